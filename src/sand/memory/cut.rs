//! Pieces of bodies take sand out of the cells of a grid.

use super::grid::Grid;
use super::{GridPiece, Marks};
use sandgait_number::{SHORTS, Shorts};

/// Sand that was taken out of cells [steps of the grid].
#[derive(Clone, Copy, Default)]
pub(super) struct Taking {
    pub amount: i32,
    /// The loose part of this sand.
    pub loose: i32,
    /// Is there sand above the piece?
    pub met: bool,
}

impl Taking {
    #[inline(always)]
    fn add(&mut self, other: Self) {
        self.amount += other.amount;
        self.loose += other.loose;
        self.met |= other.met;
    }
}

/// What a piece takes out of each cell, and how much it compacts the cell.
#[derive(Clone, Copy)]
struct Portion {
    /// Whole steps, and the remaining part of a step: from −2¹⁵ (none) to 2¹⁵ (a whole step).
    whole: i16,
    part: i16,
    /// Compaction for each step of loose sand [1/255 · 2⁻¹⁶].
    denser: u16,
}

/// Most steps that are taken at once, and the highest floor: our choice, a little below the largest `i16`.
const HIGHEST: f32 = 32_000.0;

impl Portion {
    /// `each`: [steps]; `denser`: compaction for each step of loose sand [1/255].
    #[inline(always)]
    fn new(each: f32, denser: f64) -> Self {
        let each = each.min(HIGHEST);
        let whole = each as i16;
        let part = ((each - f32::from(whole)) * 65_536.0) as i32 - 32_768;
        Self { whole, part: part as i16, denser: (denser * 65_536.0).min(65_535.0) as u16 }
    }
}

/// The height below which a piece takes nothing [steps].
#[inline(always)]
fn floor(height: f32) -> i16 {
    height.ceil().clamp(-HIGHEST, HIGHEST) as i16
}

/// Factors of a sequence that is evenly distributed over columns, rows and turns: the powers of 1/1.2207440846, in 2⁻¹⁶ (the
/// R₃ sequence: M. Roberts 2018, The unreasonable effectiveness of quasirandom sequences).
const EVENLY: [u32; 3] = [53_685, 43_977, 36_025];

/// The chance of a cell in this turn. A part of a step counts as a whole step where it exceeds the chance, and as nothing elsewhere, so
/// that on average slow motions take what they sweep.
#[inline(always)]
fn chance([x, y]: [i32; 2], turn: u32) -> i16 {
    let [a, b, c] = EVENLY;
    (x as u32).wrapping_mul(a).wrapping_add((y as u32).wrapping_mul(b)).wrapping_add(turn.wrapping_mul(c)) as i16
}

/// A chance times this factor is another chance that hardly depends on the first: the factor of a multiplicative congruential generator
/// modulo 2¹⁶ (every factor that is 5 modulo 8 has the longest period: Knuth, The Art of Computer Programming 2, 3.2.1.2).
const OTHER: i16 = 25_173;

/// Numbers of lanes.
const ORDER: [i16; SHORTS] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];

/// How a piece cuts into a row of cells.
struct CellRow<S> {
    /// [`floor`] of the first cell, and how much it falls from cell to cell.
    floor: S,
    falls: S,
    /// [`chance`] of the first cell.
    chance: S,
    portion: Portion,
}

