//! Tags that prove that data were written by a server with the same key.

use crate::error::{Error, Result};
use hmac::{Hmac, KeyInit as _, Mac as _};
use sha2::{Digest as _, Sha256};
use std::path::Path;

/// Length of a tag [bytes].
const TAG: usize = 32;

/// Shortest key [bytes]; 128 bits cannot be guessed.
const SHORTEST: usize = 16;

/// Makes and checks tags. With a key it is HMAC-SHA-256, so that nobody without the key can make valid data;
/// without a key SHA-256, which only detects damage.
#[derive(Clone, Default)]
pub struct Seal(Option<Hmac<Sha256>>);

impl Seal {
    /// The key is all of the file's bytes.
    ///
    /// # Errors
    /// The file cannot be read or is too short.
    pub fn load(path: &Path) -> Result<Self> {
        let key = std::fs::read(path).map_err(|e| Error::file(path, e))?;
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

    /// Is `tag` the tag of `data`? The time is the same for every wrong tag. The error gives the reason.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// RFC 4231, test case 1.
    #[test]
    fn the_published_value() {
        let seal = Seal::new(&[0x0b; 20]).unwrap();
        let tag: String = seal.tag(b"Hi There").iter().map(|b| format!("{b:02x}")).collect();
        assert_eq!(tag, "b0344c61d8db38535ca8afceaf0bf12b881dc200c9833da726e9376c2e32cff7");
    }

    #[test]
    fn only_the_key_makes_a_seal() {
        let (ours, theirs, none) = (Seal::new(&[1; 16]).unwrap(), Seal::new(&[2; 16]).unwrap(), Seal::default());
        let data = b"data";
        for seal in [&ours, &theirs, &none] {
            assert_eq!(seal.check(&seal.tag(data), data), Ok(()));
            assert!(seal.check(&seal.tag(data), b"Data").is_err());
        }
        assert!(ours.check(&theirs.tag(data), data).unwrap_err().starts_with("its seal is wrong"));
        assert!(ours.check(&none.tag(data), data).unwrap_err().starts_with("it has no seal"));
        assert!(none.check(&ours.tag(data), data).unwrap_err().starts_with("it is damaged, or sealed"));
        assert!(Seal::new(&[1; 15]).is_none());
    }
}
