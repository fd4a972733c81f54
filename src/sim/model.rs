//! Robot, sand and options as numbers for an engine. Immutable; randomization makes a new model.

use super::actuator::Actuator;
use super::obstacle::{self, Obstacle};
use super::robot::{Link, Robot, Servo, Tripod};
use super::solid::Solid;
use super::state::{ObjectState, State};
use super::tree::relief::Relief;
use super::tree::{HardGround, TreeModel};
use crate::error::{Error, Result, check_range};
use crate::number::Real;
use crate::sand::memory::{MemorySettings, Moved, REPOSE_DEG};
use crate::sand::{Law, LegShape, Mechanisms, Medium, Regularization, SandBed, SandDescription, Segment};
use crate::stop::NO_LIMIT;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

pub use super::solid::Plate;
pub use crate::sand::GRAVITY;

type V = nalgebra::Vector3<f64>;
type M = nalgebra::Matrix3<f64>;

/// The ground that the robot walks on, and the time step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    pub medium: Medium,
    pub law: Law,
    #[serde(default)]
    pub surface: Regularization,
    /// Mechanisms. Those of sensors and logs have no effect here.
    #[serde(default)]
    pub mechanisms: Mechanisms,
    /// The surface rises toward +x [°]; gravity tilts in the surface's frame.
    pub slope_deg: f64,
    /// Time step [s].
    pub dt: f64,
    /// Extra mass at the base's centre [kg].
    pub payload: f64,
    /// Rigid obstacles in the sand; only engine `rapier` supports them.
    #[serde(default)]
    pub obstacles: Vec<Obstacle>,
    /// Hard ground in the sand or in place of it; only engine `tree` supports it.
    #[serde(default)]
    pub hard: Vec<HardGround>,
    /// Heights of the surface; None: flat. Only engine `tree` supports it. It is not part of a stored scene; the code
    /// that reads a scene adds it.
    #[serde(skip)]
    pub relief: Option<Arc<Relief>>,
    /// Sand that was moved stays moved; None: the surface is always as at the start. Engines `lanes` and `tree` support
    /// it, on flat sand.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory: Option<MemorySettings>,
}

/// Cells along a side of the square of heights that moves with a robot, as a power of two: 64. Our choice: 12 KiB.
const BITS: u32 = 6;
/// Most cells from the robot's middle to its farthest point: our choice, so that some cells are left around it while the
/// square follows in steps of eight cells.
const WITHIN: f64 = 22.0;

impl Scene {
    /// Time step of engine `lanes`, 1 ms: the largest at which its reference walks are within 1 % of the converged
    /// ones (`docs/convergence.md`). Other engines have their own: [`super::engine::EngineKind::default_dt`].
    pub const DEFAULT_DT: f64 = 1e-3;

    /// Steepest slope, uphill or downhill [°]: natural slopes of dry sand end near 35°, its angle of repose.
    pub const MAX_SLOPE_DEG: f64 = 35.0;

    /// Largest payload [kg].
    pub const MAX_PAYLOAD: f64 = 1e3;

    pub fn flat(medium: Medium) -> Self {
        Self {
            medium,
            law: Law::Li2013,
            surface: Regularization::default(),
            mechanisms: Mechanisms::PLAIN,
            slope_deg: 0.0,
            dt: Self::DEFAULT_DT,
            payload: 0.0,
            obstacles: Vec::new(),
            hard: Vec::new(),
            relief: None,
            memory: None,
        }
    }

    /// A flat scene of this sand.
    pub fn on(sand: &SandDescription) -> Self {
        let mut scene = Self::flat(sand.medium());
        scene.set_sand(sand);
        scene
    }

    /// Replaces medium, law and mechanisms.
    pub fn set_sand(&mut self, sand: &SandDescription) {
        (self.medium, self.law, self.mechanisms) = (sand.medium(), sand.law, sand.mechanisms);
    }

    /// Gives the sand memory, for `robot`: cells of half a leg's width, or so large that the square contains the robot.
    pub fn remember(&mut self, robot: &Robot) {
        let width = robot.leg.link.iter().rev().find_map(|link| link.sand.as_ref()).map_or(0.01, |strip| strip.width);
        let long = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
        let legs: f64 = robot.leg.link.iter().map(|link| long(link.reach)).sum();
        let reach = robot.hip.iter().map(|hip| long(hip.position)).fold(0.0, f64::max) + legs;
        let cell = (0.5 * width).max(reach / WITHIN);
        self.memory = Some(MemorySettings::new(&self.medium, cell, BITS, 2.0 * width, REPOSE_DEG));
    }

