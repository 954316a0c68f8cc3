//! Compares the sums with the plain pass over samples.

use proptest::prelude::*;

use super::*;
use crate::core::ident::class::{Class, Limits, Shape};
use crate::core::ident::kinetic_band::{Freedom, best_band};
use crate::core::ident::least_squares::Gram;
use crate::core::sim::slips::by_sample::Sequence;
use crate::core::sim::slips::{FirstSlip, Law, Stroke};
use crate::core::sim::steps::{Path, Steps};

const LIMITS: Limits = Limits { tau: [0.3, 5000.0], lag: [0.0, 60.0] };

fn noise(seed: u64, n: usize) -> Vec<f64> {
    let mut state = seed.wrapping_mul(2).wrapping_add(1);
    (0..n)
        .map(|_| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64 / f64::from(1 << 24) - 0.5
        })
        .collect()
}

fn path(seed: u64, n: usize) -> Vec<f64> {
    let mut slow = 0.0;
    let shaken = noise(seed, n);
    (0..n)
        .map(|k| {
            slow += 0.08 * shaken[k];
            slow + 0.5 * libm::sin(k as f64 * 0.06)
        })
        .collect()
}

const CLASSES: [Class; 4] = [Class::First, Class::Second, Class::Integrating, Class::LagIntegrating];
const RHOS: [f64; 4] = [0.0, 0.8, 0.9, 0.98];

/// Gain, kinetic band and squared error of the best fit by columns of samples; and the squares of the filtered PV.
fn by_columns(
    class: Class,
    shape: &Shape,
    signal: [&[f64]; 2],
    pv: &[f64],
    rho: f64,
    from: usize,
    freedom: &Freedom,
) -> ([f64; 3], f64) {
    let [at, direction] = signal.map(|half| class.respond(shape, half));
    let filtered = |x: &[f64]| -> Vec<f64> { x[from - 1..].windows(2).map(|w| w[1] - rho * w[0]).collect() };
    let n = pv.len() - from;
    let mut columns = vec![vec![1.0 - rho; n]];
    for index in 1..class.memory_len() {
        let mut column = Vec::new();
        class.memory(shape, index, from, n, rho, &mut column);
        column.resize(n, 0.0);
        columns.push(column);
    }
    let own = columns.len();
    columns.extend([&at, &direction, pv].map(filtered));
    let views: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
    let mut gram = Gram::of(&views);
    let whole = [gram.at(own, own), gram.at(own + 1, own + 1)];
    let squares = gram.at(own + 2, own + 2);
    gram.eliminate(own);
    let entry = |i: usize, k: usize| gram.at(own + i, own + k);
    let system = [entry(0, 0), entry(0, 1), entry(1, 1), entry(0, 2), entry(1, 2)];
    let (gain, fd, explained) = best_band(system, whole, freedom);
    ([gain, fd, entry(2, 2) - explained], squares)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, ..ProptestConfig::default() })]

    #[test]
    fn the_error_is_that_of_the_plain_pass(
        seed in 0_u64..1_000_000, class in 0..4_usize, rho in 0..4_usize, tracking: bool, m in 1..4_usize,
        s in 0.05..0.6_f64, share in 0.0..1.0_f64, tau in 0.0..1.0_f64, apart in 0.05..2.0_f64, lag in 1.0..40.0_f64,
        uneven in -0.5..0.5_f64, has_uneven: bool,
    ) {
        let (class, rho, law) = (CLASSES[class], RHOS[rho], if tracking { Law::Tracking } else { Law::He });
        let (n, from) = (600, 45);
        let op = path(seed, n * m);
        let first = FirstSlip { direction: 1.0, threshold: op[0] + 0.02 };
        let stroke = Stroke { uneven: if has_uneven { uneven } else { 0.0 }, ..Stroke::FREE };
        let sequence = Sequence::of(stroke, law, &op, m, [s, share * s], first);
        prop_assume!(sequence.slips >= 3);
        let pv: Vec<f64> = noise(seed + 1, n).iter().zip(&sequence.at).map(|(e, v)| e + 0.7 * v).collect();
        let tau = 0.4 * libm::exp(6.0 * tau);
        let taus = [tau * libm::exp(apart), tau];
        let freedom = Freedom { fd: [-0.05, 0.3], fd_default: 0.1, sign: 1.0, limits: LIMITS };
        let signal = [&sequence.at[..], &sequence.direction[..]];
        let (plain, squares) = by_columns(class, &class.shape(taus, lag), signal, &pv, rho, from, &freedom);
        let mut steps = Steps::default();
        steps.run(&Path::new(op, m), n, stroke, law, [s, share * s], first);
        let view = View::new(&pv, rho, from);
        let tables = taus.map(|tau| view.table(tau));
        let reduced = reduce(class, &view, [&tables[0], &tables[1]], &steps.list, lag as usize, &mut HeldSums::default());
        let (gain, fd, explained) = reduced.at(lag.fract(), &freedom);
        let whole = view.nothing().max(squares);
        // A lag beyond the record is nearly a ramp, so the plain pass's own columns are nearly dependent.
        let digits = if class == Class::LagIntegrating { 3e-8 } else { 1e-9 };
        prop_assert!((reduced.rest - explained - plain[2]).abs() < digits * whole, "{class:?} {rho}: {} {}", reduced.rest - explained, plain[2]);
        prop_assert!(plain[0] == 0.0 || (gain / plain[0] - 1.0).abs() < 1e-5 && (fd - plain[1]).abs() < 1e-5, "{gain} {fd} {plain:?}");
    }

    #[test]
    fn points_that_do_not_count_and_loads_are_as_columns_of_samples_have_them(
        seed in 0_u64..1_000_000, class in 0..4_usize, rho in 0..4_usize, s in 0.05..0.6_f64, tau in 0.5..80.0_f64,
        lag in 1.0..30.0_f64, omega in 0.01..0.3_f64, block in 20..90_usize,
    ) {
        let (class, rho) = (CLASSES[class], RHOS[rho]);
        let (n, from) = (500, 35);
        let op = path(seed, n);
        let first = FirstSlip { direction: -1.0, threshold: op[0] - 0.03 };
        let sequence = Sequence::of(Stroke::FREE, Law::He, &op, 1, [s, 0.4 * s], first);
        prop_assume!(sequence.slips >= 3);
        let wave: Vec<f64> = (0..n).map(|k| libm::sin(omega * k as f64)).collect();
        let pv: Vec<f64> = noise(seed + 2, n).iter().zip(&sequence.at).zip(&wave).map(|((e, v), w)| e + v + w).collect();
        let counted: Vec<[usize; 2]> = (0..n).step_by(block).step_by(2).map(|a| [a, (a + block).min(n)]).collect();
        let taus = [2.5 * tau, tau];
        let fd = 0.15 * s;
        let freedom = Freedom { fd: [fd; 2], fd_default: fd, sign: 1.0, limits: LIMITS };
        let mut steps = Steps::default();
        steps.run(&Path::new(op, 1), n, Stroke::FREE, Law::He, [s, 0.4 * s], first);
        let view = View::of_stretches(&pv, &[&wave], rho, from, &counted);
        let tables = taus.map(|tau| view.table(tau));
        let reduced = reduce(class, &view, [&tables[0], &tables[1]], &steps.list, lag as usize, &mut HeldSums::default());
        let (_, _, explained) = reduced.at(lag.fract(), &freedom);
        // The same by columns on the points that count.
        let valve: Vec<f64> = sequence.at.iter().zip(&sequence.direction).map(|(a, d)| a - fd * d).collect();
        let shape = class.shape(taus, lag);
        let x = class.respond(&shape, &valve);
        let points: Vec<usize> = view.counted().iter().flat_map(|[a, b]| *a..*b).collect();
        let filtered = |x: &[f64]| -> Vec<f64> { points.iter().map(|k| x[*k] - rho * x[k - 1]).collect() };
        let mut columns = vec![vec![1.0; points.len()]];
        let late = |k: &usize| (*k - from) as f64;
        if class.integrates() {
            columns.push(points.iter().map(|k| late(k) * 1e-3).collect());
        }
        for tau in shape[..class.shape_len() - 1].iter().map(|t| libm::exp(*t)) {
            columns.push(points.iter().map(|k| libm::exp(-late(k) / tau)).collect());
        }
        columns.extend([filtered(&wave), filtered(&x), filtered(&pv)]);
        let views: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
        let mut gram = Gram::of(&views);
        let last = columns.len() - 1;
        gram.eliminate(last);
        let whole: f64 = columns[last].iter().map(|y| y * y).sum();
        let sse = gram.at(last, last);
        // `reduce` rejects a gain of the wrong sign, plain least squares accepts it.
        let taken = gram.back(last, &[])[last - 1] > 0.0;
        prop_assert!(!taken || (reduced.rest - explained - sse).abs() < 1e-8 * whole, "{class:?} {}, {sse}", reduced.rest - explained);
    }
}

