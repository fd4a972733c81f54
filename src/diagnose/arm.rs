//! The readings of a force sensor while a plate or leg moves along its track.
//!
//! [`SandMechanisms`] evaluates the mechanisms in the sand; this file adds the effects of measuring, in this order: depth
//! reference, compliance, delay, filter, tilt, offsets.

use super::acceleration::Accelerations;
use super::experiment::Intruder;
use super::sides::{leading_sides, sides};
use super::track::{ArmPose, RigidMotion, Track, Wrench};
use crate::error::Result;
use crate::number::{Doubles, Kernel, Real, Vec3};
use crate::sand::mechanism::Mechanisms;
use crate::sand::mechanism_laws::{SandMechanisms, SegmentState, StressModel, slope_depth};
use crate::sand::shape::{Segment, straight};
use crate::sand::{LegShape, SandBed};

/// Number of segments of a plate or leg: our choice, because the error is then below the scatter of repetitions, unless
/// they scatter by less than 0.5 % (docs/diagnosis.md, "What it cannot do"). If a segment crosses the surface, only its submerged part
/// counts; otherwise a fit would give a pressure that does not vanish at the surface, such as `cohesion`, 2 % too
/// small.
const SEGMENTS: usize = 40;
/// A trial starts at rest if its first speed is below this share of its greatest speed: our choice, the same share as
/// for samples at rest, which are left out.
const REST: f64 = 0.05;
/// Steps per sample interval of the low-pass filter. Our choice: the filter is exact for a force that is linear in each
/// step, and each step costs a computation of the force.
const FILTER_STEPS: usize = 6;
/// Segments that are computed together. The last group is filled up with segments of zero area.
#[derive(Clone, Copy)]
struct Block {
    center: [Doubles; 2],
    normal: [Doubles; 2],
    area: Doubles,
    /// Half the length of a segment [m].
    half: Doubles,
}

fn blocks(segments: &[Segment], width: f64) -> Vec<Block> {
    let block = |part: &[Segment]| {
        let lanes = |of: &dyn Fn(&Segment) -> f64| {
            Doubles::from_array(std::array::from_fn(|i| of(&part[i.min(part.len() - 1)])))
        };
        let area = |i: usize| part.get(i).map_or(0.0, |s| s.area);
        Block {
            center: [0, 1].map(|k| lanes(&|s| s.center[k])),
            normal: [0, 1].map(|k| lanes(&|s| s.normal[k])),
            area: Doubles::from_array(std::array::from_fn(area)),
            half: lanes(&|s| 0.5 * s.area / width),
        }
    };
    segments.chunks(Doubles::LANES).map(block).collect()
}

/// An intruder in segments.
#[derive(Clone)]
pub struct IntruderSegments {
    segments: Vec<Block>,
    /// Straight strip from hip to tip; empty for plates.
    chord: Vec<Block>,
    /// Side faces of a thick plate, normals outward; empty for thin plates and for legs.
    sides: Vec<Segment>,
    width: f64,
    half_thickness: f64,
}

impl IntruderSegments {
    pub fn new(intruder: &Intruder) -> Result<Self> {
        let (Intruder::Leg { width, thickness, .. } | Intruder::Plate { width, thickness, .. }) = *intruder;
        let thickness = thickness.unwrap_or(0.0);
        let (segments, chord, sides) = match *intruder {
            Intruder::Leg { chord, xi_deg, .. } => (
                LegShape::two_piece(xi_deg)?.segments(chord, width, SEGMENTS)?,
                straight([0.0, 0.0], [0.0, -chord], width, SEGMENTS),
                Vec::new(),
            ),
            Intruder::Plate { length, .. } => (
                straight([-length / 2.0, 0.0], [length / 2.0, 0.0], width, SEGMENTS),
                Vec::new(),
                sides(length, width, thickness),
            ),
        };
        let [segments, chord] = [segments, chord].map(|own| blocks(&own, width));
        Ok(Self { segments, chord, sides, width, half_thickness: thickness / 2.0 })
    }
}

/// Converts loads to the readings of a tilted sensor with offsets.
pub fn read<const N: usize>(m: &Mechanisms, loads: &mut [[Wrench; N]]) {
    let (sin, cos) = m.sensor_tilt.sin_cos();
    for [fx, fz, _] in loads.iter_mut().flatten() {
        (*fx, *fz) = (*fx * cos - *fz * sin + m.bias_x, *fx * sin + *fz * cos + m.bias_z);
    }
}

