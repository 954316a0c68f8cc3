//! Candidate inputs of the process: OP limited at its ends, and the stems of He's and the tracking model.
//!
//! All of them depend on OP only, so they are shared between views of a record with another PV. An input is stored as
//! [`Piece`]s, in each of which it is constant or follows OP; a product with any column then costs one step per piece, not
//! per bin.

use crate::core::signal::{detrend, stats};
use crate::core::sim::slips::{FirstSlip, Law, Stroke};
use crate::core::sim::steps::{Path, Steps};
use crate::core::sim::valve::{Tracking, he_step, tracking_step};

/// How a record is divided into bins.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grain {
    /// Bins per period of OP.
    pub per_period: f64,
    /// Desired number of bins for a record of few periods.
    pub enough: usize,
    /// Most bins.
    pub most: usize,
    /// Whether phase-coherent lines are part of the prior model.
    pub periodic: bool,
}

/// The views: with few periods, the fine view shows the slips and the coarse one the slow response of the process.
pub(super) const GRAINS: [Grain; 2] = [
    Grain { per_period: 30.0, enough: 240, most: 2048, periodic: true },
    Grain { per_period: 20.0, enough: 40, most: 2048, periodic: false },
];
/// Fewest bins.
const LEAST_BOXES: usize = 40;
/// Order of the autoregressive part, and bins per term.
const ORDER: usize = 7;
const BOXES_PER_TERM: usize = 12;
/// Largest delay in periods, and its bounds in bins.
const DELAY: f64 = 0.35;
const DELAYS: [f64; 2] = [4.0, 24.0];
/// s over OP's span, j over s, and first positions over fs around OP's first value.
const BANDS: [f64; 12] = [0.06, 0.09, 0.13, 0.18, 0.24, 0.3, 0.37, 0.45, 0.54, 0.64, 0.76, 0.9];
const JUMPS: [f64; 4] = [0.0, 0.35, 0.7, 1.0];
const STARTS: [f64; 3] = [-0.9, 0.0, 0.9];
/// Fewest moves of a stem.
const MIN_SLIPS: usize = 3;
/// Quantiles of OP below and above which it may have no effect.
const ENDS: [f64; 6] = [0.0, 0.03, 0.08, 0.15, 0.25, 0.35];

/// A range of bins, up to the next one's first, in which an input is constant or equal to OP's mean plus an offset.
#[derive(Debug, Clone, Copy)]
pub(super) struct Piece {
    pub from: usize,
    /// 1 if the input follows OP, else 0.
    pub follows: f64,
    pub offset: f64,
}

/// An input in bins, minus its first value.
#[derive(Debug, Clone)]
pub(super) struct Input {
    pub pieces: Vec<Piece>,
    /// Its values before the first predicted bin, and its last ones, latest first.
    pub head: Vec<f64>,
    pub tail: Vec<f64>,
    /// Its power over the predicted bins, and its product with itself a bin later, at lags 1, 2, ...
    pub power: Vec<f64>,
    pub neighbours: Vec<f64>,
}

/// A stem among the inputs.
#[derive(Debug, Clone)]
pub(super) struct StemInput {
    /// s over OP's span.
    pub share: f64,
    pub law: Law,
    pub input: Input,
}

/// OP in bins of one size.
#[derive(Debug, Clone)]
pub(super) struct Boxes {
    /// Record points and OP values per bin.
    pub points: usize,
    width: usize,
    path: Path,
    /// OP's robust span.
    span: f64,
    /// OP's mean in each bin, and the same minus its first value.
    pub op: Vec<f64>,
    pub follow: Vec<f64>,
    /// Cumulative sums of `follow`, its squares, and its products with the previous bin.
    sums: Vec<[f64; 3]>,
    ranges: Vec<Range>,
    /// Running minimum and maximum of OP.
    records: Vec<[f64; 2]>,
    /// Number of terms of the autoregressive part.
    pub order: usize,
    /// First predicted bin, and lags tried for an input.
    pub from: usize,
    pub lags: usize,
}

