//! URDF (wiki.ros.org/urdf/XML), as urdfdom reads it.

use super::draft::{DraftLink, DraftShape, Inertial, MOST_LINKS, Visual, check_range_of, name_shapes};
use super::files::Files;
use super::mesh::{MeshFile, Meshes};
use super::mjcf;
use super::notes::Notes;
use super::shapes::collision_mesh;
use super::xml::{Element, QUOTED};
use crate::error::{Error, Result};
use crate::sim::tree::{Geometry, JointKind, Mimic, TreeJoint, TreeShape};
use nalgebra::{Isometry3, Matrix3, Translation3, Unit, UnitQuaternion, Vector3};
use std::collections::HashMap;

/// Friction of a shape whose file gives none: MuJoCo's default.
pub const FRICTION: f64 = 1.0;

struct UrdfReader<'a> {
    files: &'a Files,
    meshes: &'a mut Meshes,
    notes: &'a mut Notes,
}

/// A joint, with the indices of its parent link and its child link in the file.
struct UrdfJoint<'a> {
    element: &'a Element,
    parent: usize,
    child: usize,
}

/// The links of a file, each after its parent, and whether the file says that the base moves freely.
pub fn links(root: &Element, files: &Files, meshes: &mut Meshes, notes: &mut Notes) -> Result<(Vec<DraftLink>, bool)> {
    notes.other_children(root, &["link", "joint", "material", "mujoco"]);
    let elements: Vec<&Element> = root.all("link").collect();
    if elements.is_empty() {
        return Err(root.error("has no <link>"));
    }
    if elements.len() > MOST_LINKS {
        return Err(root.error(format!("{} links are more than {MOST_LINKS}", elements.len())));
    }
    let mut by_name = HashMap::new();
    for (i, element) in elements.iter().enumerate() {
        if by_name.insert(element.required("name")?, i).is_some() {
            return Err(element.error("a second link of this name"));
        }
    }
    check_open(root, &by_name)?;
    let joints = joints(root, &by_name)?;
    let mut order = ordered(root, &elements, &joints)?;
    let base_is_free = frees_base(&elements, &mut order)?;
    let mut place = vec![0; elements.len()];
    let mut reader = UrdfReader { files, meshes, notes };
    let mut links = Vec::with_capacity(order.len());
    for (link, joint) in order {
        place[link] = links.len();
        let parent = joint.map_or(0, |j: &UrdfJoint| place[j.parent]);
        links.push(reader.link(elements[link], joint.map(|j| j.element), parent)?);
    }
    Ok((links, base_is_free))
}

/// Gravity [m/s²] of the `<mujoco>` extension, as MuJoCo reads it from a URDF; None: the Earth's.
pub fn gravity(root: &Element, notes: &mut Notes) -> Result<Option<f64>> {
    let mut found = None;
    for extension in root.all("mujoco") {
        found = mjcf::gravity(extension, notes)?.or(found);
        extension.all("compiler").for_each(|compiler| notes.others(compiler, &["meshdir", "strippath"]));
        notes.other_children(extension, &["compiler", "option"]);
    }
    Ok(found)
}

/// Refuses xacro, from which programs of ROS make URDF: its properties, macros and substitutions are not known here.
pub fn check_expanded(element: &Element) -> Result<()> {
    let open = |(_, value): &(String, String)| value.contains("${") || value.contains("$(");
    if element.tag.contains("xacro:") || element.attributes.iter().any(open) {
        return Err(element.error(format!("is xacro: {RUN_XACRO}")));
    }
    // Programs that read these sections replace what is in them.
    let mut own = element.children.iter().filter(|c| !["gazebo", "ros2_control"].contains(&c.tag.as_str()));
    own.try_for_each(check_expanded)
}

/// The remedy for a file of xacro.
pub const RUN_XACRO: &str = "run xacro first (`xacro robot.urdf.xacro > robot.urdf`)";

/// A link in the file's order, and the joint that carries it.
type OrderedLink<'a, 'b> = (usize, Option<&'b UrdfJoint<'a>>);

/// Some files carry the base by a floating joint from a root that stands for the world. This removes the root and the
/// joint from the order, and returns whether they were there.
fn frees_base(elements: &[&Element], order: &mut Vec<OrderedLink>) -> Result<bool> {
    let floats = |j: &&UrdfJoint| j.element.get("type") == Some("floating");
    let Some(floating) = order.iter().find_map(|(_, joint)| joint.filter(floats)) else { return Ok(false) };
    let world = elements[order[0].0];
    let used = ["inertial", "collision"].iter().any(|tag| world.first(tag).is_some());
    let alone = order.iter().filter(|(_, joint)| joint.is_some_and(|j| j.parent == order[0].0)).count() == 1;
    if floating.parent != order[0].0 || used || !alone {
        return Err(floating.element.wrong(
            "type",
            "\"floating\" is read only between a root link without mass, shapes and other joints and the robot's base: \
             make the joint fixed, or replace it by prismatic and revolute joints",
        ));
    }
    order.remove(0);
    order[0].1 = None;
    Ok(true)
}

