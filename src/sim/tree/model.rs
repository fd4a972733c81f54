//! A tree robot ready for an engine: tree, motors, plates and points of contact.

use super::Tree;
use super::contact::{ContactPoint, contact_points};
use super::gains::{TreeMotor, motors};
use super::kinematics::{frames, lowest};
use super::looks::Looks;
use super::patches::BodyPatches;
use super::plates::of_body;
use super::self_contact::SelfContact;
use super::stance::Stance;
use crate::State;
use crate::error::{Error, Result, check_range};
use crate::sand::Law;
use crate::sand::intruder::IntruderPlate;
use nalgebra::Vector3;
use std::sync::Arc;

/// Compliance of hard ground at each point of contact, and the speed of creep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Compliance {
    /// [N/m]
    pub stiffness: f64,
    /// [N·s/m]
    pub damping: f64,
    /// Speed with which a point creeps while friction holds it [m/s].
    pub creep: f64,
}

/// A tree robot. Everything that an episode does not change is shared, so a copy with another mass of the base or other
/// motors is small: see [`crate::Model::episode_bytes`].
#[derive(Clone, Debug, PartialEq)]
pub struct TreeModel {
    /// The robot of the file.
    pub tree: Arc<Tree>,
    /// Mass of the base [kg], with a payload and the mass that an episode adds. It replaces the mass in `tree`.
    pub base_mass: f64,
    /// One for each joint.
    pub motors: Vec<TreeMotor>,
    /// Plates that touch sand, in the frame of each body.
    pub plates: Arc<Vec<Vec<IntruderPlate>>>,
    /// The same plates in the engines' form; empty before [`TreeModel::for_law`].
    pub patches: Arc<Vec<BodyPatches>>,
    /// Points that touch hard ground, in the frame of each body.
    pub contacts: Arc<Vec<Vec<ContactPoint>>>,
    /// None: parts of the robot pass through each other.
    pub self_contact: Option<Arc<SelfContact>>,
    pub compliance: Compliance,
    /// The standing pose.
    pub stance: Arc<Stance>,
    /// Shapes for pictures.
    pub looks: Arc<Looks>,
}

impl Compliance {
    /// The whole weight of a robot of `mass` under `gravity` on one point sinks it by 1 mm. Damping is half of the critical damping of a quarter of the
    /// mass. A held point creeps with up to 1e-5 m/s, as on sand. Our choices, because one of four feet at rest then
    /// sinks by less than 0.3 mm, which changes no gait noticeably.
    pub fn of_mass(mass: f64, gravity: f64) -> Self {
        let weight = mass * gravity;
        let stiffness = weight / 1e-3;
        Self { stiffness, damping: (stiffness * mass / 4.0).sqrt(), creep: 1e-5 }
    }
}

impl TreeModel {
    /// A robot whose body `i` touches sand with `plates[i]`.
    pub fn new(tree: Tree, plates: Vec<Vec<IntruderPlate>>) -> Result<Self> {
        let contacts = contact_points(&tree);
        Self::with_contacts(tree, plates, contacts)
    }

    /// Places of the joints that move a body which is neither base nor part of a leg: of waist, arms and head.
    pub fn upper_joints(&self) -> Vec<usize> {
        let jointed = (0..self.tree.bodies.len()).filter(|i| self.tree.bodies[*i].joint.is_some());
        jointed.enumerate().filter(|(_, body)| self.stance.upper.contains(body)).map(|(joint, _)| joint).collect()
    }

