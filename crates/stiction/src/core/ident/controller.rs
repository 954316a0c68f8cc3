//! Identifies the controller from the record: gain, integral and derivative time from how OP responds to PV.
//!
//! A PID controller in velocity form moves OP between samples k - m and k by
//! `Kc [e(k) - e(k - m)] + Kc Ts/Ti sum e + Kc Td/Ts [d(k) - d(k - m)]`, where e is the error and d the (filtered) move of -PV
//! (Åström and Hägglund 1995, ch. 3). This is linear in its gains, needs no process model and holds whatever the valve does, so
//! robust least squares finds the gains. PV may be stamped before or after the OP that was computed from it: every lag is
//! tried, and the controller counts as identified only if one lag leads clearly.

use core::cell::RefCell;

use super::robust::{Regression, Regressor};
use crate::core::record::Record;
use crate::core::signal::stats;

/// A controller identified from a record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Proportional gain, OP units per PV unit of the error SP - PV: positive if OP falls when PV rises (reverse action, for
    /// processes of positive gain), negative if OP rises with PV.
    pub kc: f64,
    /// Integral time, s; infinite if no integral action is visible.
    pub ti_s: f64,
    /// Derivative time, s; 0 if no derivative action is visible.
    pub td_s: f64,
    /// Raw samples by which the recorded OP follows the PV from which it was computed; negative if PV is stamped later.
    pub lag_samples: f64,
    /// Share of the variance of OP's moves explained.
    pub r2: f64,
    /// Share of the record, 0..1, in long stretches where this controller does not explain OP: another mode, or another
    /// controller. Stretches with OP at a limit are excluded beforehand.
    pub unexplained: f64,
}

/// Lags tried, points; the outer two only bound the others, because the true lag may lie beyond them.
const LAGS: [isize; 2] = [-3, 4];
/// Widths of the moves, points: wide moves exceed OP's rounding, narrow ones show the lag best.
const WIDTHS: [usize; 3] = [1, 4, 16];
/// Share of OP's moves explained from which a reading proves which signals belong together: of 114 real processes one reads
/// like a controller, with 0.95.
pub const CERTAIN_R2: f64 = 0.98;
/// Smallest share of OP's moves that a reading must explain.
const MIN_R2: f64 = 0.9;
/// The runner-up lag must leave at least this many times the variance unexplained.
const LEAD: f64 = 1.5;
/// Largest share of the unexplained variance that an additional term may leave.
const EARNS: f64 = 0.7;
/// The same at the best plain lag; a term that leaves more there is not tried at other lags.
const HELPS: f64 = 0.97;
/// Share unexplained that counts as zero.
const EXACT: f64 = 1e-9;
/// Number of forms refined, and steps of golden section towards the best filter.
const BEST_SHAPES: usize = 3;
const REFINEMENTS: usize = 10;
/// Time constants of the filters tried on the derivative and on PV, points.
const FILTERS: [f64; 6] = [0.0, 0.3, 0.7, 1.5, 3.0, 6.0];
/// Fewest points.
const MIN_POINTS: usize = 60;
/// Points per stretch; residual power relative to the usual power, and relative to that of the moves, from which a stretch
/// counts as unexplained; and the largest share of unexplained stretches.
const STRETCH: usize = 25;
const UNUSUAL: f64 = 20.0;
const POOR: f64 = 0.5;
const MOST_UNEXPLAINED: f64 = 0.5;

/// Identifies the controller; `None` if no lag leads, too little is explained, or the proportional and integral parts have
/// different signs.
#[must_use]
pub fn read(record: &Record) -> Option<Reading> {
    read_within(record, LAGS)
}

