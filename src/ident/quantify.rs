//! From a record to the bands: normalise, search, refine, compare with no stiction at all.

use super::candidate::{Bench, Candidate, Effort, Question};
use super::choice::{DelayChoice, ModelChoice, ValveChoice};
use super::class::{Class, Limits};
use super::fit::Target;
use super::frictionless;
use super::search::{Look, beam, climb, generator};
use super::sign;
use crate::optim::{self, Objective, Outcome, Settings, Termination};
use crate::record::Record;
use crate::signal::stats;
use crate::sim::slips::Law;

/// What a fit is told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Process order.
    pub model: ModelChoice,
    /// Dead time.
    pub delay: DelayChoice,
    /// Valve law.
    pub valve: ValveChoice,
    /// Name of the global solver; an unknown one falls back to the contour grid.
    pub solver: &'static str,
    /// Step of the contour grid, % of the span.
    pub fineness_pct: f64,
    /// Seed of every random choice.
    pub seed: u64,
    /// Period of the oscillation, points, where one is known.
    pub period_points: Option<f64>,
}

/// What a fit found. Bands in OP units, gain in PV units per OP unit (per second too when integrating).
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// Dead band plus stick band.
    pub s: f64,
    /// Slip jump.
    pub j: f64,
    /// Robust span of OP.
    pub span: f64,
    /// 1 - error with stiction / error without, same class of process, 0..1.
    pub index: f64,
    /// The law that fits better.
    pub law: Law,
    /// Class of the process.
    pub class: Class,
    /// Process gain.
    pub gain: f64,
    /// Time constants, s, largest first.
    pub time_constants_s: Vec<f64>,
    /// Dead time, s.
    pub dead_time_s: f64,
    /// Mean squared free-run error, PV units squared.
    pub mse: f64,
    /// The same without stiction.
    pub mse_without: f64,
    /// Moves of the stem.
    pub slips: usize,
    /// Changes of the stem's direction.
    pub reversals: usize,
    /// Standard error of j from the fit of fd, OP units; infinite where fd is not seen apart from the gain.
    pub j_error: f64,
    /// All s in this range give the same slips, OP units.
    pub s_cell: [f64; 2],
    /// Model responses computed.
    pub evaluations: u64,
    /// The global solver's name.
    pub solver: &'static str,
    /// Why it stopped.
    pub stopped: Termination,
}

/// Filter of the search, first and later: differences of free-run errors forget a wrong slip, so the right one is
/// found from farther away; the plain error, which is minimised last, is sharper.
const SEARCH_RHO: f64 = 0.98;
const FINER_RHO: f64 = 0.8;
/// Share of PV's variance left unexplained from which the sign that was read is doubted.
const DOUBTFUL: f64 = 0.3;
/// Stiction index below which the exact size of the bands is not worth the work.
const WORTH_REFINING: f64 = 0.1;
/// Share of the error that a second lag must remove.
const SECOND_ORDER_GAIN: f64 = 0.10;

/// The best valve law and process model of a record, or `None` where a signal does not move or nothing moves the stem.
#[must_use]
pub fn quantify(record: &Record, options: &Options) -> Option<Estimate> {
    let span = stats::span(&record.op_path);
    let deviation = stats::std_dev(&record.pv);
    if record.len() < 30 || !span.is_normal() || !deviation.is_normal() {
        return None;
    }
    let question = pose(record, options, span, deviation);
    let plain = Target::new(&question.pv, 0.0, question.from);
    let mut evaluations = 0;
    let mut best: Option<Found> = None;
    let read = sign::of_gain(&question.mean, &question.pv);
    let laws: &[Law] = match options.valve {
        ValveChoice::He => &[Law::He],
        ValveChoice::Tracking => &[Law::Tracking],
        ValveChoice::Auto => &[Law::He, Law::Tracking],
    };
    for &law in laws {
        let mut found = search(&question, &plain, law, read.unwrap_or(1.0), options);
        evaluations += found.evaluations;
        if read.is_none() || found.sse() > DOUBTFUL * found.nothing {
            let other = search(&question, &plain, law, -found.sign, options);
            evaluations += other.evaluations;
            // Against the sign read only a valve speaks: a model of the controller backwards needs no friction.
            let speaks = read.is_none() || (other.index() > 0.5 && other.sse() < 0.5 * found.sse());
            if speaks && other.sse() < found.sse() {
                found = other;
            }
        }
        if best.as_ref().is_none_or(|b| found.sse() < b.sse()) {
            best = Some(found);
        }
    }
    let best = best?;
    report(record, &question, &plain, &best, evaluations, span, deviation)
}

