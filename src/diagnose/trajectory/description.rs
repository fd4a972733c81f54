//! What may be wrong in a robot's description: its mass, its centre of mass, the size of its feet, and the zeros of its joints. None of
//! these effects has a formula, so replays of a robot that differs from its description show them.

use super::model::TrajectoryModel;
use super::replay::{ReplayRobot, ReplayedJoint};
use crate::error::Result;
use crate::fit::slope;
use crate::forward::SandParameters;
use crate::known::key;
use crate::nuisance::{Nuisance, NuisanceState, estimate};
use crate::sand::mechanism::Mechanisms;
use crate::sim::State;
use crate::sim::tree::contact::contact_points;
use crate::sim::tree::kinematics::frames;
use crate::sim::tree::{Geometry, TreeModel, TreeShape, of_touching};
use nalgebra::{Point3, Vector3};
use std::sync::Arc;

/// The effect of a difference is nearly linear up to this share of the step of its derivative: our choice.
const LINEAR: f64 = 0.5;

/// A quantity of a robot that its description may state wrongly.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RobotQuantity {
    /// Mass on the base's centre of mass [kg].
    Payload,
    /// Shift of the base's centre of mass along axis x (0) or y (1) of its frame [m].
    Center(usize),
    /// What the feet are larger than described, as a share.
    FootSize,
    /// What is to be added to the logged angle of a joint [rad].
    JointZero(usize),
}

/// A quantity, and by how much it differs.
pub type Difference = (RobotQuantity, f64);

impl RobotQuantity {
    fn id(self) -> &'static str {
        match self {
            Self::Payload => "payload",
            Self::Center(_) => "center_of_mass",
            Self::FootSize => "foot_size",
            Self::JointZero(_) => "joint_zero",
        }
    }

    fn unit(self) -> &'static str {
        match self {
            Self::Payload => "kg",
            Self::Center(_) => "m",
            Self::FootSize => "1",
            Self::JointZero(_) => "rad",
        }
    }

    /// Step of the derivative, in prior standard deviations: our choices. A robot rises on larger feet, and its sensors hardly feel it, so
    /// that step is large.
    fn step(self) -> f64 {
        match self {
            Self::Payload => 2.5,
            Self::FootSize => 5.0,
            Self::Center(_) | Self::JointZero(_) => 1.0,
        }
    }

    /// Numbers that only this quantity has, for keys of a store.
    fn code(self) -> [f64; 2] {
        match self {
            Self::Payload => [0.0, 0.0],
            Self::Center(axis) => [1.0, axis as f64],
            Self::FootSize => [2.0, 0.0],
            Self::JointZero(joint) => [3.0, joint as f64],
        }
    }
}

impl ReplayRobot {
    /// The robot with a difference from its description. A joint's zero is a matter of [`ReplayedJoint::turned`]. Of robots that are not
    /// from a URDF or MJCF file only the mass can differ.
    fn differing(&self, (quantity, value): Difference) -> Result<Self> {
        let (model, touching) = match (self, quantity) {
            (_, RobotQuantity::JointZero(_)) => return Ok(self.clone()),
            (Self::Tree(model, touching), _) => (model, touching),
            (Self::Legged(robot), RobotQuantity::Payload) => {
                let mut robot = robot.clone();
                robot.base.mass += value;
                return Ok(Self::Legged(robot));
            }
            (Self::Legged(_), _) => return Ok(self.clone()),
        };
        let mut new = model.as_ref().clone();
        let mut tree = model.tree.as_ref().clone();
        match quantity {
            RobotQuantity::Payload => new.base_mass += value,
            RobotQuantity::Center(axis) => tree.bodies[0].center[axis] += value,
            RobotQuantity::FootSize => {
                for (body, shape) in feet(model, touching) {
                    let own = &mut tree.bodies[body].shapes[shape];
                    *own = scaled(own, 1.0 + value);
                }
                new.plates = Arc::new(of_touching(&tree, touching, None)?);
                new.contacts = Arc::new(contact_points(&tree));
            }
            RobotQuantity::JointZero(_) => {}
        }
        new.tree = Arc::new(tree);
        Ok(Self::Tree(Arc::new(new), touching.clone()))
    }
}

