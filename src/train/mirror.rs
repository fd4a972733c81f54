//! Observations and actions of a robot mirrored left to right. See "Left and right" in `docs/learning.md`.

use crate::env::{Column, Spec};
use crate::error::{Error, Result};

/// For each column the column with its mirrored value, and the sign.
#[derive(Clone, Debug, PartialEq)]
pub struct Mirror {
    pub order: Vec<usize>,
    pub signs: Vec<f32>,
}

impl Mirror {
    /// The mirrors of observation rows and of action rows.
    pub fn both(spec: &Spec) -> Result<[Self; 2]> {
        Ok([Self::of(&spec.observation)?, Self::of(&spec.action)?])
    }

    fn of(columns: &[Column]) -> Result<Self> {
        let place = |column: &Column| {
            let wanted = image(&column.name);
            let found = columns.iter().position(|c| c.name == wanted);
            let reason = || format!("{:?} has no mirror image {wanted:?}; --set mirror=false", column.name);
            found.ok_or_else(|| Error::invalid("mirror", reason()))
        };
        let order = columns.iter().map(place).collect::<Result<_>>()?;
        let signs = columns.iter().map(|c| if turned(&c.name) { -1.0 } else { 1.0 }).collect();
        Ok(Self { order, signs })
    }

    /// Fills `image` with the mirror images of `rows`.
    pub fn reflect(&self, rows: &[f32], image: &mut [f32]) {
        let width = self.order.len();
        for (row, image) in rows.chunks_exact(width).zip(image.chunks_exact_mut(width)) {
            for ((out, from), sign) in image.iter_mut().zip(&self.order).zip(&self.signs) {
                *out = sign * row[*from];
            }
        }
    }
}

/// The column that a column's value moves to, and the sign: left and right change places, and positions to the left
/// change sign.
fn image(name: &str) -> String {
    const PLACE: &str = " cm to the left";
    if let Some(before) = name.strip_suffix(PLACE)
        && let Some((rest, number)) = before.rsplit_once(' ')
        && let Ok(place) = number.parse::<i64>()
    {
        return format!("{rest} {}{PLACE}", -place);
    }
    name.replace("right", "\0").replace("left", "right").replace('\0', "left")
}

/// The mirror reverses y: vectors change sign along y, rotations about x and z; a coxa rotates about z.
fn turned(name: &str) -> bool {
    let along = |what: &str, axes: &[char]| name.split_once(what).is_some_and(|(_, axis)| axis.starts_with(axes));
    along("gravity direction, body frame, ", &['y'])
        || along("base velocity, body frame, ", &['y'])
        || along("angular velocity, body frame, ", &['x', 'z'])
        || name.contains("coxa")
        || name.contains("yaw")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::registry::{Blueprint, TASK_IDS};
    use serde_json::Value;

    /// The mirror twice is the identity; values of the right side move to the left, and y changes sign.
    #[test]
    fn the_mirror_of_the_mirror() {
        for id in TASK_IDS.iter().filter(|id| id.contains("Hexapod")) {
            let blueprint = Blueprint::new(id, Value::Null).unwrap();
            let spec = blueprint.task.spec();
            for (mirror, columns) in Mirror::both(spec).unwrap().iter().zip([&spec.observation, &spec.action]) {
                let row: Vec<f32> = (0..columns.len()).map(|k| 1.0 + k as f32).collect();
                let (mut once, mut twice) = (row.clone(), row.clone());
                mirror.reflect(&row, &mut once);
                mirror.reflect(&once, &mut twice);
                assert_eq!(row, twice, "{id}");
                assert_ne!(row, once, "{id}");
                for (k, column) in columns.iter().enumerate() {
                    let sides = ["left-", "right-"].map(|side| columns[mirror.order[k]].name.contains(side));
                    assert_eq!(sides[0], column.name.contains("right-"), "{}", column.name);
                    assert_eq!(sides[1], column.name.contains("left-"), "{}", column.name);
                    let y = column.name.ends_with(", y") && !column.name.contains("angular");
                    assert!(!y || mirror.signs[k] < 0.0, "{}", column.name);
                }
            }
        }
    }

    #[test]
    fn what_has_no_mirror_image_is_named() {
        let columns = [Column::free("hip of the left-front leg", "1")];
        let error = Mirror::of(&columns).unwrap_err().to_string();
        assert_eq!(
            error,
            "mirror: \"hip of the left-front leg\" has no mirror image \"hip of the right-front leg\"; --set mirror=false"
        );
    }
}
