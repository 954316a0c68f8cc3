//! A daemon without threads, bus or clock, made of the parts of [`super::run`]: queues, engine, schedule, recorder, state
//! store, restore, page, delivery, gap diagnoses and retention. The caller delivers messages, advances the clock, does the fits
//! and diagnoses, answers as the receivers and decides when the disk writes. So a simulation controls every order and every
//! fault, and the same seed gives the same run.
//!
//! Dropping it acts like kill -9: nothing is finished.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, RwLock};
use std::time::Duration;

use crossbeam_channel::{Receiver, Sender};

use super::data_health::{DataHealthParts, DataHealthWorker};
use super::engine_thread::{EngineThread, Parts};
use super::gaps::{Diagnosed, Diagnoser, Outcome};
use super::plant::{Compared, Comparer, compare};
use super::retention::{RetentionParts, RetentionWorker};
use super::worker::{Answered, Job, Workers};
use crate::daemon::sink::deliver::{Delivery, MakeTarget, Outbox};
use crate::daemon::sink::mark::Mark;
use crate::daemon::sink::recorder::{RecordedConfig, Recorder, RunInfo, Writer};
use crate::daemon::sink::state_writer::{self, StateWriter};
use crate::daemon::sink::zenoh::{Outgoing, Publication, Publisher};
use crate::daemon::source::shares::Shares;
use crate::daemon::source::{CONTROL_QUEUE, Envelope, Intake, Message};
use crate::daemon::startup_state::memory::{self, Restored};
use crate::daemon::startup_state::windows::{Refilled, refill};
use crate::runtime::clock::Clock;
use crate::runtime::control::{Answer, Control, Edit};
use crate::runtime::faults::Faults;
use crate::runtime::health::{DaemonHealth, HealthSnapshot};
use crate::runtime::metrics::Metrics;
use crate::runtime::overview::Overview;
use crate::runtime::queue::Budget;
use crate::runtime::view::CurrentConfig;
use stiction::core::verdict::Assessment;
use stiction_engine::alarm::Command;
use stiction_engine::config::{Config, ConfigChanges, Deliver};
use stiction_engine::engine::{Comparison, Engine, GapRequest, Request};
use stiction_files::disk::Disk;
use stiction_files::lock::SharedLock;

/// Windows handed out ahead of their fits: as with one worker.
const AT_HAND: usize = 1;
/// Daemon id under which it publishes its health.
const DAEMON_ID: &str = "stage";

/// The parts, and the other ends of their queues.
pub struct SimDaemon {
    engine: EngineThread,
    intake: Intake,
    control: Sender<Control>,
    requests: Receiver<Control>,
    incoming: Receiver<Message>,
    jobs: Receiver<Job>,
    answers: Sender<Answered>,
    answered: Receiver<Answered>,
    gap_requests: Receiver<GapRequest>,
    gap_answers: Sender<Diagnosed>,
    comparisons: Receiver<Comparison>,
    compared: Sender<Compared>,
    overview: Overview,
    delivery: Delivery,
    retention: RetentionWorker,
    data_health: DataHealthWorker,
    publications: Outgoing,
    writer: Writer,
    keeping: state_writer::Worker,
    budget: Budget,
    metrics: Arc<Metrics>,
    faults: Arc<Faults>,
    snapshot: HealthSnapshot,
    run_id: String,
}

/// A target that fails, for runs that deliver nothing.
#[must_use]
pub fn no_receiver(_: &Deliver) -> MakeTarget {
    Box::new(|| anyhow::bail!("no receiver"))
}

