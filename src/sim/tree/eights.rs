//! A body's patches in lanes, eight at a time, to compute the forces on one robot in one state: see [`super::sand::on_patches`].
//!
//! A lane with fewer plates than the other lanes is filled with plates without area, and the last lanes may have only such
//! plates. These plates add exactly zero.

use super::patches::{Ball, BodyPatches, Facet, Panel, Patch, Tile};
use super::sand::{Total, on_patches, under_body};
use super::terrain::{Local, Surface};
use crate::blocks::LinkFrame;
use crate::number::{EIGHT, Eight, Mat3, Vec3};
use crate::sand::SandBed;
use crate::spatial::{Inertia, PointMasses, Symmetric, Twist, Wrench};

/// Eight patches, one in each lane.
pub type EightPatches = Patch<[f32; EIGHT], [f64; EIGHT]>;

/// The patches of a body in groups of eight, one in each lane. The patches of a group have about equal numbers of
/// plates, so few lanes are empty. Where possible they are neighbours, because a group is skipped if all its patches
/// are above the sand or do not lead.
pub fn eights(patches: &[Patch]) -> Vec<EightPatches> {
    let mut order: Vec<(PlateCounts, [f64; 6], &Patch)> = patches.iter().map(|p| (counts(p), look(p), p)).collect();
    order.sort_by_key(|p| p.0);
    order.chunk_by_mut(|a, b| a.0 == b.0).for_each(arrange);
    let order: Vec<&Patch> = order.iter().map(|p| p.2).collect();
    order.chunks(EIGHT).map(together).collect()
}

/// Numbers of panels, tiles and facets, each rounded up to a power of √2.
type PlateCounts = [u32; 3];

fn counts(patch: &Patch) -> PlateCounts {
    let class = |count: usize| if count == 0 { 0 } else { 1 + (2.0 * (count as f64).log2()).ceil() as u32 };
    [class(patch.panels.len()), class(patch.tiles.len()), class(patch.facets.len())]
}

/// Mean normal, and place in units of the patch's distance from the body's origin. Neighbours have similar numbers.
fn look(patch: &Patch) -> [f64; 6] {
    let facets = patch.facets.iter().chain(patch.panels.iter().map(|p| &p.facet));
    let mut sum = [0.0; 3];
    for facet in facets.chain(patch.tiles.iter().map(|t| &t.facet)) {
        sum.iter_mut().zip(facet.normal).for_each(|(s, n)| *s += f64::from(facet.area * n));
    }
    let length = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
    let ([x, y, z], c) = (sum, patch.ball.center);
    let (n, r) = (length(sum), length(c));
    [x / n, y / n, z / n, c[0] / r, c[1] / r, c[2] / r]
}

/// Orders patches so that each eight consecutive ones are neighbours: divides the list in two across its widest extent, again and again.
fn arrange(patches: &mut [(PlateCounts, [f64; 6], &Patch)]) {
    if patches.len() <= EIGHT {
        return;
    }
    let extent = |k: usize| {
        let along = patches.iter().map(|p| p.1[k]);
        along.clone().fold(f64::MIN, f64::max) - along.fold(f64::MAX, f64::min)
    };
    let widest = (0..6).fold(0, |w, k| if extent(k) > extent(w) { k } else { w });
    patches.sort_by(|a, b| a.1[widest].total_cmp(&b.1[widest]));
    let middle = (patches.len() / 2).next_multiple_of(EIGHT);
    let (front, back) = patches.split_at_mut(middle);
    arrange(front);
    arrange(back);
}

fn together(patches: &[&Patch]) -> EightPatches {
    // A lane without a patch gets the place of the first patch, so that it does not change which groups are skipped.
    let ball = |of: &dyn Fn(&Ball) -> f64| lanes(|i| of(&patches.get(i).unwrap_or(&patches[0]).ball));
    Patch {
        facets: rows(patches, |p| &p.facets, facets),
        panels: rows(patches, |p| &p.panels, panels),
        tiles: rows(patches, |p| &p.tiles, tiles),
        ball: Ball { center: [0, 1, 2].map(|k| ball(&|b| b.center[k])), reach: ball(&|b| b.reach) },
    }
}

fn lanes<T>(of: impl FnMut(usize) -> T) -> [T; EIGHT] {
    std::array::from_fn(of)
}

