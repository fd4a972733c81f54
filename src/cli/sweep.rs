//! `sandgait sweep`

use super::Bar;
use super::options::OptionArgs;
use sandgait::env::Task;
use sandgait::env::gait::HexapodGait;
use sandgait::error::check_range;
use sandgait::files::{self, Lock};
use sandgait::plot::png;
use sandgait::sand::{Law, Medium};
use sandgait::sim::Robot;
use sandgait::sim::model::Scene;
use sandgait::sweep::{Design, SweepAxis, SweepMeasure, grid, optimize, table};
use sandgait::train::{design, entry};
use sandgait::{Error, Result};
use std::path::PathBuf;

/// Study a design: simulate walks of a robot over a grid of one or two parameters, or search for the best design.
///
/// Writes sweep.csv, and sweep.svg and sweep.png with a heat map for two parameters or a line for one. A parameter is
/// varied with NAME=FIRST:LAST:COUNT or NAME=VALUE,VALUE,… and fixed with --set NAME=VALUE. Names: xi, leg, chord,
/// width, leg-mass, base-mass, hip-height, belly, frequency, phase, medium, zeta, law, slope, payload, torque-limit,
/// kp.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait sweep --vary xi=-75:75:31 --vary frequency=1:5:9 --out study
  sandgait sweep --robot mine.toml --vary medium=poppy-loose,poppy-close --vary width=0.005:0.02:16 --out study
  sandgait sweep --vary xi=0:75:2 --vary chord=0.03:0.05:2 --optimize cost-of-transport --out study
  sandgait sweep --vary xi=-75:75:25 --learn 60 --option command=[0.1,0.6] --out study    (a gait learnt for each leg)
  sandgait sweep --vary xi=-75:75:2 --vary chord=0.03:0.05:2 --optimize return --learn-steps 3000000 --out study")]
pub struct SweepArgs {
    /// Parameter and its values; can be given twice
    #[arg(long, value_name = "NAME=VALUES", required = true, allow_hyphen_values = true)]
    vary: Vec<String>,
    /// Parameter with one value
    #[arg(long, value_name = "NAME=VALUE", allow_hyphen_values = true)]
    set: Vec<String>,
    /// Built-in robot or FILE.toml, with one joint in each leg
    #[arg(long, default_value = Robot::DEFAULT)]
    robot: String,
    /// Stride frequency [Hz] [default: 2]
    #[arg(long, value_name = "HZ")]
    frequency: Option<f64>,
    #[command(flatten)]
    sand: super::SandArgs,
    /// Measure in the figure: speed or cost-of-transport; with --learn also return
    #[arg(long, default_value = "speed")]
    measure: String,
    /// Search for the best design between the bounds instead of simulating the grid, by speed or cost-of-transport;
    /// with --learn also by return
    #[arg(long, value_name = "MEASURE")]
    optimize: Option<String>,
    /// Learn a gait for each design for this time [s], on one thread, instead of walking at one frequency. The task is
    /// HexapodGait with the settings of sandgait train. Each training is kept, and a repeated command continues the
    /// study
    #[arg(long, value_name = "SECONDS")]
    learn: Option<f64>,
    /// The same as --learn, but each training has this number of steps, so that the result has the same bits on a busy
    /// machine
    #[arg(long, value_name = "STEPS", conflicts_with = "learn", value_parser = super::whole::<u64>(1..=1_000_000_000_000))]
    learn_steps: Option<u64>,
    /// Number of trainings of each design
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = super::whole::<usize>(1..=1000))]
    trainings: usize,
    /// Along the last axis each design after the first starts with its neighbour's policy and learns for this time [s]
    /// or, with --learn-steps, for this number of steps
    #[arg(long, value_name = "SECONDS|STEPS", conflicts_with = "optimize")]
    warm: Option<f64>,
    /// Number of designs that --optimize tries with learnt gaits
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = super::whole::<usize>(1..=300))]
    designs: usize,
    #[command(flatten)]
    options: OptionArgs,
    /// Directory for the results
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

impl SweepArgs {
    pub fn run(self) -> Result<String> {
        let axes = self.vary.iter().map(|v| SweepAxis::parse(v)).collect::<Result<Vec<_>>>()?;
        if axes.len() > 2 && self.optimize.is_none() {
            return Err(Error::invalid("--vary", "a grid takes one or two parameters; --optimize takes more"));
        }
        self.check_once(&axes)?;
        let base = self.base()?;
        if self.learn.is_some() || self.learn_steps.is_some() {
            return self.learnt(base, axes);
        }
        if self.warm.is_some() || !self.options.is_empty() {
            return Err(Error::invalid("--warm, --option", "they are used only with --learn or --learn-steps"));
        }
        let measure = SweepMeasure::named(&self.measure)?;
        match &self.optimize {
            Some(goal) => self.search(&base, &axes, SweepMeasure::named(goal)?),
            None => self.grid(&base, &axes, measure),
        }
    }

    /// Refuses a parameter that two arguments set.
    fn check_once(&self, axes: &[SweepAxis]) -> Result<()> {
        let sand = &self.sand;
        let own = [
            ("--frequency", self.frequency.is_some()),
            ("--medium", sand.medium != Medium::DEFAULT),
            ("--law", sand.law != Law::Li2013.name()),
        ];
        let own = own.iter().filter(|(_, given)| *given).map(|(option, _)| (*option, &option[2..]));
        let varied = axes.iter().map(|axis| ("--vary", axis.parameter.name));
        let set = self.set.iter().filter_map(|text| text.split_once('=')).map(|(name, _)| ("--set", name));
        let mut seen: Vec<(&str, &str)> = Vec::new();
        for (option, name) in own.chain(varied).chain(set) {
            // ζ is the only number of a medium.
            let sets = if name == "zeta" { "medium" } else { name };
            if let Some((before, _)) = seen.iter().find(|(_, other)| *other == sets) {
                return Err(Error::invalid(option, format!("{name} is given already by {before}")));
            }
            seen.push((option, sets));
        }
        Ok(())
    }

