//! The sand that several pushes give.

use super::pressure_law::PressureLaw;
use super::pushes::{OfSize, Pushes};
use crate::sand::mechanism_laws::DEPTH_REFERENCE;

impl Pushes {
    /// ζ [N/cm³] of a sand for bodies of this size, and the mechanism depth_power, whose laws agree with the recommended
    /// one: |z| stands for z0 (|z|/z0)^n. A footing's law has no such form, so it is a line through the origin.
    pub fn sand(&self, size: &OfSize) -> (f64, f64) {
        let [scale, n, q] = self.fitted;
        match self.law {
            PressureLaw::Power | PressureLaw::PowerAndSize => {
                let zeta = (scale + q * size.diameter.ln() + (n - 1.0) * DEPTH_REFERENCE.ln()).exp();
                (1e-6 * zeta, n - 1.0)
            }
            _ => (size.zeta, 0.0),
        }
    }
}
