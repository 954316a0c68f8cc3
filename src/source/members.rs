//! Who is alive, and what follows for this daemon's loops: which keys are subscribed to, which loops are taken. One thread,
//! which tells the engine's; the engine decides nothing of this and records all of it.
//!
//! A member says that it lives by a liveliness token. Once the list of tokens has been still for a while, each member works
//! out for itself whose loops are whose. What the loops' owners remember of them they publish under `{loop}/state`, and every
//! member keeps those that it may inherit. A daemon whose bus is gone moves nothing: it would take all loops and hear none.

use std::collections::{BTreeMap, HashMap, HashSet, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::anyhow;
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender};
use zenoh::Wait;
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::{Sample as BusSample, SampleKind};

use super::own::{Own, carriers, keys_of};
use super::refill::{self, Past};
use super::zenoh::enqueue;
use super::{Incoming, Intake};
use stiction_monitor::codec::topic::{self, Leaf, Topic};
use stiction_monitor::config::Config;
use stiction_monitor::engine::{Checkpoint, StateDocument};
use stiction_monitor::ownership::Debounce;

/// How often the thread looks around where nothing happens.
const EVERY: Duration = Duration::from_millis(200);
/// How long others may take to say what they remember, before a member joins.
const STATES_WITHIN: Duration = Duration::from_secs(2);
/// Loops whose past is asked for at one time.
const ASKED_AT_ONCE: usize = 64;
/// How long the engine may take to hear of a change.
const ENGINE_WITHIN: Duration = Duration::from_secs(10);
/// Failures at one time after which a loop's memory is still with somebody.
const FAILURES: usize = 2;

/// What happens around the thread.
#[derive(Debug)]
pub enum Seen {
    /// A member has come, or gone.
    Member(String, bool),
    /// What a loop's owner remembers of it.
    State(Vec<u8>),
    /// A loop sends something.
    Loop(String),
    /// What a loop sent before.
    Past(String, Vec<Past>),
    /// All states that were asked for are here.
    StatesAsked,
}

/// What the engine is told.
#[derive(Debug)]
pub enum Change {
    /// Loops have other owners: those that are no longer this daemon's are to be released.
    Owners,
    /// A loop is this daemon's.
    Take {
        /// Its name.
        loop_name: String,
        /// What its last owner remembered.
        memory: Option<Box<Checkpoint>>,
        /// Its past is asked for: what it sends is held back until that is there.
        past_follows: bool,
    },
    /// What a loop sent before.
    Past {
        /// Its name.
        loop_name: String,
        /// Its messages, in no order.
        messages: Vec<Past>,
    },
}

/// What is known of a loop, whoever has it.
#[derive(Default)]
struct Known {
    /// The newest memory that was heard of, JSON, and how far it has come.
    memory: Option<(Progress, Vec<u8>)>,
}

/// How far a memory has come: the end of its last window, ns, and the commands carried out since.
type Progress = (Option<i64>, u64);

type Subscriber = zenoh::pubsub::Subscriber<()>;

/// What the thread is made of.
pub struct Parts {
    /// The bus.
    pub session: zenoh::Session,
    /// The configuration.
    pub config: Arc<Config>,
    /// This daemon's id.
    pub daemon_id: String,
    /// Which loops are its own.
    pub own: Own,
    /// Where samples go.
    pub intake: Intake,
    /// Where changes go.
    pub engine: Sender<Incoming>,
    /// What this daemon remembered of loops when it last ran.
    pub memories: BTreeMap<String, Checkpoint>,
}

struct Members {
    parts: Parts,
    carriers: Vec<String>,
    seen: Receiver<Seen>,
    tell: Sender<Seen>,
    started: Instant,
    list: Debounce,
    linked: bool,
    known: BTreeMap<String, Known>,
    /// Subscriptions of the loops that this daemon has.
    taken: HashMap<String, Vec<Subscriber>>,
    waiting: VecDeque<String>,
    asked: HashSet<String>,
    /// While loops are looked for: until when.
    looking: Option<(Subscriber, Instant)>,
    next_look: Instant,
}

