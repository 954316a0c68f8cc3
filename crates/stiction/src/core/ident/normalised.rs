//! Normalised records, the input of every fit: OP in spans, PV in standard deviations, times in points.

use std::ops::Range;
use std::sync::Arc;

use super::choice::{DelayChoice, Options};
use super::class::Limits;
use super::no_fit::NoFit;
use crate::core::record::Record;
use crate::core::signal::stats;
use crate::core::sim::slips::{FirstSlip, Stroke};
use crate::core::sim::steps::Path;

/// A record in normalised form: OP in spans, PV in standard deviations.
#[derive(Debug, Clone)]
pub struct NormalisedRecord {
    /// Path of OP, centred, in units of its robust span.
    pub path: Arc<Path>,
    /// OP averaged over each point.
    pub mean: Vec<f64>,
    /// PV minus its mean, over its standard deviation.
    pub pv: Vec<f64>,
    /// OP's robust span, OP units.
    pub span: f64,
    /// PV's standard deviation, PV units.
    pub deviation: f64,
    /// Limits of the process's shape, points.
    pub limits: Limits,
    /// First counted point.
    pub from: usize,
    /// Characteristic time, points: a period, or a fifth of the record without an oscillation.
    pub period: f64,
    /// Typical speed of OP, spans per point.
    pub rate: f64,
    /// OP's running maxima, then minima: a first slip happens at one of them.
    pub extremes: [Vec<f64>; 2],
    /// Elements of the valve in addition to its law.
    pub stroke: Stroke,
    /// Whether slips end short of OP or beyond it.
    pub slip_end: SlipEnd,
}

/// Where a slip ends, and thus on which side of s the jump j lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SlipEnd {
    /// Short of OP or at it: fd >= 0, j <= s.
    #[default]
    Short,
    /// Beyond OP: fd < 0, j >= s.
    Beyond,
}

/// Largest |fd| / fs of a stem that ends beyond OP.
pub(crate) const MOST_OVERSHOOT: f64 = 0.95;

impl SlipEnd {
    /// Maps a jump from the triangle 0 < j <= s, which searches use, to this side.
    #[must_use]
    pub(crate) fn jump(self, s: f64, j: f64) -> f64 {
        match self {
            Self::Short => j,
            Self::Beyond => s * s / j.max(1e-3 * s),
        }
    }

    /// The nearest jump that is possible with s.
    #[must_use]
    pub(crate) fn keep(self, s: f64, j: f64) -> f64 {
        match self {
            Self::Short => j.clamp(0.0, s.max(0.0)),
            Self::Beyond => j.max(s),
        }
    }
}

impl NormalisedRecord {
    /// The normalised form of a record that can be fitted.
    ///
    /// # Errors
    /// The first requirement that the record fails.
    pub(crate) fn of(record: &Record, options: &Options) -> Result<Self, NoFit> {
        NoFit::check(record)?;
        Ok(normalise(record, options, stats::span(&record.op_path), stats::std_dev(&record.pv)))
    }

    /// Running maxima and minima of OP from its first value on.
    pub(crate) fn running_extremes(path: &[f64]) -> [Vec<f64>; 2] {
        let first = path.first().copied().unwrap_or(0.0);
        let mut out = [vec![first], vec![first]];
        for &op in path {
            for (list, sign) in out.iter_mut().zip([1.0, -1.0]) {
                if list.last().is_some_and(|r| sign * (op - r) > 0.0) {
                    list.push(op);
                }
            }
        }
        out
    }

    /// A section of the record as a separate record.
    #[must_use]
    pub(crate) fn cut(&self, points: Range<usize>) -> Self {
        let m = self.path.per_point();
        let path = self.path.values()[points.start * m..points.end * m].to_vec();
        Self {
            extremes: Self::running_extremes(&path),
            path: Arc::new(Path::new(path, m)),
            mean: self.mean[points.clone()].to_vec(),
            pv: self.pv[points].to_vec(),
            ..*self
        }
    }

    /// The first slip that `start` describes.
    #[must_use]
    pub(crate) fn first_slip(&self, start: Start) -> FirstSlip {
        let list = &self.extremes[usize::from(!start.up)];
        let direction = if start.up { 1.0 } else { -1.0 };
        let threshold = match start.extreme.min(list.len() - 1) {
            0 => list[0] - direction * 1e-9,
            r => list[r - 1] + start.place * (list[r] - list[r - 1]),
        };
        FirstSlip { direction, threshold }
    }

