//! What a sticking stem foretells of PV, and OP does not.
//!
//! Direct identification in closed loop (Ljung 1999, ch. 13.4): one-step prediction errors compare two inputs of the
//! process fairly although OP answers PV, whatever disturbs the loop, if the model of what disturbs is rich enough. Here
//! it is a sum of PV's own past (an autoregressive part) and of a clock: a line and its harmonics, which take up a load
//! that repeats itself on its own account. What is left to explain is offered to OP and to the stems that He's and the
//! tracking law make of OP.

use core::f64::consts::PI;

use super::ringing::{harmonics, strongest};
use super::{Detector, View};
use crate::ident::sign;
use crate::record::Record;
use crate::signal::{detrend, stats};
use crate::sim::valve::{Tracking, he_step, tracking_step};

/// By how much better the best stem foretells PV than OP does, OP's ends cut off where that helps it: the logarithm of
/// the ratio of the squared prediction errors times the number of boxes (twice the logarithm of the likelihoods' ratio),
/// less what the best of many stems gains by chance, as `sign(x) ln(1 + |x| / 10)`: 0 for a tie, above 2.5 where friction
/// is beyond doubt. The mean of a fine view with the clock and a coarse one without it, of those that have 40 boxes.
pub(super) struct Foresight;

/// How a record is cut into boxes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grain {
    /// Boxes a period of OP.
    per_period: f64,
    /// Boxes that a record of few periods is to have.
    enough: usize,
    /// Whether a clock is among what is known already.
    clock: bool,
}

/// The views: where there are few periods the fine one sees the slips, the coarse one the slow answer of the process.
pub(super) const GRAINS: [Grain; 2] =
    [Grain { per_period: 30.0, enough: 240, clock: true }, Grain { per_period: 20.0, enough: 40, clock: false }];
/// Fewest and most boxes.
const BOXES: [usize; 2] = [40, 1400];
/// Order of the autoregressive part, and boxes a term of it.
const ORDER: usize = 7;
const BOXES_PER_TERM: usize = 12;
/// Largest delay, periods, and its bounds, boxes.
const DELAY: f64 = 0.35;
const DELAYS: [f64; 2] = [4.0, 24.0];
/// s over OP's span, j over s, first positions over fs around OP's first value.
const BANDS: [f64; 12] = [0.06, 0.09, 0.13, 0.18, 0.24, 0.3, 0.37, 0.45, 0.54, 0.64, 0.76, 0.9];
const JUMPS: [f64; 4] = [0.0, 0.35, 0.7, 1.0];
const STARTS: [f64; 3] = [-0.9, 0.0, 0.9];
/// Fewest moves of a stem that is compared.
const MIN_SLIPS: usize = 3;
/// Shares of OP's values below and above which it may have no effect.
const ENDS: [f64; 6] = [0.0, 0.03, 0.08, 0.15, 0.25, 0.35];
/// What the best of the stems gains by chance, and the unit of the score.
const CHANCE: f64 = 15.0;
const UNIT: f64 = 10.0;

impl Detector for Foresight {
    fn name(&self) -> &'static str {
        "foresight"
    }

    fn score(&self, view: &View) -> Option<f64> {
        let scores: Vec<f64> = view.grounds.iter().flatten().map(Ground::score).collect();
        (!scores.is_empty()).then(|| stats::mean(&scores))
    }
}

/// How much of what PV's past does not foretell repeats itself like a clock: logarithm of the ratio of the squared
/// prediction errors without and with a line and its harmonics, less what lines gain by chance, 0..3. Large for a load
/// that a machine or a cycle elsewhere makes; a limit cycle of the loop's own drifts with noise and load.
pub(super) struct Clock;

/// Largest score.
const CERTAIN: f64 = 3.0;

impl Detector for Clock {
    fn name(&self) -> &'static str {
        "clock"
    }

    fn score(&self, view: &View) -> Option<f64> {
        view.grounds.iter().flatten().find_map(|ground| ground.clock).map(|c| c.clamp(0.0, CERTAIN))
    }
}

