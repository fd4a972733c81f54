//! Properties of every task: mirror symmetry, and a page that agrees with the code.

use sandgait::env::ground::Change;
use sandgait::env::random::Random;
use sandgait::env::registry::{Blueprint, TASK_IDS, task_id};
use sandgait::env::task::{TaskState, Transition};
use sandgait::env::{Column, ResetOptions};
use sandgait::number::Isa;
use sandgait::sim::blocks::LaneEngine;
use sandgait::sim::engine::{Command, Integrator as _};
use sandgait::sim::lanes;
use sandgait::sim::{Model, State};
use serde_json::{Value, json};

const GAIT: &str = "sandgait/HexapodGait-v1";
const LEGS: &str = "sandgait/HexapodLegs-v1";
const TERRAIN: &str = "sandgait/HexapodTerrain-v1";

fn blueprint(id: &str, options: Value) -> Blueprint {
    Blueprint::new(id, options).unwrap()
}

fn refused(id: &str, options: Value) -> String {
    Blueprint::new(id, options).err().unwrap().to_string()
}

/// A task may be called without `sandgait/`, and its latest version without the version, as Python does it.
#[test]
fn short_names_are_ids() {
    for id in TASK_IDS {
        let bare = id.trim_start_matches("sandgait/");
        assert_eq!([task_id(id), task_id(bare)], [id, id]);
        let short = bare.split("-v").next().unwrap();
        let versions = || TASK_IDS.into_iter().filter(|id| id.starts_with(&format!("sandgait/{short}-v")));
        assert_eq!(task_id(short), versions().max().unwrap());
        assert_eq!(task_id(&format!("sandgait/{short}")), task_id(short));
    }
    assert_eq!(task_id("HexapodLegs"), "sandgait/HexapodLegs-v2");
    for other in ["HexapodGait-v0", "Pendulum-v1", "sandgait/Hexapod", ""] {
        assert_eq!(task_id(other), other);
    }
}

/// For each joint, its counterpart on the other side, and the sign of its angle in the mirror. (Hinge axes are axial
/// vectors.)
fn other_side(model: &Model) -> Vec<(usize, f64)> {
    let names = model.robot.joint_names();
    let bodies: Vec<_> = model.legs.iter().flatten().collect();
    let pair = |(i, name): (usize, &String)| {
        let other = names.iter().position(|n| *n == swapped(name)).unwrap();
        let (a, b) = (bodies[i].axis, bodies[other].axis);
        (other, -a.x * b.x + a.y * b.y - a.z * b.z)
    };
    names.iter().enumerate().map(pair).collect()
}

fn swapped(name: &str) -> String {
    if name.contains("right") { name.replace("right", "left") } else { name.replace("left", "right") }
}

fn mirrored_state(state: &State, sides: &[(usize, f64)]) -> State {
    let mut new = state.clone();
    new.position[1] *= -1.0;
    for (i, (other, sign)) in sides.iter().enumerate() {
        new.angles[*other] = sign * state.angles[i];
        new.references[*other] = sign * state.references[i];
    }
    new
}

/// A row of actions or observations with left and right exchanged. The signs follow from the columns' names.
fn mirrored_row(row: &[f32], columns: &[Column], model: &Model) -> Vec<f32> {
    let names = model.robot.joint_names();
    let sides = other_side(model);
    let sign = |name: &str| {
        let axial = name.contains("angular velocity") || name.contains("yaw");
        let odd = if axial { !name.ends_with(" y") } else { name.ends_with(" y") };
        // Signs of angles, speeds and torques. Phases and torque limits have no direction.
        let joint = names.iter().position(|j| name.ends_with(&format!(", {j}")) && !name.contains("cosine"));
        joint.map_or(if odd { -1.0 } else { 1.0 }, |i| sides[i].1)
    };
    let source = |name: &str| columns.iter().position(|c| c.name == swapped(name)).unwrap();
    columns.iter().map(|c| sign(&c.name) as f32 * row[source(&c.name)]).collect()
}

