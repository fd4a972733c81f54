//! Forces of sand and hard ground on a robot at one moment, for pictures and recordings. A step does not need this.

use super::dynamics::LinkLoad;
use super::patches::BodyPatches;
use super::step::{TreeScratch, accelerate};
use super::{engine, sand};
use crate::number::Vec3;
use crate::spatial::Twist;
use crate::{Model, State};
use nalgebra::Vector3;

type V = Vector3<f64>;

/// A force on a body: the force of sand on a patch of plates, or the force of hard ground on a point of contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointForce {
    pub body: usize,
    /// Place in the world [m]: the point, or the centre of the patch.
    pub at: V,
    /// In the world's axes [N].
    pub force: V,
}

/// Bodies that can touch sand or hard ground, in order.
pub fn touching(model: &Model) -> Vec<usize> {
    let Some(tree) = &model.tree else { return Vec::new() };
    let touches = |b: usize| {
        (model.has_sand() && !tree.plates[b].is_empty())
            || (!model.scene.hard.is_empty() && !tree.contacts[b].is_empty())
    };
    (0..tree.tree.bodies.len()).filter(|b| touches(*b)).collect()
}

/// The forces in the time step that begins at `state`, if the servos keep their references. The engine's functions
/// compute them in `f64`, with the accelerations of that step, so the sum of these forces and the weight is the change
/// of momentum per time.
pub fn pushes(model: &Model, state: &State) -> Vec<PointForce> {
    let Some((tree, state, found)) = engine::alone(model, state) else { return Vec::new() };
    let mut s = TreeScratch::new(tree.bodies.len(), tree.gears.len());
    accelerate(&tree, &state, &mut s, found.as_ref());
    let place = state.place();
    let world = |from_base: Vec3<f64>| V::from((place + from_base).lane(0));
    let mut loads = vec![LinkLoad::none(); tree.bodies.len()];
    let mut all = Vec::new();
    for body in tree.patches.iter() {
        for patch in &body.patches {
            // All other fields are those of the whole body, so the result is the patch's share of the body's force.
            let alone = [BodyPatches { patches: vec![patch.clone()], ..*body }];
            loads[body.body] = LinkLoad::none();
            sand::press(&tree.ground, &alone, &s.frames, &place, &tree.relief, found.as_ref(), &mut loads, tree.dt);
            let force = force(&loads[body.body], &s.accelerations[body.body]);
            let at = world(s.frames[body.body].point(Vec3::splat(patch.ball.center)));
            all.push(PointForce { body: body.body, at, force });
        }
    }
    for touch in &s.touches {
        loads[touch.body] = LinkLoad::none();
        tree.floor.press(std::slice::from_ref(touch), &mut loads, tree.dt);
        let force = force(&loads[touch.body], &s.accelerations[touch.body]);
        all.push(PointForce { body: touch.body, at: world(touch.at), force });
    }
    all.retain(|push| push.force != V::zeros());
    all
}

/// Upward force of the sand on a robot that moves at the velocities of `state` without acceleration [N].
pub fn support(model: &Model, state: &State) -> f64 {
    let Some((tree, state, found)) = engine::alone(model, state) else { return 0.0 };
    let mut s = TreeScratch::new(tree.bodies.len(), tree.gears.len());
    let (found, place) = (found.as_ref(), state.place());
    accelerate(&tree, &state, &mut s, found);
    let mut loads = vec![LinkLoad::none(); tree.bodies.len()];
    sand::press(&tree.ground, &tree.patches, &s.frames, &place, &tree.relief, found, &mut loads, tree.dt);
    loads.iter().map(|load| force(load, &Twist::zero()).z).sum()
}

/// The force on a body with this acceleration, from a load that contains this force only.
fn force(load: &LinkLoad<f64>, acceleration: &Twist<f64>) -> V {
    let mut needed = load.inertia.apply(acceleration);
    needed.add(&load.bias);
    -V::from(needed.force.lane(0))
}
