//! Laws found in the data: a coefficient times powers of dimensionless groups, as a stress or as a share of the force
//! law's own stress.
//!
//! A law has one term of at most two groups. Its powers are parameters, like its coefficient: the law is chosen
//! anew with each condition left out, so a large dictionary gains nothing by chance ([`super::evidence`]).

use super::fit::{Fit, slope};
use super::left_out::LawColumn;
use super::study::FitInputs;
use crate::number::dot;
use crate::parallel;
use crate::sand::GRAVITY;
use crate::sand::term::{On, Term};

/// Powers of v_n²/(g|z|) in laws of the normal speed; the next constant has the powers of |z|/w. Our choice: up to the
/// cube of the speed, in steps that logs can resolve.
const FROUDE: [f64; 6] = [0.25, 0.5, 0.75, 1.0, 1.25, 1.5];
const DEPTH: [f64; 8] = [-1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75];
/// Powers of |z|/w in pressures that do not depend on speed; with −1 the pressure does not vanish at the surface. The
/// power 0 would be the medium itself. Our choice.
const STILL: [f64; 7] = [-1.0, -0.75, -0.5, -0.25, 0.5, 1.0, 1.5];
/// Powers of the group |v|²/(g w) of the whole speed: our choice, from the root of the speed to its square.
const WHOLE: [f64; 4] = [0.25, 0.5, 0.75, 1.0];
/// Powers of sines, cosines and of the saturation: our choice, the higher, the narrower the peak.
const SHAPE: [f64; 3] = [1.0, 2.0, 4.0];
/// Least depth [m] in the range of a law: segments nearer to the surface carry almost no force. Our choice.
const SHALLOW: f64 = 1e-3;
/// Number of rounds in which law, causes, coefficients and nuisances are fitted together: our choice. Several are
/// needed, because the columns depend slightly on the fitted values.
const ROUNDS: usize = 3;

/// A law and a cause are fitted together only if the cause explains at most this share of the law's effect: with a larger share,
/// the variance inflation factor is above 10, the usual limit of collinearity (Marquardt, Technometrics 12:591, 1970).
pub const COLLINEAR: f64 = 0.9;

/// Laws that a model may have, and the change of its prediction by each with the coefficient 1.
#[derive(Default)]
pub struct Laws {
    pub terms: Vec<Term>,
    pub columns: Vec<LawColumn>,
}

/// A law with its coefficient.
pub struct FittedLaw {
    pub term: Term,
    /// Standard deviation of the coefficient under the noise.
    pub sd: f64,
    /// The model with the law; causes, coefficients and nuisances are fitted with it.
    pub fit: Fit,
}

/// The dictionary, over the range of the data: greatest speed, greatest depth and least width.
fn dictionary([speed, depth, width]: [f64; 3]) -> Vec<Term> {
    let range = |name: &str| match name {
        "froude" => [0.0, speed * speed / (GRAVITY * SHALLOW)],
        "whole_froude" => [0.0, speed * speed / (GRAVITY * width)],
        "depth_over_width" => [SHALLOW / width, (depth / width).max(2.0 * SHALLOW / width)],
        "sin_gamma" => [-1.0, 1.0],
        _ => [0.0, 1.0],
    };
    let term = |on: On, groups: &[(&str, f64)]| {
        let groups = groups.iter().filter(|g| g.1 != 0.0);
        Term {
            on,
            coefficient: 1.0,
            groups: groups.clone().map(|g| (g.0.to_string(), g.1)).collect(),
            range: groups.map(|g| (g.0.to_string(), range(g.0))).collect(),
        }
    };
    let mut all = Vec::new();
    for f in FROUDE {
        all.extend(DEPTH.map(|d| term(On::Normal, &[("froude", f), ("depth_over_width", d)])));
    }
    all.extend(STILL.map(|d| term(On::Normal, &[("depth_over_width", d)])));
    for p in WHOLE {
        all.push(term(On::Law, &[("whole_froude", p)]));
        all.push(term(On::Normal, &[("whole_froude", p)]));
        // Laws without depth: pressure and drag by the whole speed.
        all.push(term(On::Normal, &[("whole_froude", p), ("depth_over_width", -1.0)]));
        all.push(term(On::Tangential, &[("whole_froude", p), ("depth_over_width", -1.0)]));
    }
    for p in SHAPE {
        for group in ["sin_attack", "cos_attack", "sin_gamma", "cos_gamma"] {
            all.push(term(On::Law, &[(group, p)]));
            // A stress with the odd power of a signed group would pull in half of the directions.
            all.extend((group != "sin_gamma" || p > 1.0).then(|| term(On::Normal, &[(group, p)])));
        }
        all.push(term(On::Law, &[("cos_beta", p)]));
        all.push(term(On::Law, &[("saturation", p)]));
        all.push(term(On::Normal, &[("saturation", p)]));
        all.push(term(On::Law, &[("depth_over_width", 0.5 * p)]));
    }
    all.extend([0.0, 1.0].map(|p| term(On::Tangential, &[("cos_attack", p)])));
    all
}

