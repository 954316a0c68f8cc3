//! From a record to the diagnosis: traces, base, effects, noise models, decision, and its consequences.

use std::collections::BTreeMap;
use std::iter;

use super::break_away::{self, Replay};
use super::decide;
use super::effects::{self, Way};
use super::evidence::{Basis, Evidence, Left};
use super::express::{above_floor, fit};
use super::filter::{self, Filtered};
use super::forward::{fitted_to_first_part, refitted};
use super::given;
use super::judged::Diagnosis;
use super::loop_run;
use super::neighbours;
use super::next_test::next_test;
use super::noise;
use super::pairs;
use super::probability::Calibration;
use super::problem::{Problem, period_of};
use super::schedule::{self, Found, Work, residual_at, residual_of};
use super::search::Search;
use super::signatures;
use super::stages;
use super::traces::Traces;
use super::types::{
    Base, EffectResult, Ended, Executor, Fit, Floor, Forward, GapError, GapOptions, Predictions, UNKNOWN,
};
use super::weigh::Scales;
use crate::ident::controller;
use crate::record::Record;
use crate::signal::stats;
use crate::sim::slips::Law;

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

/// A record's traces, what is fitted, the floor as PV shows it, and what the search found.
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
        !self.traces.noise_shows && base().is_none_or(|base| base.rmse > self.problem.deviation)
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

