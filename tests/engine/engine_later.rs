//! Windows that are cut later than they come due, and loops that leave and return: the same inputs give the same documents.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::VecDeque;

use crate::answers::compute;
use proptest::prelude::*;
use stiction::core::record::{Sample, Signal, Value};
use stiction::core::verdict::Verdict;
use stiction::simulated::scenario::Scenario;
use stiction_engine::alarm::{AlarmAction, Command, State};
use stiction_engine::config::Config;
use stiction_engine::engine::{Engine, Event, LoopId};

const FOUR: &str = include_str!("../../recordings/scenarios/four-loops.toml");

fn config(max_points: usize) -> Config {
    let mut config = Config::with_prefix("p");
    (config.window.hop_s, config.window.max_points, config.alarm.raise) = (300.0, max_points, [1, 1]);
    config
}

fn samples_of(loop_name: &str) -> Vec<Sample> {
    let scenario = Scenario::parse(FOUR).unwrap();
    let names: Vec<String> = scenario.loop_names().map(str::to_owned).collect();
    scenario.stream().filter(|s| names[s.loop_index] == loop_name).map(|s| s.sample).collect()
}

/// Documents of the windows in order, each cut and fitted `delay` samples after it was due, every seventh skipped.
fn said(samples: &[Sample], config: &Config, delay: usize) -> Vec<String> {
    let mut engine = Engine::new(config.engine());
    let id = engine.appear("FIC201").unwrap();
    let (mut events, mut out, mut row) = (Vec::new(), Vec::new(), VecDeque::new());
    for (at, sample) in samples.iter().enumerate() {
        engine.push(id, *sample, &mut events);
        loop {
            for event in std::mem::take(&mut events) {
                match event {
                    Event::Request(r) => row.push_back((at, r)),
                    Event::Estimate(_, d) => out.push(serde_json::to_string(&d).unwrap()),
                    Event::Alarm(_, d) => out.push(serde_json::to_string(&d).unwrap()),
                    Event::State(_, d) => out.push(serde_json::to_string(&d).unwrap()),
                    Event::GapRequest(_) | Event::Gap(..) | Event::Window(..) => {}
                }
            }
            if row.front().is_none_or(|(due, _)| at < due + delay) {
                break;
            }
            let Some((_, request)) = row.pop_front() else { break };
            if request.seq % 7 == 3 {
                engine.skip(id, request.seq, &mut events);
            } else {
                engine.complete(id, request.seq, compute(&request), &mut events);
            }
        }
    }
    out
}

#[test]
fn a_window_that_is_cut_later_says_the_same() {
    let samples = samples_of("FIC201");
    for max_points in [128, 500] {
        let config = config(max_points);
        let at_once = said(&samples, &config, 0);
        assert!(at_once.len() >= 8, "{}", at_once.len());
        // With longer delays the last windows are never cut.
        for delay in [1, 40, 400] {
            let later = said(&samples, &config, delay);
            assert!(later.len() >= 4 && later[..] == at_once[..later.len()], "{max_points} {delay}");
        }
    }
}

#[test]
fn a_window_that_is_looked_at_later_is_the_one_that_was_judged() {
    let mut engine = Engine::new(config(2000).engine());
    let id = engine.appear("FIC201").unwrap();
    let (mut events, mut judged, mut looked_at) = (Vec::new(), VecDeque::new(), 0);
    for (at, sample) in samples_of("FIC201").iter().enumerate() {
        engine.push(id, *sample, &mut events);
        for event in events.drain(..) {
            if let Event::Request(r) = event {
                judged.push_back((at, r.record()));
            }
        }
        // Half a hop of both signals later.
        while judged.front().is_some_and(|(due, _)| at >= due + 300) {
            let (_, record) = judged.pop_front().unwrap();
            let look = |end_ns| engine.snapshot(id, end_ns).and_then(|s| s.record(&engine.settings(id).window));
            assert_eq!(look(Some(record.end_ns)).as_ref(), Some(&record));
            assert!(look(None).unwrap().raw_samples >= record.raw_samples);
            looked_at += 1;
        }
    }
    assert!(looked_at >= 4, "{looked_at}");
}

fn beat(k: usize) -> [Sample; 2] {
    let t_ns = k as i64 * 1_000_000_000;
    let of = |signal, v| Sample { signal, t_ns, value: Value::Number(v), quality: None };
    [of(Signal::Op, (k % 10) as f64), of(Signal::Pv, (k % 7) as f64)]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    #[test]
    fn breaks_while_windows_wait_change_no_window(gaps in proptest::collection::vec((1_usize..900, 1_usize..500), 1..6), delay in 0_usize..900) {
        let mut config = config(64);
        config.window.hop_s = 100.0;
        let (mut k, mut samples) = (0, Vec::new());
        for (length, gap) in gaps {
            (k..k + length).for_each(|k| samples.extend(beat(k)));
            k += length + gap;
        }
        let (at_once, later) = (said(&samples, &config, 0), said(&samples, &config, delay));
        prop_assert_eq!(&later[..], &at_once[..later.len()]);
    }
}

