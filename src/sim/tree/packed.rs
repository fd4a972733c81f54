//! A tree robot as one text, which a client sends to a server: `tree:` and a zlib stream of JSON in base64. Instead of
//! meshes it contains their plates and points of contact, and only small meshes for pictures.
//!
//! So a server reads no file that a client names, no XML and no mesh, and checks numbers only.

use super::contact::{ContactPoint, contact_points};
use super::looks::Looks;
use super::model::TreeModel;
use super::{Geometry, HeldMass, JointKind, Mimic, Tree, TreeBody, TreeJoint, TreeShape};
use crate::actuator::Actuator;
use crate::error::{Error, Result, check_range};
use crate::number::Vec3;
use crate::sand::intruder::IntruderPlate;
use base64::prelude::{BASE64_STANDARD, Engine as _};
use nalgebra::{Isometry3, Matrix3, Quaternion, Unit, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use std::io::{Read, Write};

/// Longest JSON [bytes]: our choice, more than a robot with [`MOST_PIECES`] needs.
const MOST_BYTES: usize = 6 << 20;
/// Longest packed text [bytes]: our choice, which leaves room for other options within a session's limit of 256 KiB.
const MOST_PACKED: usize = 224 << 10;
/// The prefix of packed texts.
const MARK: &str = "tree:";
/// Largest number of a robot's bodies: our choice, far beyond what can be simulated in real time.
const MOST_BODIES: usize = 256;
/// Largest number of a robot's plates and points of contact together: our choice, also far beyond real time.
const MOST_PIECES: usize = 20_000;
/// Largest number of a robot's primitive shapes: our choice. They are for pictures alone, and more would cost memory
/// and time.
const MOST_SHAPES: usize = 4_096;
/// Longest name of the robot, a body, a joint or a shape [bytes]: our choice, because error messages quote names whole.
const LONGEST_NAME: usize = 200;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PackedTree {
    name: String,
    bodies: Vec<PackedBody>,
    /// Shapes for pictures; None: the primitives among the bodies' shapes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    looks: Option<Looks>,
    /// [m/s²]; None: the Earth's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    gravity: Option<f64>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PackedBody {
    name: String,
    parent: usize,
    /// Position [m] and quaternion w, x, y, z.
    origin: [f64; 7],
    joint: Option<PackedJoint>,
    mass: f64,
    center: [f64; 3],
    /// xx, yy, zz, xy, xz, yz.
    inertia: [f64; 6],
    /// Mass without weight, and its moment.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    held: Option<[f64; 4]>,
    shapes: Vec<PackedShape>,
    /// Centre, radius, friction, axis (zero: a ball).
    contacts: Vec<[f64; 8]>,
    /// Centre, normal, area, two half sides, two bends.
    plates: Vec<[f64; 15]>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PackedJoint {
    name: String,
    slides: bool,
    axis: [f64; 3],
    range: Option<[f64; 2]>,
    damping: f64,
    friction: f64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    spring: Option<[f64; 2]>,
    /// Leader, ratio and offset.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    mimic: Option<(String, f64, f64)>,
    armature: f64,
    torque_limit: Option<f64>,
    speed_limit: Option<f64>,
    #[serde(default, skip_serializing_if = "is_unknown")]
    motor: Actuator,
    kp: Option<f64>,
    kd: Option<f64>,
    rest: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    target_time: Option<f64>,
}

fn is_unknown(motor: &Actuator) -> bool {
    *motor == Actuator::default()
}

/// A shape that is not a mesh, for pictures.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PackedShape {
    name: String,
    origin: [f64; 7],
    kind: PackedForm,
    /// Radius and half length, or half sides [m].
    size: [f64; 3],
    friction: f64,
}

#[derive(Clone, Copy, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum PackedForm {
    Sphere,
    Capsule,
    Cylinder,
    Box,
}

/// Packs `tree` with the plates of each body. `looks` has the shapes for pictures; None: the tree's primitives suffice.
pub fn pack(tree: &Tree, plates: &[Vec<IntruderPlate>], looks: Option<&Looks>) -> Result<String> {
    let contacts = contact_points(tree);
    let bodies = tree.bodies.iter().enumerate().map(|(i, b)| body(b, &contacts[i], &plates[i])).collect();
    let packed = PackedTree { name: tree.name.clone(), bodies, looks: looks.cloned(), gravity: tree.gravity };
    serde_json::to_string(&packed).map_err(|e| Error::invalid("robot", e.to_string()))
}

