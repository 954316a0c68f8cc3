//! A small transactional store for state that must survive a crash: one file, one value per key, each with a checksum.
//!
//! [`StateStore::save`] returns once all values are on the disk, or none. A value altered on the disk is skipped and counted,
//! never used.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use redb::{Builder, Database, ReadableDatabase, ReadableTable, TableDefinition};
use sha2::{Digest, Sha256};
use thiserror::Error;

use super::disk::{Disk, SystemDisk};

/// Name of the store's file, next to the recordings.
pub const STORE_NAME: &str = "state.redb";
/// Name of the store of documents waiting for delivery, in the same folder.
pub const OUTBOX_NAME: &str = "outbox.redb";

/// Largest cache of the store, bytes.
const CACHE_BYTES: usize = 8 << 20;
/// Bytes of the SHA-256 before each value.
const CHECK_BYTES: usize = 8;

const TABLE: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("state");

/// The key of a loop's state.
#[must_use]
pub fn key_of(prefix: &str, loop_name: &str) -> String {
    format!("{prefix}\n{loop_name}")
}

/// The loop of a state key below a prefix.
#[must_use]
pub fn loop_of<'k>(prefix: &str, key: &'k str) -> Option<&'k str> {
    key.strip_prefix(prefix)?.strip_prefix('\n')
}

/// What the key of a note begins with; no prefix does.
const NOTE: &str = "\nverified\n";

/// The key of the note of a recording that was found whole.
#[must_use]
pub fn key_of_verified(file: &str) -> String {
    format!("{NOTE}{file}")
}

/// The recording that a note is of.
#[must_use]
pub fn verified_of(key: &str) -> Option<&str> {
    key.strip_prefix(NOTE)
}

/// The key of what a prefix's data health remembers; no loop has it.
#[must_use]
pub fn key_of_data_health(prefix: &str) -> String {
    format!("\ndata_health\n{prefix}")
}

/// The key of the runs that were begun under a prefix; no loop has it.
#[must_use]
pub fn key_of_runs(prefix: &str) -> String {
    format!("\nruns\n{prefix}")
}

/// An error of the store.
#[derive(Debug, Error)]
pub enum StoreError {
    /// It cannot be opened, read or written at present.
    #[error("{}: {cause}; check that the folder is writable and has free space", path.display())]
    Failed {
        /// The store's file.
        path: PathBuf,
        /// Error of the library or the system.
        cause: Box<redb::Error>,
    },
    /// Its content cannot be used.
    #[error("{}: not a usable store: {why}", path.display())]
    Broken {
        /// The store's file.
        path: PathBuf,
        /// What is wrong with it.
        why: String,
    },
}

/// An open store. Only one process can open it at a time.
pub struct StateStore {
    database: Database,
    path: PathBuf,
}

/// Contents of a store.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Stored {
    /// Values by key.
    pub values: BTreeMap<String, Vec<u8>>,
    /// Number of values with a wrong checksum; skipped.
    pub damaged: usize,
}

impl StateStore {
    /// Opens the store, creating it if missing.
    ///
    /// # Errors
    /// [`StoreError::Broken`] if the file is not a usable store; set it aside. [`StoreError::Failed`] if the system refuses.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        Self::open_on(&SystemDisk, path)
    }

    /// As [`StateStore::open`], on the given disk.
    ///
    /// # Errors
    /// As [`StateStore::open`].
    pub fn open_on(disk: &dyn Disk, path: &Path) -> Result<Self, StoreError> {
        let opened = guarded(path, || {
            let mut builder = Builder::new();
            builder.set_cache_size(CACHE_BYTES).set_check_integrity_on_open(true);
            disk.open_store(&builder, path)
        })?;
        Ok(Self { database: opened, path: path.to_owned() })
    }

    /// All its contents.
    ///
    /// # Errors
    /// [`StoreError`]; a single damaged value is not an error.
    pub fn load(&self) -> Result<Stored, StoreError> {
        guarded(&self.path, || {
            let mut stored = Stored::default();
            let transaction = self.database.begin_read()?;
            let table = match transaction.open_table(TABLE) {
                Ok(table) => table,
                Err(redb::TableError::TableDoesNotExist(_)) => return Ok(stored),
                Err(error) => return Err(error.into()),
            };
            for entry in table.iter()? {
                let (key, value) = entry?;
                match checked(key.value(), value.value()) {
                    Some(value) => {
                        stored.values.insert(key.value().to_owned(), value.to_vec());
                    }
                    None => stored.damaged += 1,
                }
            }
            Ok(stored)
        })
    }

    /// Saves values in one transaction, which is on the disk on return.
    ///
    /// # Errors
    /// [`StoreError`]; nothing has changed then, and the store should be reopened.
    pub fn save<'v>(&self, values: impl IntoIterator<Item = (&'v str, &'v [u8])>) -> Result<(), StoreError> {
        self.change(values, [])
    }

    /// Saves values and deletes others in one transaction, which is on the disk on return.
    ///
    /// # Errors
    /// As [`StateStore::save`].
    pub fn change<'v>(
        &self,
        values: impl IntoIterator<Item = (&'v str, &'v [u8])>,
        gone: impl IntoIterator<Item = &'v str>,
    ) -> Result<(), StoreError> {
        guarded(&self.path, || {
            let transaction = self.database.begin_write()?;
            {
                let mut table = transaction.open_table(TABLE)?;
                for (key, value) in values {
                    let mut sealed = check_of(key, value).to_vec();
                    sealed.extend_from_slice(value);
                    table.insert(key, sealed.as_slice())?;
                }
                for key in gone {
                    table.remove(key)?;
                }
            }
            transaction.commit()?;
            Ok(())
        })
    }
}

