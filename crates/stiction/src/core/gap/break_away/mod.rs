//! Friction that differs from slip to slip: OP is replayed through the base's valve with a static band of its own at each
//! rest, drawn from a distribution; the kinetic band is in proportion.
//!
//! The slips' times ([`path`]), the bands' distribution ([`bands`]) and process and kinetic band ([`plant`]) are found in
//! turns. PV itself says when the stem slips, so that nothing is predicted where it was held out. The effect is named where
//! both halves of the record gain likelihood, the cost of the slips' times taken off, where the replay closes most of the gap,
//! and where the bands differ from slip to slip, but not with direction, time or the band before.

mod bands;
mod course;
mod path;
mod plant;

use super::document::closed_pct;
use super::effects::random_friction::EFFECT;
use super::express::above_floor;
use super::noise;
use super::problem::Problem;
use super::types::{Fit, Parameter};
use crate::core::record::Record;
use crate::core::signal::lag::correlation;
use crate::core::signal::stats;
use bands::Bands;
use course::Course;
use path::Search;
use plant::Plant;

/// Kinetic over static band at which a search begins, beside that of the base: random slips mislead the base's.
const RATIOS: [f64; 2] = [0.2, 0.5];
/// Spread of the bands' logarithm at which it begins.
const SPREAD: f64 = 0.25;
/// Rounds of a search, and how many without a gain end it.
const ROUNDS: usize = 16;
const IN_VAIN: usize = 5;
/// Variance that is allowed for over what the last round left: some of that belongs to slips that are not yet right.
const ALLOWED: f64 = 2.0;
/// Fewest slips that have a distribution.
const FEWEST: usize = 6;
/// Friction counts as random where each half of the record gains so many nats, where the replay closes so much of the gap, %,
/// where the bands' logarithm spreads at least so far, and where direction, time and the band before each explain less of
/// it than so many standard errors. Chosen on the loops of `val_friction` with seeds 61 and 63.
const GAIN: f64 = 16.0;
const CLOSED: f64 = 80.0;
const LEAST_SPREAD: f64 = 0.1;
const SYSTEMATIC: f64 = 3.0;

/// A replay whose bands are random.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Replay {
    /// The free run with the slips' own bands, and the model with the median one.
    pub fit: Fit,
    /// Median and spread of the static bands.
    pub parameters: Vec<Parameter>,
}

/// What one search came to.
pub(super) struct Found {
    course: Course,
    plant: Plant,
    bands: Bands,
    prediction: Vec<f64>,
    /// Nats that it takes to say PV and the slips.
    score: f64,
}

/// Number of searches.
pub(super) const SEARCHES: usize = RATIOS.len() + 1;

/// One of the searches from a base that was fitted to all of a record: its best round; `None` where its valve hardly slips.
pub(super) fn search(record: &Record, base: &Fit, from: usize, which: usize) -> Option<Found> {
    let valve = &base.model.valve;
    if valve.fs <= 0.0 || base.slips.len() < FEWEST {
        return None;
    }
    let mut plant = Plant::of(base, record);
    let s = valve.fs + valve.fd;
    plant.ratio = which.checked_sub(1).map_or(plant.ratio, |other| RATIOS[other]);
    let mut bands = Bands::new(s / (1.0 + plant.ratio), SPREAD);
    let op = record.op();
    let mut variance = ALLOWED * variance_of(&record.pv, &base.prediction, from);
    let (mut best, mut in_vain): (Option<Found>, usize) = (None, 0);
    for _ in 0..ROUNDS {
        let search = Search { op: &op, pv: &record.pv, plant: &plant, bands, variance, from };
        let Some(mut course) = search.best(base.valve[0]).filter(|course| course.slips.len() >= FEWEST) else { break };
        bands = bands.fitted(course.slips.iter().map(|slip| (slip.point as f64 / op.len() as f64 - 0.5, slip.between)));
        plant.refit(&mut course, &record.pv, from);
        // Paths have the likeliest bands, not those that meet PV.
        variance = ALLOWED * variance_of(&record.pv, &plant.predicted(&course.stem), from);
        plant.polish(&mut course, &record.pv, from);
        plant.refit(&mut course, &record.pv, from);
        let prediction = plant.predicted(&course.stem);
        let left = variance_of(&record.pv, &prediction, from);
        let score = 0.5 * (record.len() - from) as f64 * libm::log(left) + course.cost;
        in_vain += 1;
        if best.as_ref().is_none_or(|best| score < best.score) {
            best = Some(Found { course, plant: plant.clone(), bands, prediction, score });
            in_vain = 0;
        } else if in_vain == IN_VAIN {
            break;
        }
    }
    best
}

fn variance_of(pv: &[f64], prediction: &[f64], from: usize) -> f64 {
    let left: Vec<f64> = pv[from..].iter().zip(&prediction[from..]).map(|(pv, p)| pv - p).collect();
    stats::variance(&left)
}

/// The best of the searches where its bands are random; `floor` in PV units.
pub(super) fn judge(
    record: &Record,
    problem: &Problem,
    base: &Fit,
    floor: f64,
    found: impl IntoIterator<Item = Found>,
) -> Option<Replay> {
    let from = problem.blocks.from;
    let best = found.into_iter().min_by(|a, b| a.score.total_cmp(&b.score))?;
    let gap = |run: &[f64]| above_floor(variance_of(&record.pv, run, from).sqrt(), Some(floor));
    let closed = closed_pct(gap(&base.prediction), gap(&best.prediction));
    let spread = best.bands.spread();
    let is_random = closed.is_some_and(|closed| closed >= CLOSED)
        && spread >= LEAST_SPREAD
        && !is_systematic(&best)
        && gains(&record.pv, &base.prediction, &best, from).into_iter().all(|gain| gain >= GAIN);
    is_random.then(|| Replay {
        parameters: vec![
            Parameter { name: "median_fs", value: best.bands.median(), unit: "OP" },
            Parameter { name: "spread", value: spread, unit: "1" },
        ],
        fit: fit(record, problem, base, floor, best),
    })
}

