//! The objective of one model structure: the least squared free-run error on the training blocks that a parameter vector
//! leaves, from the steps of its valve signal ([`crate::core::ident::evaluator`]).
//!
//! Gain, kinetic band, bias, initial state, loads and the dead time within a sample come in closed form; time constants
//! stand on a lattice whose tables are made once for a record. A process whose rate goes with its level has no such form
//! and takes the plain pass over samples.

use std::sync::Arc;

use super::candidate::{Candidate, Linear, MAX_COLUMNS, Parameters};
use super::plain::{PlainPass, loads, reads_controller};
use super::plan::Plan;
use super::problem::{Problem, View};
use super::structure::Structure;
use super::valve_signal::ValveSignal;
use crate::core::ident::class::Class;
use crate::core::ident::evaluator::{self as sums, Best, Table, lattice_index, lattice_tau, reduce};
use crate::core::ident::kinetic_band::Freedom;
use crate::core::sim::process::separated;

/// Sets of loads whose tables are kept: a local search comes back to those it started from.
const LOAD_SETS: usize = 6;

/// Evaluates parameter vectors of one problem, with its own buffers.
#[derive(Debug)]
pub(crate) struct Evaluator<'a> {
    /// The record.
    pub problem: &'a Problem,
    /// Sign of the gain.
    pub sign: f64,
    /// Model responses computed.
    pub evaluations: u64,
    /// Responses that may be computed: from there on nothing is found any more.
    pub limit: u64,
    signal: ValveSignal,
    /// What the sums have of the signal at hand whatever the process is.
    held: sums::HeldSums,
    plain: PlainPass<'a>,
    load_sets: Vec<LoadSet>,
}

/// Loads with the tables of the time constants they were asked with.
#[derive(Debug)]
struct LoadSet {
    key: [u64; 8],
    view: View,
    with: sums::View,
    tables: Vec<(i32, Arc<Table>)>,
}

/// A valve signal that has been made, for evaluations with different processes behind it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Prepared {
    plan: Plan,
    theta: Parameters,
    freedom: Freedom,
    cells: [[f64; 2]; 2],
    slips: usize,
}

/// Time constants on the lattice and whole points of dead time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Place {
    /// Places of the time constants; the second equals the first where there is one.
    pub tau: [i32; 2],
    /// Whole points.
    pub delay: i32,
}

impl Prepared {
    /// Whether two time constants are fitted.
    #[must_use]
    pub(crate) fn has_two_lags(&self) -> bool {
        self.plan.tau2 > 0.0 && !self.plan.integrating
    }

    /// Whether a time constant is fitted at all.
    #[must_use]
    pub(crate) const fn has_lag(&self) -> bool {
        !self.plan.integrating
    }

    /// Whether only the plain pass can tell the error.
    #[must_use]
    pub(crate) fn is_plain(&self) -> bool {
        self.plan.level != 0.0 && !self.plan.integrating
    }
}

impl<'a> Evaluator<'a> {
    /// An evaluator for one problem and sign of the gain.
    #[must_use]
    pub(crate) fn new(problem: &'a Problem, sign: f64) -> Self {
        Self {
            problem,
            sign,
            evaluations: 0,
            limit: u64::MAX,
            signal: ValveSignal::default(),
            held: sums::HeldSums::default(),
            plain: PlainPass::new(problem, sign),
            load_sets: Vec::new(),
        }
    }

    /// Makes the valve signal of a parameter vector; `None` where the stem hardly moves or the budget is spent.
    pub(crate) fn prepare(&mut self, structure: &Structure, theta: &Parameters) -> Option<Prepared> {
        if self.evaluations >= self.limit {
            return None;
        }
        let plan = structure.plan(theta);
        let mut theta = *theta;
        self.held.clear();
        let freedom = self.signal.make(self.problem, &plan, &mut theta, self.sign)?;
        let steps = &self.signal.steps;
        Some(Prepared { plan, theta, freedom, cells: [steps.s_cell, steps.j_cell], slips: steps.slips })
    }

