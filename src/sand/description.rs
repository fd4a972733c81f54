//! `sand.toml`: a medium and its mechanisms as a file. The diagnosis writes it and the simulator loads it.

use super::law::Law;
use super::mechanism::Mechanisms;
use super::media::{Coefficients, Medium};
use super::term::{self, Term};
use crate::error::{Error, Result, check_range, check_toml};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The description of a sand that a simulation needs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SandDescription {
    pub name: String,
    pub law: Law,
    /// [kg/m³]
    pub bulk_density: f64,
    pub source: String,
    /// [N/m³]
    pub coefficients: Coefficients,
    #[serde(default)]
    pub mechanisms: Mechanisms,
    /// Terms added to the stress.
    #[serde(default, rename = "term", skip_serializing_if = "Vec::is_empty")]
    pub terms: Vec<Term>,
}

impl SandDescription {
    /// A medium and a law by their names, without mechanisms.
    pub fn named(medium: &str, law: &str) -> Result<Self> {
        Ok(Self { law: Law::named(law)?, ..Self::plain(&Medium::named(medium)?) })
    }

    pub fn plain(medium: &Medium) -> Self {
        Self {
            name: medium.name.clone(),
            law: Law::Li2013,
            bulk_density: medium.bulk_density,
            source: medium.source.clone(),
            coefficients: medium.coefficients,
            mechanisms: Mechanisms::default(),
            terms: medium.terms.clone(),
        }
    }

    pub fn medium(&self) -> Medium {
        Medium {
            name: self.name.clone(),
            coefficients: self.coefficients,
            bulk_density: self.bulk_density,
            source: self.source.clone(),
            terms: self.terms.clone(),
        }
    }

    pub fn from_toml(text: &str) -> Result<Self> {
        check_toml("sand", text)?;
        let sand: Self = toml::from_str(text).map_err(|e| Error::invalid("sand", e.message().to_string()))?;
        // Our choice, because no sand is outside of these bounds.
        check_range("bulk_density", sand.bulk_density, 1.0..=20_000.0)?;
        // 100 N/cm³, the bound of Medium::generic.
        for c in sand.coefficients.to_array() {
            check_range("coefficients", c, -1e8..=1e8)?;
        }
        sand.mechanisms.validated()?;
        term::check(&sand.terms, &sand.coefficients, sand.bulk_density)?;
        Ok(sand)
    }

    pub fn load(path: &Path) -> Result<Self> {
        let text = sandgait_base::files::read_text(path)?;
        Self::from_toml(&text).map_err(|e| Error::file(path, e))
    }

    /// The file's text; comments at its top name the mechanisms that have no effect on a walking robot.
    pub fn to_toml(&self) -> Result<String> {
        let text = toml::to_string(self).map_err(|e| Error::invalid("sand", e.to_string()))?;
        let comments = self.mechanisms.unfelt_by_walkers().into_iter().map(|line| format!("# {line}\n"));
        Ok(comments.chain([text]).collect())
    }
}
