//! The page of a task as Markdown, made from the tables that also define the task's rows. Options that most tasks have in the
//! same form are on a page of their own, which is written by the same code.

use sandgait::Result;
use sandgait::env::control::Control;
use sandgait::env::registry::{Blueprint, Keyword, TASK_IDS, task_id};
use sandgait::env::spec::RewardTerm;
use sandgait::env::{Column, Spec};
use serde_json::{Value, json};

/// The name of the page of common options, in place of a task's id.
const COMMON: &str = "common";

/// An option is common if at least so many tasks have it with the same default and meaning: our choice, more than half of six.
const MOST: usize = 4;

/// Everything about task `id` with its default options; or the page of [`COMMON`] options.
pub fn page(id: &str) -> Result<String> {
    let common = common()?;
    if id == COMMON {
        return Ok(common_page(&common));
    }
    let task = Blueprint::new(id, Value::Null)?;
    let keywords = task.keywords();
    let Spec { summary, about, action, observation, info, reward, max_episode_steps, control_rate, .. } =
        task.task.spec();
    let (terms, figures) = info.split_at(reward.len());
    let joints = parts_of(action);
    let actions = if keywords.iter().any(|k| k.name == "control") {
        let one = |name: &&str| action_rows(id, json!({"control": name}), &joints, Some(*name));
        Control::NAMES.iter().map(one).collect::<Result<Vec<_>>>()?.concat()
    } else {
        action_rows(id, Value::Null, &joints, None)?
    };
    let (shared, own): (Vec<_>, Vec<_>) = keywords.iter().partition(|k| common.iter().any(|c| c.rows == option(k)));
    let shared: Vec<_> = shared.iter().map(|k| code(k.name)).collect();
    let name = short(id);
    Ok(format!(
        "# {id}\n\n{summary}\n\n{about}\n\n{control_rate} control steps per second, at most {max_episode_steps} in an episode. \
         `sandgait tasks --markdown {id}` prints this part of the page, and `sandgait tasks {name}` each single column. {}\n\n\
         ## Actions\n\n{}\n\
         ## Reward\n\nThe sum of the weighted terms, each of which is a column of `info`.\n\n{}\n\
         ## Figures in `info`\n\n{}\n\
         ## Observation\n\n{}\n\
         ## Options\n\nKeywords of `gymnasium.make`; those marked `reset` are also options of `reset(options=…)`. \
         [Options of most tasks](common.md): {}.\n\n{}",
        each_joint(&joints),
        rows(&["", "name", "unit", "range"], actions.into_iter()),
        rows(&["column", "term", "weight"], terms.iter().zip(reward).map(term)),
        rows(&["columns", "unit", "range"], figure_rows(figures).into_iter()),
        rows(&["", "name", "unit", "range"], runs(observation, &joints).into_iter().map(ColumnRun::into_row)),
        shared.join(", "),
        rows(&["option", "default", "", "meaning"], own.into_iter().flat_map(option)),
    ))
}

/// An option that several tasks have, with its rows on the page, and the names of these tasks.
struct CommonOption {
    rows: Vec<Vec<String>>,
    tasks: Vec<&'static str>,
}

/// The latest version of each task.
fn latest() -> impl Iterator<Item = &'static str> {
    TASK_IDS.into_iter().filter(|id| task_id(short(id)) == *id)
}

/// A task's id without `sandgait/` and without its version.
fn short(id: &str) -> &str {
    id.trim_start_matches("sandgait/").split("-v").next().unwrap_or(id)
}

/// The options that at least [`MOST`] tasks have in the same form, in the order of the first task that has them.
fn common() -> Result<Vec<CommonOption>> {
    let mut all: Vec<CommonOption> = Vec::new();
    for id in latest() {
        for keyword in Blueprint::new(id, Value::Null)?.keywords() {
            let rows = option(&keyword);
            match all.iter_mut().find(|c| c.rows == rows) {
                Some(known) => known.tasks.push(id),
                None => all.push(CommonOption { rows, tasks: vec![id] }),
            }
        }
    }
    all.retain(|c| c.tasks.len() >= MOST);
    Ok(all)
}

fn common_page(common: &[CommonOption]) -> String {
    let names =
        |tasks: &[&str]| tasks.iter().map(|id| id.trim_start_matches("sandgait/")).collect::<Vec<_>>().join(", ");
    let all = latest().count();
    let line = |c: &CommonOption| {
        let missing: Vec<_> = latest().filter(|id| !c.tasks.contains(id)).collect();
        let whole = c.tasks.len() == all;
        let note = if whole { String::new() } else { format!("; not so in {}", names(&missing)) };
        let mut rows = c.rows.clone();
        rows[0][3] += &note;
        rows
    };
    format!(
        "# Options of most tasks\n\nKeywords of `gymnasium.make`, which these tasks take in the same form: {}. Those marked `reset` are \
         also options of `reset(options=…)`. `sandgait tasks --markdown {COMMON}` prints this page.\n\n{}",
        names(&latest().collect::<Vec<_>>()),
        rows(&["option", "default", "", "meaning"], common.iter().flat_map(line)),
    )
}

