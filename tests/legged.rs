//! The task LeggedVelocity: robots stand, rewards equal those of legged_gym, random draws have effects, and robots come
//! from files.

use sandgait::env::legged::Units;
use sandgait::env::registry::Blueprint;
use sandgait::env::shard::Shard;
use sandgait::evaluate::commands::CommandStudy;
use sandgait::evaluate::{Evaluation, EvaluationRequest, PolicySource};
use sandgait::policy::write::OnnxWriter;
use sandgait::progress::Silent;
use sandgait::robots::{self, Reading};
use sandgait::sim::tree::{packed, plates::of_touching};
use serde_json::{Value, json};
use std::path::Path;

const ID: &str = "sandgait/LeggedVelocity-v1";

fn blueprint(options: Value) -> Blueprint {
    Blueprint::new(ID, options).unwrap()
}

fn shard(options: Value, envs: usize) -> Shard {
    let mut shard = Shard::new(&blueprint(options), envs).unwrap();
    let seeds: Vec<u64> = (0..envs as u64).collect();
    shard.reset(|_| true, Some(&seeds), |_| None);
    shard
}

fn column(blueprint: &Blueprint, name: &str) -> usize {
    blueprint.task.spec().info.iter().position(|c| c.name == name).unwrap()
}

/// Our own robot from its file, packed.
fn sandcat(file: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("robots").join(file);
    packed_text(&robots::load(&path).unwrap())
}

fn packed_text(import: &robots::Import) -> String {
    let touching = import.touching(None).unwrap();
    let plates = of_touching(&import.tree, &touching, None).unwrap();
    packed::pack(&import.tree, &plates, import.looks().unwrap().as_ref()).unwrap()
}

/// `src/env/options/sandcat.json` is what `sandgait robot sandcat=robots/sandcat.urdf --pack --json` prints.
#[test]
fn the_built_in_robot_equals_its_file() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/env/options/sandcat.json");
    let import = robots::named::NamedRobot::of("sandcat").unwrap().unwrap();
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("robots/sandcat.urdf");
    let import = import.load(&file, &Reading::default()).unwrap();
    let (own, packed) = (std::fs::read_to_string(path).unwrap(), packed_text(&import));
    assert!(own.trim() == packed, "pack the file again");
}

/// On a slope the observed gravity is gravity, and not the sand's normal: it agrees with the accelerometer of a robot at
/// rest.
#[test]
fn gravity_is_observed_on_a_slope() {
    let options = json!({
        "ground": "rigid", "slope_deg": 10, "curriculum": null, "domain_rand": null,
        "sensors": {"accelerometer": {}},
    });
    let blueprint = blueprint(options.clone());
    let place = |name: &str| blueprint.task.spec().observation.iter().position(|c| c.name == name).unwrap();
    let (gravity, accelerometer) = (place("projected_gravity x"), place("specific force, body frame, x"));
    let mut shard = shard(options, 1);
    let still = vec![0.0; shard.actions()];
    (0..100).for_each(|_| shard.step(&still));
    let read = |first: usize| [0, 1, 2].map(|k| f64::from(shard.rows.observations[first + k]));
    let (seen, felt) = (read(gravity), read(accelerometer));
    let norm = felt.iter().map(|a| a * a).sum::<f64>().sqrt();
    for (seen, felt) in seen.iter().zip(felt) {
        assert!((seen + felt / norm).abs() < 0.01, "{seen} {felt}");
    }
    let normal = shard.state(0).to_body([0.0, 0.0, -1.0]);
    assert!((seen[0] - normal[0]).abs() > 0.1, "the robot stands on a slope: {seen:?} {normal:?}");
}

