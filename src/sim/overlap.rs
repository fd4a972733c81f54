//! How deep a robot lies inside rigid obstacles. Tests and studies measure it with geometry code that no engine
//! uses.

use super::solid::{RigidPose, Solid};
use super::{Model, State};

type V = nalgebra::Vector3<f64>;

/// Number of points along and across a leg's piece, and along each edge of the base. Our choice: between these points
/// an obstacle is found by its corners; more points make tests and studies slower.
const GRID: usize = 5;

/// Deepest overlap [m] of an obstacle with the base or with the middle surface of a leg; 0 if there is none. Legs and
/// base are sampled on a grid of points, obstacles also at their corners.
pub fn overlap(model: &Model, state: &State) -> f64 {
    overlaps(model, state).fold(0.0, |deepest, (_, depth)| depth.max(deepest))
}

/// The deepest overlap, divided by the depth of the obstacle's centre: 0 outside of all obstacles, 1 at a centre. The
/// share is nearly 1 for a body that passes through the middle of an obstacle.
pub fn overlap_share(model: &Model, state: &State) -> f64 {
    overlaps(model, state).fold(0.0, |deepest, (solid, depth)| (depth / solid.depth_of_centre()).max(deepest))
}

/// Each obstacle with its overlap [m], negative where there is none.
fn overlaps<'a>(model: &'a Model, state: &State) -> impl Iterator<Item = (&'a Solid, f64)> {
    let poses = obstacle_poses(model, state);
    let points: Vec<V> = leg_points(model, state).chain(base_points(model, state)).collect();
    let [length, width, top] = model.robot.base.size.map(|s| s / 2.0);
    let bottom = -model.robot.belly.as_ref().map_or(top, |b| b.below.min(top));
    let middle = V::new(0.0, 0.0, (top + bottom) / 2.0);
    let base = Solid::cuboid([2.0 * length, 2.0 * width, top - bottom]);
    let mut pose = RigidPose::new(state.position, state.orientation);
    pose.position += pose.rotation * middle;
    model.solids.iter().zip(poses).map(move |(solid, at)| {
        let near = points.iter().map(|p| solid.depth(&at, *p));
        let corners = solid.corners.iter().map(|c| base.depth(&pose, at.position + at.rotation * c));
        (solid, near.chain(corners).fold(f64::NEG_INFINITY, f64::max))
    })
}

/// Poses of the scene's obstacles.
pub fn obstacle_poses(model: &Model, state: &State) -> Vec<RigidPose> {
    let mut loose = state.objects.iter();
    let pose = |o: &super::Obstacle| match o.moves().then(|| loose.next()).flatten() {
        Some(object) => RigidPose::new(object.position, object.orientation),
        None => RigidPose::new(o.position, o.orientation),
    };
    model.scene.obstacles.iter().map(pose).collect()
}

fn leg_points(model: &Model, state: &State) -> impl Iterator<Item = V> {
    let base = RigidPose::new(state.position, state.orientation);
    let mut angles = state.angles.iter();
    let mut points = Vec::new();
    for chain in &model.legs {
        let mut at = base;
        for body in chain {
            let axis = nalgebra::Unit::new_normalize(body.axis);
            let angle = angles.next().copied().unwrap_or(0.0);
            at.position += at.rotation * body.joint;
            at.rotation *= nalgebra::Rotation3::from_axis_angle(&axis, angle).into_inner();
            for piece in &body.pieces {
                for k in 0..GRID * GRID {
                    let part = |i: usize| i as f64 / (GRID - 1) as f64 - 0.5;
                    let along = piece.along * (piece.size[0] * part(k / GRID));
                    let across = piece.across * (piece.size[1] * part(k % GRID));
                    points.push(at.position + at.rotation * (piece.center + along + across));
                }
            }
        }
    }
    points.into_iter()
}

fn base_points(model: &Model, state: &State) -> impl Iterator<Item = V> {
    let pose = RigidPose::new(state.position, state.orientation);
    let [length, width, height] = model.robot.base.size;
    let bottom = -model.robot.belly.as_ref().map_or(height / 2.0, |b| b.below.min(height / 2.0));
    (0..GRID * GRID * 2).map(move |k| {
        let part = |i: usize| i as f64 / (GRID - 1) as f64 - 0.5;
        let z = if k < GRID * GRID { bottom } else { height / 2.0 };
        let [i, j] = [k / GRID % GRID, k % GRID];
        pose.position + pose.rotation * V::new(length * part(i), width * part(j), z)
    })
}
