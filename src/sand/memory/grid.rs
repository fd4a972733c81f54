//! Heights of the sand on a square grid that moves with a body.
#![allow(clippy::needless_range_loop)] // Loops over indices become straight vector code; iterators with closures may not.

use sandgait_number::{Kernel, SHORTS, Shorts};

/// Heights are whole multiples of the cell's size over this: our choice. So sums are exact, volume is conserved to the
/// last bit, and 16 bits reach 32 cells up and down.
const STEPS: f64 = 1024.0;

/// Sand begins to slide at the angle of repose, and stops at a slope that is lower by this many steps for each cell, 1/32: 1.4° at 28°
/// and 1.5° at 25°. Our choice from the one to three degrees between both angles (Jaeger & Nagel, Science 255, 1992). So most sand
/// rests soon.
const SLIDES_ON: i16 = 32;

/// A square of cells that moves over the world. Cell (i, j) of the world has the place (j · side + i) mod side² in the lists, so
/// neighbours along x are neighbours in the lists, too. When the square moves, the places of the cells behind it are used
/// again for the new cells ahead, which are level and fresh.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    pub frame: GridFrame,
    /// In steps of [`GridFrame::quantum`].
    pub(super) heights: Vec<i16>,
    /// Compaction of each cell, from 0 (loose) to 255 (closely packed).
    pub(super) packed: Vec<u8>,
    /// Which lines of `side` heights have changed since the last sweep of sliding.
    pub(super) awake: Vec<bool>,
    /// Upper bound of all heights so far.
    pub(super) top: i16,
}

/// Where the cells of a square are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridFrame {
    /// Side of a cell [m].
    pub cell: f64,
    /// Cells in a metre.
    per_meter: f64,
    /// The square has 2^bits cells along a side.
    bits: u32,
    /// Lowest indices of the square's cells along x and y.
    corner: [i32; 2],
}

impl GridFrame {
    pub(super) fn is_of(&self, cell: f64, bits: u32) -> bool {
        (self.cell, self.bits) == (cell, bits)
    }

    /// Cells along a side.
    pub fn side(&self) -> usize {
        1 << self.bits
    }

    /// Step of heights [m].
    #[inline(always)]
    pub fn quantum(&self) -> f64 {
        self.cell / STEPS
    }

    /// The cell that contains a place [m].
    #[inline(always)]
    pub fn cell_at(&self, [x, y]: [f64; 2]) -> [i32; 2] {
        [(x * self.per_meter).floor() as i32, (y * self.per_meter).floor() as i32]
    }

    /// Place in the lists of the cell that contains a place [m]; None outside of the square. An integer up to 2³¹ is in the lowest bits of
    /// its sum with 1.5 · 2⁵², which is faster than a conversion that saturates.
    #[inline(always)]
    pub(super) fn index_at(&self, [x, y]: [f64; 2]) -> Option<usize> {
        let integer = |x: f64| ((x * self.per_meter).floor() + 6_755_399_441_055_744.0).to_bits() as i32;
        self.index([integer(x), integer(y)])
    }

    /// Place of a cell in the lists; None outside of the square.
    #[inline(always)]
    pub fn index(&self, cell: [i32; 2]) -> Option<usize> {
        let side = 1_u32 << self.bits;
        let inside = |k: usize| (cell[k].wrapping_sub(self.corner[k]) as u32) < side;
        (inside(0) && inside(1)).then(|| self.place(cell))
    }

    /// The same for a cell of the square.
    #[inline(always)]
    pub(super) fn place(&self, [x, y]: [i32; 2]) -> usize {
        ((y as usize) << self.bits).wrapping_add(x as usize) & ((1 << (2 * self.bits)) - 1)
    }

    /// The part of `count` cells from `first` on, along an axis, that is in the square: first cell and number.
    #[inline(always)]
    pub(super) fn inside(&self, axis: usize, first: i32, count: i32) -> (i32, i32) {
        let corner = self.corner[axis];
        let from = first.max(corner);
        (from, first.saturating_add(count).min(corner + (1 << self.bits)).saturating_sub(from))
    }
}

impl Grid {
    /// Level sand around x = y = 0.
    pub fn new(cell: f64, bits: u32) -> Self {
        let side = 1_usize << bits;
        let corner = [-(side as i32) / 2; 2];
        let (heights, packed) = (vec![0; side * side], vec![0; side * side]);
        Self {
            frame: GridFrame { cell, per_meter: 1.0 / cell, bits, corner },
            heights,
            packed,
            awake: vec![false; side],
            top: 0,
        }
    }

    /// Height of a cell [m]; level outside of the square.
    #[inline(always)]
    pub fn height(&self, cell: [i32; 2]) -> f64 {
        match self.frame.index(cell) {
            Some(i) => f64::from(self.heights[i]) * self.frame.quantum(),
            None => 0.0,
        }
    }

    /// Upper bound of all heights so far [m].
    #[inline(always)]
    pub fn highest(&self) -> f64 {
        f64::from(self.top) * self.frame.quantum()
    }

