//! What a motor and its gear can do, for all engines.
//!
//! The torque in the direction of motion is at most
//!
//! ```text
//!  τ(ω) = min(τ_limit, τ_stall (1 − ω/ω₀)),   not below 0
//! ```
//!
//! with the stall torque and the no-load speed of a DC motor behind its gear, at the joint (the same as Isaac Lab's `DCMotor`, whose
//! saturation effort is the stall torque). The servo's torque is tracked with a first-order lag: τ ← τ_old + (k τ_servo − τ_old) dt/(T + dt),
//! the backward Euler step of T dτ/dt = k τ_servo − τ, in which k is the motor's torque constant divided by the torque constant that the
//! drive assumes.
//!
//! The gear takes the torque (F + (1 − η) |τ_old|) sign ω + B ω away: dry friction F, dry friction in proportion to the
//! torque that the gear carries, and viscous friction B. The second part is what an efficiency η of less than 1 means
//! in both directions. Like the friction of joints in [`super::tree`], the friction is implicit in the speed at the
//! step's end, so it takes energy at any acceleration. The rotor's inertia is added to the joint's.
//!
//! **Limits.** Servos are implicit in the acceleration, so a torque is known only after all accelerations are. An
//! engine first solves with each motor's torque limited at the acceleration that its joint would have if the link
//! before it were held still. For motors whose stall torque is known, the engine then compares each torque with the
//! line at the speeds before and after the step. If some torques are beyond their lines, the engine puts each of them
//! on the lower of the two lines and solves again ([`LimitedTorque`]; Newton's method for piecewise linear functions).
//! Usually one such pass is enough. A torque that is still beyond its line after [`NEWTON`] passes is 0 in this step.
//! Without a known stall torque the engine solves only once. A torque may then exceed its constant limit by about 1 %,
//! because the previous link's acceleration adds to it.

use super::stop::{ImplicitTorque, NO_LIMIT};
use crate::error::{Error, Result, check_range};
use crate::number::Real;
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;

/// Stall torque as a multiple of the torque limit where it is not known: our choice, so that the full torque is available up to half of
/// the no-load speed.
const STALL: f64 = 2.0;

/// Speed at which dry friction has its full size [rad/s]; a joint creeps more slowly under a smaller load. Our choice, because even at this
/// rate a joint turns by only 0.06° in a second.
pub const CREEP: f64 = 1e-3;

/// Number of passes after which a torque that is still beyond its limits becomes 0: our choice, twice the number of
/// pieces of a line.
pub const NEWTON: usize = 6;
/// Rounding that does not count as beyond the limits, as shares of the smallest limit and of the stall torque: our
/// choice, some 100 and 10 units of the last place of `f32`. The reported torque is cut to the limits.
const ROUNDING: [f64; 2] = [1e-5, 1e-6];

/// The motor of a joint and its gear. A property that is None is not known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Actuator {
    /// [N·m]; None: no limit.
    pub torque_limit: Option<f64>,
    /// [N·m]; None: twice the torque limit.
    pub stall_torque: Option<f64>,
    /// [rad/s]; None: no limit.
    pub no_load_speed: Option<f64>,
    /// T [s]; None: 0.
    pub torque_time: Option<f64>,
    /// k; None: 1.
    pub torque_constant: Option<f64>,
    /// Friction F [N·m]; None: the joint's own friction.
    pub friction: Option<f64>,
    /// Damping B [N·m·s/rad]; None: the joint's own damping.
    pub damping: Option<f64>,
    /// η; None: 1.
    pub efficiency: Option<f64>,
    /// Rotor inertia at the joint [kg·m²], added to the joint's own inertia; None: 0.
    pub rotor_inertia: Option<f64>,
}

/// Greatest factor of an episode's draw on a property of a motor, up or down: our choice, above those of all tasks.
const DRAWN: f64 = 1e3;

/// Ranges of a motor's properties, for the options of tasks, for files and for saved episodes alike. They catch wrong
/// units: our choice, beyond the motor of any robot. An excavator's arm needs some 1e5 N·m.
impl Actuator {
    pub const TORQUE_LIMIT: RangeInclusive<f64> = 1e-6..=1e5;
    pub const STALL_TORQUE: RangeInclusive<f64> = 1e-6..=STALL * 1e5;
    pub const NO_LOAD_SPEED: RangeInclusive<f64> = 1e-3..=1e4;
    pub const TORQUE_TIME: RangeInclusive<f64> = 0.0..=10.0;
    pub const TORQUE_CONSTANT: RangeInclusive<f64> = 0.01..=100.0;
    pub const FRICTION: RangeInclusive<f64> = 0.0..=1e5;
    pub const DAMPING: RangeInclusive<f64> = 0.0..=1e5;
    pub const EFFICIENCY: RangeInclusive<f64> = 0.01..=1.0;
    pub const ROTOR_INERTIA: RangeInclusive<f64> = 0.0..=1e3;
}

