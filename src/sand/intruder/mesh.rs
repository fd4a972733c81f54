//! Closed meshes of triangles, in metres, from STL (text or binary) and OBJ.

use super::{IntruderPlate, area as plates_area, volume};
use crate::error::{Error, Result};
use crate::number::Vec3;
use std::io::{BufRead, Seek, SeekFrom};
use std::path::Path;

pub type Triangle = [Vec3<f64>; 3];

/// Largest number of plates of a body: our choice, 2 × 10⁶ take 240 MB.
pub(super) const MOST_PLATES: usize = 2_000_000;

/// Largest number of triangles of a mesh: our choice; no scan needs more than 10⁶.
const MOST_TRIANGLES: usize = 1_000_000;
/// Largest file that is read [bytes]: 10⁶ triangles as text; our choice.
const MOST_BYTES: u64 = 300 << 20;
/// Bytes before the triangles of a binary STL: a header of 80, and their number.
const BINARY_HEAD: u64 = 84;
/// What to do with a file that is no mesh.
const AGAIN: &str = "download it again, or export it again as triangles";
/// |Σ n A|/Σ A above which a surface is not closed: our choice, far above the rounding of STL's single precision.
const OPEN: f64 = 1e-3;

/// The triangles of a file, without triangles of zero area.
pub fn read(path: &Path) -> Result<Vec<Triangle>> {
    read_bytes(path, &sandgait_base::files::read_regular(path, MOST_BYTES)?, MOST_TRIANGLES)
}

/// The same as [`read`], from a file's `bytes`, with at most `most` triangles.
pub fn read_bytes(path: &Path, bytes: &[u8], most: usize) -> Result<Vec<Triangle>> {
    some(path, read_mesh(path, bytes, most)?)
}

fn some(path: &Path, triangles: Vec<Triangle>) -> Result<Vec<Triangle>> {
    if triangles.is_empty() { Err(Error::file(path, format!("no triangles; {AGAIN}"))) } else { Ok(triangles) }
}

/// Reads the triangles in `bytes`, STL or OBJ by the ending of `path`, at most `most`.
pub fn read_mesh(path: &Path, bytes: &[u8], most: usize) -> Result<Vec<Triangle>> {
    read_from(path, std::io::Cursor::new(bytes), most)
}

fn read_from(path: &Path, reader: impl BufRead + Seek, most: usize) -> Result<Vec<Triangle>> {
    let is_obj = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("obj"));
    let mut triangles = if is_obj { read_obj(path, reader, most)? } else { read_stl(path, reader, most)? };
    if triangles.iter().flatten().any(|p| !p.norm_squared().is_finite()) {
        return Err(Error::file(path, "a vertex is not finite"));
    }
    triangles.retain(|t| cross(t).norm_squared() > 0.0);
    Ok(triangles)
}

fn too_many(path: &Path, most: usize) -> Error {
    Error::file(path, format!("more than {most} triangles"))
}

fn read_stl(path: &Path, mut reader: impl BufRead + Seek, most: usize) -> Result<Vec<Triangle>> {
    let failed = |e: std::io::Error| Error::file(path, format!("no STL, or it ends early: {e}; {AGAIN}"));
    if let Some(count) = binary_count(&mut reader).map_err(failed)? {
        return if count > most { Err(too_many(path, most)) } else { read_binary_stl(reader, count).map_err(failed) };
    }
    let mut triangles = Vec::new();
    for triangle in stl_io::create_stl_reader(&mut reader).map_err(failed)? {
        let triangle = triangle.map_err(failed)?;
        if triangles.len() == most {
            return Err(too_many(path, most));
        }
        triangles.push(triangle.vertices.map(|v| point([v[0], v[1], v[2]])));
    }
    Ok(triangles)
}

/// Number of triangles of a binary STL. None if the length of the file does not fit this number: then the file is no
/// binary STL, and reading begins again at its start. Some binary files begin with "solid", as text files do, so the
/// number and the length decide.
fn binary_count(reader: &mut (impl BufRead + Seek)) -> std::io::Result<Option<usize>> {
    let length = reader.seek(SeekFrom::End(0))?;
    reader.rewind()?;
    if length < BINARY_HEAD {
        return Ok(None);
    }
    reader.seek(SeekFrom::Start(BINARY_HEAD - 4))?;
    let mut count = [0; 4];
    reader.read_exact(&mut count)?;
    let count = u32::from_le_bytes(count);
    let fits = length == BINARY_HEAD + 50 * u64::from(count);
    if !fits {
        reader.rewind()?;
    }
    Ok(fits.then_some(count as usize))
}

/// `count` triangles of 50 bytes: normal, three corners, two bytes that are not used.
fn read_binary_stl(mut reader: impl BufRead, count: usize) -> std::io::Result<Vec<Triangle>> {
    let mut record = [0; 50];
    let mut triangle = || {
        reader.read_exact(&mut record)?;
        let number = |k: usize| f32::from_le_bytes([0, 1, 2, 3].map(|i| record[4 * k + i]));
        Ok([3, 6, 9].map(|k| point([number(k), number(k + 1), number(k + 2)])))
    };
    (0..count).map(|_| triangle()).collect()
}

