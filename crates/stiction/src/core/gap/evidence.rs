//! What a decision is made from, without the fits: diagnosing is dear and deciding is cheap, so answers to a challenge
//! keep this, and a calibration decides on it again.

use serde::{Deserialize, Serialize};

use super::effects;
use super::types::{EffectNote, Fit, OneStep, Stage};

/// What a decision is made from beside the effects; everything in it is known without deciding.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Basis {
    /// Ids whose trace stands in PV, strongest first.
    pub traces: Vec<String>,
    /// The other loop's load that the noise model has in both halves.
    #[serde(default)]
    pub acts: Option<String>,
    /// Points by which the recorded OP is off the PV that it answers, where the controller says so.
    pub skew: Option<f64>,
    /// Whether coloured noise may be named.
    pub coloured_noise: bool,
    /// The stage that MV points to.
    pub by_mv: Option<Stage>,
    /// Whether the base is at the floor.
    pub base_at_floor: bool,
    /// The base's fit as a contender sees its own.
    pub base: Left,
}

/// What a fit leaves of PV.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Left {
    /// Training error over the floor; `None` where there is no floor.
    pub over_floor: Option<f64>,
    /// Fitted points, and numbers fitted to them.
    pub fitted: [usize; 2],
    /// See [`Fit::one_step`].
    pub one_step: OneStep,
}

impl Left {
    /// Of a fit.
    #[must_use]
    pub(crate) fn of(fit: &Fit, floor: Option<f64>) -> Self {
        Self {
            over_floor: floor.map(|f| fit.rmse_train / f),
            fitted: [fit.points, fit.parameters],
            one_step: fit.one_step,
        }
    }

    /// Log likelihood of PV one step ahead at the fitted points, nats, by the order of the noise, less what its numbers and the noise's
    /// cost (Schwarz 1978).
    #[must_use]
    pub(super) fn scores(&self) -> [f64; 5] {
        let [n, k] = self.fitted.map(|count| count as f64);
        core::array::from_fn(|order| n * self.one_step[order][0] - 0.5 * (k + order as f64) * libm::log(n.max(1.0)))
    }
}

/// A simulated effect as the decision sees it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Contender {
    /// Its id.
    pub id: String,
    /// Where it acts.
    pub stage: Stage,
    /// See [`EffectNote::lead`].
    pub lead: f64,
    /// Per cent of the gap that it closes on held-out blocks, which have no say in the choice.
    pub closed_pct: Option<f64>,
    /// What its fit leaves.
    pub left: Left,
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
        basis.acts = basis.acts.take().filter(|acts| is_other(acts));
        basis.coloured_noise &= is_other(effects::coloured_noise::EFFECT.id);
        basis.skew = basis.skew.filter(|_| is_other(effects::time_skew::EFFECT.id));
        seen
    }

    /// Of the weighed effects, those that are simulated; `floor` in PV units.
    #[must_use]
    pub(crate) fn new<'e>(
        basis: &Basis,
        effects: impl IntoIterator<Item = &'e EffectNote>,
        floor: Option<f64>,
    ) -> Self {
        let contender = |e: &EffectNote| {
            let fit = e.fit.as_ref().filter(|_| e.simulated)?;
            let left = Left::of(fit, floor);
            Some(Contender { id: e.id.clone(), stage: e.stage, lead: e.lead, closed_pct: e.closed_pct, left })
        };
        Self { basis: basis.clone(), contenders: effects.into_iter().filter_map(contender).collect() }
    }
}
