//! The core of the daemon: one state machine per loop, which gets time and data from its caller.
//!
//! [`Engine::push`] takes a sample, [`Engine::complete`] the answer to a request, [`Engine::command`] a person's command; each
//! emits [`Event`]s. No clock, thread or file is used here, and no window is cut or fitted inline: a due window leaves as a
//! [`Request`] with a snapshot of the loop's history, and the caller computes it. Answers are processed per loop in the order
//! of the windows, so everything after them depends only on that order and on event time. Gap diagnoses leave as separate
//! [`GapRequest`]s; [`gaps`] decides when.

mod due;
pub mod gaps;
mod input;
mod loop_state;
mod misplaced;
mod neighbours;
pub mod plant;
mod settings;
mod windowing;

use std::collections::{BTreeSet, HashMap};
use std::ops::Range;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::alarm::{Alarm, AlarmDocument, Command, CommandError, State};
use loop_state::LoopState;
use stiction::core::record::Sample;
use stiction::core::verdict::EstimateDocument;
use stiction::samples::align::{AlignCounts, Aligner};

pub use due::{Request, Snapshot, WindowAnswer};
pub use gaps::{GapReason, GapRefusal, GapRequest, GapWatch, PublishedGap};
pub use input::{INPUT_SCHEMA, RecordedInput, STATE_SCHEMA, StateDocument};
pub use misplaced::{Misplaced, misplaced};
pub use neighbours::RecordedNeighbour;
pub use plant::{Comparison, GroupStanding, LoopWindow, PlantWatch};
pub use settings::{EngineSettings, GapParams, LoopSettings, Origins, WindowParams};
pub use windowing::{longest, section, windows};

/// Handle of a loop in one engine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct LoopId(u32);

impl LoopId {
    /// Its index among the loops; after a loop has left, a later one may reuse its index.
    #[must_use]
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

/// Output of the engine, in order.
#[derive(Debug, Clone)]
pub enum Event {
    /// Compute this and return the answer.
    Request(Box<Request>),
    /// A window with its separate assessment, for comparison with other loops.
    Window(LoopId, Box<LoopWindow>),
    /// An estimate to publish and record.
    Estimate(LoopId, Box<EstimateDocument>),
    /// A change of an alarm to publish, record and log.
    Alarm(LoopId, Box<AlarmDocument>),
    /// The loop's memory after a window, to record.
    State(LoopId, Box<StateDocument>),
    /// Compute this when nothing else waits, and return the answer.
    GapRequest(Box<GapRequest>),
    /// A gap diagnosis to publish and record.
    Gap(LoopId, Box<PublishedGap>),
}

/// Why a due window was not fitted, or a gap not diagnosed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SkipReason {
    /// The machine was too busy.
    QueueFull,
    /// The daemon stopped before it was finished.
    Shutdown,
    /// It panicked or found no answer; the message is in the log.
    Failed,
}

/// Figures of a loop for health documents.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoopFigures {
    /// Samples dropped or inserted.
    pub counts: AlignCounts,
    /// Greatest source time, ns.
    pub greatest_ns: Option<i64>,
    /// Windows that came due.
    pub windows: u64,
    /// Windows waiting for their answers.
    pub waiting: usize,
}

/// Everything that a loop needs to continue in another file, except its history: see [`Engine::checkpoint`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Checkpoint {
    /// The alarm and its memory.
    pub alarm: Alarm,
    /// The loop's usual values, and the model from which its gap is measured.
    #[serde(default)]
    pub gap: GapWatch,
    /// The last judgement of its group.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub group: Option<GroupStanding>,
    /// Samples not yet in the history, and the extent of the history. Absent at the start of a run.
    pub stream: Option<StreamState>,
}

/// State of a loop's stream of points.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StreamState {
    aligner: Aligner,
    points: u64,
    next_end_ns: Option<i64>,
    windows: u64,
    #[serde(default)]
    gaps: u64,
    /// Windows that had no answer yet.
    #[serde(default, skip_serializing_if = "is_zero")]
    waiting: u64,
    /// End of the last window that the previous run took.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    taken_ns: Option<i64>,
}

