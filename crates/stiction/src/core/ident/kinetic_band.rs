//! The best kinetic band and gain for given slips: both are linear in the two halves of the valve signal, so they are solved
//! for, not searched (variable projection, Golub and Pereyra 1973).

use super::class::Limits;
use super::normalised::{MOST_OVERSHOOT, SlipEnd};

/// Constraints of a fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Freedom {
    /// Range of fd that belongs to the current slips.
    pub fd: [f64; 2],
    /// fd to use if the data do not determine it.
    pub fd_default: f64,
    /// Required sign of the gain.
    pub sign: f64,
    /// Limits of time constants and lag.
    pub limits: Limits,
}

/// Fewest moves of the stem for which a model is fitted.
pub(crate) const MIN_SLIPS: usize = 3;

/// Range of fd at (s, j) for slips with these cells of s and j.
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

/// Squared error as a function of fd: a ratio of quadratics.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BandProfile {
    uu: f64,
    ud: f64,
    dd: f64,
    uy: f64,
    dy: f64,
    yy: f64,
}

impl BandProfile {
    /// From the products as in [`best_band`], and the squares of which gain and band explain a part.
    #[must_use]
    pub(crate) const fn new([uu, ud, dd, uy, dy]: [f64; 5], yy: f64) -> Self {
        Self { uu, ud, dd, uy, dy, yy }
    }

    /// Squared error with the best gain for this fd.
    #[must_use]
    pub(crate) fn sse(&self, fd: f64) -> f64 {
        let power = self.uu - 2.0 * fd * self.ud + fd * fd * self.dd;
        let along = self.uy - fd * self.dy;
        if power > 1e-12 * (self.uu + fd * fd * self.dd) { self.yy - along * along / power } else { self.yy }
    }

    /// Standard error of fd with a free gain, for white residuals of this variance; infinite if the data cannot separate fd
    /// from the gain.
    #[must_use]
    pub(crate) fn error(&self, fd: f64, variance: f64, gain: f64) -> f64 {
        let power = self.uu - 2.0 * fd * self.ud + fd * fd * self.dd;
        let along = self.ud - fd * self.dd;
        let own = self.dd - along * along / power;
        if own.is_nan() || own <= 1e-6 * self.dd || gain == 0.0 {
            f64::INFINITY
        } else {
            (variance / own).sqrt() / gain.abs()
        }
    }

    /// Whether fd only scales the response, so that the gain compensates for it.
    #[must_use]
    pub(crate) fn is_flat(&self) -> bool {
        self.uu * self.dd - self.ud * self.ud <= 1e-6 * self.uu * self.dd
    }
}

/// Gain, fd and explained squares from the remaining products of the two halves of the valve signal, `at` and `direction`, and
/// the target (at·at, at·direction, direction·direction, at·target, direction·target): the explained part is a ratio of
/// quadratics in fd, so its maximum is at the free optimum or at an end of the band. A signal has no gain if removing the
/// process's memory leaves next to nothing of its squares (`whole` before the removal).
#[inline]
pub(crate) fn best_band([uu, ud, dd, uy, dy]: [f64; 5], whole: [f64; 2], freedom: &Freedom) -> (f64, f64, f64) {
    let [low, high] = freedom.fd;
    let determinant = uu * dd - ud * ud;
    let free = if determinant > 1e-6 * uu * dd {
        let gain = dd * uy - ud * dy;
        let fd = -(uu * dy - ud * uy) / gain;
        if fd.is_finite() { Some(fd.clamp(low, high)) } else { None }
    } else {
        None
    };
    let consider = |best: (f64, f64, f64), fd: f64| {
        let power = uu - 2.0 * fd * ud + fd * fd * dd;
        let along = uy - fd * dy;
        let explained = along * along / power;
        let counts = power > 1e-11 * (whole[0] + fd * fd * whole[1]) && along * freedom.sign > 0.0;
        if counts && explained > best.2 { (along / power, fd, explained) } else { best }
    };
    let none = (0.0, freedom.fd_default, 0.0);
    let Some(fd) = free else { return consider(none, freedom.fd_default.clamp(low, high)) };
    let best = consider(none, fd);
    // Inside the band the free optimum beats both ends, if its gain has the requested sign.
    if best.2 > 0.0 && fd > low && fd < high {
        return best;
    }
    consider(consider(best, low), high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::signal::stats::dot;
    use crate::core::sim::slips::{FirstSlip, Law};
    use crate::core::sim::steps::Path;

    #[test]
    fn slips_beyond_op_leave_a_band_below_zero_open() {
        let path: Vec<f64> = (0..600).map(|k| libm::sin(f64::from(k) * 0.05)).collect();
        let (s, j) = (0.3, 0.7);
        let first = FirstSlip { direction: 1.0, threshold: 0.2 };
        let (_, steps) = Path::new(path, 1).stem(Law::He, [s, j], 0.0, first);
        let cells = [steps.s_cell, steps.j_cell];
        let limits = Limits { tau: [0.3, 500.0], lag: [0.0, 25.0] };
        let open = band_freedom(cells, [s, j], 1.0, limits, SlipEnd::Beyond);
        assert!(open.fd[0] < -0.2 && open.fd[0] <= open.fd_default && open.fd_default <= open.fd[1], "{open:?}");
        let short = band_freedom(cells, [s, 0.1], 1.0, limits, SlipEnd::Short);
        assert!(short.fd[0] >= 0.0);
    }

    #[test]
    fn gain_and_band_are_read_from_the_products_and_a_wrong_sign_is_refused() {
        let at: Vec<f64> =
            (0..200).map(|k| libm::sin(f64::from(k) * 0.11) + 0.3 * libm::sin(f64::from(k) * 0.037)).collect();
        let direction: Vec<f64> = (0..200).map(|k| if k / 17 % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let y: Vec<f64> = at.iter().zip(&direction).map(|(a, d)| 2.5 * (a - 0.2 * d)).collect();
        let system = [(&at, &at), (&at, &direction), (&direction, &direction), (&at, &y), (&direction, &y)]
            .map(|(x, y)| dot(x, y));
        let whole = [system[0], system[2]];
        let limits = Limits { tau: [0.3, 500.0], lag: [0.0, 25.0] };
        let within = |fd: [f64; 2], sign: f64| Freedom { fd, fd_default: 0.0, sign, limits };
        let (gain, fd, explained) = best_band(system, whole, &within([0.0, 0.5], 1.0));
        assert!((gain - 2.5).abs() < 1e-9 && (fd - 0.2).abs() < 1e-9 && (explained / dot(&y, &y) - 1.0).abs() < 1e-9);
        assert_eq!(best_band(system, whole, &within([0.0, 0.1], 1.0)).1, 0.1);
        assert_eq!(best_band(system, whole, &within([0.0, 0.5], -1.0)), (0.0, 0.0, 0.0));
    }
}
