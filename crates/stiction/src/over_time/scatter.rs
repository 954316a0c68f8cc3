//! Scatter of ln s between windows beyond the windows' own intervals, and how long it persists.
//!
//! Estimated from median squares of differences between windows, so a few changes of the valve hardly affect it.

use super::level::{Seen, halved};
use crate::core::signal::stats;

/// Least standard deviation of ln s between windows: valves vary from day to day.
const LEAST_BETWEEN: f64 = 0.03;
/// Median of chi-squared with one degree of freedom.
const CHI_MEDIAN: f64 = 0.454_936;
/// Number of windows without overlap between two that count as independent.
const FAR: f64 = 5.0;
/// Pairs without overlap needed to estimate the correlation, and the largest correlation accepted.
const ENOUGH: f64 = 20.0;
const MOST_MEMORY: f64 = 0.9;

/// Scatter between windows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scatter {
    /// Variance of ln s.
    pub between: f64,
    /// Number of pairs of windows used, overlap counted once; `None` if there are none.
    pub pairs: Option<f64>,
    /// Number of windows that carry the information of one independent window.
    pub repeats: f64,
}

impl Scatter {
    /// From sizes with the starts and ends of their windows, sorted by end.
    pub fn of(seen: &[(Seen, [i64; 2])]) -> Self {
        let least = LEAST_BETWEEN * LEAST_BETWEEN;
        let (near, pairs) = by_differences(seen, 0.0);
        if pairs == 0.0 {
            return Self { between: least, pairs: None, repeats: 1.0 };
        }
        let near = near.max(least);
        let alone = Self { between: near, pairs: Some(pairs), repeats: 1.0 };
        let (far, far_pairs) = by_differences(seen, FAR);
        if far_pairs < ENOUGH || far <= near {
            return alone;
        }
        // Total variances, including the windows' own: neighbours differ by 2 (1 - memory) times that.
        let own = stats::median(&seen.iter().map(|(s, _)| s.variance).collect::<Vec<f64>>());
        let memory = (1.0 - (near + own) / (far + own)).clamp(0.0, MOST_MEMORY);
        Self { between: far, repeats: (1.0 + memory) / (1.0 - memory), ..alone }
    }
}

/// Half the mean square of differences between windows this many lengths apart, minus the windows' own variances; and the
/// number of pairs.
fn by_differences(seen: &[(Seen, [i64; 2])], lengths_apart: f64) -> (f64, f64) {
    let (mut later, mut pairs, mut shares) = (0, Vec::new(), 0.0);
    for (k, (first, [start, end])) in seen.iter().enumerate() {
        let clear_ns = end.saturating_add((lengths_apart * (end - start) as f64) as i64);
        later = later.max(k + 1);
        while seen.get(later).is_some_and(|(_, [start, _])| *start < clear_ns) {
            later += 1;
        }
        let Some((second, _)) = seen.get(later) else { break };
        let difference = second.x - first.x;
        pairs.push((difference * difference, first.variance + second.variance));
        shares += first.share;
    }
    let median = |between: f64| {
        let scaled: Vec<f64> = pairs.iter().map(|(d2, v)| d2 / (v + 2.0 * between)).collect();
        stats::median(&scaled)
    };
    let most = pairs.iter().map(|p| p.0).fold(0.0, f64::max) / CHI_MEDIAN;
    if pairs.is_empty() || most == 0.0 {
        return (0.0, shares);
    }
    (halved([0.0, most], |between| median(between) > CHI_MEDIAN), shares)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sim::noise::{Ar1, Noise};

    fn scatter(time_constant: f64, between: f64) -> Scatter {
        let (mut walk, mut own) = (Ar1::new(between, time_constant, Noise::new(1, 0)), Noise::new(1, 1));
        let seen = (0..400).map(|k: i64| {
            let x = walk.next_value() + 0.1 * own.gaussian();
            (Seen { x, variance: 0.01, share: 1.0, t_s: k as f64 }, [10 * k, 10 * k + 10])
        });
        Scatter::of(&seen.collect::<Vec<_>>())
    }

    #[test]
    fn what_lies_between_windows_and_its_memory_are_told() {
        let plain = scatter(0.0, 0.3);
        assert!((plain.between.sqrt() - 0.3).abs() < 0.06 && plain.repeats < 1.6, "{plain:?}");
        let slow = scatter(3.0, 0.3);
        assert!((slow.between.sqrt() - 0.3).abs() < 0.1 && slow.repeats > 2.0, "{slow:?}");
        let nothing = scatter(0.0, 0.0);
        assert!(nothing.between.sqrt() < 0.06, "{nothing:?}");
        let none = Scatter::of(&[]);
        assert_eq!((none.pairs, none.repeats), (None, 1.0));
    }
}