impl Actuator {
    /// A copy in which `other` supplies the properties that are not known here.
    pub fn or(&self, other: &Self) -> Result<Self> {
        let mut all = Self {
            torque_limit: self.torque_limit.or(other.torque_limit),
            stall_torque: self.stall_torque.or(other.stall_torque),
            no_load_speed: self.no_load_speed.or(other.no_load_speed),
            torque_time: self.torque_time.or(other.torque_time),
            torque_constant: self.torque_constant.or(other.torque_constant),
            friction: self.friction.or(other.friction),
            damping: self.damping.or(other.damping),
            efficiency: self.efficiency.or(other.efficiency),
            rotor_inertia: self.rotor_inertia.or(other.rotor_inertia),
        };
        if self.no_load_speed.is_some() && all.stall_torque.is_none() {
            let limit = all.torque_limit.filter(|limit| *limit < NO_LIMIT);
            let unknown = || Error::invalid("actuator.no_load_speed", "it needs a stall_torque or a torque limit");
            all.stall_torque = Some(STALL * limit.ok_or_else(unknown)?);
        }
        Ok(all)
    }

    /// Refuses numbers that no motor of a robot has. `owner` names the motor's owner. An episode may draw a strength that
    /// takes a motor beyond the ranges of options, by less than a factor of [`DRAWN`]. No episode draws an efficiency.
    pub fn validate(&self, owner: &str) -> Result<()> {
        for (name, value, range) in [
            ("torque_limit", self.torque_limit, Self::TORQUE_LIMIT),
            ("stall_torque", self.stall_torque, Self::STALL_TORQUE),
            ("no_load_speed", self.no_load_speed, Self::NO_LOAD_SPEED),
            ("torque_time", self.torque_time, Self::TORQUE_TIME),
            ("torque_constant", self.torque_constant, Self::TORQUE_CONSTANT),
            ("friction", self.friction, Self::FRICTION),
            ("damping", self.damping, Self::DAMPING),
            ("rotor_inertia", self.rotor_inertia, Self::ROTOR_INERTIA),
        ] {
            let range = range.start() / DRAWN..=range.end() * DRAWN;
            value.map(|value| check_range(&format!("{owner}.{name}"), value, range)).transpose()?;
        }
        let efficiency = |value| check_range(&format!("{owner}.efficiency"), value, Self::EFFICIENCY);
        self.efficiency.map(efficiency).transpose()?;
        Ok(())
    }

    fn numbers(&self) -> [f64; 10] {
        let limit = self.torque_limit.unwrap_or(NO_LIMIT);
        let zero = |x: Option<f64>| x.unwrap_or(0.0);
        [
            limit,
            self.stall_torque.unwrap_or(STALL * limit),
            self.no_load_speed.unwrap_or(NO_LIMIT),
            zero(self.torque_time),
            self.torque_constant.unwrap_or(1.0),
            zero(self.friction),
            zero(self.damping),
            1.0 - self.efficiency.unwrap_or(1.0),
            zero(self.rotor_inertia),
            f64::from(u8::from(self.stall_torque.is_some())),
        ]
    }
}

/// The motors of a joint, one lane each.
#[derive(Clone, Copy)]
pub struct LaneActuator<R> {
    torque_limit: R,
    stall_torque: R,
    no_load_speed: R,
    torque_time: R,
    torque_constant: R,
    friction: R,
    damping: R,
    /// 1 − η
    loss: R,
    rotor_inertia: R,
    /// 1 where the stall torque is known, else 0.
    has_line: R,
    /// The parts of the motor model that at least one lane has. A step skips all other parts; the results are bit-identical.
    any: Has,
}

/// Does a motor have: a line of torque over speed; a gear with friction, or a rotor with inertia; a torque that lags
/// the servo's?
#[derive(Clone, Copy, Default)]
struct Has {
    line: bool,
    gear: bool,
    lag: bool,
}

