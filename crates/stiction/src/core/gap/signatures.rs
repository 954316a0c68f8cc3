//! Traces that a transmitter or recorder leaves in PV itself: steps of a grid, held values, straight lines, cut ends,
//! single wild samples, a stretch that stands still.

use super::effects::{self, Effect};
use super::noise::quantum;
use super::traces::{Traces, knots};
use super::types::{Parameter, Signature};
use crate::core::record::Record;
use crate::core::signal::stats;

/// Quantum over the white noise below which a grid is no cause of anything, and what a quantum of PV's whole deviation
/// counts for: second differences cannot tell the noise under a grid that PV crosses at every sample.
const COARSE: f64 = 2.0;
const AGAINST_SD: f64 = 12.0;
/// Share of held samples, or of samples on straight lines, that speaks for a recorder.
const RECORDED: f64 = 0.25;
/// Share of samples exactly at an end of PV's range; one long stand just there is enough, no sensor freezes so.
const CUT: f64 = 0.02;
/// Size of a wild sample against the noise, and how many in a thousand speak.
const WILD: f64 = 8.0;
const WILD_SHARE: f64 = 2.0;
/// Most of the record that may be masked.
const MOST_MASKED: f64 = 0.05;
/// Fewest measured points to which a model is fitted; with less all that was recorded counts.
const FEWEST_MEASURED: usize = 40;
/// The same where a recorder kept the others: what lies between stored values is the recorder's. On the eleven loops of split A
/// (seed 49) with fewer than forty of them, recorders closed -24 % in the median while all counted, 82 % on the nine that are fitted now.
const FEWEST_STORED: usize = 12;

/// Looks for all of them; `period` in points. Points are masked for none of the effects in `without`.
#[must_use]
pub(crate) fn traces(record: &Record, period: f64, without: &[String]) -> Traces {
    let pv = &record.pv;
    let seen = Seen::in_record(record, period);
    let met = |effect: &Effect| seen.meets(effect.id) && !without.iter().any(|id| id == effect.id);
    let (holds, draws) = (met(&effects::hold_compression::EFFECT), met(&effects::swinging_door::EFFECT));
    let stands = met(&effects::frozen_sensor::EFFECT).then_some(seen.still);
    let cut = met(&effects::clipping::EFFECT).then_some(seen.cut_at);
    // The mean over a box of samples does not tell which of them were stored.
    let is_raw = record.box_samples == 1;
    let mut measured = measured(pv, [holds && is_raw, draws && is_raw], stands, cut);
    let count = measured.iter().filter(|m| **m).count();
    let thinned = (holds || draws) && is_raw && count >= FEWEST_STORED;
    if !thinned && count < FEWEST_MEASURED {
        measured.fill(true);
    }
    Traces {
        measured,
        masked: masked(pv.len(), met(&effects::outliers::EFFECT).then_some(seen.wild.as_slice()), stands),
        thinned,
        noise_shows: count >= FEWEST_MEASURED,
        beyond_reach: (holds || draws) && !thinned,
        still: seen.still,
        ends: seen.ends,
        pv: pv.clone(),
        signatures: seen.signatures,
    }
}

/// What PV shows; no option changes it.
struct Seen {
    signatures: Vec<Signature>,
    /// First and last point of the longest stretch that stands still.
    still: [usize; 2],
    /// Least and greatest value.
    ends: [f64; 2],
    /// The end of PV's range at which more samples lie.
    cut_at: f64,
    /// Whether each sample is wild.
    wild: Vec<bool>,
}

