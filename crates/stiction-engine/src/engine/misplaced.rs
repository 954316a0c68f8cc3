//! Detects signals under the name of another loop or of the wrong sign, by comparing the windows of a plant.
//!
//! The evidence is the controller, which computes OP from its own PV alone. If a loop's controller can be identified
//! ([`controller::read`]), its signals are its own and it is left alone.

use std::cell::OnceCell;
use std::sync::Arc;

use stiction::core::ident::controller::{self, Reading};
use stiction::core::record::Record;
use stiction::core::signal::detrend::{remove_line, remove_mean};
use stiction::core::signal::{lag, stats};
use stiction::core::units::ns_from_s;
use stiction::core::verdict::swapped::POINTS;

/// Fewest common points of two loops.
const LEAST_POINTS: usize = 120;
/// Largest difference between two records of the same signal, for values and for moves, each relative to its spread. Two
/// transmitters on one pipe share the slow part but not the noise.
const SAME_VALUES: f64 = 0.02;
const SAME_MOVES: f64 = 0.3;
/// A controller is looked for if PV and its integral explain this fraction of OP's variance, in at most this many other loops.
const LIKELY_R2: f64 = 0.8;
const MOST_READ: usize = 3;
/// Most pairs compared, which takes some seconds. In a large plant a loop is compared only with neighbours by name, where a
/// mix-up is likeliest, with at least [`LEAST_REACH`] on either side.
const MOST_PAIRS: usize = 200_000;
const LEAST_REACH: usize = 8;
/// Longest integral time relative to the record's length: a PV that merely follows OP shows no integral action.
const LONGEST_INTEGRAL: f64 = 0.3;
/// Correlation of OP and valve position below which their signs are opposite: the lag of a sticking stem has less effect.
const OPPOSITE: f64 = -0.9;

/// A fault of a loop's signals.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Misplaced {
    /// PV is that of the named loop, whose controller it fits.
    SamePv(Arc<str>),
    /// OP is that of the named loop, whose controller it fits.
    SameOp(Arc<str>),
    /// The controller responds to the PV of the named loop, to which that loop's own controller does not respond.
    AnswersPv(Arc<str>),
    /// The valve position falls while OP rises.
    OppositePosition,
}

/// A window, with figures that are computed when needed.
struct Seen<'a> {
    name: &'a Arc<str>,
    record: &'a Record,
    op: Vec<f64>,
    own: OnceCell<bool>,
    manual: bool,
}

impl<'a> Seen<'a> {
    fn new(name: &'a Arc<str>, record: &'a Record) -> Self {
        let manual = 2 * record.facts.manual as usize > record.raw_samples;
        Self { name, record, op: record.op(), own: OnceCell::new(), manual }
    }

    /// Whether the loop's controller computes its OP from its PV.
    fn is_closed(&self) -> bool {
        *self.own.get_or_init(|| controller::read(&self.record.part(0, POINTS)).is_some())
    }

    /// Index of the first common point in each, and the number of common points; `None` if clocks or sampling differ.
    fn common(&self, other: &Self) -> Option<(usize, usize, usize)> {
        let step_s = self.record.point_s();
        if (step_s - other.record.point_s()).abs() > 1e-6 * step_s {
            return None;
        }
        let step_ns = ns_from_s(step_s).max(1);
        let ahead = (other.record.start_ns - self.record.start_ns + step_ns / 2).div_euclid(step_ns);
        let (own, others) = (ahead.max(0) as usize, (-ahead).max(0) as usize);
        let points = self.op.len().saturating_sub(own).min(other.op.len().saturating_sub(others));
        let enough = points >= LEAST_POINTS && 2 * points > self.op.len();
        enough.then_some((own, others, points.min(POINTS)))
    }

    fn opposite_position(&self) -> bool {
        let Some(mv) = self.record.mv.as_deref() else { return false };
        mv.len() == self.op.len() && lag::correlation(&self.op, mv) < OPPOSITE
    }
}

/// The faults of these loops' signals, sorted by name; at most one for each loop.
#[must_use]
pub fn misplaced<'a>(loops: impl IntoIterator<Item = (&'a Arc<str>, &'a Record)>) -> Vec<(Arc<str>, Misplaced)> {
    let seen: Vec<Seen<'_>> = loops.into_iter().map(|(name, record)| Seen::new(name, record)).collect();
    let reach = (MOST_PAIRS / (2 * seen.len().max(1))).max(LEAST_REACH);
    let near = |at: usize| &seen[at.saturating_sub(reach)..(at + reach + 1).min(seen.len())];
    let found = seen.iter().enumerate().map(|(at, one)| Some((one.name.clone(), of_one(one, near(at))?)));
    found.flatten().collect()
}

