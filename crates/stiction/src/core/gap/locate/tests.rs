//! A residual that is put into a known place is found there.

use super::*;
use crate::core::gap::model::{Model, Process, SCHEMA, Valve};
use crate::core::gap::types::{Blocks, Fit, Slip, Stage};
use crate::core::sim::noise::Noise;
use crate::core::sim::process::{ProcessModel, ProcessState};
use crate::core::sim::valve::he_step;
use proptest::prelude::*;

const N: usize = 1200;
const PERIOD: f64 = 60.0;
const GAIN: f64 = 2.0;
const TAU: f64 = 6.0;
const DEAD: f64 = 2.0;
const TS_S: f64 = 2.0;
/// sd of the noise that is in every residual here, PV units.
const NOISE: f64 = 0.02;

/// A slow swing with a faster one in it, so that stem and OP stand at many levels.
fn op() -> Vec<f64> {
    let turn = |k: usize, period: f64| libm::sin(2.0 * core::f64::consts::PI * k as f64 / period);
    (0..N).map(|k| 50.0 + 4.0 * turn(k, PERIOD) + 1.5 * turn(k, 7.3 * PERIOD)).collect()
}

fn stem(op: &[f64]) -> Vec<f64> {
    let mut at = op[0];
    op.iter()
        .map(|u| {
            at = he_step(at, *u, 1.5, 0.5);
            at
        })
        .collect()
}

fn answer(valve: &[f64]) -> Vec<f64> {
    let model = ProcessModel { gain: GAIN, tau: TAU, tau2: 0.0, dead_time: DEAD, integrating: false };
    let mut process = ProcessState::at_rest(model, valve[0]);
    valve.iter().map(|v| process.step(*v, 0.0)).collect()
}

fn slips(valve: &[f64]) -> Vec<Slip> {
    let steps = valve.windows(2).map(|w| w[1] - w[0]).enumerate().filter(|(_, d)| *d != 0.0);
    steps.map(|(k, d)| Slip { point: k + 1, direction: d.signum(), size: d.abs() }).collect()
}

/// A diagnosis whose base is the model that made the record, and a record that differs from it by `residual`.
fn case(residual: impl Fn(usize, &[f64], &[f64]) -> f64) -> (Record, Case) {
    let op = op();
    let valve = stem(&op);
    let prediction = answer(&valve);
    let mut noise = Noise::new(11, 1);
    let pv = (0..N).map(|k| prediction[k] + residual(k, &op, &valve) + NOISE * noise.gaussian()).collect();
    (Record::uniform(TS_S, op, pv), diagnosis(valve, prediction))
}

fn diagnosis(valve: Vec<f64>, prediction: Vec<f64>) -> Case {
    let n = prediction.len();
    let length = (1.5 * PERIOD) as usize;
    let model = Model {
        schema: SCHEMA.to_owned(),
        ts_s: TS_S,
        valve: Valve { law: "he".to_owned(), fs: 1.5, fd: 0.5, stem0: None },
        process: Process {
            gain: GAIN,
            time_constants_s: vec![TAU * TS_S],
            dead_time_s: DEAD * TS_S,
            integrating: false,
            op: 50.0,
            pv: 100.0,
        },
        effects: Vec::new(),
    };
    let base = Fit {
        id: "base".to_owned(),
        slips: slips(&valve),
        valve,
        prediction,
        rmse_train: 1.0,
        rmse: 1.0,
        gap: 1.0,
        parameters: 6,
        evaluations: 1,
        at_floor: false,
        points: 0,
        one_step: [[0.0; 2]; 5],
        model,
    };
    Case {
        base,
        blocks: Blocks {
            from: 30,
            length,
            held_out: (0..n).map(|k| k / length % 2 == 1).collect(),
            masked: vec![false; n],
            number: (0..n).map(|k| k / length).collect(),
        },
    }
}

/// A fit and the points that count.
struct Case {
    base: Fit,
    blocks: Blocks,
}

impl Case {
    fn locate(&self, record: &Record, period_points: Option<f64>, seed: u64) -> Location {
        let subject = Subject {
            fit: &self.base,
            blocks: &self.blocks,
            noise_floor: Some(NOISE),
            signatures: &[],
            stages: None,
            stage: Stage::None,
            period_points,
            seed,
        };
        locate(record, &subject)
    }
}

fn found(residual: impl Fn(usize, &[f64], &[f64]) -> f64) -> Location {
    let (record, diagnosis) = case(residual);
    let location = diagnosis.locate(&record, Some(PERIOD), 1);
    assert_whole(&location);
    location
}

