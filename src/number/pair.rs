//! Two values of a number type as one value with twice as many lanes.

use super::{Kernel, Real};
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

#[derive(Clone, Copy)]
pub struct Pair<R>(pub R, pub R);

macro_rules! operator {
    ($trait:ident, $method:ident) => {
        impl<R: Real> $trait for Pair<R> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, o: Self) -> Self {
                Self($trait::$method(self.0, o.0), $trait::$method(self.1, o.1))
            }
        }
    };
}
operator!(Add, add);
operator!(Sub, sub);
operator!(Mul, mul);
operator!(Div, div);

impl<R: Real> Neg for Pair<R> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(-self.0, -self.1)
    }
}
impl<R: Real> AddAssign for Pair<R> {
    #[inline(always)]
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}
impl<R: Real> SubAssign for Pair<R> {
    #[inline(always)]
    fn sub_assign(&mut self, o: Self) {
        *self = *self - o;
    }
}

macro_rules! both {
    ($($method:ident($($other:ident),*);)*) => {
        $(#[inline(always)]
        fn $method(self, $($other: Self),*) -> Self {
            Self(self.0.$method($($other.0),*), self.1.$method($($other.1),*))
        })*
    };
}

impl<R: Real> Real for Pair<R> {
    const LANES: usize = 2 * R::LANES;
    type Mask = (R::Mask, R::Mask);
    type Shorts = R::Shorts;

    #[inline(always)]
    fn splat(value: f64) -> Self {
        Self(R::splat(value), R::splat(value))
    }
    #[inline(always)]
    fn lane(&self, index: usize) -> f64 {
        if index < R::LANES { self.0.lane(index) } else { self.1.lane(index - R::LANES) }
    }
    #[inline(always)]
    fn set_lane(&mut self, index: usize, value: f64) {
        if index < R::LANES { self.0.set_lane(index, value) } else { self.1.set_lane(index - R::LANES, value) }
    }
    both! {
        mul_add(a, b);
        sqrt();
        abs();
        min(o);
        max(o);
        round();
    }
    #[inline(always)]
    fn lt(self, o: Self) -> Self::Mask {
        (self.0.lt(o.0), self.1.lt(o.1))
    }
    #[inline(always)]
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self {
        Self(R::select(mask.0, yes.0, no.0), R::select(mask.1, yes.1, no.1))
    }
    #[inline(always)]
    fn bits(mask: Self::Mask) -> u32 {
        R::bits(mask.0) | R::bits(mask.1) << R::LANES
    }
    #[inline(always)]
    fn dispatch<K: Kernel>(kernel: K) {
        R::dispatch(kernel);
    }
}
