//! `sandgait tasks`

use super::task_page;
use sandgait::Result;
use sandgait::env::Column;
use sandgait::env::registry::{Blueprint, Keyword, TASK_IDS, task_id};
use sandgait::study::layout::{WIDTH, glossary, table, wrapped};
use serde_json::{Value, json};

/// List the tasks, or describe one: observations, actions, rewards, and options with their defaults
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait tasks
  sandgait tasks HexapodGait
  sandgait tasks sandgait/LeggedVelocity-v1 --json")]
pub struct TasksArgs {
    /// Describe this task: its id, or the id without `sandgait/` and without version
    #[arg(value_name = "NAME", conflicts_with = "markdown")]
    name: Option<String>,
    /// Print JSON; without NAME of all tasks
    #[arg(long)]
    json: bool,
    /// Print the page of one task, as in docs/tasks, or of the options of most tasks (`common`)
    #[arg(long, value_name = "ID", conflicts_with = "json")]
    markdown: Option<String>,
}

impl TasksArgs {
    pub fn run(self) -> Result<String> {
        if let Some(id) = &self.markdown {
            return task_page::page(id);
        }
        if let Some(name) = &self.name {
            let task = Blueprint::new(task_id(name), Value::Null)?;
            return Ok(if self.json { super::json(&as_json(&task)) } else { as_text(&task) });
        }
        let tasks = TASK_IDS.iter().map(|id| Blueprint::new(id, Value::Null)).collect::<Result<Vec<_>>>()?;
        if self.json {
            return Ok(super::json(&tasks.iter().map(as_json).collect()));
        }
        let line = |task: &Blueprint| vec![task.task.spec().id.to_owned(), task.task.spec().summary.clone()];
        let list = glossary(&tasks.iter().map(line).collect::<Vec<_>>());
        Ok(format!("{list}\n`sandgait tasks NAME` describes one of them, `--json` all.\n"))
    }
}

fn as_json(task: &Blueprint) -> Value {
    let spec = task.task.spec();
    // JSON has no infinity: a side without a bound is null.
    let column = |c: &Column| json!({"name": c.name, "unit": c.unit, "low": c.low, "high": c.high});
    let columns = |table: &[Column]| table.iter().map(column).collect::<Value>();
    let option = |k: Keyword| json!({"name": k.name, "summary": k.summary, "default": k.value, "at_reset": k.at_reset});
    json!({
        "id": spec.id,
        "summary": spec.summary,
        "observation": columns(&spec.observation),
        "action": columns(&spec.action),
        "info": columns(&spec.info),
        "reward_terms": spec.reward.len(),
        "max_episode_steps": spec.max_episode_steps,
        "control_rate": spec.control_rate,
        "options": task.keywords().into_iter().map(option).collect::<Value>(),
    })
}

fn as_text(task: &Blueprint) -> String {
    let spec = task.task.spec();
    let column = |(i, c): (usize, &Column)| {
        let bound = |x: f64| match x.is_finite() {
            true => format!("{x:.3}").trim_end_matches('0').trim_end_matches('.').to_owned(),
            false => "∞".into(),
        };
        let range = match (c.low, c.high) {
            (low, high) if low.is_infinite() && high.is_infinite() => String::new(),
            (low, high) => format!("[{}, {}]", bound(low), bound(high)),
        };
        vec![format!("  {i}"), c.name.clone(), c.unit.into(), range]
    };
    let columns = |all: &[Column]| table(&all.iter().enumerate().map(column).collect::<Vec<_>>());
    let option = |k: Keyword| {
        let when = if k.at_reset { "make, reset" } else { "make" };
        // Keys of dictionaries are separated by blanks, at which lines can be broken.
        let value = k.value.to_string().replace(",\"", ", \"");
        let head = wrapped(&format!("{} = {value} ({when})", k.name), WIDTH - 4).join("\n    ");
        format!("  {head}\n      {}\n", wrapped(&k.summary, WIDTH - 6).join("\n      "))
    };
    let options = task.keywords().into_iter().map(option).collect::<String>();
    let summary = wrapped(&spec.summary, WIDTH - 2).join("\n  ");
    format!(
        "{}\n  {}\n  {} control steps per second, at most {} in an episode\n\nobservation\n{}\naction\n{}\ninfo (the first {} are the reward terms)\n{}\noptions\n{options}",
        spec.id,
        summary,
        spec.control_rate,
        spec.max_episode_steps,
        columns(&spec.observation),
        columns(&spec.action),
        spec.reward.len(),
        columns(&spec.info),
    )
}
