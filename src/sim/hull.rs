//! Convex hulls of points, computed by parry in `f32`.

use rapier3d::glamx::Vec3;
use rapier3d::parry::transformation::try_convex_hull;

type V = nalgebra::Vector3<f64>;

/// Corners [m] and outward triangles of the convex hull of `points`; none if they span no volume.
pub fn hull(points: &[[f64; 3]]) -> Option<(Vec<V>, Vec<[usize; 3]>)> {
    let points: Vec<_> = points.iter().map(|p| Vec3::from(p.map(|x| x as f32))).collect();
    let (corners, triangles) = try_convex_hull(&points).ok()?;
    let corners = corners.into_iter().map(|c| V::new(c.x.into(), c.y.into(), c.z.into()));
    Some((corners.collect(), triangles.iter().map(|t| t.map(|i| i as usize)).collect()))
}
