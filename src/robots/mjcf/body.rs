//! `<body>`, `<joint>`, `<inertial>`: the links of the robot.

use super::actuator::limit;
use super::compiler::{Compiler, FromGeoms, limited};
use super::defaults::Defaults;
use super::geom::{Assets, Geom, geom, unreadable_look};
use crate::draft::{DraftLink, Inertial, MOST_LINKS, Visual, check_range_of, name_shapes, shift};
use crate::error::Result;
use crate::notes::Notes;
use crate::sim::tree::{JointKind, TreeJoint, TreeShape};
use crate::xml::Element;
use nalgebra::{Isometry3, Matrix3, Unit, UnitQuaternion, Vector3};
use std::collections::HashMap;

/// Elements for pictures, sensors and visibility, which have no effect on motion.
const PASSIVE: [&str; 3] = ["site", "camera", "light"];
const BODY_KNOWN: [&str; 11] =
    ["gravcomp", "name", "childclass", "pos", "quat", "axisangle", "euler", "xyaxes", "zaxis", "user", "sleep"];
const JOINT_KNOWN: [&str; 17] = [
    "name",
    "class",
    "type",
    "pos",
    "axis",
    "range",
    "limited",
    "ref",
    "damping",
    "frictionloss",
    "armature",
    "group",
    "user",
    "actuatorfrcrange",
    "actuatorfrclimited",
    "stiffness",
    "springref",
];

/// Attributes that a free joint has besides its freedom, and their effects.
const FREE_EFFECTS: [(&str, &str); 4] = [
    ("damping", "drag on the base"),
    ("armature", "the base has more inertia"),
    ("frictionloss", "friction holds the base"),
    ("stiffness", "a spring pulls the base to its place in the file"),
];

/// The geoms of a body.
struct BodyGeoms {
    /// Does the body have a mass from another source than its geoms?
    weighed: bool,
    read: Vec<Geom>,
}

pub struct Builder<'a> {
    pub compiler: &'a Compiler,
    pub defaults: &'a Defaults,
    pub assets: &'a Assets,
    pub notes: &'a mut Notes,
    pub links: Vec<DraftLink>,
    /// Positions of the joints in the reference pose, by name [rad or m].
    pub references: HashMap<String, f64>,
}

/// Does the body move freely?
pub fn is_free(body: &Element) -> bool {
    let free = |j: &Element| j.tag == "freejoint" || (j.tag == "joint" && j.get("type") == Some("free"));
    body.children.iter().any(free)
}

