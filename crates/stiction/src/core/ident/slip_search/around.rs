//! Many fits near one process: explores the surroundings of an answer, for its interval.

use super::candidate::Candidate;
use super::evaluator::{Evaluator, Polished};
use crate::core::ident::class::Class;
use crate::core::ident::evaluator::{LATTICE_STEP, Table, View, lattice_index};
use crate::core::ident::kinetic_band::{BandProfile, Freedom};
use crate::core::ident::normalised::Start;

/// Tables of time constants at and slightly beside those of a process, for many fits nearby.
#[derive(Debug, Clone)]
pub struct Around {
    /// At the process's own time constants, then with the first one longer and shorter, then the second.
    tables: Vec<Table>,
    class: Class,
}

/// Distance of the neighbouring time constants, in steps of the lattice.
const BESIDE: f64 = 0.5;

impl Evaluator<'_> {
    /// Tables around a process of the evaluator's class.
    #[must_use]
    pub(crate) fn around(&self, view: &View, process: &Polished) -> Around {
        let by = libm::exp(BESIDE * LATTICE_STEP);
        let count = if self.class == Class::Second { 2 } else { 1 };
        let mut tables: Vec<Table> = Vec::new();
        for tau in &process.taus[..count] {
            tables.extend([1.0, by, 1.0 / by].map(|f| view.table(tau * f)));
        }
        Around { tables, class: self.class }
    }

    /// A candidate whose time constants stay near those of `around`. If its error at the centre is below `enough`, the error is
    /// that of the best time constants by a quadratic model.
    pub(crate) fn fit_around(
        &mut self,
        view: &View,
        around: &Around,
        [s, j]: [f64; 2],
        start: Start,
        lag: f64,
        enough: f64,
    ) -> Option<Candidate> {
        let freedom = self.slip(s, j, start)?;
        let delay = lag.max(0.0) as usize;
        let mut fit = self.over_lags(view, around.pair([0, 0]), None, delay, &freedom, f64::INFINITY);
        fit.places = around.places();
        if fit.sse < enough && self.class != Class::Integrating {
            let is_second = self.class == Class::Second;
            let mut error = |which| self.over_lags(view, around.pair(which), None, fit.delay, &freedom, enough).sse;
            let one = [error([1, 0]), error([2, 0])];
            let lower = if is_second {
                let two = [error([0, 1]), error([0, 2])];
                let corner = error([1, 1]);
                let cross = corner - one[0] - two[0] + fit.sse;
                below(fit.sse, [one, two], cross)
            } else {
                below(fit.sse, [one, [fit.sse; 2]], 0.0)
            };
            fit.sse = lower;
        }
        Some(self.candidate([s, j], start, fit))
    }

    /// A candidate's squared error as a function of fd, with slips, time constants and lag fixed, and the range of fd that its
    /// slips allow.
    pub(crate) fn profile(&mut self, view: &View, around: &Around, of: &Candidate) -> Option<(BandProfile, [f64; 2])> {
        let freedom = self.slip(of.s, of.j, of.start)?;
        let reduced = self.reduced(view, around.pair([0, 0]), of.fit.delay);
        Some((BandProfile::new(reduced.system(of.fit.fraction), reduced.rest), freedom.fd))
    }

    /// Factor by which the standard error of fd grows when time constants and lag are free too, at least 1.
    pub(crate) fn band_stretch(&mut self, view: &View, of: &Candidate, process: &Polished) -> f64 {
        let Some(freedom) = self.slip(of.s, of.j, of.start) else { return 1.0 };
        let width = 0.05 * of.s;
        let around = self.around(view, process);
        let Some((profile, _)) = self.profile(view, &around, of) else { return 1.0 };
        let _ = self.slip(of.s, of.j, of.start);
        let (mut held, mut free) = (0.0, 0.0);
        for side in [-1.0, 1.0] {
            let fd = process.fd + side * width;
            let here = Freedom { fd: [fd; 2], fd_default: fd, ..freedom };
            held += profile.sse(fd) - process.sse;
            free += self.polish_fit(view, &of.fit, &here).sse - process.sse;
        }
        if held > free && free > 0.0 { (held / free).sqrt() } else { 1.0 }
    }
}

impl Around {
    fn pair(&self, which: [usize; 2]) -> [&Table; 2] {
        let second = if self.class == Class::Second { 3 + which[1] } else { which[0] };
        [&self.tables[which[0]], &self.tables[second]]
    }

    fn places(&self) -> [i32; 2] {
        let tau = |k: usize| self.tables.get(k).map_or(1.0, |t| t.tau);
        let first = lattice_index(tau(0));
        [first, if self.class == Class::Second { lattice_index(tau(3)).min(first - 1) } else { first }]
    }
}

/// Minimum of the quadratic model through a value, its neighbours in two directions and the mixed difference; the least of the
/// values if the model has no minimum.
fn below(value: f64, sides: [[f64; 2]; 2], cross: f64) -> f64 {
    let least = sides.iter().flatten().fold(value, |m, x| m.min(*x));
    if !sides.iter().flatten().all(|x| x.is_finite()) {
        return least;
    }
    let slope = sides.map(|[up, down]| 0.5 * (up - down));
    let curve = sides.map(|[up, down]| up + down - 2.0 * value);
    let alone = |i: usize| if curve[i] > 0.0 { 0.5 * slope[i] * slope[i] / curve[i] } else { 0.0 };
    let determinant = curve[0] * curve[1] - cross * cross;
    let gain = if curve[0] > 0.0 && determinant > 1e-3 * curve[0] * curve[1] {
        let [a, b] = slope;
        0.5 * (curve[1] * a * a - 2.0 * cross * a * b + curve[0] * b * b) / determinant
    } else {
        alone(0).max(alone(1))
    };
    // Beyond a few steps the model cannot be trusted.
    least.min((value - gain).max(0.9 * least))
}
