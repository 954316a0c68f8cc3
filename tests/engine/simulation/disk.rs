//! A disk that is full, breaks or loses power: real files, with simulated faults.
//!
//! After a power cut, data written but not synced may or may not be there: a growing file ends anywhere in them, and each 4-KiB
//! block of a store is either new or old. Synced data are there. (File names are assumed to be durable at once.)

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, SystemTime};

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use redb::{Builder, Database, StorageBackend};
use stiction_files::disk::{Disk, DiskFile};
use stictiond::runtime::clock::Clock;

const BLOCK: u64 = 4096;

/// State of the disk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    Well,
    /// No file can grow.
    Full,
    /// Writes and syncs fail.
    Broken,
    /// Nothing is written or created.
    ReadOnly,
}

#[derive(Debug)]
struct State {
    random: ChaCha8Rng,
    /// Clock for the files' times of change.
    clock: Clock,
    mode: Mode,
    /// Number of the machine's current life: handles from earlier ones are dead.
    life: u64,
    /// Operations until the power is cut.
    left: Option<u64>,
    growing: Vec<(Arc<File>, u64, u64)>,
    /// Contents of blocks before they were overwritten, oldest first.
    before: Vec<(Arc<File>, u64, Vec<u8>)>,
}

/// The disk; clones share it.
#[derive(Debug, Clone)]
pub struct FaultyDisk(Arc<Mutex<State>>);

impl State {
    /// Whether an operation on a handle may proceed.
    fn operate(&mut self, life: u64) -> io::Result<Mode> {
        if let Some(left) = &mut self.left {
            *left = left.saturating_sub(1);
        }
        if life != self.life || self.left == Some(0) {
            return Err(io::Error::other("the power is off"));
        }
        match self.mode {
            Mode::Broken => Err(io::Error::from_raw_os_error(5)),
            Mode::ReadOnly => Err(io::Error::from_raw_os_error(30)),
            mode => Ok(mode),
        }
    }

    fn grow(&mut self, life: u64) -> io::Result<()> {
        if self.operate(life)? == Mode::Full { Err(io::Error::from_raw_os_error(28)) } else { Ok(()) }
    }
}

impl FaultyDisk {
    pub fn new(seed: u64, clock: &Clock) -> Self {
        let random = ChaCha8Rng::seed_from_u64(seed);
        let (growing, before) = (Vec::new(), Vec::new());
        let clock = clock.clone();
        Self(Arc::new(Mutex::new(State { random, clock, mode: Mode::Well, life: 0, left: None, growing, before })))
    }

    fn with<T>(&self, call: impl FnOnce(&mut State) -> T) -> T {
        call(&mut self.0.lock().unwrap())
    }

    pub fn set(&self, mode: Mode) {
        self.with(|s| s.mode = mode);
    }

    pub fn mode(&self) -> Mode {
        self.with(|s| s.mode)
    }

    /// Cuts the power after this many more operations.
    pub fn cut_after(&self, operations: u64) {
        self.with(|s| s.left = Some(operations));
    }

    /// Whether the power was cut.
    pub fn is_off(&self) -> bool {
        self.with(|s| s.left == Some(0))
    }

    /// Ends this life: the process is killed, and with `power` data not synced may be lost.
    pub fn end(&self, power: bool) {
        self.with(|s| {
            s.life += 1;
            s.left = None;
            let (growing, before) = (std::mem::take(&mut s.growing), std::mem::take(&mut s.before));
            if !power {
                return;
            }
            for (file, synced, written) in growing {
                let kept = synced + u64::from(s.random.next_u32()) % (written - synced + 1);
                file.set_len(kept).unwrap();
                if kept > synced && s.random.next_u32() % 2 == 0 {
                    file.write_at(&[0xA5], kept - 1).unwrap();
                }
            }
            for (file, offset, bytes) in before.iter().rev() {
                if s.random.next_u32() % 2 == 0 {
                    file.write_all_at(bytes, *offset).unwrap();
                }
            }
        });
    }
}

/// A growing file.
struct Growing {
    disk: FaultyDisk,
    file: Arc<File>,
    life: u64,
}

impl DiskFile for Growing {
    fn append(&self, bytes: &[u8]) -> io::Result<usize> {
        self.disk.with(|s| {
            s.grow(self.life)?;
            let Some(entry) = s.growing.iter_mut().find(|(file, ..)| Arc::ptr_eq(file, &self.file)) else {
                return Err(io::Error::other("not open"));
            };
            self.file.write_all_at(bytes, entry.2)?;
            entry.2 += bytes.len() as u64;
            let changed = SystemTime::UNIX_EPOCH + Duration::from_nanos(s.clock.now_ns().try_into().unwrap());
            self.file.set_modified(changed)?;
            Ok(bytes.len())
        })
    }

    fn sync(&self, _all: bool) -> io::Result<()> {
        self.disk.with(|s| {
            s.operate(self.life)?;
            s.growing.iter_mut().filter(|(file, ..)| Arc::ptr_eq(file, &self.file)).for_each(|entry| entry.1 = entry.2);
            Ok(())
        })
    }

    fn is_at(&self, path: &Path) -> bool {
        path.exists()
    }
}

/// The store's file.
#[derive(Debug)]
struct Store {
    disk: FaultyDisk,
    file: Arc<File>,
    life: u64,
}

impl StorageBackend for Store {
    fn len(&self) -> io::Result<u64> {
        Ok(self.file.metadata()?.len())
    }

    fn read(&self, offset: u64, out: &mut [u8]) -> io::Result<()> {
        self.file.read_exact_at(out, offset)
    }

    fn set_len(&self, len: u64) -> io::Result<()> {
        self.disk.with(|s| {
            if len > self.file.metadata()?.len() {
                s.grow(self.life)?;
            }
            s.operate(self.life)?;
            self.file.set_len(len)
        })
    }

    fn sync_data(&self) -> io::Result<()> {
        self.disk.with(|s| {
            s.operate(self.life)?;
            s.before.clear();
            Ok(())
        })
    }

    fn write(&self, offset: u64, data: &[u8]) -> io::Result<()> {
        self.disk.with(|s| {
            s.operate(self.life)?;
            let (mut at, end) = (offset, offset + data.len() as u64);
            while at < end {
                let until = (at / BLOCK + 1).saturating_mul(BLOCK).min(end);
                let mut old = vec![0; (until - at) as usize];
                self.file.read_exact_at(&mut old, at)?;
                s.before.push((self.file.clone(), at, old));
                at = until;
            }
            self.file.write_all_at(data, offset)
        })
    }
}

impl Disk for FaultyDisk {
    fn create_new(&self, path: &Path) -> io::Result<Arc<dyn DiskFile>> {
        self.with(|s| {
            let life = s.life;
            s.grow(life)?;
            let file = Arc::new(File::options().read(true).write(true).create_new(true).open(path)?);
            s.growing.push((file.clone(), 0, 0));
            Ok(Arc::new(Growing { disk: self.clone(), file, life }) as Arc<dyn DiskFile>)
        })
    }

    fn create_folder(&self, path: &Path) -> io::Result<()> {
        fs::create_dir_all(path)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.with(|s| s.operate(s.life))?;
        fs::rename(from, to)
    }

    fn open_store(&self, builder: &Builder, path: &Path) -> Result<Database, redb::Error> {
        let file = self.with(|s| {
            s.operate(s.life)?;
            File::options().read(true).write(true).create(true).truncate(false).open(path)
        });
        let store = Store { disk: self.clone(), file: Arc::new(file?), life: self.with(|s| s.life) };
        Ok(builder.create_with_backend(store)?)
    }
}
