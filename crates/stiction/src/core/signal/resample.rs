//! Downsampling of a record of raw samples: in bins without aliasing, or by dropping samples.

use crate::core::record::{Facts, Record};
use crate::core::units::ns_from_s;

/// Grid steps per sample for fractional ratios.
const GRID: usize = 4;

/// Bins of `ratio` raw samples (any number above 1).
///
/// PV, SP and MV become means over each bin. OP keeps all its values, because the valve model must run on OP as recorded; the
/// model's output is then averaged over the same bins. For a fractional `ratio`, signals are held on a grid of `GRID` steps
/// per sample, the bin counts as the nearest integer number of samples, and [`Record::ts_s`] is the time of such a sample. PV
/// is then shifted so that the delay between OP and its first response is an integer number of them.
///
/// `None` if the ratio is not a finite number above 1, the record is already in bins, or there is not one whole bin.
#[must_use]
pub fn boxed(record: &Record, ratio: f64) -> Option<Record> {
    let n = record.len();
    if !(ratio.is_finite() && ratio > 1.0) || record.box_samples != 1 || ratio > n as f64 {
        return None;
    }
    let box_samples = ratio.round().max(1.0);
    let whole = (ratio - box_samples).abs() < 1e-9;
    let steps = if whole { box_samples as usize } else { GRID * ratio.ceil() as usize };
    let step = ratio / steps as f64;
    let points = ((n as f64 + 1e-9) / ratio) as usize;
    let place = |k: usize, ahead: f64| (((k as f64 + 0.5) * step + ahead + 1e-9) as usize).min(n - 1);
    let ahead = if whole { 0.0 } else { 1.0 - ratio / box_samples };
    let mean_of = |x: &[f64]| -> Vec<f64> {
        let value = |k: usize| x[place(k, ahead)];
        (0..points).map(|p| (p * steps..(p + 1) * steps).map(value).sum::<f64>() / steps as f64).collect()
    };
    let used = ((points as f64 * ratio).round() as usize).min(n);
    Some(Record {
        start_ns: record.start_ns,
        end_ns: record.end_ns,
        ts_s: record.ts_s * ratio / box_samples,
        recorded_ts_s: record.recorded_ts_s,
        held: record.held,
        raw_samples: used,
        box_samples: box_samples as usize,
        op_path: (0..points * steps).map(|k| record.op_path[place(k, 0.0)]).collect(),
        pv: mean_of(&record.pv),
        sp: record.sp.as_deref().map(mean_of),
        mv: record.mv.as_deref().map(mean_of),
        irregularity: record.irregularity,
        facts: record.facts,
    })
}

/// Every `ratio`-th sample (any number above 1; the latest one at that time); the others are dropped, OP's too. This may alias
/// and loses OP's moves in between. The toolbox does this; it is here for comparison.
///
/// `None` as for [`boxed`].
#[must_use]
pub fn decimated(record: &Record, ratio: f64) -> Option<Record> {
    let n = record.len();
    if !(ratio.is_finite() && ratio > 1.0) || record.box_samples != 1 || ratio > n as f64 {
        return None;
    }
    let kept: Vec<usize> = (0..n).map(|k| (k as f64 * ratio + 1e-9) as usize).take_while(|place| *place < n).collect();
    let pick = |x: &[f64]| -> Vec<f64> { kept.iter().map(|k| x[*k]).collect() };
    let mut out = Record::uniform(record.ts_s * ratio, pick(&record.op_path), pick(&record.pv));
    let share = |count: u32| (f64::from(count) / ratio).round() as u32;
    let facts = record.facts;
    out.facts = Facts { manual: share(facts.manual), filled: share(facts.filled), bad: share(facts.bad), ..out.facts };
    out.start_ns = record.start_ns;
    let last = kept.last().map_or(0, |k| *k) as f64;
    out.end_ns = record.end_ns.min(record.start_ns.saturating_add(ns_from_s(last * record.ts_s)));
    out.sp = record.sp.as_deref().map(pick);
    out.mv = record.mv.as_deref().map(pick);
    out.irregularity = record.irregularity;
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(n: usize) -> Record {
        let op: Vec<f64> = (0..n).map(|k| k as f64).collect();
        let pv = op.iter().map(|u| 10.0 * u).collect();
        Record { sp: Some(op.clone()), ..Record::uniform(2.0, op, pv) }
    }

    #[test]
    fn a_whole_ratio_gives_means_of_whole_boxes_and_keeps_op() {
        let record = boxed(&ramp(11), 3.0).unwrap();
        assert_eq!((record.box_samples, record.ts_s, record.point_s(), record.raw_samples), (3, 2.0, 6.0, 9));
        assert_eq!(record.pv, [10.0, 40.0, 70.0]);
        assert_eq!(record.op_path, (0..9).map(f64::from).collect::<Vec<_>>());
        assert_eq!((record.path_per_point(), record.op()), (3, vec![1.0, 4.0, 7.0]));
        assert_eq!(record.sp.unwrap(), [1.0, 4.0, 7.0]);
    }

    #[test]
    fn any_ratio_passes_every_value_of_op_in_order() {
        for ratio in [1.01, 1.5, 2.5, 3.7, 9.99] {
            let record = boxed(&ramp(200), ratio).unwrap();
            assert_eq!(record.len(), (200.0 / ratio) as usize);
            assert!((record.point_s() - 2.0 * ratio).abs() < 1e-9);
            assert_eq!(record.recorded_ts_s, 2.0, "what was recorded stays");
            let steps: Vec<f64> = record.op_path.windows(2).map(|w| w[1] - w[0]).collect();
            assert!(steps.iter().all(|s| *s == 0.0 || *s == 1.0), "{ratio}");
            // A ramp stays a ramp: bin means differ by the ratio, within a step of the grid.
            for pair in record.pv.windows(2) {
                assert!((pair[1] - pair[0] - 10.0 * ratio).abs() <= 10.0, "{ratio}: {pair:?}");
            }
        }
    }

    #[test]
    fn decimation_drops_what_lies_between() {
        let record = decimated(&ramp(11), 2.5).unwrap();
        assert_eq!(record.op_path, [0.0, 2.0, 5.0, 7.0, 10.0]);
        assert_eq!((record.ts_s, record.box_samples, record.len()), (5.0, 1, 5));
        assert_eq!(record.sp.unwrap().len(), 5);
    }

    #[test]
    fn ratios_without_a_sense_are_refused() {
        for ratio in [1.0, 0.5, -2.0, 12.0, f64::NAN, f64::INFINITY] {
            assert!(boxed(&ramp(11), ratio).is_none() && decimated(&ramp(11), ratio).is_none(), "{ratio}");
        }
        assert!(boxed(&boxed(&ramp(11), 2.0).unwrap(), 2.0).is_none());
    }
}
