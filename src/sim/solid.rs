//! Geometry of convex bodies: mass, surface facets for the sand, depth inside and height on top.

use crate::error::{Error, Result, check_range};
use std::f64::consts::{PI, TAU};

type V = nalgebra::Vector3<f64>;
type M = nalgebra::Matrix3<f64>;

/// A small flat piece that pushes on sand, in the frame of the body that carries it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plate {
    /// [m]
    pub center: V,
    /// Unit normal; outward for the belly, in either direction for thin strips.
    pub normal: V,
    /// [m²]
    pub area: f64,
    /// Width across the plane of motion [m].
    pub width: f64,
}

/// Rings and sectors of a sphere's facets. Our choice: a facet spans 22.5° by 30°. With fewer facets the force grows
/// unevenly while a rock sinks, and more make a step slower.
const RINGS: usize = 8;
const SECTORS: usize = 12;
/// A side of a box has `GRID`² facets, a triangle of a hull 4. Our choice, because a box that tilts then dips facet by
/// facet and not a side at once; more make a step slower.
const GRID: usize = 4;

/// The two triangles of each side of a box, as numbers of corners. Bit k of a corner's number is 1 if the corner lies on the
/// positive side of axis k.
const CUBE_FACES: [[u8; 3]; 12] = [
    [0, 4, 6],
    [0, 6, 2],
    [1, 3, 7],
    [1, 7, 5],
    [0, 1, 5],
    [0, 5, 4],
    [2, 6, 7],
    [2, 7, 3],
    [0, 2, 3],
    [0, 3, 1],
    [4, 5, 7],
    [4, 7, 6],
];

/// A convex body; own frame, origin at the centre of mass.
#[derive(Clone, Debug, PartialEq)]
pub struct Solid {
    /// [m³]
    pub volume: f64,
    /// About the centre of mass, at density 1 [m⁵].
    pub inertia: M,
    /// The surface, with outward normals.
    pub facets: Vec<Plate>,
    /// Corners [m]; none on a sphere.
    pub corners: Vec<V>,
    /// Triangles of corners, counter-clockwise seen from outside; none on a sphere.
    pub faces: Vec<[usize; 3]>,
    kind: SolidKind,
}

#[derive(Clone, Debug, PartialEq)]
enum SolidKind {
    Sphere {
        radius: f64,
    },
    /// Outward unit normal n and distance d of each side: inside is n·p ≤ d.
    Sides(Vec<(V, f64)>),
}

/// Pose of a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidPose {
    /// Own axes to world axes.
    pub rotation: M,
    /// [m]
    pub position: V,
}

impl RigidPose {
    pub fn new(position: [f64; 3], orientation: [f64; 4]) -> Self {
        let [w, x, y, z] = orientation;
        let turn = nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
        Self { rotation: turn.to_rotation_matrix().into_inner(), position: V::from(position) }
    }

    fn inward(&self, point: V) -> V {
        self.rotation.transpose() * (point - self.position)
    }
}

impl Solid {
    /// Memory of the body's lists [bytes].
    pub fn list_bytes(&self) -> usize {
        let sides = if let SolidKind::Sides(sides) = &self.kind { size_of_val(&sides[..]) } else { 0 };
        size_of_val(&self.facets[..]) + size_of_val(&self.corners[..]) + size_of_val(&self.faces[..]) + sides
    }

    pub fn sphere(radius: f64) -> Self {
        let volume = 4.0 / 3.0 * PI * radius.powi(3);
        let mut facets = Vec::with_capacity(RINGS * SECTORS);
        for ring in 0..RINGS {
            let [top, middle, bottom] = [0.0, 0.5, 1.0].map(|part| PI * (ring as f64 + part) / RINGS as f64);
            for sector in 0..SECTORS {
                let (sin, cos) = (TAU * (sector as f64 + 0.5) / SECTORS as f64).sin_cos();
                let normal = V::new(middle.sin() * cos, middle.sin() * sin, middle.cos());
                let area = TAU * radius * radius * (top.cos() - bottom.cos()) / SECTORS as f64;
                facets.push(Plate { center: normal * radius, normal, area, width: area.sqrt() });
            }
        }
        let inertia = M::identity() * (0.4 * volume * radius * radius);
        Self { volume, inertia, facets, corners: Vec::new(), faces: Vec::new(), kind: SolidKind::Sphere { radius } }
    }

    pub fn cuboid(size: [f64; 3]) -> Self {
        let size = V::from(size);
        let half = size / 2.0;
        let volume = size.product();
        let (mut facets, mut sides) = (Vec::new(), Vec::new());
        for axis in 0..3 {
            let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
            for sign in [-1.0, 1.0] {
                let normal = V::ith(axis, sign);
                sides.push((normal, half[axis]));
                for k in 0..GRID * GRID {
                    let at = |i: usize, axis: usize| ((i as f64 + 0.5) / GRID as f64 - 0.5) * size[axis];
                    let center = normal * half[axis] + V::ith(u, at(k / GRID, u)) + V::ith(v, at(k % GRID, v));
                    facets.push(Plate {
                        center,
                        normal,
                        area: size[u] * size[v] / (GRID * GRID) as f64,
                        width: size[v] / GRID as f64,
                    });
                }
            }
        }
        let squares = size.component_mul(&size);
        let inertia = M::from_diagonal(&(V::repeat(squares.sum()) - squares)) * (volume / 12.0);
        let sign = |bit: usize, i: usize| if i >> bit & 1 == 0 { -1.0 } else { 1.0 };
        let corners = (0..8).map(|i| half.component_mul(&V::new(sign(0, i), sign(1, i), sign(2, i))));
        let faces = CUBE_FACES.map(|f| f.map(usize::from)).to_vec();
        Self { volume, inertia, facets, corners: corners.collect(), faces, kind: SolidKind::Sides(sides) }
    }

