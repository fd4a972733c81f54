//! Which shapes touch sand: the named ones, or feet, lower links and belly.

use super::Import;
use super::hull::hull;
use crate::error::{Error, Result};
use crate::sim::tree::stance::Stance;
use crate::sim::tree::{Geometry, Tree, TreeBody, TreeShape};
use nalgebra::{Isometry3, Vector3};
use std::sync::Arc;

/// Largest number of names that a message lists: our choice, so that the message stays readable.
const MOST_NAMES: usize = 40;

/// Balls of a foot count as small and separate if each radius is at most this part of the distance to the nearest other ball:
/// our choice. Humanoids' files have balls of 5 mm at the corners of a sole (5 cm apart), which support it on hard ground.
const SMALL: f64 = 0.25;
/// Least number of such balls: three support a sole.
const SUPPORTS: usize = 3;

/// Index of a body and of one of its shapes.
pub type ShapeIndex = (usize, usize);

impl Import {
    /// The shapes with these names, in the order of bodies. A name is that of a body, of a link of the file, or of a
    /// shape. Without names, these are the shapes that the robot's own file names, or else all shapes of feet, lower
    /// links (the last bodies of the legs) and base. A shape's name in the file stands for it if no other shape has this name.
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
                found.push(self.by_own_name(name)?);
            }
        }
        found.sort_unstable();
        found.dedup();
        Ok(found)
    }

    /// The tree whose shapes push on sand, unless the user names shapes: the same, but where a body has a few small separate
    /// balls in place of its sole, the first of them is their hull.
    pub fn on_soles(&self) -> Tree {
        let mut tree = self.tree.clone();
        for body in tree.bodies.iter_mut().skip(1) {
            if let Some((ball, sole)) = sole(body) {
                body.shapes[ball] =
                    TreeShape { origin: Isometry3::identity(), geometry: sole, ..body.shapes[ball].clone() };
            }
        }
        tree
    }

    /// The only shape that has this name in the file.
    fn by_own_name(&self, name: &str) -> Result<ShapeIndex> {
        let named: Vec<&str> =
            self.given.iter().filter(|[own, _]| own == name).map(|[_, here]| here.as_str()).collect();
        match named[..] {
            [] => Err(self.no_shape(name)),
            [here] => {
                let shapes = |b: usize| (0..self.tree.bodies[b].shapes.len()).map(move |s| (b, s));
                let mut all = (0..self.tree.bodies.len()).flat_map(shapes);
                all.find(|(b, s)| self.tree.bodies[*b].shapes[*s].name == here).ok_or_else(|| self.no_shape(name))
            }
            _ => Err(Error::invalid("touches", format!("several shapes are called {name:?}: {}", named.join(", ")))),
        }
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

/// Names of the bodies that stand on small balls.
pub fn on_balls(tree: &Tree) -> impl Iterator<Item = &str> {
    tree.bodies.iter().skip(1).filter(|body| sole(body).is_some()).map(|body| body.name.as_str())
}

/// The hull of a body's small separate balls, in the body's frame, and the index of the first ball.
fn sole(body: &TreeBody) -> Option<(usize, Geometry)> {
    let ball = |(k, shape): (usize, &TreeShape)| match shape.geometry {
        Geometry::Sphere { radius } => Some((k, shape.origin.translation.vector, radius)),
        _ => None,
    };
    let balls: Vec<(usize, Vector3<f64>, f64)> = body.shapes.iter().enumerate().filter_map(ball).collect();
    let small = |(k, center, radius): &(usize, Vector3<f64>, f64)| {
        let others = balls.iter().filter(|other| other.0 != *k);
        *radius <= SMALL * others.map(|other| (other.1 - center).norm()).fold(f64::INFINITY, f64::min)
    };
    if balls.len() < SUPPORTS || !balls.iter().all(small) {
        return None;
    }
    let toward = |i: i32| Vector3::new(f64::from(i % 3 - 1), f64::from(i / 3 % 3 - 1), f64::from(i / 9 - 1));
    let around = |(_, center, radius): &(usize, Vector3<f64>, f64)| {
        let (center, radius) = (*center, *radius);
        (0..27).filter_map(move |i| Some(center + toward(i).try_normalize(0.5)? * radius))
    };
    let points: Vec<Vector3<f64>> = balls.iter().flat_map(around).collect();
    Some((balls[0].0, Geometry::Mesh(Arc::new(hull(&points)?))))
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
