//! Progress of the recorder, for those who wait for it to end and for the health document.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// A file that is not finished.
#[derive(Debug, Clone)]
struct Unfinished {
    path: PathBuf,
    /// The error that stopped it; `None` while it is being written.
    error: Option<String>,
}

/// Progress shared by the recorder's thread and its observers.
#[derive(Debug, Default)]
pub struct Progress {
    taken: AtomicU64,
    finished: AtomicU64,
    /// Unfinished files by segment.
    unfinished: Mutex<BTreeMap<usize, Unfinished>>,
}

impl Progress {
    /// Number of items taken, and of files finished at the end.
    #[must_use]
    pub fn steps(&self) -> [u64; 2] {
        [&self.taken, &self.finished].map(|count| count.load(Ordering::Relaxed))
    }

    /// Files that are still open or could not be written, each with the reason.
    #[must_use]
    pub fn unfinished(&self) -> Vec<String> {
        let text = |file: &Unfinished| {
            let path = file.path.display().to_string();
            match &file.error {
                None => path,
                Some(error) if error.contains(&path) => error.clone(),
                Some(error) => format!("{path}: {error}"),
            }
        };
        self.files(|files| files.values().map(text).collect())
    }

    /// Whether a file could not be written and no other has replaced it.
    #[must_use]
    pub fn has_stopped(&self) -> bool {
        self.files(|files| files.values().any(|file| file.error.is_some()))
    }

    pub(super) fn take_one(&self) {
        self.taken.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn finish_one(&self) {
        self.finished.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn open(&self, segment: usize, path: PathBuf) {
        self.files(|files| drop(files.insert(segment, Unfinished { path, error: None })));
    }

    pub(crate) fn fail(&self, segment: usize, error: &str) {
        self.files(|files| {
            if let Some(file) = files.get_mut(&segment) {
                file.error = Some(error.to_owned());
            }
        });
    }

    pub(super) fn close(&self, segment: usize) {
        self.files(|files| drop(files.remove(&segment)));
    }

    fn files<T>(&self, call: impl FnOnce(&mut BTreeMap<usize, Unfinished>) -> T) -> T {
        call(&mut self.unfinished.lock().unwrap_or_else(PoisonError::into_inner))
    }
}
