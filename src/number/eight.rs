//! Eight numbers of type `f64` in a value, for work on many similar items: the segments of an intruder, or the patches of a
//! body. Values in lanes come from numbers that all lanes share, or from one number for each lane.

use super::{Doubles, Isa, Real};

/// Number of lanes of [`Eight`].
pub const EIGHT: usize = 8;

/// Eight lanes of `f64`. No operation is fused and [`Eight::sum`] has one order, so every instruction set gives the same
/// bits.
pub trait Eight: Real {
    fn of_singles(lanes: &[f32; EIGHT]) -> Self;
    fn of_doubles(lanes: &[f64; EIGHT]) -> Self;

    /// Sum over all lanes.
    #[inline(always)]
    fn sum(self) -> f64 {
        let half = |i: usize| (self.lane(i) + self.lane(i + 1)) + (self.lane(i + 2) + self.lane(i + 3));
        half(0) + half(4)
    }
}

impl Eight for Doubles {
    #[inline(always)]
    #[allow(clippy::needless_range_loop)] // iterators' functions would be compiled without the instruction set
    fn of_singles(lanes: &[f32; EIGHT]) -> Self {
        let mut all = [0.0; EIGHT];
        for i in 0..EIGHT {
            all[i] = f64::from(lanes[i]);
        }
        Self::from_array(all)
    }
    #[inline(always)]
    fn of_doubles(lanes: &[f64; EIGHT]) -> Self {
        Self::from_array(*lanes)
    }
}

/// A number, or one for each lane, that is put into lanes.
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
}

impl Isa {
    /// Runs `work` with eight lanes of `f64`: in AVX-512 registers if this is the instruction set and the machine has it,
    /// otherwise in arrays that the compiler vectorises.
    pub fn eights<W: EightWork>(self, work: W) -> W::Out {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 if self.available() => work.run::<super::x86::Avx512Doubles>(),
            _ => work.run::<Doubles>(),
        }
    }
}
