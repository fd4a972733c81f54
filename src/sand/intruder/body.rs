//! Bodies by name: `cylinder:radius=0.06,width=0.06`, `box:…`, `sphere:…`, or a mesh file.

use super::{IntruderPlate, Triangle, area, cut, mesh, volume};
use crate::error::{Error, Result, check_range};
use crate::number::Vec3;
use std::path::{Path, PathBuf};

/// Allowed lengths of bodies [m]: our choice, which catches wrong units.
const LENGTHS: std::ops::RangeInclusive<f64> = 1e-4..=10.0;
/// Number of plates along a body's longest side, unless the user gives a size. Our choice: forces then differ by at
/// most 1 % from forces with plates ten times finer.
const ALONG: f64 = 50.0;

/// A body before it is cut into plates.
#[derive(Clone, Debug, PartialEq)]
pub enum BodyShape {
    /// Axis along y [m].
    Cylinder {
        radius: f64,
        width: f64,
    },
    /// Sides along x, y and z [m].
    Box {
        length: f64,
        width: f64,
        height: f64,
    },
    Sphere {
        radius: f64,
    },
    /// STL or OBJ, in metres.
    Mesh(PathBuf),
}

impl BodyShape {
    pub fn named(text: &str) -> Result<Self> {
        let (kind, sizes) = text.split_once(':').unwrap_or((text, ""));
        let read = |names: &[&str]| sizes_of(text, sizes, names);
        match kind {
            "cylinder" => read(&["radius", "width"]).map(|s| Self::Cylinder { radius: s[0], width: s[1] }),
            "box" => {
                read(&["length", "width", "height"]).map(|s| Self::Box { length: s[0], width: s[1], height: s[2] })
            }
            "sphere" => read(&["radius"]).map(|s| Self::Sphere { radius: s[0] }),
            _ => {
                let end = Path::new(text).extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
                match end.as_deref() {
                    Some("stl" | "obj") => Ok(Self::Mesh(text.into())),
                    _ => Err(Error::unknown(
                        "body",
                        text,
                        &[
                            "cylinder:radius=M,width=M",
                            "box:length=M,width=M,height=M",
                            "sphere:radius=M",
                            "FILE.stl",
                            "FILE.obj",
                        ],
                    )),
                }
            }
        }
    }
}

/// `name=value,…` in any order; each name once.
pub fn sizes_of(text: &str, sizes: &str, names: &[&str]) -> Result<Vec<f64>> {
    let wrong = |reason: String| Error::invalid("body", format!("{text:?}: {reason}"));
    let mut values = vec![None; names.len()];
    for part in sizes.split(',').filter(|p| !p.is_empty()) {
        let (name, value) = part.split_once('=').ok_or_else(|| wrong(format!("{part:?} is not name=value")))?;
        let Some(index) = names.iter().position(|n| *n == name.trim()) else {
            return Err(wrong(format!("{name:?} is not one of {}", names.join(", "))));
        };
        let number = value.trim().parse::<f64>().map_err(|_| wrong(format!("{value:?} is no number")))?;
        if values[index].replace(check_range(name.trim(), number, LENGTHS)?).is_some() {
            return Err(wrong(format!("{name} is given twice")));
        }
    }
    let missing = || names.iter().zip(&values).filter(|(_, v)| v.is_none()).map(|(n, _)| *n).collect::<Vec<_>>();
    values.iter().copied().collect::<Option<Vec<_>>>().ok_or_else(|| wrong(format!("{} missing", missing().join(", "))))
}

/// Sorts plates by the height of their lower edge.
fn rising(mut plates: Vec<IntruderPlate>) -> Vec<IntruderPlate> {
    plates.sort_by(|a, b| (a.center.z - a.rise()).total_cmp(&(b.center.z - b.rise())));
    plates
}

/// A body cut into plates.
#[derive(Clone, Debug)]
pub struct PlatedBody {
    /// Plates of a body at rest or turning about y, lowest first.
    pub plates: Vec<IntruderPlate>,
    /// Plates of a body that turns about another axis, if they differ from `plates`; otherwise empty.
    turning: Vec<IntruderPlate>,
    /// Points whose convex hull contains all plates; the lowest one is the body's lowest point.
    corners: Corners,
    /// Size of the plates [m].
    pub plate_size: f64,
    /// Number of positions in one period over which the force is averaged.
    turns: usize,
}