impl Seen {
    fn in_record(record: &Record, period: f64) -> Self {
        let pv = &record.pv;
        let (n, sd) = (pv.len() as f64, stats::std_dev(pv));
        let grid = quantum(pv);
        let ends =
            [pv.iter().copied().fold(f64::INFINITY, f64::min), pv.iter().copied().fold(f64::NEG_INFINITY, f64::max)];
        let repeats = repeat_share(record);
        let still = longest_still(pv);
        let length = (still[1] - still[0]) as f64;
        let elsewhere = (repeats * n - length).max(0.0) / n;
        let at_ends = pv.windows(2).filter(|w| w[0] == w[1] && ends.contains(&w[0])).count() as f64 / n;
        // A signal that is cut off repeats its end.
        let held = if grid.is_none() { (repeats - at_ends).max(0.0) } else { 0.0 };
        let straight = straight_share(pv, sd);
        let share_at = |end: f64| pv.iter().filter(|v| **v == end).count() as f64 / n;
        let cut_at = if share_at(ends[0]) > share_at(ends[1]) { ends[0] } else { ends[1] };
        let wild = wild_samples(pv, stats::noise_sd(pv));
        let wild_share = wild.iter().filter(|w| **w).count() as f64 / n * 1000.0;
        let coarse = grid.map_or(0.0, |q| (q / white_part(pv, q)).max(AGAINST_SD * q / sd));
        // Few levels put many samples at the ends as well.
        let is_grid = coarse > COARSE;
        let still_from = 10.0_f64.max(0.12 * period) + if is_grid { 0.5 * period } else { 0.0 };
        let stands = length >= still_from && elsewhere < 0.05;
        let is_at_end = ends.contains(&pv[still[0]]);
        let frozen = stands && !is_at_end;
        let least_cut = if stands && is_at_end { 0.0 } else { CUT };
        // A recorder holds the farthest value once; an end of the range is met again and again.
        let visits = pv.windows(2).filter(|w| w[0] != w[1] && w[1] == cut_at).count();
        let is_cut = !is_grid && !frozen && (held <= RECORDED || visits > 1);
        let signature = |effect: &Effect, [value, threshold]: [f64; 2], also: bool, (name, size, unit)| Signature {
            id: effect.id.to_owned(),
            value,
            threshold,
            met: value > threshold && also,
            parameters: vec![Parameter { name, value: size, unit }],
        };
        let stood_s = length * record.point_s();
        let has_no_grid = grid.is_none();
        let grid = grid.unwrap_or(0.0);
        let signatures = vec![
            signature(&effects::quantisation::EFFECT, [coarse, COARSE], true, ("quantum", grid, "PV")),
            signature(&effects::hold_compression::EFFECT, [held, RECORDED], !frozen, ("held", held, "1")),
            signature(&effects::swinging_door::EFFECT, [straight, RECORDED], has_no_grid, ("straight", straight, "1")),
            signature(&effects::clipping::EFFECT, [share_at(cut_at), least_cut], is_cut, ("end", cut_at, "PV")),
            signature(&effects::outliers::EFFECT, [wild_share, WILD_SHARE], true, ("per_thousand", wild_share, "1")),
            signature(&effects::frozen_sensor::EFFECT, [length, still_from], frozen, ("still", stood_s, "s")),
        ];
        Self { signatures, still, ends, cut_at, wild }
    }

    fn meets(&self, id: &str) -> bool {
        self.signatures.iter().any(|s| s.id == id && s.met)
    }
}

/// Share of samples that repeat the one before.
fn repeat_share(record: &Record) -> f64 {
    if record.box_samples == 1 {
        stats::repeat_share(&record.pv)
    } else {
        f64::from(record.facts.pv_repeats) / record.raw_samples.max(1) as f64
    }
}

/// Points that count for nothing: wild samples, and a stretch that stands still; none where that would be too many.
fn masked(points: usize, wild: Option<&[bool]>, stands: Option<[usize; 2]>) -> Vec<bool> {
    let mut masked = wild.map_or_else(|| vec![false; points], <[bool]>::to_vec);
    if let Some([from, to]) = stands {
        masked[from + 1..=to].fill(true);
    }
    if masked.iter().filter(|m| **m).count() as f64 > MOST_MASKED * points as f64 {
        masked.fill(false);
    }
    masked
}

/// Points that were measured: neither held nor drawn by a recorder, nor of a stretch that stands still, nor cut off.
fn measured(pv: &[f64], [holds, draws]: [bool; 2], stands: Option<[usize; 2]>, cut: Option<f64>) -> Vec<bool> {
    let knots = if draws { knots(pv) } else { Vec::new() };
    let is_measured = |k: usize| {
        let stored = !(holds && k > 0 && pv[k] == pv[k - 1]) && (!draws || knots[k]);
        let moves = stands.is_none_or(|[from, to]| k <= from || k > to);
        stored && moves && cut != Some(pv[k])
    };
    (0..pv.len()).map(is_measured).collect()
}

/// Spread of what lies between the lines of a grid: at least what the grid itself adds.
fn white_part(pv: &[f64], quantum: f64) -> f64 {
    // Noise under a coarse grid shows in how often PV toggles between neighbours.
    let noise = stats::noise_sd(pv);
    let toggles = pv.windows(3).filter(|w| w[0] == w[2] && w[1] != w[0]).count() as f64 / pv.len() as f64;
    noise.max(quantum * toggles).max(0.05 * quantum)
}

fn longest_still(pv: &[f64]) -> [usize; 2] {
    let (mut best, mut from) = ([0, 0], 0);
    for k in 1..pv.len() {
        if pv[k] != pv[k - 1] {
            from = k;
        }
        if k - from > best[1] - best[0] {
            best = [from, k];
        }
    }
    best
}

fn straight_share(pv: &[f64], sd: f64) -> f64 {
    let straight = |w: &&[f64]| (w[2] - 2.0 * w[1] + w[0]).abs() < 1e-6 * sd && w[1] != w[0];
    pv.windows(3).filter(straight).count() as f64 / pv.len() as f64
}