/// The rows of actions, for one control mode if there are several.
fn action_rows(id: &str, options: Value, joints: &[String], control: Option<&str>) -> Result<Vec<Vec<String>>> {
    let task = Blueprint::new(id, options)?;
    let mut rows: Vec<_> = runs(&task.task.spec().action, joints).into_iter().map(ColumnRun::into_row).collect();
    if let Some(control) = control {
        rows[0][1].insert_str(0, &format!("`control=\"{control}\"`: "));
    }
    Ok(rows)
}

/// Neighbouring columns that differ in the last part of their names only.
struct ColumnRun {
    first: usize,
    stem: String,
    parts: Vec<String>,
    /// Do all parts stand for the joints?
    joints: bool,
    unit: &'static str,
    /// Each different range, in order.
    ranges: Vec<String>,
}

impl ColumnRun {
    /// The name of all columns together.
    fn name(&self) -> String {
        let Self { stem, parts, joints, .. } = self;
        match (parts.as_slice(), joints) {
            (_, true) => format!("{stem}, each joint"),
            ([], _) => stem.clone(),
            ([first, .., last], _) if parts.len() > 6 => format!("{stem} {first} … {last}"),
            _ => format!("{stem}, {}", parts.join(", ")),
        }
    }

    fn into_row(self) -> Vec<String> {
        let last = self.first + self.parts.len().max(1) - 1;
        let numbers = if last > self.first { format!("{} … {last}", self.first) } else { last.to_string() };
        vec![numbers, self.name(), self.unit.into(), self.ranges.join(" or ")]
    }
}

/// A name without its last part: after a comma, before a number, or an axis.
fn split(name: &str) -> (&str, &str) {
    let number = |at: usize| name[at..].trim_start_matches([' ', '-']).starts_with(|c: char| c.is_ascii_digit());
    let axis = |(_, end): &(&str, &str)| ["x", "y", "z"].contains(end);
    if let Some(parts) = name.rsplit_once(", ") {
        return parts;
    }
    if let Some((at, _)) = name.match_indices(' ').find(|(at, _)| number(*at)) {
        return (&name[..at], &name[at + 1..]);
    }
    name.rsplit_once(' ').filter(axis).unwrap_or((name, ""))
}

/// The last parts of the names of the actions, which are names of joints or of their legs.
fn parts_of(action: &[Column]) -> Vec<String> {
    action.iter().map(|c| split(&c.name).1.to_owned()).filter(|part| !part.is_empty()).collect()
}

fn each_joint(joints: &[String]) -> String {
    match joints.len() {
        0..=2 => String::new(),
        _ => format!("*Each joint* stands for {}, in this order.", joints.join(", ")),
    }
}

/// Gathers neighbouring columns.
fn runs(columns: &[Column], joints: &[String]) -> Vec<ColumnRun> {
    let mut all: Vec<ColumnRun> = Vec::new();
    for (i, c) in columns.iter().enumerate() {
        let (stem, part) = split(&c.name);
        let range = range(c);
        match all.last_mut() {
            Some(run) if !part.is_empty() && run.stem == stem && run.unit == c.unit && !run.parts.is_empty() => {
                run.parts.push(part.into());
                if !run.ranges.contains(&range) {
                    run.ranges.push(range);
                }
            }
            _ => {
                let parts = if part.is_empty() { Vec::new() } else { vec![part.to_owned()] };
                let ranges = vec![range];
                all.push(ColumnRun { first: i, stem: stem.into(), parts, joints: false, unit: c.unit, ranges });
            }
        }
    }
    for run in &mut all {
        run.joints = joints.len() > 2 && run.parts == joints;
    }
    all
}

/// Neighbouring figures with the same unit and range are in one row; their names say what they are.
fn figure_rows(figures: &[Column]) -> Vec<Vec<String>> {
    let mut all: Vec<Vec<String>> = Vec::new();
    for c in figures {
        let (name, range) = (code(&c.name), range(c));
        match all.last_mut() {
            Some(row) if row[1] == c.unit && row[2] == range => row[0] += &format!(", {name}"),
            _ => all.push(vec![name, c.unit.into(), range]),
        }
    }
    all
}

fn term((column, term): (&Column, &RewardTerm)) -> Vec<String> {
    vec![code(&column.name), term.law.into(), format!("{}", term.weight)]
}

/// The row of an option; for a dictionary also a row for each of its keys.
fn option(k: &Keyword) -> Vec<Vec<String>> {
    let when = if k.at_reset { "reset" } else { "" };
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

fn code(text: &str) -> String {
    format!("`{text}`")
}

/// A bound with four decimals; nothing if there are no bounds.
fn range(c: &Column) -> String {
    let bound = |x: f64| match x.is_finite() {
        true => format!("{}", (x * 1e4).round() / 1e4),
        false => format!("{}∞", if x < 0.0 { "−" } else { "" }),
    };
    match c.low.is_finite() || c.high.is_finite() {
        true => format!("{} … {}", bound(c.low), bound(c.high)),
        false => String::new(),
    }
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
