//! What the table knows: every loop's row, the daemons, the link. Told by documents; asks nobody, draws nothing.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};

use serde_json::Value;

use stiction::gap::document::GapDocument;
use stiction::gap::text;
use stiction::record::Signal;
use stiction::units::{ns_from_s, s_from_ns};
use stiction_monitor::alarm::Place;
use stiction_monitor::codec::topic::{Kind, Leaf, Topic};
use stictiond::daemon::overview::{Flow, Newest, Overview, Row};
use stictiond::daemon::received;

/// Loops that are shown at most: what others put under the daemon's keys must not take all memory.
const MAX_LOOPS: usize = 100_000;
/// Samples of a loop's trend that are held.
const TREND: usize = 1_200;
/// A sample so much older than the one before is of a clock that was set back, s.
const SET_BACK_S: f64 = 60.0;
/// For so long after the daemon said how old a loop's data are, that holds: it says so every minute.
const AGE_HOLDS: Duration = Duration::from_secs(90);
/// A daemon that says nothing for so long is silent: it does so every 5 s.
const SILENT_DAEMON: Duration = Duration::from_secs(20);

/// The moment at which something is told or drawn.
#[derive(Debug, Clone, Copy)]
pub struct Now {
    /// For what passes.
    pub at: Instant,
    /// For stamps, ns since 1970.
    pub ns: i64,
}

impl Now {
    /// This moment.
    pub fn read() -> Self {
        Self { at: Instant::now(), ns: stictiond::daemon::clock::now_ns() }
    }
}

/// What came over the bus.
#[derive(Debug, Clone)]
pub enum News {
    /// A document and its key.
    Document(String, Vec<u8>),
    /// A sample of the loop whose trend is shown: stamp, ns since 1970, and value.
    Sample(String, Signal, i64, f64),
    /// A daemon came onto the bus.
    Came(String),
    /// A daemon left it.
    Left(String),
    /// Whether any router or daemon is connected.
    Connected(bool),
    /// What became of a command.
    Said(String),
}

/// A daemon's own word of itself.
#[derive(Debug, Clone)]
pub struct Heard {
    /// `stictiond.daemon_health.v1`.
    pub health: Value,
    /// When it came.
    pub at: Instant,
    /// Whether it left the bus.
    pub gone: bool,
}

/// OP and PV of one loop as they come.
#[derive(Debug, Clone, Default)]
pub struct Trend {
    /// The loop.
    pub name: String,
    /// Stamps, s, and values.
    pub op: VecDeque<(f64, f64)>,
    /// The same of PV.
    pub pv: VecDeque<(f64, f64)>,
}

/// How old a loop's newest sample was when that was told, s.
#[derive(Debug, Clone, Copy)]
struct Age {
    told_s: f64,
    newest_ns: i64,
    at: Instant,
}

/// A command's outcome, and when it was told.
pub type Told = Option<(String, Instant)>;

/// Everything that can be shown.
#[derive(Debug)]
pub struct Board {
    prefix: String,
    overview: Overview,
    rows: BTreeMap<String, Row>,
    ages: BTreeMap<String, Age>,
    gaps: BTreeMap<String, String>,
    /// Daemons by id.
    pub daemons: BTreeMap<String, Heard>,
    /// When the link was lost; none while it stands.
    pub lost: Option<Instant>,
    /// The trend of the loop that is looked at.
    pub trend: Option<Trend>,
    /// What was said last.
    pub said: Told,
    /// Documents that could not be read.
    pub unread: u64,
}

impl Board {
    /// Of the daemons below a prefix.
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

    /// First chunks of all keys.
    #[must_use]
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// Takes what came.
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

    /// Daemons that left and were replaced are no news.
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

    /// A document of a loop; none where it cannot be read.
    fn of_loop(&mut self, loop_name: &str, kind: Kind, document: &Value, now: Now) -> Option<()> {
        let name: Arc<str> = Arc::from(loop_name);
        let newest = self.overview.newest(loop_name).unwrap_or_default();
        let place = newest.alarm.as_ref().map(|d| Place {
            criticality: d.criticality,
            area: d.area.clone(),
            equipment: d.equipment.clone(),
            op_unit: Some(d.unit.clone()),
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

    /// Begins the trend of a loop, or ends it.
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

    /// Every loop, by name.
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

    /// What the last diagnosis of its gap says.
    #[must_use]
    pub fn gap(&self, name: &str) -> Option<&str> {
        self.gaps.get(name).map(String::as_str)
    }

    /// How old its newest sample is, s, as far as it was told; negative where the plant's clock is ahead.
    #[must_use]
    pub fn age_s(&self, name: &str, now: Now) -> Option<f64> {
        let age = self.ages.get(name)?;
        let since = now.at.saturating_duration_since(age.at);
        Some(age.told_s + if since > AGE_HOLDS { since.as_secs_f64() } else { 0.0 })
    }

    /// Why what is shown may be old, in words.
    #[must_use]
    pub fn stale(&self, now: Now) -> Option<String> {
        let for_s = |at: Instant| now.at.saturating_duration_since(at).as_secs();
        if let Some(lost) = self.lost {
            return Some(format!(
                "connection lost {} s ago; it is tried again, and what stands here is old",
                for_s(lost)
            ));
        }
        if self.daemons.is_empty() {
            return Some("no daemon has been heard yet".to_owned());
        }
        if let Some(gone) = self.daemons.values().map(|d| d.at).max().filter(|_| self.daemons.values().all(|d| d.gone))
        {
            return Some(format!("the daemon ended {} s ago; what stands here is old", for_s(gone)));
        }
        let newest = self.daemons.values().filter(|d| !d.gone).map(|d| d.at).max()?;
        let silent = now.at.saturating_duration_since(newest) > SILENT_DAEMON;
        silent.then(|| format!("the daemon has said nothing for {} s; what stands here is old", for_s(newest)))
    }
}
