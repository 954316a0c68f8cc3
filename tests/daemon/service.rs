//! Running as a service: signals, locks, system limits, and what `check` finds before the start.

use std::fs;
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::live::{Daemon, configure, files, free_port, ok, skipped, stictiond, wait_for};
use zenoh::Wait;

#[test]
fn sighup_reads_the_configuration_again_and_begins_new_recordings() {
    let dir = tempfile::tempdir().unwrap();
    let mut daemon = Daemon::start(dir.path(), "");
    let first = wait_for("a file", || files(&daemon.recordings).pop());
    let config = dir.path().join("config.toml");
    let text = fs::read_to_string(&config).unwrap();
    fs::write(&config, format!("{text}max_s = 77.0\n[commands]\nenabled = false\n[alarm]\ns_limit_op = 2.0\n"))
        .unwrap();
    daemon.signal("HUP");
    daemon.wait_for_log("these changes are in force");
    let log = daemon.logged();
    let line = |part: &str| log.lines().find(|l| l.contains(part)).unwrap_or_default().to_owned();
    let said = line("changes are in force");
    assert!(said.contains("alarm.s_limit_op") && said.contains("commands.enabled, recording.max_s"), "{log}");
    // The file is finished, and a new one is open.
    let done = first.with_extension("");
    wait_for("the finished file", || done.exists().then_some(()));
    wait_for("a new file", || (files(&daemon.recordings).len() == 2).then_some(()));
    ok(&["info", done.to_str().unwrap(), "--verify"]);
    // A broken file changes nothing, and is a fault until it is fixed.
    fs::write(&config, "[site]\nprefx = 1\n").unwrap();
    daemon.signal("HUP");
    wait_for("the fault", || daemon.faults().iter().any(|f| f.contains("the old one holds")).then_some(()));
    fs::write(&config, text).unwrap();
    daemon.signal("HUP");
    wait_for("no fault", || daemon.faults().is_empty().then_some(()));
    assert!(daemon.alive());
    daemon.stop();
}

#[test]
fn systemd_is_told_and_the_engine_feeds_its_watchdog() {
    let dir = tempfile::tempdir().unwrap();
    let place = dir.path().join("notify");
    let socket = UnixDatagram::bind(&place).unwrap();
    socket.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    let address = format!("NOTIFY_SOCKET={}", place.to_str().unwrap());
    let daemon = Daemon::start_by(&["env", &address, "WATCHDOG_USEC=400000"], dir.path(), "");
    let heard = |wanted: &str| {
        let mut buffer = [0_u8; 4096];
        loop {
            let length = socket.recv(&mut buffer).unwrap_or_else(|e| panic!("waited for {wanted}: {e}"));
            let text = String::from_utf8_lossy(&buffer[..length]).into_owned();
            if text.lines().any(|line| line.starts_with(wanted)) {
                return text;
            }
        }
    };
    heard("READY=1");
    (0..3).for_each(|_| drop(heard("WATCHDOG=1")));
    daemon.signal("HUP");
    assert!(heard("RELOADING=1").contains("MONOTONIC_USEC="));
    heard("READY=1");
    daemon.signal("TERM");
    heard("STOPPING=1");
}

#[test]
fn a_folder_belongs_to_one_daemon() {
    let dir = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(dir.path(), "");
    let path = configure(dir.path(), &format!("tcp/127.0.0.1:{}", free_port()), "");
    let second = stictiond(&["run", "--config", path.to_str().unwrap()]);
    assert_eq!(second.status.code(), Some(1));
    let said = String::from_utf8_lossy(&second.stderr).into_owned();
    assert!(said.contains("recording folder of a running daemon") && said.contains("[recording] dir"), "{said}");
    daemon.kill();
    Daemon::start(dir.path(), "").stop();
}

