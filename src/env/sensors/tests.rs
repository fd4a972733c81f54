//! Sensors and delays on every task and engine.

mod hardware;

use super::signal::wrapped;
use super::{Sensor, Sensors, extra};
use crate::episode::Episode;
use crate::options::Options as _;
use crate::registry::{Blueprint, TASK_IDS};
use crate::shard::Shard;
use serde_json::{Value, json};

const STEPS: usize = 30;

/// A hardware.toml.
const HARDWARE: &str = "source = \"a test\"\naction_delay = { value = 0.02, interval = [0.0, 0.04] }\n\n[actuator]\n\
    no_load_speed = { value = 20.0, interval = [15.0, 25.0] }\nstall_torque = { value = 0.5, interval = [0.4, 0.6] }\n\n\
    [sensors.gyroscope]\ndelay = { value = 0.02, interval = [0.01, 0.05] }\n\n\
    [sensors.imu_rotation]\ny = { value = 0.1, interval = [0.05, 0.15] }\n";

/// The options of each task and engine.
fn cases() -> Vec<(&'static str, Value)> {
    let mut all: Vec<_> = TASK_IDS.into_iter().map(|id| (id, json!({}))).collect();
    all.push(("sandgait/HexapodGait-v1", json!({"engine": "rapier"})));
    all.push(("sandgait/LeggedVelocity-v1", json!({"ground": "rigid"})));
    all
}

fn with(options: &Value, more: Value) -> Value {
    let mut all = options.clone();
    all.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
    all
}

fn shard(id: &str, options: &Value, envs: usize) -> Shard {
    let blueprint = Blueprint::new(id, options.clone()).unwrap();
    let mut shard = Shard::new(&blueprint, envs).unwrap();
    shard.reset(|_| true, Some(&(0..envs as u64).collect::<Vec<_>>()), |_| None);
    shard
}

/// An action of open-loop control.
fn action(shard: &Shard, time: usize) -> Vec<f32> {
    (0..shard.envs() * shard.actions()).map(|k| 0.3 * ((k * 7 + time) as f32 * 0.31).sin()).collect()
}

/// The observations of open-loop control, beginning with the observation of the reset.
fn run(shard: &mut Shard, steps: usize) -> Vec<Vec<f32>> {
    let mut rows = vec![shard.rows.observations.clone()];
    for time in 0..steps {
        let action = action(shard, time);
        shard.step(&action);
        rows.push(shard.rows.observations.clone());
        assert!(shard.rows.ended.is_empty(), "an episode ended");
    }
    rows
}

/// An entry for each sensor that the task observes.
fn each(id: &str, options: &Value, entry: &Value) -> Value {
    let blueprint = Blueprint::new(id, options.clone()).unwrap();
    let own = blueprint.task.spec().observation.iter().filter_map(|c| c.sensor.map(|(s, _)| s));
    let added = Sensor::ALL.into_iter().filter(|s| extra::columns(*s, blueprint.task.model()).is_some());
    Value::Object(own.chain(added).map(|sensor| (sensor.name().to_owned(), entry.clone())).collect())
}

/// A sensor that is not in the list would be accepted as an option and have no effect.
#[test]
fn every_sensor_is_listed_and_has_an_option() {
    let rows = Sensors::rows().into_iter().filter(|row| !row.keys.is_empty());
    assert_eq!(rows.map(|row| row.name).collect::<Vec<_>>(), Sensor::ALL.map(Sensor::name));
}

#[test]
fn a_delay_of_whole_steps_shows_the_bits_of_the_past() {
    for (id, options) in cases() {
        let sensors = |delay: f64| json!({"sensors": each(id, &options, &json!({"delay": delay}))});
        let exact = run(&mut shard(id, &with(&options, sensors(0.0)), 2), STEPS);
        let late = run(&mut shard(id, &with(&options, sensors(0.06)), 2), STEPS);
        let columns = shard(id, &with(&options, sensors(0.06)), 2).spec().observation.clone();
        let wide = columns.len();
        for time in 0..=STEPS {
            for k in 0..2 * wide {
                let back = if columns[k % wide].sensor.is_some() { 3 } else { 0 };
                let (seen, then) = (late[time][k], exact[time.saturating_sub(back)][k]);
                assert_eq!(seen.to_bits(), then.to_bits(), "{id} {}: step {time}", columns[k % wide].name);
            }
        }
        let half = run(&mut shard(id, &with(&options, sensors(0.01)), 2), 2);
        let k = (0..wide).find(|k| columns[*k].sensor.is_some() && exact[2][*k] != exact[1][*k]).unwrap();
        assert!((half[2][k] - (exact[2][k] + exact[1][k]) / 2.0).abs() < 1e-3 * (1.0 + exact[2][k].abs()), "{id}");
    }
}

