//! The verdict: one pure function of the table of evidence and of what its leading model was tested for.

use super::rivals::{is_beaten, rivals};
use serde::Serialize;

pub use super::compared::{Compared, Effect, Role, base};

/// The outcome of a diagnosis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// No model predicts left-out conditions better than the plain model, whose errors are within the scatter of the repetitions.
    NoiseFloor,
    /// The law fits, the stated coefficients do not.
    Recalibrated,
    /// One cause, or one pair, explains the main part of the misfit, and no other explanation predicts as well.
    Named,
    /// Several causes explain the misfit, and these data cannot distinguish them.
    Ambiguous,
    /// A law found in the data explains the main part of the misfit, and predicts better than every cause.
    Described,
    /// No explanation passes all tests, but the plain model certainly errs.
    NoneOfThese,
    /// There is no noise floor, because there are no repetitions, or only copies; or there are fewer than three conditions.
    #[default]
    InsufficientData,
}

/// What `sand.toml` contains.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Written {
    /// A named cause, or the best of an ambiguity set.
    Cause,
    /// A law found in the data.
    Description,
    /// A model that predicts left-out conditions better, but that is not held for the cause.
    Proxy,
    /// The stated sand with fitted coefficients.
    Recalibrated,
    /// The plain model.
    #[default]
    Plain,
}

/// A cause must explain more than this share of the plain model's misfit: our choice. A smaller part is not the main part. The plain model
/// is row 0 of the table, so this share and `remainder.fraction` of the report are measured alike.
pub const MAIN_PART: f64 = 0.5;

/// The verdict on a table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ruling {
    pub verdict: Verdict,
    pub written: Written,
    /// The model that is written; 0 is the plain one.
    pub model: usize,
    /// The explanations that the data cannot distinguish, the best first; empty if no explanation is named.
    pub set: Vec<usize>,
}

/// The models that may be the answer, and whether they passed the tests that a name needs beside the table.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tested {
    pub leading: Option<(usize, bool)>,
    pub law: Option<(usize, bool)>,
    /// A law that sand cannot follow, or that does not predict better if it is chosen anew: it explains nothing.
    pub refuted: Option<usize>,
    /// Is the rest that fitted coefficients leave more than noise? Then the law does not fit.
    pub uneven: bool,
}

/// The entry that is written if no cause or law is: the base, if its coefficients predict better than the stated ones.
pub fn without_cause(table: &[Compared]) -> usize {
    let base = base(table);
    let stated = table.iter().position(|e| e.role == Role::Established).unwrap_or(0);
    let better = if stated == 0 { recalibrates(table) } else { table[base].beats[stated] };
    if better { base } else { stated }
}

/// Do fitted coefficients predict left-out conditions better than the stated ones: by the density beyond twice its standard
/// error, or by the error beyond its 95 % interval?
fn recalibrates(table: &[Compared]) -> bool {
    let base = &table[base(table)];
    (base.beats[0] && base.error < table[0].error) || base.lowers
}

/// The best single explanation or the best pair. It is the entry with the greatest elpd among those with equally many effects, if
/// one of these beats the base. A pair must also beat the best single one, and its second effect must add the share `second` of
/// the pair's evidence.
pub fn leading(table: &[Compared], second: f64) -> Option<usize> {
    let of_size = |count: usize| {
        (0..table.len()).filter(move |&k| table[k].role == Role::Causes && table[k].effects.len() == count)
    };
    let base = base(table);
    let own = table[base].effects.len();
    let top = |count: usize| of_size(count).max_by(|a, b| table[*a].elpd.total_cmp(&table[*b].elpd));
    let best_of = |count: usize| top(count).filter(|_| of_size(count).any(|k| table[k].beats[base]));
    let earns = |pair: usize, single: usize| {
        let [gain, more] = [single, pair].map(|k| table[k].elpd - table[base].elpd);
        table[pair].beats[single] && more - gain > second * more
    };
    let simpler = top(own + 1);
    best_of(own + 2).filter(|&pair| simpler.is_none_or(|s| earns(pair, s))).or_else(|| best_of(own + 1))
}

/// The best law alone, if it beats the base.
pub fn leading_law(table: &[Compared]) -> Option<usize> {
    let base = base(table);
    (0..table.len()).find(|&k| table[k].role == Role::Law && table[k].beats[base])
}