/// As [`read`], for other lags, points; the outer two only bound the others.
#[must_use]
pub(crate) fn read_within(record: &Record, lags: [isize; 2]) -> Option<Reading> {
    let signals = Signals { lags, ..Signals::of(record)? };
    let mut plain: Vec<(Shape, Vec<Fit>)> = Vec::new();
    for form in signals.forms() {
        for width in WIDTHS {
            let shape = Shape { form, width, extra: Extra::None };
            let fits = signals.all_lags(&signals.columns(shape));
            // Nothing can explain more than everything.
            let exact = (least(&fits) < EXACT).then(|| signals.report(shape, &fits)).flatten();
            if let Some((_, reading)) = exact.filter(|(lead, r)| *lead >= LEAD && r.unexplained == 0.0) {
                return Some(reading);
            }
            plain.push((shape, fits));
        }
    }
    // The best few forms get a derivative or a filter if it earns its place.
    plain.sort_by(|a, b| least(&a.1).total_cmp(&least(&b.1)));
    let mut best: Option<Reading> = None;
    for (shape, fits) in plain.into_iter().take(BEST_SHAPES) {
        let Some((lead, reading)) = signals.read(shape, fits) else { continue };
        if lead >= LEAD && best.is_none_or(|b| reading.r2 > b.r2) {
            best = Some(reading);
        }
    }
    best.filter(|r| r.r2 >= MIN_R2 && r.unexplained <= MOST_UNEXPLAINED)
}

/// Signals in the control error.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Form {
    /// The set point is constant or unknown: a constant absorbs it.
    Pv,
    /// The set point is in both parts.
    Error,
    /// The set point is in the integral part only.
    ErrorIntegral,
    /// As [`Form::Pv`], but differenced once more: unrecorded steps of the set point then leave single outliers.
    Unseen,
}

/// Dynamics between PV and a plain PI controller.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Extra {
    None,
    /// A derivative with a filter of this time constant, points.
    Derivative(f64),
    /// A filter of this time constant on PV, points.
    Filter(f64),
}

/// One regression model.
#[derive(Debug, Clone, Copy)]
struct Shape {
    form: Form,
    width: usize,
    extra: Extra,
}

/// A fit at one lag.
#[derive(Debug, Clone, Copy)]
struct Fit {
    lag: isize,
    regression: Regression,
    unexplained: f64,
}

/// A record's signals on the points of the fit.
struct Signals {
    /// Lags tried, points.
    lags: [isize; 2],
    op: Vec<f64>,
    pv: Vec<f64>,
    sp: Option<Vec<f64>>,
    /// Samples at OP's highest or lowest value, if OP rests there.
    limited: Vec<bool>,
    boxed: bool,
    box_samples: f64,
    point_s: f64,
    work: RefCell<Work>,
}

/// Buffers reused for every fit.
#[derive(Debug, Default)]
struct Work {
    regressor: Regressor,
    used: Vec<bool>,
}

/// Columns of one regression model, by the point at which a move ends: slices of them serve every lag.
struct Columns {
    shape: Shape,
    op: Vec<f64>,
    /// Moves of the proportional, integral and derivative parts; the last is empty without a derivative.
    parts: [Vec<f64>; 3],
    /// Moves during which OP is never at a limit; empty if this holds for all.
    free: Vec<bool>,
}

impl Signals {
    fn of(record: &Record) -> Option<Self> {
        let m = record.path_per_point();
        let op: Vec<f64> = record.op_path.chunks_exact(m).map(|p| p[m - 1]).collect();
        let n = op.len().min(record.len());
        let moves = |x: &[f64]| x.windows(2).any(|w| w[0] != w[1]);
        let finite = |x: &[f64]| x.iter().all(|v| v.is_finite());
        if n < MIN_POINTS || !finite(&op) || !finite(&record.pv) || !moves(&op) || !moves(&record.pv) {
            return None;
        }
        let sp = record.sp.clone().filter(|sp| sp.len() >= n && finite(sp) && moves(sp));
        let [op, pv] = [op[..n].to_vec(), record.pv[..n].to_vec()];
        let boxed = record.box_samples > 1;
        let limited = limited(&op);
        Some(Self {
            lags: LAGS,
            op,
            pv,
            sp,
            limited,
            boxed,
            box_samples: record.box_samples as f64,
            point_s: record.point_s(),
            work: RefCell::default(),
        })
    }

