//! From signs to a probability: a logistic rule, its weights in a file beside it.
//!
//! `logit p = constant + sum of weight * feature`. Where the file holds several such rules, which then look at different
//! features and err on different records, the mean of their logits is the answer. A feature is a figure of the fit or an indicator, found by its name. One
//! that a record does not show counts as its mean over the cases that the rule was fitted to, so it adds nothing. The
//! contribution of each is its weight times its distance from that mean; together with `base`, the logit where every
//! feature has its mean, they add up to the logit.
//!
//! A long record is looked at in windows, of which the one with the median logit answers.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

use crate::detect::{Detector, View};
use crate::ident::Estimate;
use crate::ident::residual::{PORTMANTEAU, Whiteness};
use crate::ident::slip_search::answer::FULL_WEIGHT;
use crate::record::Record;
use crate::signal::stats;

/// Share of the error below which less of it proves no more.
const LEAST_ERROR: f64 = 1e-6;
/// Turns of the stem from which a fit is no accident.
const MANY_TURNS: f64 = 12.0;
/// What noise gives for the odd part of OP's and PV's cross-correlation, and what a sticking valve exceeds.
const HALF_ODD: f64 = 0.5;

/// One feature's part in the rule.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Weight {
    /// Name of the feature.
    pub feature: String,
    /// Logit for each unit of it.
    pub weight: f64,
    /// Its mean over the cases that the rule was fitted to.
    pub mean: f64,
}

/// What the rule was fitted to.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Made {
    /// Simulated sticking loops.
    pub sticking_loops: usize,
    /// Simulated healthy loops.
    pub healthy_loops: usize,
    /// Real valves that weigh as much as all simulated loops together.
    pub simulated_weight: f64,
    /// Labelled recordings of real loops.
    pub recordings: usize,
    /// Valves that these show, each weighing 1.
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
    /// The features that count.
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
    /// What follows from the probability.
    pub cuts: Cuts,
    /// What it was fitted to.
    pub made: Made,
}

/// The rule that this build judges by.
static SHIPPED: LazyLock<Rule> = LazyLock::new(|| {
    // A test reads the file; an empty rule calls nothing.
    let nothing = Rule { parts: Vec::new(), cuts: Cuts { called: 1.0, alarm: 1.0 }, made: Made::default() };
    serde_json::from_str(include_str!("rule.json")).unwrap_or(nothing)
});

/// Figures by name; what the record does not show is left out.
pub type Features = BTreeMap<String, f64>;

/// One feature's score and contribution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct IndicatorScore {
    /// Its figure.
    pub score: Option<f64>,
    /// Its part of the logit, against its mean; 0 where the record does not show it or it does not count.
    pub contribution: f64,
}

/// What the rule makes of a record.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Opinion {
    /// Logit where every feature stands at its mean.
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

    /// Whether it is said to stick.
    #[must_use]
    pub fn sticks(&self) -> bool {
        self.p() >= self.cuts.called
    }

    /// Whether it is sure enough to count towards an alarm.
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
    /// The rule that this build judges by.
    #[must_use]
    pub fn shipped() -> &'static Self {
        &SHIPPED
    }

    /// Names of the features that count, each once.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        let all = || self.parts.iter().flat_map(|part| &part.weights).map(|w| w.feature.as_str());
        all()
            .enumerate()
            .filter(move |(at, name)| !all().take(*at).any(|earlier| earlier == *name))
            .map(|(_, name)| name)
    }

    /// What the rule makes of a record's features.
    #[must_use]
    pub fn opinion(&self, features: &Features) -> Opinion {
        let base = self.mean(Logistic::base);
        let contributions: f64 = self.names().map(|name| self.indicator_score(name, features).contribution).sum();
        Opinion { base, logit: base + contributions, cuts: self.cuts }
    }

    /// One feature's score and contribution.
    #[must_use]
    pub(crate) fn indicator_score(&self, name: &str, features: &Features) -> IndicatorScore {
        let score = features.get(name).copied();
        IndicatorScore { score, contribution: score.map_or(0.0, |x| self.mean(|part| part.contribution(name, x))) }
    }

    /// The place of the window that answers for a record, and what the rule makes of it; `None` without a window.
    #[must_use]
    pub fn answer(&self, windows: &[Features]) -> Option<(usize, Opinion)> {
        let of = |figures: &Features| self.opinion(&features(figures.clone()));
        let mut told: Vec<(usize, Opinion)> = windows.iter().map(of).enumerate().collect();
        told.sort_by(|a, b| a.1.logit.total_cmp(&b.1.logit));
        told.get(told.len().saturating_sub(1) / 2).copied()
    }

    fn mean(&self, of: impl Fn(&Logistic) -> f64) -> f64 {
        self.parts.iter().map(of).sum::<f64>() / self.parts.len().max(1) as f64
    }
}

