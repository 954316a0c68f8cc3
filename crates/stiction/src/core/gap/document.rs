//! The published diagnosis, `stictiond.gap.v1`.

use serde::{Deserialize, Serialize};

use super::agree;
use super::budget::document::{BudgetNote, CANNOT_BE_TOLD, NOT_IN_CATALOGUE, TOLD, TellableNote};
use super::budget::{self, Budget};
use super::effects;
use super::enough::EnoughNote;
use super::judged::Diagnosis;
use super::locate::{Location, Subject, locate};
use super::loop_run::{self, Cycles};
use super::model::Model;
use super::pool::WindowNote;
use super::set_point::{self, Move};
use super::sizes::share_left;
pub use super::types::EffectNote;
use super::types::{
    Alternative, Base, Cause, Compared, Fit, Forward, FromSp, GapOptions, NONE, NextTest, SearchNote, Stage, UNKNOWN,
};
use super::valve_note::ValveNote;
use crate::core::record::Record;
use crate::core::signal::stats;
use crate::core::units::Moment;
use crate::core::verdict::Assessment;

/// Schema name of a diagnosis.
pub const GAP_SCHEMA: &str = "stictiond.gap.v1";

/// Time range of the diagnosis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Window {
    /// Timestamp of the first sample, ns since 1970.
    pub start_ns: i64,
    /// Timestamp of the last sample, ns since 1970.
    pub end_ns: i64,
    /// The start, RFC 3339.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub start: Moment,
    /// The end, RFC 3339.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub end: Moment,
    /// Raw samples.
    pub samples: u64,
    /// Mean sampling time, s.
    pub ts_s: f64,
    /// Raw samples per point of the simulation (1: raw).
    pub box_samples: u64,
}

/// Base model of the gap.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BaseNote {
    /// `refit` (He's model, first order, fitted here), `linear` (no friction) or `given` (a given model, in addition to the
    /// refitted base).
    pub source: String,
    /// Valve model of the refitted base: `he` or `none`.
    pub valve_model: String,
    /// Its order.
    pub order: u8,
    /// Whether it is integrating.
    pub integrating: bool,
    /// The refitted base, which can be simulated.
    pub model: Model,
}

/// A gap on held-out data, free run, PV units.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Figures {
    /// Root mean squared error.
    pub rmse: f64,
    /// Noise floor; for held or compressed PV from the stored values, `None` if they are too few.
    pub noise_floor: Option<f64>,
    /// Part above the floor: `sqrt(max(rmse^2 - noise_floor^2, 0))`; the full error without a floor.
    pub gap: f64,
    /// Gap relative to PV's standard deviation.
    pub relative: Option<f64>,
}

/// The answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CauseNote {
    /// An effect's id, two joined by `+`, `none` or `unknown`.
    pub id: String,
    /// Probability that the answer is right.
    pub probability: f64,
    /// Whether it also closes the gap on held-out data and in forward prediction; false means "suspected", as always where the
    /// base leaves more of held-out PV than PV's mean does.
    pub confirmed: bool,
    /// Why it is `unknown`: `not_in_catalogue`, or `cannot_be_told` where the record holds too little or the base leaves more of
    /// PV than PV's mean does. That is also said of a suspected effect of the plant and of a cause that closes next to nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
}

impl CauseNote {
    /// The answer of a diagnosis, and why it is no better by what the record can tell.
    fn of(diagnosis: &Diagnosis, told: Option<&TellableNote>) -> Self {
        let Cause { id, probability, confirmed, .. } = &diagnosis.cause;
        let note = Self { id: id.clone(), probability: *probability, confirmed: *confirmed, why: None };
        let leads = diagnosis.named().is_none_or(EffectNote::leads);
        let is_judged = !diagnosis.is_worse_than_mean();
        let why = told.and_then(|told| note.why_by(told, leads, is_judged)).map(str::to_owned);
        Self { why, ..note }
    }

