//! Default classes: values of attributes that an element does not set itself.

use crate::error::Result;
use crate::xml::Element;
use std::collections::HashMap;

/// Elements of actuators. In a default class they share one set of attributes, and the last element gives the
/// actuator's kind.
pub const ACTUATORS: [&str; 11] = [
    "general",
    "motor",
    "position",
    "velocity",
    "intvelocity",
    "damper",
    "cylinder",
    "muscle",
    "adhesion",
    "dcmotor",
    "plugin",
];
/// Name under which the defaults store an actuator's kind.
pub const KIND: &str = "(kind)";
/// Attributes of orientation: if an element gives one of them, it replaces any of them in the class.
const ORIENTATIONS: [&str; 5] = ["quat", "axisangle", "euler", "xyaxes", "zaxis"];
/// Attributes with lists: a shorter list replaces the beginning of the class's list.
const LISTS: [&str; 4] = ["size", "friction", "gainprm", "biasprm"];

type Attributes = Vec<(String, String)>;
type Class = HashMap<String, Attributes>;

#[derive(Default)]
pub struct Defaults {
    classes: HashMap<String, Class>,
    /// The outermost class, which is also called `main`.
    outermost: Class,
}

fn key(tag: &str) -> &str {
    if ACTUATORS.contains(&tag) { "general" } else { tag }
}

impl Defaults {
    /// Reads all `<default>` sections of the file.
    pub fn read(root: &Element) -> Result<Self> {
        let mut defaults = Self::default();
        for section in root.all("default") {
            let mut class = std::mem::take(&mut defaults.outermost);
            take(&mut class, section);
            defaults.outermost = class.clone();
            for name in section.get("class").into_iter().chain(["main"]) {
                defaults.classes.insert(name.to_owned(), class.clone());
            }
            for inner in section.all("default") {
                defaults.nested(inner, &class)?;
            }
        }
        Ok(defaults)
    }

    fn nested(&mut self, section: &Element, above: &Class) -> Result<()> {
        let mut class = above.clone();
        take(&mut class, section);
        let name = section.required("class")?.to_owned();
        for inner in section.all("default") {
            self.nested(inner, &class)?;
        }
        if self.classes.insert(name, class).is_some() {
            return Err(section.error("a second class of this name"));
        }
        Ok(())
    }

    /// `element` with the defaults of its class: the class that it names, or else `inherited`, or else the
    /// outermost one.
    pub fn applied(&self, element: &Element, inherited: &str) -> Result<Element> {
        let class = match element.get("class").or(Some(inherited).filter(|c| !c.is_empty())) {
            None => &self.outermost,
            Some(name) => match self.classes.get(name) {
                Some(class) => class,
                None if name == "main" => &self.outermost,
                None => return Err(element.error(format!("there is no default class {name:?}"))),
            },
        };
        let mut whole = element.clone();
        let Some(attributes) = class.get(key(&element.tag)) else { return Ok(whole) };
        let turned = element.attributes.iter().any(|(n, _)| ORIENTATIONS.contains(&n.as_str()));
        for (name, value) in attributes {
            let hidden = turned && ORIENTATIONS.contains(&name.as_str());
            match element.get(name) {
                None if !hidden => whole.set(name, value),
                Some(own) if LISTS.contains(&name.as_str()) => whole.set(name, &joined(own, value)),
                _ => {}
            }
        }
        Ok(whole)
    }
}

/// Adds a section's values to a class.
fn take(class: &mut Class, section: &Element) {
    for element in section.children.iter().filter(|c| c.tag != "default") {
        let to = class.entry(key(&element.tag).to_owned()).or_default();
        let kind = ACTUATORS.contains(&element.tag.as_str()).then(|| (KIND.to_owned(), element.tag.clone()));
        let turned = element.attributes.iter().any(|(n, _)| ORIENTATIONS.contains(&n.as_str()));
        if turned {
            to.retain(|(n, _)| !ORIENTATIONS.contains(&n.as_str()));
        }
        for (name, value) in element.attributes.iter().cloned().chain(kind) {
            match to.iter_mut().find(|(n, _)| *n == name) {
                Some(found) if LISTS.contains(&name.as_str()) => found.1 = joined(&value, &found.1),
                Some(found) => found.1 = value,
                None => to.push((name, value)),
            }
        }
    }
}

/// The numbers of `own`, followed by the numbers of `class` at the places after them.
fn joined(own: &str, class: &str) -> String {
    let more = class.split_whitespace().skip(own.split_whitespace().count());
    own.split_whitespace().chain(more).collect::<Vec<_>>().join(" ")
}
