//! The camera, which is upright with respect to gravity. By default it follows the robot, beside it and a little in
//! front, at a distance that fits the robot's size.

use crate::error::{Result, check_range};
use crate::sim::frame::V;
use crate::sim::{Model, State};

/// Allowed width and height of a picture [px]: our choice, to bound its memory.
pub const SIZES: std::ops::RangeInclusive<u32> = 16..=4096;

/// # Errors
/// Names the side that is out of [`SIZES`].
pub fn check_size(size: [u32; 2]) -> Result<()> {
    for (name, side) in ["width", "height"].into_iter().zip(size) {
        check_range(name, side.into(), (*SIZES.start()).into()..=(*SIZES.end()).into())?;
    }
    Ok(())
}

/// Default direction to the camera [rad]: the angle about the vertical from the world's x axis, and the angle above the
/// horizon. Our choice: on the right side of a robot that walks along x, a little in front, so that no leg hides
/// another.
const AZIMUTH: f64 = 0.55 - std::f64::consts::FRAC_PI_2;
const ELEVATION: f64 = 0.32;

/// Largest number of elevations that are tried until no dune hides the robot; each is higher than the last by
/// [`ELEVATION`]. Our choice: the fourth is 73°, and a fifth would look down from beyond the vertical.
const HIGHER: u32 = 4;

/// Vertical field of view [rad]: our choice, that of a lens of 32 mm on 35 mm film. A wider one distorts the robot.
const FIELD_OF_VIEW: f64 = 0.72;

/// Distance in robot radii: our choice, because the robot then fills half of the picture's width.
const DISTANCE: f64 = 3.9;

/// Nothing nearer than this is drawn [m]: our choice, because places in a picture are divided by the distance.
const NEAR: f64 = 0.02;

/// Where the camera of a picture stands. What is None has its default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CameraOptions {
    /// Angle about the vertical from the world's x axis to the camera, as seen from its target [°], counter-clockwise:
    /// 0 is ahead, 90 on the left, −90 on the right.
    pub azimuth_deg: Option<f64>,
    /// Angle of the camera above the horizon [°].
    pub elevation_deg: Option<f64>,
    /// Distance from its target [m].
    pub distance: Option<f64>,
    /// Is the target the world's origin, where episodes begin, instead of the robot?
    pub fixed: bool,
}

impl CameraOptions {
    /// # Errors
    /// Names the value that is out of its range. The ranges are our choice: above the horizon, and as far as a robot can
    /// be seen.
    pub fn check(self) -> Result<Self> {
        for (name, value, range) in [
            ("azimuth_deg", self.azimuth_deg, -360.0..=360.0),
            ("elevation_deg", self.elevation_deg, 1.0..=89.0),
            ("distance", self.distance, 0.01..=1000.0),
        ] {
            value.map_or(Ok(0.0), |v| check_range(&format!("camera.{name}"), v, range))?;
        }
        Ok(self)
    }

    /// The middle of the picture along x and y [m].
    pub fn target(&self, state: &State) -> [f64; 2] {
        if self.fixed { [0.0; 2] } else { [state.position[0], state.position[1]] }
    }

    fn azimuth(&self) -> f64 {
        self.azimuth_deg.map_or(AZIMUTH, f64::to_radians)
    }
}

/// A camera without distortion.
pub struct Camera {
    eye: V,
    right: V,
    up: V,
    forward: V,
    /// Size in the picture of a length of 1 m at a distance of 1 m [px].
    focal: f64,
    middle: [f64; 2],
    target: V,
}

/// A point of the picture [px], y downward, and its distance along the line of sight [m].
pub type ScreenPoint = ([f32; 2], f64);

/// How far feet may stand from the middle of a robot from a file, in standing heights, before the camera moves away: our choice. Dogs'
/// stand nearer, those of a low robot with legs to the sides farther out.
const WIDE: f64 = 1.5;
/// The same for the height of a robot. At [`DISTANCE`] and [`ELEVATION`] the upper edge of a picture shows what is 1.63 standing heights
/// above the ground, and a tenth is room for the text: humanoids have their base in the middle.
const TALL: f64 = 1.45;

/// Half of the robot's length with extended legs [m]; for a robot from a file, its standing height, or more if its legs reach far or much
/// of it is above its base.
pub fn radius(model: &Model) -> f64 {
    if let Some(tree) = &model.tree {
        return tree
            .standing_height(&tree.stance.angles)
            .max(tree.reach() / WIDE)
            .max(tree.tallness() / TALL)
            .max(1e-3);
    }
    let reach = |chain: &Vec<crate::sim::model::LinkBody>| {
        chain[0].joint.norm() + chain.iter().map(|b| b.reach.norm()).sum::<f64>()
    };
    model.legs.iter().map(reach).fold(0.5 * V::from(model.robot.base.size).norm(), f64::max)
}