impl Grid {
    /// Takes sand out of the cells of a piece. `each`: height taken from a cell [steps]; `denser`: compaction for each
    /// step of loose sand [1/255]; `origin`: the cell from which the piece's place counts.
    #[inline(always)]
    pub(super) fn cut<S: Shorts>(
        &mut self,
        piece: &GridPiece,
        origin: [i32; 2],
        each: f32,
        denser: f64,
        turn: u32,
        marks: &mut Marks,
    ) -> Taking {
        let portion = |each| Portion::new(each, denser);
        if piece.cells == 1 {
            let at = self.frame.index(piece.first).filter(|at| f32::from(self.heights[*at]) > piece.height);
            return match at {
                Some(at) => self.cut_one(at, floor(piece.height), portion(each), chance(piece.first, turn), marks),
                None => Taking::default(),
            };
        }
        let (x, columns) = self.frame.inside(0, piece.first[0], piece.cells.into());
        let (y, rows) = self.frame.inside(1, piece.first[1], piece.cells.into());
        let mut all = Taking::default();
        if columns <= 0 {
            return all;
        }
        let (portion, falls) = (portion(each), S::splat(piece.falls[0] as i16));
        let from_middle = |k: usize, cell: i32| cell.wrapping_sub(origin[k]) as f32 + 0.5 - piece.place[k];
        let height = piece.height - piece.falls[0] * from_middle(0, x);
        for y in y..y + rows {
            let own = S::splat(floor(height - piece.falls[1] * from_middle(1, y)));
            let row = CellRow { floor: own, falls, chance: S::splat(chance([x, y], turn)), portion };
            let (at, columns) = (self.frame.place([x, y]), columns as usize);
            let beyond = (at + columns).saturating_sub(self.heights.len());
            all.add(self.cut_row(at, 0, columns - beyond, &row, marks));
            if beyond > 0 {
                all.add(self.cut_row(0, columns - beyond, beyond, &row, marks));
            }
        }
        all
    }

    #[inline(always)]
    fn cut_one(&mut self, at: usize, floor: i16, portion: Portion, chance: i16, marks: &mut Marks) -> Taking {
        let above = self.heights[at].saturating_sub(floor);
        if above <= 0 {
            return Taking::default();
        }
        marks.cells[at] = marks.round;
        let now = above.min(portion.whole + i16::from(portion.part > chance));
        if now == 0 {
            return Taking { met: true, ..Taking::default() };
        }
        self.heights[at] -= now;
        self.wake(at);
        if portion.denser == 0 {
            return Taking { amount: now.into(), loose: 0, met: true };
        }
        let packed = &mut self.packed[at];
        let part = |of: i32, parts: u16, chance: i16| (of * i32::from(parts) + 32_767 - i32::from(chance)) >> 16;
        let (chance, other) = (chance.wrapping_mul(OTHER), chance.wrapping_mul(OTHER).wrapping_mul(OTHER));
        let loose = part(now.into(), u16::from(255 - *packed) * 257, chance); // 255 · 257 = 2¹⁶ − 1
        *packed = (i32::from(*packed) + part(loose, portion.denser, other)).min(255) as u8;
        Taking { amount: now.into(), loose, met: true }
    }

    /// The same for `count` cells beside each other, which are in the lists from `at` on; the lists do not end before the last of them.
    /// `number`: number of the first of these cells in its row.
    #[inline(always)]
    fn cut_row<S: Shorts>(
        &mut self,
        at: usize,
        number: usize,
        count: usize,
        row: &CellRow<S>,
        marks: &mut Marks,
    ) -> Taking {
        let from = at.min(self.heights.len() - SHORTS);
        let skip = at - from;
        let order = S::of(&ORDER);
        let own = S::splat((skip + count) as i16).above(order).and(order.above(S::splat(skip as i16 - 1)));
        let numbers = order.plus(S::splat(number as i16 - skip as i16));
        let heights = S::load(&self.heights, from);
        let above = heights.less(row.floor.less(numbers.low_product(row.falls))).and(own);
        let met = above.above(S::splat(0));
        if !met.any() {
            return Taking::default();
        }
        let mark = S::load(&marks.cells, from);
        S::select(met, S::splat(marks.round), mark).store(&mut marks.cells, from);
        let chance = row.chance.plus(numbers.low_product(S::splat(EVENLY[0] as i16)));
        let most = S::splat(row.portion.whole).minus(S::splat(row.portion.part).above(chance));
        let now = above.and(met).min(most);
        let amount = now.sum();
        if amount == 0 {
            return Taking { met: true, ..Taking::default() };
        }
        heights.minus(now).store(&mut self.heights, from);
        self.wake(at);
        self.wake(at + count - 1);
        if row.portion.denser == 0 {
            return Taking { amount, loose: 0, met: true };
        }
        let bytes = self.packed[from..from + SHORTS].first_chunk_mut().expect("as long as that");
        let packed = S::of_bytes(bytes);
        let chance = chance.low_product(S::splat(OTHER));
        let loose = part(now, S::splat(255).minus(packed).low_product(S::splat(257)), chance);
        let denser = part(loose, S::splat(row.portion.denser as i16), chance.low_product(S::splat(OTHER)));
        packed.plus(denser.min(S::splat(255))).min(S::splat(255)).to_bytes(bytes);
        Taking { amount, loose: loose.sum(), met: true }
    }
}

