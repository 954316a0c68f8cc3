//! Separates a loop's own ringing from a forced oscillation.
//!
//! An external disturbance with a constant period appears in PV as lines: a sine and its harmonics with a constant phase. They
//! are fitted and removed. The rest is the loop's response to random disturbances, and its autoregressive model (Burg 1975)
//! shows the closed loop's own modes: a pole `exp(s)` has the damping `-Re s / |s|`. A loop near its stability limit rings
//! there too, because noise makes its oscillation wander in phase and amplitude; a well-damped loop that is driven does not.
//! The record's process model cannot separate the two: under a sine of frequency w any fit of PV to OP in closed loop ends at
//! the process with a loop gain of -1 at w, which is the model of a loop at its limit.

use core::f64::consts::PI;

use nalgebra::Complex;

use crate::core::signal::{detrend, stats};

/// Ringing and forced components.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ringing {
    /// Period of the lines, points.
    pub period_points: f64,
    /// Their share of the variance, 0..1.
    pub forced: f64,
    /// A line of another frequency (not a harmonic or half of the first) with a considerable share of the rest.
    pub second: Option<Line>,
    /// Spread of the oscillation's amplitude over its mean: small for an external sine, cycle or machine even if its phase
    /// wanders, about a half for a mode driven by random disturbances.
    pub unsteadiness: f64,
    /// At least eight periods: enough to identify a mode.
    pub long_enough: bool,
    /// The least damped mode near the lines in the rest; `None` if there is none or the record is too short.
    pub mode: Option<Mode>,
}

/// A sine of constant phase.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Period, points.
    pub period_points: f64,
    /// Share of the signal's variance, 0..1.
    pub share: f64,
}

/// A mode of the closed loop, driven by random disturbances.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mode {
    /// Damping, 0..1.
    pub damping: f64,
    /// Period, points.
    pub period_points: f64,
    /// Power density at its frequency over the mean of those at half and twice it.
    pub height: f64,
}

/// Points per period used.
const POINTS_PER_PERIOD: f64 = 12.0;
/// Fewest periods for lines, and for modes.
const MIN_PERIODS: [f64; 2] = [4.0, 8.0];
/// Harmonics removed.
pub(super) const HARMONICS: usize = 5;
/// Highest order of the model.
const MAX_ORDER: usize = 20;
/// Relative frequency range around the lines for a mode.
const NEAR: [f64; 2] = [0.75, 1.33];
/// Relative frequency range of a second line.
const BESIDE: [f64; 2] = [0.3, 3.4];
/// Least share of the rest, and of the whole, for a second line.
const SECOND: [f64; 2] = [0.4, 0.03];

/// Analyses a signal that oscillates with about `period` points; `None` below four periods or for a constant.
#[must_use]
pub(crate) fn of(x: &[f64], period: f64) -> Option<Ringing> {
    let k = ((period / POINTS_PER_PERIOD) as usize).max(1);
    let boxed = detrend::remove_line(&detrend::box_means(x, k));
    let (n, period) = (boxed.len() as f64, period / k as f64);
    let power = stats::variance(&boxed);
    let periods = n / period;
    if periods < MIN_PERIODS[0] || period < 3.0 || !power.is_normal() {
        return None;
    }
    let f = strongest(&boxed, [0.75 / period, 1.25 / period]);
    let first = harmonics(f);
    let mut rest = without_lines(&boxed, &first);
    let forced = 1.0 - stats::variance(&rest) / power;
    let second = second_line(&rest, f).and_then(|g| {
        let lines = [harmonics(g), first.clone()].concat();
        let less = without_lines(&boxed, &lines);
        let taken = stats::variance(&rest) - stats::variance(&less);
        let holds = taken > SECOND[0] * stats::variance(&rest) && taken > SECOND[1] * power;
        holds.then(|| {
            rest = less;
            Line { period_points: k as f64 / g, share: taken / power }
        })
    });
    let unsteadiness = unsteadiness(&boxed, f);
    let long_enough = periods >= MIN_PERIODS[1];
    let mode = if long_enough { least_damped(&rest, f) } else { None };
    let mode = mode.map(|m| Mode { period_points: m.period_points * k as f64, ..m });
    Some(Ringing { period_points: k as f64 / f, forced, second, unsteadiness, long_enough, mode })
}

