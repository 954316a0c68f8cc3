//! Re-runs the engine on recordings, by the same code as the live daemon; only the order of the inputs comes from the file.
//!
//! A recorded estimate marks the point at which the live engine took that window's answer; replay computes the answer there.
//! Skips and commands are applied where they were recorded. So the engine sees the same inputs in the same order, however fast
//! the workers were, and must give the same documents.

pub mod parallel;
mod plant;

use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, bail};
use serde::Deserialize;

use super::gaps::Until;
use crate::daemon::startup_state::memory::{RunFile, is_recording};
use crate::daemon::to_json;
use stiction::core::record::Sample;
use stiction_engine::alarm::AlarmDocument;
use stiction_engine::codec::decode_recorded;
use stiction_engine::codec::topic::{Kind, Leaf, Topic};
use stiction_engine::config::Config;
use stiction_engine::engine::{
    Checkpoint, Engine, EngineSettings, Event, GapRequest, LoopId, LoopWindow, RecordedInput, RecordedNeighbour,
    Request, SkipReason, StateDocument,
};
use stiction_files::run::{REFILLED_FROM, RunMetadata};
use stiction_files::{Item, RecordingReader};

/// A document produced by replay.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Output {
    /// The loop's name.
    pub loop_name: String,
    /// Its kind: estimate, alarm, gap, or the loop's memory after one of them.
    pub kind: Kind,
    /// Its JSON, byte for byte.
    pub json: Vec<u8>,
}

/// An event of one loop, for the comparison of all loops.
#[derive(Debug)]
pub enum PlantEvent {
    /// A window to compare.
    Window(Arc<str>, Box<LoopWindow>),
    /// The loop left.
    Left(Arc<str>),
}

/// An engine fed with recorded messages.
pub struct Replay {
    engine: Engine,
    /// The previous run's loops, when a file starts a new run.
    before: Option<Engine>,
    /// Whether windows are cut but not computed, and results passed over, so that only the loops' streams advance.
    streams_alone: bool,
    /// Whether only samples and commands of the file are used: windows start empty and are judged again.
    judging: bool,
    /// Each loop's newest recorded answer, if only the streams advance.
    newest: BTreeMap<String, Vec<u8>>,
    /// Requests that wait for their place in the recording, per loop.
    waiting: HashMap<LoopId, VecDeque<Request>>,
    /// Position of each loop among its windows.
    places: HashMap<LoopId, WindowCursor>,
    /// Diagnoses that wait for their place, per loop, and the evaluations after which their search ended.
    gaps: HashMap<LoopId, VecDeque<(GapRequest, Option<u64>)>>,
    /// Whether diagnoses are computed again. No other result depends on them, so they can be skipped on the way to a file.
    diagnose: bool,
    /// Whether each request is computed at once, for recordings without results.
    at_once: bool,
    events: Vec<Event>,
    for_plant: Vec<PlantEvent>,
}

/// Finds the window of a recorded estimate. The end of the window is not enough: history that is played twice has each end
/// twice. Estimates are in the order of their windows, one for each, whether skipped or not.
#[derive(Debug, Default)]
struct WindowCursor {
    /// The window of the next estimate.
    next: u64,
    /// Windows before this one came due before the replay began and are not available.
    first: u64,
    /// Skipped windows whose estimates have not come yet.
    skipped: BTreeSet<u64>,
}

/// The window in a recorded estimate or gap; replay needs nothing else of it.
#[derive(Deserialize)]
struct Marker {
    window: MarkerWindow,
}

#[derive(Deserialize)]
struct MarkerWindow {
    end_ns: i64,
}

/// Every recorded message passed all limits when it was recorded.
fn unlimited(settings: EngineSettings) -> EngineSettings {
    EngineSettings { max_loops: usize::MAX, ..settings }
}

fn engine_of(settings: EngineSettings) -> Engine {
    Engine::new(unlimited(settings))
}

