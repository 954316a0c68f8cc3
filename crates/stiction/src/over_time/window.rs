//! The result of each window, and its weight.

use serde::{Deserialize, Serialize};

use super::level::{HALF_WIDTH, Seen};
use super::scatter::Scatter;
use crate::core::verdict::{Assessment, Gate};

/// Result of one window; a field missing in a document is `None`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default)]
pub struct WindowResult {
    /// Start of the window, ns since 1970.
    pub start_ns: i64,
    /// End of the window and its name, ns since 1970.
    pub end_ns: i64,
    /// Whether the valve sticks; `None` if the window is inconclusive.
    pub stiction: Option<bool>,
    /// Probability of stiction for the prevalence of the document, 0..1.
    pub p_stiction: Option<f64>,
    /// The same where half of the valves stick, which the levels are found by; a document without it says so as `p_stiction`.
    pub p_calibrated: Option<f64>,
    /// Grade, A to D.
    pub grade: Option<char>,
    /// Dead band plus stick band, OP units.
    pub s: Option<f64>,
    /// 90 % interval of `s`.
    pub s_interval: Option<[f64; 2]>,
    /// Slip jump, OP units.
    pub j: Option<f64>,
    /// 90 % interval of `j`; the feasible set if j is not identifiable.
    pub j_interval: Option<[f64; 2]>,
    /// Whether the record identifies j.
    pub j_identifiable: Option<bool>,
    /// Validity checks by name.
    pub gates: Vec<String>,
}

impl From<&Assessment> for WindowResult {
    fn from(a: &Assessment) -> Self {
        Self {
            start_ns: a.window.start_ns,
            end_ns: a.window.end_ns,
            stiction: a.stiction,
            p_stiction: a.p_stiction,
            p_calibrated: a.p_calibrated,
            grade: a.grade,
            s: a.s,
            s_interval: a.s_interval,
            j: a.j,
            j_interval: a.j_interval,
            j_identifiable: a.j_identifiable,
            gates: a.gates.iter().map(|g: &Gate| g.name().to_owned()).collect(),
        }
    }
}

/// Bounds of a probability: the confidence of a single window is limited.
const SURE: [f64; 2] = [0.02, 0.98];
/// Probabilities assumed for windows without one: if no stiction was found, the classifier's average for a calm loop; if it was
/// found, the second value.
const PLAIN: [f64; 2] = [0.2, 0.9];
/// Multiplier of logits: the verdicts count more than their confidences.
const SHARPER: f64 = 3.0;
/// Least standard deviation of ln s, and the least share of s assumed for an interval's end.
const LEAST_SD: f64 = 0.01;
const LEAST_END: f64 = 0.05;

/// A window with an answer.
#[derive(Debug, Clone, Copy)]
pub(super) struct Point<'a> {
    pub result: &'a WindowResult,
    pub sticks: bool,
    pub p: f64,
    /// The probability with its weight in the stretch: sharpened and bounded.
    pub weighed: f64,
    /// Its share of the time it covers, shared with overlapping windows: 1 without overlap.
    pub share: f64,
    /// ln s if the window sticks and gives one.
    pub seen: Option<Seen>,
}

impl Point<'_> {
    /// Middle of the window, ns.
    pub const fn middle_ns(&self) -> i64 {
        self.result.start_ns + (self.result.end_ns - self.result.start_ns) / 2
    }
}

/// The windows with an answer, sorted by end.
#[derive(Debug)]
pub(super) struct History<'a> {
    pub points: Vec<Point<'a>>,
    pub scatter: Scatter,
}

impl<'a> History<'a> {
    pub fn of(windows: &'a [WindowResult]) -> Self {
        let answers = |w: &&WindowResult| w.stiction.is_some() && w.end_ns > w.start_ns;
        let mut kept: Vec<&WindowResult> = windows.iter().filter(answers).collect();
        kept.sort_by_key(|w| (w.end_ns, w.start_ns));
        // A window is identified by its end; the last result computed for it counts.
        kept.reverse();
        kept.dedup_by_key(|w| w.end_ns);
        kept.reverse();
        let shares = shares(&kept);
        let points = kept.iter().zip(shares).map(|(result, share)| {
            let sticks = result.stiction == Some(true);
            let told = result.p_calibrated.or(result.p_stiction).filter(|p| p.is_finite());
            let p = told.unwrap_or(PLAIN[usize::from(sticks)]);
            let odds = libm::pow(p.max(0.0) / (1.0 - p).max(f64::MIN_POSITIVE), SHARPER);
            let weighed = if odds.is_finite() { odds / (1.0 + odds) } else { 1.0 };
            let weighed = weighed.clamp(SURE[0], SURE[1]);
            let t_s = 0.5 * (result.end_ns - result.start_ns) as f64 * 1e-9
                + (result.start_ns - kept[0].start_ns) as f64 * 1e-9;
            let seen = if sticks { log_s(result) } else { None };
            let seen = seen.map(|(x, variance)| Seen { x, variance, share, t_s });
            Point { result, sticks, p, weighed, share, seen }
        });
        let mut points: Vec<Point<'a>> = points.collect();
        let sized = points.iter().filter_map(|p| p.seen.map(|s| (s, [p.result.start_ns, p.result.end_ns])));
        let scatter = Scatter::of(&sized.collect::<Vec<_>>());
        for seen in points.iter_mut().filter_map(|p| p.seen.as_mut()) {
            seen.share /= scatter.repeats;
        }
        Self { points, scatter }
    }
}

