//! `intrude`: forces of sand on a rotating leg, and on bodies that move.

use super::arguments::{NameOrPath, OutputPath, SandArgs, TableData};
use super::declare::{Study, StudyWork};
use super::inputs::{Inputs, SENT_TABLE};
use super::result::{StudyColumn, StudyResult, StudyTable};
use super::trials::{self, SandMemory, Trials};
use crate::error::{Error, Result};
use crate::sand::intruder::{BodyShape, PlatedBody, with_friction};
use crate::sand::intrusion::{CHORD, HIP_HEIGHT, Load, OMEGA, Rotation, WIDTH};
use crate::sand::{LegShape, SandDescription};

/// Largest number of plates of a body that was sent: our choice, because so many take 300 MB. A default wheel has some 3,000.
const SENT_PLATES: usize = 50_000;

/// Compute the forces of sand on a rotating leg, or on any body that moves with constant velocity.
///
/// With --shape a leg rotates about a hip that is fixed above the sand, as on a robot arm. The table has columns theta [rad],
/// Fx, Fz [N] and Ty [N·m] about the hip, for angles from −1.75 to 1.75 rad. At θ = 0 the tip is straight down, at positive θ
/// it is forward (+x). Forces are those on the leg.
///
/// With --body a body moves with constant velocity. Each row of --trials is one motion: vx, vy, vz [m/s], wx, wy, wz
/// [rad/s] (x heading, y axle, z up; 0 if absent), and either depth [m] of the body's lowest point or load [N] that the
/// sand carries. The table has Fx, Fy, Fz, Tx, Ty, Tz, depth and status, after the other columns of a file. The status is ok,
/// or no_equilibrium if the sand cannot carry the load. If a body that is not round turns, forces are means over a turn.
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
pub struct Intrude {
    /// Shape of the leg: L, revL, C, revC, flat or xi=DEGREES
    #[arg(long, allow_hyphen_values = true, required_unless_present = "body", conflicts_with_all = ["body", "rows", "mu_s", "plate_size", "memory", "repose_deg", "cell", "surface", "grain_size"])]
    shape: Option<String>,
    /// Distance from hip to tip [m]
    #[arg(long, value_name = "METRES", default_value_t = CHORD)]
    chord: f64,
    /// Width of the leg [m]
    #[arg(long, value_name = "METRES", default_value_t = WIDTH)]
    width: f64,
    /// Height of the hip above the surface [m]
    #[arg(long, value_name = "METRES", default_value_t = HIP_HEIGHT)]
    hip_height: f64,
    /// Angular speed of the leg [rad/s]; with a negative one the tip moves backward
    #[arg(long, value_name = "RAD/S", default_value_t = OMEGA)]
    omega: f64,
    #[command(flatten)]
    sand: SandArgs,
    /// Body: cylinder:radius=M,width=M (axle along y), box:length=M,width=M,height=M, sphere:radius=M, FILE.stl or
    /// FILE.obj [metres]
    #[arg(long, requires = "rows", conflicts_with_all = ["chord", "width", "hip_height", "omega"])]
    body: Option<NameOrPath>,
    /// Motions of the body, one in each row
    #[arg(long = "trials", value_name = "FILE", requires = "body")]
    rows: Option<TableData>,
    /// Friction coefficient μ_s of the body's surface, instead of the sand's friction_clip
    #[arg(long, value_name = "MU", requires = "body")]
    mu_s: Option<f64>,
    /// Size of the plates into which the surface is cut [m]; default: a fiftieth of the body's longest side
    #[arg(long, value_name = "METRES", requires = "body")]
    plate_size: Option<f64>,
    /// Sand that was moved stays moved: paths in time, with heaps, furrows and prints (docs/memory.md)
    #[arg(long, requires = "rows")]
    memory: bool,
    /// Angle of repose of the sand [°]; default: 25 for glass beads, 28 for other media
    #[arg(long, value_name = "DEG", requires = "memory")]
    repose_deg: Option<f64>,
    /// Side of a cell of the surface [m]; default: a tenth of the body's longest horizontal side
    #[arg(long, value_name = "METRES", requires = "memory")]
    cell: Option<f64>,
    /// File for the surface after each trial: trial, x, y and height of the cells that were moved (CSV)
    #[arg(long, value_name = "FILE", requires = "memory")]
    surface: Option<OutputPath>,
    /// Diameter of the grains [m], for the passing part of sliding_face
    #[arg(long, value_name = "METRES", requires = "memory")]
    grain_size: Option<f64>,
}

