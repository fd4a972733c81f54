//! Memory that models and robots need, for limits. A test compares the numbers with the memory that is allocated.

use super::engine::EngineKind;
use super::model::LinkBody;
use super::obstacle::{Obstacle, ObstacleShape};
use super::solid::Solid;
use super::tree::patches::Patch;
use super::tree::{Geometry, Tree, TreeModel};
use super::{Model, Robot};
use crate::error::Result;
use std::collections::HashSet;
use std::sync::Arc;

/// Bytes of a list's items, without what they refer to.
fn list<T>(items: &[T]) -> usize {
    size_of_val(items)
}

fn sum<T>(items: &[T], of: impl Fn(&T) -> usize) -> usize {
    list(items) + items.iter().map(of).sum::<usize>()
}

fn corners(obstacle: &Obstacle) -> usize {
    if let ObstacleShape::Hull { points } = &obstacle.shape { list(points) } else { 0 }
}

impl Obstacle {
    /// Memory of an obstacle in a model, with its geometry [bytes].
    ///
    /// # Errors
    /// Its numbers are out of range.
    pub fn memory_bytes(&self) -> Result<usize> {
        let solid = self.solid()?;
        Ok(size_of::<Self>() + corners(self) + size_of::<Solid>() + solid.list_bytes())
    }
}

fn of_robot(robot: &Robot) -> usize {
    let strip = |link: &super::robot::Link| link.joint.len() + link.sand.as_ref().map_or(0, |s| s.shape.len());
    robot.name.len() + sum(&robot.hip, |hip| hip.name.len()) + sum(&robot.leg.link, strip)
}

fn of_tree(tree: &Tree) -> usize {
    let mesh = |shape: &super::tree::TreeShape| match &shape.geometry {
        Geometry::Mesh(triangles) => shape.name.len() + list(triangles),
        _ => shape.name.len(),
    };
    let body = |body: &super::tree::TreeBody| {
        body.name.len() + body.joint.as_ref().map_or(0, |j| j.name.len()) + sum(&body.shapes, mesh)
    };
    tree.name.len() + sum(&tree.bodies, body)
}

/// Adds up memory. A part that several things share counts once.
#[derive(Default)]
pub struct MemoryCount {
    /// Addresses of the shared parts so far.
    shared: HashSet<usize>,
    bytes: usize,
}

impl MemoryCount {
    /// The sum so far [bytes].
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// Adds memory that nothing else shares [bytes].
    pub fn add(&mut self, bytes: usize) {
        self.bytes += bytes;
    }

    /// Adds a part that others may share; `bytes`: its size. Returns whether it is counted for the first time.
    pub fn add_shared<T: ?Sized>(&mut self, part: &Arc<T>, bytes: impl FnOnce(&T) -> usize) -> bool {
        let new = self.shared.insert(Arc::as_ptr(part).addr());
        self.bytes += if new { bytes(part) } else { 0 };
        new
    }
}

impl TreeModel {
    /// Adds the parts that copies share.
    fn count_shared(&self, count: &mut MemoryCount) {
        let patch = |p: &Patch| list(&p.facets) + list(&p.panels) + list(&p.tiles);
        count.add_shared(&self.tree, of_tree);
        count.add_shared(&self.plates, |all| sum(all, |plates| list(plates)));
        count.add_shared(&self.patches, |all| sum(all, |body| sum(&body.patches, patch)));
        count.add_shared(&self.contacts, |all| sum(all, |points| list(points)));
        count.add_shared(&self.stance, |stance| list(&stance.angles) + list(&stance.feet));
        count.add_shared(&self.looks, |looks| {
            sum(&looks.meshes, |m| list(&m.corners) + list(&m.faces)) + list(&looks.shapes) + looks.json().len()
        });
    }
}

impl Model {
    /// Memory of the model with everything that it refers to [bytes].
    pub fn memory_bytes(&self) -> usize {
        let mut count = MemoryCount::default();
        self.count_memory(&mut count);
        count.bytes()
    }

    /// Adds the model with everything that it refers to.
    pub fn count_memory(&self, count: &mut MemoryCount) {
        count.add(self.episode_bytes());
        if let Some(tree) = &self.tree {
            tree.count_shared(count);
        }
        if let Some(relief) = &self.scene.relief {
            count.add_shared(relief, |relief| relief.memory_bytes());
        }
    }

    /// Memory of a copy whose masses, motors, sand or obstacles an episode has drawn [bytes]. Parts that the copy
    /// shares with the original model do not count.
    pub fn episode_bytes(&self) -> usize {
        let body = |body: &LinkBody| list(&body.plates) + list(&body.chord) + list(&body.pieces);
        let scene = self.scene.medium.name.len() + sum(&self.scene.obstacles, corners) + list(&self.scene.hard);
        let solids = sum(&self.solids, Solid::list_bytes);
        let tree = self.tree.as_ref().map_or(0, |tree| size_of::<TreeModel>() + list(&tree.motors));
        let legs = sum(&self.legs, |chain| sum(chain, body));
        size_of::<Self>() + of_robot(&self.robot) + scene + list(&self.belly) + legs + solids + tree
    }

    /// Length of the texts of shapes and heights in the header of a recording [bytes].
    pub fn drawing_bytes(&self) -> usize {
        let shapes = self.tree.as_ref().map_or(0, |tree| tree.looks.json().len());
        shapes + self.scene.relief.as_ref().map_or(0, |relief| relief.json().len())
    }

    /// Memory that one robot takes in an engine [bytes], without its model and its sand. `obstacles`: their largest
    /// number in an episode.
    pub fn engine_bytes(&self, engine: EngineKind, obstacles: usize) -> usize {
        let links = self.joints();
        match (engine, &self.tree) {
            (EngineKind::Tree, Some(tree)) => {
                let points = if self.scene.hard.is_empty() { 0 } else { tree.contacts.iter().map(Vec::len).sum() };
                LANE + tree.tree.bodies.len() * LANE_BODY + points * LANE_POINT + tree.stance.feet.len() * LANE_FOOT
            }
            (EngineKind::Lanes | EngineKind::Tree, _) => 4_000 + links * 380,
            (EngineKind::Rapier, _) => RAPIER + links * RAPIER_LINK + obstacles * ROCK,
            (EngineKind::Carriage, _) => 6_700, // two links of 12 plates, twice
        }
    }
}

// The sizes below were counted: `tests/prices.rs` adds up what is allocated for environments of each task after their
// episodes have ended, and holds the sums to these numbers.

/// Memory of a body in a world of engine `rapier` with the sand on it, and of what each joint adds [bytes].
const RAPIER: usize = 40_000;
const RAPIER_LINK: usize = 8_500;

/// Memory of an obstacle in a world of engine `rapier` [bytes]: its body, collider, shape and contacts, and the engine's
/// copy of its geometry.
const ROCK: usize = 15_000;

/// Memory of a lane of engine `tree`, of each of its bodies, and of each point that may touch hard ground [bytes], where
/// all points may touch at once.
const LANE: usize = 2_000;
const LANE_BODY: usize = 800;
const LANE_POINT: usize = 140;
const LANE_FOOT: usize = 220;

/// Resident memory [bytes] where `allocated` bytes are in use: the allocator keeps blocks of some sizes, and pages that
/// are partly free. Measured: 1.03 to 1.5 times as much in sessions of all tasks, where most are below 1.3;
/// `tests/faults/environments.rs` measures it again.
pub fn resident(allocated: usize) -> usize {
    allocated * 5 / 4
}
