//! A session of this process.

use sandgait::env::ResetOptions;
use sandgait::env::registry::Blueprint;
use sandgait::pool::{Batch, Operation, Pool};
use sandgait::session::{Answer, Environments, EnvironmentsGuard};
use sandgait::{Error, Result};
use serde_json::Value;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

fn made(envs: usize) -> Environments {
    let blueprint = Blueprint::new("sandgait/HexapodGait-v1", Value::Null).unwrap();
    Environments::new(&blueprint, envs, || false).unwrap()
}

fn lent(environments: &Environments) -> EnvironmentsGuard {
    environments.take(Duration::from_secs(60)).unwrap().unwrap()
}

fn reset(batch: &mut Batch) -> Result<Operation> {
    batch.reset(None, Some((0..batch.envs() as u64).collect()), ResetOptions::default())
}

fn rows(environments: &Environments) -> Vec<f32> {
    let mut guard = lent(environments);
    assert!(matches!(guard.answer(), Some(Answer::Rows)));
    guard.batch().shards().iter().flat_map(|s| s.rows.observations.clone()).collect()
}

/// Steps on the caller's thread and on the pool's threads are bit-identical. A refused step changes nothing.
#[test]
fn here_and_in_the_pool() {
    let pool = Pool::new(3);
    for envs in [1, 33, 100] {
        let both = [made(envs), made(envs)];
        for environments in &both {
            lent(environments).run(&pool, reset);
        }
        assert_eq!(rows(&both[0]), rows(&both[1]));
        for k in 0..20 {
            let actions = |batch: &Batch| vec![(0.3 * k as f32).sin(); 6 * batch.envs()];
            lent(&both[0]).run(&pool, |b| b.step(vec![7.0; 6 * b.envs()]));
            assert!(matches!(lent(&both[0]).answer(), Some(Answer::Refused(Error::Invalid { .. }))));
            lent(&both[0]).run(&pool, |b| b.step(actions(b)));
            lent(&both[1]).run_here(&pool, |b| b.step(actions(b)));
            assert_eq!(rows(&both[0]), rows(&both[1]), "step {k} of {envs}");
        }
    }
}

#[test]
fn a_panic_loses_these_environments_only() {
    let (pool, environments, others) = (Pool::new(1), made(1), made(1));
    let panics = || lent(&environments).run(&pool, |_| panic!("on purpose"));
    assert!(catch_unwind(AssertUnwindSafe(panics)).is_err());
    let error = environments.take(Duration::ZERO).unwrap().err().unwrap();
    assert!(error.to_string().contains("please report this as a bug"), "{error}");
    lent(&others).run(&pool, reset);
    rows(&others);
}

#[test]
fn a_rollout_can_be_stopped_and_changes_nothing() {
    let (pool, environments) = (Pool::new(2), made(20));
    lent(&environments).run(&pool, reset);
    let before = rows(&environments);
    let actions = |steps: usize| vec![0.5; 20 * 6 * steps];
    let sums = |answer| match answer {
        Some(Answer::Rolled(rolled)) => rolled,
        _ => panic!("no rollout"),
    };
    lent(&environments).roll(&pool, true, |b| b.roll(actions(30), true));
    let rolled = sums(lent(&environments).answer());
    assert_eq!((rolled.rewards.len(), rolled.returns.len()), (600, 20));
    let (other, guard) = (environments.clone(), lent(&environments));
    let roller = std::thread::spawn(move || guard.roll(&Pool::new(1), false, |b| b.roll(actions(1_000_000), false)));
    assert!(other.take(Duration::from_millis(50)).is_none(), "it is away");
    while other.take(Duration::from_millis(1)).is_none() {
        other.stop();
    }
    roller.join().unwrap();
    assert!(matches!(lent(&other).answer(), Some(Answer::Refused(Error::Cancelled(_)))));
    let held = |b: &mut Batch| b.step_but(vec![0.0; 120], vec![true; 20]);
    lent(&environments).run(&pool, held);
    assert_eq!(rows(&environments), before);
}

#[test]
fn closed_while_they_are_away() {
    let (pool, environments) = (Pool::new(1), made(1));
    let mut guard = lent(&environments);
    let operation = reset(guard.batch()).unwrap();
    environments.close();
    guard.run(&pool, |_| Ok(operation));
    let error = environments.take(Duration::from_secs(60)).unwrap().err().unwrap();
    assert_eq!(error.to_string(), "this environment is closed");
}