/// Spread over mean of the amplitude at frequency `f`, averaged over two periods (complex demodulation).
fn unsteadiness(x: &[f64], f: f64) -> f64 {
    let width = (1.0 / f).round() as usize;
    let part = |turn: fn(f64) -> f64| -> Vec<f64> {
        let carried: Vec<f64> = x.iter().enumerate().map(|(k, v)| v * turn(2.0 * PI * f * k as f64)).collect();
        detrend::hann_smooth(&carried, 2 * width)
    };
    let (cosine, sine) = (part(libm::cos), part(libm::sin));
    let amplitude: Vec<f64> = cosine.iter().zip(&sine).map(|(a, b)| (a * a + b * b).sqrt()).collect();
    // At the ends the average is over repeated values.
    let inner = &amplitude[width.min(x.len() / 4)..x.len() - width.min(x.len() / 4)];
    let mean = stats::mean(inner);
    if mean > 0.0 { stats::std_dev(inner) / mean } else { 0.0 }
}

/// `frequency` and its harmonics up to the Nyquist limit.
pub(super) fn harmonics(frequency: f64) -> Vec<f64> {
    let count = HARMONICS.min((0.45 / frequency) as usize).max(1);
    (1..=count).map(|m| frequency * m as f64).collect()
}

/// The strongest line in the rest without the lines of `f`, if it is distinct from them and from their halves.
fn second_line(rest: &[f64], f: f64) -> Option<f64> {
    let n = rest.len() as f64;
    let below = strongest(rest, [BESIDE[0] * f, NEAR[0] * f]);
    let above = strongest(rest, [NEAR[1] * f, (BESIDE[1] * f).min(0.45)]);
    let g = if line_power(rest, below) > line_power(rest, above) { below } else { above };
    let halves = 2.0 * g / f;
    // Harmonics and halves belong to the first oscillation and its wander.
    ((halves - halves.round()).abs() * 0.5 * f > 1.5 / n).then_some(g)
}

/// The least damped mode near frequency `f` of a signal's autoregressive model.
fn least_damped(x: &[f64], f: f64) -> Option<Mode> {
    let model = burg(x, MAX_ORDER.min(x.len() / 5))?;
    let density = |f: f64| {
        let turn = unit(-2.0 * PI * f);
        let value = model.iter().rev().fold(Complex::new(0.0, 0.0), |sum, a| (sum + a) * turn) + 1.0;
        1.0 / value.norm_sqr()
    };
    let modes = roots(&model).into_iter().filter(|z| z.im > 0.0).map(|z| {
        let (re, im) = (0.5 * libm::log(z.norm_sqr()), libm::atan2(z.im, z.re));
        (-re / (re * re + im * im).sqrt(), im / (2.0 * PI))
    });
    let near = modes.filter(|(_, g)| *g > NEAR[0] * f && *g < NEAR[1] * f);
    let (damping, g) = near.min_by(|a, b| a.0.total_cmp(&b.0))?;
    let height = 2.0 * density(g) / (density(0.5 * g) + density((2.0 * g).min(0.5)));
    Some(Mode { damping, period_points: 1.0 / g, height })
}

fn unit(angle: f64) -> Complex<f64> {
    Complex::new(libm::cos(angle), libm::sin(angle))
}

/// Squared sum of `x` against a line of frequency `f`.
fn line_power(x: &[f64], f: f64) -> f64 {
    let turn = unit(2.0 * PI * f);
    x.iter().rev().fold(Complex::new(0.0, 0.0), |sum, v| sum * turn + v).norm_sqr()
}

/// Number of frequencies evaluated side by side.
const LANES: usize = 8;

/// Squared sums of `x` against lines of several frequencies.
fn line_powers(x: &[f64], f: [f64; LANES]) -> [f64; LANES] {
    let (turn_re, turn_im) = (f.map(|f| libm::cos(2.0 * PI * f)), f.map(|f| libm::sin(2.0 * PI * f)));
    let (mut re, mut im) = ([0.0; LANES], [0.0; LANES]);
    for v in x.iter().rev() {
        for lane in 0..LANES {
            let (a, b) = (re[lane], im[lane]);
            re[lane] = a * turn_re[lane] - b * turn_im[lane] + v;
            im[lane] = a * turn_im[lane] + b * turn_re[lane];
        }
    }
    core::array::from_fn(|lane| re[lane] * re[lane] + im[lane] * im[lane])
}