/// ln s with its variance.
fn log_s(w: &WindowResult) -> Option<(f64, f64)> {
    let (s, [low, high]) = (w.s?, w.s_interval?);
    let usable = s.is_finite() && s > 0.0 && low.is_finite() && high.is_finite() && low <= high;
    if !usable {
        return None;
    }
    let (low, high) = (low.clamp(LEAST_END * s, s), high.max(s));
    let sd = (libm::log(high / low) / (2.0 * HALF_WIDTH)).max(LEAST_SD);
    Some((libm::log(s), sd * sd))
}

/// Share of each window in the time it covers, with overlaps divided equally.
fn shares(windows: &[&WindowResult]) -> Vec<f64> {
    let mut edges: Vec<(i64, i32)> = windows.iter().flat_map(|w| [(w.start_ns, 1), (w.end_ns, -1)]).collect();
    edges.sort_unstable();
    // Time up to an edge, each moment divided by the windows that cover it, s.
    let (mut times, mut sums): (Vec<i64>, Vec<f64>) = (Vec::new(), Vec::new());
    let (mut open, mut sum, mut last) = (0, 0.0, None);
    for (at, step) in edges {
        if let Some(last) = last.filter(|_| open > 0) {
            sum += (at - last) as f64 * 1e-9 / f64::from(open);
        }
        open += step;
        last = Some(at);
        if times.last() == Some(&at) {
            sums.pop();
        } else {
            times.push(at);
        }
        sums.push(sum);
    }
    let at = |t: i64| times.binary_search(&t).map_or(0.0, |k| sums[k]);
    let share = |w: &&WindowResult| (at(w.end_ns) - at(w.start_ns)) / ((w.end_ns - w.start_ns) as f64 * 1e-9);
    windows.iter().map(share).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn window(start_ns: i64, end_ns: i64) -> WindowResult {
        WindowResult { start_ns, end_ns, stiction: Some(true), ..WindowResult::default() }
    }

    #[test]
    fn windows_share_what_they_overlap_in() {
        let share = |windows: &[WindowResult]| History::of(windows).points.iter().map(|p| p.share).collect::<Vec<_>>();
        let apart = share(&[window(0, 10), window(10, 20), window(50, 60)]);
        assert!(apart.iter().all(|s| (s - 1.0).abs() < 1e-12));
        // Half of each is shared, so both together count one and a half.
        let two = share(&[window(0, 10), window(5, 15)]);
        assert!(two.iter().all(|s| (s - 0.75).abs() < 1e-12));
        // Windows that start a quarter of their length apart, many times: a quarter each.
        let many: Vec<WindowResult> = (0..40).map(|k| window(5 * k, 5 * k + 20)).collect();
        let all = share(&many);
        assert!((all[20] - 0.25).abs() < 1e-12 && (all.iter().sum::<f64>() - (1.0 + 39.0 * 0.25)).abs() < 1e-9);
        // The same window twice counts once.
        assert_eq!(share(&[window(0, 10), window(0, 10)]), [1.0]);
    }

    #[test]
    fn a_window_without_an_answer_or_without_a_size_is_no_size() {
        let none = WindowResult { stiction: None, ..window(0, 10) };
        assert!(History::of(&[none, window(20, 20)]).points.is_empty());
        let sized = |s, s_interval| WindowResult { s, s_interval, ..window(0, 10) };
        assert!(log_s(&sized(Some(2.0), None)).is_none() && log_s(&sized(Some(0.0), Some([0.0, 1.0]))).is_none());
        assert!(log_s(&sized(Some(f64::NAN), Some([0.0, 1.0]))).is_none());
        let (x, variance) = log_s(&sized(Some(2.0), Some([1.0, 4.0]))).unwrap();
        assert!((x - libm::log(2.0)).abs() < 1e-12 && (variance.sqrt() - libm::log(4.0) / 3.29).abs() < 1e-12);
        // An interval that reaches down to zero is wide, not infinite.
        assert!(log_s(&sized(Some(2.0), Some([0.0, 2.0]))).unwrap().1 < 1.0);
    }
}
