//! Laws found in the data: a coefficient times powers of dimensionless groups, as a stress or as a share of the force
//! law's own stress.
//!
//! A law is sparse: one term of at most two groups. Its powers are parameters as its coefficient is: the law is chosen
//! anew with each condition left out, so a large dictionary gains nothing by chance ([`super::evidence`]).

use super::fit::{Fit, slope};
use super::left_out::Laws;
use super::study::FitInputs;
use crate::number::dot;
use crate::parallel;
use crate::sand::GRAVITY;
use crate::sand::term::{On, Term};
use std::sync::Arc;

/// Powers of v_n²/(g|z|) and of |z|/w in laws of the normal speed: our choice, up to the cube of the speed, in steps
/// that logs can resolve.
const FROUDE: [f64; 6] = [0.25, 0.5, 0.75, 1.0, 1.25, 1.5];
const DEPTH: [f64; 8] = [-1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75];
/// Powers of |z|/w in pressures that do not depend on speed; with −1 the pressure does not vanish at the surface. The
/// power 0 would be the medium itself.
const STILL: [f64; 7] = [-1.0, -0.75, -0.5, -0.25, 0.5, 1.0, 1.5];
/// Powers of the whole speed's group: from its root to its square.
const WHOLE: [f64; 4] = [0.25, 0.5, 0.75, 1.0];
/// Powers of sines, cosines and of the saturation.
const SHAPE: [f64; 3] = [1.0, 2.0, 4.0];
/// Least depth [m] in the range of a law: segments nearer to the surface carry almost no force. Our choice.
const SHALLOW: f64 = 1e-3;
/// Rounds in which law, causes, coefficients and nuisances are fitted together: our choice, because the columns depend
/// slightly on them.
const ROUNDS: usize = 3;

/// Share of a law's effect that a cause may explain for both to be fitted together: at more, the variance inflation factor
/// is above 10, the usual limit of collinearity (Marquardt, Technometrics 12:591, 1970).
const COLLINEAR: f64 = 0.9;

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
        // Without depth: pressure and drag of the whole speed.
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

/// The laws that are physically possible about `base`, with their columns; None if the model supports no laws. Beside a
/// cause, a law whose effect on these data is nearly that of the cause itself is left out: it would describe the cause
/// once more, and take a part of its value.
pub fn laws(study: &FitInputs, base: &Fit) -> Option<Laws> {
    study.model.with_terms(&[])?;
    let coefficients = study.coefficients(&base.deviations);
    let normal = study.normal_equations(base);
    let column = |law: &Term| {
        let model = study.model.with_terms(std::slice::from_ref(law))?;
        let column = Arc::new(slope(&model.predict(&base.mechanisms, &coefficients), &base.prediction, 1.0));
        // The coefficient that would fit alone tells the sign; a law that sand cannot follow is left out.
        let white = study.whitener.apply(&column);
        if !base.ids.is_empty() && normal.explained(&white, base.ids.len())? > COLLINEAR {
            return None;
        }
        let estimate = dot(&white, &base.white) / dot(&white, &white).max(1e-300);
        let fitted = Term { coefficient: estimate, ..law.clone() };
        fitted.check(&coefficients, study.model.medium().bulk_density).ok()?;
        Some((law.clone(), column))
    };
    let made = parallel::map(&dictionary(study.model.reach()), column);
    let (terms, columns) = made.into_iter().flatten().unzip();
    Some(Laws { terms, columns })
}

/// The law `term` fitted in addition to `base`, from its coefficient. The values of named causes are `held`: the law
/// describes what they leave, and takes no part of them. None if sand cannot follow the fitted law.
pub fn fitted(study: &FitInputs, base: &Fit, mut term: Term, held: bool) -> Option<FittedLaw> {
    let values = if held { base.ids.len() } else { 0 };
    let (own, rest) = base.slopes.split_at(values);
    let mut fit = Fit { ids: base.ids[values..].to_vec(), slopes: rest.to_vec(), ..base.clone() };
    let mut sd = 0.0;
    for _ in 0..ROUNDS {
        let model = study.model.with_terms(std::slice::from_ref(&term))?;
        fit = study.with_model(&*model).fit_near(&fit);
        let step = 0.02 * term.coefficient;
        let more = Term { coefficient: term.coefficient + step, ..term.clone() };
        let model = study.model.with_terms(std::slice::from_ref(&more))?;
        let moved = model.predict(&fit.mechanisms, &study.coefficients(&fit.deviations));
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
