//! What the parts of a description that are not simulated do to the motion in other programs or on the robot.
//!
//! Parts without an entry have no effect on the motion here: pictures, sensors, settings of solvers, and the stiffness of
//! other programs' contacts, in whose place hard ground and sand have their own laws.
//!
//! Elements of Gazebo: <https://classic.gazebosim.org/tutorials?tut=ros_urdf>, and SDFormat inside of them.

use super::xml::Element;

/// The effect of an attribute; None: it has none.
pub fn of_attribute(tag: &str, name: &str, value: &str) -> Option<&'static str> {
    let zero = value.split_whitespace().all(|word| word.parse::<f64>().is_ok_and(|x| x == 0.0));
    let off = value == "disable";
    let effect = match (tag, name) {
        ("option", "actuatorgroupdisable") => return Some("the motors of these groups are switched off"),
        ("compiler", "balanceinertia" | "boundmass" | "boundinertia" | "settotalmass" | "inertiafromgeom")
            if value != "false" =>
        {
            "masses and inertias are others"
        }
        ("safety_controller", "soft_lower_limit" | "soft_upper_limit") => "the robot's own controller limits the joint",
        ("safety_controller", "k_velocity") => "the robot's own controller limits the torque by the speed",
        ("option", "wind") => "moving air pushes on the robot",
        ("option", "density") => "drag and lift in air or water",
        ("option", "viscosity") => "viscous drag in air or water",
        ("option", "o_friction") => "the friction of all contacts",
        ("flag", "contact") if off => "contacts are switched off",
        ("flag", "limit") if off => "joints do not stop at their limits",
        ("flag", "actuation") if off => "motors are switched off",
        ("flag", "constraint") if off => "contacts and limits are switched off",
        ("flag", "frictionloss") if off => "joints have no dry friction",
        ("flag", "spring") if off => "joints have no springs",
        ("flag", "damper") if off => "joints have no damping",
        ("flag", "passive") if off => "joints have no springs and no damping",
        ("flag", "clampctrl") if off => "commands are not limited",
        ("joint", "springdamper") => "a spring and a damper at the joint",
        ("joint", "springyield") => "a spring that yields",
        ("geom", "adhesion") => "the surface sticks",
        ("geom", "surfacevel") => "the surface moves as a belt does",
        ("general" | "motor" | "position" | "velocity" | "pid", "delay") => {
            "the command acts later; see option action_delay"
        }
        ("general", "actdim" | "actearly") => "the actuator's own dynamics",
        ("pid", "ki" | "imax" | "slewmax") => "the integral part of the controller",
        ("dynamics", "spring_stiffness" | "spring_reference") => "a spring at the joint",
        _ => return None,
    };
    (!zero).then_some(effect)
}

/// The parts of an element that have an effect, and the effects.
pub fn of_parts(element: &Element) -> Vec<(String, &'static str)> {
    let mut parts = Vec::new();
    match of_element(element) {
        Some(effect) => parts.push((format!("<{}>", shortened(&element.tag)), effect)),
        None if element.tag == "gazebo" => gazebo(element, &mut parts),
        None => {}
    }
    parts
}

/// A name, so short that a message stays readable.
pub fn shortened(name: &str) -> String {
    name.chars().take(60).collect()
}

fn gazebo(element: &Element, parts: &mut Vec<(String, &'static str)>) {
    for part in &element.children {
        let (yes, no) = (matches!(&part.text[..], "true" | "1"), matches!(&part.text[..], "false" | "0"));
        let some = part.text.parse::<f64>().is_ok_and(|x| x != 0.0);
        let effect = match part.tag.as_str() {
            "turnGravityOff" if yes => "a link has no weight",
            "gravity" if no => "a link has no weight",
            "gravity" if part.text.contains(' ') => "gravity",
            "mu" | "mu1" => "the friction of a surface",
            // The friction across the first one's direction.
            "mu2" if element.first("mu1").is_none() && element.first("mu").is_none() => "the friction of a surface",
            "springStiffness" | "spring_stiffness" if some => "a spring at a joint",
            "dampingFactor" if some => "damping of a link's motion",
            "joint" => "joins the robot to other bodies",
            "link" => "bodies beside the robot",
            "static" if yes => "the robot does not move",
            "sensor" | "plugin" | "visual" | "material" => continue,
            _ => {
                gazebo(part, parts);
                continue;
            }
        };
        parts.push((format!("<{}> of <gazebo>", part.tag), effect));
    }
}

/// The effect of an element; None: it has none.
fn of_element(element: &Element) -> Option<&'static str> {
    let with = |names: &[&str]| {
        let has = |e: &Element| names.iter().any(|name| e.get(name).is_some_and(|value| value != "0"));
        element.children.iter().any(has)
    };
    match element.tag.as_str() {
        "tendon" if with(&["stiffness", "springlength"]) => Some("springs between bodies"),
        "tendon" if with(&["damping", "frictionloss", "armature"]) => {
            Some("damping, friction or inertia between joints")
        }
        "tendon" if with(&["range"]) => Some("cables that limit joints"),
        "body" => Some("bodies beside the robot"),
        "geom" if element.get("type") != Some("plane") => Some("obstacles or ground of other shape"),
        "drake:rotor_inertia" => Some("the motor's inertia; see option actuator"),
        "muscle" | "cylinder" | "damper" | "intvelocity" | "adhesion" | "dcmotor" | "pid" | "plugin" => {
            Some("an actuator of another kind; a servo drives the joint")
        }
        _ => None,
    }
}
