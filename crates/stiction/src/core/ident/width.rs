//! From the likelihood's intervals to the reported ones.
//!
//! The likelihood assumes that the model is true: a valve that obeys the law, only noise on PV, OP exactly as recorded. If the
//! residual contradicts this, or OP lies on a grid, an interval must be at least as wide as the errors of similar fits on
//! simulated loops: a [`Floor`] for each class of fits, kept in `interval.json`.

use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

use super::residual::Whiteness;
use crate::core::signal::stats;

/// Parts of a record that are fitted separately.
pub const THIRDS: usize = 3;

/// Fit of a third of the record. Its bands have the units of its [`Spread`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Third {
    /// Stick band plus dead band.
    pub s: f64,
    /// Slip jump.
    pub j: f64,
    /// Gain relative to the whole record's.
    pub gain: f64,
    /// Dead time, points.
    pub dead_time: f64,
}

/// The likelihood's intervals with the quantities that qualify them. Sizes have one unit: spans of OP, or OP units after
/// `Spread::scaled`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Stick band plus dead band.
    pub s: [f64; 2],
    /// Slip jump; everything that the slips allow if fd cannot be separated from the gain.
    pub j: [f64; 2],
    /// Static band, (s + j) / 2.
    pub fs: [f64; 2],
    /// Kinetic band, (s - j) / 2.
    pub fd: [f64; 2],
    /// Whether j is identified separately from the gain.
    pub j_identifiable: bool,
    /// Tests of the residual.
    pub whiteness: Whiteness,
    /// Step of OP's values, 0 if they lie on no grid.
    pub quantum: f64,
    /// Stiction index of the fit, 0..1.
    pub index: f64,
    /// Whether the residual is not white, yet all other bands that the search kept leave a far larger error.
    pub distinct: bool,
    /// Fit of each third of the record, if made and successful.
    pub thirds: [Option<Third>; THIRDS],
}

/// Smallest half widths in one class of fits.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Floor {
    /// For s, as a factor minus 1: from `s / (1 + floor)` to `s (1 + floor)`.
    pub s: f64,
    /// For j, as a share of s.
    pub j: f64,
    /// For fs, as a factor minus 1.
    pub fs: f64,
    /// For fd, as a share of s.
    pub fd: f64,
}

/// Errors that the likelihood ignores, measured on simulated loops: the contents of `interval.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// How these numbers were made.
    pub made: String,
    /// Widening for each limiting gate that a record meets; chosen, not measured.
    pub gate: f64,
    /// Residual white and uncorrelated with OP.
    pub white: Floor,
    /// Residual nearly white, OP on a grid.
    pub gridded: Floor,
    /// Residual not white, but all other bands leave a far larger error.
    pub distinct: Floor,
    /// Residual white but correlated with OP, or not quite white.
    pub tinted: Floor,
    /// Residual far from white, friction explains nearly all.
    pub coloured: Floor,
    /// Residual far from white, friction explains much.
    pub doubtful: Floor,
    /// Residual far from white, friction explains little.
    pub poor: Floor,
}

/// Classes of fits, each with its [`Floor`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Trust {
    /// Residual white and uncorrelated with OP.
    White,
    /// Residual nearly white, OP on a grid.
    Gridded,
    /// Residual not white, but all other bands leave a far larger error.
    Distinct,
    /// Residual white but correlated with OP, or not quite white.
    Tinted,
    /// Residual far from white, friction explains nearly all.
    Coloured,
    /// Residual far from white, friction explains much.
    Doubtful,
    /// Residual far from white, friction explains little.
    Poor,
}

impl Trust {
    /// Every class.
    pub const ALL: [Self; 7] =
        [Self::White, Self::Gridded, Self::Distinct, Self::Tinted, Self::Coloured, Self::Doubtful, Self::Poor];

    /// The class's name in tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::White => "white",
            Self::Gridded => "gridded",
            Self::Distinct => "distinct",
            Self::Tinted => "tinted",
            Self::Coloured => "coloured",
            Self::Doubtful => "doubtful",
            Self::Poor => "poor",
        }
    }
}

