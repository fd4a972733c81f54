//! The command that an engine gets for a control step.

/// The commands of all servos; they hold until the next command.
#[derive(Clone, Debug, PartialEq)]
pub struct Command {
    /// Speed at which the reference angle of each joint moves, ω_ref [rad/s].
    pub rates: Vec<f64>,
    /// Torque added to the servo's torque in each joint [N·m].
    pub torques: Vec<f64>,
    /// Reference angles [rad], set at once. If empty, the references move on from their present angles. Only engine
    /// `tree` uses this.
    pub targets: Vec<f64>,
}

impl Command {
    pub fn still(joints: usize) -> Self {
        Self { rates: vec![0.0; joints], torques: vec![0.0; joints], targets: Vec::new() }
    }
}
