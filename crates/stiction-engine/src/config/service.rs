//! Settings of the daemon as a service: recordings and their retention, accepted commands, groups of loops, the summary of data health.

use serde::Serialize;

use super::reader::TableReader;
use stiction::core::verdict::prevalence::{PREVALENCE, SHARES};

/// `[recording]`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Recording {
    /// Folder of the recordings.
    pub dir: String,
    /// Seconds between flushes to disk.
    pub flush_s: f64,
    /// Size at which a file is closed.
    pub max_bytes: u64,
    /// Age at which a file is closed, s.
    pub max_s: f64,
    /// Form of raw samples. Not part of [`Config::hash`], because replays are the same.
    #[serde(skip_serializing)]
    pub raw: RawForm,
}

/// Form of raw samples in a recording.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum RawForm {
    /// A message for each sample.
    #[default]
    Json,
    /// Columns of many samples.
    Columns,
}

impl RawForm {
    /// Its word in configurations and in a file's metadata.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Json => "json",
            Self::Columns => "columns",
        }
    }
}

/// `[retention]`; 0 means no limit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Retention {
    /// Days to keep raw samples.
    pub raw_days: f64,
    /// Most bytes of recordings with raw samples.
    pub raw_bytes: u64,
    /// Days to keep results.
    pub results_days: f64,
    /// Most bytes of recordings with results only.
    pub results_bytes: u64,
}

/// `[commands]`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Commands {
    /// Whether commands are accepted.
    pub enabled: bool,
    /// Alarm commands per minute, over all loops.
    pub per_minute: u32,
    /// Requested gap diagnoses per hour.
    pub runs_per_hour: u32,
}

/// `[plant]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Plant {
    /// Whether loops are compared to find groups that share one oscillation.
    pub groups: bool,
}

/// `[verdict]`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct VerdictParams {
    /// Share of such loops whose valve sticks, 0..1, as assumed by `p_stiction`.
    pub prevalence: f64,
}

/// `[summary]`: the document about obstacles that keep loops from being judged, for receivers and the bus.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// Seconds between two summaries; 0: none.
    pub every_s: f64,
    /// Time of day at which one is due, `HH:MM`, UTC.
    pub at: String,
}

impl Summary {
    /// Time of day at which one is due, s.
    #[must_use]
    pub fn at_s(&self) -> f64 {
        seconds_of_day(&self.at).unwrap_or(0.0)
    }
}

/// Seconds after midnight of `HH:MM`.
fn seconds_of_day(text: &str) -> Option<f64> {
    let (hours, minutes) = text.split_once(':')?;
    let number = |digits: &str, most: u32| {
        let is_plain = digits.len() == 2 && digits.bytes().all(|b| b.is_ascii_digit());
        digits.parse::<u32>().ok().filter(|n| is_plain && *n <= most)
    };
    Some(f64::from(3600 * number(hours, 23)? + 60 * number(minutes, 59)?))
}

impl Default for Retention {
    fn default() -> Self {
        Self { raw_days: 60.0, raw_bytes: 100 << 30, results_days: 3660.0, results_bytes: 20 << 30 }
    }
}

impl Default for VerdictParams {
    fn default() -> Self {
        Self { prevalence: PREVALENCE }
    }
}

impl Default for Plant {
    fn default() -> Self {
        Self { groups: true }
    }
}

impl Default for Summary {
    fn default() -> Self {
        Self { every_s: 86_400.0, at: "06:00".to_owned() }
    }
}

impl Default for Commands {
    fn default() -> Self {
        Self { enabled: true, per_minute: 300, runs_per_hour: 60 }
    }
}

pub(super) fn read_recording(r: &mut TableReader<'_, '_>) -> Recording {
    Recording {
        dir: r.text("dir").map_or_else(|| "recordings".to_owned(), |(t, _)| t),
        flush_s: r.number("flush_s", 1.0, 0.01, 3600.0),
        max_bytes: r.integer("max_bytes", 104_857_600, 10_000, 1_000_000_000_000),
        max_s: r.number("max_s", 3600.0, 0.1, 31_622_400.0),
        raw: r.choice("raw", &[RawForm::Json, RawForm::Columns].map(|raw| (raw.name(), raw))),
    }
}

pub(super) fn read_verdict(r: &mut TableReader<'_, '_>) -> VerdictParams {
    VerdictParams { prevalence: r.number("prevalence", VerdictParams::default().prevalence, SHARES[0], SHARES[1]) }
}

pub(super) fn read_plant(r: &mut TableReader<'_, '_>) -> Plant {
    Plant { groups: r.boolean("groups", Plant::default().groups) }
}

pub(super) fn read_summary(r: &mut TableReader<'_, '_>) -> Summary {
    let d = Summary::default();
    let every_s = r.number("every_s", d.every_s, 0.0, 604_800.0);
    if every_s > 0.0
        && every_s < 1.0
        && let Some(line) = r.line_of("every_s")
    {
        r.refuse(line, "every_s", format!("{every_s} is too short"), "write 0 for no summary, or at least 1");
    }
    let at = match r.text("at") {
        Some((at, line)) if seconds_of_day(&at).is_none() => {
            r.refuse(line, "at", format!("{at:?} is not a time of day"), "write HH:MM in UTC, such as \"06:00\"");
            d.at
        }
        Some((at, _)) => at,
        None => d.at,
    };
    Summary { every_s, at }
}

pub(super) fn read_retention(r: &mut TableReader<'_, '_>) -> Retention {
    let d = Retention::default();
    let (century_days, most) = (36_525.0, 1 << 50);
    Retention {
        raw_days: r.number("raw_days", d.raw_days, 0.0, century_days),
        raw_bytes: r.integer("raw_bytes", d.raw_bytes, 0, most),
        results_days: r.number("results_days", d.results_days, 0.0, century_days),
        results_bytes: r.integer("results_bytes", d.results_bytes, 0, most),
    }
}

pub(super) fn read_commands(r: &mut TableReader<'_, '_>) -> Commands {
    let d = Commands::default();
    Commands {
        enabled: r.boolean("enabled", d.enabled),
        per_minute: r.integer("per_minute", d.per_minute.into(), 1, 100_000) as u32,
        runs_per_hour: r.integer("runs_per_hour", d.runs_per_hour.into(), 0, 100_000) as u32,
    }
}
