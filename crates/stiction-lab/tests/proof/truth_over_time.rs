//! Many windows of one valve whose s is known: false alarms, power, dates and intervals. `--nocapture` prints the figures
//! of docs/plant.md.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use stiction::core::record::Record;
use stiction::core::sim::closed_loop::{Stem, ValveLaw, ValveModel};
use stiction::core::sim::controller::{Action, Pid, PidSettings};
use stiction::core::sim::noise::{Ar1, Noise, stream_of};
use stiction::core::sim::process::{ProcessModel, ProcessState};
use stiction::core::units::NS_PER_S;
use stiction::core::verdict::{AssessParams, assess};
use stiction::over_time::{ChangeKind, OverTime, WindowResult, over_time};

const HOUR_NS: i64 = 3_600_000_000_000;
const START_NS: i64 = 1_767_225_600_000_000_000;

/// A valve's windows: s and the probability of finding stiction may change once.
#[derive(Clone, Copy)]
struct Valve {
    windows: usize,
    /// Windows that cover each moment.
    overlap: usize,
    /// ln s before and after the change; growth of ln s over the whole.
    log_s: [f64; 2],
    growth: f64,
    /// Logit of finding stiction, before and after.
    logit: [f64; 2],
    /// Position of the change, as a share of the whole; above 1 for no change.
    change: f64,
    /// Standard deviations of ln s: the part that the interval covers, and between windows.
    own: f64,
    between: f64,
    /// Autocorrelation of the variation between windows, from window to window without overlap.
    memory: f64,
}

const STEADY: Valve = Valve {
    windows: 500,
    overlap: 1,
    log_s: [1.0, 1.0],
    growth: 0.0,
    logit: [3.0, 3.0],
    change: 2.0,
    own: 0.1,
    between: 0.1,
    memory: 0.0,
};

/// Standard normal noise averaged over windows of `overlap` hops each.
fn averaged(noise: &mut Noise, windows: usize, overlap: usize, memory: f64) -> Vec<f64> {
    let phi = if memory > 0.0 { libm::pow(memory, 1.0 / overlap as f64) } else { 0.0 };
    let mut last = noise.gaussian();
    let hops: Vec<f64> = (0..windows + overlap)
        .map(|_| {
            last = phi * last + (1.0 - phi * phi).sqrt() * noise.gaussian();
            last
        })
        .collect();
    let mean = |k: usize| hops[k..k + overlap].iter().sum::<f64>() / overlap as f64;
    let scale = if memory > 0.0 { 1.0 } else { (overlap as f64).sqrt() };
    (0..windows).map(|k| scale * mean(k)).collect()
}

impl Valve {
    const fn hop_ns(&self) -> i64 {
        HOUR_NS / self.overlap as i64
    }

    /// Time of the change, ns.
    fn changes_ns(&self) -> i64 {
        let whole = self.hop_ns() * (self.windows as i64 - 1) + HOUR_NS;
        START_NS + (self.change * whole as f64) as i64
    }

    fn seen(&self, seed: u64) -> Vec<WindowResult> {
        let mut noise = Noise::new(seed, stream_of("truth over time"));
        let mut of = |memory| averaged(&mut noise, self.windows, self.overlap, memory);
        let (own, between, doubt, width) = (of(0.0), of(self.memory), of(0.0), of(0.0));
        let window = |k: usize| {
            let start_ns = START_NS + self.hop_ns() * k as i64;
            let end_ns = start_ns + HOUR_NS;
            // A window that contains the change is a mixture.
            let after = ((end_ns - self.changes_ns()) as f64 / HOUR_NS as f64).clamp(0.0, 1.0);
            let mixed = |x: [f64; 2]| x[0] + after * (x[1] - x[0]);
            let grown = self.growth * k as f64 / self.windows as f64;
            let x = mixed(self.log_s) + grown + self.own * own[k] + self.between * between[k];
            let p = 1.0 / (1.0 + libm::exp(-(mixed(self.logit) + 1.5 * doubt[k])));
            // Windows know their own error to within a third.
            let half = 1.645 * self.own * libm::exp(0.3 * width[k]);
            let s = libm::exp(x);
            let sticks = p > 0.5;
            WindowResult {
                start_ns,
                end_ns,
                stiction: Some(sticks),
                p_stiction: Some(p),
                p_calibrated: Some(p),
                grade: Some('A'),
                s: Some(s),
                s_interval: Some(if sticks { [s * libm::exp(-half), s * libm::exp(half)] } else { [0.0, s] }),
                j: Some(0.3 * s),
                j_interval: Some([0.25 * s, 0.35 * s]),
                j_identifiable: Some(true),
                gates: vec![],
            }
        };
        (0..self.windows).map(window).collect()
    }

