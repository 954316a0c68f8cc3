//! Hostile publishers, strangers who send commands, clients that never finish: all are limited, answered and logged.

mod pages;
mod proxy;
mod reviews;

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crate::live::{Daemon, FAST, PREFIX, alarm_state, ask, http, plane, request, sticking, wait_for};
use serde_json::Value;
use zenoh::Wait;
use zenoh::qos::CongestionControl;

/// Largest resident memory so far, MB.
fn peak_mb(pid: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let row = status.lines().find_map(|l| l.strip_prefix("VmHWM:")).unwrap();
    row.trim().trim_end_matches(" kB").parse::<u64>().unwrap() / 1024
}

#[test]
fn large_payloads_are_bounded_in_bytes_and_every_one_is_counted() {
    let dir = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(dir.path(), "[input]\nqueue_bytes = 8388608\n");
    let bus = daemon.session();
    let before = peak_mb(daemon.pid());
    // Batches of nearly 1 MiB, faster than they can be processed.
    let batch = format!("[{}1]{}", "1,".repeat(9_999), " ".repeat((1 << 20) - 30_000));
    let put = |payload: Vec<u8>| {
        bus.put(format!("{PREFIX}/F/op"), payload).congestion_control(CongestionControl::Block).wait().unwrap();
    };
    for _ in 0..120 {
        put(batch.clone().into_bytes());
    }
    wait_for("all messages", || (daemon.counter("messages") == 120).then_some(()));
    // Nothing is stuck: messages that were not taken are counted as dropped.
    wait_for("all counted", || {
        let (taken, dropped) = (daemon.counter("samples") / 10_000, daemon.counter("dropped_input"));
        (taken + dropped == 120).then_some(())
    });
    // Payloads that are too large are refused; far larger ones are never even assembled.
    put(vec![b'1'; 2 << 20]);
    wait_for("the refusal", || (daemon.counter("undecodable") == 1).then_some(()));
    put(vec![b'1'; 200 << 20]);
    put(b"7".to_vec());
    let samples = daemon.counter("samples");
    wait_for("a sample after it", || {
        (daemon.counter("samples") > samples || daemon.counter("messages") >= 122).then_some(())
    });
    let grown = peak_mb(daemon.pid()) - before;
    assert!(grown < 150, "{grown} MB more");
    bus.close().wait().unwrap();
    daemon.stop();
}

#[test]
fn strangers_are_answered_logged_and_bounded() {
    let dir = tempfile::tempdir().unwrap();
    let daemon =
        Daemon::start(dir.path(), &format!("{FAST}[gap]\nbudget_evaluations = 3000\n[commands]\nruns_per_hour = 3\n"));
    daemon.play(&sticking(dir.path()));
    daemon.wait_for_estimates(6);
    let bus = daemon.session();
    assert_eq!(alarm_state(&bus).as_deref(), Some("unack"));
    let refused = |parameters: &str| ask(&bus, &plane(&format!("FIC101/alarm?{parameters}"))).unwrap_err();
    assert!(refused("cmd=ack").contains("does not name the person"));
    assert!(refused("cmd=ack;by=").contains("does not name the person"));
    assert!(refused(&format!("cmd=ack;by=ann;why={}", "w".repeat(60_000))).contains("the limit is 500"));
    assert!(refused("cmd=ack;by=boss\u{1b}]0;pwned\u{7}").contains("control characters"));
    assert!(refused(&format!("cmd={};by=ann", "z".repeat(100_000))).len() < 300);
    assert_eq!(alarm_state(&bus).as_deref(), Some("unack"));
    // Diagnoses need a name and are limited in number.
    let runs: Vec<Result<_, String>> = (0..6).map(|k| ask(&bus, &plane(&format!("FIC101/gap?run;by=p{k}")))).collect();
    assert_eq!(runs.iter().filter(|r| r.is_ok()).count(), 3, "{runs:?}");
    assert!(runs.last().unwrap().as_ref().unwrap_err().contains("diagnoses an hour"));
    assert!(ask(&bus, &plane("FIC101/gap?run")).unwrap_err().contains("does not name the person"));
    // Loops with names that could steer a terminal do not appear.
    let loops = daemon.health()["loops"].as_u64().unwrap();
    bus.put(format!("{PREFIX}/\u{1b}[2J/op"), "1").wait().unwrap();
    wait_for("the refusal", || (daemon.counter("refused_loops") == 1).then_some(()));
    assert_eq!(daemon.health()["loops"].as_u64().unwrap(), loops);
    // A forged document is detected.
    let forged = r#"{"schema":"stictiond.alarm.v2","loop":"FIC101","state":"normal","active":false}"#;
    bus.put(plane("FIC101/alarm"), forged).wait().unwrap();
    wait_for("the fault", || daemon.faults().iter().any(|f| f.contains("come from elsewhere")).then_some(()));
    assert_eq!(alarm_state(&bus).as_deref(), Some("unack"));
    let log = daemon.logged();
    assert!(log.contains("refused") && !log.contains('\u{1b}') && !log.contains('\u{7}'), "{log}");
    bus.close().wait().unwrap();
    daemon.stop();
}

