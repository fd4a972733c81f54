//! Sessions that continue after a restart of their server. A server that stops writes one file for each session, and
//! the next server restores them. A file stays until its session is saved again or ends: a server that is killed, also
//! while it restores, leaves the sessions as they were when they were last saved. Clients number their requests, so they
//! notice that a session is older.
//!
//! ```text
//!  "sandgait session\n" │ tag of the rest, as in snapshots │ SessionFile
//! ```
//!
//! A file contains everything that a client of a restarted server needs: the session's id, the number of its last
//! request with the answer, and the environments as a snapshot. The id is the right to use the session, so only the
//! file's owner can read it. A file is written completely or not at all. The tag detects files that were cut off or
//! changed; without it a message that ends between two fields could be read as another session.

use super::building::{LastAnswer, SessionEnvironments};
use super::names::name;
use super::platform;
use super::proto::RunSessionResponse;
use super::sessions::{Sessions, StoppedSession};
use crate::env::registry::Blueprint;
use crate::error::{Error, Result};
use crate::pool::{Pool, Seal, Snapshot};
use parking_lot::Mutex;
use prost::Message;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs::{self, File, TryLockError};
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::{Instant, timeout_at};

const MAGIC: &[u8] = b"sandgait session\n";
const ENDING: &str = "session";
/// Name of a file while it is written.
const UNFINISHED: &str = ".unfinished-";

/// What a file contains after `MAGIC` and the tag. Snapshots contain their own version.
#[derive(Clone, PartialEq, Message)]
struct SessionFile {
    #[prost(string, tag = "1")]
    id: String,
    #[prost(string, tag = "2")]
    task: String,
    /// The task's keywords as CBOR, which keeps every float.
    #[prost(bytes = "vec", tag = "3")]
    options: Vec<u8>,
    #[prost(uint64, tag = "4")]
    envs: u64,
    #[prost(uint64, tag = "5")]
    sequence: u64,
    #[prost(message, optional, tag = "6")]
    answer: Option<RunSessionResponse>,
    /// Absent before the first reset.
    #[prost(bytes = "vec", optional, tag = "7")]
    snapshot: Option<Vec<u8>>,
}

/// Number of threads that save sessions. Our choice: they mostly wait for the disk, and 16 threads make 1,024 syncs of
/// 5 ms in 0.3 s.
const SAVERS: usize = 16;

/// How often a stopping server looks for sessions whose operations have ended: our choice, often in the 4 s that saving
/// may take, and seldom enough to keep no processor busy.
const LOOK: Duration = Duration::from_millis(2);

/// Largest number of names in the error message: our choice, some lines on a terminal; the log has all of them.
const NAMED: usize = 16;

/// Name of the file whose lock a running server holds.
const LOCK: &str = ".lock";

/// The directory of these files. One server at a time uses it.
#[derive(Clone, Debug)]
pub struct StateDir {
    path: PathBuf,
    /// Locked until the last copy of this value is dropped.
    _lock: Arc<File>,
    /// [`File::sync_all`], or a slow disk in tests.
    sync: fn(&File) -> std::io::Result<()>,
}

impl StateDir {
    /// Makes the directory if it does not exist; only its owner can enter it.
    ///
    /// # Errors
    /// The directory cannot be used, or another server uses it.
    pub fn new(path: &Path) -> Result<Self> {
        let unusable = |e: std::io::Error| Error::unwritten(path, &e);
        platform::make_private_folder(path).map_err(unusable)?;
        let mut own = File::options();
        let lock = platform::private(own.create(true).append(true)).open(path.join(LOCK)).map_err(unusable)?;
        match lock.try_lock() {
            Ok(()) => Ok(Self { path: path.into(), _lock: Arc::new(lock), sync: File::sync_all }),
            Err(TryLockError::WouldBlock) => {
                Err(Error::file(path, "another server uses this directory; stop it first, or name another directory"))
            }
            Err(TryLockError::Error(e)) => Err(unusable(e)),
        }
    }

    /// Makes the names of new and removed files durable.
    fn sync_names(&self) -> Result<()> {
        platform::sync_folder(&self.path, self.sync).map_err(|e| Error::file(&self.path, e))
    }

    /// Restores every session with a file here. A file that cannot be restored is logged and stays.
    pub fn take_up(&self, sessions: &Sessions, pool: &Pool) -> Result<()> {
        let unusable = |e| Error::file(&self.path, e);
        for entry in fs::read_dir(&self.path).map_err(unusable)? {
            let path = entry.map_err(unusable)?.path();
            let unfinished = path.file_name().is_some_and(|n| n.to_string_lossy().starts_with(UNFINISHED));
            if unfinished {
                // A server was killed while it wrote this file. No other server is writing it now, because of the lock.
                // A file that cannot be removed does no harm.
                let _ = fs::remove_file(&path);
            }
            if unfinished || path.extension().is_none_or(|e| e != ENDING) {
                continue;
            }
            let file = path.display();
            match load(&path, &sessions.seal).and_then(|saved| adopt(saved, sessions, pool)) {
                Ok(session) => tracing::info!(session, "a session was restored"),
                Err(error) => tracing::error!(%file, %error, "a session could not be restored; its file stays"),
            }
        }
        Ok(())
    }

