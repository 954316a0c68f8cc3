//! Short hashes that identify configurations, events and runs.

use sha2::{Digest, Sha256};
use stiction::core::{CALIBRATIONS, VERSION};

/// The first 8 bytes of a SHA-256, as 16 hex digits.
#[must_use]
pub fn short_hash(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().take(8).map(|b| format!("{b:02x}")).collect()
}

/// The version, and short hashes of everything that was fitted to data; the last line of commands that measure this build.
#[must_use]
pub fn provenance() -> String {
    let hashes = CALIBRATIONS.map(|(name, file)| format!("{name} {}", &short_hash(file.as_bytes())[..8]));
    format!("build: stictiond {VERSION}, {}", hashes.join(", "))
}
