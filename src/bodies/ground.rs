//! The sand that bodies move in, and its surface in the caller's world.

use crate::error::{Error, Result, check_range};
use crate::number::{Isa, Real, Vec3};
use crate::sand::{Medium, Regularization, SandBed, SandDescription};
use crate::sim::model::Scene;
use crate::sim::tree::relief::{LaneRelief, Relief};
use crate::sim::tree::terrain::{self, Local};
use std::sync::Arc;

/// The surface, and how the force law is regularised.
#[derive(Clone, Debug)]
pub struct GroundOptions {
    /// Height of the surface at x = y = 0 [m]; added to a relief.
    pub height: f64,
    /// Inclination [°]: the surface rises towards +x.
    pub slope_deg: f64,
    /// Heights of the surface; cannot be combined with a slope.
    pub relief: Option<Relief>,
    /// See [`Regularization::rest_speed`] [m/s]. Our choice 2e-6, a fifth of the engines' value, because bodies of any
    /// weight, in any medium, then creep by less than 0.1 mm in 10 s.
    pub rest_speed: f64,
    /// See [`Regularization::leading_edge_gate`]. A value other than the default is only for bodies that are computed
    /// plate by plate.
    pub leading_edge_gate: f64,
}

impl Default for GroundOptions {
    fn default() -> Self {
        let leading_edge_gate = Regularization::SOLID.leading_edge_gate;
        Self { height: 0.0, slope_deg: 0.0, relief: None, rest_speed: 2e-6, leading_edge_gate }
    }
}

/// Sand below a surface.
#[derive(Clone)]
pub struct SandGround {
    description: SandDescription,
    medium: Medium,
    pub(crate) surface: Regularization,
    height: f64,
    /// Upward normal of a flat surface.
    normal: [f64; 3],
    relief: Option<Arc<Relief>>,
    doubles: SandBed<f64>,
    /// The instruction set for `f32`.
    pub(crate) isa: Isa,
}

impl SandGround {
    pub fn new(description: SandDescription, options: GroundOptions) -> Result<Self> {
        // Our choice: at a height of 10 km single precision resolves a millimetre.
        check_range("height", options.height, -1e4..=1e4)?;
        let slope_deg = options.slope_deg + description.mechanisms.slope.to_degrees();
        check_range("slope_deg", slope_deg, -Scene::MAX_SLOPE_DEG..=Scene::MAX_SLOPE_DEG)?;
        // Our choice of bounds: below 1e-9 m/s the drag at rest is too large for single precision, and above 0.1 m/s a
        // standing robot sinks. The gate is compared with a cosine, so it is at most 1; it divides, so it is above 0.
        check_range("rest_speed", options.rest_speed, 1e-9..=0.1)?;
        check_range("leading_edge_gate", options.leading_edge_gate, 1e-3..=1.0)?;
        if options.relief.is_some() && slope_deg != 0.0 {
            return Err(Error::invalid("slope_deg", "a relief defines the slopes; leave out slope_deg"));
        }
        if let Some(relief) = &options.relief {
            relief.check_repose()?;
        }
        let GroundOptions { rest_speed, leading_edge_gate, .. } = options;
        let surface = Regularization { rest_speed, leading_edge_gate, ..Regularization::SOLID };
        let medium = description.medium();
        let (sin, cos) = slope_deg.to_radians().sin_cos();
        Ok(Self {
            doubles: SandBed::new(description.law, &medium, &surface).with(&description.mechanisms, &medium),
            medium,
            surface,
            height: options.height,
            normal: [-sin, 0.0, cos],
            relief: options.relief.map(Arc::new),
            description,
            isa: Isa::choose()?,
        })
    }

    pub fn description(&self) -> &SandDescription {
        &self.description
    }

    /// The first mechanism of the description that depends on the motion of a vehicle. If there is one, the caller must
    /// give the vehicle's velocity.
    pub fn needs_travel(&self) -> Option<&'static str> {
        let m = &self.description.mechanisms;
        let all = [("skid_loss", m.skid_loss), ("graze_loss", m.graze_loss), ("slip_bearing", m.slip_bearing)];
        all.into_iter().find(|(_, value)| *value != 0.0).map(|(id, _)| id)
    }

    /// Mechanisms of the description that have no effect here: they need the history of the ground, a body's
    /// acceleration, a leg's shape, or the size of an intruder. A slope has an effect, unlike on a body in steady motion.
    pub fn without_effect(&self) -> Vec<&'static str> {
        let all = crate::sand::intruder::without_effect(&self.description);
        all.into_iter().filter(|id| *id != "slope").collect()
    }

    /// Height of the surface [m] at a place, and its upward normal.
    pub fn at(&self, x: f64, y: f64) -> (f64, [f64; 3]) {
        let local = self.under_lanes::<f64>();
        let plane = terrain::Surface::under(&local, Vec3::new(x, y, 0.0));
        let ([nx, ny, nz], [px, py, pz]) = (plane.normal.lane(0), plane.point.lane(0));
        (pz - (nx * (x - px) + ny * (y - py)) / nz, [nx, ny, nz])
    }

    /// The sand for one number type.
    pub(crate) fn bed<R: Real>(&self) -> SandBed<R> {
        let m = &self.description.mechanisms;
        SandBed::new(self.description.law, &self.medium, &self.surface).with(m, &self.medium)
    }

    pub(crate) fn double_bed(&self) -> &SandBed<f64> {
        &self.doubles
    }

    pub(crate) fn under_lanes<R: Real>(&self) -> Under<R> {
        let point = Vec3::splat([0.0, 0.0, self.height]);
        Under {
            plane: Local { point, normal: Vec3::splat(self.normal) },
            lift: R::splat(self.height),
            relief: self.relief.as_ref().map(|r| LaneRelief(vec![r.clone(); R::LANES])),
        }
    }
}

/// The surface for one number type.
pub(crate) struct Under<R> {
    plane: Local<R>,
    lift: R,
    relief: Option<LaneRelief>,
}

/// "Flat" here means one plane, which may be inclined.
impl<R: Real> terrain::Surface<R> for Under<R> {
    #[inline(always)]
    fn is_flat(&self) -> bool {
        self.relief.is_none()
    }

    #[inline(always)]
    fn under(&self, point: Vec3<R>) -> Local<R> {
        if self.relief.is_none() {
            return self.plane;
        }
        let mut local = terrain::Surface::under(&self.relief, point);
        local.point.z += self.lift;
        local
    }
}
