//! The core of the daemon: one state machine per loop, told the time and handed the data.
//!
//! [`Engine::push`] takes a sample, [`Engine::complete`] the answer to a request, [`Engine::command`] a person's command;
//! each puts [`Event`]s out. There is no clock, thread or file below here, and no window is cut or fitted inline: a due
//! window leaves as a [`Request`] with a snapshot of the loop's history, and whoever drives the engine computes it. Answers are consumed per
//! loop in the order of the windows, so everything after them depends on that order and on event time alone.
//! Gap diagnoses leave as separate [`GapRequest`]s; see [`gaps`] for when.

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
use stiction::core::signal::align::{AlignCounts, Aligner};
use stiction::core::verdict::EstimateDocument;

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
    /// Its place among the loops; a loop that comes after another has left may get the other's.
    #[must_use]
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

/// What the engine puts out, in order.
#[derive(Debug, Clone)]
pub enum Event {
    /// Compute this and hand the answer back.
    Request(Box<Request>),
    /// A window and what it says by itself, to be compared with those of other loops.
    Window(LoopId, Box<LoopWindow>),
    /// An estimate to publish and record.
    Estimate(LoopId, Box<EstimateDocument>),
    /// A change of an alarm to publish, record and log.
    Alarm(LoopId, Box<AlarmDocument>),
    /// The loop's memory after a window, to record.
    State(LoopId, Box<StateDocument>),
    /// Compute this when nothing else waits, and hand the answer back.
    GapRequest(Box<GapRequest>),
    /// A gap diagnosis to publish and record.
    Gap(LoopId, Box<PublishedGap>),
}

/// Why a due window got no fit, or a gap no diagnosis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SkipReason {
    /// The machine was too busy.
    QueueFull,
    /// The daemon stopped before it was done.
    Shutdown,
    /// It broke off or found no answer; its message is in the log.
    Failed,
}

/// Figures of a loop for health documents.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoopFigures {
    /// What was dropped or put in.
    pub counts: AlignCounts,
    /// Greatest source time, ns.
    pub greatest_ns: Option<i64>,
    /// Windows that came due.
    pub windows: u64,
    /// Windows that wait for their answer.
    pub waiting: usize,
}

/// Everything a loop needs to go on in another file, but for its history: see [`Engine::checkpoint`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Checkpoint {
    /// The alarm and its memory.
    pub alarm: Alarm,
    /// What is usual of the loop, and the model that its gap is measured from.
    #[serde(default)]
    pub gap: GapWatch,
    /// What its group last said of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub group: Option<GroupStanding>,
    /// Samples on their way into the history, and what is held. Absent at the start of a run.
    pub stream: Option<StreamState>,
}

/// Progress of a loop's stream of points.
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
    /// End of the last window that the run before took.
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

    /// Windows that had come due.
    #[must_use]
    pub const fn windows(&self) -> u64 {
        self.windows
    }

    /// Those of them that had no answer yet.
    #[must_use]
    pub const fn waiting(&self) -> u64 {
        self.waiting
    }
}

/// All loops of a daemon.
#[derive(Debug)]
pub struct Engine {
    settings: EngineSettings,
    /// Loops with `[[loop]]` settings that have not appeared: their places are kept.
    own_absent: usize,
    /// By handle; none where a loop was forgotten.
    loops: Vec<Option<Box<LoopState>>>,
    by_name: HashMap<Arc<str>, LoopId>,
    /// Handles of loops that were forgotten: the next loops get them.
    free: BTreeSet<LoopId>,
    /// Memory of loops that are not there, for when they come back: of forgotten ones where the alarm is not at rest.
    left: HashMap<Arc<str>, Checkpoint>,
    /// Stands in for a loop that was forgotten: whoever still has its handle finds nothing.
    nobody: Box<LoopState>,
}

impl Engine {
    /// An engine without loops; those with `[[loop]]` settings appear with their first sample, as others do.
    #[must_use]
    pub fn new(settings: EngineSettings) -> Self {
        let nobody = Box::new(LoopState::new("".into(), settings.common[0].clone()));
        let (loops, by_name, free, left) = (Vec::new(), HashMap::new(), BTreeSet::new(), HashMap::new());
        Self { own_absent: settings.own.len(), settings, loops, by_name, free, left, nobody }
    }

    /// The same engine under a daemon's id, which its documents carry.
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

    /// The handles of loops from this place up to that one.
    pub fn ids_in(&self, from: usize, to: usize) -> impl ExactSizeIterator<Item = LoopId> + use<> {
        let to = to.min(self.loops.len());
        let there = (from.min(to)..to).filter(|index| self.loops[*index].is_some());
        there.map(|index| LoopId(index as u32)).collect::<Vec<LoopId>>().into_iter()
    }

    /// Loops that there are.
    #[must_use]
    pub fn count(&self) -> usize {
        self.by_name.len()
    }

    /// Places of loops, free ones included: one more than the greatest handle's.
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

    /// The handle of a loop, which appears now if it is new; `None` beyond `max_loops`. Loops with settings of their own
    /// always have their place, whoever came before them.
    pub fn appear(&mut self, name: &str) -> Option<LoopId> {
        self.has_place_for(name).then(|| self.appear_anyway(name))
    }

    /// The same whether or not there is room: for a loop that is let go again at once.
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

    /// Keeps the memory of a loop that is not there until it comes. Gives its alarm's document where that is not at rest.
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

    /// Takes a loop over from an engine under whose settings its window was the same, with its history, into one of these places: alarm and gap
    /// watch begin anew, and what was on its way is given up. `None` where there is no such loop, or no place for it.
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

