//! Whether OP and PV are swapped: judged by the set point if there is one, else by the controller.

use crate::core::detect::oscillation;
use crate::core::ident::controller;
use crate::core::record::Record;
use crate::core::signal::stats;

/// Distances of the means of OP and PV from that of the set point, in standard deviations of each, at which the two count as
/// swapped. None of 106 labelled recordings with a set point counts as swapped; with OP and PV exchanged, 75 of them do.
const NEAR_SET_POINT: f64 = 0.1;
const FAR_FROM_SET_POINT: f64 = 2.0;
/// Points per period below which the data do not show which of two signals leads.
const FEWEST_A_PERIOD: f64 = 10.0;
/// Most points in which a controller is identified.
pub const POINTS: usize = 3000;

/// OP is at the set point on average, and PV is far from it. `false` without a set point.
#[must_use]
pub(crate) fn by_set_point(record: &Record) -> bool {
    let Some(sp) = record.sp.as_deref() else { return false };
    let set_point = stats::mean(sp);
    let distance = |x: &[f64]| (stats::mean(x) - set_point).abs() / stats::std_dev(x);
    distance(&record.op()) < NEAR_SET_POINT && distance(&record.pv) > FAR_FROM_SET_POINT
}

/// No controller computes this OP from this PV, but one computes this PV from this OP; the set point is not used.
#[must_use]
pub fn by_controller(record: &Record) -> bool {
    let given = Record { sp: None, ..record.part(0, POINTS) };
    let period = oscillation::detect(&given.op(), &given.pv).filter(|o| o.oscillating);
    if period.is_some_and(|o| o.period_points < FEWEST_A_PERIOD) {
        return false;
    }
    if controller::read(&given).is_some() {
        return false;
    }
    let exchanged = Record::uniform(given.point_s(), given.pv.clone(), given.op());
    controller::read(&exchanged).is_some_and(|reading| reading.r2 >= controller::CERTAIN_R2)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(n: usize, level: f64) -> Vec<f64> {
        let at = |t: f64| libm::sin(t * 0.13) + 0.3 * libm::sin(t * 0.9) + 0.2 * libm::sin(t * t * 0.01);
        (0..n).map(|k| level + at(k as f64)).collect()
    }

    #[test]
    fn a_set_point_shows_it_where_only_op_is_near() {
        let found = |sp: f64, op: f64, pv: f64| {
            by_set_point(&Record { sp: Some(vec![sp; 500]), ..Record::uniform(1.0, wave(500, op), wave(500, pv)) })
        };
        assert!(found(50.0, 50.0, 30.0));
        // An offset of PV alone, an OP that happens to have PV's level, and a missing set point are no sign of a swap.
        assert!(!found(60.0, 50.0, 30.0) && !found(50.0, 50.0, 50.0));
        assert!(!by_set_point(&Record::uniform(1.0, wave(500, 50.0), wave(500, 30.0))));
    }

    #[test]
    fn a_controller_shows_it_in_the_other_direction() {
        let pv = wave(600, 50.0);
        let mut integral = 0.0;
        let pi = |p: &f64| {
            integral += 0.035 * (50.0 - p);
            30.0 + 0.7 * (50.0 - p) + integral
        };
        let op: Vec<f64> = pv.iter().map(pi).collect();
        assert!(by_controller(&Record::uniform(5.0, pv.clone(), op.clone())));
        assert!(!by_controller(&Record::uniform(5.0, op, pv.clone())));
        assert!(!by_controller(&Record::uniform(5.0, vec![50.0; 600], pv.clone())), "no controller either way");
        let thinned = |x: &[f64]| x.iter().step_by(12).copied().collect::<Vec<f64>>();
        let sine: Vec<f64> = (0..6000).map(|k| libm::sin(k as f64 * 0.13)).collect();
        let lagging: Vec<f64> = (0..6000).map(|k| libm::sin(k as f64 * 0.13 - 1.3)).collect();
        let few = Record::uniform(60.0, thinned(&lagging), thinned(&sine));
        assert!(!by_controller(&few), "four samples a period");
    }
}
