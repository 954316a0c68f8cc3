//! A level or line through values with known variances and an unknown variance between them.
//!
//! Random effects: the variance between windows is that of Paule and Mandel (1982), which makes the weighted sum of squares
//! equal its degrees of freedom; intervals are those of Hartung and Knapp (2001) and Sidik and Jonkman (2002) with Student's
//! t. Each value counts by its window's share, so overlapping windows count once.

/// Half width of a 90 % interval in standard deviations.
pub(super) const HALF_WIDTH: f64 = 1.645;

/// A value with its variance and weight.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seen {
    pub x: f64,
    /// Its own variance.
    pub variance: f64,
    /// Number of windows it counts for, 0..1.
    pub share: f64,
    /// Middle of its window, s after the start of the first window.
    pub t_s: f64,
}

/// A line `x = at_mean + slope (t - mean_s)`, flat for a level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Level {
    at_mean: f64,
    pub slope: f64,
    mean_s: f64,
    variance: f64,
    slope_variance: f64,
    /// Variance between windows.
    pub between: f64,
    /// Equivalent number of windows without overlap.
    pub independent: f64,
    /// Degrees of freedom.
    df: f64,
}

/// Bisection steps for the variance between windows.
const HALVINGS: usize = 60;

/// Sums of a weighted straight line.
struct Sums {
    weight: f64,
    mean_s: f64,
    mean_x: f64,
    tt: f64,
    tx: f64,
}

impl Sums {
    fn of(seen: &[Seen], between: f64) -> Self {
        let weight = |s: &Seen| s.share / (s.variance + between);
        let all: f64 = seen.iter().map(weight).sum();
        let mean = |f: fn(&Seen) -> f64| seen.iter().map(|s| weight(s) * f(s)).sum::<f64>() / all;
        let (mean_s, mean_x) = (mean(|s| s.t_s), mean(|s| s.x));
        let (mut tt, mut tx) = (0.0, 0.0);
        for s in seen {
            tt += weight(s) * (s.t_s - mean_s) * (s.t_s - mean_s);
            tx += weight(s) * (s.t_s - mean_s) * (s.x - mean_x);
        }
        Self { weight: all, mean_s, mean_x, tt, tx }
    }
}

impl Level {
    /// A level through `seen`; `None` for nothing.
    pub fn flat(seen: &[Seen]) -> Option<Self> {
        Self::of(seen, false)
    }

    /// A line through `seen`; `None` for fewer than three windows or no time difference between them.
    pub fn line(seen: &[Seen]) -> Option<Self> {
        if seen.len() < 3 { None } else { Self::of(seen, true) }
    }

    fn of(seen: &[Seen], sloped: bool) -> Option<Self> {
        let independent: f64 = seen.iter().map(|s| s.share).sum();
        if seen.is_empty() || !independent.is_normal() {
            return None;
        }
        let df = independent - if sloped { 2.0 } else { 1.0 };
        let left = |between: f64| squares(seen, sloped, between);
        let between = if df < 0.5 { 0.0 } else { between(seen, df, left) };
        let sums = Sums::of(seen, between);
        if sloped && !sums.tt.is_normal() {
            return None;
        }
        let scale = if df < 0.5 { 1.0 } else { (left(between) / df).max(1.0) };
        let slope = if sloped { sums.tx / sums.tt } else { 0.0 };
        Some(Self {
            at_mean: sums.mean_x,
            slope,
            mean_s: sums.mean_s,
            variance: scale / sums.weight,
            slope_variance: if sloped { scale / sums.tt } else { 0.0 },
            between,
            independent,
            df,
        })
    }

    /// The value at a time.
    pub fn at(&self, t_s: f64) -> f64 {
        self.at_mean + self.slope * (t_s - self.mean_s)
    }

    /// Half width of the 90 % interval of the value at a time.
    pub fn half_width(&self, t_s: f64) -> f64 {
        let away = t_s - self.mean_s;
        self.quantile(HALF_WIDTH) * (self.variance + self.slope_variance * away * away).sqrt()
    }

    /// Half width of the interval of the slope for the normal quantile `z`.
    pub fn slope_half_width(&self, z: f64) -> f64 {
        self.quantile(z) * self.slope_variance.sqrt()
    }

    fn quantile(&self, z: f64) -> f64 {
        if self.df < 0.5 { z } else { student(z, self.df) }
    }
}