    /// What keeps the answer from being sure, where the record tells it. `leads` is false for a cause that closes next to nothing,
    /// `is_judged` is false where the base is worse than PV's mean.
    pub(crate) fn why_by(&self, told: &TellableNote, leads: bool, is_judged: bool) -> Option<&'static str> {
        let hardly = told.gain_nats < TOLD[0];
        // PV alone shows what a sensor or a recorder did to it.
        let acts_in_plant =
            || effects::parts(&self.id).all(|id| effects::by_id(id).is_some_and(|e| e.stage != Stage::Measurement));
        match self.id.as_str() {
            NONE => None,
            UNKNOWN if is_judged && !hardly => Some(NOT_IN_CATALOGUE),
            UNKNOWN => Some(CANNOT_BE_TOLD),
            _ if !is_judged => Some(CANNOT_BE_TOLD),
            _ => (hardly && (!leads || !self.confirmed && acts_in_plant())).then_some(CANNOT_BE_TOLD),
        }
    }
}

/// The model with the cause, as accepted by `simulate`, `analyze` and `gap --base`, with the terms of an estimate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ModelAfter {
    /// The model.
    #[serde(flatten)]
    pub model: Model,
    /// Static band, OP units; `None` without friction.
    pub fs: Option<f64>,
    /// Kinetic band, OP units; `None` without friction.
    pub fd: Option<f64>,
    /// fs + fd.
    pub s: Option<f64>,
    /// fs - fd.
    pub j: Option<f64>,
    /// `he`, `tracking` or `none`.
    pub valve_model: String,
}

/// The document.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct GapDocument {
    /// [`GAP_SCHEMA`].
    pub schema: String,
    /// The loop's name.
    #[serde(rename = "loop")]
    pub loop_name: String,
    /// Time range of the diagnosis.
    pub window: Window,
    /// What `analyze` says of the valve in the same record.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub valve: Option<ValveNote>,
    /// Base model.
    pub base: BaseNote,
    /// That the base is good enough; absent where it is not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub good_enough: Option<EnoughNote>,
    /// Gap of the refitted base.
    pub gap: Figures,
    /// Gap of the given model.
    pub given: Option<Figures>,
    /// Part of the given model's gap that refitting closes, PV units: given minus refitted.
    pub parametric: Option<f64>,
    /// Where the gap is.
    #[serde(rename = "where")]
    pub location: Location,
    /// All effects tried, best first.
    pub effects: Vec<EffectNote>,
    /// The answer.
    pub cause: CauseNote,
    /// A second cause: an effect in the plant beneath an artefact of the historian, or that artefact.
    #[serde(default)]
    pub second_cause: Option<Alternative>,
    /// Other possible answers, best first, without the cause.
    pub alternatives: Vec<Alternative>,
    /// Forward prediction.
    pub forward: Option<Forward>,
    /// The base with the cause and the second cause.
    pub model_after: ModelAfter,
    /// The experiment that distinguishes the likeliest answers.
    pub next_test: Option<NextTest>,
    /// Model responses computed.
    pub evaluations: u64,
    /// The search: responses used and allowed, and why it ended.
    pub search: SearchNote,
    /// Whether the search ended early.
    pub stopped_early: bool,
    /// Pairs of effects, best first; empty if one effect explains the record, unless requested.
    pub pairs: Vec<EffectNote>,
    /// The simulated closed loop, if the controller can be identified.
    pub closed_loop: Option<Cycles>,
    /// The closed loop from SP alone, over the part that was not fitted; none where SP hardly moves or no controller can be read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from_sp: Option<FromSp>,
    /// PV's variance, split under a noise model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<BudgetNote>,
    /// What the record can tell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tellable: Option<TellableNote>,
    /// The windows that were decided together, if there are several; all else but the answer is of the one that is `shown`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub pooled: Vec<WindowNote>,
    /// Comparison with other loops, if some were offered.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub neighbours: Option<Compared>,
    /// Version of the program.
    pub version: String,
}

