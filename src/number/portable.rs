//! Eight lanes in portable code.

use super::Real;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// Eight lanes of `f32`; the compiler vectorises what it can.
#[derive(Clone, Copy)]
pub struct Portable([f32; 8]);

#[inline(always)]
fn each(f: impl Fn(usize) -> f32) -> Portable {
    Portable(std::array::from_fn(f))
}

macro_rules! operator {
    ($trait:ident, $method:ident, $op:tt) => {
        impl $trait for Portable {
            type Output = Self;
            #[inline(always)]
            fn $method(self, o: Self) -> Self {
                each(|i| self.0[i] $op o.0[i])
            }
        }
    };
}
operator!(Add, add, +);
operator!(Sub, sub, -);
operator!(Mul, mul, *);
operator!(Div, div, /);

impl Neg for Portable {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        each(|i| -self.0[i])
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
    const LANES: usize = 8;
    type Mask = [bool; 8];

    #[inline(always)]
    fn splat(value: f64) -> Self {
        Self([value as f32; 8])
    }
    #[inline(always)]
    fn lane(&self, index: usize) -> f64 {
        f64::from(self.0[index])
    }
    #[inline(always)]
    fn set_lane(&mut self, index: usize, value: f64) {
        self.0[index] = value as f32;
    }
    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        each(|i| self.0[i] * a.0[i] + b.0[i])
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        each(|i| self.0[i].sqrt())
    }
    #[inline(always)]
    fn abs(self) -> Self {
        each(|i| self.0[i].abs())
    }
    #[inline(always)]
    fn min(self, o: Self) -> Self {
        each(|i| if self.0[i] < o.0[i] { self.0[i] } else { o.0[i] })
    }
    #[inline(always)]
    fn max(self, o: Self) -> Self {
        each(|i| if self.0[i] > o.0[i] { self.0[i] } else { o.0[i] })
    }
    /// Adding and taking away 1.5·2²³ leaves the nearest integer; exact for |x| < 2²².
    #[inline(always)]
    fn round(self) -> Self {
        const MAGIC: f32 = 12_582_912.0;
        each(|i| (self.0[i] + MAGIC) - MAGIC)
    }
    #[inline(always)]
    fn lt(self, o: Self) -> [bool; 8] {
        std::array::from_fn(|i| self.0[i] < o.0[i])
    }
    #[inline(always)]
    fn select(mask: [bool; 8], yes: Self, no: Self) -> Self {
        each(|i| if mask[i] { yes.0[i] } else { no.0[i] })
    }
    #[inline(always)]
    fn any(mask: [bool; 8]) -> bool {
        mask.iter().any(|m| *m)
    }
}