/// Two robots of a task in one engine, without autoreset.
struct Twins<'a> {
    blueprint: &'a Blueprint,
    engine: LaneEngine,
    states: [State; 2],
    goals: [TaskState; 2],
    last: [Vec<f32>; 2],
}

impl<'a> Twins<'a> {
    fn new(blueprint: &'a Blueprint) -> Self {
        let model = blueprint.task.model();
        let (state, task_state) = blueprint.task.begin(None, &mut Random::new(5, 0));
        let mut engine = lanes::engine(Isa::F64, model, 2).unwrap();
        let states = [state.clone(), mirrored_state(&state, &other_side(model))];
        for (i, state) in states.iter().enumerate() {
            engine.set_model(i, task_state.model.as_deref().unwrap_or(model));
            engine.set_state(i, state);
        }
        let turned = TaskState { turn: -task_state.turn, ..task_state.clone() };
        let last = [(); 2].map(|()| vec![0.0; blueprint.task.spec().action.len()]);
        Self { blueprint, engine, states, goals: [task_state, turned], last }
    }

    /// Makes a step; returns observation and info of both robots.
    fn step(&mut self, actions: [Vec<f32>; 2]) -> [(Vec<f32>, Vec<f32>); 2] {
        let task = &*self.blueprint.task;
        let period = 1.0 / task.spec().control_rate;
        let mut command = Command::still(task.model().joints());
        for (i, action) in actions.iter().enumerate() {
            task.command(action, &self.states[i], &mut command);
            self.engine.command(i, &command);
        }
        self.engine.advance((period / task.model().scene.dt).round() as usize);
        let rows = [0, 1].map(|i| {
            let before = self.states[i].clone();
            self.engine.state(i, &mut self.states[i]);
            let rows = self.evaluate(i, &before, &actions[i], period);
            self.after_step(i, &rows.1);
            rows
        });
        self.last = actions;
        rows
    }

    fn after_step(&mut self, i: usize, info: &[f32]) {
        let change = self.blueprint.task.after_step(&mut self.goals[i], &self.states[i], info);
        let (Some(model), Some(ground)) = (&self.goals[i].model, &self.goals[i].ground) else { return };
        if change == Change::Patch {
            self.engine.set_model(i, model);
            self.engine.set_state(i, &self.states[i]);
        }
        self.engine.set_footing(i, model, &ground.footing);
    }

    fn evaluate(&self, i: usize, before: &State, action: &[f32], period: f64) -> (Vec<f32>, Vec<f32>) {
        let (task, after) = (&self.blueprint.task, &self.states[i]);
        let (mut row, mut info) = (vec![0.0; task.spec().observation.len()], vec![0.0; task.spec().info.len()]);
        task.observe(&self.goals[i], after, action, &mut row);
        let (task_state, previous_action) = (&self.goals[i], &self.last[i]);
        let model = task_state.model.as_ref().unwrap_or(task.model());
        task.evaluate(
            &Transition {
                model,
                task_state,
                before,
                after,
                foot_loads: &[],
                action,
                previous_action,
                period,
                diverged: false,
            },
            &mut info,
        );
        (row, info)
    }
}

/// Actions that change slowly and differ by joint.
fn wave(width: usize, time: usize) -> Vec<f32> {
    (0..width).map(|k| ((k * 7 + time) as f32 * 0.37).sin()).collect()
}

fn close(a: &[f32], b: &[f32], what: &str) {
    let far = a.iter().zip(b).map(|(a, b)| (a - b).abs() / (1.0 + b.abs())).fold(0.0, f32::max);
    assert!(far < 1e-4, "{what}: {far}");
}

fn every_walk() -> Vec<(&'static str, Value)> {
    let gait = |c| (GAIT, json!({"control": c, "turn": [0.7, 0.7]}));
    let controls = ["hip_speed", "hip_target", "torque", "clock"].map(gait);
    let ranges = json!({"turning_point": [0.05, 0.05], "patch_length": [0.04, 0.04]});
    let others = [(LEGS, json!({"turn": [0.5, 0.5]})), (TERRAIN, json!({"randomize": ranges, "turn": [0.3, 0.3]}))];
    controls.into_iter().chain(others).collect()
}

