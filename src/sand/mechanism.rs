//! Mechanisms that plain resistive force theory leaves out: the one list that simulator, diagnosis, report and
//! documents read. A new mechanism is one new entry of [`CATALOG`]'s table and, if it acts in the sand, one line in
//! [`SandMechanisms::stress`].
//!
//! Every parameter is 0 when its mechanism is off. The equations of the sand side are here; those of the measuring
//! side (sensors, log, drive) are in `diagnose::forward`.

use super::contact::Ground;
use crate::error::{Error, Result, check_range};
use crate::number::{Real, Vec3};
use serde::{Deserialize, Serialize};

/// Where a mechanism acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// In the sand: the simulator can switch it on.
    Sand,
    /// In the force sensor, the depth reference or the log.
    Sensor,
    /// In the motor or the leg's mounting.
    Drive,
}

/// One entry of the list.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Mechanism {
    pub id: &'static str,
    pub symbol: &'static str,
    /// SI; "1" where dimensionless.
    pub unit: &'static str,
    /// Least and greatest value a fit may take: physical where physics says so, otherwise our choice of a wide guard.
    pub bounds: [f64; 2],
    /// A strength one would call typical: steps of numerical derivatives and prior scales are multiples of it.
    pub typical: f64,
    pub side: Side,
    /// Can force logs show it?
    pub intrusion: bool,
    /// Can walking runs show it?
    pub walking: bool,
    /// Optional columns of the intrusion log without which it cannot be tested.
    pub columns: &'static [&'static str],
    pub law: &'static str,
    pub source: &'static str,
}

fn is_neutral(value: &f64) -> bool {
    *value == 0.0
}

macro_rules! mechanisms {
    ($($id:ident: $symbol:literal, $unit:literal, [$low:expr, $high:expr], $typical:expr, $side:ident,
       intrusion $intrusion:literal, walking $walking:literal, $columns:expr, $law:literal, $source:literal;)*) => {
        /// Every mechanism, in the order of [`Mechanisms::values`].
        pub const CATALOG: [Mechanism; Mechanisms::COUNT] = [$(Mechanism {
            id: stringify!($id), symbol: $symbol, unit: $unit, bounds: [$low, $high], typical: $typical,
            side: Side::$side, intrusion: $intrusion, walking: $walking, columns: &$columns, law: $law, source: $source,
        }),*];

        /// Strengths of all mechanisms; the default is plain resistive force theory.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields, default)]
        pub struct Mechanisms {
            $(#[doc = concat!($symbol, " [", $unit, "]: ", $law)]
            #[serde(skip_serializing_if = "is_neutral")]
            pub $id: f64,)*
        }

        impl Mechanisms {
            pub const COUNT: usize = [$(stringify!($id)),*].len();

            /// In the order of [`CATALOG`].
            pub fn values(&self) -> [f64; Self::COUNT] {
                [$(self.$id),*]
            }

            /// The inverse of [`Self::values`].
            pub fn from_values(values: [f64; Self::COUNT]) -> Self {
                let [$($id),*] = values;
                Self { $($id),* }
            }
        }
    };
}

