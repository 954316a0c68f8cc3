//! Compares intervals with the simulated truth of the half on which their widths were not calibrated.
#![allow(missing_docs)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use stiction::core::ident::width::{Settings, Trust};
use stiction::core::ident::{Options, quantify};
use stiction::core::verdict::{AssessParams, Assessment, ValveChoice, assess};
use stiction_lab::calibrate_intervals::{look, table};
use stiction_lab::truth::fixture::{Draw, Loop};
use stiction_lab::truth::{self as truth, Half, Regime};

const MATCHED: [Regime; 6] = [
    Regime::HeStart,
    Regime::HeSteady,
    Regime::HeSetPoint,
    Regime::TrackingStart,
    Regime::TrackingSteady,
    Regime::TrackingSetPoint,
];

#[test]
fn intervals_hold_the_truth_as_often_as_they_say() {
    let rows: Vec<_> =
        (0..7).flat_map(|seed| MATCHED.map(|regime| look(Half::Report, regime, seed))).flatten().collect();
    let settings = Settings::shipped();
    let n = rows.len() as f64;
    let mean = |i: usize| -> f64 {
        let regimes = table(&rows, settings).into_iter().filter(|c| MATCHED.iter().any(|r| r.name() == c.name));
        regimes.map(|c| c.held[i] * c.loops as f64).sum::<f64>() / n
    };
    let held: [f64; 4] = core::array::from_fn(mean);
    eprintln!("{n} loops: s, j, fs, fd held in {held:?}");
    assert!(n >= 40.0 && held.iter().all(|h| (0.75..=1.0).contains(h)), "{held:?}");
    for row in &rows {
        let [s, j] = row.found;
        let told = row.spread.told(s, j, &settings.least(&row.spread, s), 1.0);
        let inside = |x: [f64; 2], v: f64| x[0] >= 0.0 && x[0] <= v && v <= x[1] && x[1].is_finite();
        assert!(told.s[0] > 0.0 && inside(told.s, s) && inside(told.j, j), "{row:?} {told:?}");
        assert!(inside(told.fs, 0.5 * (s + j)) && inside(told.fd, 0.5 * (s - j)), "{row:?} {told:?}");
    }
    // A good fit gets narrow intervals.
    let sharp = rows.iter().filter(|r| r.spread.trust(r.found[0]) == Trust::White);
    let widths: Vec<f64> = sharp.map(|r| (r.spread.s[1] - r.spread.s[0]) / r.found[0]).collect();
    assert!(widths.len() * 2 > rows.len() && widths.iter().filter(|w| **w < 0.02).count() * 10 > widths.len() * 8);
}

fn assessed(regime: Regime, seed: u64) -> Assessment {
    let case = truth::accuracy(Half::Report, regime, seed);
    let valve = if case.law == "he" { ValveChoice::He } else { ValveChoice::Tracking };
    assess(
        &case.record(),
        &AssessParams { always_fit: true, fit: Options { valve, ..Options::default() }, ..AssessParams::default() },
    )
}

#[test]
fn what_the_model_does_not_know_makes_an_interval_wide() {
    // An implausible model gets no interval at all.
    let all: Vec<Assessment> = (0..6).map(|seed| assessed(Regime::UnknownSine, seed)).collect();
    let told: Vec<&Assessment> = all.iter().filter(|found| found.implausible.is_empty()).collect();
    assert!(told.len() >= 4, "{} of {}", told.len(), all.len());
    for found in told {
        let ([low, high], s) = (found.s_interval.unwrap(), found.s.unwrap());
        // Ten times as wide as with a white residual; 4 % to either side if all other bands are ruled out.
        assert!(low > 0.0 && low < 0.97 * s && high > 1.03 * s, "{low} {s} {high}");
        assert!(found.j_interval.unwrap()[1] - found.j_interval.unwrap()[0] > 0.05 * s);
    }
}

#[test]
fn every_assessment_with_bands_has_intervals_around_them() {
    for (regime, seed) in [(Regime::HeSteady, 3), (Regime::RoundedOp, 1), (Regime::Decimated, 2)] {
        let found = assessed(regime, seed);
        let inside = |x: Option<[f64; 2]>, v: Option<f64>| {
            let ([low, high], v) = (x.unwrap(), v.unwrap());
            low <= v && v <= high && low >= 0.0
        };
        assert!(inside(found.s_interval, found.s) && inside(found.j_interval, found.j), "{found:?}");
        assert!(inside(found.fs_interval, found.fs) && inside(found.fd_interval, found.fd), "{found:?}");
        assert_eq!(found.interval_level, Some(0.9));
        assert!(found.j_identifiable.is_some());
    }
}

#[test]
fn an_interval_is_narrow_in_spite_of_an_unknown_load_where_all_other_bands_are_ruled_out() {
    let width = |seed: u64| {
        let row = look(Half::Report, Regime::UnknownWalk, seed).unwrap();
        let [s, j] = row.found;
        let told = row.spread.told(s, j, &Settings::shipped().least(&row.spread, s), 1.0).s;
        (row.spread.trust(s), told[0] <= row.truth[0] && row.truth[0] <= told[1], (told[1] - told[0]) / s)
    };
    // The bands of the first have no rivals; those of the second do.
    let ((alone, holds, narrow), (among_others, _, wide)) = (width(41023), width(0));
    assert!(alone == Trust::Distinct && holds && narrow < 0.3, "{alone:?} {narrow}");
    assert!(among_others != Trust::Distinct && wide > 2.0 * narrow, "{among_others:?} {wide}");
}

/// A loop at rest, moved by a few pulses of SP.
fn from_rest(seed: u64) -> Loop {
    let mut draw = Draw::new(seed);
    let (gain, tau) = (draw.between(0.5, 2.0), draw.between(8.0, 50.0));
    let s = draw.between(1.5, 6.0);
    let j = s * draw.between(0.1, 0.95);
    Loop {
        fs: 0.5 * (s + j),
        fd: 0.5 * (s - j),
        tracking: false,
        gain,
        taus: vec![tau],
        dead_time: draw.between(1.0, 15.0),
        kc: draw.between(0.2, 0.9) / gain,
        ti: tau * draw.between(0.4, 1.2),
        noise: 0.01 * s * gain,
        sp: |k| if (30..110).contains(&k) { 5.0 } else { 0.0 },
        n: 1000,
        warm_up: 0,
        seed,
    }
}

#[test]
fn few_moves_leave_s_and_the_dead_time_open() {
    let (mut held, mut right, mut count) = (0, 0, 0);
    for seed in 61_000..61_120 {
        let plant = from_rest(seed);
        let simulated = plant.run();
        let moves = simulated.mv.windows(2).filter(|w| w[0] != w[1]).count();
        if !(3..=8).contains(&moves) {
            continue;
        }
        let Ok(found) = quantify(&simulated.record, &Options::default()) else { continue };
        let floor = Settings::shipped().least(&found.spread, found.s);
        let [low, high] = found.spread.told(found.s, found.j, &floor, 1.0).s;
        let s = plant.fs + plant.fd;
        (held, count) = (held + usize::from(low <= s && s <= high), count + 1);
        right += usize::from((found.s / s - 1.0).abs() < 0.02);
    }
    eprintln!("{count} loops of few moves: s held in {held}, within 2 % in {right}");
    assert!(count >= 30 && held * 100 >= 65 * count, "{held} of {count}");
}
