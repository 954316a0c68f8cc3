//! Replies to queries over the bus: last documents, answers to commands, refusals.
//!
//! Sending waits for the reader, for up to five seconds until Zenoh closes its link. So it is done on separate threads, each
//! serving one link at a time: a reader that stops reading delays only its own replies, and once its link is closed the rest of
//! them is dropped. A wildcard query is not copied in advance: it goes through the last documents a few at a time. Replies have
//! a priority that no document has (see [`super::zenoh::session_config`]), because a publisher would wait behind one of its
//! priority.

use std::collections::{HashMap, VecDeque};
use std::mem::take;
use std::ops::Bound;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crossbeam_channel::Sender;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::key_expr::keyexpr;
use zenoh::query::Query;

use super::askers::{Askers, Link, WaitingSlot};
use super::zenoh::encoding_of;
use crate::runtime::last_values::{LastValue, LastValues};
use crate::runtime::metrics::Metrics;
use crate::runtime::queue::{Budget, Room};

/// Bytes of queries and replies that may wait, and of the queries beyond that which wait to be refused.
const WAITING_BYTES: usize = 32 << 20;
const SURPLUS_BYTES: usize = 8 << 20;
/// Most queries that may wait to be refused.
const SURPLUS: usize = 8192;
/// Pause between attempts when there is no room even for a refusal.
const ROOM_AGAIN: Duration = Duration::from_millis(10);
/// Most threads that send at a time. If that many links stop reading, others wait until one of them is closed.
const THREADS: usize = 64;
/// How long a thread waits for work before it ends.
const IDLE: Duration = Duration::from_secs(10);
/// A reply that took this long went to a link that stopped reading; Zenoh closes it.
const STUCK: Duration = Duration::from_secs(4);
/// Time limit of one query in total.
const QUERY_WITHIN: Duration = Duration::from_secs(120);
/// Replies to one link before it is the next link's turn.
const AT_ONCE: usize = 32;
/// Keys examined while the last documents are locked.
const KEYS_AT_ONCE: usize = 2048;

/// Content of a reply.
#[derive(Debug)]
pub enum Reply {
    /// A document under the query's own key.
    Document(Vec<u8>),
    /// A refusal, with its reason.
    Refusal(String),
    /// The last documents that the query selects.
    Last,
    /// Nothing.
    Nothing,
}

/// Destination of replies. Dropping it ends the query.
pub trait Outlet {
    /// The key expression of the query.
    fn asked(&self) -> &keyexpr;
    /// Sends a document under a key.
    fn document(&self, key: &str, value: LastValue);
    /// Sends a refusal with this reason.
    fn refusal(&self, why: &str);
}

impl Outlet for Query {
    fn asked(&self) -> &keyexpr {
        self.key_expr()
    }

    fn document(&self, key: &str, value: LastValue) {
        let reply = self.reply(key, value.document).encoding(encoding_of(key));
        if let Err(error) = reply.wait() {
            tracing::debug!(%key, %error, "a reply could not be sent");
        }
    }

    fn refusal(&self, why: &str) {
        if let Err(error) = self.reply_err(why).encoding(Encoding::TEXT_PLAIN).wait() {
            tracing::debug!(%error, "a refusal could not be sent");
        }
    }
}

/// Hands queries and replies to the threads.
#[derive(Clone)]
pub struct Replies {
    pool: Pool<Query>,
    surplus: Sender<(Query, Room)>,
    askers: Askers,
    budgets: [Budget; 2],
    metrics: Arc<Metrics>,
}

/// A query that waits for its reply. Dropped without one it ends without one, but never on the current thread.
pub struct PendingQuery {
    query: Option<Query>,
    place: Option<WaitingSlot>,
    room: Option<Room>,
    replies: Replies,
}

impl Replies {
    /// Replies from these last documents.
    ///
    /// # Errors
    /// The system refuses a thread.
    pub fn start(askers: Askers, last: LastValues, metrics: Arc<Metrics>) -> std::io::Result<Self> {
        let (surplus, refused) = crossbeam_channel::bounded::<(Query, Room)>(SURPLUS);
        std::thread::Builder::new().name("refusals".into()).spawn(move || {
            for (query, _room) in refused {
                query.refusal("too many queries wait for their answers: read those, then try again");
            }
        })?;
        let pool = Pool::new(last, metrics.clone());
        Ok(Self { pool, surplus, askers, budgets: [WAITING_BYTES, SURPLUS_BYTES].map(Budget::new), metrics })
    }

