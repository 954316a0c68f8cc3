//! The engine's thread: takes what arrives in order, and is the only one that touches the engine.
//!
//! What it takes it records first; what the engine puts out goes to workers, recorder and publisher. It never waits
//! for a fit and never for the bus, whose readers and askers have threads of their own; for the recorder it waits a little (see [`crate::daemon::sink::recorder`]).

mod asked;
mod edit;
mod messages;
mod plant;
mod report;
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
use super::limits::{Limits, Refused};
use super::plant::Comparer;
use super::rerun::LastSeen;
use super::restore::Memories;
use super::routes::Routes;
use super::schedule::Schedule;
use super::senders::Senders;
use super::worker::{Answered, Job, Workers};
use crate::daemon::sink::deliver::{Item as Outgoing, Outbox};
use crate::daemon::sink::keeper::Keeper;
use crate::daemon::sink::recorder::{Item, LOOPS_PER_FILE, Recorder};
use crate::daemon::sink::zenoh::{Publication, Publisher};
use crate::daemon::source::Message;
use crate::daemon::source::shares::Shares;
use crate::runtime::clock::Clock;
use crate::runtime::control::{Answer, Control};
use crate::runtime::faults::Faults;
use crate::runtime::health::HealthSnapshot;
use crate::runtime::metrics::{Label, Metrics};
use crate::runtime::overview::Overview;
use crate::runtime::queue::Budget;
use crate::runtime::series::LoopMetrics;
use stiction::core::record::Sample;
use stiction::core::units::s_from_ns;
use stiction_engine::alarm::{AlarmDocument, State};
use stiction_engine::codec::topic::{self, Kind};
use stiction_engine::config::Config;
use stiction_engine::engine::{Engine, Event, LoopId, SkipReason, StateDocument};

/// Messages taken before the other channels are looked at again.
const BATCH: usize = 256;
/// Wishes taken before the samples are.
const WISHES: usize = 64;
/// How long that may take: a message may hold a hundred thousand samples.
const BATCH_WITHIN: Duration = Duration::from_millis(20);
/// How long a stopping daemon still takes what had already arrived.
const DRAIN: Duration = Duration::from_secs(1);

