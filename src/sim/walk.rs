//! The speed protocol: measures a robot's speed at a constant stride frequency, or its motion while it stands.
//!
//! Hold for 0.3 s, ramp the hips' speed up linearly in 0.2 s, turn the hips at constant speed for two strides, then
//! measure over four strides. At frequency 0 the robot stands: settle for 1 s, then measure over 10 s.

use super::engine::{Command, Engine, EngineKind};
use super::model::GRAVITY;
use super::{Model, State};
use crate::error::{Error, Result, check_range};
use std::f64::consts::TAU;

/// One run of the protocol.
#[derive(Clone, Debug)]
pub struct WalkTrial {
    pub model: Model,
    /// Turns of the hips per second [Hz]; negative walks backward, 0 stands.
    pub frequency: f64,
    /// Added to every hip's starting angle [rad].
    pub phase: f64,
    /// Position along the bed where the run starts [m], for sand that varies along the way.
    pub x_bed: f64,
    /// Number of strides in the measurement.
    pub strides: f64,
}

/// Results over the protocol's measurement window; all NaN if the simulation diverged.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct WalkResult {
    /// Net horizontal displacement per time, negative if toward −x [m/s].
    pub speed: f64,
    /// Mean height of the base's centre above the surface [m].
    pub base_height: f64,
    /// Root mean square of the base's pitch about its mean [rad].
    pub pitch_rms: f64,
    /// Root mean square torque over all joints [N·m].
    pub hip_torque_rms: f64,
    /// Root mean square of commanded minus actual speed, over all joints [rad/s].
    pub hip_speed_error_rms: f64,
    /// ∫ Σ|τ ω| dt over weight times distance; NaN for a robot that stands.
    pub cost_of_transport: f64,
    /// Height that the base lost from the window's start to its end [m].
    pub sink: f64,
    /// Net horizontal displacement [m].
    pub drift: f64,
}

impl WalkResult {
    /// The result of a walk that could not be simulated.
    pub fn lost() -> Self {
        let nan = f64::NAN;
        Self {
            speed: nan,
            base_height: nan,
            pitch_rms: nan,
            hip_torque_rms: nan,
            hip_speed_error_rms: nan,
            cost_of_transport: nan,
            sink: nan,
            drift: nan,
        }
    }
}

/// Time for which the robot stands before it walks [s]. This and the next three constants are the protocol of the
/// reference programs with whose speeds `sandgait validate` compares.
const HOLD: f64 = 0.3;
/// Time in which the hips' speed rises [s].
const RAMP: f64 = 0.2;
/// Strides before the measurement, in which traces of the start can die out, and strides of the measurement: whole ones,
/// because speed varies within a stride.
const STRIDES_BEFORE: f64 = 2.0;
const STRIDES_MEASURED: f64 = 4.0;
/// Time for a standing robot to settle before the measurement [s]: our choice. A robot that is set down on the surface
/// comes to rest within 0.2 s, or later on soft sand.
const SETTLE: f64 = 1.0;
/// Time over which a standing robot is measured [s]: our choice, long, so that slow creep shows in `sink` and `drift`.
const STAND: f64 = 10.0;
/// Interval of commands and samples [s]: our choice, short against a stride, and not below the usual time steps.
const TICK: f64 = 1e-3;

/// The hips' command at `time` [s] after the protocol's start: angle turned so far [rad] and speed [rad/s].
pub fn hip_angle(frequency: f64, time: f64) -> [f64; 2] {
    let ramped = (time - HOLD).clamp(0.0, RAMP);
    let turning = (time - HOLD - RAMP).max(0.0);
    let speed = TAU * frequency;
    [speed * (0.5 * ramped * ramped / RAMP + turning), speed * ramped / RAMP]
}

impl WalkTrial {
    pub fn new(model: Model, frequency: f64) -> Self {
        Self { model, frequency, phase: 0.0, x_bed: 0.0, strides: STRIDES_MEASURED }
    }

    /// Start and end of the measurement [s].
    fn window(&self) -> [f64; 2] {
        if self.frequency == 0.0 {
            return [SETTLE, SETTLE + STAND];
        }
        let start = HOLD + RAMP + STRIDES_BEFORE / self.frequency.abs();
        [start, start + self.strides / self.frequency.abs()]
    }

    /// Simulated time that the trial takes [s].
    pub fn duration(&self) -> f64 {
        self.window()[1]
    }

