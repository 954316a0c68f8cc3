//! The current state of every loop, written by the engine's thread and read by the page.
//!
//! It holds only the newest of each document and a few figures of earlier windows; everything older is in the recordings.

mod candidates;
mod expected;
mod groups;
mod obstacles;
mod share;
mod signals;

use std::collections::{BTreeMap, VecDeque};
use std::ops::Bound;
use std::sync::{Arc, PoisonError, RwLock};
use std::time::{Duration, Instant};

use serde::Serialize;

use stiction::core::ident::region::{Region, Size};
use stiction::core::units::{ms_from_ns, s_from_ns};
use stiction::core::verdict::answer::Standing;
use stiction::core::verdict::{EstimateDocument, Gate, Verdict};
use stiction_engine::alarm::{AlarmDocument, LoopContext, Priority, State};
use stiction_engine::engine::LoopFigures;
use stiction_engine::status::{Headline, InPlant, Known, LoopStatus, Sign};

pub use candidates::Candidate;
pub use groups::{Membership, ShownGroup, ShownGroups};
pub use obstacles::{Obstacle, ObstacleKind, Obstacles, Survey};
pub use share::{KeptHealth, SharePoint};

/// Windows of a loop whose figures are kept.
pub const RECENT: usize = 24;
/// Changes of alarms kept for readers that were briefly away.
const ALARMS_KEPT: usize = 256;
/// Names kept of loops that have left; a reader that was away for longer gets all rows.
const GONE_KEPT: usize = 4096;
/// A loop is silent if no newer sample came for this long or for this many sampling times, whichever is longer.
const SILENT_S: f64 = 60.0;
const SILENT_SAMPLES: f64 = 10.0;
/// The same while its sampling time is unknown.
const SILENT_UNKNOWN_S: f64 = 300.0;

/// One window of a loop's recent past.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Recent {
    /// Its end, ms since 1970.
    pub t_ms: f64,
    /// Probability that the valve sticks; null if the window has no answer.
    pub p: Option<f64>,
    /// Dead band plus stick band, OP units; null if nothing was fitted.
    pub s: Option<f64>,
    /// Its verdict.
    #[serde(skip)]
    pub verdict: Verdict,
}

impl Recent {
    fn of(document: &EstimateDocument) -> Self {
        let a = &document.assessment;
        Self { t_ms: ms_from_ns(a.window.end_ns), p: a.p_stiction, s: a.s, verdict: a.verdict }
    }
}

/// One loop in a list of all.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
#[allow(missing_docs)] // fields of the estimate and the alarm, defined in docs/read-a-result.md and docs/alarms.md
pub struct Row {
    pub name: String,
    pub area: Option<String>,
    pub equipment: Option<String>,
    pub criticality: Option<u8>,
    pub op_unit: Option<String>,
    /// NAMUR NE 107: `M` maintenance required (the alarm is active), `F` failure of a signal, `S` out of specification (the
    /// loop oscillates, or its valve sticks without an alarm), `C` function check (out of service, or in manual), `none` (nothing
    /// was found); null while there is no answer.
    pub ne107: Option<Sign>,
    /// The reason in one line.
    pub status: String,
    /// The displayed verdict: that of its newest window, or the cause named by most of its last windows.
    pub verdict: Option<Verdict>,
    /// The newest window's conclusion on stiction: `sticks`, `suspected`, `open`, `not_seen` or `no_answer`.
    pub standing: Standing,
    /// Whether that conclusion is from an earlier run, or older than data that should have come.
    pub stale: bool,
    /// Whether a signal has failed or newer samples are missing, whatever `ne107` says.
    pub failed: bool,
    /// Urgency; larger values come first.
    pub urgency: f64,
    pub stiction: Option<bool>,
    pub p_stiction: Option<f64>,
    /// The probability in words, such as `not seen (p 0.12)`.
    pub probability: Option<String>,
    pub confidence: Option<f64>,
    pub grade: Option<char>,
    pub s: Option<f64>,
    pub s_interval: Option<[f64; 2]>,
    /// s with its interval and unit, where stiction was found.
    pub size: Option<String>,
    pub region: Option<Region>,
    pub strength_by_span: Option<Size>,
    pub severity_by_range: Option<Size>,
    pub period_s: Option<f64>,
    pub gates: Vec<Gate>,
    pub alarm_state: State,
    pub active: bool,
    /// Whether the alarm waits for acknowledgement.
    pub unacknowledged: bool,
    pub priority: Option<Priority>,
    pub class: Option<Size>,
    /// The cause named by the last gap diagnosis.
    pub cause: Option<String>,
    /// The driver of the oscillation if the loop follows its group, such as `driven by FIC101, p 0.94`.
    pub driven: Option<String>,
    /// End of the newest window, ms since 1970.
    pub window_end_ms: Option<f64>,
    /// Seconds between the newest sample's stamp and the daemon's clock, as of the last change of this row.
    pub data_age_s: Option<f64>,
    /// Whether no newer sample has come for longer than its sampling time explains.
    pub silent: bool,
    pub data_gaps: u64,
    /// Samples that were dropped: duplicate, late or stamped far off.
    pub dropped: u64,
    /// The newest windows, oldest first.
    pub recent: Vec<Recent>,
    /// Trend of s over them: `rising`, `falling`, `steady`; null if too few windows found any.
    pub s_trend: Option<&'static str>,
}

