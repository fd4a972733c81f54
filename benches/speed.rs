//! Measures the parts of a step: the force on one segment, a time step of a robot, a step of the pool, and a step
//! through the service.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use sandgait::bench::{Direct, ServerStepper, Stepper, random_actions};
use sandgait::env::registry::Blueprint;
use sandgait::number::{Isa, Vec3};
use sandgait::sand::{Law, Medium, Regularization, SandBed, SegmentState};
use sandgait::sim::engine::{Command, EngineKind, Integrator as _};
use sandgait::sim::lanes;
use sandgait::sim::model::Scene;
use sandgait::sim::rapier::RapierEngine;
use sandgait::sim::{Model, Robot, State};
use serde_json::json;
use std::hint::black_box;

const TASK: &str = "sandgait/HexapodGait-v1";

fn sand() -> Medium {
    Medium::named("poppy-loose").unwrap()
}

/// The force on one segment, in `f64`, with each law.
fn segment(c: &mut Criterion) {
    let mut group = c.benchmark_group("segment");
    for law in Law::ALL {
        let ground = SandBed::<f64>::new(law, &sand(), &Regularization::default());
        let (site, n, v) = (SegmentState::fresh(0.02, 0.0), Vec3::new(0.6, 0.0, 0.8), Vec3::new(0.1, 0.02, -0.2));
        group.bench_function(law.name(), |b| b.iter(|| ground.thin_plate(&black_box(site), 1e-5, n, black_box(v))));
    }
    group.finish();
}

/// The state of a walking robot, and the command with which it walks.
fn walking(model: &Model) -> (State, Command) {
    let angles = model.tripod_angles();
    let state = State::at_rest(model.standing_height(&angles), &angles);
    (state, Command { rates: vec![6.0; model.joints()], torques: vec![0.0; model.joints()], targets: vec![] })
}

/// A time step of one robot: with each instruction set of this machine, and with engine `rapier`.
fn substep(c: &mut Criterion) {
    let mut group = c.benchmark_group("substep");
    let model = Model::new(&Robot::load("xplorer").unwrap(), &Scene::flat(sand())).unwrap();
    let (state, command) = walking(&model);
    const STEPS: u64 = 40;
    for isa in Isa::ALL.into_iter().filter(|isa| isa.available()) {
        let mut engine = lanes::engine(isa, &model, isa.lanes()).unwrap();
        for i in 0..isa.lanes() {
            engine.set_state(i, &state);
            engine.command(i, &command);
        }
        group.throughput(Throughput::Elements(STEPS * isa.lanes() as u64));
        group.bench_function(BenchmarkId::new("lanes", isa.name()), |b| b.iter(|| engine.advance(STEPS as usize)));
    }
    let mut engine = RapierEngine::new(&model, 1);
    engine.set_state(0, &state);
    engine.command(0, &command);
    group.throughput(Throughput::Elements(STEPS));
    group.bench_function("rapier", |b| b.iter(|| engine.advance(STEPS as usize)));
    group.finish();
}

/// Control steps: of the pool with one and with two threads, and of the service.
fn steps(c: &mut Criterion) {
    let blueprint = Blueprint::new(TASK, json!({})).unwrap();
    let width = blueprint.task.spec().action.len();
    let mut group = c.benchmark_group("step");
    let mut measure = |name: &str, envs: usize, stepper: &mut dyn Stepper| {
        let actions = random_actions(envs, width);
        let mut turn = actions.iter().cycle();
        group.throughput(Throughput::Elements(envs as u64));
        group.bench_function(BenchmarkId::new(name, envs), |b| {
            b.iter(|| stepper.step(turn.next().unwrap()).unwrap());
        });
    };
    for envs in [32, 256] {
        measure("pool-1-thread", envs, &mut Direct::new(&blueprint, envs, 1).unwrap());
        measure("pool-2-threads", envs, &mut Direct::new(&blueprint, envs, 2).unwrap());
        measure("grpc-uds", envs, &mut ServerStepper::new(TASK, json!({}), envs, 1, false).unwrap());
        measure("grpc-tcp", envs, &mut ServerStepper::new(TASK, json!({}), envs, 1, true).unwrap());
    }
    group.finish();
    assert_eq!(blueprint.engine, EngineKind::Lanes, "the figures above are of the default engine");
}

criterion_group!(speed, segment, substep, steps);
criterion_main!(speed);