/// Refuses what closes a chain in other programs, as the reader of MJCF does: drake's `<loop_joint>`, and a `<joint>` of
/// `<gazebo>` between two links of the robot. A joint to the world or to a body beside the robot is left out with a warning.
fn check_open(root: &Element, by_name: &HashMap<&str, usize>) -> Result<()> {
    let called = |joint: &Element, tag: &str| {
        let end = joint.first(tag)?;
        let name = end.get("link").unwrap_or(&end.text);
        Some(name.rsplit("::").next().unwrap_or(name).to_owned())
    };
    // Of a text only the beginning is kept.
    let is_link = |name: &String| by_name.keys().any(|link| link.chars().take(QUOTED).eq(name.chars().take(QUOTED)));
    let loops = root.all("loop_joint").map(|joint| (joint, ["link1", "link2"].map(|tag| called(joint, tag))));
    let of_gazebo = root.all("gazebo").flat_map(|section| section.all("joint"));
    let of_gazebo = of_gazebo.map(|joint| (joint, ["parent", "child"].map(|tag| called(joint, tag))));
    let of_gazebo = of_gazebo.filter(|(_, ends)| ends.iter().all(|end| end.as_ref().is_some_and(is_link)));
    let Some((joint, ends)) = loops.chain(of_gazebo).next() else { return Ok(()) };
    let between = match ends {
        [Some(a), Some(b)] => format!(" between {a:?} and {b:?}"),
        _ => String::new(),
    };
    Err(joint.error(format!(
        "closes a chain{between}, which is not simulated: delete this element, and drive or fix the joints of one branch"
    )))
}

fn joints<'a>(root: &'a Element, by_name: &HashMap<&str, usize>) -> Result<Vec<UrdfJoint<'a>>> {
    let mut names = HashMap::new();
    let mut joints: Vec<UrdfJoint> = Vec::new();
    for element in root.all("joint") {
        if names.insert(element.required("name")?, ()).is_some() {
            return Err(element.error("a second joint of this name"));
        }
        let end = |tag: &str| {
            let inner = element.first(tag).ok_or_else(|| element.error(format!("has no <{tag}>")))?;
            let name = inner.required("link")?;
            by_name.get(name).copied().ok_or_else(|| inner.error(format!("there is no link {name:?}")))
        };
        joints.push(UrdfJoint { element, parent: end("parent")?, child: end("child")? });
    }
    Ok(joints)
}

/// Links from the root outward, each with the joint that carries it, in the file's order of joints.
fn ordered<'a, 'b>(
    root: &Element,
    elements: &[&Element],
    joints: &'b [UrdfJoint<'a>],
) -> Result<Vec<OrderedLink<'a, 'b>>> {
    let mut carried = vec![None; elements.len()];
    let mut children = vec![Vec::new(); elements.len()];
    for joint in joints {
        if carried[joint.child].replace(joint).is_some() {
            return Err(joint.element.error(
                "its child is carried by another joint already: a closed chain, which is not simulated; delete one of the two joints, \
                 and drive or fix the joints of one branch",
            ));
        }
        children[joint.parent].push(joint);
    }
    let roots: Vec<usize> = (0..elements.len()).filter(|i| carried[*i].is_none()).collect();
    let base = match roots[..] {
        [] => return Err(root.error("every link is some joint's child: the joints go in a circle")),
        [one] => one,
        [a, b, ..] => {
            let names = [a, b].map(|i| elements[i].get("name").unwrap_or_default());
            return Err(
                root.error(format!("neither {:?} nor {:?} has a parent: the file has two robots", names[0], names[1]))
            );
        }
    };
    let (mut order, mut left) = (Vec::new(), vec![(base, None)]);
    while let Some((link, joint)) = left.pop() {
        order.push((link, joint));
        left.extend(children[link].iter().rev().map(|j| (j.child, Some(*j))));
    }
    if order.len() < elements.len() {
        let lost = joints.iter().find(|j| !order.iter().any(|(link, _)| *link == j.child));
        let lost = lost.map_or(root, |j| j.element);
        return Err(lost.error("is not connected to the root: the joints go in a circle"));
    }
    Ok(order)
}

/// `<origin xyz rpy>` of an element; rpy: about fixed x, then y, then z.
fn origin(element: &Element) -> Result<Isometry3<f64>> {
    let Some(origin) = element.first("origin") else { return Ok(Isometry3::identity()) };
    let [x, y, z] = origin.numbers("xyz")?.unwrap_or_default();
    let [roll, pitch, yaw] = origin.numbers("rpy")?.unwrap_or_default();
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_euler_angles(roll, pitch, yaw)))
}

