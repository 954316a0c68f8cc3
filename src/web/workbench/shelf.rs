//! The files of a workbench, given on the command line or uploaded.
//!
//! Their contents are kept in memory up to a limit, dropped least recently used first, and read again when needed.

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
use stiction::samples::align::Point;
use stiction_engine::analysis::{Points, Section};
use stiction_engine::config::Config;
use stiction_files::compact::stem_of;
use stiction_files::inputs::Unit;
use stiction_files::run::config_of;
use stiction_files::{Loaded, LoadedLoop, ReadOptions};

/// Limits on what is kept.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Number of files.
    pub files: usize,
    /// Bytes of one upload.
    pub file_bytes: u64,
    /// Bytes of all uploads.
    pub total_bytes: u64,
    /// Bytes of samples kept in memory.
    pub memory_bytes: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self { files: 64, file_bytes: 256 << 20, total_bytes: 1 << 30, memory_bytes: 512 << 20 }
    }
}

/// Loops whose joined points are kept.
const JOINED: usize = 4;

/// A file as the page shows it.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct FileInfo {
    /// Its name in URLs.
    pub id: String,
    /// Its displayed name.
    pub name: String,
    /// Size, bytes.
    pub bytes: u64,
    /// Whether it was uploaded; otherwise it is at the path given on the command line.
    pub uploaded: bool,
    /// How it is read: options by name.
    #[schemars(with = "std::collections::BTreeMap<String, String>")]
    pub reading: ReadingWords,
    /// What was recognised in an export.
    pub recognised: Option<String>,
    /// Warnings about the file.
    pub warnings: Vec<String>,
    /// Its loops.
    pub loops: Vec<LoopInfo>,
}

/// A loop as the page shows it. Missing numbers are null.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct LoopInfo {
    /// Its name.
    pub name: String,
    /// Number of samples after OP and PV are joined, as counted by `--samples`.
    pub samples: usize,
    /// First stamp, ms since 1970.
    pub start_ms: Option<f64>,
    /// Last stamp, ms since 1970.
    pub end_ms: Option<f64>,
    /// Sampling time, s.
    pub ts_s: Option<f64>,
    /// The common part of OP's and PV's tags, if the file has tags.
    pub tag: Option<String>,
    /// Tags of OP and PV, and the comment.
    pub about: Option<String>,
    /// Units of OP and PV.
    pub units: [Option<String>; 2],
    /// Signals present.
    pub columns: Vec<&'static str>,
}

/// Location of a file, and how to read it.
#[derive(Debug, Clone)]
struct Source {
    unit: Unit,
    /// Displayed names of the files: from the upload, or as on the command line.
    called: Vec<String>,
    uploaded: bool,
    options: ReadOptions,
}

struct Held {
    info: FileInfo,
    source: Source,
    loaded: Option<Arc<Opened>>,
    /// Last use, on the counter of uses.
    wanted: u64,
}

/// A file that has been read.
pub struct Opened {
    /// Its contents.
    pub loaded: Loaded,
    /// The configuration under which it was recorded, or the defaults.
    pub config: Config,
}

impl Opened {
    /// A loop by its name.
    ///
    /// # Errors
    /// There is no such loop.
    pub fn choose(&self, name: &str) -> Result<&LoadedLoop, Fault> {
        stiction_files::choose_loop(&self.loaded.loops, name).map_err(Fault::missing)
    }

    fn bytes(&self) -> usize {
        self.loaded.loops.iter().map(|one| one.samples.capacity() * size_of::<Sample>()).sum()
    }
}

/// An upload under way; its bytes are given back if it fails.
pub struct UploadSlot {
    shelf: Arc<Shelf>,
    /// File that the bytes are written to.
    pub path: PathBuf,
    number: u64,
    bytes: u64,
    kept: bool,
}

#[derive(Default)]
struct Inner {
    files: Vec<Held>,
    joined: VecDeque<(String, String, Arc<Points>)>,
    /// Number of uploads under way, and bytes of all uploads.
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

/// The folder for uploads, readable by us alone.
enum Folder {
    /// Nothing was uploaded yet.
    None,
    /// Deleted when this is dropped.
    Made(TempDir),
    /// No more uploads are taken.
    Over,
}

/// The files.
pub struct Shelf {
    limits: Limits,
    folder: Mutex<Folder>,
    inner: Mutex<Inner>,
    /// Held while a file is read, one at a time: reading a table takes several times its size.
    reading: Mutex<()>,
}

impl Shelf {
    /// An empty shelf.
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

    /// Deletes all uploads; no more are accepted.
    pub fn clear(&self) {
        // What cannot be deleted is left to the system's cleanup.
        *self.folder() = Folder::Over;
    }

    /// Its limits.
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
    /// It does not exist.
    pub fn info(&self, id: &str) -> Result<FileInfo, Fault> {
        let inner = self.inner();
        inner.files.iter().find(|held| held.info.id == id).map(|held| held.info.clone()).ok_or_else(|| gone(id))
    }

    /// Adds files named on the command line.
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

    /// Checks that an upload of this size is allowed.
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

    /// Starts an upload.
    ///
    /// # Errors
    /// Too many files are open, or the folder cannot be created.
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

    /// Reads a file and puts it on the shelf.
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

    /// Contents of a file, read again if they were dropped from memory.
    ///
    /// # Errors
    /// It was closed, or can no longer be read.
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

    /// Drops files from memory, least recently used first, until the rest fits; the last used one stays.
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

    /// A loop's samples, with OP and PV joined.
    ///
    /// # Errors
    /// There is no such file or loop.
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

    /// Command-line arguments that name this file, with its reading options.
    ///
    /// # Errors
    /// It was closed.
    pub fn arguments(&self, id: &str) -> Result<Vec<String>, Fault> {
        let inner = self.inner();
        let held = inner.files.iter().find(|held| held.info.id == id).ok_or_else(|| gone(id))?;
        Ok([held.source.called.clone(), held.info.reading.arguments()].concat())
    }

    /// Closes a file; an uploaded one is deleted.
    ///
    /// # Errors
    /// It does not exist.
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
    /// Reserves more bytes.
    ///
    /// # Errors
    /// The file, or all uploads together, would be too large.
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

    /// Reads the uploaded file and keeps it.
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
            // It may never have been created.
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// A new folder that only this user can read.
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

/// Replaces paths in an error by the names that the user knows.
fn with_names(error: &str, paths: &[PathBuf], called: &[String]) -> String {
    let named = |text: String, (path, name): (&PathBuf, &String)| text.replace(&path.display().to_string(), name);
    paths.iter().zip(called).fold(error.to_owned(), named)
}

/// One name for several files of a loop.
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
