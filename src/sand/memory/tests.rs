//! Passes over used sand against simulated grains (`tests/data/memory`), and laws that hold for any motion.

#[path = "../../../tests/testbed/long.rs"]
mod long;

mod fresh;

use super::*;
use crate::Medium;
use crate::SandDescription;
use crate::intruder::path::{Path, PathPoint};
use crate::intruder::{BodyShape, DepthOrLoad, PlatedBody, Trial, TrialOutcome, compute};
use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

const PLATE_DOWN: &str = "box:length=0.006,width=0.025,height=0.038";
const PLATE_FLAT: &str = "box:length=0.038,width=0.025,height=0.006";

fn table(text: &str) -> Vec<Vec<f64>> {
    text.lines().skip(1).map(|l| l.split(',').map(|c| c.parse().unwrap()).collect()).collect()
}

fn sand() -> SandDescription {
    SandDescription::named("glass-beads", "li2013").unwrap()
}

fn body(shape: &str) -> PlatedBody {
    PlatedBody::cut(&BodyShape::named(shape).unwrap(), Some(0.0015)).unwrap()
}

/// Measured rows (pass, t, x, z, vx, vz, Fx, Fz) with the model's force on the same path.
struct Passes {
    rows: Vec<(Vec<f64>, TrialOutcome)>,
    /// Rms difference of the heights after each pass [mm].
    heights: Vec<f64>,
}

fn run(shape: &str, rows: &str, surface: &str, repose: Option<f64>, cell: Option<f64>) -> Passes {
    let (sand, body) = (sand(), body(shape));
    let mut path = Path::new(&body, &sand, repose, cell).unwrap();
    let (grains, mut heights, mut done) = (table(surface), Vec::new(), Vec::new());
    let rows = table(rows);
    for pass in [1.0, 2.0, 3.0] {
        for row in rows.iter().filter(|r| r[0] == pass) {
            let trial = Trial { velocity: [row[4], 0.0, row[5]], spin: [0.0; 3], given: DepthOrLoad::Depth(-row[3]) };
            let moment = PathPoint { time: 10.0 * pass + row[1], place: Some([row[2], 0.0]), trial };
            done.push((row.clone(), path.step(&moment)));
        }
        path.settle();
        let grid = &path.moved.grid;
        // Grains that lie on the plate, which was drawn out, are no surface.
        let of_pass = grains.iter().filter(|r| r[0] == pass && r[3].abs() < 0.025);
        let squares: Vec<f64> =
            of_pass.map(|r| (grid.height(grid.frame.cell_at([r[1], r[2]])) - r[3]).powi(2)).collect();
        heights.push(1e3 * (squares.iter().sum::<f64>() / squares.len() as f64).sqrt());
    }
    Passes { rows: done, heights }
}

fn plough(repose: Option<f64>, cell: Option<f64>) -> Passes {
    let rows = include_str!("../../../tests/data/memory/plough.csv");
    run(PLATE_DOWN, rows, include_str!("../../../tests/data/memory/plough_surface.csv"), repose, cell)
}

fn press(repose: Option<f64>, cell: Option<f64>) -> Passes {
    let rows = include_str!("../../../tests/data/memory/press.csv");
    run(PLATE_FLAT, rows, include_str!("../../../tests/data/memory/press_surface.csv"), repose, cell)
}

impl Passes {
    /// Mean of the grains' and the model's force along `axis` in some rows.
    fn mean(&self, axis: usize, keep: impl Fn(&[f64]) -> bool) -> [f64; 2] {
        let kept: Vec<_> = self.rows.iter().filter(|(r, _)| keep(r)).collect();
        let count = kept.len() as f64;
        let grains = kept.iter().map(|(r, _)| r[6 + axis / 2]).sum::<f64>() / count;
        [grains, kept.iter().map(|(_, o)| o.force[axis]).sum::<f64>() / count]
    }

