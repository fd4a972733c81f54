//! `sandgait intrude`

use sandgait::diagnose::experiment::Intruder;
use sandgait::diagnose::force_log::{Pose, Track};
use sandgait::diagnose::forward::ForceLogModel;
use sandgait::error::check_range;
use sandgait::sand::intrusion::{Load, rotating_leg};
use sandgait::sand::{Ground, Law, SandDescription, Shape, Surface};
use sandgait::{Error, Result};
use std::path::PathBuf;

/// Segments along the leg: fine enough that forces no longer change in the fourth digit.
const SEGMENTS: usize = 400;

/// θ from −1.75 to 1.75 rad in steps of 0.01.
const HALF_SWEEP: i32 = 175;

/// Rotate a leg about a hip fixed above sand and record force and torque, as on a robot arm.
///
/// Writes columns theta [rad], Fx, Fz [N] and Ty [N·m] about the hip: θ = 0 is straight down, positive θ brings the
/// tip forward (+x); forces act on the leg.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait intrude --shape L --csv L.csv
  sandgait intrude --shape xi=-30 --medium quikrete-fine --csv reversed.csv
  sandgait intrude --shape C                            (a summary only)")]
pub struct Intrude {
    /// Leg: L, revL, C, revC, flat or xi=DEGREES
    #[arg(long, allow_hyphen_values = true)]
    shape: String,
    /// Distance from hip to tip [m]
    #[arg(long, value_name = "METRES", default_value_t = 0.076)]
    chord: f64,
    /// Width of the leg [m]
    #[arg(long, value_name = "METRES", default_value_t = 0.025)]
    width: f64,
    /// Height of the hip above the surface [m]
    #[arg(long, value_name = "METRES", default_value_t = 0.02, allow_negative_numbers = true)]
    hip_height: f64,
    /// Angular speed [rad/s]; negative turns the tip backward
    #[arg(long, value_name = "RAD/S", default_value_t = 0.2, allow_negative_numbers = true)]
    omega: f64,
    /// Sand: a name from `sandgait media`, or zeta=VALUE
    #[arg(long, default_value = "poppy-loose")]
    medium: String,
    /// A sand.toml, as a diagnosis writes it, in place of --medium and --law: with all it says of sand, sensor and drive
    #[arg(long, value_name = "FILE", conflicts_with_all = ["medium", "law"])]
    sand: Option<PathBuf>,
    /// Resistive force law: li2013, penetration-drag-1d or agarwal2023
    #[arg(long, default_value = "li2013")]
    law: String,
    /// File to write the sweep to
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
}

impl Intrude {
    pub fn run(self) -> Result<String> {
        // Guards against slips of units: our choice.
        check_range("hip-height", self.hip_height, -1.0..=1.0)?;
        check_range("omega", self.omega, -100.0..=100.0)?;
        let angles: Vec<f64> = (-HALF_SWEEP..=HALF_SWEEP).map(|i| f64::from(i) * 0.01).collect();
        let loads = match &self.sand {
            Some(sand) => self.extended(&SandDescription::load(sand)?, &angles)?,
            None => self.by_law(&angles)?,
        };
        let sweep: Vec<(f64, Load)> = angles.into_iter().zip(loads).collect();
        if let Some(path) = &self.csv {
            let rows = sweep.iter().map(|(theta, l)| format!("{theta:.2},{:.6},{:.6},{:.8}\n", l.fx, l.fz, l.ty));
            let text: String = std::iter::once("theta,Fx,Fz,Ty\n".to_owned()).chain(rows).collect();
            std::fs::write(path, text).map_err(|e| Error::file(path, e))?;
        }
        let largest = |name: &str, unit: &str, of: fn(&Load) -> f64| {
            let at = sweep.iter().max_by(|a, b| of(&a.1).abs().total_cmp(&of(&b.1).abs()));
            at.map_or_else(String::new, |(t, l)| format!("{name} {:.3} {unit} at {:.0}°", of(l), t.to_degrees()))
        };
        let peaks = [largest("Fx", "N", |l| l.fx), largest("Fz", "N", |l| l.fz), largest("Ty", "N·m", |l| l.ty)];
        let sand = self.sand.as_ref().map_or_else(|| self.medium.clone(), |path| path.display().to_string());
        Ok(format!("{} in {sand}: largest {}\n", self.shape, peaks.join(", ")))
    }

    /// Loads by a bare law.
    fn by_law(&self, angles: &[f64]) -> Result<Vec<Load>> {
        let segments = Shape::named(&self.shape)?.segments(self.chord, self.width, SEGMENTS)?;
        let ground = Ground::new(Law::named(&self.law)?, &super::medium(&self.medium)?, &Surface::default());
        Ok(angles.iter().map(|&theta| rotating_leg(&ground, &segments, theta, self.omega, self.hip_height)).collect())
    }

    /// Loads as the diagnosis predicts them: the sweep as one trial of its forward model.
    fn extended(&self, sand: &SandDescription, angles: &[f64]) -> Result<Vec<Load>> {
        let Shape::TwoPiece { xi } = Shape::named(&self.shape)? else {
            return Err(Error::invalid("--shape", "--sand takes two-piece legs: L, revL, flat or xi=DEGREES"));
        };
        if sand.law != Law::Li2013 {
            return Err(Error::invalid(
                "--sand",
                format!("law {}; the extended model stands on li2013", sand.law.name()),
            ));
        }
        if self.omega == 0.0 {
            return Err(Error::invalid("omega", "0 moves no leg"));
        }
        let leg = Intruder::Leg { chord: self.chord, width: self.width, xi_deg: xi.to_degrees(), thickness: None };
        // Checks chord and width.
        Shape::named(&self.shape)?.segments(self.chord, self.width, SEGMENTS)?;
        let backward = self.omega < 0.0;
        let ordered: Vec<f64> = if backward { angles.iter().rev().copied().collect() } else { angles.to_vec() };
        let pose = |theta: &f64| {
            let t = (theta - ordered[0]) / self.omega;
            Pose { t, theta: *theta, omega: self.omega, ..Pose::default() }
        };
        let poses = ordered.iter().map(pose).collect();
        let mut loads = ForceLogModel::one(sand, Track::leg(leg, self.hip_height, poses))?;
        if backward {
            loads.reverse();
        }
        Ok(loads)
    }
}
