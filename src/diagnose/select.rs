//! Selects the answer: fits the candidates, compares them by one table of evidence, tests the leading one, and measures the gain of
//! the model that `sand.toml` gets.

use super::candidates::{Candidates, SECOND, SearchSpace, candidates};
use super::evidence::EvidenceTable;
use super::gate::{self, Assessment, NameTests};
use super::laws::{Laws, laws};
use super::measured::{MeasuredFit, WIDE};
use super::nested::{Folds, Nested};
use super::normal_equations::NormalEquations;
use super::nuisance::Nuisance;
use super::one_fault::{as_described, one_fault};
use super::profile;
use super::rows::{Fits, Place};
use super::speed_exponent::{self, SpeedExponent};
use super::structure;
use super::study::FitInputs;
use super::verdict::{
    Compared, Effect, Role, Ruling, Tested, Verdict, Written, base, leading, leading_law, passed_over, verdict,
};
use crate::error::Result;
use crate::parallel;
use crate::progress::Progress;
use crate::sand::mechanism::CATALOG;
use crate::student;

/// Most effects of measuring that are established one after the other: our choice; each repeats all fits.
const ESTABLISHED: usize = 2;

/// Most explanations that are tested, the best first: our choice; the next ones are beaten anyway.
const TRIED: usize = 4;

/// If the place in the bed or the number of earlier passes is unknown, these mechanisms may multiply the stress by the same factor
/// everywhere, as `scale` does.
pub const FACTORS: [&str; 2] = ["packing_grad", "footprint"];

/// With intruders of one size this mechanism multiplies all stress by one factor, as a recalibration does, so it is no rival there.
pub const OF_SIZE: &str = "size_power";

/// All results of one diagnosis.
pub struct Selection {
    pub fits: Fits,
    pub table: EvidenceTable,
    pub entries: Vec<Compared>,
    pub ruling: Ruling,
    /// The written model, fitted with the noise scaled to its errors, and what it was tested for.
    pub standing: Assessment,
    /// Models that lead by their evidence but are not named, with the tests that they failed.
    pub withheld: Vec<(usize, Vec<String>)>,
    /// How the written model predicts if it is chosen anew in each fold.
    pub nested: Nested,
    /// See [`SearchSpace::unseen`].
    pub unseen: Vec<usize>,
    /// See [`Judging::profiled`].
    profiled: Option<Vec<[f64; 2]>>,
}

impl Selection {
    /// The causes of each explanation that the data cannot distinguish, or the formula of a law. If `scale` is among
    /// the causes, mechanisms that the data cannot see may be in its place.
    pub fn explanations(&self) -> Vec<Vec<String>> {
        let mut all: Vec<Vec<String>> = Vec::new();
        for own in self.ruling.set.iter().map(|&k| self.named(k)) {
            if !all.contains(&own) {
                all.push(own);
            }
        }
        if self.ruling.set.first().is_some_and(|&k| self.entries[k].unseen) {
            all.extend(self.unseen.iter().map(|&id| vec![CATALOG[id].id.to_owned()]));
        }
        all
    }

    /// Ids of what a row names; a law has none.
    pub fn ids(&self, row: usize) -> Vec<String> {
        ids(&self.fits, &self.entries, row)
    }

    /// Is one effect of measuring named that may be that of several channels or shapes?
    pub fn is_of_several(&self) -> bool {
        self.ruling.verdict == Verdict::Named && self.ruling.set.len() > 1
    }

    /// Ids of what a row names, and the formula of its law.
    pub fn named(&self, row: usize) -> Vec<String> {
        let law = self.fits.law(&self.table, row).map(|law| law.formula());
        self.ids(row).into_iter().chain(law).collect()
    }

    /// The one effect of measuring that shows although nothing is wrong with the sand: nothing else predicts better than the base.
    fn shows(&self, study: &FitInputs) -> Option<usize> {
        let Ruling { verdict, written, model, .. } = self.ruling;
        let nothing = verdict == Verdict::NoneOfThese && matches!(written, Written::Plain | Written::Recalibrated);
        if !nothing && !matches!(verdict, Verdict::NoiseFloor | Verdict::Recalibrated) {
            return None;
        }
        let around = self.fits.candidates.around.about(study);
        let own = if self.standing.stated { around.stated() } else { around };
        let found = super::measured::alone(&own, self.fits.fit(model), &self.fits.candidates.screened)?;
        let base = base(&self.entries);
        let other = |e: &Compared| e.role == Role::Causes && e.effects != [Effect::Measuring(found)] && e.beats[base];
        (!self.entries.iter().any(other)).then_some(found)
    }

