//! One line of a challenge's answers: the gap document, and what is called with each effect withheld.

use serde_json::{Map, Value, json};

use crate::gap::{Cause, Diagnosis, EffectResult, effects};

/// A recording's answer; a diagnosis that failed says why.
pub(super) fn line(name: &str, made_with: &Value, result: &anyhow::Result<Diagnosis>) -> Value {
    let (document, error, withheld) = match result {
        Ok(diagnosis) => (document(name, diagnosis), Value::Null, withheld(diagnosis)),
        Err(error) => (Value::Null, json!(format!("{error:#}")), json!([])),
    };
    json!({ "recording": name, "made_with": made_with, "document": document, "error": error, "withheld": withheld })
}

fn cause(cause: &Cause) -> Value {
    json!({ "id": cause.id, "probability": cause.probability, "confirmed": cause.confirmed })
}

/// The same fits judged without each effect in turn.
fn withheld(diagnosis: &Diagnosis) -> Value {
    effects::ALL
        .iter()
        .map(|effect| {
            let again = diagnosis.without(&[effect.id]);
            json!({ "without": effect.id, "cause": cause(&again.cause), "stage": again.cause.stage.name() })
        })
        .collect()
}

/// `stictiond.gap.v1` as far as the diagnosis alone gives it.
fn document(name: &str, diagnosis: &Diagnosis) -> Value {
    let Diagnosis { base, floor, .. } = diagnosis;
    let alternatives: Vec<Value> =
        diagnosis.alternatives.iter().map(|a| json!({ "id": a.id, "probability": a.probability })).collect();
    json!({
        "schema": "stictiond.gap.v1",
        "loop": name,
        "base_at_floor": base.at_floor,
        "gap": { "rmse": base.rmse, "noise_floor": floor.noise_floor, "relative": diagnosis.relative_gap },
        "where": { "stage": diagnosis.cause.stage.name(), "excited": diagnosis.basis.excited },
        "effects": diagnosis.effects.iter().chain(&diagnosis.pairs).map(effect).collect::<Vec<_>>(),
        "cause": cause(&diagnosis.cause),
        "alternatives": alternatives,
        "forward": diagnosis.forward.map(|f| json!({ "gap_before": f.gap_before, "gap_after": f.gap_after })),
        "noise_models": { "over_base": diagnosis.noise_models.over_base, "over_best": diagnosis.noise_models.over_best,
            "independence_p": diagnosis.noise_models.independence_p, "whitens": diagnosis.noise_models.whitens },
        "evaluations": diagnosis.evaluations,
        "version": crate::VERSION,
    })
}

fn effect(effect: &EffectResult) -> Value {
    let parameters: Map<String, Value> =
        effect.parameters.iter().map(|p| (p.name.to_owned(), json!({ "value": p.value, "unit": p.unit }))).collect();
    json!({
        "id": effect.id,
        "stage": effect.stage.name(),
        "parameters": parameters,
        "gap_before": effect.gap_before,
        "gap_after": effect.gap_after,
        "floor_after": effect.floor_after,
        "closed_pct": effect.closed_pct,
        "closed_interval": effect.closed_interval,
        "evidence": effect.evidence,
        "raw_gain": effect.raw_gain,
        "lead": effect.lead,
        "confusable_with": effect.confusable_with,
        "at_floor": effect.fit.as_ref().map(|f| f.at_floor),
    })
}
