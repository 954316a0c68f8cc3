//! `stictiond replay --config`: judges recordings under another configuration and reports the differences.

use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};

use anyhow::Context;
use serde_json::{Value, json};

use crate::cli::reading::config_file;
use crate::cli::{Format, Outcome, counted, say};
use crate::daemon::received;
use crate::daemon::replay::parallel::ParallelReplay;
use crate::daemon::replay::{Output, chains_of};
use stiction::core::units::format_rfc3339;
use stiction::core::verdict::Assessment;
use stiction_engine::alarm::why_not_active;
use stiction_engine::codec::topic::Kind;
use stiction_engine::config::{Config, ConfigChanges};
use stiction_files::RecordingReader;
use stiction_files::run::RunMetadata;

/// Newest windows kept of a loop, to explain why there is no alarm.
const RECENT: usize = 64;
/// Most alarm changes listed in one line.
const LISTED: usize = 4;

/// A change of an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct AlarmChange {
    at_ns: i64,
    active: bool,
}

/// Results of a loop under one configuration.
#[derive(Default)]
struct Judged {
    windows: u64,
    /// Verdicts by the end of their windows, for windows that the other side does not have yet.
    unpaired: BTreeMap<i64, String>,
    newest: Option<Value>,
    recent: VecDeque<Assessment>,
    alarm: Vec<AlarmChange>,
}

/// A loop under the recorded and the other configuration.
#[derive(Default)]
struct Compared {
    before: Judged,
    after: Judged,
    common: u64,
    /// Number of windows by verdict before and after, where these differ.
    verdicts: BTreeMap<(String, String), u64>,
}

/// Runs the command.
///
/// # Errors
/// A faulty configuration; no recording, or one that cannot be read.
pub(super) fn run(input: &Path, config: &Path, format: Format) -> anyhow::Result<Outcome> {
    let (_, other) = config_file(config)?;
    let files: Vec<PathBuf> = chains_of(input)?.into_iter().flatten().collect();
    let (mut loops, mut recorded, mut cut) = (BTreeMap::<String, Compared>::new(), None::<Config>, false);
    let mut sides: Option<[ParallelReplay; 2]> = None;
    for path in &files {
        let own = RunMetadata::of(path, RecordingReader::open(path)?.metadata())?;
        let first = sides.is_none();
        let sides = sides.get_or_insert_with(|| {
            [ParallelReplay::judging(&own.config, false), ParallelReplay::judging(&other, true)]
        });
        for (side, after) in sides.iter_mut().zip([false, true]) {
            let report = side.file(path, &own.prefix, first, false).with_context(|| path.display().to_string())?;
            if let Some(reason) = report.cut.filter(|_| after) {
                cut = true;
                tracing::warn!(file = %path.display(), reason, "the file is incomplete; judged up to its end");
            }
            for output in &report.outputs {
                let of = loops.entry(output.loop_name.clone()).or_default();
                if after { &mut of.after } else { &mut of.before }.take(output)?;
            }
        }
        loops.values_mut().for_each(Compared::pair);
        recorded = Some(own.config);
    }
    let changes = recorded.map(|recorded| recorded.changes_to(&other)).unwrap_or_default();
    Told { config, other: &other, changes, loops: &loops, files: files.len() }.tell(format)?;
    Ok(if cut { Outcome::DataLoss } else { Outcome::Done })
}

impl Judged {
    fn take(&mut self, output: &Output) -> anyhow::Result<()> {
        let document: Value = serde_json::from_slice(&output.json)?;
        match output.kind {
            Kind::Estimate => {
                self.windows += 1;
                let end_ns = document["window"]["end_ns"].as_i64().unwrap_or(0);
                self.unpaired.insert(end_ns, verdict(&document));
                self.recent.extend(received::estimate(&document).map(|document| document.assessment));
                self.recent.drain(..self.recent.len().saturating_sub(RECENT));
                self.newest = Some(document);
            }
            Kind::Alarm => {
                let active = document["active"] == true;
                if self.is_active() != active {
                    self.alarm.push(AlarmChange { at_ns: document["changed_ns"].as_i64().unwrap_or(0), active });
                }
            }
            _ => {}
        }
        Ok(())
    }

