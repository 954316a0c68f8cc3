//! Evidence that a member of a group causes the oscillation: its own signs of stiction, and how well its signals predict other
//! loops beyond their own past.
//!
//! Every figure is a gain of a linear prediction of PV: `ln(variance without / variance with)` some columns, minus the gain
//! expected from as many columns of noise (BIC). The strongest sign is how well the *stem* of one loop (its OP through He's
//! law) predicts another loop beyond the first loop's PV and OP: a stem that exists only in the model predicts no other loop.

use core::cell::OnceCell;

use nalgebra::{DMatrix, DVector, DVectorView};

use crate::core::record::Record;
use crate::core::signal::stats::{mean, std_dev};
use crate::core::sim::valve::he_step;
use crate::core::units::s_from_ns;
use crate::core::verdict::Assessment;

/// Points before the first predicted one: more than the longest lag.
const FIRST: usize = 13;
/// Longest lag and lead, points.
const LONGEST: usize = 12;
/// Fewest points to compare two loops, and three.
const LEAST_POINTS: [usize; 2] = [80, 100];
/// Most points per period.
const POINTS_A_PERIOD: f64 = 50.0;
/// Ridge on the normal equations, per point.
const RIDGE: f64 = 1e-9;
/// Upper limits of a fit's indicators.
const LARGEST: [f64; 2] = [8.0, 5.0];
/// Probability of stiction assumed for a loop that was not judged.
const UNKNOWN: f64 = 0.2;

/// The signals of a member, on the plant's time.
pub(super) struct Signals {
    start_s: f64,
    point_s: f64,
    op: Vec<f64>,
    pv: Vec<f64>,
    /// OP through He's law with the loop's own bands; `None` without bands.
    stem: Option<Vec<f64>>,
}

impl Signals {
    /// Signals of a record in seconds since `epoch_ns`, with its stem by the assessment's bands.
    pub fn of(record: &Record, assessment: &Assessment, epoch_ns: i64) -> Self {
        let bands = assessment.fs.zip(assessment.fd);
        Self {
            start_s: s_from_ns(record.start_ns.saturating_sub(epoch_ns)),
            point_s: record.point_s(),
            op: record.op(),
            pv: record.pv.clone(),
            stem: bands.map(|(fs, fd)| stem(record, fs, fd)),
        }
    }

    fn end_s(&self) -> f64 {
        self.start_s + self.pv.len().saturating_sub(1) as f64 * self.point_s
    }

    /// One signal at the times of `grid`, standardised: means over a grid point if the grid is coarser, else interpolated
    /// values.
    fn on(&self, signal: &[f64], grid: &Grid) -> Vec<f64> {
        let last = signal.len().saturating_sub(1) as f64;
        let mut values: Vec<f64> = if self.point_s < 0.75 * grid.step_s {
            let mut sums = vec![0.0];
            signal.iter().fold(0.0, |sum, v| {
                sums.push(sum + v);
                sum + v
            });
            let sum_at = |t: f64| between(&sums, ((t - self.start_s) / self.point_s + 0.5).clamp(0.0, last + 1.0));
            let half = grid.step_s / 2.0;
            let points = grid.step_s / self.point_s;
            grid.times().map(|t| (sum_at(t + half) - sum_at(t - half)) / points).collect()
        } else {
            grid.times().map(|t| between(signal, ((t - self.start_s) / self.point_s).clamp(0.0, last))).collect()
        };
        let (centre, scale) = (mean(&values), std_dev(&values) + 1e-12);
        values.iter_mut().for_each(|v| *v = (*v - centre) / scale);
        values
    }
}

/// Interpolated value between the points of `x`.
fn between(x: &[f64], place: f64) -> f64 {
    let below = (place.floor() as usize).min(x.len() - 1);
    let above = (below + 1).min(x.len() - 1);
    x[below] + (place - below as f64) * (x[above] - x[below])
}