    /// Where a parameter vector stands on the lattice.
    #[must_use]
    pub(crate) fn place_of(&self, prepared: &Prepared) -> Place {
        let limits = self.problem.normalised.limits;
        let within = |tau: f64| lattice_index(tau.clamp(limits.tau[0], limits.tau[1]));
        let first = within(libm::exp(prepared.theta.log_tau));
        let mut second = first;
        if prepared.has_two_lags() {
            second = within(prepared.plan.tau2);
            // Two equal lags have no form of their own.
            if second == first {
                second -= 1;
            }
        }
        let delay = prepared.theta.lag.clamp(limits.lag[0], limits.lag[1]).floor() as i32;
        Place { tau: [first, second], delay }
    }

    /// The best of all dead times within a whole point at one place of the lattice; `None` where no gain of the sign helps.
    /// The signal must be the one prepared last.
    pub(crate) fn at(
        &mut self,
        structure: &Structure,
        prepared: &Prepared,
        place: Place,
        view: View,
    ) -> Option<Candidate> {
        let mut theta = prepared.theta;
        let tau = place.tau.map(lattice_tau);
        if prepared.has_lag() {
            theta.log_tau = libm::log(tau[0]);
        }
        let mut plan = prepared.plan;
        if prepared.has_two_lags() {
            structure.set_second_lag(&mut theta, libm::log(tau[1]));
            plan.tau2 = tau[1];
        }
        if prepared.is_plain() {
            let limits = self.problem.normalised.limits.lag;
            theta.lag = theta.lag.clamp(f64::from(place.delay), f64::from(place.delay + 1)).clamp(limits[0], limits[1]);
            return self.plain_pass(structure, &theta, view);
        }
        self.evaluations += 1;
        let problem = self.problem;
        let own = problem.view(view);
        let mut held = core::mem::take(&mut self.held);
        let best = match self.load_set(&plan, tau[0], view) {
            None => {
                let tables = place.tau.map(|index| own.on_lattice(index));
                self.best(prepared, &plan, own, tables, place.delay, &mut held)
            }
            Some(set) => {
                let tables = place.tau.map(|index| self.load_sets[set].table(index, own));
                self.best(prepared, &plan, &self.load_sets[set].with, tables, place.delay, &mut held)
            }
        };
        self.held = held;
        Some(candidate(prepared, theta, best?, place.delay))
    }

    /// The same at any time constants, `theta`'s own; for the last refinement.
    pub(crate) fn off_lattice(
        &mut self,
        structure: &Structure,
        theta: &Parameters,
        delay: i32,
        view: View,
    ) -> Option<Candidate> {
        let prepared = self.prepare(structure, theta)?;
        if prepared.is_plain() {
            return self.plain_pass(structure, theta, view);
        }
        self.evaluations += 1;
        let plan = prepared.plan;
        let mut tau = [libm::exp(theta.log_tau); 2];
        if prepared.has_two_lags() {
            tau = separated(tau[0], plan.tau2).into();
        }
        let own = Arc::clone(self.problem.view(view));
        let signals = loads(&plan, tau[0], self.problem);
        let with;
        let view = if signals.is_empty() {
            &*own
        } else {
            let signals: Vec<&[f64]> = signals.iter().map(Vec::as_slice).collect();
            with = own.beside(&signals);
            &with
        };
        let first = Arc::new(view.table(tau[0]));
        let second = if prepared.has_two_lags() { Arc::new(view.table(tau[1])) } else { Arc::clone(&first) };
        let best = self.best(&prepared, &plan, view, [first, second], delay, &mut sums::HeldSums::default())?;
        Some(candidate(&prepared, prepared.theta, best, delay))
    }

