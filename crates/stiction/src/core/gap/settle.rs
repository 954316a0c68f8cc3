//! Local search in what is continuous: time constants and dead time behind a valve signal that is held, parameters of
//! effects, and at the end all of them off the lattice. Only costs are asked for, no slopes.

use nalgebra::{DMatrix, DVector};

use super::candidate::{Candidate, MAX_PARAMS, Parameters};
use super::effects::{Reach, Unit};
use super::evaluator::{Evaluator, Place, Prepared};
use super::problem::{Problem, View};
use super::structure::Structure;
use crate::core::ident::evaluator::{LATTICE_STEP, lattice_tau};
use crate::core::ident::normalised::{MOST_OVERSHOOT, SlipEnd};

/// Settings of the local search in what is continuous.
struct Settings {
    /// Moves of one size along the lattice at most: beyond that a place is hopeless.
    moves: usize,
    /// Share of a point at the ends of which the dead time goes on to the next whole point.
    edge: f64,
    /// First step along a parameter, as a share of its range, and the factor by which steps grow and shrink.
    first: f64,
    grow: f64,
    shrink: f64,
    /// Step below which a parameter is settled, as a share of its range.
    last: f64,
    /// Differences for the last refinement, in logarithm of time and as a share of a parameter's range.
    difference: f64,
    /// Rounds of the last refinement.
    rounds: usize,
}

const SETTINGS: Settings =
    Settings { moves: 12, edge: 2e-3, first: 0.03, grow: 2.0, shrink: 0.3, last: 5e-4, difference: 0.01, rounds: 3 };

/// Steps along the lattice for a place that is far off, for one near by, and for one that is nearly right.
pub(crate) const FAR: &[i32] = &[8, 3, 1];
pub(crate) const NEAR: &[i32] = &[2, 1];
pub(crate) const LAST: &[i32] = &[1];

/// The parameter vector inside its bounds.
#[must_use]
pub(crate) fn clamped(structure: &Structure, mut theta: Parameters, problem: &Problem) -> Parameters {
    let limits = problem.normalised.limits;
    theta.log_tau = theta.log_tau.clamp(libm::log(limits.tau[0]), libm::log(limits.tau[1]));
    theta.lag = theta.lag.clamp(limits.lag[0], limits.lag[1]);
    for (value, param) in theta.p.iter_mut().zip(structure.params()) {
        let [low, high] = param.bounds(problem);
        *value = value.clamp(low, high);
    }
    theta.s = theta.s.clamp(1e-4, 1.5);
    match structure.plan(&theta).slip_end() {
        SlipEnd::Beyond => {
            theta.j = theta.j.clamp(0.0, 39.0 * theta.s);
            theta.fd = theta.fd.clamp(-MOST_OVERSHOOT * 0.5 * (theta.s + theta.j), 0.5 * theta.s);
        }
        SlipEnd::Short => {
            theta.j = theta.j.clamp(0.0, theta.s);
            theta.fd = theta.fd.clamp(0.0, 0.5 * theta.s);
        }
    }
    theta
}

/// The parameter vector where its structure may stand; for a stem that may overshoot also the same way back and as far
/// beyond.
#[must_use]
pub(crate) fn fitted_to(structure: &Structure, mut theta: Parameters, problem: &Problem) -> Vec<Parameters> {
    if structure.plan(&theta).slip_end() == SlipEnd::Beyond {
        // The base is among its models: it must never do worse.
        let mut out = vec![clamped(structure, theta, problem)];
        if theta.j < theta.s {
            // The slips stay: fd turns.
            theta.j = theta.s * (1.0 + 0.5 * (1.0 - theta.j / theta.s.max(1e-9)));
            theta.fd = 0.5 * (theta.s - theta.j);
            out.push(clamped(structure, theta, problem));
        }
        return out;
    }
    if theta.j > theta.s {
        theta.j = theta.s;
        theta.fd = 0.0;
    }
    vec![clamped(structure, theta, problem)]
}

