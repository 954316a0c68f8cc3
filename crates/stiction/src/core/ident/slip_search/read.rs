//! Bands read from PV itself, before any model is fitted, as starting points.
//!
//! Under He's law the stem rests between slips, so PV is piecewise: straight lines behind an integrator, exponentials of one
//! time constant behind a lag. The best segmentation of PV for a fixed time constant gives the instants of the slips. OP's
//! travel between two slips in the same direction is the jump j, across a reversal it is s. The dead time between slip and kink
//! is the one for which these travels agree best.

use std::ops::Range;

use super::problem::Problem;
use crate::core::signal::stats;

/// Time constants tried, periods; infinity is an integrator.
const TIME_CONSTANTS: [f64; 5] = [f64::INFINITY, 1.0, 0.3, 0.1, 0.03];
/// Least reduction of the error by an additional piece, noise variances: chance kinks rarely reach it.
const PIECE_COSTS: f64 = 15.0;
/// Least noise, standard deviations of PV: anything smaller is an error of the shape.
const LEAST_NOISE: f64 = 1e-3;
/// Longest piece, periods.
const LONGEST_PIECE: f64 = 1.2;
/// Two cuts nearer than this count as one slip, points: a slip between two samples bends PV twice.
const ONE_SLIP: usize = 2;
/// Most points that are read.
const MOST_POINTS: usize = 2_000;
/// Fewest slips, travels across a reversal and travels in one direction for which bands are read.
const FEWEST: [usize; 3] = [6, 4, 3];
/// Step of the dead time, points.
const LAG_STEP: f64 = 0.5;
/// Jumps tried, as shares of s, if no two slips go the same way, so that the travels do not show j.
const UNSEEN_JUMPS: [f64; 4] = [0.25, 0.5, 0.75, 1.0];
/// Bands kept, and the least distance between two: share of s, in s and in j.
const KEEP: usize = 20;
const APART: [f64; 2] = [0.02, 0.04];

/// Bands read from PV's kinks at one dead time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// s and j, spans of OP.
    pub bands: [f64; 2],
    /// Point of the first slip, and whether the stem moves up there.
    pub first: (f64, bool),
}

/// Readings from PV's kinks, most consistent first; empty if PV shows none.
#[must_use]
pub(crate) fn readings(problem: &Problem<'_>) -> Vec<Reading> {
    let normalised = problem.normalised;
    let points = problem.points().min(MOST_POINTS);
    let (op, pv) = (&normalised.mean[..points], &problem.pv()[..points]);
    let noise = stats::noise_sd(pv).max(LEAST_NOISE);
    let longest = ((LONGEST_PIECE * normalised.period) as usize).max(4);
    let step = stats::median(&op.windows(2).map(|w| (w[1] - w[0]).abs()).collect::<Vec<_>>());
    let mut read: Vec<(f64, Reading)> = Vec::new();
    for share in TIME_CONSTANTS {
        let decay = libm::exp(-1.0 / (share * normalised.period));
        let kinks = kinks(pv, &cuts(pv, decay, PIECE_COSTS * noise * noise, longest), decay, problem.sign);
        if kinks.len() < FEWEST[0] {
            continue;
        }
        let lags = (normalised.limits.lag[1] / LAG_STEP) as usize;
        for lag in (0..=lags).map(|k| LAG_STEP * k as f64) {
            let first = (kinks[0].0 as f64 - lag, kinks[0].1 > 0.0);
            read.extend(
                travels(op, &kinks, lag, step).into_iter().map(|(scatter, bands)| (scatter, Reading { bands, first })),
            );
        }
    }
    read.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut kept: Vec<Reading> = Vec::new();
    for (_, reading) in read {
        let [s, j] = reading.bands;
        let near = |k: &Reading| (k.bands[0] - s).abs() < APART[0] * s && (k.bands[1] - j).abs() < APART[1] * s;
        if kept.len() < KEEP && !kept.iter().any(near) {
            kept.push(reading);
        }
    }
    kept
}

/// An unfinished piece: sums for the fit of `level + slope * shape`.
struct Piece {
    first: usize,
    /// Shape at the next point: time itself behind an integrator, else the remaining share of the exponential.
    next_shape: f64,
    count: f64,
    shape: f64,
    shape2: f64,
    pv: f64,
    pv2: f64,
    both: f64,
}

impl Piece {
    const fn at(first: usize, decay: f64) -> Self {
        let next_shape = if decay < 1.0 { 1.0 } else { 0.0 };
        Self { first, next_shape, count: 0.0, shape: 0.0, shape2: 0.0, pv: 0.0, pv2: 0.0, both: 0.0 }
    }

    fn add(&mut self, pv: f64, decay: f64) {
        let shape = self.next_shape;
        self.next_shape = if decay < 1.0 { shape * decay } else { shape + 1.0 };
        self.count += 1.0;
        self.shape += shape;
        self.shape2 += shape * shape;
        self.pv += pv;
        self.pv2 += pv * pv;
        self.both += shape * pv;
    }

