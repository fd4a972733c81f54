//! An image of any robot: every visible triangle, with a depth buffer.

use super::camera::{Camera, CameraOptions, check_size};
use super::png::png;
use super::raster::{LIGHT, PixelRows, RasterTriangle, Rgb, SAMPLES};
use super::text;
use crate::error::Result;
use crate::sand::intruder::IntruderPlate;
use crate::sim::State;
use crate::sim::frame::V;
use crate::sim::tree::kinematics::{chain, frames};
use crate::sim::tree::{Geometry, Tree, TreeShape};
use nalgebra::Isometry3;
use std::f64::consts::TAU;

const SKY: [Rgb; 2] = [[226.0, 234.0, 241.0], [247.0, 246.0, 242.0]];
const SAND: Rgb = [226.0, 209.0, 175.0];
pub(super) const BASE: Rgb = [120.0, 128.0, 140.0];
pub(super) const LINKS: [Rgb; 4] =
    [[70.0, 130.0, 180.0], [112.0, 164.0, 112.0], [176.0, 136.0, 84.0], [150.0, 116.0, 160.0]];
const PLATES: Rgb = [214.0, 84.0, 40.0];
const INK: [u8; 3] = [40, 44, 50];
/// Number of sides of round shapes: our choice.
const SIDES: usize = 32;
/// Distance at which plates are drawn outside their surface, in robot radii, so that the surface does not hide
/// them.
const BEFORE: f64 = 2e-3;
/// Width of a plate's outline, in robot radii: our choice, about a pixel of a picture of 800 × 600. The next number is
/// its greatest share of half the plate, so that small plates stay outlines.
const LINE: f64 = 4e-3;
const WIDEST: f64 = 0.2;

/// A PNG of `size` [px] that shows `tree` in its standing pose with its lowest point on the ground, or at `state` with
/// the ground at z = 0. `seen` (visual shapes) and `plates` have one list for each body, in the frame of the body.
///
/// # Errors
/// Names the side that is out of range, or the camera's value that is out of its range.
pub fn draw(
    tree: &Tree,
    seen: &[Vec<TreeShape>],
    plates: &[Vec<IntruderPlate>],
    state: Option<&State>,
    size: [u32; 2],
    camera: &CameraOptions,
    captions: &[String],
) -> Result<Vec<u8>> {
    check_size(size)?;
    let angles: Vec<f64> = tree.joints().map(|j| j.rest.unwrap_or(0.0)).collect();
    let frames = match state {
        Some(state) => frames(tree, state),
        None => chain(tree, Isometry3::identity(), &angles),
    };
    let mut faces = Vec::new();
    for (b, shapes) in seen.iter().enumerate() {
        let color = if b == 0 { BASE } else { LINKS[depth(tree, b) % LINKS.len()] };
        for shape in shapes {
            let at = frames[b] * shape.origin;
            let all = triangles(&shape.geometry, |mesh| mesh.to_vec());
            faces.extend(all.iter().map(|t| (t.map(|p| (at * nalgebra::Point3::from(p)).coords), color)));
        }
    }
    let corners = faces.iter().flat_map(|f| f.0);
    let [low, high] = corners.fold([V::repeat(f64::MAX), V::repeat(f64::MIN)], |[a, b], p| [a.inf(&p), b.sup(&p)]);
    let [low, high] = if faces.is_empty() { [V::repeat(-0.1), V::repeat(0.1)] } else { [low, high] };
    let radius = (0.5 * (high - low).norm()).max(1e-3);
    for (b, plates) in plates.iter().enumerate() {
        faces.extend(plates.iter().flat_map(|p| outline(p, &frames[b], radius)).map(|t| (t, PLATES)));
    }
    let samples = size.map(|s| s * SAMPLES as u32);
    let camera = Camera::around(&camera.check()?, (low + high) / 2.0, 0.72 * radius, samples);
    let mut canvas = TreeCanvas::new(samples, camera, if state.is_some() { 0.0 } else { low.z });
    canvas.ground(&faces, radius);
    for (corners, color) in &faces {
        canvas.triangle(corners, *color);
    }
    canvas.png(size, captions)
}

