//! A daemon under test, and its recordings.
#![allow(dead_code)] // each test uses a part of it

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use serde_json::Value;
use stiction_engine::codec::topic::{Kind, Leaf, Topic};
use stiction_files::{RecordingReader, log_topic};
use zenoh::Wait;

pub const PREFIX: &str = "plant1/area1";

/// The program under test, or another build named by `STICTIOND_BIN`, to run a test against that.
pub fn program() -> String {
    std::env::var("STICTIOND_BIN").unwrap_or_else(|_| env!("CARGO_BIN_EXE_stictiond").to_owned())
}

pub fn stictiond(args: &[&str]) -> Output {
    Command::new(program()).args(args).output().unwrap()
}

pub fn ok(args: &[&str]) -> String {
    let out = stictiond(args);
    assert!(out.status.success(), "{args:?}: {}\n{}", out.status, String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap()
}

pub fn free_port() -> u16 {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    loop {
        let number = std::process::id().wrapping_mul(97).wrapping_add(NEXT.fetch_add(1, Ordering::Relaxed));
        // Below the ports that systems assign to clients, one of which could take it before the daemon does.
        let port = 20_000 + (number % 12_000) as u16;
        if TcpListener::bind(("127.0.0.1", port)).is_ok() {
            return port;
        }
    }
}

/// A daemon under test, killed on drop.
pub struct Daemon {
    child: Child,
    pub endpoint: String,
    pub recordings: PathBuf,
    /// Address of /metrics and /healthz.
    pub web: String,
    log: Arc<Mutex<String>>,
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Daemon {
    pub fn start(dir: &Path, extra: &str) -> Self {
        Self::start_by(&[], dir, extra)
    }

    /// Starts it through another program, such as a shell that sets limits.
    pub fn start_by(by: &[&str], dir: &Path, extra: &str) -> Self {
        Self::start_with(by, dir, extra, "")
    }

    /// Starts it as a peer of another daemon, if one is given.
    pub fn start_on(dir: &Path, extra: &str, peer: Option<&str>) -> Self {
        Self::start_with(&[], dir, extra, &peer.map(|peer| format!("connect = [{peer:?}]\n")).unwrap_or_default())
    }

    /// Starts it through another program, with additional lines under `[zenoh]`.
    pub fn start_with(by: &[&str], dir: &Path, extra: &str, zenoh: &str) -> Self {
        let endpoint = format!("tcp/127.0.0.1:{}", free_port());
        let path = configure(dir, &endpoint, extra);
        let text = fs::read_to_string(&path).unwrap();
        fs::write(&path, text.replace("[zenoh]\n", &format!("[zenoh]\n{zenoh}"))).unwrap();
        let arguments = ["run", "--config", path.to_str().unwrap(), "--health-every-s", "0.2"];
        let under_test = program();
        let program = [by, &[&under_test], &arguments].concat();
        let mut child = Command::new(program[0]).args(&program[1..]).stderr(Stdio::piped()).spawn().unwrap();
        let mut reader = BufReader::new(child.stderr.take().unwrap());
        let mut line = String::new();
        let log = Arc::new(Mutex::new(String::new()));
        while !line.contains("watching") {
            line.clear();
            assert!(reader.read_line(&mut line).unwrap() > 0, "it ended early:\n{}", log.lock().unwrap());
            log.lock().unwrap().push_str(&line);
        }
        let web = line.split("web=\"").nth(1).and_then(|rest| rest.split('"').next()).unwrap_or_default().to_owned();
        let keep = log.clone();
        std::thread::spawn(move || {
            let mut line = Vec::new();
            while reader.read_until(b'\n', &mut line).is_ok_and(|n| n > 0) {
                keep.lock().unwrap().push_str(&String::from_utf8_lossy(&line));
                line.clear();
            }
        });
        Self { child, endpoint, recordings: dir.join("rec"), web, log }
    }

    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    pub fn signal(&self, name: &str) {
        let pid = self.pid().to_string();
        assert!(Command::new("kill").args([&format!("-{name}"), &pid]).status().unwrap().success());
    }

    /// Whether it is still running.
    pub fn alive(&mut self) -> bool {
        self.child.try_wait().unwrap().is_none()
    }

    /// Its log so far.
    pub fn logged(&self) -> String {
        self.log.lock().unwrap().clone()
    }

    /// Waits for a line of the log.
    #[track_caller]
    pub fn wait_for_log(&self, part: &str) {
        wait_for(part, || self.logged().contains(part).then_some(()));
    }

    /// The daemon's health from the web server.
    pub fn health(&self) -> Value {
        serde_json::from_str(&http(&self.web, "/healthz")).unwrap()
    }

    /// The status of `/healthz`.
    pub fn health_status(&self) -> u16 {
        http_with_status(&self.web, "/healthz").0
    }

    /// Stops it; returns its exit code and its log.
    pub fn end(mut self) -> (Option<i32>, String) {
        self.signal("TERM");
        let code = self.child.wait().unwrap().code();
        // A separate thread reads the rest of the log.
        wait_for("the end of the log", || (Arc::strong_count(&self.log) == 1).then_some(()));
        (code, self.logged())
    }

    pub fn counter(&self, name: &str) -> u64 {
        let text = http(&self.web, "/metrics");
        let row = format!("stictiond_{name}_total ");
        text.lines().find_map(|l| l.strip_prefix(&row)).unwrap_or_else(|| panic!("no {name}")).parse().unwrap()
    }

    /// Faults in the health document, except those about this machine's disk.
    pub fn faults(&self) -> Vec<String> {
        let health = self.health();
        let all = health["faults"].as_array().unwrap().iter().map(|f| f.as_str().unwrap().to_owned());
        all.filter(|f| !f.contains("nearly full")).collect()
    }

    pub fn session(&self) -> zenoh::Session {
        let mut config = zenoh::Config::default();
        config.insert_json5("connect/endpoints", &format!("[{:?}]", self.endpoint)).unwrap();
        config.insert_json5("scouting/multicast/enabled", "false").unwrap();
        zenoh::open(config).wait().unwrap()
    }

    pub fn play(&self, input: &str) {
        ok(&["play", input, "--connect", &self.endpoint, "--prefix", PREFIX, "--speed", "max"]);
    }

    /// Plays a file and waits until everything from it is flushed to the recordings.
    pub fn play_to_disk(&self, input: &str) {
        let before = self.counter("samples");
        self.play(input);
        wait_for("the samples on the disk", || {
            let samples = self.counter("samples");
            let of = |file: &PathBuf| {
                stiction_files::load_samples(file)
                    .map_or(0, |loaded| loaded.loops.iter().map(|one| one.samples.len() as u64).sum::<u64>())
            };
            // A new file has no samples yet.
            let kept: u64 = files(&self.recordings).iter().map(of).sum();
            (samples > before && kept >= samples).then_some(())
        });
    }

    /// Waits until the recording contains this many estimates; it is flushed every tenth of a second.
    pub fn wait_for_estimates(&self, count: usize) {
        let until = Instant::now() + Duration::from_secs(300);
        loop {
            let seen: usize = files(&self.recordings).iter().map(|f| documents(f, Kind::Estimate).len()).sum();
            if seen >= count {
                return;
            }
            assert!(Instant::now() < until, "{seen} of {count} estimates");
            // Every check reads all recordings, which slows the daemon.
            std::thread::sleep(Duration::from_secs(1));
        }
    }

    /// Stops it in order, with exit code 0.
    pub fn stop(mut self) -> PathBuf {
        let pid = self.child.id().to_string();
        assert!(Command::new("kill").args(["-TERM", &pid]).status().unwrap().success());
        let status = wait_for("the daemon's end", || self.child.try_wait().unwrap());
        assert!(status.success(), "{status}");
        self.recordings.clone()
    }

    pub fn kill(mut self) -> PathBuf {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
        self.recordings.clone()
    }
}

/// Writes the configuration of a daemon that records into the folder `rec` next to it.
pub fn configure(dir: &Path, endpoint: &str, extra: &str) -> PathBuf {
    let recordings = dir.join("rec");
    let config = format!(
        "[site]\nprefix = \"{PREFIX}\"\n[zenoh]\nlisten = [\"{endpoint}\"]\n[web]\nlisten = \"127.0.0.1:0\"\n{extra}"
    );
    let config = if extra.contains("[recording]") {
        config.replace("[recording]", &format!("[recording]\ndir = {:?}", recordings.to_str().unwrap()))
    } else {
        format!("{config}\n[recording]\ndir = {:?}\n", recordings.to_str().unwrap())
    };
    let path = dir.join("config.toml");
    fs::write(&path, config).unwrap();
    path
}

pub fn plane(rest: &str) -> String {
    format!("{PREFIX}/@stiction/v1/{rest}")
}

/// The first answer to a query, or the first error.
pub fn ask(bus: &zenoh::Session, selector: &str) -> Result<Value, String> {
    ask_within(bus, selector, Duration::from_secs(300))
}

fn ask_within(bus: &zenoh::Session, selector: &str, within: Duration) -> Result<Value, String> {
    let replies = bus.get(selector).timeout(within).wait().unwrap();
    match replies.recv().map_err(|_| "no answer".to_owned())?.into_result() {
        Ok(sample) => Ok(serde_json::from_slice(&sample.payload().to_bytes()).unwrap()),
        Err(error) => Err(String::from_utf8(error.payload().to_bytes().to_vec()).unwrap()),
    }
}

/// State of FIC101's alarm, from a query; `None` if the daemon does not answer yet.
pub fn alarm_state(bus: &zenoh::Session) -> Option<String> {
    let document = ask_within(bus, &plane("FIC101/alarm"), Duration::from_secs(20)).ok()?;
    Some(document["state"].as_str().unwrap().to_owned())
}

/// A daemon with a raised alarm on FIC101.
pub fn alarmed(dir: &Path) -> Daemon {
    let daemon = Daemon::start(dir, FAST);
    daemon.play(&sticking(dir));
    daemon.wait_for_estimates(6);
    daemon
}

/// The alarm's state after another start.
pub fn state_after_restart(dir: &Path) -> String {
    let daemon = Daemon::start(dir, FAST);
    let bus = daemon.session();
    let state = wait_for("an alarm", || alarm_state(&bus));
    bus.close().wait().unwrap();
    daemon.stop();
    state
}

/// Number of raw samples in a recording.
pub fn raw_samples(file: &Path) -> usize {
    stiction_files::load_samples(file).unwrap().loops.iter().map(|l| l.samples.len()).sum()
}

/// Reports a skipped test past the harness; `tests/run.sh` counts these lines.
pub fn skipped(test: &str, why: &str) {
    let _ = std::io::stderr().lock().write_all(format!("\nSKIPPED: {test}: {why}\n").as_bytes());
}

/// Waits until `look` gives a value.
#[track_caller]
pub fn wait_for<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let until = Instant::now() + Duration::from_secs(120);
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(Instant::now() < until, "waited in vain: {what}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// The body of a response.
pub fn http(address: &str, path: &str) -> String {
    http_with_status(address, path).1
}

/// Status and body of a response.
pub fn http_with_status(address: &str, path: &str) -> (u16, String) {
    let stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    request(stream, &["GET", path], &[("Host", address)], "")
}

/// Sends a request with these headers; returns the status and body of the response.
pub fn request(
    mut stream: impl Read + Write,
    [method, path]: &[&str; 2],
    headers: &[(&str, &str)],
    body: &str,
) -> (u16, String) {
    let lines: String = headers.iter().map(|(name, value)| format!("{name}: {value}\r\n")).collect();
    let length = body.len();
    let head = format!("{method} {path} HTTP/1.1\r\n{lines}Connection: close\r\nContent-Length: {length}\r\n\r\n");
    stream.write_all((head + body).as_bytes()).unwrap();
    let mut bytes = Vec::new();
    // A peer that refuses at once may reset the connection after its response.
    let ended = stream.read_to_end(&mut bytes);
    let text = String::from_utf8_lossy(&bytes);
    let (head, body) = text.split_once("\r\n\r\n").unwrap_or_else(|| panic!("no answer: {text}, {ended:?}"));
    let status = head.split(' ').nth(1).and_then(|word| word.parse().ok());
    let in_chunks = head.to_ascii_lowercase().contains("transfer-encoding: chunked");
    let body = if in_chunks { joined(body) } else { body.to_owned() };
    (status.unwrap_or_else(|| panic!("no status: {head}")), body)
}

/// A body in chunked encoding, decoded.
fn joined(mut body: &str) -> String {
    let mut whole = String::new();
    while let Some((length, rest)) = body.split_once("\r\n") {
        let Some((chunk, rest)) = rest.split_at_checked(usize::from_str_radix(length, 16).unwrap()) else { break };
        whole.push_str(chunk);
        body = rest.trim_start_matches("\r\n");
    }
    whole
}

/// The headers of a command, as sent by the page.
pub fn command_headers<'a>(host: &'a str, more: &[(&'a str, &'a str)]) -> Vec<(&'a str, &'a str)> {
    let usual = [("Host", host), ("X-Stictiond", "1"), ("Content-Type", "application/json")];
    [&usual, more].concat()
}

pub fn files(dir: &Path) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = fs::read_dir(dir).into_iter().flatten().flatten().map(|e| e.path()).collect();
    files.retain(|f| f.to_str().is_some_and(|n| n.ends_with(".mcap") || n.ends_with(".mcap.part")));
    files.sort();
    files
}

/// Loop and JSON of every document of a kind in a file.
pub fn documents(file: &Path, kind: Kind) -> Vec<(String, Value)> {
    let Ok(mut reader) = RecordingReader::open(file) else { return Vec::new() };
    let mut found = Vec::new();
    while let Some(message) = reader.next_message().unwrap() {
        if message.topic() == log_topic(PREFIX) {
            continue;
        }
        let topic = Topic::parse(Some(PREFIX), message.topic()).expect("a topic below the prefix");
        if topic.leaf == Leaf::Document(kind) {
            found.push((topic.loop_name.to_owned(), serde_json::from_slice(message.data).unwrap()));
        }
    }
    found
}

/// A sticking loop's samples: 2000 scans, seven windows of 300 s.
pub fn sticking(dir: &Path) -> String {
    let out = dir.join("sticking.mcap");
    ok(&["simulate", "recordings/scenarios/sticking.toml", "--raw", "--out", out.to_str().unwrap()]);
    out.to_str().unwrap().to_owned()
}

pub const FAST: &str =
    "[window]\nhop_s = 300.0\nmax_points = 400\n[alarm]\nraise = [2, 3]\n[recording]\nflush_s = 0.1\n";