/// The figures of a fit to `points` points, by name: its index, s over OP's span, the turns of the stem, and how white
/// what it leaves is.
#[must_use]
pub(crate) fn of_fit(
    index: f64,
    s_over_span: f64,
    reversals: usize,
    left: &Whiteness,
    points: usize,
) -> [(String, f64); 6] {
    let fit = [
        ("stiction_index", index),
        ("s_over_span", s_over_span),
        ("reversals", reversals as f64),
        ("points", points as f64),
        ("inflation", left.inflation),
        ("portmanteau", left.portmanteau),
    ];
    fit.map(|(name, value)| (name.to_owned(), value))
}

/// What a record shows, before anything is made of it: figures of the fit (none where nothing moved the stem or nothing
/// was fitted), of the set point and of the detectors. Where PV is `interpolated` between stored values its
/// corners are the recorder's, so the detector that looks for jumps is left out.
#[must_use]
pub fn figures(
    estimate: Option<&Estimate>,
    record: &Record,
    view: &View,
    detectors: &[&dyn Detector],
    interpolated: bool,
) -> Features {
    figures_of(estimate, record, &record.pv, view, detectors, interpolated)
}

/// As [`figures`], with another PV than the record's, which `view` was made of too.
#[must_use]
pub(crate) fn figures_of(
    estimate: Option<&Estimate>,
    record: &Record,
    pv: &[f64],
    view: &View,
    detectors: &[&dyn Detector],
    interpolated: bool,
) -> Features {
    let mut out = Features::new();
    if let Some(e) = estimate {
        out.extend(of_fit(e.index, e.s / e.span, e.reversals, &e.spread.whiteness, record.len()));
        out.insert("index_moves".to_owned(), e.index_moves);
    }
    let moved = record.sp.as_deref().map_or(0.0, stats::std_dev) / stats::std_dev(pv);
    if moved.is_finite() {
        out.insert("setpoint_share".to_owned(), moved.min(2.0));
    }
    out.insert(INTERPOLATED.to_owned(), f64::from(u8::from(interpolated)));
    let used = detectors.iter().filter(|d| !(interpolated && d.name() == "jumps"));
    out.extend(used.filter_map(|d| Some((d.name().to_owned(), d.score(view)?))));
    out
}

/// The features that are made of a record's figures; the detectors' are taken as they are.
///
/// | feature | means |
/// |---|---|
/// | `likelihood` | `ln(1 + n/2 ln(1 / (1 - index)))`, n the independent points: the logarithm of how much likelier the record is with friction than without; less, as `1 / (1 + (Q / 45.3)^2)`, where the statistic Q of Ljung and Box (1978) over 20 lags says that the fit leaves more than noise; 0 without a fit |
/// | `confirmed` | the stiction index, less where s is under a fifth of OP's span, where the stem turned less than 12 times while the set point hardly moved (few turns can be an accident), and where OP is an image of PV (`horch` below 0.5: the fit may be of the controller) |
/// | `moves` | the index for differences of the free-run error, which slow disturbances hardly touch, less where s is small |
///
/// None of them is made of a PV that lies on straight lines: what the recorder drew between two stored values any model
/// follows, and an index near 1 proves nothing.
#[must_use]
pub fn features(mut figures: Features) -> Features {
    let of = |name: &str| figures.get(name).copied().unwrap_or(0.0);
    if of(INTERPOLATED) > 0.0 {
        return figures;
    }
    let index = of("stiction_index") * (of("s_over_span") / FULL_WEIGHT).min(1.0);
    let tried = (of("reversals") / MANY_TURNS).max(of("setpoint_share")).min(1.0);
    let confirmed = index * tried * (of("horch") / HALF_ODD).min(1.0);
    let moves = of("index_moves");
    let gain =
        -0.5 * libm::log((1.0 - of("stiction_index")).max(LEAST_ERROR)) * of("points") / of("inflation").max(1.0);
    // Not gain.max(0.0): which zero that is of -0.0 depends on the build, and it is written into documents.
    let gain = if gain > 0.0 { gain } else { 0.0 };
    let coloured = of("portmanteau") / PORTMANTEAU;
    let likelihood = libm::log1p(gain) / (1.0 + coloured * coloured);
    let made = [("likelihood", likelihood), ("confirmed", confirmed), ("moves", moves)];
    figures.extend(made.map(|(name, value)| (name.to_owned(), value)));
    figures
}