    /// The same for a tree robot: its square contains it as it stands.
    pub fn remember_tree(&mut self, tree: &TreeModel) {
        let cell = tree.reach().max(1e-3) / WITHIN;
        self.memory = Some(MemorySettings::new(&self.medium, cell, BITS, 2.0 * cell, REPOSE_DEG));
    }

    /// The sand, ready for evaluation.
    pub fn ground<R: Real>(&self) -> SandBed<R> {
        SandBed::new(self.law, &self.medium, &self.surface).with(&self.mechanisms, &self.medium)
    }

    /// Refuses what sand with memory is not defined for.
    fn check_memory(&self) -> Result<()> {
        let no = |reason: &str| Err(Error::invalid("memory", reason));
        if self.mechanisms.footprint != 0.0 {
            return no("the sand's footprint mechanism and memory describe the same thing: leave one out");
        }
        if !self.hard.is_empty() || self.relief.is_some() {
            return no("it is defined for flat sand: not with hard ground, dunes or a relief");
        }
        if !self.obstacles.is_empty() {
            return no("it is not defined for sand with obstacles");
        }
        Ok(())
    }

    fn validate(&self) -> Result<()> {
        check_range("slope_deg", self.slope_deg, -Self::MAX_SLOPE_DEG..=Self::MAX_SLOPE_DEG)?;
        self.mechanisms.validated()?;
        crate::sand::term::check(&self.medium.terms, &self.medium.coefficients, self.medium.bulk_density)?;
        check_range("dt", self.dt, 1e-6..=5e-3)?;
        check_range("payload", self.payload, 0.0..=Self::MAX_PAYLOAD)?;
        if let Some(memory) = &self.memory {
            memory.validate()?;
            self.check_memory()?;
        }
        check_range("surface.rest_speed", self.surface.rest_speed, 1e-9..=1e-2)?;
        check_range("surface.leading_edge_gate", self.surface.leading_edge_gate, 1e-3..=1.0)?;
        check_range("surface.sign_gate", self.surface.sign_gate, 1e-3..=1.0)?;
        let Some(friction) = self.surface.friction else { return Ok(()) };
        if self.law != Law::Agarwal2023 {
            return Err(Error::invalid("surface.friction", format!("{} has no friction cap", self.law.name())));
        }
        check_range("surface.friction", friction, 0.0..=10.0).map(drop)
    }
}

/// A flat, straight part of a link's strip, in the frame of the body that carries it. Rigid obstacles collide with
/// it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StripPiece {
    /// [m]
    pub center: V,
    /// Unit vectors along the strip and across it, in its plane.
    pub along: V,
    pub across: V,
    /// Length and width [m].
    pub size: [f64; 2],
}

/// A link's rigid body in its own frame: parallel to the base frame when all angles are 0, origin at its joint.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkBody {
    /// Joint position in the parent's frame [m].
    pub joint: V,
    /// Unit hinge axis (the same in parent and own frame).
    pub axis: V,
    /// [kg]
    pub mass: f64,
    /// Centre of mass [m].
    pub center: V,
    /// About the centre of mass [kg·m²].
    pub inertia: M,
    /// [kg·m²]
    pub armature: f64,
    pub range: Option<[f64; 2]>,
    pub plates: Vec<Plate>,
    /// The straight strip from joint to tip in place of `plates`, for `concave_fill`.
    pub chord: Vec<Plate>,
    /// Direction of the strip's bulge: 1 if the bulging side leads when the joint turns positively, −1 if the other
    /// side leads, 0 if the strip is straight.
    pub bulge: f64,
    pub pieces: Vec<StripPiece>,
    /// From the joint to the next one or the tip [m].
    pub reach: V,
}

/// The servo at every joint. A missing limit is `f64::MAX` of the engine's precision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motor {
    /// [N·m/rad]
    pub kp: f64,
    /// [N·m·s/rad]
    pub kd: f64,
    pub actuator: Actuator,
    /// [rad/s]
    pub speed_limit: f64,
    /// Largest distance of the reference from the joint's angle [rad]. With `anti_windup` it is torque_limit/kp, where
    /// the position gain alone demands the full torque. A larger lag would not increase the torque; it would only keep
    /// the torque after the command has changed (integrator windup; clamping is the usual remedy: Åström & Murray,
    /// Feedback Systems, 2008, section 10.4).
    pub lag_limit: f64,
}

