//! Scores of verdicts against labels: counts, intervals, Brier score, reliability.

use serde::Serialize;

/// One judged case.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scored {
    /// The label: whether the valve sticks.
    pub truth: bool,
    /// The verdict.
    pub answer: Option<bool>,
    /// Probability given.
    pub p: Option<f64>,
    /// Weight of the case: 1, or its share of a valve.
    pub weight: f64,
}

impl Scored {
    /// The same case where sticking is called only at a probability of at least `threshold`.
    #[must_use]
    pub fn at(&self, threshold: f64) -> Self {
        Self { answer: self.answer.zip(self.p).map(|(answer, p)| answer && p >= threshold), ..*self }
    }
}

/// Sums of weights; whole numbers if every case has weight 1.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Tally {
    /// True positives.
    pub found: f64,
    /// False negatives.
    pub missed: f64,
    /// False positives.
    pub false_alarms: f64,
    /// True negatives.
    pub cleared: f64,
    /// No answer.
    pub unanswered: f64,
    /// Could not be read.
    pub errors: f64,
}

impl Tally {
    /// Counts cases.
    #[must_use]
    pub fn of(cases: &[Scored]) -> Self {
        let mut out = Self::default();
        for case in cases {
            let slot = match (case.truth, case.answer) {
                (_, None) => &mut out.unanswered,
                (true, Some(true)) => &mut out.found,
                (true, Some(false)) => &mut out.missed,
                (false, Some(true)) => &mut out.false_alarms,
                (false, Some(false)) => &mut out.cleared,
            };
            *slot += case.weight;
        }
        out
    }

    /// Right answers.
    #[must_use]
    pub fn right(&self) -> f64 {
        self.found + self.cleared
    }

    /// All cases.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.right() + self.missed + self.false_alarms + self.unanswered + self.errors
    }

    /// Share of right answers with its 95 % interval, `None` without a case.
    #[must_use]
    pub fn interval(&self) -> Option<[f64; 2]> {
        wilson(self.right(), self.total())
    }
}

/// Wilson's 95 % interval of a share, `right` of `total` (1927); whole numbers or sums of weights.
#[must_use]
pub fn wilson(right: f64, total: f64) -> Option<[f64; 2]> {
    const Z: f64 = 1.959_963_984_540_054;
    if total.is_nan() || total <= 0.0 {
        return None;
    }
    let (p, z2) = (right / total, Z * Z / total);
    let middle = (p + 0.5 * z2) / (1.0 + z2);
    let half = Z / (1.0 + z2) * (p * (1.0 - p) / total + 0.25 * z2 / total).max(0.0).sqrt();
    Some([(middle - half).max(0.0), (middle + half).min(1.0)])
}

/// Weighted mean squared distance of the probabilities from the truth (Brier 1950); cases without one are left out.
#[must_use]
pub fn brier(cases: &[Scored]) -> Option<f64> {
    let (mut sum, mut weight) = (0.0, 0.0);
    for case in cases {
        let Some(p) = case.p else { continue };
        let miss = p - truth(case);
        sum += case.weight * miss * miss;
        weight += case.weight;
    }
    (weight > 0.0).then(|| sum / weight)
}

fn truth(case: &Scored) -> f64 {
    f64::from(u8::from(case.truth))
}

/// A row of a reliability table: cases with about the same probability, and how many of them stick.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Bin {
    /// Lower edge of the bin.
    pub from: f64,
    /// Upper edge of the bin.
    pub to: f64,
    /// Number of cases.
    pub count: usize,
    /// Weighted mean of their probabilities.
    pub mean_p: f64,
    /// Weighted share of sticking cases among them.
    pub rate: f64,
}

impl Bin {
    fn of(cases: &[Scored], from: f64, to: f64) -> Self {
        let weight: f64 = cases.iter().map(|c| c.weight).sum();
        let mean = |value: &dyn Fn(&Scored) -> f64| cases.iter().map(|c| c.weight * value(c)).sum::<f64>() / weight;
        let (mean_p, rate) = (mean(&|c| c.p.unwrap_or(0.5)), mean(&truth));
        Self { from, to, count: cases.len(), mean_p, rate }
    }
}

