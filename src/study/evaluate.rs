//! `evaluate`: figures of gaits.

use super::arguments::{NameList, NameOrPath, Numbers, whole};
use super::declare::{Study, StudyWork};
use super::inputs::{Inputs, SENT_TEXT};
use super::options::{OptionArgs, unfelt_option};
use super::result::{RowColumn, StudyColumn, StudyResult, StudyTable};
use super::trained::{TrainedTask, in_folder, policy_file, task_and_options};
use crate::env::Task;
use crate::env::gait::HexapodGait;
use crate::env::legged::LeggedVelocity;
use crate::error::{Error, Result};
use crate::layout::{WIDTH, narrow_table, wrapped};
use sandgait_evaluate::commands::{self, CommandResult, CommandStudy, CommandTracking};
use sandgait_evaluate::sands::{self, GroundLists, MatrixGround, SandMatrix};
use sandgait_evaluate::{Evaluation, EvaluationRequest, EvaluationRow, MOST_SEEDS, PolicySource, table};
use serde_json::{Map, Value, json};
use std::path::Path;

/// Evaluate a gait: returns, speeds, costs and falls over seeds that no training uses, for each medium and slope.
///
/// POLICY is an ONNX file (`sandgait train` and sandgait.export_onnx write one) or a fixed gait. Task and options of a
/// policy are those in settings.json beside it, where --task and --option say nothing. With tripod:HZ every hip turns
/// at this rate. tripod has the best rate, searched on other seeds than those of the evaluation. clock:FILE.json and
/// clock:N,N,… repeat one action of control="clock". standing and random are for comparison. docs/evaluate.md defines
/// every figure.
///
/// A policy of LeggedVelocity follows commands. How well it follows them is measured for nine commands, half or nearly
/// all of the ranges of its training, without randomness. With --media, --slopes or --strengths the table has a line for
/// each ground, and the CSV one for each command on it.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait evaluate runs/gait --media poppy-loose,poppy-close --slopes 0,5,10
  sandgait evaluate tripod --slopes 0,10 --json tripod.json
  sandgait evaluate runs/go1 --csv commands.csv
  sandgait evaluate runs/go1 --media poppy-close,rigid --strengths 0.5,1,4
  sandgait evaluate clock:best.json --option leg=C --csv clock.csv")]
pub struct Evaluate {
    /// Gait: the folder of a training or FILE.onnx, tripod[:HZ], clock:FILE.json, clock:N,N,…, standing or random
    #[arg(allow_hyphen_values = true)]
    policy: NameOrPath,
    /// Name or id of the task [default: the policy's, or HexapodGait]
    #[arg(long, value_name = "NAME")]
    task: Option<String>,
    #[command(flatten)]
    options: OptionArgs,
    /// Number of episodes; their seeds begin at 1,000,000 [default: 100]
    #[arg(long, value_name = "N", value_parser = whole::<usize>(2..=MOST_SEEDS as u64))]
    seeds: Option<usize>,
    /// Media, instead of the medium in the options; of LeggedVelocity grounds, such as rigid
    #[arg(long, value_name = "NAME,…")]
    media: Option<NameList>,
    /// Slopes [°], instead of the slope in the options
    #[arg(long, value_name = "DEG,…", allow_hyphen_values = true)]
    slopes: Option<Numbers>,
    /// Factors on the sand's stress, of LeggedVelocity
    #[arg(long, value_name = "N,…")]
    strengths: Option<Numbers>,
    /// How well a policy of LeggedVelocity follows commands; its folder says so already
    #[arg(long, conflicts_with_all = ["task", "seeds"])]
    commands: bool,
}

impl Study for Evaluate {
    const NAME: &'static str = "evaluate";
    const PYTHON: &'static str = "Evaluation";

    fn read(&self, inputs: &mut Inputs) -> Result<()> {
        let policy = &self.policy.0;
        if let Some(file) = policy.strip_prefix("clock:").filter(|file| file.ends_with(".json")) {
            return inputs.read(file);
        }
        // A network in memory has no folder.
        if inputs.has(policy) {
            return Ok(());
        }
        let word = PolicySource::parse(policy, |_| Ok(Vec::new())).is_ok();
        let file = if word { policy.clone() } else { policy_file(Path::new(policy)).to_string_lossy().into_owned() };
        if !file.ends_with(".onnx") {
            return Ok(());
        }
        inputs.read(&file)?;
        inputs.read_if_there(&settings(&file))
    }

