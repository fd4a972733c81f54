//! Forces of the sand on the belly and the legs.

use super::model::{LaneBelly, LaneBody, LaneModel, LanePlate};
use super::plane::{PlaneField, PlaneForces, PlaneMoments};
use crate::blocks::{LaneState, LinkFrame};
use crate::number::{Kernel, Real, Vec3};
use crate::sand::law::StressLaw;
use crate::sand::memory::MOST_CELLS;
use crate::sand::{LawCoefficients, Plain, SandBed, SegmentState, StressModel};
use crate::spatial::{Inertia, Wrench};
use crate::used::{LaneMemory, LanePiece, Surfaces};

/// Position and horizontal velocity of the robot's base.
#[derive(Clone, Copy)]
pub struct Travel<R> {
    /// [m]; z above the surface that the present body has found.
    pub position: Vec3<R>,
    /// Along x and y [m/s].
    pub velocity: [R; 2],
    /// Strength of the sand that the present body has found; None without memory.
    pub strength: Option<R>,
}

impl<R: Real> Travel<R> {
    /// The same, with height and strength of the sand that body number `body` has found: number 0 is the belly, then come the legs.
    #[inline(always)]
    pub fn above(&self, surfaces: Option<&Surfaces<R>>, body: usize) -> Self {
        let mut found = *self;
        if let Some(surfaces) = surfaces {
            found.position.z = self.position.z - surfaces.levels[body];
            found.strength = Some(surfaces.strengths[body]);
        }
        found
    }
}

/// Adds the sand's force on the underside of the base. The default law without mechanisms is inlined, as in [`link_sand`].
#[inline(always)]
pub fn belly<R: Real, const J: usize>(
    model: &LaneModel<R, J>,
    base: &LinkFrame<R>,
    travel: &Travel<R>,
    inertia: &mut Inertia<R>,
    bias: &mut Wrench<R>,
) {
    let LaneModel { ground, belly, dt, .. } = model;
    if let (LawCoefficients::Li2013(law), None) = (&ground.law, &ground.mechanisms) {
        belly_by(law, &Plain, BellySand { ground, belly, base, travel, inertia, bias, dt: *dt });
        return;
    }
    // Copies, so that in the branch above everything stays in registers.
    let (base, travel, mut own_inertia, mut own_bias) = (*base, *travel, *inertia, *bias);
    let (base, travel, inertia_out, bias_out) = (&base, &travel, &mut own_inertia, &mut own_bias);
    R::dispatch(BellySand { ground, belly, base, travel, inertia: inertia_out, bias: bias_out, dt: *dt });
    (*inertia, *bias) = (own_inertia, own_bias);
}

/// A call of [`belly`].
struct BellySand<'a, R> {
    ground: &'a SandBed<R>,
    belly: &'a LaneBelly<R>,
    base: &'a LinkFrame<R>,
    travel: &'a Travel<R>,
    inertia: &'a mut Inertia<R>,
    bias: &'a mut Wrench<R>,
    dt: R,
}

impl<R: Real> Kernel for BellySand<'_, R> {
    #[inline(always)]
    fn run(self) {
        match &self.ground.mechanisms {
            None => belly_by(&self.ground.law, &Plain, self),
            Some(mechanisms) => belly_by(&self.ground.law, mechanisms, self),
        }
    }
}

