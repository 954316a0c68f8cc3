//! A window on its way: from the moment it is due to its answer.
//!
//! A window that is due leaves as a [`Request`] with a [`Snapshot`] of the loop's history. Whoever computes it looks for the
//! oscillation, cuts the window's record and fits it: none of that happens where samples are taken. A snapshot shares the
//! history's memory until newer samples change it.

use std::sync::Arc;

use super::LoopId;
use super::gaps::{Accepted, Watched};
use super::settings::{LoopSettings, WindowParams};
use super::windowing::choose_record;
use stiction::core::record::Record;
use stiction::core::signal::history::History;
use stiction::core::units::{Moment, s_from_ns};
use stiction::core::verdict::{Assessment, Gate, Oscillation, Window, assess};

/// A loop's history at one moment.
#[derive(Debug, Clone)]
pub struct Snapshot {
    history: History,
    /// Points that had come by then.
    total: u64,
    end_ns: i64,
}

impl Snapshot {
    /// The history as it is, for a window that ends at a stamp.
    pub(super) fn now(history: &History, end_ns: i64) -> Self {
        Self { history: history.clone(), total: history.total(), end_ns }
    }

    /// The history up to a stamp, as far as it is still held.
    pub(super) fn up_to(history: &History, end_ns: i64) -> Self {
        Self { history: history.clone(), total: history.up_to(end_ns).total(), end_ns }
    }

    /// The record of the window: looks for the oscillation and takes as many periods of it as a window has. `None` where
    /// nothing is held.
    #[must_use]
    pub fn record(&self, params: &WindowParams) -> Option<Record> {
        choose_record(self.history.at(self.total), params, self.end_ns)
    }

    /// The record from a time on, in the smallest bins that fit a window. `None` where nothing is held.
    pub(super) fn since(&self, from_ns: i64) -> Option<Record> {
        self.history.at(self.total).record(from_ns, self.end_ns)
    }

    /// Bytes that it takes once it shares nothing with its loop any more.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.history.bytes()
    }
}

/// A due window that waits for its estimate.
#[derive(Debug, Clone)]
pub struct Request {
    /// Its loop.
    pub id: LoopId,
    /// Its place among the loop's windows; the key to hand the answer back with.
    pub seq: u64,
    /// The window's name: its end, ns.
    pub end_ns: i64,
    /// How it is computed.
    pub settings: Arc<LoopSettings>,
    /// The loop's history when it was due.
    pub(super) snapshot: Snapshot,
    /// Values that were bad since the last point.
    pub(super) bad: u16,
    /// The loop's sampling time when it was due, s; 0 where it was not known.
    pub(super) ts_s: f64,
    /// The loop's accepted model when it was due.
    pub(super) accepted: Option<Accepted>,
}

/// The answer to a [`Request`].
#[derive(Debug, Clone, PartialEq)]
pub struct WindowAnswer {
    /// What the estimate was made from.
    pub record: Arc<Record>,
    /// The estimate.
    pub assessment: Assessment,
    /// What the gap watch asks of the record.
    pub(super) watched: Watched,
}

impl Request {
    /// Cuts the window's record.
    #[must_use]
    pub fn record(&self) -> Record {
        let nothing = || Record {
            start_ns: self.end_ns,
            end_ns: self.end_ns,
            ..Record::uniform(self.ts_s, Vec::new(), Vec::new())
        };
        let mut record = self.snapshot.record(&self.settings.window).unwrap_or_else(nothing);
        record.facts.bad += u32::from(self.bad);
        record
    }

    /// Computes the answer. Depends on the request alone.
    #[must_use]
    pub fn compute(&self) -> WindowAnswer {
        let record = self.record();
        let assessment = assess(&record, &self.settings.assess);
        self.answer(record, assessment)
    }

    /// The answer with an estimate of its record.
    #[must_use]
    pub fn answer(&self, record: Record, assessment: Assessment) -> WindowAnswer {
        let watched = Watched::of(&assessment, &record, self.accepted.clone());
        WindowAnswer { record: Arc::new(record), assessment, watched }
    }

    /// Bytes that it takes once it shares nothing with its loop any more.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.snapshot.bytes()
    }
}

/// What an estimate was made from, and what the gap watch asks of it; none of a window that nobody computed.
pub(super) type Computed = (Arc<Record>, Watched);

/// A window that waits for its answer.
#[derive(Debug)]
pub(super) struct Waiting {
    pub seq: u64,
    /// The window's name, ns.
    pub end_ns: i64,
    /// The window in its document where nobody computes it.
    latest: Window,
    pub answer: Option<(Assessment, Option<Computed>)>,
}

impl Waiting {
    /// A window that is due now.
    pub fn new(seq: u64, end_ns: i64, history: &History, ts_s: f64) -> Self {
        Self { seq, end_ns, latest: latest(history, end_ns, ts_s), answer: None }
    }

    /// Gives the window up: its document says so.
    pub fn skip(&mut self) {
        let oscillation = Oscillation {
            oscillating: false,
            period_s: None,
            periods: None,
            samples_per_period: None,
            regularity: None,
        };
        let skipped = Assessment { gates: vec![Gate::Skipped], ..Assessment::empty(self.latest, oscillation) };
        self.answer = Some((skipped, None));
    }
}

/// The stretch of raw points that a window would look at first.
fn latest(history: &History, end_ns: i64, ts_s: f64) -> Window {
    let (start_ns, samples) = history.now().latest_raw().unwrap_or((end_ns, 0));
    let mean_s = history.newest_ns().filter(|_| samples > 1).map(|t| s_from_ns(t - start_ns) / (samples - 1) as f64);
    Window {
        start_ns,
        end_ns,
        start: Moment(start_ns),
        end: Moment(end_ns),
        samples,
        ts_s: mean_s.unwrap_or(ts_s),
        box_samples: 1,
    }
}
