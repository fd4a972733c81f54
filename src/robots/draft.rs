//! Links and joints as files have them, with fixed joints, and the tree of moving bodies that is made from them.

use super::mesh::MeshFile;
use crate::error::{Error, Result};
use crate::sim::tree::{Geometry, HeldMass, JointKind, Tree, TreeBody, TreeJoint, TreeShape};
use nalgebra::{Isometry3, Matrix3, Translation3, Vector3};
use std::f64::consts::TAU;

/// Largest number of links of a file, and of joints that move: our choice, several times a humanoid's with hands.
pub const MOST_LINKS: usize = 2000;
const MOST_JOINTS: usize = 200;
/// Largest mass [kg] and distance [m]: our choice, which catches wrong units.
const MOST_MASS: f64 = 1e5;
const FARTHEST: f64 = 100.0;
/// An eigenvalue of an inertia counts as negative below minus this share of the largest one: the rounding of files
/// with six digits.
const ROUNDING: f64 = 1e-6;
/// Moments of inertia of this size count as rounding [kg·m²]: our choice, a milligram at a distance of a millimetre.
const NOTHING: f64 = 1e-12;

/// Mass, centre of mass, and inertia about this centre, along the axes of the link.
#[derive(Clone, Copy, Debug)]
pub struct Inertial {
    pub mass: f64,
    pub center: Vector3<f64>,
    pub inertia: Matrix3<f64>,
}

impl Inertial {
    pub fn none() -> Self {
        Self { mass: 0.0, center: Vector3::zeros(), inertia: Matrix3::zeros() }
    }

    /// The same mass properties in another frame; `at` is the pose of the old frame in the new one.
    pub fn moved(&self, at: &Isometry3<f64>) -> Self {
        let turn = at.rotation.to_rotation_matrix();
        let center = at.transform_point(&self.center.into()).coords;
        Self { mass: self.mass, center, inertia: turn.matrix() * self.inertia * turn.matrix().transpose() }
    }

    /// These mass properties and `other` combined into one body.
    pub fn with(&self, other: &Self) -> Self {
        let mass = self.mass + other.mass;
        if mass == 0.0 || other.mass == 0.0 {
            return Self { inertia: self.inertia + other.inertia, ..*self };
        }
        if self.mass == 0.0 {
            return Self { inertia: self.inertia + other.inertia, ..*other };
        }
        let center = (self.center * self.mass + other.center * other.mass) / mass;
        let steiner = |part: &Self| {
            let d = part.center - center;
            part.inertia + (Matrix3::identity() * d.norm_squared() - d * d.transpose()) * part.mass
        };
        Self { mass, center, inertia: steiner(self) + steiner(other) }
    }

    /// Checks mass and inertia: an error if no body can have them, a warning if they are doubtful.
    pub fn check(&self) -> std::result::Result<Option<String>, String> {
        let numbers = self.inertia.iter().chain(self.center.iter()).chain([&self.mass]);
        if numbers.clone().any(|x| !x.is_finite()) {
            return Err("mass and inertia must be finite".into());
        }
        if !(0.0..=MOST_MASS).contains(&self.mass) {
            return Err(format!("mass {} kg is outside [0, {MOST_MASS}]", self.mass));
        }
        let [least, middle, most] = principal_moments(&self.inertia);
        if least < -ROUNDING * most.abs() - NOTHING || most < -NOTHING {
            return Err(format!(
                "inertia is not positive definite: its principal moments are {least:.3e}, {middle:.3e}, {most:.3e} kg·m²"
            ));
        }
        if self.mass == 0.0 && most > 0.0 {
            return Ok(Some("has an inertia without a mass; it is used as it is".into()));
        }
        Ok(exceeds_sum(&self.inertia).then(|| {
            "no body has such an inertia (one principal moment above the sum of the others); it is used as it is".into()
        }))
    }
}

/// In ascending order.
fn principal_moments(inertia: &Matrix3<f64>) -> [f64; 3] {
    let mut principal: [f64; 3] = inertia.symmetric_eigenvalues().into();
    principal.sort_by(f64::total_cmp);
    principal
}

/// Is a principal moment above the sum of the others, as that of no body? Our choice of a tolerance of 0.1 %: files round
/// numbers to three digits.
pub fn exceeds_sum(inertia: &Matrix3<f64>) -> bool {
    let [least, middle, most] = principal_moments(inertia);
    most > (least + middle) * (1.0 + 1e-3) && most - least - middle > NOTHING
}