/// OP through He's law, one value per point.
fn stem(record: &Record, fs: f64, fd: f64) -> Vec<f64> {
    let mut position = record.op_path.first().copied().unwrap_or(0.0);
    let follow = |path: &[f64]| {
        let sum: f64 = path
            .iter()
            .map(|op| {
                position = he_step(position, *op, fs, fd);
                position
            })
            .sum();
        sum / path.len() as f64
    };
    record.op_path.chunks(record.path_per_point()).map(follow).collect()
}

/// A common time grid.
struct Grid {
    start_s: f64,
    step_s: f64,
    points: usize,
}

impl Grid {
    fn times(&self) -> impl Iterator<Item = f64> {
        let (start_s, step_s) = (self.start_s, self.step_s);
        (0..self.points).map(move |k| start_s + step_s * k as f64)
    }
}

/// Signs that a member is the source, in the order of [`Evidence::NAMES`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Evidence {
    pub figures: [f64; Evidence::NAMES.len()],
}

impl Evidence {
    /// Names of the figures.
    pub(crate) const NAMES: [&str; 17] = [
        "own_logit",
        "likelihood",
        "confirmed",
        "one_step_gain",
        "horch",
        "jumps",
        "periodicity",
        "own_stem",
        "own_stem_beside_another",
        "own_stem_beside_two",
        "own_stem_less_two",
        "explained_by_another",
        "explained_by_two",
        "explains_others",
        "explains_less_explained",
        "stem_explains_others",
        "stem_explains_one",
    ];
}

/// Prediction of loop `a` with the help of loop `b`.
#[derive(Clone, Copy, Default)]
struct Ordered {
    /// Gain from PV of `b`.
    pv: f64,
    /// Gain from the stem of `a`, alone and in addition to PV of `b`.
    own: [f64; 2],
    /// Gain from the stem of `b` in addition to its PV and OP.
    stem: f64,
}

/// Evidence of each member of a group whose period is `period_s`; `None` if the windows overlap too little.
pub(super) fn gather(members: &[(&Signals, &Assessment)], period_s: f64) -> Option<Vec<Evidence>> {
    let signals: Vec<&Signals> = members.iter().map(|m| m.0).collect();
    let from = signals.iter().map(|s| s.start_s).fold(f64::MIN, f64::max);
    let to = signals.iter().map(|s| s.end_s()).fold(f64::MAX, f64::min);
    if to - from < 3.5 * period_s {
        return None;
    }
    let n = members.len();
    let sheets = Sheets::new(&signals, [from, to], period_s);
    let of = |a: usize, b: usize| match a == b {
        true => Ordered::default(),
        false => sheets.of_step(step_s(&signals, &[a, b], period_s)).explain(a, b),
    };
    let table: Vec<Vec<Ordered>> = (0..n).map(|a| (0..n).map(|b| of(a, b)).collect()).collect();
    let one = |a: usize| {
        let others = || (0..n).filter(move |b| *b != a);
        let count = others().count() as f64;
        let best = others().max_by(|b, c| table[a][*b].pv.total_cmp(&table[a][*c].pv)).unwrap_or(a);
        let [by_two, own_beside_two] = beside_two(a, &sheets, &table[a]);
        let stems = others().map(|b| table[b][a].stem);
        let explains = others().map(|b| table[b][a].pv).sum::<f64>() / count;
        let explained = others().map(|b| table[a][b].pv).sum::<f64>() / count;
        let [own, own_beside] = table[a][best].own;
        let [logit, likelihood, confirmed, gain, horch, jumps, periodicity] = alone(members[a].1);
        Evidence {
            figures: [
                logit,
                likelihood,
                confirmed,
                gain,
                horch,
                jumps,
                periodicity,
                own,
                own_beside,
                own_beside_two,
                own_beside_two - by_two,
                table[a][best].pv,
                by_two,
                explains,
                explains - explained,
                stems.clone().sum::<f64>() / count,
                stems.fold(0.0, f64::max),
            ],
        }
    };
    Some((0..n).map(one).collect())
}

