//! Memory of models, and of the robots that engines make from them, counted from their parts. So a robot of a client is
//! reserved with the memory that it takes, not with that of a usual robot.

use super::engine::EngineKind;
use super::model::{Body, Model, Piece, Plate};
use super::tree::contact::ContactPoint;
use super::tree::looks::{Look, Looks};
use super::tree::model::TreeMotor;
use super::tree::patches::{Facet, Panel, Patch, Tile};
use super::tree::{Geometry, TreeBody, TreeModel, TreeShape};

/// Lanes of the widest block of engine `tree`; a block is allocated as a whole.
const LANES: usize = 16;

/// Numbers of a body in a lane of engine `tree`: body 26, frame 36, loads 54, hinge 10, acceleration 6, joint 16.
const BODY_NUMBERS: usize = 148;

/// Numbers of a point that touches hard ground, in a lane.
const TOUCH_NUMBERS: usize = 24;

impl EngineKind {
    /// Memory of `count` robots of `model` in an engine [bytes], without the data of an episode.
    pub fn bytes(self, model: &Model, count: usize) -> usize {
        count
            * match (self, &model.tree) {
                // The resident memory of a session of thousands of environments, divided by their number.
                (Self::Lanes, _) => 10_000,
                // The same, with 18 joints; 86,000 with 6.
                (Self::Rapier, _) => 170_000,
                // Counted: two links of 12 plates, twice, and the robot's description.
                (Self::Carriage, _) | (Self::Tree, None) => 12_000,
                (Self::Tree, Some(tree)) => return count.next_multiple_of(LANES) * tree.lane_bytes(),
            }
    }
}

impl TreeModel {
    /// Memory of one lane of engine `tree`, and of its states before and after a step.
    fn lane_bytes(&self) -> usize {
        let points: usize = self.contacts.iter().map(Vec::len).sum();
        let point = size_of::<f32>() * TOUCH_NUMBERS + size_of::<ContactPoint>() / LANES;
        self.tree.bodies.len() * (size_of::<f32>() * BODY_NUMBERS + 3 * 8 * size_of::<f64>()) + points * point + 1_000
    }

    /// Memory of a copy with other masses and motors [bytes].
    fn copy_bytes(&self) -> usize {
        let shape = |s: &TreeShape| size_of::<TreeShape>() + s.name.len();
        let body = |b: &TreeBody| {
            let joint = b.joint.as_ref().map_or(0, |j| j.name.len());
            size_of::<TreeBody>() + b.name.len() + joint + b.shapes.iter().map(shape).sum::<usize>()
        };
        let bodies: usize = self.tree.bodies.iter().map(body).sum();
        size_of::<Self>() + bodies + self.motors.len() * size_of::<TreeMotor>()
    }

    /// Memory of the data that copies share.
    fn shared_bytes(&self) -> usize {
        let triangles = |s: &TreeShape| match &s.geometry {
            Geometry::Mesh(mesh) => size_of_val(&mesh[..]),
            _ => 0,
        };
        let meshes: usize = self.tree.bodies.iter().flat_map(|b| &b.shapes).map(triangles).sum();
        let patch = |p: &Patch| {
            let own = p.facets.len() * size_of::<Facet>() + p.panels.len() * size_of::<Panel>();
            size_of::<Patch>() + own + p.tiles.len() * size_of::<Tile>()
        };
        let patches: usize = self.patches.iter().flat_map(|b| &b.patches).map(patch).sum();
        let plates: usize = self.plates.iter().map(|plates| size_of_val(&plates[..])).sum();
        let contacts: usize = self.contacts.iter().map(|points| size_of_val(&points[..])).sum();
        meshes + patches + plates + contacts + looks_bytes(&self.looks)
    }
}

fn looks_bytes(looks: &Looks) -> usize {
    let meshes: usize = looks.meshes.iter().map(|m| size_of_val(&m.corners[..]) + size_of_val(&m.faces[..])).sum();
    meshes + looks.shapes.len() * size_of::<Look>() + looks.json().len()
}

impl Model {
    /// Memory of this model [bytes].
    pub fn bytes(&self) -> usize {
        let relief = self.scene.relief.as_ref().map_or(0, |relief| relief.bytes());
        self.copy_bytes() + self.tree.as_ref().map_or(0, |tree| tree.shared_bytes()) + relief
    }

    /// Memory of a copy in which an episode draws masses, motors and sand [bytes].
    pub fn copy_bytes(&self) -> usize {
        let body = |b: &Body| {
            size_of::<Body>()
                + (b.plates.len() + b.chord.len()) * size_of::<Plate>()
                + b.pieces.len() * size_of::<Piece>()
        };
        let legs: usize = self.legs.iter().flatten().map(body).sum();
        let scene = size_of_val(&self.scene.obstacles[..]) + size_of_val(&self.scene.hard[..]);
        let own = size_of::<Self>() + self.belly.len() * size_of::<Plate>() + size_of_val(&self.robot.hip[..]);
        own + legs + scene + self.tree.as_ref().map_or(0, |tree| tree.copy_bytes())
    }
}
