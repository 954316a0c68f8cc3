//! The solvers on the toolbox's own problem: for exact bands, the error of the best process.
#![allow(missing_docs)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use stiction::core::ident::class::Class;
use stiction::core::ident::{ModelChoice, Options, ValveChoice};
use stiction::core::optim::Settings;
use stiction::core::sim::slips::Law;
use stiction::toolbox::solvers;
use stiction::toolbox::surface::{Surface, solve};
use stiction_lab::truth::fixture::Loop;

/// Enough for this record; the command line allows more.
const BUDGET: u64 = 4000;

fn options() -> Options {
    Options { model: ModelChoice::Fopdt, valve: ValveChoice::He, ..Options::default() }
}

fn sticking() -> Loop {
    Loop {
        fs: 2.6,
        fd: 1.0,
        tracking: false,
        gain: 1.3,
        taus: vec![12.0],
        dead_time: 3.4,
        kc: 0.2,
        ti: 20.0,
        noise: 0.05,
        sp: |k| 8.0 * libm::sin(k as f64 * 0.05) + 3.0 * libm::sin(k as f64 * 0.0137),
        n: 500,
        warm_up: 0,
        seed: 3,
    }
}

#[test]
fn every_solver_finds_the_bands_of_a_sticking_valve() {
    let truth = sticking();
    let record = truth.run().record;
    for solver in solvers::ALL {
        let mut surface = Surface::new(&record, &options(), Law::He, Class::First).unwrap();
        // The grid alone needs a fine step; the other solvers refine by themselves.
        let settings = Settings { budget: BUDGET, fineness_pct: 2.0, seed: 1 };
        let found = solve(&mut surface, solver, &settings);
        assert!(
            (found.fs - truth.fs).abs() < 0.15 && (found.fd - truth.fd).abs() < 0.15,
            "{}: {found:?}",
            solver.name()
        );
        assert!(found.outcome.evaluations <= BUDGET && surface.evaluations() == found.outcome.evaluations);
        assert!(0.0 <= found.fd && found.fd <= found.fs && found.fs + found.fd <= found.s0 * (1.0 + 1e-9));
        // A right model leaves white noise of 0.05.
        assert!(found.mse > 0.0015 && found.mse < 0.006, "{}: {}", solver.name(), found.mse);
    }
}

#[test]
fn the_surface_ends_where_the_bands_contradict_each_other_or_the_span() {
    let record = sticking().run().record;
    let mut surface = Surface::new(&record, &options(), Law::He, Class::Second).unwrap();
    let s0 = surface.s0();
    for (fs, fd) in [(1.0, 1.5), (0.7 * s0, 0.4 * s0), (1.0, -0.1), (f64::NAN, 0.0)] {
        assert_eq!(surface.mse(fs, fd), f64::INFINITY, "{fs} {fd}");
    }
    let nothing = surface.mse(0.0, 0.0);
    let truth = surface.point(2.6, 1.0).unwrap();
    assert!(truth.mse < 0.1 * nothing, "{truth:?} {nothing}");
    assert!((truth.gain - 1.3).abs() < 0.05 && (truth.dead_time_s - 3.4).abs() < 1.5, "{truth:?}");
}
