//! Options that every task has: its sensors, the delay of its actions, and additional rows for a policy.

use super::Sensor;
use crate::error::{Error, Result};
use crate::options;
use crate::options::OptionValue;
use crate::sim::MemoryCount;
use crate::sim::actuator::Actuator;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use serde_json::Value;
use std::f64::consts::PI;

/// Longest delay of a sensor or an action [s]: our choice, several times the delay of a robot that is steered over a network.
pub const LONGEST_DELAY: f64 = 0.5;
/// Largest distance of the inertial measurement unit from the base's origin along an axis [m]: our choice, as for the
/// parts of a robot.
const FARTHEST: f64 = 10.0;
/// Largest number of observations in a row of [`Hardware::history`]: our choice, four times the 15 of humanoid-gym.
const MOST_HISTORY: f64 = 64.0;

options! {
    /// Imperfections of a sensor. u: the unit of its values.
    #[derive(Copy, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Imperfections {
        noise_density: f64 = 0.0, [0.0, 1e9], "white noise [u/√Hz]; a sample's standard deviation is this times the square root of the control rate";
        gain: f64 = 0.0, [-0.99, 100.0], "relative error of the gain; the value is multiplied by 1 + gain";
        offset: f64 = 0.0, [-1e9, 1e9], "constant error that all values and episodes share [u]";
        bias: f64 = 0.0, [0.0, 1e9], "standard deviation of a constant error, drawn for each value and episode [u]";
        random_walk: f64 = 0.0, [0.0, 1e9], "density of the random walk of the bias [u·√Hz]; in a step its standard deviation is this times the square root of the step's duration";
        delay: f64 = 0.0, [0.0, LONGEST_DELAY], "age of the value [s]; between control steps it is interpolated, and in the beginning it is the first value";
        low_pass: f64 = 0.0, [0.0, 100.0], "time constant of a first-order low-pass filter [s]; 0: none";
        quantization: f64 = 0.0, [0.0, 1e9], "distance of neighbouring values [u]; 0: none";
        dropout: f64 = 0.0, [0.0, 0.999], "probability that a sample is lost; the value then stays the last one";
    }
}

options! {
    /// Imperfections by sensor. A sensor without an entry is exact. A sensor that the task does not observe is added to
    /// the observation if it has an entry, which may be empty.
    #[derive(Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Sensors {
        gravity: Option<Imperfections> = None, "direction of gravity, body frame";
        lin_vel: Option<Imperfections> = None, "velocity of the base [m/s], body frame";
        gyroscope: Option<Imperfections> = None, "angular velocity of the base [rad/s], body frame";
        accelerometer: Option<Imperfections> = None, "specific force [m/s²] at imu_position, body frame: its mean over the control step";
        joint_position: Option<Imperfections> = None, "joint angles [rad]";
        joint_velocity: Option<Imperfections> = None, "joint speeds [rad/s]";
        joint_torque: Option<Imperfections> = None, "torques of the motors [N·m]";
        contact_force: Option<Imperfections> = None, "force of the ground on each foot along the surface's normal [N]";
        contact_switch: Option<Imperfections> = None, "is the force on a foot more than 2 % of the robot's weight? 0 or 1";
        heights: Option<Imperfections> = None, "measured heights of the ground [m]";
        range_finder: Option<Imperfections> = None, "distance from the base's origin to the ground along the base's downward axis [m], at most 10 m; the ground is taken to be level at its height under the base";
        imu_position: [f64; 3] = [0.0; 3], [-FARTHEST, FARTHEST], "place of the accelerometer in the base's frame [m]";
        imu_rotation: [f64; 3] = [0.0; 3], [-PI, PI], "rotation of the inertial measurement unit (gravity, gyroscope, accelerometer) from the base's frame: vector along its axis, with the angle as its length [rad]";
        velocity_by_differences: bool = false, "joint speeds are differences of the measured joint positions over the control period";
        without: Vec<String> = Vec::new(), "sensors whose values are left out of the observation, because the robot does not have them";
    }
}

/// `"exact"`, or sensors.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SensorOptions(pub Sensors);

/// The value that stands for sensors without imperfections.
const EXACT: &str = "exact";

impl Serialize for SensorOptions {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        if self.0 == Sensors::default() { serializer.serialize_str(EXACT) } else { self.0.serialize(serializer) }
    }
}

