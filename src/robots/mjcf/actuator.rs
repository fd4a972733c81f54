//! `<actuator>` and `<keyframe>`: limits and gains of the joints' motors, and the standing pose.

use super::compiler::limited;
use super::defaults::{ACTUATORS, Defaults, KIND};
use crate::error::Result;
use crate::notes::Notes;
use crate::sim::tree::{Tree, TreeJoint};
use crate::xml::Element;
use std::collections::HashSet;

const KNOWN: [&str; 22] = [
    KIND,
    "name",
    "class",
    "joint",
    "group",
    "user",
    "gear",
    "ctrlrange",
    "ctrllimited",
    "forcerange",
    "forcelimited",
    "kp",
    "kv",
    "gainprm",
    "biasprm",
    "gaintype",
    "biastype",
    "dyntype",
    "inheritrange",
    "actlimited",
    "actrange",
    "jointinparent",
];

/// Gives joints the limits and gains of the actuators that drive them. `others` are joints of bodies that are not part
/// of the robot; their actuators are left out.
pub fn apply(
    root: &Element,
    defaults: &Defaults,
    autolimits: bool,
    tree: &mut Tree,
    others: &HashSet<String>,
    notes: &mut Notes,
) -> Result<()> {
    let mut driven = HashSet::new();
    for element in root.all("actuator").flat_map(|section| &section.children) {
        if !ACTUATORS.contains(&element.tag.as_str()) {
            notes.left_out(element);
            continue;
        }
        let whole = defaults.applied(element, "")?;
        let Some(name) = whole.get("joint").or(whole.get("jointinparent")) else {
            notes.part("actuator", whole.get("name").unwrap_or("without a name"), "drives no joint; it is left out");
            continue;
        };
        if others.contains(name) {
            notes.part("actuator", name, "drives a joint of a body beside the robot; it is left out");
            continue;
        }
        let mut joints = tree.bodies.iter_mut().filter_map(|b| b.joint.as_mut());
        let Some(joint) = joints.find(|j| j.name == name) else {
            return Err(element.error(format!("there is no joint {name:?}")));
        };
        if !driven.insert(name.to_owned()) {
            notes.part("joint", name, "its second actuator is left out");
            continue;
        }
        drive(&whole, autolimits, joint, notes)?;
    }
    Ok(())
}

fn drive(element: &Element, autolimits: bool, joint: &mut TreeJoint, notes: &mut Notes) -> Result<()> {
    notes.others(element, &KNOWN);
    let gear = element.list("gear")?.and_then(|g| g.first().copied()).unwrap_or(1.0);
    let first =
        |name: &str, k: usize| Ok::<_, crate::error::Error>(element.list(name)?.and_then(|l| l.get(k).copied()));
    let kind = element.tag.as_str();
    let general = kind == "general";
    let gain = if kind == "motor" { 1.0 } else { first("gainprm", 0)?.unwrap_or(1.0) };
    // A servo controls a position or a speed; other actuators use their control as a force.
    let (kp, kd) = match (kind, element.get("biastype")) {
        ("position", _) => (element.not_negative("kp")?.unwrap_or(gain), element.not_negative("kv")?.unwrap_or(0.0)),
        ("velocity", _) => (0.0, element.not_negative("kv")?.unwrap_or(gain)),
        ("general", Some("affine")) => (-first("biasprm", 1)?.unwrap_or(0.0), -first("biasprm", 2)?.unwrap_or(0.0)),
        ("motor" | "general", _) => (0.0, 0.0),
        _ => {
            notes.part("joint", &joint.name, format!("its actuator <{kind}> is left out; a servo drives it"));
            return Ok(());
        }
    };
    if general && element.get("dyntype").is_some_and(|d| d != "none") {
        notes.part("joint", &joint.name, "its actuator's own dynamics (dyntype) are left out");
    }
    let servo = kp > 0.0 || kd > 0.0;
    if servo {
        (joint.kp, joint.kd) = (Some(kp * gear * gear), Some(kd * gear * gear));
    }
    let force = element.numbers::<2>("forcerange")?;
    if limited(element, "forcelimited", force.is_some(), autolimits)? {
        limit(joint, force, gear, notes);
    }
    let control = element.numbers::<2>("ctrlrange")?;
    if !servo && limited(element, "ctrllimited", control.is_some(), autolimits)? {
        limit(joint, control, gear * gain, notes);
    }
    Ok(())
}

/// Limits a joint's torque to `factor` times a range, unless the joint already has a smaller limit. A billionth counts
/// as rounding.
fn limit(joint: &mut TreeJoint, range: Option<[f64; 2]>, factor: f64, notes: &mut Notes) {
    let Some([low, high]) = range.map(|r| r.map(|x| x * factor.abs())) else { return };
    let most = high.min(-low);
    if (low + high).abs() > 1e-9 * high.abs() {
        notes.part("joint", &joint.name, "its torque has different limits both ways; the smaller one counts for both");
    }
    if most > 0.0 {
        joint.torque_limit = Some(joint.torque_limit.map_or(most, |t| t.min(most)));
    } else {
        notes.part("joint", &joint.name, "its range of torque does not contain 0; it is left out");
    }
}

/// Sets the standing pose from the keyframe `home`, or else from the first keyframe. In a keyframe, `before` numbers of
/// other bodies precede the robot's numbers, and `after` numbers follow them.
pub fn rest(root: &Element, tree: &mut Tree, [before, after]: [usize; 2], notes: &mut Notes) -> Result<()> {
    let mut keys = root.all("keyframe").flat_map(|section| section.all("key")).filter(|k| k.get("qpos").is_some());
    let Some(first) = keys.next() else { return Ok(()) };
    let key = std::iter::once(first).chain(keys).find(|k| k.get("name") == Some("home")).unwrap_or(first);
    let values = key.list("qpos")?.unwrap_or_default();
    let joints = tree.joints().count();
    // Position and quaternion of the base come first.
    let first = before + 7;
    let wanted = first + joints + after;
    if values.len() != wanted {
        notes.say(format!("keyframe: {} numbers in place of {wanted}; it is left out", values.len()));
        return Ok(());
    }
    for (joint, value) in tree.bodies.iter_mut().filter_map(|b| b.joint.as_mut()).zip(&values[first..]) {
        joint.rest = Some(*value);
    }
    Ok(())
}
