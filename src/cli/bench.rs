//! `sandgait bench`

use super::OptionArgs;
use clap::ValueEnum as _;
use sandgait::bench::{Actions, Direct, RolloutStepper, ServerStepper, Stepper, measure, random_actions};
use sandgait::env::gait::HexapodGait;
use sandgait::env::legged::LeggedVelocity;
use sandgait::env::registry::{Blueprint, TASK_IDS};
use sandgait::env::{Spec, Task};
use sandgait::number::Isa;
use sandgait::policy::{self, Network};
use sandgait::session::MOST_ENVIRONMENTS;
use sandgait::sim::engine::EngineKind;
use sandgait::study::trained::{TrainedTask, policy_file, task_and_options};
use sandgait::{Error, Result, files};
use serde_json::{Value, json};
use std::path::PathBuf;
use std::time::Duration;

/// Measure environment steps per second: action, servo, sand, dynamics, observation, reward, autoreset.
///
/// The result is the median of the repeats. Actions are computed before the measurement, so the time of a policy is not
/// counted.
///
/// LeggedVelocity is measured without its curriculum (`curriculum=null`), on whose first levels feet sink less.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait bench --threads 1 --json
  sandgait bench --envs 256 --through grpc-uds
  sandgait bench --task all --actions zero      (robots that stand)
  sandgait bench --policy runs/gait
  sandgait bench --task LeggedVelocity --option ground=rigid --option robot=robots/sandcat.urdf
  sandgait bench --option sand=sand.toml --option leg=C
  SANDGAIT_ISA=avx2 sandgait bench            (avx512, avx2, baseline or f64)")]
pub struct BenchArgs {
    /// Name or id of the task; `all` measures every task and prints a line for each [default: the policy's, or
    /// HexapodGait]
    #[arg(long)]
    task: Option<String>,
    /// Engine; default: the task's own
    #[arg(long)]
    engine: Option<String>,
    #[command(flatten)]
    options: OptionArgs,
    /// Number of environments
    #[arg(long, default_value_t = 256, value_name = "N", value_parser = super::whole::<usize>(1..=MOST_ENVIRONMENTS as u64))]
    envs: usize,
    /// Number of simulating threads; 0: one for each processor
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = super::whole::<u16>(0..=super::MOST_THREADS))]
    threads: u16,
    /// Actions of the robots [default: random, or policy with --policy]
    #[arg(long, value_enum)]
    actions: Option<ActionChoice>,
    /// Network that computes the actions. Task and options are those in settings.json beside it where --task and
    /// --option say nothing
    #[arg(long, value_name = "FOLDER")]
    policy: Option<PathBuf>,
    /// Interface through which steps are requested
    #[arg(long, value_enum, default_value_t = Transport::Process)]
    through: Transport,
    /// Number of repeats, from 5 to 1000
    #[arg(long, default_value_t = 7, value_name = "N", value_parser = super::whole::<u16>(5..=1000))]
    repeats: u16,
    /// Duration of a repeat [s]
    #[arg(long, default_value_t = 0.5, value_name = "S")]
    seconds: f64,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
enum Transport {
    /// The pool is called directly, without a service.
    Process,
    /// A server on a Unix socket in this process, with one stream.
    GrpcUds,
    /// A server on loopback TCP in this process, with one stream.
    GrpcTcp,
    /// A server on a Unix socket in this process, with rollouts of 150 steps whose answers have only the returns.
    Rollouts,
    /// The same as `rollouts`, but the answers also have the rows of every step.
    Trajectories,
}

#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
enum ActionChoice {
    /// Uniform random actions, drawn in every step
    Random,
    /// Action 0: the hips of walking tasks do not move
    Zero,
    /// 0.4 of every upper bound: robots of HexapodGait walk at 2 Hz
    Constant,
    /// The actions of the network of --policy
    Policy,
}

impl ActionChoice {
    fn name(self) -> &'static str {
        match self {
            Self::Random => "uniform random",
            Self::Zero => "zero",
            Self::Constant => "constant",
            Self::Policy => "policy",
        }
    }
}

impl BenchArgs {
    pub fn run(self) -> Result<String> {
        if !(self.seconds > 0.0 && self.seconds <= 3600.0) {
            return Err(Error::invalid("--seconds", format!("{} is outside (0, 3600]", self.seconds)));
        }
        if self.task.as_deref() != Some("all") {
            let trained = self.policy().as_deref().map_or(Ok(None), TrainedTask::beside)?;
            let (task, options, line) =
                task_and_options(trained, self.task.as_deref(), &self.options, HexapodGait::ID, super::read_files)?;
            super::warn_each(line.as_slice());
            let (json, line) = self.bench(&task, options)?;
            return Ok(if self.json { super::json(&json) } else { line });
        }
        let options = Value::Object(self.options.read(super::read_files)?);
        let of_each = TASK_IDS.iter().map(|id| self.bench(id, options.clone())).collect::<Result<Vec<_>>>()?;
        let (all, lines): (Vec<_>, Vec<_>) = of_each.into_iter().unzip();
        Ok(if self.json { super::json(&all.into()) } else { lines.concat() })
    }

