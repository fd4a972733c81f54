//! `<geom>` and `<mesh>`: shapes, and the inertia of bodies that follows from shapes.

use super::compiler::{Compiler, flag, from_z};
use crate::draft::{DraftShape, Inertial};
use crate::error::{Error, Result};
use crate::files::Files;
use crate::hull::hull;
use crate::mesh::{self, MeshFile, Meshes, Triangle};
use crate::notes::Notes;
use crate::shapes::{closed_mesh, ellipsoid};
use crate::sim::tree::Geometry;
use crate::xml::Element;
use nalgebra::{Isometry3, Matrix3, Quaternion, Translation3, Unit, UnitQuaternion, Vector3};
use std::collections::HashMap;
use std::f64::consts::PI;
use std::path::Path;
use std::sync::Arc;

/// Density of water [kg/m³], MuJoCo's default.
const DENSITY: f64 = 1000.0;
/// Friction of geoms whose file gives none: MuJoCo's default.
const FRICTION: f64 = 1.0;

/// How the mass of a mesh is computed.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Filling {
    /// From the convex hull.
    Convex,
    /// From the volume inside the surface, which must be closed.
    Exact,
    /// From the volume by the rule of [`mesh::legacy`], MuJoCo's default.
    Legacy,
    /// From a thin shell, whose mass per unit of area is density × 1 m.
    Shell,
}

/// The triangles of a `<mesh>`, and how its mass is computed.
pub struct Mesh {
    triangles: Arc<Vec<Triangle>>,
    filling: Filling,
}

/// Meshes by name. If a file cannot be read, its mesh has the reason instead: only a geom that needs its mesh is refused.
pub type Assets = HashMap<String, Result<Mesh>>;

/// The data needed to read an asset.
pub struct GeomReader<'a> {
    pub compiler: &'a Compiler,
    pub files: &'a Files,
    pub meshes: &'a mut Meshes,
    pub notes: &'a mut Notes,
}

const MESH_KNOWN: [&str; 14] = [
    "builtin",
    "params",
    "name",
    "class",
    "file",
    "vertex",
    "face",
    "scale",
    "refpos",
    "refquat",
    "inertia",
    "normal",
    "texcoord",
    "content_type",
];

impl GeomReader<'_> {
    /// Name and triangles of a `<mesh>` to which its defaults are applied. If its file cannot be read, the result has
    /// the reason instead of triangles.
    pub fn mesh(&mut self, element: &Element) -> Result<(String, Result<Mesh>)> {
        self.notes.others(element, &MESH_KNOWN);
        let scale = Vector3::from(element.numbers("scale")?.unwrap_or([1.0; 3]));
        // Our choice of the bound: it catches mistakes; files in millimetres have 0.001.
        if scale.iter().any(|s| *s == 0.0 || s.abs() > 1e4) {
            return Err(element.wrong("scale", "must not be 0, nor larger than 10000"));
        }
        let filling = match element.get("inertia") {
            None | Some("legacy") => Filling::Legacy,
            Some("convex") => Filling::Convex,
            Some("exact") => Filling::Exact,
            Some("shell") => Filling::Shell,
            Some(other) => return Err(element.wrong("inertia", format!("{other:?} is not known"))),
        };
        if let Some(builtin) = element.get("builtin").filter(|kind| *kind != "none") {
            let reason = format!(
                "MuJoCo makes this {builtin:?} itself; it is not read here: give a file, or a geom of this type"
            );
            return Ok((element.required("name")?.to_owned(), Err(element.wrong("builtin", reason))));
        }
        let (stem, whole) = match (element.get("file"), element.list("vertex")?) {
            (Some(file), None) => {
                let file = if self.compiler.strippath { file.rsplit(['/', '\\']).next().unwrap_or(file) } else { file };
                let stem = Path::new(file).file_stem().unwrap_or_default().to_string_lossy().into_owned();
                match self.file(file) {
                    Ok(triangles) => (stem, triangles),
                    Err(reason) => {
                        let name = element.get("name").unwrap_or(&stem).to_owned();
                        return Ok((name, Err(element.error(reason))));
                    }
                }
            }
            (None, Some(vertices)) => (String::new(), Arc::new(inline(element, &vertices)?)),
            _ => return Err(element.error("needs either file or vertex")),
        };
        let name = element.get("name").unwrap_or(&stem).to_owned();
        let mut triangles = whole;
        if element.get("refpos").is_some() || element.get("refquat").is_some() {
            let place = Vector3::from(element.numbers("refpos")?.unwrap_or_default());
            let [w, x, y, z] = element.numbers("refquat")?.unwrap_or([1.0, 0.0, 0.0, 0.0]);
            let turn = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-14); // MuJoCo's `mjEPS`
            let turn = turn.ok_or_else(|| element.wrong("refquat", "has no direction"))?;
            triangles = Arc::new(triangles.iter().map(|t| t.map(|p| turn.inverse() * (p - place))).collect());
        }
        if scale != Vector3::repeat(1.0) {
            triangles = Arc::new(mesh::scaled(&triangles, &scale));
        }
        Ok((name, Ok(Mesh { triangles, filling })))
    }

    /// The triangles of a file that is named relative to `meshdir`.
    fn file(&mut self, name: &str) -> Result<Arc<Vec<Triangle>>> {
        let path = self.files.find(&self.compiler.meshdir, name)?;
        self.meshes.scaled(&MeshFile { path, scale: Vector3::repeat(1.0) })
    }
}