    fn base(&self) -> Result<Design> {
        let scene = Scene::on(&self.sand.sand_to_walk_on()?);
        let robot = Robot::load(&self.robot)?;
        let mut base = Design { robot, scene, frequency: self.frequency.unwrap_or(Design::FREQUENCY), phase: 0.0 };
        let setting = |setting: &'_ String| {
            let parts = setting.split_once('=').map(|(name, value)| (name.to_owned(), value.to_owned()));
            parts.ok_or_else(|| Error::invalid("--set", format!("{setting:?} is not NAME=VALUE")))
        };
        let settings = self.set.iter().map(setting).collect::<Result<Vec<_>>>()?;
        base.set(settings.iter().map(|(name, value)| (name.as_str(), value.as_str())))?;
        Ok(base)
    }

    fn grid(&self, base: &Design, axes: &[SweepAxis], measure: SweepMeasure) -> Result<String> {
        let count = grid::check_grid(base, axes)?;
        let _lock = self.prepare()?;
        let start = std::time::Instant::now();
        let results = grid(base, axes, &Bar::new())?;
        let seconds = start.elapsed().as_secs_f64();
        self.write("sweep.csv", &table::csv(axes, &results))?;
        let title = title(base, axes);
        png::write_both(&table::figure(axes, &results, measure, &title).svg(), &self.out.join("sweep.svg"))?;
        let best = measure.best(&results).map_or_else(String::new, |i| {
            let at = axes.iter().zip(table::values(axes, i)).map(|(a, v)| format!("{} = {v}", a.parameter.label()));
            format!(
                "best {}: {:.3} at {}\n",
                measure.label(),
                measure.of(&results[i]),
                at.collect::<Vec<_>>().join(", ")
            )
        });
        let diverged = results.iter().filter(|r| !r.speed.is_finite()).count();
        let warning = if diverged > 0 { format!("{diverged} walks diverged and are blank\n") } else { String::new() };
        Ok(format!("{best}{warning}{count} walks in {seconds:.1} s → {}\n", self.out.join("sweep.csv").display()))
    }

    fn learnt(&self, base: Design, axes: Vec<SweepAxis>) -> Result<String> {
        let measure = design::GaitMeasure::named(self.optimize.as_ref().unwrap_or(&self.measure))?;
        let mut settings = entry::settings(None, HexapodGait::ID, entry::ends(self.learn_steps, self.learn)?)?;
        let pairs = self.options.read()?;
        let options = std::mem::take(&mut settings.env_kwargs).into_iter().chain(pairs).collect();
        self.warm.map_or(Ok(0.0), |warm| check_range("--warm", warm, 1e-3..=1e12))?;
        let search = self.optimize.as_ref().map(|_| self.designs);
        let (trainings, warm, out) = (self.trainings, self.warm, self.out.clone());
        let study = design::DesignStudy { base, axes, options, settings, trainings, warm, search, out };
        study.check()?;
        let _lock = self.prepare()?;
        let findings = study.run(measure, &Bar::new())?;
        super::design::report(&study, &findings, measure, &self.out)
    }

    fn search(&self, base: &Design, axes: &[SweepAxis], goal: SweepMeasure) -> Result<String> {
        optimize::bounds(base, axes)?;
        let _lock = self.prepare()?;
        let start = std::time::Instant::now();
        let best = optimize::optimize(base, axes, goal, &Bar::new())?;
        let named: Vec<_> =
            axes.iter().zip(&best.values).map(|(a, v)| format!("{} = {v:.6}", a.parameter.label())).collect();
        let mut rows = axes.iter().map(|a| a.parameter.label()).collect::<Vec<_>>().join(",");
        rows += ",speed [m/s],cost of transport\n";
        rows += &best.values.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
        rows += &format!(",{:.6},{:.6}\n", best.result.speed, best.result.cost_of_transport);
        self.write("optimum.csv", &rows)?;
        Ok(format!(
            "best {}: {:.3} at {}\nspeed {:.2} cm/s, cost of transport {:.3}; {} walks in {:.1} s\n",
            goal.label(),
            goal.of(&best.result),
            named.join(", "),
            100.0 * best.result.speed,
            best.result.cost_of_transport,
            optimize::WALKS,
            start.elapsed().as_secs_f64(),
        ))
    }

    /// Creates the folder for the results, and locks it for this process.
    fn prepare(&self) -> Result<Lock> {
        std::fs::create_dir_all(&self.out).map_err(|e| Error::file(&self.out, e))?;
        Lock::new(&self.out, "choose another one with --out, or wait until it has ended")
    }

    fn write(&self, name: &str, text: &str) -> Result<()> {
        files::write(&self.out.join(name), text.as_bytes())
    }
}

/// Robot, sand and law, except for the varied parameters.
fn title(base: &Design, axes: &[SweepAxis]) -> String {
    let varied = |names: &[&str]| axes.iter().any(|a| names.contains(&a.parameter.name));
    let medium = if varied(&["medium", "zeta"]) { "" } else { base.scene.medium.name.as_str() };
    let law = if varied(&["law"]) { "" } else { base.scene.law.name() };
    [base.robot.name.as_str(), medium, law].into_iter().filter(|t| !t.is_empty()).collect::<Vec<_>>().join(", ")
}
