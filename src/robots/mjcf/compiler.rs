//! `<compiler>`: units and rules for the whole file, and orientations, which depend on them.

use crate::error::Result;
use crate::notes::Notes;
use crate::xml::Element;
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, Unit, UnitQuaternion, Vector3};

#[derive(Clone, Copy, PartialEq, Eq)]
pub enum FromGeoms {
    Never,
    Always,
    /// Inertia is computed from the geoms if there is no `<inertial>`.
    Auto,
}

pub struct Compiler {
    /// One unit of angle [rad].
    pub angle: f64,
    pub autolimits: bool,
    eulerseq: String,
    pub meshdir: String,
    pub strippath: bool,
    pub from_geoms: FromGeoms,
    /// Numbers of the first and the last group of geoms that contribute to inertia.
    pub groups: [f64; 2],
    pub least_mass: f64,
    pub least_inertia: f64,
    pub balance: bool,
    /// Mass of the whole robot; None: unchanged.
    pub total_mass: Option<f64>,
}

const KNOWN: [&str; 17] = [
    "angle",
    "autolimits",
    "eulerseq",
    "meshdir",
    "assetdir",
    "texturedir",
    "strippath",
    "inertiafromgeom",
    "inertiagrouprange",
    "boundmass",
    "boundinertia",
    "balanceinertia",
    "settotalmass",
    "discardvisual",
    "fusestatic",
    "coordinate",
    "alignfree",
];

impl Compiler {
    /// Reads all `<compiler>` sections; later ones take precedence. The defaults are MuJoCo's.
    pub fn read(root: &Element, notes: &mut Notes) -> Result<Self> {
        let mut c = Self {
            angle: 1f64.to_radians(),
            autolimits: true,
            eulerseq: "xyz".into(),
            meshdir: String::new(),
            strippath: false,
            from_geoms: FromGeoms::Auto,
            groups: [0.0, 5.0],
            least_mass: 0.0,
            least_inertia: 0.0,
            balance: false,
            total_mass: None,
        };
        for section in root.all("compiler") {
            notes.others(section, &KNOWN);
            c.units(section)?;
            let dir = section.get("meshdir").or(section.get("assetdir"));
            c.meshdir = dir.map_or(c.meshdir, str::to_owned);
            c.strippath = flag(section, "strippath")?.unwrap_or(c.strippath);
            c.from_geoms = match section.get("inertiafromgeom") {
                None => c.from_geoms,
                Some("false") => FromGeoms::Never,
                Some("true") => FromGeoms::Always,
                Some("auto") => FromGeoms::Auto,
                Some(other) => return Err(section.wrong("inertiafromgeom", format!("{other:?} is not known"))),
            };
            c.groups = section.numbers("inertiagrouprange")?.unwrap_or(c.groups);
            c.least_mass = section.not_negative("boundmass")?.unwrap_or(c.least_mass);
            c.least_inertia = section.not_negative("boundinertia")?.unwrap_or(c.least_inertia);
            c.balance = flag(section, "balanceinertia")?.unwrap_or(c.balance);
            c.total_mass = section.number("settotalmass")?.filter(|m| *m > 0.0).or(c.total_mass);
        }
        Ok(c)
    }

    fn units(&mut self, section: &Element) -> Result<()> {
        self.angle = match section.get("angle") {
            None => self.angle,
            Some("degree") => 1f64.to_radians(),
            Some("radian") => 1.0,
            Some(other) => return Err(section.wrong("angle", format!("{other:?} is neither degree nor radian"))),
        };
        self.autolimits = flag(section, "autolimits")?.unwrap_or(self.autolimits);
        if let Some(other) = section.get("coordinate").filter(|c| *c != "local") {
            return Err(section.wrong("coordinate", format!("{other:?} is not read: MuJoCo removed it in 2.3.4")));
        }
        if let Some(sequence) = section.get("eulerseq") {
            if sequence.chars().count() != 3 || !sequence.chars().all(|c| "xyzXYZ".contains(c)) {
                return Err(section.wrong("eulerseq", format!("{sequence:?} is not three of x, y, z, X, Y, Z")));
            }
            self.eulerseq = sequence.to_owned();
        }
        Ok(())
    }

