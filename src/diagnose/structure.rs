//! Is the rest that fitted coefficients leave noise? If the law fits, no part of the data needs a factor of its own: neither a range of
//! depth, speed or another feature, nor a direction, a shape, or a part of the session.

use super::evidence::EvidenceTable;
use super::fit::Fit;
use super::forward::{Feature, ForwardModel};
use super::left_out::{Contender, LawColumn};
use super::misfit::ranges;
use super::observations::Observations;
use super::split::{divisions, percent};
use super::study::FitInputs;
use super::words::span;
use crate::sand::mechanism::Mechanisms;

/// Number of parts of the session: our choice, enough to show a trend.
const PARTS: usize = 4;

/// A part of the data: its name, and for each unit whether a sample belongs to it.
struct DataPart {
    name: String,
    holds: Vec<Vec<bool>>,
}

/// All parts: the ranges of each feature, both parts of every division in two, and the parts of the session.
fn parts(o: &Observations, model: &dyn ForwardModel) -> Vec<DataPart> {
    let mut all = Vec::new();
    for Feature { name, unit, values } in model.features() {
        all.extend(ranges(&values).into_iter().map(|range| DataPart {
            name: format!("at {} {}", span(range, unit), name.replace('_', " ")),
            holds: values.iter().map(|own| own.iter().map(|v| (range[0]..=range[1]).contains(v)).collect()).collect(),
        }));
    }
    for division in divisions(o, model) {
        let side = |one: bool| DataPart {
            name: division.names[usize::from(one)].clone(),
            holds: division.parts.iter().map(|own| own.iter().map(|part| *part == Some(one)).collect()).collect(),
        };
        all.extend([false, true].map(side));
    }
    all.extend((0..PARTS).map(|part| DataPart {
        name: format!("in part {} of {PARTS} of the session", part + 1),
        holds: (0..o.units.len()).map(|u| vec![u * PARTS / o.units.len() == part; o.units[u].samples]).collect(),
    }));
    all
}

/// The fit of `base` with the sand's strength as one more value.
fn with_strength(study: &FitInputs, base: &Contender) -> Fit {
    let own = study.with_nuisances(base.nuisances.to_vec());
    let mut begun = Fit { slopes: Vec::new(), ..base.fit.clone() };
    match Mechanisms::index("scale") {
        Ok(id) if !begun.ids.contains(&id) => begun.ids.push(id),
        _ => return base.fit.clone(),
    }
    own.fit_from(&[&begun]).swap_remove(0)
}

/// The part of the data whose forces need a factor of their own beside the fit of `base`, in words. Beside it the whole sand has a free
/// strength, so a part that is nearly all of the data says nothing. The level is that of every comparison: a
/// model with this factor predicts left-out conditions better beyond twice the standard error (2.3 %, one-sided). The part is chosen
/// anew with each condition left out, so their number is no advantage. None also if readings are no forces, as those of walking robots,
/// whose simulations are rough: a factor on them has no meaning.
pub fn left(study: &FitInputs, base: &Contender) -> Option<String> {
    if study.model.roughness().is_some() {
        return None;
    }
    let fit = with_strength(study, base);
    let base = &Contender { fit: &fit, ..*base };
    let o = study.observations;
    let parts = parts(o, study.model);
    let column = |part: &DataPart| -> LawColumn {
        let prediction = &base.fit.prediction;
        let at = |u: usize, c: usize, i: usize| {
            if part.holds[u][i] { prediction[o.units[u].block(c).start + i] } else { 0.0 }
        };
        o.stack(at).into_iter().map(|v| v as f32).collect()
    };
    let columns: Vec<LawColumn> = parts.iter().map(column).collect();
    let models = [*base, Contender { columns: &columns, ..*base }];
    let table = EvidenceTable::new(study, study.whitener, &models);
    let own = &table.rows[1].predicted;
    let (part, factor) = (&parts[own.law?], own.step.as_slice().last()?);
    table.beats(1, 0).then(|| format!("{} of the forces are left {}", percent(*factor), part.name))
}
