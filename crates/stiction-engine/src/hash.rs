//! Short names for what is the same: of configurations, events and runs.

use sha2::{Digest, Sha256};

/// The first 8 bytes of a SHA-256, as 16 hex digits.
#[must_use]
pub fn short_hash(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().take(8).map(|b| format!("{b:02x}")).collect()
}