/// Everything the engine's thread owns.
pub struct Core {
    config: Arc<Config>,
    engine: Engine,
    routes: Routes,
    bundles: Bundles,
    feeds: Feeds,
    senders: Senders,
    workers: Workers,
    /// Windows that wait for a worker.
    schedule: Schedule<Job>,
    /// Looks at all loops, a part at a time.
    sweep: sweep::Sweep,
    registered: sweep::Registered,
    /// Loops that were removed from the configuration and still have work under way.
    removed: BTreeSet<LoopId>,
    /// Counters of payloads by codec.
    codec_counters: Vec<(&'static str, Counter)>,
    /// Messages taken.
    taken: u64,
    diagnoser: Diagnoser,
    /// The loops together; none where they are not compared.
    plant: Option<plant::Plant>,
    /// People who wait for a diagnosis, by loop and number.
    asking: HashMap<(LoopId, u64), Vec<Answer>>,
    recorder: Option<Recorder>,
    keeper: Option<Keeper>,
    publisher: Publisher,
    outbox: Option<Outbox>,
    /// Which loops have series in the metrics; none where they have none.
    board: Option<LoopMetrics>,
    /// What the page shows; none where there is no page.
    overview: Option<Overview>,
    /// When the sample arrived that is being taken, ns.
    arrival_ns: i64,
    metrics: Arc<Metrics>,
    faults: Arc<Faults>,
    snapshot: HealthSnapshot,
    daemon_id: String,
    clock: Clock,
    health_every: Duration,
    started: Instant,
    losses: [u64; 9],
    limits: Limits,
    /// The loop whose stamp was refused last for being ahead, and by how much it was, ns.
    ahead: Option<(LoopId, i64)>,
    codec: String,
    input_limit: usize,
    budget: Budget,
    warned_quality: bool,
    policy: CommandPolicy,
    events: Vec<Event>,
    samples: Vec<Sample>,
}

/// What a core is made of.
pub struct Parts {
    /// The configuration.
    pub config: Arc<Config>,
    /// The engine, which runs under it.
    pub engine: Engine,
    /// Bytes that wait for the engine, and what each key may hold of its queue.
    pub input: (Budget, Shares),
    /// The workers.
    pub workers: Workers,
    /// The gap's thread.
    pub diagnoser: Diagnoser,
    /// Compares the loops; none where the configuration says so.
    pub comparer: Option<Comparer>,
    /// The recorder.
    pub recorder: Option<Recorder>,
    /// Keeps the loops' memory; none in a demonstration.
    pub keeper: Option<Keeper>,
    /// The publisher.
    pub publisher: Publisher,
    /// The way to receivers outside the bus; none where there are none.
    pub outbox: Option<Outbox>,
    /// The counters.
    pub metrics: Arc<Metrics>,
    /// The faults.
    pub faults: Arc<Faults>,
    /// What the page shows; none where there is no page.
    pub overview: Option<Overview>,
    /// Where the health goes.
    pub snapshot: HealthSnapshot,
    /// The daemon's id.
    pub daemon_id: String,
    /// The time.
    pub clock: Clock,
    /// How often the health documents are made.
    pub health_every: Duration,
}

impl Core {
    /// Puts the parts together.
    #[must_use]
    pub fn new(parts: Parts) -> Self {
        let config = parts.config.as_ref();
        let (policy, limits) = (CommandPolicy::new(&config.commands), Limits::new(&config.input));
        let board = LoopMetrics::new(config);
        let (budget, shares) = parts.input;
        if let Some(overview) = &parts.overview {
            overview.expect(parts.config.clone(), parts.clock.now(), parts.clock.now_ns());
        }
        Self {
            routes: Routes::new(config, shares),
            bundles: Bundles::new(config),
            feeds: Feeds::new(config),
            senders: Senders::default(),
            codec: config.input.codec.clone(),
            input_limit: config.input.queue,
            engine: parts.engine,
            sweep: sweep::Sweep::default(),
            registered: sweep::Registered::default(),
            removed: BTreeSet::new(),
            codec_counters: Vec::new(),
            taken: 0,
            workers: parts.workers,
            schedule: Schedule::default(),
            budget,
            diagnoser: parts.diagnoser,
            plant: parts.comparer.map(plant::Plant::new),
            asking: HashMap::new(),
            recorder: parts.recorder,
            keeper: parts.keeper,
            publisher: parts.publisher,
            outbox: parts.outbox,
            board,
            overview: parts.overview,
            arrival_ns: 0,
            metrics: parts.metrics,
            faults: parts.faults,
            snapshot: parts.snapshot,
            daemon_id: parts.daemon_id,
            started: parts.clock.now(),
            clock: parts.clock,
            health_every: parts.health_every,
            losses: [0; 9],
            limits,
            ahead: None,
            warned_quality: false,
            config: parts.config,
            policy,
            events: Vec::new(),
            samples: Vec::new(),
        }
    }

    /// Takes over what the runs before remembered of their loops, and publishes the alarms that are not at rest. Loops whose
    /// windows go on have their places already, then come those that were answered last; the others wait for theirs.
    pub fn restore(&mut self, memories: Memories, last: BTreeMap<String, LastSeen>) {
        let Memories { there, left, removed } = memories;
        let mut there: Vec<_> = there.into_iter().map(|(name, memory)| (name, memory, false)).collect();
        there.sort_by_key(|(_, memory, _)| Reverse(memory.alarm.progress()));
        let left = left.into_iter().map(|(name, memory)| (name, memory, true));
        for (name, memory, has_left) in there.into_iter().chain(left) {
            let id = if has_left { self.engine.find(&name) } else { self.engine.appear(&name) };
            let document = match id {
                Some(id) => self.engine.restore(id, memory),
                None => self.engine.remember(&name, memory),
            };
            if let Some(document) = document {
                self.show_alarm(&document);
                self.publish(&document.loop_name, Kind::Alarm, &document);
            }
        }
        for (name, memory) in removed {
            if memory.alarm.shown() == State::Normal {
                self.keeper.iter().for_each(|keeper| keeper.forget(&name));
                continue;
            }
            let id = self.engine.appear_anyway(&name);
            self.engine.restore(id, memory);
            self.removed.insert(id);
        }
        self.show_last(last);
    }

