//! One daemon per folder: an advisory lock on the folder itself, released when the process ends, without a lock file.

use std::fs::{File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use redb::{Builder, Database};
use thiserror::Error;

use super::disk::{Disk, DiskFile, SystemDisk};

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

/// The lock of a folder, if there is one, shared by all that write there.
#[derive(Debug, Clone, Default)]
pub struct SharedLock(Arc<Mutex<Option<FolderLock>>>);

impl SharedLock {
    /// Shares a lock.
    #[must_use]
    pub fn new(lock: Option<FolderLock>) -> Self {
        Self(Arc::new(Mutex::new(lock)))
    }

    /// As [`FolderLock::renew`]; says whether there is a lock.
    ///
    /// # Errors
    /// As [`FolderLock::take`].
    pub fn renew(&self) -> Result<bool, LockError> {
        match &mut *self.0.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(lock) => lock.renew().map(|()| true),
            None => Ok(false),
        }
    }
}

/// The system's disk for files of a locked folder: nothing is made in one that another process holds by now.
#[derive(Debug, Clone, Default)]
pub struct LockedDisk(SharedLock);

impl LockedDisk {
    /// Below this lock.
    #[must_use]
    pub const fn new(lock: SharedLock) -> Self {
        Self(lock)
    }

    fn check(&self) -> io::Result<()> {
        self.0.renew().map(drop).map_err(io::Error::other)
    }
}

impl Disk for LockedDisk {
    fn create_new(&self, path: &Path) -> io::Result<Arc<dyn DiskFile>> {
        self.check()?;
        SystemDisk.create_new(path)
    }

    fn create_folder(&self, path: &Path) -> io::Result<()> {
        SystemDisk.create_folder(path)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        SystemDisk.rename(from, to)
    }

    fn open_store(&self, builder: &Builder, path: &Path) -> Result<Database, redb::Error> {
        self.check().map_err(redb::Error::Io)?;
        SystemDisk.open_store(builder, path)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::{STORE_NAME, StateStore};

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

    #[test]
    fn a_folder_that_another_holds_by_now_takes_no_new_file_and_no_store() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("rec");
        std::fs::create_dir(&path).unwrap();
        let disk = LockedDisk::new(SharedLock::new(Some(FolderLock::take(&path).unwrap())));
        let make = |name: &str| disk.create_new(&path.join(name)).map(drop);
        let store = || StateStore::open_on(&disk, &path.join(STORE_NAME)).map(drop);
        make("a").unwrap();
        let anew = |name: &str| {
            std::fs::rename(&path, dir.path().join(name)).unwrap();
            disk.create_folder(&path).unwrap();
        };
        // Whoever makes the first file or store in a folder that was made anew holds it.
        anew("moved");
        make("b").unwrap();
        assert!(matches!(FolderLock::take(&path), Err(LockError::Held { .. })));
        anew("moved again");
        store().unwrap();
        let other = FolderLock::take(&path);
        assert!(matches!(other, Err(LockError::Held { .. })));
        anew("moved once more");
        let other = FolderLock::take(&path).unwrap();
        let refused = [make("c").unwrap_err().to_string(), store().unwrap_err().to_string()];
        assert!(refused.iter().all(|why| why.contains("running daemon")), "{refused:?}");
        assert_eq!(std::fs::read_dir(&path).unwrap().count(), 0);
        drop(other);
        make("c").unwrap();
    }
}
