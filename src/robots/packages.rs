//! Which folders a robot's description may read.
//!
//! A description comes from strangers, so it cannot name any file of the user's computer. It reads
//!
//! * its checkout: the nearest folder above with `.git` or `pyproject.toml`; or else its ROS package, the nearest folder
//!   with `package.xml`;
//! * without these, folders up to two levels above by relative paths, because descriptions lie in `urdf/`, `urdf/v2/`, … beside
//!   `meshes/`;
//! * the folders that the user allows, by an option or by a variable.
//!
//! It never reads beyond a folder that holds more than one project: the user's home, the folder of temporary files, and
//! folders at the top of the file system.

use crate::error::{Error, Result};
use std::collections::VecDeque;
use std::path::{Path, PathBuf};

/// How a user allows further folders.
pub const DOOR: &str = "--packages FOLDER, option packages, or variable SANDGAIT_PACKAGES";
/// Number of folders, the description's own and those above it, that are tried as a ROS package: our choice, because
/// `package/robots/name/urdf` needs four.
pub const HIGHEST: usize = 4;
/// Levels that a relative path may climb without a checkout: our choice, which `urdf/v2/` needs.
const CLIMB: usize = 2;
/// Usual names of folders with descriptions (ROS, MuJoCo Menagerie): the package is then the folder above.
const CUSTOM: [&str; 6] = ["urdf", "robots", "robot", "mjcf", "xml", "models"];
/// Number of folders and files that a search looks at, and its depth: our choice, more than any package of robots has.
const MOST_SEARCHED: usize = 50_000;
const DEEPEST: usize = 8;

/// How a description is read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reading {
    /// Folders that the user allows besides the robot's own package.
    pub packages: Vec<PathBuf>,
    pub inertia: InertiaSource,
}

/// Which inertias a robot has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum InertiaSource {
    /// Those of the file, but those of the shapes for bodies whose inertia no body can have.
    #[default]
    Plausible,
    /// Those of the file.
    File,
}

impl std::str::FromStr for InertiaSource {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        match name {
            "plausible" => Ok(Self::Plausible),
            "file" => Ok(Self::File),
            other => Err(Error::unknown("inertia", other, &["plausible", "file"])),
        }
    }
}

impl Reading {
    /// The allowed folders, those of `SANDGAIT_PACKAGES`, and, where ROS is set up, those of its packages.
    pub fn folders(&self) -> Result<Vec<PathBuf>> {
        if let Some(none) = self.packages.iter().find(|folder| !folder.is_dir()) {
            return Err(Error::invalid("packages", format!("{} is no folder", none.display())));
        }
        let variables = ["SANDGAIT_PACKAGES", "ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"];
        let given: Vec<_> = variables.iter().filter_map(std::env::var_os).collect();
        let all = self.packages.iter().cloned().chain(given.iter().flat_map(std::env::split_paths));
        Ok(all.filter_map(|folder| folder.canonicalize().ok()).collect())
    }
}

/// The package of a description in `folder`, and the outermost folder that its relative paths may lead to.
pub fn around(folder: &Path) -> [PathBuf; 2] {
    let above = || folder.ancestors().take_while(|f| !is_shared(f));
    let checkout = above().find(|f| f.join(".git").exists() || f.join("pyproject.toml").is_file());
    let ros = || above().take(HIGHEST).find(|f| f.join("package.xml").is_file());
    if let Some(root) = checkout.or_else(ros) {
        return [root, root].map(Path::to_owned);
    }
    let named = folder.file_name().and_then(|n| n.to_str()).is_some_and(|n| CUSTOM.contains(&n));
    let root = above().nth(1).filter(|_| named).unwrap_or(folder);
    let reach = above().take(1 + CLIMB).last().unwrap_or(folder);
    [root, reach].map(Path::to_owned)
}

/// Does the folder hold more than one project?
fn is_shared(folder: &Path) -> bool {
    let real = |path: PathBuf| path.canonicalize().ok();
    let home = std::env::var_os("HOME").map(PathBuf::from).and_then(real);
    let temporary = real(std::env::temp_dir());
    // `/` and `/name` have one and two components.
    folder.components().count() < 3 || [home, temporary].into_iter().flatten().any(|shared| shared.starts_with(folder))
}

/// Has the folder this name, or does its `package.xml` declare it?
pub fn is_called(folder: &Path, name: &str) -> bool {
    let declares = || {
        let text = std::fs::read_to_string(folder.join("package.xml"));
        text.is_ok_and(|text| text.contains(&format!("<name>{name}</name>")))
    };
    folder.file_name().is_some_and(|n| n == name) || declares()
}

/// The folder of package `name` in `root`, the nearest to it.
pub fn below(root: &Path, name: &str) -> Option<PathBuf> {
    if is_called(root, name) {
        return Some(root.to_owned());
    }
    let mut found = None;
    walk(root, |path, is_folder| {
        if is_folder && found.is_none() && is_called(path, name) {
            found = Some(path.to_owned());
        }
        found.is_none()
    });
    found
}

/// The files in `root` that have the file name of `wanted`; of several, those with which `wanted` shares most folders.
pub fn same_name(root: &Path, wanted: &str) -> Vec<PathBuf> {
    let wanted: Vec<String> = wanted.rsplit('/').map(str::to_lowercase).collect();
    let mut all: Vec<(usize, PathBuf)> = Vec::new();
    walk(root, |path, is_folder| {
        let own = path.iter().rev().map(|part| part.to_string_lossy().to_lowercase());
        let shared = own.zip(&wanted).take_while(|(a, b)| a == *b).count();
        if !is_folder && shared > 0 {
            all.push((shared, path.to_owned()));
        }
        true
    });
    let most = all.iter().map(|(shared, _)| *shared).max();
    all.into_iter().filter(|(shared, _)| Some(*shared) == most).map(|(_, path)| path).collect()
}

/// Visits what lies below `root`, level by level, until `visit` returns false. Symbolic links and hidden folders are left
/// out.
fn walk(root: &Path, mut visit: impl FnMut(&Path, bool) -> bool) {
    let (mut folders, mut seen) = (VecDeque::from([(root.to_owned(), 0)]), 0);
    while let Some((folder, depth)) = folders.pop_front() {
        let mut entries: Vec<_> = std::fs::read_dir(&folder).into_iter().flatten().flatten().collect();
        entries.sort_by_key(std::fs::DirEntry::file_name);
        for entry in entries {
            let Ok(kind) = entry.file_type() else { continue };
            seen += 1;
            let hidden = entry.file_name().to_string_lossy().starts_with('.');
            if seen > MOST_SEARCHED || (!kind.is_symlink() && !hidden && !visit(&entry.path(), kind.is_dir())) {
                return;
            }
            if kind.is_dir() && !hidden && depth < DEEPEST {
                folders.push_back((entry.path(), depth + 1));
            }
        }
    }
}
