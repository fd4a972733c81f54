//! Robots from files: URDF, MJCF, and our own TOML, each read into a [`Tree`].
//!
//! ```text
//!  file ─▶ xml (bounded) ─▶ urdf | mjcf ─▶ draft (links and joints, fixed ones too) ─▶ merged, checked ─▶ Tree
//!                              └─▶ files (in the packages only) ─▶ mesh (STL, OBJ, DAE)
//! ```
//!
//! `roxmltree` reads both XML formats; the program needs it for figures anyway. Bytes, nodes and depth are checked
//! before anything is built from them, every element that is left out is named, and no file outside of the package is
//! opened.

use sandgait_base::error;
use sandgait_sand as sand;
use sandgait_sim as sim;

mod check;
mod coarse;
mod collada;
mod draft;
mod effects;
mod files;
mod hull;
mod inertia;
mod mesh;
mod mjcf;
pub mod named;
mod notes;
mod packages;
pub mod posture;
mod shapes;
pub mod states;
mod touch;
mod urdf;
mod xml;
mod xml_bounds;
mod xml_mended;

pub use mesh::{Closed, closed};
pub use packages::{InertiaSource, Reading};
pub use shapes::ellipsoid;

use crate::error::{Error, Result};
use crate::sim::tree::looks::{Looks, MOST_TRIANGLES};
use crate::sim::tree::packed;
use crate::sim::tree::stance::Stance;
use crate::sim::tree::{Geometry, Tree, TreeModel, TreeShape};
use draft::BaseFrame;
use files::{Files, MOST_TEXT, SourceFile};
use mesh::Meshes;
use nalgebra::Vector3;
use notes::Notes;
use posture::{FilePose, FoundJoints, Posture, StandingRobot};
use std::path::Path;
use std::sync::Arc;

pub use touch::ShapeIndex;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    Urdf,
    Mjcf,
    Toml,
    Packed,
}

impl Format {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Urdf => "urdf",
            Self::Mjcf => "mjcf",
            Self::Toml => "toml",
            Self::Packed => "packed",
        }
    }
}

/// A robot read from a file.
pub struct Import {
    pub tree: Tree,
    pub format: Format,
    /// Notes on parts that were left out, and warnings.
    pub warnings: Vec<String>,
    /// For each body the links of the file merged into it, its own first.
    pub links: Vec<Vec<String>>,
    /// The standing pose.
    pub stance: Stance,
    /// The joints whose pose and gains are not in the file.
    pub found: FoundJoints,
    /// Does the file say that the base moves freely?
    pub base_is_free: bool,
    /// Names of the shapes that touch sand unless the user names shapes; None: feet, lower links and base.
    touches: Option<Vec<String>>,
    /// The packed robot in the file; None: the file is no packed robot.
    pub packed: Option<Box<PackedRobot>>,
    visuals: Vec<Vec<draft::Visual>>,
    /// The file's names of shapes, and those that they have here.
    given: Vec<[String; 2]>,
    /// The base's origin in the frame of the file's root [m]; 0 if that frame is in the body.
    base_at: Vector3<f64>,
}

/// A robot that was packed before.
pub struct PackedRobot {
    pub model: TreeModel,
    /// Compressed, or JSON.
    text: String,
}

impl PackedRobot {
    /// Number of plates.
    pub fn count(&self) -> usize {
        self.model.plates.iter().map(Vec::len).sum()
    }

    /// The compressed text.
    pub fn compressed(&self) -> Result<String> {
        if packed::is_packed(&self.text) { Ok(self.text.clone()) } else { packed::compressed(&self.text, self.count()) }
    }
}

/// Reads a `.urdf`, a `.xml` or `.mjcf` (URDF or MJCF by its root element), or a `.toml`.
pub fn load(path: &Path) -> Result<Import> {
    load_with(path, &Posture::default())
}

/// Reads a robot, and replaces poses and gains by the values in `posture`.
pub fn load_with(path: &Path, posture: &Posture) -> Result<Import> {
    load_from(path, posture, &Reading::default())
}

