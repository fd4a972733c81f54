//! Position and motion of one robot.

use crate::sand::memory::Moved;
use serde::{Deserialize, Serialize};

/// State of one robot; world frame: x along the surface (uphill), z along its normal, sand at z < 0.
/// Joints are in the order of [`super::Robot::joint_names`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// Base centre [m].
    pub position: [f64; 3],
    /// Unit quaternion w, x, y, z: base frame to world.
    pub orientation: [f64; 4],
    /// Velocity of the base centre, in the world frame [m/s].
    pub velocity: [f64; 3],
    /// Angular velocity of the base, in the world frame [rad/s].
    pub angular_velocity: [f64; 3],
    /// Joint angles [rad].
    pub angles: Vec<f64>,
    /// Joint speeds [rad/s].
    pub rates: Vec<f64>,
    /// Servo reference angles θ_ref [rad].
    pub references: Vec<f64>,
    /// Torque that each joint applied in the last time step [N·m].
    pub torques: Vec<f64>,
    /// Change of `velocity` [m/s] and `angular_velocity` [rad/s] in the last time step; zero at the start. Engine
    /// `lanes` expects about the same change in the next step: see [`super::lanes`].
    pub velocity_change: [f64; 3],
    pub angular_velocity_change: [f64; 3],
    /// Change of `rates` in the last time step [rad/s].
    pub rate_changes: Vec<f64>,
    /// ∫ Σ|τ ω| dt since the state was set [J]; for engine `carriage`, whose drives recover energy, ∫ Σ τ ω dt.
    pub work: f64,
    /// Impulse of the sand's force on the legs since the state was set, ∫ F dt [N·s]; only engine `carriage` measures it.
    pub impulse: [f64; 3],
    /// The scene's obstacles that move, in the scene's order.
    #[serde(default)]
    pub objects: Vec<ObjectState>,
    /// Sand that was moved; None: the sand is level, or this copy does not contain it. Engines read the field when a
    /// state is set, but return their sand only by [`super::engine::Engine::sand`], because it is large.
    #[serde(skip)]
    pub sand: Option<Box<Moved>>,
}

/// Pose and velocity of a loose obstacle; world frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ObjectState {
    /// Centre of mass [m].
    pub position: [f64; 3],
    /// Unit quaternion w, x, y, z: own frame to world.
    pub orientation: [f64; 4],
    /// Velocity of the centre of mass [m/s].
    pub velocity: [f64; 3],
    /// [rad/s]
    pub angular_velocity: [f64; 3],
}

impl ObjectState {
    fn numbers(&self) -> impl Iterator<Item = &f64> {
        let [position, orientation] = [&self.position[..], &self.orientation];
        position.iter().chain(orientation).chain(&self.velocity).chain(&self.angular_velocity)
    }

    /// The inverse of [`Self::numbers`].
    fn from_numbers(numbers: &[f64; 13]) -> Self {
        let [px, py, pz, w, x, y, z, vx, vy, vz, ox, oy, oz] = *numbers;
        Self {
            position: [px, py, pz],
            orientation: [w, x, y, z],
            velocity: [vx, vy, vz],
            angular_velocity: [ox, oy, oz],
        }
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
            velocity_change: [0.0; 3],
            angular_velocity_change: [0.0; 3],
            rate_changes: vec![0.0; angles.len()],
            work: 0.0,
            impulse: [0.0; 3],
            objects: Vec::new(),
            sand: None,
        }
    }

    /// All numbers as one row, for [`Self::from_row`].
    pub fn row(&self) -> Vec<f64> {
        let mut row = Vec::with_capacity(23 + 5 * self.angles.len() + 13 * self.objects.len());
        row.extend(self.position.iter().chain(&self.orientation).chain(&self.velocity).chain(&self.angular_velocity));
        row.push(self.work);
        row.extend(self.impulse);
        row.extend(self.velocity_change.iter().chain(&self.angular_velocity_change));
        row.extend(self.angles.iter().chain(&self.rates).chain(&self.references).chain(&self.torques));
        row.extend(&self.rate_changes);
        row.extend(self.objects.iter().flat_map(ObjectState::numbers));
        row
    }

    /// The state of a robot with `joints` joints from its [`Self::row`]; None if the row's length is wrong.
    pub fn from_row(joints: usize, row: &[f64]) -> Option<Self> {
        let (base, rest) = row.split_at_checked(23)?;
        let (joint, objects) = rest.split_at_checked(5 * joints)?;
        let (objects, rest) = objects.as_chunks::<13>();
        if !rest.is_empty() {
            return None;
        }
        let part = |i: usize| joint[i * joints..][..joints].to_vec();
        Some(Self {
            position: base[..3].try_into().ok()?,
            orientation: base[3..7].try_into().ok()?,
            velocity: base[7..10].try_into().ok()?,
            angular_velocity: base[10..13].try_into().ok()?,
            work: base[13],
            impulse: base[14..17].try_into().ok()?,
            velocity_change: base[17..20].try_into().ok()?,
            angular_velocity_change: base[20..].try_into().ok()?,
            angles: part(0),
            rates: part(1),
            references: part(2),
            torques: part(3),
            rate_changes: part(4),
            objects: objects.iter().map(ObjectState::from_numbers).collect(),
            sand: None,
        })
    }

    /// Are all numbers finite and small enough to compute the next step? 1e4 m or rad/s is far beyond any walking
    /// robot: our choice.
    pub fn is_sound(&self) -> bool {
        let ok = |v: &[f64]| v.iter().all(|x| x.abs() < 1e4);
        ok(&self.position)
            && ok(&self.orientation)
            && ok(&self.velocity)
            && ok(&self.angular_velocity)
            && ok(&self.angles)
            && ok(&self.rates)
            && ok(&self.velocity_change)
            && ok(&self.angular_velocity_change)
            && ok(&self.rate_changes)
            && self.objects.iter().flat_map(ObjectState::numbers).all(|x| x.abs() < 1e4)
    }

    /// Clears the changes of the last time step, for engines that do not use them.
    pub fn forget_changes(&mut self) {
        (self.velocity_change, self.angular_velocity_change) = ([0.0; 3], [0.0; 3]);
        self.rate_changes.fill(0.0);
    }

    /// [`Self::is_sound`] for a state from outside: also checks torques, work and impulse, and that every orientation
    /// has length 1, to 1 %: our choice, far above rounding in `f32`.
    pub fn is_possible(&self) -> bool {
        let numbers = || self.references.iter().chain(&self.torques).chain(&self.impulse).chain([&self.work]);
        let unit = |q: &[f64; 4]| (q.iter().map(|c| c * c).sum::<f64>().sqrt() - 1.0).abs() < 1e-2;
        // A servo's reference keeps moving while its joint is blocked, so the reference needs a bound: our choice, far beyond any episode.
        self.is_sound()
            && numbers().all(|x| x.abs() < 1e9)
            && unit(&self.orientation)
            && self.objects.iter().all(|o| unit(&o.orientation))
    }

    /// Velocity of the base along x and y [m/s].
    pub fn travel(&self) -> [f64; 2] {
        [self.velocity[0], self.velocity[1]]
    }

    /// Rotation from base frame to world, row by row.
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
