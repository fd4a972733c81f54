//! Random trees, and the equations that their accelerations must satisfy.

use nalgebra::{Isometry3, Matrix3, Unit, Vector3};
use nalgebra::{Rotation3, UnitQuaternion};
use sandgait_sim::tree::flight::{GRAVITY, TreeAccelerations, TreePose, accelerations, accelerations_by};
use sandgait_sim::tree::*;

pub mod engine;
mod forces;
pub mod models;
mod sand;
mod self_contact;
mod walk;

type V = Vector3<f64>;
type M = Matrix3<f64>;

/// Numbers in [−1, 1), the same on every machine.
pub struct SignedDraw(u64);

impl SignedDraw {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    /// Xorshift (Marsaglia 2003).
    pub fn number(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    pub fn vector(&mut self) -> V {
        V::new(self.number(), self.number(), self.number())
    }

    pub fn numbers(&mut self, count: usize, scale: f64) -> Vec<f64> {
        (0..count).map(|_| scale * self.number()).collect()
    }
}

/// A tree of `count` bodies like a robot's in masses and lengths: hinges and slides, branches, inertia in any direction.
pub fn random_tree(draw: &mut SignedDraw, count: usize) -> Tree {
    let mut bodies: Vec<TreeBody> = Vec::new();
    for i in 0..count {
        // Depth first: the parent is the last body or one of its ancestors.
        let mut parent = i.saturating_sub(1);
        while i > 1 && parent > 0 && draw.number() > 0.2 {
            parent = bodies[parent].parent;
        }
        let turn = UnitQuaternion::from_scaled_axis(draw.vector());
        let [a, b, c] = [0; 3].map(|_| 1.5 + draw.number());
        let (mass, size) = (1.5 + draw.number(), 0.05);
        let principal = M::from_diagonal(&V::new(b + c, a + c, a + b)) * (mass * size * size);
        let joint = (i > 0).then(|| TreeJoint {
            name: format!("joint {i}"),
            kind: if draw.number() > 0.5 { JointKind::Slide } else { JointKind::Hinge },
            axis: Unit::new_normalize(draw.vector()),
            range: None,
            damping: 0.0,
            friction: 0.0,
            spring: None,
            mimic: None,
            armature: 0.0,
            torque_limit: None,
            speed_limit: None,
            motor: Default::default(),
            kp: None,
            kd: None,
            rest: None,
            target_time: None,
        });
        bodies.push(TreeBody {
            name: format!("body {i}"),
            parent,
            origin: Isometry3::from_parts(
                (draw.vector() * 0.3).into(),
                UnitQuaternion::from_scaled_axis(draw.vector()),
            ),
            joint,
            mass,
            center: draw.vector() * 0.1,
            inertia: turn.to_rotation_matrix() * principal * turn.to_rotation_matrix().inverse(),
            held: Default::default(),
            shapes: Vec::new(),
        });
    }
    Tree { name: "random".into(), bodies, gravity: None }
}

pub fn random_pose(draw: &mut SignedDraw, joints: usize) -> TreePose {
    let quat = UnitQuaternion::from_scaled_axis(draw.vector() * 3.0);
    TreePose {
        quat: [quat.w, quat.i, quat.j, quat.k],
        v: draw.vector().into(),
        w: (draw.vector() * 2.0).into(),
        q: draw.numbers(joints, 0.8),
        qd: draw.numbers(joints, 3.0),
        tau: draw.numbers(joints, 2.0),
    }
}

/// Motion of a body's frame and centre of mass, in classical mechanics.
struct Moving {
    turn: Rotation3<f64>,
    at: V,
    v: V,
    a: V,
    w: V,
    alpha: V,
}

impl Moving {
    fn velocity(&self, p: V) -> V {
        self.v + self.w.cross(&(p - self.at))
    }

