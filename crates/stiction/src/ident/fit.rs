//! The free-run fit of one process model to one valve signal.
//!
//! Gain, friction band, bias and the process' initial state are linear and solved exactly; time constants and lag are
//! improved by Gauss-Newton steps on what the linear part leaves (variable projection, Golub and Pereyra 1973).
//! The cost is the squared free-run (output) error from the point on where the valve before the record no longer
//! matters, optionally of `1 - rho q^-1` times it.

use super::class::{Class, Limits, Scratch, Shape};
use super::least_squares::{Gram, MAX};
use crate::signal::stats::dot;

/// What a fit is made to: a signal in any units, and where its cost begins.
#[derive(Debug, Clone)]
pub struct Target {
    /// The filtered signal from `from` on.
    pub y: Vec<f64>,
    /// Filter: `1 - rho q^-1`.
    pub rho: f64,
    /// First point that counts, at least 1.
    pub from: usize,
}

impl Target {
    /// Filters `pv` by `1 - rho q^-1` and starts at point `from` (at least 1).
    #[must_use]
    pub(crate) fn new(pv: &[f64], rho: f64, from: usize) -> Self {
        let from = from.max(1);
        Self { y: cut(pv, rho, from), rho, from }
    }
}

/// `x[k] - rho x[k-1]` for `k >= from >= 1`.
fn cut(x: &[f64], rho: f64, from: usize) -> Vec<f64> {
    let mut out = Vec::new();
    cut_into(x, rho, from, &mut out);
    out
}

fn cut_into(x: &[f64], rho: f64, from: usize, out: &mut Vec<f64>) {
    out.clear();
    if rho == 0.0 {
        out.extend_from_slice(x.get(from..).unwrap_or(&[]));
    } else if from >= 1 && x.len() >= from {
        out.extend(x[from - 1..].windows(2).map(|w| w[1] - rho * w[0]));
    }
}

/// What a fit may do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Freedom {
    /// Band of fd that belongs to the slips at hand.
    pub fd: [f64; 2],
    /// fd to take where the data cannot tell.
    pub fd_default: f64,
    /// Sign that the gain must have.
    pub sign: f64,
    /// Limits of time constants and lag.
    pub limits: Limits,
}

/// A fitted process model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fitted {
    /// Squared error, summed from the target's first point.
    pub sse: f64,
    /// Coefficient of the unit response; 0 where no gain of the asked sign helps.
    pub gain: f64,
    /// Kinetic band.
    pub fd: f64,
    /// Coefficients of the process' own memory.
    pub memory: [f64; 3],
    /// Time constants and lag.
    pub shape: Shape,
}

/// Fits models to targets, with its own buffers.
#[derive(Debug, Default)]
pub(crate) struct Fitter {
    work: Scratch,
    long: [Vec<f64>; 2],
    at: Vec<f64>,
    direction: Vec<f64>,
    memory: [Vec<f64>; 3],
    valve: Vec<f64>,
    response: Vec<f64>,
    residual: Vec<f64>,
    slopes: [Vec<f64>; 3],
    moved: Vec<f64>,
    /// Model responses computed so far.
    pub evaluations: u64,
}

/// Step of the finite differences, in logarithm of time or points.
const DELTA: f64 = 1e-5;
/// Squared error over the best one that a hop of the lag must promise.
const PROMISED: f64 = 1.01;
/// Longest Gauss-Newton step in logarithm of a time constant.
const MAX_LOG_STEP: f64 = 0.7;

impl Fitter {
    /// The best linear part for a given shape. `signal` holds the valve signal's two halves, `at - fd * direction`.
    pub(crate) fn linear(
        &mut self,
        class: Class,
        shape: &Shape,
        signal: [&[f64]; 2],
        target: &Target,
        freedom: &Freedom,
    ) -> Fitted {
        self.lay(class, shape, signal, target);
        let own = class.memory_len();
        let mut gram = self.halves(own, target);
        let whole = [gram.at(own, own), gram.at(own + 1, own + 1)];
        gram.eliminate(own);
        let entry = |i: usize, k: usize| gram.at(own + i, own + k);
        let system = [entry(0, 0), entry(0, 1), entry(1, 1), entry(0, 2), entry(1, 2)];
        let (gain, fd, explained) = best_band(system, whole, freedom);
        let all = gram.back(own, &[gain, -gain * fd]);
        let sse = (gram.at(own + 2, own + 2) - explained).max(0.0);
        let memory = core::array::from_fn(|i| if i < own { all[i] } else { 0.0 });
        Fitted { sse, gain, fd, memory, shape: *shape }
    }

