//! A window from the moment it is due to its answer.
//!
//! A due window leaves the engine as a [`Request`] with a [`Snapshot`] of the loop's history. The caller that computes it looks
//! for the oscillation, cuts the window's record and fits it, so none of that happens on the thread that takes samples. A
//! snapshot shares the history's memory until newer samples change it.

use std::sync::Arc;

use super::LoopId;
use super::gaps::{Accepted, Watched};
use super::settings::{LoopSettings, WindowParams};
use super::windowing::choose_record;
use stiction::core::record::Record;
use stiction::core::units::{Moment, s_from_ns};
use stiction::core::verdict::{Assessment, Gate, Oscillation, Window, assess};
use stiction::samples::history::History;

/// A loop's history at one moment.
#[derive(Debug, Clone)]
pub struct Snapshot {
    history: History,
    /// Number of points so far.
    total: u64,
    end_ns: i64,
}

impl Snapshot {
    /// The current history, for a window that ends at a stamp.
    pub(super) fn now(history: &History, end_ns: i64) -> Self {
        Self { history: history.clone(), total: history.total(), end_ns }
    }

    /// The history up to a stamp, as far as it is held.
    pub(super) fn up_to(history: &History, end_ns: i64) -> Self {
        Self { history: history.clone(), total: history.up_to(end_ns).total(), end_ns }
    }

    /// The record of the window: finds the oscillation and takes as many of its periods as belong to a window. `None` if
    /// nothing is held.
    #[must_use]
    pub fn record(&self, params: &WindowParams) -> Option<Record> {
        choose_record(self.history.at(self.total), params, self.end_ns)
    }

    /// The record from a given time on, in the smallest bins that fit a window. `None` if nothing is held.
    pub(super) fn since(&self, from_ns: i64) -> Option<Record> {
        self.history.at(self.total).record(from_ns, self.end_ns)
    }

    /// Bytes that it occupies when it shares nothing with its loop.
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
    /// Its number among the loop's windows, with which the answer is returned.
    pub seq: u64,
    /// End of the window, which identifies it, ns.
    pub end_ns: i64,
    /// Settings for the computation.
    pub settings: Arc<LoopSettings>,
    /// The loop's history when the window came due.
    pub(super) snapshot: Snapshot,
    /// Number of bad values since the last point.
    pub(super) bad: u16,
    /// The loop's sampling time when the window came due, s; 0 if unknown.
    pub(super) ts_s: f64,
    /// The loop's accepted model when the window came due.
    pub(super) accepted: Option<Accepted>,
}

/// The answer to a [`Request`].
#[derive(Debug, Clone, PartialEq)]
pub struct WindowAnswer {
    /// The record behind the estimate.
    pub record: Arc<Record>,
    /// The estimate.
    pub assessment: Assessment,
    /// Figures for the gap watch.
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

    /// Computes the answer, which depends on the request alone.
    #[must_use]
    pub fn compute(&self) -> WindowAnswer {
        let record = self.record();
        let assessment = assess(&record, &self.settings.assess);
        self.answer(record, assessment)
    }

    /// The answer, from an estimate of its record.
    #[must_use]
    pub fn answer(&self, record: Record, assessment: Assessment) -> WindowAnswer {
        let watched = Watched::of(&assessment, &record, self.accepted.clone());
        WindowAnswer { record: Arc::new(record), assessment, watched }
    }

    /// Bytes that it occupies when it shares nothing with its loop.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.snapshot.bytes()
    }
}

/// The record of an estimate and its figures for the gap watch; absent for a window that was not computed.
pub(super) type Computed = (Arc<Record>, Watched);

/// A window that waits for its answer.
#[derive(Debug)]
pub(super) struct Waiting {
    pub seq: u64,
    /// End of the window, which identifies it, ns.
    pub end_ns: i64,
    /// The window for the document if it is not computed.
    latest: Window,
    pub answer: Option<(Assessment, Option<Computed>)>,
}

impl Waiting {
    /// A window that has just come due.
    pub fn new(seq: u64, end_ns: i64, history: &History, ts_s: f64) -> Self {
        Self { seq, end_ns, latest: latest(history, end_ns, ts_s), answer: None }
    }

    /// Marks the window as skipped; its document says so.
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

/// The raw points that a window would examine first.
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