    /// Admits a query for a reply; `None` if its link has too many waiting.
    #[must_use]
    pub fn admit(&self, mut query: Query) -> Option<PendingQuery> {
        // Nobody reads what comes with a query, up to four megabytes, so it is not kept while the query waits.
        for unread in [query.payload_mut().map(take), query.attachment_mut().map(take)] {
            drop(unread);
        }
        let bytes = size_of::<Query>() + query.key_expr().len() + query.parameters().as_str().len();
        let [waiting, surplus] = &self.budgets;
        let place = self.askers.admit(Link::current());
        if let (Some(place), Some(room)) = (place, waiting.take(bytes)) {
            return Some(PendingQuery {
                query: Some(query),
                place: Some(place),
                room: Some(room),
                replies: self.clone(),
            });
        }
        self.metrics.queries_dropped.inc();
        let query = match surplus.take(bytes) {
            Some(room) => self.surplus.try_send((query, room)).err().map(|refused| refused.into_inner().0),
            None => Some(query),
        };
        if let Some(query) = query {
            // This link's task waits; Zenoh's thread continues with the tasks of others.
            tokio::task::block_in_place(|| self.wait_to_refuse(query, bytes));
        }
        None
    }

    /// Hands a query to the refusing thread once that has room. The query must not be dropped here: ending it sends a message,
    /// which would wait for the reader on the thread that also brings samples.
    fn wait_to_refuse(&self, query: Query, bytes: usize) {
        let bytes = bytes.min(SURPLUS_BYTES);
        let room = loop {
            if let Some(room) = self.budgets[1].take(bytes) {
                break room;
            }
            std::thread::sleep(ROOM_AGAIN);
        };
        let _ = self.surplus.send((query, room));
    }
}

impl PendingQuery {
    /// The query.
    #[must_use]
    pub const fn query(&self) -> Option<&Query> {
        self.query.as_ref()
    }

    /// The link it came from.
    #[must_use]
    pub fn link(&self) -> Link {
        self.place.as_ref().map_or(Link(0), WaitingSlot::link)
    }

    /// Answers it.
    pub fn reply(mut self, reply: Reply) {
        self.send(reply);
    }

    fn send(&mut self, reply: Reply) {
        let (Some(outlet), Some(place), Some(room)) = (self.query.take(), self.place.take(), self.room.take()) else {
            return;
        };
        let link = place.link();
        self.replies.pool.add(link, Job { outlet, left: Left::of(reply), begun: None, _held: Some((place, room)) });
    }
}

impl Drop for PendingQuery {
    fn drop(&mut self) {
        self.send(Reply::Nothing);
    }
}

/// The part of an answer still to be sent.
enum Left {
    Document(Vec<u8>),
    Refusal(String),
    Last(Cursor),
    Nothing,
}

impl Left {
    fn of(reply: Reply) -> Self {
        match reply {
            Reply::Document(json) => Self::Document(json),
            Reply::Refusal(why) => Self::Refusal(why),
            Reply::Last => Self::Last(Cursor::default()),
            Reply::Nothing => Self::Nothing,
        }
    }
}

/// A position in the last documents.
#[derive(Default)]
struct Cursor {
    after: Option<String>,
    over: bool,
}

impl Cursor {
    /// The next documents that an expression selects.
    fn next(&mut self, asked: &keyexpr, last: &LastValues) -> Vec<(String, LastValue)> {
        let last = last.read().unwrap_or_else(PoisonError::into_inner);
        if !asked.is_wild() {
            self.over = true;
            return last.get(asked.as_str()).map(|value| (asked.to_string(), value.clone())).into_iter().collect();
        }
        let literal = asked.as_str().split('*').next().unwrap_or_default().trim_end_matches('$');
        let from = self.after.as_deref().map_or(Bound::Included(literal), Bound::Excluded);
        let below = last.range::<str, _>((from, Bound::Unbounded)).take_while(|(key, _)| key.starts_with(literal));
        let mut found = Vec::new();
        for (looked, (key, value)) in below.enumerate() {
            if looked == KEYS_AT_ONCE || found.len() == AT_ONCE {
                return found;
            }
            self.after = Some(key.clone());
            if keyexpr::new(key).is_ok_and(|key| asked.intersects(key)) {
                found.push((key.clone(), value.clone()));
            }
        }
        self.over = true;
        found
    }
}

/// A reply being sent.
struct Job<O> {
    outlet: O,
    left: Left,
    /// When its first turn came.
    begun: Option<Instant>,
    /// Its slot and its share of the budget, while it waits.
    _held: Option<(WaitingSlot, Room)>,
}

