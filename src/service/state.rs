//! Sessions that continue after a restart of their server: one file each, which a stopping server writes and the next
//! one restores.
//!
//! ```text
//!  "sandgait session\n" │ tag of the rest, as in snapshots │ Saved
//! ```
//!
//! A file contains everything that a client of a restarted server needs: the session's id, the number of its last
//! request with the answer, and the environments as a snapshot. The id is the right to use the session, so only the
//! file's owner can read it. A file is written completely or not at all, and removed after it was restored. The tag
//! detects files that were cut off or changed; without it a message that ends between two fields could be read as
//! another session.

use super::names::name;
use super::proto::RunSessionResponse;
use super::sessions::{Done, Environments, Session, Sessions};
use crate::env::registry::Blueprint;
use crate::error::{Error, Result};
use crate::pool::{Pool, Seal, Snapshot};
use prost::Message;
use serde_json::Value;
use std::fs;
use std::io::Write as _;
use std::os::unix::fs::DirBuilderExt as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

const MAGIC: &[u8] = b"sandgait session\n";
const ENDING: &str = "session";
/// Name of a file while it is written.
const UNFINISHED: &str = ".unfinished-";

/// What a file contains after `MAGIC` and the tag. Snapshots contain their own version.
#[derive(Clone, PartialEq, Message)]
struct Saved {
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

/// The directory of these files.
#[derive(Clone, Debug)]
pub struct StateDir(PathBuf);

impl StateDir {
    /// Makes the directory if it does not exist; only its owner can enter it.
    pub fn new(path: &Path) -> Result<Self> {
        let made = fs::DirBuilder::new().recursive(true).mode(0o700).create(path);
        made.map_err(|e| Error::file(path, e))?;
        Ok(Self(path.into()))
    }

    /// Restores every session with a file here. A file that cannot be restored is logged and stays.
    pub fn take_up(&self, sessions: &Sessions, pool: &Pool) -> Result<()> {
        for entry in fs::read_dir(&self.0).map_err(|e| Error::file(&self.0, e))? {
            let path = entry.map_err(|e| Error::file(&self.0, e))?.path();
            let unfinished = path.file_name().is_some_and(|n| n.to_string_lossy().starts_with(UNFINISHED));
            if unfinished {
                // A server was killed while it wrote this file; if it cannot be removed it does no harm.
                let _ = fs::remove_file(&path);
            }
            if unfinished || path.extension().is_none_or(|e| e != ENDING) {
                continue;
            }
            let file = path.display();
            match load(&path, &sessions.seal).and_then(|saved| adopt(saved, sessions, pool)) {
                Ok(session) => tracing::info!(session, "a session was restored"),
                Err(error) => {
                    tracing::error!(%file, %error, "a session could not be restored; its file stays");
                    continue;
                }
            }
            if let Err(error) = fs::remove_file(&path) {
                tracing::error!(%file, %error, "the file of a session that goes on could not be removed");
            }
        }
        Ok(())
    }

    /// Writes every session until `deadline`; failures are logged.
    pub fn save(&self, sessions: Vec<Session>, seal: &Seal, deadline: Instant) {
        for session in sessions {
            let name = name(&session.id);
            let written = if Instant::now() < deadline {
                Saved::of(session, seal).and_then(|saved| self.write(&name, &saved, seal))
            } else {
                Err(Error::Exhausted("the time for the end of the server was over".into()))
            };
            match written {
                Ok(()) => tracing::info!(session = name, "a session was saved"),
                Err(error) => tracing::error!(session = name, %error, "a session was lost: it could not be saved"),
            }
        }
    }

    /// Writes a session's file under another name and then renames it, so it is either complete or not there.
    fn write(&self, name: &str, saved: &Saved, seal: &Seal) -> Result<()> {
        let path = self.0.join(format!("{name}.{ENDING}"));
        let unusable = |e: std::io::Error| Error::file(&path, e);
        // Temporary files can be read by their owner only (0600).
        let mut file = tempfile::Builder::new().prefix(UNFINISHED).tempfile_in(&self.0).map_err(unusable)?;
        let body = saved.encode_to_vec();
        [MAGIC, &seal.tag(&body), &body].into_iter().try_for_each(|part| file.write_all(part)).map_err(unusable)?;
        file.as_file().sync_all().map_err(unusable)?;
        file.persist(&path).map_err(|e| unusable(e.error))?;
        Ok(())
    }
}

impl Saved {
    fn of(session: Session, seal: &Seal) -> Result<Self> {
        let Session { id, blueprint, environments } = session;
        let Some(Environments { batch, done, .. }) = environments else {
            return Err(Error::Exhausted("a request of it was still being carried out".into()));
        };
        let mut options = Vec::new();
        let unusable = |e| Error::Exhausted(format!("its options cannot be written: {e}"));
        let keywords = blueprint.keywords().into_iter().map(|k| (k.name.to_owned(), k.value));
        ciborium::into_writer(&Value::Object(keywords.collect()), &mut options).map_err(unusable)?;
        let snapshot = if batch.is_untouched() { None } else { Some(batch.save()?.to_bytes(seal)?) };
        let task = blueprint.task.spec().id.into();
        let (envs, Done { sequence, answer }) = (batch.envs() as u64, done);
        Ok(Self { id, task, options, envs, sequence, answer, snapshot })
    }
}

fn load(path: &Path, seal: &Seal) -> Result<Saved> {
    let bytes = fs::read(path).map_err(|e| Error::file(path, e))?;
    let rest = bytes.strip_prefix(MAGIC).ok_or_else(|| Error::file(path, "this is no session of sandgait's"))?;
    let (tag, body) = rest.split_first_chunk().ok_or_else(|| Error::file(path, "it is cut off"))?;
    seal.check(tag, body).map_err(|why| Error::file(path, why))?;
    Saved::decode(body).map_err(|e| Error::file(path, e))
}

/// Restores a saved session; returns its name.
fn adopt(saved: Saved, sessions: &Sessions, pool: &Pool) -> Result<String> {
    let Saved { id, task, options, envs, sequence, answer, snapshot } = saved;
    let options: Value = ciborium::from_reader(&options[..]).map_err(|e| Error::invalid("options", e.to_string()))?;
    let blueprint = Blueprint::new(&task, options)?;
    let mut environments = sessions.build(&blueprint, envs as usize)?;
    if let Some(snapshot) = snapshot {
        let operation = environments.batch.restore(&Snapshot::from_bytes(&snapshot, &sessions.seal)?, None)?;
        let (batch, rest) = environments.into_parts();
        environments = rest.with(pool.wait(batch, operation)?);
    }
    environments.done = Done { sequence, answer };
    let name = name(&id);
    sessions.add(id, blueprint, environments)?;
    Ok(name)
}
