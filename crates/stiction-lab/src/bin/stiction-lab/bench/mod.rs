//! `stiction-lab bench`: throughput and memory on this machine.

mod fleet;
mod growth;
mod publisher;
mod replay;
mod solving;
mod watch;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::anyhow;
use serde_json::{Value as Json, json};
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::qos::CongestionControl;

use stiction::core::record::{Sample, Signal, Value};
use stiction::core::units::NS_PER_S;
use stiction::simulated::scenario::Scenario;
use stiction_engine::codec;
use stiction_engine::codec::topic;
use stiction_engine::config::Config;
use stiction_engine::engine::{Engine, Event};
use stictiond::cli::cpu;
use stictiond::cli::{Format, Outcome, block_on, say};
use stictiond::commands::{demo, play};
use stictiond::daemon::RunOptions;

/// Loops on which kernels are timed.
const SCENARIO: &str = include_str!("../../../../../../recordings/scenarios/four-loops.toml");
/// Loops of the loopback test, and its default rate in messages/s.
const LOOPS: usize = 1000;
const RATE: f64 = 20_000.0;
/// Key prefix of the loopback test.
const PREFIX: &str = "bench";

/// Measure this machine: the solver, the engine's intake, and recording of data received over loopback.
///
/// With --loops: N loops sampled every 10 s, 2 % of them oscillating, published by another process; prints the bottleneck.
/// Times of the solver are CPU times of one thread. Compare ratios within one run.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: stiction-lab bench --loops 1000 --for 60")]
pub struct Args {
    /// Duration of the loopback test, s.
    #[arg(long = "for", value_name = "SECONDS", default_value_t = 10.0)]
    pub for_s: f64,
    /// Number of loops, with daemon and publisher in separate processes.
    #[arg(long, value_name = "N")]
    pub loops: Option<usize>,
    /// Sampling time of each signal, s.
    #[arg(long, value_name = "SECONDS", default_value_t = 10.0)]
    pub every: f64,
    /// Published samples per second over all signals, whatever their timestamps say.
    #[arg(long, value_name = "HZ")]
    pub rate: Option<f64>,
    /// Samples of a signal per message [default: 1; 50 if given without a number].
    #[arg(long, value_name = "SAMPLES", num_args = 0..=1, default_missing_value = "50", requires = "loops")]
    pub batch: Option<u64>,
    /// Samples of each signal in the history before measuring.
    #[arg(long, value_name = "SAMPLES", default_value_t = 30, requires = "loops")]
    pub fill: u64,
    /// Time between two windows, s [default: one comes due while measuring].
    #[arg(long, value_name = "SECONDS", default_value_t = 3600.0)]
    pub hop: f64,
    /// Memory limit of a loop's history, bytes; 0 uses the defaults' need.
    #[arg(long, value_name = "BYTES", default_value_t = 32_768)]
    pub max_bytes: usize,
    /// How to record samples: json or columns.
    #[arg(long, value_name = "FORM", default_value = "json", value_parser = ["json", "columns"])]
    pub raw: String,
    /// Record this many loops for this many hours of plant time, then replay the recording with every estimate.
    #[arg(long, value_name = "LOOPS,HOURS")]
    pub replay: Option<replay::Plant>,
    /// Measure the memory of this many loops after this many hours of plant time, in an engine of this process.
    #[arg(long, value_name = "LOOPS,HOURS")]
    pub histories: Option<replay::Plant>,
    /// Measure how costs grow with loops, samples and periods.
    #[arg(long)]
    pub growth: bool,
    /// Measure only the solver: kernels, indicators, screening, estimates.
    #[arg(long)]
    pub solver_only: bool,
    /// Index of labelled recordings, whose estimates are timed too.
    #[arg(long, value_name = "INDEX.csv")]
    pub recordings: Option<PathBuf>,
    /// Endpoint of the daemon; used by the publisher process.
    #[arg(long, hide = true)]
    pub publish: Option<String>,
    /// What the publisher process publishes.
    #[arg(long, hide = true, default_value = "")]
    pub plan: String,
}

