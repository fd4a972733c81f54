//! The one measure of evidence: how well a model predicts conditions that were left out.
//!
//! **Numbers.** Differences between the repetitions of a condition contain no information on causes, so only the repetitions' mean
//! counts. The whitened numbers of each repetition and channel are projected on the first cosines along the trial (DCT-II), and the
//! repetitions are averaged. For noise alone each of these numbers is standard normal. If the repetitions scatter more along one cosine
//! of a channel than the noise model says, the numbers along it are divided by the standard deviation of this scatter: the model's
//! noise of a sensor is white, but sensors may drift.
//!
//! **Prediction.** Near its fit a model is linear in its parameters: values of causes, deviations of the stress
//! coefficients, and nuisances, each with a normal prior. The posterior from all conditions except c predicts the residual
//! numbers of c with mean J δ and covariance φ V, V = 1 + J Σ Jᵀ/φ. Here J has the derivatives of the model's numbers by
//! the parameters, and δ and Σ are mean and covariance of the parameters' changes from the fit. φ ≥ 1 is the scale of the
//! model's own errors: their variance in the other conditions, divided by the variance of the noise. The variance of the
//! noise is also marginalised. It is estimated from repetitions with ν degrees of freedom, so the prediction is a
//! multivariate Student t, with log density
//!
//! −½ ln |V| − ½ n ln φ − ½ (ν + n) ln(1 + Q/(νφ)) + a constant of the condition, where e = residual − J δ is the error, n
//! its number of components, and Q = eᵀ V⁻¹ e.
//!
//! The sum of these densities over c is the elpd (Vehtari, Gelman & Gabry 2017). If only condition c contains information on a parameter,
//! the prediction of c uses the parameter's prior. So the fastest or deepest condition is predicted with a wide V, and cannot exclude a
//! model by itself. The stated priors of coefficients and nuisances, a deviation of 0 ± 1 each, count as one more condition, so that a
//! model that needs coefficients far from the stated ones has a lower elpd.
//!
//! **Standard error of a difference.** The conditions of an experiment are chosen, and not drawn from a population, so a cause is no
//! less certain because it acts in the fastest condition only. So the standard error says by how much the difference would change if
//! the same conditions were measured again. s = V⁻¹ e is the expected error of the condition itself, without the error of the
//! parameters. Let A be the better model, B the worse model, Δ = s_B − s_A, and w = (ν + n)/(ν + Q/φ)/φ for each model. The errors of
//! one condition change its part of elpd_A − elpd_B by
//!
//! x = w_B Δᵀ s_A − ½ (w_A − w_B)(Q_A − n/w_A), where 1/w_A is the variance of the errors in this condition.
//!
//! The variance of elpd_A − elpd_B is the greater of two estimates. If the errors are noise, it is the sum of w_B² |Δ|²/w_A + ½ n (1 −
//! w_B/w_A)² over conditions. If the errors are the model's own and correlated within a condition, it is the sum of x² (clusters: Liang
//! & Zeger 1986), or, if this is less, the spread of the differences between conditions (Vehtari et al.), because x is of first order
//! and too large where errors are not small. Both estimates are widened by Student's t, the first for ν, the second for the number of
//! conditions. The standard error is at least 2, because differences below 4 are no evidence (Sivula, Magnusson, Matamoros & Vehtari
//! 2020).

use super::differences::{NORMAL, SumPart, summed};
use super::fit::{Fit, Stack};
use super::left_out::{Contender, LawColumn, LeftOutRow, Linear};
use super::normal_equations::value_prior;
use super::study::FitInputs;
use super::whiten::Whitener;
use crate::number::dot;
use crate::parallel;
use nalgebra::{DMatrix, DVector};
use std::borrow::Borrow;
use std::collections::HashMap;
use std::f64::consts::PI;
use std::sync::Arc;

/// Number of cosines along a trial: our choice; features shorter than a sixteenth of a trial count as noise.
const WAVES: usize = 16;
/// Stacks that are whitened together: our choice, as many as a filter takes.
const TOGETHER: usize = super::noise::LANES;
/// The scatter along a cosine replaces the noise model's if it is larger by this many standard errors: our choice, so that
/// chance hardly ever does it (one in 740 times).
const DRIFTS: f64 = 3.0;
/// Prior standard deviation of coefficients and nuisances, in units of the stated ones, if the condition that is left out is the
/// stated priors: our choice, wide.
const UNSTATED: f64 = 10.0;
/// Least standard error: see the text of this module.
pub const LEAST: f64 = 2.0;