impl Evaluator<'_> {
    /// The candidate of a parameter vector, its process settled by steps of these sizes along the lattice.
    pub(crate) fn fit(
        &mut self,
        structure: &Structure,
        theta: &Parameters,
        view: View,
        sizes: &[i32],
    ) -> Option<Candidate> {
        let prepared = self.prepare(structure, theta)?;
        let place = self.place_of(&prepared);
        let start = self.at(structure, &prepared, place, view);
        self.settle_process(structure, &prepared, (place, start), view, sizes)
    }

    /// The best process behind the signal prepared last, from a place and its candidate.
    pub(crate) fn settle_process(
        &mut self,
        structure: &Structure,
        prepared: &Prepared,
        (place, start): (Place, Option<Candidate>),
        view: View,
        sizes: &[i32],
    ) -> Option<Candidate> {
        let (mut place, mut best) = (place, start?);
        for size in sizes {
            for _ in 0..SETTINGS.moves {
                let mut better = None;
                for next in self.neighbours(prepared, place, &best, *size) {
                    let found = self.at(structure, prepared, next, view);
                    if let Some(found) = found.filter(|f| f.sse < best.sse) {
                        better = Some((next, found));
                        break;
                    }
                }
                let Some((next, found)) = better else { break };
                (place, best) = (next, found);
            }
        }
        Some(best)
    }

    /// Places beside one on the lattice: the dead time's next whole point where it stands at an end of its own, and each
    /// time constant to either side, with the dead time that keeps their sum and with the same.
    fn neighbours(&self, prepared: &Prepared, place: Place, at: &Candidate, size: i32) -> Vec<Place> {
        let limits = self.problem.normalised.limits;
        let fraction = at.theta.lag - f64::from(place.delay);
        let mut out = Vec::with_capacity(12);
        let mut put = |tau: [i32; 2], delay: i32| {
            let fits = |index: i32| {
                let tau = lattice_tau(index);
                tau >= 0.98 * limits.tau[0] && tau <= 1.02 * limits.tau[1]
            };
            let two = prepared.has_two_lags();
            let delay = delay.clamp(limits.lag[0].floor() as i32, limits.lag[1].floor() as i32);
            let next = Place { tau, delay };
            if fits(tau[0]) && (!two || fits(tau[1]) && tau[0] != tau[1]) && next != place && !out.contains(&next) {
                out.push(next);
            }
        };
        let step = if size > 1 { size } else { 1 };
        if prepared.is_plain() || fraction <= SETTINGS.edge {
            put(place.tau, place.delay - step);
        }
        if prepared.is_plain() || fraction >= 1.0 - SETTINGS.edge {
            put(place.tau, place.delay + step);
        }
        if !prepared.has_lag() {
            return out;
        }
        let moves: &[[i32; 2]] = if prepared.has_two_lags() {
            &[[1, 0], [-1, 0], [0, 1], [0, -1], [1, -1], [-1, 1]]
        } else {
            &[[1, 1], [-1, -1]]
        };
        for [first, second] in moves {
            let tau = [place.tau[0] + first * size, place.tau[1] + second * size];
            let sum = |t: [i32; 2]| lattice_tau(t[0]) + if prepared.has_two_lags() { lattice_tau(t[1]) } else { 0.0 };
            let kept = (at.theta.lag - (sum(tau) - sum(place.tau))).floor() as i32;
            put(tau, kept);
            put(tau, place.delay);
        }
        out
    }

    /// A candidate with its continuous parameters settled one after the other by parabolas, each with what the model
    /// trades for it and alone.
    pub(crate) fn settle_parameters(
        &mut self,
        structure: &Structure,
        start: Candidate,
        view: View,
        rounds: usize,
    ) -> Candidate {
        let mut best = start;
        let slots = self.slots(structure, &best);
        let mut steps: Vec<f64> = slots.iter().map(|(_, width)| SETTINGS.first * width).collect();
        for _ in 0..rounds {
            for ((slot, width), step) in slots.iter().zip(&mut steps) {
                if *step < SETTINGS.last * width {
                    continue;
                }
                let found = self.along(structure, &best, *slot, *step, view);
                match found {
                    Some((found, wider)) => {
                        best = found;
                        *step *= if wider { SETTINGS.grow } else { SETTINGS.shrink };
                    }
                    None => *step *= SETTINGS.shrink,
                }
            }
        }
        best
    }

    /// The continuous parameters of a structure and the widths of their ranges.
    fn slots(&self, structure: &Structure, at: &Candidate) -> Vec<(Slot, f64)> {
        let mut out = Vec::with_capacity(MAX_PARAMS + 1);
        let plan = structure.plan(&at.theta);
        if plan.law.is_some() && !plan.is_linear_in_fd() && !plan.zero {
            out.push((Slot::Fd, 0.5 * at.theta.s));
        }
        for (i, param) in structure.params().enumerate() {
            if param.unit != Unit::Choice && param.reach != Reach::SecondLag {
                let [low, high] = param.bounds(self.problem);
                out.push((Slot::Param(i), high - low));
            }
        }
        out
    }

    /// A better place along one parameter, and whether it lies a whole step away.
    fn along(
        &mut self,
        structure: &Structure,
        from: &Candidate,
        slot: Slot,
        step: f64,
        view: View,
    ) -> Option<(Candidate, bool)> {
        let mut sides = [f64::INFINITY; 2];
        let mut better: Option<Candidate> = None;
        for (side, by) in sides.iter_mut().zip([step, -step]) {
            if let Some(found) = self.shifted(structure, from, slot, by, view) {
                *side = found.sse;
                if found.sse < better.map_or(from.sse, |b| b.sse) {
                    better = Some(found);
                }
            }
            if better.is_some() {
                break;
            }
        }
        if let Some(found) = better {
            return Some((found, true));
        }
        let [up, down] = sides.map(|s| s - from.sse);
        if !(up.is_finite() && down.is_finite() && up + down > 0.0) {
            return None;
        }
        let by = 0.5 * step * (down - up) / (up + down);
        let found = self.shifted(structure, from, slot, by, view)?;
        (found.sse < from.sse).then_some((found, false))
    }

    /// The candidate with one parameter moved, what the model trades for it given way; or alone where that is better.
    fn shifted(
        &mut self,
        structure: &Structure,
        from: &Candidate,
        slot: Slot,
        by: f64,
        view: View,
    ) -> Option<Candidate> {
        let mut theta = from.theta;
        match slot {
            Slot::Fd => theta.fd += by,
            Slot::Tau => theta.log_tau += by,
            Slot::Param(i) => theta.p[i] += by,
        }
        let alone = clamped(structure, theta, self.problem);
        if let Slot::Param(i) = slot {
            structure.trade(&mut theta, i, by, self.problem.normalised.rate);
        }
        let traded = clamped(structure, theta, self.problem);
        let first = if alone == from.theta { None } else { self.fit(structure, &alone, view, LAST) };
        if traded == alone {
            return first;
        }
        let second = self.fit(structure, &traded, view, LAST);
        match (first, second) {
            (Some(a), Some(b)) => Some(if b.sse < a.sse { b } else { a }),
            (a, b) => a.or(b),
        }
    }

    /// The last refinement: time constants and parameters of effects off the lattice, by quadratic models of the plain
    /// error that differences of costs make.
    pub(crate) fn refine(&mut self, structure: &Structure, start: Candidate) -> Candidate {
        let mut best = start;
        let mut size = SETTINGS.difference;
        for _ in 0..SETTINGS.rounds {
            let Some(next) = self.quadratic_step(structure, &best, size) else { break };
            let gained = (best.sse - next.sse) / best.sse;
            if next.sse < best.sse {
                best = next;
            }
            if gained < 1e-5 {
                size *= SETTINGS.shrink;
            }
        }
        best
    }

    /// Where a quadratic model around a place has its least error, or the best of the places asked for it.
    fn quadratic_step(&mut self, structure: &Structure, at: &Candidate, size: f64) -> Option<Candidate> {
        let mut axes = self.slots(structure, at);
        axes.iter_mut().for_each(|(_, width)| *width *= size);
        let plan = structure.plan(&at.theta);
        if !plan.integrating {
            axes.push((Slot::Tau, LATTICE_STEP.min(4.0 * size)));
        }
        for (i, param) in structure.params().enumerate() {
            if param.reach == Reach::SecondLag {
                axes.push((Slot::Param(i), LATTICE_STEP.min(4.0 * size)));
            }
        }
        let n = axes.len();
        if n == 0 {
            return None;
        }
        let mut best = *at;
        let mut ask = |evaluator: &mut Self, steps: &[f64]| -> Option<f64> {
            let found = evaluator.off_place(structure, &at.theta, &axes, steps)?;
            if found.sse < best.sse {
                best = found;
            }
            Some(found.sse)
        };
        let unit = |i: usize, by: f64| -> Vec<f64> { (0..n).map(|k| if k == i { by } else { 0.0 }).collect() };
        let middle = ask(self, &vec![0.0; n])?;
        let (mut slope, mut curve) = (DVector::zeros(n), DMatrix::zeros(n, n));
        let mut ups = vec![0.0; n];
        for i in 0..n {
            let (Some(up), Some(down)) = (ask(self, &unit(i, 1.0)), ask(self, &unit(i, -1.0))) else {
                return (best.sse < at.sse).then_some(best);
            };
            ups[i] = up;
            slope[i] = 0.5 * (up - down);
            curve[(i, i)] = up + down - 2.0 * middle;
        }
        for i in 0..n {
            for k in 0..i {
                let mut both = unit(i, 1.0);
                both[k] = 1.0;
                let mixed = ask(self, &both).map_or(0.0, |f| f - ups[i] - ups[k] + middle);
                (curve[(i, k)], curve[(k, i)]) = (mixed, mixed);
            }
        }
        if let Some(step) = newton_step(&curve, &slope) {
            ask(self, &step);
        }
        Some(best)
    }

    /// The candidate some steps along axes away, off the lattice, its dead time free within its whole point and the next
    /// ones.
    fn off_place(
        &mut self,
        structure: &Structure,
        from: &Parameters,
        axes: &[(Slot, f64)],
        steps: &[f64],
    ) -> Option<Candidate> {
        let mut theta = *from;
        for ((slot, width), step) in axes.iter().zip(steps) {
            let by = width * step;
            match slot {
                Slot::Fd => theta.fd += by,
                Slot::Tau => theta.log_tau += by,
                Slot::Param(i) => {
                    theta.p[*i] += by;
                    structure.trade(&mut theta, *i, by, self.problem.normalised.rate);
                }
            }
        }
        theta.log_tau = theta.log_tau.min(libm::log(self.problem.normalised.limits.tau[1]));
        let theta = clamped(structure, theta, self.problem);
        let delay = theta.lag.floor() as i32;
        let mut best = self.off_lattice(structure, &theta, delay, View::Plain)?;
        let fraction = best.theta.lag - f64::from(delay);
        let next = if fraction <= SETTINGS.edge {
            delay - 1
        } else if fraction >= 1.0 - SETTINGS.edge {
            delay + 1
        } else {
            return Some(best);
        };
        if next >= 0 {
            let found = self.off_lattice(structure, &theta, next, View::Plain);
            if let Some(found) = found.filter(|f| f.sse < best.sse) {
                best = found;
            }
        }
        Some(best)
    }
}

/// What may be moved.
#[derive(Debug, Clone, Copy)]
enum Slot {
    Fd,
    Tau,
    Param(usize),
}

/// The step to the least of a quadratic form with these curvatures and slopes, damped until the form is a bowl, at most
/// three units long along each axis.
fn newton_step(curve: &DMatrix<f64>, slope: &DVector<f64>) -> Option<Vec<f64>> {
    let n = slope.len();
    let mut damping = 1e-6 * curve.diagonal().amax();
    for _ in 0..12 {
        if let Some(bowl) = (curve + DMatrix::identity(n, n) * damping).cholesky() {
            return Some(bowl.solve(slope).iter().map(|v| (-v).clamp(-3.0, 3.0)).collect());
        }
        damping *= 10.0;
    }
    None
}
