//! What a start makes of loops that are silent, had left, were removed in the meantime, or were recorded by another daemon.

use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use serde_json::Value;
use stiction_engine::alarm::{Command, State};
use stiction_engine::codec::topic::Kind;
use stiction_engine::config::Config;
use stiction_files::disk::{Disk, SystemDisk};
use stictiond::daemon::replay::chains_of;
use stictiond::daemon::sim_daemon::{SimDaemon, no_receiver};
use stictiond::runtime::clock::Clock;

use super::leavers::shown;
use super::refill::replays_to_the_byte;

fn text_of(dir: &Path, input: &str, more: &str) -> String {
    format!(
        "[site]\nprefix = \"p\"\n[input]\nmax_ahead_s = 0.0\n{input}[window]\nhop_s = 60.0\n[alarm]\nraise = [1, 1]\n\
         [gap]\nenabled = false\n[plant]\ngroups = false\n[recording]\nflush_s = 0.1\ndir = {:?}\n{more}",
        dir.to_str().unwrap()
    )
}

fn start(text: &str, clock: &Clock) -> SimDaemon {
    let disk = Arc::new(SystemDisk) as Arc<dyn Disk>;
    SimDaemon::start(Config::parse(text).unwrap(), text, clock, &disk, no_receiver).unwrap()
}

