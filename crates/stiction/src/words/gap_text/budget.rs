//! The budget as a table, and what the record can tell, in words.

use super::effect;
use crate::core::gap::budget::document::{
    BudgetNote, CANNOT_BE_TOLD, DISTURBANCE, EventNote, NOISE, NOT_SPLIT, PartNote, TellableNote, UNEXPLAINED, UPSETS,
    VALVE_AND_PROCESS,
};
use crate::core::gap::document::GapDocument;
use crate::core::gap::effects;
use crate::core::gap::sizes::percent;
use crate::core::units::{duration, number};
use serde::{Deserialize, Serialize};
use std::iter;

/// What the record tells where that is too little for the cause.
fn too_little(d: &GapDocument) -> Option<&TellableNote> {
    d.tellable.as_ref().filter(|_| d.cause.why.as_deref() == Some(CANNOT_BE_TOLD))
}

/// The clause that says why the cause is unknown or only suspected.
pub(super) fn why_unsure(d: &GapDocument) -> Option<String> {
    let nats = number(too_little(d)?.gain_nats);
    Some(if d.is_worse_than_mean() {
        "no effect can be judged from a base that leaves more of PV than PV's mean does".to_owned()
    } else {
        format!("this record cannot tell: beyond PV's own past, OP predicts only {nats} nats of PV")
    })
}

/// The conclusion where the record cannot tell the cause.
pub(super) fn cannot_be_told(d: &GapDocument) -> Option<String> {
    too_little(d)?;
    Some("Unknown: this record cannot tell, because OP predicts too little of PV beyond PV's own past.".to_owned())
}

/// Effects below this share of PV's variance, %, are left out of the conclusion.
const LEAST_SHARE_PCT: f64 = 1.0;

/// The effects that the budget confirms, with their shares; `None` where it confirms none beside the cause.
pub(super) fn confirmed(d: &GapDocument) -> Option<String> {
    let parts = d.budget.iter().flat_map(|b| &b.parts);
    let is_told = |p: &&PartNote| {
        p.confirmed == Some(true) && !(d.cause.confirmed && p.id == d.cause.id) && p.share_pct >= LEAST_SHARE_PCT
    };
    let noun = |id: &str| if id == UPSETS { "steps and pulses".to_owned() } else { effect::noun(id) };
    let mut parts: Vec<&PartNote> = parts.filter(is_told).collect();
    parts.sort_by(|a, b| b.share_pct.total_cmp(&a.share_pct));
    let each: Vec<String> = parts.into_iter().map(|p| format!("{}, {}", noun(&p.id), percent(p.share_pct))).collect();
    let [first, others @ ..] = each.as_slice() else { return None };
    let others: String = others.iter().map(|other| format!("; {other}")).collect();
    Some(format!("The budget confirms {first} of PV's variance{others}."))
}

/// A part of the budget in words.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PartText {
    /// Share of PV's variance, %, rounded to 0.1.
    pub share_pct: f64,
    /// Its standard deviation, PV units.
    pub sd: f64,
    /// What it is.
    pub words: String,
}

/// A document's budget in words.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BudgetText {
    /// What the columns of the table are, and of how many points.
    pub head: String,
    /// The table.
    pub parts: Vec<PartText>,
    /// What limits the table.
    pub limits: Vec<String>,
}

/// The budget in words, where the document has one.
#[must_use]
pub fn budget(d: &GapDocument) -> Option<BudgetText> {
    let budget = d.budget.as_ref()?;
    // Zero keeps no sign.
    let tenths = |pct: f64| (10.0 * pct).round() / 10.0 + 0.0;
    let part = |part: &PartNote| PartText { share_pct: tenths(part.share_pct), sd: part.sd, words: words(part) };
    Some(BudgetText {
        head: head(budget),
        parts: budget.parts.iter().map(part).collect(),
        limits: no_split(budget).into_iter().chain(smallest(budget)).collect(),
    })
}

/// What the record can tell, and what would tell more.
#[must_use]
pub fn tellable(d: &GapDocument) -> Vec<String> {
    let is_open = d.good_enough.is_none();
    let said =
        |told: &TellableNote| iter::once(predicted(told)).chain(helps(told).filter(|_| is_open)).collect::<Vec<_>>();
    d.tellable.iter().flat_map(said).collect()
}

/// The rows of the table and the sentences on what can be told.
pub(super) fn rows(d: &GapDocument, row: &mut impl FnMut(&str, String)) {
    if let Some(BudgetText { head, parts, limits }) = budget(d) {
        row("budget", head);
        for PartText { share_pct, sd, words } in parts {
            row("", format!("{share_pct:>6.1} %  {:>9}  {words}", number(sd)));
        }
        limits.into_iter().for_each(|limit| row("", limit));
    }
    for (k, sentence) in tellable(d).into_iter().enumerate() {
        row(if k == 0 { "tellable" } else { "" }, sentence);
    }
}