/// Health of all data in one line.
#[derive(Debug, Clone, Default, PartialEq, Serialize, schemars::JsonSchema)]
pub struct DataHealth {
    /// Number of loops without newer samples.
    pub silent_loops: usize,
    /// The loop whose newest sample is oldest, and its age, s.
    pub oldest_loop: Option<String>,
    /// Age of that sample, s.
    pub oldest_age_s: Option<f64>,
    /// Gaps in the data of all loops.
    pub data_gaps: u64,
    /// Dropped samples of all loops.
    pub dropped: u64,
}

/// State of a loop's data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Flow {
    /// Stamp of its newest sample, ns since 1970.
    pub newest_ns: Option<i64>,
    /// Gaps that ended a stretch of data.
    pub data_gaps: u64,
    /// Samples that were dropped: duplicate, late or stamped far off.
    pub dropped: u64,
}

/// The data held for one loop.
#[derive(Debug, Clone)]
struct Entry {
    place: LoopContext,
    estimate: Option<Arc<EstimateDocument>>,
    alarm: Option<Arc<AlarmDocument>>,
    /// Whether the estimate is from an earlier run.
    restored: bool,
    /// Summary of all of it, computed again after every change.
    status: LoopStatus,
    cause: Option<String>,
    /// The driver found by the newest comparison of loops.
    driven: Option<String>,
    recent: VecDeque<Recent>,
    /// The obstacle of the newest windows, and since when.
    limited: Option<obstacles::Since>,
    signals: signals::SignalFaults,
    newest_ns: Option<i64>,
    /// When its newest stamp last advanced.
    advanced: Instant,
    silent: bool,
    data_gaps: u64,
    dropped: u64,
    changed: u64,
}

/// The newest documents of a loop.
#[derive(Debug, Clone, Default)]
pub struct Newest {
    /// Estimate of its newest window.
    pub estimate: Option<Arc<EstimateDocument>>,
    /// Its alarm, if that ever changed or was restored.
    pub alarm: Option<Arc<AlarmDocument>>,
    /// Its newest stamp, ns since 1970; a few seconds old.
    pub newest_ns: Option<i64>,
}

/// Changes since a reader's last look.
#[derive(Debug)]
pub struct Changes {
    /// The version to continue from.
    pub version: u64,
    /// Whether the reader was away for too long and needs all rows.
    pub full: bool,
    /// Loops that have left.
    pub gone: Vec<String>,
    /// Alarms, oldest first.
    pub alarms: Vec<Arc<AlarmDocument>>,
    /// Whether loops were compared.
    pub compared: bool,
}

#[derive(Debug, Default)]
struct Loops {
    by_name: BTreeMap<Arc<str>, Entry>,
    version: u64,
    alarms: VecDeque<(u64, Arc<AlarmDocument>)>,
    /// Loops that have left, each with the version of that change.
    gone: VecDeque<(u64, Arc<str>)>,
    /// The last version whose leavers are no longer all kept.
    gone_after: u64,
    groups: groups::Groups,
    /// The configured loops; `None` before they are known.
    expected: Option<expected::Expected>,
    /// Fraction of loops that can be judged, over time, oldest first.
    shares: VecDeque<SharePoint>,
    /// Obstacles from an earlier run, for loops without a window since.
    earlier: BTreeMap<String, obstacles::Since>,
}

impl Loops {
    /// Changes an entry; returns the resulting version.
    fn change(&mut self, name: &Arc<str>, place: &LoopContext, now: Instant, change: impl FnOnce(&mut Entry)) -> u64 {
        self.version += 1;
        let entry = self.by_name.entry(name.clone()).or_insert_with(|| Entry::new(place, now));
        change(entry);
        entry.status = entry.status();
        entry.changed = self.version;
        self.version
    }
}

