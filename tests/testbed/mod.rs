//! Simulated measurements: force logs with a hidden cause, by code that is independent of the forward model.
//!
//! It shares no code with `src/`. It computes attack and intrusion angles with sines and cosines instead of the form without
//! trigonometry, takes 53 segments for each piece, and integrates delay and filter over time. The laws are those of the specification,
//! so an error that both made in reading it would not show here.

mod design;
#[allow(dead_code)] // not every test uses it
pub mod dirt;
#[allow(dead_code)] // not every test uses it
pub mod rests;

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use std::fmt::Write;

pub use design::Design;
use design::design;

pub const EXPERIMENT: &str = r#"kind = "intrusion"
medium = "poppy-loose"
bulk_density = 640.0
coefficient_sd = 0.08
[shape.L]
type = "leg"
chord = 0.076
width = 0.025
xi_deg = 45.0
[shape.revL]
type = "leg"
chord = 0.076
width = 0.025
xi_deg = -45.0
[shape.flat]
type = "leg"
chord = 0.076
width = 0.025
xi_deg = 0.0
[shape.plate]
type = "plate"
length = 0.038
width = 0.025
"#;

/// Coefficients of loosely packed poppy seeds [N/m³].
pub const TABLE: [f64; 9] = [51e3, 47e3, 53e3, 83e3, 20e3, -26e3, 57e3, 0.0, 25e3];
const DENSITY: f64 = 640.0;
const CHORD: f64 = 0.076;
const WIDTH: f64 = 0.025;
const PLATE: f64 = 0.038;
const PIECES: usize = 53;
const SAMPLES: usize = 40;

/// The hidden causes, by id: those of the diagnosis, or one that only this test bed has.
#[derive(Clone, Debug, Default)]
pub struct Hidden {
    pub causes: Vec<(&'static str, f64)>,
}

impl Hidden {
    fn get(&self, id: &str) -> f64 {
        self.causes.iter().find(|c| c.0 == id).map_or(0.0, |c| c.1)
    }
}

#[derive(Clone)]
struct Trial {
    shape: &'static str,
    xi: f64,
    leg: bool,
    hip: f64,
    rate: f64,
    wobble: f64,
    beta: f64,
    gamma: f64,
    start: f64,
    duration: f64,
    pass: u32,
    pass_dx: f64,
    x_bed: f64,
}

/// A force log with and without noise.
pub struct Log {
    pub noisy: String,
    pub clean: String,
    /// Root mean square of the hidden effect, relative to the noise.
    pub effect: f64,
}

pub const GAIN: f64 = 0.05;
pub const GRAIN: f64 = 0.04;
pub const SENSOR: f64 = 0.03;
pub const PHI: f64 = 0.7;
pub const ARM: f64 = 0.05;

pub fn normal(rng: &mut Xoshiro256PlusPlus) -> f64 {
    StandardNormal.sample(rng)
}

/// α_x and α_z [N/m³] for motion toward +x.
pub fn stress_per_depth(c: &[f64; 9], beta: f64, gamma: f64) -> [f64; 2] {
    let az = c[0]
        + c[1] * (2.0 * beta).cos()
        + c[2] * (2.0 * beta + gamma).sin()
        + c[3] * gamma.sin()
        + c[4] * (gamma - 2.0 * beta).sin();
    let ax = c[5] * (2.0 * beta + gamma).cos()
        + c[6] * gamma.cos()
        + c[7] * (gamma - 2.0 * beta).cos()
        + c[8] * (2.0 * beta).sin();
    [ax, az]
}

impl Trial {
    /// Path and its first two derivatives at time t; the speed oscillates three times during the trial.
    fn path(&self, t: f64) -> (f64, f64, f64) {
        let k = 6.0 * std::f64::consts::PI / self.duration;
        let w = self.wobble;
        (
            self.rate * (t - w / k * (k * t).sin()),
            self.rate * (1.0 - w * (k * t).cos()),
            self.rate * w * k * (k * t).sin(),
        )
    }

    fn center(&self, s: f64) -> [f64; 2] {
        [s * self.gamma.cos() - 0.02 * f64::from(u8::from(self.gamma == 0.0)), -self.start - s * self.gamma.sin()]
    }

