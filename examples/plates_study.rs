//! How far the sand's forces on default plates are from those on fine plates: at random poses, velocities and spins of
//! a body, below the surface by 0.1 to 1 of its size.
//!
//! `cargo run --release --example plates_study -- LAW FILE …` prints a line for each different body of each robot, with
//! the plates of engine `tree`. Instead of a FILE, `shapes=COUNT,SEED` means COUNT shapes of each kind with random
//! proportions, with the forces of `sandgait::bodies`. A line has the root mean square and the worst of the errors of force, relative
//! to the force, and the same for the moment, divided by the force and the body's size.

use nalgebra::{Isometry3, Matrix3, UnitQuaternion, Vector3};
use rand::{Rng as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;
use sandgait::bodies::{Bodies, BodyPart, GroundOptions, Motions, SandGround};
use sandgait::number::Vec3;
use sandgait::sand::intruder::IntruderPlate;
use sandgait::sand::{Law, Medium, Regularization, SandBed, SandDescription, SegmentState};
use sandgait::sim::Model;
use sandgait::sim::model::Scene;
use sandgait::sim::tree::flight::{TreePose, sand_loads};
use sandgait::sim::tree::{Geometry, Tree, TreeBody, TreeModel, TreeShape, of_shapes, of_touching};
use sandgait::{Result, robots};
use std::path::Path;
use std::sync::Arc;

type V = Vector3<f64>;

/// Approximate number of points of the reference: our choice, a hundred times the default number of plates.
const POINTS: f64 = 1.9e4;
const MEDIUM: &str = "poppy-loose";
/// Speed of the body's middle [m/s]. The largest spin moves the body's farthest point as fast.
const SPEED: f64 = 0.3;

/// Errors of force, and of moment over the body's size, relative to the force, over random poses.
pub struct Errors {
    pub rms: f64,
    pub worst: f64,
    pub moment: f64,
    pub worst_moment: f64,
    /// Patches of the engine; 0: not known.
    pub patches: usize,
    /// Number of poses with a force above a tenth of the largest.
    pub poses: usize,
}

impl std::fmt::Display for Errors {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { rms, worst, moment, worst_moment, patches, poses } = self;
        if *patches > 0 {
            write!(f, "{patches:3} patches, ")?;
        }
        write!(f, "{poses:4} poses: force rms {rms:.4}, worst {worst:.4}, ")?;
        write!(f, "moment rms {moment:.4}, worst {worst_moment:.4}")
    }
}

/// A point of the surface: place, outward normal, area, and whether its face leads as a whole.
struct Point {
    at: V,
    normal: V,
    area: f64,
    flat: bool,
}

fn vector(v: Vec3<f64>) -> V {
    v.lane(0).into()
}

/// A model of one body with these plates.
fn alone(plates: Vec<IntruderPlate>, law: &str) -> Result<Model> {
    let body = TreeBody {
        name: "body".into(),
        parent: 0,
        origin: Isometry3::identity(),
        joint: None,
        mass: 1.0,
        center: V::zeros(),
        inertia: Matrix3::identity(),
        held: Default::default(),
        shapes: Vec::new(),
    };
    let tree = TreeModel::new(Tree { name: "body".into(), bodies: vec![body], gravity: None }, vec![plates])?;
    Model::of_tree(
        tree,
        &Scene { law: Law::named(law)?, surface: Regularization::SOLID, ..Scene::flat(Medium::named(MEDIUM)?) },
    )
}

/// Fine points of the shapes' surface. Those of one mesh are the centres of its own triangles, halved until they are small.
fn points(shapes: &[&TreeShape]) -> Result<Vec<Point>> {
    let area: f64 = shapes.iter().map(|s| s.geometry.area()).sum();
    let size = (area / POINTS).sqrt();
    if let [TreeShape { geometry: Geometry::Mesh(triangles), origin, .. }] = shapes {
        let mut left: Vec<[V; 3]> =
            triangles.iter().map(|t| t.map(|p| origin.transform_point(&p.into()).coords)).collect();
        let mut points = Vec::new();
        while let Some([a, b, c]) = left.pop() {
            let longest = (b - a).norm().max((c - b).norm()).max((a - c).norm());
            if longest > 2.0 * size {
                // The first side becomes the longest one, which is halved.
                let [a, b, c] = if (b - a).norm() == longest { [a, b, c] } else { [b, c, a] };
                let [a, b, c] = if (b - a).norm() == longest { [a, b, c] } else { [b, c, a] };
                let middle = (a + b) / 2.0;
                left.extend([[a, middle, c], [middle, b, c]]);
            } else if let Some(normal) = (b - a).cross(&(c - a)).try_normalize(0.0) {
                let area = (b - a).cross(&(c - a)).norm() / 2.0;
                points.push(Point { at: (a + b + c) / 3.0, normal, area, flat: false });
            }
        }
        return Ok(points);
    }
    let point = |p: &IntruderPlate| Point {
        at: vector(p.center),
        normal: vector(p.normal),
        area: p.area,
        // The engine increases the force on a flat face over 1° when it begins to lead, and so does the reference.
        flat: p.bend == [0.0; 2],
    };
    Ok(of_shapes(shapes, Some(size))?.iter().map(point).collect())
}

