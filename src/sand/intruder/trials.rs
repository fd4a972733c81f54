//! Steady motions: force and torque at a given depth, or the depth that carries a given load.

use super::Body;
use crate::error::{Error, Result, check_range};
use crate::number::Vec3;
use crate::parallel;
use crate::sand::{Ground, SandDescription, Site, Surface};

/// Turns of a body that is not round, spread over a period: our choice; the mean force of a box has changed by less than
/// 0.5 % when there are four times as many.
const TURNS: usize = 48;
/// Depths between none and covered at which a load is first looked for: our choice, 4 mm for a wheel of 125 mm.
const STEPS: usize = 32;
/// Depth to which a load is solved [m]: our choice, far below what can be measured.
const EXACT: f64 = 1e-8;
/// Two depths [m] that tell what grows with depth from what does not.
const PROBES: [f64; 2] = [0.02, 0.04];

/// What is known of a trial besides its motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Given {
    /// Of the lowest point below the undisturbed surface [m]; of a body that is not round, the lowest of its turn.
    Depth(f64),
    /// Upward force to be carried [N].
    Load(f64),
}

/// One steady motion of the body's origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trial {
    /// [m/s]
    pub velocity: [f64; 3],
    /// [rad/s]
    pub spin: [f64; 3],
    pub given: Given,
}

impl Trial {
    /// Refuses what no experiment has: our choice of guards against slips of units.
    pub fn validated(self) -> Result<Self> {
        for (name, value) in ["vx", "vy", "vz"].iter().zip(self.velocity) {
            check_range(name, value, -100.0..=100.0)?;
        }
        for (name, value) in ["wx", "wy", "wz"].iter().zip(self.spin) {
            check_range(name, value, -1e4..=1e4)?;
        }
        match self.given {
            Given::Depth(depth) => check_range("depth", depth, -10.0..=10.0)?,
            Given::Load(load) => check_range("load", load, 1e-6..=1e6)?,
        };
        Ok(self)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    Ok,
    /// No depth down to the body's own height carries the load.
    NoEquilibrium,
}

impl Status {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::NoEquilibrium => "no_equilibrium",
        }
    }
}

/// What the sand does to the body; not a number where there is no equilibrium.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    /// On the body [N].
    pub force: [f64; 3],
    /// About the body's origin [N·m].
    pub torque: [f64; 3],
    /// [m]
    pub depth: f64,
    pub status: Status,
}

/// Mechanisms that a body in steady motion does not have, as far as `sand` switches them on.
pub fn without_effect(sand: &SandDescription) -> Vec<&'static str> {
    let m = &sand.mechanisms;
    let all = [
        ("slope", m.slope),
        ("footprint", m.footprint),
        ("concave_fill", m.concave_fill),
        ("added_mass", m.added_mass),
    ];
    all.into_iter().filter(|(_, value)| *value != 0.0).map(|(id, _)| id).collect()
}

/// Every trial, on all processors.
pub fn compute_all(body: &Body, sand: &SandDescription, trials: &[Trial]) -> Result<Vec<Outcome>> {
    if let Some(id) = without_effect(sand).first() {
        return Err(Error::invalid("sand", format!("{id} is not defined for a body in steady motion")));
    }
    for (row, trial) in trials.iter().enumerate() {
        trial.validated().map_err(|e| Error::invalid(format!("trial {}", row + 1), e.to_string()))?;
    }
    Ok(parallel::map(trials, |trial| compute(body, sand, trial)))
}

/// What one plate feels: force = growing · D(depth) + constant, D the depth or its power.
struct Piece {
    /// Height of the plate over the body's origin [m].
    height: f64,
    arm: Vec3<f64>,
    growing: Vec3<f64>,
    constant: Vec3<f64>,
}

/// A body in motion: its leading plates, lowest first, over all turns.
struct Motion<'a> {
    ground: &'a Ground<f64>,
    pieces: Vec<Piece>,
    share: f64,
    /// Least and greatest height over the origin in a turn [m].
    heights: [f64; 2],
}

/// One trial.
pub fn compute(body: &Body, sand: &SandDescription, trial: &Trial) -> Outcome {
    let medium = sand.medium();
    let ground = Ground::new(sand.law, &medium, &Surface::BARE).with(&sand.mechanisms, &medium);
    let motion = Motion::new(body, &ground, trial);
    let depth = match trial.given {
        Given::Depth(depth) => Some(depth),
        Given::Load(load) => motion.depth_under(load),
    };
    let Some(depth) = depth else {
        let none = [f64::NAN; 3];
        return Outcome { force: none, torque: none, depth: f64::NAN, status: Status::NoEquilibrium };
    };
    let [force, torque] = motion.load(depth).map(|v| v.lane(0));
    Outcome { force, torque, depth, status: Status::Ok }
}

