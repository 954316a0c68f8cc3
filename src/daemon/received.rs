//! Reads published documents back into their types, so that a reader elsewhere on the bus describes them as the daemon would.
//!
//! Only what tables and texts need is read; parts for programs (controller, search) are left out. Fields may be missing, of a
//! newer version, or forged: what cannot be read counts as null.

use serde::de::DeserializeOwned;
use serde_json::Value;

use stiction::core::detect::Indicator;
use stiction::core::units::Moment;
use stiction::core::verdict::prevalence::CALIBRATED_FOR;
use stiction::core::verdict::{Assessment, ESTIMATE_SCHEMA, EstimateDocument, Oscillation, Window, features, reasons};
use stiction_engine::alarm::{ALARM_SCHEMA, AlarmDocument, Figures, Marks};

/// NE 107 categories of an alarm.
const NE107: [&str; 6] = ["none", "ok", "M", "C", "S", "F"];
/// Stands for a word that this version does not know.
const UNKNOWN: &str = "other";

fn read<T: DeserializeOwned>(document: &Value, field: &str) -> Option<T> {
    T::deserialize(document.get(field)?).ok()
}

/// The items of a list that can be read.
fn each<T: DeserializeOwned>(document: &Value, field: &str) -> Vec<T> {
    let list = document.get(field).and_then(Value::as_array);
    list.into_iter().flatten().filter_map(|item| T::deserialize(item).ok()).collect()
}

/// Fields of a nested type that are flattened into the document.
fn whole<T: DeserializeOwned + Default>(document: &Value) -> T {
    T::deserialize(document).unwrap_or_default()
}

