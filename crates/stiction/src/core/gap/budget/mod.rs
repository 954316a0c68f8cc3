//! The budget: which part of PV's variance is valve and process, a named effect, a disturbance that wanders, noise, or
//! unexplained; and what the record can tell at all.
//!
//! The free run of [`crate::core::gap::diagnose`] asks whether one effect brings the model down to the noise. A real loop's
//! disturbance wanders, so that none does. Here effects are judged by one-step predictions of a noise model ([`super::noise`]), added
//! one by one ([`search`]), asked of both halves (`halves`) and put into one sum (`parts`). It changes the cause only where
//! both halves confirm the load of another loop.

pub mod document;
pub(super) mod halves;
pub(crate) mod parts;
mod scan;
pub mod search;
pub mod series;
pub(crate) mod shapes;
mod smallest;

use super::neighbour::Load;
use super::types::Fit;
use crate::core::record::Record;
use parts::Split;
use search::{Model, Searched};
use series::Series;
use shapes::Shape;

/// What is known of a record before.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Known<'a> {
    /// The base, fitted to all of the record, and the base with the cause where one is named.
    pub models: &'a [Fit],
    /// First point at which their free runs are valid.
    pub from: usize,
    /// Period of the oscillation, points.
    pub period: Option<f64>,
    /// Standard deviation of PV's noise, PV units.
    pub noise_sd: Option<f64>,
    /// Signals of other loops that may act on PV, at the record's points.
    pub loads: &'a [Load],
}

/// The budget of a record.
#[derive(Debug, Clone)]
pub struct Budget {
    /// What was split.
    pub series: Series,
    /// The noise model before effects were added.
    pub model: Model,
    /// The effects, and the noise model with them.
    pub searched: Searched,
    /// Whether the halves confirm each effect.
    pub confirmed: Vec<bool>,
    /// The parts.
    pub split: Split,
    /// The least step that would have been named, standard deviations of PV.
    pub smallest_step: Option<f64>,
    /// The least slow sinusoid, and its frequency, cycles a point.
    pub smallest_sinusoid: Option<(f64, f64)>,
}

/// The series of a record, its noise model, and the effects found in it; `None` as for [`Budget::of`].
fn search_in(record: &Record, known: &Known<'_>) -> Option<(Series, Model, Searched)> {
    let finite = |x: &[f64]| x.iter().all(|v| v.is_finite());
    if !finite(&record.pv) || !finite(&record.op_path) {
        return None;
    }
    let series = Series::of(record, known)?;
    let model = Model::of(&series)?;
    let searched = search::search(&series, &model);
    Some((series, model, searched))
}

/// The load that gains most under the noise model, of those that both halves confirm.
#[must_use]
pub(crate) fn acting_load(record: &Record, known: &Known<'_>) -> Option<String> {
    let (_, model, searched) = search_in(record, known)?;
    let mut confirmed = searched.added.iter().enumerate().filter(|(k, _)| halves::confirm(&model, &searched, *k));
    confirmed.find_map(|(_, added)| match &added.shape {
        Shape::Neighbour(load, _) => Some(load.name.clone()),
        _ => None,
    })
}

impl Budget {
    /// Splits a record; `None` where it is too short, OP or PV does not move, or no noise model can be fitted.
    #[must_use]
    pub fn of(record: &Record, known: Known<'_>) -> Option<Self> {
        let (series, model, searched) = search_in(record, &known)?;
        let confirmed = (0..searched.added.len()).map(|k| halves::confirm(&model, &searched, k)).collect();
        // The mean of a box holds its share of the noise.
        let by = series.of_pv[1] * (series.box_points as f64).sqrt();
        let split = parts::split(&series, &model, &searched, known.noise_sd.map(|sd| sd / by));
        Some(Self {
            smallest_step: smallest::step(&series, &model, &searched),
            smallest_sinusoid: smallest::sinusoid(&series, &model, &searched),
            series,
            model,
            searched,
            confirmed,
            split,
        })
    }

