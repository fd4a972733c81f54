//! Forces on many bodies in many states. For arrays of `f64` the forces are computed in `f64`, with eight patches of a
//! body in lanes. For arrays of `f32` they are computed in `f32`, with one state in each lane. So each result depends,
//! to the last bit, on its own state only.

use super::body::{Bodies, CutBody};
use super::force::{BodyForce, EightGround, LaneGround};
use super::ground::SandGround;
use super::part::UNIT;
use crate::error::{Error, Result};
use crate::number::{Eight, EightWork, Isa, Kernel, Real, Vec3, Work, flushed};
use crate::sim::blocks::{LinkFrame, turned_by};
use crate::sim::spatial::{Inertia, Twist};
use crate::sim::tree::terrain::Surface;
use std::marker::PhantomData;
use std::thread;

/// For each such number of bodies, counted over all states, one more thread is used: our choice, because the forces on
/// this many bodies take some ten times the 30 µs in which a thread starts.
const FOR_A_THREAD: usize = 1024;

/// The type of the numbers in the caller's arrays.
pub trait Precision: Copy + Send + Sync + Into<f64> {
    /// Number of states that are computed together.
    fn lanes(isa: Isa) -> usize;
    fn of(value: f64) -> Self;
    /// Computes a share of the states in this precision. The function is not generic, so that the hot loops are compiled in this crate alone.
    fn compute(isa: Isa, share: StateShare<'_, Self>) -> Result<()>;
}

impl Precision for f64 {
    fn lanes(_isa: Isa) -> usize {
        1
    }
    fn of(value: f64) -> Self {
        value
    }
    fn compute(isa: Isa, share: StateShare<'_, Self>) -> Result<()> {
        isa.eights(share);
        Ok(())
    }
}

impl Precision for f32 {
    fn lanes(isa: Isa) -> usize {
        isa.lanes()
    }
    fn of(value: f64) -> Self {
        value as f32
    }
    fn compute(isa: Isa, share: StateShare<'_, Self>) -> Result<()> {
        isa.with(share)
    }
}

/// An array [states, bodies, 3 or 4] whose innermost numbers are contiguous.
#[derive(Clone, Copy)]
pub struct Strided<'a, T> {
    pub numbers: &'a [T],
    /// Distance in `numbers` from one state to the next, and from one body to the next.
    pub steps: [usize; 2],
}

/// Poses and velocities of all bodies in all states.
pub struct Motions<'a, T> {
    pub states: usize,
    /// Positions of the bodies' origins [m].
    pub position: Strided<'a, T>,
    /// (w, x, y, z)
    pub quaternion: Strided<'a, T>,
    /// Velocities of the bodies' origins [m/s].
    pub velocity: Strided<'a, T>,
    /// In the world's axes [rad/s].
    pub angular_velocity: Strided<'a, T>,
    /// Velocity of the vehicle in each state [m/s], for the mechanisms of [`SandGround::needs_travel`].
    pub travel: Option<Strided<'a, T>>,
}

impl<'a, T: Precision> Motions<'a, T> {
    /// One body, in as many states as there are quaternions, from contiguous arrays.
    pub fn contiguous(position: &'a [T], quaternion: &'a [T], velocity: &'a [T], angular_velocity: &'a [T]) -> Self {
        let rows = |numbers, width| Strided { numbers, steps: [width, width] };
        Self {
            states: quaternion.len() / 4,
            position: rows(position, 3),
            quaternion: rows(quaternion, 4),
            velocity: rows(velocity, 3),
            angular_velocity: rows(angular_velocity, 3),
            travel: None,
        }
    }

    /// Refuses arrays that are too short, numbers that are not finite, and quaternions that are no rotations.
    fn check(&self, bodies: &Bodies) -> Result<()> {
        let all = [
            ("position", &self.position, 3),
            ("quaternion", &self.quaternion, 4),
            ("velocity", &self.velocity, 3),
            ("angular_velocity", &self.angular_velocity, 3),
        ];
        let states = self.states;
        for (name, array, width) in all {
            array.fits(name, [states, bodies.len(), width])?;
            for state in 0..states {
                for (body, of) in bodies.names().iter().enumerate() {
                    let row = array.row(state, body, width);
                    // A sum is finite only if every number is finite. Numbers so large that only their sum overflows are also wrong.
                    if !row.iter().fold(0.0, |sum: f64, x| sum + (*x).into()).is_finite() {
                        return Err(Error::invalid(name, format!("of {of:?} in state {state} is not finite")));
                    }
                    if width == 4 {
                        let squared: f64 = row.iter().map(|x| (*x).into() * (*x).into()).sum();
                        if (squared - 1.0).abs() > UNIT {
                            let length = squared.sqrt();
                            let reason = format!("of {of:?} in state {state} has length {length:.4}, not 1");
                            return Err(Error::invalid(name, reason));
                        }
                    }
                }
            }
        }
        let Some(travel) = &self.travel else { return Ok(()) };
        travel.fits("travel", [states, 1, 3])?;
        let wrong = (0..states).find(|s| !travel.row(*s, 0, 3).iter().all(|x| (*x).into().is_finite()));
        wrong.map_or(Ok(()), |s| Err(Error::invalid("travel", format!("in state {s} is not finite"))))
    }
}

