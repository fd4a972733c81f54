//! Sums over one episode, and figures from them. `docs/evaluate.md` has the definitions with their reasons.

use crate::env::{Shard, Spec};
use crate::error::{Error, Result};
use crate::sim::feet::feet;

/// Indices of a step's figures in an info row.
#[derive(Clone, Copy)]
pub struct Columns {
    x_velocity: usize,
    commanded_speed: usize,
    work: usize,
    diverged: usize,
}

impl Columns {
    /// Finds the columns; refuses tasks in which robots do not walk.
    pub fn of(spec: &Spec) -> Result<Self> {
        let place = |name: &str| {
            let at = spec.info.iter().position(|c| c.name == name);
            at.ok_or_else(|| Error::invalid("task", format!("{} has no {name}: it is no walking task", spec.id)))
        };
        Ok(Self {
            x_velocity: place("x_velocity")?,
            commanded_speed: place("commanded_speed")?,
            work: place("work")?,
            diverged: place("diverged")?,
        })
    }
}

/// Sums over the steps of one episode.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EpisodeSums {
    pub seed: u64,
    /// Sum of rewards.
    pub total_reward: f64,
    /// Duration [s].
    pub time: f64,
    /// Distance along +x, uphill [m]; negative if backward.
    pub distance: f64,
    /// Distance that the commanded speed would give [m].
    pub commanded: f64,
    /// ∫ Σ|τ ω| dt over all joints [J].
    pub work: f64,
    /// Weight of robot and payload [N].
    pub weight: f64,
    /// Distance that the base moved while at least one foot was in the sand [m], and the distance that it would have
    /// moved if the feet had not moved in the sand [m]. The slip of the gait is computed from both.
    pub carried: f64,
    pub without_slip: f64,
    /// The robot flipped or was buried.
    pub fell: bool,
    /// The simulation failed; the sums end there.
    pub diverged: bool,
    pub over: bool,
}

impl EpisodeSums {
    /// Stores the state of environment `i` before a step of `period` [s].
    pub fn look(&mut self, shard: &Shard, i: usize, period: f64) {
        let (model, state) = (shard.model(i), shard.state(i));
        self.weight = model.weight();
        let in_sand = feet(model, state).filter(|foot| foot.position[2] < 0.0);
        let (count, sliding) = in_sand.fold((0.0, 0.0), |(n, sum), foot| (n + 1.0, sum + foot.velocity[0]));
        if count > 0.0 {
            let speed = state.velocity[0];
            self.carried += speed * period;
            self.without_slip += (speed - sliding / count) * period;
        }
    }

    /// Adds the step that environment `i` has just made.
    pub fn add(&mut self, shard: &Shard, i: usize, columns: Columns, period: f64) {
        let rows = &shard.rows;
        let info = rows.infos.len() / rows.rewards.len();
        let figure = |column: usize| f64::from(rows.infos[i * info + column]);
        self.total_reward += f64::from(rows.rewards[i]);
        self.time += period;
        self.distance += figure(columns.x_velocity) * period;
        self.commanded += figure(columns.commanded_speed) * period;
        self.work += figure(columns.work);
        self.fell = rows.terminated[i] > 0;
        self.diverged = figure(columns.diverged) > 0.0;
        self.over = rows.terminated[i] + rows.truncated[i] > 0;
    }

    /// Mean forward speed [m/s].
    pub fn speed(&self) -> f64 {
        self.distance / self.time
    }

    /// |mean speed − commanded speed| [m/s].
    pub fn speed_error(&self) -> f64 {
        ((self.distance - self.commanded) / self.time).abs()
    }
}
