//! The page of a task as Markdown, made from the tables that also define the task's rows.

use sandgait::Result;
use sandgait::env::control::Control;
use sandgait::env::registry::{Blueprint, Keyword};
use sandgait::env::spec::RewardTerm;
use sandgait::env::{Column, Spec};
use serde_json::{Value, json};

/// Everything about task `id` with its default options.
pub fn page(id: &str) -> Result<String> {
    let task = Blueprint::new(id, Value::Null)?;
    let keywords = task.keywords();
    let Spec { summary, about, observation, info, reward, max_episode_steps, control_rate, .. } = task.task.spec();
    let (terms, figures) = info.split_at(reward.len());
    let actions = if keywords.iter().any(|k| k.name == "control") {
        Control::NAMES.iter().map(|name| action(id, Some(name))).collect::<Result<String>>()?
    } else {
        action(id, None)?
    };
    Ok(format!(
        "# {id}\n\n{summary}\n\n{about}\n\n{control_rate} control steps per second, at most {max_episode_steps} in an episode. \
         `sandgait tasks --markdown {id}` prints this part of the page.\n\n\
         ## Actions\n{actions}\n\
         ## Reward\n\nThe reward is the sum of the weighted terms. Each weighted term is a column of `info`.\n\n{}\n\
         ## Figures in `info`\n\n{}\n\
         ## Observation\n\n{}\n\
         ## Options\n\nOptions are keywords of `gymnasium.make`. Those marked `reset` are also options of `reset(options=…)`.\n\n{}",
        rows(&["column", "term", "weight"], terms.iter().zip(reward).map(term)),
        rows(&["column", "unit", "range"], figures.iter().map(|c| vec![code(&c.name), c.unit.into(), range(c)])),
        columns(observation),
        rows(&["option", "default", "at", "meaning"], keywords.iter().flat_map(option)),
    ))
}

/// The table of actions, for one control mode if there are several.
fn action(id: &str, control: Option<&str>) -> Result<String> {
    let options = control.map_or(Value::Null, |control| json!({"control": control}));
    let task = Blueprint::new(id, options)?;
    let title = control.map_or(String::new(), |control| format!("\n`control=\"{control}\"`\n"));
    Ok(format!("{title}\n{}", columns(&task.task.spec().action)))
}

fn term((column, term): (&Column, &RewardTerm)) -> Vec<String> {
    vec![code(&column.name), term.law.into(), format!("{}", term.weight)]
}

/// The row of an option; for a dictionary also a row for each of its keys.
fn option(k: &Keyword) -> Vec<Vec<String>> {
    let when = if k.at_reset { "make, reset" } else { "make" };
    let row =
        |name: &str, value: &Value, help: &str| vec![code(name), code(&value.to_string()), when.into(), help.into()];
    let keys = k.keys.iter().filter(|_| k.value.is_object());
    let keys = keys.map(|key| row(&format!("{}.{}", k.name, key.name), &k.value[key.name], key.help));
    let whole = match k.keys.is_empty() || !k.value.is_object() {
        true => row(k.name, &k.value, &k.summary),
        false => vec![code(k.name), "a dictionary:".into(), when.into(), k.help.into()],
    };
    std::iter::once(whole).chain(keys).collect()
}

fn columns(table: &[Column]) -> String {
    let row = |(i, c): (usize, &Column)| vec![i.to_string(), c.name.clone(), c.unit.into(), range(c)];
    rows(&["", "name", "unit", "range"], table.iter().enumerate().map(row))
}

fn code(text: &str) -> String {
    format!("`{text}`")
}

/// A bound with four decimals.
fn range(c: &Column) -> String {
    let bound = |x: f64| match x.is_finite() {
        true => format!("{}", (x * 1e4).round() / 1e4),
        false => format!("{}∞", if x < 0.0 { "−" } else { "" }),
    };
    format!("{} … {}", bound(c.low), bound(c.high))
}

/// A table with a heading. Bars in cells are escaped, because a bar would end the cell.
fn rows(head: &[&str], body: impl Iterator<Item = Vec<String>>) -> String {
    let line = |cells: Vec<String>| {
        let cells: Vec<_> = cells.iter().map(|cell| cell.replace('|', "\\|")).collect();
        format!("| {} |\n", cells.join(" | "))
    };
    let rule = format!("|{}\n", "---|".repeat(head.len()));
    line(head.iter().map(|h| (*h).to_owned()).collect()) + &rule + &body.map(line).collect::<String>()
}
