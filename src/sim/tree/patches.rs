//! Gathers plates into patches. The law of the sand is expensive and is evaluated once for each patch; whether a plate
//! leads and is in the sand is found for each plate.
//!
//! A patch is a part of a body's surface whose plates have nearly the same normal and lie near each other. Its
//! force is the law's force on the leading part in the sand, weighted by depth: for the mean normal, and for the
//! deviations of normals from it ([`crate::sand::law::StressLaw::mean_stress`]).
//!
//! There are two uses of lanes: each lane has its own environment, and all share one patch; or each lane has its own patch
//! ([`super::eights`]). So the numbers of a patch have a type `S` (single precision) or `D` that [`crate::number::Spread`]
//! puts into lanes.

use crate::sand::intruder::IntruderPlate;
use crate::sand::{Law, Regularization};
use nalgebra::Vector3;

type V = Vector3<f64>;

/// Largest distance of a plate from its patch's centre. The distance combines normals (unit vectors) and positions,
/// divided by the body's size and multiplied by [`BY_PLACE`]. Our choice: forces on round feet are within 2 % of those
/// of fine plates (`tests/robots.rs`). `li2013` has the exact mean over normals, so its patches are large; mechanisms
/// use the mean normal only. `agarwal2023` is a polynomial of fourth degree in the normal and discontinuous where a
/// plate is vertical, so its patches are small.
const APART: [f64; 2] = [0.7, 0.21];
/// Factor on [`APART`] for fine plates: our choice. With 1 for `li2013` the errors on spinning bodies were twice as
/// large. With smaller patches for `agarwal2023` its mean over normals is lost, and the errors on balls grow.
const FINER: [f64; 2] = [0.4, 0.8];
/// Weight of positions relative to normals: our choice. With 0.6 for `li2013` the error on Bolt's lower leg was twice as
/// large.
const BY_PLACE: [f64; 2] = [1.2, 0.6];
/// Weight of normals that vary in one direction only, a case that the mean of `agarwal2023` does not cover: our choice.
const ONE_WAY: [f64; 2] = [1.0, 1.6];
/// Largest number of patches of a body: our choice, to bound the time of a step.
const MOST: usize = 512;
/// Iterations that move patches to the centres of their plates (Lloyd 1982): our choice, later ones change little.
const ROUNDS: usize = 8;
/// The leading share of a plate that is bent along both sides grows from 0 to 1 while n·v̂ at its centre grows from −w
/// to w. This is the ratio of w to the rms change of the normal from the centre to the edges. Our choice: it lies
/// between 1 and 0.71, with which the slope at n·v̂ = 0 is right for equal bends and motion along a side or a diagonal.
const EDGE: f64 = 0.8;

/// A plate in the form that lanes need, in its body's frame: bent along both sides, or part of a [`Panel`] or [`Tile`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Facet<S = f32> {
    pub center: [S; 3],
    /// Outward unit vector.
    pub normal: [S; 3],
    /// Means of the products of the normal's components over the plate, which may be bent: xx, yy; yz, xz, xy.
    pub squares: [S; 2],
    pub products: [S; 3],
    /// center × normal: the normal velocity per angular velocity.
    pub moment: [S; 3],
    /// [m²]
    pub area: S,
    /// Distance of the plate's two sample points from its centre, up and down, when the plate is upright [m]: Gauss's
    /// rule for a square.
    pub rise: S,
    /// `begun` + `growth` n·v̂, clamped to 0 to 1, is the share of the plate that leads when it moves along v̂.
    pub begun: S,
    pub growth: S,
    /// `growth` times `area` [m²].
    pub edge: S,
}

/// A flat plate. `rise`, `begun`, `growth` and `edge` of `facet` are not used.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tile<S = f32> {
    pub facet: Facet<S>,
    /// From the centre to two neighbouring edges [m].
    pub half: [[S; 3]; 2],
}

/// A plate that is bent along one side and flat along the other. It may be long, and where it begins to lead depends on
/// the direction of motion. `rise`, `growth` and `edge` of `facet` are not used.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Panel<S = f32> {
    pub facet: Facet<S>,
    /// From the centre to the edges of the bent and of the flat side [m].
    pub half: [[S; 3]; 2],
    /// Change of the normal from the centre to the edge towards which it turns.
    pub turn: [S; 3],
}