/// [`BellySand`] for one law. The plates are one-sided with a leading-edge gate; all face down in one plane of the base.
#[inline(always)]
fn belly_by<R: Real>(law: &impl StressLaw<R>, stress_model: &impl StressModel<R>, sand: BellySand<R>) {
    let BellySand { ground, belly, base, travel, inertia, bias, dt } = sand;
    let (mut forces, mut drag, mut edge) = (PlaneForces::zero(), PlaneMoments::zero(), PlaneMoments::zero());
    let turn = &base.rotation;
    let places = PlaneField { at: turn.z * belly.height, by: [turn.x, turn.y] };
    let [length, width] = belly.corner;
    let mut trusted = R::one();
    for corner in [[length, width], [length, -width], [-length, width], [-length, -width]] {
        trusted = trusted.min(base.trust(places.value(corner)));
    }
    let expected = base.change.scaled(trusted);
    let velocities = places.velocity(&expected.scale_add(R::splat(0.5), &base.velocity));
    let normal = -turn.z;
    let mut wet = false;
    for plate in &belly.plates {
        let Some(depth) = submerged(&places, plate.center, travel.position.z) else { continue };
        wet = true;
        let site = SegmentState {
            width: plate.width,
            ..SegmentState::fresh(depth, travel.position.x + places.value(plate.center).x).travelling(travel.velocity)
        };
        let velocity = velocities.value(plate.center);
        let area = travel.strength.map_or(plate.area, |strength| plate.area * strength);
        let contact = ground.one_sided_by(law, stress_model, &site, area, normal, velocity);
        forces.add(contact.force, plate.center);
        drag.add(contact.drag, plate.center);
        edge.add(contact.edge, plate.center);
    }
    if wet {
        let expected = places.velocity(&expected);
        forces.plus(&drag.forces(&expected));
        forces.plus(&edge.forces(&expected.along(normal)));
        inertia.add(&Inertia::points(&drag.scaled(dt).of(&places)));
        inertia.add_outers(&edge.scaled(dt).of(&places.cross(normal)), normal);
        bias.add(&forces.wrench(&places).scale_add(-R::one(), &Wrench::zero()));
    }
}

/// Moves sand by the belly (body 0) and each leg (bodies 1, 2, …).
#[inline(always)]
pub fn move_sand<R: Real, const J: usize>(model: &LaneModel<R, J>, state: &LaneState<R>, memory: &mut LaneMemory<R>) {
    let cell = memory.cell();
    let mut turn = memory.turn(&state.origins, state.position);
    // Lane 0 gives the number of cells for all lanes. A tenth of a cell needs no cell of its own: our choice.
    let along_side = |side: R| (side.lane(0) / cell - 0.1).ceil().clamp(1.0, MOST_CELLS.into()) as u8;
    let mut pieces = Vec::with_capacity(MANY);
    let base = LinkFrame::base(state);
    let turned = &base.rotation;
    let places = PlaneField { at: turned.z * model.belly.height, by: [turned.x, turned.y] };
    let velocities = places.velocity(&base.velocity);
    for (number, plate) in (0..).zip(&model.belly.plates) {
        // A plate is taken for a square.
        let cells = along_side(plate.area.sqrt());
        let at = plate.center;
        let (place, velocity) = (state.position + places.value(at), velocities.value(at));
        let (area, normal) = (plate.area, -turned.z);
        pieces.push(LanePiece { place, normal, velocity, area, one_sided: true, cells, number });
    }
    turn.by(0, &pieces);
    let quarter = R::splat(0.25);
    for (l, leg) in model.legs.iter().enumerate() {
        pieces.clear();
        let (mut frame, mut number) = (base, 0);
        for (body, joint) in leg.iter().zip(&state.joints[l * J..]) {
            frame = body.frame(&frame, joint);
            let [e0, e1] = &body.plane;
            let places = PlaneField { at: frame.origin, by: [frame.rotation.apply(*e0), frame.rotation.apply(*e1)] };
            let velocities = places.velocity(&frame.velocity);
            let across = places.by[0].cross(places.by[1]);
            // Two plates at a time, in two pieces beside each other: our choice, for pieces about as large as cells.
            for pair in body.plates.chunks(2) {
                let plate = &pair[pair.len() / 2];
                let area = pair.iter().fold(R::zero(), |sum, p| sum + p.area) * R::splat(0.5);
                let beside = across * (plate.width * quarter);
                let cells = along_side(plate.width * R::splat(0.5));
                let (place, velocity) = (state.position + places.value(plate.center), velocities.value(plate.center));
                let normal = places.change(plate.normal);
                for place in [place + beside, place - beside] {
                    pieces.push(LanePiece { place, normal, velocity, area, one_sided: false, cells, number });
                    number += 1;
                }
            }
        }
        turn.by(l + 1, &pieces);
    }
    turn.end();
}

/// Initial room for pieces, about as many as a leg or a belly has.
const MANY: usize = 32;

