//! Robots by name. Each robot has a small file of ours, `robots/NAME.toml`. The file says where public packages have
//! the robot's description. It also gives the pose, the gains, what touches sand, and the source and licence of these
//! numbers; they replace the description's values.

use super::posture::Posture;
use super::{Import, Reading, load_from};
use crate::error::{Error, Result};
use serde::Deserialize;
use std::path::{Path, PathBuf};

macro_rules! files {
    ($($name:literal),* $(,)?) => {
        [$(($name, include_str!(concat!("../../robots/", $name, ".toml")))),*]
    };
}

/// Names and files, in alphabetical order.
const ROBOTS: [(&str, &str); 17] = files![
    "a1",
    "a2",
    "aliengo",
    "anymal_b",
    "anymal_c",
    "b1",
    "b2",
    "go1",
    "go2",
    "hyq",
    "hyqreal1",
    "hyqreal2",
    "mini_cheetah",
    "sandcat",
    "solo12",
    "solo8",
    "spot",
];

/// The file of a robot.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NamedRobot {
    /// Maker and model.
    pub title: String,
    /// Where the description lies in folders of packages; the first that exists is read.
    files: Vec<String>,
    /// Where the numbers come from, and their licence.
    pub source: String,
    pub licence: String,
    /// What touches sand; None: feet, lower links and base.
    #[serde(default)]
    touches: Option<Vec<String>>,
    #[serde(default)]
    default_joint_angles: std::collections::BTreeMap<String, f64>,
    #[serde(default)]
    stiffness: std::collections::BTreeMap<String, f64>,
    #[serde(default)]
    damping: std::collections::BTreeMap<String, f64>,
}

/// All names.
pub fn names() -> Vec<&'static str> {
    ROBOTS.iter().map(|r| r.0).collect()
}

impl NamedRobot {
    /// The file of robot `name`; None if there is none.
    pub fn of(name: &str) -> Option<Result<Self>> {
        let text = ROBOTS.iter().find(|r| r.0 == name)?.1;
        Some(toml::from_str(text).map_err(|e| Error::Internal(format!("robots/{name}.toml: {e}"))))
    }

    pub fn posture(&self) -> Posture {
        Posture {
            default_joint_angles: self.default_joint_angles.clone(),
            stiffness: self.stiffness.clone(),
            damping: self.damping.clone(),
        }
    }

    /// The first of the paths in `files` that one of `folders` has.
    pub fn description(&self, folders: &[PathBuf]) -> Option<PathBuf> {
        let in_folder = |file: &String| folders.iter().map(|f| f.join(file)).find(|path| path.is_file());
        self.files.iter().find_map(in_folder)
    }

    /// This robot from a description.
    pub fn load(&self, path: &Path, reading: &Reading) -> Result<Import> {
        Ok(Import { touches: self.touches.clone(), ..load_from(path, &self.posture(), reading)? })
    }
}

/// Folders with descriptions: those of `SANDGAIT_ROBOTS`, packages of the Python environment that is active or to which
/// this program belongs, and the cache of the package robot_descriptions.
pub fn folders() -> Vec<PathBuf> {
    let given = std::env::var_os("SANDGAIT_ROBOTS");
    let mut all: Vec<PathBuf> = given.iter().flat_map(std::env::split_paths).collect();
    let own = std::env::current_exe().ok().and_then(|exe| Some(exe.parent()?.parent()?.to_owned()));
    let active = std::env::var_os("VIRTUAL_ENV").or_else(|| std::env::var_os("CONDA_PREFIX")).map(PathBuf::from);
    for prefix in active.into_iter().chain(own) {
        let libraries = std::fs::read_dir(prefix.join("lib")).into_iter().flatten().flatten().map(|entry| entry.path());
        all.extend(libraries.map(|path| path.join("site-packages")).filter(|path| path.is_dir()));
    }
    let cache = std::env::var_os("ROBOT_DESCRIPTIONS_CACHE").map(PathBuf::from);
    let usual = || Some(PathBuf::from(std::env::var_os("HOME")?).join(".cache/robot_descriptions"));
    all.extend(cache.or_else(usual));
    all
}

/// A robot by name, by name and description (`go2=my/go2.urdf`), or from a file. `more`: further folders with packages of
/// named robots.
pub fn load_any(robot: &str, more: &[PathBuf], reading: &Reading) -> Result<Import> {
    if let Some((name, path)) = robot.split_once('=').filter(|(name, _)| names().contains(name)) {
        let named = NamedRobot::of(name).ok_or_else(|| Error::unknown("robot", name, &names()))??;
        return named.load(Path::new(path), reading);
    }
    let Some(named) = NamedRobot::of(robot) else {
        let path = Path::new(robot);
        if path.extension().is_none() && !path.exists() {
            return Err(Error::unknown("robot", robot, &names()));
        }
        return load_from(Path::new(robot), &Posture::default(), reading);
    };
    let named = named?;
    let folders = [more, &folders()].concat();
    match named.description(&folders) {
        Some(path) => named.load(&path, reading),
        None => Err(Error::invalid(
            "robot",
            format!(
                "{robot:?}: no package with its description is installed: pip install 'sandgait[robots]', or give yours as {robot}=FILE"
            ),
        )),
    }
}
