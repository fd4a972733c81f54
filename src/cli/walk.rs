//! `sandgait walk`

use super::options::OptionArgs;
use sandgait::env::Task;
use sandgait::env::gait::HexapodGait;
use sandgait::env::registry::Blueprint;
use sandgait::sand::{Law, Medium};
use sandgait::sim::engine::EngineKind;
use sandgait::sim::model::Scene;
use sandgait::sim::walk::{WalkResult, WalkTrial, Watch, walk, walk_watched};
use sandgait::sim::{Model, Robot};
use sandgait::view::{self, About, RecordedState};
use sandgait::{Error, Result};
use serde_json::{Value, json};
use std::path::Path;
use std::time::Instant;

/// Recorded states in a second [Hz]: our choice, because this is twenty in a stride at the highest stride frequency of
/// Li et al. 2012.
const RECORDED_RATE: f64 = 100.0;

/// Simulate a walk with an alternating tripod at constant stride frequency, and measure the speed.
///
/// The speed is measured over four strides, after two others. At frequency 0 the robot stands for 10 s, and its sinkage
/// and drift are measured. --option changes the robot and its sand by an option of HexapodGait; the other arguments take
/// precedence.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait walk --leg L --frequency 2
  sandgait walk --leg revC --frequency 3 --medium poppy-close --slope-deg 5 --json
  sandgait walk --frequency 2 --option torque_limit=0.02 --option memory=true
  sandgait walk --robot mine.toml --frequency 0        (stand still)
  sandgait walk --leg C --frequency 2 --record walk.rec && sandgait replay walk.rec --html walk.html")]
pub struct WalkArgs {
    /// Shape of the legs: L, revL, C, revC, flat or xi=DEGREES; default: the robot's own
    #[arg(long)]
    leg: Option<String>,
    /// Turns of the hips in a second [Hz]; with a negative frequency the robot walks backward, with 0 it stands
    #[arg(long, value_name = "HZ", allow_negative_numbers = true)]
    frequency: f64,
    /// Engine that integrates the motion
    #[arg(long, default_value = EngineKind::Lanes.name())]
    engine: String,
    #[command(flatten)]
    sand: super::SandArgs,
    /// Slope of the surface [°]; a positive slope rises in the walking direction
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, allow_negative_numbers = true)]
    slope_deg: f64,
    /// Time step [s]; default: 0.001, with engine rapier 0.0005
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    dt: Option<f64>,
    /// A built-in robot or a FILE.toml
    #[arg(long, default_value = Robot::DEFAULT)]
    robot: String,
    #[command(flatten)]
    options: OptionArgs,
    /// Record the walk in this file, with 100 states in a second, for `sandgait replay`
    #[arg(long, value_name = "FILE")]
    record: Option<std::path::PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// The options of HexapodGait that a walk has; the others are of the task's actions, commands and rewards.
const OPTIONS: [&str; 11] =
    ["robot", "engine", "law", "dt", "torque_limit", "leg", "medium", "sand", "memory", "slope_deg", "payload"];

impl WalkArgs {
    fn model(&self) -> Result<(Model, EngineKind)> {
        if !self.options.is_empty() {
            return self.by_options();
        }
        let mut robot = Robot::load(&self.robot)?;
        if let Some(leg) = &self.leg {
            robot = robot.with_leg_shape(leg)?;
        }
        let mut scene = Scene::on(&self.sand.sand_to_walk_on()?);
        let engine = EngineKind::named(&self.engine)?;
        (scene.slope_deg, scene.dt) = (self.slope_deg, self.dt.unwrap_or(engine.default_dt()));
        Ok((Model::new(&robot, &scene)?, engine))
    }

    /// The model of HexapodGait with options of the task.
    fn by_options(&self) -> Result<(Model, EngineKind)> {
        let given = self.options.read()?;
        if let Some(name) = given.keys().find(|name| !OPTIONS.contains(&name.as_str())) {
            return Err(Error::unknown("option", name, &OPTIONS));
        }
        let number = |x: f64, default: f64| (x != default).then(|| json!(x));
        let text = |text: &str, default: &str| (text != default).then(|| json!(text));
        let sand = self.sand.sand.as_ref().map(|_| self.sand.sand().and_then(|sand| sand.to_toml())).transpose()?;
        let arguments = [
            ("leg", self.leg.as_ref().map(|leg| json!(leg))),
            ("engine", text(&self.engine, EngineKind::Lanes.name())),
            ("medium", text(&self.sand.medium, Medium::DEFAULT)),
            ("law", text(&self.sand.law, Law::Li2013.name())),
            ("sand", sand.map(|sand| json!(sand))),
            ("slope_deg", number(self.slope_deg, 0.0)),
            ("dt", self.dt.map(|dt| json!(dt))),
            ("robot", text(&self.robot, Robot::DEFAULT)),
        ];
        let arguments = arguments.into_iter().filter_map(|(name, value)| Some((name.to_owned(), value?)));
        let options = Value::Object(given.into_iter().chain(arguments).collect());
        super::warn_of_unfelt_option(&options);
        let blueprint = Blueprint::new(HexapodGait::ID, options)?;
        Ok((Model::clone(blueprint.task.model()), blueprint.engine))
    }

    pub fn run(self) -> Result<String> {
        let (model, engine) = self.model()?;
        let trial = WalkTrial::new(model, self.frequency);
        let clock = Instant::now();
        let result = match &self.record {
            None => walk(engine, &trial)?,
            Some(path) => recorded(engine, &trial, path)?,
        };
        let real_time_factor = trial.duration() / clock.elapsed().as_secs_f64();
        if !result.speed.is_finite() {
            return Err(Error::Exhausted("the simulation diverged; try a smaller --dt".into()));
        }
        if self.json {
            return Ok(super::json(&json!({
                "engine": engine.name(),
                "frequency": self.frequency,
                "speed": result.speed,
                "base_height": result.base_height,
                "sink": result.sink,
                "drift": result.drift,
                "pitch_rms": result.pitch_rms,
                "hip_torque_rms": result.hip_torque_rms,
                "cost_of_transport": (self.frequency != 0.0).then_some(result.cost_of_transport),
                "real_time_factor": real_time_factor,
            })));
        }
        let pace = format!("({real_time_factor:.0} times real time)");
        Ok(match self.frequency {
            0.0 => format!("sinks {:.4} mm, drifts {:.4} mm in 10 s {pace}\n", result.sink * 1e3, result.drift * 1e3),
            _ => format!("{:.4} m/s, base at {:.1} mm {pace}\n", result.speed, result.base_height * 1e3),
        })
    }
}

/// Simulates the walk and writes the recording. The file appears when it is complete.
fn recorded(engine: EngineKind, trial: &WalkTrial, path: &Path) -> Result<WalkResult> {
    let failed = |e: std::io::Error| Error::unwritten(path, &e);
    let about = About { task: "sandgait walk", rate: RECORDED_RATE, ..About::default() };
    let mut writer = view::RecordingWriter::new(Vec::new(), &view::header(&trial.model, &about)).map_err(failed)?;
    let mut written = Ok(());
    let mut see = |time: f64, state: &sandgait::sim::State| {
        let moment = RecordedState { time, state, footing: &[], action: &[], reward: 0.0, info: &[] };
        if written.is_ok() {
            written = writer.row(&view::row(&trial.model, &moment));
        }
    };
    let result = walk_watched(engine, trial, &mut Watch { rate: RECORDED_RATE, see: &mut see })?;
    written.and_then(|()| writer.finish()).and_then(|file| std::fs::write(path, file)).map_err(failed)?;
    Ok(result)
}
