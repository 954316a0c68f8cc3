//! From bands and a first slip to a fitted candidate.

use super::candidate::{Candidate, LatticeFit};
use super::problem::Problem;
use crate::core::ident::class::Class;
use crate::core::ident::evaluator::{Best, HeldSums, Reduced, Table, View, lattice_index, lattice_tau, reduce};
use crate::core::ident::kinetic_band::{Freedom, band_freedom};
use crate::core::ident::least_squares::Gram;
use crate::core::ident::normalised::Start;
use crate::core::sim::slips::{Law, Stem};
use crate::core::sim::steps::Steps;

/// Most whole points by which the lag moves from its start.
const HOPS: usize = 12;
/// Walks over the lattice repeated at the same width.
const SAME_WIDTH: usize = 3;
/// Largest change of the lag, points, in exchange for time constants in one step.
const MOST_TRADED: f64 = 3.0;
/// Smallest lattice index of a time constant: 0.3 points.
const LEAST_PLACE: i32 = -30;
/// Step of finite differences off the lattice, in lattice steps, and the longest Newton step.
const FINE_STEP: f64 = 0.25;
const LONGEST_STEP: f64 = 2.0;

/// Fits processes to the slips of candidates; reuses its buffers and counts its work.
#[derive(Debug)]
pub(crate) struct Evaluator<'a> {
    /// The record.
    pub problem: &'a Problem<'a>,
    /// The valve law.
    pub law: Law,
    /// Class of the process.
    pub class: Class,
    /// Points of the record that are used, from its beginning.
    pub points: usize,
    /// Error models computed.
    pub evaluations: u64,
    /// Valve signals computed.
    pub signals: u64,
    steps: Steps,
    held: HeldSums,
    /// Lattice fits for the current steps: walks revisit the same places.
    known: Vec<(Known, Best)>,
}

/// Everything except the steps on which a lattice fit depends: indices, dead time, view, kinetic bands.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Known {
    class: Class,
    places: [i32; 2],
    delay: usize,
    rho: f64,
    points: usize,
    fd: [f64; 2],
}

/// A process whose time constants are off the lattice.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Polished {
    /// Squared error.
    pub sse: f64,
    /// Coefficient of the unit response.
    pub gain: f64,
    /// Kinetic band.
    pub fd: f64,
    /// Time constants, points, larger first.
    pub taus: [f64; 2],
    /// Dead time plus the sample that a held signal takes to act, points.
    pub lag: f64,
}

