//! MJCF (mujoco.readthedocs.io, "XML reference"), as MuJoCo 4.0 compiles it.

mod actuator;
mod body;
mod compiler;
mod defaults;
mod equality;
mod geom;
mod inertia;

use super::draft::{BaseFrame, DraftLink, Inertial, Merged, merged};
use super::files::{Files, MOST_TEXT, SourceFile};
use super::mesh::Meshes;
use super::notes::Notes;
use super::xml::{self, Element};
use crate::error::Result;
use crate::sim::tree::packed;
use actuator::Actuators;
use body::Builder;
use compiler::Compiler;
use defaults::Defaults;
use nalgebra::Isometry3;
use std::collections::{HashMap, HashSet};
use std::ops::RangeInclusive;
use std::path::PathBuf;

/// Sections that are refused, because leaving them out would change how the robot moves.
const REFUSED: [&str; 2] = ["deformable", "extension"];
/// Sections that are read.
const READ: [&str; 9] =
    ["option", "equality", "compiler", "default", "asset", "worldbody", "actuator", "keyframe", "include"];
/// Largest number of files of a model: our choice, to bound the time of reading.
const MOST_FILES: usize = 50;
/// Largest number of elements of a model with all its includes: our choice, as for one file.
const MOST_ELEMENTS: usize = 200_000;

/// The robot of a file.
pub fn robot(
    root: Element,
    name: &str,
    main: PathBuf,
    files: &Files,
    meshes: &mut Meshes,
    notes: &mut Notes,
) -> Result<(Merged, Vec<DraftLink>)> {
    let mut including = Including { files, notes, seen: HashSet::from([main]), elements: 0 };
    let mut root = including.expanded(root)?;
    let gravity = gravity(&root, notes)?;
    for section in &root.children {
        let tag = section.tag.as_str();
        if REFUSED.contains(&tag) && !section.children.is_empty() {
            return Err(section.error(format!("<{}> is not simulated", section.children[0].tag)));
        }
        let levers = tag == "tendon" && section.children.iter().all(actuator::is_lever);
        if !READ.contains(&tag) && !levers {
            notes.left_out(section);
        }
    }
    let paired: HashSet<String> = root.all("contact").flat_map(|section| section.all("pair")).flat_map(ends).collect();
    collide(&mut root, &paired);
    equality::check(&root, notes)?;
    let compiler = Compiler::read(&root, notes)?;
    let defaults = Defaults::read(&root)?;
    let mut reader = geom::GeomReader { compiler: &compiler, files, meshes, notes };
    let mut assets = geom::Assets::new();
    for asset in root.all("asset").flat_map(|section| section.all("mesh")) {
        let (name, mesh) = reader.mesh(&defaults.applied(asset, "")?)?;
        if assets.insert(name, mesh).is_some() {
            return Err(asset.error("a second mesh of this name"));
        }
    }
    let (base, beside) = base(&root, notes)?;
    let (links, references) = (Vec::new(), HashMap::new());
    let mut builder = Builder { compiler: &compiler, defaults: &defaults, assets: &assets, notes, links, references };
    builder.body(base.element, None, &Isometry3::identity(), &base.class)?;
    let Builder { mut links, references, .. } = builder;
    if let Some(wanted) = compiler.total_mass {
        rescale(&mut links, wanted);
    }
    let name = root.get("model").unwrap_or(name);
    let mut merged = merged(name, &links, BaseFrame::default())?;
    (merged.base_is_free, merged.tree.gravity) = (base.free, gravity);
    let mut actuators = Actuators { defaults: &defaults, autolimits: compiler.autolimits, notes, ratios: Vec::new() };
    actuators.apply(&root, &mut merged.tree, &beside.joints)?;
    actuators.damp(&mut merged.tree, &references, base.free);
    actuator::rest(&root, &mut merged.tree, beside.positions, notes)?;
    equality::apply(&root, &mut merged.tree)?;
    Ok((merged, links))
}

/// Gravity on the Earth's surface, from Nevado Huascarán to the Arctic Ocean [m/s²] (Hirt et al., Geophys. Res. Lett. 40
/// (2013) 4279). Within it, differences between files are rounding, and gravity is the standard one.
const EARTH: RangeInclusive<f64> = 9.76..=9.84;

/// Gravity of the file [m/s²]; None: the Earth's, also MuJoCo's default.
pub fn gravity(root: &Element, notes: &mut Notes) -> Result<Option<f64>> {
    let mut found = None;
    for option in root.all("option") {
        notes.others(option, &["gravity"]);
        if let Some([x, y, z]) = option.numbers("gravity")? {
            if x != 0.0 || y != 0.0 {
                let reason = "must point along −z; option slope_deg inclines the ground";
                return Err(option.wrong("gravity", reason));
            }
            packed::check_gravity(-z).map_err(|e| option.error(format!("a robot cannot walk: {e} downward")))?;
            found = Some(-z).filter(|g| !EARTH.contains(g));
        }
        for flag in option.all("flag") {
            notes.others(flag, &["gravity", "equality"]);
            if flag.get("gravity") == Some("disable") {
                return Err(flag.wrong("gravity", "is switched off: a robot cannot walk without it"));
            }
        }
    }
    if let Some(gravity) = found {
        notes.say(format!("gravity is {gravity} m/s², as in the file; the sand's stress is in proportion to it"));
    }
    Ok(found)
}

/// The two geoms of a `<pair>`.
fn ends(pair: &Element) -> impl Iterator<Item = String> {
    ["geom1", "geom2"].into_iter().filter_map(|end| pair.get(end)).map(str::to_owned)
}

