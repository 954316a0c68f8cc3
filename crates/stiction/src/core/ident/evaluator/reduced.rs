//! The error for every dead time within a sample, gain and kinetic band, from the sums over a valve signal's steps.

use crate::core::ident::class::{Class, INTEGRATOR_SCALE};
use crate::core::ident::kinetic_band::{Freedom, best_band};

/// Most columns of a step response: level, and ramp or decays.
pub(super) const PARTS: usize = 3;
/// Pairs of columns: 00 01 11 02 12 22.
pub(super) const PAIRS: [(usize, usize); 6] = [(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)];
/// A column counts as linearly dependent if less than this share of its sum of squares is orthogonal to earlier columns.
pub(super) const DEPENDENT: f64 = 1e-9;
/// Refinements of the dead time within a sample after the first three values.
const REFINEMENTS: usize = 4;
/// Change of the dead time below which the refinement stops.
const SAME_PLACE: f64 = 1e-3;

/// Products of the parts of a step response with each other and with PV, after projecting out everything else that is linear:
/// they determine the error for every dead time within a sample, gain and kinetic band.
#[derive(Debug, Clone, Copy)]
pub struct Reduced {
    pub(super) class: Class,
    pub(super) tau: [f64; 2],
    /// Level half with itself, with the direction half (both orders added off the diagonal), direction half with itself.
    pub(super) products: [[f64; 6]; 3],
    /// Products of both halves with PV.
    pub(super) with_pv: [[f64; PARTS]; 2],
    /// Squares of the two halves' levels before the projection, or of their steps if those are larger: if no counted point sees
    /// a step, the remainder of the levels is rounding.
    pub(super) whole: [f64; 2],
    /// Sum of squares of PV after projecting out constant, memory and loads.
    pub rest: f64,
}

/// The best of all dead times within a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Best {
    /// Squared error.
    pub sse: f64,
    /// Coefficient of the unit response; 0 if no gain of the requested sign helps.
    pub gain: f64,
    /// Kinetic band.
    pub fd: f64,
    /// Dead time beyond the whole samples, 0..1.
    pub fraction: f64,
}

impl Reduced {
    /// Weights of the parts in the response to a unit step whose dead time is `fraction` of a sample longer.
    fn weights(&self, fraction: f64) -> [f64; PARTS] {
        let early = 1.0 - fraction;
        let [t1, t2] = self.tau;
        match self.class {
            Class::First => [1.0, -libm::exp(-early / t1), 0.0],
            Class::Second => {
                let inverse = 1.0 / (t1 - t2);
                [1.0, -t1 * inverse * libm::exp(-early / t1), t2 * inverse * libm::exp(-early / t2)]
            }
            Class::Integrating => [early / INTEGRATOR_SCALE, 1.0, 0.0],
            Class::LagIntegrating => {
                [(early - t1) / INTEGRATOR_SCALE, 1.0, t1 * libm::exp(-early / t1) / INTEGRATOR_SCALE]
            }
        }
    }

    /// Products of the two halves' responses, as in [`best_band`].
    #[must_use]
    pub(crate) fn system(&self, fraction: f64) -> [f64; 5] {
        let w = self.weights(fraction);
        let square = |m: &[f64; 6], twice: f64| {
            w[0] * w[0] * m[0]
                + w[1] * w[1] * m[2]
                + w[2] * w[2] * m[5]
                + twice * (w[0] * w[1] * m[1] + w[0] * w[2] * m[3] + w[1] * w[2] * m[4])
        };
        let with = |x: &[f64; PARTS]| w[0] * x[0] + w[1] * x[1] + w[2] * x[2];
        [
            square(&self.products[0], 2.0),
            square(&self.products[1], 1.0),
            square(&self.products[2], 2.0),
            with(&self.with_pv[0]),
            with(&self.with_pv[1]),
        ]
    }

    /// Gain, kinetic band and explained squares at one dead time.
    #[must_use]
    pub(crate) fn at(&self, fraction: f64, freedom: &Freedom) -> (f64, f64, f64) {
        let scale = if self.class.integrates() { 1.0 / (INTEGRATOR_SCALE * INTEGRATOR_SCALE) } else { 1.0 };
        best_band(self.system(fraction), self.whole.map(|w| w * scale), freedom)
    }

    /// The best dead time from `fractions[0]` to `fractions[1]` of a sample, by parabolas through the explained squares.
    #[must_use]
    pub(crate) fn best(&self, freedom: &Freedom, fractions: [f64; 2]) -> Best {
        best_place(fractions, |fraction| {
            let (gain, fd, explained) = self.at(fraction, freedom);
            Best { sse: (self.rest - explained).max(0.0), gain, fd, fraction }
        })
    }

