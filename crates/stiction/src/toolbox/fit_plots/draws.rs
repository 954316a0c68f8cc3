//! Results of searches with other seeds, and bands for other noise realisations.

use rand_chacha::ChaCha8Rng;

use super::FitPlots;
use crate::core::ident::Options;
use crate::core::ident::ValveChoice;
use crate::core::ident::normalised::NormalisedRecord;
use crate::core::ident::quantify;
use crate::core::ident::random::{seeded_rng, uniform};
use crate::core::ident::slip_search::candidate::Candidate;
use crate::core::ident::slip_search::evaluator::on_whole_record;
use crate::core::ident::slip_search::local_search::{Nearness, random_steps};
use crate::core::ident::slip_search::problem::Problem;
use crate::core::sim::slips::Law;

/// Result of one search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Optimum {
    /// Static band, OP units.
    pub fs: f64,
    /// Kinetic band, OP units.
    pub fd: f64,
    /// Root mean squared free-run error at these bands, PV units.
    pub rms: f64,
}

/// Restarts per picture.
pub const RESTARTS: usize = 8;
/// Resamples per picture.
pub const RESAMPLES: usize = 40;
/// Random steps of a search that starts at the answer.
const FINE_STEPS: usize = 25;
/// Fewest points in a block of the residual.
const SHORTEST_BLOCK: usize = 10;

impl FitPlots<'_> {
    /// Bands of a candidate: all s of its cell give the same slips, so `place` (0..1) selects one.
    fn optimum(&self, c: &Candidate, place: f64) -> Optimum {
        let [low, high] = [c.cells[0][0], c.cells[0][1].min(c.s.max(1.0))];
        let fd = c.fit.fd;
        let s = (low + place * (high - low)).max(2.0 * fd);
        Optimum { fs: (s - fd) * self.span(), fd: fd * self.span(), rms: self.rms(c.fit.sse) }
    }

    /// Result of the whole search with another seed and the same valve law: restarts with different results show several
    /// valleys of the error, not the uncertainty of the answer. Costs as much as an estimate.
    #[must_use]
    pub fn restart(&self, seed: u64) -> Option<Optimum> {
        let valve = match self.candidate.law {
            Law::He => ValveChoice::He,
            Law::Tracking => ValveChoice::Tracking,
        };
        let e = quantify(self.record, &Options { seed, valve, ..self.options }).ok()?;
        Some(Optimum { fs: 0.5 * (e.s + e.j), fd: 0.5 * (e.s - e.j), rms: e.mse.sqrt() })
    }

    /// Bands fitted again to `count` resampled records, with the residual reassembled from its own blocks (moving block
    /// bootstrap, Künsch 1989; blocks of one period). OP is kept as recorded, and each search starts at the answer: the spread
    /// is that of noise and disturbance near this answer, not of other answers.
    #[must_use]
    pub fn bootstrap(&self, count: usize, seed: u64) -> Vec<Optimum> {
        let mut rng = seeded_rng(seed, 12);
        let residual = self.residual();
        let n = residual.len();
        let block = (self.normalised.period.round() as usize).min(n / 4).max(SHORTEST_BLOCK.min(n));
        let from = self.normalised.from.min(self.normalised.pv.len());
        let mut out = Vec::with_capacity(count);
        for _ in 0..count {
            let drawn = blocks(&residual, block, &mut || uniform(&mut rng));
            let mut normalised = self.normalised.clone();
            for ((y, old), new) in normalised.pv[from..].iter_mut().zip(&residual).zip(&drawn) {
                *y += new - old;
            }
            let place = uniform(&mut rng);
            out.extend(self.found_again(&normalised, &mut rng).map(|c| self.optimum(&c, place)));
        }
        out
    }

    /// The answer refined by a few steps on a resampled record.
    fn found_again(&self, normalised: &NormalisedRecord, rng: &mut ChaCha8Rng) -> Option<Candidate> {
        let c = &self.candidate;
        on_whole_record(&Problem::new(normalised, self.sign), c.law, c.class, |evaluator, view| {
            let first = evaluator.met(view, [c.s, c.j], c.start, &c.fit)?;
            let found = random_steps(evaluator, view, first, FINE_STEPS, Nearness::USUAL, rng);
            evaluator.settle(view, &found)
        })
    }
}

/// A resample of the same length, assembled from blocks of `block` values with random starts.
fn blocks(x: &[f64], block: usize, draw: &mut dyn FnMut() -> f64) -> Vec<f64> {
    let mut out = Vec::with_capacity(x.len() + block);
    while out.len() < x.len() {
        let first = (draw() * (x.len() - block + 1) as f64) as usize;
        out.extend_from_slice(&x[first..first + block]);
    }
    out.truncate(x.len());
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_keep_neighbours_and_length() {
        let x: Vec<f64> = (0..100).map(f64::from).collect();
        let mut rng = seeded_rng(3, 1);
        let y = blocks(&x, 20, &mut || uniform(&mut rng));
        assert_eq!(y.len(), 100);
        assert!(y.chunks(20).all(|b| b.windows(2).all(|w| w[1] - w[0] == 1.0)));
        assert_ne!(x, y);
    }
}
