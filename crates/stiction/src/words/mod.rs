//! Sentences written from finished documents: an estimate in words that a planner can act on, and beside it the diagnosis of a
//! gap. What the documents themselves quote is in [`crate::core::verdict::headline`].

pub mod action;
pub mod answer;
pub mod gap_text;

use crate::core::ident::region::Size;
use crate::core::people;
use crate::core::units::{number, probability};
pub use crate::core::verdict::answer::at_bound;
use crate::core::verdict::answer::{Scale, Standing, grade as grade_found};
use crate::core::verdict::features::OF_THE_FIT;
pub use crate::core::verdict::headline::{
    beside_cause, claim, gate, headline, reason, reservation, thirds_disagree, verdict,
};
pub use crate::core::verdict::texts::capital;
use crate::core::verdict::{Assessment, Gate, Implausible, NO_VALVE, SCREENED, Verdict};
use action::Action;

/// A contributing cause, in a sentence.
#[must_use]
pub const fn beside(v: Verdict) -> &'static str {
    match v {
        Verdict::Tuning => "the controller's tuning contributes to the oscillation",
        Verdict::Disturbance => "an external disturbance contributes to the oscillation",
        other => verdict(other),
    }
}

/// The recommended action.
#[must_use]
pub fn advice(a: &Assessment) -> String {
    let mut text = action::what_to_do(a);
    for v in &a.contributing {
        text = format!("{text} Also, {}.", beside(*v));
    }
    text
}

/// The bump test of a valve that sticks, one step per item; empty if none is proposed, in which case [`advice`] gives the
/// reason.
#[must_use]
pub fn bump_test(a: &Assessment) -> Vec<String> {
    Action::of(a).map_or_else(Vec::new, |action| action.steps(op_unit(a)))
}

/// The bump test as one text, one numbered step per line; `None` if none is proposed.
#[must_use]
pub fn proposal(a: &Assessment) -> Option<String> {
    let steps = bump_test(a);
    let numbered = steps.iter().enumerate().map(|(k, step)| format!("{}. {step}", k + 1));
    (!steps.is_empty()).then(|| numbered.collect::<Vec<_>>().join("\n"))
}

/// The probability as displayed: `not seen` or `open` below the decision threshold, followed by the number.
#[must_use]
pub fn seen(a: &Assessment) -> String {
    let Some(p) = a.p_stiction.map(probability) else {
        return if a.stiction == Some(false) { "not seen" } else { "no answer" }.to_owned();
    };
    match Standing::of(a) {
        Standing::Sticks | Standing::Suspected => format!("p {p}"),
        Standing::Open => format!("open (p {p})"),
        Standing::NotSeen => format!("not seen (p {p})"),
        Standing::NoAnswer => format!("no answer (p {p})"),
    }
}

/// The unit of OP.
#[must_use]
pub fn op_unit(a: &Assessment) -> &str {
    a.op_unit.as_deref().unwrap_or("OP units")
}

/// How certain the verdict is, in a sentence.
#[must_use]
pub fn sureness(a: &Assessment) -> String {
    let why = || a.reason.map_or_else(|| "a validity check fails".to_owned(), reason);
    let Some(p) = a.p_stiction else {
        let said = if a.stiction.is_some() { "No probability" } else { "No verdict" };
        return format!("{said}: {}.", why());
    };
    let said = format!("p {}, {}", probability(p), assumed(a));
    match Standing::of(a) {
        Standing::NoAnswer if a.reason == Some("masked") => format!("No verdict: {}. With its group, {said}.", why()),
        Standing::NoAnswer => format!("No verdict: {}. The indicators alone would give {said}.", why()),
        Standing::NotSeen => format!("Stiction not seen ({said}{}).", below(a)),
        Standing::Open => {
            format!("Whether the valve sticks is open ({said}{}, but too high to rule it out).", below(a))
        }
        Standing::Sticks | Standing::Suspected => {
            let odds = match p {
                p if p >= 0.9 => "very likely",
                p if p >= 0.7 => "likely",
                p if p >= 0.5 => "more likely than not",
                _ => "possible",
            };
            format!("Stiction {odds} ({said}); {}.", grade(a))
        }
    }
}

