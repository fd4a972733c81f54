//! How well a policy of LeggedVelocity follows commanded velocities: a line for each of nine commands.
//!
//! Episodes have nominal masses, motors and sand, and no pushes; the command stays the same. `docs/evaluate.md` defines
//! every figure.

use super::FIRST_SEED;
use super::gait::{Gait, PolicySource};
use crate::env::legged::{ANY, DomainRand, LeggedVelocity, SAND, Units};
use crate::env::registry::Blueprint;
use crate::env::{Shard, Spec, Task};
use crate::error::{Error, Result, check_range};
use crate::parallel;
use crate::progress::Progress;
use serde::Serialize;
use serde_json::{Map, Value, json};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Commands forward, to the left and of the yaw rate, as shares of the training's ranges (see [`trained`]). In each
/// command one or more components are not 0, at about half or nearly all of their ranges: our choice.
const SHARES: [[f64; 3]; 9] = [
    [0.5, 0.0, 0.0],
    [0.9, 0.0, 0.0],
    [-0.5, 0.0, 0.0],
    [0.0, 0.4, 0.0],
    [0.0, -0.4, 0.0],
    [0.0, 0.0, 0.8],
    [0.0, 0.0, -0.8],
    [0.6, 0.0, 0.6],
    [0.6, 0.3, 0.0],
];
const NAMES: [&str; 3] = ["lin_vel_x", "lin_vel_y", "ang_vel_yaw"];
/// Info columns with the velocity and with the command, in the order of [`NAMES`].
const VELOCITY: [&str; 3] = ["speed", "lin_vel_y", "ang_vel_yaw"];
const COMMAND: [&str; 3] = ["command_lin_vel_x", "command_lin_vel_y", "command_ang_vel_yaw"];

/// Number of robots for each command, duration of an episode, and the time at its start that is not counted [s]: our
/// choice, because a robot walks steadily after a second.
const ROBOTS: usize = 16;
const SECONDS: f64 = 6.0;
const BEGINNING: f64 = 2.0;

/// A command and how it was followed: forward, to the left [m/s] and yaw rate [rad/s].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CommandResult {
    pub command: [f64; 3],
    /// Mean over the robots that did not fall, in the base's frame; 0 if all fell.
    pub velocity: [f64; 3],
    /// |velocity − command| / |command|, where 1 rad/s counts as much as 1 m/s. A command counts as no smaller than the
    /// speed below which a training commands standing.
    pub error: f64,
    /// Share of the robots that fell.
    pub falls: f64,
}

/// The results for all commands.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CommandTracking {
    pub lines: Vec<CommandResult>,
    pub mean_error: f64,
    pub worst_error: f64,
    /// Share of all robots that fell.
    pub falls: f64,
}

/// The episodes of the study, before they are played.
pub struct CommandStudy {
    blueprints: Vec<Blueprint>,
    gait: Gait,
    /// Commanded speeds below this are zero in a training [m/s].
    small: f64,
}

impl CommandStudy {
    /// `options`: the keywords of LeggedVelocity with which the policy was trained. Their ranges of commands scale the
    /// commands of the study.
    pub fn new(policy: &PolicySource, options: &Value) -> Result<Self> {
        Self::on_sand(policy, options, 1.0)
    }

