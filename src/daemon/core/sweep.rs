//! Looks at all loops a part at a time, so that a hundred thousand of them never hold up a sample: figures, health, and
//! who has left the plant. Registers those that are new or come back.

use std::collections::{BTreeSet, HashSet};
use std::time::Duration;

use super::Core;
use crate::daemon::sink::recorder::{Item, LOOPS_PER_FILE, shard_of};
use crate::daemon::sink::zenoh::Publication;
use crate::runtime::health::LoopHealth;
use stiction::core::signal::align::AlignCounts;
use stiction::core::units::s_from_ns;
use stiction_engine::alarm::{Alarm, State};
use stiction_engine::codec::topic::{self, Kind};
use stiction_engine::engine::{Checkpoint, GapWatch, LoopId, RecordedInput, StateDocument};

/// How often a part of the loops is looked at.
pub(super) const EVERY: Duration = Duration::from_millis(50);
/// Parts of a round: each loop is looked at every five seconds.
const PARTS: usize = 100;
/// Parts over which the loops' own health is spread: each loop's comes once a minute...
const HEALTH_PARTS: usize = 1200;
/// ... as long as that is not more documents at a time than this: a thousand a second.
const HEALTH_AT_ONCE: usize = 50;
/// Loops up to which all are looked at with each report.
const FEW: usize = 2000;
/// Loops that are forgotten in a round at most.
const FORGET_AT_ONCE: usize = 1000;
/// Documents under which queries find a loop.
const KINDS: [Kind; 4] = [Kind::Estimate, Kind::Gap, Kind::Health, Kind::Alarm];

/// Where the round stands, and what it found so far.
#[derive(Debug, Default)]
pub(super) struct Sweep {
    next: usize,
    next_health: usize,
    sum: AlignCounts,
    bytes: usize,
    /// Silent loops.
    silent: Vec<LoopId>,
}

/// The loops that the daemon has registered.
#[derive(Debug, Default)]
pub(super) struct Registered {
    /// When each loop was heard last, s since the start, by the handle's place; `None` where there is no loop.
    heard_s: Vec<Option<u32>>,
    /// Shards of the recording that have a file: those with loops, and the first one until loops come.
    pub shards: BTreeSet<usize>,
}

impl Registered {
    /// A loop is new, or a sample of it was taken; says whether it is new.
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

    /// Loops that it holds.
    #[cfg(test)]
    pub(super) fn count(&self) -> usize {
        self.heard_s.iter().flatten().count()
    }
}

fn seconds(now: Duration) -> u32 {
    u32::try_from(now.as_secs()).unwrap_or(u32::MAX)
}

impl Core {
    /// Registers the loops that are there at the start, and opens their files.
    pub(super) fn register_all(&mut self) {
        let now = self.clock.since(self.started);
        for id in self.engine.ids() {
            self.registered.mark_heard(id, now);
            self.registered.shards.insert(shard_of(id));
        }
        self.registered.shards.insert(0);
        self.reopen_shards();
    }

    /// Registers a loop if it is new: its file is opened, or knows its alarm.
    pub(super) fn register(&mut self, id: LoopId) {
        if self.registered.heard_s(id).is_some() {
            return;
        }
        self.registered.mark_heard(id, self.clock.since(self.started));
        let shard = shard_of(id);
        if self.registered.shards.insert(shard) {
            return self.open_shard(shard);
        }
        let state = self.engine.checkpoint(id);
        let nothing = Checkpoint { alarm: Alarm::default(), gap: GapWatch::default(), group: None, stream: None };
        if self.memory(id) != nothing {
            // It came back with what was remembered of it: a replay of this file must know it too.
            let document = StateDocument::new(self.engine.name(id), None, state);
            self.record(id, Kind::State, &document, 0);
        }
    }

    /// The handle of a loop, which comes back if it was forgotten with an alarm, be there room or not; none of a loop that was
    /// removed.
    pub(super) fn find_or_revive(&mut self, name: &str) -> Option<LoopId> {
        let has_left = self.engine.has_left(name);
        let id = if has_left { Some(self.engine.appear_anyway(name)) } else { self.engine.find(name) };
        id.filter(|id| !self.removed.contains(id)).inspect(|id| self.register(*id))
    }

    /// Looks at every loop where there are few; many are looked at by [`Core::sweep_step`].
    pub(super) fn sweep_some(&mut self, health_parts: usize) {
        if self.engine.places() > FEW {
            return;
        }
        let all = self.engine.places();
        self.look_at(0, all);
        self.end_round();
        self.publish_health(all.div_ceil(health_parts).max(1));
    }

    /// Looks at the next part of many loops.
    pub(super) fn sweep_step(&mut self) {
        let all = self.engine.places();
        if all <= FEW {
            return;
        }
        let (from, to) = (self.sweep.next, self.sweep.next + all.div_ceil(PARTS));
        self.look_at(from, to);
        self.sweep.next = to;
        if to >= all {
            self.sweep.next = 0;
            self.end_round();
        }
        self.publish_health(all.div_ceil(HEALTH_PARTS).min(HEALTH_AT_ONCE));
    }