/// A bin of OP values: extremes, and whether OP only rises or only falls in it.
#[derive(Debug, Clone, Copy)]
struct Range {
    low: f64,
    high: f64,
    rises: bool,
    falls: bool,
}

impl Boxes {
    /// Bins of an OP path with `per_point` values per point, for PV of `points` points; `period` is OP's typical one, points.
    pub(crate) fn of(op_path: &[f64], per_point: usize, points: usize, period: f64, grain: Grain) -> Option<Self> {
        let k = ((period / grain.per_period).round() as usize).min(points / grain.enough).max(1);
        let count = (points / k).min(grain.most);
        let width = k * per_point;
        let path = op_path.get(..count * width)?;
        let span = stats::span(path);
        if count < LEAST_BOXES || !span.is_normal() {
            return None;
        }
        let op = detrend::box_means(path, width);
        let delays = (DELAY * period / k as f64).clamp(DELAYS[0], DELAYS[1]) as usize;
        let order = ORDER.min(count / BOXES_PER_TERM);
        let follow: Vec<f64> = op.iter().map(|u| u - path[0]).collect();
        Some(Self {
            points: k,
            width,
            span,
            sums: sums(&follow),
            follow,
            op,
            ranges: ranges(path, width),
            records: records(path),
            path: Path::new(path.to_vec(), width),
            order,
            from: order.max(delays + 1),
            lags: delays + 1,
        })
    }

    /// OP itself, limited at none, one or both of its ends.
    pub(crate) fn cut(&self) -> Vec<Input> {
        let sorted = stats::sorted(self.path.values());
        let ends = ENDS.map(|e| [stats::quantile_sorted(&sorted, e), stats::quantile_sorted(&sorted, 1.0 - e)]);
        ends.iter().flat_map(|low| ends.iter().map(|high| self.clipped(low[0], high[1]))).collect()
    }

    /// Every stem that moves often enough.
    pub(crate) fn stems(&self) -> Vec<StemInput> {
        let mut steps = Steps::default();
        let mut out = Vec::with_capacity(2 * BANDS.len() * JUMPS.len() * STARTS.len());
        for share in BANDS {
            for jump in JUMPS {
                let (s, j) = (share * self.span, jump * share * self.span);
                let (fs, fd) = (0.5 * (s + j), 0.5 * (s - j));
                for start in STARTS {
                    let from = self.path.values().first().copied().unwrap_or(0.0) + start * fs;
                    let found = [
                        (Law::He, self.staircase(&mut steps, from, [s, j])),
                        (Law::Tracking, self.sliding(from, fs, fd)),
                    ];
                    out.extend(
                        found.into_iter().filter_map(|(law, input)| Some(StemInput { share, law, input: input? })),
                    );
                }
            }
        }
        out
    }

    /// OP as recorded, and stems that start at OP's first value: `shares` of OP's span for s, and j over s for He's and for the
    /// tracking model.
    pub(crate) fn few(&self, shares: &[f64], [he, tracking]: [[f64; 2]; 2]) -> (Input, Vec<Input>) {
        let (mut steps, first) = (Steps::default(), self.first());
        let mut stems = Vec::with_capacity(4 * shares.len());
        for s in shares.iter().map(|share| share * self.span) {
            stems.extend(he.iter().filter_map(|jump| self.staircase(&mut steps, first, [s, jump * s])));
            let halves = tracking.map(|jump| [0.5 * s * (1.0 + jump), 0.5 * s * (1.0 - jump)]);
            stems.extend(halves.iter().filter_map(|[fs, fd]| self.sliding(first, *fs, *fd)));
        }
        (self.clipped(f64::NEG_INFINITY, f64::INFINITY), stems)
    }

    fn values(&self, index: usize) -> &[f64] {
        &self.path.values()[index * self.width..(index + 1) * self.width]
    }

    fn first(&self) -> f64 {
        self.path.values()[0]
    }

