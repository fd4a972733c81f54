//! Design studies in which a gait is learnt for every design of a grid or a search. Each design has several trainings,
//! and the best designs are compared on seeds that were used neither in training nor in the choice.

use super::export::onnx;
pub use super::measure::{GaitMeasure, TrainingMean};
use super::plan::{TrainingPlan, TrainingState, UpdateReport};
use super::record::TrainingRecord;
use super::search::{self, EvaluatedDesign};
use super::settings::Hyperparameters;
use crate::env::Task;
use crate::env::gait::HexapodGait;
use crate::env::registry::Blueprint;
use crate::error::{Error, Result, check_range};
use crate::evaluate::FIRST_SEED;
use crate::evaluate::gait::Gait;
use crate::evaluate::run::{EpisodeJob, play};
use crate::parallel;
use crate::policy::Network;
use crate::progress::{Progress, Silent};
use crate::sim::Model;
use crate::sweep::{Design, SweepAxis, table};
use rand::SeedableRng as _;
use rand_xoshiro::Xoshiro256PlusPlus;
use serde_json::{Map, Value, json};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Seeds for ranking designs, in two blocks of lanes: our choice; no reported result uses them.
const CHOICE_SEEDS: std::ops::Range<u64> = 3_000_000..3_000_032;
/// Number of seeds of the final comparison; they begin at [`FIRST_SEED`], as in evaluations.
const SEEDS: usize = 100;
/// Number of designs in the final comparison, the best of the ranking: our choice, because their intervals often
/// overlap.
const COMPARED: usize = 3;
/// Largest number of trainings of a study: our choice; so many take days.
const MOST_TRAININGS: usize = 10_000;
/// Number of designs that a search trains at the same time. A search begins with evenly spread designs: this number,
/// and this number more for each parameter. Our choice.
const TOGETHER: usize = 4;
/// The same seed in every search, so that a search can be repeated; the number is arbitrary.
const SEARCH_SEED: u64 = 1;

/// A request for a study.
pub struct DesignStudy {
    pub base: Design,
    pub axes: Vec<SweepAxis>,
    /// Task options, such as `command`, besides the options that the design sets.
    pub options: Map<String, Value>,
    /// Settings, with the steps or the time of each training on one thread.
    pub settings: Hyperparameters,
    /// Number of trainings of each design.
    pub trainings: usize,
    /// If given, each design after the first on the last axis starts from its neighbour's policy and learns for this
    /// time [s], or for this number of steps if a number of steps ends each training.
    pub warm: Option<f64>,
    /// Number of designs in a search between the axes' least and greatest values; None: the whole grid.
    pub search: Option<usize>,
    /// Folder of the trainings, which exists and into which no other process writes; a finished training in it is not repeated.
    pub out: PathBuf,
}

/// A learnt gait.
pub struct Trained {
    pub onnx: Vec<u8>,
    pub steps: u64,
    /// Each measure over the ranking's seeds.
    pub chosen_by: [f64; 3],
}

/// A design in the comparison.
pub struct DesignComparison {
    /// Index of the design.
    pub design: usize,
    /// Each measure over the evaluation seeds, one value for each training.
    pub values: [Vec<f64>; 3],
}

/// Results of a study.
pub struct Findings {
    /// Values on the axes, in the order of the grid (the last axis varies fastest) or of the search.
    pub designs: Vec<Vec<String>>,
    /// One row for each design, one entry for each training.
    pub trained: Vec<Vec<Trained>>,
    /// The best designs by the measure, best first.
    pub best: Vec<DesignComparison>,
}