/// Evidence from a loop's own window: the logit of its probability and its indicators, 0 for a missing one.
fn alone(assessment: &Assessment) -> [f64; 7] {
    let of = |name: &str| assessment.indicators.iter().find(|i| i.name == name).and_then(|i| i.score).unwrap_or(0.0);
    let p = assessment.p_calibrated.unwrap_or(UNKNOWN).clamp(1e-4, 1.0 - 1e-4);
    [
        libm::log(p / (1.0 - p)),
        of("likelihood").min(LARGEST[0]),
        of("confirmed"),
        of("one_step_gain").min(LARGEST[1]),
        of("horch"),
        of("jumps"),
        of("periodicity"),
    ]
}

/// Longest lags, in points: of another loop, and of the loop's own OP and stem.
fn lags(period_s: f64, step_s: f64) -> [usize; 2] {
    [((0.25 * period_s / step_s) as usize).clamp(3, LONGEST), ((0.16 * period_s / step_s) as usize).clamp(2, 8)]
}

/// Time between the points of the grid for comparing these members, s.
fn step_s(all: &[&Signals], members: &[usize], period_s: f64) -> f64 {
    members.iter().map(|m| all[*m].point_s).fold(period_s / POINTS_A_PERIOD, f64::max)
}

/// The members of a group on every grid needed to compare two or three of them.
struct Sheets<'a> {
    signals: &'a [&'a Signals],
    period_s: f64,
    sheets: Vec<Sheet<'a>>,
}

impl<'a> Sheets<'a> {
    fn new(signals: &'a [&'a Signals], [from, to]: [f64; 2], period_s: f64) -> Self {
        // The slowest of the two or three loops determines the step.
        let mut steps: Vec<f64> = (0..signals.len()).map(|member| step_s(signals, &[member], period_s)).collect();
        steps.sort_by(f64::total_cmp);
        steps.dedup();
        let sheet = |step_s: f64| Sheet {
            signals,
            grid: grid(from, to, step_s),
            lags: lags(period_s, step_s),
            loops: signals.iter().map(|_| OnceCell::new()).collect(),
        };
        Self { signals, period_s, sheets: steps.into_iter().map(sheet).collect() }
    }

    fn of_step(&self, step_s: f64) -> &Sheet<'a> {
        let place = self.sheets.partition_point(|sheet| sheet.grid.step_s < step_s);
        &self.sheets[place.min(self.sheets.len() - 1)]
    }
}

/// The members on one grid; each is resampled when first needed.
struct Sheet<'a> {
    signals: &'a [&'a Signals],
    grid: Grid,
    lags: [usize; 2],
    loops: Vec<OnceCell<OnGrid>>,
}

/// Standardised signals of a loop on a grid.
#[derive(Default)]
struct OnGrid {
    pv: Vec<f64>,
    op: Vec<f64>,
    stem: Option<Vec<f64>>,
    /// Products of the columns as the predicted loop, and as the helping loop.
    products: [OnceCell<DMatrix<f64>>; 2],
}

