//! Predicts a robot's log by replaying its joints.

use super::keys::Keys;
use super::log::Log;
use super::replay::{Body, Drive, Task, Track, replay};
use super::sensors::{Layout, Mounting, read};
use super::servo::{self, Asked};
use super::windows::{BINS, Integral, Window, bins, windows};
use crate::error::{Error, Result};
use crate::experiment::Experiment;
use crate::fit::slope;
use crate::forward::{Feature, ForwardModel, Menu};
use crate::nuisance::{Nuisance, Priors};
use crate::observations::{Channel, Observations, Size, Unit};
use crate::progress::Latch;
use crate::sand::mechanism::{CATALOG, Mechanisms};
use crate::sand::{Coefficients, Medium, Surface};
use crate::shared::Shared;
use crate::sim::Model;
use crate::sim::model::Scene;
use std::collections::HashMap;
use std::f64::consts::TAU;
use std::sync::{Mutex, PoisonError};

/// A slope of the simulation is trusted once its step moves the data by this many σ altogether: our choice, as for walks.
const ROUGHNESS: f64 = 4.0;
/// Step of the sand's strength that makes the direction of the beds' scatter: our choice, about that scatter.
const STRENGTH_STEP: f64 = 0.05;
/// Step of the robot's mass, relative: our choice.
const MASS_STEP: f64 = 0.05;
/// Speed of a joint about which friction turns its sign [rad/s]: our choice, below that of any stride.
const FRICTION_SPEED: f64 = 0.5;
/// Step of the IMU's turn [rad] and delay [s]: our choices.
const TURN_STEP: f64 = 1e-3;
const DELAY_STEP: f64 = 1e-3;
/// Predictions that are kept: our choice, some 10 MB.
const KNOWN: usize = 128;

type State = (Mechanisms, Coefficients);

/// See the module.
pub struct TrajectoryModel<'a> {
    latch: &'a Latch<'a>,
    medium: Medium,
    keys: Keys,
    priors: Priors,
    log: Log,
    /// Of each run.
    bodies: Vec<Body>,
    windows: Vec<Window>,
    drives: Vec<Drive>,
    /// Window of each unit.
    window_of: Vec<usize>,
    layout: Layout,
    asked: Option<Asked>,
    known: Mutex<HashMap<Vec<u64>, Vec<f64>>>,
}

impl<'a> TrajectoryModel<'a> {
    /// The model and what it predicts.
    pub fn new(log: Log, experiment: &Experiment, latch: &'a Latch<'a>) -> Result<(Self, Observations)> {
        let keys = experiment.trajectory.clone();
        let robot = experiment.robot.as_deref().unwrap_or("xplorer");
        let body = Body::load(robot, keys.touches.as_deref())?;
        let bodies = log.runs.iter().map(|r| body.with_leg(r.leg.as_deref())).collect::<Result<Vec<_>>>()?;
        let windows = windows(&log.runs, keys.window);
        if windows.is_empty() {
            let reason = "no run has a whole stride after its first: runs of at least three strides are needed";
            return Err(Error::invalid("data", reason));
        }
        let drives = windows.iter().map(|w| Drive::new(&log.runs[w.run], w, Scene::DEFAULT_DT)).collect();
        let asked = servo::asked(&log, &bodies)?;
        let there = |name: &str| !log.missing.contains(&name);
        let layout = Layout {
            joints: log.runs[0].q.len(),
            attitude: there("quat_w … quat_z"),
            place: there("x, y, z"),
            servo: asked.is_some(),
        };
        let of_window = |(k, w): (usize, &Window)| std::iter::repeat_n(k, w.strides.len());
        let window_of = windows.iter().enumerate().flat_map(of_window).collect();
        let model = Self {
            latch,
            medium: experiment.medium.clone(),
            keys,
            priors: experiment.nuisances.clone(),
            log,
            bodies,
            windows,
            drives,
            window_of,
            layout,
            asked,
            known: Mutex::default(),
        };
        let plain = model.predict(&Mechanisms::default(), &model.medium.coefficients);
        if let Some(error) = latch.error() {
            return Err(error);
        }
        if plain.iter().any(|p| !p.is_finite()) {
            let span = BINS * model.layout.count();
            let place = plain.iter().position(|p| !p.is_finite()).unwrap_or(0) / span;
            let run = &model.log.runs[model.windows[model.window_of[place]].run].name;
            return Err(Error::invalid(
                "data",
                format!("the simulation of run {run} diverges: do robot and log belong together?"),
            ));
        }
        let observations = model.observations();
        Ok((model, observations))
    }

