//! All that a diagnosis found, and the decision that is made from it.

use super::decide::{self, Decision};
use super::effects;
use super::evidence::{Basis, Evidence};
use super::model::Model;
use super::neighbour::Load;
use super::probability::{Calibration, Features};
use super::sizes::share_left;
use super::types::{
    Alternative, Blocks, Cause, Compared, EffectResult, Ended, Fit, Floor, Forward, FromSp, NONE, NextTest,
    NoiseModels, Predictions, Signature, Stages, UNKNOWN,
};

/// All that was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Diagnosis {
    /// The base, refitted.
    pub base: Fit,
    /// The base, and the base with the cause where a search or a replay fitted that, on all of the record: what the budget begins from.
    /// Nothing was held out, so that their errors and gaps say nothing.
    pub fits_to_all: Vec<Fit>,
    /// The given model as it was given.
    pub given: Option<Fit>,
    /// Gap of the base over PV's standard deviation.
    pub relative_gap: f64,
    /// Every effect asked, best first.
    pub effects: Vec<EffectResult>,
    /// The answer.
    pub cause: Cause,
    /// What is named beside it.
    pub second: Option<Alternative>,
    /// Other answers, best first.
    pub alternatives: Vec<Alternative>,
    /// Forward in time; `None` where the parts are too short.
    pub forward: Option<Forward>,
    /// The closed loop from SP alone; `None` where SP hardly moves or no controller can be read.
    pub from_sp: Option<FromSp>,
    /// The base with the cause, or the base itself.
    pub model_after: Model,
    /// Effects tried two at once, best first; empty where one alone explains the record, unless asked for.
    pub pairs: Vec<EffectResult>,
    /// Model responses computed.
    pub evaluations: u64,
    /// Responses that each search was allowed.
    pub budget_evaluations: u64,
    /// Why the search for base and effects ended.
    pub ended: Ended,
    /// Whether executor or budget ended the search before its time.
    pub stopped_early: bool,
    /// The noise floor.
    pub floor: Floor,
    /// Which points count for what.
    pub blocks: Blocks,
    /// Free runs for the record's points.
    pub predictions: Predictions,
    /// Traces in the data itself.
    pub signatures: Vec<Signature>,
    /// Noise models of the residual.
    pub noise_models: NoiseModels,
    /// The gaps apart, where MV is recorded.
    pub stages: Option<Stages>,
    /// The next test, where two answers remain.
    pub next_test: Option<NextTest>,
    /// What else the decision was made from.
    pub basis: Basis,
    /// Comparison with other loops, where some were offered.
    pub neighbours: Option<Compared>,
    /// Signals of other loops that may act on PV.
    pub loads: Vec<Load>,
    /// What the cause's probability was made of, for calibrations.
    pub features: Features,
}

impl Diagnosis {
    /// What the decision is made from.
    #[must_use]
    pub fn evidence(&self) -> Evidence {
        Evidence::new(&self.basis, self.effects.iter().chain(&self.pairs), self.floor.noise_floor)
    }

    /// The same fits judged again as if the catalogue lacked `ids` as well.
    #[must_use]
    pub fn without(&self, ids: &[&str]) -> Self {
        let mut again = self.clone();
        again.settle(ids);
        if again.cause.id != self.cause.id {
            again.drop_runs_of_cause();
        }
        again.confirm();
        again
    }

    /// Drops what was computed for one cause, where another is named now.
    pub(super) fn drop_runs_of_cause(&mut self) {
        self.forward = None;
        self.from_sp = self.from_sp.map(|from_sp| FromSp { after_pct: None, ..from_sp });
        self.next_test = None;
    }

    /// Whether the base, with the named cause where there is one, follows held-out PV worse than PV's mean does: nothing can be
    /// judged from it.
    #[must_use]
    pub fn is_worse_than_mean(&self) -> bool {
        let (given, closed) = (self.given.as_ref().map(|given| given.gap), self.named().and_then(|e| e.closed_pct));
        share_left(self.relative_gap, self.base.gap, given, closed) > 1.0
    }

