//! Meshes that robots name: STL, OBJ and DAE, scaled; each file is read once.

use super::collada::{self, MOST_TRIANGLES};
use super::files::{MOST_MESH, SourceFile};
use super::hull;
use crate::error::{Error, Result};
use crate::sand::intruder;
use nalgebra::{Matrix3, Vector3};
use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;

/// Largest number of triangles of all meshes of a robot: our choice, which bounds their memory to 144 MB.
const MOST_TOGETHER: usize = 2_000_000;
/// Corners closer than this share of the mesh's size are merged: our choice, ten times single precision's rounding.
const SAME: f64 = 1e-6;

/// A closed surface is flat if its volume is below this share of its size cubed: our choice, a thousand times the rounding of
/// sums in double precision.
const FLAT: f64 = 1e-13;

pub type Triangle = [Vector3<f64>; 3];
/// Volume or area, centre, and inertia about this centre for density 1.
type MassMoments = (f64, Vector3<f64>, Matrix3<f64>);

/// A mesh by its file.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshFile {
    pub path: PathBuf,
    pub scale: Vector3<f64>,
}

/// The triangles of every file that was read, before they are scaled.
#[derive(Default)]
pub struct Meshes {
    read: HashMap<PathBuf, Arc<Vec<Triangle>>>,
    /// Scaled meshes, by file and the bits of the factors.
    scaled: HashMap<(PathBuf, [u64; 3]), Arc<Vec<Triangle>>>,
    triangles: usize,
}

impl Meshes {
    pub fn scaled(&mut self, file: &MeshFile) -> Result<Arc<Vec<Triangle>>> {
        let whole = self.whole(&file.path)?;
        if file.scale == Vector3::repeat(1.0) {
            return Ok(whole);
        }
        let key = (file.path.clone(), [0, 1, 2].map(|k| file.scale[k].to_bits()));
        if let Some(known) = self.scaled.get(&key) {
            return Ok(known.clone());
        }
        self.count(whole.len(), &file.path)?;
        let made = Arc::new(scaled(&whole, &file.scale));
        self.scaled.insert(key, made.clone());
        Ok(made)
    }

    fn whole(&mut self, path: &PathBuf) -> Result<Arc<Vec<Triangle>>> {
        if let Some(found) = self.read.get(path) {
            return Ok(found.clone());
        }
        let source = SourceFile::read(path, MOST_MESH)?;
        source.stand_in("the mesh").map_or(Ok(()), |reason| Err(Error::file(path, reason)))?;
        let ending = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
        let triangles = match ending.as_deref() {
            Some("dae") => collada::read(&source)?,
            Some("stl" | "obj") => {
                let stl = ending.as_deref() == Some("stl");
                let bytes = if stl { stl_text(source.bytes()) } else { None };
                if stl && bytes.is_none() {
                    binary_stl(source.bytes()).map_err(|reason| Error::file(path, reason))?;
                }
                let read = intruder::read_mesh(path, bytes.as_deref().unwrap_or(source.bytes()), MOST_TRIANGLES);
                let read = read.map_err(|e| cut_text(e, path, bytes.as_deref()))?;
                read.into_iter().map(|t| t.map(|p| Vector3::from(p.lane(0)))).collect()
            }
            _ => return Err(Error::file(path, "meshes are read from .stl, .obj and .dae")),
        };
        if triangles.is_empty() {
            return Err(Error::file(path, "no triangles; export it again as triangles"));
        }
        // Our choice of the bound: it catches numbers that are no lengths, before the robot's file scales the mesh.
        if triangles.iter().flatten().flatten().any(|x| !x.is_finite() || x.abs() > 1e6) {
            return Err(Error::file(path, "a vertex is not finite, or farther than 1000 km"));
        }
        self.count(triangles.len(), path)?;
        let shared = Arc::new(triangles);
        self.read.insert(path.clone(), shared.clone());
        Ok(shared)
    }

    fn count(&mut self, more: usize, path: &std::path::Path) -> Result<()> {
        self.triangles += more;
        if self.triangles > MOST_TOGETHER {
            return Err(Error::file(
                path,
                format!("the robot's meshes have more than {MOST_TOGETHER} triangles: make them coarser"),
            ));
        }
        Ok(())
    }
}

