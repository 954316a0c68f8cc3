//! Receivers that fail, recover or never respond, across restarts.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpListener;
use std::sync::Mutex;
use std::time::Instant;

use super::dead::DeadLetters;
use super::*;
use stiction_engine::alarm::{Alarm, LoopContext};
use stiction_files::disk::SystemDisk;
use stiction_files::store::StateStore;

mod store;

/// Waits until the condition gives a value.
fn wait_for<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let until = Instant::now() + Duration::from_secs(30);
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(Instant::now() < until, "{what} did not come");
        std::thread::sleep(Duration::from_millis(10));
    }
}

fn config(receivers: &str) -> Config {
    Config::parse(&format!("[site]\nprefix = \"plant 1/a\"\n{receivers}")).unwrap()
}

fn item(k: usize) -> Item {
    item_of("FIC101", k)
}

fn item_of(loop_name: &str, k: usize) -> Item {
    let mut document = Alarm::default()
        .restored(loop_name)
        .at(&LoopContext { area: Some("A \"1\"".into()), ..LoopContext::default() });
    (document.event_id, document.changed) = (format!("e{k}"), "2026-01-05T08:15:00Z".to_owned());
    let json = serde_json::to_vec(&document).unwrap();
    Item::alarm("plant 1/a", &document, &json)
}

struct Running {
    outbox: Option<Outbox>,
    keeping: Option<JoinHandle<()>>,
    faults: Arc<Faults>,
    metrics: Arc<Metrics>,
}

impl Running {
    fn start(dir: &Path, receivers: &str) -> Self {
        let (faults, metrics) = (Arc::new(Faults::default()), Arc::new(Metrics::default()));
        let (outbox, keeping) =
            Outbox::start(&config(receivers), dir, (Arc::new(SystemDisk), &Mark::default()), &faults, &metrics)
                .unwrap()
                .unwrap();
        Self { outbox: Some(outbox), keeping: Some(keeping), faults, metrics }
    }

    fn offer(&self, numbers: std::ops::Range<usize>) {
        numbers.for_each(|k| self.outbox.as_ref().unwrap().offer(item(k)));
    }

    fn stop(mut self) {
        drop(self.outbox.take());
        self.keeping.take().unwrap().join().unwrap();
    }
}

/// A webhook request: head and body.
type Request = (String, serde_json::Value);

/// An HTTP server that gives these answers in turn and then repeats the last one; for `None` it hangs up.
fn web_server(listener: TcpListener, answers: Vec<Option<&'static str>>) -> Arc<Mutex<Vec<Request>>> {
    web_server_by(listener, move |turn, _| answers[turn.min(answers.len() - 1)])
}

/// An HTTP server whose answer depends on the number of the request and its body; for `None` it hangs up.
fn web_server_by(
    listener: TcpListener,
    answer: impl Fn(usize, &serde_json::Value) -> Option<&'static str> + Send + 'static,
) -> Arc<Mutex<Vec<Request>>> {
    let seen: Arc<Mutex<Vec<Request>>> = Arc::default();
    let taken = seen.clone();
    std::thread::spawn(move || {
        let mut turn = 0;
        for stream in listener.incoming() {
            let mut reader = BufReader::new(stream.unwrap());
            loop {
                let (mut head, mut line) = (String::new(), String::new());
                while reader.read_line(&mut line).unwrap_or(0) > 2 {
                    head.push_str(&line.to_ascii_lowercase());
                    line.clear();
                }
                let Some(length) = head.lines().find_map(|l| l.strip_prefix("content-length: ")) else { break };
                let mut body = vec![0; length.trim().parse().unwrap()];
                reader.read_exact(&mut body).unwrap();
                let body: serde_json::Value = serde_json::from_slice(&body).unwrap();
                let answer = answer(turn, &body);
                turn += 1;
                let Some(answer) = answer else { break };
                taken.lock().unwrap().push((head + answer, body));
                let said = format!("HTTP/1.1 {answer}\r\ncontent-length: 0\r\n\r\n");
                reader.get_mut().write_all(said.as_bytes()).unwrap();
            }
        }
    });
    seen
}

