//! The files of a robot: the description, and the files that it names, which must lie in its package.

use crate::error::{Error, Result};
use std::io::Read as _;
use std::path::{Component, Path, PathBuf};

/// Largest description that is read [bytes]: our choice, fifty times the largest robot we have seen.
pub const MOST_TEXT: u64 = 8 << 20;
/// Largest mesh file [bytes]: our choice; the largest we have seen has 28 MiB.
pub const MOST_MESH: u64 = 64 << 20;
/// Number of folders, the description's own and those above it, that are tried as the root of the package: our choice,
/// because `package/robots/name/urdf` needs four.
const HIGHEST: usize = 4;
/// Usual names of folders with descriptions (ROS, MuJoCo Menagerie); meshes lie in folders beside them.
const CUSTOM: [&str; 6] = ["urdf", "robots", "robot", "mjcf", "xml", "models"];

/// A file as it was read.
pub struct SourceFile {
    pub path: PathBuf,
    bytes: Vec<u8>,
}

impl SourceFile {
    /// Reads a regular file of at most `most` bytes.
    pub fn read(path: &Path, most: u64) -> Result<Self> {
        let failed = |e| Error::file(path, e);
        let about = std::fs::metadata(path).map_err(failed)?;
        if !about.is_file() {
            return Err(Error::file(path, "is no file"));
        }
        let mut bytes = Vec::new();
        std::fs::File::open(path).map_err(failed)?.take(most + 1).read_to_end(&mut bytes).map_err(failed)?;
        if bytes.len() as u64 > most {
            return Err(Error::file(path, format!("more than the {} MiB that are read", most >> 20)));
        }
        Ok(Self { path: path.to_owned(), bytes })
    }

    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    pub fn text(&self) -> Result<&str> {
        let text = std::str::from_utf8(&self.bytes).map_err(|_| Error::file(&self.path, "no text in UTF-8"))?;
        Ok(text.trim_start_matches('\u{feff}'))
    }
}

/// The folders in which a robot's files may lie.
pub struct Files {
    /// Folder of the description.
    folder: PathBuf,
    /// Root folder of its package. No file outside of the package is opened.
    root: PathBuf,
}

impl Files {
    /// The folders of a description. Its package begins at the nearest folder above that has a `package.xml`;
    /// without one, at the parent folder if the description's folder has one of the usual names; otherwise at the
    /// description's folder.
    pub fn around(description: &Path) -> Result<Self> {
        let failed = |e| Error::file(description, e);
        let whole = description.canonicalize().map_err(failed)?;
        let folder = whole.parent().unwrap_or(Path::new("/")).to_owned();
        let above = folder.ancestors().take(HIGHEST);
        let marked = above.clone().find(|f| f.join("package.xml").is_file());
        let customary = || {
            let named = folder.file_name().and_then(|n| n.to_str()).is_some_and(|n| CUSTOM.contains(&n));
            folder.parent().filter(|above| named && above.parent().is_some())
        };
        let root = marked.or_else(customary).unwrap_or(&folder).to_owned();
        Ok(Self { folder, root })
    }

    /// Finds a file that a description names. The name is relative to the folder `within`, which is relative to the
    /// description's folder. `package://NAME/…` is searched in the package NAME.
    pub fn find(&self, within: &str, name: &str) -> Result<PathBuf> {
        let (start, rest, root) = match name.strip_prefix("package://").or_else(|| name.strip_prefix("model://")) {
            Some(rest) => {
                // Some files have three slashes.
                let rest = rest.trim_start_matches('/');
                let (package, rest) = rest.split_once('/').unwrap_or((rest, ""));
                let root = self.package(package).ok_or_else(|| {
                    let reason = format!("{name}: the file lies in no folder called {package:?}");
                    Error::file(&self.folder, reason)
                })?;
                (root.clone(), rest, root)
            }
            None => {
                let plain = name.strip_prefix("file://").unwrap_or(name);
                (self.folder.join(within), plain, self.root.clone())
            }
        };
        let wanted = Path::new(rest);
        let absolute = wanted.is_absolute() || Path::new(within).is_absolute();
        let outside = || {
            let hint = match absolute {
                true => "absolute paths are read only inside of it; give one relative to the robot's file",
                false => "a package.xml in a folder above the robot's file makes that folder the package",
            };
            Error::file(wanted, format!("lies outside of the robot's package {}: {hint}", root.display()))
        };
        let whole = plain_path(&start.join(wanted));
        let whole = whole.filter(|w| w.starts_with(&root)).ok_or_else(outside)?;
        // Symbolic links must also stay inside the package.
        let real = whole.canonicalize().map_err(|e| Error::file(&whole, e))?;
        if real.starts_with(&root) { Ok(real) } else { Err(outside()) }
    }

    /// The folder of package `name`: the folder of this name that contains the description, or else the package's root,
    /// if its `package.xml` has this name.
    fn package(&self, name: &str) -> Option<PathBuf> {
        let own = self.folder.ancestors().take(HIGHEST).find(|f| f.file_name().is_some_and(|n| n == name));
        let declared = || {
            let text = SourceFile::read(&self.root.join("package.xml"), MOST_TEXT).ok()?;
            text.text().ok()?.contains(&format!("<name>{name}</name>")).then_some(self.root.as_path())
        };
        own.or_else(declared).map(Path::to_owned)
    }
}

/// The path without `.` and `..`, computed from its text alone; None if it leads above its start.
fn plain_path(path: &Path) -> Option<PathBuf> {
    let mut plain = PathBuf::new();
    for part in path.components() {
        match part {
            Component::CurDir => {}
            Component::ParentDir => {
                if !plain.pop() {
                    return None;
                }
            }
            other => plain.push(other),
        }
    }
    Some(plain)
}
