//! Seeded random numbers that are bit-identical on every machine, and the quantiser.
//!
//! The generator is ChaCha with 8 rounds (fixed by its specification); the key is derived from the seed here, and logarithm and
//! cosine are portable. Each purpose has its own stream, so that adding a noise does not change the others.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// The 64-bit FNV-1a hash of a text, for named streams.
#[must_use]
pub fn stream_of(text: &str) -> u64 {
    text.bytes().fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0000_0100_0000_01b3))
}

/// Steele, Lea & Flood's SplitMix64 (2014): spreads a seed over a key.
fn split_mix(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A seeded source of random numbers.
#[derive(Debug, Clone)]
pub struct Noise {
    rng: ChaCha8Rng,
    spare: Option<f64>,
}

impl Noise {
    /// The source of `seed` and `stream`; different streams of one seed are independent.
    #[must_use]
    pub fn new(seed: u64, stream: u64) -> Self {
        let mut state = seed;
        let mut key = [0_u8; 32];
        for chunk in key.chunks_exact_mut(8) {
            chunk.copy_from_slice(&split_mix(&mut state).to_le_bytes());
        }
        let mut rng = ChaCha8Rng::from_seed(key);
        rng.set_stream(stream);
        Self { rng, spare: None }
    }

    /// Uniform in the open interval 0..1, 53 bits.
    pub fn uniform(&mut self) -> f64 {
        ((self.rng.next_u64() >> 11) as f64 + 0.5) * (1.0 / 9_007_199_254_740_992.0)
    }

    /// Whether an event of probability `p` occurs; always one draw.
    pub fn chance(&mut self, p: f64) -> bool {
        self.uniform() < p
    }

    /// A whole number in 0..`n`, 0 for `n` = 0.
    pub fn below(&mut self, n: u64) -> u64 {
        ((self.uniform() * n as f64) as u64).min(n.saturating_sub(1))
    }

    /// Standard normal (Box & Muller 1958); draws come in pairs, the second is kept.
    pub fn gaussian(&mut self) -> f64 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        let radius = (-2.0 * libm::log(self.uniform())).sqrt();
        let angle = 2.0 * core::f64::consts::PI * self.uniform();
        self.spare = Some(radius * libm::sin(angle));
        radius * libm::cos(angle)
    }
}

/// A first-order autoregressive signal: coloured noise with a time constant.
#[derive(Debug, Clone)]
pub struct Ar1 {
    phi: f64,
    kick: f64,
    value: f64,
    noise: Noise,
}

impl Ar1 {
    /// Stationary standard deviation `sd`, autocorrelation `exp(-1 / time_constant)` from sample to sample (`time_constant` in
    /// samples; 0 is white). The initial value is drawn from the stationary distribution.
    #[must_use]
    pub fn new(sd: f64, time_constant: f64, mut noise: Noise) -> Self {
        let phi = if time_constant > 0.0 { libm::exp(-1.0 / time_constant) } else { 0.0 };
        let value = sd * noise.gaussian();
        Self { phi, kick: sd * (1.0 - phi * phi).sqrt(), value, noise }
    }

    /// The value of this sample; advances by one.
    pub fn next_value(&mut self) -> f64 {
        let now = self.value;
        self.value = self.phi * self.value + self.kick * self.noise.gaussian();
        now
    }
}

/// A random walk from 0.
#[derive(Debug, Clone)]
pub struct RandomWalk {
    sd_per_sample: f64,
    value: f64,
    noise: Noise,
}

impl RandomWalk {
    /// A walk whose steps have the standard deviation `sd_per_sample`.
    #[must_use]
    pub(crate) fn new(sd_per_sample: f64, noise: Noise) -> Self {
        Self { sd_per_sample, value: 0.0, noise }
    }

    /// The value of this sample; advances by one.
    pub(crate) fn next_value(&mut self) -> f64 {
        let now = self.value;
        self.value += self.sd_per_sample * self.noise.gaussian();
        now
    }
}