/// Lag-1 autocorrelation, or points per independent point, from which a residual is far from white.
const FAR_R1: f64 = 0.3;
const FAR_INFLATION: f64 = 3.0;
/// Stiction index from which friction explains nearly all, and much.
const NEARLY_ALL: f64 = 0.9;
const MUCH: f64 = 0.6;
/// Step of OP's values, in s, from which the grid matters.
const GRID: f64 = 1e-3;
/// Step up to which the grid is fine: then s errs by a few steps, while a coarse grid hides the slips. Of 25 loops each of the
/// calibration half (seeds 2100 to 2102) on grids of 0.2, 0.4, 1 and 3 % of s, nine in ten need 0.6, 1.2, 13 and 30 %; of 46 of
/// the report half (seeds 2100 to 2103) on a grid of 0.4 %, four steps covered only 78 %.
const FINE_GRID: f64 = 3e-3;
/// Smallest half width of s on a fine grid, steps.
const FINE_STEPS: f64 = 10.0;

/// Weight of a class's floor relative to the scatter of the record's thirds, degrees of freedom; half width of a 90 % interval
/// in standard deviations; and smallest half width of a fit whose residual is more than noise, as a logarithm and as a share of
/// s. Chosen on half of the valves of the labelled recordings, so that both halves of a recording agree, and on simulated loops
/// of the calibration half.
const PRIOR: f64 = 1.0;
const HALF_WIDTH: f64 = 1.645;
const LEAST: f64 = 0.14;

/// The reported intervals, OP units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intervals {
    /// Interval of s.
    pub s: [f64; 2],
    /// Interval of j.
    pub j: [f64; 2],
    /// Interval of fs.
    pub fs: [f64; 2],
    /// Interval of fd.
    pub fd: [f64; 2],
}

impl Intervals {
    /// Limits the intervals to possible bands around (s, j): a valve whose s exceeds the span `s0` of OP never moves, j is at
    /// most s, and fd at most half of s. Each interval still contains its estimate.
    #[must_use]
    pub const fn within(self, s0: f64, s: f64, j: f64) -> Self {
        const fn cut(x: [f64; 2], most: f64, value: f64) -> [f64; 2] {
            [x[0], x[1].min(most.max(value))]
        }
        let most = s0.max(s);
        Self {
            s: cut(self.s, most, s),
            j: cut(self.j, most, j),
            fs: cut(self.fs, most, 0.5 * (s + j)),
            fd: cut(self.fd, 0.5 * most, 0.5 * (s - j)),
        }
    }
}

impl Spread {
    /// The same spread in another unit.
    #[must_use]
    pub(crate) fn scaled(self, by: f64) -> Self {
        let scale = |x: [f64; 2]| x.map(|v| v * by);
        Self {
            s: scale(self.s),
            j: scale(self.j),
            fs: scale(self.fs),
            fd: scale(self.fd),
            quantum: self.quantum * by,
            thirds: self.thirds.map(|third| third.map(|t| Third { s: t.s * by, j: t.j * by, ..t })),
            ..self
        }
    }

    /// The union with another explanation that the likelihood cannot distinguish from this one.
    #[must_use]
    pub(crate) const fn or(self, other: &Self) -> Self {
        Self {
            s: hull(self.s, other.s),
            j: hull(self.j, other.j),
            fs: hull(self.fs, other.fs),
            fd: hull(self.fd, other.fd),
            j_identifiable: self.j_identifiable && other.j_identifiable,
            distinct: false,
            ..self
        }
    }

    /// Class of these intervals around an estimate of s.
    #[must_use]
    pub fn trust(&self, s: f64) -> Trust {
        let w = &self.whiteness;
        let gridded = self.quantum > GRID * s;
        if self.distinct && !gridded {
            return Trust::Distinct;
        }
        if w.r1.abs() > FAR_R1 || w.inflation > FAR_INFLATION {
            return match self.index {
                i if i >= NEARLY_ALL => Trust::Coloured,
                i if i >= MUCH => Trust::Doubtful,
                _ => Trust::Poor,
            };
        }
        match (gridded, w.is_noise()) {
            (true, _) => Trust::Gridded,
            // A model that explains little may leave noise by chance.
            (false, true) if self.stands() => Trust::White,
            _ => Trust::Tinted,
        }
    }

