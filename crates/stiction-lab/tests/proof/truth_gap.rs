//! The gap diagnosis on simulated loops whose cause is known.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::cases;
use std::sync::atomic::{AtomicUsize, Ordering};

use stiction::core::detect::oscillation;
use stiction::core::gap::model::{Added, Model, Process, SCHEMA, Valve};
use stiction::core::gap::{Base, Diagnosis, Executor, FromSp, GapError, GapOptions, Serial, diagnose};
use stiction::core::record::Record;
use stiction::core::sim::closed_loop::{ClosedLoop, LoopModel, ValveLaw, ValveModel};
use stiction::core::sim::controller::{Action, PidSettings};
use stiction::core::sim::disturbance::Disturbance;
use stiction::core::sim::process::ProcessModel;
use stiction::core::sim::slips::Stroke;
use stiction_lab::challenge::{Deck, Split};
use stiction_lab::truth::fixture::Draw;

/// A sticking valve in front of a first-order process, with occasional set-point moves.
fn plain(seed: u64) -> LoopModel {
    let mut d = Draw::new(seed.wrapping_mul(104_729));
    let tau = d.between(8.0, 20.0);
    let dead_time = d.between(2.0, 6.0);
    let fs = d.between(1.5, 3.0);
    LoopModel {
        ts_s: 1.0,
        process: ProcessModel { gain: 1.0, tau, tau2: 0.0, dead_time, integrating: false },
        rest_op: 50.0,
        rest_pv: 80.0,
        controller: PidSettings {
            kc: 0.35 * tau / (dead_time + 1.0),
            ti_s: tau,
            td_s: 0.0,
            action: Action::Reverse,
            op_min: 0.0,
            op_max: 100.0,
            op_resolution: 0.0,
        },
        valve: ValveModel { law: ValveLaw::He, fs, fd: fs * d.between(0.3, 0.7), ..ValveModel::HEALTHY },
        pv_noise_sd: 0.06,
        load: vec![],
        pv_disturbance: vec![],
    }
}

fn record(model: LoopModel, n: usize, seed: u64) -> Record {
    let mut d = Draw::new(seed + 17);
    let mut sp = model.rest_pv;
    let mut closed = ClosedLoop::new(model, 0.0, sp, seed);
    let (mut op, mut pv, mut set) = (vec![], vec![], vec![]);
    for k in 0..n {
        if k % 170 == 60 {
            sp = 80.0 + d.between(-4.0, 4.0);
        }
        let scan = closed.step(sp);
        op.push(scan.op);
        pv.push(scan.pv);
        set.push(scan.sp);
    }
    Record { sp: Some(set), ..Record::uniform(1.0, op, pv) }
}

/// Two threads that take jobs as they become available.
struct Two;

impl Executor for Two {
    fn run(&self, jobs: usize, job: &(dyn Fn(usize) + Sync)) {
        let next = AtomicUsize::new(0);
        std::thread::scope(|scope| {
            for _ in 0..2 {
                scope.spawn(|| {
                    loop {
                        let i = next.fetch_add(1, Ordering::Relaxed);
                        if i >= jobs {
                            break;
                        }
                        job(i);
                    }
                });
            }
        });
    }

    fn tick(&self, _done: u64) -> bool {
        true
    }
}

/// Sequential, stopped after this many evaluations.
struct Until(u64);

impl Executor for Until {
    fn run(&self, jobs: usize, job: &(dyn Fn(usize) + Sync)) {
        (0..jobs).for_each(job);
    }

    fn tick(&self, done: u64) -> bool {
        done < self.0
    }
}

fn told(model: LoopModel, n: usize, seed: u64) -> Diagnosis {
    diagnose(&record(model, n, seed), &GapOptions::default(), &Two).unwrap()
}

