//! Many pages of one loop at once: streams and windows are limited in number, and the daemon keeps working.

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, Ordering};

use super::connect_from;
use crate::live::{Daemon, FAST, alarm_state, ask, command_headers, http, plane, request, sticking, wait_for};
use zenoh::Wait;

/// The status of the first response on a stream.
fn status_of(stream: &mut TcpStream) -> u16 {
    let mut head = [0; 12];
    stream.read_exact(&mut head).unwrap();
    String::from_utf8_lossy(&head[9..]).parse().unwrap()
}

#[test]
fn two_hundred_pages_of_one_loop_are_limited_and_commands_are_answered() {
    let dir = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(dir.path(), FAST);
    daemon.play(&sticking(dir.path()));
    daemon.wait_for_estimates(6);
    let mut open = Vec::new();
    let mut statuses: BTreeMap<(u8, u16), usize> = BTreeMap::new();
    for host in [2, 3, 4, 5] {
        for _ in 0..50 {
            let mut stream = connect_from(&format!("127.0.0.{host}"), &daemon.web);
            write!(stream, "GET /api/v1/events?loop=FIC101 HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
            *statuses.entry((host, status_of(&mut stream))).or_default() += 1;
            open.push(stream);
        }
    }
    let wanted = [((2, 200), 32), ((2, 429), 18), ((3, 200), 32), ((3, 429), 18), ((4, 429), 50), ((5, 429), 50)];
    assert_eq!(statuses, BTreeMap::from(wanted));
    // Meanwhile, windows are requested until the commands are answered, at least five times by each client.
    let answered = AtomicBool::new(false);
    let window = || {
        let mut seen = Vec::new();
        while seen.len() < 5 || !answered.load(Ordering::Relaxed) {
            let stream = TcpStream::connect(&daemon.web).unwrap();
            let path = "/api/v1/loops/FIC101/window";
            seen.push(request(stream, &["GET", path], &command_headers("localhost", &[]), "").0);
        }
        seen
    };
    let bus = daemon.session();
    let seen = std::thread::scope(|scope| {
        let getters: Vec<_> = (0..24).map(|_| scope.spawn(window)).collect();
        let commands = ["ack", "suppress", "unsuppress", "out_of_service", "in_service"];
        let answers = commands.map(|cmd| ask(&bus, &plane(&format!("FIC101/alarm?cmd={cmd};by=ann"))));
        let health = http(&daemon.web, "/healthz");
        answered.store(true, Ordering::Relaxed);
        assert!(answers.iter().all(Result::is_ok) && health.contains("\"faults\""), "{answers:?}, {health}");
        getters.into_iter().flat_map(|getter| getter.join().unwrap()).collect::<Vec<u16>>()
    });
    let count = |status: u16| seen.iter().filter(|s| **s == status).count();
    // Two run at a time and eight wait; the others are refused at once.
    assert!(count(200) > 0 && count(503) > 0 && count(200) + count(503) == seen.len(), "{seen:?}");
    assert_eq!((alarm_state(&bus).as_deref(), daemon.counter("dropped_input")), (Some("acked"), 0));
    // Closing a page makes room for another.
    open.clear();
    wait_for("a free stream", || {
        let mut stream = connect_from("127.0.0.4", &daemon.web);
        write!(stream, "GET /api/v1/events HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
        (status_of(&mut stream) == 200).then_some(())
    });
    bus.close().wait().unwrap();
    daemon.stop();
}

#[test]
fn the_daemon_opens_no_file() {
    let dir = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(dir.path(), "workbench = \"http://127.0.0.1:8090\"\n");
    for [method, path] in [["GET", "options"], ["POST", "files?name=a.csv"], ["POST", "jobs"]] {
        let path = format!("/api/v1/workbench/{path}");
        let stream = TcpStream::connect(&daemon.web).unwrap();
        let (status, _) = request(stream, &[method, &path], &command_headers("localhost", &[]), "t,op,pv\n0,1,2\n");
        assert_eq!(status, 404, "{path}");
    }
    let site: serde_json::Value = serde_json::from_str(&http(&daemon.web, "/api/v1/site")).unwrap();
    assert_eq!((&site["workbench"], &site["workbench_url"]), (&false.into(), &"http://127.0.0.1:8090".into()));
    daemon.stop();
}