#[allow(clippy::trivially_copy_pass_by_ref)] // as serde calls it
const fn is_zero(n: &u64) -> bool {
    *n == 0
}

impl StreamState {
    /// The loop's greatest source time when the checkpoint was made, ns.
    #[must_use]
    pub const fn greatest_ns(&self) -> Option<i64> {
        self.aligner.greatest_ns()
    }

    /// Number of windows that had come due.
    #[must_use]
    pub const fn windows(&self) -> u64 {
        self.windows
    }

    /// Number of those without an answer.
    #[must_use]
    pub const fn waiting(&self) -> u64 {
        self.waiting
    }
}

/// All loops of a daemon.
#[derive(Debug)]
pub struct Engine {
    settings: EngineSettings,
    /// Number of loops with `[[loop]]` settings that have not appeared; places are reserved for them.
    own_absent: usize,
    /// By handle; `None` for a forgotten loop.
    loops: Vec<Option<Box<LoopState>>>,
    by_name: HashMap<Arc<str>, LoopId>,
    /// Handles of forgotten loops, which are reused.
    free: BTreeSet<LoopId>,
    /// Memory of absent loops until they return; of forgotten ones only if the alarm is active.
    left: HashMap<Arc<str>, Checkpoint>,
    /// Empty loop that a handle to a forgotten loop resolves to.
    nobody: Box<LoopState>,
}

impl Engine {
    /// An engine without loops. Loops with `[[loop]]` settings also appear only with their first sample.
    #[must_use]
    pub fn new(settings: EngineSettings) -> Self {
        let nobody = Box::new(LoopState::new("".into(), settings.common[0].clone()));
        let (loops, by_name, free, left) = (Vec::new(), HashMap::new(), BTreeSet::new(), HashMap::new());
        Self { own_absent: settings.own.len(), settings, loops, by_name, free, left, nobody }
    }

    /// The same engine with a daemon's id, which its documents carry.
    #[must_use]
    pub fn of_daemon(mut self, id: &str) -> Self {
        self.settings.daemon = Some(id.into());
        self
    }

    fn of(&self, id: LoopId) -> &LoopState {
        self.loops.get(id.index()).and_then(Option::as_deref).unwrap_or(&self.nobody)
    }

    fn of_mut(&mut self, id: LoopId) -> &mut LoopState {
        self.loops.get_mut(id.index()).and_then(Option::as_deref_mut).unwrap_or(&mut self.nobody)
    }

    /// The hash of the configuration in force.
    #[must_use]
    pub fn config_hash(&self) -> &str {
        &self.settings.config_hash
    }

    /// Every loop's handle.
    pub fn ids(&self) -> impl ExactSizeIterator<Item = LoopId> + use<> {
        self.ids_in(0, self.loops.len())
    }

    /// The handles of loops in a range of indices.
    pub fn ids_in(&self, from: usize, to: usize) -> impl ExactSizeIterator<Item = LoopId> + use<> {
        let to = to.min(self.loops.len());
        let there = (from.min(to)..to).filter(|index| self.loops[*index].is_some());
        there.map(|index| LoopId(index as u32)).collect::<Vec<LoopId>>().into_iter()
    }

    /// Number of loops.
    #[must_use]
    pub fn count(&self) -> usize {
        self.by_name.len()
    }

    /// Number of places, free ones included: one more than the largest index.
    #[must_use]
    pub const fn places(&self) -> usize {
        self.loops.len()
    }

    /// A loop's name.
    #[must_use]
    pub fn name(&self, id: LoopId) -> &Arc<str> {
        &self.of(id).name
    }