/// The prevalence that the probability assumes.
#[must_use]
pub fn assumed(a: &Assessment) -> String {
    format!("assuming that {} % of such loops stick", number(100.0 * a.prevalence))
}

/// The calibrated probability and the threshold that it does not reach.
fn below(a: &Assessment) -> String {
    let threshold = a.p_calibrated.zip(a.explanation.map(|e| e.cuts.called));
    threshold.map_or_else(String::new, |(p, called)| {
        format!("; {} where half stick, below the threshold of {}", probability(p), number(called))
    })
}

fn grade(a: &Assessment) -> String {
    grade_found(a).map_or_else(|| "not graded".to_owned(), |grade| format!("grade {}", graded(a, grade)))
}

/// A grade, with the reason if it is below A.
#[must_use]
pub fn graded(a: &Assessment, grade: char) -> String {
    match reservation(a) {
        None => format!("{grade}: no validity check limits it, and the interval of s is narrow"),
        Some(why) => format!("{grade} ({why})"),
    }
}

/// An implausible property of a model or its record, in words.
#[must_use]
pub const fn implausible(what: Implausible) -> &'static str {
    match what {
        Implausible::DailyCycle => "the cycle takes a day",
        Implausible::Trend => "PV is little more than a straight line",
        Implausible::DeadTime => "the dead time is longer than a loop of this kind, or its period, allows",
        Implausible::TimeConstant => "a time constant is longer than a loop of this kind has, or than the window",
        Implausible::Gain => "the gain would move PV far beyond its range in the record",
        Implausible::Integrating => "a loop of this kind does not integrate",
        Implausible::Fit => "the model follows PV hardly better than PV's mean does",
    }
}

/// Why neither size nor model are given, if the model is implausible.
#[must_use]
pub fn disbelief(a: &Assessment) -> Option<String> {
    let said: Vec<&str> = a.implausible.iter().map(|what| implausible(*what)).collect();
    (!said.is_empty()).then(|| format!("no size and no process model are given: {}", said.join("; ")))
}

/// Class of s relative to the valve's travel, if OP's range is known. Otherwise "moderate" at most: a share of OP's span
/// depends on how quiet the loop is as much as on the band.
#[must_use]
pub fn size_class(a: &Assessment) -> Option<Size> {
    a.severity_by_range.or_else(|| a.strength_by_span.map(|size| size.min(Size::Moderate)))
}

/// The size, in % of travel if OP's range is known, else in OP units; as a lower bound if the estimate is at its own limit;
/// `None` if no stiction was found.
#[must_use]
pub fn size(a: &Assessment) -> Option<String> {
    let s = a.s.filter(|_| a.stiction != Some(false))?;
    let scale = Scale::of(a);
    let mut text = if at_bound(a) {
        let least = a.s_interval.map_or(s, |[low, _]| low);
        format!(
            "{}, at least {}: the estimate or its interval reaches OP's span, the largest possible value",
            scale.told(s),
            people::interval([scale.value(least); 2])[0]
        )
    } else {
        let interval = a.s_interval.map(|ends| {
            let [low, high] = people::interval(ends.map(|end| scale.value(end)));
            format!(", 90 % interval {low} to {high}{}", if a.op_range.is_some() { " %" } else { "" })
        });
        format!("{}{}", scale.told(s), interval.unwrap_or_default())
    };
    // If slip and play look alike, fs and fd are not identified separately.
    if let (Some(fs), Some(fd), Some(true)) = (a.fs, a.fd, a.j_identifiable) {
        let [fs, fd] = [fs, fd].map(|band| people::size(scale.value(band)));
        text = format!("{text}; static band {fs}, kinetic band {fd} {}", scale.unit());
    }
    match (a.severity_by_range, a.s_over_span) {
        (Some(class), _) if class != Size::None => text = format!("{text}; {}, relative to travel", class.name()),
        (None, Some(share)) => text = format!("{text}; {} % of OP's swing", number((100.0 * share).round())),
        _ => {}
    }
    Some(text)
}