impl Replay {
    /// A replay under these engine settings. `at_once` is for recordings without results.
    #[must_use]
    pub fn new(settings: EngineSettings, at_once: bool) -> Self {
        Self {
            engine: engine_of(settings),
            before: None,
            streams_alone: false,
            judging: false,
            newest: BTreeMap::new(),
            waiting: HashMap::new(),
            places: HashMap::new(),
            gaps: HashMap::new(),
            diagnose: true,
            at_once,
            events: Vec::new(),
            for_plant: Vec::new(),
        }
    }

    /// Whether to replay only samples, and pass over the windows and results of the following files.
    pub const fn set_streams_alone(&mut self, streams_alone: bool) {
        self.streams_alone = streams_alone;
    }

    /// Whether to use only samples and commands of the following files.
    pub const fn set_judging(&mut self, judging: bool) {
        self.judging = judging;
    }

    /// The newest recorded answer of each loop, as JSON.
    pub fn take_newest(&mut self) -> BTreeMap<String, Vec<u8>> {
        std::mem::take(&mut self.newest)
    }

    /// Starts the replay under these settings.
    pub fn begin(&mut self, settings: EngineSettings) {
        self.engine = engine_of(settings);
    }

    /// A file starts another run under these settings; of the previous run's loops, those named in its head continue.
    pub fn begin_run(&mut self, settings: EngineSettings) {
        self.before = Some(std::mem::replace(&mut self.engine, engine_of(settings)));
        self.waiting.clear();
        self.places.clear();
        self.gaps.clear();
    }

    /// The next file was recorded after an edit of the configuration, which is applied here.
    pub fn edit(&mut self, settings: EngineSettings) {
        self.engine.reconfigure(unlimited(settings));
    }

    /// The engine in its current state.
    #[must_use]
    pub fn into_engine(self) -> Engine {
        self.engine
    }

    /// Whether to compute the gap diagnoses of the following files again, or only to keep track of their places.
    pub const fn set_diagnose(&mut self, diagnose: bool) {
        self.diagnose = diagnose;
    }

