//! The core of the daemon: one state machine per loop, told the time and handed the data.
//!
//! [`Engine::push`] takes a sample, [`Engine::complete`] the answer to a request, [`Engine::command`] a person's wish;
//! each puts [`Event`]s out. There is no clock, thread or file below here, and no fit is run inline: a due window
//! leaves as a [`Request`] that holds its record, and whoever drives the engine computes it. Answers are consumed per
//! loop in the order of the windows, so everything after them depends on that order and on event time alone.
//! Gap diagnoses leave as [`GapRequest`]s of their own; see [`gaps`] for when.

pub mod gaps;
mod input;
mod looper;
mod windowing;

use std::collections::HashMap;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::alarm::{Alarm, AlarmDocument, Command, CommandError, Place};
use crate::config::{AlarmParams, Config, GapParams, LoopConfig, WindowParams};
use looper::Loop;
use stiction::record::{Record, Sample};
use stiction::signal::align::{AlignCounts, AlignParams, Aligner, Quality};
use stiction::units::{LoopKind, ns_from_s};
use stiction::verdict::{AssessParams, Assessment, EstimateDocument, assess};

pub use gaps::{GapReason, GapRefusal, GapRequest, GapWatch, PublishedGap};
pub use input::{INPUT_SCHEMA, RecordedInput, STATE_SCHEMA, StateDocument};
pub use windowing::{longest, section, windows};

/// Handle of a loop in one engine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct LoopId(u32);

impl LoopId {
    /// Position in the order in which loops appeared.
    #[must_use]
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

/// Settings of a loop, shared by all loops that say nothing of their own.
#[derive(Debug, Clone, PartialEq)]
pub struct LoopSettings {
    /// How its signals are joined.
    pub align: AlignParams,
    /// Its windows.
    pub window: WindowParams,
    /// Its alarm.
    pub alarm: AlarmParams,
    /// Its estimates.
    pub assess: AssessParams,
    /// Its gap diagnoses.
    pub gap: GapParams,
    /// Where it belongs and what it is worth.
    pub place: Place,
}

impl LoopSettings {
    /// The settings that a configuration gives to a loop; `kind` is what its tag says, over which the configuration rules.
    #[must_use]
    pub fn of(config: &Config, own: Option<&LoopConfig>, kind: LoopKind) -> Self {
        let (window, alarm) = own.map_or((config.window, config.alarm), |l| (l.window, l.alarm));
        Self {
            align: AlignParams {
                lateness_ns: ns_from_s(window.lateness_s),
                max_gap_s: window.max_gap_s,
                quality: if config.input.quality == "classic" { Quality::Classic } else { Quality::Ua },
                modes: config.input.modes.clone(),
            },
            assess: AssessParams {
                min_periods: window.min_periods,
                min_samples_per_period: window.min_samples_per_period,
                op_range: own.and_then(|l| l.op_range),
                kind: own.and_then(|l| l.kind).and_then(LoopKind::from_name).unwrap_or(kind),
                ..AssessParams::default()
            },
            window,
            alarm,
            gap: config.gap,
            place: own.map(place_of).unwrap_or_default(),
        }
    }
}

/// What the configuration says of a loop's place.
fn place_of(own: &LoopConfig) -> Place {
    let said = |text: &String| Some(text.clone()).filter(|text| !text.is_empty());
    // OP that runs from 0 to 100 is in %, whoever wrote the range.
    let percent = (own.op_range == Some([0.0, 100.0])).then(|| "%".to_owned());
    Place {
        criticality: Some(own.criticality),
        area: said(&own.area),
        equipment: said(&own.equipment),
        op_unit: said(&own.op_unit).or(percent),
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
    /// What the estimate is made from.
    pub record: Arc<Record>,
    /// How.
    pub settings: Arc<LoopSettings>,
}

impl Request {
    /// Computes the answer. Depends on the request alone.
    #[must_use]
    pub fn compute(&self) -> Assessment {
        assess(&self.record, &self.settings.assess)
    }
}

/// What the engine puts out, in order.
#[derive(Debug, Clone)]
pub enum Event {
    /// Compute this and hand the answer back.
    Request(Box<Request>),
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
    /// Samples on their way into the history, and what is held. Absent at the start of a run.
    pub stream: Option<StreamState>,
}

/// Where a loop's stream of points stands.
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
    config: Arc<Config>,
    config_hash: Arc<str>,
    /// Settings of loops that the configuration does not name, by what their tags say they control.
    common: [Arc<LoopSettings>; LoopKind::ALL.len()],
    loops: Vec<Loop>,
    by_name: HashMap<Arc<str>, LoopId>,
    /// Loops that the configuration names and that have not appeared, with their place there: their places are kept.
    expected: HashMap<String, usize>,
}

impl Engine {
    /// An engine without loops; the configured ones appear with their first sample, as discovered ones do.
    #[must_use]
    pub fn new(config: Config) -> Self {
        let common = LoopKind::ALL.map(|kind| Arc::new(LoopSettings::of(&config, None, kind)));
        let config_hash = config.hash().into();
        let expected = config.loops.iter().enumerate().map(|(at, l)| (l.name.clone(), at)).collect();
        Self { config: Arc::new(config), config_hash, common, loops: Vec::new(), by_name: HashMap::new(), expected }
    }

    /// The configuration that it runs under.
    #[must_use]
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The configuration's hash, as documents carry it.
    #[must_use]
    pub fn config_hash(&self) -> &str {
        &self.config_hash
    }

