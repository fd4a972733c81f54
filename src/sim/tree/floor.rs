//! Contact with hard ground: Coulomb friction, and a compliance that is linearly implicit.
//!
//! The normal force on a point at depth δ is λ = k (δ − ½ dt v_n⁺) − c v_n⁺, where v_n⁺ is the point's speed along the
//! normal after the step. This scheme is stable for every k, and of the stable schemes it dissipates the least. Along
//! the ground the force −C v_t⁺ holds the point, with C = μ λ/max(|v_t|, v₀). Each step is solved twice. The first
//! solution computes C from λ = k δ and from v_t before the step, the second one from λ and v_t of the first solution.
//! The second solution leaves out points that would pull (λ < 0). Points that the first solution holds with a force of
//! more than μ λ slide with a friction of μ λ.

use super::contact::ContactPoint;
use super::dynamics::LinkLoad;
use super::hard::HardGround;
use super::model::TreeModel;
use super::terrain::Surface;
use crate::blocks::LinkFrame;
use crate::number::{Real, Vec3};
use crate::spatial::{Twist, Wrench};

/// Factor on the distance within which points are examined if the ground is not flat: our choice. It suffices even if
/// the slope changes by twice the angle of repose within the reach.
const BENT: f64 = 2.5;

/// One piece of [`HardGround`] for each lane.
#[derive(Clone, Copy)]
struct LaneSlab<R> {
    center: [R; 2],
    half: [R; 2],
    every: [R; 2],
    inverse_every: [R; 2],
    depth: R,
    grip: R,
}

/// Hard ground under each lane.
#[derive(Clone)]
pub struct Floor<R> {
    pieces: Vec<LaneSlab<R>>,
    /// [N/m]
    stiffness: R,
    /// [N·s/m]
    damping: R,
    /// v₀ [m/s].
    creep: R,
}

/// The points of a body, the same in all lanes.
#[derive(Clone)]
pub struct BodyContacts {
    pub body: usize,
    points: Vec<ContactPoint>,
    /// Centre of a ball that contains all points, in the body's frame [m].
    center: [f64; 3],
    reach: f64,
}

/// A point that touches the ground in some lane.
#[derive(Clone, Copy)]
pub struct Touch<R> {
    pub body: usize,
    /// Position from the base's origin [m].
    pub at: Vec3<R>,
    normal: Vec3<R>,
    velocity: Vec3<R>,
    /// k δ [N]; 0 in lanes in which the point does not touch.
    spring: R,
    friction: R,
    /// C [N·s/m]
    hold: R,
    /// 1 if the point touches and pushes, else 0.
    here: R,
    /// Friction of a sliding point, which does not depend on the solution [N].
    slide: Vec3<R>,
}

impl BodyContacts {
    pub fn all(model: &TreeModel) -> Vec<Self> {
        let of_body = |(body, points): (usize, &Vec<ContactPoint>)| {
            let centers = || points.iter().map(|p| p.center);
            let center = centers().sum::<nalgebra::Vector3<f64>>() / points.len().max(1) as f64;
            let reach = points.iter().map(|p| (p.center - center).norm() + p.radius).fold(0.0, f64::max);
            Self { body, points: points.clone(), center: center.into(), reach }
        };
        model.contacts.iter().enumerate().filter(|(_, p)| !p.is_empty()).map(of_body).collect()
    }
}

impl<R: Real> Floor<R> {
    pub fn new(model: &TreeModel, hard: &[HardGround]) -> Self {
        let zero = R::zero();
        let mut floor =
            Self { pieces: vec![LaneSlab::nowhere(); hard.len()], stiffness: zero, damping: zero, creep: zero };
        (0..R::LANES).for_each(|lane| floor.set_lane(lane, model, hard));
        floor
    }