    /// The result of the named cause, single or pair.
    #[must_use]
    pub fn named(&self) -> Option<&EffectResult> {
        self.effects.iter().chain(&self.pairs).find(|e| e.id == self.cause.id)
    }

    /// The cause, or what is named beside it where the cause is what the recorder did: its fit went through the recorder.
    fn acts(&self) -> &str {
        let under_trace = self.second.as_ref().filter(|_| self.basis.traces.contains(&self.cause.id));
        under_trace.map_or(&self.cause.id, |s| &s.id)
    }

    /// Whether what is named, if anything is, leaves more than noise, so that two effects may be at work.
    pub(super) fn leaves_more(&self) -> bool {
        if self.cause.id == NONE || self.base.at_floor {
            return false;
        }
        // What a trace in PV tells is not put to the vote.
        let ranked = self.named().is_none_or(|e| e.simulated);
        let over = |e: &EffectResult| Some(e.fit.as_ref()?.rmse_train / self.floor.noise_floor?);
        ranked && !self.effects.iter().filter(|e| e.simulated).filter_map(over).any(|over| over < decide::EXPLAINED)
    }

    /// Decides from its own evidence.
    pub(super) fn settle(&mut self, without: &[&str]) {
        self.follow(decide::decide(&self.evidence(), without, Calibration::shipped()));
    }

    /// Takes a decision, and lets everything that follows from its cause follow it.
    pub(super) fn follow(&mut self, decision: Decision) {
        (self.cause, self.second) = (decision.cause, decision.second);
        (self.alternatives, self.features) = (decision.alternatives, decision.features);
        let after = self.effects.iter().chain(&self.pairs).find(|e| e.id == self.acts()).and_then(|e| e.fit.clone());
        let from = self.blocks.from;
        let run = |f: &Fit, masked: &[bool]| -> Vec<Option<f64>> {
            let points = f.prediction.iter().enumerate();
            points.map(|(k, p)| (k >= from && !masked[k]).then_some(*p)).collect()
        };
        let masked = &self.predictions.masked;
        self.predictions.pv_base = run(&self.base, masked);
        self.predictions.pv_after = run(after.as_ref().unwrap_or(&self.base), masked);
        self.model_after = after.map_or_else(|| self.base.model.clone(), |f: Fit| -> Model { f.model });
    }

    /// Whether held-out blocks and the run forward bear the cause out.
    pub(super) fn confirm(&mut self) {
        let is_judged = !self.is_worse_than_mean();
        if self.cause.id == NONE || self.cause.id == UNKNOWN {
            self.cause.confirmed = self.cause.id == NONE && self.base.at_floor && is_judged;
            return;
        }
        let forward = self.forward.map(|f| [f.gap_before, f.gap_after]);
        // A trace is there; whether it makes the gap, is for held-out blocks to say where a free run can follow it.
        let closes = self.named().and_then(|e| e.closed_pct).is_none_or(|closed| closed > 0.0);
        let trace = closes && self.signatures.iter().any(|s| s.met && s.id == self.cause.id);
        let own = self.named().is_some_and(|e| decide::confirmed(e, forward));
        let acts = self.basis.acts.as_ref() == Some(&self.cause.id);
        let shows = trace || own || acts || self.cause.id == effects::time_skew::EFFECT.id;
        self.cause.confirmed = shows && is_judged;
    }
}

#[cfg(test)]
mod tests {
    use super::super::{GapOptions, Serial, diagnose};
    use crate::record::Record;
    use crate::sim::noise::Noise;

    #[test]
    fn nothing_is_confirmed_from_a_base_that_is_worse_than_the_mean() {
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
        found.effects.iter_mut().for_each(|e| e.closed_pct = Some(20.0));
        let confirmed = [1.0, 1.5].map(|relative_gap| {
            found.relative_gap = relative_gap;
            found.confirm();
            found.cause.confirmed
        });
        assert_eq!(confirmed, [true, false]);
    }
}