/// From a mirrored state, mirrored actions give mirrored observations and the same info.
#[test]
fn tasks_are_mirror_symmetric() {
    for (id, options) in every_walk() {
        let what = format!("{id} {options}");
        let blueprint = blueprint(id, options);
        let (model, spec) = (&**blueprint.task.model(), blueprint.task.spec());
        let mut twins = Twins::new(&blueprint);
        let mut aside = 0.0;
        // With torque control the motion is irregular, so that rounding errors grow and are visible after a second.
        for time in 0..30 {
            let action = wave(spec.action.len(), time);
            let mirrored = mirrored_row(&action, &spec.action, model);
            let [(row, info), (other, other_info)] = twins.step([action, mirrored]);
            close(&mirrored_row(&row, &spec.observation, model), &other, &format!("{what} step {time}"));
            close(&info, &other_info, &format!("{what} info, step {time}"));
            aside = f64::max(aside, twins.states[0].position[1].abs());
        }
        assert!(aside > 1e-4, "{what} never left its middle line");
    }
}

/// Action 0 of the clock control is a tripod at a constant rate: each hip at half of the largest speed.
#[test]
fn action_0_of_the_clock_is_the_constant_rate_tripod() {
    let quiet = |control| blueprint(GAIT, json!({"control": control, "angle_noise": 0.0}));
    let (clock, speed) = (quiet("clock"), quiet("hip_speed"));
    let (mut a, mut b) = (Twins::new(&clock), Twins::new(&speed));
    for _ in 0..100 {
        a.step([(); 2].map(|()| vec![0.0; 10]));
        b.step([(); 2].map(|()| vec![0.5; 6]));
    }
    assert!(a.states[0].position[0] > 0.3, "it walks");
    let far = (a.states[0].position[0] - b.states[0].position[0]).abs();
    assert!(far < 1e-6, "{far}");
}

/// With torque control, the action is the motor's torque, within its limit. With position control, the hip moves to the
/// target.
#[test]
fn torque_and_position_actions_have_their_meaning() {
    let torque = blueprint(GAIT, json!({"control": "torque", "torque_limit": 0.02}));
    let mut twins = Twins::new(&torque);
    let action = vec![0.5, -0.25, 0.1, 0.0, 1.0, -1.0];
    twins.step([(); 2].map(|()| action.clone()));
    let wanted: Vec<f32> = action.iter().map(|a| 0.02 * a).collect();
    close(&twins.states[0].torques.iter().map(|t| *t as f32).collect::<Vec<_>>(), &wanted, "torques");

    // Far above the sand there is no force on the legs.
    let target = blueprint(GAIT, json!({"control": "hip_target"}));
    let mut twins = Twins::new(&target);
    twins.states[0].position[2] = 50.0;
    twins.engine.set_state(0, &twins.states[0]);
    let action = vec![0.5, -0.9, 1.0, 0.0, 0.1, -0.3];
    for _ in 0..50 {
        twins.step([(); 2].map(|()| action.clone()));
    }
    for (angle, a) in twins.states[0].angles.iter().zip(action) {
        let away = angle - f64::from(a) * std::f64::consts::PI;
        assert!(away.sin().abs() < 0.01 && away.cos() > 0.0, "{angle} instead of {a} half turns");
    }
}

const WALKING: [&str; 4] = [GAIT, LEGS, "sandgait/HexapodRocks-v1", TERRAIN];

/// The observation contains both commands, so the reward depends on no hidden quantity.
#[test]
fn the_command_is_in_the_observation() {
    for id in WALKING {
        let blueprint = blueprint(id, json!({"turn": [0.5, 0.5], "command": [0.2, 0.2]}));
        let (task, columns) = (&blueprint.task, &blueprint.task.spec().observation);
        let (state, task_state) = task.begin(None, &mut Random::new(1, 0));
        let mut row = vec![0.0; columns.len()];
        task.observe(&task_state, &state, &vec![0.0; task.spec().action.len()], &mut row);
        let told = |name: &str| row[columns.iter().position(|c| c.name == name).unwrap()];
        assert_eq!((told("commanded speed"), told("commanded yaw speed")), (0.2, 0.5), "{id}");
    }
}

