//! Walks that could be logged next: the diagnosis proposes the one that best distinguishes the causes, such as "walk at 3 Hz up 5°".

use super::log::Run;
use super::model::TrajectoryModel;
use super::replay::{ReplayRobot, Signals};
use super::servo::RequestedTorques;
use super::windows::{Window, windows};
use crate::forward::{ForwardModel, Menu};
use crate::series::ends;
use crate::sim::model::Scene;
use crate::sim::walk::hip_angle;
use std::collections::BTreeSet;
use std::f64::consts::TAU;

/// Stride frequencies [Hz] and slopes [°] that may be proposed: our choices, round numbers in the range of hexapods on sand.
const FREQUENCIES: [f64; 5] = [1.0, 2.0, 3.0, 4.0, 5.0];
const SLOPES_DEG: [f64; 4] = [0.0, 5.0, 10.0, -5.0];
/// Proposed frequencies are outside of the log's range by at most this factor: our choice; the motors can probably reach them.
const BEYOND: f64 = 1.5;
/// Turns of the hips in a planned walk: a lead-in of 0.75, two strides, of which the second is compared, and a margin.
const TURNS: f64 = 2.9;
/// Duration of the protocol's hold and ramp [s].
const START: f64 = 0.5;
/// Rate of a planned walk's samples [Hz]: our choice, as in the logs of the study.
const RATE: f64 = 200.0;

impl TrajectoryModel<'_> {
    /// Walks at constant stride frequency. None if the joints swing and do not make full turns, because their motion is then not
    /// known in advance.
    pub(super) fn planned(&self) -> Option<Menu<'_>> {
        let (runs, bodies, descriptions) = self.walks()?;
        let mut all = windows(&runs, self.experiment.file.window);
        if all.len() != runs.len() {
            return None;
        }
        all.iter_mut().for_each(|w| w.strides = w.strides.split_off(w.strides.len() - 1));
        let mut model = TrajectoryModel::along(self.experiment.clone(), self.latch, self.layout, runs, bodies, all);
        if self.layout.servo {
            model.asked = Some(model.needed()?);
        }
        let rows = descriptions.iter().cloned().zip(0..).collect();
        let values = vec![0.0; model.span() * descriptions.len()];
        let observations = model.of_strides(rows, values, descriptions);
        Some(Menu { model: Box::new(model), observations })
    }

    /// The walks, their robots, and their descriptions.
    fn walks(&self) -> Option<(Vec<Run>, Vec<ReplayRobot>, Vec<String>)> {
        let known: Option<Vec<f64>> = self.runs.iter().map(|r| r.frequency).collect();
        let known = known.filter(|k| k.iter().all(|f| f.abs() > 0.02))?;
        let turns = |run: &Run| run.q.iter().all(|q| (q[q.len() - 1] - q[0]).abs() > TAU);
        if matches!(self.bodies[0], ReplayRobot::Tree(..)) || !self.runs.iter().all(turns) {
            return None;
        }
        let [low, high] = ends(known.iter().map(|f| f.abs()));
        let offered = FREQUENCIES.iter().filter(|f| (low / BEYOND..=high * BEYOND).contains(*f));
        let mut legs: BTreeSet<Option<String>> = self.runs.iter().map(|r| r.leg.clone()).collect();
        if legs.iter().all(Option::is_some) {
            legs.extend(["L", "revL"].map(|leg| Some(leg.to_string())));
        }
        let (mut runs, mut bodies, mut descriptions) = (Vec::new(), Vec::new(), Vec::new());
        for frequency in offered {
            for slope_deg in SLOPES_DEG {
                // Walks of the log, within a tenth of the frequency and 2° of the slope (our choices), are not proposed.
                let made = |leg: &Option<String>| {
                    let frequencies = self.runs.iter().zip(&known);
                    let mut own =
                        frequencies.filter(|(run, _)| run.leg == *leg && (run.slope_deg - slope_deg).abs() <= 2.0);
                    own.any(|(_, f)| (f.abs() - frequency).abs() <= 0.1 * frequency)
                };
                for leg in legs.iter().filter(|leg| !made(leg)) {
                    bodies.push(self.bodies[0].with_leg(leg.as_deref()).ok()?);
                    descriptions.push(words(*frequency, slope_deg, leg.as_deref()));
                    runs.push(walk(&self.runs[0], frequency.copysign(known[0]), slope_deg, leg.clone()));
                }
            }
        }
        (!runs.is_empty()).then_some((runs, bodies, descriptions))
    }

    /// The torques that the joints' motion needs on plain sand. The servos would request these torques from the motors.
    fn needed(&self) -> Option<RequestedTorques> {
        let tracks = self.tracks(&[(self.plain_sand(), Vec::new())], 1.0).swap_remove(0);
        let of = |window: &Window, track: &Signals| -> Option<Vec<Vec<f64>>> {
            let run = &self.runs[window.run];
            let tick = |t: f64| (((t - window.from) / Scene::DEFAULT_DT).round() as usize).max(1) - 1;
            let joint = |j: usize| -> Option<Vec<f64>> {
                let own = track.signals.get(j).filter(|s| !s.is_empty())?;
                Some(run.t.iter().map(|t| own[tick(*t).min(own.len() - 1)]).collect())
            };
            (0..self.layout.joints).map(joint).collect()
        };
        let torques: Option<Vec<_>> = self.windows.iter().zip(&tracks).map(|(w, t)| of(w, t)).collect();
        Some(RequestedTorques::exactly(&self.runs, torques?))
    }
}

/// A walk whose joints start at the angles of `first` and then turn by the protocol.
fn walk(first: &Run, frequency: f64, slope_deg: f64, leg: Option<String>) -> Run {
    let length = START + TURNS / frequency.abs();
    let t: Vec<f64> = (0..=(length * RATE).ceil() as usize).map(|i| i as f64 / RATE).collect();
    let turned: Vec<f64> = t.iter().map(|t| hip_angle(frequency, *t)[0]).collect();
    Run {
        name: "planned".into(),
        condition: "planned".into(),
        leg,
        slope_deg,
        frequency: Some(frequency),
        q: first.q.iter().map(|q| turned.iter().map(|turn| q[0] + turn).collect()).collect(),
        tau: vec![vec![0.0; t.len()]; first.q.len()],
        t,
        ..Run::default()
    }
}

fn words(frequency: f64, slope_deg: f64, leg: Option<&str>) -> String {
    let slope = match slope_deg {
        s if s > 0.0 => format!("up {s}°"),
        s if s < 0.0 => format!("down {}°", -s),
        _ => "on level sand".to_string(),
    };
    let leg = leg.map(|leg| format!(", leg {leg}")).unwrap_or_default();
    format!("walk at {frequency} Hz {slope}{leg}")
}
