//! `policy.json`: all that a program needs besides the network `policy.onnx` to run the policy, on a robot or
//! elsewhere.

use super::plan::TrainingPlan;
use crate::env::Task;
use crate::env::legged::{LeggedVelocity, joint_targets};
use crate::env::spec::Column;
use crate::env::spec::Spec;
use serde_json::{Value, json};

/// How a policy of one of the program's tasks is run.
const ON_A_ROBOT: &str = "At each control step the network gets the observation in this order and these units, clipped to [low, \
                          high]; it normalizes it itself. Its output is the action, within [low, high]. Vectors are in the \
                          base's frame: x forward, y to the left, z up. projected_gravity is the direction of gravity. The last \
                          action is that of the step before, at first 0. Numbers that are not finite are infinite.";

/// How a policy of another program's environment is run.
const ELSEWHERE: &str = "At each step the network gets the observation as the environment returns it, flattened in row-major \
                         order, as 32-bit floats; it normalizes it itself. Its output is the action, flattened in the same way, \
                         within [low, high], in the environment's own units. Bounds of null are infinite.";

/// The policy's inputs and outputs: names, units and bounds in their order, and the servos that its actions drive.
pub fn policy(plan: &TrainingPlan) -> Value {
    let column = |c: &Column| json!({"name": c.name, "unit": c.unit, "low": c.low, "high": c.high});
    let columns = |all: &[Column]| all.iter().map(column).collect::<Vec<_>>();
    let mut about = json!({
        "task": plan.spec.id,
        "network": "policy.onnx",
        "rate": null,
        "history": 1,
        "about": ELSEWHERE,
        "observation": columns(&plan.spec.observation),
        "action": columns(&plan.spec.action),
    });
    let Some(task) = plan.spec.blueprint.as_ref().map(|blueprint| &blueprint.task) else {
        about["environment"] = json!(plan.spec.options);
        return about;
    };
    let (spec, model): (&Spec, _) = (task.spec(), task.model());
    about["rate"] = json!(spec.control_rate);
    about["about"] = ON_A_ROBOT.into();
    about["joints"] = json!(model.joint_names());
    if spec.id == LeggedVelocity::ID {
        let scale = task.option("action_scale").as_f64();
        about["targets"] = json!(joint_targets(model, scale));
        about["commands"] = json!(task.command_ranges());
    }
    about
}
