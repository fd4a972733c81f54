//! Four lanes in portable code.

use super::{PlainShorts, Real};
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};
use wide::f32x4;

/// Four lanes of `f32` in the vectors that every processor of the target has (SSE2 on x86-64, NEON on AArch64).
#[derive(Clone, Copy)]
pub struct Portable(f32x4);

macro_rules! operator {
    ($trait:ident, $method:ident) => {
        impl $trait for Portable {
            type Output = Self;
            #[inline(always)]
            fn $method(self, o: Self) -> Self {
                Self($trait::$method(self.0, o.0))
            }
        }
    };
}
operator!(Add, add);
operator!(Sub, sub);
operator!(Mul, mul);
operator!(Div, div);

impl Neg for Portable {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(-self.0)
    }
}
impl AddAssign for Portable {
    #[inline(always)]
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}
impl SubAssign for Portable {
    #[inline(always)]
    fn sub_assign(&mut self, o: Self) {
        *self = *self - o;
    }
}

impl Real for Portable {
    const LANES: usize = 4;
    /// In each lane all bits are set, or none.
    type Mask = f32x4;
    type Shorts = PlainShorts;

    #[inline(always)]
    fn splat(value: f64) -> Self {
        Self(f32x4::splat(value as f32))
    }
    #[inline(always)]
    fn lane(&self, index: usize) -> f64 {
        f64::from(self.0.to_array()[index])
    }
    #[inline(always)]
    fn set_lane(&mut self, index: usize, value: f64) {
        self.0.as_mut_array()[index] = value as f32;
    }
    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        Self(self.0.mul_add(a.0, b.0))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.0.sqrt())
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Self(self.0.abs())
    }
    #[inline(always)]
    fn min(self, o: Self) -> Self {
        Self(self.0.fast_min(o.0))
    }
    #[inline(always)]
    fn max(self, o: Self) -> Self {
        Self(self.0.fast_max(o.0))
    }
    /// Adding and subtracting 1.5·2²³ rounds to the nearest integer; exact for |x| < 2²².
    #[inline(always)]
    fn round(self) -> Self {
        let magic = f32x4::splat(12_582_912.0);
        Self((self.0 + magic) - magic)
    }
    #[inline(always)]
    fn lt(self, o: Self) -> f32x4 {
        self.0.simd_lt(o.0)
    }
    #[inline(always)]
    fn select(mask: f32x4, yes: Self, no: Self) -> Self {
        Self(mask.select(yes.0, no.0))
    }
    #[inline(always)]
    fn bits(mask: f32x4) -> u32 {
        mask.to_bitmask()
    }
}