/// Without pushes and with zero actions, a robot stands for 10 s on every ground. So does the same robot from its URDF,
/// for which a standing pose is computed, and from its MJCF, which states one.
#[test]
fn robots_stand() {
    for file in ["sandcat.urdf", "sandcat.xml"] {
        let robot = packed::compressed(&sandcat(file), 1).unwrap();
        for ground in ["rigid", "poppy-close", "mixed"] {
            let options = json!({"robot": robot, "ground": ground, "domain_rand": null, "curriculum": null});
            let mut shard = shard(options, 2);
            let actions = vec![0.0; 2 * shard.actions()];
            for _ in 0..500 {
                shard.step(&actions);
                assert!(shard.rows.ended.is_empty(), "{file} {ground}");
            }
            let state = shard.state(1);
            assert!(state.rotation()[2][2] > 0.97, "{file} {ground}: {state:?}");
            assert!(state.velocity.iter().all(|v| v.abs() < 1e-3), "{file} {ground}: {state:?}");
        }
    }
}

/// A robot at rest with a command of zero gets the full tracking terms: for each its weight times 0.02 s. Torques count in units of
/// weight times leg length.
#[test]
fn rewards_are_those_of_legged_gym() {
    let still = json!({"lin_vel_x": [0, 0], "lin_vel_y": [0, 0], "ang_vel_yaw": [0, 0]});
    let options = json!({"ground": "rigid", "commands": still, "domain_rand": null});
    let blueprint = blueprint(options.clone());
    let mut shard = shard(options, 1);
    (0..200).for_each(|_| shard.step(&[0.0; 12]));
    let info = |name: &str| shard.rows.infos[column(&blueprint, name)];
    assert!((info("reward_tracking_lin_vel") - 0.02).abs() < 1e-5);
    assert!((info("reward_tracking_ang_vel") - 0.01).abs() < 1e-5);
    assert_eq!((info("feet_in_contact"), info("reward_collision"), info("reward_feet_air_time")), (4.0, 0.0, 0.0));
    let unit = Units::of(blueprint.task.model()).torque;
    let torques: f64 = shard.state(0).torques.iter().map(|t| (t / unit).powi(2)).sum();
    assert!((f64::from(info("reward_torques")) + 0.02 * 0.3 * torques).abs() < 1e-9 && torques > 1e-3);
    assert!((shard.rows.rewards[0] - shard.rows.infos[..13].iter().sum::<f32>()).abs() < 1e-6);
}

/// Pushes, new commands, and the quantities drawn for each episode have an effect.
#[test]
fn random_draws_have_effects() {
    let rand = json!({"push_interval": 1.0, "max_push_vel_xy": 1.0, "added_mass_range": [0.1, 0.2]});
    let commands = json!({"resampling_time": 1.0});
    let options = json!({"ground": "rigid", "domain_rand": rand, "commands": commands, "curriculum": null});
    let blueprint = blueprint(options.clone());
    let mut shard = shard(options, 4);
    let (command, mass) = (column(&blueprint, "command_ang_vel_yaw"), column(&blueprint, "added_mass"));
    let width = blueprint.task.spec().info.len();
    let (mut commands, mut fastest) = (Vec::new(), 0.0_f64);
    for _ in 0..120 {
        shard.step(&[0.0; 48]);
        commands.push(shard.rows.infos[command]);
        fastest = fastest.max(shard.state(0).velocity[0].abs());
    }
    commands.dedup();
    assert!(commands.len() >= 3, "{commands:?}");
    assert!(fastest > 0.1, "{fastest}");
    let masses: Vec<f32> = (0..4).map(|i| shard.rows.infos[i * width + mass]).collect();
    assert!(masses.iter().all(|m| (1.1..2.3).contains(m)) && masses[0] != masses[1], "{masses:?}");
}