/// The current state of every loop; clones share it.
#[derive(Debug, Clone, Default)]
pub struct Overview(Arc<RwLock<Loops>>);

impl Overview {
    fn change(&self, name: &Arc<str>, place: &LoopContext, now: Instant, change: impl FnOnce(&mut Entry)) {
        self.0.write().unwrap_or_else(PoisonError::into_inner).change(name, place, now, change);
    }

    /// Adds the estimate of a window.
    pub fn estimate(&self, name: &Arc<str>, place: &LoopContext, now: Instant, document: Arc<EstimateDocument>) {
        let mut loops = self.0.write().unwrap_or_else(PoisonError::into_inner);
        let earlier = loops.earlier.remove(&**name);
        let action = loops.expected.as_ref().and_then(|expected| expected.action(name));
        loops.change(name, place, now, |entry| {
            let a = &document.assessment;
            if entry.recent.len() == RECENT {
                entry.recent.pop_front();
            }
            entry.recent.push_back(Recent::of(&document));
            entry.limited = obstacles::Since::after(entry.limited.or(earlier), a);
            entry.signals.window(action, a);
            entry.estimate = Some(document);
            entry.restored = false;
        });
    }

    /// Restores what an earlier run last heard of a loop: time and stamp of its newest sample, and its newest answer, which is
    /// marked as old until this run has a window.
    pub fn restore(
        &self,
        name: &Arc<str>,
        place: &LoopContext,
        (heard, newest_ns): (Instant, Option<i64>),
        document: Option<Arc<EstimateDocument>>,
    ) {
        self.change(name, place, heard, |entry| {
            (entry.advanced, entry.newest_ns) = (heard, newest_ns);
            if let Some(document) = document {
                entry.recent.push_back(Recent::of(&document));
                entry.estimate = Some(document);
                entry.restored = true;
            }
        });
    }

    /// Sets an alarm that changed or was restored.
    pub fn alarm(&self, name: &Arc<str>, place: &LoopContext, now: Instant, document: &AlarmDocument) {
        let document = Arc::new(document.clone());
        let mut loops = self.0.write().unwrap_or_else(PoisonError::into_inner);
        let version = loops.change(name, place, now, |entry| entry.alarm = Some(document.clone()));
        if loops.alarms.len() == ALARMS_KEPT {
            loops.alarms.pop_front();
        }
        loops.alarms.push_back((version, document));
    }

    /// Sets the cause that a gap diagnosis named.
    pub fn cause(&self, name: &Arc<str>, place: &LoopContext, now: Instant, cause: &str) {
        self.change(name, place, now, |entry| entry.cause = Some(cause.to_owned()));
    }

    /// Removes a loop that has left the plant.
    pub fn forget(&self, name: &str) {
        let mut loops = self.0.write().unwrap_or_else(PoisonError::into_inner);
        let Some((name, entry)) = loops.by_name.remove_entry(name) else { return };
        if let Some(expected) = &mut loops.expected {
            expected.forget(&name, entry.newest_ns);
        }
        loops.earlier.remove(&*name);
        loops.version += 1;
        let gone = (loops.version, name);
        loops.gone.push_back(gone);
        if loops.gone.len() > GONE_KEPT {
            loops.gone_after = loops.gone.pop_front().map_or(0, |(version, _)| version);
        }
    }

    /// Updates the state of a loop's data from the engine's figures.
    pub fn figures(&self, name: &Arc<str>, place: &LoopContext, now: Instant, figures: &LoopFigures) {
        let c = &figures.counts;
        let dropped = c.duplicates + c.late + c.stamp_outliers;
        self.flow(name, place, now, Flow { newest_ns: figures.greatest_ns, data_gaps: c.gaps, dropped });
    }

    /// Updates the state of a loop's data. Counts as a change only if the loop is new, has fallen silent or is heard again.
    pub fn flow(&self, name: &Arc<str>, place: &LoopContext, now: Instant, flow: Flow) {
        let mut loops = self.0.write().unwrap_or_else(PoisonError::into_inner);
        let next = loops.version + 1;
        let mut changed = !loops.by_name.contains_key(name);
        let entry = loops.by_name.entry(name.clone()).or_insert_with(|| Entry::new(place, now));
        let is_newer = flow.newest_ns > entry.newest_ns;
        if is_newer {
            (entry.newest_ns, entry.advanced) = (flow.newest_ns, now);
        }
        // A silent loop remains silent until a newer sample comes, also over a restart.
        let silent = !is_newer && (entry.silent || now.saturating_duration_since(entry.advanced) > entry.patience());
        changed |= silent != entry.silent;
        entry.silent = silent;
        (entry.data_gaps, entry.dropped) = (flow.data_gaps, flow.dropped);
        if changed {
            entry.status = entry.status();
            entry.changed = next;
            loops.version = next;
        }
    }

