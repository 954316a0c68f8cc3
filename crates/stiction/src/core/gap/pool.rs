//! Several windows of one valve: each is diagnosed by itself, and one decision is made from the evidence of all. Level, start and
//! disturbance stay each window's own.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use super::decide::{Decision, decide, holds_out};
use super::evidence::{Basis, Contender, Evidence, Left, OnMv};
use super::judged::Diagnosis;
use super::probability::Calibration;
pub use super::types::PoolError;
use super::types::{Alone, Cause, NONE, NoiseModels, UNKNOWN};
use crate::core::record::Record;
use crate::core::signal::stats;
use crate::core::units::Moment;

/// Windows in which a trace must stand: one may have it by chance.
const WITH_TRACE: usize = 2;

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
    let evidence = pooled(&in_time.iter().map(|w| &w.evidence).collect::<Vec<_>>());
    let decision = decide(&evidence, Calibration::shipped());
    let mut cause = decision.cause.clone();
    cause.confirmed = match cause.id.as_str() {
        NONE => evidence.basis.base_at_floor,
        UNKNOWN => false,
        _ => holds_out(&evidence, &cause),
    };
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

/// One evidence of all windows: gains are means, in nats a point; what one window may have by chance is a median or the majority's.
fn pooled(all: &[&Evidence]) -> Evidence {
    let ids: BTreeSet<&str> = all.iter().flat_map(|e| e.contenders.iter().map(|c| c.id.as_str())).collect();
    let of =
        |id: &str| -> Vec<&Contender> { all.iter().filter_map(|e| e.contenders.iter().find(|c| c.id == id)).collect() };
    let contenders = ids.into_iter().map(of).filter(|c| is_most(c.len(), all.len()));
    let bases: Vec<&Basis> = all.iter().map(|e| &e.basis).collect();
    Evidence { contenders: contenders.map(|c| contender(&c, all.len())).collect(), basis: basis(&bases) }
}

fn contender(of: &[&Contender], windows: usize) -> Contender {
    // A window in which an effect was not tried tells nothing for it.
    let mean = |value: &dyn Fn(&Contender) -> f64| of.iter().map(|c| value(c)).sum::<f64>() / windows as f64;
    let closed_pct = median(of.iter().filter_map(|c| c.closed_pct));
    let below = median(of.iter().filter_map(|c| Some(c.closed_pct? - c.closed_interval?[0])));
    let above = median(of.iter().filter_map(|c| Some(c.closed_interval?[1] - c.closed_pct?)));
    let narrow = (of.len() as f64).sqrt();
    Contender {
        id: of[0].id.clone(),
        stage: of[0].stage,
        raw_gain: mean(&|c| c.raw_gain),
        evidence: mean(&|c| c.evidence),
        lead: mean(&|c| c.lead),
        at_floor: is_most(of.iter().filter(|c| c.at_floor).count(), windows),
        closed_pct,
        closed_interval: closed_pct.zip(below).zip(above).map(|((c, b), a)| [c - b / narrow, c + a / narrow]),
        left: left(of.iter().map(|c| &c.left)),
    }
}

fn basis(of: &[&Basis]) -> Basis {
    let most = |is: &dyn Fn(&Basis) -> bool| is_most(of.iter().filter(|b| is(b)).count(), of.len());
    let mut counts: BTreeMap<&String, usize> = BTreeMap::new();
    of.iter().flat_map(|b| &b.traces).for_each(|trace| *counts.entry(trace).or_default() += 1);
    let mut traces: Vec<(&String, usize)> = counts.into_iter().filter(|(_, count)| *count >= WITH_TRACE).collect();
    traces.sort_by_key(|(_, count)| core::cmp::Reverse(*count));
    let closes = |trace: &String| median(of.iter().filter_map(|b| b.traces_close.get(trace).copied()));
    let alone: Vec<&Alone> = of.iter().filter_map(|b| b.alone.as_ref()).collect();
    Basis {
        traces_close: traces.iter().filter_map(|(trace, _)| Some(((*trace).clone(), closes(trace)?))).collect(),
        traces: traces.into_iter().map(|(trace, _)| trace.clone()).collect(),
        filter: most(&|b| b.filter),
        acts: most_common(of.iter().map(|b| b.acts.clone())),
        skew: median(of.iter().filter_map(|b| b.skew)).filter(|_| most(&|b| b.skew.is_some())),
        noise: models(of.iter().map(|b| &b.noise)),
        alone: is_most(alone.len(), of.len()).then(|| Alone {
            models: models(alone.iter().map(|a| &a.models)),
            tails: median(alone.iter().map(|a| a.tails)).unwrap_or(0.0),
        }),
        coloured_noise: most(&|b| b.coloured_noise),
        by_mv: most_common(of.iter().map(|b| b.by_mv)),
        on_mv: on_mv(of),
        base_at_floor: most(&|b| b.base_at_floor),
        base: left(of.iter().map(|b| &b.base)),
        excited: of.iter().any(|b| b.excited),
        linear: most(&|b| b.linear),
    }
}

