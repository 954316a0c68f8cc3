//! The search of [`crate::core::ident`] for slips and process, asked for the base and for every effect.
//!
//! An effect's parameters are held meanwhile, its loads are free columns; a process whose gain goes with its level, or
//! which has a zero, it does not know: what these do is taken out of PV as the effect's search has it so far, so that slips
//! and effect are found in turn. It fits the training blocks; its scans take the whole record, but on held-out blocks what PV
//! does elsewhere after the same moves of OP.

use std::sync::Arc;

use super::candidate::{MAX_PARAMS, Parameters};
use super::plain::{PlainPass, loads};
use super::plan::Plan;
use super::problem::Problem;
use super::search::Search;
use super::settle::clamped;
use super::structure::Structure;
use super::valve_signal::HeldPlan;
use crate::core::ident::ModelChoice;
use crate::core::ident::class::Class;
use crate::core::ident::normalised::NormalisedRecord;
use crate::core::ident::slip_search::candidate::Candidate;
use crate::core::ident::slip_search::problem::{BehindStem, Problem as SlipProblem};
use crate::core::ident::slip_search::settings::SearchSettings;
use crate::core::ident::slip_search::stages::{Found, Request, Search as SlipSearch};
use crate::core::signal::detrend::box_means;
use crate::core::signal::stats;
use crate::core::sim::actuator::lag_path;
use crate::core::sim::slips::FirstSlip;

/// Candidates taken from one search.
const TAKEN: usize = 8;
/// Step of its coarse scan's grid, % of OP's span: as usual, and of a brief search.
const FINENESS_PCT: [f64; 2] = [5.0, 10.0];
/// Time constant through which a load comes whose process is not known yet, periods.
const LOAD_TAU: f64 = 0.2;

/// How long is searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Length {
    /// So many rounds of the estimate's search.
    Rounds(usize),
    /// One round with less of everything.
    Brief,
}

/// Where a search for slips leads.
#[derive(Debug, Default)]
pub struct Places {
    /// What it found, best first.
    pub found: Vec<Parameters>,
    /// What it met on the way: the right slips may be among them where the model lacks too much to find them.
    pub scanned: Vec<Parameters>,
    /// Error models and valve signals computed.
    pub evaluations: u64,
}

/// Places for a structure's search with its best candidate's parameters, or its first start's before it has one; nothing for
/// a stem that knows no friction.
#[must_use]
pub(crate) fn search_slips(problem: &Problem, search: &Search, length: Length, seed: u64) -> Places {
    let Some(p) = search.best.first().map(|b| b.theta.p).or(search.starts.first().copied()) else {
        return Places::default();
    };
    let plan = search.structure.plan_of(&p);
    let Some(law) = plan.law else { return Places::default() };
    let Some(normalised) = normalised_of(problem, search, &plan) else { return Places::default() };
    let held = HeldPlan { plan: plan.searchable(), points: problem.n() };
    let mut slip_problem = SlipProblem::new(&normalised, search.sign);
    slip_problem.behind = plan.shapes_signal().then_some(&held as &dyn BehindStem);
    let tau = search.best.first().map_or(LOAD_TAU * problem.period, |b| libm::exp(b.theta.log_tau));
    slip_problem.counted.clone_from(&problem.train);
    slip_problem.loads = loads(&plan, tau, problem);
    let class = plan.class();
    let request = Request {
        laws: &[law],
        model: if class == Class::Second { ModelChoice::Sopdt } else { ModelChoice::Fopdt },
        fineness_pct: FINENESS_PCT[usize::from(length == Length::Brief)],
        seed,
        rival: f64::INFINITY,
    };
    let settings = match length {
        Length::Brief => SearchSettings::brief(),
        Length::Rounds(rounds) => SearchSettings::in_rounds(rounds),
    };
    let (found, _) = SlipSearch::new(&slip_problem, &request, &settings).run();
    places(problem, &search.structure, &normalised, &found, p)
}

/// The record as the search for a plan's slips sees it; `None` where the search's best has no free run.
fn normalised_of(problem: &Problem, search: &Search, plan: &Plan) -> Option<NormalisedRecord> {
    let mut normalised = problem.normalised.clone();
    if plan.actuator.lag > 0.0 {
        let path = lag_path(&normalised.path, plan.actuator.lag);
        normalised.mean = box_means(path.values(), path.per_point());
        normalised.extremes = NormalisedRecord::running_extremes(path.values());
        normalised.path = Arc::new(path);
    }
    normalised.stroke = plan.stroke;
    normalised.slip_end = plan.slip_end();
    normalised.pv.copy_from_slice(problem.fitted_pv());
    if let Some(best) = search.best.first() {
        let added = PlainPass::new(problem, search.sign).added(&search.structure, best)?;
        normalised.pv.iter_mut().zip(&added).for_each(|(y, a)| *y -= a);
    }
    problem.fill_held_out(&mut normalised.pv);
    let mean = stats::mean(&normalised.pv);
    normalised.pv.iter_mut().for_each(|y| *y -= mean);
    Some(normalised)
}

