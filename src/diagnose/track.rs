//! The motion of an intruder in one trial.

use super::experiment::Intruder;

/// Pose and motion of an intruder at one sample. Legs use the angle, plates the centre.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ArmPose {
    /// [s]
    pub t: f64,
    /// [rad] and [rad/s]
    pub theta: f64,
    pub omega: f64,
    /// Centre of a plate [m] and its velocity [m/s].
    pub center: [f64; 2],
    pub velocity: [f64; 2],
}

/// Fx [N], Fz [N] and Ty [N·m] on an intruder.
pub type Wrench = [f64; 3];

/// Pose and motion of an intruder, rotated by (sin, cos) counter-clockwise about its origin; velocity and
/// acceleration are those of the origin.
#[derive(Clone, Copy)]
pub struct RigidMotion {
    pub origin: [f64; 2],
    pub turn: (f64, f64),
    pub velocity: [f64; 2],
    /// Angular velocity and acceleration. Only the tangential part of the acceleration changes v·n, because the
    /// normal turns with the leg.
    pub spin: f64,
    pub change: [f64; 2],
    pub spin_up: f64,
}

/// The motion of a trial; trials that move in the same way share one `Track`.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    pub shape: String,
    pub intruder: Intruder,
    /// Height of a leg's hip above the surface [m]; 0 for plates.
    pub hip_height: f64,
    /// Tilt of a plate [rad]; 0 for legs.
    pub beta: f64,
    pub pass: u32,
    /// Distance from the first pass [m].
    pub pass_dx: f64,
    /// Position in the bed [m].
    pub x_bed: f64,
    pub poses: Vec<ArmPose>,
    /// Places in `poses` of the samples whose forces are compared.
    pub compared: Vec<usize>,
}

impl Track {
    /// The coordinates that move: the angle of a leg [rad], or the centre of a plate [m].
    pub fn place(&self, pose: &ArmPose) -> [f64; 2] {
        match self.intruder {
            Intruder::Leg { .. } => [pose.theta, 0.0],
            Intruder::Plate { .. } => pose.center,
        }
    }

    /// The logged speed of these coordinates.
    pub fn speed(&self, pose: &ArmPose) -> f64 {
        match self.intruder {
            Intruder::Leg { .. } => pose.omega.abs(),
            Intruder::Plate { .. } => pose.velocity[0].hypot(pose.velocity[1]),
        }
    }

    /// Would another log call these two the same condition? Speeds and depths may differ by a fifth, angles by 10°, places by 2 cm:
    /// our choices, the steps of a usual design.
    pub(super) fn resembles(&self, other: &Self) -> bool {
        let near = |a: f64, b: f64, share: f64, least: f64| (a - b).abs() <= (share * a.abs().max(b.abs())).max(least);
        let deepest = |t: &Self| t.poses.iter().map(|p| -t.place(p)[1]).fold(f64::MIN, f64::max);
        let way = |t: &Self| {
            let (first, last) = (t.place(&t.poses[0]), t.place(&t.poses[t.poses.len() - 1]));
            (last[1] - first[1]).atan2(last[0] - first[0])
        };
        let turn = (way(self) - way(other)).sin().abs() < 0.17 && (way(self) - way(other)).cos() > 0.0;
        self.shape == other.shape
            && self.pass.min(2) == other.pass.min(2)
            && near(self.x_bed, other.x_bed, 0.0, 0.02)
            && near(self.rate(), other.rate(), 0.2, 0.0)
            && near(self.hip_height, other.hip_height, 0.2, 0.002)
            && near(self.beta, other.beta, 0.0, 0.17)
            && (matches!(self.intruder, Intruder::Leg { .. })
                || turn && near(deepest(self), deepest(other), 0.2, 0.002))
    }

    /// A leg on fresh ground at x = 0.
    #[cfg(test)]
    pub fn leg(intruder: Intruder, hip_height: f64, poses: Vec<ArmPose>) -> Self {
        let (shape, beta, pass, pass_dx, x_bed, compared) = ("leg".into(), 0.0, 1, 0.0, 0.0, Vec::new());
        Self { shape, intruder, hip_height, beta, pass, pass_dx, x_bed, poses, compared }
    }
}
