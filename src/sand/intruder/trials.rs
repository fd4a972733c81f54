//! Steady motions: force and torque at a given depth, or the depth that carries a given load.

use super::{IntruderPlate, PlatedBody};
use crate::error::{Error, Result, check_range};
use crate::mechanism_laws::{SlidingFace, left_force};
use crate::number::Vec3;
use crate::{Regularization, SandBed, SandDescription, SegmentState, Term};

/// Number of depths, from no part of the body covered to all covered, at which the search for a load begins: our
/// choice, because the depths are then 4 mm apart for a wheel of 125 mm.
const STEPS: usize = 32;
/// Accuracy [m] of the depth that carries a load: our choice, far below what can be measured.
const EXACT: f64 = 1e-8;
/// Two depths [m] at which a plate's force is computed, to separate the part that grows with depth from the constant
/// part: our choice. Any two depths give the same parts, unless a term of `sand.toml` depends on the depth otherwise.
const PROBES: [f64; 2] = [0.02, 0.04];

/// The quantity that is given in a trial, in addition to the motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DepthOrLoad {
    /// Depth of the lowest point below the undisturbed surface [m]; for a body that is not round, of the lowest
    /// point of its turn.
    Depth(f64),
    /// Upward force that the sand must carry [N].
    Load(f64),
}

/// A steady motion of the body's origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trial {
    /// [m/s]
    pub velocity: [f64; 3],
    /// [rad/s]
    pub spin: [f64; 3],
    pub given: DepthOrLoad,
}

impl Trial {
    /// Velocity of a point of the body [m/s]; `arm`: from its origin [m].
    pub(super) fn velocity_at(&self, arm: Vec3<f64>) -> Vec3<f64> {
        Vec3::splat(self.velocity) + Vec3::<f64>::splat(self.spin).cross(arm)
    }

    /// Refuses numbers that no experiment has: our choice, which catches wrong units.
    pub fn validated(self) -> Result<Self> {
        for (name, value) in ["vx", "vy", "vz"].iter().zip(self.velocity) {
            check_range(name, value, -100.0..=100.0)?;
        }
        for (name, value) in ["wx", "wy", "wz"].iter().zip(self.spin) {
            check_range(name, value, -1e4..=1e4)?;
        }
        match self.given {
            DepthOrLoad::Depth(depth) => check_range("depth", depth, -10.0..=10.0)?,
            DepthOrLoad::Load(load) => check_range("load", load, 1e-6..=1e6)?,
        };
        Ok(self)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    Ok,
    /// No depth up to the body's own height carries the load.
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

/// The sand's force and torque on the body; NaN where there is no equilibrium.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrialOutcome {
    /// Force on the body [N].
    pub force: [f64; 3],
    /// Torque about the body's origin [N·m].
    pub torque: [f64; 3],
    /// [m]
    pub depth: f64,
    pub status: Status,
}

/// Mechanisms of `sand` that have no effect on a body in steady motion.
pub fn without_effect(sand: &SandDescription) -> Vec<&'static str> {
    let m = &sand.mechanisms;
    let all = [
        ("slope", m.slope),
        ("footprint", m.footprint),
        ("concave_fill", m.concave_fill),
        ("added_mass", m.added_mass),
        ("size_power", m.size_power),
    ];
    all.into_iter().filter(|(_, value)| *value != 0.0).map(|(id, _)| id).collect()
}

/// The same sand with friction coefficient `mu` on the body's surface.
pub fn with_friction(sand: &SandDescription, mu: f64) -> Result<SandDescription> {
    let mut sand = sand.clone();
    // A coefficient of 10 is rougher than any surface. Below 0.1, 1/μ would exceed the catalogue's bound.
    sand.mechanisms.friction_clip = 1.0 / check_range("mu-s", mu, 0.1..=10.0)?;
    Ok(sand)
}

