//! Logistic regression from features to a probability; its weights are in `rule.json`.
//!
//! `logit p = constant + sum of weight * feature`. The file may hold several such rules, which use different features and err
//! on different records; the answer is the mean of their logits. A feature is a figure of the fit or an indicator, identified
//! by its name. If a record does not show it, it takes its mean over the calibration cases, so it adds nothing. Its
//! contribution is its weight times its distance from that mean; the contributions and `base`, the logit where every feature
//! has its mean, add up to the logit.
//!
//! A long record is split into windows; the window with the median logit answers.

use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

use super::features::{self, Features, Figures};
use crate::core::detect::Indicator;

/// Weight of one feature.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Weight {
    /// Name of the feature.
    pub feature: String,
    /// Logit per unit of the feature.
    pub weight: f64,
    /// The feature's mean over the calibration cases.
    pub mean: f64,
}

/// Calibration cases of the rule.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Made {
    /// Simulated sticking loops.
    pub sticking_loops: usize,
    /// Simulated healthy loops.
    pub healthy_loops: usize,
    /// Weight of all simulated loops together, in real valves.
    pub simulated_weight: f64,
    /// Labelled recordings of real loops.
    pub recordings: usize,
    /// Valves in these recordings, each with weight 1.
    pub valves: usize,
    /// Ridge penalty on the weights of standardised features.
    pub ridge: f64,
    /// Seed of the first simulated loop.
    pub seed: u64,
}

/// One logistic rule.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Logistic {
    /// Logit where every feature is 0.
    pub constant: f64,
    /// The features with a weight.
    pub weights: Vec<Weight>,
}

impl Logistic {
    fn base(&self) -> f64 {
        self.constant + self.weights.iter().map(|w| w.weight * w.mean).sum::<f64>()
    }

    fn contribution(&self, name: &str, score: f64) -> f64 {
        self.weights.iter().find(|w| w.feature == name).map_or(0.0, |w| w.weight * (score - w.mean))
    }
}

/// Probabilities from which on words and alarms follow.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Cuts {
    /// A record's valve is said to stick.
    pub called: f64,
    /// A window counts towards an alarm. Higher: an alarm is raised by itself on thousands of healthy windows a day, a
    /// record is judged because somebody asks.
    pub alarm: f64,
}

/// A fitted rule.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Rule {
    /// The rules whose logits are averaged.
    pub parts: Vec<Logistic>,
    /// Decision thresholds.
    pub cuts: Cuts,
    /// Calibration cases of the rules.
    pub made: Made,
}

/// The rule of this build.
static SHIPPED: LazyLock<Rule> = LazyLock::new(|| {
    // A test parses the file; an empty rule never calls stiction.
    let nothing = Rule { parts: Vec::new(), cuts: Cuts { called: 1.0, alarm: 1.0 }, made: Made::default() };
    serde_json::from_str(include_str!("rule.json")).unwrap_or(nothing)
});

/// The rule's result for a record.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Opinion {
    /// Logit with every feature at its mean.
    pub base: f64,
    /// Logit of this record.
    pub logit: f64,
    /// What follows from the probability.
    pub cuts: Cuts,
}

impl Opinion {
    /// Probability that the valve sticks.
    #[must_use]
    pub fn p(&self) -> f64 {
        logistic(self.logit)
    }

    /// Whether the probability reaches the decision threshold.
    #[must_use]
    pub fn sticks(&self) -> bool {
        self.p() >= self.cuts.called
    }

    /// Whether the probability is high enough to count towards an alarm.
    #[must_use]
    pub fn alarms(&self) -> bool {
        self.p() >= self.cuts.alarm
    }
}

/// `1 / (1 + exp(-x))`.
#[must_use]
pub fn logistic(x: f64) -> f64 {
    1.0 / (1.0 + libm::exp(-x))
}

