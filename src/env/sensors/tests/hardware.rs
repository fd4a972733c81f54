//! Files of hardware, and what each episode draws from them.

use super::{HARDWARE, cases, run, shard, with};
use crate::registry::Blueprint;
use crate::shard::Shard;
use serde_json::json;

#[test]
fn a_hardware_file_is_the_same_as_its_options() {
    for (id, options) in cases() {
        let file = with(&options, json!({"hardware": HARDWARE}));
        let said = json!({
            "actuator": {"no_load_speed": 20.0, "stall_torque": 0.5},
            "action_delay": [0.02, 0.02],
            "sensors": {"gyroscope": {"delay": 0.02}, "imu_rotation": [0.0, 0.1, 0.0]},
        });
        let observes = shard(id, &options, 1).spec().observation.iter().any(|c| c.name.contains("angular velocity"));
        if !observes {
            // The task has no such sensor and no motors, but it uses the file's action delay.
            assert_eq!(Blueprint::new(id, file).unwrap().task.action_delay(), [0.02, 0.02], "{id}");
            continue;
        }
        let (exact, own) = (run(&mut shard(id, &options, 2), 20), run(&mut shard(id, &file, 2), 20));
        assert_eq!(own, run(&mut shard(id, &with(&options, said), 2), 20), "{id}");
        assert_ne!(own, exact, "{id}");
    }
}

#[test]
fn episodes_draw_their_hardware() {
    let id = "sandgait/HexapodGait-v1";
    let mut drawn = shard(id, &json!({"domain_rand": {"hardware": HARDWARE}}), 16);
    let speeds =
        |shard: &Shard| -> Vec<f64> { (0..16).map(|i| shard.model(i).motor.actuator.no_load_speed.unwrap()).collect() };
    let first = speeds(&drawn);
    assert!(first.iter().all(|speed| (15.0..=25.0).contains(speed)), "{first:?}");
    assert!(first.iter().any(|speed| *speed < 18.0) && first.iter().any(|speed| *speed > 22.0), "{first:?}");
    let servos: Vec<_> = (0..16).map(|i| drawn.model(i).robot.servo).collect();
    assert!(servos.iter().zip(&first).all(|(servo, speed)| servo.no_load_speed == Some(*speed)));
    drawn.reset(|_| true, None, |_| None);
    assert_ne!(speeds(&drawn), first, "the next episode draws again");
    drawn.reset(|_| true, Some(&(0..16).collect::<Vec<_>>()), |_| None);
    assert_eq!(speeds(&drawn), first, "seeds fix what is drawn");
}