/// The comparison of all models under one noise.
pub struct EvidenceTable {
    pub rows: Vec<LeftOutRow>,
    /// n of each condition that is used.
    pub sizes: Vec<f64>,
    /// ν
    pub degrees: f64,
    /// Greatest mean square of errors that noise alone may cause: its mean and two standard deviations of its estimate
    /// (our choice), see [`EvidenceTable::lack`].
    pub limit: f64,
}

/// Projects whitened stacks on the means of the repetitions.
struct Projection<'a> {
    study: &'a FitInputs<'a>,
    whitener: &'a Whitener,
    groups: Vec<Vec<usize>>,
    /// Cosines for each number of samples, wave by wave.
    cosines: HashMap<usize, Vec<Vec<f64>>>,
    /// For each channel and cosine, one over the standard deviation of the noise in units of the noise model's.
    shares: Vec<[f64; WAVES]>,
}

impl<'a> Projection<'a> {
    /// Only the conditions `known` give the scatter of the repetitions.
    fn new(study: &'a FitInputs, whitener: &'a Whitener, known: &[usize]) -> Self {
        let groups = study.observations.repetitions();
        let cosines = study.observations.units.iter().map(|u| (u.samples, cosines(u.samples))).collect();
        let shares = vec![[1.0; WAVES]; study.observations.channels.len()];
        let even = Self { study, whitener, groups, cosines, shares };
        Self { shares: even.scatter(known), ..even }
    }

    /// `shares` from the scatter of the repetitions about their means, which no model changes.
    fn scatter(&self, known: &[usize]) -> Vec<[f64; WAVES]> {
        let white = self.whitener.apply(&self.study.observations.values);
        let mut sums = vec![[[0.0; 2]; WAVES]; self.shares.len()];
        for group in known.iter().map(|&c| &self.groups[c]).filter(|g| g.len() > 1) {
            let (each, waves, count) = (self.each(&white, group), self.waves(group), group.len() as f64);
            for k in 0..each[0].len() {
                let mean = each.iter().map(|e| e[k]).sum::<f64>() / count;
                let [squares, free] = &mut sums[k / waves][k % waves];
                *squares += each.iter().map(|e| (e[k] - mean).powi(2)).sum::<f64>();
                *free += count - 1.0;
            }
        }
        let share = |[squares, free]: [f64; 2]| {
            let variance = squares / free.max(1.0);
            if variance > 1.0 + DRIFTS * (2.0 / free.max(1.0)).sqrt() { variance.sqrt().recip() } else { 1.0 }
        };
        sums.into_iter().map(|channel| channel.map(share)).collect()
    }

    fn waves(&self, group: &[usize]) -> usize {
        group.iter().map(|&u| self.study.observations.units[u].samples).min().unwrap_or(0).min(WAVES)
    }

    /// The numbers of each repetition of a group.
    fn each(&self, white: &[f64], group: &[usize]) -> Vec<Vec<f64>> {
        let o = self.study.observations;
        let waves = self.waves(group);
        let of = |&u: &usize| {
            let unit = &o.units[u];
            let basis = &self.cosines[&unit.samples][..waves];
            let own = |c: usize| {
                basis.iter().zip(&self.shares[c]).map(move |(b, share)| share * dot(b, &white[unit.block(c)]))
            };
            (0..o.channels.len()).flat_map(own).collect()
        };
        group.iter().map(of).collect()
    }

    /// The numbers of every condition of several stacks.
    fn apply(&self, stacks: &[impl Borrow<Vec<f64>> + Sync]) -> Vec<Vec<DVector<f64>>> {
        // A few at a time, because whitened stacks of all models together would take the most memory.
        let some: Vec<_> = stacks.chunks(TOGETHER).collect();
        let made = parallel::map(&some, |some| {
            self.whitener.apply_all(some).into_iter().map(|white| self.means(white)).collect::<Vec<_>>()
        });
        made.into_iter().flatten().collect()
    }

