//! `sandgait bench`

use sandgait::bench::{Direct, Remote, Rollouts, Stepper, random_actions};
use sandgait::env::registry::Blueprint;
use sandgait::number::Isa;
use sandgait::sim::engine::EngineKind;
use sandgait::{Error, Result};
use serde_json::{Map, Value, json};
use std::time::{Duration, Instant};

/// Measure whole environment steps a second: action, servo, sand, dynamics, observation, reward, autoreset.
///
/// Actions are uniform random numbers, drawn before the clock starts. The figure is the median of the repeats.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait bench --threads 1 --json
  sandgait bench --envs 256 --through grpc-uds
  sandgait bench --option sand=sand.toml --option leg=C
  SANDGAIT_ISA=avx2 sandgait bench            (avx512, avx2, baseline or f64)")]
pub struct Bench {
    /// Task id
    #[arg(long, default_value = "sandgait/HexapodGait-v0")]
    task: String,
    /// Engine; the task's own if not given
    #[arg(long)]
    engine: Option<String>,
    /// Option of the task, repeatable; VALUE is JSON or plain text, that of `sand` the path of a sand.toml
    #[arg(long = "option", value_name = "KEY=VALUE")]
    options: Vec<String>,
    /// Environments
    #[arg(long, default_value_t = 256, value_name = "N")]
    envs: usize,
    /// Threads that simulate; 0: one for each processor
    #[arg(long, default_value_t = 1, value_name = "N")]
    threads: u16,
    /// What the steps pass through
    #[arg(long, value_enum, default_value_t = Through::Process)]
    through: Through,
    /// Repeats, at least 5
    #[arg(long, default_value_t = 7, value_name = "N", value_parser = clap::value_parser!(u16).range(5..))]
    repeats: u16,
    /// Length of a repeat [s]
    #[arg(long, default_value_t = 0.5, value_name = "S")]
    seconds: f64,
    /// Machine-readable
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
enum Through {
    /// Nothing: the pool is called directly.
    Process,
    /// A server on a Unix socket in this process, one stream.
    GrpcUds,
    /// A server on loopback TCP in this process, one stream.
    GrpcTcp,
    /// A server on a Unix socket in this process, rollouts of 150 steps, returns only.
    Rollouts,
    /// The same with every step's rows.
    Trajectories,
}

impl Bench {
    pub fn run(self) -> Result<String> {
        if !(self.seconds > 0.0 && self.seconds <= 3600.0) {
            return Err(Error::invalid("--seconds", format!("{} is outside (0, 3600]", self.seconds)));
        }
        let options = self.task_options()?;
        let blueprint = Blueprint::new(&self.task, options.clone())?;
        super::warn_of_unfelt_option(&options);
        let engine = blueprint.engine;
        let threads = usize::from(self.threads);
        let mut stepper: Box<dyn Stepper> = match self.through {
            Through::Process => Box::new(Direct::new(&blueprint, self.envs, threads)?),
            through => {
                let remote = Remote::new(&self.task, options, self.envs, threads, through == Through::GrpcTcp)?;
                match through {
                    Through::Rollouts => Box::new(Rollouts { remote, trajectories: false }),
                    Through::Trajectories => Box::new(Rollouts { remote, trajectories: true }),
                    _ => Box::new(remote),
                }
            }
        };
        let width = blueprint.task.spec().action.len();
        let rates =
            measure(&mut *stepper, self.envs, width, self.repeats.into(), Duration::from_secs_f64(self.seconds))?;
        self.report(engine, &rates)
    }

    fn task_options(&self) -> Result<Value> {
        let mut options = Map::new();
        if let Some(name) = &self.engine {
            options.insert("engine".into(), EngineKind::named(name)?.name().into());
        }
        for option in &self.options {
            let wrong = |reason: &str| Error::invalid("--option", format!("{option:?} {reason}"));
            let (key, text) = option.split_once('=').ok_or_else(|| wrong("is not KEY=VALUE"))?;
            let value = match key {
                "sand" => std::fs::read_to_string(text).map_err(|e| Error::file(text.as_ref(), e))?.into(),
                _ => serde_json::from_str(text).unwrap_or_else(|_| text.into()),
            };
            if options.insert(key.into(), value).is_some() {
                return Err(wrong("is given twice"));
            }
        }
        Ok(options.into())
    }

    fn report(&self, engine: EngineKind, rates: &[f64]) -> Result<String> {
        let threads = match self.threads {
            0 => sandgait::parallel::processors(),
            n => n.into(),
        };
        let isa = if engine == EngineKind::Lanes { Isa::choose()?.name() } else { "baseline" };
        let (median, min, max) = (rates[rates.len() / 2], rates[0], rates[rates.len() - 1]);
        let through = match self.through {
            Through::Process => "process",
            Through::GrpcUds => "grpc-uds",
            Through::GrpcTcp => "grpc-tcp",
            Through::Rollouts => "rollouts",
            Through::Trajectories => "trajectories",
        };
        if self.json {
            return Ok(super::json(&json!({
                "env_steps_per_second": median.round(),
                "min": min.round(),
                "max": max.round(),
                "repeats": rates.len(),
                "engine": engine.name(),
                "isa": isa,
                "task": self.task,
                "options": self.options,
                "envs": self.envs,
                "threads": threads,
                "through": through,
                "actions": "uniform random",
            })));
        }
        Ok(format!(
            "{median:.0} environment steps/s ({min:.0} to {max:.0}) · {} · engine {} ({isa}) · {} environments, {threads} threads, through {through}\n",
            [std::slice::from_ref(&self.task), &self.options].concat().join(" "),
            engine.name(),
            self.envs,
        ))
    }
}

/// Environment steps a second of each repeat, ascending.
fn measure(stepper: &mut dyn Stepper, envs: usize, width: usize, repeats: usize, length: Duration) -> Result<Vec<f64>> {
    let at_once = stepper.steps();
    let actions = random_actions(at_once * envs, width);
    let mut repeat = |length: Duration| -> Result<f64> {
        let (clock, mut calls) = (Instant::now(), 0);
        while clock.elapsed() < length {
            stepper.step(&actions[calls % actions.len()])?;
            calls += 1;
        }
        Ok((calls * at_once * envs) as f64 / clock.elapsed().as_secs_f64())
    };
    repeat(length)?; // warm-up: robots leave their start, caches fill
    let mut rates = (0..repeats).map(|_| repeat(length)).collect::<Result<Vec<_>>>()?;
    rates.sort_by(f64::total_cmp);
    Ok(rates)
}
