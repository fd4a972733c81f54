//! Columns of sensors that a task does not observe by itself.

use super::{Sensor, SensorInput, Sensors};
use crate::feature::Features;
use crate::sim::pose::{Pose, bearing_force};
use crate::sim::{Model, State};
use std::cell::OnceCell;

/// Bounds of the columns, far beyond a walking robot's values: our choice; gymnasium warns of spaces without bounds.
const SPECIFIC_FORCE: f64 = 1e3; // [m/s²]
const TORQUE: f64 = 1e4; // [N·m]
const FORCE: f64 = 1e6; // [N]
/// Range of the range finder [m]: our choice, as small lidars have.
const RANGE: f64 = 10.0;

/// A control step, for sensors.
pub struct MeasuredStep<'a> {
    input: &'a SensorInput<'a>,
    model: &'a Model,
    /// Equal to `after` at the beginning of an episode.
    before: &'a State,
    after: &'a State,
    imu_position: [f64; 3],
    forces: OnceCell<Vec<f64>>,
    specific_force: OnceCell<[f64; 3]>,
    /// The force above which a foot bears load [N].
    bearing: OnceCell<f64>,
}

/// Computes one number.
pub type Measure = fn(&MeasuredStep, usize) -> f64;

impl<'a> MeasuredStep<'a> {
    pub fn new(input: &'a SensorInput<'a>, imu_position: [f64; 3]) -> Self {
        let [before, after] = input.states;
        Self {
            input,
            model: input.model,
            before,
            after,
            imu_position,
            forces: OnceCell::new(),
            specific_force: OnceCell::new(),
            bearing: OnceCell::new(),
        }
    }

    /// Force of the ground on each foot along the surface's normal [N]: in the last time step, or, if the engine does not keep it, at the
    /// end of the control step.
    fn forces(&self) -> &[f64] {
        if !self.input.normal_forces.is_empty() {
            return self.input.normal_forces;
        }
        self.forces.get_or_init(|| {
            let whole = self.input.sand.map(|sand| State { sand: Some(Box::new(sand.clone())), ..self.after.clone() });
            let pose = Pose::of(self.model, whole.as_ref().unwrap_or(self.after), self.input.footing);
            match &self.model.tree {
                None => pose.leg_forces.iter().map(|force| force.z).collect(),
                Some(tree) => tree.stance.feet.iter().map(|foot| pose.force_on(self.model, *foot).z).collect(),
            }
        })
    }

    /// Distance from the base to the ground along the base's downward axis [m].
    fn range(&self) -> f64 {
        let [x, y, z] = self.after.position;
        let down = self.after.rotation()[2][2];
        let height = z - self.model.surface_height(x, y);
        if down > height / RANGE { height / down } else { RANGE }
    }

    /// Acceleration of the accelerometer, from the change of its velocity in the control step, less the acceleration of
    /// gravity [m/s²]; body frame.
    fn specific_force(&self) -> [f64; 3] {
        let velocity = |state: &State| {
            let (turn, spin) = (state.rotation(), state.angular_velocity);
            let arm = turn.map(|row| (0..3).map(|k| row[k] * self.imu_position[k]).sum::<f64>());
            let turned = |i: usize, k: usize| spin[i] * arm[k] - spin[k] * arm[i];
            let around = [turned(1, 2), turned(2, 0), turned(0, 1)];
            [0, 1, 2].map(|i| state.velocity[i] + around[i])
        };
        let (old, new, gravity) = (velocity(self.before), velocity(self.after), self.model.gravity);
        self.after.to_body([0, 1, 2].map(|i| (new[i] - old[i]) / self.input.period - gravity[i]))
    }
}

/// Names of the feet, in the order of [`MeasuredStep::forces`].
fn feet(model: &Model) -> Vec<String> {
    match &model.tree {
        Some(tree) => tree.stance.feet.iter().map(|body| tree.tree.bodies[*body].name.clone()).collect(),
        None => model.robot.hip.iter().map(|hip| hip.name.clone()).collect(),
    }
}

/// The columns of `sensor`; None: this sensor cannot be added, but a task may observe it by itself.
pub fn columns(sensor: Sensor, model: &Model) -> Option<Features<Measure>> {
    let (none, feet) = (Features::<Measure>::none(), feet(model));
    let columns = match sensor {
        Sensor::Accelerometer => none.xyz("specific force, body frame,", "m/s²", SPECIFIC_FORCE, |m, i| {
            m.specific_force.get_or_init(|| m.specific_force())[i]
        }),
        Sensor::JointTorque => {
            none.each(&model.joint_names(), "joint torque", "N·m", TORQUE, |m, i| m.after.torques[i])
        }
        Sensor::ContactForce => none.each(&feet, "contact force", "N", FORCE, |m, i| m.forces()[i]),
        Sensor::ContactSwitch => none.each(&feet, "contact switch", "1", 1.0, |m, i| {
            f64::from(u8::from(m.forces()[i] > *m.bearing.get_or_init(|| bearing_force(m.model))))
        }),
        Sensor::RangeFinder => none.each(&["base".into()], "range finder", "m", RANGE, |m, _| m.range()),
        _ => return None,
    };
    Some(columns.sensed(sensor))
}

/// The columns that `sensors` add to an observation that already has the columns of the sensors `own`.
pub fn added(sensors: &Sensors, own: &[Sensor], model: &Model) -> Features<Measure> {
    let named = Sensor::ALL.into_iter().filter(|s| sensors.of(*s).is_some() && !own.contains(s));
    named.filter_map(|sensor| columns(sensor, model)).fold(Features::<Measure>::none(), Features::and)
}
