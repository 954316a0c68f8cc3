//! Evidence in a record: oscillation and validity checks at a first look, then the fit and the classifier's figures.

use super::document::{Gate, Oscillation, Process};
use super::features::{Features, Figures};
use super::gates::{gates, is_interpolated};
use super::params::AssessParams;
use super::rule::{Opinion, Rule};
use crate::core::detect::View;
use crate::core::detect::oscillation::{Looks, Oscillates};
use crate::core::ident::controller::{self, Reading};
use crate::core::ident::{Estimate, Options, quantify};
use crate::core::record::Record;
use crate::core::signal::stats;

/// Evidence from a first look, which costs a hundredth of a fit.
pub(super) struct FirstLook {
    pub looks: Looks,
    /// The validity checks that apply.
    pub gates: Vec<Gate>,
}

impl FirstLook {
    pub(super) fn of(record: &Record, params: &AssessParams) -> Self {
        let looks = Looks::of(&record.op(), &record.pv);
        let gates = gates(record, &describe(looks.together().as_ref(), record), params);
        Self { looks, gates }
    }

    pub(super) fn oscillation(&self) -> Option<Oscillates> {
        self.looks.together()
    }

    /// The first check that prevents an answer.
    pub(super) fn blocking(&self) -> Option<Gate> {
        self.gates.iter().copied().find(|g| g.blocks())
    }
}

/// The oscillation as in documents.
pub(super) fn describe(found: Option<&Oscillates>, record: &Record) -> Oscillation {
    Oscillation {
        oscillating: found.is_some_and(|o| o.oscillating),
        period_s: found.map(|o| o.period_points * record.point_s()),
        periods: found.map(|o| o.periods),
        samples_per_period: found.map(|o| o.period_points * recorded_per_point(record)),
        regularity: found.map(|o| o.regularity),
    }
}

/// Recorded samples per point; a value held over several samples counts as one.
fn recorded_per_point(record: &Record) -> f64 {
    let held = record.held.max(1) as f64;
    if record.recorded_ts_s == record.ts_s {
        record.box_samples as f64 / held
    } else {
        record.point_s() / record.recorded_ts_s / held
    }
}

/// A record and all evidence on which its verdict is based.
pub(super) struct Evidence<'r> {
    pub record: &'r Record,
    pub first: FirstLook,
    /// `None` if no fit was made.
    pub estimate: Option<Estimate>,
    /// The record in the form that the detectors need.
    pub view: View,
    /// PV lies on straight lines between stored values.
    pub interpolated: bool,
    pub figures: Figures,
}

impl<'r> Evidence<'r> {
    fn of(record: &'r Record, params: &AssessParams, first: FirstLook) -> Self {
        let found = first.oscillation();
        let worth_it = params.always_fit
            || found.is_some_and(|o| o.oscillating && o.periods >= params.min_periods)
            || reversals(&record.op()) as f64 >= params.min_periods;
        let estimate = if worth_it { quantify(record, &options(params, &first)).ok() } else { None };
        let view = View::with_period(record, first.looks.typical_period);
        let interpolated = is_interpolated(record);
        let figures = Figures::of(estimate.as_ref(), record, &view, interpolated);
        Self { record, first, estimate, view, interpolated, figures }
    }

    /// The fitted process as in documents.
    pub(super) fn process(&self) -> Option<Process> {
        let e = self.estimate.as_ref()?;
        Some(Process {
            order: e.class.order(),
            gain: e.gain,
            time_constants_s: e.time_constants_s.clone(),
            dead_time_s: e.dead_time_s,
            integrating: e.class.integrates(),
            mse: e.mse,
            fit_pct: 100.0 * (1.0 - e.mse.sqrt() / stats::std_dev(&self.record.pv)),
            tested: false,
            gain_interval: e.gain_interval(),
            dead_time_interval_s: e.dead_time_interval_s(self.record.point_s()),
        })
    }
}

/// Options of the fit to a record.
pub(super) fn options(params: &AssessParams, first: &FirstLook) -> Options {
    params.options(first.oscillation().map(|o| o.period_points))
}

/// Reversals of OP larger than its noise and a twentieth of its span.
fn reversals(op: &[f64]) -> usize {
    let band = (6.0 * stats::noise_sd(op)).max(0.05 * stats::span(op));
    stats::turns(op, band)
}

/// The windows in which a record is judged.
pub(super) struct Windows<'r> {
    whole: &'r Record,
    /// Windows without a blocking check; the record itself if it was not split.
    windows: Vec<Evidence<'r>>,
}

impl<'r> Windows<'r> {
    /// `first` is the first look at the whole record.
    pub(super) fn of(whole: &'r Record, windows: &'r [Record], params: &AssessParams, first: FirstLook) -> Self {
        let open = |record: &'r Record| {
            let first = FirstLook::of(record, params);
            first.blocking().is_none().then(|| Evidence::of(record, params, first))
        };
        let mut windows: Vec<Evidence<'r>> = windows.iter().filter_map(open).collect();
        if windows.is_empty() {
            windows.push(Evidence::of(whole, params, first));
        }
        Self { whole, windows }
    }

    pub(super) fn figures(&self) -> Vec<Figures> {
        self.windows.iter().map(|window| window.figures).collect()
    }

    /// The window whose logit is the median, as the answer for the record.
    pub(super) fn answer(mut self, params: &AssessParams) -> Option<Answer<'r>> {
        let (window, opinion) = Rule::shipped().answer(&self.figures())?;
        let answering = self.windows.swap_remove(window);
        let features = answering.figures.features();
        let held_as_recorded = self.whole.box_samples <= 1;
        let sized = if core::ptr::eq(answering.record, self.whole) || !held_as_recorded {
            answering
        } else {
            Evidence::of(self.whole, params, FirstLook::of(self.whole, params))
        };
        let controller = controller::read(sized.record);
        Some(Answer { features, opinion, sized, controller })
    }
}

/// The classifier's answer for a record, and the source of the sizes.
pub(super) struct Answer<'r> {
    /// Features of the answering window.
    pub features: Features,
    /// The classifier's opinion on them.
    pub opinion: Opinion,
    /// The whole record if it is held as recorded; else the answering window.
    pub sized: Evidence<'r>,
    /// The controller identified from `sized`.
    pub controller: Option<Reading>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reversals_are_counted_above_the_noise() {
        let op: Vec<f64> = (0..600).map(|k| libm::sin(k as f64 * 0.0628) + 0.001 * f64::from(k % 2)).collect();
        assert_eq!(reversals(&op), 12);
        assert_eq!(reversals(&[]), 0);
        assert_eq!(reversals(&[1.0; 50]), 0);
    }
}
