//! Model files: an estimate, the model of a diagnosis, or a few numbers written by hand.

use std::collections::BTreeMap;

use serde_json::{Map, Value};

use super::document::GAP_SCHEMA;
use super::model::{Added, Model, Process, SCHEMA, Valve};
use crate::core::ident::ESTIMATE_SCHEMA;
use crate::core::record::Record;
use crate::core::signal::stats;

/// Valve models.
const LAWS: [&str; 3] = ["he", "tracking", "none"];

/// A fault in a model file.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ModelFileError {
    /// Not JSON.
    #[error("not JSON ({0}); a model is a JSON document, such as `stictiond analyze --format json` prints")]
    Json(String),
    /// JSON of another kind.
    #[error(
        "the document is a {found:?}; use a {ESTIMATE_SCHEMA}, {GAP_SCHEMA} or {SCHEMA}, or a plain object with fs, fd and \
         process {{gain, time_constants_s, dead_time_s}}"
    )]
    Schema {
        /// Its schema.
        found: String,
    },
    /// A missing or wrong field.
    #[error("{field} {problem}")]
    Field {
        /// Its path, such as `process.gain`.
        field: String,
        /// The fault.
        problem: String,
    },
}

/// A parsed model; a record may have to add values.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelFile {
    valve: Valve,
    gain: f64,
    time_constants_s: Vec<f64>,
    dead_time_s: f64,
    integrating: bool,
    /// Valve position and corresponding PV at rest; estimates do not have them.
    rest: Option<[f64; 2]>,
    ts_s: Option<f64>,
    effects: Vec<Added>,
}

/// An object and the path to it.
struct Object<'a> {
    map: &'a Map<String, Value>,
    path: String,
}

impl<'a> Object<'a> {
    fn field(&self, name: &str) -> String {
        if self.path.is_empty() { name.to_owned() } else { format!("{}.{name}", self.path) }
    }

    fn wrong(&self, name: &str, problem: impl Into<String>) -> ModelFileError {
        ModelFileError::Field { field: self.field(name), problem: problem.into() }
    }

    /// A value, unless it is missing or null.
    fn get(&self, name: &str) -> Option<&'a Value> {
        self.map.get(name).filter(|v| !v.is_null())
    }

    fn object(&self, name: &str) -> Result<Option<Self>, ModelFileError> {
        match self.get(name) {
            None => Ok(None),
            Some(Value::Object(map)) => Ok(Some(Self { map, path: self.field(name) })),
            Some(other) => Err(self.wrong(name, format!("is {other}, but must be an object"))),
        }
    }

    fn number(&self, name: &str) -> Result<Option<f64>, ModelFileError> {
        match self.get(name) {
            None => Ok(None),
            Some(value) => match value.as_f64() {
                Some(number) => Ok(Some(number)),
                None => Err(self.wrong(name, format!("is {value}, but must be a number"))),
            },
        }
    }

    fn needed(&self, name: &str) -> Result<f64, ModelFileError> {
        self.number(name)?.ok_or_else(|| self.wrong(name, "is missing"))
    }

    fn flag(&self, name: &str) -> Result<bool, ModelFileError> {
        match self.get(name) {
            None => Ok(false),
            Some(Value::Bool(flag)) => Ok(*flag),
            Some(other) => Err(self.wrong(name, format!("is {other}, but must be true or false"))),
        }
    }

    fn word(&self, name: &str) -> Result<Option<&'a str>, ModelFileError> {
        match self.get(name) {
            None => Ok(None),
            Some(Value::String(word)) => Ok(Some(word)),
            Some(other) => Err(self.wrong(name, format!("is {other}, but must be a word"))),
        }
    }
}

impl ModelFile {
    /// Parses a model.
    ///
    /// # Errors
    /// Names the missing or wrong field.
    pub fn parse(text: &str) -> Result<Self, ModelFileError> {
        // Several documents, one a line: the first one counts.
        let whole: Result<Value, serde_json::Error> = serde_json::from_str(text);
        let first = whole.or_else(|e| serde_json::from_str(text.lines().next().unwrap_or("")).map_err(|_| e));
        let value: Value = first.map_err(|e| ModelFileError::Json(e.to_string()))?;
        let Value::Object(map) = &value else {
            return Err(ModelFileError::Schema { found: "document without fields".to_owned() });
        };
        let top = Object { map, path: String::new() };
        match top.word("schema")? {
            Some(GAP_SCHEMA) => {
                let after = top.object("model_after")?.ok_or_else(|| top.wrong("model_after", "is missing"))?;
                Self::of_parts(&after)
            }
            Some(SCHEMA) => Self::of_parts(&top),
            Some(ESTIMATE_SCHEMA) => Self::of_estimate(&top),
            None if top.get("valve").is_some() => Self::of_parts(&top),
            None => Self::of_estimate(&top),
            Some(found) => Err(ModelFileError::Schema { found: found.to_owned() }),
        }
    }