    fn clipped(&self, low: f64, high: f64) -> Input {
        let first = self.first().clamp(low, high);
        let piece = |(from, r): (usize, &Range)| {
            let fixed = |value: f64| Piece { from, follows: 0.0, offset: value - first };
            if r.low >= low && r.high <= high {
                Piece { from, follows: 1.0, offset: self.first() - first }
            } else if r.high <= low {
                fixed(low)
            } else if r.low >= high {
                fixed(high)
            } else {
                fixed(stats::mean(&self.values(from).iter().map(|u| u.clamp(low, high)).collect::<Vec<_>>()))
            }
        };
        self.input(self.ranges.iter().enumerate().map(piece))
    }

    /// A stem of He's model at `from` before the first value.
    fn staircase(&self, steps: &mut Steps, from: f64, [s, j]: [f64; 2]) -> Option<Input> {
        let (fs, fd) = (0.5 * (s + j), 0.5 * (s - j));
        let moved = self.records.partition_point(|[low, high]| *high <= from + fs && *low >= from - fs);
        let direction = if self.records.get(moved)?[1] > from + fs { 1.0 } else { -1.0 };
        let first = FirstSlip { direction, threshold: from + direction * fs };
        steps.run(&self.path, self.op.len(), Stroke::FREE, Law::He, [s, j], first);
        if steps.slips < MIN_SLIPS {
            return None;
        }
        let zero = he_step(from, self.first(), fs, fd);
        let mut stem = from - zero;
        let start = Piece { from: 0, follows: 0.0, offset: stem };
        let later = steps.list.iter().map(|step| {
            stem += step.level - fd * step.direction;
            Piece { from: step.point as usize, follows: 0.0, offset: stem }
        });
        Some(self.input(core::iter::once(start).chain(later)))
    }

    /// A stem of the tracking model at `from` before the first value. Bins in which it rests or slides throughout are handled
    /// at once.
    fn sliding(&self, from: f64, fs: f64, fd: f64) -> Option<Input> {
        let zero = he_step(from, self.first(), fs, fd);
        let (mut state, mut slips) = (Tracking { position: from, direction: 0 }, 0);
        let mut pieces: Vec<Piece> = Vec::with_capacity(self.op.len());
        for (index, range) in self.ranges.iter().enumerate() {
            let d = f64::from(state.direction);
            let slides = (d > 0.0 && range.rises) || (d < 0.0 && range.falls);
            let rests = d == 0.0 && range.high <= state.position + fs && range.low >= state.position - fs;
            let values = self.values(index);
            let piece = if slides {
                state.position = values[values.len() - 1] - d * fd;
                Piece { from: index, follows: 1.0, offset: self.first() - d * fd - zero }
            } else if rests {
                Piece { from: index, follows: 0.0, offset: state.position - zero }
            } else {
                let mut sum = 0.0;
                for op in values {
                    let rested = state.direction == 0;
                    state = tracking_step(state, *op, fs, fd);
                    slips += usize::from(rested && state.direction != 0);
                    sum += state.position;
                }
                Piece { from: index, follows: 0.0, offset: sum / values.len() as f64 - zero }
            };
            pieces.push(piece);
        }
        (slips >= MIN_SLIPS).then(|| self.input(pieces.into_iter()))
    }

    /// Joins pieces; if several start at the same bin, the last one counts.
    fn input(&self, parts: impl Iterator<Item = Piece>) -> Input {
        let mut pieces: Vec<Piece> = Vec::with_capacity(64);
        for part in parts {
            match pieces.last_mut() {
                Some(last) if last.from == part.from => *last = part,
                Some(last) if last.follows == part.follows && last.offset == part.offset => {}
                _ => pieces.push(part),
            }
        }
        let n = self.follow.len();
        let mut head = Vec::with_capacity(self.from);
        for (index, piece) in pieces.iter().enumerate() {
            let end = pieces.get(index + 1).map_or(n, |next| next.from).min(self.from);
            head.extend((piece.from..end).map(|at| self.value(piece, at)));
            if end == self.from {
                break;
            }
        }
        let mut tail = Vec::with_capacity(self.lags + 2);
        for piece in pieces.iter().rev() {
            while tail.len() < self.lags + 2 && n - 1 - tail.len() >= piece.from {
                tail.push(self.value(piece, n - 1 - tail.len()));
            }
        }
        let [power, neighbours] = self.products(&pieces, &head, &tail);
        Input { pieces, head, tail, power, neighbours }
    }

