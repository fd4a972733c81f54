//! Which causes and nuisances the motions of an experiment can tell apart at all, before any force is looked at.
//!
//! The effect of each cause at its typical strength is whitened with a stated noise and reduced by what the stress coefficients and
//! the nuisances can imitate within their priors. What is left, and is not proportional to the effect of a second cause or nuisance,
//! is the distance of the two in standard deviations. All of this depends on the motions and on the experiment file alone.

use crate::fit::slope;
use crate::gram::gram;
use crate::noise::{ChannelNoise, Noise, NoiseClock, NoiseData, sizes_of};
use crate::nuisance::{Nuisance, kind};
use crate::sand::mechanism::CATALOG;
use crate::series::root_mean_square;
use crate::shared::Uncertainty;
use crate::study::FitInputs;
use crate::whiten::Whitener;
use nalgebra::DMatrix;
use serde::Serialize;
use std::collections::BTreeMap;

/// The stated noise: grains that push with a scatter of 5 % of the force, correlated over a few samples, and a sensor that resolves 1 %
/// of its channel's rms. Our choice, usual for careful repetitions; the repetitions of the data give the real noise later.
const GRAINS: f64 = 0.05;
const CORRELATION: f64 = 0.7;
const SENSOR: f64 = 0.01;
/// Two effects are told apart from this distance on [σ]: our choice; below it the study of this method hardly ever could.
pub const APART: f64 = 4.0;
/// The name under which the plain model stands in pairs.
pub const PLAIN: &str = "plain";

/// Numbers of the experiment, and what its motions separate.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ExperimentDesign {
    pub conditions: usize,
    /// Least number of repetitions of a condition.
    pub repetitions: usize,
    pub trials: usize,
    /// Number of places in the bed; None if the log does not say.
    pub places: Option<usize>,
    /// The size of each cause's effect for which the σ are given: value and unit.
    pub sizes: BTreeMap<String, (f64, String)>,
    /// Pairs that are told apart, with their distance [σ] at the size of the first.
    pub separable: Vec<(String, String, f64)>,
    pub cannot_separate: Vec<(String, String)>,
}

/// Effects in the whitened data: causes first, then coefficients and nuisances.
struct Effects {
    causes: Vec<usize>,
    nuisances: Vec<String>,
    /// Products of all columns with each other.
    products: DMatrix<f64>,
}

impl Effects {
    /// Products of the chosen effects when all other marginal effects are free within their priors.
    fn marginalised(&self, chosen: &[usize]) -> DMatrix<f64> {
        let all = self.causes.len()..self.products.nrows();
        let free: Vec<usize> = all.filter(|k| !chosen.contains(k)).collect();
        let part = |rows: &[usize], columns: &[usize]| {
            DMatrix::from_fn(rows.len(), columns.len(), |i, j| self.products[(rows[i], columns[j])])
        };
        let own = part(chosen, chosen);
        let cross = part(&free, chosen);
        let inner = part(&free, &free) + DMatrix::identity(free.len(), free.len());
        inner.cholesky().map_or(own.clone(), |c| own - cross.transpose() * c.solve(&cross))
    }

    /// Distance of effect `a` from nothing [σ].
    fn size(&self, a: usize) -> f64 {
        self.marginalised(&[a])[(0, 0)].max(0.0).sqrt()
    }

    /// Distance of effect `a` from every multiple of effect `b` [σ].
    fn distance(&self, a: usize, b: usize) -> f64 {
        let own = self.marginalised(&[a, b]);
        let rest = own[(0, 0)] - own[(0, 1)].powi(2) / own[(1, 1)].max(1e-12);
        rest.max(0.0).sqrt()
    }
}

