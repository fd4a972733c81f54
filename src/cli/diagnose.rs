//! `sandgait diagnose`

use sandgait::Result;
use sandgait::diagnose;

/// Find where the simulation disagrees with measured data, name the cause, extend the model and measure the gain.
#[derive(clap::Args)]
#[command(after_help = "Example:
  sandgait diagnose forces.csv --experiment experiment.toml --out report")]
pub struct DiagnoseArgs {
    #[command(flatten)]
    arguments: diagnose::cli::Arguments,
}

impl DiagnoseArgs {
    pub fn run(self) -> Result<String> {
        let diagnosis = diagnose::run(&self.arguments)?;
        Ok(format!("{}\n", diagnosis.report.summary))
    }
}