/// Every list of shares adds up to 1.
fn assert_whole(l: &Location) {
    let lists: [(&str, Vec<Option<f64>>); 5] = [
        ("segments", l.segments.iter().map(|s| s.share).collect()),
        ("phases", vec![l.phases.stuck, l.phases.slip, l.phases.moving]),
        ("direction", vec![l.direction.up, l.direction.down]),
        ("bands", l.bands.iter().map(|b| b.share).collect()),
        ("level", l.level.iter().map(|b| b.share).collect()),
    ];
    for (name, list) in lists {
        let sum: f64 = list.iter().flatten().sum();
        assert!((sum - 1.0).abs() < 1e-9, "{name}: {list:?}");
    }
}

fn wave(k: usize, period: f64) -> f64 {
    libm::sin(2.0 * core::f64::consts::PI * k as f64 / period)
}

/// The stem's last move before `k`: how long ago, and its direction.
fn last_move(k: usize, valve: &[f64]) -> (usize, f64) {
    let at = (1..=k).rev().find(|&i| valve[i] != valve[i - 1]);
    at.map_or((usize::MAX, 0.0), |i| (k - i, (valve[i] - valve[i - 1]).signum()))
}

#[test]
fn noise_alone_lies_nowhere() {
    let l = found(|_, _, _| 0.0);
    let tests = [l.uneven.segments, l.uneven.phases, l.uneven.direction, l.uneven.level, l.trend.trend];
    assert!(tests.iter().flatten().filter(|t| t.p < 0.05).count() <= 1, "{tests:?}");
    assert!(l.onset_s.is_none(), "{l:?}");
    assert_eq!((l.slips.missed, l.slips.extra), (Some(0), Some(0)));
    for band in &l.bands {
        assert!((band.share.unwrap() - band.expected).abs() < 0.1, "{band:?}");
    }
}

#[test]
fn a_gap_in_one_stretch_is_found_in_its_segment_and_its_onset_in_time() {
    // Points 450 to 540 are held out.
    let l = found(|k, _, _| if (450..525).contains(&k) { 0.5 * wave(k, 9.0) } else { 0.0 });
    let most = l.segments.iter().max_by(|a, b| a.share.partial_cmp(&b.share).unwrap()).unwrap();
    let middle = 0.5 * (most.from_s + most.to_s) / TS_S;
    assert!(most.share.unwrap() > 0.6 && (450.0..525.0).contains(&middle), "{most:?}");
    let l = found(|k, _, _| if k >= 700 { 0.3 * wave(k, 9.0) } else { 0.0 });
    let onset = l.onset_s.expect("the power grows a hundredfold");
    assert!((onset / TS_S - 700.0).abs() <= PERIOD, "{onset}");
    assert!(l.trend.onset_ratio.unwrap() > 20.0 && l.trend.trend_ratio.unwrap() > 5.0);
}

#[test]
fn a_gap_after_each_slip_is_found_there_and_not_elsewhere() {
    let l = found(|k, _, v| if last_move(k, v).0 < 6 { 0.3 } else { 0.0 });
    assert!(l.phases.slip.unwrap() > 0.9 && l.uneven.phases.unwrap().p <= 0.02, "{:?} {:?}", l.phases, l.uneven);
    assert!((l.slip_window_s - (TAU + DEAD) * TS_S).abs() < 1e-9);
    let l = found(|k, _, v| if last_move(k, v).0 > 9 { 0.3 } else { 0.0 });
    assert!(l.phases.stuck.unwrap() > 0.9, "{:?}", l.phases);
}

#[test]
fn a_gap_after_moves_up_is_found_in_that_direction() {
    let l = found(|k, _, v| if last_move(k, v).1 > 0.0 { 0.2 } else { 0.0 });
    assert!(l.direction.up.unwrap() > 0.9 && l.direction_ratio.unwrap() > 10.0, "{:?}", l.direction);
    assert!(l.uneven.direction.unwrap().p <= 0.02);
}

#[test]
fn a_gap_at_one_frequency_is_found_in_its_band() {
    for (band, period) in [(0, 8.0 * PERIOD), (2, PERIOD), (4, PERIOD / 4.0), (6, PERIOD / 20.0)] {
        let l = found(|k, _, _| 0.4 * wave(k, period));
        let share = l.bands[band].share.unwrap();
        assert!(share > 0.85, "band {band}: {:?}", l.bands);
        let hz = 1.0 / (period * TS_S);
        assert!(l.bands[band].from_hz <= hz && hz < l.bands[band].to_hz);
    }
}

#[test]
fn a_gap_at_high_op_is_found_at_its_level() {
    let l = found(|k, op, _| if op[k] > 53.0 { 0.3 } else { 0.0 });
    let above: f64 = l.level.iter().filter(|b| b.to > 53.2).filter_map(|b| b.share).sum();
    let r2 = l.level_r2.op.unwrap();
    assert!(above > 0.9 && r2.value > 0.5 && r2.p <= 0.02, "{:?} {r2:?}", l.level);
    assert!(l.level.last().unwrap().mean.unwrap() > 0.25);
}

