//! A SHA-256 at the end of a recording over everything before it, to detect any later change.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use mcap::records::Metadata;
use sha2::{Digest, Sha256};

/// Name of the metadata record with the hash.
pub(super) const NAME: &str = "stictiond.sha256";

/// Number of bytes so far, and their hash.
#[derive(Debug, Default)]
pub(super) struct Sum {
    hasher: Sha256,
    bytes: u64,
}

impl Sum {
    pub fn take(&mut self, bytes: &[u8]) {
        self.hasher.update(bytes);
        self.bytes += bytes.len() as u64;
    }

    /// The record to write after these bytes.
    pub fn seal(&self) -> Metadata {
        let entries = [("bytes", self.bytes.to_string()), ("sha256", hex(&self.hasher.clone().finalize()))];
        let metadata = entries.map(|(k, v)| (k.to_owned(), v)).into();
        Metadata { name: NAME.to_owned(), metadata }
    }
}

/// The hash stated in a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Seal {
    /// Number of hashed bytes, from the start.
    pub bytes: u64,
    /// SHA-256 of them, in hex.
    pub sha256: String,
}

impl Seal {
    pub(super) fn of(metadata: &BTreeMap<String, String>) -> Option<Self> {
        Some(Self { bytes: metadata.get("bytes")?.parse().ok()?, sha256: metadata.get("sha256")?.clone() })
    }

    /// Whether the file still matches its hash.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn holds(&self, path: &Path) -> io::Result<bool> {
        let mut source = File::open(path)?.take(self.bytes);
        let mut sum = Sum::default();
        let mut piece = vec![0_u8; 1 << 16];
        loop {
            match source.read(&mut piece) {
                Ok(0) => break,
                Ok(read) => sum.take(&piece[..read]),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(sum.bytes == self.bytes && hex(&sum.hasher.finalize()) == self.sha256)
    }
}

fn hex(digest: &[u8]) -> String {
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}