#[test]
fn snapshots_keep_what_sensors_remember() {
    let entry = json!({"noise_density": 0.01, "bias": 0.1, "random_walk": 0.1, "delay": 0.03, "low_pass": 0.05, "dropout": 0.2});
    for (id, options) in cases() {
        let sensors = json!({"sensors": each(id, &options, &entry), "history": 3, "privileged": true, "action_delay": [0.01, 0.05]});
        let options = with(&with(&options, sensors), json!({"domain_rand": {"hardware": HARDWARE}}));
        // As in a batch, engine `rapier` has one environment in a shard, so its steps are not divided where a neighbour's action arrives.
        let alone = Blueprint::new(id, options.clone()).unwrap().engine.shard_size() == 1;
        let (envs, chosen) = if alone { (1, vec![0]) } else { (3, vec![2, 0]) };
        let mut one = shard(id, &options, envs);
        run(&mut one, 5);
        let saved: Vec<_> = (0..envs).map(|i| one.save(i)).collect();
        let mut other = shard(id, &options, chosen.len());
        for (i, from) in chosen.iter().enumerate() {
            let task = other.task(i).clone();
            other.restore(i, &Episode::resume(&saved[*from], &task).unwrap());
        }
        let (wide, width) = (one.spec().observation.len(), one.actions());
        for time in 5..12 {
            for (i, from) in chosen.iter().enumerate() {
                let [seen, wanted] =
                    [(&other, i), (&one, *from)].map(|(s, i)| &s.rows.observations[i * wide..][..wide]);
                assert_eq!(seen, wanted, "{id}");
            }
            let actions = action(&one, time);
            one.step(&actions);
            let own: Vec<f32> = chosen.iter().flat_map(|from| actions[from * width..][..width].to_vec()).collect();
            other.step(&own);
        }
        let mut broken = saved[0].clone();
        broken.sensed.pop();
        assert!(Episode::resume(&broken, one.task(0)).is_err(), "{id}");
        let mut broken = saved[0].clone();
        broken.delayed.push(0.0);
        assert!(Episode::resume(&broken, one.task(0)).is_err(), "{id}");
    }
}

/// For a robot that stands still, the errors of one sensor: each step's measured values less the exact ones.
fn errors(entry: &Value, steps: usize, seed: u64) -> Vec<Vec<f64>> {
    let id = "sandgait/HexapodGait-v1";
    let options = json!({"sensors": {"gyroscope": entry}, "privileged": true, "max_episode_steps": 1_000_000});
    let mut shard = shard(id, &options, 16);
    shard.reset(|_| true, Some(&(seed..seed + 16).collect::<Vec<_>>()), |_| None);
    let spec = shard.spec().clone();
    let (wide, info) = (spec.observation.len(), spec.info.len());
    let name = "base angular velocity, body frame, x";
    let seen = spec.observation.iter().position(|c| c.name == name).unwrap();
    let exact = spec.info.iter().position(|c| c.name == format!("privileged {name}")).unwrap();
    let mut all = Vec::new();
    for _ in 0..steps {
        shard.step(&vec![0.0; 16 * shard.actions()]);
        let error = |i: usize, axis: usize| {
            f64::from(shard.rows.observations[i * wide + seen + axis])
                - f64::from(shard.rows.infos[i * info + exact + axis])
        };
        all.push((0..48).map(|k| error(k / 3, k % 3)).collect());
    }
    all
}

fn deviation(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / count;
    (values.map(|x| (x - mean).powi(2)).sum::<f64>() / count).sqrt()
}

