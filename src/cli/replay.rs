//! `sandgait replay`

use sandgait::study::layout::narrow_table;
use sandgait::view::{self, Section, page};
use sandgait::{Error, Result, files};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Describe a recording, or write it as a page for browsers.
///
/// `sandgait walk --record FILE` records a walk; `env.unwrapped.record(FILE)` in Python records any environment.
/// docs/recordings.md has the format of recordings.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait replay walk.rec                       (prints its contents)
  sandgait replay walk.rec --html walk.html      (one page with everything in it; open it in a browser)")]
pub struct ReplayArgs {
    /// File of the recording
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Write a self-contained page to this file
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// Print JSON
    #[arg(long, conflicts_with = "html")]
    json: bool,
}

impl ReplayArgs {
    pub fn run(self) -> Result<String> {
        let bytes = files::read(&self.file, view::MOST_UNPACKED)?;
        let sections = view::read(&bytes).map_err(|e| match e {
            Error::Invalid { reason, .. } => Error::file(&self.file, reason),
            other => other,
        })?;
        if let Some(out) = self.html {
            let title = self.file.file_name().unwrap_or(self.file.as_os_str()).to_string_lossy();
            std::fs::write(&out, page::replay(&bytes, &title)).map_err(|e| Error::unwritten(&out, &e))?;
            return Ok(format!("{}\n", out.display()));
        }
        let all: Vec<_> = sections.iter().map(summary).collect();
        Ok(if self.json { super::json(&Value::Array(all)) } else { table(&self.file, &all) })
    }
}

/// A short description of a section.
fn summary(section: &Section) -> Value {
    let first = |name: &str, k: usize| section.at(name, k).and_then(|v| v.first()).map(|v| f64::from(*v));
    let last = section.len().saturating_sub(1);
    let times = first("time", 0).zip(first("time", last));
    let places = first("position", 0).zip(first("position", last));
    let speed = times.zip(places).map(|((t0, t1), (x0, x1))| (x1 - x0) / (t1 - t0)).filter(|v| v.is_finite());
    let header = &section.header;
    serde_json::json!({
        "task": header.task,
        "robot": header.robot,
        "medium": header.medium,
        "seed": header.seed,
        "episode": header.episode,
        "moments": section.len(),
        "rate": header.rate,
        "mean_speed": speed,
    })
}

fn table(file: &Path, sections: &[Value]) -> String {
    let names = ["task", "robot", "medium", "seed", "episode", "moments", "rate", "mean_speed"];
    let text = |v: &Value| match v {
        Value::Null => "–".to_owned(),
        Value::String(s) => s.clone(),
        Value::Number(n) if n.is_f64() => format!("{:.4}", n.as_f64().unwrap_or(f64::NAN)),
        other => other.to_string(),
    };
    let unit = |name: &str| match name {
        "rate" => " [Hz]",
        "mean_speed" => " [m/s]",
        _ => "",
    };
    let head = names.map(|name| format!("{}{}", name.replace('_', " "), unit(name))).to_vec();
    let rows = sections.iter().map(|s| names.iter().map(|n| text(&s[*n])).collect());
    let rows: Vec<Vec<String>> = std::iter::once(head).chain(rows).collect();
    let note = "mean speed: along x from the first to the last moment, with the start from rest";
    format!("{}\n{}\n{note}\n", file.display(), narrow_table(&rows, 0))
}
