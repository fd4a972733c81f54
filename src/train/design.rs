//! Design studies in which every design gets a gait of its own: designs of a grid, several trainings of each, and the best
//! of them compared on seeds that neither the trainings nor the choice has seen.

use super::export::onnx;
use super::learner::{Learnt, Plan};
use super::settings::Settings;
use crate::env::Task;
use crate::env::gait::HexapodGait;
use crate::env::registry::Blueprint;
use crate::error::{Error, Result, check_range};
use crate::evaluate::FIRST_SEED;
use crate::evaluate::episode::Episode;
use crate::evaluate::gait::Gait;
use crate::evaluate::run::{Job, play};
use crate::parallel;
use crate::policy::Network;
use crate::progress::{Progress, Silent};
use crate::sim::Model;
use crate::sweep::{Axis, Design, table};
use serde_json::{Map, Value, json};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Seeds by which designs are ranked: no result is reported for them. Two blocks of lanes.
const CHOICE_SEEDS: std::ops::Range<u64> = 3_000_000..3_000_032;
/// Seeds of the comparison, as evaluations have them.
const SEEDS: usize = 100;
/// Designs that are compared at the end, the best by the choice: our choice.
const COMPARED: usize = 3;
/// Most trainings of a study: our choice of guard, some days.
const MOST_TRAININGS: usize = 10_000;

/// What is asked for.
pub struct Study {
    pub base: Design,
    pub axes: Vec<Axis>,
    /// Options of the task that the design does not have, such as `command`.
    pub options: Map<String, Value>,
    /// With the time of each training on one thread.
    pub settings: Settings,
    /// Trainings of each design.
    pub trainings: usize,
    /// If given, designs after the first on the last axis begin with what their neighbour has learnt, and learn for so long [s].
    pub warm: Option<f64>,
}

/// What is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measure {
    Return,
    Speed,
    CostOfTransport,
}

impl Measure {
    pub const ALL: [Self; 3] = [Self::Return, Self::Speed, Self::CostOfTransport];

    pub fn named(name: &str) -> Result<Self> {
        let known = Self::ALL.map(Self::name);
        Self::ALL.into_iter().find(|m| m.name() == name).ok_or_else(|| Error::unknown("measure", name, &known))
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::Return => "return",
            Self::Speed => "speed",
            Self::CostOfTransport => "cost-of-transport",
        }
    }

    pub fn label(self) -> &'static str {
        match self {
            Self::Return => "return of an episode",
            Self::Speed => "forward speed [m/s]",
            Self::CostOfTransport => "cost of transport",
        }
    }

    /// Over all episodes of a policy.
    fn of(self, episodes: &[Episode]) -> f64 {
        let sum = |term: fn(&Episode) -> f64| episodes.iter().map(term).sum::<f64>();
        match self {
            Self::Return => sum(|e| e.total_reward) / episodes.len() as f64,
            Self::Speed => sum(|e| e.distance) / sum(|e| e.time),
            Self::CostOfTransport => {
                let way = sum(|e| e.weight * e.distance);
                if way > 0.0 { sum(|e| e.work) / way } else { f64::INFINITY }
            }
        }
    }

    /// Smaller is better; what is not a number is worst.
    fn cost(self, value: f64) -> f64 {
        let cost = if self == Self::CostOfTransport { value } else { -value };
        if cost.is_nan() { f64::INFINITY } else { cost }
    }
}

/// A gait that was learnt.
pub struct Trained {
    pub onnx: Vec<u8>,
    pub steps: u64,
    /// Each measure over the seeds of the choice.
    pub chosen_by: [f64; 3],
}

/// Mean over trainings, and its 95 % interval by Student's t; without ends where there is one training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Between {
    pub mean: f64,
    pub half: f64,
}

impl Between {
    pub fn of(values: &[f64]) -> Self {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / (n - 1.0);
        let half = if values.len() > 1 { student(values.len() - 1) * (variance / n).sqrt() } else { f64::NAN };
        Self { mean, half }
    }
}

/// 97.5 % point of Student's t distribution (Fisher & Yates, Statistical Tables, table III); beyond the table that of its last row,
/// which is a little too wide.
fn student(freedom: usize) -> f64 {
    const POINTS: [f64; 10] = [12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228];
    POINTS[freedom.clamp(1, POINTS.len()) - 1]
}

/// A design in the comparison.
pub struct Compared {
    /// Number of the design in the grid.
    pub design: usize,
    /// Each measure over the unseen seeds, one a training.
    pub values: [Vec<f64>; 3],
}

/// What a study found.
pub struct Findings {
    /// One row a design in the order of the grid, the last axis fastest; one entry a training.
    pub trained: Vec<Vec<Trained>>,
    /// The best ones by the measure, best first.
    pub best: Vec<Compared>,
}

impl Study {
    /// Refuses what no training could begin with.
    pub fn check(&self) -> Result<usize> {
        let designs: usize = self.axes.iter().map(|a| a.values.len()).product();
        check_range("number of trainings", (designs * self.trainings) as f64, 1.0..=MOST_TRAININGS as f64)?;
        let gaits = ["frequency", "phase"];
        if let Some(axis) = self.axes.iter().find(|a| gaits.contains(&a.parameter.name)) {
            return Err(Error::invalid(axis.parameter.name, "each design learns its own with --learn"));
        }
        (0..designs).try_for_each(|design| self.plan(design, 0).map(drop))?;
        Ok(designs)
    }

