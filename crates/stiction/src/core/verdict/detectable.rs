//! Detection limit: the smallest band that a window would have shown.

use super::features::{Figures, FitFigures};
use super::rule::Rule;
use crate::core::detect::View;
use crate::core::ident::hypothetical::Hypothetical;
use crate::core::ident::{Estimate, Options};
use crate::core::record::Record;

/// Probability from which a band counts as detected.
const SEEN: f64 = 0.9;
/// Slip jump j of the hypothetical valve, as a share of s.
const JUMP: f64 = 0.3;
/// Smallest and largest band tested, spans of OP.
const BANDS: [f64; 2] = [0.02, 1.0];
/// Bands on the grid, evenly spaced in logarithm.
const GRID: usize = 8;
/// Bisection steps (in logarithm) between two neighbours on the grid.
const HALVINGS: usize = 3;

/// The smallest s, OP units, that would have been found in this window with a probability of at least 0.9; `None` if no band
/// up to OP's span would have been.
///
/// Evaluates the shipped classifier on the window with hypothetical valves of He's model with j = 0.3 s, see
/// [`Hypothetical`]. Eight values of s from 0.02 of OP's span to the full span are bisected three times, then the remaining
/// interval three more times, assuming that a larger band is easier to see as long as the stem moves. The fit gets the true
/// bands and start, so failures of the search are not included; nor is the reaction of OP. One-step prediction is evaluated
/// for stems of nearby bands only, so its value is a lower bound.
pub(super) fn smallest(
    record: &Record,
    view: &View,
    options: &Options,
    estimate: &Estimate,
    interpolated: bool,
) -> Option<f64> {
    let window = Window::new(record, view, options, estimate, interpolated)?;
    let share = |place: f64| BANDS[0] * libm::pow(BANDS[1] / BANDS[0], place / (GRID - 1) as f64);
    // Indices on the grid: one below all bands, one above all.
    let (mut unseen, mut high, mut found) = (-1.0, GRID as f64, false);
    while high - unseen > 1.0 {
        let middle = (0.5 * (unseen + high)).floor();
        match window.shows(share(middle)) {
            Some(false) => unseen = middle,
            // The band is too large if the stem hardly moves.
            seen => (high, found) = (middle, seen.is_some()),
        }
    }
    if !found {
        return None;
    }
    for _ in 0..HALVINGS {
        let middle = 0.5 * (unseen + high);
        if window.shows(share(middle)) == Some(true) { high = middle } else { unseen = middle }
    }
    Some(share(high) * window.hypothetical.span())
}

/// A window with all quantities that do not depend on the hypothetical valve.
struct Window<'a> {
    record: &'a Record,
    view: &'a View,
    estimate: &'a Estimate,
    hypothetical: Hypothetical<'a>,
    interpolated: bool,
}

impl<'a> Window<'a> {
    fn new(
        record: &'a Record,
        view: &'a View,
        options: &Options,
        estimate: &'a Estimate,
        interpolated: bool,
    ) -> Option<Self> {
        let hypothetical = Hypothetical::new(record, options, estimate)?;
        Some(Self { record, view, estimate, hypothetical, interpolated })
    }

    /// Whether the classifier detects a valve with a band of `share` spans; `None` if the stem hardly moves.
    fn shows(&self, share: f64) -> Option<bool> {
        let s = share * self.hypothetical.span();
        let valve = self.hypothetical.valve(s, JUMP * s)?;
        let view = View::beside(&self.view.output, &valve.pv, Some(share));
        // Features without weight need not be computed.
        let counts = |name: &str| Rule::shipped().names().any(|n| n == name);
        let without_fit = Figures::without_fit(self.record, &valve.pv, &view, self.interpolated, counts);
        // Noise and disturbances are the recorded ones, and so is the residual of a fit.
        let left = &self.estimate.spread.whiteness;
        let p = |index: f64| {
            let fit = FitFigures {
                index,
                s_over_span: valve.s_over_span,
                reversals: valve.reversals as f64,
                points: self.record.len() as f64,
                inflation: left.inflation,
                portmanteau: left.portmanteau,
            };
            Rule::shipped().opinion(&without_fit.with_fit(fit).features()).p()
        };
        // Most small bands would stay undetected even with a perfect fit; then the fit can be skipped.
        Some(p(1.0) >= SEEN && p(self.hypothetical.index(&valve)) >= SEEN)
    }
}