/// What is written if `k` is the answer: together with a law if both together predict better, and if `k` alone leaves a misfit.
fn written(table: &[Compared], k: usize) -> usize {
    let beside = |&b: &usize| {
        let own = table[b].role == Role::Beside && table[b].effects == table[k].effects;
        own && table[k].misfit > 0.0 && table[b].beats[k] && table[b].error < table[k].error
    };
    (0..table.len()).find(beside).unwrap_or(k)
}

/// Does an entry explain the main part of the plain model's misfit?
fn is_main(entry: &Compared) -> bool {
    1.0 - entry.unexplained > MAIN_PART
}

/// Why an entry that passed all tests is not the answer, in words.
pub fn passed_over(table: &[Compared], k: usize) -> String {
    match is_main(&table[k]) {
        false => "it explains less than half of the plain model's error".into(),
        true => "another explanation predicts left-out conditions better".into(),
    }
}

/// The verdict. The first entry of the table is the plain model.
pub fn verdict(table: &[Compared], tested: Tested) -> Ruling {
    let passed = |of: Option<(usize, bool)>| of.filter(|o| o.1).map(|o| o.0).filter(|k| is_main(&table[*k]));
    let (cause, law) = (passed(tested.leading).filter(|c| !is_beaten(table, *c)), passed(tested.law));
    // Data in which a free law beats the cause whose effect it repeats reject the form of this cause.
    let better_law = |c: usize| law.is_some_and(|l| table[l].beats[c]);
    if let Some(cause) = cause.filter(|c| !better_law(*c)) {
        return named(table, cause, tested.refuted);
    }
    let beaten = |l: &usize| tested.leading.is_some_and(|(c, _)| table[c].beats[*l]);
    if let Some(model) = law.filter(|l| !beaten(l)) {
        return Ruling { verdict: Verdict::Described, written: Written::Description, model, set: Vec::new() };
    }
    if let Some(established) = table.iter().position(|e| e.role == Role::Established) {
        let model = without_cause(table);
        return Ruling { verdict: Verdict::Named, written: Written::Cause, model, set: vec![established] };
    }
    unexplained(table, tested.uneven)
}

/// The verdict if neither a cause nor a law is given. `uneven`: see [`Tested`].
fn unexplained(table: &[Compared], uneven: bool) -> Ruling {
    let base = base(table);
    let of = |verdict, written, model| Ruling { verdict, written, model, set: Vec::new() };
    let over = |than: usize| {
        (1..table.len()).filter(move |&k| k != base && table[k].role != Role::Absent && table[k].beats[than])
    };
    let stand_in = |from: usize| {
        let best = over(from).max_by(|a, b| table[*a].elpd.total_cmp(&table[*b].elpd))?;
        let as_good = over(from).filter(|&k| !table[best].beats[k] && table[k].error < table[from].error);
        as_good.min_by(|a, b| table[*a].error.total_cmp(&table[*b].error))
    };
    let written = |k: usize| match table[k].role {
        Role::Law => Written::Description,
        _ => Written::Proxy,
    };
    if recalibrates(table) {
        // The law fits if noise may cause the errors that fitted coefficients leave. That nothing predicts better is no proof of it: what
        // is wrong may be outside of all causes and laws.
        let fits = table[base].misfit <= 0.0 && !uneven;
        return match stand_in(base).filter(|_| !fits) {
            Some(model) => of(Verdict::NoneOfThese, written(model), model),
            None if fits => of(Verdict::Recalibrated, Written::Recalibrated, base),
            // Nothing predicts better, or only with a larger error.
            None => of(Verdict::NoneOfThese, Written::Recalibrated, base),
        };
    }
    // What predicts better than the plain model stands in for it, even if its errors are larger.
    match stand_in(0).or_else(|| over(0).max_by(|a, b| table[*a].elpd.total_cmp(&table[*b].elpd))) {
        Some(model) => of(Verdict::NoneOfThese, written(model), model),
        None if table[0].misfit > 0.0 => of(Verdict::NoneOfThese, Written::Plain, 0),
        None => of(Verdict::NoiseFloor, Written::Plain, 0),
    }
}

