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
    /// See [`GridPiece::number`].
    pub number: u16,
}

/// Level and strength of the sand at each body, in lanes.
pub struct Surfaces<R> {
    /// [m]
    pub levels: Vec<R>,
    pub strengths: Vec<R>,
    /// Bodies above this height find nothing yet [m].
    pub tops: R,
    /// Pieces above this height move no sand [m]. A body's lowest piece is listed all the same.
    pub high: R,
}

/// The sand around the robots of a block.
pub struct LaneMemory<R> {
    pub surfaces: Surfaces<R>,
    settings: Vec<MemorySettings>,
    moved: Vec<Moved>,
    /// [time steps]
    every: u32,
    dt: f64,
    /// For each lane, the pieces of a body that may move sand.
    listed: Vec<Vec<GridPiece>>,
    marks: Marks,
}

impl<R: Real> LaneMemory<R> {
    /// For robots with `bodies` bodies that touch sand; None if the model's sand has no memory.
    pub fn new(model: &Model, bodies: usize) -> Option<Self> {
        let settings = model.scene.memory?;
        let surfaces = Surfaces {
            levels: vec![R::zero(); bodies],
            strengths: vec![R::one(); bodies],
            tops: R::zero(),
            high: R::zero(),
        };
        Some(Self {
            surfaces,
            settings: vec![settings; R::LANES],
            moved: vec![Moved::new(&settings, bodies); R::LANES],
            every: (PERIOD / model.scene.dt).round().max(1.0) as u32,
            dt: model.scene.dt,
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

    /// Takes over the sand of `state`; takes level sand if `state` has no sand of the right size.
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
        let high = self.moved[lane].grid.highest();
        self.surfaces.high.set_lane(lane, high);
        self.surfaces.tops.set_lane(lane, high + ABOVE * self.settings[lane].cell);
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

    /// Begins to move the sand of the lanes where it is time. `origins`: of x and y in each lane [m]; `middle`: the robot's
    /// position from there.
    #[inline(always)]
    pub fn turn(&mut self, origins: &[[f64; 2]], middle: Vec3<R>) -> Turn<'_, R> {
        let frame = self.moved[0].grid.frame;
        let mut corner = LaneCorner { cells: [[0; 2]; MOST_LANES], within: [R::zero(); 2] };
        let mut due = 0;
        for (lane, origin) in origins.iter().enumerate().take(R::LANES) {
            let place = origin.map(|x| x / frame.cell);
            corner.cells[lane] = place.map(|x| x.floor() as i32);
            corner.within.iter_mut().zip(place).for_each(|(within, x)| within.set_lane(lane, x - x.floor()));
            if self.moved[lane].pending >= self.every {
                due |= 1 << lane;
                let [x, y, _] = middle.lane(lane);
                self.moved[lane].grid.follow([origin[0] + x, origin[1] + y]);
            }
        }
        let (low, high) = (R::zero(), R::zero());
        Turn { memory: self, frame, corner, due, body: 0, low, high, lanes: 0, enters: 0, next: 0 }
    }
}

/// One movement of sand, body by body.
pub struct Turn<'a, R> {
    memory: &'a mut LaneMemory<R>,
    frame: GridFrame,
    corner: LaneCorner<R>,
    /// Lanes where sand is moved now (one bit a lane, as in all sets of lanes).
    due: u32,
    /// The body that moves sand now, and the height of its lowest piece [m].
    body: usize,
    low: R,
    /// Pieces above this height move no sand, except for the lowest [m].
    high: R,
    /// Lanes where this body is near the sand, and where it is at the surface and so looks at all its pieces.
    lanes: u32,
    enters: u32,
    /// The body after it.
    next: usize,
}

impl<R: Real> Turn<'_, R> {
    /// Begins with the pieces of a body, whose lowest has this height [m]. Calls come in the order of the bodies; a body without a call
    /// is far above the sand.
    #[inline(always)]
    pub fn begin(&mut self, body: usize, low: R) {
        self.skip_to(body);
        (self.body, self.low, self.next) = (body, low, body + 1);
        let surfaces = &self.memory.surfaces;
        self.high = surfaces.high.max(low);
        // Well above the sand: what it finds does not matter yet.
        let near = surfaces.high + R::splat(ABOVE * self.frame.cell);
        self.lanes = self.due & !R::bits(near.lt(low));
        self.enters = !R::bits(low.lt(surfaces.levels[body]));
        for (lane, moved) in self.memory.moved.iter_mut().enumerate() {
            self.enters |= u32::from(!moved.found[body].inside) << lane;
            if (self.due & !self.lanes) >> lane & 1 == 1 {
                moved.found[body].inside = false;
            }
        }
    }

    /// Can a piece of this height move sand in any lane?
    #[inline(always)]
    pub fn reaches(&self, height: R) -> bool {
        self.lanes & !R::bits(self.high.lt(height)) != 0
    }

    /// Adds a piece of the body.
    #[inline(always)]
    pub fn list(&mut self, piece: &LanePiece<R>) {
        let lanes = self.lanes & !R::bits(self.high.lt(piece.place.z));
        piece.list(&self.frame, &self.corner, [lanes, lanes & self.enters], &mut self.memory.listed);
    }

