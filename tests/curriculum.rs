//! The curriculum of LeggedVelocity, and the units from the robot's size.

use sandgait::env::Shard;
use sandgait::env::episode::Episode;
use sandgait::env::legged::Units;
use sandgait::env::registry::Blueprint;
use sandgait::sim::model::GRAVITY;
use sandgait::sim::tree::kinematics::{frames, lowest};
use serde_json::{Value, json};

const ID: &str = "sandgait/LeggedVelocity-v1";

fn blueprint(options: Value) -> Blueprint {
    Blueprint::new(ID, options).unwrap()
}

fn shard(blueprint: &Blueprint, seeds: &[u64]) -> Shard {
    let mut shard = Shard::new(blueprint, seeds.len()).unwrap();
    shard.reset(|_| true, Some(seeds), |_| None);
    shard
}

/// The level of environment `i` in its last step.
fn level(blueprint: &Blueprint, shard: &Shard, i: usize) -> f32 {
    let info = &blueprint.task.spec().info;
    shard.rows.infos[i * info.len() + info.iter().position(|c| c.name == "level").unwrap()]
}

/// Levels in the middle of consecutive episodes of one environment whose action is always `action`.
fn levels(options: Value, action: f32, episodes: usize) -> Vec<f32> {
    let blueprint = blueprint(options);
    let mut shard = shard(&blueprint, &[7]);
    let actions = vec![action; shard.actions()];
    let (mut all, mut ended) = (Vec::new(), true);
    while all.len() < episodes {
        shard.step(&actions);
        if ended {
            all.push(level(&blueprint, &shard, 0));
        }
        ended = !shard.rows.ended.is_empty();
    }
    all
}

fn held(x: f64) -> Value {
    json!({"lin_vel_x": [x, x], "lin_vel_y": [0, 0], "ang_vel_yaw": [0, 0], "resampling_time": 2.0})
}

/// Short episodes on hard ground with one command.
fn short(x: f64, level: f64) -> Value {
    json!({"ground": "rigid", "commands": held(x), "max_episode_steps": 100, "angle_noise": 0.0,
        "domain_rand": null, "curriculum": {"level": level}})
}

/// A robot that stands when it should stand climbs to the end; one that stands when it should walk, or that falls, goes down to
/// the beginning.
#[test]
fn levels_follow_the_robot() {
    let near = |levels: &[f32], wanted: &[f32]| {
        assert!(levels.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-6), "{levels:?}, not {wanted:?}");
    };
    near(&levels(short(0.0, 0.75), 0.0, 5), &[0.75, 0.85, 0.95, 1.0, 1.0]);
    near(&levels(short(0.5, 0.25), 0.0, 5), &[0.25, 0.15, 0.05, 0.0, 0.0]);
    // Action 1 turns all joints far from the standing pose, and the robot falls on its base.
    near(&levels(short(0.0, 0.5), 1.0, 3), &[0.5, 0.4, 0.3]);
    let mut off = short(0.0, 0.5);
    off["curriculum"] = Value::Null;
    near(&levels(off, 0.0, 3), &[1.0, 1.0, 1.0]);
}

/// A seed begins a new series of episodes at the first level; a reset without a seed keeps the level.
#[test]
fn a_seed_begins_again() {
    let blueprint = blueprint(short(0.0, 0.5));
    let mut shard = shard(&blueprint, &[7]);
    let after = |shard: &mut Shard, steps: usize| {
        (0..steps).for_each(|_| shard.step(&[0.0; 12]));
        level(&blueprint, shard, 0)
    };
    assert!((after(&mut shard, 101) - 0.6).abs() < 1e-6);
    shard.reset(|_| true, None, |_| None);
    assert!((after(&mut shard, 1) - 0.6).abs() < 1e-6, "an unfinished episode changes nothing");
    shard.reset(|_| true, Some(&[7]), |_| None);
    assert!((after(&mut shard, 1) - 0.5).abs() < 1e-6);
}

fn wave(step: usize, seed: u64, joint: usize) -> f32 {
    0.5 * (0.37 * step as f32 + 1.3 * joint as f32 + seed as f32).sin()
}

