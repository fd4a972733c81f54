//! Heights of the sand on a square grid that moves with a body.

/// Heights are whole multiples of the cell's size over this: our choice. So sums are exact, volume is conserved to the
/// last bit, and 16 bits reach 32 cells up and down.
const STEPS: f64 = 1024.0;

/// Sand that slides comes to rest at this much less than the slope at which it begins to, in steps of a cell's size: 1.8° from level, our
/// choice from the one to three degrees between both angles (Jaeger & Nagel, Science 255, 1992). So most sand rests soon.
const SLIDES_ON: i16 = 32;

/// A periodic square of cells. Each cell of the world has one place in it; when the square moves, places of cells that
/// are left behind are used again for cells ahead, which are level and fresh.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    pub frame: GridFrame,
    /// Row by row along x, in steps of [`GridFrame::quantum`].
    pub(super) heights: Vec<i16>,
    /// How much of the possible compaction each cell has had, from 0 to 255.
    pub(super) packed: Vec<u8>,
    /// Rows in which sand may slide.
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
        let side = 1_u32 << self.bits;
        let inside = |k: usize, i: i32| (i.wrapping_sub(self.corner[k]) as u32) < side;
        let mask = side as i32 - 1;
        (inside(0, x) && inside(1, y)).then_some((((y & mask) as usize) << self.bits) | (x & mask) as usize)
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
        if (0..2).all(|k| new[k].abs_diff(self.frame.corner[k]) < half as u32 / 4) {
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

    /// Marks the row of a cell, and its neighbours, as rows in which sand may slide.
    #[inline(always)]
    pub(super) fn wake(&mut self, index: usize) {
        let (row, mask) = (index >> self.frame.bits, self.frame.side() - 1);
        self.awake[row] = true;
        self.awake[(row + 1) & mask] = true;
        self.awake[row.wrapping_sub(1) & mask] = true;
    }

    /// One sweep of sliding, first along x, then along y. If the difference in height of two neighbouring cells exceeds
    /// `steepest` (a tangent), a quarter of the excess over [`SLIDES_ON`] less moves down. With a quarter to each of two
    /// neighbours cells cannot swing: our choice. All cells of a line move at once, so their order has no effect.
    #[inline(always)]
    pub fn slide(&mut self, steepest: f64) {
        let limit = (steepest * STEPS).round().clamp(f64::from(SLIDES_ON), 32_000.0) as i16 - SLIDES_ON;
        match self.frame.bits {
            6 => self.sweep::<64, 66>(limit),
            7 => self.sweep::<128, 130>(limit),
            _ => self.sweep::<256, 258>(limit),
        }
    }

    /// `N` cells along a side; `WIDE` is `N` + 2.
    #[inline(always)]
    fn sweep<const N: usize, const WIDE: usize>(&mut self, limit: i16) {
        let mask = N - 1;
        let (heights, _) = self.heights.as_chunks_mut::<N>();
        // The square's edges are not neighbours, although their places are.
        let [first_column, first_row] = self.frame.corner.map(|c| (c & (N as i32 - 1)) as usize);
        let mut passes = [-1_i16; WIDE];
        passes[first_column] = 0;
        passes[N] = if first_column == 0 { 0 } else { -1 };
        // Rows with a copy of the other end's cell at each end: all of them are written before the first is read, which would
        // have to wait for it.
        let mut wide = [[0_i16; WIDE]; N];
        for (row, wide) in wide.iter_mut().enumerate().filter(|(row, _)| self.awake[*row]) {
            wide[1..=N].copy_from_slice(&heights[row]);
            (wide[0], wide[N + 1]) = (heights[row][N - 1], heights[row][0]);
        }
        let mut awake = [false; N];
        for (row, wide) in wide.iter().enumerate().filter(|(row, _)| self.awake[*row]) {
            let mut moves = 0;
            for (i, height) in heights[row].iter_mut().enumerate() {
                let come = slid(wide[i], wide[i + 1], limit) & passes[i];
                let out = slid(wide[i + 1], wide[i + 2], limit) & passes[i + 1];
                *height = height.wrapping_add(come.wrapping_sub(out));
                moves |= out;
            }
            awake[row] = moves != 0;
        }
        let mut come = [0_i16; N];
        let (mut came, mut looked) = (false, false);
        for k in 0..N {
            let (row, next) = ((first_row + k) & mask, (first_row + k + 1) & mask);
            let last = k + 1 == N;
            if !(looked || !last && (self.awake[row] || self.awake[next])) {
                continue;
            }
            looked = !last && (self.awake[row] || self.awake[next]);
            let (old, other) = (heights[row], heights[next]);
            let kept = if looked { -1 } else { 0 };
            let out: [i16; N] = std::array::from_fn(|i| slid(old[i], other[i], limit) & kept);
            heights[row] = std::array::from_fn(|i| old[i].wrapping_add(come[i].wrapping_sub(out[i])));
            let passed = out.iter().fold(0, |any, o| any | o) != 0;
            awake[row] |= passed || came;
            (come, came) = (out, passed);
        }
        for row in 0..N {
            self.awake[row] = awake[row] || awake[(row + 1) & mask] || awake[row.wrapping_sub(1) & mask];
        }
    }
}

/// What slides from a cell to its neighbour; negative: to the cell.
#[inline(always)]
fn slid(height: i16, neighbour: i16, limit: i16) -> i16 {
    let over = |a: i16, b: i16| {
        let excess = a.saturating_sub(b).saturating_sub(limit);
        if excess > SLIDES_ON { excess >> 2 } else { 0 }
    };
    over(height, neighbour).wrapping_sub(over(neighbour, height))
}
