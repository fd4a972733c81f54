//! The golden trace of a policy of LeggedVelocity: readings, observations, actions, targets and torques of one walk, by
//! which every program that runs the policy can be checked, boundary by boundary.

use super::describe::targets;
use crate::env::Shard;
use crate::env::Task;
use crate::env::legged::LeggedVelocity;
use crate::env::registry::Blueprint;
use crate::error::Result;
use crate::policy::Network;
use serde_json::{Map, Value, json};
use std::fmt::Write as _;

/// Control steps before the trace, and in it: our choice, so that the robot walks, and the trace has a stride or more.
const BEFORE: usize = 50;
const STEPS: usize = 25;
/// The command as a part of its greatest values: our choice, so that each of its numbers differs from 0.
const COMMAND: [f64; 3] = [0.6, 0.3, 0.6];

/// The trace of `onnx`, a policy of `task` with these `options`, as CSV; None if the task has no servos' targets.
///
/// A row has the time since the policy began, what was measured (SI units, base's frame, quaternion w, x, y, z), the
/// observation, the action, the servos' targets, and the torque that the servos' law demands at this moment. Sensors
/// are exact, nothing is delayed, and no value is drawn.
pub fn golden(task: &str, options: &Value, onnx: &[u8]) -> Result<Option<String>> {
    if task != LeggedVelocity::ID {
        return Ok(None);
    }
    let blueprint = Blueprint::new(task, exact(options))?;
    let network = Network::new(onnx, blueprint.task.spec())?;
    let mut shard = Shard::new(&blueprint, 1)?;
    shard.reset(|_| true, Some(&[crate::evaluate::FIRST_SEED]), |_| None);
    let ranges = blueprint.task.command_ranges().unwrap_or_default();
    let command = [0, 1, 2].map(|k| COMMAND[k] * ranges[k][1]);
    shard.set_command(0, command);
    let targets = targets(&blueprint).concat();
    let mut action = vec![0.0; shard.actions()];
    let mut text = header(&blueprint);
    for step in 0..BEFORE + STEPS {
        network.act(&shard.rows.observations, &mut action)?;
        if step >= BEFORE {
            let look = shard.look(0, false);
            let state = look.state;
            let mut row = vec![look.time];
            row.extend(command);
            row.extend(state.orientation);
            row.extend(state.to_body(state.velocity).into_iter().chain(state.to_body(state.angular_velocity)));
            row.extend(state.angles.iter().chain(&state.rates).chain(&state.torques));
            let joints = look.model.joint_names();
            let actions = action.iter().chain(std::iter::repeat(&0.0));
            let driven = targets.iter().zip(actions).map(|(servo, action)| {
                let at = joints.iter().position(|joint| *joint == servo.joint).unwrap_or(0);
                let target = servo.default + servo.scale * f64::from(*action);
                let torque = servo.stiffness * (target - state.angles[at]) - servo.damping * state.rates[at];
                let limit = servo.torque_limit.unwrap_or(f64::INFINITY);
                (target, torque.clamp(-limit, limit))
            });
            let (wanted, torques): (Vec<f64>, Vec<f64>) = driven.unzip();
            // 64-bit numbers, so that the observation follows from them to the last bit; the rest is in 32 bits.
            line(&mut text, row.iter());
            text.push(',');
            line(&mut text, shard.rows.observations.iter().chain(&action));
            text.push(',');
            line(&mut text, wanted.iter().chain(&torques).map(|x| *x as f32));
            text.push('\n');
        }
        shard.step(&action);
    }
    Ok(Some(text))
}

fn line<T: std::fmt::Display>(text: &mut String, numbers: impl Iterator<Item = T>) {
    for (k, number) in numbers.enumerate() {
        let comma = if k == 0 { "" } else { "," };
        // Writing into a string cannot fail.
        let _ = write!(text, "{comma}{number}");
    }
}

/// The columns have the names of a robot's log (docs/diagnosis_files.md).
fn header(blueprint: &Blueprint) -> String {
    let (spec, joints) = (blueprint.task.spec(), blueprint.task.model().joint_names());
    let targets = targets(blueprint).concat();
    let motors: Vec<&str> = targets.iter().map(|servo| &servo.joint[..]).collect();
    let mut names: Vec<String> = ["t", "command_x", "command_y", "command_yaw"].map(str::to_owned).to_vec();
    names.extend(["w", "x", "y", "z"].map(|axis| format!("quat_{axis}")));
    names.extend(["x", "y", "z"].map(|axis| format!("lin_vel_{axis}")));
    names.extend(["x", "y", "z"].map(|axis| format!("gyro_{axis}")));
    for kind in ["q", "qd", "tau"] {
        names.extend(joints.iter().map(|joint| format!("{kind}:{joint}")));
    }
    names.extend((0..spec.observation.len()).map(|k| format!("obs:{k}")));
    names.extend((0..spec.action.len()).map(|k| format!("action:{k}")));
    names.extend(motors.iter().map(|joint| format!("target:{joint}")));
    names.extend(motors.iter().map(|joint| format!("effort:{joint}")));
    names.join(",") + "\n"
}

/// The options with exact sensors, without delays, draws and a curriculum.
fn exact(options: &Value) -> Value {
    let mut all = options.as_object().cloned().unwrap_or_default();
    let kept = ["without", "velocity_by_differences", "imu_position"];
    if let Some(Value::Object(sensors)) = all.get("sensors") {
        let plain = |(name, value): (&String, &Value)| {
            let value = if kept.contains(&&name[..]) { value.clone() } else { json!({}) };
            (name != "imu_rotation" && !value.is_null()).then(|| (name.clone(), value))
        };
        let present = sensors.iter().filter(|(_, value)| !value.is_null());
        let sensors: Map<String, Value> = present.filter_map(plain).collect();
        all.insert("sensors".into(), sensors.into());
    }
    for (name, value) in [
        ("action_delay", json!([0.0, 0.0])),
        ("hardware", json!("")),
        ("domain_rand", Value::Null),
        ("curriculum", Value::Null),
        ("privileged", json!(false)),
    ] {
        all.insert(name.into(), value);
    }
    all.into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::write::OnnxWriter;

    #[test]
    fn a_trace_has_a_row_for_each_step_and_a_number_for_each_column() {
        let options =
            json!({"sensors": {"gyroscope": {"noise_density": 0.1}, "joint_torque": {}}, "action_delay": [0.0, 0.1]});
        let blueprint = Blueprint::new(LeggedVelocity::ID, options.clone()).unwrap();
        let width = blueprint.task.spec().observation.len();
        let mut file = OnnxWriter::new(width);
        let action = file.dense(&file.input(), &vec![0.01; width * 12], &[0.1; 12]);
        let onnx = file.finish(&action, 12);
        let text = golden(LeggedVelocity::ID, &options, &onnx).unwrap().unwrap();
        let widths: Vec<usize> = text.lines().map(|line| line.split(',').count()).collect();
        assert_eq!(widths, [14 + 3 * 12 + width + 3 * 12; STEPS + 1]);
        assert!(golden("sandgait/HexapodGait-v1", &json!({}), &onnx).unwrap().is_none());
    }
}
