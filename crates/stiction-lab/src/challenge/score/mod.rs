//! The scorer: opens the truth and the answers, and counts.
//!
//! Terms. *Answer rate* (`coverage`): share of the cases with an effect of the catalogue that are answered with an effect's id
//! (`none` and `unknown` are not). *Precision*: right ones among all named effects, including cases without effect and with one
//! outside the catalogue. *Recall of unknowns*: `unknown` among the cases with an effect outside the catalogue, and the same
//! among the catalogue's effects when each is withheld. *Not expressed*: the base's held-out error is within [`EXPRESSED`]
//! times the true noise; `none` is then right too. `unknown` for coloured noise counts as unanswered, coloured noise for
//! `unknown` as wrong. Pairs of effects are counted separately: naming one of the two is right.

mod answer;
mod figures;
mod text;

pub use answer::{Alternative, Answer, Called, Document, EffectAnswer, Gap, Withheld};
pub use figures::{Confusion, CurvePoint, EffectRow, Figures, Group, Rate};

use std::collections::BTreeMap;

use thiserror::Error;

use super::truth::{Answer as Right, Truth, TruthCase};

/// A base error within this many times the true noise does not show the effect.
pub const EXPRESSED: f64 = 1.10;

/// Answers that do not match the truth.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum ScoreError {
    /// Recordings without an answer.
    #[error("{missing} of {all} recordings have no answer, first {first}; finish `challenge run`")]
    Missing {
        /// Number missing.
        missing: usize,
        /// Total.
        all: usize,
        /// Name of the first one.
        first: String,
    },
    /// An answer to an unknown recording.
    #[error("there is an answer for {name}, which the truth with {all} recordings does not have")]
    Foreign {
        /// The recording.
        name: String,
        /// Number of recordings in the truth.
        all: usize,
    },
}

/// A case with its answer.
#[derive(Debug, Clone, Copy)]
pub(super) struct Judged<'a> {
    pub truth: &'a TruthCase,
    pub answer: &'a Answer,
}

impl Judged<'_> {
    fn document(&self) -> Option<&Document> {
        self.answer.document.as_ref()
    }

    /// The answer; a failed diagnosis has none.
    fn said(&self) -> &str {
        self.document().map_or("error", |d| d.cause.id.as_str())
    }

    fn names(&self) -> bool {
        !matches!(self.said(), "none" | "unknown" | "error")
    }

    /// Whether the base leaves more than the noise.
    fn is_expressed(&self) -> bool {
        self.document().is_none_or(|d| d.gap.rmse > EXPRESSED * self.truth.noise_sd)
    }

    /// Whether `id` is the truth, or one of two.
    fn is_true(&self, id: &str) -> bool {
        match self.truth.answer {
            Right::None => id == "none",
            Right::Known => id == self.truth.effect,
            Right::Foreign => id == "unknown",
            Right::Pair => id == self.truth.effect || self.truth.effect.split('+').any(|part| part == id),
        }
    }

    /// Whether `id` is right, including `none` for an effect that does not show.
    fn is_right(&self, id: &str) -> bool {
        self.is_true(id) || (id == "none" && !self.is_expressed())
    }

    /// The second cause.
    fn beside(&self) -> Option<&str> {
        self.document()?.second_cause.as_ref().map(|s| s.id.as_str())
    }

    /// Whether both of two effects are named, as a pair or as first and second cause.
    fn names_both(&self) -> bool {
        let [a, b] = [self.said(), self.beside().unwrap_or_default()];
        [a.to_owned(), format!("{a}+{b}"), format!("{b}+{a}")].contains(&self.truth.effect)
    }

    /// The document's entry of an effect.
    fn entry(&self, id: &str) -> Option<&EffectAnswer> {
        self.document()?.effects.iter().find(|e| e.id == id)
    }

    /// The answer with the true effect excluded from the catalogue.
    fn without_truth(&self) -> Option<&Withheld> {
        self.answer.withheld.iter().find(|w| w.without == self.truth.effect)
    }

    /// Whether an answer without the true effect is `unknown`, or names one that the full document states to be
    /// indistinguishable from the truth.
    fn owns_up(&self, withheld: &Withheld) -> [bool; 2] {
        let said = withheld.cause.id.as_str();
        let unknown = said == "unknown" || (said == "none" && !self.is_expressed());
        let stated = |id: &str| self.entry(id).is_some_and(|e| e.confusable_with.contains(&self.truth.effect));
        [unknown, unknown || stated(said)]
    }
}