impl<'a, T: Precision> Strided<'a, T> {
    fn fits(&self, name: &str, [states, bodies, width]: [usize; 3]) -> Result<()> {
        let last = states.saturating_sub(1) * self.steps[0] + bodies.saturating_sub(1) * self.steps[1] + width;
        if states > 0 && self.numbers.len() < last {
            return Err(Error::invalid(name, format!("has {} numbers, fewer than {last}", self.numbers.len())));
        }
        Ok(())
    }

    #[inline(always)]
    fn row(&self, state: usize, body: usize, width: usize) -> &'a [T] {
        let start = state * self.steps[0] + body * self.steps[1];
        &self.numbers[start..start + width]
    }

    /// Vectors of the states from `first` on, one in each lane; lanes beyond the last state repeat it.
    #[inline(always)]
    fn lanes<R: Real>(&self, first: usize, states: usize, body: usize) -> Vec3<R> {
        let mut out = Vec3::zero();
        for lane in 0..R::LANES {
            let row = self.row((first + lane).min(states - 1), body, 3);
            out.set_lane(lane, [row[0].into(), row[1].into(), row[2].into()]);
        }
        out
    }
}

/// A part of the states, to be computed by one thread.
pub struct StateShare<'a, T> {
    bodies: &'a Bodies,
    sand: &'a SandGround,
    motions: &'a Motions<'a, T>,
    first: usize,
    wrench: &'a mut [T],
    drag: Option<&'a mut [T]>,
}

impl<T: Precision> Work for StateShare<'_, T> {
    type Out = ();

    fn run<R: Real>(self) {
        let place = LaneGround::<R>::of(self.sand);
        R::dispatch(WrenchBlocks { share: self, place, number: PhantomData });
    }
}

impl<T: Precision> EightWork for StateShare<'_, T> {
    type Out = ();

    fn run<R: Eight>(self) {
        let place = EightGround::<R>::of(self.sand);
        WrenchBlocks { share: self, place, number: PhantomData }.run();
    }

    fn single(self) {
        Work::run::<f64>(self);
    }
}

struct WrenchBlocks<'a, T, R, P> {
    share: StateShare<'a, T>,
    place: P,
    number: PhantomData<R>,
}

impl<T: Precision, R: Real, P: BodyForce<R>> Kernel for WrenchBlocks<'_, T, R, P> {
    #[inline(always)]
    fn run(self) {
        let Self { mut share, place, .. } = self;
        let count = share.wrench.len() / (6 * share.bodies.len());
        let mut state = 0;
        while state < count {
            for (index, body) in share.bodies.cut().iter().enumerate() {
                share.block(&place, state, index, body);
            }
            state += R::LANES;
        }
    }
}

impl<T: Precision> StateShare<'_, T> {
    /// One body in the states from `state` on, counted from the share's first.
    #[inline(always)]
    fn block<R: Real>(&mut self, place: &impl BodyForce<R>, state: usize, index: usize, body: &CutBody) {
        let (m, from, states) = (self.motions, self.first + state, self.motions.states);
        let at: Vec3<R> = m.position.lanes(from, states, index);
        // The body may be anywhere in a ball about its origin.
        let reach = Vec3::<f64>::splat(body.ball.center).norm_squared().sqrt() + body.ball.reach;
        let near = place.surface().under(at).depth(at) + R::splat(reach);
        // On uneven ground the surface beside the body may be higher than the surface below the body, so only flat ground allows this test.
        if place.surface().is_flat() && !R::any(R::zero().lt(near)) {
            return;
        }
        let mut turn = (R::zero(), Vec3::zero());
        for lane in 0..R::LANES {
            let row = m.quaternion.row((from + lane).min(states - 1), index, 4);
            let q: [f64; 4] = std::array::from_fn(|k| row[k].into());
            // Normalises the quaternion, to first order in the deviation of its length from 1.
            let scale = 1.5 - 0.5 * q.iter().map(|x| x * x).sum::<f64>();
            turn.0.set_lane(lane, q[0] * scale);
            turn.1.set_lane(lane, [q[1] * scale, q[2] * scale, q[3] * scale]);
        }
        let linear = m.velocity.lanes(from, states, index);
        let angular = m.angular_velocity.lanes(from, states, index);
        let frame =
            LinkFrame { rotation: turned_by(turn), velocity: Twist { angular, linear }, ..LinkFrame::at_rest() };
        let travel = m.travel.as_ref().map_or([R::zero(); 2], |travel| {
            let v: Vec3<R> = travel.lanes(from, states, 0);
            [v.x, v.y]
        });
        let Some(total) = place.on(body, &frame, &at, travel) else { return };
        let bodies = self.bodies.len();
        let count = self.wrench.len() / (6 * bodies);
        let inertia = total.inertia();
        for lane in 0..R::LANES.min(count - state) {
            let row = (state + lane) * bodies + index;
            let [f, t] = [total.wrench.force.lane(lane), total.wrench.moment.lane(lane)];
            for k in 0..3 {
                self.wrench[6 * row + k] = T::of(f[k]);
                self.wrench[6 * row + 3 + k] = T::of(t[k]);
            }
            if let Some(drag) = &mut self.drag {
                let matrix = matrix(&inertia, lane);
                for (out, x) in drag[36 * row..36 * row + 36].iter_mut().zip(matrix.iter().flatten()) {
                    *out = T::of(*x);
                }
            }
        }
    }
}

