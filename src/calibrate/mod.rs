//! The scale of a user's sand from one slow vertical penetration of a horizontal plate.
//!
//! Force over depth is a line through the origin, F = ζ z A (Li et al. 2012, section 2: linear fit with zero
//! intercept), so ζ is one least-squares slope. Samples of a force log are not independent of each other. So the
//! confidence interval is computed by leaving out one stretch of depth at a time (jackknife), and not from the scatter
//! of single samples.

use sandgait_base::{error, student};
use sandgait_plot as plot;
use sandgait_sand as sand;
use sandgait_table as table;

pub mod figure;
mod fitted_sand;
pub mod pressure_law;
pub mod pushes;
pub mod read;

use crate::error::{Error, Result};
use crate::sand::law::agarwal2023;

/// Number of stretches of depth that are left out one by one. Our choice: few and long, so that their noise is nearly
/// independent. With this number the 95 % interval covers the truth in 94 % of simulated tests with independent noise,
/// in 92 % with noise correlated over 5 of 200 samples and in 89 % over 10 (12 stretches: 93, 89 and 83 %).
const STRETCHES: usize = 6;
/// Student's t at 97.5 % with [`STRETCHES`] − 1 degrees of freedom (NIST/SEMATECH e-Handbook, 1.3.6.7.2).
const T_95: f64 = 2.571;
/// A log has at least this number of samples: our choice, four for each stretch. In a test with fewer samples, such as
/// readings by hand, each sample is a stretch of its own.
const LOGGED: usize = 4 * STRETCHES;
/// Least number of samples in a test: our choice, as few as a log has stretches.
const LEAST_SAMPLES: usize = STRETCHES;
/// The uppermost part of the test, where grains still pile up, is left out; this is its share of the greatest depth.
/// Our choice, because Li et al. 2012 also fit the steady state only.
const TRANSIENT: f64 = 0.1;
/// If the line explains less than this share of the variance, the test was not a quasi-static penetration, whose force
/// is proportional to the depth. Our choice; it is below 1 because of noise.
const LEAST_R_SQUARED: f64 = 0.8;

/// The plate of Li et al. 2012, section 2: 3.8 × 2.5 cm [m²].
pub const PLATE: f64 = 0.038 * 0.025;
/// A plate below 0.1 mm² or above 1 m² has a wrong unit: our choice.
const AREAS: std::ops::RangeInclusive<f64> = 1e-7..=1.0;

/// Results of a penetration test.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Calibration {
    /// The sand's scale ζ = α_z(0, π/2) [N/cm³].
    pub zeta: f64,
    /// Its 95 % confidence interval.
    pub zeta_interval: [f64; 2],
    /// ξ_n of `agarwal2023` [N/cm³]: ζ/0.87574.
    pub xi_n: f64,
    pub xi_n_interval: [f64; 2],
    /// Share of the force's variance that the line explains.
    pub r_squared: f64,
    /// Depth at which the force of a line with free intercept is 0 [m]; about 0 if depth was counted from the surface.
    pub surface_offset: f64,
    /// Number of samples in the fit.
    pub samples: usize,
    /// Area of the plate [m²].
    pub area: f64,
    /// Warnings about the result.
    pub cautions: Vec<String>,
}

/// Fits `depth` [m, positive down] and `force` [N, positive up on the plate] of a plate of `area` [m²].
pub fn calibrate(depth: &[f64], force: &[f64], area: f64) -> Result<Calibration> {
    crate::error::check_range("area", area, AREAS)?;
    let greatest = depth.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    refuse(depth, force, greatest)?;
    let from = TRANSIENT * greatest;
    let kept: Vec<[f64; 2]> =
        depth.iter().zip(force).filter(|(z, _)| **z >= from * (1.0 - 1e-9)).map(|(z, f)| [*z, *f]).collect();
    if kept.len() < LEAST_SAMPLES {
        return Err(refused(format!("{} samples below {:.1} mm; {LEAST_SAMPLES} are needed", kept.len(), 1e3 * from)));
    }
    let slope = through_origin(kept.iter());
    let mean = kept.iter().map(|p| p[1]).sum::<f64>() / kept.len() as f64;
    let total: f64 = kept.iter().map(|p| (p[1] - mean).powi(2)).sum();
    let left: f64 = kept.iter().map(|p| (p[1] - slope * p[0]).powi(2)).sum();
    let r_squared = 1.0 - left / total;
    if slope <= 0.0 || r_squared.is_nan() || r_squared < LEAST_R_SQUARED {
        return Err(refused(format!(
            "force does not grow in proportion to depth (r² = {r_squared:.2}, slope {slope:.3} N/m): \
             not a slow vertical penetration counted from the surface"
        )));
    }
    let half = half_width(&kept, greatest);
    let zeta = slope / area * 1e-6;
    let interval = [(slope - half) / area * 1e-6, (slope + half) / area * 1e-6];
    let (free_slope, intercept) = free_line(&kept);
    let surface_offset = -intercept / free_slope;
    Ok(Calibration {
        zeta,
        zeta_interval: interval,
        xi_n: zeta / agarwal2023::PENETRATION,
        xi_n_interval: interval.map(|z| z / agarwal2023::PENETRATION),
        r_squared,
        surface_offset,
        samples: kept.len(),
        area,
        cautions: cautions(zeta, greatest, surface_offset, area),
    })
}

fn refused(reason: impl Into<String>) -> Error {
    Error::invalid("penetration test", reason)
}

