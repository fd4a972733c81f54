//! The parameters that a design study can vary.

use super::Design;
use crate::error::{Error, Result, check_range};
use crate::sand::{Law, Medium};

/// A number or name of a design.
#[derive(Clone, Copy, Debug)]
pub struct Parameter {
    pub name: &'static str,
    /// Unit; empty for names.
    pub unit: &'static str,
    change: ParameterChange,
}

fn number(text: &str) -> Result<f64> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err(Error::invalid("value", format!("{text:?} is no finite number"))),
    }
}

/// Calls `change` with every strip that touches sand.
fn strips(design: &mut Design, change: impl Fn(&mut crate::sim::robot::Strip)) {
    design.robot.leg.link.iter_mut().filter_map(|l| l.sand.as_mut()).for_each(change);
}

/// How a parameter changes a design.
#[derive(Clone, Copy, Debug)]
enum ParameterChange {
    /// Sets this number, within bounds.
    Number(fn(&mut Design) -> &mut f64, [f64; 2]),
    By(fn(&mut Design, &str) -> Result<()>),
}

/// The bounds of a number that the robot or the scene checks itself.
const CHECKED_LATER: [f64; 2] = [f64::MIN, f64::MAX];

const fn sets(name: &'static str, unit: &'static str, bounds: [f64; 2], of: fn(&mut Design) -> &mut f64) -> Parameter {
    Parameter { name, unit, change: ParameterChange::Number(of, bounds) }
}

const fn changes(name: &'static str, unit: &'static str, by: fn(&mut Design, &str) -> Result<()>) -> Parameter {
    Parameter { name, unit, change: ParameterChange::By(by) }
}

impl Parameter {
    pub const ALL: [Parameter; 17] = [
        changes("xi", "°", |d, v| {
            let shape = format!("xi={}", number(v)?);
            crate::sand::LegShape::named(&shape)?;
            strips(d, |s| s.shape.clone_from(&shape));
            Ok(())
        }),
        changes("leg", "", |d, v| {
            d.robot = d.robot.clone().with_leg_shape(v)?;
            Ok(())
        }),
        changes("chord", "m", |d, v| {
            let chord = check_range("chord", number(v)?, 1e-3..=10.0)?;
            let [x, y, z] = d.robot.leg.link.iter().fold([0.0; 3], |sum, l| [0, 1, 2].map(|i| sum[i] + l.reach[i]));
            let scale = chord / (x * x + y * y + z * z).sqrt();
            d.robot.leg.link.iter_mut().for_each(|l| l.reach = l.reach.map(|r| r * scale));
            Ok(())
        }),
        changes("width", "m", |d, v| {
            let width = check_range("width", number(v)?, 1e-4..=10.0)?;
            strips(d, |s| s.width = width);
            Ok(())
        }),
        changes("leg-mass", "kg", |d, v| {
            let mass = check_range("leg-mass", number(v)?, 1e-6..=1e3)?;
            let total: f64 = d.robot.leg.link.iter().map(|l| l.mass).sum();
            d.robot.leg.link.iter_mut().for_each(|l| l.mass *= mass / total);
            Ok(())
        }),
        sets("base-mass", "kg", [1e-4, 1e3], |d| &mut d.robot.base.mass),
        changes("hip-height", "m", |d, v| {
            let height = check_range("hip-height", number(v)?, -10.0..=10.0)?;
            d.robot.hip.iter_mut().for_each(|h| h.position[2] = height);
            Ok(())
        }),
        changes("belly", "m", |d, v| {
            let below = check_range("belly", number(v)?, 0.0..=10.0)?;
            let belly = d.robot.belly.as_mut().ok_or_else(|| Error::invalid("belly", "this robot has no belly"))?;
            belly.below = below;
            Ok(())
        }),
        sets("frequency", "Hz", CHECKED_LATER, |d| &mut d.frequency),
        sets("phase", "rad", CHECKED_LATER, |d| &mut d.phase),
        changes("medium", "", |d, v| {
            d.scene.medium = Medium::named(v)?;
            Ok(())
        }),
        changes("zeta", "N/cm³", |d, v| {
            d.scene.medium = Medium::generic(number(v)?)?;
            Ok(())
        }),
        changes("law", "", |d, v| {
            d.scene.law = Law::named(v)?;
            Ok(())
        }),
        sets("slope", "°", CHECKED_LATER, |d| &mut d.scene.slope_deg),
        sets("payload", "kg", CHECKED_LATER, |d| &mut d.scene.payload),
        sets("torque-limit", "N·m", [1e-6, 1e4], |d| d.robot.servo.torque_limit.get_or_insert_default()),
        sets("kp", "N·m/rad", [0.0, 1e4], |d| &mut d.robot.servo.kp),
    ];

