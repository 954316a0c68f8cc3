//! The plain pass on a record that the base made.

use super::*;
use crate::core::gap::candidate::MAX_PARAMS;
use crate::core::gap::effects::{self, Way};
use crate::core::gap::express::parameters;
use crate::core::record::Record;
use crate::core::sim::noise::Noise;
use crate::core::sim::slips::{FirstSlip, Law};

/// A record made by the base, and the theta that made it.
fn made() -> (Problem, Parameters) {
    made_by(&Structure::base(Some(Law::He)), [0.0; MAX_PARAMS])
}

/// A record made by a structure without linear parts of its own, and the theta that made it.
pub(crate) fn made_by(structure: &Structure, p: [f64; MAX_PARAMS]) -> (Problem, Parameters) {
    let mut noise = Noise::new(1, 0);
    let op: Vec<f64> =
        (0..700).map(|k| 50.0 + 5.0 * libm::sin(f64::from(k) * 0.09) + 2.0 * libm::sin(f64::from(k) * 0.031)).collect();
    let pv: Vec<f64> = (0..700).map(|_| noise.gaussian()).collect();
    let problem = Problem::new(&Record::uniform(1.0, op.clone(), pv), None, 1, vec![false; 700]);
    let first = FirstSlip { direction: 1.0, threshold: problem.normalised.path.values()[0] + 0.05 };
    let theta = Parameters { s: 0.3, j: 0.1, first, fd: 0.1, log_tau: libm::log(9.0), lag: 4.3, p };
    let linear = Linear { others: [0.0; MAX_COLUMNS], count: 2, gain: 2.0 };
    let of = Candidate { theta, sse: 0.0, cells: [[0.0; 2]; 2], slips: 9, linear };
    let (course, _) = PlainPass::new(&problem, 1.0).simulate(structure, &of).unwrap();
    let pv = course.iter().map(|x| 3.0 * x + 0.01 * noise.gaussian()).collect();
    (Problem::new(&Record::uniform(1.0, op, pv), None, 1, vec![false; 700]), theta)
}

#[test]
fn every_effect_at_rest_is_the_base() {
    let (problem, theta) = made();
    let mut pass = PlainPass::new(&problem, 1.0);
    let base = pass.evaluate(&Structure::base(Some(Law::He)), &theta, View::Plain).unwrap();
    let n = problem.target(View::Plain).len() as f64;
    assert!((base.sse / n).sqrt() * problem.normalised.deviation < 0.02, "{}", base.sse);
    let rest = |id: &str| match id {
        "rate_limit" => [libm::log(2.0), 0.0],
        "travel_limit" => [2.0, 1.0],
        "positioner_lag" | "extra_lag" | "inverse_response" => [libm::log(1e-3), 0.0],
        "dead_time_change" => [350.0, 0.0],
        "sinusoid" => [0.5, 0.0],
        "step_load" => [300.0, 0.0],
        _ => [0.0; 2],
    };
    let switches = ["slip_overshoot", "sliding_valve", "integrating"];
    for effect in effects::ALL.into_iter().filter(|e| e.way == Way::Simulated && !switches.contains(&e.id)) {
        let [a, b] = rest(effect.id);
        let at_rest = Parameters { p: [a, b, 0.0, 0.0, 0.0, 0.0], ..theta };
        let found = pass.evaluate(&Structure::with(Some(Law::He), effect), &at_rest, View::Plain).unwrap();
        // Linear coefficients of its own can only help; fd is not solved exactly behind what follows the stem.
        let ratio = found.sse / base.sse;
        assert!(ratio < 1.0 + 1e-2 && ratio > 0.9, "{}: {ratio}", effect.id);
    }
}

#[test]
fn what_an_effect_adds_is_the_run_with_it_less_the_run_without() {
    let (problem, theta) = made();
    let mut pass = PlainPass::new(&problem, 1.0);
    let structure = |id: &str| Structure::with(Some(Law::He), effects::by_id(id).unwrap());
    // Uneven bands decide when the stem slips: the search for slips knows them, nothing is taken out.
    let uneven = Parameters { p: [0.3, 0.0, 0.0, 0.0, 0.0, 0.0], ..theta };
    let candidate = pass.evaluate(&structure("asymmetric_stiction"), &uneven, View::Plain).unwrap();
    assert!(pass.added(&structure("asymmetric_stiction"), &candidate).unwrap().iter().all(|x| *x == 0.0));
    // A load straight into PV is a step of its own size.
    let step = Parameters { p: [300.0, 1.0, 0.0, 0.0, 0.0, 0.0], ..theta };
    let mut candidate = pass.evaluate(&structure("step_load"), &step, View::Plain).unwrap();
    candidate.linear.others[2] = 0.7;
    let added = pass.added(&structure("step_load"), &candidate).unwrap();
    assert!(added[..300].iter().all(|x| x.abs() < 1e-9) && added[301..].iter().all(|x| (x - 0.7).abs() < 1e-9));
}

#[test]
fn loads_say_their_own_size_beside_any_other_part() {
    let (problem, theta) = made();
    let n = problem.n();
    let size_of = |ids: [&str; 2], p: [f64; MAX_PARAMS], load: &dyn Fn(usize) -> f64, name: &str| {
        let (normalised, deviation) = (&problem.normalised, problem.normalised.deviation);
        let op = normalised.path.values().iter().map(|u| problem.op_of(*u)).collect();
        let pv = normalised.pv.iter().enumerate().map(|(k, y)| (y + load(k)) * deviation).collect();
        let loaded = Problem::new(&Record::uniform(1.0, op, pv), None, 1, vec![false; n]);
        let structure = Structure { law: Some(Law::He), effects: ids.map(effects::by_id) };
        let found = PlainPass::new(&loaded, 1.0).evaluate(&structure, &Parameters { p, ..theta }, View::Plain).unwrap();
        let all = parameters(&loaded, &structure, &found);
        all.into_iter().find(|q| q.name == name).unwrap().value / deviation
    };
    let step = |k: usize| if k >= 300 { 0.7 } else { 0.0 };
    let at = |p: [f64; 4]| [p[0], p[1], p[2], p[3], 0.0, 0.0];
    for (partner, p) in [
        ("sinusoid", at([0.5, 300.0, 1.0, 0.0])),
        ("ramp", at([100.0, 300.0, 1.0, 0.0])),
        ("gain_drift", at([0.01, 0.0, 300.0, 1.0])),
        ("extra_lag", at([libm::log(0.5), 300.0, 1.0, 0.0])),
        ("inverse_response", at([libm::log(2.0), 300.0, 1.0, 0.0])),
    ] {
        let size = size_of([partner, "step_load"], p, &step, "size");
        assert!((size - 0.7).abs() < 0.03, "{partner}: {size}");
    }
    let ramp = |k: usize| 0.9 * k.saturating_sub(100) as f64 / n as f64;
    let slope = size_of(["ramp", "sinusoid"], at([100.0, 0.5, 0.0, 0.0]), &ramp, "slope");
    assert!((slope * n as f64 * problem.point_s - 0.9).abs() < 0.03, "{slope}");
    let wave = |k: usize| 0.4 * libm::sin(0.5 * k as f64);
    let amplitude = size_of(["extra_lag", "sinusoid"], at([libm::log(0.5), 0.5, 0.0, 0.0]), &wave, "amplitude");
    assert!((amplitude - 0.4).abs() < 0.03, "{amplitude}");
}
