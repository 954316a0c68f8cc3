//! The only list of verdict texts: reports, alarms, terminal, page (`src/web/assets/verdicts.js`) and docs/read-a-result.md
//! take them from here.
//!
//! A negative verdict says that no sign was found, never that a valve is healthy.

use serde::Serialize;

use super::Verdict;

/// Texts of a verdict.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Text {
    /// The verdict's id in documents.
    pub id: &'static str,
    /// In a word or two, for tiles and filters.
    pub short: &'static str,
    /// The verdict in a sentence, without capital and full stop.
    pub sentence: &'static str,
    /// The action, which the estimate may extend.
    pub action: &'static str,
}

const STICTION: Text = Text {
    id: "stiction",
    short: "sticks",
    sentence: "the valve sticks and slips",
    action: "confirm the band by a test; then inspect packing, actuator, air supply and positioner",
};
const DEADBAND: Text = Text {
    id: "deadband",
    short: "dead band",
    sentence: "the valve has a dead band",
    action: "confirm the band by a test; then inspect linkage, gears and positioner feedback for play",
};
const DISTURBANCE: Text = Text {
    id: "disturbance",
    short: "disturbed",
    sentence: "the loop oscillates, most likely because of an external disturbance",
    action: "look upstream for a loop or load with this period",
};
const TUNING: Text = Text {
    id: "tuning",
    short: "tuning",
    sentence: "the loop oscillates or follows its set point badly, most likely because of its tuning",
    action: "with operations' consent review the tuning: on an integrating loop lengthen the integral time first, elsewhere lower the gain; raise it where PV creeps to its set point",
};
const CAUSE_UNKNOWN: Text = Text {
    id: "cause_unknown",
    short: "oscillates",
    sentence: "the loop oscillates; the cause was not identified",
    action: "look for the cause of the oscillation: tuning, load, interaction with other loops",
};
const NOT_OSCILLATING: Text = Text {
    id: "not_oscillating",
    short: "steady",
    sentence: "no regular oscillation",
    action: "no action follows from this record; keep the valve in its regular checks",
};
const INCONCLUSIVE: Text = Text {
    id: "inconclusive",
    short: "no answer",
    sentence: "not enough evidence for a verdict",
    action: "collect data that can answer",
};

/// Every verdict's texts, in the order of tables.
pub const ALL: [Text; 7] = [STICTION, DEADBAND, DISTURBANCE, TUNING, CAUSE_UNKNOWN, NOT_OSCILLATING, INCONCLUSIVE];

/// The texts of a verdict.
#[must_use]
pub const fn of(v: Verdict) -> Text {
    match v {
        Verdict::Stiction => STICTION,
        Verdict::Deadband => DEADBAND,
        Verdict::Disturbance => DISTURBANCE,
        Verdict::Tuning => TUNING,
        Verdict::CauseUnknown => CAUSE_UNKNOWN,
        Verdict::NotOscillating => NOT_OSCILLATING,
        Verdict::Inconclusive => INCONCLUSIVE,
    }
}

/// The sentence for a sticking valve whose slip jump is unknown: slip from packing and play look alike then.
pub(crate) const OPEN: &str = "the valve sticks; slip or play cannot be distinguished";
/// What to inspect in that case.
pub(crate) const OPEN_ACTION: &str = "confirm the band by a test; then inspect packing, actuator, air supply and positioner (slip), \
     and linkage, gears and positioner feedback (play)";

/// Follows the verdict if the probability is below the threshold but not low enough for "not seen"; the next is the action for
/// it.
pub(crate) const UNDECIDED: &str = "whether the valve sticks is open";
pub(crate) const UNDECIDED_ACTION: &str = "judge further windows, or a record in which OP moves more; if the loop matters, \
     check the valve with operations' consent by small steps of OP in both directions";

/// With a capital first letter.
#[must_use]
pub fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_verdict_has_its_own_texts() {
        let verdicts = [
            Verdict::Stiction,
            Verdict::Deadband,
            Verdict::Disturbance,
            Verdict::Tuning,
            Verdict::CauseUnknown,
            Verdict::NotOscillating,
            Verdict::Inconclusive,
        ];
        for (v, text) in verdicts.into_iter().zip(ALL) {
            assert_eq!((of(v), text.id), (text, v.name()));
        }
    }

    #[test]
    fn the_names_of_old_recordings_are_read_with_the_meaning_of_today() {
        let of = |name: &str| serde_json::from_str::<Verdict>(&format!("\"{name}\"")).unwrap();
        assert_eq!((of("no_stiction"), of("no_oscillation")), (Verdict::CauseUnknown, Verdict::NotOscillating));
        Verdict::ALL.into_iter().for_each(|v| assert_eq!(of(v.name()), v));
    }

    #[test]
    fn no_text_calls_a_valve_healthy() {
        let all = serde_json::to_string(&ALL).unwrap();
        for claim in ["healthy", "is well", "follows its signal", "in service", "nothing to", "no stiction"] {
            assert!(!all.contains(claim), "{claim}");
        }
    }
}