/// Samples far from both neighbours, which agree.
fn wild_samples(pv: &[f64], noise: f64) -> Vec<bool> {
    let mut wild = vec![false; pv.len()];
    let usual = stats::median(&pv.windows(2).map(|w| (w[1] - w[0]).abs()).collect::<Vec<_>>());
    let least = (WILD * noise).max(8.0 * usual);
    for k in 2..pv.len().saturating_sub(2) {
        let (before, after) = (pv[k] - pv[k - 1], pv[k] - pv[k + 1]);
        let agree = (pv[k - 1] - pv[k + 1]).abs() < 0.3 * before.abs().min(after.abs());
        wild[k] = least > 0.0 && before * after > 0.0 && before.abs().min(after.abs()) > least && agree;
    }
    wild
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::gap::traces::between;
    use crate::core::sim::noise::{Noise, quantise};

    fn plain(seed: u64) -> Vec<f64> {
        let mut noise = Noise::new(seed, 0);
        (0..900).map(|k| 3.0 * libm::sin(f64::from(k) * 0.09) + 0.1 * noise.gaussian()).collect()
    }

    fn met(pv: Vec<f64>) -> Vec<String> {
        let record = Record::uniform(1.0, pv.clone(), pv);
        traces(&record, 70.0, &[]).signatures.into_iter().filter(|s| s.met).map(|s| s.id).collect()
    }

    #[test]
    fn each_trace_is_seen_and_a_plain_record_has_none() {
        for seed in 0..20 {
            assert!(met(plain(seed)).is_empty(), "{:?}", met(plain(seed)));
            let pv = plain(seed);
            assert_eq!(met(pv.iter().map(|v| quantise(*v, 0.8)).collect()), ["quantisation"]);
            let mut held = pv.clone();
            for k in 1..held.len() {
                if (held[k] - held[k - 1]).abs() < 0.6 {
                    held[k] = held[k - 1];
                }
            }
            assert_eq!(met(held), ["hold_compression"]);
            assert_eq!(met(pv.iter().map(|v| v.min(2.0)).collect()), ["clipping"]);
            let mut wild = pv.clone();
            (1..9).for_each(|i| wild[i * 97] += 3.0);
            assert_eq!(met(wild), ["outliers"]);
            let mut frozen = pv.clone();
            frozen[300..340].fill(pv[300]);
            assert_eq!(met(frozen), ["frozen_sensor"]);
            let lines: Vec<f64> =
                (0..880).map(|k| pv[k - k % 9] + (pv[k - k % 9 + 9] - pv[k - k % 9]) * (k % 9) as f64 / 9.0).collect();
            assert_eq!(met(lines), ["swinging_door"]);
        }
    }

    #[test]
    fn what_a_recorder_put_between_stored_values_was_not_measured() {
        let pv = plain(2);
        let looked = |pv: Vec<f64>| traces(&Record::uniform(1.0, pv.clone(), pv), 70.0, &[]);
        assert!(looked(pv.clone()).measured.iter().all(|m| *m));
        let held = looked((0..900).map(|k| pv[k - k % 4]).collect());
        assert!(held.thinned && (0..900).all(|k| held.measured[k] == (k % 4 == 0)));
        let drawn = looked(
            (0..880).map(|k| pv[k - k % 9] + (pv[k - k % 9 + 9] - pv[k - k % 9]) * (k % 9) as f64 / 9.0).collect(),
        );
        assert!(drawn.thinned && (0..879).all(|k| drawn.measured[k] == (k % 9 == 0)));
        assert!(drawn.noise_shows && !drawn.beyond_reach);
        let few = looked((0..900).map(|k| pv[k - k % 30]).collect());
        assert!(few.thinned && !few.noise_shows && few.measured.iter().filter(|m| **m).count() == 30);
        let fewer = looked((0..900).map(|k| pv[k - k % 90]).collect());
        assert!(fewer.beyond_reach && fewer.measured.iter().all(|m| *m), "all that was recorded counts");
        let cut = looked(pv.iter().map(|v| v.min(2.0)).collect());
        assert!(!cut.thinned && (0..900).all(|k| cut.measured[k] == (pv[k] < 2.0)));
        let mut x = vec![7.0, 0.0, 9.0, 1.0, 7.0];
        between(&[false, true, false, true, false], &mut x);
        assert_eq!(x, [0.0, 0.0, 0.5, 1.0, 1.0]);
    }

    #[test]
    fn a_recorder_can_be_repeated_on_a_prediction() {
        let pv = plain(1);
        let held: Vec<f64> = (0..900).map(|k| pv[k - k % 4]).collect();
        let record = Record::uniform(1.0, pv.clone(), held.clone());
        let mut again = pv.clone();
        traces(&record, 70.0, &[]).hold(&mut again);
        assert_eq!(again, held);
    }
}