/// What most windows have.
fn most_common<T: PartialEq>(of: impl ExactSizeIterator<Item = Option<T>>) -> Option<T> {
    let all: Vec<Option<T>> = of.collect();
    let count = |value: &Option<T>| all.iter().filter(|other| *other == value).count();
    let place = all.iter().position(|value| is_most(count(value), all.len()))?;
    all.into_iter().nth(place).flatten()
}

/// The ranking on MV by mean evidence, of what most windows ranked.
fn on_mv(of: &[&Basis]) -> Vec<OnMv> {
    let ids: BTreeSet<&String> = of.iter().flat_map(|b| b.on_mv.iter().map(|e| &e.id)).collect();
    let pooled = |id: &String| {
        let own: Vec<&OnMv> = of.iter().filter_map(|b| b.on_mv.iter().find(|e| e.id == *id)).collect();
        is_most(own.len(), of.len()).then(|| OnMv {
            id: id.clone(),
            evidence: own.iter().map(|e| e.evidence).sum::<f64>() / of.len() as f64,
            over_floor: median(own.iter().filter_map(|e| e.over_floor)),
        })
    };
    let mut out: Vec<OnMv> = ids.into_iter().filter_map(pooled).collect();
    out.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
    out
}

fn left<'e>(of: impl Iterator<Item = &'e Left> + Clone) -> Left {
    Left {
        over_floor: median(of.clone().filter_map(|l| l.over_floor)),
        colour: mean(of.clone().map(|l| l.colour)),
        with_op: mean(of.clone().map(|l| l.with_op)),
        fitted: [0, 1].map(|which| of.clone().map(|l| l.fitted[which]).sum()),
        one_step: core::array::from_fn(|order| [0, 1].map(|side| mean(of.clone().map(|l| l.one_step[order][side])))),
    }
}

fn models<'e>(of: impl Iterator<Item = &'e NoiseModels> + Clone) -> NoiseModels {
    NoiseModels {
        over_base: mean(of.clone().map(|m| m.over_base)),
        over_best: mean(of.clone().map(|m| m.over_best)),
        independence_p: median(of.clone().map(|m| m.independence_p)).unwrap_or(1.0),
        whitens: is_most(of.clone().filter(|m| m.whitens).count(), of.clone().count()),
        beyond_first: mean(of.map(|m| m.beyond_first)),
    }
}

const fn is_most(count: usize, of: usize) -> bool {
    2 * count > of
}

fn mean(x: impl Iterator<Item = f64>) -> f64 {
    stats::mean(&x.collect::<Vec<_>>())
}

fn median(x: impl Iterator<Item = f64>) -> Option<f64> {
    let all: Vec<f64> = x.collect();
    (!all.is_empty()).then(|| stats::median(&all))
}

#[cfg(test)]
mod tests {
    use super::super::decide::tests::{basis, contender};
    use super::*;
    use crate::core::gap::Stage;

    #[test]
    fn the_order_of_windows_changes_nothing() {
        let ranked = |id: &str, evidence: f64| OnMv { id: id.to_owned(), evidence, over_floor: Some(1.1) };
        let behind = |evidence: f64| Basis {
            by_mv: Some(Stage::Process),
            on_mv: vec![ranked("ramp", evidence), ranked("extra_lag", 0.1)],
            ..basis(&[])
        };
        let bases =
            [Basis { acts: Some("neighbour(F7)".to_owned()), ..basis(&["outliers"]) }, behind(0.7), behind(0.4)];
        let window = |(k, basis): (usize, Basis)| Window {
            source: format!("{k}.csv"),
            start_ns: k as i64,
            end_ns: k as i64 + 1,
            samples: 900,
            cause: UNKNOWN.to_owned(),
            probability: 0.5,
            evidence: Evidence { basis, contenders: vec![contender("ramp", 1.5, 0.3 + 0.1 * k as f64, 60.0)] },
        };
        let mut windows: Vec<Window> = bases.into_iter().enumerate().map(window).collect();
        let said = |windows: &[Window]| {
            let Together { decision, cause, clearest } = decide_together(windows).unwrap();
            (decision, cause, windows[clearest].source.clone())
        };
        let first = said(&windows);
        assert_eq!(first.1.id, "ramp", "most windows have it behind the valve position");
        for turn in 0..3 {
            windows.rotate_left(1);
            assert_eq!(said(&windows), first);
            windows.swap(0, 1);
            assert_eq!(said(&windows), first, "{turn}");
        }
    }
}
