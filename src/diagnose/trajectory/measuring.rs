//! Nuisances of a robot's log: rotation and delay of the IMU, and friction in the joints.

use super::log::Run;
use super::model::TrajectoryModel;
use super::replay::{BEYOND, Signals};
use super::sensors::Mounting;
use super::windows::{BINS, Integral};
use crate::fit::slope;
use crate::nuisance::Nuisance;

/// Joint speed over which the friction changes its sign [rad/s]: our choice, below the speeds of a stride.
const FRICTION_SPEED: f64 = 0.5;
/// Steps of the IMU's rotation [rad] and delay [s] for derivatives: our choices.
const TURN_STEP: f64 = 1e-3;
const DELAY_STEP: f64 = 1e-3;

impl TrajectoryModel<'_> {
    /// Root mean square of all torques of a prediction [N·m].
    pub(super) fn torque_rms(&self, prediction: &[f64]) -> f64 {
        let own = prediction.chunks(self.span()).flat_map(|unit| &unit[..self.layout.joints * BINS]);
        let (square, count) = own.fold((0.0, 0.0), |(s, n), v| (s + v * v, n + 1.0));
        (square / f64::max(count, 1.0)).sqrt().max(1e-9)
    }

    pub(super) fn friction(&self, rms: f64) -> Nuisance {
        let joints = self.layout.joints;
        let signs: Vec<Vec<Vec<f64>>> = self.log.runs.iter().map(signs).collect();
        let of: Vec<Vec<Integral>> = (self.log.runs.iter().zip(&signs))
            .map(|(run, signs)| signs.iter().map(|s| Integral::new(&run.t, s)).collect())
            .collect();
        let column =
            self.stack(|run, channel, [a, b]| if channel < joints { of[run][channel].mean(a, b) } else { 0.0 });
        Nuisance::linear("friction".into(), "N·m", self.priors.sd("friction") * rms, column)
    }

    /// Rotation and delay of the IMU, linearised at `values`. Neither is linear, so the first nuisance carries the
    /// difference between the prediction at `values` and its linear continuation from 0.
    pub(super) fn mounting(&self, tracks: &[Signals], values: &[(String, f64)]) -> Vec<Nuisance> {
        const NAMES: [&str; 4] = ["imu_rotation_x", "imu_rotation_y", "imu_rotation_z", "imu_delay"];
        let value = |id: &str| values.iter().find(|v| v.0 == id).map_or(0.0, |v| v.1);
        let at = NAMES.map(value);
        // A log is not early by more than 10 ms, and the simulation ends `BEYOND` after the window.
        let mounted = |v: [f64; 4]| Mounting { turn: [v[0], v[1], v[2]], delay: v[3].clamp(-0.01, BEYOND) };
        let here = self.read(tracks, mounted(at));
        let mut bend = slope(&here, &self.read(tracks, Mounting::default()), 1.0);
        let mut all = Vec::new();
        for (k, name) in NAMES.into_iter().enumerate() {
            let (step, unit, prior) =
                if k < 3 { (TURN_STEP, "rad", "imu_rotation") } else { (DELAY_STEP, "s", "imu_delay") };
            let mut moved = at;
            moved[k] += step;
            let rate = slope(&self.read(tracks, mounted(moved)), &here, step);
            bend.iter_mut().zip(&rate).for_each(|(b, r)| *b -= at[k] * r);
            all.push(Nuisance::linear(name.into(), unit, self.priors.sd(prior), rate));
        }
        let first = all.remove(0).bent(bend);
        all.insert(0, first);
        all
    }
}

/// Direction of each joint's motion at each sample, −1 to 1.
fn signs(run: &Run) -> Vec<Vec<f64>> {
    let of = |q: &Vec<f64>| {
        let rate = |i: usize| {
            let (a, b) = (i.saturating_sub(2), (i + 2).min(q.len() - 1));
            (q[b] - q[a]) / (run.t[b] - run.t[a])
        };
        (0..q.len()).map(|i| (rate(i) / FRICTION_SPEED).tanh()).collect()
    };
    run.q.iter().map(of).collect()
}