fn head(budget: &BudgetNote) -> String {
    let last = format!("{} points of {}", budget.points, duration(budget.point_s));
    let recorder: Vec<String> = budget.recorder.iter().map(|id| effect::noun(id)).collect();
    let doubt = match recorder.as_slice() {
        [] => String::new(),
        all => format!("; {} makes it less sure", all.join(" and ")),
    };
    format!("share of PV's variance, standard deviation in PV units, part ({last}{doubt})")
}

fn words(part: &PartNote) -> String {
    const STICTION: &str = effects::stiction::EFFECT.id;
    let seconds = |name: &str| part.parameters.get(name).map(|q| duration(q.value));
    let course = || match seconds("period") {
        Some(period) => format!("with a period around {period}"),
        None => "more slowly than the record is long".to_owned(),
    };
    match part.id.as_str() {
        VALVE_AND_PROCESS => "valve and process, driven by OP".to_owned(),
        STICTION => "stiction of the valve: the cycle that would end without it".to_owned(),
        DISTURBANCE => format!("a disturbance that wanders {}", course()),
        NOT_SPLIT => "valve, process and a disturbance, not told apart".to_owned(),
        NOISE => "measurement noise".to_owned(),
        UNEXPLAINED => "unexplained: neither OP nor PV's own past predicts it".to_owned(),
        id => {
            let sure = match part.confirmed {
                Some(true) => "confirmed",
                _ => "suspected, not confirmed",
            };
            let gain = part.gain_nats.map_or_else(String::new, |g| format!(" (gain {} nats)", number(g)));
            let what = match id {
                UPSETS => upsets(&part.events),
                id => effect::phrase_of(id, &part.parameters),
            };
            format!("{what}, {sure}{gain}")
        }
    }
}

/// Loads with their times and sizes.
fn upsets(events: &[EventNote]) -> String {
    let one = |event: &EventNote| {
        let lasts = event.length_s.map_or_else(String::new, |length| format!(" for {}", duration(length)));
        format!("{} PV units{lasts} at {} s", number(event.size), number(event.at_s))
    };
    format!("{} upsets: {}", events.len(), events.iter().map(one).collect::<Vec<_>>().join(", "))
}

fn no_split(budget: &BudgetNote) -> Option<String> {
    let why = match budget.no_split.as_deref()? {
        "process_unstable" => "the process fitted under the noise model runs away by itself",
        _ => "the process' part and the disturbance correlate by more than a half",
    };
    Some(format!("valve and process have no share of their own: {why}"))
}

fn smallest(budget: &BudgetNote) -> Option<String> {
    let one = |s: &crate::core::gap::budget::document::SmallestNote| {
        let size = number(s.size);
        match s.period_s {
            Some(period) => format!("a sinusoid of amplitude {size} and period {}", duration(period)),
            None => format!("a step of {size} PV units"),
        }
    };
    let all: Vec<String> = budget.smallest.iter().map(one).collect();
    (!all.is_empty()).then(|| format!("{} or more would most likely have been named", all.join(", and ")))
}

fn predicted(told: &TellableNote) -> String {
    let structure = match told.structure.as_str() {
        "hardly" => "hardly tells",
        "partly" => "partly tells",
        _ => "mostly tells",
    };
    let controller = told.outside_controller_pct.map_or_else(
        || "no controller could be read".to_owned(),
        |pct| format!("the controller leaves {} % of OP's moves", number(pct)),
    );
    format!(
        "OP predicts {} nats of PV beyond its own past, which {structure} the structure of valve and process; {controller}, \
         {} of the set point, {}, {} periods",
        number(told.gain_nats),
        counted(told.sp_moves, "move"),
        counted(told.slips, "slip"),
        number(told.periods)
    )
}

fn counted(count: u64, what: &str) -> String {
    match count {
        0 => format!("no {what}s"),
        1 => format!("1 {what}"),
        n => format!("{n} {what}s"),
    }
}

fn helps(told: &TellableNote) -> Option<String> {
    let word = |id: &String| match (id.as_str(), told.times_as_long) {
        ("longer_record", Some(times)) => format!("a record {} times as long", number(times)),
        ("longer_record", None) => "a longer record".to_owned(),
        ("op_step", _) => "a step of OP in manual".to_owned(),
        ("valve_position", _) => "the valve position".to_owned(),
        (other, _) => other.replace('_', " "),
    };
    let all: Vec<String> = told.helps.iter().map(word).collect();
    (!all.is_empty()).then(|| format!("more could be told with {}", all.join(", or ")))
}