/// Products with `parts` of 2⁻¹⁶, rounded up or down by chance.
#[inline(always)]
fn part<S: Shorts>(of: S, parts: S, chance: S) -> S {
    let up = of.low_product(parts).plus(S::splat(i16::MIN)).above(chance);
    of.high_product(parts).minus(up)
}

#[cfg(test)]
mod tests {
    use super::super::MemorySettings;
    use super::*;
    use crate::Medium;
    use rand::{Rng, SeedableRng};
    use rand_xoshiro::Xoshiro256PlusPlus;
    use sandgait_number::PlainShorts;

    /// `cut_row` does with each cell what `cut_one` does with a single cell, wherever the lists end. On average over the turns, a piece
    /// takes what it sweeps.
    #[test]
    fn rows_are_cells() {
        let medium = Medium::named("poppy-loose").unwrap();
        let s = MemorySettings::new(&medium, 0.01, 6, 0.04, None);
        let mut random = Xoshiro256PlusPlus::seed_from_u64(4);
        let [mut swept, mut taken] = [0.0; 2];
        for round in 0..2000 {
            let mut grid = Grid::new(s.cell, s.bits);
            grid.follow([random.random_range(-1.0..1.0), random.random_range(-1.0..1.0)]);
            grid.heights.iter_mut().for_each(|h| *h = random.random_range(-300..300));
            grid.packed.iter_mut().for_each(|p| *p = random.random());
            let mut marks = Marks::default();
            marks.begin(grid.heights.len());
            let (count, each) = (random.random_range(1..=16), random.random_range(0.0..40.0_f32));
            let corner = grid.cells().next().unwrap().0;
            let first = [corner[0] + random.random_range(0..48), corner[1] + random.random_range(0..64)];
            let (height, denser) = (random.random_range(-400.0..300.0_f32), random.random_range(0.0..0.2));
            let mut single = (grid.clone(), marks.clone(), Taking::default());
            for k in 0..count {
                let (portion, cell) = (Portion::new(each, denser), [first[0] + k, first[1]]);
                let at = grid.frame.index(cell).unwrap();
                let own = single.0.cut_one(at, floor(height), portion, chance(cell, round), &mut single.1);
                single.2.add(own);
            }
            let row = CellRow {
                floor: PlainShorts::splat(floor(height)),
                falls: PlainShorts::splat(0),
                chance: PlainShorts::splat(chance(first, round)),
                portion: Portion::new(each, denser),
            };
            let (at, count) = (grid.frame.index(first).unwrap(), count as usize);
            let beyond = (at + count).saturating_sub(grid.heights.len());
            let mut all = grid.cut_row(at, 0, count - beyond, &row, &mut marks);
            if beyond > 0 {
                all.add(grid.cut_row(0, count - beyond, beyond, &row, &mut marks));
            }
            assert_eq!(
                (grid.heights, grid.packed, marks.cells, all.amount, all.loose, all.met),
                (single.0.heights, single.0.packed, single.1.cells, single.2.amount, single.2.loose, single.2.met),
                "round {round}"
            );
            if height < -300.0 - each {
                swept += f64::from(each) * count as f64;
                taken += f64::from(all.amount);
            }
        }
        assert!(swept > 1e4 && (taken / swept - 1.0).abs() < 0.01, "{taken} of {swept}");
    }
}