impl<'a> Motion<'a> {
    fn new(body: &Body, ground: &'a Ground<f64>, trial: &Trial) -> Self {
        let (velocity, spin) = (Vec3::<f64>::splat(trial.velocity), Vec3::<f64>::splat(trial.spin));
        let rate = spin.norm_squared().sqrt();
        let axis = if rate > 0.0 { spin * (1.0 / rate) } else { Vec3::new(0.0, 1.0, 0.0) };
        let turns = if rate == 0.0 || body.is_round_about(axis) { 1 } else { TURNS };
        let (mut pieces, mut heights) = (Vec::new(), [f64::INFINITY, f64::NEG_INFINITY]);
        for turn in 0..turns {
            let angle = turn as f64 / turns as f64 * std::f64::consts::TAU;
            let turned = |v: Vec3<f64>| if turn == 0 { v } else { rotated(v, axis, angle) };
            let [low, high] = body.heights(turned);
            heights = [heights[0].min(low), heights[1].max(high)];
            let leading = body.plates.iter().filter_map(|p| {
                let (arm, normal) = (turned(p.center), turned(p.normal));
                Piece::of(ground, arm, normal, p.area, velocity, spin)
            });
            pieces.extend(leading);
        }
        pieces.sort_by(|a, b| a.height.total_cmp(&b.height));
        Self { ground, pieces, share: 1.0 / turns as f64, heights }
    }

    /// Force and torque with the lowest point at `depth`.
    fn load(&self, depth: f64) -> [Vec3<f64>; 2] {
        // Height of the surface over the body's origin.
        let surface = self.heights[0] + depth;
        let mut sum = [Vec3::zero(), Vec3::zero()];
        for piece in self.pieces.iter().take_while(|p| p.height < surface) {
            let force = piece.growing.scale_add(self.ground.grown(surface - piece.height), piece.constant);
            sum = [sum[0] + force, sum[1] + piece.arm.cross(force)];
        }
        sum.map(|v| v * self.share)
    }

    /// The least depth that carries `load`, down to the body's own height.
    fn depth_under(&self, load: f64) -> Option<f64> {
        let lack = |depth: f64| self.load(depth)[0].z - load;
        let step = (self.heights[1] - self.heights[0]) / STEPS as f64;
        let mut before = (0.0, -load);
        for k in 1..=STEPS {
            let depth = step * k as f64;
            let after = (depth, lack(depth));
            if after.1 >= 0.0 {
                return Some(between(lack, before, after));
            }
            before = after;
        }
        None
    }
}

impl Piece {
    /// None where the plate does not lead.
    fn of(
        ground: &Ground<f64>,
        arm: Vec3<f64>,
        normal: Vec3<f64>,
        area: f64,
        velocity: Vec3<f64>,
        spin: Vec3<f64>,
    ) -> Option<Self> {
        let v = velocity + spin.cross(arm);
        // Rounding must not decide about a plate that moves along itself, nor on which side a vertical one is looked at.
        let least = -1e-12 * v.norm_squared().sqrt();
        if v.norm_squared() == 0.0 || normal.dot(v) < least {
            return None;
        }
        let normal = if normal.z.abs() < 1e-12 { Vec3::new(normal.x, normal.y, 0.0) } else { normal };
        let at = |depth| {
            let site = Site::fresh(depth, arm.x).travelling([velocity.x, velocity.y]);
            ground.thin_plate(&site, area, normal, v).force
        };
        let [near, far] = PROBES.map(at);
        let [less, more] = PROBES.map(|d| ground.grown(d));
        let growing = (far - near) * (1.0 / (more - less));
        Some(Self { height: arm.z, arm, growing, constant: near - growing * less })
    }
}

/// A root of `f` between two points with values of opposite signs, by false position in the Illinois form.
fn between(f: impl Fn(f64) -> f64, mut a: (f64, f64), mut b: (f64, f64)) -> f64 {
    for _ in 0..100 {
        let x = b.0 - b.1 * (b.0 - a.0) / (b.1 - a.1);
        let new = (x, f(x));
        if (new.1 < 0.0) == (b.1 < 0.0) {
            a.1 /= 2.0;
        } else {
            a = b;
        }
        let moved = (new.0 - b.0).abs();
        b = new;
        if moved < EXACT || b.1 == 0.0 {
            break;
        }
    }
    b.0
}

/// Rodrigues' formula.
fn rotated(v: Vec3<f64>, axis: Vec3<f64>, angle: f64) -> Vec3<f64> {
    let (sin, cos) = angle.sin_cos();
    v * cos + axis.cross(v) * sin + axis * (axis.dot(v) * (1.0 - cos))
}
