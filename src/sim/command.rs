//! What an engine is told for a control step.

/// What each joint's servo is told; held until it is told otherwise.
#[derive(Clone, Debug, PartialEq)]
pub struct Command {
    /// Speed at which the reference angle moves, ω_ref [rad/s], a joint.
    pub rates: Vec<f64>,
    /// Torque added to the servo's [N·m], a joint.
    pub torques: Vec<f64>,
    /// Where the reference angle is put at once [rad], a joint; empty: it goes on from where it is. Engine `tree` alone.
    pub targets: Vec<f64>,
}

impl Command {
    pub fn still(joints: usize) -> Self {
        Self { rates: vec![0.0; joints], torques: vec![0.0; joints], targets: Vec::new() }
    }
}
