//! Sand with memory, for engines that compute environments in lanes. See [`crate::sand::memory`] for the equations.
//!
//! Heights differ from lane to lane, so sand is moved lane by lane, in `f64`, every [`PERIOD`]. In between, each body of
//! a robot has one level from which depths count, and one strength: two numbers in lanes, so the force law stays as fast
//! as on level sand.

use crate::number::{Real, Vec3};
use crate::sand::memory::{BodyMotion, GridFrame, GridPiece, Marks, MemorySettings, Moved, swept};
use crate::{Model, State};

/// Time between two movements of sand [s]: our choice, a control step of the tasks. A foot that pushes with 0.5 m/s moves by
/// 1 cm, 1.3 cells of the hexapods. Half and twice this time change the speeds of hexapods whose convex side leads by at most 2 % (`walks_converge`).
const PERIOD: f64 = 2e-2;
/// A body that is higher than this above the highest sand finds nothing yet [cells]: our choice, 6 cm for the hexapods. A leg that falls
/// with 2 m/s moves by 4 cm in [`PERIOD`].
const ABOVE: f64 = 8.0;

/// A piece of a body's surface in all lanes.
#[derive(Clone, Copy)]
pub struct LanePiece<R> {
    pub body: usize,
    /// Relative to the lane's origin of x and y [m].
    pub place: Vec3<R>,
    pub normal: Vec3<R>,
    pub velocity: Vec3<R>,
    /// [m²]
    pub area: R,
    /// Does only the side of the normal touch sand?
    pub one_sided: bool,
    /// See [`GridPiece::cells`].
    pub cells: u8,
}

/// What each body has found, in lanes.
pub struct Surfaces<R> {
    /// [m]
    pub levels: Vec<R>,
    pub strengths: Vec<R>,
    /// Bodies above this height find nothing yet [m].
    pub tops: R,
}

/// The sand around the robots of a block.
pub struct LaneMemory<R> {
    pub surfaces: Surfaces<R>,
    settings: Vec<MemorySettings>,
    moved: Vec<Moved>,
    /// [time steps]
    every: u32,
    dt: f64,
    pub pieces: Vec<LanePiece<R>>,
    groups: Vec<BodyPieces<R>>,
    /// Of each lane: the pieces that may move sand, body by body.
    listed: Vec<Vec<GridPiece>>,
    marks: Marks,
}

/// The pieces of a body, and their lowest height.
struct BodyPieces<R> {
    body: usize,
    from: usize,
    to: usize,
    low: R,
    /// Where this body's pieces end in the list of each lane.
    ends: [usize; MOST_LANES],
}

impl<R: Real> LaneMemory<R> {
    /// For robots with `bodies` bodies that touch sand; None if the model's sand has no memory.
    pub fn new(model: &Model, bodies: usize) -> Option<Self> {
        let settings = model.scene.memory?;
        let surfaces = Surfaces { levels: vec![R::zero(); bodies], strengths: vec![R::one(); bodies], tops: R::zero() };
        Some(Self {
            surfaces,
            settings: vec![settings; R::LANES],
            moved: vec![Moved::new(&settings, bodies); R::LANES],
            every: (PERIOD / model.scene.dt).round().max(1.0) as u32,
            dt: model.scene.dt,
            pieces: Vec::new(),
            groups: Vec::new(),
            listed: vec![Vec::new(); R::LANES],
            marks: Marks::default(),
        })
    }

    pub fn set_model(&mut self, lane: usize, model: &Model) {
        if let Some(settings) = model.scene.memory {
            self.settings[lane] = settings;
            self.show(lane);
        }
    }

    /// Takes the sand of `state`; level sand if `state` has none that fits.
    pub fn set_state(&mut self, lane: usize, state: &State) {
        let bodies = self.surfaces.levels.len();
        self.moved[lane] = match &state.sand {
            Some(sand) if sand.fits(&self.settings[lane], bodies) => (**sand).clone(),
            _ => Moved::new(&self.settings[lane], bodies),
        };
        self.show(lane);
    }