/// Starts the thread; it ends once `stop` is closed.
///
/// # Errors
/// The bus refuses a key, or the system a thread.
pub fn start(parts: Parts, stop: Receiver<()>) -> anyhow::Result<JoinHandle<()>> {
    let (tell, seen) = crossbeam_channel::unbounded();
    let now = Instant::now();
    let mut members = Members {
        carriers: carriers(&parts.config),
        list: Debounce::new(parts.config.cluster.debounce_s),
        seen,
        tell,
        started: now,
        linked: false,
        known: BTreeMap::new(),
        taken: HashMap::new(),
        waiting: VecDeque::new(),
        asked: HashSet::new(),
        looking: None,
        next_look: now,
        parts,
    };
    members.know_at_start();
    let thread = std::thread::Builder::new().name("members".into());
    Ok(thread.spawn(move || {
        if let Err(error) = members.run(&stop) {
            tracing::error!(%error, "the thread of the members ends");
        }
    })?)
}

impl Members {
    /// Loops that the configuration names, and what was remembered of others.
    fn know_at_start(&mut self) {
        let named: Vec<String> = self.parts.config.loops.iter().map(|l| l.name.clone()).collect();
        for name in named {
            self.known.entry(name).or_default();
        }
        for (name, memory) in std::mem::take(&mut self.parts.memories) {
            let progress = memory.alarm.progress();
            let json = serde_json::to_vec(&StateDocument::new(&name, progress.0, memory)).unwrap_or_default();
            self.known.entry(name).or_default().memory = Some((progress, json));
        }
    }

