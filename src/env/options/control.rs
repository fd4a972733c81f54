//! Names of the ways to drive hips.

use serde::{Deserialize, Serialize};

/// The keyword `control`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Control {
    /// The speed of each hip's reference.
    HipSpeed,
    /// The angle each hip's reference goes to.
    HipTarget,
    /// The torque of each hip; the servo does nothing.
    Torque,
    /// A gait as parameters; see [`crate::clock`].
    Clock,
}

impl Control {
    /// As the keyword has them.
    pub const NAMES: [&'static str; 4] = ["hip_speed", "hip_target", "torque", "clock"];
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_the_keywords() {
        use Control::*;
        let all = [HipSpeed, HipTarget, Torque, Clock].map(|c| serde_json::to_value(c).unwrap());
        assert_eq!(all, Control::NAMES.map(serde_json::Value::from));
    }
}
