//! What a decision is made from, without the fits: diagnosing is dear and deciding is cheap, so answers to a challenge
//! keep this, and a calibration decides on it again.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::types::{EffectResult, Fit, NoiseModels, Stage};

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
    /// Per cent of the gap that those close which a free run can follow.
    #[serde(default)]
    pub traces_close: BTreeMap<String, f64>,
    /// Whether PV's noise shares a lag of its signal.
    #[serde(default)]
    pub filter: bool,
    /// Points by which the recorded OP is off the PV that it answers, where the controller says so.
    pub skew: Option<f64>,
    /// Noise models of the residual.
    pub noise: NoiseModels,
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
    /// Held-out error over the floor.
    pub held_over_floor: Option<f64>,
    /// See [`Fit::colour`].
    pub colour: f64,
    /// See [`Fit::with_op`].
    pub with_op: f64,
}

impl Left {
    /// Of a fit.
    #[must_use]
    pub fn of(fit: &Fit, floor: Option<f64>) -> Self {
        Self {
            over_floor: floor.map(|f| fit.rmse_train / f),
            held_over_floor: floor.map(|f| fit.rmse / f),
            colour: fit.colour,
            with_op: fit.with_op,
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
    /// Per cent of the gap that it closes.
    pub closed_pct: Option<f64>,
    /// Lower and upper end of its interval.
    pub closed_interval: Option<[f64; 2]>,
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
    /// Of the weighed effects, those that are simulated; `floor` in PV units.
    #[must_use]
    pub fn new<'e>(basis: &Basis, effects: impl IntoIterator<Item = &'e EffectResult>, floor: Option<f64>) -> Self {
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
