//! Computes what the log's sensors would have read during a replay, as means over the parts of each stride.

use super::replay::{SIGNALS, Signals};
use super::windows::{BINS, Integral, Window, bins};
use crate::observations::Channel;

const IMU: [(&str, &str); 6] = [
    ("gyro_x", "rad/s"),
    ("gyro_y", "rad/s"),
    ("gyro_z", "rad/s"),
    ("acc_x", "m/s²"),
    ("acc_y", "m/s²"),
    ("acc_z", "m/s²"),
];

/// The channels of a log, in this order: torques, gyro, specific force, upward direction, speed, servo.
#[derive(Clone, Copy, Debug)]
pub struct Layout {
    pub joints: usize,
    /// Does the log have an attitude?
    pub attitude: bool,
    /// Does the log have the base's position?
    pub place: bool,
    /// Does the log have the angles that the servos were commanded to?
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

/// Rotation and delay of the IMU, beyond what the experiment file states.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mounting {
    /// Rotation vector in the IMU's frame [rad].
    pub turn: [f64; 3],
    /// Delay of its readings [s].
    pub delay: f64,
}

type M = nalgebra::Matrix3<f64>;

impl Mounting {
    /// Rotation from the base's frame to the IMU's frame; `quat` is the mounting that the experiment file states.
    fn to_imu(self, quat: [f64; 4]) -> M {
        let [w, x, y, z] = quat;
        let nominal = nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
        let turn = nalgebra::UnitQuaternion::from_scaled_axis(nalgebra::Vector3::from(self.turn));
        (nominal * turn).to_rotation_matrix().into_inner().transpose()
    }
}

/// The predicted numbers of one window: stride by stride, channel by channel. The servo's channel is 0 here.
pub fn read(
    layout: &Layout,
    window: &Window,
    track: &Signals,
    tick: f64,
    mounting: Mounting,
    quat: [f64; 4],
) -> Vec<f64> {
    let (count, joints) = (layout.count(), layout.joints);
    let mut stack = vec![f64::NAN; window.strides.len() * count * BINS];
    let samples = track.signals.first().map_or(0, Vec::len);
    if samples < 2 || track.signals.len() < joints + SIGNALS {
        return stack;
    }
    let t: Vec<f64> = (1..=samples).map(|k| window.from + k as f64 * tick).collect();
    let integrals: Vec<Integral> = track.signals.iter().map(|s| Integral::new(&t, s)).collect();
    let turn = mounting.to_imu(quat);
    for (s, stride) in window.strides.iter().enumerate() {
        let own = &mut stack[s * count * BINS..][..count * BINS];
        for (b, [from, to]) in bins(*stride).enumerate() {
            let mean = |signal: usize, late: f64| {
                let shift = track.lag(signal, joints, tick) - late;
                integrals[signal].mean(from + shift, to + shift)
            };
            let vector =
                |first: usize| turn * nalgebra::Vector3::from_fn(|k, _| mean(joints + first + k, mounting.delay));
            for j in 0..joints {
                own[j * BINS + b] = mean(j, 0.0);
            }
            let (gyro, acc) = (vector(0), vector(3));
            for (k, value) in gyro.iter().chain(acc.iter()).enumerate() {
                own[(joints + k) * BINS + b] = *value;
            }
            let mut next = joints + 6;
            if layout.attitude {
                let up = vector(6);
                (own[next * BINS + b], own[(next + 1) * BINS + b]) = (up.x, up.y);
                next += 2;
            }
            if layout.place {
                own[next * BINS + b] = mean(joints + 9, 0.0);
                next += 1;
            }
            if layout.servo {
                own[next * BINS + b] = 0.0;
            }
        }
    }
    stack
}
