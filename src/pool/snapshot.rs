//! A batch as bytes: to keep, to send, to go on with elsewhere.
//!
//! ```text
//!  "sandgait snapshot\n" │ length u8, version of sandgait │ tag of the rest │ CBOR
//! ```
//!
//! The tag is a [`Seal`]'s. Bits are promised on one version and one instruction set only, so a snapshot of another version is
//! refused. Options and episodes are CBOR inside the CBOR and unpacked one by one, only those that are asked for: however
//! many a snapshot has, a batch that takes it up needs memory for its own environments.

use super::batch::Batch;
use super::seal::Seal;
use crate::env::snapshot::{Resumed, SavedEpisode};
use crate::env::task::Setup;
use crate::env::{ResetOptions, TaskOptions};
use crate::error::{Error, Result};
use serde::de::{DeserializeOwned, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::HashMap;
use std::sync::Arc;

const MAGIC: &[u8] = b"sandgait snapshot\n";
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Longest and shortest part [bytes]. Our choice: twice what the longest options allow, and less than any has, so that very
/// many empty ones are no small snapshot.
const PART: std::ops::RangeInclusive<usize> = 64..=1 << 19;

/// Environments in the middle of their episodes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Snapshot {
    pub task: String,
    /// Each different set of options once: [`TaskOptions`].
    options: Vec<Part>,
    /// Which options an environment has, and its episode: [`SavedEpisode`].
    episodes: Vec<(u32, Part)>,
}

/// CBOR that has not been looked into.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Part(Vec<u8>);

fn broken(why: impl std::fmt::Display) -> Error {
    Error::invalid("snapshot", why.to_string())
}

impl Part {
    fn pack(whole: &impl Serialize) -> Result<Self> {
        let mut bytes = Vec::new();
        ciborium::into_writer(whole, &mut bytes).map_err(|e| broken(format!("cannot be written: {e}")))?;
        Ok(Self(bytes))
    }

    fn unpack<T: DeserializeOwned>(&self) -> Result<T> {
        ciborium::from_reader(&self.0[..]).map_err(|e| broken(format!("it cannot be read: {e}")))
    }
}

impl Serialize for Part {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        serializer.serialize_bytes(&self.0)
    }
}

impl<'de> Deserialize<'de> for Part {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        struct Bytes;
        impl Visitor<'_> for Bytes {
            type Value = Part;

            fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
                write!(f, "{} to {} bytes", PART.start(), PART.end())
            }

            fn visit_bytes<E: serde::de::Error>(self, bytes: &[u8]) -> std::result::Result<Part, E> {
                self.visit_byte_buf(bytes.to_vec())
            }

            fn visit_byte_buf<E: serde::de::Error>(self, bytes: Vec<u8>) -> std::result::Result<Part, E> {
                match PART.contains(&bytes.len()) {
                    true => Ok(Part(bytes)),
                    false => Err(E::invalid_length(bytes.len(), &self)),
                }
            }
        }
        deserializer.deserialize_byte_buf(Bytes)
    }
}

impl Snapshot {
    pub fn envs(&self) -> usize {
        self.episodes.len()
    }

    pub fn to_bytes(&self, seal: &Seal) -> Result<Vec<u8>> {
        let mut body = Vec::new();
        ciborium::into_writer(self, &mut body).map_err(|e| broken(format!("cannot be written: {e}")))?;
        let length = u8::try_from(VERSION.len()).map_err(broken)?;
        Ok([MAGIC, &[length], VERSION.as_bytes(), &seal.tag(&body), &body].concat())
    }

    pub fn from_bytes(bytes: &[u8], seal: &Seal) -> Result<Self> {
        let rest = bytes.strip_prefix(MAGIC).ok_or_else(|| broken("this is none of sandgait's"))?;
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
                episodes.push((index as u32, Part::pack(&shard.save(i))?));
            }
        }
        let options = setups.iter().map(|s| Part::pack(&s.options)).collect::<Result<_>>()?;
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
        let all = &snapshot.episodes;
        let mut setups: HashMap<&Part, Setup> = HashMap::new();
        let mut resumed: HashMap<usize, Arc<Resumed>> = HashMap::new();
        let mut one = |i: usize| {
            let source = sources.map_or(i % all.len(), |s| s[i] as usize);
            if let Some(known) = resumed.get(&source) {
                return Ok(known.clone());
            }
            let range = || Error::invalid(format!("sources[{i}]"), format!("{source} is outside [0, {})", all.len()));
            let (index, episode) = all.get(source).ok_or_else(range)?;
            let options = snapshot.options.get(*index as usize).ok_or_else(|| broken("it is inconsistent"))?;
            let setup = match setups.get(options) {
                Some(setup) => setup,
                None => setups.entry(options).or_insert(self.setup_of(&options.unpack()?)?),
            };
            let episode: SavedEpisode = episode.unpack()?;
            let new = Arc::new(Resumed::new(&episode, setup, self.spec().action.len())?);
            resumed.insert(source, new.clone());
            Ok(new)
        };
        (0..self.envs()).map(&mut one).collect()
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
