//! The verdict as a pure function of the evidence.

use serde::Serialize;

/// The outcome of a diagnosis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The plain model's errors are within the data's own scatter.
    NoiseFloor,
    /// One cause, or one pair, explains the main part of the misfit, and every rival is far away.
    Named,
    /// Several causes that these data cannot distinguish.
    Ambiguous,
    /// No mechanism explains the main part of the misfit; a law found in the data does.
    Described,
    /// Neither a mechanism nor a law explains the main part of the misfit.
    NoneOfThese,
    /// There are no repetitions, or only copies, so no noise floor.
    InsufficientData,
}

/// Probability that a true cause is excluded from the ambiguity set by chance, over all its rivals together.
const REJECTION: f64 = 1e-3;
/// Two explanations nearer to each other than this [σ] are not distinguished, whatever their χ². Our choice: noise that
/// is learnt from a few repetitions does not have reliable tails so far out.
const APART: f64 = 5.0;
/// Share of the misfit beyond noise that a cause must explain to be named although misfit remains. Our choice: on our
/// test bed with a wall, which is not a mechanism of the catalogue, the nearest pair of causes explains seven tenths.
pub const MAIN_PART: f64 = 0.8;

/// An explanation other than the best one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rival {
    /// Its χ² minus that of the best.
    pub behind: f64,
    /// Whitened distance² [σ²] to the best.
    pub squared: f64,
    /// Does the cause explain more than its gate?
    pub explains: bool,
}

/// The evidence: all inputs of the verdict.
#[derive(Clone, Debug, PartialEq)]
pub struct Evidence {
    /// Does the best cause gain more than its gate?
    pub found: bool,
    /// Is there misfit beyond noise without any cause?
    pub misfit: bool,
    /// Is there misfit beyond noise that the best cause does not explain?
    pub remainder: bool,
    /// Is that misfit only slightly larger than the limit?
    pub slight: bool,
    /// Share of the misfit beyond noise that the best explains.
    pub explained: f64,
    /// Do the data exclude the form of the best's law?
    pub form_excluded: bool,
    /// Was a law found in the data?
    pub described: bool,
    /// Factor on χ² differences because the noise is estimated.
    pub inflation: f64,
    pub rivals: Vec<Rival>,
}

/// The verdict, and the rivals that the data cannot distinguish from the best.
pub fn verdict(e: &Evidence) -> (Verdict, Vec<usize>) {
    let otherwise = if e.described { Verdict::Described } else { Verdict::NoneOfThese };
    if !e.found {
        return (if e.misfit { otherwise } else { Verdict::NoiseFloor }, Vec::new());
    }
    let main = !e.remainder || e.slight || e.explained >= MAIN_PART;
    if e.form_excluded || !main {
        return (otherwise, Vec::new());
    }
    let limit = normal_quantile(1.0 - REJECTION / e.rivals.len().max(1) as f64) * e.inflation.sqrt();
    let stays = |r: &Rival| {
        // If the rival were true, χ²_rival − χ²_best would be −d² ± 2d, d the whitened distance between the two.
        let stands = r.behind + r.squared <= limit * 2.0 * r.squared.sqrt() || r.squared < APART * APART;
        stands && r.explains
    };
    let set: Vec<usize> = (0..e.rivals.len()).filter(|&k| stays(&e.rivals[k])).collect();
    (if set.is_empty() { Verdict::Named } else { Verdict::Ambiguous }, set)
}

/// Quantile of the standard normal distribution, upper tail (Abramowitz & Stegun 26.2.23, |error| < 4.5e-4).
fn normal_quantile(share: f64) -> f64 {
    let t = (-2.0 * (1.0 - share).ln()).sqrt();
    let top = 2.515517 + t * (0.802853 + t * 0.010328);
    t - top / (1.0 + t * (1.432788 + t * (0.189269 + t * 0.001308)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn evidence() -> Evidence {
        let far = Rival { behind: 900.0, squared: 900.0, explains: true };
        Evidence {
            found: true,
            misfit: true,
            remainder: false,
            slight: false,
            explained: 1.0,
            form_excluded: false,
            described: false,
            inflation: 1.0,
            rivals: vec![far],
        }
    }

    #[test]
    fn a_remainder_hides_no_name() {
        let named = (Verdict::Named, Vec::new());
        assert_eq!(verdict(&evidence()), named);
        assert_eq!(verdict(&Evidence { remainder: true, explained: 0.9, ..evidence() }), named);
        assert_eq!(verdict(&Evidence { remainder: true, explained: 0.0, slight: true, ..evidence() }), named);
    }

    #[test]
    fn a_name_needs_the_main_part() {
        let small = Evidence { remainder: true, explained: 0.3, ..evidence() };
        assert_eq!(verdict(&small).0, Verdict::NoneOfThese);
        assert_eq!(verdict(&Evidence { described: true, ..small }).0, Verdict::Described);
        assert_eq!(verdict(&Evidence { form_excluded: true, ..evidence() }).0, Verdict::NoneOfThese);
    }

    #[test]
    fn near_rivals_make_a_set() {
        let near = Rival { behind: 30.0, squared: 16.0, explains: true };
        let dull = Rival { explains: false, ..near };
        let e = Evidence {
            rivals: vec![near, dull, Rival { behind: 900.0, squared: 900.0, explains: true }],
            ..evidence()
        };
        assert_eq!(verdict(&e), (Verdict::Ambiguous, vec![0]));
    }

    #[test]
    fn nothing_found_is_noise_or_misfit() {
        let none = Evidence { found: false, ..evidence() };
        assert_eq!(verdict(&none).0, Verdict::NoneOfThese);
        assert_eq!(verdict(&Evidence { misfit: false, ..none }).0, Verdict::NoiseFloor);
    }
}