fn taken(seen: &Mutex<Vec<Request>>) -> Vec<String> {
    let seen = seen.lock().unwrap();
    seen.iter()
        .filter(|(head, _)| head.ends_with("204 ok"))
        .map(|(_, e)| e["id"].as_str().unwrap().to_owned())
        .collect()
}

#[test]
fn a_webhook_gets_everything_in_order_although_it_fails_and_is_away_over_a_restart() {
    let dir = tempfile::tempdir().unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let token = dir.path().join("token");
    std::fs::write(&token, "s3cret\n").unwrap();
    let receiver = format!("[[deliver]]\nname = \"cmms\"\nto = \"http://{address}/hook\"\nsecret_file = {token:?}\n");
    // Nothing listens there.
    drop(listener);
    let first = Running::start(dir.path(), &receiver);
    first.offer(0..5);
    wait_for("a fault", || first.faults.list().iter().find(|f| f.contains("cmms does not take documents")).cloned());
    wait_for("all of them waiting", || {
        let waiting =
            first.metrics.delivery_waiting.get_or_create(&crate::runtime::metrics::Label { name: "cmms".into() });
        (waiting.get() == 5).then_some(())
    });
    first.stop();
    let second = Running::start(dir.path(), &receiver);
    second.offer(5..8);
    let answers = vec![None, Some("503 busy\r\nretry-after: 0"), Some("404 not there yet"), Some("204 ok")];
    let seen = web_server(TcpListener::bind(address).unwrap(), answers);
    wait_for("all of them", || (taken(&seen).len() == 8).then_some(()));
    assert_eq!(taken(&seen), (0..8).map(|k| format!("e{k}")).collect::<Vec<_>>());
    wait_for("the fault's end", || second.faults.list().is_empty().then_some(()));
    {
        let seen = seen.lock().unwrap();
        let (head, event) = seen.last().unwrap();
        assert!(
            head.contains("content-type: application/cloudevents+json") && head.contains("bearer s3cret"),
            "{head}"
        );
        assert_eq!((event["specversion"].as_str(), event["type"].as_str()), (Some("1.0"), Some("stictiond.alarm.v2")));
        assert_eq!(event["source"], "urn:stictiond:site:plant%201/a");
        assert_eq!((event["subject"].as_str(), event["data"]["loop"].as_str()), (Some("FIC101"), Some("FIC101")));
        assert_eq!(event["time"], "2026-01-05T08:15:00Z");
    }
    second.stop();
    // Nothing is left over, and nothing is sent twice.
    let third = Running::start(dir.path(), &receiver);
    third.offer(8..9);
    wait_for("one more", || (taken(&seen).len() == 9).then_some(()));
    assert_eq!(taken(&seen).last().unwrap(), "e8");
    third.stop();
}

#[test]
fn what_is_refused_for_good_holds_up_nobody() {
    let dir = tempfile::tempdir().unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let receiver = format!("[[deliver]]\nname = \"a\"\nto = \"http://{}/\"\n", listener.local_addr().unwrap());
    let seen = web_server(listener, vec![Some("422 no"), Some("204 ok")]);
    let running = Running::start(dir.path(), &receiver);
    running.offer(0..2);
    wait_for("the second", || (taken(&seen) == ["e1"]).then_some(()));
    wait_for("its dead letter", || (running.metrics.delivery_refused.get() == 1).then_some(()));
    assert!(running.faults.list()[0].contains("a refused alarm e0 of FIC101 for good"), "{:?}", running.faults.list());
    let dead = dead_letters(dir.path());
    assert_eq!((dead.len(), &dead[0]["id"], &dead[0]["document"]["loop"]), (1, &"e0".into(), &"FIC101".into()));
    assert!(dead[0]["reason"].as_str().unwrap().contains("422"), "{dead:?}");
    running.stop();
}

