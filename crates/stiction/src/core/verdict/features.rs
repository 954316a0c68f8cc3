//! Figures that a record shows of its valve, and the classifier's features that are computed from them.

use serde::{Deserialize, Serialize};

use crate::core::detect::{self, View};
use crate::core::ident::Estimate;
use crate::core::ident::residual::PORTMANTEAU;
use crate::core::ident::slip_search::answer::FULL_WEIGHT;
use crate::core::record::Record;
use crate::core::signal::stats;

/// Share of the error below which a smaller error proves no more.
const LEAST_ERROR: f64 = 1e-6;
/// Reversals of the stem from which a good fit is no accident.
const MANY_REVERSALS: f64 = 12.0;
/// Odd part of the cross-correlation of OP and PV that noise gives and a sticking valve exceeds.
const HALF_ODD: f64 = 0.5;
/// Cap of the set point's spread, standard deviations of PV.
const MOST_SETPOINT: f64 = 2.0;

/// Names of the features that need a fit, in the order of documents.
pub(crate) const OF_THE_FIT: [&str; 2] = ["likelihood", "confirmed"];
/// Detectors that a feature of the fit uses, or that are left out for a PV on straight lines.
const HORCH: &str = "horch";
const JUMPS: &str = "jumps";

/// Number of features.
const COUNT: usize = OF_THE_FIT.len() + detect::ALL.len();

/// Names of all features in the order of documents: first those of the fit, then the detectors.
pub fn names() -> impl Iterator<Item = &'static str> {
    OF_THE_FIT.into_iter().chain(detect::ALL.iter().map(|d| d.name()))
}

/// The features of one record; a feature that the record does not show is absent.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Features([Option<f64>; COUNT]);

impl Features {
    /// One feature by its name.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<f64> {
        names().zip(self.0).find(|(known, _)| *known == name)?.1
    }

    /// Features with only these scores.
    #[cfg(test)]
    pub(crate) fn of_scores(scores: &[(&str, f64)]) -> Self {
        let score = |name: &str| scores.iter().find(|(n, _)| *n == name).map(|(_, x)| *x);
        let mut known = names();
        Self([(); COUNT].map(|()| known.next().and_then(score)))
    }

    /// The features that need no fit.
    #[must_use]
    pub(crate) fn without_fit(mut self) -> Self {
        self.0[..OF_THE_FIT.len()].fill(None);
        self
    }
}

/// Figures of a fit.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct FitFigures {
    /// Stiction index, 0..1.
    pub index: f64,
    /// s, spans of OP.
    pub s_over_span: f64,
    /// Reversals of the stem.
    pub reversals: f64,
    /// Points fitted.
    pub points: f64,
    /// Points per independent point.
    pub inflation: f64,
    /// Statistic of Ljung and Box for the residual over 20 lags.
    pub portmanteau: f64,
}

impl FitFigures {
    fn of(e: &Estimate, points: usize) -> Self {
        Self {
            index: e.index,
            s_over_span: e.s / e.span,
            reversals: e.reversals as f64,
            points: points as f64,
            inflation: e.spread.whiteness.inflation,
            portmanteau: e.spread.whiteness.portmanteau,
        }
    }
}

/// Figures of a record, from which features are computed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// `None` if the stem never moved or no fit was made.
    pub fit: Option<FitFigures>,
    /// Standard deviation of the set point over PV's, at most 2.
    pub setpoint_share: f64,
    /// PV lies on straight lines between stored values.
    pub interpolated: bool,
    /// Scores of [`detect::ALL`]; `None` for a sign that the record does not show.
    pub detectors: [Option<f64>; detect::ALL.len()],
}

impl Figures {
    /// The figures of a record and its fit. `view` must belong to the record.
    #[must_use]
    pub(crate) fn of(estimate: Option<&Estimate>, record: &Record, view: &View, interpolated: bool) -> Self {
        let without_fit = Self::without_fit(record, &record.pv, view, interpolated, |_| true);
        estimate.map_or(without_fit, |e| without_fit.with_fit(FitFigures::of(e, record.len())))
    }

    /// Figures of set point and detectors, for a PV that may differ from the record's; `view` must be made from that PV. Only
    /// detectors that are `asked` for are computed. If PV is `interpolated`, its corners come from the historian, so the
    /// detector of jumps is left out.
    #[must_use]
    pub(crate) fn without_fit(
        record: &Record,
        pv: &[f64],
        view: &View,
        interpolated: bool,
        asked: impl Fn(&str) -> bool,
    ) -> Self {
        let moved = record.sp.as_deref().map_or(0.0, stats::std_dev) / stats::std_dev(pv);
        let score = |d: &dyn detect::Detector| {
            let used = asked(d.name()) && !(interpolated && d.name() == JUMPS);
            if used { d.score(view) } else { None }
        };
        Self {
            fit: None,
            setpoint_share: if moved.is_finite() { moved.min(MOST_SETPOINT) } else { 0.0 },
            interpolated,
            detectors: detect::ALL.map(score),
        }
    }

