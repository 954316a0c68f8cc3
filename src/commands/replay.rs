//! `stictiond replay`: re-runs the engine on recordings and checks that the results are identical.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use serde_json::json;

use crate::cli::{Format, Outcome, block_on, counted, say};
use crate::daemon::replay::parallel::{FileReport, ParallelReplay};
use crate::daemon::replay::{Output, chains_of, files_before};
use crate::daemon::source::zenoh as bus;
use stiction::core::units::probability;
use stiction_engine::codec::topic::{self, Kind};
use stiction_files::RecordingReader;
use stiction_files::run::RunMetadata;

/// Re-run the engine on a recording or a folder of recordings.
///
/// With --verify, compare every estimate, alarm and gap byte for byte with the recorded one. Exit 1 on the first
/// difference; exit 2 if another version made the file or its configuration reads differently now. With --config, judge the
/// samples under another configuration, beside the recorded one, and print which alarms and verdicts that changes.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stictiond replay recordings/demo --verify
  stictiond replay recordings/demo --config new.toml
  stictiond replay recordings/sticking.mcap --format json")]
pub struct Args {
    /// Recording, or folder of recordings.
    pub input: PathBuf,
    /// Compare the results with the recorded ones.
    #[arg(long)]
    pub verify: bool,
    /// Judge the samples under this configuration (TOML) and print what changes. Windows begin empty; each loop is judged by
    /// itself.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["verify", "publish"])]
    pub config: Option<PathBuf>,
    /// With --verify, also compare recordings made by another version.
    #[arg(long, requires = "verify")]
    pub allow_version: bool,
    /// Publish the results again on the recording's topics; needs --connect.
    #[arg(long, requires = "connect")]
    pub publish: bool,
    /// Zenoh endpoint to publish to, such as tcp/127.0.0.1:7447.
    #[arg(long, requires = "publish", value_parser = crate::cli::bus::endpoint)]
    pub connect: Option<String>,
}

/// Totals over all files.
#[derive(Default)]
struct Totals {
    files: usize,
    compared: usize,
    /// Groups with loops that are not all in the recordings replayed together.
    unchecked: usize,
    cut: bool,
}

/// Runs the command.
///
/// # Errors
/// No recording of this program, a required file is missing, or a file cannot be read.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    if let Some(config) = &args.config {
        return crate::commands::judge::run(&args.input, config, format);
    }
    let mut totals = Totals::default();
    let mut publisher = Publisher::open(args)?;
    for chain in chains_of(&args.input)? {
        if let Some(stopped) = replay_chain(args, format, &chain, &mut totals, &mut publisher)? {
            return Ok(stopped);
        }
    }
    publisher.close()?;
    let (files, compared, unchecked) = (totals.files, totals.compared, totals.unchecked);
    if args.verify {
        if compared == 0 {
            tracing::warn!("nothing to compare: no estimates, alarms or gaps can be read from the recordings");
        }
        if unchecked > 0 {
            tracing::warn!(
                groups = unchecked,
                "not compared: their loops are in several recordings, or their windows began before the first file"
            );
        }
        match format {
            Format::Json => {
                let schema = "stictiond.replay.v1";
                say(
                    json!({"schema": schema, "files": files, "compared": compared, "unchecked": unchecked, "equal": (compared > 0).then_some(true)}),
                )?
            }
            Format::Text if compared == 0 => say(format!("{}: nothing was compared", counted(files, "file")))?,
            Format::Text => {
                let files = counted(files, "file");
                say(format!("{files}, {compared} estimates, alarms, gaps and groups: all equal to the byte"))?
            }
        }
    }
    Ok(if totals.cut { Outcome::DataLoss } else { Outcome::Done })
}

/// Replays the files of one run, after as much of the earlier files as their windows need.
fn replay_chain(
    args: &Args,
    format: Format,
    chain: &[PathBuf],
    totals: &mut Totals,
    publisher: &mut Publisher,
) -> anyhow::Result<Option<Outcome>> {
    let Some(first) = chain.first() else { return Ok(None) };
    let own = metadata_of(first)?;
    let before = files_before(chain)?;
    let mut replay = ParallelReplay::new(&own.config, own.daemon.as_deref(), !own.has_results);
    let mut fresh = true;
    for path in before.iter().chain(chain) {
        let metadata = metadata_of(path)?;
        let shown = chain.contains(path);
        let verify = args.verify && shown;
        if verify && let Some(outcome) = refuse_foreign(args, path, &metadata)? {
            return Ok(Some(outcome));
        }
        replay.set_diagnose(shown);
        let report = replay.file(path, &metadata.prefix, fresh, verify).with_context(|| path.display().to_string())?;
        fresh = false;
        if !shown {
            continue;
        }
        totals.files += 1;
        totals.compared += report.compared;
        totals.unchecked += report.unchecked;
        if let Some(difference) = &report.difference {
            return report_difference(format, path, difference, metadata.lost_before).map(Some);
        }
        show(args, format, path, &metadata, report, totals, publisher)?;
    }
    Ok(None)
}

fn metadata_of(path: &Path) -> anyhow::Result<RunMetadata> {
    let reader = RecordingReader::open(path)?;
    RunMetadata::of(path, reader.metadata())
}

