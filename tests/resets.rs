//! Options given to a reset stay in force, for each environment separately, and in dictionaries for each key
//! separately.

use sandgait::env::ResetOptions;
use sandgait::env::registry::Blueprint;
use sandgait::pool::{Batch, Pool, Seal, Snapshot};
use serde_json::{Value, json};

const GAIT: &str = "sandgait/HexapodGait-v1";
const TERRAIN: &str = "sandgait/HexapodTerrain-v1";

struct Session {
    pool: Pool,
    batch: Option<Batch>,
}

impl Session {
    fn new(id: &str, options: Value, envs: usize) -> Self {
        let batch = Batch::new(&Blueprint::new(id, options).unwrap(), envs).unwrap();
        Self { pool: Pool::new(1), batch: Some(batch) }
    }

    fn batch(&self) -> &Batch {
        self.batch.as_ref().unwrap()
    }

    /// Resets the environments in `mask`, or all; environment i gets seed i.
    fn reset(&mut self, mask: Option<&[bool]>, options: Value) -> Result<(), String> {
        let batch = self.batch.take().unwrap();
        let changes = ResetOptions::new(options).unwrap();
        let seeds = Some((0..batch.envs() as u64).collect());
        let (batch, outcome) = match batch.reset(mask.map(<[bool]>::to_vec), seeds, changes) {
            Ok(operation) => (self.pool.wait(batch, operation).unwrap(), Ok(())),
            Err(error) => (batch, Err(error.to_string())),
        };
        self.batch = Some(batch);
        outcome
    }

    /// Observations and rewards of the next steps.
    fn walk(&mut self, steps: usize) -> Vec<f32> {
        let mut rows = Vec::new();
        for _ in 0..steps {
            let batch = self.batch.take().unwrap();
            let operation = batch.step(vec![0.4; batch.envs() * batch.spec().action.len()]).unwrap();
            self.batch = Some(self.pool.wait(batch, operation).unwrap());
            for shard in self.batch().shards() {
                rows.extend_from_slice(&shard.rows.observations);
                rows.extend_from_slice(&shard.rows.rewards);
            }
        }
        rows
    }

    fn options(&self, env: usize) -> Value {
        let mut first = 0;
        for shard in self.batch().shards() {
            if env < first + shard.envs() {
                return Value::Object(shard.task(env - first).options());
            }
            first += shard.envs();
        }
        panic!("no environment {env}")
    }
}

/// Two resets, each with an option, give bit-identical results to those of a session that was made with both options,
/// also after ends of episodes.
#[test]
fn options_of_several_resets_are_all_in_force() {
    let short = json!({"max_episode_steps": 15});
    let mut one_by_one = Session::new(GAIT, short, 3);
    one_by_one.reset(None, json!({})).unwrap();
    one_by_one.reset(None, json!({"leg": "C"})).unwrap();
    one_by_one.reset(None, json!({"slope_deg": 5.0})).unwrap();
    let mut made = Session::new(GAIT, json!({"max_episode_steps": 15, "leg": "C", "slope_deg": 5.0}), 3);
    made.reset(None, json!({})).unwrap();
    assert_eq!(one_by_one.walk(40), made.walk(40));
}

#[test]
fn a_mask_changes_only_its_environments() {
    let envs = 40; // more than one shard
    let mut session = Session::new(GAIT, json!({}), envs);
    let chosen = |ids: &[usize]| (0..envs).map(|i| ids.contains(&i)).collect::<Vec<_>>();
    session.reset(None, json!({})).unwrap();
    session.reset(Some(&chosen(&[0, 39])), json!({"slope_deg": 5.0})).unwrap();
    session.reset(Some(&chosen(&[0, 1])), json!({"payload": 0.05})).unwrap();
    session.reset(None, json!({"leg": "C"})).unwrap();
    let told = |i: usize| ["slope_deg", "payload", "leg"].map(|name| session.options(i)[name].clone());
    for (env, slope, payload) in [(0, 5.0, 0.05), (1, 0.0, 0.05), (2, 0.0, 0.0), (39, 5.0, 0.0)] {
        assert_eq!(told(env), [json!(slope), json!(payload), json!("C")], "environment {env}");
    }
}

