//! A hexapod of boxes and rods, as URDF.

use super::packing::pack;
use sandgait::robots::{self, Import};
use sandgait::sim::tree::TreeModel;
use serde_json::{Value, json};
use std::f64::consts::PI;
use std::fmt::Write as _;

/// A hexapod whose two or three joints a leg turn with at most `speed` [rad/s]: the first turns the leg about the
/// vertical, the others lift it. `places`: x, y [m] and direction [rad] of each leg; `inertia`: factor on all inertias.
pub fn hexapod(places: &[[f64; 3]], knees: bool, speed: f64, inertia: f64) -> String {
    let mut text = String::from("<robot name=\"hexapod\">");
    let inertial = |mass: f64, moment: f64, x: f64| {
        let i = moment * inertia;
        format!(
            "<inertial><origin xyz=\"{x} 0 0\"/><mass value=\"{mass}\"/>\
             <inertia ixx=\"{i}\" ixy=\"0\" ixz=\"0\" iyy=\"{i}\" iyz=\"0\" izz=\"{i}\"/></inertial>"
        )
    };
    let rod = |x: f64, length: f64, radius: f64| {
        format!(
            "<collision><origin xyz=\"{x} 0 0\" rpy=\"0 {} 0\"/><geometry>\
             <cylinder radius=\"{radius}\" length=\"{length}\"/></geometry></collision>",
            PI / 2.0
        )
    };
    let body = "<collision><geometry><box size=\"0.2 0.14 0.05\"/></geometry></collision>";
    write!(text, "<link name=\"base\">{}{body}</link>", inertial(1.4, 6e-3, 0.0)).unwrap();
    for (k, [x, y, yaw]) in places.iter().enumerate() {
        let lengths: &[f64] = if knees { &[0.05, 0.08, 0.13] } else { &[0.06, 0.16] };
        let (mut parent, mut at) = ("base".to_owned(), format!("xyz=\"{x} {y} 0\" rpy=\"0 0 {yaw}\""));
        for (j, length) in lengths.iter().enumerate() {
            let name = format!("leg{k}_{j}");
            let foot = if j + 1 == lengths.len() {
                format!(
                    "<collision><origin xyz=\"{length} 0 0\"/><geometry><sphere radius=\"0.012\"/></geometry></collision>"
                )
            } else {
                String::new()
            };
            let axis = if j == 0 { "0 0 1" } else { "0 1 0" };
            write!(
                text,
                "<link name=\"{name}\">{}{}{foot}</link><joint name=\"{name}\" type=\"revolute\"><parent link=\"{parent}\"/>\
                 <child link=\"{name}\"/><origin {at}/><axis xyz=\"{axis}\"/>\
                 <limit lower=\"-1.5\" upper=\"1.5\" effort=\"2\" velocity=\"{speed}\"/></joint>",
                inertial(0.08, 1e-4, length / 2.0),
                rod(length / 2.0, *length, 0.01),
            )
            .unwrap();
            (parent, at) = (name, format!("xyz=\"{length} 0 0\""));
        }
    }
    text + "</robot>"
}

/// Three legs at each side.
pub const BESIDE: [[f64; 3]; 6] = [
    [0.1, 0.07, 0.6],
    [0.0, 0.08, PI / 2.0],
    [-0.1, 0.07, PI - 0.6],
    [0.1, -0.07, -0.6],
    [0.0, -0.08, -PI / 2.0],
    [-0.1, -0.07, 0.6 - PI],
];

/// Six legs on a circle, one of them in front and one behind.
pub fn around() -> Vec<[f64; 3]> {
    (0..6).map(|k| f64::from(k) * PI / 3.0).map(|yaw| [0.1 * yaw.cos(), 0.1 * yaw.sin(), yaw]).collect()
}

pub fn read(text: &str) -> Import {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("robot.urdf");
    std::fs::write(&path, text).unwrap();
    robots::load(&path).unwrap()
}

pub fn model(text: &str) -> TreeModel {
    let tree = read(text).tree;
    let bodies = tree.bodies.len();
    TreeModel::new(tree, vec![Vec::new(); bodies]).unwrap()
}

/// LeggedVelocity on packed seeds with this robot.
pub fn options(text: &str) -> Value {
    let import = read(text);
    json!({"robot": pack(&import), "ground": "poppy-close"})
}
