//! A linear model of PV without input, and the reduction of its prediction error by an input.
//!
//! Columns are orthogonalised by Gram and Schmidt's method. An input is evaluated at every lag: its products with shifted
//! columns are cumulative sums at the edges of its pieces, updated from lag to lag.

use core::f64::consts::PI;

use super::inputs::Input;
use super::ringing::harmonics;
use crate::core::signal::stats;

/// Share of a column's power below which it is linearly dependent on the others.
pub(super) const SAYS: f64 = 1e-9;

/// Source of a column.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Source {
    Constant,
    /// PV this many bins earlier.
    Lag(usize),
    /// Cosine and sine of one of the lines.
    Cosine(usize),
    Sine(usize),
}

/// Orthonormal columns, and the residual of the predicted signal.
#[derive(Debug, Clone)]
pub(super) struct Known {
    columns: Vec<Vec<f64>>,
    sources: Vec<Source>,
    /// Coefficients of each original column in the orthonormal ones up to its own.
    mix: Vec<Vec<f64>>,
    pub left: Vec<f64>,
    /// PV, and its first predicted value.
    pub pv: Vec<f64>,
    pub from: usize,
    order: usize,
    /// Frequencies of the lines, cycles per bin.
    lines: Vec<f64>,
}

impl Known {
    /// A constant and PV's own past: `order` terms for the values starting at `from`.
    pub(crate) fn past(pv: Vec<f64>, from: usize, order: usize) -> Self {
        let left = pv[from..].to_vec();
        let (columns, sources, mix, lines) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let mut known = Self { columns, sources, mix, left, pv, from, order, lines };
        let n = known.pv.len();
        known.learn(Source::Constant, vec![1.0; n - from]);
        for lag in 1..=order {
            let column = known.pv[from - lag..n - lag].to_vec();
            known.learn(Source::Lag(lag), column);
        }
        known
    }

    /// The same with a line of frequency `f` and its harmonics.
    pub(crate) fn with_lines(mut self, f: f64) -> Self {
        for (index, line) in harmonics(f).into_iter().enumerate() {
            self.lines.push(line);
            let (cosine, sine) = wave(line, self.pv.len());
            self.learn(Source::Cosine(index), cosine[self.from..].to_vec());
            self.learn(Source::Sine(index), sine[self.from..].to_vec());
        }
        self
    }

    /// Adds a column (Gram-Schmidt, twice).
    fn learn(&mut self, source: Source, mut column: Vec<f64>) {
        let whole = stats::dot(&column, &column);
        let mut mix = vec![0.0; self.columns.len()];
        for _ in 0..2 {
            for (known, share) in self.columns.iter().zip(&mut mix) {
                *share += take_out(&mut column, known);
            }
        }
        let new = stats::dot(&column, &column);
        if new <= SAYS * whole {
            return;
        }
        let size = new.sqrt();
        column.iter_mut().for_each(|x| *x /= size);
        take_out(&mut self.left, &column);
        mix.push(size);
        self.columns.push(column);
        self.sources.push(source);
        self.mix.push(mix);
    }

    /// Number of columns.
    pub(crate) fn count(&self) -> usize {
        self.columns.len()
    }

    /// Squared prediction error.
    pub(crate) fn error(&self) -> f64 {
        stats::dot(&self.left, &self.left)
    }

    /// Converts products with the original columns to products with the orthonormal ones, `width` sets side by side.
    pub(crate) fn orthonormal(&self, products: &mut [f64], width: usize) {
        for (index, mix) in self.mix.iter().enumerate() {
            let (done, rest) = products.split_at_mut(index * width);
            let own = &mut rest[..width];
            for (earlier, share) in done.chunks_exact(width).zip(mix) {
                for (x, e) in own.iter_mut().zip(earlier) {
                    *x -= share * e;
                }
            }
            let size = 1.0 / mix[index];
            own.iter_mut().for_each(|x| *x *= size);
        }
    }

    /// Products of a complex line with the constant and PV's past, in column order; `first` is that with PV one bin earlier.
    pub(crate) fn past_with_line(&self, constant: [f64; 2], first: [f64; 2], ends: Ends, out: &mut Vec<[f64; 2]>) {
        out.clear();
        let n = self.pv.len();
        let (mut at, mut product) = (1, first);
        for source in &self.sources {
            match source {
                Source::Constant => out.push(constant),
                Source::Lag(lag) => {
                    // A linearly dependent lag was skipped, but still rotates the product.
                    while at < *lag {
                        product = ends.turned(product, self.pv[self.from - at - 1], self.pv[n - 1 - at]);
                        at += 1;
                    }
                    out.push(product);
                }
                Source::Cosine(_) | Source::Sine(_) => {}
            }
        }
    }
}

/// Updates a product of a signal with a complex line from one lag to the next.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ends {
    /// Rotation of the line per bin.
    pub turn: [f64; 2],
    /// Its value before the first valid bin, and at the last.
    pub before: [f64; 2],
    pub last: [f64; 2],
}

