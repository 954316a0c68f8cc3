//! What is said of the valve itself, in the words that `analyze` has for the same record.

use serde::{Deserialize, Serialize};

use crate::core::verdict::bump_test::{self, Refusal};
use crate::core::verdict::headline::headline;
use crate::core::verdict::{Assessment, ValvePosition, answer};

/// The valve of a diagnosed record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ValveNote {
    /// The first sentence of `analyze`, without its full stop.
    pub sentence: String,
    /// Whether the valve sticks; `None` where that is not known.
    pub sticks: Option<bool>,
    /// Probability that it does.
    pub p_stiction: Option<f64>,
    /// Dead band plus stick band, OP units, where it sticks.
    pub s: Option<f64>,
    /// The same in words, with its interval.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub size: Option<String>,
    /// Period of its limit cycle, s: that of the regular oscillation of a valve that sticks.
    pub cycle_s: Option<f64>,
    /// Why no bump test is proposed for it, where it sticks and none is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub no_bump_test: Option<String>,
    /// What the recorded valve position shows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position: Option<ValvePosition>,
}

impl ValveNote {
    /// By the assessment of the same record.
    #[must_use]
    pub(crate) fn of(a: &Assessment) -> Self {
        let sticks = a.stiction == Some(true);
        let refusal = || bump_test::bump_test(a).err().filter(|why| *why != Refusal::NoSize);
        Self {
            sentence: headline(a),
            sticks: a.stiction,
            p_stiction: a.p_stiction,
            s: a.s.filter(|_| sticks),
            size: answer::size(a).filter(|_| sticks),
            cycle_s: a.oscillation.period_s.filter(|_| sticks && a.oscillation.oscillating),
            no_bump_test: sticks.then(refusal).flatten().map(|why| why.words()),
            position: a.valve_position,
        }
    }

    /// Whether it sticks.
    #[must_use]
    pub(crate) fn does_stick(&self) -> bool {
        self.sticks == Some(true)
    }

    /// The sentence, with the size where the valve sticks.
    #[must_use]
    pub fn title(&self) -> String {
        let size = self.size.as_ref().map_or_else(String::new, |size| format!(", s = {size}"));
        format!("{}{size}", self.sentence)
    }
}
