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
    let sides = LeftRight::of(&robot).unwrap();
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
    let plain = LeftRight::of(&model(tree.clone())).unwrap();
    assert_eq!(plain.lopsided(&model(tree.clone())), None);
    tree.bodies[6].mass *= 3.0;
    let heavy = model(tree);
    assert_eq!(LeftRight::of(&heavy).unwrap(), plain);
    assert!(plain.lopsided(&heavy).unwrap() > 0.25);
}

#[test]
fn robots_without_a_symmetry_are_refused() {
    let refused = |change: &dyn Fn(&mut Tree)| {
        let mut tree = quadruped();
        change(&mut tree);
        LeftRight::of(&model(tree)).unwrap_err().to_string()
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
        assert!(LeftRight::of(&model(random_tree(&mut draw, 8))).is_err());
    }
}