impl GapDocument {
    /// Makes the document of a diagnosis of a record with these options, which says nothing of the valve by itself.
    #[must_use]
    pub fn new(loop_name: &str, record: &Record, options: &GapOptions, diagnosis: &Diagnosis) -> Self {
        Self::beside(loop_name, record, options, diagnosis, None)
    }

    /// The same beside what `analyze` makes of the record.
    #[must_use]
    pub fn beside(
        loop_name: &str,
        record: &Record,
        options: &GapOptions,
        diagnosis: &Diagnosis,
        assessment: Option<&Assessment>,
    ) -> Self {
        let valve = assessment.map(ValveNote::of);
        let [mut effects, pairs] = [&diagnosis.findings.effects, &diagnosis.findings.pairs]
            .map(|all| all.iter().map(|e| EffectNote { fit: None, ..e.clone() }).collect::<Vec<_>>());
        let closed_loop = loop_run::cycles(record, diagnosis);
        let budget = Budget::of(record, known(diagnosis));
        let explained = closed_loop.as_ref().map(|cycles| cycles.controller.r2);
        let tellable = budget.as_ref().map(|b| TellableNote::of(record, b, &diagnosis.findings.base.slips, explained));
        let mut cause = CauseNote::of(diagnosis, tellable.as_ref());
        let sp_moves = set_point::moves(record);
        let against = held_against(record, diagnosis, &effects, (valve.as_ref(), &sp_moves));
        let not_outside: Vec<[bool; 2]> =
            effects.iter().map(|e| [against.is_own_cycle(e), against.follows_set_point(e)]).collect();
        let doubted = effects.iter().zip(&not_outside).filter(|(_, why)| why.contains(&true));
        cause.confirmed &= !doubted.into_iter().any(|(e, _)| e.id == cause.id);
        let named = effects.iter().chain(&pairs).find(|e| e.id == cause.id);
        let named = named.map(|e| (&e.parameters, cause.confirmed));
        let mut budget = budget.map(|budget| BudgetNote::of(&budget, &diagnosis.findings.signatures, named));
        if let Some(budget) = &mut budget {
            against.settle(budget);
        }
        for (effect, why) in effects.iter_mut().zip(not_outside) {
            [effect.own_cycle, effect.follows_set_point] = why;
        }
        let deviation = stats::std_dev(&record.pv);
        let figures = |fit: &Fit| Figures::of(fit, diagnosis.findings.floor.noise_floor, deviation);
        let given = diagnosis.findings.given.as_ref().map(figures);
        let gap = figures(&diagnosis.findings.base);
        let floor = gap.noise_floor.map(|floor| floor / deviation);
        let good_enough = gap.relative.and_then(|left| EnoughNote::of(left, floor));
        // One guard for all tests of one valve.
        let may_test = valve.as_ref().is_none_or(|valve| valve.no_bump_test.is_none() && valve.position.is_none());
        Self {
            schema: GAP_SCHEMA.to_owned(),
            loop_name: loop_name.to_owned(),
            window: Window::of(record),
            base: BaseNote::of(&options.base, &diagnosis.findings.base),
            valve,
            good_enough,
            gap,
            given,
            parametric: given.map(|g| g.gap - diagnosis.findings.base.gap),
            location: locate(record, &Subject::of(diagnosis, options.period_points, options.seed)),
            effects,
            cause,
            second_cause: diagnosis.second.clone(),
            alternatives: diagnosis.alternatives.clone(),
            forward: diagnosis.runs.forward,
            model_after: ModelAfter::of(&diagnosis.model_after),
            next_test: diagnosis.runs.next_test.clone().filter(|_| may_test),
            evaluations: diagnosis.search.evaluations,
            search: diagnosis.search,
            stopped_early: diagnosis.stopped_early,
            pairs,
            closed_loop,
            from_sp: diagnosis.runs.from_sp,
            budget,
            tellable,
            pooled: Vec::new(),
            neighbours: diagnosis.findings.neighbours.clone(),
            version: crate::core::VERSION.to_owned(),
        }
    }

