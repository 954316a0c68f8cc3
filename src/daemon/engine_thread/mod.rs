//! The engine's thread. It takes what arrives in order, and no other thread touches the engine.
//!
//! A sample passes four stages before the engine: `source` takes the message off the bus and bounds the queue, [`router`] finds
//! its loop and decodes it, [`super::limits`] refuses what is too fast or too far ahead, and the recorder keeps it. [`outputs`]
//! passes on what the engine produces. The thread never waits for a fit or for the bus, whose readers and requests have their
//! own threads; it waits briefly for the recorder (see [`crate::daemon::sink::recorder`]).

mod asked;
mod edit;
mod outputs;
mod plant;
mod report;
mod router;
mod sweep;
#[cfg(test)]
mod tests;
mod windows;

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, never, select, tick};
use prometheus_client::metrics::counter::Counter;
use sd_notify::NotifyState;

use super::bundles::Bundles;
use super::command_policy::CommandPolicy;
use super::feeds::Feeds;
use super::gaps::Diagnoser;
use super::limits::Limits;
use super::plant::Comparer;
use super::routes::Routes;
use super::schedule::Schedule;
use super::senders::Senders;
use super::worker::{Answered, Job, Workers};
use crate::daemon::replay::parallel::LastSeen;
use crate::daemon::sink::deliver::Outbox;
use crate::daemon::sink::recorder::Recorder;
use crate::daemon::sink::state_writer::StateWriter;
use crate::daemon::sink::zenoh::Publisher;
use crate::daemon::source::Message;
use crate::daemon::source::shares::Shares;
use crate::daemon::startup_state::memory::Memories;
use crate::runtime::clock::Clock;
use crate::runtime::control::{Answer, Control};
use crate::runtime::faults::Faults;
use crate::runtime::health::HealthSnapshot;
use crate::runtime::metrics::Metrics;
use crate::runtime::overview::Overview;
use crate::runtime::queue::Budget;
use crate::runtime::series::LoopMetrics;
use stiction::core::record::Sample;
use stiction::core::units::s_from_ns;
use stiction_engine::alarm::State;
use stiction_engine::codec::ConfiguredCodec;
use stiction_engine::codec::topic::Kind;
use stiction_engine::config::Config;
use stiction_engine::engine::{Engine, Event, LoopId, SkipReason};

/// Messages taken before the other channels are checked again.
const BATCH: usize = 256;
/// Requests taken before the next batch of samples.
const REQUESTS: usize = 64;
/// Time limit of a batch: one message may hold a hundred thousand samples.
const BATCH_WITHIN: Duration = Duration::from_millis(20);
/// How long a stopping daemon still processes what has already arrived.
const DRAIN: Duration = Duration::from_secs(1);

/// Everything the engine's thread owns.
pub struct EngineThread {
    config: Arc<Config>,
    inputs: Inputs,
    loops: Loops,
    outputs: Outputs,
    metrics: Arc<Metrics>,
    faults: Arc<Faults>,
    daemon_id: String,
    clock: Clock,
    started: Instant,
    health_every: Duration,
}