impl Sheet<'_> {
    fn on(&self, member: usize) -> &OnGrid {
        let signals = self.signals[member];
        self.loops[member].get_or_init(|| OnGrid {
            pv: signals.on(&signals.pv, &self.grid),
            op: signals.on(&signals.op, &self.grid),
            stem: signals.stem.as_deref().map(|stem| signals.on(stem, &self.grid)),
            products: Default::default(),
        })
    }

    /// Predicts PV of loop `a` with and without the signals of loop `b`.
    fn explain(&self, a: usize, b: usize) -> Ordered {
        if self.grid.points < LEAST_POINTS[0] {
            return Ordered::default();
        }
        let [other, own] = self.lags;
        let ones = vec![1.0; self.grid.points];
        let mut of_a = Columns::new(self.grid.points, 0);
        let base = of_a.base(self.on(a), &ones, own);
        let stem = of_a.add_lags(self.on(a).stem.as_deref(), 0..=own);
        let mut of_b = Columns::new(self.grid.points, 0);
        of_b.before = of_a.columns.len();
        let pv = of_b.add_lags(Some(&self.on(b).pv), 1..=other);
        let op = of_b.add_lags(Some(&self.on(b).op), 1..=other);
        let far_stem = of_b.add_lags(self.on(b).stem.as_deref(), 1..=other);
        // A loop's own products are the same with every other loop.
        let products_a = self.on(a).products[0].get_or_init(|| of_a.own_products());
        let products_b = self.on(b).products[1].get_or_init(|| of_b.own_products());
        let fits = Fits::of_two([products_a, products_b], &of_a.products_with(&of_b), of_a.rows());
        Ordered {
            pv: fits.gain(&[&base], &pv),
            own: [fits.gain(&[&base], &stem), fits.gain(&[&base, &pv], &stem)],
            stem: fits.gain(&[&base, &pv, &op], &far_stem),
        }
    }
}

/// How well the two other loops with the largest gains predict loop `a` (with lags and leads), and the additional gain from its
/// own stem.
fn beside_two(a: usize, sheets: &Sheets, of_a: &[Ordered]) -> [f64; 2] {
    let (all, period_s) = (sheets.signals, sheets.period_s);
    let own_step = step_s(all, &[a], period_s);
    let mut others: Vec<usize> = (0..all.len()).filter(|b| *b != a).collect();
    // Loops with much slower sampling come last: they would make the grid coarse.
    let slow = |b: usize| all[b].point_s > 1.5 * own_step;
    others.sort_by(|b, c| slow(*b).cmp(&slow(*c)).then(of_a[*c].pv.total_cmp(&of_a[*b].pv)));
    others.truncate(2);
    let sheet = sheets.of_step(others.iter().map(|b| all[*b].point_s).fold(own_step, f64::max));
    if sheet.grid.points < LEAST_POINTS[1] {
        return [0.0; 2];
    }
    let [far, own] = sheet.lags;
    let far = far.max(4);
    let ones = vec![1.0; sheet.grid.points];
    let mut columns = Columns::new(sheet.grid.points, LONGEST);
    let base = columns.base(sheet.on(a), &ones, own);
    let mut around = Vec::new();
    for b in others {
        around.extend(columns.add_shifts(&sheet.on(b).pv, (-(far as isize)..=far as isize).step_by(2)));
    }
    let stem = columns.add_lags(sheet.on(a).stem.as_deref(), 0..=own);
    let fits = Fits { products: columns.own_products(), rows: columns.rows() as f64 };
    [fits.gain(&[&base], &around), fits.gain(&[&base, &around], &stem)]
}

fn grid(from: f64, to: f64, step_s: f64) -> Grid {
    let points = ((to - from - 2.0 * step_s) / step_s).ceil().max(0.0) as usize;
    Grid { start_s: from + step_s, step_s, points }
}

/// Columns of a linear prediction; the first column is the predicted one. Each is a section of a signal.
struct Columns<'a> {
    points: usize,
    /// Points at the end that only leads use.
    leads: usize,
    /// Number of columns before these.
    before: usize,
    columns: Vec<&'a [f64]>,
}

impl<'a> Columns<'a> {
    const fn new(points: usize, leads: usize) -> Self {
        Self { points, leads, before: 0, columns: Vec::new() }
    }

    fn rows(&self) -> usize {
        self.points - FIRST - self.leads
    }