    /// The numbers of each condition: the sum over its whitened repetitions / √n.
    fn means(&self, mut white: Vec<f64>) -> Vec<DVector<f64>> {
        let units = &self.study.observations.units;
        let mean = |group: &Vec<usize>| {
            let root = (group.len() as f64).sqrt();
            // The projection is linear, so repetitions with equally many samples are added before it.
            let alike = group.windows(2).all(|pair| units[pair[0]].samples == units[pair[1]].samples);
            if let (Some((&first, others)), true) = (group.split_first(), alike) {
                let own = self.study.observations.span(&units[first]);
                for &u in others {
                    let other = self.study.observations.span(&units[u]);
                    own.clone().zip(other).for_each(|(to, from)| white[to] += white[from]);
                }
            }
            let each = self.each(&white, if alike { &group[..group.len().min(1)] } else { group });
            let at = |k: usize| each.iter().map(|e| e[k]).sum::<f64>() / root;
            DVector::from_fn(each.first().map_or(0, Vec::len), |k, _| at(k))
        };
        self.groups.iter().map(mean).collect()
    }

    /// Degrees of freedom of the noise: those of the repetitions, or fewer if the scatter of repetitions differs
    /// between conditions. If a variance is itself distributed as inverse χ² with ν degrees of freedom, its relative
    /// variance is 2/(ν − 4). Fewer than three conditions show no difference (our choice).
    fn degrees(&self, residual: &[f64], used: &[usize]) -> f64 {
        let white = self.whitener.apply(residual);
        let (mut squares, mut free, mut expected) = (Vec::new(), 0.0, 0.0);
        for group in used.iter().map(|&c| &self.groups[c]).filter(|g| g.len() > 1) {
            let each = self.each(&white, group);
            let n = each[0].len();
            let mean = |k: usize| each.iter().map(|e| e[k]).sum::<f64>() / each.len() as f64;
            let square: f64 = (0..n).map(|k| each.iter().map(|e| (e[k] - mean(k)).powi(2)).sum::<f64>()).sum();
            let count = (n * (each.len() - 1)) as f64;
            squares.push(square / count);
            expected += 2.0 / count;
            free += (group.len() - 1) as f64;
        }
        let count = squares.len() as f64;
        let mean = squares.iter().sum::<f64>() / count.max(1.0);
        let variance = squares.iter().map(|s| (s / mean - 1.0).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
        let beyond = variance - expected / count.max(1.0);
        let uneven = if count > 2.0 && beyond > 0.0 { 4.0 + 2.0 / beyond } else { f64::INFINITY };
        uneven.min(free).max(1.0)
    }
}

/// Orthonormal cosines (DCT-II) over `n` samples.
fn cosines(n: usize) -> Vec<Vec<f64>> {
    let of = |k: usize| {
        let norm = if k == 0 { (1.0 / n as f64).sqrt() } else { (2.0 / n as f64).sqrt() };
        (0..n).map(|i| norm * (PI * k as f64 * (i as f64 + 0.5) / n as f64).cos()).collect()
    };
    (0..n.min(WAVES)).map(of).collect()
}

/// Models near their fits, as numbers of every condition. A table of any conditions follows from them.
pub struct EvidenceNumbers<'a> {
    study: &'a FitInputs<'a>,
    models: &'a [Contender<'a>],
    projection: Projection<'a>,
    linear: Vec<Linear>,
}

impl<'a> EvidenceNumbers<'a> {
    /// The numbers of `models` in all conditions; the first model is the plain one. Only the conditions `known` give
    /// the scatter of repetitions.
    pub fn new(study: &'a FitInputs, whitener: &'a Whitener, models: &'a [Contender], known: &[usize]) -> Self {
        let projection = Projection::new(study, whitener, known);
        // Fits share columns; two columns are the same if they have the same address.
        let place = |c: &Stack| Arc::as_ptr(c) as usize;
        let mut unique: Vec<Stack> = models.iter().flat_map(|m| &m.fit.slopes).cloned().collect();
        unique.sort_by_key(place);
        unique.dedup_by_key(|c| place(c));
        let projected = projection.apply(&unique);
        let columns: HashMap<_, _> = unique.iter().map(place).zip(&projected).collect();
        // The projected columns of each law, and the prior standard deviations of their coefficients.
        let laws = |m: &Contender| {
            let doubles = |law: &LawColumn| law.iter().copied().map(f64::from).collect();
            let of = |some: &&[LawColumn]| {
                let columns: Vec<Vec<f64>> = some.iter().map(doubles).collect();
                let widths = columns.iter().map(|column| width(column, &m.fit.prediction));
                projection.apply(&columns).into_iter().zip(widths).collect::<Vec<_>>()
            };
            let made = parallel::map(&m.columns.chunks(TOGETHER).collect::<Vec<_>>(), of);
            made.into_iter().flatten().collect::<Vec<_>>()
        };
        let residuals = projection.apply(&models.iter().map(|m| residual(study, m)).collect::<Vec<_>>());
        let of = |(m, residual): (&Contender, Vec<DVector<f64>>)| {
            // The stated priors of coefficients and nuisances are one more condition, whose numbers are the deviations, each 0 ± 1.
            let (count, values) = (m.fit.deviations.len(), m.fit.ids.len());
            let own: Vec<&Vec<DVector<f64>>> = m.fit.slopes.iter().map(|c| columns[&place(c)]).collect();
            let of_condition = |c: usize| {
                DMatrix::from_fn(residual[c].len(), own.len(), |number, parameter| own[parameter][c][number])
            };
            let stated = DMatrix::from_fn(count, own.len(), |i, k| if k == values + i { 1.0 } else { 0.0 });
            let slopes = (0..residual.len()).map(of_condition).chain([stated]).collect();
            let deviations = DVector::from_fn(count, |i, _| -m.fit.deviations[i]);
            let (laws, widths) = laws(m).into_iter().unzip();
            let residual = residual.into_iter().chain([deviations]).collect();
            Linear { residual, slopes, laws, prior: prior(m.fit), widths }
        };
        let linear = models.iter().zip(residuals).map(of).collect();
        Self { study, models, projection, linear }
    }

