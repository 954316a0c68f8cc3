//! Refills the loops' windows at a start from the recordings of earlier runs, so that the next estimate need not wait for a new
//! window.
//!
//! The newest files of each segment are replayed without computing windows. The first file of the new run names the last of
//! them as its predecessor and the first of them as the start of its windows; so it can be replayed byte for byte, and no
//! sample is recorded twice. Loops keep their segments. A loop starts with an empty window if, by the wall clock, it was silent
//! for longer than a window, or if its keys or the sizes of its window have changed.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::bail;

use crate::daemon::replay::parallel::{LastSeen, ParallelReplay};
use crate::daemon::replay::{heads, neighbour, reach_ns};
use crate::daemon::sink::recorder::{Continued, LOOPS_PER_FILE};
use crate::daemon::startup_state::memory::{LOSS_SHOWN, OwnRuns, RunFile, is_recording};
use crate::runtime::faults::Faults;
use stiction::core::units::ns_from_s;
use stiction_engine::config::Config;
use stiction_engine::engine::{Engine, EngineSettings};
use stiction_files::RecordingReader;
use stiction_files::rescue::{REMOVED, SAMPLES_KEY};
use stiction_files::run::{FilePlace, REFILLED_FROM, RunMetadata};

/// Bytes of recordings read at a start: of all segments together, and of one. A file has 100 MiB by default.
const BYTES: u64 = 512 << 20;
const SEGMENT_BYTES: u64 = 128 << 20;
/// Time limit; what has not been read by then is left out.
const WITHIN: Duration = Duration::from_secs(20);

/// Initial state of a run.
pub struct Refilled {
    /// An engine with the loops whose windows continue; their alarms are not restored.
    pub engine: Engine,
    /// The segments that continue, with their files.
    pub continued: BTreeMap<usize, Continued>,
    /// Last sign of life of each loop, whether or not its windows continue.
    pub last: BTreeMap<String, LastSeen>,
}

impl Refilled {
    /// A run with empty windows.
    #[must_use]
    pub fn empty(config: &Config) -> Self {
        Self { engine: Engine::new(config.engine()), continued: BTreeMap::new(), last: BTreeMap::new() }
    }
}

/// Reads the newest recordings in this folder. Never fails: a file that cannot be read becomes a fault that names it, and its
/// loops start with empty windows.
#[must_use]
pub fn refill(dir: &Path, config: &Config, runs: &OwnRuns, now_ns: i64, faults: &Faults) -> Refilled {
    let (started, settings) = (Instant::now(), config.engine());
    let mut refilled = Refilled::empty(config);
    let last = last_files(dir, config, runs, faults);
    let reading = Reading {
        config,
        settings,
        since_ns: now_ns.saturating_sub(reach_ns(config)),
        now_ns,
        bytes: (BYTES / last.len().max(1) as u64).min(SEGMENT_BYTES),
        until: started + WITHIN,
    };
    for file in last {
        if let Err(error) = reading.segment(&file, &mut refilled) {
            tracing::warn!(file = %file.path.display(), "windows cannot be refilled: {error:#}");
            faults.raise_for("refill", format!("the windows of some loops begin empty: {error:#}"), LOSS_SHOWN);
        }
    }
    let (loops, took_s) = (refilled.engine.count(), format!("{:.1}", started.elapsed().as_secs_f64()));
    tracing::info!(loops, segments = refilled.continued.len(), took_s, "windows refilled from recordings");
    refilled
}

