//! A batch as bytes: to keep, to send, to go on with elsewhere.
//!
//! ```text
//!  "sandgait snapshot\n" │ length u8, version of sandgait │ SHA-256 of the rest │ CBOR
//! ```
//!
//! Bits are promised on one version and one instruction set only, so a snapshot of another version is refused.

use super::batch::Batch;
use crate::env::snapshot::{Resumed, SavedEpisode};
use crate::env::task::Setup;
use crate::env::{ResetOptions, TaskOptions};
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use std::sync::Arc;

const MAGIC: &[u8] = b"sandgait snapshot\n";
const VERSION: &str = env!("CARGO_PKG_VERSION");
const DIGEST: usize = 32;

/// Environments in the middle of their episodes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Snapshot {
    pub task: String,
    /// Each different set of options once.
    options: Vec<TaskOptions>,
    /// Which options an environment has, and its episode.
    episodes: Vec<(u32, SavedEpisode)>,
}

fn broken(why: impl std::fmt::Display) -> Error {
    Error::invalid("snapshot", why.to_string())
}

impl Snapshot {
    pub fn envs(&self) -> usize {
        self.episodes.len()
    }

    /// The first environment's options: what a session that takes the snapshot up is made with.
    pub fn options(&self) -> Option<&TaskOptions> {
        let (index, _) = self.episodes.first()?;
        self.options.get(*index as usize)
    }

    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        let mut body = Vec::new();
        ciborium::into_writer(self, &mut body).map_err(|e| broken(format!("cannot be written: {e}")))?;
        let length = u8::try_from(VERSION.len()).map_err(broken)?;
        Ok([MAGIC, &[length], VERSION.as_bytes(), Sha256::digest(&body).as_slice(), &body].concat())
    }

    pub fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let rest = bytes.strip_prefix(MAGIC).ok_or_else(|| broken("this is none of sandgait's"))?;
        let short = || broken("it is cut off");
        let (length, rest) = rest.split_first().ok_or_else(short)?;
        let (version, rest) = rest.split_at_checked(usize::from(*length)).ok_or_else(short)?;
        if version != VERSION.as_bytes() {
            let version = String::from_utf8_lossy(version);
            return Err(broken(format!("it was taken by sandgait {version:?}, this is {VERSION:?}")));
        }
        let (digest, body) = rest.split_at_checked(DIGEST).ok_or_else(short)?;
        if Sha256::digest(body).as_slice() != digest {
            return Err(broken("it is damaged: its checksum is wrong"));
        }
        ciborium::from_reader(body).map_err(|e| broken(format!("it cannot be read: {e}")))
    }
}

impl Batch {
    /// All environments as they are now.
    pub fn save(&self) -> Result<Snapshot> {
        self.check_begun("save")?;
        let mut setups: Vec<&Setup> = Vec::new();
        let mut episodes = Vec::with_capacity(self.envs());
        for shard in self.shards() {
            for i in 0..shard.envs() {
                let setup = shard.setup(i);
                let same = |s: &&Setup| Arc::ptr_eq(&s.model, &setup.model) && s.options == setup.options;
                let index = setups.iter().rposition(same).unwrap_or_else(|| {
                    setups.push(setup);
                    setups.len() - 1
                });
                episodes.push((index as u32, shard.save(i)));
            }
        }
        let options = setups.iter().map(|s| s.options.clone()).collect();
        Ok(Snapshot { task: self.spec().id.into(), options, episodes })
    }

    /// Checks that environment i of this batch can go on as environment `sources[i]` of `snapshot` (none given: i
    /// modulo the snapshot's number).
    pub(super) fn resumed(&self, snapshot: &Snapshot, sources: Option<&[u32]>) -> Result<Vec<Arc<Resumed>>> {
        if snapshot.task != self.spec().id {
            return Err(broken(format!("it is of {}, not of {}", snapshot.task, self.spec().id)));
        }
        if sources.is_some_and(|s| s.len() != self.envs()) || snapshot.envs() == 0 {
            let got = sources.map_or(0, <[u32]>::len);
            return Err(Error::invalid("sources", format!("{got} entries for {} environments", self.envs())));
        }
        let setups = snapshot.options.iter().map(|o| self.setup_of(o)).collect::<Result<Vec<_>>>()?;
        let resume = |(index, saved): &(u32, SavedEpisode)| {
            let setup = setups.get(*index as usize).ok_or_else(|| broken("it is inconsistent"))?;
            Resumed::new(saved, setup, self.spec().action.len()).map(Arc::new)
        };
        let all = snapshot.episodes.iter().map(resume).collect::<Result<Vec<_>>>()?;
        let source = |i: usize| sources.map_or(i % all.len(), |s| s[i] as usize);
        let one = |i: usize| {
            let range = || format!("{} is outside [0, {})", source(i), all.len());
            all.get(source(i)).cloned().ok_or_else(|| Error::invalid(format!("sources[{i}]"), range()))
        };
        (0..self.envs()).map(one).collect()
    }

    /// A setup with `options`, which may differ from this session's in what a reset may change.
    fn setup_of(&self, options: &TaskOptions) -> Result<Setup> {
        let mine = &self.setup().options;
        if mine == options {
            return Ok(self.setup().clone());
        }
        if mine.changed(&ResetOptions::all_of(options))? != *options {
            return Err(broken("it was taken with options that this session does not have and a reset cannot change"));
        }
        self.setup().with(options.clone())
    }
}