    fn is_active(&self) -> bool {
        self.alarm.last().is_some_and(|change| change.active)
    }

    /// The newest window, in a few words.
    fn newest(&self) -> String {
        let Some(newest) = &self.newest else { return "no window".to_owned() };
        let s = newest["s"].as_f64().map_or_else(String::new, |s| format!(", s {}", stiction::core::people::size(s)));
        format!("{}{s}", verdict(newest))
    }

    /// The alarm's changes, in a few words.
    fn told(&self) -> String {
        let raised = self.alarm.iter().filter(|change| change.active).count();
        if raised == 0 {
            return "not raised".to_owned();
        }
        let at: Vec<String> = self
            .alarm
            .iter()
            .take(LISTED)
            .map(|change| {
                format!("{} {}", if change.active { "raised" } else { "cleared" }, format_rfc3339(change.at_ns))
            })
            .collect();
        let more = self.alarm.len().saturating_sub(LISTED);
        let more = if more > 0 { format!(" and {more} more changes") } else { String::new() };
        format!("{}{more}", at.join(", "))
    }

    fn document(&self) -> Value {
        let alarm: Vec<Value> = self.alarm.iter().map(|c| json!({"at_ns": c.at_ns, "active": c.active})).collect();
        let newest = self.newest.as_ref().map(|d| {
            json!({"end_ns": d["window"]["end_ns"], "verdict": d["verdict"], "reason": d["reason"],
                "s": d["s"], "p_stiction": d["p_stiction"]})
        });
        json!({"windows": self.windows, "newest": newest, "alarm": alarm, "active": self.is_active()})
    }
}

/// A window's verdict, and the reason if there is none.
fn verdict(document: &Value) -> String {
    let verdict = document["verdict"].as_str().unwrap_or("?");
    match document["reason"].as_str().filter(|_| document["stiction"].is_null()) {
        Some(reason) => format!("{verdict} ({reason})"),
        None => verdict.to_owned(),
    }
}

impl Compared {
    /// Compares the windows that both sides now have, and drops those that one side will not get.
    fn pair(&mut self) {
        let [before, after] = [&mut self.before.unpaired, &mut self.after.unpaired];
        let last = |of: &BTreeMap<i64, String>| of.keys().next_back().copied().unwrap_or(i64::MIN);
        let until = last(before).min(last(after));
        let was: BTreeMap<i64, String> = std::mem::take(before);
        let (done, later): (BTreeMap<_, _>, BTreeMap<_, _>) = was.into_iter().partition(|(end_ns, _)| *end_ns <= until);
        *before = later;
        for (end_ns, was) in done {
            let Some(is) = after.get(&end_ns) else { continue };
            self.common += 1;
            if was != *is {
                *self.verdicts.entry((was, is.clone())).or_default() += 1;
            }
        }
        after.retain(|end_ns, _| *end_ns > until);
    }

    fn differ(&self) -> u64 {
        self.verdicts.values().sum()
    }

    fn is_changed(&self) -> bool {
        self.before.alarm != self.after.alarm || self.differ() > 0 || self.before.windows != self.after.windows
    }
}

/// The differences to report.
struct Told<'a> {
    config: &'a Path,
    other: &'a Config,
    changes: ConfigChanges,
    loops: &'a BTreeMap<String, Compared>,
    files: usize,
}

