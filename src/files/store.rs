//! A small transactional store for what must survive a crash: one file, one value a key, each with a checksum.
//!
//! [`StateStore::save`] returns once the values are on the disk, all of them or none. A value that was changed on the
//! disk is left out and counted, never taken for true.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use redb::{Builder, Database, ReadableDatabase, ReadableTable, TableDefinition};
use sha2::{Digest, Sha256};
use thiserror::Error;

use super::disk::{Disk, SystemDisk};

/// Name of the store's file, beside the recordings.
pub const STORE_NAME: &str = "state.redb";
/// Name of the store of documents that wait for receivers, in the same folder.
pub const OUTBOX_NAME: &str = "outbox.redb";

/// Memory that the store may keep of its own file, bytes.
const CACHE_BYTES: usize = 8 << 20;
/// Bytes of a SHA-256 in front of each value.
const CHECK_BYTES: usize = 8;

const TABLE: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("state");

/// The key of a loop's memory.
#[must_use]
pub fn key_of(prefix: &str, loop_name: &str) -> String {
    format!("{prefix}\n{loop_name}")
}

/// The loop whose memory a key is of, under a prefix.
#[must_use]
pub fn loop_of<'k>(prefix: &str, key: &'k str) -> Option<&'k str> {
    key.strip_prefix(prefix)?.strip_prefix('\n')
}

/// What goes wrong with a store.
#[derive(Debug, Error)]
pub enum StoreError {
    /// It cannot be opened, read or written now.
    #[error("{}: {source}; check that the folder is writable and has room", path.display())]
    Failed {
        /// The store's file.
        path: PathBuf,
        /// What the library or the system said.
        source: Box<redb::Error>,
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

/// An open store. One process at a time: a second one is refused.
pub struct StateStore {
    database: Database,
    path: PathBuf,
}

/// What a store holds.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Stored {
    /// Values by key.
    pub values: BTreeMap<String, Vec<u8>>,
    /// Values whose checksum is wrong: left out.
    pub damaged: usize,
}

impl StateStore {
    /// Opens the store, or makes it.
    ///
    /// # Errors
    /// [`StoreError::Broken`] where the file is no store any more; it should be put aside. [`StoreError::Failed`] where
    /// the system refuses.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        Self::open_on(&SystemDisk, path)
    }

    /// The same on a disk of one's own.
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

    /// Everything it holds.
    ///
    /// # Errors
    /// [`StoreError`]; a single damaged value is none.
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

    /// Puts values in, all in one transaction, which is on the disk when this returns.
    ///
    /// # Errors
    /// [`StoreError`]; nothing has changed then, and the store should be opened anew.
    pub fn save<'v>(&self, values: impl IntoIterator<Item = (&'v str, &'v [u8])>) -> Result<(), StoreError> {
        self.change(values, [])
    }

    /// Puts values in and takes others out, all in one transaction, which is on the disk when this returns.
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

/// Runs one call; what a damaged file makes the library stumble over is an error, not the end of the daemon.
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
        Ok(Err(error)) => Err(StoreError::Failed { path: path.to_owned(), source: Box::new(error) }),
        Err(_) => Err(broken("it makes its reader stumble; the log says where".to_owned())),
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
