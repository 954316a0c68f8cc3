//! Cause of an oscillation without stiction: the loop's tuning or an external disturbance; and contributing causes.
//!
//! [`Ringing`] decides: lines that keep their phase come from outside, and a mode that stands out from the rest of the spectrum
//! belongs to the loop. The bounds were set on simulated loops of first and second order and integrating ones under random
//! load: at 80 to 97 % of their ultimate gain, and at 20 to 50 % of it driven by a sine, a square wave or two sines. Lines hold
//! over 0.9 of the variance of the driven loops and less of the ringing ones, whose mode stands out by a factor of 2.6 to 170.
//! External cycles whose periods vary by 2 to 10 % are no lines, but keep their amplitude within 2 to 12 %, ringing loops
//! within 15 to 66 %.

use core::f64::consts::PI;

use nalgebra::Complex;
use serde::{Deserialize, Serialize};

use super::document::Verdict;
use crate::core::detect::following::{self, Following};
use crate::core::detect::oscillation::Oscillates;
use crate::core::detect::ringing::{self, Ringing};
use crate::core::ident::Estimate;
use crate::core::ident::controller::Reading;
use crate::core::record::Record;
use crate::core::signal::stats;

/// Share of the variance in lines above which the loop is driven externally.
const DRIVEN: f64 = 0.85;
/// The same if no mode shows in addition: only a mode makes random load gather half of its power in lines.
const HALF: f64 = 0.5;
/// Share of the variance outside the lines from which a mode in it matters.
const LEFT: f64 = 0.03;
/// Damping up to which a mode rings (an estimate from twenty periods lies above the true value), and the height from which it
/// stands out; the last height counts even where lines hold nearly all of the variance.
const RINGS: f64 = 0.25;
const STANDS_OUT: f64 = 2.5;
const TOWERS: f64 = 12.0;
/// Unsteadiness below which an oscillation comes from outside, although its phase may wander.
const STEADY: f64 = 0.13;
/// A loop is sluggish if it takes this many times as long as its process, creeps if its damping is at least this, and the log
/// likelihood ratio must be below this to rule out ringing.
const SLUGGISH: f64 = 4.0;
const CREEPS: f64 = 0.8;
const NOT_RINGING: f64 = -2.0;
/// Log likelihood ratio from which the response to the set point alone shows that a loop rings.
const SURE: f64 = 5.0;
/// Largest period or time constant that a record can measure, as a share of its length.
const WITHIN: f64 = 0.2;
/// Damping of the linear loop below which its tuning contributes.
const TIGHT: f64 = 0.1;
/// Damping of the linear loop from which it does not ring.
const CALM: f64 = 0.15;
/// Spread of the set point over PV's from which its moves separate the process from disturbances.
const MOVED: f64 = 0.3;
/// Share of the variance from which a second line contributes.
const SECOND: f64 = 0.1;
/// Share of PV's variance that a process model may leave unexplained and still be believed.
const FITS: f64 = 0.2;

/// What a record lacks to name the cause of an oscillation, or to show a badly tuned loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum Missing {
    /// At least eight periods.
    Periods,
    /// A steady line of a disturbance, or a resonance of the loop, that stands out.
    LineOrMode,
    /// The set point.
    SetPoint,
    /// Moves of the set point.
    SetPointMoves,
}

impl Missing {
    /// The shortcoming of the record, without capital and full stop.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::Periods => "the window holds fewer than 8 periods",
            Self::LineOrMode => "neither a steady line nor a resonance stands out",
            Self::SetPoint => "the set point is not recorded",
            Self::SetPointMoves => "the set point does not move",
        }
    }
}

/// Lines and modes in a record that oscillates: of PV, or of the control error if the set point moves.
#[must_use]
pub(crate) fn ringing(record: &Record, oscillation: Option<&Oscillates>) -> Option<Ringing> {
    let period = oscillation?.period_points;
    let moves = |sp: &&Vec<f64>| sp.len() == record.len() && sp.windows(2).any(|w| w[0] != w[1]);
    match record.sp.as_ref().filter(moves) {
        Some(sp) => ringing::of(&sp.iter().zip(&record.pv).map(|(s, p)| s - p).collect::<Vec<_>>(), period),
        None => ringing::of(&record.pv, period),
    }
}

/// How PV follows a moving set point. Ringing with a period too long for the record is ignored.
#[must_use]
pub(crate) fn following(record: &Record, oscillation: Option<&Oscillates>) -> Option<Following> {
    let sp = record.sp.as_ref().filter(|sp| sp.len() == record.len())?;
    let within = |points: f64| points < WITHIN * record.len() as f64;
    let period = oscillation.map(|o| o.period_points).filter(|p| within(*p));
    let found = following::of(sp, &record.pv, period)?;
    Some(if within(found.period_points) { found } else { Following { rings: found.rings.min(0.0), ..found } })
}