    /// Lays out the columns of a shape: the answers to the valve signal's halves and the process' own memory.
    fn lay(&mut self, class: Class, shape: &Shape, signal: [&[f64]; 2], target: &Target) {
        self.evaluations += 1;
        let [long0, long1] = &mut self.long;
        class.respond_pair(shape, signal, &mut self.work, [long0, long1]);
        cut_into(long0, target.rho, target.from, &mut self.at);
        cut_into(long1, target.rho, target.from, &mut self.direction);
        let n = self.at.len();
        for (index, column) in self.memory.iter_mut().enumerate().take(class.memory_len()).skip(1) {
            class.memory(shape, index, target.from, n, target.rho, column);
        }
    }

    /// The response, its halves put together with a band.
    fn put_together(&mut self, fd: f64) {
        self.response.clear();
        self.response.extend(self.at.iter().zip(&self.direction).map(|(a, d)| a - fd * d));
    }

    /// Products of the constant, the process' own memory, the `others`, in this order.
    fn products(&self, own: usize, target: &Target, others: &[&[f64]]) -> Gram {
        let mut columns: [&[f64]; MAX] = [&[]; MAX];
        let memory = self.memory[1..own].iter().map(Vec::as_slice);
        let all = memory.chain(others.iter().copied());
        for (slot, column) in columns.iter_mut().zip(all) {
            *slot = column;
        }
        Gram::with_constant(1.0 - target.rho, self.at.len(), &columns[..own - 1 + others.len()])
    }

    /// Products of the process' own memory, both halves and the target.
    fn halves(&self, own: usize, target: &Target) -> Gram {
        self.products(own, target, &[&self.at, &self.direction, &target.y])
    }

    /// Up to `steps` Gauss-Newton steps from `start` (as [`Fitter::linear`] just gave it for the same signal); stops
    /// at a relative gain below `enough`, and where the slopes do not promise a squared error below `wanted`.
    #[allow(clippy::too_many_arguments)] // the signal, the target and the freedom are three things
    pub(crate) fn improve(
        &mut self,
        class: Class,
        start: Fitted,
        signal: [&[f64]; 2],
        target: &Target,
        freedom: &Freedom,
        steps: usize,
        [enough, wanted]: [f64; 2],
    ) -> Fitted {
        let mut best = start;
        for step in 0..steps {
            if best.gain == 0.0 || best.sse <= 0.0 {
                break;
            }
            if step > 0 {
                // The buffers must hold the columns of the best shape, not of a refused one.
                best = self.linear(class, &best.shape, signal, target, freedom);
            }
            let (delta, promised) = self.direction_of_descent(class, &best, signal, target);
            if promised > wanted {
                break;
            }
            let Some(next) = self.walk(class, &best, delta, signal, target, freedom) else { break };
            let gained = (best.sse - next.sse) / best.sse;
            best = next;
            if gained < enough {
                break;
            }
        }
        best
    }

    /// As [`Fitter::improve`] until nothing helps any more: between rounds the lag hops to either side, because the
    /// cost has a kink at every whole lag that a slope does not see beyond.
    pub(crate) fn settle(
        &mut self,
        class: Class,
        start: Fitted,
        signal: [&[f64]; 2],
        target: &Target,
        freedom: &Freedom,
    ) -> Fitted {
        let start = self.linear(class, &start.shape, signal, target, freedom);
        let mut best = self.improve(class, start, signal, target, freedom, 12, [1e-6, f64::INFINITY]);
        let slot = class.shape_len() - 1;
        for _ in 0..6 {
            let before = best.sse;
            for hop in [-0.6, 0.6, -1.4, 1.4, -3.0, 3.0] {
                let mut shape = best.shape;
                shape[slot] += hop;
                let shape = class.clamp(shape, &freedom.limits);
                let hopped = self.linear(class, &shape, signal, target, freedom);
                if hopped.sse < 1.3 * best.sse {
                    let wanted = PROMISED * best.sse;
                    let found = self.improve(class, hopped, signal, target, freedom, 6, [1e-6, wanted]);
                    if found.sse < best.sse {
                        best = found;
                    }
                }
            }
            if before - best.sse <= 1e-4 * before {
                break;
            }
        }
        best
    }