    /// All cells of the square: index along x and y, and height [m], row by row along x.
    pub fn cells(&self) -> impl Iterator<Item = ([i32; 2], f64)> {
        let (side, corner) = (self.frame.side() as i32, self.frame.corner);
        let place = move |k: i32| [corner[0] + k % side, corner[1] + k / side];
        (0..side * side).map(move |k| (place(k), self.height(place(k))))
    }

    /// Sum of all heights times the cells' area [m³].
    pub fn volume(&self) -> f64 {
        let sum: i64 = self.heights.iter().map(|h| i64::from(*h)).sum();
        sum as f64 * self.frame.quantum() * self.frame.cell * self.frame.cell
    }

    /// Appends everything but size and number of the cells.
    pub(super) fn write(&self, out: &mut Vec<u8>) {
        out.extend(self.frame.corner.iter().flat_map(|c| c.to_le_bytes()));
        out.extend(self.top.to_le_bytes());
        out.extend(self.awake.iter().map(|a| u8::from(*a)));
        out.extend(&self.packed);
        out.extend(self.heights.iter().flat_map(|h| h.to_le_bytes()));
    }

    /// Reads the bytes that [`Self::write`] has written for a grid of the same size; None if they are not such bytes.
    pub(super) fn read(&mut self, bytes: &[u8]) -> Option<()> {
        let (head, rest) = bytes.split_first_chunk::<10>()?;
        let [a, b, c, d, e, f, g, h, low, high] = *head;
        self.frame.corner = [i32::from_le_bytes([a, b, c, d]), i32::from_le_bytes([e, f, g, h])];
        self.top = i16::from_le_bytes([low, high]);
        let (awake, rest) = rest.split_at_checked(self.awake.len())?;
        let (packed, rest) = rest.split_at_checked(self.packed.len())?;
        let (heights, rest) = rest.as_chunks::<2>();
        // A robot that walks for years stays within a quarter of the integers.
        let far = self.frame.corner.iter().any(|c| c.unsigned_abs() > 1 << 29);
        if far || heights.len() != self.heights.len() || !rest.is_empty() || awake.iter().any(|a| *a > 1) {
            return None;
        }
        self.awake.iter_mut().zip(awake).for_each(|(row, a)| *row = *a == 1);
        self.packed.copy_from_slice(packed);
        self.heights.iter_mut().zip(heights).for_each(|(height, h)| *height = i16::from_le_bytes(*h));
        Some(())
    }

    /// Moves the square so that `place` [m] is near its middle.
    #[inline(always)]
    pub fn follow(&mut self, place: [f64; 2]) {
        let half = 1_i32 << (self.frame.bits - 1);
        let new = self.frame.cell_at(place).map(|i| i.saturating_sub(half));
        // The square moves when the place is an eighth of the side from its middle: our choice, so that it does not move in every step.
        let near = |k: usize| new[k].abs_diff(self.frame.corner[k]) < half as u32 / 4;
        if near(0) && near(1) {
            return;
        }
        self.move_to(new);
    }

    /// Moves the square to another corner.
    fn move_to(&mut self, new: [i32; 2]) {
        let old = std::mem::replace(&mut self.frame.corner, new);
        let side = self.frame.side() as i32;
        for (axis, (new, old)) in new.into_iter().zip(old).enumerate() {
            let moved = new.saturating_sub(old).clamp(-side, side);
            let fresh = if moved > 0 { new + side - moved..new + side } else { new..new - moved };
            for line in fresh {
                let across = self.frame.corner[1 - axis];
                for other in across..across + side {
                    let at = self.frame.place(if axis == 0 { [line, other] } else { [other, line] });
                    (self.heights[at], self.packed[at]) = (0, 0);
                }
            }
        }
    }

    /// Marks the line of a cell as one that has changed.
    #[inline(always)]
    pub(super) fn wake(&mut self, index: usize) {
        self.awake[index >> self.frame.bits] = true;
    }

    /// One sweep of sliding, first along x, then along y. Sand slides if the slope between two neighbouring cells exceeds
    /// `steepest` (a tangent): a quarter of the excess over the slope at which sliding stops ([`SLIDES_ON`]) moves down. With a
    /// quarter to each of two neighbours, heights cannot oscillate: our choice. All cells move at once, so their order has no
    /// effect. A sweep skips lines that have not changed since the last sweep, and whose neighbours have not.
    #[inline(always)]
    pub fn slide<S: Shorts>(&mut self, steepest: f64) {
        let limit = (steepest * STEPS).round().clamp(f64::from(SLIDES_ON), 32_000.0) as i16 - SLIDES_ON;
        let slope = Slope { rest: S::splat(limit), start: S::splat(limit + SLIDES_ON) };
        S::dispatch(Sliding { grid: self, slope });
    }

    /// `W` heights a line, in `V` vectors.
    #[inline(always)]
    fn sweep<S: Shorts, const W: usize, const V: usize>(&mut self, slope: &Slope<S>) {
        // The edges of the square are not neighbours, although their places are: along x the pair that ends at this column of
        // all lines, along y the pairs from the places before this one, a whole line of them.
        let first = self.frame.place(self.frame.corner);
        let mut changed = [false; W];
        self.slide_along::<S, W, V>(slope, first % W, &mut changed);
        self.slide_across::<S, W, V>(slope, first, &mut changed);
        self.awake.copy_from_slice(&changed);
    }

