//! Collision shapes cut into the plates that push on sand.

use super::{Geometry, Tree, TreeShape};
use crate::error::{Error, Result, check_range};
use crate::number::Vec3;
use crate::sand::intruder::{Plate, cut, gathered};
use nalgebra::{Point3, Vector3};
use std::f64::consts::{PI, TAU};

/// Number of plates of a box, of a ball or a short cylinder, and of a mesh, unless the user gives a size. Our
/// choice: at random poses and velocities forces are within 2 % of those of fine plates (`tests/robots.rs`).
const COUNTS: [f64; 3] = [200.0, 300.0, 500.0];
/// Largest size of plates on long round shapes, as a share of the radius: our choice, as above.
const ROUND: [f64; 2] = [0.45, 0.5];
/// Largest ratio of length to width of a plate that is bent along its width only: our choice, as above. The engine
/// computes the load on such a plate and the place of that load (`super::sand`).
const LONG: f64 = 15.0;
/// Fewest plates around a round shape: our choice, half of those in `sandgait intrude`.
const COARSE: usize = 8;
/// Largest number of plates of a shape: our choice, a hundred times what can be simulated in real time.
const MOST_PLATES: f64 = 20_000.0;
/// Factor on the plates' size for the base: our choice, because the base seldom touches sand.
const BASE: f64 = 2.0;
/// Allowed sizes of plates [m].
const SIZES: std::ops::RangeInclusive<f64> = 1e-4..=1.0;

impl Geometry {
    /// Distance of the farthest point from the shape's origin [m].
    pub fn radius(&self) -> f64 {
        match self {
            Self::Sphere { radius } => *radius,
            Self::Capsule { radius, half_length } => radius + half_length,
            Self::Cylinder { radius, half_length } => radius.hypot(*half_length),
            Self::Box { half } => half.norm(),
            Self::Mesh(triangles) => triangles.iter().flatten().map(|p| p.norm()).fold(0.0, f64::max),
        }
    }

    /// Longest side of the box around it [m].
    fn longest(&self) -> f64 {
        match self {
            Self::Sphere { radius } => 2.0 * radius,
            Self::Capsule { radius, half_length } => 2.0 * (radius + half_length),
            Self::Cylinder { radius, half_length } => 2.0 * radius.max(*half_length),
            Self::Box { half } => 2.0 * half.amax(),
            Self::Mesh(triangles) => {
                let ends = |k: usize| {
                    let along = triangles.iter().flatten().map(|p| p[k]);
                    along.fold([f64::MAX, f64::MIN], |[a, b], x| [a.min(x), b.max(x)])
                };
                (0..3).map(|k| ends(k)[1] - ends(k)[0]).fold(0.0, f64::max)
            }
        }
    }

    /// Default size of plates [m]; round shapes are cut finer.
    fn default_size(&self) -> f64 {
        let of = |count: f64| (self.area() / count).sqrt();
        match self {
            Self::Box { .. } => of(COUNTS[0]),
            Self::Mesh(_) => of(COUNTS[2]),
            Self::Sphere { .. } => 1.3 * of(COUNTS[1]),
            Self::Capsule { radius, .. } => (1.2 * of(COUNTS[1])).min(ROUND[0] * radius),
            Self::Cylinder { radius, .. } => (1.2 * of(COUNTS[1])).min(ROUND[1] * radius),
        }
    }

    /// [m²]
    pub fn area(&self) -> f64 {
        match self {
            Self::Sphere { radius } => 4.0 * PI * radius * radius,
            Self::Capsule { radius, half_length } => 4.0 * PI * radius * (radius + half_length),
            Self::Cylinder { radius, half_length } => TAU * radius * (radius + 2.0 * half_length),
            Self::Box { half } => 8.0 * (half.x * half.y + half.y * half.z + half.z * half.x),
            Self::Mesh(triangles) => triangles.iter().map(|[a, b, c]| (b - a).cross(&(c - a)).norm() / 2.0).sum(),
        }
    }

    /// [m³]
    pub fn volume(&self) -> f64 {
        match self {
            Self::Sphere { radius } => 4.0 / 3.0 * PI * radius.powi(3),
            Self::Capsule { radius, half_length } => PI * radius * radius * (4.0 / 3.0 * radius + 2.0 * half_length),
            Self::Cylinder { radius, half_length } => TAU * radius * radius * half_length,
            Self::Box { half } => 8.0 * half.product(),
            Self::Mesh(triangles) => triangles.iter().map(|[a, b, c]| a.dot(&b.cross(c))).sum::<f64>() / 6.0,
        }
    }

