//! When a loop's gap is diagnosed: after three departing windows, once a day, and whenever a person requests it; always the
//! same for the same windows, whatever happens to the diagnoses.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use stiction::core::record::{Sample, Signal, Value};
use stiction::core::sim::closed_loop::{ClosedLoop, LoopModel, ValveLaw, ValveModel};
use stiction::core::sim::controller::{Action, PidSettings};
use stiction::core::sim::process::ProcessModel;
use stiction::core::verdict::{Assessment, Oscillation, Process, Window};
use stiction_engine::config::Config;
use stiction_engine::engine::{Engine, Event, GapReason, GapRequest, LoopId, Request, SkipReason};

const SECOND: i64 = 1_000_000_000;
const HOUR: i64 = 3600 * SECOND;

/// What happens to requested diagnoses.
#[derive(Clone, Copy, PartialEq)]
enum Then {
    Nothing,
    Skip(SkipReason),
}

/// A loop on an engine with estimates made by `judge`.
struct Rig<J> {
    engine: Engine,
    id: LoopId,
    judge: J,
    then: Then,
    windows: usize,
    asked: Vec<(usize, GapRequest)>,
    /// All other output, in order, as JSON.
    said: Vec<String>,
}

impl<J: FnMut(usize, &Request) -> Assessment> Rig<J> {
    fn new(config: Config, then: Then, judge: J) -> Self {
        let mut engine = Engine::new(config.engine());
        let id = engine.appear("L").unwrap();
        Self { engine, id, judge, then, windows: 0, asked: Vec::new(), said: Vec::new() }
    }

    fn push(&mut self, t_ns: i64, op: f64, pv: f64) {
        for (signal, value) in [(Signal::Op, op), (Signal::Pv, pv)] {
            let mut events = Vec::new();
            let sample = Sample { signal, t_ns, value: Value::number(value), quality: None };
            self.engine.push(self.id, sample, &mut events);
            self.handle(events);
        }
    }

    fn handle(&mut self, mut events: Vec<Event>) {
        while !events.is_empty() {
            for event in std::mem::take(&mut events) {
                match event {
                    Event::Request(r) => {
                        let answer = r.answer(r.record(), (self.judge)(self.windows, &r));
                        self.windows += 1;
                        self.engine.complete(r.id, r.seq, answer, &mut events);
                    }
                    Event::GapRequest(r) => {
                        if let Then::Skip(reason) = self.then {
                            self.engine.skip_gap(r.id, r.number, reason, &mut events);
                        }
                        self.asked.push((self.windows - 1, *r));
                    }
                    Event::Estimate(_, d) => self.said.push(serde_json::to_string(&d).unwrap()),
                    Event::Alarm(_, d) => self.said.push(serde_json::to_string(&d).unwrap()),
                    Event::State(_, d) => self.said.push(serde_json::to_string(&d).unwrap()),
                    Event::Window(..) => {}
                    Event::Gap(_, d) => self.said.push(serde_json::to_string(&d).unwrap()),
                }
            }
        }
    }

    fn asked(&self) -> Vec<(usize, GapReason)> {
        self.asked.iter().map(|(window, r)| (*window, r.reason)).collect()
    }
}

fn config(hop_s: f64) -> Config {
    let mut config = Config::with_prefix("p");
    config.window.hop_s = hop_s;
    config
}

fn assessment(request: &Request, fit_pct: Option<f64>) -> Assessment {
    let still =
        Oscillation { oscillating: false, period_s: None, periods: None, samples_per_period: None, regularity: None };
    let mut a = Assessment::empty(Window::of(&request.record()), still);
    a.process = fit_pct.map(|fit_pct| Process {
        order: 1,
        gain: 2.0,
        time_constants_s: vec![20.0],
        dead_time_s: 5.0,
        integrating: false,
        mse: 0.01,
        fit_pct,
        tested: true,
        gain_interval: None,
        dead_time_interval_s: None,
    });
    a
}

/// Runs `hours` of slow samples, with a window an hour and the fit from `fit_pct` for each.
fn hours(
    hours: i64,
    config: Config,
    then: Then,
    fit_pct: impl Fn(usize) -> Option<f64>,
) -> Rig<impl FnMut(usize, &Request) -> Assessment> {
    let mut rig = Rig::new(config, then, move |window, r: &Request| assessment(r, fit_pct(window)));
    for k in 0..hours * 60 {
        let x = libm::sin(k as f64 * 0.05);
        rig.push(HOUR / 2 + k * 60 * SECOND, 50.0 + x, 20.0 - x);
    }
    rig
}

