//! The files of a workbench: given on the command line or uploaded, read when somebody looks at them.
//!
//! What is read stays in memory up to a bound, oldest use first out, and is read again when it is wanted.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use schemars::JsonSchema;
use serde::Serialize;

use super::fault::Fault;
use super::reading::ReadingWords;
use super::sampling::sampling_time_s;
use tempfile::TempDir;

use stiction::core::record::{Sample, Signal};
use stiction::core::signal::align::Point;
use stiction_engine::analysis::{Points, Section};
use stiction_engine::config::Config;
use stiction_files::compact::stem_of;
use stiction_files::inputs::Unit;
use stiction_files::run::config_of;
use stiction_files::{Loaded, LoadedLoop, ReadOptions};

/// What may be kept.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Files at a time.
    pub files: usize,
    /// Bytes of one upload.
    pub file_bytes: u64,
    /// Bytes of all uploads.
    pub total_bytes: u64,
    /// Samples of files that stay in memory, bytes.
    pub memory_bytes: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self { files: 64, file_bytes: 256 << 20, total_bytes: 1 << 30, memory_bytes: 512 << 20 }
    }
}

/// Loops whose points stay joined.
const JOINED: usize = 4;

/// A file as the page shows it.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct FileInfo {
    /// Its name in addresses.
    pub id: String,
    /// What it is called.
    pub name: String,
    /// Bytes.
    pub bytes: u64,
    /// Whether it was uploaded; else it stands where the command line said.
    pub uploaded: bool,
    /// How it is read: options by name.
    #[schemars(with = "std::collections::BTreeMap<String, String>")]
    pub reading: ReadingWords,
    /// What was recognised in an export.
    pub recognised: Option<String>,
    /// What a person should know.
    pub warnings: Vec<String>,
    /// Its loops.
    pub loops: Vec<LoopInfo>,
}

/// A loop as the page shows it. Missing numbers are null.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct LoopInfo {
    /// Its name.
    pub name: String,
    /// Samples after OP and PV are joined, as `--samples` counts them.
    pub samples: usize,
    /// First stamp, ms since 1970.
    pub start_ms: Option<f64>,
    /// Last stamp, ms since 1970.
    pub end_ms: Option<f64>,
    /// Sampling time, s.
    pub ts_s: Option<f64>,
    /// What both tags have in common, where the file gives tags.
    pub tag: Option<String>,
    /// Tags of OP and PV, and what somebody noted.
    pub about: Option<String>,
    /// Units of OP and PV.
    pub units: [Option<String>; 2],
    /// Signals that are there.
    pub columns: Vec<&'static str>,
}

/// Place of a file, and how it is read.
#[derive(Debug, Clone)]
struct Source {
    unit: Unit,
    /// What the files are called: by whoever uploaded one, or as on the command line.
    called: Vec<String>,
    uploaded: bool,
    options: ReadOptions,
}

struct Held {
    info: FileInfo,
    source: Source,
    loaded: Option<Arc<Opened>>,
    /// When it was wanted last, in wants.
    wanted: u64,
}

/// A file that has been read.
pub struct Opened {
    /// Its contents.
    pub loaded: Loaded,
    /// The configuration that it was recorded under, or the defaults.
    pub config: Config,
}

impl Opened {
    /// A loop by its name.
    ///
    /// # Errors
    /// It has no such loop.
    pub fn choose(&self, name: &str) -> Result<&LoadedLoop, Fault> {
        stiction_files::choose_loop(&self.loaded.loops, name).map_err(Fault::missing)
    }

    fn bytes(&self) -> usize {
        self.loaded.loops.iter().map(|one| one.samples.capacity() * size_of::<Sample>()).sum()
    }
}

/// Bytes of an upload that has begun, given back when it fails.
pub struct UploadSlot {
    shelf: Arc<Shelf>,
    /// Where the bytes go.
    pub path: PathBuf,
    number: u64,
    bytes: u64,
    kept: bool,
}

#[derive(Default)]
struct Inner {
    files: Vec<Held>,
    joined: VecDeque<(String, String, Arc<Points>)>,
    /// Uploads under way, and the bytes of all uploads.
    coming: usize,
    bytes: u64,
    next: u64,
    wants: u64,
}

