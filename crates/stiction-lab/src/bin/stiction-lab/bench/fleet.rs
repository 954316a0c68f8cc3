//! A fleet of loops on this machine: a recording daemon, a plant in another process, and a table of the results.

use std::io::{BufRead as _, BufReader};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use anyhow::{Context, bail};

use super::publisher::{Plan, PublisherFigures};
use super::watch::{Seen, Watched};
use super::{Args, PREFIX, Row};
use stiction::core::units::ns_from_s;
use stictiond::commands::demo;
use stictiond::runtime::clock::now_ns;

/// Rate at which histories are filled before measuring, samples/s, and samples of a signal per message.
const FILL_PACE: f64 = 100_000.0;
const FILL_BATCH: u64 = 30;
/// Time limit for the daemon to finish its queue after the last message, and for the windows due.
const DRAIN_WITHIN: Duration = Duration::from_secs(60);
const JUDGED_WITHIN: Duration = Duration::from_secs(900);
/// Messages from the plant that a restarted daemon waits for, and their rate.
const FIRST: u64 = 400;
const FIRST_PACE: f64 = 40.0;
/// Shares of the messages for which the latency to the engine is printed.
const SHARES: [f64; 2] = [0.5, 0.99];

/// Settings of a run.
#[derive(Debug, Clone)]
pub struct Ask {
    pub loops: usize,
    pub for_s: f64,
    pub every_s: f64,
    pub batch: u64,
    pub rate: Option<f64>,
    pub hop_s: f64,
    pub fill: u64,
    pub max_bytes: usize,
    pub raw: String,
}

impl Ask {
    /// From the command line.
    pub fn of(args: &Args, loops: usize) -> Self {
        Self {
            loops: loops.max(1),
            for_s: args.for_s,
            every_s: args.every,
            batch: args.batch.unwrap_or(1).max(1),
            rate: args.rate,
            hop_s: args.hop,
            fill: args.fill,
            max_bytes: args.max_bytes,
            raw: args.raw.clone(),
        }
    }

    fn pace(&self) -> f64 {
        self.rate.unwrap_or(2.0 * self.loops as f64 / self.every_s)
    }

    /// Plans for filling and for measuring. The hop ends in the middle of the latter.
    fn plans(&self) -> [Plan; 2] {
        let scans = (self.for_s * self.pace() / (2.0 * self.loops as f64)).ceil().max(1.0) as u64;
        // At least four batches, so that the hop ends among them.
        let scans = scans.max(4).next_multiple_of(self.batch);
        let hop_ns = ns_from_s(self.hop_s).max(1);
        let end_ns = now_ns().div_euclid(hop_ns) * hop_ns;
        let start_ns = end_ns - ns_from_s(self.every_s * (self.fill + scans / 2) as f64);
        let measured_ns = start_ns + ns_from_s(self.every_s * self.fill as f64);
        let plan = |start_ns, scans, batch, pace| Plan {
            loops: self.loops,
            every_s: self.every_s,
            start_ns,
            scans,
            batch,
            pace,
        };
        [plan(start_ns, self.fill, FILL_BATCH, FILL_PACE), plan(measured_ns, scans, self.batch, self.pace())]
    }
}

/// A temporary folder, removed on drop.
struct BenchFolder {
    dir: PathBuf,
    config: PathBuf,
    endpoint: String,
    web: String,
}

impl Drop for BenchFolder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.dir);
    }
}

impl BenchFolder {
    fn make(ask: &Ask) -> anyhow::Result<Self> {
        let dir = std::env::temp_dir().join(format!("stictiond-bench-{}", std::process::id()));
        std::fs::create_dir_all(&dir).with_context(|| dir.display().to_string())?;
        let endpoint = format!("tcp/127.0.0.1:{}", demo::free_port(17_447)?);
        let web = format!("127.0.0.1:{}", demo::free_port(18_080)?);
        let (loops, hop_s, recordings) = (ask.loops, ask.hop_s, dir.join("recordings"));
        let text = format!(
            "[site]\nprefix = \"{PREFIX}\"\n[zenoh]\nlisten = [\"{endpoint}\"]\n[input]\nmax_loops = {loops}\n\
             new_loops_per_hour = {loops}\n[window]\nhop_s = {hop_s:?}\nmax_bytes = {}\n[recording]\ndir = {:?}\nraw = \"{}\"\n[web]\nlisten = \"{web}\"\n",
            ask.max_bytes,
            recordings.display().to_string(),
            ask.raw
        );
        let config = dir.join("bench.toml");
        std::fs::write(&config, text).with_context(|| config.display().to_string())?;
        Ok(Self { dir, config, endpoint, web })
    }