/// Ten windows fit to 90 %, all later ones to `later`.
fn falls_to(later: f64) -> impl Fn(usize) -> Option<f64> {
    move |window| Some(if window < 10 { 90.0 } else { later })
}

#[test]
fn three_windows_in_a_row_far_below_the_median_ask_once_and_again_the_day_after() {
    let rig = hours(17, config(3600.0), Then::Nothing, falls_to(74.0));
    assert_eq!(rig.asked(), [(12, GapReason::FitFell)]);
    assert!(rig.asked[0].1.model.is_none(), "no window was graded A or B");
    // A fit that keeps falling causes a request a day later, and not before.
    let keeps = |window: usize| Some(if window < 10 { 90.0 } else { 74.0 - 10.0 * (window / 5) as f64 });
    let rig = hours(80, config(3600.0), Then::Nothing, keeps);
    assert_eq!(rig.asked().iter().map(|(w, _)| *w).collect::<Vec<_>>(), [12, 36, 60]);
}

#[test]
fn two_windows_or_fourteen_points_ask_nothing_and_windows_without_a_fit_hold_the_row() {
    let none: [(usize, GapReason); 0] = [];
    assert_eq!(hours(40, config(3600.0), Then::Nothing, falls_to(76.0)).asked(), none);
    let breaks = |window: usize| Some(if window < 10 || window.is_multiple_of(3) { 90.0 } else { 60.0 });
    assert_eq!(hours(40, config(3600.0), Then::Nothing, breaks).asked(), none);
    let holes = |window: usize| if window < 10 { Some(90.0) } else { window.is_multiple_of(2).then_some(60.0) };
    assert_eq!(hours(40, config(3600.0), Then::Nothing, holes).asked(), [(14, GapReason::FitFell)]);
    // There are no usual values yet.
    let early = |window: usize| Some(if window < 3 { 90.0 } else { 60.0 });
    assert_eq!(hours(40, config(3600.0), Then::Nothing, early).asked(), none);
}

#[test]
fn what_found_no_place_is_asked_again_and_what_had_no_answer_is_not() {
    let asked = |reason| hours(20, config(3600.0), Then::Skip(reason), falls_to(60.0)).asked().len();
    assert_eq!((asked(SkipReason::QueueFull), asked(SkipReason::Failed)), (8, 1));
}

#[test]
fn a_persons_wish_that_finds_no_place_does_not_free_the_loops_day() {
    let mut rig = hours(15, config(3600.0), Then::Nothing, falls_to(60.0));
    let unasked = |reasons: Vec<(usize, GapReason)>| reasons.iter().filter(|(_, r)| *r != GapReason::Operator).count();
    assert_eq!(unasked(rig.asked()), 1);
    let mut events = Vec::new();
    let number = rig.engine.run_gap(rig.id, Some("ann"), false, &mut events).unwrap();
    rig.engine.skip_gap(rig.id, number, SkipReason::QueueFull, &mut events);
    rig.handle(events);
    for k in 15 * 60..20 * 60 {
        let x = libm::sin(k as f64 * 0.05);
        rig.push(HOUR / 2 + k * 60 * SECOND, 50.0 + x, 20.0 - x);
    }
    assert_eq!(unasked(rig.asked()), 1, "the row went on, but the day is not over");
}

#[test]
fn what_becomes_of_diagnoses_changes_nothing_else() {
    let estimates = |rig: &[String]| rig.iter().filter(|d| d.contains("estimate.v1")).cloned().collect::<Vec<_>>();
    let nothing = hours(40, config(3600.0), Then::Nothing, falls_to(60.0));
    let skipped = hours(40, config(3600.0), Then::Skip(SkipReason::Failed), falls_to(60.0));
    assert_eq!(nothing.said, skipped.said);
    let busy = hours(40, config(3600.0), Then::Skip(SkipReason::QueueFull), falls_to(60.0));
    assert_eq!(estimates(&nothing.said), estimates(&busy.said));
    assert!(estimates(&busy.said).len() >= 39);
}

#[test]
fn switched_off_it_only_answers_people() {
    let mut off = config(3600.0);
    off.gap.enabled = false;
    let mut rig = hours(40, off, Then::Nothing, falls_to(60.0));
    assert!(rig.asked.is_empty());
    let mut events = Vec::new();
    assert_eq!(rig.engine.run_gap(rig.id, Some("ann"), false, &mut events), Ok(0));
    rig.handle(events);
    let request = &rig.asked[0].1;
    assert_eq!((request.reason, request.by.as_deref(), request.number), (GapReason::Operator, Some("ann"), 0));
    assert!(request.record.end_ns > 40 * HOUR, "the newest samples, not the last window");
    assert!(rig.said.iter().all(|d| !d.contains("stictiond.gap")));
}

