//! Left and right of a robot.

use super::tree::models::quadruped;
use super::tree::{SignedDraw, random_tree};
use sandgait_sim::frame::V;
use sandgait_sim::tree::flight::{TreePose, accelerations};
use sandgait_sim::tree::symmetry::*;
use sandgait_sim::tree::{Tree, TreeModel};

fn model(tree: Tree) -> TreeModel {
    let bodies = tree.bodies.len();
    TreeModel::new(tree, vec![Vec::new(); bodies]).unwrap()
}

fn pose(draw: &mut SignedDraw, rest: &[f64]) -> TreePose {
    let mut three = || std::array::from_fn(|_| draw.number());
    let (v, w, axis): ([f64; 3], [f64; 3], [f64; 3]) = (three(), three(), three());
    let turn = nalgebra::UnitQuaternion::from_scaled_axis(V::from(axis));
    let quat = [turn.w, turn.i, turn.j, turn.k];
    let mut joints = |scale: f64| rest.iter().map(|_| scale * draw.number()).collect::<Vec<_>>();
    let q = joints(0.5).iter().zip(rest).map(|(off, rest)| off + rest).collect();
    TreePose { quat, v, w, q, qd: joints(5.0), tau: joints(3.0) }
}

/// The quadruped's legs are FL, FR, RL, RR with three joints each. A mirrored robot accelerates like the mirror image of
/// the robot.
#[test]
fn a_mirrored_robot_moves_like_the_mirror_image() {
    let robot = model(quadruped());
    let sides = Symmetry::of(&robot).unwrap();
    assert_eq!(sides.joints, [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]);
    assert_eq!(sides.signs, [-1.0, 1.0, 1.0].repeat(4));
    let (mut draw, rest) = (SignedDraw::new(7), &robot.stance.angles);
    for _ in 0..20 {
        let here = pose(&mut draw, rest);
        let there = sides.pose(rest, &here);
        assert!(there != here && sides.pose(rest, &there).tau == here.tau);
        let [a, b] = [&here, &there].map(|pose| accelerations(&robot.tree, pose));
        let near = |x: f64, y: f64| assert!((x - y).abs() < 1e-9 * (1.0 + x.abs()), "{x} {y}");
        (0..3).for_each(|k| near(if k == 1 { -a.a[k] } else { a.a[k] }, b.a[k]));
        (0..3).for_each(|k| near(if k == 1 { a.alpha[k] } else { -a.alpha[k] }, b.alpha[k]));
        sides.swap(&a.qdd).iter().zip(&b.qdd).for_each(|(x, y)| near(*x, *y));
    }
}

/// Masses are no reason against a mirror, but a robot of which one leg is heavy is called lopsided.
#[test]
fn masses_may_differ() {
    let mut tree = quadruped();
    let plain = Symmetry::of(&model(tree.clone())).unwrap();
    assert_eq!(plain.lopsided(&model(tree.clone())), None);
    tree.bodies[6].mass *= 3.0;
    let heavy = model(tree);
    assert_eq!(Symmetry::of(&heavy).unwrap(), plain);
    assert!(plain.lopsided(&heavy).unwrap() > 0.25);
}

#[test]
fn robots_without_a_symmetry_are_refused() {
    let refused = |change: &dyn Fn(&mut Tree)| {
        let mut tree = quadruped();
        change(&mut tree);
        Symmetry::of(&model(tree)).unwrap_err().to_string()
    };
    // A hip that moves along its own axis turns about the same axis; the thigh on it does not.
    let moved = refused(&|tree| tree.bodies[4].origin.translation.vector.x += 0.02);
    assert!(moved.contains("joint \"FL_thigh\" has no mirror image on the other side"), "{moved}");
    let turned = refused(&|tree| {
        let joint = tree.bodies[5].joint.as_mut().unwrap();
        joint.axis = nalgebra::Unit::new_normalize(V::new(0.1, 1.0, 0.0));
    });
    assert!(turned.contains("joint \"FL_thigh\""), "{turned}");
    let posed = refused(&|tree| tree.bodies[1].joint.as_mut().unwrap().rest = Some(0.3));
    assert!(posed.contains("has no mirror image"), "{posed}");
    let mut draw = SignedDraw::new(3);
    for _ in 0..20 {
        assert!(Symmetry::of(&model(random_tree(&mut draw, 8))).is_err());
    }
}

/// The quadruped's front is turned to its side, as in files whose front is along y: it is symmetric in front and back.
#[test]
fn a_front_along_y_is_found() {
    let mut tree = quadruped();
    let turn = nalgebra::UnitQuaternion::from_axis_angle(&V::z_axis(), std::f64::consts::FRAC_PI_2);
    for body in &mut tree.bodies {
        if body.parent == 0 {
            body.origin = nalgebra::Isometry3::from_parts(V::zeros().into(), turn) * body.origin;
        }
    }
    let base = &mut tree.bodies[0];
    base.center = turn * base.center;
    let square = turn.to_rotation_matrix();
    base.inertia = square * base.inertia * square.inverse();
    let robot = model(tree.clone());
    let symmetry = Symmetry::of(&robot).unwrap();
    let plain = Symmetry::of(&model(quadruped())).unwrap();
    assert_eq!((symmetry.sides, &symmetry.joints), (Sides::FrontBack, &plain.joints));
    let (mut draw, rest) = (SignedDraw::new(8), &robot.stance.angles);
    let here = pose(&mut draw, rest);
    let there = symmetry.pose(rest, &here);
    let [a, b] = [&here, &there].map(|pose| accelerations(&robot.tree, pose));
    let near = |x: f64, y: f64| assert!((x - y).abs() < 1e-9 * (1.0 + x.abs()), "{x} {y}");
    (0..3).for_each(|k| near(if k == 0 { -a.a[k] } else { a.a[k] }, b.a[k]));
    (0..3).for_each(|k| near(if k == 0 { a.alpha[k] } else { -a.alpha[k] }, b.alpha[k]));
    symmetry.swap(&a.qdd).iter().zip(&b.qdd).for_each(|(x, y)| near(*x, *y));
}

/// A pose that turns left and right the same way becomes the mean with its mirror image.
#[test]
fn a_twisted_pose_is_evened() {
    let robot = model(quadruped());
    let symmetry = Symmetry::of(&robot).unwrap();
    let rest = &robot.stance.angles;
    let twisted: Vec<f64> = rest.iter().enumerate().map(|(k, q)| q + if k % 3 == 0 { 0.05 } else { 0.1 }).collect();
    let even = symmetry.evened(rest, &twisted);
    let expected = rest.iter().enumerate().map(|(k, q)| q + if k % 3 == 0 { 0.0 } else { 0.1 });
    even.iter().zip(expected).for_each(|(got, wanted)| assert!((got - wanted).abs() < 1e-12, "{got} {wanted}"));
}
