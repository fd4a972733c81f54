//! Nested predictions: in each fold the noise is learnt, the data are whitened, and the model is chosen without the held-out conditions.
//! Values are those of the full fits, changed by one Gauss-Newton step without the predicted condition, which is exact for a
//! linear model.

use super::candidates::{SECOND, SearchSpace};
use super::differences::{NORMAL, SumPart, summed};
use super::errors::SquaredErrors;
use super::evidence::{EvidenceNumbers, EvidenceTable, LEAST};
use super::left_out::{Contender, LeftOutRow, held_out};
use super::noise::NoiseData;
use super::rows::Fits;
use super::study::FitInputs;
use super::verdict::{Compared, Role, base, leading, leading_law, without_cause};
use super::whiten::Whitener;
use crate::parallel;
use std::collections::BTreeMap;

/// Number of folds: our choice; each needs its own noise.
const FOLDS: usize = 6;

/// How a model predicts if it is chosen anew in each fold.
pub struct Nested {
    /// Errors of the plain model, of the base, and of the model [unit of the data].
    pub raw: [SquaredErrors; 3],
    /// Root mean square errors of the same models, in units of the noise.
    pub errors: [f64; 3],
    /// Root mean square error of the model that has to be improved: the base without an effect of measuring, or the plain model.
    before: f64,
    /// By how much each condition's squared errors are less than those of that model.
    lowered: Vec<SumPart>,
    /// What each condition adds to the elpd of the chosen models minus that of each reference.
    gains: Vec<Vec<SumPart>>,
    /// Number of all numbers that are predicted.
    numbers: f64,
    degrees: f64,
}

impl Nested {
    /// Fraction by which the error is less than that of the model that has to be improved, and its 95 % interval: by how much it
    /// would change if the same conditions were measured again.
    pub fn reduction(&self) -> (f64, [f64; 2]) {
        let before = (self.numbers * self.before.powi(2)).max(1e-300);
        let [gain, error] = summed(&self.lowered, self.degrees);
        let share = |square: f64| 1.0 - (1.0 - square / before).max(0.0).sqrt();
        (share(gain), [share(gain - NORMAL * error), share(gain + NORMAL * error)])
    }

    /// Are the gain of elpd and the reduction of the error above 0 beyond their 95 % intervals?
    pub fn is_certain(&self) -> bool {
        self.is_denser() && self.reduction().1[0] > 0.0
    }

    /// Says that this prediction is not certain.
    pub fn uncertain(&self) -> String {
        let ([gain, error], (_, [low, high])) = (self.least(), self.reduction());
        let said = format!("{:.0} to {:.0} %, elpd {gain:+.0} ± {error:.0}", 100.0 * low, 100.0 * high);
        let said = said.replace('-', "−");
        format!("chosen anew without the predicted conditions, it lowers the error by {said}, which is not certain")
    }

    /// Is the gain of elpd above 0 beyond its 95 % interval, and the error less?
    pub fn is_denser(&self) -> bool {
        let [gain, error] = self.least();
        gain > NORMAL * error && self.reduction().0 > 0.0
    }

    /// The least gain of elpd over a reference, in standard errors, with its standard error.
    pub fn least(&self) -> [f64; 2] {
        let each = self.gains.iter().map(|parts| {
            let [gain, error] = summed(parts, self.degrees);
            [gain, error.max(LEAST)]
        });
        each.min_by(|a, b| (a[0] / a[1]).total_cmp(&(b[0] / b[1]))).unwrap_or([0.0, LEAST])
    }
}

/// One fold: the conditions that are held out and those that are not, the entries of a table without the former, and the noise that does
/// not know them.
struct Fold {
    held: Vec<usize>,
    known: Vec<usize>,
    rest: Vec<Compared>,
    whitener: Whitener,
}

/// Some rows of the table of all conditions, under the noise of one fold. Row 0, the plain model, is always among them.
struct FoldTable {
    /// The numbers that the rows have among all models, in ascending order.
    rows: Vec<usize>,
    table: EvidenceTable,
}

impl FoldTable {
    fn place(&self, model: usize) -> usize {
        self.rows.partition_point(|k| *k < model)
    }

    fn row(&self, model: usize) -> &LeftOutRow {
        &self.table.rows[self.place(model)]
    }
}

/// All folds of one selection.
pub struct Folds<'a> {
    study: &'a FitInputs<'a>,
    fits: &'a Fits,
    models: &'a [Contender<'a>],
    folds: Vec<Fold>,
}

impl<'a> Folds<'a> {
    pub fn new(
        study: &'a FitInputs,
        asked: &SearchSpace,
        fits: &'a Fits,
        models: &'a [Contender],
        entries: &[Compared],
    ) -> Self {
        let conditions = study.observations.conditions.len();
        let folds = parallel::map(&held(conditions), |held| {
            let source = NoiseData { left_out: held, sizes: &fits.candidates.around.sizes, ..*asked.source };
            let noise = source.noise(Some(&fits.candidates.around.noise), &|| study.model.stopped());
            let whitener = Whitener::new(&source, &noise);
            let known: Vec<usize> = (0..conditions).filter(|k| !held.contains(k)).collect();
            let rest = again(&EvidenceNumbers::new(study, &whitener, models, &known).table(&known), entries);
            Fold { held: held.clone(), known, rest, whitener }
        });
        Self { study, fits, models, folds }
    }