    fn file(&self, name: &str) -> PathBuf {
        self.path.join(format!("{name}.{ENDING}"))
    }

    /// Removes the file of a session that has ended, if it has one. After a power cut it may be there again; the session
    /// then ends with its lease.
    pub fn remove(&self, name: &str) {
        let file = self.file(name);
        match fs::remove_file(&file) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                tracing::error!(file = %file.display(), %error, "the file of a session that has ended cannot be removed");
            }
            _ => {}
        }
    }

    /// Saves sessions until `deadline`: idle sessions at once, the others as soon as no operation runs on them. This
    /// work has threads of its own, so requests do not delay it.
    ///
    /// # Errors
    /// Some sessions were not saved; the error has their names, and the log has the reasons.
    pub async fn save(&self, sessions: &Sessions, deadline: Instant) -> Result<()> {
        let (sender, receiver) = std::sync::mpsc::channel::<StoppedSession>();
        let receiver = Arc::new(Mutex::new(receiver));
        let (finished, mut outcomes) = mpsc::unbounded_channel();
        for _ in 0..SAVERS {
            let (own, receiver, finished, seal) =
                (self.clone(), receiver.clone(), finished.clone(), sessions.seal.clone());
            let next = move || receiver.lock().recv().ok();
            let save = move || {
                while let Some(session) = next() {
                    let name = name(&session.id);
                    let saved = SessionFile::of(session, &seal).and_then(|saved| own.write(&name, &saved, &seal));
                    // The receiver is dropped at the deadline.
                    let _ = finished.send((name, saved));
                }
            };
            std::thread::Builder::new()
                .name("save".into())
                .spawn(save)
                .map_err(|e| Error::Exhausted(format!("no thread can be started to save the sessions: {e}")))?;
        }
        drop(finished);
        let mut missing = BTreeMap::new();
        loop {
            for session in sessions.idle() {
                missing.insert(name(&session.id), "the disk took too long".to_owned());
                // The threads receive until the sender is dropped.
                let _ = sender.send(session);
            }
            if sessions.list().is_empty() || Instant::now() >= deadline {
                break;
            }
            tokio::time::sleep(LOOK).await;
        }
        drop(sender);
        let busy = sessions.list().into_iter().map(|s| (s.name, "an operation of it did not end in time".to_owned()));
        missing.extend(busy);
        while let Ok(Some((name, saved))) = timeout_at(deadline, outcomes.recv()).await {
            match saved {
                Ok(()) => {
                    tracing::info!(session = name, "a session was saved");
                    missing.remove(&name);
                }
                Err(error) => drop(missing.insert(name, error.to_string())),
            }
        }
        let durable = self.sync_names();
        for (session, error) in &missing {
            tracing::error!(session, error, "a session was lost: it could not be saved");
        }
        match missing.len() {
            0 => durable,
            n => {
                let names: Vec<_> = missing.into_keys().take(NAMED).collect();
                let more = if n > NAMED { ", …" } else { "" };
                Err(Error::Exhausted(format!("{n} sessions were not saved: {}{more}", names.join(", "))))
            }
        }
    }

    /// Writes a session's file under another name and then renames it, so it is either complete or not there.
    fn write(&self, name: &str, saved: &SessionFile, seal: &Seal) -> Result<()> {
        let path = self.file(name);
        let unusable = |e: std::io::Error| Error::unwritten(&path, &e);
        // Temporary files can be read by their owner only (0600).
        let mut file = tempfile::Builder::new().prefix(UNFINISHED).tempfile_in(&self.path).map_err(unusable)?;
        let body = saved.encode_to_vec();
        [MAGIC, &seal.tag(&body), &body].into_iter().try_for_each(|part| file.write_all(part)).map_err(unusable)?;
        (self.sync)(file.as_file()).map_err(unusable)?;
        file.persist(&path).map_err(|e| unusable(e.error))?;
        Ok(())
    }
}