/// Frequency of the strongest line in a range, to a fortieth of a spectral bin.
pub(super) fn strongest(x: &[f64], range: [f64; 2]) -> f64 {
    let n = x.len() as f64;
    let look = |from: f64, to: f64, steps: i32| {
        let place = |k: i32| from + (to - from) * f64::from(k.min(steps)) / f64::from(steps);
        let groups = (0..=steps).step_by(LANES).map(|first| {
            let at: [f64; LANES] = core::array::from_fn(|lane| place(first + lane as i32));
            let powers = line_powers(x, at);
            (0..LANES).map(|lane| (powers[lane], at[lane])).fold((f64::NEG_INFINITY, from), stronger)
        });
        groups.fold((f64::NEG_INFINITY, from), stronger).1
    };
    let coarse = look(range[0], range[1], ((3.0 * (range[1] - range[0]) * n) as i32).clamp(4, 2000));
    look(coarse - 0.4 / n, coarse + 0.4 / n, 32)
}

/// The stronger of two lines (power, frequency); of equals the first.
fn stronger(a: (f64, f64), b: (f64, f64)) -> (f64, f64) {
    if b.0 > a.0 { b } else { a }
}

/// `x` minus its least-squares lines, each fitted to the residual of the others.
fn without_lines(x: &[f64], frequencies: &[f64]) -> Vec<f64> {
    let mut rest = x.to_vec();
    for _ in 0..3 {
        for f in frequencies {
            let angle = |k: usize| 2.0 * PI * f * k as f64;
            let cosine: Vec<f64> = (0..x.len()).map(|k| libm::cos(angle(k))).collect();
            let sine: Vec<f64> = (0..x.len()).map(|k| libm::sin(angle(k))).collect();
            let (cc, cs, ss) = (stats::dot(&cosine, &cosine), stats::dot(&cosine, &sine), stats::dot(&sine, &sine));
            let (xc, xs) = (stats::dot(&rest, &cosine), stats::dot(&rest, &sine));
            let determinant = cc * ss - cs * cs;
            if determinant > 1e-9 * cc * ss {
                let (a, b) = ((ss * xc - cs * xs) / determinant, (cc * xs - cs * xc) / determinant);
                for ((r, c), s) in rest.iter_mut().zip(&cosine).zip(&sine) {
                    *r -= a * c + b * s;
                }
            }
        }
    }
    rest
}

/// Coefficients `a` of `x(k) + a1 x(k-1) + ... = e(k)` by Burg's recursion, of the order that Akaike's criterion picks.
pub(super) fn burg(x: &[f64], max_order: usize) -> Option<Vec<f64>> {
    let n = x.len();
    let (mut forward, mut backward) = (x.to_vec(), x.to_vec());
    let mut error = stats::dot(x, x) / n as f64;
    if !error.is_normal() {
        return None;
    }
    let mut a: Vec<f64> = Vec::new();
    let mut best: Option<(f64, Vec<f64>)> = None;
    for order in 1..=max_order {
        let (f, b) = (&forward[order..], &backward[order - 1..n - 1]);
        let down = stats::dot(f, f) + stats::dot(b, b);
        if down <= 0.0 {
            break;
        }
        let k = -2.0 * stats::dot(f, b) / down;
        let mirrored: Vec<f64> = a.iter().rev().copied().collect();
        for (c, m) in a.iter_mut().zip(&mirrored) {
            *c += k * m;
        }
        a.push(k);
        for at in (order..n).rev() {
            let (f, b) = (forward[at], backward[at - 1]);
            forward[at] = f + k * b;
            backward[at] = b + k * f;
        }
        error *= 1.0 - k * k;
        if error <= 0.0 {
            break;
        }
        let criterion = n as f64 * libm::log(error) + 2.0 * order as f64;
        if best.as_ref().is_none_or(|b| criterion < b.0) {
            best = Some((criterion, a.clone()));
        }
    }
    best.map(|b| b.1)
}