/// A body's state: position and velocity of its origin, orientation, and angular velocity, in the world's axes.
struct Motion {
    position: V,
    turn: UnitQuaternion<f64>,
    velocity: V,
    spin: V,
}

/// Compares the engine's forces on `plates` with the law summed over points of the `shapes`.
pub fn errors(shapes: &[&TreeShape], plates: Vec<IntruderPlate>, law: &str, poses: usize, seed: u64) -> Result<Errors> {
    let model = alone(plates, law)?;
    let patches = model.tree.as_ref().map_or(0, |tree| tree.patches[0].patches.len());
    let forces = |m: &Motion| {
        let pose = TreePose {
            quat: [m.turn.w, m.turn.i, m.turn.j, m.turn.k],
            v: m.velocity.into(),
            w: m.spin.into(),
            q: Vec::new(),
            qd: Vec::new(),
            tau: Vec::new(),
        };
        Ok(sand_loads(&model, m.position.into(), &pose)[0].map(V::from))
    };
    compared(shapes, &forces, law, poses, seed).map(|errors| Errors { patches, ..errors })
}

/// Compares `forces`, the force and torque about the body's origin, with the law summed over points of the `shapes`.
fn compared(
    shapes: &[&TreeShape],
    forces: &dyn Fn(&Motion) -> Result<[V; 2]>,
    law: &str,
    poses: usize,
    seed: u64,
) -> Result<Errors> {
    let sand = SandDescription::named(MEDIUM, law)?;
    let grounds: [SandBed<f64>; 2] =
        [Regularization::BARE, Regularization::SOLID].map(|surface| SandBed::new(sand.law, &sand.medium(), &surface));
    let points = points(shapes)?;
    let middle = points.iter().map(|p| p.at * p.area).sum::<V>() / points.iter().map(|p| p.area).sum::<f64>();
    let size = points.iter().map(|p| (p.at - middle).norm()).fold(0.0, f64::max);
    let mut chance = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut rows = Vec::with_capacity(poses);
    for _ in 0..poses {
        let mut unit = || V::from_fn(|_, _| chance.random::<f64>() - 0.5).normalize();
        let turn = UnitQuaternion::from_scaled_axis(unit() * (3.0 * unit().x));
        let (velocity, spin, deep) = (unit() * SPEED, unit() * (unit().x * SPEED / size), unit().x.abs());
        let arms: Vec<V> = points.iter().map(|p| turn * (p.at - middle)).collect();
        let lowest = arms.iter().map(|at| at.z).fold(0.0, f64::min);
        let height = -lowest - size * (0.1 + 0.9 * deep);
        let (mut force, mut moment) = (V::zeros(), V::zeros());
        for (p, at) in points.iter().zip(&arms).filter(|(_, at)| at.z + height < 0.0) {
            let (n, v) = (turn * p.normal, velocity + spin.cross(at));
            if n.dot(&v) > 0.0 {
                let site = SegmentState::fresh(-at.z - height, 0.0);
                let [n, v] = [n, v].map(|v| Vec3::splat(v.into()));
                let f = vector(grounds[usize::from(p.flat)].one_sided(&site, p.area, n, v).force);
                force += f;
                moment += at.cross(&f);
            }
        }
        let off = turn * middle;
        let [f, m] =
            forces(&Motion { position: V::z() * height - off, turn, velocity: velocity - spin.cross(&off), spin })?;
        rows.push([(f - force).norm(), (m - off.cross(&f) - moment).norm() / size, force.norm()]);
    }
    // If hardly any part of the body leads in the sand, a relative error says nothing.
    let largest = rows.iter().map(|r| r[2]).fold(0.0, f64::max);
    rows.retain(|r| r[2] > 0.1 * largest);
    let rms = |k: usize| (rows.iter().map(|r| (r[k] / r[2]).powi(2)).sum::<f64>() / rows.len() as f64).sqrt();
    let worst = |k: usize| rows.iter().map(|r| r[k] / r[2]).fold(0.0, f64::max);
    let [moment, worst_moment] = [rms(1), worst(1)];
    Ok(Errors { rms: rms(0), worst: worst(0), moment, worst_moment, patches: 0, poses: rows.len() })
}

fn robot(law: &str, file: &str) -> Result<()> {
    let import = robots::load(Path::new(file))?;
    let touching = import.touching(None)?;
    let plates = of_touching(&import.tree, &touching, None)?;
    println!("{file}: {} plates", plates.iter().map(Vec::len).sum::<usize>());
    let mut seen = Vec::new();
    for (b, (body, plates)) in import.tree.bodies.iter().zip(plates).enumerate() {
        let own: Vec<&TreeShape> = touching.iter().filter(|t| t.0 == b).map(|t| &body.shapes[t.1]).collect();
        // The other legs have the same area to a millionth of a square metre.
        let area = (1e6 * own.iter().map(|s| s.geometry.area()).sum::<f64>()).round();
        if own.is_empty() || plates.is_empty() || seen.contains(&area) {
            continue;
        }
        seen.push(area);
        let count = plates.len();
        println!("  {:28} {count:4} plates {}", body.name, errors(&own, plates, law, 100, 33_550)?);
    }
    Ok(())
}

