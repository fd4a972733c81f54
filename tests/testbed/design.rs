//! How trials are laid out.

use super::Trial;
use rand::Rng;
use rand_xoshiro::Xoshiro256PlusPlus;

/// How trials are laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Design {
    /// Depths are random and independent of the speeds.
    Crossed,
    /// Depth increases with speed: a poor design, in which effects of speed and of depth look alike.
    Covarying,
    /// The same as the crossed design, but all speeds lie within a factor of three.
    Narrow,
}

pub(super) fn design(rng: &mut Xoshiro256PlusPlus, kind: Design) -> Vec<Trial> {
    let mut trials = Vec::new();
    let ground = |rng: &mut Xoshiro256PlusPlus| {
        let again = rng.random_range(0.0..1.0) < 0.35;
        let dx = [0.0, 0.02, 0.04][rng.random_range(0..3)];
        (if again { 2 } else { 1 }, if again { dx } else { 0.0 }, rng.random_range(-0.1..0.1))
    };
    for (shape, xi) in [("L", 45f64), ("revL", -45.0), ("flat", 0.0)] {
        for k in 0..3 {
            let (pass, pass_dx, x_bed) = ground(rng);
            let rates = if kind == Design::Narrow { [4.0, 6.0, 9.0] } else { [0.2, 3.0, 9.0] };
            let rate = rates[k] * rng.random_range(0.7..1.3);
            let wobble = if rng.random_range(0..2) == 0 { 0.0 } else { 0.5 };
            let drawn = [0.02, 0.045, 0.03][rng.random_range(0..3)];
            let hip = if kind == Design::Covarying { [0.045, 0.03, 0.02][k] } else { drawn };
            let (xi, duration) = (xi.to_radians(), 3.5 / rate);
            trials.push(Trial {
                shape,
                xi,
                leg: true,
                hip,
                rate,
                wobble,
                beta: 0.0,
                gamma: 0.0,
                start: 0.0,
                duration,
                pass,
                pass_dx,
                x_bed,
            });
        }
    }
    for (k, (beta, gamma)) in
        [(0.0, 90.0), (0.0, 90.0), (45.0, 45.0), (-45.0, 45.0), (90.0, 0.0), (30.0, -60.0f64)].into_iter().enumerate()
    {
        let (pass, pass_dx, x_bed) = ground(rng);
        let narrow = [0.35, 0.8, 0.4, 0.5, 0.6, 0.7];
        let rates = if kind == Design::Narrow { narrow } else { [0.02, 0.8, 0.1, 0.5, 0.3, 0.2] };
        let rate = rates[k] * rng.random_range(0.7..1.3);
        let start = if gamma <= 0.0 { if gamma < 0.0 { 0.05 } else { 0.03 } } else { 0.0 };
        let wobble = if k % 2 == 1 { 0.45 } else { 0.0 };
        let (beta, gamma) = (f64::to_radians(beta), f64::to_radians(gamma));
        // From 1.6 to 4.8 cm of path between the slowest and the fastest plate.
        let short = if kind == Design::Covarying { 0.32 * f64::ln(0.8 / rate).clamp(0.0, 2.0) } else { 0.0 };
        trials.push(Trial {
            shape: "plate",
            xi: 0.0,
            leg: false,
            hip: 0.0,
            rate,
            wobble,
            beta,
            gamma,
            start,
            duration: 0.048 * (1.0 - short) / rate,
            pass,
            pass_dx,
            x_bed,
        });
    }
    trials
}
