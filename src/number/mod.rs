//! The number trait of the hot path.
//!
//! Sand laws and the articulated-body dynamics are generic over [`Real`], so each equation is in the source once
//! and runs as `f64` (the reference), as `f32`, or as a vector of `f32` lanes in which lane `i` carries environment
//! `i` (structure of arrays).
//!
//! One binary contains AVX-512, AVX2 with FMA, and portable code, compiled from the same functions through [`Real::dispatch`]. All
//! functions that it calls are `#[inline(always)]`: one that is not inlined is compiled without the instruction set, which costs
//! a factor of two. The compiler does not always inline a closure that is called in several places.

use sandgait_base::error;

mod denormal;
mod doubles;
mod eight;
mod isa;
mod pair;
mod portable;
mod shorts;
mod vector;
#[cfg(target_arch = "x86_64")]
mod x86;

#[cfg(target_arch = "x86_64")]
pub use denormal::met_denormals;
pub use denormal::{flushed, unflushed};
pub use doubles::{Doubles, add_scaled, dot};
pub use eight::{EIGHT, Eight, EightWork, Spread};
pub use isa::{Isa, Work};
pub use pair::Pair;
pub use portable::Portable;
pub use shorts::{PlainShorts, SHORTS, Shorts};
pub use vector::{Mat3, Vec3};

use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// Work that is compiled for an instruction set, see [`Real::dispatch`]. All functions that `run` calls must be inlined, or must
/// dispatch kernels of their own. A part that several places need, or that rarely runs, is a kernel of its own: inlined everywhere,
/// such parts were three fifths of the machine code.
pub trait Kernel {
    fn run(self);
}

/// A real number, or a vector of real numbers that is computed lane by lane. No lane ever reads another lane.
pub trait Real:
    Copy
    + Send
    + Sync
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
{
    /// Number of environments in one value.
    const LANES: usize;
    /// The result of a comparison, one truth value for each lane.
    type Mask: Copy;
    /// Lanes of integers in the same instruction set.
    type Shorts: Shorts;

    /// The same number in every lane.
    fn splat(value: f64) -> Self;
    /// Lane `index` as `f64` (exact).
    fn lane(&self, index: usize) -> f64;
    /// Puts `value`, rounded to this precision, into lane `index`.
    fn set_lane(&mut self, index: usize, value: f64);
    /// `self * a + b`, fused where the instruction set fuses.
    fn mul_add(self, a: Self, b: Self) -> Self;
    fn sqrt(self) -> Self;
    fn abs(self) -> Self;
    fn min(self, other: Self) -> Self;
    fn max(self, other: Self) -> Self;
    /// Nearest integer (ties to even).
    fn round(self) -> Self;
    fn lt(self, other: Self) -> Self::Mask;
    /// In each lane: `yes` if `mask` is true, else `no`.
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;
    /// Bit i: is `mask` true in lane i?
    fn bits(mask: Self::Mask) -> u32;
    /// Is `mask` true in any lane?
    #[inline(always)]
    fn any(mask: Self::Mask) -> bool {
        Self::bits(mask) != 0
    }

    /// Runs `kernel` compiled for the instruction set of this type, as one function for all callers.
    #[inline(never)]
    fn dispatch<K: Kernel>(kernel: K) {
        kernel.run();
    }

    #[inline(always)]
    fn zero() -> Self {
        Self::splat(0.0)
    }
    #[inline(always)]
    fn one() -> Self {
        Self::splat(1.0)
    }
    #[inline(always)]
    fn clamp(self, low: Self, high: Self) -> Self {
        self.max(low).min(high)
    }

    /// Sine and cosine [rad]; absolute error below 2e-7 in `f32` for |angle| < 100 rad.
    ///
    /// Two-step Cody-Waite reduction by π/2 and minimax polynomials on ±π/4 (coefficients: Cephes `sinf`/`cosf`,
    /// S. L. Moshier). `f64` overrides this with the standard library.
    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let quarter = (self * Self::splat(std::f64::consts::FRAC_2_PI)).round();
        let x = quarter.mul_add(Self::splat(-1.570_312_5), self);
        let x = quarter.mul_add(Self::splat(-4.838_267_948_966_2e-4), x);
        let x2 = x * x;
        let sin = Self::splat(-1.951_529_589_1e-4)
            .mul_add(x2, Self::splat(8.332_160_873_6e-3))
            .mul_add(x2, Self::splat(-1.666_665_461_1e-1))
            .mul_add(x2 * x, x);
        let cos = Self::splat(2.443_315_711_809_948e-5)
            .mul_add(x2, Self::splat(-1.388_731_625_493_765e-3))
            .mul_add(x2, Self::splat(4.166_664_568_298_827e-2))
            .mul_add(x2 * x2, x2.mul_add(Self::splat(-0.5), Self::one()));
        // `quarter` mod 4 is the quadrant. Odd quadrants swap sine and cosine, and bit 1 changes the signs.
        let half = quarter * Self::splat(0.5);
        let odd = Self::splat(0.25).lt((half - half.round()).abs());
        let (s, c) = (Self::select(odd, cos, sin), Self::select(odd, sin, cos));
        let turn = |k: Self| {
            let k = k * Self::splat(0.25);
            // Fraction of a turn: 0, 1/4, 1/2 or 3/4. The sine is negative in quadrants 2 and 3, and the cosine is the
            // sine one quadrant later.
            let fraction = k - (k - Self::splat(0.375)).round();
            Self::splat(0.375).lt(fraction)
        };
        let negative_sin = turn(quarter);
        let negative_cos = turn(quarter + Self::one());
        (Self::select(negative_sin, -s, s), Self::select(negative_cos, -c, c))
    }
}

macro_rules! scalar {
    ($float:ty) => {
        impl Real for $float {
            const LANES: usize = 1;
            type Mask = bool;
            type Shorts = PlainShorts;
            #[inline(always)]
            fn splat(value: f64) -> Self {
                value as $float
            }
            #[inline(always)]
            fn lane(&self, _index: usize) -> f64 {
                *self as f64
            }
            #[inline(always)]
            fn set_lane(&mut self, _index: usize, value: f64) {
                *self = value as $float;
            }
            #[inline(always)]
            fn mul_add(self, a: Self, b: Self) -> Self {
                self * a + b
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                <$float>::sqrt(self)
            }
            #[inline(always)]
            fn abs(self) -> Self {
                <$float>::abs(self)
            }
            #[inline(always)]
            fn min(self, other: Self) -> Self {
                <$float>::min(self, other)
            }
            #[inline(always)]
            fn max(self, other: Self) -> Self {
                <$float>::max(self, other)
            }
            #[inline(always)]
            fn round(self) -> Self {
                self.round_ties_even()
            }
            #[inline(always)]
            fn lt(self, other: Self) -> bool {
                self < other
            }
            #[inline(always)]
            fn select(mask: bool, yes: Self, no: Self) -> Self {
                if mask { yes } else { no }
            }
            #[inline(always)]
            fn bits(mask: bool) -> u32 {
                mask.into()
            }
            #[inline(always)]
            fn sin_cos(self) -> (Self, Self) {
                <$float>::sin_cos(self)
            }
        }
    };
}
scalar!(f32);
scalar!(f64);
