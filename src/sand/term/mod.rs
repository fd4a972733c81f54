//! Additional stress terms of `sand.toml` (`[[term]]`), checked when they are read.
//!
//! A term adds the stress `coefficient · ρ g |z| · Π group^power` on a submerged piece, against the normal of its
//! leading face or against its tangential velocity. A term with `on = "law"` instead changes the force law's own stress
//! by the share `coefficient · Π group^power`. Each group is clamped to its range, so a term is never extrapolated
//! beyond the data in which it was found. Both engines and the force logs evaluate terms through [`LaneTerms`].

mod lanes;

use super::GRAVITY;
use super::coefficients::Coefficients;
use crate::error::{Error, Result, check_range};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

pub use lanes::{LaneTerms, TermArguments};

/// Largest number of terms of one sand. Environments that are computed together may also have at most this many
/// different terms. Our choice, because each term makes a step slower.
pub const MOST_TERMS: usize = 4;
/// Largest number of groups of one term: our choice, for the same reason.
const MOST_GROUPS: usize = 4;
/// Energy is checked at orientations and directions from −90° to 90°; this is the number of steps in 90°. Our choice:
/// a sine of 2β or γ changes little within 5°.
const ANGLES: i32 = 18;

/// The direction of a term's stress.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum On {
    Normal,
    Tangential,
    /// Along the force law's own stress, as a share of it.
    Law,
}

impl On {
    /// The name in `sand.toml`.
    pub fn name(self) -> &'static str {
        match self {
            On::Normal => "normal",
            On::Tangential => "tangential",
            On::Law => "law",
        }
    }
}

/// A dimensionless number of a moving piece.
///
/// Grain size, curvature and distance of a wall are in this list by our choice; no published power is known for them.
/// Each measures one effect that resistive force theory neglects: sand is made of grains (d/w), neighbouring pieces of
/// a curved face influence each other (κ w), and a bed has walls (distance over w). A user who knows such a law can
/// write it as a term.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Group {
    /// v_n²/(g |z|)
    Froude,
    /// |z|/w, w the width across the plane of motion
    DepthOverWidth,
    /// Grain diameter divided by w; 0 if no diameter is given.
    GrainOverWidth,
    /// Curvature times w; 0 for flat pieces; all pieces of the engines are flat.
    Curvature,
    /// a_n/g of the leading face; 0 in the engines, which take the stress from velocities alone.
    Acceleration,
    /// Number of earlier passes over this place; 0 in the engines.
    Passes,
    /// Distance of a wall divided by w; if no distance is given, the wall counts as far away.
    Wall,
    SinGamma,
    CosGamma,
    SinBeta,
    CosBeta,
    /// |v|²/(g w) with the whole speed, not only its normal part.
    WholeFroude,
    /// |v_n|/|v|: 1 if the piece moves along its normal, 0 if it moves along itself. α is the angle of attack, between
    /// the piece and its velocity.
    SinAttack,
    /// |v_t|/|v|
    CosAttack,
    /// |z|/(|z| + w): 0 at the surface, near 1 at depths of many widths.
    Saturation,
}

