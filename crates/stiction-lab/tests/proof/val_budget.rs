//! The budget on real recordings: effects added to loops that are simulated in closed loop around the recording, and the result
//! for every recording. Three benchmarks print their tables:
//!
//! `cargo test -p stiction-lab --test proof val_budget -- --ignored --nocapture`
//!
//! `ODD=1` uses only the odd positions of the index, on which nothing was chosen, `ODD=0` the even ones. The cap on printed
//! least sizes was tuned on both.

use std::collections::BTreeSet;

use crate::labelled::{self, RECORDINGS, cells};
use crate::val_effects::budget;

use stiction::core::detect::oscillation;
use stiction::core::gap::budget::document::{
    CANNOT_BE_TOLD, DISTURBANCE, NOISE, NOT_SPLIT, UNEXPLAINED, VALVE_AND_PROCESS,
};
use stiction::core::gap::budget::{Budget, Known};
use stiction::core::gap::document::GapDocument;
use stiction::core::gap::{Diagnosis, GapOptions, Serial, UNKNOWN, diagnose};
use stiction::core::ident::controller;
use stiction::core::record::Record;
use stiction_lab::hybrid::{EFFECTS, Loop};

/// Samples used of each recording.
const SAMPLES: usize = 1_800;
/// Models tried for a recording's complete answer.
const MANY: u64 = 200_000;
/// Ways and sizes of adding an effect: to PV alone, or in closed loop.
const WAYS: [(&str, f64); 4] = [("PV", 0.5), ("PV", 1.0), ("loop", 0.5), ("loop", 1.0)];
/// Null records resampled from each recording, and effects of the printed least size added to each.
const NULLS: u64 = 2;
const CHECKS: usize = 2;

/// Every recording with a regular cycle; data listed twice in the index appear once.
fn with_a_cycle(test: &str) -> Option<Vec<(String, Record)>> {
    let all = labelled::labelled_or_skip(test)?;
    let index = std::fs::read_to_string(format!("{RECORDINGS}/INDEX.csv")).ok()?;
    let rows: Vec<Vec<String>> = index.lines().map(cells).collect();
    let place = |name: &str| rows[0].iter().position(|h| h == name).unwrap();
    let (file, group) = (place("file"), place("same_data_group"));
    let mut seen = BTreeSet::new();
    let mut fresh = |name: &str| {
        let row = rows.iter().find(|row| row[file] == name);
        let group = row.map_or("", |row| row[group].as_str());
        let folder = name.split('/').next().unwrap_or_default();
        seen.insert(if group.is_empty() { name.to_owned() } else { format!("{folder}/{group}") })
    };
    let cut = |record: Record| if record.box_samples == 1 { record.part(0, SAMPLES) } else { record };
    let all = all.into_iter().filter(|item| fresh(&item.file)).map(|item| (item.file, cut(item.record)));
    Some(all.filter(|(_, record)| period(record).is_some()).collect())
}

/// Period of a regular cycle, points.
fn period(record: &Record) -> Option<f64> {
    let found = oscillation::detect(&record.op(), &record.pv).filter(|o| o.oscillating);
    found.map(|o| o.period_points)
}

fn diagnosed(record: &Record, evaluations: u64) -> Option<(Diagnosis, GapOptions)> {
    let options =
        GapOptions { period_points: period(record), budget_evaluations: evaluations, ..GapOptions::default() };
    diagnose(record, &options, &Serial).ok().map(|made| (made, options))
}

/// Effects that a budget names, and whether they are confirmed.
type Names = Vec<(String, bool)>;

fn names(record: &Record) -> Names {
    let Some((budget, cause)) = budget(record) else { return Names::new() };
    let all = budget.searched.added.iter().zip(&budget.confirmed);
    all.map(|(added, sure)| (added.shape.id().to_owned(), *sure)).chain(cause).collect()
}

/// Results for one recording.
struct Found {
    even: bool,
    read: bool,
    unstable: usize,
    before: Names,
    /// Effect and way by their indices, with the effects that were named.
    made: Vec<(usize, usize, Names)>,
    nulls: Vec<Names>,
}

/// The budget that closes a recording's loop.
fn closing(record: &Record) -> Option<Budget> {
    Budget::of(record, Known { period: period(record), ..Known::default() })
}

