//! Keywords of a task: what `gymnasium.make` takes. Unknown ones are refused; defaults stand here and nowhere else.

mod control;
pub mod keywords;
mod legged;
mod randomize;
mod relief;
mod reset;
mod robot;
mod rocks;
mod stroke;
mod weights;

pub use control::Control;
pub use keywords::OPTION_HELP;
pub use legged::{Commands, DomainRand, Rewards};
pub(super) use randomize::Quantity;
pub use randomize::Randomize;
pub use relief::ReliefOptions;
pub use reset::{Partial, ResetOptions};
pub use robot::RobotName;
pub use rocks::RockOptions;
pub use stroke::StrokeOptions;
pub use weights::Weights;

use crate::error::{Error, Result, check_range};
use crate::sand::{Law, Medium, SandDescription, Surface};
use crate::sim::engine::EngineKind;
use crate::sim::model::Scene;
use crate::sim::{Model, Robot};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use serde_json::{Map, Value};
use std::sync::Arc;

/// Largest speed that can be commanded, either way [m/s].
pub const MAX_COMMAND: f64 = 2.0;

/// Largest yaw speed that can be commanded, either way [rad/s].
pub const MAX_TURN: f64 = 3.0;

/// Options of a locomotion task, fixed for a session unless a reset changes them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TaskOptions {
    /// Built-in robot, or for LeggedVelocity a packed one; a server does not read files that a client names.
    pub robot: RobotName,
    pub engine: EngineKind,
    pub law: Law,
    /// Time step [s]; must divide the control period. Where an engine is chosen without one, it is that engine's own.
    pub dt: f64,
    /// Largest servo torque [N·m]. Our choice 0.05: some six times the rms torque of a 2 Hz walk.
    pub torque_limit: f64,
    /// Commanded speed [m/s] is drawn from this range at every reset.
    pub command: [f64; 2],
    /// Commanded yaw speed [rad/s], likewise; tasks without a turning command go straight.
    pub turn: [f64; 2],
    /// Spread of the initial joint angles around the tripod's [rad], uniform ±.
    pub angle_noise: f64,
    /// Weights of the reward's terms.
    pub weights: Weights,
    /// Leg shape: L, revL, C, revC, flat or xi=DEGREES.
    pub leg: String,
    /// Medium's name, zeta=VALUE or mu=VALUE,rho=VALUE.
    pub medium: String,
    /// Text of a sand.toml (see [`SandDescription`]); if not empty it replaces medium and law.
    pub sand: String,
    /// Uphill along x [°].
    pub slope_deg: f64,
    /// Extra mass at the base's centre [kg].
    pub payload: f64,
    pub max_episode_steps: u32,
    /// How hips are driven; only for tasks with one joint a leg.
    pub control: Option<Control>,
    /// Rocks and steps, drawn at every reset; only for the task that has some.
    pub rocks: Option<RockOptions>,
    /// What HexapodTerrain draws for an episode; only for that task.
    pub randomize: Option<Randomize>,
    /// How much of it, 0 to 1.
    pub difficulty: Option<f64>,
    /// Carriage and constraint of LegStroke; only for that task.
    pub stroke: Option<StrokeOptions>,
    /// What a robot from a file walks on, if not empty: `rigid`, `mixed` or a medium; only for LeggedVelocity, as what follows.
    pub ground: String,
    pub commands: Option<Commands>,
    pub rewards: Option<Rewards>,
    /// None: nothing is drawn.
    pub domain_rand: Option<DomainRand>,
    /// What an action of 1 adds to a joint's default position [rad].
    pub action_scale: Option<f64>,
    /// Heights of the ground; none: it is flat, unless `ground` is `dunes`.
    pub relief: Option<ReliefOptions>,
    /// Does the robot observe heights around it?
    pub measure_heights: Option<bool>,
}

impl Default for TaskOptions {
    fn default() -> Self {
        Self {
            robot: "xplorer".into(),
            engine: EngineKind::Lanes,
            law: Law::Li2013,
            dt: Scene::DEFAULT_DT,
            torque_limit: 0.05,
            command: [0.1, 0.4],
            turn: [0.0, 0.0],
            angle_noise: 0.2,
            weights: Default::default(),
            leg: "L".into(),
            medium: "poppy-loose".into(),
            sand: String::new(),
            slope_deg: 0.0,
            payload: 0.0,
            max_episode_steps: 500,
            control: None,
            rocks: None,
            randomize: None,
            difficulty: None,
            stroke: None,
            ground: String::new(),
            commands: None,
            rewards: None,
            domain_rand: None,
            action_scale: None,
            relief: None,
            measure_heights: None,
        }
    }
}

