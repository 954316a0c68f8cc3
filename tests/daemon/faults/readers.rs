//! Clients that ask and do not read: they cost nobody else a sample or an answer.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use zenoh::Wait;
use zenoh::qos::CongestionControl;

use super::link::{BadLine, client};
use crate::live::{Daemon, PREFIX, ask, plane, wait_for};

/// What Zenoh logs once it has given up a reader.
const GIVEN_UP: &str = "Closing transport";
/// Messages that arrive meanwhile.
const SENT: u64 = 1000;
/// Commands of one client that are refused meanwhile.
const REFUSED: usize = 40_000;

fn deaf_client(daemon: &Daemon) -> (BadLine, zenoh::Session) {
    let line = BadLine::to(daemon.endpoint.rsplit(':').next().unwrap().parse().unwrap());
    let session = client(line.port);
    line.deaf.store(true, Ordering::Relaxed);
    (line, session)
}

/// Asks without waiting for the answers.
fn ask_often(session: &zenoh::Session, key: &str, times: usize) {
    for _ in 0..times {
        session.get(key).timeout(Duration::from_secs(100)).callback(|_| {}).wait().unwrap();
    }
}

/// Samples arrive before anybody was given up, and a command is answered; false where a busy machine gave readers up before
/// that could be seen.
fn is_heard(daemon: &Daemon) -> bool {
    let bus = daemon.session();
    let before = daemon.counter("samples");
    let put = |from: u64, to: u64| {
        for k in from..to {
            let put = bus.put(format!("{PREFIX}/A/op"), k.to_string()).congestion_control(CongestionControl::Block);
            put.wait().unwrap();
        }
    };
    // The first ones tell: on a busy machine readers may be given up before a thousand have come.
    if daemon.logged().contains(GIVEN_UP) {
        return false;
    }
    let begun = Instant::now();
    put(0, 10);
    wait_for("the first samples", || (daemon.counter("samples") == before + 10).then_some(()));
    let is_late = begun.elapsed() > Duration::from_secs(1);
    if daemon.logged().contains(GIVEN_UP) {
        assert!(!is_late, "it went on only once the readers were thrown out");
        return false;
    }
    put(10, SENT);
    let put_away = ask(&bus, &plane("A/alarm?cmd=out_of_service;by=ann"));
    wait_for("all samples", || (daemon.counter("samples") == before + SENT).then_some(()));
    assert!(put_away.is_ok(), "{put_away:?}");
    assert_eq!(daemon.counter("dropped_input"), 0);
    bus.close().wait().unwrap();
    true
}

/// Repeats what a busy machine kept from being seen.
fn until_seen(once: impl Fn() -> bool) {
    assert!((0..4).any(|_| once()), "readers were given up before a sample could be sent, four times");
}

fn daemon(dir: &std::path::Path) -> Daemon {
    let daemon = Daemon::start(dir, "[gap]\nenabled = false\n");
    let bus = daemon.session();
    bus.put(format!("{PREFIX}/A/op"), "1").wait().unwrap();
    wait_for("the loop", || (daemon.counter("samples") == 1).then_some(()));
    bus.close().wait().unwrap();
    daemon
}

#[test]
fn readers_of_documents_that_stop_reading_cost_no_sample() {
    until_seen(documents_are_not_read);
}

fn documents_are_not_read() -> bool {
    let dir = tempfile::tempdir().unwrap();
    let daemon = daemon(dir.path());
    // Two, as Zenoh reads its links with two threads; each asks for more than the system's buffers take.
    let readers = [deaf_client(&daemon), deaf_client(&daemon)];
    let before = daemon.counter("queries");
    readers.iter().for_each(|(_, session)| ask_often(session, &plane("@schema/*"), 200));
    wait_for("the queries", || (daemon.counter("queries") >= before + 2).then_some(()));
    let is_seen = is_heard(&daemon);
    // Who does not read is given up in the end, and what waited for it is gone.
    wait_for("the end of the readers", || daemon.logged().contains(GIVEN_UP).then_some(()));
    for (line, session) in readers {
        line.deaf.store(false, Ordering::Relaxed);
        drop(session);
    }
    daemon.stop();
    is_seen
}

#[test]
fn refused_commands_of_a_client_that_does_not_read_cost_neither_samples_nor_commands_of_others() {
    until_seen(refusals_are_not_read);
}

fn refusals_are_not_read() -> bool {
    let dir = tempfile::tempdir().unwrap();
    let daemon = daemon(dir.path());
    // Two, as Zenoh reads its links with two threads; each sends more than may wait to be refused.
    let clients = [deaf_client(&daemon), deaf_client(&daemon)];
    let before = daemon.counter("queries");
    let is_seen = std::thread::scope(|scope| {
        for (_, session) in &clients {
            let key = plane(&format!("{}/alarm?cmd=ack;by=x", "N".repeat(800)));
            scope.spawn(move || ask_often(session, &key, REFUSED));
        }
        let mut last = (before, Instant::now());
        wait_for("queries that come no further", || {
            let taken = daemon.counter("queries");
            if taken != last.0 {
                last = (taken, Instant::now());
            }
            (taken > before && last.1.elapsed() > Duration::from_millis(500)).then_some(())
        });
        println!("{} of {} queries were taken", last.0 - before, 2 * REFUSED);
        let is_seen = is_heard(&daemon);
        clients.iter().for_each(|(line, _)| line.deaf.store(false, Ordering::Relaxed));
        is_seen
    });
    for (line, session) in clients {
        line.deaf.store(false, Ordering::Relaxed);
        drop(session);
    }
    daemon.stop();
    is_seen
}
