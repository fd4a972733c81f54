//! Files that are read within bounds, files that survive a power cut, and folders that only one process at a time writes
//! into.

use super::error::{Error, Result};
use std::fs::{File, TryLockError};
use std::io::{ErrorKind, Read as _, Write as _};
use std::path::{Path, PathBuf};

/// Largest text that is read, of a robot, sand, settings or a token [bytes]: our choice, fifty times the largest robot we
/// have seen.
pub const MOST_TEXT: u64 = 8 << 20;

/// Reads a file of at most `most` bytes. A pipe may stand in the file's place. A device without an end is refused once it
/// has given more.
///
/// # Errors
/// Names the path and why it cannot be read.
pub fn read(path: &Path, most: u64) -> Result<Vec<u8>> {
    let failed = |e| Error::file(path, e);
    let file = File::open(path).map_err(failed)?;
    let about = file.metadata().map_err(failed)?;
    if about.is_dir() {
        return Err(Error::file(path, "is a folder"));
    }
    if about.len() > most {
        let size = about.len() >> 20;
        return Err(Error::file(path, format!("{size} MiB is more than the {} MiB that are read", most >> 20)));
    }
    let mut bytes = Vec::with_capacity(about.len() as usize);
    file.take(most + 1).read_to_end(&mut bytes).map_err(failed)?;
    if bytes.len() as u64 > most {
        return Err(Error::file(path, format!("more than the {} MiB that are read", most >> 20)));
    }
    Ok(bytes)
}

/// Reads a text of at most [`MOST_TEXT`] bytes.
///
/// # Errors
/// Those of [`read`], and a file that is no text in UTF-8.
pub fn read_text(path: &Path) -> Result<String> {
    String::from_utf8(read(path, MOST_TEXT)?).map_err(|_| Error::file(path, "no text in UTF-8"))
}

/// Replaces the file at `path`, or creates it. After a power cut or a kill at any moment the path has either the
/// complete old content or the complete new content. When this returns, the new content is on the disk.
pub fn write(path: &Path, content: &[u8]) -> Result<()> {
    put(path, content)?;
    sync_folder(folder_of(path))
}

/// The same as [`write`], but the new name is on the disk only after [`sync_folder`]. For many files in one folder.
///
/// The content is written to `NAME.partial` beside the file first. If the process is killed before the file is renamed,
/// `NAME.partial` stays, and the next call replaces it. Two processes must not write the same path at the same time:
/// see [`Lock`].
pub fn put(path: &Path, content: &[u8]) -> Result<()> {
    let mut beside = path.as_os_str().to_owned();
    beside.push(".partial");
    let beside = PathBuf::from(beside);
    let written = File::create(&beside).and_then(|mut file| {
        file.write_all(content)?;
        // The content must be on the disk before the name refers to it.
        file.sync_all()?;
        std::fs::rename(&beside, path)
    });
    written.map_err(|e| {
        // The first error is the one to report; the incomplete file may not even exist.
        let _ = std::fs::remove_file(&beside);
        Error::unwritten(path, &e)
    })
}

/// Writes to the disk the names of a folder's new, renamed and removed files.
pub fn sync_folder(folder: &Path) -> Result<()> {
    match File::open(folder).and_then(|folder| folder.sync_all()) {
        // Some network file systems cannot do this for folders.
        Err(e) if !matches!(e.kind(), ErrorKind::InvalidInput | ErrorKind::Unsupported) => {
            Err(Error::unwritten(folder, &e))
        }
        _ => Ok(()),
    }
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// A folder that this process alone writes into. The system ends the lock when the process ends, for whatever reason.
#[derive(Debug)]
pub struct Lock(File);

impl Lock {
    /// Locks `folder`, which must exist. If another process has locked it, the error ends with `advice`.
    ///
    /// The folder itself is locked, so no file is left. A file system without locks for folders (NFS, or Lustre without
    /// the mount option `flock`) gives no protection; that is no error, because people train there too.
    pub fn new(folder: &Path, advice: &str) -> Result<Self> {
        let file = File::open(folder).map_err(|e| Error::file(folder, e))?;
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => {
                Err(Error::file(folder, format!("another process writes into this folder; {advice}")))
            }
            Ok(()) | Err(TryLockError::Error(_)) => Ok(Self(file)),
        }
    }
}

impl Drop for Lock {
    /// A forked child may hold the folder open, too, so closing it would not end the lock.
    fn drop(&mut self) {
        // Unlocking cannot fail for a lock that is held. On a file system without locks there is nothing to unlock.
        let _ = self.0.unlock();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_without_an_end_and_a_folder_are_refused() {
        let reason = |path: &str, most| read(Path::new(path), most).unwrap_err().to_string();
        assert_eq!(reason("/dev/zero", 1 << 20), "/dev/zero: more than the 1 MiB that are read");
        assert_eq!(reason("/dev", 1), "/dev: is a folder");
        assert!(read_text(Path::new("/dev/zero")).is_err());
        assert_eq!(read(Path::new("/dev/null"), 0).unwrap(), b"");
    }
}
