//! One candidate: a pair (s, j) and a first slip, the slips they make of OP, and the process model that fits best.

use super::class::Limits;
use super::kinetic_band::Freedom;
use crate::sim::slips::{FirstSlip, Sequence, Stroke};
use std::ops::Range;

/// A record in normalised form: OP in spans, PV in standard deviations.
#[derive(Debug, Clone)]
pub struct NormalisedRecord {
    /// OP on its way, `n * per_point` values, centred, in units of its robust span.
    pub path: Vec<f64>,
    /// OP values a point.
    pub per_point: usize,
    /// OP averaged over each point.
    pub mean: Vec<f64>,
    /// PV less its mean, over its standard deviation.
    pub pv: Vec<f64>,
    /// Limits of the process' shape, points.
    pub limits: Limits,
    /// First point that counts.
    pub from: usize,
    /// A typical time, points: a period, or a fifth of the record where nothing oscillates.
    pub period: f64,
    /// How fast OP usually moves, spans a point.
    pub rate: f64,
    /// OP's running maxima, then minima: the places where a first slip can happen.
    pub records: [Vec<f64>; 2],
    /// What the valve has beside its law.
    pub stroke: Stroke,
    /// Where its slips end.
    pub slip_end: SlipEnd,
}

/// Where a slip ends, so on which side of s the jump j lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SlipEnd {
    /// Short of OP or on it: fd >= 0, j <= s.
    #[default]
    Short,
    /// Beyond OP: fd < 0, j >= s.
    Beyond,
}

/// Largest fd over fs, in size, of a stem that lands beyond OP.
pub(crate) const MOST_OVERSHOOT: f64 = 0.95;

impl SlipEnd {
    /// The jump of this side for one of the other triangle, 0 < j <= s, which searches are made for.
    #[must_use]
    pub(crate) fn jump(self, s: f64, j: f64) -> f64 {
        match self {
            Self::Short => j,
            Self::Beyond => s * s / j.max(1e-3 * s),
        }
    }

    /// The nearest jump that goes with s.
    #[must_use]
    pub(crate) fn keep(self, s: f64, j: f64) -> f64 {
        match self {
            Self::Short => j.clamp(0.0, s.max(0.0)),
            Self::Beyond => j.max(s),
        }
    }
}

impl NormalisedRecord {
    /// Running maxima (or minima) of OP from its first value on.
    pub(crate) fn records_of(path: &[f64]) -> [Vec<f64>; 2] {
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

    /// Some of its points, as a record of their own.
    #[must_use]
    pub(crate) fn cut(&self, points: Range<usize>) -> Self {
        let path = self.path[points.start * self.per_point..points.end * self.per_point].to_vec();
        Self {
            records: Self::records_of(&path),
            path,
            mean: self.mean[points.clone()].to_vec(),
            pv: self.pv[points].to_vec(),
            ..*self
        }
    }

    /// The first slip that `start` stands for.
    #[must_use]
    pub(crate) fn first_slip(&self, start: Start) -> FirstSlip {
        let list = &self.records[usize::from(!start.up)];
        let direction = if start.up { 1.0 } else { -1.0 };
        let threshold = match start.record.min(list.len() - 1) {
            0 => list[0] - direction * 1e-9,
            r => list[r - 1] + start.place * (list[r] - list[r - 1]),
        };
        FirstSlip { direction, threshold }
    }

    /// A start some points `later`, as far as OP goes on to new records there.
    #[must_use]
    pub(crate) fn moved_start(&self, start: Start, later: f64) -> Start {
        let last = self.records[usize::from(!start.up)].len().saturating_sub(1);
        let by = (later * self.per_point as f64).round();
        let record = (start.record as f64 + by).clamp(0.0, last as f64) as usize;
        Start { record, ..start }
    }
}

/// Which of OP's records brings the first slip, and where between the record before and it the threshold lies (0..1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Start {
    /// Upwards, at a running maximum.
    pub up: bool,
    /// Which record; 0 slips at the first value.
    pub record: usize,
    /// Place of the threshold.
    pub place: f64,
}

/// Fewest moves of the stem from which a model is fitted.
pub(crate) const MIN_SLIPS: usize = 3;

/// The bands fd that the slips of `sequence` leave open to (s, j).
#[must_use]
pub(crate) fn freedom(sequence: &Sequence, bands: [f64; 2], sign: f64, limits: Limits, slip_end: SlipEnd) -> Freedom {
    band_freedom([sequence.s_cell, sequence.j_cell], bands, sign, limits, slip_end)
}

/// The bands fd that slips with these cells of s and j leave open to (s, j).
#[must_use]
pub(crate) fn band_freedom(
    cells: [[f64; 2]; 2],
    [s, j]: [f64; 2],
    sign: f64,
    limits: Limits,
    slip_end: SlipEnd,
) -> Freedom {
    let [[s_low, s_high], [j_low, j_high]] = cells;
    let s_high = if s_high.is_finite() { s_high } else { s.max(1.0) };
    let low = match slip_end {
        SlipEnd::Short => (0.5 * (s_low - j_high.min(s_high))).max(0.0),
        SlipEnd::Beyond => {
            let j_high = if j_high.is_finite() { j_high } else { j.max(3.0 * s) };
            (0.5 * (s_low - j_high)).max(-MOST_OVERSHOOT * 0.5 * (s + j))
        }
    };
    let high = (0.5 * (s_high - j_low)).max(low);
    Freedom { fd: [low, high], fd_default: (0.5 * (s - j)).clamp(low, high), sign, limits }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::slips::Law;

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

    #[test]
    fn slips_beyond_op_leave_a_band_below_zero_open() {
        let path: Vec<f64> = (0..600).map(|k| libm::sin(f64::from(k) * 0.05)).collect();
        let mut sequence = Sequence::default();
        let (s, j) = (0.3, 0.7);
        sequence.run(Law::He, &path, 1, s, j, FirstSlip { direction: 1.0, threshold: 0.2 });
        let limits = Limits { tau: [0.3, 500.0], lag: [0.0, 25.0] };
        let open = freedom(&sequence, [s, j], 1.0, limits, SlipEnd::Beyond);
        assert!(open.fd[0] < -0.2 && open.fd[0] <= open.fd_default && open.fd_default <= open.fd[1], "{open:?}");
        let short = freedom(&sequence, [s, 0.1], 1.0, limits, SlipEnd::Short);
        assert!(short.fd[0] >= 0.0);
    }
}
