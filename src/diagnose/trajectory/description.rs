//! What may be wrong in a robot's description: its mass, its centre of mass, the size of its feet, and the zeros of its joints. None of
//! these effects has a formula, so replays of a robot that differs from its description show them.

use super::model::TrajectoryModel;
use super::replay::{LAW, LoggedMotion, ReplayRobot};
use crate::error::Result;
use crate::fit::slope;
use crate::forward::SandParameters;
use crate::known::key;
use crate::nuisance::{Nuisance, NuisanceState};
use crate::sand::mechanism::Mechanisms;
use crate::sim::State;
use crate::sim::tree::contact::contact_points;
use crate::sim::tree::kinematics::frames;
use crate::sim::tree::{Geometry, TreeModel, TreeShape};
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
            Self::Center(_) => 0.2,
            Self::JointZero(_) => 1.0,
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
    /// The robot with a difference from its description. A joint's zero is a matter of [`LoggedMotion::turned`]. Of robots that are not
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
                new.contacts = Arc::new(contact_points(&tree));
                new.tree = Arc::new(tree);
                new = new.with_fine_plates(touching, LAW)?;
                return Ok(Self::Tree(Arc::new(new), touching.clone()));
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

    /// What a wrong description changes, linearised at `values`; `here` is the prediction for the robot as described. Two differences
    /// together are not the sum of each alone, so if one of them is far from 0, all are taken together.
    pub(super) fn described(&self, sand: &SandParameters, here: &[f64], values: &[NuisanceState]) -> Vec<Nuisance> {
        let all = self.differences();
        let state = |quantity: RobotQuantity| {
            let owner = self.owner(quantity);
            values.iter().find(|s| s.id == quantity.id() && s.of == owner)
        };
        let value = |quantity: RobotQuantity| state(quantity).map_or(0.0, |s| s.value);
        let fitted = |quantity: RobotQuantity| state(quantity).is_none_or(|s| s.free);
        let far = all.iter().any(|&(quantity, sd)| value(quantity).abs() > LINEAR * quantity.step() * sd);
        let base: Vec<Difference> =
            all.iter().map(|&(quantity, _)| (quantity, value(quantity))).filter(|d| far && d.1 != 0.0).collect();
        let at = |quantity: RobotQuantity| base.iter().find(|d| d.0 == quantity).map_or(0.0, |d| d.1);
        // What is not fitted has the derivative of the robot as described, which is known already.
        let further = |&(quantity, sd): &(RobotQuantity, f64)| -> Vec<Difference> {
            let others = base.iter().copied().filter(|d| fitted(quantity) && d.0 != quantity);
            others.chain([(quantity, at(quantity) + quantity.step() * sd)]).collect()
        };
        let asked: Vec<Vec<Difference>> = std::iter::once(base.clone()).chain(all.iter().map(further)).collect();
        let mut found = self.differing(sand, here, &asked).into_iter();
        let there = found.next().unwrap_or_default();
        let mut bend: Vec<f64> = there.iter().zip(here).map(|(there, here)| there - here).collect();
        let mut nuisances: Vec<Nuisance> = Vec::with_capacity(all.len());
        for (&(quantity, sd), further) in all.iter().zip(found) {
            let step = quantity.step() * sd;
            let rate = slope(&further, if fitted(quantity) { &there } else { here }, step);
            bend.iter_mut().zip(&rate).for_each(|(bend, rate)| *bend -= at(quantity) * rate);
            let own = Nuisance::linear(quantity.id(), quantity.unit(), sd, rate);
            nuisances.push(Nuisance { of: self.owner(quantity), nearly_linear: LINEAR * step, ..own });
        }
        // One of the nuisances has what all of them together bend.
        let first = all.iter().position(|&(quantity, _)| at(quantity) != 0.0);
        if let Some(own) = first.and_then(|place| nuisances.get_mut(place)) {
            *own = own.clone().bent(bend);
        }
        nuisances
    }

    /// Predictions for robots with differences from their description; `here` is that without any.
    fn differing(&self, sand: &SandParameters, here: &[f64], all: &[Vec<Difference>]) -> Vec<Vec<f64>> {
        let strong = (Mechanisms { motor_torque_limit: 0.0, ..sand.0 }, sand.1);
        let own = |differences: &Vec<Difference>| {
            let mut ordered = differences.clone();
            ordered.sort_by(|a, b| a.0.code().partial_cmp(&b.0.code()).unwrap_or(std::cmp::Ordering::Equal));
            key(&strong, &ordered.iter().flat_map(|(q, value)| [q.code()[0], q.code()[1], *value]).collect::<Vec<_>>())
        };
        let some: Vec<&Vec<Difference>> = all.iter().filter(|differences| !differences.is_empty()).collect();
        let stacks = self.known_differences.of(some.iter().map(|d| own(d)).collect(), |new| {
            let settings: Vec<_> = new.iter().map(|&k| (*sand, some[k].clone())).collect();
            self.readings(&settings)
        });
        let mut found = stacks.into_iter().map(|stack| self.logged(stack, self.limit(sand), &self.hardware));
        let of = |differences: &Vec<Difference>| match differences.is_empty() {
            true => here.to_vec(),
            false => found.next().unwrap_or_else(|| here.to_vec()),
        };
        all.iter().map(of).collect()
    }

    /// The robot of each run with differences.
    pub(super) fn bodies_with(&self, differences: &[Difference]) -> Result<Vec<ReplayRobot>> {
        let with = |body: &ReplayRobot, all: &[Difference]| all.iter().try_fold(body.clone(), |b, d| b.differing(*d));
        if !matches!(self.bodies[0], ReplayRobot::Tree(..)) {
            return self.bodies.iter().map(|body| with(body, differences)).collect();
        }
        // All runs of a robot from a file have the same robot. New plates for its feet take as long as a replay, so they are kept.
        let (feet, others): (Vec<Difference>, Vec<Difference>) =
            differences.iter().copied().partition(|d: &Difference| d.0 == RobotQuantity::FootSize);
        let sizes: Vec<u64> = feet.iter().map(|d| d.1.to_bits()).collect();
        let body = self.feet.of(&sizes, || with(&self.bodies[0], &feet));
        let body = body.as_ref().as_ref().map_err(Clone::clone)?;
        Ok(vec![with(body, &others)?; self.bodies.len()])
    }
}