/// Reads keywords, all of which have defaults, from a JSON object (null: none are given); errors name the keyword.
pub fn parse<T: DeserializeOwned>(keywords: Value) -> Result<T> {
    let keywords = match keywords {
        Value::Object(keywords) => keywords,
        Value::Null => Map::new(),
        _ => return Err(Error::invalid("options", "not an object of keywords")),
    };
    let read = |keywords| serde_json::from_value(Value::Object(keywords));
    read(keywords.clone()).map_err(|whole: serde_json::Error| {
        // serde does not say where a value of the wrong type stood: try the keywords one by one.
        let wrong = keywords.into_iter().find_map(|(key, value)| {
            let alone = read(Map::from_iter([(key.clone(), value)]));
            alone.err().map(|e| Error::invalid(key, e.to_string()))
        });
        wrong.unwrap_or_else(|| Error::invalid("options", whole.to_string()))
    })
}

impl TaskOptions {
    /// The defaults `self` with the keywords in `given` (a JSON object, or null for none); `check` refuses
    /// names that the task does not have.
    pub fn with(&self, given: Value, check: impl Fn(&str) -> Result<()>) -> Result<Self> {
        let mut all = serde_json::to_value(self).map_err(|e| Error::invalid("options", e.to_string()))?;
        let given = match given {
            Value::Object(given) => given,
            Value::Null => Map::new(),
            _ => return Err(Error::invalid("options", "not an object of keywords")),
        };
        let other_engine = given.contains_key("engine") && !given.contains_key("dt");
        for (name, value) in given {
            check(&name)?;
            all[name] = value;
        }
        let mut options: Self = parse(all)?;
        if other_engine {
            options.dt = options.engine.default_dt();
        }
        Ok(options)
    }

    /// Checks everything and builds the model.
    pub fn model(&self) -> Result<Model> {
        let [low, high] = self.command;
        check_range("command[0]", low, -MAX_COMMAND..=MAX_COMMAND)?;
        check_range("command[1]", high, low..=MAX_COMMAND)?;
        let [low, high] = self.turn;
        check_range("turn[0]", low, -MAX_TURN..=MAX_TURN)?;
        check_range("turn[1]", high, low..=MAX_TURN)?;
        check_range("angle_noise", self.angle_noise, 0.0..=std::f64::consts::PI)?;
        check_range("max_episode_steps", f64::from(self.max_episode_steps), 1.0..=1e6)?;
        self.weights.validate()?;
        self.rocks.as_ref().map_or(Ok(()), RockOptions::validate)?;
        check_range("difficulty", self.difficulty.unwrap_or(0.0), 0.0..=1.0)?;
        if self.engine == EngineKind::Tree {
            return self.tree_model();
        }
        if self.robot.name().ends_with(".toml") {
            return Err(Error::unknown("robot", self.robot.name(), &Robot::names()));
        }
        let robot = if self.stroke.is_some() { Robot::stroke_leg() } else { Robot::load(self.robot.name()) };
        let mut robot = robot?.with_leg_shape(&self.leg)?;
        robot.servo.torque_limit = Some(check_range("torque_limit", self.torque_limit, 1e-4..=1e3)?);
        // What a servo's lag adds up to is not observed. LegStroke's leg has no servos.
        robot.servo.anti_windup = self.stroke.is_none();
        if self.control == Some(Control::Torque) {
            (robot.servo.kp, robot.servo.kd) = (0.0, 0.0);
        }
        let mut scene = Scene::flat(Medium::named(&self.medium)?);
        (scene.law, scene.slope_deg, scene.dt, scene.payload) = (self.law, self.slope_deg, self.dt, self.payload);
        if !self.sand.is_empty() {
            scene.set_sand(&SandDescription::from_toml(&self.sand)?);
        }
        let model = Model::new(&robot, &scene)?;
        // After the model, which says what is wrong with slope and payload themselves.
        self.randomize.as_ref().map_or(Ok(()), |randomize| randomize.validate(self.slope_deg, self.payload))?;
        self.stroke.as_ref().map_or(Ok(()), |stroke| stroke.validate(&model))?;
        Ok(model)
    }

    /// The same for a robot that is a tree of bodies.
    fn tree_model(&self) -> Result<Model> {
        self.commands.unwrap_or_default().validate()?;
        self.rewards.unwrap_or_default().validate()?;
        self.domain_rand.as_ref().map_or(Ok(()), DomainRand::validate)?;
        check_range("action_scale", self.action_scale.unwrap_or(1.0), 1e-3..=3.0)?;
        let (hard, medium) = legged::ground(&self.ground)?;
        let mut scene = Scene { hard, surface: Surface::SOLID, ..Scene::flat(medium) };
        (scene.law, scene.slope_deg, scene.dt, scene.payload) = (self.law, self.slope_deg, self.dt, self.payload);
        if !self.sand.is_empty() {
            scene.set_sand(&SandDescription::from_toml(&self.sand)?);
        }
        let dunes = (self.ground == legged::DUNES).then(ReliefOptions::default);
        if let Some(relief) = self.relief.as_ref().or(dunes.as_ref()) {
            scene.relief = Some(Arc::new(relief.checked(self.slope_deg)?));
        }
        Model::of_tree(self.robot.tree()?, &scene)
    }
}
