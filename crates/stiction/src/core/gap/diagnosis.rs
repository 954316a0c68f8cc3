//! From a record to the diagnosis: traces, base, effects, noise models, decision, and its consequences.

use std::{iter, mem};

use super::decide::Decision;
use super::effects::{self, Way};
use super::evidence::{Basis, Left};
use super::express::{above_floor, fit};
use super::filter::{self, Filtered};
use super::forward::{fitted_to_first_part, refitted};
use super::given;
use super::judged::{Diagnosis, Findings, Runs};
use super::loop_run;
use super::neighbours::{self, Offered};
use super::next_test::next_test;
use super::noise;
use super::pairs;
use super::problem::{Problem, period_of};
use super::schedule::{self, Found, Work, residual_of};
use super::search::Search;
use super::signatures;
use super::stages;
use super::traces::Traces;
use super::types::{
    Base, EffectNote, Ended, Executor, Fit, Floor, Forward, FromSp, GapError, GapOptions, SearchNote, Stages,
};
use super::weigh::{Scales, sort_by_lead};
use crate::core::ident::controller;
use crate::core::record::Record;
use crate::core::signal::stats;
use crate::core::sim::slips::Law;

/// Fewest points that are diagnosed.
pub const MIN_POINTS: usize = 120;
/// Lags of the controller that are asked, points; beyond [`USUAL_LAGS`] the recording is skewed.
const LAGS: [isize; 2] = [-14, 14];
const USUAL_LAGS: [f64; 2] = [-0.5, 1.5];

/// Checks what was asked against the record and the catalogue.
pub(super) fn check(record: &Record, options: &GapOptions) -> Result<(), GapError> {
    let points = record.len();
    if points < MIN_POINTS {
        return Err(GapError::TooShort { points, needed: MIN_POINTS });
    }
    for (signal, spread) in [("OP", stats::span(&record.op_path)), ("PV", stats::std_dev(&record.pv))] {
        if !spread.is_normal() {
            return Err(GapError::Still { signal, spread, points });
        }
    }
    for neighbour in &options.neighbours {
        neighbour.check(points)?;
    }
    for id in &options.without {
        if effects::by_id(id).is_none() {
            let known: Vec<&str> = effects::ALL.iter().map(|e| e.id).collect();
            return Err(GapError::UnknownEffect { id: id.clone(), known: known.join(", ") });
        }
    }
    Ok(())
}

/// A record's traces, what is fitted, the floor, and what the search found.
struct Searched {
    traces: Traces,
    problem: Problem,
    floor: Floor,
    found: Found,
}

impl Searched {
    /// Whether a base that was fitted to few stored values leaves more of PV than its mean would.
    fn tells_nothing(&self) -> bool {
        let base = || fit(&self.problem, &self.found.base, None, &|_| {});
        !self.traces.noise_shows && base().is_none_or(|base| base.rmse > self.problem.normalised.deviation)
    }

    /// The search of an effect or pair.
    fn search_of(&self, id: &str) -> Option<&Search> {
        self.found.searches.iter().find(|search| search.structure.id_in(&self.problem) == id)
    }

    fn scales<'a>(&'a self, base: &'a Fit, seed: u64) -> Scales<'a> {
        let Self { traces, problem, floor, found } = self;
        Scales { problem, floor, base, search: &found.base, traces, seed }
    }
}

/// Looks for the base and every effect; `None` where no base can be fitted to what was measured.
fn search(
    record: &Record,
    options: &GapOptions,
    period: f64,
    traces: Traces,
    work: &mut Work<'_>,
) -> Result<Option<Searched>, GapError> {
    let mut problem =
        Problem::new(record, Some(period), options.seed, traces.masked.clone()).fitted_where(&traces.measured);
    if let Base::Given(model) = &options.base {
        problem.stated = given::base_places(&problem, model)?;
    }
    let straight = traces.signatures.iter().any(|s| s.id == effects::swinging_door::EFFECT.id && s.met);
    let floor = noise::floor(&record.pv, &traces.measured, straight);
    let law = if options.base == Base::Linear { None } else { Some(Law::He) };
    let found = schedule::run(&problem, law, &options.without, floor.noise_floor, work);
    Ok(found.map(|found| Searched { traces, problem, floor, found }))
}

