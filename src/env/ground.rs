//! Ground of HexapodTerrain that varies with position and keeps footprints.

use crate::sand::mechanism_laws::footprint;
use crate::sim::{Model, State};
use serde::{Deserialize, Serialize};

/// Number of patches after which their sand repeats. Our choice: by default they are at least 2.4 m long together, and
/// a robot turns back after at most 1.2 m.
pub const PATCHES: usize = 16;

/// Number of footprints that are kept; the oldest one is forgotten first. Our choice: some 80 strides of six legs.
const PRINTS: usize = 512;

/// An episode's ground, and the footprints on it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UsedGround {
    /// ζ of each patch relative to the medium's.
    pub zeta: Vec<f64>,
    /// Length of a patch along x [m]; patch 0 begins at x = 0.
    pub patch_length: f64,
    /// κ of mechanism `footprint`: on a footprint the stress is 1 − κ times that on fresh ground.
    pub footprint: f64,
    /// Distance from the start at which the command reverses [m], so that the robot is to walk back.
    pub turning_point: f64,
    /// Sign of x on the way out, the sign of the first command.
    pub outward: f64,
    /// Is the robot commanded to walk back to the start?
    pub returning: bool,
    /// The patch whose sand the engine uses.
    pub patch: usize,
    /// Where each leg that is in the sand entered it [m].
    pub standing: Vec<Option<[f64; 2]>>,
    /// Factor on the stress on each leg; 1 on fresh ground.
    pub footing: Vec<f64>,
    /// Footprints [m], oldest first.
    pub prints: Vec<[f64; 2]>,
}

/// Changes of the ground in a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Change {
    Nothing,
    /// The footing of some leg changed.
    Footing,
    /// The patch changed, and with it the sand.
    Patch,
    /// A push set the base's velocity along x and y [m/s].
    Push([f64; 2]),
}

impl UsedGround {
    /// Memory of the patches and of the most footprints [bytes].
    pub const LIST_BYTES: usize = PATCHES * size_of::<f64>() + PRINTS * size_of::<[f64; 2]>();

    /// For snapshots: can an episode of a robot with `legs` legs have reached this ground?
    pub fn is_sound(&self, legs: usize) -> bool {
        let number = |x: &f64| x.is_finite();
        // The bounds of ζ and of the length are wider than those of the options (`Randomize::quantities`).
        let points = self.prints.iter().chain(self.standing.iter().flatten()).flatten();
        self.zeta.len() == PATCHES
            && self.zeta.iter().all(|z| (1e-2..=1e2).contains(z))
            && self.patch_length >= 1e-2
            && self.patch < PATCHES
            && self.standing.len() == legs
            && self.footing.len() == legs
            && self.prints.len() <= PRINTS
            && points.chain(&self.footing).all(number)
            && [-1.0, 1.0].contains(&self.outward)
            && [self.patch_length, self.footprint, self.turning_point].iter().all(number)
    }

    /// The patch under `x` [m].
    fn patch_at(&self, x: f64) -> usize {
        (x / self.patch_length).floor().rem_euclid(PATCHES as f64) as usize
    }

    /// Reverses the command if the robot at `x` [m] has passed the turning point on the way out, or the start on the
    /// way back. Only distance in the commanded direction counts: a robot that moves the other way keeps its command.
    /// Returns whether the command was reversed.
    pub fn turned(&mut self, x: f64) -> bool {
        let out = x * self.outward;
        let turned = if self.returning { out < 0.0 } else { out > self.turning_point };
        self.returning ^= turned;
        turned
    }

    /// Updates the ground for the robot's present state.
    pub fn after_step(&mut self, model: &Model, state: &State) -> Change {
        let mut change = Change::Nothing;
        // Footprints that legs leave in this step have an effect from the next step on, so that the order of the legs does not matter.
        let mut left = Vec::new();
        for leg in 0..self.standing.len() {
            let [x, y, z] = model.tip(state, leg);
            match (z < 0.0, self.standing[leg]) {
                (true, None) => {
                    self.standing[leg] = Some([x, y]);
                    let footing = self.footing_at([x, y]);
                    if footing != self.footing[leg] {
                        (self.footing[leg], change) = (footing, Change::Footing);
                    }
                }
                (false, Some(print)) => {
                    self.standing[leg] = None;
                    left.push(print);
                }
                _ => (),
            }
        }
        // In this order the list never has room for more.
        self.prints.drain(..(self.prints.len() + left.len()).saturating_sub(PRINTS));
        self.prints.extend(left);
        let patch = self.patch_at(state.position[0]);
        if patch != self.patch {
            (self.patch, change) = (patch, Change::Patch);
        }
        change
    }

