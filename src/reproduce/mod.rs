//! Compares our models with a paper: Li, Zhang & Goldman 2012, "A resistive force model for legged locomotion on
//! granular media", its figures 2 to 5 and every quantitative sentence of its sections 2 to 6.
//!
//! Each part computes its figures and its [`Claim`]s from the unchanged models; nothing here is fitted to the paper.
//!
//! * [`stresses`]: figure 2.
//! * [`legs`]: figure 3.
//! * [`grains`]: data from a simulated experiment, in place of figure 3's measured curves.
//! * [`speeds`]: figure 4.
//! * [`shapes`]: figure 5.
//! * [`assumptions`]: values that the paper does not state.
//! * [`claims`]: the verdict on each claim.
//! * [`page`]: the report.

use sandgait_base::{error, progress};
use sandgait_number as number;
use sandgait_plot as plot;
use sandgait_sand as sand;
use sandgait_sim as sim;
use sandgait_sweep as sweep;
use sandgait_table as table;

pub mod assumptions;
pub mod claims;
mod conclusions;
mod grains;
mod legs;
pub mod page;
mod shapes;
mod speeds;
mod stresses;

pub use claims::{Claim, ClaimVerdict};

use crate::error::{Error, Result};
use crate::plot::Figure;
use crate::progress::Progress;

/// Our version of one figure of the paper, with its claims.
pub struct FigureSection {
    pub heading: &'static str,
    /// File stem and figure.
    pub figures: Vec<(&'static str, Figure)>,
    pub tables: Vec<ReportTable>,
    pub claims: Vec<Claim>,
}

/// A table of the report.
pub struct ReportTable {
    pub caption: String,
    pub head: Vec<String>,
    pub rows: Vec<Vec<String>>,
}

impl ReportTable {
    fn new(caption: &str, head: &[&str]) -> Self {
        Self { caption: caption.into(), head: head.iter().map(|h| (*h).to_owned()).collect(), rows: Vec::new() }
    }
}

/// Figures of the paper that are reproduced.
pub const FIGURES: [u8; 4] = [2, 3, 4, 5];

/// Computes the parts for the given figures; with all four, also the claims of the conclusions. An error of `progress` stops
/// the work before the next figure.
pub fn compute(figures: &[u8], progress: &dyn Progress) -> Result<Vec<FigureSection>> {
    let mut parts = Vec::new();
    for (done, figure) in figures.iter().enumerate() {
        progress.report(done as f64 / figures.len() as f64, &format!("figure {figure}"))?;
        parts.push(match figure {
            2 => stresses::part()?,
            3 => legs::part(grains::part()?)?,
            4 => speeds::part()?,
            5 => shapes::part()?,
            other => return Err(unknown_figure(*other)),
        });
    }
    if figures.len() == FIGURES.len() {
        parts.push(conclusions::part());
    }
    Ok(parts)
}

/// The error for a figure that is not reproduced.
pub fn unknown_figure(figure: u8) -> Error {
    Error::invalid("figure", format!("{figure} is not one of 2, 3, 4, 5"))
}

/// Laws compared with legs rotated through grains that were simulated one by one.
pub fn grains() -> Result<ReportTable> {
    Ok(grains::part()?.table)
}

/// Figures, `report.html` and `claims.json`: names and texts.
pub fn files(parts: &[FigureSection]) -> Result<Vec<(String, String)>> {
    let claims: Vec<&Claim> = parts.iter().flat_map(|p| &p.claims).collect();
    let json = serde_json::to_string_pretty(&claims).map_err(|e| Error::Exhausted(e.to_string()))?;
    let figures = parts.iter().flat_map(|p| &p.figures).map(|(name, figure)| (format!("{name}.svg"), figure.svg()));
    let texts = [("claims.json".to_owned(), json + "\n"), ("report.html".to_owned(), page::page(parts))];
    Ok(figures.chain(texts).collect())
}
