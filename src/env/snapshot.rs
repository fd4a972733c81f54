//! Episodes as data: everything that the rest of an episode, and all later episodes, depend on.
//!
//! [`Shard::save`] and [`Shard::restore`] keep every bit: a restored environment goes on exactly as the saved
//! environment, in any lane of any batch of the same task.
//!
//! Snapshots of another version are refused, because their continuation might differ. `Task::resume` checks what an episode has
//! drawn; these values must not determine how much memory is allocated.

use super::episode::{Before, Episode};
use super::ground::UsedGround;
use super::legged::episode::LeggedEpisode;
use super::rocks::CORNERS;
use super::sensors::{ActionDelay, SensorMemory};
use super::shard::Shard;
use super::task::{AnyTask, TaskState};
use crate::error::{Error, Result, check_range};
use crate::sand::memory::Moved;
use crate::sim::model::Scene;
use crate::sim::obstacle::{Obstacle, ObstacleShape};
use crate::sim::{Model, Robot, State};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// One environment in the middle of an episode. Its options are stored elsewhere, because many environments share
/// them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SavedEpisode {
    pub seed: u64,
    pub number: u64,
    pub steps: u32,
    /// Commanded speed [m/s] and yaw speed [rad/s].
    pub goal: [f64; 2],
    /// Robot and scene, if the episode drew parts of them, such as rocks.
    pub drawn: Option<Box<(Robot, Scene)>>,
    /// The ground of tasks with patches or footprints.
    pub ground: Option<UsedGround>,
    /// Values of an episode of LeggedVelocity, from which the model is built again.
    #[serde(default)]
    pub legged: Option<LeggedEpisode>,
    /// [`State::row`]
    pub state: Vec<f64>,
    /// f32 [action]
    pub last_action: Vec<f32>,
    /// What the sensors remember: [`SensorMemory::numbers`].
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sensed: Vec<f32>,
    /// Actions that are on their way to the motors.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub delayed: Vec<f32>,
    /// The sand that was moved: [`Moved::to_bytes`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sand: Option<Vec<u8>>,
}

/// Episodes as CBOR. Their readers and writers are long, so they are compiled here, and not again in each crate that keeps episodes.
impl SavedEpisode {
    /// # Errors
    /// The reason, which does not occur with memory as the target.
    pub fn to_cbor(&self) -> std::result::Result<Vec<u8>, String> {
        to_cbor(self)
    }

    /// # Errors
    /// What is wrong with the bytes.
    pub fn from_cbor(bytes: &[u8]) -> std::result::Result<Self, String> {
        from_cbor(bytes)
    }

    /// Many episodes.
    ///
    /// # Errors
    /// See [`Self::to_cbor`].
    pub fn all_to_cbor(episodes: &[Self]) -> std::result::Result<Vec<u8>, String> {
        to_cbor(episodes)
    }

    /// # Errors
    /// See [`Self::from_cbor`].
    pub fn all_from_cbor(bytes: &[u8]) -> std::result::Result<Vec<Self>, String> {
        from_cbor(bytes)
    }
}

fn to_cbor<T: Serialize + ?Sized>(whole: &T) -> std::result::Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    ciborium::into_writer(whole, &mut bytes).map_err(|e| e.to_string())?;
    Ok(bytes)
}

fn from_cbor<T: DeserializeOwned>(bytes: &[u8]) -> std::result::Result<T, String> {
    ciborium::from_reader(bytes).map_err(|e| e.to_string())
}