#[test]
fn a_loop_like_the_base_has_no_gap_and_gives_its_model_back() {
    for seed in 1..3 {
        let model = plain(seed);
        let loop_record = record(model.clone(), 800, seed);
        let found = diagnose(&loop_record, &GapOptions::default(), &Two).unwrap();
        assert_eq!(found.cause.id, "none", "{seed}: {:?}", found.cause);
        assert!(found.findings.base.at_floor, "{} {:?}", found.findings.base.rmse_train, found.findings.floor);
        // Bands fitted to half of the record may shift one slip of the other half by a sample.
        assert!(found.findings.base.rmse < 1.3 * model.pv_noise_sd, "{}", found.findings.base.rmse);
        let valve = &found.findings.base.model.valve;
        let (s, truth) = (valve.fs + valve.fd, model.valve.fs + model.valve.fd);
        assert!((s / truth - 1.0).abs() < 0.03, "{s} {truth}");
        // SP moves by several standard deviations of the noise, and the loop responds as its model does.
        let from_sp = found.runs.from_sp.unwrap();
        println!("{from_sp:?}");
        assert!(from_sp.base_pct > 50.0 && from_sp.after_pct.is_none(), "{from_sp:?}");
        // The written model explains the record as well, and no refit is worse than its start.
        let options = GapOptions {
            base: Base::Given(Box::new(found.model_after.clone())),
            budget_evaluations: 1,
            ..GapOptions::default()
        };
        let again = diagnose(&loop_record, &options, &Two).unwrap();
        let given = again.findings.given.unwrap();
        // The written bands are the middle of the cell of equal slips, and the initial stem position is a single value.
        assert!(
            (given.rmse / found.findings.base.rmse - 1.0).abs() < 0.15,
            "{} {}",
            given.rmse,
            found.findings.base.rmse
        );
        assert!(again.findings.base.rmse_train <= given.rmse_train * 1.000_001);
    }
}

#[test]
fn what_was_added_is_named_and_closes_the_gap() {
    let sine = Disturbance::Sine { amplitude: 0.8, period_s: 37.0, phase_deg: 20.0 };
    let step = Disturbance::Step { size: 4.0, at_s: 430.0 };
    let second = |m: LoopModel| LoopModel { process: ProcessModel { tau2: 9.0, ..m.process }, ..m };
    let slides = |m: LoopModel| LoopModel { valve: ValveModel { law: ValveLaw::Tracking, ..m.valve }, ..m };
    // The stem spends much of the time at its stop, and reverses from there.
    let stopped = |m: LoopModel| LoopModel { valve: ValveModel { travel_max: m.rest_op + 2.5, ..m.valve }, ..m };
    let moves = |stroke: Stroke, m: LoopModel| LoopModel { valve: ValveModel { stroke, ..m.valve }, ..m };
    let slow = Stroke { rate: 0.25, ..Stroke::FREE };
    let cases: [(&str, LoopModel); 6] = [
        ("sinusoid", LoopModel { pv_disturbance: vec![sine], ..plain(3) }),
        ("step_load", LoopModel { load: vec![step], ..plain(4) }),
        ("extra_lag", second(plain(5))),
        ("sliding_valve", slides(plain(6))),
        ("travel_limit", stopped(plain(8))),
        ("rate_limit", moves(slow, plain(10))),
    ];
    let (mut right, mut worse) = (0, 0);
    for (seed, (id, model)) in cases.into_iter().enumerate() {
        let found = told(model, 900, seed as u64 + 1);
        let named = found.cause.id == id;
        let closes = found.named().and_then(|e| e.closed_pct).is_some_and(|c| c > 40.0);
        println!("from SP: {:?}", found.runs.from_sp);
        let better = |from_sp: FromSp| from_sp.after_pct.is_none_or(|after| after > from_sp.base_pct);
        worse += usize::from(found.cause.confirmed && !found.runs.from_sp.is_none_or(better));
        println!("{id}: {:?}, closed {:?}", found.cause, found.named().and_then(|e| e.closed_pct));
        for e in found.findings.effects.iter().take(4) {
            let left = e.fit.as_ref().map(|f| f.rmse_train);
            println!(
                "  {} leads by {:.2}, leaves {left:?} of floor {:?}",
                e.id, e.lead, found.findings.floor.noise_floor
            );
        }
        right += usize::from(named && closes);
        if named {
            assert!(found.cause.probability > 0.5);
        }
    }
    // Not named: a second lag that reaches the floor but cannot be distinguished from similar effects; a limited rate, whose
    // search ends a tenth above the floor because it does not see the held-out blocks; and a stop at the end of travel, which
    // the decision calls unknown although its model leaves only noise. Hundreds of loops measure the decision, not these six.
    assert!(right >= 3, "{right} of 6");
    // A prediction from SP alone loses the phase of a cycle, so a better model may still predict worse; an effect that is not
    // confirmed promises nothing.
    assert!(worse <= 1, "{worse} of 6 confirmed effects predict worse from SP than the base does");
}