/// Weighted sum of squared residuals of a level or line.
pub(super) fn squares(seen: &[Seen], sloped: bool, between: f64) -> f64 {
    let sums = Sums::of(seen, between);
    let slope = if sloped && sums.tt > 0.0 { sums.tx / sums.tt } else { 0.0 };
    let left = |s: &Seen| {
        let e = s.x - sums.mean_x - slope * (s.t_s - sums.mean_s);
        s.share * e * e / (s.variance + between)
    };
    seen.iter().map(left).sum()
}

/// Paule and Mandel's variance between windows.
fn between(seen: &[Seen], df: f64, left: impl Fn(f64) -> f64) -> f64 {
    if left(0.0) <= df {
        return 0.0;
    }
    let (low_x, high_x) = seen.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), s| (l.min(s.x), h.max(s.x)));
    let spread = (high_x - low_x) * (high_x - low_x) * (1.0 + seen.len() as f64 / df);
    halved([0.0, spread], |between| left(between) > df)
}

/// Bisects for the point where a test turns from true at the lower end to false at the upper one.
pub(super) fn halved([mut low, mut high]: [f64; 2], holds: impl Fn(f64) -> bool) -> f64 {
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        if holds(middle) { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// Student's quantile from the normal quantile (Cornish and Fisher; Abramowitz and Stegun 26.7.5); for one or more degrees of
/// freedom.
fn student(z: f64, df: f64) -> f64 {
    let (v, z2) = (df.max(1.0), z * z);
    let first = z * (z2 + 1.0) / 4.0;
    let second = z * ((5.0 * z2 + 16.0) * z2 + 3.0) / 96.0;
    let third = z * (((3.0 * z2 + 19.0) * z2 + 17.0) * z2 - 15.0) / 384.0;
    z + (first + (second + third / v) / v) / v
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(x: f64, sd: f64, t_s: f64) -> Seen {
        Seen { x, variance: sd * sd, share: 1.0, t_s }
    }

    #[test]
    fn students_quantiles_are_those_of_tables() {
        for (df, table) in [(3.0, 2.353), (5.0, 2.015), (10.0, 1.812), (30.0, 1.697)] {
            assert!((student(1.645, df) / table - 1.0).abs() < 0.01, "{df}: {}", student(1.645, df));
        }
    }

    #[test]
    fn a_level_weighs_by_variance_and_finds_what_lies_between_windows() {
        let two = Level::flat(&[seen(1.0, 0.1, 0.0), seen(1.3, 0.2, 1.0)]).unwrap();
        // Weights 4 to 1; 0.3 is nearly what a standard deviation of 0.22 allows.
        assert!((two.at(0.0) - 1.0).abs() < 0.16 && two.at(0.0) > 1.05);
        // Alternating by 0.5 with small variances: all variance is between windows.
        let far: Vec<Seen> = (0..20).map(|k| seen(f64::from(k % 2), 0.01, f64::from(k))).collect();
        let level = Level::flat(&far).unwrap();
        assert!((level.at(3.0) - 0.5).abs() < 1e-9 && (level.between - 5.0 / 19.0).abs() < 1e-3, "{}", level.between);
        let calm: Vec<Seen> = (0..20).map(|k| seen(0.01 * f64::from(k % 2), 0.1, f64::from(k))).collect();
        assert_eq!(Level::flat(&calm).unwrap().between, 0.0);
        assert!(Level::flat(&[]).is_none());
    }

    #[test]
    fn overlapping_windows_narrow_nothing() {
        let apart: Vec<Seen> = (0..10).map(|k| seen(f64::from(k % 2), 0.1, f64::from(k))).collect();
        let often = |times: usize| -> Vec<Seen> {
            let share = 1.0 / times as f64;
            apart.iter().flat_map(|s| vec![Seen { share, ..*s }; times]).collect()
        };
        let (one, four) = (Level::flat(&apart).unwrap(), Level::flat(&often(4)).unwrap());
        assert!((one.half_width(0.0) - four.half_width(0.0)).abs() < 1e-9 && (four.independent - 10.0).abs() < 1e-9);
    }

    #[test]
    fn a_line_follows_a_line() {
        let rising: Vec<Seen> = (0..12).map(|k| seen(1.0 + 0.1 * f64::from(k), 0.05, f64::from(k))).collect();
        let line = Level::line(&rising).unwrap();
        assert!((line.slope - 0.1).abs() < 1e-9 && (line.at(11.0) - 2.1).abs() < 1e-9);
        assert!(line.slope_half_width(1.645) < 0.02 && line.half_width(11.0) > line.half_width(5.5));
        assert!(Level::line(&[seen(1.0, 0.1, 2.0); 5]).is_none());
    }
}