/// The lowest shape of each foot in the standing pose, among the shapes that touch sand.
fn feet(model: &TreeModel, touching: &[(usize, usize)]) -> Vec<(usize, usize)> {
    let frames = frames(&model.tree, &State::at_rest(0.0, &model.stance.angles));
    let height = |&(body, shape): &(usize, usize)| {
        let own = &model.tree.bodies[body].shapes[shape];
        (frames[body] * own.origin * Point3::from(center(&own.geometry))).z
    };
    let lowest = |foot: &usize| {
        touching.iter().copied().filter(|(body, _)| body == foot).min_by(|a, b| height(a).total_cmp(&height(b)))
    };
    model.stance.feet.iter().filter_map(lowest).collect()
}

/// Centre of a shape in its own frame [m]; of a mesh that of its bounding box.
fn center(geometry: &Geometry) -> Vector3<f64> {
    let Geometry::Mesh(triangles) = geometry else { return Vector3::zeros() };
    let mut all = triangles.iter().flatten();
    let Some(first) = all.next() else { return Vector3::zeros() };
    let (low, high) = all.fold((*first, *first), |(low, high), p| (low.inf(p), high.sup(p)));
    0.5 * (low + high)
}

/// The shape with its sizes multiplied by a factor, about its centre. Capsules and cylinders keep their length.
fn scaled(shape: &TreeShape, factor: f64) -> TreeShape {
    let geometry = match &shape.geometry {
        Geometry::Sphere { radius } => Geometry::Sphere { radius: factor * radius },
        Geometry::Capsule { radius, half_length } => {
            Geometry::Capsule { radius: factor * radius, half_length: *half_length }
        }
        Geometry::Cylinder { radius, half_length } => {
            Geometry::Cylinder { radius: factor * radius, half_length: *half_length }
        }
        Geometry::Box { half } => Geometry::Box { half: factor * half },
        Geometry::Mesh(triangles) => {
            let middle = center(&shape.geometry);
            let moved = |p: &Vector3<f64>| middle + factor * (p - middle);
            Geometry::Mesh(Arc::new(triangles.iter().map(|t| [0, 1, 2].map(|k| moved(&t[k]))).collect()))
        }
    };
    TreeShape { geometry, ..shape.clone() }
}