mechanisms! {
    inertial_drag: "λ", "1", [0.0, 30.0], 0.5, Sand, intrusion true, walking true, [],
        "extra stress −λ ρ v_n² n on the leading face", "Agarwal et al. 2021 (dynamic RFT): 1.1 oblique plate, 1.4 sphere, 2.8 plane-strain plate";
    concave_fill: "χ", "1", [0.0, 1.0], 0.2, Sand, intrusion true, walking true, [],
        "legs whose concave side leads: F = (1−χ) F_segments + χ F_straight hip–tip chord", "our form of the cause named in Li et al. 2012 (grains held in a concave leading surface)";
    footprint: "κ", "1", [-2.0, 1.0], 0.2, Sand, intrusion true, walking false, ["pass", "pass_dx"],
        "re-used ground (pass ≥ 2): stress × (1 − κ e^(−pass_dx/3 cm))", "our choice: no published law found";
    added_mass: "C_a", "1", [0.0, 30.0], 0.5, Sand, intrusion true, walking false, [],
        "extra stress −C_a ρ w (dv_n/dt) n, w the segment's width", "after Aguilar & Goldman 2016 (added mass of jumping feet); form ours";
    depth_power: "p − 1", "1", [-0.8, 2.0], 0.1, Sand, intrusion true, walking true, [],
        "|z| → z0 (|z|/z0)^p, z0 = 2 cm", "power-law depth dependence, e.g. Hill, Yeung & Koehler 2005; form ours";
    cohesion: "c", "Pa", [0.0, 1e4], 50.0, Sand, intrusion true, walking true, [],
        "stress −c tanh(v_n / 1 mm/s) n at any depth", "≈ 150 Pa for 1 mm beads, ≈ 600 Pa for fine angular sand; form ours";
    scale: "ζ/ζ0 − 1", "1", [-0.9, 10.0], 0.1, Sand, intrusion true, walking true, [],
        "stress × (1 + value)", "Li, Zhang & Goldman 2013: media differ by ζ; batches by 20–40 %";
    packing_grad: "g", "1", [-0.9, 0.9], 0.1, Sand, intrusion true, walking true, ["x_bed"],
        "stress × (1 + g (x_bed + x)/10 cm)", "packing changes stress: Gravish, Umbanhowar & Goldman 2010; linear form ours";
    slope: "σ", "rad", [-0.5, 0.5], 0.03, Sand, intrusion true, walking true, [],
        "surface rises toward +x: depth = (x tan σ − z) cos σ, stress evaluated in the surface's frame", "geometry";
    rate_log: "b", "1", [-0.25, 1.0], 0.03, Sand, intrusion true, walking true, [],
        "stress × (1 + b ln(1 + |v|/1 cm/s))", "logarithmic rate dependence of dry friction; form ours";
    friction_clip: "1/μ", "1", [0.0, 10.0], 1.0, Sand, intrusion true, walking true, [],
        "tangential stress capped at μ × normal stress", "Coulomb friction of the intruder's surface, as in Agarwal, Goldman & Kamrin 2023";
    bias_x: "b_x", "N", [-1e3, 1e3], 0.05, Sensor, intrusion true, walking false, [],
        "constant offset of Fx", "force sensor zero";
    bias_z: "b_z", "N", [-1e3, 1e3], 0.05, Sensor, intrusion true, walking false, [],
        "constant offset of Fz", "force sensor zero";
    sensor_tilt: "φ", "rad", [-0.8, 0.8], 0.03, Sensor, intrusion true, walking false, [],
        "measured (Fx, Fz) rotated counter-clockwise", "geometry";
    depth_zero: "d", "m", [-0.05, 0.05], 0.001, Sensor, intrusion true, walking false, [],
        "true depth = logged depth + value", "error of the surface's height";
    delay: "τ_d", "s", [0.0, 1.0], 0.002, Sensor, intrusion true, walking false, [],
        "force log late", "two clocks";
    lowpass: "τ_f", "s", [0.0, 1.0], 0.002, Sensor, intrusion true, walking false, [],
        "first-order filter on the force channels", "amplifier or logger";
    compliance: "k⁻¹", "rad/(N·m)", [0.0, 5.0], 0.05, Drive, intrusion true, walking false, [],
        "the leg lags the motor angle by value × torque", "elastic mounting";
    motor_torque_limit: "τ_max", "N·m", [0.0, 100.0], 0.02, Drive, intrusion false, walking true, [],
        "hip torque saturates (0: no limit)", "motor data sheet";
}

impl Mechanisms {
    /// Place in [`CATALOG`] of a mechanism's id.
    pub fn index(id: &str) -> Result<usize> {
        let known = CATALOG.map(|m| m.id);
        CATALOG
            .iter()
            .position(|m| m.id == id)
            .ok_or_else(|| Error::unknown("mechanism", id, &known))
    }

    pub fn get(&self, index: usize) -> f64 {
        self.values()[index]
    }

    /// The same with one value changed.
    pub fn with(&self, index: usize, value: f64) -> Self {
        let mut values = self.values();
        values[index] = value;
        Self::from_values(values)
    }

    /// Refuses values outside [`Mechanism::bounds`].
    pub fn validated(self) -> Result<Self> {
        for (m, value) in CATALOG.iter().zip(self.values()) {
            check_range(m.id, value, m.bounds[0]..=m.bounds[1])?;
        }
        Ok(self)
    }

    /// Is nothing switched on in the sand?
    pub fn sand_is_plain(&self) -> bool {
        CATALOG
            .iter()
            .zip(self.values())
            .all(|(m, value)| m.side != Side::Sand || value == 0.0)
    }
}

