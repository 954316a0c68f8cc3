//! Cost of hours of plant time with the publisher's loops: the time to replay their recording, which is made here and
//! replayed as by `stictiond replay`, and the memory of their histories.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, anyhow};

use super::publisher::value;
use super::{Args, PREFIX, Row, cpu, resident_mib};
use stiction::core::record::{Sample, Signal, Value};
use stiction::core::units::ns_from_s;
use stiction_engine::codec::topic::{self, Kind};
use stiction_engine::config::Config;
use stiction_engine::engine::{Engine, LoopId};
use stiction_files::RecordingFile;
use stictiond::daemon::replay::parallel::ParallelReplay;
use stictiond::daemon::sink::recorder::{LOOPS_PER_FILE, RecordedConfig, RunInfo};

/// Timestamp of the first sample: a full hour, so that a day has 24 files.
const START_NS: i64 = 1_700_000_000 / 3600 * 3600 * stiction::core::units::NS_PER_S;

/// A plant and its recorded duration.
#[derive(Debug, Clone, Copy)]
pub struct Plant {
    pub loops: usize,
    pub hours: f64,
}

impl Plant {
    fn scans(self, every_s: f64) -> u64 {
        (self.hours * 3600.0 / every_s).ceil() as u64
    }
}

impl std::str::FromStr for Plant {
    type Err = String;

    /// Reads `LOOPS,HOURS`.
    fn from_str(text: &str) -> Result<Self, String> {
        let numbers = || Some(text.split_once(',')?).and_then(|(l, h)| Some((l.parse().ok()?, h.parse().ok()?)));
        match numbers() {
            Some((loops, hours)) if loops > 0 && hours > 0.0 && f64::is_finite(hours) => Ok(Self { loops, hours }),
            _ => Err("write LOOPS,HOURS, such as 1000,24".to_owned()),
        }
    }
}

/// Makes the recording, replays it and measures both.
///
/// # Errors
/// The temporary folder cannot be written.
pub fn rows(args: &Args, plant: Plant) -> anyhow::Result<Vec<Row>> {
    let text = format!(
        "[site]\nprefix = \"{PREFIX}\"\n[input]\nmax_loops = {}\n[window]\nhop_s = {:?}\nmax_bytes = {}\n[gap]\nenabled = false\n\
         [recording]\nraw = \"{}\"\n",
        plant.loops.max(1),
        args.hop,
        args.max_bytes,
        args.raw
    );
    let config = Config::parse(&text).map_err(|faults| anyhow!("{}", stictiond::cli::list(&faults)))?;
    let folder = tempfile::tempdir().context("a temporary folder")?;
    let making = cpu::process_seconds();
    let (files, samples) = record(folder.path(), &config, &text, args.every, plant)?;
    let made_s = cpu::process_seconds() - making;
    let bytes = files.iter().map(|file| std::fs::metadata(file).map_or(0, |m| m.len())).sum::<u64>();
    let (started, before) = (Instant::now(), cpu::process_seconds());
    let (mut estimates, mut alarms) = (0, 0);
    for file in &files {
        let report = ParallelReplay::new(&config, None, true).file(file, PREFIX, true, false)?;
        let of = |kind| report.outputs.iter().filter(|output| output.kind == kind).count();
        estimates += of(Kind::Estimate);
        alarms += of(Kind::Alarm);
    }
    let (took_s, cpu_s) = (started.elapsed().as_secs_f64(), cpu::process_seconds() - before);
    let row = |name: &str, value: f64, unit: &'static str| Row { name: name.to_owned(), value, unit };
    Ok(vec![
        row("loops", plant.loops as f64, "loops"),
        row("hours", plant.hours, "h"),
        row("samples, OP and PV", samples as f64, "samples"),
        row("recording: made by", made_s, "s of CPU"),
        row("  on the disk", bytes as f64 / samples.max(1) as f64, "bytes/sample"),
        row("replay", took_s, "s"),
        row("  CPU of all threads", cpu_s, "s of CPU"),
        row("  estimates", estimates as f64, "documents"),
        row("  alarms", alarms as f64, "documents"),
        row("  samples per second", samples as f64 / took_s / 1e3, "thousand/s"),
        row("  resident memory after it", resident_mib(), "MiB"),
    ])
}