impl<R: Real> LaneActuator<R> {
    pub fn splat(actuator: &Actuator) -> Self {
        let zero = R::zero();
        let mut all = Self {
            torque_limit: zero,
            stall_torque: zero,
            no_load_speed: zero,
            torque_time: zero,
            torque_constant: zero,
            friction: zero,
            damping: zero,
            loss: zero,
            rotor_inertia: zero,
            has_line: zero,
            any: Has::default(),
        };
        (0..R::LANES).for_each(|lane| all.set_lane(lane, actuator));
        all
    }

    pub fn set_lane(&mut self, lane: usize, actuator: &Actuator) {
        let all: [&mut R; 10] = [
            &mut self.torque_limit,
            &mut self.stall_torque,
            &mut self.no_load_speed,
            &mut self.torque_time,
            &mut self.torque_constant,
            &mut self.friction,
            &mut self.damping,
            &mut self.loss,
            &mut self.rotor_inertia,
            &mut self.has_line,
        ];
        all.into_iter().zip(actuator.numbers()).for_each(|(out, x)| out.set_lane(lane, x));
        let nonzero = |all: &[R]| all.iter().any(|x| R::any(R::zero().lt(x.abs())));
        self.any = Has {
            line: nonzero(&[self.has_line]),
            gear: nonzero(&[self.friction, self.damping, self.loss, self.rotor_inertia]),
            lag: nonzero(&[self.torque_time, self.torque_constant - R::one()]),
        };
    }

    /// Is a stall torque known in any lane?
    #[inline(always)]
    pub fn has_lines(&self) -> bool {
        self.any.line
    }

    /// Least and greatest torque at the joint's rate.
    #[inline(always)]
    pub fn limits(&self, rate: R) -> [R; 2] {
        let part = rate / self.no_load_speed;
        let most = |part: R| (self.stall_torque * (R::one() - part)).clamp(R::zero(), self.torque_limit);
        [-most(-part), most(part)]
    }

    /// The motor's torque in this step, which follows the servo's `push` with a lag; `before`: its torque in the last step.
    #[inline(always)]
    pub fn track(&self, push: ImplicitTorque<R>, before: R, dt: R) -> ImplicitTorque<R> {
        if !self.any.lag {
            return push;
        }
        let share = dt / (self.torque_time + dt);
        let push = ImplicitTorque {
            torque: push.torque * self.torque_constant,
            yielding: push.yielding * self.torque_constant,
        };
        let torque = (push.torque - before).mul_add(share, before);
        // Without a lag, the torque is exactly the servo's.
        let free = R::one().lt(share + R::splat(f64::from(f32::EPSILON)));
        ImplicitTorque { torque: R::select(free, push.torque, torque), yielding: push.yielding * share }
    }

    /// Friction of the gear and inertia of the rotor; `before`: the motor's torque in the last step.
    #[inline(always)]
    pub fn gear(&self, rate: R, before: R, dt: R) -> ImplicitTorque<R> {
        if !self.any.gear {
            return ImplicitTorque::none();
        }
        let slows = self.slows(rate, before);
        ImplicitTorque { torque: -(slows * rate), yielding: slows.mul_add(dt, self.rotor_inertia) }
    }

    /// Friction of the gear divided by the speed [N·m·s/rad].
    #[inline(always)]
    pub fn slows(&self, rate: R, before: R) -> R {
        let dry = self.loss.mul_add(before.abs(), self.friction);
        dry / rate.abs().max(R::splat(CREEP)) + self.damping
    }

    /// The torque `servo`, limited for a joint that accelerates by `acceleration`.
    #[inline(always)]
    pub fn limited(&self, servo: ImplicitTorque<R>, rate: R, acceleration: R, dt: R) -> ImplicitTorque<R> {
        let [low, high] = self.limits(rate);
        let flat = servo.within(low, high, acceleration);
        if !self.has_lines() {
            return flat;
        }
        let [lower, upper] = self.bounds(rate, acceleration, dt);
        let torque = servo.at(acceleration);
        let piece = ImplicitTorque::select(upper.at(acceleration).lt(torque), upper, servo);
        let piece = ImplicitTorque::select(torque.lt(lower.at(acceleration)), lower, piece);
        ImplicitTorque::select(R::zero().lt(self.has_line), piece, flat)
    }

