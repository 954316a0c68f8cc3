//! `convert IN OUT`: between tables, recordings and compact stores, chosen by OUT's extension.

use crate::cli::reading::{ReadArgs, config_of, named};
use crate::cli::refuse_existing;
use crate::cli::{Format, Outcome, UsageError};
use anyhow::{Context, anyhow, bail};
use serde_json::json;
#[cfg(feature = "parquet")]
use std::collections::BTreeMap;
use std::collections::HashSet;
#[cfg(feature = "parquet")]
use std::collections::btree_map::Entry;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use stiction::core::units::file_stem_of;
use stiction_files::compact::{self, CompactLoop};
use stiction_files::even::even;
#[cfg(feature = "parquet")]
use stiction_files::partition;
use stiction_files::transfer::write_loops;
use stiction_files::{Loaded, LoadedLoop, METADATA_PREFIX, csv};

/// Prefix of the topics for tables, which have no prefix.
const PREFIX: &str = "plant";

/// Most names listed in a message.
const NAMES_SHOWN: usize = 20;

/// Convert tables, exports, recordings and compact stores to .csv, .mcap or .mat
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stictiond convert plant.mcap loops/                       one .csv per loop
  stictiond convert plant.mcap FIC101.csv --loop FIC101
  stictiond convert store.mat store.mcap
  stictiond convert loops.mcap store.mat                    for the toolbox
  stictiond convert plant.mcap data/ --partition loop,day   Parquet by loop and day
  stictiond convert exports/ june.mcap --tz Europe/Berlin   an historian's files

A compact store has one sampling time; its toolbox reads OP and PV, this program also what it adds: SP, MV, mode, units.")]
pub struct ConvertArgs {
    /// Input files (recordings, tables, exports, or folders of them), then the output: .csv, .mcap or .mat, or a folder for
    /// one .csv per loop. A truncated recording is read up to where it ends.
    #[arg(value_names = ["IN", "OUT"], num_args = 2.., required = true)]
    pub paths: Vec<PathBuf>,
    /// Options for reading exports
    #[command(flatten)]
    pub reading: ReadArgs,
    /// Convert this loop only
    #[arg(long = "loop", value_name = "NAME")]
    pub loop_name: Option<String>,
    /// Resample to one sample every SECONDS: OP, SP and MODE are held, PV and MV interpolated linearly
    #[arg(long, value_name = "SECONDS", value_parser = resample, allow_negative_numbers = true)]
    pub resample: Option<f64>,
    /// Write Parquet files by loop and day into the folder OUT: loop=NAME/day=YYYY-MM-DD/part-0.parquet
    #[arg(long, value_name = "loop,day", value_parser = ["loop,day"])]
    pub partition: Option<String>,
    /// Replace existing files
    #[arg(long)]
    pub force: bool,
}

pub(super) fn resample(text: &str) -> Result<f64, String> {
    let seconds: f64 = text.parse().map_err(|_| format!("{text:?} is not a number of seconds"))?;
    compact::check_sampling_time(seconds)
}

/// What OUT names: one file or a folder.
enum Target {
    Csv(PathBuf),
    Mcap(PathBuf),
    Mat(PathBuf),
    Folder(PathBuf),
    Partitions(PathBuf),
}

/// Summary of the output.
struct Written {
    path: PathBuf,
    loops: Vec<String>,
    samples: usize,
    rows: Option<usize>,
}

/// Runs the command.
///
/// # Errors
/// Input that cannot be read or output that cannot be written, with its place; [`UsageError`] for a wrong request.
pub fn run(args: &ConvertArgs, format: Format) -> anyhow::Result<Outcome> {
    let [inputs @ .., output] = &args.paths[..] else {
        return Err(UsageError(
            "OUT is missing: name the output after the input, such as plant.csv plant.mcap".to_owned(),
        )
        .into());
    };
    let target = match &args.partition {
        Some(_) => Target::Partitions(output.clone()),
        None => target_of(output)?,
    };
    if let Target::Csv(path) | Target::Mcap(path) | Target::Mat(path) = &target {
        refuse_existing(path, args.force)?;
        if inputs.iter().any(|input| same_file(input, path)) {
            return Err(UsageError(format!("{}: IN and OUT are the same file", path.display())).into());
        }
    }
    let place = named(inputs);
    let mut loaded = args.reading.load_all(inputs)?;
    for warning in &loaded.warnings {
        crate::cli::warn(format_args!("{place}: {warning}"));
    }
    select(&mut loaded, args.loop_name.as_deref(), &place)?;
    let quality = config_of(inputs)?.input.quality;
    loaded.loops.iter_mut().for_each(|one| *one = one.judged(quality));
    if let Some(ts_s) = args.resample {
        for one in &mut loaded.loops {
            *one = even(one, ts_s).map_err(|fault| anyhow!("{place}: {}: {fault}", one.name))?;
        }
    }
    let written = match target {
        Target::Csv(path) => vec![to_csv(&loaded, &path)?],
        Target::Mcap(path) => vec![to_mcap(&loaded, inputs, &path)?],
        Target::Mat(path) => vec![to_mat(&loaded, &path)?],
        Target::Folder(folder) => to_folder(&loaded, &folder, args.force)?,
        Target::Partitions(folder) => to_partitions(std::mem::take(&mut loaded.loops), &folder, args.force)?,
    };
    report(&place, &loaded, &written, format)?;
    Ok(if loaded.data_loss { Outcome::DataLoss } else { Outcome::Done })
}