    /// Rows that changed after a version, sorted by name: at most `most` of those after `name`. After version 0 that is all
    /// rows.
    #[must_use]
    pub fn rows_after(&self, version: u64, name: Option<&str>, most: usize, now_ns: i64) -> Vec<Row> {
        let loops = self.0.read().unwrap_or_else(PoisonError::into_inner);
        let range = (name.map_or(Bound::Unbounded, Bound::Excluded), Bound::Unbounded);
        let rows = loops.by_name.range::<str, _>(range).filter(|(_, e)| e.changed > version || version == 0);
        rows.take(most).map(|(name, entry)| entry.row(name, now_ns)).collect()
    }

    /// Everything else that changed after a version.
    #[must_use]
    pub fn changes_after(&self, version: u64) -> Changes {
        let loops = self.0.read().unwrap_or_else(PoisonError::into_inner);
        let gone = loops.gone.iter().filter(|(v, name)| *v > version && !loops.by_name.contains_key(name));
        let alarms = loops.alarms.iter().filter(|(v, _)| *v > version);
        Changes {
            version: loops.version,
            full: version < loops.gone_after,
            gone: gone.map(|(_, name)| name.to_string()).collect(),
            alarms: alarms.map(|(_, document)| document.clone()).collect(),
            compared: loops.groups.changed > version,
        }
    }

    /// The kept changes of a loop's alarm, oldest first; the newest may not be in the recordings yet.
    #[must_use]
    pub fn alarm_changes(&self, name: &str) -> Vec<Arc<AlarmDocument>> {
        let loops = self.0.read().unwrap_or_else(PoisonError::into_inner);
        loops.alarms.iter().filter(|(_, d)| d.loop_name == name).map(|(_, document)| document.clone()).collect()
    }

    /// One loop's row.
    #[must_use]
    pub fn row(&self, name: &str, now_ns: i64) -> Option<Row> {
        let loops = self.0.read().unwrap_or_else(PoisonError::into_inner);
        loops.by_name.get(name).map(|entry| entry.row(name, now_ns))
    }

    /// The plant in a few sentences. `prefix` is where data are expected.
    #[must_use]
    pub fn headline(&self, prefix: &str) -> Headline {
        let loops = self.0.read().unwrap_or_else(PoisonError::into_inner);
        let expected = loops.expected.iter().flat_map(|expected| expected.loops());
        let missing = expected.filter(|(name, _)| !loops.by_name.contains_key(*name)).count();
        Headline::of(loops.by_name.iter().map(|(name, entry)| entry.in_plant(name)), missing, prefix)
    }

    /// One loop's newest documents.
    #[must_use]
    pub fn newest(&self, name: &str) -> Option<Newest> {
        let loops = self.0.read().unwrap_or_else(PoisonError::into_inner);
        loops.by_name.get(name).map(|e| Newest {
            estimate: e.estimate.clone(),
            alarm: e.alarm.clone(),
            newest_ns: e.newest_ns,
        })
    }

    /// Every alarm with a document.
    #[must_use]
    pub fn alarms(&self) -> Vec<Arc<AlarmDocument>> {
        let loops = self.0.read().unwrap_or_else(PoisonError::into_inner);
        loops.by_name.values().filter_map(|entry| entry.alarm.clone()).collect()
    }

    /// Summary of all data.
    #[must_use]
    pub fn data_health(&self, now_ns: i64) -> DataHealth {
        let loops = self.0.read().unwrap_or_else(PoisonError::into_inner);
        let mut health = DataHealth::default();
        let mut oldest_ns = i64::MAX;
        for (name, entry) in &loops.by_name {
            health.silent_loops += usize::from(entry.silent);
            health.data_gaps += entry.data_gaps;
            health.dropped += entry.dropped;
            if let Some(newest_ns) = entry.newest_ns.filter(|ns| *ns < oldest_ns) {
                oldest_ns = newest_ns;
                health.oldest_loop = Some(name.to_string());
                health.oldest_age_s = Some(s_from_ns(now_ns.saturating_sub(newest_ns)));
            }
        }
        health
    }
}

impl Entry {
    fn new(place: &LoopContext, now: Instant) -> Self {
        Self {
            place: place.clone(),
            estimate: None,
            alarm: None,
            restored: false,
            status: LoopStatus::of(&Known::default()),
            cause: None,
            driven: None,
            recent: VecDeque::new(),
            limited: None,
            signals: signals::SignalFaults::default(),
            newest_ns: None,
            advanced: now,
            silent: false,
            data_gaps: 0,
            dropped: 0,
            changed: 0,
        }
    }