    /// Level and slope.
    fn fit(&self) -> [f64; 2] {
        let spread = self.shape2 - self.shape * self.shape / self.count;
        let slope = if spread > 1e-12 { (self.both - self.shape * self.pv / self.count) / spread } else { 0.0 };
        [(self.pv - slope * self.shape) / self.count, slope]
    }

    /// Residual sum of squares of the fit.
    fn left(&self) -> f64 {
        let [_, slope] = self.fit();
        let total = self.pv2 - self.pv * self.pv / self.count;
        (total - slope * (self.both - self.shape * self.pv / self.count)).max(0.0)
    }
}

/// First points of the second and all later pieces in the cheapest segmentation: optimal partitioning, which drops a piece once
/// its cost exceeds that of another way to the same point (Killick, Fearnhead and Eckley 2012).
fn cuts(pv: &[f64], decay: f64, piece_cost: f64, longest: usize) -> Vec<usize> {
    let n = pv.len();
    let (mut least, mut from) = (vec![f64::INFINITY; n + 1], vec![0; n + 1]);
    least[0] = 0.0;
    let mut open: Vec<Piece> = Vec::new();
    for (point, value) in pv.iter().enumerate() {
        if least[point].is_finite() {
            open.push(Piece::at(point, decay));
        }
        let end = point + 1;
        for piece in &mut open {
            piece.add(value - pv[piece.first], decay);
            let cost = least[piece.first] + piece.left() + piece_cost;
            if piece.count > 1.0 && cost < least[end] {
                (least[end], from[end]) = (cost, piece.first);
            }
        }
        open.retain(|p| p.count < 2.0 || p.count < longest as f64 && least[p.first] + p.left() < least[end]);
    }
    let mut out = Vec::new();
    let mut at = from[n];
    while at > 0 {
        out.push(at);
        at = from[at];
    }
    out.reverse();
    out
}

/// Kinks between pieces: their points, and the direction in which the stem went.
fn kinks(pv: &[f64], cuts: &[usize], decay: f64, sign: f64) -> Vec<(usize, f64)> {
    let mut places: Vec<usize> = Vec::with_capacity(cuts.len());
    for cut in cuts {
        if places.last().is_none_or(|last| *cut > last + ONE_SLIP) {
            places.push(*cut);
        }
    }
    let ends = places.iter().copied().chain([pv.len()]);
    let pieces: Vec<Range<usize>> =
        [0].into_iter().chain(places.iter().copied()).zip(ends).map(|(a, b)| a..b).collect();
    let driven = |piece: &Range<usize>| {
        let mut sums = Piece::at(piece.start, decay);
        pv[piece.clone()].iter().for_each(|v| sums.add(*v, decay));
        let [level, slope] = sums.fit();
        if decay < 1.0 { level } else { slope }
    };
    let levels: Vec<f64> = pieces.iter().map(driven).collect();
    places.iter().zip(levels.windows(2)).map(|(at, level)| (*at, (sign * (level[1] - level[0])).signum())).collect()
}

/// The bands implied by OP's travels between kinks at a dead time, with their relative scatter. A slip occurs at the first
/// sample beyond the band, so a travel exceeds the band by half of OP's `step` on average; if kinks were missed, the shorter
/// travels show j.
fn travels(op: &[f64], kinks: &[(usize, f64)], lag: f64, step: f64) -> Vec<(f64, [f64; 2])> {
    let at = |point: usize| {
        let place = point as f64 - lag;
        (place >= 0.0).then(|| {
            let (k, share) = (place as usize, place.fract());
            op[k] * (1.0 - share) + op[(k + 1).min(op.len() - 1)] * share
        })
    };
    let (mut across, mut along) = (Vec::new(), Vec::new());
    for pair in kinks.windows(2) {
        let [(before, was), (after, is)] = [pair[0], pair[1]];
        if let (Some(from), Some(to)) = (at(before), at(after)) {
            if was == is { &mut along } else { &mut across }.push(is * (to - from));
        }
    }
    if across.len() < FEWEST[1] {
        return Vec::new();
    }
    let middle = middle_of(&mut across);
    let s = middle - 0.5 * step;
    if !(s > 0.0 && s <= 1.0) {
        return Vec::new();
    }
    let scatter = spread_of(&mut across, middle) / s;
    if along.len() < FEWEST[2] {
        return UNSEEN_JUMPS.map(|share| (2.0 * scatter, [s, share * s])).to_vec();
    }
    let middle = middle_of(&mut along);
    let spread = spread_of(&mut along.clone(), middle) / s;
    let quarter = along.len() / 4;
    let short = *along.select_nth_unstable_by(quarter, f64::total_cmp).1;
    let j = [middle, short].map(|travel| (travel - 0.5 * step).clamp(0.0, s));
    j.map(|j| (scatter + spread, [s, j])).to_vec()
}