impl<O: Outlet> Job<O> {
    /// Sends a part of it; returns the job if more is left.
    fn serve(mut self, last: &LastValues, metrics: &Metrics) -> Option<Self> {
        let begun = *self.begun.get_or_insert_with(Instant::now);
        match &mut self.left {
            Left::Nothing => None,
            Left::Refusal(why) => {
                self.outlet.refusal(why);
                None
            }
            Left::Document(json) => {
                let document = take(json);
                let key = self.outlet.asked();
                self.outlet.document(key.as_str(), LastValue { document: document.into() });
                None
            }
            Left::Last(_) if begun.elapsed() > QUERY_WITHIN => {
                metrics.queries_dropped.inc();
                self.outlet.refusal("this answer took too long: ask for less at a time");
                None
            }
            Left::Last(cursor) => {
                for (key, value) in cursor.next(self.outlet.asked(), last) {
                    self.outlet.document(&key, value);
                }
                (!cursor.over).then_some(self)
            }
        }
    }
}

/// Jobs for one link: short replies go before those that read many documents.
struct Lane<O> {
    short: VecDeque<Job<O>>,
    long: VecDeque<Job<O>>,
}

impl<O> Lane<O> {
    fn push(&mut self, job: Job<O>) {
        if matches!(job.left, Left::Last(_)) { self.long.push_back(job) } else { self.short.push_back(job) }
    }

    fn pop(&mut self) -> Option<Job<O>> {
        self.short.pop_front().or_else(|| self.long.pop_front())
    }

    fn len(&self) -> usize {
        self.short.len() + self.long.len()
    }
}

struct State<O> {
    /// Links with jobs waiting or being sent.
    lanes: HashMap<Link, Lane<O>>,
    /// Links that wait for a thread, in turn.
    ready: VecDeque<Link>,
    threads: usize,
    idle: usize,
}

struct Shared<O> {
    state: Mutex<State<O>>,
    wake: Condvar,
    last: LastValues,
    metrics: Arc<Metrics>,
}

/// The sending threads and their jobs. Clones share them.
struct Pool<O>(Arc<Shared<O>>);

impl<O> Clone for Pool<O> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<O: Outlet + Send + 'static> Pool<O> {
    fn new(last: LastValues, metrics: Arc<Metrics>) -> Self {
        let state = State { lanes: HashMap::new(), ready: VecDeque::new(), threads: 0, idle: 0 };
        Self(Arc::new(Shared { state: Mutex::new(state), wake: Condvar::new(), last, metrics }))
    }

    fn lock(&self) -> MutexGuard<'_, State<O>> {
        self.0.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a job; never waits for a reader.
    fn add(&self, link: Link, job: Job<O>) {
        let mut guard = self.lock();
        let state = &mut *guard;
        let ready = &mut state.ready;
        let lane = state.lanes.entry(link).or_insert_with(|| {
            ready.push_back(link);
            Lane { short: VecDeque::new(), long: VecDeque::new() }
        });
        lane.push(job);
        if state.ready.len() <= state.idle || state.threads >= THREADS {
            self.0.wake.notify_one();
            return;
        }
        state.threads += 1;
        drop(guard);
        let pool = self.clone();
        let started = std::thread::Builder::new().name("replies".into()).spawn(move || pool.work());
        if let Err(error) = started {
            tracing::error!(%error, "no thread for answers to queries; they wait for another");
            self.lock().threads -= 1;
        }
    }

    /// Serves one link after another, with a few replies at a time.
    fn work(&self) {
        while let Some((link, job)) = self.next() {
            let begun = Instant::now();
            let more = job.serve(&self.0.last, &self.0.metrics);
            let given_up = self.served(link, more, begun.elapsed() >= STUCK);
            self.0.metrics.queries_dropped.inc_by(given_up.len() as u64);
        }
    }

    fn next(&self) -> Option<(Link, Job<O>)> {
        let mut state = self.lock();
        loop {
            while let Some(link) = state.ready.pop_front() {
                if let Some(job) = state.lanes.get_mut(&link).and_then(Lane::pop) {
                    return Some((link, job));
                }
                state.lanes.remove(&link);
            }
            state.idle += 1;
            let (back, waited) = self.0.wake.wait_timeout(state, IDLE).unwrap_or_else(PoisonError::into_inner);
            state = back;
            state.idle -= 1;
            if waited.timed_out() && state.ready.is_empty() {
                state.threads -= 1;
                return None;
            }
        }
    }

    /// Gives a link another turn if it has jobs waiting. If it has stopped reading, its queue is dropped and its budget
    /// returned.
    fn served(&self, link: Link, more: Option<Job<O>>, stuck: bool) -> Vec<Job<O>> {
        let mut state = self.lock();
        let Some(lane) = state.lanes.get_mut(&link) else { return Vec::new() };
        if let Some(job) = more {
            lane.long.push_front(job);
        }
        let mut given_up = Vec::new();
        if stuck {
            given_up.extend(lane.short.drain(..).chain(lane.long.drain(..)));
        }
        if lane.len() > 0 {
            state.ready.push_back(link);
        } else {
            state.lanes.remove(&link);
        }
        given_up
    }
}

#[cfg(test)]
mod tests;
