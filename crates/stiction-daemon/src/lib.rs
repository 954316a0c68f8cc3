//! The whole daemon in one readable function: what runs where, and which queue lies between.
//!
//! ```text
//! Zenoh callbacks --(input, drops + counts)--> engine thread --(schedule, in turn; skips + records)--> workers
//!   |--(control, refuses; the page's, too)------->|    ^-------------(answers)----------------'
//!   |                                            |--(answers, never waits)--.
//!   '--(queries, refuses + counts)-----------------------------------------'--> replies thread --> Zenoh
//!                                                |--(gaps, refuses or skips + records)--> gap thread, last to get a core
//!                                                |--(comparisons, one at a time; left out + counted)--> plant thread, likewise
//!                                                |--(recorder, waits 2 s)--> recorder thread --> *.mcap
//!                                                |--(newest state a loop)--> state thread --> state.redb
//!                                                |--(outbox, 4,096; drops + counts)--> outbox thread --> outbox.redb, then a thread a receiver
//!                                                '--(publisher, newest of each key; counts)--> publisher thread --> Zenoh, last values
//! ```

mod bundles;
pub mod command_policy;
mod core;
mod data_health;
pub mod documents;
mod feeds;
pub mod gaps;
mod limits;
pub mod plant;
pub mod received;
mod refill;
mod reload;
pub mod replay;
mod replay_plant;
pub mod rerun;
pub mod restore;
pub mod retention;
mod routes;
mod schedule;
mod shutdown;
mod signals;
pub mod sim_daemon;
pub mod sink;
pub mod source;
mod worker;

use std::collections::{BTreeMap, HashSet};
use std::future::Future;
use std::path::{Path, PathBuf};
use std::sync::{Arc, RwLock};
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use sd_notify::NotifyState;

pub use self::core::to_json;
use self::core::{Core, Parts, tell_system};
use self::data_health::{DataHealthParts, DataHealthWorker};
use self::gaps::Diagnoser;
use self::plant::Comparer;
use self::refill::Refilled;
pub use self::reload::ConfigFile;
use self::reload::{Reload, ReloadParts};
use self::restore::Restored;
use self::retention::RetentionParts;
use crate::sink::deliver::Outbox;
use crate::sink::keeper::Keeper;
use crate::sink::recorder::{RecordedConfig, Recorder, RunInfo};
use crate::sink::signing::Signer;
use crate::sink::zenoh::Publisher;
use crate::source::askers::Askers;
use crate::source::queries::Queries;
use crate::source::replies::Replies;
use crate::source::shares::Shares;
use crate::source::zenoh::Subscriptions;
use crate::source::{CONTROL_QUEUE, Intake, presence};
use stiction_files::disk::SystemDisk;
use stiction_files::lock::{FolderLock, LockError};
use stiction_monitor::codec::topic;
use stiction_monitor::config::Config;
use stiction_runtime::clock::Clock;
use stiction_runtime::faults::Faults;
pub use stiction_runtime::health::DaemonHealth;
use stiction_runtime::health::HealthSnapshot;
use stiction_runtime::last_values::LastValues;
use stiction_runtime::metrics::Metrics;
use stiction_runtime::overview::Overview;
use stiction_runtime::queue::Budget;
use stiction_runtime::view::{CurrentConfig, Serve, View};

/// How long a router may take to answer before that is a fault.
const ROUTER_WITHIN: Duration = Duration::from_secs(5);
/// Requests about the configuration that may wait.
const CONFIG_REQUESTS: usize = 8;
/// How often a long start says that it goes on.
const STARTING_TOLD: Duration = Duration::from_secs(5);
/// How often the health documents are made, unless a test asks for less.
pub const HEALTH_EVERY: Duration = Duration::from_secs(5);
/// What the page says of a demonstration's data.
const SIMULATED: &str =
    "A simulated plant that runs 100 times as fast as a real one: its stamps run ahead of your clock.";
/// What a run is given besides its configuration.
#[derive(Debug, Clone)]
pub struct RunOptions {
    /// What makes the recordings: `run` or `demo`.
    pub origin: &'static str,
    /// Workers for fits; all cores but one if absent.
    pub workers: Option<usize>,
    /// The configuration's file, to be read again on a reload.
    pub config_file: Option<ConfigFile>,
    /// How often the health documents are made.
    pub health_every: Duration,
    /// What serves the page, the metrics and the health.
    pub serve: Serve,
}

impl RunOptions {
    /// Of a run of this origin, with the usual settings.
    #[must_use]
    pub const fn of(origin: &'static str, serve: Serve) -> Self {
        Self { origin, workers: None, config_file: None, health_every: HEALTH_EVERY, serve }
    }
}

