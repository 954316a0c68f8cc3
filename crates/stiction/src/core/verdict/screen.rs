//! Screening: a calm loop gets its verdict without a fit.
//!
//! Most windows of most plants come from loops that do not oscillate and have a constant set point. If PV also has no jumps and
//! no simulated stem predicts PV better than OP does, a full assessment would end at `not_oscillating` after about a hundred
//! times the work. Such a window gets that verdict at once. Values that were not computed, such as the probability, are null,
//! and `reason` is `screened`.

use super::document::{Assessment, Gate, Verdict};
use super::features::Features;
use super::rule::Rule;
use crate::core::detect::calm;
use crate::core::detect::oscillation::{Looks, Oscillates};
use crate::core::record::Record;
use crate::core::signal::stats;

/// `reason` of a screened window.
pub const SCREENED: &str = "screened";

/// Largest spread of the set point, relative to PV's, that counts as constant.
const RESTS: f64 = 0.02;
/// Regularity and persistence of a signal from which the two together may be an oscillation; the second is half of what an
/// oscillation needs.
const REGULAR: f64 = 1.0;
const PERSISTENT: f64 = 0.1;
/// Largest signs of a sticking valve that pass, see [`calm::Signs`]. Of 560 simulated and real loops that do not oscillate,
/// three that the rule does not call healthy show less than 0.055 and 3.3, but none of them less than 0.005 and 1.6; noise
/// alone shows stems up to 6. Of 220 others, on which these two were not chosen, one that the rule calls sticking at p = 0.54
/// is screened out: it has no jumps, and no stem predicts better than OP.
const JUMPS: f64 = 0.04;
const STEM: f64 = 1.0;
/// Span of OP over its noise's standard deviation up to which OP is noise only (for white noise the ratio is five), so that no
/// travel of a stem can be seen; the next is the largest sign of a stem in that case. Both were chosen on these: of 220
/// simulated loops that do not oscillate, one that the rule does not call healthy has so narrow an OP, and its stem shows 48;
/// of the 19 healthy ones 17 show less than 12.
const NOISE_SPAN: f64 = 12.0;
const STEM_IN_NOISE: f64 = 15.0;
/// The same for a signal on a coarse grid, which hides small travel of a stem. Chosen on 3,334 simulated loops with grids of
/// 0.3 to 0.6 standard deviations: with the two above, 2 of 334 that are screened out would not have been called healthy, with
/// these none of 210.
const ON_GRID: [f64; 2] = [9.0, 6.0];

/// Whether a record without a blocking check can be screened.
#[must_use]
pub fn is_screened_out(record: &Record, looks: &Looks, gates: &[Gate]) -> bool {
    let Some(most) = most_of_a_stem(record, gates) else { return false };
    !looks.together().is_some_and(|o| o.oscillating)
        && rests(record)
        && !may_oscillate(looks.op)
        && !may_oscillate(looks.pv)
        && calm::signs(record, looks.typical_period).is_some_and(|s| s.jumps <= JUMPS && s.stem <= most)
}

/// Largest sign of a stem at which no stem is detected; `None` behind a gate that hides it: a moving set point excites the
/// loop, and rounding hides the travel of a stem.
fn most_of_a_stem(record: &Record, gates: &[Gate]) -> Option<f64> {
    let op = record.op();
    let within = |spans: f64| stats::span(&op) <= spans * stats::noise_sd(&op);
    if gates.contains(&Gate::SetpointSteps) {
        return None;
    }
    if gates.contains(&Gate::Quantised) {
        return within(ON_GRID[0]).then_some(ON_GRID[1]);
    }
    Some(if within(NOISE_SPAN) { STEM_IN_NOISE } else { STEM })
}

fn rests(record: &Record) -> bool {
    let moved = record.sp.as_deref().map_or(0.0, stats::std_dev);
    moved <= RESTS * stats::std_dev(&record.pv)
}

fn may_oscillate(of: Option<Oscillates>) -> bool {
    of.is_some_and(|o| o.regularity > REGULAR && o.persistence > PERSISTENT)
}

/// The assessment of a screened window; `whole` holds oscillation, checks and evidence.
pub(crate) fn answer(whole: Assessment) -> Assessment {
    let verdict = Verdict::NotOscillating;
    Assessment {
        verdict,
        stiction: verdict.stiction(),
        reason: Some(SCREENED),
        indicators: Rule::shipped().indicators(&Features::default()),
        ..whole
    }
}
