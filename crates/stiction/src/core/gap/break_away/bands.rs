//! How the static band is distributed over the slips.

use core::f64::consts::PI;

/// Least and largest standard deviation of the bands' logarithm: with a larger one the search puts many small slips into one.
const SPREADS: [f64; 2] = [0.02, 0.45];
/// Steps by which median and spread are refined, logarithms.
const FINER: [f64; 4] = [0.3, 0.1, 0.03, 0.01];

/// A log-logistic distribution of bands: like the normal one of their logarithm, with tails in closed form.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bands {
    log_median: f64,
    scale: f64,
    /// Change of the median's logarithm over the record.
    growth: f64,
}

/// When a stem broke away, a share of the record from -0.5 to 0.5, and between which forces, OP units.
pub(super) type Break = (f64, [f64; 2]);

/// Standard deviation of the logistic distribution of scale 1.
fn deviation() -> f64 {
    PI / 3.0_f64.sqrt()
}

impl Bands {
    /// Of a median (OP units) and the standard deviation of the logarithm.
    pub(super) fn new(median: f64, spread: f64) -> Self {
        Self { log_median: libm::log(median), scale: spread / deviation(), growth: 0.0 }
    }

    /// The median in the middle of the record, OP units.
    pub(super) fn median(&self) -> f64 {
        libm::exp(self.log_median)
    }

    /// The median at a time, OP units.
    pub(super) fn median_at(&self, time: f64) -> f64 {
        libm::exp(self.log_median + self.growth * time)
    }

    /// Change of the median's logarithm over the record.
    pub(super) const fn growth(&self) -> f64 {
        self.growth
    }

    /// Standard deviation of the logarithm.
    pub(super) fn spread(&self) -> f64 {
        self.scale * deviation()
    }

    /// Log probability that a stem that held up to the force `before` still holds at the larger force `now`.
    pub(super) fn holds(&self, time: f64, before: f64, now: f64) -> f64 {
        self.log_above(time, now) - self.log_above(time, before)
    }

    /// Log probability that it breaks away between the two.
    pub(super) fn breaks(&self, time: f64, before: f64, now: f64) -> f64 {
        libm::log(-libm::expm1(self.holds(time, before, now).min(-1e-300)))
    }

    fn log_above(&self, time: f64, force: f64) -> f64 {
        let z = (libm::log(force) - self.log_median - self.growth * time) / self.scale;
        if z > 30.0 { -z } else { -libm::log1p(libm::exp(z)) }
    }

    /// The likeliest distribution near this one for stems that each held up to the first force and broke away by the second.
    pub(super) fn fitted(self, breaks: impl Iterator<Item = Break> + Clone) -> Self {
        let [least, most] = SPREADS.map(|spread| spread / deviation());
        let likelihood = |bands: &Self| -> f64 {
            let of = |(time, [held, broke]): Break| bands.log_above(time, held) + bands.breaks(time, held, broke);
            breaks.clone().map(of).sum()
        };
        let (mut best, mut value) = (self, likelihood(&self));
        for by in FINER {
            loop {
                let before = value;
                for (which, by) in [(0, by), (0, -by), (1, by), (1, -by), (2, by), (2, -by)] {
                    let mut tried = best;
                    match which {
                        0 => tried.log_median += by,
                        1 => tried.scale = (tried.scale * libm::exp(by)).clamp(least, most),
                        _ => tried.growth += by,
                    }
                    let other = likelihood(&tried);
                    if other > value {
                        (best, value) = (tried, other);
                    }
                }
                if value <= before || value.is_nan() {
                    break;
                }
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sim::noise::Noise;

    #[test]
    fn median_and_spread_are_read_from_intervals() {
        let mut noise = Noise::new(3, 1);
        let breaks: Vec<Break> = (0..400)
            .map(|k| {
                let time = f64::from(k) / 400.0 - 0.5;
                let cell = (20.0 * libm::exp(0.3 * noise.gaussian() + time)).floor();
                (time, [0.1 * cell.max(1e-6), 0.1 * (cell + 1.0)])
            })
            .collect();
        let found = Bands::new(5.0, 0.1).fitted(breaks.iter().copied());
        assert!((found.median() - 2.0).abs() < 0.1 && (found.spread() - 0.3).abs() < 0.05, "{found:?}");
        assert!((found.growth() - 1.0).abs() < 0.15, "{found:?}");
        // What holds or breaks is certain.
        let both = libm::exp(found.holds(0.2, 1.5, 1.6)) + libm::exp(found.breaks(0.2, 1.5, 1.6));
        assert!((both - 1.0).abs() < 1e-12);
    }
}