/// Loops of split A whose effect was not found from two or three of its starts, but is found from more.
#[test]
fn a_valves_effect_is_found_from_the_start_that_is_near() {
    let deck = Deck::new(59, Split::of_seed(59), 20);
    for number in cases(&[237, 381][..], &[237, 381, 554, 789]).iter().copied() {
        let made = deck.deal(number - 1).unwrap();
        let period_points = oscillation::detect(&made.record.op(), &made.record.pv).map(|o| o.period_points);
        let found = diagnose(&made.record, &GapOptions { period_points, ..GapOptions::default() }, &Two).unwrap();
        let fit = found.named().and_then(|e| e.fit.as_ref());
        println!("{}: {:?}", made.truth.effect, found.cause);
        assert_eq!(found.cause.id, made.truth.effect, "{number}");
        assert!(fit.is_some_and(|fit| fit.at_floor), "{number}");
    }
}

/// Holds each value until one differs by `band`.
fn held(pv: &[f64], band: f64) -> Vec<f64> {
    let mut last = pv[0];
    pv.iter()
        .map(|v| {
            if (v - last).abs() >= band {
                last = *v;
            }
            last
        })
        .collect()
}

#[test]
#[ignore = "long: tests/run.sh --all"]
fn a_few_stored_values_tell_what_the_recorder_made_of_the_gap() {
    let mut all = Vec::new();
    for seed in 1..=4 {
        let mut compressed = record(plain(seed), 700, seed);
        let stored = |pv: &[f64]| 1 + pv.windows(2).filter(|w| w[0] != w[1]).count();
        let bands = (5..60).map(|tenths| 0.1 * f64::from(tenths));
        compressed.pv = bands.map(|b| held(&compressed.pv, b)).find(|pv| stored(pv) < 36).unwrap();
        let told = diagnose(&compressed, &GapOptions::default(), &Two).unwrap();
        assert_eq!((told.cause.id.as_str(), told.findings.floor.noise_floor), ("hold_compression", None), "{seed}");
        assert_eq!(told.second, None, "so few can all be met by anything");
        let recorder = told.findings.effects.iter().find(|e| e.id == "hold_compression").unwrap();
        // If no model can be fitted to so few values, the share of the gap is absent.
        all.extend(recorder.closed_pct);
    }
    assert!(all.len() >= 3 && all.iter().all(|closed| *closed > 0.0), "{all:?}");
}

#[test]
#[ignore = "long: tests/run.sh --all"]
fn a_slow_lag_in_place_of_an_integrator_keeps_its_initial_state() {
    for seed in [1, 2] {
        let mut model = plain(seed);
        model.process = ProcessModel { gain: 0.04, integrating: true, ..model.process };
        model.controller = PidSettings { kc: 2.0, ti_s: 60.0, ..model.controller };
        let told = told(model, 900, seed);
        assert!(told.findings.relative_gap < 0.5, "seed {seed}: {} of PV's deviation", told.findings.relative_gap);
    }
}

#[test]
fn a_heavy_stem_is_followed_by_its_own_law_and_not_without_its_mass() {
    for seed in 9..12 {
        let m = plain(seed);
        let stroke = Stroke { carried: 0.6, ..Stroke::FREE };
        let heavy = LoopModel { valve: ValveModel { fd: -0.4 * m.valve.fs, stroke, ..m.valve }, ..m };
        let loop_record = record(heavy.clone(), 900, seed);
        let left = |carried: f64| {
            let valve =
                Valve { law: "he".to_owned(), fs: heavy.valve.fs, fd: heavy.valve.fd, stem0: Some(heavy.rest_op) };
            let process = Process {
                gain: 1.0,
                time_constants_s: vec![heavy.process.tau],
                dead_time_s: heavy.process.dead_time,
                integrating: false,
                op: heavy.rest_op,
                pv: heavy.rest_pv,
            };
            let parameters = [("carried".to_owned(), carried)].into_iter().collect();
            let effects = vec![Added { id: "slip_overshoot".to_owned(), parameters }];
            let model = Model { schema: SCHEMA.to_owned(), ts_s: 1.0, valve, process, effects };
            let options =
                GapOptions { base: Base::Given(Box::new(model)), budget_evaluations: 1, ..GapOptions::default() };
            diagnose(&loop_record, &options, &Two).unwrap().findings.given.unwrap().rmse
        };
        let (own, bare) = (left(0.6), left(0.0));
        assert!(own < 1.15 * heavy.pv_noise_sd && bare > 2.0 * own, "{seed}: {own} {bare}");
    }
}