impl SessionFile {
    fn of(session: StoppedSession, seal: &Seal) -> Result<Self> {
        let StoppedSession { id, blueprint, environments: SessionEnvironments { batch, books } } = session;
        let mut options = Vec::new();
        let unusable = |e| Error::Exhausted(format!("its options cannot be written: {e}"));
        let keywords = blueprint.keywords().into_iter().map(|k| (k.name.to_owned(), k.value));
        ciborium::into_writer(&Value::Object(keywords.collect()), &mut options).map_err(unusable)?;
        let snapshot = if batch.is_untouched() { None } else { Some(batch.save()?.to_bytes(seal)?) };
        let task = blueprint.task.spec().id.into();
        let (envs, LastAnswer { sequence, answer }) = (batch.envs() as u64, books.done);
        Ok(Self { id, task, options, envs, sequence, answer, snapshot })
    }
}

fn load(path: &Path, seal: &Seal) -> Result<SessionFile> {
    let bytes = fs::read(path).map_err(|e| Error::file(path, e))?;
    let rest = bytes.strip_prefix(MAGIC).ok_or_else(|| Error::file(path, "this is no session of sandgait's"))?;
    let (tag, body) = rest.split_first_chunk().ok_or_else(|| Error::file(path, "it is cut off"))?;
    seal.check(tag, body).map_err(|why| Error::file(path, why))?;
    SessionFile::decode(body).map_err(|e| Error::file(path, e))
}

/// Restores a saved session; returns its name.
fn adopt(saved: SessionFile, sessions: &Sessions, pool: &Pool) -> Result<String> {
    let SessionFile { id, task, options, envs, sequence, answer, snapshot } = saved;
    let options: Value = ciborium::from_reader(&options[..]).map_err(|e| Error::invalid("options", e.to_string()))?;
    let blueprint = Blueprint::new(&task, options)?;
    let mut environments = sessions.build(&blueprint, envs as usize)?;
    if let Some(snapshot) = snapshot {
        let operation = environments.batch.restore(Snapshot::from_bytes(&snapshot, &sessions.seal)?, None)?;
        environments.batch = pool.wait(environments.batch, operation)?;
        environments.books.reservation.set("options", environments.batch.bytes())?;
    }
    environments.books.done = LastAnswer { sequence, answer };
    let name = name(&id);
    sessions.add(id, blueprint, environments)?;
    Ok(name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::Limits;
    use tokio_util::sync::CancellationToken;

    /// A disk that needs 5 ms a sync.
    fn slow(file: &File) -> std::io::Result<()> {
        std::thread::sleep(Duration::from_millis(5));
        file.sync_all()
    }

    /// The largest default number of sessions is saved on a slow disk, while blocking work fills all threads of the
    /// runtime. One after the other, the syncs would take 5 s.
    #[tokio::test]
    async fn the_default_number_of_sessions_is_saved_in_time() {
        let directory = tempfile::tempdir().unwrap();
        let sessions = Sessions::new(Limits::default(), Seal::default(), CancellationToken::new());
        let (blueprint, pool) = (Blueprint::new("sandgait/HexapodGait-v1", Value::Null).unwrap(), Pool::new(0));
        for k in 0..Limits::DEFAULT.sessions {
            let mut environments = sessions.build(&blueprint, 64).unwrap();
            let reset = environments.batch.reset(None, None, Default::default()).unwrap();
            environments.batch = pool.wait(environments.batch, reset).unwrap();
            sessions.add(k.to_string(), blueprint.clone(), environments).unwrap();
        }
        let mut state = StateDir::new(directory.path()).unwrap();
        state.sync = slow;
        let begun = Instant::now();
        state.save(&sessions, begun + Duration::from_secs(4)).await.unwrap();
        println!("{} sessions of 64 environments were saved in {:.2?}", Limits::DEFAULT.sessions, begun.elapsed());
        let files = fs::read_dir(directory.path()).unwrap().count();
        assert_eq!(files, Limits::DEFAULT.sessions + 1, "and the lock");
    }

    /// A session on which an operation still runs at the deadline is named.
    #[tokio::test]
    async fn sessions_that_are_not_saved_are_named() {
        let directory = tempfile::tempdir().unwrap();
        let sessions = Sessions::new(Limits::default(), Seal::default(), CancellationToken::new());
        let blueprint = Blueprint::new("sandgait/HexapodGait-v1", Value::Null).unwrap();
        for id in ["idle", "busy"] {
            sessions.add(id.into(), blueprint.clone(), sessions.build(&blueprint, 1).unwrap()).unwrap();
        }
        let hold = sessions.attach("busy").unwrap();
        let _lent = sessions.take(&hold).await.unwrap();
        let state = StateDir::new(directory.path()).unwrap();
        let error = state.save(&sessions, Instant::now() + Duration::from_millis(300)).await.unwrap_err();
        assert_eq!(error.to_string(), format!("1 sessions were not saved: {}", name("busy")));
        assert!(directory.path().join(format!("{}.{ENDING}", name("idle"))).exists());
    }
}
