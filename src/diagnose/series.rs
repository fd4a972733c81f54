//! Functions of series of numbers.

/// The least and the greatest number.
pub fn ends(numbers: impl Iterator<Item = f64>) -> [f64; 2] {
    numbers.fold([f64::MAX, f64::MIN], |[low, high], v| [low.min(v), high.max(v)])
}

/// Of positive numbers: the least, the geometric mean of least and greatest, and the greatest.
pub fn low_middle_high(numbers: impl Iterator<Item = f64>) -> [f64; 3] {
    let [low, high] = ends(numbers);
    [low, (low * high).sqrt(), high]
}

/// Root mean square; 0 if there are no numbers.
pub fn root_mean_square(numbers: impl Iterator<Item = f64>) -> f64 {
    let (square, count) = numbers.fold((0.0, 0.0), |(square, count), v| (square + v * v, count + 1.0));
    (square / f64::max(count, 1.0)).sqrt()
}

/// Slope of `values` over `t` at sample `i`, from `apart` samples before it to `apart` samples after it.
pub fn central_difference(t: &[f64], values: &[f64], i: usize, apart: usize) -> f64 {
    let (a, b) = (i.saturating_sub(apart), (i + apart).min(values.len() - 1));
    (values[b] - values[a]) / (t[b] - t[a])
}

/// Interpolates `values`, given at increasing `from`, linearly at `at`; constant beyond the ends.
pub fn interpolate(from: &[f64], values: &[f64], at: f64) -> f64 {
    let right = from.partition_point(|&p| p < at);
    if right == 0 {
        return values[0];
    }
    if right == from.len() {
        return values[right - 1];
    }
    let (a, b) = (from[right - 1], from[right]);
    let share = if b > a { (at - a) / (b - a) } else { 0.0 };
    values[right - 1] + share * (values[right] - values[right - 1])
}

/// First and last index of each run of neighbours that are true.
pub fn runs_of(flags: impl Iterator<Item = bool>) -> impl Iterator<Item = [usize; 2]> {
    let mut runs: Vec<[usize; 2]> = Vec::new();
    for (i, _) in flags.enumerate().filter(|f| f.1) {
        match runs.last_mut().filter(|run| run[1] + 1 == i) {
            Some(run) => run[1] = i,
            None => runs.push([i, i]),
        }
    }
    runs.into_iter()
}
