//! Values for joints by patterns of their names, as legged_gym's `default_joint_angles`, `stiffness` and `damping`.

use super::Tree;
use crate::error::{Error, Result};
use std::collections::BTreeMap;

/// Largest number of joints that a message names: our choice, so that the message stays readable.
const MOST_NAMES: usize = 12;

/// The value of each joint, in order; None: no pattern matches. A pattern is a joint's whole name, or has a `*` for any
/// letters (`.*` means the same, as in Isaac Lab), or is a part of the name, as in legged_gym. If several patterns
/// match, a pattern that is the whole name counts, or else the longest pattern.
///
/// # Errors
/// Names the pattern of `option` that matches no joint.
pub fn by_pattern(tree: &Tree, option: &str, values: &BTreeMap<String, f64>) -> Result<Vec<Option<f64>>> {
    let names: Vec<&str> = tree.joints().map(|j| j.name.as_str()).collect();
    let mut found: Vec<Option<(usize, f64)>> = vec![None; names.len()];
    for (pattern, value) in values {
        let before = found.clone();
        for (slot, name) in found.iter_mut().zip(&names) {
            let rank = if pattern == name { usize::MAX } else { pattern.len() };
            if matches(pattern, name) && slot.is_none_or(|(old, _)| rank > old) {
                *slot = Some((rank, *value));
            }
        }
        if found == before && !names.iter().any(|name| matches(pattern, name)) {
            let mut known: Vec<&str> = names.iter().copied().take(MOST_NAMES).collect();
            known.extend((names.len() > MOST_NAMES).then_some("…"));
            let reason = format!("{pattern:?} matches no joint; the joints are {}", known.join(", "));
            return Err(Error::invalid(option, reason));
        }
    }
    Ok(found.into_iter().map(|slot| slot.map(|(_, value)| value)).collect())
}

pub fn matches(pattern: &str, name: &str) -> bool {
    if !pattern.contains('*') {
        return name.contains(pattern);
    }
    let pattern = pattern.replace(".*", "*");
    let parts: Vec<&str> = pattern.split('*').collect();
    let (first, last) = (parts[0], parts[parts.len() - 1]);
    if !name.starts_with(first) {
        return false;
    }
    let mut rest = &name[first.len()..];
    for part in &parts[1..parts.len() - 1] {
        let Some(at) = rest.find(part) else { return false };
        rest = &rest[at + part.len()..];
    }
    rest.ends_with(last)
}
