//! The state behind the table: rows of loops, daemons, the link. Fed with documents; requests nothing, draws nothing.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};

use serde_json::Value;

use stiction_core::gap::document::GapDocument;
use stiction_core::gap::text;
use stiction_core::record::Signal;
use stiction_core::units::{ns_from_s, s_from_ns};
use stiction_daemon::received;
use stiction_monitor::alarm::LoopContext;
use stiction_monitor::codec::topic::{Kind, Leaf, Topic};
use stiction_runtime::overview::{Flow, Newest, Overview, Row};

/// Most loops shown, so that foreign keys below the prefix cannot fill the memory.
const MAX_LOOPS: usize = 100_000;
/// Samples kept of a loop's trend.
const TREND: usize = 1_200;
/// A sample older than its predecessor by more than this indicates a clock that was set back, s.
const SET_BACK_S: f64 = 60.0;
/// How long the data age stated by the daemon remains valid; it states it every minute.
const AGE_HOLDS: Duration = Duration::from_secs(90);
/// A daemon silent for this long is shown as silent; it reports every 5 s.
const SILENT_DAEMON: Duration = Duration::from_secs(20);

/// A point in time, on both clocks.
#[derive(Debug, Clone, Copy)]
pub struct Now {
    /// Monotonic, for durations.
    pub at: Instant,
    /// For timestamps, ns since 1970.
    pub ns: i64,
}

impl Now {
    /// Now.
    pub fn read() -> Self {
        Self { at: Instant::now(), ns: stiction_runtime::clock::now_ns() }
    }
}

/// Input from the bus.
#[derive(Debug, Clone)]
pub enum News {
    /// A document and its key.
    Document(String, Vec<u8>),
    /// A sample of the loop whose trend is shown: timestamp in ns since 1970, and value.
    Sample(String, Signal, i64, f64),
    /// A daemon appeared on the bus.
    Came(String),
    /// A daemon disappeared from the bus.
    Left(String),
    /// Whether any router or daemon is connected.
    Connected(bool),
    /// Outcome of a command.
    Said(String),
}

/// A daemon's report on itself.
#[derive(Debug, Clone)]
pub struct Heard {
    /// `stictiond.daemon_health.v1`.
    pub health: Value,
    /// When it was received.
    pub at: Instant,
    /// Whether the daemon has left the bus.
    pub gone: bool,
}

/// Live OP and PV of one loop.
#[derive(Debug, Clone, Default)]
pub struct Trend {
    /// The loop.
    pub name: String,
    /// Timestamps in s, and values of OP.
    pub op: VecDeque<(f64, f64)>,
    /// The same of PV.
    pub pv: VecDeque<(f64, f64)>,
}

/// Age of a loop's newest sample when it was reported, s.
#[derive(Debug, Clone, Copy)]
struct Age {
    told_s: f64,
    newest_ns: i64,
    at: Instant,
}

/// Outcome of a command and when it was received.
pub type CommandOutcome = Option<(String, Instant)>;

/// Everything that can be shown.
#[derive(Debug)]
pub struct LoopTable {
    prefix: String,
    overview: Overview,
    rows: BTreeMap<String, Row>,
    ages: BTreeMap<String, Age>,
    gaps: BTreeMap<String, String>,
    /// Daemons by id.
    pub daemons: BTreeMap<String, Heard>,
    /// When the link was lost; none while connected.
    pub lost: Option<Instant>,
    /// Trend of the open loop.
    pub trend: Option<Trend>,
    /// The last message.
    pub said: CommandOutcome,
    /// Number of documents that could not be parsed.
    pub unread: u64,
}

impl LoopTable {
    /// For the daemons below a prefix.
    #[must_use]
    pub fn new(prefix: &str) -> Self {
        Self {
            prefix: prefix.to_owned(),
            overview: Overview::default(),
            rows: BTreeMap::new(),
            ages: BTreeMap::new(),
            gaps: BTreeMap::new(),
            daemons: BTreeMap::new(),
            lost: None,
            trend: None,
            said: None,
            unread: 0,
        }
    }

