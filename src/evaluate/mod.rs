//! Evaluates gaits: returns, speeds, costs and falls over seeds that no training uses, on several media and slopes.
//!
//! [`gait`]: the evaluated gait → [`run`]: episodes over lanes and cores, each an [`episode`] of sums →
//! [`figures`]: means with intervals → [`table`]: text, CSV and JSON. `docs/evaluate.md` defines every figure.

use sandgait_base::{error, parallel, progress};
use sandgait_env as env;
use sandgait_policy as policy;
use sandgait_sand as sand;
use sandgait_sim as sim;

pub mod episode;
pub mod figures;
pub mod gait;
pub mod run;
pub mod table;

pub use figures::{Estimate, Figures};
pub use gait::Wanted;

use crate::env::ResetOptions;
use crate::env::registry::Blueprint;
use crate::error::{Error, Result, check_range};
use crate::progress::{Part, Progress};
use gait::Gait;
use serde::Serialize;
use serde_json::{Value, json};

/// Training uses small seeds; the seeds of an evaluation start here, as in `examples/evaluate_gait.py`.
pub const FIRST_SEED: u64 = 1_000_000;

/// Seeds for the search of the tripod's rate, which no reported result uses. Two blocks of lanes.
const SEARCH_SEEDS: std::ops::Range<u64> = 2_000_000..2_000_032;

/// Rates that the search tries, as multiples of [`RATE_STEP`]: 0.25, 0.5, … 5 Hz.
const RATES: std::ops::RangeInclusive<u32> = 1..=20;
const RATE_STEP: f64 = 0.25;

/// Largest number of seeds: more would include [`SEARCH_SEEDS`].
const MOST_SEEDS: usize = 1_000_000;
/// Largest number of combinations of media and slopes: our choice, an hour's work.
const MOST_CONDITIONS: usize = 1_000;

/// A request for an evaluation.
pub struct Request {
    pub policy: Wanted,
    pub task: String,
    /// Keywords of the task (a JSON object; null for none).
    pub options: Value,
    pub seeds: usize,
    /// Media; if empty, that of the options.
    pub media: Vec<String>,
    /// Slopes [°]; if empty, that of the options.
    pub slopes: Vec<f64>,
}

impl Request {
    /// Default number of seeds: intervals are then about a fifth as wide as the spread between episodes.
    pub const SEEDS: usize = 100;
}

/// One medium and slope.
struct Condition {
    medium: String,
    slope_deg: f64,
    blueprint: Blueprint,
    /// None: the tripod with the best rate is used.
    gait: Option<Gait>,
}

/// A checked [`Request`].
pub struct Study {
    conditions: Vec<Condition>,
    seeds: usize,
}

/// One condition's result.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    pub medium: String,
    pub slope_deg: f64,
    /// Rate of the tripod, if it was searched [Hz].
    pub rate: Option<f64>,
    #[serde(flatten)]
    pub figures: Figures,
}

impl Study {
    pub fn new(request: &Request) -> Result<Self> {
        let Request { policy, task, options, seeds, media, slopes } = request;
        check_range("seeds", *seeds as f64, 2.0..=MOST_SEEDS as f64)?;
        let options = policy.with_control(options.clone())?;
        let base = Blueprint::new(task, options)?;
        let text = |name: &str| base.task.option(name).as_str().unwrap_or_default().to_owned();
        if !media.is_empty() && !text("sand").is_empty() {
            return Err(Error::invalid("media", "the option sand is given already; leave out one of the two"));
        }
        let media = if media.is_empty() { vec![text("medium")] } else { media.clone() };
        let slopes = if slopes.is_empty() {
            vec![base.task.option("slope_deg").as_f64().unwrap_or_default()]
        } else {
            slopes.clone()
        };
        check_range("media times slopes", (media.len() * slopes.len()) as f64, 1.0..=MOST_CONDITIONS as f64)?;
        let gait = policy.gait(&base)?;
        episode::Columns::of(base.task.spec())?;
        let condition = |medium: &String, slope_deg: f64| {
            let change = ResetOptions::new(json!({"medium": medium, "slope_deg": slope_deg}))?;
            let blueprint = base.changed(&change)?;
            Ok(Condition { medium: medium.clone(), slope_deg, blueprint, gait: gait.clone() })
        };
        let all = media.iter().flat_map(|m| slopes.iter().map(move |s| (m, *s)));
        let conditions = all.map(|(m, s)| condition(m, s)).collect::<Result<_>>()?;
        Ok(Self { conditions, seeds: *seeds })
    }

