//! Input of a search: a normalised record, its counted stretches, and the sign of the gain.

use crate::core::ident::class::Class;
use crate::core::ident::evaluator::{View, lattice_index};
use crate::core::ident::kinetic_band::Freedom;
use crate::core::ident::normalised::{NormalisedRecord, Start};
use crate::core::sim::steps::Steps;

/// A model element between the stem and the process with fixed parameters, such as a rate limit or a characteristic.
pub(crate) trait BehindStem: core::fmt::Debug + Sync {
    /// Converts the steps of a stem that begins at `start` (level, direction) into the steps of the process's input, over
    /// `points`; fixes fd if the signal is not linear in it.
    fn shape(&self, steps: &mut Steps, start: [f64; 2], freedom: &mut Freedom, points: usize);
}

/// One search problem.
#[derive(Debug)]
pub struct Problem<'a> {
    /// The record, with the stroke and slip end of the valve to be found.
    pub normalised: &'a NormalisedRecord,
    /// Stretches of points that are fitted; if empty, everything from the record's first counted point.
    pub counted: Vec<[usize; 2]>,
    /// Element behind the stem, if any.
    pub behind: Option<&'a dyn BehindStem>,
    /// Signals fitted in addition to the process's response, each as long as PV.
    pub loads: Vec<Vec<f64>>,
    /// Sign of the process gain.
    pub sign: f64,
    /// Fewest moves of the stem in the record, most per period.
    pub moves: [usize; 2],
    /// Indices of OP's running maxima, then minima, among its values.
    extremes: [Vec<u32>; 2],
}

/// Nine initial positions of the stem, as shares of the static band from OP's first value.
pub(crate) const EVEN_STARTS: [f64; 9] = [-0.9, -0.675, -0.45, -0.225, 0.0, 0.225, 0.45, 0.675, 0.9];
/// Fewest moves of the stem for which a model is fitted.
const LEAST_MOVES: usize = 3;
/// Most moves per period: a stem that follows every sample does not stick.
const MOST_MOVES: usize = 120;
/// Longest lag in front of an integrator, periods and shares of the record.
const LAG_PERIODS: f64 = 4.0;
const LAG_SHARE: f64 = 0.5;

impl<'a> Problem<'a> {
    /// A problem that counts the whole record.
    #[must_use]
    pub(crate) fn new(normalised: &'a NormalisedRecord, sign: f64) -> Self {
        let moves = [LEAST_MOVES, MOST_MOVES];
        let extremes = places_of_extremes(normalised.path.values());
        Self { normalised, counted: Vec::new(), behind: None, loads: Vec::new(), sign, moves, extremes }
    }

    /// Starts worth trying with the static band `fs`: the stem at OP's first value, and offset from it by shares of the band.
    #[must_use]
    pub(crate) fn starts(&self, fs: f64, shares: &[f64]) -> Vec<Start> {
        let mut out: Vec<Start> = Vec::with_capacity(shares.len());
        let Some(first) = self.normalised.path.values().first() else { return out };
        for share in shares {
            out.extend(self.start_from(first + share * fs, fs).filter(|s| !out.contains(s)));
        }
        out
    }

    /// The start of a stem at `position` with the band `fs`, if OP ever moves it: determined by whichever running maximum or
    /// minimum leaves the band first.
    fn start_from(&self, position: f64, fs: f64) -> Option<Start> {
        let [highs, lows] = &self.normalised.extremes;
        let up = highs.partition_point(|r| r - position <= fs);
        let down = lows.partition_point(|r| position - r <= fs);
        let at = |places: &[u32], k: usize| places.get(k).copied().unwrap_or(u32::MAX);
        let (high, low) = (at(&self.extremes[0], up), at(&self.extremes[1], down));
        if high == u32::MAX && low == u32::MAX {
            return None;
        }
        let is_up = high <= low;
        Some(Start { up: is_up, extreme: if is_up { up } else { down }, place: 0.5 })
    }