    /// Measures one task; returns JSON and a line of text.
    fn bench(&self, task: &str, options: Value) -> Result<(Value, String)> {
        let options = self.task_options(task, options)?;
        let blueprint = Blueprint::new(task, options.clone())?;
        let (engine, spec) = (blueprint.engine, blueprint.task.spec());
        super::warn_of_unfelt_option(&options);
        let threads = usize::from(self.threads);
        let mut stepper: Box<dyn Stepper> = match self.through {
            Transport::Process => Box::new(Direct::new(&blueprint, self.envs, threads)?),
            through => {
                let remote = ServerStepper::new(task, options, self.envs, threads, through == Transport::GrpcTcp)?;
                match through {
                    Transport::Rollouts => Box::new(RolloutStepper { remote, trajectories: false }),
                    Transport::Trajectories => Box::new(RolloutStepper { remote, trajectories: true }),
                    _ => Box::new(remote),
                }
            }
        };
        let (actions, size) = (self.actions(spec, stepper.steps())?, [self.envs, spec.action.len()]);
        let length = Duration::from_secs_f64(self.seconds);
        let rates = measure(&mut *stepper, &actions, size, self.repeats.into(), length)?;
        Ok(self.report(task, engine, &rates))
    }

    fn policy(&self) -> Option<PathBuf> {
        self.policy.as_deref().map(policy_file)
    }

    /// Actions for calls of `at_once` control steps.
    fn actions(&self, spec: &Spec, at_once: usize) -> Result<Actions> {
        let rows = at_once * self.envs;
        let held = |share: f64| {
            let row = spec.action.iter().map(|c| (share * c.high) as f32);
            Ok(Actions::Made(vec![std::iter::repeat_n(row, rows).flatten().collect()]))
        };
        match (self.chosen(), self.policy()) {
            (ActionChoice::Policy, Some(file)) => {
                let bytes = files::read(&file, policy::MOST_BYTES as u64)?;
                Network::new(&bytes, spec).map(Actions::Policy)
            }
            (ActionChoice::Policy, None) => Err(Error::invalid("--actions", "policy needs --policy FOLDER")),
            (_, Some(_)) => Err(Error::invalid("--policy", "it is used only with --actions policy")),
            (ActionChoice::Random, None) => Ok(Actions::Made(random_actions(rows, spec.action.len()))),
            (ActionChoice::Zero, None) => held(0.0),
            (ActionChoice::Constant, None) => held(0.4),
        }
    }

    fn task_options(&self, task: &str, mut options: Value) -> Result<Value> {
        if let (Some(name), Some(options)) = (&self.engine, options.as_object_mut()) {
            if self.options.words().iter().any(|word| word.starts_with("engine=")) {
                return Err(Error::invalid("--option engine", "is given twice: --engine has it already"));
            }
            options.insert("engine".into(), EngineKind::named(name)?.name().into());
        }
        if let (LeggedVelocity::ID, Some(options)) = (task, options.as_object_mut()) {
            // Measures the speed on the sand itself, because at lower levels of the curriculum the feet sink less.
            options.entry("curriculum").or_insert(Value::Null);
        }
        Ok(options)
    }

    fn chosen(&self) -> ActionChoice {
        self.actions.unwrap_or(if self.policy.is_some() { ActionChoice::Policy } else { ActionChoice::Random })
    }

    fn report(&self, task: &str, engine: EngineKind, rates: &[f64]) -> (Value, String) {
        let threads = match self.threads {
            0 => sandgait::parallel::processors(),
            n => n.into(),
        };
        let isa = match engine {
            EngineKind::Lanes | EngineKind::Tree => Isa::choose().map_or("unknown", Isa::name),
            _ => "baseline",
        };
        let (median, min, max) = (rates[rates.len() / 2], rates[0], rates[rates.len() - 1]);
        // The name of the transport on the command line. Every transport has a name, because none is hidden.
        let through = self.through.to_possible_value();
        let through = through.as_ref().map_or("", clap::builder::PossibleValue::get_name);
        let json = json!({
            "env_steps_per_second": median.round(),
            "min": min.round(),
            "max": max.round(),
            "repeats": rates.len(),
            "engine": engine.name(),
            "isa": isa,
            "task": task,
            "options": self.options.words(),
            "envs": self.envs,
            "threads": threads,
            "through": through,
            "actions": self.chosen().name(),
        });
        let plural = |count: usize| if count == 1 { "" } else { "s" };
        let line = format!(
            "{median:.0} environment steps/s ({min:.0} to {max:.0}) · {} · engine {} ({isa}) · {} environment{}, {threads} thread{}, through {through}, actions {}\n",
            [vec![task.to_owned()], self.options.words()].concat().join(" "),
            engine.name(),
            self.envs,
            plural(self.envs),
            plural(threads),
            self.chosen().name(),
        );
        (json, line)
    }
}
