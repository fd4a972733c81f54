//! The functions in Python, made from the declarations.

use super::STUDIES;
use super::about::{ArgumentAbout, ArgumentKind, StudyAbout};
use std::collections::BTreeSet;

/// Width of lines of Python code: that of the project's linter.
const WIDTH: usize = 120;

/// python_client/sandgait/study_functions.py.
pub fn module() -> String {
    let studies: Vec<StudyAbout> = STUDIES.iter().map(super::StudyEntry::about).collect();
    let classes: BTreeSet<&str> =
        studies.iter().map(|study| study.python).filter(|class| !["Any", "Table"].contains(class)).collect();
    let classes: Vec<&str> = classes.into_iter().collect();
    let names = studies.iter().map(|study| format!("    \"{}\",\n", study.name)).collect::<BTreeSet<_>>();
    let functions = studies.iter().map(function).collect::<Vec<_>>().join("\n\n");
    format!(
        "\"\"\"Studies as functions. `sandgait studies --python` writes this file from the declarations in src/study/.\"\"\"\n\n\
         from __future__ import annotations\n\n\
         from collections.abc import Iterable, Mapping\n\
         from typing import Any\n\n\
         import numpy.typing as npt\n\n\
         from .arguments import checked\n\
         from .results import {}\n\
         from .study_call import Data, FilePath, ProgressOption, StudyCall\n\
         from .tables import Table\n\n\
         __all__ = [\n{}]\n\n\n{functions}",
        classes.join(", "),
        names.into_iter().collect::<String>(),
    )
}

fn function(study: &StudyAbout) -> String {
    let StudyAbout { name, python, arguments, .. } = study;
    let (options, named): (Vec<_>, Vec<_>) = arguments.iter().partition(|a| a.kind == ArgumentKind::TaskOptions);
    let parameters = named.iter().map(|argument| format!("    {},\n", parameter(argument))).collect::<String>();
    let keywords = options.iter().map(|a| format!("    **{}: Any,\n", a.keyword)).collect::<String>();
    let calls = arguments.iter().map(|argument| format!("    {}\n", call(argument))).collect::<String>();
    format!(
        "@checked\ndef {name}(\n{parameters}    address: str | None = None,\n    progress: ProgressOption = True,\n{keywords}) \
         -> {python}:\n{}    call = StudyCall(\"{name}\")\n{calls}    result: {python} = call.run(address, progress)\n    \
         return result\n",
        docstring(study)
    )
}

/// The types that a parameter accepts.
fn hint(argument: &ArgumentAbout) -> &'static str {
    match argument.kind {
        ArgumentKind::InputPath if argument.repeated => "FilePath | Iterable[FilePath]",
        ArgumentKind::Flag => "bool",
        ArgumentKind::Number => "float",
        ArgumentKind::Whole => "int",
        ArgumentKind::Text => "str",
        ArgumentKind::Numbers => "float | npt.ArrayLike",
        ArgumentKind::Names => "Iterable[str]",
        ArgumentKind::InputPath | ArgumentKind::OutputPath => "FilePath",
        ArgumentKind::NameOrPath => "FilePath | bytes",
        ArgumentKind::Table => "Data",
        ArgumentKind::Measured => "Any",
        ArgumentKind::Tables => "FilePath | Mapping[str, Any]",
        ArgumentKind::Settings | ArgumentKind::TaskOptions => "Mapping[str, Any]",
    }
}

fn parameter(argument: &ArgumentAbout) -> String {
    let ArgumentAbout { keyword, kind, default, required, excludes, .. } = argument;
    let hint = hint(argument);
    // A default that is passed on would count as given.
    match default.as_ref().filter(|_| !excludes) {
        _ if *required => format!("{keyword}: {hint}"),
        _ if *kind == ArgumentKind::Flag => format!("{keyword}: bool = False"),
        Some(text) => {
            let number = [ArgumentKind::Number, ArgumentKind::Whole].contains(kind);
            let value = if number { text.clone() } else { format!("\"{text}\"") };
            let value = if *kind == ArgumentKind::Number && !value.contains(['.', 'e']) { value + ".0" } else { value };
            format!("{keyword}: {hint} = {value}")
        }
        None => format!("{keyword}: {hint} | None = None"),
    }
}

/// The line that passes an argument on.
fn call(argument: &ArgumentAbout) -> String {
    let method = match argument.kind {
        ArgumentKind::InputPath if argument.repeated => "files",
        ArgumentKind::Flag => "flag",
        ArgumentKind::Number | ArgumentKind::Whole | ArgumentKind::Text => "value",
        ArgumentKind::Numbers => "numbers",
        ArgumentKind::Names => "names",
        ArgumentKind::InputPath | ArgumentKind::NameOrPath => "file",
        ArgumentKind::OutputPath => "output",
        ArgumentKind::Table => "data",
        ArgumentKind::Measured => "measured",
        ArgumentKind::Tables => "tables",
        ArgumentKind::Settings => "settings",
        ArgumentKind::TaskOptions => "options",
    };
    let word = argument.long.as_deref().unwrap_or_default();
    format!("call.{method}(\"{word}\", \"{keyword}\", {keyword})", keyword = argument.keyword)
}

fn docstring(study: &StudyAbout) -> String {
    let mut text = String::new();
    for (k, paragraph) in study.text.split("\n\n").enumerate() {
        let begin = if k == 0 { "\"\"\"" } else { "\n" };
        text += &wrapped(&format!("{begin}{}", keywords(study, paragraph)), "    ");
    }
    text.push('\n');
    for argument in &study.arguments {
        let default = match &argument.default {
            Some(default) if argument.excludes && argument.kind != ArgumentKind::Flag => {
                format!("; default: {default}")
            }
            _ => String::new(),
        };
        let range = argument.range.as_ref().map_or(String::new(), |range| format!(", in {range}"));
        let help = keywords(study, &argument.help);
        text += &wrapped(&format!("`{}`: {help}{range}{default}.", argument.keyword), "    ");
    }
    let address = "`address`: a running server that computes the study; by default this process computes it. `progress`: shows \
                   the progress, or a function that gets it. Ctrl-C stops the study.";
    text + &wrapped(address, "    ") + "    \"\"\"\n"
}

/// `text` with Python's keywords in place of the options of the command line.
fn keywords(study: &StudyAbout, text: &str) -> String {
    let mut text = text.to_owned();
    let mut longs: Vec<_> = study.arguments.iter().filter_map(|a| Some((a.long.clone()?, &a.keyword))).collect();
    // The longer name first, because the other may begin it.
    longs.sort_by_key(|(long, _)| std::cmp::Reverse(long.len()));
    for (long, keyword) in longs {
        text = text.replace(&long, &format!("`{keyword}`"));
    }
    text
}

/// Lines of at most [`WIDTH`] characters.
fn wrapped(text: &str, indent: &str) -> String {
    let mut lines: Vec<String> = Vec::new();
    let (blank, text) = text.strip_prefix('\n').map_or(("", text), |rest| ("\n", rest));
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= WIDTH => *line += &format!(" {word}"),
            _ => lines.push(format!("{indent}{word}")),
        }
    }
    lines.into_iter().fold(blank.to_owned(), |text, line| text + &line + "\n")
}
