//! A cause is hidden in the sand, and the sensor or its logger is at fault in some rows.

use crate::{Report, changed, diagnosis, holds, named_alone, testbed};
use sandgait::diagnose::nuisance::CauseKind;
use std::cell::Cell;
use testbed::Hidden;

const DRAG: f64 = 1.0;

fn log() -> String {
    testbed::log(11, &Hidden { causes: vec![("inertial_drag", DRAG)] }, 0.02).noisy
}

/// The drag is named, and a warning says which rows are left out.
fn drag(r: &Report, fault: &str) {
    named_alone(r, "inertial_drag", CauseKind::Sand);
    holds(r, DRAG);
    let said = |finding: &_| format!("{finding:?}").contains(fault) && format!("{finding:?}").contains("left out");
    assert!(r.check.findings.iter().any(said), "{:?}", r.check.findings);
}

/// Every hundredth reading of a channel is far off, each by another amount.
#[test]
fn outliers_do_not_hide_a_cause() {
    let count = Cell::new(0_u32);
    let off = |force: f64| {
        count.set(count.get() + 1);
        let k = count.get();
        if k.is_multiple_of(101) {
            force + 30.0 * (f64::from(k) * 0.7).sin().signum() + f64::from(k % 7)
        } else {
            force
        }
    };
    drag(&diagnosis(&changed(&log(), &["Fz"], off)).report, "differs from both neighbours");
}

/// The force sensor has too small a range for the largest forces.
#[test]
fn a_saturated_sensor_does_not_hide_a_cause() {
    let text = log();
    let largest = Cell::new(0.0_f64);
    changed(&text, &["Fz"], |force| {
        largest.set(largest.get().max(force));
        force
    });
    let range = 0.6 * largest.get();
    drag(&diagnosis(&changed(&text, &["Fz"], |force| force.min(range))).report, "saturated");
}
