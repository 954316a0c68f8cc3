//! The first part of a run's start: reads what earlier runs left, opens the session, starts the threads that consume results.

use std::convert::Infallible;
use std::future::{Future, pending};
use std::path::{Path, PathBuf};
use std::sync::{Arc, RwLock};
use std::time::{Duration, Instant};

use crossbeam_channel::Sender;
use sd_notify::NotifyState;

use super::data_health::{self, DataHealthParts, DataHealthWorker};
use super::engine_thread::notify_system;
use super::retention::{self, RetentionParts};
use super::shutdown::{self, NamedThread};
use crate::daemon::sink::deliver::Outbox;
use crate::daemon::sink::mark::Mark;
use crate::daemon::sink::recorder::{Recorder, RunInfo};
use crate::daemon::sink::state_writer::StateWriter;
use crate::daemon::sink::zenoh::Publisher;
use crate::daemon::source::shares::Shares;
use crate::daemon::source::zenoh::Subscriptions;
use crate::daemon::source::{self, Intake, Message};
use crate::daemon::startup_state::memory::{self, OwnRuns, Restored};
use crate::daemon::startup_state::windows::{self, Refilled};
use crate::runtime::clock::Clock;
use crate::runtime::control::Control;
use crate::runtime::faults::Faults;
use crate::runtime::health::{DaemonHealth, HealthSnapshot};
use crate::runtime::last_values::LastValues;
use crate::runtime::metrics::Metrics;
use crate::runtime::overview::Overview;
use crate::runtime::queue::Budget;
use crate::runtime::view::{CurrentConfig, View};
use stiction_engine::config::Config;
use stiction_files::disk::{Disk, SystemDisk};
use stiction_files::lock::{FolderLock, LockError, LockedDisk, SharedLock};

/// How long a router may take to respond before that is a fault.
const ROUTER_WITHIN: Duration = Duration::from_secs(5);
/// How often a long start reports that it continues.
const STARTING_EVERY: Duration = Duration::from_secs(5);
/// Note on the page of a demonstration.
const SIMULATED: &str =
    "A simulated plant that runs 100 times as fast as a real one: its stamps run ahead of your clock.";

/// Shared by all parts of a run.
pub(super) struct Shared {
    pub current: CurrentConfig,
    pub recordings: PathBuf,
    pub metrics: Arc<Metrics>,
    pub faults: Arc<Faults>,
    pub overview: Overview,
    pub last: LastValues,
    pub snapshot: HealthSnapshot,
}

impl Shared {
    pub(super) fn of(config: &Config) -> Self {
        Self {
            current: CurrentConfig::new(config.clone()),
            recordings: PathBuf::from(&config.recording.dir),
            metrics: Arc::new(Metrics::default()),
            faults: Arc::new(Faults::default()),
            overview: Overview::default(),
            last: LastValues::default(),
            snapshot: HealthSnapshot::new(RwLock::new(starting("", config))),
        }
    }

    /// The data for the server, with access to the engine and to the configuration file.
    pub(super) fn view(&self, origin: &str, control: Sender<Control>) -> View {
        let web = &self.current.get().web;
        View {
            config: self.current.clone(),
            overview: (web.enabled && web.page.enabled).then(|| self.overview.clone()),
            last: self.last.clone(),
            control,
            snapshot: self.snapshot.clone(),
            faults: self.faults.clone(),
            note: (origin == "demo").then_some(SIMULATED),
        }
    }
}

/// The health of a daemon that is starting.
fn starting(id: &str, config: &Config) -> (Instant, Arc<DaemonHealth>) {
    (Instant::now(), Arc::new(DaemonHealth::starting(id, &config.hash())))
}

/// Results of the first steps, before the threads start.
pub(super) struct Opened {
    pub restored: Restored,
    pub session: zenoh::Session,
    /// Why the session does not listen, if it does not.
    pub deaf: Option<String>,
    pub daemon_id: String,
    pub input: (Budget, Shares),
    pub subscriptions: Subscriptions,
}

/// Reads what earlier runs left, opens the session and subscribes; `None` if the daemon is stopped first.
pub(super) async fn open(
    config: &Config,
    shared: &Shared,
    origin: &str,
    queue: Sender<Message>,
    stop: &mut (impl Future<Output = ()> + Unpin),
) -> anyhow::Result<Option<Opened>> {
    let Shared { faults, metrics, snapshot, .. } = shared;
    let restored = if goes_on(origin) {
        let reading = restore_in_background(config, faults, metrics);
        let Some(read) = unless_stopped(reading, ask_for_patience(faults, snapshot), stop).await else {
            return Ok(None);
        };
        read
    } else {
        Restored::default()
    };
    // A client's session opens once its router is there, which may be never.
    let opening = source::zenoh::open(config);
    let Some(opened) = unless_stopped(opening, wait_for_router(faults, snapshot), stop).await else { return Ok(None) };
    let (session, deaf) = opened?;
    faults.clear("bus");
    let daemon_id = if config.daemon.id.is_empty() { session.zid().to_string() } else { config.daemon.id.clone() };
    if let Ok(mut snapshot) = snapshot.write() {
        *snapshot = starting(&daemon_id, config);
    }
    // Samples that arrive during the refill wait in the queue.
    let input = (Budget::new(config.input.queue_bytes), Shares::default());
    let intake = Intake::new(queue, input.clone(), metrics.clone(), Clock::system());
    let subscriptions = Subscriptions::open(&session, config, intake).await?;
    Ok(Some(Opened { restored, session, deaf, daemon_id, input, subscriptions }))
}

