//! What an effect of a model is in a closed loop's simulation, or why it has no place there.

use super::model::{Added, Model};
use crate::core::sim::actuator::Actuator;
use crate::core::sim::disturbance::Disturbance;
use crate::core::sim::slips::Stroke;

/// What a model's effects are in a closed loop's simulation, beside what its law, process and time constants say.
#[derive(Debug, Clone, PartialEq)]
pub struct Parts {
    /// Of the stem's own motion.
    pub stroke: Stroke,
    /// The parts before and behind the stem.
    pub actuator: Actuator,
    /// At the process' input, OP units; times count from the record's start.
    pub load: Vec<Disturbance>,
    /// On PV, PV units.
    pub on_pv: Vec<Disturbance>,
}

/// Why an effect of a model has no place in a closed loop's simulation.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NoPlace {
    /// It is not in the stem, around it, or a load.
    #[error(
        "{0:?} acts inside the process or the historian and cannot be simulated in the loop; remove it from the model"
    )]
    Inside(String),
    /// A number that it needs is missing or out of range.
    #[error("{effect:?} needs {parameter} as a number{want} to be simulated")]
    Number {
        /// The effect.
        effect: String,
        /// Its parameter.
        parameter: &'static str,
        /// What it may be.
        want: &'static str,
    },
    /// What drives the stem is run in parts of a scan, a stem with a motion of its own in scans.
    #[error("a lag before the stem cannot be combined with an effect on the stem's motion; remove one from the model")]
    Clash,
}

/// An effect of a model with its numbers as stated, for a simulation in scans of `ts_s`.
#[derive(Debug)]
pub struct Stated<'m> {
    /// The model.
    pub model: &'m Model,
    /// The effect.
    pub(super) added: &'m Added,
    /// Duration of a scan, s.
    pub ts_s: f64,
}

impl Stated<'_> {
    /// The effect's id.
    #[must_use]
    pub(crate) fn id(&self) -> &str {
        &self.added.id
    }

    fn stated(&self, name: &str) -> Option<f64> {
        self.added.parameters.get(name).copied().filter(|x| x.is_finite())
    }

    /// What to say of a number that is missing or out of range.
    #[must_use]
    pub(crate) fn wrong(&self, parameter: &'static str, want: &'static str) -> NoPlace {
        NoPlace::Number { effect: self.added.id.clone(), parameter, want }
    }

    /// A number.
    ///
    /// # Errors
    /// Where it is missing.
    pub(crate) fn number(&self, name: &'static str) -> Result<f64, NoPlace> {
        self.stated(name).ok_or_else(|| self.wrong(name, ""))
    }

    /// A number above 0.
    ///
    /// # Errors
    /// Where it is missing or not above 0.
    pub(crate) fn above_zero(&self, name: &'static str) -> Result<f64, NoPlace> {
        self.stated(name).filter(|x| *x > 0.0).ok_or_else(|| self.wrong(name, " above 0"))
    }

    /// A number that may be left out: mass and drag are, where there is none.
    #[must_use]
    pub(crate) fn or_zero(&self, name: &str) -> f64 {
        self.stated(name).unwrap_or(0.0)
    }

    /// Whether it is said to be so: what is not said to be so is not so.
    #[must_use]
    pub(crate) fn is(&self, name: &str) -> bool {
        self.or_zero(name) > 0.5
    }
}