fn mimic(element: &Element) -> Result<Mimic> {
    let number = |name: &str, usual: f64| Ok::<_, Error>(element.number(name)?.unwrap_or(usual));
    let leader = element.required("joint")?.to_owned();
    Ok(Mimic { leader, ratio: number("multiplier", 1.0)?, offset: number("offset", 0.0)? })
}

impl UrdfReader<'_> {
    fn link(&mut self, element: &Element, joint: Option<&Element>, parent: usize) -> Result<DraftLink> {
        let name = element.required("name")?.to_owned();
        self.notes.other_children(element, &["inertial", "visual", "collision", "contact"]);
        let inertial = self.inertial(element, joint)?;
        let friction = match element.first("contact").and_then(|c| c.first("lateral_friction")) {
            Some(given) => given.not_negative("value")?.unwrap_or(FRICTION),
            None => FRICTION,
        };
        let mut shapes = Vec::new();
        for collision in element.all("collision") {
            let name = collision.get("name").unwrap_or_default().to_owned();
            let geometry = match self.look(collision)? {
                DraftShape::Shape(geometry) => geometry,
                DraftShape::Mesh(file) => {
                    collision_mesh(self.meshes, &file, self.notes).map_err(|e| collision.error(e))?
                }
            };
            shapes.push(TreeShape { name, origin: origin(collision)?, geometry, friction });
        }
        let given = name_shapes(&name, &mut shapes);
        let mut visuals = Vec::new();
        for visual in element.all("visual") {
            // Motion does not use visuals, so one that cannot be read does not refuse the robot.
            match origin(visual).and_then(|origin| Ok(Visual { origin, look: self.look(visual)? })) {
                Ok(visual) => visuals.push(visual),
                Err(reason) => self.notes.undrawn(&reason),
            }
        }
        // A link none of whose visuals can be read is drawn by its collision shapes, so that no part is missing in pictures.
        if visuals.is_empty() && !shapes.is_empty() && element.first("visual").is_some() {
            self.notes.part("link", &name, "its visuals cannot be read, so its collision shapes are drawn");
            let look = |s: &TreeShape| Visual { origin: s.origin, look: DraftShape::Shape(s.geometry.clone()) };
            visuals.extend(shapes.iter().map(look));
        }
        let at = joint.map_or(Ok(Isometry3::identity()), origin)?;
        let joint = joint.map(|j| self.joint(j)).transpose()?.flatten();
        let massless = element.first("inertial").is_none();
        let own = DraftLink::new(name, Some(parent), at, joint);
        Ok(DraftLink { massless, inertial, shapes, given, visuals, ..own })
    }

    fn inertial(&mut self, element: &Element, joint: Option<&Element>) -> Result<Inertial> {
        let Some(inertial) = element.first("inertial") else { return Ok(Inertial::none()) };
        let part = |tag: &str| inertial.first(tag).ok_or_else(|| element.error(format!("<inertial> has no <{tag}>")));
        let mass = part("mass")?.number("value")?.ok_or_else(|| inertial.error("mass has no value"))?;
        let tensor = part("inertia")?;
        let entry = |name: &str| tensor.number(name)?.ok_or_else(|| tensor.error(format!("{name} is missing")));
        let [xx, xy, xz] = [entry("ixx")?, entry("ixy")?, entry("ixz")?];
        let [yy, yz, zz] = [entry("iyy")?, entry("iyz")?, entry("izz")?];
        let inertia = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        let own = Inertial { mass, center: Vector3::zeros(), inertia };
        let moves = joint.is_some_and(|j| j.get("type") != Some("fixed"));
        if moves && mass == 0.0 {
            return Err(element.error("a link that moves has mass 0 (one without mass has no <inertial>)"));
        }
        match own.check() {
            Err(reason) => return Err(element.error(reason)),
            Ok(Some(doubt)) => self.notes.part("link", element.required("name")?, doubt),
            Ok(None) => {}
        }
        Ok(own.moved(&origin(inertial)?))
    }

    /// The geometry of a visual or a collision; a mesh file must exist.
    fn look(&mut self, element: &Element) -> Result<DraftShape> {
        let geometry = element.first("geometry").ok_or_else(|| element.error("has no <geometry>"))?;
        let [shape] = &geometry.children[..] else {
            return Err(geometry.error(format!("{} shapes in place of 1", geometry.children.len())));
        };
        let length = |name: &str| {
            let value = shape.number(name)?.ok_or_else(|| shape.error(format!("{name} is missing")))?;
            shape.length(name, value)
        };
        Ok(DraftShape::Shape(match shape.tag.as_str() {
            "sphere" => Geometry::Sphere { radius: length("radius")? },
            "cylinder" => Geometry::Cylinder { radius: length("radius")?, half_length: length("length")? / 2.0 },
            // Capsules are not in the standard, but drake and Isaac read them: `length` is without the caps.
            "capsule" => Geometry::Capsule { radius: length("radius")?, half_length: length("length")? / 2.0 },
            "box" => {
                let size = shape.numbers::<3>("size")?.ok_or_else(|| shape.error("size is missing"))?;
                for side in size {
                    shape.length("size", side)?;
                }
                Geometry::Box { half: Vector3::from(size) / 2.0 }
            }
            "mesh" => {
                let name = shape.required("filename")?;
                let path = self.files.find("", name).map_err(|e| shape.error(e))?;
                let scale = Vector3::from(shape.numbers("scale")?.unwrap_or([1.0; 3]));
                // Our choice of the bound: it catches mistakes; files in millimetres have 0.001.
                if scale.iter().any(|s| *s == 0.0 || s.abs() > 1e4) {
                    return Err(shape.wrong("scale", "must not be 0, nor larger than 10000"));
                }
                return Ok(DraftShape::Mesh(MeshFile { path, scale }));
            }
            _ => return Err(shape.error("is no shape that is read: box, cylinder, sphere, capsule, mesh")),
        }))
    }

    /// Reads a joint; None if it is fixed.
    fn joint(&mut self, element: &Element) -> Result<Option<TreeJoint>> {
        let known = ["origin", "parent", "child", "axis", "limit", "dynamics", "mimic", "safety_controller"];
        self.notes.other_children(element, &known);
        element.all("safety_controller").for_each(|controller| self.notes.others(controller, &["k_position"]));
        let name = element.required("name")?;
        let kind = match element.required("type")? {
            "fixed" => return Ok(None),
            "revolute" | "continuous" => JointKind::Hinge,
            "prismatic" => JointKind::Slide,
            other => {
                return Err(
                    element.wrong("type", format!("{other:?} is not read: revolute, continuous, prismatic, fixed"))
                );
            }
        };
        let mimic = element.first("mimic").map(mimic).transpose()?;
        // URDF's default. Our choice of the least length: a shorter axis is rounding.
        let axis = match element.first("axis") {
            Some(axis) => axis.numbers("xyz")?.ok_or_else(|| axis.error("xyz is missing"))?,
            None => [1.0, 0.0, 0.0],
        };
        let axis = Unit::try_new(Vector3::from(axis), 1e-9).ok_or_else(|| element.error("its axis has no length"))?;
        let mut joint = TreeJoint {
            name: name.to_owned(),
            kind,
            axis,
            range: None,
            damping: 0.0,
            friction: 0.0,
            spring: None,
            mimic,
            armature: 0.0,
            torque_limit: None,
            speed_limit: None,
            motor: Default::default(),
            kp: None,
            kd: None,
            rest: None,
            target_time: None,
        };
        if let Some(dynamics) = element.first("dynamics") {
            self.notes.others(dynamics, &["damping", "friction"]);
            joint.damping = dynamics.not_negative("damping")?.unwrap_or(0.0);
            joint.friction = dynamics.not_negative("friction")?.unwrap_or(0.0);
        }
        self.limits(element, &mut joint)?;
        Ok(Some(joint))
    }

    fn limits(&mut self, element: &Element, joint: &mut TreeJoint) -> Result<()> {
        let (name, free) = (joint.name.clone(), element.get("type") == Some("continuous"));
        let Some(limit) = element.first("limit") else {
            if !free {
                self.notes.part("joint", &name, "no <limit>; it moves freely");
            }
            return Ok(());
        };
        let mut most = |attribute: &str| {
            let value = limit.not_negative(attribute)?;
            if value == Some(0.0) {
                self.notes.part("joint", &name, format!("{attribute} 0 is taken as no limit"));
            }
            Ok::<_, Error>(value.filter(|v| *v > 0.0))
        };
        (joint.torque_limit, joint.speed_limit) = (most("effort")?, most("velocity")?);
        let ends = [limit.number("lower")?.unwrap_or(0.0), limit.number("upper")?.unwrap_or(0.0)];
        if free {
            return Ok(());
        }
        if ends[0] > ends[1] {
            return Err(limit.error(format!("joint {name}: lower {} is above upper {}", ends[0], ends[1])));
        }
        joint.range = Some(ends).filter(|e| e[0] < e[1]);
        check_range_of(joint).map_err(|reason| limit.error(reason))?;
        if joint.range.is_none() {
            self.notes.part("joint", &name, "lower = upper is taken as no limit");
        }
        Ok(())
    }
}
