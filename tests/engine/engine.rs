//! The engine's contract: the same inputs in the same order give the same documents, whatever the workers did.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::BTreeMap;

use crate::answers::compute;
use proptest::prelude::*;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use stiction::core::record::{Mode, Sample, Signal, Value};
use stiction::core::verdict::{Verdict, assess};
use stiction::samples::align::align_all;
use stiction::simulated::scenario::Scenario;
use stiction_engine::config::Config;
use stiction_engine::engine::{Engine, Event, Request, SkipReason, section};

const AWKWARD: &str = include_str!("../../recordings/scenarios/awkward.toml");
const FOUR: &str = include_str!("../../recordings/scenarios/four-loops.toml");

fn config(hop_s: f64) -> Config {
    let mut config = Config::with_prefix("p");
    config.window.hop_s = hop_s;
    config.alarm.raise = [2, 3];
    config
}

/// Windows with few points: enough if only the order matters.
fn quick(hop_s: f64) -> Config {
    let mut config = config(hop_s);
    config.window.max_points = 400;
    config
}

/// When a request is answered.
#[derive(Clone, Copy)]
enum Answers {
    AtOnce,
    /// Late, shuffled and from threads, by this seed.
    Scattered(u64),
}

/// The seed whose answers are all computed by separate threads; other runs use cached ones.
const COMPUTED: u64 = 0;

/// Every document by loop, as JSON, in the order of the engine's output.
fn run(samples: &[(String, Sample)], config: Config, answers: Answers) -> BTreeMap<String, Vec<String>> {
    let mut engine = Engine::new(config.engine());
    let mut documents: BTreeMap<String, Vec<String>> = BTreeMap::new();
    let mut waiting: Vec<Request> = Vec::new();
    let mut events = Vec::new();
    let mut random = ChaCha8Rng::seed_from_u64(if let Answers::Scattered(seed) = answers { seed } else { 0 });
    let drain = |engine: &mut Engine,
                 events: &mut Vec<Event>,
                 waiting: &mut Vec<Request>,
                 documents: &mut BTreeMap<String, Vec<String>>| {
        while !events.is_empty() {
            for event in std::mem::take(events) {
                let (id, text) = match event {
                    Event::Request(r) if matches!(answers, Answers::AtOnce) => {
                        engine.complete(r.id, r.seq, compute(&r), events);
                        continue;
                    }
                    Event::Request(r) => {
                        waiting.push(*r);
                        continue;
                    }
                    Event::Estimate(id, d) => (id, serde_json::to_string(&d).unwrap()),
                    Event::Alarm(id, d) => (id, serde_json::to_string(&d).unwrap()),
                    Event::State(id, d) => (id, serde_json::to_string(&d).unwrap()),
                    Event::GapRequest(r) => {
                        engine.skip_gap(r.id, r.number, SkipReason::Failed, events);
                        continue;
                    }
                    Event::Window(..) => continue,
                    Event::Gap(_, d) => panic!("{d:?}"),
                };
                documents.entry(engine.name(id).to_string()).or_default().push(text);
            }
        }
    };
    for (name, sample) in samples {
        let id = engine.appear(name).unwrap();
        engine.push(id, *sample, &mut events);
        drain(&mut engine, &mut events, &mut waiting, &mut documents);
        if waiting.len() > 3 || (!waiting.is_empty() && random.next_u32() % 400 == 0) {
            let request = waiting.swap_remove(random.next_u32() as usize % waiting.len());
            let answer = if matches!(answers, Answers::Scattered(COMPUTED)) {
                std::thread::scope(|s| s.spawn(|| request.compute()).join().unwrap())
            } else {
                compute(&request)
            };
            engine.complete(request.id, request.seq, answer, &mut events);
            drain(&mut engine, &mut events, &mut waiting, &mut documents);
        }
    }
    while !waiting.is_empty() {
        let request = waiting.swap_remove(random.next_u32() as usize % waiting.len());
        engine.complete(request.id, request.seq, compute(&request), &mut events);
        drain(&mut engine, &mut events, &mut waiting, &mut documents);
    }
    documents
}

fn samples_of(scenario: &str) -> Vec<(String, Sample)> {
    let scenario = Scenario::parse(scenario).unwrap();
    let names: Vec<String> = scenario.loop_names().map(str::to_owned).collect();
    scenario.stream().map(|s| (names[s.loop_index].clone(), s.sample)).collect()
}

#[test]
fn answers_out_of_order_and_from_other_threads_change_nothing() {
    for (scenario, hop_s, seeds) in [(AWKWARD, 120.0, COMPUTED..3), (FOUR, 300.0, 1..3)] {
        let samples = samples_of(scenario);
        let at_once = run(&samples, quick(hop_s), Answers::AtOnce);
        assert!(at_once.values().map(Vec::len).sum::<usize>() > 20);
        for seed in seeds {
            assert_eq!(at_once, run(&samples, quick(hop_s), Answers::Scattered(seed)));
        }
    }
}

#[test]
fn loops_do_not_depend_on_each_other() {
    let samples = samples_of(FOUR);
    let together = run(&samples, quick(300.0), Answers::AtOnce);
    let mut one_after_the_other = samples.clone();
    one_after_the_other.sort_by(|a, b| a.0.cmp(&b.0));
    assert_eq!(together, run(&one_after_the_other, quick(300.0), Answers::AtOnce));
}