fn show(
    args: &Args,
    format: Format,
    path: &Path,
    metadata: &RunMetadata,
    report: FileReport,
    totals: &mut Totals,
    publisher: &mut Publisher,
) -> anyhow::Result<()> {
    if let Some(reason) = &report.cut {
        totals.cut = true;
        tracing::warn!(file = %path.display(), reason, "the file is incomplete; replayed up to its end");
    }
    for output in report.outputs {
        if !args.verify {
            print(format, &output)?;
        }
        publisher.publish(&metadata.prefix, output)?;
    }
    Ok(())
}

fn print(format: Format, output: &Output) -> anyhow::Result<()> {
    let text = String::from_utf8_lossy(&output.json);
    if format == Format::Json {
        say(text)?;
        return Ok(());
    }
    let d: serde_json::Value = serde_json::from_slice(&output.json)?;
    let time = |v: &serde_json::Value| stiction::core::units::format_rfc3339(v.as_i64().unwrap_or(0));
    let number = |v: &serde_json::Value| v.as_f64().map_or("-".to_owned(), |x| format!("{x:.3}"));
    let text = |v: &serde_json::Value| v.as_str().unwrap_or("?").to_owned();
    let name = &output.loop_name;
    let line = match output.kind {
        Kind::Alarm => {
            format!("{}  {name:<12} alarm {}: {}", time(&d["changed_ns"]), text(&d["state"]), text(&d["detail"]))
        }
        Kind::Gap => format!(
            "{}  {name:<12} gap {} ({}, p {})",
            time(&d["window"]["end_ns"]),
            text(&d["cause"]["id"]),
            text(&d["reason"]),
            d["cause"]["probability"].as_f64().map_or_else(|| "-".to_owned(), probability)
        ),
        Kind::Group => format!(
            "{}  {name:<12} group of {} loops: source {} {} (p {})",
            time(&d["window"]["end_ns"]),
            d["members"].as_array().map_or(0, Vec::len),
            text(&d["source"]["kind"]),
            d["source"]["loop"].as_str().unwrap_or(""),
            d["source"]["probability"].as_f64().map_or_else(|| "-".to_owned(), probability)
        ),
        _ => format!(
            "{}  {name:<12} {:<15} index {:>6}  s {:>7}",
            time(&d["window"]["end_ns"]),
            text(&d["verdict"]),
            number(&d["stiction_index"]),
            number(&d["s"])
        ),
    };
    say(line)?;
    Ok(())
}

/// A file from another version, or whose configuration reads differently now, is not expected to give equal results.
fn refuse_foreign(args: &Args, path: &Path, metadata: &RunMetadata) -> anyhow::Result<Option<Outcome>> {
    if metadata.config_hash.is_empty() {
        tracing::error!(file = %path.display(), "no daemon made it, so it has no results to compare; replay it without --verify");
        return Ok(Some(Outcome::Usage));
    }
    if metadata.config.hash() != metadata.config_hash {
        let (was, is) = (&metadata.config_hash, metadata.config.hash());
        tracing::error!(file = %path.display(), "recorded with config_hash {was}, but this version reads its configuration as {is}; verify it with the version that made it");
        return Ok(Some(Outcome::Usage));
    }
    if metadata.version != stiction::core::VERSION && !args.allow_version {
        let was = &metadata.version;
        tracing::error!(file = %path.display(), "recorded by version {was}, this is {}; use --allow-version to compare anyway", stiction::core::VERSION);
        return Ok(Some(Outcome::Usage));
    }
    Ok(None)
}

fn report_difference(format: Format, path: &Path, difference: &str, lost: u64) -> anyhow::Result<Outcome> {
    let note = if lost > 0 {
        format!("; the recorder lost {lost} messages of this run before this file, so a difference is expected")
    } else {
        String::new()
    };
    match format {
        Format::Json => {
            say(json!({"schema": "stictiond.replay.v1", "file": path, "equal": false, "lost_before": lost,
            "difference": difference}))?
        }
        Format::Text => say(format!("{}: DIFFERS{note}\n{difference}", path.display()))?,
    }
    Ok(Outcome::Failed)
}

/// Publishes the results again if requested.
struct Publisher(Option<zenoh::Session>);

impl Publisher {
    fn open(args: &Args) -> anyhow::Result<Self> {
        let Some(endpoint) = args.connect.as_deref().filter(|_| args.publish) else { return Ok(Self(None)) };
        Ok(Self(Some(block_on(crate::cli::bus::connect(endpoint))?)))
    }

    fn publish(&mut self, prefix: &str, output: Output) -> anyhow::Result<()> {
        use zenoh::Wait;
        let Some(session) = &self.0 else { return Ok(()) };
        let key = topic::result(prefix, &output.loop_name, output.kind);
        let encoding = bus::encoding_of(&key);
        match session.put(&key, output.json).encoding(encoding).wait() {
            Ok(()) => Ok(()),
            Err(error) => bail!("cannot publish on {key}: {error}"),
        }
    }

    fn close(self) -> anyhow::Result<()> {
        use zenoh::Wait;
        if let Some(session) = self.0 {
            session.close().wait().map_err(|e| anyhow::anyhow!("{e}"))?;
        }
        Ok(())
    }
}
