//! What LeggedVelocity takes beyond other tasks: names and defaults after legged_gym (Rudin et al. 2022,
//! `legged_robot_config.py`) where it has them.

use crate::error::{Error, Result, check_range};
use crate::sand::Medium;
use crate::sim::tree::HardGround;
use crate::spec::Term;
use serde::{Deserialize, Serialize};

/// Ranges [low, high] that commands are drawn from, at the start and every `resampling_time`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Commands {
    /// Forward [m/s].
    pub lin_vel_x: [f64; 2],
    /// To the left [m/s].
    pub lin_vel_y: [f64; 2],
    /// Yaw [rad/s].
    pub ang_vel_yaw: [f64; 2],
    /// [s]
    pub resampling_time: f64,
}

impl Default for Commands {
    /// As legged_gym's.
    fn default() -> Self {
        let one = [-1.0, 1.0];
        Self { lin_vel_x: one, lin_vel_y: one, ang_vel_yaw: one, resampling_time: 10.0 }
    }
}

impl Commands {
    pub const MOST: f64 = 5.0;

    pub fn validate(&self) -> Result<()> {
        let ranges = [("lin_vel_x", self.lin_vel_x), ("lin_vel_y", self.lin_vel_y), ("ang_vel_yaw", self.ang_vel_yaw)];
        for (name, [low, high]) in ranges {
            check_range(&format!("commands.{name}[0]"), low, -Self::MOST..=Self::MOST)?;
            check_range(&format!("commands.{name}[1]"), high, low..=Self::MOST)?;
        }
        check_range("commands.resampling_time", self.resampling_time, 0.1..=1e4).map(drop)
    }
}

/// Ranges [low, high] that an episode draws from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DomainRand {
    /// Friction of hard ground over that of the robot's own shapes (legged_gym: 0.5 to 1.25).
    pub friction_range: [f64; 2],
    /// Stress of the sand over its medium's.
    pub sand_range: [f64; 2],
    /// Added to the base [kg], as a share of the robot's mass (legged_gym: ± 1 kg of 12).
    pub added_mass_range: [f64; 2],
    /// Torque limits and gains of the motors over their own.
    pub motor_strength_range: [f64; 2],
    /// Time between two pushes [s] (legged_gym: 15); 0: none.
    pub push_interval: f64,
    /// Largest velocity along x and along y that a push gives the base [m/s] (legged_gym: 1).
    pub max_push_vel_xy: f64,
}

impl Default for DomainRand {
    fn default() -> Self {
        Self {
            friction_range: [0.5, 1.25],
            sand_range: [0.6, 1.6],
            added_mass_range: [-0.08, 0.08],
            motor_strength_range: [0.9, 1.1],
            push_interval: 15.0,
            max_push_vel_xy: 0.5,
        }
    }
}

impl DomainRand {
    /// Nothing is drawn.
    pub const NONE: Self = Self {
        friction_range: [1.0; 2],
        sand_range: [1.0; 2],
        added_mass_range: [0.0; 2],
        motor_strength_range: [1.0; 2],
        push_interval: 0.0,
        max_push_vel_xy: 0.0,
    };

    pub fn validate(&self) -> Result<()> {
        let ranges = [
            ("friction_range", self.friction_range, [0.0, 10.0]),
            ("sand_range", self.sand_range, [0.05, 20.0]),
            ("added_mass_range", self.added_mass_range, [-0.3, 1.0]),
            ("motor_strength_range", self.motor_strength_range, [0.1, 10.0]),
        ];
        for (name, [low, high], [least, most]) in ranges {
            check_range(&format!("domain_rand.{name}[0]"), low, least..=most)?;
            check_range(&format!("domain_rand.{name}[1]"), high, low..=most)?;
        }
        if self.push_interval != 0.0 {
            check_range("domain_rand.push_interval", self.push_interval, 0.1..=1e4)?;
        }
        check_range("domain_rand.max_push_vel_xy", self.max_push_vel_xy, 0.0..=5.0).map(drop)
    }
}

