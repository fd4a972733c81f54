//! Fits a few numbers, which all wheels in one sand share, to measured steady motions.

use super::data::{SteadyState, Wheel};
use crate::error::Result;
use crate::parallel;
use crate::progress::Latch;
use crate::sand::intruder::{DepthOrLoad, Trial, compute};
use crate::sand::{Law, Mechanisms, Medium, SandDescription};
use nalgebra::{DMatrix, DVector};

/// Errors that give a residual of 1. The first three are shares of the load: the error of Fx and Fy at the measured
/// sinkage, of Fz at the measured sinkage, and of Fx and Fy under the measured load. The last is the error of the
/// sinkage [m]. Our choice, because a good model has about these errors.
const TOLERANCES: [f64; 4] = [0.08, 0.15, 0.08, 0.0035];
/// Step in depth [m] for the numerical stiffness dF/dz, which converts a missing vertical force into sinkage: our
/// choice, small compared with sinkages, large compared with rounding.
const STEP: f64 = 5e-4;
/// Least stiffness [N/m] in this conversion, so that a wheel without support counts as an error of a few centimetres:
/// our choice.
const SOFTEST: f64 = 200.0;
/// Largest residual: our choice, so that rows without support do not outweigh all others.
const LARGEST: f64 = 8.0;
/// Friction of sand on sand, for wheels that carry sand between their teeth: tan 35°, within the 30° to 40° of dry
/// sands (angle of repose 29°). It is not fitted, because rows at slip ratios ≤ 0 hardly distinguish 0.55 from 0.9.
const SAND_ON_SAND: f64 = 0.70;
/// μ_s of a smooth wheel and its standard deviation. The data do not contain μ_s, so the deviation is wide enough for
/// polished to rough plates.
const SMOOTH: [f64; 2] = [0.45, 0.30];

/// The value of `slip_bearing` from Vesic's formula; it is not fitted. Our form of this mechanism was chosen for the
/// wheels, and the prediction that is called "not fitted" contains it.
pub const BEARING: f64 = 1.0;

/// The fitted numbers: ζ [N/cm³], `depth_power`, `skid_loss` and `graze_loss`, which all wheels share, and μ_s, which
/// all wheels without carried sand share.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    pub zeta: f64,
    pub depth_power: f64,
    pub skid_loss: f64,
    pub graze_loss: f64,
    pub friction: f64,
}

/// Least and greatest values, in the order of the fields. Our choice: wide, because they must not limit a fit.
const LOW: [f64; 5] = [0.1, -0.6, 0.0, 0.0, 0.15];
const HIGH: [f64; 5] = [4.0, 1.0, 6.0, 1.0, 0.95];
/// Values from which a fit starts: our choice, typical for dry sand.
const START: [f64; 5] = [0.85, -0.2, 0.6, 0.5, SMOOTH[0]];

impl Parameters {
    fn from_vector(v: &DVector<f64>) -> Self {
        let [zeta, depth_power, skid_loss, graze_loss, friction] = std::array::from_fn(|k| v[k]);
        Self { zeta, depth_power, skid_loss, graze_loss, friction }
    }

    /// Rounded to the accuracy of the data, so that a file has the same text on every machine.
    pub fn rounded(&self) -> Self {
        let Self { zeta, depth_power, skid_loss, graze_loss, friction } = *self;
        let [zeta, depth_power, skid_loss, graze_loss, friction] =
            [zeta, depth_power, skid_loss, graze_loss, friction].map(|x| (x * 1e3).round() / 1e3);
        Self { zeta, depth_power, skid_loss, graze_loss, friction }
    }

    /// The sand of a wheel.
    pub fn sand(&self, wheel: &Wheel, name: &str, source: &str) -> Result<SandDescription> {
        let mechanisms = Mechanisms {
            depth_power: self.depth_power,
            skid_loss: self.skid_loss,
            graze_loss: self.graze_loss,
            slip_bearing: BEARING,
            friction_clip: 1.0 / if wheel.carries_sand { SAND_ON_SAND } else { self.friction },
            ..Mechanisms::PLAIN
        };
        let plain = SandDescription::plain(&Medium::generic(self.zeta)?);
        Ok(SandDescription {
            name: name.into(),
            source: source.into(),
            law: Law::Agarwal2023,
            bulk_density: super::DENSITY,
            mechanisms,
            ..plain
        })
    }
}