    fn next(&self) -> Option<String> {
        let policy = &self.policy.0;
        Some(match policy.ends_with(".onnx") || Path::new(policy).is_dir() {
            true => format!("to steer it: sandgait play {policy}"),
            false => "to learn a policy of your own: sandgait train".into(),
        })
    }

    fn check(self, inputs: &Inputs) -> Result<StudyWork> {
        let inside = in_folder(&self.policy.0);
        let name = if inputs.has(&inside) { &inside } else { &self.policy.0 };
        let policy = PolicySource::parse(name, |file| {
            let most_sent = if file.ends_with(".onnx") { sandgait_policy::MOST_BYTES } else { SENT_TEXT };
            inputs.bytes(file, most_sent).map(|bytes| bytes.to_vec())
        })?;
        let settings = settings(name);
        let learnt = matches!(policy, PolicySource::Network { .. }) && inputs.has(&settings);
        let trained =
            learnt.then(|| TrainedTask::from_settings(Path::new(&settings), inputs.text(&settings)?.as_bytes()));
        let default = if self.commands { LeggedVelocity::ID } else { HexapodGait::ID };
        let (task, options, line) =
            task_and_options(trained.transpose()?, self.task.as_deref(), &self.options, default, inputs.options)?;
        if self.commands && task != LeggedVelocity::ID {
            let reason = format!("the policy's task is {task}, not {}", LeggedVelocity::ID);
            return Err(Error::invalid("--commands", reason));
        }
        let lone = matches!(policy, PolicySource::Network { .. }) && !inputs.has(&settings);
        let bare = lone && task == LeggedVelocity::ID && options["robot"].is_null();
        let assumed = bare.then(|| {
            let short = task.trim_start_matches("sandgait/");
            format!("{settings} is missing: the policy runs in {short}, with the task's defaults where --option says nothing")
        });
        // The policy may suit another task or other options than those that were assumed.
        let cause = |e: Error| match e {
            Error::Invalid { field, reason } if lone && field == "policy" => Error::file(
                Path::new(&settings),
                format!(
                    "is missing, so the policy runs in {} with the defaults of what --task and --option do not say: put the \
                     file beside the policy, or give both; {reason}",
                    task.trim_start_matches("sandgait/")
                ),
            ),
            other => other,
        };
        let lines: Vec<String> = assumed.into_iter().chain(line).chain(unfelt_option(&options)).collect();
        if task == LeggedVelocity::ID {
            self.check_commands()?;
            let name = self.policy.0;
            if let Some(lists) = lists(self.media, self.slopes, self.strengths) {
                let matrix = SandMatrix::new(policy, options, &lists).map_err(cause)?;
                let bytes = matrix.bytes();
                let work = StudyWork::new(move |progress| Ok(on_grounds(&name, &matrix.run(progress)?)));
                return Ok(work.warning(lines).taking(bytes));
            }
            let study = CommandStudy::new(&policy, &options).map_err(cause)?;
            let bytes = study.bytes();
            let work = StudyWork::new(move |progress| Ok(followed(&name, &study.run(progress)?)));
            return Ok(work.warning(lines).taking(bytes));
        }
        if self.strengths.is_some() {
            let reason = format!("of {} only; the option sand gives a sand of another strength", LeggedVelocity::ID);
            return Err(Error::invalid("--strengths", reason));
        }
        let (media, slopes) = (self.media.unwrap_or_default().0, self.slopes.unwrap_or_default().0);
        let seeds = self.seeds.unwrap_or(EvaluationRequest::SEEDS);
        let request = EvaluationRequest { policy, task: task.clone(), options, seeds, media, slopes };
        let study = Evaluation::new(&request).map_err(cause)?;
        let (about, bytes) = (Evaluation::about(&request), study.bytes());
        let work = StudyWork::new(move |progress| Ok(evaluated(about, &study.run(progress)?)));
        Ok(work.warning(lines).taking(bytes))
    }
}

/// The file beside a policy that has its task and options.
fn settings(policy: &str) -> String {
    Path::new(policy).with_file_name("settings.json").to_string_lossy().into_owned()
}

