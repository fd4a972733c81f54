//! The torque that the servos requested from the motors. A weak motor gives less.
//!
//! In a replay the joints move as logged, so it cannot show that they lagged behind their command. But the servo's law gives the
//! requested torque from the commanded and the logged angles. In this file, `asked` is the requested torque and `given` the motor's
//! torque.

use super::log::Run;
use super::replay::{ReplayRobot, smoothed};
use super::windows::{Integral, Window, bins};
use crate::error::Result;
use crate::series::central_difference;
use crate::sim::walk::hip_angle;
use std::f64::consts::TAU;

/// Requested torques are cut off at this multiple of the largest logged torque: our choice. If a joint is far behind its command,
/// the request may be arbitrarily large, and contains no information on the motor.
const MOST: f64 = 2.0;

/// Time after which the hips turn steadily [s]: the protocol's hold and ramp end at 0.5 s; 0.1 s more is our choice.
const SETTLED: f64 = 0.6;

/// Fewest samples of steady turning: our choice, because the offset in [`zero`] is found from them.
const FEWEST: usize = 30;

/// Requested torques of one run.
struct OfRun {
    /// Joint by joint, sample by sample [N·m].
    joints: Vec<Vec<f64>>,
    /// First sample of steady turning.
    turning: usize,
    /// Torque at which the requests are cut off [N·m].
    most: f64,
    /// Is the angle of each joint at the start of its command known?
    exact: bool,
}

/// Requested torques of all runs.
pub struct RequestedTorques {
    runs: Vec<OfRun>,
}

/// The requested torques of a log. None if the log does not give the hips' command, if the robot has no servo, or if its joints do not
/// turn.
pub fn asked(runs: &[Run], bodies: &[ReplayRobot]) -> Result<Option<RequestedTorques>> {
    let runs: Option<Vec<_>> = runs.iter().zip(bodies).map(|(run, body)| of_run(run, body)).collect();
    Ok(runs.map(|runs| RequestedTorques { runs }))
}

fn of_run(run: &Run, body: &ReplayRobot) -> Option<OfRun> {
    let frequency = run.frequency.filter(|frequency| turns(run, *frequency))?;
    let gains = body.gains();
    let turning = run.t.partition_point(|t| *t < run.t[0] + SETTLED);
    let mut joints = Vec::with_capacity(run.q.len());
    for (j, q) in run.q.iter().enumerate() {
        let [kp, kd] = gains[j];
        if kp <= 0.0 || q.len() < turning + FEWEST {
            return None;
        }
        let smooth = smoothed(q);
        let torque = |i: usize| {
            let [told, rate] = hip_angle(frequency, run.t[i] - run.t[0]);
            let own = run.qd.get(j).map_or_else(|| central_difference(&run.t, &smooth, i, 1), |qd| qd[i]);
            kp * (told - smooth[i]) + kd * (rate - own)
        };
        joints.push((0..q.len()).map(torque).collect());
    }
    Some(OfRun { joints, turning, most: MOST * greatest(&run.tau), exact: false })
}

/// Do the joints turn with this frequency [Hz], as the protocol's hips do, and not swing? A joint that turns makes most of these turns: our
/// choice, more than half.
fn turns(run: &Run, frequency: f64) -> bool {
    let [first, last] = [0, run.t.len() - 1].map(|i| run.t[i]);
    let half = 0.5 * frequency.abs() * TAU * (last - first);
    run.q.iter().all(|q| (q[q.len() - 1] - q[0]).abs() > half)
}

fn greatest(torques: &[Vec<f64>]) -> f64 {
    torques.iter().flatten().fold(0.0, |most: f64, torque| most.max(torque.abs()))
}

/// Number of values that are tried first for the offset in [`zero`], at even steps in the list of sorted differences: our choice.
const TRIED: usize = 24;
/// Largest number of iterations that improve the best of these values: our choice; one that does not help is the last.
const CLOSER: usize = 8;

