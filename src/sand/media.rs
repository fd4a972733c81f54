//! Granular media: stress coefficients with their sources.

use super::coefficients::PER_CM3;
use super::friction;
use super::term::Term;
use crate::error::{Error, Result, check_range};
use serde::{Deserialize, Serialize};

pub use super::coefficients::Coefficients;

/// One kind of sand.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Medium {
    pub name: String,
    pub coefficients: Coefficients,
    /// Bulk density [kg/m³].
    pub bulk_density: f64,
    /// Source of the numbers.
    pub source: String,
    /// Terms added to the stress.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub terms: Vec<Term>,
}

/// Media whose coefficients were all measured: name, coefficients, bulk density [kg/m³], source.
const MEASURED: [(&str, Coefficients, f64, &str); 2] = [
    ("poppy-loose", Coefficients::POPPY_LOOSE, 638.0, "1 mm poppy seeds, loosely packed; the sand of Li et al. 2012"),
    (
        "poppy-close",
        Coefficients::POPPY_CLOSE,
        680.0,
        "1 mm poppy seeds, closely packed; density: our choice, 638 × 0.62/0.58 by volume fraction",
    ),
];

/// Media of which only ζ [N/cm³] is known; it multiplies the generic set: name, ζ, bulk density [kg/m³], source. The
/// sources give no densities; our choice is handbook values for the materials. Plain RFT does not use them.
const SCALED: [(&str, f64, f64, &str); 4] = [
    ("glass-beads", 0.33, 1500.0, "Treers et al. 2021"),
    ("plastic-pellets", 0.111, 560.0, "Treers et al. 2021"),
    ("quikrete-medium", 2.02, 1600.0, "Quikrete medium sand, published ζ"),
    ("quikrete-fine", 3.05, 1600.0, "Quikrete fine mix, published ζ"),
];

impl Medium {
    /// The default: the sand of Li et al. 2012.
    pub const DEFAULT: &'static str = "poppy-loose";

    /// Names that [`Medium::named`] accepts.
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
        // 100 N/cm³ is far stiffer than any published sand (3.05): our choice, which catches wrong units.
        check_range("zeta", zeta, 1e-3..=100.0)?;
        Ok(Self {
            name: format!("zeta={zeta}"),
            coefficients: Coefficients::GENERIC.scaled(zeta),
            bulk_density: 1500.0, // dry sand, handbook value: our choice
            source: "generic set, Science 2013 table S2, times ζ".into(),
            terms: Vec::new(),
        })
    }

    /// The generic set, scaled so that `agarwal2023` gets its ξ_n for friction μ and critical density ρ_c [kg/m³].
    fn from_friction(mu: f64, density: f64) -> Result<Self> {
        // Our choice, because no granular medium is outside of these bounds. For a μ within these bounds but outside of
        // the fitted range, `caution` gives a warning.
        check_range("mu", mu, 0.05..=2.0)?;
        check_range("rho", density, 10.0..=20_000.0)?;
        let zeta = friction::from_friction(mu, density) * friction::PENETRATION / PER_CM3;
        let source =
            format!("ξ_n from μ = {mu} and ρ_c = {density} kg/m³, Agarwal et al. 2023; generic set at that scale");
        Ok(Self { name: format!("mu={mu},rho={density}"), bulk_density: density, source, ..Self::generic(zeta)? })
    }

    /// One line of warning if `name` lies outside the range that its source has measured.
    pub fn caution(name: &str) -> Option<String> {
        let (mu, _) = parse_friction(name).ok()?;
        let fitted = friction::FITTED_FRICTION;
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
