//! Replies under load: order, budgets, slow readers.

use crossbeam_channel::{Receiver, Sender, unbounded};
use zenoh::key_expr::OwnedKeyExpr;

use super::*;
use stiction_engine::config::Commands;

const ALL: &str = "p/@stiction/v1/**";
/// Time limit for things that must happen, generous for a busy machine.
const PATIENCE: Duration = Duration::from_secs(60);

/// A reader, with what it has received. With `go` it takes one reply for each message in `go`, and otherwise stops reading.
#[derive(Clone)]
struct Reader {
    received: Sender<String>,
    go: Option<Receiver<()>>,
}

impl Reader {
    fn take(&self, what: String) {
        // When `go` is closed replies are lost, as Zenoh does with a reader that has stopped.
        if self.go.as_ref().is_none_or(|go| go.recv().is_ok()) {
            self.received.send(what).unwrap();
        }
    }
}

struct Query {
    asked: OwnedKeyExpr,
    reader: Reader,
}

impl Outlet for Query {
    fn asked(&self) -> &keyexpr {
        &self.asked
    }

    fn document(&self, key: &str, value: LastValue) {
        self.reader.take(format!("{key}={}", String::from_utf8_lossy(&value.document)));
    }

    fn refusal(&self, why: &str) {
        self.reader.take(why.to_owned());
    }
}

struct Bench {
    pool: Pool<Query>,
    askers: Askers,
    last: LastValues,
}

impl Bench {
    fn new(documents: usize) -> Self {
        let last = LastValues::default();
        let value = |k: usize| LastValue { document: k.to_string().into() };
        last.write().unwrap().extend((0..documents).map(|k| (format!("p/@stiction/v1/L{k:05}/alarm"), value(k))));
        let pool = Pool::new(last.clone(), Arc::default());
        Self { pool, askers: Askers::new(&Commands::default()), last }
    }

    fn ask(&self, link: u64, key: &str, reply: Reply, reader: &Reader) {
        let place = self.askers.admit(Link(link)).unwrap();
        let held = Some((place, Budget::new(1).take(1).unwrap()));
        let outlet = Query { asked: OwnedKeyExpr::new(key).unwrap(), reader: reader.clone() };
        self.pool.add(Link(link), Job { outlet, left: Left::of(reply), begun: None, _held: held });
    }

    /// Waits until only this many queries are left.
    fn wait_for(&self, left: usize) {
        let until = Instant::now() + PATIENCE;
        while self.askers.waiting() > left {
            assert!(Instant::now() < until, "{} are left", self.askers.waiting());
            std::thread::yield_now();
        }
    }
}

#[test]
fn readers_that_stand_still_hold_up_nobody_else() {
    let bench = Bench::new(5000);
    let (stuck, _never_read) = unbounded();
    let (go, gate) = unbounded::<()>();
    let standing = Reader { received: stuck, go: Some(gate) };
    for link in 1..=20 {
        (0..2).for_each(|_| bench.ask(link, ALL, Reply::Last, &standing));
        (0..20).for_each(|_| bench.ask(link, "p/@stiction/v1/X/alarm", Reply::Refusal("no".into()), &standing));
    }
    let (received, heard) = unbounded();
    let reader = Reader { received, go: None };
    bench.ask(99, "p/@stiction/v1/L00007/alarm", Reply::Document(b"acked".to_vec()), &reader);
    assert_eq!(heard.recv_timeout(PATIENCE).unwrap(), "p/@stiction/v1/L00007/alarm=acked");
    bench.ask(99, ALL, Reply::Last, &reader);
    let all: Vec<String> = (0..5000).map(|_| heard.recv_timeout(PATIENCE).unwrap()).collect();
    assert!(all.windows(2).all(|two| two[0] < two[1]), "each once, in the order of the keys");
    bench.wait_for(20 * 22);
    assert!(bench.pool.lock().threads <= THREADS);
    // Once their links are closed, everything is dropped.
    drop(go);
    bench.wait_for(0);
}

