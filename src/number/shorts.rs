//! Sixteen lanes of `i16`, for work on many cells of one grid. All operations are exact, so every instruction set gives
//! the same result.

use super::Kernel;

/// Number of lanes of [`Shorts`]: a register of AVX2.
pub const SHORTS: usize = 16;

/// Sixteen lanes of `i16`.
pub trait Shorts: Copy {
    fn splat(value: i16) -> Self;
    fn of(lanes: &[i16; SHORTS]) -> Self;
    /// Bytes from 0 to 255.
    fn of_bytes(lanes: &[u8; SHORTS]) -> Self;
    fn to(self, lanes: &mut [i16; SHORTS]);
    /// Writes the lanes as bytes; numbers outside of 0 to 255 saturate.
    fn to_bytes(self, lanes: &mut [u8; SHORTS]);
    /// Sum. It wraps around, as do all operations here unless their comment says otherwise.
    fn plus(self, other: Self) -> Self;
    fn minus(self, other: Self) -> Self;
    /// Difference, which saturates.
    fn less(self, other: Self) -> Self;
    fn min(self, other: Self) -> Self;
    fn max(self, other: Self) -> Self;
    /// Bit by bit.
    fn and(self, other: Self) -> Self;
    fn or(self, other: Self) -> Self;
    /// Moves each number to the next lane; the first lane gets the last number of `before`.
    fn raised(self, before: Self) -> Self;
    /// Moves each number to the lane before; the last lane gets `last`.
    fn lowered(self, last: i16) -> Self;
    /// Absolute values, as `u16`.
    fn magnitude(self) -> Self;
    /// A quarter of `self` − `other`, both as `u16`; 0 if `self` is less.
    fn quarter_over(self, other: Self) -> Self;
    /// The number with the sign of `sign`; 0 where `sign` is 0.
    fn signed(self, sign: Self) -> Self;
    /// Upper 16 bits of the product, with both factors as `u16`.
    fn high_product(self, other: Self) -> Self;
    /// Lower 16 bits of the product.
    fn low_product(self, other: Self) -> Self;
    /// All bits set where `self` > `other`, no bit elsewhere.
    fn above(self, other: Self) -> Self;
    /// Is any bit set?
    fn any(self) -> bool;
    fn sum(self) -> i32;

    /// Runs `kernel` compiled for the instruction set of this type, as one function for all callers: see [`super::Real::dispatch`].
    #[inline(never)]
    fn dispatch<K: Kernel>(kernel: K) {
        kernel.run();
    }

    /// The lanes of `slice` from `at` on.
    #[inline(always)]
    fn load(slice: &[i16], at: usize) -> Self {
        Self::of(slice[at..at + SHORTS].first_chunk().expect("as long as that"))
    }
    /// Writes the lanes to `slice` from `at` on.
    #[inline(always)]
    fn store(self, slice: &mut [i16], at: usize) {
        self.to(slice[at..at + SHORTS].first_chunk_mut().expect("as long as that"));
    }
    /// In each lane: `yes` where all bits of `mask` are set, `no` where none is.
    #[inline(always)]
    fn select(mask: Self, yes: Self, no: Self) -> Self {
        no.plus(yes.minus(no).and(mask))
    }
}

/// In portable code.
#[derive(Clone, Copy)]
pub struct PlainShorts([i16; SHORTS]);

impl PlainShorts {
    #[inline(always)]
    fn each(self, other: Self, op: impl Fn(i16, i16) -> i16) -> Self {
        Self(std::array::from_fn(|i| op(self.0[i], other.0[i])))
    }
}