/// The same as [`load_with`], read as `reading` says.
pub fn load_from(path: &Path, posture: &Posture, reading: &Reading) -> Result<Import> {
    let ending = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    match ending.as_deref() {
        Some("toml") => return Import::of_toml(path),
        Some("json") => return Import::of_packed(path),
        Some("urdf" | "xml" | "mjcf") => {}
        Some("xacro") => return Err(Error::file(path, format!("robots are read from URDF: {}", urdf::RUN_XACRO))),
        _ => return Err(Error::file(path, "robots are read from .urdf, .xml (MJCF), .toml and packed .json")),
    }
    let source = SourceFile::read(path, MOST_TEXT)?;
    source.stand_in("the robot").map_or(Ok(()), |reason| Err(Error::file(path, reason)))?;
    let (mut meshes, mut notes) = (Meshes::default(), Notes::default());
    let root = xml::parse(&source, |note| notes.say(note))?;
    let files = Files::around(path, reading)?;
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let named = |e: Error| match e {
        Error::Invalid { field, reason } => Error::file(path, format!("{field}: {reason}")),
        other => other,
    };
    let (format, mut merged, draft) = match root.tag.as_str() {
        "robot" => {
            urdf::check_expanded(&root)?;
            let gravity = urdf::gravity(&root, &mut notes)?;
            let (links, free) = urdf::links(&root, &files, &mut meshes, &mut notes)?;
            let name = root.get("name").unwrap_or(&stem);
            let mut merged = draft::merged(name, &links, BaseFrame::default()).map_err(named)?;
            (merged.base_is_free, merged.tree.gravity) = (free, gravity);
            (Format::Urdf, merged, links)
        }
        "mujoco" => {
            let main = path.canonicalize().map_err(|e| Error::file(path, e))?;
            let (merged, links) = mjcf::robot(root, &stem, main, &files, &mut meshes, &mut notes).map_err(named)?;
            (Format::Mjcf, merged, links)
        }
        _ => return Err(root.error("is neither <robot> (URDF) nor <mujoco> (MJCF)")),
    };
    files.into_notes().into_iter().for_each(|note| notes.say(note));
    if reading.inertia == InertiaSource::Plausible {
        inertia::replace_implausible(&mut merged.tree, &merged.links, &mut notes);
    }
    check::check(&merged, &mut notes).map_err(named)?;
    packed::check(&merged.tree).map_err(named)?;
    let standing = StandingRobot::in_body(merged, &draft, posture, &mut notes).map_err(named)?;
    let StandingRobot { merged, stance, found, pose, base_at } = standing;
    let draft::Merged { tree, visuals, links, base_is_free, .. } = merged;
    note_stance(&tree, &pose, &mut notes);
    let warnings = notes.into_lines();
    let given = draft.iter().flat_map(|link| link.given.iter().cloned()).collect();
    Ok(Import { warnings, links, visuals, given, base_is_free, base_at, ..Import::whole(format, tree, stance, found) })
}

/// Notes what is unusual in the way in which the robot stands.
fn note_stance(tree: &Tree, pose: &FilePose, notes: &mut Notes) {
    pose.note(notes);
    for joint in tree.joints().filter(|j| posture::stands_outside(j)) {
        notes.part(
            "joint",
            &joint.name,
            "its position in the standing pose is outside of its range; its stop holds it there",
        );
    }
    for name in touch::on_balls(tree) {
        notes.part(
            "body",
            name,
            "its small separate balls touch sand as one sole, their hull (--touches names others)",
        );
    }
}

impl Import {
    /// A robot from a TOML file in our own format.
    fn of_toml(path: &Path) -> Result<Self> {
        let source = SourceFile::read(path, MOST_TEXT)?;
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let robot = crate::sim::Robot::from_toml(source.text()?).map_err(|e| Error::file(path, e))?;
        Self::of_robot(&name, &robot)
    }

