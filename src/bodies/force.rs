//! The sand's force on one body: in one state for each lane, or in one state with eight of the body's patches in lanes.

use super::body::CutBody;
use super::exact::on_plates;
use super::ground::{SandGround, Under};
use crate::number::{Eight, Kernel, Real, Vec3};
use crate::sand::SandBed;
use crate::sim::blocks::LinkFrame;
use crate::sim::tree::eights::{EightPatches, on_eights};
use crate::sim::tree::patches::BodyPatches;
use crate::sim::tree::sand::{Total, on_body, under_body};
use crate::sim::tree::terrain::Surface;

/// Sand that pushes on bodies whose states are of type `R`.
pub(crate) trait BodyForce<R: Real> {
    fn surface(&self) -> &Under<R>;

    /// Force and moment on one body about `place`, and its drag, given as masses for `dt` = 1 s; None if the body is
    /// not in the sand. `travel`: horizontal velocity of the vehicle.
    fn on(&self, body: &CutBody, frame: &LinkFrame<R>, place: &Vec3<R>, travel: [R; 2]) -> Option<Total<R>>;
}

/// One state in each lane.
pub(crate) struct LaneGround<'a, R> {
    sand: &'a SandGround,
    bed: SandBed<R>,
    under: Under<R>,
}

impl<'a, R: Real> LaneGround<'a, R> {
    pub fn of(sand: &'a SandGround) -> Self {
        Self { sand, bed: sand.bed(), under: sand.under_lanes() }
    }
}

impl<R: Real> BodyForce<R> for LaneGround<'_, R> {
    #[inline(always)]
    fn surface(&self) -> &Under<R> {
        &self.under
    }

    #[inline(always)]
    fn on(&self, body: &CutBody, frame: &LinkFrame<R>, place: &Vec3<R>, travel: [R; 2]) -> Option<Total<R>> {
        if body.exact {
            return on_each((self.sand, &self.bed, &self.under), body, frame, place, travel);
        }
        let (patches, _) = body.patches(self.sand.description().law);
        let local = under_body(patches, frame, place, &self.under);
        on_body::<R, true>(&self.bed, patches, frame, &frame.velocity, place, travel, &local, None, R::one())
    }
}

/// Eight patches in lanes.
pub(crate) struct EightGround<'a, R> {
    sand: &'a SandGround,
    bed: SandBed<R>,
    under: Under<f64>,
}

impl<'a, R: Eight> EightGround<'a, R> {
    pub fn of(sand: &'a SandGround) -> Self {
        Self { sand, bed: sand.bed(), under: sand.under_lanes() }
    }
}

impl<R: Eight> BodyForce<f64> for EightGround<'_, R> {
    #[inline(always)]
    fn surface(&self) -> &Under<f64> {
        &self.under
    }

    #[inline(always)]
    fn on(&self, body: &CutBody, frame: &LinkFrame<f64>, place: &Vec3<f64>, travel: [f64; 2]) -> Option<Total<f64>> {
        if body.exact {
            return on_each((self.sand, self.sand.double_bed(), &self.under), body, frame, place, travel);
        }
        let patches = body.patches(self.sand.description().law);
        let mut total = None;
        R::dispatch(EightForce { ground: self, patches, frame, place, travel, total: &mut total });
        total
    }
}

/// A call of [`on_eights`] for one body, compiled for the lanes' instruction set.
struct EightForce<'a, R> {
    ground: &'a EightGround<'a, R>,
    patches: (&'a BodyPatches, &'a [EightPatches]),
    frame: &'a LinkFrame<f64>,
    place: &'a Vec3<f64>,
    travel: [f64; 2],
    total: &'a mut Option<Total<f64>>,
}

impl<R: Eight> Kernel for EightForce<'_, R> {
    #[inline(always)]
    fn run(self) {
        let ground = self.ground;
        *self.total = on_eights(&ground.bed, self.patches, self.frame, self.place, self.travel, &ground.under);
    }
}

/// Evaluates the force law for each plate separately.
#[inline(always)]
fn on_each<R: Real>(
    (sand, bed, under): (&SandGround, &SandBed<R>, &Under<R>),
    body: &CutBody,
    frame: &LinkFrame<R>,
    place: &Vec3<R>,
    travel: [R; 2],
) -> Option<Total<R>> {
    let mut total = None;
    R::dispatch(PlateForces { sand, bed, under, body, frame, place, travel, total: &mut total });
    total
}

/// A call of [`on_each`], the same for all callers.
struct PlateForces<'a, R> {
    sand: &'a SandGround,
    bed: &'a SandBed<R>,
    under: &'a Under<R>,
    body: &'a CutBody,
    frame: &'a LinkFrame<R>,
    place: &'a Vec3<R>,
    travel: [R; 2],
    total: &'a mut Option<Total<R>>,
}

impl<R: Real> Kernel for PlateForces<'_, R> {
    #[inline(always)]
    fn run(self) {
        let Self { sand, bed, under, body, frame, place, travel, total } = self;
        let local = under.under(*place + frame.point(Vec3::splat(body.ball.center)));
        let gate = sand.surface.leading_edge_gate;
        *total = on_plates(bed, &body.pieces, frame, &frame.velocity, place, travel, &local, gate);
    }
}
