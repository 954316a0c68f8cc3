//! The pictures' numbers on loops whose valve and process are known.

use super::*;
use crate::core::ident::class::Shape;
use crate::core::ident::{DelayChoice, ModelChoice, ValveChoice};
use crate::core::sim::noise::Noise;
use crate::core::sim::slips::Law;
use crate::core::sim::valve::he_step;

const FS: f64 = 2.4;
const FD: f64 = 1.2;
const NOISE: f64 = 0.05;

/// An oscillating OP, a sticking valve of He's law, a process of one class (points), white noise.
fn record(class: Class, shape: Shape) -> (Record, Vec<f64>) {
    let op: Vec<f64> =
        (0..600).map(f64::from).map(|t| 50.0 + 4.0 * libm::sin(0.08 * t) + 2.0 * libm::sin(0.019 * t)).collect();
    let mut position = op[0];
    let stem: Vec<f64> = op
        .iter()
        .map(|u| {
            position = he_step(position, *u, FS, FD);
            position
        })
        .collect();
    let mut noise = Noise::new(7, 1);
    let pv = class.respond(&shape, &stem);
    let pv = pv.iter().map(|x| 1.5 * x + NOISE * noise.gaussian()).collect();
    (Record::uniform(2.0, op, pv), stem)
}

fn options() -> Options {
    Options {
        model: ModelChoice::Auto,
        delay: DelayChoice::Auto,
        valve: ValveChoice::He,
        fineness_pct: 5.0,
        seed: 1,
        period_points: Some(78.0),
        ..Options::default()
    }
}

fn truth(time_constants_s: &[f64], dead_time_s: f64) -> Model {
    let (law, gain, time_constants_s) = (Law::He, 1.5, time_constants_s.to_vec());
    Model { law, fs: FS, fd: FD, gain, time_constants_s, dead_time_s, integrating: false }
}

#[test]
fn the_models_curves_are_the_plants_but_for_noise() {
    let (record, stem) = record(Class::First, [libm::log(9.0), 3.0, 0.0]);
    let plots = FitPlots::new(&record, &options(), &truth(&[18.0], 4.0)).unwrap();
    let run = plots.free_run();
    assert_eq!((run.valve.len(), run.pv.len(), run.residual.len()), (600, 600 - run.from, 600 - run.from));
    let rms = stats::std_dev(&run.residual);
    assert!((rms / NOISE - 1.0).abs() < 0.15, "{rms}");
    for (k, ((model, left), measured)) in run.pv.iter().zip(&run.residual).zip(&record.pv[run.from..]).enumerate() {
        assert!((model + left - measured).abs() < 1e-9, "{k}");
    }
    let off = run.valve.iter().zip(&stem).skip(run.from).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(off < 0.1 * FD, "stem off by {off}");
}

#[test]
fn the_map_is_least_near_the_truth_and_stays_on_the_triangle() {
    let (record, _) = record(Class::First, [libm::log(9.0), 3.0, 0.0]);
    let plots = FitPlots::new(&record, &options(), &truth(&[18.0], 4.0)).unwrap();
    let span = plots.span();
    for order in [1, 2] {
        let map = plots.error_map(order, 0.05).unwrap();
        assert!(
            (map.best.fs - FS).abs() <= 1.5 * map.step && (map.best.fd - FD).abs() <= 2.0 * map.step,
            "{:?}",
            map.best
        );
        assert!(map.cells.iter().all(|c| 0.0 <= c.fd && c.fd <= c.fs + 1e-9 && c.fs + c.fd <= span * (1.0 + 1e-9)));
        assert_eq!(map.cells.iter().filter(|c| c.fs == 0.0).count(), 1);
        let plain = map.cells[0].rms.unwrap();
        assert!(plain > 1.3 * map.best.rms.unwrap(), "without friction {plain}, best {:?}", map.best);
        let [fs, fd] = map.region;
        assert!(fs[0] <= map.best.fs && map.best.fs <= fs[1] && fd[0] <= map.best.fd && map.best.fd <= fd[1]);
        assert!(fs[1] - fs[0] < 0.5 * span, "{:?}", map.region);
    }
}