/// Runs the daemon until `stop` is ready, then ends in order.
///
/// # Errors
/// Zenoh cannot start (a setting is refused), or the system refuses a thread.
pub async fn run(
    config: Config,
    config_text: String,
    options: RunOptions,
    stop: impl Future<Output = ()>,
) -> anyhow::Result<()> {
    let metrics = Arc::new(Metrics::default());
    let recordings = Path::new(&config.recording.dir).to_owned();
    let faults = Arc::new(Faults::default());
    let signer = signer_of(&config)?;
    signals::survive_file_size_limit();
    let hangups = signals::hangups();
    let lock = lock_folder(&recordings, &faults)?;
    let starting = |id: &str| (Instant::now(), Arc::new(DaemonHealth::starting(id, &config.hash())));
    let snapshot = HealthSnapshot::new(RwLock::new(starting("")));
    let last = LastValues::default();
    let (queue, incoming) = crossbeam_channel::bounded(config.input.queue);
    let (control, wishes) = crossbeam_channel::bounded(CONTROL_QUEUE);
    let overview = Overview::default();
    let is_shown = config.web.enabled && config.web.page.enabled;
    let current = CurrentConfig::new(config.clone());
    let (requests, wanted) = tokio::sync::mpsc::channel(CONFIG_REQUESTS);
    let view = View {
        config: current.clone(),
        overview: is_shown.then(|| overview.clone()),
        last: last.clone(),
        control: control.clone(),
        ask_config: Arc::new(move |request| requests.try_send(request).is_ok()),
        snapshot: snapshot.clone(),
        faults: faults.clone(),
        note: (options.origin == "demo").then_some(SIMULATED),
    };
    let server = (options.serve)(view, metrics.registry()).await?;
    tokio::pin!(stop);
    // A demonstration starts afresh.
    let restored = if options.origin == "run" {
        tokio::select! {
            restored = restore_in_background(&config, &faults, &metrics) => restored,
            () = ask_for_patience(&faults, &snapshot) => return Ok(()),
            () = &mut stop => {
                (server.stop)();
                return Ok(());
            }
        }
    } else {
        Restored::default()
    };
    restore::tell_aside(&recordings, &faults);
    let Restored { mut memories, store, run_number, verified, data_health } = restored;
    let named: HashSet<&str> = config.loops.iter().map(|l| l.name.as_str()).collect();
    memories.retain(|name, _| config.shard.owns(name) && (config.input.discover || named.contains(name.as_str())));
    // A client's session opens once its router is there, which may be never.
    let (session, deaf) = tokio::select! {
        opened = source::zenoh::open(&config) => opened?,
        () = wait_for_router(&faults, &snapshot) => return Ok(()),
        () = &mut stop => {
            (server.stop)();
            return Ok(());
        }
    };
    faults.clear("bus");
    let daemon_id = if config.daemon.id.is_empty() { session.zid().to_string() } else { config.daemon.id.clone() };
    if let Ok(mut snapshot) = snapshot.write() {
        *snapshot = starting(&daemon_id);
    }

    // Samples that arrive during the refill wait in the queue.
    let (budget, shares) = (Budget::new(config.input.queue_bytes), Shares::default());
    let intake = Intake::new(queue, (budget.clone(), shares.clone()), metrics.clone(), Clock::system());
    let subscriptions = Subscriptions::open(&session, &config, intake).await?;
    let Refilled { engine, continued } = if options.origin == "run" {
        tokio::select! {
            refilled = refill_in_background(&config, &faults) => refilled,
            () = ask_for_patience(&faults, &snapshot) => return Ok(()),
            () = &mut stop => {
                (server.stop)();
                return Ok(());
            }
        }
    } else {
        Refilled::empty(&config)
    };
    let (publisher, publishing) =
        Publisher::start(session.clone(), last.clone(), signer.clone(), (metrics.clone(), faults.clone()))?;
    let run = RunInfo { continued, ..run_info(&config, config_text, &options, &daemon_id, run_number) };
    let run_id = run.run_id.clone();
    let (recorder, recording) = Recorder::start(run, config.recording.clone(), metrics.clone(), faults.clone())?;
    let progress = recorder.progress();
    let mut threads = vec![("recorder", recording), ("publisher", publishing)];
    let mut keeper = None;
    if options.origin == "run" {
        let prefix = &config.site.prefix;
        let (started, keeping) = Keeper::start(&recordings, prefix, store, faults.clone(), metrics.clone())?;
        keeper = Some(started);
        threads.push(("state", keeping));
    }
    let (stop_retention, retention_stops) = crossbeam_channel::bounded::<()>(0);
    let parts = RetentionParts {
        dir: recordings.clone(),
        prefix: config.site.prefix.clone(),
        run_id,
        config: current.clone(),
        lock,
        notes: keeper.as_ref().map(Keeper::notes),
        verified,
        metrics: metrics.clone(),
        faults: faults.clone(),
        clock: Clock::system(),
    };
    threads.push((shutdown::RETENTION, retention::start(parts, retention_stops)?));
    let mut outbox = None;
    if let Some((started, keeping)) = Outbox::start(&config, &recordings, &faults, &metrics)? {
        outbox = Some(started);
        threads.push(("outbox", keeping));
    }
    let (stop_summaries, summaries_stop) = crossbeam_channel::bounded::<()>(0);
    let parts = DataHealthParts {
        config: current.clone(),
        overview: overview.clone(),
        publisher: publisher.clone(),
        outbox: outbox.clone(),
        notes: keeper.as_ref().map(Keeper::notes),
        daemon_id: daemon_id.clone(),
        clock: Clock::system(),
    };
    threads.push(("data health", data_health::start(DataHealthWorker::new(parts, data_health), summaries_stop)?));
    let workers = worker::start(options.workers)?;
    let waiting = workers.jobs.clone();
    let diagnoser = Diagnoser::start(move || !waiting.is_empty())?;
    let comparer = config.plant.groups.then(|| Comparer::start(&daemon_id)).transpose()?;

    let prefix = config.site.prefix.clone();
    let sign = signer.map(|signer| -> source::zenoh::Sign {
        Arc::new(move |key: &str, document: &[u8]| signer.attachment(key, document))
    });
    let askers = Askers::new(&config.commands);
    let replies = Replies::start(askers.clone(), last.clone(), sign, metrics.clone())?;
    let queries = Queries::new(&config, control.clone(), (replies, askers.clone()), metrics.clone());
    let queryables = queries.answer(&session, &daemon_id, &last).await?;
    let parts = Parts {
        engine: engine.of_daemon(&daemon_id),
        config: current.get(),
        input: (budget, shares),
        workers,
        diagnoser,
        comparer,
        recorder: Some(recorder),
        keeper,
        publisher,
        outbox,
        metrics: metrics.clone(),
        faults: faults.clone(),
        overview: Some(overview),
        snapshot,
        daemon_id: daemon_id.clone(),
        clock: Clock::system(),
        health_every: options.health_every,
    };
    let (stop_core, stopping) = crossbeam_channel::bounded::<()>(0);
    let core = std::thread::Builder::new().name("engine".into()).spawn(move || {
        let mut core = Core::new(parts);
        core.restore(memories);
        core.run(&incoming, &wishes, &stopping);
    })?;
    let mine = (prefix.as_str(), daemon_id.as_str(), config.shard);
    let foreign = presence::watch_own_keys(&session, mine, &faults, &metrics).await?;
    let bus = source::zenoh::session_config(&config)?;
    let listening: &[String] = if deaf.is_some() { &[] } else { &config.zenoh.listen };
    if let Some(why) = deaf {
        let why = presence::listener_problem(&config.zenoh.listen, &why);
        faults.raise(presence::LISTENING, format!("cannot open the Zenoh listener: {why}; retrying"));
        tokio::spawn(presence::watch_listening(session.clone(), bus.clone(), faults.clone()));
    }
    let watching =
        tokio::spawn(presence::watch(session.clone(), bus, (prefix.clone(), daemon_id.clone()), faults.clone()));
    let token_key = topic::plane(&prefix, &format!("@daemon/{daemon_id}"));
    let token = session.liveliness().declare_token(&token_key).await.map_err(|e| anyhow!("{token_key}: {e}"))?;
    tracing::info!(
        prefix,
        daemon = daemon_id,
        listen = ?listening,
        connect = ?config.zenoh.connect,
        web = server.address.map(|a| a.to_string()),
        recordings = %recordings.display(),
        "watching"
    );

    tell_system(&[NotifyState::Ready]);
    let (file, reached) = (options.config_file, control.clone());
    let mut reload =
        Reload::new(ReloadParts { file, current, control: reached, askers, subscriptions, faults: faults.clone() });
    threads.insert(0, ("engine", core));
    let unasked = tokio::select! {
        () = signals::serve_until(stop, (hangups, wanted), &mut reload) => None,
        name = shutdown::unasked_end(&threads) => Some(name),
    };
    tracing::info!("stopping");
    tell_system(&[NotifyState::Stopping]);
    watching.abort();
    drop(control);
    reload.close().await;
    for subscriber in foreign {
        let _ = subscriber.undeclare().await;
    }
    let _ = token.undeclare().await;
    drop((stop_core, stop_retention, stop_summaries));
    let ended = shutdown::join(threads, unasked, &progress).await;
    for queryable in queryables {
        let _ = queryable.undeclare().await;
    }
    (server.stop)();
    // Closing may hang when the network loses packets.
    let _ = tokio::time::timeout(Duration::from_secs(1), session.close()).await;
    ended
}