    /// Drag in a third of the furrow over that of the first pass: of the grains and of the model.
    fn furrow(&self, pass: f64, third: usize) -> [f64; 2] {
        let edges = [-0.0501, -0.0167, 0.0167, 0.0501];
        let drag =
            |pass: f64| self.mean(0, |r| r[0] == pass && r[4] > 0.1 && r[2] > edges[third] && r[2] <= edges[third + 1]);
        let ([grains, model], [first, model_first]) = (drag(pass), drag(1.0));
        [grains / first, model / model_first]
    }

    /// Force at a depth over that of the first pass.
    fn pressed(&self, pass: f64, depth: f64) -> [f64; 2] {
        let force = |pass: f64| self.mean(2, |r| r[0] == pass && r[5] < -0.05 && (r[3] + depth).abs() < 0.0006);
        let ([grains, model], [first, model_first]) = (force(pass), force(1.0));
        [grains / first, model / model_first]
    }
}

/// In each third of the furrow, the drag of the second and third pass over that of the first is within 0.25 of the
/// grains' ratio; heights are within 4 mm rms. A single reading of the grains scatters by 1.8 mm about its neighbours.
#[test]
fn a_plate_ploughs_its_furrow_again_as_in_grains() {
    let passes = plough(None, None);
    for pass in [2.0, 3.0] {
        for third in 0..3 {
            let [grains, model] = passes.furrow(pass, third);
            assert!((grains - model).abs() < 0.25, "pass {pass}, third {third}: {model:.2}, grains {grains:.2}");
        }
    }
    assert!(passes.heights.iter().all(|h| *h < 4.0), "{:?}", passes.heights);
}

/// The second press into a print, and one beside it. Here a reading of the grains scatters by 2.5 mm about its
/// neighbours, and sand far from the print reads 3.8 mm below zero, so 4 mm are not reached.
#[test]
fn a_foot_presses_its_print_again_as_in_grains() {
    let passes = press(None, None);
    // Deeper than 25 mm the third press of the grains jumps by a third from one millimetre to the next.
    for depth in [0.005, 0.01, 0.02] {
        for pass in [2.0, 3.0] {
            let [grains, model] = passes.pressed(pass, depth);
            assert!((grains - model).abs() < 0.25, "pass {pass}, {depth} m: {model:.2}, grains {grains:.2}");
        }
    }
    assert!(passes.heights.iter().all(|h| *h < 4.7), "{:?}", passes.heights);
}

/// The figures of docs/memory.md.
#[test]
fn figures_of_both_experiments() {
    for repose in [None, Some(REPOSE_DEG)] {
        let (furrow, print) = (plough(repose, None), press(repose, None));
        let ratios = |pass| [0, 1, 2].map(|third| furrow.furrow(pass, third));
        let presses = |pass| [0.005, 0.01, 0.02].map(|depth| print.pressed(pass, depth));
        println!("{repose:?}: furrow {:.2?} {:.2?}, heights {:.1?} mm", ratios(2.0), ratios(3.0), furrow.heights);
        println!("{repose:?}: print {:.2?} {:.2?}, heights {:.1?} mm", presses(2.0), presses(3.0), print.heights);
        let worst = |of: &[[f64; 2]]| of.iter().map(|[grains, model]| (grains - model).abs()).fold(0.0, f64::max);
        assert!(worst(&ratios(2.0)).max(worst(&ratios(3.0))) < 0.25 && worst(&presses(2.0)) < 0.3);
    }
}

/// The ratios do not hang on the angle of repose or the cells' size.
#[test]
fn other_angles_and_cells_change_little() {
    let (usual, usual_press) = (plough(None, None), press(None, None));
    let finer = [plough(None, Some(0.0019)), plough(Some(22.0), None), plough(Some(28.0), None)];
    for other in finer {
        for (pass, third) in [2.0, 3.0].into_iter().flat_map(|p| [0, 1, 2].map(|t| (p, t))) {
            let [[_, a], [_, b]] = [&usual, &other].map(|p| p.furrow(pass, third));
            assert!((a - b).abs() < 0.2, "pass {pass}, third {third}: {a:.2} and {b:.2}");
        }
    }
    for other in [press(None, Some(0.0028)), press(Some(22.0), None), press(Some(28.0), None)] {
        for depth in [0.01, 0.02] {
            let [[_, a], [_, b]] = [&usual_press, &other].map(|p| p.pressed(2.0, depth));
            assert!((a - b).abs() < 0.25, "{depth} m: {a:.2} and {b:.2}");
        }
    }
}