#[test]
fn dictionaries_change_key_by_key() {
    let made = json!({"difficulty": 0.2, "randomize": {"slope_deg": [3.0, 4.0]}});
    let mut session = Session::new(TERRAIN, made, 2);
    session.reset(None, json!({"slope_deg": 2.0})).unwrap();
    assert_eq!(session.options(0)["difficulty"], 0.2);
    session.reset(None, json!({"randomize": {"payload": [0.02, 0.03]}})).unwrap();
    session.reset(Some(&[true, false]), json!({"randomize": {"zeta": [0.9, 1.1]}})).unwrap();
    let ranges = |i: usize| ["slope_deg", "payload", "zeta"].map(|name| session.options(i)["randomize"][name].clone());
    assert_eq!(ranges(0), [json!([3.0, 4.0]), json!([0.02, 0.03]), json!([0.9, 1.1])]);
    assert_eq!(ranges(1), [json!([3.0, 4.0]), json!([0.02, 0.03]), json!([0.45, 2.0])]);

    let mut rocks = Session::new("sandgait/HexapodRocks-v1", json!({"rocks": {"count": 3}}), 1);
    rocks.reset(None, json!({"rocks": {"density": 2000.0}})).unwrap();
    let told = &rocks.options(0)["rocks"];
    assert_eq!([&told["count"], &told["density"]], [&json!(3), &json!(2000.0)]);

    let mut stroke = Session::new("sandgait/LegStroke-v0", json!({"stroke": {"lift": 1.0}}), 1);
    stroke.reset(None, json!({"stroke": {"exit_weight": 2.0}})).unwrap();
    let told = &stroke.options(0)["stroke"];
    assert_eq!([&told["lift"], &told["exit_weight"]], [1.0, 2.0]);
}

/// A range that is valid for one environment's slope but not for another's is refused for both.
#[test]
fn a_refused_reset_changes_nothing() {
    let mut session = Session::new(TERRAIN, json!({}), 2);
    session.reset(None, json!({})).unwrap();
    session.reset(Some(&[true, false]), json!({"slope_deg": 20.0})).unwrap();
    let before = [0, 1].map(|i| session.options(i));
    for (wrong, said) in [
        (json!({"randomize": {"slope_deg": [-20.0, 20.0]}}), "randomize.slope_deg[1]: 20 is outside [-20, 15]"),
        (json!({"randomize": {"mud": [0, 1]}}), "randomize: key \"mud\" is unknown; known: "),
        (json!({"randomize": {"zeta": "soft"}}), "randomize: text \"soft\", expected"),
        (json!({"rocks": {"count": 1}}), "rocks: sandgait/HexapodTerrain-v1 has no such option"),
        (json!({"slope_deg": null}), "slope_deg: null is not allowed"),
        (json!({"medium": null}), "medium: null is not allowed"),
        (json!({"randomize": [0.1]}), "randomize: list, expected a dictionary"),
    ] {
        let error = session.reset(None, wrong).unwrap_err();
        assert!(error.starts_with(said), "{error}, not {said}");
        assert_eq!([0, 1].map(|i| session.options(i)), before);
    }
}

/// A snapshot contains each environment's options, and later resets change these.
#[test]
fn snapshots_keep_what_resets_changed() {
    let mut session = Session::new(TERRAIN, json!({}), 2);
    session.reset(None, json!({"difficulty": 0.5})).unwrap();
    session.reset(Some(&[false, true]), json!({"randomize": {"zeta": [0.9, 1.1]}})).unwrap();
    session.walk(10);
    let bytes = session.batch().save().unwrap().to_bytes(&Seal::default()).unwrap();
    let rows = session.walk(20);
    let mut other = Session::new(TERRAIN, json!({}), 2);
    let batch = other.batch.take().unwrap();
    let operation = batch.restore(Snapshot::from_bytes(&bytes, &Seal::default()).unwrap(), None).unwrap();
    other.batch = Some(other.pool.wait(batch, operation).unwrap());
    assert_eq!(other.walk(20), rows);
    other.reset(None, json!({"payload": 0.01})).unwrap();
    for env in 0..2 {
        let told = other.options(env);
        let zeta = if env == 1 { [0.9, 1.1] } else { [0.45, 2.0] };
        assert_eq!([&told["difficulty"], &told["payload"]], [0.5, 0.01]);
        assert_eq!(told["randomize"]["zeta"], json!(zeta));
    }
}

/// The largest inline relief is in a snapshot like any other option.
#[test]
fn snapshots_hold_large_reliefs() {
    for side in [256_usize, 512] {
        let height = |j: usize, i: usize| 0.05 * (0.1 * i as f64).sin() + 0.03 * (0.07 * j as f64).cos();
        let heights: Vec<Vec<f64>> = (0..side).map(|j| (0..side).map(|i| height(j, i)).collect()).collect();
        let options = json!({"ground": "rigid", "relief": {"heights": heights, "spacing": 0.1}});
        let mut session = Session::new("sandgait/LeggedVelocity-v1", options.clone(), 2);
        session.reset(None, json!({})).unwrap();
        session.walk(5);
        let bytes = session.batch().save().unwrap().to_bytes(&Seal::default()).unwrap();
        let rows = session.walk(10);
        let snapshot = Snapshot::from_bytes(&bytes, &Seal::default()).unwrap();
        let mut other = Session::new("sandgait/LeggedVelocity-v1", options, 2);
        let batch = other.batch.take().unwrap();
        let operation = batch.restore(snapshot, None).unwrap();
        other.batch = Some(other.pool.wait(batch, operation).unwrap());
        assert_eq!(other.walk(10), rows, "{side}");
    }
}