    /// The table of the conditions `used` alone.
    pub fn table(&self, used: &[usize]) -> EvidenceTable {
        let (projection, models) = (&self.projection, self.models);
        let degrees = models.first().map_or(1.0, |m| projection.degrees(&residual(self.study, m), used));
        let rows = parallel::map(&self.linear, |linear| linear.row(used, degrees));
        let size = |&c: &usize| (projection.waves(&projection.groups[c]) * projection.shares.len()) as f64;
        let stated = models.first().map(|m| m.fit.deviations.len() as f64);
        let sizes: Vec<f64> = used.iter().map(size).chain(stated).collect();
        let free = used.iter().map(|&c| projection.groups[c].len() as f64 - 1.0).sum::<f64>().min(degrees).max(1.0);
        let limit = 1.0 + 2.0 * (2.0 / sizes.iter().sum::<f64>().max(1.0) + 2.0 / free).sqrt();
        EvidenceTable { rows, sizes, degrees, limit }
    }
}

fn residual(study: &FitInputs, m: &Contender) -> Vec<f64> {
    study.observations.values.iter().zip(m.reading()).map(|(y, m)| y - m).collect()
}

impl EvidenceTable {
    /// Compares `models` in all conditions; the first is the plain one.
    pub fn new(study: &FitInputs, whitener: &Whitener, models: &[Contender]) -> Self {
        let all: Vec<usize> = (0..study.observations.conditions.len()).collect();
        EvidenceNumbers::new(study, whitener, models, &all).table(&all)
    }

    /// The elpd of row `k`.
    pub fn elpd(&self, k: usize) -> f64 {
        self.rows[k].elpd.iter().sum()
    }

    /// Rows by their elpd, the greatest first.
    pub fn ranked(&self, rows: impl Iterator<Item = usize>) -> Vec<usize> {
        let mut order: Vec<usize> = rows.collect();
        order.sort_by(|a, b| self.elpd(*b).total_cmp(&self.elpd(*a)));
        order
    }

    /// elpd of `a` minus elpd of `b`, and the standard error of this difference.
    pub fn difference(&self, a: usize, b: usize) -> [f64; 2] {
        if a == b {
            return [0.0; 2];
        }
        let (best, other, sign) = if self.elpd(a) >= self.elpd(b) { (a, b, 1.0) } else { (b, a, -1.0) };
        let parts: Vec<SumPart> = (0..self.sizes.len()).map(|c| self.part(best, other, c)).collect();
        let [difference, error] = summed(&parts, self.degrees);
        [sign * difference, error.max(LEAST)]
    }

    /// What condition `c` adds to the elpd of `best` minus the elpd of `other`.
    pub fn part(&self, best: usize, other: usize, c: usize) -> SumPart {
        let [own, others] = [best, other].map(|k| self.weight(&self.rows[k], c));
        let [ours, theirs] = [best, other].map(|k| &self.rows[k].predicted.left[c]);
        let (n, variance, apart) = (self.sizes[c], own.recip(), &theirs.solved - &ours.solved);
        let along = others * apart.dot(&ours.solved);
        SumPart {
            gain: self.rows[best].elpd[c] - self.rows[other].elpd[c],
            noise: variance * others.powi(2) * apart.norm_squared() + 0.5 * n * (1.0 - others * variance).powi(2),
            clusters: (along - 0.5 * (own - others) * (ours.square - n * variance)).powi(2),
        }
    }