#[test]
fn a_limit_on_file_size_costs_recordings_not_the_daemon() {
    let dir = tempfile::tempdir().unwrap();
    // In blocks of 512 bytes or 1 KiB, depending on the shell: at most 256 KiB per file, less than the store and a recording
    // need.
    let mut daemon =
        Daemon::start_by(&["sh", "-c", "ulimit -f 256; exec \"$@\"", "sh"], dir.path(), "[recording]\nflush_s = 0.1\n");
    let bus = daemon.session();
    let mut sent = 0_u64;
    wait_for("the fault", || {
        for _ in 0..2000 {
            let (t_ns, value) = (1_700_000_000_000_000_000 + sent * 1_000_000_000, (sent as f64 * 0.7).sin() * 1e9);
            bus.put("plant1/area1/A/op", format!("{{\"t\":{t_ns},\"v\":{value}}}")).wait().unwrap();
            sent += 1;
        }
        daemon.faults().iter().any(|f| f.contains("recording has stopped") || f.contains("stored")).then_some(())
    });
    assert!(daemon.alive());
    bus.close().wait().unwrap();
    // The index of the last file may not fit either.
    let (code, log) = daemon.end();
    assert!(code == Some(0) || code == Some(1) && log.contains("recordings not finished"), "{code:?}\n{log}");
}

#[test]
fn check_finds_a_missing_zenoh_file_and_a_folder_that_cannot_be_written() {
    let dir = tempfile::tempdir().unwrap();
    let check = |extra: &str| {
        let path = dir.path().join("c.toml");
        fs::write(&path, format!("[site]\nprefix = \"p\"\n{extra}")).unwrap();
        let out = stictiond(&["check", path.to_str().unwrap()]);
        (out.status.code().unwrap(), String::from_utf8(out.stdout).unwrap())
    };
    let place = dir.path().join("plain");
    fs::write(&place, b"").unwrap();
    let (code, said) = check("[zenoh]\nmode = \"peer\"\nconfig_file = \"nowhere.json5\"\n");
    assert!(code == 1 && said.contains("line 5: zenoh.config_file") && said.contains("nowhere.json5"), "{said}");
    let (code, said) = check(&format!("[recording]\ndir = {:?}\n", place.join("rec").to_str().unwrap()));
    assert!(code == 1 && said.contains("line 4: recording.dir") && said.contains("plain"), "{said}");
    let (code, said) = check(&format!("[recording]\ndir = {:?}\n", dir.path().join("new/rec").to_str().unwrap()));
    assert_eq!(code, 0, "{said}");
    assert!(!dir.path().join("new").exists(), "a check leaves nothing behind");
}

#[test]
fn a_second_daemon_under_the_same_zenoh_id_says_that_it_is_blind() {
    let dir = tempfile::tempdir().unwrap();
    let port = free_port();
    let zenoh_file = |name: &str, links: &str| {
        let path = dir.path().join(name);
        let text = format!("{{id:\"abcd1234\",mode:\"peer\",scouting:{{multicast:{{enabled:false}}}},{links}}}");
        fs::write(&path, text).unwrap();
        path
    };
    let first = zenoh_file("a.json5", &format!("listen:{{endpoints:[\"tcp/127.0.0.1:{port}\"]}}"));
    let second =
        zenoh_file("b.json5", &format!("connect:{{endpoints:[\"tcp/127.0.0.1:{port}\"]}},listen:{{endpoints:[]}}"));
    let start = |name: &str, file: &Path| {
        let path = dir.path().join(format!("{name}.toml"));
        let rec = dir.path().join(name);
        let text = format!(
            "[site]\nprefix = \"p\"\n[zenoh]\nconfig_file = {:?}\n[web]\nenabled = false\n[recording]\ndir = {:?}\n",
            file.to_str().unwrap(),
            rec.to_str().unwrap()
        );
        fs::write(&path, text).unwrap();
        let log = fs::File::create(dir.path().join(format!("{name}.log"))).unwrap();
        let mut command = Command::new(crate::live::program());
        command.args(["run", "--config", path.to_str().unwrap()]).stderr(log).stdout(Stdio::null()).spawn().unwrap()
    };
    let said = |name: &str, part: &str| {
        fs::read_to_string(dir.path().join(format!("{name}.log"))).unwrap().contains(part).then_some(())
    };
    let mut a = start("a", &first);
    wait_for("the first", || said("a", "watching"));
    let mut b = start("b", &second);
    wait_for("the fault", || said("b", "another daemon uses the Zenoh id abcd1234"));
    a.kill().unwrap();
    b.kill().unwrap();
    a.wait().unwrap();
    b.wait().unwrap();
}

