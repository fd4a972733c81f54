//! The models of the table of evidence, as the verdict compares them.

/// What a model of the table adds to the plain one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// The stated sand. Effects of measuring are marginalised within their stated priors, as in all models.
    Plain,
    /// The stated sand, with the effects of measuring that are already established.
    Established,
    /// The same with fitted coefficients: the base with which causes and laws are compared.
    Base,
    /// Causes in the sand, in the drive or in the measurement.
    Causes,
    /// The base without an effect of measuring, with which this effect is compared. It is no answer.
    Absent,
    /// A law found in the data.
    Law,
    /// A law beside causes.
    Beside,
}

/// An effect that a model names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effect {
    /// Index in the catalogue of mechanisms.
    Mechanism(usize),
    /// Index among the nuisances.
    Measuring(usize),
}

/// One model of the table.
#[derive(Clone, Debug, PartialEq)]
pub struct Compared {
    pub role: Role,
    pub effects: Vec<Effect>,
    /// Must the model not be named, because these data cannot test one of its causes?
    pub unnamed: bool,
    /// Could a cause that has no entry, because these data do not say whether it acts, look the same?
    pub unseen: bool,
    /// Entries that these data cannot test, and that could have the same effects as this entry.
    pub alike: Vec<usize>,
    /// For a law: entries whose effect it repeats.
    pub repeats: Vec<usize>,
    pub elpd: f64,
    /// Variance of its errors beyond the noise's variance, in units of the noise's variance; 0 if noise alone may cause such errors.
    pub misfit: f64,
    /// Share of the plain model's misfit that remains with this model.
    pub unexplained: f64,
    /// Does it predict better than entry `k`, beyond twice the standard error?
    pub beats: Vec<bool>,
    /// Error on left-out conditions.
    pub error: f64,
    /// Is its error on left-out conditions lower than the plain model's, beyond the 95 % interval of the difference?
    pub lowers: bool,
}

impl Compared {
    /// Has it all effects of the other entry?
    pub fn contains(&self, other: &Self) -> bool {
        other.effects.iter().all(|e| self.effects.contains(e))
    }
}

/// The entry of the base.
pub fn base(table: &[Compared]) -> usize {
    table.iter().position(|e| e.role == Role::Base).unwrap_or(0)
}
