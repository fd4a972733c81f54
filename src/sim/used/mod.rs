//! Sand that remembers, for engines that compute environments in lanes. See [`crate::sand::memory`] for the equations.
//!
//! Heights differ from lane to lane, so sand is moved lane by lane, in `f64`, every [`PERIOD`]. In between, each body of
//! a robot has one level from which depths count, and one strength: two numbers in lanes, so the force law stays as fast
//! as on level sand.

use crate::number::{Real, Vec3};
use crate::sand::memory::{Marks, MemorySettings, Moved, SurfacePiece};
use crate::{Model, State};

/// Time between two movements of sand [s]: our choice, a control step of the tasks. A foot that pushes with 0.5 m/s moves by two
/// cells. Half and twice this time change the speeds of hexapods whose convex side leads by at most 2 % (`walks_converge`).
const PERIOD: f64 = 2e-2;
/// Height above the highest sand above which a body finds nothing yet [cells]: our choice, 4 cm for the hexapods, which a leg of
/// theirs falls in [`PERIOD`] with 2 m/s.
const ABOVE: f64 = 8.0;

/// A piece of a body's surface in all lanes.
#[derive(Clone, Copy)]
pub struct LanePiece<R> {
    pub body: usize,
    /// From the lane's origin of x and y [m].
    pub place: Vec3<R>,
    pub normal: Vec3<R>,
    pub velocity: Vec3<R>,
    /// [m²]
    pub area: R,
    /// Does only the side of the normal touch sand?
    pub one_sided: bool,
    /// See [`SurfacePiece`].
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
    /// Of each piece, bit by bit: may it move sand in this lane?
    masks: Vec<u32>,
    own: Vec<SurfacePiece>,
    marks: Marks,
}

/// The pieces of a body, and their lowest height.
struct BodyPieces<R> {
    body: usize,
    from: usize,
    to: usize,
    low: R,
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
            masks: Vec::new(),
            own: Vec::new(),
            marks: Marks::default(),
        })
    }

    pub fn set_model(&mut self, lane: usize, model: &Model) {
        if let Some(settings) = model.scene.memory {
            self.settings[lane] = settings;
            self.show(lane);
        }
    }

    /// Takes the sand of `state`; level sand if it has none.
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

    /// Counts a time step. Is sand to be moved in any lane?
    #[inline(always)]
    pub fn tick(&mut self) -> bool {
        let mut due = false;
        for moved in &mut self.moved {
            moved.pending += 1;
            due |= moved.pending >= self.every;
        }
        due
    }

    /// Moves the sand of the lanes where it is time, by `self.pieces`, which are sorted by body. `origins`: of x and y
    /// in each lane [m]; `middle`: the robot's position from there.
    #[inline(always)]
    pub fn update(&mut self, origins: &[[f64; 2]], middle: Vec3<R>) {
        let Self { surfaces, settings, moved, pieces, groups, masks, own, marks, every, dt } = self;
        groups.clear();
        for (k, p) in pieces.iter().enumerate() {
            match groups.last_mut() {
                Some(group) if group.body == p.body => (group.to, group.low) = (k + 1, group.low.min(p.place.z)),
                _ => groups.push(BodyPieces { body: p.body, from: k, to: k + 1, low: p.place.z }),
            }
        }
        // In all lanes at once: pieces above the highest sand move none, except for a body's lowest.
        masks.clear();
        let high = surfaces.tops - R::splat((ABOVE - 1.0) * settings[0].cell);
        for group in groups.iter() {
            let high = high.max(group.low);
            for p in &pieces[group.from..group.to] {
                masks.push(!R::bits(high.lt(p.place.z)));
            }
        }
        for (lane, (settings, moved)) in settings.iter().zip(moved.iter_mut()).enumerate() {
            if moved.pending < *every {
                continue;
            }
            let (origin, time) = (origins[lane], f64::from(moved.pending) * *dt);
            moved.pending = 0;
            let [x, y, _] = middle.lane(lane);
            moved.grid.follow([origin[0] + x, origin[1] + y]);
            let high = moved.grid.highest() + settings.cell;
            // Bodies without pieces are far above.
            let mut next = 0;
            for group in groups.iter() {
                moved.found[next..group.body].iter_mut().for_each(|found| found.inside = false);
                next = group.body + 1;
            }
            moved.found[next..].iter_mut().for_each(|found| found.inside = false);
            for BodyPieces { body, from, to, low } in groups.iter() {
                let low = low.lane(lane);
                // Well above the sand: what it finds does not matter yet.
                if low > high + (ABOVE - 1.0) * settings.cell {
                    moved.found[*body].inside = false;
                    continue;
                }
                own.clear();
                let mut sum = [0.0; 3];
                let inside = moved.found[*body].inside;
                for (p, mask) in pieces[*from..*to].iter().zip(&masks[*from..*to]) {
                    if mask >> lane & 1 == 0 {
                        continue;
                    }
                    let z = p.place.z.lane(lane);
                    let place = [origin[0] + p.place.x.lane(lane), origin[1] + p.place.y.lane(lane), z];
                    // Inside, only pieces below the surface count.
                    if inside && z > low && z >= moved.grid.height(moved.grid.frame.cell_at([place[0], place[1]])) {
                        continue;
                    }
                    let piece = p.of(lane, place);
                    let [vx, vy, _] = piece.velocity;
                    sum = [sum[0] + piece.area * vx, sum[1] + piece.area * vy, sum[2] + piece.area];
                    own.push(piece);
                }
                let way = [0, 1].map(|k| sum[k] / sum[2].max(1e-12) * time);
                moved.meet(settings, *body, own, way, time, marks);
            }
            // Sweeps of sliding that are due by now.
            moved.sliding += (time / settings.sweep) as f32;
            let sweeps = moved.sliding.floor();
            moved.sliding -= sweeps;
            for _ in 0..(sweeps as usize).min(MOST_SWEEPS) {
                moved.grid.slide(settings.repose);
            }
        }
        (0..R::LANES).for_each(|lane| self.show(lane));
    }
}

/// Most sweeps after one movement: our choice, a bound on the time of a step for very fine grids.
const MOST_SWEEPS: usize = 16;

impl<R: Real> LanePiece<R> {
    #[inline(always)]
    fn of(&self, lane: usize, place: [f64; 3]) -> SurfacePiece {
        let velocity = self.velocity.lane(lane);
        let mut normal = self.normal.lane(lane);
        let along = normal[0] * velocity[0] + normal[1] * velocity[1] + normal[2] * velocity[2];
        if along < 0.0 && !self.one_sided {
            normal = normal.map(|n| -n);
        }
        SurfacePiece { place, normal, area: self.area.lane(lane), velocity, cells: self.cells }
    }
}
