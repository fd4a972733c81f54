//! The model of a robot's log: predicts what its sensors read while its joints move as logged.

use super::log::Run;
use super::replay::{LoggedMotion, ReplayRobot, Signals, drives};
use super::sensors::{Layout, LoggedHardware};
use super::servo::{self, RequestedTorques};
use super::windows::{BINS, Integral, Window, bins, windows};
use crate::error::{Error, Result};
use crate::experiment::Experiment;
use crate::forward::{ForwardModel, SandParameters};
use crate::hardware::{TORQUE_CONSTANT, TORQUE_LIMIT, quantities_of};
use crate::known::{Known, Recent};
use crate::observations::{Channel, Observations, Size};
use crate::progress::Latch;
use crate::sim::model::Scene;
use std::collections::HashMap;
use std::f64::consts::TAU;

/// Largest number of predictions that are kept in memory: our choice, some 10 MB in all.
const KNOWN: usize = 128;

/// The log, and all that is needed to predict it.
pub struct TrajectoryModel<'a> {
    pub(super) latch: &'a Latch<'a>,
    /// Facts about the log. If they state a torque limit, it becomes a mechanism, which limits the requested torques.
    pub(super) experiment: Experiment,
    pub(super) runs: Vec<Run>,
    /// The robot of each run.
    pub(super) bodies: Vec<ReplayRobot>,
    pub(super) windows: Vec<Window>,
    pub(super) drives: Vec<LoggedMotion>,
    /// Window of each unit.
    pub(super) window_of: Vec<usize>,
    pub(super) layout: Layout,
    pub(super) asked: Option<RequestedTorques>,
    /// The effects on a log of the hardware that the experiment file states.
    pub(super) hardware: LoggedHardware,
    /// See [`Self::moving`].
    pub(super) moving: Vec<f64>,
    pub(super) known: Known<Vec<f64>>,
    /// The predictions in sand with the stated coefficients and at most one mechanism. There are some hundred of them, and each noise
    /// that is tried asks for them again.
    pub(super) known_near_plain: Known<Vec<f64>>,
    /// Predictions for robots that differ from their description, which nuisances are asked for again and again.
    pub(super) known_differences: Known<Vec<f64>>,
    /// The robot with the last sizes of its feet.
    pub(super) feet: Recent<Vec<u64>, Result<ReplayRobot>>,
    /// The replays in the last sands, which nuisances are asked for again and again.
    pub(super) replays: Recent<SandParameters, Vec<Signals>>,
}

impl<'a> TrajectoryModel<'a> {
    /// The model, and the measured numbers that it predicts.
    pub fn new(runs: Vec<Run>, experiment: &Experiment, latch: &'a Latch<'a>) -> Result<(Self, Observations)> {
        let body = ReplayRobot::of(experiment)?;
        let bodies = runs.iter().map(|r| body.with_leg(r.leg.as_deref())).collect::<Result<Vec<_>>>()?;
        let windows = windows(&runs, experiment.file.window);
        if windows.is_empty() {
            let reason = "no run has a whole stride after its first one: log runs of at least three strides";
            return Err(Error::invalid("data", reason));
        }
        let asked = servo::asked(&runs, &bodies)?;
        let layout = Layout {
            joints: runs[0].q.len(),
            attitude: !runs[0].attitude[0].is_empty(),
            place: !runs[0].place[0].is_empty(),
            servo: asked.is_some(),
        };
        let mut experiment = experiment.clone();
        let given = &mut experiment.given;
        if given.mechanisms.motor_torque_limit == 0.0 {
            let limit = given.hardware.value(TORQUE_LIMIT).unwrap_or(0.0);
            given.mechanisms.motor_torque_limit = limit / given.hardware.value(TORQUE_CONSTANT).unwrap_or(1.0);
        }
        let model = Self { asked, ..Self::along(experiment, latch, layout, runs, bodies, windows) };
        let plain = model.plain();
        if let Some(error) = latch.error() {
            return Err(error);
        }
        if let Some(lost) = plain.iter().position(|p| !p.is_finite()) {
            let run = &model.runs[model.windows[model.window_of[lost / model.span()]].run].name;
            return Err(Error::invalid(
                "data",
                format!("the simulation of run {run} diverges: check that the log is of this robot"),
            ));
        }
        let observations = model.observations();
        Ok((model, observations))
    }

