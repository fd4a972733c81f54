//! Bodies that travel straight through fresh sand: the drag of the theory, and that of simulated grains.

use super::*;

/// Drag after each millimetre of a straight way at constant depth [N], with memory and by the theory.
struct StraightDrag {
    with: Vec<f64>,
    theory: f64,
}

/// The body is let down and then drawn at 0.1 m/s in a direction [°], `way` mm far.
fn draw(shape: &str, plate: f64, depth: f64, degrees: f64, way: u32) -> StraightDrag {
    const SPEED: f64 = 0.1;
    let (sand, body) = (sand(), PlatedBody::cut(&BodyShape::named(shape).unwrap(), Some(plate)).unwrap());
    let mut path = Path::new(&body, &sand, None, None).unwrap();
    let (y, x) = degrees.to_radians().sin_cos();
    let down = |depth| Trial { velocity: [0.0, 0.0, -SPEED], spin: [0.0; 3], given: DepthOrLoad::Depth(depth) };
    let on = Trial { velocity: [SPEED * x, SPEED * y, 0.0], spin: [0.0; 3], given: DepthOrLoad::Depth(depth) };
    let ahead = |force: [f64; 3]| -force[0] * x - force[1] * y;
    for (time, trial) in [(0.0, down(-0.002)), (0.02 + depth / SPEED, down(depth))] {
        path.step(&PathPoint { time, place: Some([0.0; 2]), trial });
    }
    let mut with = Vec::new();
    for k in 1..=way {
        let gone = 1e-3 * f64::from(k);
        let time = 0.02 + (depth + gone) / SPEED;
        with.push(ahead(path.step(&PathPoint { time, place: Some([gone * x, gone * y]), trial: on }).force));
    }
    StraightDrag { with, theory: ahead(compute(&body, &sand, &on).force) }
}

/// Means over 10 mm.
fn tens(each: &[f64]) -> Vec<f64> {
    each.chunks_exact(10).map(|ten| ten.iter().sum::<f64>() / 10.0).collect()
}

/// Drag in the grains [N] over each of the first 50 mm of a file with the columns way, Fx and Fz.
fn grains(text: &str) -> Vec<f64> {
    table(text).iter().map(|row| -row[1]).take(50).collect()
}

/// Sand flows around a ball: over 30 cm its drag is that of the theory, whatever its size, its depth and its direction to the grid.
#[test]
fn a_ball_feels_the_theory_over_30_cm() {
    let radii = [0.005, 0.01, 0.02, 0.04].into_iter();
    let all = radii.flat_map(|r| [0.5 * r, 0.75 * r, 1.5 * r].into_iter().map(move |depth| (r, depth)));
    let all = all.flat_map(|(r, depth)| [0.0, 10.0, 22.5, 45.0].into_iter().map(move |degrees| (r, depth, degrees)));
    for (radius, depth, degrees) in long::every(7, all) {
        let StraightDrag { with, theory } =
            draw(&format!("sphere:radius={radius}"), radius / 12.0, depth, degrees, 300);
        let [low, high] = with.iter().fold([f64::INFINITY, 0.0_f64], |[a, b], x| [a.min(*x), b.max(*x)]);
        println!("ball {radius} m, {depth} m, {degrees}°: {:.3} to {:.3}", low / theory, high / theory);
        assert!(0.9 * theory < low && high < 1.1 * theory, "{radius} m, {depth} m, {degrees}°: {low} {high} {theory}");
    }
}

/// So does it around other bodies that are not flat ahead: a box that travels edge first, and a cylinder that rolls or is locked.
#[test]
fn sand_flows_around_edges_and_cylinders() {
    for (shape, degrees) in [("box:length=0.04,width=0.04,height=0.05", 45.0), ("cylinder:radius=0.03,width=0.04", 0.0)]
    {
        let StraightDrag { with, theory } = draw(shape, 0.002, 0.015, degrees, 300);
        let worst = with.iter().map(|x| (x / theory - 1.0).abs()).fold(0.0, f64::max);
        assert!(worst < 0.1, "{shape}: {worst}");
    }
}

/// An upright plate begins without its heap, and ends with the drag of the theory.
#[test]
fn the_heap_ahead_of_a_plate_grows_until_the_theory_holds() {
    for (width, depth) in [(0.025, 0.02), (0.05, 0.02), (0.05, 0.01), (0.05, 0.035), (0.1, 0.02)] {
        let shape = format!("box:length=0.005,width={width},height=0.04");
        let StraightDrag { with, theory } = draw(&shape, 0.0025, depth, 0.0, 300);
        let ratios = tens(&with).iter().map(|x| x / theory).collect::<Vec<_>>();
        println!("plate {width} m, {depth} m: {ratios:.2?}");
        assert!(ratios[0] < 0.97, "{width} m, {depth} m: {ratios:.2?}");
        assert!(ratios[10..].iter().all(|r| (r - 1.0).abs() < 0.1), "{width} m, {depth} m: {ratios:.2?}");
    }
}

/// In each of the first 10 mm, 20 mm and so on up to 50 mm the drag differs from that in grains by at most 20 % of the grains' largest. The
/// height of a held heap was fitted on the plate of 50 mm; the ball and the plate of 25 mm were not used.
#[test]
fn drag_in_fresh_sand_is_that_of_grains() {
    let plough = table(include_str!("../../../../tests/data/memory/plough.csv"));
    // There are 25 rows in 10 mm.
    let narrow: Vec<f64> = plough.iter().filter(|r| r[0] == 1.0 && r[4] > 0.1).map(|r| -r[6]).take(125).collect();
    let narrow = narrow.chunks_exact(25).map(|rows| rows.iter().sum::<f64>() / 25.0).collect();
    let broad = tens(&grains(include_str!("../../../../tests/data/drag/plate_0.05.csv")));
    let ball = tens(&grains(include_str!("../../../../tests/data/drag/ball_0.02.csv")));
    for (shape, depth, grains) in [
        ("box:length=0.005,width=0.05,height=0.04", 0.02, broad),
        (PLATE_DOWN, 0.02, narrow),
        ("sphere:radius=0.02", 0.015, ball),
    ] {
        let model = tens(&draw(shape, 0.0015, depth, 0.0, 50).with);
        println!("{shape}: grains {grains:.2?}, model {model:.2?} N");
        let largest = grains.iter().fold(0.0_f64, |a, b| a.max(*b));
        for (model, grains) in model.iter().zip(&grains) {
            assert!((model - grains).abs() < 0.2 * largest, "{shape}: {model:.2} N, grains {grains:.2} N");
        }
    }
}