    /// `valve` and `process` with all their fields.
    fn of_parts(o: &Object<'_>) -> Result<Self, ModelFileError> {
        let valve = o.object("valve")?.ok_or_else(|| o.wrong("valve", "is missing"))?;
        let law = valve.word("law")?.unwrap_or("he");
        let valve = read_valve(&valve, "law", law)?;
        let process = o.object("process")?.ok_or_else(|| o.wrong("process", "is missing"))?;
        Self::with(o, valve, &process)
    }

    /// The numbers of an estimate.
    fn of_estimate(o: &Object<'_>) -> Result<Self, ModelFileError> {
        let process = o.object("process")?.ok_or_else(|| {
            let why = if o.get("gates").is_some() { ": this window was not fitted" } else { "" };
            o.wrong("process", format!("is missing{why}"))
        })?;
        let law = o.word("valve_model")?.unwrap_or("he");
        let valve = read_valve(o, "valve_model", law)?;
        let window = o.object("window")?;
        let mut read = Self::with(o, valve, &process)?;
        if let Some(window) = window {
            read.ts_s = window.number("ts_s")?.or(read.ts_s);
        }
        Ok(read)
    }

    fn with(o: &Object<'_>, valve: Valve, process: &Object<'_>) -> Result<Self, ModelFileError> {
        let gain = process.needed("gain")?;
        if gain == 0.0 || !gain.is_finite() {
            return Err(process.wrong("gain", format!("is {gain}, but must not be 0")));
        }
        let dead_time_s = process.needed("dead_time_s")?;
        if !(0.0..1e9).contains(&dead_time_s) {
            return Err(process.wrong("dead_time_s", format!("is {dead_time_s}, but must be 0 or more")));
        }
        let integrating = process.flag("integrating")?;
        Ok(Self {
            valve,
            gain,
            time_constants_s: time_constants(process, integrating)?,
            dead_time_s,
            integrating,
            rest: process.number("op")?.zip(process.number("pv")?).map(|(op, pv)| [op, pv]),
            ts_s: o.number("ts_s")?.filter(|ts| *ts > 0.0),
            effects: effects(o)?,
        })
    }

    /// The model for a record; without an operating point in the file, the means of OP and PV are used.
    #[must_use]
    pub fn on(&self, record: &Record) -> Model {
        let [op, pv] = self.rest.unwrap_or_else(|| [stats::mean(&record.op()), stats::mean(&record.pv)]);
        Model {
            schema: SCHEMA.to_owned(),
            ts_s: self.ts_s.unwrap_or(record.ts_s),
            valve: self.valve.clone(),
            process: Process {
                gain: self.gain,
                time_constants_s: self.time_constants_s.clone(),
                dead_time_s: self.dead_time_s,
                integrating: self.integrating,
                op,
                pv,
            },
            effects: self.effects.clone(),
        }
    }
}

fn read_valve(o: &Object<'_>, law_field: &str, law: &str) -> Result<Valve, ModelFileError> {
    if !LAWS.contains(&law) {
        return Err(o.wrong(law_field, format!("is {law:?}, but must be one of {}", LAWS.join(", "))));
    }
    let band = |name: &str| if law == "none" { Ok(o.number(name)?.unwrap_or(0.0)) } else { o.needed(name) };
    let (fs, fd) = (band("fs")?, band("fd")?);
    if !(0.0..1e12).contains(&fs) {
        return Err(o.wrong("fs", format!("is {fs}, but must be 0 or more")));
    }
    if fd.abs() > fs {
        return Err(o.wrong("fd", format!("is {fd}, but must be between -fs and fs, and fs is {fs}")));
    }
    Ok(Valve { law: law.to_owned(), fs, fd, stem0: o.number("stem0")? })
}

fn time_constants(process: &Object<'_>, integrating: bool) -> Result<Vec<f64>, ModelFileError> {
    let name = "time_constants_s";
    let wrong = |problem: String| process.wrong(name, problem);
    let list = match process.get(name) {
        None if integrating => return Ok(Vec::new()),
        None => return Err(wrong("is missing".to_owned())),
        Some(Value::Array(list)) => list,
        Some(other) => return Err(wrong(format!("is {other}, but must be a list of seconds"))),
    };
    let numbers: Option<Vec<f64>> = list.iter().map(Value::as_f64).collect();
    let good = |t: &f64| t.is_finite() && *t > 0.0;
    match numbers {
        Some(numbers) if numbers.iter().all(good) && numbers.len() <= 2 && (integrating || !numbers.is_empty()) => {
            Ok(numbers)
        }
        _ => Err(wrong(format!("is {}, but must be one or two numbers above 0", Value::Array(list.clone())))),
    }
}