/// Searches on the points that were measured; on all points where a recorder stored too few of them to tell anything.
fn search_where_measured(
    record: &Record,
    options: &GapOptions,
    work: &mut Work<'_>,
) -> Result<Option<Searched>, GapError> {
    let period = options.period_points.unwrap_or_else(|| period_of(record).0);
    let traces = signatures::traces(record, period, &options.without);
    let retry = traces.thinned.then(|| traces.all_measured());
    let searched = search(record, options, period, traces, work)?;
    let Some(all) = retry.filter(|_| searched.as_ref().is_none_or(Searched::tells_nothing)) else {
        return Ok(searched);
    };
    // What the discarded search spent says nothing of this one.
    work.begin(options.budget_evaluations);
    work.spent = false;
    search(record, options, period, all, work)
}

/// What was found beside the searches of the catalogue.
struct Looked {
    /// The comparison with other loops, where some were offered.
    offered: Option<Offered>,
    /// Neighbours behind the best one, each with the problem that has its signal.
    rivals: Vec<(Problem, Search)>,
    /// PV before a sensor's filter.
    filtered: Option<Filtered>,
}

/// Compares other loops, checks the floor, and undoes a filter.
fn look_further(
    record: &Record,
    options: &GapOptions,
    searched: &mut Searched,
    base_fit: Option<&Fit>,
    work: &mut Work<'_>,
) -> Looked {
    work.begin(options.budget_evaluations);
    let others = if options.asks(effects::neighbour::EFFECT.id) { &options.neighbours[..] } else { &[] };
    let mut offered = neighbours::look(record, &searched.problem, &searched.found, base_fit, others, work);
    let mut fits = offered.as_mut().map(|o| mem::take(&mut o.fits)).unwrap_or_default().into_iter();
    // The best one counts as an effect like any other; the others are weighed alone.
    if let Some((with, search)) = fits.next() {
        searched.problem.neighbour = with.neighbour;
        searched.found.searches.push(search);
    }
    let rivals = fits.collect();
    let Searched { traces, problem, floor, found } = searched;
    check_floor(problem, found, traces, floor);
    work.begin(options.budget_evaluations);
    let is_asked = options.asks(effects::sensor_filter::EFFECT.id);
    let filtered = is_asked.then(|| filter::look(record, problem, found, traces, floor.noise_floor, work)).flatten();
    if let Some(filtered) = &filtered {
        (floor.noise_sd, floor.noise_floor) = (Some(filtered.noise_sd), Some(filtered.noise_sd));
    }
    Looked { offered, rivals, filtered }
}

/// Diagnoses a record.
///
/// # Errors
/// The record is too short, a signal is constant, an id is unknown, or a given model cannot be simulated.
///
/// # Panics
/// The executor leaves out a job, or a job panics.
pub fn diagnose(record: &Record, options: &GapOptions, executor: &dyn Executor) -> Result<Diagnosis, GapError> {
    check(record, options)?;
    if let Base::Given(model) = &options.base {
        given::check(model)?;
    }
    let budget = options.budget_evaluations;
    let mut work = Work { executor, budget, done: 0, stopped: false, spent: false, seed: options.seed, asked: None };
    let searched = search_where_measured(record, options, &mut work)?;
    let no_base = GapError::NoBase { points: record.len(), evaluations: work.done };
    let Some(mut searched) = searched else { return Err(no_base) };
    let base_to_all = fit_to_all(&searched.problem, &searched.found.base, &mut work);
    let looked = look_further(record, options, &mut searched, base_to_all.as_ref(), &mut work);
    let base = fit(&searched.problem, &searched.found.base, searched.floor.noise_floor, &|_| {}).ok_or(no_base)?;
    let findings = weigh_all(record, options, &searched, looked, base, &mut work)?;
    let findings = with_pairs(options, &mut searched, findings, &mut work);
    let decision = findings.decide();
    let (forward, from_sp) = run_forward(record, &searched, &findings, &decision, &mut work);
    let cause_to_all = fit_cause(&searched, &decision, base_to_all.as_ref(), &mut work);
    let runs = Runs {
        forward,
        from_sp,
        next_test: next_test(&searched.problem, &searched.found, &findings, &decision),
        fits_to_all: base_to_all.into_iter().chain(cause_to_all).collect(),
    };
    let ended = if work.stopped { Ended::Stopped } else { searched.found.ended };
    let search = SearchNote { evaluations: work.done, budget, ended };
    Ok(Diagnosis::new(findings, decision, runs, (search, work.stopped || work.spent)))
}

