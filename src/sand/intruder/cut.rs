//! Round and square bodies cut into plates.

use super::IntruderPlate;
use crate::number::Vec3;
use std::f64::consts::{PI, TAU};

/// Fewest plates around a round body: our choice, because forces are then within 1 % at any size. The functions below
/// need a fixed part of this number in other directions: also our choice.
pub const FINE: usize = 16;

/// Number of pieces of at most `size`, at least `least`. 1e-9: a quotient just above an integer is a rounding error.
fn pieces(length: f64, size: f64, least: usize) -> usize {
    ((length / size - 1e-9).ceil() as usize).max(least)
}

/// A cylinder about y. Along the rim the plates are half as long as `size`, across it four times as wide, because on a
/// cylinder with a level axis the pressure changes along the rim and hardly across it.
pub fn cylinder(radius: f64, width: f64, size: f64, least: usize) -> Vec<IntruderPlate> {
    cylinder_across(radius, width, size, 4.0 * size, least)
}

/// The same as [`cylinder`], with plates whose width on the rim is `wide`.
pub fn cylinder_across(radius: f64, width: f64, size: f64, wide: f64, least: usize) -> Vec<IntruderPlate> {
    let (around, across) = (pieces(TAU * radius, size / 2.0, least), pieces(width, wide, least / 8));
    let mut plates = Vec::new();
    for i in 0..around {
        let (sin, cos) = ((i as f64 + 0.5) / around as f64 * TAU).sin_cos();
        let normal = Vec3::new(sin, 0.0, -cos);
        for j in 0..across {
            let y = width * ((j as f64 + 0.5) / across as f64 - 0.5);
            let center = Vec3::new(radius * sin, y, -radius * cos);
            plates.push(IntruderPlate {
                center,
                normal,
                area: TAU * radius * width / (around * across) as f64,
                half: [
                    Vec3::new(cos, 0.0, sin) * (PI * radius / around as f64),
                    Vec3::new(0.0, width / (2 * across) as f64, 0.0),
                ],
                bend: [1.0 / radius, 0.0],
            });
        }
    }
    let rings = pieces(radius, size, least / 4);
    for side in [-1.0, 1.0] {
        for ring in 0..rings {
            // The rings have equal areas and so are thin near the rim, which is the part in the sand.
            let [inner, outer] = [ring, ring + 1].map(|r| radius * (r as f64 / rings as f64).sqrt());
            let sectors = pieces(TAU * outer, size, 3 * least / 4);
            // Distance of a sector's centroid from the axis.
            let half = PI / sectors as f64;
            let at = 2.0 / 3.0 * half.sin() / half * (outer.powi(3) - inner.powi(3)) / (outer * outer - inner * inner);
            for k in 0..sectors {
                let (sin, cos) = ((k as f64 + 0.5) * 2.0 * half).sin_cos();
                let center = Vec3::new(at * sin, side * width / 2.0, -at * cos);
                let area = half * (outer * outer - inner * inner);
                let (outward, around) = (Vec3::new(sin, 0.0, -cos), Vec3::new(cos, 0.0, sin));
                plates.push(IntruderPlate {
                    center,
                    normal: Vec3::new(0.0, side, 0.0),
                    area,
                    half: [outward * ((outer - inner) / 2.0), around * (half * at)],
                    bend: [0.0; 2],
                });
            }
        }
    }
    plates
}