#[test]
fn slips_that_model_and_plant_do_not_share_are_counted() {
    let op = op();
    let valve = stem(&op);
    let moves = slips(&valve);
    // The model's stem misses two slips for a while: from one slip until the stem is back where it was before it.
    let mut other = valve.clone();
    let mut skipped = 0;
    for slip in moves.iter().filter(|s| s.point > 300) {
        let before = valve[slip.point - 1];
        let back = (slip.point..N).find(|&k| (valve[k] - before).abs() < 0.2 && k > slip.point + 12);
        if let Some(back) = back
            && moves.iter().filter(|m| m.point > slip.point && m.point <= back).count() == 1
            && skipped < 1
        {
            other[slip.point..back].fill(before);
            skipped += 1;
        }
    }
    assert_eq!(skipped, 1, "no lone slip in {} moves", moves.len());
    let count = |plant: &[f64], model: &[f64], mv: bool| {
        let mut noise = Noise::new(5, 1);
        let pv = answer(plant).iter().map(|y| y + NOISE * noise.gaussian()).collect();
        let mut record = Record::uniform(TS_S, op.clone(), pv);
        record.mv = mv.then(|| plant.iter().map(|v| 12.0 - 0.1 * v).collect());
        diagnosis(model.to_vec(), answer(model)).locate(&record, Some(PERIOD), 1).slips
    };
    for mv in [false, true] {
        let missed = count(&valve, &other, mv);
        assert_eq!((missed.missed, missed.extra), (Some(2), Some(0)), "mv {mv}");
        let extra = count(&other, &valve, mv);
        assert_eq!((extra.missed, extra.extra), (Some(0), Some(2)), "mv {mv}");
    }
}

#[test]
fn excitation_counts_positions_and_set_point_moves() {
    let (mut record, mut diagnosis) = case(|_, _, _| 0.0);
    record.sp = Some((0..N).map(|k| if k < 400 { 100.0 } else { 103.0 }).collect());
    let e = diagnosis.locate(&record, Some(PERIOD), 1).excitation;
    assert!(e.levels > 5 && !e.two_level && e.setpoint_moves == Some(1) && e.jumps_per_half_cycle.unwrap() > 1.0);
    diagnosis.base.valve = (0..N).map(|k| if k / 30 % 2 == 0 { 49.0 } else { 51.0 }).collect();
    diagnosis.base.slips = slips(&diagnosis.base.valve);
    let e = diagnosis.locate(&record, Some(PERIOD), 1).excitation;
    assert!(e.two_level && e.levels == 2 && e.jumps_per_half_cycle == Some(1.0), "{e:?}");
}

#[test]
fn a_linear_base_has_no_slips_to_miss() {
    let (record, mut diagnosis) = case(|_, _, _| 0.1);
    diagnosis.base.model.valve.law = "none".to_owned();
    diagnosis.base.valve = record.op();
    diagnosis.base.slips = Vec::new();
    let l = diagnosis.locate(&record, None, 1);
    assert_whole(&l);
    assert!(l.phases.moving.unwrap() > 0.99 && l.slips.missed.is_none() && l.slips.extra.is_none());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn nothing_panics_and_no_figure_is_infinite(
        n in 0_usize..300,
        kind in 0_u8..6,
        from in 0_usize..400,
        seed in 0_u64..1000,
    ) {
        let mut noise = Noise::new(seed, 2);
        let mut value = move |k: usize| match kind {
            0 => 5.0,
            1 => noise.gaussian(),
            2 => 1e300 * noise.gaussian(),
            3 => if k.is_multiple_of(7) { f64::NAN } else { noise.gaussian() },
            4 => 1e-300 * noise.gaussian(),
            _ => if k.is_multiple_of(11) { f64::INFINITY } else { f64::from(u8::from(k > 50)) },
        };
        let op: Vec<f64> = (0..n).map(&mut value).collect();
        let pv: Vec<f64> = (0..n).map(&mut value).collect();
        let valve: Vec<f64> = (0..n).map(&mut value).collect();
        let mut d = diagnosis(valve, pv.iter().map(|y| 0.5 * y).collect());
        d.blocks.from = from;
        let mut record = Record::uniform(1.0, op, pv.clone());
        record.sp = Some(pv.clone());
        record.mv = (seed % 2 == 0).then_some(pv);
        let location = d.locate(&record, Some(20.0), seed);
        let text = serde_json::to_string(&location).unwrap();
        prop_assert_eq!(serde_json::from_str::<Location>(&text).ok().map(|l| l.segments.len()), Some(16), "{}", text);
    }
}
