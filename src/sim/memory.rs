//! Memory that models and robots need, for limits. A test compares the numbers with the memory that is allocated.

use super::engine::EngineKind;
use super::model::LinkBody;
use super::obstacle::ObstacleShape;
use super::tree::patches::Patch;
use super::tree::{Geometry, Tree, TreeModel};
use super::{Model, Robot};

/// Bytes of a list's items, without what they refer to.
fn list<T>(items: &[T]) -> usize {
    size_of_val(items)
}

fn sum<T>(items: &[T], of: impl Fn(&T) -> usize) -> usize {
    list(items) + items.iter().map(of).sum::<usize>()
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

/// The parts of a tree robot that all its copies share.
fn of_shared(tree: &TreeModel) -> usize {
    let patch = |p: &Patch| list(&p.facets) + list(&p.panels) + list(&p.tiles);
    let stance = list(&tree.stance.angles) + list(&tree.stance.feet);
    let looks = sum(&tree.looks.meshes, |m| list(&m.corners) + list(&m.faces)) + list(&tree.looks.shapes);
    of_tree(&tree.tree)
        + sum(&tree.plates, |plates| list(plates))
        + sum(&tree.patches, |body| sum(&body.patches, patch))
        + sum(&tree.contacts, |points| list(points))
        + stance
        + looks
        + tree.looks.json().len()
}

impl Model {
    /// Memory of the model with everything that it refers to [bytes]. Environments with the same options share it.
    pub fn memory_bytes(&self) -> usize {
        let relief = self.scene.relief.as_ref().map_or(0, |relief| relief.memory_bytes());
        self.episode_bytes() + self.tree.as_ref().map_or(0, |tree| of_shared(tree)) + relief
    }

    /// Memory of a copy whose masses, motors, sand or obstacles an episode has drawn [bytes]. Parts that the copy
    /// shares with the original model do not count.
    pub fn episode_bytes(&self) -> usize {
        let body = |body: &LinkBody| list(&body.plates) + list(&body.chord) + list(&body.pieces);
        let corners = |o: &super::Obstacle| match &o.shape {
            ObstacleShape::Hull { points } => list(points),
            _ => 0,
        };
        let scene = self.scene.medium.name.len() + sum(&self.scene.obstacles, corners) + list(&self.scene.hard);
        let solids = sum(&self.solids, |s| list(&s.facets) + list(&s.corners) + list(&s.faces));
        let tree = self.tree.as_ref().map_or(0, |tree| size_of::<TreeModel>() + list(&tree.motors));
        let legs = sum(&self.legs, |chain| sum(chain, body));
        size_of::<Self>() + of_robot(&self.robot) + scene + list(&self.belly) + legs + solids + tree
    }

    /// Length of the texts of shapes and heights in the header of a recording [bytes].
    pub fn drawing_bytes(&self) -> usize {
        let shapes = self.tree.as_ref().map_or(0, |tree| tree.looks.json().len());
        shapes + self.scene.relief.as_ref().map_or(0, |relief| relief.json().len())
    }

    /// Memory of one robot in an engine [bytes], without its model.
    pub fn robot_bytes(&self, engine: EngineKind) -> usize {
        self.sand_bytes() + self.engine_bytes(engine)
    }

    fn engine_bytes(&self, engine: EngineKind) -> usize {
        match (engine, &self.tree) {
            (EngineKind::Tree, Some(tree)) => {
                let points = if self.scene.hard.is_empty() { 0 } else { tree.contacts.iter().map(Vec::len).sum() };
                LANE + tree.tree.bodies.len() * LANE_BODY + points * LANE_POINT + tree.stance.feet.len() * LANE_FOOT
            }
            // The resident memory of a session of thousands of environments divided by their number, without the data of
            // an episode.
            (EngineKind::Lanes | EngineKind::Tree, _) => 10_000,
            (EngineKind::Rapier, _) => 170_000, // measured with 18 joints; 86,000 with 6
            (EngineKind::Carriage, _) => 12_000, // counted: two links of 12 plates, twice, and the robot's description
        }
    }
}

/// Memory of a lane of engine `tree`, of each of its bodies, of each point that may touch hard ground, and of each foot [bytes]:
/// counted in the structures of [`super::tree::engine`], where a list of touching points may have room for twice as many.
const LANE: usize = 2_000;
const LANE_BODY: usize = 800;
const LANE_POINT: usize = 250;
const LANE_FOOT: usize = 220;
