//! How far a record lies from those that the decision was calibrated on.
//!
//! A calibrated probability holds for loops like those it was fitted to. What a decision is made from is a place in a few
//! dimensions; its distance to the nearest of the calibration's own places, among these places' distances to each other, gives a
//! conformal p-value (Vovk, Gammerman and Shafer 2005): uniform for records drawn like them.

use std::sync::OnceLock;

use serde::{Deserialize, Serialize};

use super::evidence::Basis;
use super::probability::Features;
use crate::core::signal::stats;

/// What a place is made of.
pub const NAMES: [&str; 9] = [
    "base_over_floor",
    "held_out_over_fitted",
    "base_colour",
    "base_with_op",
    "noise_over_base",
    "noise_over_best",
    "beyond_first",
    "closed",
    "closed_at_least",
];
/// Nearest places whose mean distance counts.
const NEAREST: usize = 3;
/// p from which a record counts as one of those.
pub const WITHIN: f64 = 0.05;
/// Largest advantage of a noise model that still tells places apart, log mean squared error.
const FAR: f64 = 5.0;

/// What a decision was made from, as a place.
pub type Place = [f64; NAMES.len()];

/// The place of a decision.
#[must_use]
pub fn place(basis: &Basis, features: &Features) -> Place {
    let (base, noise) = (&basis.base, &basis.noise);
    let log = |over: Option<f64>| over.filter(|o| *o > 0.0).map(libm::log);
    let [fitted, held] = [base.over_floor, base.held_over_floor].map(log);
    let feature = |name: &str| features.named().find(|(own, _)| *own == name).map_or(0.0, |(_, x)| x);
    [
        fitted.unwrap_or(0.0),
        held.zip(fitted).map_or(0.0, |(held, fitted)| held - fitted),
        base.colour,
        libm::log1p(base.with_op.max(0.0)),
        noise.over_base.clamp(-FAR, FAR),
        noise.over_best.clamp(-FAR, FAR),
        noise.beyond_first,
        feature("closed"),
        feature("closed_at_least"),
    ]
}

/// The calibration's own places.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Known {
    /// Where they come from.
    pub from: String,
    /// The places, each in the order of [`NAMES`].
    pub places: Vec<Place>,
}

/// How typical a record is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct TypicalNote {
    /// Share of the calibration's records that lie as far from the others as this one does: uniform for loops like these.
    pub p: f64,
    /// Mean distance to the three nearest of them, in their standard deviations.
    pub distance: f64,
    /// Whether p is below 0.05: the cause's probability is then outside the range that it was calibrated on.
    pub outside: bool,
    /// In which of its figures the record lies farthest from the calibration's mean.
    pub farthest: String,
    /// What the decision was calibrated on.
    pub calibrated_on: String,
}

impl Known {
    /// The ones that are built in; none where they cannot be read.
    #[must_use]
    pub fn shipped() -> &'static Self {
        static READ: OnceLock<Known> = OnceLock::new();
        READ.get_or_init(|| {
            let read = serde_json::from_str(include_str!("typical.json"));
            read.unwrap_or_else(|_| Self { from: String::new(), places: Vec::new() })
        })
    }

    /// Mean and standard deviation of each dimension.
    fn scales(&self) -> [[f64; 2]; NAMES.len()] {
        core::array::from_fn(|i| {
            let column: Vec<f64> = self.places.iter().map(|p| p[i]).collect();
            let sd = stats::std_dev(&column);
            [stats::mean(&column), if sd > 0.0 { sd } else { 1.0 }]
        })
    }

    /// Mean distance of a place to the nearest ones, one of them left out.
    fn distance(&self, of: &Place, but: Option<usize>, scales: &[[f64; 2]]) -> f64 {
        let others = self.places.iter().enumerate().filter(|(i, _)| Some(*i) != but);
        let apart = |(_, p): (usize, &Place)| {
            let squares = of.iter().zip(p).zip(scales).map(|((a, b), [_, sd])| (a - b) / sd * ((a - b) / sd));
            squares.sum::<f64>().sqrt()
        };
        let mut all: Vec<f64> = others.map(apart).collect();
        all.sort_by(f64::total_cmp);
        all.truncate(NEAREST);
        stats::mean(&all)
    }

    /// How typical a place is; `None` without enough places.
    #[must_use]
    pub fn note(&self, of: &Place) -> Option<TypicalNote> {
        if self.places.len() <= NEAREST {
            return None;
        }
        let scales = self.scales();
        let distance = self.distance(of, None, &scales);
        let own = (0..self.places.len()).map(|i| self.distance(&self.places[i], Some(i), &scales));
        let as_far = own.filter(|d| *d >= distance).count();
        let p = (1 + as_far) as f64 / (1 + self.places.len()) as f64;
        let off = |i: usize| ((of[i] - scales[i][0]) / scales[i][1]).abs();
        let farthest = (0..NAMES.len()).max_by(|a, b| off(*a).total_cmp(&off(*b)))?;
        Some(TypicalNote {
            p,
            distance,
            outside: p < WITHIN,
            farthest: NAMES[farthest].to_owned(),
            calibrated_on: self.from.clone(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::sim::noise::Noise;

    fn drawn(seed: u64, n: usize) -> Vec<Place> {
        let mut noise = Noise::new(seed, 0);
        (0..n).map(|_| core::array::from_fn(|_| noise.gaussian())).collect()
    }

    #[test]
    fn p_is_uniform_for_what_is_drawn_alike_and_least_for_what_is_far() {
        let known = Known { from: "here".to_owned(), places: drawn(1, 150) };
        let p: Vec<f64> = drawn(2, 400).iter().map(|place| known.note(place).unwrap().p).collect();
        for share in [0.1, 0.25, 0.5, 0.75] {
            let below = p.iter().filter(|p| **p <= share).count() as f64 / 400.0;
            assert!((below - share).abs() < 0.08, "{below} below {share}");
        }
        let mut far = known.places[0];
        far[2] = 30.0;
        let note = known.note(&far).unwrap();
        assert!(note.outside && note.farthest == "base_colour" && note.p < 0.01, "{note:?}");
        assert_eq!(Known { places: drawn(1, 3), ..known }.note(&far), None);
    }

    #[test]
    fn the_shipped_places_are_read_and_say_where_they_are_from() {
        let shipped = Known::shipped();
        assert!(shipped.places.len() >= 100 && shipped.from.contains("split A"), "{}", shipped.places.len());
        let typical = shipped.places.iter().filter(|place| !shipped.note(place).unwrap().outside).count();
        assert!(typical >= shipped.places.len() - 1);
    }
}
