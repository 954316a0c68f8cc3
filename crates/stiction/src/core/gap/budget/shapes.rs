//! What an effect adds to PV, as columns whose coefficients are fitted.

use core::f64::consts::TAU;
use std::collections::BTreeMap;
use std::sync::Arc;

use super::series::Series;
use crate::core::gap::effects::{self, columns};
use crate::core::gap::neighbour::Load;
use crate::core::gap::plan::Drift;
use crate::core::gap::sizes::Quantity;

/// Frequencies closer than this count as one, cycles in the record.
pub(super) const APART: f64 = 1.2;

/// An effect with what is not fitted linearly.
#[derive(Debug, Clone, PartialEq)]
pub enum Shape {
    /// A step from a point on.
    Step(usize),
    /// A load from a point on, over a number of points.
    Pulse(usize, usize),
    /// A straight rise from a point on.
    Ramp(usize),
    /// A sinusoid of a frequency, cycles a point.
    Sinusoid(f64),
    /// A gain that changes evenly over the record.
    Drift,
    /// A gain that changes with level.
    Bend,
    /// Single wild values at these points.
    Outliers(Vec<usize>),
    /// Another loop's signal behind a first-order lag and a dead time, points.
    Neighbour(Arc<Load>, [f64; 2]),
}

impl Shape {
    /// Its id in the catalogue.
    #[must_use]
    pub fn id(&self) -> &'static str {
        match self {
            Self::Step(_) | Self::Pulse(..) => effects::step_load::EFFECT.id,
            Self::Ramp(_) => effects::ramp::EFFECT.id,
            Self::Sinusoid(_) => effects::sinusoid::EFFECT.id,
            Self::Drift => effects::gain_drift::EFFECT.id,
            Self::Bend => effects::static_nonlinearity::EFFECT.id,
            Self::Outliers(_) => effects::outliers::EFFECT.id,
            Self::Neighbour(..) => effects::neighbour::EFFECT.id,
        }
    }

    /// Its id with the name of the neighbour.
    #[must_use]
    pub(crate) fn full_id(&self) -> String {
        match self {
            Self::Neighbour(load, _) => effects::neighbour::id_of(&load.name),
            _ => self.id().to_owned(),
        }
    }

    /// Points at which a load that steps or lasts a while begins and ends; `None` for any other shape.
    #[must_use]
    pub(crate) const fn edges(&self) -> Option<[usize; 2]> {
        match self {
            Self::Step(at) => Some([*at, usize::MAX]),
            Self::Pulse(at, length) => Some([*at, *at + *length]),
            _ => None,
        }
    }

    /// Its columns for `n` points; `driven` is what valve and process make of OP.
    #[must_use]
    pub(crate) fn columns(&self, n: usize, driven: &[f64]) -> Vec<Vec<f64>> {
        match self {
            Self::Step(at) => vec![columns::step(*at as f64, None, n)],
            Self::Pulse(at, length) => {
                let [mut on, off] = [*at, at + length].map(|at| columns::step(at as f64, None, n));
                on.iter_mut().zip(&off).for_each(|(on, off)| *on -= off);
                vec![on]
            }
            Self::Ramp(from) => vec![columns::ramp(*from as f64, n)],
            Self::Sinusoid(frequency) => columns::waves(TAU * frequency, n).into(),
            Self::Drift => {
                let course = Drift { change: 1.0, by_factor: false }.course(n);
                vec![course.zip(driven).map(|(gain, d)| gain * d).collect()]
            }
            Self::Bend => {
                let mean = driven.iter().map(|d| d * d).sum::<f64>() / n as f64;
                vec![driven.iter().map(|d| d * d - mean).collect()]
            }
            Self::Outliers(at) => at.iter().map(|at| columns::single(*at, n)).collect(),
            Self::Neighbour(load, [lag, dead_time]) => vec![load.behind(*lag, *dead_time, n)],
        }
    }

    /// What its coefficients and the choice among `tried` shapes cost, nats.
    #[must_use]
    pub(crate) fn cost(&self, n: usize, tried: usize) -> f64 {
        let log_n = libm::log(n as f64);
        match self {
            // Its place is free as well.
            Self::Outliers(at) => 1.5 * at.len() as f64 * log_n,
            Self::Sinusoid(_) => log_n + libm::log(tried as f64),
            _ => 0.5 * log_n + libm::log(tried as f64),
        }
    }

    /// Its sizes in recorded units; `gain` is what PV gains with OP at rest, standard deviations of one over those of the
    /// other, `None` where that is not known.
    #[must_use]
    pub fn sizes(&self, beta: &[f64], series: &Series, gain: Option<f64>) -> BTreeMap<String, Quantity> {
        let first = beta.first().copied().unwrap_or(0.0);
        let deviation = series.of_pv[1];
        let whole_s = series.n() as f64 * series.point_s;
        let sizes: Vec<(&str, f64, &str)> = match self {
            Self::Step(at) => vec![("at", series.time_s(*at), "s"), ("size", first * deviation, "PV")],
            Self::Pulse(at, length) => vec![
                ("at", series.time_s(*at), "s"),
                ("size", first * deviation, "PV"),
                ("length", *length as f64 * series.point_s, "s"),
            ],
            Self::Ramp(from) => {
                vec![("from", series.time_s(*from), "s"), ("slope", first * deviation / whole_s, "PV/s")]
            }
            Self::Sinusoid(frequency) => {
                let amplitude = beta.iter().map(|b| b * b).sum::<f64>().sqrt() * deviation;
                vec![("period", series.point_s / frequency, "s"), ("amplitude", amplitude, "PV")]
            }
            Self::Drift => gain.map(|_| ("gain_change_over_record", first, "1")).into_iter().collect(),
            Self::Bend => {
                let per_op = |gain: f64| 2.0 * first * gain / series.op_deviation;
                gain.map(|gain| ("gain_change_per_op", per_op(gain), "1/OP")).into_iter().collect()
            }
            Self::Outliers(at) => {
                let mean = beta.iter().map(|b| b.abs()).sum::<f64>() / beta.len().max(1) as f64;
                let share = 1e3 * at.len() as f64 / series.n() as f64;
                vec![("per_thousand", share, "1"), ("size", mean * deviation, "PV")]
            }
            Self::Neighbour(load, [lag, dead_time]) => vec![
                ("lag", lag * series.point_s, "s"),
                ("dead_time", dead_time * series.point_s, "s"),
                ("gain", first * deviation / load.deviation, if load.from_op { "PV/OP" } else { "PV/PV" }),
                ("from_op", f64::from(u8::from(load.from_op)), "1"),
                ("p_value", load.p_value, "1"),
            ],
        };
        let quantity = |value, unit: &str| Quantity { value, unit: unit.to_owned() };
        sizes.into_iter().map(|(name, value, unit)| (name.to_owned(), quantity(value, unit))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_columns_are_what_the_names_say() {
        let driven: Vec<f64> = (0..100).map(|k| libm::sin(f64::from(k) * 0.3)).collect();
        let one = |shape: Shape| shape.columns(100, &driven).remove(0);
        assert_eq!(one(Shape::Pulse(40, 2))[39..43], [0.0, 1.0, 1.0, 0.0]);
        assert_eq!(one(Shape::Drift)[0], -0.5 * driven[0]);
        assert!(one(Shape::Bend).iter().sum::<f64>().abs() < 1e-9);
        let known = |shape: &Shape| effects::by_id(shape.id()).is_some();
        let all = [Shape::Step(1), Shape::Ramp(1), Shape::Sinusoid(0.1), Shape::Drift, Shape::Bend];
        assert!(all.iter().chain([&Shape::Outliers(Vec::new())]).all(known));
    }
}
