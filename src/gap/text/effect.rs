//! Effects in words.

use super::super::document::EffectNote;
use super::{figure, percent};

/// What an effect is called among others.
pub(super) fn noun(id: &str) -> String {
    id.split('+').map(|one| word(one).unwrap_or(one)).collect::<Vec<_>>().join(" and ")
}

fn word(id: &str) -> Option<&'static str> {
    Some(match id {
        "asymmetric_stiction" => "uneven friction",
        "slip_overshoot" => "a stem that jumps past its mark",
        "sliding_valve" => "a stem that slides on after a slip",
        "backlash" => "backlash",
        "travel_limit" => "a stop of the stem",
        "rate_limit" => "a slow stem",
        "positioner_lag" => "a slow positioner",
        "extra_lag" => "a lag behind the valve",
        "static_nonlinearity" => "a gain that changes with level",
        "inverse_response" => "an inverse response",
        "integrating" => "an integrating process",
        "gain_drift" => "a drifting gain",
        "dead_time_change" => "a changed dead time",
        "sinusoid" => "a sinusoid from outside",
        "ramp" => "a ramp from outside",
        "step_load" => "a step of load",
        "coloured_noise" => "a slow random disturbance",
        "quantisation" => "a coarse grid of PV",
        "hold_compression" => "a history that holds values",
        "swinging_door" => "a history of straight lines",
        "clipping" => "a transmitter at the end of its range",
        "outliers" => "single wild values",
        "frozen_sensor" => "a frozen sensor",
        "time_skew" => "stamps of OP and PV that lie apart",
        "stiction" => "stiction",
        "none" => "nothing at all",
        "unknown" => "something else",
        _ => return None,
    })
}

/// What no record of OP and PV can tell from an effect: its class by its plant names, and what fitted nearly as well.
pub(super) fn twins(e: &EffectNote) -> Vec<String> {
    let class = match e.id.as_str() {
        "extra_lag" => Some("a sensor filter"),
        "static_nonlinearity" => Some("a valve characteristic"),
        "coloured_noise" => Some("a random walk"),
        _ => None,
    };
    class.map(str::to_owned).into_iter().chain(e.confusable_with.iter().map(|id| noun(id))).collect()
}

/// An effect with its fitted sizes.
pub(super) fn phrase(e: &EffectNote) -> String {
    let value = |name: &str| e.parameters.get(name).map(|q| q.value);
    let said = |name: &str| value(name).map(figure);
    let with = match e.id.as_str() {
        "asymmetric_stiction" => value("alpha").map(|a| {
            let side = if a > 0.0 { "upwards" } else { "downwards" };
            format!("friction that is {} larger {side} than its mean", percent(100.0 * a.abs()))
        }),
        "backlash" => said("width").map(|w| format!("backlash of {w} OP units behind the stem")),
        "travel_limit" => said("stop").map(|s| {
            let what = if value("of_stem") == Some(0.0) { "an end of the flow" } else { "a stop of the stem" };
            format!("{what} at OP {s}")
        }),
        "rate_limit" => said("rate").map(|r| {
            let what = if value("of_stem") == Some(1.0) { "a stem" } else { "a valve behind its stem" };
            format!("{what} that moves no faster than {r} OP units a second")
        }),
        "positioner_lag" => said("lag").map(|l| format!("a positioner lag of {l} s")),
        "extra_lag" => said("lag").map(|l| format!("an extra lag of {l} s")),
        "static_nonlinearity" => value("gain_change_per_op")
            .map(|g| format!("a gain that {} by {} with each OP unit", grows(g), percent(100.0 * g.abs()))),
        "inverse_response" => said("lag").map(|l| format!("an inverse response with a lag of {l} s")),
        "gain_drift" => value("gain_change_over_record")
            .map(|g| format!("a gain that {} by {} over the record", grows(g), percent(100.0 * g.abs()))),
        "dead_time_change" => said("added")
            .zip(said("at"))
            .map(|(d, t)| format!("a dead time that changes by {d} s, {t} s after the start")),
        "sinusoid" => said("period")
            .zip(said("amplitude"))
            .map(|(p, a)| format!("a sinusoid from outside, period {p} s and amplitude {a} PV units")),
        "ramp" => said("slope")
            .zip(said("from"))
            .map(|(s, t)| format!("a ramp from outside of {s} PV units a second from {t} s after the start on")),
        "step_load" => {
            said("size").zip(said("at")).map(|(s, t)| format!("a load step of {s} PV units {t} s after the start"))
        }
        _ => None,
    };
    with.unwrap_or_else(|| {
        let sizes: Vec<String> = e
            .parameters
            .iter()
            .map(|(name, q)| format!("{} {}", name.replace('_', " "), sized(q.value, &q.unit)))
            .collect();
        if sizes.is_empty() { noun(&e.id) } else { format!("{} ({})", noun(&e.id), sizes.join(", ")) }
    })
}

fn grows(change: f64) -> &'static str {
    if change > 0.0 { "grows" } else { "shrinks" }
}

fn sized(value: f64, unit: &str) -> String {
    match unit {
        "1" => figure(value),
        "OP" | "PV" => format!("{} {unit} units", figure(value)),
        unit => format!("{} {unit}", figure(value)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_effect_of_the_catalogue_has_words_of_its_own() {
        let all = crate::gap::effects::ALL;
        let missing: Vec<_> = all.iter().filter(|e| word(e.id).is_none()).map(|e| e.id).collect();
        assert!(missing.is_empty(), "{missing:?}");
        let mut words: Vec<_> = all.iter().filter_map(|e| word(e.id)).collect();
        words.sort_unstable();
        words.dedup();
        assert_eq!(words.len(), all.len());
        assert_eq!(noun("backlash+sinusoid"), "backlash and a sinusoid from outside");
    }
}
