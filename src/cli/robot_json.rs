//! A robot's shapes and joints, also as JSON.

use sandgait::robots::{Import, ShapeIndex};
use sandgait::sim::tree::{Geometry, TreeBody, TreeJoint, TreeShape, plates};
use sandgait::{Error, Result, sim};
use serde_json::{Value, json};

/// The shapes that touch sand, and their plates, body by body.
pub struct SandContacts {
    pub shapes: Vec<ShapeIndex>,
    pub plates: Vec<Vec<sandgait::sand::intruder::IntruderPlate>>,
}

impl SandContacts {
    pub fn of(import: &Import, names: Option<&[String]>, plate_size: Option<f64>) -> Result<Self> {
        if let Some(packed) = &import.packed {
            if names.is_some() || plate_size.is_some() {
                let reason = "a packed robot has its plates already: pack its file with other options";
                return Err(Error::invalid("touches", reason));
            }
            return Ok(Self { shapes: Vec::new(), plates: (*packed.model.plates).clone() });
        }
        let shapes = import.touching(names)?;
        let soles = if names.is_none() { &import.on_soles() } else { &import.tree };
        let plates = plates::of_touching(soles, &shapes, plate_size)?;
        Ok(Self { shapes, plates })
    }

    pub fn count(&self) -> usize {
        self.plates.iter().map(Vec::len).sum()
    }

    pub fn area(&self) -> f64 {
        self.plates.iter().flatten().map(|p| p.area).sum()
    }
}

pub fn kind(joint: &TreeJoint) -> &'static str {
    match joint.kind {
        sim::tree::JointKind::Hinge => "hinge",
        sim::tree::JointKind::Slide => "slide",
    }
}

/// Name, and sizes [m]: radius and length without caps, or sides; for a mesh the number of triangles.
pub fn geometry(geometry: &Geometry) -> (&'static str, Vec<f64>) {
    match geometry {
        Geometry::Sphere { radius } => ("sphere", vec![*radius]),
        Geometry::Capsule { radius, half_length } => ("capsule", vec![*radius, 2.0 * half_length]),
        Geometry::Cylinder { radius, half_length } => ("cylinder", vec![*radius, 2.0 * half_length]),
        Geometry::Box { half } => ("box", (half * 2.0).as_slice().to_vec()),
        Geometry::Mesh(triangles) => ("mesh", vec![triangles.len() as f64]),
    }
}

fn joint_json(joint: &TreeJoint) -> Value {
    json!({
        "name": joint.name,
        "kind": kind(joint),
        "axis": joint.axis.as_slice(),
        "range": joint.range,
        "torque_limit": joint.torque_limit,
        "speed_limit": joint.speed_limit,
        "damping": joint.damping,
        "friction": joint.friction,
        "armature": joint.armature,
        "kp": joint.kp,
        "kd": joint.kd,
        "rest": joint.rest,
    })
}

fn shape_json(shape: &TreeShape, touches: bool) -> Value {
    let (kind, size) = geometry(&shape.geometry);
    let q = shape.origin.rotation;
    json!({
        "name": shape.name,
        "kind": kind,
        "size": size,
        "position": shape.origin.translation.vector.as_slice(),
        "quat": [q.w, q.i, q.j, q.k],
        "area": shape.geometry.area(),
        "volume": shape.geometry.volume(),
        "friction": shape.friction,
        "touches_sand": touches,
    })
}

pub fn as_json(import: &Import, touching: &SandContacts) -> Value {
    let tree = &import.tree;
    let body = |(b, body): (usize, &TreeBody)| {
        let touches = |s: usize| touching.shapes.contains(&(b, s));
        let (q, i) = (body.origin.rotation, &body.inertia);
        json!({
            "name": body.name,
            "parent": (b > 0).then(|| tree.bodies[body.parent].name.as_str()),
            "links": import.links[b],
            "position": body.origin.translation.vector.as_slice(),
            "quat": [q.w, q.i, q.j, q.k],
            "mass": body.mass,
            "center": body.center.as_slice(),
            "inertia": {
                "xx": i[(0, 0)], "yy": i[(1, 1)], "zz": i[(2, 2)], "xy": i[(0, 1)], "xz": i[(0, 2)], "yz": i[(1, 2)],
            },
            "joint": body.joint.as_ref().map(joint_json),
            "shapes": body.shapes.iter().enumerate().map(|(s, shape)| shape_json(shape, touches(s))).collect::<Vec<_>>(),
            "plates": touching.plates[b].len(),
        })
    };
    let names = |bodies: &[usize]| bodies.iter().map(|b| tree.bodies[*b].name.clone()).collect::<Vec<_>>();
    json!({
        "name": tree.name,
        "format": import.format.name(),
        "mass": tree.mass(),
        "joints": tree.joints().map(|j| j.name.as_str()).collect::<Vec<_>>(),
        "bodies": tree.bodies.iter().enumerate().map(body).collect::<Vec<_>>(),
        "touches_sand": {
            "shapes": touching.shapes.iter().map(|t| tree.bodies[t.0].shapes[t.1].name.as_str()).collect::<Vec<_>>(),
            "plates": touching.count(),
            "area": touching.area(),
        },
        "stance": {
            "height": import.stance.height,
            "leg_length": import.stance.leg_length,
            "legs": import.stance.legs.iter().map(|leg| names(leg)).collect::<Vec<_>>(),
            "feet": names(&import.stance.feet),
        },
        "found": {"rest": import.found.rest, "kp": import.found.kp, "kd": import.found.kd},
        "warnings": import.warnings,
    })
}
