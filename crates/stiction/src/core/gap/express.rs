//! From the search's normalised places to models and fits in recorded units.

use super::candidate::{Candidate, Parameters};
use super::model::{Added, Model, Process, SCHEMA, Valve};
use super::noise;
use super::plain::PlainPass;
use super::problem::Problem;
use super::search::Search;
use super::structure::Structure;
use super::types::{AT_FLOOR, Fit, Parameter, Slip};
use crate::core::sim::process::separated;
use crate::core::sim::slips::Law;

/// Steps from the fitted fd to that of the slips.
const STEPS: i32 = 8;

/// Root of the mean of `residual` squared over stretches.
#[must_use]
pub(crate) fn rms(residual: &[f64], stretches: &[[usize; 2]]) -> f64 {
    let n = stretches.iter().map(|[a, b]| b - a).sum::<usize>().max(1);
    let sum: f64 = stretches.iter().flat_map(|[a, b]| &residual[*a..*b]).map(|r| r * r).sum();
    (sum / n as f64).sqrt()
}

/// What is left above a floor: `sqrt(rmse^2 - floor^2)`, at least 0.
#[must_use]
pub(crate) fn above_floor(rmse: f64, floor: Option<f64>) -> f64 {
    let floor = floor.unwrap_or(0.0);
    (rmse * rmse - floor * floor).max(0.0).sqrt()
}

/// fs and fd in spans: bands in the middle of what the slips and the fitted fd leave open.
fn bands(of: &Candidate) -> [f64; 2] {
    let (fd, [s_cell, j_cell]) = (of.theta.fd, of.cells);
    let high_s = s_cell[1].min(of.theta.s.max(1.0));
    let low = s_cell[0].max(j_cell[0] + 2.0 * fd);
    let high = high_s.min(j_cell[1] + 2.0 * fd);
    let s = if low <= high { 0.5 * (low + high) } else { of.theta.s };
    [s - fd, fd]
}

/// fs and fd in spans of a stem whose slips hang on both bands at once, so that no rectangle of s and j gives the same:
/// of places between the slips found and the fd fitted, the one whose model, where `j = s - 2 fd`, leaves least.
fn tied_bands(problem: &Problem, structure: &Structure, of: &Candidate) -> [f64; 2] {
    let mut pass = PlainPass::new(problem, of.linear.gain.signum());
    let slips_fd = 0.5 * (of.theta.s - of.theta.j);
    let [fs, fd] = bands(of);
    let mut places = vec![[fs + fd, fd]];
    for k in 0..=STEPS {
        let fd = of.theta.fd + (slips_fd - of.theta.fd) * f64::from(k) / f64::from(STEPS);
        let by_j = of.theta.j + 2.0 * fd;
        places.extend([of.theta.s, by_j, 0.5 * (of.theta.s + by_j)].map(|s| [s, fd]));
    }
    let mut best = (f64::INFINITY, [fs, fd]);
    for [s, fd] in places.into_iter().filter(|[s, fd]| *s > 0.0 && *s >= 2.0 * fd) {
        let theta = Parameters { s, j: s - 2.0 * fd, fd, ..of.theta };
        let left = pass.held(structure, &theta, of.linear.gain).map_or(f64::INFINITY, |held| held.sse);
        if left < best.0 {
            best = (left, [s - fd, fd]);
        }
    }
    best.1
}

/// The model of a place.
#[must_use]
pub(crate) fn model(problem: &Problem, structure: &Structure, of: &Candidate) -> Model {
    let plan = structure.plan(&of.theta);
    let per_op = problem.normalised.deviation / problem.normalised.span;
    let total = if plan.zero { of.linear.gain + of.linear.others[of.linear.count - 1] } else { of.linear.gain };
    let by_point = plan.class().gain(total * per_op);
    let gain = if plan.integrating { by_point / problem.point_s } else { by_point };
    let tau = libm::exp(of.theta.log_tau);
    let time_constants = match (plan.integrating, plan.tau2 > 0.0) {
        (true, _) => vec![],
        (false, true) => {
            let (a, b) = separated(tau, plan.tau2);
            vec![a.max(b), a.min(b)]
        }
        (false, false) => vec![tau],
    };
    let is_tied = plan.stroke.uneven != 0.0 || plan.stroke.carried != 0.0;
    let [fs, fd] = match plan.law {
        None => [0.0; 2],
        Some(_) if is_tied => tied_bands(problem, structure, of),
        Some(_) => bands(of),
    };
    let law = match plan.law {
        None => "none",
        Some(Law::He) => "he",
        Some(Law::Tracking) => "tracking",
    };
    let stem0 = of.theta.first.threshold - of.theta.first.direction * fs;
    let ts_s = problem.point_s / problem.box_samples;
    Model {
        schema: SCHEMA.to_owned(),
        ts_s,
        valve: Valve {
            law: law.to_owned(),
            fs: fs * problem.normalised.span,
            fd: fd * problem.normalised.span,
            stem0: plan.law.map(|_| problem.op_of(stem0)),
        },
        process: Process {
            gain,
            time_constants_s: time_constants.iter().map(|t| t * problem.point_s).collect(),
            dead_time_s: (of.theta.lag * problem.box_samples - 1.0).max(0.0) * ts_s,
            integrating: plan.integrating,
            op: problem.op_middle,
            pv: problem.pv_mean + of.linear.others[0] * problem.normalised.deviation,
        },
        effects: structure
            .each()
            .map(|e| Added {
                id: e.id_in(problem),
                parameters: parameters_of(problem, structure, of, e.id)
                    .into_iter()
                    .map(|p| (p.name.to_owned(), p.value))
                    .collect(),
            })
            .collect(),
    }
}

