//! Terms of the reward of LeggedVelocity: names and laws of legged_gym (`_reward_…` in `legged_robot.py`), with velocities, times
//! and torques in the robot's own units (`units`), so that weights are the same for robots of every size.

use super::episode::LeggedEpisode;
use super::units::Units;
use crate::feature::flag;
use crate::reward_terms;
use crate::sim::pose::bearing_force;
use crate::sim::tree::kinematics::{frames, lowest};
use crate::sim::{Model, State};
use crate::spec::CONTROL_RATE;
use crate::task::Transition;

/// Default of `tracking_sigma`. Our choice, because legged_gym's 0.25 (where the ends are 1) is too wide: for a command of
/// half the range's end, an error of a fifth of the command costs only 4 % of the term. With 0.25 ANYmal C walks a fifth
/// too fast on packed seeds (mean error of nine commands 18 %). With 0.1 it walks as fast as commanded (6 %, after the same
/// 12 million steps).
pub const TRACKING_SIGMA: f64 = 0.1;
/// A step is rewarded if its foot was in the air for longer than this [√(ℓ/g)]: legged_gym's 0.5 s for ANYmal's legs of 0.5 m.
const AIR: f64 = 2.2;

/// Share of a stride for which a foot bears load: that of unitree_rl_gym (`_reward_contact` in `g1_env.py`), a walk with both feet on the
/// ground for a tenth of the stride.
const STANCE: f64 = 0.55;

/// Share of a joint's range, at each of its two ends, that the joint should avoid (A1 in legged_gym: soft limits of 0.9).
const OUTER: f64 = 0.05;

/// The feet that bear load, and the other bodies that touch the ground.
pub struct Contacts {
    /// Does each foot bear load? In the order of the stance's feet. A foot that only touches grains, as every foot of a
    /// robot that wades does, is in the air.
    pub feet: Vec<bool>,
    pub base: bool,
    /// Does a body that is neither the base nor part of a leg touch the ground?
    pub upper: bool,
    /// Number of bodies besides the base and the feet that touch the ground.
    pub others: usize,
}

impl Contacts {
    /// `foot_loads`: the ground's force on each foot [N].
    pub fn of(model: &Model, state: &State, foot_loads: &[f64]) -> Self {
        let Some(tree) = &model.tree else { return Self { feet: Vec::new(), base: false, upper: false, others: 0 } };
        let frames = frames(&tree.tree, state);
        let touches = |i: usize| {
            let low = lowest(&frames[i], &tree.contacts[i]);
            low.z < model.surface_height(low.x, low.y)
        };
        let feet = &tree.stance.feet;
        let others = (1..frames.len()).filter(|i| !feet.contains(i) && touches(*i)).count();
        let upper = tree.stance.upper.iter().any(|i| touches(*i));
        let bearing = bearing_force(model);
        Self { feet: foot_loads.iter().map(|load| *load > bearing).collect(), base: touches(0), upper, others }
    }
}

/// The arguments of reward terms and figures.
pub struct LeggedStep<'a> {
    pub t: &'a Transition<'a>,
    pub legged: &'a LeggedEpisode,
    pub contacts: Contacts,
    /// Velocity that follows the command: forward, to the left [m/s], yaw [rad/s].
    pub tracked: [f64; 3],
    /// Share of this step's velocity in `tracked`, if the tracking terms are shaped.
    pub shaping: Option<f64>,
    /// Default position of each joint [rad].
    pub default: &'a [f64],
    pub units: &'a Units,
    /// Phase of the clock in [0, 1); None: there is no clock.
    pub phase: Option<f64>,
    /// For each foot: does it step half a stride after the first one?
    pub second: &'a [bool],
    /// σ of the tracking terms.
    pub sigma: f64,
    /// Gravity's direction after the step; this and the next two fields, velocity and angular velocity, are in the base's frame.
    pub gravity: [f64; 3],
    pub velocity: [f64; 3],
    pub angular_velocity: [f64; 3],
    pub fallen: bool,
    pub base_contact: bool,
    pub too_low: bool,
}

impl LeggedStep<'_> {
    pub fn terminated(&self) -> bool {
        !self.t.diverged && (self.fallen || self.base_contact || self.too_low)
    }

    /// A term for following, which is a function of the mean velocity. With shaping, the change that this step makes in it counts at
    /// once, divided by the step's share in the mean: the term for the velocity itself to first order, but a sway within a stride
    /// cancels. That is potential-based shaping (Ng, Harada & Russell 1999) without discount, so it favours no other policy. Without
    /// it a learner whose advantages are shorter than a stride sees an action's costs and only a part of its gain.
    fn following(&self, term: impl Fn(&Self, [f64; 3]) -> f64) -> f64 {
        let after = term(self, self.tracked);
        let Some(share) = self.shaping else { return after };
        let before = term(self, self.legged.average);
        before + (after - before) / share
    }

    /// Commanded speed along the ground [m/s].
    fn commanded(&self) -> f64 {
        self.legged.now[0].hypot(self.legged.now[1])
    }
}