impl Inner {
    fn want(&mut self) -> u64 {
        self.wants += 1;
        self.wants
    }
}

/// The folder of uploads, ours alone.
enum Folder {
    /// Nothing was uploaded.
    None,
    /// Taken away with this.
    Made(TempDir),
    /// Nothing more is taken.
    Over,
}

/// The files.
pub struct Shelf {
    limits: Limits,
    folder: Mutex<Folder>,
    inner: Mutex<Inner>,
    /// One file is read at a time: a table takes several times its size while it is.
    reading: Mutex<()>,
}

impl Shelf {
    /// An empty one.
    #[must_use]
    pub fn new(limits: Limits) -> Self {
        Self { limits, folder: Mutex::new(Folder::None), inner: Mutex::default(), reading: Mutex::new(()) }
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn folder(&self) -> MutexGuard<'_, Folder> {
        self.folder.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Removes everything that was uploaded; nothing comes after it.
    pub fn clear(&self) {
        // What cannot be removed is left to the system's own cleaning.
        *self.folder() = Folder::Over;
    }

    /// Its bounds.
    #[must_use]
    pub const fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Every file.
    #[must_use]
    pub fn list(&self) -> Vec<FileInfo> {
        self.inner().files.iter().map(|held| held.info.clone()).collect()
    }

    /// One file.
    ///
    /// # Errors
    /// It is not there.
    pub fn info(&self, id: &str) -> Result<FileInfo, Fault> {
        let inner = self.inner();
        inner.files.iter().find(|held| held.info.id == id).map(|held| held.info.clone()).ok_or_else(|| gone(id))
    }

    /// Takes files that the command line names.
    ///
    /// # Errors
    /// They cannot be read, or there are too many files.
    pub fn give(&self, unit: Unit, options: ReadOptions, reading: ReadingWords) -> Result<FileInfo, Fault> {
        let bytes = unit.paths.iter().filter_map(|path| path.metadata().ok()).map(|meta| meta.len()).sum();
        let called = unit.paths.iter().map(|path| path.display().to_string()).collect();
        let source = Source { unit, called, uploaded: false, options };
        let number = {
            let mut inner = self.inner();
            self.room(&inner)?;
            inner.next += 1;
            inner.next
        };
        self.add(number, source, reading, bytes)
    }

    fn room(&self, inner: &Inner) -> Result<(), Fault> {
        if inner.files.len() + inner.coming < self.limits.files {
            return Ok(());
        }
        Err(Fault::too_many(format!("{} files are open, the limit; close one first", self.limits.files)))
    }

    /// Whether there is room for an upload of this size.
    ///
    /// # Errors
    /// It is too large.
    pub fn fits(&self, bytes: u64) -> Result<(), Fault> {
        let most = self.limits.file_bytes;
        if bytes <= most {
            return Ok(());
        }
        let most = most >> 20;
        Err(Fault::too_large(format!(
            "the file is larger than {most} MiB; split it, or name it on the command line of stictiond"
        )))
    }

    /// A place for an upload.
    ///
    /// # Errors
    /// Too many files are open, or no folder can be made.
    pub fn place(self: &Arc<Self>) -> Result<UploadSlot, Fault> {
        let mut folder = self.folder();
        if matches!(*folder, Folder::None) {
            let failed = |error| {
                Fault::conflict(format!("cannot create a folder for uploads: {error}; set TMPDIR to a writable folder"))
            };
            *folder = Folder::Made(private_folder().map_err(failed)?);
        }
        let Folder::Made(folder) = &*folder else { return Err(Fault::conflict("the program is ending")) };
        let mut inner = self.inner();
        self.room(&inner)?;
        inner.coming += 1;
        inner.next += 1;
        let number = inner.next;
        let path = folder.path().join(number.to_string());
        Ok(UploadSlot { shelf: self.clone(), path, number, bytes: 0, kept: false })
    }

    /// Reads a source and puts it on the shelf.
    fn add(&self, number: u64, source: Source, reading: ReadingWords, bytes: u64) -> Result<FileInfo, Fault> {
        let opened = self.read(&source)?;
        let loaded = &opened.loaded;
        let info = FileInfo {
            id: format!("f{number}"),
            name: called(&source.called),
            bytes,
            uploaded: source.uploaded,
            reading,
            recognised: loaded.recognised.as_ref().map(ToString::to_string),
            warnings: loaded.warnings.clone(),
            loops: loaded.loops.iter().map(|one| loop_info(one, &opened.config)).collect(),
        };
        let mut inner = self.inner();
        let wanted = inner.want();
        inner.files.push(Held { info: info.clone(), source, loaded: Some(opened), wanted });
        self.forget(&mut inner);
        Ok(info)
    }

    fn read(&self, source: &Source) -> Result<Arc<Opened>, Fault> {
        let _alone = self.reading.lock().unwrap_or_else(PoisonError::into_inner);
        let Source { unit, called, options, .. } = source;
        let failed = |error: String| Fault::wrong(with_names(&error, &unit.paths, called));
        let loaded = match (&unit.paths[..], &called[..]) {
            ([path], [name]) => stiction_files::load_as(path, Path::new(name), options),
            _ => unit.load(options),
        };
        let loaded = loaded.map_err(|error| failed(error.to_string()))?;
        if loaded.loops.is_empty() {
            return Err(failed(format!("{}: no loop with OP and PV found", unit.name())));
        }
        let config = match &unit.paths[..] {
            [path] => config_of(path).map_err(|error| failed(format!("{error:#}")))?,
            _ => Config::with_prefix("plant"),
        };
        Ok(Arc::new(Opened { loaded, config }))
    }

    /// Contents of a file. Takes as long as reading it where it has left the memory.
    ///
    /// # Errors
    /// It is gone, or cannot be read any more.
    pub fn open(&self, id: &str) -> Result<Arc<Opened>, Fault> {
        let source = {
            let mut inner = self.inner();
            let wanted = inner.want();
            let held = inner.files.iter_mut().find(|held| held.info.id == id).ok_or_else(|| gone(id))?;
            held.wanted = wanted;
            if let Some(opened) = &held.loaded {
                return Ok(opened.clone());
            }
            held.source.clone()
        };
        let opened = self.read(&source)?;
        let mut inner = self.inner();
        if let Some(held) = inner.files.iter_mut().find(|held| held.info.id == id) {
            held.loaded = Some(opened.clone());
        }
        self.forget(&mut inner);
        Ok(opened)
    }

    /// Lets files leave the memory, longest unused first, until the rest fits; the one wanted last stays.
    fn forget(&self, inner: &mut Inner) {
        let size = |held: &Held| held.loaded.as_ref().map_or(0, |opened| opened.bytes());
        let mut sum: usize = inner.files.iter().map(size).sum();
        let mut by_use: Vec<&mut Held> = inner.files.iter_mut().filter(|held| held.loaded.is_some()).collect();
        by_use.sort_by_key(|held| held.wanted);
        by_use.pop();
        for held in by_use {
            if sum <= self.limits.memory_bytes {
                return;
            }
            sum -= size(held);
            held.loaded = None;
        }
    }

    /// A loop's samples joined.
    ///
    /// # Errors
    /// No such file or loop.
    pub fn points(&self, id: &str, name: &str) -> Result<Arc<Points>, Fault> {
        let known = |inner: &Inner| {
            inner.joined.iter().find(|(file, one, _)| file == id && one == name).map(|(.., points)| points.clone())
        };
        if let Some(points) = known(&self.inner()) {
            return Ok(points);
        }
        let opened = self.open(id)?;
        let one = opened.choose(name)?;
        let points = Arc::new(Points::of(&one.name, &one.samples, &opened.config));
        let mut inner = self.inner();
        if inner.joined.len() >= JOINED {
            inner.joined.pop_front();
        }
        inner.joined.push_back((id.to_owned(), name.to_owned(), points.clone()));
        Ok(points)
    }

    /// The names to write behind a command for this file, its reading options included.
    ///
    /// # Errors
    /// It is gone.
    pub fn arguments(&self, id: &str) -> Result<Vec<String>, Fault> {
        let inner = self.inner();
        let held = inner.files.iter().find(|held| held.info.id == id).ok_or_else(|| gone(id))?;
        Ok([held.source.called.clone(), held.info.reading.arguments()].concat())
    }

    /// Closes a file; an uploaded one is removed.
    ///
    /// # Errors
    /// It is not there.
    pub fn close(&self, id: &str) -> Result<(), Fault> {
        let mut inner = self.inner();
        let at = inner.files.iter().position(|held| held.info.id == id).ok_or_else(|| gone(id))?;
        let held = inner.files.remove(at);
        inner.joined.retain(|(file, ..)| file != id);
        if held.source.uploaded {
            inner.bytes = inner.bytes.saturating_sub(held.info.bytes);
            held.source.unit.paths.iter().for_each(|path| drop(std::fs::remove_file(path)));
        }
        Ok(())
    }
}

impl UploadSlot {
    /// Makes room for more bytes.
    ///
    /// # Errors
    /// The file or all uploads together would be too large.
    pub fn grow(&mut self, bytes: u64) -> Result<(), Fault> {
        let limits = &self.shelf.limits;
        self.shelf.fits(self.bytes + bytes)?;
        let mut inner = self.shelf.inner();
        if inner.bytes + bytes > limits.total_bytes {
            let text = format!("uploads are limited to {} MiB in total; close a file first", limits.total_bytes >> 20);
            return Err(Fault::too_large(text));
        }
        inner.bytes += bytes;
        self.bytes += bytes;
        Ok(())
    }

