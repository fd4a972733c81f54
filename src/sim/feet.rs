//! Positions and velocities of the feet, the tips of the legs, from a model and a state.

use super::{Model, State};
use nalgebra::{Unit, UnitQuaternion, Vector3};

/// The tip of a leg, in the world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Foot {
    /// [m]
    pub position: [f64; 3],
    /// [m/s]
    pub velocity: [f64; 3],
}

/// One foot a leg, in the order of the model's legs.
pub fn feet<'a>(model: &'a Model, state: &'a State) -> impl Iterator<Item = Foot> + 'a {
    let rows = state.rotation();
    let turn = nalgebra::Matrix3::from_fn(|i, k| rows[i][k]);
    let spin = Vector3::from(state.angular_velocity);
    let mut joint = 0;
    model.legs.iter().map(move |chain| {
        // Base frame: position of each joint, and the angular velocity it adds [rad/s].
        let (mut point, mut frame) = (Vector3::zeros(), UnitQuaternion::identity());
        let mut hinges = Vec::with_capacity(chain.len());
        for body in chain {
            point += frame * body.joint;
            hinges.push((point, frame * body.axis * state.rates[joint]));
            frame *= UnitQuaternion::from_axis_angle(&Unit::new_normalize(body.axis), state.angles[joint]);
            joint += 1;
        }
        let tip = point + chain.last().map_or(Vector3::zeros(), |body| frame * body.reach);
        let slide: Vector3<f64> = hinges.iter().map(|(at, rate)| rate.cross(&(tip - at))).sum();
        let arm = turn * tip;
        let position = Vector3::from(state.position) + arm;
        let velocity = Vector3::from(state.velocity) + spin.cross(&arm) + turn * slide;
        Foot { position: position.into(), velocity: velocity.into() }
    })
}