    /// Whether a loop is there, or may appear.
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

    /// Lets a loop that has left the plant leave the memory; says whether it did. One that something waits for stays. The
    /// handle goes to the next loop that appears: whoever kept it must forget it too.
    /// An alarm that is not at rest is kept, and the loop has it again when it comes back; all else begins anew. The
    /// recording must hold it as an input.
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

    /// Whether nothing of a loop is on its way: it may be forgotten.
    #[must_use]
    pub fn is_idle(&self, id: LoopId) -> bool {
        self.of(id).is_idle()
    }

    /// Loops that were forgotten with an alarm that is not at rest, and what is kept of them.
    pub fn left(&self) -> impl Iterator<Item = (&Arc<str>, &Checkpoint)> {
        self.left.iter()
    }

    /// Whether a loop was forgotten with an alarm that is not at rest.
    #[must_use]
    pub fn has_left(&self, name: &str) -> bool {
        self.left.contains_key(name)
    }

    /// Bytes that a loop takes, but for what all loops share and for windows on their way.
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

    /// Gives a due window up. Its document says so; the recording must hold the skip as an input.
    pub fn skip(&mut self, id: LoopId, seq: u64, out: &mut Vec<Event>) {
        let (from, hash) = (out.len(), self.settings.origin_of(&self.of(id).name));
        self.of_mut(id).resolve(id, seq, None, &hash, out);
        self.sign(&mut out[from..]);
    }

    /// Windows of a loop that wait for their answers, oldest first: place and name.
    pub fn waiting(&self, id: LoopId) -> impl Iterator<Item = (u64, i64)> + '_ {
        self.of(id).waiting()
    }

    /// Asks for a diagnosis of a loop as it is now, in the name of a person; gives its number. With `pool` the cause is decided
    /// from earlier diagnoses, too; the recording must hold their windows as an input.
    ///
    /// # Errors
    /// [`GapRefusal`] where too little is held of the loop.
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

    /// Takes a diagnosis. It is put out once those asked before it are done.
    pub fn complete_gap(&mut self, id: LoopId, number: u64, document: PublishedGap, out: &mut Vec<Event>) {
        self.of_mut(id).resolve_gap(id, number, Some(document), out);
    }

    /// Gives a diagnosis up; the recording must hold the skip as an input. One that found no place is asked again by
    /// the loop's next departing window.
    pub fn skip_gap(&mut self, id: LoopId, number: u64, reason: SkipReason, out: &mut Vec<Event>) {
        self.of_mut(id).skip_gap(id, number, reason, out);
    }

    /// Diagnoses of a loop that wait for their answers, oldest first.
    pub fn gaps_waiting(&self, id: LoopId) -> impl Iterator<Item = u64> + '_ {
        self.of(id).gaps_waiting()
    }

    /// Takes what a loop's group says of it, or that it is in none any more; the recording must hold it as an input.
    pub fn stand(&mut self, id: LoopId, standing: Option<GroupStanding>) {
        self.of_mut(id).group = standing;
    }

    /// Whether the stiction alarm of a loop is shown as active, or its newest window counts towards raising it.
    #[must_use]
    pub fn alarms(&self, name: &str) -> bool {
        self.find(name).is_some_and(|id| self.of(id).alarm.is_active_or_near())
    }

    /// Ends the alarm of a loop that the configuration names no longer; none where it is at rest. The recording must hold it
    /// as an input.
    pub fn end_alarm(&mut self, id: LoopId) -> Option<AlarmDocument> {
        let document = self.of_mut(id).end_alarm();
        document.map(|document| self.signed(document))
    }

    /// Carries out a person's command.
    ///
    /// # Errors
    /// [`CommandError`] where the command is unknown or does not fit the alarm's state.
    pub fn command(&mut self, id: LoopId, command: &Command) -> Result<AlarmDocument, CommandError> {
        let document = self.of_mut(id).command(command)?;
        Ok(self.signed(document))
    }

    /// The state to write at the start of a file.
    #[must_use]
    pub fn checkpoint(&self, id: LoopId) -> Checkpoint {
        self.of(id).checkpoint()
    }

    /// Takes a state over: the alarm always, the stream where the checkpoint holds one. The history that is there stays if
    /// it is the stream's.
    /// Gives back the alarm's document where it is not at rest.
    pub fn restore(&mut self, id: LoopId, checkpoint: Checkpoint) -> Option<AlarmDocument> {
        let document = self.of_mut(id).restore(checkpoint);
        document.map(|document| self.signed(document))
    }

    /// Takes over what windows left behind, without the stream: as at the start of the file that is verified.
    pub fn restore_memory(&mut self, id: LoopId, checkpoint: Checkpoint) {
        let of = self.of_mut(id);
        (of.alarm, of.gap, of.group) = (checkpoint.alarm, checkpoint.gap, checkpoint.group);
    }

    /// The alarm's document, under this daemon's name.
    fn signed(&self, document: AlarmDocument) -> AlarmDocument {
        AlarmDocument { daemon: self.settings.daemon.as_deref().map(str::to_owned), ..document }
    }

    /// Puts this daemon's name on events.
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

    /// Takes other settings over, and gives the loops whose own differ. A loop that was named and is named no longer goes on
    /// as it was, over further edits too: whoever drives the engine lets it go. The recording must begin a new file here, under
    /// these settings. Settings that are equal change nothing.
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

    /// The history from which a window would be cut that ended at a stamp, or with the newest sample. `None` before the
    /// first sample.
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