    pub fn log(&self) -> &Log {
        &self.log
    }

    pub fn windows(&self) -> &[Window] {
        &self.windows
    }

    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// What the plain model predicts.
    pub fn plain(&self) -> Vec<f64> {
        self.predict(&Mechanisms::default(), &self.medium.coefficients)
    }

    pub fn joint_names(&self) -> Vec<String> {
        self.bodies[0].joint_names()
    }

    /// Is it known what the hips were told?
    pub fn knows_commands(&self) -> bool {
        self.asked.is_some()
    }

    fn span(&self) -> usize {
        BINS * self.layout.count()
    }

    /// The log as it is compared: strides are the repetitions of their run.
    fn observations(&self) -> Observations {
        let values = self.windows.iter().flat_map(|w| self.measured(w)).collect();
        let mut conditions: Vec<String> = Vec::new();
        let mut places = HashMap::new();
        let progress: Vec<f64> = (0..BINS).map(|b| (b as f64 + 0.5) * TAU / BINS as f64).collect();
        let mut units = Vec::new();
        for (u, &w) in self.window_of.iter().enumerate() {
            let run = &self.log.runs[self.windows[w].run];
            let condition = *places.entry(self.windows[w].run).or_insert_with(|| {
                conditions.push(if run.condition == run.name {
                    run.name.clone()
                } else {
                    format!("{}, run {}", run.condition, run.name)
                });
                conditions.len() - 1
            });
            units.push(Unit {
                id: format!("{}:{}", run.name, u + 1),
                condition,
                start: u * self.span(),
                samples: BINS,
                progress: progress.clone(),
            });
        }
        Observations { size: Size::Channel, values, channels: self.layout.channels(), units, conditions }
    }

    /// What the log reads in one window.
    fn measured(&self, window: &Window) -> Vec<f64> {
        let run = &self.log.runs[window.run];
        let Layout { joints, .. } = self.layout;
        let [w, x, y, z] = &run.attitude;
        let up: Vec<Vec<f64>> = match self.layout.attitude {
            // The direction up, in the frame that the quaternion turns into the level one.
            true => vec![
                (0..run.t.len()).map(|i| 2.0 * (x[i] * z[i] - w[i] * y[i])).collect(),
                (0..run.t.len()).map(|i| 2.0 * (y[i] * z[i] + w[i] * x[i])).collect(),
            ],
            false => Vec::new(),
        };
        let signals: Vec<&Vec<f64>> = run.tau.iter().chain(&run.gyro).chain(&run.acc).chain(&up).collect();
        let integrals: Vec<Integral> = signals.iter().map(|s| Integral::new(&run.t, s)).collect();
        let servo = self.asked.as_ref().map(|_| servo::logged(run, window));
        let mut stack = Vec::with_capacity(window.strides.len() * self.span());
        for (s, stride) in window.strides.iter().enumerate() {
            for integral in &integrals {
                stack.extend(bins(*stride).map(|[a, b]| integral.mean(a, b)));
            }
            if self.layout.place {
                stack.extend(bins(*stride).map(|[a, b]| speed(&run.t, &run.place, a, b)));
            }
            if let Some(servo) = &servo {
                stack.extend(&servo[s * BINS..(s + 1) * BINS]);
            }
        }
        debug_assert!(signals.len() >= joints);
        stack
    }

    fn models(&self, (mechanisms, coefficients): &State, payload: f64, dt: f64) -> Result<Vec<Model>> {
        let of = |run: usize| {
            let mut scene = Scene::flat(Medium { coefficients: *coefficients, ..self.medium.clone() });
            // How the joints moved is known: a weak motor shows in what the servos asked for.
            scene.mechanisms = Mechanisms { motor_torque_limit: 0.0, ..*mechanisms };
            (scene.slope_deg, scene.dt) = (self.log.runs[run].slope_deg, dt);
            if matches!(self.bodies[run], Body::Tree(_)) {
                scene.surface = Surface::SOLID;
            }
            let model = self.bodies[run].model(&scene)?;
            match payload > 0.0 {
                true => {
                    scene.payload = payload * model.total_mass();
                    self.bodies[run].model(&scene)
                }
                false => Ok(model),
            }
        };
        (0..self.log.runs.len()).map(of).collect()
    }

