//! `walk`: walks at constant stride frequencies.

use super::arguments::{NameOrPath, Numbers, OutputPath, SandArgs};
use super::declare::{Study, StudyWork};
use super::inputs::Inputs;
use super::options::{OptionArgs, unfelt_option};
use super::result::{StudyColumn, StudyFile, StudyResult, StudyTable};
use crate::env::Task;
use crate::env::gait::HexapodGait;
use crate::env::registry::Blueprint;
use crate::error::{Error, Result, check_range};
use crate::parallel;
use crate::progress::Progress;
use crate::sand::{Law, Medium};
use crate::sim::engine::EngineKind;
use crate::sim::model::Scene;
use crate::sim::walk::{WalkResult, WalkTrial, Watch, walk_watched};
use crate::sim::{Model, Robot, State};
use crate::view::{self, About, RecordedState};
use sandgait_sweep::walk_all;
use serde_json::{Map, Value, json};
use std::cell::Cell;

/// Recorded states in a second [Hz]: our choice, because this is twenty in a stride at the highest stride frequency of
/// Li et al. 2012.
const RECORDED_RATE: f64 = 100.0;

/// Largest number of stride frequencies: our choice, because each has a model in memory.
const MOST_FREQUENCIES: usize = 4096;

/// Memory of a walk's model [bytes]: 4096 of them take some 100 MiB.
pub(super) const MODEL: usize = 25 << 10;

/// Most walks that a core simulates at a time.
const LANES: usize = 16;

/// Memory of a recorded state [bytes]: 1,024 heights of moved sand and some 80 numbers of the robot, 4 bytes each.
const RECORDED_ROW: usize = 4500;

/// The options of HexapodGait that a walk has; the others are of the task's actions, commands and rewards.
const OPTIONS: [&str; 11] =
    ["robot", "engine", "law", "dt", "torque_limit", "leg", "medium", "sand", "memory", "slope_deg", "payload"];

/// Simulate walks with an alternating tripod at constant stride frequencies, and measure speed and work.
///
/// The speed is measured over four strides, after two others. At frequency 0 the robot stands for 10 s, and its sinkage
/// and drift are measured. --option changes the robot and its sand by an option of HexapodGait; the other arguments take
/// precedence. The table has a row for each frequency; the numbers of a walk that diverged are blank.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait walk --leg L --frequency 2
  sandgait walk --leg C --frequency 1,2,3 --csv walks.csv
  sandgait walk --leg revC --frequency 3 --medium poppy-close --slope-deg 5 --json
  sandgait walk --frequency 2 --option torque_limit=0.02 --option memory=true
  sandgait walk --robot mine.toml --frequency 0        (stand still)
  sandgait walk --leg C --frequency 2 --record walk.rec && sandgait replay walk.rec --html walk.html")]
pub struct Walk {
    /// Turns of the hips in a second [Hz], one or several; with a negative frequency the robot walks backward, with 0 it
    /// stands
    #[arg(long, value_name = "HZ", required = true, allow_hyphen_values = true)]
    frequency: Numbers,
    /// Shape of the legs: L, revL, C, revC, flat or xi=DEGREES; default: the robot's own
    #[arg(long)]
    leg: Option<String>,
    /// Engine that integrates the motion
    #[arg(long, default_value = EngineKind::Lanes.name())]
    engine: String,
    #[command(flatten)]
    sand: SandArgs,
    /// Slope of the surface [°]; a positive slope rises in the walking direction
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0)]
    slope_deg: f64,
    /// Time step [s]; default: 0.001, with engine rapier 0.0005
    #[arg(long, value_name = "S")]
    dt: Option<f64>,
    /// A built-in robot or a FILE.toml
    #[arg(long, default_value = Robot::DEFAULT)]
    robot: NameOrPath,
    #[command(flatten)]
    options: OptionArgs,
    /// Record the walk in this file, with 100 states in a second, for `sandgait replay`
    #[arg(long, value_name = "FILE")]
    record: Option<OutputPath>,
}

impl Study for Walk {
    const NAME: &'static str = "walk";
    const PYTHON: &'static str = "Walks";

    fn read(&self, inputs: &mut Inputs) -> Result<()> {
        self.sand.read(inputs)?;
        self.robot.read(&["toml"], inputs)
    }

    fn next(&self) -> Option<String> {
        Some(match &self.record {
            Some(file) => format!("to see it: sandgait replay {0} --html {0}.html", file.0),
            None => {
                "to see it: the same command with --record walk.rec, then sandgait replay walk.rec --html walk.html"
                    .into()
            }
        })
    }