/// Whether the response to the set point is that of a badly tuned loop: it creeps far more slowly than its process allows
/// (integrating processes excepted: averaging level control is slow on purpose), or it rings, but damped, without a sustained
/// oscillation.
#[must_use]
pub(crate) fn follows_badly(
    record: &Record,
    oscillation: Option<&Oscillates>,
    following: &Following,
    estimate: Option<&Estimate>,
) -> bool {
    let lag = following.lag_points;
    let process = estimate.filter(|e| !e.class.integrates() && lag < WITHIN * record.len() as f64);
    let is_slow = process.is_some_and(|e| {
        let time = e.time_constants_s.iter().sum::<f64>() + e.dead_time_s + 0.5 * record.ts_s;
        lag * record.point_s() > SLUGGISH * time
    });
    let creeps = following.damping >= CREEPS && following.rings < NOT_RINGING;
    (creeps && is_slow) || (!oscillation.is_some_and(|o| o.oscillating) && following.rings > SURE)
}

/// The verdict for a loop whose valve does not stick, and the contributing causes. `damping` is that of the linear loop, if the
/// record shows it.
#[must_use]
pub(crate) fn cause(
    oscillation: Option<&Oscillates>,
    ringing: Option<&Ringing>,
    damping: Option<f64>,
) -> (Verdict, Vec<Verdict>) {
    if !oscillation.is_some_and(|o| o.oscillating) {
        return (Verdict::NotOscillating, Vec::new());
    }
    let verdict = ringing.map_or(Verdict::CauseUnknown, |r| by_ringing(r, damping.is_some_and(|d| d > CALM)));
    let beside = match verdict {
        Verdict::Tuning => second_line(ringing),
        _ => None,
    };
    (verdict, beside.into_iter().collect())
}

/// Data that would help to name the cause of an oscillation, or of a slow response of a loop that does not oscillate.
#[must_use]
pub(crate) fn missing(record: &Record, verdict: Verdict, ringing: Option<&Ringing>) -> Vec<Missing> {
    let is_long = ringing.is_some_and(|r| r.long_enough);
    let spectrum = match verdict {
        Verdict::CauseUnknown if is_long => Some(Missing::LineOrMode),
        Verdict::CauseUnknown => Some(Missing::Periods),
        Verdict::NotOscillating => None,
        _ => return Vec::new(),
    };
    let set_point = match &record.sp {
        None => Some(Missing::SetPoint),
        Some(sp) => (stats::span(sp) <= 0.0).then_some(Missing::SetPointMoves),
    };
    spectrum.into_iter().chain(set_point).collect()
}

fn by_ringing(r: &Ringing, calm: bool) -> Verdict {
    let lines = r.forced + r.second.map_or(0.0, |s| s.share);
    let height = r.mode.filter(|m| !calm && m.damping < RINGS && 1.0 - lines > LEFT).map_or(0.0, |m| m.height);
    let steady = r.long_enough && r.unsteadiness < STEADY;
    match steady || lines > DRIVEN {
        true if height >= TOWERS && !steady => Verdict::Tuning,
        true => Verdict::Disturbance,
        false if height >= STANDS_OUT => Verdict::Tuning,
        // Over few periods lines absorb random variation, too.
        false if lines > HALF && r.long_enough => Verdict::Disturbance,
        false => Verdict::CauseUnknown,
    }
}

/// Damping of the linear loop of fitted process and identified controller, if the set point moves: otherwise the fit of a loop
/// without friction is biased towards the stability limit (see [`ringing`]).
#[must_use]
pub(crate) fn moved_damping(estimate: Option<&Estimate>, controller: Option<&Reading>, record: &Record) -> Option<f64> {
    let spread = record.sp.as_deref().map_or(0.0, stats::std_dev);
    let moved = spread > MOVED * stats::std_dev(&record.pv);
    linear_damping(estimate.filter(|_| moved)?, controller?, record)
}

/// Contributing causes where the valve sticks: a loop that would hardly settle with a healthy valve either, and an oscillation
/// of another frequency.
#[must_use]
pub(crate) fn beside_sticking(
    estimate: &Estimate,
    controller: Option<&Reading>,
    record: &Record,
    ringing: Option<&Ringing>,
) -> Vec<Verdict> {
    // If j is not identified separately, gain and kinetic band can compensate each other.
    let known = 5.0 * estimate.j_error < 0.33 * estimate.s;
    let damping = controller.filter(|_| known).and_then(|c| linear_damping(estimate, c, record));
    let tuning = damping.filter(|zeta| *zeta < TIGHT).map(|_| Verdict::Tuning);
    tuning.into_iter().chain(second_line(ringing)).collect()
}

