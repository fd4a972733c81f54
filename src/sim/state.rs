//! Where one robot is and how it moves.

use serde::{Deserialize, Serialize};

/// State of one robot; world frame: x along the surface (uphill), z along its normal, sand at z < 0.
/// Joints are in the order of [`super::Robot::joint_names`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// Base centre [m].
    pub position: [f64; 3],
    /// Unit quaternion w, x, y, z: base frame to world.
    pub orientation: [f64; 4],
    /// Of the base centre, in the world frame [m/s].
    pub velocity: [f64; 3],
    /// Of the base, in the world frame [rad/s].
    pub angular_velocity: [f64; 3],
    /// Joint angles [rad].
    pub angles: Vec<f64>,
    /// Joint speeds [rad/s].
    pub rates: Vec<f64>,
    /// Servo reference angles θ_ref [rad].
    pub references: Vec<f64>,
    /// Torque each joint applied in the last time step [N·m].
    pub torques: Vec<f64>,
    /// ∫ Σ|τ ω| dt since the state was set [J].
    pub work: f64,
    /// The scene's obstacles that move, in their order.
    #[serde(default)]
    pub objects: Vec<ObjectState>,
}

/// Where a loose obstacle is and how it moves; world frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ObjectState {
    /// Centre of mass [m].
    pub position: [f64; 3],
    /// Unit quaternion w, x, y, z: own frame to world.
    pub orientation: [f64; 4],
    /// Of the centre of mass [m/s].
    pub velocity: [f64; 3],
    /// [rad/s]
    pub angular_velocity: [f64; 3],
}

impl ObjectState {
    fn numbers(&self) -> impl Iterator<Item = &f64> {
        let [position, orientation] = [&self.position[..], &self.orientation];
        position.iter().chain(orientation).chain(&self.velocity).chain(&self.angular_velocity)
    }
}

impl State {
    /// At rest at `height` [m] above the surface, joints at `angles`, references equal to them.
    pub fn at_rest(height: f64, angles: &[f64]) -> Self {
        Self {
            position: [0.0, 0.0, height],
            orientation: [1.0, 0.0, 0.0, 0.0],
            velocity: [0.0; 3],
            angular_velocity: [0.0; 3],
            angles: angles.to_vec(),
            rates: vec![0.0; angles.len()],
            references: angles.to_vec(),
            torques: vec![0.0; angles.len()],
            work: 0.0,
            objects: Vec::new(),
        }
    }

    /// Are all numbers finite and small enough that the next step can be computed? 1e4 m or rad/s is far beyond any
    /// walking robot: our choice.
    pub fn is_sound(&self) -> bool {
        let ok = |v: &[f64]| v.iter().all(|x| x.abs() < 1e4);
        ok(&self.position)
            && ok(&self.orientation)
            && ok(&self.velocity)
            && ok(&self.angular_velocity)
            && ok(&self.angles)
            && ok(&self.rates)
            && self.objects.iter().flat_map(ObjectState::numbers).all(|x| x.abs() < 1e4)
    }

    /// Base frame to world, row by row.
    pub fn rotation(&self) -> [[f64; 3]; 3] {
        let [w, x, y, z] = self.orientation;
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    }

    /// A world vector in the base frame.
    pub fn to_body(&self, v: [f64; 3]) -> [f64; 3] {
        let r = self.rotation();
        [0, 1, 2].map(|i| r[0][i] * v[0] + r[1][i] * v[1] + r[2][i] * v[2])
    }
}
