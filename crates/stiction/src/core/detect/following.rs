//! How PV follows a moving set point: identifies the closed loop itself, without a model of process or controller.
//!
//! Only the set point separates a loop from its disturbances: it is known and comes from outside. PV is fitted by the set point
//! filtered by a second-order lag with a zero and dead time (gain 1, because of integral action), plus autoregressive noise for
//! everything else that moves PV. A loop that rings is compared with one that does not, each with its own noise model.

use core::f64::consts::PI;

use super::ringing::{burg, filtered, innovations};
use crate::core::signal::{detrend, stats};

/// A closed loop identified from its response to the set point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Following {
    /// Log likelihood ratio of a loop that rings to one that does not.
    pub rings: f64,
    /// Natural period of the loop that rings, points.
    pub period_points: f64,
    /// Damping of the loop that does not ring: above 1 PV creeps to the set point.
    pub damping: f64,
    /// Time by which PV lags the set point in the loop that does not ring, points.
    pub lag_points: f64,
}

/// Loops that ring, and those that do not: dampings tried and their bounds.
const CLASSES: [(&[f64], [f64; 2]); 2] =
    [(&[0.02, 0.05, 0.1, 0.2], [0.005, 0.2]), (&[0.35, 0.6, 1.0, 1.6, 3.0], [0.35, 8.0])];
/// Natural periods tried per octave, from four points to the whole record, and dead times in shares of them.
const PER_OCTAVE: f64 = 3.0;
const DEAD_TIMES: [f64; 3] = [0.0, 0.1, 0.2];
/// Highest order of the noise.
const ORDER: usize = 10;
/// Fewest and most points, and points per period of an oscillation.
const POINTS: [usize; 2] = [60, 1200];
const PER_PERIOD: f64 = 14.0;

/// How `pv` follows `sp`, if an oscillation has a period of about `period` points; `None` if the set point is constant or the
/// record is short.
#[must_use]
pub(crate) fn of(sp: &[f64], pv: &[f64], period: Option<f64>) -> Option<Following> {
    let k = (pv.len() / POINTS[1]).max((period.unwrap_or(0.0) / PER_PERIOD) as usize).max(1);
    let [sp, pv] = [sp, pv].map(|x| detrend::box_means(x, k));
    if sp.len() != pv.len() || pv.len() < POINTS[0] || stats::span(&sp) <= 0.0 {
        return None;
    }
    let plain = Signals { sp: sp.iter().map(|x| x - sp[0]).collect(), pv: detrend::remove_line(&pv) };
    let by_error = |a: &Loop, b: &Loop| a.error.total_cmp(&b.error);
    let first = CLASSES.iter().map(|class| plain.searched(class)).min_by(by_error)?;
    let white = plain.without_noise(&first)?;
    let found: Vec<(f64, Loop)> = CLASSES.iter().filter_map(|class| plain.likeliest(class, &white)).collect();
    let [(ringing, rings), (damped, calm)] = found.try_into().ok()?;
    Some(Following {
        rings: 0.5 * plain.pv.len() as f64 * libm::log(damped / ringing),
        period_points: rings.period * k as f64,
        damping: calm.damping,
        lag_points: k as f64 * (calm.dead_time + (2.0 * calm.damping - calm.zero) * calm.period / (2.0 * PI)),
    })
}

/// A closed loop, times in points: `(1 + zero s / w) exp(-dead_time s) / (1 + 2 damping s / w + (s / w)^2)`, and its squared
/// error.
#[derive(Debug, Clone, Copy)]
struct Loop {
    damping: f64,
    period: f64,
    dead_time: f64,
    zero: f64,
    error: f64,
}

/// The set point, starting from 0, and PV without trend.
struct Signals {
    sp: Vec<f64>,
    pv: Vec<f64>,
}

impl Signals {
    /// The loop with these times and its best zero, and its residual.
    fn fitted(&self, damping: f64, period: f64, dead_time: f64) -> (Loop, Vec<f64>) {
        let [low, band] = answers(&self.sp, damping, period, dead_time).map(|x| detrend::remove_line(&x));
        let mut rest: Vec<f64> = self.pv.iter().zip(&low).map(|(y, x)| y - x).collect();
        let power = stats::dot(&band, &band);
        let zero = if power > 0.0 { stats::dot(&rest, &band) / power } else { 0.0 };
        rest.iter_mut().zip(&band).for_each(|(y, x)| *y -= zero * x);
        (Loop { damping, period, dead_time, zero, error: stats::dot(&rest, &rest) }, rest)
    }