/// The motion of each window's joints with differences; None: they do not change the motion.
pub(super) fn drives_with(drives: &[LoggedMotion], differences: &[Difference]) -> Option<Vec<LoggedMotion>> {
    let mut turned = None;
    for (quantity, value) in differences {
        if let RobotQuantity::JointZero(joint) = quantity {
            let before = turned.as_deref().unwrap_or(drives);
            turned = Some(before.iter().map(|drive| drive.turned(*joint, *value)).collect());
        }
    }
    turned
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::{Latch, Silent};
    use crate::sim::model::Scene;
    use crate::trajectory::replay::{Replay, replay};

    /// Robots with other feet are replayed with their own feet, also if they are replayed together with others.
    #[test]
    fn each_robot_has_its_own_feet() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../robots/sandcat.xml");
        let robot = ReplayRobot::load(file, None).unwrap();
        let large = robot.differing((RobotQuantity::FootSize, 0.5)).unwrap();
        let sand = crate::sand::Medium::named("poppy-loose").unwrap();
        let models = [&robot, &large].map(|robot| robot.model(&Scene::flat(sand.clone())).unwrap());
        let ReplayRobot::Tree(tree, _) = &robot else { panic!("sandcat is read from a file") };
        let drive = LoggedMotion::held(&tree.stance.angles, 200, 1e-3);
        let of = |model| Replay { model, drive: &drive, imu: [0.0; 3] };
        let latch = Latch::new(&Silent);
        let replayed = |tasks: &[Replay]| replay(robot.engine(), tasks, &latch).unwrap();
        let [plain, alone] = [&models[0], &models[1]].map(|model| replayed(&[of(model)]).swap_remove(0).signals);
        let together = replayed(&[of(&models[0]), of(&models[1])]);
        assert_eq!(together[0].signals, plain);
        assert_eq!(together[1].signals, alone);
        assert_ne!(plain, alone);
    }

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
