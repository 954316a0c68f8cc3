//! Links that stall, break and recover, and readers that stop reading.

use std::collections::BTreeSet;
use std::fs;
use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use stiction::core::record::Signal;
use zenoh::Wait;
use zenoh::qos::CongestionControl;

use crate::live::{self, Daemon, PREFIX, files, http, ok, wait_for};

/// A connection that holds bytes back and is cut, as with wireless bridges and failing switches: what lost packets look like
/// through TCP.
pub struct BadLine {
    pub port: u16,
    bad: Arc<AtomicBool>,
    /// Nothing that the daemon sends is forwarded.
    pub deaf: Arc<AtomicBool>,
    cuts: Arc<AtomicU64>,
}

impl BadLine {
    pub fn to(daemon_port: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let (bad, cuts) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
        let deaf = Arc::new(AtomicBool::new(false));
        let line = Self { port, bad: bad.clone(), deaf: deaf.clone(), cuts: cuts.clone() };
        std::thread::spawn(move || {
            let mut seen = 0;
            for (number, near) in listener.incoming().flatten().enumerate() {
                // After a cut the connection remains dead for a while.
                if seen != cuts.load(Ordering::Relaxed) {
                    seen = cuts.load(Ordering::Relaxed);
                    std::thread::sleep(Duration::from_millis(500));
                }
                let Ok(far) = TcpStream::connect(("127.0.0.1", daemon_port)) else { continue };
                for (way, (from, to)) in [(&near, &far), (&far, &near)].into_iter().enumerate() {
                    let ends = (from.try_clone().unwrap(), to.try_clone().unwrap());
                    let random = ChaCha8Rng::seed_from_u64(2 * number as u64 + way as u64);
                    let (bad, cuts) = (bad.clone(), cuts.clone());
                    let deaf = (way == 1).then(|| deaf.clone());
                    std::thread::spawn(move || carry(ends, random, (&bad, deaf.as_deref()), &cuts));
                }
            }
        });
        line
    }
}

fn carry(
    (mut from, mut to): (TcpStream, TcpStream),
    mut random: ChaCha8Rng,
    (bad, deaf): (&AtomicBool, Option<&AtomicBool>),
    cuts: &AtomicU64,
) {
    let mut buffer = [0; 4096];
    while let Ok(length @ 1..) = from.read(&mut buffer) {
        while deaf.is_some_and(|deaf| deaf.load(Ordering::Relaxed)) {
            std::thread::sleep(Duration::from_millis(10));
        }
        if bad.load(Ordering::Relaxed) {
            let draw = random.next_u32() % 400;
            std::thread::sleep(Duration::from_millis(if draw < 40 { u64::from(draw) } else { 0 }));
            if draw == 399 {
                cuts.fetch_add(1, Ordering::Relaxed);
                break;
            }
        }
        if to.write_all(&buffer[..length]).is_err() {
            break;
        }
    }
    let _ = (from.shutdown(Shutdown::Both), to.shutdown(Shutdown::Both));
}

/// A client on the plant's side that keeps trying to connect.
pub fn client(port: u16) -> zenoh::Session {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"client\"".to_owned()),
        ("connect/endpoints", format!("[\"tcp/127.0.0.1:{port}\"]")),
        ("connect/timeout_ms", "-1".to_owned()),
        ("connect/exit_on_failure", "false".to_owned()),
        ("scouting/multicast/enabled", "false".to_owned()),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    zenoh::open(config).wait().unwrap()
}

/// A total of all loops' aligner counts, by name.
fn aligned(daemon: &Daemon, name: &str) -> u64 {
    let row = format!("stictiond_aligner{{name=\"{name}\"}} ");
    http(&daemon.web, "/metrics").lines().find_map(|l| l.strip_prefix(&row)).map_or(0, |n| n.parse().unwrap())
}