/// Vertices and faces inside the XML; without faces, the hull. MuJoCo keeps vertices in single precision.
fn inline(element: &Element, vertices: &[f64]) -> Result<Vec<Triangle>> {
    if !vertices.len().is_multiple_of(3) {
        return Err(element.wrong("vertex", "is no list of points"));
    }
    let single = |x: f64| f64::from(x as f32);
    let points: Vec<_> =
        vertices.chunks_exact(3).map(|p| Vector3::new(single(p[0]), single(p[1]), single(p[2]))).collect();
    let Some(faces) = element.list("face")? else {
        return hull(&points).ok_or_else(|| element.wrong("vertex", "the points lie in a plane"));
    };
    let corner = |index: f64| {
        let point = points.get(index as usize).filter(|_| index >= 0.0 && index.fract() == 0.0);
        point.copied().ok_or_else(|| element.wrong("face", format!("{index} is no vertex")))
    };
    let face = |f: &[f64]| Ok([corner(f[0])?, corner(f[1])?, corner(f[2])?]);
    faces.chunks_exact(3).map(face).collect()
}

/// A geom: pose, shape and mass.
pub struct Geom {
    pub name: String,
    pub origin: Isometry3<f64>,
    /// The shape that collides; None if the geom does not collide.
    pub collision: Option<Geometry>,
    pub look: DraftShape,
    pub friction: f64,
    pub inertial: Inertial,
}

const KNOWN: [&str; 25] = [
    "name",
    "class",
    "type",
    "size",
    "fromto",
    "pos",
    "quat",
    "axisangle",
    "euler",
    "xyaxes",
    "zaxis",
    "mesh",
    "mass",
    "density",
    "group",
    "contype",
    "conaffinity",
    "friction",
    "material",
    "rgba",
    "shellinertia",
    "fitscale",
    "user",
    "hfield",
    "fluidshape",
];

/// Is this geom only drawn, and can the file of its mesh not be read? Such a geom is left out with a note. `weighed`: the
/// body's mass does not come from its geoms.
pub fn unreadable_look(element: &Element, assets: &Assets, weighed: bool, notes: &mut Notes) -> Result<bool> {
    let name = element.get("mesh").unwrap_or_default();
    let Some(Err(reason)) = assets.get(name) else { return Ok(false) };
    let nothing = |attribute| Ok::<_, Error>(element.number(attribute)? == Some(0.0));
    let light = weighed || nothing("mass")? || (element.get("mass").is_none() && nothing("density")?);
    if collides(element)? || !light {
        return Ok(false);
    }
    notes.undrawn(reason);
    Ok(true)
}