    /// Key prefix of the daemons.
    #[must_use]
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// Takes an input.
    pub fn take(&mut self, news: News, now: Now) {
        match news {
            News::Document(key, json) => self.document(&key, &json, now),
            News::Sample(name, signal, t_ns, value) => self.sample(&name, signal, t_ns, value),
            News::Came(id) => {
                // Who hears of a daemon has a link.
                self.lost = None;
                self.presence(id, false, now);
            }
            News::Left(id) => self.presence(id, true, now),
            News::Connected(true) => self.lost = None,
            News::Connected(false) => {
                self.lost = self.lost.or(Some(now.at));
                // Those that are still there come again with the link.
                self.daemons.values_mut().for_each(|d| d.gone = true);
            }
            News::Said(text) => self.said = Some((text, now.at)),
        }
    }

    fn presence(&mut self, id: String, gone: bool, now: Now) {
        let new = Heard { health: Value::Null, at: now.at, gone };
        let heard = self.daemons.entry(id).or_insert(new);
        (heard.gone, heard.at) = (gone, now.at);
        self.forget_the_replaced();
    }

    /// Forgets daemons that left and were replaced.
    fn forget_the_replaced(&mut self) {
        if self.daemons.values().any(|d| !d.gone) {
            self.daemons.retain(|_, d| !d.gone);
        }
    }

    fn document(&mut self, key: &str, json: &[u8], now: Now) {
        let prefix = self.prefix.clone();
        let Some(Topic { loop_name, leaf: Leaf::Document(kind), .. }) = Topic::parse(Some(&prefix), key) else {
            return;
        };
        let Ok(document) = serde_json::from_slice::<Value>(json) else {
            self.unread += 1;
            return;
        };
        if let Some(id) = loop_name.strip_prefix("@daemon/") {
            self.daemons.insert(id.to_owned(), Heard { health: document, at: now.at, gone: false });
            self.forget_the_replaced();
        } else if self.rows.contains_key(loop_name) || self.rows.len() < MAX_LOOPS {
            if self.of_loop(loop_name, kind, &document, now).is_none() {
                self.unread += 1;
            }
            self.rows.extend(self.overview.row(loop_name, now.ns).map(|row| (loop_name.to_owned(), row)));
        }
    }

    /// A loop's document; none if it cannot be parsed.
    fn of_loop(&mut self, loop_name: &str, kind: Kind, document: &Value, now: Now) -> Option<()> {
        let name: Arc<str> = Arc::from(loop_name);
        let newest = self.overview.newest(loop_name).unwrap_or_default();
        let place = newest.alarm.as_ref().map(|d| LoopContext {
            criticality: d.criticality,
            area: d.area.clone(),
            equipment: d.equipment.clone(),
            op_unit: Some(d.unit.clone()),
            upstream: Vec::new(),
        });
        let place = place.unwrap_or_default();
        match kind {
            Kind::Estimate => {
                let read = received::estimate(document)?;
                let end_ns = read.assessment.window.end_ns;
                // The last answer is asked for again after every loss of the link.
                if newest.estimate.is_none_or(|known| known.assessment.window.end_ns != end_ns) {
                    self.aged(loop_name, end_ns, now);
                    self.overview.estimate(&name, &place, now.at, Arc::new(read));
                }
            }
            Kind::Alarm => {
                let read = received::alarm(document)?;
                if newest.alarm.is_none_or(|known| *known != read) {
                    self.overview.alarm(&name, &place, now.at, &read);
                }
            }
            Kind::Gap => {
                let read: GapDocument = serde_json::from_value(document.clone()).ok()?;
                self.overview.cause(&name, &place, now.at, &read.cause.id);
                self.gaps.insert(loop_name.to_owned(), text::paragraph(&read));
            }
            Kind::Health => {
                let count = |field: &str| document[field].as_u64().unwrap_or(0);
                let newest_ns = document["data_age_s"].as_f64().map(|age_s| now.ns.saturating_sub(ns_from_s(age_s)));
                if let Some(newest_ns) = newest_ns {
                    self.aged(loop_name, newest_ns, now);
                }
                let flow = Flow { newest_ns, data_gaps: count("data_gaps"), dropped: count("dropped") };
                self.overview.flow(&name, &place, now.at, flow);
            }
            _ => {}
        }
        Some(())
    }