/// Times of the filter's steps along a track, from half a sample before it.
fn filter_times(poses: &[ArmPose]) -> Vec<f64> {
    let first = poses.get(1).map_or(0.0, |p| p.t - poses[0].t);
    let begins = [poses[0].t - 0.5 * first].into_iter().chain(poses.iter().map(|p| p.t));
    let steps = begins.zip(poses).flat_map(|(from, to)| {
        let h = (to.t - from) / FILTER_STEPS as f64;
        (0..FILTER_STEPS).map(move |k| from + h * k as f64)
    });
    steps.chain(poses.last().map(|p| p.t)).collect()
}

/// Is the first speed negligible against the greatest speed?
fn begins_at_rest(poses: &[ArmPose]) -> bool {
    let speeds = |p: &ArmPose| [p.omega.abs(), p.velocity[0].hypot(p.velocity[1])];
    let first = speeds(&poses[0]);
    (0..2).all(|k| first[k] <= REST * poses.iter().map(|p| speeds(p)[k]).fold(0.0, f64::max))
}

/// Loads at the poses behind a first-order filter of time constant `tau` [s], from the loads at its steps: τ ẏ = F
/// − y. The filter is in steady state half a sample before the log; the solution is exact for a force that is
/// linear between steps. In a trial that begins at rest, the filter is in steady state at the first pose. So a filter whose time
/// constant goes to 0 leaves the loads as they are.
pub fn filtered<const N: usize>(poses: &[ArmPose], steps: &[[Wrench; N]], tau: f64) -> Vec<[Wrench; N]> {
    let times = filter_times(poses);
    let rests = begins_at_rest(poses);
    let mut state = steps[if rests { FILTER_STEPS } else { 0 }];
    let mut out = Vec::with_capacity(poses.len());
    for k in 1..steps.len() {
        let h = times[k] - times[k - 1];
        if h > 0.0 && !(rests && k <= FILTER_STEPS) {
            let decay = (-h / tau).exp();
            // Weights of the force at the start and at the end of a step.
            let end = 1.0 - (1.0 - decay) * tau / h;
            let start = 1.0 - decay - end;
            let next = |y: f64, a: f64, b: f64| decay * y + start * a + end * b;
            // At rest the direction of the coming motion is not known, so the first force is taken from the next step.
            let before = if rests && k == FILTER_STEPS + 1 { &steps[k] } else { &steps[k - 1] };
            for (y, (a, b)) in state.iter_mut().zip(before.iter().zip(&steps[k])) {
                *y = [0, 1, 2].map(|c| next(y[c], a[c], b[c]));
            }
        }
        if k % FILTER_STEPS == 0 {
            out.push(state);
        }
    }
    out
}

/// Computes the loads of one track with one set of mechanisms in N beds that differ only in their stress coefficients.
pub struct Arm<'a, const N: usize> {
    pub track: &'a Track,
    pub cut: &'a IntruderSegments,
    pub mechanisms: &'a Mechanisms,
    pub sand: SandMechanisms<Doubles>,
    pub grounds: &'a [SandBed<Doubles>; N],
    /// The track's accelerations; None without added mass.
    pub accelerations: Option<Accelerations<'a>>,
    /// Factor on the law's stress: [`crate::sand::mechanism_laws::footprint`] of the track's pass, and
    /// [`crate::sand::mechanism_laws::of_size`] of the intruder.
    pub factor: f64,
    /// λ ρ [kg/m³] of inertial drag.
    pub drag: f64,
}

