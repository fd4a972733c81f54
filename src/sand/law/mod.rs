//! Resistive force laws: stress per depth on a small flat segment, free of trigonometry.
//!
//! * [`li2013`]: the resistive force theory of Li, Zhang & Goldman: nine coefficients for each medium.
//! * [`penetration_drag`]: its baseline, one-dimensional penetration and drag.
//! * [`agarwal2023`]: three-dimensional RFT: one universal polynomial, one number for each medium.
//!
//! A law is a type that implements [`StressLaw`]. Hot loops have it as a type parameter and match on
//! [`super::contact::LawCoefficients`] once, before the loop. So a new law does not make the others slower.

pub mod agarwal2023;
pub mod li2013;
pub mod penetration_drag;

pub use agarwal2023::SpatialTable;
pub use li2013::PlanarTable;
pub use penetration_drag::PenetrationDrag;

use super::media::Medium;
use crate::error::{Error, Result};
use crate::number::{Mat3, Real, Vec3};
use serde::{Deserialize, Serialize};

/// Which law gives the stress.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Law {
    /// Li, Zhang & Goldman, Science 339:1408 (2013), eq. S1-S2, evaluated in the vertical plane of the motion.
    #[serde(rename = "li2013")]
    Li2013,
    /// The baseline of Li, Zhang & Goldman 2012, section 3: vertical penetration and horizontal drag, independent.
    #[serde(rename = "penetration-drag-1d")]
    PenetrationDrag1d,
    /// Agarwal, Goldman & Kamrin, PNAS 120:e2214017120 (2023): 3D-RFT.
    #[serde(rename = "agarwal2023")]
    Agarwal2023,
}

impl Law {
    pub const ALL: [Law; 3] = [Law::Li2013, Law::PenetrationDrag1d, Law::Agarwal2023];

    pub fn name(self) -> &'static str {
        match self {
            Law::Li2013 => "li2013",
            Law::PenetrationDrag1d => "penetration-drag-1d",
            Law::Agarwal2023 => "agarwal2023",
        }
    }

    pub fn named(name: &str) -> Result<Self> {
        let known = Self::ALL.map(Law::name);
        Self::ALL.into_iter().find(|l| l.name() == name).ok_or_else(|| Error::unknown("law", name, &known))
    }
}

/// How a segment moves, regularised at rest with the speed scale v0 (see [`super::contact::Regularization`]).
#[derive(Clone, Copy)]
pub struct Motion<R> {
    /// Velocity [m/s].
    pub v: Vec3<R>,
    /// 1/√(v² + v0²) [s/m].
    pub inverse_speed: R,
    /// v²/(v² + v0²): 0 at rest, 1 when moving.
    pub moving: R,
    /// 1/(v² + 1e-24) [s²/m²]: 1/v² that stays finite at rest; (1e-12 m/s)² is far below creep.
    pub inverse_square: R,
}

/// The numbers of a law, with one medium in each lane.
pub trait StressLaw<R: Real>: Copy {
    /// Sets the medium of lane `lane`.
    fn set_lane(&mut self, lane: usize, medium: &Medium);

    /// Stress per depth [N/m³] on a thin segment with unit normal `n`, both sides together. `n` and −`n` give the same
    /// stress.
    fn stress(&self, n: Vec3<R>, motion: &Motion<R>) -> Vec3<R>;

    /// Mean of [`StressLaw::stress`] over `normals`. This default is the stress for the mean normal: exact to first
    /// order in the normals' deviation from the mean, and fully exact for laws that do not depend on the normal.
    #[inline(always)]
    fn mean_stress(&self, normals: &Normals<R>, motion: &Motion<R>) -> Vec3<R> {
        self.stress(normals.unit, motion)
    }
}

/// The normals of a curved face.
#[derive(Clone, Copy)]
pub struct Normals<R> {
    /// Unit vector along the mean normal.
    pub unit: Vec3<R>,
    /// 1 − length of the mean normal.
    pub spread: R,
    /// Means of the products of the normals' components: xx, yy, zz; the next field: yz, xz, xy.
    pub squares: Vec3<R>,
    pub products: Vec3<R>,
}

impl<R: Real> Normals<R> {
    /// From the normals' mean `mean`, which must not be 0, and the means of their products.
    #[inline(always)]
    pub fn new(mean: Vec3<R>, squares: Vec3<R>, products: Vec3<R>) -> Self {
        let squared = mean.norm_squared();
        let inverse = R::one() / (squared + R::splat(1e-20)).sqrt(); // never infinite
        let spread = (R::one() - squared * inverse).max(R::zero());
        Self { unit: mean * inverse, spread, squares, products }
    }

    /// The same as [`Self::new`], for means in axes that are the columns of `axes`.
    #[inline(always)]
    pub fn turned(mean: Vec3<R>, squares: Vec3<R>, products: Vec3<R>, axes: &Mat3<R>) -> Self {
        let (s, p) = (squares, products);
        let products = Mat3::new(Vec3::new(s.x, p.z, p.y), Vec3::new(p.z, s.y, p.x), Vec3::new(p.y, p.x, s.z));
        // Rows of axes · products, and of the axes.
        let (half, rows) = (axes.compose(&products).transposed(), axes.transposed());
        let squares = Vec3::new(half.x.dot(rows.x), half.y.dot(rows.y), half.z.dot(rows.z));
        let products = Vec3::new(half.y.dot(rows.z), half.x.dot(rows.z), half.x.dot(rows.y));
        Self::new(axes.apply(mean), squares, products)
    }
}