/// The loops' windows as earlier runs left them; `None` if the daemon is stopped first.
pub(super) async fn refill(
    config: &Config,
    shared: &Shared,
    (origin, runs): (&str, &OwnRuns),
    stop: &mut (impl Future<Output = ()> + Unpin),
) -> Option<Refilled> {
    if !goes_on(origin) {
        return Some(Refilled::empty(config));
    }
    let reading = refill_in_background(config, runs, &shared.faults);
    unless_stopped(reading, ask_for_patience(&shared.faults, &shared.snapshot), stop).await
}

/// Whether a run continues from earlier ones. A demonstration starts from nothing.
fn goes_on(origin: &str) -> bool {
    origin == "run"
}

/// Waits for `work` and runs `meanwhile` at the same time; `None` if the daemon is stopped first.
pub(super) async fn unless_stopped<T>(
    work: impl Future<Output = T>,
    meanwhile: impl Future<Output = Infallible>,
    stop: &mut (impl Future<Output = ()> + Unpin),
) -> Option<T> {
    tokio::select! {
        done = work => Some(done),
        never = meanwhile => match never {},
        () = stop => None,
    }
}

/// Handles of the threads that consume the engine's results.
pub(super) struct Sinks {
    pub recorder: Recorder,
    /// `None` in a demonstration.
    pub state_writer: Option<StateWriter>,
    pub publisher: Publisher,
    pub outbox: Option<Outbox>,
    /// Dropping them ends the threads that have no queue.
    pub stops: [Sender<()>; 2],
}

/// Starts recorder, publisher, state store, retention, delivery and data health.
pub(super) fn threads(
    config: &Config,
    shared: &Shared,
    run: RunInfo,
    (mut restored, lock): (Restored, SharedLock),
    session: &zenoh::Session,
) -> anyhow::Result<(Vec<NamedThread>, Sinks)> {
    let Shared { current, recordings, metrics, faults, overview, last, .. } = shared;
    let (run_id, daemon_id, is_kept) = (run.run_id.clone(), run.daemon.clone(), goes_on(run.origin));
    restored.note_run(&config.site.prefix, &run_id);
    let counters = (metrics.clone(), faults.clone());
    let disk = Arc::new(LockedDisk::new(lock.clone())) as Arc<dyn Disk>;
    let (publisher, publishing) = Publisher::start(session.clone(), last.clone(), counters)?;
    let (recorder, recording) =
        Recorder::start(run, config.recording.clone(), disk.clone(), metrics.clone(), faults.clone())?;
    let mut threads = vec![("recorder", recording), ("publisher", publishing)];
    let prefix = &config.site.prefix;
    let (mut state_writer, mark) = (None, Mark::default());
    if is_kept {
        let stored = (restored.store, mark.clone());
        let (started, keeping) =
            StateWriter::start(recordings, prefix, stored, disk.clone(), faults.clone(), metrics.clone())?;
        state_writer = Some(started);
        threads.push(("state", keeping));
    }
    let (stop_retention, retention_stops) = crossbeam_channel::bounded::<()>(0);
    let parts = RetentionParts {
        dir: recordings.clone(),
        prefix: prefix.clone(),
        run_id,
        config: current.clone(),
        lock,
        notes: state_writer.as_ref().map(StateWriter::notes),
        verified: restored.verified,
        metrics: metrics.clone(),
        faults: faults.clone(),
        clock: Clock::system(),
    };
    threads.push((shutdown::RETENTION, retention::start(parts, retention_stops)?));
    let mut outbox = None;
    if let Some((started, keeping)) = Outbox::start(config, recordings, (disk, &mark), faults, metrics)? {
        outbox = Some(started);
        threads.push(("outbox", keeping));
    }
    let (stop_summaries, summaries_stop) = crossbeam_channel::bounded::<()>(0);
    let parts = DataHealthParts {
        config: current.clone(),
        overview: overview.clone(),
        publisher: publisher.clone(),
        outbox: outbox.clone(),
        notes: state_writer.as_ref().map(StateWriter::notes),
        daemon_id,
        clock: Clock::system(),
    };
    let worker = DataHealthWorker::new(parts, restored.data_health);
    threads.push(("data health", data_health::start(worker, summaries_stop)?));
    Ok((threads, Sinks { recorder, state_writer, publisher, outbox, stops: [stop_retention, stop_summaries] }))
}

