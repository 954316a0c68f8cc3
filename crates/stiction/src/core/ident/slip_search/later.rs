//! Bands for which a stem makes the same moves, all shifted by the same number of points.
//!
//! If the lag changes by the same amount, PV hardly distinguishes them: along this ridge a record with few moves leaves s and
//! the dead time undetermined.

use crate::core::ident::normalised::{NormalisedRecord, Start};
use crate::core::sim::slips::Law;
use crate::core::sim::steps::Steps;

/// Relative margin by which a value is inside a threshold.
const JUST: f64 = 1e-6;

/// One move of a stem: its point, and whether the stem reverses.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Move {
    point: usize,
    turns: bool,
}

/// The moves of a stem that start from rest.
pub(super) struct Moves {
    list: Vec<Move>,
    law: Law,
}

/// Bands and first slip, as in [`super::candidate::Candidate`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bands {
    pub s: f64,
    pub j: f64,
    pub start: Start,
}

/// Bounds of a threshold on OP's travel since the last move: above `least`, where the stem still rests, and at most `most`,
/// where it moves.
#[derive(Debug, Clone, Copy)]
struct Threshold {
    most: f64,
    least: f64,
}

impl Threshold {
    const OPEN: Self = Self { most: f64::INFINITY, least: 0.0 };

    /// The middle of the range that all moves allow. If the moves contradict each other, each still happens, some too early.
    fn middle(self) -> f64 {
        if self.least < self.most { 0.5 * (self.least + self.most) } else { (1.0 - JUST) * self.most }
    }

    /// The nearest value that the moves allow.
    fn nearest(self, to: f64) -> f64 {
        if (self.least..self.most).contains(&to) {
            to
        } else if self.most.is_finite() {
            self.middle()
        } else {
            self.least
        }
    }
}

impl Moves {
    /// Moves of a valve signal under a law.
    pub(super) fn of(steps: &Steps, law: Law) -> Self {
        let all = steps.list.iter().map(|s| Move { point: s.point as usize, turns: s.direction != 0.0 });
        // Under the tracking law a moving stem slides on from sample to sample.
        let list = all.enumerate().filter(|(k, m)| *k == 0 || m.turns || law == Law::He).map(|(_, m)| m).collect();
        Self { list, law }
    }

    /// The bands that delay all moves by `by` points, with j as near to `near` as possible; `None` if the record does not reach
    /// that far, or no move reverses. Of a point with several OP values the first counts.
    pub(super) fn later(&self, record: &NormalisedRecord, start: Start, near: f64, by: isize) -> Option<Bands> {
        let op = record.path.values();
        let per_point = record.path.per_point();
        let at = |m: &Move| {
            let point = m.point.checked_add_signed(by)?;
            (point < record.path.points()).then_some(point * per_point)
        };
        let first = self.list.first().and_then(at)?;
        // A stem whose first move continues behaves as if it had come from the other side of its start.
        let starts = self.list.first().is_some_and(|m| m.turns);
        let mut direction = if start.up == starts { 1.0 } else { -1.0 };
        let [mut s, mut j] = [Threshold::OPEN; 2];
        let mut from = first;
        for m in &self.list[1..] {
            let Some(to) = at(m) else { break };
            // The travel to this move begins at the previous move, or where OP turned.
            let way = |x: &f64| direction * x;
            if self.law == Law::Tracking {
                from = (from..=to).max_by(|a, b| way(&op[*a]).total_cmp(&way(&op[*b])))?;
            }
            let on = |k: usize| way(&op[k]) - way(&op[from]);
            for k in from..to {
                (s.least, j.least) = (s.least.max(-on(k)), j.least.max(on(k)));
            }
            if m.turns {
                s.most = s.most.min(-on(to));
                direction = -direction;
            } else {
                j.most = j.most.min(on(to));
            }
            from = to;
        }
        let start = if starts { start_at(record, start, first) } else { start };
        s.most.is_finite().then(|| Bands { s: s.middle(), j: j.nearest(near), start })
    }
}

/// A start in the same direction whose first slip happens at a given OP value.
fn start_at(record: &NormalisedRecord, start: Start, at: usize) -> Start {
    let sign = if start.up { 1.0 } else { -1.0 };
    let reached = record.path.values()[..=at].iter().fold(f64::NEG_INFINITY, |m, x| m.max(sign * x));
    let extremes = &record.extremes[usize::from(!start.up)];
    let extreme = extremes.partition_point(|e| sign * e < reached).min(extremes.len() - 1);
    Start { extreme, ..start }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::ident::choice::Options;
    use crate::core::record::Record;

    #[test]
    fn the_bands_of_later_moves_make_the_same_moves_later() {
        // Straight slopes, on which every move can be delayed by the same amount.
        let op: Vec<f64> = (0..6000).map(|k| (f64::from((k + 500) % 1000) - 500.0).abs()).collect();
        let pv = op.iter().map(|x| x * x).collect();
        let record = NormalisedRecord::of(&Record::uniform(1.0, op, pv), &Options::default()).unwrap();
        let points = |s: f64, j: f64, start: Start, law: Law| {
            let mut steps = Steps::default();
            let first = record.first_slip(start);
            steps.run(&record.path, record.path.points(), record.stroke, law, [s, j], first);
            let points = Moves::of(&steps, law).list;
            (steps, points)
        };
        let start = Start { up: true, extreme: 130, place: 0.5 };
        for (law, [s, j]) in [(Law::He, [0.4, 0.3]), (Law::He, [0.5, 0.3]), (Law::Tracking, [0.4, 0.3])] {
            let (steps, before) = points(s, j, start, law);
            assert!(before.len() > 5);
            for by in [-30_isize, -10, 10, 20] {
                let bands = Moves::of(&steps, law).later(&record, start, j, by).unwrap();
                let (_, after) = points(bands.s, bands.j, bands.start, law);
                assert_eq!(before.len(), after.len(), "{law:?} {by}");
                let is_later = |(a, b): (&Move, &Move)| {
                    a.turns == b.turns && a.point.saturating_add_signed(by).abs_diff(b.point) <= 1
                };
                assert!(before.iter().zip(&after).all(is_later), "{law:?} {by}: {before:?} {after:?}");
            }
        }
    }
}