/// Figure of a PV that lies on straight lines between stored values, 0 or 1.
const INTERPOLATED: &str = "interpolated";

/// Names of the features that are made of the fit, in the order of documents.
pub(crate) const OF_THE_FIT: [&str; 3] = ["likelihood", "confirmed", "moves"];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect;

    #[test]
    fn the_shipped_rule_is_read_and_names_what_there_is() {
        let read: Result<Rule, _> = serde_json::from_str(include_str!("rule.json"));
        let rule = read.unwrap();
        assert_eq!(&rule, Rule::shipped());
        assert!(rule.parts.iter().all(|part| !part.weights.is_empty()) && !rule.parts.is_empty());
        assert!(0.0 < rule.cuts.called && rule.cuts.called <= rule.cuts.alarm && rule.cuts.alarm < 1.0);
        let known = |name: &str| OF_THE_FIT.contains(&name) || detect::ALL.iter().any(|d| d.name() == name);
        assert!(rule.names().all(known), "{rule:?}");
    }

    #[test]
    fn contributions_add_up_and_what_is_not_shown_adds_nothing() {
        let weight = |feature: &str, weight, mean| Weight { feature: feature.to_owned(), weight, mean };
        let first = Logistic { constant: -1.0, weights: vec![weight("index", 2.0, 0.25), weight("travel", 4.0, 0.5)] };
        let second = Logistic { constant: 1.0, weights: vec![weight("travel", 2.0, 0.5)] };
        let cuts = Cuts { called: 0.5, alarm: 0.7 };
        let rule = Rule { parts: vec![first, second], cuts, made: Made::default() };
        let of = |list: &[(&str, f64)]| list.iter().map(|(name, x)| ((*name).to_owned(), *x)).collect::<Features>();
        let all = of(&[("index", 1.0), ("travel", 0.75)]);
        let opinion = rule.opinion(&all);
        assert_eq!((opinion.base, opinion.logit), (1.75, 3.25));
        assert_eq!(
            rule.indicator_score("index", &all).contribution + rule.indicator_score("travel", &all).contribution,
            1.5
        );
        assert!(opinion.sticks() && opinion.alarms());
        let not_shown = rule.opinion(&of(&[("index", 0.25), ("unknown", 9.0)]));
        assert_eq!(not_shown.logit, 1.75);
        let weak = rule.opinion(&of(&[("index", -1.0)]));
        assert!(weak.sticks() && !weak.alarms());
        assert!(!rule.opinion(&of(&[("index", -2.0)])).sticks());
        assert!((logistic(0.0) - 0.5).abs() < 1e-15 && logistic(-800.0) == 0.0);
    }
    #[test]
    fn the_median_window_answers() {
        let weights = vec![Weight { feature: "travel".to_owned(), weight: 1.0, mean: 0.0 }];
        let cuts = Cuts { called: 0.5, alarm: 0.7 };
        let rule = Rule { parts: vec![Logistic { constant: 0.0, weights }], cuts, made: Made::default() };
        let of = |x: f64| Features::from([("travel".to_owned(), x)]);
        assert_eq!(rule.answer(&[3.0, -2.0, -1.0].map(of)).unwrap().0, 2);
        assert_eq!(rule.answer(&[of(1.0)]).unwrap().1.logit, 1.0);
        assert_eq!(rule.answer(&[]), None);
    }
}
