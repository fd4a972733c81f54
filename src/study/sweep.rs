//! `sweep`: walks of designs.

use super::arguments::{NameOrPath, SandArgs, Setting, cells};
use super::declare::{Study, StudyWork};
use super::inputs::Inputs;
use super::result::{StudyColumn, StudyFile, StudyResult, StudyTable};
use super::walk::{MODEL, columns, diverged};
use crate::error::{Error, Result, check_range};
use crate::progress::Progress;
use crate::sand::{Law, Medium};
use crate::sim::Robot;
use crate::sim::model::Scene;
use sandgait_sweep::grid::{MOST_WALKS, check_grid, grid};
use sandgait_sweep::{Design, Parameter, SweepAxis, SweepMeasure, figure, optimize};
use serde_json::{Map, json};

/// Study a design: simulate walks of a robot over a grid of one or two parameters, or search for the best design.
///
/// The table has a row for each design, first the varied parameters and then the columns of a walk; the last parameter varies
/// fastest. A search gives one row. A grid also has a figure, a heat map for two parameters or a line for one. A parameter is
/// varied with NAME=FIRST:LAST:COUNT or NAME=VALUE,VALUE,… and fixed with --set NAME=VALUE. Names: xi [°], leg, chord [m],
/// width [m], leg-mass [kg], base-mass [kg], hip-height [m], belly [m], frequency [Hz], phase [rad], medium, zeta [N/cm³],
/// law, slope [°], payload [kg], torque-limit [N·m], kp [N·m/rad].
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait sweep --vary xi=-75:75:31 --vary frequency=1:5:9 --out study
  sandgait sweep --robot mine.toml --vary medium=poppy-loose,poppy-close --vary width=0.005:0.02:16 --out study
  sandgait sweep --vary xi=0:75:2 --vary chord=0.03:0.05:2 --optimize cost-of-transport --out study")]
pub struct Sweep {
    /// Parameters and their values, one or two
    #[arg(long, value_name = "NAME=VALUES", required = true, allow_hyphen_values = true)]
    vary: Vec<Setting>,
    /// Parameters with one value
    #[arg(long, value_name = "NAME=VALUE", allow_hyphen_values = true)]
    set: Vec<Setting>,
    /// Built-in robot or FILE.toml, with one joint in each leg
    #[arg(long, default_value = Robot::DEFAULT)]
    robot: NameOrPath,
    /// Stride frequency [Hz]; default: 2
    #[arg(long, value_name = "HZ")]
    frequency: Option<f64>,
    #[command(flatten)]
    sand: SandArgs,
    /// Measure of the figure and of the best design: speed or cost-of-transport
    #[arg(long, default_value = SweepMeasure::Speed.name())]
    measure: String,
    /// Search for the best design between the least and the greatest value of each parameter instead of simulating the
    /// grid, by speed or cost-of-transport
    #[arg(long, value_name = "MEASURE")]
    optimize: Option<String>,
}

impl Study for Sweep {
    const NAME: &'static str = "sweep";
    const PYTHON: &'static str = "Sweep";

    fn read(&self, inputs: &mut Inputs) -> Result<()> {
        self.sand.read(inputs)?;
        self.robot.read(&["toml"], inputs)
    }

    fn next(&self) -> Option<String> {
        Some("to see one of them: sandgait walk --frequency HZ --record walk.rec".into())
    }

    fn check(self, inputs: &Inputs) -> Result<StudyWork> {
        let goal = self.optimize.as_deref().map(SweepMeasure::named).transpose()?;
        let measure = goal.map_or_else(|| SweepMeasure::named(&self.measure), Ok)?;
        let axes = self.vary.iter().map(axis).collect::<Result<Vec<_>>>()?;
        check_range("number of parameters in vary", axes.len() as f64, 1.0..=Parameter::ALL.len() as f64)?;
        if axes.len() > 2 && goal.is_none() {
            return Err(Error::invalid("--vary", "a grid takes one or two parameters; --optimize takes more"));
        }
        let (sand, warnings) = self.sand.to_walk_on(inputs)?;
        let settings = self.settings(&axes)?;
        let frequency = self.frequency.unwrap_or(Design::FREQUENCY);
        let mut base = Design { robot: self.robot.robot(inputs)?, scene: Scene::on(&sand), frequency, phase: 0.0 };
        base.set(settings.iter().map(|(name, value)| (name.as_str(), value.as_str())))?;
        let walks = match goal {
            None => check_grid(&base, &axes)?,
            Some(_) => optimize::bounds(&base, &axes).map(|_| optimize::WALKS)?,
        };
        let bytes = walks.min(MOST_WALKS) * RESULT + walks.min(4096) * MODEL;
        let run = move |progress: &dyn Progress| match goal {
            None => whole(&base, &axes, measure, progress),
            Some(goal) => best(&base, &axes, goal, progress),
        };
        Ok(StudyWork::new(run).warning(warnings).taking(bytes))
    }
}

/// Memory of a walk's result, in the table and in its message [bytes].
const RESULT: usize = 256;

