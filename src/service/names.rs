//! How logs and lists name sessions.

use sha2::{Digest, Sha256};

/// What logs and lists call a session: its id is the right to use it.
pub fn name(id: &str) -> String {
    let digest = Sha256::digest(id);
    digest.iter().take(4).map(|b| format!("{b:02x}")).collect()
}