/// A cylinder about y between two half balls. `length` is that of the cylinder alone. The plates are two thirds as long
/// as `size`, as on a [`sphere`]; along the cylinder twice that, because it is straight there.
pub fn capsule(radius: f64, length: f64, size: f64, least: usize) -> Vec<IntruderPlate> {
    let mut plates = Vec::new();
    let size = size / 1.5;
    // Equally many bands on both halves.
    for plate in ball(radius, size, 2 * pieces(PI * radius / 2.0, size, least / 4), least / 2) {
        // The ball's axis, z, becomes y.
        let turned = |v: Vec3<f64>| Vec3::new(v.x, v.z, -v.y);
        let center = turned(plate.center);
        let end = Vec3::new(0.0, length / 2.0 * center.y.signum(), 0.0);
        plates.push(IntruderPlate {
            center: center + end,
            normal: turned(plate.normal),
            half: plate.half.map(turned),
            ..plate
        });
    }
    let (around, across) = (pieces(TAU * radius, size, least / 2), pieces(length, 2.0 * size, 1));
    for i in 0..around {
        let (sin, cos) = ((i as f64 + 0.5) / around as f64 * TAU).sin_cos();
        for j in 0..across {
            let y = length * ((j as f64 + 0.5) / across as f64 - 0.5);
            plates.push(IntruderPlate {
                center: Vec3::new(radius * sin, y, -radius * cos),
                normal: Vec3::new(sin, 0.0, -cos),
                area: TAU * radius * length / (around * across) as f64,
                half: [
                    Vec3::new(cos, 0.0, sin) * (PI * radius / around as f64),
                    Vec3::new(0.0, length / (2 * across) as f64, 0.0),
                ],
                bend: [1.0 / radius, 0.0],
            });
        }
    }
    plates
}

/// Bands of equal width in latitude; plates two thirds as long as `size`, because the normal turns along both sides.
pub fn sphere(radius: f64, size: f64, least: usize) -> Vec<IntruderPlate> {
    let size = size / 1.5;
    ball(radius, size, pieces(PI * radius, size, least / 2), least / 2)
}

fn ball(radius: f64, size: f64, bands: usize, least: usize) -> Vec<IntruderPlate> {
    let mut plates = Vec::new();
    for band in 0..bands {
        let [low, high] = [band, band + 1].map(|b| -(PI * b as f64 / bands as f64).cos());
        // The band's mean height and its distance from the axis there. With these the plates enclose the sphere's
        // volume.
        let z = (low + high) / 2.0;
        let across = (1.0 - z * z).sqrt();
        let sectors = pieces(TAU * radius * across, size, least);
        for k in 0..sectors {
            let (sin, cos) = ((k as f64 + 0.5) / sectors as f64 * TAU).sin_cos();
            let normal = Vec3::new(across * cos, across * sin, z);
            let area = TAU * radius * radius * (high - low) / sectors as f64;
            let up = Vec3::new(-z * cos, -z * sin, across);
            let around = Vec3::new(-sin, cos, 0.0);
            plates.push(IntruderPlate {
                center: normal * radius,
                normal,
                area,
                half: [up * (PI * radius / (2 * bands) as f64), around * (PI * radius * across / sectors as f64)],
                bend: [1.0 / radius; 2],
            });
        }
    }
    plates
}

/// The corners of a box about the origin.
pub fn box_corners(length: f64, width: f64, height: f64) -> Vec<Vec3<f64>> {
    let ends = [-0.5, 0.5];
    let corner = |i: usize| Vec3::new(ends[i & 1] * length, ends[i >> 1 & 1] * width, ends[i >> 2] * height);
    (0..8).map(corner).collect()
}

/// A box with sides along x, y and z.
pub fn cuboid(length: f64, width: f64, height: f64, size: f64, least: usize) -> Vec<IntruderPlate> {
    let sides = [length, width, height];
    let counts = sides.map(|s| pieces(s, size, least / 4));
    let mut plates = Vec::new();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for side in [-1.0, 1.0] {
            let mut normal = [0.0; 3];
            normal[axis] = side;
            for i in 0..counts[u] {
                for j in 0..counts[v] {
                    let mut center = [0.0; 3];
                    center[axis] = side * sides[axis] / 2.0;
                    center[u] = sides[u] * ((i as f64 + 0.5) / counts[u] as f64 - 0.5);
                    center[v] = sides[v] * ((j as f64 + 0.5) / counts[v] as f64 - 0.5);
                    let area = sides[u] * sides[v] / (counts[u] * counts[v]) as f64;
                    let half = [u, v].map(|k| {
                        let mut half = [0.0; 3];
                        half[k] = sides[k] / (2 * counts[k]) as f64;
                        vector(half)
                    });
                    plates.push(IntruderPlate {
                        center: vector(center),
                        normal: vector(normal),
                        area,
                        half,
                        bend: [0.0; 2],
                    });
                }
            }
        }
    }
    plates
}

fn vector([x, y, z]: [f64; 3]) -> Vec3<f64> {
    Vec3::new(x, y, z)
}
