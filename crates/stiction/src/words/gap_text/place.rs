//! Where the gap lies, in words.

use super::claim::nothing_left;
use crate::core::gap::document::GapDocument;
use crate::core::gap::locate::Location;
use crate::core::gap::loop_run::{Cycle, Cycles};
use crate::core::gap::sizes::percent;
use crate::core::units::{number, probability};

/// p up to which a place is told.
const TOLD_P: f64 = 0.05;
/// Share above an even one from which a place is told.
const TOLD_LIFT: f64 = 0.15;
/// The same for bands, which have no test.
const BAND_LIFT: f64 = 0.4;

/// A place that holds more than its part.
struct Candidate {
    share: f64,
    /// Its part of the points, where that is the measure.
    part: Option<f64>,
    lift: f64,
    words: String,
}

/// `62 % of the gap sits in the 40 s after each slip, 20 % of the points`.
pub(super) fn headline(d: &GapDocument) -> String {
    if nothing_left(d) {
        return "on held-out data simulation and record agree to the noise".to_owned();
    }
    let l = &d.location;
    let mut all = by_phase(l);
    all.extend(by_direction(l));
    all.extend(by_time(l));
    all.extend(by_level(l));
    all.extend(by_band(l));
    match all.into_iter().max_by(|a, b| a.lift.total_cmp(&b.lift)) {
        Some(best) => {
            let part = best.part.map_or_else(String::new, |p| format!(", {} of the points", percent(100.0 * p)));
            format!("{} of the gap occurs {}{part}", percent(100.0 * best.share), best.words)
        }
        None => "no stretch, phase or level of the record holds clearly more of the gap than its part of the points"
            .to_owned(),
    }
}

/// A place whose share is above its part by enough, where the list as a whole is uneven.
fn place(share: Option<f64>, expected: f64, told: bool, words: impl FnOnce() -> String) -> Option<Candidate> {
    let share = share?;
    let lift = share - expected;
    (told && lift >= TOLD_LIFT).then(|| Candidate { share, part: Some(expected), lift, words: words() })
}

fn by_phase(l: &Location) -> Vec<Candidate> {
    let told = l.uneven.phases.is_some_and(|t| t.p <= TOLD_P);
    let (p, e) = (l.phases, l.phases_expected);
    let window = number(l.slip_window_s);
    let stuck = || format!("where the stem has rested for more than {window} s");
    [
        place(p.slip, e.slip.unwrap_or(0.0), told, || format!("in the {window} s after each slip")),
        place(p.stuck, e.stuck.unwrap_or(0.0), told, stuck),
        place(p.moving, e.moving.unwrap_or(0.0), told, || "where the stem keeps moving".to_owned()),
    ]
    .into_iter()
    .flatten()
    .collect()
}

fn by_direction(l: &Location) -> Vec<Candidate> {
    let told = l.uneven.direction.is_some_and(|t| t.p <= TOLD_P);
    // The ratio of densities gives back the shares of the points.
    let (Some(up), Some(down), Some(ratio)) = (l.direction.up, l.direction.down, l.direction_ratio) else {
        return Vec::new();
    };
    let part = (up / ratio) / (up / ratio + down);
    [
        place(Some(up), part, told, || "after moves of the stem upwards".to_owned()),
        place(Some(down), 1.0 - part, told, || "after moves of the stem downwards".to_owned()),
    ]
    .into_iter()
    .flatten()
    .collect()
}

fn by_time(l: &Location) -> Vec<Candidate> {
    let told = l.uneven.segments.is_some_and(|t| t.p <= TOLD_P);
    if let (Some(onset), Some(ratio)) = (l.onset_s, l.trend.onset_ratio) {
        let side = |s: &&crate::core::gap::locate::Segment| (s.from_s + s.to_s) * 0.5 >= onset && ratio > 1.0;
        let inside: Vec<_> = l.segments.iter().filter(side).collect();
        let share: f64 = inside.iter().filter_map(|s| s.share).sum();
        let part: f64 = inside.iter().map(|s| s.expected).sum();
        let since = place(Some(share), part, ratio > 1.0, || format!("from {} s after the start", number(onset)));
        if since.is_some() {
            return since.into_iter().collect();
        }
    }
    let most = l.segments.iter().filter(|s| s.share.is_some());
    let most = most.max_by(|a, b| a.share.unwrap_or(0.0).total_cmp(&b.share.unwrap_or(0.0)));
    let most = most.and_then(|s| {
        place(s.share, s.expected, told, || {
            format!("between {} and {} s after the start", number(s.from_s), number(s.to_s))
        })
    });
    most.into_iter().collect()
}

