//! Kinds of quantity in a column, and their units.

/// Kind of quantity in a column, which decides which units the column may have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    Text,
    Number,
    Length,
    Time,
    Angle,
    /// Angles in columns whose name says degrees.
    Degrees,
    AngularSpeed,
    Speed,
    Acceleration,
    Force,
    Torque,
    Mass,
    Frequency,
    Current,
}

impl Quantity {
    /// Units and their factor to the first unit, which is the SI unit except for degrees. All hold by definition.
    pub fn units(self) -> &'static [(&'static str, f64)] {
        const DEGREE: f64 = std::f64::consts::PI / 180.0;
        match self {
            Quantity::Text => &[],
            Quantity::Number => &[("1", 1.0), ("%", 0.01)],
            Quantity::Length => &[("m", 1.0), ("cm", 1e-2), ("mm", 1e-3), ("um", 1e-6), ("µm", 1e-6), ("in", 0.0254)],
            Quantity::Time => &[("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("µs", 1e-6), ("ns", 1e-9), ("min", 60.0)],
            Quantity::Angle => &[("rad", 1.0), ("deg", DEGREE), ("°", DEGREE), ("mrad", 1e-3)],
            Quantity::Degrees => &[("deg", 1.0), ("°", 1.0), ("rad", 1.0 / DEGREE)],
            Quantity::AngularSpeed => {
                &[("rad/s", 1.0), ("deg/s", DEGREE), ("°/s", DEGREE), ("rpm", 6.0 * DEGREE), ("Hz", 360.0 * DEGREE)]
            }
            Quantity::Speed => &[("m/s", 1.0), ("cm/s", 1e-2), ("mm/s", 1e-3)],
            Quantity::Acceleration => {
                // Standard gravity.
                &[("m/s²", 1.0), ("m/s^2", 1.0), ("m/s2", 1.0), ("mm/s²", 1e-3), ("mm/s^2", 1e-3), ("g", 9.80665)]
            }
            Quantity::Current => &[("A", 1.0), ("mA", 1e-3)],
            Quantity::Force => {
                &[("N", 1.0), ("mN", 1e-3), ("kN", 1e3), ("gf", 9.80665e-3), ("kgf", 9.80665), ("lbf", 4.4482216152605)]
            }
            Quantity::Torque => &[
                ("N·m", 1.0),
                ("N*m", 1.0),
                ("N m", 1.0),
                ("Nm", 1.0),
                ("mN·m", 1e-3),
                ("mN*m", 1e-3),
                ("mNm", 1e-3),
                ("N·cm", 1e-2),
                ("N*cm", 1e-2),
                ("Ncm", 1e-2),
                ("N·mm", 1e-3),
                ("N*mm", 1e-3),
                ("Nmm", 1e-3),
            ],
            Quantity::Mass => &[("kg", 1.0), ("g", 1e-3)],
            Quantity::Frequency => &[("Hz", 1.0), ("1/s", 1.0), ("1/min", 1.0 / 60.0)],
        }
    }

    /// Factor from a unit to the first unit of [`Self::units`], if it is a unit of this quantity.
    pub fn factor(self, unit: &str) -> Option<f64> {
        self.units().iter().find(|u| u.0 == unit).map(|u| u.1)
    }
}
