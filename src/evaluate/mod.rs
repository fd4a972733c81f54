//! Evaluates gaits: returns, speeds, costs and falls over seeds that no training uses, on several media and slopes.
//!
//! [`gait`]: the evaluated gait → [`run`]: episodes over lanes and cores, each an [`episode`] of sums →
//! [`figures`]: means with intervals → [`table`]: columns and text. [`commands`]: how well a policy of LeggedVelocity
//! follows commands, and [`sands`]: on several grounds. `docs/evaluate.md` defines every figure.

use sandgait_base::{error, parallel, progress};
use sandgait_env as env;
use sandgait_policy as policy;
use sandgait_sim as sim;

pub mod commands;
pub mod episode;
pub mod figures;
pub mod gait;
pub mod run;
pub mod sands;
pub mod table;

pub use figures::{Estimate, Figures};
pub use gait::PolicySource;

use crate::env::legged::LeggedVelocity;
use crate::env::registry::Blueprint;
use crate::env::{ResetOptions, Task};
use crate::error::{Error, Result, check_range};
use crate::progress::{PartialProgress, Progress};
use gait::Gait;
use serde::Serialize;
use serde_json::{Value, json};

/// The seeds of an evaluation start here, as in `examples/evaluate_gait.py`: our choice. Trainings in Python usually
/// have small seeds, and those of `sandgait train` start at 2⁴⁰.
pub const FIRST_SEED: u64 = 1_000_000;

/// Seeds for the search of the tripod's rate, in two blocks of lanes: our choice; no reported result uses them.
const SEARCH_SEEDS: std::ops::Range<u64> = 2_000_000..2_000_032;

/// Rates that the search tries, as multiples of [`RATE_STEP`]: 0.25, 0.5, … 5 Hz. Our choice: 5 Hz is the limit of all
/// hips (`env::reference::TOP_SPEED`), and a finer step takes longer.
const RATES: std::ops::RangeInclusive<u32> = 1..=20;
const RATE_STEP: f64 = 0.25;

/// Largest number of seeds: our choice. With so many seeds, the interval of a mean reaches 0.6 % of the standard
/// deviation between episodes to each side.
pub const MOST_SEEDS: usize = 100_000;
/// Largest number of combinations of media and slopes, and of all their episodes together: our choice, an hour's work.
const MOST_CONDITIONS: usize = 1_000;
const MOST_EPISODES: usize = 1_000_000;
/// Number of episodes that are played together, unless one condition has more seeds: our choice, because all processors
/// then have work, and the sums over the episodes take some 2 MB.
const TOGETHER: usize = 1 << 14;
/// Largest memory of the tasks of conditions that are played together [bytes], unless one model is larger: our choice,
/// thousands of flat beds, or some dozens with a relief.
const MODELS: usize = 16 << 20;

/// Memory of the sums over [`TOGETHER`] episodes [bytes].
const SUMS: usize = 2 << 20;

/// A request for an evaluation.
pub struct EvaluationRequest {
    pub policy: PolicySource,
    pub task: String,
    /// Keywords of the task (a JSON object; null for none).
    pub options: Value,
    pub seeds: usize,
    /// Media; if empty, the medium of the options.
    pub media: Vec<String>,
    /// Slopes [°]; if empty, the slope of the options.
    pub slopes: Vec<f64>,
}

impl EvaluationRequest {
    /// Default number of seeds: our choice. The interval of a mean then reaches a fifth of the standard deviation
    /// between episodes to each side.
    pub const SEEDS: usize = 100;
}

/// A medium and a slope [°].
type Condition = (String, f64);

/// A checked [`EvaluationRequest`].
pub struct Evaluation {
    base: Blueprint,
    conditions: Vec<Condition>,
    /// None: the tripod with the best rate of each condition is used.
    gait: Option<Gait>,
    seeds: usize,
}

/// One condition's result.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EvaluationRow {
    pub medium: String,
    pub slope_deg: f64,
    /// Rate of the tripod, if it was searched [Hz].
    pub rate: Option<f64>,
    #[serde(flatten)]
    pub figures: Figures,
}

impl Evaluation {
    pub fn new(request: &EvaluationRequest) -> Result<Self> {
        let EvaluationRequest { policy, task, options, seeds, media, slopes } = request;
        check_range("seeds", *seeds as f64, 2.0..=MOST_SEEDS as f64)?;
        let options = policy.with_control(task, options.clone())?;
        let base = Blueprint::new(task, options)?;
        if base.task.spec().id == LeggedVelocity::ID {
            let reason = "it follows commands: `sandgait evaluate POLICY` measures how well";
            return Err(Error::invalid("task", format!("{}: {reason}", LeggedVelocity::ID)));
        }
        let text = |name: &str| base.task.option(name).as_str().unwrap_or_default().to_owned();
        no_sand_beside(media, &base)?;
        let media = if media.is_empty() { vec![text("medium")] } else { media.clone() };
        let slopes = if slopes.is_empty() {
            vec![base.task.option("slope_deg").as_f64().unwrap_or_default()]
        } else {
            slopes.clone()
        };
        let count = media.len() * slopes.len();
        check_range("media times slopes", count as f64, 1.0..=MOST_CONDITIONS as f64)?;
        check_range("seeds times media times slopes", (seeds * count) as f64, 1.0..=MOST_EPISODES as f64)?;
        let gait = policy.gait(&base)?;
        episode::Columns::of(base.task.spec())?;
        let all = media.iter().flat_map(|medium| slopes.iter().map(|slope| (medium.clone(), *slope)));
        let study = Self { conditions: all.collect(), base, gait, seeds: *seeds };
        study.conditions.iter().try_for_each(|condition| study.blueprint(condition).map(drop))?;
        Ok(study)
    }

