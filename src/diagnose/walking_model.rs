//! Predicts walking runs: engine `lanes` simulates every run in closed loop, with servo, robot and sand.

use super::experiment::Experiment;
use super::fit::slope;
use super::forward::{Feature, ForwardModel, Menu, SandParameters, Testable, stronger, testable};
use super::known::{Known, key};
use super::observations::Channel;
use super::shared::{SharedNoise, Uncertainty};
use super::walking_log::{self, WalkSetup, WalkingLog};
use crate::error::{Error, Result};
use crate::progress::{Latch, Progress};
use crate::sand::Medium;
use crate::sim::engine::EngineKind;
use crate::sim::model::Scene;
use crate::sim::walk::{WalkResult, WalkTrial};
use crate::sim::{Model, Robot};
use crate::sweep::walk_all;

/// Steps of numerical slopes change all data together by this many σ: our choice, small against noise, and far above
/// the roughness of a gait in which legs stick (reversed leg at 1 Hz: 0.3 % if the phase shifts by 0.2 rad).
const ROUGHNESS: f64 = 4.0;
/// Ratio of the default time step to the small time step with which the error of the default is computed: our choice,
/// because an eighth of some tenths of a percent is far below the scatter of walks.
const FINE: f64 = 8.0;
/// Step of the sand's strength for the direction of the shared noise: our choice, about the scatter of batches.
const STRENGTH_STEP: f64 = 0.05;

/// Initial phases [rad] that show how regular a gait is: ±0.2, as in the protocol, and half of this.
const PHASES: [f64; 4] = [-0.2, -0.1, 0.1, 0.2];

/// Predicts the mean of a run's repetitions by one run with all hips at their nominal phase on a bed of nominal
/// strength. The mean over other phases and strengths differs from this run; the difference is an error of the model
/// and a part of [`ForwardModel::uncertainty`].
pub struct WalkingModel<'a> {
    latch: &'a Latch<'a>,
    experiment: Experiment,
    setups: Vec<WalkSetup>,
    /// Robot of each setup.
    robots: Vec<Robot>,
    /// Setup of each unit.
    setup_of: Vec<usize>,
    channels: Vec<Channel>,
    missing: Vec<&'static str>,
    /// Results of earlier simulations, by the bits of mechanisms and coefficients: setup by setup.
    known: Known<Vec<WalkResult>>,
    /// Factor on each number: see [`Self::correct_step`].
    correction: Vec<f64>,
}

impl<'a> WalkingModel<'a> {
    /// Refuses a setup whose plain simulation gives non-finite numbers. `latch` may stop all simulations.
    pub fn new(log: &WalkingLog, experiment: &Experiment, latch: &'a Latch<'a>) -> Result<Self> {
        let mut model = Self::along(log, experiment, latch)?;
        let plain = model.plain_sand();
        model.trials(&plain, 0.0)?.iter().try_for_each(WalkTrial::validate)?;
        let results = model.simulate(&[plain], &[0.0]);
        if let Some(error) = latch.error() {
            return Err(error);
        }
        let mut walks = results.iter().flatten().zip(&model.setups);
        if let Some((_, s)) = walks.find(|(result, _)| !result.speed.is_finite()) {
            return Err(Error::invalid("data", format!("the simulation of {} at {} Hz diverges", s.leg, s.frequency)));
        }
        model.correct_step()?;
        Ok(model)
    }

    /// A model of the setups of a log, without a correction.
    fn along(log: &WalkingLog, experiment: &Experiment, latch: &'a Latch<'a>) -> Result<Self> {
        let robot = |setup: &WalkSetup| Robot::load(&setup.robot)?.with_leg_shape(&setup.leg);
        Ok(Self {
            latch,
            experiment: experiment.clone(),
            setups: log.settings.clone(),
            robots: log.settings.iter().map(robot).collect::<Result<_>>()?,
            setup_of: log.setting_of.clone(),
            channels: log.observations.channels.clone(),
            missing: log.missing.clone(),
            known: Known::up_to(usize::MAX),
            correction: Vec::new(),
        })
    }

    /// Corrects the error of the default time step, which is some tenths of a percent. Each channel of each setup is
    /// multiplied by a factor: the plain simulation's result with an eighth of the time step, divided by its result
    /// with the whole step. An eighth of the error remains.
    fn correct_step(&mut self) -> Result<()> {
        let plain = self.plain_sand();
        let (fine, coarse) = (self.stepped(EngineKind::Lanes, &plain, FINE)?, self.predict(&plain));
        let ratio = |(f, c): (&f64, &f64)| if (f / c).is_finite() { f / c } else { 1.0 };
        self.correction = fine.iter().zip(&coarse).map(ratio).collect();
        Ok(())
    }

