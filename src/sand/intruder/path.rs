//! A body that moves on a path over sand that remembers: row by row in time.

use super::passing::Passing;
use super::trials::{DepthOrLoad, Status, Trial, TrialOutcome, check_all, compute_with};
use super::{IntruderPlate, PlatedBody};
use crate::SandDescription;
use crate::error::{Error, Result, check_range};
use crate::memory::{Marks, MemorySettings, Moved, PAIRS, SurfacePiece};
use crate::number::{PlainShorts, Vec3};

/// Cells along a side of a path's square, as a power of two: 256. Our choice, the most that a grid can have.
const BITS: u32 = 8;
/// Cells along a body's longest horizontal side: our choice, because with twice as many the forces on the plates of the
/// simulated grains change by less than 5 %.
const CELLS: f64 = 10.0;
/// Largest number of consecutive sweeps in which sand slides: our choice, a bound on the time of a row.
const MOST_SWEEPS: usize = 200;

/// A moment of a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathPoint {
    /// [s]
    pub time: f64,
    /// Position of the body's origin along x and y [m]; None: it follows from the last row's position and the velocities since then.
    pub place: Option<[f64; 2]>,
    pub trial: Trial,
}

/// Sand and body on a path.
pub struct Path<'a> {
    body: &'a PlatedBody,
    sand: &'a SandDescription,
    settings: MemorySettings,
    pub moved: Moved,
    marks: Marks,
    last: Option<Last>,
    /// Time for which the sand has not slid yet [s].
    sliding: f64,
    /// What earlier motions have left on the plates, if the size of the grains is known.
    passing: Option<Passing>,
}

struct Last {
    moment: PathPoint,
    place: [f64; 2],
    /// Height of the lowest point [m].
    low: f64,
}

impl<'a> Path<'a> {
    /// `repose_deg`: angle of repose of the sand [°]; None: the medium's. The bounds catch wrong units: our choice.
    pub fn new(
        body: &'a PlatedBody,
        sand: &'a SandDescription,
        repose_deg: Option<f64>,
        cell: Option<f64>,
    ) -> Result<Self> {
        repose_deg.map(|deg| check_range("repose-deg", deg, 5.0..=60.0)).transpose()?;
        let cell = match cell {
            Some(cell) => check_range("cell", cell, 1e-4..=1.0)?,
            None => widest(body) / CELLS,
        };
        let settings = MemorySettings {
            pairs: PAIRS,
            ..MemorySettings::new(&sand.medium(), cell, BITS, widest(body), repose_deg)
        };
        let moved = Moved::new(&settings, 1);
        Ok(Self { body, sand, settings, moved, marks: Marks::default(), last: None, sliding: 0.0, passing: None })
    }

    /// The same in grains of this diameter [m]: with `sliding_face`, the stress of a motion passes over some 1.5
    /// diameters of the next.
    pub fn in_grains(mut self, diameter: f64) -> Result<Self> {
        self.passing = Some(Passing::new(self.sand, diameter)?);
        Ok(self)
    }

    /// Moves the body to the next moment, and returns the force there.
    pub fn step(&mut self, moment: &PathPoint) -> TrialOutcome {
        let since = self.last.as_ref().map_or(0.0, |last| moment.time - last.moment.time);
        if let Some(passing) = &mut self.passing {
            passing.advance(self.body, self.sand, &moment.trial, since);
        }
        let outcome = self.move_to(moment);
        if let Some(passing) = &mut self.passing {
            let level = f64::from(self.moved.found[0].level);
            let low = self.last.as_ref().map_or(level, |last| last.low);
            passing.leave(self.body, level - low + self.body.heights()[0]);
        }
        outcome
    }

    fn move_to(&mut self, moment: &PathPoint) -> TrialOutcome {
        let Some(last) = self.last.take() else {
            let place = moment.place.unwrap_or_default();
            let low = self.force(&moment.trial).1;
            self.moved.grid.follow(place);
            // A body that begins in the sand finds level sand.
            self.sweep(place, place, low, low, 0.0, &moment.trial);
            self.last = Some(Last { moment: *moment, place, low });
            return self.force(&moment.trial).0;
        };
        let time = moment.time - last.moment.time;
        let drift = [0, 1].map(|k| last.place[k] + last.moment.trial.velocity[k] * time);
        let place = moment.place.unwrap_or(drift);
        let (_, mut low) = self.force(&moment.trial);
        // Divides the way into parts of at most half a cell, so that the body skips no cell; it moves sand in each
        // part. 10⁴ parts bound the time: our choice.
        let way = (place[0] - last.place[0]).hypot(place[1] - last.place[1]).max((low - last.low).abs());
        let parts = (way / (0.5 * self.settings.cell)).ceil().clamp(1.0, 1e4) as usize;
        let mut at = (last.place, last.low);
        for k in 1..=parts {
            let share = k as f64 / parts as f64;
            let mix = |a: f64, b: f64| a + (b - a) * share;
            let next = [0, 1].map(|k| mix(last.place[k], place[k]));
            if matches!(moment.trial.given, DepthOrLoad::Load(_)) && k > 1 {
                low = self.force(&moment.trial).1;
            }
            let height = if matches!(moment.trial.given, DepthOrLoad::Load(_)) { low } else { mix(last.low, low) };
            self.sweep(at.0, next, at.1, height, time / parts as f64, &moment.trial);
            at = (next, height);
        }
        let (outcome, low) = self.force(&moment.trial);
        self.last = Some(Last { moment: *moment, place, low });
        outcome
    }