/// The given share of commands is along one axis, each axis as often.
#[test]
fn some_commands_are_along_one_axis() {
    let options = json!({"commands": {"single_axis": 0.6}, "curriculum": null, "domain_rand": null});
    let blueprint = blueprint(options.clone());
    let columns =
        ["command_lin_vel_x", "command_lin_vel_y", "command_ang_vel_yaw"].map(|name| column(&blueprint, name));
    let width = blueprint.task.spec().info.len();
    let count = 600;
    let mut shard = shard(options, count);
    shard.step(&vec![0.0; count * shard.actions()]);
    let mut alone = [0_usize; 3];
    for row in shard.rows.infos.chunks(width) {
        let moves = columns.map(|c| row[c] != 0.0);
        if moves.iter().filter(|moves| **moves).count() == 1 {
            alone[moves.iter().position(|moves| *moves).unwrap()] += 1;
        }
    }
    // Speeds near 0 are 0: commands along the ground become commands to stand, and of the others some to turn only. Bounds
    // are four standard deviations and these.
    let expected = 0.2 * count as f64;
    assert!(alone[..2].iter().all(|n| (0.5 * expected..1.4 * expected).contains(&(*n as f64))), "{alone:?}");
    assert!((0.7 * expected..1.6 * expected).contains(&(alone[2] as f64)), "{alone:?}");
}

/// A robot that stands bears on all feet: each is in time with the clock for 55 % of a stride, and neighbours alternate.
#[test]
fn feet_are_rewarded_for_bearing_in_time() {
    let options = json!({
        "gait_clock": 1.0, "rewards": {"contact": 1.0}, "curriculum": null, "domain_rand": null, "ground": "rigid"
    });
    let place = column(&blueprint(options.clone()), "reward_contact");
    let mut shard = shard(options, 1);
    shard.set_command(0, [0.3, 0.0, 0.0]);
    let mut in_time = |steps: usize| -> Vec<f32> {
        (0..steps)
            .map(|_| {
                shard.step(&[0.0; 12]);
                shard.rows.infos[place] * 50.0
            })
            .collect()
    };
    in_time(50);
    let stride = in_time(50);
    assert!(stride.iter().all(|feet| [2.0, 4.0].iter().any(|n| (feet - n).abs() < 1e-5)), "{stride:?}");
    assert!((stride.iter().sum::<f32>() / 50.0 - 4.0 * 0.55).abs() < 0.05, "{stride:?}");
    shard.set_command(0, [0.0; 3]);
    shard.step(&[0.0; 12]);
    assert_eq!(shard.rows.infos[place], 0.0);
}

/// Steps of a turn on the spot are rewarded by a term of their own, all others by `feet_air_time`.
#[test]
fn steps_of_turns_have_a_term() {
    let both = json!({"feet_air_time": 1.0, "turning_air_time": 1.0});
    let options = json!({"rewards": both, "curriculum": null, "domain_rand": null, "ground": "rigid"});
    let places = ["reward_feet_air_time", "reward_turning_air_time"].map(|c| column(&blueprint(options.clone()), c));
    let mut shard = shard(options, 1);
    let mut rewarded = |command: [f64; 3]| {
        shard.reset(|_| true, Some(&[0]), |_| None);
        shard.set_command(0, command);
        let mut seen = [false; 2];
        for k in 0..100 {
            shard.step(&[(0.8 * f64::from(k).sin()) as f32; 12]);
            for (seen, place) in seen.iter_mut().zip(places) {
                *seen |= shard.rows.infos[place] != 0.0;
            }
        }
        seen
    };
    assert_eq!(rewarded([0.3, 0.0, 0.0]), [true, false]);
    assert_eq!(rewarded([0.3, 0.0, 0.5]), [true, false]);
    assert_eq!(rewarded([0.0, 0.0, 0.5]), [false, true]);
    assert_eq!(rewarded([0.0; 3]), [false; 2]);
}