    /// Runs all episodes; returns one row for each medium and slope; the slope varies fastest. An error of `progress` stops
    /// the work.
    pub fn run(&self, progress: &dyn Progress) -> Result<Vec<Row>> {
        let searched = self.conditions.iter().any(|c| c.gait.is_none());
        let share = if searched { self.search_share() } else { 0.0 };
        let best = self.search(&Part::new(progress, [0.0, share]))?;
        let seeds: Vec<u64> = (FIRST_SEED..).take(self.seeds).collect();
        let jobs = self.conditions.iter().zip(&best);
        let jobs: Vec<_> =
            jobs.map(|(c, (gait, _))| run::Job { blueprint: &c.blueprint, gait, seeds: &seeds }).collect();
        let episodes = run::play(&jobs, &Part::new(progress, [share, 1.0]))?;
        let row = |((c, (_, rate)), episodes): ((&Condition, &(Gait, Option<f64>)), &Vec<_>)| Row {
            medium: c.medium.clone(),
            slope_deg: c.slope_deg,
            rate: *rate,
            figures: Figures::of(episodes),
        };
        Ok(self.conditions.iter().zip(&best).zip(&episodes).map(row).collect())
    }

    fn search_share(&self) -> f64 {
        let [search, rest] = [RATES.count() * SEARCH_SEEDS.count(), self.seeds].map(|n| n as f64);
        search / (search + rest)
    }

    /// The gait of each condition. For a condition without a gait this is the tripod with the greatest mean return
    /// among several rates, and its rate.
    fn search(&self, progress: &dyn Progress) -> Result<Vec<(Gait, Option<f64>)>> {
        let seeds: Vec<u64> = SEARCH_SEEDS.collect();
        let rates: Vec<f64> = RATES.map(|k| f64::from(k) * RATE_STEP).collect();
        let open: Vec<&Condition> = self.conditions.iter().filter(|c| c.gait.is_none()).collect();
        let tripods = open.iter().flat_map(|c| rates.iter().map(|rate| Gait::tripod(*rate, c.blueprint.task.spec())));
        let tripods: Vec<Gait> = tripods.collect();
        let each = open.iter().flat_map(|c| std::iter::repeat_n(c, rates.len())).zip(&tripods);
        let jobs: Vec<_> = each.map(|(c, gait)| run::Job { blueprint: &c.blueprint, gait, seeds: &seeds }).collect();
        let played = run::play(&jobs, progress)?;
        let total = |episodes: &Vec<episode::Episode>| episodes.iter().map(|e| e.total_reward).sum::<f64>();
        let totals: Vec<f64> = played.iter().map(total).collect();
        let mut found = totals.chunks_exact(rates.len()).zip(tripods.chunks_exact(rates.len()));
        let chosen = self.conditions.iter().map(|condition| match &condition.gait {
            Some(gait) => Some((gait.clone(), None)),
            None => found.next().and_then(|(totals, tripods)| {
                let best = (0..rates.len()).max_by(|a, b| totals[*a].total_cmp(&totals[*b]))?;
                Some((tripods[best].clone(), Some(rates[best])))
            }),
        });
        Ok(chosen.flatten().collect())
    }

    /// The settings that a report states.
    pub fn about(request: &Request) -> Value {
        let name = match &request.policy {
            Wanted::Network { name, .. } => name.clone(),
            Wanted::Tripod(None) => "tripod, best rate".into(),
            Wanted::Tripod(Some(rate)) => format!("tripod at {rate} Hz"),
            Wanted::Clock(action) => format!("clock {action:?}"),
            Wanted::Standing => "standing".into(),
            Wanted::Random => "random".into(),
        };
        let search =
            (request.policy == Wanted::Tripod(None)).then(|| json!([SEARCH_SEEDS.start, SEARCH_SEEDS.end - 1]));
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
