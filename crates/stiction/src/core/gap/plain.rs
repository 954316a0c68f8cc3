//! The plain pass over samples: process and linear part of a parameter vector point by point, by columns as long as the
//! training blocks; the valve signal is that of [`super::valve_signal`].
//!
//! It gives the same error as [`super::evaluator`], which a property test compares with it, and does what that cannot: a
//! process whose time constant depends on its level, the coefficients of everything linear, and the free run itself. Gain, bias,
//! initial state and everything additive are solved exactly (variable projection, Golub and Pereyra 1973), and so is fd
//! where the valve signal is linear in it.

use super::candidate::{Candidate, Linear, MAX_COLUMNS, Parameters};
use super::effects::columns;
use super::plan::Plan;
use super::problem::{Problem, View};
use super::response::Process;
use super::structure::Structure;
use super::valve_signal::ValveSignal;
use crate::core::ident::kinetic_band::{Freedom, best_band};
use crate::core::ident::least_squares::Gram;
use crate::core::sim::actuator::Actuator;

/// Initial slope of a pair of lags, that of the quicker one alone being 1, from which it counts as leading.
const LEADS: f64 = 0.5;
/// What such a pair leaves in the end, over its larger part, below which it comes back.
const COMES_BACK: f64 = 0.05;
/// Initial state over the farthest PV from which it is not believed.
const BEYOND: f64 = 2.0;
/// The same over what is left of it at fitted points, below which they do not see it.
const SEEN: f64 = 0.3;

/// Evaluates parameter vectors of one problem sample by sample, with its own buffers.
#[derive(Debug)]
pub(crate) struct PlainPass<'a> {
    /// The record.
    pub problem: &'a Problem,
    /// Sign of the gain.
    pub sign: f64,
    /// Responses computed.
    pub evaluations: u64,
    signal: ValveSignal,
    /// The valve signal's level and direction at every point; where it is not linear in fd, the signal itself and nothing.
    valve: [Vec<f64>; 2],
    long: Vec<f64>,
    columns: Vec<Vec<f64>>,
}

impl<'a> PlainPass<'a> {
    /// A pass for one problem and sign of the gain.
    #[must_use]
    pub(crate) fn new(problem: &'a Problem, sign: f64) -> Self {
        Self {
            problem,
            sign,
            evaluations: 0,
            signal: ValveSignal::default(),
            valve: [Vec::new(), Vec::new()],
            long: Vec::new(),
            columns: vec![Vec::new(); MAX_COLUMNS],
        }
    }

    /// Runs the valve; `None` where the stem hardly moves.
    fn run_valve(&mut self, plan: &Plan, theta: &mut Parameters) -> Option<Freedom> {
        let freedom = self.signal.make(self.problem, plan, theta, self.sign)?;
        self.signal.sample(self.problem.n(), &mut self.valve);
        if !plan.is_linear_in_fd() {
            let [valve, direction] = &mut self.valve;
            valve.iter_mut().zip(&*direction).for_each(|(v, d)| *v -= theta.fd * d);
            direction.clear();
        }
        Some(freedom)
    }

    /// Makes the compact columns of a plan: others first, then one or two for the valve. Returns how many others.
    fn make_columns(&mut self, plan: &Plan, theta: &Parameters, view: View) -> usize {
        let problem = self.problem;
        let n = problem.n();
        let from = problem.blocks.from;
        let [tau1, tau2] = plan.time_constants(theta.log_tau);
        let tau = libm::exp(theta.log_tau);
        let mut count = 0;
        let mut put = |columns: &mut Vec<Vec<f64>>, long: &[f64]| {
            problem.gather(long, view, &mut columns[count]);
            count += 1;
        };
        // What does not depend on the valve.
        self.long.clear();
        self.long.resize(n, 1.0);
        put(&mut self.columns, &self.long);
        let memories: &[f64] = if plan.integrating { &[] } else { &[tau1, tau2] };
        for tau in memories.iter().filter(|t| **t > 0.0) {
            course(&mut self.long, n, from, libm::exp(-1.0 / tau));
            put(&mut self.columns, &self.long);
        }
        if plan.integrating {
            self.long.clear();
            self.long.extend((0..n).map(|k| (k as f64 - from as f64) / n as f64));
            put(&mut self.columns, &self.long);
        }
        for load in loads(plan, tau, problem) {
            put(&mut self.columns, &load);
        }
        // What does.
        let [signal, direction] = &self.valve;
        let process = Process { plan, tau: [tau1, tau2], lag: theta.lag.max(0.0) };
        let main = if plan.zero { Process { tau: [tau1, 0.0], ..process } } else { process };
        let second = Process { tau: [tau2, 0.0], ..process };
        let others = count + usize::from(plan.zero);
        let halves = [(second, signal), (main, signal), (main, direction)];
        let used = if plan.is_linear_in_fd() { 3 } else { 2 };
        for (i, (process, signal)) in halves.into_iter().enumerate().take(used).skip(usize::from(!plan.zero)) {
            problem.gather(&process.respond(signal), view, &mut self.columns[others + i - 1]);
        }
        others
    }

