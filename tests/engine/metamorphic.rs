//! Irrelevant changes have no effect: another sign or unit of PV, another date, rows that an export repeats and shuffles. The
//! verdict, the size of the sticking band (within 1 %) and the grade remain the same.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use stiction::core::record::{Record, Sample, Signal, Value};
use stiction::core::units::{ns_from_s, s_from_ns};
use stiction::core::verdict::{AssessParams, Assessment, Gate, assess};
use stiction::simulated::scenario::Scenario;
use stiction_engine::analysis::Points;
use stiction_engine::config::Config;
use stiction_files::load_samples;

/// Largest relative difference of s.
const NEAR: f64 = 0.01;
const DAY_S: f64 = 86_400.0;

/// A simulated loop from its valve, process and controller.
fn simulated(valve: &str, process: &str, controller: &str, seed: u64) -> Record {
    let text = format!(
        "[site]\nprefix = \"p\"\n[run]\nstart = \"2026-01-05T08:00:00Z\"\nduration_s = 700.0\nts_s = 1.0\nseed = {seed}\n\
         warmup_s = 900.0\n[[loop]]\nname = \"L\"\nlabel = \"stiction\"\noperating_point = {{ op = 50.0, pv = 60.0 }}\n\
         setpoint = 60.5\nprocess = {{ {process} }}\ncontroller = {{ {controller} }}\nvalve = {{ {valve} }}\n\
         noise = {{ pv_sd = 0.05 }}\n"
    );
    let scenario = Scenario::parse(&text).unwrap();
    Record { sp: None, mv: None, ..scenario.record(0).unwrap() }
}

fn loops() -> [Record; 6] {
    let he = |fs: f64, fd: f64| format!("law = \"he\", fs = {fs:?}, fd = {fd:?}");
    let process = |gain: f64, lag_s: f64, dead_s: f64| {
        format!("gain = {gain:?}, time_constants_s = [{lag_s:?}], dead_time_s = {dead_s:?}")
    };
    let pi = |kc: f64, ti_s: f64| format!("kc = {kc:?}, ti_s = {ti_s:?}");
    [
        simulated(&he(2.0, 1.0), &process(2.0, 10.0, 3.0), &pi(0.6, 8.0), 1),
        simulated(&he(4.0, 2.5), &process(1.5, 15.0, 4.0), &pi(0.7, 10.0), 2),
        simulated(&he(1.5, 1.2), &process(3.0, 8.0, 2.0), &pi(0.4, 7.0), 3),
        simulated(&he(3.0, 3.0), &process(2.0, 12.0, 5.0), &pi(0.5, 9.0), 4),
        simulated(&he(2.5, 0.5), &process(1.0, 6.0, 2.0), &pi(0.9, 6.0), 5),
        simulated(&he(5.0, 4.0), &process(2.5, 20.0, 3.0), &pi(0.5, 12.0), 6),
    ]
}

/// A record with PV in other units or with the opposite sign.
fn with_pv(record: &Record, change: impl Fn(f64) -> f64) -> Record {
    let all = |values: &[f64]| values.iter().map(|v| change(*v)).collect::<Vec<f64>>();
    Record { pv: all(&record.pv), sp: record.sp.as_deref().map(all), ..record.clone() }
}

fn a_day_later(record: &Record) -> Record {
    let day_ns = ns_from_s(DAY_S);
    Record { start_ns: record.start_ns + day_ns, end_ns: record.end_ns + day_ns, ..record.clone() }
}

fn judged(record: &Record) -> Assessment {
    assess(record, &AssessParams::default())
}

/// The differences between two answers.
fn differences(name: &str, base: &Assessment, other: &Assessment) -> Option<String> {
    let near = match (base.s, other.s) {
        (Some(a), Some(b)) => (a - b).abs() <= NEAR * a.abs(),
        (a, b) => a.is_none() == b.is_none(),
    };
    let same = near && base.verdict == other.verdict && base.grade == other.grade;
    let told = |a: &Assessment| format!("{:?}, s {:?}, grade {:?}", a.verdict, a.s, a.grade);
    (!same).then(|| format!("{name}: {} instead of {}", told(other), told(base)))
}

/// An export of the record with these rows, read and joined.
fn exported(record: &Record, rows: &[usize]) -> Record {
    let mut text = "Time,L.OP,L.PV\n".to_owned();
    for k in rows {
        let time = stiction::core::units::format_rfc3339(ns_from_s(1.7e9 + *k as f64));
        writeln!(text, "{time},{},{}", record.op()[*k], record.pv[*k]).unwrap();
    }
    let file = tempfile::Builder::new().suffix(".csv").tempfile().unwrap();
    fs::write(file.path(), text).unwrap();
    let loaded = load_samples(file.path()).unwrap();
    Points::of("L", &loaded.loops[0].samples, &Config::with_prefix("p")).judgeable().unwrap().0.record
}

/// Every row twice, in an arbitrary order.
fn doubled_and_shuffled(n: usize) -> Vec<usize> {
    // A prime that does not divide n visits every row.
    let step = if n.is_multiple_of(251) { 257 } else { 251 };
    (0..2 * n).map(|k| k * step % n).collect()
}

