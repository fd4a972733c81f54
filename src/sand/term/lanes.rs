//! Terms in the hot loop, for one number or for lanes.

use super::{Group, MOST_GROUPS, MOST_TERMS, On, Term};
use crate::GRAVITY;
use crate::number::{Real, Vec3};

/// Speed [m/s] below which a term falls to zero, so that it is smooth at rest: our choice, a tenth of cohesion's
/// speed.
const REST_SPEED: f64 = 1e-4;
/// One group of a term in the hot loop.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Factor {
    group: Group,
    low: f64,
    high: f64,
    power: f64,
}

/// One term. All lanes share it except for its coefficient.
#[derive(Clone, Copy)]
struct LaneTerm<R> {
    on: On,
    factors: [Factor; MOST_GROUPS],
    count: usize,
    /// coefficient · ρ g [N/m³], or, if the term is a share of the law's stress, the coefficient alone; 0 in lanes without the term.
    strength: R,
}

/// Terms ready for evaluation, one lane for each environment.
#[derive(Clone, Copy)]
pub struct LaneTerms<R> {
    slots: [LaneTerm<R>; MOST_TERMS],
    count: usize,
}

/// The arguments of a term.
pub struct TermArguments<R> {
    pub depth: R,
    pub width: R,
    /// |v_n| [m/s]
    pub normal_speed: R,
    pub normal_acceleration: R,
    pub passes: R,
    pub normal: Vec3<R>,
    pub velocity: Vec3<R>,
}

impl<R: Real> LaneTerms<R> {
    pub fn new() -> Self {
        let none = Factor { group: Group::Froude, low: 0.0, high: 0.0, power: 0.0 };
        let slot = LaneTerm { on: On::Normal, factors: [none; MOST_GROUPS], count: 0, strength: R::zero() };
        Self { slots: [slot; MOST_TERMS], count: 0 }
    }

    /// Sets one lane's terms. Lanes share slots for terms: terms that differ only in their coefficient share a slot,
    /// and all others take a slot each, in a fixed order. If no slot is left for a lane's terms, the lane's strength
    /// becomes NaN, which ends its episode.
    pub fn set_lane(&mut self, lane: usize, terms: &[Term], bulk_density: f64) {
        (0..self.count).for_each(|k| self.slots[k].strength.set_lane(lane, 0.0));
        for term in terms {
            let factors = term.factors().unwrap_or_default();
            let mut own = LaneTerms::<R>::new().slots[0];
            own.on = term.on;
            own.count = factors.len().min(MOST_GROUPS);
            for (place, (group, power, [low, high])) in own.factors.iter_mut().zip(factors) {
                *place = Factor { group, low, high, power };
            }
            let alike = |s: &LaneTerm<R>| s.on == own.on && s.count == own.count && s.factors == own.factors;
            let scale = if term.on == On::Law { 1.0 } else { bulk_density * GRAVITY };
            let strength = term.coefficient * scale;
            match self.slots[..self.count].iter().position(alike) {
                Some(k) => {
                    let known = self.slots[k].strength.lane(lane);
                    self.slots[k].strength.set_lane(lane, known + strength);
                }
                None if self.count < MOST_TERMS => {
                    own.strength.set_lane(lane, strength);
                    self.slots[self.count] = own;
                    self.count += 1;
                }
                None => self.slots[0].strength.set_lane(lane, f64::NAN),
            }
        }
    }

    #[inline(always)]
    pub fn any(&self) -> bool {
        self.count > 0
    }

    /// Pressure [Pa] against the leading face, stress against the tangential velocity, and the factor on the law's own
    /// stress.
    #[inline(always)]
    pub fn stress(&self, piece: &TermArguments<R>) -> (R, R, R) {
        let (mut normal, mut tangential, mut share) = (R::zero(), R::zero(), R::one());
        for slot in &self.slots[..self.count] {
            let mut product = if slot.on == On::Law { slot.strength } else { slot.strength * piece.depth };
            for factor in &slot.factors[..slot.count] {
                let at = group(factor, piece).clamp(R::splat(factor.low), R::splat(factor.high));
                product = product * power(at, factor.power);
            }
            match slot.on {
                On::Normal => normal += product,
                On::Tangential => tangential += product,
                On::Law => share += product,
            }
        }
        let speed = piece.normal_speed;
        let rest = R::splat(REST_SPEED * REST_SPEED);
        (normal * speed / speed.mul_add(speed, rest).sqrt(), tangential, share.max(R::zero()))
    }

    /// Unit vector against the tangential velocity; near rest its length falls to 0.
    #[inline(always)]
    pub fn against_slip(n: Vec3<R>, v: Vec3<R>) -> Vec3<R> {
        let along = v - n * n.dot(v);
        along * (-R::one() / (along.norm_squared() + R::splat(REST_SPEED * REST_SPEED)).sqrt())
    }
}

impl<R: Real> Default for LaneTerms<R> {
    fn default() -> Self {
        Self::new()
    }
}