/// A body that goes straight down into fresh sand feels what the theory says, at any speed.
#[test]
fn fresh_sand_is_the_theory() {
    let sand = sand();
    for shape in [PLATE_FLAT, "sphere:radius=0.02", "cylinder:radius=0.03,width=0.02"] {
        let body = body(shape);
        for speed in [0.01, 0.5] {
            let mut path = Path::new(&body, &sand, Some(30.0), None).unwrap();
            for k in 0..40 {
                let depth = -0.002 + 0.0005 * f64::from(k);
                let trial = Trial { velocity: [0.0, 0.0, -speed], spin: [0.0; 3], given: DepthOrLoad::Depth(depth) };
                let time = 0.0005 * f64::from(k) / speed;
                let [with, without] =
                    [path.step(&PathPoint { time, place: None, trial }), compute(&body, &sand, &trial)]
                        .map(|o| o.force[2]);
                assert!((with - without).abs() <= 1e-6 * without.max(1.0), "{shape}, {depth}: {with} {without}");
            }
        }
    }
}

fn settings(random: &mut impl Rng, gain: f64) -> MemorySettings {
    let medium = Medium::named("poppy-loose").unwrap();
    let cell = random.random_range(0.002..0.01);
    let pairs = random.random_range(1..=PAIRS);
    let size = random.random_range(0.01..0.05);
    MemorySettings { gain, pairs, ..MemorySettings::new(&medium, cell, 6, size, Some(random.random_range(15.0..40.0))) }
}

/// A body of random pieces around a place.
fn pieces(random: &mut impl Rng, place: [f64; 3], velocity: [f64; 3], size: f64) -> Vec<SurfacePiece> {
    let count = random.random_range(1..30);
    let mut one = || {
        let mut draw = || random.random_range(-1.0_f64..1.0);
        let n = [draw(), draw(), draw()];
        let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt().max(1e-3);
        let at = [draw(), draw(), draw()];
        let place = std::array::from_fn(|k| place[k] + 0.5 * size * at[k]);
        SurfacePiece {
            place,
            normal: n.map(|c| c / length),
            area: 0.1 * size * size,
            velocity,
            cells: 1 + (at[0] > 0.5) as u8,
        }
    };
    (0..count).map(|_| one()).collect()
}

fn sum(moved: &Moved) -> i64 {
    moved.grid.heights.iter().map(|h| i64::from(*h)).sum()
}

fn energy(moved: &Moved) -> i64 {
    moved.grid.heights.iter().map(|h| i64::from(*h).pow(2)).sum()
}

/// Any motion conserves the volume to the last step of the heights; with compaction it only falls. Sliding only lowers
/// the potential energy. Everything stays finite.
#[test]
fn volume_stays_and_sliding_dissipates() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(11);
    let (mut swept, mut slid) = (0, 0);
    for round in 0..300 {
        let loose = round % 2 == 1;
        let s = settings(&mut random, if loose { 1.8 } else { 1.0 });
        let (mut moved, mut marks) = (Moved::new(&s, 1), Marks::default());
        let mut place = [0.0, 0.0, 0.01];
        for _ in 0..100 {
            let mut draw = |most: f64| random.random_range(-most..most);
            let velocity = [draw(0.5), draw(0.5), draw(0.5)];
            let time = 0.005;
            place = std::array::from_fn(|k| (place[k] + velocity[k] * time).clamp(-8.0 * s.cell, 8.0 * s.cell));
            let body = pieces(&mut random, place, velocity, 6.0 * s.cell);
            let (before, heights) = (sum(&moved), moved.grid.heights.clone());
            moved.push(&s, 0, &body, [velocity[0] * time, velocity[1] * time], time, &mut marks);
            let after = sum(&moved);
            assert!(after == before || (loose && after < before), "round {round}: {before} {after}");
            swept += i64::from(heights != moved.grid.heights);
            let LocalSand { level, packed, size, .. } = moved.found[0];
            assert!(level.is_finite() && size.is_finite() && (0.0..=1.0).contains(&packed));
            let rough = energy(&moved);
            moved.grid.slide::<PlainShorts>(s.repose);
            assert!(sum(&moved) == after && energy(&moved) <= rough, "round {round}");
            slid += i64::from(energy(&moved) < rough);
        }
        assert!(loose || moved.grid.volume().abs() < 1e-15, "round {round}: {}", moved.grid.volume());
    }
    assert!(swept > 10_000 && slid > 10_000, "{swept} {slid}");
}