/// Lets the geoms called `paired` collide: in MuJoCo, a `<pair>` collides whatever the `contype` and `conaffinity` of its geoms.
fn collide(element: &mut Element, paired: &HashSet<String>) {
    for child in &mut element.children {
        if child.tag == "geom" && child.get("name").is_some_and(|name| paired.contains(name)) {
            child.set("contype", "1");
        }
        collide(child, paired);
    }
}

/// Scales all masses so that their sum is `wanted`, the file's `settotalmass`.
fn rescale(links: &mut [DraftLink], wanted: f64) {
    let factor = wanted / links.iter().map(|l| l.inertial.mass).sum::<f64>();
    if factor.is_finite() {
        for link in links {
            let Inertial { mass, center, inertia } = link.inertial;
            link.inertial = Inertial { mass: mass * factor, center, inertia: inertia * factor };
        }
    }
}

struct MjcfBase<'a> {
    element: &'a Element,
    class: String,
    free: bool,
}

/// The joints of the other bodies of the world, which are left out.
#[derive(Default)]
struct BesideRobot {
    joints: HashSet<String>,
    /// Numbers of positions that a keyframe has for the bodies before and after the robot.
    positions: [usize; 2],
}

/// The robot's base: the only body of the world that moves freely and carries joints. Other free bodies, such as a ball, are left out.
fn base<'a>(root: &'a Element, notes: &mut Notes) -> Result<(MjcfBase<'a>, BesideRobot)> {
    let mut bodies = Vec::new();
    for world in root.all("worldbody") {
        top(world, "", &mut bodies, notes)?;
    }
    let free = |i: &usize| body::is_free(bodies[*i].element);
    let carries = |i: &usize| joints(bodies[*i].element, &mut HashSet::new()) > FREE;
    let mut free: Vec<usize> = (0..bodies.len()).filter(free).collect();
    if free.iter().any(carries) {
        free.retain(carries);
    }
    let chosen = match (&free[..], bodies.len()) {
        ([one], _) => *one,
        ([a, b, ..], _) => {
            let name = bodies[*a].element.get("name").unwrap_or("(unnamed)").to_owned();
            return Err(bodies[*b]
                .element
                .error(format!("moves freely, and so does {name:?}: the file has two robots")));
        }
        ([], 1) => {
            notes.say("the base is fixed to the world in the file; here it moves freely");
            0
        }
        ([], 0) => return Err(root.error("<worldbody> has no <body>: the robot's base is a body with a free joint")),
        ([], count) => {
            return Err(root.error(format!(
                "none of the {count} bodies of <worldbody> has a free joint: add a <freejoint/> to the robot's base, or \
                 wrap the bodies in a <body> with <freejoint/>"
            )));
        }
    };
    let base = bodies.remove(chosen);
    let mut beside = BesideRobot::default();
    for (i, other) in bodies.iter().enumerate() {
        notes.left_out(other.element);
        beside.positions[usize::from(i >= chosen)] += joints(other.element, &mut beside.joints);
    }
    Ok((base, beside))
}

/// Numbers of a free body's position: place and quaternion.
const FREE: usize = 7;

/// Adds the names of the joints of a body and of all that it carries, and counts their numbers of positions.
fn joints(body: &Element, names: &mut HashSet<String>) -> usize {
    let mut positions = 0;
    for child in &body.children {
        positions += match (child.tag.as_str(), child.get("type")) {
            ("freejoint", _) | ("joint", Some("free")) => FREE,
            ("joint", Some("ball")) => 4,
            ("joint", _) => 1,
            _ => joints(child, names),
        };
        if child.tag == "joint" {
            names.extend(child.get("name").map(str::to_owned));
        }
    }
    positions
}

/// Bodies of the world, also those inside frames.
fn top<'a>(world: &'a Element, class: &str, bodies: &mut Vec<MjcfBase<'a>>, notes: &mut Notes) -> Result<()> {
    let class = world.get("childclass").unwrap_or(class);
    for child in &world.children {
        match child.tag.as_str() {
            "body" => bodies.push(MjcfBase { element: child, class: class.to_owned(), free: body::is_free(child) }),
            "frame" => top(child, class, bodies, notes)?,
            "replicate" | "attach" | "composite" | "flexcomp" => return Err(child.error("is not read")),
            _ => notes.left_out(child),
        }
    }
    Ok(())
}

struct Including<'a> {
    files: &'a Files,
    notes: &'a mut Notes,
    seen: HashSet<PathBuf>,
    elements: usize,
}

impl Including<'_> {
    /// Returns `element` with the content of included files in place of each `<include>`.
    fn expanded(&mut self, mut element: Element) -> Result<Element> {
        let mut children = Vec::with_capacity(element.children.len());
        for child in std::mem::take(&mut element.children) {
            self.elements += 1;
            if self.elements > MOST_ELEMENTS {
                return Err(child.error(format!("more than {MOST_ELEMENTS} elements with all included files")));
            }
            if child.tag != "include" {
                children.push(self.expanded(child)?);
                continue;
            }
            let path = self.files.find("", child.required("file")?).map_err(|e| child.error(e))?;
            // MuJoCo also includes each file only once.
            if !self.seen.insert(path.clone()) {
                return Err(child.error("the file is included already: a circular include"));
            }
            if self.seen.len() > MOST_FILES {
                return Err(child.error(format!("more than {MOST_FILES} files")));
            }
            let included = xml::parse(&SourceFile::read(&path, MOST_TEXT)?, |note| self.notes.say(note))?;
            children.extend(self.expanded(included)?.children);
        }
        element.children = children;
        Ok(element)
    }
}