fn by_level(l: &Location) -> Vec<Candidate> {
    let told = l.uneven.level.is_some_and(|t| t.p <= TOLD_P);
    let half = l.level.len() / 2;
    let sum = |part: &[crate::core::gap::locate::Level]| {
        (part.iter().filter_map(|b| b.share).sum::<f64>(), part.iter().map(|b| b.expected).sum::<f64>())
    };
    let Some(middle) = l.level.get(half) else { return Vec::new() };
    let ((low, low_part), (high, high_part)) = (sum(&l.level[..half]), sum(&l.level[half..]));
    let at = number(middle.from);
    [
        place(Some(low), low_part, told, || format!("where OP is below {at}")),
        place(Some(high), high_part, told, || format!("where OP is above {at}")),
    ]
    .into_iter()
    .flatten()
    .collect()
}

fn by_band(l: &Location) -> Vec<Candidate> {
    let names = [
        "in motion more than three times slower than the oscillation",
        "in motion about twice as slow as the oscillation",
        "at the oscillation's own period",
        "in motion about twice as fast as the oscillation",
        "in motion three to six times as fast as the oscillation",
        "in motion six to fifteen times as fast as the oscillation",
        "in motion more than fifteen times as fast as the oscillation",
    ];
    let of = |(b, name): (&crate::core::gap::locate::Band, &str)| {
        let share = b.share?;
        let lift = share - b.expected;
        // Half as telling as a tested place: slow parts are common.
        (lift >= BAND_LIFT).then(|| Candidate { share, part: None, lift: 0.5 * lift, words: name.to_owned() })
    };
    l.bands.iter().zip(names).filter_map(of).collect()
}

/// How likely chance makes a list as uneven.
fn chance(p: Option<f64>) -> String {
    match p {
        Some(p) if p > TOLD_P => format!(" (not significant, p {})", probability(p)),
        _ => String::new(),
    }
}

/// Rows of the long report.
pub(super) fn rows(d: &GapDocument, row: &mut dyn FnMut(&str, String)) {
    let l = &d.location;
    let share = |x: Option<f64>| x.map_or("-".to_owned(), |x| percent(100.0 * x));
    // Beside a share of the gap that of the points: a phase that lasts long holds much of anything.
    let of = |x: Option<f64>, points: Option<f64>| match points {
        Some(points) if x.is_some() => format!("{} (of {} of the points)", share(x), share(Some(points))),
        _ => share(x),
    };
    let (p, e) = (l.phases, l.phases_expected);
    row(
        "phase",
        format!(
            "at rest {}, within {} s of a slip {}, moving {}",
            of(p.stuck, e.stuck),
            number(l.slip_window_s),
            of(p.slip, e.slip),
            of(p.moving, e.moving)
        ),
    );
    row(
        "direction",
        format!(
            "after moves up {}, down {}{}",
            share(l.direction.up),
            share(l.direction.down),
            chance(l.uneven.direction.map(|t| t.p))
        ),
    );
    let bands: Vec<String> = l.bands.iter().map(|b| share(b.share)).collect();
    row("frequency", format!("{} (below .3, .7, 1.3, 2.5, 6, 15 times 1/period, above)", bands.join(" ")));
    if let Some(r2) = l.level_r2.op {
        row("level", format!("OP explains {} of it (p {:.3})", percent(100.0 * r2.value), r2.p));
    }
    if let (Some(onset), Some(ratio)) = (l.onset_s, l.trend.onset_ratio) {
        row("onset", format!("{} s after the start, power times {}", number(onset), number(ratio)));
    }
    if let (Some(missed), Some(extra)) = (l.slips.missed, l.slips.extra) {
        row("slips", format!("the model misses {missed} of the valve's and makes {extra} that the valve does not"));
    }
    let met: Vec<&str> = l.signatures.iter().filter(|s| s.met).map(|s| s.id.as_str()).collect();
    if !met.is_empty() {
        row("traces", met.join(", "));
    }
    let e = &l.excitation;
    let jumps = e.jumps_per_half_cycle.map_or(String::new(), |j| format!(", {} slips between reversals", number(j)));
    let moves = e.setpoint_moves.map_or(String::new(), |m| format!(", {m} moves of the set point"));
    row("excitation", format!("{} positions of the stem{jumps}{moves}", e.levels));
}

/// The cycle as measured and as the closed loop makes it.
pub(super) fn cycles(c: &Cycles) -> String {
    let of = |c: &Cycle| match c.period_s.filter(|_| c.oscillating) {
        Some(p) => format!("period {} s, PV +-{}", number(p), number(c.amplitude_pv)),
        None => format!("no regular cycle, PV +-{}", number(c.amplitude_pv)),
    };
    let mut text = format!("measured {}", of(&c.measured));
    for (name, cycle) in [("base", &c.before), ("with the cause", &c.after)] {
        if let Some(cycle) = cycle {
            text.push_str(&format!("; {name} {}", of(cycle)));
        }
    }
    text
}