    /// The best linear part at one place; `None` where the stem hardly moves or no gain of the sign helps.
    pub(crate) fn evaluate(&mut self, structure: &Structure, theta: &Parameters, view: View) -> Option<Candidate> {
        self.evaluations += 1;
        let plan = structure.plan(theta);
        let mut theta = *theta;
        let freedom = self.run_valve(&plan, &mut theta)?;
        let others = self.make_columns(&plan, &theta, view);
        let target = self.problem.target(view);
        let two = plan.is_linear_in_fd();
        let mains = if two { 2 } else { 1 };
        let mut columns: [&[f64]; MAX_COLUMNS] = [&[]; MAX_COLUMNS];
        for (slot, column) in columns.iter_mut().zip(&self.columns[..others + mains]) {
            *slot = column;
        }
        columns[others + mains] = target;
        let mut gram = Gram::of(&columns[..=others + mains]);
        let whole = gram.at(others, others);
        let whole_direction = if two { gram.at(others + 1, others + 1) } else { 0.0 };
        gram.eliminate(others);
        let last = others + mains;
        let (gain, known, explained) = if two {
            let at = |i: usize, k: usize| gram.at(others + i, others + k);
            let system = [at(0, 0), at(0, 1), at(1, 1), at(0, 2), at(1, 2)];
            let (gain, fd, explained) = best_band(system, [whole, whole_direction], &freedom);
            theta.fd = fd;
            (gain, [gain, -gain * fd], explained)
        } else {
            let (power, along) = (gram.at(others, others), gram.at(others, last));
            let gain = if power > 1e-11 * whole { along / power } else { 0.0 };
            (gain, [gain, 0.0], gain * along)
        };
        let all = gram.back(others, &known[..mains]);
        let mut linear = Linear { others: [0.0; MAX_COLUMNS], count: others, gain };
        linear.others[..others].copy_from_slice(&all[..others]);
        let total = if plan.zero { gain + linear.others[others - 1] } else { gain };
        if gain == 0.0 || total * self.sign <= 0.0 {
            return None;
        }
        if plan.zero && reads_controller(plan.time_constants(theta.log_tau), [gain, total - gain]) {
            return None;
        }
        let sse = (gram.at(last, last) - explained).max(0.0);
        Some(Candidate { theta, sse, cells: self.cells(), slips: self.signal.steps.slips, linear })
    }

    /// As [`PlainPass::evaluate`] by the plain error with fd and the gain held: only the other columns are fitted.
    pub(crate) fn held(&mut self, structure: &Structure, theta: &Parameters, gain: f64) -> Option<Candidate> {
        self.evaluations += 1;
        let plan = structure.plan(theta);
        let (mut moved, fd) = (*theta, theta.fd);
        self.run_valve(&plan, &mut moved)?;
        let others = self.make_columns(&plan, theta, View::Plain);
        let only = Linear { others: [0.0; MAX_COLUMNS], count: 0, gain };
        let mut left = Vec::new();
        let main = self.columns[others].clone();
        if plan.is_linear_in_fd() {
            let direction = &self.columns[others + 1];
            left.extend(main.iter().zip(direction).map(|(a, d)| -gain * (a - fd * d)));
        } else {
            left.extend(main.iter().map(|a| -gain * a));
        }
        for (l, y) in left.iter_mut().zip(self.problem.target(View::Plain)) {
            *l += y;
        }
        let mut columns: Vec<&[f64]> = self.columns[..others].iter().map(Vec::as_slice).collect();
        columns.push(&left);
        let mut gram = Gram::of(&columns);
        gram.eliminate(others);
        let all = gram.back(others, &[]);
        let mut linear = Linear { count: others, ..only };
        linear.others[..others].copy_from_slice(&all[..others]);
        let sse = gram.at(others, others).max(0.0);
        Some(Candidate { theta: *theta, sse, cells: self.cells(), slips: self.signal.steps.slips, linear })
    }

    fn cells(&self) -> [[f64; 2]; 2] {
        [self.signal.steps.s_cell, self.signal.steps.j_cell]
    }

    fn combine(&self, plan: &Plan, others: usize, fd: f64, linear: &Linear, out: &mut Vec<f64>) {
        out.clear();
        if plan.is_linear_in_fd() {
            let (at, direction) = (&self.columns[others], &self.columns[others + 1]);
            out.extend(at.iter().zip(direction).map(|(a, d)| linear.gain * (a - fd * d)));
        } else {
            out.extend(self.columns[others].iter().map(|x| linear.gain * x));
        }
        for (column, c) in self.columns[..others].iter().zip(linear.others) {
            for (o, x) in out.iter_mut().zip(column) {
                *o += c * x;
            }
        }
    }

    /// Free run over the whole record, deviations of PV, and the flow ([`super::Fit::valve`]), spans; `None` where the stem
    /// hardly moves.
    pub(crate) fn simulate(&mut self, structure: &Structure, of: &Candidate) -> Option<(Vec<f64>, Vec<f64>)> {
        self.run_plan(&structure.plan(&of.theta), of, of.linear)
    }

