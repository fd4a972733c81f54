//! Solids: hulls, tops and depths.

use sandgait_sim::frame::V;
use sandgait_sim::solid::*;
use std::f64::consts::PI;

fn close(a: f64, b: f64) {
    assert!((a - b).abs() < 1e-5 * b.abs().max(1e-3), "{a} is not {b}");
}

/// A box given as a hull of its corners, shifted, equals the box.
#[test]
fn a_hull_of_a_boxs_corners_is_the_box() {
    let cuboid = Solid::cuboid([0.2, 0.3, 0.5]);
    let points: Vec<_> = cuboid.corners.iter().map(|c| [c.x + 0.1, c.y - 0.2, c.z + 0.3]).collect();
    let hull = Solid::hull(&points).unwrap();
    close(hull.volume, 0.03);
    assert!((hull.inertia - cuboid.inertia).norm() < 1e-5 * cuboid.inertia.norm());
    let area = |s: &Solid| s.facets.iter().map(|f| f.area).sum::<f64>();
    close(area(&hull), 0.62);
    close(area(&cuboid), 0.62);
    let pose = RigidPose::new([1.0, 2.0, 0.1], [0.8, 0.6, 0.0, 0.0]);
    for point in [V::new(1.0, 2.0, 0.1), V::new(1.05, 2.1, 0.2), V::new(3.0, 0.0, 0.0)] {
        close(hull.depth(&pose, point), cuboid.depth(&pose, point));
    }
    close(hull.top(&pose, 1.02, 2.03).unwrap(), cuboid.top(&pose, 1.02, 2.03).unwrap());
    assert!(hull.top(&pose, 1.2, 2.0).is_none());
    assert!(Solid::hull(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]]).is_err());
}

#[test]
fn tops_and_depths_by_hand() {
    let pose = RigidPose::new([0.0, 0.0, 0.02], [1.0, 0.0, 0.0, 0.0]);
    let (ball, cube) = (Solid::sphere(0.05), Solid::cuboid([0.1, 0.1, 0.1]));
    close(ball.top(&pose, 0.03, 0.0).unwrap(), 0.02 + 0.04);
    assert!(ball.top(&pose, 0.051, 0.0).is_none());
    close(ball.depth(&pose, V::new(0.0, 0.0, 0.06)), 0.01);
    close(cube.top(&pose, 0.049, 0.0).unwrap(), 0.07);
    close(cube.depth(&pose, V::new(0.04, 0.0, 0.0)), 0.01);
    close(ball.facets.iter().map(|f| f.area).sum(), 4.0 * PI * 0.05 * 0.05);
    let closed = |s: &Solid| s.facets.iter().map(|f| f.normal * f.area).sum::<V>().norm();
    assert!(closed(&ball) < 1e-12 && closed(&cube) < 1e-12);
    for [a, b, c] in cube.faces.iter().map(|f| f.map(|i| cube.corners[i])) {
        assert!((b - a).cross(&(c - a)).dot(&a) > 0.0, "a face looks inward");
    }
}
