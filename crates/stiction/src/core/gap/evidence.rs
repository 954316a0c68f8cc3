//! What a decision is made from, without the fits: diagnosing is dear and deciding is cheap, so answers to a challenge
//! keep this, and a calibration decides on it again.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::effects;
use super::express::above_floor;
use super::types::{Alone, EffectResult, Fit, NoiseModels, OneStep, Stage};
use super::weigh::NOTHING_LEFT;

/// An effect ranked with the recorded valve position in the place of OP.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OnMv {
    /// Its id.
    pub id: String,
    /// Its evidence, as the margin of most effects counts it.
    pub evidence: f64,
    /// Training error over the floor; `None` where there is no floor.
    pub over_floor: Option<f64>,
}

/// What a decision is made from beside the effects; everything in it is known without deciding.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Basis {
    /// Ids whose trace stands in PV, strongest first.
    pub traces: Vec<String>,
    /// Per cent of the gap that those close, where models were fitted, which a free run can follow.
    #[serde(default)]
    pub traces_close: BTreeMap<String, f64>,
    /// Whether PV's noise shares a lag of its signal.
    #[serde(default)]
    pub filter: bool,
    /// The other loop's load that the noise model has in both halves.
    #[serde(default)]
    pub acts: Option<String>,
    /// Points by which the recorded OP is off the PV that it answers, where the controller says so.
    pub skew: Option<f64>,
    /// Noise models of the residual.
    pub noise: NoiseModels,
    /// Of the base's place that is best one step ahead; `None` from versions that did not look.
    #[serde(default)]
    pub alone: Option<Alone>,
    /// Whether coloured noise may be named.
    pub coloured_noise: bool,
    /// The stage that MV points to.
    pub by_mv: Option<Stage>,
    /// Effects ranked on MV instead of OP, best first.
    pub on_mv: Vec<OnMv>,
    /// Whether the base is at the floor.
    pub base_at_floor: bool,
    /// The base's fit as a contender sees its own.
    pub base: Left,
    /// Whether the set point moves or OP's swings differ in size.
    pub excited: bool,
    /// Whether the base has no friction.
    pub linear: bool,
}

/// What a fit leaves of PV.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Left {
    /// Training error over the floor; `None` where there is no floor.
    pub over_floor: Option<f64>,
    /// See [`Fit::colour`].
    pub colour: f64,
    /// See [`Fit::with_op`].
    pub with_op: f64,
    /// Fitted points, and numbers fitted to them.
    #[serde(default)]
    pub fitted: [usize; 2],
    /// See [`Fit::one_step`].
    #[serde(default)]
    pub one_step: OneStep,
}

impl Left {
    /// Of a fit.
    #[must_use]
    pub(crate) fn of(fit: &Fit, floor: Option<f64>) -> Self {
        Self {
            over_floor: floor.map(|f| fit.rmse_train / f),
            colour: fit.colour,
            with_op: fit.with_op,
            fitted: [fit.points, fit.parameters],
            one_step: fit.one_step,
        }
    }
}

/// A simulated effect as the decision sees it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Contender {
    /// Its id.
    pub id: String,
    /// Where it acts.
    pub stage: Stage,
    /// See [`EffectResult::raw_gain`].
    pub raw_gain: f64,
    /// See [`EffectResult::evidence`].
    pub evidence: f64,
    /// See [`EffectResult::lead`].
    pub lead: f64,
    /// Whether its training error is at the floor.
    pub at_floor: bool,
    /// Per cent of the gap that it closes on held-out blocks, which have no say in the choice among effects.
    pub closed_pct: Option<f64>,
    /// Lower and upper end of its interval.
    pub closed_interval: Option<[f64; 2]>,
    /// What its fit leaves.
    pub left: Left,
}

impl Contender {
    /// Per cent of the gap that it closes where it was fitted; `None` where the base leaves no more than noise.
    #[must_use]
    pub(super) fn closes(&self, base: &Left) -> Option<f64> {
        let Some((before, after)) = base.over_floor.zip(self.left.over_floor) else {
            return Some(100.0 * (1.0 - libm::exp(-0.5 * self.raw_gain)));
        };
        let gap = |over: f64| above_floor(over, Some(1.0));
        (before >= NOTHING_LEFT).then(|| 100.0 * (1.0 - gap(after) / gap(before)))
    }
}

/// Everything.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Evidence {
    /// Beside the effects.
    pub basis: Basis,
    /// The simulated effects.
    pub contenders: Vec<Contender>,
}

impl Evidence {
    /// The same without what tells of an effect, for a calibration to learn from: a search without it may find more of the
    /// others.
    #[must_use]
    pub fn without(&self, id: &str) -> Self {
        let is_other = |of: &str| effects::parts(of).all(|part| effects::kind(part) != id);
        let mut seen = self.clone();
        seen.contenders.retain(|c| is_other(&c.id));
        let basis = &mut seen.basis;
        basis.traces.retain(|trace| is_other(trace));
        basis.on_mv.retain(|on_mv| is_other(&on_mv.id));
        basis.acts = basis.acts.take().filter(|acts| is_other(acts));
        basis.filter &= is_other(effects::sensor_filter::EFFECT.id);
        basis.coloured_noise &= is_other(effects::coloured_noise::EFFECT.id);
        basis.skew = basis.skew.filter(|_| is_other(effects::time_skew::EFFECT.id));
        seen
    }

    /// Of the weighed effects, those that are simulated; `floor` in PV units.
    #[must_use]
    pub(crate) fn new<'e>(
        basis: &Basis,
        effects: impl IntoIterator<Item = &'e EffectResult>,
        floor: Option<f64>,
    ) -> Self {
        let contender = |e: &EffectResult| {
            let fit = e.fit.as_ref().filter(|_| e.simulated)?;
            Some(Contender {
                id: e.id.clone(),
                stage: e.stage,
                raw_gain: e.raw_gain,
                evidence: e.evidence,
                lead: e.lead,
                at_floor: fit.at_floor,
                closed_pct: e.closed_pct,
                closed_interval: e.closed_interval,
                left: Left::of(fit, floor),
            })
        };
        Self { basis: basis.clone(), contenders: effects.into_iter().filter_map(contender).collect() }
    }
}