fn target_of(output: &Path) -> anyhow::Result<Target> {
    if output.is_dir() || output.as_os_str().to_string_lossy().ends_with('/') {
        return Ok(Target::Folder(output.to_owned()));
    }
    let extension = output.extension().map(|e| e.to_string_lossy().to_lowercase());
    match extension.as_deref() {
        Some("csv") => Ok(Target::Csv(output.to_owned())),
        Some("mcap") => Ok(Target::Mcap(output.to_owned())),
        Some("mat") => Ok(Target::Mat(output.to_owned())),
        None => Ok(Target::Folder(output.to_owned())),
        Some(other) => {
            let place = output.display();
            Err(UsageError(format!("{place}: cannot write .{other}; name a .csv, .mcap or .mat file, or a folder"))
                .into())
        }
    }
}

fn same_file(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

/// Keeps only the selected loop.
fn select(loaded: &mut Loaded, name: Option<&str>, place: &str) -> anyhow::Result<()> {
    if loaded.loops.is_empty() {
        bail!("{place}: contains no readable samples");
    }
    let Some(wanted) = name else { return Ok(()) };
    let chosen = stiction_files::choose_loop(&loaded.loops, wanted).map_err(|e| UsageError(format!("{place}: {e}")))?;
    loaded.loops = vec![chosen.clone()];
    Ok(())
}

fn listed(loops: &[LoadedLoop]) -> String {
    let shown: Vec<&str> = loops.iter().take(NAMES_SHOWN).map(|one| one.name.as_str()).collect();
    let more = loops.len().saturating_sub(NAMES_SHOWN);
    if more == 0 { shown.join(", ") } else { format!("{} and {more} more", shown.join(", ")) }
}

fn to_csv(loaded: &Loaded, path: &Path) -> anyhow::Result<Written> {
    let [one] = &loaded.loops[..] else {
        let count = loaded.loops.len();
        let names = listed(&loaded.loops);
        let text = format!("the input has {count} loops ({names}); choose one with --loop, or name a folder as OUT");
        return Err(UsageError(text).into());
    };
    let temporary = Temporary::beside(path);
    let rows = write_table(one, &temporary.path)?;
    temporary.become_file(path)?;
    Ok(written_table(one, path.to_owned(), rows))
}

fn written_table(one: &LoadedLoop, path: PathBuf, rows: usize) -> Written {
    Written { path, loops: vec![one.name.clone()], samples: one.samples.len(), rows: Some(rows) }
}

fn write_table(one: &LoadedLoop, path: &Path) -> anyhow::Result<usize> {
    let context = || format!("{}: cannot be written", path.display());
    let file = File::create(path).with_context(context)?;
    let mut out = BufWriter::with_capacity(1 << 16, file);
    let rows = csv::write(one, &mut out).with_context(context)?;
    let file = out.into_inner().map_err(std::io::IntoInnerError::into_error).with_context(context)?;
    file.sync_all().with_context(context)?;
    Ok(rows)
}

/// One table per loop: all of them or, on an error, none.
fn to_folder(loaded: &Loaded, folder: &Path, force: bool) -> anyhow::Result<Vec<Written>> {
    let mut taken = HashSet::new();
    let paths: Vec<PathBuf> =
        loaded.loops.iter().map(|one| folder.join(format!("{}.csv", file_stem(&one.name, &mut taken)))).collect();
    for path in &paths {
        refuse_existing(path, force)?;
    }
    fs::create_dir_all(folder).with_context(|| format!("{}: cannot create the folder", folder.display()))?;
    let mut written = Vec::with_capacity(paths.len());
    let mut temporaries = Vec::with_capacity(paths.len());
    for (one, path) in loaded.loops.iter().zip(paths) {
        let temporary = Temporary::beside(&path);
        let rows = write_table(one, &temporary.path)?;
        temporaries.push(temporary);
        written.push(written_table(one, path, rows));
    }
    for (temporary, done) in temporaries.into_iter().zip(&written) {
        temporary.become_file(&done.path)?;
    }
    Ok(written)
}

/// Parquet by loop and day. Files of the same loop are merged; each loop is freed once it is written.
#[cfg(feature = "parquet")]
fn to_partitions(loops: Vec<LoadedLoop>, folder: &Path, force: bool) -> anyhow::Result<Vec<Written>> {
    let mut by_name: BTreeMap<String, LoadedLoop> = BTreeMap::new();
    for mut one in loops {
        match by_name.entry(one.name.clone()) {
            Entry::Vacant(place) => {
                place.insert(one);
            }
            Entry::Occupied(mut all) => all.get_mut().samples.append(&mut one.samples),
        }
    }
    let mut written = Vec::with_capacity(by_name.len());
    for one in by_name.into_values() {
        let rows = partition::write(&one, folder, force)?.iter().map(|part| part.rows).sum();
        let path = folder.join(format!("loop={}", partition::encoded(&one.name)));
        written.push(written_table(&one, path, rows));
    }
    Ok(written)
}

#[cfg(not(feature = "parquet"))]
fn to_partitions(_: Vec<LoadedLoop>, _: &Path, _: bool) -> anyhow::Result<Vec<Written>> {
    Err(UsageError("this build cannot write Parquet; rebuild with --features full".to_owned()).into())
}

/// A file stem from a loop's name, unique in its folder, also on file systems that ignore letter case.
fn file_stem(name: &str, taken: &mut HashSet<String>) -> String {
    let stem = file_stem_of(name);
    let mut unique = stem.clone();
    let mut count = 1;
    while !taken.insert(unique.to_lowercase()) {
        count += 1;
        unique = format!("{stem}_{count}");
    }
    unique
}

fn to_mcap(loaded: &Loaded, inputs: &[PathBuf], path: &Path) -> anyhow::Result<Written> {
    let prefix = loaded.metadata.get(METADATA_PREFIX).map_or(PREFIX, String::as_str);
    let names = inputs.iter().filter_map(|input| input.file_name()).map(|name| name.to_string_lossy().into_owned());
    let source = names.collect::<Vec<_>>().join(", ");
    let temporary = Temporary::beside(path);
    let samples = write_loops([&temporary.path, path], prefix, ["convert", &source], &loaded.loops)?;
    let loops = loaded.loops.iter().map(|one| one.name.clone()).collect();
    Ok(Written { path: path.to_owned(), loops, samples, rows: None })
}

/// A compact store of all loops.
fn to_mat(loaded: &Loaded, path: &Path) -> anyhow::Result<Written> {
    let mut stored = Vec::with_capacity(loaded.loops.len());
    for one in &loaded.loops {
        stored.push(CompactLoop::of(one, None).map_err(|fault| {
            anyhow!("{}: {fault}; a compact store needs one sampling time, use --resample SECONDS", one.name)
        })?);
    }
    write_store(&stored, path, true)?;
    let loops = loaded.loops.iter().map(|one| one.name.clone()).collect();
    let rows = stored.iter().map(|one| one.rows.len()).sum();
    Ok(Written { path: path.to_owned(), loops, samples: 2 * rows, rows: Some(rows) })
}

/// Writes a compact store completely or not at all.
pub(super) fn write_store(loops: &[CompactLoop], path: &Path, deflated: bool) -> anyhow::Result<()> {
    let context = || format!("{}: cannot be written", path.display());
    let temporary = Temporary::beside(path);
    let mut out = BufWriter::with_capacity(1 << 16, File::create(&temporary.path).with_context(context)?);
    compact::write(&mut out, loops, deflated).with_context(context)?;
    let file = out.into_inner().map_err(std::io::IntoInnerError::into_error).with_context(context)?;
    file.sync_all().with_context(context)?;
    temporary.become_file(path)
}

/// A temporary file, removed on drop unless renamed to its target.
struct Temporary {
    path: PathBuf,
}

impl Temporary {
    fn beside(target: &Path) -> Self {
        let mut name = target.file_name().unwrap_or_default().to_owned();
        name.push(format!(".tmp{}", std::process::id()));
        Self { path: target.with_file_name(name) }
    }

    fn become_file(self, target: &Path) -> anyhow::Result<()> {
        fs::rename(&self.path, target).with_context(|| format!("{}: cannot be written", target.display()))?;
        Ok(stiction_files::sync_folder(target)?)
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        // If it was renamed, there is nothing to remove.
        let _ = fs::remove_file(&self.path);
    }
}

fn report(input: &str, loaded: &Loaded, written: &[Written], format: Format) -> anyhow::Result<()> {
    let mut text = String::new();
    for done in written {
        let place = done.path.display().to_string();
        if format == Format::Json {
            let document = json!({
                "schema": "stictiond.convert.v1", "input": input, "output": place,
                "loops": done.loops, "samples": done.samples, "rows": done.rows, "data_loss": loaded.data_loss,
            });
            text.push_str(&document.to_string());
        } else {
            let what =
                if done.loops.len() == 1 { done.loops[0].clone() } else { format!("{} loops", done.loops.len()) };
            let rows = done.rows.map_or(String::new(), |rows| format!(" in {rows} rows"));
            text.push_str(&format!("{place}: {what}, {} samples{rows}", done.samples));
        }
        text.push('\n');
    }
    Ok(crate::cli::print(&text)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_stems_are_unique_and_stay_in_their_folder() {
        let mut taken = HashSet::new();
        for (name, stem) in [("u1/FIC", "u1_FIC"), ("u1_fic", "u1_fic_2"), ("..", "_.."), ("a:b", "a_b")] {
            assert_eq!(file_stem(name, &mut taken), stem);
        }
    }
}