/// Depth of a place in a plane, if it is below the surface in any lane.
#[inline(always)]
fn submerged<R: Real>(places: &PlaneField<R>, p: [R; 2], height: R) -> Option<R> {
    let [e0, e1] = &places.by;
    let depth = -e0.z.mul_add(p[0], e1.z.mul_add(p[1], places.at.z + height));
    R::any(R::zero().lt(depth)).then(|| depth.max(R::zero()))
}

/// The sand's forces on a link, and its drags as masses. They act on the strip, or in part on the straight chord if sand
/// fills the concave leading side. The default law without mechanisms is inlined: in a function of its own, as the others
/// are, it made a step 5 % slower.
#[inline(always)]
pub fn link_sand<R: Real>(
    ground: &SandBed<R>,
    body: &LaneBody<R>,
    rate: R,
    places: &PlaneField<R>,
    velocities: &PlaneField<R>,
    travel: &Travel<R>,
) -> (PlaneForces<R>, PlaneMoments<R>) {
    let mut total = (PlaneForces::zero(), PlaneMoments::zero());
    if let (LawCoefficients::Li2013(law), None) = (&ground.law, &ground.mechanisms) {
        let share = travel.strength.unwrap_or(R::one());
        strip(law, &Plain, ground, &body.plates, places, velocities, travel, share, &mut total);
        return total;
    }
    // Copies, so that in the branch above everything stays in registers.
    let (places, velocities, travel, mut other) = (*places, *velocities, *travel, total);
    let (places, velocities, travel) = (&places, &velocities, &travel);
    R::dispatch(LinkSand { ground, body, rate, places, velocities, travel, total: &mut other });
    other
}

/// A call of [`link_sand`].
struct LinkSand<'a, R> {
    ground: &'a SandBed<R>,
    body: &'a LaneBody<R>,
    /// Speed of the link's joint [rad/s].
    rate: R,
    places: &'a PlaneField<R>,
    velocities: &'a PlaneField<R>,
    travel: &'a Travel<R>,
    total: &'a mut (PlaneForces<R>, PlaneMoments<R>),
}

impl<R: Real> Kernel for LinkSand<'_, R> {
    #[inline(always)]
    fn run(self) {
        let Self { ground, body, rate, places, velocities, travel, total } = self;
        let Some(mechanisms) = &ground.mechanisms else {
            let share = travel.strength.unwrap_or(R::one());
            strip(&ground.law, &Plain, ground, &body.plates, places, velocities, travel, share, total);
            return;
        };
        let concave_leads = (body.bulge * rate).lt(R::zero());
        let fill = R::select(concave_leads, mechanisms.fill, R::zero());
        for (plates, share) in [(&body.plates, R::one() - fill), (&body.chord, fill)] {
            if !R::any(R::zero().lt(share)) {
                continue;
            }
            let share = travel.strength.map_or(share, |strength| share * strength);
            strip(&ground.law, mechanisms, ground, plates, places, velocities, travel, share, total);
        }
    }
}

/// Adds `share` of the sand's force on two-sided plates: the hottest loop of the program.
#[inline(always)]
#[allow(clippy::too_many_arguments)] // all arguments stay in registers
fn strip<R: Real>(
    law: &impl StressLaw<R>,
    stress_model: &impl StressModel<R>,
    ground: &SandBed<R>,
    plates: &[LanePlate<R>],
    places: &PlaneField<R>,
    velocities: &PlaneField<R>,
    travel: &Travel<R>,
    share: R,
    total: &mut (PlaneForces<R>, PlaneMoments<R>),
) {
    for plate in plates {
        let Some(depth) = submerged(places, plate.center, travel.position.z) else { continue };
        let (normal, velocity) = (places.change(plate.normal), velocities.value(plate.center));
        let site = SegmentState {
            width: plate.width,
            ..SegmentState::fresh(depth, travel.position.x + places.value(plate.center).x).travelling(travel.velocity)
        };
        let contact = ground.thin_plate_by(law, stress_model, &site, plate.area * share, normal, velocity);
        total.0.add(contact.force, plate.center);
        total.1.add(contact.drag, plate.center);
    }
}