    /// Speed of the hips [rad/s] at `time` [s].
    fn hip_speed(&self, time: f64) -> f64 {
        TAU * self.frequency * ((time - HOLD) / RAMP).clamp(0.0, 1.0)
    }

    /// Refuses runs that the protocol cannot simulate.
    pub fn validate(&self) -> Result<()> {
        // Slower than one stride in 50 s or faster than 20 Hz is far from any walk: our choice.
        check_range("frequency", self.frequency, -20.0..=20.0)?;
        if self.frequency != 0.0 && self.frequency.abs() < 0.02 {
            return Err(Error::invalid("frequency", format!("{} is neither 0 nor at least 0.02 Hz", self.frequency)));
        }
        check_range("phase", self.phase, -TAU..=TAU)?;
        // A bed of 2 km or a walk of 1000 strides has wrong units: our choice.
        check_range("x_bed", self.x_bed, -1e3..=1e3)?;
        check_range("strides", self.strides, 0.1..=1e3)?;
        if self.frequency != 0.0 && self.model.legs.iter().any(|l| l.len() != 1) {
            let reason = "the protocol turns hips at constant speed, so every leg must have one joint";
            return Err(Error::invalid("robot", reason));
        }
        Ok(())
    }

    fn start(&self) -> State {
        let angles: Vec<f64> = match self.model.legs.iter().all(|l| l.len() == 1) {
            true => self.model.tripod_angles().iter().map(|a| a + self.phase).collect(),
            false => vec![0.0; self.model.joints()],
        };
        let mut state = State::at_rest(self.model.standing_height(&angles), &angles);
        state.position[0] = self.x_bed;
        state
    }
}

/// Runs one trial.
pub fn walk(kind: EngineKind, trial: &WalkTrial) -> Result<WalkResult> {
    let results = walk_many(kind, std::slice::from_ref(trial), &|_| Ok(()))?;
    results.first().copied().ok_or_else(|| Error::invalid("trials", "none"))
}

/// Receives a walk's states while it runs.
pub struct Watch<'a> {
    /// Number of calls in a second of simulated time: at most 1000, because the protocol takes 1000 samples a second.
    pub rate: f64,
    /// Takes the time [s] and the state.
    pub see: &'a mut dyn FnMut(f64, &State),
}

/// The same as [`walk`]; also passes the states, from the first one on, to `watch`. `advanced` as in [`walk_many`].
pub fn walk_watched(
    kind: EngineKind,
    trial: &WalkTrial,
    advanced: &dyn Fn(f64) -> Result<()>,
    watch: &mut Watch,
) -> Result<WalkResult> {
    check_range("rate", watch.rate, 1.0..=1.0 / TICK)?;
    let results = run(kind, std::slice::from_ref(trial), advanced, Some(watch))?;
    results.first().copied().ok_or_else(|| Error::invalid("trials", "none"))
}

/// Simulated time [s] between two calls of `advanced`: our choice; the processor needs some milliseconds for it.
const REPORT_TIME: f64 = 1.0;

/// Runs `trials` side by side in one engine; all robots must have the same number of joints and plates. `advanced`
/// receives the additional simulated seconds; its error stops the walks and is returned.
pub fn walk_many(
    kind: EngineKind,
    trials: &[WalkTrial],
    advanced: &dyn Fn(f64) -> Result<()>,
) -> Result<Vec<WalkResult>> {
    run(kind, trials, advanced, None)
}

