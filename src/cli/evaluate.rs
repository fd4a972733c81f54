//! `sandgait evaluate`

use super::Bar;
use super::layout::{WIDTH, narrow_table, wrapped};
use super::options::OptionArgs;
use super::trained::task_and_options;
use sandgait::env::Task;
use sandgait::env::gait::HexapodGait;
use sandgait::env::legged::LeggedVelocity;
use sandgait::evaluate::commands::{self, CommandStudy};
use sandgait::evaluate::{Evaluation, EvaluationRequest, EvaluationRow, MOST_SEEDS, PolicySource, table};
use sandgait::{Error, Result};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Evaluate a gait: returns, speeds, costs and falls over seeds that no training uses, for each medium and slope.
///
/// POLICY is an ONNX file (`sandgait train` and sandgait.export_onnx write one) or a fixed gait. Task and options of a
/// policy are those in settings.json beside it, where --task and --option say nothing. With tripod:HZ every hip turns
/// at this rate. tripod has the best rate, searched on other seeds than those of the evaluation. clock:FILE.json and
/// clock:N,N,… repeat one action of control="clock". standing and random are for comparison. docs/evaluate.md defines
/// every figure.
///
/// A policy of LeggedVelocity follows commands. How well it follows them is measured for nine commands, half or nearly
/// all of the ranges of its training, without randomness.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait evaluate runs/gait/policy.onnx --media poppy-loose,poppy-close --slopes 0,5,10
  sandgait evaluate tripod --slopes 0,10 --json tripod.json
  sandgait evaluate runs/go1/policy.onnx --csv commands.csv
  sandgait evaluate runs/go1/policy.onnx --option ground=rigid
  sandgait evaluate clock:best.json --option leg=C --csv clock.csv")]
pub struct EvaluateArgs {
    /// Gait: FILE.onnx, tripod[:HZ], clock:FILE.json, clock:N,N,…, standing or random
    #[arg(allow_hyphen_values = true)]
    policy: String,
    /// Name or id of the task [default: the policy's, or HexapodGait]
    #[arg(long, value_name = "NAME")]
    task: Option<String>,
    #[command(flatten)]
    options: OptionArgs,
    /// Number of episodes; their seeds begin at 1,000,000 [default: 100]
    #[arg(long, value_name = "N", value_parser = super::whole::<usize>(2..=MOST_SEEDS as u64))]
    seeds: Option<usize>,
    /// Media, instead of the medium in the options
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    media: Vec<String>,
    /// Slopes [°], instead of the slope in the options
    #[arg(long, value_name = "DEG,…", value_delimiter = ',', allow_hyphen_values = true)]
    slopes: Vec<f64>,
    /// How well a policy of LeggedVelocity follows commands; its folder says so already
    #[arg(long, conflicts_with_all = ["task", "seeds", "media", "slopes"])]
    commands: bool,
    /// Also write all results to this JSON file
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Also write one line for each medium and slope, or for each command, to this CSV file
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
}

impl EvaluateArgs {
    pub fn run(self) -> Result<String> {
        let read = |file: &str| std::fs::read(file).map_err(|e| Error::file(Path::new(file), e));
        let policy = PolicySource::parse(&self.policy, read)?;
        let learnt = matches!(policy, PolicySource::Network { .. }).then_some(Path::new(&self.policy));
        let default = if self.commands { LeggedVelocity::ID } else { HexapodGait::ID };
        let (task, options) = task_and_options(learnt, self.task.as_deref(), &self.options, default)?;
        if self.commands && task != LeggedVelocity::ID {
            let reason = format!("the policy's task is {task}, not {}", LeggedVelocity::ID);
            return Err(Error::invalid("--commands", reason));
        }
        // The paths are checked before the work begins.
        let files = [self.json.clone(), self.csv.clone()];
        files.iter().flatten().try_for_each(|path| writable(path))?;
        super::warn_of_unfelt_option(&options);
        if task == LeggedVelocity::ID {
            self.check_commands()?;
            return follow(&self.policy, &policy, &options, &files);
        }
        let seeds = self.seeds.unwrap_or(EvaluationRequest::SEEDS);
        let request = EvaluationRequest { policy, task, options, seeds, media: self.media, slopes: self.slopes };
        let study = Evaluation::new(&request)?;
        let rows = study.run(&Bar::new())?;
        let about = Evaluation::about(&request);
        let text = report(&about, &rows);
        write(&files, &table::json(about, &rows), &table::csv(&rows))?;
        Ok(text)
    }

    /// Refuses arguments that an evaluation by commands does not have.
    fn check_commands(&self) -> Result<()> {
        let given = [
            ("--seeds", self.seeds.is_some()),
            ("--media", !self.media.is_empty()),
            ("--slopes", !self.slopes.is_empty()),
        ];
        let Some((name, _)) = given.iter().find(|(_, given)| *given) else { return Ok(()) };
        let reason = format!(
            "a policy of {} is evaluated by nine commands; --option ground=NAME and --option slope_deg=DEG change the ground",
            LeggedVelocity::ID
        );
        Err(Error::invalid(*name, reason))
    }
}

/// How well the policy follows commands.
fn follow(name: &str, policy: &PolicySource, options: &Value, files: &[Option<PathBuf>; 2]) -> Result<String> {
    let followed = CommandStudy::new(policy, options)?.run(&Bar::new())?;
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
