//! The catalogue: one file an effect, with where it acts, its parameters and bounds, how it enters the simulator, where
//! to begin looking, what it is confused with and which measurement would tell.

mod asymmetric_stiction;
mod backlash;
pub(crate) mod clipping;
mod clues;
pub(crate) mod coloured_noise;
pub(crate) mod columns;
mod dead_time_change;
mod effect;
pub(crate) mod extra_lag;
pub(crate) mod frozen_sensor;
pub(crate) mod gain_drift;
pub(crate) mod hold_compression;
pub(crate) mod integrating;
mod inverse_response;
pub mod neighbour;
pub(crate) mod outliers;
mod positioner_lag;
pub(crate) mod quantisation;
pub(crate) mod ramp;
mod rate_limit;
pub(crate) mod sensor_filter;
pub(crate) mod sinusoid;
mod sliding_valve;
mod slip_overshoot;
pub(crate) mod static_nonlinearity;
pub(crate) mod step_load;
pub(crate) mod stiction;
pub(crate) mod swinging_door;
pub(crate) mod time_skew;
mod travel_limit;

pub use clues::Clues;
pub(crate) use effect::MARGIN;
pub use effect::{Effect, Param, Reach, Rest, Start, Unit, Way};

/// Every effect.
pub const ALL: [&Effect; 27] = [
    &asymmetric_stiction::EFFECT,
    &slip_overshoot::EFFECT,
    &sliding_valve::EFFECT,
    &backlash::EFFECT,
    &travel_limit::EFFECT,
    &rate_limit::EFFECT,
    &positioner_lag::EFFECT,
    &extra_lag::EFFECT,
    &static_nonlinearity::EFFECT,
    &inverse_response::EFFECT,
    &integrating::EFFECT,
    &gain_drift::EFFECT,
    &dead_time_change::EFFECT,
    &sinusoid::EFFECT,
    &ramp::EFFECT,
    &step_load::EFFECT,
    &coloured_noise::EFFECT,
    &sensor_filter::EFFECT,
    &quantisation::EFFECT,
    &hold_compression::EFFECT,
    &swinging_door::EFFECT,
    &clipping::EFFECT,
    &outliers::EFFECT,
    &frozen_sensor::EFFECT,
    &time_skew::EFFECT,
    &stiction::EFFECT,
    &neighbour::EFFECT,
];

/// The effect of an id, with a neighbour's name or without.
#[must_use]
pub fn by_id(id: &str) -> Option<&'static Effect> {
    ALL.into_iter().find(|e| e.id == kind(id))
}

/// An id without the name of a neighbour.
#[must_use]
pub(crate) fn kind(id: &str) -> &str {
    id.split_once('(').map_or(id, |(kind, _)| kind)
}

/// The ids that a `+` joins; a neighbour's name may hold one of its own.
pub fn parts(id: &str) -> impl Iterator<Item = &str> {
    let mut depth = 0_usize;
    id.split(move |c: char| {
        match c {
            '(' => depth += 1,
            ')' => depth = depth.saturating_sub(1),
            _ => {}
        }
        c == '+' && depth == 0
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::gap::candidate::MAX_PARAMS;

    #[test]
    fn ids_are_unique_and_what_is_confused_exists() {
        for (i, effect) in ALL.iter().enumerate() {
            assert!(ALL[i + 1..].iter().all(|e| e.id != effect.id), "{} twice", effect.id);
            assert_eq!(by_id(effect.id).map(|e| e.id), Some(effect.id));
            for clash in effect.clashes {
                assert!(by_id(clash).is_some_and(|o| o.clashes.contains(&effect.id)), "{}: {clash}", effect.id);
            }
            for other in effect.confused_with {
                assert!(by_id(other).is_some_and(|o| o.id != effect.id), "{}: {other}", effect.id);
            }
            assert!(
                !effect.separated_by.is_empty() && !effect.noun.is_empty() && 2 * effect.params.len() <= MAX_PARAMS
            );
        }
        assert!(by_id("none").is_none());
        assert_eq!(by_id("neighbour(FIC (old) +1)").map(|e| e.id), Some("neighbour"));
        assert_eq!(parts("extra_lag+neighbour(A+B)").collect::<Vec<_>>(), ["extra_lag", "neighbour(A+B)"]);
    }
}
