//! Triangles of one colour, with a depth buffer.

use super::camera::Camera;
use crate::sim::frame::V;

pub type Rgb = [f64; 3];

/// Direction to the light: over the camera's right shoulder, so that the robot's front is bright.
pub const LIGHT: [f64; 3] = [0.35, -0.45, 0.82];

/// Samples of a pixel along each edge, for smooth edges: our choice.
pub const SAMPLES: usize = 2;

/// Triangles are drawn wider by this length [samples]: our choice, because rounding of `f32` must leave no gaps between
/// neighbours.
const SEAM: f32 = 1e-3;

/// A triangle as a camera sees it.
pub struct RasterTriangle {
    corners: [[f32; 2]; 3],
    distances: [f32; 3],
    color: [f32; 3],
}

impl RasterTriangle {
    /// None if a corner is behind the camera.
    pub fn flat(camera: &Camera, corners: &[V; 3], color: Rgb) -> Option<Self> {
        let seen = corners.map(|p| camera.see(p));
        let [Some((a, da)), Some((b, db)), Some((c, dc))] = seen else { return None };
        Some(Self { corners: [a, b, c], distances: [da, db, dc].map(|d| d as f32), color: color.map(|x| x as f32) })
    }

    /// First and last row of the image that it may cover [samples].
    pub fn rows(&self) -> [f32; 2] {
        let [a, b, c] = self.corners.map(|corner| corner[1]);
        [a.min(b).min(c), a.max(b).max(c)]
    }

    /// Like [`Self::flat`], but lit on the side that faces the camera, because meshes may be inside out.
    pub fn lit(camera: &Camera, corners: &[V; 3], color: Rgb) -> Option<Self> {
        let [a, b, c] = corners;
        let normal = (b - a).cross(&(c - a)).try_normalize(0.0)?;
        let toward = if camera.faces((a + b + c) / 3.0, normal) { normal } else { -normal };
        let bright = 0.62 + 0.38 * toward.dot(&V::from(LIGHT).normalize()).max(-0.6);
        Self::flat(camera, corners, color.map(|x| x * bright + 24.0 * (bright - 0.62)))
    }
}

/// Some rows of an image: the colour of each sample, and the distance of the visible face.
pub struct PixelRows {
    width: usize,
    /// Number of the first row in the image.
    top: usize,
    pub colors: Vec<[f32; 3]>,
    /// Distance of each sample's nearest face from the camera [m]; infinite if there is no face.
    pub distances: Vec<f32>,
}

impl PixelRows {
    pub fn new(width: usize, top: usize, rows: usize) -> Self {
        let count = width * rows;
        Self { width, top, colors: vec![[0.0; 3]; count], distances: vec![f32::INFINITY; count] }
    }

    /// Fills a triangle where it is nearer than the present face.
    pub fn fill(&mut self, facet: &RasterTriangle) {
        let ([a, b, c], [da, db, dc]) = (facet.corners, facet.distances);
        let range = |k: usize, first: usize, end: usize| {
            let (low, high) = (a[k].min(b[k]).min(c[k]), a[k].max(b[k]).max(c[k]));
            let [first, end] = [first as f32, end as f32];
            (low.floor().clamp(first, end) as usize)..(high.ceil().clamp(first, end) as usize)
        };
        let bottom = self.top + self.colors.len() / self.width;
        let rows = range(1, self.top, bottom);
        let cross =
            |p: [f32; 2], q: [f32; 2], r: [f32; 2]| (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
        let area = cross(a, b, c);
        if rows.is_empty() || area == 0.0 || !area.is_finite() {
            return;
        }
        let columns = range(0, 0, self.width);
        for y in rows {
            // The weight of each corner is linear along the row: its value at the first sample, and its change.
            let weight = |p: [f32; 2], q: [f32; 2]| {
                let at = (q[0] - p[0]) * (y as f32 + 0.5 - p[1]) - (q[1] - p[1]) * (0.5 - p[0]);
                [at / area, (p[1] - q[1]) / area]
            };
            let weights = [weight(b, c), weight(c, a), weight(a, b)];
            // Inside, no weight is negative.
            let [mut first, mut last] = [columns.start as f32, columns.end as f32 - 1.0];
            for [at, change] in weights {
                match change {
                    c if c > 0.0 => first = first.max(-at / c - SEAM),
                    c if c < 0.0 => last = last.min(-at / c + SEAM),
                    _ if at < 0.0 => last = -1.0,
                    _ => (),
                }
            }
            // 1/distance is linear in the picture's coordinates.
            let [near, nearer] = [0, 1].map(|k| weights[0][k] / da + weights[1][k] / db + weights[2][k] / dc);
            let row = (y - self.top) * self.width;
            for x in first.ceil() as usize..(last.floor() + 1.0) as usize {
                let distance = 1.0 / (near + nearer * x as f32);
                if distance > 0.0 && distance < self.distances[row + x] {
                    (self.distances[row + x], self.colors[row + x]) = (distance, facet.color);
                }
            }
        }
    }
}
