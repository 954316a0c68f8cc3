//! Three daemons and a router, each daemon in a network namespace of its own: one dies, is cut off, is stopped, all are
//! restarted in turn. The union of their documents has no window missing and none contradictory, and each of their
//! recordings replays to the byte. `cargo test --test several -- --nocapture` prints what was measured.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "../common/live.rs"]
mod live;
mod site;

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use site::Site;

const ALL: [&str; 3] = ["a", "b", "c"];
/// How long a takeover may take, s, and how long after it its first window comes at the latest: a hop, its lateness, a fit.
const WITHIN_S: f64 = 5.0 + 1.5;

/// One at a time: what is measured are seconds.
fn alone() -> MutexGuard<'static, ()> {
    static LOCK: Mutex<()> = Mutex::new(());
    LOCK.lock().unwrap_or_else(PoisonError::into_inner)
}

fn three(number: usize) -> Site {
    site::program_runs();
    let mut site = Site::start(number);
    ALL.iter().for_each(|id| site.add(id, None));
    site.wait_until_shared(&ALL);
    site
}

fn tell(test: &str, site: &Site, took_s: &[f64]) {
    let (windows, twice) = site.check_union();
    println!("{test}: first windows elsewhere after {took_s:.1?} s; {windows} windows, {twice} of them twice");
}

/// The owner of the first loop.
fn owner() -> &'static str {
    let live: stiction_monitor::ownership::Live = ALL.into_iter().collect();
    let owner = live.owner(&site::name_of(0)).unwrap().to_owned();
    ALL.into_iter().find(|id| *id == owner).unwrap()
}

fn others(id: &str) -> Vec<&'static str> {
    ALL.into_iter().filter(|other| *other != id).collect()
}

#[test]
fn a_daemon_that_is_killed_leaves_its_loops_and_their_alarms_to_the_others() {
    let _alone = alone();
    if !Site::permitted("several: kill -9") {
        return;
    }
    let mut site = three(11);
    let victim = owner();
    let answers = site.alarm("?cmd=out_of_service;by=anna;why=packing");
    assert_eq!(answers.len(), 1, "only the owner answers: {answers:?}");
    assert_eq!((answers[0]["state"].as_str(), answers[0]["daemon"].as_str()), (Some("out_of_service"), Some(victim)));
    let since = Instant::now();
    site.signal(victim, "KILL");
    let took_s = site.taken_over(victim, &ALL, since);
    let folder = site.remove(victim);
    assert!(took_s < WITHIN_S, "{took_s}");
    let answers = site.alarm("");
    assert_eq!(answers.len(), 1, "{answers:?}");
    assert_eq!((&answers[0]["state"], &answers[0]["out_of_service"]["by"]), (&"out_of_service".into(), &"anna".into()));
    assert!(others(victim).iter().any(|id| answers[0]["daemon"] == *id));
    // It comes back under the same folder, with an old memory of the loop, and takes it with the newer one.
    site.alarm("?cmd=in_service;by=ben");
    site.add(victim, Some(folder));
    site.wait_until_shared(&ALL);
    let state = || site.alarm("").first().map(|d| (d["state"].clone(), d["daemon"].clone()));
    assert!(state().is_none_or(|(state, _)| state == "normal"), "{:?}", state());
    tell("kill -9", &site, &[took_s]);
    site.end_and_verify();
}

#[test]
fn a_daemon_that_is_cut_off_is_replaced_and_comes_back() {
    let _alone = alone();
    if !Site::permitted("several: cable") {
        return;
    }
    let site = three(12);
    let victim = owner();
    let since = Instant::now();
    site.cable(victim, "down");
    let took_s = site.taken_over(victim, &ALL, since);
    assert!(took_s < WITHIN_S, "{took_s}");
    std::thread::sleep(Duration::from_secs(4));
    let healed = Instant::now();
    site.cable(victim, "up");
    site.wait_until_shared(&ALL);
    println!("cable: healed after {:.1} s", healed.elapsed().as_secs_f64());
    tell("cable", &site, &[took_s]);
    site.end_and_verify();
}

#[test]
fn a_daemon_that_stands_still_is_replaced_and_goes_on() {
    let _alone = alone();
    if !Site::permitted("several: SIGSTOP") {
        return;
    }
    let site = three(13);
    let victim = owner();
    let since = Instant::now();
    site.signal(victim, "STOP");
    let took_s = site.taken_over(victim, &ALL, since);
    assert!(took_s < WITHIN_S, "{took_s}");
    std::thread::sleep(Duration::from_secs(3));
    site.signal(victim, "CONT");
    site.wait_until_shared(&ALL);
    tell("SIGSTOP", &site, &[took_s]);
    site.end_and_verify();
}

#[test]
fn a_rolling_restart_misses_no_window() {
    let _alone = alone();
    if !Site::permitted("several: rolling restart") {
        return;
    }
    let mut site = three(14);
    let mut took_s = Vec::new();
    for id in ALL {
        let since = Instant::now();
        site.signal(id, "TERM");
        let folder = site.remove(id);
        took_s.push(site.taken_over(id, &ALL, since));
        site.add(id, Some(folder));
        site.wait_until_shared(&ALL);
    }
    assert!(took_s.iter().all(|took_s| *took_s < WITHIN_S), "{took_s:?}");
    tell("rolling restart", &site, &took_s);
    site.end_and_verify();
}
