//! A batch as bytes, to store, to send, or to continue elsewhere.
//!
//! ```text
//!  "sandgait snapshot\n" │ length u8, version of sandgait │ tag of the rest │ CBOR
//! ```
//!
//! [`Seal`] makes the tag. Environments continue bit-identically only on the same version and instruction set, so a
//! snapshot of another version is refused. Options and episodes are CBOR inside the CBOR. Only those that are requested
//! are unpacked, one by one, so a restore needs memory only for the batch's own environments, whatever the snapshot's
//! size.

use super::batch::Batch;
use super::operation::Operation;
use super::seal::Seal;
use crate::env::AnyTask;
use crate::env::snapshot::SavedEpisode;
use crate::error::{Error, Result};
use serde::de::Visitor;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::{Map, Value};
use std::sync::Arc;

const MAGIC: &[u8] = b"sandgait snapshot\n";
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Shortest and longest part [bytes]: our choice. The largest options are 512 × 512 heights of a relief, 2.4 MB, beside
/// a packed robot. Every real part is longer than the shortest; this limit prevents a small snapshot with very many
/// empty parts.
const PART: std::ops::RangeInclusive<usize> = 64..=4 << 20;

/// Number of copies of a snapshot in memory while it is made: its parts, the CBOR of all of them, and the finished
/// bytes.
const COPIES: usize = 3;

/// Environments in the middle of their episodes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Snapshot {
    pub task: String,
    /// Each different set of options once: [`AnyTask::options`].
    options: Vec<PackedPart>,
    /// For each environment, the index of its options and its episode: [`SavedEpisode`].
    episodes: Vec<(u32, PackedPart)>,
}

/// CBOR that is not unpacked yet.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct PackedPart(Vec<u8>);

pub(super) fn broken(why: impl std::fmt::Display) -> Error {
    Error::invalid("snapshot", why.to_string())
}

impl PackedPart {
    fn pack_options(options: &Map<String, Value>) -> Result<Self> {
        let mut bytes = Vec::new();
        ciborium::into_writer(options, &mut bytes).map_err(|e| broken(format!("cannot be written: {e}")))?;
        Self::new(bytes)
    }

    fn pack_episode(episode: &SavedEpisode) -> Result<Self> {
        Self::new(episode.to_cbor().map_err(|e| broken(format!("cannot be written: {e}")))?)
    }

    fn new(bytes: Vec<u8>) -> Result<Self> {
        match PART.contains(&bytes.len()) {
            true => Ok(Self(bytes)),
            // A part outside this range could not be read again.
            false => Err(broken(format!("options of {} bytes are more than {}", bytes.len(), PART.end()))),
        }
    }

    fn options(&self) -> Result<Map<String, Value>> {
        ciborium::from_reader(&self.0[..]).map_err(|e| broken(format!("it cannot be read: {e}")))
    }

    pub(super) fn episode(&self) -> Result<SavedEpisode> {
        SavedEpisode::from_cbor(&self.0).map_err(|e| broken(format!("it cannot be read: {e}")))
    }
}

impl Serialize for PackedPart {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        serializer.serialize_bytes(&self.0)
    }
}

impl<'de> Deserialize<'de> for PackedPart {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        struct PartVisitor;
        impl Visitor<'_> for PartVisitor {
            type Value = PackedPart;

            fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
                write!(f, "{} to {} bytes", PART.start(), PART.end())
            }

            fn visit_bytes<E: serde::de::Error>(self, bytes: &[u8]) -> std::result::Result<PackedPart, E> {
                self.visit_byte_buf(bytes.to_vec())
            }

            fn visit_byte_buf<E: serde::de::Error>(self, bytes: Vec<u8>) -> std::result::Result<PackedPart, E> {
                match PART.contains(&bytes.len()) {
                    true => Ok(PackedPart(bytes)),
                    false => Err(E::invalid_length(bytes.len(), &self)),
                }
            }
        }
        deserializer.deserialize_byte_buf(PartVisitor)
    }
}

impl Snapshot {
    pub fn envs(&self) -> usize {
        self.episodes.len()
    }

    pub(super) fn episodes(&self) -> &[(u32, PackedPart)] {
        &self.episodes
    }

    /// The options with this index.
    pub(super) fn options_of(&self, index: u32) -> Result<Map<String, Value>> {
        self.options.get(index as usize).ok_or_else(|| broken("it is inconsistent"))?.options()
    }

    pub fn to_bytes(&self, seal: &Seal) -> Result<Vec<u8>> {
        let mut body = Vec::new();
        ciborium::into_writer(self, &mut body).map_err(|e| broken(format!("cannot be written: {e}")))?;
        let length = u8::try_from(VERSION.len()).map_err(broken)?;
        Ok([MAGIC, &[length], VERSION.as_bytes(), &seal.tag(&body), &body].concat())
    }

    pub fn from_bytes(bytes: &[u8], seal: &Seal) -> Result<Self> {
        let rest = bytes.strip_prefix(MAGIC).ok_or_else(|| broken("this is not one of sandgait's snapshots"))?;
        let short = || broken("it is cut off");
        let (length, rest) = rest.split_first().ok_or_else(short)?;
        let (version, rest) = rest.split_at_checked(usize::from(*length)).ok_or_else(short)?;
        if version != VERSION.as_bytes() {
            let version = String::from_utf8_lossy(version);
            return Err(broken(format!("it was taken by sandgait {version:?}, this is {VERSION:?}")));
        }
        let (tag, body) = rest.split_first_chunk().ok_or_else(short)?;
        seal.check(tag, body).map_err(broken)?;
        ciborium::from_reader(body).map_err(|e| broken(format!("it cannot be read: {e}")))
    }
}

impl Batch {
    /// The present state of all environments.
    pub fn save(&self) -> Result<Snapshot> {
        self.check_begun("save")?;
        let mut tasks: Vec<&Arc<dyn AnyTask>> = Vec::new();
        let mut episodes = Vec::with_capacity(self.envs());
        for shard in self.shards() {
            for i in 0..shard.envs() {
                let task = shard.task(i);
                let index = tasks.iter().rposition(|t| t.id() == task.id()).unwrap_or_else(|| {
                    tasks.push(task);
                    tasks.len() - 1
                });
                episodes.push((index as u32, PackedPart::pack_episode(&shard.save(i))?));
            }
            let packed = &episodes[episodes.len() - shard.envs()..];
            self.charge(COPIES * packed.iter().map(|(_, part)| part.0.len()).sum::<usize>())?;
        }
        let options = |t: &&Arc<dyn AnyTask>| {
            let part = PackedPart::pack_options(&t.options())?;
            self.charge(COPIES * part.0.len())?;
            Ok(part)
        };
        let options = tasks.iter().map(options).collect::<Result<_>>()?;
        Ok(Snapshot { task: self.spec().id.into(), options, episodes })
    }

    /// See [`Batch::prepare_restore`].
    pub fn restore(&self, snapshot: Snapshot, sources: Option<Vec<u32>>) -> Result<Operation> {
        self.prepare_restore(snapshot, sources)?.finish(self)
    }

    /// This session's task with `options`, which may differ from the session's own only in options that a reset can
    /// change.
    pub(super) fn task_with(&self, options: Map<String, Value>) -> Result<Arc<dyn AnyTask>> {
        let fixed = "it was taken with options that this session does not have and a reset cannot change";
        let changes = self.task().reset_to(options).ok_or_else(|| broken(fixed))?;
        match changes.keywords().is_empty() {
            true => Ok(self.task().clone()),
            false => self.task().changed(&changes),
        }
    }
}