    /// A note on how predictions are corrected.
    pub fn step_note(&self) -> String {
        let largest = self.correction.iter().map(|ratio| (ratio - 1.0).abs()).fold(0.0, f64::max);
        let (step, fine) = (1e3 * Scene::DEFAULT_DT, 1e3 * Scene::DEFAULT_DT / FINE);
        format!(
            "predictions are simulated with a time step of {step} ms and multiplied by the ratio of plain simulations with {fine} \
             and {step} ms, which differs from 1 by at most {} %; the report shows simulated numbers without this factor",
            super::words::digits(100.0 * largest)
        )
    }

    fn corrected(&self, mut stack: Vec<f64>) -> Vec<f64> {
        stack.iter_mut().zip(&self.correction).for_each(|(s, ratio)| *s *= ratio);
        stack
    }

    /// A trial for every setup, with all hips `phase` [rad] ahead.
    fn trials(&self, (mechanisms, coefficients): &SandParameters, phase: f64) -> Result<Vec<WalkTrial>> {
        let trial = |(setup, robot): (&WalkSetup, &Robot)| {
            let mut scene = Scene::flat(Medium { coefficients: *coefficients, ..self.medium().clone() });
            (scene.mechanisms, scene.slope_deg, scene.payload) = (*mechanisms, setup.slope_deg, setup.payload);
            let trial = WalkTrial::new(Model::new(robot, &scene)?, setup.frequency);
            Ok(WalkTrial { phase, x_bed: setup.x_bed, strides: setup.strides, ..trial })
        };
        self.setups.iter().zip(&self.robots).map(trial).collect()
    }

    /// Results of every state with all hips ahead by each of `phases` [rad]: state by state, then phase by phase, setup
    /// by setup. NaN where a simulation is refused, diverges, or is stopped.
    fn simulate(&self, states: &[SandParameters], phases: &[f64]) -> Vec<Vec<WalkResult>> {
        let cases: Vec<_> = states.iter().flat_map(|state| phases.iter().map(move |&phase| (state, phase))).collect();
        let keys = cases.iter().map(|(state, phase)| key(state, &[*phase])).collect();
        self.known.of(keys, |new| {
            let trials: Result<Vec<_>> = new.iter().map(|&k| self.trials(cases[k].0, cases[k].1)).collect();
            let trials = trials.map(|trials| trials.into_iter().flatten().collect::<Vec<_>>());
            let results = trials.and_then(|t| walk_all(EngineKind::Lanes, &t, self));
            let results = results.unwrap_or_else(|_| vec![WalkResult::lost(); self.setups.len() * new.len()]);
            results.chunks(self.setups.len().max(1)).map(<[_]>::to_vec).collect()
        })
    }

    /// Prediction by `engine` with a time step `finer` times smaller than the default one.
    fn stepped(&self, engine: EngineKind, state: &SandParameters, finer: f64) -> Result<Vec<f64>> {
        let mut trials = self.trials(state, 0.0)?;
        trials.iter_mut().for_each(|t| t.model.scene.dt /= finer);
        Ok(self.stack(&walk_all(engine, &trials, self)?))
    }

    fn stack(&self, results: &[WalkResult]) -> Vec<f64> {
        let of = |&setup: &usize| self.channels.iter().map(move |c| channel(&results[setup], &c.name));
        self.setup_of.iter().flat_map(of).collect()
    }
}

/// The simulations of walks also check `latch`, which may stop them.
impl Progress for WalkingModel<'_> {
    fn report(&self, _done: f64, _stage: &str) -> Result<()> {
        if self.latch.stopped() { self.latch.error().map_or(Ok(()), Err) } else { Ok(()) }
    }
}

fn channel(result: &WalkResult, name: &str) -> f64 {
    match name {
        "base_height" => result.base_height,
        "pitch_rms" => result.pitch_rms,
        "hip_torque_rms" => result.hip_torque_rms,
        "hip_speed_error_rms" => result.hip_speed_error_rms,
        _ => result.speed,
    }
}

