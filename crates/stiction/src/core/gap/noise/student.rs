//! Student's t for innovations, so that a few wild ones do not turn a fit (Lange, Little and Taylor 1989).

use core::f64::consts::PI;

use crate::core::signal::stats;

/// Degrees of freedom tried: heavy tails, and next to none.
const FREEDOM: [f64; 2] = [8.0, 50.0];
/// Most rounds for the scale, and the relative change that ends them.
const ROUNDS: usize = 30;
const DONE: f64 = 1e-6;
/// Least scale, standard deviations of PV: held and rounded values leave innovations of 0.
const LEAST: f64 = 1e-4;

/// The distribution of innovations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Student {
    /// Degrees of freedom.
    pub freedom: f64,
    /// Scale, units of the innovations.
    pub scale: f64,
    /// Log likelihood of the innovations it was fitted to, nats.
    pub log_likelihood: f64,
}

impl Student {
    /// The likeliest of two degrees of freedom and any scale for innovations.
    #[must_use]
    pub(crate) fn of(e: impl Iterator<Item = f64>) -> Self {
        let squares: Vec<f64> = e.map(|e| e * e).collect();
        let fits = FREEDOM.map(|freedom| Self::with(freedom, &squares));
        if fits[1].log_likelihood > fits[0].log_likelihood { fits[1] } else { fits[0] }
    }

    fn with(freedom: f64, squares: &[f64]) -> Self {
        let n = squares.len().max(1) as f64;
        let mut power = (1.5 * stats::median(squares)).max(LEAST * LEAST);
        for _ in 0..ROUNDS {
            let sum: f64 = squares.iter().map(|e2| (freedom + 1.0) * e2 / (freedom + e2 / power)).sum();
            let next = (sum / n).max(LEAST * LEAST);
            let change = (next / power - 1.0).abs();
            power = next;
            if change < DONE {
                break;
            }
        }
        let mut fit = Self { freedom, scale: power.sqrt(), log_likelihood: 0.0 };
        let height =
            libm::lgamma(0.5 * (freedom + 1.0)) - libm::lgamma(0.5 * freedom) - 0.5 * libm::log(freedom * PI * power);
        fit.log_likelihood = n * height - fit.losses(squares);
        fit
    }

    /// What squared innovations cost beyond innovations of 0, nats.
    fn losses(&self, squares: &[f64]) -> f64 {
        /// Factors multiplied before a logarithm is taken.
        const AT_ONCE: usize = 4;
        let share = 1.0 / (self.freedom * self.scale * self.scale);
        let logs = squares.chunks(AT_ONCE).map(|few| libm::log(few.iter().map(|e2| 1.0 + e2 * share).product()));
        0.5 * (self.freedom + 1.0) * logs.sum::<f64>()
    }

    /// What innovations cost beyond innovations of 0, nats.
    #[must_use]
    pub(crate) fn loss(&self, e: impl Iterator<Item = f64>) -> f64 {
        self.losses(&e.map(|e| e * e).collect::<Vec<_>>())
    }

    /// Weight of an innovation in the next round of least squares.
    #[must_use]
    pub(crate) fn weight(&self, e: f64) -> f64 {
        let z = e / self.scale;
        (self.freedom + 1.0) / (self.freedom + z * z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sim::noise::Noise;

    #[test]
    fn a_wild_value_hardly_moves_the_scale() {
        let mut noise = Noise::new(3, 1);
        let mut e: Vec<f64> = (0..800).map(|_| 0.2 * noise.gaussian()).collect();
        let clean = Student::of(e.iter().copied());
        assert!((clean.scale - 0.2).abs() < 0.02 && clean.freedom == 50.0, "{clean:?}");
        e[400] = 30.0;
        let wild = Student::of(e.iter().copied());
        assert!((wild.scale / clean.scale - 1.0).abs() < 0.1 && wild.freedom == 8.0, "{wild:?}");
        assert!(wild.weight(30.0) < 0.01 && wild.weight(0.0) > 1.0);
        assert!((wild.loss([0.2, -0.4].into_iter()) - wild.loss([-0.4, 0.2].into_iter())).abs() < 1e-12);
        assert!(Student::of([0.0; 50].into_iter()).scale > 0.0);
    }
}