    /// Events for the comparison of all loops since the last call.
    pub fn drain_for_plant(&mut self) -> impl Iterator<Item = PlantEvent> + '_ {
        self.for_plant.drain(..)
    }

    /// Takes one message from the file.
    ///
    /// # Errors
    /// The payload does not match its topic.
    pub fn take(&mut self, topic: &Topic<'_>, data: &[u8], out: &mut Vec<Output>) -> anyhow::Result<()> {
        if let Leaf::Raw(signal) = topic.leaf {
            self.take_sample(topic.loop_name, decode_recorded(signal, data)?, out);
            return Ok(());
        }
        let Some(id) = self.engine.appear(topic.loop_name) else { return Ok(()) };
        match topic.leaf {
            Leaf::Document(Kind::Estimate) if self.streams_alone => {
                self.newest.insert(topic.loop_name.to_owned(), data.to_vec());
            }
            Leaf::Document(kind) if (self.streams_alone || self.judging) && kind != Kind::Input => {}
            Leaf::Document(Kind::Estimate) if !self.at_once => {
                let marker: Marker = serde_json::from_slice(data).context("a recorded estimate names no window")?;
                self.answer(id, marker.window.end_ns);
            }
            Leaf::Document(Kind::Gap) if !self.at_once => self.diagnose_next(id),
            Leaf::Document(Kind::Input) => {
                self.handle(id, serde_json::from_slice(data).context("a recorded input")?, out)?;
            }
            Leaf::Raw(_) | Leaf::Document(_) => {}
        }
        self.sort_events(out);
        Ok(())
    }

    /// Takes one sample of a loop.
    pub fn take_sample(&mut self, loop_name: &str, sample: Sample, out: &mut Vec<Output>) {
        let Some(id) = self.engine.appear(loop_name) else { return };
        self.engine.push(id, sample, &mut self.events);
        self.sort_events(out);
    }

    /// Applies an input that came from outside, from people or timing, at the point where it was recorded.
    fn handle(&mut self, id: LoopId, input: RecordedInput, out: &mut Vec<Output>) -> anyhow::Result<()> {
        match input {
            // Skipped windows and group answers belong to the recorded run, not to this one.
            other if self.judging && !matches!(other, RecordedInput::Command(_)) => {}
            RecordedInput::Command(_) | RecordedInput::GapRun { .. } | RecordedInput::Removed if self.streams_alone => {
            }
            RecordedInput::Skip { seq, .. } => {
                self.waiting.entry(id).or_default().retain(|r| r.seq != seq);
                self.places.entry(id).or_default().skipped.insert(seq);
                self.engine.skip(id, seq, &mut self.events);
            }
            RecordedInput::Command(command) => {
                if let Ok(document) = self.engine.command(id, &command) {
                    self.put_alarm(id, &document, out);
                }
            }
            RecordedInput::GapRun { by, .. } => {
                // A recorded run had not been refused.
                let _ = self.engine.run_gap(id, by.as_deref(), false, &mut self.events);
            }
            RecordedInput::GapNeighbours { number, neighbours } => {
                if let Some((request, _)) = self.waiting_gap(id, number) {
                    request.neighbours = neighbours.iter().map(RecordedNeighbour::neighbour).collect();
                }
            }
            RecordedInput::GapEarlier { number, windows } => {
                if let Some((request, _)) = self.waiting_gap(id, number) {
                    request.earlier = windows;
                }
            }
            RecordedInput::GapSkip { number, reason } => {
                self.gaps.entry(id).or_default().retain(|(r, _)| r.number != number);
                self.engine.skip_gap(id, number, reason, &mut self.events);
            }
            RecordedInput::Group { standing } => self.engine.stand(id, standing.map(|standing| *standing)),
            // Concerns several loops: not handled in a loop's channel.
            RecordedInput::Comparing { .. } | RecordedInput::Compared { .. } => {}
            RecordedInput::Forget => {
                self.for_plant.push(PlantEvent::Left(self.engine.name(id).clone()));
                self.engine.forget(id);
                self.places.remove(&id);
                self.waiting.remove(&id);
                self.gaps.remove(&id);
            }
            RecordedInput::Removed => {
                if let Some(document) = self.engine.end_alarm(id) {
                    self.put_alarm(id, &document, out);
                }
            }
            RecordedInput::GapCut { number, evaluations } => {
                if let Some((_, cut)) = self.waiting_gap(id, number) {
                    *cut = Some(evaluations);
                }
            }
        }
        Ok(())
    }

    /// A loop's requested but not yet computed diagnosis, with the evaluations after which its search ends.
    fn waiting_gap(&mut self, id: LoopId, number: u64) -> Option<&mut (GapRequest, Option<u64>)> {
        self.gaps.get_mut(&id)?.iter_mut().find(|(request, _)| request.number == number)
    }

    /// Computes the loop's oldest diagnosis, whose recorded document was just read.
    fn diagnose_next(&mut self, id: LoopId) {
        if let Some((request, cut)) = self.gaps.entry(id).or_default().pop_front() {
            self.diagnose(&request, cut);
        }
    }

    fn diagnose(&mut self, request: &GapRequest, cut: Option<u64>) {
        let (id, number) = (request.id, request.number);
        match self.diagnose.then(|| request.compute(&Until(cut))) {
            Some(Ok(document)) => self.engine.complete_gap(id, number, document, &mut self.events),
            // Without an answer there is no document, so a recorded one finds no match.
            Some(Err(_)) | None => self.engine.skip_gap(id, number, SkipReason::Failed, &mut self.events),
        }
    }

    /// Restores the states at the head of a file: in full at the start of the replay and of a run, later without the streams.
    ///
    /// # Errors
    /// A payload is not a state.
    pub fn take_head(&mut self, data: &[u8], everything: bool) -> anyhow::Result<()> {
        if self.judging {
            return Ok(());
        }
        let state: StateDocument = serde_json::from_slice(data).context("a recorded state cannot be read")?;
        if let Some(before) = self.before.as_mut().filter(|_| everything) {
            self.engine.take_loop(before, &state.loop_name, 0..usize::MAX);
        }
        let Some(id) = self.engine.appear(&state.loop_name) else { return Ok(()) };
        if everything {
            let (windows, waiting) = state.checkpoint.stream.as_ref().map_or((0, 0), |s| (s.windows(), s.waiting()));
            let place =
                WindowCursor { next: windows.saturating_sub(waiting), first: windows, skipped: BTreeSet::new() };
            self.places.insert(id, place);
            self.engine.restore(id, state.checkpoint);
        } else {
            self.engine.restore_memory(id, state.checkpoint);
        }
        Ok(())
    }

    /// Computes the answer to the window of a recorded estimate.
    fn answer(&mut self, id: LoopId, end_ns: i64) {
        let place = self.places.entry(id).or_default();
        let seq = place.next;
        place.next += 1;
        if place.skipped.remove(&seq) || seq < place.first {
            return;
        }
        let Some(waiting) = self.waiting.get_mut(&id) else { return };
        let exact = waiting.iter().position(|r| r.seq == seq && r.end_ns == end_ns);
        // Older recordings do not say how many windows were unanswered when they begin.
        let Some(at) = exact.or_else(|| waiting.iter().position(|r| r.end_ns == end_ns)) else { return };
        if let Some(request) = waiting.remove(at) {
            place.next = request.seq + 1;
            self.engine.complete(id, request.seq, request.compute(), &mut self.events);
        }
    }

    fn sort_events(&mut self, out: &mut Vec<Output>) {
        while !self.events.is_empty() {
            for event in std::mem::take(&mut self.events) {
                match event {
                    Event::Request(request) if self.streams_alone => {
                        self.engine.skip(request.id, request.seq, &mut self.events);
                    }
                    _ if self.streams_alone => {}
                    Event::Request(request) if self.at_once => {
                        self.engine.complete(request.id, request.seq, request.compute(), &mut self.events);
                    }
                    Event::GapRequest(request) if self.at_once => self.diagnose(&request, None),
                    Event::GapRequest(request) => {
                        self.gaps.entry(request.id).or_default().push_back((*request, None));
                    }
                    Event::Gap(id, document) => out.extend(self.output(id, Kind::Gap, &document)),
                    Event::Request(request) => self.waiting.entry(request.id).or_default().push_back(*request),
                    Event::Estimate(id, document) => out.extend(self.output(id, Kind::Estimate, &document)),
                    Event::Alarm(id, document) => out.extend(self.output(id, Kind::Alarm, &document)),
                    Event::Window(id, window) => {
                        self.for_plant.push(PlantEvent::Window(self.engine.name(id).clone(), window));
                    }
                    Event::State(id, document) => out.extend(self.output(id, Kind::State, &document)),
                }
            }
        }
    }

    /// Adds an alarm change that belongs to no window, and the loop's memory after it.
    fn put_alarm(&self, id: LoopId, document: &AlarmDocument, out: &mut Vec<Output>) {
        let memory = Checkpoint { stream: None, ..self.engine.checkpoint(id) };
        let state = StateDocument::new(self.engine.name(id), Some(document.changed_ns), memory);
        out.extend(self.output(id, Kind::Alarm, document));
        out.extend(self.output(id, Kind::State, &state));
    }

    fn output(&self, id: LoopId, kind: Kind, document: &impl serde::Serialize) -> Option<Output> {
        Some(Output { loop_name: self.engine.name(id).to_string(), kind, json: to_json(document)? })
    }
}