#[test]
fn noise_has_its_density() {
    // 2100 steps of 48 values: 10⁵ samples, whose standard deviation has an error of 0.2 %.
    let all = errors(&json!({"noise_density": 0.02}), 2100, 0);
    let found = deviation(all.iter().flatten().copied());
    let wanted = 0.02 * 50_f64.sqrt();
    assert!((found / wanted - 1.0).abs() < 0.01, "{found} {wanted}");
    // White: successive samples are independent.
    let pairs = all.windows(2).flat_map(|w| w[0].iter().zip(&w[1]).map(|(a, b)| a * b));
    let correlation = pairs.sum::<f64>() / (48.0 * 2099.0) / wanted.powi(2);
    assert!(correlation.abs() < 0.02, "{correlation}");
    // A delay that is no whole number of control steps makes the noise no smaller.
    let late = errors(&json!({"noise_density": 0.02, "delay": 0.01}), 1000, 0);
    // After the robot has come to rest.
    let found = deviation(late[100..].iter().flatten().copied());
    assert!((found / wanted - 1.0).abs() < 0.02, "{found} {wanted}");
    assert_eq!(all[..50], errors(&json!({"noise_density": 0.02}), 50, 0)[..], "seeds fix the noise");
    assert_ne!(all[..50], errors(&json!({"noise_density": 0.02}), 50, 100)[..]);
}

#[test]
fn a_bias_stays_for_an_episode_and_a_walk_grows() {
    let all = errors(&json!({"bias": 0.3}), 20, 0);
    assert!(all.iter().all(|row| row.iter().zip(&all[0]).all(|(a, b)| (a - b).abs() < 1e-5)), "it is constant");
    let biases: Vec<f64> = (0..40).flat_map(|k| errors(&json!({"bias": 0.3}), 1, 16 * k).remove(0)).collect();
    let found = deviation(biases.iter().copied());
    assert!((found / 0.3 - 1.0).abs() < 0.05, "{found}");
    let all = errors(&json!({"random_walk": 0.5}), 100, 0);
    let found = deviation(all[99].iter().copied());
    let wanted = 0.5 * (100.0 / 50_f64).sqrt();
    assert!((found / wanted - 1.0).abs() < 0.35, "48 walks: {found} {wanted}");
}

#[test]
fn quantization_dropout_and_filter() {
    let id = "sandgait/HexapodLegs-v1";
    let mut coarse = shard(id, &json!({"sensors": {"joint_position": {"quantization": 0.01}}}), 1);
    let columns = coarse.spec().observation.clone();
    let first = columns.iter().position(|c| c.name.starts_with("joint angle")).unwrap();
    for row in run(&mut coarse, 10) {
        assert!(row[first..first + 18].iter().all(|x| (x / 0.01 - (x / 0.01).round()).abs() < 1e-3), "{row:?}");
    }
    let exact = run(&mut shard(id, &json!({}), 1), STEPS);
    let held = run(&mut shard(id, &json!({"sensors": {"joint_velocity": {"dropout": 0.5}}}), 1), STEPS);
    let rates = first + 18;
    let fresh = (1..=STEPS).filter(|t| held[*t][rates] == exact[*t][rates]).count();
    let kept = (1..=STEPS).filter(|t| held[*t][rates] == held[t - 1][rates]).count();
    assert!(fresh + kept >= STEPS && kept > STEPS / 4 && fresh > STEPS / 4, "{fresh} {kept}");
    let slow = run(&mut shard(id, &json!({"sensors": {"joint_velocity": {"low_pass": 0.1}}}), 1), STEPS);
    let mut filtered = exact[0][rates];
    let share = 1.0 - (-0.02_f32 / 0.1).exp();
    for t in 1..=STEPS {
        filtered += (exact[t][rates] - filtered) * share;
        assert!((slow[t][rates] - filtered).abs() < 1e-3, "step {t}: {} {filtered}", slow[t][rates]);
    }
    let by_difference = run(&mut shard(id, &json!({"sensors": {"velocity_by_differences": true}}), 1), STEPS);
    for t in 1..=STEPS {
        let change = (exact[t][first] - exact[t - 1][first]) * 50.0;
        assert!((by_difference[t][rates] - change).abs() < 1e-3);
    }
}