/// The newest file of each segment, from this daemon's own runs, newest run first. File names are not trusted: a segment number
/// beyond the number of loops is skipped.
fn last_files(dir: &Path, config: &Config, own: &OwnRuns, faults: &Faults) -> Vec<RunFile> {
    let (prefix, segments) = (&config.site.prefix, config.input.max_loops.div_ceil(LOOPS_PER_FILE));
    let entries = fs::read_dir(dir).into_iter().flatten().flatten();
    let mut runs: BTreeMap<String, BTreeMap<usize, (u32, PathBuf)>> = BTreeMap::new();
    for path in entries.map(|e| e.path()).filter(|p| p.is_file() && is_recording(p)) {
        let Some(FilePlace { run_id, shard: segment, index }) = FilePlace::of(&path) else { continue };
        if segment >= segments {
            let why =
                format!("{}: its name says shard {segment}, and [input] max_loops has {segments}", path.display());
            faults.raise_for("refill", format!("the windows of some loops begin empty: {why}"), LOSS_SHOWN);
            continue;
        }
        let newest = runs.entry(run_id).or_default().entry(segment).or_insert_with(|| (index, path.clone()));
        if index > newest.0 {
            *newest = (index, path);
        }
    }
    let run_of = |files: BTreeMap<usize, (u32, PathBuf)>| {
        let of = |path: &PathBuf| {
            let reader = RecordingReader::open(path).ok()?;
            RunFile::of(path, reader.metadata()).filter(|_| reader.metadata().get("prefix") == Some(prefix))
        };
        let one = files.values().find_map(|(_, path)| of(path))?;
        let file = |(segment, (index, path))| RunFile { path, segment, index, ..one.clone() };
        Some(files.into_iter().map(file).collect::<Vec<RunFile>>())
    };
    let all = runs.into_values().filter_map(run_of).flatten();
    let (mut files, strange): (Vec<RunFile>, Vec<RunFile>) = all.partition(|file| own.include(file));
    let newest = files.iter().map(|file| (file.run_number, file.started_ns)).max();
    if let Some(first) = strange.iter().find(|file| Some((file.run_number, file.started_ns)) > newest) {
        let name = first.path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let text = format!("{name} is of a run that this daemon has not made: windows do not go on from it");
        tracing::warn!("{text}");
        faults.raise_for("refill strange", text, LOSS_SHOWN);
    }
    files.sort_by_key(|f| (f.segment, std::cmp::Reverse((f.run_number, f.started_ns))));
    files.dedup_by_key(|f| f.segment);
    files.sort_by_key(|f| (std::cmp::Reverse((f.run_number, f.started_ns)), f.segment));
    files
}

/// Limits for reading a segment.
struct Reading<'a> {
    config: &'a Config,
    settings: EngineSettings,
    /// Earliest time that a window which ends now or later can reach back to.
    since_ns: i64,
    now_ns: i64,
    /// Limit on the bytes of a segment's files.
    bytes: u64,
    until: Instant,
}