impl Motor {
    fn new(servo: &Servo, mechanisms: &Mechanisms) -> Self {
        let own = servo.torque_limit.unwrap_or(NO_LIMIT);
        // The torque limit of a weak motor, if that is lower.
        let weak = mechanisms.motor_torque_limit;
        let torque_limit = if weak > 0.0 { own.min(weak) } else { own };
        let lag_limit = if servo.anti_windup && servo.kp > 0.0 { torque_limit / servo.kp } else { NO_LIMIT };
        Self {
            kp: servo.kp,
            kd: servo.kd,
            actuator: Actuator {
                torque_limit: Some(torque_limit),
                stall_torque: servo.stall_torque,
                no_load_speed: servo.no_load_speed,
                time_constant: servo.torque_time,
            },
            speed_limit: servo.speed_limit.unwrap_or(NO_LIMIT),
            lag_limit: lag_limit.min(NO_LIMIT),
        }
    }
}

/// All data that an engine needs and does not change.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    pub robot: Robot,
    pub scene: Scene,
    /// Base with payload [kg].
    pub base_mass: f64,
    /// Principal inertia of the base about its centre [kg·m²].
    pub base_inertia: V,
    /// One-sided plates under the base.
    pub belly: Vec<Plate>,
    /// One chain of bodies a hip, from the hip outward; all chains have the same length.
    pub legs: Vec<Vec<LinkBody>>,
    pub motor: Motor,
    /// Gravity in the surface's frame [m/s²].
    pub gravity: V,
    /// Geometry of the scene's obstacles.
    pub solids: Vec<Solid>,
    /// A robot that is a tree of bodies. Such a model has no legs in `legs`, and of `robot` only the name is used.
    pub tree: Option<Arc<TreeModel>>,
}

impl Model {
    pub fn new(robot: &Robot, scene: &Scene) -> Result<Self> {
        scene.validate()?;
        if !scene.hard.is_empty() {
            return Err(Error::invalid(
                "hard",
                format!("{:?} takes no hard ground; robots from URDF or MJCF files do", robot.name),
            ));
        }
        let size = V::from(robot.base.size).map(|s| s * s);
        let box_inertia = V::new(size.y + size.z, size.x + size.z, size.x + size.y) / 12.0;
        let legs = robot.hip.iter().map(|hip| leg(robot, hip.position, hip.yaw_deg.to_radians()));
        Ok(Self {
            base_mass: robot.base.mass + scene.payload,
            base_inertia: box_inertia * robot.base.mass,
            belly: belly(robot),
            legs: legs.collect::<Result<_>>()?,
            motor: Motor::new(&robot.servo, &scene.mechanisms),
            gravity: gravity(scene),
            solids: solids(&scene.obstacles)?,
            robot: robot.clone(),
            scene: scene.clone(),
            tree: None,
        })
    }

    /// A model of a tree robot; a payload lies at its base's centre of mass.
    pub fn of_tree(tree: TreeModel, scene: &Scene) -> Result<Self> {
        scene.validate()?;
        if !scene.obstacles.is_empty() {
            return Err(Error::invalid("obstacles", "engine tree does not support obstacles; use hard ground instead"));
        }
        if scene.hard.len() > HardGround::MOST {
            let reason = format!("{} pieces are more than {}", scene.hard.len(), HardGround::MOST);
            return Err(Error::invalid("hard", reason));
        }
        scene.hard.iter().try_for_each(HardGround::validate)?;
        if let Some(relief) = scene.relief.as_ref().filter(|_| !scene.hard.iter().any(HardGround::is_everything)) {
            relief.check_repose()?;
        }
        let tree =
            tree.with_payload(scene.payload).with_weak_motors(scene.mechanisms.motor_torque_limit).for_law(scene.law);
        let robot = Robot::bare(&tree.tree.name, tree.base_mass);
        Ok(Self {
            base_mass: tree.base_mass,
            base_inertia: tree.tree.bodies[0].inertia.diagonal(),
            belly: Vec::new(),
            legs: Vec::new(),
            motor: Motor::new(&robot.servo, &scene.mechanisms),
            gravity: gravity(scene),
            solids: Vec::new(),
            robot,
            scene: scene.clone(),
            tree: Some(Arc::new(tree)),
        })
    }

    /// Does the scene have sand?
    pub fn has_sand(&self) -> bool {
        !self.scene.hard.iter().any(HardGround::is_everything)
    }