    /// The training number `training` of design `design`.
    fn plan(&self, design: usize, training: usize) -> Result<Plan> {
        let mut changed = self.base.clone();
        for (axis, value) in self.axes.iter().zip(table::values(&self.axes, design)) {
            axis.parameter.set(&mut changed, value)?;
        }
        let mut options = self.options.clone();
        if let Some(limit) = changed.robot.servo.torque_limit {
            options.insert("torque_limit".into(), json!(limit));
        }
        let blueprint = Blueprint::new(HexapodGait::ID, Value::Object(options))?;
        // As the task has its servos.
        changed.robot.servo.torque_limit = blueprint.task.option("torque_limit").as_f64();
        changed.robot.servo.anti_windup = true;
        let blueprint = blueprint.with_model(Model::new(&changed.robot, &changed.scene)?)?;
        Plan::new(blueprint, self.settings.clone(), training as u64, 1)
    }

    /// Learns, chooses and compares. An error of `progress` stops the work.
    pub fn run(&self, measure: Measure, progress: &dyn Progress) -> Result<Findings> {
        let designs = self.check()?;
        let trained = self.train(designs, progress)?;
        let mean = |design: &usize| {
            let place = Measure::ALL.iter().position(|m| *m == measure).unwrap_or(0);
            let all = trained[*design].iter().map(|t| t.chosen_by[place]);
            measure.cost(all.sum::<f64>() / self.trainings as f64)
        };
        let mut order: Vec<usize> = (0..designs).collect();
        order.sort_by(|a, b| mean(a).total_cmp(&mean(b)));
        let compare = |design: &usize| {
            let seeds: Vec<u64> = (FIRST_SEED..).take(SEEDS).collect();
            let played = trained[*design].iter().enumerate();
            let played = played.map(|(k, t)| self.measures(*design, k, &t.onnx, &seeds)).collect::<Result<Vec<_>>>()?;
            let values = [0, 1, 2].map(|m| played.iter().map(|all| all[m]).collect());
            Ok(Compared { design: *design, values })
        };
        let best = order.iter().take(COMPARED).map(compare).collect::<Result<_>>()?;
        Ok(Findings { trained, best })
    }

    /// All trainings: chains of neighbours where these are warm-started, else each for itself; one thread a training.
    fn train(&self, designs: usize, progress: &dyn Progress) -> Result<Vec<Vec<Trained>>> {
        let length = match self.warm {
            Some(_) => self.axes.last().map_or(1, |axis| axis.values.len()),
            None => 1,
        };
        let starts = (0..designs).step_by(length);
        let chains: Vec<[usize; 2]> = starts.flat_map(|d| (0..self.trainings).map(move |t| [d, t])).collect();
        let total = (designs * self.trainings) as f64;
        let thousandths = AtomicU64::new(0);
        let advance = |by: f64| {
            let done = thousandths.fetch_add((by * 1e6) as u64, Ordering::Relaxed) as f64 / 1e6 + by;
            progress.report((done / total).min(1.0), &format!("{total} trainings"))
        };
        let learnt = parallel::map(&chains, |[first, training]| {
            let mut before: Option<Learnt> = None;
            let mut all = Vec::with_capacity(length);
            for design in *first..first + length {
                let (onnx, learnt) = self.one(design, *training, before.as_ref(), &advance)?;
                let seeds: Vec<u64> = CHOICE_SEEDS.collect();
                let chosen_by = self.measures(design, *training, &onnx, &seeds)?;
                all.push(Trained { onnx, steps: learnt.steps, chosen_by });
                before = Some(learnt);
            }
            Ok(all)
        });
        let mut trained: Vec<Vec<Trained>> = (0..designs).map(|_| Vec::with_capacity(self.trainings)).collect();
        for ([first, _], chain) in chains.iter().zip(learnt) {
            chain?.into_iter().enumerate().for_each(|(k, t)| trained[first + k].push(t));
        }
        Ok(trained)
    }

    /// One training, from what a neighbour has learnt if there is one.
    fn one(
        &self,
        design: usize,
        training: usize,
        before: Option<&Learnt>,
        advance: &(dyn Fn(f64) -> Result<()> + Sync),
    ) -> Result<(Vec<u8>, Learnt)> {
        let mut plan = self.plan(design, training)?;
        let mut learnt = plan.begin();
        if let (Some(before), Some(seconds)) = (before, self.warm) {
            learnt.parameters.clone_from(&before.parameters);
            learnt.normal.clone_from(&before.normal);
            plan.settings.seconds = Some(seconds);
        }
        let mut told = 0.0;
        let learnt = plan.run(learnt, |_, report| {
            let more = report.done - told;
            told = report.done;
            advance(more)
        })?;
        Ok((onnx(&plan, &learnt), learnt))
    }

    /// Every measure of a policy over `seeds`.
    fn measures(&self, design: usize, training: usize, onnx: &[u8], seeds: &[u64]) -> Result<[f64; 3]> {
        let plan = self.plan(design, training)?;
        let gait = Gait::Network(Arc::new(Network::new(onnx, plan.blueprint.task.spec())?));
        let jobs = [Job { blueprint: &plan.blueprint, gait: &gait, seeds }];
        let episodes = play(&jobs, &Silent)?.into_iter().next().unwrap_or_default();
        Ok(Measure::ALL.map(|m| m.of(&episodes)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interval_is_student_s() {
        let three = Between::of(&[1.0, 2.0, 3.0]);
        assert!((three.mean - 2.0).abs() < 1e-12 && (three.half - 4.303 / 3.0_f64.sqrt()).abs() < 1e-9);
        assert!(Between::of(&[1.0]).half.is_nan());
    }
}
