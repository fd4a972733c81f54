//! Lanes in AVX2 and AVX-512 registers.
//!
//! Every `unsafe` here is of one of two kinds. (1) Intrinsics need their instruction set. Values of these types are
//! used only inside [`Real::dispatch`], and only after [`super::Isa::available`] has found the instruction set. The
//! operators have to be safe functions, because the equations are written with operators. So the types are private to
//! this crate, and used only through [`super::Isa`], which makes this check. (2) Access to a lane reads the register's
//! memory as an array of floats.

use super::{EIGHT, Eight, Kernel, Pair, Real, SHORTS, Shorts};
use std::arch::x86_64::*;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

macro_rules! lanes {
    ($(#[$doc:meta])* $name:ident, $register:ty, $float:ty, $lanes:literal, $mask:ty, $features:literal, $splat:ident,
     $add:ident, $sub:ident, $mul:ident, $div:ident, $fma:ident, $sqrt:ident, $min:ident, $max:ident,
     abs: $abs:expr, round: $round:expr, lt: $lt:expr, select: $select:expr, bits: $bits:expr) => {
        $(#[$doc])*
        #[derive(Clone, Copy)]
        #[repr(transparent)]
        pub struct $name($register);

        lanes!(@operator $name, Add, add, $add);
        lanes!(@operator $name, Sub, sub, $sub);
        lanes!(@operator $name, Mul, mul, $mul);
        lanes!(@operator $name, Div, div, $div);

        impl Neg for $name {
            type Output = Self;
            #[inline(always)]
            fn neg(self) -> Self {
                // SAFETY: inside `dispatch`, see the module. −0 − x flips the sign of every x.
                Self(unsafe { $sub($splat(-0.0), self.0) })
            }
        }
        impl AddAssign for $name {
            #[inline(always)]
            fn add_assign(&mut self, o: Self) {
                *self = *self + o;
            }
        }
        impl SubAssign for $name {
            #[inline(always)]
            fn sub_assign(&mut self, o: Self) {
                *self = *self - o;
            }
        }

        // SAFETY of each block: inside `dispatch`, see the module.
        impl Real for $name {
            const LANES: usize = $lanes;
            type Mask = $mask;
            type Shorts = Avx2Shorts;

            #[inline(always)]
            fn splat(value: f64) -> Self {
                // SAFETY: an array of floats has the register's size, and any bits are valid floats.
                Self(unsafe { std::mem::transmute::<[$float; $lanes], $register>([value as $float; $lanes]) })
            }
            #[inline(always)]
            fn lane(&self, index: usize) -> f64 {
                // SAFETY: the register's memory is an array of floats.
                let lanes = unsafe { &*(&raw const self.0).cast::<[$float; $lanes]>() };
                f64::from(lanes[index])
            }
            #[inline(always)]
            fn set_lane(&mut self, index: usize, value: f64) {
                // SAFETY: the register's memory is an array of floats.
                let lanes = unsafe { &mut *(&raw mut self.0).cast::<[$float; $lanes]>() };
                lanes[index] = value as $float;
            }
            #[inline(always)]
            fn mul_add(self, a: Self, b: Self) -> Self {
                Self(unsafe { $fma(self.0, a.0, b.0) })
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                Self(unsafe { $sqrt(self.0) })
            }
            #[inline(always)]
            fn abs(self) -> Self {
                Self(unsafe { $abs(self.0) })
            }
            #[inline(always)]
            fn min(self, o: Self) -> Self {
                Self(unsafe { $min(self.0, o.0) })
            }
            #[inline(always)]
            fn max(self, o: Self) -> Self {
                Self(unsafe { $max(self.0, o.0) })
            }
            #[inline(always)]
            fn round(self) -> Self {
                Self(unsafe { $round(self.0) })
            }
            #[inline(always)]
            fn lt(self, o: Self) -> $mask {
                unsafe { $lt(self.0, o.0) }
            }
            #[inline(always)]
            fn select(mask: $mask, yes: Self, no: Self) -> Self {
                Self(unsafe { $select(mask, yes.0, no.0) })
            }
            #[inline(always)]
            fn bits(mask: $mask) -> u32 {
                unsafe { $bits(mask) }
            }
            #[inline(always)]
            fn dispatch<K: Kernel>(kernel: K) {
                #[inline(never)]
                #[target_feature(enable = $features)]
                fn inside<K: Kernel>(kernel: K) {
                    kernel.run();
                }
                // SAFETY: blocks of this type exist only where `Isa::available` found the features.
                unsafe { inside(kernel) }
            }
        }
    };
    (@operator $name:ident, $trait:ident, $method:ident, $intrinsic:ident) => {
        impl $trait for $name {
            type Output = Self;
            #[inline(always)]
            fn $method(self, o: Self) -> Self {
                // SAFETY: inside `dispatch`, see the module.
                Self(unsafe { $intrinsic(self.0, o.0) })
            }
        }
    };
}

lanes!(
    /// Sixteen lanes of `f32`.
    Avx512, __m512, f32, 16, __mmask16, "avx512f,avx512dq,avx2,fma", _mm512_set1_ps,
    _mm512_add_ps, _mm512_sub_ps, _mm512_mul_ps, _mm512_div_ps, _mm512_fmadd_ps, _mm512_sqrt_ps, _mm512_min_ps, _mm512_max_ps,
    abs: _mm512_abs_ps,
    round: |x| _mm512_roundscale_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(x),
    lt: |a, b| _mm512_cmp_ps_mask::<_CMP_LT_OQ>(a, b),
    select: |m, yes, no| _mm512_mask_blend_ps(m, no, yes),
    bits: |m| _mm512_mask2int(m) as u32
);

lanes!(
    /// Eight lanes of `f32`.
    Avx2, __m256, f32, 8, __m256, "avx2,fma", _mm256_set1_ps,
    _mm256_add_ps, _mm256_sub_ps, _mm256_mul_ps, _mm256_div_ps, _mm256_fmadd_ps, _mm256_sqrt_ps, _mm256_min_ps, _mm256_max_ps,
    abs: |x| _mm256_andnot_ps(_mm256_set1_ps(-0.0), x),
    round: |x| _mm256_round_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(x),
    lt: |a, b| _mm256_cmp_ps::<_CMP_LT_OQ>(a, b),
    select: |m, yes, no| _mm256_blendv_ps(no, yes, m),
    bits: |m| _mm256_movemask_ps(m) as u32
);

lanes!(
    /// Eight lanes of `f64`.
    Avx512Doubles, __m512d, f64, 8, __mmask8, "avx512f,avx512dq,avx2,fma", _mm512_set1_pd,
    _mm512_add_pd, _mm512_sub_pd, _mm512_mul_pd, _mm512_div_pd, _mm512_fmadd_pd, _mm512_sqrt_pd, _mm512_min_pd, _mm512_max_pd,
    abs: _mm512_abs_pd,
    round: |x| _mm512_roundscale_pd::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(x),
    lt: |a, b| _mm512_cmp_pd_mask::<_CMP_LT_OQ>(a, b),
    select: |m, yes, no| _mm512_mask_blend_pd(m, no, yes),
    bits: _cvtmask8_u32
);

lanes!(
    /// Four lanes of `f64`, half of an [`Eight`].
    Avx2Doubles, __m256d, f64, 4, __m256d, "avx2,fma", _mm256_set1_pd,
    _mm256_add_pd, _mm256_sub_pd, _mm256_mul_pd, _mm256_div_pd, _mm256_fmadd_pd, _mm256_sqrt_pd, _mm256_min_pd, _mm256_max_pd,
    abs: |x| _mm256_andnot_pd(_mm256_set1_pd(-0.0), x),
    round: |x| _mm256_round_pd::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(x),
    lt: |a, b| _mm256_cmp_pd::<_CMP_LT_OQ>(a, b),
    select: |m, yes, no| _mm256_blendv_pd(no, yes, m),
    bits: |m| _mm256_movemask_pd(m) as u32
);

impl Eight for Avx512Doubles {
    #[inline(always)]
    fn of_singles(lanes: &[f32; EIGHT]) -> Self {
        // SAFETY: inside `dispatch`, see the module; the array has eight numbers.
        Self(unsafe { _mm512_cvtps_pd(_mm256_loadu_ps(lanes.as_ptr())) })
    }
    #[inline(always)]
    fn of_doubles(lanes: &[f64; EIGHT]) -> Self {
        // SAFETY: inside `dispatch`, see the module; the array has eight numbers.
        Self(unsafe { _mm512_loadu_pd(lanes.as_ptr()) })
    }
}

impl Eight for Pair<Avx2Doubles> {
    #[inline(always)]
    fn of_singles(lanes: &[f32; EIGHT]) -> Self {
        let at = lanes.as_ptr();
        // SAFETY: inside `dispatch`, see the module; the array has eight numbers.
        let [low, high] = unsafe { [_mm256_cvtps_pd(_mm_loadu_ps(at)), _mm256_cvtps_pd(_mm_loadu_ps(at.add(4)))] };
        Self(Avx2Doubles(low), Avx2Doubles(high))
    }
    #[inline(always)]
    fn of_doubles(lanes: &[f64; EIGHT]) -> Self {
        let at = lanes.as_ptr();
        // SAFETY: inside `dispatch`, see the module; the array has eight numbers.
        let [low, high] = unsafe { [_mm256_loadu_pd(at), _mm256_loadu_pd(at.add(4))] };
        Self(Avx2Doubles(low), Avx2Doubles(high))
    }
}

/// Sixteen lanes of `i16`.
#[derive(Clone, Copy)]
#[repr(transparent)]
pub struct Avx2Shorts(__m256i);

macro_rules! shorts {
    ($($method:ident $intrinsic:ident)*) => {
        $(
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                // SAFETY: inside `dispatch`, see the module.
                Self(unsafe { $intrinsic(self.0, other.0) })
            }
        )*
    };
}

// SAFETY of each block: inside `dispatch`, see the module; arrays have sixteen numbers.
impl Shorts for Avx2Shorts {
    #[inline(always)]
    fn dispatch<K: Kernel>(kernel: K) {
        #[inline(never)]
        #[target_feature(enable = "avx2,fma")]
        fn inside<K: Kernel>(kernel: K) {
            kernel.run();
        }
        unsafe { inside(kernel) }
    }

    shorts! {
        plus _mm256_add_epi16
        minus _mm256_sub_epi16
        less _mm256_subs_epi16
        min _mm256_min_epi16
        max _mm256_max_epi16
        and _mm256_and_si256
        or _mm256_or_si256
        high_product _mm256_mulhi_epu16
        low_product _mm256_mullo_epi16
        above _mm256_cmpgt_epi16
        signed _mm256_sign_epi16
    }

    #[inline(always)]
    fn splat(value: i16) -> Self {
        Self(unsafe { _mm256_set1_epi16(value) })
    }
    #[inline(always)]
    fn of(lanes: &[i16; SHORTS]) -> Self {
        Self(unsafe { _mm256_loadu_si256(lanes.as_ptr().cast()) })
    }
    #[inline(always)]
    fn of_bytes(lanes: &[u8; SHORTS]) -> Self {
        Self(unsafe { _mm256_cvtepu8_epi16(_mm_loadu_si128(lanes.as_ptr().cast())) })
    }
    #[inline(always)]
    fn to(self, lanes: &mut [i16; SHORTS]) {
        unsafe { _mm256_storeu_si256(lanes.as_mut_ptr().cast(), self.0) }
    }
    #[inline(always)]
    fn to_bytes(self, lanes: &mut [u8; SHORTS]) {
        unsafe {
            let packed = _mm_packus_epi16(_mm256_castsi256_si128(self.0), _mm256_extracti128_si256::<1>(self.0));
            _mm_storeu_si128(lanes.as_mut_ptr().cast(), packed);
        }
    }
    #[inline(always)]
    fn raised(self, before: Self) -> Self {
        unsafe {
            let below = _mm256_permute2x128_si256::<0x21>(before.0, self.0);
            Self(_mm256_alignr_epi8::<14>(self.0, below))
        }
    }
    #[inline(always)]
    fn lowered(self, last: i16) -> Self {
        unsafe {
            // The upper half in the lower one.
            let above = _mm256_permute2x128_si256::<0x81>(self.0, self.0);
            let above = _mm256_insert_epi16::<8>(above, last);
            Self(_mm256_alignr_epi8::<2>(above, self.0))
        }
    }
    #[inline(always)]
    fn magnitude(self) -> Self {
        Self(unsafe { _mm256_abs_epi16(self.0) })
    }
    #[inline(always)]
    fn quarter_over(self, other: Self) -> Self {
        Self(unsafe { _mm256_srli_epi16::<2>(_mm256_subs_epu16(self.0, other.0)) })
    }
    #[inline(always)]
    fn any(self) -> bool {
        unsafe { _mm256_testz_si256(self.0, self.0) == 0 }
    }
    #[inline(always)]
    fn sum(self) -> i32 {
        unsafe {
            let pairs = _mm256_madd_epi16(self.0, _mm256_set1_epi16(1));
            let four = _mm_add_epi32(_mm256_castsi256_si128(pairs), _mm256_extracti128_si256::<1>(pairs));
            let two = _mm_add_epi32(four, _mm_shuffle_epi32::<0b00_00_11_10>(four));
            _mm_cvtsi128_si32(_mm_add_epi32(two, _mm_shuffle_epi32::<0b01>(two)))
        }
    }
}
