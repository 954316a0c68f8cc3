//! The gap by what the stem did last: at rest, slipped, moving; up or down; and slips that model and plant do not share.

use super::held::Held;
use super::{Direction, Phases, SlipCount, Test};
use crate::core::gap::noise::least_squares::line;
use crate::core::signal::stats;

/// A step of the stem's error counts from this share of the median slip on, and from so many standard errors on.
const LEAST_STEP: f64 = 0.5;
const LEAST_ERRORS: f64 = 4.0;

/// Moves at neighbouring points that are a slide.
const MIN_ROW: usize = 3;

const STUCK: usize = 0;
const SLIP: usize = 1;
const MOVING: usize = 2;

/// What the model's stem did last, per point.
pub(super) struct Steps {
    /// Points after a move that count as just moved.
    pub window: usize,
    phase: Vec<usize>,
    /// Direction of the last move; `None` where the stem never moves.
    up: Option<Vec<bool>>,
}

/// Moves of the model's stem: point and direction.
fn moves(held: &Held<'_>) -> Vec<(usize, f64)> {
    let fit = held.fit;
    if fit.model.valve.law != "none" && !fit.slips.is_empty() {
        return fit.slips.iter().map(|s| (s.point, s.direction)).collect();
    }
    let steps = fit.valve.windows(2).map(|w| w[1] - w[0]).enumerate();
    steps.filter(|(_, d)| d.is_finite() && *d != 0.0).map(|(k, d)| (k + 1, d.signum())).collect()
}

impl Steps {
    /// Reads them from the model.
    pub(crate) fn of(held: &Held<'_>) -> Self {
        let n = held.residual.len();
        let window = (held.fit.model.process.answer_s() / held.point_s).round().clamp(1.0, n.max(1) as f64) as usize;
        let moves = moves(held);
        let slides = sliding(&moves);
        let mut phase = vec![STUCK; n];
        let mut up = vec![moves.first().is_some_and(|m| m.1 < 0.0); n];
        for (i, (at, direction)) in moves.iter().enumerate() {
            let end = moves.get(i + 1).map_or(n, |next| next.0.min(n));
            let kind = if slides[i] { MOVING } else { SLIP };
            let at = (*at).min(end);
            phase[at..end.min(at + window + 1)].fill(kind);
            phase[end.min(at + window + 1)..end].fill(STUCK);
            up[at..end].fill(*direction > 0.0);
        }
        Self { window, phase, up: (!moves.is_empty()).then_some(up) }
    }
}

/// Whether each move is one of a row of moves at neighbouring points: two may be one slip, seen by a box on each side.
fn sliding(moves: &[(usize, f64)]) -> Vec<bool> {
    let row = |pair: &[(usize, f64)]| pair[1].0.saturating_sub(pair[0].0) <= 1 && pair[1].1 == pair[0].1;
    let mut slides = vec![false; moves.len()];
    let mut start = 0;
    for i in 1..=moves.len() {
        if i == moves.len() || !row(&moves[i - 1..=i]) {
            slides[start..i].fill(i - start >= MIN_ROW);
            start = i;
        }
    }
    slides
}

/// Shares by phase, the same of the points, and the test.
pub(super) fn phases(held: &Held<'_>, steps: &Steps) -> (Phases, Phases, Option<Test>) {
    let shares = held.shares("phases", 3, |k| steps.phase[k]);
    let as_phases = |x: &dyn Fn(usize) -> Option<f64>| Phases { stuck: x(STUCK), slip: x(SLIP), moving: x(MOVING) };
    let expected = as_phases(&|i| shares.share[i].is_some().then_some(shares.expected[i]));
    (as_phases(&|i| shares.share[i]), expected, shares.test)
}

/// Shares by direction, mean square up over down, and the test.
pub(super) fn direction(held: &Held<'_>, steps: &Steps) -> (Direction, Option<f64>, Option<Test>) {
    let Some(up) = &steps.up else {
        return (Direction { up: None, down: None }, None, None);
    };
    let shares = held.shares("direction", 2, |k| usize::from(!up[k]));
    let density = |i: usize| shares.share[i].map(|s| s / shares.expected[i]);
    let ratio = density(0).zip(density(1)).and_then(|(up, down)| (down > 0.0).then(|| up / down));
    (Direction { up: shares.share[0], down: shares.share[1] }, ratio, shares.test)
}

/// How far the plant's stem is from the model's, and how well that is known.
struct StemError {
    /// Per point, OP units.
    error: Vec<f64>,
    /// First point at which it is known.
    from: usize,
    /// Points that are averaged on each side of a step.
    width: usize,
    /// Standard error of a step's height, OP units.
    step_sd: f64,
    /// Points by which a step shows after the stem's move.
    late: f64,
}

