//! Long runs with a router that is restarted: nothing grows, nothing stops, and the figures are printed.
//!
//! `cargo test --test daemon soak -- --nocapture` takes seconds. `STICTIOND_SOAK_S=3600 cargo test --test daemon soak -- --ignored
//! --nocapture` is an hour of 1,000 loops at 1 Hz with two signals, the router restarted every `STICTIOND_ROUTER_S` (60).

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::live::{free_port, http, ok, wait_for};
use zenoh::Wait;
use zenoh::qos::CongestionControl;

const PREFIX: &str = "plant1/area1";

fn number(name: &str, default: f64) -> f64 {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(default)
}

fn session(mode: &str, listen: bool, port: u16) -> Option<zenoh::Session> {
    let mut config = zenoh::Config::default();
    let endpoints = format!("[\"tcp/127.0.0.1:{port}\"]");
    let place = if listen { "listen/endpoints" } else { "connect/endpoints" };
    for (key, value) in [
        ("mode", format!("{mode:?}")),
        (place, endpoints),
        ("scouting/multicast/enabled", "false".to_owned()),
        ("scouting/gossip/enabled", "false".to_owned()),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    zenoh::open(config).wait().ok()
}

/// A daemon process as a client; killed on drop.
struct Client {
    child: Child,
    web: String,
    recordings: std::path::PathBuf,
}

impl Drop for Client {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Client {
    fn start(dir: &Path, port: u16, extra: &str) -> Self {
        let (config, log, recordings) = (dir.join("c.toml"), dir.join("log"), dir.join("rec"));
        let text = format!(
            "[site]\nprefix = \"{PREFIX}\"\n[zenoh]\nmode = \"client\"\nconnect = [\"tcp/127.0.0.1:{port}\"]\n\
             [web]\nlisten = \"127.0.0.1:0\"\n{extra}dir = {:?}\n",
            recordings.to_str().unwrap()
        );
        fs::write(&config, text).unwrap();
        let child = Command::new(crate::live::program())
            .args(["run", "--config", config.to_str().unwrap()])
            .stdout(Stdio::null())
            .stderr(fs::File::create(&log).unwrap())
            .spawn()
            .unwrap();
        let web = wait_for("the daemon", || {
            let said = fs::read_to_string(&log).unwrap();
            Some(said.split("web=\"").nth(1)?.split('"').next()?.to_owned())
        });
        Self { child, web, recordings }
    }

    fn counter(&self, name: &str) -> u64 {
        let (text, row) = (http(&self.web, "/metrics"), format!("stictiond_{name}_total "));
        text.lines().find_map(|l| l.strip_prefix(&row)).unwrap_or_else(|| panic!("no {name}")).parse().unwrap()
    }

    fn resident_mb(&self) -> f64 {
        let status = fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let row = status.lines().find_map(|l| l.strip_prefix("VmRSS:")).unwrap();
        row.trim().trim_end_matches(" kB").parse::<f64>().unwrap() / 1024.0
    }

    fn descriptors(&self) -> usize {
        fs::read_dir(format!("/proc/{}/fd", self.child.id())).unwrap().count()
    }

    fn stop(mut self) {
        let pid = self.child.id().to_string();
        assert!(Command::new("kill").args(["-TERM", &pid]).status().unwrap().success());
        assert!(wait_for("the daemon's end", || self.child.try_wait().unwrap()).success());
        for entry in fs::read_dir(&self.recordings).unwrap().flatten().map(|e| e.path()) {
            if entry.extension().is_some_and(|e| e == "mcap") {
                ok(&["info", entry.to_str().unwrap(), "--verify"]);
            }
        }
    }
}

#[test]
fn a_router_that_is_restarted_again_and_again_is_found_again() {
    let dir = tempfile::tempdir().unwrap();
    let port = free_port();
    let mut router = session("router", true, port).unwrap();
    let daemon = Client::start(dir.path(), port, "[recording]\n");
    let plant = session("client", false, port).unwrap();
    let mut sent = 0_u64;
    for _ in 0..5 {
        let before = daemon.counter("samples");
        wait_for("samples after a restart", || {
            let t_ns = 1_700_000_000_000_000_000 + sent * 1_000_000_000;
            plant.put(format!("{PREFIX}/A/op"), format!("{{\"t\":{t_ns},\"v\":1}}")).wait().unwrap();
            sent += 1;
            (daemon.counter("samples") > before + 5).then_some(())
        });
        router.close().wait().unwrap();
        std::thread::sleep(Duration::from_millis(300));
        router = wait_for("the port", || session("router", true, port));
    }
    let memory = daemon.resident_mb();
    assert!(memory < 200.0, "{memory} MB");
    let _ = plant.close().wait();
    daemon.stop();
    router.close().wait().unwrap();
}

/// Slope of a straight line through the points, by least squares.
fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let (mx, my) = (points.iter().map(|p| p.0).sum::<f64>() / n, points.iter().map(|p| p.1).sum::<f64>() / n);
    let (top, bottom) =
        points.iter().fold((0.0, 0.0), |(t, b), p| (t + (p.0 - mx) * (p.1 - my), b + (p.0 - mx) * (p.0 - mx)));
    top / bottom
}

#[test]
#[ignore = "an hour: see the head of this file"]
fn soak_with_reconnects() {
    let (seconds, every) = (number("STICTIOND_SOAK_S", 3600.0), number("STICTIOND_ROUTER_S", 60.0));
    let loops = number("STICTIOND_SOAK_LOOPS", 1000.0) as usize;
    let dir = tempfile::tempdir().unwrap();
    let port = free_port();
    let mut router = session("router", true, port).unwrap();
    // Histories fill up and recordings finish within two minutes, so anything that still grows after that grows for ever.
    let window = "[window]\nhop_s = 60.0\nmax_window_s = 120.0\nmax_points = 128\n[recording]\nmax_s = 60.0\n";
    let daemon = Client::start(dir.path(), port, window);
    let plant = session("client", false, port).unwrap();
    let keys: Vec<[String; 2]> = (0..loops).map(|k| ["op", "pv"].map(|s| format!("{PREFIX}/L{k:05}/{s}"))).collect();
    let (started, start_ns) = (Instant::now(), stictiond::runtime::clock::now_ns());
    let (mut sent, mut restarts, mut points, mut most) = (0_u64, 0, Vec::new(), 0);
    let mut next_restart = every;
    for scan in 0..seconds as u64 {
        let now = started.elapsed().as_secs_f64();
        if now > next_restart {
            router.close().wait().unwrap();
            router = wait_for("the port", || session("router", true, port));
            (next_restart, restarts) = (started.elapsed().as_secs_f64() + every, restarts + 1);
        }
        let t_ns = start_ns + scan as i64 * 1_000_000_000;
        for (index, key) in keys.iter().enumerate() {
            for (signal, key) in key.iter().enumerate() {
                let phase = scan as f64 * 0.4 + (index + signal) as f64;
                let value = 50.0 + 3.0 * phase.sin() + ((scan * 7919 + index as u64) % 89) as f64 / 89.0;
                let put = plant.put(key, format!("{{\"t\":{t_ns},\"v\":{value:.3}}}"));
                put.congestion_control(CongestionControl::Block).wait().unwrap();
                sent += 1;
            }
        }
        let at = started.elapsed().as_secs_f64();
        if scan % 10 == 0 {
            most = most.max(daemon.descriptors());
            points.push((at, daemon.resident_mb()));
        }
        std::thread::sleep(Duration::from_secs_f64((scan as f64 + 1.0 - at).max(0.0)));
    }
    let half: Vec<(f64, f64)> = points.iter().copied().filter(|(at, _)| *at > seconds / 2.0).collect();
    let per_hour = slope(&half) * 3600.0;
    println!(
        "{loops} loops x 1 Hz x 2 signals for {:.0} s: {sent} sent, {} received, {} dropped, {} recorded, {} lost, {} windows, \
         {} without a fit; {restarts} restarts of the router; memory {:.0} to {:.0} MB, {per_hour:+.1} MB an hour in the second \
         half; {most} descriptors at most, {} at the end",
        started.elapsed().as_secs_f64(),
        daemon.counter("messages"),
        daemon.counter("dropped_input"),
        daemon.counter("recorded"),
        daemon.counter("recording_lost"),
        daemon.counter("windows"),
        daemon.counter("fits_skipped"),
        points[0].1,
        points.iter().map(|p| p.1).fold(0.0, f64::max),
        daemon.descriptors(),
    );
    assert_eq!(daemon.counter("recording_lost"), 0);
    assert!(daemon.counter("messages") > sent / 2, "it heard the plant");
    assert!(most < 100 && points.iter().all(|p| p.1 < 1000.0), "{most} descriptors, {points:?}");
    let _ = plant.close().wait();
    daemon.stop();
    router.close().wait().unwrap();
}
