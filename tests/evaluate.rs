//! Figures of gaits: each agrees with its definition, and the intervals have the right coverage.

use nalgebra::{UnitQuaternion, Vector3};
use rand::{Rng as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;
use sandgait::Result;
use sandgait::env::Task;
use sandgait::env::gait::HexapodGait;
use sandgait::evaluate::episode::EpisodeSums;
use sandgait::evaluate::{Evaluation, EvaluationRequest, EvaluationRow, Figures, PolicySource};
use sandgait::progress::{Progress, Silent};
use sandgait::sand::Medium;
use sandgait::sim::engine::EngineKind;
use sandgait::sim::feet::feet;
use sandgait::sim::model::Scene;
use sandgait::sim::walk::{WalkTrial, walk};
use sandgait::sim::{Model, Robot, State};
use serde_json::{Value, json};
use std::sync::Mutex;

fn request(policy: &str, options: Value) -> EvaluationRequest {
    let policy =
        PolicySource::parse(policy, |file| std::fs::read(file).map_err(|e| sandgait::Error::file(file.as_ref(), e)));
    EvaluationRequest {
        policy: policy.unwrap(),
        task: HexapodGait::ID.into(),
        options,
        seeds: 20,
        media: Vec::new(),
        slopes: Vec::new(),
    }
}

fn rows(request: &EvaluationRequest) -> Vec<EvaluationRow> {
    Evaluation::new(request).unwrap().run(&Silent).unwrap()
}

fn figures(policy: &str, options: Value) -> Figures {
    rows(&request(policy, options))[0].figures
}

/// The velocities of the feet are the derivatives of their positions, for a flying robot that turns its legs.
#[test]
fn velocities_of_feet_are_derivatives_of_their_positions() {
    let dt = 1e-6;
    for (name, shape) in [("xplorer", "L"), ("xplorer18", "flat")] {
        let robot = Robot::load(name).unwrap().with_leg_shape(shape).unwrap();
        let model = Model::new(&robot, &Scene::flat(Medium::named("poppy-loose").unwrap())).unwrap();
        let angles: Vec<f64> = (0..model.joints()).map(|i| 0.5 * (i as f64).sin()).collect();
        let at = |time: f64| {
            let (velocity, spin) = (Vector3::new(0.3, -0.2, 0.1), Vector3::new(1.0, -2.0, 0.7));
            let rates: Vec<f64> = (0..model.joints()).map(|i| 5.0 * (i as f64 * 1.3).cos()).collect();
            let turned: Vec<f64> = angles.iter().zip(&rates).map(|(a, r)| a + r * time).collect();
            let tilt =
                UnitQuaternion::from_scaled_axis(spin * time) * UnitQuaternion::from_euler_angles(0.4, -0.3, 1.0);
            State {
                position: (Vector3::new(1.0, 2.0, 0.5) + velocity * time).into(),
                orientation: [tilt.w, tilt.i, tilt.j, tilt.k],
                velocity: velocity.into(),
                angular_velocity: spin.into(),
                rates,
                ..State::at_rest(0.5, &turned)
            }
        };
        let [before, now, after] = [-dt, 0.0, dt].map(|time| feet(&model, &at(time)).collect::<Vec<_>>());
        assert_eq!(now.len(), 6);
        for leg in 0..6 {
            for i in 0..3 {
                let moved = (after[leg].position[i] - before[leg].position[i]) / (2.0 * dt);
                let said = now[leg].velocity[i];
                assert!((moved - said).abs() < 1e-8, "{name}, leg {leg}: {moved} {said}");
            }
        }
    }
}

/// The lowest feet of a robot at its standing height touch the surface.
#[test]
fn feet_of_a_standing_robot_touch_the_surface() {
    let robot = Robot::load("xplorer").unwrap();
    let model = Model::new(&robot, &Scene::flat(Medium::named("poppy-loose").unwrap())).unwrap();
    let angles = model.tripod_angles();
    let state = State::at_rest(model.standing_height(&angles), &angles);
    let heights: Vec<f64> = feet(&model, &state).map(|f| f.position[2]).collect();
    assert!(heights.iter().all(|z| *z > -1e-12) && heights.iter().filter(|z| **z < 1e-12).count() == 3, "{heights:?}");
}

/// A robot that starts at rest and walks for ten seconds at a constant rate has the same speed and cost of transport as
/// in the four strides of the speed protocol.
#[test]
fn a_tripods_speed_and_cost_are_those_of_a_walk() {
    let got = figures("tripod:2", json!({"angle_noise": 0.0, "leg": "C"}));
    let mut robot = Robot::load("xplorer").unwrap().with_leg_shape("C").unwrap();
    robot.servo.torque_limit = Some(0.05);
    let scene = Scene::flat(Medium::named("poppy-loose").unwrap());
    let walked = walk(EngineKind::Lanes, &WalkTrial::new(Model::new(&robot, &scene).unwrap(), 2.0)).unwrap();
    println!("{got:?}\n{walked:?}");
    assert!((got.speed.mean / walked.speed - 1.0).abs() < 0.05, "{} {}", got.speed.mean, walked.speed);
    let cost = got.cost_of_transport.mean;
    assert!((cost / walked.cost_of_transport - 1.0).abs() < 0.07, "{cost} {}", walked.cost_of_transport);
    // Without noise the episodes differ only in their command.
    assert!(got.speed.high - got.speed.low < 1e-3 && got.return_differs());
    assert!(got.slip.mean > 0.0 && got.slip.mean < 1.0, "{:?}", got.slip);
    assert_eq!((got.falls.mean, got.diverged), (0.0, 0));
}

trait ReturnDiffers {
    fn return_differs(&self) -> bool;
}

impl ReturnDiffers for Figures {
    fn return_differs(&self) -> bool {
        self.total_reward.high > self.total_reward.low
    }
}

#[test]
fn standing_and_random_actions_score_below_a_tripod() {
    let (standing, random) = (figures("standing", Value::Null), figures("random", Value::Null));
    let tripod = figures("tripod:2", Value::Null);
    assert!(standing.speed.mean.abs() < 0.005 && random.speed.mean.abs() < 0.1, "{standing:?} {random:?}");
    assert!(
        tripod.speed.mean > 0.15 && tripod.total_reward.low > standing.total_reward.high.max(random.total_reward.high)
    );
    // A robot that walks backward covers no forward distance, so cost of transport and slip are not defined.
    let back = figures("tripod:-2", Value::Null);
    assert!(back.speed.high < -0.1 && back.cost_of_transport.mean.is_nan() && back.slip.mean.is_nan(), "{back:?}");
}

/// There is one row for each medium and slope. Walking up a slope costs more.
#[test]
fn slopes_and_media_each_have_a_row() {
    let mut all = request("tripod:2", json!({"leg": "C"}));
    (all.media, all.slopes) = (vec!["poppy-loose".into(), "poppy-close".into()], vec![0.0, 5.0]);
    let rows = rows(&all);
    let places: Vec<_> = rows.iter().map(|r| (r.medium.as_str(), r.slope_deg)).collect();
    assert_eq!(places, [("poppy-loose", 0.0), ("poppy-loose", 5.0), ("poppy-close", 0.0), ("poppy-close", 5.0)]);
    for pair in rows.chunks(2) {
        let [flat, steep] = [pair[0].figures, pair[1].figures];
        assert!(steep.speed.high < flat.speed.low && steep.cost_of_transport.low > flat.cost_of_transport.high);
    }
    // Each row equals an evaluation of this medium and slope alone.
    let alone = figures("tripod:2", json!({"leg": "C", "medium": "poppy-close", "slope_deg": 5.0}));
    assert_eq!(alone, rows[3].figures);
}

/// The gait `tripod` takes the best rate of a search, which uses other seeds than the report.
#[test]
fn the_best_tripod_is_searched() {
    let found = &rows(&request("tripod", json!({"command": [0.25, 0.25]})))[0];
    let rate = found.rate.unwrap();
    assert_eq!(found.figures, figures(&format!("tripod:{rate}"), json!({"command": [0.25, 0.25]})));
    for other in [rate - 0.5, rate + 0.5] {
        let other = figures(&format!("tripod:{other}"), json!({"command": [0.25, 0.25]}));
        assert!(other.total_reward.mean < found.figures.total_reward.mean);
    }
}

/// Action 0 of the clock control is the tripod at 2.5 Hz, computed by other code than the gait `tripod`.
#[test]
fn action_0_of_the_clock_is_a_tripod() {
    let options = json!({"angle_noise": 0.0});
    let (clock, tripod) =
        (figures("clock:0,0,0,0,0,0,0,0,0,0", options.clone()), figures("tripod:2.5", options.clone()));
    assert!((clock.speed.mean / tripod.speed.mean - 1.0).abs() < 1e-3, "{clock:?} {tripod:?}");
    assert!((clock.cost_of_transport.mean / tripod.cost_of_transport.mean - 1.0).abs() < 1e-2);
    let file = tempfile::NamedTempFile::with_suffix(".json").unwrap();
    std::fs::write(file.path(), "[0, 0, 0, 0, 0, 0, 0, 0, 0, 0]").unwrap();
    assert_eq!(figures(&format!("clock:{}", file.path().display()), options), clock);
    let refused =
        |policy: &str, options: Value| Evaluation::new(&request(policy, options)).map(drop).unwrap_err().to_string();
    assert_eq!(refused("clock:0,0,0", Value::Null), "clock: 3 numbers, an action of this task has 10");
    assert!(refused("clock:0,0,2,0,0,0,0,0,0,0", Value::Null).starts_with("clock[2]: 2 (stance sweep"));
    let other = refused("tripod:2", json!({"control": "torque"}));
    assert_eq!(other, "control: this gait needs \"hip_speed\", not \"torque\"");
}

/// Every walking task, with all quantities that its episodes draw at random.
#[test]
fn walking_tasks_can_be_evaluated() {
    for task in ["sandgait/HexapodLegs-v1", "sandgait/HexapodRocks-v1", "sandgait/HexapodTerrain-v1"] {
        let request = request("random", json!({"max_episode_steps": 30}));
        let rows = rows(&EvaluationRequest { task: task.into(), seeds: 3, ..request });
        assert!(rows[0].figures.total_reward.mean.is_finite() && rows[0].figures.speed.mean.is_finite(), "{task}");
    }
}

#[test]
fn a_network_is_evaluated() {
    let got = figures("tests/data/policy_ppo.onnx", json!({"max_episode_steps": 60}));
    assert!(got.total_reward.mean.is_finite() && got.episodes == 20, "{got:?}");
    let mut wrong = request("tests/data/policy_ppo.onnx", Value::Null);
    wrong.task = "sandgait/HexapodLegs-v1".into();
    let error = Evaluation::new(&wrong).map(drop).unwrap_err().to_string();
    assert!(error.contains("41 numbers a row"), "{error}");
}

struct Told(Mutex<Vec<f64>>);

impl Progress for Told {
    fn report(&self, done: f64, _stage: &str) -> Result<()> {
        self.0.lock().unwrap().push(done);
        if done > 0.5 { Err(sandgait::Error::Cancelled("enough".into())) } else { Ok(()) }
    }
}

#[test]
fn an_evaluation_reports_progress_and_can_be_stopped() {
    let told = Told(Mutex::default());
    let stopped = Evaluation::new(&request("tripod", Value::Null)).unwrap().run(&told);
    assert_eq!(stopped.unwrap_err().to_string(), "enough");
    let told = told.0.into_inner().unwrap();
    assert!(told.len() > 20 && told.iter().all(|d| (0.0..=1.0).contains(d)) && *told.last().unwrap() < 0.7, "{told:?}");
}

/// Newcombe, Stat. Med. 17:857 (1998), table I: 81 of 263, 15 of 148, 0 of 20, 1 of 29 by method 3.
#[test]
fn the_interval_of_falls_is_the_published_one() {
    for (count, of, low, high) in
        [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)]
    {
        let episode = |i: usize| EpisodeSums { fell: i < count, time: 1.0, ..EpisodeSums::default() };
        let got = Figures::of(&(0..of).map(episode).collect::<Vec<_>>()).falls;
        assert!((got.low - low).abs() < 6e-5 && (got.high - high).abs() < 6e-5, "{count}/{of}: {got:?}");
    }
}

