//! From the search's candidates to the reported one: selects the class by held-out error, and the filter that makes the
//! residual as white as a first-order filter can.

use super::candidate::{Candidate, apart};
use super::classes::classes_of;
use super::local_search::{Nearness, along_ridge, neighbours, random_steps};
use super::rivals;
use super::stages::{Found, Search};
use crate::core::ident::choice::{ModelChoice, Options};
use crate::core::ident::class::Class;
use crate::core::ident::evaluator::View;
use crate::core::ident::random::seeded_rng;
use crate::core::ident::slip_search::evaluator::{Evaluator, Polished};
use crate::core::signal::stats;
use serde::{Deserialize, Serialize};

/// Share by which a second lag must reduce the held-out error to stay in the answer.
pub(crate) const EARNED: f64 = 0.01;
/// Share of a record that the held-out fit uses.
pub(crate) const FITTED_SHARE: f64 = 0.6;
/// Lag-1 autocorrelation of a residual from which the error is filtered, and the strongest filter.
const COLOURED: f64 = 0.2;
const MOST_RHO: f64 = 0.98;
/// Change of the filter implied by the residual from which the search for the answer is repeated.
const OTHER_FILTER: f64 = 0.1;
/// Error relative to the answer's below which another candidate replaces it.
const BETTER: f64 = 0.98;
/// Candidates refitted to the filtered error, how many of them continue, random steps for the first two and for the others.
const REFITTED: usize = 12;
const FOLLOWED: usize = 4;
const STEPS: [usize; 2] = [60, 24];
/// Stiction index from which the record shows enough friction to refit rivals and to filter the residual.
const LEAST_INDEX: f64 = 0.1;
/// Ratio of lag to record length from which the record hardly shows where PV would settle, and the largest ratio of an
/// integrator's error to the lag's at which the integrator is as good.
const NO_END: f64 = 0.25;
const AS_GOOD: f64 = 1.01;
/// s in spans of OP from which an index counts in full: noise and rounding imitate smaller bands.
pub(crate) const FULL_WEIGHT: f64 = 0.2;

/// What decided the order of the process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum OrderBy {
    /// It was requested.
    Asked,
    /// The search: a second lag promised too little to be searched with, or nothing but it could be fitted.
    Search,
    /// The errors on data that neither order was fitted to.
    HeldOut,
}

/// How the order of the process was chosen.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct OrderChoice {
    /// What decided it.
    pub by: OrderBy,
    /// Root mean squared held-out errors of the first and of the second order, PV units, where these settled it.
    pub held_out_rms: Option<[f64; 2]>,
    /// Coefficient of the residual's filter `1 - rho q^-1` behind which they are.
    pub rho: f64,
}

/// The candidate to report.
#[derive(Debug, Clone)]
pub struct Answer {
    /// Fitted to the error filtered by `1 - rho q^-1`.
    pub candidate: Candidate,
    /// Filter of that error; 0 if the residual is white without one.
    pub rho: f64,
    /// The best process by the plain error, of the same law and class, with time constants off the lattice.
    pub plain: Polished,
    /// Squared plain error of the filtered candidate's slips.
    pub plain_sse: f64,
    /// Squared plain error without friction, same class.
    pub without: f64,
    /// Candidates with other bands, fitted like `candidate`; empty if the residual is white.
    pub rivals: Vec<Candidate>,
    /// How the order was chosen; errors in standard deviations of PV.
    pub order: OrderChoice,
}

/// Share of an error that friction removes, 0..1.
#[must_use]
pub(crate) fn improvement(with: f64, without: f64) -> f64 {
    if without > 0.0 { (1.0 - with / without).clamp(0.0, 1.0) } else { 0.0 }
}

impl Answer {
    /// Share of the plain error that friction removes.
    #[must_use]
    pub(crate) fn index(&self) -> f64 {
        improvement(self.plain.sse, self.without)
    }
}

