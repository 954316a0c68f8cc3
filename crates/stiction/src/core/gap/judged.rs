//! What a diagnosis found, what is named for it, and what was computed for that name.

use super::agree::is_physical;
use super::calibration::Calibration;
use super::decide::{self, Decision};
use super::effects;
use super::evidence::{Basis, Evidence};
use super::model::Model;
use super::neighbour::Load;
use super::sizes::share_left;
use super::types::{
    Alternative, Blocks, Cause, Compared, EffectNote, Fit, Floor, Forward, FromSp, NONE, NextTest, Predictions,
    SearchNote, Signature, Stages, UNKNOWN,
};

/// What was found of a record, before anything is named.
#[derive(Debug, Clone, PartialEq)]
pub struct Findings {
    /// The base, refitted.
    pub base: Fit,
    /// The given model as it was given.
    pub given: Option<Fit>,
    /// Gap of the base over PV's standard deviation.
    pub relative_gap: f64,
    /// Every effect asked, best first.
    pub effects: Vec<EffectNote>,
    /// Effects tried two at once, best first; empty where one alone explains the record, unless asked for.
    pub pairs: Vec<EffectNote>,
    /// The noise floor.
    pub floor: Floor,
    /// Which points count for what.
    pub blocks: Blocks,
    /// Traces in the data itself.
    pub signatures: Vec<Signature>,
    /// The gaps apart, where MV is recorded.
    pub stages: Option<Stages>,
    /// What else the decision is made from.
    pub basis: Basis,
    /// Comparison with other loops, where some were offered.
    pub neighbours: Option<Compared>,
    /// Signals of other loops that may act on PV.
    pub loads: Vec<Load>,
}

impl Findings {
    /// What the decision is made from.
    #[must_use]
    pub fn evidence(&self) -> Evidence {
        Evidence::new(&self.basis, self.effects.iter().chain(&self.pairs), self.floor.noise_floor)
    }

    /// The decision.
    #[must_use]
    pub(super) fn decide(&self) -> Decision {
        decide::decide(&[&self.evidence()], Calibration::shipped())
    }

    /// The result of an effect or pair.
    pub(super) fn result(&self, id: &str) -> Option<&EffectNote> {
        self.effects.iter().chain(&self.pairs).find(|e| e.id == id)
    }

    /// Whether a decision leaves more than noise, so that two effects may be at work.
    pub(super) fn leaves_more(&self, decision: &Decision) -> bool {
        let cause = &decision.cause.id;
        if cause == NONE || self.base.at_floor {
            return false;
        }
        // What a trace in PV tells is not put to the vote.
        let ranked = self.result(cause).is_none_or(|e| e.simulated);
        let over = |e: &EffectNote| Some(e.fit.as_ref()?.rmse_train / self.floor.noise_floor?);
        ranked && !self.effects.iter().filter(|e| e.simulated).filter_map(over).any(|over| over < decide::EXPLAINED)
    }

    /// Whether the base, with a cause where there is one, follows held-out PV worse than PV's mean does.
    fn is_worse_than_mean(&self, cause: &Cause) -> bool {
        let closed = self.result(&cause.id).and_then(|e| e.closed_pct);
        share_left(self.relative_gap, self.base.gap, self.given.as_ref().map(|given| given.gap), closed) > 1.0
    }

    /// Whether held-out blocks and the run forward bear a cause out.
    fn is_confirmed(&self, cause: &Cause, forward: Option<Forward>) -> bool {
        if self.is_worse_than_mean(cause) {
            return false;
        }
        if cause.id == NONE || cause.id == UNKNOWN {
            return cause.id == NONE && self.base.at_floor;
        }
        let result = self.result(&cause.id);
        let mut sizes = result.iter().flat_map(|e| &e.parameters);
        if sizes.any(|(name, q)| effects::parts(&cause.id).any(|id| !is_physical(id, name, q.value))) {
            return false;
        }
        // A trace is there; whether it makes the gap, is for held-out blocks to say where a free run can follow it.
        let closes = result.and_then(|e| e.closed_pct).is_none_or(|closed| closed > 0.0);
        let trace = closes && self.signatures.iter().any(|s| s.met && s.id == cause.id);
        let forward = forward.map(|f| [f.gap_before, f.gap_after]);
        let own = result.is_some_and(|e| decide::confirmed(e, forward));
        let acts = self.basis.acts.as_ref() == Some(&cause.id);
        trace || own || acts || cause.id == effects::time_skew::EFFECT.id
    }

    /// The fit of what acts on the plant: of the cause, or of what is named beside it where the cause is what the recorder
    /// did, whose fit went through the recorder.
    fn fit_of(&self, decision: &Decision) -> Option<&Fit> {
        let cause = &decision.cause.id;
        let under_trace = decision.second.as_ref().filter(|_| self.basis.traces.contains(cause));
        self.result(under_trace.map_or(cause, |s| &s.id))?.fit.as_ref()
    }

    /// A fit's free run where it counts.
    fn shown(&self, fit: &Fit) -> Vec<Option<f64>> {
        let points = fit.prediction.iter().enumerate();
        points.map(|(k, p)| (k >= self.blocks.from && !self.blocks.masked[k]).then_some(*p)).collect()
    }
}

