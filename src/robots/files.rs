//! The files of a robot: the description, and the files that it names, which must lie in its package or in a folder that
//! the user allows.

use super::packages::{self, Reading};
use crate::error::{Error, Result};
use encoding_rs::{Encoding, UTF_8, UTF_16BE, UTF_16LE, WINDOWS_1252};
use std::cell::RefCell;
use std::path::{Component, Path, PathBuf};

pub use sandgait_base::files::MOST_TEXT;

/// Largest mesh file [bytes]: our choice; the largest we have seen has 28 MiB.
pub const MOST_MESH: u64 = 64 << 20;

/// The kinds of addresses that name files of the package or of this computer.
const SCHEMES: [&str; 3] = ["package", "model", "file"];

/// A file as it was read.
pub struct SourceFile {
    pub path: PathBuf,
    bytes: Vec<u8>,
}

impl SourceFile {
    /// Reads a regular file of at most `most` bytes.
    pub fn read(path: &Path, most: u64) -> Result<Self> {
        Ok(Self { path: path.to_owned(), bytes: sandgait_base::files::read_regular(path, most)? })
    }

    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    pub fn text(&self) -> Result<&str> {
        let text = std::str::from_utf8(&self.bytes).map_err(|_| Error::file(&self.path, "no text in UTF-8"))?;
        Ok(text.trim_start_matches('\u{feff}'))
    }

    /// Why the file cannot be `what`; None: it may be.
    pub fn stand_in(&self, what: &str) -> Option<String> {
        let bytes = &self.bytes;
        let start = String::from_utf8_lossy(&bytes[..bytes.len().min(200)]).trim_start().to_lowercase();
        if start.is_empty() && bytes.len() < 200 {
            return Some("is empty: download it again".into());
        }
        if start.starts_with("version https://git-lfs") {
            return Some(format!("is a Git LFS pointer in place of {what}: run `git lfs pull` in its folder"));
        }
        let page = ["<!doctype html", "<html", "<head", "<body"].iter().any(|tag| start.starts_with(tag));
        if page {
            return Some(format!("is a web page in place of {what}: download the file itself (on GitHub, \"raw\")"));
        }
        // What servers answer in place of a file.
        let answer = [
            "404",
            "403",
            "not found",
            "{\"message\"",
            "access denied",
            "<?xml version=\"1.0\" encoding=\"utf-8\"?><error",
        ];
        let said = start.lines().next().unwrap_or_default();
        let short = bytes.len() < 2000 && answer.iter().any(|text| start.starts_with(text));
        short.then(|| format!("is a server's answer in place of {what}: {said:?}; download it again"))
    }

    /// The text of an XML file, and a note if it is not in the encoding that it should have. Other programs read blank
    /// lines before the XML declaration, so the declaration becomes blanks then; lines keep their numbers. Some programs end
    /// a text with a NUL, or with the Ctrl-Z of DOS.
    pub fn xml(&self) -> Result<(String, Option<String>)> {
        let (mut text, note) = self.decoded()?;
        text.truncate(text.trim_end_matches(|c: char| c.is_whitespace() || matches!(c, '\0' | '\u{1a}')).len());
        let before = text.len() - text.trim_start().len();
        if before > 0 && text[before..].starts_with("<?xml") {
            let end = text[before..].find("?>").map_or(text.len(), |end| before + end + 2);
            let blank: String = text[before..end].chars().map(|c| if c == '\n' { c } else { ' ' }).collect();
            text.replace_range(before..end, &blank);
        }
        Ok((text, note))
    }

    /// The text in its byte order mark's encoding, in UTF-16 if every other byte is 0, or else in the encoding that the
    /// XML declaration names. Text that should be UTF-8 and is not is read as Latin-1 (Windows-1252).
    fn decoded(&self) -> Result<(String, Option<String>)> {
        let bytes = &self.bytes[..];
        let wide = match bytes {
            [b'<', 0, ..] => Some(UTF_16LE),
            [0, b'<', ..] => Some(UTF_16BE),
            _ => None,
        };
        let declared = declared(bytes);
        let named = match &declared {
            // The file's bytes are not UTF-16, even if its declaration says so, as some programs on Windows write.
            Some(label) => Encoding::for_label(label.as_bytes()).filter(|e| *e != UTF_16LE && *e != UTF_16BE),
            None => None,
        };
        let encoding = Encoding::for_bom(bytes).map(|(encoding, _)| encoding).or(wide).or(named).unwrap_or(UTF_8);
        let (text, _, wrong) = encoding.decode(bytes);
        if !wrong {
            return Ok((text.into_owned(), None));
        }
        if encoding != UTF_8 {
            return Err(Error::file(&self.path, format!("is no text in {}, its encoding", encoding.name())));
        }
        let (text, _, _) = WINDOWS_1252.decode(bytes);
        let of = declared.filter(|_| named.is_none()).map_or(String::new(), |name| format!(" (it declares {name:?})"));
        Ok((text.into_owned(), Some(format!("the file is no text in UTF-8{of}; it was read as Latin-1"))))
    }
}