fn put_into(record: &Record, place: usize) -> Option<Found> {
    let seed = 100 + place as u64;
    let closing = closing(record)?;
    let own = Loop { record, budget: &closing };
    let reading = controller::read(record);
    let mut out = Found {
        even: place.is_multiple_of(2),
        read: reading.is_some(),
        unstable: 0,
        before: names(record),
        made: Vec::new(),
        nulls: (1..=NULLS).map(|k| names(&own.null(seed + k))).collect(),
    };
    for (effect, id) in EFFECTS.iter().enumerate() {
        for (way, (kind, size)) in WAYS.iter().enumerate() {
            let made = match (*kind, &reading) {
                ("PV", _) => Some(own.in_pv(id, *size, seed)),
                (_, Some(reading)) => {
                    let closed = own.closed(id, *size, reading, seed);
                    out.unstable += usize::from(closed.is_none());
                    closed
                }
                _ => None,
            };
            out.made.extend(made.map(|record| (effect, way, names(&record))));
        }
    }
    Some(out)
}

/// Whether a step and a sinusoid of the printed least size are named.
fn least(record: &Record) -> Option<[Vec<bool>; 2]> {
    let (printed, _) = budget(record)?;
    let closing = closing(record)?;
    let own = Loop { record, budget: &closing };
    let scale = printed.series.of_pv[1] / closing.series.of_pv[1];
    let has = |record: &Record, id: &str| names(record).iter().any(|(found, _)| *found == id);
    let places: Vec<f64> = (0..CHECKS).map(|k| (k as f64 + 0.7) / (CHECKS as f64 + 0.4)).collect();
    let step = |size: f64| places.iter().map(|at| has(&own.with_step(scale * size, *at), "step_load")).collect();
    let wave = |(size, f): (f64, f64)| {
        places.iter().map(|phase| has(&own.with_wave(scale * size, f, *phase), "sinusoid")).collect()
    };
    Some([printed.smallest_step.map_or_else(Vec::new, step), printed.smallest_sinusoid.map_or_else(Vec::new, wave)])
}

/// The recordings of the requested half, with their positions.
fn of_half(all: &[(String, Record)]) -> Vec<(usize, &Record)> {
    let odd = std::env::var("ODD").ok().map(|odd| odd == "1");
    let places = all.iter().enumerate().filter(|(place, _)| odd.is_none_or(|odd| odd != place.is_multiple_of(2)));
    places.map(|(place, (_, record))| (place, record)).collect()
}

#[test]
#[ignore = "a benchmark of minutes"]
fn effects_of_the_printed_least_size_are_named() {
    let Some(all) = with_a_cycle("effects_of_the_printed_least_size_are_named") else { return };
    let found: Vec<[Vec<bool>; 2]> = of_half(&all).into_iter().filter_map(|(_, record)| least(record)).collect();
    for (kind, id) in ["step", "sinusoid"].iter().enumerate() {
        let named: Vec<bool> = found.iter().flat_map(|f| f[kind].clone()).collect();
        let right = named.iter().filter(|n| **n).count();
        println!("{id} of the printed least size: {right} of {} named", named.len());
        assert!(2 * right >= named.len());
    }
}

/// The table of one half of the recordings; returns for each effect how many were named at full size in closed loop, of how
/// many.
fn table(name: &str, all: &[&Found]) -> Vec<[usize; 2]> {
    let count = |is: &dyn Fn(&Found) -> bool| all.iter().filter(|f| is(f)).count();
    println!("\n{name}: {} recordings with a cycle, the controller read in {}", all.len(), count(&|f| f.read));
    println!("{:<12} {:<5} {:>4}   named    confirmed  wrong beside  of these confirmed", "effect", "into", "size");
    let mut out = Vec::new();
    for (effect, id) in EFFECTS.iter().enumerate() {
        for (way, (kind, size)) in WAYS.iter().enumerate() {
            let mut sums = [0; 5];
            // If the original recording already has the effect's name, a hit proves nothing.
            for found in all.iter().filter(|f| f.before.iter().all(|(own, _)| own != id)) {
                for (_, _, names) in found.made.iter().filter(|(e, w, _)| (*e, *w) == (effect, way)) {
                    let new = |own: &str| own != *id && found.before.iter().all(|(other, _)| *other != own);
                    let is = [
                        true,
                        names.iter().any(|(own, _)| own == id),
                        names.iter().any(|(own, sure)| own == id && *sure),
                        names.iter().any(|(own, _)| new(own)),
                        names.iter().any(|(own, sure)| new(own) && *sure),
                    ];
                    sums.iter_mut().zip(is).for_each(|(sum, is)| *sum += usize::from(is));
                }
            }
            let [of, right, sure, wrong, wrong_sure] = sums;
            println!(
                "{id:<12} {kind:<5} {size:>4} {right:>5}/{of:<3} {sure:>6}/{of:<3} {wrong:>7}/{of:<3} {wrong_sure:>7}/{of}"
            );
            if (*kind, *size) == ("loop", 1.0) {
                out.push([right, of]);
            }
        }
    }
    let nulls: Vec<&Names> = all.iter().flat_map(|f| &f.nulls).collect();
    println!(
        "resampled nulls: {} of {} named, {} confirmed; as recorded: {} of {} named, {} confirmed; not stable when closed: {}",
        nulls.iter().filter(|n| !n.is_empty()).count(),
        nulls.len(),
        nulls.iter().filter(|n| n.iter().any(|(_, sure)| *sure)).count(),
        count(&|f| !f.before.is_empty()),
        all.len(),
        count(&|f| f.before.iter().any(|(_, sure)| *sure)),
        all.iter().map(|f| f.unstable).sum::<usize>()
    );
    out
}