/// The angle of a joint at the start of its command is not known, nor is the exact time of the start. So the requested torque has a
/// constant error. Returns the torque [N·m] to add to the requests with which motors with this limit give the logged torques with
/// the least squared error. Samples at the limit contain no information on this torque.
fn zero(asked: &[f64], given: &[f64], limit: f64) -> f64 {
    let mut apart: Vec<f64> = asked.iter().zip(given).map(|(a, t)| t - a).collect();
    if limit == f64::MAX {
        return apart.iter().sum::<f64>() / apart.len().max(1) as f64;
    }
    let square = |zero: f64| -> f64 {
        asked.iter().zip(given).map(|(a, t)| (t - (a + zero).clamp(-limit, limit)).powi(2)).sum()
    };
    apart.sort_by(f64::total_cmp);
    let tried = (0..TRIED).map(|k| apart[(apart.len() - 1) * k / (TRIED - 1)]).map(|z| (square(z), z));
    let Some((mut least, mut best)) = tried.min_by(|a, b| a.0.total_cmp(&b.0)) else { return 0.0 };
    for _ in 0..CLOSER {
        let free = asked.iter().zip(given).filter(|(a, _)| (**a + best).abs() < limit).map(|(a, t)| t - a);
        let (sum, count) = free.fold((0.0, 0.0), |(s, n), v| (s + v, n + 1.0));
        let next = sum / f64::max(count, 1.0);
        if count == 0.0 || square(next) >= least {
            break;
        }
        (least, best) = (square(next), next);
    }
    best
}

impl RequestedTorques {
    /// Requests that are known exactly: `torques` run by run, joint by joint, sample by sample.
    pub fn exactly(runs: &[Run], torques: Vec<Vec<Vec<f64>>>) -> Self {
        let of = |(run, joints): (&Run, Vec<Vec<f64>>)| {
            let most = greatest(&joints);
            OfRun { joints, turning: run.t.len(), most, exact: true }
        };
        Self { runs: runs.iter().zip(torques).map(of).collect() }
    }

    /// Torques of motors with a limit [N·m], mean over the joints, at each sample of each run; a limit of 0 means no limit.
    pub fn given(&self, runs: &[Run], limit: f64) -> Vec<Vec<f64>> {
        let limit = if limit > 0.0 { limit } else { f64::MAX };
        let of = |(own, run): (&OfRun, &Run)| {
            let mut sum = vec![0.0; run.t.len()];
            for (asked, given) in own.joints.iter().zip(&run.tau) {
                let zero = if own.exact { 0.0 } else { zero(&asked[own.turning..], &given[own.turning..], limit) };
                let most = limit.min(own.most);
                let share = 1.0 / own.joints.len() as f64;
                sum.iter_mut().zip(asked).for_each(|(s, a)| *s += share * (a + zero).clamp(-most, most));
            }
            sum
        };
        self.runs.iter().zip(runs).map(of).collect()
    }
}

/// Logged torques of the motors [N·m], mean over the joints, in the parts of a window's strides.
pub fn logged(run: &Run, window: &Window) -> Vec<f64> {
    let given = |i: usize| run.tau.iter().map(|tau| tau[i]).sum::<f64>() / run.tau.len() as f64;
    means(run, window, &(0..run.t.len()).map(given).collect::<Vec<_>>())
}

/// Means of a run's samples over the parts of a window's strides.
pub fn means(run: &Run, window: &Window, values: &[f64]) -> Vec<f64> {
    let integral = Integral::new(&run.t, values);
    window.strides.iter().flat_map(|s| bins(*s)).map(|[a, b]| integral.mean(a, b)).collect()
}

#[cfg(test)]
mod tests {
    use super::zero;

    /// The offset is found although the motor is at its limit most of the time.
    #[test]
    fn a_servos_offset_is_found_despite_the_limit() {
        let asked: Vec<f64> = (0..400).map(|i| 0.03 * (0.1 * f64::from(i)).sin() + 0.02).collect();
        for (limit, hidden) in [(0.01, 0.013), (0.01, -0.05), (0.02, 0.0)] {
            let given: Vec<f64> = asked.iter().map(|a| (a + hidden).clamp(-limit, limit)).collect();
            let found = zero(&asked, &given, limit);
            assert!((found - hidden).abs() < 1e-4, "{found} of {hidden}");
        }
    }
}