impl Search<'_, '_> {
    /// The answer for the best candidate of one law; `None` if it has no process.
    pub(crate) fn answer(&mut self, best: Candidate, found: &Found, options: &Options) -> Option<Answer> {
        let Options { model, seed, .. } = *options;
        let rich = best;
        let (best, order) = self.earned(rich, model, 0.0)?;
        let best = self.without_an_end(best, options, 0.0);
        let without = self.without(best.class);
        let (evaluator, plain) = self.whole();
        let process = evaluator.polish(plain, &best)?;
        let (plain_sse, rivals) = (process.sse, Vec::new());
        let mut answer = Answer { candidate: best, rho: 0.0, plain: process, plain_sse, without, rivals, order };
        if !found.is_noise && answer.index() > LEAST_INDEX {
            let rho = {
                let (evaluator, plain) = self.whole();
                stats::autocorrelation_1(&evaluator.residual(plain, &best, &answer.plain)).min(MOST_RHO)
            };
            if rho >= COLOURED {
                let (best, order) = self.earned(rich, model, rho)?;
                answer.order = order;
                let best = self.without_an_end(best, options, rho);
                if best.class != answer.candidate.class {
                    answer.without = self.without(best.class);
                    let (evaluator, plain) = self.whole();
                    let plain_best = evaluator.in_class(plain, &best, best.class)?;
                    answer.plain = evaluator.polish(plain, &plain_best)?;
                    answer.plain_sse = answer.plain.sse;
                }
                self.whiten(&mut answer, best, &found.seen, rho, seed);
            }
            self.weigh_rivals(&mut answer, found);
        }
        Some(answer)
    }

    /// Refits the other candidates like the answer; one with a clearly smaller error replaces it.
    fn weigh_rivals(&mut self, answer: &mut Answer, found: &Found) {
        let (evaluator, plain) = self.whole();
        let mut view =
            if answer.rho == 0.0 { plain.clone() } else { evaluator.problem.view(answer.rho, evaluator.points) };
        let class = answer.candidate.class;
        answer.rivals = rivals::refitted(evaluator, &mut view, &answer.candidate, class, &found.seen, &found.best);
        let Some(better) = answer.rivals.first().copied().filter(|c| c.sse() < BETTER * answer.candidate.sse()) else {
            return;
        };
        let again = evaluator.in_class(plain, &better, class).and_then(|c| evaluator.polish(plain, &c));
        let Some(process) = again else { return };
        answer.rivals.push(answer.candidate);
        (answer.candidate, answer.plain_sse) = (better, process.sse);
        if process.sse < answer.plain.sse || answer.rho == 0.0 {
            answer.plain = process;
        }
    }

    /// Replaces the lag by an integrator if the lag is so long that the record does not show where PV would settle, and the
    /// integrator explains the record as well: only the ratio of gain and time constant is identified then.
    fn without_an_end(&mut self, of: Candidate, options: &Options, rho: f64) -> Candidate {
        let class = match of.class {
            Class::First => Class::Integrating,
            Class::Second => Class::LagIntegrating,
            Class::Integrating | Class::LagIntegrating => return of,
        };
        let (evaluator, plain) = self.whole();
        let long = of.taus()[0] >= NO_END * evaluator.points as f64;
        if !(long && options.may_integrate && classes_of(options.model).contains(&class)) {
            return of;
        }
        let mut view = if rho == 0.0 { plain.clone() } else { evaluator.problem.view(rho, evaluator.points) };
        let Some(lag) = evaluator.in_class(&mut view, &of, of.class) else { return of };
        let Some(other) = evaluator.in_class(&mut view, &of, class) else { return of };
        let other = neighbours(evaluator, &mut view, other, 2, Nearness::USUAL);
        if other.fit.gain != 0.0 && other.sse() <= AS_GOOD * lag.sse() { other } else { of }
    }

    /// Drops the second lag unless it earns its place on held-out data, by the error filtered with `1 - rho q^-1`.
    fn earned(&mut self, rich: Candidate, model: ModelChoice, rho: f64) -> Option<(Candidate, OrderChoice)> {
        let by = |by: OrderBy| OrderChoice { by, held_out_rms: None, rho };
        let simpler = match (model, rich.class) {
            (ModelChoice::Auto, Class::Second) => Class::First,
            (ModelChoice::Auto, Class::LagIntegrating) => Class::Integrating,
            (ModelChoice::Auto, _) => return Some((rich, by(OrderBy::Search))),
            _ => return Some((rich, by(OrderBy::Asked))),
        };
        let (evaluator, plain) = self.whole();
        let mut view = if rho == 0.0 { plain.clone() } else { evaluator.problem.view(rho, evaluator.points) };
        let rich = if rho == 0.0 { rich } else { evaluator.in_class(&mut view, &rich, rich.class)? };
        let Some(poor) = evaluator.in_class(&mut view, &rich, simpler).filter(|c| c.fit.gain != 0.0) else {
            return Some((rich, by(OrderBy::Search)));
        };
        // The simpler model may have its best slips in a neighbouring cell.
        let near = Nearness::USUAL;
        let poor = neighbours(evaluator, &mut view, poor, 2, near);
        let of_rich = held_out(evaluator, rho, &rich);
        let of_poor = held_out(evaluator, rho, &poor);
        let order = OrderChoice { held_out_rms: Some([of_poor.sqrt(), of_rich.sqrt()]), ..by(OrderBy::HeldOut) };
        Some((if of_rich > (1.0 - EARNED) * of_poor { poor } else { rich }, order))
    }