/// Refuses trials that cannot be computed.
pub fn check_all(sand: &SandDescription, trials: &[Trial]) -> Result<()> {
    if let Some(id) = without_effect(sand).first() {
        return Err(Error::invalid("sand", format!("{id} is not defined for a body in steady motion")));
    }
    // The force on a plate is taken as linear in its depth, and the plates of a body have no width of their own.
    if let Some(group) = sand.terms.iter().find_map(Term::varying_group) {
        let reason = format!("a term with the group {group} is not defined for a body in steady motion");
        return Err(Error::invalid("sand", reason));
    }
    for (row, trial) in trials.iter().enumerate() {
        trial.validated().map_err(|e| Error::invalid(format!("trial {}", row + 1), e.to_string()))?;
    }
    Ok(())
}

/// The force on one plate: growing · D(depth) + constant + resting · depth, where D is the depth or a power of it.
struct DepthForce {
    /// Height of the centre above the body's origin [m], and half the plate's vertical extent.
    height: f64,
    rise: f64,
    arm: Vec3<f64>,
    growing: Vec3<f64>,
    constant: Vec3<f64>,
    /// 0 unless `sliding_face` is on.
    resting: Vec3<f64>,
}

/// The part of a plate that leads, and how it moves.
struct LeadingPart {
    normal: Vec3<f64>,
    /// Velocity of the plate's centre [m/s].
    v: Vec3<f64>,
    speed: f64,
    /// n·v at the centre, its largest difference at the edges, and its mean over the part that leads [m/s].
    along: f64,
    uneven: f64,
    toward: f64,
    /// The share of the plate's force that counts.
    share: f64,
}

/// Plates are first prepared up to the first share of the body's height. If this part carries the load, the plates
/// above it are not needed. Our choice; it saves time.
const PARTS: [f64; 2] = [0.4, 1.0];

/// A body in motion: its leading plates below some height in all positions of a period, lowest first.
struct MovingPlates<'a> {
    ground: &'a SandBed<f64>,
    pieces: Vec<DepthForce>,
    share: f64,
}

/// The positions of a period (one or several), and the least and greatest height of the body in them [m].
struct Turns {
    axis: Vec3<f64>,
    count: usize,
    heights: [f64; 2],
}

/// Computes one trial.
pub fn compute(body: &PlatedBody, sand: &SandDescription, trial: &Trial) -> TrialOutcome {
    compute_with(body, sand, trial, &[])
}

/// The same with the stress [N/m³] that earlier motions have left on each plate ([`super::passing`]); none if `excess` is empty.
/// A body that is not round may then not turn.
pub(super) fn compute_with(body: &PlatedBody, sand: &SandDescription, trial: &Trial, excess: &[f64]) -> TrialOutcome {
    let (ground, plain) = (bed(sand), plain(sand));
    let turns = Turns::of(body, trial);
    let height = turns.heights[1] - turns.heights[0];
    let up_to = |depth: f64| {
        let surface = turns.heights[0] + depth;
        MovingPlates::new(body, &ground, trial, &turns, surface, plain, excess)
    };
    let found = match trial.given {
        DepthOrLoad::Depth(depth) => Some((depth, up_to(depth))),
        DepthOrLoad::Load(load) => {
            let mut from = 0.0;
            PARTS.iter().find_map(|part| {
                let motion = up_to(part * height);
                let depth = motion.depth_under(load, turns.heights[0], [from, part * height], height);
                from = part * height;
                depth.map(|depth| (depth, motion))
            })
        }
    };
    let Some((depth, motion)) = found else {
        let none = [f64::NAN; 3];
        return TrialOutcome { force: none, torque: none, depth: f64::NAN, status: Status::NoEquilibrium };
    };
    let [force, torque] = motion.load(turns.heights[0] + depth).map(|v| v.lane(0));
    TrialOutcome { force, torque, depth, status: Status::Ok }
}

pub(super) fn bed(sand: &SandDescription) -> SandBed<f64> {
    let medium = sand.medium();
    SandBed::new(sand.law, &medium, &Regularization::BARE).with(&sand.mechanisms, &medium)
}

/// Are all forces proportional to the depth or a power of it?
fn plain(sand: &SandDescription) -> bool {
    sand.mechanisms.inertial_drag == 0.0 && sand.mechanisms.cohesion == 0.0
}

