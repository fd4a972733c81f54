//! The convex hull of points: quickhull (Barber, Dobkin & Huhdanpaa 1996).

use nalgebra::Vector3;
use std::collections::{HashMap, HashSet};

type V = Vector3<f64>;

/// A point counts as on a face if its distance is below this share of the size of the whole. Our choice: the first
/// number is a hundredth of single precision's rounding; the next numbers are tried if rounding leaves gaps in the
/// surface.
const ON_FACE: [f64; 3] = [1e-9, 1e-7, 1e-5];

/// If rounding leaves gaps with all of these, points are moved at random by at most these shares of the size of the whole
/// (Qhull's "joggled input", Barber, Dobkin & Huhdanpaa 1996): then no four points are in a plane but for rounding. Our
/// choice: from the rounding of files in single precision to what closing a surface merges.
const MOVED: [f64; 3] = [1e-7, 1e-6, 1e-5];
/// A point counts as on a face of moved points below this share: our choice, a thousand times double precision's rounding.
const ON_MOVED: f64 = 1e-13;

struct HullFace {
    corners: [usize; 3],
    normal: V,
    at: f64,
    /// Neighbours across the edges that begin at each corner.
    beside: [usize; 3],
    outside: Vec<usize>,
    gone: bool,
}

struct Hull<'a> {
    points: &'a [V],
    faces: Vec<HullFace>,
    least: f64,
}

/// Triangles, counterclockwise seen from outside; None if all points lie in a plane.
pub fn hull(points: &[V]) -> Option<Vec<[V; 3]>> {
    let corners = |hull: Vec<[usize; 3]>| hull.into_iter().map(|f| f.map(|c| points[c])).collect();
    let found = ON_FACE.iter().find_map(|on_face| hull_within(points, *on_face));
    found.or_else(|| hull_of_moved(points)).map(corners)
}

/// Middle and size of the box around points.
pub fn middle_and_size(points: &[V]) -> (V, f64) {
    let start = [V::repeat(f64::MAX), V::repeat(f64::MIN)];
    let [low, high] = points.iter().fold(start, |[a, b], p| [a.inf(p), b.sup(p)]);
    ((low + high) / 2.0, (high - low).max())
}

/// The hull of points that are moved a little; None if they lie in a plane.
fn hull_of_moved(points: &[V]) -> Option<Vec<[usize; 3]>> {
    let (middle, size) = middle_and_size(points);
    let flat = ON_FACE[ON_FACE.len() - 1];
    Hull { points, faces: Vec::new(), least: flat * size }.start()?;
    let mut single = HashSet::new();
    let kept: Vec<usize> = (0..points.len()).filter(|i| single.insert(points[*i].map(f64::to_bits))).collect();
    MOVED.iter().find_map(|share| {
        let mut random = 0_u64;
        let mut part = || {
            // Knuth's generator (MMIX).
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((random >> 11) as f64 / (1_u64 << 52) as f64 - 1.0) * share * size
        };
        let moved: Vec<V> = kept.iter().map(|i| points[*i] - middle + V::new(part(), part(), part())).collect();
        let hull = hull_within(&moved, ON_MOVED)?;
        Some(hull.into_iter().map(|f| f.map(|c| kept[c])).collect())
    })
}

/// The corners of the hull's triangles.
fn hull_within(points: &[V], on_face: f64) -> Option<Vec<[usize; 3]>> {
    let (_, size) = middle_and_size(points);
    let mut hull = Hull { points, faces: Vec::new(), least: on_face * size };
    let start = hull.start()?;
    hull.assign(&(0..points.len()).collect::<Vec<_>>(), &start);
    let mut left = start;
    while let Some(face) = left.pop() {
        if !hull.faces[face].gone && !hull.faces[face].outside.is_empty() {
            left.extend(hull.grow(face)?);
        }
    }
    let kept = hull.faces.iter().filter(|f| !f.gone);
    Some(kept.map(|f| f.corners).collect())
}

