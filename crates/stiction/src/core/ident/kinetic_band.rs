//! The kinetic band and the gain that fit best behind given slips: both are linear in the valve signal's two halves, so they
//! are solved and not searched (variable projection, Golub and Pereyra 1973).

use super::class::Limits;
use super::normalised::{MOST_OVERSHOOT, SlipEnd};

/// What a fit may do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Freedom {
    /// Band of fd that belongs to the slips at hand.
    pub fd: [f64; 2],
    /// fd to take where the data cannot tell.
    pub fd_default: f64,
    /// Sign that the gain must have.
    pub sign: f64,
    /// Limits of time constants and lag.
    pub limits: Limits,
}

/// Fewest moves of the stem from which a model is fitted.
pub(crate) const MIN_SLIPS: usize = 3;

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

/// Squared error against fd: a quotient of parabolas.
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
    /// From products as [`best_band`] takes them and the squares that gain and band explain a part of.
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

    /// Standard error of fd next to a free gain, for white residuals of this variance; infinite where the data cannot tell fd
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

    /// Whether fd only changes the size of the response, so that the gain makes up for it.
    #[must_use]
    pub(crate) fn is_flat(&self) -> bool {
        self.uu * self.dd - self.ud * self.ud <= 1e-6 * self.uu * self.dd
    }
}

/// Gain, fd and explained squares from the products left of the two halves of the valve signal, `at` and `direction`,
/// and the target (at·at, at·direction, direction·direction, at·target, direction·target): the explained part is a
/// quotient of parabolas in fd, so its best place is the free optimum or an end of the band. A signal of which the
/// process' own memory leaves next to nothing (of `whole`, its squares before) has no gain.
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
    // Within the band the free optimum is better than either end, where its gain has the asked sign.
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
