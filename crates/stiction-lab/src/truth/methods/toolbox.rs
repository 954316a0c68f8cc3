//! The toolbox's method (Lee, Ren and Huang 2008): the best cell of He's law compared with no friction.

use super::{Answer, Case, Method};
use stiction::core::signal::stats;
use stiction::toolbox::one_step::{Best, Search, toolbox};

/// Samples kept per period; the dead times tried are counted in samples.
const POINTS_PER_PERIOD: f64 = 100.0;
/// Published thresholds on the index and on s over OP's span.
const INDEX: f64 = 0.5;
const SHARE_OF_SPAN: f64 = 0.2;

/// Statistic: the stiction index, or 0 if s is at most a fifth of OP's span.
pub(super) struct Toolbox;

impl Method for Toolbox {
    fn name(&self) -> &'static str {
        "toolbox (index, s/span)"
    }

    fn decision(&self) -> &'static str {
        "index >= 0.5, s/span > 0.2"
    }

    fn answer(&self, case: &Case<'_>) -> Answer {
        Answer::by_thresholds(statistic(case), INDEX, INDEX)
    }
}

fn statistic(case: &Case<'_>) -> Option<f64> {
    let period = case.view.output.period * (case.record.len() as f64 / case.view.pv.len().max(1) as f64);
    let every = ((period / POINTS_PER_PERIOD) as usize).max(1);
    let thinned = |x: &[f64]| x.iter().step_by(every).copied().collect::<Vec<f64>>();
    let (op, pv) = (thinned(&case.record.op()), thinned(&case.record.pv));
    let span = stats::span(&op);
    let of = |sign: &f64| toolbox(&op, &pv, &Search::within(span, *sign));
    let best = case.signs.iter().filter_map(of).min_by(|a: &Best, b: &Best| a.error.total_cmp(&b.error))?;
    Some(if best.s > SHARE_OF_SPAN * span { best.index } else { 0.0 })
}