    fn told(&self, seed: u64) -> OverTime {
        over_time(&self.seen(seed))
    }
}

/// Histories without a change, and how often a change is found.
#[test]
fn no_change_is_found_where_there_is_none() {
    let cases = [
        ("500 windows", STEADY),
        ("500 windows, half of them find stiction", Valve { logit: [0.0; 2], ..STEADY }),
        ("500 windows, few find stiction", Valve { logit: [-3.0; 2], ..STEADY }),
        ("500 windows, nothing between them", Valve { between: 0.0, ..STEADY }),
        ("500 windows, much between them", Valve { between: 0.4, ..STEADY }),
        ("500 windows, four at a time", Valve { overlap: 4, ..STEADY }),
        ("500 windows, four at a time, half find stiction", Valve { overlap: 4, logit: [0.0; 2], ..STEADY }),
        ("60 windows", Valve { windows: 60, ..STEADY }),
        ("60 windows, four at a time", Valve { windows: 60, overlap: 4, ..STEADY }),
        ("12 windows", Valve { windows: 12, ..STEADY }),
        ("7 windows", Valve { windows: 7, ..STEADY }),
    ];
    let each = 200;
    let mut all = 0;
    for (name, valve) in cases {
        let found = (0..each).filter(|seed| !valve.told(*seed).changes.is_empty()).count();
        all += found;
        println!("false alarms: {name}: {found} of {each}");
        // 1 % of 200 is 2; 7 have a probability below 0.5 %.
        assert!(found <= 7, "{name}: {found} of {each}");
    }
    let with_memory = Valve { memory: 0.5, ..STEADY };
    let found = (0..each).filter(|seed| !with_memory.told(*seed).changes.is_empty()).count();
    println!("false alarms: 500 windows that remember half of the last one's deviation: {found} of {each}");
    let share = all as f64 / (each as usize * cases.len()) as f64;
    println!("false alarms: {:.2} % of all without memory", 100.0 * share);
    assert!(share <= 0.01, "{share}");
}

/// A change of known size and date: how often it is found, and how often its interval contains the date.
#[test]
fn changes_are_found_and_dated() {
    let step = |pct: f64| [1.0, 1.0 + libm::log(1.0 + 0.01 * pct)];
    let middle = Valve { windows: 100, change: 0.5, ..STEADY };
    let cases = [
        ("repaired, 100 windows", Valve { logit: [3.0, -3.0], ..middle }, ChangeKind::Repaired, 0.99),
        (
            "repaired, 100 windows, four at a time",
            Valve { overlap: 4, logit: [3.0, -3.0], ..middle },
            ChangeKind::Repaired,
            0.95,
        ),
        (
            "repaired 8 windows before the end",
            Valve { change: 0.92, logit: [3.0, -3.0], ..middle },
            ChangeKind::Repaired,
            0.9,
        ),
        ("began to stick", Valve { logit: [-3.0, 3.0], ..middle }, ChangeKind::Worse, 0.99),
        ("s grows by 50 %", Valve { log_s: step(50.0), ..middle }, ChangeKind::Worse, 0.95),
        ("s falls by 33 %", Valve { log_s: step(-33.0), ..middle }, ChangeKind::Better, 0.95),
        ("s grows by 20 %", Valve { log_s: step(20.0), ..middle }, ChangeKind::Worse, 0.3),
        ("s grows by 50 %, 20 windows", Valve { windows: 20, log_s: step(50.0), ..middle }, ChangeKind::Worse, 0.3),
        (
            "s grows by 50 %, much between windows",
            Valve { between: 0.3, log_s: step(50.0), ..middle },
            ChangeKind::Worse,
            0.3,
        ),
    ];
    let each = 100;
    for (name, valve, kind, least) in cases {
        let (mut found, mut held, mut first_only) = (0, 0, 0);
        for seed in 1_000..1_000 + each {
            let told = valve.told(seed);
            let Some(change) = told.changes.iter().find(|c| c.kind == kind) else { continue };
            found += 1;
            held += usize::from((change.from_ns..=change.to_ns).contains(&valve.changes_ns()));
            first_only += usize::from(told.changes.len() == 1);
        }
        println!(
            "power: {name}: {found} of {each} found, {held} dated within their interval, {first_only} the only change"
        );
        assert!(found as f64 >= least * each as f64, "{name}: {found}");
        assert!(held as f64 >= 0.9 * found as f64, "{name}: {held} of {found}");
        assert!(first_only as f64 >= 0.9 * found as f64, "{name}: {first_only} of {found}");
    }
}