    /// A disturbance of PV persists in the residual from sample to sample. Filtering the error by the residual's own
    /// first-order model (generalised least squares, Cochrane and Orcutt 1949) gives it no more weight than noise.
    fn whiten(&mut self, answer: &mut Answer, best: Candidate, rivals: &[Candidate], rho: f64, seed: u64) {
        let near = Nearness::USUAL;
        let mut rng = seeded_rng(seed, 5);
        let (evaluator, plain) = self.whole();
        let mut rho = rho;
        answer.candidate = best;
        for _ in 0..2 {
            if rho < COLOURED {
                return;
            }
            rho = rho.min(MOST_RHO);
            let mut view = evaluator.problem.view(rho, evaluator.points);
            let mut pool: Vec<Candidate> = apart(rivals, REFITTED, 0);
            pool.push(answer.candidate);
            pool.push(best);
            let refitted = pool.iter().filter_map(|c| evaluator.in_class(&mut view, c, best.class));
            let refitted: Vec<Candidate> = refitted.filter(|c| c.fit.gain != 0.0).collect();
            let mut held = apart(&refitted, FOLLOWED, 0);
            if let Some(first) = held.first().copied() {
                held.extend(along_ridge(evaluator, &mut view, &first, 0.1, 20));
                held = apart(&held, FOLLOWED, 0);
            }
            for (i, c) in held.iter_mut().enumerate() {
                *c = random_steps(evaluator, &mut view, *c, STEPS[usize::from(i > 1)], near, &mut rng);
            }
            held.sort_by(|a, b| a.sse().total_cmp(&b.sse()));
            let Some(found) = held.first() else { return };
            let found = neighbours(evaluator, &mut view, *found, 4, near);
            let again = evaluator.in_class(plain, &found, best.class);
            let process = again.and_then(|c| evaluator.polish(plain, &c).map(|p| (c, p)));
            let Some((again, process)) = process else { return };
            (answer.candidate, answer.rho, answer.plain_sse) = (found, rho, process.sse);
            if process.sse < answer.plain.sse {
                answer.plain = process;
            }
            // The right slips leave another residual, which may need another filter.
            let next = stats::autocorrelation_1(&evaluator.residual(plain, &again, &process));
            if (next - rho).abs() <= OTHER_FILTER {
                return;
            }
            rho = next;
        }
    }
}

/// Mean squared error, filtered by `1 - rho q^-1`, after the first [`FITTED_SHARE`] of the record, with the process fitted to
/// that first part alone.
pub(crate) fn held_out(evaluator: &mut Evaluator<'_>, rho: f64, of: &Candidate) -> f64 {
    let (from, points) = (evaluator.problem.normalised.from.max(1), evaluator.points);
    let fitted = (FITTED_SHARE * (points - from) as f64) as usize;
    let mut first = evaluator.problem.view_of(rho, points, &[[from, from + fitted]]);
    let Some(found) = evaluator.in_class(&mut first, of, of.class) else { return f64::INFINITY };
    let Some(process) = evaluator.polish(&first, &found) else { return f64::INFINITY };
    let left = evaluator.residual(&first, &found, &process);
    let later: Vec<f64> = left.windows(2).skip(fitted.max(1) - 1).map(|w| w[1] - rho * w[0]).collect();
    later.iter().map(|e| e * e).sum::<f64>() / later.len().max(1) as f64
}

/// The same error relative to PV's own mean square there.
#[must_use]
pub(crate) fn held_out_share(evaluator: &mut Evaluator<'_>, rho: f64, of: &Candidate) -> f64 {
    let error = held_out(evaluator, rho, of);
    let from = evaluator.problem.normalised.from.max(1);
    let later = from + (FITTED_SHARE * (evaluator.points - from) as f64) as usize;
    let pv = evaluator.problem.pv();
    let moved: Vec<f64> = pv[later.min(pv.len())..].windows(2).map(|w| w[1] - rho * w[0]).collect();
    let deviation = stats::std_dev(&moved);
    error / (deviation * deviation)
}

/// The view to which an answer was fitted.
#[must_use]
pub(crate) fn view_of(search: &mut Search<'_, '_>, answer: &Answer) -> View {
    let (evaluator, plain) = search.whole();
    if answer.rho == 0.0 { plain.clone() } else { evaluator.problem.view(answer.rho, evaluator.points) }
}