    #[inline(always)]
    fn slide_along<S: Shorts, const W: usize, const V: usize>(
        &mut self,
        slope: &Slope<S>,
        first: usize,
        changed: &mut [bool; W],
    ) {
        let (lines, _) = self.heights.as_chunks_mut::<W>();
        let mut edge = [-1; W];
        edge[(first + W - 1) % W] = 0;
        // The lists' ends are neighbours, too.
        let very_first = lines[0][0];
        let mut before = {
            let own = S::load(&lines[W - 1], W - SHORTS);
            slope.slides(own, own.lowered(very_first)).and(S::load(&edge, W - SHORTS))
        };
        for y in 0..W {
            // A line's ends have neighbours in the lines beside it.
            if !(self.awake[y] || self.awake[(y + W - 1) % W] || self.awake[(y + 1) % W]) {
                before = S::splat(0);
                continue;
            }
            let next_line = if y + 1 < W { lines[y + 1][0] } else { very_first };
            let line = &mut lines[y];
            let mut slid = S::splat(0);
            for k in 0..V {
                let own = S::load(line, k * SHORTS);
                let next = if k + 1 < V { S::load(line, k * SHORTS + 1) } else { own.lowered(next_line) };
                let out = slope.slides(own, next).and(S::load(&edge, k * SHORTS));
                let come = out.raised(before);
                own.plus(come.minus(out)).store(line, k * SHORTS);
                slid = slid.or(come).or(out);
                before = out;
            }
            changed[y] = slid.any();
        }
    }

    #[inline(always)]
    fn slide_across<S: Shorts, const W: usize, const V: usize>(
        &mut self,
        slope: &Slope<S>,
        first: usize,
        changed: &mut [bool; W],
    ) {
        let (lines, _) = self.heights.as_chunks_mut::<W>();
        // The square's first and last rows share `first_line`: places before `column` belong to the last row.
        let (first_line, column) = (first / W, first % W);
        let (mut before, mut behind, all) = ([-1; W], [-1; W], [-1; W]);
        before[column..].fill(0);
        behind[..column].fill(0);
        let last_line = (first_line + W - 1) % W;
        let (mut shared, mut any) = ([S::splat(0); V], S::splat(0));
        for k in 0..V {
            let (own, next) = (S::load(&lines[last_line], k * SHORTS), S::load(&lines[first_line], k * SHORTS));
            shared[k] = slope.slides(own, next).and(S::load(&before, k * SHORTS));
            any = any.or(shared[k]);
        }
        let ended = any.any();
        let (mut come, mut came) = (shared, ended);
        for step in 0..W - 1 {
            let (y, next) = ((first_line + step) % W, (first_line + step + 1) % W);
            if !(came || changed[y] || changed[next] || self.awake[y] || self.awake[next]) {
                continue;
            }
            let pairs = if step == 0 { &behind } else { &all };
            let mut passed = S::splat(0);
            for k in 0..V {
                let (own, next) = (S::load(&lines[y], k * SHORTS), S::load(&lines[next], k * SHORTS));
                let out = slope.slides(own, next).and(S::load(pairs, k * SHORTS));
                own.plus(come[k].minus(out)).store(&mut lines[y], k * SHORTS);
                come[k] = out;
                passed = passed.or(out);
            }
            let passed = passed.any();
            changed[y] |= passed || came;
            came = passed;
        }
        for k in 0..V {
            let own = S::load(&lines[last_line], k * SHORTS);
            own.plus(come[k].minus(shared[k])).store(&mut lines[last_line], k * SHORTS);
        }
        changed[last_line] |= came || ended;
        changed[first_line] |= ended;
    }
}

/// Differences in height.
struct Slope<S> {
    /// Sand that slides comes to rest at `rest`, and sand at rest begins to slide beyond `start`.
    rest: S,
    start: S,
}

/// A sweep of [`Grid::slide`], the same for all engines.
struct Sliding<'a, S> {
    grid: &'a mut Grid,
    slope: Slope<S>,
}

impl<S: Shorts> Kernel for Sliding<'_, S> {
    #[inline(always)]
    fn run(self) {
        let Self { grid, slope } = self;
        match grid.frame.bits {
            6 => grid.sweep::<S, 64, 4>(&slope),
            7 => grid.sweep::<S, 128, 8>(&slope),
            _ => grid.sweep::<S, 256, 16>(&slope),
        }
    }
}

impl<S: Shorts> Slope<S> {
    /// Amounts that slide from cells to their neighbours; negative: from the neighbours to the cells.
    #[inline(always)]
    fn slides(&self, heights: S, neighbours: S) -> S {
        let step = heights.less(neighbours);
        let size = step.magnitude();
        size.quarter_over(self.rest).and(size.above(self.start)).signed(step)
    }
}