fn effects(o: &Object<'_>) -> Result<Vec<Added>, ModelFileError> {
    let Some(list) = o.get("effects") else { return Ok(Vec::new()) };
    let Value::Array(list) = list else { return Err(o.wrong("effects", "must be a list")) };
    let one = |(i, value): (usize, &Value)| {
        let path = o.field(&format!("effects[{i}]"));
        let Value::Object(map) = value else {
            return Err(ModelFileError::Field { field: path, problem: "must be an object".to_owned() });
        };
        let item = Object { map, path };
        let id = item.word("id")?.ok_or_else(|| item.wrong("id", "is missing"))?.to_owned();
        let mut parameters = BTreeMap::new();
        if let Some(given) = item.object("parameters")? {
            for name in given.map.keys() {
                parameters.insert(name.clone(), given.needed(name)?);
            }
        }
        Ok(Added { id, parameters })
    };
    list.iter().enumerate().map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record() -> Record {
        Record::uniform(2.0, vec![40.0, 60.0], vec![1.0, 3.0])
    }

    fn plain() -> Value {
        serde_json::json!({"fs": 3.0, "fd": 1.0, "process": {"gain": -2.0, "time_constants_s": [20.0], "dead_time_s": 4.0}})
    }

    #[test]
    fn a_plain_model_an_estimate_and_a_diagnosis_give_the_same_model() {
        let from_plain = ModelFile::parse(&plain().to_string()).unwrap().on(&record());
        assert_eq!((from_plain.process.op, from_plain.process.pv, from_plain.ts_s), (50.0, 2.0, 2.0));
        let mut estimate = plain();
        estimate["schema"] = ESTIMATE_SCHEMA.into();
        estimate["valve_model"] = "he".into();
        estimate["window"] = serde_json::json!({"ts_s": 2.0});
        assert_eq!(ModelFile::parse(&estimate.to_string()).unwrap().on(&record()), from_plain);
        let diagnosis = serde_json::json!({"schema": GAP_SCHEMA, "model_after": from_plain});
        assert_eq!(ModelFile::parse(&diagnosis.to_string()).unwrap().on(&record()), from_plain);
        let own = serde_json::to_string(&from_plain).unwrap();
        assert_eq!(ModelFile::parse(&own).unwrap().on(&record()), from_plain);
        // Two documents, one a line: the first counts.
        assert!(ModelFile::parse(&format!("{own}\n{own}\n")).is_ok());
    }

    #[test]
    fn errors_name_the_field_and_what_it_must_be() {
        let with = |path: &[&str], value: Value| {
            let mut v = plain();
            let (last, way) = path.split_last().unwrap();
            way.iter().fold(&mut v, |v, key| &mut v[*key])[*last] = value;
            ModelFile::parse(&v.to_string()).map(|_| ()).unwrap_err().to_string()
        };
        assert_eq!(with(&["process", "gain"], Value::Null), "process.gain is missing");
        assert_eq!(with(&["process", "gain"], "two".into()), "process.gain is \"two\", but must be a number");
        assert!(with(&["process", "gain"], 0.0.into()).starts_with("process.gain is 0"));
        assert!(with(&["process", "time_constants_s"], 5.0.into()).contains("a list of seconds"));
        assert!(
            with(&["process", "time_constants_s"], serde_json::json!([-5.0])).starts_with("process.time_constants_s")
        );
        assert!(with(&["process", "dead_time_s"], (-1.0).into()).contains("0 or more"));
        assert!(with(&["fd"], 4.0.into()).contains("fs is 3"));
        assert!(with(&["valve_model"], "kano".into()).contains("he, tracking, none"));
        assert!(with(&["process"], Value::Null).contains("process is missing"));
        assert!(with(&["schema"], "stictiond.alarm.v1".into()).contains("stictiond.alarm.v1"));
        assert!(with(&["effects"], serde_json::json!([{}])).contains("effects[0].id is missing"));
        assert!(matches!(ModelFile::parse("{"), Err(ModelFileError::Json(_))));
        assert!(matches!(ModelFile::parse("[1]"), Err(ModelFileError::Schema { .. })));
    }
}