impl TrajectoryModel<'_> {
    /// The quantities that can differ, each with the standard deviation of its prior.
    fn differences(&self) -> Vec<(RobotQuantity, f64)> {
        let joints = (0..self.layout.joints).map(RobotQuantity::JointZero);
        let mut all = vec![(RobotQuantity::Payload, self.prior("payload") * self.mass())];
        if let ReplayRobot::Tree(model, _) = &self.bodies[0] {
            let center = self.prior("center_of_mass") * model.stance.leg_length;
            all.extend([0, 1].map(|axis| (RobotQuantity::Center(axis), center)));
            all.push((RobotQuantity::FootSize, self.prior("foot_size")));
        }
        all.extend(joints.map(|joint| (joint, self.prior("joint_zero"))));
        all.retain(|(_, sd)| *sd > 0.0);
        all
    }

    /// Whose quantity it is: an axis or a joint.
    fn owner(&self, quantity: RobotQuantity) -> Option<String> {
        match quantity {
            RobotQuantity::Center(axis) => Some(["x", "y"][axis].into()),
            RobotQuantity::JointZero(joint) => self.bodies[0].joint_names().get(joint).cloned(),
            RobotQuantity::Payload | RobotQuantity::FootSize => None,
        }
    }

    /// What a wrong description changes, linearised at `values`; `here` is the prediction for the robot as described.
    pub(super) fn described(&self, sand: &SandParameters, here: &[f64], values: &[NuisanceState]) -> Vec<Nuisance> {
        // Each quantity with its prior standard deviation, the step of its derivative, and the value at which this is taken.
        let all: Vec<(RobotQuantity, f64, f64, f64)> = (self.differences().into_iter())
            .map(|(quantity, sd)| {
                let value = estimate(values, quantity.id(), self.owner(quantity).as_deref());
                let step = quantity.step() * sd;
                (quantity, sd, step, if value.abs() > LINEAR * step { value } else { 0.0 })
            })
            .collect();
        // The prediction at each value, and one step further.
        let asked = all.iter().flat_map(|&(quantity, _, step, at)| [(quantity, at), (quantity, at + step)]);
        let asked: Vec<Difference> = asked.filter(|(_, value)| *value != 0.0).collect();
        let mut found = self.differing(sand, &asked).into_iter();
        let mut of = |value: f64| if value == 0.0 { None } else { found.next() }.unwrap_or_else(|| here.to_vec());
        let one = |(quantity, sd, step, at): (RobotQuantity, f64, f64, f64)| {
            let (there, further) = (of(at), of(at + step));
            let rate = slope(&further, &there, step);
            let bend = there.iter().zip(here).zip(&rate).map(|((there, here), rate)| there - here - at * rate);
            let bend: Vec<f64> = if at == 0.0 { Vec::new() } else { bend.collect() };
            let own = Nuisance::linear(quantity.id(), quantity.unit(), sd, rate).bent(bend);
            Nuisance { of: self.owner(quantity), nearly_linear: LINEAR * step, ..own }
        };
        all.into_iter().map(one).collect()
    }

    /// Predictions for robots that differ from their description, each in one quantity.
    fn differing(&self, sand: &SandParameters, differences: &[Difference]) -> Vec<Vec<f64>> {
        let strong = (Mechanisms { motor_torque_limit: 0.0, ..sand.0 }, sand.1);
        let own = |(quantity, value): &Difference| key(&strong, &[&quantity.code()[..], &[*value]].concat());
        let stacks = self.known_differences.of(differences.iter().map(own).collect(), |new| {
            let settings: Vec<_> = new.iter().map(|&k| (*sand, Some(differences[k]))).collect();
            self.readings(&settings)
        });
        stacks.into_iter().map(|stack| self.logged(stack, self.limit(sand), &self.hardware)).collect()
    }

    /// The robot of each run with a difference.
    pub(super) fn bodies_with(&self, difference: Option<Difference>) -> Result<Vec<ReplayRobot>> {
        let Some(difference) = difference else { return Ok(self.bodies.clone()) };
        // All runs of a robot from a file have the same robot.
        if matches!(self.bodies[0], ReplayRobot::Tree(..)) {
            return Ok(vec![self.bodies[0].differing(difference)?; self.bodies.len()]);
        }
        self.bodies.iter().map(|body| body.differing(difference)).collect()
    }
}

/// The motion of each window's joints with a difference; None: it does not change the motion.
pub(super) fn drives_with(drives: &[ReplayedJoint], difference: Option<Difference>) -> Option<Vec<ReplayedJoint>> {
    let Some((RobotQuantity::JointZero(joint), value)) = difference else { return None };
    Some(drives.iter().map(|drive| drive.turned(joint, value)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_larger_foot_keeps_its_centre_and_a_peg_its_length() {
        let shape = |geometry| TreeShape {
            name: "foot".into(),
            origin: nalgebra::Isometry3::identity(),
            geometry,
            friction: 1.0,
        };
        let peg = scaled(&shape(Geometry::Cylinder { radius: 0.01, half_length: 0.1 }), 1.5);
        assert_eq!(peg.geometry, Geometry::Cylinder { radius: 0.015, half_length: 0.1 });
        let corners = [[1.0, 0.0, 0.0], [3.0, 0.0, 0.0], [1.0, 4.0, 2.0]].map(Vector3::from);
        let mesh = scaled(&shape(Geometry::Mesh(Arc::new(vec![corners]))), 2.0).geometry;
        assert_eq!(center(&mesh), Vector3::new(2.0, 2.0, 1.0));
        let Geometry::Mesh(triangles) = mesh else { panic!("the shape is no mesh any more") };
        assert_eq!(triangles[0][0], Vector3::new(0.0, -2.0, -1.0));
    }
}
