//! How sure an answer is: a calibrated choice between three outcomes, "the best effect is right", "nothing is missing",
//! "something else is", made from bounded features (multinomial logistic regression; its weights stand in
//! `calibration.json`, fitted to loops of known cause by the lab).

use std::collections::BTreeMap;
use std::sync::OnceLock;

use serde::{Deserialize, Serialize};

use super::effects;
use super::evidence::{Basis, Contender};
use super::types::Stage;

/// What an answer's probability is made of, in this order; the first is a constant.
pub const NAMES: [&str; 23] = [
    "one",
    "lead",
    "ahead",
    "at_floor",
    "closed",
    "train",
    "colour",
    "white_above",
    "explained",
    "with_op",
    "over_best",
    "base_train",
    "base_colour",
    "base_with_op",
    "independent",
    "beyond_first",
    "no_floor",
    "excited",
    "bends",
    "nothing_ranked",
    "valve",
    "load_above",
    "process_above",
];

/// The features of one decision, bounded, in the order of [`NAMES`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Features([f64; NAMES.len()]);

impl Features {
    /// Of what is ranked, best first.
    #[must_use]
    pub(crate) fn of(basis: &Basis, ranked: &[&Contender]) -> Self {
        let flag = |x: bool| f64::from(u8::from(x));
        let log = |x: Option<f64>| libm::log(x.unwrap_or(1.0)).clamp(-0.1, 1.5);
        let base = &basis.base;
        let best = ranked.first();
        let left = best.map_or(base, |b| &b.left);
        let lead = best.map_or(-0.2, |b| b.lead);
        let second = ranked.get(1).map_or(0.0, |e| e.lead);
        let closed = best.and_then(|b| b.closes(base)).unwrap_or(0.0);
        let share = |pct: f64| (pct / 100.0).clamp(-1.0, 1.0);
        let against = |x: f64| ((x - 3.0) / 6.0).clamp(0.0, 1.5);
        let raw_gain = best.map_or(0.0, |b| b.raw_gain).max(0.0);
        let train = log(left.over_floor);
        // White but well above the noise: a model that reads the controller backwards finds the noise in OP.
        let white_above = train.max(0.0) * libm::exp(-5.0 * left.colour.max(0.0));
        // A load that is the right one leaves noise; the right process nearly does; slips that are a little wrong leave more.
        let above = |stage: Stage| flag(best.is_some_and(|b| b.stage == stage)) * (4.0 * train).clamp(0.0, 2.0);
        let to_explain = 2.0 * libm::log(base.over_floor.unwrap_or(1.0).max(1.05));
        Self([
            1.0,
            lead.clamp(-0.3, 1.5),
            (2.0 * (lead - second.max(0.0))).clamp(0.0, 1.0),
            flag(best.is_some_and(|b| b.at_floor)),
            share(closed),
            train,
            left.colour.clamp(0.0, 2.0),
            white_above,
            (raw_gain / to_explain).clamp(0.0, 1.2),
            against(left.with_op),
            (basis.noise.over_base - raw_gain).clamp(-0.5, 1.5),
            log(base.over_floor),
            base.colour.clamp(0.0, 2.0),
            against(base.with_op),
            flag(basis.noise.independence_p > 0.1),
            basis.noise.beyond_first.clamp(0.0, 1.0),
            flag(base.over_floor.is_none()),
            flag(basis.excited),
            flag(best.is_some_and(|b| effects::by_id(&b.id).is_some_and(|e| e.bends))),
            flag(best.is_none_or(|b| b.lead <= 0.0)),
            flag(best.is_some_and(|b| b.stage == Stage::Valve)),
            above(Stage::Disturbance),
            above(Stage::Process),
        ])
    }

    /// Values in the order of [`NAMES`]: for fits, and trials of one.
    #[must_use]
    pub const fn values(&self) -> &[f64; NAMES.len()] {
        &self.0
    }

    /// Of given values, in the order of [`NAMES`].
    #[must_use]
    pub const fn from_values(values: [f64; NAMES.len()]) -> Self {
        Self(values)
    }