/// Plates with nearly the same normal.
#[derive(Clone, Debug, PartialEq)]
pub struct Patch<S = f32, D = f64> {
    pub facets: Vec<Facet<S>>,
    pub panels: Vec<Panel<S>>,
    pub tiles: Vec<Tile<S>>,
    pub ball: Ball<D>,
}

/// A ball that contains plates [m].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball<D = f64> {
    pub center: [D; 3],
    pub reach: D,
}

/// A body's patches, in its frame.
#[derive(Clone, Debug, PartialEq)]
pub struct BodyPatches {
    pub body: usize,
    pub patches: Vec<Patch>,
    /// A ball that contains all plates.
    pub ball: Ball,
    /// Corners of a box that contains the plates' centres. The weight of the expected change is evaluated at these
    /// corners.
    pub corners: [[f64; 3]; 8],
}

fn center(p: &IntruderPlate) -> V {
    p.center.lane(0).into()
}

fn normal(p: &IntruderPlate) -> V {
    p.normal.lane(0).into()
}

fn length(p: &IntruderPlate, k: usize) -> f64 {
    V::from(p.half[k].lane(0)).norm()
}

/// Least and greatest x, y and z of the plates' centres.
fn ends(plates: &[IntruderPlate]) -> [[f64; 2]; 3] {
    [0, 1, 2].map(|k| {
        let along = plates.iter().map(|p| center(p)[k]);
        along.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], x| [a.min(x), b.max(x)])
    })
}

impl Ball {
    pub fn around(plates: &[IntruderPlate]) -> Self {
        let middle = ends(plates).map(|[a, b]| (a + b) / 2.0);
        let away = |p: &IntruderPlate| (center(p) - V::from(middle)).norm() + length(p, 0) + length(p, 1);
        Self { center: middle, reach: plates.iter().map(away).fold(0.0, f64::max) }
    }
}

impl BodyPatches {
    /// The patches of each body that has plates.
    pub fn all(plates: &[Vec<IntruderPlate>], law: Law) -> Vec<Self> {
        plates.iter().enumerate().filter(|(_, p)| !p.is_empty()).map(|(body, p)| Self::of(body, p, law)).collect()
    }

    pub fn of(body: usize, plates: &[IntruderPlate], law: Law) -> Self {
        Self::within(body, plates, law, 1.0)
    }

    /// The patches of one body, smaller than those of [`Self::of`], for the fine plates of [`super::plates::of_body`].
    pub fn fine(body: usize, plates: &[IntruderPlate], law: Law) -> Self {
        Self::within(body, plates, law, FINER[usize::from(law == Law::Agarwal2023)])
    }

    /// `share`: factor on [`APART`].
    fn within(body: usize, plates: &[IntruderPlate], law: Law, share: f64) -> Self {
        let ends = ends(plates);
        let corners = std::array::from_fn(|i| [0, 1, 2].map(|k| ends[k][i >> k & 1]));
        let ball = Ball::around(plates);
        let alike = alike(plates, &ball, law, share);
        let patch = |members: &Vec<usize>| {
            let own: Vec<IntruderPlate> = members.iter().map(|i| plates[*i]).collect();
            let bent = |sides: usize| own.iter().filter(move |p| p.bend.iter().filter(|b| **b != 0.0).count() == sides);
            Patch {
                facets: bent(2).map(Facet::of).collect(),
                panels: bent(1).map(Panel::of).collect(),
                tiles: bent(0).map(Tile::of).collect(),
                ball: Ball::around(&own),
            }
        };
        Self { body, patches: alike.iter().map(patch).collect(), ball, corners }
    }
}

impl Facet {
    fn of(p: &IntruderPlate) -> Self {
        let n = normal(p);
        let sides = [length(p, 0), length(p, 1)];
        let square = |x: f64| x * x;
        let at = center(p);
        let single = |v: V| [v.x as f32, v.y as f32, v.z as f32];
        let rise = ((square(sides[0]) + square(sides[1])) / 6.0).sqrt();
        let turn = ((square(p.bend[0] * sides[0]) + square(p.bend[1] * sides[1])) / 2.0).sqrt();
        // A flat plate pushes when it moves outward; its force rises over the gate of solid bodies.
        let gate = Regularization::SOLID.leading_edge_gate;
        let wide = EDGE * turn > gate / 2.0;
        let (begun, growth) = if wide { (0.5, 0.5 / (EDGE * turn)) } else { (0.0, 1.0 / gate) };
        // A normal that turns evenly by ± a along t has the mean products (1 − a²/3) n n + a²/3 t t, to second order in a.
        let mut second = n * n.transpose();
        for k in (0..2).filter(|k| p.bend[*k] != 0.0) {
            let (turned, along) = (square(p.bend[k] * sides[k]) / 3.0, V::from(p.half[k].lane(0)).normalize());
            second += (along * along.transpose() - n * n.transpose()) * turned;
        }
        Self {
            center: single(at),
            normal: single(n),
            squares: [second[(0, 0)] as f32, second[(1, 1)] as f32],
            products: [(1, 2), (0, 2), (0, 1)].map(|at| second[at] as f32),
            moment: single(at.cross(&n)),
            area: p.area as f32,
            rise: rise as f32,
            begun: begun as f32,
            growth: growth as f32,
            edge: (growth * p.area) as f32,
        }
    }
}