    /// Number of bodies that find a surface of their own in sand with memory: the belly and the legs, or the bodies of a
    /// tree.
    pub fn sand_bodies(&self) -> usize {
        self.tree.as_ref().map_or(1 + self.legs.len(), |tree| tree.tree.bodies.len())
    }

    /// Memory of the sand around one robot [bytes]; 0 if it has none.
    pub fn sand_bytes(&self) -> usize {
        self.scene.memory.as_ref().map_or(0, |settings| Moved::bytes(settings, self.sand_bodies()))
    }

    /// Height of the ground at a place [m].
    pub fn surface_height(&self, x: f64, y: f64) -> f64 {
        self.scene.relief.as_ref().map_or(0.0, |relief| relief.at(x, y).0)
    }

    /// Joint angles of the whole robot, in the order of [`State::angles`].
    pub fn joint_names(&self) -> Vec<String> {
        match &self.tree {
            Some(tree) => tree.tree.joints().map(|j| j.name.clone()).collect(),
            None => self.robot.joint_names(),
        }
    }

    /// The same robot and sand with other obstacles.
    pub fn with_obstacles(&self, obstacles: &[Obstacle]) -> Result<Self> {
        let solids = solids(obstacles)?;
        let scene = Scene { obstacles: obstacles.to_vec(), ..self.scene.clone() };
        Ok(Self { scene, solids, ..self.clone() })
    }

    /// The obstacles that move, at rest at their initial poses.
    pub fn objects_at_rest(&self) -> Vec<ObjectState> {
        let loose = self.scene.obstacles.iter().filter(|o| o.moves());
        let at_rest = |o: &Obstacle| ObjectState {
            position: o.position,
            orientation: o.orientation,
            velocity: [0.0; 3],
            angular_velocity: [0.0; 3],
        };
        loose.map(at_rest).collect()
    }

    /// Number of joints of the whole robot.
    pub fn joints(&self) -> usize {
        self.tree.as_ref().map_or_else(|| self.legs.iter().map(Vec::len).sum(), |tree| tree.joints())
    }

    /// [kg]
    pub fn total_mass(&self) -> f64 {
        if let Some(tree) = &self.tree {
            return tree.mass();
        }
        self.base_mass + self.legs.iter().flatten().map(|b| b.mass).sum::<f64>()
    }

    /// Joint angles [rad] at the start of the alternating tripod: freely turning hips of tripod A point straight
    /// down, of B straight up; all other joints are at 0.
    pub fn tripod_angles(&self) -> Vec<f64> {
        let links = &self.robot.leg.link;
        let turns = |j: usize| j == 0 && links[j].range.is_none();
        let angle = |t: Tripod, j: usize| if t == Tripod::B && turns(j) { std::f64::consts::PI } else { 0.0 };
        self.robot.hip.iter().flat_map(|h| (0..links.len()).map(move |j| angle(h.tripod, j))).collect()
    }

    /// The same robot on other sand.
    pub fn with_medium(&self, medium: Medium) -> Self {
        Self {
            scene: Scene { memory: self.scene.memory.map(|m| m.on(&medium)), medium, ..self.scene.clone() },
            ..self.clone()
        }
    }

    /// Sets slope [°] and payload [kg]; values beyond a scene's bounds are clipped.
    pub fn set_load(&mut self, slope_deg: f64, payload: f64) {
        self.scene.slope_deg = slope_deg.clamp(-Scene::MAX_SLOPE_DEG, Scene::MAX_SLOPE_DEG);
        self.scene.payload = payload.clamp(0.0, Scene::MAX_PAYLOAD);
        self.base_mass = self.robot.base.mass + self.scene.payload;
        self.gravity = gravity(&self.scene);
    }

    /// Gives all motors this torque–speed line and lag, where they are given.
    pub fn with_motors(mut self, stall_torque: Option<f64>, no_load_speed: Option<f64>, torque_time: f64) -> Self {
        let servo = &mut self.robot.servo;
        servo.stall_torque = stall_torque.or(servo.stall_torque);
        servo.no_load_speed = no_load_speed.or(servo.no_load_speed);
        servo.torque_time = servo.torque_time.max(torque_time);
        self.motor = Motor::new(servo, &self.scene.mechanisms);
        for motor in self.tree.iter_mut().flat_map(|tree| &mut Arc::make_mut(tree).motors) {
            motor.stall_torque = stall_torque.or(motor.stall_torque);
            motor.speed_limit = no_load_speed.or(motor.speed_limit);
            motor.time_constant = motor.time_constant.max(torque_time);
        }
        self
    }