fn body(b: &TreeBody, contacts: &[ContactPoint], plates: &[IntruderPlate]) -> PackedBody {
    PackedBody {
        name: b.name.clone(),
        parent: b.parent,
        origin: place(&b.origin),
        joint: b.joint.as_ref().map(joint),
        mass: b.mass,
        center: b.center.into(),
        inertia: [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)].map(|at| b.inertia[at]),
        held: (b.held != HeldMass::default()).then(|| {
            let [x, y, z] = b.held.moment.into();
            [b.held.mass, x, y, z]
        }),
        shapes: b.shapes.iter().filter_map(shape).collect(),
        contacts: contacts.iter().map(contact).collect(),
        plates: plates.iter().map(plate).collect(),
    }
}

/// The text of [`pack`], compressed; `plates` is the number of the robot's plates.
pub fn compressed(text: &str, plates: usize) -> Result<String> {
    let mut stream = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
    let bytes = stream.write_all(text.as_bytes()).and_then(|()| stream.finish());
    let bytes = bytes.map_err(|e| Error::invalid("robot", e.to_string()))?;
    let packed = format!("{MARK}{}", BASE64_STANDARD.encode(bytes));
    match packed.len() <= MOST_PACKED {
        true => Ok(packed),
        false => {
            let (found, most) = (packed.len() >> 10, MOST_PACKED >> 10);
            let reason = format!(
                "{plates} plates make a robot of {found} KiB, and {most} KiB are allowed: give a larger size, or fewer bodies with touches"
            );
            Err(Error::invalid("plate-size", reason))
        }
    }
}

/// Does this text claim to be a packed robot? It may still be broken.
pub fn is_packed(text: &str) -> bool {
    text.starts_with(MARK)
}

/// Refuses a robot that [`unpack`] would refuse because of its numbers.
pub fn check(tree: &Tree) -> Result<()> {
    check_range("number of bodies", tree.bodies.len() as f64, 1.0..=MOST_BODIES as f64)?;
    tree.bodies.iter().try_for_each(|b| body(b, &[], &[]).check())
}

/// Reads a text of [`compressed`].
pub fn unpack_compressed(text: &str) -> Result<TreeModel> {
    let broken = |e: &dyn std::fmt::Display| Error::invalid("robot", format!("not a packed robot: {e}"));
    let bytes = BASE64_STANDARD.decode(text.trim_start_matches(MARK).trim()).map_err(|e| broken(&e))?;
    let mut json = String::new();
    // Unpacks at most one byte more than allowed, so that a longer text is noticed and the unpacked size is limited.
    let most = MOST_BYTES as u64 + 1;
    flate2::read::ZlibDecoder::new(&bytes[..]).take(most).read_to_string(&mut json).map_err(|e| broken(&e))?;
    unpack(&json)
}

/// Reads a text of [`pack`] and checks every number.
pub fn unpack(text: &str) -> Result<TreeModel> {
    if text.len() > MOST_BYTES {
        return Err(Error::invalid("robot", format!("{} bytes are more than {MOST_BYTES}", text.len())));
    }
    let PackedTree { name, bodies, looks, gravity } =
        serde_json::from_str(text).map_err(|e| Error::invalid("robot", format!("not a packed robot: {e}")))?;
    check_range("number of bodies", bodies.len() as f64, 1.0..=MOST_BODIES as f64)?;
    let pieces: usize = bodies.iter().map(|b| b.contacts.len() + b.plates.len()).sum();
    check_range("number of plates and points", pieces as f64, 0.0..=MOST_PIECES as f64)?;
    let shapes: usize = bodies.iter().map(|b| b.shapes.len()).sum();
    check_range("number of shapes", shapes as f64, 0.0..=MOST_SHAPES as f64)?;
    check_name(&name)?;
    gravity.map(check_gravity).transpose()?;
    bodies.iter().try_for_each(PackedBody::check)?;
    let count = bodies.len();
    looks.iter().try_for_each(|looks| looks.check(count))?;
    let contacts = bodies.iter().map(|b| b.contacts.iter().map(contact_of).collect()).collect();
    let plates = bodies.iter().map(|b| b.plates.iter().map(plate_of).collect()).collect();
    let tree = Tree { name, bodies: bodies.into_iter().map(PackedBody::unpacked).collect(), gravity };
    let model = TreeModel::with_contacts(tree, plates, contacts)?;
    match looks {
        Some(looks) => Ok(model.with_looks(looks)),
        None => model.looks.check(count).map(|()| model),
    }
}