impl<const N: usize> Arm<'_, N> {
    /// The loads that the sensor would have read, one for each pose.
    pub fn readings(&self) -> Vec<[Wrench; N]> {
        let m = self.mechanisms;
        let mut loads: Vec<[Wrench; N]> = if m.lowpass > 0.0 {
            filtered(&self.track.poses, &self.between(), m.lowpass)
        } else {
            self.track.poses.iter().enumerate().map(|(i, p)| self.load(&self.late(i, p))).collect()
        };
        read(m, &mut loads);
        loads
    }

    /// The pose whose force the log has at sample `index`: the pose at a time earlier by the delay.
    fn late(&self, index: usize, pose: &ArmPose) -> ArmPose {
        if self.mechanisms.delay == 0.0 { *pose } else { self.pose_at(pose.t - self.mechanisms.delay, index) }
    }

    /// Pose at time `t`: cubic Hermite interpolation of the samples, constant velocity beyond them; `near` is the
    /// index of a sample close to `t`.
    fn pose_at(&self, t: f64, near: usize) -> ArmPose {
        let poses = &self.track.poses;
        let mut right = near.min(poses.len() - 1);
        while right > 0 && poses[right].t > t {
            right -= 1;
        }
        while poses.get(right + 1).is_some_and(|next| next.t <= t) {
            right += 1;
        }
        let a = &poses[right];
        let Some(b) = poses.get(right + 1).filter(|_| t >= a.t) else {
            let dt = t - a.t;
            let center = [0, 1].map(|k| a.center[k] + a.velocity[k] * dt);
            return ArmPose { t, theta: a.theta + a.omega * dt, center, ..*a };
        };
        let h = b.t - a.t;
        let s = (t - a.t) / h;
        let hermite = |p: f64, dp: f64, q: f64, dq: f64| {
            let (s2, s3) = (s * s, s * s * s);
            (2.0 * s3 - 3.0 * s2 + 1.0) * p
                + (s3 - 2.0 * s2 + s) * h * dp
                + (3.0 * s2 - 2.0 * s3) * q
                + (s3 - s2) * h * dq
        };
        let between = |p: f64, q: f64| p + s * (q - p);
        ArmPose {
            t,
            theta: hermite(a.theta, a.omega, b.theta, b.omega),
            omega: between(a.omega, b.omega),
            center: [0, 1].map(|k| hermite(a.center[k], a.velocity[k], b.center[k], b.velocity[k])),
            velocity: [0, 1].map(|k| between(a.velocity[k], b.velocity[k])),
        }
    }

    /// Loads at the steps of a filter: [`FILTER_STEPS`] from one pose to the next, and half an interval before the
    /// first.
    pub fn between(&self) -> Vec<[Wrench; N]> {
        let times = filter_times(&self.track.poses);
        let load = |(k, t): (usize, &f64)| self.load(&self.pose_at(t - self.mechanisms.delay, k / FILTER_STEPS));
        times.iter().enumerate().map(load).collect()
    }

    /// Load at a pose.
    fn load(&self, pose: &ArmPose) -> [Wrench; N] {
        let acceleration = self.accelerations.as_ref().map_or([0.0; 3], |own| own.at(pose.t));
        match self.track.intruder {
            Intruder::Plate { .. } => self.plate(pose, acceleration),
            Intruder::Leg { .. } => {
                let mut lagged = *pose;
                if self.mechanisms.compliance != 0.0 {
                    // Two rounds of θ = θ_motor + torque × compliance: the torque changes little over the lag.
                    for _ in 0..2 {
                        lagged.theta =
                            pose.theta + self.mechanisms.compliance * self.leg(&lagged, acceleration[0])[0][2];
                    }
                }
                self.leg(&lagged, acceleration[0])
            }
        }
    }

    fn plate(&self, pose: &ArmPose, acceleration: [f64; 3]) -> [Wrench; N] {
        let origin = [pose.center[0], pose.center[1] - self.mechanisms.depth_zero];
        let change = [acceleration[1], acceleration[2]];
        let place = RigidMotion {
            origin,
            turn: self.track.beta.sin_cos(),
            velocity: pose.velocity,
            spin: 0.0,
            change,
            spin_up: 0.0,
        };
        let sides = self.sides(place);
        self.sum(&self.cut.segments, place).map(|load| [0, 1, 2].map(|c| load[c] + sides[c]))
    }

    /// Inertial drag on the leading side face of a thick plate.
    fn sides(&self, place: RigidMotion) -> Wrench {
        if self.drag == 0.0 {
            return [0.0; 3];
        }
        let pressure = |speed: f64| self.drag * speed * speed;
        leading_sides(&self.cut.sides, place, self.mechanisms.slope, pressure)
    }

    fn leg(&self, pose: &ArmPose, spin_up: f64) -> [Wrench; N] {
        let origin = [0.0, self.track.hip_height - self.mechanisms.depth_zero];
        let turn = pose.theta.sin_cos();
        let place = RigidMotion { origin, turn, velocity: [0.0; 2], spin: pose.omega, change: [0.0; 2], spin_up };
        let full = self.sum(&self.cut.segments, place);
        let Intruder::Leg { xi_deg, .. } = self.track.intruder else {
            return full;
        };
        let chi = self.mechanisms.concave_fill;
        // If a leg bulges forward (ξ > 0) and turns backward, or the reverse, its concave side leads.
        if chi == 0.0 || xi_deg * pose.omega >= 0.0 {
            return full;
        }
        let chord = self.sum(&self.cut.chord, place);
        let mix = |segments: f64, straight: f64| (1.0 - chi) * segments + chi * straight;
        std::array::from_fn(|bed| [0, 1, 2].map(|c| mix(full[bed][c], chord[bed][c])))
    }

    /// Sums stress over segments.
    fn sum(&self, blocks: &[Block], place: RigidMotion) -> [Wrench; N] {
        let mut loads = [[0.0; 3]; N];
        Doubles::dispatch(Sum { arm: self, blocks, place, loads: &mut loads });
        loads
    }
}

