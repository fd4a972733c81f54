//! Effects, other than those of the sand, that make a log differ from its replay: mounting, delay and filter of the IMU, errors
//! of the logged torques, and friction in the joints.

use super::log::Run;
use super::model::TrajectoryModel;
use super::sensors::LoggedHardware;
use super::servo;
use super::windows::{BINS, Integral};

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
        let given = asked.given(&self.log.runs, limit);
        let means = self.windows.iter().flat_map(|w| servo::means(&self.log.runs[w.run], w, &given[w.run]));
        let means: Vec<f64> = means.map(|mean| (1.0 + hardware.servo_gain) * mean).collect();
        for (own, means) in stack.chunks_mut(self.span()).zip(means.chunks(BINS)) {
            own[channel * BINS..][..BINS].copy_from_slice(means);
        }
        stack
    }

    /// Mean direction of each joint's motion at each number of a prediction, −1 to 1; 0 at numbers that are no torques.
    pub(super) fn moving(&self) -> Vec<f64> {
        let joints = self.layout.joints;
        let signs: Vec<Vec<Vec<f64>>> = self.log.runs.iter().map(signs).collect();
        let of: Vec<Vec<Integral>> = (self.log.runs.iter().zip(&signs))
            .map(|(run, signs)| signs.iter().map(|s| Integral::new(&run.t, s)).collect())
            .collect();
        self.stack(|run, channel, [a, b]| if channel < joints { of[run][channel].mean(a, b) } else { 0.0 })
    }
}

/// Direction of each joint's motion at each sample, −1 to 1.
fn signs(run: &Run) -> Vec<Vec<f64>> {
    let of = |q: &Vec<f64>| (0..q.len()).map(|i| (servo::slope(&run.t, q, i, 2) / FRICTION_SPEED).tanh()).collect();
    run.q.iter().map(of).collect()
}
