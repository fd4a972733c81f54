//! Physical laws with any mechanisms within their bounds: the sand dissipates energy and never adds any.

use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sandgait::number::{Portable, Real, Vec3};
use sandgait::progress::Silent;
use sandgait::sand::intrusion::Rotation;
use sandgait::sand::mechanism::{CATALOG, Mechanism, Side};
use sandgait::sand::mechanism_laws::{LEAST_FACTOR, SegmentState, footprint};
use sandgait::sand::{Law, LegShape, Mechanisms, Medium, Regularization, SandBed, SandDescription};
use sandgait::sim::engine::EngineKind;
use sandgait::sim::model::Scene;
use sandgait::sim::walk::{WalkResult, WalkTrial};
use sandgait::sim::{Model, Robot};
use sandgait::sweep::walk_all;

/// Makes test cases from the mechanisms that act in the sand (with `motor`, also in the motor): first each alone at
/// both of its bounds, then `combinations` random combinations with values between the bounds.
fn extremes(motor: bool, combinations: usize) -> Vec<(String, Mechanisms)> {
    let acts = |m: &Mechanism| m.side == Side::Sand || (motor && m.walking);
    let entries: Vec<_> = CATALOG.iter().enumerate().filter(|(_, m)| acts(m)).collect();
    let bounds = entries.iter().flat_map(|&(id, m)| m.bounds.map(|value| (id, value)));
    let alone = bounds.map(|(id, value)| (format!("{} = {value}", CATALOG[id].id), Mechanisms::PLAIN.with(id, value)));
    let mut all: Vec<_> = alone.collect();
    let mut random = Xoshiro256PlusPlus::seed_from_u64(8);
    for k in 0..combinations {
        let mut m = Mechanisms::PLAIN;
        for &(id, entry) in &entries {
            if random.random_bool(0.5) {
                m = m.with(id, random.random_range(entry.bounds[0]..=entry.bounds[1]));
            }
        }
        all.push((format!("combination {k}: {m:?}"), m));
    }
    all
}

/// The friction cap divides by a power plus this small number [W], so it may leave a power of this size.
const GUARD: f64 = 1e-30;

fn unit(random: &mut impl Rng) -> Vec3<f64> {
    loop {
        let [x, y, z] = [(); 3].map(|()| random.random_range(-1.0..1.0));
        let v = Vec3::new(x, y, z);
        let n = v.norm_squared();
        if n > 1e-3 && n < 1.0 {
            return v * (1.0 / n.sqrt());
        }
    }
}

/// A random segment in the bed that moves in any direction, at up to 20 m/s.
struct Segment {
    n: Vec3<f64>,
    v: Vec3<f64>,
    depth: f64,
    x: f64,
    pass_dx: f64,
    /// Velocity of its body along x and y [m/s].
    travel: [f64; 2],
}

fn segment(random: &mut impl Rng) -> Segment {
    let speed = 10f64.powf(random.random_range(-8.0..1.3));
    Segment {
        n: unit(random),
        v: unit(random) * speed,
        depth: 10f64.powf(random.random_range(-5.0..-0.5)),
        x: random.random_range(-2.0..2.0),
        pass_dx: random.random_range(0.0..0.1),
        travel: [(); 2].map(|()| random.random_range(-1.0..1.0) * 10f64.powf(random.random_range(-5.0..0.5))),
    }
}

impl Segment {
    fn site<R: Real>(&self, m: &Mechanisms) -> SegmentState<R> {
        let [depth, x] = [self.depth, self.x].map(R::splat);
        let footprint = R::splat(footprint(m.footprint, 2, self.pass_dx));
        SegmentState {
            footprint,
            width: R::splat(0.01),
            travel: self.travel.map(R::splat),
            ..SegmentState::fresh(depth, x)
        }
    }

    fn splat<R: Real>(v: Vec3<f64>) -> Vec3<R> {
        Vec3::new(R::splat(v.x), R::splat(v.y), R::splat(v.z))
    }

