//! Robots from files, and ground that is not flat, in the picture of a moment.

use super::camera::{Camera, radius};
use super::raster::{PixelRows, RasterTriangle, Rgb, SAMPLES};
use super::{hard, tree};
use crate::sand::memory::Moved;
use crate::sim::frame::V;
use crate::sim::tree::{HardGround, TreeModel, kinematics};
use crate::sim::{Model, State};
use tiny_skia::{Pixmap, PremultipliedColorU8};

/// Two colours of the ground, in squares.
const GROUND: [Rgb; 2] = [[230.0, 213.0, 178.0], [222.0, 203.0, 166.0]];
/// Side of these squares, and of the cells in which the ground is drawn [m]: our choice, five cells a square. The cells
/// are larger for larger robots, because of [`REACH`].
const SQUARE: f64 = 0.25;
const CELL: f64 = 0.05;
/// Largest number of cells from the robot to the edge of the drawn ground: our choice, to bound the time of a picture.
const REACH: f64 = 64.0;
/// Share of a robot's colour in a pixel where the robot is under the surface: our choice, faint but visible.
const BURIED: f32 = 0.22;
/// Rows of pixels that are drawn at a time, so that large pictures need little memory: our choice.
const BAND: usize = 32;

/// A triangle in the world, and its colour.
pub type ColoredTriangle = ([V; 3], Rgb);

/// The robot's shapes.
pub fn robot(robot: &TreeModel, state: &State) -> Vec<ColoredTriangle> {
    let frames = kinematics::frames(&robot.tree, state);
    let mut all = Vec::new();
    for look in &robot.looks.shapes {
        let color = match look.body {
            0 => tree::BASE,
            body => tree::LINKS[tree::depth(&robot.tree, body) % tree::LINKS.len()],
        };
        let at = frames[look.body] * look.origin();
        let placed = |t: [V; 3]| (t.map(|p| (at * nalgebra::Point3::from(p)).coords), color);
        let of_mesh = |i: &usize| {
            let mesh = &robot.looks.meshes[*i];
            mesh.faces.iter().map(|face| face.map(|k| V::from(mesh.corners[k as usize]))).collect()
        };
        all.extend(tree::triangles(&look.form, of_mesh).into_iter().map(placed));
    }
    all
}

/// Ground with heights around the point [x, y], in the colours of sand; None: it is flat.
pub fn ground(model: &Model, state: &State, [x, y]: [f64; 2]) -> Option<Vec<ColoredTriangle>> {
    if let Some(sand) = &state.sand {
        return Some(moved(sand));
    }
    if model.scene.relief.is_none() && !hard::rises(&model.scene.hard) {
        return None;
    }
    let reach = 12.0 * radius(model);
    let cell = CELL * (reach / (REACH * CELL)).ceil().max(1.0);
    let [i0, j0] = [x, y].map(|at| ((at - reach) / cell).floor());
    let count = (2.0 * reach / cell).ceil() as usize + 1;
    let node = |i: usize, j: usize| {
        let [x, y] = [(i0 + i as f64) * cell, (j0 + j as f64) * cell];
        V::new(x, y, hard::surface(model, x, y))
    };
    let nodes: Vec<V> = (0..count * count).map(|k| node(k % count, k / count)).collect();
    let mut all = Vec::with_capacity(2 * count * count);
    for k in (0..count * (count - 1)).filter(|k| k % count + 1 < count) {
        let [a, b, c, d] = [k, k + 1, k + count + 1, k + count].map(|k| nodes[k]);
        let middle = (a + c) / (2.0 * SQUARE);
        let color = GROUND[(middle.x.floor() + middle.y.floor()).rem_euclid(2.0) as usize];
        all.extend([([a, b, c], color), ([a, c, d], color)]);
    }
    Some(all)
}

/// All cells of the square of sand that moves with a robot.
fn moved(sand: &Moved) -> Vec<ColoredTriangle> {
    let (cell, side) = (sand.grid.frame.cell, sand.grid.frame.side());
    let nodes: Vec<V> = (sand.grid.cells())
        .map(|([i, j], height)| V::new((f64::from(i) + 0.5) * cell, (f64::from(j) + 0.5) * cell, height))
        .collect();
    let mut all = Vec::with_capacity(2 * side * side);
    for k in (0..side * (side - 1)).filter(|k| k % side + 1 < side) {
        let [a, b, c, d] = [k, k + 1, k + side + 1, k + side].map(|k| nodes[k]);
        all.extend([([a, b, c], GROUND[0]), ([a, c, d], GROUND[0])]);
    }
    all
}

