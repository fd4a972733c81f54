//! What a force sensor reads while one plate or leg moves along its track.
//!
//! The sand side of a mechanism is evaluated by [`SandMechanisms`]; the measuring side (depth reference, compliance, delay,
//! filter, tilt, offsets) is here, in that order.

use super::experiment::Intruder;
use super::force_log::{Pose, Track};
use crate::error::Result;
use crate::number::Vec3;
use crate::sand::beyond::{SandMechanisms, Site, slope_depth};
use crate::sand::intrusion::Load;
use crate::sand::mechanism::Mechanisms;
use crate::sand::shape::{Segment, straight};
use crate::sand::{Ground, Shape};

/// Segments a plate or leg is cut into: the partly submerged one then errs by < 0.1 % of the peak force. Our choice.
const SEGMENTS: usize = 40;
/// Steps per sample interval in which the low-pass filter sees the force; linear in between. Our choice.
const FILTER_STEPS: usize = 6;
/// Samples that an acceleration is taken from: our choice. A velocity that swings once in thirteen samples then errs by 0.2 %
/// inside a trial and by 1 % at its ends, where two samples gave 4 % and a quarter; noise of a velocity counts a third more.
const STENCIL: usize = 5;

/// An intruder in segments.
#[derive(Clone)]
pub struct Cut {
    segments: Vec<Segment>,
    /// Straight strip from hip to tip; empty for plates.
    chord: Vec<Segment>,
    width: f64,
    half_thickness: f64,
}

impl Cut {
    pub fn new(intruder: &Intruder) -> Result<Self> {
        Ok(match *intruder {
            Intruder::Leg { chord, width, xi_deg, thickness } => Cut {
                segments: Shape::two_piece(xi_deg)?.segments(chord, width, SEGMENTS)?,
                chord: straight([0.0, 0.0], [0.0, -chord], width, SEGMENTS),
                width,
                half_thickness: thickness.unwrap_or(0.0) / 2.0,
            },
            Intruder::Plate { length, width, thickness } => Cut {
                segments: straight([-length / 2.0, 0.0], [length / 2.0, 0.0], width, SEGMENTS),
                chord: Vec::new(),
                width,
                half_thickness: thickness.unwrap_or(0.0) / 2.0,
            },
        })
    }
}

/// Inertial drag of another form: the extra stress is −λ ρ v0² (v_n/v0)^q n. At the speed v0 it is that of the catalogue's law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PowerDrag {
    pub exponent: f64,
    /// v0 [m/s]
    pub speed: f64,
}

impl PowerDrag {
    /// How much more than v_n² stands there [m²/s²].
    fn beyond_square(&self, speed: f64) -> f64 {
        self.speed.powi(2) * (speed / self.speed).powf(self.exponent) - speed * speed
    }
}

/// One track under one set of mechanisms.
pub struct Arm<'a> {
    pub track: &'a Track,
    pub cut: &'a Cut,
    pub mechanisms: &'a Mechanisms,
    pub sand: SandMechanisms<f64>,
    pub ground: &'a Ground<f64>,
    /// [`crate::sand::beyond::footprint`] of the track's pass.
    pub footprint: f64,
    /// λ ρ [kg/m³] and the form of inertial drag, where it is another than the catalogue's.
    pub other_drag: Option<(f64, PowerDrag)>,
}