fn dead_letters(dir: &Path) -> Vec<serde_json::Value> {
    let text = std::fs::read_to_string(dir.join(dead::DEAD_LETTERS)).unwrap_or_default();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn a_document_that_is_answered_with_500_for_ever_does_not_block_other_loops() {
    let dir = tempfile::tempdir().unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let receiver = format!("[[deliver]]\nname = \"a\"\nto = \"http://{}/\"\n", listener.local_addr().unwrap());
    // Two poisoned loops, so that the first document tried in between is refused as well.
    let answer = |_: usize, event: &serde_json::Value| {
        let poisoned = event["subject"].as_str().unwrap().starts_with("POISON");
        Some(if poisoned { "500 broken" } else { "204 ok" })
    };
    let seen = web_server_by(listener, answer);
    let running = Running::start(dir.path(), &receiver);
    let outbox = running.outbox.as_ref().unwrap();
    outbox.offer(item_of("POISON1", 0));
    outbox.offer(item_of("POISON2", 1));
    (2..22).for_each(|k| outbox.offer(item_of(if k % 2 == 0 { "GOOD1" } else { "GOOD2" }, k)));
    wait_for("the alarms of the other loops", || (taken(&seen).len() == 20).then_some(()));
    wait_for("both dead letters", || (running.metrics.delivery_refused.get() == 2).then_some(()));
    let of_loop = |parity: usize| (2..22).filter(move |k| k % 2 == parity).map(|k| format!("e{k}"));
    for parity in [0, 1] {
        let got = taken(&seen).into_iter().filter(|id| id[1..].parse::<usize>().unwrap() % 2 == parity);
        assert_eq!(got.collect::<Vec<_>>(), of_loop(parity).collect::<Vec<_>>(), "in order within the loop");
    }
    let dead = dead_letters(dir.path());
    let ids: Vec<&str> = dead.iter().map(|d| d["id"].as_str().unwrap()).collect();
    assert_eq!(ids, ["e0", "e1"]);
    assert!(dead.iter().all(|d| d["reason"].as_str().unwrap().contains("500") && d["attempts"].as_u64() > Some(3)));
    running.stop();
}

#[test]
fn a_receiver_that_refuses_everything_for_a_while_loses_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let receiver = format!("[[deliver]]\nname = \"a\"\nto = \"http://{}/\"\n", listener.local_addr().unwrap());
    let seen = web_server_by(listener, |turn, _| Some(if turn < 14 { "503 down" } else { "204 ok" }));
    let running = Running::start(dir.path(), &receiver);
    (0..6).for_each(|k| running.outbox.as_ref().unwrap().offer(item_of(&format!("L{}", k % 3), k)));
    wait_for("all", || (taken(&seen).len() == 6).then_some(()));
    assert_eq!(running.metrics.delivery_refused.get(), 0);
    assert!(dead_letters(dir.path()).is_empty());
    running.stop();
}

#[test]
fn a_document_that_is_refused_for_a_day_does_not_block_its_own_loop() {
    let dir = tempfile::tempdir().unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let receiver = format!("[[deliver]]\nname = \"a\"\nto = \"http://{}/\"\n", listener.local_addr().unwrap());
    let answer = |_: usize, event: &serde_json::Value| Some(if event["id"] == "e0" { "500 broken" } else { "204 ok" });
    let seen = web_server_by(listener, answer);
    let running = Running::start(dir.path(), &receiver);
    running.offer(0..3);
    wait_for("the others", || (taken(&seen) == ["e1", "e2"]).then_some(()));
    let letter = wait_for("the dead letter", || dead_letters(dir.path()).pop());
    assert_eq!(letter["attempts"], 20);
    running.stop();
}