/// Everything that takes a message to its loop or refuses it.
struct Inputs {
    routes: Routes,
    bundles: Bundles,
    feeds: Feeds,
    senders: Senders,
    codec: ConfiguredCodec,
    /// Counters of payloads by codec.
    codec_counters: Vec<(&'static str, Counter)>,
    /// Messages taken.
    taken: u64,
    /// Arrival time of the sample being processed, ns.
    arrival_ns: i64,
    /// Reused buffer for the samples of a message.
    samples: Vec<Sample>,
    limits: Limits,
    /// The last loop with a stamp refused for being ahead of time, and by how much it was ahead, ns.
    ahead: Option<(LoopId, i64)>,
    input_limit: usize,
    budget: Budget,
    warned_quality: bool,
    policy: CommandPolicy,
}

/// The loops, and the work under way for them elsewhere.
struct Loops {
    engine: Engine,
    events: Vec<Event>,
    workers: Workers,
    /// Windows that wait for a worker.
    schedule: Schedule<Job>,
    /// Visits all loops, some at a time.
    sweep: sweep::Sweep,
    registered: sweep::Registered,
    /// Loops removed from the configuration that still have work under way.
    removed: BTreeSet<LoopId>,
    diagnoser: Diagnoser,
    /// Compares the loops with each other; `None` if this is switched off.
    plant: Option<plant::Plant>,
    /// People waiting for a diagnosis, by loop and number.
    asking: HashMap<(LoopId, u64), Vec<Answer>>,
}

/// Consumers of what the engine produces.
struct Outputs {
    recorder: Option<Recorder>,
    state_writer: Option<StateWriter>,
    publisher: Publisher,
    outbox: Option<Outbox>,
    /// Which loops have series in the metrics; `None` if no loop has any.
    board: Option<LoopMetrics>,
    /// The page's data; `None` without a page.
    overview: Option<Overview>,
    snapshot: HealthSnapshot,
    /// Loss counters at the last report.
    losses: [u64; 9],
}

/// Inputs of the engine's thread.
pub struct Parts {
    /// The configuration.
    pub config: Arc<Config>,
    /// The engine, under the same configuration.
    pub engine: Engine,
    /// Byte budget of the input queue, and the share of it that each key may hold.
    pub input: (Budget, Shares),
    /// The workers.
    pub workers: Workers,
    /// The thread that runs gap diagnoses.
    pub diagnoser: Diagnoser,
    /// Compares the loops with each other; `None` if the configuration switches this off.
    pub comparer: Option<Comparer>,
    /// The recorder.
    pub recorder: Option<Recorder>,
    /// Stores the loops' memory; `None` in a demonstration.
    pub state_writer: Option<StateWriter>,
    /// The publisher.
    pub publisher: Publisher,
    /// Sends to receivers outside the bus; `None` if none is configured.
    pub outbox: Option<Outbox>,
    /// The counters.
    pub metrics: Arc<Metrics>,
    /// The faults.
    pub faults: Arc<Faults>,
    /// The page's data; `None` without a page.
    pub overview: Option<Overview>,
    /// Where the health is published.
    pub snapshot: HealthSnapshot,
    /// The daemon's id.
    pub daemon_id: String,
    /// The time.
    pub clock: Clock,
    /// How often the health documents are written.
    pub health_every: Duration,
}

impl EngineThread {
    /// A thread with these parts, not yet started.
    #[must_use]
    pub fn new(parts: Parts) -> Self {
        let config = parts.config.as_ref();
        let (policy, limits) = (CommandPolicy::new(&config.commands), Limits::new(&config.input));
        let board = LoopMetrics::new(config);
        let (budget, shares) = parts.input;
        if let Some(overview) = &parts.overview {
            overview.expect(parts.config.clone(), parts.clock.now(), parts.clock.now_ns());
        }
        let inputs = Inputs {
            routes: Routes::new(config, shares),
            bundles: Bundles::new(config),
            feeds: Feeds::new(config),
            senders: Senders::default(),
            codec: config.input.codec,
            codec_counters: Vec::new(),
            taken: 0,
            arrival_ns: 0,
            samples: Vec::new(),
            limits,
            ahead: None,
            input_limit: config.input.queue,
            budget,
            warned_quality: false,
            policy,
        };
        let loops = Loops {
            engine: parts.engine,
            events: Vec::new(),
            workers: parts.workers,
            schedule: Schedule::default(),
            sweep: sweep::Sweep::default(),
            registered: sweep::Registered::default(),
            removed: BTreeSet::new(),
            diagnoser: parts.diagnoser,
            plant: parts.comparer.map(plant::Plant::new),
            asking: HashMap::new(),
        };
        let outputs = Outputs {
            recorder: parts.recorder,
            state_writer: parts.state_writer,
            publisher: parts.publisher,
            outbox: parts.outbox,
            board,
            overview: parts.overview,
            snapshot: parts.snapshot,
            losses: [0; 9],
        };
        Self {
            inputs,
            loops,
            outputs,
            metrics: parts.metrics,
            faults: parts.faults,
            daemon_id: parts.daemon_id,
            started: parts.clock.now(),
            clock: parts.clock,
            health_every: parts.health_every,
            config: parts.config,
        }
    }

