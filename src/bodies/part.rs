//! Parts of bodies by name: `sphere:radius=0.02`, `mesh:foot.stl`, …, and their plates.

use crate::error::{Error, Result};
use crate::number::Vec3;
use crate::robots::{Closed, closed, ellipsoid};
use crate::sand::intruder::{IntruderPlate, read_file, sizes_of};
use crate::sim::tree::{Geometry, MOST_PLATES, TreeShape};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use std::path::Path;
use std::sync::Arc;

/// The shapes that a body can consist of, each with its name and lengths.
const KINDS: [&str; 9] = [
    "sphere:radius=M",
    "box:length=M,width=M,height=M",
    "capsule:radius=M,height=M",
    "cylinder:radius=M,height=M",
    "cylinder:radius=M,width=M",
    "ellipsoid:length=M,width=M,height=M",
    "plate:length=M,width=M",
    "face:length=M,width=M",
    "mesh:FILE.stl or .obj",
];
/// Friction is not used: sand's force does not depend on it.
const FRICTION: f64 = 1.0;
/// Longest side of a mesh [m]: the bounds of the lengths of named shapes, which catch wrong units.
const LENGTHS: std::ops::RangeInclusive<f64> = 1e-4..=10.0;
/// Largest distance of a shape from its body's origin along an axis [m]: our choice, ten times the longest shape.
const FARTHEST: f64 = 100.0;
/// Plates along the longer side of a thin plate, unless the user gives a size: our choice, twice the segments of a leg
/// of the reference robot.
const ALONG: f64 = 24.0;
/// Largest ||q|² − 1| of a quaternion that counts as a rotation: our choice, beyond the drift of simulators in single
/// precision.
pub const UNIT: f64 = 1e-3;

/// A shape at its place in a body's frame.
#[derive(Clone, Debug, PartialEq)]
pub struct BodyPart {
    kind: PartKind,
    origin: Isometry3<f64>,
}

#[derive(Clone, Debug, PartialEq)]
enum PartKind {
    Solid(Geometry),
    /// A rectangle in the plane of x and y [m]. `thin`: sand acts on both faces; otherwise only on the upper face (+z).
    Sheet {
        length: f64,
        width: f64,
        thin: bool,
    },
}

/// A plate, and whether it is thin, so that sand acts on both of its sides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyPlate {
    pub plate: IntruderPlate,
    pub thin: bool,
}

impl BodyPart {
    /// See [`KINDS`]. Lengths are full lengths along x, widths along y, heights along z; a capsule's height is that of
    /// its cylinder. A cylinder with a `width` has its axis along y, like a wheel.
    pub fn named(text: &str) -> Result<Self> {
        let (kind, sizes) = text.split_once(':').unwrap_or((text, ""));
        let read = |names: &[&str]| sizes_of(text, sizes, names);
        let mut origin = Isometry3::identity();
        let kind = match kind {
            "sphere" => read(&["radius"]).map(|s| PartKind::Solid(Geometry::Sphere { radius: s[0] }))?,
            "box" => read(&["length", "width", "height"])
                .map(|s| PartKind::Solid(Geometry::Box { half: Vector3::new(s[0], s[1], s[2]) / 2.0 }))?,
            "ellipsoid" => read(&["length", "width", "height"])
                .map(|s| PartKind::Solid(ellipsoid(Vector3::new(s[0], s[1], s[2]) / 2.0)))?,
            "capsule" => read(&["radius", "height"])
                .map(|s| PartKind::Solid(Geometry::Capsule { radius: s[0], half_length: s[1] / 2.0 }))?,
            "cylinder" => {
                let wheel = sizes.contains("width");
                if wheel {
                    // A turn of −90° about x takes the axis z to y.
                    origin = Isometry3::rotation(Vector3::x() * -std::f64::consts::FRAC_PI_2);
                }
                read(&["radius", if wheel { "width" } else { "height" }])
                    .map(|s| PartKind::Solid(Geometry::Cylinder { radius: s[0], half_length: s[1] / 2.0 }))?
            }
            "plate" | "face" => read(&["length", "width"]).map(|s| PartKind::Sheet {
                length: s[0],
                width: s[1],
                thin: kind == "plate",
            })?,
            "mesh" => PartKind::Solid(mesh(Path::new(sizes))?),
            _ => {
                let end = Path::new(text).extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
                match end.as_deref() {
                    Some("stl" | "obj") => PartKind::Solid(mesh(Path::new(text))?),
                    _ => return Err(Error::unknown("shape", text, &KINDS)),
                }
            }
        };
        Ok(Self { kind, origin })
    }

    /// A closed mesh of triangles [m]; `name` is for error messages.
    pub fn triangles(name: &str, triangles: &[[[f64; 3]; 3]]) -> Result<Self> {
        let triangles = triangles.iter().map(|t| t.map(Vector3::from)).collect();
        Ok(Self { kind: PartKind::Solid(solid(name, triangles)?), origin: Isometry3::identity() })
    }