/// The encoding that an XML declaration names.
fn declared(bytes: &[u8]) -> Option<String> {
    let start = String::from_utf8_lossy(&bytes[..bytes.len().min(400)]).into_owned();
    let declaration = start.trim_start().strip_prefix("<?xml")?.split_once("?>")?.0.to_owned();
    let value = declaration.split_once("encoding")?.1.trim_start().strip_prefix('=')?.trim_start().to_owned();
    let quote = value.chars().next().filter(|c| matches!(c, '"' | '\''))?;
    Some(value[1..].split_once(quote)?.0.to_owned())
}

/// The folders in which a robot's files may lie.
pub struct Files {
    /// Folder of the description.
    folder: PathBuf,
    /// The description's package, in which `package://` and the author's absolute paths are searched.
    root: PathBuf,
    /// The outermost folder that paths relative to the description may lead to.
    reach: PathBuf,
    /// Folders that the user allows in addition.
    allowed: Vec<PathBuf>,
    /// What was taken in place of a path of the author's computer.
    taken: RefCell<Vec<String>>,
}

impl Files {
    /// The folders of a description ([`packages`] has the rules), and those that the user allows.
    pub fn around(description: &Path, reading: &Reading) -> Result<Self> {
        let failed = |e| Error::file(description, e);
        let whole = description.canonicalize().map_err(failed)?;
        let folder = whole.parent().unwrap_or(Path::new("/")).to_owned();
        let [root, reach] = packages::around(&folder);
        Ok(Self { folder, root, reach, allowed: reading.folders()?, taken: RefCell::default() })
    }

    /// Notes on files that were taken in place of others.
    pub fn into_notes(self) -> Vec<String> {
        self.taken.into_inner()
    }

    /// Finds a file that a description names. The name is relative to the folder `within`, which is relative to the
    /// description's folder. `package://NAME/…` is searched in the package NAME. `\` separates folders, as `/` does. A name
    /// that is not found may be that of a URI, with `%20` for a blank.
    pub fn find(&self, within: &str, name: &str) -> Result<PathBuf> {
        let found = self.find_named(within, name);
        match plain_uri(name) {
            Some(plain) if found.is_err() => self.find_named(within, &plain).or(found),
            _ => found,
        }
    }

    fn find_named(&self, within: &str, name: &str) -> Result<PathBuf> {
        let [within, name] = [within, name].map(|text| text.replace('\\', "/"));
        if let Some((scheme, _)) = name.split_once("://").filter(|(scheme, _)| !SCHEMES.contains(scheme)) {
            let reason = format!(
                "files are not read by {scheme}://: download the file into the robot's package, and write its path here"
            );
            return Err(Error::file(Path::new(&name), reason));
        }
        if let Some(rest) = name.strip_prefix("package://").or_else(|| name.strip_prefix("model://")) {
            // Some files have three slashes, and some of these name no package: such a path is relative to the description.
            let whole = rest.trim_start_matches('/');
            let (package, rest) = whole.split_once('/').unwrap_or((whole, ""));
            let Some(root) = self.package(package) else {
                let beside = self.inside(&self.folder.join(whole), Path::new(whole), &[&self.root]);
                return beside.ok().filter(|path| path.is_file()).ok_or_else(|| self.unknown(&name, package));
            };
            return self.inside(&root.join(rest), Path::new(rest), &[&root]);
        }
        let plain = name.strip_prefix("file://").unwrap_or(&name);
        let start = self.folder.join(&within);
        if is_absolute(plain) || (is_absolute(&within) && !start.is_dir()) {
            return self.absolute(plain);
        }
        let inside: Vec<&PathBuf> = [&self.root, &self.reach].into_iter().chain(&self.allowed).collect();
        let found = self.inside(&start.join(plain), Path::new(plain), &inside);
        match (found, packages::same_name(&self.root, plain).as_slice()) {
            (Err(Error::File { path, reason }), [other]) if !reason.contains("outside") => {
                let other = other.strip_prefix(&self.root).unwrap_or(other).display();
                Err(Error::File { path, reason: format!("{reason}; the package has {other}") })
            }
            (found, _) => found,
        }
    }

