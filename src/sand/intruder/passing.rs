//! The passing part of `sliding_face`: the stress that an earlier motion has left on a plate.
//!
//! When the direction of motion changes, a plate's stress per depth q is still that of the motion before, and goes to
//! the steady pressure P of the new one: q = P + e, de/dt = −(|v_t|/ℓ + |v_n|/δ) e, δ = κ ℓ. The force per depth is the
//! steady one and −e (n + μ_e t̂), t̂ along the tangential velocity. For the derivation see
//! [`crate::mechanism_laws::SlidingFace`]; form and numbers are ours, from simulated grains of 4 mm.

use super::PlatedBody;
use super::trials::{Trial, pressures};
use crate::SandDescription;
use crate::error::{Error, Result, check_range};

/// ℓ over the diameter of a grain: 6.1 mm over 4 mm, from the rate at which the lift of a lying plate fades
/// (`tests/data/drag/flat_0.04_0.05_20mm.csv`). That it grows with the diameter is not proved: one size was simulated.
const WAY: f64 = 1.5;

/// The stress on each plate of a body.
#[derive(Clone, Debug)]
pub(super) struct Passing {
    /// ℓ and δ [m].
    ways: [f64; 2],
    /// q of each plate [N/m³]; empty before the first moment.
    stress: Vec<f64>,
    /// e of each plate [N/m³] at the present moment.
    pub(super) excess: Vec<f64>,
}

impl Passing {
    /// `diameter` of a grain [m]. The bounds are those of dust and cobbles: our choice, which catches wrong units.
    pub(super) fn new(sand: &SandDescription, diameter: f64) -> Result<Self> {
        let way = WAY * check_range("grain-size", diameter, 1e-5..=0.2)?;
        let kappa = sand.mechanisms.sliding_face;
        if kappa == 0.0 {
            return Err(Error::invalid("grain-size", "has an effect only in sand with the mechanism sliding_face"));
        }
        Ok(Self { ways: [way, way * kappa], stress: Vec::new(), excess: Vec::new() })
    }

    /// Goes on by `time` [s] in the motion of `trial`. Plates at rest keep their stress.
    pub(super) fn advance(&mut self, body: &PlatedBody, sand: &SandDescription, trial: &Trial, time: f64) {
        let steady = pressures(body, sand, trial);
        if self.stress.is_empty() {
            self.stress = steady.iter().map(|p| p.unwrap_or_default()).collect();
        }
        self.excess.resize(self.stress.len(), 0.0);
        let plates = body.plates.iter().zip(steady);
        for ((stress, excess), (plate, steady)) in self.stress.iter_mut().zip(&mut self.excess).zip(plates) {
            let Some(steady) = steady else { continue };
            let v = trial.velocity_at(plate.center);
            let along = plate.normal.dot(v);
            let aside = (v - plate.normal * along).norm_squared().sqrt();
            let rate = aside / self.ways[0] + along.abs() / self.ways[1];
            *excess = (*stress - steady) * (-rate * time).exp();
            *stress = steady + *excess;
        }
    }

    /// Plates above the surface, `surface` [m] above the body's origin, have no stress.
    pub(super) fn leave(&mut self, body: &PlatedBody, surface: f64) {
        let plates = body.plates.iter().zip(&mut self.stress);
        plates.filter(|(p, _)| p.center.z - p.rise() >= surface).for_each(|(_, stress)| *stress = 0.0);
    }
}
