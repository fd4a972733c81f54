//! Draws one moment as an image, without a GPU: far faces first, then near faces over them.

use super::camera::{Camera, CameraOptions, check_size, clip, radius};
use super::raster::{LIGHT, Rgb, SAMPLES};
use super::solid;
use super::text::{self, Labels};
use crate::error::{Error, Result};
use crate::sim::frame::{M, V};
use crate::sim::overlap::obstacle_poses;
use crate::sim::pose::{Pose, SegmentForce};
use crate::sim::robot::Tripod;
use crate::sim::tree::TreeModel;
use crate::sim::{Model, State};
use tiny_skia::{
    Color, FillRule, GradientStop, LineCap, LinearGradient, Paint, Path, PathBuilder, Pixmap, Point, Rect, Shader,
    SpreadMode, Stroke, Transform,
};

const SKY: [Rgb; 2] = [[226.0, 234.0, 241.0], [247.0, 246.0, 242.0]];
const SAND: [Rgb; 2] = [[236.0, 224.0, 198.0], [216.0, 194.0, 152.0]];
const LINES: Rgb = [172.0, 146.0, 100.0];
const BASE: Rgb = [86.0, 94.0, 106.0];
const HEAD: Rgb = [206.0, 112.0, 48.0];
const LEGS: [Rgb; 2] = [[34.0, 110.0, 178.0], [96.0, 158.0, 96.0]];
const ROCK: Rgb = [150.0, 142.0, 134.0];
const ARROW: Rgb = [200.0, 30.0, 60.0];
const INK: [u8; 3] = [40, 44, 50];

/// Spacing of the fine lines on the sand, and of the coarse lines that are labelled with x [m]: first for small robots,
/// then for robots whose drawn sand reaches further than [`SMALL`]. Our choice: round lengths, a coarse line at every
/// fifth or fourth fine line.
const SPACING: [[f64; 2]; 2] = [[0.05, 0.25], [0.25, 1.0]];
/// Reach of the drawn sand of small robots [m]: our choice, 64 fine lines.
const SMALL: f64 = 3.2;
/// Share of the drawn sand that has fine lines: our choice, because lines closer than a pixel only take time.
const FINE_SHARE: f64 = 0.5;

/// Drawn thickness of legs [m]: our choice; the physics takes them as thin strips.
const THICKNESS: f64 = 0.002;

/// Length of an arrow for a force equal to the robot's weight, in robot radii: our choice.
const ARROW_LENGTH: f64 = 0.9;

/// A convex flat face of a solid.
struct PictureFace {
    corners: Vec<V>,
    normal: V,
    color: Rgb,
}

/// An image of `size` [px], RGB rows from the top; `captions` are written into its upper left corner. `footing`:
/// see [`Pose::of`].
///
/// # Errors
/// Names the side that is out of range, or the camera's value that is out of its range.
pub fn draw(
    model: &Model,
    state: &State,
    footing: &[f64],
    size: [u32; 2],
    camera: &CameraOptions,
    captions: &[String],
) -> Result<Vec<u8>> {
    check_size(size)?;
    let pose = Pose::of(model, state, footing);
    let mut canvas = SandCanvas::new(model, state, size, camera.check()?)?;
    canvas.sand();
    let labels = match &model.tree {
        Some(robot) => canvas.tree(model, robot, state, &pose),
        None => canvas.legs(model, state, &pose),
    };
    let mut pixels = canvas.pixels();
    let width = size[0] as usize;
    for (at, label) in text::apart(labels, size) {
        text::write(&mut pixels, width, at, &label, LINES.map(|c| (c * 0.75) as u8));
    }
    for (n, caption) in captions.iter().enumerate() {
        text::write(&mut pixels, width, [8, 6 + (n * text::CELL[1]) as i64], caption, INK);
    }
    Ok(pixels)
}

/// Six faces of a box about `center`, `half` its half sizes along the columns of `axes`.
fn cuboid(center: V, axes: M, half: V, color: impl Fn(usize, f64) -> Rgb) -> Vec<PictureFace> {
    let mut faces = Vec::with_capacity(6);
    for axis in 0..3 {
        let [u, v] = [(axis + 1) % 3, (axis + 2) % 3].map(|k| axes.column(k) * half[k]);
        for sign in [-1.0, 1.0] {
            let normal = axes.column(axis) * sign;
            let middle = center + normal * half[axis];
            let corners = vec![middle - u - v, middle + u - v, middle + u + v, middle - u + v];
            faces.push(PictureFace { corners, normal, color: color(axis, sign) });
        }
    }
    faces
}

