//! Options of an assessment.

use super::plausible::Range;
use super::prevalence::PREVALENCE;
use crate::core::ident::Options;
use crate::core::units::{FinalElement, LoopKind};

/// All options of [`super::assess`]. The defaults are the daemon's.
#[derive(Debug, Clone, PartialEq)]
pub struct AssessParams {
    /// Periods below which `too_few_periods` applies, and no fit is made unless `always_fit` is set.
    pub min_periods: f64,
    /// Raw samples per period below which `too_coarse` applies.
    pub min_samples_per_period: f64,
    /// Reversals of the stem from which a window holds enough evidence, however few its periods.
    pub min_reversals: usize,
    /// OP's range, for sizes in % of travel.
    pub op_range: Option<[f64; 2]>,
    /// Unit of OP, for texts.
    pub op_unit: Option<String>,
    /// Share of such loops whose valve sticks, 0..1, as `p_stiction` assumes. No verdict or alarm depends on it.
    pub prevalence: f64,
    /// Controlled quantity.
    pub kind: LoopKind,
    /// What OP moves: stiction is judged for valves only.
    pub final_element: FinalElement,
    /// Fit in any case, as `analyze` does; the daemon waits for `min_periods` or as many reversals of OP.
    pub always_fit: bool,
    /// Screen calm loops without a fit, unless `always_fit`: see `screened` among the reasons in documents.
    pub screening: bool,
    /// Options of the fit, except the period, which comes from each record.
    pub fit: Options,
}

impl Default for AssessParams {
    fn default() -> Self {
        Self {
            min_periods: 5.0,
            min_samples_per_period: 50.0,
            min_reversals: 1,
            op_range: None,
            op_unit: None,
            prevalence: PREVALENCE,
            kind: LoopKind::Other,
            final_element: FinalElement::Valve,
            always_fit: false,
            screening: true,
            fit: Options::default(),
        }
    }
}

impl AssessParams {
    /// Options of the fit, with the oscillation's period in points, if known, and within the plausible values for this kind of
    /// loop.
    #[must_use]
    pub fn options(&self, period_points: Option<f64>) -> Options {
        let may = Range::of(self.kind);
        let longest_dead_time_s = self.fit.longest_dead_time_s.min(may.dead_time_s);
        let may_integrate = self.fit.may_integrate && may.integrates;
        Options { period_points, longest_dead_time_s, may_integrate, ..self.fit }
    }
}
