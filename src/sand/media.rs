//! Granular media: stress coefficients with their sources.

use super::law::agarwal2023;
use super::term::Term;
use crate::error::{Error, Result, check_range};
use serde::{Deserialize, Serialize};

/// N/cm³ to N/m³.
const PER_CM3: f64 = 1e6;

/// Fourier coefficients of the stress per depth, in N/m³; names as in Li, Zhang & Goldman, Science 339:1408 (2013),
/// supplementary table S2 (first index: multiples of 2β, second: of γ; `bm11`, `cm11` stand for B₋₁₁, C₋₁₁).
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

    /// The generic set, to be multiplied by a medium's ζ. Source: Science 2013, table S2.
    pub const GENERIC: Self = Self::per_cm3([0.206, 0.169, 0.212, 0.358, 0.055, -0.124, 0.253, 0.007, 0.088]);
    /// Loosely packed 1 mm poppy seeds. Source: one public lineage of implementations of the 2013 data; likely.
    pub const POPPY_LOOSE: Self = Self::per_cm3([0.051, 0.047, 0.053, 0.083, 0.020, -0.026, 0.057, 0.0, 0.025]);
    /// Closely packed 1 mm poppy seeds. Source: as for [`Self::POPPY_LOOSE`].
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

/// One kind of sand.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Medium {
    pub name: String,
    pub coefficients: Coefficients,
    /// Bulk density [kg/m³].
    pub bulk_density: f64,
    /// Where the numbers come from.
    pub source: String,
    /// Laws found in data, added to the stress.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub terms: Vec<Term>,
}

/// Media measured as a whole set: name, coefficients, bulk density [kg/m³], source.
const MEASURED: [(&str, Coefficients, f64, &str); 2] = [
    ("poppy-loose", Coefficients::POPPY_LOOSE, 638.0, "1 mm poppy seeds, loosely packed; the sand of Li et al. 2012"),
    (
        "poppy-close",
        Coefficients::POPPY_CLOSE,
        680.0,
        "1 mm poppy seeds, closely packed; density: our choice, 638 × 0.62/0.58 by volume fraction",
    ),
];

/// Media known by their ζ [N/cm³] alone, on the generic set: name, ζ, bulk density [kg/m³], source. The densities
/// are our choice, handbook values for the material, because the sources give none; plain RFT does not use them.
const SCALED: [(&str, f64, f64, &str); 4] = [
    ("glass-beads", 0.33, 1500.0, "Treers et al. 2021"),
    ("plastic-pellets", 0.111, 560.0, "Treers et al. 2021"),
    ("quikrete-medium", 2.02, 1600.0, "Quikrete medium sand, published ζ"),
    ("quikrete-fine", 3.05, 1600.0, "Quikrete fine mix, published ζ"),
];

impl Medium {
    /// Unless another is given: the sand of Li et al. 2012.
    pub const DEFAULT: &'static str = "poppy-loose";

    /// Names that [`Medium::named`] answers to.
    pub fn names() -> Vec<&'static str> {
        MEASURED.iter().map(|m| m.0).chain(SCALED.iter().map(|m| m.0)).collect()
    }

    /// A medium by its name, `zeta=VALUE` (N/cm³) for the generic set at any scale, or `mu=VALUE,rho=VALUE` for the
    /// scale that `agarwal2023` derives from internal friction and critical density (kg/m³).
    pub fn named(name: &str) -> Result<Self> {
        if name.starts_with("mu=") {
            let (mu, density) = parse_friction(name)?;
            return Self::from_friction(mu, density);
        }
        if let Some(value) = name.strip_prefix("zeta=") {
            let zeta = value.parse().map_err(|_| Error::invalid("medium", format!("{value:?} is no number")))?;
            return Self::generic(zeta);
        }
        let measured = MEASURED.iter().find(|m| m.0 == name).map(|m| (m.1, m.2, m.3));
        let scaled = SCALED.iter().find(|m| m.0 == name).map(|m| (Coefficients::GENERIC.scaled(m.1), m.2, m.3));
        let Some((coefficients, bulk_density, source)) = measured.or(scaled) else {
            let mut known = Self::names();
            known.extend(["zeta=VALUE", "mu=VALUE,rho=VALUE"]);
            return Err(Error::unknown("medium", name, &known));
        };
        Ok(Self { name: name.into(), coefficients, bulk_density, source: source.into(), terms: Vec::new() })
    }

    /// The generic set times `zeta` [N/cm³].
    pub fn generic(zeta: f64) -> Result<Self> {
        // 100 N/cm³ is far stiffer than any published sand (3.05): our choice of a guard against unit slips.
        check_range("zeta", zeta, 1e-3..=100.0)?;
        Ok(Self {
            name: format!("zeta={zeta}"),
            coefficients: Coefficients::GENERIC.scaled(zeta),
            bulk_density: 1500.0, // dry sand, handbook value: our choice
            source: "generic set, Science 2013 table S2, times ζ".into(),
            terms: Vec::new(),
        })
    }

    /// The generic set at the scale that gives `agarwal2023` its ξ_n of friction μ and critical density ρ_c [kg/m³].
    fn from_friction(mu: f64, density: f64) -> Result<Self> {
        // Wider than any granular medium; between these and the fitted range `caution` warns. Our choice.
        check_range("mu", mu, 0.05..=2.0)?;
        check_range("rho", density, 10.0..=20_000.0)?;
        let zeta = agarwal2023::from_friction(mu, density) * agarwal2023::PENETRATION / PER_CM3;
        let source =
            format!("ξ_n from μ = {mu} and ρ_c = {density} kg/m³, Agarwal et al. 2023; generic set at that scale");
        Ok(Self { name: format!("mu={mu},rho={density}"), bulk_density: density, source, ..Self::generic(zeta)? })
    }

    /// One line of warning if `name` asks for more than its source has measured.
    pub fn caution(name: &str) -> Option<String> {
        let (mu, _) = parse_friction(name).ok()?;
        let fitted = agarwal2023::FITTED_FRICTION;
        (!fitted.contains(&mu)).then(|| {
            format!("mu {mu} is outside [{}, {}], where ξ_n(μ) was fitted: extrapolated", fitted.start(), fitted.end())
        })
    }
}

/// μ and ρ_c of `mu=VALUE,rho=VALUE`.
fn parse_friction(name: &str) -> Result<(f64, f64)> {
    let number = |text: &str| text.parse().map_err(|_| Error::invalid("medium", format!("{text:?} is no number")));
    let parts = name.strip_prefix("mu=").and_then(|rest| rest.split_once(",rho="));
    let (mu, density) = parts.ok_or_else(|| Error::invalid("medium", format!("{name:?} is not mu=VALUE,rho=VALUE")))?;
    Ok((number(mu)?, number(density)?))
}