reward_terms! {
    /// Weights of the reward's terms, with legged_gym's names and signs; each is a rate per second. Velocities are in
    /// the base's frame; v_max and ω_max are the ends of the commands' default ranges. Weights of terms in the robot's
    /// units are legged_gym's weights for ANYmal C (ℓ = 0.5 m), converted and rounded; the weight of the torques is
    /// between legged_gym's weights for A1 (0.26) and for ANYmal C (0.65), converted. `dof_pos_limits` is A1's. The
    /// weight of `termination`, our choice, costs 2 s of perfect tracking; legged_gym has 0, but clips negative sums.
    pub struct Rewards of LeggedStep<'_>, weights in [-1e4, 1e4] {
        tracking_lin_vel: 1.0, "exp(−(((v_x − commanded) / v_max,x)² + ((v_y − commanded) / v_max,y)²) / tracking_sigma)", |s| {
            s.following(|s, v| {
                let [x, y, _] = s.units.commanded();
                (-(square((v[0] - s.legged.now[0]) / x) + square((v[1] - s.legged.now[1]) / y)) / s.sigma).exp()
            })
        };
        tracking_ang_vel: 0.5, "exp(−((ω_z − commanded) / ω_max)² / tracking_sigma)", |s| {
            s.following(|s, v| (-square((v[2] - s.legged.now[2]) / s.units.commanded()[2]) / s.sigma).exp())
        };
        lin_vel_z: -10.0, "v_z² / (gℓ)", |s| square(s.velocity[2] / s.units.speed);
        ang_vel_xy: -1.0, "(ω_x² + ω_y²) ℓ/g", |s| (square(s.angular_velocity[0]) + square(s.angular_velocity[1])) / square(s.units.rate);
        orientation: 0.0, "g_x² + g_y², with gravity's direction g in the base's frame", |s| square(s.gravity[0]) + square(s.gravity[1]);
        torques: -0.3, "Σ (τ / (Wℓ))²", |s| s.t.after.torques.iter().map(|x| square(x / s.units.torque)).sum::<f64>();
        dof_acc: -1e-4, "Σ (mean acceleration of a joint over the step · ℓ/g)²", |s| accelerations(s.t) / square(square(s.units.rate));
        action_rate: -0.01, "Σ (change of the action)²", |s| {
            s.t.action.iter().zip(s.t.previous_action).map(|(a, b)| square(f64::from(a - b))).sum()
        };
        feet_air_time: 0.23, "Σ (time in the air / √(ℓ/g) − 2.2) over the feet that touch down; 0 if the commanded speed is 0", |s| {
            if s.commanded() > 0.0 { air_time(s) } else { 0.0 }
        };
        turning_air_time: 0.0, "feet_air_time in turns on the spot", |s| {
            if s.commanded() == 0.0 && s.legged.now[2] != 0.0 { air_time(s) } else { 0.0 }
        };
        collision: -1.0, "number of bodies in the ground, except base and feet", |s| s.contacts.others as f64;
        dof_pos_limits: -10.0, "Σ distance of joints beyond the middle 90 % of their range [rad]", |s| beyond_limits(s.t.model, s.t.after);
        stand_still: 0.0, "Σ |joint angle − default|; 0 if the commanded speed is above 0", |s| {
            if s.commanded() == 0.0 { off_default(s) } else { 0.0 }
        };
        contact: 0.0, "number of feet that bear load just in their 55 % of the clock's stride; 0 without command", |s| {
            if s.legged.now == [0.0; 3] { 0.0 } else { in_time(s) }
        };
        termination: -100.0, "1 in the step that terminates the episode", |s| flag(s.terminated());
    }
}

fn square(x: f64) -> f64 {
    x * x
}

fn accelerations(t: &Transition) -> f64 {
    let rates = t.after.rates.iter().zip(&t.before.rates);
    rates.map(|(after, before)| square((after - before) / t.period)).sum()
}

fn air_time(s: &LeggedStep) -> f64 {
    let landed = s.legged.air.iter().zip(&s.contacts.feet).filter(|(air, touches)| **air > 0.0 && **touches);
    landed.map(|(air, _)| (air + 1.0 / CONTROL_RATE) * s.units.rate - AIR).sum()
}

/// Number of feet that bear load when they should, and only then.
fn in_time(s: &LeggedStep) -> f64 {
    let Some(phase) = s.phase else { return 0.0 };
    let bears_now = |second: bool| (if second { (phase + 0.5).fract() } else { phase }) < STANCE;
    s.contacts.feet.iter().zip(s.second).filter(|(bears, second)| **bears == bears_now(**second)).count() as f64
}

fn off_default(s: &LeggedStep) -> f64 {
    s.t.after.angles.iter().zip(s.default).map(|(q, default)| (q - default).abs()).sum()
}

/// Sum over the joints of the distance by which each is in the outer part of its range [rad].
fn beyond_limits(model: &Model, state: &State) -> f64 {
    let Some(tree) = &model.tree else { return 0.0 };
    let way = |(joint, q): (&crate::sim::tree::TreeJoint, &f64)| {
        let [low, high] = joint.range?;
        let outer = OUTER * (high - low);
        Some((low + outer - q).max(q - high + outer).max(0.0))
    };
    tree.tree.joints().zip(&state.angles).filter_map(way).sum()
}
