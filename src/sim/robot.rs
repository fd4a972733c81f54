//! A robot as its user describes it in a TOML file. Unknown keys are refused.

use super::actuator::Actuator;
use crate::error::{Error, Result, check_range, check_toml};
use crate::sand::LegShape;
use serde::{Deserialize, Serialize};

/// The whole robot; SI units, origin at the base's centre, x forward, y left, z up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Robot {
    pub name: String,
    pub base: Base,
    #[serde(default)]
    pub belly: Option<Belly>,
    pub leg: Leg,
    pub servo: Servo,
    pub hip: Vec<Hip>,
}

/// The trunk: a uniform box.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Base {
    /// [kg], without the legs.
    pub mass: f64,
    /// Length, width, height [m].
    pub size: [f64; 3],
}

/// One-sided plates under the trunk that touch sand.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Belly {
    /// Length, width [m].
    pub size: [f64; 2],
    /// Distance under the base's centre [m].
    pub below: f64,
    /// Number of plates along x and along y.
    pub plates: [usize; 2],
}

/// All legs of a robot are alike; each entry of `hips` mounts one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Leg {
    /// From the hip outward.
    pub link: Vec<Link>,
}

/// One rigid link and the hinge that moves it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Link {
    /// Name of the joint, for observation tables.
    pub joint: String,
    /// Hinge axis in the hip's frame with all angles 0.
    pub axis: [f64; 3],
    /// From this joint to the next, or to the tip [m], in the hip's frame with all angles 0.
    pub reach: [f64; 3],
    /// [kg], spread uniformly over the length.
    pub mass: f64,
    /// Rotor inertia seen at the joint [kg·m²].
    pub armature: f64,
    /// Lowest and highest angle [rad] of a position command; None: the joint turns freely.
    #[serde(default)]
    pub range: Option<[f64; 2]>,
    /// The strip that pushes on sand; None: the link does not touch sand.
    #[serde(default)]
    pub sand: Option<Strip>,
}

/// A thin strip along a link's reach.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Strip {
    /// `L`, `revL`, `C`, `revC`, `flat` or `xi=DEGREES`. With a positive ξ the convex side leads when the joint turns
    /// positively.
    pub shape: String,
    /// [m]
    pub width: f64,
    pub segments: usize,
    /// Direction of the width in the hip's frame; the joint's axis if not given.
    #[serde(default)]
    pub width_axis: Option<[f64; 3]>,
}

/// Position and speed servo at every joint: torque = kp(θ_ref − θ) + kd(ω_ref − ω), clamped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Servo {
    /// [N·m/rad]
    pub kp: f64,
    /// [N·m·s/rad]
    pub kd: f64,
    /// Largest torque [N·m]; no limit if not given.
    #[serde(default)]
    pub torque_limit: Option<f64>,
    /// Largest speed that can be commanded [rad/s]; no limit if not given.
    #[serde(default)]
    pub speed_limit: Option<f64>,
    /// Does the reference wait while the motor is at its torque limit? See [`super::motor::Motor::lag_limit`].
    #[serde(default)]
    pub anti_windup: bool,
    /// The motor behind its gear: see [`Actuator`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stall_torque: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub no_load_speed: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub torque_time: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub torque_constant: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub friction: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub damping: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub efficiency: Option<f64>,
    /// Added to the links' `armature`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotor_inertia: Option<f64>,
}

impl Servo {
    /// The motors of all joints.
    pub fn actuator(&self) -> Actuator {
        let Self { torque_limit, stall_torque, no_load_speed, torque_time, .. } = *self;
        let Self { torque_constant, friction, damping, efficiency, rotor_inertia, .. } = *self;
        Actuator {
            torque_limit,
            stall_torque,
            no_load_speed,
            torque_time,
            torque_constant,
            friction,
            damping,
            efficiency,
            rotor_inertia,
        }
    }