/// The laws that are physically possible about `base`, with their columns; none if the model supports no laws. A law is
/// left out if its effect on these data is nearly that of a cause of `base`: it would describe this cause a second
/// time, and take a part of the cause's value.
pub fn laws(study: &FitInputs, base: &Fit) -> Laws {
    if study.model.with_terms(&[]).is_none() {
        return Laws::default();
    }
    let sand = study.sand(base);
    let normal = study.normal_equations(base);
    let column = |law: &Term| {
        let model = study.model.with_terms(std::slice::from_ref(law))?;
        let column = slope(&model.predict(&sand), &base.prediction, 1.0);
        let white = study.whitener.apply(&column);
        // What coefficients and effects of measuring leave of two equal effects may differ, so the whole effects are compared, too.
        let causes = base.ids.len();
        let same = |share: Option<f64>| share.is_none_or(|share| share > COLLINEAR);
        if causes > 0 && (same(normal.explained(&white, causes)) || same(normal.alike(&white, causes))) {
            return None;
        }
        // Whether a law is physically possible depends on the sign of its coefficient, which a fit of this law alone gives.
        let estimate = dot(&white, &base.white) / dot(&white, &white).max(1e-300);
        let fitted = Term { coefficient: estimate, ..law.clone() };
        fitted.check(&sand.1, study.model.medium().bulk_density).ok()?;
        Some((law.clone(), column.iter().map(|v| *v as f32).collect()))
    };
    let made = parallel::map(&dictionary(study.model.reach()), column);
    let (terms, columns) = made.into_iter().flatten().unzip();
    Laws { terms, columns }
}