/// A visual shape of a link.
#[derive(Clone, Debug)]
pub enum DraftShape {
    Shape(Geometry),
    Mesh(MeshFile),
}

#[derive(Clone, Debug)]
pub struct Visual {
    pub origin: Isometry3<f64>,
    pub look: DraftShape,
}

/// A link, and the joint that carries it (None: the link is fixed to its parent).
#[derive(Clone, Debug)]
pub struct DraftLink {
    pub name: String,
    /// Index of the parent link; the root has its own index.
    pub parent: usize,
    pub origin: Isometry3<f64>,
    pub joint: Option<TreeJoint>,
    /// May the link move although it has no mass?
    pub massless: bool,
    pub inertial: Inertial,
    /// The part of its weight that is held from outside.
    pub held: f64,
    pub shapes: Vec<TreeShape>,
    /// The file's names of shapes, and those that they have here.
    pub given: Vec<[String; 2]>,
    pub visuals: Vec<Visual>,
}

impl DraftLink {
    /// A link without mass and shapes; without a parent it is the root.
    pub fn new(name: String, parent: Option<usize>, origin: Isometry3<f64>, joint: Option<TreeJoint>) -> Self {
        let parent = parent.unwrap_or(0);
        let inertial = Inertial::none();
        let (shapes, given, visuals) = (Vec::new(), Vec::new(), Vec::new());
        Self { name, parent, origin, joint, massless: false, inertial, held: 0.0, shapes, given, visuals }
    }
}

/// Moving bodies, and the visual shapes of each.
pub struct Merged {
    pub tree: Tree,
    pub visuals: Vec<Vec<Visual>>,
    /// For each body the links that are merged into it; its own link is the first.
    pub links: Vec<Vec<String>>,
    /// May the body move without mass?
    pub massless: Vec<bool>,
    /// Does the file say that the base moves freely?
    pub base_is_free: bool,
}

/// Where the base's frame is: at a link that is fixed to the root, or away from it; its axes are the root's.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BaseFrame {
    link: usize,
    shift: Vector3<f64>,
}

impl BaseFrame {
    /// The frames that may take the place of the root's: of the links to which links without mass and shapes lead, and the
    /// last one moved to `place` in the frame of the root.
    pub fn others(links: &[DraftLink], place: Vector3<f64>) -> Vec<Self> {
        let (mut all, mut at) = (Vec::new(), 0);
        loop {
            let bare = links[at].inertial.mass == 0.0 && links[at].shapes.is_empty();
            let mut children = (1..links.len()).filter(|i| links[*i].parent == at);
            match (bare, children.next(), children.next()) {
                (true, Some(child), None) if links[child].joint.is_none() => at = child,
                _ => break,
            }
            all.push(Self { link: at, shift: Vector3::zeros() });
        }
        all.push(Self { link: 0, shift: place });
        all
    }

    /// The base's origin in the frame of the root.
    pub fn place(&self, links: &[DraftLink]) -> Vector3<f64> {
        let (mut place, mut at) = (Isometry3::identity(), self.link);
        while at > 0 {
            place = links[at].origin * place;
            at = links[at].parent;
        }
        place.translation.vector + self.shift
    }
}

