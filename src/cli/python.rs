//! `sandgait certify` and `sandgait adapt`, which are written in Python, because they drive a robot in MuJoCo. The
//! command that pip installs runs them; this one says how to get them.

use sandgait::{Error, Result};

/// Drive a robot by its policy in MuJoCo, on sand and on hard ground, and say whether it may leave the simulator.
///
/// Needs the Python package: pip install 'sandgait[deploy]'. docs/certify.md explains the sheet.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait certify runs/go1 --robot go1.xml
  sandgait certify runs/go1 --robot go1.xml --quick --out certificate.html")]
pub struct CertifyArgs {
    /// The folder of a policy and the options of `python -m sandgait.certify --help`
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<String>,
}

/// Train a policy on over what the log of its robot says of sand and motors, if the log can tell.
///
/// Needs the Python package: pip install sandgait. docs/certify.md explains the page.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait adapt walk.csv --policy runs/go1 --robot go1.xml --out runs/go1-adapted")]
pub struct AdaptArgs {
    /// A robot's log and the options of `python -m sandgait.adapt --help`
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<String>,
}

impl CertifyArgs {
    /// Always an error: this program has no Python.
    pub fn run(self) -> Result<String> {
        Err(elsewhere("certify", "sandgait[deploy]", &self.arguments))
    }
}

impl AdaptArgs {
    /// Always an error: this program has no Python.
    pub fn run(self) -> Result<String> {
        Err(elsewhere("adapt", "sandgait", &self.arguments))
    }
}

fn elsewhere(command: &str, package: &str, arguments: &[String]) -> Error {
    let call = format!("python -m sandgait.{command} {}", arguments.join(" "));
    Error::invalid(command, format!("is written in Python: pip install '{package}', then run {}", call.trim_end()))
}