    /// Names and values.
    pub(crate) fn named(&self) -> impl Iterator<Item = (&'static str, f64)> + '_ {
        NAMES.into_iter().zip(self.0)
    }
}

/// Probabilities of the three outcomes; their sum is 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outcomes {
    /// The best of the ranked effects is the cause.
    pub right: f64,
    /// Nothing is missing in the base.
    pub none: f64,
    /// Something else is.
    pub other: f64,
}

/// Which one came true.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// See [`Outcomes::right`].
    Right,
    /// See [`Outcomes::none`].
    None,
    /// See [`Outcomes::other`].
    Other,
}

/// Weights of a feature for "right" and for "none"; "other" is the one they are measured against.
pub type Weights = BTreeMap<String, [f64; 2]>;

/// Weights and thresholds, as `stiction-lab challenge calibrate` writes them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// By feature; one that is absent weighs nothing.
    pub weights: Weights,
    /// Probability of being right from which an effect is named.
    pub name_from: f64,
    /// Share of right ones among calls made from a trace in PV or from the controller's lag.
    pub trace: f64,
    /// Among calls made from the recorded valve position.
    pub by_mv: f64,
    /// Among effects that are named beside what the recorder did.
    pub second: f64,
    /// Among calls of coloured noise.
    pub coloured_noise: f64,
    /// Among neighbours that are named.
    #[serde(default = "of_neighbours")]
    pub neighbour: f64,
    /// Share of effects that no catalogue has where something else than the best effect was likeliest.
    pub unknown: f64,
    /// Where all this comes from.
    pub from: String,
    /// The search whose answers it was fitted to, or checked on last, by the name that the lab gives it.
    pub search: String,
}

/// The share of named neighbours that was right: `challenge neighbours --without-search --cases 14` of split A, seeds 3, 5 and 7,
/// named the driver 17 times, a follower and an unrelated loop once each; one right and one wrong added (Laplace).
const fn of_neighbours() -> f64 {
    18.0 / 21.0
}

impl Calibration {
    /// The one that is built in.
    #[must_use]
    pub fn shipped() -> &'static Self {
        static READ: OnceLock<Calibration> = OnceLock::new();
        READ.get_or_init(|| serde_json::from_str(include_str!("calibration.json")).unwrap_or_else(|_| Self::blank()))
    }

    /// One that knows nothing.
    #[must_use]
    pub const fn blank() -> Self {
        Self {
            weights: BTreeMap::new(),
            name_from: 0.5,
            trace: 0.9,
            by_mv: 0.9,
            second: 0.5,
            coloured_noise: 0.5,
            neighbour: of_neighbours(),
            unknown: 0.5,
            from: String::new(),
            search: String::new(),
        }
    }

    /// Probabilities of the outcomes.
    #[must_use]
    pub fn outcomes(&self, features: &Features) -> Outcomes {
        let said = features.named().filter_map(|(name, x)| Some((self.weights.get(name)?, x)));
        let z = said.fold([0.0; 2], |z, (w, x)| [z[0] + w[0] * x, z[1] + w[1] * x]);
        let [right, none, other] = softmax(z);
        Outcomes { right, none, other }
    }
}

/// Probabilities of two outcomes measured against a third, and of that one.
#[must_use]
pub fn softmax(z: [f64; 2]) -> [f64; 3] {
    let most = z[0].max(z[1]).max(0.0);
    let e = [libm::exp(z[0] - most), libm::exp(z[1] - most), libm::exp(-most)];
    let sum: f64 = e.iter().sum();
    e.map(|x| x / sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_calibration_is_read_and_has_every_feature() {
        let shipped = Calibration::shipped();
        assert!(!shipped.from.is_empty() && shipped.trace > 0.5 && shipped.name_from > 0.0);
        assert!(NAMES.iter().all(|name| shipped.weights.contains_key(*name)));
    }

    #[test]
    fn what_a_load_or_a_process_leaves_above_the_floor_speaks_against_it() {
        let weight = |name: &str| Calibration::shipped().weights[name][0];
        assert!(weight("load_above") < 0.0 && weight("process_above") < 0.0);
    }
}