/// The recordings in a folder, or the one file given, as chains: each inner list is one segment of one run, oldest first.
///
/// # Errors
/// There is no recording.
pub fn chains_of(input: &Path) -> anyhow::Result<Vec<Vec<PathBuf>>> {
    if !input.is_dir() {
        return Ok(vec![vec![input.to_owned()]]);
    }
    let mut files = Vec::new();
    let entries = std::fs::read_dir(input).with_context(|| input.display().to_string())?;
    for path in entries.flatten().map(|e| e.path()).filter(|p| p.is_file() && is_recording(p)) {
        // A file killed before its first flush is empty.
        if path.extension().is_some_and(|e| e == "part") && std::fs::metadata(&path).is_ok_and(|m| m.len() == 0) {
            tracing::warn!(file = %path.display(), "is empty: left out");
            continue;
        }
        let reader = RecordingReader::open(&path)?;
        if let Some(file) = RunFile::of(&path, reader.metadata()) {
            files.push(file);
        } else {
            tracing::warn!(file = %path.display(), "no recording of ours: left out");
        }
    }
    if files.is_empty() {
        bail!("{}: holds no recordings", input.display());
    }
    files.sort_by(|a, b| {
        (a.started_ns, &a.run_id, a.segment, a.index).cmp(&(b.started_ns, &b.run_id, b.segment, b.index))
    });
    let chains = files.chunk_by(|a, b| (&a.run_id, a.segment) == (&b.run_id, b.segment));
    Ok(chains.map(|chain| chain.iter().map(|f| f.path.clone()).collect()).collect())
}

