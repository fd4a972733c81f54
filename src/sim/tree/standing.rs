//! Does a robot stand? As in an episode with the action 0, it starts in its default pose just above the ground, and stands
//! for five seconds under its servos. A robot that stands is also set down gently, to measure how deep its feet sink.

use super::forces::pushes;
use super::kinematics::{frames, lowest};
use super::stability::fastest;
use crate::engine::{Command, Engine, EngineKind};
use crate::error::{Error, Result};
use crate::{Model, State};
use nalgebra::Vector3;

/// Time in which the weight grows from 0 to its full value [s]. Our choice, several periods of a robot on its legs: one
/// that is dropped sinks deeper into sand than one that is set down, because the sand must dissipate its energy.
const SETTING_DOWN: f64 = 2.0;
/// Time for which the robot stands [s]: our choice, so that a slow fall shows; a longer time makes the check slower.
const STANDING: f64 = 5.0;
/// Time between two changes of the weight [s]: our choice, a control step. All of `STEPS` divide it, and the weight
/// changes by less than 2 % at once.
const PERIOD: f64 = 0.02;
/// A robot stands if its base has tilted by at most 30°, its hips move with at most 5 cm/s, those of a robot with fewer than four
/// legs are not lower than half of their standing height, as in an episode, and at most a twentieth of the weight rests on bodies other than legs and feet. Our choice: a robot may
/// lean or sink, but one that falls, slides or lies on its belly does not stand.
const UPRIGHT: f64 = 0.866;
const LOW: f64 = 0.5;
const STILL: f64 = 0.05;
const BELLY: f64 = 0.05;
/// Time steps that are tried [s], the finest last. Our choice: from the largest that a scene accepts, mostly by halves;
/// all divide a control step.
const STEPS: [f64; 7] = [5e-3, 4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4, 1.25e-4];
/// Duration of a run with each of them [s]: our choice, eight periods of `BOB`; a longer one makes the check slower.
const BOB_TIME: f64 = 4.0;
/// Frequency of the joints' motion in these runs [Hz]: our choice, about as fast as legs step. A faster motion needs a
/// finer step.
const BOB: f64 = 2.0;
/// Amplitude of this motion [rad], for robots with at least four legs and with fewer: our choice, because a robot on
/// two feet tips over more easily.
const BOB_SIZE: [f64; 2] = [0.2, 0.05];
/// How often the amplitude is halved for a robot that falls: our choice; then it is some tenths of a degree.
const HALVINGS: usize = 4;
/// Time after which a robot that started just above the ground has landed [s]: our choice, several control steps.
const LANDED: f64 = 0.1;
/// Accepted mean difference of the hips' height, as a part of the standing height: our choice, because a smaller one
/// asks for finer steps, which make the simulation slower.
const ACCEPTED: f64 = 0.01;

/// How much higher the robot starts in a run that shows what any small change does [m]: our choice, a tenth of a usual grain.
const LIFT: f64 = 1e-4;

/// A foot of a standing robot.
#[derive(Clone, Debug, PartialEq)]
pub struct FootPrint {
    pub body: usize,
    /// Depth of the lowest point under the ground's surface [m].
    pub sinkage: f64,
    /// Force of the ground along its normal [N].
    pub load: f64,
    /// `load` divided by the horizontal area of the foot's plates that lead downward in the sand [Pa]; None on hard ground.
    pub pressure: Option<f64>,
}

/// The robot at the end of its time.
#[derive(Clone, Debug, PartialEq)]
pub struct Standing {
    pub stands: bool,
    /// Why it does not stand, in a few words.
    pub reason: String,
    pub state: State,
    /// Height of the middle of the hips above the ground at the end, and in the default pose [m].
    pub height: [f64; 2],
    /// Angle of the base's z axis against the ground's normal [rad].
    pub tilt: f64,
    pub feet: Vec<FootPrint>,
    /// The part of the weight that rests on bodies other than legs and feet.
    pub belly: f64,
    /// |torque| of each joint [N·m]; the same as a part of the joint's torque limit, if the limit is known.
    pub torques: Vec<(f64, Option<f64>)>,
}

fn engine(model: &Model, state: &State) -> Result<Engine> {
    let mut engine = Engine::new(EngineKind::Tree, model, 1)?;
    engine.set_state(0, state);
    Ok(engine)
}

fn start(model: &Model) -> Result<State> {
    let Some(tree) = &model.tree else { return Err(Error::invalid("robot", "is no tree of bodies")) };
    let angles = &tree.stance.angles;
    let mut state = State::at_rest(tree.height_over(angles, |x, y| model.surface_height(x, y)), angles);
    state.references.copy_from_slice(angles);
    Ok(state)
}