/// Diagnoses a record.
///
/// # Errors
/// The record is too short, a signal is constant, an id is unknown, or a given model cannot be simulated.
pub fn diagnose(record: &Record, options: &GapOptions, executor: &dyn Executor) -> Result<Diagnosis, GapError> {
    check(record, options)?;
    if let Base::Given(model) = &options.base {
        given::check(model)?;
    }
    let period = options.period_points.unwrap_or_else(|| period_of(record).0);
    let budget = options.budget_evaluations;
    let mut work = Work { executor, budget, done: 0, stopped: false, spent: false, seed: options.seed, asked: None };
    let traces = signatures::traces(record, period, &options.without);
    let retry = traces.thinned.then(|| traces.all_measured());
    let mut searched = search(record, options, period, traces, &mut work)?;
    if let Some(all) = retry.filter(|_| searched.as_ref().is_none_or(Searched::tells_nothing)) {
        // What the discarded search spent says nothing of this one.
        work.begin(budget);
        work.spent = false;
        searched = search(record, options, period, all, &mut work)?;
    }
    let no_base = GapError::NoBase { points: record.len(), evaluations: work.done };
    let Some(Searched { traces, problem, mut floor, mut found }) = searched else { return Err(no_base) };
    let mut problem = problem;
    let base_fit = fit_to_all(&problem, &found.base, &mut work);
    work.begin(budget);
    let is_asked = |id: &str| !options.without.iter().any(|w| w == id);
    let others = if is_asked(effects::neighbour::EFFECT.id) { &options.neighbours[..] } else { &[] };
    let offered = neighbours::look(record, &problem, &found, base_fit.as_ref(), others, &mut work);
    let mut rivals = Vec::new();
    for (with, search) in offered.as_ref().map(|o| o.fits.clone()).unwrap_or_default() {
        // The best one now counts as an effect like any other; the others are weighed alone.
        if problem.neighbour.is_none() {
            problem.neighbour = with.neighbour;
            found.searches.push(search);
        } else {
            rivals.push((with, search));
        }
    }
    check_floor(&problem, &found, &traces, &mut floor);
    work.begin(budget);
    let filtered = if is_asked(effects::sensor_filter::EFFECT.id) {
        filter::look(record, &problem, &found, &traces, floor.noise_floor, &mut work)
    } else {
        None
    };
    let owes = floor_owes(&traces, &floor, filtered.as_ref());
    if let Some(filtered) = &filtered {
        (floor.noise_sd, floor.noise_floor) = (Some(filtered.noise_sd), Some(filtered.noise_sd));
    }
    let base = fit(&problem, &found.base, floor.noise_floor, &|_| {}).ok_or(no_base)?;
    let given = match &options.base {
        Base::Given(model) => Some(given::simulate(&problem, model, floor.noise_floor)?),
        _ => None,
    };
    work.begin(budget);
    let against = (base.rmse_train, floor.noise_floor);
    let seen = stages::look(record, &problem, &traces, against, &options.without, &mut work);
    let weighed = scales(&problem, &found, &base, &traces, &floor, options.seed);
    let mut effects = weigh(&weighed, &found, filtered.as_ref(), options);
    effects.extend(rivals.iter().filter_map(|(with, search)| Scales { problem: with, ..weighed }.weigh(search)));
    effects.sort_by(|a, b| b.lead.total_cmp(&a.lead));
    let acts = offered.as_ref().and_then(|o| o.compared.acts.as_deref()).map(effects::neighbour::id_of);
    let mut basis = basis(record, &problem, &found, &base, &traces, &effects, &seen, &floor, owes, options);
    basis.acts = acts;
    let nothing = decide::decide(&Evidence::new(&basis, &[], None), &[], Calibration::shipped());
    let mut made = Diagnosis {
        relative_gap: base.gap / problem.deviation,
        predictions: Predictions {
            pv_base: Vec::new(),
            pv_after: Vec::new(),
            held_out: problem.blocks.held_out.clone(),
            masked: problem.blocks.masked.clone(),
        },
        model_after: base.model.clone(),
        fits_to_all: base_fit.into_iter().collect(),
        base,
        given,
        effects,
        cause: nothing.cause,
        second: nothing.second,
        alternatives: nothing.alternatives,
        features: nothing.features,
        forward: None,
        from_sp: None,
        pairs: Vec::new(),
        evaluations: 0,
        budget_evaluations: budget,
        ended: found.ended,
        stopped_early: false,
        floor,
        blocks: problem.blocks.clone(),
        signatures: traces.signatures.clone(),
        noise_models: basis.noise,
        stages: seen.map(|s| s.stages),
        next_test: None,
        loads: offered.as_ref().map(|o| o.loads.clone()).unwrap_or_default(),
        neighbours: offered.map(|o| o.compared),
        basis,
    };
    made.settle(&[]);
    if options.pairs || made.leaves_more() {
        work.begin(budget);
        let scales = scales(&problem, &found, &made.base, &traces, &made.floor, options.seed);
        let (weighed, searches) = pairs::run(&problem, &found, &scales, &mut work);
        made.pairs = weighed;
        made.settle(&[]);
        found.searches.extend(searches);
    }
    let random = &effects::random_friction::EFFECT;
    let replay = is_asked(random.id).then(|| replay(record, &problem, &made, &mut work)).flatten();
    if let Some(replay) = &replay {
        let scales = scales(&problem, &found, &made.base, &traces, &made.floor, options.seed);
        let result = scales.replayed(random, replay);
        made.effects.push(result);
        made.effects.sort_by(|a, b| b.lead.total_cmp(&a.lead));
        made.basis.random_bands = true;
        made.settle(&[]);
    }
    run_forward(record, &problem, &found, &mut made, &mut work);
    let is_cause = |search: &&Search| !made.fits_to_all.is_empty() && search.structure.id_in(&problem) == made.cause.id;
    let cause = found.searches.iter().find(is_cause);
    let fit_of_cause = cause.and_then(|search| fit_to_all(&problem, search, &mut work));
    made.fits_to_all
        .extend(fit_of_cause.or_else(|| replay.filter(|_| made.cause.id == random.id).map(|replay| replay.fit)));
    made.confirm();
    made.next_test = next_test(&problem, &found, &made);
    made.evaluations = work.done;
    made.stopped_early = work.stopped || work.spent;
    if work.stopped {
        made.ended = Ended::Stopped;
    }
    Ok(made)
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

/// A replay of OP with random bands, where the search names nothing.
fn replay(record: &Record, problem: &Problem, made: &Diagnosis, work: &mut Work<'_>) -> Option<Replay> {
    let (base, floor) = (made.fits_to_all.first()?, made.floor.noise_floor?);
    if made.cause.id != UNKNOWN || made.base.at_floor || work.stopped {
        return None;
    }
    let found = work.all(break_away::SEARCHES, |which| break_away::search(record, base, problem.blocks.from, which));
    break_away::judge(record, problem, base, floor, found.into_iter().flatten())
}

fn scales<'a>(
    problem: &'a Problem,
    found: &'a Found,
    base: &'a Fit,
    traces: &'a Traces,
    floor: &'a Floor,
    seed: u64,
) -> Scales<'a> {
    Scales { problem, floor, base, search: &found.base, traces, seed }
}