    pub fn set_actuator(&mut self, actuator: &Actuator) {
        let Actuator { torque_limit, stall_torque, no_load_speed, torque_time, .. } = *actuator;
        let Actuator { torque_constant, friction, damping, efficiency, rotor_inertia, .. } = *actuator;
        let Self { kp, kd, speed_limit, anti_windup, .. } = *self;
        *self = Self {
            kp,
            kd,
            torque_limit,
            speed_limit,
            anti_windup,
            stall_torque,
            no_load_speed,
            torque_time,
            torque_constant,
            friction,
            damping,
            efficiency,
            rotor_inertia,
        };
    }
}

/// The mounting of a leg.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Hip {
    pub name: String,
    /// [m] from the base's centre.
    pub position: [f64; 3],
    /// Rotation of the leg's frame about z [°].
    #[serde(default)]
    pub yaw_deg: f64,
    /// Which half of the alternating tripod the leg belongs to.
    pub tripod: Tripod,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Tripod {
    A,
    B,
}

const BUILT_IN: [(&str, &str); 2] =
    [("xplorer", include_str!("robots/xplorer.toml")), ("xplorer18", include_str!("robots/xplorer18.toml"))];

impl Robot {
    /// The reference robot.
    pub const DEFAULT: &'static str = "xplorer";

    /// The leg under the carriage of LegStroke; it cannot walk.
    pub fn stroke_leg() -> Result<Self> {
        Self::from_toml(include_str!("robots/stroke-leg.toml"))
    }

    /// The description of a tree robot, of which only the name is used.
    pub(super) fn bare(name: &str, mass: f64) -> Self {
        let servo = Servo::default();
        let base = Base { mass, size: [0.0; 3] };
        Self { name: name.into(), base, belly: None, leg: Leg { link: Vec::new() }, servo, hip: Vec::new() }
    }

