//! A daemon under test, and what it recorded.
#![allow(dead_code)] // each test takes what it needs

use std::fs;
use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use stictiond::codec::topic::{Kind, Leaf, Topic};
use stictiond::files::RecordingReader;

pub const PREFIX: &str = "plant1/area1";

pub fn stictiond(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_stictiond")).args(args).output().unwrap()
}

pub fn ok(args: &[&str]) -> String {
    let out = stictiond(args);
    assert!(out.status.success(), "{args:?}: {}\n{}", out.status, String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap()
}

pub fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// A daemon under test; killed when dropped.
pub struct Daemon {
    child: Child,
    pub endpoint: String,
    pub recordings: PathBuf,
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Daemon {
    pub fn start(dir: &Path, extra: &str) -> Self {
        let endpoint = format!("tcp/127.0.0.1:{}", free_port());
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
        let mut child = Command::new(env!("CARGO_BIN_EXE_stictiond"))
            .args(["run", "--config", path.to_str().unwrap()])
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut log = BufReader::new(child.stderr.take().unwrap());
        let mut line = String::new();
        while !line.contains("watching") {
            line.clear();
            assert!(log.read_line(&mut line).unwrap() > 0, "the daemon ended before it watched");
        }
        std::thread::spawn(move || std::io::copy(&mut log, &mut std::io::sink()));
        Self { child, endpoint, recordings }
    }

    pub fn play(&self, input: &str) {
        ok(&["play", input, "--connect", &self.endpoint, "--prefix", PREFIX, "--speed", "max"]);
    }

    /// Waits until the recording holds so many estimates; it is flushed every tenth of a second.
    pub fn wait_for_estimates(&self, count: usize) {
        let until = Instant::now() + Duration::from_secs(300);
        loop {
            let seen: usize = files(&self.recordings).iter().map(|f| documents(f, Kind::Estimate).len()).sum();
            if seen >= count {
                return;
            }
            assert!(Instant::now() < until, "{seen} of {count} estimates");
            std::thread::sleep(Duration::from_millis(200));
        }
    }

    /// Ends it in order: exit 0 within 5 s.
    pub fn stop(mut self) -> PathBuf {
        let started = Instant::now();
        let pid = self.child.id().to_string();
        assert!(Command::new("kill").args(["-TERM", &pid]).status().unwrap().success());
        let status = self.child.wait().unwrap();
        assert!(status.success(), "{status}");
        assert!(started.elapsed() < Duration::from_secs(5), "{:?}", started.elapsed());
        self.recordings.clone()
    }

    pub fn kill(mut self) -> PathBuf {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
        self.recordings.clone()
    }
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

pub const FAST: &str = "[window]\nhop_s = 300.0\n[alarm]\nraise = [2, 3]\n[recording]\nflush_s = 0.1\n";