/// Connects from another address of this machine's loopback network, which counts as a separate host.
fn connect_from(address: &str, to: &str) -> TcpStream {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build().unwrap();
    let stream = runtime.block_on(async {
        let socket = tokio::net::TcpSocket::new_v4().unwrap();
        socket.bind(format!("{address}:0").parse().unwrap()).unwrap();
        socket.connect(to.parse().unwrap()).await.unwrap().into_std().unwrap()
    });
    stream.set_nonblocking(false).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    stream
}

#[test]
fn one_host_cannot_hold_all_connections_and_all_together_stay_bounded() {
    let dir = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(dir.path(), "");
    let descriptors = || std::fs::read_dir(format!("/proc/{}/fd", daemon.pid())).unwrap().count();
    let before = descriptors();
    let open_half = |from: &str| {
        let mut stream = connect_from(from, &daemon.web);
        // Connections beyond the limit are closed at once, maybe before this is written.
        let _ = stream.write_all(b"GET /metrics HTTP/1.1\r\nX: ");
        stream
    };
    let one_host: Vec<TcpStream> = (0..200).map(|_| open_half("127.0.0.2")).collect();
    wait_for("the limit of one host", || (descriptors() <= before + 64).then_some(()));
    // Unfinished request heads are closed after 5 s: this answer comes while they are open.
    let (status, _) =
        request(connect_from("127.0.0.3", &daemon.web), &["GET", "/healthz"], &[("Host", "localhost")], "");
    assert_eq!(status, 200);
    let many: Vec<TcpStream> =
        (10..20).flat_map(|k| (0..60).map(move |_| k)).map(|k| open_half(&format!("127.0.0.{k}"))).collect();
    wait_for("the limit in all", || (descriptors() <= before + 256).then_some(()));
    drop((one_host, many));
    wait_for("free connections", || (descriptors() <= before + 8).then_some(()));
    assert!(http(&daemon.web, "/metrics").contains("stictiond_messages"));
    daemon.stop();
}

#[test]
fn requests_that_are_never_finished_end_and_shut_nobody_out_for_long() {
    let dir = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(dir.path(), "");
    let mut open: Vec<TcpStream> = (0..500)
        .filter_map(|_| {
            let mut stream = TcpStream::connect(&daemon.web).ok()?;
            stream.write_all(b"GET /metrics HTTP/1.1\r\nHost: x\r\nX: ").ok()?;
            Some(stream)
        })
        .collect();
    let held = std::fs::read_dir(format!("/proc/{}/fd", daemon.pid())).unwrap().count();
    assert!(held < 150, "{held} descriptors");
    let until = Instant::now() + Duration::from_secs(60);
    for stream in &mut open {
        stream
            .set_read_timeout(Some(until.saturating_duration_since(Instant::now()) + Duration::from_secs(1)))
            .unwrap();
        let mut answer = Vec::new();
        // Closed or reset, the connection has ended. A read that times out would mean that it has not.
        let ended = stream.read_to_end(&mut answer);
        assert!(ended.as_ref().err().is_none_or(|e| e.kind() != std::io::ErrorKind::WouldBlock), "{ended:?}");
    }
    assert!(http(&daemon.web, "/metrics").contains("stictiond_messages"));
    daemon.stop();
}

/// Samples of a loop over a range of seconds: calm, or oscillating like a sticking valve.
fn batch(loop_index: usize, signal: &str, seconds: std::ops::Range<i64>, step_s: i64) -> String {
    let value = |k: i64| {
        let (noise, swing) = ((k * k * 7919 + loop_index as i64) % 97, if k % 12 < 6 { 4.0 } else { -4.0 });
        let swing = if loop_index.is_multiple_of(10) { swing } else { 0.0 };
        50.0 + noise as f64 / 97.0 + if signal == "op" { swing * ((k % 6) as f64 / 3.0 - 1.0) } else { swing }
    };
    // Starts with the first second of a window; the one before it would belong to a separate window.
    let sample = |k: i64| format!("{{\"t\":{},\"v\":{:.3}}}", (1_700_000_041 + k * step_s) * 1_000_000_000, value(k));
    format!("[{}]", seconds.map(sample).collect::<Vec<_>>().join(","))
}

