//! `sandgait reproduce`

use sandgait::Result;
use sandgait::reproduce::{self, ClaimVerdict, FIGURES};
use std::path::PathBuf;

/// Reproduce Li, Zhang & Goldman 2012: figures 2 to 5, and every claim with a number.
///
/// Writes the figures as SVG, report.html and claims.json. These files have each claim with the paper's value,
/// ours, a verdict (reproduced, not_reproduced or no_data) and its reason.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait reproduce --out paper
  sandgait reproduce --figure 4 --out paper")]
pub struct ReproduceArgs {
    /// Make only this figure: 2, 3, 4 or 5
    #[arg(long, value_name = "N")]
    figure: Option<u8>,
    /// Directory for the results
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

impl ReproduceArgs {
    pub fn run(self) -> Result<String> {
        let start = std::time::Instant::now();
        let figures = self.figure.map_or(FIGURES.to_vec(), |f| vec![f]);
        let parts = reproduce::compute(&figures)?;
        reproduce::write(&parts, &self.out)?;
        let claims: Vec<_> = parts.iter().flat_map(|p| &p.claims).collect();
        let rows = claims.iter().map(|c| {
            let verdict = match c.verdict {
                ClaimVerdict::Reproduced => "reproduced",
                ClaimVerdict::NotReproduced => "not reproduced",
                ClaimVerdict::NoData => "no data",
            };
            vec![c.id.clone(), verdict.to_owned(), c.seed_value.clone(), c.ours.clone()]
        });
        let head = ["claim", "verdict", "paper", "here"].map(str::to_owned).to_vec();
        let table = super::table(&std::iter::once(head).chain(rows).collect::<Vec<_>>());
        let seconds = start.elapsed().as_secs_f64();
        Ok(format!("{table}\n{seconds:.1} s → {}\n", self.out.join("report.html").display()))
    }
}