/// Reads the memory of earlier runs on a separate thread: this may take minutes if the store is missing and the recordings are
/// large, and the daemon must handle signals meanwhile. It can be abandoned at any point without harm, and the daemon starts
/// whatever it finds.
async fn restore_in_background(config: &Config, faults: &Arc<Faults>, metrics: &Arc<Metrics>) -> Restored {
    let (dir, prefix) = (PathBuf::from(&config.recording.dir), config.site.prefix.clone());
    let (faults, metrics) = (faults.clone(), metrics.clone());
    let named = faults.clone();
    let read = move || {
        let restored = memory::restore(&SystemDisk, &dir, &prefix, &faults, &metrics);
        memory::report_aside(&dir, &faults);
        restored
    };
    tokio::task::spawn_blocking(read).await.unwrap_or_else(|error| {
        named.raise("restore", format!("earlier runs' alarm states could not be read, the log says where: {error}"));
        Restored::default()
    })
}

/// Reads the loops' windows on a separate thread; a failure leaves them empty.
async fn refill_in_background(config: &Config, runs: &OwnRuns, faults: &Arc<Faults>) -> Refilled {
    let (own, runs, named) = (config.clone(), runs.clone(), faults.clone());
    let now_ns = crate::runtime::clock::now_ns();
    let read = move || windows::refill(Path::new(&own.recording.dir), &own, &runs, now_ns, &named);
    tokio::task::spawn_blocking(read).await.unwrap_or_else(|error| {
        faults.raise("restore", format!("the loops' windows begin empty, the log says why: {error}"));
        Refilled::empty(config)
    })
}

/// While earlier runs are read: reports this in the health document, and extends the system's start timeout. Never returns.
async fn ask_for_patience(faults: &Faults, snapshot: &HealthSnapshot) -> Infallible {
    let until_next = u32::try_from((3 * STARTING_EVERY).as_micros()).unwrap_or(u32::MAX);
    loop {
        tokio::time::sleep(STARTING_EVERY).await;
        faults.raise_for("starting", "starting: what earlier runs remembered is being read", 2 * STARTING_EVERY);
        show_faults(faults, snapshot);
        notify_system(&[
            NotifyState::ExtendTimeoutUsec(until_next),
            NotifyState::Status("reads what earlier runs left"),
        ]);
    }
}

/// Shows faults in the health document before the engine runs.
fn show_faults(faults: &Faults, snapshot: &HealthSnapshot) {
    if let Ok(mut snapshot) = snapshot.write() {
        let health = DaemonHealth { faults: faults.list(), ..(*snapshot.1).clone() };
        *snapshot = (Instant::now(), Arc::new(health));
    }
}

/// While a client waits for its router, possibly for ever: reports a fault, and feeds the system's watchdog, which would
/// otherwise end the idle daemon. Never returns.
async fn wait_for_router(faults: &Faults, snapshot: &HealthSnapshot) -> Infallible {
    tokio::time::sleep(ROUTER_WITHIN).await;
    faults.raise("bus", "not connected to the bus: no router answers; retrying");
    notify_system(&[NotifyState::Ready, NotifyState::Status("waits for the router")]);
    let pause = sd_notify::watchdog_enabled().map_or(ROUTER_WITHIN, |period| period / 2);
    loop {
        show_faults(faults, snapshot);
        notify_system(&[NotifyState::Watchdog]);
        tokio::time::sleep(pause).await;
    }
}

/// Creates the folder and locks it against a second daemon, on a separate thread; `None` if the daemon is stopped while the
/// disk hangs.
pub(super) async fn lock(
    shared: &Shared,
    stop: &mut (impl Future<Output = ()> + Unpin),
) -> anyhow::Result<Option<SharedLock>> {
    let (dir, faults) = (shared.recordings.clone(), shared.faults.clone());
    let locking = tokio::task::spawn_blocking(move || lock_folder(&dir, &faults));
    match unless_stopped(locking, pending(), stop).await {
        Some(locked) => Ok(Some(SharedLock::new(locked??))),
        None => Ok(None),
    }
}

/// If the disk refuses, the daemon continues without a lock.
fn lock_folder(dir: &Path, faults: &Faults) -> anyhow::Result<Option<FolderLock>> {
    let made = std::fs::create_dir_all(dir);
    match FolderLock::take(dir) {
        Ok(lock) => Ok(Some(lock)),
        Err(held @ LockError::Held { .. }) => Err(held.into()),
        Err(error) => {
            let why = made.err().map_or_else(|| error.to_string(), |e| format!("{}: {e}", dir.display()));
            faults.raise("lock", why);
            Ok(None)
        }
    }
}