#[test]
fn a_slow_reader_gets_its_short_answers_first_and_what_is_there_at_the_time() {
    let bench = Bench::new(3000);
    let (go, gate) = unbounded();
    let (received, heard) = unbounded();
    let slow = Reader { received, go: Some(gate) };
    bench.ask(1, ALL, Reply::Last, &slow);
    go.send(()).unwrap();
    assert!(heard.recv_timeout(PATIENCE).unwrap().ends_with("=0"));
    bench.ask(1, "p/@stiction/v1/L00001/alarm", Reply::Document(b"acked".to_vec()), &slow);
    bench.last.write().unwrap().remove("p/@stiction/v1/L02999/alarm");
    (0..5000).for_each(|_| go.send(()).unwrap());
    bench.wait_for(0);
    let rest: Vec<String> = heard.try_iter().collect();
    assert_eq!(rest.len(), 2999);
    let place = rest.iter().position(|text| text.ends_with("acked")).unwrap();
    assert!(place < AT_ONCE, "{place}");
}

#[test]
fn what_waits_for_a_link_that_stood_still_too_long_is_given_back() {
    let bench = Bench::new(10);
    let (received, heard) = unbounded();
    let (go, gate) = unbounded::<()>();
    let slow = Reader { received, go: Some(gate) };
    (0..5).for_each(|_| bench.ask(1, ALL, Reply::Last, &slow));
    // One is being sent by a thread.
    bench.wait_for(5);
    let until = Instant::now() + PATIENCE;
    while bench.pool.lock().lanes[&Link(1)].len() > 4 {
        assert!(Instant::now() < until);
    }
    assert_eq!(bench.pool.served(Link(1), None, true).len(), 4);
    bench.wait_for(1);
    drop(go);
    bench.wait_for(0);
    assert!(heard.is_empty());
}

#[test]
fn a_key_without_a_wildcard_and_one_that_names_nothing_end() {
    let bench = Bench::new(10);
    let (received, heard) = unbounded();
    let reader = Reader { received, go: None };
    bench.ask(1, "p/@stiction/v1/none/alarm", Reply::Last, &reader);
    bench.ask(1, "p/@stiction/v1/*/estimate", Reply::Last, &reader);
    bench.ask(1, "p/@stiction/v1/L00004/gap", Reply::Nothing, &reader);
    bench.ask(1, "p/@stiction/v1/L00003/alarm", Reply::Last, &reader);
    bench.wait_for(0);
    assert_eq!(heard.try_iter().collect::<Vec<_>>(), ["p/@stiction/v1/L00003/alarm=3"]);
}

#[test]
fn what_a_query_brings_along_does_not_wait_with_it() {
    let mut settings = zenoh::Config::default();
    for (key, value) in [("scouting/multicast/enabled", "false"), ("listen/endpoints", "[]")] {
        settings.insert_json5(key, value).unwrap();
    }
    let session = zenoh::open(settings).wait().unwrap();
    let (pending, waiting) = unbounded();
    let replies = Replies::start(Askers::new(&Commands::default()), LastValues::default(), Arc::default()).unwrap();
    let budget = replies.budgets[0].clone();
    let admit = move |query| pending.send(replies.admit(query)).unwrap();
    let _queryable = session.declare_queryable("p/x").callback(admit).wait().unwrap();
    let large = || vec![7_u8; 1 << 20];
    let _answers = session.get("p/x").payload(large()).attachment(large()).wait().unwrap();
    let held = waiting.recv_timeout(PATIENCE).unwrap().unwrap();
    let query = held.query().unwrap();
    let bytes = [query.payload(), query.attachment()].map(|bytes| bytes.map_or(0, zenoh::bytes::ZBytes::len));
    assert_eq!((bytes, budget.used() < 1000), ([0, 0], true));
}