    fn run(&mut self, stop: &Receiver<()>) -> anyhow::Result<()> {
        let shared = self.parts.own.is_shared();
        let _carried = self.carriers.clone().iter().map(|key| self.listen(key)).collect::<anyhow::Result<Vec<_>>>()?;
        let _joined = if shared { Some(self.join(stop)?) } else { None };
        if !shared {
            self.go_through();
        }
        loop {
            match self.seen.recv_timeout(self.wait()) {
                Ok(seen) => {
                    self.take(seen);
                    // A storm of states must not be answered one by one.
                    while let Ok(seen) = self.seen.try_recv() {
                        self.take(seen);
                    }
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Ok(()),
            }
            if matches!(stop.try_recv(), Err(crossbeam_channel::TryRecvError::Disconnected)) {
                return Ok(());
            }
            if shared {
                self.settle();
            }
            self.ask_for_pasts();
            self.look_for_loops()?;
        }
    }

    fn wait(&self) -> Duration {
        let settles_s = self.list.wait_s(self.started.elapsed().as_secs_f64()).filter(|_| self.linked);
        settles_s.map_or(EVERY, |wait_s| EVERY.min(Duration::from_secs_f64(wait_s)))
    }

    /// Subscribes to a key of the plant.
    fn listen(&self, key: &str) -> anyhow::Result<Subscriber> {
        let intake = self.parts.intake.clone();
        let declared =
            self.parts.session.declare_subscriber(key).callback(move |sample| enqueue(&sample, &intake)).wait();
        declared.map_err(|e| anyhow!("cannot subscribe to {key:?}: {e}"))
    }

    /// Learns what the others remember, then says that this daemon is there. What it gives keeps it there.
    fn join(&mut self, stop: &Receiver<()>) -> anyhow::Result<Box<dyn std::any::Any>> {
        let (session, prefix) = (self.parts.session.clone(), self.parts.config.site.prefix.clone());
        let of = |key: &str, error: zenoh::Error| anyhow!("cannot join the cluster by {key:?}: {error}");
        let states = topic::plane(&prefix, "**/state");
        let tell = self.tell.clone();
        let hear = move |sample: BusSample| {
            if sample.kind() == SampleKind::Put {
                let _ = tell.send(Seen::State(sample.payload().to_bytes().into_owned()));
            }
        };
        let hearing = session.declare_subscriber(&states).allowed_origin(zenoh::sample::Locality::Remote);
        let hearing = hearing.callback(hear).wait().map_err(|e| of(&states, e))?;
        self.ask_for_states(&states, stop)?;
        let all = topic::plane(&prefix, &format!("@cluster/{}/*", self.parts.config.cluster.name));
        let tell = self.tell.clone();
        let watch = move |sample: BusSample| {
            let Some(id) = sample.key_expr().as_str().rsplit('/').next() else { return };
            let _ = tell.send(Seen::Member(id.to_owned(), sample.kind() == SampleKind::Put));
        };
        let own =
            topic::plane(&prefix, &format!("@cluster/{}/{}", self.parts.config.cluster.name, self.parts.daemon_id));
        let token = session.liveliness().declare_token(&own).wait().map_err(|e| of(&own, e))?;
        let watching = session.liveliness().declare_subscriber(&all).history(true).callback(watch).wait();
        let watching = watching.map_err(|e| of(&all, e))?;
        self.take(Seen::Member(self.parts.daemon_id.clone(), true));
        Ok(Box::new((hearing, token, watching)))
    }

    fn ask_for_states(&mut self, key: &str, stop: &Receiver<()>) -> anyhow::Result<()> {
        /// Says that the answers have ended, however they do.
        struct Ends(Sender<Seen>);
        impl Drop for Ends {
            fn drop(&mut self) {
                let _ = self.0.send(Seen::StatesAsked);
            }
        }
        let ends = Ends(self.tell.clone());
        let hear = move |reply: zenoh::query::Reply| {
            if let Ok(sample) = reply.result() {
                let _ = ends.0.send(Seen::State(sample.payload().to_bytes().into_owned()));
            }
        };
        let asked = self.parts.session.get(key).target(QueryTarget::All).consolidation(ConsolidationMode::None);
        asked.timeout(STATES_WITHIN).callback(hear).wait().map_err(|e| anyhow!("{key}: {e}"))?;
        let until = Instant::now() + 2 * STATES_WITHIN;
        while Instant::now() < until && !matches!(stop.try_recv(), Err(crossbeam_channel::TryRecvError::Disconnected)) {
            match self.seen.recv_timeout(EVERY) {
                Ok(Seen::StatesAsked) => break,
                Ok(seen) => self.take(seen),
                Err(_) => {}
            }
        }
        Ok(())
    }

    fn take(&mut self, seen: Seen) {
        match seen {
            Seen::Member(id, alive) => {
                // Its own token may be lost with the link; this daemon knows that it lives.
                if alive || id != self.parts.daemon_id {
                    self.list.tell(&id, alive, self.started.elapsed().as_secs_f64());
                }
            }
            Seen::State(json) => self.learn_state(json),
            Seen::Loop(name) => self.learn_loop(name),
            Seen::Past(loop_name, messages) => {
                self.asked.remove(&loop_name);
                if self.taken.contains_key(&loop_name) {
                    self.tell_engine(Change::Past { loop_name, messages });
                }
            }
            Seen::StatesAsked => {}
        }
    }

    fn learn_loop(&mut self, name: String) {
        if self.known.len() >= self.parts.config.input.max_loops || self.known.contains_key(&name) {
            return;
        }
        self.known.insert(name.clone(), Known::default());
        if self.parts.own.has(&name) {
            self.waiting.push_back(name);
        }
    }

    fn learn_state(&mut self, json: Vec<u8>) {
        let Ok(state) = serde_json::from_slice::<StateDocument>(&json) else { return };
        let (name, progress) = (state.loop_name, state.checkpoint.alarm.progress());
        self.learn_loop(name.clone());
        let Some(known) = self.known.get_mut(&name) else { return };
        if known.memory.as_ref().is_none_or(|(had, _)| *had <= progress) {
            known.memory = Some((progress, json));
        }
    }

    /// Draws the conclusions once the list of members is still.
    fn settle(&mut self) {
        let now_s = self.started.elapsed().as_secs_f64();
        let linked = self.is_linked();
        if linked && !self.linked {
            self.list.touch(now_s);
        }
        self.linked = linked;
        if !linked {
            return;
        }
        let Some(live) = self.list.settle(now_s) else { return };
        tracing::info!(members = ?live.ids().collect::<Vec<_>>(), "the members of the cluster");
        self.parts.own.share_among(live.clone());
        let own = self.parts.own.clone();
        self.taken.retain(|name, _| own.has(name));
        self.tell_engine(Change::Owners);
        // What cannot be inherited need not be remembered.
        for (name, known) in &mut self.known {
            if !live.may_inherit(&self.parts.daemon_id, name, FAILURES) {
                known.memory = None;
            }
        }
        self.go_through();
    }

    /// Whether anybody is at the other end of the bus.
    fn is_linked(&self) -> bool {
        let info = self.parts.session.info();
        info.routers_zid().wait().next().is_some() || info.peers_zid().wait().next().is_some()
    }

    /// Every loop that is this daemon's and not taken yet waits to be.
    fn go_through(&mut self) {
        let (own, taken) = (&self.parts.own, &self.taken);
        self.waiting = self.known.keys().filter(|name| own.has(name) && !taken.contains_key(*name)).cloned().collect();
    }

    /// Takes loops that wait, so many at a time that their pasts do not come all at once.
    fn ask_for_pasts(&mut self) {
        let cluster = self.parts.config.cluster.clone();
        let asks = self.parts.own.is_shared() && cluster.refill_s > 0.0;
        while self.asked.len() < ASKED_AT_ONCE {
            let Some(name) = self.waiting.pop_front() else { return };
            if !self.parts.own.has(&name) || self.taken.contains_key(&name) {
                continue;
            }
            if self.parts.own.is_shared() {
                self.tell_engine(Change::Take {
                    loop_name: name.clone(),
                    memory: self.memory_of(&name),
                    past_follows: asks,
                });
            }
            let keys = keys_of(&self.parts.config, &self.carriers, &name);
            let subscribers: anyhow::Result<Vec<Subscriber>> = keys.iter().map(|key| self.listen(key)).collect();
            match subscribers {
                Ok(subscribers) => drop(self.taken.insert(name.clone(), subscribers)),
                Err(error) => tracing::error!(name, %error, "a loop cannot be watched"),
            }
            if asks {
                self.asked.insert(name.clone());
                let within = Duration::from_secs_f64(cluster.refill_within_s);
                let tell = self.tell.clone();
                refill::ask(&self.parts.session, &name, &keys, (cluster.refill_s, within), move |name, messages| {
                    let _ = tell.send(Seen::Past(name, messages));
                });
            }
        }
    }

    fn memory_of(&self, name: &str) -> Option<Box<Checkpoint>> {
        let (_, json) = self.known.get(name)?.memory.as_ref()?;
        let state: StateDocument = serde_json::from_slice(json).ok()?;
        Some(Box::new(Checkpoint { stream: None, ..state.checkpoint }))
    }

    fn tell_engine(&self, change: Change) {
        if self.parts.engine.send_timeout(Incoming::Shared(Box::new(change)), ENGINE_WITHIN).is_err() {
            tracing::error!("the engine did not hear of a change of the cluster");
        }
    }

    /// From time to time everything under the prefix is heard, for the names alone.
    fn look_for_loops(&mut self) -> anyhow::Result<()> {
        let now = Instant::now();
        if self.looking.as_ref().is_some_and(|(_, until)| now >= *until) {
            self.looking = None;
            self.next_look = now + Duration::from_secs_f64(self.parts.config.cluster.discover_every_s);
        }
        if !self.parts.config.input.discover || self.looking.is_some() || now < self.next_look {
            return Ok(());
        }
        let (prefix, tell) = (self.parts.config.site.prefix.clone(), self.tell.clone());
        let key = format!("{prefix}/**");
        let told: Mutex<HashSet<String>> = Mutex::new(self.known.keys().cloned().collect());
        let look = move |sample: BusSample| {
            let Some(Topic { loop_name, leaf: Leaf::Raw(_), .. }) =
                Topic::parse(Some(&prefix), sample.key_expr().as_str())
            else {
                return;
            };
            let mut told = told.lock().unwrap_or_else(PoisonError::into_inner);
            if !told.contains(loop_name) {
                told.insert(loop_name.to_owned());
                let _ = tell.send(Seen::Loop(loop_name.to_owned()));
            }
        };
        let subscriber = self.parts.session.declare_subscriber(&key).callback(look).wait();
        let subscriber = subscriber.map_err(|e| anyhow!("cannot subscribe to {key:?}: {e}"))?;
        self.looking = Some((subscriber, now + Duration::from_secs_f64(self.parts.config.cluster.discover_for_s)));
        Ok(())
    }
}
