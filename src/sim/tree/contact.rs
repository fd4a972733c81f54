//! Points of collision shapes that can touch hard ground.

use super::{Geometry, Tree};
use nalgebra::{Isometry3, Vector3};

type V = Vector3<f64>;

/// A point of contact in the frame of its body: the lowest point of a ball, or of a disc's rim.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactPoint {
    /// Centre [m].
    pub center: V,
    /// [m]
    pub radius: f64,
    /// Unit normal of a disc; none: a ball.
    pub axis: Option<V>,
    /// Coulomb friction of the shape.
    pub friction: f64,
}

/// Number of fixed points on each rim of a cylinder, besides the lowest point: our choice, so that the cylinder can
/// stand. More make a step slower.
const RIM: usize = 4;

/// [`outermost`] looks in directions toward a lattice of points on a cube; this is the number of lattice steps from the
/// middle of a face to its edge. Our choice: neighbouring directions then differ by at most 27°, so every corner of a
/// box is found in any orientation.
const STEPS: i32 = 2;
/// A point that is less than this [m] behind the outermost one counts as equally far out: our choice, above the
/// rounding of `f32` in meshes, and far below what hard ground yields.
const LEVEL: f64 = 1e-6;

/// Points of contact, one list for each body.
pub fn contact_points(tree: &Tree) -> Vec<Vec<ContactPoint>> {
    let of_body = |body: &super::TreeBody| {
        let shapes = body.shapes.iter();
        outermost(shapes.flat_map(|s| points(&s.geometry, &s.origin, s.friction)).collect())
    };
    tree.bodies.iter().map(of_body).collect()
}

impl ContactPoint {
    /// Distance that the point reaches along a unit vector from the body's origin [m].
    pub fn reach(&self, toward: &V) -> f64 {
        let part = self.axis.map_or(1.0, |axis| (1.0 - axis.dot(toward).powi(2)).max(0.0).sqrt());
        self.center.dot(toward) + self.radius * part
    }

    /// Does a fixed point lie on this disc's rim?
    fn carries(&self, point: &Self) -> bool {
        let off = point.center - self.center;
        let above = self.axis.map_or(0.0, |axis| off.dot(&axis));
        above.abs() < LEVEL && (off.norm() - self.radius).abs() < LEVEL
    }
}

/// The points of all shapes of a body that are outermost in some direction. Flat ground touches one of these first.
fn outermost(points: Vec<ContactPoint>) -> Vec<ContactPoint> {
    let mut kept = vec![false; points.len()];
    let side = || -STEPS..=STEPS;
    let lattice = side().flat_map(|x| side().flat_map(move |y| side().map(move |z| [x, y, z])));
    for at in lattice.filter(|at| at.iter().any(|x| x.abs() == STEPS)) {
        let toward = V::from(at.map(f64::from)).normalize();
        let most = points.iter().map(|p| p.reach(&toward)).fold(f64::NEG_INFINITY, f64::max);
        for (kept, point) in kept.iter_mut().zip(&points) {
            *kept |= point.reach(&toward) > most - LEVEL;
        }
    }
    // The fixed points of a rim are kept with it, because the cylinder stands on them.
    let rims: Vec<ContactPoint> =
        points.iter().zip(&kept).filter(|(p, kept)| **kept && p.axis.is_some()).map(|(p, _)| *p).collect();
    let on_rim = |p: &ContactPoint| p.axis.is_none() && rims.iter().any(|rim| rim.carries(p));
    points.into_iter().zip(kept).filter(|(p, kept)| *kept || on_rim(p)).map(|(p, _)| p).collect()
}

fn points(geometry: &Geometry, at: &Isometry3<f64>, friction: f64) -> Vec<ContactPoint> {
    let ball =
        |p: V, radius: f64| ContactPoint { center: at.transform_point(&p.into()).coords, radius, axis: None, friction };
    let ends = [-1.0, 1.0];
    match geometry {
        Geometry::Sphere { radius } => vec![ball(V::zeros(), *radius)],
        Geometry::Capsule { radius, half_length } => {
            ends.map(|end| ball(V::z() * (end * half_length), *radius)).to_vec()
        }
        Geometry::Box { half } => {
            let corner = |i: usize| V::new(ends[i & 1] * half.x, ends[i >> 1 & 1] * half.y, ends[i >> 2] * half.z);
            (0..8).map(|i| ball(corner(i), 0.0)).collect()
        }
        Geometry::Cylinder { radius, half_length } => {
            let mut all = Vec::new();
            for end in ends {
                let center = V::z() * (end * half_length);
                let disc = ContactPoint { radius: *radius, axis: Some(at.rotation * V::z()), ..ball(center, 0.0) };
                all.push(disc);
                let rim = |k: usize| {
                    let (sin, cos) = (std::f64::consts::TAU * k as f64 / RIM as f64).sin_cos();
                    ball(center + V::new(cos, sin, 0.0) * *radius, 0.0)
                };
                all.extend((0..RIM).map(rim));
            }
            all
        }
        Geometry::Mesh(triangles) => {
            // The outermost points in the directions of the corners, edges and faces of a cube.
            let mut chosen: Vec<V> = Vec::new();
            for i in 0..27 {
                let toward = V::new((i % 3) as f64, (i / 3 % 3) as f64, (i / 9) as f64) - V::repeat(1.0);
                let vertices = triangles.iter().flatten();
                let Some(p) = vertices.max_by(|a, b| a.dot(&toward).total_cmp(&b.dot(&toward))) else { continue };
                if toward != V::zeros() && !chosen.contains(p) {
                    chosen.push(*p);
                }
            }
            chosen.into_iter().map(|p| ball(p, 0.0)).collect()
        }
    }
}