    fn aged(&mut self, loop_name: &str, newest_ns: i64, now: Now) {
        if self.ages.get(loop_name).is_none_or(|known| newest_ns > known.newest_ns) {
            let told_s = s_from_ns(now.ns.saturating_sub(newest_ns));
            self.ages.insert(loop_name.to_owned(), Age { told_s, newest_ns, at: now.at });
        }
    }

    /// Starts or ends the trend of a loop.
    pub fn watch(&mut self, name: Option<&str>) {
        self.trend = name.map(|name| Trend { name: name.to_owned(), ..Trend::default() });
    }

    fn sample(&mut self, name: &str, signal: Signal, t_ns: i64, value: f64) {
        let Some(trend) = self.trend.as_mut().filter(|t| t.name == name) else { return };
        let line = match signal {
            Signal::Op => &mut trend.op,
            Signal::Pv => &mut trend.pv,
            _ => return,
        };
        let t_s = s_from_ns(t_ns);
        // Late samples would draw backwards; behind a clock that was set back it begins anew.
        match line.back() {
            Some((last, _)) if *last > t_s + SET_BACK_S => line.clear(),
            Some((last, _)) if *last >= t_s => return,
            _ => {}
        }
        if line.len() == TREND {
            line.pop_front();
        }
        line.push_back((t_s, value));
    }

    /// All loops by name.
    pub fn rows(&self) -> impl Iterator<Item = &Row> {
        self.rows.values()
    }

    /// One loop.
    #[must_use]
    pub fn row(&self, name: &str) -> Option<&Row> {
        self.rows.get(name)
    }

    /// Its newest documents.
    #[must_use]
    pub fn newest(&self, name: &str) -> Newest {
        self.overview.newest(name).unwrap_or_default()
    }

    /// Summary of the last diagnosis of its gap.
    #[must_use]
    pub fn gap(&self, name: &str) -> Option<&str> {
        self.gaps.get(name).map(String::as_str)
    }

    /// Age of its newest sample as far as known, s; negative if the plant's clock is ahead.
    #[must_use]
    pub fn age_s(&self, name: &str, now: Now) -> Option<f64> {
        let age = self.ages.get(name)?;
        let since = now.at.saturating_duration_since(age.at);
        Some(age.told_s + if since > AGE_HOLDS { since.as_secs_f64() } else { 0.0 })
    }

    /// Why the display may be out of date, in words.
    #[must_use]
    pub fn stale(&self, now: Now) -> Option<String> {
        let for_s = |at: Instant| now.at.saturating_duration_since(at).as_secs();
        if let Some(lost) = self.lost {
            return Some(format!("connection lost {} s ago; reconnecting; the table is out of date", for_s(lost)));
        }
        if self.daemons.is_empty() {
            return Some("no daemon has reported yet".to_owned());
        }
        if let Some(gone) = self.daemons.values().map(|d| d.at).max().filter(|_| self.daemons.values().all(|d| d.gone))
        {
            return Some(format!("the daemon stopped {} s ago; the table is out of date", for_s(gone)));
        }
        let newest = self.daemons.values().filter(|d| !d.gone).map(|d| d.at).max()?;
        let silent = now.at.saturating_duration_since(newest) > SILENT_DAEMON;
        silent.then(|| format!("no report from the daemon for {} s; the table may be out of date", for_s(newest)))
    }
}