/// Depth z0 [m] at which `depth_power` leaves the stress as it is.
const DEPTH_REFERENCE: f64 = 0.02;
/// Distance [m] over which a footprint fades.
const FOOTPRINT_REACH: f64 = 0.03;
/// Length [m] that `packing_grad` refers to.
const PACKING_LENGTH: f64 = 0.1;
/// Speed [m/s] that `rate_log` refers to.
const RATE_REFERENCE: f64 = 0.01;
/// Normal speed [m/s] over which cohesion builds up.
const COHESION_SPEED: f64 = 1e-3;

/// Where a segment is and how it moves, beyond its normal and velocity.
#[derive(Clone, Copy)]
pub struct Site<R> {
    /// Below the surface, ≥ 0 [m].
    pub depth: R,
    /// Place in the bed [m]: x_bed + x in force logs, travelled distance in walking.
    pub x: R,
    /// [`footprint`] of the pass; 1 on fresh ground.
    pub footprint: R,
    /// Width w of the segment across the plane of motion [m].
    pub width: R,
    /// dv_n/dt of the leading face [m/s²].
    pub normal_acceleration: R,
}

/// 1 − κ e^(−pass_dx/3 cm) from the second pass on, 1 before.
pub fn footprint(kappa: f64, pass: u32, pass_dx: f64) -> f64 {
    if pass < 2 {
        1.0
    } else {
        1.0 - kappa * (-pass_dx.abs() / FOOTPRINT_REACH).exp()
    }
}

/// Depth [m] of the point (x, z) below a surface through the origin that rises toward +x by σ, given as (sin σ, cos σ):
/// (x tan σ − z) cos σ.
pub fn slope_depth<R: Real>((sin, cos): (f64, f64), x: R, z: R) -> R {
    x * R::splat(sin) - z * R::splat(cos)
}

/// `f` of every lane: for functions [`Real`] does not have. Slow, and only reached while its mechanism is on.
fn by_lane<R: Real>(x: R, f: impl Fn(f64) -> f64) -> R {
    let mut y = x;
    for lane in 0..R::LANES {
        y.set_lane(lane, f(x.lane(lane)));
    }
    y
}

/// The sand side of [`Mechanisms`], ready for evaluation.
#[derive(Clone, Copy)]
pub struct SandMechanisms {
    mechanisms: Mechanisms,
    bulk_density: f64,
}

impl SandMechanisms {
    /// `bulk_density` ρ in kg/m³.
    pub fn new(mechanisms: &Mechanisms, bulk_density: f64) -> Self {
        Self {
            mechanisms: *mechanisms,
            bulk_density,
        }
    }

    /// Stress [Pa] on a submerged thin segment with unit normal `n` and velocity `v`, both in the surface's frame.
    /// Depth-proportional stress carries scale, packing, footprint, rate and the friction cap; inertia, added mass
    /// and cohesion push against the leading face in addition.
    #[inline]
    pub fn stress<R: Real>(&self, ground: &Ground<R>, n: Vec3<R>, v: Vec3<R>, site: &Site<R>) -> Vec3<R> {
        let m = &self.mechanisms;
        let motion = ground.motion(v);
        let mut quasi_static = ground.stress(n, &motion) * (self.depth(site.depth) * self.factor(v, site));
        if m.friction_clip > 0.0 {
            quasi_static = capped(quasi_static, n, 1.0 / m.friction_clip);
        }
        if m.inertial_drag == 0.0 && m.cohesion == 0.0 && m.added_mass == 0.0 {
            return quasi_static;
        }
        let along = n.dot(v);
        let speed = along.abs();
        let density = R::splat(self.bulk_density);
        let mut pressure = R::splat(m.inertial_drag) * density * speed * speed;
        if m.added_mass != 0.0 {
            pressure += R::splat(m.added_mass) * density * site.width * site.normal_acceleration;
        }
        if m.cohesion != 0.0 {
            pressure += R::splat(m.cohesion) * by_lane(speed, |s| (s / COHESION_SPEED).tanh());
        }
        let toward_front = R::select(along.lt(R::zero()), pressure, -pressure);
        n.scale_add(toward_front, quasi_static)
    }

    /// |z| → z0 (|z|/z0)^p
    fn depth<R: Real>(&self, depth: R) -> R {
        let excess = self.mechanisms.depth_power;
        if excess == 0.0 {
            return depth;
        }
        by_lane(depth, |d| {
            DEPTH_REFERENCE * (d.max(0.0) / DEPTH_REFERENCE).powf(1.0 + excess)
        })
    }

