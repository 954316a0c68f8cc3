//! From a record to the bands: normalise, search, refine, compare with no stiction at all.

use core::cell::RefCell;

use super::choice::{DelayChoice, ModelChoice, ValveChoice};
use super::class::Class;
use super::fit::Target;
use super::hunt::{Answer, Found, Ground, Rival, Scouted, hunt, scout};
use super::interval;
use super::pose::pose;
use super::sign;
use super::width::Spread;
use crate::optim::{self, Termination};
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

impl Default for Options {
    /// As the daemon asks, without a period.
    fn default() -> Self {
        Self {
            model: ModelChoice::default(),
            delay: DelayChoice::default(),
            valve: ValveChoice::default(),
            solver: "contour",
            fineness_pct: 5.0,
            seed: 1,
            period_points: None,
        }
    }
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
    /// The same for differences of the free-run error, which slow disturbances hardly touch.
    pub index_moves: f64,
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
    /// What else explains the record nearly as well, OP units.
    pub spread: Spread,
    /// Model responses computed.
    pub evaluations: u64,
    /// The global solver's name.
    pub solver: &'static str,
    /// Why it stopped.
    pub stopped: Termination,
}

/// Share of PV's variance left unexplained from which the sign that was read is doubted.
const DOUBTFUL: f64 = 0.3;
/// Stiction index, plain and of differences, below which a law sees no friction.
const NO_FRICTION: f64 = 0.05;
/// Searches with other chance at most, while the best leaves more than noise: in the rugged error a search finds the
/// right slips by luck too. And the stiction index below which they are not worth it.
const ROUNDS: u64 = 3;
const WORTH_ANOTHER: f64 = 0.3;
/// Share of the error that does not tell one law from the other.
const HARDLY_WORSE: f64 = 0.01;

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
    let moves = Ground::moves_of(&question);
    let ground = Ground { question: &question, plain: &plain, moves: &moves, options, known: RefCell::default() };
    let read = sign::of_gain(&question.mean, &question.pv);
    let laws: &[Law] = match options.valve {
        ValveChoice::He => &[Law::He],
        ValveChoice::Tracking => &[Law::Tracking],
        ValveChoice::Auto => &[Law::He, Law::Tracking],
    };
    let signs: &[f64] = match read {
        Some(1.0) => &[1.0],
        Some(_) => &[-1.0],
        None => &[1.0, -1.0],
    };
    let (mut all, mut evaluations) = search(&ground, laws, signs, read, Rival::NONE);
    for round in 1..ROUNDS {
        all.sort_by(|a, b| a.sse().total_cmp(&b.sse()));
        let Some(best) = all.first().filter(|best| !best.done && best.index() > WORTH_ANOTHER) else { break };
        let rival = Rival { sse: best.sse(), ..Rival::NONE };
        let options = Options { seed: options.seed.wrapping_add(round << 32), ..*options };
        let again = Ground { options: &options, known: ground.known.clone(), ..ground };
        let (more, spent) = search(&again, laws, signs, read, rival);
        evaluations += spent;
        all.extend(more);
    }
    all.sort_by(|a, b| a.sse().total_cmp(&b.sse()));
    let best = all.first()?;
    let mut estimate = report(record, &ground, best, evaluations, span, deviation)?;
    let other_law = all.iter().find(|f| f.law != best.law);
    if let Some(rival) = other_law.filter(|r| r.sse() < (1.0 + HARDLY_WORSE) * best.sse()) {
        let other = report(record, &ground, rival, 0, span, deviation);
        if let Some(other) = other {
            estimate.spread = estimate.spread.or(&other.spread);
        }
    }
    Some(estimate)
}