impl Reading<'_> {
    /// Refills the loops of the segment with this newest file.
    fn segment(&self, last: &RunFile, refilled: &mut Refilled) -> anyhow::Result<()> {
        let prefix = &self.config.site.prefix;
        let files = self.files_up_to(last)?;
        let (Some(first), Some(newest)) = (files.first(), files.last()) else { return Ok(()) };
        let mut rerun = ParallelReplay::of_streams(self.config, self.until);
        for (at, file) in files.iter().enumerate() {
            rerun.file(file, prefix, at == 0, false)?;
        }
        let reader = RecordingReader::open(newest)?;
        let is_unchanged =
            reader.metadata().get("config_hash").is_some_and(|hash| **hash == *self.settings.config_hash);
        let before =
            if is_unchanged { None } else { Some(RunMetadata::of(newest, reader.metadata())?.config.engine()) };
        let count = refilled.engine.count();
        // Newer runs were read first and take precedence.
        for (name, seen) in rerun.take_last() {
            refilled.last.entry(name).or_insert(seen);
        }
        let mut placeless = 0_usize;
        for mut lane in rerun.into_engines() {
            for id in lane.ids() {
                let name = lane.name(id).clone();
                if refilled.engine.find(&name).is_none()
                    && self.goes_on(&name, lane.figures(id).greatest_ns, before.as_ref())
                {
                    let from = last.segment * LOOPS_PER_FILE;
                    let taken = refilled.engine.take_loop(&mut lane, &name, from..from + LOOPS_PER_FILE);
                    placeless += usize::from(taken.is_none());
                }
            }
        }
        if placeless > 0 {
            let file = newest.display();
            tracing::warn!(%file, loops = placeless, "loops find no place: their windows begin empty");
        }
        if refilled.engine.count() > count {
            let name = |path: &Path| {
                let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
                name.strip_suffix(".part").map_or(name.clone(), str::to_owned)
            };
            refilled.continued.insert(last.segment, Continued { from: name(first), previous: name(newest) });
        }
        Ok(())
    }

    /// Whether a loop's window continues. `before` are the settings under which it was recorded, if they differ from the
    /// current ones.
    fn goes_on(&self, name: &str, greatest_ns: Option<i64>, before: Option<&EngineSettings>) -> bool {
        let settings = self.settings.of(name);
        let longest_ns = ns_from_s(settings.window.max_window_s).unsigned_abs();
        let is_same = |old: &EngineSettings| old.of(name).window_continues_under(settings);
        self.config.shard.owns(name)
            && (self.config.input.discover || self.settings.own.contains_key(name))
            && greatest_ns.is_some_and(|t_ns| t_ns.abs_diff(self.now_ns) <= longest_ns)
            && before.is_none_or(is_same)
    }

    /// A segment's newest file that holds loops, and as many files before it as windows reach back into and the limit allows;
    /// oldest first.
    fn files_up_to(&self, last: &RunFile) -> anyhow::Result<Vec<PathBuf>> {
        let (mut files, mut left, mut refilled_from) = (Vec::new(), self.bytes, String::new());
        let mut next = Some(last.path.clone());
        while let Some(path) = next {
            if Instant::now() >= self.until {
                bail!("{}: reading those before it took too long", path.display());
            }
            let reader = RecordingReader::open(&path)?;
            let get = |key: &str| reader.metadata().get(key).map_or("", String::as_str);
            next = Some(get("previous")).filter(|name| !name.is_empty()).and_then(|name| neighbour(&path, name));
            let heads = heads(&path, &self.config.site.prefix)?;
            // A run that was killed before it wrote anything.
            if files.is_empty() && heads.is_empty() && next.is_some() {
                continue;
            }
            let bytes = fs::metadata(&path)?.len();
            if get(SAMPLES_KEY) == REMOVED || bytes > left {
                break;
            }
            left -= bytes;
            let is_first = neighbour(&path, &refilled_from).is_some_and(|first| first == path);
            if !get(REFILLED_FROM).is_empty() {
                get(REFILLED_FROM).clone_into(&mut refilled_from);
            }
            files.push(path);
            if is_first || heads.values().flatten().all(|greatest_ns| *greatest_ns <= self.since_ns) {
                break;
            }
        }
        files.reverse();
        Ok(files)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_with_a_shard_that_no_loop_can_have_is_passed_over_and_told() {
        let dir = tempfile::tempdir().unwrap();
        let pairs = [("prefix", "p"), ("run_id", "r"), ("started_ns", "1"), ("shard", "0"), ("file_index", "0")];
        let metadata = pairs.map(|(key, value)| (key.to_owned(), value.to_owned())).into_iter().collect();
        for segment in ["s0", "s99", "s100", "s4000000", "s18446744073709551615"] {
            let name = format!("p-20260101-r-{segment}-00000");
            stiction_files::RecordingFile::create(dir.path(), &name, &metadata).unwrap().finish().unwrap();
        }
        let (mut config, faults) = (Config::with_prefix("p"), Faults::default());
        config.input.max_loops = 100 * LOOPS_PER_FILE;
        let segments: Vec<usize> =
            last_files(dir.path(), &config, &OwnRuns::default(), &faults).iter().map(|file| file.segment).collect();
        assert_eq!(segments, [0, 99]);
        assert!(faults.list().iter().any(|fault| fault.contains("max_loops")), "{:?}", faults.list());
    }
}