/// Number of positions for each plate along the longest side: our choice. With 96 positions in a period forces differ by at
/// most 1 % from forces with 400; with plates half as long and twice as many positions, by at most 0.3 %.
const TURNS: f64 = 1.92;
/// Least and largest number of positions: our choice, because fewer positions are inaccurate and more take too long.
const FEWEST_TURNS: usize = 48;
const MOST_TURNS: usize = 384;
/// Largest number of plates in all positions together: our choice; with as many, the search for a load takes 300 MB.
const MOST_TURNED: usize = 2_500_000;

/// Number of positions in a period, for a body of `plates` plates, `along` of them along its longest side.
fn turns(along: f64, plates: usize) -> usize {
    let most = (MOST_TURNED / plates.max(1)).clamp(FEWEST_TURNS, MOST_TURNS);
    ((TURNS * along).round() as usize).clamp(FEWEST_TURNS, most)
}

/// The points among which the lowest point is searched.
#[derive(Clone, Debug)]
enum Corners {
    Sphere(f64),
    /// Radius and half the width.
    Cylinder(f64, f64),
    Points(Vec<Vec3<f64>>),
}

impl PlatedBody {
    pub const MOST_PLATES: usize = mesh::MOST_PLATES;

    /// Cuts a body into plates of about `size` [m]; None: a fiftieth of its longest side.
    pub fn cut(shape: &BodyShape, size: Option<f64>) -> Result<Self> {
        Self::cut_within(shape, size, mesh::MOST_PLATES)
    }

    /// The same as [`Self::cut`], with at most `most` plates.
    pub fn cut_within(shape: &BodyShape, size: Option<f64>, most: usize) -> Result<Self> {
        let (corners, longest, surface) = match *shape {
            BodyShape::Cylinder { radius, width } => {
                let surface = std::f64::consts::TAU * radius * (radius + width);
                (Corners::Cylinder(radius, width / 2.0), width.max(2.0 * radius), surface)
            }
            BodyShape::Sphere { radius } => {
                (Corners::Sphere(radius), 2.0 * radius, 2.0 * std::f64::consts::TAU * radius * radius)
            }
            BodyShape::Box { length, width, height } => (
                Corners::Points(cut::box_corners(length, width, height)),
                length.max(width).max(height),
                2.0 * (length * width + width * height + height * length),
            ),
            BodyShape::Mesh(ref path) => return Self::of_triangles(path, mesh::read(path)?, size, most),
        };
        let size = size_within(size, longest, surface, most)?;
        let plates = match *shape {
            BodyShape::Cylinder { radius, width } => cut::cylinder(radius, width, size, cut::FINE),
            BodyShape::Sphere { radius } => cut::sphere(radius, size, cut::FINE),
            BodyShape::Box { length, width, height } => cut::cuboid(length, width, height, size, cut::FINE),
            BodyShape::Mesh(_) => Vec::new(),
        };
        let turning = match *shape {
            // The two ends of the rim enter the sand at different times.
            BodyShape::Cylinder { radius, width } => cut::cylinder_across(radius, width, size, size, cut::FINE),
            _ => Vec::new(),
        };
        let turns = turns(longest / size, plates.len().max(turning.len()));
        Ok(Self { plates: rising(plates), turning, corners, plate_size: size, turns })
    }

    /// A mesh from the `bytes` of its file: STL or OBJ, by the ending of `path`.
    pub fn of_mesh(path: &Path, bytes: &[u8], size: Option<f64>, most: usize) -> Result<Self> {
        Self::of_triangles(path, mesh::read_bytes(path, bytes, most)?, size, most)
    }

    fn of_triangles(path: &Path, triangles: Vec<Triangle>, size: Option<f64>, most: usize) -> Result<Self> {
        let longest = mesh::longest_side(&triangles);
        check_range("body", longest, LENGTHS)
            .map_err(|_| Error::file(path, format!("{longest:e} m is outside [1e-4, 10] m: meshes are in metres")))?;
        let size = size_within(size, longest, mesh::area(&triangles), most)?;
        let plates = rising(mesh::plates(path, &triangles, size, most)?);
        let points = triangles.into_iter().flatten().collect();
        let turns = turns(longest / size, plates.len());
        Ok(Self { plates, turning: Vec::new(), corners: Corners::Points(points), plate_size: size, turns })
    }

