//! The sizes of an effect: with their units, as documents have them, and in figures for its words.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::effects;
use super::types::Parameter;
use crate::core::units::number;

/// A number with a unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Quantity {
    /// The value.
    pub value: f64,
    /// Its unit, as that of the parameter.
    pub unit: String,
}

/// The sizes of an effect or pair of this id by their names.
#[must_use]
pub(super) fn sized(id: &str, parameters: Vec<Parameter>) -> BTreeMap<String, Quantity> {
    let mut out = BTreeMap::new();
    for Parameter { name, value, unit } in parameters {
        // Both effects of a pair may have one of this name: the second's says whose it is.
        let second = effects::parts(id).last().unwrap_or_default();
        let name = if out.contains_key(name) { format!("{second}.{name}") } else { name.to_owned() };
        out.insert(name, Quantity { value, unit: unit.to_owned() });
    }
    out
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

/// Share of PV's deviation that base and named effect leave on held-out data; above 1 PV's mean leaves less.
pub(super) fn share_left(relative_gap: f64, base_gap: f64, given_gap: Option<f64>, closed_pct: Option<f64>) -> f64 {
    // A given model may be better than the refitted one on the held-out blocks.
    let given = given_gap.map_or(1.0, |given| (given / base_gap).min(1.0));
    relative_gap * given.min(1.0 - 0.01 * closed_pct.unwrap_or(0.0).max(0.0))
}

/// A share in figures.
pub(crate) fn percent(value: f64) -> String {
    format!("{value:.0} %")
}