    fn value(&self, piece: &Piece, at: usize) -> f64 {
        piece.follows * self.follow[at] + piece.offset
    }

    /// Power and product with the neighbour at every lag, updated from lag to lag.
    fn products(&self, pieces: &[Piece], head: &[f64], tail: &[f64]) -> [Vec<f64>; 2] {
        let (mut power, mut neighbour) = self.products_at_one(pieces);
        let mut out = [Vec::with_capacity(self.lags), Vec::with_capacity(self.lags)];
        for lag in 1..=self.lags {
            out[0].push(power.max(0.0));
            out[1].push(neighbour);
            if lag < self.lags {
                let (enters, leaves) = (head[self.from - lag - 1], tail[lag]);
                power += enters * enters - leaves * leaves;
                // The last product is not needed: it would extend before the record.
                let earlier = if self.from >= lag + 2 { head[self.from - lag - 2] } else { 0.0 };
                neighbour += enters * earlier - leaves * tail[lag + 1];
            }
        }
        out
    }

    /// The same at a lag of one: from the last bin before the first predicted one to the last but one.
    fn products_at_one(&self, pieces: &[Piece]) -> (f64, f64) {
        let [first, end] = [self.from - 1, self.follow.len() - 1];
        let (mut power, mut neighbour, mut last) = (0.0, 0.0, 0.0);
        for (index, piece) in pieces.iter().enumerate() {
            let next = pieces.get(index + 1).map_or(end, |next| next.from.min(end));
            if next < first {
                continue;
            }
            // A bin before the range counts as the neighbour of the first bin.
            let from = piece.from.max(first - 1);
            let own = from.max(first);
            if own < next {
                if from == piece.from && index > 0 && own == from {
                    neighbour += last * self.value(piece, from);
                }
                let inner = (own.max(from + 1)).min(next);
                if piece.follows > 0.0 {
                    let sum = |k: usize, a: usize, b: usize| self.sums[b][k] - self.sums[a][k];
                    let (o, count) = (piece.offset, (next - own) as f64);
                    power += sum(1, own, next) + o * (2.0 * sum(0, own, next) + o * count);
                    let both = sum(0, inner, next) + sum(0, inner - 1, next - 1);
                    neighbour += sum(2, inner, next) + o * (both + o * (next - inner) as f64);
                } else {
                    let square = piece.offset * piece.offset;
                    power += square * (next - own) as f64;
                    neighbour += square * (next - inner) as f64;
                }
            }
            if next > piece.from {
                last = self.value(piece, next - 1);
            }
        }
        (power, neighbour)
    }
}

/// Cumulative sums of values, squares and products with the previous value.
fn sums(x: &[f64]) -> Vec<[f64; 3]> {
    let mut out = Vec::with_capacity(x.len() + 1);
    let (mut sum, mut before) = ([0.0; 3], 0.0);
    out.push(sum);
    for v in x {
        sum = [sum[0] + v, sum[1] + v * v, sum[2] + v * before];
        before = *v;
        out.push(sum);
    }
    out
}

fn ranges(path: &[f64], width: usize) -> Vec<Range> {
    let of = |(index, values): (usize, &[f64])| {
        let low = values.iter().copied().fold(f64::INFINITY, f64::min);
        let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let with_last = &path[(index * width).saturating_sub(1)..(index + 1) * width];
        let rises = with_last.windows(2).all(|w| w[1] >= w[0]);
        let falls = with_last.windows(2).all(|w| w[1] <= w[0]);
        Range { low, high, rises, falls }
    };
    path.chunks_exact(width).enumerate().map(of).collect()
}

fn records(path: &[f64]) -> Vec<[f64; 2]> {
    let mut so_far = [f64::INFINITY, f64::NEG_INFINITY];
    let all = path.iter().map(|u| {
        so_far = [so_far[0].min(*u), so_far[1].max(*u)];
        so_far
    });
    all.collect()
}