#[test]
fn broken_robots_and_options_are_refused_in_one_line() {
    let refused = |options: Value| {
        let error = Blueprint::new(ID, options).err().unwrap().to_string();
        assert!(!error.contains('\n') && error.len() < 400, "{error}");
        error
    };
    assert!(refused(json!({"robot": "xplorer"})).contains("robot"));
    assert!(refused(json!({"robot": "../../etc/passwd"})).contains("robot"));
    assert!(refused(json!({"robot": "tree:!!"})).contains("not a packed robot"));
    assert!(refused(json!({"robot": "tree:AAAA"})).contains("not a packed robot"));
    assert!(refused(json!({"ground": "lava"})).contains("rigid"));
    assert!(refused(json!({"leg": "C"})).contains("no such option"));
    assert!(refused(json!({"engine": "lanes"})).contains("no such option"));
    assert!(refused(json!({"commands": {"lin_vel_x": [2, 1]}})).contains("lin_vel_x"));
    assert!(refused(json!({"domain_rand": {"sand_range": [0, 1]}})).contains("sand_range"));
    let good = sandcat("sandcat.urdf");
    let with = |change: &dyn Fn(&mut Value)| {
        let mut json: Value = serde_json::from_str(&good).unwrap();
        change(&mut json);
        refused(json!({"robot": packed::compressed(&json.to_string(), 1).unwrap()}))
    };
    assert!(with(&|r| r["bodies"][3]["parent"] = json!(7)).contains("depth-first"));
    assert!(with(&|r| r["bodies"][3]["parent"] = json!(3)).contains("depth-first"));
    assert!(with(&|r| r["bodies"][2]["mass"] = json!(-1.0)).contains("mass"));
    assert!(with(&|r| r["bodies"][2]["mass"] = json!(1e300)).contains("mass"));
    assert!(with(&|r| r["bodies"][2]["joint"] = Value::Null).contains("depth-first"));
    assert!(with(&|r| r["bodies"][2]["joint"]["axis"] = json!([0, 0, 0])).contains("axis"));
    assert!(with(&|r| r["bodies"][2]["joint"]["range"] = json!([1, 0])).contains("range"));
    assert!(with(&|r| r["bodies"] = json!([])).contains("number of bodies"));
    assert!(with(&|r| r["bodies"][0]["plates"][0][6] = json!(1e300)).contains("trunk"));
    // Shapes for pictures are a client's numbers too.
    let faces = |n: usize| json!({"corners": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "faces": vec![[0, 1, 2]; n]});
    let look = |body: usize, form: Value| json!({"body": body, "at": [0, 0, 0, 1, 0, 0, 0], "form": form});
    let looks = |meshes: Value, shapes: Value| with(&|r| r["looks"] = json!({"meshes": meshes, "shapes": shapes}));
    assert!(looks(json!([{"corners": [[0, 0, 0]], "faces": [[0, 0, 1]]}]), json!([])).contains("corner 1"));
    assert!(looks(json!([{"corners": [[0, 0, 1e9]], "faces": []}]), json!([])).contains("corner in looks"));
    assert!(looks(json!([]), json!([look(0, json!({"mesh": 0}))])).contains("mesh 0"));
    assert!(looks(json!([]), json!([look(13, json!({"sphere": {"radius": 1}}))])).contains("body 13"));
    assert!(looks(json!([]), json!([look(0, json!({"sphere": {"radius": -1}}))])).contains("size"));
    assert!(looks(json!([]), json!([look(0, json!({"ball": {"radius": 1}}))])).contains("ball"));
    assert!(looks(json!([faces(30_000)]), json!(vec![look(0, json!({"mesh": 0})); 40])).contains("triangles"));
    assert!(looks(json!([]), json!(vec![look(0, json!({"sphere": {"radius": 1}})); 2001])).contains("triangles"));
    let shape =
        json!({"name": "", "origin": [0, 0, 0, 1, 0, 0, 0], "kind": "sphere", "size": [1, 0, 0], "friction": 1});
    assert!(with(&|r| r["bodies"][0]["shapes"] = json!(vec![shape.clone(); 2001])).contains("triangles"));
}

