//! A model of a loop's valve and process that can be written down, read back and simulated.

use serde::{Deserialize, Serialize};

/// Schema of the document.
pub const SCHEMA: &str = "stictiond.model.v1";

/// The valve.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Valve {
    /// `he`, `tracking` or `none`.
    pub law: String,
    /// Static band, OP units.
    pub fs: f64,
    /// Kinetic band, OP units; negative where the stem overshoots.
    pub fd: f64,
    /// Stem position before the record, OP units; `None` where it is not known.
    #[serde(default)]
    pub stem0: Option<f64>,
}

/// The process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Process {
    /// PV units an OP unit (and a second, when integrating).
    pub gain: f64,
    /// Time constants, s, largest first.
    pub time_constants_s: Vec<f64>,
    /// Dead time, s.
    pub dead_time_s: f64,
    /// Integrates instead of settling.
    #[serde(default)]
    pub integrating: bool,
    /// OP (behind the valve) at which PV is `pv`.
    pub op: f64,
    /// PV at rest with the valve at `op`.
    pub pv: f64,
}

/// An effect beside valve and process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Added {
    /// Its id.
    pub id: String,
    /// Its parameters by name, in the units that the catalogue gives.
    pub parameters: std::collections::BTreeMap<String, f64>,
}

/// A loop's model, in recorded units.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Model {
    /// [`SCHEMA`].
    pub schema: String,
    /// Sampling time it was fitted at, s.
    pub ts_s: f64,
    /// The valve.
    pub valve: Valve,
    /// The process.
    pub process: Process,
    /// Effects beside them.
    #[serde(default)]
    pub effects: Vec<Added>,
}

/// What is wrong with a model.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ModelError {
    /// A number out of its range.
    #[error("{name} is {value}, but must be {want}")]
    Range {
        /// Which.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        want: &'static str,
    },
    /// A word that is none of those known.
    #[error("{name} is {value:?}, but must be one of {want}")]
    Word {
        /// Which.
        name: &'static str,
        /// As given.
        value: String,
        /// The words.
        want: &'static str,
    },
}
