//! The smallest band that a window would have shown.

use super::rule::{self, Rule};
use crate::detect;
use crate::ident::imagine::Imagination;
use crate::ident::{Estimate, Options};
use crate::record::Record;

/// Probability from which a band counts as seen.
const SEEN: f64 = 0.9;
/// Share of s that is slip jump in the imagined valve.
const JUMP: f64 = 0.3;
/// Smallest and largest band looked at, spans of OP.
const BANDS: [f64; 2] = [0.02, 1.0];
/// Bands on the grid, evenly spaced in logarithm.
const GRID: usize = 8;
/// Halvings (in logarithm) between two neighbours on the grid.
const HALVINGS: usize = 3;

/// The smallest s, OP units, that would have been found in this window with a probability of at least 0.9; `None` where
/// no band up to OP's span would have been.
///
/// Asks the shipped rule about the window behind imagined valves of He's law with j = 0.3 s, see [`Imagination`]: s from
/// 0.02 of OP's span up to the span, the first of 8 steps that is seen and whose next one is seen too (or moves the stem
/// too seldom), then three halvings. The valve's own bands and start are given to the fit, so what the search would
/// have missed is not in it; nor is that OP would have answered.
pub(super) fn smallest(
    record: &Record,
    options: &Options,
    estimate: &Estimate,
    sticks: bool,
    interpolated: bool,
) -> Option<f64> {
    let imagination = Imagination::new(record, options, estimate, sticks)?;
    let seen = |share: f64| is_seen(record, &imagination, estimate, share, interpolated);
    let ratio = libm::pow(BANDS[1] / BANDS[0], 1.0 / (GRID - 1) as f64);
    let mut unseen = BANDS[0] / ratio;
    let mut first: Option<f64> = None;
    let mut share = BANDS[0];
    for _ in 0..GRID {
        match (seen(share), first) {
            (Some(true), None) => first = Some(share),
            (Some(true), Some(_)) => break,
            (Some(false), _) => (unseen, first) = (share, None),
            (None, _) => break,
        }
        share *= ratio;
    }
    let mut high = first?;
    for _ in 0..HALVINGS {
        let middle = (unseen * high).sqrt();
        if seen(middle) == Some(true) { high = middle } else { unseen = middle }
    }
    Some(high * imagination.span())
}

/// Whether the rule sees a valve with a band of `share` spans; `None` where the stem hardly moves.
fn is_seen(
    record: &Record,
    imagination: &Imagination<'_>,
    estimate: &Estimate,
    share: f64,
    interpolated: bool,
) -> Option<bool> {
    let s = share * imagination.span();
    let mut valve = imagination.valve(s, JUMP * s)?;
    let record = Record { pv: core::mem::take(&mut valve.pv), ..record.clone() };
    let without_fit = rule::figures(None, &record, &detect::ALL, interpolated);
    let p = |index: f64| {
        let mut figures = without_fit.clone();
        // Noise and disturbances are those at hand, and so is what a fit leaves of them.
        let left = &estimate.spread.whiteness;
        figures.extend(rule::of_fit(index, valve.s_over_span, valve.reversals, left, record.len()));
        Rule::shipped().opinion(&rule::features(figures)).p()
    };
    // Most small bands are not seen even were the fit perfect; then there is no need for it.
    Some(p(1.0) >= SEEN && p(imagination.index(&valve)) >= SEEN)
}
