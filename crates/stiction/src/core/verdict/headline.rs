//! The verdict on a record in a sentence, as documents and displays have it.

use super::answer::{self, Scale, Standing, at_bound};
use super::texts;
use super::{Assessment, Gate, NO_VALVE, Verdict};
use crate::core::ident::width::agree;
use crate::core::people;
use crate::core::units::probability;

/// The verdict in a sentence.
#[must_use]
pub const fn verdict(v: Verdict) -> &'static str {
    texts::of(v).sentence
}

/// The verdict on a record in a sentence: "suspected" if the probability would not raise an alarm, open if slip and play look
/// alike, with the detection limit if nothing was found, and with a reservation below grade A.
#[must_use]
pub fn headline(a: &Assessment) -> String {
    let mut text = claim(a);
    if let (Some(why), Some(grade)) = (reservation(a), answer::grade(a)) {
        text = format!("{text} (grade {grade}: {why})");
    }
    text
}

/// The headline without its grade.
#[must_use]
pub fn claim(a: &Assessment) -> String {
    match Standing::of(a) {
        standing @ (Standing::Sticks | Standing::Suspected) => {
            let sentence = if a.j_identifiable == Some(false) { texts::OPEN } else { verdict(a.verdict) };
            let suspected = standing == Standing::Suspected;
            format!("{}{sentence}", if suspected { "suspected, below the alarm threshold: " } else { "" })
        }
        Standing::Open | Standing::NotSeen => beside_cause(a, a.verdict),
        Standing::NoAnswer => match a.reason {
            Some(why @ NO_VALVE) => reason(why),
            Some(why) => format!("{}: {}", verdict(a.verdict), reason(why)),
            None => verdict(a.verdict).to_owned(),
        },
    }
}

/// The sentence of an estimate that finds no stiction, for a display that already names the cause.
#[must_use]
pub fn beside_cause(a: &Assessment, cause: Verdict) -> String {
    let rest = if Standing::of(a) == Standing::Open { texts::UNDECIDED.to_owned() } else { not_seen(a) };
    let missing: Vec<&str> = a.missing.iter().filter(|_| cause == Verdict::CauseUnknown).map(|m| m.words()).collect();
    let why = if missing.is_empty() { String::new() } else { format!(" ({})", missing.join(", ")) };
    format!("{}{why}; {rest}", verdict(cause))
}

/// The negative finding, with the detection limit.
#[must_use]
fn not_seen(a: &Assessment) -> String {
    match a.s_detectable {
        Some(least) => {
            format!("no sign of stiction found, bands below {} could easily be missed", Scale::of(a).told(least))
        }
        None => "no sign of stiction found, detection limit not determinable".to_owned(),
    }
}

/// The reason for a grade below A, in a few words; `None` for grade A, and if no stiction was found.
#[must_use]
pub fn reservation(a: &Assessment) -> Option<String> {
    if answer::grade(a)? == 'A' {
        return None;
    }
    let mut why: Vec<String> = a.gates.iter().map(|g| g.name().replace('_', " ")).collect();
    if let (Some(c), Some(p)) = (a.confidence, a.p_stiction)
        && c < 0.95
    {
        why.push(format!("p {}", probability(p)));
    }
    if thirds_disagree(a) {
        let said: Vec<String> = a.s_thirds.iter().map(|s| people::size(*s)).collect();
        why.push(format!("parts of the window give other sizes: s {}", said.join(", ")));
    } else if at_bound(a) {
        why.push("s reaches the largest value that OP's span allows".to_owned());
    } else {
        match a.s_interval.zip(a.s) {
            Some(([low, high], s)) if (high - low) / s > 0.15 => {
                let scale = Scale::of(a);
                let [low, high] = people::interval([low, high].map(|end| scale.value(end)));
                why.push(format!("90 % interval of s {low} to {high} {}", scale.unit()));
            }
            None => why.push("no interval of s".to_owned()),
            _ => {}
        }
    }
    Some(why.join("; "))
}

/// Whether the thirds of the window differ by more than the interval of s.
#[must_use]
pub fn thirds_disagree(a: &Assessment) -> bool {
    a.s_interval.is_some_and(|interval| !agree(&a.s_thirds, interval))
}

/// A reason for no answer, or for a verdict without numbers, in words; gates use [`gate`].
#[must_use]
pub fn reason(name: &str) -> String {
    let known = match name {
        "stuck_signal" => {
            "PV does not move while OP travels (a failed transmitter, a closed block valve, or a valve that does not move at \
             all)"
        }
        "implausible_model" => "no plausible model explains this record",
        "daily_cycle" => "the cycle takes a day, as weather, shifts or load make it; it shows nothing of the valve",
        "trend" => "PV is little more than a straight line; there is no cycle to judge the valve by",
        "op_held" => "OP is stored too seldom within a cycle to show what the valve received",
        "not_fitted" => "no model could be fitted",
        "masked" => "the loop follows an oscillation that it shares with others, which hides the state of its valve",
        NO_VALVE => "the final element is declared to be no valve, so stiction is not judged",
        "screened" => "the loop is calm, so only the screening was computed",
        _ => "",
    };
    if !known.is_empty() {
        return known.to_owned();
    }
    Gate::ALL.into_iter().find(|g| g.name() == name).map_or_else(|| name.replace('_', " "), |g| gate(g).to_owned())
}

/// A gate in words.
#[must_use]
pub const fn gate(g: Gate) -> &'static str {
    match g {
        Gate::Manual => "the controller was in manual",
        Gate::BadQuality => "too many values are missing or bad",
        Gate::FrozenPv => "PV never moves",
        Gate::FrozenOp => "OP never moves",
        Gate::NoResponse => "PV does not answer OP: OP runs on while PV stays away from its set point",
        Gate::OpScale => "OP lies between 0 and 1 while its range is far wider: it seems to be a fraction of its range",
        Gate::Swapped => "OP and PV seem to be swapped: the one named OP behaves as a PV does, and the other as an OP",
        Gate::Saturated => "OP is at a limit",
        Gate::TooFewSamples => "there are too few usable samples, or fewer than two periods",
        Gate::RateTooLow => "a period has fewer than 10 samples: the loop cannot be judged at this rate",
        Gate::Skipped => "the fit was skipped: the machine was too busy, or the daemon stopped",
        Gate::TooFewPeriods => "there are few periods, so intervals are wide",
        Gate::TooCoarse => "sampling is too coarse for reliable bands",
        Gate::TooFewReversals => "neither the periods nor the reversals of the stem are enough for a verdict",
        Gate::SetpointSteps => "the set point moved in steps, which disturbs the oscillation test",
        Gate::Quantised => "the resolution of OP or PV is coarse",
        Gate::Compressed => "the historian compressed the data: corners of PV may be its own",
        Gate::Irregular => "the sampling time is not constant",
        Gate::Excursion => "a single event, such as a trip or a start-up, was left out of the fit",
        Gate::StepOrUpset => {
            "PV or OP leaves its usual values for a time; without SP a step cannot be told from an upset, so nothing was left \
             out"
        }
    }
}