#[test]
fn simulated_loops_have_one_answer_whatever_the_sign_and_unit_of_pv_and_the_day() {
    let mut faults = Vec::new();
    let mut found = 0;
    for (k, record) in loops().iter().enumerate() {
        let base = judged(record);
        found += usize::from(base.stiction == Some(true));
        let mut hold = |name: &str, other: &Record| {
            faults.extend(differences(&format!("loop {k}, {name}"), &base, &judged(other)));
        };
        hold("-PV", &with_pv(record, |v| -v));
        hold("PV in other units", &with_pv(record, |v| 1.8 * v + 32.0));
        if k == 0 {
            hold("a day later", &a_day_later(record));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert!(found >= 4, "of six sticking valves {found} are found: nothing to compare");
}

/// A cycle of 61 s sampled every second is judged; sampled every 10 s it is too coarse, however many rows the export has.
#[test]
fn rows_that_repeat_a_value_are_no_samples() {
    let wave = |k: usize, phase: f64| 3.0 * (std::f64::consts::TAU * (k as f64 / 61.3 + phase)).sin();
    let op: Vec<f64> = (0..1200).map(|k| 50.0 + wave(k, 0.0)).collect();
    let pv = |rows: usize| (0..1200).map(|k| 20.0 + wave(k / rows * rows, 0.2)).collect::<Vec<f64>>();
    let found = judged(&Record::uniform(1.0, op, pv(10)));
    assert!(found.gates.contains(&Gate::RateTooLow), "{:?}", found.gates);
    let density = found.oscillation.samples_per_period.unwrap();
    assert!((density - 6.13).abs() < 0.2, "{density}");
    assert_eq!(Record::uniform(1.0, pv(1), pv(1)).held, 1);
}

/// As above in a record so long that it is judged in bins: the values are counted before they are averaged.
#[test]
fn rows_that_repeat_a_value_are_no_samples_in_bins_either() {
    let wave = |k: usize, phase: f64| 3.0 * (std::f64::consts::TAU * (k as f64 / 245.0 + phase)).sin();
    let judged_with = |held_rows: usize| {
        let sample = |k: usize, signal, v| Sample {
            signal,
            t_ns: k as i64 * 1_000_000_000,
            value: Value::number(v),
            quality: None,
        };
        let row = |k: usize| {
            let pv = 20.0 + wave(k / held_rows * held_rows, 0.2);
            [sample(k, Signal::Op, 50.0 + wave(k, 0.0)), sample(k, Signal::Pv, pv)]
        };
        let samples: Vec<Sample> = (0..16_000).flat_map(row).collect();
        let points = Points::of("L", &samples, &Config::with_prefix("p"));
        let record = points.judgeable().unwrap().0.record;
        assert!(record.box_samples > 1, "{}", record.box_samples);
        judged(&record)
    };
    for (held_rows, is_slow) in [(40, true), (5, false)] {
        let found = judged_with(held_rows);
        assert_eq!(found.gates.contains(&Gate::RateTooLow), is_slow, "{held_rows}: {:?}", found.gates);
        let density = found.oscillation.samples_per_period.unwrap();
        assert!((density * held_rows as f64 / 245.0 - 1.0).abs() < 0.05, "{held_rows}: {density}");
    }
}

#[test]
fn rows_that_come_twice_and_in_disorder_are_the_same_record() {
    for record in &loops()[..2] {
        let n = record.len();
        let rows: Vec<usize> = (0..n).collect();
        let plain = exported(record, &rows);
        assert_eq!((plain.len(), s_from_ns(plain.end_ns - plain.start_ns)), (n, (n - 1) as f64));
        assert!(exported(record, &doubled_and_shuffled(n)) == plain);
    }
}

#[test]
fn recorded_loops_have_one_answer_whatever_the_sign_of_pv_and_the_order_of_rows() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    let Ok(mut index) = csv::Reader::from_path(folder.join("INDEX.csv")) else {
        println!("\nSKIPPED: recorded_loops_have_one_answer…: no ../shared/data\n");
        return;
    };
    let names: Vec<String> = index.records().map(|row| row.unwrap()[0].to_owned()).collect();
    let read = |name: &String| {
        let loaded = load_samples(&folder.join(name)).ok()?;
        let points = Points::of("L", &loaded.loops.first()?.samples, &Config::with_prefix("p"));
        Some((name.clone(), points.judgeable().ok()?.0.record))
    };
    let records: Vec<(String, Record)> =
        names.iter().filter_map(read).filter(|(_, r)| r.box_samples == 1 && (300..1000).contains(&r.len())).collect();
    assert!(records.len() >= 10, "{} recordings", records.len());
    for (name, record) in records.iter().take(10) {
        let rows: Vec<usize> = (0..record.len()).collect();
        let same = exported(record, &doubled_and_shuffled(record.len())) == exported(record, &rows);
        assert!(same, "{name}: rows in disorder");
    }
    let every = records.len() / 5;
    let compare = |(name, record): &(String, Record)| {
        differences(&format!("{name}, -PV"), &judged(record), &judged(&with_pv(record, |v| -v)))
    };
    let faults: Vec<String> = records.iter().step_by(every).take(5).filter_map(compare).collect();
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}