    /// Reads what was uploaded and keeps it.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn keep(mut self, name: &str, reading: ReadingWords) -> Result<FileInfo, Fault> {
        let options = reading.options()?;
        let unit = Unit { paths: vec![self.path.clone()] };
        let source = Source { unit, called: vec![super::names::shown(name)], uploaded: true, options };
        let info = self.shelf.add(self.number, source, reading, self.bytes)?;
        self.kept = true;
        Ok(info)
    }
}

impl Drop for UploadSlot {
    fn drop(&mut self) {
        let mut inner = self.shelf.inner();
        inner.coming -= 1;
        if !self.kept {
            inner.bytes = inner.bytes.saturating_sub(self.bytes);
            // It may never have been made.
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// A new folder that nobody else can look into.
fn private_folder() -> std::io::Result<TempDir> {
    let mut builder = tempfile::Builder::new();
    builder.prefix("stictiond-");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        builder.permissions(std::fs::Permissions::from_mode(0o700));
    }
    builder.tempdir()
}

fn gone(id: &str) -> Fault {
    Fault::missing(format!("there is no open file {:?}; open it again", super::names::shown(id)))
}

/// An error that calls files what their owners call them.
fn with_names(error: &str, paths: &[PathBuf], called: &[String]) -> String {
    let named = |text: String, (path, name): (&PathBuf, &String)| text.replace(&path.display().to_string(), name);
    paths.iter().zip(called).fold(error.to_owned(), named)
}

/// Several files of one loop in one name.
fn called(names: &[String]) -> String {
    let first =
        names.first().map(|name| Path::new(name).file_name().map_or(name.clone(), |n| n.to_string_lossy().into()));
    let first = first.unwrap_or_default();
    if names.len() > 1 { format!("{first} and {} more", names.len() - 1) } else { first }
}

fn loop_info(one: &LoadedLoop, config: &Config) -> LoopInfo {
    let points = Points::of(&one.name, &one.samples, config);
    let all = points.samples(Section::Whole).unwrap_or_default();
    let ms = |point: Option<&Point>| point.map(|p| p.t_ns as f64 / 1e6);
    let signals =
        [(Signal::Op, "op"), (Signal::Pv, "pv"), (Signal::Sp, "sp"), (Signal::Mv, "mv"), (Signal::Mode, "mode")];
    let there = |signal: Signal| one.samples.iter().any(|sample| sample.signal == signal);
    let about = one.about.as_ref().map(|about| {
        let parts = [about.tags.join(", "), about.comment.trim().to_owned()];
        parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("; ")
    });
    LoopInfo {
        name: one.name.clone(),
        samples: all.len(),
        start_ms: ms(all.first()),
        end_ms: ms(all.last()),
        ts_s: sampling_time_s(&all),
        tag: one.about.as_ref().and_then(|about| stem_of(&about.tags)).map(str::to_owned),
        about: about.filter(|text| !text.is_empty()),
        units: one.units.clone(),
        columns: signals.into_iter().filter(|(signal, _)| there(*signal)).map(|(_, name)| name).collect(),
    }
}