    /// Factor on the stress for a leg that enters the sand at `place` [m]; only the nearest footprint counts.
    fn footing_at(&self, place: [f64; 2]) -> f64 {
        if self.footprint == 0.0 {
            return 1.0;
        }
        let away = |p: &[f64; 2]| (p[0] - place[0]).hypot(p[1] - place[1]);
        let nearest = self.prints.iter().map(away).fold(f64::INFINITY, f64::min);
        footprint(self.footprint, 2, nearest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sand::Medium;
    use crate::sim::Robot;
    use crate::sim::model::Scene;

    fn ground(footprint: f64) -> UsedGround {
        UsedGround {
            zeta: vec![1.0; PATCHES],
            patch_length: 0.3,
            footprint,
            turning_point: 1.0,
            outward: 1.0,
            returning: false,
            patch: 0,
            standing: vec![None; 6],
            footing: vec![1.0; 6],
            prints: Vec::new(),
        }
    }

    /// All tips 1 cm in the sand at `x`, or all above it.
    fn at(model: &Model, x: f64, down: bool) -> State {
        let mut state = State::at_rest(0.0, &[0.0; 6]);
        state.position = [x, 0.0, model.standing_height(&state.angles) + if down { -0.01 } else { 0.01 }];
        state
    }

    fn model() -> Model {
        let robot = Robot::built_in("xplorer").unwrap();
        Model::new(&robot, &Scene::flat(Medium::named("poppy-loose").unwrap())).unwrap()
    }

    /// The middle leg meets the front leg's footprint. Ground without footprints is fresh, and a leg that stays where
    /// it is does not meet its own footprint.
    #[test]
    fn prints_are_found_again() {
        let (model, mut ground) = (model(), ground(0.5));
        assert_eq!(ground.after_step(&model, &at(&model, 0.0, true)), Change::Nothing);
        assert_eq!(ground.after_step(&model, &at(&model, 0.0, true)), Change::Nothing);
        assert_eq!(ground.after_step(&model, &at(&model, 0.03, false)), Change::Nothing);
        assert_eq!(ground.prints.len(), 6);
        // Legs are 6 cm apart along x, the middle ones 5 mm further out.
        assert_eq!(ground.after_step(&model, &at(&model, 0.06, true)), Change::Footing);
        let near = 1.0 - 0.5 * (-0.005_f64 / 0.03).exp();
        let fresh = 1.0 - 0.5 * (-0.06_f64 / 0.03).exp();
        for (leg, expected) in [fresh, near, near, fresh, near, near].into_iter().enumerate() {
            assert!((ground.footing[leg] - expected).abs() < 1e-9, "leg {leg}: {:?}", ground.footing);
        }
    }

    #[test]
    fn patches_go_on_both_ways() {
        let (model, mut ground) = (model(), ground(0.0));
        for (x, patch, change) in [
            (0.1, 0, Change::Nothing),
            (0.31, 1, Change::Patch),
            (0.59, 1, Change::Nothing),
            (-0.01, 15, Change::Patch),
            (4.81, 0, Change::Patch),
        ] {
            assert_eq!((ground.after_step(&model, &at(&model, x, false)), ground.patch), (change, patch), "{x}");
        }
    }

    /// The robot walks out and back twice, with either sign of the first command.
    #[test]
    fn robots_turn_round_at_both_ends() {
        for outward in [1.0, -1.0] {
            let mut ground = UsedGround { outward, ..ground(0.0) };
            let turns = [0.5, 1.1, 1.2, 0.1, -0.1, -0.2, -1.1, -0.5, 0.1, 1.1, 0.5].map(|x| ground.turned(x * outward));
            let expected = [false, true, false, false, true, false, false, false, false, true, false];
            assert_eq!(turns, expected, "outward {outward}");
        }
    }

    #[test]
    fn memory_is_bounded() {
        let (model, mut ground) = (model(), ground(0.5));
        for k in 0..1000 {
            ground.after_step(&model, &at(&model, 0.0, k % 2 == 0));
        }
        assert_eq!(ground.prints.len(), PRINTS);
        assert!(ground.is_sound(6) && !ground.is_sound(5));
    }
}