/// The first plates of all patches, then the second ones, and so on.
fn rows<P: Copy + Default, E>(
    patches: &[&Patch],
    list: impl Fn(&Patch) -> &[P],
    across: impl Fn(&[P; EIGHT]) -> E,
) -> Vec<E> {
    let most = patches.iter().map(|p| list(p).len()).max().unwrap_or(0);
    let plate = |row: usize, lane: usize| patches.get(lane).and_then(|p| list(p).get(row)).copied().unwrap_or_default();
    (0..most).map(|row| across(&lanes(|lane| plate(row, lane)))).collect()
}

fn three<P>(all: &[P; EIGHT], of: impl Fn(&P) -> [f32; 3]) -> [[f32; EIGHT]; 3] {
    [0, 1, 2].map(|k| lanes(|i| of(&all[i])[k]))
}

fn facets(all: &[Facet; EIGHT]) -> Facet<[f32; EIGHT]> {
    let one = |of: &dyn Fn(&Facet) -> f32| lanes(|i| of(&all[i]));
    Facet {
        center: three(all, |f| f.center),
        normal: three(all, |f| f.normal),
        squares: [0, 1].map(|k| one(&|f| f.squares[k])),
        products: three(all, |f| f.products),
        moment: three(all, |f| f.moment),
        area: one(&|f| f.area),
        rise: one(&|f| f.rise),
        begun: one(&|f| f.begun),
        growth: one(&|f| f.growth),
        edge: one(&|f| f.edge),
    }
}

fn panels(all: &[Panel; EIGHT]) -> Panel<[f32; EIGHT]> {
    Panel {
        facet: facets(&all.map(|p| p.facet)),
        half: [0, 1].map(|k| three(all, |p| p.half[k])),
        turn: three(all, |p| p.turn),
    }
}

fn tiles(all: &[Tile; EIGHT]) -> Tile<[f32; EIGHT]> {
    Tile { facet: facets(&all.map(|t| t.facet)), half: [0, 1].map(|k| three(all, |t| t.half[k])) }
}

/// The sand's effect on one body at rest or in motion, the same as [`super::sand::on_body`] with `SECANT`.
#[inline(always)]
pub fn on_eights<R: Eight>(
    ground: &SandBed<R>,
    (plates, eights): (&BodyPatches, &[EightPatches]),
    frame: &LinkFrame<f64>,
    place: &Vec3<f64>,
    travel: [f64; 2],
    surface: &impl Surface<f64>,
) -> Option<Total<f64>> {
    let under = under_body(plates, frame, place, surface);
    let under = Local { point: spread(under.point), normal: spread(under.normal) };
    let velocity = Twist { angular: spread(frame.velocity.angular), linear: spread(frame.velocity.linear) };
    let turn = &frame.rotation;
    let frame = LinkFrame {
        rotation: Mat3::new(spread(turn.x), spread(turn.y), spread(turn.z)),
        origin: spread(frame.origin),
        velocity,
        ..LinkFrame::at_rest()
    };
    let travel = [R::splat(travel[0]), R::splat(travel[1])];
    let all = (plates, eights);
    let total =
        on_patches::<R, _, _, true>(ground, all, &frame, &velocity, &spread(*place), travel, &under, None, R::one());
    Some(sum(&total?))
}

#[inline(always)]
fn spread<R: Eight>(v: Vec3<f64>) -> Vec3<R> {
    Vec3::new(R::splat(v.x), R::splat(v.y), R::splat(v.z))
}

/// The sum over all lanes.
#[inline(always)]
fn sum<R: Eight>(t: &Total<R>) -> Total<f64> {
    let (edge, drag) = (&t.edge, &t.drag);
    Total {
        wrench: Wrench { moment: vector(t.wrench.moment), force: vector(t.wrench.force) },
        drag: PointMasses { mass: drag.mass.sum(), first: vector(drag.first), second: symmetric(&drag.second) },
        edge: Inertia {
            rotary: symmetric(&edge.rotary),
            coupling: Mat3::new(vector(edge.coupling.x), vector(edge.coupling.y), vector(edge.coupling.z)),
            linear: symmetric(&edge.linear),
        },
    }
}

#[inline(always)]
fn vector<R: Eight>(v: Vec3<R>) -> Vec3<f64> {
    Vec3::new(v.x.sum(), v.y.sum(), v.z.sum())
}

#[inline(always)]
fn symmetric<R: Eight>(m: &Symmetric<R>) -> Symmetric<f64> {
    Symmetric { diagonal: vector(m.diagonal), off: vector(m.off) }
}