/// Weighs everything that was found against the base.
fn weigh_all(
    record: &Record,
    options: &GapOptions,
    searched: &Searched,
    looked: Looked,
    base: Fit,
    work: &mut Work<'_>,
) -> Result<Findings, GapError> {
    let Searched { traces, problem, floor, found } = searched;
    let given = match &options.base {
        Base::Given(model) => Some(given::simulate(problem, model, floor.noise_floor)?),
        _ => None,
    };
    work.begin(options.budget_evaluations);
    let against = (base.rmse_train, floor.noise_floor);
    let stages = stages::look(record, problem, traces, against, work);
    let scales = searched.scales(&base, options.seed);
    let Looked { offered, rivals, filtered } = looked;
    let mut effects = weigh(&scales, found, filtered.as_ref(), options);
    effects.extend(rivals.iter().filter_map(|(with, search)| Scales { problem: with, ..scales }.weigh(search)));
    sort_by_lead(&mut effects);
    let (compared, loads) = offered.map(|o| (o.compared, o.loads)).unzip();
    let acts = compared.as_ref().and_then(|c| c.acts.as_deref());
    let basis = basis(record, searched, &base, stages.as_ref(), acts, options);
    Ok(Findings {
        relative_gap: base.gap / problem.normalised.deviation,
        base,
        given,
        effects,
        pairs: Vec::new(),
        floor: *floor,
        blocks: problem.blocks.clone(),
        signatures: traces.signatures.clone(),
        stages,
        basis,
        neighbours: compared,
        loads: loads.unwrap_or_default(),
    })
}

/// With two effects at once, where one leaves more than noise, or where that is asked for.
fn with_pairs(options: &GapOptions, searched: &mut Searched, findings: Findings, work: &mut Work<'_>) -> Findings {
    if !options.pairs && !findings.leaves_more(&findings.decide()) {
        return findings;
    }
    work.begin(options.budget_evaluations);
    let (pairs, searches) =
        pairs::run(&searched.problem, &searched.found, &searched.scales(&findings.base, options.seed), work);
    searched.found.searches.extend(searches);
    Findings { pairs, ..findings }
}

/// The base with the cause on all of the record; `None` where the base has none.
fn fit_cause(searched: &Searched, decision: &Decision, base_to_all: Option<&Fit>, work: &mut Work<'_>) -> Option<Fit> {
    base_to_all?;
    fit_to_all(&searched.problem, searched.search_of(&decision.cause.id)?, work)
}

/// The best of a search, fitted to all of the record; `None` where that was stopped, or no place is found.
fn fit_to_all(problem: &Problem, search: &Search, work: &mut Work<'_>) -> Option<Fit> {
    // What is done after the stop would not be done again by one who stops at the same count.
    if work.stopped {
        return None;
    }
    let nothing = vec![false; problem.n()];
    refitted(problem, &nothing, &[search], None, work)?.pop()
}