    /// Tracks of several states, state by state and window by window, with `payload` as a share of the robot's mass.
    fn tracks(&self, states: &[State], payload: f64, finer: f64) -> Vec<Vec<Track>> {
        let dt = Scene::DEFAULT_DT / finer;
        let models: Result<Vec<Vec<Model>>> = states.iter().map(|s| self.models(s, payload, dt)).collect();
        let lost = || vec![vec![Track::default(); self.windows.len()]; states.len()];
        let Ok(models) = models else { return lost() };
        let task = |(state, k): (usize, usize)| Task {
            model: &models[state][self.windows[k].run],
            drive: &self.drives[k],
            imu: self.keys.imu_position,
        };
        let tasks: Vec<Task> =
            (0..states.len()).flat_map(|s| (0..self.windows.len()).map(move |k| (s, k))).map(task).collect();
        match replay(self.bodies[0].engine(), &tasks, self.latch) {
            Ok(tracks) => tracks.chunks(self.windows.len()).map(<[Track]>::to_vec).collect(),
            Err(_) => lost(),
        }
    }

    /// Numbers of all windows, the servo's channel at 0.
    fn read(&self, tracks: &[Track], mounting: Mounting) -> Vec<f64> {
        let of = |(k, track): (usize, &Track)| {
            read(&self.layout, &self.windows[k], track, self.drives[k].tick, mounting, self.keys.imu_quat)
        };
        tracks.iter().enumerate().flat_map(of).collect()
    }

    /// Puts in what the motors give.
    fn with_servo(&self, mut stack: Vec<f64>, limit: f64) -> Vec<f64> {
        let (Some(asked), Some(channel)) = (&self.asked, self.layout.servo_channel()) else { return stack };
        let mut unit = 0;
        for window in &self.windows {
            let given = asked.given(&self.log.runs[window.run], window, limit);
            for own in given.chunks(BINS) {
                let from = unit * self.span() + channel * BINS;
                stack[from..from + BINS].copy_from_slice(own);
                unit += 1;
            }
        }
        stack
    }

    /// Replays of several states, as read by an IMU that is mounted as the experiment says.
    fn simulate(&self, states: &[State]) -> Vec<Vec<f64>> {
        let keys: Vec<Vec<u64>> = states.iter().map(key).collect();
        let known = || self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let (mut new, mut found): (Vec<usize>, HashMap<&[u64], Vec<f64>>) = (Vec::new(), HashMap::new());
        {
            let known = known();
            for (k, key) in keys.iter().enumerate() {
                match known.get(key) {
                    Some(stack) => drop(found.insert(key, stack.clone())),
                    None if !keys[..k].contains(key) => new.push(k),
                    None => {}
                }
            }
        }
        // A few at a time: tracks are long.
        for part in new.chunks(16) {
            let states: Vec<State> = part.iter().map(|&k| states[k]).collect();
            let tracks = self.tracks(&states, 0.0, 1.0);
            let stacks = crate::parallel::map(&tracks, |t| self.read(t, Mounting::default()));
            part.iter().zip(stacks).for_each(|(&k, stack)| drop(found.insert(&keys[k], stack)));
        }
        let mut known = known();
        for &k in &new {
            if known.len() >= KNOWN {
                known.clear();
            }
            known.insert(keys[k].clone(), found[keys[k].as_slice()].clone());
        }
        keys.iter()
            .zip(states)
            .map(|(k, s)| self.with_servo(found[k.as_slice()].clone(), s.0.motor_torque_limit))
            .collect()
    }

    /// A stack of f(unit's run, channel, bin's ends).
    fn stack(&self, f: impl Fn(usize, usize, [f64; 2]) -> f64) -> Vec<f64> {
        let mut stack = Vec::with_capacity(self.window_of.len() * self.span());
        for window in &self.windows {
            for stride in &window.strides {
                for channel in 0..self.layout.count() {
                    stack.extend(bins(*stride).map(|bin| f(window.run, channel, bin)));
                }
            }
        }
        stack
    }

    /// Root mean square of all torques of a prediction [N·m].
    fn torque_rms(&self, prediction: &[f64]) -> f64 {
        let own = prediction.chunks(self.span()).flat_map(|unit| &unit[..self.layout.joints * BINS]);
        let (square, count) = own.fold((0.0, 0.0), |(s, n), v| (s + v * v, n + 1.0));
        (square / f64::max(count, 1.0)).sqrt().max(1e-9)
    }

    fn is_torque(&self, channel: usize) -> bool {
        channel < self.layout.joints || Some(channel) == self.layout.servo_channel()
    }

    fn friction(&self, rms: f64) -> Nuisance {
        let joints = self.layout.joints;
        let signs: Vec<Vec<Vec<f64>>> = self.log.runs.iter().map(signs).collect();
        let of: Vec<Vec<Integral>> = (self.log.runs.iter().zip(&signs))
            .map(|(run, signs)| signs.iter().map(|s| Integral::new(&run.t, s)).collect())
            .collect();
        let column =
            self.stack(|run, channel, [a, b]| if channel < joints { of[run][channel].mean(a, b) } else { 0.0 });
        Nuisance::linear("friction".into(), "N·m", self.priors.sd("friction") * rms, column)
    }