impl Group {
    /// Name, group, and the group in words and in TeX.
    const ALL: [(&'static str, Group, &'static str, &'static str); 15] = [
        ("froude", Group::Froude, "v_n²/(g|z|)", r"\frac{v_n^2}{g|z|}"),
        ("depth_over_width", Group::DepthOverWidth, "|z|/w", r"\frac{|z|}{w}"),
        ("grain_over_width", Group::GrainOverWidth, "d/w", r"\frac{d}{w}"),
        ("curvature", Group::Curvature, "κw", r"\kappa w"),
        ("acceleration", Group::Acceleration, "a_n/g", r"\frac{a_n}{g}"),
        ("passes", Group::Passes, "passes", r"n"),
        ("wall", Group::Wall, "wall/w", r"\frac{l}{w}"),
        ("sin_gamma", Group::SinGamma, "sin γ", r"\sin\gamma"),
        ("cos_gamma", Group::CosGamma, "cos γ", r"\cos\gamma"),
        ("sin_beta", Group::SinBeta, "sin β", r"\sin\beta"),
        ("cos_beta", Group::CosBeta, "cos β", r"\cos\beta"),
        ("whole_froude", Group::WholeFroude, "v²/(gw)", r"\frac{v^2}{gw}"),
        ("sin_attack", Group::SinAttack, "sin α", r"\sin\alpha"),
        ("cos_attack", Group::CosAttack, "cos α", r"\cos\alpha"),
        ("saturation", Group::Saturation, "|z|/(|z|+w)", r"\frac{|z|}{|z|+w}"),
    ];

    pub fn named(name: &str) -> Result<Self> {
        let known = Self::ALL.map(|g| g.0);
        Self::ALL.iter().find(|g| g.0 == name).map(|g| g.1).ok_or_else(|| Error::unknown("group", name, &known))
    }

    /// The group of this name in words and in TeX.
    fn symbols(name: &str) -> [&'static str; 2] {
        Self::ALL.iter().find(|g| g.0 == name).map_or([""; 2], |g| [g.2, g.3])
    }

    /// May the group be negative?
    fn signed(self) -> bool {
        matches!(self, Group::Acceleration | Group::SinGamma | Group::SinBeta)
    }

    /// Does the group's value in [`LaneTerms`] change with the depth or the width of a piece?
    fn varies_in_place(self) -> bool {
        match self {
            Group::Froude | Group::DepthOverWidth | Group::WholeFroude | Group::Saturation => true,
            Group::GrainOverWidth
            | Group::Curvature
            | Group::Acceleration
            | Group::Passes
            | Group::Wall
            | Group::SinGamma
            | Group::CosGamma
            | Group::SinBeta
            | Group::CosBeta
            | Group::SinAttack
            | Group::CosAttack => false,
        }
    }
}

/// One term as written in `sand.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Term {
    pub on: On,
    pub coefficient: f64,
    /// Group → power.
    #[serde(default)]
    pub groups: BTreeMap<String, f64>,
    /// Group → least and greatest value; values outside are clamped.
    #[serde(default)]
    pub range: BTreeMap<String, [f64; 2]>,
}

/// A negative stress up to this share of the penetration stress is accepted: our choice, because no experiment can
/// detect it.
const UNTOLD: f64 = 1e-3;

/// The law's own stress on a moving piece, per depth [N/m³].
struct Resisting {
    /// Push on the leading face.
    normal: f64,
    /// Resistance along the motion.
    power: f64,
    /// |n·v| for unit vectors.
    along: f64,
}

fn resisting(coefficients: &Coefficients, beta: f64, gamma: f64) -> Resisting {
    let (n, v) = ([beta.sin(), -beta.cos()], [gamma.cos(), -gamma.sin()]);
    let along = n[0] * v[0] + n[1] * v[1];
    let law = per_depth(coefficients, beta, gamma);
    let normal = -(law[0] * n[0] + law[1] * n[1]) * along.signum();
    Resisting { normal, power: -(law[0] * v[0] + law[1] * v[1]), along: along.abs() }
}

impl Term {
    /// Groups with power and range.
    fn factors(&self) -> Result<Vec<(Group, f64, [f64; 2])>> {
        if let Some(name) = self.range.keys().find(|name| !self.groups.contains_key(*name)) {
            return Err(Error::invalid("term.range", format!("{name} is not among the term's groups")));
        }
        let factor = |(name, power): (&String, &f64)| {
            let range = self.range.get(name).copied();
            let range = range.ok_or_else(|| Error::invalid("term.range", format!("{name} has none")))?;
            Ok((Group::named(name)?, *power, range))
        };
        self.groups.iter().map(factor).collect()
    }

    /// Refuses a term that would add energy, pull, break mirror symmetry, act above the surface, or grow without bound.
    /// The bounds of coefficient, powers and ranges catch wrong numbers: our choice.
    pub fn check(&self, coefficients: &Coefficients, bulk_density: f64) -> Result<()> {
        check_range("term.coefficient", self.coefficient, -1e4..=1e4)?;
        let factors = self.factors()?;
        if factors.len() > MOST_GROUPS {
            return Err(Error::invalid("term.groups", format!("{} are more than {MOST_GROUPS}", factors.len())));
        }
        for (group, power, [low, high]) in &factors {
            check_factor(*group, *power, *low, *high)?;
        }
        if !self.value(&extreme(&factors), &factors).is_finite() {
            return Err(Error::invalid("term", "grows without bound in its range"));
        }
        self.check_energy(&factors, coefficients, bulk_density)
    }

