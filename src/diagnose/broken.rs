//! Readings that are faults of the sensor or its logger, found in the readings alone, before anything is predicted: a saturated sensor, and
//! single samples that are far from both neighbours. Their rows are left out.

use super::series::{ends, root_mean_square, runs_of};

/// The readings of one trial, in the order of time.
pub struct TrialReadings {
    pub id: String,
    pub condition: usize,
    /// One list for each channel.
    pub channels: Vec<Vec<f64>>,
}

/// A fault of one channel.
pub struct Fault {
    pub channel: usize,
    pub what: String,
    pub remedy: &'static str,
    /// Trial, first and last sample of the worst place.
    pub trial: usize,
    pub at: [usize; 2],
    /// All broken samples, each with its trial.
    samples: Vec<[usize; 2]>,
}

/// A sample is an outlier if it is out of its neighbours' way by more than this many times what four of five samples nearby differ from the
/// mean of their two neighbours: our choice. For noise with a normal distribution it is some twelve standard deviations.
const OUTLYING: f64 = 8.0;
/// It also differs by more than this share of the channel's rms: our choice. A smaller one does no harm, and the steps of a coarse
/// converter are no outliers.
const LEAST: f64 = 0.1;
/// Samples on each side with which a sample is compared, and the least number of them: our choices.
const NEAR: usize = 10;
const ENOUGH: usize = 8;
/// If more than this share of a channel's samples are outlying, they are the channel's noise: our choice.
const MOST_OUTLIERS: f64 = 0.03;
/// A trial keeps its rows if more than this share of them would be left out: our choice.
const MOST_OF_A_TRIAL: f64 = 0.5;

/// The faults of all channels.
pub fn faults(trials: &[TrialReadings]) -> Vec<Fault> {
    let channels = trials.first().map_or(0, |t| t.channels.len());
    (0..channels).flat_map(|c| [saturated(trials, c), outliers(trials, c)]).flatten().collect()
}

/// For each trial, the samples that stay; None if most of them are broken, so that all stay.
pub fn sound(trials: &[TrialReadings], faults: &[Fault]) -> Vec<Option<Vec<usize>>> {
    let mut broken: Vec<Vec<bool>> =
        trials.iter().map(|t| vec![false; t.channels.first().map_or(0, Vec::len)]).collect();
    for [trial, i] in faults.iter().flat_map(|fault| &fault.samples) {
        broken[*trial][*i] = true;
    }
    let stay = |broken: Vec<bool>| {
        let count = broken.iter().filter(|b| **b).count();
        let most = count as f64 > MOST_OF_A_TRIAL * broken.len() as f64;
        (!most).then(|| (0..broken.len()).filter(|&i| !broken[i]).collect())
    };
    broken.into_iter().map(stay).collect()
}

fn readings(trials: &[TrialReadings], channel: usize) -> impl Iterator<Item = f64> {
    trials.iter().flat_map(move |t| t.channels[channel].iter().copied())
}

/// The largest value of the file, of either sign, is reached exactly in many samples that follow each other. Three together in
/// two trials, or ten in one: our choice; noise repeats its largest value less often.
fn saturated(trials: &[TrialReadings], channel: usize) -> Option<Fault> {
    let [low, high] = ends(readings(trials, channel));
    let far = |end: &f64| high > low && end.abs() >= 0.5 * low.abs().max(high.abs());
    let at_end = |end: f64| {
        let mut longest = Vec::new();
        for (u, trial) in trials.iter().enumerate() {
            let all = runs_of(trial.channels[channel].iter().map(|v| *v == end));
            longest.extend(all.filter(|[a, b]| b - a >= 2).map(|run| (u, run)));
        }
        let (trial, at) = *longest.iter().max_by_key(|(_, [a, b])| b - a)?;
        (longest.len() > 1 || at[1] - at[0] >= 9).then(|| Fault {
            channel,
            what: format!("stands at {end} in {} trials: the sensor or its amplifier is saturated", longest.len()),
            remedy: "these rows are left out; measure with a larger range",
            trial,
            at,
            samples: longest.iter().flat_map(|(u, [a, b])| (*a..=*b).map(|i| [*u, i])).collect(),
        })
    };
    [low, high].into_iter().filter(far).find_map(at_end)
}

/// Single samples far from their neighbours.
fn outliers(trials: &[TrialReadings], channel: usize) -> Option<Fault> {
    let jumps: Vec<Vec<f64>> = trials.iter().map(|t| jumps(&t.channels[channel])).collect();
    let least = LEAST * root_mean_square(readings(trials, channel));
    let outlying = |u: usize, i: usize| {
        let own = &trials[u].channels[channel];
        let near = i.saturating_sub(NEAR).max(1)..(i + NEAR + 1).min(own.len().saturating_sub(1));
        // The two neighbours of an outlier differ from their mean by half as much.
        let bend = |j: usize| (own[j] - 0.5 * (own[j - 1] + own[j + 1])).abs();
        let mut others: Vec<f64> = near.filter(|j| j.abs_diff(i) > 1).map(bend).collect();
        others.sort_by(f64::total_cmp);
        others.len() >= ENOUGH && jumps[u][i].abs() > (OUTLYING * others[others.len() * 4 / 5]).max(least)
    };
    let all = (0..trials.len()).flat_map(|u| (0..jumps[u].len()).map(move |i| [u, i]));
    let mut found: Vec<[usize; 2]> = all.filter(|[u, i]| outlying(*u, *i)).collect();
    found.retain(|[u, i]| !repeated(trials, &jumps, *u, *i));
    let samples: usize = jumps.iter().map(Vec::len).sum();
    let size = |&[u, i]: &[usize; 2]| jumps[u][i].abs();
    let [trial, i] = *found.iter().max_by(|a, b| size(a).total_cmp(&size(b)))?;
    let others = match found.len() - 1 {
        0 => String::new(),
        more => format!(", and {more} more"),
    };
    (found.len() as f64 <= MOST_OUTLIERS * samples as f64).then(|| Fault {
        channel,
        what: format!("differs from both neighbours by {:.3} (trial {}){others}", size(&[trial, i]), trials[trial].id),
        remedy: "these rows are left out, as faults of the logger",
        trial,
        at: [i, i],
        samples: found,
    })
}