    /// Outward plates about the shape's origin, with the shape's z along y.
    /// `wide`: the width of plates on the rim of a cylinder.
    fn cut(&self, size: f64, wide: f64) -> Option<Vec<Plate>> {
        Some(match self {
            Self::Sphere { radius } => cut::sphere(*radius, size, COARSE),
            Self::Capsule { radius, half_length } => cut::capsule(*radius, 2.0 * half_length, size, COARSE),
            Self::Cylinder { radius, half_length } => {
                cut::cylinder_across(*radius, 2.0 * half_length, size, wide, COARSE)
            }
            Self::Box { half } => cut::cuboid(2.0 * half.x, 2.0 * half.y, 2.0 * half.z, size, COARSE),
            Self::Mesh(triangles) => {
                let point = |p: Vector3<f64>| Vec3::new(p.x, p.y, p.z);
                let triangles: Vec<_> = triangles.iter().map(|t| t.map(point)).collect();
                return gathered(&triangles, size);
            }
        })
    }

    /// Does the shape contain a point, given in the shape's frame? For a mesh this is computed from `plates`.
    fn holds(&self, p: Vector3<f64>, plates: &[Plate]) -> bool {
        match self {
            Self::Sphere { radius } => p.norm() < *radius,
            Self::Capsule { radius, half_length } => {
                let beyond = p.z - p.z.clamp(-half_length, *half_length);
                (p.x * p.x + p.y * p.y + beyond * beyond).sqrt() < *radius
            }
            Self::Cylinder { radius, half_length } => p.z.abs() < *half_length && p.x.hypot(p.y) < *radius,
            Self::Box { half } => (0..3).all(|k| p[k].abs() < half[k]),
            Self::Mesh(_) => {
                // The solid angle of the surface seen from the point: 4π from inside.
                let p = Vec3::new(p.x, p.y, p.z);
                let seen = plates.iter().map(|plate| {
                    let to = plate.center - p;
                    let r = to.norm_squared().sqrt().max(1e-9);
                    plate.area * plate.normal.dot(to) / (r * r * r)
                });
                seen.sum::<f64>() > TAU
            }
        }
    }
}

impl TreeShape {
    /// Height of the lowest point above its body's origin [m] while the body is level.
    pub fn lowest(&self) -> f64 {
        let up = self.origin.rotation.inverse() * Vector3::z();
        let below = match &self.geometry {
            Geometry::Sphere { radius } => *radius,
            Geometry::Capsule { radius, half_length } => radius + half_length * up.z.abs(),
            Geometry::Cylinder { radius, half_length } => half_length * up.z.abs() + radius * up.x.hypot(up.y),
            Geometry::Box { half } => half.dot(&up.abs()),
            Geometry::Mesh(triangles) => triangles.iter().flatten().map(|p| -p.dot(&up)).fold(f64::MIN, f64::max),
        };
        self.origin.translation.z - below
    }
}

/// Plates of one shape in the shape's frame, of about `size` [m]; None: the size at which forces are within 2 %.
pub fn of_shape(shape: &TreeShape, size: Option<f64>) -> Result<Vec<Plate>> {
    one_shape(shape, size, 1.0)
}

/// `larger`: with larger plates, unless a size is given.
fn one_shape(shape: &TreeShape, given: Option<f64>, larger: f64) -> Result<Vec<Plate>> {
    let size = match given {
        Some(size) => check_range("plate-size", size, SIZES)?.min(shape.geometry.longest()),
        None => larger * shape.geometry.default_size(),
    };
    let least = (shape.geometry.area() / MOST_PLATES).sqrt();
    let too_many = || {
        let reason = format!("more than {MOST_PLATES} plates of {size} m; give a larger plate size");
        Error::invalid(format!("shape {:?}", shape.name), reason)
    };
    if size < least {
        return Err(too_many());
    }
    // If the user gives a size, the plates are those of `sandgait intrude`. Others are joined to long ones later.
    let wide = if given.is_some() { 4.0 * size } else { size };
    let plates = shape.geometry.cut(size, wide).ok_or_else(too_many)?;
    // The functions for plates have along y the axis that a shape has along z.
    let turned = |v: Vec3<f64>| match shape.geometry {
        Geometry::Capsule { .. } | Geometry::Cylinder { .. } => Vec3::new(v.x, -v.z, v.y),
        _ => v,
    };
    let one = |p: Plate| Plate { center: turned(p.center), normal: turned(p.normal), half: p.half.map(turned), ..p };
    Ok(plates.into_iter().map(one).collect())
}