/// A group's value. Small numbers in the denominators keep it finite; the term's range limits it to less.
#[inline(always)]
fn group<R: Real>(factor: &Factor, piece: &TermArguments<R>) -> R {
    let gravity = R::splat(1.0 / GRAVITY);
    let v = &piece.velocity;
    let vertical = || -v.z / (v.norm_squared() + R::splat(1e-24)).sqrt();
    let cosine = |sine: R| (R::one() - sine * sine).max(R::zero()).sqrt();
    let attack = || piece.normal_speed / (v.norm_squared() + R::splat(1e-24)).sqrt();
    match factor.group {
        Group::Froude => piece.normal_speed * piece.normal_speed * gravity / piece.depth.max(R::splat(1e-6)),
        Group::DepthOverWidth => {
            let over = piece.depth / piece.width.max(R::splat(1e-9));
            R::select(R::zero().lt(piece.width), over, R::splat(factor.high))
        }
        Group::Acceleration => piece.normal_acceleration * gravity,
        Group::Passes => piece.passes,
        Group::SinGamma => vertical(),
        Group::CosGamma => cosine(vertical()),
        Group::CosBeta => piece.normal.z.abs(),
        Group::SinBeta => cosine(piece.normal.z),
        Group::Wall => R::splat(factor.high),
        Group::WholeFroude => v.norm_squared() * gravity / piece.width.max(R::splat(1e-9)),
        Group::SinAttack => attack(),
        Group::CosAttack => cosine(attack()),
        Group::Saturation => piece.depth / (piece.depth + piece.width).max(R::splat(1e-9)),
        Group::GrainOverWidth | Group::Curvature => R::zero(),
    }
}

/// x^power. If the power is a multiple of a quarter, roots and products give the result. Other powers are computed lane
/// by lane, which is slow.
#[inline(always)]
fn power<R: Real>(x: R, power: f64) -> R {
    let quarters = power * 4.0;
    if quarters.fract() != 0.0 {
        let mut powered = x;
        for lane in 0..R::LANES {
            powered.set_lane(lane, x.lane(lane).powf(power));
        }
        return powered;
    }
    let count = quarters.abs() as usize;
    let (base, times) = if count.is_multiple_of(4) {
        (x, count / 4)
    } else if count.is_multiple_of(2) {
        (x.sqrt(), count / 2)
    } else {
        (x.sqrt().sqrt(), count)
    };
    let mut product = R::one();
    for _ in 0..times {
        product = product * base;
    }
    if quarters < 0.0 { R::one() / product } else { product }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn term(text: &str) -> Term {
        toml::from_str(text).unwrap()
    }

    #[test]
    fn powers_are_powers() {
        for exponent in [-1.5, -1.0, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 2.0, 0.3] {
            for x in [0.01, 0.7, 3.0] {
                let ours: f64 = power(x, exponent);
                assert!((ours / f64::powf(x, exponent) - 1.0).abs() < 1e-12, "{x}^{exponent}: {ours}");
            }
        }
    }

    #[test]
    fn a_share_of_the_law_is_its_formula() {
        let text = "on = \"law\"\ncoefficient = -0.5\n\
                    groups = { whole_froude = 0.5, sin_attack = 2.0, cos_attack = 1.0, saturation = 1.0 }\n\
                    range = { whole_froude = [0.0, 9.0], sin_attack = [0.0, 1.0], cos_attack = [0.0, 1.0], saturation = [0.0, 1.0] }";
        let mut terms = LaneTerms::<f64>::new();
        terms.set_lane(0, &[term(text)], 640.0);
        let piece = TermArguments {
            depth: 0.03,
            width: 0.025,
            normal_speed: 0.3,
            normal_acceleration: 0.0,
            passes: 0.0,
            normal: Vec3::new(0.0, 0.0, -1.0),
            velocity: Vec3::new(0.4, 0.0, -0.3),
        };
        let expected = 1.0 - 0.5 * (0.25f64 / (GRAVITY * 0.025)).sqrt() * 0.36 * 0.8 * (0.03 / 0.055);
        let (normal, tangential, share) = terms.stress(&piece);
        assert_eq!((normal, tangential), (0.0, 0.0));
        assert!((share / expected - 1.0).abs() < 1e-9, "{share} {expected}");
    }

    #[test]
    fn a_term_is_its_formula() {
        let text = "on = \"normal\"\ncoefficient = 5.0\ngroups = { froude = 0.75, depth_over_width = -0.25 }\n\
                    range = { froude = [0.0, 9.0], depth_over_width = [0.01, 9.0] }";
        let mut terms = LaneTerms::<f64>::new();
        terms.set_lane(0, &[term(text)], 640.0);
        let piece = TermArguments {
            depth: 0.03,
            width: 0.025,
            normal_speed: 0.5,
            normal_acceleration: 0.0,
            passes: 0.0,
            normal: Vec3::new(0.6, 0.0, -0.8),
            velocity: Vec3::new(0.3, 0.0, -0.4),
        };
        let froude: f64 = 0.25 / (GRAVITY * 0.03);
        let expected = 5.0 * 640.0 * GRAVITY * 0.03 * froude.powf(0.75) * 1.2f64.powf(-0.25);
        assert!((terms.stress(&piece).0 / expected - 1.0).abs() < 1e-6);
    }
}