/// The innovations of `x` under the model `a` of [`burg`], with zeros before the first point.
pub(super) fn filtered(x: &[f64], a: &[f64]) -> Vec<f64> {
    (0..x.len()).map(|k| x[k] + a.iter().zip(x[..k].iter().rev()).map(|(c, v)| c * v).sum::<f64>()).collect()
}

/// The same where all of the past is known.
pub(super) fn innovations(x: &[f64], a: &[f64]) -> Vec<f64> {
    filtered(x, a).split_off(a.len().min(x.len()))
}

/// Roots of `z^p + a1 z^(p-1) + ... + ap`, all at once (Durand 1960, Kerner 1966).
fn roots(a: &[f64]) -> Vec<Complex<f64>> {
    let p = a.len();
    let value = |z: Complex<f64>| a.iter().fold(Complex::new(1.0, 0.0), |sum, c| sum * z + c);
    let mut z: Vec<Complex<f64>> = (0..p).map(|i| unit(0.4 + 2.0 * PI * i as f64 / p as f64) * 0.9).collect();
    for _ in 0..200 {
        let mut moved = 0.0_f64;
        for i in 0..p {
            let others = (0..p).filter(|k| *k != i).fold(Complex::new(1.0, 0.0), |m, k| m * (z[i] - z[k]));
            let step = value(z[i]) / others;
            if step.re.is_finite() && step.im.is_finite() {
                z[i] -= step;
                moved = moved.max(step.norm_sqr());
            }
        }
        if moved < 1e-24 {
            break;
        }
    }
    z
}

#[cfg(test)]
mod tests {
    use super::super::noise;
    use super::*;

    /// A second-order mode of damping `zeta` and period `period` driven by white noise.
    fn rung(n: usize, zeta: f64, period: f64, seed: u64) -> Vec<f64> {
        let w = 2.0 * PI / period;
        let r = libm::exp(-zeta * w);
        let (mut a, mut b) = (0.0, 0.0);
        noise(n, seed)
            .into_iter()
            .map(|e| {
                (a, b) = (2.0 * r * libm::cos(w * (1.0 - zeta * zeta).sqrt()) * a - r * r * b + e, a);
                a
            })
            .collect()
    }

    #[test]
    fn the_roots_and_the_model_are_found() {
        // (z - 0.5)(z^2 - z + 0.5)
        let mut found = roots(&[-1.5, 1.0, -0.25]);
        found.sort_by(|a, b| a.im.total_cmp(&b.im));
        for (got, want) in found.iter().zip([(0.5, -0.5), (0.5, 0.0), (0.5, 0.5)]) {
            assert!((got.re - want.0).abs() < 1e-9 && (got.im - want.1).abs() < 1e-9, "{found:?}");
        }
        let model = burg(&rung(5000, 0.1, 10.0, 3), 2).unwrap();
        let r = libm::exp(-0.1 * 2.0 * PI / 10.0);
        assert!((model[1] - r * r).abs() < 0.02, "{model:?}");
    }

    #[test]
    fn a_mode_is_told_from_lines() {
        let mut height = [0.0; 2];
        for seed in 1..6 {
            let own = of(&rung(2500, 0.04, 100.0, seed), 100.0).unwrap();
            let mode = own.mode.unwrap();
            assert!(mode.damping < 0.2 && own.forced < 0.8 && own.unsteadiness > 0.2, "{own:?}");
            height[0] += mode.height;
            let line = |k: usize, p: f64| libm::sin(2.0 * PI * k as f64 / p);
            let sane = rung(2500, 0.5, 70.0, seed);
            let driven: Vec<f64> =
                sane.iter().enumerate().map(|(k, v)| 0.1 * v + 5.0 * line(k, 100.0) + 2.5 * line(k, 137.0)).collect();
            let driven = of(&driven, 101.0).unwrap();
            assert!((driven.period_points - 100.0).abs() < 1.0 && driven.forced > 0.7, "{driven:?}");
            let second = driven.second.unwrap();
            assert!((second.period_points - 137.0).abs() < 2.0 && (second.share - 0.2).abs() < 0.05, "{driven:?}");
            height[1] += driven.mode.map_or(0.0, |m| m.height);
        }
        assert!(height[0] > 4.0 * height[1], "{height:?}");
        assert!(of(&[1.0; 500], 50.0).is_none() && of(&noise(100, 1), 50.0).is_none());
    }
}
