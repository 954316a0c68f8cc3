//! Sentences made from the numbers, and what was taken for granted.

use super::plant::Known;
use super::{Case, Figure, Repair, RepairParams};
use crate::units::number;
use crate::verdict::Assessment;

/// PV's spread over that of now within these is hardly a change.
const HARDLY: [f64; 2] = [0.85, 1.15];

/// What a case does to PV's spread.
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

fn said(f: &Figure) -> String {
    let [low, high] = f.interval.map(number);
    format!("{} ({low} to {high})", number(f.value))
}

/// What is to be said.
pub(super) fn sentences(told: &Repair, a: &Assessment) -> Vec<String> {
    let (now, repaired, half) = (&told.now, &told.repaired, &told.half_gain);
    let mut out = vec![format!(
        "Simulated as it is now, PV has a standard deviation of {} PV units; the record has {}.",
        said(&now.pv_sd),
        number(told.recorded_pv_sd)
    )];
    if a.stiction == Some(false) {
        out.push("No stiction was found, so a repair of the valve would make no difference.".to_owned());
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
                "The repaired loop would still oscillate, by its tuning or a disturbance from outside: retune it, too."
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
    let (to, from) = (said(&case.pv_sd), number(now.pv_sd.value));
    let percent = |x: f64| number(100.0 * (x - 1.0).abs());
    let ratio = &case.pv_sd_ratio;
    let [low, high] = ratio.interval.map(percent);
    match change(ratio) {
        Change::Less => format!(
            "{lead} PV would vary by {to} instead of {from} PV units: {} % less ({high} to {low} %).",
            percent(ratio.value)
        ),
        Change::More => format!(
            "{lead} PV would vary by {to} instead of {from} PV units: {} % more ({low} to {high} %).",
            percent(ratio.value)
        ),
        Change::Hardly => format!("{lead} PV would vary by {to} instead of {from} PV units: hardly a difference."),
        Change::Unknown => format!(
            "{lead} PV would vary by {to} instead of {from} PV units: whether that is less or more cannot be told."
        ),
    }
}

fn valve(case: &Case, now: &Case) -> String {
    format!(
        "The stem would travel {} instead of {} OP units a day, and turn {} instead of {} times.",
        said(&case.travel_per_day),
        number(now.travel_per_day.value),
        said(&case.reversals_per_day),
        number(now.reversals_per_day.value)
    )
}

/// What was taken for granted.
pub(super) fn assumptions(told: &Repair, known: &Known<'_>, params: &RepairParams) -> Vec<String> {
    let c = known.controller;
    let ti = if c.ti_s.is_finite() { format!("Ti {} s", number(c.ti_s)) } else { "no integral action".to_owned() };
    let mut out = vec![
        "The disturbance is what the model leaves of PV in this record, without stiction anything between that and the measurement's noise; loads that come more rarely are not in it."
            .to_owned(),
        format!(
            "The controller is the one read from the record (gain {}, {ti}, Td {} s; it explains {} % of OP's moves) and stays as it is.",
            number(c.kc),
            number(c.td_s),
            number(100.0 * c.r2)
        ),
        "A repaired valve follows OP exactly; packing and actuator leave a real one a small dead band.".to_owned(),
        format!("A turn of the stem counts from {} OP units on.", number(told.turn_op)),
    ];
    if known.sp.is_none() {
        out.push("The set point is not recorded: it is taken to stand where PV was on average.".to_owned());
    }
    if params.op_range.is_none() {
        out.push("OP's limits are not known: OP may go as far as the controller takes it.".to_owned());
    }
    if known.box_samples > 1.0 {
        out.push("The record holds means over several samples: travel between them is not counted.".to_owned());
    }
    out
}
