//! What the record offers to learn from.

use super::Excitation;
use super::held::Held;
use crate::core::gap::set_point;
use crate::core::record::Record;
use crate::core::signal::stats;

/// Positions nearer than this share of the median move are one.
const SAME: f64 = 0.2;
/// Most positions that are told apart.
const MOST: usize = 1000;

/// Positions of the model's stem, its moves a half cycle, and the set point's moves.
pub(super) fn excitation(held: &Held<'_>, record: &Record) -> Excitation {
    let slips = &held.fit.slips;
    let sizes: Vec<f64> = slips.iter().map(|s| s.size).collect();
    let apart = SAME * stats::median(&sizes);
    let at = |p: usize| held.fit.valve.get(p).copied().filter(|v| v.is_finite());
    // Where the stem comes to rest: the value just before each slip, and at the end.
    let rests = slips.iter().filter_map(|s| at(s.point.saturating_sub(1)));
    let places: Vec<f64> = match slips.is_empty() {
        true => held.fit.valve.iter().copied().filter(|v| v.is_finite()).collect(),
        false => rests.chain(held.fit.valve.last().copied()).collect(),
    };
    let levels = groups(&stats::sorted(&places), apart);
    let turns = slips.windows(2).filter(|w| w[0].direction != w[1].direction).count();
    Excitation {
        levels: levels as u64,
        jumps_per_half_cycle: (turns > 0).then(|| slips.len() as f64 / (turns + 1) as f64),
        setpoint_moves: record.sp.as_ref().map(|_| set_point::moves(record).len() as u64),
        two_level: levels == 2,
    }
}

/// Groups of sorted values no wider than `apart`, counted up to a limit.
fn groups(sorted: &[f64], apart: f64) -> usize {
    let (mut count, mut begin) = (0, f64::NEG_INFINITY);
    for &value in sorted {
        if count == 0 || value - begin > apart {
            count += 1;
            begin = value;
        }
        if count >= MOST {
            break;
        }
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_places_are_one() {
        assert_eq!(groups(&[1.0, 1.05, 2.0, 2.1, 5.0], 0.2), 3);
        assert_eq!(groups(&[], 0.2), 0);
    }
}
