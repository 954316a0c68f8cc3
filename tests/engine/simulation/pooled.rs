//! Diagnoses that are decided together with earlier ones of their loop: requested, recorded, and replayed byte for byte.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use serde_json::Value;
use stiction::core::gap::Serial;
use stiction::core::record::Record;
use stiction_engine::config::Config;
use stiction_engine::engine::{GapRequest, PublishedGap};
use stiction_files::disk::{Disk, SystemDisk};
use stiction_lab::challenge::windows::in_windows;
use stictiond::daemon::gaps::Outcome;
use stictiond::daemon::sim_daemon::{SimDaemon, no_receiver};
use stictiond::runtime::clock::Clock;

use super::neighbours::play;
use super::refill::replays_to_the_byte;

const NAME: &str = "FIC101";
const DAY: Duration = Duration::from_secs(86_400);

/// Requests a diagnosis and runs it; returns the document, or the reason for refusal.
fn ask(stage: &mut SimDaemon, pool: bool) -> Result<Value, String> {
    ask_and_change(stage, pool, |_| ())
}

fn ask_and_change(
    stage: &mut SimDaemon,
    pool: bool,
    mut change: impl FnMut(&mut PublishedGap),
) -> Result<Value, String> {
    let answered = Arc::new(Mutex::new(None));
    let told = answered.clone();
    assert!(stage.ask_gap(NAME, "ann", pool, Box::new(move |answer| *told.lock().unwrap() = Some(answer))));
    stage.turn();
    stage.diagnose(|request: &GapRequest| {
        let mut made = request.compute(&Serial).unwrap();
        change(&mut made);
        Outcome::Done(Box::new(made), None)
    });
    let answer = answered.lock().unwrap().take().unwrap();
    answer.map(|json| serde_json::from_slice(&json).unwrap())
}

#[test]
fn a_diagnosis_is_decided_with_earlier_ones_where_a_person_wants_it_and_replays_to_the_byte() {
    let dir = tempfile::tempdir().unwrap();
    let text = format!(
        "[site]\nprefix = \"p\"\n[window]\nhop_s = 86400.0\n[gap]\nbudget_evaluations = 3000\n[recording]\ndir = {:?}\n",
        dir.path().to_str().unwrap()
    );
    let clock = Clock::standing(super::START_NS);
    let (config, disk) = (Config::parse(&text).unwrap(), Arc::new(SystemDisk) as Arc<dyn Disk>);
    let mut stage = SimDaemon::start(config, &text, &clock, &disk, no_receiver).unwrap();
    let windows = in_windows(48, None, 0).windows;
    let mut days = windows.iter().zip(0..).map(|(window, day)| {
        let start_ns = day * DAY.as_nanos() as i64;
        Record { start_ns, ..window.clone() }
    });
    let mut next_day = |stage: &mut SimDaemon| {
        play(stage, &[(NAME, &days.next().unwrap())]);
        clock.advance(DAY);
    };

    next_day(&mut stage);
    assert!(ask(&mut stage, true).unwrap_err().contains("ask without pool"));
    // A number that no recording can restore, so that window is not remembered.
    ask_and_change(&mut stage, false, |made| {
        made.own.as_mut().unwrap().evidence.basis.skew = Some(f64::INFINITY);
    })
    .unwrap();
    next_day(&mut stage);
    assert!(ask(&mut stage, true).unwrap_err().contains("ask without pool"));
    let first = ask(&mut stage, false).unwrap();
    assert!(first["pooled"].is_null(), "{first}");
    // The same samples do not count twice.
    clock.advance(DAY);
    assert!(ask(&mut stage, true).unwrap_err().contains("ask without pool"));
    next_day(&mut stage);
    let second = ask(&mut stage, true).unwrap();
    next_day(&mut stage);
    let third = ask(&mut stage, true).unwrap();
    let seen = |document: &Value| -> Vec<(Value, Value, Value)> {
        let windows = document["pooled"].as_array().unwrap().iter();
        windows.map(|w| (w["end_ns"].clone(), w["cause"].clone(), w["shown"].clone())).collect()
    };
    let (second_windows, third_windows) = (seen(&second), seen(&third));
    let of_first = (first["window"]["end_ns"].clone(), first["cause"]["id"].clone(), false.into());
    assert_eq!((second_windows.len(), &second_windows[0], &third_windows[0]), (2, &of_first, &of_first));
    assert_eq!((&second_windows[1].0, &second_windows[1].2), (&second["window"]["end_ns"], &true.into()));
    // A window's own result is remembered, not the joint decision.
    assert_eq!((third_windows.len(), &third_windows[1].1), (3, &second_windows[1].1));
    stage.finish();
    drop(stage);
    assert!(replays_to_the_byte(dir.path()) >= 4);
}