/// Bytes before the triangles of a binary STL, and of each triangle.
const BINARY_STL: [usize; 2] = [84, 50];

/// The length that a binary STL of as many triangles as it says has; None: it has no whole head.
fn stl_length(bytes: &[u8]) -> Option<usize> {
    let count = bytes.get(BINARY_STL[0] - 4..BINARY_STL[0])?.first_chunk::<4>()?;
    Some(BINARY_STL[0] + BINARY_STL[1] * u32::from_le_bytes(*count) as usize)
}

/// A text STL in the form that our reader takes: in small letters, without blanks before it; None: the STL is binary.
fn stl_text(bytes: &[u8]) -> Option<Vec<u8>> {
    let start = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes).trim_ascii_start();
    let solid = start.len() > 5 && start[..5].eq_ignore_ascii_case(b"solid");
    // Some binary files begin with "solid", too: their length or their bytes show it.
    let text = solid && stl_length(bytes) != Some(bytes.len()) && !bytes.contains(&0);
    text.then(|| start.to_ascii_lowercase())
}

fn binary_stl(bytes: &[u8]) -> std::result::Result<(), String> {
    match stl_length(bytes) {
        None => Err(format!("ends early: {} bytes; even the head of a binary STL has {}", bytes.len(), BINARY_STL[0])),
        Some(wanted) if bytes.len() < wanted => {
            Err(format!("ends early: {} bytes of {wanted}; download it again", bytes.len()))
        }
        Some(wanted) if bytes.len() > wanted => {
            Err(format!("is no STL: {} bytes, and its number of triangles needs {wanted}", bytes.len()))
        }
        Some(_) => Ok(()),
    }
}

/// Says of a text STL without its last line that it ends early.
fn cut_text(error: Error, path: &std::path::Path, text: Option<&[u8]>) -> Error {
    match text {
        Some(text) if !String::from_utf8_lossy(text).contains("endsolid") => {
            Error::file(path, format!("ends early: {} bytes without \"endsolid\"; download it again", text.len()))
        }
        _ => error,
    }
}

/// Scales a mesh. A mirror image would be inside out, so its triangles are reversed.
pub fn scaled(triangles: &[Triangle], scale: &Vector3<f64>) -> Vec<Triangle> {
    let mirrored = scale.product() < 0.0;
    let one = |t: &Triangle| {
        let [a, b, c] = t.map(|p| p.component_mul(scale));
        if mirrored { [a, c, b] } else { [a, b, c] }
    };
    triangles.iter().map(one).collect()
}

/// A surface that sand can push on, and how it was made.
pub enum Closed {
    Itself,
    /// The mesh with its triangles turned, because it is inside out.
    Turned(Vec<Triangle>),
    /// The convex hull, because the mesh is open or has no volume.
    Hull(Vec<Triangle>),
    /// The mesh is flat.
    Nothing,
}

pub fn closed(triangles: &[Triangle]) -> Closed {
    let points: Vec<_> = triangles.iter().flatten().copied().collect();
    let (middle, size) = hull::middle_and_size(&points);
    if is_closed(triangles, &middle, size) {
        let centred: Vec<Triangle> = triangles.iter().map(|t| t.map(|p| p - middle)).collect();
        let volume = volume(&centred) / size.powi(3);
        if volume > FLAT {
            return Closed::Itself;
        }
        if volume < -FLAT {
            return Closed::Turned(triangles.iter().map(|[a, b, c]| [*a, *c, *b]).collect());
        }
    }
    hull::hull(&points).map_or(Closed::Nothing, Closed::Hull)
}

