//! `policy.json`: all that a program needs to run `policy.onnx` on a robot, besides the network.

use super::plan::TrainingPlan;
use crate::env::Task;
use crate::env::legged::{LeggedVelocity, joint_targets};
use crate::env::spec::Column;
use crate::env::spec::Spec;
use serde_json::{Value, json};

/// The policy's inputs and outputs: names, units and bounds in their order, and the servos that its actions drive.
pub fn policy(plan: &TrainingPlan) -> Value {
    let task = &plan.blueprint.task;
    let (spec, model): (&Spec, _) = (task.spec(), task.model());
    let column = |c: &Column| json!({"name": c.name, "unit": c.unit, "low": c.low, "high": c.high});
    let columns = |all: &[Column]| all.iter().map(column).collect::<Vec<_>>();
    let mut about = json!({
        "task": spec.id,
        "network": "policy.onnx",
        "rate": spec.control_rate,
        "history": 1,
        "about": "At each control step the network gets the observation in this order and these units, clipped to [low, high]; it \
                  normalizes it itself. Its output is the action, within [low, high]. Vectors are in the base's frame: x forward, \
                  y to the left, z up. projected_gravity is the direction of gravity. The last action is that of the step before, at \
                  first 0. Numbers that are not finite are infinite.",
        "observation": columns(&spec.observation),
        "action": columns(&spec.action),
        "joints": model.joint_names(),
    });
    if spec.id == LeggedVelocity::ID {
        let scale = task.option("action_scale").as_f64();
        about["targets"] = json!(joint_targets(model, scale));
        about["commands"] = json!(task.command_ranges());
    }
    about
}
