//! An external oscillation of wandering phase and amplitude: a stochastic cycle in what the likeliest process leaves of PV.
//!
//! The process is the base's free run, or a first-order lag with a dead time behind OP or a fitted stem. It is refitted
//! together with the noise ([`kernel::Kernel`]), because the base was fitted without the cycle. The noise with a cycle is
//! held against that without by likelihood. Three things could be taken for a cycle from outside, and each is tested: what a
//! wrong base leaves of the loop's own oscillation, which is small beside what the base makes; a process that OP does not
//! show; and an oscillation that the controller does not answer.

mod fit;
mod kernel;
mod simplex;

use core::f64::consts::{PI, TAU};

use super::search::{Added, LEAST_GAIN, Searched};
use super::series::{START, Series};
use super::shapes::Shape;
use crate::core::signal::{detrend, stats};
use fit::{Boxed, Driver, PERIODS, Without, kernel};
use kernel::StochasticCycle;

/// Likeliest drivers with which a cycle is looked for.
const DRIVERS: usize = 3;
/// Evaluations of a fit from a place, of the last one, and of one without OP.
const PLACE: usize = 220;
const LAST: usize = 600;
const ALONE: usize = 300;

// What a cycle must be, chosen on odd seeds of the challenge (71 to 77) and on recordings resampled from noise models.

/// Coherence, periods: of a cycle near the loop's own oscillation, of another; and the most, beyond which it is a sinusoid.
const LEAST_COHERENCE: [f64; 2] = [2.5, 1.5];
const MOST_COHERENCE: f64 = 25.0;
/// Ratio of both periods from which it is another than the loop's own.
const OTHER: f64 = 1.35;
/// Cycles in the record.
const LEAST_CYCLES: f64 = 4.0;
/// Standard deviation, PV's being 1.
const LEAST_SIZE: f64 = 0.12;
/// Its power over that of valve and process at its frequency.
const LEAST_POWER: f64 = 0.1;
/// Its coherence with OP: of one near the loop's own, of another.
const LEAST_COHERENCE_WITH_OP: [f64; 2] = [0.65, 0.5];
/// What OP adds to the likelihood beside the cycle, nats.
const LEAST_BY_OP: f64 = 30.0;
/// Least difference of periods, as a share, below which a sinusoid that was named is the same.
const SAME: f64 = 0.15;

/// A cycle that was named. It is suspected at most: halves that both gained from one were as often wrong as right.
#[derive(Debug, Clone, PartialEq)]
pub struct Cycle {
    /// Its period, points of the series.
    pub period: f64,
    /// Periods after which its autocorrelation has fallen to 1/e.
    pub coherence: f64,
    /// Nats that it gains beyond its cost.
    pub gain: f64,
    /// What it adds to PV, standard deviations of PV.
    pub path: Vec<f64>,
}

/// The cycle of a searched series, where there is one.
#[must_use]
pub(crate) fn find(series: &Series, searched: &Searched) -> Option<Cycle> {
    let (boxed, drivers) = Boxed::of(series, searched);
    let mut without: Vec<Without> = drivers.into_iter().map(|driver| boxed.without(driver)).collect();
    without.sort_by(|x, y| y.log_likelihood.total_cmp(&x.log_likelihood));
    let found = Found::of(&boxed, &without).filter(|found| found.is_from_outside(&boxed))?;
    let period = found.cycle.period * boxed.points as f64;
    // As far apart as the cycle is wide.
    let same = SAME.max(1.0 / (PI * found.cycle.coherence()));
    let is_same = |k: &Added| matches!(k.shape, Shape::Sinusoid(f) if (f * period - 1.0).abs() < same);
    if searched.added.iter().any(is_same) {
        return None;
    }
    Some(Cycle {
        period,
        coherence: found.cycle.coherence(),
        gain: found.gain,
        path: unboxed(&found.path, boxed.points, series.n()),
    })
}

/// A fit with a cycle, and what is asked of it.
struct Found {
    cycle: StochasticCycle,
    /// What it adds to PV, by box.
    path: Vec<f64>,
    /// Nats beyond its cost, and what OP adds beside it.
    gain: f64,
    by_op: f64,
    /// Its power over that of valve and process at its frequency, and its coherence with OP.
    power: f64,
    coherence_with_op: f64,
}