#[cfg(test)]
mod tests {
    use super::super::{summary, verbose};
    use super::*;
    use crate::core::gap::budget::document::NOT_IN_CATALOGUE;
    use crate::core::gap::document::CauseNote;

    fn document() -> GapDocument {
        serde_json::from_str(include_str!("../../../tests/golden/gap-sinusoid.json")).unwrap()
    }

    #[test]
    fn the_table_has_a_line_for_every_part_and_says_what_is_suspected() {
        let mut d = document();
        let parts = d.budget.as_ref().unwrap().parts.len();
        let text = verbose(&d);
        let shares = text.lines().filter(|l| l.contains(" %  ")).count();
        assert!(shares >= parts && text.contains("measurement noise"), "{text}");
        let part = &mut d.budget.as_mut().unwrap().parts[0];
        (part.id, part.confirmed, part.share_pct) = ("gain_drift".to_owned(), Some(false), -0.01);
        let text = verbose(&d);
        assert!(text.contains(" 0.0 % ") && !text.contains("-0.0 %"), "{text}");
        assert!(text.contains("a drifting gain, suspected, not confirmed"));
    }

    #[test]
    fn upsets_are_said_with_times_sizes_and_lengths() {
        let mut part = document().budget.unwrap().parts.remove(0);
        let event = |at_s: f64, length_s: Option<f64>| EventNote { at_s, size: -1.5, length_s, confirmed: true };
        (part.id, part.confirmed, part.gain_nats) = (UPSETS.to_owned(), Some(true), Some(40.0));
        part.events = vec![event(300.0, None), event(900.0, Some(60.0))];
        assert_eq!(
            words(&part),
            format!(
                "2 upsets: -1.5 PV units at 300 s, -1.5 PV units for {} at 900 s, confirmed (gain 40 nats)",
                duration(60.0)
            )
        );
    }

    #[test]
    fn what_cannot_be_told_is_not_said_to_be_outside_the_catalogue() {
        let mut d = document();
        d.cause.id = "unknown".to_owned();
        d.cause.why = Some(CANNOT_BE_TOLD.to_owned());
        d.tellable.as_mut().unwrap().gain_nats = 12.3;
        assert!(summary(&d)[0].starts_with("Unknown: this record cannot tell, because OP predicts too little"));
        d.cause.why = Some("not_in_catalogue".to_owned());
        assert!(summary(&d)[0].starts_with("Unknown: no effect of the catalogue"));
        let mut part = d.budget.as_ref().unwrap().parts[0].clone();
        (part.id, part.confirmed, part.share_pct) = ("outliers".to_owned(), Some(true), 37.7);
        d.budget.as_mut().unwrap().parts.push(part);
        let parts = " The budget confirms single wild values, 38 % of PV's variance; an external sinusoid, 5 %.";
        assert!(summary(&d)[0].ends_with(parts), "{:?}", summary(&d));
        d.gap.relative = Some(1.25);
        assert!(summary(&d)[0].starts_with("Unknown: the base model leaves 125 % of PV's standard deviation"));
    }

    #[test]
    fn a_cause_that_is_only_suspected_says_that_the_record_cannot_tell_it() {
        let mut told = document().tellable.unwrap();
        let mut why = |id: &str, confirmed: bool, gain_nats: f64| {
            told.gain_nats = gain_nats;
            let cause = CauseNote { id: id.to_owned(), probability: 0.8, confirmed, why: None };
            cause.why_by(&told, true, true)
        };
        assert_eq!(why("sinusoid", false, 12.0), Some(CANNOT_BE_TOLD));
        assert_eq!(why("backlash+sinusoid", false, 12.0), Some(CANNOT_BE_TOLD));
        assert_eq!((why("sinusoid", true, 12.0), why("sinusoid", false, 200.0)), (None, None));
        // PV alone shows these, and nothing is missing.
        assert_eq!((why("clipping", false, 12.0), why("none", false, 12.0)), (None, None));
        assert_eq!(
            (why("unknown", false, 12.0), why("unknown", false, 200.0)),
            (Some(CANNOT_BE_TOLD), Some(NOT_IN_CATALOGUE))
        );
        told.gain_nats = 12.0;
        let cause = CauseNote { id: "swinging_door".to_owned(), probability: 0.9, confirmed: true, why: None };
        assert_eq!([true, false].map(|leads| cause.why_by(&told, leads, true)), [None, Some(CANNOT_BE_TOLD)]);
        told.gain_nats = 200.0;
        let unknown = CauseNote { id: "unknown".to_owned(), ..cause };
        assert_eq!(unknown.why_by(&told, true, false), Some(CANNOT_BE_TOLD));
    }
}