impl Episode {
    /// Checks that `saved` can go on as an episode of `task`.
    pub fn resume(saved: &SavedEpisode, task: &Arc<dyn AnyTask>) -> Result<Self> {
        let unfit = |why: &str| Error::invalid("snapshot", format!("an environment does not suit this task: {why}"));
        let model = saved.drawn.as_deref().map(|(robot, scene)| drawn(robot, scene, &**task)).transpose();
        let model = model.map_err(|e| unfit(&e.to_string()))?.map(Arc::new);
        let [speed, turn] = saved.goal;
        // Our choice of the bound: far above the commands of all tasks.
        if !saved.goal.iter().all(|g| g.abs() < 1e3) {
            return Err(unfit("its goal"));
        }
        let mut task_state =
            TaskState { speed, turn, model, ground: saved.ground.clone(), legged: saved.legged.clone() };
        task.resume(&mut task_state).map_err(|why| unfit(&why))?;
        task.draw_motors(&mut task_state, saved.seed, saved.number);
        let own = task.model();
        let state =
            State::from_row(own.joints(), &saved.state).filter(State::is_possible).ok_or_else(|| unfit("its state"))?;
        if state.objects.len() != task_state.model.as_ref().unwrap_or(own).objects_at_rest().len() {
            return Err(unfit("its rocks"));
        }
        let mut state = state;
        let settings = task_state.model.as_ref().unwrap_or(own).scene.memory;
        state.sand = match (&saved.sand, settings) {
            (None, None) => None,
            (Some(bytes), Some(settings)) => {
                let sand = Moved::from_bytes(&settings, own.sand_bodies(), bytes).ok_or_else(|| unfit("its sand"))?;
                Some(Box::new(sand))
            }
            _ => return Err(unfit("its sand")),
        };
        let (actions, last) = (task.spec().action.len(), &saved.last_action);
        if last.len() != actions || !last.iter().all(|a| (-1.0..=1.0).contains(a)) {
            return Err(unfit("its last action"));
        }
        // Both are counts from 0, so larger numbers are impossible.
        if saved.steps > task.spec().max_episode_steps || saved.number > u64::MAX / 2 {
            return Err(unfit("its counters"));
        }
        let sensed = match task.sensing() {
            None => Some(SensorMemory::default()).filter(|_| saved.sensed.is_empty()),
            Some(sensors) => sensors.resume(&saved.sensed, [saved.seed, saved.number]),
        };
        let sensed = sensed.ok_or_else(|| unfit("what its sensors remember"))?;
        let period = 1.0 / task.spec().control_rate;
        let drawn = [saved.seed, saved.number];
        let delay = ActionDelay::draw(task.action_delay(), drawn, actions, [period, own.scene.dt]);
        let delay = delay.resume(&saved.delayed).ok_or_else(|| unfit("its delayed actions"))?;
        let (task, last_action) = (task.clone(), last.clone());
        let SavedEpisode { seed, number, steps, .. } = *saved;
        Ok(Self { task, seed, number, steps, task_state, state, last_action, sensed, delay })
    }
}

/// The model of an episode that drew parts of its model. Masses, sand and slope are checked like any other input. All
/// numbers of parts, on which the memory depends, must equal those of `task`.
fn drawn(robot: &Robot, scene: &Scene, task: &dyn AnyTask) -> Result<Model> {
    let own = task.model();
    if !robot.is_variant_of(&own.robot) {
        return Err(Error::invalid("robot", "it is not the robot of the session"));
    }
    let mut same = own.scene.clone();
    same.medium.coefficients = scene.medium.coefficients;
    (same.slope_deg, same.payload, same.mechanisms) = (scene.slope_deg, scene.payload, scene.mechanisms);
    same.obstacles.clone_from(&scene.obstacles);
    if same != *scene {
        return Err(Error::invalid("scene", "it is not the scene of the session"));
    }
    // The largest value that options allow, times the largest ζ of a patch.
    for c in scene.medium.coefficients.to_array() {
        check_range("coefficients", c, -1e9..=1e9)?;
    }
    let most = task.most_obstacles();
    check_range("number of rocks", scene.obstacles.len() as f64, 0.0..=most as f64)?;
    let corners = |o: &Obstacle| if let ObstacleShape::Hull { points } = &o.shape { points.len() } else { 0 };
    if scene.obstacles.iter().any(|o| corners(o) > CORNERS) {
        return Err(Error::invalid("rocks", format!("one has more than {CORNERS} corners")));
    }
    Model::new(robot, scene)
}

impl Shard {
    /// Environment `i`'s present episode as data.
    pub fn save(&self, i: usize) -> SavedEpisode {
        let Episode { seed, number, steps, task_state, state, last_action, sensed, delay, .. } =
            &self.environments[i].episode;
        SavedEpisode {
            sensed: sensed.numbers(),
            delayed: delay.numbers().to_vec(),
            seed: *seed,
            number: *number,
            steps: *steps,
            goal: [task_state.speed, task_state.turn],
            drawn: match task_state.legged {
                Some(_) => None,
                None => task_state.model.as_ref().map(|m| Box::new((m.robot.clone(), m.scene.clone()))),
            },
            ground: task_state.ground.clone(),
            legged: task_state.legged.clone(),
            state: state.row(),
            last_action: last_action.clone(),
            sand: self.engine.sand(i).map(Moved::to_bytes),
        }
    }

