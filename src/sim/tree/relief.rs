//! Ground that is not flat: a field of heights, smooth between its nodes.

use super::terrain::{Flat, Local, Surface};
use crate::error::{Error, Result, check_range};
use crate::number::{Real, Vec3};
use std::f64::consts::TAU;
use std::sync::Arc;

/// Steepest slope at which dry, loose sand rests [°]: [`crate::model::Scene::MAX_SLOPE_DEG`], where natural slopes of
/// dry sand end. Media have no limits of their own.
pub const REPOSE_DEG: f64 = 35.0;
/// Least and greatest number of nodes along a side: our choice. The spline takes three nodes, and 512 × 512 take 1 MiB.
const NODES: std::ops::RangeInclusive<f64> = 4.0..=512.0;
/// Least and greatest height of a node [m]: our choice, because higher ground has wrong units. `f32` has 0.01 mm there.
const HEIGHTS: std::ops::RangeInclusive<f64> = -100.0..=100.0;
/// Number of waves whose sum makes dunes: our choice, because with these no direction dominates.
const WAVES: usize = 24;
/// Number of nodes along a side of a field of dunes; the second constant is the number of nodes in a wavelength. Our
/// choice: dunes then repeat after eight wavelengths.
const SIDE: usize = 128;
const A_WAVE: f64 = 16.0;
/// Largest number of nodes along a side that a page draws: our choice; the page then needs some 100 kB for them.
const DRAWN: usize = 128;

/// Heights on a square grid; the surface is the quadratic B-spline over them, so its normal changes without a jump.
#[derive(Clone, Debug, PartialEq)]
pub struct Relief {
    /// Between nodes [m].
    spacing: f64,
    /// Rows along y, columns along x.
    rows: usize,
    columns: usize,
    /// Row by row [m].
    heights: Vec<f32>,
    /// Does the field repeat beyond its edges? Otherwise the surface continues there at the height of the edge.
    repeats: bool,
    /// The field as JSON for pages, with at most [`DRAWN`] nodes along a side.
    json: String,
}

impl Relief {
    /// Distances between nodes, and wavelengths of dunes [m]: our choice, from prints to hills.
    pub const SPACING: std::ops::RangeInclusive<f64> = 1e-3..=100.0;
    pub const WAVELENGTH: std::ops::RangeInclusive<f64> = 0.1..=100.0;

    /// [bytes]
    pub fn memory_bytes(&self) -> usize {
        size_of_val(&self.heights[..]) + self.json.len()
    }

    /// The node of row 0 and column 0 is at x = y = 0.
    pub fn new(spacing: f64, rows: &[Vec<f64>]) -> Result<Self> {
        check_range("relief.spacing", spacing, Self::SPACING)?;
        let columns = rows.first().map_or(0, Vec::len);
        check_range("relief.heights: rows", rows.len() as f64, NODES)?;
        check_range("relief.heights: columns", columns as f64, NODES)?;
        if let Some((k, row)) = rows.iter().enumerate().find(|(_, row)| row.len() != columns) {
            let reason = format!("row {} has {} numbers, the first {columns}", k + 1, row.len());
            return Err(Error::invalid("relief.heights", reason));
        }
        rows.iter().flatten().try_for_each(|h| check_range("relief.heights", *h, HEIGHTS).map(drop))?;
        let heights = rows.iter().flatten().map(|h| *h as f32).collect();
        let relief = Self { spacing, rows: rows.len(), columns, heights, repeats: false, json: String::new() };
        Ok(relief.finished())
    }

    /// Random dunes: waves of about `wavelength` [m] in all directions, `slope_deg` at the steepest point. They
    /// repeat after eight wave lengths.
    pub fn dunes(seed: u64, wavelength: f64, slope_deg: f64) -> Result<Self> {
        check_range("relief.wavelength", wavelength, Self::WAVELENGTH)?;
        check_range("relief.slope_deg", slope_deg, 0.0..=REPOSE_DEG)?;
        let mut draw = SplitMix64(seed);
        let whole = SIDE as f64 / A_WAVE;
        let waves: Vec<[f64; 3]> = (0..WAVES)
            .map(|_| {
                let (angle, length) = (TAU * draw.next(), 0.5 + draw.next());
                // Each wave has a whole number of periods, so the dunes repeat.
                let [x, y] = [angle.cos(), angle.sin()].map(|part| (whole * length * part).round());
                [x, y, TAU * draw.next()]
            })
            .filter(|[x, y, _]| x.hypot(*y) > 0.0)
            .collect();
        let height = |i: usize| {
            let (x, y) = ((i % SIDE) as f64 / SIDE as f64, (i / SIDE) as f64 / SIDE as f64);
            waves.iter().map(|[a, b, phase]| (TAU * (a * x + b * y) + phase).sin() / a.hypot(*b)).sum::<f64>() as f32
        };
        let heights = (0..SIDE * SIDE).map(height).collect();
        let (spacing, json) = (wavelength / A_WAVE, String::new());
        let mut dunes = Self { spacing, rows: SIDE, columns: SIDE, heights, repeats: true, json };
        let scale = slope_deg.to_radians().tan() / dunes.steepest().0.max(1e-9);
        dunes.heights.iter_mut().for_each(|h| *h = (f64::from(*h) * scale) as f32);
        Ok(dunes.finished())
    }