    pub fn named(name: &str) -> Result<Self> {
        let known = Self::ALL.map(|p| p.name);
        Self::ALL.into_iter().find(|p| p.name == name).ok_or_else(|| Error::unknown("parameter", name, &known))
    }

    /// Changes the design; refuses values that no robot or sand can have.
    pub fn set(&self, design: &mut Design, value: &str) -> Result<()> {
        let changed = match self.change {
            ParameterChange::By(change) => change(design, value),
            ParameterChange::Number(of, [low, high]) => number(value).and_then(|x| {
                *of(design) = check_range(self.name, x, low..=high)?;
                Ok(())
            }),
        };
        changed.map_err(|e| match e {
            Error::Invalid { field, reason } if field == "value" => Error::invalid(self.name, reason),
            other => other,
        })
    }

    /// Name and unit for an axis.
    pub fn label(&self) -> String {
        let name = if self.name == "xi" { "ξ" } else { self.name };
        if self.unit.is_empty() { name.into() } else { format!("{name} [{}]", self.unit) }
    }
}

/// A parameter and the values it takes.
#[derive(Clone, Debug)]
pub struct SweepAxis {
    pub parameter: Parameter,
    pub values: Vec<String>,
}

/// Largest number of values on one axis: our choice, which catches typing errors.
const MOST_VALUES: usize = 10_000;

impl SweepAxis {
    /// A parameter's name and its values as text, numbers or names.
    pub fn new(name: &str, values: Vec<String>) -> Result<Self> {
        let parameter = Parameter::named(name)?;
        check_range(&format!("{name}: number of values"), values.len() as f64, 1.0..=MOST_VALUES as f64)?;
        match values.iter().position(String::is_empty) {
            Some(index) => Err(Error::invalid(format!("{name}[{index}]"), "an empty value")),
            None => Ok(Self { parameter, values }),
        }
    }

    /// `NAME=FIRST:LAST:COUNT` or `NAME=VALUE,VALUE,…` (values of a medium that contain commas cannot be listed).
    pub fn parse(text: &str) -> Result<Self> {
        let (name, values) =
            text.split_once('=').ok_or_else(|| Error::invalid("--vary", format!("{text:?} is not NAME=VALUES")))?;
        let parts: Vec<&str> = values.split(':').collect();
        let values = match parts[..] {
            [first, last, count] => {
                let (first, last) = (number(first)?, number(last)?);
                let count: usize =
                    count.parse().map_err(|_| Error::invalid("--vary", format!("{count:?} is no count of values")))?;
                check_range("--vary count", count as f64, 2.0..=MOST_VALUES as f64)?;
                let step = (last - first) / (count - 1) as f64;
                (0..count).map(|i| round(first + step * i as f64, step).to_string()).collect()
            }
            [list] => list.split(',').map(|v| v.trim().to_owned()).collect::<Vec<_>>(),
            _ => return Err(Error::invalid("--vary", format!("{values:?} is neither FIRST:LAST:COUNT nor a list"))),
        };
        Self::new(name, values)
    }

    /// The values as numbers, if all of them are numbers.
    pub fn numbers(&self) -> Option<Vec<f64>> {
        self.values.iter().map(|v| v.parse().ok()).collect()
    }

    /// Least and greatest value of each axis, to search between.
    pub fn ends(axes: &[Self]) -> Result<[Vec<f64>; 2]> {
        let (mut low, mut high) = (Vec::new(), Vec::new());
        for axis in axes {
            let reason = format!("{} needs two numbers to search between", axis.parameter.name);
            let values = axis.numbers().filter(|v| v.len() > 1).ok_or_else(|| Error::invalid("vary", reason))?;
            low.push(values.iter().copied().fold(f64::INFINITY, f64::min));
            high.push(values.iter().copied().fold(f64::NEG_INFINITY, f64::max));
        }
        Ok([low, high])
    }
}

/// Rounds a value to 6 significant digits, and to 0 if it is below a millionth of the step, so that tables read 0.3 and
/// 0, not 0.30000000000000004 and 1e-17.
fn round(value: f64, step: f64) -> f64 {
    if value.abs() < 1e-6 * step.abs() {
        return 0.0;
    }
    format!("{value:.5e}").parse().unwrap_or(value)
}
