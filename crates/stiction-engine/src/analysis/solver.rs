//! A solver on the error surface of an estimate, as in the toolbox.

use serde::Serialize;

use stiction::core::ident::Options;
use stiction::core::ident::class::Class;
use stiction::core::optim::{Objective, Settings, Solver, Termination};
use stiction::core::record::Record;
use stiction::core::sim::slips::Law;
use stiction::core::verdict::{Assessment, Process};
use stiction::toolbox::surface::{Solved, Surface};

/// A solver's result, as in documents.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SolverDocument {
    /// Name of the solver, or the program.
    pub name: String,
    /// Static band, OP units; null if no model exists anywhere.
    pub fs: Option<f64>,
    /// Kinetic band, OP units.
    pub fd: Option<f64>,
    /// Smallest mean squared error, PV units squared.
    pub mse: Option<f64>,
    /// Mean squared error of the estimate's own bands on the same surface.
    pub estimate_mse: Option<f64>,
    /// Order of the process behind the valve.
    pub order: u8,
    /// Process gain, PV units per OP unit (per second too when integrating).
    pub gain: Option<f64>,
    /// Time constants, s.
    pub time_constants_s: Vec<f64>,
    /// Dead time, s.
    pub dead_time_s: Option<f64>,
    /// Span of OP.
    pub s0: f64,
    /// The constraint applied.
    pub constraint: &'static str,
    /// Models evaluated.
    pub evaluations: u64,
    /// Models allowed.
    pub evaluations_limit: u64,
    /// Why it stopped.
    pub stopped: Termination,
    /// Lower bound of the MSE estimated by the solver.
    pub lower_bound_mse: Option<f64>,
    /// Reliability of that bound.
    pub bound: Option<&'static str>,
    /// Run time, ms.
    pub elapsed_ms: f64,
}

/// The surface of an assessment: its valve model and process class. `None` if the record could not be fitted.
#[must_use]
pub fn surface(record: &Record, options: &Options, found: &Assessment) -> Option<Surface> {
    let class = class_of(found.process.as_ref()?);
    let law = found.valve_model.unwrap_or(Law::He);
    Surface::new(record, options, law, class).ok()
}

const fn class_of(process: &Process) -> Class {
    match (process.order, process.integrating) {
        (1, false) => Class::First,
        (1, true) => Class::Integrating,
        (_, false) => Class::Second,
        (_, true) => Class::LagIntegrating,
    }
}

/// Mean squared error of the assessment's bands on the surface.
#[must_use]
pub fn own_mse(surface: &mut Surface, found: &Assessment) -> Option<f64> {
    let own = found.fs.zip(found.fd);
    own.map(|(fs, fd)| surface.mse(fs, fd)).filter(|mse| mse.is_finite())
}

/// Runs a solver on the surface. `heard` gets the number of models evaluated and the least mean squared error so far, PV
/// units squared, after each; the search ends when it returns false.
pub fn search(
    surface: &mut Surface,
    solver: &dyn Solver,
    settings: &Settings,
    heard: &mut dyn FnMut(u64, f64) -> bool,
) -> Solved {
    let s0 = surface.s0();
    let mut watched = Watched { surface, heard, least: f64::INFINITY, go_on: true };
    let outcome = solver.search(&mut watched, settings);
    let mut solved = Solved::of(outcome, s0);
    if !watched.go_on {
        solved.outcome.stopped = Termination::Interrupted;
    }
    solved
}

/// A surface that reports progress and returns at once after a stop request.
struct Watched<'a> {
    surface: &'a mut Surface,
    heard: &'a mut dyn FnMut(u64, f64) -> bool,
    least: f64,
    go_on: bool,
}

impl Objective for Watched<'_> {
    fn cost(&mut self, point: [f64; 2]) -> f64 {
        if !self.go_on {
            return f64::INFINITY;
        }
        let cost = self.surface.cost(point);
        self.least = self.least.min(cost);
        self.go_on = (self.heard)(self.surface.evaluations(), self.least);
        cost
    }
}

/// The result on the surface, next to [`own_mse`] from before the search.
#[must_use]
pub fn document(
    name: String,
    solved: &Solved,
    surface: &mut Surface,
    settings: &Settings,
    found: &Assessment,
    estimate_mse: Option<f64>,
    elapsed_ms: f64,
) -> SolverDocument {
    let there = solved.mse.is_finite();
    let point = if there { surface.point(solved.fs, solved.fd.min(solved.fs)) } else { None };
    let bound = solved.outcome.lower_bound.filter(|_| there);
    SolverDocument {
        name,
        fs: there.then_some(solved.fs),
        fd: there.then_some(solved.fd),
        mse: there.then_some(solved.mse),
        estimate_mse,
        order: found.process.as_ref().map_or(0, |p| p.order),
        gain: point.as_ref().map(|p| p.gain),
        time_constants_s: point.as_ref().map_or_else(Vec::new, |p| p.time_constants_s.clone()),
        dead_time_s: point.as_ref().map(|p| p.dead_time_s),
        s0: solved.s0,
        constraint: "0 <= fd <= fs, fs + fd <= s0",
        evaluations: solved.outcome.evaluations,
        evaluations_limit: settings.budget,
        stopped: solved.outcome.stopped,
        lower_bound_mse: bound,
        bound: bound.map(|_| "heuristic"),
        elapsed_ms,
    }
}
