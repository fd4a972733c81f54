//! Poses of a robot's parts at one moment, and the sand's forces on them.

use super::frame::{BodyFrame, M, V};
use super::model::{LinkBody, Plate};
use super::tree::{forces, kinematics};
use super::{Model, State};
use crate::number::Vec3;
use crate::sand::{Contact, SandBed, SegmentState};

/// A leg or foot bears load if the ground's force on it is above this share of the robot's weight: then a leg stands, a
/// foot is in contact and its switch closes, and a picture has an arrow for the force. Our choice: a leg in the air has
/// no force, and each of two to six legs that stand has half to a sixth of the weight. The sand's force on a foot that
/// is dragged through it can also be above this share.
const BEARING: f64 = 0.02;

/// The force above which a leg or foot of this robot bears load [N].
pub fn bearing_force(model: &Model) -> f64 {
    BEARING * model.total_mass() * model.gravity.norm()
}

/// The ground's force on each foot of a robot from a file along the surface's normal [N]; for other robots empty.
pub fn foot_loads(model: &Model, state: &State) -> Vec<f64> {
    let Some(tree) = &model.tree else { return Vec::new() };
    let pushes = forces::pushes(model, state);
    let on = |foot: &usize| pushes.iter().filter(|push| push.body == *foot).map(|push| push.force.z).sum::<f64>();
    tree.stance.feet.iter().map(on).collect()
}

/// A small flat piece that sand may push on, as a [`Model`] has it.
#[derive(Clone, Copy, Debug)]
pub struct SandSegment<'a> {
    /// Index of the body that carries it, as in [`Pose::bodies`].
    pub body: usize,
    /// Index of that body's leg; None: the base.
    pub leg: Option<usize>,
    pub plate: &'a Plate,
}

/// The sand's force on a segment, and where it acts.
#[derive(Clone, Copy, Debug)]
pub struct SegmentForce {
    /// Position of the segment's centre in the world [m].
    pub position: V,
    /// Force of the sand on the segment, in the world's axes [N]; zero outside the sand.
    pub force: V,
}

/// Positions of a robot's bodies and the forces of the sand on them, at one time.
pub struct Pose {
    /// The base, then every link, leg by leg from the hip outward; origins in the world [m].
    pub bodies: Vec<(M, V)>,
    /// The force of the sand on each segment, in the order of [`segments`].
    pub loads: Vec<SegmentForce>,
    /// Sum of the forces on each leg [N].
    pub leg_forces: Vec<V>,
    /// Does the sand hold the leg? One value for each leg.
    pub stance: Vec<bool>,
    /// The ground's force on each body of [`forces::touching`], and the mean place of this force; only for robots from files.
    pub contacts: Vec<SegmentForce>,
    /// A leg with a smaller force does not stand [N].
    least: f64,
    /// Velocity of the base along x and y [m/s].
    travel: [f64; 2],
}

/// All segments of a robot: the belly's, then each link's. If the sand's mechanisms fill concave sides, a link's
/// strip is followed by the segments of its chord.
pub fn segments(model: &Model) -> Vec<SandSegment<'_>> {
    let belly = model.belly.iter().map(|plate| SandSegment { body: 0, leg: None, plate });
    let fills = model.scene.mechanisms.concave_fill > 0.0;
    let links = model.legs.iter().enumerate().flat_map(|(leg, chain)| chain.iter().map(move |body| (leg, body)));
    let strips = links.enumerate().flat_map(move |(i, (leg, body))| {
        let chord: &[Plate] = if fills { &body.chord } else { &[] };
        body.plates.iter().chain(chord).map(move |plate| SandSegment { body: i + 1, leg: Some(leg), plate })
    });
    belly.chain(strips).collect()
}

impl Pose {
    /// The forces are those of the sand at this moment's velocities, computed in `f64` by the engines' functions.
    /// `footing` is each leg's share of the stress, see [`super::integrator::Integrator::set_footing`]; a leg without
    /// an entry has 1.
    pub fn of(model: &Model, state: &State, footing: &[f64]) -> Self {
        let ground: SandBed<f64> = model.scene.ground();
        let base = BodyFrame::base(state);
        let at = V::from(state.position);
        let mut pose = Self {
            bodies: vec![(base.rotation, at)],
            loads: Vec::new(),
            leg_forces: Vec::new(),
            stance: Vec::new(),
            contacts: contacts(model, state),
            least: bearing_force(model),
            travel: state.travel(),
        };
        let [level, strength] = found(model, state, 0);
        pose.press(&model.belly, &base, at, level, |site, area, n, v| ground.one_sided(site, area * strength, n, v));
        let mut joint = 0;
        for (leg, chain) in model.legs.iter().enumerate() {
            let [level, strength] = found(model, state, leg + 1);
            let found = footing.get(leg).copied().unwrap_or(1.0) * strength;
            let first = pose.loads.len();
            let mut frame = base;
            for body in chain {
                let rate = state.rates[joint];
                frame = frame.child(body, state.angles[joint], rate);
                pose.bodies.push((frame.rotation, at + frame.origin));
                pose.press_link(model, &ground, body, [rate, found, level], &frame, at);
                joint += 1;
            }
            pose.leg_forces.push(pose.loads[first..].iter().map(|l| l.force).sum());
        }
        pose.stance = pose.leg_forces.iter().map(|f| f.norm() > pose.least).collect();
        pose
    }