    /// The motor's least and greatest torque. Its torque-speed line must allow the torque at the speed before the step and
    /// at the speed after it. The speed after the step depends on the acceleration, so each bound is piecewise linear in
    /// the acceleration; the result is the piece that contains `acceleration`.
    #[inline(always)]
    fn bounds(&self, rate: R, acceleration: R, dt: R) -> [ImplicitTorque<R>; 2] {
        let [low, high] = self.limits(rate);
        let slope = self.stall_torque / self.no_load_speed;
        let most = |rate: R, acceleration: R, now: R| {
            let line = ImplicitTorque { torque: self.stall_torque - slope * rate, yielding: slope * dt };
            let after = line.at(acceleration);
            let constant = ImplicitTorque { torque: after.clamp(R::zero(), now), yielding: R::zero() };
            ImplicitTorque::select(after.lt(now), ImplicitTorque::select(R::zero().lt(after), line, constant), constant)
        };
        let lower = most(-rate, -acceleration, -low);
        [ImplicitTorque { torque: -lower.torque, yielding: lower.yielding }, most(rate, acceleration, high)]
    }

    /// By how much `torque` is beyond the limits of a motor whose stall torque is known; 0 or less if it is within
    /// them.
    #[inline(always)]
    pub fn beyond(&self, torque: R, rate: R, acceleration: R, dt: R) -> R {
        let [lower, upper] = self.bounds(rate, acceleration, dt).map(|bound| bound.at(acceleration));
        let [share, of_stall] = ROUNDING.map(R::splat);
        let rounding = self.torque_limit.min(self.stall_torque).mul_add(share, self.stall_torque * of_stall);
        ((torque - upper).max(lower - torque) - rounding) * self.has_line
    }

    /// The torque to report: where the stall torque is known, `torque` clamped to the limits, which removes rounding; else `flat`.
    #[inline(always)]
    pub fn reported(&self, flat: R, torque: R, rate: R, acceleration: R, dt: R) -> R {
        if !self.has_lines() {
            return flat;
        }
        let [lower, upper] = self.bounds(rate, acceleration, dt).map(|bound| bound.at(acceleration));
        R::select(R::zero().lt(self.has_line), torque.clamp(lower, upper), flat)
    }
}

/// A motor's torque in the passes of one step.
#[derive(Clone, Copy)]
pub struct LimitedTorque<R> {
    /// The servo's torque without limits.
    servo: ImplicitTorque<R>,
    /// The torque of the last pass, or, if [`next_pass`] has prepared another pass, of that pass.
    pub push: ImplicitTorque<R>,
    /// 1 in lanes where the next pass uses `push`.
    held: R,
}

impl<R: Real> LimitedTorque<R> {
    pub fn none() -> Self {
        Self { servo: ImplicitTorque::none(), push: ImplicitTorque::none(), held: R::zero() }
    }

    /// Before the first pass.
    #[inline(always)]
    pub fn begin(&mut self) {
        self.held = R::zero();
    }

    /// The motor's torque in this pass; in the first pass this is the argument `push`.
    #[inline(always)]
    pub fn pass(&mut self, servo: ImplicitTorque<R>, push: ImplicitTorque<R>) -> ImplicitTorque<R> {
        self.servo = servo;
        self.push = ImplicitTorque::select(R::zero().lt(self.held), self.push, push);
        self.push
    }
}

/// Prepares the pass after pass number `pass` and returns true if a torque is beyond its motor's limits. `limits` has
/// an entry for each joint, and `joint(i)` gives the actuator of joint `i`, its rate before the step and its
/// acceleration. In a robot with such a torque, all motors use the pieces of their lines at these accelerations in the
/// next pass. Motors of the other robots in the block keep their torques. Returns false if no torque is beyond its
/// limits.
#[inline(always)]
pub fn next_pass<'a, R: Real>(
    limits: &mut [LimitedTorque<R>],
    joint: impl Fn(usize) -> (&'a LaneActuator<R>, R, R),
    dt: R,
    pass: usize,
) -> bool {
    let zero = R::zero();
    let beyond = |i: usize, limits: &LimitedTorque<R>| {
        let (actuator, rate, acceleration) = joint(i);
        actuator.beyond(limits.push.at(acceleration), rate, acceleration, dt)
    };
    let worst = limits.iter().enumerate().fold(zero, |worst, (i, own)| worst.max(beyond(i, own)));
    if !R::any(zero.lt(worst)) {
        return false;
    }
    for (i, own) in limits.iter_mut().enumerate() {
        let (actuator, rate, acceleration) = joint(i);
        let next = match pass < NEWTON {
            true => actuator.limited(own.servo, rate, acceleration, dt),
            false => ImplicitTorque::select(zero.lt(beyond(i, own)), ImplicitTorque::none(), own.push),
        };
        own.push = ImplicitTorque::select(zero.lt(worst), next, own.push);
        own.held = R::select(zero.lt(worst), R::one(), own.held);
    }
    true
}