    fn forms(&self) -> Vec<Form> {
        match self.sp {
            Some(_) => vec![Form::Error, Form::ErrorIntegral, Form::Pv],
            None => vec![Form::Pv, Form::Unseen],
        }
    }

    /// The reading in one form and width, with a derivative or filter if one earns its place, and the ratio of the variance
    /// that the runner-up lag leaves unexplained to that of the best lag.
    fn read(&self, plain: Shape, fits: Vec<Fit>) -> Option<(f64, Reading)> {
        let (mut shape, mut error, mut fits) = (plain, least(&fits), fits);
        let lag = fits.iter().max_by(|a, b| a.regression.r2.total_cmp(&b.regression.r2))?.lag;
        let makes: [fn(f64) -> Extra; 2] = [Extra::Derivative, Extra::Filter];
        for make in makes {
            if error < EXACT {
                break;
            }
            // The additional term may shift the best lag.
            let near = (lag - 2).max(self.lags[0])..=(lag + 2).min(self.lags[1]);
            let with = |filter: f64| self.columns(Shape { extra: make(filter), ..plain });
            let tried = FILTERS.map(|filter| (filter, with(filter)));
            // A term that does not help at this lag is not tried at the neighbouring lags.
            if tried.iter().all(|(_, columns)| self.error(columns, lag) > HELPS * error) {
                continue;
            }
            let at = |(filter, columns): &(f64, Columns), lag: isize| (self.error(columns, lag), lag, *filter);
            let all = tried.iter().flat_map(|one| near.clone().map(move |lag| at(one, lag)));
            let Some((found, lag, filter)) = all.min_by(|a, b| a.0.total_cmp(&b.0)) else { continue };
            if found >= EARNS * error {
                continue;
            }
            let next = with(finest(filter, |filter| self.error(&with(filter), lag)));
            let others = self.all_lags(&next);
            if self.report(next.shape, &others).is_some() {
                (shape, error, fits) = (next.shape, least(&others), others);
            }
        }
        self.report(shape, &fits)
    }

    fn all_lags(&self, columns: &Columns) -> Vec<Fit> {
        (self.lags[0]..=self.lags[1]).filter_map(|lag| self.fit(columns, lag)).collect()
    }

    /// Share of OP's moves that a fit leaves unexplained; infinite without a fit.
    fn error(&self, columns: &Columns, lag: isize) -> f64 {
        self.fit(columns, lag).map_or(f64::INFINITY, |fit| 1.0 - fit.regression.r2)
    }

    fn report(&self, shape: Shape, fits: &[Fit]) -> Option<(f64, Reading)> {
        let best = fits.iter().max_by(|a, b| a.regression.r2.total_cmp(&b.regression.r2))?;
        let others = fits.iter().filter(|f| f.lag != best.lag);
        let second = others.map(|f| 1.0 - f.regression.r2).fold(f64::INFINITY, f64::min);
        let error = 1.0 - best.regression.r2;
        let lead = if error > 0.0 { second / error } else { f64::INFINITY };
        if best.lag == self.lags[0] || best.lag == self.lags[1] {
            return None;
        }
        let [kc, ki, kd, ..] = best.regression.coefficients;
        let derivative = matches!(shape.extra, Extra::Derivative(_));
        let td = if derivative { kd / kc } else { 0.0 };
        // Integral action too slow to act within a hundred records counts as absent.
        let idle = ki.abs() * self.op.len() as f64 * 100.0 < kc.abs();
        let ti = if idle { f64::INFINITY } else { kc / ki };
        // A derivative time beyond the integral time does not come from a controller.
        if kc == 0.0 || ti.is_nan() || ti <= 0.0 || td < 0.0 || td > ti {
            return None;
        }
        let reading = Reading {
            kc,
            ti_s: ti * self.point_s,
            td_s: td * self.point_s,
            lag_samples: best.lag as f64 * self.box_samples,
            r2: best.regression.r2,
            unexplained: best.unexplained,
        };
        Some((lead, reading))
    }