/// Does every edge have one triangle on each side, with the same winding?
fn is_closed(triangles: &[Triangle], middle: &Vector3<f64>, size: f64) -> bool {
    let cell = (SAME * size).max(f64::MIN_POSITIVE);
    let key = |p: &Vector3<f64>| [0, 1, 2].map(|k| ((p[k] - middle[k]) / cell).round() as i64);
    let mut edges: HashMap<[[i64; 3]; 2], i32> = HashMap::new();
    for [a, b, c] in triangles.iter().map(|t| [key(&t[0]), key(&t[1]), key(&t[2])]) {
        for [from, to] in [[a, b], [b, c], [c, a]] {
            // After corners are merged, a very thin triangle has an edge of length 0.
            match from.cmp(&to) {
                std::cmp::Ordering::Less => *edges.entry([from, to]).or_default() += 1,
                std::cmp::Ordering::Greater => *edges.entry([to, from]).or_default() -= 1,
                std::cmp::Ordering::Equal => {}
            }
        }
    }
    edges.values().all(|n| *n == 0)
}

/// Volume by the divergence theorem [m³]; negative if the surface is inside out.
pub fn volume(triangles: &[Triangle]) -> f64 {
    triangles.iter().map(|[a, b, c]| a.dot(&b.cross(c))).sum::<f64>() / 6.0
}

/// Volume, centre, and inertia about it for density 1, of a closed surface.
pub fn solid(triangles: &[Triangle]) -> MassMoments {
    let (volume, first, second) = tetrahedra(triangles, Vector3::zeros(), false);
    moments(volume, first, second)
}

/// The same as [`solid`], by MuJoCo's rule `legacy`: tetrahedra between the faces and the mean of the faces' centres, all
/// counted as positive, give the centre of mass; then tetrahedra between the faces and the centre of mass give volume and
/// inertia.
pub fn legacy(triangles: &[Triangle]) -> MassMoments {
    let middle = middle_of_faces(triangles);
    let (volume, first, _) = tetrahedra(triangles, middle, true);
    let center = first / volume + middle;
    let (volume, _, second) = tetrahedra(triangles, center, true);
    (volume, center, Matrix3::identity() * second.trace() - second)
}

/// Volume, and first and second moments about `tip`, of the tetrahedra between `tip` and the faces; with `unsigned`,
/// inverted tetrahedra count as positive.
fn tetrahedra(triangles: &[Triangle], tip: Vector3<f64>, unsigned: bool) -> MassMoments {
    let (mut volume, mut first, mut second) = (0.0, Vector3::zeros(), Matrix3::zeros());
    for t in triangles {
        let [a, b, c] = t.map(|p| p - tip);
        let signed = a.dot(&b.cross(&c)) / 6.0;
        let v = if unsigned { signed.abs() } else { signed };
        let sum = a + b + c;
        volume += v;
        first += sum * (v / 4.0);
        // ∫ x xᵀ over a tetrahedron with a corner at 0: V/20 (Σ p pᵀ + (Σ p)(Σ p)ᵀ).
        second += (a * a.transpose() + b * b.transpose() + c * c.transpose() + sum * sum.transpose()) * (v / 20.0);
    }
    (volume, first, second)
}

/// Mean of the faces' centres, weighted by area.
fn middle_of_faces(triangles: &[Triangle]) -> Vector3<f64> {
    let (mut sum, mut all) = (Vector3::zeros(), 0.0);
    for [a, b, c] in triangles {
        let area = (b - a).cross(&(c - a)).norm() / 2.0;
        sum += (a + b + c) * (area / 3.0);
        all += area;
    }
    if all > 0.0 { sum / all } else { sum }
}

/// Moments of a thin shell: area in place of volume.
pub fn shell(triangles: &[Triangle]) -> MassMoments {
    let (mut area, mut center, mut second) = (0.0, Vector3::zeros(), Matrix3::zeros());
    for [a, b, c] in triangles {
        let s = (b - a).cross(&(c - a)).norm() / 2.0;
        let sum = a + b + c;
        area += s;
        center += sum * (s / 3.0);
        // ∫ x xᵀ over a triangle: A/12 (Σ p pᵀ + (Σ p)(Σ p)ᵀ).
        second += (a * a.transpose() + b * b.transpose() + c * c.transpose() + sum * sum.transpose()) * (s / 12.0);
    }
    moments(area, center, second)
}

fn moments(amount: f64, first: Vector3<f64>, second: Matrix3<f64>) -> MassMoments {
    let center = first / amount;
    let about = second - center * center.transpose() * amount;
    (amount, center, Matrix3::identity() * about.trace() - about)
}