/// A loop sends a minute of samples up to the current time, one a second.
fn send(stage: &mut SimDaemon, name: &str, clock: &Clock) {
    let now_s = clock.now_ns() / 1_000_000_000;
    for t_s in now_s - 60..now_s {
        for (signal, value) in [("op", 50), ("pv", t_s % 20)] {
            let json = format!(r#"{{"t": {}, "v": {value}}}"#, t_s * 1_000_000_000);
            stage.deliver(&format!("p/{name}/{signal}"), json.as_bytes());
        }
        stage.turn();
        stage.work(usize::MAX, |_, request| Some(crate::answers::compute(request).assessment));
    }
    stage.record();
    assert!(stage.keep());
}

fn pass(stage: &mut SimDaemon, clock: &Clock, seconds: u64) {
    clock.advance(Duration::from_secs(seconds));
    stage.health();
    stage.record();
    assert!(stage.keep());
}

fn command(stage: &mut SimDaemon, name: &str, cmd: &str) -> Result<Vec<u8>, String> {
    let answer = Arc::new(Mutex::new(None));
    let (told, command) =
        (answer.clone(), Command { action: cmd.parse().unwrap(), by: Some("ann".into()), why: None, for_s: None });
    assert!(stage.command(name, command, Box::new(move |result| *told.lock().unwrap() = Some(result))));
    stage.turn();
    stage.record();
    assert!(stage.keep());
    answer.lock().unwrap().take().unwrap()
}

fn alarms(stage: &mut SimDaemon) -> Vec<(String, String)> {
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    let published = stage.published().filter(|p| p.kind == Kind::Alarm);
    let documents = published.map(|p| serde_json::from_slice::<Value>(&p.document.unwrap()).unwrap());
    documents.map(|d| (text(&d["loop"]), text(&d["event"]))).collect()
}

#[test]
fn where_places_are_few_a_loop_that_left_obeys_and_takes_none_from_those_that_are_there() {
    let (dir, clock) = (tempfile::tempdir().unwrap(), Clock::standing(super::START_NS));
    let text = text_of(dir.path(), "max_loops = 2\nforget_after_s = 600.0\n", "");
    let mut stage = start(&text, &clock);
    send(&mut stage, "A", &clock);
    command(&mut stage, "A", "out_of_service").unwrap();
    pass(&mut stage, &clock, 601);
    assert_eq!(stage.engine().count(), 0, "it left");
    // Two others take its place, one of which is put aside.
    for _ in 0..6 {
        pass(&mut stage, &clock, 60);
        send(&mut stage, "M", &clock);
        send(&mut stage, "Z", &clock);
    }
    command(&mut stage, "Z", "out_of_service").unwrap();
    stage.published().for_each(drop);
    command(&mut stage, "A", "suppress").unwrap();
    assert_eq!(alarms(&mut stage), [("A".to_owned(), "suppressed".to_owned())]);
    assert_eq!(stage.engine().count(), 2);
    for order in [false, true] {
        if order {
            stage.finish();
        }
        drop(stage);
        clock.advance(Duration::from_secs(5));
        stage = start(&text, &clock);
        let restored = alarms(&mut stage);
        assert!(restored.contains(&("A".to_owned(), "restored".to_owned())), "{restored:?}");
        assert_eq!((shown(&stage, "Z"), shown(&stage, "A")), (Some(State::OutOfService), None));
        for _ in 0..6 {
            pass(&mut stage, &clock, 60);
            send(&mut stage, "M", &clock);
            send(&mut stage, "Z", &clock);
        }
        assert_eq!((stage.metrics().samples.get(), stage.metrics().refused_loops.get()), (2 * 6 * 120, 0));
        assert!(command(&mut stage, "A", if order { "suppress" } else { "unsuppress" }).is_ok());
    }
    stage.finish();
    drop(stage);
    assert!(replays_to_the_byte(dir.path()) > 20);
}

#[test]
fn a_loop_that_was_removed_while_the_daemon_was_down_ends_its_alarm_at_the_next_start() {
    let (dir, clock) = (tempfile::tempdir().unwrap(), Clock::standing(super::START_NS));
    let entry = |name: &str| format!("[[loop]]\nname = {name:?}\n");
    for (discover, run) in [(false, 0), (true, 1)] {
        let dir = dir.path().join(format!("{run}"));
        let input = format!("discover = {discover}\n");
        let [both, one] = [format!("{}{}", entry("A"), entry("B")), entry("B")].map(|e| text_of(&dir, &input, &e));
        let mut stage = start(&both, &clock);
        for _ in 0..4 {
            pass(&mut stage, &clock, 60);
            send(&mut stage, "A", &clock);
        }
        command(&mut stage, "A", "suppress").unwrap();
        stage.finish();
        drop(stage);
        let mut stage = start(&one, &clock);
        assert_eq!(alarms(&mut stage), [("A".to_owned(), "removed".to_owned())]);
        assert_eq!(shown(&stage, "A"), None);
        stage.finish();
        drop(stage);
        let mut stage = start(&both, &clock);
        assert_eq!(alarms(&mut stage), []);
        assert_ne!(shown(&stage, "A"), Some(State::Suppressed));
        stage.finish();
        drop(stage);
        assert!(replays_to_the_byte(&dir) > 3);
    }
}

#[test]
fn silence_and_the_last_answer_go_on_over_a_start() {
    let (dir, clock) = (tempfile::tempdir().unwrap(), Clock::standing(super::START_NS));
    let text = text_of(dir.path(), "", "");
    let mut stage = start(&text, &clock);
    for at in 0..20 {
        pass(&mut stage, &clock, 60);
        send(&mut stage, "A", &clock);
        if at < 10 {
            send(&mut stage, "B", &clock);
        }
    }
    stage.health();
    let row = |stage: &SimDaemon, name: &str| stage.overview().row(name, clock.now_ns()).unwrap();
    let before = [row(&stage, "A"), row(&stage, "B")];
    assert!(!before[0].silent && before[1].silent && before[1].verdict.is_some());
    drop(stage);
    clock.advance(Duration::from_secs(5));
    let mut stage = start(&text, &clock);
    stage.health();
    for old in before {
        let new = row(&stage, &old.name);
        let of = |r: &stictiond::runtime::overview::Row| (r.silent, r.verdict, r.p_stiction, r.window_end_ms);
        assert_eq!(of(&new), of(&old), "{}", old.name);
        assert!(new.data_age_s > old.data_age_s);
    }
}

#[test]
fn the_windows_of_another_daemons_run_in_the_same_folder_are_left_alone_and_it_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let [own, other] = ["own", "other"].map(|name| folder.path().join(name));
    let clock = Clock::standing(super::START_NS);
    for (dir, starts) in [(&own, 1), (&other, 3)] {
        for _ in 0..starts {
            let mut stage = start(&text_of(dir, "", ""), &clock);
            pass(&mut stage, &clock, 60);
            send(&mut stage, "A", &clock);
            stage.finish();
        }
    }
    let file = chains_of(&other).unwrap().pop().unwrap().pop().unwrap();
    std::fs::copy(&file, own.join(file.file_name().unwrap())).unwrap();
    let stage = start(&text_of(&own, "", ""), &clock);
    let id = stage.engine().find("A").unwrap();
    let newest_ns = super::START_NS / 1_000_000_000 * 1_000_000_000 + 59_000_000_000;
    assert_eq!(stage.engine().figures(id).greatest_ns, Some(newest_ns));
    let name = file.file_name().unwrap().to_str().unwrap().to_owned();
    assert!(stage.faults().iter().any(|f| f.contains(&name)), "{:?}", stage.faults());
}

