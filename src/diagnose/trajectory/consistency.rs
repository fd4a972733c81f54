//! Finds wrong units and signs before the diagnosis. Each error is one line that says what to state in the experiment file.
//!
//! The checks compare quantities that depend on each other: joint speeds with the change of angles, angles with the command,
//! specific force with gravity and with the attitude. They also compare torques, gyro and speed with the replay, whose error is
//! some ten percent; a wrong unit gives a ratio of 57 or more, a wrong sign a negative ratio.

use super::log::Run;
use super::sensors::Layout;
use super::windows::BINS;
use crate::check::ratio::{NEAR, products, proportion};
use crate::error::{Error, Result};
use crate::series::{central_difference, ends};
use crate::sim::model::GRAVITY;
use std::f64::consts::{PI, TAU};
use std::path::Path;

const DEGREES: f64 = 180.0 / PI;

/// What belongs to the known ratio that `ratio` is near to.
fn named<T: Clone>(ratio: f64, known: &[(f64, T)]) -> Option<T> {
    known.iter().find(|k| (ratio / k.0 - 1.0).abs() < NEAR).map(|k| k.1.clone())
}

/// Refuses a log in which joints, gravity and attitude contradict each other. `joints` has the joints' names.
pub fn check(path: &Path, runs: &[Run], joints: &[String], mount: [f64; 4]) -> Result<()> {
    for run in runs {
        let found = (joints.iter().enumerate())
            .find_map(|(j, name)| speed(run, j, name).or_else(|| command(run, j, name)))
            .or_else(|| gravity(run, mount))
            .or_else(|| attitude(run));
        if let Some(error) = found {
            return Err(Error::file(path, format!("run {}: {error}", run.name)));
        }
    }
    Ok(())
}

/// Compares the joint speeds with the change of the angles.
fn speed(run: &Run, j: usize, name: &str) -> Option<String> {
    let qd = run.qd.get(j)?;
    let q = &run.q[j];
    let inner = 2..q.len().saturating_sub(2);
    let change = |i: usize| central_difference(&run.t, q, i, 2);
    let [low, high] = ends(q.iter().copied());
    // Samples at which an angle is wrapped are left out.
    let steady = |i: &usize| (q[i + 2] - q[i - 2]).abs() <= 0.5 * (high - low);
    let ratio = proportion(inner.filter(steady).map(|i| (change(i), qd[i])))?;
    let unit = |what: &str, column: &str, unit: &str| format!("{what}; state [units] \"{column}:{name}\" = \"{unit}\"");
    let degrees = || unit("the speed is in degrees", "qd", "deg/s");
    let known = [
        (-1.0, ("has the opposite sign of the change of", "one of the two has the wrong sign".to_string())),
        (DEGREES, ("is 57.3 times the change of", degrees())),
        (-DEGREES, ("is -57.3 times the change of", degrees())),
        (1.0 / DEGREES, ("is 1/57.3 of the change of", unit("the angle is in degrees", "q", "deg"))),
        (60.0 / TAU, ("is 9.55 times the change of", unit("the speed is in turns a minute", "qd", "rpm"))),
        (1.0 / TAU, ("is 1/6.28 of the change of", unit("the speed is in turns a second", "qd", "Hz"))),
    ];
    let (what, mend) = named(ratio, &known)?;
    Some(format!("qd:{name} {what} q:{name}: {mend}"))
}

/// Compares the angles with the hips' command, for joints that make full turns.
fn command(run: &Run, j: usize, name: &str) -> Option<String> {
    let told = TAU * run.frequency?;
    let (q, half) = (&run.q[j], run.t.len() / 2);
    let rate = (q[q.len() - 1] - q[half]) / (run.t[q.len() - 1] - run.t[half]);
    match named(rate / told, &[(DEGREES, "deg"), (1.0 / TAU, "turns"), (-1.0, "sign"), (-DEGREES, "both")])? {
        "deg" => Some(format!(
            "q:{name} turns 57.3 times as fast as stride_frequency says: it is in degrees; state [units] \"q:{name}\" = \"deg\""
        )),
        "turns" => Some(format!("q:{name} turns by 1 a stride and not by 2π: it is in turns, not in radians")),
        "sign" => Some(format!("q:{name} turns against stride_frequency: one of the two has the wrong sign")),
        _ => Some(format!("q:{name} turns against stride_frequency and is in degrees")),
    }
}