fn linear_damping(estimate: &Estimate, controller: &Reading, record: &Record) -> Option<f64> {
    if estimate.mse > FITS * stats::variance(&record.pv) {
        return None;
    }
    let time = |place: usize| estimate.time_constants_s.get(place).copied().unwrap_or(0.0);
    let closed = LinearLoop {
        gain: estimate.gain * controller.kc,
        times_s: [time(0), time(1)],
        integrating: estimate.class.integrates(),
        // The zero-order hold of the output adds half a sample.
        dead_time_s: estimate.dead_time_s + 0.5 * record.ts_s,
        ti_s: controller.ti_s,
        td_s: controller.td_s,
    };
    closed.damping()
}

fn second_line(ringing: Option<&Ringing>) -> Option<Verdict> {
    ringing?.second.filter(|s| s.share > SECOND).map(|_| Verdict::Disturbance)
}

/// A controller and a process in closed loop.
#[derive(Debug, Clone, Copy, PartialEq)]
struct LinearLoop {
    /// Controller gain times process gain (per second if the process integrates).
    gain: f64,
    /// Time constants, s; 0 for none.
    times_s: [f64; 2],
    integrating: bool,
    dead_time_s: f64,
    ti_s: f64,
    td_s: f64,
}

impl LinearLoop {
    /// The open loop L and its logarithmic derivative at `s`, 1/s.
    fn open(&self, s: Complex<f64>) -> (Complex<f64>, Complex<f64>) {
        let one = Complex::new(1.0, 0.0);
        let integral = if self.ti_s.is_finite() { one / (s * self.ti_s) } else { Complex::new(0.0, 0.0) };
        let controller = one + integral + s * self.td_s;
        let mut log_slope = (Complex::new(self.td_s, 0.0) - integral / s) / controller - self.dead_time_s;
        let decay = libm::exp(-s.re * self.dead_time_s);
        let angle = -s.im * self.dead_time_s;
        let mut value = controller * Complex::new(libm::cos(angle), libm::sin(angle)) * (decay * self.gain);
        for t in self.times_s {
            let factor = one + s * t;
            value /= factor;
            log_slope -= Complex::new(t, 0.0) / factor;
        }
        if self.integrating {
            value /= s;
            log_slope -= one / s;
        }
        (value, log_slope)
    }