/// Number of joints between a body and the base.
pub(super) fn depth(tree: &Tree, body: usize) -> usize {
    let (mut at, mut depth) = (body, 0);
    while tree.bodies[at].parent > 0 {
        at = tree.bodies[at].parent;
        depth += 1;
    }
    depth
}

/// The thin outline of a plate, so that the robot behind it is seen; `radius`: the robot's.
fn outline(plate: &IntruderPlate, frame: &Isometry3<f64>, radius: f64) -> Vec<[V; 3]> {
    let vector = |v: crate::number::Vec3<f64>| frame.rotation * V::from(v.lane(0));
    let center = frame * nalgebra::Point3::from(V::from(plate.center.lane(0)));
    let middle = center.coords + vector(plate.normal) * (BEFORE * radius);
    // Drawn slightly smaller, so that the outlines of neighbours are apart.
    let halves = plate.half.map(|h| vector(h) * 0.9);
    let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
    let inner = halves.map(|half| 1.0 - (LINE * radius / half.norm().max(f64::MIN_POSITIVE)).min(WIDEST));
    let at = |[u, v]: [f64; 2], [a, b]: [f64; 2]| middle + halves[0] * (u * a) + halves[1] * (v * b);
    let strip = |k: usize| {
        let (one, two) = (corners[k], corners[(k + 1) % 4]);
        let [a, b, c, d] = [at(one, [1.0; 2]), at(two, [1.0; 2]), at(two, inner), at(one, inner)];
        [[a, b, c], [a, c, d]]
    };
    (0..4).flat_map(strip).collect()
}

/// Triangles of a round shape from its profile along z: (distance from the axis, height), from below.
fn turned(profile: &[[f64; 2]]) -> Vec<[V; 3]> {
    let at = |[r, z]: [f64; 2], k: usize| {
        let (sin, cos) = (TAU * (k % SIDES) as f64 / SIDES as f64).sin_cos();
        V::new(r * cos, r * sin, z)
    };
    let mut faces = Vec::new();
    for pair in profile.windows(2) {
        for k in 0..SIDES {
            let [a, b] = [at(pair[0], k), at(pair[0], k + 1)];
            let [d, c] = [at(pair[1], k), at(pair[1], k + 1)];
            faces.extend([[a, b, c], [a, c, d]]);
        }
    }
    faces
}

/// The triangles of a shape; `of_mesh` gives the triangles of a mesh.
pub(super) fn triangles<M>(geometry: &Geometry<M>, of_mesh: impl Fn(&M) -> Vec<[V; 3]>) -> Vec<[V; 3]> {
    let arc = |radius: f64, lift: f64, from: usize, to: usize| {
        let steps = SIDES / 2;
        (from..=to).map(move |k| {
            let (sin, cos) = (TAU / 2.0 * k as f64 / steps as f64).sin_cos();
            [radius * sin, lift - radius * cos]
        })
    };
    match geometry {
        Geometry::Sphere { radius } => turned(&arc(*radius, 0.0, 0, SIDES / 2).collect::<Vec<_>>()),
        Geometry::Capsule { radius, half_length } => {
            let low = arc(*radius, -half_length, 0, SIDES / 4);
            turned(&low.chain(arc(*radius, *half_length, SIDES / 4, SIDES / 2)).collect::<Vec<_>>())
        }
        Geometry::Cylinder { radius, half_length } => {
            let [r, h] = [*radius, *half_length];
            turned(&[[0.0, -h], [r, -h], [r, h], [0.0, h]])
        }
        Geometry::Box { half } => {
            let mut faces = Vec::new();
            for axis in 0..3 {
                for side in [-1.0, 1.0] {
                    let unit = |k: usize| V::ith(k % 3, half[k % 3]);
                    let (n, u, v) = (unit(axis) * side, unit(axis + 1) * side, unit(axis + 2));
                    let [a, b, c, d] = [n - u - v, n + u - v, n + u + v, n - u + v];
                    faces.extend([[a, b, c], [a, c, d]]);
                }
            }
            faces
        }
        Geometry::Mesh(mesh) => of_mesh(mesh),
    }
}