fn robot_faces(model: &Model, pose: &Pose) -> Vec<PictureFace> {
    let (turn, at) = pose.bodies[0];
    let front = |axis, sign| if axis == 0 && sign > 0.0 { HEAD } else { BASE };
    let mut faces = cuboid(at, turn, V::from(model.robot.base.size) / 2.0, front);
    let links = model.legs.iter().zip(&model.robot.hip).flat_map(|(chain, hip)| chain.iter().map(move |b| (b, hip)));
    for ((body, hip), (turn, origin)) in links.zip(&pose.bodies[1..]) {
        let color = LEGS[usize::from(hip.tripod == Tripod::B)];
        for piece in &body.pieces {
            let axes = M::from_columns(&[piece.along, piece.across, piece.along.cross(&piece.across)]);
            let half = V::new(piece.size[0], piece.size[1], THICKNESS) / 2.0;
            faces.extend(cuboid(origin + turn * piece.center, turn * axes, half, |_, _| color));
        }
    }
    faces
}

fn obstacle_faces(model: &Model, state: &State) -> Vec<PictureFace> {
    let mut faces = Vec::new();
    for (solid, at) in model.solids.iter().zip(obstacle_poses(model, state)) {
        if solid.corners.is_empty() {
            // A sphere is drawn by the facets that sand pushes on.
            faces.extend(solid.facets.iter().map(|f| {
                let normal = at.rotation * f.normal;
                let side = normal.cross(&if normal.z.abs() < 0.9 { V::z() } else { V::x() }).normalize();
                let (u, v) = (side * (0.55 * f.area.sqrt()), normal.cross(&side) * (0.55 * f.area.sqrt()));
                let p = at.position + at.rotation * f.center;
                PictureFace { corners: vec![p - u - v, p + u - v, p + u + v, p - u + v], normal, color: ROCK }
            }));
        }
        for face in &solid.faces {
            let corners = face.map(|i| at.position + at.rotation * solid.corners[i]).to_vec();
            let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0])).normalize();
            faces.push(PictureFace { corners, normal, color: ROCK });
        }
    }
    faces
}

fn color(c: Rgb, alpha: f64) -> Color {
    let [r, g, b] = c.map(|v| (v / 255.0).clamp(0.0, 1.0) as f32);
    Color::from_rgba(r, g, b, alpha as f32).unwrap_or(Color::BLACK)
}

fn ink(c: Rgb, alpha: f64) -> Paint<'static> {
    Paint { shader: Shader::SolidColor(color(c, alpha)), ..Default::default() }
}

fn outline(points: &[[f32; 2]], path: &mut PathBuilder) {
    for (k, [x, y]) in points.iter().enumerate() {
        if k == 0 { path.move_to(*x, *y) } else { path.line_to(*x, *y) }
    }
}

fn closed(points: &[[f32; 2]]) -> Option<Path> {
    let mut path = PathBuilder::new();
    outline(points, &mut path);
    path.close();
    path.finish()
}

struct SandCanvas {
    map: Pixmap,
    options: CameraOptions,
    camera: Camera,
    /// Centre of the visible sand [m], and its radius.
    middle: V,
    radius: f64,
}

impl SandCanvas {
    fn new(model: &Model, state: &State, [width, height]: [u32; 2], options: CameraOptions) -> Result<Self> {
        let memory = || Error::Exhausted("a picture of this size does not fit into memory".into());
        let [x, y] = options.target(state);
        Ok(Self {
            map: Pixmap::new(width, height).ok_or_else(memory)?,
            options,
            camera: Camera::of(&options, model, state, [width, height]),
            middle: V::new(x, y, model.surface_height(x, y)),
            radius: radius(model),
        })
    }