/// The steady pressure per depth [N/m³] against each plate; None for plates at rest. With `depth_power` it is that at the
/// mechanism's reference depth.
pub(super) fn pressures(body: &PlatedBody, sand: &SandDescription, trial: &Trial) -> Vec<Option<f64>> {
    let (ground, plain) = (bed(sand), plain(sand));
    let pressure = |p: &IntruderPlate| {
        let moves = trial.velocity_at(p.center).norm_squared() > 0.0;
        let force = DepthForce::of(&ground, p, trial, plain, 0.0).map_or(Vec3::zero(), |f| f.growing + f.resting);
        moves.then(|| -force.dot(p.normal) / p.area)
    };
    body.plates.iter().map(pressure).collect()
}

impl Turns {
    fn of(body: &PlatedBody, trial: &Trial) -> Self {
        let spin = Vec3::<f64>::splat(trial.spin);
        let rate = spin.norm_squared().sqrt();
        let axis = if rate > 0.0 { spin * (1.0 / rate) } else { Vec3::new(0.0, 1.0, 0.0) };
        if rate == 0.0 || body.is_round_about(axis) {
            return Self { axis, count: 1, heights: body.heights() };
        }
        Self { axis, count: body.turns(), heights: body.heights_in_turn(axis) }
    }

    fn turned(&self, k: usize, v: Vec3<f64>) -> Vec3<f64> {
        if k == 0 { v } else { rotated(v, self.axis, k as f64 / self.count as f64 * std::f64::consts::TAU) }
    }
}

impl<'a> MovingPlates<'a> {
    /// Makes pieces of the plates that begin below `surface` [m] above the origin.
    fn new(
        body: &PlatedBody,
        ground: &'a SandBed<f64>,
        trial: &Trial,
        turns: &Turns,
        surface: f64,
        plain: bool,
        excess: &[f64],
    ) -> Self {
        let mut pieces = Vec::new();
        if turns.count == 1 {
            // The plates are sorted already.
            let below = body.plates.iter().enumerate().take_while(|(_, p)| p.center.z - p.rise() < surface);
            let left = |k: usize| excess.get(k).copied().unwrap_or(0.0);
            pieces.extend(below.filter_map(|(k, p)| DepthForce::of(ground, p, trial, plain, left(k))));
            return Self { ground, pieces, share: 1.0 };
        }
        for k in 0..turns.count {
            let turned = |v| turns.turned(k, v);
            let plates = body.turning().iter().map(|p| IntruderPlate {
                center: turned(p.center),
                normal: turned(p.normal),
                half: p.half.map(turned),
                ..*p
            });
            let below = plates.filter(|p| p.center.z - p.rise() < surface);
            pieces.extend(below.filter_map(|p| DepthForce::of(ground, &p, trial, plain, 0.0)));
        }
        pieces.sort_by(|a, b| (a.height - a.rise).total_cmp(&(b.height - b.rise)));
        Self { ground, pieces, share: 1.0 / turns.count as f64 }
    }

    /// Force and torque when the sand's surface is at `surface` [m] above the origin.
    fn load(&self, surface: f64) -> [Vec3<f64>; 2] {
        let (mut sum, rests) = ([Vec3::zero(), Vec3::zero()], self.ground.sliding().is_some());
        for piece in self.pieces.iter().take_while(|p| p.height - p.rise < surface) {
            let (depth, share) = piece.submerged(surface - piece.height);
            let mut force = piece.growing.scale_add(self.ground.grown(depth) * share, piece.constant * share);
            if rests {
                force += piece.resting * (depth * share);
            }
            sum = [sum[0] + force, sum[1] + piece.arm.cross(force)];
        }
        sum.map(|v| v * self.share)
    }

    /// The least depth within `range` that carries `load`; `low` is the height of the lowest point, `height` the body's.
    fn depth_under(&self, load: f64, low: f64, range: [f64; 2], height: f64) -> Option<f64> {
        let lack = |depth: f64| self.load(low + depth)[0].z - load;
        let steps = ((range[1] - range[0]) / height * STEPS as f64).ceil();
        let mut before = (range[0], lack(range[0]));
        for k in 1..=steps as usize {
            let depth = range[0] + (range[1] - range[0]) * k as f64 / steps;
            let after = (depth, lack(depth));
            if after.1 >= 0.0 {
                return Some(between(lack, before, after));
            }
            before = after;
        }
        None
    }
}

