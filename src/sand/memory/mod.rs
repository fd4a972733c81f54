//! Sand that was moved stays moved: heights of the surface, and how compacted it is.
//!
//! Resistive force theory gives the force on a body in level, fresh sand. Here the surface has heights ([`Grid`]) that
//! bodies change, and the force law's depth is counted from the surface that a body has found:
//!
//! * **Swept volume.** A piece of a body's surface with area A, outward normal m and velocity v, below the sand's
//!   surface, moves the volume A (m·v)₊ dt out of its cell. Sand that the piece only lifts falls back and counts as not moved.
//!   This is the bulldozing of soil contact models (SCM: Krenn & Hirzinger, ISTVS, Bremen 2009: displaced soil is counted and
//!   put around the contact; Holz, Beer & Kuhlen 2009).
//! * **Where it goes.** Ahead of the body, within the reach L = D tan(45° + φ/2) of the passive wedge (Rankine 1857; the
//!   failure surface of excavation models, Reece 1964, McKyes 1985), D the depth of the body and φ the angle of repose. Sand
//!   that the body's shape does not hold (`heap.rs`) flows around it, to both sides of its way.
//!   A body that moves straight down spreads it around itself within the same reach.
//! * **Sliding.** Slopes above the angle of repose slide (Grid::slide; a cellular rule as in Bak, Tang & Wiesenfeld 1987
//!   and in SCM's erosion step).
//! * **What a body finds.** Depths count from a level: when the body enters, the mean height below its lowest pieces. While the body
//!   travels, the level follows the mean height ahead of the heap that the body pushes now. The theory's measured
//!   coefficients contain that heap, so where a body has not pushed it yet, the level is lower (`heap.rs`). So the force in
//!   fresh sand is that of the theory, except where an upright plate begins to travel.
//! * **Compaction.** Pressing down takes volume out of loose sand until the sand is closely packed. Compacted sand is
//!   stronger: [`MemorySettings::gain`].

mod cut;
mod disc;
mod grid;
mod heap;
mod local;
mod piece;
mod settings;

pub use disc::PAIRS;
pub use grid::{Grid, GridFrame};
pub use local::LocalSand;
pub use piece::{GridPiece, MOST_CELLS, SurfacePiece, swept};
pub use settings::{MemorySettings, REPOSE_DEG};

use cut::Taking;
use disc::{Disc, SMALLEST, receiving};
use heap::{Pushing, Taken};
use sandgait_number::{Kernel, PlainShorts, Shorts};
use settings::{AHEAD, DENSER, LOST, WAY};
use std::marker::PhantomData;

/// Numbers of the quasirandom sequence that a body uses in a turn, one for each piece: our choice, about as many as a
/// leg or a belly has pieces.
const PIECES: u32 = 61;

/// The surface around a robot or an intruder, and what each of its bodies has found.
#[derive(Clone, Debug, PartialEq)]
pub struct Moved {
    pub grid: Grid,
    pub found: Vec<LocalSand>,
    /// `pending`: time since sand was moved last [time steps], for engines; `turns`: how often bodies have moved sand.
    pub pending: u32,
    pub turns: u32,
    /// Part of a sweep of sliding that is due, for engines.
    pub sliding: f32,
}

/// Marks the cells from which a body could take sand in this turn. This is work space: its contents do not outlive the turn.
#[derive(Clone, Debug, Default)]
pub struct Marks {
    cells: Vec<i16>,
    round: i16,
}

impl Marks {
    #[inline(always)]
    fn begin(&mut self, cells: usize) {
        if self.cells.len() < cells {
            self.cells.resize(cells, 0);
        }
        self.round = self.round.wrapping_add(1);
        if self.round == 0 {
            self.cells.fill(0);
            self.round = 1;
        }
    }

    #[inline(always)]
    fn is_set(&self, index: usize) -> bool {
        self.cells[index] == self.round
    }
}

/// How a body has moved since sand was moved last.
#[derive(Clone, Copy, Debug)]
pub struct BodyMotion {
    /// The cell of the origin from which places count.
    pub origin: [i32; 2],
    /// Height of the body's lowest piece [m].
    pub low: f64,
    /// Distance along x and y that the body has moved [m]; None: the mean of its pieces in the sand, weighted by their area.
    pub way: Option<[f64; 2]>,
    /// [s]
    pub time: f64,
}

