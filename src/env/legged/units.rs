//! A robot's own units: speeds, times and torques that are alike for robots of every size.

use super::draws::{Commands, MOST_COMMAND};
use crate::sim::Model;

/// Units from the legs' length ℓ and the weight W. Two robots whose motions have equal numbers in these units move alike, one
/// only larger than the other (R. McN. Alexander & A. S. Jayes, J. Zool. 201 (1983) 135). v²/(gℓ) is the Froude number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Units {
    /// √(gℓ) [m/s]
    pub speed: f64,
    /// √(g/ℓ) [rad/s]
    pub rate: f64,
    /// Wℓ [N·m]
    pub torque: f64,
    /// Ends of the commands' ranges: forward, to the left [m/s], yaw [rad/s].
    commanded: [f64; 3],
}

/// Ends of the commands' default ranges in these units, forward, to the left and yaw: our choice. The speed forward has
/// a Froude number of 0.25, which is a brisk walk (animals change from walk to trot near 0.5, Alexander & Jayes 1983).
/// The speed to the left is half of it. One turn takes some 30 times √(ℓ/g). With legs of half a metre (ANYmal) these
/// ends are 1.1 m/s, 0.55 m/s and 0.9 rad/s; legged_gym has 1, 1 and 1.
pub const COMMANDED: [f64; 3] = [0.5, 0.25, 0.2];

/// Commanded speeds below this part of √(gℓ) are zero: legged_gym has a limit of 0.2 m/s, for commands of at most 1 m/s. Our choice
/// is smaller, so that a policy also learns slow steps to the side.
const SMALL: f64 = 0.05;

impl Units {
    pub fn of(model: &Model) -> Self {
        // Our choice of the least length, so that no unit is 0.
        let length = model.tree.as_ref().map_or(1.0, |tree| tree.stance.leg_length).max(1e-3);
        let gravity = model.gravity_size();
        let (speed, rate) = ((gravity * length).sqrt(), (gravity / length).sqrt());
        let [x, y, yaw] = COMMANDED;
        let commanded = [x * speed, y * speed, yaw * rate].map(|end| end.min(MOST_COMMAND));
        Self { speed, rate, torque: model.total_mass() * gravity * length, commanded }
    }

    /// The same units, with these ends of the commands' ranges.
    pub fn up_to(self, ends: Option<[f64; 3]>) -> Self {
        Self { commanded: ends.unwrap_or(self.commanded), ..self }
    }

    /// Commanded speeds below this are zero [m/s].
    pub fn small(&self) -> f64 {
        SMALL * self.speed * (self.commanded[0] / (COMMANDED[0] * self.speed)).min(1.0)
    }

    /// The ends of the commands' default ranges: forward, to the left [m/s], yaw [rad/s].
    pub fn commanded(&self) -> [f64; 3] {
        self.commanded
    }

    /// The ranges of the commands: the given range, or, where none is given, the robot's default range.
    pub fn ranges(&self, commands: &Commands) -> [[f64; 2]; 3] {
        let given = [commands.lin_vel_x, commands.lin_vel_y, commands.ang_vel_yaw];
        let own = self.commanded();
        std::array::from_fn(|k| given[k].unwrap_or([-own[k], own[k]]))
    }
}