    /// Fx, Fz, Ty at time t, before the sensor.
    fn load(&self, t: f64, c: &[f64; 9], h: &Hidden) -> [f64; 3] {
        if !self.leg {
            return self.plate(t, c, h);
        }
        let (s, omega, alpha) = self.path(t);
        let mut theta = -1.75 + s;
        let lag = h.get("compliance");
        for _ in 0..if lag == 0.0 { 0 } else { 4 } {
            theta = -1.75 + s + lag * self.leg(theta, omega, alpha, c, h)[2];
        }
        self.leg(theta, omega, alpha, c, h)
    }

    fn leg(&self, theta: f64, omega: f64, alpha: f64, c: &[f64; 9], h: &Hidden) -> [f64; 3] {
        let knee = [CHORD * self.xi.cos() * self.xi.sin(), -CHORD * self.xi.cos().powi(2)];
        let (hip, tip) = ([0.0, 0.0], [0.0, -CHORD]);
        let chi = h.get("concave_fill");
        let mut total = [0.0; 3];
        let mut add = |a: [f64; 2], b: [f64; 2], weight: f64| {
            for k in 0..PIECES {
                let u = (k as f64 + 0.5) / PIECES as f64;
                let p = [a[0] + u * (b[0] - a[0]), a[1] + u * (b[1] - a[1])];
                let r = [p[0] * theta.cos() - p[1] * theta.sin(), p[0] * theta.sin() + p[1] * theta.cos()];
                let length = (b[0] - a[0]).hypot(b[1] - a[1]);
                let tilt = (b[1] - a[1]).atan2(b[0] - a[0]) + theta;
                let (v, dv) = ([-omega * r[1], omega * r[0]], [-alpha * r[1], alpha * r[0]]);
                let f = self.segment([r[0], r[1] + self.hip], tilt, v, dv, length / PIECES as f64 * WIDTH, c, h);
                for (t, x) in total.iter_mut().zip([f[0], f[1], r[0] * f[1] - r[1] * f[0]]) {
                    *t += weight * x;
                }
            }
        };
        let pieces = if self.xi == 0.0 { vec![(hip, tip)] } else { vec![(hip, knee), (knee, tip)] };
        let concave = self.xi * omega < 0.0;
        for (a, b) in pieces {
            add(a, b, if concave { 1.0 - chi } else { 1.0 });
        }
        if concave && chi != 0.0 {
            add(hip, tip, chi);
        }
        total
    }

    fn plate(&self, t: f64, c: &[f64; 9], h: &Hidden) -> [f64; 3] {
        let (s, speed, change) = self.path(t);
        let center = self.center(s);
        let along = [self.gamma.cos(), -self.gamma.sin()];
        let mut total = [0.0; 3];
        for k in 0..PIECES {
            let u = PLATE * ((k as f64 + 0.5) / PIECES as f64 - 0.5);
            let r = [u * self.beta.cos(), u * self.beta.sin()];
            let p = [center[0] + r[0], center[1] + r[1]];
            let f = self.segment(
                p,
                self.beta,
                along.map(|a| a * speed),
                along.map(|a| a * change),
                PLATE / PIECES as f64 * WIDTH,
                c,
                h,
            );
            for (t, x) in total.iter_mut().zip([f[0], f[1], r[0] * f[1] - r[1] * f[0]]) {
                *t += x;
            }
        }
        total
    }

