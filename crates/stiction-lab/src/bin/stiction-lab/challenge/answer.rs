//! One line of a challenge's answers: the gap document, and the evidence for its decision.

use serde_json::{Value, json};

use stiction::core::detect::oscillation;
use stiction::core::gap::document::GapDocument;
use stiction::core::gap::{Cause, Diagnosis, GapOptions, Serial, diagnose};
use stiction::core::record::Record;

/// Diagnoses a record as `gap` does. Returns the document too.
///
/// # Errors
/// The record cannot be diagnosed.
pub(super) fn ask_for(name: &str, record: &Record, options: &GapOptions) -> anyhow::Result<(Diagnosis, GapDocument)> {
    let period = oscillation::detect(&record.op(), &record.pv).map(|o| o.period_points);
    let options = GapOptions { period_points: period, ..options.clone() };
    let diagnosis = diagnose(record, &options, &Serial)?;
    let document = GapDocument::new(name, record, &options, &diagnosis);
    Ok((diagnosis, document))
}

/// The answer for a recording; a failed diagnosis gives the reason.
pub(super) fn line(name: &str, made_with: &Value, result: &anyhow::Result<(Diagnosis, GapDocument)>) -> Value {
    let answer = match result {
        Ok((diagnosis, document)) => json!({ "document": document, "base_at_floor": diagnosis.findings.base.at_floor,
            "evidence": diagnosis.evidence() }),
        Err(error) => json!({ "document": null, "error": format!("{error:#}") }),
    };
    let mut line = json!({ "recording": name, "made_with": made_with });
    if let (Some(line), Value::Object(answer)) = (line.as_object_mut(), answer) {
        line.extend(answer);
    }
    line
}

/// A cause in the form of such a line.
pub(super) fn cause(cause: &Cause) -> Value {
    json!({ "id": cause.id, "probability": cause.probability, "confirmed": cause.confirmed })
}