impl Told<'_> {
    fn is_watched(&self, name: &str) -> bool {
        self.other.input.discover || self.other.loop_named(name).is_some()
    }

    /// Why a loop has no alarm under the other configuration; `None` if it has one.
    fn why(&self, name: &str, of: &Compared) -> Option<String> {
        if !self.is_watched(name) {
            return Some("the configuration does not watch this loop".to_owned());
        }
        let params = self.other.loop_named(name).map_or(self.other.alarm, |one| one.alarm);
        let recent: Vec<Assessment> = of.after.recent.iter().cloned().collect();
        (!of.after.is_active()).then(|| why_not_active(&recent, &params))
    }

    fn tell(&self, format: Format) -> anyhow::Result<()> {
        let active = |after: bool| {
            let of = move |one: &Compared| if after { one.after.is_active() } else { one.before.is_active() };
            self.loops.iter().filter(move |(_, one)| of(one)).map(|(name, _)| name.as_str())
        };
        let [before, after]: [Vec<&str>; 2] = [active(false).collect(), active(true).collect()];
        let only = |a: &[&str], b: &[&str]| -> Vec<String> {
            a.iter().filter(|name| !b.contains(name)).map(|name| (*name).to_owned()).collect()
        };
        let (gone, new) = (only(&before, &after), only(&after, &before));
        let changed = self.loops.values().filter(|of| of.is_changed()).count();
        if format == Format::Json {
            for (name, of) in self.loops {
                let verdicts: Vec<Value> = of
                    .verdicts
                    .iter()
                    .map(|((was, is), windows)| json!({"before": was, "after": is, "windows": windows}))
                    .collect();
                say(json!({"schema": "stictiond.judged_loop.v1", "loop": name, "watched": self.is_watched(name),
                    "changed": of.is_changed(), "before": of.before.document(), "after": of.after.document(),
                    "common_windows": of.common, "verdicts": verdicts, "why_no_alarm": self.why(name, of)}))?;
            }
            say(json!({"schema": "stictiond.judged.v1", "config": self.config, "files": self.files,
                "loops": self.loops.len(), "changed": changed, "settings": self.changes,
                "active": {"before": before.len(), "after": after.len(), "gone": gone, "new": new}}))?;
            return Ok(());
        }
        say(format!("settings that differ: {}", self.settings()))?;
        for (name, of) in self.loops.iter().filter(|(_, of)| of.is_changed()) {
            self.tell_loop(name, of)?;
        }
        let names = |what: &str, names: &[String]| match names {
            [] => String::new(),
            some => format!("; {what}: {}", some.join(", ")),
        };
        say(format!(
            "{changed} of {} changed; alarms active at the end: {} as recorded, {} under {}{}{}",
            counted(self.loops.len(), "loop"),
            before.len(),
            after.len(),
            self.config.display(),
            names("gone", &gone),
            names("new", &new)
        ))?;
        Ok(())
    }

    /// The names of the settings and loops that differ.
    fn settings(&self) -> String {
        let ConfigChanges { added, changed, removed, settings, restart } = &self.changes;
        let loops = changed.iter().map(|one| format!("{} ({})", one.name, one.keys.join(", ")));
        let named = |what: &'static str, names: &[String]| {
            (!names.is_empty()).then(|| format!("{what} {}", names.join(", "))).into_iter()
        };
        let all: Vec<String> = settings
            .iter()
            .chain(restart)
            .cloned()
            .chain(loops)
            .chain(named("with", added))
            .chain(named("without", removed))
            .collect();
        if all.is_empty() { "none".to_owned() } else { all.join(", ") }
    }

    fn tell_loop(&self, name: &str, of: &Compared) -> anyhow::Result<()> {
        say(name)?;
        if of.before.alarm == of.after.alarm {
            say(format!("  alarm    as recorded: {}", of.after.told()))?;
        } else {
            say(format!("  alarm    recorded settings: {}", of.before.told()))?;
            say(format!("           these settings:    {}", of.after.told()))?;
        }
        if let Some(why) = self.why(name, of).filter(|_| of.before.is_active() || of.before.alarm != of.after.alarm) {
            say(format!("           not active: {why}"))?;
        }
        let windows = if of.before.windows == of.after.windows {
            format!("{}", of.before.windows)
        } else {
            format!("{} before, {} after", of.before.windows, of.after.windows)
        };
        say(format!(
            "  windows  {windows}; {} of {} that both have differ; newest: {} -> {}",
            of.differ(),
            of.common,
            of.before.newest(),
            of.after.newest()
        ))?;
        for ((was, is), windows) in &of.verdicts {
            say(format!("           {windows} x {was} -> {is}"))?;
        }
        Ok(())
    }
}