    /// How a model of the kind of `row` predicts. `table` is that of all data.
    pub fn nested(&self, table: &EvidenceTable, entries: &[Compared], row: usize) -> Nested {
        let (base, conditions) = (base(entries), self.study.observations.conditions.len());
        let references = simpler(entries, row);
        let improved = references.iter().copied().find(|&k| entries[k].role == Role::Absent).unwrap_or(0);
        let mut raw = [(); 3].map(|()| SquaredErrors(vec![[0.0; 2]; conditions]));
        let (mut squares, mut numbers) = ([0.0; 4], 0.0);
        let (mut lowered, mut gains) = (Vec::new(), vec![Vec::new(); references.len()]);
        let mut readings = BTreeMap::new();
        let tables: Vec<(usize, FoldTable)> = parallel::map(&self.folds, |fold| {
            let chosen = self.chosen(&fold.rest, row);
            let used = [0, base, chosen, improved].into_iter().chain(references.iter().copied());
            (chosen, self.table(fold, used))
        });
        for (fold, (chosen, all)) in self.folds.iter().zip(tables) {
            for &c in &fold.held {
                for (kind, model) in [0, base, chosen, improved].into_iter().enumerate() {
                    let own = &all.row(model).predicted.left[c];
                    squares[kind] += own.error.norm_squared();
                    if kind == raw.len() {
                        break;
                    }
                    let (contender, step) = (&self.models[model], (own.law, own.step.as_slice()));
                    let reading = readings.entry(model).or_insert_with(|| contender.reading());
                    let error = held_out(self.study, contender, reading, step, &[c]);
                    raw[kind].0[c] = error.0[0];
                }
                numbers += all.table.sizes[c];
                let part = |better: bool, reference: usize| match (chosen == reference, better) {
                    (true, _) => SumPart::default(),
                    (false, true) => all.table.part(all.place(chosen), all.place(reference), c),
                    (false, false) => all.table.lowered(all.place(chosen), all.place(reference), c),
                };
                lowered.push(part(false, improved));
                references.iter().zip(&mut gains).for_each(|(&reference, own)| own.push(part(true, reference)));
            }
        }
        // The stated priors count as one more condition, which no fold leaves out.
        for (&reference, own) in references.iter().zip(&mut gains).filter(|g| *g.0 != row) {
            own.push(table.part(row, reference, table.sizes.len() - 1));
        }
        let [plain, recalibrated, own, before] = squares.map(|square| (square / f64::max(numbers, 1.0)).sqrt());
        let errors = [plain, recalibrated, own];
        Nested { raw, errors, before, lowered, gains, numbers, degrees: table.degrees }
    }

    /// The table of all conditions with the rows `used`, under the noise of a fold.
    fn table(&self, fold: &Fold, used: impl Iterator<Item = usize>) -> FoldTable {
        let mut rows: Vec<usize> = used.collect();
        rows.sort_unstable();
        rows.dedup();
        let models: Vec<Contender> = rows.iter().map(|&k| self.models[k]).collect();
        let all: Vec<usize> = (0..self.study.observations.conditions.len()).collect();
        let table = EvidenceNumbers::new(self.study, &fold.whitener, &models, &fold.known).table(&all);
        FoldTable { rows, table }
    }

    /// The model that a fold's own `entries` would write, if models of the kind of `row` may be written.
    fn chosen(&self, entries: &[Compared], row: usize) -> usize {
        let found = match self.fits.rows[row].role {
            Role::Plain => Some(0),
            Role::Base if entries[base(entries)].elpd > entries[0].elpd => Some(base(entries)),
            Role::Established | Role::Base | Role::Absent => None,
            Role::Causes | Role::Beside => leading(entries, SECOND),
            Role::Law => leading_law(entries),
        };
        found.unwrap_or_else(|| without_cause(entries))
    }
}

/// The entries in another table.
fn again(table: &EvidenceTable, entries: &[Compared]) -> Vec<Compared> {
    let of = |k: usize| Compared {
        elpd: table.elpd(k),
        beats: (0..entries.len()).map(|j| table.beats(k, j)).collect(),
        error: table.error(k),
        lowers: false,
        ..entries[k].clone()
    };
    (0..entries.len()).map(of).collect()
}

/// Conditions held out in each fold.
fn held(conditions: usize) -> Vec<Vec<usize>> {
    let folds = FOLDS.min(conditions);
    // Neighbouring conditions of a design are similar. A stride that has no common divisor with the number of
    // conditions distributes them over the folds.
    let stride = (conditions / 2 + 1..conditions + 2).find(|s| gcd(*s, conditions) == 1).unwrap_or(1);
    (0..folds).map(|f| (f..conditions).step_by(folds).map(|k| k * stride % conditions).collect()).collect()
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// The rows with which a row is compared: for a pair, those of its causes alone; for an effect of measuring, the base without it; for
/// anything else, the base.
pub fn simpler(entries: &[Compared], row: usize) -> Vec<usize> {
    let base = base(entries);
    let (before, own) = (entries[base].effects.len(), &entries[row].effects);
    let single = |k: &usize| {
        entries[*k].role == Role::Causes
            && entries[*k].effects.len() == before + 1
            && entries[*k].effects.iter().all(|e| own.contains(e))
    };
    let absent = |k: &usize| entries[*k].role == Role::Absent && entries[*k].effects == *own;
    let found: Vec<usize> = match entries[row].role == Role::Causes && own.len() > before + 1 {
        true => (0..entries.len()).filter(single).collect(),
        false => (0..entries.len()).filter(absent).collect(),
    };
    if found.is_empty() { vec![base] } else { found }
}
