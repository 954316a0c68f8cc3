//! Starts: with a damaged store, with a stop request before the start is complete, and with configurations of any size.

use std::fmt::Write as _;
use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use stiction_engine::codec::topic::Kind;
use zenoh::Wait;

use crate::live::{
    self, Daemon, FAST, alarm_state, alarmed, ask, configure, documents, files, free_port, plane, state_after_restart,
    stictiond, wait_for,
};

#[test]
fn a_store_that_is_damaged_before_a_start_or_under_the_daemon_costs_no_alarm() {
    let dir = tempfile::tempdir().unwrap();
    alarmed(dir.path()).stop();
    let store = dir.path().join("rec/state.redb");
    let mut random = ChaCha8Rng::seed_from_u64(7);
    for round in 0..8 {
        let mut bytes = fs::read(&store).unwrap();
        let at = random.next_u32() as usize % bytes.len();
        match round % 3 {
            0 => bytes.truncate(at),
            1 => bytes[at..].fill(0xa5),
            // The pages with data; the rest is free space.
            _ => bytes[..16_384].iter_mut().step_by(97).for_each(|byte| *byte ^= 4),
        }
        fs::write(&store, &bytes).unwrap();
        assert_eq!(state_after_restart(dir.path()), "unack", "round {round}, at {at}");
    }
    // The store is damaged under a running daemon: acknowledged commands persist, whatever the next start finds in the store.
    for (round, cmd) in ["suppress", "unsuppress", "suppress"].into_iter().enumerate() {
        let earlier = files(&dir.path().join("rec"));
        let daemon = Daemon::start(dir.path(), FAST);
        let bus = daemon.session();
        wait_for("an alarm", || alarm_state(&bus));
        let length = fs::metadata(&store).unwrap().len();
        match round {
            0 => fs::File::options().write(true).open(&store).unwrap().set_len(length / 2).unwrap(),
            1 => fs::write(&store, vec![0x5a; length as usize]).unwrap(),
            _ => fs::write(&store, b"").unwrap(),
        }
        let wanted = if cmd == "suppress" { "suppressed" } else { "unack" };
        // The first reply may say that the command could not be stored; no later one does.
        let _ = ask(&bus, &plane(&format!("FIC101/alarm?cmd={cmd};by=ann")));
        wait_for("its state", || (alarm_state(&bus).as_deref() == Some(wanted)).then_some(()));
        wait_for("a store", || (!daemon.faults().iter().any(|f| f.contains("cannot be stored"))).then_some(()));
        // The recording contains the same.
        wait_for("the recording of it", || {
            let own = files(&daemon.recordings).into_iter().filter(|file| !earlier.contains(file));
            let mut alarms = own.flat_map(|file| documents(&file, Kind::Alarm));
            alarms.any(|(_, alarm)| alarm["state"] == wanted).then_some(())
        });
        let _ = bus.close().wait();
        daemon.kill();
        assert_eq!(state_after_restart(dir.path()), wanted, "round {round}");
    }
}

/// Whether the process handles SIGTERM yet.
fn takes_sigterm(pid: u32) -> bool {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
    let caught = status.lines().find_map(|l| l.strip_prefix("SigCgt:")).map_or("0", str::trim);
    u64::from_str_radix(caught, 16).unwrap() & (1 << (15 - 1)) != 0
}

fn spawn(config: &Path) -> std::process::Child {
    let mut command = Command::new(live::program());
    command.args(["run", "--config", config.to_str().unwrap()]).stdout(Stdio::null()).stderr(Stdio::null());
    command.spawn().unwrap()
}

#[test]
fn asked_to_stop_or_to_reload_while_it_starts_it_ends_in_order_and_forgets_nothing() {
    let dir = tempfile::tempdir().unwrap();
    alarmed(dir.path()).kill();
    let config = configure(dir.path(), &format!("tcp/127.0.0.1:{}", free_port()), FAST);
    let mut random = ChaCha8Rng::seed_from_u64(5);
    for cycle in 0..24 {
        if cycle % 3 == 0 {
            // Without the store it reads recordings first.
            let _ = fs::remove_file(dir.path().join("rec/state.redb"));
        }
        let mut child = spawn(&config);
        wait_for("its signals", || takes_sigterm(child.id()).then_some(()));
        std::thread::sleep(Duration::from_micros(u64::from(random.next_u32() % 60_000)));
        let pid = child.id().to_string();
        let send = |signal: &str| assert!(Command::new("kill").args([signal, &pid]).status().unwrap().success());
        if cycle % 2 == 0 {
            send("-HUP");
        }
        send("-TERM");
        let ended = wait_for("its end", || child.try_wait().unwrap());
        assert!(ended.success(), "cycle {cycle}: {ended}, signal {:?}", ended.signal());
    }
    assert_eq!(state_after_restart(dir.path()), "unack");
}

#[test]
fn a_configuration_of_a_whole_site_is_read_and_one_of_nonsense_refused_in_a_sentence() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("site.toml");
    let rec = dir.path().join("rec");
    let mut text = format!("[site]\nprefix = \"p\"\n[recording]\ndir = {:?}\n", rec.to_str().unwrap());
    for k in 0..50_000 {
        let _ = writeln!(text, "[[loop]]\nname = \"L{k}\"\nop = \"gw/L{k}.MV\"\npv = \"gw/L{k}.PV\"\nhop_s = 300.0");
    }
    let check = |text: &str| {
        fs::write(&path, text).unwrap();
        let out = stictiond(&["check", path.to_str().unwrap()]);
        (out.status.code(), String::from_utf8_lossy(&out.stdout).into_owned())
    };
    let (code, said) = check(&text);
    assert_eq!(code, Some(0), "{said}");
    let (code, said) = check(&format!("{text}[[loop]]\nname = \"L7\"\npv = \"gw/L9.PV\"\n"));
    assert_eq!(code, Some(1));
    assert!(
        said.contains("line 250005: loop[50000].name") && said.contains("already mapped for loop \"L9\""),
        "{said}"
    );
    for nonsense in
        ["[".repeat(100_000), format!("x = {}1", "[".repeat(50_000)), "\u{0}".repeat(1000), "=\n".repeat(20_000)]
    {
        let (code, said) = check(&nonsense);
        assert_eq!(code, Some(1), "{}", said.chars().take(300).collect::<String>());
    }
}