    /// Side of a cell [m], the same in all lanes.
    pub fn cell(&self) -> f64 {
        self.settings[0].cell
    }

    pub fn sand(&self, lane: usize) -> &Moved {
        &self.moved[lane]
    }

    /// Puts what a lane's bodies have found into the lanes.
    #[inline(always)]
    fn show(&mut self, lane: usize) {
        let top = self.moved[lane].grid.highest() + ABOVE * self.settings[lane].cell;
        self.surfaces.tops.set_lane(lane, top);
        for (body, found) in self.moved[lane].found.iter().enumerate() {
            self.surfaces.levels[body].set_lane(lane, found.level.into());
            self.surfaces.strengths[body].set_lane(lane, self.settings[lane].strength(found));
        }
    }

    /// Counts a time step. Returns whether it is time to move sand in any lane.
    #[inline(always)]
    pub fn tick(&mut self) -> bool {
        let mut due = false;
        for moved in &mut self.moved {
            moved.pending += 1;
            due |= moved.pending >= self.every;
        }
        due
    }

    /// Moves the sand in the lanes where it is time, with `self.pieces`, which are sorted by body. `origins`: origins of x and y
    /// in each lane [m]; `middle`: the robot's position relative to them.
    #[inline(always)]
    pub fn update(&mut self, origins: &[[f64; 2]], middle: Vec3<R>) {
        let Self { surfaces, settings, moved, pieces, groups, listed, marks, every, dt } = self;
        groups.clear();
        for (k, p) in pieces.iter().enumerate() {
            match groups.last_mut() {
                Some(group) if group.body == p.body => (group.to, group.low) = (k + 1, group.low.min(p.place.z)),
                _ => {
                    groups.push(BodyPieces { body: p.body, from: k, to: k + 1, low: p.place.z, ends: [0; MOST_LANES] })
                }
            }
        }
        // The cell of each lane's origin, and the origin's place in it [cells].
        let frame = moved[0].grid.frame;
        let mut corner = LaneCorner { cells: [[0; 2]; MOST_LANES], within: [R::zero(); 2] };
        let mut due = 0;
        for lane in 0..R::LANES {
            let place = origins[lane].map(|x| x / frame.cell);
            corner.cells[lane] = place.map(|x| x.floor() as i32);
            corner.within.iter_mut().zip(place).for_each(|(within, x)| within.set_lane(lane, x - x.floor()));
            due |= u32::from(moved[lane].pending >= *every) << lane;
            listed[lane].clear();
        }
        // Pieces above the highest sand move no sand. A body's lowest piece is listed in any case.
        let high = surfaces.tops - R::splat(ABOVE * frame.cell);
        for group in groups.iter_mut() {
            let high = high.max(group.low);
            for p in &pieces[group.from..group.to] {
                let lanes = due & !R::bits(high.lt(p.place.z));
                if lanes != 0 {
                    p.list(&frame, &corner, lanes, listed);
                }
            }
            group.ends.iter_mut().zip(listed.iter()).for_each(|(end, list)| *end = list.len());
        }
        for (lane, (settings, moved)) in settings.iter().zip(moved.iter_mut()).enumerate() {
            if moved.pending < *every {
                continue;
            }
            let (origin, time) = (origins[lane], f64::from(moved.pending) * *dt);
            moved.pending = 0;
            let [x, y, _] = middle.lane(lane);
            moved.grid.follow([origin[0] + x, origin[1] + y]);
            let mut from = 0;
            let high = moved.grid.highest() + settings.cell;
            // Bodies without pieces are far above the sand.
            let mut next = 0;
            for group in groups.iter() {
                moved.found[next..group.body].iter_mut().for_each(|found| found.inside = false);
                next = group.body + 1;
            }
            moved.found[next..].iter_mut().for_each(|found| found.inside = false);
            for BodyPieces { body, low, ends, .. } in groups.iter() {
                let (low, own) = (low.lane(lane), &listed[lane][from..ends[lane]]);
                from = ends[lane];
                // The body is well above the sand: what it finds does not matter yet.
                if low > high + (ABOVE - 1.0) * settings.cell {
                    moved.found[*body].inside = false;
                    continue;
                }
                let motion = BodyMotion { origin: corner.cells[lane], low, way: None, time };
                moved.meet::<R::Shorts>(settings, *body, own, &motion, marks);
            }
            // Sweeps of sliding that are due now.
            moved.sliding += (time / settings.sweep) as f32;
            let sweeps = moved.sliding.floor();
            moved.sliding -= sweeps;
            for _ in 0..(sweeps as usize).min(MOST_SWEEPS) {
                moved.grid.slide::<R::Shorts>(settings.repose);
            }
        }
        (0..R::LANES).for_each(|lane| self.show(lane));
    }
}