/// How far each sample is from the straight lines through its two neighbours on the left and on the right, and at most twice as far as it
/// is outside of all four; 0 if it is not outside, or between the lines, or at an end of the trial. So a step or a bend of the force has
/// the value 0, the neighbours of an outlier have it, and the top of a smooth peak has a small one.
fn jumps(own: &[f64]) -> Vec<f64> {
    let jump = |i: usize| {
        if i < 2 || i + 2 >= own.len() {
            return 0.0;
        }
        let near = [own[i - 2], own[i - 1], own[i + 1], own[i + 2]];
        let [left, right] = [own[i] - (2.0 * near[1] - near[0]), own[i] - (2.0 * near[2] - near[3])];
        let [low, high] = ends(near.into_iter());
        let outside = (own[i] - high).max(low - own[i]).max(0.0);
        if left * right > 0.0 { left.signum() * left.abs().min(right.abs()).min(2.0 * outside) } else { 0.0 }
    };
    (0..own.len()).map(jump).collect()
}

/// Has half of the other trials of the condition the same peak at this place? Then it is no fault, but a force.
fn repeated(trials: &[TrialReadings], jumps: &[Vec<f64>], u: usize, i: usize) -> bool {
    let (own, place) = (jumps[u][i], |i: usize, n: usize| i as f64 / n as f64);
    let others: Vec<usize> =
        (0..trials.len()).filter(|k| *k != u && trials[*k].condition == trials[u].condition).collect();
    let same = |k: &&usize| {
        let (m, n) = (jumps[**k].len(), jumps[u].len());
        let near = |j: usize| (place(j, m) - place(i, n)).abs() <= 1.5 / m.min(n) as f64;
        (0..m).any(|j| near(j) && jumps[**k][j] * own > 0.0 && jumps[**k][j].abs() > 0.5 * own.abs())
    };
    !others.is_empty() && 2 * others.iter().filter(same).count() >= others.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A force that rises, bends and falls at once, with a little noise.
    fn trial(condition: usize, phase: f64) -> TrialReadings {
        let at = |i: usize| {
            let t = i as f64;
            let force = if i < 8 {
                0.0
            } else if i < 25 {
                t - 8.0
            } else {
                5.0
            };
            force + 0.05 * (1.7 * t + phase).sin() * (0.9 * t * t + phase).cos()
        };
        TrialReadings { id: format!("t{phase}"), condition, channels: vec![(0..40).map(at).collect()] }
    }

    fn three() -> Vec<TrialReadings> {
        vec![trial(0, 0.0), trial(0, 1.0), trial(0, 2.0)]
    }

    #[test]
    fn bends_and_steps_are_no_outliers() {
        assert!(faults(&three()).is_empty());
    }

    #[test]
    fn single_samples_that_no_other_trial_has_are_left_out() {
        let mut trials = three();
        trials[1].channels[0][15] += 4.0;
        trials[2].channels[0][30] -= 3.0;
        let found = faults(&trials);
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].trial, found[0].at), (1, [15, 15]));
        assert!(found[0].what.contains("differs from both neighbours by") && found[0].what.ends_with("and 1 more"));
        let kept = sound(&trials, &found);
        let without = |i: usize| (0..40).filter(|k| *k != i).collect::<Vec<_>>();
        assert_eq!(kept, [(0..40).collect(), without(15), without(30)].map(Some));
        // A peak of all repetitions is a force.
        for trial in &mut trials {
            trial.channels[0][20] += 4.0;
        }
        assert!(faults(&trials).iter().all(|f| f.samples.iter().all(|s| s[1] != 20)));
    }

    #[test]
    fn a_saturated_sensor_leaves_its_rows_out() {
        let mut trials = three();
        for trial in &mut trials {
            trial.channels[0].iter_mut().for_each(|v| *v = v.min(10.0));
        }
        let found = faults(&trials);
        assert!(found[0].what.contains("stands at 10 in 3 trials"), "{}", found[0].what);
        let kept = sound(&trials, &found);
        assert!(kept.iter().flatten().all(|k| k.len() < 40 && k.len() > 30 && !k.contains(&22)));
        // A trial that is mostly saturated stays as it is.
        trials[0].channels[0][..25].fill(10.0);
        assert_eq!(sound(&trials, &faults(&trials)).iter().filter(|k| k.is_none()).count(), 1);
    }
}