impl Sweep {
    /// Names and values of `set`. Refuses a parameter that two arguments set.
    fn settings(&self, axes: &[SweepAxis]) -> Result<Vec<(String, String)>> {
        let settings = self.set.iter().map(setting).collect::<Result<Vec<_>>>()?;
        let own = [
            ("--frequency", self.frequency.is_some()),
            ("--medium", self.sand.medium != Medium::DEFAULT),
            ("--law", self.sand.law != Law::Li2013.name()),
        ];
        let own = own.iter().filter(|(_, given)| *given).map(|(option, _)| (*option, &option[2..]));
        let varied = axes.iter().map(|axis| ("--vary", axis.parameter.name));
        let set = settings.iter().map(|(name, _)| ("--set", &name[..]));
        let mut seen: Vec<(&str, &str)> = Vec::new();
        for (argument, name) in own.chain(varied).chain(set) {
            // ζ is the only number of a medium.
            let sets = if name == "zeta" { "medium" } else { name };
            if let Some((before, _)) = seen.iter().find(|(_, other)| *other == sets) {
                return Err(Error::invalid(argument, format!("{name} is given already by {before}")));
            }
            seen.push((argument, sets));
        }
        Ok(settings)
    }
}

/// A parameter and its values; a list in brackets may have names with commas.
fn axis(vary: &Setting) -> Result<SweepAxis> {
    match vary.0.split_once('=') {
        Some((name, values)) if values.starts_with('[') => SweepAxis::new(name, cells(values)?),
        _ => SweepAxis::parse(&vary.0),
    }
}

/// A parameter and its one value.
fn setting(set: &Setting) -> Result<(String, String)> {
    let parts = set.0.split_once('=');
    let (name, value) = parts.ok_or_else(|| Error::invalid("--set", format!("{:?} is not NAME=VALUE", set.0)))?;
    let mut values = if value.starts_with('[') { cells(value)? } else { vec![value.to_owned()] };
    match (values.pop(), values.len()) {
        (Some(value), 0) => Ok((name.to_owned(), value)),
        (_, others) => Err(Error::invalid(name, format!("{} values where one is set", others + 1))),
    }
}

/// All designs of the grid.
fn whole(base: &Design, axes: &[SweepAxis], measure: SweepMeasure, progress: &dyn Progress) -> Result<StudyResult> {
    let results = grid(base, axes, progress)?;
    let cells = |k: usize| (0..results.len()).map(move |i| figure::values(axes, i)[k]);
    let axis = |(k, axis): (usize, &SweepAxis)| match axis.numbers() {
        Some(_) => {
            let numbers = cells(k).filter_map(|cell| cell.parse().ok());
            StudyColumn::numbers(axis.parameter.name, axis.parameter.unit, numbers)
        }
        None => StudyColumn::names(axis.parameter.name, cells(k)),
    };
    let all = axes.iter().enumerate().map(axis).chain(columns(&results)).collect();
    let summary = measure.best(&results).map_or_else(String::new, |i| {
        let at = axes.iter().zip(figure::values(axes, i)).map(|(a, v)| format!("{} = {v}", a.parameter.label()));
        let at = at.collect::<Vec<_>>().join(", ");
        format!("best {}: {:.3} at {at}; {} walks\n", measure.label(), measure.of(&results[i]), results.len())
    });
    let svg = figure::figure(axes, &results, measure, &title(base, axes)).svg();
    Ok(StudyResult {
        summary,
        warnings: diverged(&results).into_iter().collect(),
        about: Map::from_iter([("measure".to_owned(), json!(measure.name()))]),
        files: vec![StudyFile::new("sweep.svg", svg)],
        ..StudyResult::table(StudyTable::new("sweep", all))
    })
}

/// The best design.
fn best(base: &Design, axes: &[SweepAxis], goal: SweepMeasure, progress: &dyn Progress) -> Result<StudyResult> {
    let best = optimize::optimize(base, axes, goal, progress)?;
    let value =
        |(axis, value): (&SweepAxis, &f64)| StudyColumn::numbers(axis.parameter.name, axis.parameter.unit, [*value]);
    let all = axes.iter().zip(&best.values).map(value).chain(columns(&[best.result])).collect();
    let named = axes.iter().zip(&best.values).map(|(a, v)| format!("{} = {v:.6}", a.parameter.label()));
    let summary = format!(
        "best {}: {:.3} at {}\nspeed {:.2} cm/s, cost of transport {:.3}; {} walks\n",
        goal.label(),
        goal.of(&best.result),
        named.collect::<Vec<_>>().join(", "),
        100.0 * best.result.speed,
        best.result.cost_of_transport,
        optimize::WALKS,
    );
    let about = Map::from_iter([("optimize".to_owned(), json!(goal.name()))]);
    Ok(StudyResult { summary, about, ..StudyResult::table(StudyTable::new("optimum", all)) })
}

/// Robot, sand and law, except for the varied parameters.
fn title(base: &Design, axes: &[SweepAxis]) -> String {
    let varied = |names: &[&str]| axes.iter().any(|a| names.contains(&a.parameter.name));
    let medium = if varied(&["medium", "zeta"]) { "" } else { base.scene.medium.name.as_str() };
    let law = if varied(&["law"]) { "" } else { base.scene.law.name() };
    [base.robot.name.as_str(), medium, law].into_iter().filter(|t| !t.is_empty()).collect::<Vec<_>>().join(", ")
}