impl Shorts for PlainShorts {
    #[inline(always)]
    fn splat(value: i16) -> Self {
        Self([value; SHORTS])
    }
    #[inline(always)]
    fn of(lanes: &[i16; SHORTS]) -> Self {
        Self(*lanes)
    }
    #[inline(always)]
    fn of_bytes(lanes: &[u8; SHORTS]) -> Self {
        Self(lanes.map(i16::from))
    }
    #[inline(always)]
    fn to(self, lanes: &mut [i16; SHORTS]) {
        *lanes = self.0;
    }
    #[inline(always)]
    fn to_bytes(self, lanes: &mut [u8; SHORTS]) {
        *lanes = self.0.map(|lane| lane.clamp(0, 255) as u8);
    }
    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        self.each(other, i16::wrapping_add)
    }
    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        self.each(other, i16::wrapping_sub)
    }
    #[inline(always)]
    fn less(self, other: Self) -> Self {
        self.each(other, i16::saturating_sub)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.each(other, Ord::min)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.each(other, Ord::max)
    }
    #[inline(always)]
    fn and(self, other: Self) -> Self {
        self.each(other, |a, b| a & b)
    }
    #[inline(always)]
    fn or(self, other: Self) -> Self {
        self.each(other, |a, b| a | b)
    }
    #[inline(always)]
    fn raised(self, before: Self) -> Self {
        Self(std::array::from_fn(|i| if i == 0 { before.0[SHORTS - 1] } else { self.0[i - 1] }))
    }
    #[inline(always)]
    fn lowered(self, last: i16) -> Self {
        Self(std::array::from_fn(|i| if i + 1 == SHORTS { last } else { self.0[i + 1] }))
    }
    #[inline(always)]
    fn magnitude(self) -> Self {
        Self(self.0.map(|lane| lane.unsigned_abs() as i16))
    }
    #[inline(always)]
    fn quarter_over(self, other: Self) -> Self {
        self.each(other, |a, b| ((a as u16).saturating_sub(b as u16) >> 2) as i16)
    }
    #[inline(always)]
    fn signed(self, sign: Self) -> Self {
        self.each(sign, |a, s| a.wrapping_mul(s.signum()))
    }
    #[inline(always)]
    fn high_product(self, other: Self) -> Self {
        self.each(other, |a, b| ((u32::from(a as u16) * u32::from(b as u16)) >> 16) as i16)
    }
    #[inline(always)]
    fn low_product(self, other: Self) -> Self {
        self.each(other, i16::wrapping_mul)
    }
    #[inline(always)]
    fn above(self, other: Self) -> Self {
        self.each(other, |a, b| if a > b { -1 } else { 0 })
    }
    #[inline(always)]
    fn any(self) -> bool {
        self.0 != [0; SHORTS]
    }
    #[inline(always)]
    fn sum(self) -> i32 {
        self.0.iter().map(|lane| i32::from(*lane)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Isa, Real, Work};

    struct Every<'a>(&'a [[i16; SHORTS]; 3]);

    /// Results of all operations on three vectors.
    fn results<S: Shorts>([a, b, c]: [S; 3]) -> Vec<[i16; SHORTS]> {
        let all = [
            S::splat(-7),
            a.plus(b),
            a.minus(b),
            a.less(b),
            a.min(b),
            a.max(b),
            a.and(b),
            a.or(b),
            a.raised(b),
            a.lowered(9),
            a.magnitude(),
            a.quarter_over(b),
            a.signed(b),
            a.high_product(b),
            a.low_product(b),
            a.above(b),
            S::select(a.above(b), b, c),
            S::splat(a.sum() as i16),
            S::splat(a.and(b).and(c).any().into()),
        ];
        let mut bytes = [0; SHORTS];
        a.to_bytes(&mut bytes);
        let lanes = |s: &S| {
            let mut lanes = [0; SHORTS];
            s.to(&mut lanes);
            lanes
        };
        all.iter().chain([&S::of_bytes(&bytes)]).map(lanes).collect()
    }

    struct InLanes<'a, R>(&'a [[i16; SHORTS]; 3], &'a mut Vec<[i16; SHORTS]>, std::marker::PhantomData<R>);
    impl<R: Real> crate::Kernel for InLanes<'_, R> {
        #[inline(always)]
        fn run(self) {
            *self.1 = results(self.0.each_ref().map(R::Shorts::of));
        }
    }

    impl Work for Every<'_> {
        type Out = Vec<[i16; SHORTS]>;
        fn run<R: Real>(self) -> Self::Out {
            let mut out = Vec::new();
            R::dispatch(InLanes::<R>(self.0, &mut out, std::marker::PhantomData));
            out
        }
    }

    /// Every instruction set gives the same results.
    #[test]
    fn instruction_sets_agree() {
        let mut state = 1_u64;
        let mut draw = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            // Also small numbers, and the ends of the range.
            match state >> 62 {
                0 => i16::MIN,
                1 => i16::MAX,
                2 => (state >> 40) as i16 >> 12,
                _ => (state >> 40) as i16,
            }
        };
        for _ in 0..1000 {
            let vectors: [[i16; SHORTS]; 3] = std::array::from_fn(|_| std::array::from_fn(|_| draw()));
            let plain = results(vectors.each_ref().map(PlainShorts::of));
            for isa in Isa::ALL.into_iter().filter(|isa| isa.available()) {
                assert_eq!(isa.with(Every(&vectors)).unwrap(), plain, "{isa:?} {vectors:?}");
            }
        }
    }
}