    fn check(self, inputs: &Inputs) -> Result<StudyWork> {
        let (model, engine, warnings) = self.model(inputs)?;
        let frequencies = &self.frequency.0;
        check_range("number of frequencies", frequencies.len() as f64, 1.0..=MOST_FREQUENCIES as f64)?;
        if self.record.is_some() && frequencies.len() > 1 {
            return Err(Error::invalid("--record", "one walk can be recorded; give one frequency"));
        }
        // The models of all walks are made when there is memory for them.
        let running = frequencies.len().min(LANES * parallel::processors());
        let bytes = frequencies.len() * MODEL + running * model.sand_bytes();
        let mut trial = WalkTrial::new(model, frequencies[0]);
        for frequency in frequencies {
            trial.frequency = *frequency;
            trial.validate()?;
        }
        let recording = self.record.as_ref().map_or(0, |_| (trial.duration() * RECORDED_RATE) as usize * RECORDED_ROW);
        let (record, frequencies) = (self.record, self.frequency.0);
        let run = move |progress: &dyn Progress| {
            let trials: Vec<_> = frequencies.iter().map(|f| WalkTrial::new(trial.model.clone(), *f)).collect();
            match record {
                None => Ok(result(engine, &trials, &walk_all(engine, &trials, progress)?)),
                Some(OutputPath(name)) => {
                    let (walk, content) = recorded(engine, &trials[0], progress)?;
                    let named_files = vec![StudyFile { name, content }];
                    Ok(StudyResult { named_files, ..result(engine, &trials, &[walk]) })
                }
            }
        };
        let bytes = bytes + recording;
        Ok(StudyWork::new(run).warning(warnings).taking(bytes))
    }
}

impl Walk {
    fn model(&self, inputs: &Inputs) -> Result<(Model, EngineKind, Vec<String>)> {
        if !self.options.is_empty() {
            return self.by_options(inputs);
        }
        let mut robot = self.robot.robot(inputs)?;
        if let Some(leg) = &self.leg {
            robot = robot.with_leg_shape(leg)?;
        }
        let (sand, warnings) = self.sand.to_walk_on(inputs)?;
        let mut scene = Scene::on(&sand);
        let engine = EngineKind::named(&self.engine)?;
        (scene.slope_deg, scene.dt) = (self.slope_deg, self.dt.unwrap_or(engine.default_dt()));
        Ok((Model::new(&robot, &scene)?, engine, warnings))
    }

    /// The model of HexapodGait with options of the task.
    fn by_options(&self, inputs: &Inputs) -> Result<(Model, EngineKind, Vec<String>)> {
        let given = self.options.read(inputs.options)?;
        if let Some(name) = given.keys().find(|name| !OPTIONS.contains(&name.as_str())) {
            return Err(Error::unknown("option", name, &OPTIONS));
        }
        let number = |x: f64, default: f64| (x != default).then(|| json!(x));
        let text = |text: &str, default: &str| (text != default).then(|| json!(text));
        let (sand, warnings) = self.sand.sand(inputs)?;
        let file = self.sand.sand.as_ref().map(|_| sand.to_toml()).transpose()?;
        let arguments = [
            ("leg", self.leg.as_ref().map(|leg| json!(leg))),
            ("engine", text(&self.engine, EngineKind::Lanes.name())),
            ("medium", text(&self.sand.medium, Medium::DEFAULT)),
            ("law", text(&self.sand.law, Law::Li2013.name())),
            ("sand", file.map(|sand| json!(sand))),
            ("slope_deg", number(self.slope_deg, 0.0)),
            ("dt", self.dt.map(|dt| json!(dt))),
            ("robot", text(&self.robot.0, Robot::DEFAULT)),
        ];
        let arguments = arguments.into_iter().filter_map(|(name, value)| Some((name.to_owned(), value?)));
        let options = Value::Object(given.into_iter().chain(arguments).collect());
        let warnings = warnings.into_iter().chain(unfelt_option(&options)).collect();
        let blueprint = Blueprint::new(HexapodGait::ID, options)?;
        Ok((Model::clone(blueprint.task.model()), blueprint.engine, warnings))
    }
}

/// Columns of walks. The cost of transport of a robot that stands is undefined: NaN.
pub(super) fn columns(results: &[WalkResult]) -> Vec<StudyColumn> {
    StudyColumn::of_rows(
        results,
        &[
            ("speed", "m/s", |r| r.speed),
            ("base_height", "m", |r| r.base_height),
            ("pitch_rms", "rad", |r| r.pitch_rms),
            ("hip_torque_rms", "N·m", |r| r.hip_torque_rms),
            ("hip_speed_error_rms", "rad/s", |r| r.hip_speed_error_rms),
            ("cost_of_transport", "1", |r| r.cost_of_transport),
            ("sink", "m", |r| r.sink),
            ("drift", "m", |r| r.drift),
        ],
    )
}