fn collides(element: &Element) -> Result<bool> {
    Ok([element.number("contype")?, element.number("conaffinity")?].iter().any(|c| *c != Some(0.0)))
}

/// Reads a geom, with the defaults of its class.
pub fn geom(element: &Element, compiler: &Compiler, assets: &Assets, notes: &mut Notes) -> Result<Geom> {
    notes.others(element, &KNOWN);
    if flag(element, "shellinertia")?.unwrap_or(false) {
        return Err(element.error("shellinertia is not read: give an <inertial>"));
    }
    let kind = element.get("type").unwrap_or("sphere");
    if kind != "mesh" && element.get("mesh").is_some() {
        return Err(element.error(format!("a {kind} fitted to a mesh is not read: give its pos and size, and no mesh")));
    }
    let mut origin = compiler.pose(element)?;
    let mut size = element.list("size")?.unwrap_or_default();
    if let Some(ends) = element.numbers::<6>("fromto")? {
        let from_to = Vector3::new(ends[0] - ends[3], ends[1] - ends[4], ends[2] - ends[5]);
        let middle = Translation3::new(ends[0] + ends[3], ends[1] + ends[4], ends[2] + ends[5]);
        // MuJoCo's `mjEPS`.
        let axis = Unit::try_new(from_to, 1e-14).ok_or_else(|| element.wrong("fromto", "has no length"))?;
        origin = Isometry3::from_parts(Translation3::from(middle.vector / 2.0), from_z(axis));
        let radius = size.first().copied().unwrap_or(0.0);
        let half = from_to.norm() / 2.0;
        size = match kind {
            "capsule" | "cylinder" => vec![radius, half],
            "box" | "ellipsoid" => vec![radius, radius, half],
            _ => return Err(element.wrong("fromto", format!("a {kind} has none"))),
        };
    }
    let side = |k: usize| {
        let value = size.get(k).ok_or_else(|| element.wrong("size", format!("a {kind} needs {} numbers", k + 1)))?;
        element.length("size", *value)
    };
    let unknown = |what: &str| element.error(format!("type {what:?} is not read on a robot"));
    let mut shape = match kind {
        "sphere" => Geometry::Sphere { radius: side(0)? },
        "capsule" => Geometry::Capsule { radius: side(0)?, half_length: side(1)? },
        "cylinder" => Geometry::Cylinder { radius: side(0)?, half_length: side(1)? },
        "box" => Geometry::Box { half: Vector3::new(side(0)?, side(1)?, side(2)?) },
        "ellipsoid" => ellipsoid(Vector3::new(side(0)?, side(1)?, side(2)?)),
        "mesh" => Geometry::Mesh(found(element, assets)?.triangles.clone()),
        other => return Err(unknown(other)),
    };
    let (volume, own) = match kind {
        "mesh" => filled(element, found(element, assets)?)?,
        "ellipsoid" => of_ellipsoid([side(0)?, side(1)?, side(2)?]),
        _ => solid(&shape),
    };
    let inertial = weighed(element, compiler, volume, &own)?.moved(&origin);
    let collides = collides(element)?;
    let look = DraftShape::Shape(shape.clone());
    if let (Geometry::Mesh(triangles), true, "mesh") = (&shape, collides, kind) {
        let name = element.get("mesh").unwrap_or_default();
        let kept = closed_mesh(name, triangles.clone(), notes);
        shape = kept.ok_or_else(|| element.error(format!("the mesh {name:?} is flat: it has no volume")))?;
    }
    let friction = element.list("friction")?.and_then(|f| f.first().copied()).unwrap_or(FRICTION);
    Ok(Geom {
        name: element.get("name").unwrap_or_default().to_owned(),
        origin,
        collision: collides.then_some(shape),
        look,
        friction,
        inertial,
    })
}