/// A call of [`Moved::meet`], the same for all engines.
struct Meeting<'a, S> {
    moved: &'a mut Moved,
    settings: &'a MemorySettings,
    body: usize,
    pieces: &'a [GridPiece],
    motion: &'a BodyMotion,
    marks: &'a mut Marks,
    shorts: PhantomData<S>,
}

impl<S: Shorts> Kernel for Meeting<'_, S> {
    #[inline(always)]
    fn run(self) {
        self.moved.met::<S>(self.settings, self.body, self.pieces, self.motion, self.marks);
    }
}

impl Moved {
    /// Level sand and `bodies` bodies outside of it.
    pub fn new(s: &MemorySettings, bodies: usize) -> Self {
        Self {
            grid: Grid::new(s.cell, s.bits),
            found: vec![LocalSand::default(); bodies],
            pending: 0,
            turns: 0,
            sliding: 0.0,
        }
    }

    /// Does this sand have these settings, and so many bodies?
    pub fn fits(&self, s: &MemorySettings, bodies: usize) -> bool {
        self.found.len() == bodies && self.grid.frame.is_of(s.cell, s.bits)
    }

    /// All numbers, little-endian, for [`Self::from_bytes`].
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(3 * self.grid.heights.len() + 100);
        out.extend([self.pending, self.turns, self.sliding.to_bits()].iter().flat_map(|n| n.to_le_bytes()));
        self.found.iter().for_each(|found| out.extend(found.to_bytes()));
        self.grid.write(&mut out);
        out
    }

    /// The sand of `bodies` bodies from its [`Self::to_bytes`]; None if it cannot be of these settings. `pending` is
    /// bounded, so that it cannot overflow in later steps.
    pub fn from_bytes(s: &MemorySettings, bodies: usize, bytes: &[u8]) -> Option<Self> {
        let mut new = Self::new(s, bodies);
        let (counts, mut rest) = bytes.split_first_chunk::<12>()?;
        let [a, b, c, d, e, f, g, h, i, j, k, l] = *counts;
        (new.pending, new.turns) = (u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h]));
        new.sliding = f32::from_le_bytes([i, j, k, l]);
        for found in &mut new.found {
            let (one, others) = rest.split_first_chunk()?;
            *found = LocalSand::from_bytes(s, one)?;
            rest = others;
        }
        (new.pending < 1 << 30 && (0.0..1.0).contains(&new.sliding) && new.grid.read(rest).is_some()).then_some(new)
    }

    /// Memory [bytes].
    pub fn bytes(s: &MemorySettings, bodies: usize) -> usize {
        size_of::<Self>() + bodies * size_of::<LocalSand>() + (3 << (2 * s.bits)) + (1 << s.bits)
    }

    /// Moves the sand that a body pushes in `time` [s], and updates what the body finds. `pieces`: the body's leading pieces; `way`: the
    /// distance along x and y that the body has moved [m].
    pub fn push(
        &mut self,
        s: &MemorySettings,
        body: usize,
        pieces: &[SurfacePiece],
        way: [f64; 2],
        time: f64,
        marks: &mut Marks,
    ) {
        let frame = self.grid.frame;
        let origin = pieces.first().map_or([0; 2], |p| frame.cell_at([p.place[0], p.place[1]]));
        let low = pieces.iter().fold(f64::INFINITY, |low, p| low.min(p.place[2]));
        let pieces: Vec<_> = (0..).zip(pieces).map(|(number, piece)| piece.on(number, &frame, origin)).collect();
        self.meet::<PlainShorts>(s, body, &pieces, &BodyMotion { origin, low, way: Some(way), time }, marks);
    }

    /// The same for pieces in the units of the grid.
    #[inline(always)]
    pub fn meet<S: Shorts>(
        &mut self,
        s: &MemorySettings,
        body: usize,
        pieces: &[GridPiece],
        motion: &BodyMotion,
        marks: &mut Marks,
    ) {
        S::dispatch(Meeting { moved: self, settings: s, body, pieces, motion, marks, shorts: PhantomData::<S> });
    }

    #[inline(always)]
    fn met<S: Shorts>(
        &mut self,
        s: &MemorySettings,
        body: usize,
        pieces: &[GridPiece],
        motion: &BodyMotion,
        marks: &mut Marks,
    ) {
        let BodyMotion { low, time, .. } = *motion;
        let mut found = self.found[body];
        if !found.inside || low >= f64::from(found.ground) {
            let under = self.below(pieces, low, s.least);
            let outside = low >= under[0];
            if !found.inside || outside {
                found = LocalSand::at(under, !outside);
            }
            if outside {
                self.found[body] = found;
                return;
            }
        }
        marks.begin(self.grid.heights.len());
        let size = f64::from(found.size);
        let taken = self.take::<S>(s, pieces, motion, size, marks);
        if taken.amount > 0 {
            let reach = s.wedge() * (f64::from(found.ground) - low).max(s.least);
            let pushing = Pushing::new(s, &taken, motion.way.unwrap_or(taken.velocity.map(|v| v * time)));
            self.put(s, &receiving(&taken, &pushing, reach, size, s.least, self.turns), &taken, marks, size);
            if pushing.length > 0.0 {
                let radius = disc::before(reach, size).max(SMALLEST * s.least);
                let beyond = self.beyond(s, &taken, radius, pushing.along);
                found.go_on(beyond, pushing.length / (WAY * radius));
            }
            found.push_heap(s, &pushing, low, reach);
        }
        self.found[body] = found;
        self.turns = self.turns.wrapping_add(1);
    }

    /// Mean height [m] and compaction below the lowest pieces of a body, and the radius of a disc of their area [m].
    #[inline(always)]
    fn below(&self, pieces: &[GridPiece], low: f64, least: f64) -> [f64; 3] {
        let frame = &self.grid.frame;
        let lowest = ((low + least) / frame.quantum()) as f32;
        let (mut area, mut sums) = (0.0, [0.0; 2]);
        let (mut middle, mut squares) = ([0.0; 2], 0.0);
        for p in pieces.iter().filter(|p| p.height < lowest) {
            let ([x, y], own) = (p.place.map(f64::from), f64::from(p.area));
            area += own;
            sums[0] += own * self.grid.height(p.cell);
            sums[1] += own * frame.index(p.cell).map_or(0.0, |i| f64::from(self.grid.packed[i]) / 255.0);
            middle = [middle[0] + own * x, middle[1] + own * y];
            squares += own * (x * x + y * y);
        }
        if area == 0.0 {
            return [0.0; 3];
        }
        let middle = middle.map(|m| m / area);
        // The radius is that of a disc with the same second moment.
        let spread = (squares / area - middle[0] * middle[0] - middle[1] * middle[1]).max(0.0);
        [sums[0] / area, sums[1] / area, frame.cell * (2.0 * spread).sqrt()]
    }

    /// Takes the sand that the pieces sweep out of their cells.
    #[inline(always)]
    fn take<S: Shorts>(
        &mut self,
        s: &MemorySettings,
        pieces: &[GridPiece],
        motion: &BodyMotion,
        size: f64,
        marks: &mut Marks,
    ) -> Taken {
        let quantum = self.grid.frame.quantum();
        let mut taken = Taken::default();
        // The share of the volume pressed down that is lost, and the compaction of a cell by one step [1/255]. The
        // compacted layer is as thick as the body's diameter (our choice).
        let lost = if s.gain > 1.0 { LOST } else { 0.0 };
        let denser = 256.0 * lost * quantum / (DENSER * 2.0 * size.max(s.cell));
        let top = f32::from(self.grid.top);
        let mut area = 0.0;
        for p in pieces.iter().filter(|p| p.height < top) {
            let each = p.rate * motion.time as f32;
            if each <= 0.0 {
                continue;
            }
            let down = f64::from((-p.normal[2]).max(0.0)).powi(2);
            // Pieces that share a cell use different chances, so they do not round up in the same turn.
            let turn = self.turns.wrapping_mul(PIECES).wrapping_add(p.number.into());
            let Taking { amount, loose, met } = self.grid.cut::<S>(p, motion.origin, each, down * denser, turn, marks);
            let a = f64::from(amount);
            let add = |sum: [f64; 2], weight: f64, own: [f32; 2]| [0, 1].map(|k| sum[k] + weight * f64::from(own[k]));
            if met {
                area += f64::from(p.area);
                taken.velocity = add(taken.velocity, p.area.into(), p.velocity);
            }
            taken.amount += amount;
            taken.place = add(taken.place, a, p.place);
            let [x, y] = p.place.map(f64::from);
            taken.spread = [taken.spread[0] + a * x * x, taken.spread[1] + a * y * y, taken.spread[2] + a * x * y];
            taken.push = add(taken.push, a, [p.normal[0], p.normal[1]]);
            taken.lost += f64::from(loose) * lost * down;
        }
        let amount = f64::from(taken.amount.max(1));
        let [x, y] = taken.place.map(|sum| sum / amount);
        let squares = [x * x, y * y, x * y];
        taken.spread = [0, 1, 2].map(|k| (taken.spread[k] / amount - squares[k]) * s.cell * s.cell);
        taken.place = [0, 1].map(|k| ([x, y][k] + f64::from(motion.origin[k])) * s.cell);
        taken.push = taken.push.map(|p| p / amount);
        taken.velocity = taken.velocity.map(|v| v / area.max(1e-12)); // avoids 0/0
        taken
    }

    /// Distributes what was taken among places of a disc where the body is not.
    #[inline(always)]
    fn put(&mut self, s: &MemorySettings, disc: &Disc, taken: &Taken, marks: &Marks, size: f64) {
        let amount = taken.amount - taken.lost as i32;
        let mut wider = *disc;
        // A disc that the body covers grows until a place is free, by half and a cell: our choice, eight times at most.
        // If none is free even then, the sand falls back on the body's own cells.
        for growths in 0..=8 {
            let back = growths == 8;
            let disc = if back { disc } else { &wider };
            let mut free = [0_u16; 2 * PAIRS];
            let mut count = 0;
            disc.visit(self.grid.frame, s.pairs, self.turns, |at| {
                free[count] = at as u16;
                count += usize::from(back || !marks.is_set(at));
            });
            if count == 0 {
                wider.radius = 1.5 * disc.radius + s.cell;
                continue;
            }
            let (each, rest) = (amount / count as i32, amount % count as i32);
            let keep = 1.0 - (f64::from(each) * self.grid.frame.quantum() / size.max(s.cell)).min(1.0);
            for (k, at) in free[..count].iter().enumerate() {
                let at = usize::from(*at);
                let now = each + i32::from((k as i32) < rest);
                let height = &mut self.grid.heights[at];
                *height = height.saturating_add(now.min(i16::MAX.into()) as i16);
                self.grid.top = self.grid.top.max(*height);
                // Sand that was moved is loose.
                if self.grid.packed[at] > 0 {
                    self.grid.packed[at] = (f64::from(self.grid.packed[at]) * keep) as u8;
                }
                self.grid.wake(at);
            }
            return;
        }
    }

    /// Mean height [m] and compaction of the sand that the body will find next: in a disc of this radius, ahead of the sand
    /// that the body pushes now.
    #[inline(always)]
    fn beyond(&self, s: &MemorySettings, taken: &Taken, radius: f64, along: [f64; 2]) -> [f64; 2] {
        let next = |k: usize| taken.place[k] + AHEAD * radius * along[k];
        let next = Disc { center: [next(0), next(1)], radius, along, gap: 0.0 };
        let (mut count, mut height, mut packed) = (0, 0, 0);
        next.visit(self.grid.frame, s.pairs, self.turns, |at| {
            count += 1;
            height += i32::from(self.grid.heights[at]);
            packed += i32::from(self.grid.packed[at]);
        });
        let mean = |sum: i32| f64::from(sum) / f64::from(count.max(1));
        [mean(height) * self.grid.frame.quantum(), mean(packed) / 255.0]
    }
}

#[cfg(test)]
mod tests;
