//! Checks that robots do not pass through rocks: whole episodes of random actions among rocks. Overlaps are computed by
//! other code than the engine's. `cargo run --release --example rocks_study [EPISODES] [STEPS] [FIRST_SEED]`
//!
//! Prints the deepest overlap of each episode's legs (middle surface of the strips) and base with any obstacle
//! after a control step, as quantiles over episodes. For overlaps between control steps it also interpolates poses
//! (angles and positions linear), and prints the deepest overlap as a share of the depth of the obstacle's centre. This
//! share is nearly 1 for a body that passes through an obstacle's centre.

use sandgait::env::random::Random;
use sandgait::env::registry::Blueprint;
use sandgait::sim::engine::{Command, Engine, EngineKind};
use sandgait::sim::overlap::{overlap, overlap_share};
use sandgait::sim::state::{ObjectState, State};
use std::f64::consts::{PI, TAU};
use std::sync::atomic::{AtomicU64, Ordering};

/// Number of poses between two control steps: a leg's tip moves at most 4 mm from one to the next.
const BETWEEN: usize = 8;

/// An overlap beyond this share of the depth of an obstacle's centre counts as passing through: our choice, because a
/// body that is half way to the centre will hardly be pushed out again.
const THROUGH: f64 = 0.5;

/// Results of one episode.
struct Episode {
    /// Deepest overlap [m].
    overlap: f64,
    /// Deepest overlap as a share of the depth of the obstacle's centre, also at poses between the control steps.
    share: f64,
    /// Distance of the robot from start to end [m].
    distance: f64,
    diverged: bool,
    obstacles: usize,
    /// Number of loose rocks that moved by more than 5 mm along the surface.
    pushed: usize,
}

fn mix<const N: usize>(a: [f64; N], b: [f64; N], part: f64) -> [f64; N] {
    std::array::from_fn(|i| a[i] + part * (b[i] - a[i]))
}

/// Interpolates between two orientations that are less than half a turn apart.
fn mix_turn(a: [f64; 4], b: [f64; 4], part: f64) -> [f64; 4] {
    let same_side = a.iter().zip(&b).map(|(a, b)| a * b).sum::<f64>() >= 0.0;
    let q = mix(a, b.map(|c| if same_side { c } else { -c }), part);
    let norm = q.iter().map(|c| c * c).sum::<f64>().sqrt();
    q.map(|c| c / norm)
}

/// The state at the share `part` of the way from `a` to `b`. Speeds are those of `a`.
fn between(a: &State, b: &State, part: f64) -> State {
    let mut pose = a.clone();
    pose.position = mix(a.position, b.position, part);
    pose.orientation = mix_turn(a.orientation, b.orientation, part);
    // The shorter of the two directions, because a hinge turns by less than half a turn in a control step.
    let shorter = |turn: f64| (turn + PI).rem_euclid(TAU) - PI;
    pose.angles.iter_mut().zip(&b.angles).for_each(|(angle, end)| *angle += part * shorter(end - *angle));
    let object = |(a, b): (&ObjectState, &ObjectState)| ObjectState {
        position: mix(a.position, b.position, part),
        orientation: mix_turn(a.orientation, b.orientation, part),
        ..*a
    };
    pose.objects = a.objects.iter().zip(&b.objects).map(object).collect();
    pose
}

