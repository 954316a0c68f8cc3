//! One daemon a folder: an advisory lock on the folder itself, which ends with the process and leaves nothing behind.

use std::fs::{File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// Why a folder could not be locked.
#[derive(Debug, Error)]
pub enum LockError {
    /// Another process holds it.
    #[error(
        "{} is the recording folder of another daemon that runs: give each one its own, [recording] dir = \"…\"",
        path.display()
    )]
    Held {
        /// The folder.
        path: PathBuf,
    },
    /// The system refuses; the folder may be on a file system without locks.
    #[error("{}: cannot be locked, so a second daemon here would not be noticed: {source}", path.display())]
    Io {
        /// The folder.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

/// A held lock; dropped, it is free.
#[derive(Debug)]
pub struct FolderLock {
    folder: File,
    path: PathBuf,
}

impl FolderLock {
    /// Locks a folder.
    ///
    /// # Errors
    /// [`LockError::Held`] where another process has it.
    pub fn take(path: &Path) -> Result<Self, LockError> {
        let failed = |source| LockError::Io { path: path.to_owned(), source };
        let folder = File::open(path).map_err(failed)?;
        match folder.try_lock() {
            Ok(()) => Ok(Self { folder, path: path.to_owned() }),
            Err(TryLockError::WouldBlock) => Err(LockError::Held { path: path.to_owned() }),
            Err(TryLockError::Error(source)) => Err(failed(source)),
        }
    }

    /// Locks the folder that now stands under the name, where the locked one was taken away.
    ///
    /// # Errors
    /// As [`FolderLock::take`].
    pub fn renew(&mut self) -> Result<(), LockError> {
        let moved = match (self.folder.metadata(), std::fs::metadata(&self.path)) {
            (Ok(held), Ok(there)) => !super::same_file(&held, &there),
            _ => false,
        };
        if moved {
            *self = Self::take(&self.path)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_locked_once_and_again_after_it_was_made_anew() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("rec");
        std::fs::create_dir(&path).unwrap();
        let mut lock = FolderLock::take(&path).unwrap();
        assert!(matches!(FolderLock::take(&path), Err(LockError::Held { .. })));
        std::fs::remove_dir(&path).unwrap();
        lock.renew().unwrap();
        std::fs::create_dir(&path).unwrap();
        lock.renew().unwrap();
        assert!(matches!(FolderLock::take(&path), Err(LockError::Held { .. })));
        drop(lock);
        FolderLock::take(&path).unwrap();
        assert!(matches!(FolderLock::take(&dir.path().join("none")), Err(LockError::Io { .. })));
    }
}
