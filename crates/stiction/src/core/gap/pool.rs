//! Several windows of one valve: each is diagnosed by itself, and one decision is made from the evidence of all. Level, start and
//! disturbance stay each window's own.

use serde::{Deserialize, Serialize};

use super::calibration::Calibration;
use super::decide::{Decision, decide, holds_out};
use super::evidence::Evidence;
use super::judged::Diagnosis;
use super::types::Cause;
pub use super::types::PoolError;
use crate::core::record::Record;
use crate::core::units::Moment;

/// What a window adds to a decision from several.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Window {
    /// Where it comes from, for messages and documents.
    pub source: String,
    /// Timestamp of its first sample, ns since 1970.
    pub start_ns: i64,
    /// Timestamp of its last sample, ns since 1970.
    pub end_ns: i64,
    /// Raw samples.
    pub samples: u64,
    /// The answer of this window alone.
    pub cause: String,
    /// Its probability.
    pub probability: f64,
    /// What that was decided from.
    pub evidence: Evidence,
}

impl Window {
    /// A diagnosed record.
    #[must_use]
    pub fn of(source: &str, record: &Record, alone: &Diagnosis) -> Self {
        Self {
            source: source.to_owned(),
            start_ns: record.start_ns,
            end_ns: record.end_ns,
            samples: record.raw_samples as u64,
            cause: alone.cause.id.clone(),
            probability: alone.cause.probability,
            evidence: alone.evidence(),
        }
    }

    fn note(&self, shown: bool) -> WindowNote {
        WindowNote {
            source: self.source.clone(),
            start_ns: self.start_ns,
            end_ns: self.end_ns,
            start: Moment(self.start_ns),
            end: Moment(self.end_ns),
            samples: self.samples,
            cause: self.cause.clone(),
            probability: self.probability,
            shown,
        }
    }
}

/// A window as documents have it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct WindowNote {
    /// Its file, or another name.
    pub source: String,
    /// Timestamp of its first sample, ns since 1970.
    pub start_ns: i64,
    /// Timestamp of its last sample, ns since 1970.
    pub end_ns: i64,
    /// The start, RFC 3339.
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub start: Moment,
    /// The end, RFC 3339.
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub end: Moment,
    /// Raw samples.
    pub samples: u64,
    /// The answer of this window alone.
    pub cause: String,
    /// Its probability.
    pub probability: f64,
    /// Whether the document's model, effects and pictures are of this window.
    pub shown: bool,
}

/// The decision from several windows.
#[derive(Debug, Clone, PartialEq)]
pub struct Together {
    decision: Decision,
    /// The cause.
    pub cause: Cause,
    /// Place of the window that shows it best.
    pub clearest: usize,
}

/// Decides from the evidence of all windows.
///
/// # Errors
/// Fewer than two windows.
pub fn decide_together(windows: &[Window]) -> Result<Together, PoolError> {
    if windows.len() < 2 {
        return Err(PoolError::Single);
    }
    // Sums round by the order of their terms.
    let mut in_time: Vec<&Window> = windows.iter().collect();
    in_time.sort_by(|a, b| (a.start_ns, &a.source).cmp(&(b.start_ns, &b.source)));
    let each: Vec<&Evidence> = in_time.iter().map(|w| &w.evidence).collect();
    let decision = decide(&each, Calibration::shipped());
    let mut cause = decision.cause.clone();
    cause.confirmed = holds_out(&each, &cause.id);
    let clearest = clearest(windows, &cause.id);
    Ok(Together { decision, cause, clearest })
}

/// The windows as documents have them.
#[must_use]
pub fn notes(windows: &[Window], shown: usize) -> Vec<WindowNote> {
    windows.iter().enumerate().map(|(at, window)| window.note(at == shown)).collect()
}

impl Diagnosis {
    /// This window's diagnosis with the answer of several, of which it is one.
    #[must_use]
    pub fn with_answer_of(&self, together: &Together) -> Self {
        Self { cause: together.cause.clone(), ..self.with_decision(together.decision.clone()) }
    }
}

/// The window whose own answer is the answer of all with the highest probability, else the one in which that effect leads most.
fn clearest(windows: &[Window], cause: &str) -> usize {
    let rank = |w: &Window| {
        let own = if w.cause == cause { w.probability } else { 0.0 };
        let tried = w.evidence.contenders.iter().find(|c| c.id == cause);
        (own, tried.map_or(f64::NEG_INFINITY, |c| c.lead))
    };
    let by_rank = |x: &(f64, f64), y: &(f64, f64)| x.0.total_cmp(&y.0).then(x.1.total_cmp(&y.1));
    (0..windows.len()).rev().max_by(|i, j| by_rank(&rank(&windows[*i]), &rank(&windows[*j]))).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::super::decide::tests::{basis, contender};
    use super::super::evidence::Basis;
    use super::*;
    use crate::core::gap::UNKNOWN;

    #[test]
    fn the_order_of_windows_changes_nothing() {
        let acting = Basis { acts: Some("neighbour(F7)".to_owned()), ..basis(&["outliers"]) };
        let window = |(k, basis): (usize, Basis)| Window {
            source: format!("{k}.csv"),
            start_ns: k as i64,
            end_ns: k as i64 + 1,
            samples: 900,
            cause: UNKNOWN.to_owned(),
            probability: 0.5,
            evidence: Evidence { basis, contenders: vec![contender("ramp", 0.1 + 0.01 * k as f64, 0.0)] },
        };
        let mut windows: Vec<Window> = [acting, basis(&[]), basis(&[])].into_iter().enumerate().map(window).collect();
        let said = |windows: &[Window]| {
            let Together { decision, cause, clearest } = decide_together(windows).unwrap();
            (decision, cause, windows[clearest].source.clone())
        };
        let first = said(&windows);
        assert_eq!(first.1.id, "ramp", "what one window has of a recorder or a neighbour may be chance");
        for turn in 0..3 {
            windows.rotate_left(1);
            assert_eq!(said(&windows), first);
            windows.swap(0, 1);
            assert_eq!(said(&windows), first, "{turn}");
        }
    }
}
