//! `sandgait validate`

use sandgait::Result;
use sandgait::validate::{data, others, page::Scoreboard};
use std::path::PathBuf;

/// Compare the model with measurements, and print the errors of its predictions.
///
/// Without --data the references are: two wheels and three discs in dry sand, measured at Carnegie Mellon University;
/// legs in simulated grains; walks of independent programs; and robots in pinocchio and MuJoCo.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait validate
  sandgait validate --out scoreboard               (validation.md, its rows and figures)
  sandgait validate --data my_wheel --out scoreboard")]
pub struct ValidateArgs {
    /// Folder with a validation.toml and the files of rows that it names
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Folder for the page, its rows and its figures
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

impl ValidateArgs {
    pub fn run(self) -> Result<String> {
        let data = match &self.data {
            Some(folder) => data::folder(folder)?,
            None => data::own()?,
        };
        let board = Scoreboard::new(data)?;
        let others = if self.data.is_none() { others::text()? } else { String::new() };
        if let Some(folder) = &self.out {
            board.write(folder, &others)?;
        }
        Ok(format!("{}\n\n{}\n{others}", board.worst(), board.text()))
    }
}
