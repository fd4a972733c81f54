//! What a look at the data has found.

use crate::error::{Error, Result};
use serde::Serialize;
use std::path::Path;

/// How bad a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// Certainly wrong: nothing is diagnosed.
    Refuse,
    Warn,
    Note,
}

/// Where in the data a finding is.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct DataPlace {
    /// Name of the file.
    pub file: String,
    /// One column, or several with commas between them; None for the whole table.
    pub column: Option<String>,
    /// First and last row, as lines of the file; None for all rows.
    pub rows: Option<[u64; 2]>,
}

/// One finding.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    pub what: String,
    #[serde(rename = "where")]
    pub place: DataPlace,
    pub severity: Severity,
    pub remedy: String,
}

impl Finding {
    /// A finding in a column, of all rows.
    pub fn new(severity: Severity, column: &str, what: impl Into<String>, remedy: impl Into<String>) -> Self {
        let place = DataPlace { column: Some(column.into()), ..DataPlace::default() };
        Self { what: what.into(), place, severity, remedy: remedy.into() }
    }

    /// This finding in these rows.
    pub fn at(mut self, rows: [u64; 2]) -> Self {
        self.place.rows = Some(rows);
        self
    }

    /// Place, fact and remedy in one line.
    pub fn line(&self) -> String {
        let rows = match self.place.rows {
            Some([first, last]) if first == last => format!("row {first}, "),
            Some([first, last]) => format!("rows {first} to {last}, "),
            None => String::new(),
        };
        let column = self.place.column.as_ref().map_or(String::new(), |c| format!("column {c}: "));
        format!("{rows}{column}{}; {}", self.what, self.remedy)
    }
}

/// Most findings that an error names: our choice, so that it stays one readable line.
const SHOWN: usize = 3;

/// The findings of the file `path`, worst first; an error in one line if one of them is certain.
pub fn settled(path: &Path, mut findings: Vec<Finding>) -> Result<Vec<Finding>> {
    findings.sort_by_key(|f| f.severity);
    let mut refused: Vec<&Finding> = findings.iter().filter(|f| f.severity == Severity::Refuse).collect();
    // What one remedy mends is said once.
    let mut remedies = std::collections::HashSet::new();
    refused.retain(|f| remedies.insert(f.remedy.as_str()));
    if !refused.is_empty() {
        let lines: Vec<String> = refused.into_iter().take(SHOWN).map(Finding::line).collect();
        return Err(Error::file(path, lines.join(" · ")));
    }
    let name = path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into());
    findings.iter_mut().for_each(|f| f.place.file.clone_from(&name));
    Ok(findings)
}

/// Joins findings that say the same of several trials or runs. The rows are those of the first.
pub fn joined(each: Vec<Option<Finding>>) -> Vec<Finding> {
    let of = each.len();
    let mut all: Vec<(Finding, usize)> = Vec::new();
    for finding in each.into_iter().flatten() {
        let same = all.iter_mut().find(|(f, _)| f.remedy == finding.remedy && f.place.column == finding.place.column);
        match same {
            Some((_, count)) => *count += 1,
            None => all.push((finding, 1)),
        }
    }
    let told = |(mut finding, count): (Finding, usize)| {
        if count > 1 {
            finding.what += &format!(" (and so in {count} of {of})");
        }
        finding
    };
    all.into_iter().map(told).collect()
}