/// The states at the head of a file: for each loop its greatest source time.
pub(super) fn heads(path: &Path, prefix: &str) -> anyhow::Result<BTreeMap<String, Option<i64>>> {
    let mut reader = RecordingReader::open(path)?;
    let mut heads = BTreeMap::new();
    while let Some(message) = reader.next_message()? {
        let Some(topic) = Topic::parse(Some(prefix), message.topic()) else { continue };
        if topic.leaf != Leaf::Document(Kind::State) {
            break;
        }
        let state: StateDocument = serde_json::from_slice(message.data)
            .with_context(|| format!("{}: a recorded state cannot be read", path.display()))?;
        heads.insert(state.loop_name, state.checkpoint.stream.and_then(|s| s.greatest_ns()));
    }
    Ok(heads)
}

/// The loops with samples or results in a file, and the earliest window end of their gap diagnoses; the other loops have no
/// window in the file.
fn loops_with_windows(path: &Path, prefix: &str) -> anyhow::Result<BTreeMap<String, Option<i64>>> {
    let mut reader = RecordingReader::open(path)?;
    let mut loops: BTreeMap<String, Option<i64>> = BTreeMap::new();
    // Samples add nothing to what their channel shows, so each channel is checked once.
    let mut seen = BTreeSet::new();
    while let Some(item) = reader.next_item()? {
        let (id, channel) = item.channel();
        if !seen.insert(id) && channel.kind != Some(Kind::Gap) {
            continue;
        }
        let Some(topic) = Topic::parse(Some(prefix), &channel.topic) else { continue };
        match topic.leaf {
            Leaf::Document(Kind::Gap) => {
                let Item::Message(message) = item else { continue };
                let marker: Marker = serde_json::from_slice(message.data).context("a recorded gap names no window")?;
                let earliest = loops.entry(topic.loop_name.to_owned()).or_default();
                *earliest = Some(earliest.map_or(marker.window.end_ns, |e| e.min(marker.window.end_ns)));
            }
            Leaf::Raw(_) | Leaf::Document(Kind::Estimate) if !loops.contains_key(topic.loop_name) => {
                loops.insert(topic.loop_name.to_owned(), None);
            }
            _ => {}
        }
    }
    Ok(loops)
}

