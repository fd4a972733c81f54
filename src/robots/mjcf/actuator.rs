//! `<actuator>` and `<keyframe>`: limits and gains of the joints' motors, and the standing pose.

use super::compiler::limited;
use super::defaults::{ACTUATORS, Defaults, KIND};
use super::inertia;
use crate::error::Result;
use crate::notes::Notes;
use crate::sim::tree::{Tree, TreeJoint};
use crate::xml::Element;
use std::collections::{HashMap, HashSet};

const KNOWN: [&str; 28] = [
    KIND,
    "tendon",
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

/// A servo's targets count as limited if `ctrlrange` leaves out more than this part of the joint's range: our choice, more than
/// the rounding of files.
const LEFT_OUT: f64 = 0.01;
/// Gain and bias are unequal if they differ by more than this part: our choice, for the rounding of files.
const UNEQUAL: f64 = 1e-6;

/// What an actuator is at the joint that it drives.
struct ActuatorGains {
    /// Position and speed gain on the actuator's side of the gear; both 0: its control is a force.
    kp: f64,
    kd: f64,
    gain: f64,
    /// The damping ratio that it has in place of a damping.
    ratio: Option<f64>,
}

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
        // For each driven joint the limit of its torque without actuators.
        let mut driven: HashMap<String, Option<f64>> = HashMap::new();
        let tendons = of_one_joint(root)?;
        for element in root.all("actuator").flat_map(|section| &section.children) {
            if !ACTUATORS.contains(&element.tag.as_str()) {
                self.notes.left_out(element);
                continue;
            }
            let whole = self.defaults.applied(element, "")?;
            let own = whole.get("joint").or(whole.get("jointinparent")).map(|joint| (joint, 1.0));
            let by_tendon = || tendons.get(whole.get("tendon")?).map(|(joint, lever)| (joint.as_str(), *lever));
            let Some((name, lever)) = own.or_else(by_tendon) else {
                self.notes.not_simulated(
                    format!("<{}> on no single joint", element.tag),
                    "it acts on several joints, a slider, a site or a body; here each joint has a servo of its own",
                );
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
            match driven.get(name) {
                Some(limit) => self.second(&whole, joint, lever, *limit)?,
                None => {
                    driven.insert(name.to_owned(), joint.torque_limit);
                    self.drive(&whole, joint, lever)?;
                }
            }
        }
        for joint in tree.joints().filter(|j| driven.contains_key(&j.name) && j.kp == Some(0.0)) {
            let done = "its actuator holds a speed, not a position (kp 0), so targets do not move it; option stiffness gives a kp";
            self.notes.part("joint", &joint.name, done);
        }
        Ok(())
    }

    /// The second actuator of a joint. A servo for the position without damping and one for the speed are one servo, whose
    /// torque is at most the sum of theirs, and at most `most`, the joint's own limit. Others are left out.
    fn second(&mut self, element: &Element, joint: &mut TreeJoint, lever: f64, most: Option<f64>) -> Result<()> {
        let servo = self.servo(element)?;
        let gains = joint.kp.zip(joint.kd).zip(servo.map(|s| (s.kp, s.kd)));
        let are_one = gains.is_some_and(|(a, b)| {
            let fit = |p: (f64, f64), v: (f64, f64)| p.0 > 0.0 && p.1 == 0.0 && v.0 == 0.0 && v.1 > 0.0;
            fit(a, b) || fit(b, a)
        });
        if !are_one {
            self.notes.not_simulated("second actuators of joints", "their torque adds to that of the first");
            return Ok(());
        }
        let mut other = TreeJoint { kp: None, kd: None, torque_limit: None, ..joint.clone() };
        self.drive(element, &mut other, lever)?;
        let sum = |a: Option<f64>, b: Option<f64>| a.zip(b).map(|(a, b)| a + b);
        let both = sum(joint.torque_limit, other.torque_limit);
        let torque_limit = both.zip(most).map(|(a, b)| a.min(b)).or(both).or(most);
        *joint = TreeJoint { kp: sum(joint.kp, other.kp), kd: sum(joint.kd, other.kd), torque_limit, ..other };
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
                joint.kd = joint.kp.map(|kp| joint.kd.unwrap_or(0.0) + ratio * 2.0 * (kp * inertia).sqrt());
            }
        }
    }

    /// Gives a joint what its actuator is; `lever` is the coefficient of a tendon between them.
    fn drive(&mut self, element: &Element, joint: &mut TreeJoint, lever: f64) -> Result<()> {
        self.notes.others(element, &KNOWN);
        let gear = lever * element.list("gear")?.and_then(|g| g.first().copied()).unwrap_or(1.0);
        let damping = element.list("damping")?.and_then(|list| list.first().copied());
        // An actuator's own inertia and damping are those of its side of the gear.
        joint.armature += gear * gear * element.not_negative("armature")?.unwrap_or(0.0);
        joint.damping += gear * gear * damping.unwrap_or(0.0);
        let Some(ActuatorGains { kp, kd, gain, ratio }) = self.servo(element)? else {
            self.notes.left_out(element);
            return Ok(());
        };
        let servo = kp > 0.0 || kd > 0.0;
        if servo {
            (joint.kp, joint.kd) = (Some(kp * gear * gear), Some(kd * gear * gear));
            self.ratios.extend(ratio.map(|ratio| (joint.name.clone(), ratio)));
        }
        if element.tag == "general" {
            self.unequal(element, &ActuatorGains { kp, kd, gain, ratio })?;
        }
        self.lag(element, joint, servo)?;
        let force = element.numbers::<2>("forcerange")?;
        if limited(element, "forcelimited", force.is_some(), self.autolimits)? {
            limit(joint, force, gear, self.notes);
        }
        let control = element.numbers::<2>("ctrlrange")?;
        let controlled = limited(element, "ctrllimited", control.is_some(), self.autolimits)?;
        if controlled && !servo {
            limit(joint, control, gear * gain, self.notes);
        }
        // MuJoCo makes the targets' range from the joint's by `inheritrange`.
        let inherited = element.number("inheritrange")?.is_some_and(|part| part > 0.0 && part < 1.0 - LEFT_OUT);
        if kp > 0.0 && (inherited || (controlled && is_narrow(joint, control, gear))) {
            let done = "ctrlrange keeps its servo's targets within a part of its range; here they have all of it";
            self.notes.part("joint", &joint.name, done);
        }
        Ok(())
    }

    /// The gains of an actuator; None: it is of another kind.
    fn servo(&self, element: &Element) -> Result<Option<ActuatorGains>> {
        let first =
            |name: &str, k: usize| Ok::<_, crate::error::Error>(element.list(name)?.and_then(|l| l.get(k).copied()));
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
            _ => return Ok(None),
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
        Ok(Some(ActuatorGains { kp, kd: kd.max(0.0), gain, ratio }))
    }

    /// Notes what a `<general>` does besides being a servo or a motor.
    fn unequal(&mut self, element: &Element, servo: &ActuatorGains) -> Result<()> {
        let bias = element.get("biastype").unwrap_or("none");
        let affine = bias == "affine";
        if affine && element.list("biasprm")?.is_some_and(|list| list.first().is_some_and(|x| *x != 0.0)) {
            self.notes.not_simulated("biasprm's first number of <general>", "a constant force at the joint");
        }
        let own = if servo.kp > 0.0 { servo.kp } else { servo.kd };
        if own > 0.0 && (servo.gain - own).abs() > UNEQUAL * own {
            let effect = "the joint goes to the target times gain by bias; here it goes to the target";
            self.notes.not_simulated("gain unlike the bias of <general>", effect);
        }
        if !affine && bias != "none" {
            self.notes.not_simulated("biastype of <general>", "another force at the joint");
        }
        if element.get("gaintype").is_some_and(|kind| kind != "fixed") {
            self.notes.not_simulated("gaintype of <general>", "the force per control changes with position and speed");
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
pub fn limit(joint: &mut TreeJoint, range: Option<[f64; 2]>, factor: f64, notes: &mut Notes) {
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

/// Do the controls of a servo, beyond the gear, leave out a part of the joint's range?
fn is_narrow(joint: &TreeJoint, control: Option<[f64; 2]>, gear: f64) -> bool {
    let Some(([low, high], [a, b])) = joint.range.zip(control.map(|ends| ends.map(|x| x / gear))) else { return false };
    let rounding = LEFT_OUT * (high - low);
    a.min(b) > low + rounding || a.max(b) < high - rounding
}

/// Is the tendon no more than a lever between actuators and a single joint?
pub fn is_lever(tendon: &Element) -> bool {
    tendon.tag == "fixed" && tendon.children.len() == 1 && tendon.attributes.iter().all(|(name, _)| name == "name")
}

/// The fixed tendons of a single joint, by name: the joint, and the tendon's length per position of the joint.
fn of_one_joint(root: &Element) -> Result<HashMap<String, (String, f64)>> {
    let mut found = HashMap::new();
    for tendon in root.all("tendon").flat_map(|section| section.all("fixed")) {
        if let ([joint], Some(name)) = (&tendon.children[..], tendon.get("name")) {
            let lever = joint.number("coef")?.ok_or_else(|| joint.error("coef is missing"))?;
            found.insert(name.to_owned(), (joint.required("joint")?.to_owned(), lever));
        }
    }
    Ok(found)
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