/// The outcome of one search for one law and sign.
struct Found {
    candidate: Option<Candidate>,
    class: Class,
    law: Law,
    sign: f64,
    without: f64,
    /// Squared error of no process at all.
    nothing: f64,
    evaluations: u64,
    outcome: Outcome,
    solver: &'static str,
}

impl Found {
    fn sse(&self) -> f64 {
        self.candidate.map_or(f64::INFINITY, |c| c.fit.sse)
    }

    fn index(&self) -> f64 {
        improvement(self.sse(), self.without)
    }
}

/// The value on a grid of 2^-24, far finer than any recording: shifting or scaling a record changes its normalised
/// values in the last bits only, and the grid takes those away, so that every search takes the same way.
fn on_grid(x: f64) -> f64 {
    const GRID: f64 = 16_777_216.0;
    (x * GRID).round() / GRID
}

/// The record in normalised form.
pub(super) fn pose(record: &Record, options: &Options, span: f64, deviation: f64) -> Question {
    let (n, m) = (record.len(), record.path_per_point());
    let middle = stats::mean(&record.op_path);
    let path: Vec<f64> = record.op_path.iter().map(|u| on_grid((u - middle) / span)).collect();
    let mean: Vec<f64> = path.chunks_exact(m).map(stats::mean).collect();
    let level = stats::mean(&record.pv);
    let pv = record.pv.iter().map(|p| on_grid((p - level) / deviation)).collect();
    let period = options.period_points.unwrap_or(n as f64 / 5.0).clamp(6.0, n as f64);
    let period = (16.0 * period).round() / 16.0;
    let raw = 1.0 / record.box_samples as f64;
    let most = (0.4 * period).clamp(6.0, 60.0).min(n as f64 / 6.0);
    let lag = match options.delay {
        DelayChoice::Auto => [raw, most],
        DelayChoice::Samples(d) => [raw * (d.max(0.0) + 1.0); 2],
        DelayChoice::Seconds(d) => [raw * (d.max(0.0) / record.ts_s + 1.0); 2],
    };
    let lag = lag.map(|l| l.min(0.5 * n as f64));
    let from = (lag[1].ceil() as usize + 1).min(n / 2);
    let limits = Limits { tau: [0.3, (3.0 * n as f64).max(500.0)], lag };
    let records = Question::records_of(&path);
    let still = vec![0.0; n];
    let width = ((period / 32.0) as usize).max(1);
    let travel: Vec<f64> = mean.windows(width + 1).map(|w| (w[width] - w[0]).abs() / width as f64).collect();
    let rate = stats::median(&travel);
    Question { path, per_point: m, mean, still, pv, limits, from, period, rate, records }
}

/// The best candidate for one law and one sign of the gain, in the class that it deserves.
fn search(question: &Question, plain: &Target, law: Law, sign: f64, options: &Options) -> Found {
    let solver = optim::by_name(options.solver).unwrap_or(optim::ALL[0]);
    let settings = Settings { budget: 20_000, fineness_pct: options.fineness_pct, seed: options.seed };
    let mut rng = generator(options.seed, 1);
    // By level: the solver's own look at the free-run error.
    let mut bench = Bench::new(question, law, Class::First, plain, sign);
    let mut look = Look::new(&mut bench, 3, 2);
    let outcome = solver.search(&mut look, &settings);
    let held = beam(&look.pool, 10, 2);
    let mut by_level = round(&mut bench, held, 40, &mut rng);
    by_level.truncate(3);
    let by_level = round(&mut bench, by_level, 100, &mut rng);
    let mut evaluations = bench.fitter.evaluations;
    // By moves: the same of PV's differences, which finds the exact slips from farther away.
    let shows = by_level
        .first()
        .is_some_and(|c| improvement(c.fit.sse, frictionless(question, plain, Class::First, sign)) > WORTH_REFINING);
    let (by_moves, class) = search_moves(question, law, sign, options, shows, &mut rng, &mut evaluations);
    let mut bench = Bench::new(question, law, class, plain, sign);
    let mut held: Vec<Candidate> = by_moves.iter().filter_map(|c| bench.settle(c)).collect();
    held.extend(by_level.iter().take(2).filter_map(|c| in_class(&mut bench, c)));
    let held = round(&mut bench, held, if shows { 100 } else { 20 }, &mut rng);
    let mut candidate = held.first().copied();
    if shows {
        candidate = candidate.map(|c| climb(&mut bench, c, 150, false, &mut rng));
    }
    candidate = candidate.and_then(|c| bench.settle(&c));
    let (mut candidate, mut class) = demote(&mut bench, candidate, options.model);
    evaluations += bench.fitter.evaluations;
    if options.model != ModelChoice::Sopdt && class != Class::First {
        let first = by_level.first().filter(|f| candidate.is_none_or(|c| f.fit.sse < c.fit.sse));
        if let Some(first) = first {
            (candidate, class) = (Some(*first), Class::First);
        }
    }
    let without = frictionless(question, plain, class, sign);
    let nothing = plain.y.len() as f64 * stats::variance(&plain.y);
    Found { candidate, class, law, sign, without, nothing, evaluations, outcome, solver: solver.name() }
}

