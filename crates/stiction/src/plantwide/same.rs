//! Whether two loops have the same record: a file sent under two names, or keys mapped twice.

use crate::core::record::Record;
use crate::core::signal::stats;
use crate::core::units::ns_from_s;

/// Largest difference between two copies of a sample, as a share of the signal's span: rounding by formats and means of bins.
const ROUNDED: f64 = 1e-6;
/// Fewest common points.
const LEAST: usize = 30;

/// Whether OP and PV of both records agree over their common time, which must cover most of each.
pub(super) fn is_same(a: &Record, b: &Record) -> bool {
    let step_s = a.point_s();
    if (step_s - b.point_s()).abs() > 1e-6 * step_s {
        return false;
    }
    let step_ns = ns_from_s(step_s).max(1);
    let ahead = (b.start_ns - a.start_ns + step_ns / 2).div_euclid(step_ns);
    let (from_a, from_b) = (ahead.max(0) as usize, (-ahead).max(0) as usize);
    let points = a.pv.len().saturating_sub(from_a).min(b.pv.len().saturating_sub(from_b));
    points >= LEAST
        && 2 * points > a.pv.len().max(b.pv.len())
        && agree(&a.pv[from_a..from_a + points], &b.pv[from_b..from_b + points])
        && agree(&a.op()[from_a..from_a + points], &b.op()[from_b..from_b + points])
}

fn agree(a: &[f64], b: &[f64]) -> bool {
    let allowed = ROUNDED * stats::span(a);
    a.iter().zip(b).all(|(a, b)| (a - b).abs() <= allowed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copies_are_the_same_and_two_transmitters_on_one_pipe_are_not() {
        let wave = |lag: f64| (0..600).map(|k| libm::sin(0.1 * (f64::from(k) - lag))).collect::<Vec<f64>>();
        let one = Record::uniform(1.0, wave(0.0), wave(8.0));
        let cut = |from: usize, to: usize| one.part(from, to);
        assert!(is_same(&one, &one) && is_same(&cut(0, 500), &cut(50, 600)) && is_same(&cut(50, 600), &cut(0, 500)));
        let noisy =
            Record { pv: one.pv.iter().enumerate().map(|(k, y)| y + 1e-3 * (k % 7) as f64).collect(), ..one.clone() };
        assert!(!is_same(&one, &noisy));
        let other_op = Record::uniform(1.0, wave(1.0), wave(8.0));
        assert!(!is_same(&one, &other_op) && !is_same(&cut(0, 20), &cut(0, 20)));
    }
}