/// Merges fixed links into the links that carry them. Each link comes after its parent, the root first.
pub fn merged(name: &str, links: &[DraftLink], base: BaseFrame) -> Result<Merged> {
    let root = shift(-base.place(links));
    let mut children = vec![Vec::new(); links.len()];
    for (i, link) in links.iter().enumerate().skip(1) {
        children[link.parent].push(i);
    }
    let mut out = Merged {
        tree: Tree { name: name.to_owned(), bodies: Vec::new(), gravity: None },
        visuals: Vec::new(),
        links: Vec::new(),
        massless: Vec::new(),
        base_is_free: false,
    };
    // Entries are a link, the body that carries it, and the pose in that body of the link's parent. Links are visited
    // depth first, in the file's order.
    let mut left = vec![(0, 0, Isometry3::identity())];
    while let Some((i, carrier, within)) = left.pop() {
        let link = &links[i];
        let mut at = if i == 0 { root } else { within * link.origin };
        if i > 0 && i == base.link {
            // Exactly, so that frames of links without mass do not change a bit of the motion.
            at.translation = Translation3::identity();
        }
        if at.translation.vector.norm() > FARTHEST {
            return Err(Error::invalid(&link.name, format!("lies more than {FARTHEST} m from its parent")));
        }
        let moves = i == 0 || link.joint.is_some();
        let (body, frame) = match moves {
            true => (out.tree.bodies.len(), if i == 0 { at } else { Isometry3::identity() }),
            false => (carrier, at),
        };
        if moves {
            out.tree.bodies.push(TreeBody {
                name: link.name.clone(),
                parent: carrier,
                origin: if i == 0 { Isometry3::identity() } else { at },
                joint: link.joint.clone(),
                mass: 0.0,
                center: Vector3::zeros(),
                inertia: Matrix3::zeros(),
                held: HeldMass::default(),
                shapes: Vec::new(),
            });
            out.visuals.push(Vec::new());
            out.links.push(Vec::new());
            out.massless.push(link.massless);
        }
        out.add(body, link, &frame);
        left.extend(children[i].iter().rev().map(|child| (*child, body, frame)));
    }
    let joints = out.tree.bodies.len() - 1;
    if joints > MOST_JOINTS {
        return Err(Error::invalid("robot", format!("{joints} joints that move are more than {MOST_JOINTS}")));
    }
    Ok(out)
}

impl Merged {
    fn add(&mut self, body: usize, link: &DraftLink, frame: &Isometry3<f64>) {
        let to = &mut self.tree.bodies[body];
        let own = Inertial { mass: to.mass, center: to.center, inertia: to.inertia };
        let sum = own.with(&link.inertial.moved(frame));
        // Makes the inertia exactly symmetric after rounding.
        let inertia = (sum.inertia + sum.inertia.transpose()) * 0.5;
        (to.mass, to.center, to.inertia) = (sum.mass, sum.center, inertia);
        let held = link.held * link.inertial.mass;
        to.held.mass += held;
        to.held.moment += frame.transform_point(&link.inertial.center.into()).coords * held;
        let shapes = link.shapes.iter().cloned();
        to.shapes.extend(shapes.map(|s| TreeShape { origin: frame * s.origin, ..s }));
        let visuals = link.visuals.iter().cloned();
        self.visuals[body].extend(visuals.map(|v| Visual { origin: frame * v.origin, ..v }));
        if self.links[body].last() != Some(&link.name) {
            self.links[body].push(link.name.clone());
        }
    }
}

/// Largest range of a hinge [turns], and the largest end that may be one in degrees [rad]: our choice. Cables and winches
/// make some turns; larger ends are a way to write that there is no end.
const MOST_TURNS: f64 = 4.0;
const MOST_DEGREES: f64 = 720.0;

/// Refuses the range of a hinge that looks like degrees.
pub fn check_range_of(joint: &TreeJoint) -> std::result::Result<(), String> {
    let Some([low, high]) = joint.range.filter(|_| joint.kind == JointKind::Hinge) else { return Ok(()) };
    let turns = (high - low) / TAU;
    if turns <= MOST_TURNS || low.abs().max(high.abs()) > MOST_DEGREES {
        return Ok(());
    }
    Err(format!(
        "joint {:?}: limits {low} to {high} look like degrees (the larger one is {:.0} turns): give radians, or no limits",
        joint.name,
        low.abs().max(high.abs()) / TAU
    ))
}

/// A translation without a rotation.
pub fn shift(by: Vector3<f64>) -> Isometry3<f64> {
    Isometry3::from_parts(Translation3::from(by), nalgebra::UnitQuaternion::identity())
}

/// Names a link's shapes. A single shape gets the link's name. Of several, each gets `link/name`, or `link/number` if
/// it has no name. Returns the file's names, and those that the shapes have now.
pub fn name_shapes(link: &str, shapes: &mut [TreeShape]) -> Vec<[String; 2]> {
    let many = shapes.len() > 1;
    let mut given = Vec::new();
    for (k, shape) in shapes.iter_mut().enumerate() {
        let own = shape.name.clone();
        shape.name = match (many, shape.name.is_empty()) {
            (false, _) => link.to_owned(),
            (true, false) => format!("{link}/{}", shape.name),
            (true, true) => format!("{link}/{}", k + 1),
        };
        if !own.is_empty() {
            given.push([own, shape.name.clone()]);
        }
    }
    given
}