impl SimDaemon {
    /// Starts a run in the configured folder, with what earlier runs left there. `receiver` makes the replacement for each
    /// `[[deliver]]` entry.
    ///
    /// # Errors
    /// A receiver cannot be made.
    pub fn start(
        config: Config,
        config_text: &str,
        clock: &Clock,
        disk: &Arc<dyn Disk>,
        receiver: impl Fn(&Deliver) -> MakeTarget,
    ) -> anyhow::Result<Self> {
        let (metrics, faults) = (Arc::new(Metrics::default()), Arc::new(Faults::new(clock.clone())));
        let dir = Path::new(&config.recording.dir).to_owned();
        let prefix = config.site.prefix.clone();
        let mut restored = memory::restore(disk.as_ref(), &dir, &prefix, &faults, &metrics);
        let memories = restored.take_memories(&config);
        let run = run_of(&config, config_text, clock, restored.run_number);
        restored.note_run(&prefix, &run.run_id);
        let Restored { store, runs, verified, data_health, .. } = restored;
        memory::report_aside(&dir, &faults);
        let Refilled { engine, continued, last } = refill(&dir, &config, &runs, clock.now_ns(), &faults);
        let run = RunInfo { continued, ..run };
        let run_id = run.run_id.clone();
        let place = (disk.clone(), clock.clone());
        let (recorder, writer) = Recorder::pair(run, config.recording.clone(), place, metrics.clone(), faults.clone());
        let mark = Mark::default();
        let stored = (store, mark.clone());
        let (state_writer, keeping) =
            StateWriter::pair(&dir, &prefix, stored, disk.clone(), faults.clone(), metrics.clone());
        let (publisher, publications) = Publisher::pair(metrics.clone());
        let (queue, incoming) = crossbeam_channel::bounded(config.input.queue);
        let (control, requests) = crossbeam_channel::bounded(CONTROL_QUEUE);
        let (budget, shares) = (Budget::new(config.input.queue_bytes), Shares::default());
        let way_in = (budget.clone(), shares.clone());
        let intake = Intake::new(queue, way_in, metrics.clone(), clock.clone());
        let (to_worker, waiting) = crossbeam_channel::bounded(AT_HAND);
        let (answers, answered) = crossbeam_channel::unbounded();
        let (diagnoser, gap_requests, gap_answers) = Diagnoser::ends();
        let (comparer, comparisons, compared) = Comparer::ends();
        let (outbox, delivery) =
            Outbox::pair(&config, &dir, (disk.clone(), clock.clone(), mark), receiver, &faults, &metrics)?;
        let (overview, current) = (Overview::default(), CurrentConfig::new(config.clone()));
        let parts = DataHealthParts {
            config: current.clone(),
            overview: overview.clone(),
            publisher: publisher.clone(),
            outbox: Some(outbox.clone()),
            notes: Some(state_writer.notes()),
            daemon_id: DAEMON_ID.to_owned(),
            clock: clock.clone(),
        };
        let data_health = DataHealthWorker::new(parts, data_health);
        let retention = RetentionWorker::new(RetentionParts {
            dir,
            prefix,
            run_id: run_id.clone(),
            config: current,
            lock: SharedLock::default(),
            notes: Some(state_writer.notes()),
            verified,
            metrics: metrics.clone(),
            faults: faults.clone(),
            clock: clock.clone(),
        });
        let starting = DaemonHealth::starting(DAEMON_ID, &config.hash());
        let snapshot = HealthSnapshot::new(RwLock::new((clock.now(), Arc::new(starting))));
        let mut engine_thread = EngineThread::new(Parts {
            engine: engine.of_daemon(DAEMON_ID),
            comparer: config.plant.groups.then_some(comparer),
            config: Arc::new(config),
            input: (budget.clone(), shares),
            workers: Workers { jobs: to_worker, answers: answered.clone() },
            diagnoser,
            recorder: Some(recorder),
            state_writer: Some(state_writer),
            publisher,
            outbox: Some(outbox),
            metrics: metrics.clone(),
            faults: faults.clone(),
            overview: Some(overview.clone()),
            snapshot: snapshot.clone(),
            daemon_id: DAEMON_ID.to_owned(),
            clock: clock.clone(),
            health_every: super::HEALTH_EVERY,
        });
        engine_thread.restore(memories, last);
        engine_thread.begin(0);
        Ok(Self {
            engine: engine_thread,
            intake,
            control,
            requests,
            incoming,
            jobs: waiting,
            answers,
            answered,
            gap_requests,
            gap_answers,
            comparisons,
            compared,
            overview,
            delivery,
            retention,
            data_health,
            publications,
            writer,
            keeping,
            budget,
            metrics,
            faults,
            snapshot,
            run_id,
        })
    }

    /// A message arrives from the bus.
    pub fn deliver(&self, key: &str, payload: &[u8]) {
        let envelope = Envelope { key, encoding: None, bus_ns: None, sender: None };
        self.intake.take(&envelope, payload.len(), |bytes| bytes.extend_from_slice(payload));
    }

    /// A person's command arrives; false if the daemon is too busy to take it.
    pub fn command(&self, loop_name: &str, command: Command, answer: Answer) -> bool {
        let loop_name = loop_name.to_owned();
        self.control.try_send(Control::Command { loop_name, command, answer }).is_ok()
    }

    /// The engine takes everything that waits for it.
    pub fn turn(&mut self) {
        self.engine.turn(&self.incoming, &self.requests);
    }

    /// Does up to `most` fits, each given by `fit`; returns how many were done.
    pub fn work(&mut self, most: usize, mut fit: impl FnMut(&str, &Request) -> Option<Assessment>) -> usize {
        for done in 0..most {
            let Ok(Job { request, arrival_ns }) = self.jobs.try_recv() else { return done };
            let assessment = fit(self.engine.engine().name(request.id), &request);
            let answer = assessment.map(|assessment| request.answer(request.record(), assessment));
            let (id, seq, end_ns, took) = (request.id, request.seq, request.end_ns, Duration::ZERO);
            let _ = self.answers.send(Answered { id, seq, end_ns, arrival_ns, took, answer });
            // The answer makes room for the next job from the schedule.
            self.engine.turn(&self.incoming, &self.requests);
        }
        most
    }

    /// A person requests a gap diagnosis, pooled with earlier ones if `pool` is set; false if the daemon is too busy to take
    /// it.
    pub fn ask_gap(&self, loop_name: &str, by: &str, pool: bool, answer: Answer) -> bool {
        let (loop_name, by) = (loop_name.to_owned(), Some(by.to_owned()));
        self.control.try_send(Control::GapRun { loop_name, by, pool, answer }).is_ok()
    }

