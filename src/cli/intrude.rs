//! `sandgait intrude`

use sandgait::sand::LegShape;
use sandgait::sand::intruder::with_friction;
use sandgait::sand::intrusion::{CHORD, HIP_HEIGHT, Load, OMEGA, Rotation, WIDTH};
use sandgait::{Error, Result};
use std::path::PathBuf;

/// Compute the forces of sand on a rotating leg, or on any body that moves with constant velocity.
///
/// With --shape a leg rotates about a hip that is fixed above the sand, as on a robot arm. Writes columns theta [rad],
/// Fx, Fz [N] and Ty [N·m] about the hip. At θ = 0 the tip is straight down, at positive θ it is forward (+x). Forces
/// are those on the leg.
///
/// With --body a body moves with constant velocity. Each row of --trials is one motion: vx, vy, vz [m/s], wx, wy, wz
/// [rad/s] (x heading, y axle, z up; 0 if absent), and either depth [m] of the body's lowest point or load [N] that the
/// sand carries. Writes the rows with Fx, Fy, Fz, Tx, Ty, Tz, depth and status. The status is ok, or no_equilibrium if
/// the sand cannot carry the load. If a body that is not round turns, forces are means over a turn.
///
/// With --memory the sand remembers: rows with the same `trial` are one path in time, from level sand on. Each row has
/// a time t [s]. x and y [m] are the place of the body's origin; without them the body moves on with the velocities of
/// the row above. Depths are below the undisturbed surface.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait intrude --shape L --csv L.csv
  sandgait intrude --shape xi=-30 --medium quikrete-fine --csv reversed.csv
  sandgait intrude --shape C                            (a summary only)
  sandgait intrude --body cylinder:radius=0.0625,width=0.06 --trials rows.csv --sand sand.toml --csv forces.csv
  sandgait intrude --body box:length=0.1,width=0.05,height=0.02 --trials rows.csv --law agarwal2023 --csv forces.csv
  sandgait intrude --body sphere:radius=0.02 --trials steps.csv --memory --csv forces.csv --surface heights.csv")]
pub struct IntrudeArgs {
    /// Shape of the leg: L, revL, C, revC, flat or xi=DEGREES
    #[arg(long, allow_hyphen_values = true, required_unless_present = "body", conflicts_with_all = ["body", "trials", "mu_s", "plate_size", "memory", "repose_deg", "cell", "surface"])]
    shape: Option<String>,
    /// Body: cylinder:radius=M,width=M (axle along y), box:length=M,width=M,height=M, sphere:radius=M, FILE.stl or
    /// FILE.obj [metres]
    #[arg(long, requires = "trials", conflicts_with_all = ["chord", "width", "hip_height", "omega"])]
    body: Option<String>,
    /// CSV file with the motions of the body
    #[arg(long, value_name = "FILE", requires = "body")]
    trials: Option<PathBuf>,
    /// Friction coefficient μ_s of the body's surface, instead of the sand's friction_clip
    #[arg(long, value_name = "MU", allow_negative_numbers = true, requires = "body")]
    mu_s: Option<f64>,
    /// Size of the plates into which the surface is cut [m]; default: a fiftieth of the body's longest side
    #[arg(long, value_name = "METRES", allow_negative_numbers = true, requires = "body")]
    plate_size: Option<f64>,
    /// Sand that was moved stays moved: paths in time, with heaps, furrows and prints (docs/memory.md)
    #[arg(long, requires = "trials")]
    memory: bool,
    /// Angle of repose of the sand [°]; default: 25 for glass beads, 28 for other media
    #[arg(long, value_name = "DEG", requires = "memory")]
    repose_deg: Option<f64>,
    /// Side of a cell of the surface [m]; default: a tenth of the body's longest horizontal side
    #[arg(long, value_name = "METRES", requires = "memory")]
    cell: Option<f64>,
    /// CSV file for the surface after each trial: trial, x, y and height of the cells that were moved
    #[arg(long, value_name = "FILE", requires = "memory")]
    surface: Option<PathBuf>,
    /// Distance from hip to tip [m]
    #[arg(long, value_name = "METRES", default_value_t = CHORD, allow_negative_numbers = true)]
    chord: f64,
    /// Width of the leg [m]
    #[arg(long, value_name = "METRES", default_value_t = WIDTH, allow_negative_numbers = true)]
    width: f64,
    /// Height of the hip above the surface [m]
    #[arg(long, value_name = "METRES", default_value_t = HIP_HEIGHT, allow_negative_numbers = true)]
    hip_height: f64,
    /// Angular speed of the leg [rad/s]; with a negative one the tip moves backward
    #[arg(long, value_name = "RAD/S", default_value_t = OMEGA, allow_negative_numbers = true)]
    omega: f64,
    #[command(flatten)]
    sand: super::SandArgs,
    /// CSV file for the forces
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
}

impl IntrudeArgs {
    pub fn run(self) -> Result<String> {
        let (Some(shape), None) = (&self.shape, &self.body) else { return self.run_trials() };
        let (name, shape) = (shape, LegShape::named(shape)?);
        let Self { chord, width, hip_height, omega, .. } = self;
        let sand = self.sand.sand()?;
        let loads = Rotation { shape, chord, width, hip_height, omega }.loads(&sand)?;
        if let Some(path) = &self.csv {
            let rows = loads.iter().map(|(theta, l)| format!("{theta:.2},{:.6},{:.6},{:.8}\n", l.fx, l.fz, l.ty));
            let text: String = std::iter::once("theta,Fx,Fz,Ty\n".to_owned()).chain(rows).collect();
            std::fs::write(path, text).map_err(|e| Error::unwritten(path, &e))?;
        }
        let largest = |name: &str, unit: &str, of: fn(&Load) -> f64| {
            let at = loads.iter().max_by(|a, b| of(&a.1).abs().total_cmp(&of(&b.1).abs()));
            at.map_or_else(String::new, |(t, l)| format!("{name} {:.3} {unit} at {:.0}°", of(l), t.to_degrees()))
        };
        let peaks = [largest("Fx", "N", |l| l.fx), largest("Fz", "N", |l| l.fz), largest("Ty", "N·m", |l| l.ty)];
        Ok(format!("{name} in {}: largest {}\n", sand.name, peaks.join(", ")))
    }

    fn run_trials(self) -> Result<String> {
        let (Some(body), Some(trials)) = (&self.body, &self.trials) else {
            return Err(Error::invalid("intrude", "give --shape, or --body with --trials"));
        };
        let mut sand = self.sand.sand()?;
        if let Some(mu) = self.mu_s {
            sand = with_friction(&sand, mu)?;
        }
        let (repose_deg, cell, surface) = (self.repose_deg, self.cell, self.surface.as_deref());
        let memory = self.memory.then_some(super::trials::Memory { repose_deg, cell, surface });
        super::trials::run(body, self.plate_size, &sand, trials, self.csv.as_deref(), memory.as_ref())
    }
}