impl Ends {
    /// For a line of frequency `f` over the bins `from..n`.
    pub(crate) fn of(f: f64, from: usize, n: usize) -> Self {
        let at = |k: f64| [libm::cos(2.0 * PI * f * k), libm::sin(2.0 * PI * f * k)];
        Self { turn: at(1.0), before: at(from as f64 - 1.0), last: at(n as f64 - 1.0) }
    }

    /// The product at the next lag, with `enters` added in front and `leaves` removed at the end.
    pub(crate) fn turned(&self, p: [f64; 2], enters: f64, leaves: f64) -> [f64; 2] {
        let part = |i: usize| p[i] + enters * self.before[i] - leaves * self.last[i];
        let [re, im] = [part(0), part(1)];
        [re * self.turn[0] - im * self.turn[1], re * self.turn[1] + im * self.turn[0]]
    }
}

fn take_out(x: &mut [f64], unit: &[f64]) -> f64 {
    let share = stats::dot(x, unit);
    for (v, u) in x.iter_mut().zip(unit) {
        *v -= share * u;
    }
    share
}

/// Cumulative sums for evaluating inputs.
#[derive(Debug, Clone)]
pub(super) struct Sums {
    known: Known,
    error: f64,
    lags: usize,
    /// Columns of the tables, and the start of each kind: one per difference of lags, the constant, the lines, the residual at
    /// each lag.
    width: usize,
    /// Cumulative sums of the columns, and of their products with OP.
    plain: Vec<f64>,
    with_op: Vec<f64>,
    ends: Vec<Ends>,
}

/// Work space reused for every input.
#[derive(Debug, Clone, Default)]
pub(super) struct Work {
    totals: Vec<f64>,
    shares: Vec<f64>,
    new: Vec<f64>,
    together: Vec<f64>,
}

impl Sums {
    /// `follow` is OP in bins, as followed by inputs.
    pub(crate) fn new(known: Known, follow: &[f64], lags: usize) -> Self {
        let (n, from, order) = (known.pv.len(), known.from, known.order);
        let differences = lags + order - 1;
        let width = differences + 1 + 2 * known.lines.len() + lags;
        let mut row = vec![0.0; width];
        let [mut plain, mut with_op] = [vec![0.0; (n + 1) * width], vec![0.0; (n + 1) * width]];
        let waves: Vec<(Vec<f64>, Vec<f64>)> = known.lines.iter().map(|f| wave(*f, n + 1)).collect();
        for m in 0..n {
            for (index, slot) in row[..differences].iter_mut().enumerate() {
                // PV's index minus the input's.
                let d = index as isize + 1 - order as isize;
                let lag = (d + 1).max(1) as usize;
                *slot = if within(m, from, n, lag) { known.pv[(m as isize + d) as usize] } else { 0.0 };
            }
            let one = f64::from(u8::from(within(m, from, n, 1)));
            row[differences] = one;
            for (pair, (cosine, sine)) in row[differences + 1..].chunks_exact_mut(2).zip(&waves) {
                pair[0] = one * cosine[m + 1];
                pair[1] = one * sine[m + 1];
            }
            for (index, slot) in row[width - lags..].iter_mut().enumerate() {
                let lag = index + 1;
                *slot = if within(m, from, n, lag) { known.left[m + lag - from] } else { 0.0 };
            }
            let (before, after) = plain.split_at_mut((m + 1) * width);
            for ((next, last), x) in after.iter_mut().zip(&before[m * width..]).zip(&row) {
                *next = last + x;
            }
            let (before, after) = with_op.split_at_mut((m + 1) * width);
            for ((next, last), x) in after.iter_mut().zip(&before[m * width..]).zip(&row) {
                *next = last + follow[m] * x;
            }
        }
        let ends = known.lines.iter().map(|f| Ends::of(*f, from, n)).collect();
        Self { error: known.error(), known, lags, width, plain, with_op, ends }
    }

    /// Squared error without an input.
    pub(crate) fn without(&self) -> f64 {
        self.error
    }

    /// Number of predicted bins.
    pub(crate) fn count(&self) -> usize {
        self.known.left.len()
    }

    /// Squared prediction error with an input: the best delay, with free weights on its last two bins, whose sum has the
    /// required sign.
    pub(crate) fn error(&self, input: &Input, sign: Option<f64>, work: &mut Work) -> f64 {
        self.products(input, work);
        let (lags, count) = (self.lags, self.known.count());
        self.known.orthonormal(&mut work.shares[..count * lags], lags);
        work.new.clear();
        work.new.extend_from_slice(&input.power);
        work.together.clear();
        work.together.extend_from_slice(&input.neighbours);
        for shares in work.shares[..count * lags].chunks_exact(lags) {
            for ((new, together), (lag, share)) in
                work.new.iter_mut().zip(&mut work.together).zip(shares.iter().enumerate())
            {
                *new -= share * share;
                *together -= share * shares[(lag + 1).min(lags - 1)];
            }
        }
        let left = &work.totals[self.width - lags..];
        let speaks = |at: usize| work.new[at] > SAYS * input.power[at];
        let pairs = (0..lags - 1).filter(|at| speaks(*at) && speaks(at + 1));
        let errors = pairs.map(|at| {
            self.with_pair([work.new[at], work.new[at + 1]], work.together[at], [left[at], left[at + 1]], sign)
        });
        errors.fold(self.error, f64::min)
    }

