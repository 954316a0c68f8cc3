//! From a record to the bands: normalise, search, refine, compare with a fit without stiction.

use super::choice::{Options, ValveChoice};
use super::class::Class;
use super::no_fit::NoFit;
use super::normalised::NormalisedRecord;
use super::sign;
use super::slip_search::answer::{Answer, OrderChoice, held_out_share, improvement, view_of};
use super::slip_search::candidate::{Candidate, apart};
use super::slip_search::interval;
use super::slip_search::problem::Problem;
use super::slip_search::rivals;
use super::slip_search::settings::SearchSettings;
use super::slip_search::stages::{Ended, Found, Request, Search};
use super::slip_search::thirds;
use super::width::{Spread, Third};
use crate::core::record::Record;
use crate::core::signal::stats;
use crate::core::sim::slips::Law;
use serde::{Deserialize, Serialize};

/// Result of a fit. Bands in OP units, gain in PV units per OP unit (also per second if integrating).
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// Dead band plus stick band.
    pub s: f64,
    /// Slip jump.
    pub j: f64,
    /// Robust span of OP.
    pub span: f64,
    /// 1 - error with stiction / error without, for the same process class, 0..1.
    pub index: f64,
    /// The valve model that fits better.
    pub law: Law,
    /// Process class.
    pub class: Class,
    /// Process gain.
    pub gain: f64,
    /// Time constants, s, largest first.
    pub time_constants_s: Vec<f64>,
    /// Dead time, s.
    pub dead_time_s: f64,
    /// Mean squared free-run error, PV units squared.
    pub mse: f64,
    /// Mean squared free-run error without stiction, PV units squared.
    pub mse_without: f64,
    /// Movements of the stem.
    pub slips: usize,
    /// Reversals of the stem.
    pub reversals: usize,
    /// Standard error of j from the fit of fd, OP units; infinite if fd is not separable from the gain.
    pub j_error: f64,
    /// Range of s with the same slips, OP units.
    pub s_cell: [f64; 2],
    /// Ranges of s, j, fs and fd that explain the record almost as well, OP units; [`crate::core::verdict::assess`] widens them
    /// to 90 % intervals.
    pub spread: Spread,
    /// Share of PV's movement left unexplained in the last part of the record by a process fitted to the part before.
    pub held_out: f64,
    /// Number of models evaluated.
    pub evaluations: u64,
    /// Rounds of the search, for all signs of the gain.
    pub rounds: usize,
    /// Why the search for the answer ended.
    pub ended: Ended,
    /// The error that was minimised, and how the order was chosen.
    pub basis: FitBasis,
}

/// Basis of a fit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FitBasis {
    /// Coefficient rho of the filter `1 - rho q^-1` behind which the free-run error was minimised; 0 where that was left white.
    pub error_filter: f64,
    /// How the order of the process was chosen.
    pub order: OrderChoice,
}

impl Estimate {
    /// Share of the error that friction removes, for the reported model.
    #[must_use]
    pub(crate) fn stiction_index(&self) -> f64 {
        improvement(self.mse, self.mse_without)
    }
}

/// Half width of a 90 % interval in standard errors of a mean of three (Student's t); smallest half widths of the gain, as a
/// logarithm, and of the dead time, in points.
const OF_THREE: f64 = 2.92;
const LEAST_GAIN: f64 = 0.05;
const LEAST_DEAD_TIME: f64 = 0.5;

impl Estimate {
    /// 90 % interval of the gain, from the scatter of the record's thirds.
    #[must_use]
    pub(crate) fn gain_interval(&self) -> Option<[f64; 2]> {
        let gains = self.thirds().map(|third| third.gain).filter(|gain| *gain > 0.0);
        let half = half_width(gains.map(libm::log))?.max(LEAST_GAIN);
        let ends = [-half, half].map(|by| self.gain * libm::exp(by));
        Some([ends[0].min(ends[1]), ends[0].max(ends[1])])
    }

    /// 90 % interval of the dead time, s; `point_s` is the time between points.
    #[must_use]
    pub(crate) fn dead_time_interval_s(&self, point_s: f64) -> Option<[f64; 2]> {
        let half = point_s * half_width(self.thirds().map(|third| third.dead_time))?.max(LEAST_DEAD_TIME);
        Some([(self.dead_time_s - half).max(0.0), self.dead_time_s + half])
    }

    fn thirds(&self) -> impl Iterator<Item = Third> {
        self.spread.thirds.into_iter().flatten()
    }
}

/// Half width of the 90 % interval of a mean; `None` for fewer than two values.
fn half_width(values: impl Iterator<Item = f64>) -> Option<f64> {
    let values: Vec<f64> = values.collect();
    let error = stats::std_dev(&values) / (values.len() as f64 - 1.0).sqrt();
    (values.len() > 1).then_some(OF_THREE * error)
}

/// Share of PV's variance left unexplained from which the sign that was read is in doubt.
const DOUBTFUL: f64 = 0.3;
/// Largest share of the error that the other sign may leave to be believed, and its least stiction index.
const AGAINST: [f64; 2] = [0.5, 0.5];
/// Difference in error, as a share, that does not distinguish the laws.
const HARDLY_WORSE: f64 = 0.01;
/// Rivals included in the interval.
const RIVALS: usize = 24;

