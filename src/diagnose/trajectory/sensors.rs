//! Computes what the log's sensors would have read during a replay, as means over the parts of each stride.

use super::replay::{SIGNALS, Signals};
use super::windows::{BINS, Integral, Window, bins};
use crate::hardware::{DELAY, FILTER, FRICTION, ROTATION, TORQUE_CONSTANT, TORQUE_GAIN};
use crate::observations::Channel;
use crate::sim::hardware::HardwareDescription;

const IMU: [(&str, &str); 6] = [
    ("gyro_x", "rad/s"),
    ("gyro_y", "rad/s"),
    ("gyro_z", "rad/s"),
    ("acc_x", "m/s²"),
    ("acc_y", "m/s²"),
    ("acc_z", "m/s²"),
];

/// Signals of a replay that the IMU measures: angular velocity, specific force and upward direction.
const IMU_SIGNALS: usize = 9;

/// The channels of a log, in this order: torques, gyro, specific force, upward direction, speed, servo.
#[derive(Clone, Copy, Debug)]
pub struct Layout {
    pub joints: usize,
    /// Does the log have an attitude?
    pub attitude: bool,
    /// Does the log have the base's position?
    pub place: bool,
    /// Does the log have the commanded angles of the servos?
    pub servo: bool,
}

impl Layout {
    pub fn channels(&self) -> Vec<Channel> {
        let torque = |j: usize| Channel { name: format!("torque_{j}").into(), unit: "N·m", in_rmse: true };
        let mut all: Vec<Channel> = (1..=self.joints).map(torque).collect();
        all.extend(IMU.iter().map(|&(name, unit)| Channel::new(name, unit, false)));
        if self.attitude {
            all.extend([Channel::new("up_x", "1", false), Channel::new("up_y", "1", false)]);
        }
        if self.place {
            all.push(Channel::new("speed", "m/s", false));
        }
        if self.servo {
            all.push(Channel::new("servo", "N·m", true));
        }
        all
    }

    pub fn count(&self) -> usize {
        self.joints + 6 + 2 * usize::from(self.attitude) + usize::from(self.place) + usize::from(self.servo)
    }

    pub fn servo_channel(&self) -> Option<usize> {
        self.servo.then(|| self.count() - 1)
    }
}

/// Rotation, delay and filter of the IMU beyond what the experiment file states, and the delay of the torques.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mounting {
    /// Rotation vector in the IMU's frame [rad].
    pub turn: [f64; 3],
    /// Delay of its readings [s].
    pub delay: f64,
    /// Time constant of the first-order filter of its readings [s].
    pub low_pass: f64,
    /// Delay of the logged torques [s].
    pub torque_delay: f64,
}

/// The effects of hardware on a log.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LoggedHardware {
    pub mounting: Mounting,
    /// Share by which logged torques are too large.
    pub torque_gain: f64,
    /// Share by which logged torques exceed the torques that servos request.
    pub servo_gain: f64,
    /// Friction of each joint [N·m].
    pub friction: f64,
}

impl LoggedHardware {
    /// The hardware that a file states. Quantities that do not change the mean of logged values, such as noise, have no effect.
    pub fn of(file: &HardwareDescription) -> Self {
        let value = |path: &str| file.value(path).unwrap_or(0.0);
        let torque_gain = value(TORQUE_GAIN);
        let constant = file.value(TORQUE_CONSTANT).unwrap_or(1.0);
        Self {
            mounting: Mounting {
                turn: ROTATION.map(value),
                delay: value(DELAY[0]),
                low_pass: value(FILTER[0]),
                torque_delay: 0.0,
            },
            torque_gain,
            servo_gain: constant * (1.0 + torque_gain) - 1.0,
            friction: value(FRICTION),
        }
    }
}

type M = nalgebra::Matrix3<f64>;