    /// Tries a step, then shorter ones; `None` when none is better.
    fn walk(
        &mut self,
        class: Class,
        from: &Fitted,
        delta: Shape,
        signal: [&[f64]; 2],
        target: &Target,
        freedom: &Freedom,
    ) -> Option<Fitted> {
        let mut scale = 1.0;
        for _ in 0..3 {
            let moved = core::array::from_fn(|i| from.shape[i] + scale * delta[i]);
            let shape = class.clamp(moved, &freedom.limits);
            if shape != from.shape {
                let next = self.linear(class, &shape, signal, target, freedom);
                if next.sse < from.sse {
                    return Some(next);
                }
            }
            scale *= 0.3;
        }
        None
    }

    /// What a fitted model leaves of a target that may be longer than the one it was fitted to.
    pub(crate) fn leftover(&mut self, class: Class, fit: &Fitted, signal: [&[f64]; 2], target: &Target) -> Vec<f64> {
        self.lay(class, &fit.shape, signal, target);
        self.put_together(fit.fd);
        self.leave(class.memory_len(), fit, target);
        self.residual.clone()
    }

    /// What a model leaves of the target, from its first point on.
    pub fn residual(
        &mut self,
        class: Class,
        fit: &Fitted,
        signal: [&[f64]; 2],
        target: &Target,
        freedom: &Freedom,
    ) -> Vec<f64> {
        let again = self.linear(class, &fit.shape, signal, target, freedom);
        self.leftover(class, &again, signal, target)
    }

    /// The residual, from the columns that [`Fitter::lay`] left and the response.
    fn leave(&mut self, own: usize, fit: &Fitted, target: &Target) {
        self.residual.clear();
        let constant = fit.memory[0] * (1.0 - target.rho);
        self.residual.extend(target.y.iter().zip(&self.response).map(|(y, x)| y - fit.gain * x - constant));
        for (column, c) in self.memory[1..own].iter().zip(&fit.memory[1..]) {
            for (r, m) in self.residual.iter_mut().zip(column) {
                *r -= c * m;
            }
        }
    }

    /// The response of a fit that [`Fitter::linear`] just gave, and its slopes along the shape.
    fn slopes(&mut self, class: Class, fit: &Fitted, signal: [&[f64]; 2], target: &Target) {
        self.valve.clear();
        self.valve.extend(signal[0].iter().zip(signal[1]).map(|(a, d)| a - fit.fd * d));
        self.put_together(fit.fd);
        let len = class.shape_len();
        for first in (0..len).step_by(2) {
            let second = (first + 1).min(len - 1);
            self.slopes_of(class, fit, target, [first, second]);
        }
    }

    /// The Gauss-Newton step in the shape, with all linear coefficients free and fd held, and the squared error that
    /// it promises.
    fn direction_of_descent(
        &mut self,
        class: Class,
        fit: &Fitted,
        signal: [&[f64]; 2],
        target: &Target,
    ) -> (Shape, f64) {
        let (own, len) = (class.memory_len(), class.shape_len());
        self.slopes(class, fit, signal, target);
        self.leave(own, fit, target);
        let mut columns: [&[f64]; 4] = [&[]; 4];
        columns[0] = &self.response;
        for (slot, column) in columns[1..].iter_mut().zip(&self.slopes[..len]) {
            *slot = column;
        }
        let mut gram = self.products(own, target, &columns[..=len]);
        // What the linear part leaves has nothing in common with its columns.
        let mut with = [0.0; MAX];
        for (slot, slope) in with[own + 1..].iter_mut().zip(&self.slopes[..len]) {
            *slot = dot(&self.residual, slope);
        }
        let last = own + 1 + len;
        gram.append(&with[..last], fit.sse);
        gram.eliminate(last);
        let all = gram.back(last, &[]);
        let lag_step = 2.5_f64.max(0.1 * class.lag(&fit.shape));
        let step = core::array::from_fn(|i| match i {
            i if i + 1 < len => all[own + 1 + i].clamp(-MAX_LOG_STEP, MAX_LOG_STEP),
            i if i + 1 == len => all[own + 1 + i].clamp(-lag_step, lag_step),
            _ => 0.0,
        });
        (step, gram.at(last, last))
    }

