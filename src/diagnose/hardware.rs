//! `hardware.toml`: what a diagnosis has found of the robot's motors, sensors and delays, for [`crate::sim::hardware`].

use super::differences::NORMAL;
use super::report::Report;
use crate::sim::hardware::{HardwareDescription, HardwareQuantity};

/// Paths of the quantities.
pub const DELAY: [&str; 3] = ["sensors.gyroscope.delay", "sensors.accelerometer.delay", "sensors.gravity.delay"];
pub const FILTER: [&str; 3] =
    ["sensors.gyroscope.low_pass", "sensors.accelerometer.low_pass", "sensors.gravity.low_pass"];
pub const ROTATION: [&str; 3] = ["sensors.imu_rotation.x", "sensors.imu_rotation.y", "sensors.imu_rotation.z"];
pub const TORQUE_GAIN: &str = "sensors.joint_torque.gain";
pub const TORQUE_CONSTANT: &str = "actuator.torque_constant";
pub const TORQUE_LIMIT: &str = "actuator.torque_limit";
pub const FRICTION: &str = "actuator.friction";

/// An effect: its id, its axis, the quantities, and its least value.
type KnownEffect = (&'static str, Option<&'static str>, &'static [&'static str], Option<f64>);

/// Effects of measuring that a report names for a robot's own log, each with the quantities of a simulation that it
/// changes. If the effect is itself the first of these quantities, the last entry is its least possible value.
const EFFECTS: [KnownEffect; 8] = [
    ("imu_rotation", Some("x"), &[ROTATION[0]], Some(f64::NEG_INFINITY)),
    ("imu_rotation", Some("y"), &[ROTATION[1]], Some(f64::NEG_INFINITY)),
    ("imu_rotation", Some("z"), &[ROTATION[2]], Some(f64::NEG_INFINITY)),
    ("imu_delay", None, &[DELAY[0], DELAY[1], DELAY[2], FILTER[0], FILTER[1], FILTER[2]], None),
    ("imu_blur", None, &[DELAY[0], DELAY[1], DELAY[2], FILTER[0], FILTER[1], FILTER[2]], None),
    ("torque_constant", None, &[TORQUE_GAIN, TORQUE_CONSTANT], Some(f64::NEG_INFINITY)),
    ("servo_gain", None, &[TORQUE_GAIN, TORQUE_CONSTANT], None),
    ("friction", None, &[FRICTION], Some(0.0)),
];

/// The quantities of a simulation that a nuisance of a robot's log changes.
pub fn quantities_of(nuisance: &str, axis: Option<&str>) -> &'static [&'static str] {
    EFFECTS.iter().find(|effect| (effect.0, effect.1) == (nuisance, axis)).map_or(&[], |effect| effect.2)
}

/// A value and the half width of its 95 % interval, which does not reach below `least`.
fn quantity(value: f64, half: f64, least: f64) -> HardwareQuantity {
    HardwareQuantity { value, interval: [value - half, value + half].map(|x| x.max(least)) }
}

/// The quantities whose 95 % interval excludes the ideal value (0; 1 for the torque constant), and also the torque limit if a weak motor
/// is among the causes.
pub fn found(report: &Report) -> HardwareDescription {
    let source = format!("sandgait diagnose, data {}: {}", report.data_sha256, report.summary);
    let mut all = HardwareDescription { source, ..HardwareDescription::default() };
    let of = |id: &str, axis: Option<&str>| {
        let own = report.nuisances.iter().find(|n| n.id == id && n.of.as_deref() == axis && n.level == "log");
        own.map(|n| (n.value, n.sd))
    };
    let measured = |id: &str| of(id, None);
    for (id, axis, paths, least) in EFFECTS {
        let Some(least) = least else { continue };
        if let Some((value, sd)) = of(id, axis).filter(|(v, sd)| v.abs() > NORMAL * sd && *v > least) {
            all.quantities.insert(paths[0].into(), quantity(value, NORMAL * sd, least));
        }
    }
    all.quantities.extend(late(measured("imu_delay"), measured("imu_blur")));
    let [(gain, gain_sd), (servo, servo_sd)] =
        ["torque_constant", "servo_gain"].map(|id| measured(id).unwrap_or_default());
    let (share, sd) = ((1.0 + servo) / (1.0 + gain), gain_sd.hypot(servo_sd));
    // A drive's torque is (1 + s)/(1 + g) times the torque that its servo requests: the logged torque is 1 + s times the request, and the
    // log is wrong by the factor 1 + g. If the requests are not known, the drive computes its torque from the current, as the log does: s = 0.
    let interval = [share * (1.0 - NORMAL * sd), share * (1.0 + NORMAL * sd)];
    if measured("torque_constant").is_some() && !(interval[0]..=interval[1]).contains(&1.0) {
        all.quantities.insert(TORQUE_CONSTANT.into(), HardwareQuantity { value: share, interval });
    }
    if let Some(cause) = report.causes.iter().find(|cause| cause.id == "motor_torque_limit" && cause.value > 0.0) {
        // The cause limits the requested torques, and motors give (1 + s)/(1 + g) times the requested torques.
        let half = |end: f64| (end / cause.value - 1.0).hypot(NORMAL * sd);
        let value = cause.value * share;
        let interval = [value * (1.0 - half(cause.ci95[0])).max(0.0), value * (1.0 + half(cause.ci95[1]))];
        all.quantities.insert(TORQUE_LIMIT.into(), HardwareQuantity { value, interval });
    }
    all
}

/// Delay and filter of the IMU, from its lag [s] and its blur [s²], each with its standard deviation. A first-order filter of time
/// constant T has the lag T and the blur T². If the log does not show a blur, the whole lag is the delay, and its interval extends
/// downwards by the largest filter that the log allows.
fn late(lag: Option<(f64, f64)>, blur: Option<(f64, f64)>) -> Vec<(String, HardwareQuantity)> {
    let Some((lag, sd)) = lag.filter(|(lag, sd)| *lag > NORMAL * sd) else { return Vec::new() };
    let half = NORMAL * sd;
    let [low, constant, high] = match blur {
        Some((blur, sd)) => [blur - NORMAL * sd, blur, blur + NORMAL * sd].map(|square| square.max(0.0).sqrt()),
        None => [0.0; 3],
    };
    let named = |paths: [&str; 3], value: f64, interval: [f64; 2]| {
        let interval = interval.map(|x| x.max(0.0));
        paths.map(|path| (path.to_string(), HardwareQuantity { value, interval }))
    };
    if low == 0.0 {
        return named(DELAY, lag, [lag - half - high, lag + half]).to_vec();
    }
    let mut all = named(FILTER, constant, [low, high]).to_vec();
    let delay = lag - constant;
    let [less, more] = [high - constant, constant - low].map(|apart| half.hypot(apart));
    if delay > less {
        all.extend(named(DELAY, delay, [delay - less, delay + more]));
    }
    all
}