    /// The best loop of a class: a search over its grid, then steps around the best.
    fn searched(&self, (dampings, bounds): &(&[f64], [f64; 2])) -> Loop {
        let best = |best: Option<Loop>, (damping, period, dead_time)| {
            let tried = self.fitted(damping, period, dead_time).0;
            Some(best.filter(|b| b.error <= tried.error).unwrap_or(tried))
        };
        let steps = (libm::log2(self.pv.len() as f64 / 4.0) * PER_OCTAVE) as usize;
        let periods = (0..=steps).map(|step| 4.0 * libm::exp2(step as f64 / PER_OCTAVE));
        let grid = periods.flat_map(|period| {
            dampings.iter().flat_map(move |damping| DEAD_TIMES.map(|dead| (*damping, period, dead * period)))
        });
        let mut found = grid.fold(None, best);
        for step in [0.1, 0.1, 0.05, 0.05, 0.025, 0.0125] {
            let Some(Loop { damping, period, dead_time, .. }) = found else { continue };
            let around = [-step, step].into_iter().flat_map(|step| {
                let damped = (damping * libm::exp(4.0 * step)).clamp(bounds[0], bounds[1]);
                let later = (dead_time + 0.5 * step * period).max(0.0);
                [(damped, period, dead_time), (damping, period * libm::exp(step), dead_time), (damping, period, later)]
            });
            found = around.fold(found, best);
        }
        found.unwrap_or(Loop { damping: bounds[1], period: 4.0, dead_time: 0.0, zero: 0.0, error: f64::INFINITY })
    }

    /// Both signals, filtered so that the residual of a loop becomes white.
    fn without_noise(&self, of: &Loop) -> Option<Self> {
        let noise = burg(&self.fitted(of.damping, of.period, of.dead_time).1, ORDER)?;
        Some(Self { sp: filtered(&self.sp, &noise), pv: detrend::remove_line(&filtered(&self.pv, &noise)) })
    }

    /// The likeliest loop of a class, first by whitened signals, then with its own noise model; also the variance of its
    /// innovations.
    fn likeliest(&self, class: &(&[f64], [f64; 2]), white: &Self) -> Option<(f64, Loop)> {
        let by_own_noise = |of: Loop| {
            let (of, left) = self.fitted(of.damping, of.period, of.dead_time);
            Some((stats::variance(&innovations(&left, &burg(&left, ORDER)?)), of))
        };
        let first = by_own_noise(white.searched(class))?;
        let second = by_own_noise(self.without_noise(&first.1)?.searched(class))?;
        Some(if second.0 < first.0 { second } else { first })
    }
}

/// The set point filtered by a second-order lag, and its derivative over the natural frequency (bilinear transform).
fn answers(sp: &[f64], damping: f64, period: f64, dead_time: f64) -> [Vec<f64>; 2] {
    let w = 2.0 * PI / period;
    let across = 4.0 * damping * w;
    let [a0, a1, a2] = [4.0 + across + w * w, 2.0 * w * w - 8.0, 4.0 - across + w * w];
    let (late, part) = (dead_time.floor() as usize, dead_time - dead_time.floor());
    let at = |k: usize| if k < late { 0.0 } else { sp[k - late] };
    let (mut low, mut band) = (Vec::with_capacity(sp.len()), Vec::with_capacity(sp.len()));
    let (mut x, mut y, mut v) = ([0.0; 2], [0.0; 2], [0.0; 2]);
    for k in 0..sp.len() {
        let now = (1.0 - part) * at(k) + if k > 0 { part * at(k - 1) } else { 0.0 };
        let lag = (w * w * (now + 2.0 * x[0] + x[1]) - a1 * y[0] - a2 * y[1]) / a0;
        let slope = (2.0 * w * (now - x[1]) - a1 * v[0] - a2 * v[1]) / a0;
        (x, y, v) = ([now, x[0]], [lag, y[0]], [slope, v[0]]);
        low.push(lag);
        band.push(slope);
    }
    [low, band]
}

#[cfg(test)]
mod tests {
    use super::super::noise;
    use super::*;

    /// A loop of this damping and natural period 40 that follows a set point with steps, with a sine of this size and noise.
    fn followed(damping: f64, sine: f64, seed: u64) -> Following {
        let n = 900;
        let sp: Vec<f64> = (0..n).map(|k| f64::from(u8::from(k / 130 % 2 == 1))).collect();
        let [answer, _] = answers(&sp, damping, 40.0, 3.0);
        let beside = |k: usize| sine * libm::sin(2.0 * PI * k as f64 / 43.0);
        let pv: Vec<f64> =
            answer.iter().zip(noise(n, seed)).enumerate().map(|(k, (y, e))| y + beside(k) + 0.1 * e).collect();
        of(&sp, &pv, Some(40.0)).unwrap()
    }

    #[test]
    fn the_closed_loop_is_found_beside_a_disturbance_of_its_period() {
        for seed in 1..4 {
            let [ringing, calm, driven] =
                [(0.08, 0.0), (0.8, 0.0), (0.8, 0.5)].map(|(z, sine)| followed(z, sine, seed));
            assert!(ringing.rings > 10.0 && (ringing.period_points / 40.0 - 1.0).abs() < 0.05, "{ringing:?}");
            assert!(calm.rings < -10.0 && (calm.damping / 0.8 - 1.0).abs() < 0.4, "{calm:?}");
            // Dead time 3 plus 2 zeta / w.
            assert!((calm.lag_points - (3.0 + 1.6 * 40.0 / (2.0 * PI))).abs() < 3.0, "{calm:?}");
            assert!(driven.rings < -3.0, "{driven:?}");
        }
    }

    #[test]
    fn a_set_point_that_rests_shows_no_loop() {
        assert_eq!(of(&[1.0; 300], &noise(300, 1), None), None);
        assert_eq!(of(&noise(20, 2), &noise(20, 1), None), None);
    }
}
