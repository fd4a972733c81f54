//! `<actuator>` and `<keyframe>`: limits and gains of the joints' motors, and the standing pose.

use super::compiler::limited;
use super::defaults::{ACTUATORS, Defaults, KIND};
use super::inertia;
use crate::error::Result;
use crate::notes::Notes;
use crate::sim::tree::{Tree, TreeJoint};
use crate::xml::Element;
use std::collections::{HashMap, HashSet};

const KNOWN: [&str; 27] = [
    KIND,
    "armature",
    "damping",
    "dampratio",
    "dynprm",
    "timeconst",
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

/// Reads actuators.
pub struct Actuators<'a> {
    pub defaults: &'a Defaults,
    pub autolimits: bool,
    pub notes: &'a mut Notes,
    /// Joints whose servos have a damping ratio in place of a damping.
    pub ratios: Vec<(String, f64)>,
}

impl Actuators<'_> {
    /// Gives joints the limits and gains of the actuators that drive them. `others` are joints of bodies that are not part
    /// of the robot; their actuators are left out.
    pub fn apply(&mut self, root: &Element, tree: &mut Tree, others: &HashSet<String>) -> Result<()> {
        let mut driven = HashSet::new();
        for element in root.all("actuator").flat_map(|section| &section.children) {
            if !ACTUATORS.contains(&element.tag.as_str()) {
                self.notes.left_out(element);
                continue;
            }
            let whole = self.defaults.applied(element, "")?;
            let Some(name) = whole.get("joint").or(whole.get("jointinparent")) else {
                let name = whole.get("name").unwrap_or("without a name");
                self.notes.part("actuator", name, "drives no joint; it is left out");
                continue;
            };
            if others.contains(name) {
                self.notes.part("actuator", name, "drives a joint of a body beside the robot; it is left out");
                continue;
            }
            let mut joints = tree.bodies.iter_mut().filter_map(|b| b.joint.as_mut());
            let Some(joint) = joints.find(|j| j.name == name) else {
                return Err(element.error(format!("there is no joint {name:?}")));
            };
            if !driven.insert(name.to_owned()) {
                self.notes.part("joint", name, "its second actuator is left out");
                continue;
            }
            self.drive(&whole, joint)?;
        }
        Ok(())
    }

    /// Gives servos with a damping ratio ζ their damping 2 ζ √(kp M), as MuJoCo: M is the inertia that the joint moves in
    /// the reference pose, in which joints are at `references`.
    pub fn damp(&mut self, tree: &mut Tree, references: &HashMap<String, f64>, base_is_free: bool) {
        if self.ratios.is_empty() {
            return;
        }
        let angles: Vec<f64> = tree.joints().map(|j| references.get(&j.name).copied().unwrap_or(0.0)).collect();
        // Without an inverse the robot is refused afterwards, because a joint has no inertia to move.
        let Some(inertias) = inertia::of_joints(tree, &angles, base_is_free) else { return };
        for (joint, inertia) in tree.bodies.iter_mut().filter_map(|b| b.joint.as_mut()).zip(inertias) {
            if let Some((_, ratio)) = self.ratios.iter().find(|(name, _)| *name == joint.name) {
                joint.kd = joint.kp.map(|kp| ratio * 2.0 * (kp * inertia).sqrt());
            }
        }
    }

    fn drive(&mut self, element: &Element, joint: &mut TreeJoint) -> Result<()> {
        self.notes.others(element, &KNOWN);
        let gear = element.list("gear")?.and_then(|g| g.first().copied()).unwrap_or(1.0);
        let first =
            |name: &str, k: usize| Ok::<_, crate::error::Error>(element.list(name)?.and_then(|l| l.get(k).copied()));
        // An actuator's own inertia and damping are those of its side of the gear.
        joint.armature += gear * gear * element.not_negative("armature")?.unwrap_or(0.0);
        joint.damping += gear * gear * first("damping", 0)?.unwrap_or(0.0);
        let kind = element.tag.as_str();
        let gain = if kind == "motor" { 1.0 } else { first("gainprm", 0)?.unwrap_or(1.0) };
        let bias = |k: usize| Ok::<_, crate::error::Error>(-first("biasprm", k)?.unwrap_or(0.0));
        // A servo controls a position or a speed; other actuators use their control as a force.
        let (kp, kd) = match (kind, element.get("biastype")) {
            ("position", _) => {
                (element.not_negative("kp")?.unwrap_or(gain), element.not_negative("kv")?.unwrap_or(0.0))
            }
            ("velocity", _) => (0.0, element.not_negative("kv")?.unwrap_or(gain)),
            ("general", Some("affine")) => (bias(1)?, bias(2)?),
            ("motor" | "general", _) => (0.0, 0.0),
            _ => {
                self.notes.left_out(element);
                return Ok(());
            }
        };
        let ratio = match kind {
            "position" => element.not_negative("dampratio")?.filter(|ratio| *ratio > 0.0),
            // MuJoCo takes the third number of a position servo for a damping ratio if it is positive.
            "general" if kd < 0.0 && kp > 0.0 && kp == gain => Some(-kd),
            _ => None,
        };
        if ratio.is_some() && kd > 0.0 {
            return Err(element.wrong("dampratio", "is given with kv: one of them must go"));
        }
        let servo = kp > 0.0 || kd > 0.0;
        if servo {
            (joint.kp, joint.kd) = (Some(kp * gear * gear), Some(kd.max(0.0) * gear * gear));
            self.ratios.extend(ratio.map(|ratio| (joint.name.clone(), ratio)));
        }
        self.lag(element, joint, servo)?;
        let force = element.numbers::<2>("forcerange")?;
        if limited(element, "forcelimited", force.is_some(), self.autolimits)? {
            limit(joint, force, gear, self.notes);
        }
        let control = element.numbers::<2>("ctrlrange")?;
        if !servo && limited(element, "ctrllimited", control.is_some(), self.autolimits)? {
            limit(joint, control, gear * gain, self.notes);
        }
        Ok(())
    }

    /// The lag of an actuator: of the target of a servo, or of the torque of a motor.
    fn lag(&mut self, element: &Element, joint: &mut TreeJoint, servo: bool) -> Result<()> {
        let own = element.list("dynprm")?.and_then(|list| list.first().copied());
        let time = match (element.tag.as_str(), element.get("dyntype")) {
            ("position", _) => element.not_negative("timeconst")?.unwrap_or(0.0),
            ("general", Some("filter" | "filterexact")) => own.unwrap_or(1.0),
            ("general", Some(other)) if other != "none" => {
                self.notes.part(
                    "joint",
                    &joint.name,
                    format!("its actuator's own dynamics ({other}) are not simulated"),
                );
                return Ok(());
            }
            _ => return Ok(()),
        };
        match (time > 0.0, servo) {
            (false, _) => {}
            (true, true) => joint.target_time = Some(time),
            (true, false) => joint.motor.torque_time = Some(time),
        }
        Ok(())
    }
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
