//! Accelerations along a track. A log has none, so they are computed from its velocities.

use super::track::ArmPose;
use std::ops::Range;

/// Number of samples from which an acceleration is computed if the motion is smooth: our choice. For a velocity with a
/// period of thirteen samples the error is then 0.2 % inside a trial and 1 % at its ends (with two samples: 4 % and 25
/// %); noise of the velocity has an effect larger by a third.
const STENCIL: usize = 5;
/// The number of samples if no stretch of [`STENCIL`] is smooth: our choice, short enough for a ramp of three samples.
const SHORT: usize = 3;
/// A stretch is smooth if its difference of the highest order is below this share of the differences of lower order:
/// our choice, above the share for a period of thirteen samples (a quarter) and below that for a kink.
const SMOOTH: f64 = 0.5;

/// The stretch centred on the sample is used unless it is this many times rougher than the smoothest other stretch
/// (Shu, Journal of Scientific Computing 5:127, 1990, takes 2).
const SHIFT: f64 = 2.0;

/// For each sample the stretch from which its acceleration is computed. Drives start and stop with a kink in the speed,
/// and a polynomial across a kink is wrong on both sides. So the smoothest of the stretches that contain the sample is
/// used, as in essentially non-oscillatory schemes (Harten, Engquist, Osher & Chakravarthy 1987). Among stretches of
/// similar smoothness, the one centred on the sample is preferred. If no long stretch is smooth, a short one is used.
fn stencils(poses: &[ArmPose]) -> Vec<Range<usize>> {
    let chosen = |i: usize| {
        let of = |count: usize| {
            let count = count.min(poses.len());
            let starts = (i + 1).saturating_sub(count)..=i.min(poses.len() - count);
            let rough = |start: usize| roughness(&poses[start..start + count]);
            let middle = |start: usize| (2 * start + count).abs_diff(2 * i + 1);
            let all: Vec<_> = starts.map(|start| (rough(start), middle(start), start..start + count)).collect();
            let least = all.iter().map(|a| a.0[0]).fold(f64::INFINITY, f64::min);
            all.into_iter().filter(|a| a.0[0] <= SHIFT * least).min_by_key(|a| a.1)
        };
        let [long, short] = [STENCIL, SHORT].map(of);
        let smooth = long.as_ref().is_some_and(|l| l.0[0] <= SMOOTH * l.0[1]);
        if smooth { long } else { short }.map_or(0..poses.len(), |l| l.2)
    };
    (0..poses.len()).map(chosen).collect()
}

/// Size of the velocities' difference of the highest order over a stretch, and the greatest size of a difference of
/// lower order, without the first order.
fn roughness(poses: &[ArmPose]) -> [f64; 2] {
    let mut differences: Vec<[f64; 3]> = poses.iter().map(moving).collect();
    let interval = (poses[poses.len() - 1].t - poses[0].t) / (poses.len() - 1).max(1) as f64;
    let mut sizes = Vec::new();
    for order in 1..poses.len() {
        // Divided differences times the interval. For even sampling these are ordinary differences.
        let next = |i: usize| {
            let way = (poses[i + order].t - poses[i].t) / (order as f64 * interval);
            [0, 1, 2].map(|axis| (differences[i + 1][axis] - differences[i][axis]) / way)
        };
        differences = (0..poses.len() - order).map(next).collect();
        let size = |d: &[f64; 3]| d.iter().map(|v| v * v).sum::<f64>().sqrt();
        sizes.push(differences.iter().map(size).fold(0.0, f64::max));
    }
    let last = sizes.pop().unwrap_or(0.0);
    [last, sizes.into_iter().skip(1).fold(0.0, f64::max)]
}

/// Angular velocity [rad/s] and the centre's velocity [m/s].
fn moving(pose: &ArmPose) -> [f64; 3] {
    [pose.omega, pose.velocity[0], pose.velocity[1]]
}

/// The accelerations of a track.
pub struct Accelerations<'a> {
    poses: &'a [ArmPose],
    stencils: Vec<Range<usize>>,
    /// Deviation of the accelerations from the most likely ones, in standard deviations.
    deviation: f64,
}

impl<'a> Accelerations<'a> {
    pub fn new(poses: &'a [ArmPose], deviation: f64) -> Self {
        Self { poses, stencils: stencils(poses), deviation }
    }