impl Tile {
    fn of(p: &IntruderPlate) -> Self {
        Self { facet: Facet::of(p), half: halves(p) }
    }
}

impl Panel {
    fn of(p: &IntruderPlate) -> Self {
        // The bent side first.
        let p = if p.bend[0] == 0.0 {
            IntruderPlate { half: [p.half[1], p.half[0]], bend: [p.bend[1], 0.0], ..*p }
        } else {
            *p
        };
        let half = V::from(p.half[0].lane(0));
        let turn = half * p.bend[0];
        // The middle of a bent plate lies below its highest point.
        let sag = turn.dot(&half) / 6.0;
        let lower = IntruderPlate { center: p.center - p.normal * sag, ..p };
        Self { facet: Facet::of(&lower), half: halves(&p), turn: turn.map(|x| x as f32).into() }
    }
}

fn halves(p: &IntruderPlate) -> [[f32; 3]; 2] {
    p.half.map(|h| h.lane(0).map(|x| x as f32))
}

/// The normal, and the position divided by the body's size.
type NormalAndPlace = [f64; 6];

fn apart(a: &NormalAndPlace, b: &NormalAndPlace) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

/// Indices of the plates of each patch. Patches are added until every plate is near a patch's centre.
fn alike(plates: &[IntruderPlate], ball: &Ball, law: Law, share: f64) -> Vec<Vec<usize>> {
    let kind = usize::from(law == Law::Agarwal2023);
    let (most, turned) = (share * APART[kind], ONE_WAY[kind]);
    let scale = BY_PLACE[kind] / ball.reach.max(1e-9);
    let look = |p: &IntruderPlate| -> NormalAndPlace {
        let one_way = (p.bend[0] == 0.0) != (p.bend[1] == 0.0);
        let n = normal(p) * if one_way { turned } else { 1.0 };
        let at = (center(p) - V::from(ball.center)) * scale;
        [n.x, n.y, n.z, at.x, at.y, at.z]
    };
    let looks: Vec<NormalAndPlace> = plates.iter().map(look).collect();
    // The next centre is the plate farthest from the present centres (Gonzalez 1985).
    let mut middles = vec![looks[0]];
    let mut distance: Vec<f64> = looks.iter().map(|l| apart(l, &looks[0])).collect();
    while middles.len() < MOST.min(looks.len()) {
        let far = (0..looks.len()).fold(0, |far, i| if distance[i] > distance[far] { i } else { far });
        if distance[far] <= most * most {
            break;
        }
        middles.push(looks[far]);
        distance.iter_mut().zip(&looks).for_each(|(d, l)| *d = d.min(apart(l, &looks[far])));
    }
    let nearest = |middles: &[NormalAndPlace], l: &NormalAndPlace| {
        let all = middles.iter().map(|m| apart(m, l)).enumerate();
        all.fold((0, f64::INFINITY), |best, one| if one.1 < best.1 { one } else { best }).0
    };
    for _ in 0..ROUNDS {
        let mut sums = vec![([0.0; 6], 0.0); middles.len()];
        for (look, plate) in looks.iter().zip(plates) {
            let (sum, area) = &mut sums[nearest(&middles, look)];
            sum.iter_mut().zip(look).for_each(|(s, x)| *s += plate.area * x);
            *area += plate.area;
        }
        for (middle, (sum, area)) in middles.iter_mut().zip(sums).filter(|(_, s)| s.1 > 0.0) {
            *middle = sum.map(|x| x / area);
        }
    }
    let mut patches = vec![Vec::new(); middles.len()];
    looks.iter().enumerate().for_each(|(i, l)| patches[nearest(&middles, l)].push(i));
    patches.retain(|p| !p.is_empty());
    patches
}
