//! The fields of a diagnosis that the scorer reads.

use serde::{Deserialize, Serialize};

/// The named cause.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Called {
    /// An effect's id, `none` or `unknown`.
    pub id: String,
    /// Probability given.
    pub probability: f64,
    /// Whether held-out data confirm it.
    pub confirmed: bool,
}

/// Another possible answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Alternative {
    /// As [`Called::id`].
    pub id: String,
    /// Probability given.
    pub probability: f64,
}

/// Gap of the base.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Gap {
    /// Root mean squared held-out error, PV units.
    pub rmse: f64,
    /// Noise floor, PV units.
    pub noise_floor: Option<f64>,
    /// Gap relative to PV's standard deviation.
    pub relative: Option<f64>,
}

/// A fitted effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EffectAnswer {
    /// Its id.
    pub id: String,
    /// Gap of the base, PV units.
    pub gap_before: f64,
    /// Gap with it, PV units.
    pub gap_after: f64,
    /// Per cent closed.
    pub closed_pct: Option<f64>,
    /// Effects that are indistinguishable from it.
    #[serde(default)]
    pub confusable_with: Vec<String>,
    /// Whether its fit is at the noise floor on the training blocks.
    #[serde(default)]
    pub at_floor: Option<bool>,
}

/// The scored part of a gap document.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Document {
    /// The cause.
    pub cause: Called,
    /// The second cause.
    #[serde(default)]
    pub second_cause: Option<Alternative>,
    /// Location of the cause.
    #[serde(rename = "where")]
    pub place: LocatedStage,
    /// Other answers, best first.
    pub alternatives: Vec<Alternative>,
    /// Gap of the base.
    pub gap: Gap,
    /// Effects, best first.
    pub effects: Vec<EffectAnswer>,
}

/// Location of the gap.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LocatedStage {
    /// Stage.
    pub stage: String,
}

/// The answer with one effect excluded from the catalogue.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Withheld {
    /// The effect.
    pub without: String,
    /// The cause named then.
    pub cause: Called,
}

/// The complete answer for a recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// Name of the recording.
    pub recording: String,
    /// The document; none if the diagnosis failed.
    pub document: Option<Document>,
    /// Whether the base's training error is at the noise floor.
    #[serde(default)]
    pub base_at_floor: Option<bool>,
    /// Why it failed.
    #[serde(default)]
    pub error: Option<String>,
    /// One entry per effect of the catalogue.
    #[serde(default)]
    pub withheld: Vec<Withheld>,
}