/// The text for an indicator without its own.
const UNNAMED: &str = "a sign in the record";

/// What an indicator measures.
#[must_use]
pub fn looks_at(name: &str) -> &'static str {
    match name {
        "likelihood" => "how much better a model with friction explains the record than one without",
        "confirmed" => {
            "whether the friction model is well supported (the stem reverses often enough, and OP is not a scaled copy of PV)"
        }
        "horch" => "whether OP and PV are out of phase by a quarter period, as behind a sticking valve",
        "jumps" => "whether PV moves in jumps while OP moves steadily",
        "curve_fit" => "whether half cycles are triangles rather than sinusoids",
        "travel" => "how far OP travels while PV rests",
        "one_step_gain" => "how much better a sticking stem predicts PV's next value than OP does",
        "periodicity" => "how much of PV's movement keeps a period of its own, as an external load does",
        _ => UNNAMED,
    }
}

/// Stiction index from which a model with friction explains PV clearly better than one without.
const EXPLAINS: f64 = 0.5;

/// The finding of an indicator, as a fact: for stiction, and against it. `index` is the stiction index.
#[must_use]
fn fact(name: &str, towards: bool, index: f64) -> &'static str {
    let [yes, no] = match name {
        "likelihood" => [
            "a model with friction explains PV better than one without",
            if index >= EXPLAINS {
                "the model with friction leaves more than noise unexplained"
            } else {
                "a model with friction explains PV hardly better than one without"
            },
        ],
        "confirmed" => [
            "the friction model is well supported: the stem reverses often enough, and OP is not a scaled copy of PV",
            "the friction model may fit by accident: the stem reverses too seldom, or OP is a scaled copy of PV",
        ],
        "horch" => [
            "OP and PV are out of phase by a quarter period, as behind a sticking valve",
            "OP and PV are not out of phase by a quarter period",
        ],
        "jumps" => [
            "PV moves in jumps while OP moves steadily",
            "PV does not jump while OP moves steadily (a dead band alone makes no jumps)",
        ],
        "curve_fit" => {
            ["half cycles are triangles rather than sinusoids", "half cycles are sinusoids rather than triangles"]
        }
        "travel" => ["OP travels far while PV rests", "OP hardly travels while PV rests"],
        "one_step_gain" => [
            "a sticking stem predicts PV's next value better than OP does",
            "a sticking stem predicts PV's next value hardly better than OP does",
        ],
        "periodicity" => [
            "PV's movement does not keep one steady period, as an external load often does",
            "PV's movement keeps one steady period, as an external load often does and a valve's own cycle can",
        ],
        _ => [UNNAMED, UNNAMED],
    };
    if towards { yes } else { no }
}

/// The evidence as facts with log-odds: first the facts that support the verdict, then those against it, strongest first. Facts
/// of a fit are left out if no fit is reported.
#[must_use]
pub fn evidence(a: &Assessment) -> Vec<(String, f64)> {
    let given = |name: &str| a.process.is_some() || !OF_THE_FIT.contains(&name);
    let mut said: Vec<_> = a.indicators.iter().filter(|w| w.contribution.abs() >= 0.05 && given(w.name)).collect();
    let for_verdict = |c: f64| Standing::of(a).is_found() == (c > 0.0);
    said.sort_by(|x, y| {
        let strength = y.contribution.abs().total_cmp(&x.contribution.abs());
        for_verdict(y.contribution).cmp(&for_verdict(x.contribution)).then(strength)
    });
    let words = |name: &str, c: f64| {
        let points = if c > 0.0 { "points to sticking" } else { "points away from sticking" };
        capital(&format!("{}: {points}", fact(name, c > 0.0, a.stiction_index.unwrap_or(0.0))))
    };
    said.iter().map(|w| (words(w.name, w.contribution), w.contribution)).collect()
}