    /// Regresses OP's moves at one lag, and again without the stretches that the first fit leaves unexplained.
    fn fit(&self, columns: &Columns, lag: isize) -> Option<Fit> {
        let [from, to] = self.range(columns.shape, lag);
        let y = columns.op.get(from..to)?;
        let moved = |at: usize| (at as isize - lag) as usize;
        let [p, i, d] = [0, 1, 2].map(|part| columns.parts[part].get(moved(from)..moved(to)).unwrap_or(&[]));
        let parts: &[&[f64]] = if d.is_empty() { &[p, i] } else { &[p, i, d] };
        let free = (!columns.free.is_empty()).then(|| &columns.free[from..to]);
        let count = free.map_or(y.len(), |free| free.iter().filter(|f| **f).count());
        if count < MIN_POINTS / 2 {
            return None;
        }
        let work = &mut *self.work.borrow_mut();
        let mut regression = work.regressor.regress(y, parts, free)?;
        let mut unexplained = 0.0;
        for _ in 0..2 {
            let lost = explained(y, work.regressor.left(), free, &mut work.used);
            unexplained = lost as f64 / y.len().max(1) as f64;
            if lost == 0 || unexplained > MOST_UNEXPLAINED {
                break;
            }
            regression = work.regressor.regress(y, parts, Some(&work.used))?;
        }
        Some(Fit { lag, regression, unexplained })
    }

    /// First and last point whose moves can be regressed.
    fn range(&self, shape: Shape, lag: isize) -> [usize; 2] {
        let twice = usize::from(shape.form == Form::Unseen);
        let from = (shape.width as isize + 1 + lag.max(0)) as usize;
        let to = ((self.op.len() as isize + lag.min(0)) as usize).max(from);
        [(from + twice).min(to), to]
    }

    /// OP's moves, and those of the proportional, integral and derivative parts, for one form.
    fn columns(&self, shape: Shape) -> Columns {
        let n = self.op.len();
        let pv = lagged(&self.pv, if let Extra::Filter(tau) = shape.extra { tau } else { 0.0 });
        let sp = self.sp.as_deref();
        let with_sp = |k: usize| sp.map_or(0.0, |sp| sp[k]);
        let middle = stats::mean(&pv) - sp.map_or(0.0, stats::mean);
        // Bins: PV's mean belongs to the middle of a bin, OP's last value to its end.
        let end = |x: &[f64], k: usize| if self.boxed { 0.5 * (x[k] + x[(k + 1).min(n - 1)]) } else { x[k] };
        let proportional: Vec<f64> = match (shape.form, sp) {
            (Form::Error, Some(sp)) => (0..n).map(|k| end(sp, k) - end(&pv, k)).collect(),
            _ => (0..n).map(|k| -end(&pv, k)).collect(),
        };
        let sum = (0..n).scan(0.0, |sum, k| {
            *sum += match shape.form {
                Form::Error | Form::ErrorIntegral => with_sp(k) - pv[k] + middle,
                Form::Pv | Form::Unseen => middle - pv[k],
            };
            Some(*sum)
        });
        let sum: Vec<f64> = sum.collect();
        let derivative = match shape.extra {
            Extra::Derivative(filter) => {
                let slope: Vec<f64> = (0..n).map(|k| if k == 0 { 0.0 } else { pv[k - 1] - pv[k] }).collect();
                lagged(&slope, filter)
            }
            _ => Vec::new(),
        };
        let twice = shape.form == Form::Unseen;
        let of = |x: &[f64]| moves(x, shape.width, twice);
        let limited = self.limited.iter().any(|l| *l);
        let free = if limited { self.free(shape.width, twice) } else { Vec::new() };
        Columns { shape, op: of(&self.op), parts: [of(&proportional), of(&sum), of(&derivative)], free }
    }

    /// Moves over `width` points during which OP is never at a limit; with `twice`, the previous move must be free, too.
    fn free(&self, width: usize, twice: bool) -> Vec<bool> {
        let once = |k: usize| k >= width && (k - width..=k).all(|i| !self.limited[i]);
        (0..self.op.len()).map(|k| once(k) && (!twice || (k > 0 && once(k - 1)))).collect()
    }
}