    /// The same for squares of errors: by how much those of `best` are less than those of `other`, in units of the noise's variance. If the
    /// condition is measured again, its own expected error s changes, and the errors of the parameters, which other conditions give, stay.
    pub fn lowered(&self, best: usize, other: usize, c: usize) -> SumPart {
        let [ours, theirs] = [best, other].map(|k| &self.rows[k].predicted.left[c]);
        let (apart, variance) = (&theirs.error - &ours.error, self.weight(&self.rows[best], c).recip());
        SumPart {
            gain: theirs.error.norm_squared() - ours.error.norm_squared(),
            noise: 4.0 * variance * apart.norm_squared(),
            clusters: (2.0 * apart.dot(&ours.solved)).powi(2),
        }
    }

    /// Root mean square of the errors of row `k` in measured conditions, in units of the noise.
    pub fn error(&self, k: usize) -> f64 {
        let measured = self.sizes.len() - 1;
        let square: f64 = self.rows[k].predicted.left[..measured].iter().map(|own| own.error.norm_squared()).sum();
        (square / self.sizes[..measured].iter().sum::<f64>().max(1.0)).sqrt()
    }

    /// Are the errors of row `a` less than those of row `b`, beyond the 95 % interval of the difference of their squares?
    pub fn lowers(&self, a: usize, b: usize) -> bool {
        let parts: Vec<SumPart> = (0..self.sizes.len() - 1).map(|c| self.lowered(a, b, c)).collect();
        let [difference, error] = summed(&parts, self.degrees);
        a != b && difference > NORMAL * error
    }

    /// w of condition `c`: one over the variance of the errors of the row's model in this condition, in units of the noise's variance.
    pub fn weight(&self, row: &LeftOutRow, c: usize) -> f64 {
        let (n, scale) = (self.sizes[c], row.scales[c]);
        (self.degrees + n) / (self.degrees + row.predicted.left[c].square / scale) / scale
    }

    /// Does `a` predict left-out conditions better than `b`, beyond twice the standard error?
    pub fn beats(&self, a: usize, b: usize) -> bool {
        let [difference, error] = self.difference(a, b);
        difference > 2.0 * error
    }

    /// By how much each measured condition speaks for `a` and against `b`.
    pub fn shares(&self, a: usize, b: usize) -> Vec<f64> {
        let measured = self.sizes.len() - 1;
        let each = self.rows[a].elpd.iter().zip(&self.rows[b].elpd).map(|(a, b)| a - b);
        each.take(measured).collect()
    }

    /// Mean square of the errors of row `k`, in units of the noise's variance: 1 for noise alone.
    pub fn lack(&self, k: usize) -> f64 {
        self.rows[k].predicted.left.iter().map(|own| own.square).sum::<f64>() / self.sizes.iter().sum::<f64>().max(1.0)
    }

    /// Variance of the errors of row `k` beyond the noise's variance, in units of the noise's variance; 0 if noise alone may cause such errors.
    pub fn misfit(&self, k: usize) -> f64 {
        if self.lack(k) <= self.limit { 0.0 } else { self.lack(k) - 1.0 }
    }

    /// The misfit of row `k` as a share of that of row `base`. If the errors of `base` are smaller than noise and the stated
    /// errors of the model would give, by more than chance, the mean square of all errors takes the place of the misfit.
    pub fn unexplained(&self, k: usize, base: usize) -> f64 {
        if self.lack(base) * self.limit < 1.0 {
            return self.lack(k) / self.lack(base).max(1e-9);
        }
        self.misfit(k) / self.misfit(base).max(1e-9)
    }
}

/// Precision and score of each parameter's prior at the fit.
fn prior(fit: &Fit) -> Vec<[f64; 2]> {
    let value = |(&id, at): (&usize, f64)| value_prior(id, at);
    let deviation = |d: &f64| [UNSTATED.powi(-2), -d * UNSTATED.powi(-2)];
    fit.ids.iter().zip(fit.coordinates()).map(value).chain(fit.deviations.iter().map(deviation)).collect()
}

/// Prior standard deviation of a law's coefficient: with it, the law's effect is as large as the whole prediction. Our choice.
fn width(column: &[f64], prediction: &[f64]) -> f64 {
    (dot(prediction, prediction) / dot(column, column).max(1e-300)).sqrt()
}