impl Camera {
    /// Looks at the robot above the surface, or at a fixed point. Follows the robot's position, not its rotation.
    pub fn of(options: &CameraOptions, model: &Model, state: &State, [width, height]: [u32; 2]) -> Self {
        let radius = radius(model);
        let up = -model.gravity.normalize();
        let ahead = (V::x() - up * up.x).normalize();
        let left = up.cross(&ahead);
        let [x, y] = options.target(state);
        let target = V::new(x, y, 0.25 * radius + model.surface_height(x, y));
        let (sin, cos) = options.azimuth().sin_cos();
        let at = |elevation: f64| {
            let away = (ahead * cos + left * sin) * elevation.cos() + up * elevation.sin();
            Self::towards(target, away, up, options.distance.ok_or(radius), [width, height])
        };
        if let Some(elevation) = options.elevation_deg {
            return at(elevation.to_radians());
        }
        // Dunes must not hide the robot.
        let clear = |camera: &Self| {
            let along = (1..=8).map(|k| target + (camera.eye - target) * (f64::from(k) / 8.0));
            along.into_iter().all(|p| p.z > model.surface_height(p.x, p.y) + 0.1 * radius)
        };
        (0..HIGHER).map(|k| at(ELEVATION * f64::from(1 + k))).find(clear).unwrap_or_else(|| at(ELEVATION))
    }

    /// Looks at `target` from the direction `away`. `distance`: `Ok` has the distance [m]; `Err` has half of a robot's
    /// length [m], to which the distance is fitted.
    fn towards(target: V, away: V, up: V, distance: std::result::Result<f64, f64>, [width, height]: [u32; 2]) -> Self {
        let forward = -away;
        let right = forward.cross(&up).normalize();
        let focal = f64::from(height) / (2.0 * (FIELD_OF_VIEW / 2.0).tan());
        // For a narrow picture the camera is further away.
        let narrow = (4.0 / 3.0 * f64::from(height) / f64::from(width)).max(1.0);
        Self {
            eye: target + away * distance.unwrap_or_else(|radius| DISTANCE * radius * narrow),
            up: right.cross(&forward),
            right,
            forward,
            focal,
            middle: [f64::from(width) / 2.0, f64::from(height) / 2.0],
            target,
        }
    }

    /// Looks at a robot of this half length, centred at `target`, on level ground; by default from its right front.
    pub fn around(options: &CameraOptions, target: V, radius: f64, [width, height]: [u32; 2]) -> Self {
        let (sin, cos) = options.azimuth().sin_cos();
        let elevation = options.elevation_deg.map_or(ELEVATION, f64::to_radians);
        let away = V::new(cos * elevation.cos(), sin * elevation.cos(), elevation.sin());
        Self::towards(target, away, V::z(), options.distance.ok_or(radius), [width, height])
    }

    /// The point that the camera looks at.
    pub fn target(&self) -> V {
        self.target
    }

    /// Distance along the line of sight [m].
    pub fn depth(&self, p: V) -> f64 {
        (p - self.eye).dot(&self.forward)
    }

    /// Position of a point in the picture; None if it is behind the camera.
    pub fn see(&self, p: V) -> Option<ScreenPoint> {
        let depth = self.depth(p);
        (depth > NEAR).then(|| (self.place(p), depth))
    }

    fn place(&self, p: V) -> [f32; 2] {
        let ray = p - self.eye;
        let scale = self.focal / ray.dot(&self.forward);
        let [x, y] = [self.middle[0] + ray.dot(&self.right) * scale, self.middle[1] - ray.dot(&self.up) * scale];
        [x as f32, y as f32]
    }

    /// Distance along the line of sight at which a point of the picture [px] shows the level surface z = 0; infinite
    /// above the horizon.
    pub fn level(&self, at: [f64; 2]) -> f64 {
        let distance = -self.eye.z / self.sight(at).z;
        if distance > 0.0 { distance } else { f64::INFINITY }
    }

    /// What a point of the picture [px] shows at this distance along the line of sight [m]; None: the sky.
    pub fn point(&self, at: [f64; 2], distance: f64) -> Option<V> {
        distance.is_finite().then(|| self.eye + self.sight(at) * distance)
    }

    /// Length of the level surface that a pixel covers at this distance along the line of sight [m].
    pub fn blur(&self, distance: f64) -> f64 {
        distance * distance / (self.focal * self.eye.z.abs().max(NEAR))
    }

    /// Direction to a point of the picture [px], with length 1 along the line of sight.
    fn sight(&self, [x, y]: [f64; 2]) -> V {
        let [u, v] = [(x - self.middle[0]) / self.focal, (self.middle[1] - y) / self.focal];
        self.forward + self.right * u + self.up * v
    }

    /// A polygon in the picture, without the part behind the camera; None if nothing is left.
    pub fn polygon(&self, corners: &[V]) -> Option<Vec<[f32; 2]>> {
        let inside = clip(corners, |p| self.depth(p) - 1.01 * NEAR);
        (inside.len() > 1).then(|| inside.iter().map(|p| self.place(*p)).collect())
    }

    /// Does a face with outward normal `n` at `p` face the camera?
    pub fn faces(&self, p: V, n: V) -> bool {
        (self.eye - p).dot(&n) > 0.0
    }

    /// Distance from the camera [m].
    pub fn distance(&self, p: V) -> f64 {
        (p - self.eye).norm()
    }
}