/// A daemon that may never start watching; killed on drop.
struct Started(std::process::Child, std::path::PathBuf);

impl Drop for Started {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Started {
    fn new(dir: &Path, zenoh: &str, web: u16) -> Self {
        let (path, log) = (dir.join("c.toml"), dir.join("log"));
        let rec = dir.join("rec");
        let text = format!(
            "[site]\nprefix = \"plant1/area1\"\n[zenoh]\n{zenoh}\n[web]\nlisten = \"127.0.0.1:{web}\"\n[recording]\ndir = {:?}\n",
            rec.to_str().unwrap()
        );
        fs::write(&path, text).unwrap();
        let mut command = Command::new(crate::live::program());
        let child = command.args(["run", "--config", path.to_str().unwrap()]).stdout(Stdio::null());
        Self(child.stderr(fs::File::create(&log).unwrap()).spawn().unwrap(), log)
    }

    fn said(&self, part: &str) -> Option<()> {
        fs::read_to_string(&self.1).unwrap().contains(part).then_some(())
    }
}

/// Faults from the web server, once it responds.
fn faults_at(web: u16) -> Option<String> {
    std::net::TcpStream::connect(("127.0.0.1", web)).ok()?;
    let health: serde_json::Value =
        serde_json::from_str(&crate::live::http(&format!("127.0.0.1:{web}"), "/healthz")).ok()?;
    Some(health["faults"].to_string())
}

#[test]
fn taken_ports_are_faults_that_clear_and_loops_are_watched_meanwhile() {
    let dir = tempfile::tempdir().unwrap();
    let (on_web, on_bus) =
        (std::net::TcpListener::bind("127.0.0.1:0").unwrap(), std::net::TcpListener::bind("127.0.0.1:0").unwrap());
    let port = |of: &std::net::TcpListener| of.local_addr().unwrap().port();
    let (web, bus) = (port(&on_web), port(&on_bus));
    let daemon = Started::new(dir.path(), &format!("listen = [\"tcp/127.0.0.1:{bus}\"]"), web);
    wait_for("the daemon", || daemon.said("watching"));
    assert!(daemon.said("[web] listen").is_some() && daemon.said("is another stictiond running").is_some());
    wait_for("a recording", || (!files(&dir.path().join("rec")).is_empty()).then_some(()));
    drop(on_web);
    wait_for("the web server", || {
        faults_at(web).filter(|f| f.contains("cannot open the Zenoh listener") && !f.contains("[web]"))
    });
    drop(on_bus);
    wait_for("no fault", || faults_at(web).filter(|f| f == "[]"));
    drop(std::net::TcpStream::connect(("127.0.0.1", bus)).expect("it listens"));
}

#[test]
fn a_router_that_is_not_there_is_a_fault_until_it_comes() {
    let dir = tempfile::tempdir().unwrap();
    let (web, port) = (free_port(), free_port());
    let zenoh = format!("mode = \"client\"\nconnect = [\"tcp/127.0.0.1:{port}\"]");
    let daemon = Started::new(dir.path(), &zenoh, web);
    wait_for("the fault", || faults_at(web).filter(|f| f.contains("no router answers")));
    assert!(daemon.said("watching").is_none());
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"router\"".to_owned()),
        ("listen/endpoints", format!("[\"tcp/127.0.0.1:{port}\"]")),
        ("scouting/multicast/enabled", "false".to_owned()),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    let router = zenoh::open(config).wait().unwrap();
    wait_for("the daemon", || daemon.said("watching"));
    wait_for("no fault", || faults_at(web).filter(|f| f == "[]"));
    drop(daemon);
    router.close().wait().unwrap();
}

