//! Sentences from the numbers, and the assumptions.

use super::plant::Known;
use super::{Case, Figure, Repair, RepairParams};
use crate::core::people::size;
use crate::core::units::number;
use crate::core::verdict::Assessment;

/// Ratio of PV's spread to that of now within which it hardly changes.
const HARDLY: [f64; 2] = [0.85, 1.15];

/// Ratio of an interval's ends from which its middle has no meaning.
const WIDE: f64 = 3.0;

/// Effect of a case on PV's spread.
#[derive(Clone, Copy, PartialEq)]
enum Change {
    Less,
    More,
    Hardly,
    Unknown,
}

fn change(ratio: &Figure) -> Change {
    let [low, high] = ratio.interval;
    match (low, high) {
        (_, high) if high < HARDLY[0] => Change::Less,
        (low, _) if low > HARDLY[1] => Change::More,
        (low, high) if HARDLY[0] <= low && high <= HARDLY[1] => Change::Hardly,
        _ if high < 1.0 => Change::Less,
        _ if low > 1.0 => Change::More,
        _ => Change::Unknown,
    }
}

/// A number with its interval; the interval alone if its ends are so far apart that the middle has no meaning.
fn said(f: &Figure) -> String {
    let [low, high] = f.interval;
    if high > WIDE * low {
        return format!("{} to {}", size(low), size(high));
    }
    format!("{} ({} to {})", size(f.value), size(low), size(high))
}

/// All sentences of the report.
pub(super) fn sentences(told: &Repair, a: &Assessment) -> Vec<String> {
    let (now, repaired, half) = (&told.now, &told.repaired, &told.half_gain);
    let mut out = vec![format!(
        "Simulated as it is now, PV has a standard deviation of {} PV units; the record has {}.",
        said(&now.pv_sd),
        size(told.recorded_pv_sd)
    )];
    if a.stiction == Some(false) {
        out.push("No sign of stiction was found, so the effect of a valve repair was not simulated.".to_owned());
    } else {
        out.push(effect("Without stiction", repaired, now));
        out.push(valve(repaired, now));
        if change(&repaired.pv_sd_ratio) == Change::Hardly {
            out.push(
                "A repair of the valve alone makes no difference to PV: its tuning or a disturbance moves it."
                    .to_owned(),
            );
        }
        if repaired.oscillates == Some(true) {
            out.push(
                "The repaired loop would still oscillate, because of its tuning or an external disturbance: review the tuning too."
                    .to_owned(),
            );
        }
    }
    out.push(effect("With half the controller gain and the valve as it is", half, now));
    if a.stiction == Some(true) && half.oscillates == Some(true) {
        out.push("With half the gain it would go on oscillating: a lower gain does not remove stiction.".to_owned());
    }
    out
}

fn effect(lead: &str, case: &Case, now: &Case) -> String {
    let (to, from) = (said(&case.pv_sd), size(now.pv_sd.value));
    let percent = |x: f64| size(100.0 * (x - 1.0).abs());
    let would = format!("{lead} PV would vary by {to} instead of {from} PV units");
    let [low, high] = case.pv_sd_ratio.interval.map(percent);
    match change(&case.pv_sd_ratio) {
        Change::Less => format!("{would}: {high} to {low} % less."),
        Change::More => format!("{would}: {low} to {high} % more."),
        Change::Hardly => format!("{would}: hardly a difference."),
        Change::Unknown => format!("{would}: whether that is less or more is not known."),
    }
}

/// Change of the stem's movement, as far as it is known well enough to report.
fn valve(case: &Case, now: &Case) -> String {
    let less = |of: fn(&Case) -> Figure| of(case).interval[1] < of(now).value;
    let told = |of: fn(&Case) -> Figure| format!("{} instead of {}", said(&of(case)), size(of(now).value));
    match (less(|c| c.travel_per_day), less(|c| c.reversals_per_day)) {
        (true, true) => format!(
            "The stem would travel {} OP units a day and reverse {} times.",
            told(|c| c.travel_per_day),
            told(|c| c.reversals_per_day)
        ),
        (true, false) => format!("The stem would travel {} OP units a day.", told(|c| c.travel_per_day)),
        (false, true) => format!("The stem would reverse {} times a day.", told(|c| c.reversals_per_day)),
        (false, false) => "This record does not show whether the stem would travel less.".to_owned(),
    }
}

/// The assumptions of the simulation.
pub(super) fn assumptions(told: &Repair, known: &Known<'_>, params: &RepairParams) -> Vec<String> {
    let c = known.controller;
    let ti = if c.ti_s.is_finite() { format!("Ti {} s", number(c.ti_s)) } else { "no integral action".to_owned() };
    let mut out = vec![
        "The disturbance is what the model leaves of PV in this record, without stiction anything between that and the measurement noise; rarer loads are not included."
            .to_owned(),
        format!(
            "The controller is the one read from the record (gain {}, {ti}, Td {} s; it explains {} % of OP's moves) and stays as it is.",
            number(c.kc),
            number(c.td_s),
            number(100.0 * c.r2)
        ),
        "A repaired valve follows OP exactly; packing and actuator leave a real one a small dead band.".to_owned(),
        format!("A reversal of the stem counts at {} OP units or more.", number(told.turn_op)),
    ];
    if known.sp.is_none() {
        out.push("The set point is not recorded: it is assumed to be PV's mean.".to_owned());
    }
    if params.op_range.is_none() {
        out.push("OP's limits are not known: OP may go as far as the controller takes it.".to_owned());
    }
    if known.box_samples > 1.0 {
        out.push("The record holds means over several samples: travel between them is not counted.".to_owned());
    }
    out
}