fn found<'a>(element: &Element, assets: &'a Assets) -> Result<&'a Mesh> {
    let name = element.required("mesh")?;
    let asset = assets.get(name).ok_or_else(|| element.error(format!("there is no mesh {name:?}")))?;
    asset.as_ref().map_err(Error::clone)
}

/// Mass and inertia from the geom's mass or else its density; none if its density is 0 or its group does not contribute
/// to inertia.
fn weighed(element: &Element, compiler: &Compiler, volume: f64, own: &Inertial) -> Result<Inertial> {
    let group = element.number("group")?.unwrap_or(0.0);
    if group < compiler.groups[0] || group > compiler.groups[1] {
        return Ok(Inertial::none());
    }
    let density = match element.not_negative("mass")? {
        Some(mass) => mass / volume,
        None => element.not_negative("density")?.unwrap_or(DENSITY),
    };
    if density == 0.0 {
        return Ok(Inertial::none());
    }
    Ok(Inertial { mass: own.mass * density, inertia: own.inertia * density, ..*own })
}

fn diagonal(volume: f64, moments: [f64; 3]) -> (f64, Inertial) {
    let inertia = Matrix3::from_diagonal(&Vector3::from(moments));
    (volume, Inertial { mass: volume, center: Vector3::zeros(), inertia })
}

/// Volume, and mass and inertia of density 1.
fn solid(shape: &Geometry) -> (f64, Inertial) {
    match *shape {
        Geometry::Sphere { radius: r } => of_ellipsoid([r, r, r]),
        Geometry::Box { half: h } => {
            let v = 8.0 * h.x * h.y * h.z;
            let [x, y, z] = [h.x * h.x, h.y * h.y, h.z * h.z];
            diagonal(v, [v / 3.0 * (y + z), v / 3.0 * (x + z), v / 3.0 * (x + y)])
        }
        Geometry::Cylinder { radius: r, half_length: h } => {
            let v = 2.0 * PI * r * r * h;
            let across = v * (3.0 * r * r + 4.0 * h * h) / 12.0;
            diagonal(v, [across, across, v * r * r / 2.0])
        }
        Geometry::Capsule { radius: r, half_length: h } => {
            let (tube, caps) = (2.0 * PI * r * r * h, 4.0 / 3.0 * PI * r * r * r);
            // The centroid of half a ball is 3/8 r above its base.
            let across =
                tube * (3.0 * r * r + 4.0 * h * h) / 12.0 + caps * (2.0 / 5.0 * r * r + h * h + 3.0 / 4.0 * r * h);
            let along = tube * r * r / 2.0 + caps * 2.0 / 5.0 * r * r;
            diagonal(tube + caps, [across, across, along])
        }
        Geometry::Mesh(_) => (0.0, Inertial::none()),
    }
}

fn of_ellipsoid([a, b, c]: [f64; 3]) -> (f64, Inertial) {
    let v = 4.0 / 3.0 * PI * a * b * c;
    diagonal(v, [v / 5.0 * (b * b + c * c), v / 5.0 * (a * a + c * c), v / 5.0 * (a * a + b * b)])
}

fn filled(element: &Element, mesh: &Mesh) -> Result<(f64, Inertial)> {
    let triangles = &mesh.triangles;
    let (amount, center, inertia) = match mesh.filling {
        Filling::Shell => mesh::shell(triangles),
        Filling::Exact => mesh::solid(triangles),
        Filling::Legacy => mesh::legacy(triangles),
        Filling::Convex => {
            let points: Vec<_> = triangles.iter().flatten().copied().collect();
            let hull = hull(&points).ok_or_else(|| no_volume(element))?;
            mesh::solid(&hull)
        }
    };
    // Our choice of the bound: the volume of a cube with sides of 22 µm [m³], or a shell's area [m²].
    if amount.is_nan() || amount <= 1e-14 {
        return Err(no_volume(element));
    }
    Ok((amount, Inertial { mass: amount, center, inertia }))
}

fn no_volume(element: &Element) -> Error {
    element.error("the mesh has no volume: give the body an <inertial>, and the geom mass=\"0\"")
}
