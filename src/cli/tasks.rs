//! `sandgait tasks`

use sandgait::Result;
use sandgait::env::options::OPTION_HELP;
use sandgait::env::task::{Blueprint, TASK_IDS};
use sandgait::env::{Column, ResetOptions};
use serde_json::{Value, json};

/// List the tasks: what is observed, what an action is, what is paid for, and the options with their defaults.
#[derive(clap::Args)]
pub struct Tasks {
    /// Machine-readable
    #[arg(long)]
    json: bool,
}

impl Tasks {
    pub fn run(self) -> Result<String> {
        let tasks = TASK_IDS.iter().map(|id| Blueprint::new(id, Value::Null)).collect::<Result<Vec<_>>>()?;
        if self.json {
            return Ok(super::json(&tasks.iter().map(as_json).collect()));
        }
        Ok(tasks.iter().map(as_text).collect::<Vec<_>>().join("\n"))
    }
}

/// Name, summary, default, and whether a reset may change it.
fn options(task: &Blueprint) -> Vec<(&'static str, &'static str, Value, bool)> {
    let values = serde_json::to_value(&task.setup.options).unwrap_or_default();
    let option = |(name, summary): &(&'static str, &'static str)| {
        (*name, *summary, values[*name].clone(), ResetOptions::NAMES.contains(name))
    };
    OPTION_HELP.iter().map(option).collect()
}

fn as_json(task: &Blueprint) -> Value {
    let spec = task.task.spec();
    // JSON has no infinity: a side without a bound is null.
    let column = |c: &Column| json!({"name": c.name, "unit": c.unit, "low": c.low, "high": c.high});
    let columns = |table: &[Column]| table.iter().map(column).collect::<Value>();
    let option = |(name, summary, default, at_reset)| json!({"name": name, "summary": summary, "default": default, "at_reset": at_reset});
    json!({
        "id": spec.id,
        "summary": spec.summary,
        "observation": columns(&spec.observation),
        "action": columns(&spec.action),
        "info": columns(&spec.info),
        "reward_terms": spec.reward_terms,
        "max_episode_steps": spec.max_episode_steps,
        "control_rate": spec.control_rate,
        "options": options(task).into_iter().map(option).collect::<Value>(),
    })
}

fn as_text(task: &Blueprint) -> String {
    let spec = task.task.spec();
    let column = |(i, c): (usize, &Column)| {
        let bound = |x: f64| if x.is_finite() { format!("{x}") } else { "∞".into() };
        let range = match (c.low, c.high) {
            (low, high) if low.is_infinite() && high.is_infinite() => String::new(),
            (low, high) => format!("[{}, {}]", bound(low), bound(high)),
        };
        vec![format!("  {i}"), c.name.clone(), c.unit.into(), range]
    };
    let columns = |table: &[Column]| super::table(&table.iter().enumerate().map(column).collect::<Vec<_>>());
    let option = |(name, summary, default, at_reset): (&str, &str, Value, bool)| {
        let when = if at_reset { "make, reset" } else { "make" };
        vec![format!("  {name}"), default.to_string(), when.into(), summary.into()]
    };
    let options = super::table(&options(task).into_iter().map(option).collect::<Vec<_>>());
    format!(
        "{}\n  {}\n  {} control steps a second, at most {} an episode\n\nobservation\n{}\naction\n{}\ninfo (the first {} are the reward's terms)\n{}\noptions\n{options}",
        spec.id,
        spec.summary,
        spec.control_rate,
        spec.max_episode_steps,
        columns(&spec.observation),
        columns(&spec.action),
        spec.reward_terms,
        columns(&spec.info),
    )
}
