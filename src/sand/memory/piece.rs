//! Pieces of a body's surface that move sand.

use super::grid::GridFrame;
use super::settings::CLEARING;
use sandgait_number::{Real, Vec3};

/// A piece of a body's surface.
#[derive(Clone, Copy, Debug)]
pub struct SurfacePiece {
    /// Place in the world [m].
    pub place: [f64; 3],
    /// Unit normal of the leading side.
    pub normal: [f64; 3],
    /// [m²]
    pub area: f64,
    /// Velocity [m/s].
    pub velocity: [f64; 3],
    /// Cells along each side of the square that it covers, from 1 to [`MOST_CELLS`].
    pub cells: u8,
}

/// Most cells along a side of a piece's square: the lanes of a vector ([`sandgait_number::SHORTS`]).
pub const MOST_CELLS: u8 = 16;

/// The same in the units of a grid.
#[derive(Clone, Copy, Debug)]
pub struct GridPiece {
    /// The cell that contains the piece's middle, and the first cell of the piece's square.
    pub cell: [i32; 2],
    pub first: [i32; 2],
    /// Cells along each side of its square.
    pub cells: u8,
    /// Among its body's pieces.
    pub number: u16,
    /// How much it falls from cell to cell along x and y [steps of the grid].
    pub falls: [f32; 2],
    /// Place from the body's origin [cells].
    pub place: [f32; 2],
    /// Height [steps of the grid].
    pub height: f32,
    pub normal: [f32; 3],
    /// [m²]
    pub area: f32,
    /// Along x and y [m/s].
    pub velocity: [f32; 2],
    /// What the piece takes out of each of its cells [steps/s]: see [`swept`].
    pub rate: f32,
}

impl SurfacePiece {
    /// On the grid, with the body's origin in this cell. `number`: among its body's pieces.
    pub fn on(&self, number: u16, grid: &GridFrame, origin: [i32; 2]) -> GridPiece {
        let [x, y, z] = self.place;
        let half = 0.5 * f64::from(self.cells - 1) * grid.cell;
        GridPiece {
            cell: grid.cell_at([x, y]),
            first: grid.cell_at([x - half, y - half]),
            cells: self.cells,
            number,
            falls: [0.0; 2],
            place: [x / grid.cell - f64::from(origin[0]), y / grid.cell - f64::from(origin[1])].map(|c| c as f32),
            height: (z / grid.quantum()) as f32,
            normal: self.normal.map(|n| n as f32),
            area: self.area as f32,
            velocity: [self.velocity[0], self.velocity[1]].map(|v| v as f32),
            rate: swept(Vec3::splat(self.normal), Vec3::splat(self.velocity), self.area, self.cells, grid) as f32,
        }
    }
}

/// What a piece takes out of each of its cells [steps/s]: the volume that it sweeps, without sand that it only lifts. A
/// piece that pushes sideways takes more, to keep its cell empty (`CLEARING`).
#[inline(always)]
pub fn swept<R: Real>(normal: Vec3<R>, velocity: Vec3<R>, area: R, cells: u8, grid: &GridFrame) -> R {
    let lifted = normal.z.max(R::zero()) * velocity.z.max(R::zero());
    let volume = area * (normal.dot(velocity) - lifted).max(R::zero());
    let sideways = normal.x * normal.x + normal.y * normal.y;
    let clearing = sideways.mul_add(R::splat(CLEARING - 1.0), R::one());
    let side = f64::from(cells) * grid.cell;
    clearing * volume * R::splat(1.0 / (side * side * grid.quantum()))
}
