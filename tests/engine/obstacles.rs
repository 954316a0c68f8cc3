//! Obstacles that keep loops from being judged: every fault put into the signals of a simulated plant is found, and nothing
//! else.

mod recorded;
mod summary;

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, Instant};

use stiction::core::record::{Mode, Sample, Signal, Value};
use stiction::core::units::s_from_ns;
use stiction::simulated::scenario::Scenario;
use stiction_engine::alarm::LoopContext;
use stiction_engine::config::Config;
use stiction_engine::engine::{Engine, Event, PlantWatch};
use stictiond::runtime::overview::{ObstacleKind, Overview};

const SCENARIO: &str = include_str!("../../recordings/scenarios/sticking.toml");
/// Plant time up to which every loop sends, and the end of the simulation, s: the window to 800 s is complete.
const ALL_SEND_S: f64 = 850.0;
const END_S: f64 = 900.0;

/// A fault in a loop's signals.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Fault {
    None,
    Of(ObstacleKind),
}

use Fault::Of;
use ObstacleKind::{AtLimit, Compressed, Frozen, Manual, Misplaced, Silent, Swapped, TooSlow, WrongSign};

const FAULTS: [ObstacleKind; 9] = [Silent, Frozen, Swapped, Misplaced, WrongSign, AtLimit, Manual, TooSlow, Compressed];
/// Loops with each fault, and as many that never send; the rest of a hundred are healthy.
const OF_EACH: usize = 3;
const LOOPS: usize = 100;
/// The samples of a simulated loop; no two loops have the same noise.
fn simulated(seed: usize, sticks: bool) -> Vec<Sample> {
    let mut text = SCENARIO.replace("seed = 1", &format!("seed = {seed}"));
    text = text.replace("duration_s = 2000.0", &format!("duration_s = {END_S:?}"));
    if !sticks {
        text = text
            .replace("fs = 5.0, fd = 3.0", "fs = 0.0, fd = 0.0")
            .replace("kc = 0.8, ti_s = 8.0", "kc = 0.2, ti_s = 20.0");
        // Without quantization the loop is calm enough to be judged without a fit.
        text = text
            .replace("op_resolution = 0.01", "op_resolution = 0.0001")
            .replace("pv_quantum = 0.01", "pv_quantum = 0.0001");
    }
    Scenario::parse(&text).unwrap().stream().map(|simulated| simulated.sample).collect()
}

/// Every loop that sends, by name, with its fault.
fn plant() -> Vec<(String, Fault)> {
    let faulty = FAULTS.into_iter().flat_map(|kind| (0..OF_EACH).map(move |k| (format!("{kind:?}-{k}"), Of(kind))));
    let healthy = LOOPS - (FAULTS.len() + 1) * OF_EACH;
    faulty.chain((0..healthy).map(|k| (format!("Healthy-{k}"), Fault::None))).collect()
}

/// The samples of a loop with a fault, and the seconds since the start at which each is sent.
fn with_fault(samples: &[Sample], fault: Fault) -> Vec<(f64, Sample)> {
    let start_ns = samples[0].t_ns;
    let mut held = 0.0;
    let change = |sample: &Sample| {
        let at_s = s_from_ns(sample.t_ns - start_ns);
        let mut sample = *sample;
        match (fault, sample.signal, &mut sample.value) {
            (Of(Silent), ..) if at_s > ALL_SEND_S => return None,
            (Of(TooSlow), ..) if at_s % 10.0 != 0.0 => return None,
            (Of(Frozen), Signal::Pv, Value::Number(pv)) => *pv = 60.0,
            (Of(Compressed), Signal::Pv, Value::Number(pv)) => {
                // Held for irregular times, as with compression by deviation: held over four rows each, PV would be sampled too
                // slowly.
                held = if (7.0 * at_s) % 11.0 < 4.0 { *pv } else { held };
                *pv = held;
            }
            (Of(AtLimit), Signal::Op, Value::Number(op)) => *op = op.min(50.0),
            (Of(Manual), Signal::Mode, mode) => *mode = Value::Mode(Mode::Manual),
            (Of(WrongSign), Signal::Op, Value::Number(op)) => *op = 100.0 - *op,
            (Of(Swapped), Signal::Op, _) => sample.signal = Signal::Pv,
            (Of(Swapped), Signal::Pv, _) => sample.signal = Signal::Op,
            _ => {}
        }
        Some((at_s, sample))
    };
    samples.iter().filter_map(change).collect()
}

/// The loop whose PV comes under this loop's name: two have exchanged theirs, one has that of a healthy loop.
fn pv_of(name: &str) -> Option<&'static str> {
    match name {
        "Misplaced-0" => Some("Misplaced-1"),
        "Misplaced-1" => Some("Misplaced-0"),
        "Misplaced-2" => Some("Healthy-0"),
        _ => None,
    }
}

/// A loop's samples with the PV of another loop.
fn with_pv_of(mut samples: Vec<Sample>, other: &[Sample]) -> Vec<Sample> {
    samples.retain(|sample| sample.signal != Signal::Pv);
    samples.extend(other.iter().filter(|sample| sample.signal == Signal::Pv));
    samples.sort_by_key(|sample| sample.t_ns);
    samples
}