/// [`walk_many`]; `watch` receives the states of the first trial.
fn run(
    kind: EngineKind,
    trials: &[WalkTrial],
    advanced: &dyn Fn(f64) -> Result<()>,
    mut watch: Option<&mut Watch>,
) -> Result<Vec<WalkResult>> {
    let Some(first) = trials.first() else { return Ok(Vec::new()) };
    let mut engine = Engine::new(kind, &first.model, trials.len())?;
    for (i, trial) in trials.iter().enumerate() {
        trial.validate()?;
        if trial.model.joints() != first.model.joints() || trial.model.scene.dt != first.model.scene.dt {
            return Err(Error::invalid("trials", "robots that walk side by side need equal joints and time steps"));
        }
        engine.set_model(i, &trial.model);
        engine.set_state(i, &trial.start());
    }
    let dt = first.model.scene.dt;
    let stride = (TICK / dt).round().max(1.0) as usize;
    let tick = stride as f64 * dt;
    let end = trials.iter().map(|t| t.window()[1]).fold(0.0, f64::max);
    let mut meters: Vec<_> = trials.iter().map(Meter::new).collect();
    let mut command = Command::still(first.model.joints());
    let ticks = (end / tick).ceil() as usize;
    let between = (REPORT_TIME / tick).round().max(1.0) as usize;
    let every = watch.as_ref().map_or(1, |w| (1.0 / (w.rate * tick)).round().max(1.0) as usize);
    let mut seen = first.start();
    for k in 0..=ticks {
        let time = k as f64 * tick;
        if let Some(watch) = watch.as_mut().filter(|_| k % every == 0) {
            engine.state(0, &mut seen);
            (watch.see)(time, &seen);
        }
        for (i, meter) in meters.iter_mut().enumerate() {
            // The speed in the middle of the interval, which makes the integral of the ramp exact.
            command.rates.fill(meter.trial.hip_speed(time + 0.5 * tick));
            engine.command(i, &command);
        }
        engine.advance(stride);
        for (i, meter) in meters.iter_mut().enumerate() {
            meter.sample(&engine, i, time + tick, tick);
        }
        if (k + 1) % between == 0 {
            advanced(between as f64 * tick)?;
        }
    }
    advanced(((ticks + 1) % between) as f64 * tick)?;
    Ok(meters.into_iter().map(Meter::result).collect())
}

/// Gathers one trial's measurements.
struct Meter<'a> {
    trial: &'a WalkTrial,
    now: State,
    /// Position and work at the window's start and end.
    ends: [Option<([f64; 3], f64)>; 2],
    samples: f64,
    height: f64,
    pitch: f64,
    pitch_squared: f64,
    torque_squared: f64,
    error_squared: f64,
}

impl<'a> Meter<'a> {
    fn new(trial: &'a WalkTrial) -> Self {
        Self {
            trial,
            now: trial.start(),
            ends: [None; 2],
            samples: 0.0,
            height: 0.0,
            pitch: 0.0,
            pitch_squared: 0.0,
            torque_squared: 0.0,
            error_squared: 0.0,
        }
    }

    /// Takes the state of robot `index` at `time`, one `tick` [s] after the last.
    fn sample(&mut self, engine: &Engine, index: usize, time: f64, tick: f64) {
        let window = self.trial.window();
        // Reads the state from one sample before the window on, because the window's start lies between two samples.
        if time + tick < window[0] || self.ends[1].is_some() {
            return;
        }
        let before = self.now.work;
        engine.state(index, &mut self.now);
        if time < window[0] {
            return;
        }
        let now = &self.now;
        for (end, at) in self.ends.iter_mut().zip(window) {
            if end.is_none() && time >= at {
                // The ends of the window lie between samples, so the state there is extrapolated back with the present
                // velocity.
                let back = time - at;
                let place = [0, 1, 2].map(|i| now.position[i] - back * now.velocity[i]);
                *end = Some((place, now.work - (now.work - before) * back / tick));
            }
        }
        let joints = now.rates.len() as f64;
        let target = self.trial.hip_speed(time - 0.5 * tick);
        self.samples += 1.0;
        self.height += now.position[2];
        let pitch = now.rotation()[2][0].clamp(-1.0, 1.0).asin();
        self.pitch += pitch;
        self.pitch_squared += pitch * pitch;
        self.torque_squared += now.torques.iter().map(|t| t * t).sum::<f64>() / joints;
        self.error_squared += now.rates.iter().map(|r| (target - r).powi(2)).sum::<f64>() / joints;
    }

    fn result(self) -> WalkResult {
        let nan = ([f64::NAN; 3], f64::NAN);
        let sound = self.now.is_sound();
        let [(from, work_from), (to, work_to)] = self.ends.map(|e| e.filter(|_| sound).unwrap_or(nan));
        let [start, end] = self.trial.window();
        let drift = (to[0] - from[0]).hypot(to[1] - from[1]);
        let mean = |sum: f64| if sound { sum / self.samples } else { f64::NAN };
        WalkResult {
            speed: drift.copysign(to[0] - from[0]) / (end - start),
            base_height: mean(self.height),
            pitch_rms: (mean(self.pitch_squared) - mean(self.pitch).powi(2)).max(0.0).sqrt(),
            hip_torque_rms: mean(self.torque_squared).sqrt(),
            hip_speed_error_rms: mean(self.error_squared).sqrt(),
            cost_of_transport: match self.trial.frequency {
                0.0 => f64::NAN,
                _ => (work_to - work_from) / (self.trial.model.total_mass() * GRAVITY * drift),
            },
            sink: from[2] - to[2],
            drift,
        }
    }
}