fn of_one(one: &Seen<'_>, all: &[Seen<'_>]) -> Option<Misplaced> {
    if one.opposite_position() {
        return Some(Misplaced::OppositePosition);
    }
    // In manual mode no controller shows which signals belong together.
    if one.manual || stats::std_dev(&one.op) <= 0.0 || one.is_closed() {
        return None;
    }
    let mut likely: Vec<(f64, &Seen<'_>, [usize; 3])> = Vec::new();
    for other in all.iter().filter(|other| !std::ptr::eq(*other, one)) {
        let Some((own, others, points)) = one.common(other) else { continue };
        let cut = |x: &'_ [f64], from: usize| x[from..from + points].to_vec();
        if is_same(&cut(&one.record.pv, own), &cut(&other.record.pv, others)) && other.is_closed() {
            return Some(Misplaced::SamePv(other.name.clone()));
        }
        if is_same(&cut(&one.op, own), &cut(&other.op, others)) && other.is_closed() {
            return Some(Misplaced::SameOp(other.name.clone()));
        }
        let r2 = explained(&one.op[own..own + points], &other.record.pv[others..others + points]);
        if r2 > LIKELY_R2 {
            likely.push((r2, other, [own, others, points]));
        }
    }
    likely.sort_by(|a, b| b.0.total_cmp(&a.0));
    let answers = |(_, other, [own, others, points]): &(f64, &Seen<'_>, [usize; 3])| {
        let op = one.op[*own..own + points].to_vec();
        let pv = other.record.pv[*others..others + points].to_vec();
        let together = Record::uniform(one.record.point_s(), op, pv);
        let length_s = *points as f64 * one.record.point_s();
        controller::read(&together).is_some_and(|reading| is_plain(&reading, length_s)) && !other.is_closed()
    };
    let found = likely.iter().take(MOST_READ).find(|pair| answers(pair))?;
    Some(Misplaced::AnswersPv(found.1.name.clone()))
}

/// Whether a reading is certainly that of a controller, and not of a signal that follows OP.
fn is_plain(reading: &Reading, length_s: f64) -> bool {
    reading.r2 >= controller::CERTAIN_R2 && reading.lag_samples >= 0.0 && reading.ti_s < LONGEST_INTEGRAL * length_s
}

/// Whether two series record the same signal.
fn is_same(a: &[f64], b: &[f64]) -> bool {
    let rms = |x: &[f64]| (stats::dot(x, x) / x.len().max(1) as f64).sqrt();
    let between = |a: &[f64], b: &[f64]| rms(&a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<f64>>());
    let (spread, moved) = (stats::std_dev(b), moves(b));
    spread > 0.0 && between(a, b) <= SAME_VALUES * spread && between(&moves(a), &moved) <= SAME_MOVES * rms(&moved)
}

fn moves(x: &[f64]) -> Vec<f64> {
    x.windows(2).map(|pair| pair[1] - pair[0]).collect()
}

/// Fraction of OP's variance explained by PV and its integral: nearly all of it under a PI controller. Linear trends are
/// removed first, since the integral of a small offset is one.
fn explained(op: &[f64], pv: &[f64]) -> f64 {
    let mut sum = 0.0;
    let mut add = |value: &f64| {
        sum += value;
        sum
    };
    let integral: Vec<f64> = remove_mean(pv).iter().map(&mut add).collect();
    let (op, pv, integral) = (remove_line(op), remove_line(pv), remove_line(&integral));
    let (pp, pi, ii) = (stats::dot(&pv, &pv), stats::dot(&pv, &integral), stats::dot(&integral, &integral));
    let (po, io, oo) = (stats::dot(&pv, &op), stats::dot(&integral, &op), stats::dot(&op, &op));
    let det = pp * ii - pi * pi;
    if det <= 1e-12 * pp * ii || oo <= 0.0 {
        return 0.0;
    }
    (po * (ii * po - pi * io) + io * (pp * io - pi * po)) / (det * oo)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_position_that_falls_while_op_rises_is_named_and_one_that_follows_is_not() {
        let op: Vec<f64> = (0..600).map(|k| 50.0 + 5.0 * libm::sin(0.05 * f64::from(k))).collect();
        let pv: Vec<f64> = (0..600).map(|k| 20.0 + libm::sin(0.05 * f64::from(k) - 0.7)).collect();
        let name: Arc<str> = "FIC1".into();
        let found = |mv: Vec<f64>| {
            let record = Record { mv: Some(mv), ..Record::uniform(1.0, op.clone(), pv.clone()) };
            misplaced([(&name, &record)])
        };
        let opposite = op.iter().map(|u| 100.0 - u).collect();
        assert_eq!(found(opposite), [(name.clone(), Misplaced::OppositePosition)]);
        // A sticking stem lags behind OP and has a correlation in between.
        let sticks = (0..600).map(|k: i32| 50.0 + 5.0 * libm::sin(0.05 * f64::from(20 * (k / 20)) - 0.5)).collect();
        assert_eq!(found(sticks), []);
        assert_eq!(found(op.clone()), []);
    }
}