    /// The power of the speed in the answer's law, or in that of the best answer that failed a test.
    pub fn form(&self, study: &FitInputs) -> Option<SpeedExponent> {
        let row = self.ruling.set.first().copied().or(self.withheld.first().map(|w| w.0))?;
        speed_exponent::form(&self.fits.candidates.around.about(study), &self.fits, row)
    }

    /// The same fits, judged again: see [`Judging::strict`].
    fn stricter(self, study: &FitInputs, asked: &SearchSpace, refused: Option<&str>) -> Self {
        let around = self.fits.candidates.around.about(study);
        let with = Judging { study: &around, asked, strict: true, refused, profiled: self.profiled.as_deref() };
        let Judged { ruling, standing, withheld, nested } = judged(&with, &self.fits, &self.table, &self.entries);
        drop(around);
        Self { ruling, standing, withheld, nested, ..self }
    }

    /// Does it name what predicts better than the plain model, with certain values?
    fn stands(&self) -> bool {
        let better = self.entries[self.ruling.model].beats[0] && self.nested.reduction().1[0] > 0.0;
        matches!(self.ruling.verdict, Verdict::Named | Verdict::Ambiguous)
            && better
            && self.standing.found.iter().all(|found| found.certain)
    }

    /// The effect of measuring that this selection names alone.
    fn establishes(&self) -> Option<usize> {
        let effects = &self.entries[*self.ruling.set.first()?].effects;
        let before = self.entries[base(&self.entries)].effects.len();
        match effects.last()? {
            Effect::Measuring(k) if self.ruling.verdict == Verdict::Named && effects.len() == before + 1 => Some(*k),
            _ => None,
        }
    }
}

/// Runs the whole selection. Effects of measuring are marginalised within their stated priors. If one of them is the answer because it
/// is far larger than stated, it becomes a part of every model, and the causes are compared again.
pub fn select(study: &FitInputs, asked: &SearchSpace, progress: &dyn Progress) -> Result<Selection> {
    let mut nuisances = study.nuisances.clone();
    let mut alone = None;
    progress.report(0.02, "each difference alone")?;
    if let Some((one, causes)) = one_fault(study, asked) {
        let alone_asked = SearchSpace { ids: &causes, ..*asked };
        let found =
            attempt(&one, &as_described(study), &alone_asked, &ShareOfProgress { whole: progress, from: 0.05 })?;
        let names = || ids(&found.fits, &found.entries, found.ruling.model).join(" + ");
        match gate::inexact(&found.standing) {
            Some(why) if found.stands() => progress.note(&format!("{} alone is no answer: {why}", names())),
            None if found.stands() => {
                nuisances.clone_from(&one.nuisances);
                alone = Some(found);
            }
            _ => (),
        }
    }
    let mut selection = alone.map_or_else(|| attempt(study, study, asked, progress), Ok)?;
    let mut refused = None;
    for _ in 0..ESTABLISHED {
        // In a robot's log small effects of measuring are always there; a large one is found by [`one_fault`].
        let small = || selection.shows(study).filter(|_| study.model.roughness().is_none());
        let Some(k) = selection.establishes().or_else(small) else { break };
        nuisances[k] = nuisances[k].with_prior(WIDE * nuisances[k].stated_sd);
        let wide = study.with_nuisances(nuisances.clone());
        let next = attempt(&wide, study, asked, &ShareOfProgress { whole: progress, from: 0.9 })?;
        if !next.stands() {
            break;
        }
        refused = gate::inexact(&next.standing);
        if refused.is_some() {
            break;
        }
        selection = next;
    }
    // An effect of measuring that did not become a part of all models must be certain as it is.
    if selection.establishes().is_some() && (refused.is_some() || !selection.nested.is_certain()) {
        selection = selection.stricter(study, asked, refused.as_deref());
    }
    Ok(selection)
}

/// The progress of an attempt before or after the main one: a twentieth of the whole, from `from` on.
struct ShareOfProgress<'a> {
    whole: &'a dyn Progress,
    from: f64,
}

impl Progress for ShareOfProgress<'_> {
    fn report(&self, done: f64, stage: &str) -> Result<()> {
        self.whole.report(self.from + 0.05 * done, stage)
    }

    fn note(&self, line: &str) {
        self.whole.note(line);
    }
}

