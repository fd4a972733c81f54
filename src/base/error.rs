//! The one error type: a wrong input of the user, or a failure of the machine.

use std::io;
use std::path::Path;

/// Every fallible function of the program returns this. `Display` writes one line that suits a terminal or a gRPC
/// status.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// A value that the named field does not accept; the caller can correct it.
    #[error("{field}: {reason}")]
    Invalid { field: String, reason: String },
    /// A name that does not exist.
    #[error("{what} {}", unknown_name(name, known))]
    Unknown { what: &'static str, name: String, known: Vec<String> },
    /// A name that has been replaced by another.
    #[error("{what} {name:?} has been replaced by {new:?}; see CHANGELOG")]
    Replaced { what: &'static str, name: String, new: String },
    /// A call that is not allowed in the present state (for example a step before any reset).
    #[error("{0}")]
    OutOfOrder(String),
    /// A limit of this server or machine was reached.
    #[error("{0}")]
    Exhausted(String),
    /// The caller stopped the work.
    #[error("{0}")]
    Cancelled(String),
    /// A file could not be read or written.
    #[error("{path}: {reason}")]
    File { path: String, reason: String },
    /// The machine cannot write: the disk is full, or the folder is read-only.
    #[error("{path}: {reason}")]
    Unwritten { path: String, reason: String },
    /// A server that cannot be reached, or that has lost the session.
    #[error("server {server}: {reason}")]
    Lost { server: String, reason: String },
    /// A defect of this program, such as a panic; the user cannot correct it.
    #[error("{0}; please report this as a bug")]
    Internal(String),
}

pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    pub fn invalid(field: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Invalid { field: shortened(field.into(), LONGEST_NAME), reason: shortened(reason.into(), LONGEST) }
    }

    pub fn unknown(what: &'static str, name: &str, known: &[&str]) -> Self {
        let known = known.iter().map(|known| (*known).to_owned()).collect();
        Self::Unknown { what, name: shortened(name.into(), LONGEST_NAME), known }
    }

    /// One line, even if `reason` quotes several lines of a file. The path may be any text that was given as one.
    pub fn file(path: &Path, reason: impl std::fmt::Display) -> Self {
        Self::File { path: shown(path), reason: one_line(reason) }
    }

    /// A file that could not be written. A path that can never be one is the user's error, and everything else the
    /// machine's.
    pub fn unwritten(path: &Path, error: &io::Error) -> Self {
        use io::ErrorKind::{AlreadyExists, InvalidFilename, InvalidInput, IsADirectory, NotADirectory, NotFound};
        match error.kind() {
            AlreadyExists | InvalidFilename | InvalidInput | IsADirectory | NotADirectory | NotFound => {
                Self::file(path, error)
            }
            _ => Self::Unwritten { path: shown(path), reason: one_line(error) },
        }
    }

    pub fn lost(server: &str, reason: impl Into<String>) -> Self {
        Self::Lost { server: shortened(server.into(), LONGEST_NAME), reason: shortened(reason.into(), LONGEST) }
    }

    /// The same error with `note` at its end.
    pub fn with_note(mut self, note: &str) -> Self {
        match &mut self {
            Self::Invalid { reason, .. }
            | Self::File { reason, .. }
            | Self::Unwritten { reason, .. }
            | Self::Lost { reason, .. }
            | Self::OutOfOrder(reason)
            | Self::Exhausted(reason)
            | Self::Cancelled(reason) => reason.push_str(note),
            Self::Unknown { .. } | Self::Replaced { .. } | Self::Internal(_) => {}
        }
        self
    }
}

fn shown(path: &Path) -> String {
    shortened(path.display().to_string().replace(['\n', '\r'], " "), LONGEST_NAME)
}

fn one_line(reason: impl std::fmt::Display) -> String {
    shortened(reason.to_string().replace(['\n', '\r'], " "), LONGEST)
}

/// What a message says of a name that does not exist: the known name that the user most likely meant, if one is
/// similar, and all known names.
pub fn unknown_name<S: AsRef<str>>(name: &str, known: &[S]) -> String {
    let meant = similar(name, known).map_or(String::new(), |meant| format!("did you mean {meant:?}? "));
    let known: Vec<&str> = known.iter().map(AsRef::as_ref).collect();
    format!("{name:?} is unknown; {meant}known: {}", known.join(", "))
}

/// A known name is similar from this Jaro similarity on: the value of clap, which makes the same suggestions for the
/// options of the command line.
const SIMILAR: f64 = 0.7;

