//! A study's arguments as data, read from its declaration.

use super::arguments::{DataPath, FolderPath, InputPath, NameList, NameOrPath, Numbers, OutputPath};
use super::arguments::{Setting, TableData, TaskOption, TomlPath};
use super::declare::StudyEntry;
use clap::{Arg, ArgAction, Command};
use std::any::TypeId;

/// What may be given for an argument.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArgumentKind {
    Flag,
    Number,
    Whole,
    Text,
    Numbers,
    Names,
    InputPath,
    NameOrPath,
    OutputPath,
    /// A table in a file or in memory.
    Table,
    /// Measured data.
    Measured,
    /// Tables of a TOML file.
    Tables,
    /// Values by names.
    Settings,
    /// Options of a task.
    TaskOptions,
}

/// The types of fields, and what they are called.
fn kinds() -> [(TypeId, ArgumentKind, &'static str); 16] {
    use ArgumentKind as K;
    [
        (TypeId::of::<bool>(), K::Flag, "flag"),
        (TypeId::of::<f64>(), K::Number, "number"),
        (TypeId::of::<usize>(), K::Whole, "whole number"),
        (TypeId::of::<u8>(), K::Whole, "whole number"),
        (TypeId::of::<String>(), K::Text, "text"),
        (TypeId::of::<Numbers>(), K::Numbers, "numbers"),
        (TypeId::of::<NameList>(), K::Names, "names"),
        (TypeId::of::<InputPath>(), K::InputPath, "file"),
        (TypeId::of::<FolderPath>(), K::InputPath, "folder"),
        (TypeId::of::<NameOrPath>(), K::NameOrPath, "name or file"),
        (TypeId::of::<OutputPath>(), K::OutputPath, "file to write"),
        (TypeId::of::<TableData>(), K::Table, "table"),
        (TypeId::of::<DataPath>(), K::Measured, "file"),
        (TypeId::of::<TomlPath>(), K::Tables, "file"),
        (TypeId::of::<Setting>(), K::Settings, "name and values"),
        (TypeId::of::<TaskOption>(), K::TaskOptions, "option"),
    ]
}

/// An argument of a study.
#[derive(Clone, Debug)]
pub struct ArgumentAbout {
    /// Python's keyword.
    pub keyword: String,
    /// `--name` on the command line; None: the argument stands alone.
    pub long: Option<String>,
    pub kind: ArgumentKind,
    /// The kind in words.
    pub kind_name: &'static str,
    pub default: Option<String>,
    pub required: bool,
    /// Can it be given several times?
    pub repeated: bool,
    /// Are there arguments that cannot be given with it?
    pub excludes: bool,
    /// The allowed numbers, `[low, high]`, if the declaration has them.
    pub range: Option<String>,
    pub help: String,
}

/// A study as its declaration describes it.
#[derive(Clone, Debug)]
pub struct StudyAbout {
    pub name: &'static str,
    pub python: &'static str,
    /// One sentence.
    pub summary: String,
    /// The summary and all else, in paragraphs.
    pub text: String,
    pub examples: String,
    pub arguments: Vec<ArgumentAbout>,
}

impl StudyEntry {
    pub fn about(&self) -> StudyAbout {
        let command = self.command();
        let text = |styled: Option<&clap::builder::StyledStr>| styled.map(ToString::to_string).unwrap_or_default();
        let shown = command.get_arguments().filter(|argument| !argument.is_hide_set());
        let arguments = shown.map(|argument| self.argument(&command, argument)).collect();
        let summary = text(command.get_about());
        StudyAbout {
            name: self.name,
            python: self.python,
            text: command.get_long_about().map_or_else(|| summary.clone(), ToString::to_string),
            examples: text(command.get_after_help()),
            summary,
            arguments,
        }
    }

    fn argument(&self, command: &Command, argument: &Arg) -> ArgumentAbout {
        let id = argument.get_value_parser().type_id();
        let kinds = kinds();
        let (_, kind, kind_name) = kinds.iter().find(|(of, ..)| id == *of).unwrap_or(&kinds[4]);
        let default = argument.get_default_values().first().map(|value| value.to_string_lossy().into_owned());
        let others = command.get_arguments();
        let excluded =
            |other: &Arg| command.get_arg_conflicts_with(other).iter().any(|one| one.get_id() == argument.get_id());
        let excludes = !command.get_arg_conflicts_with(argument).is_empty() || others.into_iter().any(excluded);
        let help = argument.get_long_help().or(argument.get_help()).map(ToString::to_string).unwrap_or_default();
        ArgumentAbout {
            keyword: argument.get_id().to_string(),
            long: argument.get_long().map(|long| format!("--{long}")),
            kind: *kind,
            kind_name,
            default: default.filter(|_| argument.get_action().takes_values()),
            required: argument.is_required_set(),
            repeated: matches!(argument.get_action(), ArgAction::Append),
            excludes,
            range: self.range(argument),
            help: help.split_whitespace().collect::<Vec<_>>().join(" "),
        }
    }

    /// The range of an argument, as the refusal of a number outside it says it.
    fn range(&self, argument: &Arg) -> Option<String> {
        let whole = argument.get_value_parser().type_id() == TypeId::of::<usize>();
        let probe = vec![format!("--{}={}", argument.get_long()?, if whole { "-1" } else { "-1e999" })];
        let refused = self.parse_words(&probe).err()?.to_string();
        let (name, reason) = refused.split_once(": ")?;
        let range = reason.split_once(" is outside ")?.1;
        (name == argument.get_id().as_str()).then(|| range.to_owned())
    }
}