#[test]
fn a_panic_costs_the_document_that_causes_it_and_nothing_else() {
    let dir = tempfile::tempdir().unwrap();
    let sent = Arc::new(Mutex::new(Vec::new()));
    let took = sent.clone();
    let mut held = store::Held::on(Clock::system(), dir.path(), move |item| {
        assert!(item.loop_name != "POISON", "on purpose");
        took.lock().unwrap().push(item.id.clone());
        Ok(())
    });
    held.outbox.offer(item_of("POISON", 0));
    (1..4).for_each(|k| held.outbox.offer(item_of("GOOD", k)));
    held.delivery.store();
    let (mut worker, _) = held.delivery.workers.remove(0);
    let thread = std::thread::spawn(move || worker.supervise());
    wait_for("all to be settled", || held.is_settled().then_some(()));
    assert_eq!(*sent.lock().unwrap(), ["e1", "e2", "e3"]);
    assert_eq!((dead_letters(dir.path()).len(), held.metrics.delivery_refused.get()), (1, 1));
    assert!(held.metrics.delivery_restarts.get() >= 4);
    assert!(held.faults.list().iter().any(|f| f.contains("panicked and was restarted")), "{:?}", held.faults.list());
    held.delivery.keep.close_queues();
    thread.join().unwrap();
}

#[test]
fn the_dead_letter_file_is_bounded() {
    let dir = tempfile::tempdir().unwrap();
    let dead = DeadLetters::new(dir.path());
    let mut large = item_of("L", 1);
    large.document = format!("\"{}\"", "x".repeat(5 << 20));
    (0..7).for_each(|_| dead.append("a", &large, 1, "too large").unwrap());
    let files: Vec<u64> =
        std::fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().metadata().unwrap().len()).collect();
    assert!(files.len() == 2 && files.iter().sum::<u64>() < 24 << 20, "{files:?}");
}

#[test]
fn too_many_cost_the_oldest_and_receivers_that_are_gone_leave_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let away = "[[deliver]]\nname = \"a\"\nto = \"http://127.0.0.1:1\"\nqueue = 10\n";
    let running = Running::start(dir.path(), away);
    running.offer(0..15);
    wait_for("five to be given up", || (running.metrics.delivery_dropped.get() == 5).then_some(()));
    running.stop();
    let stored = |path: &str| StateStore::open(&dir.path().join(path)).unwrap().load().unwrap();
    let waiting = stored(stiction_files::store::OUTBOX_NAME).values;
    let oldest: Item = serde_json::from_slice(waiting.values().next().unwrap()).unwrap();
    assert_eq!((waiting.len(), oldest.id.as_str()), (10, "e5"));
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let there = format!("[[deliver]]\nname = \"b\"\nto = \"http://{}\"\n", listener.local_addr().unwrap());
    web_server(listener, vec![Some("204 ok")]);
    let other = Running::start(dir.path(), &there);
    assert_eq!(other.metrics.delivery_dropped.get(), 10);
    other.offer(0..1);
    wait_for("its delivery", || (other.metrics.delivered.get() == 1).then_some(()));
    other.stop();
    assert!(stored(stiction_files::store::OUTBOX_NAME).values.is_empty());
}

#[test]
fn what_waits_in_a_store_that_cannot_be_read_at_the_start_is_sent_once_it_can() {
    let dir = tempfile::tempdir().unwrap();
    let receivers = |port: u16| format!("[[deliver]]\nname = \"a\"\nto = \"http://127.0.0.1:{port}\"\n");
    let first = Running::start(dir.path(), &receivers(1));
    first.offer(0..3);
    wait_for("an attempt", || (first.metrics.delivery_failed.get() > 0).then_some(()));
    first.stop();
    // Another process has the store: it cannot be opened.
    let store = StateStore::open(&dir.path().join(stiction_files::store::OUTBOX_NAME)).unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let second = Running::start(dir.path(), &receivers(listener.local_addr().unwrap().port()));
    web_server(listener, vec![Some("204 ok")]);
    assert!(second.faults.list()[0].contains("cannot be kept"), "{:?}", second.faults.list());
    second.offer(3..5);
    drop(store);
    wait_for("all five", || (second.metrics.delivered.get() == 5).then_some(()));
    second.stop();
}

#[test]
fn a_broken_store_is_put_aside() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join(stiction_files::store::OUTBOX_NAME), vec![7; 9000]).unwrap();
    let running = Running::start(dir.path(), "[[deliver]]\nname = \"a\"\nto = \"http://127.0.0.1:1\"\n");
    assert!(running.faults.list()[0].contains("put aside"), "{:?}", running.faults.list());
    running.stop();
    assert!(dir.path().join("outbox.redb.broken").exists());
}
