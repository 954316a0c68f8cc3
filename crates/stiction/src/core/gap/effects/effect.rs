//! What an effect is: where it acts, its parameters and bounds, how it enters the simulator, and what is said of it.

use super::clues::Clues;
use crate::core::gap::candidate::{Candidate, Parameters};
use crate::core::gap::in_loop::{NoPlace, Parts, Stated};
use crate::core::gap::plan::Plan;
use crate::core::gap::problem::Problem;
use crate::core::gap::sizes::Sizes;
use crate::core::gap::traces::Traces;
use crate::core::gap::types::{EffectId, Parameter, Stage};
use crate::core::ident::least_squares::Gram;

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
    /// By a lag of PV that its noise shares.
    Filter,
    /// Against other loops' records, where these are given.
    Neighbour,
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
    /// The same; told by the effect's own function, since the lag belongs to it.
    OwnInstant,
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

/// What the rest of a parameter vector gives way by when a parameter has changed: the vector after the change, the
/// parameter's place in it, the change, and how fast OP usually moves (spans a point).
pub(crate) type Trade = fn(&mut Parameters, usize, f64, f64);

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
    /// What a model trades it for.
    pub trade: Trade,
}

/// For a parameter that the model trades for nothing.
pub(super) fn kept(_theta: &mut Parameters, _at: usize, _by: f64, _op_rate: f64) {}

/// For a lag by its logarithm: the dead time gives way.
pub(super) fn for_dead_time(theta: &mut Parameters, at: usize, by: f64, _op_rate: f64) {
    theta.lag -= libm::exp(theta.p[at]) - libm::exp(theta.p[at] - by);
}

impl Param {
    /// Bounds in the units of the search, low below high.
    #[must_use]
    pub(crate) fn bounds(&self, problem: &Problem) -> [f64; 2] {
        let [low, high] = (self.limits)(problem);
        [low, high.max(low + 1e-9)]
    }

    /// The value in recorded units, with their name.
    #[must_use]
    pub(crate) fn recorded(&self, value: f64, problem: &Problem) -> Option<Parameter> {
        let (value, unit) = match self.unit {
            Unit::One => (value, "1"),
            Unit::LogTime => (libm::exp(value) * problem.point_s, "s"),
            Unit::Time | Unit::Instant => (value * problem.point_s, "s"),
            Unit::Op => (value * problem.normalised.span, "OP"),
            Unit::LogRate => (libm::exp(value) * problem.normalised.span / problem.point_s, "OP/s"),
            Unit::Period => (2.0 * core::f64::consts::PI / value.max(1e-9) * problem.point_s, "s"),
            Unit::Choice => (if value > 0.5 { 1.0 } else { 0.0 }, "1"),
            Unit::PerOp => (value / problem.normalised.span, "1/OP"),
            Unit::StemEnd | Unit::OwnInstant => return None,
        };
        Some(Parameter { name: self.name, value, unit })
    }

    /// The inverse of [`Param::recorded`].
    #[must_use]
    pub(crate) fn normalised(&self, value: f64, problem: &Problem) -> f64 {
        match self.unit {
            Unit::One | Unit::Choice => value,
            Unit::LogTime => libm::log((value / problem.point_s).max(1e-9)),
            Unit::Time | Unit::Instant | Unit::OwnInstant => value / problem.point_s,
            Unit::Op => value / problem.normalised.span,
            Unit::LogRate => libm::log((value * problem.point_s / problem.normalised.span).max(1e-12)),
            Unit::PerOp => value * problem.normalised.span,
            Unit::StemEnd => (value - problem.op_middle) / problem.normalised.span,
            Unit::Period => 2.0 * core::f64::consts::PI * problem.point_s / value.max(1e-9),
        }
    }
}

/// The residual of a fit at fitted points.
#[derive(Debug, Clone, PartialEq)]
pub struct Rest {
    /// Point of the record and what is left there, noise floors.
    pub points: Vec<(f64, f64)>,
}

impl Rest {
    /// Half of the squared error that a wave of a frequency (radians a point) takes beside a constant: 1 on average where
    /// white noise of one floor is left (two coefficients).
    #[must_use]
    pub(crate) fn power_at(&self, omega: f64) -> f64 {
        let column = |of: fn(f64) -> f64| self.points.iter().map(move |(k, _)| of(omega * k)).collect::<Vec<f64>>();
        let left: Vec<f64> = self.points.iter().map(|(_, left)| *left).collect();
        let columns = [vec![1.0; left.len()], column(libm::cos), column(libm::sin), left];
        let mut gram = Gram::of(&columns.each_ref().map(Vec::as_slice));
        let mut with = gram.clone();
        gram.eliminate(1);
        with.eliminate(3);
        0.5 * (gram.at(3, 3) - with.at(3, 3)).max(0.0)
    }
}

/// Parameter values at which a search begins; an effect has up to three.
pub type Start = [f64; 3];