/// `state` rotated about the robot's vertical axis by `yaw` [rad].
fn yawed(state: &State, yaw: f64) -> State {
    let (sin, cos) = (yaw / 2.0).sin_cos();
    let [w, x, y, z] = state.orientation;
    State { orientation: [cos * w - sin * z, cos * x - sin * y, cos * y + sin * x, cos * z + sin * w], ..state.clone() }
}

/// Info columns of a step of HexapodGait in which the robot turns from one heading to another [rad] and moves by
/// `moved` [m]. At its end the yaw speed is `turning` [rad/s] and the accumulated work `work` [J].
fn paid(headings: [f64; 2], moved: [f64; 2], turning: f64, work: f64) -> impl Fn(&str) -> f64 {
    let blueprint = blueprint(GAIT, json!({"command": [0.25, 0.25]}));
    let task = blueprint.task.clone();
    let (state, task_state) = task.begin(None, &mut Random::new(1, 0));
    let [before, mut after] = headings.map(|yaw| yawed(&state, yaw));
    after.position = [state.position[0] + moved[0], state.position[1] + moved[1], state.position[2]];
    (after.angular_velocity[2], after.work) = (turning, work);
    let mut info = vec![0.0; task.spec().info.len()];
    let transition = Transition {
        model: task.model(),
        task_state: &task_state,
        before: &before,
        after: &after,
        foot_loads: &[],
        action: &[0.0; 6],
        previous_action: &[0.0; 6],
        period: 0.02,
        diverged: false,
    };
    task.evaluate(&transition, &mut info);
    let names: Vec<_> = task.spec().info.iter().map(|c| c.name.clone()).collect();
    move |name| f64::from(info[names.iter().position(|n| n == name).unwrap()])
}

/// The reward does not depend on the robot's heading. Speeds in a step with a turn are those in the mean heading.
#[test]
fn speeds_are_rewarded_along_the_heading() {
    for heading in [0.0, 1.0, 3.0, -2.0] {
        let (sin, cos) = f64::sin_cos(heading);
        let [forward, left] = [0.005, 0.001];
        let moved = [cos * forward - sin * left, sin * forward + cos * left];
        let got = paid([heading - 0.2, heading + 0.2], moved, 0.0, 0.0);
        assert!((got("speed") - 0.25).abs() < 1e-6 && (got("reward_tracking") - 1.0).abs() < 1e-6, "{heading}");
        let lateral = -0.1 * 2.0 * ((1.0_f64 + 0.25).sqrt() - 1.0); // 0.05 m/s is half of the tolerance
        assert!((got("reward_lateral") - lateral).abs() < 1e-6, "{heading}: {}", got("reward_lateral"));
        assert!((got("x_velocity") - moved[0] / 0.02).abs() < 1e-6);
    }
}

/// A cost never saturates: a larger error always costs more.
#[test]
fn costs_do_not_saturate() {
    let mut last = [0.0; 3];
    for much in [0.5, 1.0, 2.0, 5.0, 20.0] {
        let got = paid([0.0; 2], [0.0, 0.002 * much], much, 0.02 * much);
        let costs = ["reward_lateral", "reward_turning", "reward_power"].map(|name| -got(name));
        assert!(costs.iter().zip(last).all(|(cost, last)| *cost > 1.2 * last), "{much}: {costs:?} {last:?}");
        last = costs;
    }
}

#[test]
fn earlier_versions_name_the_present_one() {
    for id in WALKING {
        let old = id.replace("-v1", "-v0");
        let id = if id == LEGS { "sandgait/HexapodLegs-v2" } else { id };
        assert_eq!(refused(&old, Value::Null), format!("task {old:?} has been replaced by {id:?}; see CHANGELOG"));
    }
    assert!(
        refused("sandgait/HexapodGait-v2", Value::Null)
            .contains("is unknown; did you mean \"sandgait/HexapodGait-v1\"?")
    );
}