/// Memory of this many loops in an engine of this process after this many hours: their histories are then as full as
/// `max_bytes` allows. No window comes due.
///
/// # Errors
/// The configuration has a fault.
pub fn histories(args: &Args, plant: Plant) -> anyhow::Result<Vec<Row>> {
    let mut config = Config::with_prefix(PREFIX);
    (config.input.max_loops, config.window.max_bytes) = (plant.loops, args.max_bytes);
    config.window.hop_s = 1e9;
    let mut engine = Engine::new(config.engine());
    let (empty_mib, before) = (resident_mib(), cpu::seconds());
    let ids: Vec<LoopId> = (0..plant.loops).filter_map(|index| engine.appear(&format!("L{index:06}"))).collect();
    let scans = plant.scans(args.every);
    let mut events = Vec::new();
    for scan in 0..scans {
        let t_ns = START_NS + ns_from_s(args.every * scan as f64);
        for (index, id) in ids.iter().enumerate() {
            for signal in [Signal::Op, Signal::Pv] {
                let value = Value::number(value(index, signal, scan));
                engine.push(*id, Sample { signal, t_ns, value, quality: None }, &mut events);
            }
        }
    }
    let (loops, cpu_s) = (plant.loops as f64, cpu::seconds() - before);
    let bytes: usize = ids.iter().map(|id| engine.bytes(*id)).sum();
    let grown_mib = resident_mib() - empty_mib;
    let row = |name: &str, value: f64, unit: &'static str| Row { name: name.to_owned(), value, unit };
    Ok(vec![
        row("loops", loops, "loops"),
        row("hours", plant.hours, "h"),
        row("samples, OP and PV", 2.0 * scans as f64 * loops, "samples"),
        row("CPU of the intake", 1e6 * cpu_s / (2.0 * scans as f64 * loops), "us/sample"),
        row("memory of the loops, as the engine counts it", bytes as f64 / loops, "bytes/loop"),
        row("resident memory of the engine", grown_mib, "MiB"),
        row("  per loop", grown_mib * f64::from(1 << 20) / loops, "bytes/loop"),
    ])
}

/// The recording, with as many loops per file as the daemon uses, scan by scan.
fn record(
    folder: &Path,
    config: &Config,
    text: &str,
    every_s: f64,
    plant: Plant,
) -> anyhow::Result<(Vec<PathBuf>, u64)> {
    let scans = plant.scans(every_s);
    let run = RunInfo {
        prefix: PREFIX.to_owned(),
        run_id: "bench".to_owned(),
        started_ns: START_NS,
        run_number: None,
        origin: "bench",
        config: RecordedConfig::new(config, text.to_owned()),
        daemon: String::new(),
        raw: config.recording.raw,
        continued: BTreeMap::new(),
    };
    let mut files = Vec::new();
    for (shard, first) in (0..plant.loops).step_by(LOOPS_PER_FILE).enumerate() {
        let loops = first..(first + LOOPS_PER_FILE).min(plant.loops);
        let topic = |index: usize, signal| topic::raw(PREFIX, &format!("L{index:06}"), signal);
        let topics: Vec<[String; 2]> =
            loops.clone().map(|index| [Signal::Op, Signal::Pv].map(|signal| topic(index, signal))).collect();
        let mut file = RecordingFile::create(folder, &run.stem(shard, 0), &run.metadata(shard, 0, "", 0))?;
        for scan in 0..scans {
            let t_ns = START_NS + ns_from_s(every_s * scan as f64);
            for (index, pair) in loops.clone().zip(&topics) {
                for (signal, topic) in [Signal::Op, Signal::Pv].into_iter().zip(pair) {
                    let value = Value::number(value(index, signal, scan));
                    file.sample(topic, t_ns, &Sample { signal, t_ns, value, quality: None })?;
                }
            }
        }
        files.push(file.finish()?);
    }
    Ok((files, 2 * scans * plant.loops as u64))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plant_is_loops_and_hours() {
        let plant: Plant = "1000,24".parse().unwrap();
        assert_eq!((plant.loops, plant.hours), (1000, 24.0));
        for wrong in ["", "1000", "0,24", "10,0", "10,inf", "10,nan", "a,b", "-1,2"] {
            assert!(wrong.parse::<Plant>().is_err(), "{wrong}");
        }
    }
}