/// The known name that is most similar to `name`. The case, `_` in place of `-`, and the namespace and version of a
/// task do not count.
pub fn similar<'a, S: AsRef<str>>(name: &str, known: &'a [S]) -> Option<&'a str> {
    let plain = |name: &str| {
        let name = name.rsplit_once('/').map_or(name, |(_, name)| name);
        let version = name.rsplit_once("-v").filter(|(_, version)| version.parse::<u32>().is_ok());
        version.map_or(name, |(name, _)| name).to_lowercase().replace('_', "-")
    };
    // Among the known names may be a description, such as "sessions that have not ended".
    let names = known.iter().map(AsRef::as_ref).filter(|known| !known.contains(' '));
    let scored = names.map(|known| (known, strsim::jaro(&plain(name), &plain(known))));
    // Of equals the first is taken.
    let best = scored.filter(|(_, score)| *score > SIMILAR).rev().max_by(|a, b| a.1.total_cmp(&b.1))?;
    Some(best.0)
}

/// Longest name and longest reason in a message [bytes]: our choice, because a message may quote a file that was given in
/// place of a name, and a gRPC status has at most 16 KiB.
const LONGEST_NAME: usize = 300;
const LONGEST: usize = 4000;

/// A whole message, cut off as its parts are.
pub fn bounded(message: String) -> String {
    shortened(message, LONGEST_NAME + LONGEST)
}

/// `text`, cut off after `most` bytes.
fn shortened(mut text: String, most: usize) -> String {
    if text.len() > most {
        text.truncate(text.floor_char_boundary(most));
        text.push('…');
    }
    text
}

/// Refuses a number that is not finite or lies outside `range`, naming the field and the range.
pub fn check_range(field: &str, value: f64, range: std::ops::RangeInclusive<f64>) -> Result<f64> {
    if value.is_finite() && range.contains(&value) {
        return Ok(value);
    }
    let (low, high) = (range.start(), range.end());
    Err(Error::invalid(field, format!("{} is outside [{}, {}]", short(value), short(*low), short(*high))))
}

/// Longest TOML text of a sand, of hardware or of a hexapod [bytes]: our choice; such files have some kilobytes. A text of keys
/// alone takes 160 times its length while it is read.
const LONGEST_TOML: usize = 64 << 10;

/// Refuses a TOML text that is too long to be read.
pub fn check_toml(field: &str, text: &str) -> Result<()> {
    match text.len() > LONGEST_TOML {
        true => Err(Error::invalid(field, format!("its text has {} bytes; {LONGEST_TOML} are read", text.len()))),
        false => Ok(()),
    }
}

/// A number in a message: `0.25`, and `1e308` instead of 309 digits.
pub fn short(value: f64) -> String {
    match value.abs() {
        size if size == 0.0 || (1e-6..1e15).contains(&size) => value.to_string(),
        _ => format!("{value:e}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_toml_is_not_read() {
        assert!(check_toml("sand", &" ".repeat(LONGEST_TOML)).is_ok());
        let refused = check_toml("sand", &" ".repeat(LONGEST_TOML + 1)).unwrap_err().to_string();
        assert_eq!(refused, "sand: its text has 65537 bytes; 65536 are read");
    }

    #[test]
    fn an_unknown_name_has_a_suggestion() {
        let options = ["leg", "medium", "slope_deg", "torque_limit", "max_episode_steps"];
        let tasks = ["sandgait/HexapodGait-v1", "sandgait/HexapodLegs-v1", "sandgait/LeggedVelocity-v1"];
        let media = ["poppy-loose", "poppy-close", "glass-3mm-loose"];
        for (name, known, meant) in [
            ("mediun", &options[..], Some("medium")),
            ("slope", &options[..], Some("slope_deg")),
            ("torque-limit", &options[..], Some("torque_limit")),
            ("episode_steps", &options[..], Some("max_episode_steps")),
            ("HexapodGate", &tasks[..], Some("sandgait/HexapodGait-v1")),
            ("leggedvelocity", &tasks[..], Some("sandgait/LeggedVelocity-v1")),
            ("sandgait/HexapodLeg-v1", &tasks[..], Some("sandgait/HexapodLegs-v1")),
            ("Poppy_Loose", &media[..], Some("poppy-loose")),
            ("popy-close", &media[..], Some("poppy-close")),
            ("xyz", &media[..], None),
            ("", &media[..], None),
            ("sessions", &["sessions that have not ended"][..], None),
        ] {
            assert_eq!(similar(name, known), meant, "{name}");
        }
        let said = Error::unknown("option", "mediun", &options[..2]).to_string();
        assert_eq!(said, r#"option "mediun" is unknown; did you mean "medium"? known: leg, medium"#);
        assert_eq!(Error::unknown("option", "xyz", &["leg"]).to_string(), r#"option "xyz" is unknown; known: leg"#);
    }
}
