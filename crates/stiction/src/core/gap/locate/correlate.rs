//! Correlations of the residual with the input and its functions.
//!
//! Only what came earlier counts, or stands at the same point: under feedback the residual goes into OP afterwards
//! (Ljung 1999, ch. 16). Even and odd functions of the input beside it see what plain correlation cannot (Billings and
//! Zhu 1994, Int. J. Control 60: 1107).

use super::Correlate;
use super::held::Held;
use crate::core::signal::stats;

/// Lags tried, from none to dead time and three time constants.
const LAGS: usize = 12;

/// A signal at the held points, `lag` points earlier, centred and of unit power; `None` where it stands still.
fn earlier(signal: &[f64], held: &Held<'_>, lag: usize) -> Option<Vec<f64>> {
    let at: Vec<f64> = held.points.iter().map(|&k| signal.get(k.saturating_sub(lag)).copied().unwrap_or(0.0)).collect();
    unit(&at)
}

fn unit(x: &[f64]) -> Option<Vec<f64>> {
    let m = stats::mean(x);
    let centred: Vec<f64> = x.iter().map(|v| v - m).collect();
    let norm = stats::dot(&centred, &centred).sqrt();
    (norm.is_normal() && x.len() > 2).then(|| centred.iter().map(|v| v / norm).collect())
}

fn lags(held: &Held<'_>) -> Vec<usize> {
    let longest = held.fit.dead_time_s + 3.0 * held.fit.time_constants_s.iter().sum::<f64>();
    let longest = (longest / held.point_s).min(2.0 * held.period).min(0.25 * held.residual.len() as f64);
    let mut all: Vec<usize> =
        (0..LAGS).map(|i| (longest.max(0.0) * i as f64 / (LAGS - 1) as f64).round() as usize).collect();
    all.dedup();
    all
}

/// One correlation, at the lag where it is largest.
fn correlate(held: &Held<'_>, name: &str, target: &[f64], signal: &[f64]) -> Option<Correlate> {
    let target = unit(target)?;
    let lags = lags(held);
    let columns: Vec<(usize, Vec<f64>)> =
        lags.into_iter().filter_map(|lag| Some((lag, earlier(signal, held, lag)?))).collect();
    let strongest = |e: &[f64]| {
        let each = columns.iter().map(|(lag, c)| (*lag, stats::dot(e, c)));
        each.fold((0, 0.0_f64), |best, x| if x.1.abs() > best.1.abs() { x } else { best })
    };
    let (lag, value) = strongest(&target);
    let test = held.test(name, &target, |e| strongest(e).1.abs())?;
    (value != 0.0).then(|| Correlate {
        name: name.to_owned(),
        value,
        lag_s: lag as f64 * held.point_s,
        threshold: test.threshold,
        p: test.p,
    })
}

/// All correlations, the least likely by chance first, then the strongest.
pub(super) fn correlates(held: &Held<'_>) -> Vec<Correlate> {
    let u = {
        let m = stats::mean(&held.op);
        held.op.iter().map(|v| v - m).collect::<Vec<_>>()
    };
    let map = |f: fn(f64) -> f64| u.iter().map(|v| f(*v)).collect::<Vec<_>>();
    let moves: Vec<f64> = core::iter::once(0.0).chain(u.windows(2).map(|w| w[1] - w[0])).collect();
    let sign: Vec<f64> = moves.iter().map(|d| if *d == 0.0 { 0.0 } else { d.signum() }).collect();
    let squared = map(|v| v * v);
    let (values, squares) = (held.values(), held.squares());
    let asked: [(&str, &[f64], &[f64]); 7] = [
        ("op", &values, &u),
        ("op_move", &values, &moves),
        ("pv", &values, &held.fit.prediction),
        ("op_abs", &values, &map(f64::abs)),
        ("op_squared", &values, &squared),
        ("op_move_sign", &values, &sign),
        ("squared_with_op_squared", &squares, &squared),
    ];
    let mut found: Vec<Correlate> =
        asked.into_iter().filter_map(|(name, target, signal)| correlate(held, name, target, signal)).collect();
    found.sort_by(|a, b| a.p.total_cmp(&b.p).then(b.value.abs().total_cmp(&a.value.abs())));
    found
}
