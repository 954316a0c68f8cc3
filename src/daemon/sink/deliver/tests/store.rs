//! What survives a crash, a hanging disk and a broken store, and which document a failing receiver costs; without threads, on a
//! simulated clock.

use std::sync::atomic::{AtomicU64, Ordering};

use super::*;
use crate::daemon::sink::deliver::ledger::HELD;
use crate::daemon::sink::state_writer::{StateWriter, Worker as Keeping};
use stiction_files::store::{OUTBOX_NAME, STORE_NAME, Stored};

struct Calls<F>(F);

impl<F: FnMut(&Item) -> Result<(), Failure> + Send> Target for Calls<F> {
    fn send(&mut self, item: &Item) -> Result<(), Failure> {
        (self.0)(item)
    }
}

/// An outbox, with its other end held by the test.
pub(super) struct Held {
    pub outbox: Outbox,
    pub delivery: Delivery,
    pub faults: Arc<Faults>,
    pub metrics: Arc<Metrics>,
    clock: Clock,
    mark: Mark,
}

impl Held {
    fn new(dir: &Path, send: impl FnMut(&Item) -> Result<(), Failure> + Clone + Send + 'static) -> Self {
        Self::on(Clock::standing(1_700_000_000_000_000_000), dir, send)
    }

    pub fn on(
        clock: Clock,
        dir: &Path,
        send: impl FnMut(&Item) -> Result<(), Failure> + Clone + Send + 'static,
    ) -> Self {
        let (faults, metrics) = (Arc::new(Faults::new(clock.clone())), Arc::new(Metrics::default()));
        let mark = Mark::default();
        let place = (Arc::new(SystemDisk) as Arc<dyn Disk>, clock.clone(), mark.clone());
        let make = |_: &Deliver| -> MakeTarget {
            let send = send.clone();
            Box::new(move || Ok(Box::new(Calls(send.clone())) as Box<dyn Target>))
        };
        let receiver = config("[[deliver]]\nname = \"a\"\nto = \"http://127.0.0.1:1/\"\nqueue = 100\n");
        let (outbox, delivery) = Outbox::pair(&receiver, dir, place, make, &faults, &metrics).unwrap();
        Self { outbox, delivery, faults, metrics, clock, mark }
    }

    /// Writes what is pending; true if nothing waits any more.
    pub fn is_settled(&mut self) -> bool {
        self.delivery.store();
        self.delivery.keep.is_stored() && self.outbox.0.ledger.queues[0].len() == 0
    }

    /// One step of the receiver's thread and the pause after it; true if there was something to send.
    fn step(&mut self) -> bool {
        match self.delivery.workers[0].0.step(Duration::ZERO) {
            Step::Next => true,
            Step::Wait(pause) => {
                assert!(pause >= worker::FIRST_PAUSE, "{pause:?}");
                self.clock.advance(pause);
                true
            }
            Step::Idle | Step::Closed => false,
        }
    }
}

/// Content of a store as kill -9 leaves it.
fn left_in(dir: &Path, name: &str) -> Stored {
    let copy = dir.join("copy.redb");
    std::fs::copy(dir.join(name), &copy).unwrap();
    StateStore::open(&copy).unwrap().load().unwrap()
}

fn away(_: &Item) -> Result<(), Failure> {
    Err(Failure::Unanswered("away".to_owned()))
}

fn state_writer(dir: &Path, held: &Held) -> (StateWriter, Keeping) {
    let disk = Arc::new(SystemDisk);
    StateWriter::pair(dir, "p", (None, held.mark.clone()), disk, held.faults.clone(), held.metrics.clone())
}

#[test]
fn what_is_answered_outlives_a_kill_in_the_very_moment() {
    let dir = tempfile::tempdir().unwrap();
    let mut held = Held::new(dir.path(), away);
    let (state_writer, mut keeping) = state_writer(dir.path(), &held);
    let (tell, told) = std::sync::mpsc::channel();
    for k in 0..30 {
        held.outbox.offer(item(k));
        let (tell, at) = (tell.clone(), dir.path().to_owned());
        let answer = move |kept: Result<(), String>| {
            let documents = left_in(&at, OUTBOX_NAME).values;
            let state = left_in(&at, STORE_NAME).values["p\nA"].clone();
            tell.send((kept, documents.len(), state)).unwrap();
        };
        state_writer.keep_then("A", k.to_string().into(), held.clock.now(), Box::new(answer));
        // The state store is the faster one whenever it can be.
        keeping.turn();
        assert!(told.try_recv().is_err(), "answered, and its document is lost with a kill");
        held.delivery.store();
        keeping.turn();
        assert_eq!(told.try_recv().unwrap(), (Ok(()), k + 1, k.to_string().into_bytes()));
    }
}