/// What was computed for one cause.
#[derive(Debug, Clone, PartialEq)]
pub struct Runs {
    /// Forward in time; `None` where the parts are too short.
    pub forward: Option<Forward>,
    /// The closed loop from SP alone; `None` where SP hardly moves or no controller can be read.
    pub from_sp: Option<FromSp>,
    /// The next test, where two answers remain.
    pub next_test: Option<NextTest>,
    /// The base, and the base with the cause where a search fitted that, on all of the record: what the budget begins from.
    /// Nothing was held out, so that their errors and gaps say nothing.
    pub fits_to_all: Vec<Fit>,
}

impl Runs {
    /// Without what belongs to the cause alone.
    fn of_the_base(mut self) -> Self {
        self.fits_to_all.truncate(1);
        let from_sp = self.from_sp.map(|from_sp| FromSp { after_pct: None, ..from_sp });
        Self { forward: None, from_sp, next_test: None, ..self }
    }
}

/// All that was found, and the answer.
#[derive(Debug, Clone, PartialEq)]
pub struct Diagnosis {
    /// What the answer is made from.
    pub findings: Findings,
    /// The answer.
    pub cause: Cause,
    /// What is named beside it.
    pub second: Option<Alternative>,
    /// Other answers, best first.
    pub alternatives: Vec<Alternative>,
    /// The base with the cause, or the base itself.
    pub model_after: Model,
    /// Free runs for the record's points.
    pub predictions: Predictions,
    /// What was computed for the cause.
    pub runs: Runs,
    /// What the search spent.
    pub search: SearchNote,
    /// Whether executor or budget ended the search before its time.
    pub stopped_early: bool,
}

impl Diagnosis {
    pub(super) fn new(
        findings: Findings,
        decision: Decision,
        runs: Runs,
        (search, stopped_early): (SearchNote, bool),
    ) -> Self {
        let after = findings.fit_of(&decision).unwrap_or(&findings.base);
        let predictions = Predictions { pv_base: findings.shown(&findings.base), pv_after: findings.shown(after) };
        let model_after = after.model.clone();
        let Decision { mut cause, second, alternatives, .. } = decision;
        cause.confirmed = findings.is_confirmed(&cause, runs.forward);
        Self { findings, cause, second, alternatives, model_after, predictions, runs, search, stopped_early }
    }

    /// The same findings with another decision.
    #[must_use]
    pub(super) fn with_decision(&self, decision: Decision) -> Self {
        let runs = self.runs.clone();
        let runs = if decision.cause.id == self.cause.id { runs } else { runs.of_the_base() };
        Self::new(self.findings.clone(), decision, runs, (self.search, self.stopped_early))
    }

    /// What the decision is made from.
    #[must_use]
    pub fn evidence(&self) -> Evidence {
        self.findings.evidence()
    }

    /// Whether the base, with the named cause where there is one, follows held-out PV worse than PV's mean does: nothing can be
    /// judged from it.
    #[must_use]
    pub fn is_worse_than_mean(&self) -> bool {
        self.findings.is_worse_than_mean(&self.cause)
    }

    /// The result of the named cause, single or pair.
    #[must_use]
    pub fn named(&self) -> Option<&EffectNote> {
        self.findings.result(&self.cause.id)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{GapOptions, Serial, diagnose};
    use super::*;
    use crate::core::record::Record;
    use crate::core::sim::noise::Noise;

    #[test]
    fn another_cause_has_its_own_runs_and_nothing_is_confirmed_from_a_base_worse_than_the_mean() {
        let turn = |k: usize, period: f64| libm::sin(2.0 * core::f64::consts::PI * k as f64 / period);
        let (mut noise, mut stem) = (Noise::new(4, 1), 0.0);
        let op: Vec<f64> = (0..600).map(|k| 50.0 + 4.0 * turn(k, 60.0) + turn(k, 331.0)).collect();
        let follow = |(k, u): (usize, &f64)| {
            stem += 0.3 * (u - stem);
            stem + 2.0 * turn(k, 23.0) + 0.1 * noise.gaussian()
        };
        let pv = op.iter().enumerate().map(follow).collect();
        let mut found = diagnose(&Record::uniform(1.0, op, pv), &GapOptions::default(), &Serial).unwrap();
        assert!(found.cause.id == "sinusoid" && found.cause.confirmed, "{:?}", found.cause);
        // What was computed for one cause says nothing of another.
        let without = found.evidence().without("sinusoid");
        let another = found.with_decision(decide::decide(&[&without], Calibration::shipped()));
        assert!(found.runs.fits_to_all.len() == 2 && found.runs.forward.is_some());
        assert!(another.cause.id != "sinusoid" && another.runs.fits_to_all == found.runs.fits_to_all[..1]);
        assert!(another.runs.forward.is_none() && another.runs.next_test.is_none());
        let findings = &mut found.findings;
        findings.effects.iter_mut().for_each(|e| e.closed_pct = Some(20.0));
        let confirmed = [1.0, 1.5].map(|relative_gap| {
            findings.relative_gap = relative_gap;
            findings.is_confirmed(&found.cause, found.runs.forward)
        });
        assert_eq!(confirmed, [true, false]);
    }
}