#[test]
fn held_out_figures_tell_the_order() {
    let (one, _) = record(Class::First, [libm::log(9.0), 3.0, 0.0]);
    let (two, _) = record(Class::Second, [libm::log(14.0), libm::log(8.0), 3.0]);
    let gain = |record: &Record, model: &Model| {
        let chart = FitPlots::new(record, &options(), model).unwrap().orders();
        assert_eq!(chart.figures.iter().map(|f| f.order).collect::<Vec<_>>(), [1, 2]);
        chart.figures[0].held_out_rms / chart.figures[1].held_out_rms
    };
    let plain = gain(&one, &truth(&[18.0], 4.0));
    let rich = gain(&two, &truth(&[28.0, 16.0], 4.0));
    assert!(plain < 1.05 && rich > 1.2, "{plain} {rich}");
}

#[test]
fn draws_repeat_with_their_seed_and_lie_around_the_truth() {
    let (record, _) = record(Class::First, [libm::log(9.0), 3.0, 0.0]);
    let plots = FitPlots::new(&record, &options(), &truth(&[18.0], 4.0)).unwrap();
    let drawn = plots.bootstrap(12, 5);
    assert_eq!(drawn, plots.bootstrap(12, 5));
    assert_ne!(drawn, plots.bootstrap(12, 6));
    assert_eq!(drawn.len(), 12);
    let fs = stats::mean(&drawn.iter().map(|o| o.fs).collect::<Vec<_>>());
    let fd = stats::mean(&drawn.iter().map(|o| o.fd).collect::<Vec<_>>());
    assert!((fs - FS).abs() < 0.1 * FS && (fd - FD).abs() < 0.15 * FS, "{fs} {fd}");
    let end = plots.restart(5).unwrap();
    assert_eq!(Some(end), plots.restart(5));
    let plain = plots.error_map(1, 0.25).unwrap().cells[0].rms.unwrap();
    assert!(end.rms < plain && 0.0 <= end.fd && end.fd <= end.fs, "{end:?}");
}

#[test]
fn what_cannot_be_fitted_has_no_portrait() {
    let (record, _) = record(Class::First, [libm::log(9.0), 3.0, 0.0]);
    let still = Record::uniform(1.0, vec![1.0; 100], vec![2.0; 100]);
    assert!(FitPlots::new(&still, &options(), &truth(&[18.0], 4.0)).is_none());
    let huge = Model { fs: 100.0, fd: 0.0, ..truth(&[18.0], 4.0) };
    assert!(FitPlots::new(&record, &options(), &huge).is_none());
    let odd = Model { fs: f64::NAN, ..truth(&[18.0], 4.0) };
    assert!(FitPlots::new(&record, &options(), &odd).is_none());
}

#[test]
fn short_records_are_drawn_or_not_but_never_a_fault() {
    let (whole, _) = record(Class::First, [libm::log(9.0), 3.0, 0.0]);
    let mut drawn = 0;
    for n in 0..100 {
        let part = Record::uniform(2.0, whole.op_path[600 - n..].to_vec(), whole.pv[600 - n..].to_vec());
        if let Some(plots) = FitPlots::new(&part, &options(), &truth(&[18.0], 4.0)) {
            let maps = [1, 2].map(|order| plots.error_map(order, 0.2));
            assert!(maps.iter().flatten().all(|map| map.best.rms.is_some_and(|rms| rms >= 0.0)), "{n}");
            assert_eq!(plots.free_run().valve.len(), n);
            assert!(plots.bootstrap(2, 1).len() <= 2 && plots.orders().figures.len() <= 2, "{n}");
            drawn += usize::from(plots.restart(3).is_some());
        }
    }
    assert!(drawn > 50, "{drawn}");
}