/// Stamps of a signal in all recordings, in the order in which they were taken, s.
fn recorded(recordings: &Path, signal: Signal) -> Vec<i64> {
    let of = |file| {
        let loops = stiction_files::load_samples(file).unwrap().loops;
        let samples: Vec<_> = loops.into_iter().flat_map(|l| l.samples).filter(|s| s.signal == signal).collect();
        samples.into_iter().map(|s| s.t_ns / 1_000_000_000)
    };
    files(recordings).iter().flat_map(|file| of(file.as_path())).collect()
}

#[test]
fn what_a_failing_link_loses_is_lost_once_and_the_holes_are_those_that_an_oracle_counts() {
    const START_S: i64 = 1_700_000_000;
    const HOLE_S: i64 = 5;
    let dir = tempfile::tempdir().unwrap();
    let extra = format!("[window]\nmax_gap_s = {HOLE_S}.0\n[recording]\nflush_s = 0.1\n");
    let daemon = Daemon::start(dir.path(), &extra);
    let line = BadLine::to(daemon.endpoint.rsplit(':').next().unwrap().parse().unwrap());
    let plant = client(line.port);
    let mut sent = 0;
    let mut send = |pause: Duration| {
        for signal in ["op", "pv"] {
            let payload = format!("{{\"t\":{},\"v\":{}}}", (START_S + sent) * 1_000_000_000, sent % 7);
            plant.put(format!("{PREFIX}/A/{signal}"), payload).wait().unwrap();
        }
        sent += 1;
        std::thread::sleep(pause);
        sent
    };
    wait_for("the first sample", || {
        send(Duration::from_millis(20));
        (daemon.counter("samples") > 0).then_some(())
    });
    line.bad.store(true, Ordering::Relaxed);
    wait_for("three cuts", || {
        for _ in 0..50 {
            send(Duration::from_millis(10));
        }
        (line.cuts.load(Ordering::Relaxed) >= 3).then_some(())
    });
    line.bad.store(false, Ordering::Relaxed);
    // New samples arrive once the faults have stopped.
    let before = daemon.counter("samples");
    wait_for("samples after it", || {
        send(Duration::from_millis(10));
        (daemon.counter("samples") > before + 60).then_some(())
    });
    let sent = send(Duration::from_millis(500));
    let samples = daemon.counter("samples");
    // The aligners' totals are published with the health, so two documents later they include all samples.
    let uptime = || daemon.health()["uptime_s"].as_f64().unwrap();
    for _ in 0..2 {
        let before = uptime();
        wait_for("the next health document", || (uptime() > before).then_some(()));
    }
    let holes = aligned(&daemon, "gaps");
    assert_eq!((daemon.counter("dropped_input"), daemon.counter("recording_lost")), (0, 0));
    let _ = plant.close().wait();
    let recordings = daemon.stop();
    let of = [Signal::Op, Signal::Pv].map(|signal| recorded(&recordings, signal));
    assert_eq!(of.iter().map(Vec::len).sum::<usize>() as u64, samples, "what was counted was recorded");
    for stamps in &of {
        assert!(stamps.windows(2).all(|w| w[0] < w[1]), "nothing came twice or out of order");
        assert!(stamps.iter().all(|t| (START_S..START_S + sent).contains(t)));
    }
    let both: Vec<i64> = {
        let op: BTreeSet<i64> = of[0].iter().copied().collect();
        of[1].iter().copied().filter(|t| op.contains(t)).collect()
    };
    let counted = both.windows(2).filter(|w| w[1] - w[0] > HOLE_S).count() as u64;
    println!("{} cuts: {samples} of {} samples, {holes} holes", line.cuts.load(Ordering::Relaxed), 2 * sent);
    assert!(holes > 0 && holes == counted, "{holes} holes, the oracle counts {counted}");
}

/// A process that is stopped for a while; killed on drop.
struct Reader(Child);