    /// Slopes of the fitted curve along two entries of the shape (the same twice where only one is left).
    fn slopes_of(&mut self, class: Class, fit: &Fitted, target: &Target, entries: [usize; 2]) {
        let shapes: [Shape; 2] = core::array::from_fn(|i| {
            let mut s = fit.shape;
            s[entries[i]] += DELTA;
            s
        });
        self.evaluations += 1;
        let [long0, long1] = &mut self.long;
        let valve = [&self.valve[..]; 2];
        class.respond_shapes([&shapes[0], &shapes[1]], valve, &mut self.work, [long0, long1]);
        for i in 0..2 {
            let entry = entries[i];
            cut_into(&self.long[i], target.rho, target.from, &mut self.moved);
            let scale = fit.gain / DELTA;
            self.slopes[entry].clear();
            self.slopes[entry].extend(self.moved.iter().zip(&self.response).map(|(m, x)| scale * (m - x)));
            for index in 1..class.memory_len() {
                // Only decaying columns depend on the shape; the constant and the ramp give zero here.
                class.memory(&shapes[i], index, target.from, target.y.len(), target.rho, &mut self.moved);
                let scale = fit.memory[index] / DELTA;
                for ((s, m), old) in self.slopes[entry].iter_mut().zip(&self.moved).zip(&self.memory[index]) {
                    *s += scale * (m - old);
                }
            }
        }
    }
}

/// Squared error against fd: a quotient of parabolas.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BandProfile {
    uu: f64,
    ud: f64,
    dd: f64,
    uy: f64,
    dy: f64,
    yy: f64,
}

impl BandProfile {
    /// From products as [`best_band`] takes them and the squares that gain and band explain a part of.
    #[must_use]
    pub(crate) const fn new([uu, ud, dd, uy, dy]: [f64; 5], yy: f64) -> Self {
        Self { uu, ud, dd, uy, dy, yy }
    }

    /// Squared error with the best gain for this fd.
    #[must_use]
    pub(crate) fn sse(&self, fd: f64) -> f64 {
        let power = self.uu - 2.0 * fd * self.ud + fd * fd * self.dd;
        let along = self.uy - fd * self.dy;
        if power > 1e-12 * (self.uu + fd * fd * self.dd) { self.yy - along * along / power } else { self.yy }
    }

    /// Standard error of fd next to a free gain, for white residuals of this variance; infinite where the data cannot tell fd
    /// from the gain.
    #[must_use]
    pub(crate) fn error(&self, fd: f64, variance: f64, gain: f64) -> f64 {
        let power = self.uu - 2.0 * fd * self.ud + fd * fd * self.dd;
        let along = self.ud - fd * self.dd;
        let own = self.dd - along * along / power;
        if own.is_nan() || own <= 1e-6 * self.dd || gain == 0.0 {
            f64::INFINITY
        } else {
            (variance / own).sqrt() / gain.abs()
        }
    }

    /// Whether fd only changes the size of the response, so that the gain makes up for it.
    #[must_use]
    pub(crate) fn is_flat(&self) -> bool {
        self.uu * self.dd - self.ud * self.ud <= 1e-6 * self.uu * self.dd
    }
}

