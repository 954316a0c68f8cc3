//! The dominant cycle of one loop: its frequency, its share of the signal's power, and its phase over time.

use nalgebra::Complex;

use crate::core::record::Record;
use crate::core::signal::{detrend, spectrum};
use crate::core::units::s_from_ns;

/// Fewest cycles of the lowest frequency searched.
const LEAST_CYCLES: f64 = 3.5;
/// Highest frequency searched, cycles per sample.
const HIGHEST: f64 = 0.3;
/// A peak is a harmonic if the line at this fraction of its frequency has at least [`SUBHARMONIC`] of its power.
const FRACTIONS: [usize; 3] = [3, 2, 5];
/// See [`FRACTIONS`].
const SUBHARMONIC: f64 = 0.3;
/// Share of the power in the line and its harmonics above which a loop oscillates.
const LEAST_SHARE: f64 = 0.25;

/// The dominant cycle of a loop, in OP or PV, whichever shows it more clearly.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Cycle {
    /// Frequency, Hz.
    pub frequency_hz: f64,
    /// Share of the detrended signal's power at the frequency and its second and third harmonics, 0..1.
    pub share: f64,
    /// The detrended signal.
    pub signal: Vec<f64>,
    /// Time of the first point, s since the plant's epoch.
    pub start_s: f64,
    /// Time between points, s.
    pub point_s: f64,
}

impl Cycle {
    /// The cycle of a record, in seconds since `epoch_ns`; `None` if the loop does not oscillate.
    pub fn of(record: &Record, epoch_ns: i64) -> Option<Self> {
        let n = record.len();
        if n < 30 {
            return None;
        }
        let signals = [detrend::remove_line(&record.op()), detrend::remove_line(&record.pv)];
        let window: Vec<f64> = hann(n).collect();
        let windowed = signals.each_ref().map(|x| x.iter().zip(&window).map(|(v, w)| v * w).collect::<Vec<f64>>());
        let size = (4 * n).next_power_of_two();
        let powers = spectrum::powers([&windowed[0], &windowed[1]], size);
        let lines = powers.map(|power| line(&power[..=size / 2], n, size));
        let better = usize::from(lines[1].map_or(0.0, |l| l.1) >= lines[0].map_or(0.0, |l| l.1));
        let (bin, share) = lines[better].filter(|line| line.1 > LEAST_SHARE)?;
        let [op, pv] = signals;
        Some(Self {
            frequency_hz: bin / (size as f64 * record.point_s()),
            share,
            signal: if better == 0 { op } else { pv },
            start_s: s_from_ns(record.start_ns.saturating_sub(epoch_ns)),
            point_s: record.point_s(),
        })
    }

    /// Time of the last point, s since the plant's epoch.
    pub fn end_s(&self) -> f64 {
        self.start_s + self.signal.len().saturating_sub(1) as f64 * self.point_s
    }

    /// Period, s.
    pub fn period_s(&self) -> f64 {
        1.0 / self.frequency_hz
    }

    /// Complex amplitude at `frequency_hz` in Hann frames of `length_s` around each of `centres_s`; the phase is relative to
    /// the plant's epoch.
    pub fn demodulated(&self, frequency_hz: f64, centres_s: &[f64], length_s: f64) -> Vec<Complex<f64>> {
        let n = self.signal.len();
        let half = (length_s / 2.0 / self.point_s) as usize;
        let frame: Vec<f64> = hann(2 * half + 3).skip(1).take(2 * half + 1).collect();
        let total: f64 = frame.iter().sum();
        let phasors: Vec<Complex<f64>> = (0..n)
            .map(|k| {
                let cycles = frequency_hz * (self.start_s + k as f64 * self.point_s);
                phasor(cycles.floor() - cycles)
            })
            .collect();
        let at = |centre_s: &f64| {
            let centre = ((centre_s - self.start_s) / self.point_s).round() as isize;
            let (mut sum, mut leak, mut mean) = (Complex::<f64>::ZERO, Complex::<f64>::ZERO, 0.0);
            let mut add = |weight: f64, value: f64, phasor: Complex<f64>| {
                let phasor = phasor * weight;
                mean += weight * value;
                sum += phasor * value;
                leak += phasor;
            };
            let inside = usize::try_from(centre - half as isize).ok().map(|first| first..first + frame.len());
            match inside.and_then(|range| self.signal.get(range.clone()).zip(phasors.get(range))) {
                Some((values, phasors)) => {
                    frame.iter().zip(values).zip(phasors).for_each(|((weight, value), z)| add(*weight, *value, *z));
                }
                // Beyond the ends of the window the end values are repeated.
                None => frame.iter().enumerate().for_each(|(j, weight)| {
                    let place = (centre + j as isize - half as isize).clamp(0, n as isize - 1) as usize;
                    add(*weight, self.signal[place], phasors[place]);
                }),
            }
            // Subtract the frame's own mean, which would leak into a slow line.
            (sum - leak * (mean / total)) * (2.0 / total)
        };
        centres_s.iter().map(at).collect()
    }
}

/// Unit phasor at an angle of `cycles` turns; identical bits on every machine.
pub(super) fn phasor(cycles: f64) -> Complex<f64> {
    let (sin, cos) = libm::sincos(2.0 * core::f64::consts::PI * cycles);
    Complex::new(cos, sin)
}

/// Angle of a complex number, rad, -pi to pi; identical bits on every machine.
pub(super) fn angle(z: Complex<f64>) -> f64 {
    libm::atan2(z.im, z.re)
}