/// A record in boxes, with all that is known of PV before OP is asked.
#[derive(Debug, Clone)]
pub(super) struct Ground {
    path: Vec<f64>,
    /// OP values a box.
    width: usize,
    /// OP's robust span.
    span: f64,
    memory: Memory,
    /// First box that is foretold, and largest delay, boxes.
    from: usize,
    delays: usize,
    sign: Option<f64>,
    /// Gain of the clock, where there is one.
    clock: Option<f64>,
}

impl Ground {
    /// `period` is OP's typical one, points.
    pub(super) fn of(record: &Record, period: f64, grain: Grain) -> Option<Self> {
        let k = ((period / grain.per_period).round() as usize).min(record.len() / grain.enough).max(1);
        let count = (record.len() / k).min(BOXES[1]);
        let width = k * record.path_per_point();
        let path = record.op_path.get(..count * width)?.to_vec();
        let span = stats::span(&path);
        let pv = detrend::box_means(&record.pv[..count * k], k);
        let (level, spread) = (stats::mean(&pv), stats::std_dev(&pv));
        if count < BOXES[0] || !span.is_normal() || !spread.is_normal() {
            return None;
        }
        let pv: Vec<f64> = pv.iter().map(|y| (y - level) / spread).collect();
        let op = detrend::box_means(&path, width);
        let delays = (DELAY * period / k as f64).clamp(DELAYS[0], DELAYS[1]) as usize;
        let order = ORDER.min(count / BOXES_PER_TERM);
        let from = order.max(delays + 1);
        let mut memory = Memory { columns: Vec::new(), left: pv[from..].to_vec() };
        memory.add(vec![1.0; count - from]);
        for lag in 1..=order {
            memory.add(pv[from - lag..count - lag].to_vec());
        }
        let sign = sign::of_gain(&op, &pv);
        let mut clock = None;
        if grain.clock {
            let (error, known) = (memory.error(), memory.columns.len());
            memory = with_clock(memory, [&pv, &op]);
            let lines = (memory.columns.len() - known) as f64;
            clock = Some(gain(error, memory.error()) - 2.0 * lines / (count - from) as f64);
        }
        Some(Self { path, width, span, memory, from, delays, sign, clock })
    }

    /// What [`Foresight`] says of this view.
    fn score(&self) -> f64 {
        let sorted = stats::sorted(&self.path);
        let ends = ENDS.map(|e| [stats::quantile_sorted(&sorted, e), stats::quantile_sorted(&sorted, 1.0 - e)]);
        let cut = |low: f64, high: f64| self.path.iter().map(|u| u.clamp(low, high)).collect::<Vec<_>>();
        let pairs = ends.iter().flat_map(|low| ends.iter().map(|high| cut(low[0], high[1])));
        let without = pairs.fold(f64::INFINITY, |least, op| least.min(self.error(&op)));
        let with = self.stems().fold(f64::INFINITY, |least, stem| least.min(self.error(&stem)));
        let gained = self.memory.left.len() as f64 * gain(without, with) - CHANCE;
        gained.signum() * libm::log(1.0 + gained.abs() / UNIT)
    }

    /// Squared prediction error with `signal`, a value for each of OP's, as input: the best delay, its last two boxes
    /// with a free weight each, of the gain's sign.
    fn error(&self, signal: &[f64]) -> f64 {
        let input: Vec<f64> = signal.chunks_exact(self.width).map(|c| stats::mean(c) - signal[0]).collect();
        let end = input.len();
        let at = |lag: usize| &input[self.from - lag..end - lag];
        let looked: Vec<Look> = (1..=self.delays + 1).map(|lag| self.memory.look(at(lag))).collect();
        let errors = looked.windows(2).enumerate().map(|(k, pair)| {
            let together = stats::dot(at(k + 1), at(k + 2));
            self.memory.error_with([&pair[0], &pair[1]], together, self.sign)
        });
        errors.fold(self.memory.error(), f64::min)
    }

