//! Three-vectors and 3×3 matrices over any [`Real`]; only what the hot path needs.

use super::Real;
use std::ops::{Add, AddAssign, Mul, Neg, Sub};

/// A vector in space; axes x forward, y left, z up.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Vec3<R> {
    pub x: R,
    pub y: R,
    pub z: R,
}

impl<R: Real> Vec3<R> {
    #[inline(always)]
    pub fn new(x: R, y: R, z: R) -> Self {
        Self { x, y, z }
    }
    #[inline(always)]
    pub fn zero() -> Self {
        Self::splat([0.0; 3])
    }
    /// The same vector in every lane.
    #[inline(always)]
    pub fn splat(v: [f64; 3]) -> Self {
        Self::new(R::splat(v[0]), R::splat(v[1]), R::splat(v[2]))
    }
    #[inline(always)]
    pub fn dot(self, o: Self) -> R {
        self.x.mul_add(o.x, self.y.mul_add(o.y, self.z * o.z))
    }
    #[inline(always)]
    pub fn cross(self, o: Self) -> Self {
        Self::new(
            self.y.mul_add(o.z, -(self.z * o.y)),
            self.z.mul_add(o.x, -(self.x * o.z)),
            self.x.mul_add(o.y, -(self.y * o.x)),
        )
    }
    #[inline(always)]
    pub fn norm_squared(self) -> R {
        self.dot(self)
    }
    /// `self * s + o`
    #[inline(always)]
    pub fn scale_add(self, s: R, o: Self) -> Self {
        Self::new(self.x.mul_add(s, o.x), self.y.mul_add(s, o.y), self.z.mul_add(s, o.z))
    }
    /// Lane `index` as `f64`.
    #[inline(always)]
    pub fn lane(&self, index: usize) -> [f64; 3] {
        [self.x.lane(index), self.y.lane(index), self.z.lane(index)]
    }
    #[inline(always)]
    pub fn set_lane(&mut self, index: usize, v: [f64; 3]) {
        self.x.set_lane(index, v[0]);
        self.y.set_lane(index, v[1]);
        self.z.set_lane(index, v[2]);
    }
}

impl<R: Real> Add for Vec3<R> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        Self::new(self.x + o.x, self.y + o.y, self.z + o.z)
    }
}
impl<R: Real> AddAssign for Vec3<R> {
    #[inline(always)]
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}
impl<R: Real> Sub for Vec3<R> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        Self::new(self.x - o.x, self.y - o.y, self.z - o.z)
    }
}
impl<R: Real> Neg for Vec3<R> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self::new(-self.x, -self.y, -self.z)
    }
}
impl<R: Real> Mul<R> for Vec3<R> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, s: R) -> Self {
        Self::new(self.x * s, self.y * s, self.z * s)
    }
}

/// A 3×3 matrix, stored as its columns. The columns of a rotation are the images of the axes.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Mat3<R> {
    pub x: Vec3<R>,
    pub y: Vec3<R>,
    pub z: Vec3<R>,
}

impl<R: Real> Mat3<R> {
    #[inline(always)]
    pub fn new(x: Vec3<R>, y: Vec3<R>, z: Vec3<R>) -> Self {
        Self { x, y, z }
    }
    #[inline(always)]
    pub fn identity() -> Self {
        Self::new(Vec3::splat([1.0, 0.0, 0.0]), Vec3::splat([0.0, 1.0, 0.0]), Vec3::splat([0.0, 0.0, 1.0]))
    }
    /// Matrix times vector.
    #[inline(always)]
    pub fn apply(&self, v: Vec3<R>) -> Vec3<R> {
        self.x.scale_add(v.x, self.y.scale_add(v.y, self.z * v.z))
    }
    /// Transpose times vector.
    #[inline(always)]
    pub fn apply_transposed(&self, v: Vec3<R>) -> Vec3<R> {
        Vec3::new(self.x.dot(v), self.y.dot(v), self.z.dot(v))
    }
    #[inline(always)]
    pub fn transposed(&self) -> Self {
        let (a, b, c) = (&self.x, &self.y, &self.z);
        Self::new(Vec3::new(a.x, b.x, c.x), Vec3::new(a.y, b.y, c.y), Vec3::new(a.z, b.z, c.z))
    }
    /// Matrix times matrix.
    #[inline(always)]
    pub fn compose(&self, o: &Self) -> Self {
        Self::new(self.apply(o.x), self.apply(o.y), self.apply(o.z))
    }
}
