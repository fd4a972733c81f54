//! `hardware.toml`: what a diagnosis has found of the robot's motors, sensors and delays, for [`crate::sim::hardware`].

use super::evidence::NORMAL;
use super::report::Report;
use crate::sim::hardware::{HardwareDescription, HardwareQuantity};

/// An effect of measuring that a report names for a robot's own log: its id there, the quantities that it is in a simulation, and the least
/// possible value.
const EFFECTS: [(&str, &[&str], f64); 6] = [
    ("imu_delay", &["sensors.gravity.delay", "sensors.gyroscope.delay", "sensors.accelerometer.delay"], 0.0),
    ("imu_rotation_x", &["sensors.imu_rotation.x"], f64::NEG_INFINITY),
    ("imu_rotation_y", &["sensors.imu_rotation.y"], f64::NEG_INFINITY),
    ("imu_rotation_z", &["sensors.imu_rotation.z"], f64::NEG_INFINITY),
    ("torque_constant", &["sensors.joint_torque.gain"], f64::NEG_INFINITY),
    ("friction", &["actuator.friction"], 0.0),
];

/// The quantities whose 95 % interval excludes 0, and the torque limit of a weak motor that is a cause.
pub fn found(report: &Report) -> HardwareDescription {
    let source = format!("sandgait diagnose, data {}: {}", report.data_sha256, report.summary);
    let mut all = HardwareDescription { source, ..HardwareDescription::default() };
    for (id, paths, least) in EFFECTS {
        let values = report.nuisances.iter().filter(|n| n.id == id && n.level == "log");
        for n in values.filter(|n| n.value.abs() > NORMAL * n.sd && n.value > least) {
            let interval = [n.value - NORMAL * n.sd, n.value + NORMAL * n.sd].map(|x| x.max(least));
            let quantity = HardwareQuantity { value: n.value, interval };
            all.quantities.extend(paths.iter().map(|path| ((*path).to_owned(), quantity)));
        }
    }
    // A drive's torque is (1 + s)/(1 + g) of what its servo requests: by the log it is 1 + s of that, and the log is wrong by the factor
    // 1 + g. If the requests are not known, the drive computes its torque from the current, as the log does: s = 0.
    let measured = |id: &str| report.nuisances.iter().find(|n| n.id == id && n.level == "log").map(|n| (n.value, n.sd));
    if let Some((gain, sd)) = measured("torque_constant") {
        let (servo, servo_sd) = measured("servo_gain").unwrap_or_default();
        let (value, half) = ((1.0 + servo) / (1.0 + gain), NORMAL * sd.hypot(servo_sd));
        let interval = [value * (1.0 - half), value * (1.0 + half)];
        if !(interval[0]..=interval[1]).contains(&1.0) {
            all.quantities.insert("actuator.torque_constant".into(), HardwareQuantity { value, interval });
        }
    }
    if let Some(cause) = report.causes.iter().find(|cause| cause.id == "motor_torque_limit" && cause.value > 0.0) {
        let [low, high] = cause.ci95;
        let interval = [low.clamp(0.0, cause.value), high.max(cause.value)];
        let quantity = HardwareQuantity { value: cause.value, interval };
        all.quantities.insert("actuator.torque_limit".into(), quantity);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::found;
    use crate::diagnose;
    use crate::progress::Silent;
    use crate::sand::mechanism::Mechanisms;
    use crate::sim::hardware::{HardwareDescription, HardwareQuantity};
    use crate::trajectory::generate::{Truth, csv, experiment, file};
    use rand::{Rng as _, SeedableRng as _};

    /// Number of logs: our choice, because each takes seconds.
    const LOGS: u64 = 3;

    /// Logs of walks with a late and crooked IMU, of which every other one has weak motors. The intervals of what is found contain the truth in
    /// nearly all cases; with so few logs two of ten may miss it.
    #[test]
    fn intervals_contain_the_truth() {
        let (mut within, mut all) = (0, 0);
        for seed in 0..LOGS {
            let mut draw = rand_xoshiro::Xoshiro256PlusPlus::seed_from_u64(7000 + seed);
            let limit = if seed % 2 == 1 { draw.random_range(0.007..0.013) } else { 0.0 };
            let mechanisms = Mechanisms { motor_torque_limit: limit, ..Mechanisms::PLAIN };
            let turn = [0; 3].map(|_| draw.random_range(-0.05..0.05));
            let truth = Truth {
                turn,
                delay: f64::from(draw.random_range(0..13_u8)) * 1e-3,
                ..Truth::new(mechanisms, 7000 + seed)
            };
            let report = diagnose(file(&csv(&truth)).path(), &experiment(), &Silent).unwrap().report;
            let hardware = found(&report);
            assert_eq!(HardwareDescription::from_toml(&hardware.to_toml()).unwrap(), hardware);
            for (path, value) in [
                ("sensors.gyroscope.delay", truth.delay),
                ("sensors.imu_rotation.x", turn[0]),
                ("sensors.imu_rotation.y", turn[1]),
                ("sensors.imu_rotation.z", turn[2]),
                ("actuator.torque_limit", limit),
            ] {
                let Some(HardwareQuantity { interval: [low, high], .. }) = hardware.quantities.get(path) else {
                    assert!(path != "actuator.torque_limit" || limit == 0.0, "{}", report.summary);
                    continue;
                };
                println!("{seed} {path}: {value:.5} in [{low:.5}, {high:.5}]: {}", (low..=high).contains(&&value));
                all += 1;
                within += u32::from((low..=high).contains(&&value));
            }
        }
        println!("{within} of {all}");
        assert!(all >= 3 * LOGS as u32 && 10 * within >= 8 * all, "{within} of {all}");
    }
}