/// Weights of the reward's terms, with legged_gym's names, signs and values; each counts for a second.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Rewards {
    pub tracking_lin_vel: f64,
    pub tracking_ang_vel: f64,
    pub lin_vel_z: f64,
    pub ang_vel_xy: f64,
    pub orientation: f64,
    pub torques: f64,
    pub dof_acc: f64,
    pub action_rate: f64,
    pub feet_air_time: f64,
    pub collision: f64,
    pub dof_pos_limits: f64,
    pub stand_still: f64,
    pub termination: f64,
}

impl Default for Rewards {
    fn default() -> Self {
        Self {
            tracking_lin_vel: 1.0,
            tracking_ang_vel: 0.5,
            lin_vel_z: -2.0,
            ang_vel_xy: -0.05,
            orientation: 0.0,
            torques: -1e-5,
            dof_acc: -2.5e-7,
            action_rate: -0.01,
            feet_air_time: 1.0,
            collision: -1.0,
            dof_pos_limits: -10.0,
            stand_still: 0.0,
            termination: -100.0,
        }
    }
}

/// Name and law of each term, in the order of [`Rewards`]; all but the last two velocities in the base's frame.
const TERMS: [(&str, &str); 13] = [
    ("tracking_lin_vel", "exp(−((v_x − commanded)² + (v_y − commanded)²) / 0.25 m²/s²)"),
    ("tracking_ang_vel", "exp(−(ω_z − commanded)² / 0.25 rad²/s²)"),
    ("lin_vel_z", "v_z²"),
    ("ang_vel_xy", "ω_x² + ω_y²"),
    ("orientation", "squares of gravity's direction along x and y of the base"),
    ("torques", "Σ τ²"),
    ("dof_acc", "Σ (change of a joint's speed over the step)²"),
    ("action_rate", "Σ (change of the action)²"),
    ("feet_air_time", "Σ (time in the air − 0.5 s) of feet that touch down, if more than 0.1 m/s is commanded"),
    ("collision", "number of bodies in the ground that are neither base nor feet"),
    ("dof_pos_limits", "Σ way of joints into the outer 5 % of their range at either end [rad]"),
    ("stand_still", "Σ |joint − default|, if less than 0.1 m/s is commanded"),
    ("termination", "1 in the step that terminates the episode"),
];

impl Rewards {
    pub(crate) fn values(&self) -> [f64; TERMS.len()] {
        [
            self.tracking_lin_vel,
            self.tracking_ang_vel,
            self.lin_vel_z,
            self.ang_vel_xy,
            self.orientation,
            self.torques,
            self.dof_acc,
            self.action_rate,
            self.feet_air_time,
            self.collision,
            self.dof_pos_limits,
            self.stand_still,
            self.termination,
        ]
    }

    pub fn terms(&self) -> Vec<Term> {
        TERMS.iter().zip(self.values()).map(|((name, law), weight)| Term { name, law, weight }).collect()
    }

    pub fn validate(&self) -> Result<()> {
        let mut terms = self.terms().into_iter();
        terms.try_for_each(|t| check_range(&format!("rewards.{}", t.name), t.weight, -1e4..=1e4).map(drop))
    }
}

/// Kinds of ground that are no medium: hard, slabs of hard ground in sand.
pub const GROUNDS: [&str; 2] = ["rigid", "mixed"];
/// Size of the slabs of `mixed`, and distance after which the next comes [m]: our choice, a robot's length or two.
const SLABS: [f64; 2] = [0.8, 1.6];

/// Hard ground of a kind, and the medium of the sand.
pub(super) fn ground(name: &str) -> Result<(Vec<HardGround>, Medium)> {
    let sand = || Medium::named(Medium::DEFAULT);
    let [size, every] = SLABS.map(|length| [length; 2]);
    match name {
        "rigid" => Ok((vec![HardGround::everywhere()], sand()?)),
        "mixed" => Ok((vec![HardGround { size, every, ..HardGround::everywhere() }], sand()?)),
        _ => {
            let media = Medium::names();
            let medium = Medium::named(name).map_err(|e| match e {
                Error::Unknown { .. } => Error::unknown("ground", name, &[&GROUNDS[..], &media].concat()),
                other => other,
            });
            Ok((Vec::new(), medium?))
        }
    }
}