    /// Memory of the tasks that are played together, and of their episodes' sums [bytes].
    pub fn bytes(&self) -> usize {
        MODELS.max(self.base.shared_bytes()) + SUMS
    }

    fn blueprint(&self, (medium, slope_deg): &Condition) -> Result<Blueprint> {
        self.base.changed(&ResetOptions::new(json!({"medium": medium, "slope_deg": slope_deg}))?)
    }

    /// Runs all episodes; returns one row for each medium and slope; the slope varies fastest. An error of `progress`
    /// stops the work. Only the episodes of some conditions are in memory at a time.
    pub fn run(&self, progress: &dyn Progress) -> Result<Vec<EvaluationRow>> {
        let searched = if self.gait.is_none() { RATES.count() * SEARCH_SEEDS.count() } else { 0 };
        let models = MODELS / self.base.shared_bytes().max(1);
        let groups = self.conditions.chunks((TOGETHER / (searched + self.seeds)).min(models).max(1));
        let (count, share) = (groups.len() as f64, searched as f64 / (searched + self.seeds) as f64);
        let mut rows = Vec::with_capacity(self.conditions.len());
        for (k, group) in groups.enumerate() {
            let part = PartialProgress::new(progress, [k as f64 / count, (k + 1) as f64 / count]);
            let blueprints = group.iter().map(|condition| self.blueprint(condition)).collect::<Result<Vec<_>>>()?;
            let best = match &self.gait {
                Some(gait) => vec![(gait.clone(), None); group.len()],
                None => search(&blueprints, &PartialProgress::new(&part, [0.0, share]))?,
            };
            let seeds: Vec<u64> = (FIRST_SEED..).take(self.seeds).collect();
            let jobs = blueprints.iter().zip(&best);
            let jobs: Vec<_> =
                jobs.map(|(blueprint, (gait, _))| run::EpisodeJob { blueprint, gait, seeds: &seeds }).collect();
            let episodes = run::play(&jobs, &PartialProgress::new(&part, [share, 1.0]))?;
            rows.extend(group.iter().zip(&best).zip(&episodes).map(|(((medium, slope_deg), (_, rate)), episodes)| {
                EvaluationRow {
                    medium: medium.clone(),
                    slope_deg: *slope_deg,
                    rate: *rate,
                    figures: Figures::of(episodes),
                }
            }));
        }
        Ok(rows)
    }

    /// The settings that a report states.
    pub fn about(request: &EvaluationRequest) -> Value {
        let name = match &request.policy {
            PolicySource::Network { name, .. } => name.clone(),
            PolicySource::Tripod(None) => "tripod, best rate".into(),
            PolicySource::Tripod(Some(rate)) => format!("tripod at {rate} Hz"),
            PolicySource::Clock(action) => format!("clock {action:?}"),
            PolicySource::Standing => "standing".into(),
            PolicySource::Random => "random".into(),
        };
        let search =
            (request.policy == PolicySource::Tripod(None)).then(|| json!([SEARCH_SEEDS.start, SEARCH_SEEDS.end - 1]));
        json!({
            "policy": name,
            "task": request.task,
            "options": request.options,
            "seeds": [FIRST_SEED, FIRST_SEED + request.seeds as u64 - 1],
            "search_seeds": search,
            "version": env!("CARGO_PKG_VERSION"),
        })
    }
}

/// Refuses a list of media beside the option `sand`, which would replace each of them.
fn no_sand_beside(media: &[String], base: &Blueprint) -> Result<()> {
    let given = base.task.option("sand").as_str().is_some_and(|sand| !sand.is_empty());
    match given && !media.is_empty() {
        true => Err(Error::invalid("media", "the option sand is given already; leave out one of the two")),
        false => Ok(()),
    }
}

/// For each condition the tripod with the greatest mean return among several rates, and its rate.
fn search(conditions: &[Blueprint], progress: &dyn Progress) -> Result<Vec<(Gait, Option<f64>)>> {
    let seeds: Vec<u64> = SEARCH_SEEDS.collect();
    let rates: Vec<f64> = RATES.map(|k| f64::from(k) * RATE_STEP).collect();
    let tripods = conditions.iter().flat_map(|c| rates.iter().map(|rate| Gait::tripod(*rate, c.task.spec())));
    let tripods: Vec<Gait> = tripods.collect();
    let each = conditions.iter().flat_map(|c| std::iter::repeat_n(c, rates.len())).zip(&tripods);
    let jobs: Vec<_> = each.map(|(blueprint, gait)| run::EpisodeJob { blueprint, gait, seeds: &seeds }).collect();
    let played = run::play(&jobs, progress)?;
    let total = |episodes: &Vec<episode::EpisodeSums>| episodes.iter().map(|e| e.total_reward).sum::<f64>();
    let totals: Vec<f64> = played.iter().map(total).collect();
    let found = totals.chunks_exact(rates.len()).zip(tripods.chunks_exact(rates.len()));
    let chosen = found.filter_map(|(totals, tripods)| {
        let best = (0..rates.len()).max_by(|a, b| totals[*a].total_cmp(&totals[*b]))?;
        Some((tripods[best].clone(), Some(rates[best])))
    });
    Ok(chosen.collect())
}