fn within(v: DVector<f64>) -> DVector<f64> {
    v.map_with_location(|k, _, x| x.clamp(LOW[k], HIGH[k]))
}

/// Least squares over `rows` of each wheel (Levenberg–Marquardt with numerical derivatives). The error of a stop is returned.
pub fn fit(wheels: &[Wheel], rows: &[Vec<SteadyState>], latch: &Latch) -> Result<Parameters> {
    let residuals = |x: &DVector<f64>| residuals(wheels, rows, x, latch);
    let mut x = DVector::from_row_slice(&START);
    let mut r = residuals(&x)?;
    let mut damping = 1e-2;
    for _ in 0..40 {
        let mut jacobian = DMatrix::zeros(r.len(), x.len());
        for k in 0..x.len() {
            let mut moved = x.clone();
            moved[k] += 2e-3;
            jacobian.set_column(k, &((residuals(&moved)? - &r) / 2e-3));
        }
        let (normal, gradient) = (jacobian.transpose() * &jacobian, jacobian.transpose() * &r);
        let before = r.norm_squared();
        loop {
            let mut damped = normal.clone();
            (0..x.len()).for_each(|k| damped[(k, k)] *= 1.0 + damping);
            let step = damped.lu().solve(&gradient).unwrap_or_else(|| DVector::zeros(x.len()));
            let next = within(&x - step);
            let after = residuals(&next)?;
            if after.norm_squared() < before {
                (x, r) = (next, after);
                damping = (damping / 5.0).max(1e-9);
                break;
            }
            damping *= 5.0;
            if damping > 1e6 {
                break;
            }
        }
        if before - r.norm_squared() < 1e-7 * before {
            break;
        }
    }
    Ok(Parameters::from_vector(&x))
}

/// Residuals: Fx, Fy, Fz at the measured sinkage; the sinkage, Fx and Fy under the measured load (to first order); and
/// the deviation of the friction from its expected value.
fn residuals(wheels: &[Wheel], rows: &[Vec<SteadyState>], x: &DVector<f64>, latch: &Latch) -> Result<DVector<f64>> {
    let parameters = Parameters::from_vector(x);
    let mut all = Vec::new();
    for (wheel, rows) in wheels.iter().zip(rows) {
        let sand = parameters.sand(wheel, "", "")?;
        let mean = rows.iter().map(|r| r.force[2]).sum::<f64>() / rows.len().max(1) as f64;
        let each = |row: &SteadyState| if latch.stopped() { [0.0; 6] } else { of_row(wheel, &sand, row, mean) };
        all.extend(parallel::map(rows, each).into_iter().flatten());
    }
    latch.error().map_or(Ok(()), Err)?;
    all.push((parameters.friction - SMOOTH[0]) / SMOOTH[1]);
    Ok(DVector::from_vec(all))
}

fn of_row(wheel: &Wheel, sand: &SandDescription, row: &SteadyState, load: f64) -> [f64; 6] {
    let at = |depth: f64| compute(&wheel.body, sand, &Trial { given: DepthOrLoad::Depth(depth), ..row.trial }).force;
    let (here, below) = (at(row.depth), at(row.depth + STEP));
    let off = [0, 1, 2].map(|k| here[k] - row.force[k]);
    let slope = [0, 1, 2].map(|k| (below[k] - here[k]) / STEP);
    let sinkage = -off[2] / slope[2].max(SOFTEST);
    let carried = [0, 1].map(|k| off[k] + slope[k] * sinkage);
    let [side, up, under, deep] = TOLERANCES;
    let scaled = [
        off[0] / (side * load),
        off[1] / (side * load),
        off[2] / (up * load),
        sinkage / deep,
        carried[0] / (under * load),
        carried[1] / (under * load),
    ];
    scaled.map(|r| r.clamp(-LARGEST, LARGEST))
}
