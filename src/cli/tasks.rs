//! `sandgait tasks`

use super::task_page;
use sandgait::Result;
use sandgait::env::Column;
use sandgait::env::registry::{Blueprint, Keyword, TASK_IDS};
use serde_json::{Value, json};

/// List the tasks: observations, actions, rewards, and options with their defaults
#[derive(clap::Args)]
pub struct Tasks {
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Print the page of one task, as in docs/tasks
    #[arg(long, value_name = "ID", conflicts_with = "json")]
    markdown: Option<String>,
}

impl Tasks {
    pub fn run(self) -> Result<String> {
        if let Some(id) = &self.markdown {
            return task_page::page(id);
        }
        let tasks = TASK_IDS.iter().map(|id| Blueprint::new(id, Value::Null)).collect::<Result<Vec<_>>>()?;
        if self.json {
            return Ok(super::json(&tasks.iter().map(as_json).collect()));
        }
        Ok(tasks.iter().map(as_text).collect::<Vec<_>>().join("\n"))
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
        let bound = |x: f64| if x.is_finite() { format!("{x}") } else { "∞".into() };
        let range = match (c.low, c.high) {
            (low, high) if low.is_infinite() && high.is_infinite() => String::new(),
            (low, high) => format!("[{}, {}]", bound(low), bound(high)),
        };
        vec![format!("  {i}"), c.name.clone(), c.unit.into(), range]
    };
    let columns = |table: &[Column]| super::table(&table.iter().enumerate().map(column).collect::<Vec<_>>());
    let option = |k: Keyword| {
        let when = if k.at_reset { "make, reset" } else { "make" };
        vec![format!("  {}", k.name), k.value.to_string(), when.into(), k.summary]
    };
    let options = super::table(&task.keywords().into_iter().map(option).collect::<Vec<_>>());
    format!(
        "{}\n  {}\n  {} control steps per second, at most {} in an episode\n\nobservation\n{}\naction\n{}\ninfo (the first {} are the reward terms)\n{}\noptions\n{options}",
        spec.id,
        spec.summary,
        spec.control_rate,
        spec.max_episode_steps,
        columns(&spec.observation),
        columns(&spec.action),
        spec.reward.len(),
        columns(&spec.info),
    )
}