    /// Whether the residual is only noise and friction explains nearly all of PV: then the likelihood is trusted.
    #[must_use]
    pub(crate) const fn stands(&self) -> bool {
        self.whiteness.is_noise() && self.index >= NEARLY_ALL
    }

    /// A class's floor combined with the scatter of the thirds: for s and fs both count; for j and fd the thirds can only widen
    /// it.
    fn with_thirds(&self, s: f64, floor: &Floor) -> Floor {
        let apart = |value: &dyn Fn(&Third) -> f64| {
            let values: Vec<f64> = self.thirds.iter().flatten().map(value).collect();
            let deviation = stats::std_dev(&values);
            // Degrees of freedom, and squared standard error of the mean.
            (values.len() > 1).then(|| (values.len() as f64 - 1.0, deviation * deviation / (values.len() as f64 - 1.0)))
        };
        let factor = |floor: f64, apart: Option<(f64, f64)>| {
            let prior = libm::log(1.0 + floor);
            let half = apart.map_or(prior, |(freedom, squared)| {
                let known = PRIOR * (prior / HALF_WIDTH) * (prior / HALF_WIDTH);
                HALF_WIDTH * ((freedom * squared + known) / (freedom + PRIOR)).sqrt()
            });
            libm::exp(half.max(LEAST)) - 1.0
        };
        let share = |floor: f64, apart: Option<(f64, f64)>| {
            apart.map_or(floor, |(_, squared)| floor.max(HALF_WIDTH * squared.sqrt())).max(LEAST)
        };
        Floor {
            s: factor(floor.s, apart(&|t| libm::log(t.s))),
            j: share(floor.j, apart(&|t| t.j / s)),
            fs: factor(floor.fs, apart(&|t| libm::log(0.5 * (t.s + t.j)))),
            fd: share(floor.fd, apart(&|t| 0.5 * (t.s - t.j) / s)),
        }
    }

    /// The intervals to report around the estimate (s, j): no narrower than `floor`, and `times` wider for a record that meets
    /// limiting gates. They contain the estimate; the interval of s ends above 0, and none extends below 0.
    #[must_use]
    pub fn told(&self, s: f64, j: f64, floor: &Floor, times: f64) -> Intervals {
        let q = self.quantum;
        let factor = |found: [f64; 2], value: f64, floor: f64| {
            if value <= 0.0 {
                return [0.0, found[1].max(0.0) + q];
            }
            let down = (found[0].max(0.01 * value) / value).min(1.0 / (1.0 + floor));
            let up = (found[1] / value).max(1.0 + floor);
            let [low, high] = [value * libm::pow(down, times), value * libm::pow(up, times)];
            [(low - q).max(0.5 * low), high + q]
        };
        let share = |found: [f64; 2], value: f64, floor: f64, most: f64| {
            let low = value - times * (value - found[0]).max(floor * s) - q;
            let high = value + times * (found[1] - value).max(floor * s) + q;
            [low.clamp(0.0, value), high.clamp(value, most.max(value))]
        };
        let (fs, fd) = (0.5 * (s + j), 0.5 * (s - j));
        let wide = factor(self.s, s, floor.s);
        Intervals {
            s: wide,
            j: share(self.j, j, floor.j, wide[1]),
            fs: factor(self.fs, fs, floor.fs),
            fd: share(self.fd, fd, floor.fd, 0.5 * wide[1]),
        }
    }
}

