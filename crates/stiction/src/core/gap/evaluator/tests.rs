//! The evaluator against the plain pass, and the local search in what is continuous.

use proptest::prelude::*;

use super::*;
use crate::core::gap::candidate::MAX_PARAMS;
use crate::core::gap::effects::{self, Effect, Unit, Way};
use crate::core::gap::neighbour::Load;
use crate::core::gap::plain::tests::made_by;
use crate::core::gap::settle::{FAR, clamped};
use crate::core::ident::random::{seeded_rng, uniform};
use crate::core::sim::slips::Law;

/// Effects that are simulated.
fn simulated() -> Vec<&'static Effect> {
    effects::ALL.into_iter().filter(|e| matches!(e.way, Way::Simulated | Way::Neighbour)).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 384, ..ProptestConfig::default() })]

    #[test]
    fn the_error_of_every_structure_is_that_of_the_plain_pass(
        seed in 0_u64..1_000_000, first in 0..16_usize, second in 0..33_usize, s in 0.08..0.5_f64, share in 0.05..1.0_f64,
        tau in 0.5..60.0_f64, lag in 1.2..20.0_f64, fd in 0.0..0.5_f64, filtered: bool, frictionless: bool,
    ) {
        let all = simulated();
        let one = all[first % all.len()];
        let pair = all.get(second).copied().filter(|e| e.id != one.id && !one.clashes.contains(&e.id));
        let law = if frictionless && second % 3 == 0 { None } else { Some(Law::He) };
        let structure = Structure { law, effects: [Some(one), pair] };
        prop_assume!(structure.each().map(|e| e.params.len()).sum::<usize>() <= MAX_PARAMS);
        let (mut problem, truth) = made_by(&Structure::base(Some(Law::He)), [0.0; MAX_PARAMS]);
        let signal: Vec<f64> = (0..problem.n()).map(|k| libm::sin(0.07 * k as f64) + libm::cos(0.11 * k as f64)).collect();
        problem.neighbour = Some(Arc::new(Load::new("N", false, &signal, 0.01)));
        let mut rng = seeded_rng(seed, 3);
        let mut p = [0.0; MAX_PARAMS];
        for (value, param) in p.iter_mut().zip(structure.params()) {
            let [low, high] = param.bounds(&problem);
            *value = low + (high - low) * uniform(&mut rng);
            if param.unit == Unit::Choice {
                *value = value.round();
            }
        }
        let theta = Parameters { s, j: share * s, fd: fd * s, log_tau: libm::log(tau), lag, p, ..truth };
        let theta = clamped(&structure, theta, &problem);
        let view = if filtered { View::Moves } else { View::Plain };
        let mut evaluator = Evaluator::new(&problem, 1.0);
        let Some(prepared) = evaluator.prepare(&structure, &theta) else { return Ok(()) };
        prop_assume!(!prepared.is_plain());
        // Of a valve that rests wherever points count they see no more than tails: nothing but rounding would be compared.
        let place = evaluator.place_of(&prepared);
        let counted = problem.view(view).counted();
        let counts = |k: usize| counted.iter().any(|[start, end]| (start + 1..*end).contains(&k));
        let moves = evaluator.signal.steps.list.iter().filter(|s| counts(s.point as usize + place.delay as usize));
        prop_assume!(moves.map(|s| s.level.abs() + s.direction.abs()).sum::<f64>() > 0.3);
        let Some(found) = evaluator.at(&structure, &prepared, place, view) else { return Ok(()) };
        // The same dead time, band and time constants, sample by sample.
        let plain = evaluator.plain_pass(&structure, &found.theta, view);
        let whole: f64 = problem.target(view).iter().map(|y| y * y).sum();
        let sse = plain.map_or(f64::INFINITY, |f| f.sse);
        prop_assert!((found.sse - sse).abs() < 1e-9 * whole, "{}: {} {sse} of {whole}", structure.id(), found.sse);
    }
}

#[test]
fn process_and_band_are_found_from_afar() {
    let structure = Structure::base(Some(Law::He));
    let (problem, truth) = made_by(&structure, [0.0; MAX_PARAMS]);
    let mut evaluator = Evaluator::new(&problem, 1.0);
    let away = Parameters { log_tau: libm::log(16.0), lag: 7.0, ..truth };
    let found = evaluator.fit(&structure, &away, View::Plain, FAR).unwrap();
    let found = evaluator.refine(&structure, found);
    assert!((found.theta.lag - truth.lag).abs() < 0.05, "{}", found.theta.lag);
    assert!((libm::exp(found.theta.log_tau) - 9.0).abs() < 0.1 && (found.theta.fd - 0.1).abs() < 0.01);
    assert!(evaluator.evaluations < 120, "{}", evaluator.evaluations);
}