    fn look_at(&mut self, from: usize, to: usize) {
        let (now, now_ns) = (self.clock.now(), self.clock.now_ns());
        let forget_after_s = self.config.input.forget_after_s;
        let (now_s, may_forget) = (self.clock.since(self.started).as_secs_f64(), forget_after_s > 0.0);
        for id in self.engine.ids_in(from, to) {
            let figures = self.engine.figures(id);
            self.sweep.sum.add(&figures.counts);
            self.sweep.bytes += self.engine.bytes(id);
            let (name, place) = (self.engine.name(id), &self.engine.settings(id).place);
            if let Some(board) = &mut self.board {
                let age_s = figures.greatest_ns.map(|t| s_from_ns(now_ns.saturating_sub(t)));
                board.age(&self.metrics.series, name, place, age_s);
            }
            if let Some(overview) = &self.overview {
                overview.figures(name, place, now, &figures);
            }
            let heard_s = self.registered.heard_s(id).map_or(now_s, f64::from);
            if may_forget && now_s - heard_s > forget_after_s && self.sweep.silent.len() < FORGET_AT_ONCE {
                self.sweep.silent.push(id);
            }
        }
    }

    fn end_round(&mut self) {
        self.metrics.show_aligned(&std::mem::take(&mut self.sweep.sum));
        self.metrics.loop_bytes.set(std::mem::take(&mut self.sweep.bytes) as i64);
        // One whose last window was skipped is idle without an answer.
        self.forget_removed();
        let silent = std::mem::take(&mut self.sweep.silent);
        self.forget(&silent);
    }

    fn publish_health(&mut self, slice: usize) {
        let (all, from, now_ns) = (self.engine.places(), self.sweep.next_health, self.clock.now_ns());
        for id in self.engine.ids_in(from, from + slice) {
            let health = LoopHealth::new(self.engine.name(id), &self.daemon_id, &self.engine.figures(id), now_ns);
            self.publish(self.engine.name(id), Kind::Health, &health);
        }
        self.sweep.next_health = if from + slice >= all { 0 } else { from + slice };
    }

    /// Forgets loops that have been silent for long or were removed. It first records what a replay needs to do the same at
    /// the same place.
    pub(super) fn forget(&mut self, silent: &[LoopId]) {
        let mut gone = HashSet::new();
        for id in silent.iter().copied() {
            if !self.engine.is_idle(id) {
                continue;
            }
            let name = self.engine.name(id).clone();
            let at_rest = self.engine.checkpoint(id).alarm.shown() == State::Normal;
            let at_ns = self.engine.figures(id).greatest_ns.unwrap_or(0);
            self.record(id, Kind::Input, &RecordedInput::Forget, at_ns);
            if !at_rest {
                self.keep(&StateDocument { left: true, ..StateDocument::new(&name, None, self.memory(id)) });
            }
            self.engine.forget(id);
            if let Some(plant) = &mut self.plant {
                plant.forget(&name);
            }
            gone.insert(id);
            self.metrics.loops_forgotten.inc();
            // An alarm that is not at rest goes on being shown and answered, with the age that it has.
            for kind in KINDS.into_iter().filter(|kind| at_rest || *kind != Kind::Alarm) {
                let key = topic::result(&self.config.site.prefix, &name, kind);
                self.publisher.publish(Publication { key, kind, document: None });
            }
            if at_rest {
                if let Some(keeper) = &self.keeper {
                    keeper.forget(&name);
                }
                if let Some(overview) = &self.overview {
                    overview.forget(&name);
                }
                if let Some(board) = &mut self.board {
                    board.forget(&self.metrics.series, &name);
                }
            }
            self.schedule.forget(id.index());
            self.limits.forget(id);
            self.registered.forget(id);
            self.ahead = self.ahead.filter(|(of, _)| *of != id);
        }
        if gone.is_empty() {
            return;
        }
        tracing::info!(loops = gone.len(), left = self.engine.count(), "loops have left the memory");
        self.sweep.silent.retain(|id| !gone.contains(id));
        self.removed.retain(|id| !gone.contains(id));
        self.routes.forget(&gone);
        self.feeds.forget(&gone);
        self.senders.forget(&gone);
        self.close_empty_shards(&gone);
    }

    /// Files of which every loop has left are finished; the next one follows with the next loop.
    fn close_empty_shards(&mut self, gone: &HashSet<LoopId>) {
        for shard in gone.iter().map(|id| shard_of(*id)).collect::<BTreeSet<usize>>() {
            let (from, to) = (shard * LOOPS_PER_FILE, (shard + 1) * LOOPS_PER_FILE);
            if self.engine.ids_in(from, to).len() == 0
                && self.registered.shards.remove(&shard)
                && let Some(recorder) = &mut self.recorder
            {
                recorder.record(Item::Close { shard });
            }
        }
    }
}