impl Study for Intrude {
    const NAME: &'static str = "intrude";
    const PYTHON: &'static str = "Any";

    fn read(&self, inputs: &mut Inputs) -> Result<()> {
        self.sand.read(inputs)?;
        self.body.iter().try_for_each(|body| body.read(&["stl", "obj"], inputs))?;
        self.rows.iter().try_for_each(|rows| inputs.read(&rows.0))
    }

    fn cost(&self, inputs: &Inputs) -> usize {
        self.rows.as_ref().map_or(0, |rows| trials::cost(&rows.0, inputs, self.memory))
    }

    fn next(&self) -> Option<String> {
        Some("to compare it with your measurements: sandgait diagnose data.csv --experiment experiment.toml --out diagnosis".into())
    }

    fn check(self, inputs: &Inputs) -> Result<StudyWork> {
        let (mut sand, warnings) = self.sand.sand(inputs)?;
        let (Some(body), Some(rows)) = (&self.body, &self.rows) else {
            let rotation = self.rotation()?;
            let name = self.shape.unwrap_or_default();
            let rotated = rotation.loads(&sand).map(|loads| rotated(&name, &sand, &loads))?;
            return Ok(StudyWork::new(move |_| Ok(rotated)).warning(warnings).quick());
        };
        if let Some(mu) = self.mu_s {
            sand = with_friction(&sand, mu)?;
        }
        let Self { repose_deg, cell, grain_size, .. } = self;
        let memory = self.memory.then_some(SandMemory { repose_deg, cell, grain_size, surface: self.surface });
        let rows = trials::read(&rows.0, inputs, memory.is_some())?;
        let plated = plated(body, self.plate_size, inputs)?;
        let bytes = rows.body_bytes(&plated) + rows.sand_bytes(memory.as_ref());
        let trials = Trials { shape: body.0.clone(), body: plated, sand, rows, memory };
        trials.check()?;
        Ok(StudyWork::new(move |progress| trials.run(progress)).warning(warnings).taking(bytes))
    }
}

impl Intrude {
    fn rotation(&self) -> Result<Rotation> {
        let Some(shape) = &self.shape else {
            return Err(Error::invalid("intrude", "give --shape, or --body with --trials"));
        };
        let Self { chord, width, hip_height, omega, .. } = *self;
        Ok(Rotation { shape: LegShape::named(shape)?, chord, width, hip_height, omega })
    }
}

/// The body in plates.
fn plated(body: &NameOrPath, size: Option<f64>, inputs: &Inputs) -> Result<PlatedBody> {
    let most = if inputs.local { PlatedBody::MOST_PLATES } else { SENT_PLATES };
    match BodyShape::named(&body.0)? {
        BodyShape::Mesh(path) => PlatedBody::of_mesh(&path, inputs.bytes(&body.0, SENT_TABLE)?, size, most),
        shape => PlatedBody::cut_within(&shape, size, most),
    }
}

/// The result for a leg.
fn rotated(name: &str, sand: &SandDescription, loads: &[(f64, Load)]) -> StudyResult {
    let table = StudyTable::new(
        "intrusion",
        StudyColumn::of_rows(
            loads,
            &[("theta", "rad", |r| r.0), ("Fx", "N", |r| r.1.fx), ("Fz", "N", |r| r.1.fz), ("Ty", "N·m", |r| r.1.ty)],
        ),
    );
    let largest = |name: &str, unit: &str, of: fn(&Load) -> f64| {
        let at = loads.iter().max_by(|a, b| of(&a.1).abs().total_cmp(&of(&b.1).abs()));
        at.map_or_else(String::new, |(t, l)| format!("{name} {:.3} {unit} at {:.0}°", of(l), t.to_degrees()))
    };
    let peaks = [largest("Fx", "N", |l| l.fx), largest("Fz", "N", |l| l.fz), largest("Ty", "N·m", |l| l.ty)];
    let summary = format!("{name} in {}: largest {}\n", sand.name, peaks.join(", "));
    StudyResult { summary, ..StudyResult::table(table) }
}