/// The best of each law, for the signs of the gain that may be, and the responses computed.
fn search(ground: &Ground<'_>, laws: &[Law], signs: &[f64], read: Option<f64>, known: Rival) -> (Vec<Found>, u64) {
    let nothing = ground.plain.y.len() as f64 * stats::variance(&ground.plain.y);
    let mut seen: Vec<Scouted<'_>> = laws.iter().map(|law| scout(ground, *law, signs)).collect();
    // The law that looks better comes first, so that the other one can be told to be far behind.
    seen.sort_by(|a, b| a.share().total_cmp(&b.share()));
    let (mut all, mut evaluations): (Vec<Found>, u64) = (Vec::new(), 0);
    for scouted in &seen {
        let rival = all.first().map_or(known, |f| Rival { sse: f.sse(), done: f.done, class: Some(f.class) });
        let mut found = hunt(ground, scouted, rival);
        evaluations += found.iter().map(|f| f.evaluations).sum::<u64>();
        if let (Some(_), Some(first)) = (read, found.first()) {
            // Against the sign read only a valve speaks: a model of the controller backwards needs no friction.
            let least = 0.5 * first.sse();
            if first.sse() > DOUBTFUL * nothing {
                let against: &[f64] = if signs == [1.0] { &[-1.0] } else { &[1.0] };
                let other = hunt(ground, &scout(ground, scouted.law, against), Rival { sse: least, ..Rival::NONE });
                evaluations += other.iter().map(|o| o.evaluations).sum::<u64>();
                found.extend(other.into_iter().filter(|o| o.index() > 0.5 && o.sse() < least));
            }
        }
        all.extend(found.into_iter().min_by(|a, b| a.sse().total_cmp(&b.sse())));
        // The laws are alike enough that where one sees no friction at all, the other need not be asked.
        let sees = |f: &Found| f.index().max(f.index_moves) >= NO_FRICTION;
        if !all.iter().any(sees) {
            break;
        }
    }
    (all, evaluations)
}

/// The estimate in recorded units.
fn report(
    record: &Record,
    ground: &Ground<'_>,
    found: &Found,
    evaluations: u64,
    span: f64,
    deviation: f64,
) -> Option<Estimate> {
    let Answer { candidate, rho, plain_sse } = found.answer?;
    let target = Target::new(&ground.question.pv, rho, ground.question.from);
    let count = ground.plain.y.len() as f64;
    let scale = deviation * deviation / count;
    let mut bench = ground.bench(found.law, found.class, &target, found.sign);
    let without = if rho == 0.0 { found.without[0] } else { found.without_of(&target, ground) };
    let met = interval::spread(&mut bench, &candidate, without, ground.options.seed);
    let (spread, c) = (met.spread, met.best);
    // A better candidate met on the way of the interval is the answer.
    let plain_sse = if rho == 0.0 {
        c.fit.sse
    } else if c == candidate {
        plain_sse
    } else {
        let mut plain = ground.bench(found.law, found.class, ground.plain, found.sign);
        plain.settle(&c).map_or(plain_sse, |c| c.fit.sse)
    };
    let [s, j] = c.centred();
    let band_error = bench.band_error(&c);
    let point_s = record.point_s();
    let gain = found.class.gain(c.fit.gain) * deviation / span;
    let raw_lag = found.class.lag(&c.fit.shape) * record.box_samples as f64;
    Some(Estimate {
        s: s * span,
        j: j * span,
        span,
        index: found.index(),
        index_moves: found.index_moves,
        law: found.law,
        class: found.class,
        gain: if found.class.integrates() { gain / point_s } else { gain },
        time_constants_s: found.class.time_constants(&c.fit.shape).iter().map(|t| t * point_s).collect(),
        dead_time_s: (raw_lag - 1.0).max(0.0) * record.ts_s,
        mse: plain_sse * scale,
        mse_without: found.without[0] * scale,
        slips: c.slips,
        reversals: c.reversals,
        j_error: 2.0 * band_error * span,
        s_cell: c.s_cell.map(|v| v * span),
        spread: spread.scaled(span),
        evaluations: evaluations + bench.fitter.evaluations,
        solver: optim::by_name(ground.options.solver).unwrap_or(optim::ALL[0]).name(),
        stopped: found.outcome.stopped,
    })
}
