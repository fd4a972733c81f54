//! Functions that lanes compute without calls.

use crate::number::Real;

/// ln(1 + x) for 0 ≤ x < 10⁴, relative error below 1e-7: with y = 1 + x, ln y = 32 artanh((r − 1)/(r + 1)) and
/// r = y^(1/16). The series of artanh is cut at the 13th power.
#[inline(always)]
pub fn log_one_plus<R: Real>(x: R) -> R {
    let root = (x + R::one()).sqrt().sqrt().sqrt().sqrt();
    let z = (root - R::one()) / (root + R::one());
    let z2 = z * z;
    let series = [1.0 / 11.0, 1.0 / 9.0, 1.0 / 7.0, 1.0 / 5.0, 1.0 / 3.0, 1.0];
    let mut sum = R::splat(1.0 / 13.0);
    for c in series {
        sum = sum.mul_add(z2, R::splat(c));
    }
    sum * z * R::splat(32.0)
}

/// tanh x for x ≥ 0, absolute error below 1e-7: the formula tanh x = 2 t/(1 + t²) with t = tanh(x/2) is used three
/// times. It begins with tanh(x/8) as a continued fraction, which is exact to single precision for x ≤ 9. An x above
/// 9.5 is replaced by 9.5, where tanh is 1 within the error.
#[inline(always)]
pub fn tanh<R: Real>(x: R) -> R {
    let y = x.min(R::splat(9.5)) * R::splat(0.125);
    let y2 = y * y;
    let above = R::splat(21.0).mul_add(y2, R::splat(1260.0)).mul_add(y2, R::splat(10395.0));
    let below = (y2 + R::splat(210.0)).mul_add(y2, R::splat(4725.0)).mul_add(y2, R::splat(10395.0));
    let mut t = y * above / below;
    for _ in 0..3 {
        t = (t + t) / t.mul_add(t, R::one());
    }
    t
}