impl Reader {
    /// Another daemon on the same keys, which receives every document of the first.
    fn start(dir: &Path, port: u16) -> Self {
        let (config, rec) = (dir.join("reader.toml"), dir.join("reader"));
        let text = format!(
            "[site]\nprefix = \"{PREFIX}\"\n[zenoh]\nmode = \"client\"\nconnect = [\"tcp/127.0.0.1:{port}\"]\n\
             [web]\nenabled = false\n[recording]\ndir = {:?}\n",
            rec.to_str().unwrap()
        );
        fs::write(&config, text).unwrap();
        let log = dir.join("reader.log");
        let mut command = Command::new(live::program());
        command.args(["run", "--config", config.to_str().unwrap()]).stdout(Stdio::null());
        let reader = Self(command.stderr(fs::File::create(&log).unwrap()).spawn().unwrap());
        wait_for("the reader", || fs::read_to_string(&log).unwrap().contains("watching").then_some(()));
        reader
    }

    fn signal(&self, name: &str) {
        let pid = self.0.id().to_string();
        assert!(Command::new("kill").args([&format!("-{name}"), &pid]).status().unwrap().success());
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_reader_that_is_stopped_holds_nothing_up_and_hears_again_when_it_goes_on() {
    const LOOPS: usize = 40;
    let dir = tempfile::tempdir().unwrap();
    let extra = "[window]\nhop_s = 10.0\nmax_window_s = 60.0\n[gap]\nenabled = false\n[recording]\nflush_s = 0.1\n";
    let daemon = Daemon::start(dir.path(), extra);
    let reader = Reader::start(dir.path(), daemon.endpoint.rsplit(':').next().unwrap().parse().unwrap());
    let bus = daemon.session();
    let mut at_s = 1_700_000_000_i64;
    // This many seconds of every loop, without stiction: a document for every ten seconds of plant time.
    let mut feed = |seconds: i64| {
        for index in 0..LOOPS {
            for signal in ["op", "pv"] {
                let sample = |t: i64| {
                    format!("{{\"t\":{},\"v\":{}}}", t * 1_000_000_000, (t % 1000 * (t % 1000) * 7919 + 13) % 97)
                };
                let batch: Vec<String> = (at_s..at_s + seconds).map(sample).collect();
                let put = bus.put(format!("{PREFIX}/L{index}/{signal}"), format!("[{}]", batch.join(",")));
                put.congestion_control(CongestionControl::Block).wait().unwrap();
            }
        }
        at_s += seconds;
    };
    feed(100);
    wait_for("documents", || (daemon.counter("estimates") >= 8 * LOOPS as u64).then_some(()));
    reader.signal("STOP");
    let (published, before) = (daemon.counter("published"), daemon.counter("windows"));
    (0..6).for_each(|_| {
        feed(100);
        std::thread::sleep(Duration::from_secs(1));
    });
    // While the reader is stopped, every window gets its estimate, recorded, and published or counted.
    wait_for("every window", || {
        let windows = daemon.counter("windows");
        (windows >= before + 50 * LOOPS as u64 && daemon.counter("estimates") == windows).then_some(())
    });
    assert_eq!((daemon.counter("dropped_input"), daemon.counter("recording_lost")), (0, 0));
    wait_for("the publisher", || {
        let done = daemon.counter("published") + daemon.counter("dropped_output");
        (done >= published + 50 * LOOPS as u64).then_some(())
    });
    reader.signal("CONT");
    let health = daemon.health()["queues"].as_array().unwrap().clone();
    assert!(health.iter().all(|q| q["length"].as_u64() <= q["limit"].as_u64()), "{health:?}");
    // Afterwards new documents are received, also by a new reader.
    let published = daemon.counter("published");
    feed(100);
    wait_for("documents after it", || (daemon.counter("published") > published + 8 * LOOPS as u64).then_some(()));
    drop(reader);
    bus.close().wait().unwrap();
    for file in files(&daemon.stop()) {
        ok(&["info", file.to_str().unwrap(), "--verify"]);
    }
}