impl Evaluate {
    /// Refuses an argument that an evaluation by commands does not have.
    fn check_commands(&self) -> Result<()> {
        let reason =
            || format!("a policy of {} is evaluated by nine commands, each followed by 16 robots", LeggedVelocity::ID);
        self.seeds.map_or(Ok(()), |_| Err(Error::invalid("--seeds", reason())))
    }
}

/// The grounds that are asked for; None if the policy's own ground is.
fn lists(media: Option<NameList>, slopes: Option<Numbers>, strengths: Option<Numbers>) -> Option<GroundLists> {
    let media = media.unwrap_or_default().0;
    let [slopes, strengths] = [slopes, strengths].map(|list| list.unwrap_or_default().0);
    let lists = GroundLists { media, slopes, strengths };
    (lists != GroundLists::default()).then_some(lists)
}

fn evaluated(about: Value, rows: &[EvaluationRow]) -> StudyResult {
    let media = StudyColumn::names("medium", rows.iter().map(|r| r.medium.as_str()));
    let columns = table::columns(rows).into_iter().map(|c| StudyColumn::numbers(&c.name, c.unit, c.values));
    let table = StudyTable::new("evaluation", std::iter::once(media).chain(columns).collect());
    let summary = report(&about, rows);
    let about = about.as_object().cloned().unwrap_or_default();
    StudyResult { summary, about, ..StudyResult::table(table) }
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

/// The columns of results for commands.
const COMMANDS: [RowColumn<'_, CommandResult>; 8] = [
    ("command_lin_vel_x", "m/s", |l| l.command[0]),
    ("command_lin_vel_y", "m/s", |l| l.command[1]),
    ("command_ang_vel_yaw", "rad/s", |l| l.command[2]),
    ("lin_vel_x", "m/s", |l| l.velocity[0]),
    ("lin_vel_y", "m/s", |l| l.velocity[1]),
    ("ang_vel_yaw", "rad/s", |l| l.velocity[2]),
    ("error", "1", |l| l.error),
    ("falls", "1", |l| l.falls),
];

/// How well the policy follows commands.
fn followed(name: &str, followed: &CommandTracking) -> StudyResult {
    let columns = StudyColumn::of_rows::<CommandResult>(&followed.lines, &COMMANDS);
    let CommandTracking { mean_error, worst_error, falls, .. } = followed;
    let about = json!({
        "policy": name, "task": LeggedVelocity::ID, "mean_error": mean_error, "worst_error": worst_error, "falls": falls,
    });
    let (cells, summary) = (crate::layout::table(&commands::cells(followed)), commands::summary(followed));
    StudyResult {
        summary: format!("{name}, {}\n\n{cells}\n{summary}\n", LeggedVelocity::ID),
        about: about.as_object().cloned().unwrap_or_else(Map::new),
        ..StudyResult::table(StudyTable::new("commands", columns))
    }
}

/// How well the policy follows commands on each ground.
fn on_grounds(name: &str, rows: &[(MatrixGround, CommandTracking)]) -> StudyResult {
    let lines: Vec<CommandResult> = rows.iter().flat_map(|row| row.1.lines.clone()).collect();
    let grounds: Vec<&MatrixGround> = rows.iter().flat_map(|row| row.1.lines.iter().map(|_| &row.0)).collect();
    let mut columns = vec![
        StudyColumn::names("medium", grounds.iter().map(|g| g.medium.as_str())),
        StudyColumn::numbers("slope_deg", "°", grounds.iter().map(|g| g.slope_deg)),
        StudyColumn::numbers("strength", "1", grounds.iter().map(|g| g.strength)),
    ];
    columns.extend(StudyColumn::of_rows::<CommandResult>(&lines, &COMMANDS));
    let of = |(ground, t): &(MatrixGround, CommandTracking)| {
        json!({
            "medium": ground.medium, "slope_deg": ground.slope_deg, "strength": ground.strength,
            "mean_error": t.mean_error, "worst_error": t.worst_error, "falls": t.falls,
        })
    };
    let about = json!({
        "policy": name, "task": LeggedVelocity::ID, "grounds": rows.iter().map(of).collect::<Vec<_>>(),
    });
    let cells = crate::layout::narrow_table(&sands::cells(rows), 3);
    StudyResult {
        summary: format!("{name}, {}\n\n{cells}", LeggedVelocity::ID),
        about: about.as_object().cloned().unwrap_or_else(Map::new),
        ..StudyResult::table(StudyTable::new("grounds", columns))
    }
}