/// What earlier runs remembered, read on a thread of its own: it may take minutes where the store is gone and recordings
/// are large, and the daemon must hear signals meanwhile. Given up half way it leaves nothing half done, and whatever it
/// stumbles over, the daemon starts.
async fn restore_in_background(config: &Config, faults: &Arc<Faults>, metrics: &Arc<Metrics>) -> Restored {
    let (dir, prefix) = (PathBuf::from(&config.recording.dir), config.site.prefix.clone());
    let (faults, metrics) = (faults.clone(), metrics.clone());
    let named = faults.clone();
    let read = move || restore::restore(&SystemDisk, &dir, &prefix, &faults, &metrics);
    tokio::task::spawn_blocking(read).await.unwrap_or_else(|error| {
        named.raise("restore", format!("earlier runs' alarm states could not be read, the log says where: {error}"));
        Restored::default()
    })
}

/// The loops' windows, read on a thread of its own; a failure leaves them empty.
async fn refill_in_background(config: &Config, faults: &Arc<Faults>) -> Refilled {
    let (own, named) = (config.clone(), faults.clone());
    let read = move || refill::refill(Path::new(&own.recording.dir), &own, stiction_runtime::clock::now_ns(), &named);
    tokio::task::spawn_blocking(read).await.unwrap_or_else(|error| {
        faults.raise("restore", format!("the loops' windows begin empty, the log says why: {error}"));
        Refilled::empty(config)
    })
}

