//! Visits all loops some at a time, so that even a hundred thousand of them never hold up a sample: collects figures and
//! health, and forgets loops that have left the plant. Registers loops that are new or come back.

use std::collections::{BTreeSet, HashSet};
use std::time::Duration;

use super::EngineThread;
use crate::daemon::sink::recorder::{Item, LOOPS_PER_FILE, segment_of};
use crate::daemon::sink::zenoh::Publication;
use crate::runtime::health::LoopHealth;
use stiction::core::units::s_from_ns;
use stiction::samples::align::AlignCounts;
use stiction_engine::alarm::{Alarm, State};
use stiction_engine::codec::topic::{self, Kind};
use stiction_engine::engine::{Checkpoint, GapWatch, LoopId, RecordedInput, StateDocument};

/// Interval between two steps of the sweep.
pub(super) const EVERY: Duration = Duration::from_millis(50);
/// Steps of a round: each loop is visited every five seconds.
const PARTS: usize = 100;
/// Steps over which the loops' health documents are spread: each loop's comes once a minute...
const HEALTH_PARTS: usize = 1200;
/// ... provided that is at most this many documents a step, a thousand a second.
const HEALTH_AT_ONCE: usize = 50;
/// Up to this many loops, all are visited with each report.
const FEW: usize = 2000;
/// Most loops forgotten in one round.
const FORGET_AT_ONCE: usize = 1000;
/// Kinds of documents under which queries find a loop.
const KINDS: [Kind; 4] = [Kind::Estimate, Kind::Gap, Kind::Health, Kind::Alarm];

/// Progress of the current round, and its totals so far.
#[derive(Debug, Default)]
pub(super) struct Sweep {
    next: usize,
    next_health: usize,
    sum: AlignCounts,
    bytes: usize,
    /// Loops that are silent.
    silent: Vec<LoopId>,
}

/// The loops that the daemon has registered.
#[derive(Debug, Default)]
pub(super) struct Registered {
    /// When each loop was last heard, s since the start, by handle; `None` where there is no loop.
    heard_s: Vec<Option<u32>>,
    /// Segments of the recording that have a file: those with loops, and the first one even before any loop comes.
    pub segments: BTreeSet<usize>,
}

impl Registered {
    /// Notes a new loop or a sample of a known one; true if the loop is new.
    pub(super) fn mark_heard(&mut self, id: LoopId, now: Duration) -> bool {
        if self.heard_s.len() <= id.index() {
            self.heard_s.resize(id.index() + 1, None);
        }
        self.heard_s[id.index()].replace(seconds(now)).is_none()
    }

    fn heard_s(&self, id: LoopId) -> Option<u32> {
        self.heard_s.get(id.index()).copied().flatten()
    }

    fn forget(&mut self, id: LoopId) {
        if let Some(heard_s) = self.heard_s.get_mut(id.index()) {
            *heard_s = None;
        }
    }

    /// Number of registered loops.
    #[cfg(test)]
    pub(super) fn count(&self) -> usize {
        self.heard_s.iter().flatten().count()
    }
}

fn seconds(now: Duration) -> u32 {
    u32::try_from(now.as_secs()).unwrap_or(u32::MAX)
}

impl EngineThread {
    /// Registers the loops present at the start, and opens their files.
    pub(super) fn register_all(&mut self) {
        let now = self.clock.since(self.started);
        for id in self.loops.engine.ids() {
            self.loops.registered.mark_heard(id, now);
            self.loops.registered.segments.insert(segment_of(id));
        }
        self.loops.registered.segments.insert(0);
        self.reopen_segments();
    }

    /// Registers a loop if it is new: opens its segment's file, or records its memory in the open one.
    pub(super) fn register(&mut self, id: LoopId) {
        if self.loops.registered.heard_s(id).is_some() {
            return;
        }
        self.loops.registered.mark_heard(id, self.clock.since(self.started));
        let segment = segment_of(id);
        if self.loops.registered.segments.insert(segment) {
            return self.open_segment(segment);
        }
        let state = self.loops.engine.checkpoint(id);
        let nothing = Checkpoint { alarm: Alarm::default(), gap: GapWatch::default(), group: None, stream: None };
        if self.memory(id) != nothing {
            // It came back with its memory, which a replay of this file needs too.
            let document = StateDocument::new(self.loops.engine.name(id), None, state);
            self.record(id, Kind::State, &document, 0);
        }
    }

    /// The handle of a loop. A loop that was forgotten with an active alarm comes back, whether or not there is room; a removed
    /// loop has no handle.
    pub(super) fn find_or_revive(&mut self, name: &str) -> Option<LoopId> {
        let has_left = self.loops.engine.has_left(name);
        let id = if has_left { Some(self.loops.engine.appear_anyway(name)) } else { self.loops.engine.find(name) };
        id.filter(|id| !self.loops.removed.contains(id)).inspect(|id| self.register(*id))
    }

    /// Visits every loop if there are few; otherwise [`EngineThread::sweep_step`] does it.
    pub(super) fn sweep_some(&mut self, health_parts: usize) {
        if self.loops.engine.places() > FEW {
            return;
        }
        let all = self.loops.engine.places();
        self.look_at(0, all);
        self.end_round();
        self.publish_health(all.div_ceil(health_parts).max(1));
    }

