//! Observations and actions of a robot, mirrored. See "Left and right" in `docs/learning.md`.

use crate::env::Column;
use crate::env::legged::columns::CLOCK;
use crate::env::registry::Blueprint;
use crate::error::{Error, Result};
use crate::sim::tree::TreeModel;
use crate::sim::tree::plain_gait::PlainGait;
use crate::sim::tree::symmetry::{Sides, Symmetry};

/// For each column of a mirror image, the column that its value comes from, and the sign.
#[derive(Clone, Debug, PartialEq)]
pub struct Mirror {
    pub order: Vec<usize>,
    pub signs: Vec<f32>,
}

impl Mirror {
    /// The mirrors of observation rows and of action rows. For a robot from a file they follow from its geometry, for
    /// our own hexapods from the names of their legs.
    pub fn both(blueprint: &Blueprint) -> Result<[Self; 2]> {
        let (spec, model) = (blueprint.task.spec(), blueprint.task.model());
        let Some(robot) = &model.tree else {
            let of_name = |name: &str| Some((image(name), if turned(name) { -1.0 } else { 1.0 }));
            return Ok([Self::of(&spec.observation, of_name)?, Self::of(&spec.action, of_name)?]);
        };
        let legged = LeggedMirror::of(robot, model.joint_names())?;
        if legged.clock.is_none() && spec.observation.iter().any(|column| CLOCK.contains(&&*column.name)) {
            let reason =
                "it mixes the two groups of legs that step in turn, so the phase of their steps has no mirror image";
            return Err(refused(reason));
        }
        let of_name = |name: &str| legged.image(name);
        Ok([Self::of(&spec.observation, of_name)?, Self::of(&spec.action, of_name)?])
    }

    /// What the training says of the mirror of a robot from a file: that it is not the one of left and right, and that masses
    /// differ clearly between both sides.
    pub fn notes(blueprint: &Blueprint) -> Vec<String> {
        let Some(robot) = &blueprint.task.model().tree else { return Vec::new() };
        let Ok(symmetry) = Symmetry::of(robot) else { return Vec::new() };
        let sides = symmetry.sides.name();
        let other = (symmetry.sides != Sides::LeftRight)
            .then(|| format!("the robot is symmetric in {sides}, not in left and right, and so is the policy (--set mirror=false: neither)"));
        let lopsided = symmetry.lopsided(robot).map(|off| {
            format!(
                "the policy is symmetric in {sides}, the robot's masses are not: mirrored, its accelerations differ by {:.0} % \
                 (--set mirror=false learns both sides apart)",
                100.0 * off
            )
        });
        other.into_iter().chain(lopsided).collect()
    }