    /// The same figures with a fit added.
    #[must_use]
    pub(crate) fn with_fit(&self, fit: FitFigures) -> Self {
        Self { fit: Some(fit), ..*self }
    }

    /// The features computed from these figures; detector scores are copied.
    ///
    /// | feature | means |
    /// |---|---|
    /// | `likelihood` | `ln(1 + n/2 ln(1 / (1 - index)))`, n the independent points: the logarithm of how much likelier the record is with friction than without; less, by the factor `1 / (1 + (Q / 45.3)^2)`, if the statistic Q of Ljung and Box (1978) over 20 lags shows that the residual is not white; 0 without a fit |
    /// | `confirmed` | the stiction index, less where s is under a fifth of OP's span, where the stem turned less than 12 times while the set point hardly moved (few turns can be an accident), and where OP is an image of PV (`horch` below 0.5: the fit may be of the controller); 0 without a fit |
    ///
    /// Neither is computed for a PV on straight lines: any model follows what the historian drew between two stored values, so
    /// an index near 1 proves nothing.
    #[must_use]
    pub fn features(&self) -> Features {
        let mut out = Features::default();
        let (of_fit, of_detectors) = out.0.split_at_mut(OF_THE_FIT.len());
        of_detectors.copy_from_slice(&self.detectors);
        if !self.interpolated {
            let fit = self.fit.as_ref();
            let made = [fit.map_or(0.0, likelihood), fit.map_or(0.0, |fit| self.confirmed(fit))];
            of_fit.copy_from_slice(&made.map(Some));
        }
        out
    }

    fn confirmed(&self, fit: &FitFigures) -> f64 {
        let horch = detect::ALL.iter().zip(self.detectors).find(|(d, _)| d.name() == HORCH);
        let horch = horch.and_then(|(_, score)| score).unwrap_or(0.0);
        let index = fit.index * (fit.s_over_span / FULL_WEIGHT).min(1.0);
        let tried = (fit.reversals / MANY_REVERSALS).max(self.setpoint_share).min(1.0);
        index * tried * (horch / HALF_ODD).min(1.0)
    }
}

fn likelihood(fit: &FitFigures) -> f64 {
    let gain = -0.5 * libm::log((1.0 - fit.index).max(LEAST_ERROR)) * fit.points / fit.inflation.max(1.0);
    // Not gain.max(0.0): for -0.0 its sign depends on the build, and documents contain it.
    let gain = if gain > 0.0 { gain } else { 0.0 };
    let coloured = fit.portmanteau / PORTMANTEAU;
    libm::log1p(gain) / (1.0 + coloured * coloured)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn figures(fit: Option<FitFigures>, interpolated: bool) -> Figures {
        let mut detectors = [None; detect::ALL.len()];
        detectors[0] = Some(0.25);
        Figures { fit, setpoint_share: 0.0, interpolated, detectors }
    }

    #[test]
    fn features_of_the_fit_are_zero_without_one_and_absent_on_straight_lines() {
        let fit = FitFigures {
            index: 1.0,
            s_over_span: 0.1,
            reversals: 6.0,
            points: 200.0,
            inflation: 2.0,
            portmanteau: 0.0,
        };
        let found = figures(Some(fit), false).features();
        // Half for the small s, half for six reversals, half for the odd part.
        assert_eq!((found.get(HORCH), found.get("confirmed")), (Some(0.25), Some(0.125)));
        assert!((found.get("likelihood").unwrap() - libm::log1p(-50.0 * libm::log(LEAST_ERROR))).abs() < 1e-12);
        assert_eq!(figures(None, false).features().get("confirmed"), Some(0.0));
        let drawn = figures(Some(fit), true).features();
        assert_eq!((drawn.get("confirmed"), drawn.get(HORCH)), (None, Some(0.25)));
        assert_eq!((found.without_fit(), found.get("other")), (drawn, None));
    }

    #[test]
    fn detectors_that_features_need_have_their_names() {
        assert!([HORCH, JUMPS].into_iter().all(|name| detect::ALL.iter().any(|d| d.name() == name)));
    }
}
