//! `sandgait evaluate`

use super::Bar;
use super::layout::{WIDTH, narrow_table, wrapped};
use sandgait::env::Task;
use sandgait::env::gait::HexapodGait;
use sandgait::env::legged::LeggedVelocity;
use sandgait::env::registry::task_id;
use sandgait::evaluate::commands::{self, CommandStudy};
use sandgait::evaluate::{Evaluation, EvaluationRequest, EvaluationRow, MOST_SEEDS, PolicySource, table};
use sandgait::{Error, Result};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Evaluate a gait: returns, speeds, costs and falls over seeds that no training uses, for each medium and slope.
///
/// POLICY is an ONNX file (sandgait.export_onnx writes one) or a fixed gait. With tripod:HZ every hip turns at this
/// rate. tripod has the best rate, searched on other seeds than those of the evaluation. clock:FILE.json and
/// clock:N,N,… repeat one action of control="clock". standing and random are for comparison. docs/evaluate.md defines
/// every figure.
///
/// With --commands: how well a policy of LeggedVelocity follows nine commands, half or nearly all of the ranges of its
/// training, without randomness. Without --options the options are those in settings.json beside the policy.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait evaluate runs/gait/policy.onnx --media poppy-loose,poppy-close --slopes 0,5,10
  sandgait evaluate tripod --slopes 0,10 --json tripod.json
  sandgait evaluate runs/go1/policy.onnx --commands --csv commands.csv
  sandgait evaluate clock:best.json --options '{\"leg\": \"C\"}' --csv clock.csv")]
pub struct EvaluateArgs {
    /// Gait: FILE.onnx, tripod[:HZ], clock:FILE.json, clock:N,N,…, standing or random
    #[arg(allow_hyphen_values = true)]
    policy: String,
    /// Name or id of the task
    #[arg(long, value_name = "NAME", default_value = HexapodGait::ID)]
    task: String,
    /// Options of the task as JSON, the same as for gymnasium.make
    #[arg(long, value_name = "JSON")]
    options: Option<String>,
    /// Number of episodes; their seeds begin at 1,000,000
    #[arg(long, value_name = "N", default_value_t = EvaluationRequest::SEEDS, value_parser = super::whole::<usize>(2..=MOST_SEEDS as u64))]
    seeds: usize,
    /// Media, instead of the medium in the options
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    media: Vec<String>,
    /// Slopes [°], instead of the slope in the options
    #[arg(long, value_name = "DEG,…", value_delimiter = ',', allow_hyphen_values = true)]
    slopes: Vec<f64>,
    /// How well a policy of LeggedVelocity follows commands
    #[arg(long, conflicts_with_all = ["task", "seeds", "media", "slopes"])]
    commands: bool,
    /// Also write all results to this JSON file
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Also write one line for each medium and slope to this CSV file
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
}

impl EvaluateArgs {
    pub fn run(self) -> Result<String> {
        let read = |file: &str| std::fs::read(file).map_err(|e| Error::file(Path::new(file), e));
        let mut options = self.options.as_deref().map_or(Ok(Value::Null), |text| {
            serde_json::from_str(text).map_err(|e| Error::invalid("--options", format!("not JSON: {e}")))
        })?;
        super::read_files(&mut options)?;
        // The paths are checked before the work begins.
        let files = [self.json.clone(), self.csv.clone()];
        files.iter().flatten().try_for_each(|path| writable(path))?;
        if self.commands {
            return follow(&self.policy, options, read, &files);
        }
        let request = EvaluationRequest {
            policy: PolicySource::parse(&self.policy, read)?,
            task: task_id(&self.task).to_owned(),
            options,
            seeds: self.seeds,
            media: self.media,
            slopes: self.slopes,
        };
        let study = Evaluation::new(&request)?;
        super::warn_of_unfelt_option(&request.options);
        let rows = study.run(&Bar::new())?;
        let about = Evaluation::about(&request);
        let text = report(&about, &rows);
        write(&files, &table::json(about, &rows), &table::csv(&rows))?;
        Ok(text)
    }
}

/// How well the policy follows commands.
fn follow(
    name: &str,
    options: Value,
    read: impl Fn(&str) -> Result<Vec<u8>>,
    files: &[Option<PathBuf>; 2],
) -> Result<String> {
    let policy = PolicySource::parse(name, read)?;
    let options = if options.is_null() { own_options(Path::new(name))? } else { options };
    let followed = CommandStudy::new(&policy, &options)?.run(&Bar::new())?;
    let about = json!({"policy": name, "task": LeggedVelocity::ID, "results": followed});
    write(files, &about, &commands::csv(&followed))?;
    let (table, summary) = (super::table(&commands::cells(&followed)), commands::summary(&followed));
    Ok(format!("{name}, {}\n\n{table}\n{summary}\n", LeggedVelocity::ID))
}

/// Writes the results to the requested files.
fn write(files: &[Option<PathBuf>; 2], json: &Value, csv: &str) -> Result<()> {
    for (path, content) in files.iter().zip([super::json(json), csv.to_owned()]) {
        let Some(path) = path else { continue };
        std::fs::write(path, content).map_err(|e| Error::unwritten(path, &e))?;
    }
    Ok(())
}

/// The options with which a policy was trained, from `settings.json` beside it; null if there is no such file.
fn own_options(policy: &Path) -> Result<Value> {
    let path = policy.with_file_name("settings.json");
    let Ok(text) = std::fs::read(&path) else { return Ok(Value::Null) };
    let settings: Value = serde_json::from_slice(&text).map_err(|e| Error::file(&path, e))?;
    match settings["task"].as_str() {
        Some(LeggedVelocity::ID) => Ok(settings["options"].clone()),
        task => Err(Error::file(&path, format!("its task is {}, not {}", task.unwrap_or("none"), LeggedVelocity::ID))),
    }
}

/// Refuses a path that is a folder or in a missing folder. Creates nothing.
fn writable(path: &Path) -> Result<()> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if path.is_dir() || !folder.is_dir() {
        return Err(Error::file(path, "no file can be written there"));
    }
    Ok(())
}

fn report(about: &Value, rows: &[EvaluationRow]) -> String {
    let range = |key: &str| about[key].as_array().map(|r| format!("{} to {}", r[0], r[1]));
    let mut head =
        format!("{}, {}", about["policy"].as_str().unwrap_or_default(), about["task"].as_str().unwrap_or_default());
    head += &range("seeds").map_or(String::new(), |r| format!(", seeds {r}"));
    head += &range("search_seeds").map_or(String::new(), |r| format!("; rate searched on seeds {r}"));
    // Each part of the table begins with medium, slope and, if it was searched, the rate.
    let keys = 2 + usize::from(rows.iter().any(|r| r.rate.is_some()));
    let head = wrapped(&head, WIDTH).join("\n");
    format!("{head}\n\n{}\n{}\n", narrow_table(&table::cells(rows), keys), table::notes(rows).join("\n"))
}
