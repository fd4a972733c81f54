//! Names of sessions in logs and lists.

use sha2::{Digest, Sha256};

/// The name of a session in logs and lists. It is not the id, because the id is the right to use the session.
pub fn name(id: &str) -> String {
    let digest = Sha256::digest(id);
    digest.iter().take(4).map(|b| format!("{b:02x}")).collect()
}