    /// Largest factor of the mechanisms on the law's own stress. The energy that 3D-RFT adds may grow by this factor.
    fn most(&self, m: &Mechanisms) -> f64 {
        let power = (self.depth / 0.02).powf(m.depth_power);
        let rate = 1.0 + m.rate_log * (self.v.norm_squared().sqrt() / 0.01).ln_1p();
        let packing = 1.0 + m.packing_grad * self.x / 0.1;
        let factor = (1.0 + m.scale) * footprint(m.footprint, 2, self.pass_dx);
        1.001 * power * factor * rate.max(LEAST_FACTOR) * packing.max(LEAST_FACTOR)
    }
}

/// The power from the sand is at most that of the published law (0, except for 3D-RFT, see `laws_of_sand`) times the
/// mechanisms' factors. The accelerations are 0 here, because added mass stores energy; another test below checks it.
#[test]
fn sand_with_mechanisms_never_adds_energy() {
    let medium = Medium::named("poppy-loose").unwrap();
    let mut random = Xoshiro256PlusPlus::seed_from_u64(3);
    for law in Law::ALL {
        let plain = SandBed::<f64>::new(law, &medium, &Regularization::DEFAULT);
        for (what, m) in extremes(false, 60) {
            let ground = plain.with(&m, &medium);
            let lanes = SandBed::<Portable>::new(law, &medium, &Regularization::DEFAULT);
            let lanes = lanes.with(&m, &medium);
            for _ in 0..3_000 {
                let s = segment(&mut random);
                let (site, area, speed) = (s.site(&m), 1e-4, s.v.norm_squared().sqrt());
                let given = |bare: Vec3<f64>| bare.dot(s.v).max(0.0) * s.most(&m);
                let fresh = SegmentState::fresh(s.depth, s.x);
                for (contact, bare) in [
                    (ground.thin_plate(&site, area, s.n, s.v), plain.thin_plate(&fresh, area, s.n, s.v)),
                    (ground.one_sided(&site, area, s.n, s.v), plain.one_sided(&fresh, area, s.n, s.v)),
                ] {
                    let (force, power) = (contact.force.norm_squared().sqrt(), contact.force.dot(s.v));
                    // The force before the friction cap may be larger, and then its rounding error is larger too.
                    let uncut = bare.force.norm_squared().sqrt() * s.most(&m);
                    let allowed = given(bare.force) + (1e-12 * force + 1e-15 * uncut) * speed + GUARD;
                    let said = || format!("{} {what}: n {:?} v {:?}: {power} W", law.name(), s.n, s.v);
                    assert!(power <= allowed, "{}", said());
                    assert!(contact.drag >= 0.0 && contact.edge >= 0.0, "{}", said());
                }
                let (n, v) = (Segment::splat(s.n), Segment::splat(s.v));
                let single = lanes.thin_plate(&s.site(&m), Portable::splat(area), n, v).force;
                let [force, power] = [single.norm_squared().sqrt(), single.dot(v)].map(|x| x.lane(0));
                let bare = plain.thin_plate(&fresh, area, s.n, s.v).force;
                let size = force + bare.norm_squared().sqrt() * s.most(&m);
                assert!(power <= given(bare) + 2e-5 * size * speed + GUARD, "{} {what}: {power} W in f32", law.name());
            }
        }
    }
}

/// The sand brakes a turning leg at every angle and speed. (In an earlier version `rate_log` = −0.25 drove a leg at 10
/// rad/s.) A motor turns the leg, so `friction_clip` acts as it is defined; above 1 it may drive the leg (docs/physics.md).
#[test]
fn sand_brakes_a_turning_leg() {
    let poppy = SandDescription::named("poppy-loose", "li2013").unwrap();
    for (what, mut mechanisms) in extremes(false, 20) {
        mechanisms.friction_clip = mechanisms.friction_clip.min(1.0);
        for omega in [-100.0, -20.0, -10.0, 0.2, 10.0, 20.0, 100.0] {
            for shape in ["L", "revL", "C", "flat"] {
                let leg = Rotation { omega, ..Rotation::of(LegShape::named(shape).unwrap()) };
                for (theta, load) in leg.loads(&SandDescription { mechanisms, ..poppy.clone() }).unwrap() {
                    let power = load.ty * omega;
                    assert!(power <= 1e-12 * omega.abs(), "{what}: leg {shape} at {theta} rad: {power} W");
                }
            }
        }
    }
}

