//! Traces that a transmitter or recorder leaves in PV itself: steps of a grid, held values, straight lines, cut ends,
//! single wild samples, a stretch that stands still.

use super::effects;
use super::noise::quantum;
use super::traces::{Traces, knots};
use super::types::{Parameter, Signature};
use crate::record::Record;
use crate::signal::stats;

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
    let n = pv.len() as f64;
    let sd = stats::std_dev(pv);
    let noise = stats::noise_sd(pv);
    let grid = quantum(pv);
    let ends = [pv.iter().copied().fold(f64::INFINITY, f64::min), pv.iter().copied().fold(f64::NEG_INFINITY, f64::max)];
    let repeats = if record.box_samples == 1 {
        stats::repeat_share(pv)
    } else {
        f64::from(record.facts.pv_repeats) / record.raw_samples.max(1) as f64
    };
    let still = longest_still(pv);
    let length = (still[1] - still[0]) as f64;
    let elsewhere = (repeats * n - length).max(0.0) / n;
    let at_ends = pv.windows(2).filter(|w| w[0] == w[1] && ends.contains(&w[0])).count() as f64 / n;
    // A signal that is cut off repeats its end.
    let held = if grid.is_none() { (repeats - at_ends).max(0.0) } else { 0.0 };
    let straight = straight_share(pv, sd);
    let at_end = |end: f64| pv.iter().filter(|v| **v == end).count() as f64 / n;
    let cut = if at_end(ends[0]) > at_end(ends[1]) { (ends[0], at_end(ends[0])) } else { (ends[1], at_end(ends[1])) };
    let wild = wild_samples(pv, noise);
    let wild_share = wild.iter().filter(|w| **w).count() as f64 / n * 1000.0;
    let coarse = grid.map_or(0.0, |q| (q / white_part(pv, q)).max(AGAINST_SD * q / sd));
    // Few levels put many samples at the ends as well.
    let is_grid = coarse > COARSE;
    let still_from = 10.0_f64.max(0.12 * period) + if is_grid { 0.5 * period } else { 0.0 };
    let stands = length >= still_from && elsewhere < 0.05;
    let at_its_end = ends.contains(&pv[still[0]]);
    let frozen = stands && !at_its_end;
    let least_cut = if stands && at_its_end { 0.0 } else { CUT };
    let number = |name: &'static str, value: f64, unit: &'static str| vec![Parameter { name, value, unit }];
    let signature = |id, value: f64, threshold: f64, also: bool, parameters| Signature {
        id,
        value,
        threshold,
        met: value > threshold && also,
        parameters,
    };
    // A recorder holds the farthest value once; an end of the range is met again and again.
    let visits = pv.windows(2).filter(|w| w[0] != w[1] && w[1] == cut.0).count();
    let is_cut = !is_grid && !frozen && (held <= RECORDED || visits > 1);
    let signatures = vec![
        signature(effects::quantisation::EFFECT.id, coarse, COARSE, true, number("quantum", grid.unwrap_or(0.0), "PV")),
        signature(effects::hold_compression::EFFECT.id, held, RECORDED, !frozen, number("held", held, "1")),
        signature(
            effects::swinging_door::EFFECT.id,
            straight,
            RECORDED,
            grid.is_none(),
            number("straight", straight, "1"),
        ),
        signature(effects::clipping::EFFECT.id, cut.1, least_cut, is_cut, number("end", cut.0, "PV")),
        signature(effects::outliers::EFFECT.id, wild_share, WILD_SHARE, true, number("per_thousand", wild_share, "1")),
        signature(
            effects::frozen_sensor::EFFECT.id,
            length,
            still_from,
            frozen,
            number("still", length * record.point_s(), "s"),
        ),
    ];
    let met = |id: &str| signatures.iter().any(|s| s.id == id && s.met) && !without.iter().any(|w| w == id);
    let mut masked = vec![false; pv.len()];
    if met(effects::outliers::EFFECT.id) {
        masked.clone_from(&wild);
    }
    if met(effects::frozen_sensor::EFFECT.id) {
        masked[still[0] + 1..=still[1]].fill(true);
    }
    if masked.iter().filter(|m| **m).count() as f64 > MOST_MASKED * n {
        masked.fill(false);
    }
    let at_the_end = met(effects::clipping::EFFECT.id).then_some(cut.0);
    let stands_still = met(effects::frozen_sensor::EFFECT.id).then_some(still);
    // The mean over a box of samples does not tell which of them were stored.
    let raw = record.box_samples == 1;
    let holds = raw && met(effects::hold_compression::EFFECT.id);
    let draws = raw && met(effects::swinging_door::EFFECT.id);
    let knots = if draws { knots(pv) } else { Vec::new() };
    let is_measured = |k: usize| {
        let stored = !(holds && k > 0 && pv[k] == pv[k - 1]) && (!draws || knots[k]);
        let moves = stands_still.is_none_or(|[from, to]| k <= from || k > to);
        stored && moves && at_the_end != Some(pv[k])
    };
    let mut measured: Vec<bool> = (0..pv.len()).map(is_measured).collect();
    let count = measured.iter().filter(|m| **m).count();
    let thinned = (holds || draws) && count >= FEWEST_STORED;
    if !thinned && count < FEWEST_MEASURED {
        measured.fill(true);
    }
    let compressed = met(effects::hold_compression::EFFECT.id) || met(effects::swinging_door::EFFECT.id);
    Traces {
        measured,
        masked,
        thinned,
        noise_shows: count >= FEWEST_MEASURED,
        beyond_reach: compressed && !thinned,
        still,
        ends,
        pv: pv.clone(),
        signatures,
    }
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
    use crate::gap::traces::between;
    use crate::sim::noise::{Noise, quantise};

    fn plain(seed: u64) -> Vec<f64> {
        let mut noise = Noise::new(seed, 0);
        (0..900).map(|k| 3.0 * libm::sin(f64::from(k) * 0.09) + 0.1 * noise.gaussian()).collect()
    }

    fn met(pv: Vec<f64>) -> Vec<&'static str> {
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