/// In an environment with a delay, motors do later what they do in an environment without a delay.
#[test]
fn delayed_actions_reach_the_motors_later() {
    let id = "sandgait/HexapodGait-v1";
    // Hip speeds do not depend on the state, so a delay of 40 ms shifts the references by two steps.
    let references = |options: Value| {
        let mut shard = shard(id, &options, 3);
        let mut all = vec![shard.state(1).references.clone()];
        for time in 0..20 {
            let action = action(&shard, time);
            shard.step(&action);
            all.push(shard.state(1).references.clone());
        }
        all
    };
    let exact = references(json!({"angle_noise": 0.0}));
    let late = references(json!({"angle_noise": 0.0, "action_delay": [0.04, 0.04]}));
    for t in 2..=20 {
        for (a, b) in late[t].iter().zip(&exact[t - 2]) {
            assert!(wrapped(a - b).abs() < 1e-4, "{t}: {a} {b}");
        }
    }
    let part = references(json!({"angle_noise": 0.0, "action_delay": [0.005, 0.005]}));
    for t in 1..=20 {
        for ((a, now), before) in part[t].iter().zip(&exact[t]).zip(&exact[t - 1]) {
            let wanted = now + 0.25 * wrapped(before - now);
            assert!(wrapped(a - wanted).abs() < 1e-4, "{t}: {a} between {before} and {now}");
        }
    }
}

/// Actions that arrive in the middle of a step, and motors at their limits, leave the other environments bit-identical, though all are
/// simulated together.
#[test]
fn delays_and_motors_of_neighbours_change_no_bits() {
    for (id, options) in cases() {
        if Blueprint::new(id, options.clone()).unwrap().engine.shard_size() == 1 {
            continue;
        }
        let drawn = HARDWARE.replace(
            "stall_torque = { value = 0.5, interval = [0.4, 0.6] }",
            "stall_torque = { value = 0.02, interval = [0.01, 20.0] }",
        );
        let options = with(&options, json!({"action_delay": [0.0, 0.05], "domain_rand": {"hardware": drawn}}));
        let (mut alone, mut among) = (shard(id, &options, 1), shard(id, &options, 4));
        for _ in 0..60 {
            let action = vec![0.8; alone.actions()];
            alone.step(&action);
            among.step(&action.repeat(4));
            let info = alone.rows.infos.len();
            assert_eq!(alone.rows.observations, among.rows.observations[..alone.rows.observations.len()], "{id}");
            assert_eq!(alone.rows.infos, among.rows.infos[..info], "{id}");
        }
    }
}

/// The info row of a step that ends an episode has the exact values of the next episode's first observation.
#[test]
fn the_next_episodes_exact_values_come_with_the_end() {
    for (id, options) in cases() {
        let more = json!({"privileged": true, "max_episode_steps": 3});
        let mut shard = shard(id, &with(&options, more), 1);
        let (wide, info) = (shard.spec().observation.len(), shard.spec().info.len());
        for step in 1..=3 {
            shard.step(&vec![0.1; shard.actions()]);
            let (present, next) = shard.rows.infos[info - 2 * wide..].split_at(wide);
            if step < 3 {
                assert_eq!(present, shard.rows.observations, "{id}");
                assert!(next.iter().all(|x| *x == 0.0));
            } else {
                assert_eq!(present, shard.rows.final_observations, "{id}");
                assert_eq!(next, shard.rows.observations, "{id}");
            }
        }
    }
}

/// The forces that engine `lanes` keeps equal the forces of `Pose` on average.
#[test]
fn kept_forces_are_those_of_the_pose() {
    let options = json!({"sensors": {"contact_force": {}}, "command": [0.3, 0.3]});
    let mut shard = shard("sandgait/HexapodGait-v1", &options, 1);
    let first = shard.spec().observation.len() - 6;
    let (mut kept, mut posed) = ([0.0; 6], [0.0; 6]);
    for _ in 0..200 {
        shard.step(&vec![0.4; shard.actions()]);
        let pose = crate::sim::pose::Pose::of(shard.model(0), shard.state(0), &[]);
        for leg in 0..6 {
            kept[leg] += f64::from(shard.rows.observations[first + leg]) / 200.0;
            posed[leg] += pose.leg_forces[leg].z / 200.0;
        }
    }
    let sum = posed.iter().sum::<f64>();
    for (kept, posed) in kept.iter().zip(&posed) {
        assert!((kept - posed).abs() < 0.02 * sum, "{kept} and {posed} of {sum} N");
    }
}

