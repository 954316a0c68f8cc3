//! Tracks how many loops can be judged and sends summaries of it. This runs on a separate thread: it visits all loops, and the
//! engine must not wait for that.
//!
//! A summary is due at whole multiples of its interval, so a restart sends none twice. One that came due while the daemon was
//! down follows once the loops have had time to fill a window.

use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError};

use super::to_json;
use crate::daemon::sink::deliver::{Item, Outbox};
use crate::daemon::sink::state_writer::Notes;
use crate::daemon::sink::zenoh::{Publication, Publisher};
use crate::runtime::clock::Clock;
use crate::runtime::data_health::{DataHealthDocument, Due};
use crate::runtime::overview::{KeptHealth, Obstacles, Overview};
use crate::runtime::view::CurrentConfig;
use stiction::core::units::{ns_from_ms, ns_from_s, s_from_ns};
use stiction_engine::codec::topic::{self, Kind};
use stiction_engine::config::{Config, Summary};

/// Trend points between two summaries, and the longest interval between points, s.
const POINTS: f64 = 24.0;
const POINT_EVERY_S: f64 = 3600.0;
/// Longest pause between two rounds, s.
const LOOK_EVERY_S: f64 = 60.0;

/// Inputs of the worker.
pub(super) struct DataHealthParts {
    /// The configuration in force.
    pub config: CurrentConfig,
    /// The loops.
    pub overview: Overview,
    /// Sends to the bus.
    pub publisher: Publisher,
    /// Sends to receivers outside the bus; `None` if none is configured.
    pub outbox: Option<Outbox>,
    /// Stores the trend; `None` in a demonstration.
    pub notes: Option<Notes>,
    /// The daemon's id.
    pub daemon_id: String,
    /// The time.
    pub clock: Clock,
}

/// The worker without its thread, so that a test can call [`Self::turn`] directly.
pub(super) struct DataHealthWorker {
    parts: DataHealthParts,
    started: Instant,
    /// Number of the last summary that was sent.
    sent: Option<i64>,
    kept: KeptHealth,
}

/// Starts the thread; it ends when `stop` is closed.
///
/// # Errors
/// The system refuses a thread.
pub(super) fn start(mut worker: DataHealthWorker, stop: Receiver<()>) -> std::io::Result<JoinHandle<()>> {
    std::thread::Builder::new().name("data-health".into()).spawn(move || {
        while stop.recv_timeout(worker.pause()) == Err(RecvTimeoutError::Timeout) {
            worker.turn();
        }
    })
}

/// Interval of the trend's points, s.
fn point_every_s(summary: &Summary) -> f64 {
    if summary.every_s > 0.0 { (summary.every_s / POINTS).min(POINT_EVERY_S) } else { POINT_EVERY_S }
}

/// Index of the interval that contains a time, counted from the offset.
fn number(at_ns: i64, offset_s: f64, every_s: f64) -> i64 {
    at_ns.saturating_sub(ns_from_s(offset_s)).div_euclid(ns_from_s(every_s).max(1))
}

impl DataHealthWorker {
    /// A worker that continues from what earlier runs kept.
    pub fn new(parts: DataHealthParts, kept: KeptHealth) -> Self {
        parts.overview.take_over(kept.clone());
        Self { started: parts.clock.now(), sent: kept.sent, kept, parts }
    }

    fn pause(&self) -> Duration {
        let every_s = point_every_s(&self.parts.config.get().summary);
        Duration::from_secs_f64((every_s / 2.0).min(LOOK_EVERY_S))
    }

    /// Visits all loops once: adds a point to the trend, sends a summary if one is due, and stores what a restart needs.
    pub fn turn(&mut self) {
        let config = self.parts.config.get();
        let (now, now_ns) = (self.parts.clock.now(), self.parts.clock.now_ns());
        let every_s = point_every_s(&config.summary);
        let survey = self.parts.overview.survey(now);
        // Before that, most loops have no full window.
        if self.parts.clock.since(self.started).as_secs_f64() >= every_s {
            let found = &survey.found;
            let newest_ms = found.trend.last().map(|point| point.t_ms);
            let is_next = |ms: f64| number(ns_from_ms(ms), 0.0, every_s) != number(now_ns, 0.0, every_s);
            self.send(&config, found, now_ns);
            if newest_ms.is_none_or(is_next) {
                self.parts.overview.add_share(found, now_ns);
            }
        }
        let kept = self.parts.overview.kept(&survey, self.sent);
        if kept != self.kept {
            if let (Some(notes), Some(json)) = (&self.parts.notes, to_json(&kept)) {
                notes.data_health(&config.site.prefix, json);
            }
            self.kept = kept;
        }
    }

    /// Sends the summary that is due, once.
    fn send(&mut self, config: &Config, found: &Obstacles, now_ns: i64) {
        let summary = &config.summary;
        if summary.every_s == 0.0 {
            return;
        }
        let due = number(now_ns, summary.at_s(), summary.every_s);
        // So a clock set back by up to one interval repeats no summary, and one that was far ahead for a while does not stop
        // later ones.
        if self.sent.is_some_and(|sent| (due..=due.saturating_add(1)).contains(&sent)) {
            return;
        }
        self.sent = Some(due);
        let due = Due {
            prefix: &config.site.prefix,
            daemon: &self.parts.daemon_id,
            part: config.shard.index(),
            due_ns: due.saturating_mul(ns_from_s(summary.every_s)).saturating_add(ns_from_s(summary.at_s())),
            every_ns: ns_from_s(summary.every_s),
        };
        let document = DataHealthDocument::new(due, found);
        let Some(json) = to_json(&document) else { return };
        tracing::info!(seconds_late = s_from_ns(now_ns - document.due_ns), "{}", document.line());
        if let Some(outbox) = self.parts.outbox.as_ref().filter(|outbox| outbox.wants(Kind::DataHealth)) {
            outbox.offer(Item::data_health(&config.site.prefix, &document, &json));
        }
        let key = topic::result(&config.site.prefix, &format!("@daemon/{}", self.parts.daemon_id), Kind::DataHealth);
        self.parts.publisher.publish(Publication { key, kind: Kind::DataHealth, document: Some(json) });
    }
}