fn read_obj(path: &Path, mut reader: impl BufRead, most: usize) -> Result<Vec<Triangle>> {
    let options =
        tobj::LoadOptions { triangulate: true, ignore_lines: true, ignore_points: true, ..Default::default() };
    // Colours are not needed, so no material file is opened.
    let no_materials = |_: &Path| Ok(Default::default());
    let (models, _) = tobj::load_obj_buf(&mut reader, &options, no_materials)
        .map_err(|e| Error::file(path, format!("no OBJ, or it ends early: {e}; {AGAIN}")))?;
    let mut triangles = Vec::new();
    for mesh in models.iter().map(|m| &m.mesh) {
        if triangles.len() + mesh.indices.len() / 3 > most {
            return Err(too_many(path, most));
        }
        for corners in mesh.indices.chunks_exact(3) {
            let place = |index: u32| {
                let start = 3 * index as usize;
                mesh.positions.get(start..start + 3).map(|p| point([p[0], p[1], p[2]]))
            };
            let corner = |k: usize| {
                place(corners[k])
                    .ok_or_else(|| Error::file(path, format!("a face names a vertex that is not there; {AGAIN}")))
            };
            triangles.push([corner(0)?, corner(1)?, corner(2)?]);
        }
    }
    Ok(triangles)
}

fn point(p: [f32; 3]) -> Vec3<f64> {
    let [x, y, z] = p.map(f64::from);
    Vec3::new(x, y, z)
}

/// Normal vector with a length of twice the area.
fn cross([a, b, c]: &Triangle) -> Vec3<f64> {
    (*b - *a).cross(*c - *a)
}

/// [m²]
pub fn area(triangles: &[Triangle]) -> f64 {
    triangles.iter().map(|t| cross(t).norm_squared().sqrt() / 2.0).sum()
}

/// Longest side of the box around the mesh [m].
pub fn longest_side(triangles: &[Triangle]) -> f64 {
    let axis = |of: fn(&Vec3<f64>) -> f64| {
        let ends = triangles
            .iter()
            .flatten()
            .map(of)
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)]);
        ends[1] - ends[0]
    };
    axis(|p| p.x).max(axis(|p| p.y)).max(axis(|p| p.z))
}

/// Outward plates no longer than `size`; triangles that are longer are halved.
pub fn plates(path: &Path, triangles: &[Triangle], size: f64, most: usize) -> Result<Vec<IntruderPlate>> {
    let mut plates = halved_within(triangles, size, most)
        .ok_or_else(|| Error::file(path, format!("more than {most} plates: give a larger plate-size")))?;
    let open = plates.iter().fold(Vec3::zero(), |sum: Vec3<f64>, p| p.normal.scale_add(p.area, sum));
    if open.norm_squared().sqrt() > OPEN * plates_area(&plates) {
        return Err(Error::file(path, "the surface is not closed"));
    }
    if volume(&plates) < 0.0 {
        // The mesh is inside out: the corners of all its triangles are in the opposite order.
        plates.iter_mut().for_each(|p| p.normal = -p.normal);
    }
    Ok(plates)
}

/// Plates from triangles, halved until no side is longer than `size`; None if there would be too many.
pub fn halved(triangles: &[Triangle], size: f64) -> Option<Vec<IntruderPlate>> {
    halved_within(triangles, size, MOST_PLATES)
}

fn halved_within(triangles: &[Triangle], size: f64, most: usize) -> Option<Vec<IntruderPlate>> {
    let mut plates = Vec::new();
    let mut left: Vec<Triangle> = triangles.to_vec();
    while let Some(triangle) = left.pop() {
        let [a, b, c] = triangle;
        let sides = [(b - a).norm_squared(), (c - b).norm_squared(), (a - c).norm_squared()];
        let k = (0..3).fold(0, |k, i| if sides[i] > sides[k] { i } else { k });
        if sides[k] > size * size {
            let [p, q, r] = [triangle[k], triangle[(k + 1) % 3], triangle[(k + 2) % 3]];
            let middle = (p + q) * 0.5;
            left.extend([[p, middle, r], [middle, q, r]]);
        } else {
            let n = cross(&triangle);
            let length = n.norm_squared().sqrt();
            if length > 0.0 {
                let normal = n * (1.0 / length);
                let area = length / 2.0;
                let edge = (b - a) * (0.5 * area.sqrt() / (b - a).norm_squared().sqrt());
                let center = (a + b + c) * (1.0 / 3.0);
                plates.push(IntruderPlate { center, normal, area, half: [edge, normal.cross(edge)], bend: [0.0; 2] });
            }
        }
        if plates.len() + left.len() > most {
            return None;
        }
    }
    Some(plates)
}
