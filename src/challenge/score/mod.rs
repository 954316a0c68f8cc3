//! The scorer: opens the truth and the answers, and counts.
//!
//! Terms. *Coverage*: share of the cases with an effect of the catalogue that are answered with an effect's id (`none`
//! and `unknown` are no answers). *Precision*: right ones among all named calls, cases without an effect and with one
//! that no catalogue has included. *Recall of unknowns*: `unknown` among the cases whose effect no catalogue has, and
//! the same among the catalogue's effects once each is withheld. *Not expressed*: the base's held-out error is within
//! [`EXPRESSED`] times the true noise; there `none` is right too. `unknown` for coloured noise counts as unanswered,
//! coloured noise for `unknown` as wrong. Two effects at once are counted apart: one of the two named is right.

mod answer;
mod figures;
mod text;

pub use answer::{Alternative, Answer, Called, Document, EffectAnswer, Gap, Withheld};
pub use figures::{Confusion, CurvePoint, EffectRow, Figures, Group, Rate};

use std::collections::BTreeMap;

use thiserror::Error;

use super::truth::{Answer as Right, Truth, TruthCase};

/// A base error within this many times the true noise shows no effect.
pub const EXPRESSED: f64 = 1.10;

/// Answers that do not fit the truth.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum ScoreError {
    /// Recordings without an answer.
    #[error("{missing} of {all} recordings have no answer, the first is {first}: run the challenge to its end")]
    Missing {
        /// How many.
        missing: usize,
        /// Of how many.
        all: usize,
        /// The first one.
        first: String,
    },
    /// An answer to a recording that the truth does not know.
    #[error("there is an answer for {name}, which the truth with {all} recordings does not have")]
    Foreign {
        /// The recording.
        name: String,
        /// Recordings in the truth.
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

    /// What was answered; a diagnosis that failed says nothing.
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

    /// Whether `id` is right, `none` for an effect that does not show included.
    fn is_right(&self, id: &str) -> bool {
        self.is_true(id) || (id == "none" && !self.is_expressed())
    }

    /// The document's entry of an effect.
    fn entry(&self, id: &str) -> Option<&EffectAnswer> {
        self.document()?.effects.iter().find(|e| e.id == id)
    }

    /// What was answered with the true effect taken out of the catalogue.
    fn without_truth(&self) -> Option<&Withheld> {
        self.answer.withheld.iter().find(|w| w.without == self.truth.effect)
    }

    /// Whether an answer without the true effect says `unknown`, or names one that the full document states to be
    /// indistinguishable from the truth.
    fn owns_up(&self, withheld: &Withheld) -> [bool; 2] {
        let said = withheld.cause.id.as_str();
        let unknown = said == "unknown" || (said == "none" && !self.is_expressed());
        let stated = |id: &str| {
            self.entry(id).is_some_and(|e| e.confusable_with.iter().any(|other| *other == self.truth.effect))
        };
        [unknown, unknown || stated(said)]
    }
}

/// Pairs answers with the truth and counts.
///
/// # Errors
/// [`ScoreError`] where an answer is missing or has no truth.
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
