//! Effects in words.

use std::collections::BTreeMap;

use crate::core::gap::document::{EffectNote, GapDocument};
use crate::core::gap::effects::{self, Way};
use crate::core::gap::sizes::{Quantity, Sizes};
use crate::core::gap::types::{NONE, UNKNOWN};
use crate::core::units::number;

/// What an effect is called among others.
pub(super) fn noun(id: &str) -> String {
    id.split('+').map(|one| word(one).unwrap_or(one)).collect::<Vec<_>>().join(" and ")
}

fn word(id: &str) -> Option<&'static str> {
    match id {
        NONE => Some("nothing at all"),
        UNKNOWN => Some("something else"),
        _ => effects::by_id(id).map(|e| e.noun),
    }
}

/// What no record of OP and PV can tell from an effect: its class by its plant names, and what it is confused with where that
/// closes at least half as much of the gap here. One trace in PV is told from another.
pub(super) fn twins(d: &GapDocument, e: &EffectNote) -> Vec<String> {
    let class = effects::by_id(&e.id).and_then(|effect| effect.twin);
    let is_trace = |id: &str| effects::by_id(id).is_some_and(|effect| effect.way == Way::Signature);
    let closes = |id: &str| d.effects.iter().find(|other| other.id == id).and_then(|other| other.closed_pct);
    let near = |id: &str| match (e.closed_pct, closes(id)) {
        (Some(own), Some(other)) => other >= 0.5 * own,
        _ => true,
    };
    let others = e.confusable_with.iter().filter(|id| near(id) && !(is_trace(&e.id) && is_trace(id)));
    class.map(str::to_owned).into_iter().chain(others.map(|id| noun(id))).collect()
}

/// An effect with its fitted sizes.
pub(super) fn phrase(e: &EffectNote) -> String {
    let sizes = Sizes(&e.parameters);
    if let Some(period) = sizes.said("period").filter(|_| e.own_cycle) {
        return format!("a part of the valve's own cycle, period {period} s");
    }
    if let Some(at) = sizes.said("at").filter(|_| e.follows_set_point) {
        return format!("PV's answer to a move of the set point, {at} s after the start");
    }
    phrase_of(&e.id, &e.parameters)
}

/// The same by id and sizes.
pub(super) fn phrase_of(id: &str, parameters: &BTreeMap<String, Quantity>) -> String {
    let with = effects::by_id(id).and_then(|effect| (effect.phrase)(&Sizes(parameters)));
    with.unwrap_or_else(|| {
        let sizes: Vec<String> = parameters
            .iter()
            .map(|(name, q)| format!("{} {}", name.replace('_', " "), sized(q.value, &q.unit)))
            .collect();
        if sizes.is_empty() { noun(id) } else { format!("{} ({})", noun(id), sizes.join(", ")) }
    })
}

fn sized(value: f64, unit: &str) -> String {
    match unit {
        "1" => number(value),
        "OP" | "PV" => format!("{} {unit} units", number(value)),
        unit => format!("{} {unit}", number(value)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_effect_of_the_catalogue_has_words_of_its_own() {
        let all = crate::core::gap::effects::ALL;
        let missing: Vec<_> = all.iter().filter(|e| word(e.id).is_none()).map(|e| e.id).collect();
        assert!(missing.is_empty(), "{missing:?}");
        let mut words: Vec<_> = all.iter().filter_map(|e| word(e.id)).collect();
        words.sort_unstable();
        words.dedup();
        assert_eq!(words.len(), all.len());
        assert_eq!(noun("backlash+sinusoid"), "backlash and an external sinusoid");
    }
}