impl DesignStudy {
    /// Refuses studies whose trainings could not start; returns the designs of the grid, or none for a search.
    pub fn check(&self) -> Result<Vec<Vec<String>>> {
        let points: usize = self.axes.iter().map(|a| a.values.len()).product();
        let designs = self.search.unwrap_or(points);
        check_range("number of trainings", (designs * self.trainings) as f64, 1.0..=MOST_TRAININGS as f64)?;
        let gaits = ["frequency", "phase"];
        if let Some(axis) = self.axes.iter().find(|a| gaits.contains(&a.parameter.name)) {
            return Err(Error::invalid(
                axis.parameter.name,
                "with --learn each design learns its own; it cannot be varied",
            ));
        }
        if self.search.is_some() {
            check_range("number of parameters", self.axes.len() as f64, 1.0..=search::MOST_PARAMETERS as f64)?;
            let [low, high] = SweepAxis::ends(&self.axes)?;
            [low, high].iter().try_for_each(|end| self.plan(&named(end), 0).map(drop))?;
            return Ok(Vec::new());
        }
        let all = (0..points).map(|i| table::values(&self.axes, i).into_iter().map(str::to_owned).collect());
        let all: Vec<Vec<String>> = all.collect();
        all.iter().try_for_each(|values| self.plan(values, 0).map(drop))?;
        Ok(all)
    }

    /// The plan of training number `training` of the design with these values.
    fn plan(&self, values: &[String], training: usize) -> Result<TrainingPlan> {
        let mut changed = self.base.clone();
        for (axis, value) in self.axes.iter().zip(values) {
            axis.parameter.set(&mut changed, value)?;
        }
        let mut options = self.options.clone();
        if let Some(limit) = changed.robot.servo.torque_limit {
            options.insert("torque_limit".into(), json!(limit));
        }
        let blueprint = Blueprint::new(HexapodGait::ID, Value::Object(options))?;
        // The servos have the task's limit of torque, if it has one.
        changed.robot.servo.torque_limit = blueprint.task.option("torque_limit").as_f64();
        changed.robot.servo.anti_windup = true;
        let blueprint = blueprint.with_model(Model::new(&changed.robot, &changed.scene)?)?;
        TrainingPlan::new(blueprint, self.settings.clone(), training as u64, 1)
    }

    /// Trains, ranks and compares. An error of `progress` stops the work; finished trainings are kept.
    pub fn run(&self, measure: GaitMeasure, progress: &dyn Progress) -> Result<Findings> {
        let grid = self.check()?;
        let (designs, trained, costs) = match self.search {
            None => {
                let total = grid.len() as f64;
                let trained =
                    self.train(&grid, 0, &StudyProgress::new(progress, 0.0, total * self.trainings as f64))?;
                let costs: Vec<f64> = trained.iter().map(|all| measure.cost(mean(measure, all))).collect();
                (grid, trained, costs)
            }
            Some(count) => self.search(count, measure, progress)?,
        };
        let mut order: Vec<usize> = (0..designs.len()).collect();
        order.sort_by(|a, b| costs[*a].total_cmp(&costs[*b]));
        let compare = |design: &usize| {
            let seeds: Vec<u64> = (FIRST_SEED..).take(SEEDS).collect();
            let played = trained[*design].iter().enumerate();
            let played = played.map(|(k, t)| measures(&self.plan(&designs[*design], k)?, &t.onnx, &seeds));
            let played = played.collect::<Result<Vec<_>>>()?;
            let values = [0, 1, 2].map(|m| played.iter().map(|all| all[m]).collect());
            Ok(DesignComparison { design: *design, values })
        };
        let best = order.iter().take(COMPARED).map(compare).collect::<Result<_>>()?;
        Ok(Findings { designs, trained, best })
    }