    /// The first group whose value changes with the depth or the width of a piece.
    pub fn varying_group(&self) -> Option<&str> {
        self.groups.keys().map(String::as_str).find(|name| Group::named(name).is_ok_and(Group::varies_in_place))
    }

    /// coefficient · Π group^power
    fn value(&self, groups: &[f64], factors: &[(Group, f64, [f64; 2])]) -> f64 {
        factors.iter().zip(groups).fold(self.coefficient, |product, ((_, power, _), at)| product * at.powf(*power))
    }

    /// The law with the term must resist the motion at every orientation and direction, for all values of the other
    /// groups within their ranges. At some steep orientations the published coefficients themselves drive the motion a
    /// little; with a term, the law must not drive it more.
    fn check_energy(
        &self,
        factors: &[(Group, f64, [f64; 2])],
        coefficients: &Coefficients,
        bulk_density: f64,
    ) -> Result<()> {
        let degrees = |k: i32| std::f64::consts::FRAC_PI_2 * f64::from(k) / f64::from(ANGLES);
        let all = || (-ANGLES..=ANGLES).flat_map(|b| (-ANGLES..=ANGLES).map(move |g| [degrees(b), degrees(g)]));
        let least_normal = all().map(|[beta, gamma]| resisting(coefficients, beta, gamma).normal).fold(0.0, f64::min)
            - UNTOLD * coefficients.penetration();
        for [beta, gamma] in all() {
            let least = self.least(factors, beta, gamma);
            if least >= 0.0 || (self.on == On::Law && least >= -1.0) {
                continue;
            }
            if self.on == On::Law {
                let why = "turns the law's own stress round and so adds energy: it may take away all of it at most";
                return Err(Error::invalid("term", why));
            }
            let Resisting { normal, power, along } = resisting(coefficients, beta, gamma);
            let extra = least * bulk_density * GRAVITY;
            let pulls = normal + extra < least_normal || power + extra * along < 0.0;
            // A piece that moves along itself has no leading face.
            if self.on == On::Tangential || (along > 1e-9 && pulls) {
                let place = format!("at β {:.0}°, γ {:.0}°", beta.to_degrees(), gamma.to_degrees());
                let what = if self.on == On::Normal { "pulls and so adds energy" } else { "adds energy" };
                return Err(Error::invalid(
                    "term",
                    format!("{what} {place}: the stress must resist everywhere in its range"),
                ));
            }
        }
        Ok(())
    }

    /// Least value of the term at an orientation and direction, over the ranges of all other groups.
    fn least(&self, factors: &[(Group, f64, [f64; 2])], beta: f64, gamma: f64) -> f64 {
        let mut bounds = [self.coefficient; 2];
        for (group, power, [low, high]) in factors {
            let fixed = match group {
                Group::SinGamma => Some(gamma.sin()),
                Group::CosGamma => Some(gamma.cos()),
                Group::SinBeta => Some(beta.sin()),
                Group::CosBeta => Some(beta.cos()),
                Group::SinAttack => Some((beta.sin() * gamma.cos() + beta.cos() * gamma.sin()).abs()),
                Group::CosAttack => Some((beta.cos() * gamma.cos() - beta.sin() * gamma.sin()).abs()),
                _ => None,
            };
            let ends = fixed.map_or([*low, *high], |at| [at.clamp(*low, *high); 2]).map(|at| at.powf(*power));
            let all = [bounds[0] * ends[0], bounds[0] * ends[1], bounds[1] * ends[0], bounds[1] * ends[1]];
            bounds = [all.iter().copied().fold(f64::MAX, f64::min), all.iter().copied().fold(f64::MIN, f64::max)];
        }
        bounds[0]
    }

