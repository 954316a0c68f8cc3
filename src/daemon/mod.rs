//! The whole daemon: the threads, and the queues between them.
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

pub mod asyncapi;
mod bundles;
pub mod command_policy;
mod data_health;
pub mod documents;
mod engine_thread;
mod feeds;
pub mod gaps;
mod limits;
pub mod plant;
pub mod received;
mod reload;
pub mod replay;
pub mod retention;
mod routes;
mod schedule;
mod senders;
mod shutdown;
mod signals;
pub mod sim_daemon;
pub mod sink;
pub mod source;
mod start;
pub mod startup_state;
mod worker;

use std::collections::BTreeMap;
use std::future::{Future, pending};
use std::net::SocketAddr;
use std::path::Path;
use std::time::Duration;

use anyhow::anyhow;
use crossbeam_channel::{Receiver, Sender};
use sd_notify::NotifyState;
use tokio::task::JoinHandle;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::query::Queryable;

pub use self::engine_thread::to_json;
use self::engine_thread::{EngineThread, Parts, notify_system};
use self::gaps::Diagnoser;
use self::plant::Comparer;
pub use self::reload::ConfigFile;
use self::reload::{Reload, ReloadParts};
use self::replay::parallel::LastSeen;
use self::start::{Opened, Shared, Sinks};
use self::startup_state::memory::Memories;
use self::startup_state::windows::Refilled;
use crate::daemon::sink::recorder::{RecordedConfig, RunInfo};
use crate::daemon::source::askers::Askers;
use crate::daemon::source::queries::Queries;
use crate::daemon::source::replies::Replies;
use crate::daemon::source::{CONTROL_QUEUE, Message, descriptors, presence};
use crate::runtime::clock::Clock;
use crate::runtime::control::Control;
pub use crate::runtime::health::DaemonHealth;
use crate::runtime::view::Serve;
use stiction_engine::codec::topic;
use stiction_engine::config::Config;

/// How often the health documents are written, unless a test asks for less.
pub const HEALTH_EVERY: Duration = Duration::from_secs(5);

/// Settings of a run besides its configuration.
#[derive(Debug, Clone)]
pub struct RunOptions {
    /// Command that writes the recordings: `run` or `demo`.
    pub origin: &'static str,
    /// Number of workers for fits; all cores but one if absent.
    pub workers: Option<usize>,
    /// The configuration file, which a reload reads again.
    pub config_file: Option<ConfigFile>,
    /// How often the health documents are written.
    pub health_every: Duration,
    /// Serves the page, the metrics and the health.
    pub serve: Serve,
}

impl RunOptions {
    /// The usual settings for a run of this origin.
    #[must_use]
    pub const fn of(origin: &'static str, serve: Serve) -> Self {
        Self { origin, workers: None, config_file: None, health_every: HEALTH_EVERY, serve }
    }
}

/// Runs the daemon until `stop` is ready, then shuts down in order.
///
/// # Errors
/// Zenoh cannot start (a setting is refused), or the system refuses a thread.
pub async fn run(
    config: Config,
    config_text: String,
    options: RunOptions,
    stop: impl Future<Output = ()>,
) -> anyhow::Result<()> {
    let shared = Shared::of(&config);
    let Shared { metrics, faults, .. } = &shared;
    signals::survive_file_size_limit();
    let hangups = signals::hangups();
    tokio::pin!(stop);
    let Some(lock) = start::lock(&shared, &mut stop).await? else { return Ok(()) };
    let (queue, incoming) = crossbeam_channel::bounded(config.input.queue);
    let (control, requests) = crossbeam_channel::bounded(CONTROL_QUEUE);
    let view = shared.view(options.origin, control.clone());
    let serving = (options.serve)(view, metrics.registry());
    let Some(server) = start::unless_stopped(serving, pending(), &mut stop).await else { return Ok(()) };
    let server = server?;
    let Some(opened) = start::open(&config, &shared, options.origin, queue, &mut stop).await? else {
        (server.stop)();
        return Ok(());
    };
    let Opened { mut restored, session, deaf, daemon_id, input, subscriptions } = opened;
    let Some(refilled) = start::refill(&config, &shared, (options.origin, &restored.runs), &mut stop).await else {
        (server.stop)();
        return Ok(());
    };
    let Refilled { engine, continued, last } = refilled;
    let memories = restored.take_memories(&config);
    let run = run_info(&config, config_text, options.origin, &daemon_id, restored.run_number);
    let run = RunInfo { continued, ..run };
    let (mut threads, sinks) = start::threads(&config, &shared, run, (restored, lock), &session)?;
    let workers = worker::start(options.workers)?;
    let waiting = workers.jobs.clone();
    let diagnoser = Diagnoser::start(move || !waiting.is_empty())?;
    let comparer = config.plant.groups.then(|| Comparer::start(&daemon_id)).transpose()?;

    let askers = Askers::new(&config.commands);
    let on = (&session, daemon_id.as_str());
    let queryables = answer_queries(&config, &shared, &askers, &control, on).await?;
    let Sinks { recorder, state_writer, publisher, outbox, stops } = sinks;
    let progress = recorder.progress();
    let parts = Parts {
        engine: engine.of_daemon(&daemon_id),
        config: shared.current.get(),
        input,
        workers,
        diagnoser,
        comparer,
        recorder: Some(recorder),
        state_writer,
        publisher,
        outbox,
        metrics: metrics.clone(),
        faults: faults.clone(),
        overview: Some(shared.overview.clone()),
        snapshot: shared.snapshot.clone(),
        daemon_id: daemon_id.clone(),
        clock: Clock::system(),
        health_every: options.health_every,
    };
    let (stop_engine, engine_thread) = start_engine(parts, (memories, last), incoming, requests)?;
    threads.insert(0, ("engine", engine_thread));
    let presence = Presence::show(&session, &config, &daemon_id, deaf, &shared).await?;
    presence.announce(&config, &daemon_id, server.address, &shared.recordings);
    notify_system(&[NotifyState::Ready]);
    let (file, current, faults) = (options.config_file, shared.current.clone(), faults.clone());
    let mut reload =
        Reload::new(ReloadParts { file, current, control: control.clone(), askers, subscriptions, faults });
    let unasked = tokio::select! {
        () = signals::serve_until(stop, hangups, &mut reload) => None,
        name = shutdown::unasked_end(&threads) => Some(name),
    };
    tracing::info!("stopping");
    notify_system(&[NotifyState::Stopping]);
    presence.watching.iter().for_each(JoinHandle::abort);
    drop(control);
    reload.close().await;
    presence.end().await;
    drop((stop_engine, stops));
    let ended = shutdown::join(threads, unasked, &progress).await;
    for queryable in queryables {
        let _ = queryable.undeclare().await;
    }
    (server.stop)();
    // Closing may hang if the network loses packets.
    let _ = tokio::time::timeout(Duration::from_secs(1), session.close()).await;
    ended
}

