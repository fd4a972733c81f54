//! `sandgait calibrate`

use sandgait::calibrate::{self, Calibration};
use sandgait::plot::png;
use sandgait::table::{self, Asked, Column, Quantity};
use sandgait::{Error, Result};
use std::path::PathBuf;

/// The plate of Li et al. 2012, section 2: 3.8 × 2.5 cm [m²].
const PLATE: f64 = 0.038 * 0.025;

/// Beyond ±1e6 m or N a test is in the wrong unit or broken: our choice, as for force logs.
const MOST: f64 = 1e6;

const COLUMNS: [Column; 2] = [Column::needed("depth", Quantity::Length), Column::needed("force", Quantity::Force)];

/// Measure your sand: its scale from one slow vertical penetration of a horizontal plate.
///
/// Reads columns depth (downward from the surface) and force (upward on the plate) of the way down, below 0.5 m/s; units
/// stand in the header, as in "depth [mm],force [N]", or in the options, else m and N. Prints ζ, for --medium zeta=VALUE
/// anywhere, and ξ_n of agarwal2023, with 95 % confidence intervals.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait calibrate push.csv --area 0.00095
  sandgait calibrate push.csv --depth-unit mm --plot push.svg      (also push.png)")]
pub struct Calibrate {
    /// CSV with columns depth and force
    data: PathBuf,
    /// Area of the plate [m²]; default: 3.8 × 2.5 cm, the plate of Li et al. 2012
    #[arg(long, value_name = "M2", allow_negative_numbers = true)]
    area: Option<f64>,
    /// m, cm, mm or in
    #[arg(long)]
    depth_unit: Option<String>,
    /// N, mN, kN, gf, kgf or lbf
    #[arg(long)]
    force_unit: Option<String>,
    /// Draw the test and its line to this SVG file, and as PNG beside it
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// Machine-readable
    #[arg(long)]
    json: bool,
}

impl Calibrate {
    pub fn run(self) -> Result<String> {
        let units = [("depth", self.depth_unit), ("force", self.force_unit)];
        let units = units.into_iter().filter_map(|(name, unit)| Some((name.to_owned(), unit?)));
        let asked = Asked { units: units.collect(), ..Asked::new(&COLUMNS) };
        let (mut depth, mut force) = (Vec::new(), Vec::new());
        table::read(&self.data, &asked, |row| {
            depth.push(row.within(0, MOST)?.ok_or_else(|| row.blank(0))?);
            force.push(row.within(1, MOST)?.ok_or_else(|| row.blank(1))?);
            Ok(())
        })?;
        if self.plot.as_ref().is_some_and(|p| p.extension().is_none_or(|e| e != "svg")) {
            return Err(Error::invalid("--plot", "give a file name that ends in .svg"));
        }
        let result = calibrate::calibrate(&depth, &force, self.area.unwrap_or(PLATE))?;
        if let Some(path) = &self.plot {
            png::write_both(&calibrate::figure(&depth, &force, &result).svg(), path)?;
        }
        for caution in &result.cautions {
            eprintln!("sandgait: warning: {caution}");
        }
        Ok(match self.json {
            true => super::json(&serde_json::to_value(&result).unwrap_or_default()),
            false => describe(&result, self.area.is_none()),
        })
    }
}

fn describe(c: &Calibration, assumed: bool) -> String {
    let line = |name: &str, value: f64, [low, high]: [f64; 2]| {
        format!("{name} {value:.4} N/cm³, 95 % confidence {low:.4} to {high:.4}\n")
    };
    let plate = if assumed { " (the plate of Li et al. 2012; give --area if yours differs)" } else { "" };
    format!(
        "{}{}{} samples, r² {:.3}, plate {:.2} cm²{plate}\nuse it as --medium zeta={:.4}\n",
        line("ζ  ", c.zeta, c.zeta_interval),
        line("ξ_n", c.xi_n, c.xi_n_interval),
        c.samples,
        c.r_squared,
        c.area * 1e4,
        c.zeta,
    )
}
