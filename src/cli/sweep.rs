//! `sandgait sweep`

use super::Bar;
use sandgait::files::{self, Lock};
use sandgait::sand::{Law, Medium};
use sandgait::sim::Robot;
use sandgait::sim::model::Scene;
use sandgait::sweep::{Design, SweepAxis, SweepMeasure, grid, optimize, table};
use sandgait::{Error, Result};
use std::path::PathBuf;

/// Study a design: simulate walks of a robot over a grid of one or two parameters, or search for the best design.
///
/// Writes sweep.csv, and sweep.svg with a heat map for two parameters or a line for one. A parameter is
/// varied with NAME=FIRST:LAST:COUNT or NAME=VALUE,VALUE,… and fixed with --set NAME=VALUE. Names: xi, leg, chord,
/// width, leg-mass, base-mass, hip-height, belly, frequency, phase, medium, zeta, law, slope, payload, torque-limit,
/// kp.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait sweep --vary xi=-75:75:31 --vary frequency=1:5:9 --out study
  sandgait sweep --robot mine.toml --vary medium=poppy-loose,poppy-close --vary width=0.005:0.02:16 --out study
  sandgait sweep --vary xi=0:75:2 --vary chord=0.03:0.05:2 --optimize cost-of-transport --out study")]
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
    /// Measure in the figure: speed or cost-of-transport
    #[arg(long, default_value = "speed")]
    measure: String,
    /// Search for the best design between the bounds instead of simulating the grid, by speed or cost-of-transport
    #[arg(long, value_name = "MEASURE")]
    optimize: Option<String>,
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
        table::figure(axes, &results, measure, &title).write(&self.out.join("sweep.svg"))?;
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
        std::fs::create_dir_all(&self.out).map_err(|e| Error::unwritten(&self.out, &e))?;
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