    /// The same as [`Self::new`], for points of contact that the caller supplies.
    pub fn with_contacts(
        tree: Tree,
        plates: Vec<Vec<IntruderPlate>>,
        contacts: Vec<Vec<ContactPoint>>,
    ) -> Result<Self> {
        check(&tree)?;
        let compliance = Compliance::of_mass(tree.mass(), tree.gravity());
        let stance = Arc::new(Stance::of(&tree, &contacts));
        let motors = motors(&tree, &contacts, &stance);
        let looks = Looks::of(tree.bodies.iter().map(|b| &b.shapes[..]), false).or_plates(&plates);
        let (patches, contacts, looks) = (Arc::default(), Arc::new(contacts), Arc::new(looks));
        let (base_mass, tree) = (tree.bodies[0].mass, Arc::new(tree));
        let (plates, self_contact) = (Arc::new(plates), None);
        Ok(Self { tree, base_mass, motors, plates, patches, contacts, self_contact, compliance, stance, looks })
    }

    /// The model with other shapes for pictures. Without this call, pictures show the primitives of each body, or its
    /// plates if it has no primitives.
    pub fn with_looks(self, looks: Looks) -> Self {
        Self { looks: Arc::new(looks.finished()), ..self }
    }

    /// The model with its plates gathered for `law`, if they are not gathered yet.
    pub fn for_law(mut self, law: Law) -> Self {
        if self.patches.is_empty() {
            self.patches = Arc::new(BodyPatches::all(&self.plates, law));
        }
        self
    }

    /// The model with fine plates on the shapes that touch sand, indices of a body and of one of its shapes, gathered for `law`: with
    /// them forces are accurate in every single pose ([`super::plates::of_body`]). A step takes twice the time.
    pub fn with_fine_plates(mut self, touching: &[(usize, usize)], law: Law) -> Result<Self> {
        let of = |body: usize| {
            let own = touching.iter().filter(|t| t.0 == body).map(|t| &self.tree.bodies[body].shapes[t.1]);
            of_body(&own.collect::<Vec<_>>())
        };
        let plates: Vec<_> = (0..self.tree.bodies.len()).map(of).collect::<Result<_>>()?;
        let fine = plates.iter().enumerate().filter(|(_, own)| !own.is_empty());
        self.patches = Arc::new(fine.map(|(body, own)| BodyPatches::fine(body, own, law)).collect());
        self.plates = Arc::new(plates);
        Ok(self)
    }

    /// A copy with `payload` [kg] at the base's centre of mass.
    pub fn with_payload(mut self, payload: f64) -> Self {
        self.base_mass += payload;
        self
    }

    /// A copy whose motors give at most `limit` [N·m]; with a limit of 0 nothing changes.
    pub fn with_weak_motors(mut self, limit: f64) -> Self {
        for motor in self.motors.iter_mut().filter(|_| limit > 0.0) {
            let own = &mut motor.actuator.torque_limit;
            *own = Some(own.map_or(limit, |own| own.min(limit)));
        }
        self
    }

    /// A copy whose legs do not pass through each other or the base.
    pub fn with_self_contact(mut self) -> Self {
        self.self_contact = Some(Arc::new(SelfContact::of(&self.tree, &self.contacts, &self.stance)));
        self
    }

    /// A copy that stands with the given joints at other angles.
    pub fn standing_at(mut self, angles: &[Option<f64>]) -> Self {
        let own = self.stance.angles.iter().zip(angles);
        let angles: Vec<f64> = own.map(|(own, other)| other.unwrap_or(*own)).collect();
        self.stance = Arc::new(Stance::at(&self.tree, &self.contacts, angles));
        self
    }

    /// Height above `ground` of the middle of the hips, with the base in `state` [m].
    pub fn hips_over(&self, state: &State, ground: impl Fn(f64, f64) -> f64) -> f64 {
        over(&self.stance.hips, state, ground)
    }

    /// Is the middle of the hips, or the base's centre of mass, lower than this `part` of its standing height? A robot that
    /// sits has high hips and a low centre of mass.
    pub fn is_low(&self, state: &State, part: f64, ground: impl Fn(f64, f64) -> f64) -> bool {
        let low = |point: &Vector3<f64>| over(point, state, &ground) < part * (self.stance.height + point.z);
        low(&self.stance.hips) || low(&self.tree.bodies[0].center)
    }

