//! The page of the reference, made from the declarations.

use super::STUDIES;
use super::about::{ArgumentAbout, StudyAbout};

/// All studies as Markdown: docs/reference/studies.md.
pub fn page() -> String {
    let sections = STUDIES.iter().map(|study| section(&study.about())).collect::<String>();
    format!(
        "# Studies\n\nEach study is a command of `sandgait`, a function of the Python package and a call of the service \
         (`rpc Study`), with the same arguments, checks and results. `sandgait studies --markdown` writes this page from the \
         declarations in `src/study/`.\n\nEvery command also takes `--csv FILE` (the table), `--json` (the table as JSON) and \
         `--out DIR` (all tables and files). Every function also takes `address`, a server that computes the study, and \
         `progress`. [Studies from Python](../studies.md) has examples.\n{sections}"
    )
}

fn section(study: &StudyAbout) -> String {
    let StudyAbout { name, python, text, examples, arguments, .. } = study;
    let examples = examples.trim_start_matches("Examples:").trim_start_matches('\n');
    let examples = examples.lines().map(|line| line.trim_start_matches("  ").to_owned() + "\n").collect::<String>();
    let rows = arguments.iter().map(row).collect::<String>();
    format!(
        "\n## {name}\n\n{text}\n\nIn Python `sandgait.{name}(…)` gives `{python}`.\n\n\
         | command | Python | takes | default | meaning |\n|---|---|---|---|---|\n{rows}\n```text\n{examples}```\n"
    )
}

fn row(argument: &ArgumentAbout) -> String {
    let ArgumentAbout { keyword, long, kind_name, default, required, repeated, range, help, .. } = argument;
    let command = long.clone().unwrap_or_else(|| keyword.to_uppercase());
    let default = match (required, default) {
        (true, _) => "needed".to_owned(),
        (false, Some(default)) => format!("`{default}`"),
        (false, None) => String::new(),
    };
    let many = if *repeated { ", repeatable" } else { "" };
    let range = range.as_ref().map_or(String::new(), |range| format!(" in {range}"));
    let cells =
        [format!("`{command}`"), format!("`{keyword}`"), format!("{kind_name}{range}{many}"), default, help.clone()];
    format!("| {} |\n", cells.map(|cell| cell.replace('|', "\\|")).join(" | "))
}
