//! What a decision is made from, without the fits: diagnosing is dear and deciding is cheap, so answers to a challenge
//! keep this, and a calibration decides on it again.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::express::{AT_FLOOR, above_floor};
use super::types::{Alone, EffectResult, Fit, NoiseModels, Stage};

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
    /// By effect, the floor over the one that would be taken if nothing were known of it.
    #[serde(default)]
    pub floor_owes: BTreeMap<String, f64>,
    /// The other loop's load that the noise model has in both halves.
    #[serde(default)]
    pub acts: Option<String>,
    /// Whether a replay of OP finds bands that differ at random.
    #[serde(default)]
    pub random_bands: bool,
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
    pub(crate) fn of(fit: &Fit, floor: Option<f64>) -> Self {
        Self {
            over_floor: floor.map(|f| fit.rmse_train / f),
            held_over_floor: floor.map(|f| fit.rmse / f),
            colour: fit.colour,
            with_op: fit.with_op,
        }
    }
}

impl Left {
    /// The same over a floor that is lower by a factor.
    fn over_lower(&mut self, by: f64) {
        for over in [&mut self.over_floor, &mut self.held_over_floor] {
            *over = over.map(|o| o * by);
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
    /// What a catalogue that lacks some effects would see: errors over the floor that is taken where nothing is known of them.
    #[must_use]
    pub(crate) fn of_those_who_lack(&self, without: &[&str]) -> Self {
        let mut seen = self.clone();
        let owed = self.basis.floor_owes.iter().filter(|(id, _)| without.contains(&id.as_str()));
        let by = owed.map(|(_, by)| *by).fold(1.0, f64::max);
        if by <= 1.0 {
            return seen;
        }
        let at_floor = |left: &Left| left.over_floor.is_some_and(|o| o <= AT_FLOOR);
        let basis = &mut seen.basis;
        basis.base.over_lower(by);
        basis.base_at_floor &= at_floor(&basis.base);
        for on_mv in &mut basis.on_mv {
            on_mv.over_floor = on_mv.over_floor.map(|o| o * by);
        }
        for contender in &mut seen.contenders {
            contender.left.over_lower(by);
            contender.at_floor &= at_floor(&contender.left);
            let gap = |left: &Left| left.held_over_floor.map(|o| above_floor(o, Some(1.0))).filter(|g| *g > 0.0);
            let (before, after) = (gap(&basis.base), gap(&contender.left));
            let closed = before.zip(after).map(|(before, after)| 100.0 * (1.0 - after / before));
            let moved = closed.zip(contender.closed_pct).map(|(now, was)| now - was);
            contender.closed_interval =
                contender.closed_interval.zip(moved).map(|(ends, moved)| ends.map(|end| end + moved));
            contender.closed_pct = closed;
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    fn left(over_floor: f64) -> Left {
        Left { over_floor: Some(over_floor), held_over_floor: Some(over_floor), colour: 0.0, with_op: 0.0 }
    }

    #[test]
    fn who_lacks_a_filter_sees_errors_over_the_floor_that_he_would_take() {
        let models =
            NoiseModels { over_base: 0.0, over_best: 0.0, independence_p: 1.0, whitens: true, beyond_first: 0.0 };
        let basis = Basis {
            traces: Vec::new(),
            traces_close: BTreeMap::new(),
            filter: true,
            floor_owes: BTreeMap::from([("sensor_filter".to_owned(), 3.0)]),
            acts: None,
            random_bands: false,
            skew: None,
            noise: models,
            alone: None,
            coloured_noise: true,
            by_mv: None,
            on_mv: Vec::new(),
            base_at_floor: false,
            base: left(2.0),
            excited: false,
            linear: false,
        };
        let lag = Contender {
            id: "extra_lag".to_owned(),
            stage: Stage::Process,
            raw_gain: 1.4,
            evidence: 1.3,
            lead: 1.2,
            at_floor: true,
            closed_pct: Some(100.0),
            closed_interval: Some([90.0, 100.0]),
            left: left(1.0),
        };
        let all = Evidence { basis, contenders: vec![lag] };
        assert_eq!(all.of_those_who_lack(&["ramp"]), all);
        let seen = all.of_those_who_lack(&["sensor_filter"]);
        let lag = &seen.contenders[0];
        assert!(!lag.at_floor && lag.left.over_floor == Some(3.0) && seen.basis.base.over_floor == Some(6.0));
        // Of a gap of sqrt(35) it leaves sqrt(8).
        let closed = 100.0 * (1.0 - (8.0_f64 / 35.0).sqrt());
        assert!((lag.closed_pct.unwrap() - closed).abs() < 1e-9);
        assert!((lag.closed_interval.unwrap()[0] - (closed - 10.0)).abs() < 1e-9);
    }
}