impl Found {
    /// The likeliest cycle beside the fits without, the best of these first.
    fn of(boxed: &Boxed, without: &[Without]) -> Option<Self> {
        let followed = without.iter().take(DRIVERS).flat_map(|bare| {
            let places = boxed.places(bare).into_iter();
            places.map(move |place| (boxed.fit(&place, &bare.driver, PLACE), bare))
        });
        let ((at, _), bare) = followed.max_by(|x, y| x.0.1.total_cmp(&y.0.1))?;
        let (at, log_likelihood) = boxed.fit(&at, &bare.driver, LAST);
        let best = without.first()?;
        let cost = libm::log(boxed.n() as f64) + libm::log(PERIODS as f64);
        let gain = log_likelihood - best.log_likelihood - cost;
        if gain.is_nan() || gain < LEAST_GAIN {
            return None;
        }
        // Without OP, from both sides.
        let alone = [at.clone(), Boxed::beside(bare, &at)].map(|at| boxed.fit(&at, &Driver::Nothing, ALONE).1);
        let with = boxed.fitted(&at, &bare.driver)?;
        let cycle = kernel(&at).cycle?;
        let path = with.factors.cycle(cycle, &with.innovations);
        let at_period = |x: &[f64]| demodulated(x, cycle.period);
        let own = at_period(&path);
        Some(Self {
            gain,
            by_op: log_likelihood - alone[0].max(alone[1]),
            power: power(&own) / power(&at_period(&with.run())).max(f64::MIN_POSITIVE),
            coherence_with_op: coherence(&own, &at_period(&boxed.op)),
            cycle,
            path,
        })
    }

    /// Whether it is another oscillation than the loop's own.
    fn is_apart(&self, boxed: &Boxed) -> bool {
        let ratio = self.cycle.period / boxed.period;
        ratio.max(1.0 / ratio) > OTHER
    }

    /// Whether it is a cycle from outside.
    fn is_from_outside(&self, boxed: &Boxed) -> bool {
        let which = usize::from(self.is_apart(boxed));
        self.by_op >= LEAST_BY_OP
            && (LEAST_COHERENCE[which]..=MOST_COHERENCE).contains(&self.cycle.coherence())
            && boxed.n() as f64 >= LEAST_CYCLES * self.cycle.period
            && stats::std_dev(&self.path) >= LEAST_SIZE
            && self.power >= LEAST_POWER
            && self.coherence_with_op >= LEAST_COHERENCE_WITH_OP[which]
    }
}

/// A signal shifted in frequency, so that what has this period is steady, and averaged over two periods.
fn demodulated(x: &[f64], period: f64) -> [Vec<f64>; 2] {
    let mean = stats::mean(x);
    let width = 2 * (period as usize) + 1;
    let by = |wave: fn(f64) -> f64| {
        let turned: Vec<f64> = x.iter().enumerate().map(|(k, x)| (x - mean) * wave(TAU * k as f64 / period)).collect();
        detrend::hann_smooth(&turned, width)
    };
    [by(libm::cos), by(libm::sin)]
}

fn power([re, im]: &[Vec<f64>; 2]) -> f64 {
    stats::dot(re, re) + stats::dot(im, im)
}

/// Coherence of two demodulated signals, 0 to 1.
fn coherence(x: &[Vec<f64>; 2], y: &[Vec<f64>; 2]) -> f64 {
    let re = stats::dot(&x[0], &y[0]) + stats::dot(&x[1], &y[1]);
    let im = stats::dot(&x[0], &y[1]) - stats::dot(&x[1], &y[0]);
    ((re * re + im * im) / (power(x) * power(y)).max(f64::MIN_POSITIVE)).sqrt()
}

/// Means of boxes behind the first [`START`] points as a line through their middles, over `n` points.
fn unboxed(means: &[f64], points: usize, n: usize) -> Vec<f64> {
    let last = means.len() - 1;
    let at = |k: usize| {
        let place = ((k as f64 - START as f64 + 0.5) / points as f64 - 0.5).clamp(0.0, last as f64);
        let whole = (place as usize).min(last.saturating_sub(1));
        let part = place - whole as f64;
        means[whole] * (1.0 - part) + means[(whole + 1).min(last)] * part
    };
    (0..n).map(at).collect()
}
