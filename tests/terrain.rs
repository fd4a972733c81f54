//! The task HexapodTerrain: random draws have effects, the ground changes and keeps footprints, and difficulty 0 is
//! HexapodGait.

use sandgait::env::Shard;
use sandgait::env::registry::Blueprint;
use serde_json::{Value, json};

const ID: &str = "sandgait/HexapodTerrain-v1";

/// Shards of `envs` environments, reset with seeds 0, 1, …
fn shard(id: &str, options: Value, envs: usize) -> (Shard, Blueprint) {
    let blueprint = Blueprint::new(id, options).unwrap();
    let mut shard = Shard::new(&blueprint, envs).unwrap();
    shard.reset(|_| true, Some(&(0..envs as u64).collect::<Vec<_>>()), |_| None);
    (shard, blueprint)
}

/// One info column of every environment.
fn info(shard: &Shard, blueprint: &Blueprint, name: &str) -> Vec<f64> {
    let columns = &blueprint.task.spec().info;
    let index = columns.iter().position(|c| c.name == name).unwrap();
    shard.rows.infos.chunks_exact(columns.len()).map(|row| f64::from(row[index])).collect()
}

fn walk(shard: &mut Shard) {
    let actions = vec![0.4; 6 * shard.envs()];
    shard.step(&actions);
}

/// At difficulty 0, rows equal those of HexapodGait bit for bit, as long as no robot reverses its direction.
#[test]
fn difficulty_0_is_the_plain_task() {
    let near = json!({"difficulty": 0.0, "randomize": {"turning_point": [100.0, 100.0]}});
    for engine in ["lanes", "rapier"] {
        let mut options = near.clone();
        options["engine"] = engine.into();
        let (mut terrain, _) = shard(ID, options, 3);
        let (mut gait, _) = shard("sandgait/HexapodGait-v1", json!({"engine": engine}), 3);
        for _ in 0..40 {
            walk(&mut terrain);
            walk(&mut gait);
            assert_eq!(terrain.rows.rewards, gait.rows.rewards, "{engine}");
            assert_eq!(terrain.rows.observations, gait.rows.observations, "{engine}");
        }
    }
}

/// Every quantity is drawn within its range and all over it, for each episode anew, and the range shrinks with the
/// difficulty.
#[test]
fn quantities_are_drawn_within_their_ranges() {
    for (difficulty, slope) in [(1.0_f64, 10.0_f64), (0.3, 3.0)] {
        let (mut shard, blueprint) = shard(ID, json!({"difficulty": difficulty}), 200);
        walk(&mut shard);
        let column = |name: &str| info(&shard, &blueprint, name);
        for (name, low, high) in [
            ("slope_deg", -slope, slope),
            ("payload", 0.0, 0.05 * difficulty),
            ("zeta", 1.0 - 0.55 * difficulty, 1.0 + difficulty),
            ("torque_limit", 0.05 * (1.0 - 0.6 * difficulty), 0.05),
            ("footprint", 0.0, 0.5 * difficulty),
            ("turning_point", 0.3, 1.2),
            ("patch_length", 0.15, 0.6),
        ] {
            let values = column(name);
            let (least, most) = values.iter().fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(*x), b.max(*x)));
            let room = 1e-6 * (1.0 + high.abs());
            assert!(least >= low - room && most <= high + room, "{name}: {least} {most}");
            assert!(most - least > 0.9 * (high - low), "{name} is not spread over its range: {least} {most}");
        }
        assert!(column("difficulty").iter().all(|d| (d - difficulty).abs() < 1e-6));
        // The payload changes the motion, not only the log.
        let weights = column("weight");
        for (weight, payload) in weights.iter().zip(column("payload")) {
            assert!((weight - (0.15 + payload) * 9.80665).abs() < 1e-5, "{weight} {payload}");
        }
    }
}

/// Robots cross patches, come back, and find weaker ground in their footprints. Without footprints the ground stays
/// fresh.
#[test]
fn ground_has_patches_and_footprints() {
    for engine in ["lanes", "rapier"] {
        let run = |kappa: f64| {
            let ranges = json!({
                "patch_length": [0.15, 0.15], "footprint": [kappa, kappa], "turning_point": [0.2, 0.2],
                "slope_deg": [0.0, 0.0], "zeta": [0.6, 1.5], "torque_limit": [1.0, 1.0]
            });
            let options = json!({"randomize": ranges, "engine": engine, "command": [0.3, 0.3]});
            let (mut shard, blueprint) = shard(ID, options, 1);
            let (mut zetas, mut footings, mut commands, mut speeds) = (vec![], vec![], vec![1.0], vec![]);
            for _ in 0..90 {
                let action = if commands[commands.len() - 1] > 0.0 { 0.4 } else { -0.4 };
                shard.step(&[action; 6]);
                let one = |name: &str| info(&shard, &blueprint, name)[0];
                zetas.push(one("zeta").to_bits());
                footings.push(one("footing"));
                commands.push(one("commanded_speed"));
                speeds.push(one("speed"));
            }
            zetas.sort_unstable();
            zetas.dedup();
            (zetas.len(), footings, commands, speeds)
        };
        let (patches, footings, commands, speeds) = run(0.5);
        assert!(patches > 1, "{engine}: the sand never changed");
        assert!(commands.iter().any(|c| *c < 0.0), "{engine}: the robot was never sent back");
        let least = footings.iter().copied().fold(1.0, f64::min);
        assert!((0.5..0.9).contains(&least), "{engine}: {least}");
        let (_, fresh, _, others) = run(0.0);
        assert!(fresh.iter().all(|f| *f == 1.0), "{engine}");
        assert_ne!(speeds, others, "{engine}: weaker ground is not felt");
    }
}

