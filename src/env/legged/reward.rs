//! Terms of the reward of LeggedVelocity: names and laws of legged_gym (`_reward_…` in `legged_robot.py`).

use super::{LeggedEpisode, base};
use crate::locomotion::CONTROL_RATE;
use crate::sim::tree::stance::{frames, lowest};
use crate::sim::{Model, State};
use crate::task::Transition;

/// σ of the tracking terms [m²/s², rad²/s²].
const TRACKING: f64 = 0.25;
/// Time in the air that a step is paid for beyond [s].
const AIR: f64 = 0.5;
/// Commanded speed below which a robot should stand [m/s].
const STANDING: f64 = 0.1;
/// Share of a joint's range at its end that it should keep out of (A1: soft limits of 0.9).
const OUTER: f64 = 0.05;

/// Which bodies are in the ground.
pub struct Contacts {
    /// In the order of the stance's feet.
    pub feet: Vec<bool>,
    pub base: bool,
    /// Bodies that are neither.
    pub others: usize,
}

impl Contacts {
    pub fn of(model: &Model, state: &State) -> Self {
        let Some(tree) = &model.tree else { return Self { feet: Vec::new(), base: false, others: 0 } };
        let frames = frames(&tree.tree, state);
        let touches = |i: usize| lowest(&frames[i], &tree.contacts[i]).z < 0.0;
        let feet = &tree.stance.feet;
        let others = (1..frames.len()).filter(|i| !feet.contains(i) && touches(*i)).count();
        Self { feet: feet.iter().map(|i| touches(*i)).collect(), base: touches(0), others }
    }
}

/// Before they are weighted, in the order of [`crate::options::Rewards`].
pub fn terms(t: &Transition, legged: &LeggedEpisode, contacts: &Contacts, rest: &[f64], ended: bool) -> [f64; 13] {
    let [gravity, v, w] = base(t.after);
    let [x, y, yaw] = legged.now;
    let square = |x: f64| x * x;
    let squares = |all: &[f64]| all.iter().map(|x| x * x).sum::<f64>();
    let commanded = x.hypot(y);
    let changes = t.after.rates.iter().zip(&t.before.rates).map(|(after, before)| square((after - before) / t.period));
    let actions = t.action.iter().zip(t.previous_action).map(|(a, b)| square(f64::from(a - b)));
    let landed = legged.air.iter().zip(&contacts.feet).filter(|(air, touches)| **air > 0.0 && **touches);
    let air = landed.map(|(air, _)| air + 1.0 / CONTROL_RATE - AIR).sum::<f64>();
    let off = t.after.angles.iter().zip(rest).map(|(q, rest)| (q - rest).abs());
    [
        (-(square(v[0] - x) + square(v[1] - y)) / TRACKING).exp(),
        (-square(w[2] - yaw) / TRACKING).exp(),
        square(v[2]),
        square(w[0]) + square(w[1]),
        square(gravity[0]) + square(gravity[1]),
        squares(&t.after.torques),
        changes.sum(),
        actions.sum(),
        if commanded > STANDING { air } else { 0.0 },
        contacts.others as f64,
        beyond(t.model, t.after),
        if commanded < STANDING { off.sum() } else { 0.0 },
        f64::from(u8::from(ended)),
    ]
}

/// Way of all joints into the outer parts of their ranges [rad].
fn beyond(model: &Model, state: &State) -> f64 {
    let Some(tree) = &model.tree else { return 0.0 };
    let way = |(joint, q): (&crate::sim::tree::TreeJoint, &f64)| {
        let [low, high] = joint.range?;
        let outer = OUTER * (high - low);
        Some((low + outer - q).max(q - high + outer).max(0.0))
    };
    tree.tree.joints().zip(&state.angles).filter_map(way).sum()
}
