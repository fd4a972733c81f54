//! Effects, other than those of the sand, that make a log differ from its replay: mounting, delay and filter of the IMU, errors
//! of the logged torques, and friction in the joints.

use super::log::Run;
use super::model::TrajectoryModel;
use super::replay::{BEYOND, Signals};
use super::sensors::{LoggedHardware, Mounting};
use super::servo;
use super::windows::{BINS, Integral};
use crate::fit::slope;
use crate::nuisance::{Nuisance, NuisanceState, Priors, estimate};
use crate::series::{central_difference, root_mean_square};

/// Steps of the IMU's rotation [rad] and delay [s] for derivatives: our choices, small against the priors.
const TURN_STEP: f64 = 1e-3;
const DELAY_STEP: f64 = 1e-3;
/// Step of the IMU's blur for derivatives [s²]: our choice, the blur of a filter of 2 ms.
const BLUR_STEP: f64 = 4e-6;
/// A channel is early by at most this time [s]: our choice.
const EARLIEST: f64 = -0.01;
/// Joint speed over which the friction changes its sign [rad/s]: our choice, below the speeds of a stride.
const FRICTION_SPEED: f64 = 0.5;

impl TrajectoryModel<'_> {
    /// The numbers of a replay as a log shows them: with errors of the logged torques, and with the torques of motors whose limit is
    /// `limit` [N·m].
    pub(super) fn logged(&self, mut stack: Vec<f64>, limit: f64, hardware: &LoggedHardware) -> Vec<f64> {
        let torques = self.layout.joints * BINS;
        if hardware.torque_gain != 0.0 || hardware.friction != 0.0 {
            let moving = self.moving.chunks(self.span());
            for (own, moving) in stack.chunks_mut(self.span()).zip(moving) {
                for (value, sign) in own.iter_mut().zip(moving).take(torques) {
                    *value = (1.0 + hardware.torque_gain) * *value + hardware.friction * sign;
                }
            }
        }
        let (Some(asked), Some(channel)) = (&self.asked, self.layout.servo_channel()) else { return stack };
        let given = asked.given(&self.runs, limit);
        let means = self.windows.iter().flat_map(|w| servo::means(&self.runs[w.run], w, &given[w.run]));
        let means: Vec<f64> = means.map(|mean| (1.0 + hardware.servo_gain) * mean).collect();
        for (own, means) in stack.chunks_mut(self.span()).zip(means.chunks(BINS)) {
            own[channel * BINS..][..BINS].copy_from_slice(means);
        }
        stack
    }

    /// Mean direction of each joint's motion at each number of a prediction, −1 to 1; 0 at numbers that are no torques.
    pub(super) fn moving(&self) -> Vec<f64> {
        let joints = self.layout.joints;
        let signs: Vec<Vec<Vec<f64>>> = self.runs.iter().map(signs).collect();
        let of: Vec<Vec<Integral>> = (self.runs.iter().zip(&signs))
            .map(|(run, signs)| signs.iter().map(|s| Integral::new(&run.t, s)).collect())
            .collect();
        self.stack(|run, channel, [a, b]| if channel < joints { of[run][channel].mean(a, b) } else { 0.0 })
    }

    /// Root mean square of all torques of a prediction [N·m].
    pub(super) fn torque_rms(&self, prediction: &[f64]) -> f64 {
        let own = prediction.chunks(self.span()).flat_map(|unit| &unit[..self.layout.joints * BINS]);
        root_mean_square(own.copied()).max(1e-9)
    }

    pub(super) fn friction(&self, rms: f64) -> Nuisance {
        Nuisance::linear("friction", "N·m", self.prior("friction") * rms, self.moving.clone())
    }

    /// Rotation, lag and blur of the IMU, linearised at `values`. The lag is the mean of the IMU's impulse response over time, the blur
    /// its variance (Elmore, J. Appl. Phys. 19, 1948): a delay adds to the mean alone, a first-order filter of time constant T adds T to
    /// the mean and T² to the variance. The effects of these quantities are not linear. So the first nuisance also contains, in its
    /// `bend`, the effect at `values` minus the linear terms from 0.
    pub(super) fn mounting(&self, tracks: &[Signals], values: &[NuisanceState]) -> Vec<Nuisance> {
        // Id, axis, and step of the derivative.
        const ALL: [(&str, Option<&str>, f64); 5] = [
            ("imu_rotation", Some("x"), TURN_STEP),
            ("imu_rotation", Some("y"), TURN_STEP),
            ("imu_rotation", Some("z"), TURN_STEP),
            ("imu_delay", None, DELAY_STEP),
            ("imu_blur", None, BLUR_STEP),
        ];
        let given = self.hardware.mounting;
        // Limits the delay: the simulation ends `BEYOND` after the window.
        let mounted = |v: [f64; 5]| {
            let low_pass = v[4].max(0.0).sqrt().min(BEYOND);
            let delay = (v[3] - low_pass).clamp(EARLIEST, BEYOND);
            let turn = [0, 1, 2].map(|k| given.turn[k] + v[k]);
            Mounting { turn, delay: given.delay + delay, low_pass: given.low_pass + low_pass, ..given }
        };
        let at = ALL.map(|(id, axis, _)| estimate(values, id, axis));
        let here = self.read(tracks, mounted(at));
        let mut bend = slope(&here, &self.read(tracks, given), 1.0);
        let mut all = Vec::new();
        for (k, (id, axis, step)) in ALL.into_iter().enumerate() {
            let sd = self.prior(id);
            if sd == 0.0 || self.is_given(id, axis) {
                continue;
            }
            let mut moved = at;
            moved[k] = if id == "imu_blur" { at[k].max(0.0) } else { at[k] } + step;
            let rate = slope(&self.read(tracks, mounted(moved)), &here, step);
            bend.iter_mut().zip(&rate).for_each(|(b, r)| *b -= at[k] * r);
            let own = Nuisance::linear(id, Priors::unit(id), sd, rate);
            all.push(match axis {
                Some(axis) => own.of(axis),
                None => own,
            });
        }
        if !all.is_empty() {
            let first = all.remove(0).bent(bend);
            all.insert(0, first);
        }
        all
    }

    /// Delay of the logged torques, linearised at its present estimate.
    pub(super) fn torque_delay(&self, tracks: &[Signals], values: &[NuisanceState]) -> Nuisance {
        const ID: &str = "torque_delay";
        let mounting = self.hardware.mounting;
        let late = |by: f64| self.read(tracks, Mounting { torque_delay: by.clamp(EARLIEST, BEYOND), ..mounting });
        let at = estimate(values, ID, None);
        let (none, there) = (late(0.0), late(at));
        let rate = slope(&late(at + DELAY_STEP), &there, DELAY_STEP);
        let bend = there.iter().zip(&none).zip(&rate).map(|((there, none), rate)| there - none - at * rate).collect();
        let sd = self.prior(ID);
        Nuisance { nearly_linear: 0.25 * sd, ..Nuisance::linear(ID, Priors::unit(ID), sd, rate).bent(bend) }
    }
}

/// Direction of each joint's motion at each sample, −1 to 1.
fn signs(run: &Run) -> Vec<Vec<f64>> {
    let of =
        |q: &Vec<f64>| (0..q.len()).map(|i| (central_difference(&run.t, q, i, 2) / FRICTION_SPEED).tanh()).collect();
    run.q.iter().map(of).collect()
}
