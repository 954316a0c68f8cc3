//! One candidate of the search: bands, first slip, and the best process for the resulting slips.

use crate::core::ident::class::Class;
use crate::core::ident::evaluator::lattice_tau;
use crate::core::ident::normalised::Start;
use crate::core::sim::slips::Law;

/// A fitted candidate. Sizes in spans of OP, times in points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// The valve law.
    pub law: Law,
    /// Class of the process.
    pub class: Class,
    /// Dead band plus stick band.
    pub s: f64,
    /// Slip jump.
    pub j: f64,
    /// First slip.
    pub start: Start,
    /// Ranges of s, then of j, that give the same slips.
    pub cells: [[f64; 2]; 2],
    /// Moves of the stem.
    pub slips: usize,
    /// Reversals of the stem.
    pub reversals: usize,
    /// The process model.
    pub fit: LatticeFit,
}

/// A process fitted with its time constants on the lattice.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LatticeFit {
    /// Squared error in the view to which it was fitted.
    pub sse: f64,
    /// Coefficient of the unit response; 0 if no gain of the requested sign helps.
    pub gain: f64,
    /// Kinetic band.
    pub fd: f64,
    /// Lattice indices of the time constants, the larger first; meaningless if the class lacks them.
    pub places: [i32; 2],
    /// Whole points of the lag, and its fraction, 0..1.
    pub delay: usize,
    /// See `delay`.
    pub fraction: f64,
}

impl LatticeFit {
    /// Dead time plus the sample that a held signal takes to act, points.
    #[must_use]
    pub(crate) fn lag(&self) -> f64 {
        self.delay as f64 + self.fraction
    }
}

impl Candidate {
    /// Whether (s, j) with the same start gives the same slips.
    #[must_use]
    pub(crate) fn covers(&self, s: f64, j: f64, start: Start) -> bool {
        let within = |[low, high]: [f64; 2], x: f64| low <= x && x < high;
        self.start == start && within(self.cells[0], s) && within(self.cells[1], j)
    }

    /// Squared error.
    #[must_use]
    pub(crate) const fn sse(&self) -> f64 {
        self.fit.sse
    }

    /// Time constants, points, the larger first; meaningless where the class lacks them.
    #[must_use]
    pub(crate) fn taus(&self) -> [f64; 2] {
        self.fit.places.map(lattice_tau)
    }

    /// Whether two candidates are too similar to keep both.
    fn is_near(&self, other: &Self) -> bool {
        self.law == other.law && (self.s / other.s - 1.0).abs() <= 0.012 && (self.j - other.j).abs() <= 0.05 * other.s
    }
}

/// The best candidates that differ clearly, best first: `overall` by error, then `each` from every third of j / s; otherwise
/// models that slip at every sample would fill the list.
#[must_use]
pub(crate) fn apart(pool: &[Candidate], overall: usize, each: usize) -> Vec<Candidate> {
    let mut order: Vec<&Candidate> = pool.iter().filter(|c| c.fit.gain != 0.0).collect();
    order.sort_by(|a, b| a.sse().total_cmp(&b.sse()));
    let mut chosen: Vec<Candidate> = Vec::new();
    for c in &order {
        if chosen.len() == overall {
            break;
        }
        if !chosen.iter().any(|o| o.is_near(c)) {
            chosen.push(**c);
        }
    }
    for third in 0..3 {
        let mut taken = 0;
        for c in order.iter().filter(|c| ((3.0 * c.j.min(c.s) / c.j.max(c.s)) as usize).min(2) == third) {
            if taken == each {
                break;
            }
            if !chosen.iter().any(|o| o.is_near(c)) {
                chosen.push(**c);
                taken += 1;
            }
        }
    }
    chosen.sort_by(|a, b| a.sse().total_cmp(&b.sse()));
    chosen
}
