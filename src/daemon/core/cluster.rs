//! What the engine's thread does where loops change hands: takes one with its memory and its past, releases one, and says
//! what it remembers so that another may take it. Each is recorded, so that replay does the same.

use super::super::routes::Route;
use super::{Core, to_json};
use crate::sink::zenoh::Publication;
use crate::source::members::Change;
use crate::source::refill::Past;
use stiction::record::{Sample, Signal};
use stiction_monitor::codec;
use stiction_monitor::codec::topic::{self, Kind};
use stiction_monitor::engine::{Checkpoint, LoopId, RecordedInput, StateDocument};

/// Samples of one loop that are held back while its past is asked for.
const HELD: usize = 100_000;
/// Stands for a sample that nobody stamped, neither itself nor the bus: it has no place in the past.
const UNSTAMPED_NS: i64 = i64::MIN;

impl Core {
    /// Something has changed among the daemons.
    pub(super) fn shared(&mut self, change: Change) {
        match change {
            Change::Owners => {
                let lost: Vec<LoopId> = self.held().filter(|id| !self.own.has(self.engine.name(*id))).collect();
                lost.into_iter().for_each(|id| self.release(id));
            }
            Change::Take { loop_name, memory, past_follows } => self.take_loop(&loop_name, memory, past_follows),
            Change::Past { loop_name, messages } => self.take_past(&loop_name, messages),
        }
    }

    /// Loops that are this daemon's.
    fn held(&self) -> impl Iterator<Item = LoopId> + '_ {
        self.engine.ids().filter(|id| !self.engine.is_away(*id))
    }

    fn take_loop(&mut self, name: &str, memory: Option<Box<Checkpoint>>, past_follows: bool) {
        if self.engine.find(name).is_some_and(|id| !self.engine.is_away(id)) {
            return;
        }
        let now = self.clock.since(self.started);
        let known = memory.is_some();
        let may_appear = || known || self.limits.new_loop(now);
        let Route::To(id, _) = self.routes.to_loop(name, Signal::Op, &mut self.engine, may_appear) else {
            self.metrics.refused_loops.inc();
            return;
        };
        self.welcome();
        let at_ns = memory.as_ref().and_then(|m| m.alarm.progress().0).unwrap_or(0);
        self.record(id, Kind::Input, &RecordedInput::Taken { memory: memory.clone() }, at_ns);
        let document = self.engine.take(id, memory.map(|memory| *memory));
        self.metrics.loops_taken.inc();
        if let Some(document) = document {
            self.show_alarm(id, &document);
            self.publish(id, Kind::Alarm, to_json(&document));
        }
        if known {
            let state = to_json(&StateDocument::new(self.engine.name(id), Some(at_ns), self.memory(id)));
            if let Some(keeper) = &self.keeper {
                keeper.keep(self.engine.name(id), state.clone());
            }
            self.tell_state(id, state);
        }
        if past_follows {
            self.filling.insert(id, Vec::new());
        }
    }

    fn release(&mut self, id: LoopId) {
        let memory = self.memory(id);
        let at_ns = memory.alarm.progress().0.unwrap_or(0);
        self.record(id, Kind::Input, &RecordedInput::Released, at_ns);
        self.engine.release(id);
        self.metrics.loops_released.inc();
        self.filling.remove(&id);
        self.due.retain(|(of, _), _| *of != id);
        // Whoever waits for a diagnosis gets none from here, and asks again.
        self.asking.retain(|(of, _), _| *of != id);
        self.tell_state(id, to_json(&StateDocument::new(self.engine.name(id), Some(at_ns), memory)));
        for kind in [Kind::Estimate, Kind::Alarm, Kind::Gap, Kind::Health, Kind::State] {
            let key = topic::result(&self.config.site.prefix, self.engine.name(id), kind);
            self.publisher.publish(Publication::removal(key, kind));
        }
    }

    /// At the end of a member: others make the windows that are not done.
    pub(super) fn release_all(&mut self) {
        if self.own.is_shared() {
            let all: Vec<LoopId> = self.held().collect();
            all.into_iter().for_each(|id| self.release(id));
        }
    }

    /// Says what is remembered of a loop to those who may take it.
    pub(super) fn tell_state(&self, id: LoopId, state: Vec<u8>) {
        if self.own.is_shared() {
            self.publish(id, Kind::State, state);
        }
    }

    /// Whether a sample goes no further for now: its loop is another's, or its past is not there yet.
    pub(super) fn is_held_back(&mut self, id: LoopId, sample: &Sample, arrival_ns: i64) -> bool {
        if self.own.is_all() {
            return false;
        }
        if self.engine.is_away(id) {
            return true;
        }
        let Some(held) = self.filling.get_mut(&id) else { return false };
        if held.len() < HELD {
            held.push((*sample, arrival_ns));
        } else {
            self.metrics.dropped_input.inc();
        }
        true
    }

    /// A loop's past is there: it is taken in the order of its stamps, then what came meanwhile.
    fn take_past(&mut self, name: &str, messages: Vec<Past>) {
        let Some((id, held)) = self.engine.find(name).and_then(|id| Some((id, self.filling.remove(&id)?))) else {
            return;
        };
        let arrival_ns = self.clock.now_ns();
        let mut samples = Vec::new();
        for past in &messages {
            let route = self.routes.of(&past.key, &mut self.engine, || false);
            let Route::To(of, signal) = route else { continue };
            let fallback_ns = past.bus_ns.unwrap_or(UNSTAMPED_NS);
            let (encoding, codec) = (past.encoding.as_deref(), Some(self.codec.as_str()));
            if of != id || codec::decode(signal, &past.payload, encoding, codec, fallback_ns, &mut samples).is_err() {
                self.metrics.undecodable.inc();
            }
        }
        samples.retain(|sample| sample.t_ns != UNSTAMPED_NS);
        samples.sort_by_key(|sample| sample.t_ns);
        // A cache and a storage may both have it.
        samples.dedup_by(|b, a| a.t_ns == b.t_ns && a.signal == b.signal);
        self.metrics.samples_refilled.inc_by(samples.len() as u64);
        for sample in samples {
            self.take_sample(id, sample, arrival_ns);
        }
        for (sample, arrival_ns) in held {
            self.take_sample(id, sample, arrival_ns);
        }
    }
}