impl Builder<'_> {
    /// Adds a body and all that it carries; `at` is the pose of its parent's frame, or of a `<frame>`, in the link
    /// `parent`.
    pub fn body(&mut self, element: &Element, parent: Option<usize>, at: &Isometry3<f64>, class: &str) -> Result<()> {
        if self.links.len() > MOST_LINKS {
            return Err(element.error(format!("more than {MOST_LINKS} bodies")));
        }
        self.notes.others(element, &BODY_KNOWN);
        if element.get("mocap") == Some("true") {
            return Err(element.wrong("mocap", "is not simulated"));
        }
        let class = element.get("childclass").unwrap_or(class);
        let name = match element.get("name") {
            Some(name) => name.to_owned(),
            None => format!("body{}", self.links.len()),
        };
        let joints: Vec<&Element> =
            element.children.iter().filter(|c| c.tag == "joint" || c.tag == "freejoint").collect();
        let mut at = at * self.compiler.pose(element)?;
        let mut carrier = parent;
        match parent {
            None => {
                if let Some(extra) = joints.iter().find(|j| j.tag == "joint" && j.get("type") != Some("free")) {
                    return Err(extra.error("the base moves freely: it can have no other joint"));
                }
                for joint in joints.iter().filter(|j| j.tag == "joint") {
                    self.free_joint(&self.defaults.applied(joint, class)?)?;
                }
                at = Isometry3::identity();
            }
            Some(_) => {
                for (k, joint) in joints.iter().enumerate() {
                    let joint = self.defaults.applied(joint, class)?;
                    let anchor = Vector3::from(joint.numbers("pos")?.unwrap_or_default());
                    let (joint, start) = self.joint(&joint, &name, k)?;
                    let last = k + 1 == joints.len();
                    let link = if last { name.clone() } else { format!("{name}:{}", joint.name) };
                    let origin = at * shift(anchor) * start;
                    carrier = Some(
                        self.push(DraftLink { massless: !last, ..DraftLink::new(link, carrier, origin, Some(joint)) }),
                    );
                    at = shift(-anchor);
                }
            }
        }
        // Children of the body use the body's own frame, which is fixed to the frame of its last joint.
        let own = self.push(DraftLink::new(name, carrier, at, None));
        self.content(element, own, class)
    }

    /// Notes what a free joint does but free the base. MuJoCo takes it from default classes, too, and applies it to all six
    /// directions; a `<freejoint>` has none of it.
    fn free_joint(&mut self, joint: &Element) -> Result<()> {
        for (name, effect) in FREE_EFFECTS {
            if joint.list(name)?.is_some_and(|list| list.iter().any(|x| *x != 0.0)) {
                self.notes.not_simulated(format!("{name} of the base's free joint"), effect);
            }
        }
        Ok(())
    }

    fn push(&mut self, link: DraftLink) -> usize {
        self.links.push(link);
        self.links.len() - 1
    }

    fn content(&mut self, element: &Element, own: usize, class: &str) -> Result<()> {
        let given = element.first("inertial").filter(|_| self.compiler.from_geoms != FromGeoms::Always);
        let weighed = given.is_some() || self.compiler.from_geoms == FromGeoms::Never;
        let mut geoms = BodyGeoms { weighed, read: Vec::new() };
        self.inside(element, own, &Isometry3::identity(), class, &mut geoms, 0)?;
        let geoms = geoms.read;
        let inertial = match given {
            Some(inertial) => self.inertial(inertial)?,
            None if weighed => Inertial::none(),
            None => geoms.iter().fold(Inertial::none(), |sum, g| sum.with(&g.inertial)),
        };
        let inertial = self.bounded(inertial);
        match inertial.check() {
            Err(reason) => return Err(element.error(reason)),
            Ok(Some(doubt)) => self.notes.part("body", &self.links[own].name, doubt),
            Ok(None) => {}
        }
        let link = &mut self.links[own];
        link.inertial = inertial;
        link.held = element.number("gravcomp")?.unwrap_or(0.0);
        for geom in geoms {
            match geom.collision {
                Some(geometry) => {
                    let Geom { name, origin, friction, .. } = geom;
                    link.shapes.push(TreeShape { name, origin, geometry, friction });
                }
                None => link.visuals.push(Visual { origin: geom.origin, look: geom.look }),
            }
        }
        let name = link.name.clone();
        link.given = name_shapes(&name, &mut link.shapes);
        Ok(())
    }

    /// Geoms and bodies of a body, also those inside frames.
    fn inside(
        &mut self,
        element: &Element,
        own: usize,
        at: &Isometry3<f64>,
        class: &str,
        geoms: &mut BodyGeoms,
        depth: usize,
    ) -> Result<()> {
        for child in &element.children {
            match child.tag.as_str() {
                "geom" => {
                    let whole = self.defaults.applied(child, class)?;
                    if unreadable_look(&whole, self.assets, geoms.weighed, self.notes)? {
                        continue;
                    }
                    let read = geom(&whole, self.compiler, self.assets, self.notes)?;
                    geoms.read.push(Geom { origin: at * read.origin, inertial: read.inertial.moved(at), ..read });
                }
                "body" => self.body(child, Some(own), at, class)?,
                "frame" => {
                    let class = child.get("childclass").unwrap_or(class);
                    let at = at * self.compiler.pose(child)?;
                    self.inside(child, own, &at, class, geoms, depth + 1)?;
                }
                "joint" | "freejoint" | "inertial" if depth == 0 => {}
                tag if PASSIVE.contains(&tag) => self.notes.left_out(child),
                _ => return Err(child.error("is not read inside of a body")),
            }
        }
        Ok(())
    }

    /// Applies `compiler`'s rules for masses that are too small and inertias that are physically impossible.
    fn bounded(&self, own: Inertial) -> Inertial {
        let c = self.compiler;
        let mut new = Inertial { mass: own.mass.max(c.least_mass), ..own };
        let parts = own.inertia.symmetric_eigen();
        let mut moments: [f64; 3] = parts.eigenvalues.into();
        let mut changed = false;
        if moments.iter().any(|m| *m < c.least_inertia) {
            moments = moments.map(|m| m.max(c.least_inertia));
            changed = true;
        }
        let [a, b, d] = moments;
        if c.balance && (a + b < d || a + d < b || b + d < a) {
            moments = [(a + b + d) / 3.0; 3];
            changed = true;
        }
        if changed {
            let turn = parts.eigenvectors;
            new.inertia = turn * Matrix3::from_diagonal(&Vector3::from(moments)) * turn.transpose();
        }
        new
    }

    fn inertial(&self, element: &Element) -> Result<Inertial> {
        let mass = element.number("mass")?.ok_or_else(|| element.error("mass is missing"))?;
        let at = self.compiler.pose(element)?;
        let inertia = match (element.numbers::<3>("diaginertia")?, element.numbers::<6>("fullinertia")?) {
            (Some(moments), None) => Matrix3::from_diagonal(&Vector3::from(moments)),
            (None, Some([xx, yy, zz, xy, xz, yz])) => Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz),
            _ => return Err(element.error("needs either diaginertia or fullinertia")),
        };
        Ok(Inertial { mass, center: Vector3::zeros(), inertia }.moved(&at))
    }

    /// A joint, and the pose of its frame where its position is 0.
    fn joint(&mut self, element: &Element, body: &str, k: usize) -> Result<(TreeJoint, Isometry3<f64>)> {
        self.notes.others(element, &JOINT_KNOWN);
        let name = element.get("name").map_or_else(|| format!("{body}_joint{}", k + 1), str::to_owned);
        let (kind, unit) = match element.get("type").unwrap_or("hinge") {
            "hinge" => (JointKind::Hinge, self.compiler.angle),
            "slide" => (JointKind::Slide, 1.0),
            other => return Err(element.wrong("type", format!("{other:?} is not read here: hinge, slide"))),
        };
        // MuJoCo's default, and its bound for lengths (`mjEPS`).
        let axis = Vector3::from(element.numbers("axis")?.unwrap_or([0.0, 0.0, 1.0]));
        let axis = Unit::try_new(axis, 1e-14).ok_or_else(|| element.wrong("axis", "has no length"))?;
        let range = element.numbers::<2>("range")?.filter(|_| element.get("range").is_some());
        let mut joint = TreeJoint {
            name,
            kind,
            axis,
            range: None,
            damping: self.first(element, "damping")?,
            friction: element.not_negative("frictionloss")?.unwrap_or(0.0),
            spring: None,
            mimic: None,
            armature: element.not_negative("armature")?.unwrap_or(0.0),
            torque_limit: None,
            speed_limit: None,
            motor: Default::default(),
            kp: None,
            kd: None,
            rest: None,
            target_time: None,
        };
        if limited(element, "limited", range.is_some(), self.compiler.autolimits)? {
            let [low, high] = range.ok_or_else(|| element.error("is limited without a range"))?;
            if low >= high {
                return Err(element.wrong("range", format!("{low} is not below {high}")));
            }
            joint.range = Some([low * unit, high * unit]);
            check_range_of(&joint).map_err(|reason| element.wrong("range", reason))?;
        }
        let stiffness = self.first(element, "stiffness")?;
        if stiffness > 0.0 {
            joint.spring = Some([stiffness, element.number("springref")?.unwrap_or(0.0) * unit]);
        }
        let force = element.numbers::<2>("actuatorfrcrange")?;
        if limited(element, "actuatorfrclimited", force.is_some(), self.compiler.autolimits)? {
            limit(&mut joint, force, 1.0, self.notes);
        }
        let reference = element.number("ref")?.unwrap_or(0.0) * unit;
        self.references.insert(joint.name.clone(), reference);
        let start = match kind {
            JointKind::Hinge => {
                Isometry3::from_parts(Default::default(), UnitQuaternion::from_axis_angle(&axis, -reference))
            }
            JointKind::Slide => shift(axis.into_inner() * -reference),
        };
        Ok((joint, start))
    }

    /// The first of several coefficients. The coefficients of a nonlinear law are left out, with a note.
    fn first(&mut self, element: &Element, attribute: &str) -> Result<f64> {
        let list = element.list(attribute)?.unwrap_or_default();
        if list.iter().skip(1).any(|x| *x != 0.0) {
            let name = element.get("name").unwrap_or("without a name");
            self.notes.part("joint", name, format!("only the linear part of its {attribute} counts"));
        }
        match list.first() {
            Some(x) if *x < 0.0 => Err(element.wrong(attribute, format!("{x} is negative"))),
            other => Ok(other.copied().unwrap_or(0.0)),
        }
    }
}