    /// Adds PV and the loop's own past: the constant, PV at lags 1 to 3, OP at lags 0 to `own`. Returns the columns of the
    /// past.
    fn base(&mut self, signals: &'a OnGrid, ones: &'a [f64], own: usize) -> Vec<usize> {
        self.add_shifts(&signals.pv, 0..=0);
        let mut base = self.add_shifts(ones, 0..=0);
        base.extend(self.add_shifts(&signals.pv, 1..=3));
        base.extend(self.add_lags(Some(&signals.op), 0..=own));
        base
    }

    fn add_lags(&mut self, signal: Option<&'a [f64]>, lags: core::ops::RangeInclusive<usize>) -> Vec<usize> {
        let shifts = *lags.start() as isize..=*lags.end() as isize;
        signal.map_or_else(Vec::new, |signal| self.add_shifts(signal, shifts))
    }

    fn add_shifts(&mut self, signal: &'a [f64], lags: impl Iterator<Item = isize>) -> Vec<usize> {
        let first = self.before + self.columns.len();
        for lag in lags {
            let from = (FIRST as isize - lag) as usize;
            self.columns.push(&signal[from..from + self.rows()]);
        }
        (first..self.before + self.columns.len()).collect()
    }

    /// Inner products of the columns among themselves.
    fn own_products(&self) -> DMatrix<f64> {
        let n = self.columns.len();
        let mut products = DMatrix::zeros(n, n);
        for i in 0..n {
            for j in 0..=i {
                let product = inner(self.columns[i], self.columns[j]);
                (products[(i, j)], products[(j, i)]) = (product, product);
            }
        }
        products
    }

    /// Inner products of these columns (rows of the matrix) with those of another loop.
    fn products_with(&self, other: &Columns) -> DMatrix<f64> {
        DMatrix::from_fn(self.columns.len(), other.columns.len(), |i, j| inner(self.columns[i], other.columns[j]))
    }
}

fn inner(a: &[f64], b: &[f64]) -> f64 {
    DVectorView::from_slice(a, a.len()).dot(&DVectorView::from_slice(b, b.len()))
}

/// Least squares on any subset of the columns, from their products.
struct Fits {
    products: DMatrix<f64>,
    rows: f64,
}

impl Fits {
    /// From the products of each of two loops' own columns, and those of the first loop's with the second's.
    fn of_two(own: [&DMatrix<f64>; 2], between: &DMatrix<f64>, rows: usize) -> Self {
        let n = own[0].nrows();
        let all = n + own[1].nrows();
        let product = |i: usize, j: usize| match (i < n, j < n) {
            (true, true) => own[0][(i, j)],
            (true, false) => between[(i, j - n)],
            (false, true) => between[(j, i - n)],
            (false, false) => own[1][(i - n, j - n)],
        };
        Self { products: DMatrix::from_fn(all, all, product), rows: rows as f64 }
    }

    /// Residual variance with these columns.
    fn left(&self, columns: &[usize]) -> f64 {
        let k = columns.len();
        let ridge = RIDGE * self.rows;
        let square =
            DMatrix::from_fn(k, k, |i, j| self.products[(columns[i], columns[j])] + if i == j { ridge } else { 0.0 });
        let right = DVector::from_fn(k, |i, _| self.products[(columns[i], 0)]);
        let explained = square.cholesky().map_or(0.0, |factor| factor.solve(&right).dot(&right));
        (self.products[(0, 0)] - explained).max(1e-12 * self.products[(0, 0)]) / self.rows
    }

    /// Gain of the `added` columns in addition to `before`, minus the gain expected from as many columns of noise; at least 0.
    fn gain(&self, before: &[&Vec<usize>], added: &[usize]) -> f64 {
        if added.is_empty() {
            return 0.0;
        }
        let without: Vec<usize> = before.iter().flat_map(|columns| columns.iter().copied()).collect();
        let with: Vec<usize> = without.iter().chain(added).copied().collect();
        let penalty = added.len() as f64 * libm::log(self.rows) / self.rows;
        (libm::log(self.left(&without) / self.left(&with)) - penalty).max(0.0)
    }
}