/// Gain, fd and explained squares from the products left of the two halves of the valve signal, `at` and `direction`,
/// and the target (at·at, at·direction, direction·direction, at·target, direction·target): the explained part is a
/// quotient of parabolas in fd, so its best place is the free optimum or an end of the band. A signal of which the
/// process' own memory leaves next to nothing (of `whole`, its squares before) has no gain.
#[inline]
pub(crate) fn best_band([uu, ud, dd, uy, dy]: [f64; 5], whole: [f64; 2], freedom: &Freedom) -> (f64, f64, f64) {
    let [low, high] = freedom.fd;
    let determinant = uu * dd - ud * ud;
    let free = if determinant > 1e-6 * uu * dd {
        let gain = dd * uy - ud * dy;
        let fd = -(uu * dy - ud * uy) / gain;
        if fd.is_finite() { Some(fd.clamp(low, high)) } else { None }
    } else {
        None
    };
    let consider = |best: (f64, f64, f64), fd: f64| {
        let power = uu - 2.0 * fd * ud + fd * fd * dd;
        let along = uy - fd * dy;
        let explained = along * along / power;
        let counts = power > 1e-11 * (whole[0] + fd * fd * whole[1]) && along * freedom.sign > 0.0;
        if counts && explained > best.2 { (along / power, fd, explained) } else { best }
    };
    let none = (0.0, freedom.fd_default, 0.0);
    let Some(fd) = free else { return consider(none, freedom.fd_default.clamp(low, high)) };
    let best = consider(none, fd);
    // Within the band the free optimum is better than either end, where its gain has the asked sign.
    if best.2 > 0.0 && fd > low && fd < high {
        return best;
    }
    consider(consider(best, low), high)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits { tau: [0.3, 500.0], lag: [0.0, 25.0] };

    fn square(n: usize) -> Vec<f64> {
        (0..n)
            .map(|k| if libm::sin(k as f64 * 0.11) + libm::sin(k as f64 * 0.029) > 0.0 { 1.0 } else { -0.4 })
            .collect()
    }

    #[test]
    fn the_truth_is_reached_from_afar_in_every_class() {
        let v = square(900);
        let still = vec![0.0; v.len()];
        for (class, truth) in [
            (Class::First, [libm::log(12.0), 4.3, 0.0]),
            (Class::Second, [libm::log(20.0), libm::log(6.0), 3.7]),
            (Class::Integrating, [5.6, 0.0, 0.0]),
            (Class::LagIntegrating, [libm::log(9.0), 2.2, 0.0]),
        ] {
            let (mut x, mut other, mut work) = (Vec::new(), Vec::new(), Scratch::default());
            class.respond_pair(&truth, [&v, &v], &mut work, [&mut x, &mut other]);
            let pv: Vec<f64> = x.iter().enumerate().map(|(k, x)| 7.0 - 2.5 * x + 1e-3 * k as f64).collect();
            let pv: Vec<f64> = if class.integrates() { pv } else { x.iter().map(|x| 7.0 - 2.5 * x).collect() };
            for rho in [0.0, 0.9] {
                let target = Target::new(&pv, rho, 26);
                let freedom = Freedom { fd: [0.0, 0.0], fd_default: 0.0, sign: -1.0, limits: LIMITS };
                let mut fitter = Fitter::default();
                let start = class.start(10.0, 5.0);
                let linear = fitter.linear(class, &start, [&v, &still], &target, &freedom);
                let fit = fitter.settle(class, linear, [&v, &still], &target, &freedom);
                assert!(fit.sse < 1e-8 * linear.sse.max(1.0), "{class:?} rho {rho}: {linear:?} to {fit:?}");
                for (got, want) in fit.shape.iter().zip(truth) {
                    assert!((got - want).abs() < 1e-3, "{class:?}: {fit:?}");
                }
                assert!((class.gain(fit.gain) / class.gain(1.0) + 2.5).abs() < 1e-3);
            }
        }
    }

    #[test]
    fn a_gain_of_the_wrong_sign_is_refused() {
        let v = square(300);
        let still = vec![0.0; v.len()];
        let target = Target::new(&v, 0.0, 5);
        let freedom = Freedom { fd: [0.0, 0.0], fd_default: 0.0, sign: -1.0, limits: LIMITS };
        let fit = Fitter::default().linear(Class::First, &[0.0, 0.0, 0.0], [&v, &still], &target, &freedom);
        assert_eq!(fit.gain, 0.0);
    }

    #[test]
    fn the_band_is_read_from_the_response() {
        let at: Vec<f64> = (0..400).map(|k| libm::sin(k as f64 * 0.11) + 0.3 * libm::sin(k as f64 * 0.037)).collect();
        let direction = square(400).iter().map(|v| v.signum()).collect::<Vec<_>>();
        let v: Vec<f64> = at.iter().zip(&direction).map(|(a, d)| a - 0.2 * d).collect();
        let (mut x, mut other) = (Vec::new(), Vec::new());
        let shape = [libm::log(5.0), 2.5, 0.0];
        Class::First.respond_pair(&shape, [&v, &v], &mut Scratch::default(), [&mut x, &mut other]);
        let target = Target::new(&x, 0.0, 10);
        let freedom = Freedom { fd: [0.0, 0.5], fd_default: 0.0, sign: 1.0, limits: LIMITS };
        let fit = Fitter::default().linear(Class::First, &shape, [&at, &direction], &target, &freedom);
        assert!((fit.fd - 0.2).abs() < 1e-9 && (fit.gain - 1.0).abs() < 1e-9);
        let capped = Freedom { fd: [0.0, 0.1], ..freedom };
        let fit = Fitter::default().linear(Class::First, &shape, [&at, &direction], &target, &capped);
        assert_eq!(fit.fd, 0.1);
    }
}
