//! `<equality>`: joints that follow others. Other equalities would close a loop of bodies, and a tree has no loops.

use crate::error::{Error, Result};
use crate::notes::Notes;
use crate::sim::tree::{Mimic, Tree};
use crate::xml::Element;

/// The equalities that are not switched off, each by itself or all by the options.
fn active(root: &Element) -> impl Iterator<Item = &Element> {
    let sections = root.all("equality").filter(|_| !are_off(root));
    sections.flat_map(|section| &section.children).filter(|e| e.get("active") != Some("false"))
}

/// Does an option switch off all equalities, as MuJoCo reads it?
fn are_off(root: &Element) -> bool {
    let flags = root.all("option").flat_map(|option| option.all("flag"));
    let off = |flag: &Element| ["equality", "constraint"].iter().any(|name| flag.get(name) == Some("disable"));
    flags.into_iter().any(off)
}

/// Refuses equalities that are not between joints. This comes before the bodies are read: rods that close a chain often
/// have ball joints, and their refusal would hide the cause.
///
/// # Errors
/// Names the bodies, and how many other equalities there are.
pub fn check(root: &Element, notes: &mut Notes) -> Result<()> {
    if are_off(root) && root.all("equality").any(|section| !section.children.is_empty()) {
        notes.say("the file's <flag> switches its equalities off, as in MuJoCo: joints do not follow others, and no chain is closed");
    }
    let mut others = active(root).filter(|e| e.tag != "joint");
    others.next().map_or(Ok(()), |first| Err(refusal(first, others.count())))
}

/// Gives joints their leaders.
///
/// # Errors
/// Names the joints of an equality that is not simulated.
pub fn apply(root: &Element, tree: &mut Tree) -> Result<()> {
    for element in active(root) {
        let follower = element.required("joint1")?;
        let coefficients = element.list("polycoef")?.unwrap_or_else(|| vec![0.0, 1.0]);
        if coefficients.iter().skip(2).any(|c| *c != 0.0) {
            return Err(element.wrong(
                "polycoef",
                format!("joint {follower:?} follows another by a curve; only a line is simulated"),
            ));
        }
        let [offset, slope] = [0, 1].map(|k| coefficients.get(k).copied().unwrap_or(0.0));
        // If the equality names only one joint, it holds this joint at a constant position. The joint then follows any
        // other joint with ratio 0.
        let any = tree.joints().map(|j| j.name.clone()).find(|name| name != follower);
        let (leader, ratio) = match element.get("joint2") {
            Some(leader) => (leader.to_owned(), slope),
            None => (any.ok_or_else(|| element.error("the only joint is held"))?, 0.0),
        };
        let mut joints = tree.bodies.iter_mut().filter_map(|b| b.joint.as_mut());
        let joint = joints.find(|j| j.name == follower);
        let joint = joint.ok_or_else(|| element.error(format!("there is no joint {follower:?}")))?;
        joint.mimic = Some(Mimic { leader, ratio, offset });
    }
    Ok(())
}

/// Why an equality that is not between joints is refused; there are `more` of them.
fn refusal(element: &Element, more: usize) -> Error {
    let end = |names: [&str; 2]| names.iter().find_map(|name| element.get(name));
    let reason = match (element.tag.as_str(), end(["body1", "site1"]), end(["body2", "site2"])) {
        ("tendon", ..) => {
            let ties = match (element.get("tendon1").unwrap_or_default(), element.get("tendon2")) {
                (one, Some(other)) => format!("ties the length of tendon {one:?} to that of tendon {other:?}"),
                (one, None) => format!("holds the length of tendon {one:?}"),
            };
            format!(
                "{ties}; tendons are not simulated: delete this line, and let one joint follow the other by an equality <joint>"
            )
        }
        ("connect" | "weld", Some(one), other) => {
            let other = other.map_or("the world".to_owned(), |name| format!("{name:?}"));
            format!(
                "closes a chain between {one:?} and {other}, which is not simulated: delete this line, and drive or fix \
                 the joints of one branch"
            )
        }
        _ => "is not simulated: delete this line".to_owned(),
    };
    let more = if more > 0 { format!(" ({more} more like it)") } else { String::new() };
    element.error(reason + &more)
}