    /// How the IMU is mounted and how late it is: a turn is no straight line, nor is a delay.
    fn mounting(&self, tracks: &[Track], values: &[(String, f64)]) -> Vec<Nuisance> {
        const NAMES: [&str; 4] = ["imu_rotation_x", "imu_rotation_y", "imu_rotation_z", "imu_delay"];
        let value = |id: &str| values.iter().find(|v| v.0 == id).map_or(0.0, |v| v.1);
        let at = NAMES.map(value);
        // A log cannot be early, and beyond what is simulated nothing is known.
        let mounted =
            |v: [f64; 4]| Mounting { turn: [v[0], v[1], v[2]], delay: v[3].clamp(-0.01, super::replay::BEYOND) };
        let here = self.read(tracks, mounted(at));
        let mut bend = slope(&here, &self.read(tracks, Mounting::default()), 1.0);
        let mut all = Vec::new();
        for (k, name) in NAMES.into_iter().enumerate() {
            let (step, unit, prior) =
                if k < 3 { (TURN_STEP, "rad", "imu_rotation") } else { (DELAY_STEP, "s", "imu_delay") };
            let mut moved = at;
            moved[k] += step;
            let rate = slope(&self.read(tracks, mounted(moved)), &here, step);
            bend.iter_mut().zip(&rate).for_each(|(b, r)| *b -= at[k] * r);
            all.push(Nuisance::linear(name.into(), unit, self.priors.sd(prior), rate));
        }
        let first = all.remove(0).bent(bend);
        all.insert(0, first);
        all
    }
}

/// Mean horizontal speed from `a` to `b` [m/s].
fn speed(t: &[f64], place: &[Vec<f64>; 3], a: f64, b: f64) -> f64 {
    let at = |k: usize, time: f64| crate::observations::interpolate(t, &place[k], time);
    (at(0, b) - at(0, a)).hypot(at(1, b) - at(1, a)) / (b - a)
}

/// Directions in which each joint moves, −1…1.
fn signs(run: &super::log::Run) -> Vec<Vec<f64>> {
    let of = |q: &Vec<f64>| {
        let rate = |i: usize| {
            let (a, b) = (i.saturating_sub(2), (i + 2).min(q.len() - 1));
            (q[b] - q[a]) / (run.t[b] - run.t[a])
        };
        (0..q.len()).map(|i| (rate(i) / FRICTION_SPEED).tanh()).collect()
    };
    run.q.iter().map(of).collect()
}

fn key((mechanisms, coefficients): &State) -> Vec<u64> {
    let felt = Mechanisms { motor_torque_limit: 0.0, ..*mechanisms };
    felt.values().into_iter().chain(coefficients.to_array()).map(f64::to_bits).collect()
}