    /// Moves sand by the pieces of the body.
    #[inline(always)]
    pub fn move_sand(&mut self) {
        let Self { body, low, lanes, .. } = *self;
        let LaneMemory { settings, moved, listed, marks, dt, .. } = &mut *self.memory;
        for lane in 0..R::LANES {
            if lanes >> lane & 1 == 0 {
                continue;
            }
            let time = f64::from(moved[lane].pending) * *dt;
            let motion = BodyMotion { origin: self.corner.cells[lane], low: low.lane(lane), way: None, time };
            moved[lane].meet::<R::Shorts>(&settings[lane], body, &listed[lane], &motion, marks);
            listed[lane].clear();
        }
    }

    /// Moves sand by all pieces of a body.
    #[inline(always)]
    pub fn by(&mut self, body: usize, pieces: &[LanePiece<R>]) {
        let mut low = R::splat(f64::INFINITY);
        for piece in pieces {
            low = low.min(piece.place.z);
        }
        self.begin(body, low);
        for piece in pieces {
            self.list(piece);
        }
        self.move_sand();
    }

    /// Lets sand slide, after all bodies have moved it.
    #[inline(always)]
    pub fn end(mut self) {
        self.skip_to(self.memory.surfaces.levels.len());
        for lane in 0..R::LANES {
            if self.due >> lane & 1 == 0 {
                continue;
            }
            let LaneMemory { settings, moved, dt, .. } = &mut *self.memory;
            let (settings, moved) = (&settings[lane], &mut moved[lane]);
            moved.sliding += (f64::from(moved.pending) * *dt / settings.sweep) as f32;
            moved.pending = 0;
            let sweeps = moved.sliding.floor();
            moved.sliding -= sweeps;
            for _ in 0..(sweeps as usize).min(MOST_SWEEPS) {
                moved.grid.slide::<R::Shorts>(settings.repose);
            }
            self.memory.show(lane);
        }
    }

    /// The bodies before this one that have not come are not in the sand.
    #[inline(always)]
    fn skip_to(&mut self, body: usize) {
        for (lane, moved) in self.memory.moved.iter_mut().enumerate() {
            if self.due >> lane & 1 == 1 {
                moved.found[self.next..body].iter_mut().for_each(|found| found.inside = false);
            }
        }
    }
}

/// Most sweeps after one movement: our choice, a bound on the time of a step for very fine grids.
const MOST_SWEEPS: usize = 16;

/// A piece of several cells that is steeper than this counts as level [rad]: our choice, 60°, because a piece then
/// falls by less than 2¹⁵ steps over sixteen cells.
const STEEPEST: f64 = std::f64::consts::FRAC_PI_3;
/// Most lanes of a number type: see [`crate::number::Isa::lanes`].
const MOST_LANES: usize = 16;

/// The cell of each lane's origin, and the origin's place in it [cells].
struct LaneCorner<R> {
    cells: [[i32; 2]; MOST_LANES],
    within: [R; 2],
}

impl<R: Real> LanePiece<R> {
    /// Adds the piece, in the units of the grids, to the lists of these lanes (one bit a lane): to the first lanes' if it takes sand, to
    /// the second lanes' always.
    #[inline(always)]
    fn list(&self, frame: &GridFrame, corner: &LaneCorner<R>, lanes: [u32; 2], listed: &mut [Vec<GridPiece>]) {
        let Self { place, velocity, area, cells, number, .. } = *self;
        let inwards = if self.one_sided { R::one() } else { self.normal.dot(velocity) };
        let side = R::select(inwards.lt(R::zero()), -R::one(), R::one());
        let normal = self.normal * side;
        let rate = swept(normal, velocity, area, cells, frame);
        let mut lanes = lanes[1] | lanes[0] & R::bits(R::zero().lt(rate));
        if lanes == 0 {
            return;
        }
        let per_cell = R::splat(1.0 / frame.cell);
        let [x, y] = [place.x.mul_add(per_cell, corner.within[0]), place.y.mul_add(per_cell, corner.within[1])];
        // Rounds down: the largest integer not above x is the integer nearest to x − ½.
        let below = |less: f64| [x, y].map(|x| (x - R::splat(0.5 + less)).round());
        let middle = below(0.0);
        let height = place.z * R::splat(1.0 / frame.quantum());
        let (mut first, mut falls) = (middle, [R::zero(); 2]);
        if cells > 1 {
            first = below(0.5 * f64::from(cells - 1));
            // Each cell has the height of the piece's plane there, if that is not too steep.
            let level = R::splat(STEEPEST.cos()).lt(normal.z.abs());
            let cell_in_steps = R::splat(frame.cell / frame.quantum());
            let along_z = R::select(level, normal.z, R::one());
            falls = [normal.x, normal.y].map(|n| R::select(level, n / along_z * cell_in_steps, R::zero()));
        }
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            let [origin_x, origin_y] = corner.cells[lane];
            let cell = |c: &[R; 2]| {
                [origin_x.wrapping_add(integer(c[0].lane(lane))), origin_y.wrapping_add(integer(c[1].lane(lane)))]
            };
            let single = |x: &R| x.lane(lane) as f32;
            listed[lane].push(GridPiece {
                cell: cell(&middle),
                first: cell(&first),
                cells,
                number,
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

/// Converts `x`, a whole number between −2³¹ and 2³¹. In the sum with 1.5 · 2⁵² it is in the lowest 32 bits. This is faster
/// than `as i32`, which saturates.
#[inline(always)]
fn integer(x: f64) -> i32 {
    (x + 6_755_399_441_055_744.0).to_bits() as i32
}