/// The engine's thread, which ends when the sender is dropped.
fn start_engine(
    parts: Parts,
    (memories, last): (Memories, BTreeMap<String, LastSeen>),
    incoming: Receiver<Message>,
    requests: Receiver<Control>,
) -> std::io::Result<(Sender<()>, std::thread::JoinHandle<()>)> {
    let (stop, stopping) = crossbeam_channel::bounded::<()>(0);
    let thread = std::thread::Builder::new().name("engine".into()).spawn(move || {
        let mut engine = EngineThread::new(parts);
        engine.restore(memories, last);
        engine.run(&incoming, &requests, &stopping);
    })?;
    Ok((stop, thread))
}

/// Answers queries on the bus until the queryables are dropped.
async fn answer_queries(
    config: &Config,
    shared: &Shared,
    askers: &Askers,
    control: &Sender<Control>,
    (session, daemon_id): (&zenoh::Session, &str),
) -> anyhow::Result<Vec<Queryable<()>>> {
    let Shared { metrics, last, .. } = shared;
    let replies = Replies::start(askers.clone(), last.clone(), metrics.clone())?;
    let queries = Queries::new(config, control.clone(), (replies, askers.clone()), metrics.clone());
    queries.answer(session, daemon_id, last).await
}

/// What the daemon announces on the bus, and the others it sees there.
struct Presence {
    /// Endpoints on which it listens or tries to.
    listening: Vec<String>,
    foreign: [Subscriber<()>; 2],
    watching: [JoinHandle<()>; 2],
    token: LivelinessToken,
}

impl Presence {
    async fn show(
        session: &zenoh::Session,
        config: &Config,
        daemon_id: &str,
        deaf: Option<String>,
        shared: &Shared,
    ) -> anyhow::Result<Self> {
        let (prefix, faults) = (&config.site.prefix, &shared.faults);
        let mine = (prefix.as_str(), daemon_id, config.shard);
        let foreign = presence::watch_own_keys(session, mine, faults, &shared.metrics).await?;
        let bus = source::zenoh::session_config(config)?;
        let open = if deaf.is_some() { " (not open; retrying)" } else { "" };
        let listening = config.zenoh.listen.iter().map(|endpoint| format!("{endpoint}{open}")).collect();
        if let Some(why) = deaf {
            let why = presence::listener_problem(&config.zenoh.listen, &why);
            faults.raise(presence::LISTENING, format!("cannot open the Zenoh listener: {why}; retrying"));
            tokio::spawn(presence::watch_listening(session.clone(), bus.clone(), faults.clone()));
        }
        let own = (prefix.clone(), daemon_id.to_owned());
        let watching = [
            tokio::spawn(presence::watch(session.clone(), bus, own, faults.clone())),
            tokio::spawn(descriptors::watch(faults.clone())),
        ];
        let key = topic::plane(prefix, &format!("@daemon/{daemon_id}"));
        let token = session.liveliness().declare_token(&key).await.map_err(|e| anyhow!("{key}: {e}"))?;
        Ok(Self { listening, foreign, watching, token })
    }

    /// Logs that the daemon is running, and its addresses.
    fn announce(&self, config: &Config, daemon_id: &str, web: Option<SocketAddr>, recordings: &Path) {
        tracing::info!(
            prefix = config.site.prefix,
            daemon = daemon_id,
            listen = ?self.listening,
            connect = ?config.zenoh.connect,
            web = web.map(|a| a.to_string()),
            recordings = %recordings.display(),
            "watching"
        );
    }

    async fn end(self) {
        for subscriber in self.foreign {
            let _ = subscriber.undeclare().await;
        }
        let _ = self.token.undeclare().await;
    }
}

fn run_info(config: &Config, config_text: String, origin: &'static str, daemon_id: &str, run_number: u64) -> RunInfo {
    let started_ns = crate::runtime::clock::now_ns();
    let seed = format!("{daemon_id} {started_ns}");
    let run_id = stiction_engine::short_hash(seed.as_bytes())[..8].to_owned();
    RunInfo {
        prefix: config.site.prefix.clone(),
        run_id,
        started_ns,
        run_number: (run_number > 0).then_some(run_number),
        origin,
        config: RecordedConfig::new(config, config_text),
        daemon: daemon_id.to_owned(),
        raw: config.recording.raw,
        continued: BTreeMap::new(),
    }
}
