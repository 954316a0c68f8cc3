//! The start of a record that the rest of it does not explain: the transient of a start-up, or of whatever came before.
//!
//! The fit takes the stem's first position and the process' first state as it finds them, but not a controller that was
//! just switched on or a valve that moved before the record. A few dozen samples of that leave the residual far from
//! white, and the interval as wide as a fit in doubt deserves, for all the good samples behind them.

use crate::ident::free_run::{Fixed, free_run};
use crate::ident::{Estimate, Options, quantify};
use crate::record::Record;
use crate::units::ns_from_s;

/// Periods that are left out, and fewest periods of a record that can spare them.
const START: f64 = 1.5;
const ENOUGH: f64 = 8.0;
/// Mean squared error of the start over that of the rest from which it is a transient. Over 1.5 periods of 50 samples
/// white noise passes it in less than one record of a hundred.
const WORSE: f64 = 1.5;

/// The estimate without the start of the record, where the start fits worse than the rest and the residual is whiter
/// without it.
#[must_use]
pub fn without(record: &Record, estimate: &Estimate, options: &Options) -> Option<Estimate> {
    let period = options.period_points?;
    let cut = (START * period) as usize;
    if ENOUGH * period > record.len() as f64 || cut < 2 {
        return None;
    }
    let model = Fixed {
        law: estimate.law,
        fs: 0.5 * (estimate.s + estimate.j),
        fd: 0.5 * (estimate.s - estimate.j),
        gain: estimate.gain,
        time_constants_s: &estimate.time_constants_s,
        dead_time_s: estimate.dead_time_s,
        integrating: estimate.class.integrates(),
    };
    let after_ns = record.start_ns + ns_from_s(cut as f64 * record.point_s());
    let rest = free_run(record, &model, after_ns)?.rmse;
    let whole = free_run(record, &model, record.start_ns)?.rmse;
    let (n, first) = (record.len() as f64, cut as f64);
    let start = (n * whole * whole - (n - first) * rest * rest) / first;
    if start <= WORSE * rest * rest {
        return None;
    }
    let found = quantify(&record.part(cut, record.len()), options)?;
    (found.spread.trust(found.s) < estimate.spread.trust(estimate.s)).then_some(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::valve::he_step;

    /// OP swings, a valve follows it, a first-order process answers; PV starts `away` from where it belongs, and the
    /// fault fades over some 20 points without being the process' own memory.
    fn record(away: f64) -> Record {
        let op: Vec<f64> =
            (0..1500).map(|k| 5.0 * libm::sin(f64::from(k) * 0.06) + libm::sin(f64::from(k) * 0.017)).collect();
        let (mut stem, mut state, mut seed) = (0.0, 0.0, 9_u64);
        let pv = op
            .iter()
            .enumerate()
            .map(|(k, u)| {
                seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let noise = (seed >> 11) as f64 / (1_u64 << 53) as f64 - 0.5;
                let measured =
                    state + 0.2 * noise + away * libm::exp(-((k as f64 - 60.0) / 25.0) * ((k as f64 - 60.0) / 25.0));
                stem = he_step(stem, *u, 2.5, 1.0);
                state += 0.1 * (1.5 * stem - state);
                measured
            })
            .collect();
        Record::uniform(1.0, op, pv)
    }

    #[test]
    fn a_start_that_the_rest_does_not_explain_is_left_out() {
        let options = Options { period_points: Some(104.7), ..Options::default() };
        let disturbed = record(1.0);
        let whole = quantify(&disturbed, &options).unwrap();
        let better = without(&disturbed, &whole, &options).unwrap();
        assert!((better.s - 3.5).abs() < 0.05, "{}", better.s);
        let clean = record(0.0);
        let whole = quantify(&clean, &options).unwrap();
        assert!(without(&clean, &whole, &options).is_none());
    }
}
