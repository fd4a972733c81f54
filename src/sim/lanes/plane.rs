//! Bodies that lie in a plane: forces and masses summed in the plane's two coordinates.
//!
//! A link is a curve in the plane of its side view, and a belly is flat. So a piece is at o + p₀ e₀ + p₁ e₁, and two
//! products suffice for each component of its position, velocity and depth. The sums Σf, Σp₀f, Σp₁f and the moments of
//! the pieces' masses up to second order give the wrench and the inertia of all pieces. Wrench and inertia are
//! therefore computed once for a body, and not for each piece.

use crate::number::{Real, Vec3};
use crate::spatial::{PointMasses, Symmetric, Twist, Wrench};

/// A vector that changes linearly over a plane: `at` + p₀ `by[0]` + p₁ `by[1]`.
#[derive(Clone, Copy)]
pub struct PlaneField<R> {
    pub at: Vec3<R>,
    pub by: [Vec3<R>; 2],
}

impl<R: Real> PlaneField<R> {
    #[inline(always)]
    pub fn value(&self, p: [R; 2]) -> Vec3<R> {
        self.by[0].scale_add(p[0], self.by[1].scale_add(p[1], self.at))
    }

    /// Change along `p`.
    #[inline(always)]
    pub fn change(&self, p: [R; 2]) -> Vec3<R> {
        self.by[0].scale_add(p[0], self.by[1] * p[1])
    }

    /// Σmx of the values x at points p, from Σm and Σmp.
    #[inline(always)]
    pub fn sum(&self, mass: R, first: [R; 2]) -> Vec3<R> {
        self.at.scale_add(mass, self.change(first))
    }

    /// `self` is a field of places: their velocities on a body that moves with `twist`.
    #[inline(always)]
    pub fn velocity(&self, twist: &Twist<R>) -> Self {
        Self { at: twist.at(self.at), by: [twist.angular.cross(self.by[0]), twist.angular.cross(self.by[1])] }
    }

    /// `self + o`
    #[inline(always)]
    pub fn plus(&self, o: &Self) -> Self {
        Self { at: self.at + o.at, by: [self.by[0] + o.by[0], self.by[1] + o.by[1]] }
    }

    /// Each vector's part along the unit vector `n`.
    #[inline(always)]
    pub fn along(&self, n: Vec3<R>) -> Self {
        Self { at: n * n.dot(self.at), by: [n * n.dot(self.by[0]), n * n.dot(self.by[1])] }
    }

    /// The cross product `self` × `v` of each vector with `v`.
    #[inline(always)]
    pub fn cross(&self, v: Vec3<R>) -> Self {
        Self { at: self.at.cross(v), by: [self.by[0].cross(v), self.by[1].cross(v)] }
    }
}

/// Σm, Σmp and Σmppᵀ (00, 01, 11) of masses m at points p of a plane.
#[derive(Clone, Copy)]
pub struct PlaneMoments<R> {
    pub mass: R,
    pub first: [R; 2],
    pub second: [R; 3],
}

impl<R: Real> PlaneMoments<R> {
    #[inline(always)]
    pub fn zero() -> Self {
        let zero = R::zero();
        Self { mass: zero, first: [zero; 2], second: [zero; 3] }
    }

    #[inline(always)]
    pub fn add(&mut self, mass: R, p: [R; 2]) {
        let [m0, m1] = [mass * p[0], mass * p[1]];
        self.mass += mass;
        self.first[0] += m0;
        self.first[1] += m1;
        self.second[0] = m0.mul_add(p[0], self.second[0]);
        self.second[1] = m0.mul_add(p[1], self.second[1]);
        self.second[2] = m1.mul_add(p[1], self.second[2]);
    }

    #[inline(always)]
    pub fn scaled(&self, s: R) -> Self {
        let ([m0, m1], [m00, m01, m11]) = (self.first, self.second);
        Self { mass: self.mass * s, first: [m0 * s, m1 * s], second: [m00 * s, m01 * s, m11 * s] }
    }

    #[inline(always)]
    pub fn plus(&self, o: &Self) -> Self {
        let ([a0, a1], [b0, b1]) = (self.first, o.first);
        let ([a00, a01, a11], [b00, b01, b11]) = (self.second, o.second);
        Self { mass: self.mass + o.mass, first: [a0 + b0, a1 + b1], second: [a00 + b00, a01 + b01, a11 + b11] }
    }

    /// The forces that accelerate the masses by `accelerations`.
    #[inline(always)]
    pub fn forces(&self, accelerations: &PlaneField<R>) -> PlaneForces<R> {
        let ([m0, m1], [m00, m01, m11]) = (self.first, self.second);
        let force = accelerations.sum(self.mass, self.first);
        PlaneForces { force, first: [accelerations.sum(m0, [m00, m01]), accelerations.sum(m1, [m01, m11])] }
    }

    /// Σm, Σmx and Σmxxᵀ for the values x of `field`.
    #[inline(always)]
    pub fn of(&self, field: &PlaneField<R>) -> PointMasses<R> {
        let [m00, m01, m11] = self.second;
        let [e0, e1] = field.by;
        let arm = field.change(self.first);
        let sum = field.at.scale_add(self.mass, arm);
        let mut second = Symmetric::zero();
        second.add_product(e0, field.change([m00, m01]));
        second.add_product(e1, field.change([m01, m11]));
        second.add_product(field.at, sum);
        second.add_product(arm, field.at);
        PointMasses { mass: self.mass, first: sum, second }
    }
}

/// Forces on the pieces of a plane.
#[derive(Clone, Copy)]
pub struct PlaneForces<R> {
    pub force: Vec3<R>,
    /// Σp₀f, Σp₁f
    first: [Vec3<R>; 2],
}

impl<R: Real> PlaneForces<R> {
    #[inline(always)]
    pub fn zero() -> Self {
        Self { force: Vec3::zero(), first: [Vec3::zero(); 2] }
    }

    #[inline(always)]
    pub fn add(&mut self, force: Vec3<R>, p: [R; 2]) {
        self.force += force;
        self.first[0] = force.scale_add(p[0], self.first[0]);
        self.first[1] = force.scale_add(p[1], self.first[1]);
    }

    #[inline(always)]
    pub fn plus(&mut self, o: &Self) {
        self.force += o.force;
        self.first[0] += o.first[0];
        self.first[1] += o.first[1];
    }

    #[inline(always)]
    pub fn minus(&self, o: &Self) -> Self {
        let ([a0, a1], [b0, b1]) = (self.first, o.first);
        Self { force: self.force - o.force, first: [a0 - b0, a1 - b1] }
    }

    /// The forces' wrench about the origin of `places`.
    #[inline(always)]
    pub fn wrench(&self, places: &PlaneField<R>) -> Wrench<R> {
        let [e0, e1] = places.by;
        let moment = places.at.cross(self.force) + e0.cross(self.first[0]) + e1.cross(self.first[1]);
        Wrench { moment, force: self.force }
    }
}