/// Moves over `width` points by the point at which they end, 0 if they would begin before the first point; with `twice`, minus
/// the move that ends one point earlier.
fn moves(x: &[f64], width: usize, twice: bool) -> Vec<f64> {
    let mut out = vec![0.0; width.min(x.len())];
    out.extend(x.iter().skip(width).zip(x).map(|(now, before)| now - before));
    if twice {
        for k in (1..out.len()).rev() {
            out[k] -= out[k - 1];
        }
    }
    out
}

/// Smallest unexplained share.
fn least(fits: &[Fit]) -> f64 {
    fits.iter().map(|f| 1.0 - f.regression.r2).fold(f64::INFINITY, f64::min)
}

/// The filter of least cost between the neighbours of `start` in [`FILTERS`], by golden section.
fn finest(start: f64, cost: impl Fn(f64) -> f64) -> f64 {
    let low = FILTERS.into_iter().filter(|f| *f < start).fold(0.0, f64::max);
    let high = FILTERS.into_iter().filter(|f| *f > start).fold(2.0 * start + 0.1, f64::min);
    let share = 0.5 * (5.0_f64.sqrt() - 1.0);
    let (mut a, mut b) = (low, high);
    let (mut c, mut d) = (b - share * (b - a), a + share * (b - a));
    let (mut at_c, mut at_d) = (cost(c), cost(d));
    for _ in 0..REFINEMENTS {
        if at_c < at_d {
            (b, d, at_d) = (d, c, at_c);
            c = b - share * (b - a);
            at_c = cost(c);
        } else {
            (a, c, at_c) = (c, d, at_d);
            d = a + share * (b - a);
            at_d = cost(d);
        }
    }
    let middle = if at_c < at_d { c } else { d };
    if cost(start) <= at_c.min(at_d) { start } else { middle }
}

/// `x` filtered by a first-order lag of `tau` points (backward difference), starting at rest.
fn lagged(x: &[f64], tau: f64) -> Vec<f64> {
    if tau <= 0.0 {
        return x.to_vec();
    }
    let share = 1.0 / (tau + 1.0);
    let mut state = x.first().copied().unwrap_or(0.0);
    x.iter()
        .map(|v| {
            state += share * (v - state);
            state
        })
        .collect()
}

/// Values at the overall maximum or minimum, if one of these is held for three samples in a row.
fn limited(op: &[f64]) -> Vec<bool> {
    let high = op.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let low = op.iter().copied().fold(f64::INFINITY, f64::min);
    let held = |end: f64| op.windows(3).any(|w| w.iter().all(|u| *u == end));
    let (at_high, at_low) = (held(high), held(low));
    op.iter().map(|u| (at_high && *u == high) || (at_low && *u == low)).collect()
}