fn episode(blueprint: &Blueprint, seed: u64, steps: usize) -> sandgait::Result<Episode> {
    let task = &blueprint.task;
    let (mut state, task_state) = task.begin(None, &mut Random::new(seed, 0));
    let model = task_state.model.as_deref().unwrap_or(task.model());
    let start = state.clone();
    let mut engine = Engine::new(EngineKind::Rapier, model, 1)?;
    engine.set_state(0, &state);
    let mut random = Random::new(seed, 1);
    let mut command = Command::still(model.joints());
    let mut action = vec![0.0; task.spec().action.len()];
    let substeps = (1.0 / (task.spec().control_rate * model.scene.dt)).round() as usize;
    let (mut most, mut share): (f64, f64) = (0.0, 0.0);
    for step in 0..steps {
        // A new random action every 0.2 s, in which the hips reach their speed. In half of the episodes the mean action
        // is forward.
        if step % 10 == 0 {
            let low = if seed.is_multiple_of(2) { -1.0 } else { 0.0 };
            action.iter_mut().for_each(|a| *a = random.uniform(low, 1.0) as f32);
        }
        task.command(&action, &state, &mut command);
        engine.command(0, &command);
        engine.advance(substeps);
        let before = state.clone();
        engine.state(0, &mut state);
        if !state.is_sound() {
            break;
        }
        most = most.max(overlap(model, &state));
        let parts = (1..=BETWEEN).map(|k| k as f64 / BETWEEN as f64);
        share = parts.map(|part| overlap_share(model, &between(&before, &state, part))).fold(share, f64::max);
    }
    let apart = |a: &[f64; 3], b: &[f64; 3]| (a[0] - b[0]).hypot(a[1] - b[1]);
    let objects = state.objects.iter().zip(&start.objects);
    Ok(Episode {
        overlap: most,
        share,
        distance: apart(&state.position, &start.position),
        diverged: !state.is_sound(),
        obstacles: model.scene.obstacles.len(),
        pushed: objects.filter(|(a, b)| apart(&a.position, &b.position) > 5e-3).count(),
    })
}

fn main() -> sandgait::Result<()> {
    let number = |i, default| std::env::args().nth(i).and_then(|a| a.parse().ok()).unwrap_or(default);
    let (episodes, steps) = (number(1, 1000), number(2, 250));
    let blueprint = Blueprint::new("sandgait/HexapodRocks-v1", serde_json::json!({"rocks": {"count": 40}}))?;
    let first = number(3, 0);
    let episodes = first + episodes;
    let next = AtomicU64::new(first);
    let threads = sandgait::parallel::processors();
    let worker = || {
        let seeds = std::iter::repeat_with(|| next.fetch_add(1, Ordering::Relaxed)).take_while(|s| *s < episodes);
        seeds
            .map(|seed| episode(&blueprint, seed, steps as usize).map(|e| (seed, e)))
            .collect::<sandgait::Result<Vec<_>>>()
    };
    let results = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(worker)).collect();
        let join = |w: std::thread::ScopedJoinHandle<_>| w.join().unwrap_or_else(|e| std::panic::resume_unwind(e));
        workers.into_iter().map(join).collect::<sandgait::Result<Vec<_>>>()
    })?;
    let mut results: Vec<_> = results.into_iter().flatten().collect();
    results.sort_by(|a, b| a.1.overlap.total_cmp(&b.1.overlap));
    let sum = |of: fn(&Episode) -> f64| results.iter().map(|(_, e)| of(e)).sum::<f64>();
    let count = results.len() as f64;
    println!("{} episodes of {steps} control steps", results.len());
    println!(
        "{:.1} obstacles an episode, {:.2} loose rocks pushed",
        sum(|e| e.obstacles as f64) / count,
        sum(|e| e.pushed as f64) / count
    );
    println!(
        "{:.2} m from start to end, {} diverged",
        sum(|e| e.distance) / count,
        sum(|e| f64::from(u8::from(e.diverged)))
    );
    for part in [0.5, 0.9, 0.99, 0.999, 1.0] {
        let at = ((count * part).ceil() as usize).clamp(1, results.len()) - 1;
        let (seed, e) = &results[at];
        println!("overlap, quantile {part}: {:.3} mm (seed {seed})", e.overlap * 1e3);
    }
    let deepest = results.iter().max_by(|a, b| a.1.share.total_cmp(&b.1.share));
    let through = results.iter().filter(|(_, e)| e.share > THROUGH).count();
    if let Some((seed, e)) = deepest {
        println!("deepest on the way: {:.2} of an obstacle's own depth (seed {seed})", e.share);
    }
    println!(
        "{through} of {} episodes passed through an obstacle (more than {THROUGH} of its own depth)",
        results.len()
    );
    Ok(())
}
