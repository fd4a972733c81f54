//! Which shapes touch sand: the named ones, or feet, lower links and belly.

use super::Import;
use crate::error::{Error, Result};
use crate::sim::tree::Tree;
use crate::sim::tree::stance::Stance;

/// Largest number of names that a message lists: our choice, so that the message stays readable.
const MOST_NAMES: usize = 40;

/// Index of a body and of one of its shapes.
pub type ShapeIndex = (usize, usize);

impl Import {
    /// The shapes with these names, in the order of bodies. A name is that of a body, of a link of the file, or of a
    /// shape. Without names, these are the shapes that the robot's own file names, or else all shapes of feet, lower
    /// links (the last bodies of the legs) and base.
    pub fn touching(&self, names: Option<&[String]>) -> Result<Vec<ShapeIndex>> {
        let Some(names) = names.or(self.touches.as_deref()) else { return Ok(lowest_parts(&self.tree, &self.stance)) };
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

/// All shapes of base, feet, and the last body of each leg.
fn lowest_parts(tree: &Tree, stance: &Stance) -> Vec<ShapeIndex> {
    let mut touching = vec![0];
    touching.extend(stance.legs.iter().filter_map(|leg| leg.last().copied()));
    touching.extend(&stance.feet);
    touching.sort_unstable();
    touching.dedup();
    touching.iter().flat_map(|b| (0..tree.bodies[*b].shapes.len()).map(move |s| (*b, s))).collect()
}
