//! Sand forces on plates that lie in one plane of a body, summed in the plane's two coordinates.
//!
//! A leg's strip is a curve in the plane of its side view, and a belly is flat. A plate is at o + p₀ e₀ + p₁ e₁ then, so
//! its place, velocity and depth take two products a component, and what all plates together do to the body follows from
//! the sums Σf, Σp₀f, Σp₁f and from the moments of their point masses up to the second order: turned into a wrench and an
//! inertia once a body, not once a plate.

use super::spatial::{PointMasses, Symmetric, Twist, Wrench};
use crate::number::{Real, Vec3};

/// A vector that changes linearly over a plane: `at` + p₀ `by[0]` + p₁ `by[1]`.
#[derive(Clone, Copy)]
pub struct Field<R> {
    pub at: Vec3<R>,
    pub by: [Vec3<R>; 2],
}

impl<R: Real> Field<R> {
    #[inline(always)]
    pub fn value(&self, p: [R; 2]) -> Vec3<R> {
        self.by[0].scale_add(p[0], self.by[1].scale_add(p[1], self.at))
    }

    /// How much it changes along `p`.
    #[inline(always)]
    pub fn change(&self, p: [R; 2]) -> Vec3<R> {
        self.by[0].scale_add(p[0], self.by[1] * p[1])
    }

    /// Velocities of these places on a body that moves with `twist`.
    #[inline(always)]
    pub fn velocity(&self, twist: &Twist<R>) -> Self {
        Self { at: twist.at(self.at), by: [twist.angular.cross(self.by[0]), twist.angular.cross(self.by[1])] }
    }

    /// Each vector's product with `v`, as in `self` × `v`.
    #[inline(always)]
    pub fn cross(&self, v: Vec3<R>) -> Self {
        Self { at: self.at.cross(v), by: [self.by[0].cross(v), self.by[1].cross(v)] }
    }
}

/// Σm, Σmp and Σmppᵀ (00, 01, 11) of masses m at points p of a plane.
#[derive(Clone, Copy)]
pub struct Moments<R> {
    mass: R,
    first: [R; 2],
    second: [R; 3],
}

impl<R: Real> Moments<R> {
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

    /// `scale` Σm, Σmx and Σmxxᵀ for the values x of `field`.
    #[inline(always)]
    pub fn of(&self, field: &Field<R>, scale: R) -> PointMasses<R> {
        let (mass, first) = (self.mass * scale, self.first.map(|m| m * scale));
        let [m00, m01, m11] = self.second.map(|m| m * scale);
        let [e0, e1] = field.by;
        let arm = field.change(first);
        let sum = field.at.scale_add(mass, arm);
        let mut second = Symmetric::zero();
        second.add_product(e0, field.change([m00, m01]));
        second.add_product(e1, field.change([m01, m11]));
        second.add_product(field.at, sum);
        second.add_product(arm, field.at);
        PointMasses { mass, first: sum, second }
    }
}

/// What sand does to the plates of a plane.
#[derive(Clone, Copy)]
pub struct PlaneForces<R> {
    force: Vec3<R>,
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

    /// Their wrench about the point that `places` count from.
    #[inline(always)]
    pub fn wrench(&self, places: &Field<R>) -> Wrench<R> {
        let [e0, e1] = places.by;
        let moment = places.at.cross(self.force) + e0.cross(self.first[0]) + e1.cross(self.first[1]);
        Wrench { moment, force: self.force }
    }
}
