//! Is the rest that fitted coefficients leave noise? If the law fits, no part of the data needs a factor of its own: neither a range of
//! depth, speed or another feature, nor a direction, a shape, or a part of the session.

use super::evidence::EvidenceTable;
use super::forward::{Feature, ForwardModel};
use super::left_out::{Contender, LawColumn};
use super::misfit::ranges;
use super::observations::Observations;
use super::split::{divisions, percent};
use super::study::FitInputs;
use super::words::span;

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

impl DataPart {
    /// Errors of `reading` in this part and in the rest: measured less read, along the reading, as a share of it. None where nothing is read.
    fn errors(&self, o: &Observations, reading: &[f64]) -> [Option<f64>; 2] {
        let mut sums = [[0.0; 2]; 2];
        for (unit, holds) in o.units.iter().zip(&self.holds) {
            for (c, _) in o.channels.iter().enumerate().filter(|c| c.1.in_rmse) {
                for (k, own) in unit.block(c).zip(holds) {
                    let [error, square] = &mut sums[usize::from(!own)];
                    *error += (o.values[k] - reading[k]) * reading[k];
                    *square += reading[k].powi(2);
                }
            }
        }
        sums.map(|[error, square]| (square > 0.0).then(|| error / square))
    }

    /// Both errors in words.
    fn said(&self, o: &Observations, reading: &[f64]) -> String {
        let [own, rest] = self.errors(o, reading);
        let rest = rest.map_or(String::new(), |rest| format!(", and by {} elsewhere", percent(rest)));
        format!("what is fitted still errs by {} {}{rest}", percent(own.unwrap_or(0.0)), self.name)
    }
}

/// The part of the data whose forces need a factor of their own beside the fit of `base`, in words. The words have the errors of this
/// fit, because the factor belongs to another one, in which the coefficients give way to it. The level is that of every comparison: a
/// model with this factor predicts left-out conditions better beyond twice the standard error (2.3 %, one-sided). The part is chosen
/// anew with each condition left out, so their number is no advantage. None also if readings are no forces, as those of walking robots,
/// whose simulations are rough: a factor on them has no meaning.
pub fn left(study: &FitInputs, base: &Contender) -> Option<String> {
    if study.model.roughness().is_some() {
        return None;
    }
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
    let part = &parts[own.law?];
    table.beats(1, 0).then(|| part.said(o, &base.reading()))
}