/// `value` rounded to whole multiples of `quantum`; unchanged for a quantum of 0.
///
/// If 1/quantum is an integer (0.01, 0.1, 0.25, 0.5, …), the result is the double nearest to the decimal, so it prints with no
/// more digits than the quantum.
#[must_use]
pub fn quantise(value: f64, quantum: f64) -> f64 {
    if quantum <= 0.0 {
        return value;
    }
    let inverse = (1.0 / quantum).round();
    if inverse >= 1.0 && (inverse * quantum - 1.0).abs() < 1e-9 {
        (value * inverse).round() / inverse
    } else {
        (value / quantum).round() * quantum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moments(x: &[f64]) -> (f64, f64) {
        let n = x.len() as f64;
        let mean = x.iter().sum::<f64>() / n;
        (mean, (x.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / n).sqrt())
    }

    fn lag1(x: &[f64]) -> f64 {
        let (mean, sd) = moments(x);
        x.windows(2).map(|w| (w[0] - mean) * (w[1] - mean)).sum::<f64>() / (x.len() as f64 * sd * sd)
    }

    #[test]
    fn the_stream_is_pinned_to_its_bits() {
        // The first numbers of seed 1: a change here would change every simulated recording.
        let mut noise = Noise::new(1, 0);
        let got: Vec<u64> = (0..3).map(|_| noise.gaussian().to_bits()).collect();
        assert_eq!(got, [13_823_424_603_807_642_754, 13_814_564_528_175_681_346, 4_609_658_326_980_699_638]);
    }

    #[test]
    fn seeds_and_streams_differ_and_repeat() {
        let first = |seed, stream| Noise::new(seed, stream).uniform().to_bits();
        assert_eq!(first(7, 3), first(7, 3));
        assert_ne!(first(7, 3), first(8, 3));
        assert_ne!(first(7, 3), first(7, 4));
        assert_ne!(stream_of("FIC101"), stream_of("FIC102"));
    }

    #[test]
    fn gaussian_noise_has_its_moments_and_is_white() {
        let mut noise = Noise::new(2, 0);
        let x: Vec<f64> = (0..40_000).map(|_| noise.gaussian()).collect();
        let (mean, sd) = moments(&x);
        assert!(mean.abs() < 0.02 && (sd - 1.0).abs() < 0.02 && lag1(&x).abs() < 0.02);
        let beyond = x.iter().filter(|v| v.abs() > 1.96).count() as f64 / x.len() as f64;
        assert!((beyond - 0.05).abs() < 0.005, "{beyond}");
    }

    #[test]
    fn whole_numbers_and_chances_are_fair() {
        let mut noise = Noise::new(3, 0);
        let mut counts = [0_u32; 5];
        for _ in 0..10_000 {
            counts[noise.below(5) as usize] += 1;
        }
        assert!(counts.iter().all(|c| (1_850..2_150).contains(c)), "{counts:?}");
        assert_eq!(noise.below(0), 0);
        let hits = (0..10_000).filter(|_| noise.chance(0.2)).count();
        assert!((1_880..2_120).contains(&hits), "{hits}");
        assert!((0..100).all(|_| !noise.chance(0.0) && noise.chance(1.0)));
    }

    #[test]
    fn coloured_noise_has_its_spread_and_memory() {
        let mut ar = Ar1::new(2.0, 10.0, Noise::new(4, 0));
        let x: Vec<f64> = (0..60_000).map(|_| ar.next_value()).collect();
        let (mean, sd) = moments(&x);
        assert!(mean.abs() < 0.15 && (sd - 2.0).abs() < 0.1, "{mean} {sd}");
        assert!((lag1(&x) - libm::exp(-0.1)).abs() < 0.01);
    }

    #[test]
    fn a_random_walk_spreads_with_the_root_of_time() {
        let ends: Vec<f64> = (0..400)
            .map(|stream| {
                let mut walk = RandomWalk::new(0.5, Noise::new(5, stream));
                assert_eq!(walk.next_value(), 0.0);
                (0..100).map(|_| walk.next_value()).last().unwrap()
            })
            .collect();
        assert!((moments(&ends).1 - 5.0).abs() < 0.5);
    }

    #[test]
    fn quantised_values_are_short_decimals() {
        assert_eq!(quantise(12.3456, 0.01).to_string(), "12.35");
        assert_eq!(quantise(-0.26, 0.5), -0.5);
        assert_eq!(quantise(7.4, 3.0), 6.0);
        assert_eq!(quantise(7.4, 0.0), 7.4);
    }
}
