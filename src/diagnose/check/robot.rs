//! Looks at a robot's own log: order of the quaternion, jumps of encoders, channels that stand still, are saturated or late.

use super::finding::{Finding, Severity::Refuse, Severity::Warn, joined};
use super::ratio::products;
use crate::series::{central_difference, ends, interpolate, root_mean_square, runs_of};
use crate::trajectory::log::Run;
use std::f64::consts::TAU;

/// An angle jumps if it changes by this [rad] more than its speed says, and by [`RARE`] times the usual difference: our choices, far
/// above the errors of encoders and of filtered speeds.
const JUMP: f64 = 0.5;
const RARE: f64 = 20.0;
/// No joint of a robot is faster [rad/s]: our choice, some three times the no-load speed of the fastest actuators of legs.
const FASTEST: f64 = 100.0;
/// Least rms of the gyro for which the attitude is compared with it [rad/s]: our choice, above noise and offsets.
const TURNING: f64 = 0.05;
/// Samples for which a frozen channel stands still: our choice; rounded readings repeat a few times.
const STILL: usize = 25;

/// All findings; `joints` has the names of the joints.
pub fn check(runs: &[Run], joints: &[String]) -> Vec<Finding> {
    let each = |f: &dyn Fn(&Run) -> Option<Finding>| joined(runs.iter().map(f).collect());
    let mut found: Vec<Finding> = Vec::new();
    for (j, name) in joints.iter().enumerate() {
        found.extend(each(&|run| jump(run, j, name)));
        found.extend(each(&|run| still_angle(run, j, name)));
        found.extend(each(&|run| late(run, j, name)));
    }
    found.extend(each(&order));
    for (k, axis) in ["x", "y", "z"].into_iter().enumerate() {
        let [gyro, acc] = ["gyro", "acc"].map(|kind| format!("{kind}_{axis}"));
        found.extend(each(&|run| still_reading(run, &run.gyro[k], &gyro)));
        found.extend(each(&|run| still_reading(run, &run.acc[k], &acc)));
        found.extend(each(&|run| saturated(run, &run.gyro[k], &gyro)));
        found.extend(each(&|run| saturated(run, &run.acc[k], &acc)));
    }
    found
}