    /// Every stem that moves often enough.
    fn stems(&self) -> impl Iterator<Item = Vec<f64>> + '_ {
        let bands = BANDS.iter().flat_map(move |s| JUMPS.iter().map(move |j| (s * self.span, j * s * self.span)));
        let valves = bands.flat_map(|(s, j)| STARTS.iter().map(move |start| (0.5 * (s + j), 0.5 * (s - j), *start)));
        valves.flat_map(move |(fs, fd, start)| {
            let from = self.path.first().copied().unwrap_or(0.0) + start * fs;
            [self.staircase(from, fs, fd), self.sliding(from, fs, fd)].into_iter().flatten()
        })
    }

    fn staircase(&self, from: f64, fs: f64, fd: f64) -> Option<Vec<f64>> {
        let (mut position, mut slips) = (from, 0);
        let step = |op: &f64| {
            let next = he_step(position, *op, fs, fd);
            slips += usize::from(next != position);
            position = next;
            position
        };
        let stem = self.path.iter().map(step).collect();
        (slips >= MIN_SLIPS).then_some(stem)
    }

    fn sliding(&self, from: f64, fs: f64, fd: f64) -> Option<Vec<f64>> {
        let (mut state, mut slips) = (Tracking { position: from, direction: 0 }, 0);
        let step = |op: &f64| {
            let rested = state.direction == 0;
            state = tracking_step(state, *op, fs, fd);
            slips += usize::from(rested && state.direction != 0);
            state.position
        };
        let stem = self.path.iter().map(step).collect();
        (slips >= MIN_SLIPS).then_some(stem)
    }
}

/// What a linear model knows already: orthonormal columns, and what they leave of the signal to be foretold.
#[derive(Debug, Clone)]
struct Memory {
    columns: Vec<Vec<f64>>,
    left: Vec<f64>,
}

/// A column against what is known: its share of each known column, what it holds beside them, its product with what is
/// left to be foretold.
struct Look {
    shares: Vec<f64>,
    new: f64,
    left: f64,
    /// Nothing beside what is known.
    known: bool,
}

/// Share of a column's power below which it says nothing that is not known already.
const KNOWN: f64 = 1e-9;

impl Memory {
    /// Learns a column (Gram-Schmidt, twice).
    fn add(&mut self, mut column: Vec<f64>) {
        let whole = stats::dot(&column, &column);
        for _ in 0..2 {
            for known in &self.columns {
                take_out(&mut column, known);
            }
        }
        let new = stats::dot(&column, &column);
        if new <= KNOWN * whole {
            return;
        }
        let size = new.sqrt();
        column.iter_mut().for_each(|x| *x /= size);
        take_out(&mut self.left, &column);
        self.columns.push(column);
    }

    fn error(&self) -> f64 {
        stats::dot(&self.left, &self.left)
    }

    /// A column against all that is known.
    fn look(&self, column: &[f64]) -> Look {
        let whole = stats::dot(column, column);
        let shares: Vec<f64> = self.columns.iter().map(|known| stats::dot(known, column)).collect();
        let new = whole - stats::dot(&shares, &shares);
        Look { known: new <= KNOWN * whole, new, shares, left: stats::dot(column, &self.left) }
    }

    /// Squared error with a pair of columns more, `together` their product, whose weights have a sum of the wanted sign.
    fn error_with(&self, [a, b]: [&Look; 2], together: f64, sign: Option<f64>) -> f64 {
        if a.known || b.known {
            return self.error();
        }
        let (aa, bb, ab) = (a.new, b.new, together - stats::dot(&a.shares, &b.shares));
        let (az, bz) = (a.left, b.left);
        let determinant = aa * bb - ab * ab;
        let weights = match determinant > KNOWN * aa * bb {
            true => [(bb * az - ab * bz) / determinant, (aa * bz - ab * az) / determinant],
            false => [az / aa, 0.0],
        };
        if sign.is_some_and(|s| s * (weights[0] + weights[1]) < 0.0) {
            return self.error();
        }
        (self.error() - weights[0] * az - weights[1] * bz).max(0.0)
    }
}

/// Logarithm of the ratio of two squared errors of normalised signals, of which rounding alone may be left.
fn gain(without: f64, with: f64) -> f64 {
    const LEAST: f64 = 1e-9;
    libm::log(without.max(LEAST) / with.max(LEAST))
}

fn take_out(x: &mut [f64], unit: &[f64]) {
    let share = stats::dot(x, unit);
    for (v, u) in x.iter_mut().zip(unit) {
        *v -= share * u;
    }
}

/// Periods that a clock needs, bins to either side of the strongest line among which its frequency is looked for, and
/// steps a bin.
const CLOCK_PERIODS: f64 = 2.0;
const REACH: i32 = 8;
const STEPS_PER_BIN: f64 = 10.0;

