//! The verdict: one pure function of the table of evidence.

use serde::Serialize;

/// The outcome of a diagnosis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// No model predicts left-out conditions better than the plain model, whose errors are within the scatter of the repetitions.
    NoiseFloor,
    /// One cause, or one pair, explains the main part of the misfit, and no other explanation predicts as well.
    Named,
    /// Several causes explain the misfit, and these data cannot distinguish them.
    Ambiguous,
    /// A law found in the data explains the main part of the misfit, and predicts better than every cause.
    Described,
    /// Neither a mechanism nor a law explains the main part of the misfit.
    NoneOfThese,
    /// There is no noise floor, because there are no repetitions, or only copies.
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
    /// Mechanisms that predict left-out conditions better, but that are probably not the cause.
    Proxy,
    /// The plain model.
    #[default]
    Plain,
}

/// Share of the misfit that a cause or law must explain to be named: our choice, because less than half of the variance
/// of the plain model's errors beyond noise is not the main part.
pub const MAIN_PART: f64 = 0.5;

/// One model of the table.
#[derive(Clone, Debug, PartialEq)]
pub struct Compared {
    /// Number of causes in the model.
    pub causes: usize,
    /// Does it contain a law found in the data?
    pub law: bool,
    /// Must the model not be named, because these data cannot test one of its causes, or because one of them is an effect of measuring?
    pub unnamed: bool,
    /// Does it need an effect of measuring that is far larger than stated?
    pub unlikely: bool,
    /// Entries without a law that have the same causes.
    pub within: Vec<usize>,
    /// Entries that these data cannot test, and that could have the same effects as this entry.
    pub alike: Vec<usize>,
    /// Could a cause that has no entry, because these data do not say whether it acts, look the same?
    pub unseen: bool,
    pub elpd: f64,
    /// Variance of its errors beyond the noise's variance, in units of the noise's variance; 0 if noise alone may cause such errors.
    pub misfit: f64,
    /// Share of the plain model's misfit that remains with this model.
    pub unexplained: f64,
    /// Does it predict better than entry `k`, beyond twice the standard error?
    pub beats: Vec<bool>,
    /// Does it predict better than the plain model, beyond the standard error?
    pub ahead: bool,
    /// Error of the sand alone, without nuisances, on left-out conditions; the plain model's is that without any fit.
    pub error: f64,
}

/// The verdict on a table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ruling {
    pub verdict: Verdict,
    pub written: Written,
    /// The model that is written; 0 is the plain one.
    pub model: usize,
    /// The explanations that the data cannot distinguish, the best first; empty if no explanation is named.
    pub set: Vec<usize>,
    /// The entry of `set` that was added because no other entry of it may be named.
    pub added: Option<usize>,
    /// Entries that are not compared: they give left-out conditions a higher density, but their sand alone has a larger error than the
    /// plain sand.
    pub left_out: Vec<usize>,
}

impl Ruling {
    fn without_name(verdict: Verdict, written: Written, model: usize) -> Self {
        Self { verdict, written, model, set: Vec::new(), added: None, left_out: Vec::new() }
    }
}

impl Compared {
    /// A copy of this entry that takes no part in comparisons.
    fn left_out(&self) -> Self {
        let beats = vec![false; self.beats.len()];
        Self { causes: 0, law: false, elpd: f64::NEG_INFINITY, beats, ahead: false, ..self.clone() }
    }
}

/// The verdict; the first entry of the table is the plain model. `second` is the share of a pair's evidence that its
/// second cause must add.
///
/// A simulator uses the sand alone. So a proxy or a description must also have a smaller error than the plain sand. If
/// its error is not smaller, all models whose error is larger than the plain sand's are left out, and the rest is
/// compared again.
pub fn verdict(table: &[Compared], second: f64) -> Ruling {
    let ruling = by_density(table, second);
    let raises = |k: &usize| table[*k].error >= table[0].error;
    if matches!(ruling.written, Written::Cause | Written::Plain) || !raises(&ruling.model) {
        return ruling;
    }
    let left_out: Vec<usize> = (1..table.len()).filter(|k| table[*k].ahead && raises(k)).collect();
    let of = |(k, entry): (usize, &Compared)| if left_out.contains(&k) { entry.left_out() } else { entry.clone() };
    let rest: Vec<Compared> = table.iter().enumerate().map(of).collect();
    Ruling { left_out, ..by_density(&rest, second) }
}

