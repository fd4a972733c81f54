//! Intruders cut into segments: legs and plates as thin curved strips in the vertical plane.
//!
//! Frame of a leg: the hip is at the origin, forward is +x, and at angle 0 the tip is straight down at (0, −2R). A leg
//! with ξ > 0 bulges forward: when it rotates so that its tip moves forward, its convex side leads.

use crate::error::{Error, Result, check_range};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// A small flat piece of an intruder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// Centre (x, z) [m] in the intruder's frame.
    pub center: [f64; 2],
    /// Unit normal (x, z); for a thin plate the sign does not matter.
    pub normal: [f64; 2],
    /// [m²]
    pub area: f64,
}

/// The side view of an intruder's mid-surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum LegShape {
    /// Two straight pieces; the knee lies on the circle that has hip-tip as its diameter, so the pieces meet at a right
    /// angle. `xi` [rad] is the signed angle at the hip between hip→tip and the first piece: 0 is a flat leg, positive
    /// bulges forward (L-leg: π/4), negative backward (reversed L-leg). After Li et al. 2012, fig. 5a.
    TwoPiece { xi: f64 },
    /// Half circle over the diameter hip-tip, bulging forward, or backward when `reversed`.
    HalfCircle { reversed: bool },
}

impl LegShape {
    pub const NAMES: [&'static str; 5] = ["L", "revL", "C", "revC", "flat"];

    /// `L`, `revL`, `C`, `revC`, `flat`, or `xi=DEGREES` with |ξ| < 90°.
    pub fn named(name: &str) -> Result<Self> {
        Ok(match name {
            "L" => LegShape::TwoPiece { xi: PI / 4.0 },
            "revL" => LegShape::TwoPiece { xi: -PI / 4.0 },
            "flat" => LegShape::TwoPiece { xi: 0.0 },
            "C" => LegShape::HalfCircle { reversed: false },
            "revC" => LegShape::HalfCircle { reversed: true },
            other => {
                let Some(degrees) = other.strip_prefix("xi=") else {
                    return Err(Error::unknown("leg shape", name, &[&Self::NAMES[..], &["xi=DEGREES"]].concat()));
                };
                let degrees = degrees.parse().map_err(|_| Error::invalid("xi", format!("{degrees:?} is no number")))?;
                return Self::two_piece(degrees);
            }
        })
    }

    /// A two-piece leg by its knee angle [°]. ±90° is refused, because the leg's first piece would then have no length.
    pub fn two_piece(xi_deg: f64) -> Result<Self> {
        if !(xi_deg.is_finite() && xi_deg.abs() < 90.0) {
            return Err(Error::invalid("xi_deg", format!("{xi_deg} is not between -90 and 90 (exclusive)")));
        }
        Ok(LegShape::TwoPiece { xi: xi_deg.to_radians() })
    }

    /// Direction in which the leg bulges: 1 forward, −1 backward, 0 for a straight leg.
    pub fn bulge(&self) -> f64 {
        match *self {
            LegShape::TwoPiece { xi: 0.0 } => 0.0,
            LegShape::TwoPiece { xi } => xi.signum(),
            LegShape::HalfCircle { reversed } => {
                if reversed {
                    -1.0
                } else {
                    1.0
                }
            }
        }
    }

    /// Corners of the mid-surface from hip to tip, for a hip-tip distance of 1.
    fn two_piece_corners(xi: f64) -> [[f64; 2]; 3] {
        let (sin, cos) = xi.sin_cos();
        [[0.0, 0.0], [cos * sin, -cos * cos], [0.0, -1.0]]
    }

    /// Cuts the strip into exactly `count` ≥ 2 segments (`chord` = hip-tip distance 2R [m], `width` [m]). A lower piece
    /// that is shorter than 1e-9 of the chord is only a rounding error, and is left out.
    pub fn segments(&self, chord: f64, width: f64, count: usize) -> Result<Vec<Segment>> {
        // A robot smaller than 1 mm or larger than 10 m has wrong units, and no leg needs 10⁵ segments: our choice.
        check_range("chord", chord, 1e-3..=10.0)?;
        check_range("width", width, 1e-4..=10.0)?;
        if !(2..=100_000).contains(&count) {
            return Err(Error::invalid("segments", format!("{count} is outside [2, 100000]")));
        }
        Ok(match *self {
            LegShape::TwoPiece { xi } => {
                let [hip, knee, tip] = Self::two_piece_corners(xi).map(|p| p.map(|c| c * chord));
                let (upper, lower) = (distance(hip, knee), distance(knee, tip));
                if lower < 1e-9 * chord {
                    return Ok(straight(hip, tip, width, count));
                }
                let share = (count as f64 * upper / (upper + lower)).round() as usize;
                let first = share.clamp(1, count - 1);
                let mut segments = straight(hip, knee, width, first);
                segments.extend(straight(knee, tip, width, count - first));
                segments
            }
            LegShape::HalfCircle { reversed } => {
                let side = if reversed { -1.0 } else { 1.0 };
                let radius = chord / 2.0;
                let area = PI * radius / count as f64 * width;
                (0..count)
                    .map(|i| {
                        let (sin, cos) = ((i as f64 + 0.5) / count as f64 * PI).sin_cos();
                        Segment {
                            center: [side * radius * sin, -radius + radius * cos],
                            normal: [side * sin, cos],
                            area,
                        }
                    })
                    .collect()
            }
        })
    }
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (b[0] - a[0]).hypot(b[1] - a[1])
}

/// `count` equal segments from `a` to `b`.
pub fn straight(a: [f64; 2], b: [f64; 2], width: f64, count: usize) -> Vec<Segment> {
    let length = distance(a, b);
    let normal = [-(b[1] - a[1]) / length, (b[0] - a[0]) / length];
    let area = length / count as f64 * width;
    (0..count)
        .map(|i| {
            let s = (i as f64 + 0.5) / count as f64;
            Segment { center: [a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1])], normal, area }
        })
        .collect()
}
