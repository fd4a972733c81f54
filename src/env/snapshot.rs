//! Episodes as data: everything that the rest of an episode, and all that follow it, depend on.
//!
//! [`Shard::save`] and [`Shard::restore`] keep every bit: an environment that was restored goes on exactly as the one
//! that was saved, in any lane of any batch of the same task.

use super::ground::Ground;
use super::shard::{Episode, Shard};
use super::task::{Goal, Setup};
use crate::error::{Error, Result};
use crate::sim::model::Scene;
use crate::sim::{Model, Robot, State};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// One environment in the middle of an episode. Its options stand elsewhere: many environments share them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SavedEpisode {
    pub seed: u64,
    pub number: u64,
    pub steps: u32,
    /// Commanded speed [m/s] and yaw speed [rad/s].
    pub goal: [f64; 2],
    /// What the episode is simulated with where it drew something of its own, such as rocks.
    pub drawn: Option<Box<(Robot, Scene)>>,
    /// Of tasks whose ground changes along the way.
    pub ground: Option<Ground>,
    /// [`State::row`]
    pub state: Vec<f64>,
    /// f32 [action]
    pub last_action: Vec<f32>,
}

/// A [`SavedEpisode`] that was checked and is ready to go on.
pub struct Resumed {
    setup: Setup,
    seed: u64,
    number: u64,
    steps: u32,
    goal: Goal,
    state: State,
    last_action: Vec<f32>,
}

impl Resumed {
    /// Checks that `saved` can go on with `setup` in a task of `actions` actions.
    pub fn new(saved: &SavedEpisode, setup: &Setup, actions: usize) -> Result<Self> {
        let unfit = |why: &str| Error::invalid("snapshot", format!("an environment does not suit this task: {why}"));
        let model = match saved.drawn.as_deref() {
            Some((robot, scene)) => Some(Arc::new(Model::new(robot, scene)?)),
            None => None,
        };
        let joints = setup.model.joints();
        let state = State::from_row(joints, &saved.state).filter(State::is_sound).ok_or_else(|| unfit("its state"))?;
        let loose = model.as_deref().unwrap_or(&setup.model).objects_at_rest().len();
        if model.as_ref().is_some_and(|m| m.joints() != joints) || state.objects.len() != loose {
            return Err(unfit("its robot or its rocks"));
        }
        if saved.last_action.len() != actions || !saved.last_action.iter().all(|a| (-1.0..=1.0).contains(a)) {
            return Err(unfit("its last action"));
        }
        let legs = setup.model.legs.len();
        let grounded = setup.options.randomize.is_some();
        if saved.ground.is_some() != grounded || saved.ground.as_ref().is_some_and(|g| !g.is_sound(legs)) {
            return Err(unfit("its ground"));
        }
        if grounded && model.is_none() {
            return Err(unfit("its sand"));
        }
        let [speed, turn] = saved.goal;
        if !(speed.is_finite() && turn.is_finite()) {
            return Err(unfit("its goal"));
        }
        Ok(Self {
            setup: setup.clone(),
            seed: saved.seed,
            number: saved.number,
            steps: saved.steps,
            goal: Goal { speed, turn, model, ground: saved.ground.clone() },
            state,
            last_action: saved.last_action.clone(),
        })
    }
}

impl Shard {
    /// Environment `i` as it is now.
    pub fn save(&self, i: usize) -> SavedEpisode {
        let Episode { seed, number, steps, goal, after, last_action, .. } = &self.episodes[i];
        SavedEpisode {
            seed: *seed,
            number: *number,
            steps: *steps,
            goal: [goal.speed, goal.turn],
            drawn: goal.model.as_ref().map(|m| Box::new((m.robot.clone(), m.scene.clone()))),
            ground: goal.ground.clone(),
            state: after.row(),
            last_action: last_action.clone(),
        }
    }

    /// Environment `i` as it is now, for this shard's own use.
    pub fn keep(&self, i: usize) -> Resumed {
        let Episode { setup, seed, number, steps, goal, after, last_action, .. } = &self.episodes[i];
        let (setup, goal) = (setup.clone(), goal.clone());
        let (state, last_action) = (after.clone(), last_action.clone());
        Resumed { setup, seed: *seed, number: *number, steps: *steps, goal, state, last_action }
    }

    /// The options environment `i` has now.
    pub fn setup(&self, i: usize) -> &Setup {
        &self.episodes[i].setup
    }

    /// Lets environment `i` go on as `resumed`; fills its observation row.
    pub fn restore(&mut self, i: usize, resumed: &Resumed) {
        let Resumed { setup, seed, number, steps, goal, state, last_action } = resumed;
        let episode = &mut self.episodes[i];
        episode.setup = setup.clone();
        episode.stale = false;
        (episode.seed, episode.number, episode.steps) = (*seed, *number, *steps);
        episode.goal = goal.clone();
        episode.after.clone_from(state);
        episode.last_action.clone_from(last_action);
        self.engine.set_model(i, goal.model.as_ref().unwrap_or(&setup.model));
        self.take_up(i);
    }
}
