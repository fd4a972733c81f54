//! Heights of the sand on a square grid that moves with a body.
#![allow(clippy::needless_range_loop, clippy::manual_memcpy)] // Loops over indices become vectors; calls with closures or slices may not.

/// Heights are whole multiples of the cell's size over this: our choice. So sums are exact, volume is conserved to the
/// last bit, and 16 bits reach 32 cells up and down.
const STEPS: f64 = 1024.0;

/// Sand that slides comes to rest at this much less than the slope at which it begins to, in steps of a cell's size: 1.8° from level, our
/// choice from the one to three degrees between both angles (Jaeger & Nagel, Science 255, 1992). So most sand rests soon.
const SLIDES_ON: i16 = 32;

/// Heights in a vector of AVX2.
const WIDE: usize = 16;

/// A periodic square of cells. Each cell of the world has one place in it; when the square moves, places of cells that
/// are left behind are used again for cells ahead, which are level and fresh.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    pub frame: GridFrame,
    /// In steps of [`GridFrame::quantum`], row by row along x.
    pub(super) heights: Vec<i16>,
    /// How much of the possible compaction each cell has had, from 0 to 255.
    pub(super) packed: Vec<u8>,
    /// Rows that have changed since sand slid last.
    pub(super) awake: Vec<bool>,
    /// No cell has been higher.
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

    /// Place of a cell in the lists; None outside of the square.
    #[inline(always)]
    pub fn index(&self, [x, y]: [i32; 2]) -> Option<usize> {
        Some((self.line(1, y)? << self.bits) | self.line(0, x)?)
    }

    /// Column (`axis` 0) or row (1) of a cell in the lists.
    #[inline(always)]
    pub(super) fn line(&self, axis: usize, i: i32) -> Option<usize> {
        let side = 1_u32 << self.bits;
        let inside = (i.wrapping_sub(self.corner[axis]) as u32) < side;
        inside.then_some((i as u32 & (side - 1)) as usize)
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

    /// No cell has been higher than this [m].
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

    /// Reads what [`Self::write`] has written for a grid of the same size; None if it is something else.
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
        // It moves when the place is an eighth of the side off: our choice, so that it does not move in every step.
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
        let mask = side - 1;
        for (k, (new, old)) in new.into_iter().zip(old).enumerate() {
            let moved = new.saturating_sub(old).clamp(-side, side);
            let fresh = if moved > 0 { new + side - moved..new + side } else { new..new - moved };
            for line in fresh {
                let line = (line & mask) as usize;
                for i in 0..side as usize {
                    let at = if k == 0 { (i << self.frame.bits) | line } else { (line << self.frame.bits) | i };
                    (self.heights[at], self.packed[at]) = (0, 0);
                }
            }
        }
    }

    /// Marks the row of a cell as one that has changed.
    #[inline(always)]
    pub(super) fn wake(&mut self, index: usize) {
        self.awake[index >> self.frame.bits] = true;
    }

    /// One sweep of sliding, first along x, then along y. If the difference in height of two neighbouring cells exceeds
    /// `steepest` (a tangent), a quarter of the excess over [`SLIDES_ON`] less moves down. With a quarter to each of two
    /// neighbours cells cannot swing: our choice. All cells of a line move at once, so their order has no effect.
    #[inline(always)]
    pub fn slide(&mut self, steepest: f64) {
        let limit = (steepest * STEPS).round().clamp(f64::from(SLIDES_ON), 32_000.0) as i16 - SLIDES_ON;
        match self.frame.bits {
            6 => self.sweep::<4>(limit),
            7 => self.sweep::<8>(limit),
            _ => self.sweep::<16>(limit),
        }
    }

    /// `V` vectors a row. Nothing slides between cells that have not changed since they were looked at.
    #[inline(always)]
    fn sweep<const V: usize>(&mut self, limit: i16) {
        let (heights, _) = self.heights.as_chunks_mut::<WIDE>();
        let (rows, _) = heights.as_chunks_mut::<V>();
        let mask = rows.len() - 1;
        // The square's edges are not neighbours, although their places are.
        let [first_column, first_row] = self.frame.corner.map(|c| c as usize & mask);
        let mut passes = [[-1_i16; WIDE]; V];
        let last = first_column.wrapping_sub(1) & mask;
        passes[last / WIDE][last % WIDE] = 0;
        let mut changed = [false; 16 * WIDE];
        for (y, row) in rows.iter_mut().enumerate().filter(|(y, _)| self.awake[*y]) {
            let (old, mut out) = (*row, [[0; WIDE]; V]);
            for k in 0..V {
                let mut next = [old[(k + 1) % V][0]; WIDE];
                for i in 1..WIDE {
                    next[i - 1] = old[k][i];
                }
                out[k] = flow(old[k], next, limit, passes[k]);
            }
            for k in 0..V {
                let mut come = [out[(k + V - 1) % V][WIDE - 1]; WIDE];
                for i in 1..WIDE {
                    come[i] = out[k][i - 1];
                }
                row[k] = moved(old[k], come, out[k]);
            }
            changed[y] = any(&out);
        }
        let (mut come, mut came) = ([[0; WIDE]; V], false);
        for k in 0..rows.len() {
            let (y, next) = ((first_row + k) & mask, (first_row + k + 1) & mask);
            let looked = k < mask && (self.awake[y] || self.awake[next]);
            if !(looked || came) {
                continue;
            }
            let (old, other) = (rows[y], rows[next]);
            let kept = [if looked { -1 } else { 0 }; WIDE];
            let mut out = [[0; WIDE]; V];
            for k in 0..V {
                out[k] = flow(old[k], other[k], limit, kept);
            }
            for k in 0..V {
                rows[y][k] = moved(old[k], come[k], out[k]);
            }
            let passed = any(&out);
            changed[y] |= passed || came;
            (come, came) = (out, passed);
        }
        self.awake.copy_from_slice(&changed[..=mask]);
    }
}

type Wide = [i16; WIDE];

/// What slides from cells to their neighbours, where all bits of `passes` are set.
#[inline(always)]
fn flow(heights: Wide, neighbours: Wide, limit: i16, passes: Wide) -> Wide {
    let mut out = [0; WIDE];
    for i in 0..WIDE {
        out[i] = slid(heights[i], neighbours[i], limit) & passes[i];
    }
    out
}

/// Heights after a movement.
#[inline(always)]
fn moved(old: Wide, come: Wide, out: Wide) -> Wide {
    let mut new = [0; WIDE];
    for i in 0..WIDE {
        new[i] = old[i].wrapping_add(come[i].wrapping_sub(out[i]));
    }
    new
}

/// Does anything slide?
#[inline(always)]
fn any<const V: usize>(out: &[Wide; V]) -> bool {
    let mut any = [0; WIDE];
    for out in out {
        for i in 0..WIDE {
            any[i] |= out[i];
        }
    }
    any != [0; WIDE]
}

/// What slides from a cell to its neighbour; negative: to the cell.
#[inline(always)]
fn slid(height: i16, neighbour: i16, limit: i16) -> i16 {
    let step = height.saturating_sub(neighbour);
    // A shift rounds down; so a negative excess counts from further away, and both directions are alike.
    let excess = step.wrapping_sub(step.clamp(-3 - limit, limit));
    let rests = step == step.clamp(-SLIDES_ON - limit, limit + SLIDES_ON);
    if rests { 0 } else { excess >> 2 }
}
