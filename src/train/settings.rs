//! Hyperparameters. Names and meanings are those of stable-baselines3's PPO; those of further settings are as in
//! `examples/train.py`.

use crate::error::{Error, Result, check_range};
use serde_json::{Map, Value, json};

/// A number that is constant, or falls to zero over the training (`lin_X`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Schedule {
    pub first: f64,
    pub falls: bool,
}

impl Schedule {
    const fn constant(first: f64) -> Self {
        Self { first, falls: false }
    }

    /// The value at the share `done` of the training, 0 to 1.
    pub fn at(self, done: f64) -> f64 {
        if self.falls { self.first * (1.0 - done) } else { self.first }
    }

    fn json(self) -> Value {
        if self.falls { json!(format!("lin_{}", self.first)) } else { json!(self.first) }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Hyperparameters {
    pub n_envs: usize,
    /// The training ends after this many environment steps, or after this many seconds, whichever comes first.
    pub n_timesteps: u64,
    pub seconds: Option<f64>,
    /// The time [s] in place of `seconds` for a robot of LeggedVelocity with two legs, where `seconds` is not given.
    pub biped_seconds: Option<f64>,
    /// Normalize observations and rewards by running statistics.
    pub normalize: bool,
    /// Is the policy made symmetric in left and right? None (`auto`): yes, if the robot is symmetric.
    pub mirror: Option<bool>,
    pub learning_rate: Schedule,
    /// Steps of each environment between two updates.
    pub n_steps: usize,
    pub batch_size: usize,
    pub n_epochs: usize,
    pub gamma: f64,
    pub gae_lambda: f64,
    pub clip_range: Schedule,
    pub clip_range_vf: Option<Schedule>,
    pub normalize_advantage: bool,
    pub ent_coef: f64,
    pub vf_coef: f64,
    pub max_grad_norm: f64,
    pub target_kl: Option<f64>,
    /// Hidden layers of actor and critic.
    pub net_arch: [Vec<usize>; 2],
    pub log_std_init: f64,
    /// Steps in which the policy of a robot with six or more legs first imitates a plain gait, which also finds the
    /// ranges of its commands; 0: it starts from nothing.
    pub gait_prior: u64,
    /// Standard deviation of the actions' noise at the end of a training; None: no bound. From the middle of the training on it is
    /// at most this number to a power that grows from 0 to 1. A policy that learns with much noise, and is used without,
    /// walks faster and turns farther than commanded: feet that shake slip.
    pub final_std: Option<f64>,
    /// Options of the task.
    pub env_kwargs: Map<String, Value>,
}

/// Names in files; `policy` exists for stable-baselines3 and is always MlpPolicy.
const NAMES: [&str; 24] = [
    "n_envs",
    "n_timesteps",
    "seconds",
    "biped_seconds",
    "normalize",
    "mirror",
    "policy",
    "learning_rate",
    "n_steps",
    "batch_size",
    "n_epochs",
    "gamma",
    "gae_lambda",
    "clip_range",
    "clip_range_vf",
    "normalize_advantage",
    "ent_coef",
    "vf_coef",
    "max_grad_norm",
    "target_kl",
    "policy_kwargs",
    "gait_prior",
    "final_std",
    "env_kwargs",
];

/// Limits, our choice: far above useful values, far below what fills a machine's memory.
const MOST_ENVS: f64 = 65_536.0;
pub(super) const MOST_SAMPLES: usize = 1 << 22;
/// Time of a training [s].
pub(super) const SECONDS: std::ops::RangeInclusive<f64> = 1e-3..=1e7;
const MOST_LAYERS: usize = 8;
const MOST_WIDTH: f64 = 1024.0;

impl Default for Hyperparameters {
    /// stable-baselines3's defaults for one environment.
    fn default() -> Self {
        Self {
            n_envs: 1,
            n_timesteps: 1_000_000,
            seconds: None,
            biped_seconds: None,
            normalize: false,
            mirror: Some(false),
            learning_rate: Schedule::constant(3e-4),
            n_steps: 2048,
            batch_size: 64,
            n_epochs: 10,
            gamma: 0.99,
            gae_lambda: 0.95,
            clip_range: Schedule::constant(0.2),
            clip_range_vf: None,
            normalize_advantage: true,
            ent_coef: 0.0,
            vf_coef: 0.5,
            max_grad_norm: 0.5,
            target_kl: None,
            net_arch: [vec![64, 64], vec![64, 64]],
            log_std_init: 0.0,
            gait_prior: 0,
            final_std: None,
            env_kwargs: Map::new(),
        }
    }
}

impl Hyperparameters {
    /// Reads and checks the settings of a file's entry. Settings that it does not give have the defaults of stable-baselines3.
    pub fn from_entry(entry: &Map<String, Value>) -> Result<Self> {
        let mut settings = Self::default();
        for (name, value) in entry {
            settings.set(name, value)?;
        }
        settings.check()?;
        Ok(settings)
    }

    fn set(&mut self, name: &str, value: &Value) -> Result<()> {
        let time = |value: &Value| number(name, value, *SECONDS.start(), *SECONDS.end());
        match name {
            "n_envs" => self.n_envs = whole(name, value, 1.0, MOST_ENVS)? as usize,
            "n_timesteps" => self.n_timesteps = whole(name, value, 1.0, 1e12)? as u64,
            "seconds" => self.seconds = optional(value, time)?,
            "biped_seconds" => self.biped_seconds = optional(value, time)?,
            "normalize" => self.normalize = flag(name, value)?,
            "mirror" => self.mirror = if value == "auto" { None } else { Some(flag(name, value)?) },
            "policy" if value == "MlpPolicy" => (),
            "policy" => return Err(Error::invalid(name, format!("{value} is not MlpPolicy, the only policy"))),
            "learning_rate" => self.learning_rate = schedule(name, value)?,
            "n_steps" => self.n_steps = whole(name, value, 1.0, MOST_SAMPLES as f64)? as usize,
            "batch_size" => self.batch_size = whole(name, value, 2.0, MOST_SAMPLES as f64)? as usize,
            "n_epochs" => self.n_epochs = whole(name, value, 1.0, 1000.0)? as usize,
            "gamma" => self.gamma = number(name, value, 0.0, 1.0)?,
            "gae_lambda" => self.gae_lambda = number(name, value, 0.0, 1.0)?,
            "clip_range" => self.clip_range = schedule(name, value)?,
            "clip_range_vf" => self.clip_range_vf = optional(value, |v| schedule(name, v))?,
            "normalize_advantage" => self.normalize_advantage = flag(name, value)?,
            "ent_coef" => self.ent_coef = number(name, value, -1e3, 1e3)?,
            "vf_coef" => self.vf_coef = number(name, value, 0.0, 1e3)?,
            "max_grad_norm" => self.max_grad_norm = number(name, value, 1e-9, 1e9)?,
            "target_kl" => self.target_kl = optional(value, |v| number(name, v, 1e-9, 1e9))?,
            "policy_kwargs" => self.policy_kwargs(object(name, value)?)?,
            "gait_prior" => self.gait_prior = whole(name, value, 0.0, 1e12)? as u64,
            "final_std" => self.final_std = optional(value, |v| number(name, v, 1e-3, 1.0))?,
            "env_kwargs" => self.env_kwargs = object(name, value)?.clone(),
            _ => return Err(Error::unknown("setting", name, &NAMES)),
        }
        Ok(())
    }

    fn policy_kwargs(&mut self, given: &Map<String, Value>) -> Result<()> {
        for (name, value) in given {
            let place = format!("policy_kwargs.{name}");
            match (name.as_str(), value) {
                ("log_std_init", _) => self.log_std_init = number(&place, value, -20.0, 10.0)?,
                ("net_arch", Value::Object(both)) => {
                    for (part, sizes) in both {
                        let k = ["pi", "vf"].iter().position(|p| p == part);
                        let k = k.ok_or_else(|| Error::unknown("part of net_arch", part, &["pi", "vf"]))?;
                        self.net_arch[k] = layers(&format!("{place}.{part}"), sizes)?;
                    }
                }
                ("net_arch", _) => self.net_arch = [layers(&place, value)?, layers(&place, value)?],
                _ => return Err(Error::unknown("setting of policy_kwargs", name, &["net_arch", "log_std_init"])),
            }
        }
        Ok(())
    }

    /// Checks that involve more than one value.
    fn check(&self) -> Result<()> {
        let samples = self.n_envs.saturating_mul(self.n_steps);
        if !(2..=MOST_SAMPLES).contains(&samples) {
            return Err(Error::invalid("n_envs · n_steps", format!("{samples} is outside [2, {MOST_SAMPLES}]")));
        }
        if self.batch_size > samples {
            return Err(Error::invalid(
                "batch_size",
                format!("{} is more than n_envs · n_steps = {samples}", self.batch_size),
            ));
        }
        Ok(())
    }

    /// The largest logarithm of a deviation when the share `done` of a training is done; see `final_std`. A curriculum at a mean
    /// `level` below 1 still needs the noise: the logarithm is multiplied by the level's square (our choice: by a third at 0.6).
    pub fn most_log_std(&self, done: f64, level: f64) -> f32 {
        let share = level.powi(2) * (2.0 * done - 1.0);
        self.final_std.filter(|_| share > 0.0).map_or(f32::INFINITY, |last| (share * last.ln()) as f32)
    }

    /// The settings as an entry of a file.
    pub fn json(&self) -> Value {
        json!({
            "n_envs": self.n_envs,
            "n_timesteps": self.n_timesteps,
            "seconds": self.seconds,
            "biped_seconds": self.biped_seconds,
            "normalize": self.normalize,
            "mirror": self.mirror.map_or_else(|| json!("auto"), Value::Bool),
            "policy": "MlpPolicy",
            "learning_rate": self.learning_rate.json(),
            "n_steps": self.n_steps,
            "batch_size": self.batch_size,
            "n_epochs": self.n_epochs,
            "gamma": self.gamma,
            "gae_lambda": self.gae_lambda,
            "clip_range": self.clip_range.json(),
            "clip_range_vf": self.clip_range_vf.map(Schedule::json),
            "normalize_advantage": self.normalize_advantage,
            "ent_coef": self.ent_coef,
            "vf_coef": self.vf_coef,
            "max_grad_norm": self.max_grad_norm,
            "target_kl": self.target_kl,
            "policy_kwargs": {
                "log_std_init": self.log_std_init,
                "net_arch": {"pi": self.net_arch[0], "vf": self.net_arch[1]},
            },
            "gait_prior": self.gait_prior,
            "final_std": self.final_std,
            "env_kwargs": self.env_kwargs,
        })
    }
}

/// A number. YAML readers return some numbers as texts, such as 1_000 and 1e-3.
pub(super) fn float(value: &Value) -> Option<f64> {
    match value {
        Value::Number(number) => number.as_f64(),
        Value::String(text) => text.replace('_', "").parse().ok(),
        _ => None,
    }
}

fn number(name: &str, value: &Value, low: f64, high: f64) -> Result<f64> {
    let number = float(value).ok_or_else(|| Error::invalid(name, format!("{value} is no number")))?;
    check_range(name, number, low..=high)
}

fn whole(name: &str, value: &Value, low: f64, high: f64) -> Result<f64> {
    let number = number(name, value, low, high)?;
    if number.fract() == 0.0 { Ok(number) } else { Err(Error::invalid(name, format!("{value} is not whole"))) }
}

fn flag(name: &str, value: &Value) -> Result<bool> {
    value.as_bool().ok_or_else(|| Error::invalid(name, format!("{value} is neither true nor false")))
}

fn object<'a>(name: &str, value: &'a Value) -> Result<&'a Map<String, Value>> {
    value.as_object().ok_or_else(|| Error::invalid(name, format!("{value} is no table of names and values")))
}