    /// Restores what earlier runs remembered of their loops, and publishes the alarms that are not normal. Loops whose windows
    /// continue already have places; the rest get places in order of their last answer until none are left.
    pub fn restore(&mut self, memories: Memories, last: BTreeMap<String, LastSeen>) {
        let Memories { there, left, removed } = memories;
        let mut there: Vec<_> = there.into_iter().map(|(name, memory)| (name, memory, false)).collect();
        there.sort_by_key(|(_, memory, _)| Reverse(memory.alarm.progress()));
        let left = left.into_iter().map(|(name, memory)| (name, memory, true));
        for (name, memory, has_left) in there.into_iter().chain(left) {
            let id = if has_left { self.loops.engine.find(&name) } else { self.loops.engine.appear(&name) };
            let document = match id {
                Some(id) => self.loops.engine.restore(id, memory),
                None => self.loops.engine.remember(&name, memory),
            };
            if let Some(document) = document {
                self.show_alarm(&document);
                self.publish(&document.loop_name, Kind::Alarm, &document);
            }
        }
        for (name, memory) in removed {
            if memory.alarm.shown() == State::Normal {
                self.outputs.state_writer.iter().for_each(|state_writer| state_writer.forget(&name));
                continue;
            }
            let id = self.loops.engine.appear_anyway(&name);
            self.loops.engine.restore(id, memory);
            self.loops.removed.insert(id);
        }
        self.show_last(last);
    }

    /// Shows when each loop was last heard, so that silence counts on over a restart.
    fn show_last(&self, last: BTreeMap<String, LastSeen>) {
        let Some(overview) = &self.outputs.overview else { return };
        let (now, now_ns) = (self.clock.now(), self.clock.now_ns());
        for (name, LastSeen { estimate, heard_ns }) in last {
            let Some(id) = self.loops.engine.find(&name) else { continue };
            let silent_ns = heard_ns.map_or(0, |ns| now_ns.saturating_sub(ns)).max(0);
            let heard = now.checked_sub(Duration::from_nanos(silent_ns.unsigned_abs())).unwrap_or(now);
            let (name, place) = (self.loops.engine.name(id), &self.loops.engine.settings(id).place);
            let newest_ns = self.loops.engine.figures(id).greatest_ns;
            overview.restore(name, place, (heard, newest_ns), estimate.map(Arc::from));
        }
    }

    /// Runs until `stop` is closed, then shuts down in order: takes what has arrived, and skips unfinished fits and records
    /// them as skipped. The files are closed when the recorder is dropped.
    pub fn run(mut self, incoming: &Receiver<Message>, control: &Receiver<Control>, stop: &Receiver<()>) {
        let (ticker, sweeps) = (tick(self.health_every), tick(sweep::EVERY));
        let answers = self.loops.workers.answers.clone();
        let diagnoses = self.loops.diagnoser.answers.clone();
        let comparisons = self.loops.plant.as_ref().map_or_else(never, |plant| plant.answers().clone());
        // The watchdog is fed here, so that a blocked engine triggers it.
        let watchdog = sd_notify::watchdog_enabled().map_or_else(never, |period| tick(period / 2));
        let rotations = self.outputs.recorder.as_ref().map_or_else(never, |r| r.rotations.clone());
        self.begin(incoming.len());
        loop {
            select! {
                recv(control) -> request => match request {
                    Ok(request) => self.handle(request),
                    Err(_) => break,
                },
                recv(incoming) -> message => match message {
                    Ok(message) => {
                        self.take_control(control);
                        self.take_batch(message, incoming);
                    }
                    Err(_) => break,
                },
                recv(answers) -> answered => if let Ok(answered) = answered { self.answered(answered) },
                recv(diagnoses) -> diagnosed => if let Ok(diagnosed) = diagnosed { self.diagnosed(diagnosed) },
                recv(comparisons) -> compared => if let Ok(compared) = compared { self.compared(compared) },
                recv(rotations) -> segment => if let Ok(segment) = segment { self.open_segment(segment) },
                recv(ticker) -> _ => self.report(incoming.len()),
                recv(sweeps) -> _ => self.sweep_step(),
                recv(watchdog) -> _ => notify_system(&[NotifyState::Watchdog]),
                recv(stop) -> _ => break,
            }
        }
        self.finish(incoming, control, &answers);
        // Closing the files takes longest, so start it before the memory of up to a hundred thousand loops is freed.
        self.outputs.recorder = None;
    }

    /// Opens the files and sends a first report before any message is taken.
    pub fn begin(&mut self, input_waiting: usize) {
        self.register_all();
        self.forget_removed();
        self.report(input_waiting);
    }