    /// How long a newer sample may be missing.
    fn patience(&self) -> Duration {
        let ts_s = self.estimate.as_ref().map(|e| e.assessment.window.ts_s).filter(|ts| ts.is_finite() && *ts > 0.0);
        let s = ts_s.map_or(SILENT_UNKNOWN_S, |ts| (SILENT_SAMPLES * ts).max(SILENT_S));
        Duration::try_from_secs_f64(s).unwrap_or(Duration::MAX)
    }

    fn row(&self, name: &str, now_ns: i64) -> Row {
        let a = self.estimate.as_deref().map(|e| &e.assessment);
        let alarm = self.alarm.as_deref();
        let status = &self.status;
        let answer = status.answer.as_ref();
        Row {
            name: name.to_owned(),
            area: self.place.area.clone(),
            equipment: self.place.equipment.clone(),
            criticality: self.place.criticality,
            op_unit: self.place.op_unit.clone(),
            ne107: status.sign,
            status: status.sentence.clone(),
            verdict: status.verdict,
            standing: status.standing(),
            stale: status.stale,
            failed: status.failed,
            urgency: self.in_plant(name).urgency(),
            stiction: a.and_then(|a| a.stiction),
            p_stiction: a.and_then(|a| a.p_stiction),
            probability: answer.map(|answer| answer.probability.clone()),
            confidence: a.and_then(|a| a.confidence),
            grade: answer.and_then(|answer| answer.grade),
            s: a.and_then(|a| a.s),
            s_interval: a.and_then(|a| a.s_interval),
            size: answer.and_then(|answer| answer.size.clone()),
            region: a.and_then(|a| a.region),
            strength_by_span: a.and_then(|a| a.strength_by_span),
            severity_by_range: a.and_then(|a| a.severity_by_range),
            period_s: a.and_then(|a| a.oscillation.period_s),
            gates: a.map(|a| a.gates.clone()).unwrap_or_default(),
            alarm_state: alarm.map_or(State::Normal, |d| d.state),
            active: status.active,
            unacknowledged: status.unacknowledged,
            priority: alarm.and_then(|d| d.priority),
            class: alarm.and_then(|d| d.class),
            cause: self.cause.clone(),
            driven: self.driven.clone(),
            window_end_ms: a.map(|a| ms_from_ns(a.window.end_ns)),
            data_age_s: self.newest_ns.map(|ns| s_from_ns(now_ns.saturating_sub(ns))),
            silent: self.silent,
            data_gaps: self.data_gaps,
            dropped: self.dropped,
            recent: self.recent.iter().copied().collect(),
            s_trend: trend(&self.recent),
        }
    }

    fn in_plant<'a>(&'a self, name: &'a str) -> InPlant<'a> {
        let alarm = self.alarm.as_deref();
        InPlant {
            name,
            status: &self.status,
            priority: alarm.and_then(|d| d.priority),
            class: alarm.and_then(|d| d.class),
            p: self.estimate.as_deref().and_then(|e| e.assessment.p_stiction),
        }
    }

    fn status(&self) -> LoopStatus {
        LoopStatus::of(&Known {
            estimate: self.estimate.as_deref().map(|e| &e.assessment),
            verdicts: self.recent.iter().rev().map(|window| window.verdict).collect(),
            alarm: self.alarm.as_deref(),
            silent: self.silent,
            restored: self.restored,
        })
    }
}

/// Trend of s over windows: compares the means of the later and the earlier half, with a limit of two standard errors.
fn trend(recent: &VecDeque<Recent>) -> Option<&'static str> {
    /// Fewest windows with a fit in each half.
    const LEAST: usize = 3;
    let found: Vec<f64> = recent.iter().filter_map(|w| w.s).collect();
    let (before, after) = found.split_at(found.len() / 2);
    if before.len() < LEAST {
        return None;
    }
    let [(from, from_sd), (to, to_sd)] = [before, after]
        .map(|half| (stiction::core::signal::stats::mean(half), stiction::core::signal::stats::std_dev(half)));
    let error = (from_sd.powi(2) / before.len() as f64 + to_sd.powi(2) / after.len() as f64).sqrt();
    // A change of less than 5 % is too small to plan by.
    let limit = (2.0 * error).max(0.05 * from.abs());
    Some(match to - from {
        rise if rise > limit => "rising",
        rise if rise < -limit => "falling",
        _ => "steady",
    })
}

#[cfg(test)]
mod tests;
