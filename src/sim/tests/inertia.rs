//! Masses and principal axes of bodies for rapier.

use sandgait_sim::frame::{M, V};
use sandgait_sim::rapier::inertia::*;

#[test]
fn principal_axes_rebuild_the_matrix() {
    let b = M::new(3.0, 0.4, -1.1, 0.4, 2.0, 0.7, -1.1, 0.7, 5.0);
    for matrix in [b, M::from_diagonal(&V::new(1.0, 2.0, 3.0)), V::x() * V::x().transpose(), M::zeros()] {
        let (moments, axes) = principal(&matrix);
        let rebuilt = axes * M::from_diagonal(&moments) * axes.transpose();
        assert!((rebuilt - matrix).norm() < 1e-13, "{rebuilt} is not {matrix}");
        assert!((axes.determinant() - 1.0).abs() < 1e-13);
    }
}

/// Two masses on a line and a body: parallel-axis theorem written out by hand.
#[test]
fn moments_follow_the_parallel_axis_theorem() {
    let mut two = Masses::none();
    two.add(1.0, V::new(1.0, 0.0, 0.0));
    two.add(3.0, V::new(-1.0, 0.0, 0.0));
    assert!((two.center() - V::new(-0.5, 0.0, 0.0)).norm() < 1e-15);
    // reduced mass 3/4 kg, 2 m apart
    assert!((two.inertia() - M::from_diagonal(&V::new(0.0, 3.0, 3.0))).norm() < 1e-14);
    // vertical inertia only: no resistance to turning about z
    assert!((two.inertia_along(V::z()) - M::from_diagonal(&V::new(0.0, 3.0, 0.0))).norm() < 1e-14);
    let inertia = M::from_diagonal(&V::new(0.1, 0.2, 0.25));
    let body = Masses::body(2.0, V::new(0.3, 0.1, -0.2), inertia);
    assert!((body.inertia() - inertia).norm() < 1e-14);
}