/// While earlier runs are read: says so in the health document, and keeps the system from taking the start for one that
/// hangs. Never ends.
async fn ask_for_patience(faults: &Faults, snapshot: &HealthSnapshot) {
    let until_next = u32::try_from((3 * STARTING_TOLD).as_micros()).unwrap_or(u32::MAX);
    loop {
        tokio::time::sleep(STARTING_TOLD).await;
        faults.raise_for("starting", "starting: what earlier runs remembered is being read", 2 * STARTING_TOLD);
        show_faults(faults, snapshot);
        tell_system(&[NotifyState::ExtendTimeoutUsec(until_next), NotifyState::Status("reads what earlier runs left")]);
    }
}

/// Puts the faults of a daemon whose engine does not run yet into its health document.
fn show_faults(faults: &Faults, snapshot: &HealthSnapshot) {
    if let Ok(mut snapshot) = snapshot.write() {
        let health = DaemonHealth { faults: faults.list(), ..(*snapshot.1).clone() };
        *snapshot = (Instant::now(), Arc::new(health));
    }
}

/// While a client waits for its router, which may be for ever: says so among the faults and to the system, whose watchdog
/// would else end a daemon that has nothing to do. Never ends.
async fn wait_for_router(faults: &Faults, snapshot: &HealthSnapshot) {
    tokio::time::sleep(ROUTER_WITHIN).await;
    faults.raise("bus", "not connected to the bus: no router answers; retrying");
    tell_system(&[NotifyState::Ready, NotifyState::Status("waits for the router")]);
    let pause = sd_notify::watchdog_enabled().map_or(ROUTER_WITHIN, |period| period / 2);
    loop {
        show_faults(faults, snapshot);
        tell_system(&[NotifyState::Watchdog]);
        tokio::time::sleep(pause).await;
    }
}

/// What signs documents, where the configuration names a key.
fn signer_of(config: &Config) -> anyhow::Result<Option<Arc<Signer>>> {
    if config.signing.key_file.is_empty() {
        return Ok(None);
    }
    let signer = Signer::read(Path::new(&config.signing.key_file)).context("[signing] key_file")?;
    tracing::info!(public_key = signer.public_key(), "documents are signed");
    Ok(Some(Arc::new(signer)))
}

/// Makes the folder and locks it against a second daemon. Where the disk refuses, the daemon goes on without.
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

fn run_info(config: &Config, config_text: String, options: &RunOptions, daemon_id: &str, run_number: u64) -> RunInfo {
    let started_ns = stiction_runtime::clock::now_ns();
    let seed = format!("{daemon_id} {started_ns}");
    let run_id = stiction_monitor::short_hash(seed.as_bytes())[..8].to_owned();
    RunInfo {
        prefix: config.site.prefix.clone(),
        run_id,
        started_ns,
        run_number: (run_number > 0).then_some(run_number),
        origin: options.origin,
        config: RecordedConfig::new(config, config_text),
        daemon: daemon_id.to_owned(),
        raw: config.recording.raw.clone(),
        continued: BTreeMap::new(),
    }
}