    pub fn names() -> Vec<&'static str> {
        BUILT_IN.iter().map(|r| r.0).collect()
    }

    pub fn built_in(name: &str) -> Result<Self> {
        let text = BUILT_IN.iter().find(|r| r.0 == name).map(|r| r.1);
        Self::from_toml(text.ok_or_else(|| Error::unknown("robot", name, &Self::names()))?)
    }

    /// A built-in robot by name, or the robot in the file `name` if that ends in `.toml`.
    pub fn load(name: &str) -> Result<Self> {
        if name.ends_with(".toml") {
            let path = std::path::Path::new(name);
            return Self::from_toml(&sandgait_base::files::read_text(path)?);
        }
        match BUILT_IN.iter().any(|r| r.0 == name) {
            true => Self::built_in(name),
            false => Err(Self::unknown(name)),
        }
    }

    /// The refusal of a robot that is no hexapod of ours.
    pub fn unknown(name: &str) -> Error {
        match crate::tree::packed::is_packed(name) || [".urdf", ".xml"].iter().any(|ending| name.ends_with(ending)) {
            true => Error::invalid(
                "robot",
                "this task has hexapods with one drive in each leg only: xplorer, xplorer18 or FILE.toml; a robot of a URDF or MJCF file \
                 walks in task LeggedVelocity",
            ),
            false => Error::unknown("robot", name, &[&Self::names()[..], &["FILE.toml"]].concat()),
        }
    }

    pub fn from_toml(text: &str) -> Result<Self> {
        check_toml("robot", text)?;
        let robot: Self =
            toml::from_str(text).map_err(|e| Error::invalid("robot", e.to_string().replace('\n', " ").trim()))?;
        robot.validate()?;
        Ok(robot)
    }

    /// Replaces the shape of every strip (see [`LegShape::named`]).
    pub fn with_leg_shape(mut self, shape: &str) -> Result<Self> {
        LegShape::named(shape)?;
        for strip in self.leg.link.iter_mut().filter_map(|l| l.sand.as_mut()) {
            strip.shape = shape.into();
        }
        Ok(self)
    }

    /// Joints of the whole robot, legs in order of the hips, each from the hip outward.
    pub fn joint_names(&self) -> Vec<String> {
        let name = |h: &Hip, l: &Link| match self.leg.link.len() {
            1 => h.name.clone(),
            _ => format!("{} {}", h.name, l.joint),
        };
        self.hip.iter().flat_map(|h| self.leg.link.iter().map(move |l| name(h, l))).collect()
    }

    /// Is this robot equal to `own`, except for masses, rotor inertias and the servo?
    pub fn is_variant_of(&self, own: &Self) -> bool {
        let mut same = own.clone();
        (same.base.mass, same.servo) = (self.base.mass, self.servo);
        for (same, link) in same.leg.link.iter_mut().zip(&self.leg.link) {
            (same.mass, same.armature) = (link.mass, link.armature);
        }
        same == *self
    }

    /// The ranges are to detect wrong units: our choice, far wider than the range in which RFT was measured.
    pub fn validate(&self) -> Result<()> {
        check_range("base.mass", self.base.mass, 1e-4..=1e3)?;
        for s in self.base.size {
            check_range("base.size", s, 1e-3..=10.0)?;
        }
        if let Some(belly) = &self.belly {
            for s in belly.size {
                check_range("belly.size", s, 1e-3..=10.0)?;
            }
            check_range("belly.below", belly.below, 0.0..=10.0)?;
            for n in belly.plates {
                check_range("belly.plates", n as f64, 1.0..=100.0)?;
            }
        }
        check_range("number of hips", self.hip.len() as f64, 1.0..=12.0)?;
        for hip in &self.hip {
            for p in hip.position {
                check_range("hip.position", p, -10.0..=10.0)?;
            }
            check_range("hip.yaw_deg", hip.yaw_deg, -360.0..=360.0)?;
        }
        check_range("servo.kp", self.servo.kp, 0.0..=1e4)?;
        check_range("servo.kd", self.servo.kd, 0.0..=1e3)?;
        self.servo.actuator().validate("servo")?;
        check_range("servo.speed_limit", self.servo.speed_limit.unwrap_or(1.0), 1e-3..=1e4)?;
        if !matches!(self.leg.link.len(), 1..=3) {
            return Err(Error::invalid(
                "leg.link",
                format!("{} links a leg; 1 to 3 are supported", self.leg.link.len()),
            ));
        }
        self.leg.link.iter().try_for_each(Link::validate)
    }
}

impl Link {
    /// As [`Robot::validate`]. Axes may have rounding errors: our choice, 1 % of the length and 0.001 rad.
    fn validate(&self) -> Result<()> {
        let norm = |v: [f64; 3]| v.iter().map(|c| c * c).sum::<f64>().sqrt();
        check_range("leg.link.axis (length)", norm(self.axis), 0.99..=1.01)?;
        check_range("leg.link.reach (length)", norm(self.reach), 1e-3..=10.0)?;
        check_range("leg.link.mass", self.mass, 1e-6..=1e3)?;
        check_range("leg.link.armature", self.armature, 0.0..=10.0)?;
        if let Some([low, high]) = self.range {
            check_range("leg.link.range", low, -7.0..=7.0)?;
            check_range("leg.link.range", high, low..=7.0)?;
        }
        let Some(strip) = &self.sand else { return Ok(()) };
        check_range("leg.link.sand.segments", strip.segments as f64, 2.0..=200.0)?;
        let width_axis = strip.width_axis.unwrap_or(self.axis);
        check_range("leg.link.sand.width_axis (length)", norm(width_axis), 0.99..=1.01)?;
        let along: f64 = width_axis.iter().zip(self.reach).map(|(w, r)| w * r).sum();
        check_range("leg.link.sand.width_axis (along reach)", along / norm(self.reach), -1e-3..=1e-3)?;
        LegShape::named(&strip.shape)?.segments(norm(self.reach), strip.width, strip.segments).map(drop)
    }
}