    /// The same on sand whose stress is multiplied by `strength`.
    pub fn on_sand(policy: &PolicySource, options: &Value, strength: f64) -> Result<Self> {
        check_range("strengths", strength, SAND)?;
        let no_policy = || {
            let reason = format!("it follows no commands; give FILE.onnx of a policy of {}", LeggedVelocity::ID);
            Error::invalid("policy", reason)
        };
        if !matches!(policy, PolicySource::Network { .. } | PolicySource::Random) {
            return Err(no_policy());
        }
        let base = Blueprint::new(LeggedVelocity::ID, options.clone())?;
        let gait = policy.gait(&base)?.ok_or_else(no_policy)?;
        let ends = serde_json::from_value(base.task.option("max_velocity")).unwrap_or_default();
        let units = Units::of(base.task.model()).up_to(ends);
        let ranges = base.task.command_ranges().unwrap_or_default();
        let mut commands: Vec<[f64; 3]> = Vec::new();
        for command in SHARES.iter().filter_map(|shares| trained(&ranges, units.small(), *shares)) {
            if !commands.contains(&command) {
                commands.push(command);
            }
        }
        if commands.is_empty() {
            return Err(Error::invalid("commands", "all ranges are 0, so there is nothing to follow"));
        }
        let blueprints = commands.iter().map(|command| held(options, *command, strength)).collect::<Result<_>>()?;
        Ok(Self { blueprints, gait, small: units.small() })
    }

    /// Memory of all tasks with their episodes [bytes].
    pub fn bytes(&self) -> usize {
        self.blueprints.iter().map(|blueprint| blueprint.bytes(ROBOTS)).sum()
    }

    /// Plays all episodes. An error of `progress` stops the work.
    pub fn run(&self, progress: &dyn Progress) -> Result<CommandTracking> {
        let (done, count) = (AtomicUsize::new(0), self.blueprints.len());
        let lines = parallel::map(&self.blueprints, |blueprint| {
            let steps = blueprint.task.spec().max_episode_steps as usize * count;
            follow(blueprint, &self.gait, self.small, &|| {
                let done = done.fetch_add(1, Ordering::Relaxed) + 1;
                progress.report((done as f64 / steps as f64).min(1.0), &format!("{count} commands"))
            })
        });
        let lines: Vec<CommandResult> = lines.into_iter().collect::<Result<_>>()?;
        let mean = |of: fn(&CommandResult) -> f64| lines.iter().map(of).sum::<f64>() / lines.len() as f64;
        let worst_error = lines.iter().map(|l| l.error).fold(0.0, f64::max);
        Ok(CommandTracking { mean_error: mean(|l| l.error), worst_error, falls: mean(|l| l.falls), lines })
    }
}

/// The command at these shares of the training's `ranges`: at 0 the one of a range that is nearest to standing still, at
/// ±1 its ends. In a training, speeds along the ground below `small` are zero. Such a command is made as fast as
/// `small`, in the same direction; if it is then out of the ranges, the robot turns only. None: the robot would stand.
fn trained(ranges: &[[f64; 2]; 3], small: f64, shares: [f64; 3]) -> Option<[f64; 3]> {
    // Rounded, so that a table shows the number that was commanded.
    let rounded = |x: f64| (x * 1e3).round() / 1e3;
    let at = |k: usize| {
        let [low, high] = ranges[k];
        let rest = 0.0_f64.clamp(low, high);
        rounded(rest + shares[k].abs() * (if shares[k] < 0.0 { low } else { high } - rest))
    };
    let mut command: [f64; 3] = std::array::from_fn(at);
    let speed = command[0].hypot(command[1]);
    if speed < small {
        // Rounding must not lead below the limit again.
        let faster = |k: usize| (command[k].abs() * small / speed * 1e3).ceil() / 1e3 * command[k].signum();
        let [x, y] = if speed > 0.0 { [faster(0), faster(1)] } else { [0.0; 2] };
        let within = |k: usize, v: f64| v == command[k] || (ranges[k][0]..=ranges[k][1]).contains(&v);
        [command[0], command[1]] = if within(0, x) && within(1, y) { [x, y] } else { [0.0; 2] };
    }
    (command != [0.0; 3]).then_some(command)
}