    /// Limits the motors' torque to `share`, at most 1, of the servos' torque limit.
    pub fn weaken_motors(&mut self, share: f64) {
        let servo = &mut self.robot.servo;
        for torque in [&mut servo.torque_limit, &mut servo.stall_torque].into_iter().flatten() {
            *torque *= share;
        }
        self.motor = Motor::new(&self.robot.servo, &self.scene.mechanisms);
    }

    /// Scales each leg's plate areas of `full`, the same robot, by `shares` [legs]; the sand's stress scales alike.
    pub fn scale_areas(&mut self, full: &Self, shares: &[f64]) {
        for ((chain, full), share) in self.legs.iter_mut().zip(&full.legs).zip(shares) {
            for (body, full) in chain.iter_mut().zip(full) {
                let plates = body.plates.iter_mut().chain(&mut body.chord).zip(full.plates.iter().chain(&full.chord));
                plates.for_each(|(plate, full)| plate.area = full.area * share);
            }
        }
    }

    /// Position of the tip of leg number `leg` [m], in the world.
    pub fn tip(&self, state: &State, leg: usize) -> [f64; 3] {
        let rows = state.rotation();
        let mut turn = nalgebra::Rotation3::from_matrix_unchecked(M::from_fn(|i, j| rows[i][j]));
        let mut place = V::from(state.position);
        let chain = &self.legs[leg];
        for (body, angle) in chain.iter().zip(&state.angles[leg * chain.len()..]) {
            place += turn * body.joint;
            turn *= nalgebra::Rotation3::from_axis_angle(&nalgebra::Unit::new_unchecked(body.axis), *angle);
        }
        (place + turn * chain.last().map_or(V::zeros(), |body| body.reach)).into()
    }

    /// Base height at which the lowest joint or tip touches the surface with the base level and joints at `angles`.
    pub fn standing_height(&self, angles: &[f64]) -> f64 {
        let mut angles = angles.iter();
        let mut lowest = -self.robot.belly.as_ref().map_or(0.0, |b| b.below);
        for chain in &self.legs {
            let (mut point, mut turn) = (V::zeros(), nalgebra::UnitQuaternion::identity());
            for body in chain {
                point += turn * body.joint;
                let angle = angles.next().copied().unwrap_or(0.0);
                turn *= nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Unit::new_normalize(body.axis), angle);
                lowest = lowest.min((point + turn * body.reach).z);
            }
        }
        -lowest
    }
}

/// Gravity in the surface's frame [m/s²].
fn gravity(scene: &Scene) -> V {
    let slope = scene.slope_deg.to_radians() + scene.mechanisms.slope;
    V::new(-slope.sin(), 0.0, -slope.cos()) * GRAVITY
}

fn solids(obstacles: &[Obstacle]) -> Result<Vec<Solid>> {
    if obstacles.len() > obstacle::MOST {
        let reason = format!("{} are more than {}", obstacles.len(), obstacle::MOST);
        return Err(Error::invalid("obstacles", reason));
    }
    obstacles.iter().map(Obstacle::solid).collect()
}

fn belly(robot: &Robot) -> Vec<Plate> {
    let Some(belly) = &robot.belly else { return Vec::new() };
    let [nx, ny] = belly.plates;
    let [dx, dy] = [belly.size[0] / nx as f64, belly.size[1] / ny as f64];
    let at = |i: usize, d: f64, length: f64| (i as f64 + 0.5) * d - length / 2.0;
    (0..nx * ny)
        .map(|k| Plate {
            center: V::new(at(k / ny, dx, belly.size[0]), at(k % ny, dy, belly.size[1]), -belly.below),
            normal: -V::z(),
            area: dx * dy,
            width: belly.size[1],
        })
        .collect()
}

fn leg(robot: &Robot, hip: [f64; 3], yaw: f64) -> Result<Vec<LinkBody>> {
    let turn = nalgebra::Rotation3::from_axis_angle(&V::z_axis(), yaw);
    let mut joint = V::from(hip);
    let mut chain = Vec::with_capacity(robot.leg.link.len());
    for link in &robot.leg.link {
        let reach = turn * V::from(link.reach);
        chain.push(body(link, joint, turn)?);
        joint = reach;
    }
    Ok(chain)
}