    /// A file that `sandgait robot --pack` has written.
    fn of_packed(path: &Path) -> Result<Self> {
        let source = SourceFile::read(path, MOST_TEXT)?;
        Self::of_packed_text(source.text()?.trim()).map_err(|e| Error::file(path, e))
    }

    /// A robot that `sandgait robot --pack` has printed, with `--json` or without.
    pub fn of_packed_text(text: &str) -> Result<Self> {
        let model = if packed::is_packed(text) { packed::unpack_compressed(text)? } else { packed::unpack(text)? };
        let (tree, stance) = ((*model.tree).clone(), (*model.stance).clone());
        let found = FoundJoints::none(tree.joints().count());
        let packed = Some(Box::new(PackedRobot { model, text: text.to_owned() }));
        Ok(Self { packed, ..Self::whole(Format::Packed, tree, stance, found) })
    }

    /// A built-in robot by its name, as `--robot` takes it.
    pub fn built_in(name: &str) -> Result<Self> {
        Self::of_robot(name, &crate::sim::Robot::built_in(name)?)
    }

    fn of_robot(name: &str, robot: &crate::sim::Robot) -> Result<Self> {
        let mut tree = crate::sim::tree::of_robot(name, robot)?;
        let (stance, found, _) = posture::settle(&mut tree, &Posture::default());
        Ok(Self::whole(Format::Toml, tree, stance, found))
    }

    /// A robot without notes and visuals, each of whose bodies is one link.
    fn whole(format: Format, tree: Tree, stance: Stance, found: FoundJoints) -> Self {
        let links = tree.bodies.iter().map(|b| vec![b.name.clone()]).collect();
        let visuals = vec![Vec::new(); tree.bodies.len()];
        let (warnings, base_at) = (Vec::new(), Vector3::zeros());
        let (base_is_free, touches, packed, given) = (true, None, None, Vec::new());
        Self { tree, format, warnings, links, visuals, given, stance, found, base_is_free, touches, packed, base_at }
    }

    /// The tree with the base's frame where the file has it, for comparison with other programs.
    pub fn as_in_file(&self) -> Tree {
        let (mut tree, at) = (self.tree.clone(), draft::shift(self.base_at));
        let base = &mut tree.bodies[0];
        base.center += self.base_at;
        base.held.moment += self.base_at * base.held.mass;
        base.shapes.iter_mut().for_each(|shape| shape.origin = at * shape.origin);
        tree.bodies.iter_mut().skip(1).filter(|b| b.parent == 0).for_each(|body| body.origin = at * body.origin);
        tree
    }

    /// The visual shapes of each body: the file's visuals, or else its collision shapes. Meshes of visuals are read
    /// here.
    pub fn seen(&self) -> Result<Vec<Vec<TreeShape>>> {
        let mut meshes = Meshes::default();
        let any = self.visuals.iter().any(|v| !v.is_empty());
        let mut all = Vec::with_capacity(self.visuals.len());
        for (visuals, body) in self.visuals.iter().zip(&self.tree.bodies) {
            if !any {
                all.push(body.shapes.clone());
                continue;
            }
            let mut shapes = Vec::with_capacity(visuals.len());
            for visual in visuals {
                let geometry = match &visual.look {
                    draft::DraftShape::Shape(geometry) => geometry.clone(),
                    draft::DraftShape::Mesh(file) => Geometry::Mesh(Arc::clone(&meshes.scaled(file)?)),
                };
                shapes.push(TreeShape { name: body.name.clone(), origin: visual.origin, geometry, friction: 0.0 });
            }
            all.push(shapes);
        }
        Ok(all)
    }

    /// Shapes for pictures and recordings, with coarser meshes. None if they are the primitives that a packed robot has
    /// anyway.
    pub fn looks(&self) -> Result<Option<Looks>> {
        let small = coarse::coarse(&self.seen()?, MOST_TRIANGLES);
        let seen = Looks::of(small.iter().map(|shapes| &shapes[..]), true);
        let packed = Looks::of(self.tree.bodies.iter().map(|b| &b.shapes[..]), false);
        Ok((seen != packed).then_some(seen))
    }
}