/// The verdict by the densities of left-out conditions.
fn by_density(table: &[Compared], second: f64) -> Ruling {
    let elpd = |k: usize| table[k].elpd;
    let best_of = |keep: &dyn Fn(&Compared) -> bool| {
        best((1..table.len()).filter(|k| keep(&table[*k])), elpd, |k| table[k].beats[0])
    };
    let size = |k: usize| if table[k].law { 0 } else { table[k].causes };
    let explanation = leading(table.len(), size, elpd, |a, b| table[a].beats[b], second);
    let law = best_of(&|e| e.law && e.causes == 0);
    let Some(best) = best_of(&|_| true) else {
        return without_cause(table);
    };
    let main = |k: &usize| 1.0 - table[*k].unexplained > MAIN_PART;
    let cause = explanation.filter(main).filter(|&c| law.is_none_or(|l| !table[l].beats[c]));
    if let Some(cause) = cause {
        return named(table, cause);
    }
    let law = law.filter(main).filter(|&l| explanation.is_none_or(|c| table[l].elpd >= table[c].elpd));
    if let Some(model) = law {
        return Ruling::without_name(Verdict::Described, Written::Description, model);
    }
    stand_in(table, best, &|k| table[k].beats[0])
}

/// Of some entries the one with the greatest elpd, if any of them predicts `better` than the plain model.
fn best(
    entries: impl Iterator<Item = usize> + Clone,
    elpd: impl Fn(usize) -> f64,
    mut better: impl FnMut(usize) -> bool,
) -> Option<usize> {
    let best = entries.clone().max_by(|a, b| elpd(*a).total_cmp(&elpd(*b)));
    best.filter(|_| entries.into_iter().any(&mut better))
}

/// The best single cause or pair among `count` entries, of which the first is the plain model. It is the entry with the
/// greatest elpd among those with equally many causes, if one of these beats the plain model. A pair must also beat the
/// single cause with the greatest elpd, and its second cause must add the share `second` of the pair's evidence. `size` is
/// the number of causes, 0 for entries that do not count.
pub fn leading(
    count: usize,
    size: impl Fn(usize) -> usize,
    elpd: impl Fn(usize) -> f64,
    beats: impl Fn(usize, usize) -> bool,
    second: f64,
) -> Option<usize> {
    let (size, elpd, beats) = (&size, &elpd, &beats);
    let of_size = |causes: usize| (1..count).filter(move |&k| size(k) == causes);
    let best_of = |causes: usize| best(of_size(causes), elpd, |k| beats(k, 0));
    let simpler = of_size(1).max_by(|a, b| elpd(*a).total_cmp(&elpd(*b)));
    let earns = |pair: usize, single: usize| {
        let [gain, more] = [single, pair].map(|k| elpd(k) - elpd(0));
        beats(pair, single) && more - gain > second * more
    };
    best_of(2).filter(|&pair| simpler.is_none_or(|s| earns(pair, s))).or_else(|| best_of(1))
}

/// The verdict if no model predicts better beyond twice the standard error. If the plain model's errors are larger than noise may
/// cause, there is certainly a misfit. A stand-in (a proxy or a description) then needs less evidence than a cause: one standard
/// error.
fn without_cause(table: &[Compared]) -> Ruling {
    if table[0].misfit <= 0.0 {
        return Ruling::without_name(Verdict::NoiseFloor, Written::Plain, 0);
    }
    let ahead = (1..table.len()).filter(|&k| table[k].ahead);
    match ahead.max_by(|a, b| table[*a].elpd.total_cmp(&table[*b].elpd)) {
        Some(best) => stand_in(table, best, &|k| table[k].ahead),
        None => Ruling::without_name(Verdict::NoneOfThese, Written::Plain, 0),
    }
}

/// The ruling if some models are `better` than the plain model, but none is the cause. A simulator uses only the sand of the written model.
/// So, of the models that the best model does not beat, the one whose sand alone has the smallest error is written.
fn stand_in(table: &[Compared], best: usize, better: &dyn Fn(usize) -> bool) -> Ruling {
    let as_good = (1..table.len()).filter(|&k| better(k) && !table[best].beats[k]);
    let model = as_good.min_by(|a, b| table[*a].error.total_cmp(&table[*b].error)).unwrap_or(best);
    let written = if table[model].causes > 0 { Written::Proxy } else { Written::Description };
    Ruling::without_name(Verdict::NoneOfThese, written, model)
}