    /// Id of each part that is an effect, and whether the halves confirm it: of several loads at least two.
    #[must_use]
    pub fn named(&self) -> Vec<(String, bool)> {
        let name = |part: &Vec<usize>| match part.as_slice() {
            [one] => (self.searched.added[*one].shape.full_id(), self.confirmed[*one]),
            several => (document::UPSETS.to_owned(), several.iter().filter(|k| self.confirmed[**k]).count() >= 2),
        };
        self.searched.parts().iter().map(name).collect()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::core::sim::noise::Noise;

    const N: usize = 900;

    /// A PI loop around a first-order process with moves of SP, a disturbance that wanders, noise, and one effect.
    #[derive(Debug, Clone, Copy, Default)]
    pub(super) struct Loop {
        pub step: f64,
        pub pulse: f64,
        pub wave: f64,
        pub burst: bool,
        pub wild: f64,
        pub drift: f64,
    }

    /// What PV is made of.
    pub(super) struct Truth {
        pub pv: Vec<f64>,
        pub process: Vec<f64>,
        pub effect: Vec<f64>,
        pub rest: Vec<f64>,
    }

    impl Loop {
        fn effect(&self, k: usize) -> f64 {
            let step = if k >= 500 { self.step } else { 0.0 };
            let pulse = if (250..270).contains(&k) { self.pulse } else { 0.0 };
            let sounds = !self.burst || k < N / 2;
            let wave = if sounds { self.wave * libm::sin(k as f64 * core::f64::consts::TAU / 23.0) } else { 0.0 };
            step + pulse + wave + if k % 100 == 60 && k > 100 { self.wild } else { 0.0 }
        }

        pub(super) fn run(&self, seed: u64) -> (Record, Truth) {
            let (mut noise, mut walk) = (Noise::new(seed, 1), Noise::new(seed, 2));
            let (mut x, mut d, mut sum) = (0.0, 0.0, 0.0);
            let mut truth = Truth { pv: vec![], process: vec![], effect: vec![], rest: vec![] };
            let (mut op, mut set) = (vec![], vec![]);
            for k in 0..N {
                d = 0.97 * d + 0.08 * walk.gaussian();
                let rest = d + 0.05 * noise.gaussian();
                let effect = self.effect(k);
                let y = x + effect + rest;
                let sp = if (k / 75) % 2 == 0 { 1.0 } else { -1.0 };
                sum += 0.08 * (sp - y);
                let u = 0.8 * (sp - y) + sum;
                for (series, value) in [
                    (&mut truth.pv, y),
                    (&mut truth.process, x),
                    (&mut truth.effect, effect),
                    (&mut truth.rest, rest),
                    (&mut op, u),
                    (&mut set, sp),
                ] {
                    series.push(value);
                }
                let gain = 1.0 + self.drift * (2.0 * k as f64 / N as f64 - 1.0);
                x = 0.9 * x + 0.1 * gain * u;
            }
            (Record { sp: Some(set), ..Record::uniform(1.0, op, truth.pv.clone()) }, truth)
        }

        pub(super) fn series_of(&self, record: Record) -> Series {
            Series::of(&record, &Known { period: Some(150.0), ..Known::default() }).unwrap()
        }

        pub(super) fn series(&self, seed: u64) -> Series {
            self.series_of(self.run(seed).0)
        }
    }

    /// The shapes that the search adds.
    pub(super) fn named(series: &Series) -> Vec<Shape> {
        let model = Model::of(series).unwrap();
        search::search(series, &model).added.into_iter().map(|a| a.shape).collect()
    }

    #[test]
    fn a_null_resampled_from_the_fit_names_next_to_nothing() {
        let series = Loop::default().series(3);
        let model = Model::of(&series).unwrap();
        let names: usize = (0..20).filter(|seed| !named(&model.resampled(&series, *seed)).is_empty()).count();
        assert!(names <= 1, "{names} of 20");
    }

    /// A cycle whose phase drifts, as a load.
    fn cycle_with_phase_drift(seed: u64) -> Load {
        let (mut noise, mut phase) = (Noise::new(seed, 4), 0.0);
        let values: Vec<f64> = (0..N)
            .map(|_| {
                phase += (1.0 + 0.3 * noise.gaussian()) * core::f64::consts::TAU / 60.0;
                5.0 * libm::sin(phase) + 0.2 * noise.gaussian()
            })
            .collect();
        Load::new("F7", false, &values, 0.01)
    }

    /// The budget's row of a load that acts on PV with this size.
    fn row_of_load(load: &Load, acts: impl Fn(usize) -> f64) -> Option<document::PartNote> {
        let (mut record, _) = Loop::default().run(3);
        let behind = load.behind(6.0, 4.0, N);
        record.pv.iter_mut().zip(&behind).enumerate().for_each(|(k, (y, x))| *y += acts(k) * x);
        let budget = Budget::of(&record, Known { loads: core::slice::from_ref(load), ..Known::default() }).unwrap();
        document::BudgetNote::of(&budget, &[], None).parts.into_iter().find(|part| part.id == "neighbour(F7)")
    }

    #[test]
    fn another_loops_load_is_a_part_with_its_lag_where_both_halves_have_it() {
        let load = cycle_with_phase_drift(2);
        let row = row_of_load(&load, |_| 0.6).unwrap();
        let size = |name: &str| row.parameters[name].value;
        assert_eq!(row.confirmed, Some(true));
        assert!((size("lag") + size("dead_time") - 10.0).abs() < 3.0, "{row:?}");
        assert!((size("gain") * load.deviation - 0.6).abs() < 0.15 && row.gain_nats.unwrap() > 20.0, "{row:?}");
        assert!(row_of_load(&load, |_| 0.0).is_none());
        let half = row_of_load(&load, |k| if k < N / 2 { 0.6 } else { 0.0 });
        assert!(half.is_none_or(|row| row.confirmed == Some(false)));
    }

    #[test]
    fn a_step_and_a_pulse_are_one_part_with_two_events_and_either_alone_is_a_load() {
        let note = |of: Loop| {
            let budget = Budget::of(&of.run(1).0, Known { period: Some(150.0), ..Known::default() }).unwrap();
            let named = budget.named();
            (named, document::BudgetNote::of(&budget, &[], None))
        };
        let (named, both) = note(Loop { step: 1.5, pulse: 1.5, ..Loop::default() });
        assert_eq!(named, [(document::UPSETS.to_owned(), true)]);
        let part = both.parts.iter().find(|part| part.id == document::UPSETS).unwrap();
        let times: Vec<(f64, Option<f64>)> = part.events.iter().map(|e| (e.at_s, e.length_s)).collect();
        assert!(
            matches!(times[..], [(pulse, Some(length)), (step, None)]
            if (pulse - 250.0).abs() <= 2.0 && (length - 20.0).abs() <= 3.0 && (step - 500.0).abs() <= 2.0),
            "{times:?}"
        );
        assert!(part.parameters.is_empty() && part.gain_nats > Some(16.0), "{part:?}");
        let (named, alone) = note(Loop { pulse: 1.5, ..Loop::default() });
        assert_eq!(named, [("step_load".to_owned(), true)]);
        let part = alone.parts.iter().find(|part| part.id == "step_load").unwrap();
        assert!((part.parameters["length"].value - 20.0).abs() <= 3.0 && part.events.is_empty(), "{part:?}");
    }

    #[test]
    fn one_record_has_one_budget() {
        let of = Loop { step: 1.5, ..Loop::default() };
        let once = || Budget::of(&of.run(1).0, Known { noise_sd: Some(0.05), ..Known::default() }).unwrap();
        let (first, second) = (once(), once());
        assert_eq!(first.split, second.split);
        assert_eq!((first.confirmed, first.smallest_step), (second.confirmed, second.smallest_step));
        assert!(first.split.noise.size > 0.02 && first.split.noise.share < 0.01, "{:?}", first.split);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn hostile_records_have_a_finite_budget_or_none(
            n in 0_usize..260, seed in any::<u64>(), held in 1_usize..40, size in -12_i32..12, kind in 0_u8..5,
        ) {
            let mut noise = Noise::new(seed, 9);
            let size = libm::pow(10.0, f64::from(size));
            let mut x = 0.0;
            let pv: Vec<f64> = (0..n).map(|k| {
                if k % held == 0 {
                    x = match kind {
                        0 => 0.0,
                        1 => x + noise.gaussian(),
                        2 => noise.gaussian().round(),
                        3 => f64::from(u8::from(k == n / 2)),
                        _ => 1e9 + noise.gaussian(),
                    };
                }
                size * x
            }).collect();
            let op: Vec<f64> = pv.iter().map(|y| if kind == 2 { -y } else { y * y - (y * 3.0).round() }).collect();
            let budget = Budget::of(&Record::uniform(1.0, op, pv), Known::default());
            if let Some(budget) = budget {
                let note = document::BudgetNote::of(&budget, &[], None);
                let sum: f64 = note.parts.iter().map(|p| p.share_pct).sum();
                prop_assert!((sum - 100.0).abs() < 1e-6, "{sum}: {note:?}");
                prop_assert!(note.parts.iter().all(|p| p.sd.is_finite() && p.sd >= 0.0), "{note:?}");
            }
        }
    }
}