struct Sum<'a, const N: usize> {
    arm: &'a Arm<'a, N>,
    blocks: &'a [Block],
    place: RigidMotion,
    loads: &'a mut [Wrench; N],
}

impl<const N: usize> Kernel for Sum<'_, N> {
    #[inline(always)]
    fn run(self) {
        let Sum { arm, blocks, place, loads } = self;
        let splat = Doubles::splat;
        let zero = Doubles::zero();
        let turn = |[x, z]: [Doubles; 2]| {
            let (sin, cos) = (splat(place.turn.0), splat(place.turn.1));
            [x * cos - z * sin, x * sin + z * cos]
        };
        let moving = |r: [Doubles; 2], [x, z]: [f64; 2], spin: f64| {
            [splat(x) - splat(spin) * r[1], splat(z) + splat(spin) * r[0]]
        };
        let slope = arm.mechanisms.slope.sin_cos();
        let (s_sin, s_cos) = (splat(slope.0), splat(slope.1));
        let into = |p: [Doubles; 2]| Vec3::new(p[0] * s_cos + p[1] * s_sin, zero, p[1] * s_cos - p[0] * s_sin);
        let mut sums = [[zero; 3]; N];
        for block in blocks {
            let r = turn(block.center);
            let at = [splat(place.origin[0]) + r[0], splat(place.origin[1]) + r[1]];
            // These segments are well above the surface, so there is no force on them.
            let reach = splat(-arm.cut.half_thickness) - block.half;
            if !Doubles::any(reach.lt(slope_depth(slope, at[0], at[1]))) {
                continue;
            }
            let n = turn(block.normal);
            let (v, dv) = (moving(r, place.velocity, place.spin), moving(r, place.change, place.spin_up));
            let along = n[0] * v[0] + n[1] * v[1];
            let lead = Doubles::select(along.lt(zero), splat(-1.0), splat(1.0));
            // The stress acts on the leading face, half a thickness ahead of the mid-surface.
            let ahead = lead * splat(arm.cut.half_thickness);
            let [x, z] = [0, 1].map(|k| at[k] + n[k] * ahead);
            let arm_of_force = [0, 1].map(|k| r[k] + n[k] * ahead);
            let (normal, velocity) = (into(n), into(v));
            // If a segment crosses the surface, its submerged share counts, at the mean depth of this share. A
            // horizontal segment has no extent; 1e-12 avoids 0/0.
            let (depth, extent) = (slope_depth(slope, x, z), normal.x.abs() * block.half);
            let share = ((depth + extent) / (extent + extent + splat(1e-12))).max(zero).min(Doubles::one());
            let mean = Doubles::select(depth.lt(extent), splat(0.5) * (depth + extent), depth);
            let area = block.area * share;
            let site = SegmentState {
                depth: mean.max(zero),
                x: splat(arm.track.x_bed) + x,
                footprint: splat(arm.factor),
                width: splat(arm.cut.width),
                normal_acceleration: lead * (n[0] * dv[0] + n[1] * dv[1]),
                passes: splat(f64::from(arm.track.pass.max(1) - 1)),
                // A log has positions only; the velocity of travel is not known.
                travel: [zero; 2],
            };
            let motion = arm.grounds[0].motion(velocity);
            for ([sum_x, sum_z, sum_turn], ground) in sums.iter_mut().zip(arm.grounds) {
                let stress = arm.sand.force(ground.stress(normal, &motion), normal, velocity, &site, Doubles::one());
                let fx = (stress.x * s_cos - stress.z * s_sin) * area;
                let fz = (stress.x * s_sin + stress.z * s_cos) * area;
                *sum_x += fx;
                *sum_z += fz;
                *sum_turn += arm_of_force[0] * fz - arm_of_force[1] * fx;
            }
        }
        *loads = sums.map(|own| own.map(Doubles::sum));
    }
}