    /// Damping of the mode nearest to the stability limit, negative beyond it: Newton's method on 1 + L(s) = 0 from the
    /// frequency at which L comes closest to -1. `None` if it finds no oscillating mode.
    fn damping(&self) -> Option<f64> {
        let slowest = self.times_s[0].max(self.ti_s.min(1e9)).max(self.dead_time_s);
        let (from, to) = (0.05 / slowest, 2.0 * PI / self.dead_time_s.max(0.02 * slowest));
        let place = |k: i32| from * libm::pow(to / from, f64::from(k) / 400.0);
        let distance = |w: f64| (self.open(Complex::new(0.0, w)).0 + 1.0).norm_sqr();
        let nearest = (0..=400).map(|k| (distance(place(k)), place(k))).min_by(|a, b| a.0.total_cmp(&b.0))?.1;
        let mut s = Complex::new(0.0, nearest);
        for _ in 0..50 {
            let (value, log_slope) = self.open(s);
            let step = (value + 1.0) / (value * log_slope);
            // A step is at most half the distance to the origin.
            let shrink = (0.5 * s.norm_sqr().sqrt() / step.norm_sqr().sqrt()).min(1.0);
            if !(step.re.is_finite() && step.im.is_finite()) {
                return None;
            }
            s -= step * shrink;
        }
        let rest = (self.open(s).0 + 1.0).norm_sqr();
        (rest < 1e-12 && s.im.abs() > 1e-3 * nearest).then(|| -s.re / s.norm_sqr().sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::detect::ringing::{Line, Mode};

    const WAVE: Oscillates = Oscillates {
        period_points: 50.0,
        periods: 20.0,
        regularity: 5.0,
        persistence: 0.9,
        endurance: Some(0.9),
        oscillating: true,
    };

    fn of(forced: f64, second: f64, height: f64) -> (Verdict, Vec<Verdict>) {
        let second = (second > 0.0).then_some(Line { period_points: 37.0, share: second });
        let mode = Some(Mode { damping: 0.05, period_points: 50.0, height });
        cause(
            Some(&WAVE),
            Some(&Ringing { period_points: 50.0, forced, second, unsteadiness: 0.3, long_enough: true, mode }),
            None,
        )
    }

    #[test]
    fn lines_are_from_outside_and_modes_the_loops_own() {
        assert_eq!(of(0.95, 0.0, 2.0), (Verdict::Disturbance, vec![]));
        assert_eq!(of(0.6, 0.3, 2.0), (Verdict::Disturbance, vec![]));
        assert_eq!(of(0.9, 0.0, 30.0), (Verdict::Tuning, vec![]));
        assert_eq!(of(0.4, 0.15, 30.0), (Verdict::Tuning, vec![Verdict::Disturbance]));
        assert_eq!(of(0.3, 0.0, 1.0), (Verdict::CauseUnknown, vec![]));
        let mode = Some(Mode { damping: 0.05, period_points: 50.0, height: 30.0 });
        let cycle =
            Ringing { period_points: 50.0, forced: 0.6, second: None, unsteadiness: 0.05, long_enough: true, mode };
        assert_eq!(cause(Some(&WAVE), Some(&cycle), None).0, Verdict::Disturbance);
        let rung = Ringing { unsteadiness: 0.4, ..cycle };
        assert_eq!(cause(Some(&WAVE), Some(&rung), None).0, Verdict::Tuning);
        assert_eq!(cause(Some(&WAVE), Some(&rung), Some(0.4)).0, Verdict::Disturbance);
        assert_eq!(cause(Some(&WAVE), None, None).0, Verdict::CauseUnknown);
        assert_eq!(cause(Some(&Oscillates { oscillating: false, ..WAVE }), None, None).0, Verdict::NotOscillating);
        assert_eq!(cause(None, None, None).0, Verdict::NotOscillating);
    }

    #[test]
    fn what_is_missing_is_what_the_record_lacks() {
        let mut record = Record::uniform(1.0, vec![0.0; 4], vec![0.0; 4]);
        let short = Ringing {
            period_points: 50.0,
            forced: 0.5,
            second: None,
            unsteadiness: 0.3,
            long_enough: false,
            mode: None,
        };
        let of = |record: &Record, verdict, ringing| missing(record, verdict, ringing);
        assert_eq!(of(&record, Verdict::CauseUnknown, Some(&short)), [Missing::Periods, Missing::SetPoint]);
        assert_eq!(of(&record, Verdict::NotOscillating, None), [Missing::SetPoint]);
        record.sp = Some(vec![5.0; 4]);
        let long = Ringing { long_enough: true, ..short };
        assert_eq!(of(&record, Verdict::CauseUnknown, Some(&long)), [Missing::LineOrMode, Missing::SetPointMoves]);
        record.sp = Some(vec![5.0, 5.0, 6.0, 6.0]);
        assert_eq!(of(&record, Verdict::CauseUnknown, Some(&long)), [Missing::LineOrMode]);
        assert_eq!(of(&record, Verdict::Tuning, Some(&short)), []);
    }

    /// PI with the time constant as integral time, so that the loop is `gain exp(-d s) / (T s)`.
    fn lambda(gain: f64) -> LinearLoop {
        LinearLoop { gain, times_s: [20.0, 0.0], integrating: false, dead_time_s: 5.0, ti_s: 20.0, td_s: 0.0 }
    }

    #[test]
    fn the_linear_loop_knows_its_limit() {
        // gain exp(-5 s) / (20 s): at the limit w = pi / 10 and gain = 20 w.
        let ultimate = 2.0 * PI;
        assert!(lambda(ultimate).damping().unwrap().abs() < 1e-9);
        let zeta = |share: f64| lambda(share * ultimate).damping().unwrap();
        assert!(zeta(1.05) < 0.0 && zeta(0.9) > 0.0 && zeta(0.9) < 0.1 && zeta(0.5) > 0.2, "{}", zeta(0.9));
        // Without dead time: s^2 T Ti + s Ti (1 + K) + K = 0.
        let second = LinearLoop { dead_time_s: 0.0, ti_s: 2.0, ..lambda(3.0) };
        let want = 2.0 * 4.0 / (2.0 * (20.0_f64 * 2.0 * 3.0).sqrt());
        assert!((second.damping().unwrap() - want).abs() < 1e-9);
        // An integrator under PI: s^2 Ti + K Ti s + K = 0.
        let level =
            LinearLoop { gain: 0.01, times_s: [0.0; 2], integrating: true, dead_time_s: 0.0, ti_s: 30.0, td_s: 0.0 };
        let want = 0.01 * 30.0 / (2.0 * (30.0_f64 * 0.01).sqrt());
        assert!((level.damping().unwrap() - want).abs() < 1e-9);
    }
}