impl Mounting {
    /// Rotation from the base's frame to the IMU's frame; `quat` is the mounting that the experiment file states.
    pub fn to_imu(self, quat: [f64; 4]) -> M {
        let [w, x, y, z] = quat;
        let nominal = nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
        let turn = nalgebra::UnitQuaternion::from_scaled_axis(nalgebra::Vector3::from(self.turn));
        (nominal * turn).to_rotation_matrix().into_inner().transpose()
    }
}

/// The output of a first-order filter, exact for a signal that is linear between its samples. `share`: time between two samples
/// divided by the filter's time constant.
fn low_passed(signal: &[f64], share: f64) -> Vec<f64> {
    let kept = (-share).exp();
    let mean = (1.0 - kept) / share;
    let (mut value, mut before) = (signal[0], signal[0]);
    let step = |x: &f64| {
        value = kept * value + (mean - kept) * before + (1.0 - mean) * x;
        before = *x;
        value
    };
    signal.iter().map(step).collect()
}

/// The predicted numbers of one window: stride by stride, channel by channel. The servo's channel is 0 here. The replay's signals are
/// sampled at the `times` of the log and interpolated linearly, as are the log's signals.
pub fn read(
    layout: &Layout,
    window: &Window,
    times: &[f64],
    track: &Signals,
    mounting: Mounting,
    quat: [f64; 4],
) -> Vec<f64> {
    let (count, joints, tick) = (layout.count(), layout.joints, track.step);
    let mut stack = vec![f64::NAN; window.strides.len() * count * BINS];
    if track.signals.first().map_or(0, Vec::len) < 2 || track.signals.len() < joints + SIGNALS {
        return stack;
    }
    // Takes one more sample at each end.
    let first = times.partition_point(|t| *t < window.from).saturating_sub(1);
    let times = &times[first..(times.partition_point(|t| *t < window.end()) + 1).min(times.len())];
    let imu = joints..joints + IMU_SIGNALS;
    let sampled = |(k, signal): (usize, &Vec<f64>)| {
        let late = match k {
            k if k < joints => mounting.torque_delay,
            k if imu.contains(&k) => mounting.delay,
            _ => 0.0,
        };
        let start = window.from - track.lag(k, joints, tick) + late + tick;
        match imu.contains(&k) && mounting.low_pass > 0.0 {
            true => resampled(&low_passed(signal, tick / mounting.low_pass), start, tick, times),
            false => resampled(signal, start, tick, times),
        }
    };
    let signals: Vec<Vec<f64>> = track.signals.iter().enumerate().map(sampled).collect();
    let integrals: Vec<Integral> = signals.iter().map(|s| Integral::new(times, s)).collect();
    let turn = mounting.to_imu(quat);
    for (s, stride) in window.strides.iter().enumerate() {
        let own = &mut stack[s * count * BINS..][..count * BINS];
        for (b, [from, to]) in bins(*stride).enumerate() {
            let mean = |signal: usize| integrals[signal].mean(from, to);
            let vector = |first: usize| turn * nalgebra::Vector3::from_fn(|k, _| mean(joints + first + k));
            let [gyro, acc, up] = [0, 3, 6].map(vector);
            let up = up.iter().take(if layout.attitude { 2 } else { 0 });
            let of_imu = gyro.iter().chain(acc.iter()).chain(up).copied();
            let speed = layout.place.then(|| mean(joints + 9));
            let numbers = (0..joints).map(mean).chain(of_imu).chain(speed).chain(layout.servo.then_some(0.0));
            numbers.enumerate().for_each(|(channel, number)| own[channel * BINS + b] = number);
        }
    }
    stack
}

/// Interpolates a signal at `times`. The signal has a value every `tick`, the first at `start`.
fn resampled(signal: &[f64], start: f64, tick: f64, times: &[f64]) -> Vec<f64> {
    let last = (signal.len() - 1) as f64;
    let at = |t: &f64| {
        let place = ((t - start) / tick).clamp(0.0, last);
        let before = (place as usize).min(signal.len() - 2);
        let share = place - before as f64;
        (1.0 - share) * signal[before] + share * signal[before + 1]
    };
    times.iter().map(at).collect()
}