/// For many samples from a known distribution, some 95 % of the intervals contain its mean.
#[test]
fn bootstrap_intervals_have_their_coverage() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(5);
    let covered = (0..200).filter(|_| {
        let x = |_| random.random_range(0.0..1.0_f64).powi(2);
        let episodes: Vec<_> =
            (0..60).map(x).map(|x| EpisodeSums { total_reward: x, time: 1.0, ..EpisodeSums::default() }).collect();
        let got = Figures::of(&episodes).total_reward;
        (got.low..=got.high).contains(&(1.0 / 3.0))
    });
    let covered = covered.count();
    assert!((178..=199).contains(&covered), "{covered} of 200");
}

#[test]
fn a_cost_of_transport_without_distance_is_nan() {
    let still = EpisodeSums { work: 1.0, weight: 1.5, time: 1.0, ..EpisodeSums::default() };
    let walks = EpisodeSums { distance: 1.0, ..still };
    assert!(Figures::of(&[still; 4]).cost_of_transport.mean.is_nan());
    let half = Figures::of(&[still, walks]).cost_of_transport;
    assert!(half.mean == 2.0 / 1.5 && half.low == 1.0 / 1.5 && half.high.is_nan(), "{half:?}");
}

#[test]
fn wrong_gaits_are_refused() {
    let read = |file: &str| std::fs::read(file).map_err(|e| sandgait::Error::file(file.as_ref(), e));
    let refused = |text: &str| PolicySource::parse(text, read).unwrap_err().to_string();
    assert!(refused("crawl").contains("policy \"crawl\" is unknown; known: FOLDER or FILE.onnx, tripod"));
    assert_eq!(refused("tripod:7"), "tripod: 7 is outside [-5, 5]");
    assert_eq!(refused("tripod:fast"), "tripod: \"fast\" is not a number of Hz");
    assert_eq!(refused("clock:1,x"), "clock: \"x\" is no number");
    assert!(refused("no-such.onnx").contains("no-such.onnx"));
    let refused = |request: &EvaluationRequest| Evaluation::new(request).map(drop).unwrap_err().to_string();
    assert_eq!(
        refused(&EvaluationRequest { seeds: 1, ..request("random", Value::Null) }),
        "seeds: 1 is outside [2, 100000]"
    );
    let much = EvaluationRequest {
        seeds: 100_000,
        slopes: (0..1000).map(|k| 0.01 * f64::from(k)).collect(),
        ..request("random", Value::Null)
    };
    assert_eq!(refused(&much), "seeds times media times slopes: 100000000 is outside [1, 1000000]");
    let moon = EvaluationRequest { media: vec!["moon".into()], ..request("random", Value::Null) };
    assert!(refused(&moon).contains("moon"));
    let steep = EvaluationRequest { slopes: vec![50.0], ..request("random", Value::Null) };
    assert_eq!(refused(&steep), "slope_deg: 50 is outside [-35, 35]");
    let leg = EvaluationRequest { task: "sandgait/LegStroke-v0".into(), ..request("random", Value::Null) };
    assert_eq!(refused(&leg), "task: sandgait/LegStroke-v0 has no x_velocity: it is no walking task");
}