/// The verdict if `cause` passed all tests. A law that predicts as well is a rival like every other.
fn named(table: &[Compared], cause: usize, refuted: Option<usize>) -> Ruling {
    let mut set = vec![cause];
    set.extend(rivals(table, cause).into_iter().filter(|r| Some(*r) != refuted));
    set.extend(table[cause].alike.iter().filter(|k| !set.contains(k)).copied().collect::<Vec<_>>());
    // The best that may be named comes first.
    if let Some(place) = set.iter().position(|&k| !table[k].unnamed && table[k].role != Role::Law) {
        let own = set.remove(place);
        set.insert(0, own);
    }
    let alone = set.len() == 1 && !table[cause].unnamed && !table[cause].unseen;
    let verdict = if alone { Verdict::Named } else { Verdict::Ambiguous };
    let model = written(table, set[0]);
    Ruling { verdict, written: Written::Cause, model, set }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(role: Role, effects: &[usize], elpd: f64) -> Compared {
        Compared {
            role,
            effects: effects.iter().map(|e| Effect::Mechanism(*e)).collect(),
            unnamed: false,
            unseen: false,
            alike: Vec::new(),
            repeats: Vec::new(),
            elpd,
            misfit: 0.0,
            unexplained: 0.0,
            beats: Vec::new(),
            error: -elpd,
            lowers: false,
        }
    }

    /// Twice the standard error of each difference is 10.
    fn table(mut all: Vec<Compared>) -> Vec<Compared> {
        let elpd: Vec<f64> = all.iter().map(|e| e.elpd).collect();
        all.iter_mut().for_each(|e| e.beats = elpd.iter().map(|other| e.elpd - other > 10.0).collect());
        all
    }

    fn plain(elpd: f64) -> Compared {
        entry(Role::Plain, &[], elpd)
    }

    fn ruled(table: &[Compared], passes: bool) -> (Verdict, Written, usize, Vec<usize>) {
        let tested = Tested {
            leading: leading(table, 0.01).map(|k| (k, passes)),
            law: leading_law(table).map(|k| (k, passes)),
            ..Tested::default()
        };
        let Ruling { verdict, written, model, set } = verdict(table, tested);
        (verdict, written, model, set)
    }

    #[test]
    fn a_name_needs_that_no_rival_of_any_kind_predicts_as_well() {
        use Role::*;
        let of = |rest: Vec<Compared>| {
            let mut all = vec![plain(-120.0), entry(Base, &[], -100.0)];
            all.extend(rest);
            ruled(&table(all), true)
        };
        let named = (Verdict::Named, Written::Cause, 2, vec![2]);
        assert_eq!(of(vec![entry(Causes, &[0], 0.0), entry(Causes, &[1], -50.0)]), named);
        let two = of(vec![entry(Causes, &[0], 0.0), entry(Causes, &[1], -5.0)]);
        assert_eq!(two, (Verdict::Ambiguous, Written::Cause, 2, vec![2, 3]));
        // A pair with the cause is no rival, and a pair that hardly predicts better is not named.
        assert_eq!(of(vec![entry(Causes, &[0], 0.0), entry(Causes, &[0, 1], 5.0)]), named);
        assert_eq!(of(vec![entry(Causes, &[0], 0.0), entry(Causes, &[1, 2], -5.0)]).0, Verdict::Ambiguous);
        // What another explanation beats is not the answer, even if that one fails a test.
        let better =
            table(vec![plain(-120.0), entry(Base, &[], -100.0), entry(Causes, &[0], 0.0), entry(Causes, &[1], -50.0)]);
        let tested = Tested { leading: Some((3, true)), ..Tested::default() };
        assert_eq!(verdict(&better, tested).set, Vec::<usize>::new());
        // What the best model does not beat beyond its own standard error is a rival, even if the cause alone beats it.
        let mut near = table(vec![
            plain(-120.0),
            entry(Base, &[], -100.0),
            entry(Causes, &[0], -4.0),
            entry(Causes, &[0, 1], 0.0),
            entry(Causes, &[2], -16.0),
        ]);
        near[3].beats[4] = false;
        assert_eq!(ruled(&near, true), (Verdict::Ambiguous, Written::Cause, 2, vec![2, 4]));
        // A weak rival is a rival, too.
        let weak = of(vec![entry(Causes, &[0], -85.0), entry(Causes, &[1], -93.0)]);
        assert_eq!(weak, (Verdict::Ambiguous, Written::Cause, 2, vec![2, 3]));
        // A tie between a law and a cause is a tie; a law that predicts better describes.
        let law = |elpd: f64| of(vec![entry(Causes, &[0], 0.0), entry(Law, &[], elpd)]);
        assert_eq!(law(-5.0), (Verdict::Ambiguous, Written::Cause, 2, vec![2, 3]));
        assert_eq!(law(15.0), (Verdict::Described, Written::Description, 3, vec![]));
        let mut same = entry(Law, &[], -5.0);
        same.repeats = vec![2];
        assert_eq!(of(vec![entry(Causes, &[0], 0.0), same.clone()]), named);
        // A law that repeats a cause and beats it rejects the cause's form.
        same.elpd = 15.0;
        assert_eq!(of(vec![entry(Causes, &[0], 0.0), same]).0, Verdict::Described);
    }

    #[test]
    fn what_fails_a_test_is_not_named() {
        use Role::*;
        let of = |rest: Vec<Compared>| {
            let mut all = vec![plain(-120.0), entry(Base, &[], -100.0)];
            all.extend(rest);
            ruled(&table(all), false)
        };
        // If fitted coefficients leave no misfit, the law fits.
        assert_eq!(of(vec![entry(Causes, &[0], 0.0)]), (Verdict::Recalibrated, Written::Recalibrated, 1, vec![]));
        let mut misfit = table(vec![plain(-120.0), entry(Base, &[], -100.0), entry(Causes, &[0], 0.0)]);
        misfit[1].misfit = 9.0;
        assert_eq!(ruled(&misfit, false), (Verdict::NoneOfThese, Written::Proxy, 2, vec![]));
        assert_eq!(of(vec![entry(Causes, &[0], -95.0)]), (Verdict::Recalibrated, Written::Recalibrated, 1, vec![]));
        // The smaller part is not the main part.
        let mut small = table(vec![plain(-120.0), entry(Base, &[], -100.0), entry(Causes, &[0], 0.0)]);
        (small[1].misfit, small[2].unexplained) = (9.0, 0.6);
        assert_eq!(ruled(&small, true).0, Verdict::NoneOfThese);
        assert!(passed_over(&small, 2).contains("less than half"));
    }

    #[test]
    fn without_a_better_model_there_is_noise_or_misfit() {
        use Role::*;
        let mut all = table(vec![plain(-5.0), entry(Base, &[], -4.0), entry(Causes, &[0], 0.0)]);
        assert_eq!(ruled(&all, true), (Verdict::NoiseFloor, Written::Plain, 0, vec![]));
        all[0].misfit = 50.0;
        assert_eq!(ruled(&all, true), (Verdict::NoneOfThese, Written::Plain, 0, vec![]));
        all[1].lowers = true;
        assert_eq!(ruled(&all, true), (Verdict::Recalibrated, Written::Recalibrated, 1, vec![]));
        // What fitted coefficients leave must be noise, even if nothing predicts better.
        let uneven = Tested { uneven: true, ..Tested::default() };
        assert_eq!(verdict(&all, uneven).verdict, Verdict::NoneOfThese);
        assert_eq!(verdict(&all, uneven).written, Written::Recalibrated);
        all[1].misfit = 9.0;
        assert_eq!(ruled(&all, true), (Verdict::NoneOfThese, Written::Recalibrated, 1, vec![]));
        // What predicts better than the plain model is written, even if its errors are larger.
        let mut wide = table(vec![plain(-120.0), entry(Base, &[], -119.0), entry(Causes, &[0], 0.0)]);
        wide[2].error = 200.0;
        assert_eq!(ruled(&wide, false), (Verdict::NoneOfThese, Written::Proxy, 2, vec![]));
    }

    #[test]
    fn an_untestable_effect_is_never_named() {
        use Role::*;
        let mut near =
            table(vec![plain(-120.0), entry(Base, &[], -100.0), entry(Causes, &[0], -5.0), entry(Causes, &[1], 0.0)]);
        near[3].unnamed = true;
        assert_eq!(ruled(&near, true), (Verdict::Ambiguous, Written::Cause, 2, vec![2, 3]));
        near[3].unnamed = false;
        near[3].unseen = true;
        near[2].elpd = -90.0;
        let near = table(near);
        assert_eq!(ruled(&near, true), (Verdict::Ambiguous, Written::Cause, 3, vec![3]));
    }

    #[test]
    fn what_is_established_is_named() {
        use Role::*;
        let established = |role, elpd| entry(role, &[7], elpd);
        let all =
            vec![plain(-120.0), established(Established, 0.0), established(Base, 1.0), entry(Causes, &[7, 1], 2.0)];
        assert_eq!(ruled(&table(all.clone()), true), (Verdict::Named, Written::Cause, 1, vec![1]));
        let mut more = all;
        more[3].elpd = 40.0;
        assert_eq!(ruled(&table(more), true), (Verdict::Named, Written::Cause, 3, vec![3]));
    }
}
