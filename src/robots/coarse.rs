//! Makes small meshes from large ones, for pictures: all corners in a cell become one corner, at the point that
//! preserves the surface best (vertex clustering with quadrics, Lindstrom 2000).

use super::mesh::Triangle;
use crate::sim::tree::{Geometry, TreeShape};
use nalgebra::{Matrix3, Vector3};
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

/// Number of times that the range of cell sizes is halved: our choice, because this determines the size to 0.02 %.
const ROUNDS: usize = 16;
/// Singular values below this share of the largest are zero: Lindstrom's 1e-3.
const FLAT: f64 = 1e-3;

/// The same shapes with at most `most` triangles in all meshes together, each mesh counted once. All meshes lose the
/// same detail: the cells have one size.
pub fn coarse(bodies: &[Vec<TreeShape>], most: usize) -> Vec<Vec<TreeShape>> {
    let mut meshes: Vec<&Arc<Vec<Triangle>>> = Vec::new();
    for shape in bodies.iter().flatten() {
        if let Geometry::Mesh(triangles) = &shape.geometry
            && !meshes.iter().any(|m| Arc::ptr_eq(m, triangles))
        {
            meshes.push(triangles);
        }
    }
    let small = together(&meshes, most);
    let replaced = |shape: &TreeShape| {
        let mut shape = shape.clone();
        if let Geometry::Mesh(old) = &shape.geometry
            && let Some(i) = meshes.iter().position(|m| Arc::ptr_eq(m, old))
        {
            shape.geometry = Geometry::Mesh(small[i].clone());
        }
        shape
    };
    bodies.iter().map(|shapes| shapes.iter().map(replaced).collect()).collect()
}

fn together(meshes: &[&Arc<Vec<Triangle>>], most: usize) -> Vec<Arc<Vec<Triangle>>> {
    if meshes.iter().map(|m| m.len()).sum::<usize>() <= most {
        return meshes.iter().map(|m| Arc::clone(m)).collect();
    }
    let extent = meshes.iter().flat_map(|m| m.iter()).flatten().map(|p| p.amax()).fold(0.0, f64::max);
    // The size is searched on a logarithmic scale. Our choice of its ends: the smallest cells change no picture, and of
    // the largest a mesh has at most eight.
    let (mut low, mut high) = ((1e-4 * extent).ln(), (4.0 * extent).ln());
    for _ in 0..ROUNDS {
        let middle = (low + high) / 2.0;
        let count: usize = meshes.iter().map(|m| faces(m, middle.exp()).len()).sum();
        if count > most { low = middle } else { high = middle }
    }
    meshes.iter().map(|m| Arc::new(clustered(m, high.exp()))).collect()
}

type GridCell = [i64; 3];

fn cell(p: &Vector3<f64>, size: f64) -> GridCell {
    [p.x, p.y, p.z].map(|x| (x / size).floor() as i64)
}

/// Triangles with corners in three different cells, each set of cells once for each winding.
fn faces(triangles: &[Triangle], size: f64) -> HashSet<[GridCell; 3]> {
    let mut kept = HashSet::new();
    for triangle in triangles {
        let [a, b, c] = triangle.map(|p| cell(&p, size));
        if a != b && b != c && c != a {
            // The smallest cell comes first, so that equal faces have equal keys.
            kept.insert(if a < b && a < c {
                [a, b, c]
            } else if b < c {
                [b, c, a]
            } else {
                [c, a, b]
            });
        }
    }
    kept
}

/// Sum over the triangles at a cell: their planes as a quadric (A, b), and their corners in the cell.
#[derive(Default)]
struct Quadric {
    a: Matrix3<f64>,
    b: Vector3<f64>,
    corners: Vector3<f64>,
    count: f64,
}

impl Quadric {
    /// The point with the least squared distance from all planes. In directions that the planes do not determine, the
    /// point stays at the mean corner. If the point is farther than `size` from the mean corner, the mean corner is
    /// returned.
    fn point(&self, size: f64) -> Vector3<f64> {
        let mean = self.corners / self.count;
        let svd = self.a.svd(true, true);
        let least = FLAT * svd.singular_values.max();
        let Ok(shift) = svd.solve(&(self.b - self.a * mean), least.max(f64::MIN_POSITIVE)) else { return mean };
        if shift.norm() < size { mean + shift } else { mean }
    }
}

fn clustered(triangles: &[Triangle], size: f64) -> Vec<Triangle> {
    let mut quadrics: HashMap<GridCell, Quadric> = HashMap::new();
    for triangle in triangles {
        let [p, q, r] = triangle;
        // The normal's length is twice the area, so large triangles count more.
        let normal = (q - p).cross(&(r - p));
        for corner in triangle {
            let quadric = quadrics.entry(cell(corner, size)).or_default();
            quadric.a += normal * normal.transpose();
            quadric.b += normal * normal.dot(p);
            quadric.corners += corner;
            quadric.count += 1.0;
        }
    }
    let points: HashMap<GridCell, Vector3<f64>> = quadrics.iter().map(|(cell, q)| (*cell, q.point(size))).collect();
    let mut kept: Vec<[GridCell; 3]> = faces(triangles, size).into_iter().collect();
    // A robot's text must not depend on the order of a hash.
    kept.sort_unstable();
    kept.into_iter().map(|face| face.map(|cell| points[&cell])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes;
    use nalgebra::Isometry3;

    fn shape(geometry: Geometry) -> TreeShape {
        TreeShape { name: "shape".into(), origin: Isometry3::identity(), geometry, friction: 1.0 }
    }

    /// An ellipsoid of 4000 triangles that is reduced to a few hundred keeps its size and volume; a shared mesh stays shared.
    #[test]
    fn a_coarse_mesh_has_the_same_shape() {
        let fine = shapes::ellipsoid(Vector3::new(0.2, 0.1, 0.05));
        let bodies =
            vec![vec![shape(fine.clone())], vec![shape(fine.clone()), shape(Geometry::Sphere { radius: 1.0 })]];
        let small = coarse(&bodies, 500);
        let Geometry::Mesh(triangles) = &small[0][0].geometry else { panic!() };
        assert!((300..=500).contains(&triangles.len()), "{}", triangles.len());
        assert!(matches!(&small[1][0].geometry, Geometry::Mesh(other) if Arc::ptr_eq(other, triangles)));
        assert_eq!(small[1][1], bodies[1][1]);
        let ratio = small[0][0].geometry.volume() / fine.volume();
        assert!((ratio - 1.0).abs() < 0.05, "{ratio}");
        for k in 0..3 {
            let most = triangles.iter().flatten().map(|p| p[k]).fold(0.0, f64::max);
            assert!((most / [0.2, 0.1, 0.05][k] - 1.0).abs() < 0.1, "{k}: {most}");
        }
        assert_eq!(coarse(&bodies, 500), small);
        assert_eq!(coarse(&bodies, 5000), bodies, "small ones stay as they are");
    }
}