    /// Starts with a first slip up, or down, within `within` of OP's running extremes from a point.
    #[must_use]
    pub(crate) fn starts_near(&self, point: f64, up: bool, within: usize) -> Vec<Start> {
        let places = &self.extremes[usize::from(!up)];
        let at = (point.max(0.0) * self.normalised.path.per_point() as f64) as u32;
        let middle = places.partition_point(|place| *place < at);
        let last = (middle + within).min(places.len().saturating_sub(1));
        (middle.saturating_sub(within)..=last).map(|extreme| Start { up, extreme, place: 0.5 }).collect()
    }

    /// Number of points.
    #[must_use]
    pub(crate) fn points(&self) -> usize {
        self.normalised.pv.len()
    }

    /// PV, deviations from its mean.
    #[must_use]
    pub(crate) fn pv(&self) -> &[f64] {
        &self.normalised.pv
    }

    /// PV's first `points`, filtered by `1 - rho q^-1`.
    #[must_use]
    pub(crate) fn view(&self, rho: f64, points: usize) -> View {
        let whole = [[self.normalised.from, points]];
        self.view_of(rho, points, if self.counted.is_empty() { &whole } else { &self.counted })
    }

    /// As [`Self::view`], with the stretches `counted` fitted.
    #[must_use]
    pub(crate) fn view_of(&self, rho: f64, points: usize, counted: &[[usize; 2]]) -> View {
        let loads: Vec<&[f64]> = self.loads.iter().map(|l| &l[..points]).collect();
        View::of_stretches(&self.pv()[..points], &loads, rho, self.normalised.from, counted)
    }

    /// First point at which OP differs by more than `spans` from its first value.
    #[must_use]
    pub(crate) fn first_far(&self, spans: f64) -> usize {
        let path = self.normalised.path.values();
        let far = |first: &f64| path.iter().position(|u| (u - first).abs() > spans);
        path.first().and_then(far).unwrap_or(0) / self.normalised.path.per_point()
    }

    /// Largest lattice index of a time constant.
    #[must_use]
    pub(crate) fn most_place(&self, class: Class) -> i32 {
        let normalised = self.normalised;
        let tau = if class.integrates() {
            (LAG_PERIODS * normalised.period).min(LAG_SHARE * self.points() as f64).max(4.0)
        } else {
            normalised.limits.tau[1]
        };
        lattice_index(tau)
    }
}

/// Indices of running maxima, then minima, including the first value.
fn places_of_extremes(path: &[f64]) -> [Vec<u32>; 2] {
    let mut out = [vec![0], vec![0]];
    for (k, value) in path.iter().enumerate() {
        for (list, sign) in out.iter_mut().zip([1.0, -1.0]) {
            if list.last().is_some_and(|last| sign * (value - path[*last as usize]) > 0.0) {
                list.push(k as u32);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::ident::Options;
    use crate::core::ident::normalised::normalise;
    use crate::core::record::Record;

    #[test]
    fn a_start_is_where_op_first_leaves_the_band() {
        let op: Vec<f64> =
            (0..700).map(|k| libm::sin(f64::from(k) * 0.05) + 0.4 * libm::sin(f64::from(k) * 0.31)).collect();
        let pv: Vec<f64> = op.iter().map(|u| 2.0 * u).collect();
        let normalised = normalise(&Record::uniform(1.0, op, pv), &Options::default(), 2.0, 1.0);
        let problem = Problem::new(&normalised, 1.0);
        for fs in [0.02, 0.1, 0.3, 0.6] {
            let start = problem.starts(fs, &[0.0])[0];
            let path = normalised.path.values();
            let first = path[0];
            let left = path.iter().find(|op| (*op - first).abs() > fs).unwrap();
            assert_eq!((normalised.extremes[usize::from(!start.up)][start.extreme], start.up), (*left, *left > first));
        }
        assert!(problem.starts(2.0, &[0.0]).is_empty());
    }
}