/// The task with one command, without randomness, on sand whose stress is multiplied by `strength`.
fn held(options: &Value, command: [f64; 3], strength: f64) -> Result<Blueprint> {
    let mut options = options.as_object().cloned().unwrap_or_default();
    let ranges: Map<String, Value> = NAMES.iter().zip(command).map(|(n, v)| ((*n).to_owned(), json!([v, v]))).collect();
    options.insert("commands".into(), Value::Object(ranges));
    let stronger = DomainRand { sand_range: [strength; 2], ..DomainRand::NONE };
    options.insert("domain_rand".into(), if strength == 1.0 { Value::Null } else { json!(stronger) });
    options.insert("curriculum".into(), Value::Null);
    let rate = crate::env::spec::CONTROL_RATE;
    options.insert("max_episode_steps".into(), json!((SECONDS * rate).round() as u64));
    Blueprint::new(LeggedVelocity::ID, Value::Object(options))
}

/// Indices of these info columns.
fn columns(spec: &Spec, names: [&str; 3]) -> Result<[usize; 3]> {
    let mut at = [0; 3];
    for (at, name) in at.iter_mut().zip(names) {
        let found = spec.info.iter().position(|c| c.name == name);
        *at = found.ok_or_else(|| Error::Internal(format!("{} has no {name}", spec.id)))?;
    }
    Ok(at)
}

/// Lets robots follow the command of `blueprint`.
fn follow(blueprint: &Blueprint, gait: &Gait, small: f64, report: &dyn Fn() -> Result<()>) -> Result<CommandResult> {
    let spec = blueprint.task.spec();
    let (velocity, commanded) = (columns(spec, VELOCITY)?, columns(spec, COMMAND)?);
    let seeds: Vec<u64> = (FIRST_SEED..).take(ROBOTS).collect();
    let mut shard = Shard::new(blueprint, ROBOTS)?;
    shard.reset(|_| true, Some(&seeds), |_| None);
    let mut player = gait.player(&seeds);
    let mut actions = vec![0.0; ROBOTS * spec.action.len()];
    let (mut sums, mut fell, mut command) = ([[0.0; 3]; ROBOTS], [false; ROBOTS], [0.0; 3]);
    let (steps, first) = (spec.max_episode_steps, (BEGINNING * spec.control_rate).round() as u32);
    for step in 0..steps {
        player.act(&shard, &mut actions)?;
        shard.step(&actions);
        for i in 0..ROBOTS {
            fell[i] |= shard.rows.terminated[i] > 0;
            let info = &shard.rows.infos[i * spec.info.len()..][..spec.info.len()];
            command = commanded.map(|k| info[k].into());
            if step >= first && !fell[i] {
                (0..3).for_each(|k| sums[i][k] += f64::from(info[velocity[k]]) / f64::from(steps - first));
            }
        }
        report()?;
    }
    let standing: Vec<&[f64; 3]> = sums.iter().zip(fell).filter(|(_, fell)| !fell).map(|(sum, _)| sum).collect();
    let velocity: [f64; 3] =
        std::array::from_fn(|k| standing.iter().map(|sum| sum[k]).sum::<f64>() / standing.len().max(1) as f64);
    let norm = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let error_of =
        |velocity: &[f64; 3]| norm(std::array::from_fn(|k| velocity[k] - command[k])) / norm(command).max(small);
    // Errors of robots on different grounds must not cancel.
    let error = if blueprint.task.option("ground") == ANY && !standing.is_empty() {
        standing.iter().map(|v| error_of(v)).sum::<f64>() / standing.len() as f64
    } else {
        error_of(&velocity)
    };
    let falls = fell.iter().filter(|fell| **fell).count() as f64 / ROBOTS as f64;
    Ok(CommandResult { command, velocity, error, falls })
}

/// Cells of the text table, the heading first.
pub fn cells(followed: &CommandTracking) -> Vec<Vec<String>> {
    let heading = ["commanded: forward [m/s]", "left [m/s]", "yaw [rad/s]", "forward", "left", "yaw", "error", "fell"];
    let line = |line: &CommandResult| {
        let speeds = line.command.iter().chain(&line.velocity).map(|x| format!("{x:.2}"));
        speeds.chain([percent(line.error), percent(line.falls)]).collect()
    };
    std::iter::once(heading.map(str::to_owned).to_vec()).chain(followed.lines.iter().map(line)).collect()
}

