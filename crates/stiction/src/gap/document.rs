//! The published diagnosis, `stictiond.gap.v1`.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::judged::Diagnosis;
use super::locate::Location;
use super::loop_run::Cycles;
use super::model::Model;
use super::sizes::Quantity;
use super::types::{Alternative, Base, EffectResult, Ended, Fit, Parameter};
use crate::record::Record;
use crate::signal::stats;
use crate::units::Moment;

/// Schema name of a diagnosis.
pub const GAP_SCHEMA: &str = "stictiond.gap.v1";

/// The stretch of time that was diagnosed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Window {
    /// Stamp of the first sample, ns since 1970.
    pub start_ns: i64,
    /// Stamp of the last sample.
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
    /// Raw samples in a point of the simulation (1: raw).
    pub box_samples: u64,
}

/// The record of the search.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SearchNote {
    /// Model responses computed by all searches: for base and effects, behind a recorded valve position, for pairs.
    pub evaluations: u64,
    /// Responses that each of them was allowed.
    pub budget: u64,
    /// Why the search for base and effects ended: `noise`, `explained`, `agreement`, `complete`, `budget` or `stopped`.
    pub ended: Ended,
}

/// From which model the gap is measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BaseNote {
    /// `refit` (He's law, first order, fitted here), `linear` (without friction) or `given` (a model from elsewhere,
    /// with the refitted base beside it).
    pub source: String,
    /// Law of the refitted base's valve: `he` or `none`.
    pub valve_model: String,
    /// Its order.
    pub order: u8,
    /// Whether it integrates.
    pub integrating: bool,
    /// The refitted base, which can be simulated again.
    pub model: Model,
}

/// A gap on held-out data, free run, PV units.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Figures {
    /// Root mean squared error.
    pub rmse: f64,
    /// What no model gets below; on held or compressed PV as the stored values show it, `None` where they are too few.
    pub noise_floor: Option<f64>,
    /// What is left above the floor: `sqrt(max(rmse^2 - noise_floor^2, 0))`, the error itself without a floor.
    pub gap: f64,
    /// The gap over PV's standard deviation.
    pub relative: Option<f64>,
}

/// One effect, added to the base.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct EffectNote {
    /// Its id, or two joined by `+`.
    pub id: String,
    /// Where it acts.
    pub stage: String,
    /// Its parameters as fitted.
    pub parameters: BTreeMap<String, Quantity>,
    /// Gap of the base, PV units.
    pub gap_before: f64,
    /// Gap with the effect.
    pub gap_after: f64,
    /// The noise floor with it, for effects that free run cannot predict.
    pub floor_after: Option<f64>,
    /// 100 (1 - after / before); `None` where it says nothing.
    pub closed_pct: Option<f64>,
    /// 90 % interval of it.
    pub closed_interval: Option<[f64; 2]>,
    /// Gain in training log mean squared error over the base, after BIC.
    pub evidence: f64,
    /// Evidence less what the effect needs to be named.
    pub lead: f64,
    /// Effects that it cannot be told from.
    pub confusable_with: Vec<String>,
    /// The measurement that would settle it.
    pub separated_by: String,
    /// Whether its training error reaches the noise floor; `None` for effects that are not simulated.
    pub at_floor: Option<bool>,
}

/// The answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CauseNote {
    /// An effect's id, two joined by `+`, `none` or `unknown`.
    pub id: String,
    /// Probability that it is right.
    pub probability: f64,
    /// Whether it also closes the gap on held-out data and forward in time; false is "suspected".
    pub confirmed: bool,
}

/// Another answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AlternativeNote {
    /// As [`CauseNote::id`].
    pub id: String,
    /// Probability that it is right.
    pub probability: f64,
}

/// Gaps of models fitted to the first part, over the rest.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ForwardNote {
    /// The base's, PV units.
    pub gap_before: f64,
    /// With the cause.
    pub gap_after: f64,
    /// 100 (1 - after / before).
    pub closed_pct: Option<f64>,
}

/// The experiment that would tell the two best answers apart.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct TestNote {
    /// `op` or `sp`.
    pub signal: String,
    /// Height of the bump, units of the signal.
    pub size: f64,
    /// Its duration, s.
    pub duration_s: f64,
    /// The two answers.
    pub separates: [String; 2],
    /// Probability that it tells them.
    pub p: f64,
}

/// The model with the cause: what `simulate`, `analyze` and `gap --base` take, and the words of an estimate beside it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ModelAfter {
    /// The model itself.
    #[serde(flatten)]
    pub model: Model,
    /// Static band, OP units; `None` without friction.
    pub fs: Option<f64>,
    /// Kinetic band.
    pub fd: Option<f64>,
    /// fs + fd.
    pub s: Option<f64>,
    /// fs - fd.
    pub j: Option<f64>,
    /// `he`, `tracking` or `none`.
    pub valve_model: String,
}