/// Absolute value of a complex number; identical bits on every machine.
pub(super) fn length(z: Complex<f64>) -> f64 {
    z.norm_sqr().sqrt()
}

/// Time by which the PV of the second record lags the first's at a common period, s, within half a period, because the sign of
/// the gain between them is unknown.
pub(super) fn lag_s(records: [&Record; 2], epoch_ns: i64, period_s: f64) -> f64 {
    let cycles = records.map(|record| Cycle {
        frequency_hz: 1.0 / period_s,
        share: 1.0,
        signal: detrend::remove_line(&record.pv),
        start_s: s_from_ns(record.start_ns.saturating_sub(epoch_ns)),
        point_s: record.point_s(),
    });
    let (from, to) = (cycles[0].start_s.max(cycles[1].start_s), cycles[0].end_s().min(cycles[1].end_s()));
    let length_s = (3.0 * period_s).min(to - from);
    let frames = ((to - from - length_s) / period_s).max(0.0) as usize + 1;
    let centres: Vec<f64> = (0..frames).map(|k| from + length_s / 2.0 + k as f64 * period_s).collect();
    let [first, second] = cycles.map(|cycle| cycle.demodulated(1.0 / period_s, &centres, length_s));
    let difference: Complex<f64> = first.iter().zip(&second).map(|(a, b)| a * b.conj()).sum();
    (angle(difference) / (2.0 * core::f64::consts::PI)).rem_euclid(0.5) * period_s
}

/// A Hann window of `n` points, zero at both ends.
pub(super) fn hann(n: usize) -> impl Iterator<Item = f64> {
    let step = 2.0 * core::f64::consts::PI / (n.max(2) - 1) as f64;
    (0..n).map(move |k| 0.5 - 0.5 * libm::cos(step * k as f64))
}

/// The strongest line of a spectrum as a (fractional) bin, and its share with two harmonics; `n` points padded to `size`.
fn line(power: &[f64], n: usize, size: usize) -> Option<(f64, f64)> {
    let (n, length) = (n as f64, size as f64);
    let low = (LEAST_CYCLES * length / n).ceil() as usize;
    let high = ((HIGHEST * length) as usize).min(power.len() - 2);
    if high <= low + 4 {
        return None;
    }
    let width = (2.0 * length / n).ceil() as usize;
    let strongest = |from: usize, to: usize| (from..to).max_by(|a, b| power[*a].total_cmp(&power[*b]));
    let mut peak = strongest(low, high)?;
    for fraction in FRACTIONS {
        let near = (peak as f64 / fraction as f64).round() as usize;
        if near > low {
            let below = strongest(near - (width / 2).min(near), near + width / 2 + 1)?;
            if power[below] > SUBHARMONIC * power[peak] {
                peak = below;
                break;
            }
        }
    }
    let curve = 2.0 * (power[peak - 1] - 2.0 * power[peak] + power[peak + 1]);
    let beside = if curve < 0.0 { ((power[peak - 1] - power[peak + 1]) / curve).clamp(-1.0, 1.0) } else { 0.0 };
    let total: f64 = power[(1.5 * length / n) as usize..].iter().sum();
    let around = |harmonic: usize| -> f64 {
        let from = (harmonic * peak).saturating_sub(width);
        power.get(from..(harmonic * peak + width + 1).min(power.len())).map_or(0.0, |bins| bins.iter().sum())
    };
    let share = (1..=3).map(around).sum::<f64>() / total;
    (total > 0.0 && share.is_finite()).then_some((peak as f64 + beside, share.min(1.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(period: f64, n: usize, harmonics: &[f64]) -> Record {
        let at = |k: usize| {
            let angle = 2.0 * core::f64::consts::PI * k as f64 / period;
            harmonics.iter().enumerate().map(|(h, a)| a * libm::sin((h + 1) as f64 * angle)).sum::<f64>()
        };
        let pv: Vec<f64> = (0..n).map(at).collect();
        Record::uniform(2.0, vec![50.0; n], pv)
    }

    #[test]
    fn the_frequency_is_found_below_its_own_harmonic() {
        let record = wave(80.0, 1000, &[1.0, 0.0, 1.5]);
        let cycle = Cycle::of(&record, 0).unwrap();
        assert!((cycle.period_s() - 160.0).abs() < 1.0, "{}", cycle.period_s());
        assert!(cycle.share > 0.95);
    }

    #[test]
    fn amplitude_and_phase_come_back() {
        let record = wave(80.0, 1000, &[3.0]);
        let cycle = Cycle::of(&record, 0).unwrap();
        for z in cycle.demodulated(1.0 / 160.0, &[600.0, 900.0, 1200.0], 480.0) {
            assert!((length(z) - 3.0).abs() < 0.05, "{z:?}");
            // A sine is a cosine delayed by a quarter of a period.
            assert!((angle(z) + core::f64::consts::FRAC_PI_2).abs() < 0.02, "{z:?}");
        }
    }

    #[test]
    fn noise_and_short_records_have_no_cycle() {
        let mut noise = crate::core::sim::noise::Noise::new(1, 1);
        let pv: Vec<f64> = (0..1000).map(|_| noise.gaussian()).collect();
        assert_eq!(Cycle::of(&Record::uniform(1.0, vec![50.0; 1000], pv), 0), None);
        assert_eq!(Cycle::of(&wave(80.0, 20, &[1.0]), 0), None);
    }
}