/// A plate as large as the whole square leaves no free place, and still no sand is lost.
#[test]
fn sand_below_a_plate_of_the_whole_square_stays() {
    let medium = Medium::named("poppy-loose").unwrap();
    let s = MemorySettings { gain: 1.0, pairs: PAIRS, ..MemorySettings::new(&medium, 0.005, 6, 0.02, None) };
    let (mut moved, mut marks) = (Moved::new(&s, 1), Marks::default());
    let place = |k: usize| (k as f64 - 31.5) * s.cell;
    let cells = (0..64).flat_map(|i| (0..64).map(move |k| [i, k]));
    let plate: Vec<_> = cells
        .map(|[i, k]| SurfacePiece {
            place: [place(i), place(k), -0.01],
            normal: [0.0, 0.0, -1.0],
            area: s.cell * s.cell,
            velocity: [0.0, 0.0, -0.1],
            cells: 1,
        })
        .collect();
    for _ in 0..20 {
        moved.push(&s, 0, &plate, [0.0; 2], 0.001, &mut marks);
        assert_eq!(sum(&moved), 0);
    }
    assert!(energy(&moved) > 0);
}

/// Heaps come to rest at the angle of repose, and where the square begins does not matter.
#[test]
fn heaps_rest_wherever_the_square_begins() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(5);
    let s = settings(&mut random, 1.0);
    let heap = |at: [f64; 2]| {
        let mut moved = Moved::new(&s, 1);
        moved.grid.follow(at);
        let middle = moved.grid.frame.cell_at(at);
        for (k, height) in [(0, 9000), (3, -4000), (5, 2500)] {
            let index = moved.grid.frame.index([middle[0] + k, middle[1] - k]).unwrap();
            moved.grid.heights[index] = height;
            moved.grid.wake(index);
        }
        (0..4000).for_each(|_| moved.grid.slide::<PlainShorts>(s.repose));
        assert!(moved.grid.awake.iter().all(|awake| !awake));
        let near = |i: i32, j: i32| moved.grid.height([middle[0] + i, middle[1] + j]);
        let around = (0..400).map(|k| (k % 20 - 10, k / 20 - 10)).collect::<Vec<_>>();
        for (i, j) in &around {
            for other in [near(i + 1, *j), near(*i, j + 1)] {
                let slope = (near(*i, *j) - other).abs() / s.cell;
                assert!(slope < s.repose + 0.01, "{slope} at {i} {j}");
            }
        }
        around.into_iter().map(|(i, j)| near(i, j)).collect::<Vec<_>>()
    };
    let first = heap([0.0; 2]);
    assert!(first.iter().any(|h| *h > 0.4 * s.cell));
    for at in [[13.4 * s.cell, -20.6 * s.cell], [-1000.3 * s.cell, 77.7 * s.cell]] {
        let other = heap(at);
        assert!(first.iter().zip(&other).all(|(a, b)| a == b), "{at:?}");
    }
}