/// Compares the mean specific force with gravity: 9.81 m/s², upward. A factor of two is our choice, far above the error
/// of a sensor and the accelerations of a walk, which have a mean of about 0.
fn gravity(run: &Run, [w, x, y, z]: [f64; 4]) -> Option<String> {
    let mean = |v: &Vec<f64>| v.iter().sum::<f64>() / v.len() as f64;
    let own = nalgebra::Vector3::from_fn(|k, _| mean(&run.acc[k]));
    let mount = nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
    let acc = mount * own;
    let size = acc.norm() / GRAVITY;
    if size < 0.5 {
        return Some(match named(size * GRAVITY, &[(1.0, "g")]) {
            Some(_) => "the mean of acc is 1, not 9.81: it is in g; state [units] acc_x, acc_y, acc_z = \"g\"".into(),
            None => format!(
                "the mean of acc is {:.2} m/s²: gravity is missing; the specific force is needed, +9.81 upward at rest",
                acc.norm()
            ),
        });
    }
    if size > 2.0 {
        return Some(match named(size, &[(1e3, "mm")]) {
            Some(_) => {
                "the mean of acc is 9810, not 9.81: it is in mm/s²; state [units] acc_x, acc_y, acc_z = \"mm/s²\""
                    .into()
            }
            None => format!("the mean of acc is {:.1} m/s², not 9.81: state its unit in [units]", acc.norm()),
        });
    }
    let up = acc.z / acc.norm();
    if up < -0.7 {
        return Some(
            "acc_z is negative on average: acc has gravity's direction; the specific force points up (+9.81 at rest)"
                .into(),
        );
    }
    // On the steepest slope, with the robot pitched, four fifths of the specific force are still along z.
    (up < 0.7).then(|| {
        let axis = ["x", "y", "z"][own.iamax()];
        format!("gravity is mostly along acc_{axis}: the IMU is not mounted as [imu] quat states")
    })
}

/// Checks that the attitude turns the specific force upward. The limits are our choice: 0.7 as for gravity, and ±0.5
/// for the correlation of the tilt, which is near 1 if all is right and −1 with the inverse.
fn attitude(run: &Run) -> Option<String> {
    let [w, x, y, z] = &run.attitude;
    let upward = |q: &dyn Fn(usize) -> [f64; 4]| {
        let up = |i: usize| {
            let [w, x, y, z] = q(i);
            let up = [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)];
            (0..3).map(|k| up[k] * run.acc[k][i]).sum::<f64>()
        };
        (0..w.len()).map(up).sum::<f64>() / (w.len().max(1) as f64 * GRAVITY)
    };
    // The correlation of the tilt alone is also checked: it is negative if the quaternion's order is wrong or its rotation is the inverse.
    let tilt = |q: &dyn Fn(usize) -> [f64; 4]| {
        let pairs = (0..w.len()).flat_map(|i| {
            let [w, x, y, z] = q(i);
            let up = [2.0 * (x * z - w * y), 2.0 * (y * z + w * x)];
            [(up[0] * GRAVITY, run.acc[0][i]), (up[1] * GRAVITY, run.acc[1][i])]
        });
        let (aa, ab, bb) = products(pairs);
        ab / (aa * bb).sqrt().max(1e-12)
    };
    let as_is = |i: usize| [w[i], x[i], y[i], z[i]];
    let inverse = |i: usize| [w[i], -x[i], -y[i], -z[i]];
    let shifted = |i: usize| [z[i], w[i], x[i], y[i]];
    if w.is_empty() {
        return None;
    }
    if upward(&as_is) > 0.7 && tilt(&as_is) > -0.5 {
        return None;
    }
    Some(if upward(&shifted) > 0.7 && tilt(&shifted) > 0.5 {
        "quat has the order x, y, z, w; w, x, y, z is needed".into()
    } else if upward(&inverse) > 0.7 && tilt(&inverse) > 0.5 {
        "quat is the inverse rotation, from the level frame to the IMU's; from the IMU's frame to the level one is needed".into()
    } else {
        "quat does not turn the specific force upward: it is the attitude of another frame than the IMU's".into()
    })
}

/// Refuses a log in which the ratio of torques, gyro or speed to the replay is that of a wrong unit or sign.
pub fn against_replay(path: &Path, layout: &Layout, measured: &[f64], replayed: &[f64]) -> Result<()> {
    let span = BINS * layout.count();
    let ratio = |channels: std::ops::Range<usize>| {
        let own = move |k: &usize| channels.contains(&(k % span / BINS));
        proportion((0..measured.len()).filter(own).map(|k| (replayed[k], measured[k])))
    };
    let torque = [
        (-1.0, "has the wrong sign"),
        (1e3, "is in mN·m: state it in [units]"),
        (1e2, "is in N·cm: state it in [units]"),
    ];
    let gyro = [
        (-1.0, "has the wrong sign"),
        (DEGREES, "is in deg/s: state it in [units]"),
        (-DEGREES, "is in deg/s and has the wrong sign"),
    ];
    let speed = [(1e3, "is in mm: state it in [units]"), (1e2, "is in cm: state it in [units]")];
    let joints = layout.joints;
    let place = layout.place.then(|| layout.count() - 1 - usize::from(layout.servo));
    let checks = [
        ("torque", Some(0..joints), &torque[..]),
        ("gyro", Some(joints..joints + 3), &gyro[..]),
        ("x, y, z", place.map(|c| c..c + 1), &speed[..]),
    ];
    for (what, channels, known) in checks {
        let found = channels.and_then(&ratio).and_then(|r| named(r, known).map(|error| (r, error)));
        if let Some((ratio, error)) = found {
            let reason =
                format!("{what} is {ratio:.3} times the value in a simulation with the logged joints: it {error}");
            return Err(Error::file(path, reason));
        }
    }
    Ok(())
}
