//! A place in the search for one model structure, and how well it fits.

use crate::core::sim::slips::FirstSlip;

/// Most parameters that a structure's effects have together.
pub(crate) const MAX_PARAMS: usize = 6;
/// Columns of a model, right-hand side included, at most.
pub(crate) const MAX_COLUMNS: usize = 11;

/// A place in the search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameters {
    /// Dead band plus stick band.
    pub s: f64,
    /// Slip jump.
    pub j: f64,
    /// First slip.
    pub first: FirstSlip,
    /// Kinetic band.
    pub fd: f64,
    /// Logarithm of the first time constant.
    pub log_tau: f64,
    /// Dead time plus one raw sample.
    pub lag: f64,
    /// The effects' parameters.
    pub p: [f64; MAX_PARAMS],
}

/// Linear coefficients of a model: those of the other columns first, then that of the response.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Linear {
    /// In the order in which the columns are made.
    pub others: [f64; MAX_COLUMNS],
    /// How many of them.
    pub count: usize,
    /// Of the response to the valve signal.
    pub gain: f64,
}

/// A theta and how well it fits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// Where.
    pub theta: Parameters,
    /// Squared error on the fitted blocks, in the view that was asked.
    pub sse: f64,
    /// Values of s and j that give the same slips.
    pub cells: [[f64; 2]; 2],
    /// Moves of the stem.
    pub slips: usize,
    /// The linear part.
    pub linear: Linear,
}

impl Candidate {
    /// Whether another place with the same parameters has the same slips.
    #[must_use]
    pub(crate) fn covers(&self, theta: &Parameters) -> bool {
        let within = |[low, high]: [f64; 2], x: f64| low <= x && x < high;
        theta.first == self.theta.first
            && theta.p == self.theta.p
            && within(self.cells[0], theta.s)
            && within(self.cells[1], theta.j)
    }
}
