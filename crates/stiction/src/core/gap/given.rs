//! A model from elsewhere, simulated on a record as it is: only what the record must supply is fitted (the stem before
//! it, PV's level, the process' state, and loads that the model names without their size).

use super::candidate::{Candidate, MAX_PARAMS, Parameters};
use super::effects::{self, Effect, Param, Reach, Unit, Way};
use super::model::{Added, Model, ModelError};
use super::plain::PlainPass;
use super::problem::Problem;
use super::structure::Structure;
use super::types::Fit;
use crate::core::ident::class::Class;
use crate::core::ident::slip_search::problem::{EVEN_STARTS, Problem as SlipProblem};
use crate::core::sim::slips::{FirstSlip, Law};

/// Checks whether a model can be simulated, before any search.
///
/// # Errors
/// A number or word of the model is out of range.
pub fn check(model: &Model) -> Result<(), ModelError> {
    model.check()?;
    structure(model).map(|_| ())
}

/// The model's free run and residuals.
///
/// # Errors
/// A number or word of the model is out of range, or nothing moves its stem.
pub(crate) fn simulate(problem: &Problem, model: &Model, floor: Option<f64>) -> Result<Fit, ModelError> {
    model.check()?;
    let structure = structure(model)?;
    let theta = theta(problem, model, &structure);
    let per_point = if model.process.integrating { problem.point_s / Class::Integrating.gain(1.0) } else { 1.0 };
    let gain = model.process.gain * problem.normalised.span / problem.normalised.deviation * per_point;
    let mut pass = PlainPass::new(problem, gain.signum());
    let mut best: Option<Candidate> = None;
    for first in firsts(problem, model, &theta) {
        let mut place = theta;
        place.first = first;
        let held = pass.held(&structure, &place, gain);
        best = held.filter(|h| best.is_none_or(|b| h.sse < b.sse)).or(best);
    }
    let stuck = ModelError::Range { name: "fs", value: model.valve.fs, want: "small enough for OP to move the stem" };
    let best = best.ok_or(stuck.clone())?;
    let (prediction, valve) = pass.simulate(&structure, &best).ok_or(stuck)?;
    let prediction = prediction.iter().map(|p| problem.pv_of(*p)).collect();
    let valve = valve.iter().map(|v| problem.op_of(*v)).collect();
    let made = Fit::of_run(problem, "given".to_owned(), model.clone(), prediction, valve, floor);
    Ok(Fit { evaluations: pass.evaluations, ..made })
}

/// The base's parameters as the model states them, one for each first slip that may be meant; none where it is another
/// structure.
///
/// # Errors
/// Where a number or word of the model is out of range.
pub(crate) fn base_places(problem: &Problem, model: &Model) -> Result<Vec<Parameters>, ModelError> {
    let structure = structure(model)?;
    if structure.law != Some(Law::He) || structure.each().next().is_some() {
        return Ok(Vec::new());
    }
    let theta = theta(problem, model, &structure);
    let mut places = Vec::new();
    for first in firsts(problem, model, &theta) {
        let mut place = theta;
        place.first = first;
        places.push(place);
    }
    Ok(places)
}

/// The structure whose blocks a model has.
fn structure(model: &Model) -> Result<Structure, ModelError> {
    let law = match model.valve.law.as_str() {
        "none" => None,
        "tracking" => Some(Law::Tracking),
        _ => Some(Law::He),
    };
    let mut wanted: Vec<&'static Effect> = Vec::new();
    for added in &model.effects {
        let effect = effects::by_id(&added.id).ok_or_else(|| ModelError::Word {
            name: "effects",
            value: added.id.clone(),
            want: "the catalogue's ids",
        })?;
        if effect.way == Way::Neighbour {
            let want = "effects that need no other loop's record (--neighbours offers that record)";
            return Err(ModelError::Word { name: "effects", value: added.id.clone(), want });
        }
        let needed = |p: &&Param| !effect.bare && p.unit != Unit::Choice;
        let missing = effect.params.iter().filter(needed).find(|p| !added.parameters.contains_key(p.name));
        if let Some(Param { name, .. }) = missing {
            return Err(ModelError::Missing { effect: added.id.clone(), name });
        }
        wanted.push(effect);
    }
    let second = |e: &&Effect| e.params.iter().any(|p| p.reach == Reach::SecondLag);
    if model.process.time_constants_s.len() > 1 && !model.process.integrating && !wanted.iter().any(second) {
        wanted.push(&effects::extra_lag::EFFECT);
    }
    let integrating = &effects::integrating::EFFECT;
    if model.process.integrating && !wanted.iter().any(|e| e.id == integrating.id) {
        wanted.push(integrating);
    }
    // The law itself says this.
    wanted.retain(|e| e.way != Way::AgainstLinear);
    if wanted.len() > 2 {
        let value = wanted.len() as f64;
        return Err(ModelError::Range { name: "effects", value, want: "at most 2, a second lag counted" });
    }
    Ok(Structure { law, effects: [wanted.first().copied(), wanted.get(1).copied()] })
}