impl Rule {
    /// The rule of this build.
    #[must_use]
    pub fn shipped() -> &'static Self {
        &SHIPPED
    }

    /// Names of the features with a weight, each once.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        let all = || self.parts.iter().flat_map(|part| &part.weights).map(|w| w.feature.as_str());
        all()
            .enumerate()
            .filter(move |(at, name)| !all().take(*at).any(|earlier| earlier == *name))
            .map(|(_, name)| name)
    }

    /// Applies the rule to a record's features.
    #[must_use]
    pub fn opinion(&self, features: &Features) -> Opinion {
        let base = self.mean(Logistic::base);
        let contributions: f64 = self.names().map(|name| self.contribution(name, features)).sum();
        Opinion { base, logit: base + contributions, cuts: self.cuts }
    }

    /// Every feature as an indicator, as documents list it.
    #[must_use]
    pub(crate) fn indicators(&self, features: &Features) -> Vec<Indicator> {
        let of = |name| {
            let contribution = self.contribution(name, features);
            let vote = (contribution != 0.0).then_some(contribution > 0.0);
            Indicator { name, score: features.get(name), vote, contribution }
        };
        features::names().map(of).collect()
    }

    /// A feature's contribution to the logit, relative to its mean; 0 if the record does not show it or it has no weight.
    fn contribution(&self, name: &str, features: &Features) -> f64 {
        features.get(name).map_or(0.0, |x| self.mean(|part| part.contribution(name, x)))
    }

    /// Index of the window that answers for a record, and the rule's opinion on it; `None` without a window.
    #[must_use]
    pub fn answer(&self, windows: &[Figures]) -> Option<(usize, Opinion)> {
        let of = |figures: &Figures| self.opinion(&figures.features());
        let mut told: Vec<(usize, Opinion)> = windows.iter().map(of).enumerate().collect();
        told.sort_by(|a, b| a.1.logit.total_cmp(&b.1.logit));
        told.get(told.len().saturating_sub(1) / 2).copied()
    }

    fn mean(&self, of: impl Fn(&Logistic) -> f64) -> f64 {
        self.parts.iter().map(of).sum::<f64>() / self.parts.len().max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::detect;

    #[test]
    fn the_shipped_rule_is_read_and_names_what_there_is() {
        let read: Result<Rule, _> = serde_json::from_str(include_str!("rule.json"));
        let rule = read.unwrap();
        assert_eq!(&rule, Rule::shipped());
        assert!(rule.parts.iter().all(|part| !part.weights.is_empty()) && !rule.parts.is_empty());
        assert!(0.0 < rule.cuts.called && rule.cuts.called <= rule.cuts.alarm && rule.cuts.alarm < 1.0);
        let known = |name: &str| features::names().any(|n| n == name);
        assert!(rule.names().all(known), "{rule:?}");
    }

    #[test]
    fn contributions_add_up_and_what_is_not_shown_adds_nothing() {
        let weight = |feature: &str, weight, mean| Weight { feature: feature.to_owned(), weight, mean };
        let first =
            Logistic { constant: -1.0, weights: vec![weight("confirmed", 2.0, 0.25), weight("travel", 4.0, 0.5)] };
        let second = Logistic { constant: 1.0, weights: vec![weight("travel", 2.0, 0.5)] };
        let cuts = Cuts { called: 0.5, alarm: 0.7 };
        let rule = Rule { parts: vec![first, second], cuts, made: Made::default() };
        let of = Features::of_scores;
        let all = of(&[("confirmed", 1.0), ("travel", 0.75)]);
        let opinion = rule.opinion(&all);
        assert_eq!((opinion.base, opinion.logit), (1.75, 3.25));
        let indicators = rule.indicators(&all);
        assert_eq!(indicators.iter().map(|i| i.contribution).sum::<f64>(), 1.5);
        let votes = ["confirmed", "horch"].map(|name| indicators.iter().find(|i| i.name == name).unwrap().vote);
        assert_eq!(votes, [Some(true), None]);
        assert!(opinion.sticks() && opinion.alarms());
        let not_shown = rule.opinion(&of(&[("confirmed", 0.25), ("horch", 9.0)]));
        assert_eq!(not_shown.logit, 1.75);
        let weak = rule.opinion(&of(&[("confirmed", -1.0)]));
        assert!(weak.sticks() && !weak.alarms());
        assert!(!rule.opinion(&of(&[("confirmed", -2.0)])).sticks());
        assert!((logistic(0.0) - 0.5).abs() < 1e-15 && logistic(-800.0) == 0.0);
    }

    #[test]
    fn the_median_window_answers() {
        let weights = vec![Weight { feature: detect::ALL[0].name().to_owned(), weight: 1.0, mean: 0.0 }];
        let cuts = Cuts { called: 0.5, alarm: 0.7 };
        let rule = Rule { parts: vec![Logistic { constant: 0.0, weights }], cuts, made: Made::default() };
        let of = |x: f64| {
            let mut detectors = [None; detect::ALL.len()];
            detectors[0] = Some(x);
            Figures { fit: None, setpoint_share: 0.0, interpolated: false, detectors }
        };
        assert_eq!(rule.answer(&[3.0, -2.0, -1.0].map(of)).unwrap().0, 2);
        assert_eq!(rule.answer(&[of(1.0)]).unwrap().1.logit, 1.0);
        assert_eq!(rule.answer(&[]), None);
    }
}
