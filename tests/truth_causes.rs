//! Valve, tuning or disturbance: loops whose cause is known get its name.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::BTreeMap;

use stictiond::sim::scenario::Scenario;
use stictiond::verdict::{AssessParams, assess};

/// Verdicts over seeds for one loop of a plant.
fn verdicts(text: &str, seeds: u64) -> BTreeMap<&'static str, usize> {
    let mut counts = BTreeMap::new();
    for seed in 1..=seeds {
        let scenario = Scenario::parse(&text.replace("SEED", &seed.to_string())).unwrap();
        let record = scenario.record(0).unwrap();
        let verdict = assess(&record, &AssessParams { always_fit: true, ..AssessParams::default() }).verdict;
        *counts.entry(verdict.name()).or_default() += 1;
    }
    counts
}

fn plant(kc: f64, load: &str, valve: &str) -> String {
    format!(
        "[site]\nprefix = \"p\"\n[run]\nstart = \"2026-01-05T08:00:00Z\"\nduration_s = 1600.0\nts_s = 1.0\nseed = SEED\nwarmup_s = 1800.0\n\
         [[loop]]\nname = \"L\"\noperating_point = {{ op = 55.0, pv = 12.0 }}\nsetpoint = 12.0\n\
         process = {{ gain = 1.2, time_constants_s = [30.0, 10.0], dead_time_s = 12.0 }}\n\
         controller = {{ kc = {kc}, ti_s = 40.0 }}\nnoise = {{ pv_sd = 0.05 }}\n{valve}\ndisturbance = {{ load = [{load}] }}\n"
    )
}

const RANDOM: &str = "{ ar1 = { sd = 0.6, time_constant_s = 30.0 } }";

#[test]
fn a_loop_near_its_limit_is_tuning() {
    for kc in [2.0, 2.2] {
        let counts = verdicts(&plant(kc, RANDOM, ""), 8);
        println!("kc {kc}: {counts:?}");
        assert!(counts.get("tuning").copied().unwrap_or(0) >= 5, "kc {kc}: {counts:?}");
        assert!(!counts.contains_key("stiction") && !counts.contains_key("deadband"), "kc {kc}: {counts:?}");
    }
}

#[test]
fn a_load_that_oscillates_is_a_disturbance() {
    for load in [
        "{ sine = { amplitude = 3.0, period_s = 90.0 } }, { ar1 = { sd = 0.3, time_constant_s = 30.0 } }",
        "{ square = { amplitude = 2.0, period_s = 140.0 } }, { ar1 = { sd = 0.3, time_constant_s = 30.0 } }",
    ] {
        let counts = verdicts(&plant(0.9, load, ""), 8);
        println!("{load}: {counts:?}");
        assert!(counts.get("disturbance").copied().unwrap_or(0) >= 6, "{load}: {counts:?}");
    }
}

#[test]
fn a_sticking_valve_is_stiction() {
    let text = "[site]\nprefix = \"p\"\n[run]\nstart = \"2026-01-05T08:00:00Z\"\nduration_s = 1600.0\nts_s = 1.0\nseed = SEED\n\
                warmup_s = 1800.0\n[[loop]]\nname = \"L\"\noperating_point = { op = 50.0, pv = 60.0 }\nsetpoint = 61.0\n\
                process = { gain = 2.0, time_constants_s = [20.0], dead_time_s = 6.0 }\n\
                controller = { kc = 1.2, ti_s = 10.0 }\nvalve = { law = \"he\", fs = 5.0, fd = 2.0 }\n\
                noise = { pv_sd = 0.05 }\ndisturbance = { load = [{ ar1 = { sd = 0.1, time_constant_s = 60.0 } }] }\n";
    let counts = verdicts(text, 6);
    println!("{counts:?}");
    assert!(counts.get("stiction").copied().unwrap_or(0) >= 5, "{counts:?}");
}
