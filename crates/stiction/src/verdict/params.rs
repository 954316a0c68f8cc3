//! What an assessment can be told.

use crate::ident::{DelayChoice, ModelChoice, Options, ValveChoice};
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
    /// Process order.
    pub model: ModelChoice,
    /// Dead time.
    pub delay: DelayChoice,
    /// Valve law.
    pub valve: ValveChoice,
    /// Name of the solver, one of [`crate::optim::ALL`].
    pub solver: &'static str,
    /// Step of the contour grid, % of S0.
    pub fineness_pct: f64,
    /// Seed of every random choice.
    pub seed: u64,
    /// Fit whatever is there, as `analyze` does; the daemon waits for `min_periods` or as many reversals.
    pub always_fit: bool,
    /// Let calm loops go at once, unless `always_fit`: see `screened` among the reasons of documents.
    pub screening: bool,
}

impl Default for AssessParams {
    fn default() -> Self {
        Self {
            min_periods: 5.0,
            min_samples_per_period: 50.0,
            op_range: None,
            kind: LoopKind::Other,
            model: ModelChoice::Auto,
            delay: DelayChoice::Auto,
            valve: ValveChoice::default(),
            solver: "contour",
            fineness_pct: 5.0,
            seed: 1,
            always_fit: false,
            screening: true,
        }
    }
}

impl AssessParams {
    /// What the fit is told, with the oscillation's period where one is known, points.
    #[must_use]
    pub const fn options(&self, period_points: Option<f64>) -> Options {
        Options {
            model: self.model,
            delay: self.delay,
            valve: self.valve,
            solver: self.solver,
            fineness_pct: self.fineness_pct,
            seed: self.seed,
            period_points,
        }
    }
}