/// A cell keeps its height as long as the square covers it; a cell that the square newly covers is level.
#[test]
fn the_square_moves_over_the_sand() {
    let mut grid = Grid::new(0.01, 6);
    let index = grid.frame.index([3, -2]).unwrap();
    (grid.heights[index], grid.packed[index]) = (500, 7);
    grid.follow([0.2, 0.1]);
    assert!(grid.height([3, -2]) > 0.0);
    grid.follow([0.5, 0.1]);
    assert_eq!([grid.height([3, -2]), grid.volume()], [0.0; 2]);
    grid.follow([0.0, 0.0]);
    assert!(grid.heights.iter().all(|h| *h == 0) && grid.packed.iter().all(|p| *p == 0));
    grid.follow([1e9, -1e9]);
    assert_eq!(grid.cells().count(), 64 * 64);
}

/// Sand as bytes comes back the same; whatever is not such bytes is refused.
#[test]
fn bytes_come_back() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(3);
    let s = settings(&mut random, 1.8);
    let (mut moved, mut marks) = (Moved::new(&s, 2), Marks::default());
    let body = pieces(&mut random, [0.0, 0.0, -0.01], [0.1, 0.0, -0.1], 0.03);
    moved.push(&s, 1, &body, [0.001, 0.0], 0.01, &mut marks);
    moved.sliding = 0.25;
    let bytes = moved.to_bytes();
    assert_eq!(Moved::from_bytes(&s, 2, &bytes).as_ref(), Some(&moved));
    assert!(bytes.len() <= Moved::bytes(&s, 2));
    for wrong in [&bytes[..bytes.len() - 1], &bytes[1..], &[bytes.as_slice(), &[0]].concat(), &[]] {
        assert_eq!(Moved::from_bytes(&s, 2, wrong), None);
    }
    assert_eq!(Moved::from_bytes(&s, 3, &bytes), None);
    for (at, value) in [(8, 0xff), (11, 0x7f), (15, 0x7f), (19, 0x7f), (24, 2)] {
        let mut broken = bytes.clone();
        broken[at] = value;
        broken[(at + 1).min(at | 3)] = 0xff;
        if at != 8 {
            assert_eq!(Moved::from_bytes(&s, 2, &broken), None, "byte {at}");
        }
    }
}

/// A wheel that travels over fresh sand under its load sinks in as the theory says, at every slip ratio: the heap that it
/// pushes is part of the theory. So the measured wheels are no worse than without memory.
#[test]
fn wheels_on_fresh_sand_are_the_theory() {
    let sand = include_str!("../../../tests/data/real_wheel/sand_discs.toml");
    let sand = SandDescription::from_toml(sand).unwrap();
    let body = body("cylinder:radius=0.0625,width=0.06");
    let rows = include_str!("../../../tests/data/real_wheel/wheel_smooth.csv");
    let mut errors = Vec::new();
    for line in long::every(4, rows.lines().filter(|l| !l.starts_with('#')).skip(1)) {
        let row: Vec<f64> = line.split(',').skip(1).map(|c| c.parse().unwrap()).collect();
        let [slip_angle, _, vx, vy, wy, depth, _, _, load] = row[..] else { panic!("{line}") };
        if slip_angle > 60.0 {
            continue;
        }
        let trial = Trial { velocity: [vx, vy, 0.0], spin: [0.0, wy, 0.0], given: DepthOrLoad::Load(load) };
        let mut path = Path::new(&body, &sand, None, None).unwrap();
        let times = (0..50).map(|k| 0.5 * f64::from(k));
        let with = times.fold(0.0, |_, time| path.step(&PathPoint { time, place: None, trial }).depth);
        errors.push([with, compute(&body, &sand, &trial).depth].map(|d| d - depth));
    }
    let [with, without] =
        [0, 1].map(|k| (errors.iter().map(|e: &[f64; 2]| e[k].powi(2)).sum::<f64>() / errors.len() as f64).sqrt());
    println!("sinkage of {} rows: {:.2} mm rms with memory, {:.2} mm without", errors.len(), 1e3 * with, 1e3 * without);
    assert!(errors.len() > long::either(15, 60) && (with - without).abs() < 1e-4, "{with} {without}");
}