impl<'de> Deserialize<'de> for SensorOptions {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        match Value::deserialize(deserializer)? {
            Value::String(text) if text == EXACT => Ok(Self::default()),
            value @ Value::Object(_) => Sensors::deserialize(value).map(Self).map_err(de::Error::custom),
            other => Err(de::Error::custom(format!("{other} is neither {EXACT:?} nor a dictionary of sensors"))),
        }
    }
}

impl OptionValue for SensorOptions {
    fn count_memory(&self, count: &mut MemoryCount) {
        OptionValue::count_memory(&self.0, count);
    }

    fn check(&self, name: &str) -> Result<()> {
        self.0.check(name)?;
        let known = Sensor::ALL.map(Sensor::name);
        match self.0.without.iter().find(|w| !known.contains(&w.as_str())) {
            Some(unknown) => Err(Error::unknown("sensor", unknown, &known)),
            None => Ok(()),
        }
    }

    fn keys() -> Vec<crate::options::OptionRow> {
        Sensors::keys()
    }
}

options! {
    /// The motors of all joints.
    #[derive(Copy, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Motors {
        torque_limit: Option<f64> = None, [Actuator::TORQUE_LIMIT], "largest torque of motor and drive [N·m]; None: that of the robot";
        stall_torque: Option<f64> = None, [Actuator::STALL_TORQUE], "torque at standstill [N·m]; None: that of the robot, or twice its torque limit";
        no_load_speed: Option<f64> = None, [Actuator::NO_LOAD_SPEED], "speed without a load [rad/s], at which the torque has fallen to zero; None: that of the robot, or no limit";
        torque_time: Option<f64> = None, [Actuator::TORQUE_TIME], "time constant with which the torque follows the servo [s]; None: that of the robot, or 0";
        torque_constant: Option<f64> = None, [Actuator::TORQUE_CONSTANT], "the motors' torque constant divided by that with which their drives reckon: factor on the servo's torque; None: that of the robot, or 1";
        friction: Option<f64> = None, [Actuator::FRICTION], "dry friction of the gear [N·m]; None: that of the robot";
        damping: Option<f64> = None, [Actuator::DAMPING], "viscous friction of the gear [N·m·s/rad]; None: that of the robot";
        efficiency: Option<f64> = None, [Actuator::EFFICIENCY], "share of the torque that the gear passes on; None: that of the robot, or 1";
        rotor_inertia: Option<f64> = None, [Actuator::ROTOR_INERTIA], "inertia of rotor and gear at the joint, in addition to the robot's [kg·m²]; None: that of the robot, or 0";
    }
}

impl From<Motors> for Actuator {
    fn from(motors: Motors) -> Self {
        let Motors { torque_limit, stall_torque, no_load_speed, torque_time, .. } = motors;
        let Motors { torque_constant, friction, damping, efficiency, rotor_inertia, .. } = motors;
        Self {
            torque_limit,
            stall_torque,
            no_load_speed,
            torque_time,
            torque_constant,
            friction,
            damping,
            efficiency,
            rotor_inertia,
        }
    }
}

options! {
    /// The files from whose intervals an episode's hardware is drawn.
    #[derive(Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct HardwareRand {
        hardware: String = String::new(), reset, "text of a hardware.toml (in Python its path); its quantities are drawn uniformly from their intervals";
    }
}

options! {
    /// Options of every task.
    pub struct Hardware {
        sensors: SensorOptions = SensorOptions::default(), "\"exact\", or the imperfections of each sensor: a dictionary of sensors, each a dictionary";
        history: u32 = 1, [1.0, MOST_HISTORY], "number of observations in a row of the observation: the present one, then those of the steps before it";
        privileged: bool = false, "add the exact values of all sensors to info";
        actuator: Motors = Motors::default(), "what the motors can do: a DC motor's line of torque and speed, and its lag";
        action_delay: [f64; 2] = [0.0, 0.0], [0.0, LONGEST_DELAY], reset, "range [low, high] of the time from an action to the motors [s], drawn for each episode; before the first action the action is 0";
        hardware: String = String::new(), "text of a hardware.toml, for example from a diagnosis (in Python its path); its values hold where sensors, actuator and action_delay say nothing";
        domain_rand: HardwareRand = HardwareRand::default(), reset, "what each episode draws";
    }
}