/// Most sweeps after one movement: our choice, a bound on the time of a step for very fine grids.
const MOST_SWEEPS: usize = 16;

/// Pieces of several cells that are steeper than this are level [rad]: our choice, 60°.
const STEEPEST: f64 = std::f64::consts::FRAC_PI_3;
/// Most lanes of a number type: see [`crate::number::Isa::lanes`].
const MOST_LANES: usize = 16;

/// The cell of each lane's origin, and the origin's place in it [cells].
struct LaneCorner<R> {
    cells: [[i32; 2]; MOST_LANES],
    within: [R; 2],
}

impl<R: Real> LanePiece<R> {
    /// Adds the piece, in the units of the grids, to the lists of these lanes (bit by bit).
    #[inline(always)]
    fn list(&self, frame: &GridFrame, corner: &LaneCorner<R>, lanes: u32, listed: &mut [Vec<GridPiece>]) {
        let Self { place, velocity, area, cells, .. } = *self;
        let inwards = if self.one_sided { R::one() } else { self.normal.dot(velocity) };
        let side = R::select(inwards.lt(R::zero()), -R::one(), R::one());
        let normal = self.normal * side;
        let per_cell = R::splat(1.0 / frame.cell);
        let [x, y] = [place.x.mul_add(per_cell, corner.within[0]), place.y.mul_add(per_cell, corner.within[1])];
        // The next integer below is the nearest one to half a cell less.
        let below = |less: f64| [x, y].map(|x| (x - R::splat(0.5 + less)).round());
        let (middle, first) = (below(0.0), below(0.5 * f64::from(cells - 1)));
        let height = place.z * R::splat(1.0 / frame.quantum());
        let rate = swept(normal, velocity, area, cells, frame);
        // If a piece covers several cells, the piece's plane gives the height in each of them, unless it is too steep.
        let level = R::splat(STEEPEST.cos()).lt(normal.z.abs());
        let cell_in_steps = R::splat(if cells > 1 { frame.cell / frame.quantum() } else { 0.0 });
        let along_z = R::select(level, normal.z, R::one());
        let falls = [normal.x, normal.y].map(|n| R::select(level, n / along_z * cell_in_steps, R::zero()));
        for (lane, list) in listed.iter_mut().enumerate().take(R::LANES) {
            if lanes >> lane & 1 == 0 {
                continue;
            }
            let [origin_x, origin_y] = corner.cells[lane];
            let cell = |c: &[R; 2]| {
                [origin_x.wrapping_add(integer(c[0].lane(lane))), origin_y.wrapping_add(integer(c[1].lane(lane)))]
            };
            let single = |x: &R| x.lane(lane) as f32;
            list.push(GridPiece {
                cell: cell(&middle),
                first: cell(&first),
                cells,
                falls: [single(&falls[0]), single(&falls[1])],
                place: [single(&x), single(&y)],
                height: single(&height),
                normal: [single(&normal.x), single(&normal.y), single(&normal.z)],
                area: single(&area),
                velocity: [single(&velocity.x), single(&velocity.y)],
                rate: single(&rate),
            });
        }
    }
}

/// An integer between −2³¹ and 2³¹. It is in the lowest bits of its sum with 1.5 · 2⁵², which is faster than a conversion that
/// saturates.
#[inline(always)]
fn integer(x: f64) -> i32 {
    (x + 6_755_399_441_055_744.0).to_bits() as i32
}
