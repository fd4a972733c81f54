//! Tags that prove that data were written by a server with the same key.

use crate::error::{Error, Result};
use hmac::{Hmac, KeyInit as _, Mac as _};
use sha2::{Digest as _, Sha256};
use std::path::Path;

/// Length of a tag [bytes]: that of a SHA-256.
const TAG: usize = 32;

/// Shortest key [bytes]; 128 bits cannot be guessed.
const SHORTEST: usize = 16;

/// Makes and checks tags. With a key the tag is an HMAC-SHA-256, so nobody without the key can make valid data. Without
/// a key it is a SHA-256, which only detects damage.
#[derive(Clone, Default)]
pub struct Seal(Option<Hmac<Sha256>>);

impl Seal {
    /// The key is all of the file's bytes.
    ///
    /// # Errors
    /// The file cannot be read or is too short.
    pub fn load(path: &Path) -> Result<Self> {
        let key = sandgait_base::files::read(path, sandgait_base::files::MOST_TEXT)?;
        Self::new(&key).ok_or_else(|| Error::file(path, format!("{} bytes are no key; at least {SHORTEST}", key.len())))
    }

    /// None if the key is too short.
    pub fn new(key: &[u8]) -> Option<Self> {
        let key = Some(key).filter(|k| k.len() >= SHORTEST)?;
        Hmac::new_from_slice(key).ok().map(|hmac| Self(Some(hmac)))
    }

    pub fn tag(&self, data: &[u8]) -> [u8; TAG] {
        match &self.0 {
            Some(hmac) => hmac.clone().chain_update(data).finalize().into_bytes().into(),
            None => Sha256::digest(data).into(),
        }
    }

    /// Is `tag` the tag of `data`? The check takes the same time for every wrong tag. The error gives the reason.
    pub fn check(&self, tag: &[u8; TAG], data: &[u8]) -> std::result::Result<(), &'static str> {
        let checksum = || Sha256::digest(data).as_slice() == tag;
        match &self.0 {
            Some(hmac) if hmac.clone().chain_update(data).verify_slice(tag).is_ok() => Ok(()),
            Some(_) if checksum() => Err("it has no seal, and this server takes only what is sealed with its key"),
            Some(_) => Err("its seal is wrong: it was made with another key, or changed since"),
            None if checksum() => Ok(()),
            None => Err("it is damaged, or sealed with a key that this server does not have: its checksum is wrong"),
        }
    }
}
