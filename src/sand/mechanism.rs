//! Mechanisms that plain resistive force theory leaves out: the one list that simulator, diagnosis, report and
//! documentation use. To add a mechanism, add a row to [`CATALOG`]'s table. If the mechanism acts on the stress of a
//! segment, also extend `SandMechanisms` in [`super::mechanism_laws`]: a field, the field's first value in `new`, a
//! lane's value in `set_lane`, if needed a flag in `Active`, and the equation in `force`.
//!
//! Every parameter is 0 when its mechanism is off. The equations of the measuring side (sensors, log, drive) are in
//! `diagnose::arm` and `diagnose::forward`.

use crate::error::{Error, Result, check_range};
use serde::{Deserialize, Serialize};

/// Where a mechanism acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// In the sand: a simulation of a robot can switch the mechanism on.
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
    /// SI unit; "1" if dimensionless.
    pub unit: &'static str,
    /// Least and greatest value in a fit: physical bounds where they exist, otherwise our choice of wide bounds.
    pub bounds: [f64; 2],
    /// A typical strength: our choice of an order of magnitude. Steps of numerical derivatives and scales of priors are
    /// multiples of it.
    pub typical: f64,
    pub side: Side,
    /// Can force logs show the mechanism?
    pub intrusion: bool,
    /// Can walking runs show the mechanism?
    pub walking: bool,
    /// Optional columns of a force log that a test of this mechanism needs.
    pub columns: &'static [&'static str],
    pub law: &'static str,
    pub source: &'static str,
    /// Is the value an upper limit? Then 0 switches the mechanism off, and otherwise a lower value acts more strongly.
    pub ceiling: bool,
    /// Power of the speed in its law, if a diagnosis can fit another power to the data.
    pub exponent: Option<f64>,
    /// The reason why the mechanism has no effect on a walking robot; None: it has an effect, or it acts in the sensor.
    pub unfelt: Option<&'static str>,
}

impl Mechanism {
    /// The coordinate of fits, in which 0 is off and more is stronger: the value itself, or the inverse of an upper
    /// limit.
    pub fn coordinate(&self, value: f64) -> f64 {
        if self.ceiling && value > 0.0 { 1.0 / value } else { value }
    }

    /// The value at a coordinate. If the value is an upper limit, a limit above its largest value means that the
    /// mechanism is off.
    pub fn value(&self, coordinate: f64) -> f64 {
        if self.ceiling && coordinate * self.bounds[1] < 1.0 { 0.0 } else { self.coordinate(coordinate) }
    }

    /// Least and greatest coordinate. Fits may lower an upper limit to a fiftieth of its typical value: our choice,
    /// because a motor with that torque just holds its leg level (`xplorer`: 2 g, 4 cm).
    pub fn coordinate_bounds(&self) -> [f64; 2] {
        if self.ceiling { [0.0, 50.0 / self.typical] } else { self.bounds }
    }

    /// The coordinate of a typical strength.
    pub fn coordinate_typical(&self) -> f64 {
        self.coordinate(self.typical)
    }
}

macro_rules! is_ceiling {
    (ceiling) => {
        true
    };
    ($($other:tt)*) => {
        false
    };
}

macro_rules! exponent {
    (exponent $power:literal) => {
        Some($power)
    };
    ($($other:tt)*) => {
        None
    };
}

macro_rules! unfelt {
    (unfelt $why:literal) => {
        Some($why)
    };
    ($($other:tt)*) => {
        None
    };
}

fn is_neutral(value: &f64) -> bool {
    *value == 0.0
}