/// Everything that an environment shows, for some short episodes; `from`: the step at which a snapshot is taken and restored into a
/// new shard.
fn history(blueprint: &Blueprint, seeds: &[u64], at: usize, from: Option<usize>) -> Vec<f32> {
    let mut shard = shard(blueprint, seeds);
    let mut all = Vec::new();
    for step in 0..130 {
        if from == Some(step) {
            let saved: Vec<_> = (0..seeds.len()).map(|i| shard.save(i)).collect();
            shard = Shard::new(blueprint, seeds.len()).unwrap();
            for (i, saved) in saved.iter().enumerate() {
                let text = serde_json::to_string(saved).unwrap();
                let saved = serde_json::from_str(&text).unwrap();
                shard.restore(i, &Episode::resume(&saved, &blueprint.task).unwrap());
            }
        }
        let actions: Vec<f32> = seeds.iter().flat_map(|s| (0..12).map(|j| wave(step, *s, j))).collect();
        shard.step(&actions);
        let row = |rows: &[f32]| rows[at * rows.len() / seeds.len()..(at + 1) * rows.len() / seeds.len()].to_vec();
        all.extend(row(&shard.rows.observations));
        all.extend(row(&shard.rows.infos));
    }
    all
}

/// An environment's results depend on no bit of its neighbours, nor on a snapshot in the middle of an episode.
#[test]
fn levels_have_the_same_bits_in_every_batch() {
    for ground in ["poppy-close", "any"] {
        let blueprint = blueprint(
            json!({"ground": ground, "max_episode_steps": 25, "curriculum": {"level": 0.3, "step": 0.07, "rise": 2.0, "fall": 3.0},
            "commands": {"resampling_time": 0.2}}),
        );
        let alone = history(&blueprint, &[5], 0, None);
        assert!(alone == history(&blueprint, &[3, 4, 5, 6, 9], 2, None), "{ground}");
        assert!(alone == history(&blueprint, &[5], 0, Some(63)), "{ground}");
        let (wide, info) = (blueprint.task.spec().observation.len(), &blueprint.task.spec().info);
        let level = wide + info.iter().position(|c| c.name == "level").unwrap();
        let mut levels: Vec<f32> = alone.chunks_exact(wide + info.len()).map(|row| row[level]).collect();
        levels.dedup();
        assert!(levels.len() > 3, "{ground}: {levels:?}");
    }
}

/// Mean depth of the feet of standing robot `i` in parts of its legs' length.
fn feet_depth(shard: &Shard, i: usize) -> f64 {
    let tree = shard.model(i).tree.as_ref().unwrap();
    let (frames, feet) = (frames(&tree.tree, shard.state(i)), &tree.stance.feet);
    let depth = |foot: &usize| -lowest(&frames[*foot], &tree.contacts[*foot]).z;
    feet.iter().map(depth).sum::<f64>() / feet.len() as f64 / tree.stance.leg_length
}

/// The depth of the feet 3 s after the start of an episode.
fn sunk(options: Value) -> f64 {
    let blueprint = blueprint(options);
    let mut shard = shard(&blueprint, &[1]);
    (0..150).for_each(|_| shard.step(&[0.0; 12]));
    feet_depth(&shard, 0)
}

/// On ground `any` about a fifth of the episodes have hard ground, the others sand of a hidden strength, and robots sink
/// less the stronger it is. In `info`, `sand` is then 0 or that strength.
#[test]
fn episodes_draw_any_ground() {
    let blueprint = blueprint(json!({"ground": "any", "angle_noise": 0.0, "domain_rand": null, "curriculum": null}));
    let seeds: Vec<u64> = (0..64).collect();
    let mut shard = shard(&blueprint, &seeds);
    (0..150).for_each(|_| shard.step(&[0.0; 12 * 64]));
    let info = &blueprint.task.spec().info;
    let sand = info.iter().position(|c| c.name == "sand").unwrap();
    let mut seen: Vec<_> =
        (0..64).map(|i| (f64::from(shard.rows.infos[i * info.len() + sand]), feet_depth(&shard, i))).collect();
    seen.sort_by(|a, b| a.0.total_cmp(&b.0));
    let hard = seen.iter().filter(|(sand, _)| *sand == 0.0).count();
    assert!((5..=22).contains(&hard), "{hard} of 64 on hard ground");
    for (_, depth) in &seen[..hard] {
        assert!(depth.abs() < 2e-3, "{depth} on hard ground");
    }
    let logs: Vec<f64> = seen[hard..].iter().map(|(sand, _)| sand.ln()).collect();
    assert!(logs.iter().all(|log| (0.0..=16_f64.ln()).contains(log)), "{logs:?}");
    // The mean of 50 uniform numbers differs from the middle by more than 0.15 of their range once in 4,000 times.
    let mean = logs.iter().sum::<f64>() / logs.len() as f64 / 16_f64.ln();
    assert!((0.35..0.65).contains(&mean), "{mean}");
    for pair in seen[hard..].windows(2) {
        assert!(pair[0].1 > pair[1].1 - 1e-4, "stronger sand, deeper feet: {pair:?}");
    }
}