/// From the residual: the process turned round, `(tau de/dt + e) / gain`, is the valve signal that is missing.
fn from_residual(held: &Held<'_>, noise_floor: Option<f64>) -> Option<StemError> {
    let process = &held.fit.model.process;
    let tau = process.time_constants_s.iter().sum::<f64>() / held.point_s;
    let e = &held.residual;
    // An integrating process gives its slope alone; its gain counts a second.
    let (gain, slope, level) =
        if process.integrating { (process.gain * held.point_s, 1.0, 0.0) } else { (process.gain, tau, 1.0) };
    let width = (0.5 * tau).clamp(2.0, (held.period / 6.0).max(2.0)).round();
    let sd = noise_floor.unwrap_or_else(|| stats::noise_sd(&held.values())) / gain.abs();
    let wanted = |w: &[f64]| (slope * (w[1] - w[0]) + level * w[1]) / gain;
    (gain.is_normal() && sd.is_finite()).then(|| StemError {
        error: core::iter::once(0.0).chain(e.windows(2).map(wanted)).collect(),
        from: held.from + 1,
        width: width as usize,
        step_sd: sd * (6.0 * slope * slope / (width * width) + 2.0 * level / width).sqrt(),
        late: process.dead_time_s / held.point_s,
    })
}

/// From the recorded position, scaled to the model's.
fn from_position(held: &Held<'_>, mv: &[f64]) -> Option<StemError> {
    let valve = &held.fit.valve;
    let (mx, my) = (stats::mean(valve), stats::mean(mv));
    let [slope, _] = line(valve, mv);
    let width = 2;
    (slope.is_normal() && mv.len() == valve.len()).then(|| StemError {
        error: valve.iter().zip(mv).map(|(v, m)| (m - my) / slope - (v - mx)).collect(),
        from: held.from,
        width,
        step_sd: stats::noise_sd(mv) / slope.abs(),
        late: 0.0,
    })
}

/// Slips that the plant made and the model did not, and the other way round, over all that counts, fitted or held out.
/// `None` where the model has no slips, or where one of its slips would drown in the noise.
pub(super) fn slips(held: &Held<'_>, mv: Option<&[f64]>, noise_floor: Option<f64>) -> SlipCount {
    let none = SlipCount { missed: None, extra: None };
    let sizes: Vec<f64> = held.fit.slips.iter().map(|s| s.size).collect();
    let found = match mv {
        Some(mv) => from_position(held, mv),
        None => from_residual(held, noise_floor),
    };
    let Some(stem) = found else { return none };
    let usual = stats::median(&sizes);
    if sizes.is_empty() || held.fit.model.valve.law == "none" || usual <= LEAST_ERRORS * stem.step_sd {
        return none;
    }
    let mut used = vec![false; held.fit.slips.len()];
    let (mut missed, mut extra) = (0, 0);
    for (point, height) in steps_of(&stem, (LEAST_STEP * usual).max(LEAST_ERRORS * stem.step_sd)) {
        let moved_at = point as f64 - stem.late;
        let undoes = |i: &usize| {
            let slip = &held.fit.slips[*i];
            !used[*i]
                && slip.direction * height < 0.0
                && (slip.point as f64 - moved_at).abs() <= stem.width as f64 + 1.0
        };
        match (0..used.len()).find(undoes) {
            Some(i) => {
                used[i] = true;
                extra += 1;
            }
            None => missed += 1,
        }
    }
    SlipCount { missed: Some(missed), extra: Some(extra) }
}

/// Steps of the stem's error above a height, the largest first, each with what lies around it left out.
fn steps_of(stem: &StemError, least: f64) -> Vec<(usize, f64)> {
    let w = stem.width;
    let sums: Vec<f64> = core::iter::once(0.0)
        .chain(stem.error.iter().scan(0.0, |sum, e| {
            *sum += e;
            Some(*sum)
        }))
        .collect();
    let mean = |from: usize, to: usize| (sums[to] - sums[from]) / (to - from) as f64;
    let last = stem.error.len().saturating_sub(w);
    let height = |k: usize| mean(k, k + w) - mean(k - w, k);
    let mut all: Vec<(usize, f64)> = (stem.from + w..=last).map(|k| (k, height(k))).collect();
    all.retain(|(_, h)| h.abs() >= least);
    all.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
    let mut taken = vec![false; stem.error.len() + 1];
    let mut steps = Vec::new();
    for (k, h) in all {
        if !taken[k] {
            taken[k.saturating_sub(w)..(k + w + 1).min(stem.error.len() + 1)].fill(true);
            steps.push((k, h));
        }
    }
    steps
}