/// Feeds a loop's samples over a range of seconds, and shows the engine's results.
fn feed(
    engine: &mut Engine,
    watch: &mut PlantWatch,
    overview: &Overview,
    name: &str,
    samples: &[(f64, Sample)],
    now: Instant,
) {
    let (id, place) = (engine.appear(name).unwrap(), LoopContext::default());
    let name: Arc<str> = name.into();
    let mut events = Vec::new();
    for (_, sample) in samples {
        engine.push(id, *sample, &mut events);
        while !events.is_empty() {
            for event in std::mem::take(&mut events) {
                match event {
                    Event::Request(request) => engine.complete(id, request.seq, request.compute(), &mut events),
                    Event::Window(_, window) => {
                        watch.keep(&name, *window);
                    }
                    Event::Estimate(_, document) => overview.estimate(&name, &place, now, Arc::from(document)),
                    _ => {}
                }
            }
        }
    }
    overview.figures(&name, &place, now, &engine.figures(id));
}

#[test]
fn every_fault_of_a_simulated_plant_is_found_and_nothing_else() {
    let never = (0..OF_EACH).map(|k| format!("[[loop]]\nname = \"Never-{k}\"\nop = \"gw/{k}\"\n")).collect::<String>();
    let acting = ["WrongSign-0", "WrongSign-1", "WrongSign-2", "Healthy-0", "Compressed-0"]
        .map(|name| format!("[[loop]]\nname = \"{name}\"\naction = \"reverse\"\n"))
        .concat();
    let text = format!("[site]\nprefix = \"p\"\n[window]\nhop_s = 800.0\nmin_samples_per_period = 45\n{never}{acting}");
    let config = Arc::new(Config::parse(&text).unwrap());
    let (mut engine, overview, now) = (Engine::new(config.engine()), Overview::default(), Instant::now());
    let later = now + Duration::from_secs(301);
    overview.expect(config, now, 5_000_000);
    let (plant, mut watch) = (plant(), PlantWatch::default());
    let seed_of = |name: &str| 1 + plant.iter().position(|(other, _)| other == name).unwrap();
    for (at, (name, fault)) in plant.iter().enumerate() {
        // Most loops of a plant are calm. These faults show only with a sticking valve, whose fits take time.
        let sticks = matches!(fault, Of(Swapped | Misplaced | WrongSign | AtLimit | TooSlow | Compressed))
            || name == "Healthy-0";
        let mut samples = simulated(at + 1, sticks);
        if let Some(other) = pv_of(name) {
            samples = with_pv_of(samples, &simulated(seed_of(other), true));
        }
        let samples = with_fault(&samples, *fault);
        let (first, rest) = samples.split_at(samples.partition_point(|(at_s, _)| *at_s <= ALL_SEND_S));
        feed(&mut engine, &mut watch, &overview, name, first, now);
        feed(&mut engine, &mut watch, &overview, name, rest, later);
    }
    overview.show_misplaced(watch.compare().misplaced());
    let found = overview.obstacles(later);
    let seen: BTreeSet<(&str, String)> =
        found.obstacles.iter().map(|o| (o.loop_name.as_str(), format!("{:?}", o.kind))).collect();
    let never: Vec<String> = (0..OF_EACH).map(|k| format!("Never-{k}")).collect();
    let put_in = plant.iter().filter_map(|(name, fault)| match fault {
        Of(kind) => Some((name.as_str(), format!("{kind:?}"))),
        Fault::None => None,
    });
    let wanted: BTreeSet<(&str, String)> =
        put_in.chain(never.iter().map(|name| (name.as_str(), "Silent".to_owned()))).collect();
    assert_eq!(seen, wanted);
    // Loops that never send count too, and compressed ones and those with a wrong sign are judged.
    let blocked = (FAULTS.len() + 1 - 2) * OF_EACH;
    // Reversals of the stem can suffice where there are too few samples in a period.
    let judged_all_the_same = found.obstacles.iter().filter(|o| o.kind == TooSlow && !o.blocks).count();
    assert_eq!((found.loops, found.judged), (LOOPS, LOOPS - blocked + judged_all_the_same));
    assert!(found.obstacles.iter().all(|o| o.since_ms.is_some() && !o.words.is_empty()), "{found:#?}");
    let mut rest = found.obstacles.iter().filter(|o| o.kind != TooSlow);
    assert!(rest.all(|o| o.blocks != matches!(o.kind, Compressed | WrongSign)));
    let remedy = |name: &str| &found.obstacles.iter().find(|o| o.loop_name == name).unwrap().remedy;
    let slow = remedy("TooSlow-0");
    assert!(slow.contains(" instead of every 10 s: 45 samples a period of "), "{slow}");
    assert!(remedy("Compressed-0").contains("deviations of OP and PV to 0"));
    let words = |name: &str| &found.obstacles.iter().find(|o| o.loop_name == name).unwrap().words;
    assert!(words("Misplaced-0").starts_with("OP answers the PV of Misplaced-1"), "{}", words("Misplaced-0"));
    assert!(words("Misplaced-2").starts_with("PV is that of Healthy-0"), "{}", words("Misplaced-2"));
    assert!(words("WrongSign-1").starts_with("OP rises with PV"), "{}", words("WrongSign-1"));
    assert!(remedy("Swapped-0").contains("exchange"));
    assert_eq!(remedy("Never-1"), "check that something publishes gw/1 and p/Never-1/pv");
}