/// Candidates found by differences of the free-run error, and the class of process that they ask for.
fn search_moves(
    question: &Question,
    law: Law,
    sign: f64,
    options: &Options,
    shows: bool,
    rng: &mut rand_chacha::ChaCha8Rng,
    evaluations: &mut u64,
) -> (Vec<Candidate>, Class) {
    let filtered = Target::new(&question.pv, SEARCH_RHO, question.from);
    let mut bench = Bench::new(question, law, Class::First, &filtered, sign);
    let mut look = Look::new(&mut bench, 1, 2);
    sweep(&mut look);
    let held = beam(&look.pool, 20, 6);
    let shows = shows
        || held.first().is_some_and(|c| {
            improvement(c.fit.sse, frictionless(question, &filtered, Class::First, sign)) > WORTH_REFINING
        });
    if !shows {
        let class = deserved(&mut bench, &held, options.model);
        bench.class = class;
        let held = held.into_iter().take(2).filter_map(|c| in_class(&mut bench, &c)).collect();
        *evaluations += bench.fitter.evaluations;
        return (held, class);
    }
    let held = round(&mut bench, held, 70, rng);
    let class = deserved(&mut bench, &held, options.model);
    bench.class = class;
    let mut held: Vec<Candidate> = held.into_iter().take(8).filter_map(|c| in_class(&mut bench, &c)).collect();
    for centre in beam(&held, 2, 0) {
        held.extend(zoom(&mut bench, &centre));
    }
    let held = beam(&held, 10, 0);
    let mut held = round(&mut bench, held, 120, rng);
    held.truncate(4);
    *evaluations += bench.fitter.evaluations;
    let finer = Target::new(&question.pv, if class.integrates() { SEARCH_RHO } else { FINER_RHO }, question.from);
    let mut bench = Bench::new(question, law, class, &finer, sign);
    let held: Vec<Candidate> = held.iter().filter_map(|c| bench.settle(c)).collect();
    let mut held = round(&mut bench, held, 250, rng);
    held.truncate(3);
    *evaluations += bench.fitter.evaluations;
    (held, class)
}

/// An even look on a logarithmic scale of s, which no linear grid gives to small bands.
fn sweep(look: &mut Look<'_, '_>) {
    const STEPS: i32 = 80;
    for k in 0..STEPS {
        let s = libm::pow(0.04, f64::from(k) / f64::from(STEPS - 1));
        for share in [0.04, 0.12, 0.27, 0.5, 0.75, 0.94] {
            look.cost([s, share * s]);
        }
    }
}

/// An even look around a candidate, its best places: 12 % of s to either side, 30 % of j.
fn zoom(bench: &mut Bench<'_>, around: &Candidate) -> Vec<Candidate> {
    let mut pool = Vec::new();
    for k in -12..=12 {
        for m in -3..=3 {
            let s = (around.s * (1.0 + 0.01 * f64::from(k))).min(1.0);
            let j = (around.j * (1.0 + 0.1 * f64::from(m))).min(s);
            let mut shape = around.fit.shape;
            // A later slip goes with a shorter lag.
            shape[bench.class.shape_len() - 1] -= (s - around.s) / bench.question.rate.max(1e-6);
            let shapes = [bench.class.clamp(shape, &bench.question.limits)];
            let effort = Effort { steps: 2, hopeless: 4.0 * around.fit.sse };
            pool.extend(bench.fit(s, j, around.start, &shapes, effort));
        }
    }
    beam(&pool, 4, 0)
}

/// Random steps for each of the candidates, best first afterwards.
fn round(
    bench: &mut Bench<'_>,
    held: Vec<Candidate>,
    steps: usize,
    rng: &mut rand_chacha::ChaCha8Rng,
) -> Vec<Candidate> {
    let climbed: Vec<Candidate> = held.into_iter().map(|c| climb(bench, c, steps, false, rng)).collect();
    beam(&climbed, usize::MAX, 0)
}

/// A candidate of first order refitted in the bench's class.
fn in_class(bench: &mut Bench<'_>, from: &Candidate) -> Option<Candidate> {
    let mut start = *from;
    if bench.class == Class::First {
        return Some(start);
    }
    let tau = libm::exp(from.fit.shape[0]);
    start.fit.shape = bench.class.clamp(bench.class.start(tau, from.fit.shape[1]), &bench.question.limits);
    bench.settle(&start).filter(|c| c.fit.gain != 0.0)
}