/// A line about walks that diverged.
pub(super) fn diverged(results: &[WalkResult]) -> Option<String> {
    let lost = results.iter().filter(|r| !r.speed.is_finite()).count();
    (lost > 0).then(|| format!("{lost} of {} walks diverged, their numbers are blank; try a smaller dt", results.len()))
}

/// The failure of a study whose walks have all diverged.
fn nothing_walked(results: &[WalkResult]) -> Option<String> {
    let lost = results.iter().all(|r| !r.speed.is_finite());
    lost.then(|| "the simulation diverged; try a smaller dt".to_owned())
}

fn result(engine: EngineKind, trials: &[WalkTrial], results: &[WalkResult]) -> StudyResult {
    let frequency = StudyColumn::numbers("frequency", "Hz", trials.iter().map(|t| t.frequency));
    let table = StudyTable::new("walks", std::iter::once(frequency).chain(columns(results)).collect());
    // The numbers of a single walk stand at the top of the JSON form, too.
    let mut about = if trials.len() == 1 { table.row(0) } else { Map::new() };
    about.insert("engine".into(), engine.name().into());
    let line = |(trial, r): (&WalkTrial, &WalkResult)| {
        let begin = if trials.len() > 1 { format!("{} Hz: ", trial.frequency) } else { String::new() };
        match trial.frequency {
            0.0 => format!("{begin}sinks {:.4} mm, drifts {:.4} mm in 10 s\n", r.sink * 1e3, r.drift * 1e3),
            _ => format!("{begin}{:.4} m/s, base at {:.1} mm\n", r.speed, r.base_height * 1e3),
        }
    };
    let failure = nothing_walked(results);
    StudyResult {
        summary: trials.iter().zip(results).map(line).collect(),
        warnings: diverged(results).filter(|_| failure.is_none()).into_iter().collect(),
        failure,
        about,
        simulated: trials.iter().map(WalkTrial::duration).sum(),
        ..StudyResult::table(table)
    }
}

/// Simulates the walk and makes its recording.
fn recorded(engine: EngineKind, trial: &WalkTrial, progress: &dyn Progress) -> Result<(WalkResult, Vec<u8>)> {
    let failed = |e: std::io::Error| Error::Internal(format!("the recording cannot be made: {e}"));
    let about = About { task: "sandgait walk", rate: RECORDED_RATE, ..About::default() };
    let mut writer = view::RecordingWriter::new(Vec::new(), &view::header(&trial.model, &about)).map_err(failed)?;
    let mut written = Ok(());
    let mut see = |time: f64, state: &State| {
        let moment = RecordedState { time, state, footing: &[], action: &[], reward: 0.0, info: &[] };
        if written.is_ok() {
            written = writer.row(&view::row(&trial.model, &moment));
        }
    };
    let passed = Cell::new(0.0);
    let advanced = |seconds: f64| {
        passed.set(passed.get() + seconds);
        progress.report((passed.get() / trial.duration()).min(1.0), "1 walk")
    };
    let result = walk_watched(engine, trial, &advanced, &mut Watch { rate: RECORDED_RATE, see: &mut see })?;
    let content = written.and_then(|()| writer.finish()).map_err(failed)?;
    Ok((result, content))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sand::SandDescription;

    #[test]
    fn a_study_fails_if_all_walks_diverged() {
        let sand = SandDescription::named(Medium::DEFAULT, Law::Li2013.name()).unwrap();
        let model = Model::new(&Robot::built_in(Robot::DEFAULT).unwrap(), &Scene::on(&sand)).unwrap();
        let trials = [1.0, 2.0].map(|frequency| WalkTrial::new(model.clone(), frequency));
        let good = WalkResult { speed: 0.1, ..WalkResult::lost() };
        let lost = WalkResult::lost();
        let told = |results: &[WalkResult]| {
            let made = result(EngineKind::Lanes, &trials[..results.len()], results);
            (made.warnings.len(), made.failure)
        };
        assert_eq!(told(&[good, good]), (0, None));
        assert_eq!(told(&[good, lost]), (1, None));
        for all in [&[lost] as &[_], &[lost, lost]] {
            assert_eq!(told(all), (0, Some("the simulation diverged; try a smaller dt".into())));
        }
    }
}