    /// Fills in the JSON, of every node or of every second, third, … one; heights are rounded to 0.1 mm.
    fn finished(mut self) -> Self {
        let by = self.rows.max(self.columns).div_ceil(DRAWN);
        let [rows, columns] = [self.rows, self.columns].map(|n| n.div_ceil(by));
        let height = |j: usize, i: usize| (f64::from(self.heights[j * by * self.columns + i * by]) * 1e4).round() / 1e4;
        let heights: Vec<Vec<f64>> = (0..rows).map(|j| (0..columns).map(|i| height(j, i)).collect()).collect();
        let (spacing, repeats) = (self.spacing * by as f64, self.repeats);
        self.json = serde_json::json!({"spacing": spacing, "repeats": repeats, "heights": heights}).to_string();
        self
    }

    /// `spacing` [m], `repeats`, and `heights` [m]: rows along y of numbers along x.
    pub fn json(&self) -> &str {
        &self.json
    }

    /// Length and width of the field [m].
    pub fn size(&self) -> [f64; 2] {
        [self.columns, self.rows].map(|n| n as f64 * self.spacing)
    }

    /// Tangent of the steepest slope, and its position [m]. Only nodes and the points half way between them are
    /// evaluated. Between these the slope may be a few percent steeper.
    pub fn steepest(&self) -> (f64, [f64; 2]) {
        let half = self.spacing / 2.0;
        let places = (0..4 * self.rows * self.columns)
            .map(|i| [(i % (2 * self.columns)) as f64 * half, (i / (2 * self.columns)) as f64 * half]);
        places.fold((0.0, [0.0; 2]), |best, at| {
            let [gx, gy] = self.at(at[0], at[1]).1;
            let slope = gx.hypot(gy);
            if slope > best.0 { (slope, at) } else { best }
        })
    }

    /// Refuses slopes at which loose sand does not rest.
    pub fn check_repose(&self) -> Result<()> {
        let (slope, [x, y]) = self.steepest();
        let degrees = slope.atan().to_degrees();
        if degrees <= REPOSE_DEG + 1e-6 {
            return Ok(());
        }
        let reason = format!(
            "at x = {x:.2} m, y = {y:.2} m it is {degrees:.1}° steep; loose sand rests at {REPOSE_DEG}° at most"
        );
        Err(Error::invalid("relief", reason))
    }

    /// Height [m], and its derivatives along x and y.
    #[inline]
    pub fn at(&self, x: f64, y: f64) -> (f64, [f64; 2]) {
        let along = |x: f64, count: usize| {
            // The clamp keeps node indices within the range of integers.
            let u = (x / self.spacing).clamp(-1e15, 1e15);
            let node = u.round();
            let t = u - node;
            let [low, high] = [0.5 - t, 0.5 + t];
            let index = |k: i64| {
                let k = (node as i64).saturating_add(k);
                let last = count as i64 - 1;
                if self.repeats { k.rem_euclid(count as i64) as usize } else { k.clamp(0, last) as usize }
            };
            (
                [index(-1), index(0), index(1)],
                [0.5 * low * low, 0.75 - t * t, 0.5 * high * high],
                [-low, -2.0 * t, high],
            )
        };
        let (columns, wx, dx) = along(x, self.columns);
        let (rows, wy, dy) = along(y, self.rows);
        let (mut height, mut slope) = (0.0, [0.0; 2]);
        for j in 0..3 {
            let row = rows[j] * self.columns;
            let h = columns.map(|c| f64::from(self.heights[row + c]));
            let value = h[0] * wx[0] + h[1] * wx[1] + h[2] * wx[2];
            height += wy[j] * value;
            slope[0] += wy[j] * (h[0] * dx[0] + h[1] * dx[1] + h[2] * dx[2]);
            slope[1] += dy[j] * value;
        }
        (height, slope.map(|s| s / self.spacing))
    }
}

/// Numbers in [0, 1), the same on every machine (SplitMix64, Steele, Lea & Flood 2014).
struct SplitMix64(u64);

impl SplitMix64 {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// A relief in each lane.
pub struct LaneRelief(pub Vec<Arc<Relief>>);

/// None is level ground. One type serves for both cases, so that the step is compiled only once.
impl<R: Real> Surface<R> for Option<LaneRelief> {
    #[inline(always)]
    fn is_flat(&self) -> bool {
        self.is_none()
    }

    #[inline(always)]
    fn under(&self, p: Vec3<R>) -> Local<R> {
        match self {
            None => Flat.under(p),
            Some(reliefs) => reliefs.under(p),
        }
    }
}

impl LaneRelief {
    #[inline(never)]
    fn under<R: Real>(&self, p: Vec3<R>) -> Local<R> {
        let mut local = Local { point: p, normal: Vec3::zero() };
        for (lane, relief) in self.0.iter().enumerate() {
            let [x, y, _] = p.lane(lane);
            let (height, [gx, gy]) = relief.at(x, y);
            let length = (gx * gx + gy * gy + 1.0).sqrt();
            local.point.z.set_lane(lane, height);
            local.normal.set_lane(lane, [-gx / length, -gy / length, 1.0 / length]);
        }
        local
    }
}