/// The pooled interval contains the true s as often as stated.
#[test]
fn the_pooled_interval_holds_the_true_s() {
    let cases = [
        ("1 window", Valve { windows: 1, between: 0.0, ..STEADY }, 0.8),
        ("2 windows", Valve { windows: 2, ..STEADY }, 0.8),
        ("5 windows", Valve { windows: 5, ..STEADY }, 0.85),
        ("30 windows", Valve { windows: 30, ..STEADY }, 0.85),
        ("120 windows, four at a time", Valve { windows: 120, overlap: 4, ..STEADY }, 0.85),
        ("30 windows, much between them", Valve { windows: 30, between: 0.4, ..STEADY }, 0.85),
        ("100 windows with memory of 0.5", Valve { windows: 100, memory: 0.5, between: 0.3, ..STEADY }, 0.8),
        ("100 windows, changed in the middle", Valve { windows: 100, change: 0.5, log_s: [1.0, 1.6], ..STEADY }, 0.85),
    ];
    let each = 300;
    for (name, valve, least) in cases {
        let (mut held, mut all) = (0, 0);
        for seed in 5_000..5_000 + each {
            let Some(pooled) = valve.told(seed).pooled else { continue };
            all += 1;
            held += usize::from((pooled.s_interval[0]..=pooled.s_interval[1]).contains(&libm::exp(valve.log_s[1])));
            assert!(pooled.independent_windows <= valve.windows as f64 + 1e-9);
        }
        let share = held as f64 / all as f64;
        println!("coverage: {name}: {held} of {all} ({:.0} %)", 100.0 * share);
        assert!(share >= least && all > each * 9 / 10, "{name}: {share}");
    }
}

/// Slow growth is a trend, not a series of steps; without growth a trend is hardly ever found.
#[test]
fn a_trend_is_found_and_none_where_there_is_none() {
    let fortnight = Valve { windows: 336, ..STEADY };
    let each = 200;
    let false_trends = (0..each).filter(|seed| fortnight.told(*seed).trend.is_some()).count();
    println!("trend: {false_trends} of {each} where there is none");
    assert!(false_trends <= 7, "{false_trends}");
    let grows = Valve { growth: 0.4, ..fortnight };
    let month = libm::expm1(0.4 / 14.0 * 30.44);
    let (mut found, mut held, mut steps) = (0, 0, 0);
    for seed in 0..each {
        let told = grows.told(seed);
        steps += usize::from(!told.changes.is_empty());
        let Some(trend) = told.trend else { continue };
        found += 1;
        let s = libm::exp(1.4);
        let [low, high] = trend.s_per_month_interval;
        held += usize::from((low..=high).contains(&(s * month)));
        assert!(trend.s_per_month > 0.0 && trend.pct_per_month > 0.0);
    }
    println!("trend: {found} of {each} found, {held} within their interval, {steps} told as steps");
    assert!(found as f64 > 0.9 * each as f64 && held as f64 > 0.8 * found as f64 && steps < 20);
}