    /// The same part, moved to `position` [m] and turned by the quaternion (w, x, y, z).
    pub fn placed(mut self, position: [f64; 3], quaternion: [f64; 4]) -> Result<Self> {
        let [w, x, y, z] = quaternion;
        let squared = w * w + x * x + y * y + z * z;
        if !(squared - 1.0).abs().lt(&UNIT) || !position.iter().all(|p| p.abs() <= FARTHEST) {
            let reason = format!("position {position:?} and quaternion {quaternion:?} are no pose (w, x, y, z)");
            return Err(Error::invalid("shape", reason));
        }
        let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        self.origin = Isometry3::from_parts(Translation3::from(position), turn) * self.origin;
        Ok(self)
    }

    /// The part as a shape of a tree; None: a thin plate or a face.
    pub(crate) fn solid(&self, name: &str) -> Option<TreeShape> {
        match &self.kind {
            PartKind::Solid(geometry) => Some(TreeShape {
                name: name.to_owned(),
                origin: self.origin,
                geometry: geometry.clone(),
                friction: FRICTION,
            }),
            PartKind::Sheet { .. } => None,
        }
    }

    /// The plates of a thin plate or a face, of about `size` [m]. Rounding, up to 1e-9, adds no plate.
    pub(crate) fn sheet(&self, size: Option<f64>) -> Result<Vec<BodyPlate>> {
        let PartKind::Sheet { length, width, thin } = self.kind else { return Ok(Vec::new()) };
        let size = size.unwrap_or(length.max(width) / ALONG);
        let found = length * width / (size * size);
        if found > MOST_PLATES {
            let reason = format!("{found:.0} plates of {size} m on one shape are more than {MOST_PLATES}");
            return Err(Error::invalid("plate_size", reason));
        }
        let counts = [length, width].map(|side| ((side / size - 1e-9).ceil() as usize).max(1));
        let steps = [length / counts[0] as f64, width / counts[1] as f64];
        let vector = |v: Vector3<f64>| Vec3::splat((self.origin.rotation * v).into());
        let (normal, half) =
            (vector(Vector3::z()), [vector(Vector3::x() * (steps[0] / 2.0)), vector(Vector3::y() * (steps[1] / 2.0))]);
        let mut pieces = Vec::new();
        for i in 0..counts[0] {
            for j in 0..counts[1] {
                let at = |k: usize, count: usize, step: f64| (k as f64 + 0.5 - count as f64 / 2.0) * step;
                let center = nalgebra::Point3::new(at(i, counts[0], steps[0]), at(j, counts[1], steps[1]), 0.0);
                let center = Vec3::splat(self.origin.transform_point(&center).coords.into());
                let plate = IntruderPlate { center, normal, area: steps[0] * steps[1], half, bend: [0.0; 2] };
                pieces.push(BodyPlate { plate, thin });
            }
        }
        Ok(pieces)
    }
}

fn mesh(path: &Path) -> Result<Geometry> {
    let triangles = read_file(path)?;
    let triangles = triangles.iter().map(|t| t.map(|p| Vector3::from(p.lane(0)))).collect();
    solid(&path.display().to_string(), triangles)
}

/// A mesh that encloses a volume; a winding that is inside out is reversed.
fn solid(name: &str, triangles: Vec<[Vector3<f64>; 3]>) -> Result<Geometry> {
    if triangles.is_empty() || triangles.iter().flatten().any(|p| !p.iter().all(|x| x.is_finite())) {
        return Err(Error::invalid("mesh", format!("{name} has no triangles, or a corner is not finite")));
    }
    let side = |k: usize| {
        let along = || triangles.iter().flatten().map(|p| p[k]);
        along().fold(f64::MIN, f64::max) - along().fold(f64::MAX, f64::min)
    };
    let longest = side(0).max(side(1)).max(side(2));
    if !LENGTHS.contains(&longest) {
        let [least, most] = [LENGTHS.start(), LENGTHS.end()];
        let reason = format!("{name}: {longest:.3e} m is outside [{least:e}, {most}] m: meshes are in metres");
        return Err(Error::invalid("mesh", reason));
    }
    let turned: Vec<_> = triangles.iter().map(|[a, b, c]| [*a, *c, *b]).collect();
    for triangles in [triangles, turned] {
        if matches!(closed(&triangles), Closed::Itself) {
            return Ok(Geometry::Mesh(Arc::new(triangles)));
        }
    }
    Err(Error::invalid("mesh", format!("{name}: the surface is not closed")))
}

/// The surface that sand pushes on: the mesh itself if it is closed, otherwise its convex hull. The second value is
/// true for the hull. None: the mesh is flat.
pub fn closed_surface(triangles: Vec<[[f64; 3]; 3]>) -> Option<(Vec<[[f64; 3]; 3]>, bool)> {
    let vectors: Vec<_> = triangles.iter().map(|t| t.map(Vector3::from)).collect();
    match closed(&vectors) {
        Closed::Itself => Some((triangles, false)),
        Closed::Turned(turned) => Some((turned.iter().map(|t| t.map(Into::into)).collect(), false)),
        Closed::Hull(hull) => Some((hull.iter().map(|t| t.map(Into::into)).collect(), true)),
        Closed::Nothing => None,
    }
}