    /// A file by an absolute path. If it does not lie in the package or in a folder that the user allows, the only file
    /// that has its name, or the same folders before its name, is taken in its place.
    fn absolute(&self, name: &str) -> Result<PathBuf> {
        let inside: Vec<&PathBuf> = [&self.root].into_iter().chain(&self.allowed).collect();
        let own = Path::new(name);
        if own.is_absolute()
            && let Ok(found) = self.inside(own, own, &inside)
        {
            return Ok(found);
        }
        // A folder that the user allows may lie in the package, or hold it.
        let mut all: Vec<PathBuf> = inside.iter().flat_map(|root| packages::same_name(root, name)).collect();
        all.sort();
        all.dedup();
        match &all[..] {
            [one] => {
                let shown = one.strip_prefix(&self.root).unwrap_or(one).display();
                self.taken.borrow_mut().push(format!("{name} is a path of another computer; {shown} was taken"));
                Ok(one.clone())
            }
            [] => Err(Error::file(own, self.outside(true, &self.root))),
            [a, b, ..] => {
                let [a, b] = [a, b].map(|path| path.strip_prefix(&self.root).unwrap_or(path).display().to_string());
                let reason =
                    format!("is a path of another computer, and the package has {a} and {b}: name one of them");
                Err(Error::file(own, reason))
            }
        }
    }

    /// The path, if it lies in one of `roots`.
    fn inside(&self, path: &Path, named: &Path, roots: &[&PathBuf]) -> Result<PathBuf> {
        let outside = || Error::file(named, self.outside(named.is_absolute(), roots[0]));
        let within = |path: &Path| roots.iter().any(|root| path.starts_with(root));
        let whole = plain_path(path).filter(|whole| within(whole)).ok_or_else(outside)?;
        // Symbolic links must also stay inside the package.
        let real = whole.canonicalize().map_err(|e| Error::file(&whole, e))?;
        if within(&real) { Ok(real) } else { Err(outside()) }
    }

    fn outside(&self, absolute: bool, root: &Path) -> String {
        let hint = match absolute {
            true => "absolute paths are read only inside of it; give one relative to the robot's file",
            false => "a package.xml in a folder above the robot's file makes that folder the package",
        };
        format!(
            "lies outside of the robot's package {}: {hint}, or allow its folder: {}",
            root.display(),
            packages::DOOR
        )
    }

    fn unknown(&self, name: &str, package: &str) -> Error {
        let beside = self.root.parent().filter(|above| above.join(package).is_dir());
        let here = beside.map_or(String::new(), |above| format!(" ({} has one)", above.display()));
        let reason = format!(
            "{name}: the file lies in no folder called {package:?}; name the folder that has it{here}: {}",
            packages::DOOR
        );
        Error::file(&self.folder, reason)
    }

    /// The folder of package `name`.
    fn package(&self, name: &str) -> Option<PathBuf> {
        let own = self.folder.ancestors().take_while(|f| f.starts_with(&self.root));
        let beyond = self.folder.ancestors().take(packages::HIGHEST);
        let above = own.chain(beyond).find(|f| packages::is_called(f, name)).map(Path::to_owned);
        above.or_else(|| [&self.root].into_iter().chain(&self.allowed).find_map(|root| packages::below(root, name)))
    }
}

/// A URI without its `%` codes (RFC 3986); None: it has none, or is no text without them.
fn plain_uri(name: &str) -> Option<String> {
    let mut parts = name.split('%');
    let mut bytes = parts.next()?.as_bytes().to_vec();
    for part in parts {
        bytes.push(u8::from_str_radix(part.get(..2)?, 16).ok()?);
        bytes.extend(&part.as_bytes()[2..]);
    }
    String::from_utf8(bytes).ok().filter(|plain| plain != name)
}

/// Is the path absolute, on this computer or on Windows?
fn is_absolute(path: &str) -> bool {
    let drive = matches!(path.as_bytes(), [letter, b':', b'/', ..] if letter.is_ascii_alphabetic());
    drive || path.starts_with('/')
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
