//! Gathers many small plates of a body into few: each new plate is a part of the surface with nearly one normal.
//!
//! Parts are clusters of normals and places: the part whose normals and places vary most is divided in two across its
//! principal axis (principal direction divisive partitioning, Boley 1998), until there are as many parts as wanted.
//! Then each small plate moves to the part with the nearest mean (Lloyd 1982). So parts are small where the surface is
//! bent and large where it is flat. A new plate has its part's area, mean normal, extents and bends, and encloses the
//! same volume.

use crate::number::Vec3;
use crate::sand::intruder::IntruderPlate;
use nalgebra::{Matrix2, SMatrix, SVector, SymmetricEigen, Vector2, Vector3};

type V = Vector3<f64>;
/// Normal, and place as a share of the body's size.
type NormalAndPlace = SVector<f64, 6>;

/// Iterations that move parts to the means of their plates: our choice, because later ones change little.
const ROUNDS: usize = 8;
/// About `count` plates, or fewer, in place of `plates`. If a part's normals turn by less than `flat` [rad] from its
/// middle to the edge of one side, its plate is flat along that side.
pub fn few(plates: &[IntruderPlate], count: usize, flat: f64) -> Vec<IntruderPlate> {
    if plates.len() <= count {
        return plates.to_vec();
    }
    let area: f64 = plates.iter().map(|p| p.area).sum();
    let middle = plates.iter().map(|p| center(p) * p.area).sum::<V>() / area;
    parts(plates, count).iter().filter_map(|part| together(plates, part, middle, flat)).collect()
}

fn center(p: &IntruderPlate) -> V {
    p.center.lane(0).into()
}

fn normal(p: &IntruderPlate) -> V {
    p.normal.lane(0).into()
}

fn looks(plates: &[IntruderPlate]) -> Vec<NormalAndPlace> {
    let ends = |k: usize| {
        let along = plates.iter().map(|p| center(p)[k]);
        along.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], x| [a.min(x), b.max(x)])
    };
    let extent = V::from_fn(|k, _| ends(k)[1] - ends(k)[0]);
    // Half of the diagonal of the box around the body. Two places a whole diagonal apart then differ by 2, as opposite
    // normals do.
    let size = (0.5 * extent.norm()).max(1e-9);
    let look = |p: &IntruderPlate| {
        let (n, x) = (normal(p), center(p) / size);
        NormalAndPlace::new(n.x, n.y, n.z, x.x, x.y, x.z)
    };
    plates.iter().map(look).collect()
}

/// Plates that may become one plate; the mean of their normals and places, and the axis along which these vary most.
struct PlateCluster {
    members: Vec<usize>,
    mean: NormalAndPlace,
    axis: NormalAndPlace,
    /// Sum over the plates of area times squared deviation along this axis.
    spread: f64,
}

impl PlateCluster {
    fn of(members: Vec<usize>, looks: &[NormalAndPlace], plates: &[IntruderPlate]) -> Self {
        let area: f64 = members.iter().map(|i| plates[*i].area).sum();
        let mean =
            members.iter().map(|i| looks[*i] * plates[*i].area).sum::<NormalAndPlace>() / area.max(f64::MIN_POSITIVE);
        let mut second = SMatrix::<f64, 6, 6>::zeros();
        for i in &members {
            let off = looks[*i] - mean;
            second += off * off.transpose() * plates[*i].area;
        }
        let eigen = SymmetricEigen::new(second);
        let (most, spread) = eigen.eigenvalues.argmax();
        Self { members, mean, axis: eigen.eigenvectors.column(most).into(), spread }
    }
}

/// Indices of the plates of each part.
fn parts(plates: &[IntruderPlate], count: usize) -> Vec<Vec<usize>> {
    let looks = looks(plates);
    let mut parts = vec![PlateCluster::of((0..plates.len()).collect(), &looks, plates)];
    while parts.len() < count {
        let widest = (0..parts.len()).fold(0, |w, i| if parts[i].spread > parts[w].spread { i } else { w });
        let PlateCluster { members, mean, axis, spread } = parts.swap_remove(widest);
        let ahead = |i: &usize| (looks[*i] - mean).dot(&axis) > 0.0;
        let (front, back): (Vec<usize>, Vec<usize>) = members.into_iter().partition(ahead);
        let whole = front.is_empty() || back.is_empty();
        for half in [front, back].into_iter().filter(|half| !half.is_empty()) {
            parts.push(PlateCluster::of(half, &looks, plates));
        }
        if whole || spread <= 0.0 {
            break;
        }
    }
    let mut means: Vec<NormalAndPlace> = parts.iter().map(|p| p.mean).collect();
    let mut nearest = vec![0; plates.len()];
    for (part, cluster) in parts.iter().enumerate() {
        cluster.members.iter().for_each(|i| nearest[*i] = part);
    }
    for _ in 0..ROUNDS {
        let mut sums = vec![(NormalAndPlace::zeros(), 0.0); means.len()];
        let around = neighbours(&means);
        for (i, look) in looks.iter().enumerate() {
            nearest[i] = closest(look, nearest[i], &means, &around);
            let (sum, area) = &mut sums[nearest[i]];
            *sum += look * plates[i].area;
            *area += plates[i].area;
        }
        for (mean, (sum, area)) in means.iter_mut().zip(sums).filter(|(_, s)| s.1 > 0.0) {
            *mean = sum / area;
        }
    }
    let mut members = vec![Vec::new(); means.len()];
    nearest.iter().enumerate().for_each(|(i, part)| members[*part].push(i));
    members.retain(|m| !m.is_empty());
    members
}

