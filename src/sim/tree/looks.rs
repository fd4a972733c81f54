//! What a robot looks like: primitives and small meshes, for pictures and recordings. They have no effect on motion.

use super::{Geometry, TreeShape};
use crate::error::{Error, Result, check_range};
use crate::sand::intruder::IntruderPlate;
use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;

/// Largest number of triangles of all meshes of a robot, each mesh counted once: our choice, because they take some 50
/// kB of a packed robot.
pub const MOST_TRIANGLES: usize = 4000;
/// Largest number of shapes, and of meshes: our choice, which bounds the memory and time that a client's robot takes.
const MOST_SHAPES: usize = 10_000;
/// Largest number of corners of all meshes: three for each triangle, as in a mesh whose triangles share no corners.
const MOST_CORNERS: usize = 3 * MOST_TRIANGLES;
/// Largest number of triangles of all shapes: our choice, so that a picture takes at most some tenths of a second.
const MOST_DRAWN: usize = 1 << 20;
/// Number of triangles that counts for a primitive: those of a sphere in pictures, 2 · 32 · 16. A capsule has 64 more,
/// other primitives fewer.
const PRIMITIVE: usize = 1 << 10;
/// Corners of meshes are rounded to this [m], which no picture shows: our choice.
const ROUNDED: f64 = 1e-4;

/// Shapes of all bodies, and the meshes that they refer to.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Looks {
    pub meshes: Vec<LookMesh>,
    pub shapes: Vec<VisualShape>,
    /// The meshes and shapes as JSON, because each section of a recording begins with this text.
    #[serde(skip)]
    json: String,
}

/// Triangles, counterclockwise seen from outside.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LookMesh {
    /// [m]
    pub corners: Vec<[f64; 3]>,
    /// Three indices of corners each.
    pub faces: Vec<[u32; 3]>,
}

/// A shape that is fixed to a body.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VisualShape {
    /// Index of the body.
    pub body: usize,
    /// The shape's position [m] and quaternion w, x, y, z in the body's frame.
    pub at: [f64; 7],
    /// A mesh is an index in [`Looks::meshes`].
    pub form: Geometry<usize>,
}

impl VisualShape {
    /// The shape's frame in the body's.
    pub fn origin(&self) -> Isometry3<f64> {
        let [x, y, z, w, i, j, k] = self.at;
        let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
        Isometry3::from_parts(Vector3::new(x, y, z).into(), turn)
    }
}