    /// Product of all that multiplies the depth-proportional stress.
    fn factor<R: Real>(&self, v: Vec3<R>, site: &Site<R>) -> R {
        let m = &self.mechanisms;
        let mut factor = site.footprint * R::splat(1.0 + m.scale);
        if m.packing_grad != 0.0 {
            factor = factor * R::splat(m.packing_grad / PACKING_LENGTH).mul_add(site.x, R::one());
        }
        if m.rate_log != 0.0 {
            factor = factor
                * by_lane(v.norm_squared(), |v2| {
                    1.0 + m.rate_log * (v2.sqrt() / RATE_REFERENCE).ln_1p()
                });
        }
        factor
    }
}

/// `stress` with its part along the face cut to `mu` times the part along the normal.
fn capped<R: Real>(stress: Vec3<R>, n: Vec3<R>, mu: f64) -> Vec3<R> {
    let normal = stress.dot(n);
    let tangential = stress - n * normal;
    let size = tangential.norm_squared().sqrt();
    let share = (R::splat(mu) * normal.abs() / (size + R::splat(1e-30))).min(R::one());
    tangential.scale_add(share, n * normal)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sand::{Law, Medium, Surface};

    fn ground() -> Ground<f64> {
        Ground::new(Law::Li2013, &Medium::named("poppy-loose").unwrap(), &Surface::default())
    }

    fn stress(m: Mechanisms, v: [f64; 3]) -> Vec3<f64> {
        let site = Site {
            depth: 0.03,
            x: 0.05,
            footprint: 1.0,
            width: 0.02,
            normal_acceleration: 0.0,
        };
        SandMechanisms::new(&m, 600.0).stress(&ground(), Vec3::new(0.6, 0.0, -0.8), Vec3::splat(v), &site)
    }

    #[test]
    fn drag_is_lambda_rho_v_squared_against_the_motion() {
        let v = [0.6, 0.0, -0.8];
        let extra = stress(
            Mechanisms {
                inertial_drag: 2.0,
                ..Default::default()
            },
            v,
        ) - stress(Mechanisms::default(), v);
        // λ ρ v² = 2 · 600 · 1² = 1200 Pa along −n
        assert!((extra.x + 0.6 * 1200.0).abs() < 1e-9 && (extra.z - 0.8 * 1200.0).abs() < 1e-9);
    }

    #[test]
    fn factors_multiply_the_stress() {
        let v = [0.01, 0.0, -0.02];
        let plain = stress(Mechanisms::default(), v);
        let m = Mechanisms {
            scale: 0.5,
            packing_grad: 0.2,
            ..Default::default()
        };
        // 1.5 · (1 + 0.2 · 0.05/0.1) = 1.65
        assert!((stress(m, v).z / plain.z - 1.65).abs() < 1e-12);
        let power = stress(
            Mechanisms {
                depth_power: 1.0,
                ..Default::default()
            },
            v,
        );
        // (3 cm / 2 cm)^1 times the plain stress
        assert!((power.z / plain.z - 1.5).abs() < 1e-12);
    }

    #[test]
    fn friction_cap_leaves_the_normal_part() {
        // Along the face: almost all of the stress is tangential.
        let (v, n) = ([0.04, 0.0, 0.03], Vec3::new(0.6, 0.0, -0.8));
        let (plain, cut) = (
            stress(Mechanisms::default(), v),
            stress(
                Mechanisms {
                    friction_clip: 10.0,
                    ..Default::default()
                },
                v,
            ),
        );
        assert!((plain.dot(n) - cut.dot(n)).abs() < 1e-9);
        let along = |f: Vec3<f64>| (f - n * f.dot(n)).norm_squared().sqrt();
        assert!(along(plain) > 0.2 * plain.dot(n).abs(), "the cap has nothing to cut");
        let tangential = along(cut);
        assert!((tangential - 0.1 * cut.dot(n).abs()).abs() < 1e-9, "{tangential}");
    }

    #[test]
    fn toml_is_neutral_by_default_and_refuses_unknown_keys() {
        let m: Mechanisms = toml::from_str("inertial_drag = 1.1").unwrap();
        assert_eq!(
            m,
            Mechanisms {
                inertial_drag: 1.1,
                ..Default::default()
            }
        );
        assert_eq!(toml::to_string(&m).unwrap().trim(), "inertial_drag = 1.1");
        assert!(toml::from_str::<Mechanisms>("viscosity = 1.0").is_err());
    }
}