/// For each mean a list of all means with their distances from it, nearest first.
fn neighbours(means: &[NormalAndPlace]) -> Vec<Vec<(f64, usize)>> {
    let of = |mean: &NormalAndPlace| {
        let mut all: Vec<(f64, usize)> = means.iter().enumerate().map(|(k, m)| ((m - mean).norm(), k)).collect();
        all.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        all
    };
    means.iter().map(of).collect()
}

/// The mean that is closest to `look`; of equally close means, the first one. The search begins at mean `guess` and
/// ends where, by the triangle inequality, no other mean can be as close. The small number is for rounding.
fn closest(look: &NormalAndPlace, guess: usize, means: &[NormalAndPlace], around: &[Vec<(f64, usize)>]) -> usize {
    let away = |k: usize| (means[k] - look).norm_squared();
    let mut best = (away(guess), guess);
    let reach = best.0.sqrt();
    for (gap, k) in &around[guess] {
        if *gap > (reach + best.0.sqrt()) * (1.0 + 1e-9) {
            break;
        }
        let other = away(*k);
        if other < best.0 || (other == best.0 && *k < best.1) {
            best = (other, *k);
        }
    }
    best.1
}

/// The plate that replaces the plates of a part; None if their normals cancel. `middle`: the reference point for the
/// enclosed volume. `limit`: the argument `flat` of [`few`].
fn together(plates: &[IntruderPlate], part: &[usize], middle: V, limit: f64) -> Option<IntruderPlate> {
    let own = || part.iter().map(|i| &plates[*i]);
    let area: f64 = own().map(|p| p.area).sum();
    let n = own().map(|p| normal(p) * p.area).sum::<V>().try_normalize(1e-9 * area)?;
    let mean = own().map(|p| center(p) * p.area).sum::<V>() / area;
    let volume: f64 = own().map(|p| p.area * (center(p) - middle).dot(&normal(p))).sum();
    let beside = if n.z.abs() < 0.9 { V::z() } else { V::x() };
    let u = n.cross(&beside).normalize();
    let w = n.cross(&u);
    let flat = |a: V| Vector2::new(a.dot(&u), a.dot(&w));
    // Means over the surface of the products of places, of normals, and of both, in the plane of the plate. A small
    // plate of half side h adds h²/3 of its own.
    let (mut places, mut normals, mut both) = (Matrix2::zeros(), Matrix2::zeros(), Matrix2::zeros());
    for p in own() {
        let share = p.area / area;
        let (at, turned) = (flat(center(p) - mean), flat(normal(p)));
        places += at * at.transpose() * share;
        normals += turned * turned.transpose() * share;
        both += turned * at.transpose() * share;
        for (half, bend) in p.half.iter().zip(p.bend) {
            let half = flat(half.lane(0).into());
            let square = half * half.transpose() * (share / 3.0);
            places += square;
            normals += square * (bend * bend);
            both += square * bend;
        }
    }
    let bent = 3.0 * normals.trace() > limit * limit;
    let axes = SymmetricEigen::new(if bent { normals } else { places }).eigenvectors;
    let side = |k: usize| {
        let axis = axes.column(k).into_owned();
        let mean = |m: &Matrix2<f64>| axis.dot(&(m * axis));
        let (half, turn) = ((3.0 * mean(&places)).sqrt().max(1e-9), (3.0 * mean(&normals)).max(0.0).sqrt());
        let bend = if turn < limit { 0.0 } else { (turn / half).copysign(mean(&both)) };
        let along = (u * axis.x + w * axis.y) * half;
        (Vec3::splat(along.into()), bend)
    };
    let [(a, along_a), (b, along_b)] = [side(0), side(1)];
    let out = volume / area - (mean - middle).dot(&n);
    let [center, normal] = [mean + n * out, n].map(|v| Vec3::splat(v.into()));
    Some(IntruderPlate { center, normal, area, half: [a, b], bend: [along_a, along_b] })
}
