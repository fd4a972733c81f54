//! `reproduce`: figures and claims of Li, Zhang & Goldman 2012.

use super::declare::{Study, StudyWork};
use super::inputs::Inputs;
use super::result::{StudyColumn, StudyFile, StudyResult, StudyTable};
use crate::error::Result;
use crate::layout;
use crate::progress::Progress;
use sandgait_reproduce::{self as reproduce, Claim, ClaimVerdict, FIGURES};

/// Reproduce Li, Zhang & Goldman 2012: figures 2 to 5, and every claim with a number.
///
/// The table has each claim with the paper's value, ours, a verdict (reproduced, not_reproduced or no_data) and its reason. The
/// files are the figures as SVG, report.html and claims.json.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait reproduce --out paper
  sandgait reproduce --figure 4 --out paper")]
pub struct Reproduce {
    /// Make only this figure: 2, 3, 4 or 5
    #[arg(long, value_name = "N")]
    figure: Option<u8>,
}

impl Study for Reproduce {
    const NAME: &'static str = "reproduce";

    fn next(&self) -> Option<String> {
        Some("to see the figures: add --out FOLDER, and open FOLDER/report.html".into())
    }

    fn check(self, _inputs: &Inputs) -> Result<StudyWork> {
        let figures = self.figure.map_or(FIGURES.to_vec(), |figure| vec![figure]);
        match figures.iter().find(|figure| !FIGURES.contains(figure)) {
            Some(other) => Err(reproduce::unknown_figure(*other)),
            None => Ok(StudyWork::new(move |progress| result(&figures, progress))),
        }
    }
}

fn words(verdict: ClaimVerdict) -> &'static str {
    match verdict {
        ClaimVerdict::Reproduced => "reproduced",
        ClaimVerdict::NotReproduced => "not_reproduced",
        ClaimVerdict::NoData => "no_data",
    }
}

fn result(figures: &[u8], progress: &dyn Progress) -> Result<StudyResult> {
    let parts = reproduce::compute(figures, progress)?;
    let claims: Vec<&Claim> = parts.iter().flat_map(|part| &part.claims).collect();
    let rows = claims
        .iter()
        .map(|c| vec![c.id.clone(), words(c.verdict).replace('_', " "), c.seed_value.clone(), c.ours.clone()]);
    let head = ["claim", "verdict", "paper", "here"].map(str::to_owned).to_vec();
    let summary = layout::table(&std::iter::once(head).chain(rows).collect::<Vec<_>>());
    let column = |name: &str, of: fn(&Claim) -> String| StudyColumn::names(name, claims.iter().map(|c| of(c)));
    let columns = vec![
        column("id", |c| c.id.clone()),
        column("claim", |c| c.claim.clone()),
        column("seed_value", |c| c.seed_value.clone()),
        column("ours", |c| c.ours.clone()),
        column("verdict", |c| words(c.verdict).to_owned()),
        column("why", |c| c.why.clone()),
    ];
    let files = reproduce::files(&parts)?.into_iter().map(|(name, text)| StudyFile::new(name, text)).collect();
    Ok(StudyResult { summary, files, ..StudyResult::table(StudyTable::new("claims", columns)) })
}
