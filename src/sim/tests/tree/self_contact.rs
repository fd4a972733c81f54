//! Legs that meet.

use super::engine::conserved;
use super::models::*;
use super::*;
use sandgait_number::Isa;
use sandgait_sim::engine::{Command, Integrator as _};
use sandgait_sim::tree::kinematics::frames;
use sandgait_sim::{Model, State};

/// Radius of a foot [m], and where it is in the frame of its calf.
const FOOT: f64 = 0.02;
const AT: V = V::new(0.0, 0.0, -0.2);

fn model(self_contact: bool, dt: f64) -> Model {
    let tree = quadruped();
    let plates = plates(&tree);
    let tree = TreeModel::new(tree, plates).unwrap();
    Model::of_tree(if self_contact { tree.with_self_contact() } else { tree }, &scene(dt)).unwrap()
}

/// Distance of the front feet's centres [m].
fn apart(model: &Model, state: &State) -> f64 {
    let frames = frames(&model.tree.as_ref().unwrap().tree, state);
    (frames[3] * nalgebra::Point3::from(AT) - frames[6] * nalgebra::Point3::from(AT)).norm()
}

/// High above the ground, with the centres of the front feet some 4 cm apart.
fn start() -> State {
    let mut state = standing(&quadruped());
    state.position[2] = 100.0;
    (state.angles[0], state.angles[3]) = (-0.35, 0.35);
    state.references.clone_from(&state.angles);
    state
}

/// Robot `k` after half a second in which its servos try to cross the front feet, and the least distance of the feet in this time.
fn crossed(isa: Isa, model: &Model, count: usize, k: usize) -> (State, f64) {
    let mut engine = sandgait_sim::tree::engine(isa, model, count).unwrap();
    let named = |i: usize| if count == 1 { k } else { i };
    let (mut state, own) = (start(), if count == 1 { 0 } else { k });
    let mut least = f64::INFINITY;
    for i in 0..count {
        engine.set_state(i, &state);
        let mut command = Command { targets: start().angles, ..Command::still(12) };
        // Some robots do not cross their feet.
        let far = 0.8 * f64::from(named(i) % 3 != 1);
        (command.targets[0], command.targets[3]) = (-far, far);
        engine.command(i, &command);
    }
    for _ in 0..125 {
        sandgait_number::flushed(|| engine.advance((4e-3 / model.scene.dt).round() as usize));
        engine.state(own, &mut state);
        least = least.min(apart(model, &state));
    }
    (state, least)
}

/// Feet that are pulled through each other stay apart; without the option they pass. Nothing gains momentum.
#[test]
fn legs_do_not_pass_through_each_other() {
    for dt in [1e-3, 2e-3, 4e-3] {
        let (_, through) = crossed(Isa::F64, &model(false, dt), 1, 0);
        assert!(through < FOOT, "{dt}: {through}");
        for isa in [Isa::F64, Isa::Baseline] {
            let model = model(true, dt);
            let (after, least) = crossed(isa, &model, 1, 0);
            assert!(least > 2.0 * FOOT - 2e-3, "{dt} {isa:?}: {least}");
            let ((p0, l0, _), (p1, l1, _)) = (conserved(&model, &start()), conserved(&model, &after));
            let fallen = V::from(model.gravity) * (0.5 * model.tree.as_ref().unwrap().mass());
            assert!((p1 - p0 - fallen).norm() < 2e-3 * fallen.norm(), "{dt} {isa:?}: {}", p1 - p0 - fallen);
            assert!((l1 - l0).norm() < 0.01, "{dt} {isa:?}: {}", l1 - l0);
        }
    }
}

/// Loose legs that swing into each other lose energy.
#[test]
fn a_meeting_gains_no_energy() {
    let model = loosened(&model(true, 1e-3));
    let mut before = start();
    (before.rates[0], before.rates[3]) = (-4.0, 3.0);
    (before.rates[1], before.rates[5]) = (1.0, -2.0);
    let after = run(Isa::F64, &model, &before, 0.1);
    let [(_, _, e0), (_, _, e1)] = [&before, &after].map(|state| conserved(&model, state));
    let height = |state: &State| state.position[2] * model.tree.as_ref().unwrap().mass() * sandgait_sand::GRAVITY;
    let motion = e0 - height(&before);
    assert!(e1 < e0 + 1e-3 * motion, "{e0} {e1}");
    let free = run(Isa::F64, &loosened(&self::model(false, 1e-3)), &before, 0.1);
    assert_ne!(after, free, "they meet");
}

/// If legs meet in one lane, the other lanes stay bit-identical; robots whose parts do not meet move as without the option.
#[test]
fn only_those_that_meet_are_changed() {
    for isa in Isa::ALL.into_iter().filter(|isa| isa.available()) {
        let (with, without) = (model(true, 1e-3), model(false, 1e-3));
        for k in [0, 1, 4, 17] {
            let (alone, among) = (crossed(isa, &with, 1, k).0, crossed(isa, &with, 20, k).0);
            assert_eq!(alone, among, "{isa:?} {k}");
            let same = alone == crossed(isa, &without, 1, k).0;
            assert_eq!(same, k % 3 == 1, "{isa:?} {k}");
        }
    }
}
