//! Position and motion of each body, from the state alone.

use super::State;
use super::model::LinkBody;

pub type V = nalgebra::Vector3<f64>;
pub type M = nalgebra::Matrix3<f64>;

/// Pose and motion of a body's frame, in world axes, with positions relative to the base's centre of mass.
#[derive(Clone, Copy, Debug)]
pub struct BodyFrame {
    /// Own axes to world axes.
    pub rotation: M,
    /// [m]
    pub origin: V,
    /// Velocity of the origin [m/s].
    velocity: V,
    /// [rad/s]
    pub angular_velocity: V,
    /// Acceleration that the origin has while all generalized accelerations are zero [m/s²].
    acceleration: V,
    /// Angular acceleration of the body while all generalized accelerations are zero [rad/s²].
    angular_acceleration: V,
}

impl BodyFrame {
    pub fn base(state: &State) -> Self {
        let rows = state.rotation();
        Self {
            rotation: M::from_fn(|i, j| rows[i][j]),
            origin: V::zeros(),
            velocity: V::from(state.velocity),
            angular_velocity: V::from(state.angular_velocity),
            acceleration: V::zeros(),
            angular_acceleration: V::zeros(),
        }
    }

    /// The frame of `body`, whose hinge has the angle `angle` [rad] and the speed `rate` [rad/s].
    pub fn child(&self, body: &LinkBody, angle: f64, rate: f64) -> Self {
        let arm = self.rotation * body.joint;
        let axis = nalgebra::Unit::new_unchecked(body.axis);
        let spin = self.rotation * body.axis * rate;
        Self {
            rotation: self.rotation * nalgebra::Rotation3::from_axis_angle(&axis, angle).into_inner(),
            origin: self.origin + arm,
            velocity: self.velocity_at(arm),
            angular_velocity: self.angular_velocity + spin,
            acceleration: self.acceleration_at(arm),
            angular_acceleration: self.angular_acceleration + self.angular_velocity.cross(&spin),
        }
    }

    /// Velocity [m/s] of the body's point at `arm` from its origin; world axes.
    pub fn velocity_at(&self, arm: V) -> V {
        self.velocity + self.angular_velocity.cross(&arm)
    }

    /// Acceleration [m/s²] of the point at `arm` from the origin, due to velocities alone; world axes.
    pub fn acceleration_at(&self, arm: V) -> V {
        let turning = self.angular_velocity.cross(&self.angular_velocity.cross(&arm));
        self.acceleration + self.angular_acceleration.cross(&arm) + turning
    }
}