#[cfg(test)]
mod tests {
    use super::super::force_model::tests::forces;
    use super::*;

    /// A level plate that moves down and forward has its leading face half a thickness below its centre. There the sand holds back with Fx,
    /// so Ty = x Fz − z Fx is half a thickness times Fx.
    #[test]
    fn the_stress_on_a_thick_plate_turns_it_about_its_leading_face() {
        let thickness = 0.006;
        let intruder = Intruder::Plate { length: 0.038, width: 0.025, thickness: Some(thickness) };
        let pose = |t: f64| ArmPose { t, center: [0.1 * t, -0.03], velocity: [0.1, -0.05], ..ArmPose::default() };
        let [fx, fz, turn]: [f64; 3] =
            forces(Mechanisms::default(), &Track::leg(intruder, 0.0, vec![pose(0.0)])).try_into().unwrap();
        assert!(fx < -0.1 && fz > 0.1, "{fx} {fz}");
        assert!((turn / (0.5 * thickness * fx) - 1.0).abs() < 1e-6, "{turn} {fx}");
    }

    /// Cohesion pushes with the same stress on the whole submerged area, so its force on a vertical plate grows with
    /// every step into the sand, however small the step is against a segment.
    #[test]
    fn of_a_segment_that_crosses_the_surface_the_submerged_part_counts() {
        let (length, width, cohesion, steps) = (0.04, 0.025, 300.0, 500);
        let intruder = Intruder::Plate { length, width, thickness: None };
        let pose = |i: u32| {
            let z = length * (0.5 - f64::from(i) / f64::from(steps));
            ArmPose { t: 1e-3 * f64::from(i), center: [0.0, z], velocity: [0.5, 0.0], ..ArmPose::default() }
        };
        let track =
            Track { beta: std::f64::consts::FRAC_PI_2, ..Track::leg(intruder, 0.0, (0..steps).map(pose).collect()) };
        let force = |cohesion: f64| forces(Mechanisms { cohesion, ..Mechanisms::default() }, &track);
        for (i, (with, without)) in force(cohesion).into_iter().zip(force(0.0)).take(steps as usize).enumerate() {
            let submerged = i as f64 / f64::from(steps);
            let expected = -cohesion * width * length * submerged;
            assert!((with - without - expected).abs() < 1e-6, "{submerged}: {} and not {expected}", with - without);
        }
    }

    /// A filter whose time constant goes to 0 leaves forces as they are, also at the first pose of a plate that begins slowly. There
    /// the filtered force was 0, so fits took the force of the first sample for the effect of a filter.
    #[test]
    fn a_fast_filter_changes_nothing() {
        let intruder = Intruder::Plate { length: 0.04, width: 0.025, thickness: None };
        for first in [0.0, 2e-3, 0.2] {
            let speed = |t: f64| first.max(0.2 * (t / 0.1).min(1.0));
            let pose = |i: u32| {
                let t = 5e-3 * f64::from(i);
                ArmPose { t, center: [0.0, -0.03 - 0.1 * t], velocity: [0.0, -speed(t)], ..ArmPose::default() }
            };
            let track = Track::leg(intruder, 0.0, (0..40).map(pose).collect());
            let of = |lowpass: f64| forces(Mechanisms { lowpass, ..Mechanisms::default() }, &track);
            for (i, (fast, none)) in of(1e-7).into_iter().zip(of(0.0)).enumerate() {
                assert!((fast - none).abs() < 1e-3 * none.abs().max(0.1), "{first} m/s, {i}: {fast} and not {none}");
            }
        }
    }
}