#[test]
fn a_loop_without_data_is_refused_with_both_numbers() {
    let mut rig = hours(0, config(3600.0), Then::Nothing, falls_to(60.0));
    for k in 0..20 {
        rig.push(k * SECOND, k as f64, 1.0);
    }
    let refusal = rig.engine.run_gap(rig.id, None, false, &mut Vec::new()).unwrap_err().to_string();
    assert!(refusal.contains("120") && refusal.chars().next().is_some_and(|c| c.is_ascii_digit()), "{refusal}");
}

#[test]
fn a_checkpoint_carries_the_row_and_the_day_over() {
    let first = hours(12, config(3600.0), Then::Nothing, falls_to(60.0));
    assert!(first.asked.is_empty());
    let checkpoint = serde_json::to_string(&first.engine.checkpoint(first.id)).unwrap();
    let mut second = hours(0, config(3600.0), Then::Nothing, |_| Some(60.0));
    let mut checkpoint: stiction_engine::engine::Checkpoint = serde_json::from_str(&checkpoint).unwrap();
    checkpoint.stream = None;
    second.engine.restore(second.id, checkpoint);
    for k in 12 * 60..20 * 60 {
        second.push(HOUR / 2 + k * 60 * SECOND, k as f64, 1.0);
    }
    assert_eq!(second.asked(), [(0, GapReason::FitFell)], "two windows before the restart, one after it");
}

/// A flow loop with a valve that sticks by `fs` and `fd`; it starts at rest.
fn plant() -> LoopModel {
    LoopModel {
        ts_s: 1.0,
        process: ProcessModel { gain: 2.0, tau: 20.0, tau2: 0.0, dead_time: 5.0, integrating: false },
        rest_op: 50.0,
        rest_pv: 60.0,
        controller: PidSettings {
            kc: 0.8,
            ti_s: 8.0,
            td_s: 0.0,
            action: Action::Reverse,
            op_min: 0.0,
            op_max: 100.0,
            op_resolution: 0.0,
        },
        valve: ValveModel { law: ValveLaw::He, fs: 5.0, fd: 3.0, ..ValveModel::HEALTHY },
        pv_noise_sd: 0.1,
        load: vec![],
        pv_disturbance: vec![],
    }
}

/// Estimates with the bands 5 and 3 in the first twenty windows, then `fs` and 0.6 `fs`; graded D in the first four windows,
/// then `grade`.
fn grown(grade: char, fs: f64) -> Vec<(usize, GapRequest)> {
    let mut rig = Rig::new(config(300.0), Then::Nothing, move |window, r: &Request| {
        let mut a = assessment(r, Some(90.0));
        let bands = if window < 20 { (5.0, 3.0) } else { (fs, 0.6 * fs) };
        (a.fs, a.fd, a.valve_model) = (Some(bands.0), Some(bands.1), Some(stiction::core::sim::slips::Law::He));
        a.grade = Some(if window < 4 { 'D' } else { grade });
        a
    });
    let mut t_s = 0;
    let mut play = |valve: ValveModel, scans: i64, seed: u64| {
        let mut plant = ClosedLoop::new(LoopModel { valve, ..plant() }, 0.0, 60.5, seed);
        for _ in 0..scans {
            let scan = plant.step(60.5);
            rig.push(t_s * SECOND, scan.op, scan.pv);
            t_s += 1;
        }
    };
    if fs == 5.0 {
        play(plant().valve, 10_000, 1);
    } else {
        play(plant().valve, 6000, 1);
        play(ValveModel { fs, fd: 0.6 * fs, ..plant().valve }, 4000, 2);
    }
    rig.asked
}

#[test]
fn a_valve_that_sticks_more_is_held_against_the_model_from_before() {
    let asked = grown('A', 8.0);
    assert_eq!(asked.len(), 1, "{:?}", asked.iter().map(|(w, _)| w).collect::<Vec<_>>());
    let (window, request) = &asked[0];
    let model = request.model.as_ref().unwrap();
    assert!((22..30).contains(window) && request.reason == GapReason::GapGrew, "{window} {:?}", request.reason);
    // The fit is as good as ever; the model is that of the first graded window, not of a recent one.
    assert_eq!((model.valve.fs, model.valve.fd, model.valve.law.as_str()), (5.0, 3.0, "he"));
    assert!((model.process.pv - 60.0 - 2.0 * (model.process.op - 50.0)).abs() < 0.3, "{:?}", model.process);
}

#[test]
fn a_valve_that_stays_as_it_was_and_ungraded_windows_ask_nothing() {
    assert!(grown('A', 5.0).is_empty());
    assert!(grown('C', 8.0).is_empty());
}
