//! `stictiond play`: publishes a recording's samples on the bus, in place of a gateway.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{anyhow, bail};
use indicatif::ProgressBar;
use serde_json::{Value, json};
use zenoh::bytes::Encoding;
use zenoh::qos::CongestionControl;

use crate::cli::bus::{connect, endpoint, prefix};
use crate::cli::reading::ReadArgs;
use crate::cli::{Format, Outcome, asked_to_stop, block_on, say};
use stiction::core::record::Sample;
use stiction::core::units::s_from_ns;
use stiction_engine::codec::encode_recorded;
use stiction_engine::codec::topic;
use stiction_files::LoadedLoop;

/// Messages per second at `--speed max`: a rate that a daemon can process without loss.
const MAX_RATE: f64 = 20_000.0;
/// Windows waiting in a daemon at which `--speed max` waits for it: beyond 1,024 the daemon drops windows.
const WAITING: f64 = 256.0;
/// Shortest interval between a loop's windows that is assumed at first, s: the default of `[window] every_s`.
const HOP_S: f64 = 600.0;
/// Pause between two health queries to the daemons, and how long one may take to answer.
const LOOK: Duration = Duration::from_secs(1);
/// Time limit for a subscriber to show.
const SUBSCRIBER_WITHIN: Duration = Duration::from_secs(10);
/// How long to wait at the end until everything is sent.
const CLOSE_WITHIN: Duration = Duration::from_secs(60);

/// Publish the samples of recordings, tables and exports on Zenoh, in place of a gateway.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example: stictiond play recordings/sticking.mcap --connect tcp/127.0.0.1:7447 --prefix plant1/area1 --speed 60"
)]
pub struct Args {
    /// Recordings, tables, exports, or folders of them.
    #[arg(required = true)]
    pub input: Vec<PathBuf>,
    /// Options for reading exports.
    #[command(flatten)]
    pub reading: ReadArgs,
    /// Zenoh endpoint of the daemon or router, such as tcp/127.0.0.1:7447.
    #[arg(long, value_parser = endpoint)]
    pub connect: String,
    /// Key prefix of the published samples, such as plant1/area1.
    #[arg(long, value_parser = prefix)]
    pub prefix: String,
    /// Speed as a multiple of real time, or max: 20,000 messages/s, and no faster than the daemons below the prefix judge.
    #[arg(long, default_value = "1", value_parser = speed, allow_negative_numbers = true)]
    pub speed: Speed,
}

/// `--speed`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Speed {
    /// A multiple of real time.
    Times(f64),
    /// As fast as a daemon can certainly follow.
    Max,
}

fn speed(text: &str) -> Result<Speed, String> {
    if text == "max" {
        return Ok(Speed::Max);
    }
    match text.parse::<f64>() {
        Ok(times) if times > 0.0 && times.is_finite() => Ok(Speed::Times(times)),
        _ => Err(format!("{text:?}: write a number above 0, or max")),
    }
}

