//! Gathers a mesh of many small triangles into fewer plates of a chosen size.

use super::{IntruderPlate, Triangle, mesh};
use crate::number::Vec3;
use std::collections::BTreeMap;

/// Plates are sorted by their direction into cells on the six faces of a cube. This is the number of cells along a side
/// of a face, so there are 6 × 6² cells. Our choice, because a cell is 15° wide, and the normals in a plate differ
/// little.
const DIRECTIONS: f64 = 6.0;

/// Sums over the triangles of a plate.
#[derive(Default, Clone, Copy)]
struct PlateSum {
    area: f64,
    /// Σ A n, Σ A c and Σ A c·n of the triangles.
    directed: [f64; 3],
    place: [f64; 3],
    volume: f64,
}

/// Outward plates of about `size` from a closed surface, with its area and volume. Triangles longer than this are
/// halved. Triangles in the same cell with similar normals become one plate. None if there would be too many.
pub fn gathered(triangles: &[Triangle], size: f64) -> Option<Vec<IntruderPlate>> {
    let corners = triangles.iter().flatten();
    let [low, high] = corners.fold([[f64::MAX; 3], [f64::MIN; 3]], |[low, high], p| {
        let at = p.lane(0);
        [std::array::from_fn(|k| low[k].min(at[k])), std::array::from_fn(|k| high[k].max(at[k]))]
    });
    // A whole number of cells along each side.
    let cells: [f64; 3] = std::array::from_fn(|k| ((high[k] - low[k]) / size).ceil().max(1.0));
    let middle = Vec3::splat(std::array::from_fn(|k| (low[k] + high[k]) / 2.0));
    let mut sums: BTreeMap<([u32; 3], [u8; 3]), PlateSum> = BTreeMap::new();
    for plate in mesh::halved(triangles, size)? {
        let (at, n) = (plate.center.lane(0), plate.normal.lane(0));
        let cell = std::array::from_fn(|k| {
            let share = (at[k] - low[k]) / (high[k] - low[k]).max(f64::MIN_POSITIVE);
            (share * cells[k]).clamp(0.0, cells[k] - 1.0) as u32
        });
        let sum = sums.entry((cell, direction(n))).or_default();
        sum.area += plate.area;
        for k in 0..3 {
            sum.directed[k] += plate.area * n[k];
            sum.place[k] += plate.area * at[k];
        }
        sum.volume += plate.area * (plate.center - middle).dot(plate.normal);
    }
    Some(sums.values().filter_map(|sum| sum.plate(middle)).collect())
}

/// The face of a cube that a normal passes through, and the position on it.
fn direction(n: [f64; 3]) -> [u8; 3] {
    let axis = (0..3).fold(0, |a, k| if n[k].abs() > n[a].abs() { k } else { a });
    let on = |k: usize| {
        // Equal angles; the edge of the face is at tan 45° = 1.
        let along = (n[(axis + k) % 3] / n[axis].abs()).atan() / std::f64::consts::FRAC_PI_4;
        ((along + 1.0) / 2.0 * DIRECTIONS).clamp(0.0, DIRECTIONS - 1.0) as u8
    };
    [2 * axis as u8 + u8::from(n[axis] > 0.0), on(1), on(2)]
}

impl PlateSum {
    /// None if the triangles' normals cancel, except for rounding errors.
    fn plate(&self, middle: Vec3<f64>) -> Option<IntruderPlate> {
        let directed = Vec3::<f64>::splat(self.directed);
        let length = directed.norm_squared().sqrt();
        if length <= 1e-9 * self.area {
            return None;
        }
        let normal = directed * (1.0 / length);
        let center = Vec3::<f64>::splat(self.place) * (1.0 / self.area);
        // Moves the plate along its normal until it encloses the same volume as its triangles.
        let out = self.volume / self.area - (center - middle).dot(normal);
        let half = 0.5 * self.area.sqrt();
        let n = normal.lane(0);
        let beside = if n[2].abs() < 0.9 { Vec3::new(0.0, 0.0, 1.0) } else { Vec3::new(1.0, 0.0, 0.0) };
        let across = normal.cross(beside);
        let across = across * (half / across.norm_squared().sqrt());
        // Normals that turn evenly by ±a along both sides of a square have a mean that is shorter than 1 by a²/3.
        let turn = (3.0 * (1.0 - length / self.area).max(0.0)).sqrt();
        let (half, bend) = ([across, normal.cross(across)], [turn / half; 2]);
        Some(IntruderPlate { center: normal.scale_add(out, center), normal, area: self.area, half, bend })
    }
}
