//! `sandgait diagnose`

use sandgait::Result;
use sandgait::diagnose::check::finding::Severity;
use sandgait::diagnose::diagnose;
use sandgait::diagnose::experiment::Experiment;
use sandgait::progress::Silent;
use std::path::PathBuf;

/// Find where the simulation disagrees with measured data, name the cause, extend the model and measure the gain.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait diagnose forces.csv --experiment experiment.toml --out report")]
pub struct DiagnoseArgs {
    /// Measured data as CSV; `python -m sandgait.logs` converts Parquet, LeRobot data sets, MCAP and ROS bags
    data: PathBuf,
    /// Facts that the data file does not contain: medium, shapes, units (TOML)
    #[arg(long)]
    experiment: PathBuf,
    /// Directory for report.json, report.html, sand.toml and hardware.toml
    #[arg(long)]
    out: PathBuf,
}

impl DiagnoseArgs {
    /// Diagnoses and writes the report; bad input is an error and writes nothing.
    pub fn run(self) -> Result<String> {
        let diagnosis = diagnose(&self.data, &Experiment::load(&self.experiment)?, &Silent)?;
        diagnosis.write(&self.out)?;
        let report = &diagnosis.report;
        let warned = report.check.findings.iter().filter(|f| f.severity == Severity::Warn);
        warned.for_each(|finding| eprintln!("warning: {}: {}", self.data.display(), finding.line()));
        let split = report.split.as_ref().map(|split| format!("Measured against predicted forces: {}\n", split.said()));
        let page = self.out.join("report.html");
        Ok(format!("{}\n{}\n{}{}\n", report.headline, report.action, split.unwrap_or_default(), page.display()))
    }
}