impl LeadingPart {
    /// None if the plate is at rest. If the leading edge crosses the plate, the force is proportional to the leading
    /// share. With `sliding_face` it also rises over the mechanism's range of n·v̂.
    fn of(ground: &SandBed<f64>, plate: &IntruderPlate, trial: &Trial) -> Option<Self> {
        let v = trial.velocity_at(plate.center);
        let speed = v.norm_squared().sqrt();
        if speed == 0.0 {
            return None;
        }
        // These small numbers decide two cases that rounding would decide otherwise: whether a plate that moves along
        // itself leads, and which side of a vertical plate leads.
        let least = 1e-12 * speed;
        let n = plate.normal;
        let normal = if n.z.abs() < 1e-12 { Vec3::new(n.x, n.y, 0.0) } else { n };
        let (along, uneven) = (normal.dot(v), plate.unevenness(v, Vec3::splat(trial.spin)));
        if let Some(face) = ground.sliding() {
            let share = ((along + uneven) / (2.0 * uneven + face.range(0.0) * speed)).clamp(0.0, 1.0);
            let toward = along.max((along + uneven) / 2.0).max(least);
            return Some(Self { normal, v, speed, along, uneven, toward, share });
        }
        let share =
            if uneven > least { (0.5 + 0.5 * along / uneven).clamp(0.0, 1.0) } else { f64::from(along >= -least) };
        // If the leading edge crosses the plate, n·v of the leading part ranges from 0 to `along + uneven`, so its mean
        // is half of this. A plate that moves along itself is also pushed, not pulled.
        let toward = if share < 1.0 { (along + uneven) / 2.0 } else { along.max(least) };
        Some(Self { normal, v, speed, along, uneven, toward, share })
    }

    /// The force [N/m] for each metre of depth of the sand at rest, if `sliding_face` is on.
    fn resting(&self, ground: &SandBed<f64>, area: f64) -> Vec3<f64> {
        let Some(face) = ground.sliding() else { return Vec3::zero() };
        let load = face.resting(self.along / self.speed, self.uneven / self.speed).share * area;
        if load == 0.0 {
            return Vec3::zero();
        }
        let load = load * SlidingFace::pressure(self.normal.z);
        face.force(self.normal * load, load, self.v * (1.0 / self.speed), 1.0)
    }
}

impl DepthForce {
    /// The force on the leading part of a plate; None if there is none.
    fn of(ground: &SandBed<f64>, plate: &IntruderPlate, trial: &Trial, plain: bool, excess: f64) -> Option<Self> {
        let part = LeadingPart::of(ground, plate, trial)?;
        let mut resting = part.resting(ground, plate.area);
        if excess != 0.0 {
            resting += left_force(part.normal, part.v, excess * plate.area);
        }
        if part.share == 0.0 {
            let none = Vec3::zero();
            return (resting.norm_squared() > 0.0).then(|| Self::over(plate, [none, none, resting]));
        }
        let v = part.normal.scale_add(part.toward - part.along, part.v);
        let at = |depth| {
            let [x, y, _] = trial.velocity;
            let site = SegmentState::fresh(depth, plate.center.x).travelling([x, y]);
            ground.thin_plate(&site, plate.area * part.share, part.normal, v).force
        };
        let less = ground.grown(PROBES[0]);
        let near = at(PROBES[0]);
        let growing = match plain {
            true => near * (1.0 / less),
            false => (at(PROBES[1]) - near) * (1.0 / (ground.grown(PROBES[1]) - less)),
        };
        let constant = if plain { Vec3::zero() } else { near - growing * less };
        Some(Self::over(plate, [growing, constant, resting]))
    }

    fn over(plate: &IntruderPlate, [growing, constant, resting]: [Vec3<f64>; 3]) -> Self {
        Self { height: plate.center.z, rise: plate.rise(), arm: plate.center, growing, constant, resting }
    }

    /// Mean depth of the part in the sand and its share of the plate, for a centre at `depth`.
    fn submerged(&self, depth: f64) -> (f64, f64) {
        if depth >= self.rise {
            return (depth, 1.0);
        }
        let wet = depth + self.rise;
        (wet / 2.0, wet / (2.0 * self.rise))
    }
}

/// A root of `f` between two points with values of opposite signs, by false position in the Illinois form. 100 steps
/// bound the time: our choice.
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
