//! Can a robot's motion be computed? Robots in all lanes of a block are moved by their servos for a short time.

use crate::engine::{Command, Engine, EngineKind};
use crate::error::{Error, Result};
use crate::{Model, State};

/// Duration [s]: our choice, several falls of a robot onto the ground. A longer one makes the reading of a file slower.
const SHAKEN: f64 = 2.0;
/// Time between two commands [s]: a control step.
const PERIOD: f64 = 0.02;
/// Largest offset of a target from the default pose [rad], as the largest scale of LeggedVelocity's actions; a slide takes
/// this part of the legs' length [m].
const OFFSET: f64 = 0.5;
const SLIDE: f64 = 0.25;

/// The name of the joint that moves fastest; None: the robot has no joints.
pub fn fastest(model: &Model, state: &State) -> Option<String> {
    let size = |i: &usize| {
        let rate = state.rates[*i].abs();
        if rate.is_nan() { f64::INFINITY } else { rate }
    };
    let joint = (0..state.rates.len()).max_by(|a, b| size(a).total_cmp(&size(b)))?;
    model.joint_names().get(joint).cloned()
}

/// The joint that moves fastest when a robot's motion can no longer be computed; None: it can. One robot stands in its
/// default pose; the targets of the others jump to random places, of half of them to the ends of their ranges.
pub fn first_to_diverge(model: &Model) -> Result<Option<String>> {
    let Some(tree) = &model.tree else { return Err(Error::invalid("robot", "is no tree of bodies")) };
    let (count, angles) = (EngineKind::Tree.shard_size(), &tree.stance.angles);
    let mut start = State::at_rest(tree.height_over(angles, |x, y| model.surface_height(x, y)), angles);
    start.references.copy_from_slice(angles);
    let mut engine = Engine::new(EngineKind::Tree, model, count)?;
    (0..count).for_each(|i| engine.set_state(i, &start));
    let sizes: Vec<f64> = tree.tree.joints().map(|joint| size(joint, tree.stance.leg_length)).collect();
    let mut before = vec![start.clone(); count];
    let (mut draws, mut command) = (0.0, Command::still(model.joints()));
    for _ in 0..(SHAKEN / PERIOD).round() as usize {
        for lane in 0..count {
            let target = |(angle, size): (&f64, &f64)| {
                // Multiples of the golden ratio without their whole part are spread evenly.
                draws += 1.0;
                let part = 2.0 * (draws * 0.618_033_988_749_895_f64).fract() - 1.0;
                let part = if lane % 2 == 0 { part } else { part.signum() };
                angle + if lane == 0 { 0.0 } else { part * size }
            };
            command.targets = angles.iter().zip(&sizes).map(target).collect();
            engine.command(lane, &command);
        }
        engine.advance((PERIOD / model.scene.dt).round().max(1.0) as usize);
        for (lane, last) in before.iter_mut().enumerate() {
            let mut next = last.clone();
            engine.state(lane, &mut next);
            if !next.is_sound() {
                return Ok(fastest(model, last));
            }
            *last = next;
        }
    }
    Ok(None)
}

fn size(joint: &super::TreeJoint, leg_length: f64) -> f64 {
    match joint.kind {
        super::JointKind::Hinge => OFFSET,
        super::JointKind::Slide => joint.range.map_or(SLIDE * leg_length, |[low, high]| (high - low) / 2.0),
    }
}