/// A visual mesh of 32,000 triangles is sent with a few thousand triangles, and the robot's motion does not depend on it.
#[test]
fn large_meshes_become_small_for_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let copy = folder.path().join("cat.urdf");
    let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("robots/sandcat.urdf")).unwrap();
    let sphere = r#"<sphere radius="0.022"/></geometry></visual>"#;
    assert!(text.contains(sphere));
    std::fs::write(&copy, text.replacen(sphere, r#"<mesh filename="ball.obj"/></geometry></visual>"#, 1)).unwrap();
    let (n, mut ball) = (160_usize, String::new());
    for k in 0..n * n {
        let (up, around) =
            (std::f64::consts::PI * (k / n) as f64 / (n - 1) as f64, std::f64::consts::TAU * (k % n) as f64 / n as f64);
        ball += &format!(
            "v {} {} {}\n",
            0.022 * up.sin() * around.cos(),
            0.022 * up.sin() * around.sin(),
            0.022 * up.cos()
        );
    }
    for (j, i) in (0..n * n - n).map(|k| (k / n, k % n)) {
        let [a, b] = [j * n + i + 1, j * n + (i + 1) % n + 1];
        ball += &format!("f {a} {} {b}\nf {} {} {b}\n", a + n, a + n, b + n);
    }
    std::fs::write(folder.path().join("ball.obj"), ball).unwrap();
    let import = robots::load(&copy).unwrap();
    let looks = import.looks().unwrap().unwrap();
    let [mesh] = &looks.meshes[..] else { panic!("{}", looks.meshes.len()) };
    assert!((1000..=4000).contains(&mesh.faces.len()), "{}", mesh.faces.len());
    assert!(mesh.corners.iter().all(|c| (c.iter().map(|x| x * x).sum::<f64>().sqrt() / 0.022 - 1.0).abs() < 0.03));
    let plates = of_touching(&import.tree, &import.touching(None).unwrap(), Some(0.02)).unwrap();
    let text = |looks| packed::compressed(&packed::pack(&import.tree, &plates, looks).unwrap(), 1).unwrap();
    let run = |robot: String| {
        let mut shard = shard(json!({"robot": robot}), 1);
        let actions = vec![0.5; shard.actions()];
        (0..20).for_each(|_| shard.step(&actions));
        shard.state(0).clone()
    };
    let (with, without) = (text(Some(&looks)), text(None));
    assert!(with.len() < without.len() + 60_000, "{} {}", with.len(), without.len());
    assert_eq!(run(with), run(without));
}

/// Each session has its own time step. Steps outside of the bounds, and those that do not divide the control step, are
/// refused. On hard ground and in sand the motion comes closer to that of the finest step, the smaller the step is.
#[test]
fn a_robot_has_its_own_time_step() {
    for (dt, said) in [(6e-3, "outside"), (0.0, "outside"), (-1e-3, "outside"), (1e-7, "outside"), (3e-3, "divide")] {
        let error = Blueprint::new(ID, json!({"dt": dt})).err().unwrap().to_string();
        assert!(error.starts_with("dt: ") && error.contains(said) && !error.contains('\n'), "{error}");
    }
    for ground in ["rigid", "poppy-loose"] {
        let heights = |dt: f64| -> Vec<f64> {
            let options =
                json!({"ground": ground, "dt": dt, "domain_rand": null, "angle_noise": 0.0, "curriculum": null});
            assert_eq!(blueprint(options.clone()).task.model().scene.dt, dt);
            let mut shard = shard(options, 1);
            let bob = |k: u32| (0.2 * (std::f64::consts::TAU * 2.0 * f64::from(k) / 50.0).sin()) as f32;
            let mut height = |k| {
                shard.step(&vec![bob(k); shard.actions()]);
                assert!(shard.rows.ended.is_empty(), "{ground} {dt}");
                shard.state(0).position[2]
            };
            (0..100).map(&mut height).collect()
        };
        let finest = heights(2.5e-4);
        let off = |dt: f64| heights(dt).iter().zip(&finest).map(|(a, b)| (a - b).abs()).sum::<f64>() / 100.0;
        let [coarse, usual, fine] = [5e-3, 2e-3, 1e-3].map(off);
        assert!(coarse > usual && usual > fine && fine < 1e-3, "{ground}: {coarse} {usual} {fine}");
    }
}

/// Legs that large random actions drive into each other and into the base leave every state sound, and move otherwise than legs
/// that pass through each other.
#[test]
fn legs_that_meet_stay_sound() {
    for ground in ["rigid", "poppy-loose"] {
        let run = |self_contact: bool| {
            let options =
                json!({"ground": ground, "self_contact": self_contact, "action_scale": 1.5, "domain_rand": null});
            let mut shard = shard(options, 8);
            let mut seed = 1_u64;
            let mut draw = || {
                seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (seed >> 40) as f32 / (1 << 23) as f32 - 1.0
            };
            for step in 0..300 {
                let actions: Vec<f32> = (0..8 * shard.actions()).map(|_| draw()).collect();
                shard.step(&actions);
                assert!((0..8).all(|k| shard.state(k).is_sound()), "{ground} {step}");
            }
            (0..8).map(|k| shard.state(k).clone()).collect::<Vec<_>>()
        };
        assert!(run(true) != run(false), "{ground}");
    }
}

/// The hexapod tasks refuse the engine `tree`.
#[test]
fn hexapod_tasks_refuse_the_engine_tree() {
    let error = Blueprint::new("sandgait/HexapodGait-v1", json!({"engine": "tree"})).err().unwrap().to_string();
    assert!(error.contains("engine"), "{error}");
}

/// On dunes, episodes begin at different places, robots stand on the local slope, and observed heights are those of the
/// ground.
#[test]
fn robots_stand_on_dunes() {
    let options = json!({"ground": "dunes", "measure_heights": true, "domain_rand": null, "curriculum": null});
    let blueprint = blueprint(options.clone());
    let relief = blueprint.task.model().scene.relief.clone().unwrap();
    let columns = blueprint.task.spec().observation.len();
    assert_eq!(blueprint.task.spec().observation[columns - 187].name, "measured_heights -0.8 -0.5");
    let mut shard = shard(options, 4);
    let (first, second) = (shard.state(0).position, shard.state(1).position);
    assert!((first[0] - second[0]).hypot(first[1] - second[1]) > 0.1, "{first:?} {second:?}");
    let actions = vec![0.0; 4 * shard.actions()];
    for _ in 0..150 {
        shard.step(&actions);
        assert!(shard.rows.ended.is_empty());
    }
    for k in 0..4 {
        let state = shard.state(k);
        let [x, y, z] = state.position;
        let over = z - relief.at(x, y).0;
        assert!((0.05..0.4).contains(&over), "{state:?}");
        assert!(state.velocity.iter().all(|v| v.abs() < 5e-3), "{state:?}");
        // The 94th of 187 points is under the base.
        let seen = f64::from(shard.rows.observations[(k + 1) * columns - 94]);
        assert!((seen - (over - 0.5)).abs() < 1e-4, "{seen} {over}");
    }
}

/// Each wrong terrain gives one line that names the error.
#[test]
fn bad_reliefs_are_refused() {
    let steps: Vec<Vec<f64>> = (0..6).map(|k| vec![f64::from(k / 3); 6]).collect();
    for (options, said) in [
        (json!({"ground": "poppy-loose", "relief": {"heights": steps}}), "loose sand rests at 35"),
        (json!({"relief": {"slope_deg": 40}}), "slope_deg"),
        (json!({"relief": {"heights": [[0.0]]}}), "relief.heights"),
        (json!({"relief": {"height": 1}}), "height"),
        (json!({"ground": "dunes", "slope_deg": 5}), "defines the slopes"),
    ] {
        let error = Blueprint::new(ID, options.clone()).map(drop).unwrap_err().to_string();
        assert!(error.contains(said) && !error.contains('\n'), "{options}: {error}");
    }
    // Hard ground may have steps.
    blueprint(json!({"ground": "rigid", "relief": {"heights": steps}}));
}

/// A network whose actions are 0: the robot stands.
fn standing(options: &Value) -> PolicySource {
    let blueprint = blueprint(options.clone());
    let [observation, action] = [&blueprint.task.spec().observation, &blueprint.task.spec().action].map(Vec::len);
    let mut writer = OnnxWriter::new(observation);
    let input = writer.input();
    let output = writer.dense(&input, &vec![0.0; observation * action], &vec![0.0; action]);
    PolicySource::Network { name: "policy.onnx".into(), bytes: writer.finish(&output, action) }
}

/// A robot that stands does not follow; its error is that of the velocity 0. Commands scale with the training's ranges.
#[test]
fn commands_are_measured() {
    let full = json!({"lin_vel_x": [-1, 1], "lin_vel_y": [-1, 1], "ang_vel_yaw": [-1, 1]});
    let options = json!({"ground": "rigid", "commands": full});
    let followed = CommandStudy::new(&standing(&options), &options).unwrap().run(&Silent).unwrap();
    let commands: Vec<_> = followed.lines.iter().map(|line| line.command).collect();
    assert_eq!(commands.len(), 9);
    let near = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
    assert!(near(commands[1], [0.9, 0.0, 0.0]) && near(commands[4], [0.0, -0.4, 0.0]), "{commands:?}");
    assert!(near(commands[7], [0.6, 0.0, 0.6]), "{commands:?}");
    for line in &followed.lines {
        assert!((line.error - 1.0).abs() < 0.02 && line.falls == 0.0, "{line:?}");
    }
    // Without ranges they are those of the robot's size, with the same signs.
    let own = CommandStudy::new(&standing(&Value::Null), &json!({"ground": "rigid"})).unwrap().run(&Silent).unwrap();
    let ends = Units::of(blueprint(Value::Null).task.model()).commanded();
    for (line, full) in own.lines.iter().zip(&commands) {
        assert!((0..3).all(|k| (line.command[k] - full[k] * ends[k]).abs() < 1e-3), "{line:?}");
    }
    let narrow = json!({"lin_vel_x": [-0.4, 0.8], "lin_vel_y": [0.0, 0.0], "ang_vel_yaw": [-0.5, 0.5]});
    let options = json!({"ground": "rigid", "commands": narrow});
    let followed = CommandStudy::new(&standing(&options), &options).unwrap().run(&Silent).unwrap();
    let commands: Vec<_> = followed.lines.iter().map(|line| line.command).collect();
    assert_eq!(commands.len(), 7, "none is sideways: {commands:?}");
    assert!(near(commands[1], [0.72, 0.0, 0.0]) && near(commands[2], [-0.2, 0.0, 0.0]), "{commands:?}");
}

#[test]
fn evaluations_of_the_wrong_kind_say_which_is_right() {
    let request = EvaluationRequest {
        policy: PolicySource::Random,
        task: ID.into(),
        options: Value::Null,
        seeds: 4,
        media: Vec::new(),
        slopes: Vec::new(),
    };
    let error = Evaluation::new(&request).err().unwrap().to_string();
    assert!(error.contains("`sandgait evaluate POLICY` measures how well"), "{error}");
    let refused =
        |policy: PolicySource, options: Value| CommandStudy::new(&policy, &options).err().unwrap().to_string();
    assert!(refused(PolicySource::Tripod(None), Value::Null).contains("it follows no commands"));
    let still = json!({"lin_vel_x": [0, 0], "lin_vel_y": [0, 0], "ang_vel_yaw": [0, 0]});
    assert!(refused(PolicySource::Random, json!({"commands": still})).contains("nothing to follow"));
}