    /// The convex hull of `points` [m].
    pub fn hull(points: &[[f64; 3]]) -> Result<Self> {
        let flat = || Error::invalid("obstacle.points", "they span no volume");
        let middle = points.iter().map(|p| V::from(*p)).sum::<V>() / points.len() as f64;
        let span =
            M::from_fn(|i, j| points.iter().map(|p| (V::from(*p) - middle)[i] * (V::from(*p) - middle)[j]).sum());
        // parry makes the hull in `f32` and needs all three dimensions: a hull thinner than a thousandth of its
        // size is refused.
        let spread = span.symmetric_eigenvalues();
        if spread.min() <= 1e-6 * spread.max() {
            return Err(flat());
        }
        let (corners, triangles) = super::hull::hull(points).ok_or_else(flat)?;
        let faces = triangles.clone();
        let triangles = triangles.iter().map(|t| t.map(|i| corners[i]));
        // Sums over tetrahedra from the points' mean, which is inside: ∫dV, ∫p dV, ∫p pᵀ dV.
        let (mut volume, mut first, mut second) = (0.0, V::zeros(), M::zeros());
        for [a, b, c] in triangles.clone() {
            let [a, b, c] = [a - middle, b - middle, c - middle];
            let part = a.dot(&b.cross(&c)) / 6.0;
            let sum = a + b + c;
            volume += part;
            first += sum * (part / 4.0);
            second +=
                (a * a.transpose() + b * b.transpose() + c * c.transpose() + sum * sum.transpose()) * (part / 20.0);
        }
        check_range("obstacle.points (volume)", volume, 1e-9..=1e4)?;
        let offset = first / volume;
        second -= offset * offset.transpose() * volume;
        let center = middle + offset;
        let (mut facets, mut sides) = (Vec::new(), Vec::new());
        for t in triangles {
            let [a, b, c] = t.map(|p| p - center);
            let across = (b - a).cross(&(c - a));
            let normal = across.normalize();
            sides.push((normal, normal.dot(&a)));
            let [ab, bc, ca] = [(a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0];
            for part in [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]] {
                facets.push(Plate {
                    center: part.iter().sum::<V>() / 3.0,
                    normal,
                    area: across.norm() / 8.0,
                    width: (across.norm() / 8.0).sqrt(),
                });
            }
        }
        Ok(Self {
            volume,
            inertia: M::identity() * second.trace() - second,
            facets,
            corners: corners.iter().map(|p| p - center).collect(),
            faces,
            kind: SolidKind::Sides(sides),
        })
    }

    /// Depth [m] of a point of the world inside the body at `pose`; negative outside.
    pub fn depth(&self, pose: &RigidPose, point: V) -> f64 {
        let p = pose.inward(point);
        match &self.kind {
            SolidKind::Sphere { radius } => radius - p.norm(),
            SolidKind::Sides(sides) => sides.iter().map(|(n, d)| d - n.dot(&p)).fold(f64::INFINITY, f64::min),
        }
    }

    /// Depth [m] of the centre of mass under the surface.
    pub fn depth_of_centre(&self) -> f64 {
        match &self.kind {
            SolidKind::Sphere { radius } => *radius,
            SolidKind::Sides(sides) => sides.iter().map(|(_, d)| *d).fold(f64::INFINITY, f64::min),
        }
    }

    /// Height [m] of the body's top above the point (x, y) of the surface; none beside it.
    pub fn top(&self, pose: &RigidPose, x: f64, y: f64) -> Option<f64> {
        let start = pose.inward(V::new(x, y, 0.0));
        let up = pose.rotation.transpose() * V::z();
        match &self.kind {
            SolidKind::Sphere { radius } => {
                let along = start.dot(&up);
                let under = radius * radius - start.norm_squared() + along * along;
                (under >= 0.0).then(|| under.sqrt() - along)
            }
            SolidKind::Sides(sides) => {
                let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
                for (n, d) in sides {
                    let (rate, gap) = (n.dot(&up), d - n.dot(&start));
                    if rate.abs() > 1e-12 {
                        if rate > 0.0 { high = high.min(gap / rate) } else { low = low.max(gap / rate) }
                    } else if gap < 0.0 {
                        return None;
                    }
                }
                (low <= high).then_some(high)
            }
        }
    }

    /// Radius of the smallest sphere about the centre of mass that contains the body [m].
    pub fn reach(&self) -> f64 {
        match self.kind {
            SolidKind::Sphere { radius } => radius,
            SolidKind::Sides(_) => self.corners.iter().map(V::norm).fold(0.0, f64::max),
        }
    }

    /// Vertical distance of the lowest point under the centre of mass [m], for a body with the orientation of `pose`.
    pub fn below(&self, pose: &RigidPose) -> f64 {
        match self.kind {
            SolidKind::Sphere { radius } => radius,
            SolidKind::Sides(_) => self.corners.iter().map(|c| -(pose.rotation * c).z).fold(0.0, f64::max),
        }
    }
}