    /// A start `later` points later, as far as OP reaches new extremes there.
    #[must_use]
    pub(crate) fn moved_start(&self, start: Start, later: f64) -> Start {
        let last = self.extremes[usize::from(!start.up)].len().saturating_sub(1);
        let by = (later * self.path.per_point() as f64).round();
        let extreme = (start.extreme as f64 + by).clamp(0.0, last as f64) as usize;
        Start { extreme, ..start }
    }
}

/// The running extreme of OP at which the first slip occurs, and the position of the threshold between the previous extreme and
/// this one (0..1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Start {
    /// The slip goes up, at a running maximum.
    pub up: bool,
    /// Index of the extreme; 0 slips at the first value.
    pub extreme: usize,
    /// Position of the threshold.
    pub place: f64,
}

/// Rounds to a grid of 2^-24, far finer than any recording: shifting or scaling a record changes its normalised values in the
/// last bits only, and rounding removes these changes, so that every search takes the same path.
fn on_grid(x: f64) -> f64 {
    const GRID: f64 = 16_777_216.0;
    (x * GRID).round() / GRID
}

/// Dead times up to this are always searched, points: a record cannot resolve anything finer.
const FINEST: f64 = 3.0;

/// The record in normalised form with this span of OP and this standard deviation of PV.
pub(crate) fn normalise(record: &Record, options: &Options, span: f64, deviation: f64) -> NormalisedRecord {
    let (n, m) = (record.len(), record.path_per_point());
    let middle = stats::mean(&record.op_path);
    let path: Vec<f64> = record.op_path.iter().map(|u| on_grid((u - middle) / span)).collect();
    let mean: Vec<f64> = path.chunks_exact(m).map(stats::mean).collect();
    let level = stats::mean(&record.pv);
    let pv = record.pv.iter().map(|p| on_grid((p - level) / deviation)).collect();
    let period = options.period_points.unwrap_or(n as f64 / 5.0).clamp(6.0, n as f64);
    let period = (16.0 * period).round() / 16.0;
    let raw = 1.0 / record.box_samples as f64;
    let longest = options.longest_dead_time_s / record.point_s() + raw;
    let most = (0.4 * period).clamp(6.0, 120.0).min(n as f64 / 6.0).min(longest.max(FINEST + raw));
    let lag = match options.delay {
        DelayChoice::Auto => [raw, most],
        DelayChoice::Samples(d) => [raw * (d.max(0.0) + 1.0); 2],
        DelayChoice::Seconds(d) => [raw * (d.max(0.0) / record.ts_s + 1.0); 2],
    };
    let lag = lag.map(|l| l.min(0.5 * n as f64));
    let from = (lag[1].ceil() as usize + 1).min(n / 2);
    let limits = Limits { tau: [0.3, (3.0 * n as f64).max(500.0)], lag };
    let extremes = NormalisedRecord::running_extremes(&path);
    let width = ((period / 32.0) as usize).max(1);
    let travel: Vec<f64> = mean.windows(width + 1).map(|w| (w[width] - w[0]).abs() / width as f64).collect();
    let rate = stats::median(&travel);
    NormalisedRecord {
        path: Arc::new(Path::new(path, m)),
        mean,
        pv,
        span,
        deviation,
        limits,
        from,
        period,
        rate,
        extremes,
        stroke: Stroke::FREE,
        slip_end: SlipEnd::Short,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slip_end_keeps_jumps_on_its_side_and_reaches_all_of_them() {
        for (s, j) in [(0.4, 0.1), (0.4, 0.4), (0.02, 0.005)] {
            assert_eq!(SlipEnd::Short.jump(s, j), j);
            let beyond = SlipEnd::Beyond.jump(s, j);
            assert!(beyond >= s && (SlipEnd::Beyond.jump(s, beyond) - j).abs() < 1e-12);
            assert_eq!(SlipEnd::Beyond.keep(s, beyond), beyond);
        }
        assert_eq!(SlipEnd::Short.keep(0.3, 0.5), 0.3);
        assert_eq!(SlipEnd::Beyond.keep(0.3, 0.1), 0.3);
    }
}