/// The best valve and process model of a record.
///
/// # Errors
/// The record cannot be fitted, or no model fits it.
pub fn quantify(record: &Record, options: &Options) -> Result<Estimate, NoFit> {
    let normalised = NormalisedRecord::of(record, options)?;
    let deviation = normalised.deviation;
    let laws: &[Law] = match options.valve {
        ValveChoice::He => &[Law::He],
        ValveChoice::Tracking => &[Law::Tracking],
        ValveChoice::Auto => &[Law::He, Law::Tracking],
    };
    let of_sign = |sign: f64, rival: f64| {
        let problem = Problem::new(&normalised, sign);
        estimate(&problem, options, laws, rival, record)
    };
    let sp = record.sp.as_ref().filter(|sp| sp.len() == record.len());
    let level = stats::mean(&record.pv);
    let sp: Option<Vec<f64>> = sp.map(|sp| sp.iter().map(|v| (v - level) / deviation).collect());
    let Some(read) = sign::of_gain_with_sp(&normalised.mean, &normalised.pv, sp.as_deref()) else {
        let both = [1.0, -1.0].map(|sign| of_sign(sign, f64::INFINITY));
        let rounds = both.iter().flatten().map(|e| e.rounds).sum();
        let evaluations = both.iter().flatten().map(|e| e.evaluations).sum();
        let best = both.into_iter().flatten().min_by(|a, b| a.mse.total_cmp(&b.mse)).ok_or(NoFit::NoModel)?;
        return Ok(Estimate { rounds, evaluations, ..best });
    };
    let found = of_sign(read, f64::INFINITY).ok_or(NoFit::NoModel)?;
    if found.mse <= DOUBTFUL * deviation * deviation {
        return Ok(found);
    }
    // A fit of the controller backwards needs no friction, so only a sticking valve overrules the sign that was read.
    let rival = AGAINST[0] * found.mse;
    let counted = record.len().saturating_sub(normalised.from).max(1) as f64;
    let other = of_sign(-read, rival / (deviation * deviation) * counted);
    let evaluations = found.evaluations + other.as_ref().map_or(0, |o| o.evaluations);
    let believed = other.filter(|o| o.mse < rival && o.index > AGAINST[1]).unwrap_or(found);
    Ok(Estimate { evaluations, ..believed })
}

/// The estimate for one sign of the gain; the search gives up above the error `rival`.
fn estimate(problem: &Problem<'_>, options: &Options, laws: &[Law], rival: f64, record: &Record) -> Option<Estimate> {
    let Options { model, fineness_pct, seed, .. } = *options;
    let request = Request { laws, model, fineness_pct, seed, rival };
    let settings = SearchSettings::usual();
    let (found, mut search) = Search::new(problem, &request, &settings).run();
    let best = *found.best.first()?;
    let answer = search.answer(best, &found, options)?;
    let mut made = report(&mut search, &answer, &found, options, record)?;
    let other_law = found.best.get(1).filter(|c| c.sse() < (1.0 + HARDLY_WORSE) * best.sse());
    if let Some(other) = other_law.copied()
        && let Some(answer) = search.answer(other, &found, options)
        && let Some(other) = report(&mut search, &answer, &found, options, record)
    {
        made.spread = made.spread.or(&other.spread);
    }
    made.evaluations = search.evaluations();
    Some(made)
}

/// The estimate in recorded units.
fn report(
    search: &mut Search<'_, '_>,
    answer: &Answer,
    found: &Found,
    options: &Options,
    record: &Record,
) -> Option<Estimate> {
    let mut view = view_of(search, answer);
    let count = view.count();
    let (evaluator, plain) = search.whole();
    let NormalisedRecord { span, deviation, .. } = *evaluator.problem.normalised;
    let class = answer.candidate.class;
    let rivals: Vec<Candidate> = apart(&found.seen, RIVALS, 0);
    let of_view = |sse: f64| improvement(sse, answer.without);
    let index = if answer.rho == 0.0 { of_view(answer.plain.sse) } else { of_view(answer.plain_sse) };
    let met = interval::spread(evaluator, &mut view, &answer.candidate, &rivals, index, options.seed)?;
    let best = met.best;
    let mut spread = met.spread;
    spread.thirds = thirds::thirds(evaluator, answer.rho, &best, &found.seen, options.seed);
    spread.distinct = !spread.whiteness.is_noise() && rivals::are_ruled_out(&best, &answer.rivals);
    // A better candidate found while computing the interval becomes the answer.
    let same = best.covers(answer.candidate.s, answer.candidate.j, answer.candidate.start);
    let plain_sse = if answer.rho == 0.0 {
        met.process.sse
    } else if same {
        answer.plain_sse
    } else {
        let again = evaluator.in_class(plain, &best, class).and_then(|c| evaluator.polish(plain, &c));
        again.map_or(answer.plain_sse, |p| p.sse)
    };
    let held_out = held_out_share(evaluator, answer.rho, &best);
    let [s, j] = interval::centred(&best);
    let point_s = record.point_s();
    let gain = class.gain(met.process.gain) * deviation / span;
    let taus = &met.process.taus[..class.lags()];
    let raw_lag = met.process.lag * record.box_samples as f64;
    let to_mse = deviation * deviation / count;
    Some(Estimate {
        s: s * span,
        j: j * span,
        span,
        index: improvement(plain_sse.min(answer.plain.sse), answer.without),
        law: best.law,
        class,
        gain: if class.integrates() { gain / point_s } else { gain },
        time_constants_s: taus.iter().map(|t| t * point_s).collect(),
        dead_time_s: (raw_lag - 1.0).max(0.0) * record.ts_s,
        mse: plain_sse * to_mse,
        mse_without: answer.without * to_mse,
        slips: best.slips,
        reversals: best.reversals,
        j_error: 2.0 * met.band_error * span,
        s_cell: best.cells[0].map(|v| v * span),
        spread: spread.scaled(span),
        held_out,
        evaluations: 0,
        rounds: found.rounds,
        ended: found.ended,
        basis: FitBasis {
            error_filter: answer.rho,
            order: OrderChoice {
                held_out_rms: answer.order.held_out_rms.map(|both| both.map(|rms| rms * deviation)),
                ..answer.order
            },
        },
    })
}