/// The line below the table.
pub fn summary(followed: &CommandTracking) -> String {
    let CommandTracking { mean_error, worst_error, falls, .. } = followed;
    format!("mean error {}, worst {}, fell {}", percent(*mean_error), percent(*worst_error), percent(*falls))
}

/// One sentence on what limits the policy; `level`: the mean level of the curriculum at the end of its training.
pub fn limit(followed: &CommandTracking, level: Option<f64>) -> String {
    let name = |line: &CommandResult| {
        let [x, y, yaw] = line.command;
        format!("{x:.2} m/s forward, {y:.2} m/s to the left, {yaw:.2} rad/s")
    };
    let worst = |of: fn(&CommandResult) -> f64| followed.lines.iter().max_by(|a, b| of(a).total_cmp(&of(b)));
    let early = level.filter(|level| *level < TRAINED).map(|level| {
        format!(
            "The training ended at level {level:.2} of 1 of its curriculum, with easier commands, pushes and ground than these: train \
             longer (--resume --seconds). "
        )
    });
    let worst = match (worst(|l| l.falls), worst(|l| l.error)) {
        (Some(line), _) if line.falls > 0.0 => {
            format!("It falls most often, in {} of the trials, under the command {}.", percent(line.falls), name(line))
        }
        (_, Some(line)) => {
            format!("It follows the command {} worst, with an error of {}.", name(line), percent(line.error))
        }
        _ => String::new(),
    };
    early.unwrap_or_default() + &worst
}

/// Mean level from which on most environments have full difficulty: our choice.
const TRAINED: f64 = 0.9;

pub(super) fn percent(share: f64) -> String {
    format!("{:.0} %", 100.0 * share)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Commands are inside of the ranges of the training, and none of them is set to zero by it.
    #[test]
    fn commands_are_those_of_the_training() {
        let small = 0.086;
        let of = |ranges: [[f64; 2]; 3]| SHARES.map(|shares| trained(&ranges, small, shares));
        // Usual ranges: shares of their ends.
        let usual = of([[-0.8, 0.8], [-0.4, 0.4], [-1.0, 1.0]]);
        assert_eq!(usual[0], Some([0.4, 0.0, 0.0]));
        assert_eq!(usual[3], Some([0.0, 0.16, 0.0]));
        assert_eq!(usual[7], Some([0.48, 0.0, 0.6]));
        // A small range to the side: 0.4 of it is made faster; a smaller one has no such command at all.
        let [x, y, yaw] = of([[-0.8, 0.8], [-0.1, 0.1], [0.0, 0.0]])[3].unwrap();
        assert!((x, yaw) == (0.0, 0.0) && (0.086..0.0875).contains(&y), "{y}");
        assert_eq!(of([[-0.8, 0.8], [-0.08, 0.08], [-1.0, 1.0]])[3], None);
        // A range without 0.
        assert_eq!(of([[0.3, 0.6], [0.0, 0.0], [-1.0, 1.0]])[2], Some([0.3, 0.0, 0.0]));
        assert_eq!(of([[0.3, 0.6], [0.0, 0.0], [-1.0, 1.0]])[5], Some([0.3, 0.0, 0.8]));
        for ranges in [[[-0.8, 0.8], [-0.08, 0.08], [-1.0, 1.0]], [[0.0, 0.05], [0.0, 0.0], [0.1, 0.2]]] {
            for command in of(ranges).into_iter().flatten() {
                let inside = (0..3).all(|k| command[k] == 0.0 || (ranges[k][0]..=ranges[k][1]).contains(&command[k]));
                let speed = command[0].hypot(command[1]);
                assert!(inside && (speed == 0.0 || speed >= small), "{command:?}");
            }
        }
    }
}
