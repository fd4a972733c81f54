//! Laws of the pressure on a body that is pushed into sand.

use serde::Serialize;

/// The laws of the pressure p that are compared; z is the depth and D the diameter of the body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PressureLaw {
    /// p = ζ |z|: plain resistive force theory.
    Proportional,
    /// p = k |z|^n
    Power,
    /// p = ζ |z| (D/D0)^q
    Size,
    /// p = k |z|^n (D/D0)^q
    PowerAndSize,
    /// p = a D + b |z|: bearing capacity of a round footing (Terzaghi 1943); a D is due to the weight of the sand
    /// beside the footing, b |z| to the depth.
    Footing,
}

impl PressureLaw {
    /// Laws with fewer parameters first.
    pub const ALL: [Self; 5] = [Self::Proportional, Self::Power, Self::Size, Self::Footing, Self::PowerAndSize];

    pub fn formula(self) -> &'static str {
        match self {
            Self::Proportional => "p = zeta |z|",
            Self::Power => "p = k |z|^n",
            Self::Size => "p = zeta |z| (D/D0)^q",
            Self::PowerAndSize => "p = k |z|^n (D/D0)^q",
            Self::Footing => "p = a D + b |z|",
        }
    }

    pub fn parameters(self) -> usize {
        match self {
            Self::Proportional => 1,
            Self::Power | Self::Size | Self::Footing => 2,
            Self::PowerAndSize => 3,
        }
    }

    pub fn knows_size(self) -> bool {
        matches!(self, Self::Size | Self::PowerAndSize | Self::Footing)
    }
}