#[test]
#[ignore = "a benchmark of minutes"]
fn effects_put_into_real_loops_are_named() {
    let Some(all) = with_a_cycle("effects_put_into_real_loops_are_named") else { return };
    let found: Vec<Found> = of_half(&all).into_iter().filter_map(|(place, record)| put_into(record, place)).collect();
    let half = |even: bool| found.iter().filter(|f| f.even == even).collect::<Vec<_>>();
    table("even places of the index", &half(true));
    let named = table("odd places of the index", &half(false));
    for (id, [right, of]) in EFFECTS.iter().zip(named).take(2) {
        assert!(right * 10 >= of * 8, "{id}: {right} of {of} named");
    }
}

/// An answer: a confirmed cause, a confirmed effect of the budget, or that the record cannot tell.
fn kind(d: &GapDocument) -> usize {
    let in_budget = d.budget.iter().flat_map(|b| &b.parts).any(|p| p.confirmed == Some(true));
    match (d.cause.id != UNKNOWN && d.cause.confirmed, in_budget, d.cause.why.as_deref() == Some(CANNOT_BE_TOLD)) {
        (true, ..) => 0,
        (_, true, _) => 1,
        (.., true) => 2,
        _ => 3,
    }
}

#[test]
#[ignore = "a benchmark of minutes"]
fn what_every_recording_tells() {
    let Some(all) = with_a_cycle("what_every_recording_tells") else { return };
    println!(
        "\n{:<42} {:<20} {:>5} {:>7} {:>7} {:>5} {:>5}  effects",
        "recording", "answer", "nats", "process", "wanders", "noise", "rest"
    );
    let mut kinds = [0; 5];
    for (file, record) in &all {
        let Some((made, options)) = diagnosed(record, MANY) else {
            println!("{file:<42} no base");
            kinds[4] += 1;
            continue;
        };
        let d = GapDocument::new(file, record, &options, &made);
        kinds[kind(&d)] += 1;
        let Some(budget) = &d.budget else { continue };
        let sum: f64 = budget.parts.iter().map(|p| p.share_pct).sum();
        assert!((sum - 100.0).abs() < 1e-6, "{file}: {sum}");
        let share = |ids: [&str; 2]| {
            let of = budget.parts.iter().find(|p| ids.contains(&p.id.as_str()));
            of.map_or_else(|| "-".to_owned(), |p| format!("{:.0}", p.share_pct))
        };
        let doubt = |sure: bool| if sure { "" } else { "?" };
        let effects: Vec<String> = budget
            .parts
            .iter()
            .filter_map(|p| p.confirmed.map(|sure| format!("{}{} {:.0}", p.id, doubt(sure), p.share_pct)))
            .collect();
        let unknown = d.cause.id == UNKNOWN;
        println!(
            "{file:<42} {:<20} {:>5.0} {:>7} {:>7} {:>5} {:>5}  {}{}",
            format!("{}{}", d.cause.id, doubt(unknown || d.cause.confirmed)),
            d.tellable.as_ref().map_or(f64::NAN, |t| t.gain_nats),
            share([VALVE_AND_PROCESS; 2]),
            share([DISTURBANCE, NOT_SPLIT]),
            share([NOISE; 2]),
            share([UNEXPLAINED; 2]),
            effects.join(", "),
            budget.no_split.as_ref().map_or_else(String::new, |why| format!(" ({why})")),
        );
    }
    println!(
        "\n{} recordings with a cycle: {} a confirmed cause, {} a confirmed effect in the budget, {} cannot be told; {} neither, \
         {} without a base",
        all.len(),
        kinds[0],
        kinds[1],
        kinds[2],
        kinds[3],
        kinds[4]
    );
    assert!(kinds[..3].iter().sum::<usize>() * 2 > all.len(), "{kinds:?}");
}