/// Makes all fits and compares them. `stated` has the stated priors.
fn attempt(study: &FitInputs, stated: &FitInputs, asked: &SearchSpace, progress: &dyn Progress) -> Result<Selection> {
    let mut candidates = candidates(study, asked, progress)?;
    progress.report(0.8, "laws in the data")?;
    let around = candidates.around.clone();
    let renewed = around.about(study);
    let profiled = explored(&renewed, &mut candidates);
    let alone = laws(&candidates.about_base(&renewed), &candidates.base);
    let leading = candidates.leading.map(|k| &candidates.fits[k]).filter(|_| !alone.terms.is_empty());
    let beside = leading.map_or_else(Laws::default, |fit| laws(&renewed, fit));
    let plain = plain(&renewed, stated, &candidates);
    let fits = Fits { candidates, plain, laws: [alone, beside], rows: Vec::new() }.with_rows();
    progress.report(0.85, "held-out conditions")?;
    let table = EvidenceTable::new(&renewed, renewed.whitener, &fits.contenders());
    let entries = entries(&renewed, &table, &fits, asked);
    let with = Judging { study: &renewed, asked, strict: false, refused: None, profiled: profiled.as_deref() };
    let Judged { ruling, standing, withheld, nested } = judged(&with, &fits, &table, &entries);
    drop(renewed);
    let unseen = asked.unseen.to_vec();
    Ok(Selection { fits, table, entries, ruling, standing, withheld, nested, unseen, profiled })
}

/// The plain model, with the stated priors of all effects of measuring.
fn plain(study: &FitInputs, stated: &FitInputs, candidates: &Candidates) -> MeasuredFit {
    if study.nuisances.iter().all(|n| n.sd == n.stated_sd) {
        return MeasuredFit { fit: candidates.stated.clone(), nuisances: candidates.base_nuisances.clone() };
    }
    let mut from = candidates.stated.clone();
    from.deviations.iter_mut().for_each(|d| *d = 0.0);
    // The plain model does not contain the established effects.
    let known = |n: Nuisance| match study.nuisances.iter().find(|own| own.is(&n)) {
        Some(own) if own.sd > own.stated_sd => n.with_prior(0.0),
        _ => n,
    };
    let nuisances: Vec<Nuisance> = stated.nuisances_of(&from, &from).into_iter().map(known).collect();
    let now = study.with_nuisances(nuisances.clone());
    let fit = super::candidates::plain_fit(&now, &from);
    MeasuredFit { fit, nuisances }
}

/// The inputs of a judgement.
struct Judging<'a> {
    /// The study with the noise about the best model.
    study: &'a FitInputs<'a>,
    asked: &'a SearchSpace<'a>,
    /// Must the error with an effect of measuring be certainly less, too?
    strict: bool,
    /// Why an effect of measuring is no answer, if that is known.
    refused: Option<&'a str>,
    /// Intervals of the leading fit's values, for models whose slopes are not reliable.
    profiled: Option<&'a [[f64; 2]]>,
}

/// Results of the tests of an evidence table.
struct Judged {
    ruling: Ruling,
    standing: Assessment,
    withheld: Vec<(usize, Vec<String>)>,
    nested: Nested,
}