/// The design of the data of `study`; `uncertainty` has the errors that the model states beside the noise.
pub fn design(study: &FitInputs, uncertainty: &Uncertainty) -> ExperimentDesign {
    let effects = effects(study, uncertainty);
    let repetitions = study.observations.repetitions();
    let mut design = ExperimentDesign {
        conditions: repetitions.iter().filter(|units| !units.is_empty()).count(),
        repetitions: repetitions.iter().map(Vec::len).filter(|n| *n > 0).min().unwrap_or(0),
        trials: study.observations.units.len(),
        places: places(study),
        sizes: effects.causes.iter().map(|&id| (CATALOG[id].id.into(), size_of(id))).collect(),
        ..ExperimentDesign::default()
    };
    let id = |k: usize| CATALOG[effects.causes[k]].id.to_string();
    let mut add = |a: String, b: String, distance: f64| match distance >= APART {
        true => design.separable.push((a, b, (10.0 * distance).round() / 10.0)),
        false => design.cannot_separate.push((a, b)),
    };
    let sizes: Vec<f64> = (0..effects.causes.len()).map(|k| effects.size(k)).collect();
    (0..sizes.len()).for_each(|k| add(id(k), PLAIN.into(), sizes[k]));
    let seen: Vec<usize> = (0..sizes.len()).filter(|&k| sizes[k] >= APART).collect();
    for (n, &a) in seen.iter().enumerate() {
        for &b in &seen[n + 1..] {
            let both = [(a, b, effects.distance(a, b)), (b, a, effects.distance(b, a))];
            let (first, second, least) = if both[0].2 <= both[1].2 { both[0] } else { both[1] };
            add(id(first), id(second), least);
        }
        let from = effects.products.nrows() - effects.nuisances.len();
        for (k, name) in effects.nuisances.iter().enumerate() {
            add(id(a), name.clone(), effects.distance(a, from + k));
        }
    }
    design
}

fn size_of(id: usize) -> (f64, String) {
    (CATALOG[id].typical, CATALOG[id].unit.into())
}

/// Number of different places in the bed, if the log gives places.
fn places(study: &FitInputs) -> Option<usize> {
    let features = study.model.features();
    let of_place = features.iter().find(|f| f.name == "place")?;
    let untold =
        study.model.testable().iter().any(|(id, why)| why.is_some() && CATALOG[*id].columns.contains(&"x_bed"));
    // In millimetres: our choice; a bed is prepared no more accurately.
    let mut starts: Vec<i64> = of_place.values.iter().filter_map(|v| Some((1e3 * v.first()?).round() as i64)).collect();
    starts.sort_unstable();
    starts.dedup();
    (!untold).then_some(starts.len())
}

fn effects(study: &FitInputs, uncertainty: &Uncertainty) -> Effects {
    let (observations, model) = (study.observations, study.model);
    let (plain_sand, plain) = (model.plain_sand(), &study.plain().prediction);
    let sizes = sizes_of(observations, plain);
    let source = NoiseData { observations, prediction: plain, sizes: &sizes, uncertainty, left_out: &[] };
    let channel = |c: usize| {
        let own = observations.units.iter().flat_map(|u| u.block(c)).map(|k| plain[k]).filter(|p| p.is_finite());
        ChannelNoise { grain: GRAINS, sensor: SENSOR * root_mean_square(own).max(1e-9), phi: CORRELATION }
    };
    let noise = Noise {
        clock: NoiseClock::Path,
        channels: (0..observations.channels.len()).map(channel).collect(),
        shared: uncertainty.shared.iter().map(|s| s.guess).collect(),
    };
    let whitener = Whitener::new(&source, &noise);
    // A mechanism of the sensor that is a nuisance, too, is only listed as a nuisance.
    let answer = |n: &Nuisance| kind(n.id).map(|kind| kind.answer(n.of.as_deref()));
    let stated = |id: usize| study.nuisances.iter().any(|n| answer(n) == Some(CATALOG[id].id));
    let tested = model.testable().into_iter().filter(|(id, why)| why.is_none() && !stated(*id));
    let causes: Vec<usize> = tested.map(|t| t.0).collect();
    let sands: Vec<_> = causes.iter().map(|&id| (plain_sand.0.with(id, CATALOG[id].typical), plain_sand.1)).collect();
    let moved = model.predict_many(&sands);
    let mut columns = whitener.apply_all(&moved.iter().map(|m| slope(m, plain, 1.0)).collect::<Vec<_>>());
    columns.extend(whitener.apply_all(&study.marginal_slopes[0]));
    let name = |n: &Nuisance| n.of.as_ref().map_or_else(|| n.id.to_owned(), |of| format!("{}_{of}", n.id));
    let nuisances = study.nuisances.iter().map(name).collect();
    Effects { causes, nuisances, products: gram(&columns) }
}