/// The class that the best candidates of first order ask for.
fn deserved(bench: &mut Bench<'_>, held: &[Candidate], model: ModelChoice) -> Class {
    let mut best_of = |class: Class| {
        bench.class = class;
        let refitted = held.iter().take(3).filter_map(|c| match class {
            Class::First => bench.settle(c),
            _ => in_class(bench, c),
        });
        refitted.map(|c| c.fit.sse).fold(f64::INFINITY, f64::min)
    };
    let simple = |first: f64, integrating: f64| {
        if integrating <= 1.005 * first { (integrating, Class::Integrating) } else { (first, Class::First) }
    };
    let double = |second: f64, lagged: f64| {
        if lagged <= 1.005 * second { (lagged, Class::LagIntegrating) } else { (second, Class::Second) }
    };
    match model {
        ModelChoice::Fopdt => simple(best_of(Class::First), best_of(Class::Integrating)).1,
        ModelChoice::Sopdt => double(best_of(Class::Second), best_of(Class::LagIntegrating)).1,
        ModelChoice::Auto => {
            let one = simple(best_of(Class::First), best_of(Class::Integrating));
            let two = double(best_of(Class::Second), best_of(Class::LagIntegrating));
            // Filtered errors are mostly noise, so a small gain here can be a large one there.
            if two.0 < 0.998 * one.0 { two.1 } else { one.1 }
        }
    }
}

/// Goes back to the simpler class where the second lag does not earn its place.
fn demote(bench: &mut Bench<'_>, candidate: Option<Candidate>, model: ModelChoice) -> (Option<Candidate>, Class) {
    let class = bench.class;
    let Some(rich) = candidate else { return (None, class) };
    let simpler = match (model, class) {
        (ModelChoice::Auto, Class::Second) => Class::First,
        (ModelChoice::Auto, Class::LagIntegrating) => Class::Integrating,
        _ => return (candidate, class),
    };
    bench.class = simpler;
    let mut start = rich;
    let lost = libm::exp(rich.fit.shape[if class == Class::Second { 1 } else { 0 }]);
    let lag = class.lag(&rich.fit.shape) + lost;
    start.fit.shape = simpler.clamp(simpler.start(libm::exp(rich.fit.shape[0]), lag), &bench.question.limits);
    match bench.settle(&start) {
        Some(plain) if plain.fit.sse * (1.0 - SECOND_ORDER_GAIN) <= rich.fit.sse => (Some(plain), simpler),
        _ => (Some(rich), class),
    }
}

/// Squared error of the best process without friction, of the same class and sign; at most that of no process at all.
fn frictionless(question: &Question, target: &Target, class: Class, sign: f64) -> f64 {
    frictionless::best(question, target, class, sign, 4).map_or(f64::INFINITY, |f| f.sse)
}

/// Share of an error that goes with the friction, 0..1.
pub(super) fn improvement(with: f64, without: f64) -> f64 {
    if without > 0.0 { (1.0 - with / without).clamp(0.0, 1.0) } else { 0.0 }
}

/// The estimate in recorded units.
#[allow(clippy::too_many_arguments)]
fn report(
    record: &Record,
    question: &Question,
    plain: &Target,
    found: &Found,
    evaluations: u64,
    span: f64,
    deviation: f64,
) -> Option<Estimate> {
    let c = found.candidate?;
    let count = plain.y.len() as f64;
    let scale = deviation * deviation / count;
    let [s, j] = c.centred();
    let mut bench = Bench::new(question, found.law, found.class, plain, found.sign);
    let band_error = bench.band_error(&c);
    let point_s = record.point_s();
    let gain = found.class.gain(c.fit.gain) * deviation / span;
    let raw_lag = found.class.lag(&c.fit.shape) * record.box_samples as f64;
    Some(Estimate {
        s: s * span,
        j: j * span,
        span,
        index: improvement(c.fit.sse, found.without),
        law: found.law,
        class: found.class,
        gain: if found.class.integrates() { gain / point_s } else { gain },
        time_constants_s: found.class.time_constants(&c.fit.shape).iter().map(|t| t * point_s).collect(),
        dead_time_s: (raw_lag - 1.0).max(0.0) * record.ts_s,
        mse: c.fit.sse * scale,
        mse_without: found.without * scale,
        slips: c.slips,
        reversals: c.reversals,
        j_error: 2.0 * band_error * span,
        s_cell: c.s_cell.map(|v| v * span),
        evaluations,
        solver: found.solver,
        stopped: found.outcome.stopped,
    })
}
