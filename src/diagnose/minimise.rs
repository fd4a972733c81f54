//! A small minimiser for smooth functions of few variables.

/// Minimises `f` by BFGS with numerical gradients, from `x`, in at most `rounds` rounds. A step must reduce `f` by 1e-4
/// of what its slope promises (Nocedal & Wright 2006, 3.1). The other numbers are our choice for variables that are
/// logarithms, and for `f` = −2 log likelihood: gradients are differences over 1e-4, the first step is a hundredth
/// of the gradient, no step is longer than one e-fold, a step that fails is multiplied by 0.4 and given up below 1e-3
/// of its length, and the search ends when a round gains less than 0.01, far below every threshold in use.
pub fn minimise(f: impl Fn(&[f64]) -> f64, mut x: Vec<f64>, rounds: usize) -> Vec<f64> {
    let n = x.len();
    let gradient = |x: &[f64], value: f64| -> Vec<f64> {
        let slope = |k: usize| {
            let mut moved = x.to_vec();
            moved[k] += 1e-4;
            (f(&moved) - value) / 1e-4
        };
        (0..n).map(slope).collect()
    };
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut value = f(&x);
    let mut g = gradient(&x, value);
    let mut inverse: Vec<Vec<f64>> =
        (0..n).map(|i| (0..n).map(|j| if i == j { 1e-2 } else { 0.0 }).collect()).collect();
    for _ in 0..rounds {
        let mut step: Vec<f64> = inverse.iter().map(|row| -dot(row, &g)).collect();
        let longest = step.iter().fold(0.0, |a: f64, b| a.max(b.abs()));
        if longest > 1.0 {
            step.iter_mut().for_each(|s| *s /= longest);
        }
        let slope = dot(&step, &g);
        let mut share = 1.0;
        let moved = loop {
            let trial: Vec<f64> = x.iter().zip(&step).map(|(x, s)| x + share * s).collect();
            let now = f(&trial);
            if now < value + 1e-4 * share * slope {
                break Some((trial, now));
            }
            share *= 0.4;
            if share < 1e-3 {
                break None;
            }
        };
        let Some((next, now)) = moved else { break };
        let gained = value - now;
        let after = gradient(&next, now);
        let s: Vec<f64> = next.iter().zip(&x).map(|(a, b)| a - b).collect();
        let y: Vec<f64> = after.iter().zip(&g).map(|(a, b)| a - b).collect();
        update_inverse(&mut inverse, &s, &y);
        (x, value, g) = (next, now, after);
        if gained < 1e-2 {
            break;
        }
    }
    x
}

/// Updates the inverse Hessian (BFGS) by a step `s` that changed the gradient by `y`.
fn update_inverse(inverse: &mut [Vec<f64>], s: &[f64], y: &[f64]) {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let curvature = dot(s, y);
    if curvature <= 1e-12 {
        return;
    }
    let hy: Vec<f64> = inverse.iter().map(|row| dot(row, y)).collect();
    let factor = (1.0 + dot(y, &hy) / curvature) / curvature;
    for i in 0..s.len() {
        for j in 0..s.len() {
            inverse[i][j] += factor * s[i] * s[j] - (hy[i] * s[j] + s[i] * hy[j]) / curvature;
        }
    }
}