fn check_name(name: &str) -> Result<()> {
    check_range("length of a name", name.len() as f64, 0.0..=LONGEST_NAME as f64).map(drop)
}

/// Gravity at which a robot can walk [m/s²]: our choice, from that of an asteroid of 50 km to four times Jupiter's.
pub fn check_gravity(gravity: f64) -> Result<f64> {
    check_range("gravity", gravity, 0.01..=100.0)
}

impl PackedBody {
    fn check(&self) -> Result<()> {
        let joint_name = self.joint.iter().map(|j| &j.name);
        let mut names = self.shapes.iter().map(|s| &s.name).chain(joint_name).chain([&self.name]);
        names.try_for_each(|name| check_name(name))?;
        let joint = self.joint.iter().flat_map(|j| {
            let options = [j.torque_limit, j.speed_limit, j.kp, j.kd, j.rest].into_iter().flatten();
            let range = j.range.into_iter().flatten();
            j.axis.into_iter().chain([j.damping, j.friction, j.armature]).chain(options).chain(range)
        });
        let pieces = self.contacts.iter().flatten().chain(self.plates.iter().flatten()).copied();
        let shapes = self.shapes.iter().flat_map(|s| s.origin.into_iter().chain(s.size).chain([s.friction]));
        let own = self.origin.into_iter().chain(self.center).chain(self.inertia).chain(self.held.into_iter().flatten());
        // The bound is far beyond any robot. Joint limits may be large, because some files write a large number for "no limit".
        for x in own.chain(joint).chain(pieces).chain(shapes) {
            check_range(&format!("a number of {}", self.name), x, -1e12..=1e12)?;
        }
        let unit = |what: &str, square: f64| check_range(&format!("{what} of {}", self.name), square, 0.99..=1.01);
        unit("orientation", self.origin[3..].iter().map(|x| x * x).sum())?;
        for shape in &self.shapes {
            unit("orientation of a shape", shape.origin[3..].iter().map(|x| x * x).sum())?;
        }
        let Some(joint) = &self.joint else { return Ok(()) };
        let name = |what: &str| format!("{what} of {}", joint.name);
        joint.motor.validate(&joint.name)?;
        unit("axis", joint.axis.iter().map(|x| x * x).sum())?;
        for (what, x) in [("damping", joint.damping), ("friction", joint.friction), ("armature", joint.armature)] {
            check_range(&name(what), x, 0.0..=1e9)?;
        }
        for (what, x) in [("kp", joint.kp), ("kd", joint.kd)] {
            check_range(&name(what), x.unwrap_or(0.0), 0.0..=1e9)?;
        }
        for (what, x) in [("torque_limit", joint.torque_limit), ("speed_limit", joint.speed_limit)] {
            check_range(&name(what), x.unwrap_or(1.0), 1e-9..=1e12)?;
        }
        check_range(&name("target_time"), joint.target_time.unwrap_or(0.0), 0.0..=10.0)?;
        let [stiffness, rest] = joint.spring.unwrap_or_default();
        check_range(&name("spring"), stiffness, 0.0..=1e9)?;
        check_range(&name("spring"), rest, -1e6..=1e6)?;
        if let Some((_, ratio, offset)) = joint.mimic {
            check_range(&name("mimic"), ratio, -1e3..=1e3)?;
            check_range(&name("mimic"), offset, -1e3..=1e3)?;
        }
        let [low, high] = joint.range.unwrap_or_default();
        check_range(&name("range"), high, low..=1e12).map(drop)
    }

    fn unpacked(self) -> TreeBody {
        let [xx, yy, zz, xy, xz, yz] = self.inertia;
        TreeBody {
            name: self.name,
            parent: self.parent,
            origin: place_of(&self.origin),
            joint: self.joint.map(joint_of),
            mass: self.mass,
            center: self.center.into(),
            inertia: Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz),
            held: self
                .held
                .map_or_else(HeldMass::default, |[mass, x, y, z]| HeldMass { mass, moment: Vector3::new(x, y, z) }),
            shapes: self.shapes.into_iter().map(shape_of).collect(),
        }
    }
}

