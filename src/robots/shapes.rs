//! Collision shapes that need conversion: open meshes and ellipsoids.

use super::mesh::{Closed, MeshFile, Meshes, Triangle, closed};
use super::notes::Notes;
use crate::error::{Error, Result};
use crate::sim::tree::Geometry;
use nalgebra::Vector3;
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

/// Bands of an ellipsoid between its poles: our choice, because the error of its volume is then below 0.5 %.
const BANDS: usize = 32;

/// A mesh that sand can push on: itself if its surface is closed, otherwise its convex hull, with a note.
pub fn collision_mesh(meshes: &mut Meshes, file: &MeshFile, notes: &mut Notes) -> Result<Geometry> {
    let name = file.path.file_name().unwrap_or_default().to_string_lossy();
    let closed = closed_mesh(&name, meshes.scaled(file)?, notes);
    closed.ok_or_else(|| Error::file(&file.path, "the mesh is flat: it has no volume"))
}

/// The same as [`collision_mesh`], for given triangles; None if they are flat.
pub fn closed_mesh(name: &str, triangles: Arc<Vec<Triangle>>, notes: &mut Notes) -> Option<Geometry> {
    Some(Geometry::Mesh(match closed(&triangles) {
        Closed::Itself => triangles,
        Closed::Turned(turned) => {
            notes.part("mesh", name, "the surface is inside out; it was turned");
            Arc::new(turned)
        }
        Closed::Hull(hull) => {
            notes.part("mesh", name, "the surface is not closed; its convex hull takes its place");
            Arc::new(hull)
        }
        Closed::Nothing => return None,
    }))
}

/// Triangles of an ellipsoid with these half axes.
pub fn ellipsoid(half: Vector3<f64>) -> Geometry {
    let point = |band: usize, sector: usize| {
        let (up, around) = (PI * band as f64 / BANDS as f64, TAU * sector as f64 / (2 * BANDS) as f64);
        // The last sector ends at exactly the corner where the first sector begins.
        let around = if sector == 2 * BANDS { 0.0 } else { around };
        let (sin, cos) = up.sin_cos();
        let ring = if band == 0 || band == BANDS { 0.0 } else { sin };
        Vector3::new(ring * around.cos(), ring * around.sin(), -cos).component_mul(&half)
    };
    let mut triangles = Vec::new();
    for band in 0..BANDS {
        for sector in 0..2 * BANDS {
            let [a, b] = [point(band, sector), point(band, sector + 1)];
            let [d, c] = [point(band + 1, sector), point(band + 1, sector + 1)];
            if band > 0 {
                triangles.push([a, b, c]);
            }
            if band + 1 < BANDS {
                triangles.push([a, c, d]);
            }
        }
    }
    Geometry::Mesh(Arc::new(triangles))
}