    /// A search for the best design: evenly spread designs first, then some at a time where the expected improvement is
    /// greatest. Returns the expected value of each design at the end of the search; this depends less on chance than
    /// the results of the design's own trainings.
    fn search(
        &self,
        count: usize,
        measure: GaitMeasure,
        progress: &dyn Progress,
    ) -> Result<(Designs, Trainings, Vec<f64>)> {
        let [low, high] = SweepAxis::ends(&self.axes)?;
        // Rounded to a thousandth of the range, so that tables stay readable.
        let at = |place: &[f64]| -> Vec<f64> {
            let within = |((x, low), high): ((&f64, &f64), &f64)| low + (x * 1000.0).round() / 1000.0 * (high - low);
            place.iter().zip(&low).zip(&high).map(within).collect()
        };
        let mut random = Xoshiro256PlusPlus::seed_from_u64(SEARCH_SEED);
        let first = (TOGETHER * (1 + self.axes.len())).min(count);
        let mut places: Vec<Vec<f64>> = (0..first as u64).map(|k| search::spread(k, self.axes.len())).collect();
        let (mut designs, mut trained): (Designs, Trainings) = Default::default();
        let mut looks: Vec<EvaluatedDesign> = Vec::new();
        while !places.is_empty() {
            let new: Designs = places.iter().map(|place| named(&at(place))).collect();
            let told =
                StudyProgress::new(progress, (designs.len() * self.trainings) as f64, (count * self.trainings) as f64);
            let learnt = self.train(&new, designs.len(), &told)?;
            let value = |all: &Vec<Trained>| -measure.cost(mean(measure, all));
            looks.extend(places.into_iter().zip(&learnt).map(|(at, all)| EvaluatedDesign { at, value: value(all) }));
            designs.extend(new);
            trained.extend(learnt);
            let more = TOGETHER.min(count - designs.len());
            places = search::next(&finite(&looks), noise(measure, &trained), more, &mut random);
        }
        let expected = search::smoothed(&finite(&looks), noise(measure, &trained));
        Ok((designs, trained, expected.into_iter().map(|value| -value).collect()))
    }

    /// Makes all trainings of `designs`, whose numbers start at `first`, with one thread for each training.
    /// Warm-started trainings form chains of neighbours; other trainings are independent.
    fn train(&self, designs: &[Vec<String>], first: usize, told: &StudyProgress) -> Result<Trainings> {
        let length = match (self.warm, self.search) {
            (Some(_), None) => self.axes.last().map_or(1, |axis| axis.values.len()),
            _ => 1,
        };
        let starts = (0..designs.len()).step_by(length);
        let chains: Vec<[usize; 2]> = starts.flat_map(|d| (0..self.trainings).map(move |t| [d, t])).collect();
        let learnt = parallel::map(&chains, |[start, training]| {
            let mut before: Option<TrainingState> = None;
            let mut all = Vec::with_capacity(length);
            let chain = &designs[*start..start + length];
            for (k, values) in chain.iter().enumerate() {
                let mut plan = self.plan(values, *training)?;
                if before.is_some() {
                    self.shorten(&mut plan.settings);
                }
                let record = TrainingRecord::new(&self.out, first + start + k, *training, &plan, &chain[..k]);
                let (trained, learnt) = one(&plan, &record, before.as_ref(), told)?;
                all.push(trained);
                before = Some(learnt);
            }
            Ok(all)
        });
        let mut trained: Trainings = designs.iter().map(|_| Vec::with_capacity(self.trainings)).collect();
        for ([start, _], chain) in chains.iter().zip(learnt) {
            chain?.into_iter().enumerate().for_each(|(k, t)| trained[start + k].push(t));
        }
        Ok(trained)
    }

    /// Shortens the settings for a training that starts from a neighbour's policy.
    fn shorten(&self, settings: &mut Hyperparameters) {
        match (self.warm, settings.seconds) {
            (Some(warm), Some(_)) => settings.seconds = Some(warm),
            (Some(warm), None) => settings.n_timesteps = warm as u64,
            (None, _) => (),
        }
    }
}

type Designs = Vec<Vec<String>>;
type Trainings = Vec<Vec<Trained>>;

/// Progress of all trainings.
struct StudyProgress<'a> {
    progress: &'a dyn Progress,
    total: f64,
    /// Finished trainings [1e-6].
    millionths: AtomicU64,
}

impl<'a> StudyProgress<'a> {
    /// `done` of `total` trainings are finished.
    fn new(progress: &'a dyn Progress, done: f64, total: f64) -> Self {
        Self { progress, total, millionths: AtomicU64::new((1e6 * done) as u64) }
    }

