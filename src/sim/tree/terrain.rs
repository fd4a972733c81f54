//! The ground's surface, and its tangent plane near a point.

use crate::number::{Real, Vec3};

/// The ground's surface.
pub trait Surface<R> {
    /// Is the ground level everywhere?
    fn is_flat(&self) -> bool;

    /// The surface below or above a point of the world.
    fn under(&self, point: Vec3<R>) -> Local<R>;
}

/// The tangent plane of the surface.
#[derive(Clone, Copy)]
pub struct Local<R> {
    /// A point of the plane [m], in the world.
    pub point: Vec3<R>,
    /// Upward unit vector.
    pub normal: Vec3<R>,
}

impl<R: Real> Local<R> {
    /// Depth of a point of the world below the plane [m].
    #[inline(always)]
    pub fn depth(&self, p: Vec3<R>) -> R {
        self.normal.dot(self.point - p)
    }

    /// The normal of a plane whose depth below this one has the derivatives `tilt` along x and y.
    #[inline(always)]
    pub fn tilted(&self, tilt: [R; 2]) -> Vec3<R> {
        let n = self.normal + Vec3::new(tilt[0], tilt[1], R::zero());
        n * (R::one() / n.norm_squared().sqrt())
    }
}

/// Level ground.
#[derive(Clone, Copy)]
pub struct Flat;

impl<R: Real> Surface<R> for Flat {
    #[inline(always)]
    fn is_flat(&self) -> bool {
        true
    }

    #[inline(always)]
    fn under(&self, _point: Vec3<R>) -> Local<R> {
        Local { point: Vec3::zero(), normal: Vec3::splat([0.0, 0.0, 1.0]) }
    }
}
