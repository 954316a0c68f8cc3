//! The decision: what is named, what else is possible, and what is left unnamed.
//!
//! Effects are ranked by their gain on the training blocks after BIC (Schwarz 1978); choosing by held-out free run
//! would let one mistimed slip decide. Held-out blocks and the run forward in time only confirm.

use super::effects::{self, Way};
use super::probability::{self, Features};
use super::types::{Alternative, Cause, EffectResult, NONE, NoiseModels, Stage, UNKNOWN};

/// Farther behind the best in training evidence, an effect is no alternative; and how fast it loses weight.
const FAR: f64 = 0.6;
const STEEP: f64 = 8.0;
/// Coloured noise is named where it depends on nothing with this p, and where first order is nearly enough.
const INDEPENDENT: f64 = 0.1;
const FIRST_ORDER: f64 = 0.15;
/// Traces whose samples are left out of every fit, and the error over the floor up to which the rest is explained.
const MASKED: [&str; 2] = ["outliers", "frozen_sensor"];
const EXPLAINED: f64 = 1.2;
/// Effects that act at one time of the record: forward in time says nothing about them.
const LOCAL: [&str; 6] = ["step_load", "dead_time_change", "ramp", "frozen_sensor", "outliers", "clipping"];

/// What the decision is made from beside the effects' fits; everything in it is known without deciding.
#[derive(Debug, Clone, PartialEq)]
pub struct Basis {
    /// Ids whose trace stands in PV, strongest first.
    pub traces: Vec<&'static str>,
    /// Points by which the recorded OP is off the PV that it answers, where the controller says so.
    pub skew: Option<f64>,
    /// Noise models of the residual.
    pub noise: NoiseModels,
    /// Whether coloured noise may be named.
    pub coloured_noise: bool,
    /// Effects beyond their margin.
    pub effects: usize,
    /// The stage that MV points to.
    pub by_mv: Option<Stage>,
    /// Effects ranked on MV instead of OP: id and evidence, best first.
    pub on_mv: Vec<(&'static str, f64)>,
    /// Whether the base is at the floor.
    pub base_at_floor: bool,
    /// The base's training error over the floor; `None` where there is no floor.
    pub over_floor: Option<f64>,
    /// Whether the set point moves or OP's swings differ in size.
    pub excited: bool,
}

/// The answer without its confirmation.
#[derive(Debug, Clone, PartialEq)]
pub struct Decision {
    /// What is named.
    pub cause: Cause,
    /// What else, best first.
    pub alternatives: Vec<Alternative>,
    /// What the probability was made of.
    pub features: Features,
}

/// Decides with a catalogue that lacks `without`.
#[must_use]
pub fn decide(effects: &[EffectResult], evidence: &Basis, without: &[&str]) -> Decision {
    let has = |id: &str| !id.split('+').any(|part| without.contains(&part));
    let features = |ranked: &[&EffectResult]| features(evidence, ranked);
    // Masked samples are the whole story only where the rest is explained.
    let explained = |t: &str| !MASKED.contains(&t) || evidence.over_floor.is_none_or(|o| o < EXPLAINED);
    if let Some(trace) = evidence.traces.iter().find(|t| has(t) && explained(t)) {
        return named(trace, stage_of(trace), probability::of_trace(), true, &[], features(&[]));
    }
    if evidence.skew.is_some() && has("time_skew") {
        return named("time_skew", Stage::Measurement, probability::of_trace(), true, &[], features(&[]));
    }
    let mut ranked: Vec<&EffectResult> =
        effects.iter().filter(|e| e.fit.is_some() && has(&e.id) && allowed(evidence, e)).collect();
    ranked.sort_by(|a, b| b.lead.total_cmp(&a.lead));
    let best = ranked.first().copied();
    let features = features(&ranked);
    if let Some((id, gain)) = evidence.on_mv.iter().find(|(id, _)| has(id)) {
        // Behind a measured valve the process stands alone: its own ranking counts.
        if evidence.by_mv == Some(Stage::Process) && *gain > effects::MARGIN && !evidence.base_at_floor {
            return named(
                id,
                stage_of(id),
                probability::of_trace(),
                true,
                &alternatives(&ranked, id, features),
                features,
            );
        }
    }
    // What no noise model and no effect explains, or what is left of samples that would have been masked.
    let hidden = evidence.traces.iter().any(|t| !has(t) && MASKED.contains(t));
    let unexplained = best.is_none_or(|b| b.lead <= 0.0) && evidence.over_floor.is_some_and(|o| o > EXPLAINED);
    let rejects = features.over_best > probability::reject_margin() || hidden || unexplained;
    let coloured_is_known = evidence.coloured_noise && has("coloured_noise");
    match best {
        Some(best) if best.lead > 0.0 && !rejects => {
            let p = probability::of_named(&features);
            named(&best.id, best.stage, p, false, &alternatives(&ranked, &best.id, features), features)
        }
        _ if rejects => {
            let noise = &evidence.noise;
            let p = probability::of_rejected(&features);
            let plain = noise.whitens && noise.independence_p > INDEPENDENT && noise.beyond_first < FIRST_ORDER;
            if coloured_is_known && plain {
                named(
                    "coloured_noise",
                    Stage::Disturbance,
                    p,
                    false,
                    &alternatives(&ranked, "coloured_noise", features),
                    features,
                )
            } else {
                named(UNKNOWN, Stage::CannotTell, p, false, &alternatives(&ranked, UNKNOWN, features), features)
            }
        }
        _ => named(
            NONE,
            Stage::None,
            probability::of_none(&features),
            true,
            &alternatives(&ranked, NONE, features),
            features,
        ),
    }
}

fn named(
    id: &str,
    stage: Stage,
    probability: f64,
    confirmed: bool,
    others: &[Alternative],
    features: Features,
) -> Decision {
    let mut rest = (1.0 - probability).max(0.0);
    let alternatives = others
        .iter()
        .map(|a| {
            let p = a.probability * (1.0 - probability);
            rest -= p;
            Alternative { id: a.id.clone(), probability: p }
        })
        .collect();
    Decision { cause: Cause { id: id.to_owned(), probability, confirmed, stage }, alternatives, features }
}

fn stage_of(id: &str) -> Stage {
    effects::by_id(id).map_or(Stage::CannotTell, |e| e.stage)
}

/// MV at the floor of PV leaves the valve's effects; else what acts behind it.
fn allowed(evidence: &Basis, effect: &EffectResult) -> bool {
    match evidence.by_mv {
        Some(Stage::Valve) => effect.stage == Stage::Valve || effect.id == "positioner_lag",
        Some(Stage::Process) => effect.stage != Stage::Valve,
        _ => true,
    }
}

/// What the probabilities are made of.
fn features(evidence: &Basis, ranked: &[&EffectResult]) -> Features {
    let lead = ranked.first().map_or(0.0, |e| e.lead);
    let second = ranked.get(1).map_or(0.0, |e| e.lead);
    let best_fit = ranked.first().and_then(|e| e.fit.as_ref());
    Features {
        lead,
        ahead: (lead - second.max(0.0)).max(0.0),
        at_floor: best_fit.is_some_and(|f| f.at_floor),
        closed: ranked.first().and_then(|e| e.closed_pct).unwrap_or(0.0) / 100.0,
        // Against the best that is still in the catalogue.
        over_best: evidence.noise.over_base - ranked.first().map_or(0.0, |e| e.raw_gain).max(0.0),
        excited: evidence.excited,
    }
}

/// Shares of what the named one leaves, by evidence; those within [`FAR`] of the best, at most four.
fn alternatives(ranked: &[&EffectResult], cause: &str, features: Features) -> Vec<Alternative> {
    let near = ranked.iter().filter(|e| e.id != cause && e.lead > features.lead - FAR && e.evidence > 0.0).take(4);
    let mut weights: Vec<(String, f64)> =
        near.map(|e| (e.id.clone(), libm::exp(STEEP * (e.lead - features.lead)))).collect();
    if cause != NONE && features.lead < 0.5 {
        weights.push((NONE.to_owned(), libm::exp(-STEEP * features.lead.max(0.0))));
    }
    if cause != UNKNOWN {
        weights.push((UNKNOWN.to_owned(), 0.3 + features.over_best.clamp(0.0, 1.0)));
    }
    let total: f64 = weights.iter().map(|(_, w)| w).sum();
    let mut out: Vec<Alternative> =
        weights.into_iter().map(|(id, w)| Alternative { id, probability: w / total }).collect();
    out.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    out
}

/// Whether held-out blocks, and where it can say so the run forward in time, bear a call out.
#[must_use]
pub fn confirmed(effect: &EffectResult, forward: Option<[f64; 2]>) -> bool {
    let closes = effect.closed_pct.is_some_and(|c| c > 5.0) || effect.gap_after < 0.9 * effect.gap_before;
    let local = LOCAL.contains(&effect.id.as_str());
    closes && (local || forward.is_none_or(|[before, after]| after < before))
}

/// Whether free run can predict an effect.
#[must_use]
pub fn predictable(id: &str) -> bool {
    id.split('+').all(|part| effects::by_id(part).is_none_or(|e| e.predictable && e.way != Way::Noise))
}