    /// Force on a segment that is tilted by `tilt` from the horizontal.
    #[allow(clippy::too_many_arguments)]
    fn segment(
        &self,
        p: [f64; 2],
        tilt: f64,
        v: [f64; 2],
        dv: [f64; 2],
        area: f64,
        c: &[f64; 9],
        h: &Hidden,
    ) -> [f64; 2] {
        let sigma = h.get("slope");
        let z = p[1] - h.get("depth_zero");
        let mut depth = (p[0] * sigma.tan() - z) * sigma.cos();
        if depth <= 0.0 {
            return [0.0, 0.0];
        }
        // In the surface's frame, all angles are smaller by σ.
        let speed = v[0].hypot(v[1]).max(1e-12);
        let mut gamma = -(v[1].atan2(v[0]) - sigma);
        let mut beta = tilt - sigma;
        let mirrored = gamma.cos() < 0.0;
        if mirrored {
            gamma = std::f64::consts::PI - gamma;
            beta = -beta;
        }
        let [ax, az] = stress_per_depth(c, beta, gamma);
        let n = [tilt.sin(), -tilt.cos()];
        let vn = v[0] * n[0] + v[1] * n[1];
        let n = if vn < 0.0 { n.map(|c| -c) } else { n };
        let (vn, dvn) = (vn.abs(), dv[0] * n[0] + dv[1] * n[1]);
        depth = 0.02 * (depth / 0.02).powf(1.0 + h.get("depth_power"));
        depth *= self.outside(p, depth, h);
        let mut factor = (1.0 + h.get("scale")) * (1.0 + h.get("packing_grad") * (self.x_bed + p[0]) / 0.1);
        factor *= 1.0 + h.get("rate_log") * (speed / 0.01).ln_1p();
        let length = if self.leg { CHORD } else { PLATE };
        factor *= ((length * WIDTH).sqrt() / 0.05).powf(h.get("size_power"));
        if self.pass >= 2 {
            factor *= 1.0 - h.get("footprint") * (-self.pass_dx / 0.03).exp();
        }
        let local = [if mirrored { ax } else { -ax }, az].map(|a| a * depth * factor);
        let mut stress =
            [local[0] * sigma.cos() - local[1] * sigma.sin(), local[0] * sigma.sin() + local[1] * sigma.cos()];
        let clip = h.get("friction_clip");
        if clip > 0.0 {
            let normal = stress[0] * n[0] + stress[1] * n[1];
            let t = [stress[0] - normal * n[0], stress[1] - normal * n[1]];
            let share = (normal.abs() / clip / t[0].hypot(t[1]).max(1e-12)).min(1.0);
            stress = [normal * n[0] + share * t[0], normal * n[1] + share * t[1]];
        }
        let pressure = h.get("inertial_drag") * DENSITY * vn * vn
            + h.get("drag_1.5") * DENSITY * vn.powf(1.5)
            + h.get("added_mass") * DENSITY * WIDTH * dvn
            + h.get("cohesion") * (vn / 1e-3).tanh();
        [(stress[0] - pressure * n[0]) * area, (stress[1] - pressure * n[1]) * area]
    }

    /// Causes that the diagnosis does not know.
    fn outside(&self, p: [f64; 2], depth: f64, h: &Hidden) -> f64 {
        let x = self.x_bed + p[0];
        let crust = if depth < 0.012 { 1.0 + h.get("crust") } else { 1.0 };
        let slip = 1.0 + h.get("stick_slip") * (2.0 * std::f64::consts::PI * (p[0] + p[1]) / 0.02).sin();
        let buried =
            1.0 + h.get("buried_stone") * (-((x - 0.03) / 0.015).powi(2) - ((p[1] + 0.02) / 0.012).powi(2)).exp();
        (1.0 + h.get("wall") * (-(0.12 - x).max(0.0) / 0.04).exp()) * crust * slip * buried
    }