/// Whether the effect of a case shows: the base leaves more than [`EXPRESSED`] times the noise.
#[must_use]
pub fn is_expressed(truth: &TruthCase, answer: &Answer) -> bool {
    Judged { truth, answer }.is_expressed()
}

/// Matches answers with the truth and counts.
///
/// # Errors
/// [`ScoreError`] if an answer is missing or has no truth.
pub fn score(truth: &Truth, answers: &[Answer]) -> Result<Figures, ScoreError> {
    let by_name: BTreeMap<&str, &Answer> = answers.iter().map(|a| (a.recording.as_str(), a)).collect();
    let all = truth.cases.len();
    let known = |name: &str| truth.cases.iter().any(|c| c.name == name);
    if let Some(name) = by_name.keys().find(|name| !known(name)) {
        return Err(ScoreError::Foreign { name: (*name).to_owned(), all });
    }
    let missing: Vec<&str> =
        truth.cases.iter().map(|c| c.name.as_str()).filter(|name| !by_name.contains_key(name)).collect();
    if let Some(first) = missing.first() {
        return Err(ScoreError::Missing { missing: missing.len(), all, first: (*first).to_owned() });
    }
    let judged: Vec<Judged<'_>> = truth
        .cases
        .iter()
        .filter_map(|case| by_name.get(case.name.as_str()).map(|answer| Judged { truth: case, answer }))
        .collect();
    Ok(Figures::of(truth, &judged))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// A truth in which the sizes do not matter.
    fn truth_case(name: &str, answer: &str, effect: &str, stage: &str) -> serde_json::Value {
        json!({ "name": name, "answer": answer, "effect": effect, "form": null, "stages": [stage],
            "unpredictable": effect == "coloured_noise", "size": "large", "parameters": {}, "noise_sd": 1.0,
            "pv_sd": 10.0, "setpoint_moves": true, "transient": true, "mv": false, "period": 100.0, "fs": 3.0,
            "fd": 1.0, "gain": 1.0, "tau": 20.0, "dead_time": 5.0, "base_rmse": 3.0, "oracle_rmse": 1.0 })
    }

    fn answer(name: &str, id: &str, second: &str, p: f64, rmse: f64, withheld: &[(&str, &str)]) -> Answer {
        let effects = json!([
            { "id": "extra_lag", "gap_before": 2.8, "gap_after": 0.7, "closed_pct": 75.0, "at_floor": true,
              "confusable_with": ["inverse_response"] },
            { "id": "ramp", "gap_before": 2.8, "gap_after": 2.8, "closed_pct": 0.0, "confusable_with": ["extra_lag"] }
        ]);
        let withheld: Vec<_> = withheld
            .iter()
            .map(|(w, c)| json!({ "without": w, "cause": { "id": c, "probability": 0.5, "confirmed": false } }))
            .collect();
        let document = json!({ "cause": { "id": id, "probability": p, "confirmed": p > 0.5 },
            "where": { "stage": if id == "ramp" { "disturbance" } else { "process" } },
            "alternatives": [{ "id": second, "probability": 1.0 - p }],
            "gap": { "rmse": rmse, "noise_floor": 1.0, "relative": 0.1 }, "effects": effects });
        serde_json::from_value(json!({ "recording": name, "document": document, "withheld": withheld })).unwrap()
    }

    fn truth(cases: Vec<serde_json::Value>) -> Truth {
        serde_json::from_value(json!({ "schema": "stictiond.challenge.truth.v1", "version": "0", "seed": 1,
            "split": "A", "cases_per_effect": 1, "cases": cases }))
        .unwrap()
    }

    fn share(rate: Rate) -> (usize, usize) {
        (rate.right, rate.of)
    }

    #[test]
    fn the_terms_are_counted_as_they_are_defined() {
        let truth = truth(vec![
            truth_case("a", "known", "extra_lag", "process"),
            truth_case("b", "known", "extra_lag", "process"),
            truth_case("c", "known", "ramp", "disturbance"),
            truth_case("d", "known", "coloured_noise", "disturbance"),
            truth_case("e", "none", "none", "none"),
            truth_case("f", "none", "none", "none"),
            truth_case("g", "foreign", "clock_jitter", "measurement"),
            truth_case("h", "foreign", "sluggish_fall", "process"),
            truth_case("i", "pair", "extra_lag+ramp", "process"),
        ]);
        let answers = [
            answer("a", "extra_lag", "ramp", 0.9, 3.0, &[("extra_lag", "unknown"), ("ramp", "extra_lag")]),
            // Within 1.10 times the noise the effect is not visible, so `none` is right.
            answer("b", "none", "extra_lag", 0.6, 1.05, &[("extra_lag", "none")]),
            answer("c", "extra_lag", "ramp", 0.4, 3.0, &[("ramp", "extra_lag")]),
            answer("d", "unknown", "none", 0.7, 3.0, &[("coloured_noise", "ramp")]),
            answer("e", "none", "ramp", 0.8, 1.0, &[]),
            answer("f", "ramp", "none", 0.3, 3.0, &[]),
            answer("g", "unknown", "ramp", 0.8, 3.0, &[]),
            answer("h", "ramp", "unknown", 0.6, 3.0, &[]),
            answer("i", "ramp", "none", 0.6, 3.0, &[]),
        ];
        let figures = score(&truth, &answers).unwrap();
        let all = &figures.groups[0];
        assert_eq!((share(all.top1), share(all.top2)), ((2, 4), (3, 4)));
        assert_eq!((share(all.coverage), share(all.precision)), ((2, 4), (1, 4)));
        assert_eq!((share(all.named_false_alarms), share(all.all_false_alarms)), ((1, 2), (1, 2)));
        assert_eq!((share(all.unknown_foreign), share(all.unknown_withheld)), ((1, 2), (2, 4)));
        assert_eq!((share(all.pairs), all.closed_right_pct), ((1, 1), Some(75.0)));
        // Among answers with at least 0.5, the wrong answer for c is left out.
        let half = figures.curve.iter().find(|c| c.p == 0.5).unwrap();
        assert_eq!((share(half.coverage), share(half.precision)), ((1, 4), (1, 2)));
        let lag = figures.effects.iter().find(|e| e.effect == "extra_lag").unwrap();
        assert_eq!((lag.cases, lag.expressed, share(lag.named)), (2, 1, (2, 2)));
        assert!((lag.gap_with_pct.unwrap() - 7.0).abs() < 1e-9 && lag.gap_oracle_pct == Some(0.0));
        let row = figures.confusion.truths.iter().position(|t| t == "two effects").unwrap();
        assert_eq!(figures.confusion.counts[row].iter().sum::<u32>(), 1);
        assert!(figures.text().contains("known effects named rightly (top 1)                  0.50 (2/4)"));
    }

    #[test]
    fn a_missing_answer_and_a_strange_one_are_named() {
        let truth = truth(vec![truth_case("a", "none", "none", "none"), truth_case("b", "none", "none", "none")]);
        let of = |name: &str| answer(name, "none", "ramp", 0.8, 1.0, &[]);
        let error = score(&truth, &[of("a")]).unwrap_err();
        assert!(error.to_string().contains("1 of 2") && error.to_string().contains('b'));
        assert!(score(&truth, &[of("a"), of("b"), of("z")]).unwrap_err().to_string().contains('z'));
    }
}