macro_rules! mechanisms {
    ($($id:ident: $symbol:literal, $unit:literal, [$low:expr, $high:expr], $typical:expr, $side:ident,
       intrusion $intrusion:literal, walking $walking:literal, $columns:expr, $law:literal, $source:literal
       $(, $extra:ident $($said:literal)?)?;)*) => {
        /// Every mechanism, in the order of [`Mechanisms::values`].
        pub const CATALOG: [Mechanism; Mechanisms::COUNT] = [$(Mechanism {
            id: stringify!($id), symbol: $symbol, unit: $unit, bounds: [$low, $high], typical: $typical,
            side: Side::$side, intrusion: $intrusion, walking: $walking, columns: &$columns, law: $law, source: $source,
            ceiling: is_ceiling!($($extra $($said)?)?), exponent: exponent!($($extra $($said)?)?),
            unfelt: unfelt!($($extra $($said)?)?),
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
            /// All switched off.
            pub const PLAIN: Self = Self { $($id: 0.0),* };
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

// A row: `id: symbol, unit, [least, greatest], typical, side, intrusion …, walking …, [columns], law, source`, with the
// meaning of [`Mechanism`]'s fields. The row may end with `exponent P`, `unfelt "reason"` or `ceiling`, which sets the
// field of this name.
mechanisms! {
    inertial_drag: "λ", "1", [0.0, 30.0], 0.5, Sand, intrusion true, walking true, [],
        "extra stress −λ ρ v_n² n on the leading face", "Agarwal et al. 2021 (dynamic RFT): 1.1 oblique plate, 1.4 sphere, 2.8 plane-strain plate",
        exponent 2.0;
    concave_fill: "χ", "1", [0.0, 1.0], 0.2, Sand, intrusion true, walking true, [],
        "legs whose concave side leads: F = (1−χ) F_segments + χ F_straight hip–tip chord", "our form of the cause named in Li et al. 2012 (grains held in a concave leading surface)";
    footprint: "κ", "1", [-2.0, 1.0], 0.2, Sand, intrusion true, walking false, ["pass", "pass_dx"],
        "re-used ground (pass ≥ 2): stress × (1 − κ e^(−pass_dx/3 cm))", "our choice: no published law found",
        unfelt "all ground is fresh except in HexapodTerrain, where randomize.footprint sets the strength of footprints";
    added_mass: "C_a", "1", [0.0, 30.0], 0.5, Sand, intrusion true, walking false, [],
        "extra stress −C_a ρ w (dv_n/dt) n, w the segment's width", "after Aguilar & Goldman 2016 (added mass of jumping feet); form ours",
        unfelt "the engines compute the sand's stress from velocities and not from accelerations";
    depth_power: "p − 1", "1", [-0.8, 2.0], 0.1, Sand, intrusion true, walking true, [],
        "|z| → z0 (|z|/z0)^p, z0 = 2 cm", "power-law depth dependence, e.g. Hill, Yeung & Koehler 2005; form ours";
    cohesion: "c", "Pa", [0.0, 1e4], 50.0, Sand, intrusion true, walking true, [],
        "stress −c tanh(v_n / 1 mm/s) n at any depth", "≈ 150 Pa for 1 mm beads, ≈ 600 Pa for fine angular sand; form ours";
    scale: "ζ/ζ0 − 1", "1", [-0.9, 10.0], 0.1, Sand, intrusion true, walking true, [],
        "stress × (1 + value)", "Li, Zhang & Goldman 2013: media differ by ζ; batches by 20–40 %";
    packing_grad: "g", "1", [-0.9, 0.9], 0.1, Sand, intrusion true, walking true, ["x_bed"],
        "stress × (1 + g (x_bed + x)/10 cm), the factor at least 0.2", "packing changes stress: Gravish, Umbanhowar & Goldman 2010; linear form ours";
    slope: "σ", "rad", [-0.5, 0.5], 0.03, Sand, intrusion true, walking true, [],
        "surface rises toward +x: depth = (x tan σ − z) cos σ, stress evaluated in the surface's frame", "geometry";
    rate_log: "b", "1", [-0.25, 1.0], 0.03, Sand, intrusion true, walking true, [],
        "stress × (1 + b ln(1 + |v|/1 cm/s)), the factor at least 0.2", "logarithmic rate dependence of dry friction; form ours";
    friction_clip: "1/μ", "1", [0.0, 10.0], 1.0, Sand, intrusion true, walking true, [],
        "tangential stress capped at μ × normal stress", "Coulomb friction of the intruder's surface, as in Agarwal, Goldman & Kamrin 2023";
    skid_loss: "κ_s", "1", [0.0, 10.0], 0.7, Sand, intrusion false, walking false, [],
        "vertical part of the stress × 1/(1 + κ_s s²) where a segment is dragged along with its body (slip ratio s = −v·V̂/max(|V|, |v − V|) < 0)", "sand carried away from under a skidding wheel; cause after Agarwal, Karsai, Goldman & Kamrin 2021 (surface lowered by shear flow); form ours, for wheels measured at Carnegie Mellon";
    graze_loss: "κ_g", "1", [0.0, 1.0], 0.6, Sand, intrusion false, walking false, [],
        "stress × (1 − κ_g |n_h|⁸ (1 − |n_h·V̂|/|n_h|)), n_h the horizontal part of the normal, V̂ the direction in which the body travels", "a steep face that travels along itself displaces little sand, and the face before it has already moved that sand; form ours, for wheels measured at Carnegie Mellon";
    slip_bearing: "c_b", "1", [0.0, 3.0], 0.9, Sand, intrusion false, walking false, [],
        "extra stress per depth −c_b (1 − μ)^1.5 ζ s (−m_z) m on the leading side m where a segment runs backward under its body (s > 0); μ from friction_clip", "Vesic 1973: bearing capacity under an inclined load, square footing; Li, Zhang & Goldman 2013 measured 0.375 ζ for a plate drawn along itself";
    sliding_face: "κ", "1", [0.0, 0.09], 0.03, Sand, intrusion false, walking false, [],
        "stress per depth of a solid body's face = clamp(s/κ, 0, 1) × law − max(1 − |s|/κ, 0) ρ g (n_z² + K0 (1 − n_z²)) (n + μ v̂), s = n·v̂, μ of friction_clip or 0.4", "geostatic stress, K0 = 0.5 (Jaky 1944), Coulomb friction and passive failure are textbook; the threshold κ and its value are ours, from simulated grains of 4 mm";
    size_power: "q", "1", [-1.0, 2.0], 0.2, Sand, intrusion true, walking false, [],
        "stress × (w/w0)^q, w = √(length × width) of the intruder (a leg's length is its chord), w0 = 5 cm", "pressure under footings grows with their size (Terzaghi 1943: ½ ρ g B N_γ); power law ours, 1.0 for discs of 60 to 100 mm measured at Carnegie Mellon",
        unfelt "it is defined for an intruder on an arm, not for the bodies of a robot";
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
        "the leg lags the motor angle by value × torque", "elastic mounting",
        unfelt "the engines' legs are rigid";
    motor_torque_limit: "τ_max", "N·m", [0.0, 100.0], 0.02, Drive, intrusion false, walking true, [],
        "hip torque saturates (0: no limit)", "motor data sheet", ceiling;
}

impl Mechanisms {
    /// Index in [`CATALOG`] of a mechanism's id.
    pub fn index(id: &str) -> Result<usize> {
        let known = CATALOG.map(|m| m.id);
        CATALOG.iter().position(|m| m.id == id).ok_or_else(|| Error::unknown("mechanism", id, &known))
    }

    pub fn get(&self, index: usize) -> f64 {
        self.values()[index]
    }

    /// A copy in which the value at `index` is changed.
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

    /// One line for each mechanism that is switched on and has no effect on a walking robot. Mechanisms of a force
    /// log's sensor are left out, because a robot has no such sensor.
    pub fn unfelt_by_walkers(&self) -> Vec<String> {
        let on = CATALOG.iter().zip(self.values()).filter(|(_, value)| *value != 0.0);
        on.filter_map(|(m, _)| m.unfelt.map(|why| format!("{} has no effect on a walking robot: {why}", m.id)))
            .collect()
    }

    /// Are all mechanisms of the sand switched off?
    pub fn sand_is_plain(&self) -> bool {
        CATALOG.iter().zip(self.values()).all(|(m, value)| m.side != Side::Sand || value == 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn toml_is_neutral_by_default_and_refuses_unknown_keys() {
        let m: Mechanisms = toml::from_str("inertial_drag = 1.1").unwrap();
        assert_eq!(m, Mechanisms { inertial_drag: 1.1, ..Default::default() });
        assert_eq!(toml::to_string(&m).unwrap().trim(), "inertial_drag = 1.1");
        assert!(toml::from_str::<Mechanisms>("viscosity = 1.0").is_err());
    }
}
