//! Patterns of joint names.

use sandgait_sim::tree::joint_values::matches;

#[test]
fn patterns_match_as_in_legged_gym_and_isaac_lab() {
    for (pattern, name, wanted) in [
        ("joint", "FL_hip_joint", true),
        ("hip", "FL_hip_joint", true),
        ("knee", "FL_hip_joint", false),
        ("*_hip_joint", "FL_hip_joint", true),
        (".*_hip_joint", "FL_hip_joint", true),
        ("F*_joint", "FL_hip_joint", true),
        ("R*_joint", "FL_hip_joint", false),
        ("*", "anything", true),
        ("a*a", "a", false),
        ("*_calf", "FL_calf_joint", false),
    ] {
        assert_eq!(matches(pattern, name), wanted, "{pattern} {name}");
    }
}
