//! The sizes of an effect: with their units, as documents have them, and in figures for its words.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::units::number;

/// A number with a unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Quantity {
    /// The value.
    pub value: f64,
    /// Its unit, as that of the parameter.
    pub unit: String,
}

/// An effect's sizes, for its words.
#[derive(Debug)]
pub struct Sizes<'n>(pub &'n BTreeMap<String, Quantity>);

impl Sizes<'_> {
    /// A size.
    #[must_use]
    pub(crate) fn value(&self, name: &str) -> Option<f64> {
        self.0.get(name).map(|q| q.value)
    }

    /// A size in figures.
    #[must_use]
    pub(crate) fn said(&self, name: &str) -> Option<String> {
        self.value(name).map(number)
    }

    /// The amount of a change as per cent.
    #[must_use]
    pub(crate) fn percent(&self, change: f64) -> String {
        percent(100.0 * change.abs())
    }
}

/// A share in figures.
pub(super) fn percent(value: f64) -> String {
    format!("{value:.0} %")
}
