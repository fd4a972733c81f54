//! The form of a cause's law: which powers of the speed predict left-out conditions as well as the power in the law.
//!
//! The stress ρ v^q of the speed alone is the term of groups (v_n²/(g|z|))^(q/2) (|z|/w)^(q/2 − 1). Each power is a model
//! of its own in a table of evidence.

use super::evidence::EvidenceTable;
use super::laws::laws;
use super::left_out::{Contender, LawColumn};
use super::rows::Fits;
use super::study::FitInputs;
use super::words::digits;
use crate::sand::mechanism::CATALOG;
use crate::sand::term::{On, Term};
use serde::Serialize;

/// Result of the comparison of powers of the speed.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct SpeedExponent {
    pub id: String,
    /// The law's own power.
    pub law: f64,
    /// The power that predicts best.
    pub found: f64,
    /// Least and greatest power that the best power does not beat.
    pub ci95: [f64; 2],
    /// Is the law's own power beaten?
    pub excluded: bool,
    /// Do the data exclude all powers that differ from the law's own by ¾ or more? Our choice: those ½ away may remain.
    pub told_apart: bool,
}

impl SpeedExponent {
    /// Do the data exclude the law's own power, and not all that are far from it? Real grains exclude the 2 of a drag for 1.5, because all
    /// their forces grow with the speed a little; that refutes no drag.
    pub fn is_refuted(&self) -> bool {
        self.excluded && !self.told_apart
    }

    /// A clause for the report's sentence; None if the data agree with the law's power and exclude other powers.
    pub fn said(&self) -> Option<String> {
        let Self { id, law, found, ci95: [low, high], .. } = self;
        let [law, found, low, high] = [law, found, low, high].map(|v| digits(*v));
        match (self.excluded, self.told_apart) {
            (true, _) => Some(format!("the data prefer the power {found} of the speed where {id} has {law}")),
            (false, false) => {
                Some(format!("of the speed in {id} these data allow every power from {low} to {high}, not only {law}"))
            }
            (false, true) => None,
        }
    }
}

/// Replaces the power of the speed in the law of the cause of `row` by other powers, and compares them. None if the row has not one cause
/// with such a power, or if these data cannot test laws.
pub fn form(study: &FitInputs, fits: &Fits, row: usize) -> Option<SpeedExponent> {
    let [own] = fits.fit(row).ids[..] else { return None };
    let (id, law) = (CATALOG[own].id, CATALOG[own].exponent?);
    let candidates = &fits.candidates;
    let (study, fit) = (&candidates.about_base(study), &candidates.base);
    let laws = laws(study, fit);
    let power = |term: &Term| {
        let at = |name: &str| term.groups.get(name).copied().unwrap_or(0.0);
        let (speed, depth) = (at("froude"), at("depth_over_width"));
        let alone = term.on == On::Normal && term.groups.keys().all(|g| g == "froude" || g == "depth_over_width");
        (alone && speed > 0.0 && (depth - speed + 1.0).abs() < 1e-9).then_some(2.0 * speed)
    };
    let each: Vec<(f64, &LawColumn)> =
        laws.terms.iter().zip(&laws.columns).filter_map(|(term, column)| Some((power(term)?, column))).collect();
    let nuisances = &study.nuisances[..];
    let model = |&(_, column)| Contender { fit, nuisances, columns: std::slice::from_ref(column) };
    let models: Vec<Contender> = each.iter().map(model).collect();
    let table = EvidenceTable::new(study, study.whitener, &models);
    let top = (0..models.len()).max_by(|a, b| table.elpd(*a).total_cmp(&table.elpd(*b)))?;
    let stay: Vec<f64> = (0..models.len()).filter(|&k| !table.beats(top, k)).map(|k| each[k].0).collect();
    let ci95 = [stay.iter().copied().fold(f64::MAX, f64::min), stay.iter().copied().fold(f64::MIN, f64::max)];
    let excluded = !(ci95[0]..=ci95[1]).contains(&law);
    Some(SpeedExponent {
        id: id.into(),
        law,
        found: each[top].0,
        ci95,
        excluded,
        told_apart: ci95[0] > law - 0.75 && ci95[1] < law + 0.75,
    })
}