    /// As [`Reduced::best`] for the two lags of [`Class::Second`] in parallel, each with its own gain (`gain` is their sum);
    /// pairs of gains that are not `accepted` explain nothing.
    #[must_use]
    pub(crate) fn best_side_by_side(
        &self,
        freedom: &Freedom,
        fractions: [f64; 2],
        accepted: impl Fn([f64; 2]) -> bool,
    ) -> Best {
        best_place(fractions, |fraction| {
            let [low, high] = freedom.fd;
            let within = best_place([0.0, 1.0], |share| {
                let fd = low + share * (high - low);
                let (gains, explained) = self.side_by_side(fraction, fd);
                let total = gains[0] + gains[1];
                let taken = total * freedom.sign > 0.0 && accepted(gains);
                let (gain, explained) = if taken { (total, explained) } else { (0.0, 0.0) };
                Best { sse: (self.rest - explained).max(0.0), gain, fd, fraction: share }
            });
            Best { fraction, ..within }
        })
    }

    /// Gains of two parallel lags for one dead time and kinetic band, and the squares that they explain.
    #[must_use]
    pub(crate) fn side_by_side(&self, fraction: f64, fd: f64) -> ([f64; 2], f64) {
        let left = self.tau.map(|tau| libm::exp(-(1.0 - fraction) / tau));
        let product = |slot: usize| {
            let (a, b) = PAIRS[slot];
            let both = if a == b { 2.0 } else { 1.0 };
            self.products[0][slot] - fd * both * self.products[1][slot] + fd * fd * self.products[2][slot]
        };
        let m: [f64; 6] = core::array::from_fn(product);
        let y: [f64; PARTS] = core::array::from_fn(|b| self.with_pv[0][b] - fd * self.with_pv[1][b]);
        let [g1, g2] = left;
        let own = [m[0] - 2.0 * g1 * m[1] + g1 * g1 * m[2], m[0] - 2.0 * g2 * m[3] + g2 * g2 * m[5]];
        let both = m[0] - g1 * m[1] - g2 * m[3] + g1 * g2 * m[4];
        let with = [y[0] - g1 * y[1], y[0] - g2 * y[2]];
        let determinant = own[0] * own[1] - both * both;
        if determinant <= DEPENDENT * own[0] * own[1] {
            return ([0.0; 2], 0.0);
        }
        let gains =
            [(own[1] * with[0] - both * with[1]) / determinant, (own[0] * with[1] - both * with[0]) / determinant];
        (gains, gains[0] * with[0] + gains[1] * with[1])
    }
}

/// The least error from `low` to `high`, by parabolas through three points.
fn best_place([low, high]: [f64; 2], place: impl Fn(f64) -> Best) -> Best {
    if high - low < SAME_PLACE {
        return place(low);
    }
    let mut three = [place(low), place(0.5 * (low + high)), place(high)];
    for _ in 0..REFINEMENTS {
        let Some(next) = next_place(&three) else { break };
        let found = place(next);
        let after = if next < three[1].fraction { 1 } else { 2 };
        let mut four = [three[0], three[1], three[2], three[2]];
        if after == 1 {
            four[2] = three[1];
        }
        four[after] = found;
        let top = (1..4).fold(0, |m, i| if four[i].sse < four[m].sse { i } else { m });
        let from = usize::from(top >= 2);
        three = [four[from], four[from + 1], four[from + 2]];
    }
    three.into_iter().reduce(|a, b| if b.sse < a.sse { b } else { a }).unwrap_or(three[0])
}

/// The minimum of the parabola through three points, or a point halfway towards the best end; `None` if it coincides with the
/// middle one.
fn next_place(three: &[Best; 3]) -> Option<f64> {
    let [x0, x1, x2] = three.map(|p| p.fraction);
    let [e0, e1, e2] = three.map(|p| p.sse);
    let (d0, d2) = (x0 - x1, x2 - x1);
    let (r0, r2) = (e0 - e1, e2 - e1);
    let best = if e0 < e1 && e0 <= e2 {
        0
    } else if e2 < e1 {
        2
    } else {
        1
    };
    let curvature = (r0 * d2 - r2 * d0) / (d0 * d2 * (d0 - d2));
    let mut x = if curvature > 0.0 {
        x1 + 0.5 * (r0 * d2 * d2 - r2 * d0 * d0) / (r0 * d2 - r2 * d0)
    } else {
        three[best].fraction
    };
    // Move halfway towards an end of the range: stopping at the middle would exclude whole samples.
    if !(x > x0 && x < x2) {
        x = if best == 1 { 0.5 * (x1 + x0) } else { 0.5 * (x1 + three[best].fraction) };
    }
    ((x - x1).abs() >= SAME_PLACE).then_some(x)
}
