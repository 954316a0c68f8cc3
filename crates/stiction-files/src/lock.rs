//! One daemon per folder: an advisory lock on the folder itself, released when the process ends, without a lock file.

use std::fs::{File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// Why a folder could not be locked.
#[derive(Debug, Error)]
pub enum LockError {
    /// Another process holds the lock.
    #[error(
        "{} is already the recording folder of a running daemon; give each daemon its own, [recording] dir = \"…\"",
        path.display()
    )]
    Held {
        /// The folder.
        path: PathBuf,
    },
    /// The system refuses the lock; some file systems have none.
    #[error("cannot lock {}, so a second daemon in this folder would go unnoticed: {cause}", path.display())]
    Io {
        /// The folder.
        path: PathBuf,
        /// Error of the system.
        cause: io::Error,
    },
}

/// A lock on a folder; released on drop.
#[derive(Debug)]
pub struct FolderLock {
    folder: File,
    path: PathBuf,
}

impl FolderLock {
    /// Locks a folder.
    ///
    /// # Errors
    /// [`LockError::Held`] if another process holds the lock.
    pub fn take(path: &Path) -> Result<Self, LockError> {
        let failed = |cause| LockError::Io { path: path.to_owned(), cause };
        let folder = File::open(path).map_err(failed)?;
        match folder.try_lock() {
            Ok(()) => Ok(Self { folder, path: path.to_owned() }),
            Err(TryLockError::WouldBlock) => Err(LockError::Held { path: path.to_owned() }),
            Err(TryLockError::Error(cause)) => Err(failed(cause)),
        }
    }

    /// Locks the folder again if the locked one was removed and replaced.
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