impl Looks {
    /// The shapes of each body for pictures. Equal meshes are stored once. With `meshed`, meshes are included; they
    /// must be small.
    pub fn of<'a>(bodies: impl Iterator<Item = &'a [TreeShape]>, meshed: bool) -> Self {
        let mut all = Self::default();
        for (body, shapes) in bodies.enumerate() {
            for shape in shapes {
                if matches!(shape.geometry, Geometry::Mesh(_)) && !meshed {
                    continue;
                }
                let form = shape.geometry.with_mesh(|triangles| all.mesh(LookMesh::of(triangles)));
                let (p, q) = (shape.origin.translation.vector, shape.origin.rotation);
                // Nine digits, as in a recording's header.
                let at = [p.x, p.y, p.z, q.w, q.i, q.j, q.k].map(|x| (x * 1e9).round() / 1e9);
                all.shapes.push(VisualShape { body, at, form });
            }
        }
        all.finished()
    }

    /// A copy that shows a body without shapes by its plates, if there are few enough plates to draw.
    #[must_use]
    pub fn or_plates(mut self, plates: &[Vec<IntruderPlate>]) -> Self {
        for (body, own) in plates.iter().enumerate() {
            let bare = !own.is_empty() && self.shapes.iter().all(|s| s.body != body);
            let meshed: usize = self.meshes.iter().map(|m| m.faces.len()).sum();
            if bare && meshed + 2 * own.len() <= MOST_TRIANGLES {
                let faces: Vec<_> = own.iter().flat_map(halves).collect();
                let form = Geometry::Mesh(self.mesh(LookMesh::of(&faces)));
                self.shapes.push(VisualShape { body, at: [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], form });
            }
        }
        self.finished()
    }

    fn mesh(&mut self, mesh: LookMesh) -> usize {
        self.meshes.iter().position(|m| *m == mesh).unwrap_or_else(|| {
            self.meshes.push(mesh);
            self.meshes.len() - 1
        })
    }

    /// Fills in the JSON.
    #[must_use]
    pub fn finished(mut self) -> Self {
        // There are only numbers and lists, so this cannot fail.
        self.json = serde_json::to_string(&self).unwrap_or_default();
        self
    }

    pub fn json(&self) -> &str {
        &self.json
    }

    /// Triangles of all shapes.
    fn drawn(&self) -> usize {
        let of = |s: &VisualShape| if let Geometry::Mesh(i) = s.form { self.meshes[i].faces.len() } else { PRIMITIVE };
        self.shapes.iter().map(of).sum()
    }

    /// Checks every number of a client's robot of this many bodies.
    pub fn check(&self, bodies: usize) -> Result<()> {
        let wrong = |reason: String| Err(Error::invalid("looks", reason));
        let of_meshes = |count: fn(&LookMesh) -> usize| self.meshes.iter().map(count).sum::<usize>();
        for (what, count, most) in [
            ("shapes in looks", self.shapes.len(), MOST_SHAPES),
            ("corners of meshes in looks", of_meshes(|m| m.corners.len()), MOST_CORNERS),
            ("triangles of meshes in looks", of_meshes(|m| m.faces.len()), MOST_TRIANGLES),
            ("meshes in looks", self.meshes.len(), MOST_SHAPES),
        ] {
            check_range(what, count as f64, 0.0..=most as f64)?;
        }
        for mesh in &self.meshes {
            mesh.corners
                .iter()
                .flatten()
                .try_for_each(|x| check_range("a corner in looks", *x, -1e6..=1e6).map(drop))?;
            if let Some(i) = mesh.faces.iter().flatten().find(|i| **i as usize >= mesh.corners.len()) {
                return wrong(format!("corner {i} of a mesh with {}", mesh.corners.len()));
            }
        }
        for shape in &self.shapes {
            let sizes = match shape.form {
                Geometry::Sphere { radius } => [radius; 3],
                Geometry::Capsule { radius, half_length } | Geometry::Cylinder { radius, half_length } => {
                    [radius, half_length, radius]
                }
                Geometry::Box { half } => half.into(),
                Geometry::Mesh(i) if i >= self.meshes.len() => {
                    return wrong(format!("mesh {i} of {}", self.meshes.len()));
                }
                Geometry::Mesh(_) => [0.0; 3],
            };
            if shape.body >= bodies {
                return wrong(format!("body {} of {bodies}", shape.body));
            }
            sizes.into_iter().try_for_each(|x| check_range("a size in looks", x, 0.0..=1e6).map(drop))?;
            shape.at.into_iter().try_for_each(|x| check_range("a position in looks", x, -1e6..=1e6).map(drop))?;
            let square = shape.at[3..].iter().map(|x| x * x).sum();
            check_range("a quaternion's square in looks", square, 0.99..=1.01)?;
        }
        check_range("triangles in looks", self.drawn() as f64, 0.0..=MOST_DRAWN as f64).map(drop)
    }
}

impl LookMesh {
    /// Corners are rounded, and equal ones become one; triangles without an area are dropped.
    fn of(triangles: &[[Vector3<f64>; 3]]) -> Self {
        let mut mesh = Self { corners: Vec::new(), faces: Vec::new() };
        let mut known = HashMap::new();
        for triangle in triangles {
            let face = triangle.map(|p| {
                let key = [p.x, p.y, p.z].map(|x| (x / ROUNDED).round() as i64);
                *known.entry(key).or_insert_with(|| {
                    mesh.corners.push(key.map(|k| k as f64 / ROUNDED.recip()));
                    mesh.corners.len() as u32 - 1
                })
            });
            if face[0] != face[1] && face[1] != face[2] && face[2] != face[0] {
                mesh.faces.push(face);
            }
        }
        mesh
    }
}

/// A plate as two triangles that face outward.
fn halves(plate: &IntruderPlate) -> [[Vector3<f64>; 3]; 2] {
    let [middle, normal, u, v] =
        [plate.center, plate.normal, plate.half[0], plate.half[1]].map(|x| Vector3::from(x.lane(0)));
    let v = if u.cross(&v).dot(&normal) < 0.0 { -v } else { v };
    let [a, b, c, d] = [middle - u - v, middle + u - v, middle + u + v, middle - u + v];
    [[a, b, c], [a, c, d]]
}