    fn recordings(&self) -> PathBuf {
        self.dir.join("recordings")
    }

    fn daemon(&self) -> anyhow::Result<Watched> {
        Watched::start(&self.config, &self.web, &self.recordings())
    }

    fn publisher(&self, plan: &Plan) -> anyhow::Result<Child> {
        let program = std::env::current_exe().context("this program")?;
        let mut command = Command::new(program);
        command
            .args(plan.arguments(&self.endpoint))
            .env("RUST_LOG", "error")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped());
        command.spawn().context("the publisher")
    }
}

/// Results of a run.
#[derive(Debug, Clone)]
pub struct Figures {
    ask: Ask,
    sent: PublisherFigures,
    /// Messages sent before measuring.
    filled: f64,
    before: Seen,
    /// Snapshots after everything was sent and taken, and after all windows were judged.
    after: Seen,
    judged: Seen,
    recorded_bytes: f64,
    /// Start-up time of a daemon that knows all loops, to its first sample, s.
    first_sample_s: f64,
}

/// Runs the benchmark.
///
/// # Errors
/// A process cannot be started, or the daemon does not answer.
pub fn run(ask: &Ask) -> anyhow::Result<Figures> {
    let place = BenchFolder::make(ask)?;
    let daemon = place.daemon()?;
    daemon.answers()?;
    let [fill, measured] = ask.plans();
    let (filled, before) = if fill.scans > 0 {
        let (sent, before) = published(&place, &daemon, &fill, 0.0)?;
        (sent.samples, before)
    } else {
        (0.0, daemon.look()?)
    };
    let (sent, after) = published(&place, &daemon, &measured, filled)?;
    let judged = daemon.until(JUDGED_WITHIN, |seen| seen.count("estimates") >= seen.count("windows"))?;
    let recordings = daemon.recorded_bytes();
    daemon.stop()?;
    let first_sample_s = restart(&place, &measured)?;
    Ok(Figures { ask: ask.clone(), sent, filled, before, after, judged, recorded_bytes: recordings, first_sample_s })
}

/// Publishes a plan and waits until the daemon has taken everything.
fn published(
    place: &BenchFolder,
    daemon: &Watched,
    plan: &Plan,
    already: f64,
) -> anyhow::Result<(PublisherFigures, Seen)> {
    let mut publisher = place.publisher(plan)?;
    let mut line = String::new();
    BufReader::new(publisher.stdout.take().context("its output")?).read_line(&mut line)?;
    let sent = PublisherFigures::read(&line)?;
    let seen = taken(daemon, already + sent.samples)?;
    drop(publisher.stdin.take());
    let status = publisher.wait()?;
    if !status.success() {
        bail!("the publisher failed: {status}");
    }
    Ok((sent, seen))
}

/// Waits until this many samples were taken and recorded, or no more arrive.
fn taken(daemon: &Watched, samples: f64) -> anyhow::Result<Seen> {
    let all = |seen: &Seen| seen.count("samples") >= samples && seen.count("recorded") >= samples;
    match daemon.until(DRAIN_WITHIN, all) {
        Ok(seen) => Ok(seen),
        // Samples missing by now are lost, and the table reports them.
        Err(_) => daemon.look(),
    }
}

/// Start-up time of a daemon that knows all loops, to its first sample, s.
fn restart(place: &BenchFolder, plan: &Plan) -> anyhow::Result<f64> {
    let first = Plan { loops: 1, batch: 1, scans: FIRST, pace: FIRST_PACE, ..*plan };
    let daemon = place.daemon()?;
    let mut publisher = place.publisher(&first)?;
    let seen = daemon.until(DRAIN_WITHIN, |seen| seen.count("samples") > 0.0);
    let took_s = daemon.started.elapsed().as_secs_f64();
    let _ = publisher.kill();
    let _ = publisher.wait();
    daemon.stop()?;
    seen.map(|_| took_s)
}

impl Figures {
    fn seconds(&self) -> f64 {
        self.sent.seconds.max(1e-3)
    }

    /// CPU cores used by the daemon while samples arrived.
    pub fn cores(&self) -> f64 {
        let (Some(from), Some(to)) = (self.before.at, self.after.at) else { return f64::NAN };
        (self.after.cpu_s() - self.before.cpu_s()) / to.duration_since(from).as_secs_f64()
    }

    /// Resident memory, bytes.
    pub fn resident(&self) -> f64 {
        self.judged.resident[0]
    }

    fn came(&self, name: &str) -> f64 {
        self.after.count(name) - self.before.count(name)
    }