/// Looks for a step of an angle that its speed, or the steps beside it, contradict.
fn jump(run: &Run, j: usize, name: &str) -> Option<Finding> {
    let (q, t) = (&run.q[j], &run.t);
    let last = q.len() - 1;
    let usual_step = run.step();
    let step = |i: usize| q[i + 1] - q[i];
    let expected = |i: usize| match run.qd.get(j) {
        Some(qd) => 0.5 * (qd[i] + qd[i + 1]) * (t[i + 1] - t[i]),
        None => 0.5 * (step(i.saturating_sub(1)) + step((i + 1).min(last - 1))),
    };
    // After a gap of the clock the angle may have moved.
    let steady = |i: &usize| t[i + 1] - t[*i] < 3.0 * usual_step;
    let off: Vec<(f64, usize)> = (0..last).filter(steady).map(|i| (step(i) - expected(i), i)).collect();
    let mut sizes: Vec<f64> = off.iter().map(|o| o.0.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let usual = *sizes.get(sizes.len() / 2)?;
    let (size, i) = *off.iter().find(|o| o.0.abs() > JUMP.max(RARE * usual))?;
    let turns = (step(i) / TAU).round();
    let wrapped = turns != 0.0 && (step(i) - expected(i) - turns * TAU).abs() < 0.05 * TAU;
    let told = match run.qd.get(j) {
        Some(_) => format!("qd:{name} says {:+.3}", expected(i)),
        None => "the steps beside it say otherwise".into(),
    };
    let what = format!(
        "jumps by {:+.3} rad between t = {:.4} and {:.4} s of run {}, but {told}",
        step(i),
        run.start + t[i],
        run.start + t[i + 1],
        run.name
    );
    let remedy = match wrapped {
        true => "make the angle continuous: add full turns where it is wrapped",
        false => "split the run there, or correct the angle: its encoder was reset or lost counts",
    };
    let certain = run.qd.get(j).is_some() || size.abs() > FASTEST * usual_step.max(1e-9);
    let severity = if certain { Refuse } else { Warn };
    Some(Finding::new(severity, &format!("q:{name}"), what, remedy).at([run.line(i), run.line(i + 1)]))
}

/// The attitude's numbers in four places, with continuous signs; `order` says where w, x, y and z are, and `inverse`
/// inverts the rotation.
fn attitude(run: &Run, order: [usize; 4], inverse: bool) -> Vec<[f64; 4]> {
    let mut before = [0.0; 4];
    let of = |i: usize| {
        let mut q = order.map(|k| run.attitude[k][i]);
        if inverse {
            q[1..].iter_mut().for_each(|v| *v = -*v);
        }
        if q.iter().zip(&before).map(|(a, b)| a * b).sum::<f64>() < 0.0 {
            q.iter_mut().for_each(|v| *v = -*v); // q and −q are the same attitude
        }
        before = q;
        q
    };
    (0..run.t.len()).map(of).collect()
}

/// Correlation of the gyro with the rate at which the attitude turns in the IMU's own frame.
fn agreement(run: &Run, q: &[[f64; 4]]) -> f64 {
    let inner = 2..q.len().saturating_sub(2);
    let pairs = inner.flat_map(|i| {
        let rate: [f64; 4] = [0, 1, 2, 3].map(|k| (q[i + 2][k] - q[i - 2][k]) / (run.t[i + 2] - run.t[i - 2]));
        let ([w, x, y, z], [dw, dx, dy, dz]) = (q[i], rate);
        // 2 q̄ q̇ without its real part.
        let turn = [
            2.0 * (w * dx - x * dw - y * dz + z * dy),
            2.0 * (w * dy - y * dw - z * dx + x * dz),
            2.0 * (w * dz - z * dw - x * dy + y * dx),
        ];
        [0, 1, 2].map(|k| (turn[k], run.gyro[k][i]))
    });
    let (aa, ab, bb) = products(pairs);
    ab / (aa * bb).sqrt().max(1e-12)
}

/// Orders in which programs write a quaternion, and the words for them; the first is the right one.
const ORDERS: [([usize; 4], bool, &str); 4] = [
    ([0, 1, 2, 3], false, ""),
    ([3, 0, 1, 2], false, "is in the order x, y, z, w"),
    ([0, 1, 2, 3], true, "is the inverse rotation, from the level frame to the IMU's"),
    ([3, 0, 1, 2], true, "is the inverse rotation, in the order x, y, z, w"),
];

/// Compares the gyro with the rate of the attitude, in each order of the quaternion.
fn order(run: &Run) -> Option<Finding> {
    if run.attitude[0].is_empty() || root_mean_square(run.gyro.iter().flatten().copied()) < TURNING {
        return None;
    }
    let all = ORDERS.map(|(order, inverse, words)| (agreement(run, &attitude(run, order, inverse)), words));
    let own = all[0].0;
    let (best, words) = all.into_iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
    // 0.9 and 0.2: our choice; the right order gives 0.95 and more, another order rarely more than 0.7.
    let certain = best > 0.9 && own < best - 0.2;
    let weak = own < 0.5;
    let told = format!("the gyro agrees with its rate with a correlation of {own:.2} in run {}", run.name);
    (certain || weak).then(|| match certain {
        true => Finding::new(
            Refuse,
            "quat_w, quat_x, quat_y, quat_z",
            format!("{words}: {told}, and of {best:.2} in that order"),
            "w, x, y, z are needed, from the IMU's frame to the level one",
        ),
        false => {
            Finding::new(Warn, "quat_w, quat_x, quat_y, quat_z", told, "see whether gyro and attitude are of one IMU")
        }
    })
}

/// Looks for an angle that repeats one value while its speed says that it moves.
fn still_angle(run: &Run, j: usize, name: &str) -> Option<Finding> {
    let qd = run.qd.get(j)?;
    let way = |[a, b]: [usize; 2]| (run.t[b] - run.t[a]) * root_mean_square(qd[a..=b].iter().copied());
    still(run, &run.q[j], &format!("q:{name}"), "its speed says that it moves", way)
}

/// Looks for a reading that repeats one value while the joints move.
fn still_reading(run: &Run, signal: &[f64], name: &str) -> Option<Finding> {
    let way = |[a, b]: [usize; 2]| run.q.iter().map(|q| (q[b] - q[a]).abs()).fold(0.0, f64::max);
    still(run, signal, name, "the joints move", way)
}

/// A signal that repeats one value while something else goes a long `way` [rad].
fn still(run: &Run, signal: &[f64], name: &str, other: &str, way: impl Fn([usize; 2]) -> f64) -> Option<Finding> {
    let same = (0..signal.len()).map(|i| i > 0 && signal[i] == signal[i - 1]);
    let [a, b] = runs_of(same).filter(|[a, b]| b - a >= STILL).find(|run| way(*run) > JUMP)?;
    let what = format!("stays at {} for {:.2} s of run {} while {other}", signal[a], run.t[b] - run.t[a], run.name);
    let remedy = "leave this part out: the channel is frozen";
    Some(Finding::new(Warn, name, what, remedy).at([run.line(a), run.line(b)]))
}

/// Looks for a channel that keeps its largest or smallest value for three rows at three places: our choice; noise
/// hardly does this.
fn saturated(run: &Run, signal: &[f64], name: &str) -> Option<Finding> {
    let [low, high] = ends(signal.iter().copied());
    [low, high].into_iter().filter(|end| end.abs() >= 0.9 * low.abs().max(high.abs())).find_map(|end| {
        let all: Vec<_> = runs_of(signal.iter().map(|v| *v == end)).filter(|[a, b]| b - a >= 2).collect();
        (all.len() >= 3).then(|| {
            let what = format!("stands at {end} at {} places of run {}: the sensor is saturated", all.len(), run.name);
            let rows = [run.line(all[0][0]), run.line(all[0][1])];
            Finding::new(Warn, name, what, "log with a larger range of the sensor").at(rows)
        })
    })
}

/// Looks for a speed that is late or early against the change of its angle by more than a sample and a half, if a shift
/// by this time halves their difference.
fn late(run: &Run, j: usize, name: &str) -> Option<Finding> {
    let (q, qd) = (&run.q[j], run.qd.get(j)?);
    let step = run.step();
    let inner = 2..q.len().saturating_sub(2);
    let (times, rate): (Vec<f64>, Vec<f64>) = inner.map(|i| (run.t[i], central_difference(&run.t, q, i, 1))).unzip();
    let misfit = |delay: f64| {
        let off = times.iter().zip(&rate).map(|(t, r)| interpolate(&run.t, qd, t + delay) - r);
        root_mean_square(off)
    };
    let none = misfit(0.0);
    let steps = (-20..=20).map(|k| 0.5 * step * f64::from(k));
    let (delay, least) = steps.map(|d| (d, misfit(d))).min_by(|a, b| a.1.total_cmp(&b.1))?;
    (delay.abs() > 1.5 * step && least < 0.5 * none).then(|| {
        let side = if delay > 0.0 { "late" } else { "early" };
        let what = format!("is {:.0} ms {side} against q:{name} in run {}", 1e3 * delay.abs(), run.name);
        Finding::new(Warn, &format!("qd:{name}"), what, "see the clock or the filter of the speed")
    })
}
