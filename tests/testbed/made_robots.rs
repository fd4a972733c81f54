//! Robots with legs of two links, as URDF.

use sandgait::env::registry::Blueprint;
use sandgait::env::shard::Shard;
use sandgait::robots::{self, Import};
use std::fmt::Write as _;

/// Reads a description from a text.
pub fn read(text: &str, ending: &str) -> Result<Import, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(format!("robot.{ending}"));
    std::fs::write(&path, text).unwrap();
    robots::load(&path).map_err(|e| e.to_string())
}

pub const INERTIAL: &str =
    r#"<inertial><mass value="0.3"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>"#;

/// A link with a ball at `z`.
pub fn ball(name: &str, z: f64) -> String {
    format!(
        r#"<link name="{name}">{INERTIAL}<collision><origin xyz="0 0 {z}"/><geometry><sphere radius="0.02"/></geometry></collision></link>"#
    )
}

pub fn joint(name: &str, parent: &str, child: &str, at: &str, axis: &str, more: &str) -> String {
    format!(
        r#"<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/><origin xyz="{at}"/><axis xyz="{axis}"/>{more}</joint>"#
    )
}

pub const BASE: &str = r#"<link name="base"><inertial><mass value="8"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><geometry><box size="0.4 0.2 0.1"/></geometry></collision></link>"#;

/// A quadruped whose legs are two links of 0.2 m; the knees' range is `knee`. All joints point up when they are at 0, if
/// `upward`.
pub fn quadruped(knee: [f64; 2], upward: bool) -> String {
    let mut text = format!(r#"<robot name="made">{BASE}"#);
    let turned = if upward { r#"" rpy="0 3.14159265358979 0"# } else { "" };
    for (k, name) in ["fl", "fr", "rl", "rr"].iter().enumerate() {
        let at = format!("{} {} 0{turned}", [0.2, 0.2, -0.2, -0.2][k], [0.15, -0.15, 0.15, -0.15][k]);
        let limit =
            |[low, high]: [f64; 2]| format!(r#"<limit lower="{low}" upper="{high}" effort="1000" velocity="20"/>"#);
        write!(text, r#"<link name="{name}_thigh">{INERTIAL}</link>{}"#, ball(&format!("{name}_shank"), -0.2)).unwrap();
        text += &joint(&format!("{name}_hip"), "base", &format!("{name}_thigh"), &at, "0 1 0", &limit([-3.1, 3.1]));
        let (thigh, shank) = (format!("{name}_thigh"), format!("{name}_shank"));
        text += &joint(&format!("{name}_knee"), &thigh, &shank, "0 0 -0.2", "0 1 0", &limit(knee));
    }
    text + "</robot>"
}

pub fn shard_of(blueprint: &Blueprint) -> Shard {
    let mut shard = Shard::new(blueprint, 1).unwrap();
    shard.reset(|_| true, Some(&[3]), |_| None);
    shard
}
