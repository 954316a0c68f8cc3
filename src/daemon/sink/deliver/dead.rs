//! Documents that a receiver refuses permanently: one line of JSON each, with the reason, in a file of bounded size.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use serde_json::json;

use super::Item;
use crate::runtime::clock::now_ns;

/// Name of the file, in the folder of the recordings.
pub const DEAD_LETTERS: &str = "dead-letters.jsonl";
/// Name of the previous file.
const OLDER: &str = "dead-letters.1.jsonl";
/// Size at which the file is renamed to [`OLDER`], bytes.
const MAX_BYTES: u64 = 8 << 20;

/// The file, shared by the receivers.
pub(super) struct DeadLetters {
    dir: PathBuf,
    /// One writer at a time.
    writing: Mutex<()>,
}

impl DeadLetters {
    pub fn new(dir: &Path) -> Self {
        Self { dir: dir.to_owned(), writing: Mutex::default() }
    }

    /// Appends a document with the reason; returns once the line is on disk.
    pub fn append(&self, receiver: &str, item: &Item, attempts: u32, reason: &str) -> io::Result<()> {
        let document: serde_json::Value = serde_json::from_str(&item.document).unwrap_or_default();
        let line = json!({
            "time": stiction::core::units::format_rfc3339(now_ns()),
            "receiver": receiver,
            "attempts": attempts,
            "reason": reason,
            "id": item.id,
            "kind": item.kind,
            "loop": item.loop_name,
            "document": document,
        });
        let _writing = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        let path = self.dir.join(DEAD_LETTERS);
        if fs::metadata(&path).is_ok_and(|file| file.len() >= MAX_BYTES) {
            fs::rename(&path, self.dir.join(OLDER))?;
        }
        let mut file = File::options().append(true).create(true).open(&path)?;
        file.write_all(format!("{line}\n").as_bytes())?;
        file.sync_data()
    }
}