/// A word of this build's list, or [`UNKNOWN`].
fn word(document: &Value, field: &str, mut known: impl Iterator<Item = &'static str>) -> Option<&'static str> {
    let text = document.get(field)?.as_str()?;
    Some(known.find(|k| *k == text).unwrap_or(UNKNOWN))
}

fn window(document: &Value) -> Option<Window> {
    let of = document.get("window")?;
    let (start_ns, end_ns) = (read(of, "start_ns")?, read(of, "end_ns")?);
    Some(Window {
        start_ns,
        end_ns,
        start: Moment(start_ns),
        end: Moment(end_ns),
        samples: read(of, "samples").unwrap_or(0),
        ts_s: read(of, "ts_s").unwrap_or(f64::NAN),
        box_samples: read(of, "box_samples").unwrap_or(1),
    })
}

fn indicator(of: &Value) -> Option<Indicator> {
    let contribution = read(of, "contribution").unwrap_or(0.0);
    Some(Indicator {
        name: word(of, "name", features::names())?,
        score: read(of, "score"),
        vote: read(of, "vote"),
        contribution,
    })
}

/// An estimate (`stictiond.estimate.v1`); `None` if it is another document or lacks the loop or the window.
#[must_use]
pub fn estimate(document: &Value) -> Option<EstimateDocument> {
    let d = document;
    if d.get("schema")?.as_str()? != ESTIMATE_SCHEMA {
        return None;
    }
    let silent =
        Oscillation { oscillating: false, period_s: None, periods: None, samples_per_period: None, regularity: None };
    let assessment = Assessment {
        verdict: read(d, "verdict")?,
        contributing: each(d, "contributing"),
        missing: each(d, "missing"),
        stiction: read(d, "stiction"),
        reason: word(d, "reason", reasons()),
        p_stiction: read(d, "p_stiction"),
        // Before the prevalence was added, documents had only the calibrated probability, as `p_stiction`.
        p_calibrated: read(d, "p_calibrated").or_else(|| read(d, "p_stiction")),
        prevalence: read(d, "prevalence").unwrap_or(CALIBRATED_FOR),
        confidence: read(d, "confidence"),
        gates: each(d, "gates"),
        implausible: each(d, "implausible"),
        grade: read(d, "grade"),
        fs: read(d, "fs"),
        fd: read(d, "fd"),
        s: read(d, "s"),
        j: read(d, "j"),
        fs_interval: read(d, "fs_interval"),
        fd_interval: read(d, "fd_interval"),
        s_interval: read(d, "s_interval"),
        j_interval: read(d, "j_interval"),
        s_thirds: each(d, "s_thirds"),
        interval_level: read(d, "interval_level"),
        j_identifiable: read(d, "j_identifiable"),
        s_detectable: read(d, "s_detectable"),
        counted_by: read(d, "counted_by"),
        reversals: read(d, "reversals"),
        stiction_index: read(d, "stiction_index"),
        s_over_span: read(d, "s_over_span"),
        region: read(d, "region"),
        strength_by_span: read(d, "strength_by_span"),
        severity_by_range: read(d, "severity_by_range"),
        op_range: read(d, "op_range"),
        op_unit: read(d, "op_unit"),
        valve_model: read(d, "valve_model"),
        process: read(d, "process"),
        pv_span: read(d, "pv_span"),
        indicators: d["indicators"].as_array().into_iter().flatten().filter_map(indicator).collect(),
        explanation: read(d, "explanation"),
        ..Assessment::empty(window(d)?, read(d, "oscillation").unwrap_or(silent))
    };
    let config_hash: String = read(d, "config_hash").unwrap_or_default();
    let document = EstimateDocument::new(d.get("loop")?.as_str()?, &config_hash, assessment);
    Some(EstimateDocument { group: read(d, "group"), daemon: read(d, "daemon"), ..document })
}

/// An alarm (`stictiond.alarm.v2`); `None` if it is another document or lacks loop, state or time.
#[must_use]
pub fn alarm(document: &Value) -> Option<AlarmDocument> {
    let d = document;
    if d.get("schema")?.as_str()? != ALARM_SCHEMA {
        return None;
    }
    Some(AlarmDocument {
        action: None,
        schema: ALARM_SCHEMA,
        loop_name: read(d, "loop")?,
        alarm: word(d, "alarm", ["stiction"].into_iter())?,
        event_id: read(d, "event_id").unwrap_or_default(),
        occurrence_id: read(d, "occurrence_id"),
        event: read(d, "event")?,
        state: read(d, "state")?,
        active: read(d, "active")?,
        priority: read(d, "priority"),
        criticality: read(d, "criticality"),
        area: read(d, "area"),
        equipment: read(d, "equipment"),
        ne107: word(d, "ne107", NE107.into_iter())?,
        class: read(d, "class"),
        unit: read(d, "unit").unwrap_or_default(),
        figures: whole::<Figures>(d),
        why: read(d, "why"),
        what_to_do: read(d, "what_to_do"),
        since_ns: read(d, "since_ns"),
        since: read(d, "since"),
        changed_ns: read(d, "changed_ns")?,
        changed: read(d, "changed").unwrap_or_default(),
        by: read(d, "by"),
        detail: read(d, "detail").unwrap_or_default(),
        marks: whole::<Marks>(d),
        daemon: read(d, "daemon"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction_files::RecordingReader;

    /// Every estimate and alarm of the shipped recordings is the same after reading it back, except for the omitted parts.
    #[test]
    fn documents_read_back_are_those_that_were_written() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings");
        let (mut estimates, mut alarms) = (0, 0);
        for file in ["four-loops.mcap", "sticking.mcap", "awkward.mcap"] {
            let mut reader = RecordingReader::open(&folder.join(file)).unwrap();
            while let Some(message) = reader.next_message().unwrap() {
                let leaf = message.topic().rsplit('/').next().unwrap().to_owned();
                let Ok(mut written) = serde_json::from_slice::<Value>(message.data) else { continue };
                let again = match leaf.as_str() {
                    "estimate" => {
                        estimates += 1;
                        for left_out in ["controller", "search"] {
                            written[left_out] = Value::Null;
                        }
                        written.as_object_mut().unwrap().remove("fitted_by");
                        serde_json::to_value(estimate(&written).unwrap()).unwrap()
                    }
                    "alarm" => {
                        alarms += 1;
                        serde_json::to_value(alarm(&written).unwrap()).unwrap()
                    }
                    _ => continue,
                };
                assert_eq!(again, written);
            }
        }
        assert!(estimates > 20 && alarms > 2, "{estimates} estimates, {alarms} alarms");
    }

    #[test]
    fn words_of_another_version_and_damaged_fields_are_as_if_they_were_not_there() {
        let text = r#"{"schema": "stictiond.estimate.v1", "loop": "A", "window": {"start_ns": 0, "end_ns": 9},
            "verdict": "stiction", "gates": ["new_gate", "too_coarse"], "reason": "new reason", "s": "wide",
            "indicators": [{"name": "new", "contribution": 1.5}, 3], "fs_interval": [1]}"#;
        let read = estimate(&serde_json::from_str(text).unwrap()).unwrap();
        let a = &read.assessment;
        assert_eq!(
            (a.gates.as_slice(), a.reason, a.s),
            ([stiction::core::verdict::Gate::TooCoarse].as_slice(), Some(UNKNOWN), None)
        );
        assert_eq!((a.indicators.len(), a.fs_interval), (1, None));
        for wrong in
            ["{}", "[]", "null", r#"{"schema": "stictiond.alarm.v2"}"#, r#"{"schema": "stictiond.estimate.v1"}"#]
        {
            let value: Value = serde_json::from_str(wrong).unwrap();
            assert!(estimate(&value).is_none() && alarm(&value).is_none(), "{wrong}");
        }
    }
}