    /// What a structure's effect adds to the free run of the same slips beside what the search of the slips knows itself
    /// ([`Plan::searchable`]); zeros where it knows all.
    pub(crate) fn added(&mut self, structure: &Structure, of: &Candidate) -> Option<Vec<f64>> {
        let plan = structure.plan(&of.theta);
        let plain = plan.searchable();
        if plan == plain {
            return Some(vec![0.0; self.problem.n()]);
        }
        let mut linear = of.linear;
        if plan.zero {
            linear.gain += linear.others[linear.count - 1];
        }
        let (with, _) = self.run_plan(&plan, of, of.linear)?;
        let (without, _) = self.run_plan(&plain, of, linear)?;
        Some(with.iter().zip(&without).map(|(a, b)| a - b).collect())
    }

    fn run_plan(&self, plan: &Plan, of: &Candidate, linear: Linear) -> Option<(Vec<f64>, Vec<f64>)> {
        let whole = self.problem.whole();
        let mut pass = PlainPass::new(&whole, self.sign);
        let mut theta = of.theta;
        pass.run_valve(plan, &mut theta)?;
        let others = pass.make_columns(plan, &theta, View::Plain);
        let linear = pass.begun_within_reason(plan, linear);
        let mut out = Vec::new();
        pass.combine(plan, others, theta.fd, &linear, &mut out);
        // The flow before the characteristic, without drift and change of dead time.
        let actuator = Actuator { bend: 0.0, ..plan.actuator };
        let before = Plan { actuator, switch: None, drift: None, ..*plan };
        if before != *plan {
            pass.run_valve(&before, &mut theta)?;
        }
        let [mut valve, direction] = pass.valve;
        valve.iter_mut().zip(&direction).for_each(|(v, d)| *v -= theta.fd * d);
        Some((out, valve))
    }

    /// Without an initial state beyond PV's range that no fitted point sees: on a record of few stored values it is noise
    /// over next to nothing. One that they do see stays, as of a slow lag in place of an integrator.
    fn begun_within_reason(&self, plan: &Plan, mut linear: Linear) -> Linear {
        let problem = self.problem;
        let fitted = problem.train.iter().flat_map(|[a, b]| &problem.normalised.pv[*a..*b]);
        let farthest = fitted.fold(0.0, |m: f64, y| m.max(y.abs()));
        let memories = if plan.integrating { 0 } else { 1 + usize::from(plan.tau2 > 0.0) };
        let course = |k: usize| (1..=memories).map(|i| linear.others[i] * self.columns[i][k]).sum::<f64>().abs();
        let most = |of: &dyn Fn(usize) -> bool| {
            let points = (problem.blocks.from..problem.n()).filter(|k| of(*k));
            points.map(course).fold(0.0, f64::max)
        };
        let is_fitted = |k: usize| problem.is_measured(k) && !problem.blocks.held_out[k] && !problem.blocks.masked[k];
        if most(&|_| true) > BEYOND * farthest && most(&is_fitted) < SEEN * farthest {
            linear.others[1..=memories].fill(0.0);
        }
        linear
    }
}

/// Whether two lags side by side are not the process but the closed loop's controller read backwards, which gives PV's
/// moves from OP's and no level: the pair begins faster than half of what one lag would, or comes back to where it was.
pub(crate) fn reads_controller(tau: [f64; 2], gain: [f64; 2]) -> bool {
    let total = gain[0] + gain[1];
    let slope = gain[0] / tau[0] + gain[1] / tau[1];
    slope * tau[0].min(tau[1]) / total > LEADS || total.abs() < COMES_BACK * gain[0].abs().max(gain[1].abs())
}

/// Signals that are fitted beside the process' answer, one entry a point, in the order of [`Plan::column`]; `tau` is the
/// lag through which a step comes.
pub(crate) fn loads(plan: &Plan, tau: f64, problem: &Problem) -> Vec<Vec<f64>> {
    let n = problem.n();
    let mut out = Vec::new();
    out.extend(plan.omega.into_iter().flat_map(|omega| columns::waves(omega, n)));
    out.extend(plan.ramp.map(|start| columns::ramp(start, n)));
    // A gain that drifts also drifts PV's level, since the process need not rest at the middle of the stem's range.
    out.extend(plan.drift.map(|drift| drift.course(n).collect::<Vec<f64>>()));
    let through = |straight: bool| (!straight && !plan.integrating).then_some(tau);
    out.extend(plan.step.map(|(start, straight)| columns::step(start, through(straight), n)));
    if let (Some([lag, delay]), Some(load)) = (plan.neighbour, &problem.neighbour) {
        out.push(load.behind(lag, delay, n));
    }
    out
}

/// The decay `a^(k - from)` from the point before `from` on, 1 before that.
fn course(out: &mut Vec<f64>, n: usize, from: usize, a: f64) {
    out.clear();
    out.resize(from.min(n), 1.0);
    if let Some(before) = out.last_mut() {
        *before = 1.0 / a.max(1e-12);
    }
    let mut value = 1.0;
    while out.len() < n {
        out.push(value);
        value *= a;
        if value < 1e-14 {
            out.resize(n, 0.0);
        }
    }
}

#[cfg(test)]
pub(crate) mod tests;
