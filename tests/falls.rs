//! Falling is never rewarded. A search looks for action plans that end in a fall with a high return. For each such
//! plan, the return is higher if the robot stands still from some step on.

use rand::{Rng as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;
use sandgait::env::Shard;
use sandgait::env::registry::Blueprint;
use serde_json::json;

const TASK: &str = "sandgait/HexapodGait-v1";
const STEPS: usize = 500;
/// Number of plans in a generation.
const PLANS: usize = 64;
/// Number of generations after the first.
const GENERATIONS: usize = 1;
/// Number of falls that the next generation varies: those with the highest returns.
const BEST: usize = 8;
/// Control steps during which a plan holds an action.
const HOLD: usize = 10;

/// A sequence of actions that is repeated, and the step from which the robot stands still instead.
#[derive(Clone)]
struct Plan {
    actions: Vec<[f32; 6]>,
    until: usize,
}

impl Plan {
    fn action(&self, step: usize) -> [f32; 6] {
        if step < self.until { self.actions[(step / HOLD) % self.actions.len()] } else { [0.0; 6] }
    }
}

/// Return of each plan until its episode ends, and the step in which it fell. All plans start from the same state.
fn play(blueprint: &Blueprint, seed: u64, plans: &[Plan]) -> Vec<(f64, Option<usize>)> {
    let mut shard = Shard::new(blueprint, plans.len()).unwrap();
    shard.reset(|_| true, Some(&vec![seed; plans.len()]), |_| None);
    let (mut outcomes, mut running) = (vec![(0.0, None); plans.len()], vec![true; plans.len()]);
    for step in 0..STEPS {
        if !running.contains(&true) {
            break;
        }
        let actions: Vec<f32> = plans.iter().flat_map(|p| p.action(step)).collect();
        shard.step(&actions);
        for i in 0..plans.len() {
            if running[i] {
                outcomes[i].0 += f64::from(shard.rows.rewards[i]);
                running[i] = shard.rows.terminated[i] == 0;
                outcomes[i].1 = (!running[i]).then_some(step);
            }
        }
    }
    outcomes
}

/// The falls with the highest returns that the search finds: return, step, plan.
fn falls(blueprint: &Blueprint, seed: u64) -> Vec<(f64, usize, Plan)> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut plan = |k: usize| {
        let mut action = || [(); 6].map(|()| random.random_range(-1.0..=1.0));
        Plan { actions: (0..[1, 2, 5, 50][k % 4]).map(|_| action()).collect(), until: STEPS }
    };
    let mut plans: Vec<Plan> = (0..PLANS).map(&mut plan).collect();
    let mut best = Vec::new();
    for _ in 0..=GENERATIONS {
        let played = play(blueprint, seed, &plans).into_iter().zip(&plans);
        best.extend(played.filter_map(|((total, fell), plan)| Some((total, fell?, plan.clone()))));
        best.sort_by(|a: &(f64, usize, Plan), b| b.0.total_cmp(&a.0));
        best.truncate(BEST);
        if best.is_empty() {
            break;
        }
        let varied = |k: usize| {
            let mut plan = best[k % best.len()].2.clone();
            for a in plan.actions.iter_mut().flatten() {
                if random.random_range(0.0..1.0) < 0.3 {
                    *a = (*a + random.random_range(-0.5..0.5_f32)).clamp(-1.0, 1.0);
                }
            }
            plan
        };
        plans = (0..PLANS).map(varied).collect();
    }
    best
}

#[test]
fn falling_never_pays() {
    let mut found = 0;
    for (k, leg) in ["L", "revL", "C", "revC", "flat"].into_iter().enumerate() {
        for slope in if k % 2 == 0 { [-35.0, 25.0] } else { [-25.0, 35.0] } {
            let blueprint = Blueprint::new(TASK, json!({"slope_deg": slope, "leg": leg})).unwrap();
            let falls = falls(&blueprint, k as u64);
            let stops = |fell: usize| [0, fell / 2, fell.saturating_sub(100), fell.saturating_sub(50)];
            let stopped =
                falls.iter().flat_map(|(_, fell, plan)| stops(*fell).map(|until| Plan { until, ..plan.clone() }));
            let stood = play(&blueprint, k as u64, &stopped.collect::<Vec<_>>());
            for ((total, fell, _), stood) in falls.iter().zip(stood.chunks(4)) {
                let best =
                    stood.iter().filter(|(_, fell)| fell.is_none()).map(|(total, _)| *total).fold(f64::MIN, f64::max);
                assert!(best > *total, "leg {leg}, slope {slope}: a fall in step {fell} has {total}, standing {best}");
            }
            found += falls.len();
        }
    }
    assert!(found > 50, "only {found} falls were found");
}

/// A robot that falls in the first two seconds has a lower return than one that stands.
#[test]
fn early_falls_are_far_below_standing() {
    for slope in [-35.0, 35.0] {
        let blueprint = Blueprint::new(TASK, json!({"slope_deg": slope})).unwrap();
        let standing = play(&blueprint, 0, &[Plan { actions: vec![[0.0; 6]], until: 0 }])[0];
        assert_eq!(standing.1, None, "slope {slope}");
        let early = falls(&blueprint, 0).into_iter().filter(|(_, fell, _)| *fell < 100);
        early.for_each(|(total, fell, _)| assert!(total < standing.0 - 20.0, "slope {slope}, step {fell}: {total}"));
    }
}
