//! `sandgait validate`

use sandgait::Result;
use sandgait::validate::{data, others, page::Scoreboard};
use std::path::PathBuf;

/// Compare the model with measurements: predictions, their errors, and where they fail.
///
/// Without --data: two wheels and three discs in dry sand, measured at Carnegie Mellon University; legs in grains
/// simulated one by one; walks by independent codes, and robots by pinocchio and MuJoCo.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait validate
  sandgait validate --out scoreboard               (validation.md, its rows and figures)
  sandgait validate --data my_wheel --out scoreboard")]
pub struct Validate {
    /// Folder with a validation.toml and its rows
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Folder to write the page, its rows and figures to
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

impl Validate {
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