/// A link's mass is spread over its strip's segments as thin rods; without a strip, over the straight reach.
fn body(link: &Link, joint: V, turn: nalgebra::Rotation3<f64>) -> Result<LinkBody> {
    let reach = V::from(link.reach);
    let axis = V::from(link.axis).normalize();
    let down = reach.normalize();
    let width_axis = link.sand.as_ref().and_then(|s| s.width_axis).map_or(axis, |w| V::from(w).normalize());
    let forward = width_axis.cross(&down); // where the tip goes when the joint turns positively about the width axis
    let place = |p: [f64; 2]| turn * (forward * p[0] - down * p[1]);
    let (shape, width, count) = match &link.sand {
        Some(strip) => (LegShape::named(&strip.shape)?, strip.width, strip.segments),
        None => (LegShape::TwoPiece { xi: 0.0 }, 0.01, 12),
    };
    let segments = shape.segments(reach.norm(), width, count)?;
    let total: f64 = segments.iter().map(|s| s.area).sum();
    let center: V = segments.iter().map(|s| place(s.center) * (s.area / total)).sum();
    let inertia = segments.iter().fold(M::zeros(), |sum, s| {
        let mass = link.mass * s.area / total;
        let (r, length) = (place(s.center) - center, s.area / width);
        let along = place([-s.normal[1], s.normal[0]]);
        let rod = (M::identity() - along * along.transpose()) * (mass * length * length / 12.0);
        sum + rod + (M::identity() * r.norm_squared() - r * r.transpose()) * mass
    });
    let touching = |segments: &[Segment]| match link.sand {
        Some(_) => {
            let plate = |s: &Segment| Plate {
                center: exact(place(s.center)),
                normal: exact(place(s.normal)),
                area: s.area,
                width,
            };
            segments.iter().map(plate).collect()
        }
        None => Vec::new(),
    };
    Ok(LinkBody {
        joint: exact(joint),
        axis: exact(turn * axis),
        mass: link.mass,
        center: exact(center),
        inertia: exact(inertia),
        armature: link.armature,
        range: link.range,
        plates: touching(&segments),
        chord: touching(&LegShape::TwoPiece { xi: 0.0 }.segments(reach.norm(), width, count)?),
        bulge: shape.bulge(),
        pieces: pieces(&segments, width, place, turn * width_axis),
        reach: exact(turn * reach),
    })
}

/// `v` with rounding errors replaced by exact zeros. cos 90° is 6e-17 in `f64`, and a product of two such numbers
/// is denormal in `f32`. 1e-12 of the norm is far above rounding and far below any length in a drawing.
pub(super) fn exact<const R: usize, const C: usize>(v: nalgebra::SMatrix<f64, R, C>) -> nalgebra::SMatrix<f64, R, C> {
    let least = 1e-12 * v.norm();
    v.map(|x| if x.abs() < least { 0.0 } else { x })
}

/// Straight pieces of a strip: neighbouring segments are one piece while their directions differ by less than
/// [`BEND`]. `place` takes a segment's coordinates to the body's frame, where `across` is the strip's width.
fn pieces(segments: &[Segment], width: f64, place: impl Fn([f64; 2]) -> V, across: V) -> Vec<StripPiece> {
    let mut runs: Vec<&[Segment]> = Vec::new();
    let mut start = 0;
    for end in 1..=segments.len() {
        let [nx, nz] = segments[start].normal;
        if segments.get(end).is_none_or(|s| s.normal[0] * nx + s.normal[1] * nz < BEND.cos()) {
            runs.push(&segments[start..end]);
            start = end;
        }
    }
    let piece = |run: &[Segment]| {
        let (first, last) = (&run[0], &run[run.len() - 1]);
        let [dx, dz] = [0, 1].map(|i| last.center[i] - first.center[i]);
        let ahead = if dx * first.normal[1] - dz * first.normal[0] < 0.0 { -1.0 } else { 1.0 };
        let end = |s: &Segment, side: f64| {
            let half = ahead * side * s.area / width / 2.0;
            place([s.center[0] + half * s.normal[1], s.center[1] - half * s.normal[0]])
        };
        let (from, to) = (end(first, -1.0), end(last, 1.0));
        let length = (to - from).norm();
        StripPiece { center: (from + to) / 2.0, along: (to - from) / length, across, size: [length, width] }
    };
    runs.into_iter().map(piece).collect()
}

/// Sharpest bend inside a piece [rad]: two of a C-leg's twelve segments are one piece, and its chord stays within
/// 0.2 mm of the arc.
const BEND: f64 = 0.35;
