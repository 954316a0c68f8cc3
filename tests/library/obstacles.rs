//! What keeps loops from being judged: every fault that is put into the signals of a simulated plant is found, and nothing else.

use std::sync::Arc;
use std::time::{Duration, Instant};

use stiction::record::{Mode, Sample, Signal, Value};
use stiction::sim::scenario::Scenario;
use stiction::units::s_from_ns;
use stiction_monitor::alarm::LoopContext;
use stiction_monitor::config::Config;
use stiction_monitor::engine::{Engine, Event};
use stiction_runtime::overview::{ObstacleKind, Overview};

const SCENARIO: &str = include_str!("../../recordings/scenarios/sticking.toml");
/// Time of the plant up to which every loop sends, s: the window to 1500 s is complete.
const ALL_SEND_S: f64 = 1700.0;

/// A fault in a loop's signals.
#[derive(Clone, Copy, PartialEq)]
enum Fault {
    None,
    Of(ObstacleKind),
}

use Fault::Of;
use ObstacleKind::{AtLimit, Compressed, Frozen, Manual, Silent, Swapped, TooSlow};

const LOOPS: [(&str, Fault); 8] = [
    ("HEALTHY", Fault::None),
    ("SILENT", Of(Silent)),
    ("FROZEN", Of(Frozen)),
    ("SWAPPED", Of(Swapped)),
    ("LIMIT", Of(AtLimit)),
    ("MANUAL", Of(Manual)),
    ("SLOW", Of(TooSlow)),
    ("COMPRESSED", Of(Compressed)),
];

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
                held = if at_s % 4.0 == 0.0 { *pv } else { held };
                *pv = held;
            }
            (Of(AtLimit), Signal::Op, Value::Number(op)) => *op = op.min(50.0),
            (Of(Manual), Signal::Mode, mode) => *mode = Value::Mode(Mode::Manual),
            (Of(Swapped), Signal::Op, _) => sample.signal = Signal::Pv,
            (Of(Swapped), Signal::Pv, _) => sample.signal = Signal::Op,
            _ => {}
        }
        Some((at_s, sample))
    };
    samples.iter().filter_map(change).collect()
}

/// Feeds a loop's samples of a stretch of time, in seconds, and shows what the engine makes of them.
fn feed(engine: &mut Engine, overview: &Overview, name: &str, samples: &[(f64, Sample)], now: Instant) {
    let (id, place) = (engine.appear(name).unwrap(), LoopContext::default());
    let name: Arc<str> = name.into();
    let mut events = Vec::new();
    for (_, sample) in samples {
        engine.push(id, *sample, &mut events);
        while !events.is_empty() {
            for event in std::mem::take(&mut events) {
                match event {
                    Event::Request(request) => engine.complete(id, request.seq, request.compute(), &mut events),
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
    let samples: Vec<Sample> = Scenario::parse(SCENARIO).unwrap().stream().map(|simulated| simulated.sample).collect();
    let config = Config::parse("[site]\nprefix = \"p\"\n[window]\nhop_s = 1500.0\n").unwrap();
    let (mut engine, overview, now) = (Engine::new(config.engine()), Overview::default(), Instant::now());
    let loops = LOOPS.map(|(name, fault)| (name, with_fault(&samples, fault)));
    let later = now + Duration::from_secs(300);
    for (name, samples) in &loops {
        let (first, rest) = samples.split_at(samples.partition_point(|(at_s, _)| *at_s <= ALL_SEND_S));
        feed(&mut engine, &overview, name, first, now);
        feed(&mut engine, &overview, name, rest, later);
    }
    let found = overview.obstacles();
    let seen: Vec<(&str, Fault)> = found.obstacles.iter().map(|o| (o.loop_name.as_str(), Of(o.kind))).collect();
    assert!(seen == LOOPS[1..], "{found:#?}");
    let unblocked: Vec<&str> = found.obstacles.iter().filter(|o| !o.blocks).map(|o| o.loop_name.as_str()).collect();
    assert_eq!(unblocked, ["COMPRESSED"]);
    assert_eq!((found.loops, found.judged, found.share), (8, 2, Some(0.25)));
    assert!(found.obstacles.iter().all(|o| o.since_ms.is_some() && !o.words.is_empty()), "{found:#?}");
    let remedy = |name: &str| &found.obstacles.iter().find(|o| o.loop_name == name).unwrap().remedy;
    assert!(remedy("SLOW").starts_with("record every 1.99 s instead of every 10 s"), "{}", remedy("SLOW"));
    assert!(remedy("COMPRESSED").contains("deviations of OP and PV to 0"));
    assert!(remedy("SWAPPED").contains("exchange"));
}
