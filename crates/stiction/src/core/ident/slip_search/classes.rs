//! Selects the class of process that the slips need: how many lags, and whether it integrates.

use super::candidate::{Candidate, apart};
use super::evaluator::Evaluator;
use super::local_search::{Nearness, along_ridge, random_steps};
use super::part::{FOLLOWERS, LawRound};
use super::problem::Problem;
use crate::core::ident::choice::ModelChoice;
use crate::core::ident::class::Class;
use crate::core::ident::evaluator::View;

/// Share of the error that a second lag must remove to be used in the search.
const SECOND_LAG: f64 = 0.03;
/// The same for another class with no more lags.
const ANOTHER: f64 = 0.03;
/// Relative errors up to which an integrator replaces a lag, by the filtered and by the plain error.
const INTEGRATOR: [f64; 2] = [1.005, 1.01];
/// Shares of the filtered and of the plain error that a second lag must remove for the search to continue with it.
const PROMISE: [f64; 2] = [0.002, 0.02];
/// Candidates by which the class is judged.
const JUDGES: usize = 2;
/// How far along the ridge (share of s), and in how many steps per side, the search looks after a change of class.
pub(super) const FAR_ALONG: (f64, usize) = (0.3, 40);

pub(super) const fn index_of(class: Class) -> usize {
    match class {
        Class::First => 0,
        Class::Second => 1,
        Class::Integrating => 2,
        Class::LagIntegrating => 3,
    }
}

/// Classes that a choice of model allows, the simplest first.
#[must_use]
pub(crate) const fn classes_of(model: ModelChoice) -> &'static [Class] {
    match model {
        ModelChoice::Fopdt => &[Class::First, Class::Integrating],
        ModelChoice::Sopdt => &[Class::Second, Class::LagIntegrating],
        ModelChoice::Auto => &[Class::First, Class::Integrating, Class::Second, Class::LagIntegrating],
    }
}

/// The class itself if the model allows it, else its replacement.
pub(super) const fn allowed(model: ModelChoice, class: Class) -> Class {
    match (model, class) {
        (ModelChoice::Sopdt, Class::First) => Class::Second,
        (ModelChoice::Sopdt, Class::Integrating) => Class::LagIntegrating,
        (ModelChoice::Fopdt, Class::Second) => Class::First,
        (ModelChoice::Fopdt, Class::LagIntegrating) => Class::Integrating,
        _ => class,
    }
}

/// The candidate in the class that suits its slips best on the whole record; its own class unless another is clearly better.
pub(super) fn suited(model: ModelChoice, whole: &mut Evaluator<'_>, plain: &mut View, own: Candidate) -> Candidate {
    let mut best = own;
    for &class in classes_of(model) {
        if class == own.class {
            continue;
        }
        let Some(other) = whole.in_class(plain, &own, class) else { continue };
        let must = if class.order() > own.class.order() { 1.0 - SECOND_LAG } else { 1.0 - ANOTHER };
        if other.fit.gain != 0.0 && other.sse() < must * best.sse() {
            best = other;
        }
    }
    best
}

/// Chooses the class by the filtered and the plain errors of the best candidates of the part, and converts the held candidates.
pub(super) fn choose_class<'a>(
    problem: &'a Problem<'a>,
    model: ModelChoice,
    run: &mut LawRound<'a>,
    steps: usize,
    near: Nearness,
) {
    let LawRound { part, rng, .. } = run;
    let judges: Vec<Candidate> = part.held.iter().take(JUDGES).copied().collect();
    let mut scores = [[f64::INFINITY; 2]; 4];
    for class in classes_of(ModelChoice::Auto) {
        let score = &mut scores[index_of(*class)];
        for c in &judges {
            let Some(found) = part.evaluator.in_class(&mut part.view, c, *class) else { continue };
            score[0] = score[0].min(found.sse());
            let head = part.head.get_or_insert_with(|| problem.view(0.0, part.points));
            if let Some(plain) = part.evaluator.settle(head, &found) {
                score[1] = score[1].min(plain.sse());
            }
        }
    }
    let family = |lag: Class, integrator: Class| {
        let [a, b] = [scores[index_of(lag)], scores[index_of(integrator)]];
        if b[0] <= INTEGRATOR[0] * a[0] && b[1] <= INTEGRATOR[1] * a[1] { integrator } else { lag }
    };
    let (one, two) = (family(Class::First, Class::Integrating), family(Class::Second, Class::LagIntegrating));
    let promising = (0..2).any(|i| scores[index_of(two)][i] < (1.0 - PROMISE[i]) * scores[index_of(one)][i]);
    let class = allowed(model, if promising { two } else { one });
    if class != Class::First {
        let mut next: Vec<Candidate> = part
            .held
            .iter()
            .take(FOLLOWERS)
            .filter_map(|c| part.evaluator.in_class(&mut part.view, c, class))
            .filter(|c| c.fit.gain != 0.0)
            .collect();
        next.sort_by(|a, b| a.sse().total_cmp(&b.sse()));
        for c in next.iter_mut().take(JUDGES) {
            // A wrong s imitated the second lag: the right one is along the ridge.
            let (reach, places) = FAR_ALONG;
            let found = along_ridge(&mut part.evaluator, &mut part.view, c, reach, places);
            *c = found.first().copied().unwrap_or(*c);
            *c = random_steps(&mut part.evaluator, &mut part.view, *c, steps, near, rng);
        }
        part.held = apart(&next, usize::MAX, 0);
    }
}