    /// The term in words.
    pub fn formula(&self) -> String {
        let power = |(name, power): (&String, &f64)| {
            let symbol = Group::symbols(name)[0];
            format!(" · ({symbol})^{power}")
        };
        let groups: String = self.groups.iter().map(power).collect();
        match self.on {
            On::Normal => format!("{:.3} · ρg|z|{groups}, against the normal of the leading face", self.coefficient),
            On::Tangential => format!("{:.3} · ρg|z|{groups}, against the tangential velocity", self.coefficient),
            On::Law => format!("{:.3}{groups}, as a share of the force law's own stress", self.coefficient),
        }
    }

    pub fn tex(&self) -> String {
        let power = |(name, power): (&String, &f64)| {
            let symbol = Group::symbols(name)[1];
            format!(r"\left({symbol}\right)^{{{power}}}")
        };
        let groups: String = self.groups.iter().map(power).collect();
        let scale = match self.on {
            On::Normal => r"\mathbf{n}\,\rho g|z|",
            On::Tangential => r"\hat{\mathbf{v}}_t\,\rho g|z|",
            On::Law => {
                return format!(r"\Delta\boldsymbol\sigma = {:.3}\,{groups}\,\boldsymbol\sigma", self.coefficient);
            }
        };
        format!(r"\Delta\boldsymbol\sigma = -{:.3}\,{groups}\,{scale}", self.coefficient)
    }
}

/// Checks all terms of a sand.
pub fn check(terms: &[Term], coefficients: &Coefficients, bulk_density: f64) -> Result<()> {
    if terms.len() > MOST_TERMS {
        return Err(Error::invalid("term", format!("{} terms are more than {MOST_TERMS}", terms.len())));
    }
    terms.iter().try_for_each(|term| term.check(coefficients, bulk_density))
}

fn check_factor(group: Group, power: f64, low: f64, high: f64) -> Result<()> {
    let name = Group::ALL.iter().find(|g| g.1 == group).map_or("", |g| g.0);
    check_range(&format!("term.groups.{name}"), power, -4.0..=4.0)?;
    check_range(&format!("term.range.{name}"), low, -1e6..=1e6)?;
    check_range(&format!("term.range.{name}"), high, low..=1e6)?;
    let wrong = |why: &str| Err(Error::invalid(format!("term.range.{name}"), why));
    if low < 0.0 && group == Group::DepthOverWidth {
        return wrong("a negative depth is above the surface, where no sand acts");
    }
    if low < 0.0 && !group.signed() {
        return wrong("cannot be negative");
    }
    if group == Group::SinBeta && power.rem_euclid(2.0) != 0.0 {
        let why =
            "an odd power of sin β breaks mirror symmetry: a plate and its mirror image would feel different stress";
        return Err(Error::invalid("term.groups.sin_beta", why));
    }
    if low < 0.0 && power.fract() != 0.0 {
        return wrong("a power that is no whole number needs a range without negative values");
    }
    if power < 0.0 && low <= 0.0 && high >= 0.0 {
        return wrong("a negative power grows without bound at 0");
    }
    Ok(())
}

/// Values of the groups, each at an end of its range, for which the product is greatest.
fn extreme(factors: &[(Group, f64, [f64; 2])]) -> Vec<f64> {
    factors.iter().map(|(_, power, [low, high])| if *power < 0.0 { *low } else { high.abs().max(low.abs()) }).collect()
}

/// The law's stress per depth [N/m³] for motion toward +x.
fn per_depth(c: &Coefficients, beta: f64, gamma: f64) -> [f64; 2] {
    let z = c.a00
        + c.a10 * (2.0 * beta).cos()
        + c.b11 * (2.0 * beta + gamma).sin()
        + c.b01 * gamma.sin()
        + c.bm11 * (gamma - 2.0 * beta).sin();
    let x = c.c11 * (2.0 * beta + gamma).cos()
        + c.c01 * gamma.cos()
        + c.cm11 * (gamma - 2.0 * beta).cos()
        + c.d10 * (2.0 * beta).sin();
    [-x, z]
}

#[cfg(test)]
mod tests;