    /// Whether the base, with the named cause where there is one, follows held-out PV worse than PV's mean does.
    pub(crate) fn is_worse_than_mean(&self) -> bool {
        let (given, closed) = (self.given.map(|given| given.gap), self.named().and_then(|e| e.closed_pct));
        self.gap.relative.is_some_and(|relative| share_left(relative, self.gap.gap, given, closed) > 1.0)
    }

    /// The named effect, unless it closes next to nothing: then it is a side note.
    pub(crate) fn leading(&self) -> Option<&EffectNote> {
        self.named().filter(|e| e.leads())
    }

    /// The named effect, unless the answer is `none` or `unknown`.
    #[must_use]
    pub fn named(&self) -> Option<&EffectNote> {
        self.effects.iter().chain(&self.pairs).find(|e| e.id == self.cause.id)
    }
}

/// What the budget of a diagnosis is held against.
fn held_against<'a>(
    record: &Record,
    diagnosis: &Diagnosis,
    effects: &'a [EffectNote],
    (valve, sp_moves): (Option<&ValveNote>, &'a [Move]),
) -> agree::Known<'a> {
    let base = &diagnosis.findings.base;
    let sticks = valve.is_some_and(ValveNote::does_stick);
    let model = if base.model.valve.law == "none" { &diagnosis.model_after } else { &base.model };
    let noise_sd = diagnosis.findings.floor.noise_sd.unwrap_or(0.0);
    agree::Known {
        effects,
        cycle_s: valve.and_then(|valve| valve.cycle_s),
        of_friction: sticks.then(|| loop_run::share_of_friction(record, model, noise_sd)).flatten(),
        sp_moves,
        point_s: record.point_s(),
        record_s: record.len() as f64 * record.point_s(),
        answer_s: base.model.process.answer_s(),
    }
}

/// What the diagnosis knows for the budget: the models fitted to the whole record, PV's noise and the loads.
fn known(diagnosis: &Diagnosis) -> budget::Known<'_> {
    budget::Known {
        models: &diagnosis.runs.fits_to_all,
        from: diagnosis.findings.blocks.from,
        period: None,
        noise_sd: diagnosis.findings.floor.noise_sd,
        loads: &diagnosis.findings.loads,
    }
}

impl Window {
    fn of(record: &Record) -> Self {
        Self {
            start_ns: record.start_ns,
            end_ns: record.end_ns,
            start: Moment(record.start_ns),
            end: Moment(record.end_ns),
            samples: record.raw_samples as u64,
            ts_s: record.recorded_ts_s,
            box_samples: record.box_samples as u64,
        }
    }
}

impl Figures {
    fn of(fit: &Fit, noise_floor: Option<f64>, deviation: f64) -> Self {
        let relative = (deviation > 0.0).then(|| fit.gap / deviation);
        Self { rmse: fit.rmse, noise_floor, gap: fit.gap, relative }
    }
}

impl BaseNote {
    fn of(base: &Base, fit: &Fit) -> Self {
        let source = match base {
            Base::Refit => "refit",
            Base::Linear => "linear",
            Base::Given(_) => "given",
        };
        let process = &fit.model.process;
        Self {
            source: source.to_owned(),
            valve_model: fit.model.valve.law.clone(),
            order: process.time_constants_s.len() as u8 + u8::from(process.integrating),
            integrating: process.integrating,
            model: fit.model.clone(),
        }
    }
}

impl ModelAfter {
    fn of(model: &Model) -> Self {
        let valve = &model.valve;
        let rubs = valve.law != "none";
        Self {
            fs: rubs.then_some(valve.fs),
            fd: rubs.then_some(valve.fd),
            s: rubs.then_some(valve.fs + valve.fd),
            j: rubs.then_some(valve.fs - valve.fd),
            valve_model: valve.law.clone(),
            model: model.clone(),
        }
    }
}