    /// A copy of environment `i`'s present episode, with the sand that was moved.
    pub fn keep(&self, i: usize) -> Episode {
        let mut episode = self.environments[i].episode.clone();
        episode.state.sand = self.engine.sand(i).cloned().map(Box::new);
        episode
    }

    /// The task of environment `i` with its present options and model.
    pub fn task(&self, i: usize) -> &Arc<dyn AnyTask> {
        &self.environments[i].episode.task
    }

    /// Continues environment `i` with `episode`, and fills its observation row.
    pub fn restore(&mut self, i: usize, episode: &Episode) {
        self.engine.set_model(i, episode.model());
        self.put_back(i, episode);
    }

    /// Continues environment `i`, whose engine has the model of `episode`, with `episode`.
    pub(super) fn put_back(&mut self, i: usize, episode: &Episode) {
        self.unfinished = None;
        let environment = &mut self.environments[i];
        (environment.begun, environment.stale) = (true, false);
        environment.episode.clone_from(episode);
        self.take_up(i, Before::Restore);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registry::{Blueprint, TASK_IDS};
    use serde_json::Value;

    /// An environment of each task after some steps.
    fn saved() -> Vec<(Blueprint, SavedEpisode)> {
        let one = |id: &&str| {
            let blueprint = Blueprint::new(id, Value::Null).unwrap();
            let mut shard = Shard::new(&blueprint, 1).unwrap();
            shard.reset(|_| true, Some(&[3]), |_| None);
            (0..5).for_each(|_| shard.step(&vec![0.3; blueprint.task.spec().action.len()]));
            let saved = shard.save(0);
            (blueprint, saved)
        };
        TASK_IDS.iter().map(one).collect()
    }

    fn resume(blueprint: &Blueprint, saved: &SavedEpisode) -> Result<Episode> {
        Episode::resume(saved, &blueprint.task)
    }

    type Change = (&'static str, fn(&mut Robot, &mut Scene));

    /// Values that no episode can have drawn.
    const CRAFTED: [Change; 20] = [
        ("many plates", |r, _| r.belly.iter_mut().for_each(|b| b.plates = [6000, 6000])),
        ("more plates than memory", |r, _| r.belly.iter_mut().for_each(|b| b.plates = [100_000, 100_000])),
        ("one plate more", |r, _| r.belly.iter_mut().for_each(|b| b.plates[0] += 1)),
        ("no plates", |r, _| r.belly.iter_mut().for_each(|b| b.plates = [0, 0])),
        ("a long name", |r, _| r.name = "x".repeat(100_000)),
        ("segments", |r, _| r.leg.link.iter_mut().filter_map(|l| l.sand.as_mut()).for_each(|s| s.segments = 1 << 40)),
        ("one segment more", |r, _| {
            r.leg.link.iter_mut().filter_map(|l| l.sand.as_mut()).for_each(|s| s.segments += 1)
        }),
        ("a shape", |r, _| r.leg.link.iter_mut().filter_map(|l| l.sand.as_mut()).for_each(|s| s.shape = "C".into())),
        ("a hip more", |r, _| r.hip.push(r.hip[0].clone())),
        ("no hips", |r, _| r.hip.clear()),
        ("another link", |r, _| r.leg.link.push(r.leg.link[0].clone())),
        ("no mass", |r, _| r.base.mass = f64::NAN),
        ("a light link", |r, _| r.leg.link[0].mass = 0.0),
        ("a servo without end", |r, _| r.servo.kp = f64::INFINITY),
        ("a steep slope", |_, s| s.slope_deg = 80.0),
        ("a time step", |_, s| s.dt = 1e-6),
        ("a payload", |_, s| s.payload = -1.0),
        ("sand like diamond", |_, s| s.medium.coefficients = s.medium.coefficients.scaled(1e12)),
        ("a name of sand", |_, s| s.medium.name = "x".repeat(100_000)),
        ("walls", |_, s| s.obstacles = vec![Obstacle::block([9.0; 2], [0.1; 2], 0.1, 0.0); 257]),
    ];

    #[test]
    fn a_crafted_robot_is_refused_in_every_task() {
        for (blueprint, honest) in saved() {
            resume(&blueprint, &honest).unwrap();
            if blueprint.task.model().tree.is_some() {
                continue; // This task draws no robot: see the next test
            }
            let id = blueprint.task.spec().id;
            let own = || Box::new((blueprint.task.model().robot.clone(), blueprint.task.model().scene.clone()));
            for (what, change) in CRAFTED {
                let mut crafted = honest.clone();
                let drawn = crafted.drawn.get_or_insert_with(own);
                if what.contains("plate") && drawn.0.belly.is_none() {
                    continue;
                }
                let before = drawn.clone();
                change(&mut drawn.0, &mut drawn.1);
                if *drawn == before {
                    // LegStroke has a leg of this shape, but its snapshots contain no robot, so a snapshot with a robot
                    // is refused.
                    assert_eq!(id, "sandgait/LegStroke-v0", "{what}");
                }
                let error = resume(&blueprint, &crafted).err().unwrap_or_else(|| panic!("{id}: {what} is taken"));
                assert!(
                    error.to_string().starts_with("snapshot: an environment does not suit"),
                    "{id}: {what}: {error}"
                );
            }
            let swapped = SavedEpisode { drawn: honest.drawn.clone().xor(Some(own())), ..honest.clone() };
            assert!(resume(&blueprint, &swapped).is_err(), "{id}");
        }
    }

    #[test]
    fn what_a_legged_episode_drew_is_checked() {
        let (blueprint, honest) = saved().into_iter().find(|(b, _)| b.task.model().tree.is_some()).unwrap();
        let with = |change: &dyn Fn(&mut LeggedEpisode)| {
            let mut crafted = honest.clone();
            change(crafted.legged.as_mut().unwrap());
            resume(&blueprint, &crafted).is_ok()
        };
        assert!(with(&|_| ()));
        assert!(!with(&|l| l.friction = f64::NAN));
        assert!(!with(&|l| l.sand = 1e9));
        assert!(!with(&|l| l.added_mass = -1e3));
        assert!(!with(&|l| l.motor_strength = 0.0));
        assert!(!with(&|l| l.air.push(0.0)));
        assert!(!with(&|l| l.air.clear()));
        assert!(!with(&|l| l.commands.clear()));
        assert!(!with(&|l| l.commands[0][1] = 1e9));
        assert!(!with(&|l| l.pushes = vec![[0.0; 2]; 100_000]));
        assert!(resume(&blueprint, &SavedEpisode { legged: None, ..honest.clone() }).is_err());
    }

    #[test]
    fn rocks_are_no_more_than_the_session_draws() {
        let (blueprint, honest) = saved().into_iter().find(|(b, _)| b.task.most_obstacles() > 0).unwrap();
        let with = |change: &dyn Fn(&mut Vec<Obstacle>)| {
            let mut crafted = honest.clone();
            change(&mut crafted.drawn.as_mut().unwrap().1.obstacles);
            resume(&blueprint, &crafted).is_ok()
        };
        let fixed = || Obstacle::block([9.0; 2], [0.1; 2], 0.1, 0.0);
        assert!(with(&|_| ()));
        assert!(!with(&|all| all.resize(17, fixed())), "the options say 16");
        let hull = |corners| {
            let point = |k: usize| [(k as f64).sin(), (k as f64).cos(), (k as f64 * 0.7).sin()].map(|c| 0.01 * c);
            let points = (0..corners).map(point).collect();
            Obstacle::fixed(ObstacleShape::Hull { points }, [9.0, 0.0, 0.0])
        };
        let last_fixed = |all: &[Obstacle]| all.iter().rposition(|o| !o.moves()).unwrap();
        assert!(with(&|all| {
            let k = last_fixed(all);
            all[k] = hull(12);
        }));
        assert!(!with(&|all| {
            let k = last_fixed(all);
            all[k] = hull(64);
        }));
    }

    #[test]
    fn other_impossible_episodes() {
        type Change = (&'static str, fn(&mut SavedEpisode));
        let wrong: [Change; 10] = [
            ("orientation", |s| s.state[3..7].fill(0.0)),
            ("position", |s| s.state[0] = f64::NAN),
            ("references", |s| *s.state.last_mut().unwrap() = f64::INFINITY),
            ("work", |s| s.state[13] = f64::NAN),
            ("length", |s| s.state.push(0.0)),
            ("steps", |s| s.steps = u32::MAX),
            ("number", |s| s.number = u64::MAX),
            ("goal", |s| s.goal[0] = 1e300),
            ("action", |s| s.last_action[0] = 2.0),
            ("actions", |s| s.last_action.push(0.0)),
        ];
        for (blueprint, honest) in saved() {
            for (what, change) in wrong {
                let mut crafted = honest.clone();
                change(&mut crafted);
                assert!(resume(&blueprint, &crafted).is_err(), "{}: {what}", blueprint.task.spec().id);
            }
        }
    }
}