/// A shape of each kind with random proportions, as a part of a body and as what the reference knows. All numbers are
/// our choice.
#[allow(dead_code)] // not used by all tests that include this file
pub fn drawn(chance: &mut Xoshiro256PlusPlus) -> Result<Vec<(&'static str, BodyPart, Geometry)>> {
    let mut ratio = |most: f64| most.powf(2.0 * chance.random::<f64>() - 1.0);
    let radius = 0.02 * ratio(2.0);
    let [capsule, roller] = [radius * 2.0 * ratio(3.0), radius * ratio(3.0)];
    let mut sides = |most: f64| V::from_fn(|_, _| 0.02 * ratio(most));
    let (egg, half, soft) = (sides(1.6), sides(2.2), sides(1.6));
    let waves = [0, 1, 2].map(|_| V::from_fn(|_, _| 6.0 * chance.random::<f64>() - 3.0));
    let meshes = [robots::ellipsoid(egg), bumpy(&robots::ellipsoid(soft), &waves)];
    let [egg, blob] = meshes.map(|mesh| {
        let Geometry::Mesh(triangles) = &mesh else { unreachable!("an ellipsoid is a mesh") };
        let list: Vec<[[f64; 3]; 3]> = triangles.iter().map(|t| t.map(Into::into)).collect();
        Ok::<_, sandgait::Error>((BodyPart::triangles("mesh", &list)?, mesh))
    });
    let ((egg, egg_mesh), (blob, blob_mesh)) = (egg?, blob?);
    let [x, y, z] = (2.0 * half).into();
    let named = BodyPart::named;
    Ok(vec![
        ("ball", named(&format!("sphere:radius={radius}"))?, Geometry::Sphere { radius }),
        ("egg", egg, egg_mesh),
        (
            "capsule",
            named(&format!("capsule:radius={radius},height={}", 2.0 * capsule))?,
            Geometry::Capsule { radius, half_length: capsule },
        ),
        (
            "cylinder",
            named(&format!("cylinder:radius={radius},height={}", 2.0 * roller))?,
            Geometry::Cylinder { radius, half_length: roller },
        ),
        ("box", named(&format!("box:length={x},width={y},height={z}"))?, Geometry::Box { half }),
        ("blob", blob, blob_mesh),
    ])
}

/// The mesh with its points moved outward and inward by up to 15 %, in three waves over the directions.
fn bumpy(mesh: &Geometry, waves: &[V; 3]) -> Geometry {
    let Geometry::Mesh(triangles) = mesh else { return mesh.clone() };
    let moved = |p: V| p * (1.0 + waves.iter().map(|wave| 0.05 * (wave.dot(&p.normalize())).sin()).sum::<f64>());
    Geometry::Mesh(Arc::new(triangles.iter().map(|t| t.map(moved)).collect()))
}

/// `numbers`: number of shapes of each kind, and seed.
fn random_shapes(law: &str, numbers: &str) -> Result<()> {
    let wrong = || sandgait::Error::invalid("shapes", format!("{numbers:?} is not COUNT,SEED"));
    let (count, seed) = numbers.split_once(',').ok_or_else(wrong)?;
    let (count, seed): (usize, u64) = (count.parse().map_err(|_| wrong())?, seed.parse().map_err(|_| wrong())?);
    let mut chance = Xoshiro256PlusPlus::seed_from_u64(seed);
    let ground = SandGround::new(SandDescription::named(MEDIUM, law)?, GroundOptions::default())?;
    for index in 0..count {
        for (name, part, geometry) in drawn(&mut chance)? {
            let shape = TreeShape { name: name.into(), origin: Isometry3::identity(), geometry, friction: 1.0 };
            let body = Bodies::new(vec![(name.into(), vec![part])], None)?;
            let forces = |m: &Motion| {
                let (position, v, w): ([f64; 3], [f64; 3], [f64; 3]) =
                    (m.position.into(), m.velocity.into(), m.spin.into());
                let quat = [m.turn.w, m.turn.i, m.turn.j, m.turn.k];
                let mut wrench = [0.0; 6];
                body.wrench(&ground, &Motions::contiguous(&position, &quat, &v, &w), 1, &mut wrench, None)?;
                Ok([V::from_column_slice(&wrench[..3]), V::from_column_slice(&wrench[3..])])
            };
            let e = compared(&[&shape], &forces, law, 200, seed + index as u64)?;
            println!("{law} {name:9} {:4} plates, {e}", body.plates(0).len());
        }
    }
    Ok(())
}

#[allow(dead_code)] // the tests include this file for `errors`
fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let Some((law, files)) = arguments.split_first() else {
        return Err(sandgait::Error::invalid("arguments", "LAW FILE …"));
    };
    files.iter().try_for_each(|file| match file.strip_prefix("shapes=") {
        Some(numbers) => random_shapes(law, numbers),
        None => robot(law, file),
    })
}