impl ForwardModel for WalkingModel<'_> {
    fn stopped(&self) -> bool {
        self.latch.stopped()
    }

    fn predict_many(&self, states: &[SandParameters]) -> Vec<Vec<f64>> {
        self.simulate(states, &[0.0]).iter().map(|r| self.corrected(self.stack(r))).collect()
    }

    fn as_simulated(&self, prediction: &[f64]) -> Vec<f64> {
        let mut stack = prediction.to_vec();
        stack.iter_mut().zip(&self.correction).for_each(|(s, ratio)| *s /= ratio);
        stack
    }

    fn roughness(&self) -> Option<f64> {
        Some(ROUGHNESS)
    }

    /// **Noise.** Beds differ in strength, and the numbers of a run change with the strength according to their derivative. If a gait
    /// sticks, slips or stalls, small differences grow. So the directions of `gait_scatter` are the changes of the nominal run by
    /// other initial phases, and the curvature of the numbers as functions of the strength. For regular gaits both are negligible.
    ///
    /// **Errors of the model.** Four differences of simulations give their size: (1) the other engine's solution of the
    /// same equations; (2) the effect of the time step there beyond the correction of [`Self::correct_step`]; (3) the
    /// eighth of the step's error that the correction leaves; (4) the distance of the mean over other phases and beds from
    /// the nominal run, which is negligible for regular gaits. The error of each channel of each setup is their root sum
    /// of squares, independent of the other channels and setups, because one difference gives the size of an error and not
    /// its pattern.
    fn uncertainty(&self, sand: &SandParameters, prediction: &[f64]) -> Uncertainty {
        let beds = self.predict_many(&[STRENGTH_STEP, -STRENGTH_STEP].map(|share| stronger(sand, share)));
        let phases = self.simulate(&[*sand], &PHASES);
        let phases: Vec<_> = phases.iter().map(|results| self.corrected(self.stack(results))).collect();
        let strength = slope(&beds[0], &beds[1], 2.0 * STRENGTH_STEP);
        let middle: Vec<f64> = beds[0].iter().zip(&beds[1]).map(|(a, b)| 0.5 * (a + b)).collect();
        let mut stacks = vec![slope(&middle, prediction, 1.0)];
        stacks.extend(phases.iter().map(|other| slope(other, prediction, (PHASES.len() as f64).sqrt())));
        let shared = vec![
            SharedNoise::one("bed_strength", "1", STRENGTH_STEP, false, strength),
            SharedNoise { name: "gait_scatter", unit: "1", guess: 1.0, optional: false, stacks },
        ];
        let (other, fine) = (self.stepped(EngineKind::Rapier, sand, 1.0), self.stepped(EngineKind::Lanes, sand, FINE));
        let (Ok(other), Ok(fine)) = (other.map(|o| self.corrected(o)), fine) else {
            return Uncertainty { shared, ..Uncertainty::default() };
        };
        let mean =
            |runs: &[Vec<f64>], k: usize| runs.iter().map(|r| r[k] - prediction[k]).sum::<f64>() / runs.len() as f64;
        let size = |k: usize| {
            let average = mean(&beds, k) + mean(&phases, k);
            // The correction leaves an eighth of the step's error.
            let left = (fine[k] - prediction[k] / self.correction.get(k).copied().unwrap_or(1.0)) / FINE;
            let differences = [other[k] - prediction[k], fine[k] - prediction[k], left, average];
            // A difference from a diverged simulation contains no information, so it does not count.
            differences.into_iter().filter(|d| d.is_finite()).map(|d| d * d).sum::<f64>().sqrt()
        };
        let count = self.channels.len();
        let of = |c: usize| (0..prediction.len()).map(|k| if k % count == c { size(k) } else { 0.0 }).collect();
        Uncertainty { shared, common: (0..count).map(of).collect(), own: Vec::new() }
    }

    fn experiment(&self) -> &Experiment {
        &self.experiment
    }

    fn testable(&self) -> Testable {
        testable(|m| m.walking, &self.missing)
    }

    fn features(&self) -> Vec<Feature> {
        let per_run = |name, unit, f: &dyn Fn(&WalkSetup) -> f64| Feature {
            name,
            unit,
            values: self.setup_of.iter().map(|&s| vec![f(&self.setups[s])]).collect(),
        };
        vec![
            per_run("stride_frequency", "Hz", &|s| s.frequency),
            per_run("slope_deg", "°", &|s| s.slope_deg),
            per_run("payload", "kg", &|s| s.payload),
            per_run("place", "m", &|s| s.x_bed),
        ]
    }

    fn menu(&self) -> Option<Menu<'_>> {
        let log = walking_log::planned(walking_log::possible(&self.setups), self.channels.clone());
        let model = Self::along(&log, &self.experiment, self.latch).ok()?;
        Some(Menu { model: Box::new(model), observations: log.observations })
    }

    fn group(&self, unit: usize) -> &str {
        &self.setups[self.setup_of[unit]].leg
    }
}
