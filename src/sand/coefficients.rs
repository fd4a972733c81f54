//! Coefficients of the stress per depth.

use serde::{Deserialize, Serialize};

/// N/cm³ to N/m³.
pub(crate) const PER_CM3: f64 = 1e6;

/// Fourier coefficients of the stress per depth, in N/m³; the names are those of Li, Zhang & Goldman, Science
/// 339:1408 (2013), supplementary table S2 (first index: multiples of 2β, second: of γ; `bm11`, `cm11` stand for
/// B₋₁₁, C₋₁₁).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Coefficients {
    pub a00: f64,
    pub a10: f64,
    pub b11: f64,
    pub b01: f64,
    pub bm11: f64,
    pub c11: f64,
    pub c01: f64,
    pub cm11: f64,
    pub d10: f64,
}

impl Coefficients {
    const fn per_cm3(c: [f64; 9]) -> Self {
        Self {
            a00: c[0] * PER_CM3,
            a10: c[1] * PER_CM3,
            b11: c[2] * PER_CM3,
            b01: c[3] * PER_CM3,
            bm11: c[4] * PER_CM3,
            c11: c[5] * PER_CM3,
            c01: c[6] * PER_CM3,
            cm11: c[7] * PER_CM3,
            d10: c[8] * PER_CM3,
        }
    }

    /// The generic set, to be multiplied by a medium's ζ [N/cm³]. Source: Science 2013, table S2.
    pub const GENERIC: Self = Self::per_cm3([0.206, 0.169, 0.212, 0.358, 0.055, -0.124, 0.253, 0.007, 0.088]);
    /// Loosely packed 1 mm poppy seeds. Source: public implementations of the 2013 data, all derived from one
    /// implementation; the numbers are probably right, but not confirmed.
    pub const POPPY_LOOSE: Self = Self::per_cm3([0.051, 0.047, 0.053, 0.083, 0.020, -0.026, 0.057, 0.0, 0.025]);
    /// Closely packed 1 mm poppy seeds. Source and certainty as for [`Self::POPPY_LOOSE`].
    pub const POPPY_CLOSE: Self = Self::per_cm3([0.094, 0.092, 0.092, 0.151, 0.035, -0.039, 0.086, 0.018, 0.046]);

    /// Every coefficient times `factor`.
    pub fn scaled(&self, factor: f64) -> Self {
        Self::from_array(self.to_array().map(|c| c * factor))
    }

    /// In the order A00 A10 B11 B01 B₋₁₁ C11 C01 C₋₁₁ D10.
    pub fn to_array(&self) -> [f64; 9] {
        [self.a00, self.a10, self.b11, self.b01, self.bm11, self.c11, self.c01, self.cm11, self.d10]
    }

    /// The inverse of [`Self::to_array`].
    pub fn from_array(c: [f64; 9]) -> Self {
        let [a00, a10, b11, b01, bm11, c11, c01, cm11, d10] = c;
        Self { a00, a10, b11, b01, bm11, c11, c01, cm11, d10 }
    }

    /// α_z(0, π/2) [N/m³]: a horizontal plate pushed straight down. In N/cm³ this is the scale ζ.
    pub fn penetration(&self) -> f64 {
        self.a00 + self.a10 + self.b01 + self.b11 + self.bm11
    }

    /// α_z(0, −π/2) [N/m³], negative: a horizontal plate pulled straight up.
    pub fn extraction(&self) -> f64 {
        self.a00 + self.a10 - self.b01 - self.b11 - self.bm11
    }

    /// α_x(π/2, 0) [N/m³]: a vertical plate dragged horizontally.
    pub fn drag(&self) -> f64 {
        self.c01 - self.c11 - self.cm11
    }
}