/// Tests the leading explanation and the leading law, and gives the verdict.
fn judged(with: &Judging, fits: &Fits, table: &EvidenceTable, entries: &[Compared]) -> Judged {
    let mut withheld = Vec::new();
    let mut tested = Tested::default();
    let contenders = fits.contenders();
    let folds = Folds::new(with.study, with.asked, fits, &contenders, entries);
    let nested = |row: usize| folds.nested(table, entries, row);
    let test = |row: usize| {
        let (nested, assessment) = (nested(row), with.assess(fits, table, entries, row));
        let tests = NameTests { study: with.study, table, entries, contenders: &contenders, nested: &nested };
        let mut failed = tests.failed(row, &assessment);
        let form = speed_exponent::form(with.study, fits, row).filter(SpeedExponent::is_refuted);
        failed.extend(form.and_then(|form| form.said()));
        (nested, assessment, failed)
    };
    let mut results = Vec::new();
    let mut lead = leading(entries, SECOND);
    while let Some(row) = lead {
        let (nested, assessment, failed) = test(row);
        let passes = failed.is_empty();
        tested.leading = Some((row, passes));
        results.push((row, nested, assessment));
        if passes {
            break;
        }
        withheld.push((row, failed));
        // If the second cause of a pair fails, one cause may stand alone; if that fails, the next best one.
        let tried = |k: &usize| withheld.iter().any(|w: &(usize, Vec<String>)| w.0 == *k);
        let next = gate::singles(entries).filter(|k| !tried(k));
        lead = next.max_by(|a, b| entries[*a].elpd.total_cmp(&entries[*b].elpd)).filter(|_| withheld.len() < TRIED);
    }
    if let Some(row) = leading_law(entries) {
        let (nested, assessment, failed) = test(row);
        tested.law = Some((row, failed.is_empty()));
        tested.refuted = (assessment.impossible || !nested.is_certain()).then_some(row);
        results.push((row, nested, assessment));
        if !failed.is_empty() {
            withheld.push((row, failed));
        }
    }
    let mut ruling = with_one_name(verdict(entries, tested), fits, entries);
    // What only makes the stress of the law stronger or weaker is a recalibration, so the same test holds for both.
    let factor = ruling.verdict == Verdict::Named && is_strength(&entries[ruling.model].effects);
    if (factor || ruling.verdict == Verdict::Recalibrated)
        && let Some(left) = structure::left(with.study, &fits.contender(ruling.model))
    {
        withheld.push((ruling.model, vec![left]));
        tested.leading = tested.leading.map(|(row, passes)| (row, passes && !factor));
        tested.uneven = true;
        ruling = verdict(entries, tested);
    }
    let measuring = entries[ruling.model].effects.iter().all(|e| matches!(e, Effect::Measuring(_)));
    // What is ambiguous becomes no part of all models, so it must be certain as it is.
    let last = with.strict && ruling.verdict == Verdict::Named || ruling.verdict == Verdict::Ambiguous;
    if last && measuring {
        let own = nested(ruling.model);
        let uncertain = (!own.is_certain()).then(|| own.uncertain());
        let why: Vec<String> = with.refused.map(String::from).into_iter().chain(uncertain).collect();
        if !why.is_empty() {
            withheld.push((ruling.model, why));
            tested.leading = tested.leading.map(|(row, _)| (row, false));
            ruling = verdict(entries, tested);
        }
    }
    // If nothing is named, models that passed all tests are listed, too.
    let passed = [tested.leading, tested.law].into_iter().flatten().filter(|t| t.1 && t.0 != ruling.model);
    let passed = passed.filter(|_| ruling.set.is_empty()).map(|(row, _)| (row, vec![passed_over(entries, row)]));
    withheld.extend(passed);
    let mut measure = |row: usize| match results.iter().position(|r| r.0 == row) {
        Some(k) => {
            let (_, nested, standing) = results.swap_remove(k);
            (nested, standing)
        }
        None => (nested(row), with.assess(fits, table, entries, row)),
    };
    let (mut predicted, mut standing) = measure(ruling.model);
    // A model chosen anew without the predicted conditions must lower the error, too.
    if ruling.set.is_empty() && ruling.model > 0 && predicted.errors[2] >= predicted.errors[0] {
        let base = base(entries);
        ruling.verdict = Verdict::NoneOfThese;
        if ruling.model != base && entries[base].beats[0] {
            ruling = Ruling { model: base, written: Written::Recalibrated, ..ruling };
            (predicted, standing) = measure(base);
        } else if ruling.model != base {
            ruling.written = Written::Proxy;
        }
    }
    Judged { ruling, standing, withheld, nested: predicted }
}

/// Ids of what a row names; a law has none.
fn ids(fits: &Fits, entries: &[Compared], row: usize) -> Vec<String> {
    let nuisances = fits.nuisances(row);
    let id = |effect: &Effect| match effect {
        Effect::Mechanism(id) => CATALOG[*id].id.to_string(),
        Effect::Measuring(k) => super::measured::answer(&nuisances[*k]).to_string(),
    };
    entries[row].effects.iter().map(id).collect()
}

/// Explanations of one name differ only in the channel or the shape, so the name is certain.
fn with_one_name(mut ruling: Ruling, fits: &Fits, entries: &[Compared]) -> Ruling {
    let mut names = ruling.set.iter().map(|&row| ids(fits, entries, row));
    let first = names.next().filter(|own| own.len() == 1);
    let same = ruling.set.len() > 1 && first.is_some_and(|first| names.all(|own| own == first));
    if same && ruling.verdict == Verdict::Ambiguous && !ruling.set.iter().any(|&row| entries[row].unnamed) {
        ruling.verdict = Verdict::Named;
    }
    ruling
}

