//! A daemon in its own process: its metrics, and its CPU and memory according to the system.

use std::collections::BTreeMap;
use std::fs;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};

/// Time limit for the daemon's first answer.
const START_WITHIN: Duration = Duration::from_secs(60);
/// Time limit for the daemon to stop.
const STOP_WITHIN: Duration = Duration::from_secs(20);
/// Pause between two polls.
const LOOK_AGAIN: Duration = Duration::from_millis(20);

/// Part of the daemon that a thread belongs to, by the start of its name.
const PARTS: [(&str, &str); 10] = [
    ("engine", "engine"),
    ("record", "recorder"),
    ("publish", "publisher"),
    ("state", "states"),
    ("fit-", "fits"),
    ("gap", "gap"),
    ("rx-", "bus"),
    ("tx-", "bus"),
    ("net-", "bus"),
    ("app-", "bus"),
];

/// The daemon; killed on drop.
pub struct Watched {
    child: Child,
    web: String,
    folder: PathBuf,
    pub started: Instant,
}

impl Drop for Watched {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A snapshot.
#[derive(Debug, Clone, Default)]
pub struct Seen {
    /// Values of `/metrics` by name and labels.
    pub metrics: BTreeMap<String, f64>,
    /// CPU time by part, s.
    pub cpu_s: BTreeMap<&'static str, f64>,
    /// Resident memory, current and peak, bytes.
    pub resident: [f64; 2],
    pub at: Option<Instant>,
}

impl Seen {
    /// Value of a counter.
    pub fn count(&self, name: &str) -> f64 {
        self.value(&format!("stictiond_{name}_total"))
    }

    /// Value of a gauge.
    pub fn value(&self, key: &str) -> f64 {
        self.metrics.get(key).copied().unwrap_or(0.0)
    }

    /// CPU time of all parts, s.
    pub fn cpu_s(&self) -> f64 {
        self.cpu_s.values().sum()
    }

    /// Latency to the engine of this share of the messages since `before`, s.
    pub fn intake_s(&self, before: &Self, share: f64) -> f64 {
        let bucket = "stictiond_intake_seconds_bucket{le=\"";
        let mut steps: Vec<(f64, f64)> = Vec::new();
        for (key, count) in self.metrics.range(bucket.to_owned()..).take_while(|(key, _)| key.starts_with(bucket)) {
            let limit = key[bucket.len()..].trim_end_matches("\"}");
            let limit_s = if limit == "+Inf" { f64::INFINITY } else { limit.parse().unwrap_or(f64::INFINITY) };
            steps.push((limit_s, count - before.value(key)));
        }
        steps.sort_by(|a, b| a.0.total_cmp(&b.0));
        let all = steps.last().map_or(0.0, |(_, count)| *count);
        let found = steps.iter().find(|(_, count)| all > 0.0 && *count >= share * all);
        found.map_or(f64::NAN, |(limit_s, _)| *limit_s)
    }
}

impl Watched {
    /// Starts `stictiond run` with a configuration; returns at once.
    pub fn start(config: &Path, web: &str, folder: &Path) -> anyhow::Result<Self> {
        let program = std::env::current_exe().context("this program")?.with_file_name("stictiond");
        let mut command = Command::new(&program);
        command.args(["run", "--config"]).arg(config).env("RUST_LOG", "error");
        let child = command
            .stdout(Stdio::null())
            .stdin(Stdio::null())
            .spawn()
            .with_context(|| format!("the daemon, {}", program.display()))?;
        Ok(Self { child, web: web.to_owned(), folder: folder.to_owned(), started: Instant::now() })
    }

    /// Polls until `found` returns true.
    pub fn until(&self, within: Duration, mut found: impl FnMut(&Seen) -> bool) -> anyhow::Result<Seen> {
        let begun = Instant::now();
        loop {
            if let Some(seen) = self.look().ok().filter(|seen| found(seen)) {
                return Ok(seen);
            }
            if begun.elapsed() > within {
                bail!("the daemon did not reach the expected state within {} s", within.as_secs());
            }
            std::thread::sleep(LOOK_AGAIN);
        }
    }

    /// Waits until the daemon answers.
    pub fn answers(&self) -> anyhow::Result<Seen> {
        self.until(START_WITHIN, |_| true)
    }