struct Row {
    name: String,
    value: f64,
    unit: &'static str,
}

/// Runs the command.
///
/// # Errors
/// No port is free, or the temporary folder cannot be written.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    if let Some(endpoint) = &args.publish {
        publisher::run(endpoint, &args.plan)?;
        return Ok(Outcome::Done);
    }
    if args.growth {
        print(growth::rows(), format)?;
    }
    if let Some(loops) = args.loops {
        print(fleet::run(&fleet::Ask::of(args, loops))?.rows(), format)?;
    }
    if let Some(plant) = args.replay {
        print(replay::rows(args, plant)?, format)?;
    }
    if let Some(plant) = args.histories {
        print(replay::histories(args, plant)?, format)?;
    }
    if args.growth || [args.loops.is_some(), args.replay.is_some(), args.histories.is_some()].contains(&true) {
        return Ok(Outcome::Done);
    }
    solving::rows(args.recordings.as_deref(), |rows| print(rows, format))?;
    if !args.solver_only {
        print(intake()?, format)?;
        print(ingest(args)?, format)?;
    }
    Ok(Outcome::Done)
}

fn print(rows: Vec<Row>, format: Format) -> anyhow::Result<()> {
    for Row { name, value, unit } in rows {
        match format {
            Format::Json => say(json!({"schema": "stictiond.bench.v1", "name": name, "value": value, "unit": unit}))?,
            Format::Text => say(format!("{name:<68} {value:>12.2} {unit}"))?,
        }
    }
    Ok(())
}

fn scenario() -> anyhow::Result<Scenario> {
    Scenario::parse(SCENARIO).map_err(|e| anyhow!("the built-in scenario: {e}"))
}

/// Samples per second through decoding and engine, without fits.
fn intake() -> anyhow::Result<Vec<Row>> {
    let scenario = scenario()?;
    let samples: Vec<(usize, Sample)> = scenario.stream().map(|s| (s.loop_index, s.sample)).collect();
    let payloads: Vec<Vec<u8>> = samples
        .iter()
        .map(|(_, s)| {
            let mut json = Vec::new();
            codec::encode_recorded(s, &mut json);
            json
        })
        .collect();
    let mut out = Vec::new();
    let decoding = Instant::now();
    for ((_, sample), payload) in samples.iter().zip(&payloads) {
        out.clear();
        codec::decode(sample.signal, payload, None, None, 0, &mut out)?;
    }
    let decoded = samples.len() as f64 / decoding.elapsed().as_secs_f64();
    let mut engine = Engine::new(Config::with_prefix(PREFIX).engine());
    let ids: Vec<_> = scenario.loop_names().filter_map(|name| engine.appear(name)).collect();
    let mut events = Vec::new();
    let pushing = Instant::now();
    for (index, sample) in &samples {
        engine.push(ids[*index], *sample, &mut events);
        for event in std::mem::take(&mut events) {
            if let Event::Request(r) = event {
                engine.skip(r.id, r.seq, &mut events);
            }
        }
        events.clear();
    }
    let pushed = samples.len() as f64 / pushing.elapsed().as_secs_f64();
    Ok(vec![
        Row { name: "decode JSON objects".into(), value: decoded / 1e3, unit: "thousand/s" },
        Row { name: "engine intake (join, history, windows)".into(), value: pushed / 1e3, unit: "thousand/s" },
    ])
}

