//! A window on its way: from the moment it is due to its answer.
//!
//! What it is made from need not be cut at once: at the full hour the windows of all loops come due together, and to look
//! for each one's oscillation takes a millisecond or two. So the memory is held where it is, and the window cut when
//! somebody is there to compute it; it is the same to the last bit. A loop whose samples will not wait that long is cut
//! when the memory's patience ends.

use std::sync::Arc;

use super::settings::WindowParams;
use super::windowing::choose_record;
use stiction::record::Record;
use stiction::signal::history::History;
use stiction::units::{Moment, s_from_ns};
use stiction::verdict::{Assessment, Gate, Oscillation, Window};

/// A window that waits for its answer.
#[derive(Debug)]
pub(super) struct Waiting {
    pub seq: u64,
    /// The window's name, ns.
    pub end_ns: i64,
    /// Points of the stretch when it was due.
    total: u64,
    /// Values that were bad since the last of them.
    bad: u16,
    /// The loop's sampling time then, s; 0 where it was not known.
    ts_s: f64,
    /// What its document says of it where nobody computes it.
    latest: Window,
    record: Option<Arc<Record>>,
    pub answer: Option<Assessment>,
}

impl Waiting {
    /// A window that is due now.
    pub fn new(seq: u64, end_ns: i64, history: &History, bad: u16, ts_s: Option<f64>) -> Self {
        let ts_s = ts_s.unwrap_or(0.0);
        let latest = latest(history, end_ns, ts_s);
        Self { seq, end_ns, total: history.total(), bad, ts_s, latest, record: None, answer: None }
    }

    /// Whether the memory must be held for it.
    pub const fn is_uncut(&self) -> bool {
        self.record.is_none() && self.answer.is_none()
    }

    /// What the estimate is made from.
    pub fn cut(&mut self, history: &History, params: &WindowParams) -> Arc<Record> {
        if let Some(record) = &self.record {
            return record.clone();
        }
        let mut record = choose_record(history.at(self.total), params, self.end_ns).unwrap_or_else(|| Record {
            start_ns: self.end_ns,
            end_ns: self.end_ns,
            ..Record::uniform(self.ts_s, Vec::new(), Vec::new())
        });
        record.facts.bad += u32::from(self.bad);
        let record = Arc::new(record);
        self.record = Some(record.clone());
        record
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
        self.answer = Some(Assessment { gates: vec![Gate::Skipped], ..Assessment::empty(self.latest, oscillation) });
    }

    /// The answer, if it is there, and what it was made from, if that was cut.
    pub fn into_answer(self) -> Option<(Assessment, Option<Arc<Record>>)> {
        Some((self.answer?, self.record))
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