    /// Does the waiting gap diagnoses, each given by `diagnose`; returns their number.
    pub fn diagnose(&mut self, mut diagnose: impl FnMut(&GapRequest) -> Outcome) -> usize {
        let requests: Vec<GapRequest> = self.gap_requests.try_iter().collect();
        for request in &requests {
            let answer = Diagnosed { id: request.id, number: request.number, outcome: diagnose(request) };
            let _ = self.gap_answers.send(answer);
            self.engine.turn(&self.incoming, &self.requests);
        }
        requests.len()
    }

    /// Does the waiting comparison of loops; false if there was none.
    pub fn compare(&mut self) -> bool {
        let Ok(comparison) = self.comparisons.try_recv() else { return false };
        let _ = self.compared.send(compare(comparison, DAEMON_ID));
        self.engine.turn(&self.incoming, &self.requests);
        true
    }

    /// Number of gap diagnoses that wait.
    #[must_use]
    pub fn gaps_waiting(&self) -> usize {
        self.gap_requests.len()
    }

    /// Sends receivers their waiting documents once these are stored; true if all are stored.
    pub fn send_out(&mut self) -> bool {
        self.delivery.turn()
    }

    /// Number of documents that wait for receivers.
    #[must_use]
    pub fn undelivered(&self) -> usize {
        self.delivery.waiting()
    }

    /// Maintains the recording folder, as the retention worker does every half minute.
    pub fn keep_folder(&mut self) {
        self.retention.keep();
        self.retention.check_all();
    }

    /// Checks which obstacles keep loops from being judged, as the data-health thread does every minute.
    pub fn look_at_data(&mut self) {
        self.data_health.turn();
    }

    /// The page's data.
    #[must_use]
    pub const fn overview(&self) -> &Overview {
        &self.overview
    }

    /// The recorder writes everything that waits for it.
    pub fn record(&mut self) {
        self.writer.turn();
    }

    /// The state store writes everything that waits for it, after the document store; true if it could.
    pub fn keep(&mut self) -> bool {
        self.delivery.store();
        self.keeping.turn()
    }

    /// Publications since the last call.
    pub fn published(&mut self) -> impl Iterator<Item = Publication> + '_ {
        std::iter::from_fn(|| self.publications.next_now()).filter(|p| p.document.is_some())
    }

    /// The current health.
    pub fn health(&mut self) -> Arc<DaemonHealth> {
        self.engine.report(self.incoming.len());
        self.snapshot.read().unwrap_or_else(std::sync::PoisonError::into_inner).1.clone()
    }

    /// The engine, to read.
    #[must_use]
    pub const fn engine(&self) -> &Engine {
        self.engine.engine()
    }

    /// The counters.
    #[must_use]
    pub fn metrics(&self) -> &Metrics {
        &self.metrics
    }

    /// The current faults.
    #[must_use]
    pub fn faults(&self) -> Vec<String> {
        self.faults.list()
    }

    /// Bytes of waiting messages, and number of states waiting for the store.
    #[must_use]
    pub fn waiting(&self) -> (usize, usize) {
        (self.budget.used(), self.keeping.waiting())
    }

    /// Number of loops held, by part of the daemon.
    #[cfg(test)]
    #[must_use]
    pub fn remains(&self) -> Vec<(&'static str, usize)> {
        self.engine.remains()
    }

    /// A new configuration arrives, and is applied with the next turn; returns the changes. `None` if it is refused, because it
    /// changes settings that cannot change at run time or the daemon is too busy.
    pub fn edit(&self, config: Config, text: &str) -> Option<ConfigChanges> {
        let changes = self.engine.config().changes_to(&config);
        let edit = Edit { config: Arc::new(config), text: text.to_owned(), changes: changes.clone() };
        let request = Control::Edit { edit: Box::new(edit), answer: Box::new(|| ()) };
        (changes.refusal().is_none() && self.control.try_send(request).is_ok()).then_some(changes)
    }

    /// Names this run in its recordings.
    #[must_use]
    pub fn run_id(&self) -> &str {
        &self.run_id
    }

    /// Shuts down in order, as SIGTERM does. Returns the last publications.
    pub fn finish(&mut self) -> Vec<Publication> {
        self.engine.finish(&self.incoming, &self.requests, &self.answered);
        self.writer.turn();
        self.writer.finish();
        self.delivery.turn();
        self.keeping.turn();
        self.published().collect()
    }
}

fn run_of(config: &Config, config_text: &str, clock: &Clock, run_number: u64) -> RunInfo {
    let started_ns = clock.now_ns();
    RunInfo {
        prefix: config.site.prefix.clone(),
        run_id: stiction_engine::short_hash(format!("{started_ns} {run_number}").as_bytes())[..8].to_owned(),
        started_ns,
        run_number: (run_number > 0).then_some(run_number),
        origin: "stage",
        config: RecordedConfig::new(config, config_text.to_owned()),
        daemon: DAEMON_ID.to_owned(),
        raw: config.recording.raw,
        continued: BTreeMap::new(),
    }
}