    fn advance(&self, by: f64) -> Result<()> {
        let done = self.millionths.fetch_add((by * 1e6) as u64, Ordering::Relaxed) as f64 / 1e6 + by;
        self.progress.report((done / self.total).min(1.0), &format!("{} trainings", self.total))
    }
}

/// Values as texts, in the form that the axes use.
fn named(values: &[f64]) -> Vec<String> {
    // Rounded to six digits, so that a sum of steps is not printed as 0.30000000000000004.
    values.iter().map(|v| format!("{v:.6e}").parse().map_or_else(|_| v.to_string(), |v: f64| v.to_string())).collect()
}

/// Mean over the trainings of a design.
fn mean(measure: GaitMeasure, trained: &[Trained]) -> f64 {
    let place = GaitMeasure::ALL.iter().position(|m| *m == measure).unwrap_or(0);
    trained.iter().map(|t| t.chosen_by[place]).sum::<f64>() / trained.len() as f64
}

/// Variance of a design's mean, from the scatter of trainings of the same design, pooled over all designs; 0 if each
/// has one training.
fn noise(measure: GaitMeasure, trained: &[Vec<Trained>]) -> f64 {
    let (mut squares, mut freedom) = (0.0, 0.0);
    for all in trained {
        let center = mean(measure, all);
        let off = all.iter().map(|t| mean(measure, std::slice::from_ref(t)) - center);
        let sum: f64 = off.map(|d| d * d).sum();
        if sum.is_finite() {
            squares += sum;
            freedom += all.len() as f64 - 1.0;
        }
    }
    let each = trained.first().map_or(1, Vec::len) as f64;
    if freedom > 0.0 { squares / freedom / each } else { 0.0 }
}

/// Gives designs whose trainings failed the least value of the other designs.
fn finite(looks: &[EvaluatedDesign]) -> Vec<EvaluatedDesign> {
    let least = looks.iter().map(|l| l.value).filter(|v| v.is_finite()).fold(f64::INFINITY, f64::min);
    let least = if least.is_finite() { least } else { 0.0 };
    let value = |look: &EvaluatedDesign| if look.value.is_finite() { look.value } else { least };
    looks.iter().map(|look| EvaluatedDesign { at: look.at.clone(), value: value(look) }).collect()
}

/// Makes one training, from a neighbour's policy if there is one. If it was finished before, reads its files instead.
fn one(
    plan: &TrainingPlan,
    record: &TrainingRecord,
    before: Option<&TrainingState>,
    told: &StudyProgress,
) -> Result<(Trained, TrainingState)> {
    if let Some((learnt, chosen_by)) = record.read(plan) {
        told.advance(1.0)?;
        return Ok((Trained { onnx: onnx(plan, &learnt), steps: learnt.steps, chosen_by }, learnt));
    }
    let learnt = before.map_or_else(|| plan.begin(), |before| plan.begin_from(before));
    let mut so_far = 0.0;
    let learnt = plan.run(learnt, None, &mut |_: &TrainingState, report: &UpdateReport| {
        let more = report.done - so_far;
        so_far = report.done;
        told.advance(more)
    })?;
    let onnx = onnx(plan, &learnt);
    let seeds: Vec<u64> = CHOICE_SEEDS.collect();
    let chosen_by = measures(plan, &onnx, &seeds)?;
    record.write(plan, &learnt, &onnx, &chosen_by)?;
    Ok((Trained { onnx, steps: learnt.steps, chosen_by }, learnt))
}

/// Every measure of a policy over `seeds`.
fn measures(plan: &TrainingPlan, onnx: &[u8], seeds: &[u64]) -> Result<[f64; 3]> {
    let blueprint = plan.spec.task()?;
    let gait = Gait::Network(Arc::new(Network::new(onnx, blueprint.task.spec())?));
    let jobs = [EpisodeJob { blueprint, gait: &gait, seeds }];
    let episodes = play(&jobs, &Silent)?.into_iter().next().unwrap_or_default();
    Ok(GaitMeasure::ALL.map(|m| m.of(&episodes)))
}