/// Joins neighbouring plates along the axis of a round shape, up to [`LONG`] times their width.
fn joined(plates: &[Plate]) -> Vec<Plate> {
    let mut all = Vec::new();
    for row in plates.chunk_by(|one, next| straight_side(one).is_some_and(|k| continues(one, next, k))) {
        let Some(k) = straight_side(&row[0]) else {
            all.extend_from_slice(row);
            continue;
        };
        let size = |k: usize| row[0].half[k].norm_squared().sqrt();
        let most = (LONG * size(1 - k) / size(k)).max(1.0);
        let count = (row.len() as f64 / most).ceil() as usize;
        let ends = |i: usize| i * row.len() / count;
        all.extend((0..count).map(|i| one_of(&row[ends(i)..ends(i + 1)], k)));
    }
    all
}

/// The side along which a plate is flat while it is bent along the other.
fn straight_side(plate: &Plate) -> Option<usize> {
    (0..2).find(|k| plate.bend[*k] == 0.0 && plate.bend[1 - k] != 0.0)
}

/// Does `next` lie beside `one` in the direction of its side `k`, with the same size and normal?
fn continues(one: &Plate, next: &Plate, k: usize) -> bool {
    let near = |a: Vec3<f64>, b: Vec3<f64>| {
        let (apart, size) = ((a - b).norm_squared(), a.norm_squared());
        apart < 1e-12 * size
    };
    let sides = one.half.iter().zip(&next.half).all(|(a, b)| near(*a, *b));
    one.bend == next.bend && sides && near(one.normal, next.normal) && near(one.half[k] * 2.0, next.center - one.center)
}

/// The plate that the plates of a row make together.
fn one_of(row: &[Plate], k: usize) -> Plate {
    let (first, last) = (row[0], row[row.len() - 1]);
    let mut half = first.half;
    half[k] = half[k] * row.len() as f64;
    let center = (first.center + last.center) * 0.5;
    Plate { center, half, area: first.area * row.len() as f64, ..first }
}

/// Plates of the shapes that touch sand, by index of body and shape, body by body. The base seldom touches sand, so
/// its plates are larger unless a size is given.
pub fn of_touching(tree: &Tree, touching: &[(usize, usize)], size: Option<f64>) -> Result<Vec<Vec<Plate>>> {
    let of_body = |b: usize| {
        let own: Vec<_> = touching.iter().filter(|t| t.0 == b).map(|t| &tree.bodies[b].shapes[t.1]).collect();
        together(&own, size, if b == 0 { BASE } else { 1.0 })
    };
    (0..tree.bodies.len()).map(of_body).collect()
}

/// Plates of shapes that are fixed to one body, in the body's frame, without plates inside another shape.
pub fn of_shapes(shapes: &[&TreeShape], size: Option<f64>) -> Result<Vec<Plate>> {
    together(shapes, size, 1.0)
}

/// `larger`: with larger plates, unless a size is given.
fn together(shapes: &[&TreeShape], size: Option<f64>, larger: f64) -> Result<Vec<Plate>> {
    let cut: Vec<Vec<Plate>> = shapes.iter().map(|s| one_shape(s, size, larger)).collect::<Result<_>>()?;
    let mut all = Vec::new();
    for (i, plates) in cut.iter().enumerate() {
        for plate in plates {
            let placed = moved(plate, shapes[i]);
            let at: Vector3<f64> = placed.center.lane(0).into();
            let hidden = shapes.iter().zip(&cut).enumerate().any(|(k, (other, of_other))| {
                k != i && other.geometry.holds(other.origin.inverse_transform_point(&at.into()).coords, of_other)
            });
            if !hidden {
                all.push(placed);
            }
        }
    }
    Ok(if size.is_some() { all } else { joined(&all) })
}

/// The plate, moved from the shape's frame to its body's.
fn moved(plate: &Plate, shape: &TreeShape) -> Plate {
    let point =
        |v: Vec3<f64>| Vec3::splat(shape.origin.transform_point(&Point3::from(Vector3::from(v.lane(0)))).coords.into());
    let vector = |v: Vec3<f64>| Vec3::splat((shape.origin.rotation * Vector3::from(v.lane(0))).into());
    Plate { center: point(plate.center), normal: vector(plate.normal), half: plate.half.map(vector), ..*plate }
}