    /// Velocity of the middle of the hips [m/s], world axes.
    pub fn hips_velocity(&self, state: &State) -> Vector3<f64> {
        let arm = state.rotation().map(|row| Vector3::from(row).dot(&self.stance.hips));
        Vector3::from(state.velocity) + Vector3::from(state.angular_velocity).cross(&Vector3::from(arm))
    }

    /// Height of the level base's origin at which the lowest point touches flat ground [m], with joints at `angles`.
    pub fn standing_height(&self, angles: &[f64]) -> f64 {
        self.height_over(angles, |_, _| 0.0)
    }

    /// The same as [`Self::standing_height`], over ground with the heights `ground`; the base's origin is at x = y = 0.
    pub fn height_over(&self, angles: &[f64], ground: impl Fn(f64, f64) -> f64) -> f64 {
        let frames = frames(&self.tree, &State::at_rest(0.0, angles));
        let over = |low: Vector3<f64>| low.z - ground(low.x, low.y);
        let low =
            frames.iter().zip(self.contacts.iter()).map(|(f, p)| over(lowest(f, p))).fold(f64::INFINITY, f64::min);
        if low.is_finite() { -low } else { 0.0 }
    }

    /// Horizontal distance of the farthest plate from the base's origin in the standing pose [m].
    pub fn reach(&self) -> f64 {
        let frames = frames(&self.tree, &State::at_rest(0.0, &self.stance.angles));
        let of = |(frame, plates): (&nalgebra::Isometry3<f64>, &Vec<IntruderPlate>)| {
            let far = |p: &IntruderPlate| (frame * nalgebra::Point3::from(p.center.lane(0))).coords.xy().norm();
            plates.iter().map(far).fold(0.0, f64::max)
        };
        frames.iter().zip(self.plates.iter()).map(of).fold(0.0, f64::max)
    }

    /// Height of the highest point of contact over the lowest one in the standing pose [m].
    pub fn tallness(&self) -> f64 {
        let frames = frames(&self.tree, &State::at_rest(0.0, &self.stance.angles));
        let high = |(frame, points): (&nalgebra::Isometry3<f64>, &Vec<ContactPoint>)| {
            let up = frame.rotation.inverse() * Vector3::z();
            points.iter().map(|p| frame.translation.z + p.reach(&up)).fold(f64::NEG_INFINITY, f64::max)
        };
        let top = frames.iter().zip(self.contacts.iter()).map(high).fold(f64::NEG_INFINITY, f64::max);
        if top.is_finite() { self.standing_height(&self.stance.angles) + top } else { 0.0 }
    }

    pub fn joints(&self) -> usize {
        self.motors.len()
    }

    /// [kg]
    pub fn mass(&self) -> f64 {
        self.tree.bodies.iter().skip(1).fold(self.base_mass, |sum, body| sum + body.mass)
    }
}

/// Checks once more the properties that readers of files guarantee, because engines rely on them for indexing.
fn check(tree: &Tree) -> Result<()> {
    for (i, body) in tree.bodies.iter().enumerate() {
        if (i > 0 && body.parent >= i) || (i > 0) != body.joint.is_some() {
            return Err(Error::invalid("robot", format!("{}: bodies are not in depth-first order", body.name)));
        }
        check_range(&format!("mass of {}", body.name), body.mass, 0.0..=1e6)?;
    }
    match tree.bodies.first() {
        Some(_) => check_range("mass", tree.mass(), 1e-6..=1e6).map(drop),
        None => Err(Error::invalid("robot", "it has no bodies")),
    }
}

/// Height of a `point` of the base above the ground [m].
fn over(point: &Vector3<f64>, state: &State, ground: impl Fn(f64, f64) -> f64) -> f64 {
    let [x, y, z] = state.position;
    let [dx, dy, dz] = state.rotation().map(|row| Vector3::from(row).dot(point));
    z + dz - ground(x + dx, y + dy)
}
