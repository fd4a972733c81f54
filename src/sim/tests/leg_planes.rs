//! Planes of links.

use sandgait_sand::Medium;
use sandgait_sim::Model;
use sandgait_sim::Robot;
use sandgait_sim::frame::{M, V};
use sandgait_sim::lanes::model::*;
use sandgait_sim::lanes::plane::PlaneMoments;
use sandgait_sim::model::Scene;

fn model(robot: &str, shape: &str) -> Model {
    let robot = Robot::load(robot).unwrap().with_leg_shape(shape).unwrap();
    Model::new(&robot, &Scene::flat(Medium::named("poppy-loose").unwrap())).unwrap()
}

/// The coordinates in the plane give back every plate and the inertia about the joint.
#[test]
fn planes_hold_all_of_a_link() {
    for (robot, shape) in [("xplorer", "L"), ("xplorer", "revC"), ("xplorer", "flat"), ("xplorer18", "xi=30")] {
        let model = model(robot, shape);
        check_planes(&model).unwrap();
        for body in model.legs.iter().flatten() {
            let [e0, e1] = plane(body);
            assert!(e0.dot(&e1).abs() < 1e-12 && (e0.norm() - 1.0).abs() < 1e-12, "{robot} {shape}");
            let back = |v: V| e0 * in_plane(v, [e0, e1])[0] + e1 * in_plane(v, [e0, e1])[1];
            for p in body.plates.iter().chain(&body.chord) {
                assert!((back(p.center) - p.center).norm() < 1e-12, "{robot} {shape}");
                assert!((back(p.normal) - p.normal).norm() < 1e-12, "{robot} {shape}");
            }
            let PlaneMoments { mass, first, second: [m00, m01, m11] } = moments(body, [e0, e1]);
            let about = e0 * e0.transpose() * m00
                + (e0 * e1.transpose() + e1 * e0.transpose()) * m01
                + e1 * e1.transpose() * m11;
            let (arm, center) = (e0 * first[0] + e1 * first[1], body.center);
            let inertia = body.inertia + (M::identity() * center.norm_squared() - center * center.transpose()) * mass;
            assert!((M::identity() * about.trace() - about - inertia).norm() < 1e-12 * inertia.norm());
            assert!((arm - center * mass).norm() < 1e-15);
        }
    }
}

#[test]
fn bodies_out_of_a_plane_are_refused() {
    let refused = |change: fn(&mut Model), word: &str| {
        let mut model = model("xplorer", "L");
        change(&mut model);
        assert!(check_planes(&model).unwrap_err().to_string().contains(word));
    };
    refused(|m| m.legs[2][0].plates[3].center.y += 1e-4, "leg");
    refused(|m| m.legs[2][0].plates[3].normal.y += 1e-4, "leg");
    refused(|m| m.legs[2][0].center.y += 1e-4, "leg");
    refused(|m| m.legs[2][0].inertia[(0, 0)] *= 1.1, "leg");
    refused(|m| m.belly[4].center.z += 1e-4, "belly");
    refused(|m| m.belly[4].normal = V::x(), "belly");
}