/// Added mass stores energy and returns it: its work is zero over a stroke at constant depth with equal speeds at both
/// ends.
#[test]
fn added_mass_conserves_energy() {
    let medium = Medium::named("poppy-loose").unwrap();
    let plain = SandBed::<f64>::new(Law::Li2013, &medium, &Regularization::DEFAULT);
    let m = Mechanisms { added_mass: 30.0, ..Mechanisms::PLAIN };
    let ground = plain.with(&m, &medium);
    let n = Vec3::new(0.6, 0.0, -0.8);
    let steps = 1000;
    let (mut work, mut moved) = (0.0, 0.0);
    for k in 0..steps {
        let phase = (f64::from(k) + 0.5) / f64::from(steps) * std::f64::consts::TAU;
        let (speed, acceleration) = (0.2 - 0.1 * phase.cos(), 0.1 * phase.sin());
        let v = n * speed;
        let site = SegmentState { width: 0.01, normal_acceleration: acceleration, ..SegmentState::fresh(0.02, 0.0) };
        let extra = ground.thin_plate(&site, 1e-4, n, v).force - plain.thin_plate(&site, 1e-4, n, v).force;
        work += extra.dot(v);
        moved += extra.dot(v).abs();
    }
    assert!(moved > 0.0 && work.abs() < 1e-9 * moved, "{work} of {moved}");
}

fn walks(cases: &[(String, Mechanisms)], legs: &[&str], frequencies: &[f64]) -> Vec<(String, WalkResult)> {
    let mut trials = Vec::new();
    let mut said = Vec::new();
    for (what, mechanisms) in cases {
        for &leg in legs {
            for &frequency in frequencies {
                let robot = Robot::load("xplorer").unwrap().with_leg_shape(leg).unwrap();
                let mut scene = Scene::flat(Medium::named("poppy-loose").unwrap());
                scene.mechanisms = *mechanisms;
                trials.push(WalkTrial::new(Model::new(&robot, &scene).unwrap(), frequency));
                said.push(format!("{what}: leg {leg} at {frequency} Hz"));
            }
        }
    }
    said.into_iter().zip(walk_all(EngineKind::Lanes, &trials, &Silent).unwrap()).collect()
}

/// Robots walk on every sand that the bounds allow, with one mechanism or several: no simulation diverges, and no robot
/// is thrown into the air. (On ten times harder sand, uphill at 5 Hz, they tumble; the mean height stays below a body's
/// length.)
#[test]
fn robots_walk_on_every_sand_within_bounds() {
    let own = |m: &Mechanisms| Mechanisms { motor_torque_limit: 0.0, ..*m };
    let cases: Vec<_> = extremes(true, 12).into_iter().map(|(what, m)| (what, own(&m))).collect();
    for (what, w) in walks(&cases, &["L", "revL"], &[1.0, 3.0, 5.0]) {
        println!("{what}: {:.3} m/s, {:.1} mm", w.speed, 1e3 * w.base_height);
        assert!(w.speed.is_finite() && w.speed.abs() < 2.0 && w.base_height < 0.15, "{what}: {w:?}");
    }
}

/// In sand that gets weaker along the path, a robot sinks until the smallest stress that the mechanism allows carries
/// it, and goes on walking. (In an earlier version `packing_grad` = −0.3 buried every robot at 0.29 m.)
#[test]
fn robots_walk_on_in_weakening_sand() {
    let cases =
        [-0.1, -0.3, -0.9].map(|g| (format!("packing_grad {g}"), Mechanisms { packing_grad: g, ..Mechanisms::PLAIN }));
    for (what, w) in walks(&cases, &["L", "revL", "C", "revC"], &[1.0, 2.0, 3.0, 5.0]) {
        println!("{what}: {:.3} m/s, {:.1} mm", w.speed, 1e3 * w.base_height);
        assert!(w.speed > 0.0 && w.base_height > -0.02, "{what}: {w:?}");
    }
}