    /// Angular acceleration [rad/s²] and the centre's acceleration [m/s²] at time `t`: slopes of the polynomial
    /// through the logged velocities of the samples around `t` (Lagrange), which works for uneven sampling and at the
    /// ends. Before the first and after the last sample the accelerations are constant.
    pub fn at(&self, t: f64) -> [f64; 3] {
        let poses = self.poses;
        let t = t.clamp(poses[0].t, poses[poses.len() - 1].t);
        let after = poses.partition_point(|p| p.t < t);
        let nearest = if after > 0 && t - poses[after - 1].t < poses[after].t - t { after - 1 } else { after };
        let near = &poses[self.stencils[nearest].clone()];
        let others = |j: usize| (0..near.len()).filter(move |&m| m != j);
        let start = if self.deviation == 0.0 { [0.0; 3] } else { self.sd(nearest).map(|sd| self.deviation * sd) };
        near.iter().enumerate().fold(start, |sum, (j, pose)| {
            let share = |k: usize| (t - near[k].t) / (pose.t - near[k].t);
            let without = |m: usize| others(j).filter(|&k| k != m).map(share).product::<f64>();
            let weight: f64 = others(j).map(|m| without(m) / (pose.t - near[m].t)).sum();
            let own = moving(pose);
            [0, 1, 2].map(|axis| sum[axis] + weight * own[axis])
        })
    }

    /// Standard deviation of the accelerations at a sample, with a sign. A log gives the mean accelerations over the
    /// intervals before and after the sample, and not how they change at the sample. In between, every value is equally
    /// likely: a rectangular distribution (JCGM 100:2008, 4.3.7).
    fn sd(&self, sample: usize) -> [f64; 3] {
        if sample == 0 || sample + 1 >= self.poses.len() {
            return [0.0; 3];
        }
        let [before, here, after] = [0, 1, 2].map(|i| &self.poses[sample + i - 1]);
        let mean = |a: &ArmPose, b: &ArmPose, axis: usize| (moving(b)[axis] - moving(a)[axis]) / (b.t - a.t);
        [0, 1, 2].map(|axis| (mean(here, after, axis) - mean(before, here, axis)) / 12f64.sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A plate starts within two intervals of 10 ms, moves steadily at 1 m/s, and stops within one. The acceleration is
    /// in doubt only at the samples where it changes.
    #[test]
    fn accelerations_are_in_doubt_where_a_drive_starts_and_stops() {
        let speeds = [0.0, 0.5, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0];
        let pose = |(i, v): (usize, &f64)| ArmPose { t: 0.01 * i as f64, velocity: [0.0, *v], ..ArmPose::default() };
        let poses: Vec<ArmPose> = speeds.iter().enumerate().map(pose).collect();
        let [likely, other] = [0.0, 1.0].map(|deviation| Accelerations::new(&poses, deviation));
        for (i, change) in [0.0, 0.0, -50.0, 0.0, 0.0, -100.0, 100.0, 0.0].into_iter().enumerate() {
            let [turn, x, z] = [0, 1, 2].map(|axis| other.at(poses[i].t)[axis] - likely.at(poses[i].t)[axis]);
            assert!((z - change / 12f64.sqrt()).abs() < 1e-9 && turn == 0.0 && x == 0.0, "{i}: {z}");
        }
    }

    /// For a speed with a period of about thirteen unevenly spaced samples, the derivative is right at samples, between
    /// them and beyond the ends.
    #[test]
    fn accelerations_are_found_up_to_the_ends_of_a_log() {
        let swing = 2.0 * std::f64::consts::PI / 13.0;
        let times = (0..40).map(|i| f64::from(i) + 0.2 * f64::from(i * 7 % 5 - 2) / 2.0);
        let pose = |t: f64| ArmPose {
            t,
            omega: 3.0 + (swing * t).sin(),
            velocity: [(swing * t).cos(), 2.0],
            ..ArmPose::default()
        };
        let poses: Vec<ArmPose> = times.map(pose).collect();
        let found = Accelerations::new(&poses, 0.0);
        for k in -20..900 {
            let t = (0.05 * f64::from(k)).clamp(poses[0].t, poses[39].t);
            let [turn, x, z] = found.at(0.05 * f64::from(k));
            let wrong =
                (turn - swing * (swing * t).cos()).abs().max((x + swing * (swing * t).sin()).abs()).max(z.abs());
            assert!(wrong < 0.02 * swing, "{t}: {wrong}");
        }
    }
}
