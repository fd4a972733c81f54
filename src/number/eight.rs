//! Eight lanes of `f64`, for work on many similar items of one state: the patches of a body. A value in lanes is made from one
//! number that all lanes share, or from one number for each lane ([`Spread`]).

use super::{Isa, Real};

/// Number of lanes of [`Eight`]: a register of AVX-512, or two of AVX2.
pub const EIGHT: usize = 8;

/// Eight lanes of `f64`. Every implementation fuses multiplication and addition, and [`Eight::sum`] adds in a fixed
/// order, so all implementations give bit-identical results.
pub trait Eight: Real {
    fn of_singles(lanes: &[f32; EIGHT]) -> Self;
    fn of_doubles(lanes: &[f64; EIGHT]) -> Self;

    /// Sum over all lanes.
    #[inline(always)]
    fn sum(self) -> f64 {
        let [a, b] = [self.lane(0) + self.lane(1), self.lane(2) + self.lane(3)];
        let [c, d] = [self.lane(4) + self.lane(5), self.lane(6) + self.lane(7)];
        (a + b) + (c + d)
    }
}

/// A number for all lanes, or an array with one number for each lane.
pub trait Spread<R>: Copy {
    fn spread(&self) -> R;
}

impl<R: Real> Spread<R> for f32 {
    #[inline(always)]
    fn spread(&self) -> R {
        R::splat(f64::from(*self))
    }
}
impl<R: Real> Spread<R> for f64 {
    #[inline(always)]
    fn spread(&self) -> R {
        R::splat(*self)
    }
}
impl<R: Eight> Spread<R> for [f32; EIGHT] {
    #[inline(always)]
    fn spread(&self) -> R {
        R::of_singles(self)
    }
}
impl<R: Eight> Spread<R> for [f64; EIGHT] {
    #[inline(always)]
    fn spread(&self) -> R {
        R::of_doubles(self)
    }
}

/// Work that is generic over eight lanes of `f64`, see [`Isa::eights`].
pub trait EightWork {
    type Out;
    fn run<R: Eight>(self) -> Self::Out;
    /// Does the same work without lanes.
    fn single(self) -> Self::Out;
}

impl Isa {
    /// Runs `work` in registers of AVX-512 or AVX2 if `self` is that instruction set and the machine has it, otherwise
    /// without lanes.
    pub fn eights<W: EightWork>(self, work: W) -> W::Out {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 if self.available() => work.run::<super::x86::Avx512Doubles>(),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 if self.available() => work.run::<super::Pair<super::x86::Avx2Doubles>>(),
            _ => work.single(),
        }
    }
}