    /// The same body scaled by `factor`, in as many plates.
    pub fn scaled(&self, factor: f64) -> Self {
        let plate = |p: &IntruderPlate| IntruderPlate {
            center: p.center * factor,
            normal: p.normal,
            area: p.area * factor * factor,
            half: p.half.map(|h| h * factor),
            bend: p.bend.map(|b| b / factor),
        };
        let corners = match &self.corners {
            Corners::Sphere(radius) => Corners::Sphere(radius * factor),
            Corners::Cylinder(radius, half) => Corners::Cylinder(radius * factor, half * factor),
            Corners::Points(points) => Corners::Points(points.iter().map(|p| *p * factor).collect()),
        };
        Self {
            plates: self.plates.iter().map(plate).collect(),
            turning: self.turning.iter().map(plate).collect(),
            corners,
            plate_size: self.plate_size * factor,
            turns: self.turns,
        }
    }

    /// Plates of a body that turns about any axis.
    pub fn turning(&self) -> &[IntruderPlate] {
        if self.turning.is_empty() { &self.plates } else { &self.turning }
    }

    /// Number of positions in one period over which the force is averaged.
    pub fn turns(&self) -> usize {
        self.turns
    }

    /// [m³]
    pub fn volume(&self) -> f64 {
        volume(&self.plates)
    }

    /// [m²]
    pub fn area(&self) -> f64 {
        area(&self.plates)
    }

    /// Does every rotation about `axis` (unit, with rounding errors) leave the body unchanged?
    pub fn is_round_about(&self, axis: Vec3<f64>) -> bool {
        match self.corners {
            Corners::Sphere(_) => true,
            Corners::Cylinder(..) => axis.y.abs() > 1.0 - 1e-12,
            Corners::Points(_) => false,
        }
    }

    /// Least and greatest height [m] of the body's points above the origin.
    pub fn heights(&self) -> [f64; 2] {
        match &self.corners {
            Corners::Sphere(radius) | Corners::Cylinder(radius, _) => [-radius, *radius],
            Corners::Points(points) => {
                points.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], p| [low.min(p.z), high.max(p.z)])
            }
        }
    }

    /// The same as [`Self::heights`], over a whole turn about `axis` (unit), in which each point moves on a circle.
    pub fn heights_in_turn(&self, axis: Vec3<f64>) -> [f64; 2] {
        let level = (1.0 - axis.z * axis.z).max(0.0).sqrt();
        match &self.corners {
            Corners::Sphere(radius) => [-radius, *radius],
            Corners::Cylinder(radius, half) => {
                // During a turn the vertical component of the cylinder's axis (unit vector) takes every value from
                // `least` to `most`, except for its sign. A change of the sign only mirrors the cylinder.
                let (middle, swing) = ((axis.y * axis.z).abs(), (1.0 - axis.y * axis.y).max(0.0).sqrt() * level);
                let (least, most) = ((middle - swing).max(0.0), middle + swing);
                let steepest = half / radius.hypot(*half);
                let rise = steepest.clamp(least, most);
                let reach = half * rise + radius * (1.0 - rise * rise).max(0.0).sqrt();
                [-reach, reach]
            }
            Corners::Points(points) => points.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], p| {
                let along = axis.dot(*p);
                let around = (p.norm_squared() - along * along).max(0.0).sqrt() * level;
                [low.min(along * axis.z - around), high.max(along * axis.z + around)]
            }),
        }
    }
}

/// The requested or default plate size; an error if it makes too many plates. 1 % is a margin for rounding: our choice.
fn size_within(asked: Option<f64>, longest: f64, surface: f64, most: usize) -> Result<f64> {
    let size = asked.unwrap_or(longest / ALONG);
    let least = (surface / most as f64).sqrt() * 1.01;
    check_range("plate-size", size, least..=longest)
}
