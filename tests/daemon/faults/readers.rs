//! Clients that send queries and do not read: no one else loses a sample or a reply.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use zenoh::Wait;
use zenoh::qos::CongestionControl;

use super::link::{BadLine, client};
use crate::live::{Daemon, PREFIX, ask, plane, wait_for};

/// Zenoh's log message when it has given up a reader.
const GIVEN_UP: &str = "Closing transport";
/// How long Zenoh waits for them.
const PATIENCE: Duration = Duration::from_secs(40);
/// Messages that arrive in the meantime.
const SENT: u64 = 1000;
/// Commands of one client that are refused in the meantime.
const REFUSED: usize = 40_000;

fn deaf_client(daemon: &Daemon) -> (BadLine, zenoh::Session) {
    let line = BadLine::to(daemon.endpoint.rsplit(':').next().unwrap().parse().unwrap());
    let session = client(line.port);
    line.deaf.store(true, Ordering::Relaxed);
    (line, session)
}

/// Sends queries without waiting for replies.
fn ask_often(session: &zenoh::Session, key: &str, times: usize) {
    for _ in 0..times {
        session.get(key).timeout(Duration::from_secs(100)).callback(|_| {}).wait().unwrap();
    }
}

/// Checks that samples arrive and a command is answered while Zenoh still waits for readers.
fn assert_heard(daemon: &Daemon) {
    let bus = daemon.session();
    let before = daemon.counter("samples");
    for k in 0..SENT {
        let put = bus.put(format!("{PREFIX}/A/op"), k.to_string()).congestion_control(CongestionControl::Block);
        put.wait().unwrap();
    }
    let put_away = ask(&bus, &plane("A/alarm?cmd=out_of_service;by=ann"));
    wait_for("all samples", || (daemon.counter("samples") == before + SENT).then_some(()));
    assert!(put_away.is_ok(), "{put_away:?}");
    assert!(!daemon.logged().contains(GIVEN_UP), "it went on only once the readers were thrown out");
    assert_eq!(daemon.counter("dropped_input"), 0);
    bus.close().wait().unwrap();
}

/// A daemon that knows one loop, and whose Zenoh waits long before it gives up a reader, so that the speed of the machine does
/// not matter.
fn daemon(dir: &std::path::Path) -> Daemon {
    let settings = dir.join("zenoh.json5");
    let patience_us = PATIENCE.as_micros();
    let text = format!(
        r#"{{transport: {{link: {{tx: {{queue: {{congestion_control: {{block: {{wait_before_close: {patience_us}}}}}}}}}}}}}}}"#
    );
    std::fs::write(&settings, text).unwrap();
    let daemon = Daemon::start_with(&[], dir, "[gap]\nenabled = false\n", &format!("config_file = {settings:?}\n"));
    let bus = daemon.session();
    bus.put(format!("{PREFIX}/A/op"), "1").wait().unwrap();
    wait_for("the loop", || (daemon.counter("samples") == 1).then_some(()));
    bus.close().wait().unwrap();
    daemon
}

#[test]
fn readers_of_documents_that_stop_reading_cost_no_sample() {
    let dir = tempfile::tempdir().unwrap();
    let daemon = daemon(dir.path());
    // Two readers, since Zenoh reads its links with two threads; each requests more than the system's buffers can hold.
    let readers = [deaf_client(&daemon), deaf_client(&daemon)];
    let before = daemon.counter("queries");
    readers.iter().for_each(|(_, session)| ask_often(session, &plane("@schema/*"), 200));
    wait_for("the queries", || (daemon.counter("queries") >= before + 2).then_some(()));
    assert_heard(&daemon);
    // Readers that do not read are given up in the end, and everything that waited for them is dropped.
    wait_for("the end of the readers", || daemon.logged().contains(GIVEN_UP).then_some(()));
    for (line, session) in readers {
        line.deaf.store(false, Ordering::Relaxed);
        drop(session);
    }
    daemon.stop();
}

#[test]
fn refused_commands_of_a_client_that_does_not_read_cost_neither_samples_nor_commands_of_others() {
    let dir = tempfile::tempdir().unwrap();
    let daemon = daemon(dir.path());
    // Two clients, since Zenoh reads its links with two threads; each sends more than may wait to be refused.
    let clients = [deaf_client(&daemon), deaf_client(&daemon)];
    let before = daemon.counter("queries");
    std::thread::scope(|scope| {
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
        assert_heard(&daemon);
        clients.iter().for_each(|(line, _)| line.deaf.store(false, Ordering::Relaxed));
    });
    for (line, session) in clients {
        line.deaf.store(false, Ordering::Relaxed);
        drop(session);
    }
    daemon.stop();
}
