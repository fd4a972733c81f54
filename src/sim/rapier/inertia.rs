//! Point masses added to rigid bodies, as mass properties that rapier can hold.

use super::units::{quat, scaled, scaled_twice};
use crate::frame::{M, V};
use rapier3d::prelude::MassProperties;

/// The moments of point masses, or of a whole body, in the frame of the body that carries them.
#[derive(Clone, Copy, Debug)]
pub struct Masses {
    /// [kg]
    pub mass: f64,
    /// Σ m p [kg·m]
    first: V,
    /// Σ m p pᵀ [kg·m²]
    second: M,
}

impl Masses {
    pub fn none() -> Self {
        Self { mass: 0.0, first: V::zeros(), second: M::zeros() }
    }

    /// A rigid body by its mass [kg], centre [m] and inertia about that centre [kg·m²].
    pub fn body(mass: f64, center: V, inertia: M) -> Self {
        let second = M::identity() * (inertia.trace() / 2.0) - inertia;
        Self { mass, first: center * mass, second: second + center * center.transpose() * mass }
    }

    /// Adds `mass` [kg] at `place` [m].
    pub fn add(&mut self, mass: f64, place: V) {
        self.mass += mass;
        self.first += place * mass;
        self.second += place * place.transpose() * mass;
    }

    /// The sum of both.
    pub fn with(mut self, other: &Self) -> Self {
        self.mass += other.mass;
        self.first += other.first;
        self.second += other.second;
        self
    }

    /// Centre of mass [m]; the origin if there is no mass.
    pub fn center(&self) -> V {
        if self.mass > 0.0 { self.first / self.mass } else { V::zeros() }
    }

    fn central_second(&self) -> M {
        let c = self.center();
        self.second - c * c.transpose() * self.mass
    }

    /// Inertia about the centre of mass [kg·m²].
    pub fn inertia(&self) -> M {
        let second = self.central_second();
        M::identity() * second.trace() - second
    }

    /// The mass, its centre and inertia in rapier's type.
    pub fn properties(&self) -> MassProperties {
        mass_properties(self.mass, self.center(), &self.inertia())
    }

    /// The inertia if the masses resist motion along the unit vector `along` only.
    pub fn inertia_along(&self, along: V) -> M {
        let cross = along.cross_matrix();
        cross * self.central_second() * cross.transpose()
    }
}

/// Smallest principal inertia as a share of the largest: our choice, some thousand times the rounding of `f32`, in
/// which rapier inverts the inertia. Point masses in a line have no inertia about it.
const RELATIVE_FLOOR: f64 = 1e-4;
/// Smallest principal inertia in kg·m²: our choice, because rapier multiplies three inverse inertias, and the product
/// must stay finite in `f32`.
const ABSOLUTE_FLOOR: f64 = 1e-12;

/// Mass properties, in rapier's units, from an inertia matrix [kg·m²] about `center` [m]; no mass gives rapier's "no mass
/// properties".
pub fn mass_properties(mass: f64, center: V, inertia: &M) -> MassProperties {
    if mass <= 0.0 {
        return MassProperties::default();
    }
    let (moments, axes) = principal(inertia);
    let floor = (moments.max() * RELATIVE_FLOOR).max(ABSOLUTE_FLOOR);
    let frame = nalgebra::UnitQuaternion::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(axes));
    MassProperties::with_principal_inertia_frame(
        scaled(center),
        mass as f32,
        scaled_twice(moments.map(|i| i.max(floor))),
        quat(&frame),
    )
}

/// Principal moments and axes (columns, right-handed) of a symmetric matrix: cyclic Jacobi rotations (Golub & Van
/// Loan, *Matrix Computations*, algorithm 8.5.2). Six sweeps leave nothing above rounding (1e-15) in three dimensions.
pub fn principal(matrix: &M) -> (V, M) {
    let (mut a, mut axes) = (*matrix, M::identity());
    for (p, q) in [(0, 2), (0, 1), (1, 2)].into_iter().cycle().take(18) {
        if a[(p, q)].abs() <= 1e-15 * (a[(p, p)].abs() + a[(q, q)].abs()) {
            continue;
        }
        let ratio = (a[(q, q)] - a[(p, p)]) / (2.0 * a[(p, q)]);
        let tan = ratio.signum() / (ratio.abs() + ratio.hypot(1.0));
        let cos = 1.0 / tan.hypot(1.0);
        let mut turn = M::identity();
        turn[(p, p)] = cos;
        turn[(q, q)] = cos;
        turn[(p, q)] = tan * cos;
        turn[(q, p)] = -tan * cos;
        a = turn.transpose() * a * turn;
        axes *= turn;
    }
    (a.diagonal(), axes)
}