/// The upper median, in linear time; `values` must not be empty.
fn middle_of(values: &mut [f64]) -> f64 {
    let half = values.len() / 2;
    *values.select_nth_unstable_by(half, f64::total_cmp).1
}

/// Median distance from a value.
fn spread_of(values: &mut [f64], from: f64) -> f64 {
    values.iter_mut().for_each(|v| *v = (*v - from).abs());
    middle_of(values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::ident::normalised::normalise;
    use crate::core::ident::{Options, sign};
    use crate::core::record::Record;
    use crate::core::sim::closed_loop::{ClosedLoop, LoopModel, ValveLaw, ValveModel};
    use crate::core::sim::controller::{Action, PidSettings};
    use crate::core::sim::process::ProcessModel;
    use proptest::prelude::*;

    /// An integrating process under PI control with a sticking valve, after its start-up.
    fn integrating(fs: f64, fd: f64, dead_time: f64, seed: u64) -> Record {
        let gain = 0.02;
        let model = LoopModel {
            ts_s: 1.0,
            process: ProcessModel { gain, tau: 0.0, tau2: 0.0, dead_time, integrating: true },
            rest_op: 50.0,
            rest_pv: 60.0,
            controller: PidSettings {
                kc: 0.3 / (gain * (dead_time + 1.0)),
                ti_s: 12.0 * (dead_time + 1.0),
                td_s: 0.0,
                action: Action::Reverse,
                op_min: 0.0,
                op_max: 100.0,
                op_resolution: 0.0,
            },
            valve: ValveModel { law: ValveLaw::He, fs, fd, ..ValveModel::HEALTHY },
            pv_noise_sd: 0.005,
            load: vec![],
            pv_disturbance: vec![],
        };
        let mut closed = ClosedLoop::new(model, -1000.0, 60.0, seed);
        closed.record(1000, 60.5);
        closed.record(1200, 60.0)
    }

    #[test]
    fn bands_of_most_integrating_loops_are_among_the_readings() {
        let is_read = |seed: u8| {
            let [k, other] = [seed % 4, seed / 4].map(f64::from);
            let (fs, fd) = (2.0 + k, (2.0 + k) * (0.15 + 0.2 * other));
            let record = integrating(fs, fd, 2.3 + 1.7 * other, u64::from(seed));
            let (span, deviation) = (stats::span(&record.op_path), stats::std_dev(&record.pv));
            let normalised = normalise(&record, &Options::default(), span, deviation);
            let gain = sign::of_gain(&normalised.mean, &normalised.pv).unwrap_or(1.0);
            let truth = [(fs + fd) / span, (fs - fd) / span];
            let near = |r: &Reading| (0..2).all(|k| (r.bands[k] - truth[k]).abs() < 0.1 * truth[0]);
            readings(&Problem::new(&normalised, gain)).iter().any(near)
        };
        let right = (0..16).filter(|seed| is_read(*seed)).count();
        assert!(right >= 11, "{right} of 16");
    }

    #[test]
    fn the_cheapest_cut_of_straight_pieces_is_where_they_meet() {
        let pv: Vec<f64> = (0..90)
            .map(|k| match k {
                0..30 => f64::from(k),
                30..60 => 60.0 - f64::from(k),
                _ => f64::from(k) - 60.0,
            })
            .collect();
        let at = cuts(&pv, 1.0, 0.1, 90);
        assert!(at.len() == 2 && at[0].abs_diff(30) <= 1 && at[1].abs_diff(60) <= 1, "{at:?}");
        let (up, down) = (1.0, -1.0);
        assert_eq!(kinks(&pv, &at, 1.0, 1.0).iter().map(|k| k.1).collect::<Vec<_>>(), [down, up]);
        assert_eq!(kinks(&pv, &at, 1.0, -1.0).iter().map(|k| k.1).collect::<Vec<_>>(), [up, down]);
    }

    proptest! {
        #[test]
        fn any_record_gives_bands_within_the_span_or_none(
            signals in prop::collection::vec((-1e3..1e3f64, -1e3..1e3f64), 20..200)
        ) {
            let (op, pv): (Vec<f64>, Vec<f64>) = signals.into_iter().unzip();
            let (span, deviation) = (stats::span(&op).max(1e-9), stats::std_dev(&pv).max(1e-9));
            let normalised = normalise(&Record::uniform(1.0, op, pv), &Options::default(), span, deviation);
            for reading in readings(&Problem::new(&normalised, 1.0)) {
                let [s, j] = reading.bands;
                prop_assert!(0.0 < s && s <= 1.0 && (0.0..=s).contains(&j), "{s} {j}");
            }
        }
    }
}