impl Arm<'_> {
    /// Loads as logged, one a pose.
    pub fn readings(&self) -> Vec<Load> {
        let m = self.mechanisms;
        let mut loads: Vec<Load> = if m.lowpass > 0.0 {
            self.filtered(m.lowpass)
        } else {
            self.track.poses.iter().enumerate().map(|(i, p)| self.load(&self.late(i, p))).collect()
        };
        let (sin, cos) = m.sensor_tilt.sin_cos();
        for load in &mut loads {
            let (fx, fz) = (load.fx, load.fz);
            load.fx = fx * cos - fz * sin + m.bias_x;
            load.fz = fx * sin + fz * cos + m.bias_z;
        }
        loads
    }

    /// The pose whose force is logged at sample `index`: `delay` earlier.
    fn late(&self, index: usize, pose: &Pose) -> Pose {
        if self.mechanisms.delay == 0.0 { *pose } else { self.pose_at(pose.t - self.mechanisms.delay, index) }
    }

    /// Pose at time `t`: cubic Hermite through the samples, constant velocity beyond them; `near` is a sample close by.
    fn pose_at(&self, t: f64, near: usize) -> Pose {
        let poses = &self.track.poses;
        let mut right = near.min(poses.len() - 1);
        while right > 0 && poses[right].t > t {
            right -= 1;
        }
        let a = &poses[right];
        let Some(b) = poses.get(right + 1).filter(|_| t >= a.t) else {
            let dt = t - a.t;
            let center = [0, 1].map(|k| a.center[k] + a.velocity[k] * dt);
            return Pose { t, theta: a.theta + a.omega * dt, center, ..*a };
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
        Pose {
            t,
            theta: hermite(a.theta, a.omega, b.theta, b.omega),
            omega: between(a.omega, b.omega),
            center: [0, 1].map(|k| hermite(a.center[k], a.velocity[k], b.center[k], b.velocity[k])),
            velocity: [0, 1].map(|k| between(a.velocity[k], b.velocity[k])),
        }
    }

    /// Loads behind a first-order filter of time constant `tau` [s], settled half a sample before the log: τ ẏ = F − y.
    fn filtered(&self, tau: f64) -> Vec<Load> {
        let poses = &self.track.poses;
        let start = poses[0].t - poses.get(1).map_or(0.0, |p| 0.5 * (p.t - poses[0].t));
        let mut out: Vec<Load> = Vec::with_capacity(poses.len());
        for i in 0..poses.len() {
            // A fast filter sees only the last moments: quadrature. A slow one is stepped through the samples.
            let fast = i == 0 || tau < 2.0 * (poses[i].t - poses[i - 1].t);
            out.push(if fast { self.remembered(i, tau, start) } else { self.stepped(i, tau, out[i - 1]) });
        }
        out
    }

    /// y(t) = ∫ e^(−u) F(t − τ u) du by Gauss-Laguerre quadrature (Abramowitz & Stegun table 25.9, n = 8).
    fn remembered(&self, i: usize, tau: f64, start: f64) -> Load {
        const NODES: [(f64, f64); 8] = [
            (0.170_279_632_305, 3.691_885_893_42e-1),
            (0.903_701_776_799, 4.187_867_808_14e-1),
            (2.251_086_629_87, 1.757_949_866_37e-1),
            (4.266_700_170_29, 3.334_349_226_12e-2),
            (7.045_905_402_39, 2.794_536_235_23e-3),
            (10.758_516_010_2, 9.076_508_773_36e-5),
            (15.740_678_641_3, 8.485_746_716_27e-7),
            (22.863_131_736_9, 1.048_001_174_87e-9),
        ];
        let t = self.track.poses[i].t;
        NODES.iter().fold(Load::default(), |sum, (u, weight)| {
            let then = (t - tau * u).max(start);
            let f = self.load(&self.pose_at(then - self.mechanisms.delay, i));
            Load { fx: sum.fx + weight * f.fx, fz: sum.fz + weight * f.fz, ty: sum.ty + weight * f.ty }
        })
    }

    /// The filter's state at sample `i` from that at the sample before, exact for a force linear between steps.
    fn stepped(&self, i: usize, tau: f64, mut state: Load) -> Load {
        let (from, to) = (self.track.poses[i - 1].t, self.track.poses[i].t);
        let h = (to - from) / FILTER_STEPS as f64;
        let decay = (-h / tau).exp();
        // weights of the force at the start and the end of a step
        let end = 1.0 - (1.0 - decay) * tau / h;
        let start = 1.0 - decay - end;
        let at = |step: usize| {
            let t = from + h * step as f64;
            self.load(&self.pose_at(t - self.mechanisms.delay, i))
        };
        let mut before = at(0);
        for step in 1..=FILTER_STEPS {
            let now = at(step);
            let next = |y: f64, a: f64, b: f64| decay * y + start * a + end * b;
            state = Load {
                fx: next(state.fx, before.fx, now.fx),
                fz: next(state.fz, before.fz, now.fz),
                ty: next(state.ty, before.ty, now.ty),
            };
            before = now;
        }
        state
    }

    /// Load at a pose.
    fn load(&self, pose: &Pose) -> Load {
        let acceleration = if self.mechanisms.added_mass == 0.0 { [0.0; 3] } else { self.acceleration(pose.t) };
        match self.track.intruder {
            Intruder::Plate { .. } => self.plate(pose, acceleration),
            Intruder::Leg { .. } => {
                let mut lagged = *pose;
                if self.mechanisms.compliance != 0.0 {
                    // Two rounds of θ = θ_motor + torque × compliance: the torque changes little over the lag.
                    for _ in 0..2 {
                        lagged.theta = pose.theta + self.mechanisms.compliance * self.leg(&lagged, acceleration[0]).ty;
                    }
                }
                self.leg(&lagged, acceleration[0])
            }
        }
    }

    /// Angular acceleration [rad/s²] and the centre's acceleration [m/s²] at time `t`: slopes of the polynomial through the
    /// logged velocities of the nearest samples (Lagrange), which needs no even sampling and no sample beyond an end. Before
    /// and after the log they are those of its ends.
    fn acceleration(&self, t: f64) -> [f64; 3] {
        let poses = &self.track.poses;
        let t = t.clamp(poses[0].t, poses[poses.len() - 1].t);
        let count = poses.len().min(STENCIL);
        let after = poses.partition_point(|p| p.t < t);
        let nearest = if after > 0 && t - poses[after - 1].t < poses[after].t - t { after - 1 } else { after };
        let near = &poses[nearest.saturating_sub(STENCIL / 2).min(poses.len() - count)..][..count];
        let others = |j: usize| (0..count).filter(move |&m| m != j);
        near.iter().enumerate().fold([0.0; 3], |sum, (j, pose)| {
            let share = |k: usize| (t - near[k].t) / (pose.t - near[k].t);
            let without = |m: usize| others(j).filter(|&k| k != m).map(share).product::<f64>();
            let weight: f64 = others(j).map(|m| without(m) / (pose.t - near[m].t)).sum();
            let moving = [pose.omega, pose.velocity[0], pose.velocity[1]];
            [0, 1, 2].map(|axis| sum[axis] + weight * moving[axis])
        })
    }

    fn plate(&self, pose: &Pose, acceleration: [f64; 3]) -> Load {
        let (sin, cos) = self.track.beta.sin_cos();
        let origin = [pose.center[0], pose.center[1] - self.mechanisms.depth_zero];
        self.sum(&self.cut.segments, origin, (sin, cos), |_| pose.velocity, |_| [acceleration[1], acceleration[2]])
    }

    fn leg(&self, pose: &Pose, angular_acceleration: f64) -> Load {
        let turn = pose.theta.sin_cos();
        let origin = [0.0, self.track.hip_height - self.mechanisms.depth_zero];
        let velocity = |r: [f64; 2]| [-pose.omega * r[1], pose.omega * r[0]];
        // Only the tangential part: the normal turns with the leg, so the centripetal part does not change v·n.
        let change = |r: [f64; 2]| [-angular_acceleration * r[1], angular_acceleration * r[0]];
        let full = self.sum(&self.cut.segments, origin, turn, velocity, change);
        let Intruder::Leg { xi_deg, .. } = self.track.intruder else {
            return full;
        };
        let chi = self.mechanisms.concave_fill;
        // Bulging forward (ξ > 0) and turning backward, or the reverse: the concave side leads.
        if chi == 0.0 || xi_deg * pose.omega >= 0.0 {
            return full;
        }
        let chord = self.sum(&self.cut.chord, origin, turn, velocity, change);
        let mix = |segments: f64, straight: f64| (1.0 - chi) * segments + chi * straight;
        Load { fx: mix(full.fx, chord.fx), fz: mix(full.fz, chord.fz), ty: mix(full.ty, chord.ty) }
    }

    /// Sums stress over segments turned by (sin, cos) counter-clockwise about `origin`.
    fn sum(
        &self,
        segments: &[Segment],
        origin: [f64; 2],
        (sin, cos): (f64, f64),
        velocity: impl Fn([f64; 2]) -> [f64; 2],
        change: impl Fn([f64; 2]) -> [f64; 2],
    ) -> Load {
        let turn = |p: [f64; 2]| [p[0] * cos - p[1] * sin, p[0] * sin + p[1] * cos];
        let mut load = Load::default();
        let slope = self.mechanisms.slope.sin_cos();
        for s in segments {
            let r = turn(s.center);
            // Well above the surface, whatever side leads: nothing to do.
            if slope_depth(slope, origin[0] + r[0], origin[1] + r[1]) < -self.cut.half_thickness {
                continue;
            }
            let n = turn(s.normal);
            let (v, dv) = (velocity(r), change(r));
            let along = n[0] * v[0] + n[1] * v[1];
            let lead = if along < 0.0 { -1.0 } else { 1.0 };
            // The stress acts on the leading face, half a thickness ahead of the mid-surface.
            let ahead = lead * self.cut.half_thickness;
            let (x, z) = (origin[0] + r[0] + n[0] * ahead, origin[1] + r[1] + n[1] * ahead);
            let (depth, (s_sin, s_cos)) = (slope_depth(slope, x, z), slope);
            if depth <= 0.0 {
                continue;
            }
            let into = |p: [f64; 2]| Vec3::new(p[0] * s_cos + p[1] * s_sin, 0.0, p[1] * s_cos - p[0] * s_sin);
            let site = Site {
                depth,
                x: self.track.x_bed + x,
                footprint: self.footprint,
                width: self.cut.width,
                normal_acceleration: lead * (n[0] * dv[0] + n[1] * dv[1]),
                passes: f64::from(self.track.pass.max(1) - 1),
                // A log says where the intruder is, not what of its motion is travel.
                travel: [0.0; 2],
            };
            let stress = self.sand.stress(self.ground, into(n), into(v), &site);
            let more = self.other_drag.map_or(0.0, |(density, law)| density * law.beyond_square(along.abs()) * lead);
            let fx = (stress.x * s_cos - stress.z * s_sin - more * n[0]) * s.area;
            let fz = (stress.x * s_sin + stress.z * s_cos - more * n[1]) * s.area;
            load.fx += fx;
            load.fz += fz;
            load.ty += r[0] * fz - r[1] * fx;
        }
        load
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sand::{Law, Medium, Surface};

    /// A speed that swings once in about thirteen unevenly spaced samples: its change is found at, between and beyond samples.
    #[test]
    fn accelerations_are_found_up_to_the_ends_of_a_log() {
        let swing = 2.0 * std::f64::consts::PI / 13.0;
        let times = (0..40).map(|i| f64::from(i) + 0.2 * f64::from(i * 7 % 5 - 2) / 2.0);
        let pose =
            |t: f64| Pose { t, omega: 3.0 + (swing * t).sin(), velocity: [(swing * t).cos(), 2.0], ..Pose::default() };
        let poses: Vec<Pose> = times.map(pose).collect();
        let ends = [poses[0].t, poses[39].t];
        let intruder = Intruder::Plate { length: 0.04, width: 0.025, thickness: None };
        let (track, mechanisms) = (Track::leg(intruder, 0.0, poses), Mechanisms::default());
        let ground = Ground::new(Law::Li2013, &Medium::named("poppy-loose").unwrap(), &Surface::DEFAULT);
        let arm = Arm {
            track: &track,
            cut: &Cut::new(&intruder).unwrap(),
            mechanisms: &mechanisms,
            sand: SandMechanisms::new(&mechanisms, 640.0),
            ground: &ground,
            footprint: 1.0,
            other_drag: None,
        };
        for k in -20..900 {
            let t = (0.05 * f64::from(k)).clamp(ends[0], ends[1]);
            let [turn, x, z] = arm.acceleration(0.05 * f64::from(k));
            let wrong =
                (turn - swing * (swing * t).cos()).abs().max((x + swing * (swing * t).sin()).abs()).max(z.abs());
            assert!(wrong < 0.02 * swing, "{t}: {wrong}");
        }
    }
}