/// Questions that this record leaves open.
#[must_use]
pub fn unknowns(a: &Assessment) -> Vec<String> {
    let mut out: Vec<String> = a.gates.iter().map(|g| format!("{} ({})", gate(*g), g.name())).collect();
    let screened = a.reason == Some(SCREENED);
    if screened {
        out.push(
            "everything beyond the screening: the loop is calm, so nothing more was computed (screened)".to_owned(),
        );
    } else if let Some(why) = disbelief(a) {
        out.push(why);
    } else if a.reason == Some(NO_VALVE) {
        // The final element is no valve, so no size is missing.
    } else if a.s.is_none() {
        out.push("the size: no model was fitted".to_owned());
    } else if a.j_identifiable == Some(false) {
        out.push("the slip jump j: what it may be reaches from one kind of sticking to another".to_owned());
    }
    if a.gates.contains(&Gate::TooCoarse)
        && let Some(period) = a.oscillation.period_s
    {
        out.push(format!("a reliable band: it needs a sample every {} or faster", people::at_most(period / 50.0)));
    }
    if a.s.is_some() && a.op_range.is_none() {
        out.push(
            "the size in % of travel: OP's range is not known (--op-range, or op_range in the configuration)".into(),
        );
    }
    match a.s_detectable {
        Some(least) => out.push(format!("bands below the detection limit, s = {}", Scale::of(a).told(least))),
        None if a.stiction == Some(false) && !screened => {
            out.push("the detection limit: it is not determinable from this record".to_owned());
        }
        None => {}
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::detect::Indicator;
    use crate::core::record::Record;
    use crate::core::verdict::rule::{Cuts, Opinion};
    use crate::core::verdict::{Oscillation, Window};

    fn empty() -> Assessment {
        let window = Window::of(&Record::uniform(1.0, vec![0.0; 40], vec![0.0; 40]));
        let oscillation = Oscillation {
            oscillating: false,
            period_s: Some(100.0),
            periods: None,
            samples_per_period: None,
            regularity: None,
        };
        Assessment::empty(window, oscillation)
    }

    fn sticking() -> Assessment {
        Assessment {
            verdict: Verdict::Deadband,
            stiction: Some(true),
            p_stiction: Some(0.97),
            p_calibrated: Some(0.97),
            confidence: Some(0.97),
            grade: Some('A'),
            s: Some(2.0),
            s_interval: Some([1.9, 2.1]),
            s_over_span: Some(0.5),
            explanation: Some(Opinion { base: 0.0, logit: 3.0, cuts: Cuts { called: 0.6, alarm: 0.7 } }),
            ..empty()
        }
    }

    #[test]
    fn every_indicator_has_words() {
        for name in crate::core::verdict::features::names() {
            let facts = [(true, 0.0), (false, 0.0), (false, 0.9)].map(|(towards, index)| fact(name, towards, index));
            assert!(looks_at(name) != UNNAMED && facts[0] != facts[1] && facts[0] != facts[2], "{name}");
        }
    }

    #[test]
    fn a_result_below_the_threshold_is_not_seen_with_its_limit_never_healthy() {
        let mut a = Assessment { verdict: Verdict::Tuning, stiction: Some(false), grade: Some('C'), ..sticking() };
        (a.p_stiction, a.p_calibrated) = (Some(0.17), Some(0.17));
        a.s_detectable = Some(1.25);
        let text = format!("{} {} {} {}", headline(&a), sureness(&a), advice(&a), seen(&a));
        for part in ["bands below 1.3 OP units could easily be missed", "not seen (p 0.17", "Bands below 1.3"] {
            assert!(text.contains(part), "{part}: {text}");
        }
        a.s_detectable = None;
        assert!(headline(&a).contains("detection limit not determinable"));
        assert_eq!(size(&a), None);
        assert!(advice(&a).contains("rules out no band"));
        (a.p_stiction, a.p_calibrated) = (Some(0.44), Some(0.44));
        let text = format!("{} {} {} {}", headline(&a), sureness(&a), advice(&a), seen(&a));
        assert!(!text.contains("no sign") && !text.contains("not seen") && text.contains("open (p 0.44"), "{text}");
    }

    #[test]
    fn an_estimate_at_its_bound_is_a_lower_bound() {
        let mut a = sticking();
        assert!(!at_bound(&a) && reservation(&a).is_none() && !headline(&a).contains("grade"));
        (a.s_over_span, a.s_interval, a.grade) = (Some(1.0), Some([1.3, 2.0]), Some('C'));
        assert!(size(&a).unwrap().starts_with("2 OP units, at least 1.3: "), "{:?}", size(&a));
        assert!(headline(&a).contains("(grade C: s reaches the largest"), "{}", headline(&a));
        (a.s_over_span, a.s_interval) = (Some(0.5), Some([1.3, 4.0]));
        a.op_range = Some([0.0, 200.0]);
        assert!(size(&a).unwrap().starts_with("1 % of travel (2 OP units), at least 0.65: "), "{:?}", size(&a));
    }

    #[test]
    fn a_window_whose_parts_disagree_says_so() {
        let a = Assessment { grade: Some('B'), s_thirds: vec![1.5, 2.0, 2.2], ..sticking() };
        assert!(reservation(&a).unwrap().contains("parts of the window give other sizes: s 1.5, 2, 2.2"));
    }

    #[test]
    fn where_the_jump_is_open_both_repairs_are_named() {
        let mut a = Assessment { j_identifiable: Some(false), ..sticking() };
        assert!(headline(&a).starts_with("the valve sticks; slip or play cannot be distinguished"));
        assert!(advice(&a).contains("packing") && advice(&a).contains("linkage"), "{}", advice(&a));
        a.j_identifiable = Some(true);
        assert!(!advice(&a).contains("packing"));
        a.p_calibrated = Some(0.6);
        assert!(headline(&a).starts_with("suspected, below the alarm threshold: "), "{}", headline(&a));
    }

    #[test]
    fn evidence_is_a_fact_and_tells_nothing_of_a_fit_that_is_not_given() {
        let mut a = sticking();
        let of = |name, contribution| Indicator { name, score: None, vote: Some(contribution > 0.0), contribution };
        a.indicators = vec![of("jumps", 0.4), of("confirmed", 1.0), of("horch", -0.6)];
        let said: Vec<String> = evidence(&a).into_iter().map(|(text, _)| text).collect();
        assert_eq!(
            said,
            [
                "PV moves in jumps while OP moves steadily: points to sticking",
                "OP and PV are not out of phase by a quarter period: points away from sticking"
            ]
        );
    }

    #[test]
    fn what_is_missing_is_said_not_shown_as_zero() {
        let mut a = empty();
        assert!(unknowns(&a).iter().any(|u| u.contains("no model")) && evidence(&a).is_empty());
        assert!(sureness(&a).contains("validity check"));
        a.reason = Some("stuck_signal");
        assert!(sureness(&a).contains("failed transmitter") && advice(&a).contains("transmitter"));
        let mut a = Assessment { s: Some(2.0), s_interval: Some([1.0, 4.0]), ..empty() };
        assert_eq!(size(&a).unwrap(), "2 OP units, 90 % interval 1 to 4");
        assert!(unknowns(&a).iter().any(|u| u.contains("--op-range")));
        a.op_range = Some([0.0, 200.0]);
        assert_eq!(size(&a).unwrap(), "1 % of travel (2 OP units), 90 % interval 0.5 to 2 %");
    }
}
