//! The disk below recordings and store: the system's, or one that a test makes full, broken or cut off.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;

use redb::{Builder, Database};

/// A file that only grows.
pub trait DiskFile: Send + Sync {
    /// Appends some of the bytes, and says how many.
    ///
    /// # Errors
    /// What the disk says.
    fn append(&self, bytes: &[u8]) -> io::Result<usize>;

    /// Returns once the bytes are on the disk, and with `all` also the file's length and times.
    ///
    /// # Errors
    /// What the disk says.
    fn sync(&self, all: bool) -> io::Result<()>;

    /// Whether the folder holds this file under a name.
    fn is_at(&self, path: &Path) -> bool;
}

/// What is done to a disk.
pub trait Disk: Send + Sync {
    /// Makes a file that must not be there yet.
    ///
    /// # Errors
    /// What the disk says.
    fn create_new(&self, path: &Path) -> io::Result<Arc<dyn DiskFile>>;

    /// Makes a folder and those above it, where they are missing.
    ///
    /// # Errors
    /// What the disk says.
    fn create_folder(&self, path: &Path) -> io::Result<()>;

    /// Gives a file another name, in the place of what has it.
    ///
    /// # Errors
    /// What the disk says.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;

    /// Opens a store, or makes it.
    ///
    /// # Errors
    /// What the library says.
    fn open_store(&self, builder: &Builder, path: &Path) -> Result<Database, redb::Error>;
}

/// The system's disk.
#[derive(Debug, Clone, Copy, Default)]
pub struct SystemDisk;

impl Disk for SystemDisk {
    fn create_new(&self, path: &Path) -> io::Result<Arc<dyn DiskFile>> {
        Ok(Arc::new(OpenOptions::new().write(true).create_new(true).open(path)?))
    }

    fn create_folder(&self, path: &Path) -> io::Result<()> {
        fs::create_dir_all(path)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::rename(from, to)
    }

    fn open_store(&self, builder: &Builder, path: &Path) -> Result<Database, redb::Error> {
        Ok(builder.create(path)?)
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

/// A file as writers want it.
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
