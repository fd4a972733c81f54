//! Quantiles of χ² with one degree of freedom: squares of the normal distribution's two-sided ones (NIST/SEMATECH
//! e-Handbook of Statistical Methods, 1.3.6.7.4).

/// 95 %: the rise of an objective at the ends of an interval.
pub const AT_95_PERCENT: f64 = 3.841;
/// 99.9 %: chance alone exceeds it once in a thousand.
pub const AT_999_PER_MILLE: f64 = 10.828;