    /// Shows what was heard of each loop last: silence goes on over a restart.
    fn show_last(&self, last: BTreeMap<String, LastSeen>) {
        let Some(overview) = &self.overview else { return };
        let (now, now_ns) = (self.clock.now(), self.clock.now_ns());
        for (name, LastSeen { estimate, heard_ns }) in last {
            let Some(id) = self.engine.find(&name) else { continue };
            let silent_ns = heard_ns.map_or(0, |ns| now_ns.saturating_sub(ns)).max(0);
            let heard = now.checked_sub(Duration::from_nanos(silent_ns.unsigned_abs())).unwrap_or(now);
            let (name, place) = (self.engine.name(id), &self.engine.settings(id).place);
            let newest_ns = self.engine.figures(id).greatest_ns;
            overview.restore(name, place, (heard, newest_ns), estimate.map(Arc::from));
        }
    }

    /// Works until `stop` is closed, then ends in order: what has arrived is taken, fits that are not done are skipped
    /// and recorded as such, files are finished when the core is dropped.
    pub fn run(mut self, incoming: &Receiver<Message>, control: &Receiver<Control>, stop: &Receiver<()>) {
        let (ticker, sweeps) = (tick(self.health_every), tick(sweep::EVERY));
        let answers = self.workers.answers.clone();
        let diagnoses = self.diagnoser.answers.clone();
        let comparisons = self.plant.as_ref().map_or_else(never, |plant| plant.answers().clone());
        // A watchdog is fed from here, so that an engine that stands still starves it.
        let watchdog = sd_notify::watchdog_enabled().map_or_else(never, |period| tick(period / 2));
        let rotations = self.recorder.as_ref().map_or_else(never, |r| r.rotations.clone());
        self.begin(incoming.len());
        loop {
            select! {
                recv(control) -> wish => match wish {
                    Ok(wish) => self.obey(wish),
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
                recv(rotations) -> shard => if let Ok(shard) = shard { self.open_shard(shard) },
                recv(ticker) -> _ => self.report(incoming.len()),
                recv(sweeps) -> _ => self.sweep_step(),
                recv(watchdog) -> _ => tell_system(&[NotifyState::Watchdog]),
                recv(stop) -> _ => break,
            }
        }
        self.finish(incoming, control, &answers);
        // The recorder has the most to do after that: it begins before a hundred thousand loops are given back.
        self.recorder = None;
    }

    /// What comes before anything is taken: the files, and a first word.
    pub fn begin(&mut self, input_waiting: usize) {
        self.register_all();
        self.forget_removed();
        self.report(input_waiting);
    }

    /// Takes all that waits, in a fixed order: for whoever drives the core without threads.
    pub fn turn(&mut self, incoming: &Receiver<Message>, control: &Receiver<Control>) {
        let answers = self.workers.answers.clone();
        while let Ok(answered) = answers.try_recv() {
            self.answered(answered);
        }
        let diagnoses = self.diagnoser.answers.clone();
        while let Ok(diagnosed) = diagnoses.try_recv() {
            self.diagnosed(diagnosed);
        }
        let comparisons = self.plant.as_ref().map_or_else(never, |plant| plant.answers().clone());
        while let Ok(compared) = comparisons.try_recv() {
            self.compared(compared);
        }
        let rotations = self.recorder.as_ref().map_or_else(never, |r| r.rotations.clone());
        while let Ok(shard) = rotations.try_recv() {
            self.open_shard(shard);
        }
        self.take_control(control);
        while let Ok(message) = incoming.try_recv() {
            self.take_message(&message);
        }
    }

    /// The loops.
    pub const fn engine(&self) -> &Engine {
        &self.engine
    }

    /// The configuration in force.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Ends in order: what has arrived is taken, what is not done is skipped and recorded as such.
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
        for id in self.engine.ids() {
            let unfinished: Vec<(u64, i64)> = self.engine.waiting(id).collect();
            for (seq, end_ns) in unfinished {
                self.skip(id, seq, end_ns, SkipReason::Shutdown);
                self.handle_events();
            }
        }
        while let Ok(diagnosed) = self.diagnoser.answers.try_recv() {
            self.diagnosed(diagnosed);
        }
        for id in self.engine.ids() {
            for number in self.engine.gaps_waiting(id).collect::<Vec<u64>>() {
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

    /// Takes wishes that wait, before each batch of samples: neither holds up the other.
    fn take_control(&mut self, control: &Receiver<Control>) {
        control.try_iter().take(WISHES).for_each(|wish| self.obey(wish));
    }

    fn obey(&mut self, wish: Control) {
        match wish {
            Control::Command { loop_name, command, answer } => self.take_command(&loop_name, &command, answer),
            Control::GapRun { loop_name, by, pool, answer } => self.run_gap(&loop_name, by, pool, answer),
            Control::GetWindow { loop_name, end_ns, answer } => self.get_window(&loop_name, end_ns, answer),
            Control::Edit { edit, answer } => {
                self.edit(*edit);
                answer();
            }
        }
    }

    fn take_sample(&mut self, id: LoopId, sample: Sample, arrival_ns: i64) {
        self.metrics.samples.inc();
        let now = self.clock.since(self.started);
        if !self.is_within_limits(id, &sample, arrival_ns, now) {
            return;
        }
        if sample.quality.is_some_and(|q| (1..=255).contains(&q)) && self.config.input.quality == "ua" {
            self.metrics.suspicious_quality.inc();
            if !std::mem::replace(&mut self.warned_quality, true) {
                let name = self.engine.name(id);
                tracing::warn!(%name, quality = ?sample.quality, "this looks like a classic OPC quality: set [input] quality = \"classic\"");
            }
        }
        if let Some(recorder) = &mut self.recorder {
            let name = self.engine.name(id).clone();
            recorder.record(Item::Raw { id, name, sample, arrival_ns });
        }
        self.registered.mark_heard(id, now);
        self.arrival_ns = arrival_ns;
        self.engine.push(id, sample, &mut self.events);
        self.handle_events();
    }

    fn is_within_limits(&mut self, id: LoopId, sample: &Sample, arrival_ns: i64, now: Duration) -> bool {
        let engine = &self.engine;
        let greatest = || engine.ids().filter_map(|id| engine.figures(id).greatest_ns).collect();
        match self.limits.sample((id, sample, arrival_ns), now, greatest) {
            Ok(()) => return true,
            Err(Refused::OverRate) => self.metrics.over_rate.inc(),
            Err(Refused::Ahead) => {
                self.ahead = Some((id, sample.t_ns.saturating_sub(arrival_ns)));
                self.metrics.stamps_ahead.inc()
            }
        };
        false
    }

    fn answered(&mut self, answered: Answered) {
        self.metrics.fit.0.observe(answered.took.as_secs_f64());
        let lag_ns = self.clock.now_ns().saturating_sub(answered.arrival_ns).max(0);
        self.metrics.lag.0.observe(s_from_ns(lag_ns));
        match answered.answer {
            Some(answer) => {
                self.engine.complete(answered.id, answered.seq, answer, &mut self.events);
                self.window_answered(answered.end_ns);
            }
            None => self.skip(answered.id, answered.seq, answered.end_ns, SkipReason::Failed),
        }
        self.handle_events();
        self.dispatch_to_workers();
        self.forget_removed();
    }

    fn handle_events(&mut self) {
        while !self.events.is_empty() {
            for event in std::mem::take(&mut self.events) {
                match event {
                    Event::Request(request) => self.schedule_window(*request),
                    Event::GapRequest(request) => self.request_gap(*request),
                    Event::Gap(id, document) => {
                        self.metrics.gaps.inc();
                        if let Some(overview) = &self.overview {
                            let (name, place) = (self.engine.name(id), &self.engine.settings(id).place);
                            overview.cause(name, place, self.clock.now(), &document.document.cause.id);
                        }
                        self.record(id, Kind::Gap, &document, document.end_ns());
                        self.publish_result(id, Kind::Gap, document.end_ns(), &document);
                    }
                    Event::Window(id, window) => self.watch_window(id, *window),
                    Event::Estimate(id, document) => {
                        self.metrics.estimates.inc();
                        let a = &document.assessment;
                        self.metrics.verdicts.get_or_create(&Label { name: a.verdict.name().into() }).inc();
                        for gate in &a.gates {
                            self.metrics.gates.get_or_create(&Label { name: gate.name().into() }).inc();
                        }
                        if let Some(board) = &mut self.board {
                            let (name, place) = (self.engine.name(id), &self.engine.settings(id).place);
                            board.estimate(&self.metrics.series, name, place, a);
                        }
                        self.record(id, Kind::Estimate, &document, a.window.end_ns);
                        self.publish_result(id, Kind::Estimate, a.window.end_ns, &document);
                        if let Some(overview) = &self.overview {
                            let (name, place) = (self.engine.name(id), &self.engine.settings(id).place);
                            overview.estimate(name, place, self.clock.now(), Arc::from(document));
                        }
                    }
                    Event::Alarm(id, document) => self.alarm_changed(id, &document),
                    Event::State(id, document) => {
                        let at_ns = document.window_end_ns.unwrap_or(0);
                        self.record(id, Kind::State, &document, at_ns);
                        self.keep(&document);
                    }
                }
            }
        }
        self.compare_when_due();
    }

    fn alarm_changed(&mut self, id: LoopId, document: &AlarmDocument) {
        self.metrics.alarms.inc();
        if document.active {
            tracing::warn!(target: "stiction_engine::alarm", "{}", document.line());
        } else {
            tracing::info!(target: "stiction_engine::alarm", "{}", document.line());
        }
        self.show_alarm(document);
        self.record(id, Kind::Alarm, document, document.changed_ns);
        let Some(json) = to_json(document) else { return };
        if let Some(outbox) = self.outbox.as_ref().filter(|outbox| outbox.wants(Kind::Alarm)) {
            outbox.offer(Outgoing::alarm(&self.config.site.prefix, document, &json));
        }
        self.publish_json(&document.loop_name, Kind::Alarm, json);
    }

    fn show_alarm(&mut self, document: &AlarmDocument) {
        let name: Arc<str> = document.loop_name.as_str().into();
        let there = self.engine.find(&name).map(|id| self.engine.settings(id));
        let place = &there.unwrap_or_else(|| self.engine.engine_settings().of(&name)).place;
        if let Some(overview) = &self.overview {
            overview.alarm(&name, place, self.clock.now(), document);
        }
        let Some(board) = &mut self.board else { return };
        board.alarm(&self.metrics.series, &name, place, document);
    }

    /// Publishes what a window gave, to receivers outside the bus too.
    fn publish_result(&self, id: LoopId, kind: Kind, end_ns: i64, document: &impl serde::Serialize) {
        let Some(json) = to_json(document) else { return };
        if let Some(outbox) = self.outbox.as_ref().filter(|outbox| outbox.wants(kind)) {
            outbox.offer(Outgoing::result(&self.config.site.prefix, self.engine.name(id), kind, end_ns, &json));
        }
        self.publish_json(self.engine.name(id), kind, json);
    }

    fn record(&mut self, id: LoopId, kind: Kind, document: &impl serde::Serialize, event_ns: i64) {
        let (Some(recorder), Some(json)) = (&mut self.recorder, to_json(document)) else { return };
        let name = self.engine.name(id).clone();
        recorder.record(Item::Document { id, name, kind, json, event_ns });
    }

    fn publish(&self, name: &str, kind: Kind, document: &impl serde::Serialize) {
        if let Some(json) = to_json(document) {
            self.publish_json(name, kind, json);
        }
    }

    fn publish_json(&self, name: &str, kind: Kind, json: Vec<u8>) {
        let key = topic::result(&self.config.site.prefix, name, kind);
        self.publisher.publish(Publication { key, kind, document: Some(json) });
    }

    /// Keeps a loop's state over a restart.
    fn keep(&self, state: &StateDocument) {
        if let (Some(keeper), Some(json)) = (&self.keeper, to_json(state)) {
            keeper.keep(&state.loop_name, json);
        }
    }

    /// Begins a new file of each shard that has loops.
    fn reopen_shards(&mut self) {
        self.registered.shards.clone().into_iter().for_each(|shard| self.open_shard(shard));
    }

    /// Begins a new file of a shard; one whose loops have left needs none.
    fn open_shard(&mut self, shard: usize) {
        let Some(recorder) = self.recorder.as_mut().filter(|_| self.registered.shards.contains(&shard)) else { return };
        let (from, to) = (shard * LOOPS_PER_FILE, (shard + 1) * LOOPS_PER_FILE);
        let states = self.engine.ids_in(from, to).filter_map(|id| {
            let name = self.engine.name(id);
            Some((name.clone(), to_json(&StateDocument::new(name, None, self.engine.checkpoint(id)))?))
        });
        let states = states.collect();
        recorder.record(Item::Open { shard, states });
    }
}

/// Tells systemd, where it listens; elsewhere nothing.
pub(super) fn tell_system(state: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(state) {
        tracing::debug!(%error, "systemd could not be told");
    }
}

/// A document's JSON, UTF-8. None where it cannot be written, which is an error of this program: it is logged, and nothing
/// takes the document's place.
#[must_use]
pub fn to_json(document: &impl serde::Serialize) -> Option<Vec<u8>> {
    let json = serde_json::to_vec(document);
    json.inspect_err(|error| tracing::error!(%error, "a document cannot be written as JSON and is left out")).ok()
}
