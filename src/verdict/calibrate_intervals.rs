//! Intervals against simulated truth: how often they hold, how wide they have to be.

use serde::{Deserialize, Serialize};

use crate::detect::oscillation;
use crate::ident::interval::Spread;
use crate::ident::{DelayChoice, ModelChoice, Options, ValveChoice, quantify};
use crate::sim::truth::{self, Half, Regime};

/// One simulated loop: what is true, what was estimated, what the likelihood says. OP units.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the loop's regime.
    pub regime: String,
    /// Seed of the loop.
    pub seed: u64,
    /// True s and j.
    pub truth: [f64; 2],
    /// Estimated s and j.
    pub found: [f64; 2],
    /// The likelihood's intervals.
    pub spread: Spread,
    /// Stiction index of the fit.
    pub index: f64,
    /// OP's span.
    pub span: f64,
    /// Model responses computed.
    pub evaluations: u64,
}

/// Fits one simulated loop, by the law that it obeys where it obeys one; `None` where the fit finds nothing.
#[must_use]
pub fn look(half: Half, regime: Regime, seed: u64) -> Option<Row> {
    let case = truth::accuracy(half, regime, seed);
    let record = case.record();
    let period_points = oscillation::detect(&record.op(), &record.pv).map(|o| o.period_points);
    let options = Options {
        model: ModelChoice::Auto,
        delay: DelayChoice::Auto,
        valve: match case.law {
            "he" => ValveChoice::He,
            "tracking" => ValveChoice::Tracking,
            _ => ValveChoice::Auto,
        },
        solver: "contour",
        fineness_pct: 1.0,
        seed,
        period_points,
    };
    let e = quantify(&record, &options)?;
    let regime = regime.name().to_owned();
    let (truth, found) = ([case.s?, case.j?], [e.s, e.j]);
    Some(Row { regime, seed, truth, found, spread: e.spread, index: e.index, span: e.span, evaluations: e.evaluations })
}
