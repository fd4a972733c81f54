//! A leg rotated about a fixed hip: the experiment of Li et al. 2012, section 3.

use super::contact::{Regularization, SandBed};
use super::description::SandDescription;
use super::mechanism::Mechanisms;
use super::mechanism_laws::{SandMechanisms, SegmentState, of_size};
use super::shape::{LegShape, Segment, straight};
use crate::error::{Result, check_range};
use crate::number::Vec3;

/// Force and torque on an intruder.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Load {
    /// Horizontal force on the intruder [N], positive along +x.
    pub fx: f64,
    /// Vertical force [N], positive up.
    pub fz: f64,
    /// Torque x·Fz − z·Fx about the hip [N·m].
    pub ty: f64,
}

/// The load on a leg at angle `theta` [rad] (0: tip straight down; positive: tip forward) that turns with `omega`
/// [rad/s] about a hip `hip_height` [m] above the surface.
pub fn rotating_leg(ground: &SandBed<f64>, segments: &[Segment], theta: f64, omega: f64, hip_height: f64) -> Load {
    let (sin, cos) = theta.sin_cos();
    let turn = |p: [f64; 2]| [p[0] * cos - p[1] * sin, p[0] * sin + p[1] * cos];
    let mut load = Load::default();
    for s in segments {
        let ([x, z], n) = (turn(s.center), turn(s.normal));
        let depth = -(hip_height + z);
        if depth <= 0.0 {
            continue;
        }
        let v = Vec3::new(-omega * z, 0.0, omega * x);
        let f = ground.thin_plate(&SegmentState::fresh(depth, x), s.area, Vec3::new(n[0], 0.0, n[1]), v).force;
        load.fx += f.x;
        load.fz += f.z;
        load.ty += x * f.z - z * f.x;
    }
    load
}

/// Segments along the leg: our choice, because eight times as many change no force by more than 1e-5 of its peak.
const SEGMENTS: usize = 400;

/// θ from −1.75 to 1.75 rad in steps of 0.01: our choice. The forces' peaks on all named legs are within ±0.9 rad.
const HALF_SWEEP: i32 = 175;

/// A leg that turns once through the sand about a fixed hip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rotation {
    pub shape: LegShape,
    /// Distance from hip to tip [m].
    pub chord: f64,
    /// [m]
    pub width: f64,
    /// Height of the hip above the surface [m]; on sloped sand, above the surface right below it.
    pub hip_height: f64,
    /// Angular speed [rad/s]; negative turns the tip backward.
    pub omega: f64,
}

/// Li et al. 2012, section 3: hip-tip distance 2R [m].
pub const CHORD: f64 = 0.076;
/// Li et al. 2012, section 3: width [m].
pub const WIDTH: f64 = 0.025;
/// Height of the hip above the sand [m]: our choice, because the paper does not state it.
pub const HIP_HEIGHT: f64 = 0.02;
/// Li et al. 2012, section 3: angular speed [rad/s].
pub const OMEGA: f64 = 0.2;

impl Rotation {
    /// A leg in the paper's experiment.
    pub fn of(shape: LegShape) -> Self {
        Self { shape, chord: CHORD, width: WIDTH, hip_height: HIP_HEIGHT, omega: OMEGA }
    }

    /// Angle [rad] and load in `sand`, from θ = −1.75 to 1.75. Mechanisms of sensors and logs are not applied.
    pub fn loads(&self, sand: &SandDescription) -> Result<Vec<(f64, Load)>> {
        let segments = self.shape.segments(self.chord, self.width, SEGMENTS)?;
        // Bounds that catch wrong units: our choice.
        check_range("hip-height", self.hip_height, -1.0..=1.0)?;
        check_range("omega", self.omega, -100.0..=100.0)?;
        let (medium, mechanisms) = (sand.medium(), &sand.mechanisms);
        // The size of the leg gives all of its stress one factor.
        let scale = (1.0 + mechanisms.scale) * of_size(mechanisms.size_power, [self.chord, self.width]) - 1.0;
        let acting = Mechanisms { scale, ..*mechanisms };
        let mut ground = SandBed::new(sand.law, &medium, &Regularization::default()).with(&acting, &medium);
        ground.mechanisms = ground.mechanisms.map(SandMechanisms::for_prescribed_motion);
        let chord = straight([0.0, 0.0], [0.0, -self.chord], self.width, SEGMENTS);
        // Does the concave side lead? Sand fills a leg that bulges forward and turns backward, or the reverse.
        let concave_leads = self.shape.bulge() * self.omega < 0.0;
        let fill = if concave_leads { mechanisms.concave_fill } else { 0.0 };
        let (sin, cos) = mechanisms.slope.sin_cos();
        let load = |theta: f64| {
            // In the surface's frame the leg is inclined by the slope; the forces are rotated back.
            let at =
                |s: &[Segment]| rotating_leg(&ground, s, theta - mechanisms.slope, self.omega, self.hip_height * cos);
            let own = at(&segments);
            let l = if fill == 0.0 { own } else { own.mixed(&at(&chord), fill) };
            Load { fx: l.fx * cos - l.fz * sin, fz: l.fx * sin + l.fz * cos, ty: l.ty }
        };
        Ok((-HALF_SWEEP..=HALF_SWEEP).map(|i| f64::from(i) * 0.01).map(|theta| (theta, load(theta))).collect())
    }
}

impl Load {
    /// Weighted mean of two loads: (1 − share) of this one and `share` of the other.
    fn mixed(&self, other: &Load, share: f64) -> Load {
        let mix = |a: f64, b: f64| (1.0 - share) * a + share * b;
        Load { fx: mix(self.fx, other.fx), fz: mix(self.fz, other.fz), ty: mix(self.ty, other.ty) }
    }
}
