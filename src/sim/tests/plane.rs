//! Forces and masses of plates in a plane.

use sandgait_number::Mat3;
use sandgait_number::Vec3;
use sandgait_sim::lanes::plane::*;
use sandgait_sim::spatial::Inertia;
use sandgait_sim::spatial::{PointMasses, Symmetric, Twist, Wrench};

fn close(a: Vec3<f64>, b: Vec3<f64>) {
    assert!((a - b).norm_squared().sqrt() < 1e-12, "{a:?} is not {b:?}");
}

fn same(a: &Symmetric<f64>, b: &Symmetric<f64>) {
    close(a.diagonal, b.diagonal);
    close(a.off, b.off);
}

/// Sums over the pieces in the plane's coordinates equal sums piece by piece in space: wrench, inertia, the
/// inertia of a slope along the normal, and the wrench of a motion.
#[test]
fn the_planar_form_is_the_general_form() {
    let mut k = 0.0_f64;
    let mut draw = || {
        k += 1.0;
        (k * k).sin()
    };
    let mut vector = || Vec3::new(draw(), draw(), draw());
    let (e0, other) = (vector(), vector());
    let places = PlaneField { at: vector(), by: [e0, e0.cross(other)] };
    let normal = e0.cross(places.by[1]);
    let (velocity, acceleration) =
        (Twist { angular: vector(), linear: vector() }, Twist { angular: vector(), linear: vector() });
    let velocities = places.velocity(&velocity);
    let accelerations = places.velocity(&acceleration).plus(&velocities.cross(-velocity.angular));

    let (mut forces, mut masses) = (PlaneForces::zero(), PlaneMoments::zero());
    let (mut wrench, mut motion, mut along) = (Wrench::zero(), Wrench::zero(), Inertia::points(&PointMasses::zero()));
    let mut gathered = PointMasses::zero();
    for _ in 0..20 {
        let (Vec3 { x, y, z: mass }, force) = (vector(), vector());
        let (p, r) = ([x, y], places.value([x, y]));
        close(velocity.at(r), velocities.value(p));
        forces.add(force, p);
        masses.add(mass, p);
        wrench.add(&at(r, force));
        motion.add(&at(r, (acceleration.at(r) + velocity.angular.cross(velocity.at(r))) * mass));
        along.add_outer(mass, &at(r, normal));
        gathered.mass += mass;
        gathered.first += r * mass;
        gathered.second.add_outer(mass, r);
    }
    close(forces.wrench(&places).force, wrench.force);
    close(forces.wrench(&places).moment, wrench.moment);
    let moving = masses.forces(&accelerations).wrench(&places);
    close(moving.force, motion.force);
    close(moving.moment, motion.moment);
    let planar = masses.of(&places);
    assert!((planar.mass - gathered.mass).abs() < 1e-12);
    close(planar.first, gathered.first);
    same(&planar.second, &gathered.second);
    let mut outers = Inertia::points(&PointMasses::zero());
    outers.add_outers(&masses.of(&places.cross(normal)), normal);
    same(&outers.rotary, &along.rotary);
    same(&outers.linear, &along.linear);
    let columns = |m: Mat3<f64>| [m.x, m.y, m.z];
    columns(outers.coupling).into_iter().zip(columns(along.coupling)).for_each(|(a, b)| close(a, b));
}

fn at(r: Vec3<f64>, force: Vec3<f64>) -> Wrench<f64> {
    Wrench { moment: r.cross(force), force }
}