/// Refuses data that cannot be fitted. The limits are our choice: a depth of more than 5 m has a wrong unit; because of
/// noise, a tenth of the forces may be negative, and a tenth of the steps may go up by more than 0.01 % of the depth.
fn refuse(depth: &[f64], force: &[f64], greatest: f64) -> Result<()> {
    if depth.len() < LEAST_SAMPLES {
        return Err(refused(format!("{} samples; at least {LEAST_SAMPLES} are needed", depth.len())));
    }
    if greatest <= 0.0 {
        return Err(refused("no depth is positive: depth counts downward from the surface"));
    }
    if greatest > 5.0 {
        return Err(refused(format!("depth reaches {greatest:.3} m: is the unit right? (--depth-unit)")));
    }
    let pushing = force.iter().zip(depth).filter(|(f, z)| **z > TRANSIENT * greatest && **f > 0.0).count();
    let deep = depth.iter().filter(|z| **z > TRANSIENT * greatest).count();
    if 10 * pushing < 9 * deep {
        return Err(refused(
            "force is not positive while the plate goes down: it must be positive upward on the plate",
        ));
    }
    let falling = depth.windows(2).filter(|w| w[1] < w[0] - 1e-4 * greatest).count();
    if 10 * falling > depth.len() {
        return Err(refused("depth decreases again: leave out the rows of the way up"));
    }
    Ok(())
}

/// The limits are our choice: a tenth of the depth is left out of the fit anyway; those of ζ are about half of the
/// least and 1.6 times the greatest of the media in `src/sand/media.rs`.
fn cautions(zeta: f64, greatest: f64, offset: f64, area: f64) -> Vec<String> {
    let mut cautions = Vec::new();
    if offset.abs() > 0.1 * greatest {
        cautions.push(format!(
            "a line with free start begins at {:.1} mm depth: is depth zero at the surface?",
            1e3 * offset
        ));
    }
    if greatest < area.sqrt() / 2.0 {
        cautions.push("the plate went less than half its size deep: the start weighs heavily".into());
    }
    if !(0.05..=5.0).contains(&zeta) {
        cautions
            .push(format!("ζ = {zeta:.3} N/cm³ is outside all published media (0.11 to 3.05): check units and area"));
    }
    cautions
}

fn through_origin<'a>(points: impl Iterator<Item = &'a [f64; 2]>) -> f64 {
    let (top, bottom) = points.fold((0.0, 0.0), |(t, b), [z, f]| (t + z * f, b + z * z));
    top / bottom
}

/// Slope and intercept.
fn free_line(points: &[[f64; 2]]) -> (f64, f64) {
    let n = points.len() as f64;
    let [mz, mf] = [0, 1].map(|i| points.iter().map(|p| p[i]).sum::<f64>() / n);
    let (top, bottom) =
        points.iter().fold((0.0, 0.0), |(t, b), [z, f]| (t + (z - mz) * (f - mf), b + (z - mz).powi(2)));
    (top / bottom, mf - top / bottom * mz)
}

/// Half of the slope's 95 % confidence interval.
fn half_width(points: &[[f64; 2]], greatest: f64) -> f64 {
    if points.len() >= LOGGED {
        return T_95 * slope_error(points, greatest);
    }
    let without = |k: usize| through_origin(points.iter().enumerate().filter(|(i, _)| *i != k).map(|(_, p)| p));
    let slopes: Vec<f64> = (0..points.len()).map(without).collect();
    student::two_sided_95(points.len() as f64 - 1.0) * jackknife(&slopes)
}

/// Standard error of the slope from leaving out one stretch of depth at a time.
fn slope_error(points: &[[f64; 2]], greatest: f64) -> f64 {
    let from = TRANSIENT * greatest;
    let stretch = |z: f64| (((z - from) / (greatest - from) * STRETCHES as f64) as usize).min(STRETCHES - 1);
    let without = |k: usize| through_origin(points.iter().filter(|p| stretch(p[0]) != k));
    let slopes: Vec<f64> = (0..STRETCHES).map(without).filter(|s| s.is_finite()).collect();
    jackknife(&slopes)
}

/// Standard error of a value by the jackknife: `without` are the values with one part of the data left out.
fn jackknife(without: &[f64]) -> f64 {
    let count = without.len() as f64;
    let mean = without.iter().sum::<f64>() / count;
    ((count - 1.0) / count * without.iter().map(|x| (x - mean).powi(2)).sum::<f64>()).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten readings by hand, each off by up to `noise` N, of a sand with ζ = 0.3 N/cm³.
    fn readings(seed: u64, noise: f64) -> (Vec<f64>, Vec<f64>) {
        let mut random = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        let mut unit = || {
            random ^= random << 13;
            random ^= random >> 7;
            random ^= random << 17;
            (random >> 11) as f64 / (1_u64 << 53) as f64
        };
        let depth: Vec<f64> = (1..=10).map(|k| 5e-3 * f64::from(k)).collect();
        let force = depth.iter().map(|z| 0.3e6 * z * 9.5e-4 + noise * (2.0 * unit() - 1.0)).collect();
        (depth, force)
    }

    /// Ten readings are enough, and their interval covers the truth about as often as it says.
    #[test]
    fn ten_readings_by_hand_calibrate() {
        let covers = |seed: u64| {
            let (depth, force) = readings(seed, 0.4);
            let c = calibrate(&depth, &force, 9.5e-4).unwrap();
            assert_eq!(c.samples, 10);
            (c.zeta_interval[0]..=c.zeta_interval[1]).contains(&0.3)
        };
        let covered = (0..1000).filter(|seed| covers(*seed)).count();
        assert!((910..=985).contains(&covered), "{covered} of 1000");
    }

    #[test]
    fn too_few_readings_are_refused() {
        let (depth, force) = readings(1, 0.1);
        let error = calibrate(&depth[..5], &force[..5], 9.5e-4).unwrap_err().to_string();
        assert_eq!(error, "penetration test: 5 samples; at least 6 are needed");
    }
}