impl ForwardModel for TrajectoryModel<'_> {
    fn stopped(&self) -> bool {
        self.latch.stopped()
    }

    fn predict(&self, mechanisms: &Mechanisms, coefficients: &Coefficients) -> Vec<f64> {
        self.simulate(&[(*mechanisms, *coefficients)]).swap_remove(0)
    }

    fn predict_many(&self, states: &[State]) -> Vec<Vec<f64>> {
        self.simulate(states)
    }

    fn roughness(&self) -> Option<f64> {
        Some(ROUGHNESS)
    }

    fn coefficient_step(&self) -> f64 {
        1.0
    }

    /// Strides of one run have nothing in common that the repetitions could tell: see [`Self::model_error`].
    fn shared(&self, _: &Mechanisms, _: &Coefficients, _prediction: &[f64]) -> Vec<Shared> {
        Vec::new()
    }

    /// What all strides of a run have in common: the strength of its bed and the zeros of its sensors.
    fn model_error(&self, mechanisms: &Mechanisms, coefficients: &Coefficients, prediction: &[f64]) -> Vec<Vec<f64>> {
        let sd = |kind: &str| self.priors.sd(kind);
        let strength = Mechanisms { scale: (1.0 + mechanisms.scale) * (1.0 + STRENGTH_STEP) - 1.0, ..*mechanisms };
        let stronger = self.predict(&strength, coefficients);
        let mut all = vec![slope(&stronger, prediction, STRENGTH_STEP / sd("bed_strength").max(1e-9))];
        let torque = sd("torque_offset") * self.torque_rms(prediction);
        let joints = self.layout.joints;
        for channel in 0..self.layout.count() {
            let size = match channel {
                c if c < joints => torque,
                c if c < joints + 3 => sd("gyro_bias"),
                c if c < joints + 6 => sd("acc_bias"),
                c if Some(c) == self.layout.servo_channel() => torque / (joints as f64).sqrt(),
                _ => continue,
            };
            all.push(self.stack(|_, c, _| if c == channel { size } else { 0.0 }));
        }
        let fine = self.tracks(&[(*mechanisms, *coefficients)], 0.0, 4.0).swap_remove(0);
        let fine = self.with_servo(self.read(&fine, Mounting::default()), mechanisms.motor_torque_limit);
        all.push(slope(&fine, prediction, 1.0));
        all
    }

    /// A share of the root mean square that each channel swings by in a stride.
    fn own_error(&self, prediction: &[f64]) -> Vec<f64> {
        let share = self.priors.sd("model_error");
        let swing = |block: &[f64]| {
            let mean = block.iter().sum::<f64>() / block.len() as f64;
            (block.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / block.len() as f64).sqrt()
        };
        prediction.chunks(BINS).flat_map(|block| std::iter::repeat_n(share * swing(block), block.len())).collect()
    }

    fn nuisances(&self, m: &Mechanisms, c: &Coefficients, values: &[(String, f64)]) -> Vec<Nuisance> {
        let here = self.predict(m, c);
        let tracks = self.tracks(&[(*m, *c)], 0.0, 1.0).swap_remove(0);
        let mut all = self.mounting(&tracks, values);
        let torque = self.stack(|_, channel, _| if self.is_torque(channel) { 1.0 } else { 0.0 });
        let gain = here.iter().zip(&torque).map(|(v, t)| v * t).collect();
        all.push(Nuisance::linear("torque_constant".into(), "1", self.priors.sd("torque_constant"), gain));
        all.push(self.friction(self.torque_rms(&here)));
        let heavier = self.tracks(&[(*m, *c)], MASS_STEP, 1.0).swap_remove(0);
        let heavier = self.with_servo(self.read(&heavier, Mounting::default()), m.motor_torque_limit);
        let by_mass = slope(&heavier, &here, MASS_STEP);
        all.push(Nuisance::linear("mass".into(), "1", self.priors.sd("mass"), by_mass));
        all.retain(|n| n.sd > 0.0);
        all
    }

    fn medium(&self) -> &Medium {
        &self.medium
    }

    fn testable(&self) -> Vec<(usize, Option<String>)> {
        let why = |m: &crate::sand::mechanism::Mechanism| match m.id {
            "packing_grad" => Some("the log does not say where in the bed each run began".to_string()),
            "motor_torque_limit" if self.asked.is_none() => Some(
                "the log does not say what the hips were told (stride_frequency), or the robot has no servo".into(),
            ),
            _ => None,
        };
        CATALOG.iter().enumerate().filter(|(_, m)| m.walking).map(|(index, m)| (index, why(m))).collect()
    }

    fn features(&self) -> Vec<Feature> {
        let per_bin = |name, unit, f: &dyn Fn(usize, usize) -> f64| Feature {
            name,
            unit,
            values: (self.window_of.iter()).map(|&w| (0..BINS).map(|b| f(self.windows[w].run, b)).collect()).collect(),
        };
        let frequency =
            |w: &Window| w.strides.len() as f64 / (w.strides.last().map_or(1.0, |s| s[1]) - w.strides[0][0]);
        let own: HashMap<usize, f64> = self.windows.iter().map(|w| (w.run, frequency(w))).collect();
        vec![
            per_bin("stride_frequency", "Hz", &|run, _| own.get(&run).copied().unwrap_or(0.0)),
            per_bin("phase", "rad", &|_, bin| (bin as f64 + 0.5) * TAU / BINS as f64),
            per_bin("slope_deg", "°", &|run, _| self.log.runs[run].slope_deg),
        ]
    }

    fn menu(&self) -> Option<Menu<'_>> {
        None
    }

    fn group(&self, unit: usize) -> &str {
        self.log.runs[self.windows[self.window_of[unit]].run].leg.as_deref().unwrap_or("robot")
    }
}

/// The channels of a log, for what names them.
pub fn channel_names(channels: &[Channel], joints: &[String]) -> String {
    let own = channels.iter().filter(|c| c.name.starts_with("torque_")).zip(joints);
    own.map(|(c, joint)| format!("{} is {joint}", c.name)).collect::<Vec<_>>().join(", ")
}