/// The best residual's high band beside the floor that was read from PV alone; where a recorder thinned PV, the floor is
/// what this residual shows at the values that were stored.
fn check_floor(problem: &Problem, found: &Found, traces: &Traces, floor: &mut Floor) {
    let best = found.searches.iter().chain([&found.base]).min_by(|a, b| a.sse().total_cmp(&b.sse()));
    let left = best.and_then(|search| residual_of(problem, search));
    if let (true, Some(left)) = (traces.thinned, &left) {
        let sd = noise::of_measured(left, &traces.measured, problem.blocks.from).map(|s| s * problem.deviation);
        let sd = sd.filter(|_| traces.noise_shows);
        floor.noise_sd = sd;
        floor.noise_floor = sd.filter(|s| *s > 0.0);
    }
    let sd = left.and_then(|r| noise::high_band(&r, &problem.train));
    floor.high_band_sd = sd.map(|s| s * problem.deviation);
}

/// How much of the floor is owed to what an effect told of PV's noise: a grid's own share, and the memory of a filter. Before
/// the filter's own noise is taken for the floor.
fn floor_owes(traces: &Traces, floor: &Floor, filtered: Option<&Filtered>) -> BTreeMap<String, f64> {
    /// Most that is owed: a coarse grid leaves nothing of the noise.
    const MOST: f64 = 20.0;
    let over = |with: Option<f64>, without: Option<f64>| {
        let (with, without) = (with?, without?);
        Some((with / without.max(with / MOST)).max(1.0))
    };
    let grid = effects::quantisation::EFFECT.id;
    let is_coarse = traces.signatures.iter().any(|s| s.id == grid && s.met);
    let of_grid = over(floor.noise_floor, floor.noise_sd).filter(|_| is_coarse).map(|by| (grid, by));
    let of_filter = filtered.and_then(|f| over(Some(f.noise_sd), floor.noise_floor));
    let of_filter = of_filter.map(|by| (effects::sensor_filter::EFFECT.id, by));
    of_grid.into_iter().chain(of_filter).map(|(id, by)| (id.to_owned(), by)).collect()
}

/// Every effect of the catalogue, weighed.
fn weigh(scales: &Scales<'_>, found: &Found, filtered: Option<&Filtered>, options: &GapOptions) -> Vec<EffectResult> {
    let (problem, floor) = (scales.problem, scales.floor);
    let mut out: Vec<EffectResult> = found.searches.iter().filter_map(|search| scales.weigh(search)).collect();
    let left = residual_of(problem, &found.base);
    let one_step =
        left.and_then(|r| noise::autoregression(&r, &problem.train)).map(|a| a.mse.sqrt() * problem.deviation);
    let asked = |e: &&effects::Effect| !options.without.iter().any(|w| w == e.id);
    for effect in effects::ALL.into_iter().filter(asked) {
        let floor_after = match effect.way {
            Way::Noise => one_step,
            _ if effect.id == effects::quantisation::EFFECT.id => floor.noise_floor,
            _ => None,
        };
        match (effect.way, filtered) {
            (Way::Simulated | Way::AgainstLinear | Way::Neighbour | Way::Replay, _) => {}
            (Way::Filter, Some(filtered)) => out.push(scales.filtered(effect, filtered)),
            _ => out.push(scales.recorded(effect, floor_after)),
        }
    }
    out.sort_by(|a, b| b.lead.total_cmp(&a.lead));
    out
}