/// Pushes a loop's samples and answers due windows; returns the resulting state of the alarm.
fn run(engine: &mut Engine, id: LoopId, samples: &[Sample]) -> State {
    let mut events = Vec::new();
    for sample in samples {
        engine.push(id, *sample, &mut events);
        while !events.is_empty() {
            for event in std::mem::take(&mut events) {
                match event {
                    Event::Request(r) => engine.complete(r.id, r.seq, r.compute(), &mut events),
                    Event::GapRequest(r) => {
                        engine.skip_gap(r.id, r.number, stiction_engine::engine::SkipReason::Failed, &mut events);
                    }
                    Event::Estimate(_, d) => assert_ne!(d.assessment.verdict, Verdict::Disturbance),
                    _ => {}
                }
            }
        }
    }
    engine.checkpoint(id).alarm.shown()
}

#[test]
fn a_loop_that_left_comes_back_with_its_alarm_alone() {
    let samples = samples_of("FIC201");
    let mut engine = Engine::new(config(2000).engine());
    let id = engine.appear("FIC201").unwrap();
    assert_eq!(run(&mut engine, id, &samples), State::Unack);
    let held = engine.bytes(id);
    assert!(engine.forget(id) && !engine.forget(id));
    assert_eq!((engine.count(), engine.find("FIC201"), engine.left().count()), (0, None, 1));
    // A stale handle finds an empty loop, and has no effect.
    engine.push(id, samples[0], &mut Vec::new());
    assert_eq!((&**engine.name(id), engine.figures(id).windows), ("", 0));
    let again = engine.appear("FIC201").unwrap();
    assert_eq!(again, id, "its handle is used again");
    assert_eq!((engine.checkpoint(again).alarm.shown(), engine.figures(again).windows), (State::Unack, 0));
    assert!(engine.bytes(again) * 3 < held, "{} of {held}", engine.bytes(again));
    let command = Command { action: AlarmAction::Ack, by: Some("ann".into()), why: None, for_s: None };
    assert_eq!(engine.command(again, &command).unwrap().state, State::Acked);
    assert_eq!(engine.left().count(), 0);
}

#[test]
fn a_loop_leaves_only_when_nothing_waits_and_frees_its_place() {
    let text = "[site]\nprefix = \"p\"\n[input]\nmax_loops = 2\n[window]\nhop_s = 50.0\n[[loop]]\nname = \"A\"\ncriticality = 5\n";
    let mut engine = Engine::new(Config::parse(text).unwrap().engine());
    let (a, b) = (engine.appear("A").unwrap(), engine.appear("B").unwrap());
    assert!(engine.appear("C").is_none() && !engine.has_room());
    let (mut events, mut due) = (Vec::new(), Vec::new());
    (0..120).flat_map(beat).for_each(|sample| engine.push(a, sample, &mut events));
    due.extend(events.drain(..).filter_map(|e| if let Event::Request(r) = e { Some(r.seq) } else { None }));
    assert!(!due.is_empty() && !engine.forget(a));
    due.into_iter().for_each(|seq| engine.skip(a, seq, &mut events));
    assert!(engine.forget(a) && engine.forget(b));
    // A configured loop keeps its place and its settings.
    assert!(engine.appear("C").is_some() && engine.appear("D").is_none());
    let a = engine.appear("A").unwrap();
    assert_eq!((engine.settings(a).place.criticality, engine.count()), (Some(5), 2));
}

/// Ends of the windows that come due while these samples are taken in order, each answered at once.
fn ends_of(samples: &[Sample], config: &Config) -> Vec<i64> {
    let mut engine = Engine::new(config.engine());
    let id = engine.appear("FIC101").unwrap();
    let (mut events, mut ends) = (Vec::new(), Vec::new());
    for sample in samples {
        engine.push(id, *sample, &mut events);
        for event in std::mem::take(&mut events) {
            if let Event::Request(request) = event {
                ends.push(request.end_ns);
                engine.skip(id, request.seq, &mut Vec::new());
            }
        }
    }
    ends
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    /// A gateway's set point comes later than allowed, its stamps between those of the others: no window comes due twice.
    #[test]
    fn no_window_comes_due_twice_whatever_comes_late(
        every_s in 2_i64..12,
        offset_s in 0_i64..12,
        late_s in 0_i64..40,
        hole in proptest::option::of((10_i64..60, 5_i64..90)),
    ) {
        const S: i64 = 1_000_000_000;
        let of = |signal, t_s: i64| Sample { signal, t_ns: t_s * S, value: Value::Number((t_s % 7) as f64), quality: None };
        let mut sent: Vec<(i64, Sample)> = Vec::new();
        for k in 0..150 {
            let t_s = 1_000_000 + every_s * k + offset_s;
            if hole.is_some_and(|(from, scans)| (from..from + scans).contains(&k)) {
                continue;
            }
            sent.extend([(t_s, of(Signal::Op, t_s)), (t_s, of(Signal::Pv, t_s))]);
            sent.extend((0..every_s).map(|s| (t_s + s + late_s, of(Signal::Sp, t_s + s))));
        }
        sent.sort_by_key(|(at_s, _)| *at_s);
        let samples: Vec<Sample> = sent.into_iter().map(|(_, sample)| sample).collect();
        let mut config = config(128);
        config.window.hop_s = 60.0;
        let ends = ends_of(&samples, &config);
        prop_assert!(ends.len() > 2 && ends.is_sorted_by(|a, b| a < b), "{:?}", ends);
    }
}
