//! Packed robots that an attacker who knows the format might craft.

use sandgait::sim::tree::packed;
use serde_json::{Value, json};

/// The built-in robot, changed.
pub fn robot(change: impl FnOnce(&mut Value)) -> String {
    let mut robot: Value = serde_json::from_str(include_str!("../../src/env/options/sandcat.json")).unwrap();
    change(&mut robot);
    packed::compressed(&robot.to_string(), 1).unwrap()
}

pub fn shape(name: &str) -> Value {
    json!({"name": name, "origin": [0, 0, 0, 1, 0, 0, 0], "kind": "sphere", "size": [0.01, 0, 0], "friction": 1})
}

/// Leaves no shapes for pictures: with an empty list the shapes of bodies were once not counted.
pub fn without_looks(robot: &mut Value) {
    robot["looks"] = json!({"meshes": [], "shapes": []});
}

/// Very many shapes on the base.
pub fn many_shapes(robot: &mut Value) {
    without_looks(robot);
    robot["bodies"][0]["shapes"] = vec![shape("s"); 40_000].into();
}

/// 128 bodies in a row, and 127 feet on the last one.
pub fn long_chain(robot: &mut Value) {
    without_looks(robot);
    let bodies = robot["bodies"].as_array_mut().unwrap();
    let mut link = bodies[1].clone();
    link["joint"]["rest"] = Value::Null;
    link["plates"] = json!([]);
    link["contacts"] = json!([[0.0, 0.0, -0.01, 0.01, 1.0, 0.0, 0.0, 0.0]]);
    bodies.truncate(1);
    for k in 1..256_usize {
        link["parent"] = k.min(129).saturating_sub(1).into();
        bodies.push(link.clone());
    }
}
