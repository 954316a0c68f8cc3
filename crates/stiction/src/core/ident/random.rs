//! Seeded random draws, identical on every machine.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// A uniform draw from [0, 1).
pub(crate) fn uniform(rng: &mut ChaCha8Rng) -> f64 {
    (rng.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
}

/// An approximately normal draw: the sum of twelve uniform draws, minus six.
pub(crate) fn normal(rng: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| uniform(rng)).sum::<f64>() - 6.0
}

/// A value just across an edge of its cell (30 %), else a normal step.
#[must_use]
pub(crate) fn moved(value: f64, cell: [f64; 2], sigma: f64, rng: &mut ChaCha8Rng) -> f64 {
    if uniform(rng) < 0.3 {
        let edge = if uniform(rng) < 0.5 { cell[0] * (1.0 - 1e-9) - 1e-12 } else { cell[1] * (1.0 + 1e-9) + 1e-12 };
        if edge.is_finite() && edge > 0.0 {
            return edge;
        }
    }
    value + sigma * normal(rng)
}

/// A generator for one purpose within one search.
#[must_use]
pub(crate) fn seeded_rng(seed: u64, purpose: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(purpose);
    rng
}