#[test]
#[ignore = "long: tests/run.sh --all"]
fn stems_that_no_pair_of_bands_imitates_are_found_from_nothing() {
    let moves = |fd_over_fs: f64, stroke: Stroke, m: LoopModel| {
        let fd = fd_over_fs * m.valve.fs;
        LoopModel { valve: ValveModel { fd, stroke, ..m.valve }, ..m }
    };
    let uneven = |uneven: f64| Stroke { uneven, ..Stroke::FREE };
    let heavy = |carried: f64| Stroke { carried, ..Stroke::FREE };
    let cases = [
        ("asymmetric_stiction", moves(0.5, uneven(0.35), plain(12))),
        ("asymmetric_stiction", moves(0.4, uneven(-0.55), plain(13))),
        ("slip_overshoot", moves(-0.4, heavy(0.6), plain(9))),
        ("slip_overshoot", moves(-0.25, heavy(0.2), plain(14))),
    ];
    let mut right = 0;
    for (seed, (id, model)) in cases.into_iter().enumerate() {
        let noise = model.pv_noise_sd;
        let loop_record = record(model, 900, seed as u64 + 1);
        let found = diagnose(&loop_record, &GapOptions::default(), &Two).unwrap();
        let own = found.findings.effects.iter().find(|e| e.id == id).and_then(|e| e.fit.as_ref()).unwrap();
        println!(
            "{id}: {:?}, base leaves {} of {noise}, with it {}",
            found.cause, found.findings.base.rmse_train, own.rmse_train
        );
        let named = found.cause.id == id && own.rmse_train < 1.15 * noise;
        right += usize::from(named);
        if named {
            // The written model leaves as little.
            let base = Base::Given(Box::new(found.model_after.clone()));
            let options = GapOptions { base, budget_evaluations: 1, ..GapOptions::default() };
            let again = diagnose(&loop_record, &options, &Two).unwrap().findings.given.unwrap();
            println!("  given back {} for {}", again.rmse_train, own.rmse_train);
            assert!(again.rmse_train < 1.4 * own.rmse_train, "{} {}", again.rmse_train, own.rmse_train);
        }
    }
    // Both uneven stems and one heavy stem stay open: too few starts reach their slips.
    assert!(right >= 1, "{right} of 4");
}

#[test]
fn answers_depend_on_the_work_and_not_on_who_does_it() {
    let loop_record = record(plain(7), 400, 7);
    let options = GapOptions { budget_evaluations: 60_000, ..GapOptions::default() };
    let one = diagnose(&loop_record, &options, &Serial).unwrap();
    assert_eq!(one, diagnose(&loop_record, &options, &Two).unwrap());
    // A search stopped from outside is reproduced from the number of its evaluations.
    let cut = diagnose(&loop_record, &GapOptions::default(), &Until(5_000)).unwrap();
    assert!(cut.stopped_early && cut.search.evaluations >= 5_000);
    assert_eq!(cut, diagnose(&loop_record, &GapOptions::default(), &Until(cut.search.evaluations)).unwrap());
    // The budget holds, except for the base and the last steps.
    assert!(one.search.evaluations < 90_000, "{}", one.search.evaluations);
}

#[test]
fn what_cannot_be_diagnosed_says_why() {
    let short = record(plain(1), 50, 1);
    let error = diagnose(&short, &GapOptions::default(), &Serial).unwrap_err();
    assert!(error.to_string().contains("50 points") && error.to_string().contains("120"), "{error}");
    let mut still = record(plain(1), 300, 1);
    still.pv.fill(3.0);
    assert!(matches!(diagnose(&still, &GapOptions::default(), &Serial), Err(GapError::Still { signal: "PV", .. })));
    let options = GapOptions { without: vec!["gremlins".to_owned()], ..GapOptions::default() };
    let error = diagnose(&record(plain(1), 300, 1), &options, &Serial).unwrap_err();
    assert!(error.to_string().contains("gremlins") && error.to_string().contains("backlash"), "{error}");
}
