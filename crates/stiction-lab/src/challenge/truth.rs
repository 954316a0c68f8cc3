//! The sealed truth about each recording, a document whose SHA-256 is printed before the diagnosis.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use thiserror::Error;

use super::Split;
use super::generator::{Case, Order};
use super::kinds::Stage;

/// Name of the document.
pub const SCHEMA: &str = "stictiond.challenge.truth.v1";

/// A number with a unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Quantity {
    /// The number.
    pub value: f64,
    /// Its unit; empty for none.
    pub unit: String,
}

/// Type of the right answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Answer {
    /// No effect.
    None,
    /// An effect of the catalogue.
    Known,
    /// An effect outside the catalogue.
    Foreign,
    /// Two effects of the catalogue.
    Pair,
}

/// The truth about one recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TruthCase {
    /// Name of the recording.
    pub name: String,
    /// Type of the right answer.
    pub answer: Answer,
    /// The effect: an id, two joined by `+` (alphabetical), or `none`.
    pub effect: String,
    /// Its variant, if it has several (a lag of the process or of the sensor).
    pub form: Option<String>,
    /// Locations, one per effect.
    pub stages: Vec<String>,
    /// Whether a free run cannot predict it even if it is known.
    pub unpredictable: bool,
    /// `small`, `middle` or `large`; none without an effect.
    pub size: Option<String>,
    /// True sizes.
    pub parameters: BTreeMap<String, Quantity>,
    /// Standard deviation of the white measurement noise, PV units.
    pub noise_sd: f64,
    /// Standard deviation of PV without noise, PV units.
    pub pv_sd: f64,
    /// Whether the set point changes.
    pub setpoint_moves: bool,
    /// Whether the record includes the start of the cycle.
    pub transient: bool,
    /// Whether the valve position is recorded.
    pub mv: bool,
    /// Period, samples.
    pub period: f64,
    /// Static and kinetic band measured on the bench with the effect, upwards, OP units.
    pub fs: f64,
    /// See `fs`.
    pub fd: f64,
    /// Gain (PV units per OP unit), time constant and dead time (samples) of the process.
    pub gain: f64,
    /// See `gain`.
    pub tau: f64,
    /// See `gain`.
    pub dead_time: f64,
    /// Residual of a refitted first-order process behind the true base valve, root mean square, PV units.
    pub base_rmse: f64,
    /// Residual of the catalogue's form of the truth with the true sizes (gain and bias refitted), PV units; none if the
    /// catalogue has no such form or chance decides it.
    pub oracle_rmse: Option<f64>,
}

const SIZES: [&str; 3] = ["small", "middle", "large"];

impl TruthCase {
    pub(super) fn of(name: &str, order: &Order, case: &Case) -> Self {
        let ids: Vec<&str> = order.kinds.iter().map(|k| k.id()).collect();
        let answer = match order.kinds.as_slice() {
            [] => Answer::None,
            [one] if one.is_in_catalogue() => Answer::Known,
            [_] => Answer::Foreign,
            _ => Answer::Pair,
        };
        let quantity = |(name, value, unit): &(&str, f64, &str)| {
            ((*name).to_owned(), Quantity { value: *value, unit: (*unit).to_owned() })
        };
        let stages = if ids.is_empty() { vec!["none".to_owned()] } else { vec![] };
        let [fs, fd] = case.bands[0];
        Self {
            name: name.to_owned(),
            answer,
            effect: if ids.is_empty() { "none".to_owned() } else { ids.join("+") },
            form: case.made.form.map(str::to_owned),
            stages: stages.into_iter().chain(order.kinds.iter().map(|k| Stage::name(k.stage()).to_owned())).collect(),
            unpredictable: order.kinds.iter().any(|k| k.is_unpredictable()),
            size: (!ids.is_empty()).then(|| SIZES[order.size.min(2)].to_owned()),
            parameters: case.made.sizes.iter().map(quantity).collect(),
            noise_sd: case.noise_sd,
            pv_sd: case.pv_sd,
            setpoint_moves: order.setpoint_moves,
            transient: order.transient,
            mv: order.mv,
            period: case.period,
            fs,
            fd,
            gain: case.made.plant.process.gain,
            tau: case.made.plant.process.tau,
            dead_time: case.made.plant.process.dead_time,
            base_rmse: case.base_rmse,
            oracle_rmse: order.kinds.iter().all(|k| k.is_in_catalogue()).then_some(case.oracle_rmse),
        }
    }

    /// Noise relative to PV's spread without noise.
    #[must_use]
    pub fn noise_share(&self) -> f64 {
        self.noise_sd / self.pv_sd
    }
}

/// The document.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// [`SCHEMA`].
    pub schema: String,
    /// Version of the generator.
    pub version: String,
    /// Seed of all draws.
    pub seed: u64,
    /// `A` or `B`.
    pub split: String,
    /// Cases per effect.
    pub cases_per_effect: usize,
    /// One per recording, in their order.
    pub cases: Vec<TruthCase>,
}

/// A truth that cannot be opened.
#[derive(Debug, Error)]
pub enum Tampered {
    /// Its SHA-256 is not the one that was printed.
    #[error(
        "the truth's SHA-256 is {found}, but {sealed} was sealed: the truth was changed after the challenge was made; make a new challenge"
    )]
    Digest {
        /// SHA-256 of the file.
        found: String,
        /// SHA-256 when sealed.
        sealed: String,
    },
    /// Not a truth document.
    #[error("cannot parse the truth: {0}; make the challenge again with this version")]
    Unreadable(#[from] serde_json::Error),
    /// A document of another kind or version.
    #[error("the truth is a {found:?}, but this version reads {SCHEMA:?}; make a new challenge")]
    Schema {
        /// Its schema.
        found: String,
    },
}

/// SHA-256 of a truth's bytes, in hexadecimal.
#[must_use]
pub fn seal(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}

impl Truth {
    pub(super) fn new(seed: u64, split: Split, cases_per_effect: usize, cases: Vec<TruthCase>) -> Self {
        let (schema, version) = (SCHEMA.to_owned(), stiction::core::VERSION.to_owned());
        Self { schema, version, seed, split: split.name().to_owned(), cases_per_effect, cases }
    }

    /// Its bytes when sealed.
    ///
    /// # Errors
    /// A number that JSON cannot represent, which no case has.
    pub fn to_bytes(&self) -> Result<Vec<u8>, serde_json::Error> {
        let mut bytes = serde_json::to_vec_pretty(self)?;
        bytes.push(b'\n');
        Ok(bytes)
    }

    /// Opens a truth if its seal matches.
    ///
    /// # Errors
    /// [`Tampered`] with both digests, or the fault in the document.
    pub fn open(bytes: &[u8], sealed: &str) -> Result<Self, Tampered> {
        let (found, sealed) = (seal(bytes), sealed.trim().to_ascii_lowercase());
        if found != sealed {
            return Err(Tampered::Digest { found, sealed });
        }
        let truth: Self = serde_json::from_slice(bytes)?;
        if truth.schema != SCHEMA {
            return Err(Tampered::Schema { found: truth.schema });
        }
        Ok(truth)
    }
}