/// The command reverses only after progress in the commanded direction. A robot that moves the wrong way keeps its
/// command.
#[test]
fn robots_that_move_the_wrong_way_keep_their_command() {
    for sign in [1.0, -1.0] {
        let ranges = json!({
            "turning_point": [0.3, 0.3], "slope_deg": [0.0, 0.0], "torque_limit": [1.0, 1.0], "footprint": [0.0, 0.0],
            "zeta": [1.0, 1.0]
        });
        let command = 0.3 * sign;
        let options = json!({"randomize": ranges, "slope_deg": 15.0 * sign, "command": [command, command]});
        let (mut shard, blueprint) = shard(ID, options, 1);
        // First the robot walks downhill, against its command, then it follows the command.
        while sign * shard.state(0).position[0] > -0.35 {
            shard.step(&[-0.4 * sign as f32; 6]);
            assert!((info(&shard, &blueprint, "commanded_speed")[0] - command).abs() < 1e-6, "sign {sign}");
        }
        shard.step(&[0.4 * sign as f32; 6]);
        assert!((info(&shard, &blueprint, "commanded_speed")[0] - command).abs() < 1e-6, "sign {sign}");
    }
}

/// A command to walk backward reverses behind the start, and again at the start.
#[test]
fn backward_commands_turn_round_too() {
    let ranges = json!({
        "turning_point": [0.2, 0.2], "slope_deg": [0.0, 0.0], "torque_limit": [1.0, 1.0], "footprint": [0.0, 0.0]
    });
    let (mut shard, blueprint) = shard(ID, json!({"randomize": ranges, "command": [-0.3, -0.3]}), 1);
    let (mut sense, mut turns) = (-1.0, Vec::new());
    for _ in 0..300 {
        shard.step(&[0.4 * sense as f32; 6]);
        // The command of the last step; if it reversed, then at the beginning of the step.
        let now = info(&shard, &blueprint, "commanded_speed")[0].signum();
        if now != sense {
            turns.push(shard.state(0).position[0]);
            sense = now;
        }
    }
    assert!(turns.len() >= 2, "{turns:?}");
    assert!((turns[0] + 0.2).abs() < 0.05 && turns[1].abs() < 0.05, "{turns:?}");
}

/// Draws at the ends of the allowed ranges have effects, too.
#[test]
fn extreme_draws_are_in_force() {
    let ranges = json!({"slope_deg": [-70.0, -70.0], "payload": [10.0, 10.0], "torque_limit": [0.01, 0.01]});
    let options = json!({"randomize": ranges, "slope_deg": 35.0, "payload": 990.0, "torque_limit": 1e-4});
    let (mut shard, blueprint) = shard(ID, options, 1);
    walk(&mut shard);
    let column = |name: &str| info(&shard, &blueprint, name)[0];
    assert!((column("slope_deg") + 35.0).abs() < 1e-4 && (column("payload") - 1000.0).abs() < 1e-3);
    assert!((column("torque_limit") - 1e-6).abs() < 1e-12);
}

#[test]
fn wrong_ranges_are_refused_in_one_line() {
    let refused = |options: Value| Blueprint::new(ID, options).err().unwrap().to_string();
    for (options, said) in [
        (json!({"randomize": {"zeta": [0.0, 1.0]}}), "randomize.zeta[0]: 0 is outside [0.1, 10]"),
        (json!({"randomize": {"payload": [0.2, 0.1]}}), "randomize.payload[1]: 0.1 is outside [0.2, 10]"),
        (json!({"slope_deg": 30}), "randomize.slope_deg[1]: 10 is outside [-10, 5]"),
        (json!({"payload": 1000}), "randomize.payload[1]: 0.05 is outside [0, 0] (it is added to payload = 1000)"),
        (json!({"payload": 1001}), "payload: 1001 is outside [0, 1000]"),
        (json!({"randomize": {"mud": [0, 1]}}), "randomize: key \"mud\" is unknown; known: "),
        (json!({"randomize": null}), "randomize: null"),
        (json!({"difficulty": 1.5}), "difficulty: 1.5 is outside [0, 1]"),
    ] {
        let error = refused(options);
        assert!(error.starts_with(said), "{error}, not {said}");
    }
    let gait = Blueprint::new("sandgait/HexapodGait-v1", json!({"difficulty": 0.5})).err().unwrap().to_string();
    assert!(gait.starts_with("difficulty: sandgait/HexapodGait-v1 has no such option"), "{gait}");
}