    /// Draws a robot from a file and its ground; returns the labels of the grid lines.
    fn tree(&mut self, model: &Model, robot: &TreeModel, state: &State, pose: &Pose) -> Labels {
        let (painted, ground) = (solid::robot(robot, state), solid::ground(model, state, self.options.target(state)));
        let mut labels = Vec::new();
        // Lines and shadows are drawn on level ground only.
        if ground.is_none() {
            labels = self.lines(model, state);
            let face = |(corners, color): &solid::ColoredTriangle| {
                let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0])).try_normalize(0.0)?;
                Some(PictureFace { corners: corners.to_vec(), normal, color: *color })
            };
            self.shadow(&painted.iter().filter_map(face).collect::<Vec<_>>());
        }
        let size = [self.map.width(), self.map.height()].map(|side| side * SAMPLES as u32);
        let fine = Camera::of(&self.options, model, state, size);
        solid::paint(&mut self.map, &fine, &painted, ground.as_deref(), &model.scene.hard);
        self.arrows(model, pose);
        labels
    }

    /// Draws a robot with identical legs, and the rocks; returns the labels of the grid lines.
    fn legs(&mut self, model: &Model, state: &State, pose: &Pose) -> Labels {
        let labels = self.lines(model, state);
        let mut faces = robot_faces(model, pose);
        faces.extend(obstacle_faces(model, state));
        if let Some(ground) = solid::ground(model, state, self.options.target(state)) {
            let fan = |face: &PictureFace| {
                let (corners, color) = (face.corners.clone(), face.color);
                (2..corners.len()).map(move |k| ([corners[0], corners[k - 1], corners[k]], color)).collect::<Vec<_>>()
            };
            let painted: Vec<solid::ColoredTriangle> = faces.iter().flat_map(fan).collect();
            let size = [self.map.width(), self.map.height()].map(|side| side * SAMPLES as u32);
            let fine = Camera::of(&self.options, model, state, size);
            solid::paint(&mut self.map, &fine, &painted, Some(&ground), &[]);
            self.arrows(model, pose);
            return labels;
        }
        self.shadow(&faces);
        self.faces(faces);
        self.arrows(model, pose);
        labels
    }

    /// A vertical gradient of two colours.
    fn gradient(&self, [top, bottom]: [Rgb; 2]) -> Paint<'static> {
        let stops = vec![GradientStop::new(0.0, color(top, 1.0)), GradientStop::new(1.0, color(bottom, 1.0))];
        let ends = [Point::from_xy(0.0, 0.0), Point::from_xy(0.0, self.map.height() as f32)];
        let shader = LinearGradient::new(ends[0], ends[1], stops, SpreadMode::Pad, Transform::identity());
        Paint { shader: shader.unwrap_or(Shader::SolidColor(color(top, 1.0))), ..Default::default() }
    }

    fn fill(&mut self, path: Option<Path>, paint: &Paint) {
        if let Some(path) = path {
            self.map.fill_path(&path, paint, FillRule::Winding, Transform::identity(), None);
        }
    }

    /// Draws the sky, and the surface as far as the horizon.
    fn sand(&mut self) {
        let (width, height) = (self.map.width() as f32, self.map.height() as f32);
        if let Some(all) = Rect::from_xywh(0.0, 0.0, width, height) {
            let sky = Paint { anti_alias: false, ..self.gradient(SKY) };
            self.map.fill_rect(all, &sky, Transform::identity(), None);
        }
        let far = 200.0 * self.radius;
        let surface =
            [[-far, -far], [far, -far], [far, far], [-far, far]].map(|[x, y]| self.middle + V::new(x, y, 0.0));
        // Clipped to the neighbourhood of the picture, because the rasteriser cannot handle coordinates of millions
        // of pixels.
        let near = clip(&surface, |p| self.camera.depth(p) - 0.5 * self.radius);
        let seen = self.camera.polygon(&near).and_then(|points| closed(&points));
        let paint = self.gradient(SAND);
        self.fill(seen, &paint);
    }

    /// Draws lines at round x and y; returns the labels of the coarse lines.
    fn lines(&mut self, model: &Model, state: &State) -> Labels {
        let reach = (12.0 * self.radius).max(4.0 * SPACING[0][0]);
        let [fine, coarse] = SPACING[usize::from(reach > SMALL)];
        let mut labels = Vec::new();
        for (spacing, alpha, reach) in [(fine, 0.35, FINE_SHARE * reach), (coarse, 0.8, reach)] {
            let mut path = PathBuilder::new();
            for axis in 0..2 {
                let from = ((self.middle[axis] - reach) / spacing).ceil() as i64;
                let to = ((self.middle[axis] + reach) / spacing).floor() as i64;
                for at in (from..=to).map(|k| k as f64 * spacing) {
                    let (mut a, mut b) = (self.middle, self.middle);
                    (a[axis], b[axis]) = (at, at);
                    (a[1 - axis], b[1 - axis]) = (a[1 - axis] - reach, b[1 - axis] + reach);
                    let line = clip(&[a, b], |p| self.camera.depth(p) - 0.5 * self.radius);
                    // A line is clipped as a polygon with two corners.
                    if let Some(points) = self.camera.polygon(&line) {
                        outline(&points, &mut path);
                    }
                }
            }
            if let Some(path) = path.finish() {
                let stroke = Stroke { width: 0.8, ..Default::default() };
                self.map.stroke_path(&path, &ink(LINES, alpha), &stroke, Transform::identity(), None);
            }
        }
        let beside = state.position[1] - 1.6 * radius(model);
        let from = ((self.middle.x - reach) / coarse).ceil() as i64;
        let to = ((self.middle.x + reach) / coarse).floor() as i64;
        for x in (from..=to).map(|k| k as f64 * coarse) {
            if let Some(([u, v], _)) = self.camera.see(V::new(x, beside, 0.0)) {
                labels.push(([u as i64 + 3, v as i64 - 8], format!("{x:.2} m")));
            }
        }
        labels
    }

    /// Shadows: all faces projected along the light, drawn once.
    fn shadow(&mut self, faces: &[PictureFace]) {
        let light = V::from(LIGHT);
        let mut path = PathBuilder::new();
        for face in faces.iter().filter(|f| f.normal.dot(&light) > 0.0) {
            let above = clip(&face.corners, |p| p.z);
            let cast: Vec<V> = above.iter().map(|p| p - light * (p.z / light.z)).collect();
            if let Some(points) = self.camera.polygon(&cast).filter(|p| p.len() > 2) {
                // All polygons get the same winding, so that overlapping shadows do not cancel.
                let area = |p: &[[f32; 2]]| -> f32 {
                    p.iter().zip(p.iter().cycle().skip(1)).map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum()
                };
                let ordered = if area(&points) < 0.0 { points.into_iter().rev().collect() } else { points };
                outline(&ordered, &mut path);
                path.close();
            }
        }
        self.fill(path.finish(), &ink([90.0, 70.0, 40.0], 0.28));
    }

    /// Draws the faces. Parts under the surface are faintly visible through the sand; the other parts are opaque.
    fn faces(&mut self, faces: Vec<PictureFace>) {
        let middle = |f: &PictureFace| f.corners.iter().sum::<V>() / f.corners.len() as f64;
        let mut seen: Vec<_> = faces.into_iter().filter(|f| self.camera.faces(middle(f), f.normal)).collect();
        seen.sort_by(|a, b| self.camera.distance(middle(b)).total_cmp(&self.camera.distance(middle(a))));
        for (above, alpha) in [(-1.0, 0.22), (1.0, 1.0)] {
            for face in &seen {
                let part = clip(&face.corners, |p| above * p.z);
                if part.len() < 3 {
                    continue;
                }
                let light = V::from(LIGHT).normalize();
                let bright = 0.62 + 0.38 * face.normal.dot(&light).max(-0.4);
                let path = self.camera.polygon(&part).and_then(|points| closed(&points));
                let shaded = face.color.map(|c| c * bright + 30.0 * (bright - 0.62));
                self.fill(path.clone(), &ink(shaded, alpha));
                if let Some(path) = path.filter(|_| alpha == 1.0) {
                    // Strokes that close the seams between neighbouring faces and mark the edges.
                    let stroke = Stroke { width: 0.6, ..Default::default() };
                    let edge = ink(face.color.map(|c| c * bright * 0.7), 0.9);
                    self.map.stroke_path(&path, &edge, &stroke, Transform::identity(), None);
                }
            }
        }
    }

    /// Draws arrows of the ground's force on each leg, or on each body that touches the ground, from the point where
    /// the force acts.
    fn arrows(&mut self, model: &Model, pose: &Pose) {
        let per_newton = ARROW_LENGTH * self.radius / (model.total_mass() * model.gravity.norm());
        let thick = self.map.height() as f32 / 180.0;
        for SegmentForce { position: at, force } in pose.arrows(model) {
            let tip = at + force * per_newton;
            let (Some((from, _)), Some((to, _))) = (self.camera.see(at), self.camera.see(tip)) else { continue };
            let [dx, dy] = [to[0] - from[0], to[1] - from[1]];
            let length = dx.hypot(dy).max(1e-3);
            let [ux, uy] = [dx / length, dy / length];
            let head = (3.5 * thick).min(length);
            let neck = [to[0] - ux * head, to[1] - uy * head];
            let mut shaft = PathBuilder::new();
            outline(&[from, neck], &mut shaft);
            if let Some(path) = shaft.finish() {
                let stroke = Stroke { width: thick, line_cap: LineCap::Round, ..Default::default() };
                self.map.stroke_path(&path, &ink(ARROW, 1.0), &stroke, Transform::identity(), None);
            }
            let half = 0.45 * head;
            let barbs = [[neck[0] - uy * half, neck[1] + ux * half], to, [neck[0] + uy * half, neck[1] - ux * half]];
            self.fill(closed(&barbs), &ink(ARROW, 1.0));
        }
    }

    /// RGB rows from the top: everything is opaque.
    fn pixels(&self) -> Vec<u8> {
        self.map.data().as_chunks::<4>().0.iter().flat_map(|[r, g, b, _]| [*r, *g, *b]).collect()
    }
}