/// A stray window is named, and hardly any others.
#[test]
fn windows_that_contradict_are_named() {
    let valve = Valve { windows: 60, ..STEADY };
    let (mut named, mut others) = (0, 0);
    for seed in 0..100 {
        let mut windows = valve.seen(seed);
        let far = windows[30].s.unwrap() * 4.0;
        (windows[30].s, windows[30].s_interval) = (Some(far), Some([0.9 * far, 1.1 * far]));
        let told = over_time(&windows);
        named += usize::from(told.contradicting.iter().any(|c| c.end_ns == windows[30].end_ns && !c.why.is_empty()));
        others += told.contradicting.iter().filter(|c| c.end_ns != windows[30].end_ns).count();
    }
    println!("contradicting: {named} of 100 stray windows named, {others} of 5900 others");
    assert!(named >= 95 && others <= 60, "{named} {others}");
    let mut windows = valve.seen(7);
    (windows[20].stiction, windows[20].p_stiction, windows[20].p_calibrated) = (Some(false), Some(0.01), Some(0.01));
    windows[20].gates = vec!["quantised".to_owned()];
    let told = over_time(&windows);
    let why = &told.contradicting.iter().find(|c| c.end_ns == windows[20].end_ns).unwrap().why;
    assert!(why.contains("no stiction") && why.contains("quantised"), "{why}");
    for told in [told, Valve { logit: [3.0, -3.0], change: 0.5, ..valve }.told(3), over_time(&[])] {
        println!(
            "{}",
            told.sentences.join(
                "
"
            )
        );
        assert!(!told.sentences.is_empty() && told.sentences.iter().all(|s| s.ends_with('.')));
    }
}

/// A loop, second by second, whose valve loses its friction in the middle of the record.
fn repaired_half_way(n: usize, seed: u64) -> Record {
    let process = ProcessModel { gain: 1.5, tau: 20.0, tau2: 0.0, dead_time: 5.0, integrating: false };
    let settings = PidSettings {
        kc: 0.6,
        ti_s: 20.0,
        td_s: 0.0,
        action: Action::Reverse,
        op_min: 0.0,
        op_max: 100.0,
        op_resolution: 0.0,
    };
    let mut noise = Noise::new(seed, 0);
    let mut load = Ar1::new(0.3, 60.0, Noise::new(seed, 1));
    let (mut pid, mut stem, mut state) =
        (Pid::bumpless(settings, 50.0, 2.0, 0.0), Stem::at_rest(50.0), ProcessState::at_rest(process, 0.0));
    let sticking = ValveModel { law: ValveLaw::He, fs: 3.0, fd: 1.0, ..ValveModel::HEALTHY };
    let (mut op, mut pv) = (vec![], vec![]);
    for k in 0..n {
        let y = state.step(stem.position - 50.0 + load.next_value(), 0.0) + 0.05 * noise.gaussian();
        let u = pid.step(2.0, y, 1.0);
        let valve = if k < n / 2 { sticking } else { ValveModel::HEALTHY };
        stem = valve.step(stem, u);
        op.push(u);
        pv.push(y);
    }
    let mut record = Record::uniform(1.0, op, pv);
    record.sp = Some(vec![2.0; n]);
    record
}

/// From samples to the date: windows of a valve repaired in the middle, assessed as the daemon would.
#[test]
fn a_repair_half_way_is_dated_from_samples() {
    let (window, hop, windows) = (900, 450, 32);
    let n = window + hop * (windows - 1);
    let record = repaired_half_way(n, 11);
    let results: Vec<WindowResult> = (0..windows)
        .map(|k| WindowResult::from(&assess(&record.part(k * hop, k * hop + window), &AssessParams::default())))
        .collect();
    let told = over_time(&results);
    let of = |r: &WindowResult| (r.stiction, r.p_stiction, r.s);
    println!("{}\n{:?}", told.sentences.join("\n"), results.iter().map(of).collect::<Vec<_>>());
    let change = told.changes.last().unwrap();
    let repaired_ns = (n / 2) as i64 * NS_PER_S;
    assert_eq!(change.kind, ChangeKind::Repaired, "{:?}", told.changes);
    assert!((change.from_ns..=change.to_ns).contains(&repaired_ns), "{change:?}");
    assert!((change.at_ns - repaired_ns).abs() <= window as i64 * NS_PER_S, "{change:?}");
    let s_before = change.s_before.unwrap();
    assert!((s_before / 4.0 - 1.0).abs() < 0.15, "{s_before}");
    assert!(told.changes.len() == 1 && told.pooled.is_none() && told.since_ns == Some(change.at_ns));
    // Before the repair, only the size is known.
    let before = over_time(&results[..windows / 2 - 2]).pooled.unwrap();
    assert!((before.s_interval[0]..=before.s_interval[1]).contains(&4.0) || (before.s - 4.0).abs() < 0.2, "{before:?}");
}
