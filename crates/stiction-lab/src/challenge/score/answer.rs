//! What the diagnosis answered, as far as the scorer reads it: documents may hold more.

use serde::{Deserialize, Serialize};

/// The cause that was named.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Called {
    /// An effect's id, `none` or `unknown`.
    pub id: String,
    /// Probability given.
    pub probability: f64,
    /// Whether held-out data bear it out.
    pub confirmed: bool,
}

/// Another answer that was not excluded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Alternative {
    /// As [`Called::id`].
    pub id: String,
    /// Probability given.
    pub probability: f64,
}

/// The base's gap.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Gap {
    /// Root mean squared held-out error, PV units.
    pub rmse: f64,
    /// Noise floor, PV units.
    pub noise_floor: Option<f64>,
    /// Gap over PV's standard deviation.
    pub relative: Option<f64>,
}

/// One effect as fitted.
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
    /// Effects that it cannot be told from.
    #[serde(default)]
    pub confusable_with: Vec<String>,
    /// Whether its fit is at the noise floor on the training blocks.
    #[serde(default)]
    pub at_floor: Option<bool>,
}

/// The part of a gap document that is scored.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Document {
    /// The cause.
    pub cause: Called,
    /// What is named beside it.
    #[serde(default)]
    pub second_cause: Option<Alternative>,
    /// Stage of the cause.
    #[serde(rename = "where")]
    pub place: Place,
    /// Other answers, best first.
    pub alternatives: Vec<Alternative>,
    /// The base's gap.
    pub gap: Gap,
    /// Effects, best first.
    pub effects: Vec<EffectAnswer>,
}

/// Where the gap lies.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Place {
    /// Stage.
    pub stage: String,
}

/// The answer with one effect taken out of the catalogue.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Withheld {
    /// The effect.
    pub without: String,
    /// What is called then.
    pub cause: Called,
}

/// All that was answered for a recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// The recording.
    pub recording: String,
    /// The document; none where the diagnosis failed.
    pub document: Option<Document>,
    /// Whether the base's training error is at the noise floor.
    #[serde(default)]
    pub base_at_floor: Option<bool>,
    /// Why it failed.
    #[serde(default)]
    pub error: Option<String>,
    /// One entry an effect of the catalogue.
    #[serde(default)]
    pub withheld: Vec<Withheld>,
}