    fn with_pair(&self, [aa, bb]: [f64; 2], ab: f64, [az, bz]: [f64; 2], sign: Option<f64>) -> f64 {
        let determinant = aa * bb - ab * ab;
        let weights = match determinant > SAYS * aa * bb {
            true => [(bb * az - ab * bz) / determinant, (aa * bz - ab * az) / determinant],
            false => [az / aa, 0.0],
        };
        if sign.is_some_and(|s| s * (weights[0] + weights[1]) < 0.0) {
            return self.error;
        }
        (self.error - weights[0] * az - weights[1] * bz).max(0.0)
    }

    /// Products of an input at every lag with the original columns (`shares`, by column), and with the residual (the end of
    /// `totals`).
    fn products(&self, input: &Input, work: &mut Work) {
        let width = self.width;
        work.totals.clear();
        work.totals.resize(width, 0.0);
        let mut add = |table: &[f64], at: usize, by: f64| {
            for (total, sum) in work.totals.iter_mut().zip(&table[at * width..(at + 1) * width]) {
                *total += by * sum;
            }
        };
        // Up to the edge as part of the previous piece, after it no longer.
        let (mut follows, mut offset) = (0.0, 0.0);
        for piece in &input.pieces {
            if piece.offset != offset {
                add(&self.plain, piece.from, offset - piece.offset);
            }
            if piece.follows != follows {
                add(&self.with_op, piece.from, follows - piece.follows);
            }
            (follows, offset) = (piece.follows, piece.offset);
        }
        let n = self.known.pv.len();
        add(&self.plain, n, offset);
        add(&self.with_op, n, follows);
        self.spread(input, work);
    }

    /// From one product per column to one at every lag.
    fn spread(&self, input: &Input, work: &mut Work) {
        let known = &self.known;
        let (n, from, lags, order) = (known.pv.len(), known.from, self.lags, known.order);
        let (head, tail) = (&input.head, &input.tail);
        let differences = lags + order - 1;
        work.shares.resize(known.count().max(1) * lags, 0.0);
        for (source, out) in known.sources.iter().zip(work.shares.chunks_exact_mut(lags)) {
            match source {
                Source::Constant => {
                    let mut sum = work.totals[differences];
                    for (index, slot) in out.iter_mut().enumerate() {
                        *slot = sum;
                        let lag = index + 1;
                        if lag < lags {
                            sum += head[from - lag - 1] - tail[lag];
                        }
                    }
                }
                Source::Lag(own) => {
                    for (index, slot) in out.iter_mut().enumerate() {
                        let lag = index + 1;
                        // The first pair of this difference, and the values that entered and left since.
                        let first = if lag > *own { lag - own + 1 } else { 1 };
                        let mut sum = work.totals[lag + order - own - 1];
                        for at in first..lag {
                            let place = at + own - lag;
                            sum +=
                                head[from - at - 1] * known.pv[from - place - 1] - tail[at] * known.pv[n - 1 - place];
                        }
                        *slot = sum;
                    }
                }
                Source::Cosine(line) | Source::Sine(line) => {
                    let place = differences + 1 + 2 * line;
                    let part = usize::from(matches!(source, Source::Sine(_)));
                    let mut sum = [work.totals[place], work.totals[place + 1]];
                    for (index, slot) in out.iter_mut().enumerate() {
                        *slot = sum[part];
                        let lag = index + 1;
                        if lag < lags {
                            sum = self.ends[*line].turned(sum, head[from - lag - 1], tail[lag]);
                        }
                    }
                }
            }
        }
    }
}

/// Whether the input's bin `m` is used at this lag.
const fn within(m: usize, from: usize, n: usize, lag: usize) -> bool {
    m + lag >= from && m + lag < n
}

/// Bins after which a rotating line is recomputed, so that rounding errors do not accumulate.
const FRESH: usize = 32;

/// Cosine and sine of a line at every bin.
fn wave(f: f64, n: usize) -> (Vec<f64>, Vec<f64>) {
    let angle = |k: usize| 2.0 * PI * f * k as f64;
    let (turn_cos, turn_sin) = (libm::cos(angle(1)), libm::sin(angle(1)));
    let (mut cosine, mut sine) = (Vec::with_capacity(n), Vec::with_capacity(n));
    let (mut c, mut s) = (1.0, 0.0);
    for k in 0..n {
        if k % FRESH == 0 {
            (c, s) = (libm::cos(angle(k)), libm::sin(angle(k)));
        }
        cosine.push(c);
        sine.push(s);
        (c, s) = (c * turn_cos - s * turn_sin, c * turn_sin + s * turn_cos);
    }
    (cosine, sine)
}

/// Log ratio of two squared errors of normalised signals, protected against rounding errors.
pub(super) fn log_ratio(without: f64, with: f64) -> f64 {
    const LEAST: f64 = 1e-9;
    libm::log(without.max(LEAST) / with.max(LEAST))
}
