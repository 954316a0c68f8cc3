//! A plant for benchmarks in its own process: loops with OP and PV, published at a fixed rate.

use std::io::{Read as _, Write as _};
use std::time::{Duration, Instant};

use anyhow::anyhow;
use serde_json::{Value as Json, json};
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::key_expr::KeyExpr;
use zenoh::qos::CongestionControl;

use super::{PREFIX, cpu};
use stiction::core::record::{Sample, Signal, Value};
use stiction::core::units::ns_from_s;
use stiction_engine::codec;
use stiction_engine::codec::topic;
use stictiond::cli::say;

/// Messages sent between checks of the clock, as a time at the rate.
const SLICE: Duration = Duration::from_millis(2);
/// One in this many loops sticks and oscillates: 2 %.
const STICKS: usize = 50;
/// The period of its oscillation, in samples.
const PERIOD: u64 = 60;

/// What to publish.
#[derive(Debug, Clone, Copy)]
pub struct Plan {
    pub loops: usize,
    /// Sampling time in plant time, s.
    pub every_s: f64,
    /// Timestamp of the first sample, ns.
    pub start_ns: i64,
    /// Scans of all loops.
    pub scans: u64,
    /// Samples of a signal per message.
    pub batch: u64,
    /// Samples per second over all signals.
    pub pace: f64,
}

/// Totals of what was sent.
#[derive(Debug, Clone, Copy)]
pub struct PublisherFigures {
    pub messages: f64,
    pub samples: f64,
    pub seconds: f64,
    pub cpu_s: f64,
}

impl Plan {
    /// The arguments for the other process.
    pub fn arguments(&self, endpoint: &str) -> Vec<String> {
        let Self { loops, every_s, start_ns, scans, batch, pace } = self;
        let plan = json!([loops, every_s, start_ns, scans, batch, pace]);
        ["bench", "--publish", endpoint, "--plan", &plan.to_string()].map(str::to_owned).to_vec()
    }

    fn read(text: &str) -> anyhow::Result<Self> {
        let (loops, every_s, start_ns, scans, batch, pace) = serde_json::from_str(text)?;
        Ok(Self { loops, every_s, start_ns, scans, batch, pace })
    }
}

impl PublisherFigures {
    /// Parses the output of the other process.
    pub fn read(text: &str) -> anyhow::Result<Self> {
        let said: Json = serde_json::from_str(text.trim())
            .map_err(|e| anyhow!("cannot parse the publisher's output {text:?}: {e}"))?;
        let of = |name: &str| said[name].as_f64().unwrap_or(f64::NAN);
        Ok(Self { messages: of("messages"), samples: of("samples"), seconds: of("seconds"), cpu_s: of("cpu_s") })
    }
}

/// A number from 0 to 1 from a seed. All bits are mixed (SplitMix64): a plain product would give a regular pattern from scan
/// to scan, and a calm loop would look like an oscillating one.
fn drawn(seed: u64) -> f64 {
    let z = seed.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ z >> 31) >> 11) as f64 / (1_u64 << 53) as f64
}

/// A signal's value: calm loops are constant plus noise; the others oscillate as with a sticking valve, OP in ramps and PV
/// in steps.
pub fn value(index: usize, signal: Signal, scan: u64) -> f64 {
    let noise = drawn(scan ^ (index as u64) << 32 ^ (signal as u64) << 56) - 0.5;
    if !index.is_multiple_of(STICKS) {
        return (5000.0 + 10.0 * noise).round() / 100.0;
    }
    let phase = ((scan + index as u64) % PERIOD) as f64 / PERIOD as f64;
    let swing = match signal {
        Signal::Op => 4.0 * (2.0 * (2.0 * phase - 1.0).abs() - 1.0),
        _ if phase < 0.5 => 3.0,
        _ => -3.0,
    };
    50.0 + swing + 0.1 * noise
}

