//! Inertias that no body of the robot's size can have, as of files whose numbers have other units.

use super::draft::exceeds_sum;
use super::notes::Notes;
use crate::sim::tree::contact::{ContactPoint, contact_points};
use crate::sim::tree::{Tree, TreeBody};
use nalgebra::{Matrix3, Vector3};

type V = Vector3<f64>;

/// Largest radius of gyration, as a part of the distance from the centre of mass to the body's farthest point or joint.
/// No body within this distance has more than 1; 1.5 is our choice, because collision shapes leave parts out, and
/// because some files add the inertia of a motor's rotor to that of its link.
const MOST: f64 = 1.5;

/// Replaces inertias whose radius of gyration is far beyond the body's size, and those with a principal moment above the
/// sum of the others, by those of a box around the body's shapes, with the same mass and centre. `links`: for each body the links that are merged into it.
pub fn replace_implausible(tree: &mut Tree, links: &[Vec<String>], notes: &mut Notes) {
    let points = contact_points(tree);
    let mut worst: Option<(f64, String)> = None;
    let mut count = 0;
    for i in 0..tree.bodies.len() {
        let body = &tree.bodies[i];
        if body.mass <= 0.0 || points[i].is_empty() {
            continue;
        }
        let gyration = (body.inertia.symmetric_eigenvalues().max() / body.mass).sqrt();
        let times = gyration / size(tree, i, &points[i]);
        let why = match times > MOST {
            true => format!("a radius of gyration of {gyration:.2} m"),
            false if exceeds_sum(&body.inertia) => "a principal moment above the sum of the others".into(),
            false => continue,
        };
        if worst.as_ref().is_none_or(|w| w.0 < times) {
            worst = Some((times, format!("{} of {:.2} kg has {why}", body.name, body.mass)));
        }
        links[i].iter().for_each(|link| notes.forget("link", link));
        notes.forget("body", &tree.bodies[i].name);
        tree.bodies[i].inertia = of_box(&tree.bodies[i], &points[i]);
        count += 1;
    }
    if let Some((_, example)) = worst {
        let plural = if count == 1 { "body: its inertia is" } else { "bodies: their inertias are" };
        notes.say(format!("{count} {plural} replaced by that of a box around the shapes, because {example}; inertia = \"file\" keeps what the file says"));
    }
}

/// Distance of the farthest point of contact, and of the farthest joint, from the body's centre of mass [m].
fn size(tree: &Tree, i: usize, points: &[ContactPoint]) -> f64 {
    let center = tree.bodies[i].center;
    let children = tree.bodies.iter().skip(1).filter(|b| b.parent == i).map(|b| b.origin.translation.vector);
    let shapes = points.iter().map(|p| (p.center - center).norm() + p.radius);
    let joints = children.chain([V::zeros()]).map(|at| (at - center).norm());
    shapes.chain(joints).fold(0.0, f64::max)
}

/// Inertia of a uniform box around the points, along the body's axes, about its own centre [kg·m²].
fn of_box(body: &TreeBody, points: &[ContactPoint]) -> Matrix3<f64> {
    let ends = points.iter().fold([V::repeat(f64::MAX), V::repeat(f64::MIN)], |[low, high], p| {
        [low.inf(&p.center.add_scalar(-p.radius)), high.sup(&p.center.add_scalar(p.radius))]
    });
    let square = (ends[1] - ends[0]).map(|side| side * side);
    Matrix3::from_diagonal(&(V::repeat(square.sum()) - square)) * (body.mass / 12.0)
}