    /// Samples lost or rejected anywhere, including documents that were not recorded.
    pub fn lost(&self) -> f64 {
        let missing = self.filled + self.sent.samples - self.judged.count("samples");
        let refused = ["over_rate", "stamps_ahead", "recording_lost"];
        missing.max(0.0) + refused.into_iter().map(|name| self.judged.count(name)).sum::<f64>()
    }

    /// The bottleneck in words: what lost something, else what was busiest.
    fn limit(&self) -> (String, f64) {
        let share = |part: &str| {
            let of = |seen: &Seen| seen.cpu_s.get(part).copied().unwrap_or(0.0);
            (of(&self.after) - of(&self.before)) / self.seconds()
        };
        let parts = self.after.cpu_s.keys().map(|part| (share(part), *part));
        let (busiest, part) = parts.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((0.0, "nothing"));
        let behind = self.sent.samples / self.sent.seconds < 0.98 * self.ask.pace();
        let why = if self.judged.count("recording_lost") > 0.0 {
            "recorder or disk: messages could not be recorded".to_owned()
        } else if self.judged.count("dropped_input") > 0.0 {
            "engine: its queue was full".to_owned()
        } else if self.judged.count("fits_skipped") > 0.0 {
            "fits: no free worker for some windows".to_owned()
        } else if self.lost() > 0.0 {
            "bus: samples did not arrive".to_owned()
        } else if behind {
            "the publisher, or the bus slowing it down".to_owned()
        } else {
            format!("none; the busiest part is {part}")
        };
        (why, busiest)
    }

    /// The table.
    pub fn rows(&self) -> Vec<Row> {
        let loops = self.ask.loops as f64;
        let samples = self.filled + self.sent.samples;
        let row = |name: &str, value: f64, unit: &'static str| Row { name: name.to_owned(), value, unit };
        let mut rows = vec![
            row("loops", loops, "loops"),
            row("published", self.sent.samples, "samples"),
            row("  a second", self.sent.samples / self.seconds() / 1e3, "thousand/s"),
            row("  messages", self.sent.messages, "messages"),
            row("  by a process that took", self.sent.cpu_s / self.seconds(), "cores"),
            row("received", self.came("messages"), "messages"),
            row("taken by the engine", self.came("samples"), "samples"),
            row("recorded, including filling and documents", self.judged.count("recorded"), "messages"),
            row("lost or rejected anywhere", self.lost(), "samples"),
            row("windows due", self.judged.count("windows"), "windows"),
            row("  judged", self.judged.count("estimates") - self.judged.count("fits_skipped"), "windows"),
            row("  skipped", self.judged.count("fits_skipped"), "windows"),
            row("CPU of the daemon while samples came", self.cores(), "cores"),
        ];
        for (part, cpu_s) in &self.after.cpu_s {
            let before = self.before.cpu_s.get(part).copied().unwrap_or(0.0);
            rows.push(row(&format!("  {part}"), (cpu_s - before) / self.seconds(), "cores"));
        }
        for share in SHARES {
            let name = format!("publisher to engine, {:.0} % of the messages within", 100.0 * share);
            rows.push(row(&name, 1e3 * self.after.intake_s(&self.before, share), "ms"));
        }
        let windows = self.judged.value("stictiond_loop_bytes") / loops;
        rows.extend([
            row("resident memory", self.resident() / f64::from(1 << 20), "MiB"),
            row("  peak", self.judged.resident[1] / f64::from(1 << 20), "MiB"),
            row("  per loop, whole process", self.resident() / loops, "bytes"),
            row("  per loop, in the engine", windows, "bytes"),
            row("on the disk", self.recorded_bytes / samples.max(1.0), "bytes/sample"),
            row("a start with these loops known, to the first sample", self.first_sample_s, "s"),
        ]);
        let (why, busiest) = self.limit();
        rows.push(Row { name: format!("limits: {why}"), value: busiest, unit: "cores" });
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hop_ends_while_it_is_measured() {
        let ask = Ask {
            loops: 100,
            for_s: 60.0,
            every_s: 10.0,
            batch: 1,
            rate: None,
            hop_s: 3600.0,
            fill: 30,
            max_bytes: 0,
            raw: "json".to_owned(),
        };
        let [fill, measured] = ask.plans();
        assert_eq!((fill.scans, measured.scans, ask.pace()), (30, 6, 20.0));
        let end_ns = measured.start_ns + ns_from_s(30.0);
        assert_eq!((end_ns % ns_from_s(3600.0), measured.start_ns - fill.start_ns), (0, ns_from_s(300.0)));
        let fast = Ask { rate: Some(2000.0), batch: 7, ..ask };
        assert_eq!(fast.plans()[1].scans % 7, 0);
    }
}