#[test]
fn a_live_window_and_the_same_section_of_the_recording_give_the_same_numbers() {
    let samples = samples_of(FOUR);
    let config = quick(300.0);
    let mut engine = Engine::new(config.engine());
    let mut compared = 0;
    let mut events = Vec::new();
    for (name, sample) in &samples {
        let id = engine.appear(name).unwrap();
        engine.push(id, *sample, &mut events);
        for event in std::mem::take(&mut events) {
            let Event::Request(request) = event else { continue };
            // Every other window is enough.
            if request.end_ns % 600_000_000_000 != 0 {
                continue;
            }
            let settings = config.loop_settings(name);
            let own: Vec<Sample> = samples.iter().filter(|(n, _)| n == name).map(|(_, s)| *s).collect();
            let (stretches, _) = align_all(&own, &settings.align);
            let live = compute(&request);
            let (start, end) = (live.record.start_ns, request.end_ns);
            let (record, _) = section(&stretches, start, end, Some(end), settings.window.max_points);
            let again = record.map(|r| assess(&r, &settings.assess));
            if live.assessment.s.is_some() {
                assert_eq!(Some(live.assessment), again);
                compared += 1;
            }
        }
    }
    assert!(compared >= 3, "{compared}");
}

#[test]
fn every_due_window_gets_a_document_and_hops_without_samples_none() {
    let mut samples = samples_of(FOUR);
    samples.retain(|(name, _)| name == "PIC203");
    let gap_ns = 10 * 365 * 86_400 * 1_000_000_000_i64;
    let last = samples.last().unwrap().1.t_ns;
    let later: Vec<_> = samples
        .iter()
        .map(|(n, s)| (n.clone(), Sample { t_ns: s.t_ns - samples[0].1.t_ns + last + gap_ns, ..*s }))
        .collect();
    samples.extend(later);
    let documents = run(&samples, config(300.0), Answers::AtOnce);
    let estimates = documents["PIC203"].iter().filter(|d| d.contains("estimate.v1")).count();
    assert!((12..=15).contains(&estimates), "{estimates}");
}

#[test]
fn the_sticking_loop_raises_an_alarm_and_the_others_do_not() {
    let documents = run(&samples_of(FOUR), quick(300.0), Answers::AtOnce);
    let alarmed = |name: &str| documents[name].iter().any(|d| d.contains("\"schema\":\"stictiond.alarm.v2\""));
    assert!(alarmed("FIC201"));
    assert!(!alarmed("PIC203") && !alarmed("TIC204"));
    assert!(documents["FIC201"].iter().any(|d| d.contains(&format!("\"verdict\":\"{}\"", Verdict::Stiction.name()))));
}

#[test]
fn a_skipped_window_says_so_and_holds_the_alarm() {
    let samples = samples_of(FOUR);
    let mut engine = Engine::new(config(300.0).engine());
    let mut events = Vec::new();
    let mut gates = Vec::new();
    for (name, sample) in samples.iter().filter(|(n, _)| n == "FIC201") {
        let id = engine.appear(name).unwrap();
        engine.push(id, *sample, &mut events);
        while !events.is_empty() {
            for event in std::mem::take(&mut events) {
                match event {
                    Event::Request(r) => engine.skip(r.id, r.seq, &mut events),
                    Event::Estimate(_, d) => gates.extend(d.assessment.gates.iter().map(|g| g.name())),
                    Event::Alarm(_, d) => panic!("{d:?}"),
                    Event::State(..) | Event::Window(..) => {}
                    Event::Gap(..) | Event::GapRequest(..) => panic!("{event:?}"),
                }
            }
        }
    }
    assert!(gates.len() >= 5 && gates.iter().all(|g| *g == "skipped"));
}

fn any_value() -> impl Strategy<Value = Value> {
    prop_oneof![
        4 => (-100.0..100.0_f64).prop_map(Value::number),
        1 => prop_oneof![Just(0.0), Just(1e308), Just(-1e308), Just(5e-324), Just(f64::NAN)].prop_map(Value::number),
        1 => Just(Value::Missing),
        1 => Just(Value::Mode(Mode::Manual)),
    ]
}

/// Mostly a sample a second, with every irregularity of clocks and gateways.
fn any_stamp() -> impl Strategy<Value = i64> {
    prop_oneof![
        20 => (0_i64..400).prop_map(|k| k * 1_000_000_000),
        2 => any::<i64>(),
        1 => prop_oneof![Just(i64::MIN), Just(i64::MAX), Just(0)],
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    #[test]
    fn no_stream_of_samples_makes_the_engine_panic(
        stream in proptest::collection::vec((any_stamp(), 0_usize..5, any_value(), proptest::option::of(any::<u32>())), 0..1500)
    ) {
        let mut config = config(50.0);
        config.window.max_points = 128;
        let samples: Vec<(String, Sample)> = stream
            .into_iter()
            .enumerate()
            .map(|(k, (stamp, signal, value, quality))| {
                // Half of the samples are in order, so that windows come due.
                let t_ns = if k % 2 == 0 { (k as i64 / 4) * 1_000_000_000 } else { stamp };
                let quality = quality.filter(|q| q % 3 == 0);
                ("L".to_owned(), Sample { signal: Signal::ALL[signal], t_ns, value, quality })
            })
            .collect();
        let first = run(&samples, config.clone(), Answers::AtOnce);
        for document in first.values().flatten() {
            prop_assert!(!document.contains("NaN") && !document.contains("inf"));
        }
        prop_assert_eq!(first, run(&samples, config, Answers::Scattered(7)));
    }
}
