//! A loop that changes hands: the next daemon goes on where the last one was, and says the same.

use stiction::record::{Sample, Signal, Value};
use stiction_monitor::alarm::Command;
use stiction_monitor::config::Config;
use stiction_monitor::engine::{Engine, EngineSettings, Event, Request};

const S: i64 = 1_000_000_000;

fn engine(daemon: &str) -> Engine {
    let mut config = Config::with_prefix("p");
    (config.window.hop_s, config.window.lateness_s) = (10.0, 0.5);
    Engine::new(EngineSettings { daemon: Some(daemon.into()), ..config.engine() })
}

/// Samples of a loop whose OP stands still, once a second; gives the windows that came due.
fn feed(engine: &mut Engine, seconds: std::ops::Range<i64>) -> Vec<Request> {
    let id = engine.appear("A").unwrap();
    let mut events = Vec::new();
    for k in seconds {
        for (signal, value) in [(Signal::Op, 50.0), (Signal::Pv, (k % 7) as f64)] {
            let sample = Sample { t_ns: k * S, signal, value: Value::Number(value), quality: None };
            engine.push(id, sample, &mut events);
        }
    }
    let due = |event| if let Event::Request(request) = event { Some(*request) } else { None };
    events.into_iter().filter_map(due).collect()
}

/// Answers windows; gives their ends, and who says so.
fn answer(engine: &mut Engine, requests: &[Request]) -> Vec<(i64, Option<String>, String)> {
    let mut events = Vec::new();
    requests.iter().for_each(|r| engine.complete(r.id, r.seq, r.compute(), &mut events));
    let said = |event| match event {
        Event::Estimate(_, mut d) => {
            let daemon = d.daemon.take();
            Some((d.assessment.window.end_ns / S, daemon, serde_json::to_string(&d).unwrap()))
        }
        _ => None,
    };
    events.into_iter().filter_map(said).collect()
}

#[test]
fn a_taken_loop_makes_the_windows_that_were_not_done_and_says_what_its_last_owner_would_have_said() {
    let (mut one, mut two) = (engine("one"), engine("two"));
    let due = feed(&mut one, 0..45);
    assert_eq!(due.iter().map(|r| r.end_ns / S).collect::<Vec<_>>(), [0, 10, 20, 30, 40]);
    assert_eq!(answer(&mut one, &due[..3]).len(), 3);
    let id = one.find("A").unwrap();
    let aside = Command { cmd: "out_of_service".into(), by: Some("anna".into()), why: None, for_s: None };
    one.command(id, &aside).unwrap();
    let memory = one.checkpoint(id);
    let taken = two.appear("A").unwrap();
    let alarm = two.take(taken, Some(memory.clone())).unwrap();
    assert_eq!((alarm.state.name(), alarm.daemon.as_deref()), ("out_of_service", Some("two")));
    // The past comes again, from its begin: windows that are done do not.
    let again = feed(&mut two, 0..45);
    assert_eq!(again.iter().map(|r| r.end_ns / S).collect::<Vec<_>>(), [30, 40]);
    let (theirs, ours) = (answer(&mut one, &due[3..]), answer(&mut two, &again));
    assert_eq!(theirs.len(), 2);
    for (a, b) in theirs.iter().zip(&ours) {
        assert_eq!((a.0, &a.2), (b.0, &b.2), "but for who says so, they are the same");
        assert_eq!((a.1.as_deref(), b.1.as_deref()), (Some("one"), Some("two")));
    }
}

#[test]
fn a_released_loop_says_nothing_more_and_may_come_back() {
    let mut one = engine("one");
    let due = feed(&mut one, 0..45);
    answer(&mut one, &due[..2]);
    let id = one.find("A").unwrap();
    let memory = one.release(id);
    assert!(one.is_away(id) && memory.stream.is_none());
    assert!(answer(&mut one, &due[2..]).is_empty(), "late answers find no place");
    assert_eq!(one.waiting(id).count(), 0);
    one.take(id, Some(memory));
    let again = feed(&mut one, 0..45);
    assert!(!one.is_away(id) && again[0].seq == due.len() as u64, "windows are counted on");
    assert_eq!(again.iter().map(|r| r.end_ns / S).collect::<Vec<_>>(), [20, 30, 40]);
    assert_eq!(answer(&mut one, &again).len(), 3);
}
