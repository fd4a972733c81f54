//! `sandgait stress`

use sandgait::number::Vec3;
use sandgait::sand::law::agarwal2023;
use sandgait::sand::{Law, Medium, Regularization, SandBed};
use sandgait::table::{self, HeaderColumn, Quantity, ReadOptions};
use sandgait::{Error, Result};
use std::path::PathBuf;

const COLUMNS: [HeaderColumn; 3] = [
    HeaderColumn::needed("beta", Quantity::Angle),
    HeaderColumn::needed("gamma", Quantity::Angle),
    HeaderColumn::needed("psi", Quantity::Angle),
];

/// Evaluate a force law: prints the stress per depth at given angles.
///
/// The input has columns beta (tilt of the plate, modulo π), gamma (direction of its velocity below the horizontal)
/// and, for agarwal2023, psi (azimuth of its normal from that of the velocity), in rad. Prints these columns and the
/// stress per depth in N/m³: alpha_x against the motion and alpha_z up. For agarwal2023 the components are alpha_r
/// along the motion, alpha_theta across it and alpha_z up. The laws are evaluated without the regularisation that the
/// dynamics need.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait stress --input angles.csv
  sandgait stress --law agarwal2023 --medium glass-beads --input angles.csv
  sandgait stress --law agarwal2023 --medium mu=0.5,rho=1500 --friction 0.36 --input angles.csv")]
pub struct StressArgs {
    /// Resistive force law: li2013, penetration-drag-1d or agarwal2023
    #[arg(long, default_value = "li2013")]
    law: String,
    /// Sand: a name from `sandgait media`, zeta=VALUE or mu=VALUE,rho=VALUE
    #[arg(long, default_value = "poppy-loose")]
    medium: String,
    /// CSV file with columns beta, gamma and, if needed, psi [rad]
    #[arg(long, value_name = "FILE")]
    input: PathBuf,
    /// Friction coefficient of the plate's surface (agarwal2023 only): a normal stress that would pull is reversed, and
    /// the tangential stress is limited
    #[arg(long, value_name = "MU", allow_negative_numbers = true)]
    friction: Option<f64>,
}

impl StressArgs {
    pub fn run(self) -> Result<String> {
        let sand = super::named_sand(&self.medium, &self.law)?;
        let (law, medium) = (sand.law, sand.medium());
        if let Some(mu) = self.friction {
            sandgait::error::check_range("--friction", mu, 0.0..=10.0)?;
            if law != Law::Agarwal2023 {
                return Err(Error::invalid("--friction", format!("{} has no friction cap", law.name())));
            }
        }
        let (names, columns): (&[&str], _) = match law {
            Law::Agarwal2023 => (&["alpha_r", "alpha_theta", "alpha_z"], &COLUMNS[..]),
            Law::Li2013 | Law::PenetrationDrag1d => (&["alpha_x", "alpha_z"], &COLUMNS[..2]),
        };
        let mut text = String::new();
        let summary = table::read(&self.input, &ReadOptions::new(columns), |row| {
            let mut angles = [0.0; 3];
            for (k, angle) in angles.iter_mut().enumerate().take(columns.len()) {
                *angle = row.needed(k)?;
            }
            let stress = stress(law, &medium, self.friction, angles).into_iter().map(|s| format!("{s:.6}"));
            let cells: Vec<_> = row.cells().map(str::to_owned).chain(stress).collect();
            text.push_str(&format!("{}\n", cells.join(",")));
            Ok(())
        })?;
        text.insert_str(0, &format!("{},{}\n", summary.header.join(","), names.join(",")));
        Ok(text)
    }
}

/// Components at (β, γ, ψ) [N/m³].
fn stress(law: Law, medium: &Medium, friction: Option<f64>, [beta, gamma, psi]: [f64; 3]) -> Vec<f64> {
    if law == Law::Agarwal2023 {
        let components = match friction {
            None => agarwal2023::components(beta, gamma, psi),
            Some(mu) => agarwal2023::components_on_surface(beta, gamma, psi, mu),
        };
        return components.map(|c| c * agarwal2023::calibrated(&medium.coefficients)).to_vec();
    }
    let ground = SandBed::new(law, medium, &Regularization::BARE);
    let motion = ground.motion(Vec3::new(gamma.cos(), 0.0, -gamma.sin()));
    let force = ground.stress(Vec3::new(beta.sin(), 0.0, -beta.cos()), &motion);
    vec![-force.x, force.z]
}
