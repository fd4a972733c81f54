//! The motion of an intruder: where it rests, its direction, and the distance travelled.
//!
//! Real drives start from rest, stop, and go on. Velocities and positions are noisy, so the decisions use both,
//! over several samples.

use super::track::{ArmPose, Track};

/// An intruder rests if its speed is below this share of the trial's speed: our choice, above the noise of velocities
/// at rest and far below any speed of interest.
const REST: f64 = 0.05;
/// A velocity up to this share counts as noise if the position shows rest: our choice, because with [`REST`] alone
/// noise would count as motion.
const NOISY_REST: f64 = 0.2;
/// Speeds from positions are taken over up to this many samples before and after: our choice, because the noise of one
/// position weighs half as much over two intervals as over one.
const REACH: usize = 2;
/// Share of the trial's extent within which fluctuations of the position do not count as motion: our choice, 0.2 mm
/// on a distance of 4 cm, 1° on one of 200°.
const SLACK: f64 = 0.005;
/// Share of the trial's extent after which an intruder has certainly started: our choice, because the error of the
/// direction is then only twice the position's noise divided by the extent.
const SET_OUT: f64 = 0.5;

/// The first direction of motion of a trial.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heading {
    /// Unit vector; for a leg (±1, 0), the sign of its rotation. 0 if it never moves.
    along: [f64; 2],
    /// First sample at which it has certainly started; the last sample if it never does.
    pub until: usize,
}

impl Heading {
    /// Does the intruder move in this trial?
    pub fn moves(&self) -> bool {
        self.along != [0.0; 2]
    }
}

fn between(a: [f64; 2], b: [f64; 2]) -> f64 {
    (b[0] - a[0]).hypot(b[1] - a[1])
}

/// Largest distance from where the trial starts.
fn extent(track: &Track) -> f64 {
    let start = track.place(&track.poses[0]);
    track.poses.iter().map(|p| between(start, track.place(p))).fold(0.0, f64::max)
}

/// The displacement from the start until the trial has certainly started.
pub fn heading(track: &Track) -> Heading {
    let (start, extent) = (track.place(&track.poses[0]), extent(track));
    let out = |p: &ArmPose| between(start, track.place(p)) >= SET_OUT * extent;
    match track.poses.iter().position(out).filter(|_| extent > 0.0) {
        Some(until) => {
            let end = track.place(&track.poses[until]);
            let way = between(start, end);
            Heading { along: [0, 1].map(|k| (end[k] - start[k]) / way), until }
        }
        None => Heading { along: [0.0; 2], until: track.poses.len() - 1 },
    }
}

/// Angle [rad] or path [m] travelled at each sample, counted from the frame's zero along `heading`. So repetitions that
/// start at different times are matched by position and not by time. The path never decreases; it also grows when the
/// intruder moves back.
///
/// Fluctuations within [`SLACK`] do not count: the path is that of a point that follows the position and lags it by at
/// most this distance. So noise at rest does not add up.
pub fn progress(track: &Track, heading: &Heading) -> Vec<f64> {
    let start = track.place(&track.poses[0]);
    let from = start[0] * heading.along[0] + start[1] * heading.along[1];
    let leash = SLACK * extent(track);
    let (mut behind, mut path, mut furthest) = (start, 0.0, 0.0);
    let at = |pose: &ArmPose| {
        let here = track.place(pose);
        let away = between(behind, here);
        if away > leash {
            let pulled = (away - leash) / away;
            behind = [0, 1].map(|k| behind[k] + pulled * (here[k] - behind[k]));
            path += away - leash;
        }
        furthest = f64::max(furthest, path + away.min(leash));
        from + furthest
    };
    track.poses.iter().map(at).collect()
}

/// Samples at which the intruder moves; all samples if it never does. The force law depends on the direction of motion
/// only, so it does not predict the force at rest, which may have any value up to the force that starts a motion.
pub fn moving(track: &Track) -> Vec<usize> {
    let poses = &track.poses;
    let usual = usual_speed(track);
    let seen = |a: usize, b: usize| match a < b {
        true => between(track.place(&poses[a]), track.place(&poses[b])) / (poses[b].t - poses[a].t),
        false => f64::INFINITY,
    };
    let moves = |i: &usize| {
        let logged = track.speed(&poses[*i]);
        // At the start or end of a rest, only the samples on one side are at rest.
        let before = seen(i.saturating_sub(REACH), *i);
        let after = seen(*i, (i + REACH).min(poses.len() - 1));
        let seen = before.min(after);
        logged >= NOISY_REST * usual || (logged >= REST * usual && seen >= REST * usual)
    };
    let all = 0..poses.len();
    if usual > 0.0 { all.filter(moves).collect() } else { all.collect() }
}

/// The logged speed at the median of the path: rests and single outliers hardly affect it.
fn usual_speed(track: &Track) -> f64 {
    let mut speeds: Vec<f64> = track.poses.iter().map(|p| track.speed(p)).collect();
    speeds.sort_by(f64::total_cmp);
    let half = 0.5 * speeds.iter().sum::<f64>();
    let mut way = 0.0;
    let passed = |v: &&f64| {
        way += **v;
        way >= half
    };
    speeds.iter().find(passed).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::super::experiment::Intruder;
    use super::super::track::ArmPose;
    use super::*;

    /// A plate that rests, goes down 3 cm at 0.1 m/s, rests, and comes up again, sampled every millisecond; the
    /// position's noise is `noise` [m].
    fn stroke(noise: f64) -> Track {
        let poses = (0..1000).map(|i| {
            let t = f64::from(i) * 1e-3;
            let (z, vz) = match t {
                t if t < 0.2 => (0.0, 0.0),
                t if t < 0.5 => (-0.1 * (t - 0.2), -0.1),
                t if t < 0.7 => (-0.03, 0.0),
                _ => (-0.03 + 0.1 * (t - 0.7), 0.1),
            };
            let waver = noise * (f64::from(i) * 2.4).sin();
            ArmPose { t, center: [0.5, z + waver], velocity: [0.0, vz], ..ArmPose::default() }
        });
        let poses = poses.collect();
        let intruder = Intruder::Plate { length: 0.04, width: 0.025, thickness: None };
        Track { shape: "plate".into(), ..Track::leg(intruder, 0.0, poses) }
    }

    #[test]
    fn path_does_not_gather_noise() {
        for noise in [0.0, 1e-4] {
            let track = stroke(noise);
            let along = progress(&track, &heading(&track));
            assert!(along.is_sorted());
            // 3 cm down and 3 cm up, less twice the slack of 0.15 mm.
            let (middle, end) = (along[600] - along[0], along[999] - along[0]);
            assert!((middle - 0.03).abs() < 3.0 * noise + 1e-6, "{noise}: {middle}");
            assert!((end - 0.06).abs() < 3.0 * noise + 5e-4, "{noise}: {end}");
        }
    }

    #[test]
    fn rests_are_found_in_noise() {
        let mut track = stroke(1e-6);
        let moves = |i: &usize| (200..500).contains(i) || *i >= 700;
        assert_eq!(moving(&track), (0..1000).filter(moves).collect::<Vec<_>>());
        for (i, pose) in track.poses.iter_mut().enumerate() {
            // 10 % of the speed
            pose.velocity[0] += 0.01 * (i as f64 * 1.7).sin();
        }
        let found = moving(&track);
        let wrong = (0..1000).filter(|i| found.contains(i) != moves(i)).count();
        assert!(wrong < 10, "{wrong} samples are taken for what they are not");
    }
}
