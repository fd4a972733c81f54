//! Files that are read within bounds, files that survive a power cut, and folders that only one process at a time writes
//! into.

use super::error::{Error, Result};
use std::fs::{File, TryLockError};
use std::io::{ErrorKind, Read, Write as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Largest text that is read, of a robot, sand, settings or a token [bytes]: our choice, fifty times the largest robot we
/// have seen.
pub const MOST_TEXT: u64 = 8 << 20;

/// Time for which a pipe is read before something writes into it: our choice, enough for a program that starts at the same time.
const PIPE_WAITS: Duration = Duration::from_secs(2);
/// Time between two looks into a pipe that gives nothing yet: our choice, short beside a program's start.
const PIPE_LOOKS: Duration = Duration::from_millis(5);

/// Reads a file of at most `most` bytes. A pipe may stand in the file's place, such as `<(…)` of a shell. A device without an
/// end is refused once it has given more.
///
/// # Errors
/// Names the path and why it cannot be read.
pub fn read(path: &Path, most: u64) -> Result<Vec<u8>> {
    let (file, length) = open(path, most, "")?;
    let mut bytes = Vec::with_capacity(length as usize);
    file.take(most + 1).read_to_end(&mut bytes).map_err(|e| Error::file(path, e))?;
    if bytes.len() as u64 > most {
        return Err(Error::file(path, format!("more than the {} MiB that are read", most >> 20)));
    }
    Ok(bytes)
}

/// The same as [`read`], but refuses what is no regular file, such as a pipe or a device.
///
/// # Errors
/// Those of [`read`].
pub fn read_regular(path: &Path, most: u64) -> Result<Vec<u8>> {
    let about = std::fs::metadata(path).map_err(|e| Error::file(path, e))?;
    if about.is_file() { read(path, most) } else { Err(Error::file(path, "is no file")) }
}

/// Opens a file or a pipe, and returns its length, which is 0 for a pipe. A file of more than `most` bytes is refused with
/// `advice`, and so is a pipe into which nothing writes. A pipe may give more than `most` bytes: the caller counts.
///
/// # Errors
/// Names the path and why it cannot be read.
pub fn open(path: &Path, most: u64, advice: &str) -> Result<(PatientFile, u64)> {
    let failed = |e| Error::file(path, e);
    let file = waiting_for_none(path).map_err(failed)?;
    let about = file.metadata().map_err(failed)?;
    if about.is_dir() {
        return Err(Error::file(path, "is a folder"));
    }
    if about.len() > most {
        let size = about.len() >> 20;
        return Err(Error::file(path, format!("{size} MiB is more than the {} MiB that are read{advice}", most >> 20)));
    }
    let mut file = PatientFile { file, first: Vec::new() };
    if is_pipe(&about) {
        file.await_writer().map_err(failed)?;
    }
    Ok((file, about.len()))
}

/// A file, or a pipe whose writer may be slow.
pub struct PatientFile {
    file: File,
    /// What was read while the writer was awaited.
    first: Vec<u8>,
}

impl PatientFile {
    /// Waits for the first byte of a pipe.
    fn await_writer(&mut self) -> std::io::Result<()> {
        let (start, mut byte) = (Instant::now(), [0]);
        loop {
            match self.file.read(&mut byte) {
                Ok(0) if start.elapsed() < PIPE_WAITS => std::thread::sleep(PIPE_LOOKS),
                Ok(0) => return Err(std::io::Error::other("is a pipe into which nothing writes")),
                Ok(_) => {
                    self.first = byte.to_vec();
                    return Ok(());
                }
                // Something has opened the pipe and has not written yet.
                Err(e) if e.kind() == ErrorKind::WouldBlock => return Ok(()),
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) => return Err(e),
            }
        }
    }
}

impl Read for PatientFile {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        if !self.first.is_empty() && !buffer.is_empty() {
            let count = self.first.len().min(buffer.len());
            buffer[..count].copy_from_slice(&self.first[..count]);
            self.first.drain(..count);
            return Ok(count);
        }
        loop {
            match self.file.read(buffer) {
                Err(e) if e.kind() == ErrorKind::WouldBlock => std::thread::sleep(PIPE_LOOKS),
                read => return read,
            }
        }
    }
}

/// Opens a file without waiting for the writer of a pipe.
#[cfg(unix)]
fn waiting_for_none(path: &Path) -> std::io::Result<File> {
    use std::os::unix::fs::OpenOptionsExt as _;
    const O_NONBLOCK: i32 = if cfg!(any(target_os = "linux", target_os = "android")) { 0o4000 } else { 4 };
    File::options().read(true).custom_flags(O_NONBLOCK).open(path)
}

#[cfg(not(unix))]
fn waiting_for_none(path: &Path) -> std::io::Result<File> {
    File::open(path)
}

#[cfg(unix)]
fn is_pipe(about: &std::fs::Metadata) -> bool {
    use std::os::unix::fs::FileTypeExt as _;
    about.file_type().is_fifo()
}

#[cfg(not(unix))]
fn is_pipe(_: &std::fs::Metadata) -> bool {
    false
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

    /// A pipe is read as a file is, however slowly it is written; one into which nothing writes does not stop the program.
    #[cfg(unix)]
    #[test]
    fn a_pipe_without_a_writer_is_refused() {
        let path = std::env::temp_dir().join(format!("sandgait-pipe-{}", std::process::id()));
        let made = std::process::Command::new("mkfifo").arg(&path).status();
        if !made.is_ok_and(|status| status.success()) {
            return;
        }
        let reason = read(&path, 100).unwrap_err().to_string();
        assert!(reason.ends_with("is a pipe into which nothing writes"), "{reason}");
        assert!(read_regular(&path, 100).unwrap_err().to_string().ends_with("is no file"));
        let writer = std::thread::spawn({
            let path = path.clone();
            move || {
                let mut pipe = File::options().write(true).open(path).unwrap();
                for part in ["a", "bc", "d"] {
                    std::thread::sleep(Duration::from_millis(30));
                    pipe.write_all(part.as_bytes()).unwrap();
                }
            }
        });
        assert_eq!(read(&path, 100).unwrap(), b"abcd");
        writer.join().unwrap();
        std::fs::remove_file(&path).unwrap();
    }
}