/// Mechanisms that leave the form of the law's stress, and change its strength everywhere, with the depth, or with the size.
const STRENGTHS: [&str; 3] = ["scale", "depth_power", OF_SIZE];

/// Is one of these the only effect?
fn is_strength(effects: &[Effect]) -> bool {
    matches!(effects, [Effect::Mechanism(id)] if STRENGTHS.contains(&CATALOG[*id].id))
}

impl Judging<'_> {
    fn assess(&self, fits: &Fits, table: &EvidenceTable, entries: &[Compared], row: usize) -> Assessment {
        let leads = fits.candidates.leading.is_some_and(|k| fits.rows[row].place == Place::Candidate(k));
        let weights = self.study.observations.units.iter().map(|unit| {
            // One over the variance of the model's errors in the condition, which is at least the variance of the noise.
            table.weight(&table.rows[row], unit.condition).min(1.0)
        });
        gate::Assessing {
            study: self.study,
            whitener: self.study.whitener.weighted(weights),
            contender: fits.contender(row),
            effects: &entries[row].effects,
            stated: fits.is_stated(row),
            law: fits.law(table, row),
            held: fits.rows[row].role == Role::Beside,
            profiled: self.profiled.filter(|_| leads),
            degrees: table.degrees,
        }
        .assess()
    }
}

/// The entries of a table, for the verdict.
fn entries(study: &FitInputs, table: &EvidenceTable, fits: &Fits, asked: &SearchSpace) -> Vec<Compared> {
    let numbers: Vec<usize> = (0..fits.rows.len()).collect();
    let normal: Vec<Option<NormalEquations>> = parallel::map(&numbers, |&k| {
        let cause = fits.rows[k].role == Role::Causes;
        cause.then(|| study.with_nuisances(fits.nuisances(k).to_vec()).normal_equations(fits.fit(k)))
    });
    let of = |k: usize| {
        let ids = &fits.fit(k).ids;
        let scaled = fits.rows[k].role == Role::Causes && ids.iter().any(|&id| CATALOG[id].id == "scale");
        let hidden = |j: &usize| match fits.fit(*j).ids[..] {
            [other] if fits.rows[*j].role == Role::Causes => {
                scaled && asked.untestable.contains(&other) && FACTORS.contains(&CATALOG[other].id)
            }
            _ => false,
        };
        Compared {
            role: fits.rows[k].role,
            effects: fits.effects(k),
            unnamed: ids.iter().any(|id| asked.untestable.contains(id)),
            unseen: scaled && !asked.unseen.is_empty(),
            alike: (0..fits.rows.len()).filter(hidden).collect(),
            repeats: repeated(study, table, fits, &normal, k),
            elpd: table.elpd(k),
            misfit: table.misfit(k),
            unexplained: table.unexplained(k, 0),
            beats: (0..fits.rows.len()).map(|j| table.beats(k, j)).collect(),
            error: table.error(k),
            lowers: table.lowers(k, 0),
        }
    };
    (0..fits.rows.len()).map(of).collect()
}

/// The rows of causes whose effect the law of row `k` repeats.
fn repeated(
    study: &FitInputs,
    table: &EvidenceTable,
    fits: &Fits,
    normal: &[Option<NormalEquations>],
    k: usize,
) -> Vec<usize> {
    let (Role::Law, Some(law)) = (fits.rows[k].role, table.rows[k].predicted.law) else { return Vec::new() };
    let column: Vec<f64> = fits.contender(k).columns[law].iter().copied().map(f64::from).collect();
    let white = study.whitener.apply(&column);
    let same = |j: &usize| {
        let count = fits.fit(*j).ids.len();
        let share = normal[*j].as_ref().filter(|_| count > 0).and_then(|n| n.explained(&white, count));
        share.is_some_and(|share| share > super::laws::COLLINEAR)
    };
    (0..fits.rows.len()).filter(same).collect()
}

/// For models whose slopes are not reliable: moves the leading fit to the lowest state about it. Returns the intervals
/// of its values.
fn explored(study: &FitInputs, candidates: &mut Candidates) -> Option<Vec<[f64; 2]>> {
    let leading = candidates.leading.filter(|_| study.model.roughness().is_some())?;
    let free = study.observations.repetitions().iter().map(|g| g.len() as f64 - 1.0).sum::<f64>();
    let (lowest, intervals) = profile::explore(study, &candidates.fits[leading], student::square_at_95(free.max(2.0)));
    if lowest.objective < candidates.fits[leading].objective {
        candidates.fits[leading] = lowest;
    }
    Some(intervals)
}