    /// A model of these windows of a log, without requested torques.
    pub(super) fn along(
        experiment: Experiment,
        latch: &'a Latch<'a>,
        layout: Layout,
        runs: Vec<Run>,
        bodies: Vec<ReplayRobot>,
        windows: Vec<Window>,
    ) -> Self {
        let of_window = |(k, w): (usize, &Window)| std::iter::repeat_n(k, w.strides.len());
        let mut model = Self {
            drives: Vec::new(),
            window_of: windows.iter().enumerate().flat_map(of_window).collect(),
            hardware: LoggedHardware::of(&experiment.given.hardware),
            asked: None,
            moving: Vec::new(),
            known: Known::up_to(KNOWN),
            known_near_plain: Known::up_to(KNOWN),
            known_differences: Known::up_to(2 * KNOWN),
            feet: Recent::up_to(8),
            replays: Recent::up_to(2),
            latch,
            experiment,
            runs,
            bodies,
            windows,
            layout,
        };
        model.drives = drives(&model.runs, &model.windows, Scene::DEFAULT_DT, model.guide().as_ref());
        model.moving = model.moving();
        model
    }

    /// Does the experiment file state the hardware that a nuisance changes?
    pub(super) fn is_given(&self, nuisance: &str, axis: Option<&str>) -> bool {
        quantities_of(nuisance, axis).iter().any(|path| self.experiment.given.hardware.value(path).is_some())
    }

    /// Prior standard deviation of a kind of nuisances.
    pub(super) fn prior(&self, kind: &str) -> f64 {
        self.experiment.nuisances.sd(kind)
    }

    pub fn plain(&self) -> Vec<f64> {
        self.predict(&self.plain_sand())
    }

    /// A sentence that says which joint each torque channel belongs to.
    pub fn torque_channels(&self, channels: &[Channel]) -> String {
        let own = channels.iter().filter(|c| c.name.starts_with("torque_")).zip(self.bodies[0].joint_names());
        own.map(|(c, joint)| format!("{} is {joint}", c.name)).collect::<Vec<_>>().join(", ")
    }

    pub(super) fn span(&self) -> usize {
        BINS * self.layout.count()
    }

    /// The measured numbers: each stride is a repetition of its run.
    fn observations(&self) -> Observations {
        let values = self.windows.iter().flat_map(|w| self.measured(w)).collect();
        let mut conditions: Vec<String> = Vec::new();
        let mut places = HashMap::new();
        let mut rows = Vec::new();
        for (u, &w) in self.window_of.iter().enumerate() {
            let run = &self.runs[self.windows[w].run];
            let condition = *places.entry(self.windows[w].run).or_insert_with(|| {
                conditions.push(if run.condition == run.name {
                    run.name.clone()
                } else {
                    format!("{}, run {}", run.condition, run.name)
                });
                conditions.len() - 1
            });
            rows.push((format!("{}:{}", run.name, u + 1), condition));
        }
        self.of_strides(rows, values, conditions)
    }

    /// Observations of strides, each with an id and a condition.
    pub(super) fn of_strides(
        &self,
        rows: Vec<(String, usize)>,
        values: Vec<f64>,
        conditions: Vec<String>,
    ) -> Observations {
        // Phase at the middle of each part of a stride [rad].
        let progress: Vec<f64> = (0..BINS).map(|b| (b as f64 + 0.5) * TAU / BINS as f64).collect();
        let (size, channels) = (Size::Channel, self.layout.channels());
        Observations::of_rows(size, channels, &progress, rows.into_iter(), values, conditions)
    }

    fn measured(&self, window: &Window) -> Vec<f64> {
        let run = &self.runs[window.run];
        let [w, x, y, z] = &run.attitude;
        let up: Vec<Vec<f64>> = match self.layout.attitude {
            // x and y of the upward direction in the IMU's frame.
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
        stack
    }
}

/// Mean horizontal speed from `a` to `b` [m/s].
fn speed(t: &[f64], place: &[Vec<f64>; 3], a: f64, b: f64) -> f64 {
    let at = |k: usize, time: f64| crate::series::interpolate(t, &place[k], time);
    (at(0, b) - at(0, a)).hypot(at(1, b) - at(1, a)) / (b - a)
}