/// The loops whose windows continue into a chain of files, each with the greatest source time up to which earlier data is
/// needed.
fn loops_that_go_on(chain: &[PathBuf], prefix: &str) -> anyhow::Result<BTreeMap<String, Option<i64>>> {
    let Some(first) = chain.first() else { return Ok(BTreeMap::new()) };
    let mut alive: BTreeMap<String, Option<i64>> = BTreeMap::new();
    // A loop without samples in the first file may have waiting ones that are sent in a later file.
    for file in chain {
        for (name, earliest) in loops_with_windows(file, prefix)? {
            let of = alive.entry(name).or_default();
            *of = of.iter().copied().chain(earliest).min();
        }
    }
    let mut own = heads(first, prefix)?;
    own.retain(|name, _| alive.contains_key(name));
    // A diagnosis may concern a window long before the file that contains it.
    for (name, greatest) in &mut own {
        *greatest = greatest.map(|g| alive.get(name).copied().flatten().map_or(g, |end_ns| g.min(end_ns)));
    }
    Ok(own)
}

/// The files that must be read before a chain, so that its windows are complete; oldest first.
///
/// # Errors
/// Names the missing file.
pub fn files_before(chain: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let Some(path) = chain.first() else { return Ok(Vec::new()) };
    let metadata = RunMetadata::of(path, RecordingReader::open(path)?.metadata())?;
    if metadata.previous.is_empty() {
        return Ok(Vec::new());
    }
    let own = loops_that_go_on(chain, &metadata.prefix)?;
    let reach_ns = reach_ns(&metadata.config);
    let mut files = Vec::new();
    let (mut previous, mut refilled_from) = (metadata.previous.clone(), metadata.refilled_from.clone());
    while !previous.is_empty() {
        let Some(file) = neighbour(path, &previous) else {
            let gone = path.with_file_name(&previous);
            bail!("{}: missing; the windows of {} reach back into it", gone.display(), path.display());
        };
        let earlier = heads(&file, &metadata.prefix)?;
        let far_enough =
            own.iter().filter_map(|(name, greatest)| greatest.map(|g| (name, g))).all(|(name, greatest)| {
                // A loop that had not appeared yet needs nothing from earlier files.
                earlier.get(name).copied().flatten().is_none_or(|g| greatest.saturating_sub(g) >= reach_ns)
            });
        let is_first = previous == refilled_from;
        let reader = RecordingReader::open(&file)?;
        let get = |key: &str| reader.metadata().get(key).cloned().unwrap_or_default();
        previous = get("previous");
        if !get(REFILLED_FROM).is_empty() {
            refilled_from = get(REFILLED_FROM);
        }
        files.push(file);
        if far_enough || is_first {
            break;
        }
    }
    files.reverse();
    Ok(files)
}

/// How far the windows of any loop may reach back, ns.
pub(super) fn reach_ns(config: &Config) -> i64 {
    let windows = config.loops.iter().map(|l| l.window).chain([config.window]);
    let reach_s = windows.map(|w| 1.05 * w.max_window_s + 2.0 * w.hop_s + w.lateness_s).fold(0.0, f64::max);
    stiction::core::units::ns_from_s(reach_s)
}

/// The recording of this name in the same folder, finished or not; `None` for an empty name.
pub(super) fn neighbour(path: &Path, name: &str) -> Option<PathBuf> {
    [path.with_file_name(name), path.with_file_name(format!("{name}.part"))].into_iter().find(|p| p.is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_a_kill_left_empty_is_left_out_and_a_damaged_one_is_an_error() {
        let dir = tempfile::tempdir().unwrap();
        let pairs = [("prefix", "p"), ("run_id", "r"), ("started_ns", "1"), ("shard", "0"), ("file_index", "0")];
        let metadata = pairs.map(|(key, value)| (key.to_owned(), value.to_owned())).into_iter().collect();
        let whole = stiction_files::RecordingFile::create(dir.path(), "a", &metadata).unwrap().finish().unwrap();
        std::fs::write(dir.path().join("b.mcap.part"), b"").unwrap();
        assert_eq!(chains_of(dir.path()).unwrap(), [[whole]]);
        std::fs::write(dir.path().join("c.mcap"), b"").unwrap();
        assert!(chains_of(dir.path()).unwrap_err().to_string().contains("c.mcap"));
    }
}