    pub fn look(&self) -> anyhow::Result<Seen> {
        let text = self.get("/metrics")?;
        let rows = text.lines().filter(|l| !l.starts_with('#')).filter_map(|l| l.rsplit_once(' '));
        let metrics = rows.filter_map(|(key, value)| Some((key.to_owned(), value.parse().ok()?))).collect();
        let proc = PathBuf::from(format!("/proc/{}", self.child.id()));
        let status = fs::read_to_string(proc.join("status")).unwrap_or_default();
        let kib = |row: &str| {
            let line = status.lines().find_map(|l| l.strip_prefix(row));
            line.and_then(|l| l.trim().trim_end_matches(" kB").parse::<f64>().ok()).unwrap_or(f64::NAN)
        };
        let resident = [kib("VmRSS:") * 1024.0, kib("VmHWM:") * 1024.0];
        Ok(Seen { metrics, cpu_s: threads(&proc), resident, at: Some(Instant::now()) })
    }

    fn get(&self, path: &str) -> anyhow::Result<String> {
        let mut stream = TcpStream::connect(&self.web)?;
        stream.set_read_timeout(Some(Duration::from_secs(10)))?;
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n\r\n", self.web)?;
        let mut text = String::new();
        stream.read_to_string(&mut text)?;
        Ok(text)
    }

    /// Size of the recordings, bytes.
    pub fn recorded_bytes(&self) -> f64 {
        let entries = fs::read_dir(&self.folder).into_iter().flatten().flatten();
        let recordings = entries.filter(|e| e.file_name().to_string_lossy().contains(".mcap"));
        recordings.filter_map(|e| e.metadata().ok()).map(|m| m.len() as f64).sum()
    }

    /// Stops the daemon cleanly with SIGTERM.
    pub fn stop(mut self) -> anyhow::Result<Duration> {
        let asked = Instant::now();
        ask_to_end(&mut self.child)?;
        while asked.elapsed() < STOP_WITHIN {
            if self.child.try_wait()?.is_some() {
                return Ok(asked.elapsed());
            }
            std::thread::sleep(LOOK_AGAIN);
        }
        bail!("the daemon did not stop within {} s", STOP_WITHIN.as_secs())
    }
}

#[cfg(target_os = "linux")]
fn ask_to_end(child: &mut Child) -> anyhow::Result<()> {
    let pid = i32::try_from(child.id()).ok().and_then(rustix::process::Pid::from_raw).context("its number")?;
    rustix::process::kill_process(pid, rustix::process::Signal::TERM)?;
    Ok(())
}

#[cfg(not(target_os = "linux"))]
fn ask_to_end(child: &mut Child) -> anyhow::Result<()> {
    Ok(child.kill()?)
}

/// CPU time of a process by part, s.
fn threads(proc: &Path) -> BTreeMap<&'static str, f64> {
    let mut parts = BTreeMap::new();
    for entry in fs::read_dir(proc.join("task")).into_iter().flatten().flatten() {
        let text = fs::read_to_string(entry.path().join("stat")).unwrap_or_default();
        // The name is in brackets and may contain any character.
        let (Some(open), Some(close)) = (text.find('('), text.rfind(')')) else { continue };
        let name = &text[open + 1..close];
        let part = PARTS.iter().find(|(start, _)| name.starts_with(start)).map_or("other", |(_, part)| part);
        let ticks = text[close + 1..].split_whitespace().skip(11).take(2).filter_map(|t| t.parse::<f64>().ok());
        *parts.entry(part).or_default() += ticks.sum::<f64>() / ticks_per_s();
    }
    parts
}

#[cfg(target_os = "linux")]
fn ticks_per_s() -> f64 {
    rustix::param::clock_ticks_per_second() as f64
}

#[cfg(not(target_os = "linux"))]
fn ticks_per_s() -> f64 {
    100.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_of_what_came_since() {
        let bucket = |limit: &str| format!("stictiond_intake_seconds_bucket{{le=\"{limit}\"}}");
        let seen = |counts: [f64; 3]| Seen {
            metrics: ["0.001", "0.05", "+Inf"].map(bucket).into_iter().zip(counts).collect(),
            ..Seen::default()
        };
        let (before, after) = (seen([0.0, 0.0, 100.0]), seen([90.0, 99.0, 200.0]));
        assert_eq!((after.intake_s(&before, 0.5), after.intake_s(&before, 0.99)), (0.001, 0.05));
        assert!(after.intake_s(&before, 1.0).is_infinite() && before.intake_s(&before, 0.5).is_nan());
    }
}