    /// The sensor's reading at time t.
    fn reading(&self, t: f64, c: &[f64; 9], h: &Hidden) -> [f64; 3] {
        let late = h.get("delay");
        let tau = h.get("lowpass");
        let f = if tau > 0.0 {
            // τ ẏ = F − y from rest at the first force, by the exponential kernel on 400 steps over 12 τ
            let (mut sum, mut weight) = ([0.0; 3], 0.0);
            for k in 0..400 {
                let back = 12.0 * tau * (k as f64 + 0.5) / 400.0;
                let w = (-back / tau).exp();
                let f = self.load((t - back - late).max(0.0), c, h);
                sum = [0, 1, 2].map(|i| sum[i] + w * f[i]);
                weight += w;
            }
            sum.map(|s| s / weight)
        } else {
            self.load(t - late, c, h)
        };
        let (sin, cos) = h.get("sensor_tilt").sin_cos();
        [f[0] * cos - f[1] * sin + h.get("bias_x"), f[0] * sin + f[1] * cos + h.get("bias_z"), f[2]]
    }
}

/// Makes a log; `coefficient_error` is relative to each coefficient (that of C₋₁₁ to D10's size).
pub fn log(seed: u64, hidden: &Hidden, coefficient_error: f64) -> Log {
    log_of(Design::Crossed, seed, hidden, coefficient_error)
}

/// The same with another design of the trials.
pub fn log_of(kind: Design, seed: u64, hidden: &Hidden, coefficient_error: f64) -> Log {
    noisy_log(kind, 1.0, seed, hidden, coefficient_error)
}

/// The same with all noise multiplied by `loud`.
pub fn noisy_log(kind: Design, loud: f64, seed: u64, hidden: &Hidden, coefficient_error: f64) -> Log {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let trials = design(&mut rng, kind);
    let mut c = TABLE;
    for (k, c) in c.iter_mut().enumerate() {
        *c += coefficient_error * normal(&mut rng) * if k == 7 { TABLE[8] } else { c.abs() };
    }
    let header = "trial,condition,rep,kind,shape,medium,hip_z,plate_beta,plate_gamma,pass,pass_dx,x_bed,t,theta,omega,x,z,vx,vz,Fx,Fz,Ty\n";
    let (mut noisy, mut clean) = (header.to_string(), header.to_string());
    let (mut effect, mut noise) = (0.0, 0.0);
    for (condition, trial) in trials.iter().enumerate() {
        let times: Vec<f64> = (0..SAMPLES).map(|i| (i as f64 + 0.5) / SAMPLES as f64 * trial.duration).collect();
        let truth: Vec<[f64; 3]> = times.iter().map(|t| trial.reading(*t, &c, hidden)).collect();
        let plain: Vec<[f64; 3]> = times.iter().map(|t| trial.reading(*t, &c, &Hidden::default())).collect();
        for rep in 0..3 {
            let gain = 1.0 + loud * GAIN * normal(&mut rng);
            let mut grain = [0; 3].map(|_| normal(&mut rng));
            for (i, t) in times.iter().enumerate() {
                let f = truth[i];
                let size = f[0].hypot(f[1]);
                let arm = [1.0, 1.0, ARM].map(|arm| loud * arm);
                let measured =
                    [0, 1, 2].map(|k| f[k] * gain + arm[k] * (GRAIN * size * grain[k] + SENSOR * normal(&mut rng)));
                grain = grain.map(|g| PHI * g + (1.0 - PHI * PHI).sqrt() * normal(&mut rng));
                effect += (0..2).map(|k| (f[k] - plain[i][k]).powi(2)).sum::<f64>();
                noise += (0..2).map(|k| (f[k] - measured[k]).powi(2)).sum::<f64>();
                let motion = trial.motion(*t);
                for (text, y) in [(&mut noisy, measured), (&mut clean, f)] {
                    let _ = writeln!(
                        text,
                        "{condition}_{rep},{condition},{rep},{motion},{:.6e},{:.6e},{:.6e}",
                        y[0], y[1], y[2]
                    );
                }
            }
        }
    }
    Log { noisy, clean, effect: (effect / noise).sqrt() }
}

impl Trial {
    /// The columns from `kind` to `vz` of one row.
    fn motion(&self, t: f64) -> String {
        let (s, rate, _) = self.path(t);
        let tail = format!("{},{},{}", self.pass, self.pass_dx, self.x_bed);
        if self.leg {
            return format!(
                "leg,{},poppy-loose,{},,,{tail},{t:.9},{:.9},{rate:.9},0,0,0,0",
                self.shape,
                self.hip,
                -1.75 + s
            );
        }
        let [x, z] = self.center(s);
        let v = [rate * self.gamma.cos(), -rate * self.gamma.sin()];
        format!(
            "plate,plate,poppy-loose,,{:.9},{:.9},{tail},{t:.9},,,{x:.9},{z:.9},{:.9},{:.9}",
            self.beta, self.gamma, v[0], v[1]
        )
    }
}
