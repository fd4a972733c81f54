//! Which shapes touch sand: the named ones, or feet, lower links and belly.

use super::Import;
use crate::error::{Error, Result};
use crate::sim::tree::{Tree, TreeShape};

/// Largest number of names that a message lists: our choice, so that the message stays readable.
const MOST_NAMES: usize = 40;

/// Index of a body and of one of its shapes.
pub type Touch = (usize, usize);

impl Import {
    /// The shapes with these names, in the order of bodies. Without names: feet and lower links (the last bodies of
    /// branches that reach below the base), and the base itself. A name is that of a body, of a link of the file,
    /// or of a shape.
    pub fn touching(&self, names: Option<&[String]>) -> Result<Vec<Touch>> {
        let Some(names) = names else { return Ok(by_reach(&self.tree)) };
        let mut found = Vec::new();
        for name in names {
            let before = found.len();
            for (b, body) in self.tree.bodies.iter().enumerate() {
                let whole = body.name == *name;
                for (s, shape) in body.shapes.iter().enumerate() {
                    let link = shape.name.split('/').next().unwrap_or_default();
                    if whole || shape.name == *name || link == name {
                        found.push((b, s));
                    }
                }
            }
            if found.len() == before {
                return Err(self.no_shape(name));
            }
        }
        found.sort_unstable();
        found.dedup();
        Ok(found)
    }

    fn no_shape(&self, name: &str) -> Error {
        if self.tree.bodies.iter().any(|b| b.name == name) || self.links.iter().flatten().any(|l| l == name) {
            return Error::invalid("touches", format!("{name:?} has no collision shape"));
        }
        let mut known: Vec<&str> = Vec::new();
        for shape in self.tree.bodies.iter().flat_map(|b| &b.shapes) {
            let link = shape.name.split('/').next().unwrap_or_default();
            if !known.contains(&link) {
                known.push(link);
            }
        }
        known.truncate(MOST_NAMES);
        Error::unknown("body", name, &known)
    }
}

fn by_reach(tree: &Tree) -> Vec<Touch> {
    let lowest = |body: usize| {
        let shapes = tree.bodies[body].shapes.iter();
        shapes.map(TreeShape::lowest).fold(0.0, f64::min)
    };
    let mut touching = vec![0];
    for leaf in 1..tree.bodies.len() {
        if tree.bodies.iter().skip(1).any(|b| b.parent == leaf) {
            continue;
        }
        // The last body of the branch that has shapes.
        let mut last = leaf;
        while last > 0 && tree.bodies[last].shapes.is_empty() {
            last = tree.bodies[last].parent;
        }
        if last > 0 && deepest(tree, last) < lowest(0) {
            touching.push(last);
        }
    }
    touching.sort_unstable();
    touching.dedup();
    touching.iter().flat_map(|b| (0..tree.bodies[*b].shapes.len()).map(move |s| (*b, s))).collect()
}

/// The lowest point below the base that a body reaches when its branch hangs straight down [m].
fn deepest(tree: &Tree, body: usize) -> f64 {
    let shapes = tree.bodies[body].shapes.iter();
    let mut length = shapes.map(|s| s.origin.translation.vector.norm() + s.geometry.radius()).fold(0.0, f64::max);
    let mut at = body;
    while tree.bodies[at].parent > 0 {
        length += tree.bodies[at].origin.translation.vector.norm();
        at = tree.bodies[at].parent;
    }
    tree.bodies[at].origin.translation.z - length
}