/// One effect that the base leaves out: all that is known of it stands in its file.
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
    /// Puts it into the model structure.
    pub apply: fn(&[f64], &mut Plan),
    /// Parameter values at which a search begins.
    pub starts: fn(&Clues<'_>) -> Vec<Start>,
    /// What the linear coefficients and fd say in recorded units, of an effect with these parameters.
    pub linear: fn(&[f64], &Plan, &Candidate, &Problem) -> Vec<Parameter>,
    /// Makes parameters read from a model those of the search, where fd or the lag belongs to them.
    pub from_model: fn(&mut [f64], &Parameters),
    /// Its part in a closed loop's simulation.
    pub in_loop: fn(&Stated<'_>, &mut Parts) -> Result<(), NoPlace>,
    /// What its recorder does to a prediction, where a free run can follow it.
    pub recorder: Option<fn(&Traces, &mut [f64])>,
    /// Whether a fitted model is what the effect's name says, and not only of its form.
    pub is_meant: fn(&Plan, &Candidate) -> bool,
    /// Whether what its fit leaves of PV bears its name out; it is asked with its plan and the points of [`Rest`].
    pub leaves_noise: fn(&Plan, &Rest) -> bool,
    /// An effect with the same parameters that it holds as a special case, whose places it tries as they are.
    pub holds: Option<EffectId>,
    /// Training log mean squared error by which it must beat the base: more for what bends to anything.
    pub margin: f64,
    /// Whether free run can predict it.
    pub predictable: bool,
    /// Whether it acts behind a stem whose position is recorded, or may.
    pub behind_stem: bool,
    /// Whether it is whole without its numbers in a model that is given.
    pub bare: bool,
    /// Whether it changes friction, so that a base without knows nothing of it.
    pub needs_friction: bool,
    /// Whether it bends to nearly anything.
    pub bends: bool,
    /// Whether it acts at one time of the record: forward in time says nothing about it.
    pub local: bool,
    /// Whether samples that show it are left out of every fit.
    pub masks: bool,
    /// Effects that it cannot stand beside: one would undo the other.
    pub clashes: &'static [EffectId],
    /// What it is called among others.
    pub noun: &'static str,
    /// What no record of OP and PV can tell from it, by its plant name.
    pub twin: Option<&'static str>,
    /// It with its sizes in words; `None` where they are listed.
    pub phrase: fn(&Sizes<'_>) -> Option<String>,
    /// Effects that look alike on OP and PV.
    pub confused_with: &'static [EffectId],
    /// The measurement that would tell.
    pub separated_by: &'static str,
}

impl Effect {
    /// Its id in documents: that of another loop's load has the loop's name.
    #[must_use]
    pub(crate) fn id_in(&self, problem: &Problem) -> String {
        match &problem.neighbour {
            Some(load) if self.way == Way::Neighbour => self.id_of(&load.name),
            _ => self.id.to_owned(),
        }
    }

    /// Its id with the name of a loop.
    #[must_use]
    pub(crate) fn id_of(&self, name: &str) -> String {
        format!("{}({name})", self.id)
    }

    /// One that is simulated, bound to the valve signal and without parameters.
    pub(super) const fn simulated(id: EffectId, stage: Stage) -> Self {
        Self {
            id,
            stage,
            way: Way::Simulated,
            params: &[],
            apply: outside,
            starts: once,
            linear: nothing,
            from_model: as_it_is,
            in_loop: inside,
            recorder: None,
            is_meant: |_, _| true,
            leaves_noise: |_, _| true,
            holds: None,
            margin: MARGIN,
            predictable: true,
            behind_stem: !matches!(stage, Stage::Valve),
            bare: false,
            needs_friction: false,
            bends: false,
            local: false,
            masks: false,
            clashes: &[],
            noun: "",
            twin: None,
            phrase: listed,
            confused_with: &[],
            separated_by: "",
        }
    }

    /// One that no search fits: it is seen in the recording.
    pub(super) const fn unsimulated(id: EffectId, stage: Stage, way: Way) -> Self {
        Self { way, ..Self::simulated(id, stage) }
    }
}

/// Margin of an effect that is bound to the valve signal.
pub(crate) const MARGIN: f64 = 0.10;
/// Margin of one that is not, or that bends further.
pub(crate) const WIDE_MARGIN: f64 = 0.15;

/// A lag of up to `MOST` raw samples that acts where `reach` says.
pub(super) const fn lag<const MOST: u32>(reach: Reach) -> Param {
    Param { name: "lag", unit: Unit::LogTime, reach, limits: lag_limits::<MOST>, trade: for_dead_time }
}

fn lag_limits<const MOST: u32>(problem: &Problem) -> [f64; 2] {
    [0.3, f64::from(MOST)].map(|samples| libm::log(samples / problem.box_samples))
}

/// Lags of these shares of a period.
pub(super) fn lags(clues: &Clues<'_>, shares: &[f64]) -> Vec<Start> {
    shares.iter().map(|t| [libm::log(t * clues.problem.period), 0.0, 0.0]).collect()
}

/// For effects without nonlinear parameters: one start.
pub(super) fn once(_clues: &Clues<'_>) -> Vec<Start> {
    vec![[0.0; 3]]
}

/// For effects without linear coefficients of their own.
pub(super) fn nothing(_p: &[f64], _plan: &Plan, _of: &Candidate, _scene: &Problem) -> Vec<Parameter> {
    Vec::new()
}

/// For effects that are not simulated.
pub(super) fn outside(_p: &[f64], _plan: &mut Plan) {}

/// For parameters that a model states as the search has them.
pub(super) fn as_it_is(_p: &mut [f64], _theta: &Parameters) {}

/// For effects that have no part in a closed loop's simulation.
pub(super) fn inside(stated: &Stated<'_>, _parts: &mut Parts) -> Result<(), NoPlace> {
    Err(NoPlace::Inside(stated.id().to_owned()))
}

/// For effects that law, process and time constants of a model say already.
pub(super) fn said_already(_stated: &Stated<'_>, _parts: &mut Parts) -> Result<(), NoPlace> {
    Ok(())
}

/// For effects whose sizes are listed.
pub(super) fn listed(_sizes: &Sizes<'_>) -> Option<String> {
    None
}

/// Which way a change goes.
pub(super) const fn grows(change: f64) -> &'static str {
    if change > 0.0 { "grows" } else { "shrinks" }
}
