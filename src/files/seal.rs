//! A SHA-256 at the end of a recording over everything before it: proof that not a byte was changed since.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use mcap::records::Metadata;
use sha2::{Digest, Sha256};

/// Name of the metadata record that holds it.
pub(super) const NAME: &str = "stictiond.sha256";

/// Bytes so far, and their sum.
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

/// What a file says of its own bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Seal {
    /// How many of them are summed up, from the first.
    pub bytes: u64,
    /// SHA-256 of them, in hex.
    pub sha256: String,
}

impl Seal {
    pub(super) fn of(metadata: &BTreeMap<String, String>) -> Option<Self> {
        Some(Self { bytes: metadata.get("bytes")?.parse().ok()?, sha256: metadata.get("sha256")?.clone() })
    }

    /// Whether the file is what it was when it was sealed.
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