/// The verdict if `cause` explains the main part.
fn named(table: &[Compared], cause: usize) -> Ruling {
    let of_size = |k: &usize| table[*k].causes == table[cause].causes && !table[*k].law;
    // A rival is an entry that gains more than half as much as the cause and is not beaten by it. An effect of measuring is
    // no rival if it would have to be far larger than stated.
    let gain = |k: usize| table[k].elpd - table[0].elpd;
    let near = |k: &usize| !table[cause].beats[*k] && gain(*k) > MAIN_PART * gain(cause) && !table[*k].unlikely;
    let rival = |k: &usize| of_size(k) && *k != cause && near(k);
    let mut set: Vec<usize> = (1..table.len()).filter(rival).collect();
    set.sort_by(|a, b| table[*b].elpd.total_cmp(&table[*a].elpd));
    set.insert(0, cause);
    set.extend(table[cause].alike.iter().filter(|k| !set.contains(k)).copied().collect::<Vec<_>>());
    // If no entry of the set may be named, the best entry that may be named is added.
    let mut added = None;
    if set.iter().all(|&k| table[k].unnamed) {
        let others = (1..table.len()).filter(|k| of_size(k) && !table[*k].unnamed);
        added = others.max_by(|a, b| table[*a].elpd.total_cmp(&table[*b].elpd));
        set.extend(added);
    }
    let first = set.iter().position(|&k| !table[k].unnamed).filter(|&k| k > 0 && !table[cause].beats[set[k]]);
    if let Some(place) = first {
        let own = set.remove(place);
        set.insert(0, own);
    }
    let alone = set.len() == 1 && !table[cause].unnamed && !table[set[0]].unseen;
    let verdict = if alone { Verdict::Named } else { Verdict::Ambiguous };
    // A law is written together with the first explanation if both together predict better, and if the explanation alone leaves a misfit.
    let beside = |k: &usize| {
        table[*k].law && table[set[0]].misfit > 0.0 && table[*k].within.contains(&set[0]) && table[*k].beats[set[0]]
    };
    let model = (1..table.len()).find(beside).unwrap_or(set[0]);
    Ruling { verdict, written: Written::Cause, model, set, added, left_out: Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A table in which twice the standard error of each difference is 10.
    fn table(of: &[(usize, bool, f64, f64)]) -> Vec<Compared> {
        let entry = |&(causes, law, elpd, misfit): &(usize, bool, f64, f64)| Compared {
            causes,
            law,
            unnamed: false,
            unlikely: false,
            within: Vec::new(),
            alike: Vec::new(),
            unseen: false,
            elpd,
            misfit,
            unexplained: misfit / of[0].3.max(1e-9),
            beats: of.iter().map(|other| elpd - other.2 > 10.0).collect(),
            ahead: elpd - of[0].2 > 5.0,
            error: -elpd,
        };
        of.iter().map(entry).collect()
    }

    fn of(table: &[Compared]) -> (Verdict, Written, usize, Vec<usize>) {
        let Ruling { verdict, written, model, set, .. } = verdict(table, 0.01);
        (verdict, written, model, set)
    }

    #[test]
    fn the_verdict_follows_from_the_table() {
        use Verdict::*;
        use Written::*;
        let all = [
            // A name needs that no rival predicts as well.
            (vec![(0, false, -100.0, 90.0), (1, false, 0.0, 0.0), (1, false, -50.0, 40.0)], (Named, Cause, 1, vec![1])),
            (
                vec![(0, false, -100.0, 90.0), (1, false, 0.0, 0.0), (1, false, -5.0, 0.0)],
                (Ambiguous, Cause, 1, vec![1, 2]),
            ),
            // An entry that explains hardly anything is no rival, even if it is not beaten.
            (vec![(0, false, -8.0, 0.0), (1, false, 3.0, 0.0), (1, false, -6.0, 0.0)], (Named, Cause, 1, vec![1])),
            // A remainder hides no name, and the smaller part is a proxy.
            (vec![(0, false, -100.0, 100.0), (1, false, 0.0, 40.0)], (Named, Cause, 1, vec![1])),
            (vec![(0, false, -100.0, 100.0), (1, false, 0.0, 60.0)], (NoneOfThese, Proxy, 1, vec![])),
            // A law that predicts better describes.
            (
                vec![(0, false, -100.0, 90.0), (1, false, -40.0, 20.0), (0, true, 0.0, 0.0)],
                (Described, Description, 2, vec![]),
            ),
            (vec![(0, false, -100.0, 90.0), (1, false, -5.0, 0.0), (0, true, 0.0, 0.0)], (Named, Cause, 1, vec![1])),
            // If nothing is better, there is noise or misfit.
            (vec![(0, false, -5.0, 0.0), (1, false, 0.0, 0.0)], (NoiseFloor, Plain, 0, vec![])),
            (vec![(0, false, -5.0, 50.0), (1, false, 0.0, 45.0)], (NoneOfThese, Plain, 0, vec![])),
            (vec![(0, false, -7.0, 50.0), (1, false, 0.0, 45.0)], (NoneOfThese, Proxy, 1, vec![])),
        ];
        for (entries, expected) in all {
            assert_eq!(of(&table(&entries)), expected, "{entries:?}");
        }
    }

    #[test]
    fn an_untestable_effect_is_never_named() {
        let mut near = table(&[(0, false, -100.0, 90.0), (1, false, -5.0, 0.0), (1, false, 0.0, 0.0)]);
        near[2].unnamed = true;
        assert_eq!(of(&near), (Verdict::Ambiguous, Written::Cause, 1, vec![1, 2]));
        let mut alike = table(&[(0, false, -100.0, 90.0), (1, false, 0.0, 0.0), (1, false, -90.0, 80.0)]);
        (alike[1].alike, alike[2].unnamed) = (vec![2], true);
        assert_eq!(of(&alike), (Verdict::Ambiguous, Written::Cause, 1, vec![1, 2]));
        let mut unseen = table(&[(0, false, -100.0, 90.0), (1, false, 0.0, 0.0), (1, false, -90.0, 80.0)]);
        unseen[1].unseen = true;
        assert_eq!(of(&unseen), (Verdict::Ambiguous, Written::Cause, 1, vec![1]));
        let mut far = table(&[(0, false, -100.0, 90.0), (1, false, -50.0, 40.0), (1, false, 0.0, 0.0)]);
        far[2].unnamed = true;
        assert_eq!(of(&far), (Verdict::Ambiguous, Written::Cause, 2, vec![2, 1]));
    }

    /// A pair must beat the best single cause, even if no single cause beats the plain model.
    #[test]
    fn a_pair_beats_the_best_single_cause() {
        let mut pair = table(&[(0, false, -16.0, 0.0), (1, false, -5.0, 0.0), (2, false, -4.6, 0.0)]);
        pair[1].beats[0] = false;
        assert_eq!(of(&pair).1, Written::Proxy);
    }

    /// The entry that is added to a set without names is marked, so that it does not count as an explanation.
    #[test]
    fn an_added_entry_is_marked() {
        let mut far = table(&[(0, false, -100.0, 90.0), (1, false, -50.0, 40.0), (1, false, 0.0, 0.0)]);
        far[2].unnamed = true;
        assert_eq!(verdict(&far, 0.01).added, Some(1));
    }

    #[test]
    fn a_stand_in_lowers_the_error_of_the_sand_alone() {
        let mut entries = table(&[(0, false, -100.0, 90.0), (1, false, 0.0, 60.0), (2, false, -8.0, 60.0)]);
        entries[1].error = 120.0;
        assert_eq!(of(&entries), (Verdict::NoneOfThese, Written::Proxy, 2, Vec::new()));
        entries[2].error = 110.0;
        assert_eq!(of(&entries), (Verdict::NoneOfThese, Written::Plain, 0, Vec::new()));
        assert_eq!(verdict(&entries, 0.01).left_out, [1, 2]);
        // A cause is named whatever the error of its sand alone is.
        entries[1].unexplained = 0.0;
        assert_eq!(of(&entries), (Verdict::Named, Written::Cause, 1, vec![1]));
    }
}