    /// Processes everything that waits, in a fixed order, for a caller that runs this without threads.
    pub fn turn(&mut self, incoming: &Receiver<Message>, control: &Receiver<Control>) {
        let answers = self.loops.workers.answers.clone();
        while let Ok(answered) = answers.try_recv() {
            self.answered(answered);
        }
        let diagnoses = self.loops.diagnoser.answers.clone();
        while let Ok(diagnosed) = diagnoses.try_recv() {
            self.diagnosed(diagnosed);
        }
        let comparisons = self.loops.plant.as_ref().map_or_else(never, |plant| plant.answers().clone());
        while let Ok(compared) = comparisons.try_recv() {
            self.compared(compared);
        }
        let rotations = self.outputs.recorder.as_ref().map_or_else(never, |r| r.rotations.clone());
        while let Ok(segment) = rotations.try_recv() {
            self.open_segment(segment);
        }
        self.take_control(control);
        while let Ok(message) = incoming.try_recv() {
            self.take_message(&message);
        }
    }

    /// The engine, to read.
    pub const fn engine(&self) -> &Engine {
        &self.loops.engine
    }

    /// The configuration in force.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Shuts down in order: takes what has arrived, and skips unfinished work and records it as skipped.
    pub fn finish(&mut self, incoming: &Receiver<Message>, control: &Receiver<Control>, answers: &Receiver<Answered>) {
        let until = self.clock.now() + DRAIN;
        self.take_control(control);
        while self.clock.now() < until {
            let Ok(message) = incoming.try_recv() else { break };
            self.take_message(&message);
        }
        self.metrics.dropped_input.inc_by(incoming.len() as u64);
        while let Ok(answered) = answers.try_recv() {
            self.answered(answered);
        }
        for id in self.loops.engine.ids() {
            let unfinished: Vec<(u64, i64)> = self.loops.engine.waiting(id).collect();
            for (seq, end_ns) in unfinished {
                self.skip(id, seq, end_ns, SkipReason::Shutdown);
                self.handle_events();
            }
        }
        while let Ok(diagnosed) = self.loops.diagnoser.answers.try_recv() {
            self.diagnosed(diagnosed);
        }
        for id in self.loops.engine.ids() {
            for number in self.loops.engine.gaps_waiting(id).collect::<Vec<u64>>() {
                self.skip_gap(id, number, SkipReason::Shutdown, "the daemon stopped");
                self.handle_events();
            }
        }
        self.forget_removed();
        self.report(incoming.len());
    }

    fn take_batch(&mut self, first: Message, incoming: &Receiver<Message>) {
        let until = self.clock.now() + BATCH_WITHIN;
        self.take_message(&first);
        for _ in 1..BATCH {
            if self.clock.now() >= until {
                return;
            }
            let Ok(next) = incoming.try_recv() else { return };
            self.take_message(&next);
        }
    }

    /// Takes waiting requests before each batch of samples, so that neither holds up the other.
    fn take_control(&mut self, control: &Receiver<Control>) {
        control.try_iter().take(REQUESTS).for_each(|request| self.handle(request));
    }

    fn handle(&mut self, request: Control) {
        match request {
            Control::Command { loop_name, command, answer } => self.take_command(&loop_name, &command, answer),
            Control::GapRun { loop_name, by, pool, answer } => self.run_gap(&loop_name, by, pool, answer),
            Control::GetWindow { loop_name, end_ns, answer } => self.get_window(&loop_name, end_ns, answer),
            Control::Edit { edit, answer } => {
                self.edit(*edit);
                answer();
            }
        }
    }

    fn answered(&mut self, answered: Answered) {
        self.metrics.fit.0.observe(answered.took.as_secs_f64());
        let lag_ns = self.clock.now_ns().saturating_sub(answered.arrival_ns).max(0);
        self.metrics.lag.0.observe(s_from_ns(lag_ns));
        match answered.answer {
            Some(answer) => {
                self.loops.engine.complete(answered.id, answered.seq, answer, &mut self.loops.events);
                self.window_answered(answered.end_ns);
            }
            None => self.skip(answered.id, answered.seq, answered.end_ns, SkipReason::Failed),
        }
        self.handle_events();
        self.dispatch_to_workers();
        self.forget_removed();
    }
}

/// Notifies systemd if it started the daemon; otherwise does nothing.
pub(super) fn notify_system(state: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(state) {
        tracing::debug!(%error, "systemd could not be notified");
    }
}

/// Serializes a document as UTF-8 JSON. `None` if that fails, which is a bug in this program: it is logged, and nothing is sent
/// instead.
#[must_use]
pub fn to_json(document: &impl serde::Serialize) -> Option<Vec<u8>> {
    let json = serde_json::to_vec(document);
    json.inspect_err(|error| tracing::error!(%error, "a document cannot be written as JSON and is left out")).ok()
}
