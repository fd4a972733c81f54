//! Numbers of a row, each declared once with name, unit, bounds and the function that computes it.
//!
//! ```ignore
//! type Figure = fn(&Transition, usize) -> f64;
//! let figures = Features::<Figure>::none()
//!     .free("work", "J", |t, _| t.after.work - t.before.work)
//!     .each(&joints, "hip speed", "rad/s", 9.0, |t, i| t.after.rates[i]);
//! ```

use super::sensors::{Part, Sensor};
use super::spec::Column;

/// A list of numbers, each with a function of type `F` that computes it. The last argument of the function is the
/// number's index in its group.
pub struct Features<F> {
    all: Vec<FeatureColumn<F>>,
    /// Index at which the last added group begins.
    last: usize,
}

struct FeatureColumn<F> {
    column: Column,
    value: F,
    /// Index of the joint, axis or point that the number belongs to.
    place: usize,
}

impl<F: Copy> Features<F> {
    pub fn none() -> Self {
        Self { all: Vec::new(), last: 0 }
    }

    /// One number.
    pub fn one(mut self, name: &str, unit: &'static str, low: f64, high: f64, value: F) -> Self {
        self.last = self.all.len();
        self.all.push(FeatureColumn { column: Column::new(name, unit, low, high), value, place: 0 });
        self
    }

    /// One number without bounds.
    pub fn free(self, name: &str, unit: &'static str, value: F) -> Self {
        self.one(name, unit, f64::NEG_INFINITY, f64::INFINITY, value)
    }

    /// One number that is 0 or 1.
    pub fn flag(self, name: &str, value: F) -> Self {
        self.one(name, "1", 0.0, 1.0, value)
    }

    /// One number for each axis.
    pub fn xyz(self, name: &str, unit: &'static str, bound: f64, value: F) -> Self {
        self.group(Column::xyz(name, unit, bound), value)
    }

    /// One number for each joint.
    pub fn each(self, joints: &[String], name: &str, unit: &'static str, bound: f64, value: F) -> Self {
        self.group(Column::each(joints, name, unit, bound), value)
    }

    /// One number for each of these columns.
    pub fn group(mut self, columns: impl IntoIterator<Item = Column>, value: F) -> Self {
        self.last = self.all.len();
        let group = columns.into_iter().enumerate();
        self.all.extend(group.map(|(place, column)| FeatureColumn { column, value, place }));
        self
    }

    /// Marks the number or group that was added last as values of `sensor`.
    pub fn sensed(self, sensor: Sensor) -> Self {
        self.sensed_as(sensor, Part::Value)
    }

    /// Like [`Self::sensed`], for columns that have the function `part` of the measured value, for example its sine.
    pub fn sensed_as(mut self, sensor: Sensor, part: Part) -> Self {
        self.all[self.last..].iter_mut().for_each(|feature| feature.column.sensor = Some((sensor, part)));
        self
    }

    /// These features, followed by `others`.
    pub fn and(mut self, others: Self) -> Self {
        self.last = self.all.len();
        self.all.extend(others.all);
        self
    }

    pub fn len(&self) -> usize {
        self.all.len()
    }

    pub fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    pub fn columns(&self) -> Vec<Column> {
        self.all.iter().map(|feature| feature.column.clone()).collect()
    }

    /// Fills a row; `call` calls a feature's function with its place.
    pub fn fill(&self, row: &mut [f32], call: impl Fn(F, usize) -> f64) {
        for (out, feature) in row.iter_mut().zip(&self.all) {
            *out = call(feature.value, feature.place) as f32;
        }
    }
}

/// 1 for yes, 0 for no.
pub fn flag(yes: bool) -> f64 {
    f64::from(u8::from(yes))
}
