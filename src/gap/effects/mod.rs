//! The catalogue: one file an effect, with where it acts, its parameters and bounds, how it enters the simulator, where
//! to begin looking, what it is confused with and which measurement would tell.

mod asymmetric_stiction;
mod backlash;
mod clipping;
mod clues;
mod coloured_noise;
mod dead_time_change;
mod extra_lag;
mod frozen_sensor;
mod gain_drift;
mod hold_compression;
mod integrating;
mod inverse_response;
mod outliers;
mod positioner_lag;
mod quantisation;
mod ramp;
mod rate_limit;
mod sinusoid;
mod sliding_valve;
mod slip_overshoot;
mod static_nonlinearity;
mod step_load;
mod stiction;
mod swinging_door;
mod time_skew;
mod travel_limit;

pub use clues::Clues;
pub use travel_limit::above_stop;

use super::evaluator::Candidate;
use super::problem::Problem;
use super::structure::Plan;
use super::types::{EffectId, Parameter, Stage};

/// How an effect is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Way {
    /// It is simulated and fitted.
    Simulated,
    /// Only against the base without friction.
    AgainstLinear,
    /// By a noise model of the residual.
    Noise,
    /// By its trace in PV.
    Signature,
    /// By the controller's lag.
    Controller,
}

/// Which part of the simulator a parameter moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reach {
    /// What the friction sees.
    Path,
    /// What follows the stem.
    Stem,
    /// The process and what is added to PV.
    Process,
    /// The second time constant, a logarithm.
    SecondLag,
    /// The cost jumps along it: random steps only.
    Jumps,
}

/// What a parameter is measured in, and so how it is given in recorded units.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// A number.
    One,
    /// Points to seconds, from its logarithm.
    LogTime,
    /// Points to seconds.
    Time,
    /// Point of the record to seconds from its start.
    Instant,
    /// Spans to OP units.
    Op,
    /// Spans a point to OP units a second, from its logarithm.
    LogRate,
    /// Radians a point to a period in seconds.
    Period,
    /// Yes (1) or no (0).
    Choice,
    /// Per span to per OP unit.
    PerOp,
    /// Spans from OP's middle to an OP value; told by the effect's own function, since fd belongs to it.
    StemEnd,
}

/// One nonlinear parameter.
#[derive(Debug)]
pub struct Param {
    /// Name in documents.
    pub name: &'static str,
    /// Unit.
    pub unit: Unit,
    /// What it moves.
    pub reach: Reach,
    /// Bounds in the units of the search.
    pub limits: fn(&Problem) -> [f64; 2],
}

impl Param {
    /// Bounds in the units of the search, low below high.
    #[must_use]
    pub fn bounds(&self, problem: &Problem) -> [f64; 2] {
        let [low, high] = (self.limits)(problem);
        [low, high.max(low + 1e-9)]
    }

    /// The value in recorded units, with their name.
    #[must_use]
    pub fn recorded(&self, value: f64, problem: &Problem) -> Option<Parameter> {
        let (value, unit) = match self.unit {
            Unit::One => (value, "1"),
            Unit::LogTime => (libm::exp(value) * problem.point_s, "s"),
            Unit::Time | Unit::Instant => (value * problem.point_s, "s"),
            Unit::Op => (value * problem.span, "OP"),
            Unit::LogRate => (libm::exp(value) * problem.span / problem.point_s, "OP/s"),
            Unit::Period => (2.0 * core::f64::consts::PI / value.max(1e-9) * problem.point_s, "s"),
            Unit::Choice => (if value > 0.5 { 1.0 } else { 0.0 }, "1"),
            Unit::PerOp => (value / problem.span, "1/OP"),
            Unit::StemEnd => return None,
        };
        Some(Parameter { name: self.name, value, unit })
    }

    /// The inverse of [`Param::recorded`].
    #[must_use]
    pub fn posed(&self, value: f64, problem: &Problem) -> f64 {
        match self.unit {
            Unit::One | Unit::Choice => value,
            Unit::LogTime => libm::log((value / problem.point_s).max(1e-9)),
            Unit::Time | Unit::Instant => value / problem.point_s,
            Unit::Op => value / problem.span,
            Unit::LogRate => libm::log((value * problem.point_s / problem.span).max(1e-12)),
            Unit::PerOp => value * problem.span,
            Unit::StemEnd => (value - problem.op_middle) / problem.span,
            Unit::Period => 2.0 * core::f64::consts::PI * problem.point_s / value.max(1e-9),
        }
    }
}

/// Parameter values at which a search begins; an effect has up to three.
pub type Start = [f64; 3];