    /// As it is, by the plain pass: with the coefficients of everything linear.
    pub(crate) fn plain_pass(&mut self, structure: &Structure, theta: &Parameters, view: View) -> Option<Candidate> {
        self.evaluations += 1;
        self.plain.evaluate(structure, theta, view)
    }

    fn best(
        &self,
        prepared: &Prepared,
        plan: &Plan,
        view: &sums::View,
        tables: [Arc<Table>; 2],
        delay: i32,
        held: &mut sums::HeldSums,
    ) -> Option<Best> {
        let limits = self.problem.normalised.limits.lag;
        let fraction = |lag: f64| (lag - f64::from(delay)).clamp(0.0, 1.0);
        let fractions = limits.map(fraction);
        let class = match (plan.integrating, prepared.has_two_lags()) {
            (true, _) => Class::Integrating,
            (false, true) => Class::Second,
            (false, false) => Class::First,
        };
        let steps = &self.signal.steps.list;
        let reduced = reduce(class, view, [&tables[0], &tables[1]], steps, delay.max(0) as usize, held);
        let best = if plan.zero {
            let tau = [tables[0].tau, tables[1].tau];
            reduced.best_side_by_side(&prepared.freedom, fractions, |gains| !reads_controller(tau, gains))
        } else {
            reduced.best(&prepared.freedom, fractions)
        };
        (best.gain * self.sign > 0.0).then_some(best)
    }

    /// Makes the loads of a plan, where it has some, and says where they are kept.
    fn load_set(&mut self, plan: &Plan, tau: f64, view: View) -> Option<usize> {
        let through_lag = plan.step.is_some_and(|(_, straight)| !straight) && !plan.integrating;
        let key = [
            plan.omega.map_or(0, f64::to_bits),
            plan.ramp.map_or(0, f64::to_bits),
            plan.drift.map_or(0, |d| if d.by_factor { d.change.to_bits() } else { 1 }),
            plan.step.map_or(0, |(start, _)| start.to_bits() | 1),
            if through_lag { tau.to_bits() } else { 0 },
            u64::from(plan.step.is_some_and(|(_, straight)| straight)),
            plan.neighbour.map_or(0, |[lag, _]| lag.to_bits()),
            plan.neighbour.map_or(0, |[_, delay]| delay.to_bits()),
        ];
        if key[..4] == [0; 4] && plan.neighbour.is_none() {
            return None;
        }
        if let Some(found) = self.load_sets.iter().position(|s| s.key == key && s.view == view) {
            return Some(found);
        }
        if self.load_sets.len() == LOAD_SETS {
            self.load_sets.remove(0);
        }
        let signals = loads(plan, tau, self.problem);
        let signals: Vec<&[f64]> = signals.iter().map(Vec::as_slice).collect();
        let with = self.problem.view(view).beside(&signals);
        self.load_sets.push(LoadSet { key, view, with, tables: Vec::new() });
        Some(self.load_sets.len() - 1)
    }
}

impl LoadSet {
    fn table(&mut self, index: i32, own: &sums::View) -> Arc<Table> {
        if let Some((_, table)) = self.tables.iter().find(|(i, _)| *i == index) {
            return Arc::clone(table);
        }
        let table = Arc::new(self.with.extended(&own.on_lattice(index)));
        self.tables.push((index, Arc::clone(&table)));
        table
    }
}

/// The candidate of the best dead time; the coefficients of everything linear are left to the plain pass.
fn candidate(prepared: &Prepared, mut theta: Parameters, best: Best, delay: i32) -> Candidate {
    theta.lag = f64::from(delay) + best.fraction;
    if prepared.plan.is_linear_in_fd() || prepared.plan.zero && prepared.freedom.fd != [0.0; 2] {
        theta.fd = best.fd;
    }
    let linear = Linear { others: [0.0; MAX_COLUMNS], count: 0, gain: best.gain };
    Candidate { theta, sse: best.sse, cells: prepared.cells, slips: prepared.slips, linear }
}

#[cfg(test)]
mod tests;
