//! Our own robots, of identical legs, as trees.

use super::{Geometry, HeldMass, JointKind, Tree, TreeBody, TreeJoint, TreeShape};
use crate::error::Result;
use crate::model::{Model, Scene, StripPiece};
use crate::robot::Robot;
use crate::sand::Medium;
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, Unit, UnitQuaternion, Vector3};

/// Thickness of strips [m]: our choice, for pictures; the physics treats them as thin.
const THICKNESS: f64 = 0.002;
/// Friction of shapes whose file gives none: MuJoCo's default.
const FRICTION: f64 = 1.0;

/// `robot` as a tree, with its strips as flat boxes.
pub fn of_robot(name: &str, robot: &Robot) -> Result<Tree> {
    let model = Model::new(robot, &Scene::flat(Medium::named(Medium::DEFAULT)?))?;
    let shape =
        |name: String, origin, half| TreeShape { name, origin, geometry: Geometry::Box { half }, friction: FRICTION };
    let mut bodies = vec![TreeBody {
        name: "base".into(),
        parent: 0,
        origin: Isometry3::identity(),
        joint: None,
        mass: model.base_mass,
        center: Vector3::zeros(),
        inertia: Matrix3::from_diagonal(&model.base_inertia),
        held: HeldMass::default(),
        shapes: vec![shape("base".into(), Isometry3::identity(), Vector3::from(robot.base.size) / 2.0)],
    }];
    let mut names = robot.joint_names().into_iter();
    let limit = |x: Option<f64>| x.filter(|x| x.is_finite());
    for chain in &model.legs {
        let mut parent = 0;
        for body in chain {
            let name = names.next().unwrap_or_default();
            let many = body.pieces.len() > 1;
            let shapes = body.pieces.iter().enumerate().map(|(k, piece)| {
                let name = if many { format!("{name}/{}", k + 1) } else { name.clone() };
                shape(name, place(piece), Vector3::new(piece.size[0], piece.size[1], THICKNESS) / 2.0)
            });
            bodies.push(TreeBody {
                parent,
                origin: Isometry3::from_parts(Translation3::from(body.joint), UnitQuaternion::identity()),
                joint: Some(TreeJoint {
                    name: name.clone(),
                    kind: JointKind::Hinge,
                    axis: Unit::new_normalize(body.axis),
                    range: body.range,
                    damping: 0.0,
                    friction: 0.0,
                    spring: None,
                    mimic: None,
                    armature: body.armature,
                    torque_limit: limit(robot.servo.torque_limit),
                    speed_limit: limit(robot.servo.speed_limit),
                    motor: robot.servo.actuator(),
                    kp: Some(robot.servo.kp),
                    kd: Some(robot.servo.kd),
                    rest: None,
                    target_time: None,
                }),
                mass: body.mass,
                center: body.center,
                inertia: body.inertia,
                held: HeldMass::default(),
                shapes: if body.plates.is_empty() { Vec::new() } else { shapes.collect() },
                name,
            });
            parent = bodies.len() - 1;
        }
    }
    Ok(Tree { name: name.to_owned(), bodies, gravity: None })
}

fn place(piece: &StripPiece) -> Isometry3<f64> {
    let axes = Matrix3::from_columns(&[piece.along, piece.across, piece.along.cross(&piece.across)]);
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    Isometry3::from_parts(Translation3::from(piece.center), turn)
}