/// At level 0 sand carries the robot like hard ground: the feet sink by some 2 % of the legs' length, and up to twice
/// as much because the robot is set down with a bump. At level 1 the feet sink as without a curriculum.
#[test]
fn the_first_level_is_firm() {
    let ground = json!({"ground": "poppy-loose", "angle_noise": 0.0, "domain_rand": null});
    let at = |curriculum: Value| {
        let mut options = ground.clone();
        options["curriculum"] = curriculum;
        sunk(options)
    };
    let [first, middle, last, none] =
        [json!({"level": 0.0}), json!({"level": 0.5}), json!({"level": 1.0}), Value::Null].map(at);
    assert!((0.01..0.04).contains(&first), "{first}");
    assert!(first < middle && middle < last, "{first} {middle} {last}");
    assert_eq!(last, none);
}

/// Commands and units follow from the legs' length: √(gℓ), √(g/ℓ).
#[test]
fn commands_suit_the_legs() {
    let blueprint = blueprint(json!({"commands": {"lin_vel_y": [-0.1, 0.2]}}));
    let model = blueprint.task.model();
    let (length, g) = (model.tree.as_ref().unwrap().stance.leg_length, GRAVITY);
    let units = Units::of(model);
    let near = |a: f64, b: f64| assert!((a / b - 1.0).abs() < 1e-9, "{a} {b}");
    near(units.speed * units.speed, g * length);
    near(units.rate * units.rate, g / length);
    near(units.torque, model.total_mass() * g * length);
    let [x, y, yaw] = blueprint.task.command_ranges().unwrap();
    near(x[1], 0.5 * units.speed);
    near(yaw[0], -0.2 * units.rate);
    assert_eq!(y, [-0.1, 0.2]);
}

/// A command that is set holds for the rest of the episode, and the observation shows it at once.
#[test]
fn commands_can_be_set() {
    let blueprint = blueprint(json!({"ground": "rigid", "commands": {"resampling_time": 0.1}}));
    let mut shard = shard(&blueprint, &[1]);
    shard.set_command(0, [0.5, -0.25, 0.125]);
    for _ in 0..20 {
        assert_eq!(shard.rows.observations[9..12], [0.5, -0.25, 0.125]);
        shard.step(&[0.0; 12]);
    }
    let refusal = |task: &str, command| {
        let blueprint = Blueprint::new(task, Value::Null).unwrap();
        blueprint.task.check_command("command", command).map_err(|error| error.to_string())
    };
    let legged = "sandgait/LeggedVelocity-v1";
    assert_eq!(refusal(legged, [0.5, -0.25, 0.125]), Ok(()));
    assert!(refusal(legged, [9.0, 0.0, 0.0]).unwrap_err().starts_with("command: "));
    assert!(refusal(legged, [f64::NAN, 0.0, 0.0]).unwrap_err().starts_with("command: "));
    assert!(refusal("sandgait/LegStroke-v0", [0.0; 3]).unwrap_err().contains("has no commands"));
    assert_eq!(refusal("sandgait/HexapodGait-v1", [0.5, 0.0, 0.125]), Ok(()));
    assert!(refusal("sandgait/HexapodGait-v1", [0.5, 0.1, 0.0]).unwrap_err().contains("to the left"));
}