fn place(at: &Isometry3<f64>) -> [f64; 7] {
    let ([x, y, z], q) = (at.translation.vector.into(), at.rotation);
    [x, y, z, q.w, q.i, q.j, q.k]
}

fn place_of(&[x, y, z, w, i, j, k]: &[f64; 7]) -> Isometry3<f64> {
    Isometry3::from_parts(Vector3::new(x, y, z).into(), UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k)))
}

fn joint(j: &TreeJoint) -> PackedJoint {
    PackedJoint {
        name: j.name.clone(),
        slides: j.kind == JointKind::Slide,
        axis: j.axis.into_inner().into(),
        range: j.range,
        damping: j.damping,
        friction: j.friction,
        spring: j.spring,
        mimic: j.mimic.as_ref().map(|m| (m.leader.clone(), m.ratio, m.offset)),
        armature: j.armature,
        torque_limit: j.torque_limit,
        speed_limit: j.speed_limit,
        motor: j.motor,
        kp: j.kp,
        kd: j.kd,
        rest: j.rest,
        target_time: j.target_time,
    }
}

fn joint_of(j: PackedJoint) -> TreeJoint {
    TreeJoint {
        name: j.name,
        kind: if j.slides { JointKind::Slide } else { JointKind::Hinge },
        axis: Unit::new_normalize(j.axis.into()),
        range: j.range,
        damping: j.damping,
        friction: j.friction,
        spring: j.spring,
        mimic: j.mimic.map(|(leader, ratio, offset)| Mimic { leader, ratio, offset }),
        armature: j.armature,
        torque_limit: j.torque_limit,
        speed_limit: j.speed_limit,
        motor: j.motor,
        kp: j.kp,
        kd: j.kd,
        rest: j.rest,
        target_time: j.target_time,
    }
}

fn shape(s: &TreeShape) -> Option<PackedShape> {
    let (kind, size) = match s.geometry {
        Geometry::Sphere { radius } => (PackedForm::Sphere, [radius, 0.0, 0.0]),
        Geometry::Capsule { radius, half_length } => (PackedForm::Capsule, [radius, half_length, 0.0]),
        Geometry::Cylinder { radius, half_length } => (PackedForm::Cylinder, [radius, half_length, 0.0]),
        Geometry::Box { half } => (PackedForm::Box, half.into()),
        Geometry::Mesh(_) => return None,
    };
    Some(PackedShape { name: s.name.clone(), origin: place(&s.origin), kind, size, friction: s.friction })
}

fn shape_of(s: PackedShape) -> TreeShape {
    let [radius, half_length, _] = s.size;
    let geometry = match s.kind {
        PackedForm::Sphere => Geometry::Sphere { radius },
        PackedForm::Capsule => Geometry::Capsule { radius, half_length },
        PackedForm::Cylinder => Geometry::Cylinder { radius, half_length },
        PackedForm::Box => Geometry::Box { half: s.size.into() },
    };
    TreeShape { name: s.name, origin: place_of(&s.origin), geometry, friction: s.friction }
}

fn contact(c: &ContactPoint) -> [f64; 8] {
    let ([x, y, z], [i, j, k]) = (c.center.into(), c.axis.unwrap_or_default().into());
    [x, y, z, c.radius, c.friction, i, j, k]
}

fn contact_of(&[x, y, z, radius, friction, i, j, k]: &[f64; 8]) -> ContactPoint {
    let axis = Vector3::new(i, j, k).try_normalize(1e-6);
    ContactPoint { center: Vector3::new(x, y, z), radius, axis, friction }
}

/// Rounds to six digits, fewer than single precision has, and more than any shape is known to.
fn plate(p: &IntruderPlate) -> [f64; 15] {
    let [c, n, a, b] = [p.center, p.normal, p.half[0], p.half[1]].map(|v| v.lane(0));
    let all = [c[0], c[1], c[2], n[0], n[1], n[2], p.area, a[0], a[1], a[2], b[0], b[1], b[2], p.bend[0], p.bend[1]];
    all.map(|x| format!("{x:.5e}").parse().unwrap_or(0.0))
}

fn plate_of(p: &[f64; 15]) -> IntruderPlate {
    let vector = |i: usize| Vec3::new(p[i], p[i + 1], p[i + 2]);
    IntruderPlate {
        center: vector(0),
        normal: vector(3),
        area: p[6],
        half: [vector(7), vector(10)],
        bend: [p[13], p[14]],
    }
}