#[test]
fn a_loop_that_sends_later_than_the_first_file_of_a_run_goes_on_in_a_replay_too() {
    let (dir, clock) = (tempfile::tempdir().unwrap(), Clock::standing(super::START_NS));
    let of = |per_minute: u32| text_of(dir.path(), "", &format!("[commands]\nper_minute = {per_minute}\n"));
    let mut stage = start(&of(100), &clock);
    let edit = |stage: &mut SimDaemon, per_minute: u32| {
        assert!(stage.edit(Config::parse(&of(per_minute)).unwrap(), &of(per_minute)).is_some());
        stage.turn();
        stage.record();
    };
    for at in 0..12 {
        pass(&mut stage, &clock, 60);
        send(&mut stage, "A", &clock);
        if at % 4 == 3 {
            edit(&mut stage, 101 + at);
        }
    }
    stage.finish();
    drop(stage);
    let mut stage = start(&of(100), &clock);
    pass(&mut stage, &clock, 60);
    send(&mut stage, "B", &clock);
    edit(&mut stage, 200);
    for _ in 0..12 {
        send(&mut stage, "A", &clock);
        pass(&mut stage, &clock, 60);
    }
    stage.finish();
    drop(stage);
    assert!(replays_to_the_byte(dir.path()) > 4);
}

#[test]
fn a_removed_loop_with_windows_under_way_ends_as_it_was_whatever_is_read_again() {
    let (dir, clock) = (tempfile::tempdir().unwrap(), Clock::standing(super::START_NS));
    let named = "[[loop]]\nname = \"A\"\ncriticality = 5\narea = \"unit 7\"\n";
    let [both, one] = [named, ""].map(|entry| text_of(dir.path(), "", &format!("{entry}[[loop]]\nname = \"B\"\n")));
    let mut stage = start(&both, &clock);
    pass(&mut stage, &clock, 60);
    send(&mut stage, "A", &clock);
    command(&mut stage, "A", "suppress").unwrap();
    let now_s = clock.now_ns() / 1_000_000_000;
    for t_s in now_s..now_s + 300 {
        for (signal, value) in [("op", 50), ("pv", t_s % 20)] {
            let json = format!(r#"{{"t": {}, "v": {value}}}"#, t_s * 1_000_000_000);
            stage.deliver(&format!("p/A/{signal}"), json.as_bytes());
        }
    }
    stage.turn();
    stage.published().for_each(drop);
    for _ in 0..2 {
        assert!(stage.edit(Config::parse(&one).unwrap(), &one).is_some());
        stage.turn();
    }
    assert!(alarms(&mut stage).is_empty(), "its windows are under way");
    stage.work(usize::MAX, |_, request| Some(crate::answers::compute(request).assessment));
    let removed = stage.published().filter(|p| p.kind == Kind::Alarm).last().unwrap();
    let removed: Value = serde_json::from_slice(&removed.document.unwrap()).unwrap();
    assert_eq!((&removed["event"], &removed["criticality"]), (&Value::from("removed"), &Value::from(5)));
    stage.finish();
    drop(stage);
    assert!(replays_to_the_byte(dir.path()) > 4);
}

#[test]
fn a_window_that_is_empty_at_a_start_has_the_size_that_it_is_started_with() {
    let (dir, clock) = (tempfile::tempdir().unwrap(), Clock::standing(super::START_NS));
    let [large, small] =
        ["", "max_points = 128\n"].map(|size| text_of(dir.path(), "", &format!("[[loop]]\nname = \"A\"\n{size}")));
    let mut stage = start(&large, &clock);
    pass(&mut stage, &clock, 60);
    send(&mut stage, "A", &clock);
    send(&mut stage, "B", &clock);
    command(&mut stage, "A", "suppress").unwrap();
    assert!(stage.edit(Config::parse(&small).unwrap(), &small).is_some());
    stage.turn();
    stage.finish();
    drop(stage);
    let mut stage = start(&large, &clock);
    for _ in 0..6 {
        pass(&mut stage, &clock, 60);
        send(&mut stage, "A", &clock);
        send(&mut stage, "B", &clock);
    }
    stage.finish();
    drop(stage);
    assert!(replays_to_the_byte(dir.path()) > 4);
}