/// Nats that the halves of a record gain under a noise model of what each run leaves, half of the slips' cost taken off.
fn gains(pv: &[f64], before: &[f64], after: &Found, from: usize) -> [f64; 2] {
    let middle = usize::midpoint(from, pv.len());
    let left = |run: &[f64]| -> Vec<f64> { pv.iter().zip(run).map(|(pv, run)| pv - run).collect() };
    let [before, left_after] = [left(before), left(&after.prediction)];
    [[from, middle], [middle, pv.len()]].map(|half| {
        let error = |left: &[f64]| noise::autoregression(left, &[half]).map(|found| libm::log(found.mse));
        let gain = error(&before).zip(error(&left_after)).map_or(0.0, |(before, after)| before - after);
        0.5 * (half[1] - half[0]) as f64 * gain - 0.5 * after.course.cost
    })
}

/// Whether the bands go with the slips' direction, with time, or with the band before.
fn is_systematic(found: &Found) -> bool {
    let slips = &found.course.slips;
    let root = (slips.len() as f64).sqrt();
    let [upwards, logs]: [Vec<f64>; 2] =
        [slips.iter().map(|s| s.band.signum()).collect(), slips.iter().map(|s| libm::log(s.band.abs())).collect()];
    let by_direction = root * correlation(&upwards, &logs);
    // The standard deviation of times that are spread evenly over a record is 1 / sqrt(12) of it.
    let by_time = root * found.bands.growth() / (found.bands.spread() * 12.0_f64.sqrt());
    let by_last = root * correlation(&logs[1..], &logs[..logs.len() - 1]);
    [by_direction, by_time, by_last].into_iter().any(|errors| errors.abs() >= SYSTEMATIC)
}

fn fit(record: &Record, problem: &Problem, base: &Fit, floor: f64, found: Found) -> Fit {
    // What the slips cost, in parameters of BIC.
    let as_parameters = 2.0 * found.course.cost / libm::log(record.len() as f64);
    let mut model = base.model.clone();
    model.valve.fs = found.bands.median();
    model.valve.fd = found.plant.ratio * model.valve.fs;
    found.plant.write_to(&mut model.process, record);
    Fit {
        parameters: base.parameters + as_parameters.ceil() as usize,
        evaluations: base.evaluations,
        ..Fit::of_run(problem, EFFECT.id.to_owned(), model, found.prediction, found.course.stem, Some(floor))
    }
}

#[cfg(test)]
mod tests {
    use super::variance_of;
    use crate::core::gap::{Diagnosis, Fit, GapOptions, Serial, diagnose};
    use crate::core::record::Record;
    use crate::core::sim::noise::Noise;
    use crate::core::sim::valve::he_step;

    /// A first-order process behind a valve whose bands of 2.5 and 1 spread by so much from slip to slip.
    fn record(spread: f64) -> Record {
        let (mut chance, mut noise) = (Noise::new(3, 1), Noise::new(3, 2));
        let wave = |k: usize, by: f64| libm::sin(k as f64 * by);
        let op: Vec<f64> = (0..900).map(|k| 6.0 * wave(k, 0.06) + 2.0 * wave(k, 0.017)).collect();
        let (mut stem, mut process, mut by, mut pv) = (0.0, 0.0, 1.0, Vec::new());
        for u in &op {
            pv.push(process + 0.02 * noise.gaussian());
            let next = he_step(stem, *u, 2.5 * by, by);
            if next != stem {
                by = libm::exp(spread * chance.gaussian());
            }
            stem = next;
            process += 0.1 * (1.5 * stem - process);
        }
        Record::uniform(1.0, op, pv)
    }

    fn diagnosed(record: &Record, without: &[&str]) -> Diagnosis {
        let without = without.iter().map(|id| (*id).to_owned()).collect();
        let options = GapOptions { budget_evaluations: 20_000, without, ..GapOptions::default() };
        diagnose(record, &options, &Serial).unwrap()
    }

    #[test]
    fn friction_that_differs_from_slip_to_slip_is_named_with_its_spread() {
        let record = record(0.3);
        let made = diagnosed(&record, &[]);
        assert!(made.cause.id == "random_friction" && !made.cause.confirmed, "{:?}", made.cause);
        let value = |name: &str| made.named().unwrap().parameters.iter().find(|p| p.name == name).unwrap().value;
        assert!((value("median_fs") - 2.5).abs() < 0.4 && (value("spread") - 0.3).abs() < 0.12, "{:?}", made.named());
        let left = |fit: &Fit| variance_of(&record.pv, &fit.prediction, made.findings.blocks.from).sqrt();
        let [base, replay] = &made.fits_to_all[..] else { panic!("{:?}", made.fits_to_all) };
        assert!(replay.id == "random_friction" && left(replay) < 0.3 * left(base), "{} {}", left(replay), left(base));
    }

    #[test]
    fn constant_friction_and_an_effect_that_is_left_out_are_not_named() {
        assert_ne!(diagnosed(&record(0.0), &[]).cause.id, "random_friction");
        assert_eq!(diagnosed(&record(0.3), &["random_friction"]).cause.id, "unknown");
    }
}
