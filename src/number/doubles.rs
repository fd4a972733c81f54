//! Eight lanes of `f64`, for work that needs double precision on many similar items: the segments of an intruder.

use super::{Kernel, PlainShorts, Real};
use std::array::from_fn;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// Two registers of AVX2: our choice.
const LANES: usize = 8;

/// Plain arrays, which the compiler vectorises. No operation is fused, so every instruction set gives bit-identical
/// results.
#[derive(Clone, Copy)]
pub struct Doubles([f64; LANES]);

impl Doubles {
    pub fn from_array(lanes: [f64; LANES]) -> Self {
        Self(lanes)
    }

    /// Sum over all lanes.
    #[inline(always)]
    pub fn sum(self) -> f64 {
        self.0.iter().sum()
    }
}

macro_rules! operator {
    ($trait:ident, $method:ident) => {
        impl $trait for Doubles {
            type Output = Self;
            #[inline(always)]
            fn $method(self, o: Self) -> Self {
                Self(from_fn(|i| $trait::$method(self.0[i], o.0[i])))
            }
        }
    };
}
operator!(Add, add);
operator!(Sub, sub);
operator!(Mul, mul);
operator!(Div, div);

impl Neg for Doubles {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(from_fn(|i| -self.0[i]))
    }
}
impl AddAssign for Doubles {
    #[inline(always)]
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}
impl SubAssign for Doubles {
    #[inline(always)]
    fn sub_assign(&mut self, o: Self) {
        *self = *self - o;
    }
}

impl Real for Doubles {
    const LANES: usize = LANES;
    /// In each lane all bits are set, or none.
    type Mask = [u64; LANES];
    type Shorts = PlainShorts;

    #[inline(always)]
    fn splat(value: f64) -> Self {
        Self([value; LANES])
    }
    #[inline(always)]
    fn lane(&self, index: usize) -> f64 {
        self.0[index]
    }
    #[inline(always)]
    fn set_lane(&mut self, index: usize, value: f64) {
        self.0[index] = value;
    }
    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        self * a + b
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(from_fn(|i| self.0[i].sqrt()))
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Self(from_fn(|i| self.0[i].abs()))
    }
    #[inline(always)]
    fn min(self, o: Self) -> Self {
        Self(from_fn(|i| if self.0[i] < o.0[i] { self.0[i] } else { o.0[i] }))
    }
    #[inline(always)]
    fn max(self, o: Self) -> Self {
        Self(from_fn(|i| if self.0[i] > o.0[i] { self.0[i] } else { o.0[i] }))
    }
    #[inline(always)]
    fn round(self) -> Self {
        Self(from_fn(|i| self.0[i].round_ties_even()))
    }
    #[inline(always)]
    fn lt(self, o: Self) -> Self::Mask {
        from_fn(|i| if self.0[i] < o.0[i] { u64::MAX } else { 0 })
    }
    #[inline(always)]
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self {
        Self(from_fn(|i| f64::from_bits((mask[i] & yes.0[i].to_bits()) | (!mask[i] & no.0[i].to_bits()))))
    }
    #[inline(always)]
    fn bits(mask: Self::Mask) -> u32 {
        mask.iter().rev().fold(0, |bits, m| bits << 1 | u32::from(*m != 0))
    }
    #[inline(always)]
    fn any(mask: Self::Mask) -> bool {
        mask.iter().any(|m| *m != 0)
    }

    #[inline(always)]
    fn dispatch<K: Kernel>(kernel: K) {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has this instruction set.
            unsafe { with_avx2(kernel) }
            return;
        }
        kernel.run();
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn with_avx2<K: Kernel>(kernel: K) {
    kernel.run();
}

/// Sum of products of two vectors, bit-identical on every machine.
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sum = 0.0;
    Doubles::dispatch(Dot { a, b, sum: &mut sum });
    sum
}

struct Dot<'a> {
    a: &'a [f64],
    b: &'a [f64],
    sum: &'a mut f64,
}

impl Kernel for Dot<'_> {
    #[inline(always)]
    fn run(self) {
        let (a, b) = (self.a.as_chunks::<LANES>(), self.b.as_chunks::<LANES>());
        let mut sums = Doubles::splat(0.0);
        for (a, b) in a.0.iter().zip(b.0) {
            sums += Doubles(*a) * Doubles(*b);
        }
        *self.sum = sums.sum() + a.1.iter().zip(b.1).map(|(a, b)| a * b).sum::<f64>();
    }
}

/// Adds `share` times the vector `from` to `to`.
pub fn add_scaled(to: &mut [f64], share: f64, from: &[f64]) {
    Doubles::dispatch(AddScaled { to, share, from });
}

struct AddScaled<'a> {
    to: &'a mut [f64],
    share: f64,
    from: &'a [f64],
}

impl Kernel for AddScaled<'_> {
    #[inline(always)]
    fn run(self) {
        self.to.iter_mut().zip(self.from).for_each(|(to, from)| *to += self.share * from);
    }
}