    /// Gives one lane other ground. If the lane has fewer pieces than other lanes, its unused pieces are put out of reach.
    pub fn set_lane(&mut self, lane: usize, model: &TreeModel, hard: &[HardGround]) {
        self.pieces.resize(self.pieces.len().max(hard.len()), LaneSlab::nowhere());
        for (k, piece) in self.pieces.iter_mut().enumerate() {
            piece.set_lane(lane, hard.get(k).unwrap_or(&NOWHERE));
        }
        self.stiffness.set_lane(lane, model.compliance.stiffness);
        self.damping.set_lane(lane, model.compliance.damping);
        self.creep.set_lane(lane, model.compliance.creep);
    }

    /// Finds the points that touch. `local` gives the surface under a body, `place` is the position of the base's origin.
    #[inline(always)]
    pub fn find(
        &self,
        bodies: &[BodyContacts],
        frames: &[LinkFrame<R>],
        place: &Vec3<R>,
        local: &impl Surface<R>,
        touches: &mut Vec<Touch<R>>,
    ) {
        touches.clear();
        if self.pieces.is_empty() {
            return;
        }
        for contacts in bodies {
            let frame = &frames[contacts.body];
            let center = frame.point(Vec3::splat(contacts.center));
            let under = local.under(*place + center);
            // Hard ground is nowhere higher than the least depth of its pieces. If the surface bends, it may rise more
            // steeply than at this point.
            let reach = if local.is_flat() { 1.0 } else { BENT } * contacts.reach;
            let depth = under.depth(*place + center) + R::splat(reach);
            let near = |p: &LaneSlab<R>| R::any(p.depth.lt(depth));
            if !self.pieces.iter().any(near) {
                continue;
            }
            for point in &contacts.points {
                self.point(point, contacts.body, frame, place, local, touches);
            }
        }
    }

    #[inline(always)]
    fn point(
        &self,
        point: &ContactPoint,
        body: usize,
        frame: &LinkFrame<R>,
        place: &Vec3<R>,
        local: &impl Surface<R>,
        touches: &mut Vec<Touch<R>>,
    ) {
        let center = frame.point(Vec3::splat(point.center.into()));
        let under = local.under(*place + center);
        let radius = R::splat(point.radius);
        let lowest = |normal: Vec3<R>| match point.axis {
            None => normal.scale_add(-radius, center),
            Some(axis) => {
                let axis = frame.rotation.apply(Vec3::splat(axis.into()));
                let along = axis.scale_add(-normal.dot(axis), normal);
                let length = (along.norm_squared() + R::splat(1e-12)).sqrt();
                along.scale_add(-(radius / length), center)
            }
        };
        let at = lowest(under.normal);
        for piece in &self.pieces {
            let world = *place + at;
            let (top, tilt) = piece.top(world);
            let depth = under.depth(world) - top;
            if !R::any(R::zero().lt(depth)) {
                continue;
            }
            let normal = under.tilted(tilt);
            // Along a tilted normal the distance is shorter than the depth. A ball then touches beside its lowest
            // point, which is neglected.
            let depth = depth * normal.dot(under.normal);
            let spring = (depth * self.stiffness).max(R::zero());
            let friction = piece.grip * R::splat(point.friction);
            let velocity = frame.velocity.at(at);
            let along = normal.scale_add(-normal.dot(velocity), velocity);
            let hold = self.hold(friction * spring, along);
            let here = R::select(R::zero().lt(spring), R::one(), R::zero());
            touches.push(Touch { body, at, normal, velocity, spring, friction, hold, here, slide: Vec3::zero() });
        }
    }

    /// C of a point whose friction is at most `most` [N] and whose velocity along the ground is `along`.
    #[inline(always)]
    fn hold(&self, most: R, along: Vec3<R>) -> R {
        most / along.norm_squared().sqrt().max(self.creep)
    }

    /// Adds the forces of all touching points to the bodies' loads.
    #[inline(always)]
    pub fn press(&self, touches: &[Touch<R>], loads: &mut [LinkLoad<R>], dt: R) {
        for touch in touches {
            self.press_one(touch, &mut loads[touch.body], dt);
        }
    }