/// One lane of an inertia as a matrix over (linear, angular).
#[inline(always)]
pub(crate) fn matrix<R: Real>(inertia: &Inertia<R>, lane: usize) -> [[f64; 6]; 6] {
    let mut all = [[0.0; 6]; 6];
    for (block, part) in [(0, &inertia.linear), (3, &inertia.rotary)] {
        let (d, [xy, xz, yz]) = (part.diagonal.lane(lane), part.off.lane(lane));
        let rows = [[d[0], xy, xz], [xy, d[1], yz], [xz, yz, d[2]]];
        for (i, row) in rows.iter().enumerate() {
            all[block + i][block..block + 3].copy_from_slice(row);
        }
    }
    for (j, column) in [&inertia.coupling.x, &inertia.coupling.y, &inertia.coupling.z].into_iter().enumerate() {
        for (i, x) in column.lane(lane).into_iter().enumerate() {
            all[3 + i][j] = x;
            all[j][3 + i] = x;
        }
    }
    all
}

impl Bodies {
    /// The sand's force [N] and torque [N·m] about each body's origin, in the world's axes: `wrench` is [states,
    /// bodies, 6]. `drag`, [states, bodies, 6, 6], becomes −∂(wrench)/∂(velocity, angular velocity), see
    /// [`super::exact`]. It is symmetric and positive semidefinite, and along the motion it is the secant from rest.
    /// `threads`: the most to use.
    pub fn wrench<T: Precision>(
        &self,
        sand: &SandGround,
        motions: &Motions<'_, T>,
        threads: usize,
        wrench: &mut [T],
        mut drag: Option<&mut [T]>,
    ) -> Result<()> {
        motions.check(self)?;
        let (states, bodies) = (motions.states, self.len());
        if wrench.len() != 6 * states * bodies || drag.as_ref().is_some_and(|d| d.len() != 36 * states * bodies) {
            return Err(Error::invalid("out", format!("is not of {states} states of {bodies} bodies")));
        }
        if let (Some(id), None) = (sand.needs_travel(), &motions.travel) {
            let reason = format!("is missing: mechanism {id} depends on the velocity of the vehicle");
            return Err(Error::invalid("travel", reason));
        }
        self.check_gate(sand)?;
        wrench.fill(T::of(0.0));
        if let Some(drag) = &mut drag {
            drag.fill(T::of(0.0));
        }
        if states == 0 {
            return Ok(());
        }
        let isa = sand.isa;
        let count = threads.clamp(1, (states * bodies / FOR_A_THREAD).max(1));
        // Whole blocks for each thread.
        let each = states.div_ceil(count).next_multiple_of(T::lanes(isa));
        let mut drags = drag.map(|d| d.chunks_mut(36 * each * bodies));
        let mut shares = wrench.chunks_mut(6 * each * bodies).enumerate().map(|(k, wrench)| StateShare {
            bodies: self,
            sand,
            motions,
            first: k * each,
            wrench,
            drag: drags.as_mut().and_then(Iterator::next),
        });
        let own = shares.next();
        let run = |share: StateShare<'_, T>| flushed(|| T::compute(isa, share));
        thread::scope(|scope| {
            let others: Vec<_> = shares.map(|share| scope.spawn(move || run(share))).collect();
            let mine = own.map_or(Ok(()), run);
            // A panic in the work is passed on to the caller.
            let rest = others.into_iter().map(|h| h.join().unwrap_or_else(|e| std::panic::resume_unwind(e)));
            rest.fold(mine, Result::and)
        })
    }
}