#[test]
fn options_of_other_tasks_are_refused() {
    let legs = refused(LEGS, json!({"control": "clock"}));
    assert!(
        legs.starts_with("control: sandgait/HexapodLegs-v1 has no such option; sandgait/HexapodGait-v1, "),
        "{legs}"
    );
    assert!(refused(GAIT, json!({"control": "magic"})).starts_with("control \"magic\" is unknown"));
    assert!(refused(GAIT, json!({"controls": "clock"})).contains("known: robot, engine"));
    let reset = ResetOptions::new(json!({"rocks": {"count": 1}})).unwrap();
    let error = blueprint(GAIT, Value::Null).changed(&reset).err().unwrap().to_string();
    assert!(error.starts_with("rocks: ") && error.contains("HexapodRocks"), "{error}");
}

/// The part of a page after this line has measured results and is written by hand; the part before it is generated.
const MEASURED: &str = "<!-- measured -->";

#[test]
fn pages_agree_with_the_code() {
    // Only the latest version of a task has a page.
    let latest =
        |id: &&str| id.rsplit_once("-v").is_some_and(|(name, _)| task_id(name.trim_start_matches("sandgait/")) == *id);
    for id in TASK_IDS.into_iter().filter(latest).chain(["common"]) {
        let name = id.trim_start_matches("sandgait/");
        let path = format!("{}/docs/tasks/{name}.md", env!("CARGO_MANIFEST_DIR"));
        let page = std::fs::read_to_string(&path).unwrap();
        // The common options have no measured results.
        let made = if id == "common" { page.as_str() } else { page.split_once(MEASURED).unwrap().0 };
        // A page can be read in a few minutes. That of LeggedVelocity has 40 options of its own.
        let most = if name.starts_with("LeggedVelocity") { 1450 } else { 1200 };
        assert!(page.split_whitespace().filter(|word| word.contains(char::is_alphanumeric)).count() <= most, "{path}");
        let printed = std::process::Command::new(env!("CARGO_BIN_EXE_sandgait"))
            .args(["tasks", "--markdown", id])
            .output()
            .unwrap();
        assert!(printed.status.success());
        assert!(String::from_utf8(printed.stdout).unwrap() == made, "{path} is old: run `make task-pages`");
    }
}

#[allow(dead_code)] // its `main` runs in the example only
#[path = "../examples/own_task.rs"]
mod own_task;

/// The example task works with one file: options, help, resets, rewards and figures are derived from it.
#[test]
fn a_task_of_ones_own_is_one_file() {
    let make = |options| Blueprint::of::<own_task::LevelWalk>(options);
    let refused = |options| make(options).err().unwrap().to_string();
    assert_eq!(refused(json!({"largest_tilt": 9})), "largest_tilt: 9 is outside [0.1, 3]");
    assert_eq!(refused(json!({"level_weights": {"level": -1}})), "level_weights.level: -1 is outside [0, 100]");
    assert!(refused(json!({"difficulty": 1})).starts_with("difficulty: example/LevelWalk-v0 has no such option"));
    let level = make(json!({"level_weights": {"level": 0.5}})).unwrap();
    let names: Vec<_> = level.task.spec().info.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["reward_progress", "reward_level", "tilt", "work"]);
    assert_eq!(level.task.option("level_weights"), json!({"progress": 1.0, "level": 0.5}));
    let keywords = level.keywords();
    let tilt = keywords.iter().find(|k| k.name == "largest_tilt").unwrap();
    assert_eq!((tilt.at_reset, &tilt.value), (true, &json!(0.8)));
    let reset = |options| level.changed(&ResetOptions::new(options).unwrap());
    assert_eq!(reset(json!({"largest_tilt": 0.3, "slope_deg": 5})).unwrap().task.option("largest_tilt"), 0.3);
    let fixed = reset(json!({"level_weights": {"level": 0}})).err().unwrap().to_string();
    assert!(fixed.starts_with("level_weights: no reset changes it; resets change: command, turn"), "{fixed}");
    // The robot walks with and without a weight on tilt, and the weight lowers the reward.
    let [free, priced] = [0.0, 5.0].map(|level| own_task::played(json!({"level_weights": {"level": level}})).unwrap());
    assert!(free > 1.0 && priced < free, "{free} {priced}");
}