/// The parameter vectors of what a search found, an effect's own as they were held.
fn places(
    problem: &Problem,
    structure: &Structure,
    normalised: &NormalisedRecord,
    found: &Found,
    p: [f64; MAX_PARAMS],
) -> Places {
    let class = structure.plan_of(&p).class();
    let at = |c: &Candidate| clamped(structure, parameters(structure, normalised, c, p), problem);
    let mut all: Vec<&Candidate> = found.seen.iter().filter(|c| c.class == class).collect();
    all.sort_by(|a, b| a.sse().total_cmp(&b.sse()));
    // The best of each law first, whatever part of the record the others were fitted to.
    let mut out = Places { evaluations: found.evaluations, ..Places::default() };
    for candidate in found.best.iter().filter(|c| c.class == class).chain(all) {
        let theta = at(candidate);
        if out.found.len() < TAKEN && !out.found.contains(&theta) {
            out.found.push(theta);
        }
    }
    out.scanned = found.scanned.iter().map(at).collect();
    out
}

/// The parameter vector of a candidate.
fn parameters(structure: &Structure, normalised: &NormalisedRecord, c: &Candidate, p: [f64; MAX_PARAMS]) -> Parameters {
    let taus = c.taus();
    let is_linear_in_fd = structure.plan_of(&p).searchable().is_linear_in_fd();
    let mut theta = Parameters {
        s: c.s,
        j: c.j,
        first: normalised.first_slip(c.start),
        fd: if is_linear_in_fd { c.fit.fd } else { 0.5 * (c.s - c.j) },
        log_tau: if c.class.integrates() { 0.0 } else { libm::log(taus[0]) },
        lag: c.fit.lag().max(normalised.limits.lag[0]),
        p,
    };
    if c.class == Class::Second {
        structure.set_second_lag(&mut theta, libm::log(taus[1]));
    }
    theta
}

/// Starts for a model without friction: an even look at time constants and lags.
#[must_use]
pub(crate) fn frictionless(problem: &Problem) -> Vec<Parameters> {
    let mut out = Vec::new();
    for tau in [0.01, 0.05, 0.2, 1.0] {
        for lag in [0.01, 0.05, 0.12, 0.25] {
            out.push(Parameters {
                s: 0.0,
                j: 0.0,
                first: FirstSlip { direction: 1.0, threshold: 0.0 },
                fd: 0.0,
                log_tau: libm::log((tau * problem.period).max(0.3)),
                lag: problem.normalised.limits.lag[0] + lag * problem.period,
                p: [0.0; MAX_PARAMS],
            });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::evidence::Left;
    use super::super::express::fit;
    use super::super::noise;
    use super::super::schedule::{self, Work};
    use super::super::signatures;
    use super::super::types::Serial;
    use super::super::weigh::Scales;
    use super::*;
    use crate::core::record::Record;
    use crate::core::sim::noise::Noise;
    use crate::core::sim::process::{ProcessModel, ProcessState};
    use crate::core::sim::slips::Law;
    use crate::core::sim::valve::he_step;

    /// A sticking valve, a first-order process and a load that steps.
    fn record() -> Record {
        let turn = |k: usize, period: f64| libm::sin(2.0 * core::f64::consts::PI * k as f64 / period);
        let op: Vec<f64> = (0..500).map(|k| 50.0 + 4.0 * turn(k, 60.0) + turn(k, 331.0)).collect();
        let model = ProcessModel { gain: 2.0, tau: 5.0, tau2: 0.0, dead_time: 2.5, integrating: false };
        let (mut process, mut noise, mut stem) = (ProcessState::at_rest(model, 0.0), Noise::new(4, 1), 50.0);
        let follow = |(k, u): (usize, &f64)| {
            let y = process.step(stem - 50.0, 0.0) + 0.1 * noise.gaussian() + if k > 260 { 2.0 } else { 0.0 };
            stem = he_step(stem, *u, 3.0, 1.0);
            y
        };
        let pv = op.iter().enumerate().map(follow).collect();
        Record::uniform(1.0, op, pv)
    }

    #[test]
    fn nothing_that_an_effect_is_chosen_by_sees_a_held_out_block() {
        let record = record();
        let traces = signatures::traces(&record, 60.0, &[]);
        let problem = Problem::new(&record, Some(60.0), 1, traces.masked.clone());
        let mut other = problem.clone();
        let mut noise = Noise::new(9, 1);
        for k in (0..other.n()).filter(|k| problem.blocks.held_out[*k]) {
            other.normalised.pv[k] = 40.0 * noise.gaussian();
        }
        let other = other.held_out_by(&problem.blocks.held_out);
        let floor = noise::floor(&record.pv, &traces.measured, false);
        let chosen_by = |problem: &Problem| {
            let mut work =
                Work { executor: &Serial, budget: 60_000, done: 0, stopped: false, spent: false, seed: 1, asked: None };
            let found = schedule::run(problem, Some(Law::He), &[], floor.noise_floor, &mut work).unwrap();
            let base = fit(problem, &found.base, floor.noise_floor, &|_| {}).unwrap();
            let scales = Scales { problem, floor: &floor, base: &base, search: &found.base, traces: &traces, seed: 1 };
            let of_fit = |fit: &crate::core::gap::types::Fit| {
                let Left { over_floor, one_step, .. } = Left::of(fit, floor.noise_floor);
                (over_floor, one_step.map(|sides| sides[0]))
            };
            let of_search = |search: &Search| {
                let weighed = scales.weigh(search)?;
                Some((weighed.id, weighed.lead, weighed.evidence, of_fit(&weighed.fit?)))
            };
            let effects: Vec<_> = found.searches.iter().map(of_search).collect();
            (work.done, of_fit(&base), effects, base.rmse)
        };
        let (seen, garbled) = (chosen_by(&problem), chosen_by(&other));
        assert!(garbled.3 > 3.0 * seen.3, "held-out errors tell of them");
        assert_eq!((seen.0, seen.1, seen.2), (garbled.0, garbled.1, garbled.2));
    }
}
