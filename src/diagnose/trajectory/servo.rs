//! What the servos ask of the motors: a motor that gives less is weak.
//!
//! A replay takes the joints' motion as it was, so it cannot show that they did not follow. The servo's own law can: from what
//! the hips were told and where they were it says which torque was asked for.

use super::log::{Log, Run};
use super::replay::{Body, smoothed};
use super::windows::{Integral, Window, bins};
use crate::error::Result;
use crate::sim::walk::hip_angle;

/// Torques asked for beyond this share of the greatest logged one tell nothing more: our choice. A servo that has wound up asks for
/// whatever.
const MOST: f64 = 2.0;

/// Time from which the hips turn steadily [s]: after the protocol's ramp.
const SETTLED: f64 = 0.6;

/// Fewest samples after that: our choice.
const FEWEST: usize = 30;

/// Torques asked for: run by run, joint by joint, sample by sample [N·m].
pub struct Asked {
    runs: Vec<Vec<Vec<f64>>>,
}

/// What the hips were told in a log: none where it does not say, or where the robot has no servo.
pub fn asked(log: &Log, bodies: &[Body]) -> Result<Option<Asked>> {
    let runs: Option<Vec<_>> = log.runs.iter().zip(bodies).map(|(run, body)| of_run(run, body)).collect();
    Ok(runs.map(|runs| Asked { runs }))
}

fn of_run(run: &Run, body: &Body) -> Option<Vec<Vec<f64>>> {
    let frequency = run.frequency?;
    let gains = body.gains();
    let most = MOST * run.tau.iter().flatten().fold(0.0, |m: f64, t| m.max(t.abs()));
    let turning = run.t.partition_point(|t| *t < run.t[0] + SETTLED);
    let mut all = Vec::with_capacity(run.q.len());
    for (j, q) in run.q.iter().enumerate() {
        let [kp, kd] = gains[j];
        if kp <= 0.0 || q.len() < turning + FEWEST {
            return None;
        }
        let smooth = smoothed(q);
        let torque = |i: usize| {
            let [told, rate] = hip_angle(frequency, run.t[i] - run.t[0]);
            let own = run.qd.get(j).map_or_else(|| slope(&run.t, &smooth, i), |qd| qd[i]);
            kp * (told - smooth[i]) + kd * (rate - own)
        };
        let mut asked: Vec<f64> = (0..q.len()).map(torque).collect();
        let zero = densest(asked.iter().zip(&run.tau[j]).skip(turning).map(|(a, t)| t - a).collect());
        asked.iter_mut().for_each(|torque| *torque = (*torque + zero).clamp(-most, most));
        all.push(asked);
    }
    Some(all)
}

/// Mean of the third of the values that lie closest together. Where a joint was when it was told to start, and when exactly, is known
/// from the samples that no limit touches: for them the torque given is the one asked for.
fn densest(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let third = (values.len() / 3).max(1);
    let width = |k: &usize| values[k + third - 1] - values[*k];
    let start = (0..=values.len() - third).min_by(|a, b| width(a).total_cmp(&width(b))).unwrap_or(0);
    values[start..start + third].iter().sum::<f64>() / third as f64
}

fn slope(t: &[f64], q: &[f64], i: usize) -> f64 {
    let (a, b) = (i.saturating_sub(1), (i + 1).min(q.len() - 1));
    (q[b] - q[a]) / (t[b] - t[a])
}

impl Asked {
    /// What motors with a limit give [N·m], mean over the joints: for each part of each stride of a window. A limit of 0 is none.
    pub fn given(&self, run: &Run, window: &Window, limit: f64) -> Vec<f64> {
        let asked = &self.runs[window.run];
        let most = if limit > 0.0 { limit } else { f64::MAX };
        let given = |i: usize| asked.iter().map(|a| a[i].clamp(-most, most)).sum::<f64>() / asked.len() as f64;
        mean(run, window, &(0..run.t.len()).map(given).collect::<Vec<_>>())
    }
}

/// What the motors gave [N·m], mean over the joints, as [`Asked::given`] says it.
pub fn logged(run: &Run, window: &Window) -> Vec<f64> {
    let given = |i: usize| run.tau.iter().map(|tau| tau[i]).sum::<f64>() / run.tau.len() as f64;
    mean(run, window, &(0..run.t.len()).map(given).collect::<Vec<_>>())
}

fn mean(run: &Run, window: &Window, values: &[f64]) -> Vec<f64> {
    let integral = Integral::new(&run.t, values);
    window.strides.iter().flat_map(|s| bins(*s)).map(|[a, b]| integral.mean(a, b)).collect()
}