    /// `pos` and one of the five orientations.
    pub fn pose(&self, element: &Element) -> Result<Isometry3<f64>> {
        let [x, y, z] = element.numbers("pos")?.unwrap_or_default();
        Ok(Isometry3::from_parts(Translation3::new(x, y, z), self.orientation(element)?))
    }

    /// An element's rotation. A vector shorter than 1e-14, MuJoCo's `mjEPS`, has no direction.
    pub fn orientation(&self, element: &Element) -> Result<UnitQuaternion<f64>> {
        let nothing = |name: &str| element.wrong(name, "has no direction");
        let axis = |name: &str, v: [f64; 3]| Unit::try_new(Vector3::from(v), 1e-14).ok_or_else(|| nothing(name));
        if let Some([w, x, y, z]) = element.numbers("quat")? {
            let q = nalgebra::Quaternion::new(w, x, y, z);
            return UnitQuaternion::try_new(q, 1e-14).ok_or_else(|| nothing("quat"));
        }
        if let Some([x, y, z, angle]) = element.numbers("axisangle")? {
            return Ok(UnitQuaternion::from_axis_angle(&axis("axisangle", [x, y, z])?, angle * self.angle));
        }
        if let Some(angles) = element.numbers::<3>("euler")? {
            let turns = self.eulerseq.chars().zip(angles).map(|(c, a)| {
                let about = match c.to_ascii_lowercase() {
                    'x' => Vector3::x_axis(),
                    'y' => Vector3::y_axis(),
                    _ => Vector3::z_axis(),
                };
                (c.is_ascii_lowercase(), UnitQuaternion::from_axis_angle(&about, a * self.angle))
            });
            // Lower-case letters rotate about axes of the rotating frame, capital letters about fixed axes.
            return Ok(turns.fold(UnitQuaternion::identity(), |q, (along, t)| if along { q * t } else { t * q }));
        }
        if let Some([a, b, c, d, e, f]) = element.numbers("xyaxes")? {
            let x = axis("xyaxes", [a, b, c])?.into_inner();
            let y = Vector3::new(d, e, f);
            let y = (y - x * x.dot(&y)).try_normalize(1e-14).ok_or_else(|| nothing("xyaxes"))?;
            let turn = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, x.cross(&y)]));
            return Ok(UnitQuaternion::from_rotation_matrix(&turn));
        }
        match element.numbers("zaxis")? {
            Some(z) => Ok(from_z(axis("zaxis", z)?)),
            None => Ok(UnitQuaternion::identity()),
        }
    }
}

/// The smallest rotation that takes z to `direction`; for −z, about x. The bound is that of MuJoCo's `mjuu_z2quat`.
pub fn from_z(direction: Unit<Vector3<f64>>) -> UnitQuaternion<f64> {
    let across = Vector3::z().cross(&direction);
    let sin = across.norm();
    let axis = if sin < 1e-10 { Vector3::x_axis() } else { Unit::new_normalize(across) };
    UnitQuaternion::from_axis_angle(&axis, sin.atan2(direction.z))
}

pub fn flag(element: &Element, name: &str) -> Result<Option<bool>> {
    match element.get(name) {
        None => Ok(None),
        Some("true") => Ok(Some(true)),
        Some("false") => Ok(Some(false)),
        Some(other) => Err(element.wrong(name, format!("{other:?} is neither true nor false"))),
    }
}

/// Is a range active? The attribute `name` decides. If it is absent or `auto`, the range is active if it is `given` and
/// `autolimits` is true.
pub fn limited(element: &Element, name: &str, given: bool, autolimits: bool) -> Result<bool> {
    match element.get(name) {
        None | Some("auto") => Ok(given && autolimits),
        Some("true") => Ok(true),
        Some("false") => Ok(false),
        Some(other) => Err(element.wrong(name, format!("{other:?} is not true, false or auto"))),
    }
}