fn optional<T>(value: &Value, read: impl FnOnce(&Value) -> Result<T>) -> Result<Option<T>> {
    if value.is_null() { Ok(None) } else { read(value).map(Some) }
}

fn schedule(name: &str, value: &Value) -> Result<Schedule> {
    let falling = value.as_str().and_then(|text| text.strip_prefix("lin_"));
    let first = float(&falling.map_or_else(|| value.clone(), |rest| json!(rest)));
    let first = first.ok_or_else(|| Error::invalid(name, format!("{value} is neither a number nor lin_NUMBER")))?;
    Ok(Schedule { first: check_range(name, first, 1e-12..=1e3)?, falls: falling.is_some() })
}

fn layers(name: &str, value: &Value) -> Result<Vec<usize>> {
    let sizes = value.as_array().filter(|sizes| sizes.len() <= MOST_LAYERS);
    let sizes =
        sizes.ok_or_else(|| Error::invalid(name, format!("{value} is no list of at most {MOST_LAYERS} sizes")))?;
    sizes.iter().map(|size| Ok(whole(name, size, 1.0, MOST_WIDTH)? as usize)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_noise_falls_in_the_second_half() {
        let entry =
            |last: Value| Hyperparameters::from_entry(json!({"final_std": last}).as_object().unwrap_or(&Map::new()));
        let settings = entry(json!(0.04)).unwrap();
        let most = [0.0, 0.5, 0.75, 1.0].map(|done| settings.most_log_std(done, 1.0).exp());
        assert_eq!(most[..2], [f32::INFINITY; 2]);
        assert!((most[2] - 0.2).abs() < 1e-6 && (most[3] - 0.04).abs() < 1e-6, "{most:?}");
        assert_eq!(settings.most_log_std(1.0, 0.0), f32::INFINITY);
        assert!((settings.most_log_std(1.0, 0.5).exp() - 0.04_f32.powf(0.25)).abs() < 1e-6);
        assert_eq!(entry(Value::Null).unwrap().most_log_std(1.0, 1.0), f32::INFINITY);
        assert!(entry(json!(0)).is_err());
    }
}