#[test]
fn windows_of_all_loops_at_once_and_racing_stamps_cost_no_honest_loop_its_turn() {
    const LOOPS: usize = 300;
    const WINDOWS: i64 = 3;
    let dir = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(dir.path(), "[window]\nhop_s = 120.0\nmax_window_s = 120.0\n[gap]\nenabled = false\n");
    let bus = daemon.session();
    let seen: Arc<Mutex<BTreeMap<String, [u64; 2]>>> = Arc::default();
    let taking = seen.clone();
    let listening = bus.declare_subscriber(plane("*/estimate")).callback(move |sample| {
        let document: Value = serde_json::from_slice(&sample.payload().to_bytes()).unwrap();
        let skipped = document["gates"].as_array().unwrap().iter().any(|gate| gate == "skipped");
        let mut seen = taking.lock().unwrap();
        seen.entry(document["loop"].as_str().unwrap().to_owned()).or_default()[usize::from(skipped)] += 1;
    });
    let listening = listening.wait().unwrap();
    let put = |name: &str, signal: &str, payload: String| {
        let key = format!("{PREFIX}/{name}/{signal}");
        bus.put(key, payload).congestion_control(CongestionControl::Block).wait().unwrap();
    };
    for window in 0..=WINDOWS {
        let until = if window == WINDOWS { 20 } else { 120 };
        for index in 0..LOOPS {
            for signal in ["op", "pv"] {
                put(&format!("L{index:04}"), signal, batch(index, signal, window * 120..window * 120 + until, 1));
                // Twenty seconds between samples where the others have one, so every six samples fill a window.
                put(
                    "racing",
                    signal,
                    batch(0, signal, (window * 300 + index as i64) * 6..(window * 300 + index as i64 + 1) * 6, 20),
                );
            }
        }
        let honest =
            || seen.lock().unwrap().iter().filter(|(name, _)| *name != "racing").map(|(_, n)| n[0] + n[1]).sum::<u64>();
        wait_for("every honest window", || (honest() >= window as u64 * LOOPS as u64).then_some(()));
    }
    let seen = seen.lock().unwrap();
    let short: Vec<_> = seen.iter().filter(|(name, n)| *name != "racing" && **n != [WINDOWS as u64, 0]).collect();
    assert!(seen.len() > LOOPS && short.is_empty(), "{} loops, of which short: {short:?}", seen.len());
    assert!(daemon.counter("windows") > 3 * LOOPS as u64 + 500, "the racing loop did race");
    drop(seen);
    listening.undeclare().wait().unwrap();
    bus.close().wait().unwrap();
    daemon.stop();
}

#[test]
fn invented_loops_racing_clocks_and_floods_are_counted_named_and_take_nothing_from_others() {
    let dir = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(
        dir.path(),
        "[input]\nmax_loops = 40\nmax_rate_hz = 1.0\n[[loop]]\nname = \"FIC101\"\n[[loop]]\nname = \"FIC102\"\n",
    );
    let bus = daemon.session();
    let put = |key: &str, payload: &str| {
        bus.put(format!("{PREFIX}/{key}"), payload).congestion_control(CongestionControl::Block).wait().unwrap();
    };
    let before = peak_mb(daemon.pid());
    for k in 0..20_000 {
        put(&format!("stranger{k}/op"), "1");
    }
    wait_for("all messages", || (daemon.counter("messages") == 20_000).then_some(()));
    wait_for("all counted", || {
        (daemon.counter("loops_over_limit") + daemon.counter("dropped_input") == 20_000 - 38).then_some(())
    });
    assert!(peak_mb(daemon.pid()) - before < 60, "{} MB more", peak_mb(daemon.pid()) - before);
    // Configured loops still get their places.
    let now_ns = stictiond::runtime::clock::now_ns();
    let sample = |t_ns: i64| format!("{{\"t\":{t_ns},\"v\":1}}");
    let samples = daemon.counter("samples");
    for name in ["FIC101", "FIC102"] {
        put(&format!("{name}/op"), &sample(now_ns));
    }
    wait_for("the named loops", || (daemon.counter("samples") == samples + 2).then_some(()));
    // Ten years ahead of the clock and of the other loops: refused, and the others are unaffected.
    for k in 0..5 {
        put("FIC102/op", &sample(now_ns + 315_360_000_000_000_000 + k));
    }
    wait_for("the refusal", || (daemon.counter("stamps_ahead") == 5).then_some(()));
    put("FIC102/op", &sample(now_ns + 1_000_000_000));
    // Exceeds its rate and its burst of a thousand seconds.
    let flood = format!("[{}1]", "1,".repeat(1999));
    put("FIC101/pv", &flood);
    wait_for("the flood", || (daemon.counter("over_rate") > 900).then_some(()));
    let faults = wait_for("the faults", || Some(daemon.faults()).filter(|f| f.len() >= 3));
    for part in ["max_loops", "max_ahead_s; the last of FIC102, 3650 days", "max_rate_hz"] {
        assert!(faults.iter().any(|f| f.contains(part)), "{part} in {faults:?}");
    }
    assert_eq!(daemon.health()["loops"], 40);
    bus.close().wait().unwrap();
    daemon.stop();
}
