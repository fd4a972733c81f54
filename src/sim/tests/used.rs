//! Robots on sand that remembers: bits, states, volume, and convergence.

use sandgait_sand::Medium;
use sandgait_sand::memory::MemorySettings;
use sandgait_sim::engine::{Command, Engine, EngineKind};
use sandgait_sim::model::Scene;
use sandgait_sim::{Model, Robot, State};
use std::f64::consts::TAU;

/// Width of a leg [m].
const WIDTH: f64 = 0.01;

fn model(leg: &str, dt: f64) -> Model {
    let robot = Robot::built_in("xplorer").unwrap().with_leg_shape(leg).unwrap();
    let mut scene = Scene { dt, ..Scene::flat(Medium::named("poppy-loose").unwrap()) };
    scene.remember(&robot);
    Model::new(&robot, &scene).unwrap()
}

fn start(model: &Model) -> State {
    let angles = model.tripod_angles();
    State::at_rest(model.standing_height(&angles), &angles)
}

fn command(rate: f64) -> Command {
    Command { rates: vec![rate; 6], torques: vec![0.0; 6], targets: vec![] }
}

/// State and sand of robot `index` of an engine; all fields that the engine does not fill are those of `like`.
fn after(engine: &Engine, index: usize, like: &State) -> State {
    let mut state = like.clone();
    engine.state(index, &mut state);
    state.sand = engine.sand(index).cloned().map(Box::new);
    state
}

/// An environment's results are bit-identical in every lane and with every neighbour.
#[test]
fn neighbours_do_not_matter() {
    let model = model("L", 1e-3);
    let start = start(&model);
    let run = |count: usize, index: usize| {
        let mut engine = Engine::new(EngineKind::Lanes, &model, count).unwrap();
        for i in 0..count {
            engine.set_state(i, &start);
            engine.command(i, &command(if i == index { 12.0 } else { 3.0 + i as f64 }));
        }
        engine.advance(1503);
        after(&engine, index, &start)
    };
    let alone = run(1, 0);
    assert!(alone.sand.as_ref().unwrap().grid.cells().any(|(_, h)| h < -1e-3), "it has left no print");
    assert_eq!(run(20, 0), alone);
    assert_eq!(run(20, 18), alone);
}

/// A state that is read with its sand and set again goes on bit-identically, also between two movements of sand.
#[test]
fn states_go_on() {
    let model = model("revL", 1e-3);
    let start = start(&model);
    let mut engine = Engine::new(EngineKind::Lanes, &model, 1).unwrap();
    engine.set_state(0, &start);
    engine.command(0, &command(9.0));
    engine.advance(733);
    let middle = after(&engine, 0, &start);
    let bytes = middle.sand.as_ref().unwrap().to_bytes();
    let settings = model.scene.memory.unwrap();
    assert_eq!(
        sandgait_sand::memory::Moved::from_bytes(&settings, model.sand_bodies(), &bytes).as_ref(),
        middle.sand.as_deref()
    );
    let mut other = Engine::new(EngineKind::Lanes, &model, 3).unwrap();
    other.set_state(2, &middle);
    other.command(2, &command(9.0));
    for engine in [&mut engine, &mut other] {
        engine.advance(518);
    }
    assert_eq!(after(&engine, 0, &start), after(&other, 2, &start));
    // A state that is set without its sand goes on differently.
    other.set_state(2, &State { sand: None, ..middle });
    other.command(2, &command(9.0));
    other.advance(518);
    assert_ne!(after(&engine, 0, &start).position, after(&other, 2, &start).position);
}

/// Walking speed along its path over sixteen strides [m/s], the median over starts at evenly distributed places and headings on the
/// grid, from heights that differ by 0.1 mm. Any rounding changes a robot's way a little, so the speeds of single walks scatter by
/// 2 %, and in a few walks the robot stumbles.
fn speed(model: &Model, hz: f64) -> f64 {
    const STARTS: usize = 32;
    let start = start(model);
    let mut engine = Engine::new(EngineKind::Lanes, model, STARTS).unwrap();
    for i in 0..STARTS {
        let [x, y, z] = start.position;
        // Multiples of the golden section, and of the numbers of the R₂ sequence, are evenly distributed between 0 and 1.
        let [along, across, turn] = [0.754_877_666, 0.569_840_291, 0.618_033_989].map(|g| (g * i as f64).fract());
        let half = 0.5 * TAU * turn;
        let position = [x + WIDTH * along, y + WIDTH * across, z + 1e-4 * i as f64];
        engine.set_state(i, &State { position, orientation: [half.cos(), 0.0, 0.0, half.sin()], ..start.clone() });
        engine.command(i, &command(TAU * hz));
    }
    // Control steps of 20 ms.
    let (dt, each) = (model.scene.dt, (0.02 / model.scene.dt).round() as usize);
    let mut state = start.clone();
    let mut advance = |time: f64| {
        let steps = (time / dt).round() as usize;
        (0..steps.div_ceil(each)).for_each(|k| engine.advance(each.min(steps - k * each)));
        let mut place = |i| {
            engine.state(i, &mut state);
            state.position
        };
        (0..STARTS).map(&mut place).collect::<Vec<_>>()
    };
    let mut last = advance(0.5 + 2.0 / hz);
    let mut ways = [0.0; STARTS];
    for _ in 0..16 {
        let now = advance(1.0 / hz);
        for ((way, a), b) in ways.iter_mut().zip(&last).zip(&now) {
            *way += (b[0] - a[0]).hypot(b[1] - a[1]);
        }
        last = now;
    }
    ways.sort_by(f64::total_cmp);
    0.5 * (ways[STARTS / 2 - 1] + ways[STARTS / 2]) * hz / 16.0
}

/// With an eighth of the time step and cells of a third of the size, walking speeds change by at most 2 %. The number of places that
/// get sand grows with the number of cells: as few places among smaller cells would be a coarser distribution, not a finer one
/// (with it and cells of half the size, the speeds of concave legs change by 3 %).
#[test]
fn walks_converge() {
    const FINER: f64 = 0.35;
    for (leg, hz) in [("L", 1.0), ("L", 2.0), ("L", 3.0), ("revL", 2.0), ("revL", 3.0), ("C", 2.0)] {
        let usual = model(leg, 1e-3);
        let mut fine = model(leg, 1.25e-4);
        let settings = fine.scene.memory.unwrap();
        assert_eq!(settings.cell, 0.75 * WIDTH);
        let smaller = MemorySettings::new(&fine.scene.medium, FINER * settings.cell, 8, 2.0 * WIDTH, None);
        let pairs = (settings.pairs as f64 / (FINER * FINER)) as usize;
        fine.scene.memory = Some(MemorySettings { least: settings.least, pairs, ..smaller });
        let mut fresh = usual.clone();
        fresh.scene.memory = None;
        let [a, b, none] = [&usual, &fine, &fresh].map(|m| speed(m, hz));
        println!("{leg} {hz} Hz: {a:.4}, fine {b:.4} ({:.2} %), without memory {none:.4}", 100.0 * (a / b - 1.0));
        assert!((a / b - 1.0).abs() < 0.02, "{leg} {hz} Hz: {a} and {b}");
    }
}

/// Only engines that have memory take such a model.
#[test]
fn other_engines_refuse() {
    let error = Engine::new(EngineKind::Rapier, &model("L", 5e-4), 1).err().unwrap().to_string();
    assert!(error.contains("memory") && error.contains("lanes"), "{error}");
}
