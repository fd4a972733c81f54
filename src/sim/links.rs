//! Belly and legs of a described robot as bodies with masses and plates.

use super::robot::{Link, Robot};
use super::solid::Plate;
use crate::error::Result;
use crate::sand::{LegShape, Segment};

type V = nalgebra::Vector3<f64>;
type M = nalgebra::Matrix3<f64>;

/// A flat, straight part of a link's strip, in the frame of the body that carries it. Rigid obstacles collide with
/// it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StripPiece {
    /// [m]
    pub center: V,
    /// Unit vectors along the strip and across it, in its plane.
    pub along: V,
    pub across: V,
    /// Length and width [m].
    pub size: [f64; 2],
}

/// A link's rigid body in its own frame: parallel to the base frame when all angles are 0, origin at its joint.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkBody {
    /// Joint position in the parent's frame [m].
    pub joint: V,
    /// Unit hinge axis (the same in parent and own frame).
    pub axis: V,
    /// [kg]
    pub mass: f64,
    /// Centre of mass [m].
    pub center: V,
    /// About the centre of mass [kg·m²].
    pub inertia: M,
    /// [kg·m²]
    pub armature: f64,
    /// Lowest and highest angle, at which the joint stops [rad]; None: it turns freely.
    pub range: Option<[f64; 2]>,
    pub plates: Vec<Plate>,
    /// Plates of the straight strip from joint to tip, which replace `plates` when sand fills the concave side (`concave_fill`).
    pub chord: Vec<Plate>,
    /// Direction of the strip's bulge: 1 if the bulging side leads when the joint turns positively, −1 if the other
    /// side leads, 0 if the strip is straight.
    pub bulge: f64,
    pub pieces: Vec<StripPiece>,
    /// From the joint to the next one or the tip [m].
    pub reach: V,
}

pub fn belly(robot: &Robot) -> Vec<Plate> {
    let Some(belly) = &robot.belly else { return Vec::new() };
    let [nx, ny] = belly.plates;
    let [dx, dy] = [belly.size[0] / nx as f64, belly.size[1] / ny as f64];
    let at = |i: usize, d: f64, length: f64| (i as f64 + 0.5) * d - length / 2.0;
    (0..nx * ny)
        .map(|k| Plate {
            center: V::new(at(k / ny, dx, belly.size[0]), at(k % ny, dy, belly.size[1]), -belly.below),
            normal: -V::z(),
            area: dx * dy,
            width: belly.size[1],
        })
        .collect()
}

pub fn leg(robot: &Robot, hip: [f64; 3], yaw: f64) -> Result<Vec<LinkBody>> {
    let turn = nalgebra::Rotation3::from_axis_angle(&V::z_axis(), yaw);
    let mut joint = V::from(hip);
    let mut chain = Vec::with_capacity(robot.leg.link.len());
    for link in &robot.leg.link {
        let reach = turn * V::from(link.reach);
        chain.push(body(link, joint, turn)?);
        joint = reach;
    }
    Ok(chain)
}

/// The strip's segments carry a link's mass as thin rods; without a strip, the straight reach carries it, and rigid
/// obstacles touch it as a strip of 1 cm (our choice, as wide as the legs of `xplorer`) of any number of segments.
fn body(link: &Link, joint: V, turn: nalgebra::Rotation3<f64>) -> Result<LinkBody> {
    let reach = V::from(link.reach);
    let axis = V::from(link.axis).normalize();
    let down = reach.normalize();
    let width_axis = link.sand.as_ref().and_then(|s| s.width_axis).map_or(axis, |w| V::from(w).normalize());
    let forward = width_axis.cross(&down); // where the tip goes when the joint turns positively about the width axis
    let place = |p: [f64; 2]| turn * (forward * p[0] - down * p[1]);
    let (shape, width, count) = match &link.sand {
        Some(strip) => (LegShape::named(&strip.shape)?, strip.width, strip.segments),
        None => (LegShape::TwoPiece { xi: 0.0 }, 0.01, 12),
    };
    let segments = shape.segments(reach.norm(), width, count)?;
    let total: f64 = segments.iter().map(|s| s.area).sum();
    let center: V = segments.iter().map(|s| place(s.center) * (s.area / total)).sum();
    let inertia = segments.iter().fold(M::zeros(), |sum, s| {
        let mass = link.mass * s.area / total;
        let (r, length) = (place(s.center) - center, s.area / width);
        let along = place([-s.normal[1], s.normal[0]]);
        let rod = (M::identity() - along * along.transpose()) * (mass * length * length / 12.0);
        sum + rod + (M::identity() * r.norm_squared() - r * r.transpose()) * mass
    });
    let touching = |segments: &[Segment]| match link.sand {
        Some(_) => {
            let plate = |s: &Segment| Plate {
                center: exact(place(s.center)),
                normal: exact(place(s.normal)),
                area: s.area,
                width,
            };
            segments.iter().map(plate).collect()
        }
        None => Vec::new(),
    };
    Ok(LinkBody {
        joint: exact(joint),
        axis: exact(turn * axis),
        mass: link.mass,
        center: exact(center),
        inertia: exact(inertia),
        armature: link.armature,
        range: link.range,
        plates: touching(&segments),
        chord: touching(&LegShape::TwoPiece { xi: 0.0 }.segments(reach.norm(), width, count)?),
        bulge: shape.bulge(),
        pieces: pieces(&segments, width, place, turn * width_axis),
        reach: exact(turn * reach),
    })
}

/// `v` with rounding errors replaced by exact zeros: cos 90° is 6e-17 in `f64`, and products of such numbers can be
/// denormal in `f32`. 1e-12 of the norm is far above rounding and far below any length in a drawing.
pub(super) fn exact<const R: usize, const C: usize>(v: nalgebra::SMatrix<f64, R, C>) -> nalgebra::SMatrix<f64, R, C> {
    let least = 1e-12 * v.norm();
    v.map(|x| if x.abs() < least { 0.0 } else { x })
}

/// Straight pieces of a strip: neighbouring segments are one piece while their directions differ by less than
/// [`BEND`]. `place` takes a segment's coordinates to the body's frame, where `across` is the strip's width.
fn pieces(segments: &[Segment], width: f64, place: impl Fn([f64; 2]) -> V, across: V) -> Vec<StripPiece> {
    let mut runs: Vec<&[Segment]> = Vec::new();
    let mut start = 0;
    for end in 1..=segments.len() {
        let [nx, nz] = segments[start].normal;
        if segments.get(end).is_none_or(|s| s.normal[0] * nx + s.normal[1] * nz < BEND.cos()) {
            runs.push(&segments[start..end]);
            start = end;
        }
    }
    let piece = |run: &[Segment]| {
        let (first, last) = (&run[0], &run[run.len() - 1]);
        let [dx, dz] = [0, 1].map(|i| last.center[i] - first.center[i]);
        let ahead = if dx * first.normal[1] - dz * first.normal[0] < 0.0 { -1.0 } else { 1.0 };
        let end = |s: &Segment, side: f64| {
            let half = ahead * side * s.area / width / 2.0;
            place([s.center[0] + half * s.normal[1], s.center[1] - half * s.normal[0]])
        };
        let (from, to) = (end(first, -1.0), end(last, 1.0));
        let length = (to - from).norm();
        StripPiece { center: (from + to) / 2.0, along: (to - from) / length, across, size: [length, width] }
    };
    runs.into_iter().map(piece).collect()
}

/// Sharpest bend inside a piece [rad]: our choice. Two of a C-leg's twelve segments then make one piece, and on
/// `xplorer` the piece stays within 0.6 mm of the arc.
const BEND: f64 = 0.35;