    /// Every loop's handle, in order of appearance.
    pub fn ids(&self) -> impl ExactSizeIterator<Item = LoopId> + use<> {
        (0..self.loops.len()).map(|index| LoopId(index as u32))
    }

    /// A loop's name.
    #[must_use]
    pub fn name(&self, id: LoopId) -> &Arc<str> {
        &self.loops[id.index()].name
    }

    /// The handle of a loop that has appeared.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<LoopId> {
        self.by_name.get(name).copied()
    }

    /// The handle of a loop, which appears now if it is new; `None` beyond `max_loops`. Loops that the configuration
    /// names always have their place, whoever came before them.
    pub fn appear(&mut self, name: &str) -> Option<LoopId> {
        if let Some(id) = self.find(name) {
            return Some(id);
        }
        let kept = if self.expected.contains_key(name) { 0 } else { self.expected.len() };
        if self.loops.len() + kept >= self.config.input.max_loops {
            return None;
        }
        let own = self.expected.remove(name).and_then(|at| self.config.loops.get(at));
        let kind = LoopKind::of_tag(name);
        let common = || self.common[kind as usize].clone();
        let settings = own.map_or_else(common, |l| Arc::new(LoopSettings::of(&self.config, Some(l), kind)));
        let id = LoopId(self.loops.len() as u32);
        let name: Arc<str> = name.into();
        self.loops.push(Loop::new(name.clone(), settings));
        self.by_name.insert(name, id);
        Some(id)
    }

    /// Whether a loop that the configuration does not name may still appear.
    #[must_use]
    pub fn has_room(&self) -> bool {
        self.loops.len() + self.expected.len() < self.config.input.max_loops
    }

    /// Takes one sample of a loop.
    pub fn push(&mut self, id: LoopId, sample: Sample, out: &mut Vec<Event>) {
        self.loops[id.index()].push(id, sample, out);
    }

    /// Takes the answer to a request.
    pub fn complete(&mut self, id: LoopId, seq: u64, assessment: Assessment, out: &mut Vec<Event>) {
        self.loops[id.index()].resolve(id, seq, Some(assessment), &self.config_hash, out);
    }

    /// Gives a due window up. Its document says so; the recording must hold the skip as an input.
    pub fn skip(&mut self, id: LoopId, seq: u64, out: &mut Vec<Event>) {
        self.loops[id.index()].resolve(id, seq, None, &self.config_hash, out);
    }

    /// Windows of a loop that wait for their answers, oldest first: place and name.
    pub fn waiting(&self, id: LoopId) -> impl Iterator<Item = (u64, i64)> + '_ {
        self.loops[id.index()].waiting()
    }

    /// Asks for a diagnosis of a loop as it is now, in the name of a person; gives its number.
    ///
    /// # Errors
    /// [`GapRefusal`] where too little is held of the loop.
    pub fn run_gap(&mut self, id: LoopId, by: Option<&str>, out: &mut Vec<Event>) -> Result<u64, GapRefusal> {
        self.loops[id.index()].run_gap(id, by, &self.config_hash, out)
    }

    /// Takes a diagnosis. It is put out once those asked before it are done.
    pub fn complete_gap(&mut self, id: LoopId, number: u64, document: PublishedGap, out: &mut Vec<Event>) {
        self.loops[id.index()].resolve_gap(id, number, Some(document), out);
    }

    /// Gives a diagnosis up; the recording must hold the skip as an input. One that found no place is asked again by
    /// the loop's next departing window.
    pub fn skip_gap(&mut self, id: LoopId, number: u64, reason: SkipReason, out: &mut Vec<Event>) {
        self.loops[id.index()].skip_gap(id, number, reason, out);
    }

    /// Diagnoses of a loop that wait for their answers, oldest first.
    pub fn gaps_waiting(&self, id: LoopId) -> impl Iterator<Item = u64> + '_ {
        self.loops[id.index()].gaps_waiting()
    }

    /// Carries out a person's command.
    ///
    /// # Errors
    /// [`CommandError`] where the command is unknown or does not fit the alarm's state.
    pub fn command(&mut self, id: LoopId, command: &Command) -> Result<AlarmDocument, CommandError> {
        self.loops[id.index()].command(command)
    }

    /// The state to write at the start of a file.
    #[must_use]
    pub fn checkpoint(&self, id: LoopId) -> Checkpoint {
        self.loops[id.index()].checkpoint()
    }

    /// Takes a state over: the alarm always, the stream where the checkpoint holds one.
    /// Gives back the alarm's document where it is not at rest.
    pub fn restore(&mut self, id: LoopId, checkpoint: Checkpoint) -> Option<AlarmDocument> {
        self.loops[id.index()].restore(checkpoint)
    }

    /// Takes over what windows left behind, without the stream: as at the start of the file that is verified.
    pub fn restore_memory(&mut self, id: LoopId, checkpoint: Checkpoint) {
        let of = &mut self.loops[id.index()];
        (of.alarm, of.gap) = (checkpoint.alarm, checkpoint.gap);
    }

    /// A loop's settings.
    #[must_use]
    pub fn settings(&self, id: LoopId) -> &Arc<LoopSettings> {
        &self.loops[id.index()].settings
    }

    /// A loop's figures.
    #[must_use]
    pub fn figures(&self, id: LoopId) -> LoopFigures {
        self.loops[id.index()].figures()
    }
}