impl Settings {
    /// The settings of this build.
    #[must_use]
    pub fn shipped() -> &'static Self {
        static SHIPPED: LazyLock<Settings> = LazyLock::new(|| {
            serde_json::from_str(include_str!("interval.json")).unwrap_or_else(|_| Settings::unknown())
        });
        &SHIPPED
    }

    /// The floor of a class.
    #[must_use]
    pub(crate) const fn of(&self, trust: Trust) -> &Floor {
        match trust {
            Trust::White => &self.white,
            Trust::Gridded => &self.gridded,
            Trust::Distinct => &self.distinct,
            Trust::Tinted => &self.tinted,
            Trust::Coloured => &self.coloured,
            Trust::Doubtful => &self.doubtful,
            Trust::Poor => &self.poor,
        }
    }

    /// The floor around an estimate of s: that of its class, combined with the scatter of the record's thirds if the residual
    /// is more than noise.
    #[must_use]
    pub fn least(&self, spread: &Spread, s: f64) -> Floor {
        let floor = self.of_class(spread, s);
        if spread.stands() { floor } else { spread.with_thirds(s, &floor) }
    }

    /// The floor of a class; on a fine grid, in proportion to its step.
    fn of_class(&self, spread: &Spread, s: f64) -> Floor {
        let trust = spread.trust(s);
        let floor = *self.of(trust);
        let step = spread.quantum / s;
        if trust != Trust::Gridded || step > FINE_GRID {
            return floor;
        }
        let share = (FINE_STEPS * step / floor.s).min(1.0);
        Floor { s: share * floor.s, j: share * floor.j, fs: share * floor.fs, fd: share * floor.fd }
    }

    /// Mutable floor of a class.
    pub const fn of_mut(&mut self, trust: Trust) -> &mut Floor {
        match trust {
            Trust::White => &mut self.white,
            Trust::Gridded => &mut self.gridded,
            Trust::Distinct => &mut self.distinct,
            Trust::Tinted => &mut self.tinted,
            Trust::Coloured => &mut self.coloured,
            Trust::Doubtful => &mut self.doubtful,
            Trust::Poor => &mut self.poor,
        }
    }

    /// No measurement: a factor of two to either side.
    #[must_use]
    pub const fn unknown() -> Self {
        let floor = Floor { s: 1.0, j: 1.0, fs: 1.0, fd: 1.0 };
        Self {
            made: String::new(),
            gate: 1.5,
            white: floor,
            gridded: floor,
            distinct: floor,
            tinted: floor,
            coloured: floor,
            doubtful: floor,
            poor: floor,
        }
    }
}

/// Whether sizes from parts of a record differ by no more than the width of an interval.
#[must_use]
pub(crate) fn agree(parts: &[f64], [low, high]: [f64; 2]) -> bool {
    let least = parts.iter().copied().fold(f64::INFINITY, f64::min);
    let most = parts.iter().copied().fold(0.0, f64::max);
    low <= 0.0 || most * low <= least * high
}

