//! Robots on two legs from files: what a training sets for them, and when they fall.

#[path = "testbed/legged_training.rs"]
mod legged_training;
#[path = "testbed/made_robots.rs"]
mod made_robots;
#[path = "testbed/packing.rs"]
mod packing;

use made_robots::{quadruped, read, shard_of};
use packing::pack;
use sandgait::env::registry::Blueprint;
use sandgait::robots::Import;
use sandgait::train::entry;
use sandgait::train::teacher::suit;
use serde_json::{Value, json};
use std::f64::consts::PI;

const ID: &str = "sandgait/LeggedVelocity-v1";

/// A robot on two legs, each with two links of `link` [m], whose joints have a torque limit of 1000 N·m and this damping [N·m·s/rad].
fn biped(link: f64, damping: f64) -> Import {
    let text = quadruped([-2.6, -0.6], false)
        .replace("0 0 -0.2", &format!("0 0 {}", -link))
        .replace("<limit", &format!(r#"<dynamics damping="{damping}"/><limit"#));
    // Without the rear legs.
    let import =
        read(&(text.split("<link name=\"rl_thigh\">").next().unwrap().to_owned() + "</robot>"), "urdf").unwrap();
    assert_eq!(import.stance.legs.len(), 2);
    import
}

/// `sandgait train` gives two legs commands along one axis, speeds that servos reach, a clock with a reward for steps in time and shaped
/// tracking terms, and if they are long a reward for steps in turns, unless the options are given or the training goes on without them;
/// four legs get none.
#[test]
fn bipeds_have_options_that_suit_them() {
    let suited = |robot: &Import, given: Value, kept: Value| {
        let mut options = given;
        options["robot"] = json!(pack(robot));
        let said = suit(&mut options, &kept).unwrap().notes().concat();
        let number = |at: &str| options.pointer(at).and_then(Value::as_f64);
        let steps = ["/rewards/contact", "/rewards/turning_air_time"].map(number);
        (number("/gait_clock"), steps, number("/commands/single_axis"), said)
    };
    let (two, tall, four) = (biped(0.1, 0.0), biped(0.2, 0.0), read(&quadruped([-2.6, -0.6], false), "urdf").unwrap());
    let strides = 0.33 * (9.81 / two.stance.leg_length).sqrt();
    let (clock, steps, share, said) = suited(&two, json!({}), Value::Null);
    assert!((clock.unwrap() / strides - 1.0).abs() < 0.03, "{clock:?}");
    assert_eq!((steps, share), ([Some(0.18), None], Some(0.5)));
    assert!(["two legs", "gait_clock", "contact", "single_axis"].iter().all(|word| said.contains(word)), "{said}");
    let own = json!({
        "gait_clock": 2.0, "rewards": {"contact": 0.1}, "commands": {"single_axis": 0.25}, "tracking_shaping": false
    });
    let given = (Some(2.0), [Some(0.1), None], Some(0.25), String::new());
    assert_eq!(suited(&two, own.clone(), Value::Null), given);
    assert_eq!(suited(&two, json!({}), own), given);
    let none = (None, [None; 2], None, String::new());
    assert_eq!(suited(&two, json!({}), json!({"ground": "rigid"})), none);
    assert_eq!(suited(&four, json!({}), Value::Null), none);
    let mut shaped = json!({"robot": pack(&two)});
    suit(&mut shaped, &Value::Null).unwrap();
    assert_eq!(shaped["tracking_shaping"], json!(true));
    let (clock, steps, ..) = suited(&tall, json!({}), Value::Null);
    let strides = 0.33 * (9.81 / tall.stance.leg_length).sqrt();
    assert!((clock.unwrap() / strides - 1.0).abs() < 0.03 && strides < 1.75, "{clock:?} {strides}");
    assert_eq!(steps, [Some(0.18), Some(0.23)]);
    // Servos that turn with at most 5 rad/s.
    let slow = biped(0.2, 200.0);
    let slowed = suited(&slow, json!({}), Value::Null).3;
    assert!(!said.contains("max_velocity") && slowed.contains("max_velocity"), "{said}; {slowed}");
    let mut options = json!({"robot": pack(&slow)});
    suit(&mut options, &Value::Null).unwrap();
    let most = 0.5 * 5.0 * slow.stance.leg_length / (1.5 * PI / 2.0);
    assert!((options["max_velocity"][0].as_f64().unwrap() / most - 1.0).abs() < 0.05, "{options} {most}");
    // A joint that its friction holds.
    let mut options = json!({"robot": pack(&biped(0.2, 1e6))});
    suit(&mut options, &Value::Null).unwrap();
    let least = sandgait::env::legged::prior::LEAST * 0.5 * (9.81 * slow.stance.leg_length).sqrt();
    assert!((options["max_velocity"][0].as_f64().unwrap() / least - 1.0).abs() < 0.05, "{options} {least}");
}

/// A robot on two legs ends its episode when its base is low; on hard ground also when a trunk on top of it touches.
#[test]
fn bipeds_fall() {
    let import = biped(0.2, 0.0);
    for ground in ["rigid", "poppy-close"] {
        let options = json!({"robot": pack(&import), "ground": ground, "domain_rand": null});
        let blueprint = Blueprint::new(ID, options).unwrap();
        let mut shard = shard_of(&blueprint);
        let ended = (0..300).any(|_| {
            shard.step(&vec![0.0; shard.actions()]);
            !shard.rows.ended.is_empty() && shard.rows.terminated[0] == 1
        });
        assert!(ended, "two balls cannot balance: {ground}");
    }
}

/// They learn for longer, unless the time is given.
#[test]
fn bipeds_learn_for_a_time_of_their_own() {
    let trained = |robot: &Import, ends: &[&str]| {
        let small = ["n_envs=8", "n_steps=16", "batch_size=64", "n_timesteps=1e9"];
        let changes = small.iter().chain(ends).map(|text| entry::pair("--set", text).unwrap()).collect();
        let folder = tempfile::tempdir().unwrap();
        let options = json!({"robot": pack(robot), "ground": "rigid"});
        let request = legged_training::request(options, &folder.path().join("run"), changes);
        request.run(&sandgait::progress::Silent).unwrap().learnt.seconds
    };
    // The other time would not end.
    let two = biped(0.2, 0.0);
    assert!((0.3..5.0).contains(&trained(&two, &["biped_seconds=0.3"])));
    let four = read(&quadruped([-2.6, -0.6], false), "urdf").unwrap();
    assert!((0.05..5.0).contains(&trained(&four, &["seconds=0.05", "biped_seconds=1e6"])));
    let own = entry::settings(None, ID, Vec::new()).unwrap();
    assert_eq!((own.seconds, own.biped_seconds), (Some(900.0), Some(1200.0)));
    for ends in [entry::ends(None, Some(60.0)), entry::ends(Some(100), None)] {
        assert_eq!(entry::settings(None, ID, ends.unwrap()).unwrap().biped_seconds, None);
    }
}
