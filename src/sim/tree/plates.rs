//! Collision shapes cut into the plates that push on sand.

use super::{Geometry, Tree, TreeShape, cluster};
use crate::error::{Error, Result, check_range};
use crate::number::Vec3;
use crate::sand::intruder::{IntruderPlate, cut, gathered};
use nalgebra::{Point3, Vector3};
use std::f64::consts::{PI, TAU};

/// Number of plates of a body that touches sand, unless the user gives a size. Our choice: at random poses and
/// velocities forces on feet and lower legs differ by at most 2 % from forces on fine plates (rms; `tests/robots.rs`,
/// `make study-plates`).
const BODY: f64 = 128.0;
/// Number of plates of the base: our choice, because the base seldom touches sand.
const BASE: f64 = 64.0;
/// Largest number of plates of a robot, unless the user gives a size: our choice, enough for six limbs. Sand on 576
/// plates takes four times as long as the motion of twelve joints.
const ROBOT: f64 = 800.0;
/// Number of plates that a body is cut into before they are gathered: our choice. With 3,000 the error on ANYmal's shanks
/// was half as large again.
const FINE: f64 = 8000.0;
/// Argument `flat` of [`cluster::few`] [rad]: our choice, because among 0.03, 0.1 and 0.2 it gave the least error on
/// six robots.
const FLAT: f64 = 0.1;
/// The argument `flat` of [`cluster::few`] for [`of_body`], whose plates are smaller: our choice, because among 0.02,
/// 0.04 and 0.1 it gave the least error on random shapes.
const FLAT_FINE: f64 = 0.04;
/// Number of plates that [`of_body`] gives a flat shape and a shape that is curved everywhere; for other shapes it
/// interpolates linearly in the curved part of the surface. Our choice, because rms errors of forces on random shapes
/// are then near 0.5 %, and one call for gymnasium's Ant takes less than 15 µs (`make study-plates`,
/// `benches/sand.py`).
const FLAT_SHAPE: f64 = 256.0;
const CURVED_SHAPE: f64 = 512.0;
/// Largest number of plates of a body in [`of_body`], to bound the time of a call: our choice, enough for two curved shapes.
const MOST_OF_BODY: f64 = 1024.0;
/// Fewest plates around a round shape: our choice, half of those in `sandgait intrude`.
const COARSE: usize = 8;
/// Largest number of plates of a shape: our choice, a hundred times what can be simulated in real time.
pub const MOST_PLATES: f64 = 20_000.0;
/// Allowed sizes of plates [m]: our choice, from below a grain of sand to beyond a robot's foot. Others have wrong
/// units.
pub const PLATE_SIZES: std::ops::RangeInclusive<f64> = 1e-4..=1.0;

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
    fn cut(&self, size: f64) -> Option<Vec<IntruderPlate>> {
        Some(match self {
            Self::Sphere { radius } => cut::sphere(*radius, size, COARSE),
            Self::Capsule { radius, half_length } => cut::capsule(*radius, 2.0 * half_length, size, COARSE),
            Self::Cylinder { radius, half_length } => cut::cylinder(*radius, 2.0 * half_length, size, COARSE),
            Self::Box { half } => cut::cuboid(2.0 * half.x, 2.0 * half.y, 2.0 * half.z, size, COARSE),
            Self::Mesh(triangles) => {
                let point = |p: Vector3<f64>| Vec3::new(p.x, p.y, p.z);
                let triangles: Vec<_> = triangles.iter().map(|t| t.map(point)).collect();
                return gathered(&triangles, size);
            }
        })
    }

    /// Does the shape contain a point, given in the shape's frame? For a mesh this is computed from `plates`.
    fn holds(&self, p: Vector3<f64>, plates: &[IntruderPlate]) -> bool {
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

/// Plates of one shape in the shape's frame, of about `size` [m].
fn of_shape(shape: &TreeShape, size: f64) -> Result<Vec<IntruderPlate>> {
    let count = shape.geometry.area() / (size * size);
    let too_many = |found: f64| {
        let reason = format!("{found:.0} plates of {size} m on shape {:?} are more than {MOST_PLATES}", shape.name);
        Error::invalid("plate-size", reason)
    };
    if count > MOST_PLATES {
        return Err(too_many(count));
    }
    let plates = shape.geometry.cut(size.min(shape.geometry.longest())).ok_or_else(|| too_many(count))?;
    // The functions for plates have along y the axis that a shape has along z.
    let turned = |v: Vec3<f64>| match shape.geometry {
        Geometry::Capsule { .. } | Geometry::Cylinder { .. } => Vec3::new(v.x, -v.z, v.y),
        _ => v,
    };
    let one = |p: IntruderPlate| IntruderPlate {
        center: turned(p.center),
        normal: turned(p.normal),
        half: p.half.map(turned),
        ..p
    };
    Ok(plates.into_iter().map(one).collect())
}

/// Plates of the shapes that touch sand, by index of body and shape, body by body. With `size` [m] each shape is cut
/// into plates of this size; otherwise a body has at most 128 plates, the base 64, and the robot 800.
pub fn of_touching(tree: &Tree, touching: &[(usize, usize)], size: Option<f64>) -> Result<Vec<Vec<IntruderPlate>>> {
    let shapes: Vec<Vec<&TreeShape>> = (0..tree.bodies.len())
        .map(|b| touching.iter().filter(|t| t.0 == b).map(|t| &tree.bodies[b].shapes[t.1]).collect())
        .collect();
    let areas: Vec<f64> = shapes.iter().map(|own| area(own)).collect();
    let counts = counts(&areas);
    shapes.iter().zip(counts).map(|(own, count)| together(own, size, count)).collect()
}

/// Plates of shapes that are fixed to one body, in the body's frame, without plates inside another shape. `size` as in
/// [`of_touching`].
pub fn of_shapes(shapes: &[&TreeShape], size: Option<f64>) -> Result<Vec<IntruderPlate>> {
    together(shapes, size, BODY)
}

fn area(shapes: &[&TreeShape]) -> f64 {
    shapes.iter().map(|s| s.geometry.area()).sum()
}

/// Number of plates of each body with these areas [m²], the base first: [`BODY`], and for the base [`BASE`]. If these
/// numbers together are more than [`ROBOT`], they are reduced to numbers in proportion to the square roots of the
/// areas.
fn counts(areas: &[f64]) -> Vec<f64> {
    let most = |b: usize| if b == 0 { BASE } else { BODY };
    let at = |scale: f64| -> Vec<f64> {
        let count = |(b, area): (usize, &f64)| {
            if *area > 0.0 { (scale * most(b) * area.sqrt()).clamp(1.0, most(b)) } else { 0.0 }
        };
        areas.iter().enumerate().map(count).collect()
    };
    let total = |scale: f64| at(scale).iter().sum::<f64>();
    let least = areas.iter().copied().filter(|a| *a > 0.0).fold(f64::INFINITY, f64::min);
    if !least.is_finite() {
        return vec![0.0; areas.len()];
    }
    let (mut low, mut high) = (0.0, 1.0 / least.sqrt());
    if total(high) <= ROBOT {
        return at(high);
    }
    for _ in 0..60 {
        let middle = (low + high) / 2.0;
        if total(middle) > ROBOT { high = middle } else { low = middle }
    }
    at(low)
}

/// Plates of shapes that are fixed to one body, in the body's frame: finer than those of [`of_shapes`], for accurate
/// forces in every single pose.
pub fn of_body(shapes: &[&TreeShape]) -> Result<Vec<IntruderPlate>> {
    if shapes.is_empty() {
        return Ok(Vec::new());
    }
    let small: Vec<f64> = shapes.iter().map(|s| (s.geometry.area() / FINE).sqrt()).collect();
    let visible = visible(shapes, &small)?;
    let count = |(plates, shape): (&Vec<IntruderPlate>, &&TreeShape)| {
        let sum = |plates: &mut dyn Iterator<Item = &IntruderPlate>| plates.map(|p| p.area).sum::<f64>();
        let seen = sum(&mut plates.iter());
        let few = cluster::few(plates, FLAT_SHAPE as usize, FLAT);
        let curved = sum(&mut few.iter().filter(|p| p.bend != [0.0; 2])) / seen.max(f64::MIN_POSITIVE);
        seen / shape.geometry.area() * (FLAT_SHAPE + (CURVED_SHAPE - FLAT_SHAPE) * curved)
    };
    let counts: Vec<f64> = visible.iter().zip(shapes).map(count).collect();
    let scale = (MOST_OF_BODY / counts.iter().sum::<f64>()).min(1.0);
    let few = |(plates, count): (&Vec<IntruderPlate>, f64)| {
        cluster::few(plates, ((scale * count).round() as usize).max(1), FLAT_FINE)
    };
    Ok(visible.iter().zip(counts).flat_map(few).collect())
}

/// Plates of shapes that are fixed to one body: of this size, or, without one, about `count`.
fn together(shapes: &[&TreeShape], size: Option<f64>, count: f64) -> Result<Vec<IntruderPlate>> {
    if shapes.is_empty() {
        return Ok(Vec::new());
    }
    let small = match size {
        Some(size) => check_range("plate-size", size, PLATE_SIZES)?,
        None => (area(shapes) / FINE).sqrt(),
    };
    let all = visible(shapes, &vec![small; shapes.len()])?.concat();
    Ok(if size.is_some() { all } else { cluster::few(&all, (count as usize).max(1), FLAT) })
}

/// The plates of each shape, of its size [m], in the body's frame, without plates inside another shape.
fn visible(shapes: &[&TreeShape], sizes: &[f64]) -> Result<Vec<Vec<IntruderPlate>>> {
    let cut: Vec<Vec<IntruderPlate>> =
        shapes.iter().zip(sizes).map(|(shape, size)| of_shape(shape, *size)).collect::<Result<_>>()?;
    let seen = |i: usize, plate: &IntruderPlate| {
        let placed = moved(plate, shapes[i]);
        let at: Vector3<f64> = placed.center.lane(0).into();
        let hidden = shapes.iter().zip(&cut).enumerate().any(|(k, (other, of_other))| {
            k != i && other.geometry.holds(other.origin.inverse_transform_point(&at.into()).coords, of_other)
        });
        (!hidden).then_some(placed)
    };
    Ok(cut.iter().enumerate().map(|(i, plates)| plates.iter().filter_map(|p| seen(i, p)).collect()).collect())
}

/// The plate, moved from the shape's frame to its body's.
fn moved(plate: &IntruderPlate, shape: &TreeShape) -> IntruderPlate {
    let point =
        |v: Vec3<f64>| Vec3::splat(shape.origin.transform_point(&Point3::from(Vector3::from(v.lane(0)))).coords.into());
    let vector = |v: Vec3<f64>| Vec3::splat((shape.origin.rotation * Vector3::from(v.lane(0))).into());
    IntruderPlate { center: point(plate.center), normal: vector(plate.normal), half: plate.half.map(vector), ..*plate }
}
