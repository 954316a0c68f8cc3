//! A group in sentences.

use super::document::{GroupDocument, Source, SourceKind};
use super::evidence::Evidence;
use super::source::{Decision, names};
use crate::core::units::{duration, number, probability};
use crate::core::verdict::MemberJudgement;

/// Probability from which a source is named.
const NAMED: f64 = 0.7;
/// Most reasons given.
const REASONS: usize = 3;
/// Duration of a test in manual, periods.
const TEST_PERIODS: f64 = 4.0;

/// The source of a group whose likeliest member is called `name`.
pub(super) fn source(decision: &Decision, evidence: &Evidence, name: &str, period_s: f64) -> Source {
    let p_best = decision.p_source[decision.best];
    let (kind, probability) = match () {
        () if p_best >= NAMED => (SourceKind::Loop, p_best),
        () if decision.p_outside >= NAMED => (SourceKind::Outside, decision.p_outside),
        () if decision.likely() > 1 => (SourceKind::Several, 1.0 - decision.p_outside),
        () => (SourceKind::CannotTell, 1.0 - p_best.max(decision.p_outside)),
    };
    let outside = kind == SourceKind::Outside;
    let next_test = matches!(kind, SourceKind::Several | SourceKind::CannotTell).then(|| {
        format!(
            "Put {name} in manual for {} ({TEST_PERIODS} periods): if the others stop oscillating, {name} is the source.",
            duration(TEST_PERIODS * period_s)
        )
    });
    Source {
        kind,
        loop_name: (!outside).then(|| name.to_owned()),
        probability,
        reasons: reasons(decision, evidence, name, outside),
        next_test,
    }
}

/// The figures with the largest weight for the likeliest member, or against it if nothing inside causes the oscillation.
fn reasons(decision: &Decision, evidence: &Evidence, name: &str, against: bool) -> Vec<String> {
    let sign = if against { -1.0 } else { 1.0 };
    let mut parts: Vec<(f64, &str, bool)> = Vec::new();
    for ((figure, compared), part) in names().zip(&decision.parts) {
        // A figure and its comparison with the other members are one reason.
        match parts.iter_mut().find(|known| known.1 == figure) {
            Some(known) => (known.0, known.2) = (known.0 + sign * part, known.2 || compared),
            None => parts.push((sign * part, figure, compared)),
        }
    }
    parts.sort_by(|a, b| b.0.total_cmp(&a.0));
    let value = |figure: &str| Evidence::NAMES.iter().position(|n| *n == figure).map_or(0.0, |k| evidence.figures[k]);
    let said = parts.iter().filter(|part| part.0 > 0.1).filter_map(|part| reason(part.1, value(part.1), name, against));
    let mut reasons: Vec<String> = Vec::new();
    for sentence in said {
        if !reasons.contains(&sentence) && reasons.len() < REASONS {
            reasons.push(sentence);
        }
    }
    reasons
}

/// A figure as a fact.
fn reason(figure: &str, value: f64, name: &str, against: bool) -> Option<String> {
    let sentence = match (figure, against) {
        ("own_logit", false) => format!("{name} by itself looks like a sticking valve"),
        ("own_logit", true) => {
            format!("no loop of the group clearly looks like a sticking valve by itself; {name} looks most like one")
        }
        ("likelihood" | "confirmed" | "one_step_gain", false) => {
            format!("a sticking valve explains {name}'s own record best")
        }
        ("likelihood" | "confirmed" | "one_step_gain", true) => {
            format!("a sticking valve explains {name}'s own record hardly better than none")
        }
        ("jumps" | "periodicity", false) => format!("PV of {name} moves in jumps while OP moves steadily"),
        ("stem_explains_others" | "stem_explains_one", false) => {
            format!("the valve movement computed for {name} predicts other loops better than its PV and OP do")
        }
        ("stem_explains_others" | "stem_explains_one", true) => {
            format!("the valve movement computed for {name} predicts the other loops no better than its PV and OP do")
        }
        ("own_stem_beside_another" | "own_stem_beside_two" | "own_stem_less_two" | "own_stem", false) => {
            format!("stiction in {name} explains its PV beyond what the other loops explain")
        }
        ("own_stem_beside_another" | "own_stem_beside_two" | "own_stem_less_two" | "own_stem", true) => {
            format!("the other loops explain PV of {name} as well as stiction in its own valve does")
        }
        ("explains_others" | "explains_less_explained", false) if value > 0.0 => {
            format!("past values of {name}'s PV help to predict the other loops")
        }
        ("explained_by_another" | "explained_by_two", true) => format!("other loops help to predict {name}"),
        _ => return None,
    };
    Some(sentence)
}