/// Runs `work` with an evaluator and the plain view of a whole record.
pub(crate) fn on_whole_record<T>(
    problem: &Problem<'_>,
    law: Law,
    class: Class,
    work: impl FnOnce(&mut Evaluator<'_>, &mut View) -> T,
) -> T {
    let points = problem.points();
    work(&mut Evaluator::new(problem, law, class, points), &mut problem.view(0.0, points))
}

impl<'a> Evaluator<'a> {
    /// An evaluator for the first `points` of a record.
    #[must_use]
    pub(crate) fn new(problem: &'a Problem<'a>, law: Law, class: Class, points: usize) -> Self {
        Self {
            problem,
            law,
            class,
            points,
            evaluations: 0,
            signals: 0,
            steps: Steps::default(),
            held: HeldSums::default(),
            known: Vec::new(),
        }
    }

    /// Runs the valve; returns the range of kinetic bands that its slips allow, or `None` if it moves too seldom or too often.
    pub(crate) fn slip(&mut self, s: f64, j: f64, start: Start) -> Option<Freedom> {
        let normalised = self.problem.normalised;
        self.signals += 1;
        self.held.clear();
        self.known.clear();
        let first = normalised.first_slip(start);
        self.steps.run(&normalised.path, self.points, normalised.stroke, self.law, [s, j], first);
        let [least, most] = self.problem.moves;
        let most = (most as f64 * self.points as f64 / normalised.period) as usize + 30;
        if self.steps.slips < least || self.steps.slips > most {
            return None;
        }
        let cells = [self.steps.s_cell, self.steps.j_cell];
        let mut freedom = band_freedom(cells, [s, j], self.problem.sign, normalised.limits, normalised.slip_end);
        if let Some(behind) = self.problem.behind {
            let before = Stem::before(first, [s, j], normalised.stroke, normalised.path.per_point()).signal();
            behind.shape(&mut self.steps, before.into(), &mut freedom, self.points);
        }
        Some(freedom)
    }

    /// The current valve signal.
    #[must_use]
    pub(crate) const fn steps(&self) -> &Steps {
        &self.steps
    }

    /// Uses OP itself as the valve signal.
    pub(crate) fn follow_op(&mut self) {
        self.held.clear();
        self.known.clear();
        self.steps.of_signal(&self.problem.normalised.mean, &[]);
        self.steps.list.retain(|s| (s.point as usize) < self.points);
    }

    /// Allowed range of the lag, whole points.
    fn delays(&self) -> [usize; 2] {
        self.problem.normalised.limits.lag.map(|l| l.max(0.0) as usize)
    }

    /// Allowed fractions of a point for a lag of `delay` whole points.
    fn fractions(&self, delay: usize) -> [f64; 2] {
        self.problem.normalised.limits.lag.map(|l| (l - delay as f64).clamp(0.0, 1.0))
    }

    /// Limits lattice indices to those that the class allows.
    fn clamp(&self, places: [i32; 2]) -> [i32; 2] {
        let most = self.problem.most_place(self.class);
        let second = self.class == Class::Second;
        let first = places[0].clamp(LEAST_PLACE + i32::from(second), most);
        [first, if second { places[1].clamp(LEAST_PLACE, first - 1) } else { first }]
    }

    /// The best fit at one place of the lattice, starting from a lag; tries neighbouring lags while that helps, unless the
    /// error is above `enough`.
    fn at(&mut self, view: &mut View, places: [i32; 2], delay: usize, freedom: &Freedom, enough: f64) -> LatticeFit {
        let places = self.clamp(places);
        let first = view.on_lattice(places[0]);
        let second = if places[1] == places[0] { first.clone() } else { view.on_lattice(places[1]) };
        self.over_lags(view, [&first, &second], Some(places), delay, freedom, enough)
    }

    /// The best dead time within one whole point, at `places` of the lattice or off it.
    fn best_at(
        &mut self,
        view: &View,
        tables: [&Table; 2],
        places: Option<[i32; 2]>,
        delay: usize,
        freedom: &Freedom,
    ) -> Best {
        let (class, rho, points, fd) = (self.class, view.rho(), view.points(), freedom.fd);
        let known = places.map(|places| Known { class, places, delay, rho, points, fd });
        if let Some((_, best)) = known.and_then(|known| self.known.iter().find(|(k, _)| *k == known)) {
            return *best;
        }
        self.evaluations += 1;
        let best = self.reduced(view, tables, delay).best(freedom, self.fractions(delay));
        self.known.extend(known.map(|known| (known, best)));
        best
    }

    pub(super) fn over_lags(
        &mut self,
        view: &View,
        tables: [&Table; 2],
        on_lattice: Option<[i32; 2]>,
        delay: usize,
        freedom: &Freedom,
        enough: f64,
    ) -> LatticeFit {
        let [least, most] = self.delays();
        let places = on_lattice.unwrap_or_default();
        let mut delay = delay.clamp(least, most);
        let mut best =
            LatticeFit { sse: f64::INFINITY, gain: 0.0, fd: freedom.fd_default, places, delay, fraction: 0.0 };
        let mut last = 0;
        for _ in 0..HOPS {
            let fractions = self.fractions(delay);
            let found = self.best_at(view, tables, on_lattice, delay, freedom);
            if found.sse >= best.sse {
                break;
            }
            best =
                LatticeFit { sse: found.sse, gain: found.gain, fd: found.fd, places, delay, fraction: found.fraction };
            let way: i32 = if found.fraction < 1e-3 {
                -1
            } else if found.fraction > 0.999 {
                1
            } else {
                0
            };
            if found.sse > enough || way == 0 || way == -last || fractions[1] - fractions[0] < 1e-3 {
                break;
            }
            last = way;
            match delay.checked_add_signed(way as isize).filter(|d| (least..=most).contains(d)) {
                Some(next) => delay = next,
                None => break,
            }
        }
        best
    }

    /// Improves a fit over the lattice: by a quadratic model of the error through places `width` apart, then ever closer ones;
    /// the lag moves against the time constants.
    fn walk(&mut self, view: &mut View, from: LatticeFit, freedom: &Freedom, width: i32, trade: bool) -> LatticeFit {
        if self.class == Class::Integrating {
            return if trade { self.hop(view, from, freedom) } else { from };
        }
        let count = if self.class == Class::Second { 2 } else { 1 };
        let (mut best, mut width, mut again) = (from, width, SAME_WIDTH);
        while width >= 1 {
            let home = best;
            let (mut slope, mut curve, mut cross, mut corner) = ([0.0; 2], [0.0; 2], 0.0, 0.0);
            for i in 0..count {
                let mut by = [0; 2];
                by[i] = width;
                let up = self.beside(view, &home, by, freedom, &mut best);
                by[i] = -width;
                let down = self.beside(view, &home, by, freedom, &mut best);
                slope[i] = 0.5 * (up - down);
                curve[i] = up - 2.0 * home.sse + down;
                corner += up - home.sse;
            }
            if count == 2 {
                cross = self.beside(view, &home, [width; 2], freedom, &mut best) - home.sse - corner;
            }
            let step = newton(slope, curve, cross, count).map(|x| (x * f64::from(width)).round() as i32);
            if step.iter().any(|x| x.abs() > width) || step != [0; 2] && count == 2 {
                self.beside(view, &home, step, freedom, &mut best);
            }
            let far = (0..count).any(|i| (best.places[i] - home.places[i]).abs() > width);
            if best.sse < home.sse && (far || width == 1) && again > 0 {
                again -= 1;
            } else {
                width /= if width > 2 { 4 } else { 2 };
                again = SAME_WIDTH;
            }
        }
        best
    }

    /// The error at a place `by` lattice steps from a fit, with the lag moved against the time constants; keeps the best so
    /// far.
    fn beside(
        &mut self,
        view: &mut View,
        home: &LatticeFit,
        by: [i32; 2],
        freedom: &Freedom,
        best: &mut LatticeFit,
    ) -> f64 {
        let places = self.clamp([home.places[0] + by[0], home.places[1] + by[1]]);
        if places == home.places {
            return home.sse;
        }
        let grown = |i: usize| lattice_tau(places[i]) - lattice_tau(home.places[i]);
        let later = match self.class {
            Class::First => 0.5 * grown(0),
            Class::Second => grown(0) + grown(1),
            _ => 0.0,
        };
        // A much slower lag changes the dead time by a few points at most.
        let delay = (home.lag() - later.clamp(-MOST_TRADED, MOST_TRADED)).max(0.0) as usize;
        let found = self.at(view, places, delay, freedom, f64::INFINITY);
        if found.sse < best.sse {
            *best = found;
        }
        found.sse
    }

    /// The same time constants with other lags: the error has kinks at whole points.
    fn hop(&mut self, view: &mut View, from: LatticeFit, freedom: &Freedom) -> LatticeFit {
        let mut best = from;
        for by in [-4, -2, 2, 4] {
            let delay = from.delay.saturating_add_signed(by);
            let found = self.at(view, from.places, delay, freedom, f64::INFINITY);
            if found.sse < best.sse {
                best = found;
            }
        }
        best
    }

    /// A quick fit starting from the process `near`, refined only if its error is below `enough`.
    pub(crate) fn fit(
        &mut self,
        view: &mut View,
        [s, j]: [f64; 2],
        start: Start,
        near: &LatticeFit,
        enough: f64,
    ) -> Option<Candidate> {
        let freedom = self.slip(s, j, start)?;
        let mut fit = self.at(view, near.places, near.delay, &freedom, enough);
        if fit.sse < enough {
            fit = self.walk(view, fit, &freedom, 1, false);
        }
        Some(self.candidate([s, j], start, fit))
    }

    /// The best process for given bands and first slip behind the current valve signal, starting from a single lag; `freedom`
    /// gives the kinetic band.
    pub(crate) fn at_bands(
        &mut self,
        view: &mut View,
        bands: [f64; 2],
        start: Start,
        single: &LatticeFit,
        freedom: &Freedom,
    ) -> Option<Candidate> {
        let fit = if self.class == Class::First {
            let fit = self.at(view, single.places, single.delay, freedom, f64::INFINITY);
            self.walk(view, fit, freedom, 2, false)
        } else {
            let taus = single.places.map(lattice_tau);
            let starts = self.starts_in(Class::First, self.class, taus, single.lag());
            let fits = starts.map(|(taus, lag)| {
                let places = taus.map(|t| lattice_index(t.max(lattice_tau(LEAST_PLACE))));
                let fit = self.at(view, places, lag.max(0.0) as usize, freedom, f64::INFINITY);
                self.walk(view, fit, freedom, 4, true)
            });
            fits.into_iter().reduce(|a, b| if b.sse < a.sse { b } else { a })?
        };
        Some(self.candidate(bands, start, fit))
    }

    /// The best process near `from` for given bands and first slip.
    pub fn met(&mut self, view: &mut View, [s, j]: [f64; 2], start: Start, from: &LatticeFit) -> Option<Candidate> {
        let freedom = self.slip(s, j, start)?;
        let fit = self.settle_fit(view, from, &freedom);
        Some(self.candidate([s, j], start, fit))
    }

    /// A candidate of this class, fitted until no lattice step helps.
    pub(crate) fn settle(&mut self, view: &mut View, from: &Candidate) -> Option<Candidate> {
        self.law = from.law;
        let freedom = self.slip(from.s, from.j, from.start)?;
        let fit = self.settle_fit(view, &from.fit, &freedom);
        Some(self.candidate([from.s, from.j], from.start, fit))
    }

    /// The normal equations of the current valve signal for these tables and a dead time of `delay` whole points.
    pub(super) fn reduced(&mut self, view: &View, tables: [&Table; 2], delay: usize) -> Reduced {
        reduce(self.class, view, tables, &self.steps.list, delay, &mut self.held)
    }

    /// The best process near `from` behind the current valve signal.
    pub(crate) fn settle_fit(&mut self, view: &mut View, from: &LatticeFit, freedom: &Freedom) -> LatticeFit {
        let fit = self.at(view, from.places, from.delay, freedom, f64::INFINITY);
        let mut best = self.walk(view, fit, freedom, 8, true);
        for by in [-2, 2] {
            let delay = best.delay.saturating_add_signed(by);
            let near = self.at(view, best.places, delay, freedom, f64::INFINITY);
            if near.sse < 1.5 * best.sse {
                let near = self.walk(view, near, freedom, 1, false);
                if near.sse < best.sse {
                    best = near;
                }
            }
        }
        best
    }

    /// A candidate of any class refitted in the class `to`; the evaluator keeps that class.
    pub(crate) fn in_class(&mut self, view: &mut View, from: &Candidate, to: Class) -> Option<Candidate> {
        (self.law, self.class) = (from.law, to);
        if from.class == to {
            return self.settle(view, from);
        }
        let freedom = self.slip(from.s, from.j, from.start)?;
        let taus = from.taus();
        let fits = self.starts_in(from.class, to, taus, from.fit.lag()).map(|(taus, lag)| {
            let places = taus.map(|t| lattice_index(t.max(lattice_tau(LEAST_PLACE))));
            let start = LatticeFit { places, delay: lag.max(0.0) as usize, ..from.fit };
            self.settle_fit(view, &start, &freedom)
        });
        let fit = fits.into_iter().reduce(|a, b| if b.sse < a.sse { b } else { a })?;
        Some(self.candidate([from.s, from.j], from.start, fit))
    }

    /// Two starting points for a process of another class: a new second lag takes its time from the first lag or the dead time,
    /// and a dropped one returns it there.
    fn starts_in(&self, from: Class, to: Class, taus: [f64; 2], lag: f64) -> [([f64; 2], f64); 2] {
        let period = self.problem.normalised.period;
        // An integrator has no lag; use one as slow as the record is long.
        let slow = lattice_tau(self.problem.most_place(Class::First));
        let [main, lost] = match from {
            Class::First => [taus[0], 0.0],
            Class::Second => taus,
            Class::Integrating => [slow, 0.0],
            Class::LagIntegrating => [slow, taus[0]],
        };
        match to {
            Class::First | Class::Integrating => [([main; 2], lag + lost), ([main.min(period); 2], lag)],
            Class::Second => [
                ([main, (0.3 * main).min(0.5 * lag.max(1.0) + lost)], lag - 0.2 * main.min(lag)),
                ([main, 0.25 * lag.max(1.0)], 0.75 * lag),
            ],
            Class::LagIntegrating => [([0.5 * lag.max(1.0); 2], 0.6 * lag), ([2.0 * lag.max(1.0); 2], 0.2 * lag)],
        }
    }

    /// A candidate with the current slips.
    pub(super) fn candidate(&self, [s, j]: [f64; 2], start: Start, fit: LatticeFit) -> Candidate {
        let steps = &self.steps;
        Candidate {
            law: self.law,
            class: self.class,
            s,
            j,
            start,
            cells: [steps.s_cell, steps.j_cell],
            slips: steps.slips,
            reversals: steps.reversals,
            fit,
        }
    }

    /// A candidate with the process from a coarse look: time constant (points), lag and error.
    pub(crate) fn seen(&self, [s, j]: [f64; 2], start: Start, sse: f64, tau: f64, lag: f64) -> Candidate {
        let place = lattice_index(tau);
        let (delay, gain) = (lag as usize, self.problem.sign);
        let fit = LatticeFit { sse, gain, fd: 0.0, places: [place; 2], delay, fraction: lag.fract() };
        self.candidate([s, j], start, fit)
    }

    /// A candidate's process with its time constants off the lattice: Newton steps on finite differences of the error; each
    /// evaluation solves for the dead time and all linear parameters.
    pub(crate) fn polish(&mut self, view: &View, of: &Candidate) -> Option<Polished> {
        (self.law, self.class) = (of.law, of.class);
        let freedom = self.slip(of.s, of.j, of.start)?;
        Some(self.polish_fit(view, &of.fit, &freedom))
    }

    /// The same for the current valve signal.
    pub(crate) fn polish_fit(&mut self, view: &View, of: &LatticeFit, freedom: &Freedom) -> Polished {
        let places = self.clamp(of.places).map(f64::from);
        let mut best = self.off_lattice(view, places, of.delay, freedom);
        let mut at = places;
        let count = match self.class {
            Class::Integrating => return best,
            Class::Second => 2,
            _ => 1,
        };
        let mut width = 1.0;
        for _ in 0..4 {
            let delay = best.lag as usize;
            let mut look = |by: [f64; 2]| self.off_lattice(view, [at[0] + by[0], at[1] + by[1]], delay, freedom);
            let (mut slope, mut curve, mut cross) = ([0.0; 2], [0.0; 2], 0.0);
            let mut corner = 0.0;
            for i in 0..count {
                let mut by = [0.0; 2];
                by[i] = width;
                let up = look(by).sse;
                by[i] = -width;
                let down = look(by).sse;
                slope[i] = 0.5 * (up - down) / width;
                curve[i] = (up - 2.0 * best.sse + down) / (width * width);
                corner += up - best.sse;
            }
            if count == 2 {
                cross = (look([width, width]).sse - best.sse - corner) / (width * width);
            }
            let step = newton(slope, curve, cross, count);
            let next = [at[0] + step[0], at[1] + step[1]];
            let found = self.off_lattice(view, next, delay, freedom);
            if found.sse < best.sse {
                let gained = best.sse - found.sse;
                (best, at) = (found, next);
                if gained < 1e-7 * best.sse {
                    break;
                }
            } else if width <= FINE_STEP {
                break;
            }
            width = FINE_STEP;
        }
        best
    }

    /// The best fit for time constants between lattice points.
    fn off_lattice(&mut self, view: &View, mut places: [f64; 2], delay: usize, freedom: &Freedom) -> Polished {
        let most = f64::from(self.problem.most_place(self.class));
        places[0] = places[0].clamp(f64::from(LEAST_PLACE), most);
        if self.class == Class::Second {
            places[1] = places[1].clamp(f64::from(LEAST_PLACE) - 1.0, places[0] - 0.5);
        }
        let taus = places.map(|p| libm::exp(p * crate::core::ident::evaluator::LATTICE_STEP));
        let first = view.table(taus[0]);
        let second = (self.class == Class::Second).then(|| view.table(taus[1]));
        let tables = [&first, second.as_ref().unwrap_or(&first)];
        let fit = self.over_lags(view, tables, None, delay, freedom, f64::INFINITY);
        Polished { sse: fit.sse, gain: fit.gain, fd: fit.fd, taus, lag: fit.lag() }
    }

    /// Residual of a process behind the candidate's valve signal, on all points from the view's first on; constant, memory and
    /// loads are fitted to the counted points.
    pub(crate) fn residual(&mut self, view: &View, of: &Candidate, process: &Polished) -> Vec<f64> {
        (self.law, self.class) = (of.law, of.class);
        if self.slip(of.s, of.j, of.start).is_none() {
            return Vec::new();
        }
        self.leftover(view, process)
    }

    /// The same for the current valve signal.
    pub(crate) fn leftover(&self, view: &View, process: &Polished) -> Vec<f64> {
        let (class, n) = (self.class, view.points());
        let valve = self.signal(n, process.fd);
        let shape = class.shape(process.taus, process.lag);
        let out = class.respond(&shape, &valve);
        let from = view.from();
        let pv = self.problem.pv();
        let mut left: Vec<f64> = (from..n).map(|k| pv[k] - process.gain * out[k]).collect();
        let rho = view.rho();
        let filtered = |x: &dyn Fn(usize) -> f64| -> Vec<f64> {
            let counted = view.counted().iter().flat_map(|[a, b]| *a..*b);
            counted.map(|k| x(k) - rho * x(k - 1)).collect()
        };
        let mut beside: Vec<Vec<f64>> = vec![vec![1.0; n]];
        for index in 1..class.memory_len() {
            let mut column = Vec::new();
            class.memory(&shape, index, from, n - from, 0.0, &mut column);
            column.resize(n - from, 0.0);
            let first = column.first().copied().unwrap_or(0.0);
            beside.push(core::iter::repeat_n(first, from).chain(column).collect());
        }
        beside.extend(self.problem.loads.iter().cloned());
        let mut columns: Vec<Vec<f64>> = beside.iter().map(|c| filtered(&|k| c[k])).collect();
        columns.push(filtered(&|k| pv[k] - process.gain * out[k]));
        let slices: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
        let mut gram = Gram::of(&slices);
        gram.eliminate(beside.len());
        let coefficients = gram.back(beside.len(), &[]);
        for (column, c) in beside.iter().zip(coefficients) {
            for (l, x) in left.iter_mut().zip(&column[from..]) {
                *l -= c * x;
            }
        }
        left
    }

    /// The current valve signal with a kinetic band, per point, from 0 at the record's beginning.
    fn signal(&self, n: usize, fd: f64) -> Vec<f64> {
        let mut out = vec![0.0; n];
        let (mut value, mut from) = (0.0, 0);
        for step in &self.steps.list {
            let point = (step.point as usize).min(n);
            out[from..point].fill(value);
            value += step.level - fd * step.direction;
            from = point;
        }
        out[from..].fill(value);
        out
    }
}

/// Shortened Newton step for one or two indices; a whole step downhill if the error is not convex.
fn newton(slope: [f64; 2], curve: [f64; 2], cross: f64, count: usize) -> [f64; 2] {
    let short = |x: f64| x.clamp(-LONGEST_STEP, LONGEST_STEP);
    let determinant = curve[0] * curve[1] - cross * cross;
    if count == 2 && curve[0] > 0.0 && determinant > 1e-6 * curve[0] * curve[1] {
        let x = (curve[1] * slope[0] - cross * slope[1]) / determinant;
        let y = (curve[0] * slope[1] - cross * slope[0]) / determinant;
        return [short(-x), short(-y)];
    }
    let mut out = [0.0; 2];
    for i in 0..count {
        out[i] = if curve[i] > 0.0 { short(-slope[i] / curve[i]) } else { -slope[i].signum() };
    }
    out
}