/// Marks the free samples in stretches that a fit explains as well as usual, or nearly as well as the moves there allow;
/// returns the number of samples in other stretches. Samples that are not free do not count.
fn explained(y: &[f64], left: &[f64], free: Option<&[bool]>, used: &mut Vec<bool>) -> usize {
    let of = |from: usize| {
        let (mut count, mut powers) = (0, [0.0; 3]);
        for k in (from..(from + STRETCH).min(y.len())).filter(|k| free.is_none_or(|free| free[*k])) {
            let fitted = y[k] - left[k];
            count += 1;
            for (power, x) in powers.iter_mut().zip([left[k], y[k], fitted]) {
                *power += x * x;
            }
        }
        let [r, y, fitted] = powers.map(|power| power / f64::from(count));
        (count > 0).then(|| (r, y.max(fitted)))
    };
    let stretches: Vec<Option<(f64, f64)>> = (0..y.len()).step_by(STRETCH).map(of).collect();
    let usual = stats::median(&stretches.iter().flatten().map(|s| s.0).collect::<Vec<_>>());
    let fine = |s: &Option<(f64, f64)>| s.is_none_or(|(r, y)| r <= UNUSUAL * usual || r <= POOR * y);
    used.clear();
    let mut lost = 0;
    for (index, stretch) in stretches.iter().enumerate() {
        let count = STRETCH.min(y.len() - index * STRETCH);
        let is_fine = fine(stretch);
        lost += if is_fine { 0 } else { count };
        used.resize(used.len() + count, is_fine);
    }
    if let Some(free) = free {
        used.iter_mut().zip(free).for_each(|(used, free)| *used &= free);
    }
    lost
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(n: usize) -> Vec<f64> {
        (0..n)
            .map(|k| {
                let t = k as f64;
                50.0 + libm::sin(t * 0.13) + 0.3 * libm::sin(t * 0.9) + 0.2 * libm::sin(t * t * 0.01)
            })
            .collect()
    }

    /// OP of a PI controller acting on PV.
    fn pi(pv: &[f64], sp: f64, kc: f64, ti: f64) -> Vec<f64> {
        let mut integral = 0.0;
        pv.iter()
            .map(|p| {
                integral += kc / ti * (sp - p);
                30.0 + kc * (sp - p) + integral
            })
            .collect()
    }

    #[test]
    fn a_pi_controller_is_read_in_its_units_and_sign() {
        let pv = wave(600);
        for kc in [0.7, -2.0] {
            let found = read(&Record::uniform(5.0, pi(&pv, 50.0, kc, 20.0), pv.clone())).unwrap();
            assert!((found.kc / kc - 1.0).abs() < 1e-6 && (found.ti_s / 100.0 - 1.0).abs() < 1e-6, "{found:?}");
            assert_eq!((found.td_s, found.lag_samples, found.unexplained), (0.0, 0.0, 0.0));
        }
    }

    #[test]
    fn stamps_before_and_after_are_told() {
        let pv = wave(700);
        let op = pi(&pv, 50.0, 1.0, 30.0);
        for skew in [-1_isize, 0, 2] {
            // OP is recorded `skew` samples after its PV.
            let later: Vec<f64> = (5..690).map(|k: usize| op[(k as isize - skew) as usize]).collect();
            let found = read(&Record::uniform(1.0, later, pv[5..690].to_vec())).unwrap();
            assert_eq!(found.lag_samples, skew as f64);
        }
    }

    #[test]
    fn a_set_point_that_moves_and_one_that_is_not_recorded() {
        let pv = wave(800);
        let sp: Vec<f64> = (0..800).map(|k| 50.0 + f64::from(k / 160 % 2)).collect();
        let mut integral = 0.0;
        let op: Vec<f64> = pv
            .iter()
            .zip(&sp)
            .map(|(p, s)| {
                integral += 0.1 * (s - p);
                30.0 + 2.0 * (s - p) + integral
            })
            .collect();
        let mut record = Record::uniform(1.0, op, pv);
        let unseen = read(&record).unwrap();
        record.sp = Some(sp);
        let seen = read(&record).unwrap();
        for found in [unseen, seen] {
            assert!((found.kc / 2.0 - 1.0).abs() < 0.02 && (found.ti_s / 20.0 - 1.0).abs() < 0.05, "{found:?}");
        }
    }

    #[test]
    fn a_stretch_in_manual_is_found_and_left_out() {
        let pv = wave(1000);
        let mut op = pi(&pv, 50.0, 0.7, 20.0);
        for k in 400..600 {
            op[k] = op[399];
        }
        let found = read(&Record::uniform(1.0, op, pv)).unwrap();
        assert!((found.kc / 0.7 - 1.0).abs() < 0.01 && (found.ti_s / 20.0 - 1.0).abs() < 0.01, "{found:?}");
        assert!((found.unexplained - 0.2).abs() < 0.05, "{found:?}");
    }

    #[test]
    fn what_does_not_follow_is_not_read() {
        let pv = wave(600);
        let other: Vec<f64> = (0_u64..600).map(|k| ((k * k * 7919) % 1013) as f64).collect();
        assert_eq!(read(&Record::uniform(1.0, other, pv.clone())), None);
        assert_eq!(read(&Record::uniform(1.0, vec![1.0; 600], pv)), None);
        assert_eq!(read(&Record::uniform(1.0, vec![], vec![])), None);
    }
}