/// Lets the robot stand as in an episode, and measures it set down gently if it then stands, too.
pub fn stand(model: &Model) -> Result<Standing> {
    let dropped = let_down(model, 0.0)?;
    if !dropped.stands {
        return Ok(dropped);
    }
    let set_down = let_down(model, SETTING_DOWN)?;
    Ok(if set_down.stands { set_down } else { dropped })
}

/// The robot after its weight has grown from 0 within `growing` [s] and it has then stood for [`STANDING`].
fn let_down(model: &Model, growing: f64) -> Result<Standing> {
    let mut state = start(model)?;
    let mut engine = engine(model, &state)?;
    let substeps = (PERIOD / model.scene.dt).round().max(1.0) as usize;
    let count = |seconds: f64| (seconds / PERIOD).round() as usize;
    for k in 0..count(growing + STANDING) {
        let part = ((k + 1) as f64 * PERIOD / growing).min(1.0);
        if growing > 0.0 && (part < 1.0 || k == count(growing)) {
            let smooth = (1.0 - (std::f64::consts::PI * part).cos()) / 2.0;
            let gravity = model.gravity * if part < 1.0 { smooth } else { 1.0 };
            engine.set_model(0, &Model { gravity, ..model.clone() });
        }
        engine.advance(substeps);
        let mut next = state.clone();
        engine.state(0, &mut next);
        if !next.is_sound() {
            let joint = fastest(model, &state).map_or(String::new(), |name| format!(": joint {name:?} moves fastest"));
            let mut fallen = judged(model, state)?;
            (fallen.stands, fallen.reason) = (false, format!("its motion cannot be computed{joint}"));
            return Ok(fallen);
        }
        state = next;
    }
    judged(model, state)
}

fn judged(model: &Model, state: State) -> Result<Standing> {
    let Some(tree) = &model.tree else { return Err(Error::invalid("robot", "is no tree of bodies")) };
    let weight = model.weight();
    let frames = frames(&tree.tree, &state);
    let mut loads = vec![0.0; frames.len()];
    pushes(model, &state).iter().for_each(|push| loads[push.body] += push.force.z);
    let foot = |&body: &usize| {
        let low = lowest(&frames[body], &tree.contacts[body]);
        let under = |p: &&crate::sand::intruder::IntruderPlate| {
            let at = frames[body].transform_point(&Vector3::from(p.center.lane(0)).into());
            at.z < model.surface_height(at.x, at.y)
        };
        let down = |p: &crate::sand::intruder::IntruderPlate| {
            p.area * (-(frames[body].rotation * Vector3::from(p.normal.lane(0))).z).max(0.0)
        };
        let area: f64 = tree.plates[body].iter().filter(under).map(down).sum();
        let pressure = (model.has_sand() && area > 0.0).then(|| loads[body] / area);
        FootPrint { body, sinkage: model.surface_height(low.x, low.y) - low.z, load: loads[body], pressure }
    };
    let feet: Vec<FootPrint> = tree.stance.feet.iter().map(foot).collect();
    let carries =
        |body: &usize| tree.stance.feet.contains(body) || tree.stance.legs.iter().flatten().any(|b| b == body);
    let belly = (0..loads.len()).filter(|body| !carries(body)).map(|body| loads[body]).sum::<f64>().max(0.0) / weight;
    let height = [tree.hips_over(&state, |x, y| model.surface_height(x, y)), tree.stance.hips_height()];
    let up = state.rotation()[2][2];
    let speed = tree.hips_velocity(&state).norm();
    let torque = |(t, motor): (&f64, &super::gains::TreeMotor)| {
        (t.abs(), motor.actuator.torque_limit.map(|limit| t.abs() / limit))
    };
    let torques = state.torques.iter().zip(&tree.motors).map(torque).collect();
    let reason = match () {
        () if up < UPRIGHT => "it tips over",
        () if tree.stance.legs.len() < 4 && tree.is_low(&state, LOW, |x, y| model.surface_height(x, y)) => {
            "its base is lower than half of its standing height"
        }
        () if speed > STILL => "it does not come to rest",
        () if belly > BELLY => "its belly carries it",
        () => "",
    };
    Ok(Standing {
        stands: reason.is_empty(),
        reason: reason.into(),
        height,
        tilt: up.clamp(-1.0, 1.0).acos(),
        feet,
        belly,
        torques,
        state,
    })
}

