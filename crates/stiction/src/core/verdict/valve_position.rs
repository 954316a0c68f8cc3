//! Hysteresis from a recorded valve position: how far OP moves after a reversal before the valve follows.

use serde::{Deserialize, Serialize};

use crate::core::ident::least_squares::Gram;
use crate::core::record::Record;
use crate::core::signal::stats;
use crate::core::units::number;

/// Change of the position that counts as a move, standard deviations of its noise.
const MOVES: f64 = 4.0;
/// Smallest change that counts as a move, as a share of the largest moves.
const LEAST_MOVE: f64 = 0.05;
/// Fewest moves in each direction.
const FEWEST: usize = 5;
/// Share of OP's variance at the moves that the position must explain.
const EXPLAINED: f64 = 0.5;

/// The hysteresis between OP and the recorded valve position.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ValvePosition {
    /// Its width: how far OP goes after a reversal before the valve follows, OP units; `None` where the position moves too
    /// seldom or too fast, or does not follow OP.
    pub hysteresis: Option<f64>,
    /// The same in each half of the record; `None` where a half has too few moves.
    pub halves: Option<[f64; 2]>,
}

impl ValvePosition {
    /// Hysteresis in a record; `None` if no position is recorded.
    #[must_use]
    pub(crate) fn of(record: &Record) -> Option<Self> {
        let mv = record.mv.as_deref().filter(|mv| mv.len() == record.len() && stats::span(mv).is_normal())?;
        let op = record.op();
        let hysteresis = width(&op, mv);
        let half = op.len() / 2;
        let halves = width(&op[..half], &mv[..half]).zip(width(&op[half..], &mv[half..]));
        let halves = halves.filter(|_| hysteresis.is_some()).map(|(first, second)| [first, second]);
        Some(Self { hysteresis, halves })
    }

    /// In words, without a full stop.
    #[must_use]
    pub fn words(&self) -> String {
        let Some(width) = self.hysteresis else {
            return "the recorded valve position shows no hysteresis that can be measured here: it moves too seldom or too \
                    fast, or does not follow OP"
                .to_owned();
        };
        let halves = self.halves.map_or_else(String::new, |[first, second]| {
            format!(" ({} and {} in the halves of the record)", number(first), number(second))
        });
        format!("measured OP-to-MV hysteresis {} OP units{halves}", number(width))
    }
}

/// Regresses OP at the valve's moves on the position, both halfway through each move, and on the move's direction: the width is
/// twice the direction's coefficient.
fn width(op: &[f64], mv: &[f64]) -> Option<f64> {
    let finite = op.iter().chain(mv).all(|v| v.is_finite());
    let steps: Vec<f64> = mv.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
    let least = (MOVES * stats::noise_sd(mv)).max(LEAST_MOVE * stats::quantile(&steps, 0.99));
    if !finite || steps.len() < 4 * FEWEST {
        return None;
    }
    let halfway = |x: &[f64], k: usize| 0.5 * (x[k] + x[k - 1]);
    let mut columns: [Vec<f64>; 4] = Default::default();
    for k in 1..mv.len() {
        let step = mv[k] - mv[k - 1];
        if step.abs() > least {
            for (column, value) in columns.iter_mut().zip([1.0, halfway(mv, k), step.signum(), halfway(op, k)]) {
                column.push(value);
            }
        }
    }
    let up = columns[2].iter().filter(|d| **d > 0.0).count();
    if up < FEWEST || columns[2].len() - up < FEWEST {
        return None;
    }
    let mut gram = Gram::of(&columns.each_ref().map(Vec::as_slice));
    let mut level = gram.clone();
    level.eliminate(1);
    gram.eliminate(3);
    let [_, _, by_direction, ..] = gram.back(3, &[]);
    let follows = gram.at(3, 3) <= (1.0 - EXPLAINED) * level.at(3, 3);
    (follows && by_direction.is_finite()).then(|| (2.0 * by_direction).max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sim::noise::Noise;

    /// A stem that rests until OP is `fs` ahead and then moves to `fd` behind it; returned as a position in other units, with
    /// noise.
    fn recorded(fs: f64, fd: f64, noise_sd: f64) -> Record {
        let (mut noise, mut stem) = (Noise::new(3, 1), 50.0);
        let op: Vec<f64> = (0..2_000).map(|k| 50.0 + 6.0 * libm::sin(f64::from(k) * 0.04)).collect();
        let follow = |u: &f64| {
            let ahead: f64 = u - stem;
            if ahead.abs() > fs {
                stem = u - fd * ahead.signum();
            }
            4.0 + 0.16 * stem + noise_sd * noise.gaussian()
        };
        let mv = op.iter().map(follow).collect();
        Record { mv: Some(mv), ..Record::uniform(1.0, op.clone(), op) }
    }

    #[test]
    fn the_width_is_that_of_the_bands_in_units_of_op_whatever_the_positions_units() {
        for (fs, fd) in [(1.5, 1.5), (2.0, 0.8)] {
            let found = ValvePosition::of(&recorded(fs, fd, 0.005)).unwrap();
            assert!((found.hysteresis.unwrap() - (fs + fd)).abs() < 0.3, "{fs} {fd}: {found:?}");
            let [first, second] = found.halves.unwrap();
            assert!((first - second).abs() < 0.3, "{found:?}");
        }
        let healthy = ValvePosition::of(&recorded(0.0, 0.0, 0.005)).unwrap();
        assert!(
            healthy.hysteresis.unwrap() < 0.1 && healthy.words().starts_with("measured OP-to-MV hysteresis"),
            "{healthy:?}"
        );
    }

    #[test]
    fn a_position_that_rests_or_does_not_follow_op_has_none() {
        let resting = Record { mv: Some(vec![7.0; 2_000]), ..recorded(1.0, 1.0, 0.0) };
        let mut noise = Noise::new(4, 1);
        let other = Record { mv: Some((0..2_000).map(|_| noise.gaussian()).collect()), ..recorded(1.0, 1.0, 0.0) };
        assert_eq!(ValvePosition::of(&resting), None);
        let found = ValvePosition::of(&other).unwrap();
        assert!(found.hysteresis.is_none() && found.words().contains("shows no hysteresis"), "{found:?}");
    }
}