/// The cause of a member's oscillation, if the member is not the source.
pub(super) fn cause(source: &Source) -> Option<String> {
    let p = probability(source.probability);
    match (source.kind, &source.loop_name) {
        (SourceKind::Loop, Some(name)) => Some(format!("driven by {name}, p {p}")),
        (SourceKind::Outside, _) => Some(format!("driven from outside these loops, p {p}")),
        _ => None,
    }
}

/// The note on a member that has the same record as another.
pub(super) fn twice(twin: &str) -> String {
    format!("recorded twice, as {twin} too: check the keys of both")
}

/// A member's role in its group, in a sentence.
#[must_use]
pub fn of_member(judged: &MemberJudgement) -> String {
    let own = judged.p_alone.map_or_else(String::new, |p| format!("; by its own window p {}", probability(p)));
    match &judged.cause {
        Some(cause) => format!("{cause}{own}{}", if judged.masked { MASKED } else { "" }),
        None => format!("may make its group's oscillation, p {}{own}", probability(judged.p_source)),
    }
}

/// Appended for a masked member.
const MASKED: &str = "; masked: judge this loop again once that oscillation has ended";

/// The cause of a group's oscillation, in a sentence used by every display of the group.
#[must_use]
pub fn headline(group: &GroupDocument) -> String {
    let source = &group.source;
    let p = probability(source.probability);
    let likeliest = source.loop_name.as_ref().map_or_else(String::new, |name| format!("; {name} is the likeliest"));
    match (source.kind, &source.loop_name) {
        _ if !group.same_record.is_empty() => {
            format!("{} have the same record, so no source is named: check their keys", listed(&group.same_record))
        }
        (SourceKind::Loop, Some(name)) => format!("{name} causes the oscillation (p {p})"),
        (SourceKind::Outside, _) => {
            format!(
                "none of these loops causes the oscillation (p {p}): look upstream for a common load or a loop that is not recorded"
            )
        }
        (SourceKind::Several, _) => format!("more than one of these loops may cause the oscillation{likeliest}"),
        (SourceKind::Loop | SourceKind::CannotTell, _) => {
            format!("the windows do not show which loop causes the oscillation{likeliest}")
        }
    }
}

/// Names in a sentence.
fn listed(names: &[String]) -> String {
    match names {
        [rest @ .., last] if !rest.is_empty() => format!("{} and {last}", rest.join(", ")),
        _ => names.join(", "),
    }
}

/// A group as lines of text.
#[must_use]
pub fn text(group: &GroupDocument) -> String {
    let source = &group.source;
    let mut lines = vec![
        format!("{} loops oscillate together: {}", group.members.len(), headline(group)),
        format!(
            "  period       {}; probability of a chance group {}",
            duration(group.period_s),
            probability(group.p_value)
        ),
    ];
    lines.extend(group.area.iter().map(|area| format!("  area         {area}")));
    lines.extend(source.reasons.iter().map(|reason| format!("  because      {reason}")));
    lines.extend(source.next_test.iter().map(|test| format!("  next test    {test}")));
    for judged in &group.judgements {
        let follower = group.followers.iter().find(|f| f.loop_name == judged.loop_name);
        let role = match follower {
            None if judged.cause.is_none() && source.kind != SourceKind::Loop => "may be the source".to_owned(),
            None => "source".to_owned(),
            Some(f) => format!("lag {} s, {} % of its power", number(f.lag_s), (100.0 * f.share).round()),
        };
        let p = match (judged.p_stiction, judged.p_alone) {
            (Some(p), Some(alone)) if p != alone => format!("p {} (alone {})", probability(p), probability(alone)),
            (Some(p), _) => format!("p {}", probability(p)),
            (None, _) => "not judged".to_owned(),
        };
        let masked = if judged.masked { MASKED } else { "" };
        lines.push(format!("  {:<12} {role}; stiction {p}{masked}", judged.loop_name));
    }
    lines.join("\n")
}