/// The hips' heights of a robot whose joints bend by `size` [rad], in order, and how it keeps on its legs.
struct Bobbed {
    heights: Vec<f64>,
    /// Were its hips lower than half of their standing height?
    fell: bool,
    /// Did all feet stay on the ground after `LANDED`?
    stays: bool,
}

/// The robot with all joints bending with 2 Hz, starting higher by `lift` [m].
fn bob(model: &Model, size: f64, lift: f64) -> Result<Bobbed> {
    let mut state = start(model)?;
    state.position[2] += lift;
    let mut engine = engine(model, &state)?;
    let tree = model.tree.as_ref().ok_or_else(|| Error::invalid("robot", "is no tree of bodies"))?;
    let mut command = Command::still(model.joints());
    let mut bobbed = Bobbed { heights: Vec::new(), fell: false, stays: true };
    for k in 0..(BOB_TIME / PERIOD) as usize {
        let bend = size * (std::f64::consts::TAU * BOB * k as f64 * PERIOD).sin();
        command.targets = tree.stance.angles.iter().map(|angle| angle + bend).collect();
        engine.command(0, &command);
        engine.advance((PERIOD / model.scene.dt).round() as usize);
        engine.state(0, &mut state);
        let height = tree.hips_over(&state, |_, _| 0.0);
        bobbed.fell |= height < LOW * tree.stance.hips_height();
        if bobbed.stays && k as f64 * PERIOD > LANDED {
            let found = pushes(model, &state);
            let loaded = |foot: &usize| found.iter().any(|push| push.body == *foot && push.force.z > 0.0);
            bobbed.stays = tree.stance.feet.iter().all(loaded);
        }
        bobbed.heights.push(height);
    }
    bobbed.heights.sort_by(f64::total_cmp);
    Ok(bobbed)
}

/// How far the joints bend [rad], and the hips' heights of a run of `finest`: [`BOB_SIZE`], or, for a robot that falls then, so
/// little that all its feet stay on the ground. A fall goes its own way after any small change, so that it says nothing of
/// the step.
fn bob_size(finest: &Model) -> Result<(f64, Vec<f64>)> {
    let few = finest.tree.as_ref().is_some_and(|tree| tree.stance.legs.len() < 4);
    let mut size = BOB_SIZE[usize::from(few)];
    let mut bobbed = bob(finest, size, 0.0)?;
    if bobbed.fell {
        for _ in 0..HALVINGS {
            size /= 2.0;
            bobbed = bob(finest, size, 0.0)?;
            if bobbed.stays {
                break;
            }
        }
    }
    Ok((size, bobbed.heights))
}

/// The largest time step in `STEPS` that is fine enough, or None. In the test all joints bend with 2 Hz. The distribution of the
/// hips' heights may differ from that of a run at 0.125 ms, on average over its quantiles, by at most 1 % of the standing height,
/// and by what another start, 0.1 mm higher, changes at 0.125 ms: a robot that hops or slides goes its own way after any small
/// change, which says nothing of the step. `model_at`: makes the model with a given time step.
pub fn needed_step(model_at: impl Fn(f64) -> Result<Model>) -> Result<Option<f64>> {
    let finest = model_at(STEPS[STEPS.len() - 1])?;
    let (size, plain) = bob_size(&finest)?;
    let heights = |model: &Model, lift: f64| Ok::<_, Error>(bob(model, size, lift)?.heights);
    let off = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f64>() / a.len() as f64;
    let lifted = heights(&finest, LIFT)?;
    let most = ACCEPTED * finest.tree.as_ref().map_or(0.0, |tree| tree.stance.hips_height());
    let most = most + off(&lifted, &plain);
    for dt in &STEPS[..STEPS.len() - 1] {
        if off(&heights(&model_at(*dt)?, 0.0)?, &plain) <= most {
            return Ok(Some(*dt));
        }
    }
    Ok(None)
}

/// Measures for `seconds` how many control steps a second one thread makes with 16 robots in their default pose.
pub fn speed(model: &Model, control_rate: f64, seconds: f64) -> Result<f64> {
    let count = EngineKind::Tree.shard_size();
    let state = start(model)?;
    let mut engine = Engine::new(EngineKind::Tree, model, count)?;
    (0..count).for_each(|i| engine.set_state(i, &state));
    let substeps = (1.0 / control_rate / model.scene.dt).round() as usize;
    (0..10).for_each(|_| engine.advance(substeps));
    let (begin, mut steps) = (std::time::Instant::now(), 0);
    while begin.elapsed().as_secs_f64() < seconds {
        engine.advance(substeps);
        steps += count;
    }
    Ok(steps as f64 / begin.elapsed().as_secs_f64())
}