#[test]
fn the_best_dead_time_within_a_sample_is_found() {
    let (n, from) = (800, 30);
    let op = path(5, n);
    let first = FirstSlip { direction: 1.0, threshold: op[0] + 0.02 };
    let sequence = Sequence::of(Stroke::FREE, Law::He, &op, 1, [0.3, 0.1], first);
    let freedom = Freedom { fd: [0.0, 0.3], fd_default: 0.1, sign: 1.0, limits: LIMITS };
    let mut steps = Steps::default();
    steps.run(&Path::new(op, 1), n, Stroke::FREE, Law::He, [0.3, 0.1], first);
    let valve: Vec<f64> = sequence.at.iter().zip(&sequence.direction).map(|(a, d)| a - 0.1 * d).collect();
    for (class, lag) in CLASSES.into_iter().zip([4.37, 7.81, 3.04, 9.5]) {
        let taus = [12.0, 5.0];
        let x = class.respond(&class.shape(taus, lag), &valve);
        let view = View::new(&x, 0.0, from);
        let tables = taus.map(|tau| view.table(tau));
        let reduced =
            reduce(class, &view, [&tables[0], &tables[1]], &steps.list, lag as usize, &mut HeldSums::default());
        let best = reduced.best(&freedom, [0.0, 1.0]);
        assert!((best.fraction - lag.fract()).abs() < 2e-3 && best.sse < 1e-5 * view.nothing(), "{class:?}: {best:?}");
        assert_eq!(lattice_index(lattice_tau(17)), 17);
        assert_eq!(view.on_lattice(17).tau, lattice_tau(17));
    }
}