    fn acceleration(&self, p: V) -> V {
        let arm = p - self.at;
        self.a + self.alpha.cross(&arm) + self.w.cross(&self.w.cross(&arm))
    }
}

/// Computes the motion of every body from the joints' motion, by the rules for moving frames.
fn motions(tree: &Tree, pose: &TreePose, found: &TreeAccelerations) -> Vec<Moving> {
    let [w, x, y, z] = pose.quat;
    let quat = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
    let mut all = vec![Moving {
        turn: quat.to_rotation_matrix(),
        at: V::zeros(),
        v: pose.v.into(),
        a: found.a.into(),
        w: pose.w.into(),
        alpha: found.alpha.into(),
    }];
    for (i, body) in tree.bodies.iter().enumerate().skip(1) {
        let (p, joint) = (&all[body.parent], body.joint.as_ref().unwrap());
        let (q, qd, qdd) = (pose.q[i - 1], pose.qd[i - 1], found.qdd[i - 1]);
        let mut turn = p.turn * body.origin.rotation.to_rotation_matrix();
        let mut at = p.at + p.turn * body.origin.translation.vector;
        let axis = turn * joint.axis.into_inner();
        let (mut w, mut alpha, mut dv, mut da) = (p.w, p.alpha, V::zeros(), V::zeros());
        match joint.kind {
            JointKind::Hinge => {
                turn = Rotation3::from_axis_angle(&Unit::new_unchecked(axis), q) * turn;
                w += axis * qd;
                alpha += axis * qdd + p.w.cross(&axis) * qd;
            }
            JointKind::Slide => {
                at += axis * q;
                dv = axis * qd;
                // The Coriolis term, twice the frame's rate times the relative velocity.
                da = axis * qdd + 2.0 * p.w.cross(&axis) * qd;
            }
        }
        let moving = Moving { turn, at, v: p.velocity(at) + dv, a: p.acceleration(at) + da, w, alpha };
        all.push(moving);
    }
    all
}

/// Force, and moment about point `about`, that the motion of all bodies of the branch at `root` needs.
fn needed(tree: &Tree, motions: &[Moving], root: usize, about: V) -> (V, V) {
    let (mut force, mut moment) = (V::zeros(), V::zeros());
    for (i, (body, m)) in tree.bodies.iter().zip(motions).enumerate() {
        let mut up = i;
        while up > root {
            up = tree.bodies[up].parent;
        }
        if up != root {
            continue;
        }
        let c = m.at + m.turn * body.center;
        let inertia = m.turn.matrix() * body.inertia * m.turn.matrix().transpose();
        let f = (m.acceleration(c) + V::z() * GRAVITY) * body.mass;
        force += f;
        moment += (c - about).cross(&f) + inertia * m.alpha + m.w.cross(&(inertia * m.w));
    }
    (force, moment)
}

/// Newton's and Euler's equations hold, body by body, for the computed accelerations: no net force on the whole, the
/// given torque at each joint. The test uses no spatial algebra.
#[test]
fn every_branch_is_in_balance() {
    let mut draw = SignedDraw::new(1);
    for count in [1, 2, 5, 13, 30] {
        for _ in 0..10 {
            let tree = random_tree(&mut draw, count);
            let pose = random_pose(&mut draw, count - 1);
            let found = accelerations(&tree, &pose);
            let motions = motions(&tree, &pose, &found);
            let scale = 1.0 + found.qdd.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
            let (force, moment) = needed(&tree, &motions, 0, V::zeros());
            assert!(force.norm() < 1e-10 * scale && moment.norm() < 1e-10 * scale, "{count}: {force} {moment}");
            for i in 1..count {
                let (force, moment) = needed(&tree, &motions, i, motions[i].at);
                let joint = tree.bodies[i].joint.as_ref().unwrap();
                let axis = motions[i].turn * joint.axis.into_inner();
                let along = match joint.kind {
                    JointKind::Hinge => moment.dot(&axis),
                    JointKind::Slide => force.dot(&axis),
                };
                assert!((along - pose.tau[i - 1]).abs() < 1e-10 * scale, "{count}, joint {i}: {along}");
            }
        }
    }
}

/// For linear, angular and joint accelerations each: the largest difference divided by the largest acceleration.
/// Returns the greatest of the three ratios.
pub fn difference(a: &TreeAccelerations, b: &TreeAccelerations) -> f64 {
    let of = |a: &[f64], b: &[f64]| {
        let most = b.iter().fold(1e-9_f64, |m, x| m.max(x.abs()));
        a.iter().zip(b).fold(0.0_f64, |m, (a, b)| m.max((a - b).abs())) / most
    };
    of(&a.a, &b.a).max(of(&a.alpha, &b.alpha)).max(of(&a.qdd, &b.qdd))
}

/// Single precision, as one number and in portable lanes, gives the accelerations of double precision.
#[test]
fn single_precision_is_enough() {
    let mut draw = SignedDraw::new(2);
    for _ in 0..50 {
        let tree = random_tree(&mut draw, 13);
        let pose = random_pose(&mut draw, 12);
        let exact = accelerations(&tree, &pose);
        let single = accelerations_by::<f32>(&tree, &pose);
        let lanes = accelerations_by::<sandgait_number::Portable>(&tree, &pose);
        assert!(difference(&single, &exact) < 1e-4, "{}", difference(&single, &exact));
        assert!(difference(&lanes, &exact) < 1e-4, "{}", difference(&lanes, &exact));
    }
}
