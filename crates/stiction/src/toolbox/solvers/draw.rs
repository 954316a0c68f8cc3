//! Seeded random draws on the triangle.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::core::optim::local::on_triangle;

/// A random stream that is determined by the seed on every machine.
pub(super) struct Draws(ChaCha8Rng);

impl Draws {
    pub(crate) fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    /// Uniform between 0 and 1.
    pub(crate) fn share(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 * (1.0 / 9_007_199_254_740_992.0)
    }

    /// Uniform over the triangle.
    pub(crate) fn anywhere(&mut self) -> [f64; 2] {
        let (a, b) = (self.share(), self.share());
        [a.max(b), a.min(b)]
    }

    /// Uniform over the square of half width `reach` around a point, projected onto the triangle.
    pub(crate) fn near(&mut self, around: [f64; 2], reach: f64) -> [f64; 2] {
        let mut off = || reach * (2.0 * self.share() - 1.0);
        on_triangle([around[0] + off(), around[1] + off()])
    }
}