/// The part of a convex polygon, or of a line, where `inside` is positive (Sutherland & Hodgman 1974).
pub fn clip(corners: &[V], inside: impl Fn(V) -> f64) -> Vec<V> {
    let mut kept = Vec::with_capacity(corners.len() + 1);
    for (i, &to) in corners.iter().enumerate() {
        let from = corners[(i + corners.len() - 1) % corners.len()];
        let [a, b] = [inside(from), inside(to)];
        if (a > 0.0) != (b > 0.0) {
            kept.push(from + (to - from) * (a / (a - b)));
        }
        if b > 0.0 {
            kept.push(to);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sand::Medium;
    use crate::sim::Robot;
    use crate::sim::model::Scene;

    fn camera(slope_deg: f64) -> Camera {
        let scene = Scene { slope_deg, ..Scene::flat(Medium::named("poppy-loose").unwrap()) };
        let model = Model::new(&Robot::load("xplorer").unwrap(), &scene).unwrap();
        Camera::of(&CameraOptions::default(), &model, &State::at_rest(0.03, &model.tripod_angles()), [480, 360])
    }

    /// Each option does what it says; the others keep their defaults.
    #[test]
    fn the_camera_stands_where_the_options_say() {
        let model = Model::new(&Robot::load("xplorer").unwrap(), &Scene::flat(Medium::named("poppy-loose").unwrap()));
        let model = model.unwrap();
        let mut state = State::at_rest(0.03, &model.tripod_angles());
        state.position[0] = 0.7;
        let eye = |options: CameraOptions| {
            let camera = Camera::of(&options.check().unwrap(), &model, &state, [480, 360]);
            camera.eye - camera.target
        };
        let option = CameraOptions { elevation_deg: Some(30.0), distance: Some(2.0), ..CameraOptions::default() };
        for (azimuth, [x, y]) in [(0.0, [1.0, 0.0]), (90.0, [0.0, 1.0]), (-90.0, [0.0, -1.0]), (180.0, [-1.0, 0.0])] {
            let away = eye(CameraOptions { azimuth_deg: Some(azimuth), ..option });
            let level = 3_f64.sqrt();
            assert!((away - V::new(x * level, y * level, 1.0)).norm() < 1e-12, "{azimuth}: {away}");
        }
        let default = eye(CameraOptions::default());
        assert!(
            (eye(CameraOptions { distance: Some(1.0), ..CameraOptions::default() }) - default.normalize()).norm()
                < 1e-12
        );
        for fixed in [false, true] {
            let camera = Camera::of(&CameraOptions { fixed, ..option }, &model, &state, [480, 360]);
            assert_eq!(camera.target.x, if fixed { 0.0 } else { 0.7 });
        }
        let wrong = CameraOptions { elevation_deg: Some(-3.0), ..option };
        assert_eq!(wrong.check().unwrap_err().to_string(), "camera.elevation_deg: -3 is outside [1, 89]");
    }

    /// In the picture, forward is to the right, the robot's left is farther away, up is up, and a slope rises to the
    /// right.
    #[test]
    fn the_picture_is_the_right_way_up() {
        let level = camera(0.0);
        let at = |c: &Camera, x, y, z| c.see(V::new(x, y, z)).unwrap();
        let (middle, _) = at(&level, 0.0, 0.0, 0.0);
        assert!((middle[0] - 240.0).abs() < 1.0 && (middle[1] - 180.0).abs() < 60.0, "{middle:?}");
        assert!(at(&level, 0.05, 0.0, 0.0).0[0] > middle[0] + 20.0);
        assert!(at(&level, 0.0, 0.0, 0.05).0[1] < middle[1] - 20.0);
        assert!(at(&level, 0.0, 0.05, 0.0).1 > at(&level, 0.0, -0.05, 0.0).1);
        let rise = |c: &Camera| at(c, -0.1, 0.0, 0.0).0[1] - at(c, 0.1, 0.0, 0.0).0[1];
        assert!(rise(&camera(20.0)) > rise(&level) + 20.0);
        assert!(rise(&camera(-20.0)) < rise(&level) - 20.0);
    }

    /// What is [`TALL`] radii high is below the text in the picture.
    #[test]
    fn a_tall_robot_fits() {
        let ground = V::new(0.0, 0.0, -0.25);
        let camera = Camera::around(&CameraOptions::default(), V::zeros(), 1.0, [480, 360]);
        let top = camera.see(ground + V::z() * TALL).unwrap().0[1];
        assert!((20.0..40.0).contains(&top), "{top}");
    }

    #[test]
    fn clipping_keeps_the_inside() {
        let square = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|[x, z]| V::new(x, 0.0, z));
        assert_eq!(clip(&square, |_| 1.0).len(), 4);
        assert!(clip(&square, |_| -1.0).is_empty());
        let above = clip(&square, |p| p.z);
        assert_eq!(above.len(), 4);
        assert!(above.iter().all(|p| p.z >= 0.0) && above.iter().filter(|p| p.z == 0.0).count() == 2);
    }
}