/// An accelerometer at rest feels the ground's push against gravity, and feet carry the robot.
#[test]
fn a_standing_robot_feels_its_weight() {
    for (id, options) in [
        ("sandgait/HexapodGait-v1", json!({"angle_noise": 0.0})),
        ("sandgait/LeggedVelocity-v1", json!({"angle_noise": 0.0, "domain_rand": null, "ground": "poppy-close"})),
    ] {
        let more =
            json!({"sensors": {"accelerometer": {}, "contact_force": {}, "contact_switch": {}, "range_finder": {}}});
        let mut shard = shard(id, &with(&options, more), 1);
        let columns = shard.spec().observation.clone();
        for _ in 0..100 {
            shard.step(&vec![0.0; shard.actions()]);
        }
        let row = &shard.rows.observations;
        let value = |name: &str| {
            let found = columns.iter().zip(row).filter(|(c, _)| c.name.starts_with(name)).map(|(_, x)| *x);
            found.collect::<Vec<f32>>()
        };
        let felt = value("specific force").iter().map(|x| x * x).sum::<f32>().sqrt();
        assert!((felt / 9.80665 - 1.0).abs() < 0.05, "{id}: {felt}");
        let weight = shard.model(0).total_mass() * 9.80665;
        let carried = f64::from(value("contact force").iter().sum::<f32>());
        // The hexapod's belly lies in the sand and carries a part.
        let least = if id.contains("Hexapod") { 0.3 } else { 0.85 };
        assert!((least..1.15).contains(&(carried / weight)), "{id}: {carried} of {weight} N");
        assert!(value("contact switch").iter().sum::<f32>() >= 3.0, "{id}");
        let height = shard.state(0).position[2];
        assert!((f64::from(value("range finder")[0]) / height - 1.0).abs() < 0.02, "{id}");
    }
}

#[test]
fn wrong_entries_are_refused() {
    let refused = |id: &str, options: Value| Blueprint::new(id, options).err().expect("it is refused").to_string();
    let gait = "sandgait/HexapodGait-v1";
    for (options, said) in [
        (json!({"sensors": "noisy"}), "sensors: "),
        (json!({"sensors": {"sonar": {}}}), "sonar"),
        (json!({"sensors": {"gyroscope": {"delay": 2.0}}}), "sensors.gyroscope.delay: 2 is outside [0, 0.5]"),
        (json!({"sensors": {"gyroscope": {"noise": 2.0}}}), "noise"),
        (json!({"sensors": {"heights": {}}}), "sensors.heights: sandgait/HexapodGait-v1 does not observe it"),
        (json!({"sensors": {"without": ["sonar"]}}), "sonar"),
        (json!({"history": 0}), "history: 0 is outside [1, 64]"),
        (json!({"action_delay": [0.1, 0.0]}), "action_delay[1]"),
        (json!({"hardware": "delay = 3"}), "hardware: delay: expected a table"),
        (json!({"hardware": "[actuator]\nforce = { value = 1.0, interval = [1.0, 1.0] }"}), "actuator.force"),
        (
            json!({"hardware": "[sensors.gyroscope]\ndelay = { value = 1.0, interval = [0.0, 2.0] }"}),
            "hardware: sensors.gyroscope.delay: 1 is outside [0, 0.5]",
        ),
        (
            json!({"domain_rand": {"hardware": "action_delay = { value = 0.1, interval = [0.0, 2.0] }"}}),
            "domain_rand.hardware: action_delay: 2 is outside [0, 0.5]",
        ),
        (json!({"domain_rand": {"friction": [0, 1]}}), "friction"),
        (json!({"sensors": {"imu_rotation": [4.0, 0.0, 0.0]}}), "imu_rotation"),
    ] {
        let error = refused(gait, options);
        assert!(error.contains(said) && !error.contains('\n'), "{error}");
    }
    let few = Blueprint::new(gait, json!({"sensors": {"without": ["lin_vel"]}, "history": 2})).unwrap();
    let all = Blueprint::new(gait, json!({})).unwrap();
    assert_eq!(few.task.spec().observation.len(), 2 * (all.task.spec().observation.len() - 3));
}