#[test]
fn a_person_is_told_where_documents_cannot_be_stored_and_where_the_disk_does_not_answer() {
    let dir = tempfile::tempdir().unwrap();
    let mut held = Held::new(dir.path(), away);
    let (state_writer, mut keeping) = state_writer(dir.path(), &held);
    let (tell, told) = std::sync::mpsc::channel();
    let ask = |held: &Held| {
        let tell = tell.clone();
        held.outbox.offer(item(0));
        let answer = move |kept: Result<(), String>| tell.send(kept.map_err(|why| why.to_lowercase())).unwrap();
        state_writer.keep_then("A", b"1".to_vec(), held.clock.now(), Box::new(answer));
    };
    ask(&held);
    held.clock.advance(Duration::from_secs(2));
    state_writer.reply_late(held.clock.now());
    assert!(told.try_recv().is_err());
    held.clock.advance(Duration::from_secs(2));
    state_writer.reply_late(held.clock.now());
    assert!(told.try_recv().unwrap().unwrap_err().contains("has not answered for 4 s"));
    ask(&held);
    // Another program holds the document store under its old name; this one's was renamed.
    std::fs::rename(dir.path().join(OUTBOX_NAME), dir.path().join("x")).unwrap();
    let other = StateStore::open(&dir.path().join(OUTBOX_NAME)).unwrap();
    held.delivery.keep.forget_store();
    held.delivery.store();
    assert!(keeping.turn());
    assert!(told.try_recv().unwrap().unwrap_err().contains("cannot be kept"));
    assert!(left_in(dir.path(), STORE_NAME).values.contains_key("p\nA"), "the state is kept all the same");
    drop(other);
    held.delivery.store();
    assert_eq!(left_in(dir.path(), OUTBOX_NAME).values.len(), 2);
}

#[test]
fn a_disk_that_hangs_holds_a_document_for_a_second_and_the_oldest_of_too_many_goes() {
    let dir = tempfile::tempdir().unwrap();
    let sent = Arc::new(Mutex::new(Vec::new()));
    let took = sent.clone();
    let mut held = Held::new(dir.path(), move |item| {
        took.lock().unwrap().push(item.id.clone());
        Ok(())
    });
    held.outbox.offer(item(0));
    // The writing thread has taken it and hangs.
    let ledger = held.outbox.0.ledger.clone();
    let batch = ledger.take();
    assert!(!held.step() && held.outbox.stall().is_none());
    held.clock.advance(HELD);
    assert!(held.step());
    assert_eq!((sent.lock().unwrap().as_slice(), held.mark.look(1)), (["e0".to_owned()].as_slice(), None));
    (1..151).for_each(|k| held.outbox.offer(item(k)));
    assert!(held.outbox.stall().unwrap().contains(": 101 documents"), "{:?}", held.outbox.stall());
    assert_eq!(held.metrics.delivery_dropped.get(), 50);
    held.clock.advance(HELD);
    while held.step() {}
    let told = sent.lock().unwrap().clone();
    assert_eq!((told.len(), told[1].as_str()), (101, "e51"));
    ledger.stored(&batch);
    assert_eq!((held.mark.look(1), held.is_settled()), (Some(Ok(())), true));
}

#[test]
fn a_store_that_breaks_or_goes_under_the_run_gets_all_that_waits() {
    let dir = tempfile::tempdir().unwrap();
    let mut held = Held::new(dir.path(), away);
    (0..3).for_each(|k| held.outbox.offer(item(k)));
    held.delivery.store();
    assert_eq!(left_in(dir.path(), OUTBOX_NAME).values.len(), 3);
    held.delivery.keep.forget_store();
    std::fs::write(dir.path().join(OUTBOX_NAME), vec![7; 9000]).unwrap();
    held.outbox.offer(item(3));
    held.delivery.store();
    assert_eq!(left_in(dir.path(), OUTBOX_NAME).values.len(), 4);
    assert!(held.faults.list()[0].contains("put aside"), "{:?}", held.faults.list());
    std::fs::remove_file(dir.path().join(OUTBOX_NAME)).unwrap();
    held.delivery.store();
    assert_eq!(left_in(dir.path(), OUTBOX_NAME).values.len(), 4);
}

/// Offers documents of three loops to a receiver that gives these answers; returns what it took.
fn taken_by(answer: impl Fn(u64, &Item) -> Result<(), Failure> + Clone + Send + 'static) -> (Vec<String>, Held) {
    let dir = tempfile::tempdir().unwrap();
    let (asked, sent) = (Arc::new(AtomicU64::new(0)), Arc::new(Mutex::new(Vec::new())));
    let took = sent.clone();
    let mut held = Held::new(dir.path(), move |item| {
        answer(asked.fetch_add(1, Ordering::Relaxed), item)?;
        took.lock().unwrap().push(item.id.clone());
        Ok(())
    });
    (0..30).for_each(|k| held.outbox.offer(item_of(&format!("L{}", k % 3), k)));
    held.delivery.store();
    (0..20_000).take_while(|_| held.step()).count();
    held.delivery.store();
    assert_eq!(held.delivery.waiting(), 0);
    let sent = sent.lock().unwrap().clone();
    (sent, held)
}

#[test]
fn a_receiver_that_was_away_for_long_and_comes_back_in_part_costs_no_document() {
    let busy = || Err(Failure::Later("503".to_owned(), Some(Duration::ZERO)));
    // Down for many times the attempts of a day, then two machines of which one is down, then both up.
    let (sent, held) = taken_by(move |turn, item| match turn {
        0..3000 => away(item),
        3000..3200 if turn % 2 == 0 => busy(),
        _ => Ok(()),
    });
    assert_eq!((sent.len(), held.metrics.delivery_refused.get()), (30, 0));
    // Everything is refused for a while, and tried again at once.
    let (sent, held) = taken_by(move |turn, _| if turn < 15 { busy() } else { Ok(()) });
    assert_eq!((sent.len(), held.metrics.delivery_refused.get()), (30, 0));
    // One document is itself the problem.
    let (sent, held) = taken_by(move |_, item| if item.id == "e4" { busy() } else { Ok(()) });
    assert_eq!((sent.len(), held.metrics.delivery_refused.get()), (29, 1));
}