    /// Adds the sand's forces on a link. They act on its strip, and in part on its straight chord if sand fills the
    /// concave leading side. `found` is the factor on the stress for this leg, `level` the height of the sand's surface
    /// at the leg [m].
    fn press_link(
        &mut self,
        model: &Model,
        ground: &SandBed<f64>,
        body: &LinkBody,
        [rate, found, level]: [f64; 3],
        frame: &BodyFrame,
        at: V,
    ) {
        let concave_leads = body.bulge * rate < 0.0;
        let fill = ground.mechanisms.as_ref().filter(|_| concave_leads).map_or(0.0, |mechanisms| mechanisms.fill);
        let plate = |share: f64| {
            move |site: &SegmentState<f64>, area: f64, n, v| ground.thin_plate(site, area * share * found, n, v)
        };
        self.press(&body.plates, frame, at, level, plate(1.0 - fill));
        if model.scene.mechanisms.concave_fill > 0.0 {
            self.press(&body.chord, frame, at, level, plate(fill));
        }
    }

    /// Adds the sand's force on each plate. `contact` computes it from the segment's state, area [m²], normal and
    /// velocity [m/s].
    fn press(
        &mut self,
        plates: &[Plate],
        frame: &BodyFrame,
        at: V,
        level: f64,
        contact: impl Fn(&SegmentState<f64>, f64, Vec3<f64>, Vec3<f64>) -> Contact<f64>,
    ) {
        let vector = |v: V| Vec3::new(v.x, v.y, v.z);
        self.loads.extend(plates.iter().map(|plate| {
            let arm = frame.rotation * plate.center;
            let position = at + frame.origin + arm;
            let mut force = V::zeros();
            if position.z < level {
                let site = SegmentState::fresh(level - position.z, position.x).travelling(self.travel);
                let (normal, velocity) = (frame.rotation * plate.normal, frame.velocity_at(arm));
                let pushed = contact(&site, plate.area, vector(normal), vector(velocity)).force;
                force = V::new(pushed.x, pushed.y, pushed.z);
            }
            SegmentForce { position, force }
        }));
    }

    /// The ground's force on a body of a robot from a file [N].
    pub fn force_on(&self, model: &Model, body: usize) -> V {
        let touching = forces::touching(model);
        touching.iter().position(|b| *b == body).map_or(V::zeros(), |k| self.contacts[k].force)
    }

    /// Forces of the ground to draw: one for each leg that stands or, in a robot from a file, for each body that
    /// touches the ground. The position of a leg's force is the mean of its segments' positions, weighted by their
    /// forces.
    pub fn arrows(&self, model: &Model) -> Vec<SegmentForce> {
        let segments = segments(model);
        let of_leg = |leg: usize| {
            let own = segments.iter().zip(&self.loads).filter(|(s, _)| s.leg == Some(leg)).map(|(_, load)| *load);
            Some(SegmentForce { position: mean_place(own)?, force: self.leg_forces[leg] })
        };
        let legs = (0..self.stance.len()).filter(|leg| self.stance[*leg]).filter_map(of_leg);
        legs.chain(self.contacts.iter().filter(|c| c.force.norm() > self.least).copied()).collect()
    }
}

/// Level of the sand at a body [m], and the factor on the sand's strength there, in sand with memory. Body 0 is the belly.
fn found(model: &Model, state: &State, body: usize) -> [f64; 2] {
    match (&state.sand, &model.scene.memory) {
        (Some(sand), Some(settings)) => {
            sand.found.get(body).map_or([0.0, 1.0], |found| [f64::from(found.level), settings.strength(found)])
        }
        _ => [0.0, 1.0],
    }
}

/// Mean position, weighted by force; None if there is no force.
fn mean_place(loads: impl Iterator<Item = SegmentForce>) -> Option<V> {
    let (sum, total) = loads.fold((V::zeros(), 0.0), |(sum, total), load| {
        let weight = load.force.norm();
        (sum + load.position * weight, total + weight)
    });
    (total > 0.0).then(|| sum / total)
}

/// The ground's force on each body that can touch it. If there is no force, its position is the body's origin.
fn contacts(model: &Model, state: &State) -> Vec<SegmentForce> {
    let Some(robot) = &model.tree else { return Vec::new() };
    let (frames, pushes) = (kinematics::frames(&robot.tree, state), forces::pushes(model, state));
    let of_body = |body: usize| {
        let own = pushes.iter().filter(|p| p.body == body).map(|p| SegmentForce { position: p.at, force: p.force });
        let position = mean_place(own.clone()).unwrap_or(frames[body].translation.vector);
        SegmentForce { position, force: own.map(|load| load.force).sum() }
    };
    forces::touching(model).into_iter().map(of_body).collect()
}
