//! A model of a loop's valve and process that can be saved, loaded and simulated.

use serde::{Deserialize, Serialize};

use crate::core::sim::process::ProcessModel;

/// Schema of the document.
pub const SCHEMA: &str = "stictiond.model.v1";

/// The valve.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Valve {
    /// `he`, `tracking` or `none`.
    pub law: String,
    /// Static band, OP units.
    pub fs: f64,
    /// Kinetic band, OP units; negative if the stem overshoots.
    pub fd: f64,
    /// Stem position before the record, OP units; `None` if unknown.
    #[serde(default)]
    pub stem0: Option<f64>,
}

/// The process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Process {
    /// PV units per OP unit (and per second, if integrating).
    pub gain: f64,
    /// Time constants, s, largest first.
    pub time_constants_s: Vec<f64>,
    /// Dead time, s.
    pub dead_time_s: f64,
    /// Integrating instead of self-regulating.
    #[serde(default)]
    pub integrating: bool,
    /// OP (behind the valve) at which PV is `pv`.
    pub op: f64,
    /// PV at rest with the valve at `op`.
    pub pv: f64,
}

impl Process {
    /// Time in which it answers a step: dead time and time constants, s.
    #[must_use]
    pub(crate) fn answer_s(&self) -> f64 {
        self.dead_time_s + self.time_constants_s.iter().sum::<f64>()
    }

    /// The same with times in points that are so many seconds apart.
    #[must_use]
    pub(crate) fn in_points(&self, point_s: f64) -> ProcessModel {
        let mut taus = self.time_constants_s.iter().map(|tau| tau / point_s);
        ProcessModel {
            gain: if self.integrating { self.gain * point_s } else { self.gain },
            tau: taus.next().unwrap_or(0.0),
            tau2: taus.next().unwrap_or(0.0),
            dead_time: self.dead_time_s / point_s,
            integrating: self.integrating,
        }
    }
}

/// An effect in addition to valve and process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Added {
    /// Its id.
    pub id: String,
    /// Its parameters by name, in the units of the catalogue.
    pub parameters: std::collections::BTreeMap<String, f64>,
}

/// A loop's model, in recorded units.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Model {
    /// [`SCHEMA`].
    pub schema: String,
    /// Sampling time of the fitted record, s.
    pub ts_s: f64,
    /// The valve.
    pub valve: Valve,
    /// The process.
    pub process: Process,
    /// Additional effects.
    #[serde(default)]
    pub effects: Vec<Added>,
}

/// A fault in a model.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ModelError {
    /// A number out of range.
    #[error("{name} is {value}, but must be {want}")]
    Range {
        /// Name of the number.
        name: &'static str,
        /// Its value.
        value: f64,
        /// Its range.
        want: &'static str,
    },
    /// A missing parameter of an effect.
    #[error("the effect {effect} lacks its parameter {name}")]
    Missing {
        /// Its id.
        effect: String,
        /// The parameter.
        name: &'static str,
    },
    /// An unknown word.
    #[error("{name} is {value:?}, but must be one of {want}")]
    Word {
        /// Name of the field.
        name: &'static str,
        /// As given.
        value: String,
        /// The valid words.
        want: &'static str,
    },
}

impl Model {
    /// Checks whether it can be simulated.
    ///
    /// # Errors
    /// The first number or word that is out of range.
    pub fn check(&self) -> Result<(), ModelError> {
        let (valve, process) = (&self.valve, &self.process);
        let mut numbers = vec![
            ("fs", valve.fs, valve.fs >= 0.0, "0 or more"),
            ("fd", valve.fd, valve.fd.abs() <= valve.fs, "at most fs in size"),
            ("gain", process.gain, process.gain != 0.0, "a number other than 0"),
            ("dead_time_s", process.dead_time_s, process.dead_time_s >= 0.0, "0 or more"),
        ];
        numbers.extend(process.time_constants_s.iter().map(|t| ("time_constants_s", *t, *t > 0.0, "greater than 0")));
        if let Some((name, value, _, want)) = numbers.into_iter().find(|(_, v, ok, _)| !ok || !v.is_finite()) {
            return Err(ModelError::Range { name, value, want });
        }
        if !process.integrating && process.time_constants_s.is_empty() {
            return Err(ModelError::Range { name: "time_constants_s", value: 0.0, want: "one or two numbers" });
        }
        if !["he", "tracking", "none"].contains(&valve.law.as_str()) {
            let value = valve.law.clone();
            return Err(ModelError::Word { name: "law", value, want: "he, tracking, none" });
        }
        Ok(())
    }
}

#[cfg(test)]
impl Model {
    /// He's model before a first-order process with one effect, for tests.
    pub(super) fn example(effect: Option<(&str, &[(&str, f64)])>) -> Self {
        let process = Process {
            gain: 1.5,
            time_constants_s: vec![20.0],
            dead_time_s: 4.5,
            integrating: false,
            op: 50.0,
            pv: 10.0,
        };
        let valve = Valve { law: "he".to_owned(), fs: 3.0, fd: 1.0, stem0: None };
        let added = |(id, numbers): (&str, &[(&str, f64)])| Added {
            id: id.to_owned(),
            parameters: numbers.iter().map(|(name, x)| ((*name).to_owned(), *x)).collect(),
        };
        Self { schema: SCHEMA.to_owned(), ts_s: 1.0, valve, process, effects: effect.map(added).into_iter().collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_reads_back_and_says_what_is_wrong_with_it() {
        let good = Model::example(None);
        assert_eq!(good.check(), Ok(()));
        let text = serde_json::to_string(&good).unwrap();
        assert_eq!(serde_json::from_str::<Model>(&text).unwrap(), good);
        let mut bad = good.clone();
        bad.valve.law = "kano".to_owned();
        assert!(bad.check().unwrap_err().to_string().contains("kano"));
        let mut bad = good;
        bad.process.dead_time_s = -1.0;
        assert_eq!(bad.check().unwrap_err().to_string(), "dead_time_s is -1, but must be 0 or more");
    }
}
