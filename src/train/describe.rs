//! `policy.json`: all that a program needs besides the network `policy.onnx` to run the policy, on a robot or
//! elsewhere. `python_client/sandgait_deploy/policy.schema.json` is its schema.

use super::plan::TrainingPlan;
use crate::env::Task;
use crate::env::legged::{JointTarget, LEGS, LeggedVelocity, MOST_TILT, joint_targets};
use crate::env::registry::Blueprint;
use crate::env::sensors::{Part, Sensor};
use crate::env::spec::{Column, Spec};
use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};
use std::collections::HashMap;

/// Version of the format. Version 1 had no key `version`, and none of the keys that [`robot`] and [`reading`] add.
const VERSION: u32 = 2;

/// How a policy of one of the program's tasks is run.
const ON_A_ROBOT: &str = "At each control step the network gets the observation in this order and these units, clipped to [low, \
                          high]; it normalizes it itself. Its output is the action, within [low, high]. Vectors are in the \
                          base's frame: x forward, y to the left, z up. projected_gravity is the direction of gravity. The last \
                          action is that of the step before, at first 0. Numbers that are not finite are infinite.";

/// How a policy of another program's environment is run.
const ELSEWHERE: &str = "At each step the network gets the observation as the environment returns it, flattened in row-major \
                         order, as 32-bit floats; it normalizes it itself. Its output is the action, flattened in the same way, \
                         within [low, high], in the environment's own units. Bounds of null are infinite.";

/// Options of LeggedVelocity that say with which imperfections and on which ground a policy was trained.
const CONDITIONS: [&str; 9] =
    ["action_delay", "sensors", "actuator", "hardware", "domain_rand", "ground", "slope_deg", "payload", "dt"];

/// The policy's inputs and outputs: names, units and bounds in their order, and the servos that its actions drive.
/// `onnx`: the bytes of the network's file.
pub fn policy(plan: &TrainingPlan, onnx: &[u8]) -> Value {
    match &plan.spec.blueprint {
        Some(blueprint) => of_task(blueprint, onnx),
        None => {
            let columns = |all: &[Column]| all.iter().map(column).collect::<Vec<_>>();
            let mut about = network(&plan.spec.id, onnx);
            about["rate"] = Value::Null;
            about["history"] = 1.into();
            about["about"] = ELSEWHERE.into();
            about["observation"] = json!(columns(&plan.spec.observation));
            about["action"] = json!(columns(&plan.spec.action));
            about["environment"] = json!(plan.spec.options);
            about
        }
    }
}

/// The description of a policy of one of the program's tasks.
pub fn of_task(blueprint: &Blueprint, onnx: &[u8]) -> Value {
    let task = &blueprint.task;
    let (spec, model): (&Spec, _) = (task.spec(), task.model());
    let history = task.option("history").as_u64().unwrap_or(1);
    let legged = spec.id == LeggedVelocity::ID;
    let mut about = network(spec.id, onnx);
    about["rate"] = json!(spec.control_rate);
    about["history"] = history.into();
    about["about"] = ON_A_ROBOT.into();
    about["joints"] = json!(model.joint_names());
    about["action"] = spec.action.iter().map(column).collect();
    about["observation"] = spec.observation.iter().map(column).collect();
    if legged {
        add_readings(&mut about["observation"], &spec.observation, history as usize, &default_pose(blueprint));
        let Value::Object(robot) = robot(blueprint) else { return about };
        robot.into_iter().for_each(|(key, value)| about[key] = value);
    }
    about
}

fn network(task: &str, onnx: &[u8]) -> Value {
    let digest: String = Sha256::digest(onnx).iter().map(|byte| format!("{byte:02x}")).collect();
    json!({"version": VERSION, "task": task, "network": "policy.onnx", "network_sha256": digest})
}

fn column(c: &Column) -> Value {
    json!({"name": c.name, "unit": c.unit, "low": c.low, "high": c.high})
}

fn default_pose(blueprint: &Blueprint) -> Vec<f64> {
    blueprint.task.model().tree.as_ref().map_or(Vec::new(), |tree| tree.stance.angles.clone())
}

/// The target of each action of LeggedVelocity, and those of joints that are held.
pub(super) fn targets(blueprint: &Blueprint) -> [Vec<JointTarget>; 2] {
    let task = &blueprint.task;
    joint_targets(task.model(), task.option("action_scale").as_f64(), task.option("joints") == LEGS)
}