/// The time constant that is not the stated lag: they stand in the model by size, whichever was called the lag.
fn own_time_constant(model: &Model) -> f64 {
    let has_second = |e: &Effect| e.params.iter().any(|p| p.reach == Reach::SecondLag);
    let second = |a: &&Added| effects::by_id(&a.id).is_some_and(has_second);
    let lag = model.effects.iter().find(second).and_then(|a| a.parameters.get("lag"));
    match (lag, model.process.time_constants_s.as_slice()) {
        (Some(lag), [a, b]) if (a - lag).abs() < (b - lag).abs() => *b,
        (_, [first, ..]) => *first,
        (_, []) => model.ts_s,
    }
}

fn theta(problem: &Problem, model: &Model, structure: &Structure) -> Parameters {
    let (fs, fd) = (model.valve.fs / problem.normalised.span, model.valve.fd / problem.normalised.span);
    let tau = |i: usize| model.process.time_constants_s.get(i).map_or(1.0, |t| t / problem.point_s);
    let ts_s = problem.point_s / problem.box_samples;
    let mut theta = Parameters {
        s: fs + fd,
        j: fs - fd,
        first: FirstSlip { direction: 1.0, threshold: 0.0 },
        fd,
        log_tau: libm::log((own_time_constant(model) / problem.point_s).max(1e-3)),
        lag: (model.process.dead_time_s / ts_s + 1.0) / problem.box_samples,
        p: [0.0; MAX_PARAMS],
    };
    let mut at = 0;
    for effect in structure.each() {
        let added = model.effects.iter().find(|a| a.id == effect.id);
        let mut own = [0.0; MAX_PARAMS];
        for (value, param) in own.iter_mut().zip(effect.params) {
            let stated = added.and_then(|a| a.parameters.get(param.name)).copied();
            *value = match stated {
                Some(value) => param.normalised(value, problem),
                None if param.reach == Reach::SecondLag => libm::log(tau(1).max(1e-3)),
                None => param.normalised(0.0, problem),
            };
        }
        (effect.from_model)(&mut own, &theta);
        let end = (at + effect.params.len()).min(MAX_PARAMS);
        theta.p[at..end].copy_from_slice(&own[..end - at]);
        at = end;
    }
    theta
}

/// First slips to try: from the position that the model states, and from an even look.
fn firsts(problem: &Problem, model: &Model, theta: &Parameters) -> Vec<FirstSlip> {
    let fs = 0.5 * (theta.s + theta.j);
    let normalised = &problem.normalised;
    let starts = SlipProblem::new(normalised, 1.0).starts(fs, &EVEN_STARTS);
    let mut out: Vec<FirstSlip> = starts.into_iter().map(|start| normalised.first_slip(start)).collect();
    if let Some(stem0) = model.valve.stem0 {
        let position = (stem0 - problem.op_middle) / problem.normalised.span;
        out.push(FirstSlip { direction: 1.0, threshold: position + fs });
        out.push(FirstSlip { direction: -1.0, threshold: position - fs });
    }
    if out.is_empty() {
        out.push(theta.first);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_effect_without_its_number_is_refused_by_name() {
        let with = |id: &str, numbers: &[(&str, f64)]| structure(&Model::example(Some((id, numbers)))).map(|r| r.id());
        let error = with("static_nonlinearity", &[]).unwrap_err().to_string();
        assert_eq!(error, "the effect static_nonlinearity lacks its parameter gain_change_per_op");
        // Which end and whose it is are no where they are not said.
        assert_eq!(with("travel_limit", &[("stop", 40.0)]), Ok("travel_limit".to_owned()));
        assert_eq!(with("extra_lag", &[]), Ok("extra_lag".to_owned()));
        assert_eq!(with("slip_overshoot", &[]), Ok("slip_overshoot".to_owned()));
    }
}
