//! The convex hull of points: quickhull (Barber, Dobkin & Huhdanpaa 1996).

use nalgebra::Vector3;
use std::collections::HashMap;

type V = Vector3<f64>;

/// A point counts as on a face if its distance is below this share of the size of the whole. Our choice: the first
/// number is a hundredth of single precision's rounding; the next numbers are tried if rounding leaves gaps in the
/// surface.
const ON_FACE: [f64; 3] = [1e-9, 1e-7, 1e-5];

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
    ON_FACE.iter().find_map(|on_face| hull_within(points, *on_face))
}

fn hull_within(points: &[V], on_face: f64) -> Option<Vec<[V; 3]>> {
    let extent = |k: usize| {
        let ends = points.iter().fold([f64::MAX, f64::MIN], |[a, b], p| [a.min(p[k]), b.max(p[k])]);
        ends[1] - ends[0]
    };
    let least = on_face * extent(0).max(extent(1)).max(extent(2));
    let mut hull = Hull { points, faces: Vec::new(), least };
    let start = hull.start()?;
    hull.assign(&(0..points.len()).collect::<Vec<_>>(), &start);
    let mut left = start;
    while let Some(face) = left.pop() {
        if !hull.faces[face].gone && !hull.faces[face].outside.is_empty() {
            left.extend(hull.grow(face)?);
        }
    }
    let kept = hull.faces.iter().filter(|f| !f.gone);
    Some(kept.map(|f| f.corners.map(|c| points[c])).collect())
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