/// What noise models make of the residual, as [`super::types::NoiseModels`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct NoiseNote {
    /// Gain of an autoregressive model of the best residual, log mean squared error.
    pub over_base: f64,
    /// By how much it beats the best structural model.
    pub over_best: f64,
    /// Smallest p of independence.
    pub independence_p: f64,
    /// Whether it leaves white noise.
    pub whitens: bool,
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
    /// What was diagnosed.
    pub window: Window,
    /// From which model.
    pub base: BaseNote,
    /// Gap of the refitted base.
    pub gap: Figures,
    /// Gap of the model that was given.
    pub given: Option<Figures>,
    /// Part of the given model's gap that refitting closes, PV units: as given less refitted.
    pub parametric: Option<f64>,
    /// Where the gap lies.
    #[serde(rename = "where")]
    pub location: Location,
    /// Every effect asked, best first.
    pub effects: Vec<EffectNote>,
    /// The answer.
    pub cause: CauseNote,
    /// Named beside the cause: what acts on the plant under what the recorder did, or what the recorder did beside it.
    #[serde(default)]
    pub second_cause: Option<AlternativeNote>,
    /// Other answers, best first, without the cause.
    pub alternatives: Vec<AlternativeNote>,
    /// Forward in time.
    pub forward: Option<ForwardNote>,
    /// The base with the cause, and with what is named beside it.
    pub model_after: ModelAfter,
    /// The experiment that would settle it.
    pub next_test: Option<TestNote>,
    /// Model responses computed.
    pub evaluations: u64,
    /// The search: what it spent, what it might, why it ended.
    pub search: SearchNote,
    /// Whether the search was ended before it was done.
    pub stopped_early: bool,
    /// Effects tried two at once, best first; empty where one alone explains the record, unless asked for.
    pub pairs: Vec<EffectNote>,
    /// Noise models of the residual.
    pub noise_models: NoiseNote,
    /// The closed loop simulated, where the controller can be read.
    pub closed_loop: Option<Cycles>,
    /// Version of the program.
    pub version: String,
}

/// 100 (1 - after / before); `None` where there was no gap.
#[must_use]
pub fn closed_pct(before: f64, after: f64) -> Option<f64> {
    let pct = 100.0 * (1.0 - after / before);
    (before > 0.0 && pct.is_finite()).then_some(pct)
}

impl GapDocument {
    /// Writes down a diagnosis of a record, asked from `base`.
    #[must_use]
    pub fn new(loop_name: &str, record: &Record, base: &Base, diagnosis: &Diagnosis, location: Location) -> Self {
        let deviation = stats::std_dev(&record.pv);
        let figures = |fit: &Fit| Figures {
            rmse: fit.rmse,
            noise_floor: diagnosis.floor.noise_floor,
            gap: fit.gap,
            relative: (deviation > 0.0).then(|| fit.gap / deviation),
        };
        let given = diagnosis.given.as_ref().map(figures);
        Self {
            schema: GAP_SCHEMA.to_owned(),
            loop_name: loop_name.to_owned(),
            window: Window::of(record),
            base: BaseNote::of(base, &diagnosis.base),
            gap: figures(&diagnosis.base),
            given,
            parametric: given.map(|g| g.gap - diagnosis.base.gap),
            location,
            effects: diagnosis.effects.iter().map(EffectNote::of).collect(),
            cause: CauseNote {
                id: diagnosis.cause.id.clone(),
                probability: diagnosis.cause.probability,
                confirmed: diagnosis.cause.confirmed,
            },
            second_cause: diagnosis.second.as_ref().map(AlternativeNote::of),
            alternatives: diagnosis.alternatives.iter().map(AlternativeNote::of).collect(),
            forward: diagnosis.forward.map(|f| ForwardNote {
                gap_before: f.gap_before,
                gap_after: f.gap_after,
                closed_pct: closed_pct(f.gap_before, f.gap_after),
            }),
            model_after: ModelAfter::of(&diagnosis.model_after),
            next_test: diagnosis.next_test.as_ref().map(|t| TestNote {
                signal: t.signal.to_owned(),
                size: t.size,
                duration_s: t.duration_s,
                separates: t.separates.clone(),
                p: t.p,
            }),
            evaluations: diagnosis.evaluations,
            search: SearchNote {
                evaluations: diagnosis.evaluations,
                budget: diagnosis.budget_evaluations,
                ended: diagnosis.ended,
            },
            stopped_early: diagnosis.stopped_early,
            pairs: diagnosis.pairs.iter().map(EffectNote::of).collect(),
            noise_models: NoiseNote {
                over_base: diagnosis.noise_models.over_base,
                over_best: diagnosis.noise_models.over_best,
                independence_p: diagnosis.noise_models.independence_p,
                whitens: diagnosis.noise_models.whitens,
            },
            closed_loop: super::loop_run::cycles(record, diagnosis),
            version: crate::VERSION.to_owned(),
        }
    }

    /// The effect that was named, unless the answer is `none` or `unknown`.
    #[must_use]
    pub fn named(&self) -> Option<&EffectNote> {
        self.effects.iter().chain(&self.pairs).find(|e| e.id == self.cause.id)
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

impl AlternativeNote {
    fn of(other: &Alternative) -> Self {
        Self { id: other.id.clone(), probability: other.probability }
    }
}

impl EffectNote {
    fn of(effect: &EffectResult) -> Self {
        let mut parameters = BTreeMap::new();
        for Parameter { name, value, unit } in &effect.parameters {
            // Both effects of a pair may have one of this name: the second's says whose it is.
            let second = effect.id.rsplit('+').next().unwrap_or_default();
            let taken = parameters.contains_key(*name);
            let name = if taken { format!("{second}.{name}") } else { (*name).to_owned() };
            parameters.insert(name, Quantity { value: *value, unit: (*unit).to_owned() });
        }
        Self {
            id: effect.id.clone(),
            stage: effect.stage.name().to_owned(),
            parameters,
            gap_before: effect.gap_before,
            gap_after: effect.gap_after,
            floor_after: effect.floor_after,
            closed_pct: effect.closed_pct,
            closed_interval: effect.closed_interval,
            evidence: effect.evidence,
            lead: effect.lead,
            confusable_with: effect.confusable_with.iter().map(|id| (*id).to_owned()).collect(),
            separated_by: effect.separated_by.to_owned(),
            at_floor: effect.fit.as_ref().filter(|_| effect.simulated).map(|f| f.at_floor),
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