/// Runs in the child process: publishes the plan and reports what was sent.
///
/// # Errors
/// Nothing answers, or the bus rejects the data.
pub fn run(endpoint: &str, plan: &str) -> anyhow::Result<()> {
    let plan = Plan::read(plan)?;
    let session = open(endpoint)?;
    let keys: Vec<[KeyExpr<'static>; 2]> = (0..plan.loops)
        .map(|i| [Signal::Op, Signal::Pv].map(|s| KeyExpr::new(topic::raw(PREFIX, &format!("L{i:06}"), s))))
        .map(|[op, pv]| Ok([op?, pv?]))
        .collect::<zenoh::Result<_>>()
        .map_err(|e| anyhow!("{e}"))?;
    let (started, mut sent, mut payload) =
        (Instant::now(), PublisherFigures { messages: 0.0, samples: 0.0, seconds: 0.0, cpu_s: 0.0 }, Vec::new());
    let mut next_look = 0.0;
    for first in (0..plan.scans).step_by(plan.batch.max(1) as usize) {
        let scans = first..(first + plan.batch.max(1)).min(plan.scans);
        for (index, pair) in keys.iter().enumerate() {
            for (signal, key) in [Signal::Op, Signal::Pv].into_iter().zip(pair) {
                write_payload(&plan, index, signal, scans.clone(), &mut payload);
                let put = session.put(key, payload.as_slice()).encoding(Encoding::APPLICATION_JSON);
                let put = put.timestamp(session.new_timestamp()).congestion_control(CongestionControl::Block);
                put.wait().map_err(|e| anyhow!("{key}: {e}"))?;
                sent.messages += 1.0;
                sent.samples += (scans.end - scans.start) as f64;
            }
            if sent.samples >= next_look {
                let due = Duration::from_secs_f64(sent.samples / plan.pace);
                std::thread::sleep(due.saturating_sub(started.elapsed()));
                next_look = sent.samples + plan.pace * SLICE.as_secs_f64();
            }
        }
    }
    (sent.seconds, sent.cpu_s) = (started.elapsed().as_secs_f64(), cpu::process_seconds());
    let PublisherFigures { messages, samples, seconds, cpu_s } = sent;
    say(json!({"messages": messages, "samples": samples, "seconds": seconds, "cpu_s": cpu_s}))?;
    // Closing the session would drop its queued messages, so wait until the parent has seen all arrive.
    let _ = std::io::stdin().read_to_end(&mut Vec::new());
    session.close().wait().map_err(|e| anyhow!("{e}"))
}

fn write_payload(plan: &Plan, index: usize, signal: Signal, scans: std::ops::Range<u64>, out: &mut Vec<u8>) {
    out.clear();
    let many = plan.batch > 1;
    for (place, scan) in scans.enumerate() {
        let t_ns = plan.start_ns + ns_from_s(plan.every_s * scan as f64);
        let sample = Sample { signal, t_ns, value: Value::number(value(index, signal, scan)), quality: None };
        if many {
            // Writing into memory cannot fail.
            let _ = out.write_all(if place == 0 { b"[" } else { b"," });
        }
        codec::encode_recorded(&sample, out);
    }
    if many {
        out.push(b']');
    }
}

/// A connected session, whenever the other side starts.
fn open(endpoint: &str) -> anyhow::Result<zenoh::Session> {
    let mut config = zenoh::Config::default();
    let endpoints = serde_json::to_string(&[endpoint])?;
    for (key, value) in [
        ("mode", "\"client\""),
        ("scouting/multicast/enabled", "false"),
        ("connect/endpoints", endpoints.as_str()),
        ("connect/timeout_ms", "-1"),
        ("connect/retry", "{period_init_ms:50,period_max_ms:50,period_increase_factor:1}"),
    ] {
        config.insert_json5(key, value).map_err(|e| anyhow!("Zenoh rejects the setting {key} = {value}: {e}"))?;
    }
    let session = zenoh::open(config).wait().map_err(|e| anyhow!("{endpoint}: {e}"))?;
    wait_for_listener(&session)?;
    Ok(session)
}

/// Waits for a subscriber, because earlier data would be lost.
fn wait_for_listener(session: &zenoh::Session) -> anyhow::Result<()> {
    let key = topic::raw(PREFIX, "L000000", Signal::Op);
    let publisher = session.declare_publisher(key.clone()).wait().map_err(|e| anyhow!("{key}: {e}"))?;
    loop {
        match publisher.matching_status().wait() {
            Ok(status) if status.matching() => return Ok(()),
            Ok(_) => std::thread::sleep(Duration::from_millis(10)),
            Err(error) => return Err(anyhow!("{key}: {error}")),
        }
    }
}
