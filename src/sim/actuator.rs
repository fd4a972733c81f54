//! What a motor can do, for all engines: its torque–speed line, and the time that its torque needs.
//!
//! The torque in the direction of motion is at most
//!
//! ```text
//!  τ(ω) = min(τ_limit, τ_stall (1 − ω/ω₀)),   not below 0
//! ```
//!
//! with the stall torque and the no-load speed of a DC motor behind its gear, at the joint (the same as Isaac Lab's
//! `DCMotor`, whose saturation effort is the stall torque). The servo's torque is tracked with a first-order lag:
//! τ ← τ_old + (τ_servo − τ_old) dt/(T + dt), the backward Euler step of T dτ/dt = τ_servo − τ.

use super::stop::{NO_LIMIT, StopTorque};
use crate::number::Real;

/// Stall torque as a multiple of the torque limit where it is not known: our choice, so that the full torque is available up to half of
/// the no-load speed.
const STALL: f64 = 2.0;

/// The motor of a joint. None: no limit; for `stall_torque`, twice the torque limit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Actuator {
    /// [N·m]
    pub torque_limit: Option<f64>,
    /// [N·m]
    pub stall_torque: Option<f64>,
    /// [rad/s]
    pub no_load_speed: Option<f64>,
    /// T [s]
    pub time_constant: f64,
}

/// The motors of a joint, one lane each.
#[derive(Clone, Copy)]
pub struct LaneActuator<R> {
    torque_limit: R,
    stall_torque: R,
    no_load_speed: R,
    time_constant: R,
}

impl Actuator {
    fn numbers(&self) -> [f64; 4] {
        let limit = self.torque_limit.unwrap_or(NO_LIMIT);
        let stall = self.stall_torque.unwrap_or(STALL * limit);
        [limit, stall, self.no_load_speed.unwrap_or(NO_LIMIT), self.time_constant]
    }
}

impl<R: Real> LaneActuator<R> {
    pub fn splat(actuator: &Actuator) -> Self {
        let [torque_limit, stall_torque, no_load_speed, time_constant] = actuator.numbers().map(R::splat);
        Self { torque_limit, stall_torque, no_load_speed, time_constant }
    }

    pub fn set_lane(&mut self, lane: usize, actuator: &Actuator) {
        let all = [&mut self.torque_limit, &mut self.stall_torque, &mut self.no_load_speed, &mut self.time_constant];
        all.into_iter().zip(actuator.numbers()).for_each(|(out, x)| out.set_lane(lane, x));
    }

    /// Least and greatest torque at the joint's rate.
    #[inline(always)]
    pub fn limits(&self, rate: R) -> [R; 2] {
        let part = rate / self.no_load_speed;
        let most = |part: R| (self.stall_torque * (R::one() - part)).clamp(R::zero(), self.torque_limit);
        [-most(-part), most(part)]
    }

    /// The torque that follows the servo's `push` in this step, if it was `before` in the last one.
    #[inline(always)]
    pub fn track(&self, push: StopTorque<R>, before: R, dt: R) -> StopTorque<R> {
        let share = dt / (self.time_constant + dt);
        let torque = (push.torque - before).mul_add(share, before);
        // Exactly the servo's without a lag.
        let free = R::one().lt(share + R::splat(f64::from(f32::EPSILON)));
        StopTorque { torque: R::select(free, push.torque, torque), yielding: push.yielding * share }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn torque_falls_along_the_line() {
        let motor = Actuator {
            torque_limit: Some(10.0),
            stall_torque: Some(15.0),
            no_load_speed: Some(30.0),
            time_constant: 0.0,
        };
        let motor = LaneActuator::<f64>::splat(&motor);
        for (rate, low, high) in [
            (0.0, -10.0, 10.0),
            (10.0, -10.0, 10.0),
            (20.0, -10.0, 5.0),
            (30.0, -10.0, 0.0),
            (40.0, -10.0, 0.0),
            (-20.0, -5.0, 10.0),
        ] {
            let [least, most] = motor.limits(rate);
            assert!((least - low).abs() < 1e-12 && (most - high).abs() < 1e-12, "{rate}: {least} {most}");
        }
        let ideal = LaneActuator::<f32>::splat(&Actuator { torque_limit: Some(0.05), ..Actuator::default() });
        assert_eq!(ideal.limits(40.0), [-0.05_f32, 0.05]);
    }

    #[test]
    fn a_lag_follows_the_servo() {
        let push = StopTorque { torque: 2.0, yielding: 0.5 };
        let at_once = LaneActuator::<f64>::splat(&Actuator::default()).track(push, 1.0, 1e-3);
        assert_eq!((at_once.torque, at_once.yielding), (2.0, 0.5));
        let slow = LaneActuator::<f64>::splat(&Actuator { time_constant: 0.02, ..Actuator::default() });
        let mut torque = 0.0;
        for _ in 0..20 {
            torque = slow.track(push, torque, 1e-3).torque;
        }
        assert!((torque / 2.0 - (1.0 - (-1.0_f64).exp())).abs() < 0.02, "{torque}");
    }

    /// Motors of many strengths drive a hexapod to random speeds. A torque is never beyond its motor's line. Whether a motor is at
    /// its limit is decided with the link before it held still, so a torque may be beyond by the part that this link's
    /// acceleration adds: the test's tolerance.
    #[test]
    fn no_torque_is_beyond_its_line() {
        use crate::engine::{Command, Engine, EngineKind};
        use crate::sand::Medium;
        use crate::{Model, Robot, State, model::Scene};
        let scene = Scene::flat(Medium::named("poppy-loose").unwrap());
        let robot = Robot::load("xplorer").unwrap();
        let mut state = 1_u64;
        let mut draw = |low: f64, high: f64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            low + (high - low) * ((state >> 11) as f64 / (1_u64 << 53) as f64)
        };
        for kind in [EngineKind::Lanes, EngineKind::Rapier] {
            let mut worst = 0.0_f64;
            for round in 0..12 {
                let mut robot = robot.clone();
                let limit = draw(0.005, 0.1);
                robot.servo.torque_limit = Some(limit);
                robot.servo.anti_windup = true;
                let (stall, free) = (draw(1.0, 2.0) * limit, draw(3.0, 40.0));
                let scene = Scene { dt: kind.default_dt(), ..scene.clone() };
                let lag = if round % 2 == 0 { 0.0 } else { draw(0.0, 0.02) };
                let model = Model::new(&robot, &scene).unwrap().with_motors(Some(stall), Some(free), lag);
                let line = LaneActuator::<f64>::splat(&model.motor.actuator);
                let mut engine = Engine::new(kind, &model, 1).unwrap();
                let angles = model.tripod_angles();
                let mut now = State::at_rest(model.standing_height(&angles), &angles);
                engine.set_state(0, &now);
                for step in 0..400 {
                    if step % 40 == 0 {
                        let rates = (0..6).map(|_| draw(-60.0, 60.0)).collect();
                        engine.command(0, &Command { rates, torques: vec![0.0; 6], targets: vec![] });
                    }
                    let before = now.clone();
                    engine.advance(1);
                    engine.state(0, &mut now);
                    assert!(now.is_sound());
                    for (torque, rate) in now.torques.iter().zip(&before.rates) {
                        let [low, high] = line.limits(*rate);
                        worst = worst.max((torque - high).max(low - torque) / limit);
                    }
                }
            }
            println!("{}: beyond the line by at most {worst:.4} of the torque limit", kind.name());
            assert!(worst < 0.05, "{}: {worst}", kind.name());
        }
    }
}