/// Paints robot, ground and hard ground into `map`. `camera`: the camera of a picture with [`SAMPLES`] times as many
/// pixels along each side. Parts of the robot under the surface shine through.
pub fn paint(
    map: &mut Pixmap,
    camera: &Camera,
    robot: &[ColoredTriangle],
    ground: Option<&[ColoredTriangle]>,
    hard: &[HardGround],
) {
    let lit = |all: &[ColoredTriangle]| -> Vec<RasterTriangle> {
        all.iter().filter_map(|(t, c)| RasterTriangle::lit(camera, t, *c)).collect()
    };
    let (robot, ground) = (lit(robot), ground.map(lit));
    let everywhere = hard.iter().any(HardGround::is_everything);
    let plain = ground.is_none() && hard.is_empty();
    let [width, height] = [map.width(), map.height()].map(|side| side as usize);
    for top in (0..height).step_by(BAND) {
        let rows = BAND.min(height - top);
        let [first, end] = [top, top + rows].map(|row| (row * SAMPLES) as f32);
        let covers = |facet: &&RasterTriangle| facet.rows()[0] <= end && facet.rows()[1] >= first;
        if plain && !robot.iter().any(|facet| covers(&facet)) {
            continue;
        }
        let layer = |facets: &[RasterTriangle]| {
            let mut layer = PixelRows::new(width * SAMPLES, top * SAMPLES, rows * SAMPLES);
            facets.iter().filter(covers).for_each(|facet| layer.fill(facet));
            layer
        };
        let (robot, ground) = (layer(&robot), ground.as_deref().map(layer));
        let pixels = map.pixels_mut()[top * width..][..rows * width].iter_mut();
        for (k, pixel) in pixels.enumerate() {
            let sample = |s: usize| [k % width * SAMPLES + s % SAMPLES, k / width * SAMPLES + s / SAMPLES];
            let index = |s: usize| sample(s)[1] * width * SAMPLES + sample(s)[0];
            // Most pixels of level sand show nothing else.
            if plain && (0..SAMPLES * SAMPLES).all(|s| robot.distances[index(s)] == f32::INFINITY) {
                continue;
            }
            let old = [pixel.red(), pixel.green(), pixel.blue()].map(f32::from);
            let mut sum = [0.0_f32; 3];
            for s in 0..SAMPLES * SAMPLES {
                let ([x, y], at) = (sample(s), index(s));
                let place = [x as f64 + 0.5, (top * SAMPLES + y) as f64 + 0.5];
                // Beyond the drawn ground one sees a level surface.
                let (sand, surface, seen) = match &ground {
                    Some(ground) if ground.distances[at].is_finite() => {
                        (ground.colors[at], ground.distances[at], f64::from(ground.distances[at]))
                    }
                    Some(_) => (old, f32::INFINITY, if everywhere { camera.level(place) } else { f64::INFINITY }),
                    None => {
                        let level = camera.level(place);
                        (old, level as f32, level)
                    }
                };
                let below = match hard {
                    [] => sand,
                    // All of the ground is seen grey, so the place need not be found.
                    _ if everywhere && seen.is_finite() => hard::grey(sand),
                    _ => camera
                        .point(place, seen)
                        .map_or(sand, |p| hard::shaded(hard, [p.x, p.y], camera.blur(seen), sand)),
                };
                let share = match robot.distances[at] {
                    f32::INFINITY => 0.0,
                    distance if distance > surface => BURIED,
                    _ => 1.0,
                };
                (0..3).for_each(|c| sum[c] += robot.colors[at][c] * share + below[c] * (1.0 - share));
            }
            let [r, g, b] = sum.map(|x| (x / (SAMPLES * SAMPLES) as f32).round().clamp(0.0, 255.0) as u8);
            *pixel = PremultipliedColorU8::from_rgba(r, g, b, 255).unwrap_or(*pixel);
        }
    }
}
