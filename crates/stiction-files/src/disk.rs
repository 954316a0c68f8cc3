//! The disk below recordings and store: the system's, or a test double that is full, faulty or unplugged.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use redb::{Builder, Database};

/// An append-only file.
pub trait DiskFile: Send + Sync {
    /// Appends some of the bytes; returns how many.
    ///
    /// # Errors
    /// Error of the disk.
    fn append(&self, bytes: &[u8]) -> io::Result<usize>;

    /// Returns once the bytes are on the disk; with `all` also the file's length and times.
    ///
    /// # Errors
    /// Error of the disk.
    fn sync(&self, all: bool) -> io::Result<()>;

    /// Whether the folder still has this file under this name.
    fn is_at(&self, path: &Path) -> bool;
}

/// Operations on a disk.
pub trait Disk: Send + Sync {
    /// Creates a file that must not exist.
    ///
    /// # Errors
    /// Error of the disk.
    fn create_new(&self, path: &Path) -> io::Result<Arc<dyn DiskFile>>;

    /// Creates a folder and its missing parents.
    ///
    /// # Errors
    /// Error of the disk.
    fn create_folder(&self, path: &Path) -> io::Result<()>;

    /// Renames a file, replacing the target; once this returns, the new name outlives a power cut.
    ///
    /// # Errors
    /// Error of the disk.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;

    /// Opens a store, creating it if missing.
    ///
    /// # Errors
    /// Error of the library.
    fn open_store(&self, builder: &Builder, path: &Path) -> Result<Database, redb::Error>;
}

/// The system's disk.
#[derive(Debug, Clone, Copy, Default)]
pub struct SystemDisk;

impl Disk for SystemDisk {
    fn create_new(&self, path: &Path) -> io::Result<Arc<dyn DiskFile>> {
        let file = OpenOptions::new().write(true).create_new(true).open(path)?;
        // A file that nobody gets must not stand in the way of the next attempt.
        sync_folder_of(path).inspect_err(|_| drop(fs::remove_file(path)))?;
        Ok(Arc::new(file))
    }

    fn create_folder(&self, path: &Path) -> io::Result<()> {
        fs::create_dir_all(path)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::rename(from, to)?;
        sync_folder_of(to)
    }

    fn open_store(&self, builder: &Builder, path: &Path) -> Result<Database, redb::Error> {
        let is_new = !path.exists();
        let store = builder.create(path)?;
        if is_new {
            sync_folder_of(path)?;
        }
        Ok(store)
    }
}

/// Makes a file name durable: without it, a power cut may remove a file whose content was synced.
///
/// # Errors
/// Error of the disk. None on file systems that cannot sync folders, such as network ones.
pub(super) fn sync_folder_of(path: &Path) -> io::Result<()> {
    let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or_else(|| Path::new("."));
    match File::open(parent).and_then(|folder| folder.sync_all()) {
        Err(error) if matches!(error.kind(), io::ErrorKind::InvalidInput | io::ErrorKind::Unsupported) => Ok(()),
        synced => synced,
    }
}

impl DiskFile for File {
    fn append(&self, bytes: &[u8]) -> io::Result<usize> {
        let mut file = self;
        file.write(bytes)
    }

    fn sync(&self, all: bool) -> io::Result<()> {
        if all { self.sync_all() } else { self.sync_data() }
    }

    fn is_at(&self, path: &Path) -> bool {
        let Ok(open) = self.metadata() else { return false };
        fs::metadata(path).is_ok_and(|there| super::same_file(&open, &there))
    }
}

/// A disk in memory that holds one file, whatever its name.
#[derive(Debug, Clone, Default)]
pub struct MemoryDisk(Arc<Mutex<Vec<u8>>>);

impl MemoryDisk {
    /// What was written, which is gone from here then.
    #[must_use]
    pub fn take(&self) -> Vec<u8> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Disk for MemoryDisk {
    fn create_new(&self, _: &Path) -> io::Result<Arc<dyn DiskFile>> {
        Ok(Arc::new(self.clone()))
    }

    fn create_folder(&self, _: &Path) -> io::Result<()> {
        Ok(())
    }

    fn rename(&self, _: &Path, _: &Path) -> io::Result<()> {
        Ok(())
    }

    fn open_store(&self, _: &Builder, _: &Path) -> Result<Database, redb::Error> {
        Err(redb::Error::Io(io::ErrorKind::Unsupported.into()))
    }
}

impl DiskFile for MemoryDisk {
    fn append(&self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn sync(&self, _: bool) -> io::Result<()> {
        Ok(())
    }

    fn is_at(&self, _: &Path) -> bool {
        true
    }
}

/// A file with the interface of a writer.
#[derive(Clone)]
pub(super) struct Handle(pub Arc<dyn DiskFile>);

impl Write for Handle {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.append(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
