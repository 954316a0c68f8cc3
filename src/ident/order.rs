//! Which class of process: decided by what the data cannot do without.

use super::candidate::{Bench, Candidate, Question};
use super::choice::ModelChoice;
use super::class::{Class, Shape};
use super::fit::Target;
use super::frictionless;

/// Starts of the frictionless process that are fitted to their end.
const SETTLED: usize = 4;

/// A candidate of first order refitted in the bench's class.
pub fn in_class(bench: &mut Bench<'_>, from: &Candidate) -> Option<Candidate> {
    let mut start = *from;
    if bench.class == Class::First {
        return Some(start);
    }
    let tau = libm::exp(from.fit.shape[0]);
    start.fit.shape = bench.class.clamp(bench.class.start(tau, from.fit.shape[1]), &bench.question.limits);
    bench.settle(&start).filter(|c| c.fit.gain != 0.0)
}

/// Share of the filtered error, and of the plain one, that a second lag must remove to be kept in the search.
const PROMISE: [f64; 2] = [0.002, 0.02];
/// Share of the error on data not fitted to that it must remove to stay in the answer.
pub const EARNED: f64 = 0.01;
/// Share of a record that the held-out fit is made to.
pub const FITTED_SHARE: f64 = 0.6;

/// The class that the best candidates of first order ask for, by filtered and by plain errors.
#[must_use]
pub fn deserved(filtered: &mut Bench<'_>, plain: &mut Bench<'_>, held: &[Candidate], model: ModelChoice) -> Class {
    let best_of = |bench: &mut Bench<'_>, class: Class| {
        bench.class = class;
        let refitted = held.iter().take(2).filter_map(|c| match class {
            Class::First => bench.settle(c),
            _ => in_class(bench, c),
        });
        refitted.map(|c| c.fit.sse).fold(f64::INFINITY, f64::min)
    };
    // An integrator must do as well as a lag in both views.
    let mut family = |lag: Class, integrator: Class| {
        let [a, b] = [best_of(filtered, lag), best_of(plain, lag)];
        let [c, d] = [best_of(filtered, integrator), best_of(plain, integrator)];
        if c <= 1.005 * a && d <= 1.01 * b { ([c, d], integrator) } else { ([a, b], lag) }
    };
    let mut one = || family(Class::First, Class::Integrating);
    match model {
        ModelChoice::Fopdt => return one().1,
        ModelChoice::Sopdt => return family(Class::Second, Class::LagIntegrating).1,
        ModelChoice::Auto => {}
    }
    let (one, two) = (one(), family(Class::Second, Class::LagIntegrating));
    let promising = (0..2).any(|i| two.0[i] < (1.0 - PROMISE[i]) * one.0[i]);
    if promising { two.1 } else { one.1 }
}

/// The simpler class' shape whose lag takes the place of the second lag.
pub fn reduced(class: Class, simpler: Class, shape: &Shape) -> Shape {
    let lost = libm::exp(shape[if class == Class::Second { 1 } else { 0 }]);
    simpler.start(libm::exp(shape[0]), class.lag(shape) + lost)
}

/// Goes back to the simpler class where the second lag does not earn its place on data that it was not fitted to.
pub fn demote(bench: &mut Bench<'_>, candidate: Option<Candidate>, model: ModelChoice) -> (Option<Candidate>, Class) {
    let class = bench.class;
    let Some(rich) = candidate else { return (None, class) };
    let simpler = match (model, class) {
        (ModelChoice::Auto, Class::Second) => Class::First,
        (ModelChoice::Auto, Class::LagIntegrating) => Class::Integrating,
        _ => return (candidate, class),
    };
    let of_rich = bench.held_out(&rich, FITTED_SHARE);
    bench.class = simpler;
    let mut start = rich;
    start.fit.shape = simpler.clamp(reduced(class, simpler, &rich.fit.shape), &bench.question.limits);
    if let Some(plain) = bench.settle(&start) {
        let of_plain = bench.held_out(&plain, FITTED_SHARE);
        if plain.fit.gain != 0.0 && of_rich > (1.0 - EARNED) * of_plain {
            return (Some(plain), simpler);
        }
    }
    bench.class = class;
    (Some(rich), class)
}

/// Squared error of the best process without friction, of the same class and sign; at most that of no process at all.
pub fn frictionless(question: &Question, target: &Target, class: Class, sign: f64) -> f64 {
    frictionless::best(question, target, class, sign, SETTLED).map_or(f64::INFINITY, |f| f.sse)
}