/// The law `term`, fitted in addition to `base`, starting from the coefficient in `term`. With `held`, the values of
/// the causes do not change: the law then describes only the misfit that the causes leave. None if the fitted law is
/// physically impossible ([`Term::check`]).
pub fn fitted(study: &FitInputs, base: &Fit, mut term: Term, held: bool) -> Option<FittedLaw> {
    let values = if held { base.ids.len() } else { 0 };
    let (own, rest) = base.slopes.split_at(values);
    let mut fit = Fit { ids: base.ids[values..].to_vec(), slopes: rest.to_vec(), ..base.clone() };
    let mut sd = 0.0;
    for _ in 0..ROUNDS {
        let model = study.model.with_terms(std::slice::from_ref(&term))?;
        fit = study.with_model(&*model).fit_near(&fit);
        let step = 0.02 * term.coefficient; // our choice, as for mechanisms
        let more = Term { coefficient: term.coefficient + step, ..term.clone() };
        let model = study.model.with_terms(std::slice::from_ref(&more))?;
        let moved = model.predict(&study.sand(&fit));
        let white = study.whitener.apply(&slope(&moved, &fit.prediction, step));
        let [score, left] = study.normal_equations(&fit).beside(&white, &fit.white)?;
        term.coefficient += score / left.max(1e-300);
        sd = left.max(1e-300).sqrt().recip();
    }
    let model = study.model.with_terms(std::slice::from_ref(&term))?;
    let fit = study.with_model(&*model).fit_near(&fit);
    term.check(&study.coefficients(&fit.deviations), study.model.medium().bulk_density).ok()?;
    let fit = Fit { ids: base.ids.clone(), slopes: [own, &fit.slopes].concat(), ..fit };
    Some(FittedLaw { term, sd, fit })
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::experiment::{Experiment, Intruder};
    use super::super::force_log::{planned, possible};
    use super::super::force_model::ForceLogModel;
    use super::super::forward::ForwardModel;
    use super::super::noise::{ChannelNoise, Noise, NoiseClock, NoiseData, sizes};
    use super::super::shared::Uncertainty;
    use super::super::track::{ArmPose, Track};
    use super::super::whiten::Whitener;
    use super::*;
    use crate::sand::mechanism::Mechanisms;

    const EXPERIMENT: &str = "kind = \"intrusion\"\nmedium = \"poppy-loose\"\nbulk_density = 640.0\n\
        [shape.plate]\ntype = \"plate\"\nlength = 0.04\nwidth = 0.025\n[nuisances]\ngain_drift = 0.0\n";

    /// Plates with a hidden cohesion of 300 Pa, and a drag of another law than `inertial_drag`. The other law drives a drift of the gain to
    /// its bound, where fits are not linear, so there is none.
    pub fn with_cohesion(check: impl Fn(&FitInputs, &Fit)) {
        let intruder = Intruder::Plate { length: 0.04, width: 0.025, thickness: None };
        let at = |velocity: f64| {
            let pose = ArmPose { velocity: [velocity, 0.0], ..ArmPose::default() };
            Track { shape: "plate".into(), ..Track::leg(intruder, 0.0, vec![pose]) }
        };
        let log = planned(possible(&[at(0.05), at(1.0)]), 2);
        let model = ForceLogModel::new(&log, &Experiment::from_toml(EXPERIMENT).unwrap()).unwrap();
        let hidden = Mechanisms { cohesion: 300.0, ..Mechanisms::default() };
        let law = Term { coefficient: 1.0, ..term(&[("froude", 0.75), ("depth_over_width", -0.25)]) };
        let values = model.with_terms(&[law]).unwrap().predict(&(hidden, model.medium().coefficients));
        let observations = super::super::observations::Observations { values, ..log.observations.clone() };
        let channel = ChannelNoise { grain: 0.04, sensor: 0.03, phi: 0.5 };
        let noise = Noise { clock: NoiseClock::Path, channels: vec![channel; 2], shared: Vec::new() };
        let source = NoiseData {
            observations: &observations,
            prediction: &observations.values,
            sizes: &sizes(&observations),
            uncertainty: &Uncertainty::default(),
            left_out: &[],
        };
        let whitener = Whitener::new(&source, &noise);
        let study = FitInputs::new(&observations, &model, &whitener);
        let cohesion = Mechanisms::index("cohesion").unwrap();
        check(&study, &study.fit(&[cohesion], &[200.0]));
    }

    fn term(groups: &[(&str, f64)]) -> Term {
        let all = dictionary([1.0, 0.05, 0.025]);
        let named = groups.iter().map(|g| (g.0.to_string(), g.1)).collect();
        all.into_iter().find(|t| t.on == On::Normal && t.groups == named).unwrap()
    }

    /// The pressure |z| (|z|/w)^−1 does not depend on depth, as cohesion does not. In addition to cohesion this law
    /// would describe the same stress a second time, so it is left out; in addition to the plain model it is allowed.
    #[test]
    fn a_law_that_repeats_a_cause_is_left_out_beside_it() {
        with_cohesion(|study, fit| {
            let still = term(&[("depth_over_width", -1.0)]);
            let beside = |fit: &Fit| laws(study, fit).terms.iter().any(|law| law.groups == still.groups);
            assert!(beside(&study.recalibrated()) && !beside(fit));
            assert!(laws(study, fit).terms.len() > 20);
        });
    }

    /// A law in addition to a named cause is fitted to the misfit that the cause leaves. Otherwise the law would take a
    /// part of the cause's value.
    #[test]
    fn a_law_beside_a_named_cause_leaves_it_its_value() {
        with_cohesion(|study, fit| {
            let law = Term { coefficient: 0.5, ..term(&[("froude", 0.25), ("depth_over_width", -1.0)]) };
            let beside = fitted(study, fit, law.clone(), true).unwrap();
            assert_eq!((&beside.fit.ids, beside.fit.values()), (&fit.ids, fit.values()));
            assert_eq!(beside.fit.slopes.len(), fit.slopes.len());
            let free = fitted(study, fit, law, false).unwrap();
            let change = free.fit.values()[0] / fit.values()[0] - 1.0;
            assert!(change.abs() > 0.05, "the law takes {change} of the value");
        });
    }
}