/// What drives the robot of LeggedVelocity: targets, torques, commands, the pose in which it stands, and what the
/// policy was trained with.
fn robot(blueprint: &Blueprint) -> Value {
    let (task, model) = (&blueprint.task, blueprint.task.model());
    let stance = model.tree.as_ref().map(|tree| &tree.stance);
    let feet = |tree: &std::sync::Arc<crate::sim::tree::TreeModel>| {
        tree.stance.feet.iter().map(|foot| tree.tree.bodies[*foot].name.clone()).collect::<Vec<_>>()
    };
    let [targets, held] = targets(blueprint);
    let trained = CONDITIONS.map(|name| (name.to_owned(), task.option(name)));
    let sensors = task.option("sensors");
    let mut own = json!({
        "formulas": {
            "observation": "clip(part(reading[index] - subtract), low, high); part: the value itself, or its sine or cosine; \
                            reading: that of `steps_before` control steps earlier, at first the first one",
            "gravity": "R(quaternion)^T (0, 0, -1); quaternion w, x, y, z: rotation from the base's frame to the level frame",
            "last_action": "the action of the step before, at first 0",
            "clock": "sine and cosine of 2 pi clock_frequency t, with the time t since the policy began",
            "target": "default + scale * clip(action, low, high)",
            "torque": "clip(stiffness * (target - position) - damping * velocity, -torque_limit, torque_limit)",
            "line": "in the direction of motion a motor gives at most stall_torque * (1 - |velocity| / no_load_speed)",
        },
        "robot": {
            "name": model.tree.as_ref().map(|tree| tree.tree.name.clone()),
            "mass": model.tree.as_ref().map(|tree| tree.tree.mass()),
            "height": stance.map(|stance| stance.height),
            "leg_length": stance.map(|stance| stance.leg_length),
            "feet": model.tree.as_ref().map(feet),
        },
        "targets": targets,
        "servo_rate": 1.0 / task.option("dt").as_f64().unwrap_or(0.002),
        "commands": task.command_ranges(),
        "clock_frequency": task.option("gait_clock"),
        "velocity_by_differences": sensors["velocity_by_differences"].as_bool().unwrap_or(false),
        "most_tilt": MOST_TILT,
        "trained_with": trained.into_iter().collect::<serde_json::Map<_, _>>(),
    });
    if !held.is_empty() {
        own["held"] = json!(held);
    }
    own
}

/// Adds to each column of an observation where its number comes from.
fn add_readings(columns: &mut Value, observation: &[Column], history: usize, default: &[f64]) {
    let Some(columns) = columns.as_array_mut() else { return };
    let width = observation.len() / history.max(1);
    let mut counts: HashMap<(usize, &str), usize> = HashMap::new();
    for (i, (out, column)) in columns.iter_mut().zip(observation).enumerate() {
        let (reading, part) = reading(column);
        let back = i / width.max(1);
        let count = counts.entry((back, reading)).or_default();
        let index = *count;
        *count += 1;
        let subtract = if reading == Sensor::JointPosition.name() { default.get(index).copied() } else { None };
        out["reading"] = reading.into();
        out["index"] = index.into();
        out["subtract"] = json!(subtract.unwrap_or(0.0));
        out["part"] = part.into();
        out["steps_before"] = back.into();
    }
}

/// The reading that a column of LeggedVelocity's observation shows, and the function of it.
fn reading(column: &Column) -> (&'static str, &'static str) {
    match column.sensor {
        Some((sensor, Part::Value)) => (sensor.name(), "value"),
        Some((sensor, Part::Sine)) => (sensor.name(), "sine"),
        Some((sensor, Part::Cosine)) => (sensor.name(), "cosine"),
        None if column.name.starts_with("commanded ") => ("command", "value"),
        None if column.name.starts_with("last action") => ("last_action", "value"),
        None if column.name.starts_with("clock ") => ("clock", "value"),
        None => ("", "value"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every column of every reading is found, also those of earlier steps.
    #[test]
    fn each_column_has_its_reading() {
        let options = json!({"history": 2, "gait_clock": 1.0, "sensors": {"joint_torque": {}, "accelerometer": {}}});
        let blueprint = Blueprint::new(LeggedVelocity::ID, options).unwrap();
        let about = of_task(&blueprint, b"network");
        let columns = about["observation"].as_array().unwrap();
        assert!(columns.iter().all(|c| c["reading"] != ""));
        let of = |name: &str, back: u64| {
            columns.iter().filter(|c| c["reading"] == name && c["steps_before"] == back).count()
        };
        for back in [0, 1] {
            let counts = ["lin_vel", "gravity", "joint_position", "joint_torque", "last_action", "clock"]
                .map(|name| of(name, back));
            assert_eq!(counts, [3, 3, 12, 12, 12, 2]);
        }
        let knee = columns.iter().find(|c| c["reading"] == "joint_position" && c["index"] == 2).unwrap();
        assert_eq!(knee["subtract"], about["targets"][2]["default"]);
        assert_eq!((about["history"].as_u64(), about["version"].as_u64()), (Some(2), Some(2)));
    }
}