/// The memory with the clock that foretells most: the strongest line of one of the signals, with its harmonics.
fn with_clock(memory: Memory, signals: [&[f64]; 2]) -> Memory {
    let n = signals[0].len() as f64;
    let first = signals[0].len() - memory.left.len();
    let mut best = memory.clone();
    for signal in signals {
        let around = strongest(&detrend::remove_line(signal), [(CLOCK_PERIODS + 1.0) / n, 0.45]);
        for step in -REACH..=REACH {
            let f = around + f64::from(step) / (STEPS_PER_BIN * n);
            if f <= CLOCK_PERIODS / n {
                continue;
            }
            let mut clock = memory.clone();
            for line in harmonics(f) {
                let angle = |k: usize| 2.0 * PI * line * (first + k) as f64;
                clock.add((0..memory.left.len()).map(|k| libm::cos(angle(k))).collect());
                clock.add((0..memory.left.len()).map(|k| libm::sin(angle(k))).collect());
            }
            if clock.error() < best.error() {
                best = clock;
            }
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::super::noise;
    use super::*;
    use crate::sim::process::Pole;

    const N: usize = 1200;

    /// Scores of a PI loop on a first-order process whose valve has the bands `fs`, `fd`, under white noise and a load.
    fn scores(fs: f64, fd: f64, seed: u64, load: impl Fn(usize) -> f64) -> [f64; 2] {
        let (mut op, mut pv, mut stem) = (Vec::new(), Vec::new(), vec![0.0; 3]);
        let (mut position, mut integral, mut state) = (0.0, 0.0, 0.0);
        let pole = Pole::lag(10.0, 0.0);
        for (k, e) in noise(N, seed).iter().enumerate() {
            state = pole.a * state + (pole.b0 + pole.b1) * (stem[k] + load(k));
            let y = state + 0.2 * e;
            integral -= 0.06 * y;
            op.push(integral - 0.6 * y);
            pv.push(y);
            position = he_step(position, op[k], fs, fd);
            stem.push(position);
        }
        let view = View::new(&Record::uniform(1.0, op, pv));
        [Foresight.score(&view).unwrap(), Clock.score(&view).unwrap()]
    }

    fn triangle(k: usize) -> f64 {
        (8.0 * (k as f64 / 83.0).fract() - 4.0).abs() - 2.0
    }

    #[test]
    fn a_stem_foretells_what_op_does_not_only_where_the_valve_sticks() {
        for seed in 1..6 {
            let [sticking, healthy] = [scores(2.0, 1.0, seed, |_| 0.5), scores(0.0, 0.0, seed, |_| 0.5)];
            assert!(sticking[0] > 1.2 && healthy[0] < 0.8, "{sticking:?} {healthy:?}");
        }
    }

    #[test]
    fn a_load_like_a_clock_is_taken_for_one() {
        for seed in 1..6 {
            let [score, clock] = scores(0.0, 0.0, seed, triangle);
            assert!(score < 1.5 && clock > 0.05, "{score} {clock}");
            let [_, idle] = scores(0.0, 0.0, seed, |_| 0.5);
            assert!(idle < clock, "{idle} {clock}");
        }
    }

    #[test]
    fn offsets_scales_and_signs_do_not_matter() {
        let op: Vec<f64> = (0..600).map(|k| libm::sin(f64::from(k) * 0.1)).collect();
        let pv: Vec<f64> = op.iter().zip(noise(600, 3)).map(|(u, e)| (4.0 * u).round() + e).collect();
        let of = |a: f64, b: f64| {
            let scaled = |x: &[f64], c: f64| x.iter().map(|v| c * v + b).collect::<Vec<_>>();
            let view = View::new(&Record::uniform(1.0, scaled(&op, a), scaled(&pv, a)));
            [Foresight.score(&view).unwrap(), Clock.score(&view).unwrap()]
        };
        let plain = of(1.0, 0.0);
        for other in [of(8.0, 0.0), of(-3.0, 70.0), of(0.25, -5.0)] {
            assert!((0..2).all(|i| (plain[i] - other[i]).abs() < 1e-6), "{plain:?} {other:?}");
        }
    }
}