struct TreeCanvas {
    /// [samples]
    size: [usize; 2],
    camera: Camera,
    layer: PixelRows,
    ground: f64,
}

impl TreeCanvas {
    fn new(size: [u32; 2], camera: Camera, ground: f64) -> Self {
        let [width, height] = size.map(|s| s as usize);
        let sky = |row: usize| {
            let t = row as f64 / height as f64;
            std::array::from_fn(|k| (SKY[0][k] * (1.0 - t) + SKY[1][k] * t) as f32)
        };
        let mut layer = PixelRows::new(width, 0, height);
        layer.colors = (0..height).flat_map(|row| std::iter::repeat_n(sky(row), width)).collect();
        Self { size: [width, height], camera, layer, ground }
    }

    /// Draws a disc of sand under the robot, with the shadow of its faces.
    fn ground(&mut self, faces: &[([V; 3], Rgb)], radius: f64) {
        let center = self.camera.target();
        let middle = V::new(center.x, center.y, self.ground - BEFORE * radius);
        let point = |k: usize| {
            let (sin, cos) = (TAU * k as f64 / 64.0).sin_cos();
            middle + V::new(cos, sin, 0.0) * (2.4 * radius)
        };
        for k in 0..64 {
            self.flat(&[middle, point(k), point(k + 1)], SAND);
        }
        let light = V::from(LIGHT);
        let shade = SAND.map(|c| c * 0.74);
        for (corners, _) in faces {
            let cast = corners.map(|p| p - light * ((p.z - self.ground + 0.5 * BEFORE * radius) / light.z));
            self.flat(&cast, shade);
        }
    }

    fn triangle(&mut self, corners: &[V; 3], color: Rgb) {
        RasterTriangle::lit(&self.camera, corners, color).iter().for_each(|facet| self.layer.fill(facet));
    }

    fn flat(&mut self, corners: &[V; 3], color: Rgb) {
        RasterTriangle::flat(&self.camera, corners, color).iter().for_each(|facet| self.layer.fill(facet));
    }

    fn png(&self, [width, height]: [u32; 2], captions: &[String]) -> Result<Vec<u8>> {
        let mut pixels = Vec::with_capacity(3 * (width * height) as usize);
        for y in 0..height as usize {
            for x in 0..width as usize {
                for k in 0..3 {
                    let samples = (0..SAMPLES * SAMPLES).map(|s| {
                        self.layer.colors[(y * SAMPLES + s / SAMPLES) * self.size[0] + x * SAMPLES + s % SAMPLES][k]
                    });
                    let mean = samples.sum::<f32>() / (SAMPLES * SAMPLES) as f32;
                    pixels.push(mean.round().clamp(0.0, 255.0) as u8);
                }
            }
        }
        for (n, caption) in captions.iter().enumerate() {
            text::write(&mut pixels, width as usize, [8, 6 + (n * text::CELL[1]) as i64], caption, INK);
        }
        png(&pixels, [width, height])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::number::Vec3;

    /// An outline covers a small part of a large plate and leaves the middle of each plate free.
    #[test]
    fn plates_are_thin_outlines() {
        for (half, share) in [(0.1, 0.05), (0.001, 0.4)] {
            let axis = |v: [f64; 3]| Vec3::new(v[0], v[1], v[2]);
            let plate = IntruderPlate {
                center: Vec3::zero(),
                normal: axis([0.0, 0.0, 1.0]),
                area: 4.0 * half * half,
                half: [axis([half, 0.0, 0.0]), axis([0.0, half, 0.0])],
                bend: [0.0; 2],
            };
            let faces = outline(&plate, &Isometry3::identity(), 0.5);
            let area: f64 = faces.iter().map(|[a, b, c]| 0.5 * (b - a).cross(&(c - a)).norm()).sum();
            assert!(area < share * 4.0 * half * half && area > 0.0, "{area} of {}", 4.0 * half * half);
            assert!(faces.iter().flatten().all(|p| p.x.abs().max(p.y.abs()) > 0.5 * half));
        }
    }
}