fn check_of(key: &str, value: &[u8]) -> [u8; CHECK_BYTES] {
    let digest = Sha256::new().chain_update(key).chain_update([0]).chain_update(value).finalize();
    std::array::from_fn(|i| digest[i])
}

fn checked<'v>(key: &str, sealed: &'v [u8]) -> Option<&'v [u8]> {
    let (check, value) = sealed.split_at_checked(CHECK_BYTES)?;
    (check == check_of(key, value)).then_some(value)
}

/// Makes one call; a panic of the library on a damaged file becomes an error.
fn guarded<T>(path: &Path, call: impl FnOnce() -> Result<T, redb::Error>) -> Result<T, StoreError> {
    let broken = |why: String| StoreError::Broken { path: path.to_owned(), why };
    match catch_unwind(AssertUnwindSafe(call)) {
        Ok(Ok(value)) => Ok(value),
        Ok(Err(redb::Error::Corrupted(why))) => Err(broken(why)),
        Ok(Err(error @ redb::Error::UpgradeRequired(_))) => Err(broken(error.to_string())),
        // A file that ends too early was cut: no second attempt will find more in it.
        Ok(Err(redb::Error::Io(error)))
            if matches!(error.kind(), std::io::ErrorKind::InvalidData | std::io::ErrorKind::UnexpectedEof) =>
        {
            Err(broken(error.to_string()))
        }
        Ok(Err(error)) => Err(StoreError::Failed { path: path.to_owned(), cause: Box::new(error) }),
        Err(_) => Err(broken("it is corrupt (its reader panicked; details are in the log)".to_owned())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn filled(dir: &Path) -> PathBuf {
        let path = dir.join(STORE_NAME);
        let store = StateStore::open(&path).unwrap();
        let values: Vec<(String, Vec<u8>)> = (0..200).map(|k| (format!("p/L{k}"), vec![k as u8; 300])).collect();
        store.save(values.iter().map(|(k, v)| (k.as_str(), v.as_slice()))).unwrap();
        path
    }

    #[test]
    fn what_was_saved_is_there_after_a_copy_taken_at_any_time() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(STORE_NAME);
        let store = StateStore::open(&path).unwrap();
        store.save([("a", b"one".as_slice()), ("b", b"two")]).unwrap();
        store.change([("a", b"three".as_slice()), ("c", b"gone")], []).unwrap();
        store.change([], ["c", "never there"]).unwrap();
        // As kill -9 leaves it: the file as it stands, never closed.
        let copy = dir.path().join("copy.redb");
        fs::copy(&path, &copy).unwrap();
        let stored = StateStore::open(&copy).unwrap().load().unwrap();
        assert_eq!(stored.damaged, 0);
        assert_eq!(stored.values["a"], b"three");
        assert_eq!((stored.values["b"].as_slice(), stored.values.len()), (b"two".as_slice(), 2));
        assert!(StateStore::open(&path).is_err(), "one process at a time");
    }

    #[test]
    fn flipped_bits_and_cuts_are_errors_or_left_out_never_taken_for_true() {
        let dir = tempfile::tempdir().unwrap();
        let whole = fs::read(filled(dir.path())).unwrap();
        let path = dir.path().join("hurt.redb");
        let (mut refused, mut read) = (0, 0);
        for k in 0..240_usize {
            let mut bytes = whole.clone();
            if k % 4 == 0 {
                bytes.truncate(whole.len() * k / 240);
            } else {
                let bit = k.wrapping_mul(7_919_113) % (8 * bytes.len());
                bytes[bit / 8] ^= 1 << (bit % 8);
            }
            fs::write(&path, &bytes).unwrap();
            match StateStore::open(&path).and_then(|s| s.load()) {
                Ok(stored) => {
                    read += 1;
                    for (key, value) in stored.values {
                        let number: u8 = key.strip_prefix("p/L").unwrap().parse().unwrap();
                        assert_eq!(value, vec![number; 300], "{key}");
                    }
                }
                Err(_) => refused += 1,
            }
        }
        assert!(read > 0 && refused > 0, "{read} read, {refused} refused");
    }
}