    #[inline(always)]
    fn press_one(&self, t: &Touch<R>, load: &mut LinkLoad<R>, dt: R) {
        let yielding = self.yielding(dt);
        let normal_speed = t.normal.dot(t.velocity);
        let along = t.normal.scale_add(-normal_speed, t.velocity);
        let normal = t.normal * (t.here * (t.spring - yielding * normal_speed));
        let force = along.scale_add(-t.hold, normal + t.slide);
        let (u, w) = across(t.normal);
        for (axis, mass) in [(t.normal, t.here * yielding), (u, t.hold), (w, t.hold)] {
            load.inertia.add_outer(mass * dt, &Wrench { moment: t.at.cross(axis), force: axis });
        }
        load.bias.add(&Wrench { moment: -t.at.cross(force), force: -force });
    }

    /// Decrease of a point's normal force with the point's speed after the step [N·s/m].
    #[inline(always)]
    fn yielding(&self, dt: R) -> R {
        self.stiffness.mul_add(dt * R::splat(0.5), self.damping)
    }

    /// Decides from the bodies' `accelerations` in the first solution which points are left out, are held, or slide.
    #[inline(always)]
    pub fn classify(&self, touches: &mut [Touch<R>], accelerations: &[Twist<R>], dt: R) {
        let (zero, one) = (R::zero(), R::one());
        for t in touches {
            let after = accelerations[t.body].at(t.at).scale_add(dt, t.velocity);
            let normal_speed = t.normal.dot(after);
            let along = t.normal.scale_add(-normal_speed, after);
            let push = (t.spring - self.yielding(dt) * normal_speed) * t.here;
            t.here = R::select(zero.lt(push), one, zero);
            let most = t.friction * push.max(zero);
            let speed = along.norm_squared().sqrt();
            let slides = most.lt(t.hold * speed);
            let slide = R::select(slides, most / speed.max(self.creep), zero);
            t.slide = along * -slide;
            t.hold = R::select(slides, zero, self.hold(most, along));
        }
    }
}

/// Two directions perpendicular to a normal that points up.
#[inline(always)]
fn across<R: Real>(n: Vec3<R>) -> (Vec3<R>, Vec3<R>) {
    let length = R::one() / (n.x * n.x + n.z * n.z).sqrt();
    let u = Vec3::new(n.z * length, R::zero(), -(n.x * length));
    (u, n.cross(u))
}

/// Out of every robot's reach.
const NOWHERE: HardGround =
    HardGround { center: [0.0; 2], size: [HardGround::ENDLESS; 2], every: [0.0; 2], depth: 1e6, grip: 0.0 };

impl<R: Real> LaneSlab<R> {
    fn nowhere() -> Self {
        let zero = [R::zero(); 2];
        let none = R::zero();
        let mut piece = Self { center: zero, half: zero, every: zero, inverse_every: zero, depth: none, grip: none };
        (0..R::LANES).for_each(|lane| piece.set_lane(lane, &NOWHERE));
        piece
    }

    fn set_lane(&mut self, lane: usize, hard: &HardGround) {
        for k in 0..2 {
            self.center[k].set_lane(lane, hard.center[k]);
            self.half[k].set_lane(lane, hard.size[k] / 2.0);
            self.every[k].set_lane(lane, hard.every[k]);
            self.inverse_every[k].set_lane(lane, if hard.every[k] > 0.0 { 1.0 / hard.every[k] } else { 0.0 });
        }
        self.depth.set_lane(lane, hard.depth);
        self.grip.set_lane(lane, hard.grip);
    }

    /// Depth of the piece's top below a point of the world, and its derivatives along x and y.
    #[inline(always)]
    fn top(&self, p: Vec3<R>) -> (R, [R; 2]) {
        let (edge, zero) = (R::splat(HardGround::EDGE), R::zero());
        let mut top = self.depth;
        let mut tilt = [zero; 2];
        for (k, x) in [p.x, p.y].into_iter().enumerate() {
            let x = x - self.center[k];
            let x = x - (x * self.inverse_every[k]).round() * self.every[k];
            let outside = x.abs() - self.half[k];
            let falls = zero.lt(outside);
            top += R::select(falls, outside * edge, zero);
            tilt[k] = R::select(falls, R::select(x.lt(zero), -edge, edge), zero);
        }
        (top, tilt)
    }
}
