//! What an assessment can be told.

use super::plausible::Range;
use crate::ident::Options;
use crate::units::LoopKind;

/// Everything that [`super::assess`] may be told. The defaults are the daemon's.
#[derive(Debug, Clone, PartialEq)]
pub struct AssessParams {
    /// Periods below which `too_few_periods` is said and no fit is started unless `always_fit`.
    pub min_periods: f64,
    /// Raw samples a period below which `too_coarse` is said.
    pub min_samples_per_period: f64,
    /// OP's range, so that sizes can be given in % of travel.
    pub op_range: Option<[f64; 2]>,
    /// What the loop controls.
    pub kind: LoopKind,
    /// Fit whatever is there, as `analyze` does; the daemon waits for `min_periods` or as many reversals.
    pub always_fit: bool,
    /// Let calm loops go at once, unless `always_fit`: see `screened` among the reasons of documents.
    pub screening: bool,
    /// What the fit is told, but for the period: each record gives its own.
    pub fit: Options,
}

impl Default for AssessParams {
    fn default() -> Self {
        Self {
            min_periods: 5.0,
            min_samples_per_period: 50.0,
            op_range: None,
            kind: LoopKind::Other,
            always_fit: false,
            screening: true,
            fit: Options::default(),
        }
    }
}

impl AssessParams {
    /// What the fit is told: with the oscillation's period where one is known, points, and with what such a loop may have.
    #[must_use]
    pub fn options(&self, period_points: Option<f64>) -> Options {
        let may = Range::of(self.kind);
        let longest_dead_time_s = self.fit.longest_dead_time_s.min(may.dead_time_s);
        let may_integrate = self.fit.may_integrate && may.integrates;
        Options { period_points, longest_dead_time_s, may_integrate, ..self.fit }
    }
}