/// Reliability over bins of equal width; empty bins are left out.
#[must_use]
pub fn reliability(cases: &[Scored], bins: usize) -> Vec<Bin> {
    let edge = |k: usize| k as f64 / bins as f64;
    let of = |k: usize| {
        let inside = |p: f64| (p >= edge(k) || k == 0) && (p < edge(k + 1) || k + 1 == bins);
        let cases: Vec<Scored> = cases.iter().filter(|c| c.p.is_some_and(inside)).copied().collect();
        (!cases.is_empty()).then(|| Bin::of(&cases, edge(k), edge(k + 1)))
    };
    (0..bins).filter_map(of).collect()
}

/// Reliability over bins that hold equally many cases.
#[must_use]
pub fn reliability_equal(cases: &[Scored], bins: usize) -> Vec<Bin> {
    let mut sorted: Vec<Scored> = cases.iter().filter(|c| c.p.is_some()).copied().collect();
    sorted.sort_by(|a, b| a.p.unwrap_or(0.0).total_cmp(&b.p.unwrap_or(0.0)));
    let edge = |k: usize| k * sorted.len() / bins;
    let parts = (0..bins).map(|k| &sorted[edge(k)..edge(k + 1)]);
    let p = |case: Option<&Scored>| case.and_then(|c| c.p).unwrap_or(0.0);
    parts.filter(|part| !part.is_empty()).map(|part| Bin::of(part, p(part.first()), p(part.last()))).collect()
}

/// Mean distance between probability and rate, unweighted over the bins.
#[must_use]
pub fn miscalibration(bins: &[Bin]) -> Option<f64> {
    let sum: f64 = bins.iter().map(|b| (b.mean_p - b.rate).abs()).sum();
    (!bins.is_empty()).then(|| sum / bins.len() as f64)
}

/// Gives every case the weight 1 over the number of cases with the same key, so that each key counts once.
pub fn share_by<K: Ord>(cases: &mut [Scored], keys: &[K]) {
    let mut counts = std::collections::BTreeMap::new();
    for key in keys {
        *counts.entry(key).or_insert(0_u32) += 1;
    }
    for (case, key) in cases.iter_mut().zip(keys) {
        case.weight = 1.0 / f64::from(counts.get(key).copied().unwrap_or(1));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn case(truth: bool, p: f64) -> Scored {
        Scored { truth, answer: Some(p > 0.5), p: Some(p), weight: 1.0 }
    }

    #[test]
    fn wilson_is_the_textbooks() {
        let [low, high] = wilson(8.0, 10.0).unwrap();
        assert!((low - 0.4902).abs() < 1e-4 && (high - 0.9433).abs() < 1e-4);
        let [low, high] = wilson(0.0, 20.0).unwrap();
        assert!(low == 0.0 && (high - 0.1611).abs() < 1e-4);
        assert_eq!(wilson(0.0, 0.0), None);
    }

    #[test]
    fn cases_are_counted_and_scored() {
        let mut cases = vec![case(true, 0.9), case(true, 0.2), case(false, 0.2), case(false, 0.6)];
        cases.push(Scored { truth: true, answer: None, p: None, weight: 1.0 });
        let tally = Tally::of(&cases);
        assert_eq!((tally.right(), tally.total(), tally.unanswered), (2.0, 5.0, 1.0));
        assert!((brier(&cases).unwrap() - (0.01 + 0.64 + 0.04 + 0.36) / 4.0).abs() < 1e-12);
        share_by(&mut cases, &["a", "a", "b", "c", "c"]);
        assert_eq!(Tally::of(&cases).total(), 3.0);
        assert_eq!(brier(&[]), None);
    }

    #[test]
    fn a_calibrated_crowd_lies_on_the_diagonal() {
        let cases: Vec<Scored> = (0..1000).map(|k| case(k % 10 < k / 100, f64::from(k / 100) / 10.0)).collect();
        let bins = reliability_equal(&cases, 10);
        assert_eq!(bins.len(), 10);
        assert!(miscalibration(&bins).unwrap() < 1e-9);
        let wide = reliability(&cases, 5);
        assert_eq!(wide.iter().map(|b| b.count).sum::<usize>(), 1000);
        assert!(wide.iter().all(|b| (b.mean_p - b.rate).abs() < 1e-9));
    }
}
