//! A sentence of the paper, our result, and whether they agree.

use serde::Serialize;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ClaimVerdict {
    Reproduced,
    NotReproduced,
    /// The paper gives the number only in a figure, or the sentence describes the experiment, so there is nothing to compare.
    NoData,
}

/// One row of `claims.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Claim {
    /// Section of the paper, then a name.
    pub id: String,
    pub claim: String,
    pub seed_value: String,
    pub ours: String,
    pub verdict: ClaimVerdict,
    pub why: String,
}

/// A number counts as reproduced if it differs from the paper's by at most this share. 15 % is the agreement that the
/// paper reports between its own model and its own experiment; it was fixed before any comparison was made.
pub const TOLERANCE: f64 = 0.15;

impl Claim {
    pub fn new(
        id: &str,
        claim: &str,
        seed_value: &str,
        ours: impl Into<String>,
        holds: bool,
        why: impl Into<String>,
    ) -> Self {
        let verdict = if holds { ClaimVerdict::Reproduced } else { ClaimVerdict::NotReproduced };
        Self { verdict, ..Self::no_data(id, claim, seed_value, ours, why) }
    }

    pub fn no_data(id: &str, claim: &str, seed_value: &str, ours: impl Into<String>, why: impl Into<String>) -> Self {
        Self {
            id: id.into(),
            claim: claim.into(),
            seed_value: seed_value.into(),
            ours: ours.into(),
            verdict: ClaimVerdict::NoData,
            why: why.into(),
        }
    }

    /// A claim that a model over-predicts by a percentage: `ratio` is the model's number divided by the reference at
    /// the declared assumptions, `band` the range of this ratio over all assumptions, `seed` the paper's ratio.
    pub fn ratio(id: &str, claim: &str, seed_value: &str, seed: f64, ratio: f64, band: [f64; 2], note: &str) -> Self {
        let holds = (ratio / seed - 1.0).abs() <= TOLERANCE;
        let ours =
            format!("× {ratio:.2} ({}); × {:.2} to × {:.2} over the assumptions", percent(ratio), band[0], band[1]);
        let reach = if seed >= band[0] && seed <= band[1] { "within" } else { "outside" };
        let why = format!(
            "× {seed:.2} expected, {} {:.0} %; it is {reach} the band over what the paper leaves open. {note}",
            if holds { "met within" } else { "missed by more than" },
            100.0 * TOLERANCE
        );
        Self::new(id, claim, seed_value, ours, holds, why.trim())
    }
}

/// A ratio as a change in per cent: 1.5 is +50 %.
pub fn percent(ratio: f64) -> String {
    format!("{:+.0} %", 100.0 * (ratio - 1.0)).replace('-', "−")
}

/// A number with a typographic minus sign.
pub fn signed(value: f64) -> String {
    format!("{value:.0}").replace('-', "−")
}

/// Least and greatest.
pub fn extremes(values: impl IntoIterator<Item = f64>) -> [f64; 2] {
    values.into_iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], v| [l.min(v), h.max(v)])
}