impl Hull<'_> {
    fn height(&self, face: usize, point: usize) -> f64 {
        self.faces[face].normal.dot(&self.points[point]) - self.faces[face].at
    }

    fn add(&mut self, corners: [usize; 3]) -> usize {
        let [a, b, c] = corners.map(|i| self.points[i]);
        let normal = (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_else(V::zeros);
        let at = (normal.dot(&a) + normal.dot(&b) + normal.dot(&c)) / 3.0;
        self.faces.push(HullFace { corners, normal, at, beside: [usize::MAX; 3], outside: Vec::new(), gone: false });
        self.faces.len() - 1
    }

    /// A tetrahedron of points far from each other.
    fn start(&mut self) -> Option<Vec<usize>> {
        let p = self.points;
        let farthest = |of: &dyn Fn(&V) -> f64| (0..p.len()).max_by(|a, b| of(&p[*a]).total_cmp(&of(&p[*b])));
        let a = farthest(&|v| v.x)?;
        let b = farthest(&|v| (v - p[a]).norm_squared())?;
        let along = (p[b] - p[a]).try_normalize(self.least)?;
        let c = farthest(&|v| (v - p[a]).cross(&along).norm_squared())?;
        let normal = along.cross(&(p[c] - p[a])).try_normalize(self.least)?;
        let d = farthest(&|v| (v - p[a]).dot(&normal).abs())?;
        let height = (p[d] - p[a]).dot(&normal);
        if height.abs() <= self.least {
            return None;
        }
        let [b, c] = if height > 0.0 { [c, b] } else { [b, c] };
        let faces: Vec<_> = [[a, b, c], [a, d, b], [b, d, c], [c, d, a]].map(|f| self.add(f)).into();
        self.join(&faces)?;
        Some(faces)
    }

    /// Links faces of `faces` that share an edge as neighbours.
    fn join(&mut self, faces: &[usize]) -> Option<()> {
        let mut edges = HashMap::new();
        for &f in faces {
            for k in 0..3 {
                let edge = [self.faces[f].corners[k], self.faces[f].corners[(k + 1) % 3]];
                // Two faces use this edge in the same direction: rounding has made a gap in the surface.
                if edges.insert(edge, (f, k)).is_some() {
                    return None;
                }
            }
        }
        for (&[from, to], &(f, k)) in &edges {
            if let Some((other, _)) = edges.get(&[to, from]) {
                self.faces[f].beside[k] = *other;
            }
        }
        faces.iter().all(|f| self.faces[*f].beside.iter().all(|b| *b != usize::MAX)).then_some(())
    }

    /// Assigns each point to the first face on whose outer side it lies.
    fn assign(&mut self, points: &[usize], faces: &[usize]) {
        for &p in points {
            if let Some(&f) = faces.iter().find(|f| self.height(**f, p) > self.least) {
                self.faces[f].outside.push(p);
            }
        }
    }

    /// Adds the point farthest outside of a face to the hull; returns the new faces.
    fn grow(&mut self, face: usize) -> Option<Vec<usize>> {
        let outside = &self.faces[face].outside;
        let apex = *outside.iter().max_by(|a, b| self.height(face, **a).total_cmp(&self.height(face, **b)))?;
        let (mut seen, mut left, mut rim) = (vec![face], vec![face], Vec::new());
        self.faces[face].gone = true;
        while let Some(f) = left.pop() {
            for k in 0..3 {
                let other = self.faces[f].beside[k];
                if self.faces[other].gone {
                    continue;
                }
                if self.height(other, apex) > self.least {
                    self.faces[other].gone = true;
                    seen.push(other);
                    left.push(other);
                } else {
                    rim.push(([self.faces[f].corners[k], self.faces[f].corners[(k + 1) % 3]], other));
                }
            }
        }
        let mut new = Vec::with_capacity(rim.len());
        for ([from, to], other) in rim {
            let f = self.add([from, to, apex]);
            self.faces[f].beside[0] = other;
            let back = (0..3).find(|k| self.faces[other].corners[*k] == to)?;
            self.faces[other].beside[back] = f;
            new.push(f);
        }
        self.join(&new)?;
        let freed: Vec<usize> = seen.iter().flat_map(|f| std::mem::take(&mut self.faces[*f].outside)).collect();
        self.assign(&freed, &new);
        Some(new)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn volume(hull: &[[V; 3]]) -> f64 {
        hull.iter().map(|[a, b, c]| a.dot(&b.cross(c))).sum::<f64>() / 6.0
    }

    /// Corners of a rounded edge [nm], on which three tolerances left gaps: of z1_GripperStator.STL (Unitree Z1, BSD-3-Clause,
    /// example-robot-data 4).
    const EDGE: [[i32; 3]; 36] = [
        [-7000002, -21770371, 24130912],
        [101076454, -36159538, -36261879],
        [100633793, -39516028, -34321003],
        [83603621, -40919393, -34888107],
        [83603248, -40855642, -35075545],
        [85397609, -39624132, -36199857],
        [86330868, -40946886, -34316394],
        [95386967, -40219992, -34179058],
        [88083036, -39108314, -36254477],
        [59165459, -40519372, -36250696],
        [59165459, -40355697, -36315687],
        [56224272, -40467694, -36321651],
        [59165180, -40105999, -36350001],
        [59165459, -40985160, -35622858],
        [53283080, -40723294, -36250386],
        [82694963, -40772140, -35266358],
        [82694963, -40845726, -35120256],
        [82694963, -40857442, -35085469],
        [81224367, -40991940, -34536622],
        [82694963, -39586954, -36261931],
        [79753771, -39571710, -36273938],
        [82694963, -40355135, -35820920],
        [76812588, -40968467, -34804817],
        [46728157, -40773604, -36221843],
        [47063440, -40773604, -36256768],
        [83409473, 38987216, -36350001],
        [82694963, 39179582, -36339682],
        [59165459, 40272854, -36335159],
        [56224272, 40399253, -36337741],
        [59165459, 40355697, -36315687],
        [56224272, 40467694, -36321651],
        [79753771, 39388068, -36317103],
        [79753771, 39571710, -36273938],
        [76812588, 39454818, -36318466],
        [24224777, 40853553, -22870602],
        [149000004, 25980430, -19292306],
    ];

    /// Rounding leaves no gap in the hull, whatever the unit. Its volume is that of scipy 1.17's ConvexHull.
    #[test]
    fn hulls_of_rounded_edges_have_no_gaps() {
        for unit in [1e-9, 1e-8, 1e-6] {
            let single = |x: i32| f64::from((f64::from(x) * unit) as f32);
            let points: Vec<V> = EDGE.iter().map(|p| V::from(p.map(single))).collect();
            let share = volume(&hull(&points).expect("a hull")) / (unit / 1e-9).powi(3) / 1.774_221_296_990_3e-4;
            assert!((share - 1.0).abs() < 1e-6, "{unit}: {share}");
            // Moved points in a plane have no hull either.
            let plane: Vec<V> = points.iter().map(|p| V::new(p.x, p.y, 0.0)).collect();
            assert!(hull(&plane).is_none() && hull_of_moved(&plane).is_none(), "{unit}");
        }
    }

    /// Hulls of a box's dense lattice of points and of random points on a ball contain every point.
    #[test]
    fn hulls_of_a_box_and_a_ball() {
        let lattice: Vec<V> =
            (0..1331).map(|i| V::new((i % 11) as f64, (i / 11 % 11) as f64, (i / 121) as f64) * 0.1).collect();
        let cube = hull(&lattice).unwrap();
        assert!((volume(&cube) - 1.0).abs() < 1e-9, "{}", volume(&cube));
        // A spiral from pole to pole by the golden angle: no four points in a plane.
        let spiral = |k: i32| {
            let z = (f64::from(k) + 0.5) / 10_000.0 - 1.0;
            let (sin, cos) = (2.399_963_229_728_653 * f64::from(k)).sin_cos();
            V::new(cos * (1.0 - z * z).sqrt(), sin * (1.0 - z * z).sqrt(), z)
        };
        let points: Vec<V> = (0..20_000).map(spiral).collect();
        let ball = hull(&points).unwrap();
        assert!((volume(&ball) / (4.0 / 3.0 * std::f64::consts::PI) - 1.0).abs() < 1e-3);
        // Euler's formula: all points are corners.
        assert_eq!(ball.len(), 2 * points.len() - 4);
        for [a, b, c] in ball.iter().step_by(97) {
            let n = (b - a).cross(&(c - a)).normalize();
            assert!(points.iter().all(|p| n.dot(&(p - a)) < 1e-8));
        }
        assert!(hull(&lattice[..121]).is_none(), "a plane has no hull");
        assert!(hull(&[]).is_none() && hull(&[V::zeros(); 9]).is_none());
    }
}
