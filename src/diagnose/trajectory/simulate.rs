//! Replays with many sets of mechanisms and coefficients, and the sensors' readings of each.

use super::description::{Difference, drives_with};
use super::model::TrajectoryModel;
use super::replay::{Guide, Replay, ReplayRobot, Signals, drives, following_time, replay};
use super::sensors::{LoggedHardware, Mounting, read};
use super::windows::{BINS, bins};
use crate::error::Result;
use crate::forward::{ForwardModel, SandParameters, stronger};
use crate::known::key;
use crate::sand::mechanism::Mechanisms;
use crate::sand::{Medium, Regularization};
use crate::sim::Model;
use crate::sim::model::Scene;

/// Relative changes of the sand's strength that are too small to measure: our choice, at most a hundredth of the scatter of beds.
const NUDGES: [f64; 6] = [-3e-4, -2e-4, -1e-4, 1e-4, 2e-4, 3e-4];
/// Factor on the variance of predictions with [`NUDGES`]: our choice, so that chaotic motion adds less than a quarter
/// to χ² for each window and channel.
const SETTLED: f64 = 4.0;

/// The sand of a replay, and what differs between the robot and its description.
pub(super) type Setting = (SandParameters, Vec<Difference>);

impl TrajectoryModel<'_> {
    pub(super) fn models(&self, ((mechanisms, coefficients), differences): &Setting, dt: f64) -> Result<Vec<Model>> {
        let bodies = self.bodies_with(differences)?;
        let of = |run: usize| {
            let mut scene = Scene::flat(Medium { coefficients: *coefficients, ..self.medium().clone() });
            // The joints move as logged, so a weak motor has no effect in the replay; it has an effect on the servo's channel.
            scene.mechanisms = Mechanisms { motor_torque_limit: 0.0, ..self.with_given(mechanisms) };
            (scene.slope_deg, scene.dt) = (self.runs[run].slope_deg, dt);
            if matches!(bodies[run], ReplayRobot::Tree(..)) {
                scene.surface = Regularization::SOLID;
            }
            bodies[run].model(&scene)
        };
        (0..self.runs.len()).map(of).collect()
    }

    /// The mounting of the gyro that the base of a robot from a URDF or MJCF file follows.
    pub(super) fn guide(&self) -> Option<Guide> {
        let mounting = self.hardware.mounting;
        let turn = mounting.to_imu(self.experiment.file.imu.quat).transpose();
        matches!(self.bodies[0], ReplayRobot::Tree(..)).then_some(Guide { turn, delay: mounting.delay })
    }

    /// Time in which the base's angular velocity follows the log's [s]; None: the base is free.
    pub(super) fn follows(&self) -> Option<f64> {
        match &self.bodies[0] {
            ReplayRobot::Tree(tree, _) => Some(following_time(tree)),
            ReplayRobot::Legged(_) => None,
        }
    }

    /// Mass of the robot as described [kg].
    pub(super) fn mass(&self) -> f64 {
        let models = self.models(&(self.plain_sand(), Vec::new()), Scene::DEFAULT_DT);
        models.ok().and_then(|all| all.first().map(Model::total_mass)).unwrap_or(1.0)
    }

    /// Tracks of several settings, setting by setting and window by window. The time step is divided by `finer`.
    pub(super) fn tracks(&self, settings: &[Setting], finer: f64) -> Vec<Vec<Signals>> {
        let dt = Scene::DEFAULT_DT / finer;
        let models: Result<Vec<Vec<Model>>> = settings.iter().map(|s| self.models(s, dt)).collect();
        let lost = || vec![vec![Signals::default(); self.windows.len()]; settings.len()];
        let Ok(models) = models else { return lost() };
        let finer = (finer != 1.0).then(|| drives(&self.runs, &self.windows, dt, self.guide().as_ref()));
        let drives = finer.as_deref().unwrap_or(&self.drives);
        let turned: Vec<_> = settings.iter().map(|(_, differences)| drives_with(drives, differences)).collect();
        let task = |(s, k): (usize, usize)| Replay {
            model: &models[s][self.windows[k].run],
            drive: &turned[s].as_deref().unwrap_or(drives)[k],
            imu: self.experiment.file.imu.position,
        };
        let tasks: Vec<Replay> =
            (0..settings.len()).flat_map(|s| (0..self.windows.len()).map(move |k| (s, k))).map(task).collect();
        match replay(self.bodies[0].engine(), &tasks, self.latch) {
            Ok(tracks) => tracks.chunks(self.windows.len()).map(<[Signals]>::to_vec).collect(),
            Err(_) => lost(),
        }
    }

    /// These mechanisms, together with the mechanisms that the experiment file states.
    pub(super) fn with_given(&self, mechanisms: &Mechanisms) -> Mechanisms {
        let (own, given) = (mechanisms.values(), self.experiment.given.mechanisms.values());
        Mechanisms::from_values(std::array::from_fn(|k| if own[k] == 0.0 { given[k] } else { own[k] }))
    }

    /// Torque limit of the motors [N·m]; 0 means no limit.
    pub(super) fn limit(&self, sand: &SandParameters) -> f64 {
        self.with_given(&sand.0).motor_torque_limit
    }

    /// The predicted numbers of all windows; the servo's channel is 0.
    pub(super) fn read(&self, tracks: &[Signals], mounting: Mounting) -> Vec<f64> {
        let of = |(k, track): (usize, &Signals)| {
            let window = &self.windows[k];
            let times = &self.runs[window.run].t;
            read(&self.layout, window, times, track, mounting, self.experiment.file.imu.quat)
        };
        tracks.iter().enumerate().flat_map(of).collect()
    }

    /// Predicted numbers of one state, with another time step and hardware than in [`Self::simulate`].
    pub(super) fn replayed(&self, sand: &SandParameters, finer: f64, hardware: &LoggedHardware) -> Vec<f64> {
        let tracks = self.tracks(&[(*sand, Vec::new())], finer).swap_remove(0);
        self.logged(self.read(&tracks, hardware.mounting), self.limit(sand), hardware)
    }

    /// The predicted numbers of several settings, before errors of the logged torques.
    pub(super) fn readings(&self, settings: &[Setting]) -> Vec<Vec<f64>> {
        // Sixteen at a time, because tracks need much memory: our choice.
        let some = |part: &[Setting]| {
            let tracks = self.tracks(part, 1.0);
            crate::parallel::map(&tracks, |t| self.read(t, self.hardware.mounting))
        };
        settings.chunks(16).flat_map(some).collect()
    }

    /// Predicted numbers of several states, with the hardware that the experiment file states.
    pub(super) fn simulate(&self, states: &[SandParameters]) -> Vec<Vec<f64>> {
        // The joints move as logged, so a weak motor changes only the servo's channel.
        let strong = |(m, c): &SandParameters| (Mechanisms { motor_torque_limit: 0.0, ..*m }, *c);
        let keys = states.iter().map(|state| key(&strong(state), &[])).collect();
        let stated = self.medium().coefficients;
        let near = |(m, c): &SandParameters| *c == stated && m.values().iter().filter(|v| **v != 0.0).count() < 2;
        let known = if states.iter().all(near) { &self.known_near_plain } else { &self.known };
        let stacks = known.of(keys, |new| {
            let settings: Vec<Setting> = new.iter().map(|&k| (states[k], Vec::new())).collect();
            self.readings(&settings)
        });
        let logged = |(stack, sand): (Vec<f64>, &SandParameters)| self.logged(stack, self.limit(sand), &self.hardware);
        stacks.into_iter().zip(states).map(logged).collect()
    }

    /// Variance of each predicted number due to chaotic motion. If a gait hops or sways, a change of the sand that is too small to
    /// measure changes the robot's path, and later numbers carry little information. The variance is the scatter of replays on sands
    /// that differ by [`NUDGES`]. Within one window and channel these errors are correlated. So each number gets the sum of the
    /// variances of all numbers in its window and channel: together these numbers then count less than one.
    pub(super) fn unsettled(&self, sand: &SandParameters, prediction: &[f64]) -> Vec<f64> {
        let nudged = self.simulate(&NUDGES.map(|nudge| stronger(sand, nudge)));
        let (span, count) = (self.span(), self.layout.count());
        let mut squares = vec![0.0; self.windows.len() * count];
        let block = |k: usize| self.window_of[k / span] * count + k % span / BINS;
        for (k, here) in prediction.iter().enumerate() {
            let square = nudged.iter().map(|n| (n[k] - here).powi(2)).sum::<f64>() / NUDGES.len() as f64;
            squares[block(k)] += if square.is_finite() { square } else { 0.0 };
        }
        // The sum of squares over the block is the mean square times the count of its numbers.
        (0..prediction.len()).map(|k| SETTLED * squares[block(k)]).collect()
    }

    /// A vector in the order of the predictions, with f(run, channel, ends of the part) at each place.
    pub(super) fn stack(&self, f: impl Fn(usize, usize, [f64; 2]) -> f64) -> Vec<f64> {
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
}