/// Where a recorder thinned PV, the floor is what the best residual shows at the values that were stored.
fn check_floor(problem: &Problem, found: &Found, traces: &Traces, floor: &mut Floor) {
    let best = found.searches.iter().chain([&found.base]).min_by(|a, b| a.sse().total_cmp(&b.sse()));
    let left = best.filter(|_| traces.thinned).and_then(|search| residual_of(problem, search));
    if let Some(left) = left {
        let sd =
            noise::of_measured(&left, &traces.measured, problem.blocks.from).map(|s| s * problem.normalised.deviation);
        let sd = sd.filter(|_| traces.noise_shows);
        floor.noise_sd = sd;
        floor.noise_floor = sd.filter(|s| *s > 0.0);
    }
}

/// Every effect of the catalogue, weighed.
fn weigh(scales: &Scales<'_>, found: &Found, filtered: Option<&Filtered>, options: &GapOptions) -> Vec<EffectNote> {
    let (problem, floor) = (scales.problem, scales.floor);
    let mut out: Vec<EffectNote> = found.searches.iter().filter_map(|search| scales.weigh(search)).collect();
    let left = residual_of(problem, &found.base);
    let one_step =
        left.and_then(|r| noise::memory(&r, &problem.train)).map(|(mse, ..)| mse.sqrt() * problem.normalised.deviation);
    for effect in effects::ALL.into_iter().filter(|e| options.asks(e.id)) {
        let floor_after = match effect.way {
            Way::Noise => one_step,
            _ if effect.id == effects::quantisation::EFFECT.id => floor.noise_floor,
            _ => None,
        };
        match (effect.way, filtered) {
            (Way::Simulated | Way::AgainstLinear | Way::Neighbour, _) => {}
            (Way::Filter, Some(filtered)) => out.push(scales.filtered(effect, filtered)),
            _ => out.push(scales.recorded(effect, floor_after)),
        }
    }
    out
}

/// What the decision is made from beside the fits.
fn basis(
    record: &Record,
    searched: &Searched,
    base: &Fit,
    seen: Option<&Stages>,
    acts: Option<&str>,
    options: &GapOptions,
) -> Basis {
    let Searched { traces, problem, floor, .. } = searched;
    let mut strongest: Vec<_> = traces.signatures.iter().filter(|s| s.met).collect();
    strongest.sort_by(|a, b| (b.value / b.threshold).total_cmp(&(a.value / a.threshold)));
    let reading = controller::read_within(record, LAGS);
    let skew = reading.map(|r| r.lag_samples / problem.box_samples).filter(|l| {
        let [low, high] = USUAL_LAGS;
        *l < low || *l > high
    });
    Basis {
        traces: strongest.iter().filter(|s| options.asks(&s.id)).map(|s| s.id.clone()).collect(),
        acts: acts.map(effects::neighbour::id_of),
        skew: skew.filter(|_| options.asks(effects::time_skew::EFFECT.id)),
        coloured_noise: options.asks(effects::coloured_noise::EFFECT.id),
        by_mv: seen.map(|s| s.stage).filter(|_| !base.at_floor),
        base_at_floor: base.at_floor,
        base: Left::of(base, floor.noise_floor),
    }
}

/// Base and cause fitted to the first part alone: the run over the rest from OP, and from SP.
fn run_forward(
    record: &Record,
    searched: &Searched,
    findings: &Findings,
    decision: &Decision,
    work: &mut Work<'_>,
) -> (Option<Forward>, Option<FromSp>) {
    let cause = searched.search_of(&decision.cause.id);
    if work.stopped || cause.is_none() && !loop_run::sp_moves(record) {
        return (None, None);
    }
    let floor = findings.floor.noise_floor;
    let searches: Vec<_> = iter::once(&searched.found.base).chain(cause).collect();
    let Some(first) = fitted_to_first_part(&searched.problem, &searches, floor, work) else { return (None, None) };
    let forward = match first.fits.as_slice() {
        [base, cause] => Some(Forward::new([base, cause].map(|fit| above_floor(fit.rmse, floor)))),
        _ => None,
    };
    (forward, loop_run::from_sp(record, &first))
}