    /// The mirror of rows with these columns. `image` gives the name of the column that a column's value moves to, and the
    /// sign.
    fn of(columns: &[Column], image: impl Fn(&str) -> Option<(String, f32)>) -> Result<Self> {
        let unknown = |column: &Column| refused(&format!("what the mirror does to {:?} is not known", column.name));
        let images = columns.iter().map(|c| image(&c.name).ok_or_else(|| unknown(c)));
        let images = images.collect::<Result<Vec<(String, f32)>>>()?;
        let place = |(column, (wanted, _)): (&Column, &(String, f32))| {
            let found = columns.iter().position(|c| c.name == *wanted);
            found.ok_or_else(|| refused(&format!("{:?} has no mirror image {wanted:?}", column.name)))
        };
        // The mirror is its own inverse, so a column gets its new value from the column to which its own value moves.
        let order = columns.iter().zip(&images).map(place).collect::<Result<_>>()?;
        Ok(Self { order, signs: images.into_iter().map(|(_, sign)| sign).collect() })
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

/// What a refused setting can be replaced by.
pub const REMEDY: &str = "; --set mirror=false";

fn refused(why: &str) -> Error {
    Error::invalid("mirror", format!("{why}{REMEDY}"))
}

/// The mirror of a robot from a file.
struct LeggedMirror {
    symmetry: Symmetry,
    joints: Vec<String>,
    /// Sign of the clock's columns. If the legs of one group have images of the other, they do the same half a stride later.
    /// None: only some of them have.
    clock: Option<f32>,
}

impl LeggedMirror {
    fn of(robot: &TreeModel, joints: Vec<String>) -> Result<Self> {
        let symmetry = Symmetry::of(robot).map_err(|e| refused(&e.to_string()))?;
        let clock = match PlainGait::of(robot) {
            Some(gait) => gait.swaps(&symmetry.joints).map(|swaps| if swaps { -1.0 } else { 1.0 }),
            None => Some(-1.0),
        };
        Ok(Self { symmetry, joints, clock })
    }

    /// The column of LeggedVelocity that a column's value moves to, and the sign.
    fn image(&self, name: &str) -> Option<(String, f32)> {
        if let Some((what, joint)) = name.split_once(", ")
            && let Some(k) = self.joints.iter().position(|j| j == joint)
        {
            return Some((format!("{what}, {}", self.joints[self.symmetry.joints[k]]), self.symmetry.signs[k] as f32));
        }
        let across = self.symmetry.sides.across();
        if let Some(place) = name.strip_prefix("measured_heights ") {
            let mut place: Vec<String> = place.split(' ').map(str::to_owned).collect();
            let own = place.get_mut(across)?;
            *own = match own.strip_prefix('-') {
                Some(positive) => positive.to_owned(),
                None if own == "0.0" => own.clone(),
                None => format!("-{own}"),
            };
            return Some((format!("measured_heights {}", place.join(" ")), 1.0));
        }
        if CLOCK.contains(&name) {
            return Some((name.to_owned(), self.clock?));
        }
        // One coordinate of a vector changes its sign, and two of a rotation.
        let (axis, vector) = match name {
            "base_lin_vel x" | "projected_gravity x" | "commanded lin_vel_x" => (0, true),
            "base_lin_vel y" | "projected_gravity y" | "commanded lin_vel_y" => (1, true),
            "base_lin_vel z" | "projected_gravity z" => (2, true),
            "base_ang_vel x" => (0, false),
            "base_ang_vel y" => (1, false),
            "base_ang_vel z" | "commanded ang_vel_yaw" => (2, false),
            _ => return None,
        };
        Some((name.to_owned(), if (axis == across) == vector { -1.0 } else { 1.0 }))
    }
}

/// The column of a hexapod that a column's value moves to: left and right change places, and positions to the left change
/// sign.
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
    use crate::env::legged::LeggedVelocity;
    use crate::env::registry::TASK_IDS;
    use crate::env::{Shard, Task};
    use serde_json::{Value, json};

    /// The mirror twice is the identity; values of the right side move to the left, and y changes sign.
    #[test]
    fn the_mirror_of_the_mirror() {
        for id in TASK_IDS.iter().filter(|id| id.contains("Hexapod")) {
            let blueprint = Blueprint::new(id, Value::Null).unwrap();
            let spec = blueprint.task.spec();
            for (mirror, columns) in Mirror::both(&blueprint).unwrap().iter().zip([&spec.observation, &spec.action]) {
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

    /// Mirrored actions take a robot of LeggedVelocity to the mirror image of its next observation: on hard ground, with
    /// measured heights, for many steps.
    #[test]
    fn a_legged_robot_walks_like_its_mirror_image() {
        // In sand the patches of plates are not exactly mirror images: the difference is 3e-3 after two steps.
        for ground in ["rigid"] {
            let options = |sign: f64| {
                let commands = json!({"lin_vel_x": [0.5, 0.5], "lin_vel_y": vec![0.3 * sign; 2], "ang_vel_yaw": vec![0.6 * sign; 2]});
                let mut options =
                    json!({"ground": ground, "angle_noise": 0.0, "domain_rand": null, "commands": commands});
                options["measure_heights"] = true.into();
                // The bound below was measured with this motion.
                options["action_scale"] = 1.0.into();
                options
            };
            let [left, right] = [1.0, -1.0].map(|sign| Blueprint::new(LeggedVelocity::ID, options(sign)).unwrap());
            let [observation, action] = Mirror::both(&left).unwrap();
            let mut shards = [&left, &right].map(|blueprint| Shard::new(blueprint, 1).unwrap());
            shards.iter_mut().for_each(|shard| shard.reset(|_| true, Some(&[1]), |_| None));
            let width = shards[0].actions();
            let mut image = vec![0.0; left.task.spec().observation.len()];
            let mut actions = [vec![0.0; width], vec![0.0; width]];
            for step in 0..40 {
                observation.reflect(&shards[0].rows.observations, &mut image);
                let apart =
                    image.iter().zip(&shards[1].rows.observations).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
                // Differences of rounding grow with time; after 60 steps 3e-3 was seen on rigid ground.
                assert!(apart < 2e-3, "{ground}, step {step}: {apart}");
                let wave = |k: usize| 0.4 * (0.3 * step as f32 + 0.7 * k as f32).sin();
                let [one, other] = &mut actions;
                one.iter_mut().enumerate().for_each(|(k, a)| *a = wave(k));
                action.reflect(one, other);
                assert!(step == 0 || one != other);
                shards.iter_mut().zip(&actions).for_each(|(shard, actions)| shard.step(actions));
            }
            // The robot has moved sideways and turned, so the images differ.
            let own = &shards[0].rows.observations;
            assert!(image.iter().zip(own).any(|(a, b)| (a - b).abs() > 0.05), "{ground}");
        }
    }

    #[test]
    fn what_has_no_mirror_image_is_named() {
        let columns = [Column::free("hip of the left-front leg", "1")];
        let error = Mirror::of(&columns, |name| Some((image(name), 1.0))).unwrap_err().to_string();
        assert_eq!(
            error,
            "mirror: \"hip of the left-front leg\" has no mirror image \"hip of the right-front leg\"; --set mirror=false"
        );
    }
}