/// Waits until something subscribes to samples below the prefix; prints a warning if nothing does.
///
/// # Errors
/// The prefix is not a valid key.
pub async fn wait_for_subscriber(session: &zenoh::Session, prefix: &str) -> anyhow::Result<()> {
    let key = format!("{prefix}/**");
    let publisher = session.declare_publisher(&key).await.map_err(|e| anyhow!("{key}: {e}"))?;
    let until = Instant::now() + SUBSCRIBER_WITHIN;
    while !publisher.matching_status().await.is_ok_and(|status| status.matching()) {
        if Instant::now() > until {
            tracing::warn!("nothing subscribes to {key}: samples that nothing takes are lost");
            break;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    publisher.undeclare().await.map_err(|e| anyhow!("{key}: {e}"))
}

/// Samples of all loops in time order; within a loop the recorded order is kept.
pub(super) struct Merged<'l> {
    loops: &'l [LoadedLoop],
    next: Vec<usize>,
}

impl<'l> Merged<'l> {
    /// Merges these loops.
    pub fn new(loops: &'l [LoadedLoop]) -> Self {
        Self { loops, next: vec![0; loops.len()] }
    }
}

impl<'l> Iterator for Merged<'l> {
    type Item = (&'l LoadedLoop, Sample);

    fn next(&mut self) -> Option<Self::Item> {
        let heads = self.loops.iter().zip(&self.next).enumerate();
        let (index, sample) =
            heads.filter_map(|(i, (l, n))| l.samples.get(*n).map(|s| (i, *s))).min_by_key(|(_, s)| s.t_ns)?;
        self.next[index] += 1;
        Some((&self.loops[index], sample))
    }
}

/// Runs the command; Ctrl-C stops it cleanly.
///
/// # Errors
/// The file cannot be read, or nothing answers at the endpoint.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let loaded = args.reading.load_all(&args.input)?;
    for warning in &loaded.warnings {
        tracing::warn!("{warning}");
    }
    let total: usize = loaded.loops.iter().map(|l| l.samples.len()).sum();
    if total == 0 {
        bail!("{}: contains no samples", crate::cli::reading::named(&args.input));
    }
    let (sent, skipped) = block_on(async {
        let stop = asked_to_stop()?;
        let session = connect(&args.connect).await?;
        wait_for_subscriber(&session, &args.prefix).await?;
        let before = skipped_fits(&session, &args.prefix).await;
        let bar = ProgressBar::new(total as u64);
        let mut taken = true;
        let (sent, patience) = tokio::select! {
            sent = async {
                let sent = publish(&session, args, &loaded.loops, &bar).await;
                taken = all_taken(&session, &args.prefix).await?;
                sent
            } => (sent, CLOSE_WITHIN),
            () = stop => (Ok(bar.position()), Duration::from_secs(2)),
        };
        bar.finish_and_clear();
        let after = skipped_fits(&session, &args.prefix).await;
        let skipped = after.zip(before).map_or(0, |(after, before)| after.saturating_sub(before));
        match tokio::time::timeout(patience, session.close()).await {
            Ok(Ok(())) if taken => {}
            _ => tracing::warn!("the last samples may be lost: {} did not take them in time", args.connect),
        }
        sent.map(|sent| (sent, skipped))
    })?;
    if skipped > 0 {
        tracing::warn!(
            "{skipped} windows got no answer because the daemon's machine was too busy: play slower (--speed)"
        );
    }
    match format {
        Format::Json => {
            say(json!({"schema": "stictiond.play.v1", "published": sent, "of": total, "skipped": skipped}))?
        }
        Format::Text => say(format!("{sent} of {total} samples published below {}", args.prefix))?,
    }
    Ok(if loaded.data_loss { Outcome::DataLoss } else { Outcome::Done })
}

/// Waits until a daemon below the prefix has processed what was sent, as shown by its answer to a query that follows the
/// samples on the same path. Closing the session is not enough: it discards what a receiver that is busy for some seconds has
/// not taken yet. False if the daemon does not answer in time. Without a daemon, nothing can be known.
///
/// # Errors
/// The prefix is not a valid key.
async fn all_taken(session: &zenoh::Session, prefix: &str) -> anyhow::Result<bool> {
    let key = topic::plane(prefix, "@daemon/*/health");
    let asked = session.get(&key).congestion_control(CongestionControl::Block).timeout(CLOSE_WITHIN);
    let (started, answers) = (Instant::now(), asked.await.map_err(|e| anyhow!("{key}: {e}"))?);
    while let Ok(answer) = answers.recv_async().await {
        if answer.result().is_ok() {
            return Ok(true);
        }
    }
    Ok(started.elapsed() < CLOSE_WITHIN)
}

async fn publish(
    session: &zenoh::Session,
    args: &Args,
    loops: &[LoadedLoop],
    bar: &ProgressBar,
) -> anyhow::Result<u64> {
    let started = Instant::now();
    let mut first_ns = None;
    let mut json = Vec::new();
    let mut pace = Pace { slice_s: WAITING * HOP_S / loops.len() as f64, from_ns: None };
    for (sent, (of, sample)) in Merged::new(loops).enumerate() {
        let first_ns = *first_ns.get_or_insert(sample.t_ns);
        let due = match args.speed {
            Speed::Times(times) => s_from_ns(sample.t_ns.saturating_sub(first_ns)) / times,
            Speed::Max => sent as f64 / MAX_RATE,
        };
        let ahead = Duration::from_secs_f64(due.clamp(0.0, 1e9)).saturating_sub(started.elapsed());
        if ahead > Duration::from_millis(2) {
            tokio::time::sleep(ahead).await;
        }
        if args.speed == Speed::Max {
            pace.keep(session, &args.prefix, sample.t_ns).await;
        }
        json.clear();
        encode_recorded(&sample, &mut json);
        let key = topic::raw(&args.prefix, &of.name, sample.signal);
        session
            .put(&key, json.clone())
            .encoding(Encoding::APPLICATION_JSON)
            .congestion_control(CongestionControl::Block)
            .await
            .map_err(|e| anyhow!("{key}: {e}"))?;
        bar.inc(1);
    }
    Ok(bar.position())
}

/// Limits how far `--speed max` runs ahead of the daemons.
struct Pace {
    /// Plant time between two waits, s.
    slice_s: f64,
    /// Start of the current slice.
    from_ns: Option<i64>,
}

impl Pace {
    /// At the end of a slice, waits until the daemons have judged most of it.
    async fn keep(&mut self, session: &zenoh::Session, prefix: &str, t_ns: i64) {
        let from_ns = *self.from_ns.get_or_insert(t_ns);
        if s_from_ns(t_ns.saturating_sub(from_ns)) < self.slice_s {
            return;
        }
        self.from_ns = Some(t_ns);
        // Wait for a health document made after the slice, since the current one may be older.
        let Some(asked) = Daemons::of(session, prefix).await else { return };
        let mut most = 0;
        loop {
            tokio::time::sleep(LOOK).await;
            let Some(now) = Daemons::of(session, prefix).await else { return };
            most = most.max(now.fits);
            if now.uptime_s != asked.uptime_s && (now.fits as f64) < WAITING {
                break;
            }
        }
        match most as f64 {
            most if most > 2.0 * WAITING => self.slice_s /= 2.0,
            most if most < WAITING => self.slice_s *= 2.0,
            _ => {}
        }
    }
}

/// Health of the daemons below a prefix.
#[derive(Default)]
struct Daemons {
    /// Waiting windows of the daemon that has the most.
    fits: u64,
    /// Windows left without an answer so far.
    skipped: u64,
    /// Age of the youngest daemon, which tells a new document from an old one.
    uptime_s: f64,
}

impl Daemons {
    /// `None` if no daemon answers.
    async fn of(session: &zenoh::Session, prefix: &str) -> Option<Self> {
        let key = topic::plane(prefix, "@daemon/*/health");
        let replies = session.get(&key).timeout(LOOK).await.ok()?;
        let mut all: Option<Self> = None;
        while let Ok(reply) = replies.recv_async().await {
            let Ok(sample) = reply.result() else { continue };
            let Ok(health) = serde_json::from_slice::<Value>(&sample.payload().to_bytes()) else { continue };
            let queues = health["queues"].as_array().map_or(&[][..], Vec::as_slice);
            let waiting =
                queues.iter().find(|queue| queue["name"] == "fits").and_then(|queue| queue["length"].as_u64());
            let uptime_s = health["uptime_s"].as_f64().unwrap_or(0.0);
            let known = all.get_or_insert(Self { uptime_s, ..Self::default() });
            known.fits = known.fits.max(waiting.unwrap_or(0));
            known.skipped += health["counters"]["fits_skipped"].as_u64().unwrap_or(0);
            known.uptime_s = known.uptime_s.min(uptime_s);
        }
        all
    }
}

/// Windows left without an answer so far because a daemon was too busy; `None` if no daemon answers.
async fn skipped_fits(session: &zenoh::Session, prefix: &str) -> Option<u64> {
    Daemons::of(session, prefix).await.map(|daemons| daemons.skipped)
}