/// A folder on a separate disk of 4 MiB, which only root can create; unmounted on drop.
struct SmallDisk(std::path::PathBuf);

impl SmallDisk {
    fn mount(dir: &Path, options: &str) -> Option<Self> {
        fs::create_dir_all(dir).unwrap();
        let out = Command::new("mount").args(["-t", "tmpfs", "-o", options, "tmpfs"]).arg(dir).output().ok()?;
        out.status.success().then(|| Self(dir.to_owned()))
    }

    fn remount(&self, options: &str) {
        let status = Command::new("mount").args(["-o", &format!("remount,{options}")]).arg(&self.0).status().unwrap();
        assert!(status.success());
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).status();
    }
}

#[test]
fn a_full_disk_and_a_read_only_one_are_faults_that_clear_and_every_sample_is_accounted_for() {
    let dir = tempfile::tempdir().unwrap();
    let rec = dir.path().join("rec");
    let Some(disk) = SmallDisk::mount(&rec, "size=4m,ro") else {
        return skipped("a_full_disk", "mounting a small disk takes root");
    };
    let mut daemon = Daemon::start(dir.path(), "[recording]\nflush_s = 0.1\n");
    let bus = daemon.session();
    let mut sent = 0_u64;
    let mut feed = |daemon: &Daemon| {
        for _ in 0..500 {
            let t_ns = 1_700_000_000_000_000_000 + sent * 1_000_000_000;
            bus.put("plant1/area1/A/op", format!("{{\"t\":{t_ns},\"v\":{}}}", sent % 977)).wait().unwrap();
            sent += 1;
        }
        wait_for("the samples", || (daemon.counter("samples") == sent).then_some(()));
        sent
    };
    let named = |daemon: &Daemon, part: &str| {
        wait_for(part, || daemon.faults().iter().any(|f| f.contains(part)).then_some(()));
    };
    feed(&daemon);
    named(&daemon, "recording has stopped");
    wait_for("503", || (daemon.health_status() == 503).then_some(()));
    disk.remount("rw,size=4m");
    wait_for("a recording", || (daemon.counter("recording_files") > 0).then_some(()));
    feed(&daemon);
    wait_for("its samples", || (daemon.counter("recorded") >= 500).then_some(()));
    let stopped = || daemon.faults().iter().any(|f| f.contains("recording has stopped"));
    wait_for("the fault's end", || (!stopped()).then_some(()));
    wait_for("200", || (daemon.health_status() == 200).then_some(()));
    // Another program fills the disk.
    let filler = rec.join("filler");
    let mut file = fs::File::create(&filler).unwrap();
    while std::io::Write::write(&mut file, &[7; 4096]).is_ok_and(|n| n > 0) {}
    drop(file);
    feed(&daemon);
    named(&daemon, "recording has stopped");
    assert!(daemon.alive());
    fs::remove_file(&filler).unwrap();
    wait_for("another recording", || (daemon.counter("recording_files") > 1).then_some(()));
    let sent = feed(&daemon);
    wait_for("no standing fault", || {
        (!daemon.faults().iter().any(|f| f.contains("stopped") || f.contains("stored"))).then_some(())
    });
    wait_for("all accounted for", || {
        (daemon.counter("recorded") + daemon.counter("recording_lost") == sent).then_some(())
    });
    bus.close().wait().unwrap();
    let (lost, recordings) = (daemon.counter("recording_lost"), daemon.stop());
    let samples = |file: &std::path::PathBuf| -> usize {
        stiction_files::load_samples(file).unwrap().loops.iter().map(|l| l.samples.len()).sum()
    };
    let kept: usize = files(&recordings).iter().map(samples).sum();
    assert!(lost > 500 && kept as u64 + lost >= sent, "{kept} kept and {lost} lost of {sent}");
}
