//! Types of arguments. The type of a field tells the function in Python what it may be given.

use super::inputs::Inputs;
use crate::error::{Error, Result};
use crate::sand::{Law, Medium, SandDescription};
use crate::sim::Robot;
use std::ops::RangeInclusive;
use std::path::Path;
use std::str::FromStr;

/// Types of arguments that are texts on the command line.
macro_rules! texts {
    ($($(#[$about:meta])* $name:ident),* $(,)?) => {
        $(
            $(#[$about])*
            #[derive(Clone, Debug, PartialEq, Eq)]
            pub struct $name(pub String);

            impl From<String> for $name {
                fn from(text: String) -> Self {
                    Self(text)
                }
            }
        )*
    };
}

texts! {
    /// A path of a file that the study reads.
    InputPath,
    /// A path of a folder whose files the study reads.
    FolderPath,
    /// A name, or a path of a file that the study reads.
    NameOrPath,
    /// A path of a table that the study reads, or the name of one in memory.
    TableData,
    /// A path of measured data; in Python also a frame or a recording.
    DataPath,
    /// A path of a TOML file; in Python also its tables.
    TomlPath,
    /// A path of a file that the caller writes.
    OutputPath,
    /// `NAME=VALUE`; in Python a dictionary.
    Setting,
    /// `NAME=VALUE`, an option of a task; in Python a keyword.
    TaskOption,
}

/// Numbers: `1,2,3` or `[1, 2, 3]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Numbers(pub Vec<f64>);

impl FromStr for Numbers {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let number = |cell: &str| cell.parse().map_err(|_| Error::invalid("number", format!("{cell:?} is no number")));
        match inside(text).unwrap_or(text) {
            none if none.trim().is_empty() && inside(text).is_some() => Ok(Self::default()),
            list => list.split(',').map(|cell| number(cell.trim())).collect::<Result<_>>().map(Self),
        }
    }
}

/// Names: `a,b,c` or `["a", "b", "c"]`; names with commas need the second form.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct NameList(pub Vec<String>);

impl FromStr for NameList {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        cells(text).map(Self)
    }
}

/// What is between the brackets of a list.
fn inside(text: &str) -> Option<&str> {
    text.trim().strip_prefix('[').and_then(|rest| rest.strip_suffix(']'))
}

/// The cells of a list. Numbers stay texts, because a reader of JSON may round them.
pub fn cells(text: &str) -> Result<Vec<String>> {
    match inside(text) {
        Some(inside) if inside.trim().is_empty() => Ok(Vec::new()),
        Some(inside) if inside.contains('"') => {
            serde_json::from_str(text).map_err(|e| Error::invalid("list", format!("not a list of texts: {e}")))
        }
        inside => Ok(inside.unwrap_or(text).split(',').map(|cell| cell.trim().to_owned()).collect()),
    }
}

/// A parser of whole numbers in `range`. Its refusals name the range.
pub fn whole<T: TryFrom<u64>>(
    range: RangeInclusive<u64>,
) -> impl Fn(&str) -> std::result::Result<T, String> + Clone + Send + Sync {
    move |text| {
        let number: i128 = text.parse().map_err(|_| "no whole number".to_owned())?;
        let within = u64::try_from(number).ok().filter(|n| range.contains(n)).and_then(|n| T::try_from(n).ok());
        within.ok_or_else(|| format!("{number} is outside [{}, {}]", range.start(), range.end()))
    }
}

/// A parser of numbers in `range`. Its refusals name the range.
pub fn within(range: RangeInclusive<f64>) -> impl Fn(&str) -> std::result::Result<f64, String> + Clone + Send + Sync {
    move |text| {
        let number: f64 = text.parse().map_err(|_| "no number".to_owned())?;
        let inside = range.contains(&number).then_some(number);
        inside.ok_or_else(|| format!("{number} is outside [{}, {}]", range.start(), range.end()))
    }
}

/// The sand of a study.
#[derive(clap::Args)]
pub struct SandArgs {
    /// Sand: a name from `sandgait media`, zeta=VALUE or mu=VALUE,rho=VALUE
    #[arg(long, default_value = Medium::DEFAULT)]
    pub medium: String,
    /// Resistive force law: li2013, penetration-drag-1d or agarwal2023
    #[arg(long, default_value = Law::Li2013.name())]
    pub law: String,
    /// A sand.toml, for example from a diagnosis, instead of --medium and --law
    #[arg(long, value_name = "FILE", conflicts_with_all = ["medium", "law"])]
    pub sand: Option<InputPath>,
}

/// Sand, and lines for its user.
pub type CheckedSand = (SandDescription, Vec<String>);

impl SandArgs {
    pub fn read(&self, inputs: &mut Inputs) -> Result<()> {
        self.sand.iter().try_for_each(|file| inputs.read(&file.0))
    }

    /// The sand of the file, or of medium and law by their names. A line says if its numbers are extrapolated.
    pub fn sand(&self, inputs: &Inputs) -> Result<CheckedSand> {
        match &self.sand {
            Some(InputPath(file)) => {
                let sand = SandDescription::from_toml(inputs.text(file)?);
                Ok((sand.map_err(|e| Error::file(Path::new(file), e))?, Vec::new()))
            }
            None => {
                let sand = SandDescription::named(&self.medium, &self.law)?;
                Ok((sand, Medium::caution(&self.medium).into_iter().collect()))
            }
        }
    }

    /// Like [`Self::sand`], for walking robots: a line also names the mechanisms that have no effect on them.
    pub fn to_walk_on(&self, inputs: &Inputs) -> Result<CheckedSand> {
        let (sand, mut lines) = self.sand(inputs)?;
        lines.extend(unfelt(&sand));
        Ok((sand, lines))
    }
}

/// A line that names the mechanisms of `sand` without effect on a walking robot.
pub fn unfelt(sand: &SandDescription) -> Option<String> {
    let lines = sand.mechanisms.unfelt_by_walkers();
    let lines: Vec<String> = lines.iter().map(|line| format!("sand {}: {line}", sand.name)).collect();
    (!lines.is_empty()).then(|| lines.join("; "))
}

impl NameOrPath {
    /// Reads the file, if it has one of these endings and so is no name.
    pub fn read(&self, endings: &[&str], inputs: &mut Inputs) -> Result<()> {
        let ending = Path::new(&self.0).extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
        match ending.is_some_and(|ending| endings.contains(&&ending[..])) {
            true => inputs.read(&self.0),
            false => Ok(()),
        }
    }

    /// A built-in hexapod, or that of a robot's TOML file.
    pub fn robot(&self, inputs: &Inputs) -> Result<Robot> {
        if self.0.ends_with(".toml") {
            return Robot::from_toml(inputs.text(&self.0)?).map_err(|e| Error::file(Path::new(&self.0), e));
        }
        match Robot::names().contains(&&self.0[..]) {
            true => Robot::built_in(&self.0),
            false => Err(Robot::unknown(&self.0)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_words_or_json() {
        let numbers = |text: &str| text.parse::<Numbers>().map(|n| n.0);
        assert_eq!(numbers("1, -2.5,1e-3").unwrap(), [1.0, -2.5, 1e-3]);
        assert_eq!(numbers("[0.1, 2]").unwrap(), [0.1, 2.0]);
        assert!(numbers("[]").unwrap().is_empty());
        assert!(numbers("nan").unwrap()[0].is_nan());
        assert_eq!(numbers("1,x").unwrap_err().to_string(), "number: \"x\" is no number");
        // The bits of a number survive the way as a text.
        let x = 0.1 + 0.2 * 1e-16 + 1.0 / 3.0;
        assert_eq!(numbers(&format!("[{x}]")).unwrap(), [x]);
        let names = |text: &str| text.parse::<NameList>().unwrap().0;
        assert_eq!(names("a,b"), ["a", "b"]);
        assert_eq!(names(r#"["mu=0.5,rho=1500", "b"]"#), ["mu=0.5,rho=1500", "b"]);
    }
}