/// One effect that the base leaves out.
#[derive(Debug)]
pub struct Effect {
    /// Id in documents.
    pub id: EffectId,
    /// Where it acts.
    pub stage: Stage,
    /// How it is found.
    pub way: Way,
    /// Its nonlinear parameters.
    pub params: &'static [Param],
    /// Puts it into the simulator.
    pub enter: fn(&[f64], &mut Plan),
    /// Parameter values at which a search begins.
    pub starts: fn(&Clues<'_>) -> Vec<Start>,
    /// What the linear coefficients and fd say in recorded units, of an effect with these parameters.
    pub linear: fn(&[f64], &Plan, &Candidate, &Problem) -> Vec<Parameter>,
    /// Training log mean squared error by which it must beat the base: more for what bends to anything.
    pub margin: f64,
    /// Whether free run can predict it.
    pub predictable: bool,
    /// Effects that look alike on OP and PV.
    pub confused_with: &'static [EffectId],
    /// The measurement that would tell.
    pub separated_by: &'static str,
}

impl Effect {
    /// Whether it acts behind a stem whose position is recorded.
    #[must_use]
    pub fn is_behind_stem(&self) -> bool {
        self.stage != Stage::Valve || BEHIND_STEM.contains(&self.id)
    }

    /// An effect that no search fits: it is seen in the recording.
    const fn unsimulated(id: EffectId, way: Way) -> Self {
        Self {
            id,
            stage: Stage::Measurement,
            way,
            params: &[],
            enter: outside,
            starts: once,
            linear: nothing,
            margin: MARGIN,
            predictable: true,
            confused_with: &[],
            separated_by: "",
        }
    }
}

/// Margin of an effect that is bound to the valve signal.
pub const MARGIN: f64 = 0.10;
/// Margin of one that is not, or that bends further.
pub const WIDE_MARGIN: f64 = 0.15;

/// Effects of the valve that a recorded stem position does not show, or not always.
const BEHIND_STEM: [EffectId; 3] = ["backlash", "travel_limit", "rate_limit"];

/// Every effect.
pub const ALL: [&Effect; 25] = [
    &asymmetric_stiction::EFFECT,
    &slip_overshoot::EFFECT,
    &sliding_valve::EFFECT,
    &backlash::EFFECT,
    &travel_limit::EFFECT,
    &rate_limit::EFFECT,
    &positioner_lag::EFFECT,
    &extra_lag::EFFECT,
    &static_nonlinearity::EFFECT,
    &inverse_response::EFFECT,
    &integrating::EFFECT,
    &gain_drift::EFFECT,
    &dead_time_change::EFFECT,
    &sinusoid::EFFECT,
    &ramp::EFFECT,
    &step_load::EFFECT,
    &coloured_noise::EFFECT,
    &quantisation::EFFECT,
    &hold_compression::EFFECT,
    &swinging_door::EFFECT,
    &clipping::EFFECT,
    &outliers::EFFECT,
    &frozen_sensor::EFFECT,
    &time_skew::EFFECT,
    &stiction::EFFECT,
];

/// The effect of an id.
#[must_use]
pub fn by_id(id: &str) -> Option<&'static Effect> {
    ALL.into_iter().find(|e| e.id == id)
}

/// A lag of up to `MOST` raw samples that acts where `reach` says.
const fn lag<const MOST: u32>(reach: Reach) -> Param {
    Param { name: "lag", unit: Unit::LogTime, reach, limits: lag_limits::<MOST> }
}

fn lag_limits<const MOST: u32>(problem: &Problem) -> [f64; 2] {
    [0.3, f64::from(MOST)].map(|samples| libm::log(samples / problem.box_samples))
}

/// Lags of these shares of a period.
fn lags(clues: &Clues<'_>, shares: &[f64]) -> Vec<Start> {
    shares.iter().map(|t| [libm::log(t * clues.problem.period), 0.0, 0.0]).collect()
}

/// For effects without nonlinear parameters: one start.
fn once(_clues: &Clues<'_>) -> Vec<Start> {
    vec![[0.0; 3]]
}

/// For effects without linear coefficients of their own.
fn nothing(_p: &[f64], _plan: &Plan, _of: &Candidate, _scene: &Problem) -> Vec<Parameter> {
    Vec::new()
}

/// For effects that do not enter the simulator.
fn outside(_p: &[f64], _plan: &mut Plan) {}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::structure::MAX_PARAMS;

    #[test]
    fn ids_are_unique_and_what_is_confused_exists() {
        for (i, effect) in ALL.iter().enumerate() {
            assert!(ALL[i + 1..].iter().all(|e| e.id != effect.id), "{} twice", effect.id);
            assert_eq!(by_id(effect.id).map(|e| e.id), Some(effect.id));
            for other in effect.confused_with {
                assert!(by_id(other).is_some_and(|o| o.id != effect.id), "{}: {other}", effect.id);
            }
            assert!(!effect.separated_by.is_empty() && 2 * effect.params.len() <= MAX_PARAMS);
        }
        assert!(by_id("none").is_none());
    }
}