/// A recording daemon in this process, fed over loopback at a fixed rate.
fn ingest(args: &Args) -> anyhow::Result<Vec<Row>> {
    let dir = std::env::temp_dir().join(format!("stictiond-bench-{}", std::process::id()));
    let port = demo::free_port(17_447)?;
    let text = format!(
        "[site]\nprefix = \"{PREFIX}\"\n[zenoh]\nlisten = [\"tcp/127.0.0.1:{port}\"]\n[recording]\ndir = {:?}\n[web]\nenabled = false\n",
        dir.display().to_string()
    );
    let config = Config::parse(&text).map_err(|f| anyhow!("{}", stictiond::cli::list(&f)))?;
    let health = block_on(async {
        let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
        let options = RunOptions::of("bench", stictiond::web::serve);
        let daemon = tokio::spawn(stictiond::daemon::run(config, text, options, async { drop(stopped.await) }));
        let session = stictiond::cli::bus::connect(&format!("tcp/127.0.0.1:{port}")).await?;
        play::wait_for_subscriber(&session, PREFIX).await?;
        let sent = feed(&session, args).await?;
        // The daemon updates its health every 5 s: wait for an update after the last message.
        tokio::time::sleep(Duration::from_secs(6)).await;
        let health = last_health(&session)?;
        drop(stop);
        daemon.await??;
        Ok((sent, health))
    });
    let _ = std::fs::remove_dir_all(&dir);
    let (sent, health) = health?;
    let counter = |name: &str| health["counters"][name].as_f64().unwrap_or(f64::NAN);
    Ok(vec![
        Row { name: "ingest over loopback: sent".into(), value: sent, unit: "messages" },
        Row { name: "  rate".into(), value: args.rate.unwrap_or(RATE) / 1e3, unit: "thousand/s" },
        Row { name: "  received".into(), value: counter("messages"), unit: "messages" },
        Row { name: "  dropped before the engine".into(), value: counter("dropped_input"), unit: "messages" },
        Row { name: "  recorded".into(), value: counter("recorded"), unit: "messages" },
        Row { name: "  not recorded".into(), value: counter("recording_lost"), unit: "messages" },
        Row { name: "resident memory after it".into(), value: resident_mib(), unit: "MiB" },
    ])
}

async fn feed(session: &zenoh::Session, args: &Args) -> anyhow::Result<f64> {
    let keys: Vec<[String; 2]> =
        (0..LOOPS).map(|i| [Signal::Op, Signal::Pv].map(|s| topic::raw(PREFIX, &format!("L{i:05}"), s))).collect();
    let started = Instant::now();
    let rate = args.rate.unwrap_or(RATE);
    let total = (rate * args.for_s) as u64;
    let mut json = Vec::new();
    for sent in 0..total {
        let (scan, place) = (sent / (2 * keys.len() as u64), sent % (2 * keys.len() as u64));
        let (loop_index, signal) = ((place / 2) as usize, (place % 2) as usize);
        let t_ns = 1_700_000_000 * NS_PER_S + scan as i64 * NS_PER_S;
        let value = Value::number(50.0 + libm::sin(scan as f64 * 0.1 + loop_index as f64));
        json.clear();
        codec::encode_recorded(&Sample { signal: Signal::Op, t_ns, value, quality: None }, &mut json);
        let key = &keys[loop_index][signal];
        let put = session.put(key, json.clone()).encoding(Encoding::APPLICATION_JSON);
        put.congestion_control(CongestionControl::Block).await.map_err(|e| anyhow!("{key}: {e}"))?;
        if sent % 100 == 0 {
            let due = Duration::from_secs_f64(sent as f64 / rate);
            tokio::time::sleep(due.saturating_sub(started.elapsed())).await;
        }
    }
    Ok(total as f64)
}

fn last_health(session: &zenoh::Session) -> anyhow::Result<Json> {
    let key = topic::plane(PREFIX, "@daemon/*/health");
    let replies = session.get(&key).wait().map_err(|e| anyhow!("{key}: {e}"))?;
    let reply = replies.recv().map_err(|_| anyhow!("no answer on {key}"))?;
    let sample = reply.into_result().map_err(|e| anyhow!("{key}: {e}"))?;
    Ok(serde_json::from_slice(&sample.payload().to_bytes())?)
}

/// Resident memory of this process, including the publisher.
fn resident_mib() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:"));
    let kib = line.and_then(|l| l.trim().trim_end_matches(" kB").trim().parse::<f64>().ok());
    kib.map_or(f64::NAN, |k| k / 1024.0)
}