    /// Visits the next part of many loops.
    pub(super) fn sweep_step(&mut self) {
        let all = self.loops.engine.places();
        if all <= FEW {
            return;
        }
        let (from, to) = (self.loops.sweep.next, self.loops.sweep.next + all.div_ceil(PARTS));
        self.look_at(from, to);
        self.loops.sweep.next = to;
        if to >= all {
            self.loops.sweep.next = 0;
            self.end_round();
        }
        self.publish_health(all.div_ceil(HEALTH_PARTS).min(HEALTH_AT_ONCE));
    }

    fn look_at(&mut self, from: usize, to: usize) {
        let (now, now_ns) = (self.clock.now(), self.clock.now_ns());
        let forget_after_s = self.config.input.forget_after_s;
        let (now_s, may_forget) = (self.clock.since(self.started).as_secs_f64(), forget_after_s > 0.0);
        for id in self.loops.engine.ids_in(from, to) {
            let figures = self.loops.engine.figures(id);
            self.loops.sweep.sum.add(&figures.counts);
            self.loops.sweep.bytes += self.loops.engine.bytes(id);
            let (name, place) = (self.loops.engine.name(id), &self.loops.engine.settings(id).place);
            if let Some(board) = &mut self.outputs.board {
                let age_s = figures.greatest_ns.map(|t| s_from_ns(now_ns.saturating_sub(t)));
                board.age(&self.metrics.series, name, place, age_s);
            }
            if let Some(overview) = &self.outputs.overview {
                overview.figures(name, place, now, &figures);
            }
            let heard_s = self.loops.registered.heard_s(id).map_or(now_s, f64::from);
            if may_forget && now_s - heard_s > forget_after_s && self.loops.sweep.silent.len() < FORGET_AT_ONCE {
                self.loops.sweep.silent.push(id);
            }
        }
    }

    fn end_round(&mut self) {
        self.metrics.show_aligned(&std::mem::take(&mut self.loops.sweep.sum));
        self.metrics.loop_bytes.set(std::mem::take(&mut self.loops.sweep.bytes) as i64);
        // A loop whose last window was skipped becomes idle without an answer, so check here too.
        self.forget_removed();
        let silent = std::mem::take(&mut self.loops.sweep.silent);
        self.forget(&silent);
    }

    fn publish_health(&mut self, slice: usize) {
        let (all, from, now_ns) = (self.loops.engine.places(), self.loops.sweep.next_health, self.clock.now_ns());
        for id in self.loops.engine.ids_in(from, from + slice) {
            let health =
                LoopHealth::new(self.loops.engine.name(id), &self.daemon_id, &self.loops.engine.figures(id), now_ns);
            self.publish(self.loops.engine.name(id), Kind::Health, &health);
        }
        self.loops.sweep.next_health = if from + slice >= all { 0 } else { from + slice };
    }

    /// Forgets loops that have long been silent or were removed. First records what a replay needs to forget them at the same
    /// point.
    pub(super) fn forget(&mut self, silent: &[LoopId]) {
        let mut gone = HashSet::new();
        for id in silent.iter().copied() {
            if !self.loops.engine.is_idle(id) {
                continue;
            }
            let name = self.loops.engine.name(id).clone();
            let at_rest = self.loops.engine.checkpoint(id).alarm.shown() == State::Normal;
            let at_ns = self.loops.engine.figures(id).greatest_ns.unwrap_or(0);
            self.record(id, Kind::Input, &RecordedInput::Forget, at_ns);
            if !at_rest {
                self.keep(&StateDocument { left: true, ..StateDocument::new(&name, None, self.memory(id)) });
            }
            self.loops.engine.forget(id);
            if let Some(plant) = &mut self.loops.plant {
                plant.forget(&name);
            }
            gone.insert(id);
            self.metrics.loops_forgotten.inc();
            // An active alarm remains on display and can be queried, with its age.
            for kind in KINDS.into_iter().filter(|kind| at_rest || *kind != Kind::Alarm) {
                let key = topic::result(&self.config.site.prefix, &name, kind);
                self.outputs.publisher.publish(Publication { key, kind, document: None });
            }
            if at_rest {
                if let Some(state_writer) = &self.outputs.state_writer {
                    state_writer.forget(&name);
                }
                if let Some(overview) = &self.outputs.overview {
                    overview.forget(&name);
                }
                if let Some(board) = &mut self.outputs.board {
                    board.forget(&self.metrics.series, &name);
                }
            }
            self.loops.schedule.forget(id.index());
            self.inputs.limits.forget(id);
            self.loops.registered.forget(id);
            self.inputs.ahead = self.inputs.ahead.filter(|(of, _)| *of != id);
        }
        if gone.is_empty() {
            return;
        }
        tracing::info!(loops = gone.len(), left = self.loops.engine.count(), "loops have left the memory");
        self.loops.sweep.silent.retain(|id| !gone.contains(id));
        self.loops.removed.retain(|id| !gone.contains(id));
        self.inputs.routes.forget(&gone);
        self.inputs.feeds.forget(&gone);
        self.inputs.senders.forget(&gone);
        self.close_empty_segments(&gone);
    }

    /// Closes the files whose loops have all left; the next loop opens a new one.
    fn close_empty_segments(&mut self, gone: &HashSet<LoopId>) {
        for segment in gone.iter().map(|id| segment_of(*id)).collect::<BTreeSet<usize>>() {
            let (from, to) = (segment * LOOPS_PER_FILE, (segment + 1) * LOOPS_PER_FILE);
            if self.loops.engine.ids_in(from, to).len() == 0
                && self.loops.registered.segments.remove(&segment)
                && let Some(recorder) = &mut self.outputs.recorder
            {
                recorder.record(Item::Close { segment });
            }
        }
    }
}