/// The smallest interval that contains both.
pub(crate) const fn hull(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spread() -> Spread {
        let whiteness =
            Whiteness { r1: 0.0, portmanteau: 20.0, cross: 1.0, inflation: 1.0, white: true, follows_op: false };
        Spread {
            s: [3.9, 4.1],
            j: [1.8, 2.2],
            fs: [2.95, 3.05],
            fd: [0.9, 1.1],
            j_identifiable: true,
            whiteness,
            quantum: 0.0,
            index: 0.95,
            distinct: false,
            thirds: [None; THIRDS],
        }
    }

    const NONE: Floor = Floor { s: 0.0, j: 0.0, fs: 0.0, fd: 0.0 };

    #[test]
    fn what_is_shipped_can_be_read_and_worse_fits_get_wider_intervals() {
        let shipped: Settings = serde_json::from_str(include_str!("interval.json")).unwrap();
        assert!(
            shipped.gate >= 1.0
                && shipped.white.s < shipped.distinct.s
                && shipped.distinct.s < shipped.tinted.s
                && shipped.white.s < shipped.gridded.s
                && shipped.coloured.s < shipped.poor.s
        );
        for trust in Trust::ALL {
            let f = shipped.of(trust);
            assert!([f.s, f.j, f.fs, f.fd].iter().all(|x| (0.0..20.0).contains(x)), "{trust:?}");
        }
    }

    #[test]
    fn intervals_hold_the_estimate_and_stay_above_zero() {
        for (s, j) in [(4.0, 2.0), (5.0, 5.0), (3.0, 0.0)] {
            for (floor, times) in [(NONE, 1.0), (Settings::unknown().white, 1.0), (Settings::unknown().white, 4.0)] {
                for quantum in [0.0, 0.5, 20.0] {
                    let t = Spread { quantum, ..spread() }.told(s, j, &floor, times);
                    let inside = |x: [f64; 2], v: f64| x[0] >= 0.0 && x[0] <= v && v <= x[1];
                    assert!(t.s[0] > 0.0 && inside(t.s, s) && inside(t.j, j), "{t:?}");
                    assert!(inside(t.fs, 0.5 * (s + j)) && inside(t.fd, 0.5 * (s - j)), "{t:?}");
                }
            }
        }
        let t = spread().told(4.0, 2.0, &NONE, 1.0);
        assert!((t.s[0] - 3.9).abs() < 1e-9 && (t.j[1] - 2.2).abs() < 1e-9);
        let wide = spread().told(4.0, 2.0, &Settings::unknown().white, 4.0);
        let cut = wide.within(5.0, 4.0, 2.0);
        assert!(
            wide.s[1] > 5.0 && (cut.s[1], cut.fs[1]) == (5.0, 5.0) && cut.j[1] <= 5.0 && cut.fd[1] <= 2.5,
            "{cut:?}"
        );
        assert_eq!(wide.within(3.0, 4.0, 2.0).s[1], 4.0);
    }

    #[test]
    fn thirds_widen_or_narrow_what_leaves_more_than_noise() {
        let third = |s: f64| Some(Third { s, j: 0.5 * s, gain: 1.0, dead_time: 5.0 });
        let settings = Settings::shipped();
        let whiteness = Whiteness { white: false, ..spread().whiteness };
        let least = |whiteness, thirds| settings.least(&Spread { whiteness, thirds, ..spread() }, 4.0);
        let alone = least(whiteness, [None; THIRDS]);
        let alike = least(whiteness, [third(3.9), third(4.0), third(4.1)]);
        let apart = least(whiteness, [third(1.0), third(4.0), third(12.0)]);
        assert!((alone.s - settings.tinted.s).abs() < 1e-9);
        assert!(alike.s < alone.s && alone.s < apart.s && alike.s > 0.14, "{alike:?} {apart:?}");
        assert!(alike.j == alone.j && apart.j > alone.j && apart.fs > alone.fs);
        // If the residual is only noise and nearly all is explained, the thirds are ignored.
        let white = least(spread().whiteness, [third(2.5), third(4.0), third(6.0)]);
        assert_eq!(white, settings.white);
        assert!(!Spread { index: 0.4, ..spread() }.stands());
        assert!(agree(&[2.5, 3.0], [2.0, 3.0]) && !agree(&[2.5, 4.0], [2.0, 3.0]) && agree(&[], [2.0, 2.1]));
    }

    #[test]
    fn a_finer_grid_asks_for_less() {
        let least = |quantum: f64| Settings::shipped().of_class(&Spread { quantum, ..spread() }, 4.0).s;
        assert_eq!(least(0.4), Settings::shipped().gridded.s);
        assert!((least(0.012) - 0.03).abs() < 1e-12 && (least(0.008) - 0.02).abs() < 1e-12);
        assert_eq!(least(0.001), Settings::shipped().white.s);
    }

    #[test]
    fn residuals_and_grids_decide_what_an_interval_is_worth() {
        let with = |r1: f64, white: bool, follows_op: bool, quantum: f64| {
            let mut s = spread();
            s.whiteness = Whiteness { r1, white, follows_op, ..s.whiteness };
            Spread { quantum, ..s }.trust(4.0)
        };
        assert_eq!(with(0.0, true, false, 0.0), Trust::White);
        assert_eq!(with(0.0, true, true, 0.0), Trust::Tinted);
        assert_eq!(with(0.2, false, false, 0.0), Trust::Tinted);
        assert_eq!(with(0.9, false, false, 0.0), Trust::Coloured);
        assert_eq!(with(0.0, true, false, 0.1), Trust::Gridded);
        assert_eq!(with(0.9, false, false, 0.1), Trust::Coloured);
        let alone = |quantum| Spread {
            distinct: true,
            whiteness: Whiteness { r1: 0.9, ..spread().whiteness },
            quantum,
            ..spread()
        };
        assert_eq!((alone(0.0).trust(4.0), alone(0.1).trust(4.0)), (Trust::Distinct, Trust::Coloured));
        let far = |index: f64| Spread { index, whiteness: Whiteness { r1: 0.9, ..spread().whiteness }, ..spread() };
        assert_eq!((far(0.7).trust(4.0), far(0.2).trust(4.0)), (Trust::Doubtful, Trust::Poor));
        let both = spread().or(&Spread { s: [4.5, 4.6], j_identifiable: false, ..spread() });
        assert_eq!((both.s, both.j_identifiable), ([3.9, 4.6], false));
    }
}
