//! `stictiond test --write`: writes expectations from what a configuration now reports for given data.

use std::fmt::Write as _;
use std::path::{Component, Path, PathBuf};

use anyhow::Context;

use crate::cli::reading::ReadArgs;
use crate::cli::refuse_existing;
use crate::cli::{in_order_on_all_cores, put, stop};
use crate::commands::test::{Heard, Input, load, report_on};
use stiction::core::units::significant;
use stiction_engine::config::Config;
use stiction_files::LoadedLoop;

/// Relative tolerance of a size in either direction.
const BAND: f64 = 0.1;

/// A loop of an input.
struct LoopOf<'a> {
    input: &'a Path,
    one: &'a LoadedLoop,
    /// Whether a case must state the loop's name.
    is_named: bool,
}

/// Writes a case for each loop covered by the configuration; returns their number.
///
/// # Errors
/// The data cannot be read, or the file exists or cannot be written.
pub(super) fn write(
    config: &Config,
    inputs: &[PathBuf],
    reading: &ReadArgs,
    (out, force): (&Path, bool),
) -> anyhow::Result<usize> {
    refuse_existing(out, force)?;
    stop::watch();
    let mut all = Vec::new();
    for path in inputs {
        let (loops, _) = load(&Input::of(path), reading)?;
        all.push((path, loops));
    }
    let watched = |name: &str| config.input.discover || config.loop_named(name).is_some();
    let loops: Vec<LoopOf<'_>> = all
        .iter()
        .flat_map(|(input, loops)| {
            let is_named = loops.len() > 1;
            loops.iter().filter(|one| watched(&one.name)).map(move |one| LoopOf { input, one, is_named })
        })
        .collect();
    let mut text = String::from(
        "# What the configuration reports on this data, by `stictiond test --write`. Check each case against what you know of\n\
         # the valve before you rely on it.\n",
    );
    let folder = out.parent().unwrap_or(Path::new(""));
    let work = |of: &LoopOf<'_>, _: &_| report_on(config, &of.one.name, &of.one.samples, None);
    let mut written = 0;
    in_order_on_all_cores(
        &loops,
        |of| of.one.name.clone(),
        work,
        |heard| {
            let of = &loops[written];
            written += 1;
            text.push_str(&case(of, &heard?, folder)?);
            Ok(())
        },
    )?;
    put(&text, Some(out), force)?;
    Ok(written)
}

/// One case, TOML.
fn case(of: &LoopOf<'_>, heard: &Heard, folder: &Path) -> anyhow::Result<String> {
    let LoopOf { input, one, is_named } = of;
    let quoted = |text: &str| toml::Value::String(text.to_owned()).to_string();
    let file = input.file_name().unwrap_or_default().to_string_lossy();
    let Some(estimate) = &heard.found.estimate else {
        return Ok(format!("\n# {} of {file}: no window came due.\n", one.name));
    };
    let mut text = String::from("\n[[case]]\n");
    writeln!(text, "name = {}", quoted(&format!("{} of {file}", one.name)))?;
    writeln!(text, "input = {}", quoted(&relative(input, folder)?))?;
    if *is_named {
        writeln!(text, "loop = {}", quoted(&one.name))?;
    }
    let word = |key: &str| estimate[key].as_str();
    if let Some(verdict) = word("verdict") {
        writeln!(text, "verdict = {}", quoted(verdict))?;
    }
    if let Some(reason) = word("reason").filter(|_| estimate["stiction"].is_null()) {
        writeln!(text, "reason = {}", quoted(reason))?;
    }
    if let Some(s) = estimate["s"].as_f64().filter(|_| estimate["stiction"] == true) {
        let [low, high] = [1.0 - BAND, 1.0 + BAND].map(|share| significant(share * s, 2));
        writeln!(text, "s = [{low}, {high}]              # found: {}", significant(s, 3))?;
    }
    writeln!(text, "alarm = {}", heard.found.alarm)?;
    Ok(text)
}

/// A path relative to a folder.
fn relative(path: &Path, folder: &Path) -> anyhow::Result<String> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let [path, folder] = [path, folder].map(|one| one.canonicalize().with_context(|| one.display().to_string()));
    let (path, folder) = (path?, folder?);
    let common = path.components().zip(folder.components()).take_while(|(a, b)| a == b).count();
    let up = folder.components().skip(common).map(|_| Component::ParentDir);
    let way: PathBuf = up.chain(path.components().skip(common)).collect();
    Ok(way.display().to_string())
}