    /// The handle of a loop that has appeared.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<LoopId> {
        self.by_name.get(name).copied()
    }

    /// The handle of a loop, which is created if it is new; `None` beyond `max_loops`. Loops with their own settings always
    /// have a place.
    pub fn appear(&mut self, name: &str) -> Option<LoopId> {
        self.has_place_for(name).then(|| self.appear_anyway(name))
    }

    /// The same regardless of room, for a loop that is forgotten again at once.
    pub fn appear_anyway(&mut self, name: &str) -> LoopId {
        if let Some(id) = self.find(name) {
            return id;
        }
        let mut new = LoopState::new(name.into(), self.settings.of(name).clone());
        if let Some(memory) = self.left.remove(name) {
            (new.alarm, new.gap, new.group) = (memory.alarm, memory.gap, memory.group);
        }
        let id = self.free.first().copied().unwrap_or(LoopId(self.loops.len() as u32));
        self.put(id, Box::new(new));
        id
    }

    /// Stores the memory of an absent loop until it appears. Returns its alarm's document if the alarm is active.
    pub fn remember(&mut self, name: &str, memory: Checkpoint) -> Option<AlarmDocument> {
        let is_at_rest = memory.alarm.shown() == State::Normal;
        let document = (!is_at_rest).then(|| memory.alarm.restored(name).at(&self.settings.of(name).place));
        self.left.insert(name.into(), memory);
        document.map(|document| self.signed(document))
    }

    fn put(&mut self, id: LoopId, new: Box<LoopState>) {
        while self.loops.len() <= id.index() {
            self.free.insert(LoopId(self.loops.len() as u32));
            self.loops.push(None);
        }
        self.free.remove(&id);
        self.own_absent -= usize::from(self.settings.own.contains_key(&*new.name));
        self.by_name.insert(new.name.clone(), id);
        self.loops[id.index()] = Some(new);
    }

    /// Moves a loop with its history from an engine under whose settings its window was the same, into a place in this range.
    /// Alarm and gap watch start from nothing, and work under way is dropped. `None` if there is no such loop or no place.
    pub fn take_loop(&mut self, from: &mut Self, name: &str, places: Range<usize>) -> Option<LoopId> {
        let (least, most) = (LoopId(places.start as u32), LoopId(places.end as u32));
        let free = self.free.range(least..most).next().copied();
        let id = free.unwrap_or_else(|| LoopId(self.loops.len().max(places.start) as u32));
        if id >= most || self.find(name).is_some() || !self.has_room_for(self.settings.own.contains_key(name)) {
            return None;
        }
        let old = from.by_name.remove(name)?;
        let taken = from.loops.get_mut(old.index()).and_then(Option::take)?;
        from.own_absent += usize::from(from.settings.own.contains_key(name));
        from.free.insert(old);
        self.put(id, Box::new(taken.in_next_run(self.settings.of(name).clone())));
        Some(id)
    }

    /// Whether a loop exists or may appear.
    #[must_use]
    pub fn has_place_for(&self, name: &str) -> bool {
        self.find(name).is_some() || self.has_room_for(self.settings.own.contains_key(name))
    }

    /// Whether a loop without `[[loop]]` settings may still appear.
    #[must_use]
    pub fn has_room(&self) -> bool {
        self.has_room_for(false)
    }

    fn has_room_for(&self, own: bool) -> bool {
        self.by_name.len() + if own { 0 } else { self.own_absent } < self.settings.max_loops
    }

    /// Takes one sample of a loop.
    pub fn push(&mut self, id: LoopId, sample: Sample, out: &mut Vec<Event>) {
        self.of_mut(id).push(id, sample, out);
    }

    /// Forgets a loop that has left the plant; false if it cannot be, because work is under way for it. Its handle is reused
    /// for the next loop that appears, so the caller must drop it.
    /// An active alarm is kept, and the loop has it again when it returns; everything else starts from nothing. The recording
    /// must contain this as an input.
    pub fn forget(&mut self, id: LoopId) -> bool {
        if self.of(id).name.is_empty() || !self.of(id).is_idle() {
            return false;
        }
        let Some(gone) = self.loops.get_mut(id.index()).and_then(Option::take) else { return false };
        let LoopState { name, alarm, gap, .. } = *gone;
        self.by_name.remove(&name);
        self.free.insert(id);
        self.own_absent += usize::from(self.settings.own.contains_key(&*name));
        if alarm.shown() != State::Normal {
            self.left.insert(name, Checkpoint { alarm, gap, group: None, stream: None });
        }
        true
    }

    /// Whether no work is under way for a loop, so that it can be forgotten.
    #[must_use]
    pub fn is_idle(&self, id: LoopId) -> bool {
        self.of(id).is_idle()
    }

    /// Loops that were forgotten with an active alarm, and their memory.
    pub fn left(&self) -> impl Iterator<Item = (&Arc<str>, &Checkpoint)> {
        self.left.iter()
    }

    /// Whether a loop was forgotten with an active alarm.
    #[must_use]
    pub fn has_left(&self, name: &str) -> bool {
        self.left.contains_key(name)
    }

    /// Bytes of a loop, without what all loops share and without windows under way.
    #[must_use]
    pub fn bytes(&self, id: LoopId) -> usize {
        self.of(id).bytes()
    }

    /// Takes the answer to a request.
    pub fn complete(&mut self, id: LoopId, seq: u64, answer: WindowAnswer, out: &mut Vec<Event>) {
        let (from, hash) = (out.len(), self.settings.origin_of(&self.of(id).name));
        self.of_mut(id).resolve(id, seq, Some(answer), &hash, out);
        self.sign(&mut out[from..]);
    }

    /// Skips a due window. Its document says so; the recording must contain the skip as an input.
    pub fn skip(&mut self, id: LoopId, seq: u64, out: &mut Vec<Event>) {
        let (from, hash) = (out.len(), self.settings.origin_of(&self.of(id).name));
        self.of_mut(id).resolve(id, seq, None, &hash, out);
        self.sign(&mut out[from..]);
    }

    /// A loop's windows that wait for answers, oldest first: number and end, ns.
    pub fn waiting(&self, id: LoopId) -> impl Iterator<Item = (u64, i64)> + '_ {
        self.of(id).waiting()
    }

    /// Requests a diagnosis of a loop's current data for a person; returns its number. With `pool`, earlier diagnoses help to
    /// decide the cause, and the recording must contain their windows as an input.
    ///
    /// # Errors
    /// [`GapRefusal`] if too little data is held.
    pub fn run_gap(
        &mut self,
        id: LoopId,
        by: Option<&str>,
        pool: bool,
        out: &mut Vec<Event>,
    ) -> Result<u64, GapRefusal> {
        let (from, hash) = (out.len(), self.settings.origin_of(&self.of(id).name));
        let asked = self.of_mut(id).run_gap(id, (by, pool), &hash, out);
        self.sign(&mut out[from..]);
        asked
    }

    /// Takes a diagnosis, which is emitted once all earlier ones are done.
    pub fn complete_gap(&mut self, id: LoopId, number: u64, document: PublishedGap, out: &mut Vec<Event>) {
        self.of_mut(id).resolve_gap(id, number, Some(document), out);
    }

    /// Skips a diagnosis; the recording must contain the skip as an input. If it found no place in the queue, the loop's next
    /// departing window requests it again.
    pub fn skip_gap(&mut self, id: LoopId, number: u64, reason: SkipReason, out: &mut Vec<Event>) {
        self.of_mut(id).skip_gap(id, number, reason, out);
    }

    /// A loop's diagnoses that wait for answers, oldest first.
    pub fn gaps_waiting(&self, id: LoopId) -> impl Iterator<Item = u64> + '_ {
        self.of(id).gaps_waiting()
    }

    /// Sets the judgement of a loop's group, or that it is in none any longer; the recording must contain it as an input.
    pub fn stand(&mut self, id: LoopId, standing: Option<GroupStanding>) {
        self.of_mut(id).group = standing;
    }

    /// Whether a loop's stiction alarm is active, or its newest window counts towards raising it, and it is not inhibited.
    #[must_use]
    pub fn alarms(&self, name: &str) -> bool {
        self.find(name).is_some_and(|id| self.of(id).alarm.is_active_or_near())
    }

    /// Ends the alarm of a loop that is no longer configured; `None` if it is normal. The recording must contain this as an
    /// input.
    pub fn end_alarm(&mut self, id: LoopId) -> Option<AlarmDocument> {
        let document = self.of_mut(id).end_alarm();
        document.map(|document| self.signed(document))
    }

    /// Carries out a person's command.
    ///
    /// # Errors
    /// [`CommandError`] if the command is unknown or does not fit the alarm's state.
    pub fn command(&mut self, id: LoopId, command: &Command) -> Result<AlarmDocument, CommandError> {
        let document = self.of_mut(id).command(command)?;
        Ok(self.signed(document))
    }

    /// The state to write at the start of a file.
    #[must_use]
    pub fn checkpoint(&self, id: LoopId) -> Checkpoint {
        self.of(id).checkpoint()
    }

    /// Restores a state: the alarm always, the stream if the checkpoint has one. The current history is kept if it belongs to
    /// that stream.
    /// Returns the alarm's document if the alarm is active.
    pub fn restore(&mut self, id: LoopId, checkpoint: Checkpoint) -> Option<AlarmDocument> {
        let document = self.of_mut(id).restore(checkpoint);
        document.map(|document| self.signed(document))
    }

    /// Restores a state without its stream, as at the start of the file that is being verified.
    pub fn restore_memory(&mut self, id: LoopId, checkpoint: Checkpoint) {
        let of = self.of_mut(id);
        (of.alarm, of.gap, of.group) = (checkpoint.alarm, checkpoint.gap, checkpoint.group);
    }

    /// The alarm's document with this daemon's id.
    fn signed(&self, document: AlarmDocument) -> AlarmDocument {
        AlarmDocument { daemon: self.settings.daemon.as_deref().map(str::to_owned), ..document }
    }

    /// Adds this daemon's id to events.
    fn sign(&self, out: &mut [Event]) {
        let Some(daemon) = &self.settings.daemon else { return };
        for event in out {
            match event {
                Event::Estimate(_, document) => document.daemon = Some(daemon.to_string()),
                Event::Alarm(_, document) => document.daemon = Some(daemon.to_string()),
                Event::GapRequest(request) => request.daemon = Some(daemon.clone()),
                Event::Request(_) | Event::Window(..) | Event::State(..) | Event::Gap(..) => {}
            }
        }
    }

    /// Adopts new settings, and returns the loops whose own settings differ. A loop that is no longer configured continues
    /// unchanged, also over further edits, until the caller forgets it. The recording must begin a new file here, under these
    /// settings. Equal settings change nothing.
    pub fn reconfigure(&mut self, settings: EngineSettings) -> Vec<LoopId> {
        let origin = |s: &EngineSettings| (s.config_hash.clone(), s.origins.clone());
        if origin(&settings) == origin(&self.settings) {
            return Vec::new();
        }
        let before = std::mem::replace(&mut self.settings, settings);
        let was_removed = |name: &str| before.own.contains_key(name) && !self.settings.own.contains_key(name);
        let mut changed = Vec::new();
        for id in self.ids() {
            let Some(one) = self.loops[id.index()].as_mut() else { continue };
            one.removed |= was_removed(&one.name);
            if !one.removed && one.take_settings(self.settings.of(&one.name).clone()) {
                changed.push(id);
            }
        }
        self.own_absent = self.settings.own.keys().filter(|name| !self.by_name.contains_key(name.as_str())).count();
        changed
    }

    /// The settings in force.
    #[must_use]
    pub const fn engine_settings(&self) -> &EngineSettings {
        &self.settings
    }

    /// A loop's settings.
    #[must_use]
    pub fn settings(&self, id: LoopId) -> &Arc<LoopSettings> {
        &self.of(id).settings
    }

    /// The history for a window that ends at a stamp, or at the newest sample. `None` before the first sample.
    #[must_use]
    pub fn snapshot(&self, id: LoopId, end_ns: Option<i64>) -> Option<Snapshot> {
        self.of(id).snapshot(end_ns)
    }

    /// A loop's figures.
    #[must_use]
    pub fn figures(&self, id: LoopId) -> LoopFigures {
        self.of(id).figures()
    }
}
