//! `sandgait certify`, which is written in Python, because it drives a robot in MuJoCo. The command that pip installs
//! runs it; this one says how to get it.

use sandgait::{Error, Result};

/// Drive a robot by its policy in MuJoCo, on sand and on hard ground, and say whether it may leave the simulator.
///
/// Needs the Python package: pip install 'sandgait[deploy]'. docs/deploy.md explains the sheet.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait certify runs/go1 --robot go1.xml
  sandgait certify runs/go1 --robot go1.xml --quick --out runs/go1/certificate.html")]
pub struct CertifyArgs {
    /// The folder of a policy and the options of `python -m sandgait.certify --help`
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<String>,
}

impl CertifyArgs {
    /// Always an error: this program has no Python.
    pub fn run(self) -> Result<String> {
        let reason = "is written in Python: pip install 'sandgait[deploy]', then run";
        let rest = self.arguments.join(" ");
        Err(Error::invalid("certify", format!("{reason} python -m sandgait.certify {rest}").trim_end()))
    }
}
