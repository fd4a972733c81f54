//! The header of a recording: the robot's geometry and the meaning of every column.

use super::camera::radius;
use super::recording::{FORMAT, HEIGHTS, VERSION};
use crate::sim::frame::V;
use crate::sim::model::{LinkBody, StripPiece};
use crate::sim::pose::segments;
use crate::sim::solid::Solid;
use crate::sim::tree::forces::touching;
use crate::sim::tree::{JointKind, TreeBody, TreeModel};
use crate::sim::{Model, Obstacle};
use serde_json::{Value, json};

/// What the task adds to a section's header.
#[derive(Clone, Debug, Default)]
pub struct About<'a> {
    /// The task's id, or the name of the program that made the recording.
    pub task: &'a str,
    /// Number of rows for a second of simulated time.
    pub rate: f64,
    /// Seed and number of the episode.
    pub episode: Option<(u64, u64)>,
    /// Name and unit of each of the task's figures.
    pub info: Vec<(&'a str, &'a str)>,
    /// How many of these figures, from the first one, are reward terms.
    pub reward_terms: usize,
    /// How many numbers an action has.
    pub actions: usize,
}

/// The header of a section as JSON text; `docs/recordings.md` has its fields.
pub fn header(model: &Model, about: &About) -> String {
    let robot = &model.robot;
    let hips: Vec<_> = robot.hip.iter().map(|h| json!({"name": h.name, "tripod": h.tripod})).collect();
    let mut head = json!({
        "format": FORMAT,
        "version": VERSION,
        "sandgait": env!("CARGO_PKG_VERSION"),
        "task": about.task,
        "rate": about.rate,
        "seed": about.episode.map(|e| e.0),
        "episode": about.episode.map(|e| e.1),
        "reward_terms": about.reward_terms,
        "robot": robot.name,
        "mass": model.total_mass(),
        "medium": model.scene.medium.name,
        "law": model.scene.law.name(),
        "slope_deg": model.scene.slope_deg,
        "gravity": list(model.gravity),
        "legs": hips,
        "joints": model.joint_names(),
        "base": robot.base.size,
        "radius": (radius(model) * 1e9).round() / 1e9,
        "bodies": bodies(model),
        "segments": segment_list(model),
        "obstacles": model.scene.obstacles.iter().zip(&model.solids).map(obstacle).collect::<Vec<_>>(),
        "columns": columns(model, about),
    });
    if model.tree.is_some() {
        head["touching"] = json!(touching(model));
    }
    if !model.scene.hard.is_empty() {
        head["hard"] = json!(model.scene.hard);
    }
    let mut text = head.to_string();
    // Long parts that stay the same are kept as text. The header ends with them.
    let parts = [
        ("shapes", model.tree.as_ref().map(|t| t.looks.json())),
        ("relief", model.scene.relief.as_ref().map(|r| r.json())),
    ];
    for (name, json) in parts.into_iter().filter_map(|(name, json)| Some((name, json?))) {
        text.pop();
        text.push_str(&format!(",\"{name}\":{json}}}"));
    }
    text
}

/// The vector, rounded to 1e-9. This is far below any length of a robot, and makes the text half as long.
fn list(v: V) -> [f64; 3] {
    [v.x, v.y, v.z].map(|c| (c * 1e9).round() / 1e9)
}

/// The bodies of a robot from a file; its shapes are listed separately.
fn tree_bodies(robot: &TreeModel) -> Vec<Value> {
    let one = |(i, body): (usize, &TreeBody)| {
        let q = body.origin.rotation;
        json!({
            "name": body.name,
            "parent": (i > 0).then_some(body.parent),
            "leg": null,
            "joint": list(body.origin.translation.vector),
            "turn": [q.w, q.i, q.j, q.k],
            "axis": body.joint.as_ref().map(|j| list(j.axis.into_inner())),
            "slides": body.joint.as_ref().is_some_and(|j| j.kind == JointKind::Slide),
            "pieces": [],
        })
    };
    robot.tree.bodies.iter().enumerate().map(one).collect()
}

fn bodies(model: &Model) -> Vec<Value> {
    if let Some(robot) = &model.tree {
        return tree_bodies(robot);
    }
    let mut all = Vec::with_capacity(1 + model.joints());
    all.push(json!({"parent": null, "leg": null, "pieces": []}));
    for (leg, chain) in model.legs.iter().enumerate() {
        let mut parent = 0;
        for body in chain {
            all.push(link(body, parent, leg));
            parent = all.len() - 1;
        }
    }
    all
}

fn link(body: &LinkBody, parent: usize, leg: usize) -> Value {
    let piece = |p: &StripPiece| json!({"center": list(p.center), "along": list(p.along), "across": list(p.across), "size": p.size});
    json!({
        "parent": parent,
        "leg": leg,
        "joint": list(body.joint),
        "axis": list(body.axis),
        "reach": list(body.reach),
        "pieces": body.pieces.iter().map(piece).collect::<Vec<_>>(),
    })
}

fn segment_list(model: &Model) -> Vec<Value> {
    let one = |s: crate::sim::pose::SandSegment| {
        json!({
            "body": s.body,
            "leg": s.leg,
            "center": list(s.plate.center),
            "normal": list(s.plate.normal),
            "area": s.plate.area,
        })
    };
    segments(model).into_iter().map(one).collect()
}

fn obstacle((obstacle, solid): (&Obstacle, &Solid)) -> Value {
    let round = solid.corners.is_empty();
    json!({
        "moves": obstacle.moves(),
        "position": obstacle.position,
        "orientation": obstacle.orientation,
        "radius": round.then(|| solid.reach()),
        "corners": solid.corners.iter().map(|c| list(*c)).collect::<Vec<_>>(),
        "faces": solid.faces,
    })
}

/// Name, unit and shape of every column of a row, in the order of [`super::recording::row`].
fn columns(model: &Model, about: &About) -> Vec<Value> {
    let (joints, segments) = (model.joints(), segments(model).len());
    let column = |name: &str, unit: &str, shape: &[usize]| json!({"name": name, "unit": unit, "shape": shape});
    let mut all = vec![
        column("time", "s", &[]),
        column("position", "m", &[3]),
        column("orientation", "1", &[4]),
        column("velocity", "m/s", &[3]),
        column("angular_velocity", "rad/s", &[3]),
        column("angles", "rad", &[joints]),
        column("rates", "rad/s", &[joints]),
        column("references", "rad", &[joints]),
        column("torques", "N·m", &[joints]),
        column("action", "1", &[about.actions]),
        column("reward", "1", &[]),
    ];
    all.extend(about.info.iter().map(|(name, unit)| column(name, unit, &[])));
    all.push(column("stance", "1", &[model.legs.len()]));
    all.push(column("objects", "m, 1", &[model.objects_at_rest().len(), 7]));
    all.push(column("forces", "N", &[segments, 3]));
    if model.tree.is_some() {
        let bodies = touching(model).len();
        all.extend([column("ground_forces", "N", &[bodies, 3]), column("ground_points", "m", &[bodies, 3])]);
    }
    if model.scene.memory.is_some() {
        all.extend([column("sand_frame", "m", &[3]), column("sand_heights", "m", &[HEIGHTS, HEIGHTS])]);
    }
    all
}