    /// Lets the sand slide until it rests.
    pub fn settle(&mut self) {
        (0..MOST_SWEEPS).for_each(|_| self.moved.grid.slide::<PlainShorts>(self.settings.repose));
    }

    /// The force on the body in the sand as it now is, and the height of the body's lowest point.
    fn force(&self, trial: &Trial) -> (TrialOutcome, f64) {
        let found = self.moved.found[0];
        let strength = self.settings.strength(&found);
        let level = f64::from(found.level);
        let given = match trial.given {
            DepthOrLoad::Depth(depth) if found.inside => DepthOrLoad::Depth(depth + level),
            DepthOrLoad::Depth(depth) => DepthOrLoad::Depth((depth + level).min(0.0)),
            DepthOrLoad::Load(load) => DepthOrLoad::Load(load / strength),
        };
        let left = self.passing.as_ref().map_or(&[][..], |passing| &passing.excess);
        let mut outcome = compute_with(self.body, self.sand, &Trial { given, ..*trial }, left);
        let low = if outcome.status == Status::Ok { level - outcome.depth } else { level };
        outcome.force = outcome.force.map(|f| f * strength);
        outcome.torque = outcome.torque.map(|t| t * strength);
        if let DepthOrLoad::Depth(depth) = trial.given {
            outcome.depth = depth;
            return (outcome, -depth);
        }
        outcome.depth = -low;
        (outcome, low)
    }

    fn sweep(&mut self, from: [f64; 2], to: [f64; 2], low: f64, height: f64, time: f64, trial: &Trial) {
        let way = [to[0] - from[0], to[1] - from[1], height - low];
        let rate = if time > 0.0 { 1.0 / time } else { 0.0 };
        let velocity = Vec3::<f64>::splat(way.map(|w| w * rate));
        let (spin, origin) = (Vec3::<f64>::splat(trial.spin), height - self.body.heights()[0]);
        self.moved.grid.follow(to);
        let piece = |p: &IntruderPlate| {
            let v = velocity + spin.cross(p.center);
            let [x, y, z] = p.center.lane(0);
            // If the body does not move, n·v is 0, so no piece is left out.
            (p.normal.dot(v) >= 0.0).then(|| SurfacePiece {
                place: [to[0] + x, to[1] + y, origin + z],
                normal: p.normal.lane(0),
                area: p.area,
                velocity: v.lane(0),
                // Sand beside a body slides toward it. With 1 in place of 2, furrows are 1 mm narrower and shallower
                // than in simulated grains.
                cells: 2,
            })
        };
        let pieces: Vec<SurfacePiece> = self.body.plates.iter().filter_map(piece).collect();
        self.moved.push(&self.settings, 0, &pieces, [way[0], way[1]], time, &mut self.marks);
        self.sliding += time;
        let sweep = self.settings.sweep;
        let sweeps = ((self.sliding / sweep) as usize).min(MOST_SWEEPS);
        self.sliding -= sweeps as f64 * sweep;
        self.sliding = self.sliding.min(sweep);
        (0..sweeps).for_each(|_| self.moved.grid.slide::<PlainShorts>(self.settings.repose));
    }
}

/// The body's longest horizontal side [m], at least the least length of a body.
fn widest(body: &PlatedBody) -> f64 {
    let extent = |k: usize| {
        let along = body.plates.iter().map(|p| p.center.lane(0)[k]);
        let [low, high] = along.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], x| [a.min(x), b.max(x)]);
        high - low
    };
    extent(0).max(extent(1)).max(1e-4)
}

/// Refuses paths that cannot be followed. The bounds catch wrong units: our choice.
pub fn check(body: &PlatedBody, sand: &SandDescription, moments: &[PathPoint]) -> Result<()> {
    let trials: Vec<Trial> = moments.iter().map(|m| m.trial).collect();
    check_all(sand, &trials)?;
    let turns = |m: &&PathPoint| {
        let spin = Vec3::<f64>::splat(m.trial.spin);
        let rate = spin.norm_squared().sqrt();
        rate > 0.0 && !body.is_round_about(spin * (1.0 / rate))
    };
    if moments.iter().find(turns).is_some() {
        let reason = "with memory a body may turn only if it is round about that axis";
        return Err(Error::invalid("spin", reason));
    }
    for m in moments {
        check_range("t", m.time, -1e6..=1e6)?;
        for place in m.place.into_iter().flatten() {
            check_range("x, y", place, -1e3..=1e3)?;
        }
    }
    match moments.windows(2).position(|m| m[1].time < m[0].time) {
        Some(k) => Err(Error::invalid(format!("row {} of a path", k + 2), "its t is before that of the row above")),
        None => Ok(()),
    }
}
