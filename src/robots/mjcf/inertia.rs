//! The inertia that each joint moves in the reference pose, from which MuJoCo computes the damping of servos with a
//! `dampratio`: 1/(M⁻¹)ᵢᵢ with the mass matrix M, so all other joints, and a free base, yield.

use crate::sim::tree::kinematics::chain;
use crate::sim::tree::{JointKind, Tree};
use nalgebra::{DMatrix, Isometry3, Vector3};

/// The inertias, in the order of [`Tree::joints`], with joints at `angles`; None: the mass matrix has no inverse.
pub fn of_joints(tree: &Tree, angles: &[f64], base_is_free: bool) -> Option<Vec<f64>> {
    let frames = chain(tree, Isometry3::identity(), angles);
    let first = if base_is_free { 6 } else { 0 };
    let count = first + angles.len();
    let mut matrix = DMatrix::zeros(count, count);
    for (i, (body, frame)) in tree.bodies.iter().zip(&frames).enumerate() {
        let center = frame.transform_point(&body.center.into()).coords;
        let (mut spins, mut moves) = (DMatrix::zeros(3, count), DMatrix::zeros(3, count));
        if base_is_free {
            moves.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
            spins.fixed_view_mut::<3, 3>(0, 3).fill_with_identity();
            moves.fixed_view_mut::<3, 3>(0, 3).copy_from(&-center.cross_matrix());
        }
        let mut at = i;
        while at > 0 {
            if let Some((kind, axis)) = tree.bodies[at].axis(&frames[at]) {
                let arm = center - frames[at].translation.vector;
                let (spin, linear) = match kind {
                    JointKind::Hinge => (axis, axis.cross(&arm)),
                    JointKind::Slide => (Vector3::zeros(), axis),
                };
                spins.column_mut(first + at - 1).copy_from(&spin);
                moves.column_mut(first + at - 1).copy_from(&linear);
            }
            at = tree.bodies[at].parent;
        }
        let turn = frame.rotation.to_rotation_matrix().into_inner();
        let inertia = turn * body.inertia * turn.transpose();
        matrix += moves.transpose() * &moves * body.mass + spins.transpose() * inertia * &spins;
    }
    for (i, joint) in tree.joints().enumerate() {
        matrix[(first + i, first + i)] += joint.armature;
    }
    let inverse = matrix.cholesky()?.inverse();
    Some((first..count).map(|i| 1.0 / inverse[(i, i)]).collect())
}