/// What the decision is made from beside the fits.
#[allow(clippy::too_many_arguments)] // everything that was found
fn basis(
    record: &Record,
    problem: &Problem,
    found: &Found,
    base: &Fit,
    traces: &Traces,
    weighed: &[EffectResult],
    seen: &Option<stages::Seen>,
    floor: &Floor,
    floor_owes: BTreeMap<String, f64>,
    options: &GapOptions,
) -> Basis {
    let nothing = || vec![0.0; problem.n()];
    let mut of_base = vec![residual_of(problem, &found.base).unwrap_or_else(nothing)];
    let places = found.base.best.iter().skip(1).chain(&found.by_moves);
    of_base.extend(places.filter_map(|place| residual_at(problem, &found.base, place)));
    let best = found.searches.iter().min_by(|a, b| a.sse().total_cmp(&b.sse()));
    let of_best = best.and_then(|search| residual_of(problem, search)).unwrap_or_else(nothing);
    let after = (base.dead_time_s + base.time_constants_s.first().copied().unwrap_or(0.0)) / problem.point_s;
    let mut slipped = vec![false; problem.n()];
    for slip in &base.slips {
        let end = (slip.point + after.ceil() as usize + 1).min(problem.n());
        slipped[slip.point..end].fill(true);
    }
    let mut strongest: Vec<_> = traces.signatures.iter().filter(|s| s.met).collect();
    strongest.sort_by(|a, b| (b.value / b.threshold).total_cmp(&(a.value / a.threshold)));
    let reading = controller::read_within(record, LAGS);
    let skew = reading.map(|r| r.lag_samples / problem.box_samples).filter(|l| {
        let [low, high] = USUAL_LAGS;
        *l < low || *l > high
    });
    let left_out = |id: &str| options.without.iter().any(|w| w == id);
    Basis {
        traces: strongest.iter().filter(|s| !left_out(s.id)).map(|s| s.id.to_owned()).collect(),
        traces_close: weighed
            .iter()
            .filter(|e| !e.simulated)
            .filter_map(|e| Some((e.id.clone(), e.closed_pct?)))
            .collect(),
        filter: weighed.iter().any(|e| e.simulated && e.id == effects::sensor_filter::EFFECT.id),
        floor_owes,
        acts: None,
        random_bands: false,
        skew: skew.filter(|_| !left_out(effects::time_skew::EFFECT.id)),
        noise: noise::judge(problem, &of_base[0], &of_best, &slipped, options.seed),
        alone: noise::alone(problem, &of_base, &of_best, &slipped, options.seed),
        coloured_noise: !left_out(effects::coloured_noise::EFFECT.id),
        by_mv: seen.as_ref().map(|s| s.stages.stage).filter(|_| !base.at_floor),
        on_mv: seen.as_ref().map(|s| s.ranked.clone()).unwrap_or_default(),
        base_at_floor: base.at_floor,
        base: Left::of(base, floor.noise_floor),
        excited: excited(record, problem),
        linear: options.base == Base::Linear,
    }
}

/// Whether the record holds more than one repeated swing: the set point moves, or OP's turns differ in size.
fn excited(record: &Record, problem: &Problem) -> bool {
    let moves = record.sp.as_ref().is_some_and(|sp| stats::std_dev(sp) > 0.05 * problem.deviation);
    moves || !problem.oscillates
}

/// Base and cause fitted to the first part alone: the run over the rest from OP, and from SP.
fn run_forward(record: &Record, problem: &Problem, found: &Found, made: &mut Diagnosis, work: &mut Work<'_>) {
    let cause = found.searches.iter().find(|l| l.structure.id_in(problem) == made.cause.id);
    if work.stopped || cause.is_none() && !loop_run::sp_moves(record) {
        return;
    }
    let floor = made.floor.noise_floor;
    let searches: Vec<_> = iter::once(&found.base).chain(cause).collect();
    let Some(first) = fitted_to_first_part(problem, &searches, floor, work) else { return };
    made.from_sp = loop_run::from_sp(record, &first);
    if let [base, cause] = first.fits.as_slice() {
        let [gap_before, gap_after] = [base, cause].map(|fit| above_floor(fit.rmse, floor));
        made.forward = Some(Forward { gap_before, gap_after });
    }
}
