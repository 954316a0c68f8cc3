//! Moves of the set point, found in one way for all who count them or hold a load against them.

use super::model::Process;
use crate::core::record::Record;
use crate::core::signal::stats;

/// A set point moves where it changes by more than this share of PV's spread from point to point.
const LEAST_SHARE: f64 = 0.01;
/// Share of a load's size from which a move of the set point may be what is taken for the load.
const AS_LARGE: f64 = 0.25;

/// A move of the set point; a ramp is one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Move {
    /// Point at which it begins.
    pub at: usize,
    /// How far the set point goes, PV units.
    pub size: f64,
}

/// The moves of a record's set point in time order; none without one.
#[must_use]
pub(crate) fn moves(record: &Record) -> Vec<Move> {
    record.sp.as_deref().map(|sp| moves_of(sp, stats::std_dev(&record.pv))).unwrap_or_default()
}

fn moves_of(sp: &[f64], deviation: f64) -> Vec<Move> {
    let least = LEAST_SHARE * deviation;
    let mut out: Vec<Move> = Vec::new();
    let mut goes_on = false;
    for (k, w) in sp.windows(2).enumerate() {
        let change = w[1] - w[0];
        let moves = change.abs() > least;
        match out.last_mut().filter(|_| goes_on && moves) {
            Some(last) => last.size += change,
            None if moves => out.push(Move { at: k + 1, size: change }),
            None => {}
        }
        goes_on = moves;
    }
    out
}

/// Whether what begins at point `at` and moves PV by `size` may be the answer to one of these moves, which goes the same way
/// and takes `answer` points.
#[must_use]
pub(crate) fn explains(moves: &[Move], (at, size): (f64, f64), answer: f64) -> bool {
    moves.iter().any(|m| {
        let after = at - m.at as f64;
        (-1.0..=answer).contains(&after) && m.size * size > 0.0 && m.size.abs() >= AS_LARGE * size.abs()
    })
}

/// Points in which PV answers a move of the set point: the dead time and three time constants of a fitted process.
#[must_use]
pub(crate) fn answer_points(process: &Process, point_s: f64) -> f64 {
    (process.dead_time_s + 3.0 * process.time_constants_s.iter().sum::<f64>()) / point_s + 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_and_ramps_of_the_set_point_are_one_move_each() {
        let mut sp = vec![50.0; 20];
        sp.extend([52.0; 20]);
        sp.extend((0..10).map(|k| 52.0 - 0.3 * f64::from(k + 1)));
        sp.extend([49.0; 10]);
        let found = moves_of(&sp, 1.0);
        assert_eq!(found.iter().map(|m| m.at).collect::<Vec<_>>(), [20, 40]);
        assert!((found[0].size - 2.0).abs() < 1e-9 && (found[1].size + 3.0).abs() < 1e-9, "{found:?}");
        assert!(moves_of(&[f64::NAN; 9], 1.0).is_empty());
    }

    #[test]
    fn what_begins_while_pv_answers_a_move_is_no_load_unless_it_is_far_larger() {
        let moves = [Move { at: 100, size: -1.5 }];
        assert!(explains(&moves, (110.0, -2.3), 30.0));
        assert!(!explains(&moves, (140.0, -2.3), 30.0) && !explains(&moves, (95.0, -2.3), 30.0));
        assert!(!explains(&moves, (110.0, -9.0), 30.0) && !explains(&moves, (110.0, 2.3), 30.0));
    }
}