/// The parameters of one of a structure's effects, in recorded units.
fn parameters_of(problem: &Problem, structure: &Structure, of: &Candidate, id: &str) -> Vec<Parameter> {
    let plan = structure.plan(&of.theta);
    let mut at = 0;
    for effect in structure.each() {
        let values = &of.theta.p[at..];
        if effect.id == id {
            let own = effect.params.iter().zip(values).filter_map(|(p, v)| p.recorded(*v, problem));
            return own.chain((effect.linear)(values, &plan, of, problem)).collect();
        }
        at += effect.params.len();
    }
    Vec::new()
}

/// The parameters of all of a structure's effects.
#[must_use]
pub(crate) fn parameters(problem: &Problem, structure: &Structure, of: &Candidate) -> Vec<Parameter> {
    structure.each().flat_map(|e| parameters_of(problem, structure, of, e.id)).collect()
}

/// The fit of a search's best place; `after` is applied to the prediction (what a recorder does to PV).
#[must_use]
pub(crate) fn fit(problem: &Problem, search: &Search, floor: Option<f64>, after: &dyn Fn(&mut [f64])) -> Option<Fit> {
    let best = search.best.first()?;
    let mut pass = PlainPass::new(problem, search.sign);
    let (mut prediction, valve) = pass.simulate(&search.structure, best)?;
    prediction.iter_mut().for_each(|p| *p = problem.pv_of(*p));
    after(&mut prediction);
    let model = model(problem, &search.structure, best);
    let valve = valve.iter().map(|v| problem.op_of(*v)).collect();
    let made = Fit::of_run(problem, search.structure.id_in(problem), model, prediction, valve, floor);
    let parameters = search.structure.freedom(&search.structure.plan(&best.theta));
    Some(Fit { parameters, evaluations: search.evaluations, ..made })
}

impl Fit {
    /// A model with its free run, PV units, and its flow, OP units; without parameters that were fitted.
    #[must_use]
    pub(super) fn of_run(
        problem: &Problem,
        id: String,
        model: Model,
        prediction: Vec<f64>,
        valve: Vec<f64>,
        floor: Option<f64>,
    ) -> Self {
        let pv = problem.normalised.pv.iter().map(|y| problem.pv_of(*y));
        let residual: Vec<f64> = pv.zip(&prediction).map(|(y, p)| y - p).collect();
        let [train, test] = [&problem.train, &problem.test].map(|stretches| rms(&residual, stretches));
        let has_friction = model.valve.law != "none";
        Self {
            id,
            slips: if has_friction { slips(&valve, 1e-6 * problem.normalised.span) } else { Vec::new() },
            model,
            valve,
            prediction,
            rmse_train: train,
            rmse: test,
            gap: above_floor(test, floor),
            parameters: 0,
            evaluations: 0,
            at_floor: floor.is_some_and(|f| train <= AT_FLOOR * f),
            points: problem.train.iter().map(|[a, b]| b - a).sum(),
            one_step: noise::one_step(&residual, problem),
        }
    }
}

/// Moves of a stem, OP units, larger than `least`.
#[must_use]
fn slips(valve: &[f64], least: f64) -> Vec<Slip> {
    valve
        .windows(2)
        .enumerate()
        .filter(|(_, w)| (w[1] - w[0]).abs() > least)
        .map(|(k, w)| Slip { point: k + 1, direction: (w[1] - w[0]).signum(), size: (w[1] - w[0]).abs() })
        .collect()
}
