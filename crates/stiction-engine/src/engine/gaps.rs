//! Decides when a loop's gap is diagnosed, and against which model.
//!
//! A window *departs* if its fit is [`FIT_DROP_PCT`] points below the loop's median, or if the accepted model, in free run over
//! the data after its own window, leaves [`GAP_GROWTH`] times its usual gap. [`IN_A_ROW`] such windows request a diagnosis, at
//! most once in [`REST_NS`] of event time; windows without a fit neither count nor interrupt the sequence.
//!
//! The *accepted* model is that of the first window graded A or B. It is kept until a diagnosis was made against it (or until a
//! first one of grade B is followed by an A): if it were renewed with every window, slowly growing stiction would never show.
//! The diagnosed window, or the next one graded A or B, gives the next model. Diagnoses requested by people change none of
//! this. Everything depends only on the loop's windows and their order, and is part of its checkpoint.

use std::collections::VecDeque;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::LoopId;
use super::settings::GapParams;
use stiction::core::detect::oscillation;
use stiction::core::gap::document::GapDocument;
use stiction::core::gap::model::{self, Model};
use stiction::core::gap::pool;
use stiction::core::gap::{self, Base, Executor, GapError, GapOptions, Neighbour};
use stiction::core::ident;
use stiction::core::ident::free_run::free_run;
use stiction::core::record::Record;
use stiction::core::signal::stats;
use stiction::core::sim::slips::Law;
use stiction::core::units::format_rfc3339;
use stiction::core::verdict::{AssessParams, Assessment, assess};

/// A window departs if its fit is this many points below the loop's median.
pub const FIT_DROP_PCT: f64 = 15.0;
/// A window departs if the accepted model leaves this many times its usual gap.
pub const GAP_GROWTH: f64 = 1.5;
/// Consecutive departing windows that request a diagnosis.
pub const IN_A_ROW: u32 = 3;
/// Event time between two automatic diagnoses: a day, ns.
pub const REST_NS: i64 = 86_400_000_000_000;
/// Number of earlier diagnoses whose windows are remembered.
pub(super) const POOLED: usize = 4;
/// Event time for which a diagnosis is remembered: 30 days, ns.
pub(super) const POOLED_NS: i64 = 30 * REST_NS;
/// Windows from which the usual values are taken.
const REMEMBERED: usize = 24;
/// Fewest windows for a usual value.
const USUAL: usize = 5;
/// A smaller gap counts as this fraction of PV's standard deviation: growth from almost nothing means nothing.
const LEAST_GAP: f64 = 0.05;

/// Why a gap is diagnosed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GapReason {
    /// A person requested it.
    Operator,
    /// The fit of three windows was far below the loop's median.
    FitFell,
    /// In three windows the accepted model left far more than usual.
    GapGrew,
}

/// A model with which later windows are compared.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Accepted {
    model: Model,
    /// Grade of its estimate.
    grade: char,
    /// End of its window, ns.
    window_end_ns: i64,
}

/// Figures of a window's record for the watch, computed with the window's estimate and not on the engine's thread.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Watched {
    /// The model accepted when the window came due.
    accepted: Option<Accepted>,
    /// Its gap in the window.
    gap: Option<f64>,
    /// The window's own model, if it is graded A or B.
    model: Option<Model>,
}

impl Watched {
    /// For a window that came due under this model.
    pub(super) fn of(assessment: &Assessment, record: &Record, accepted: Option<Accepted>) -> Self {
        let gap = fit_pct(assessment).and_then(|_| accepted.as_ref()?.gap_in(record));
        let model = grade(assessment).and_then(|_| model_of(assessment, record));
        Self { accepted, gap, model }
    }
}

fn fit_pct(assessment: &Assessment) -> Option<f64> {
    assessment.process.as_ref().map(|p| p.fit_pct).filter(|fit| fit.is_finite())
}

/// The grade of an estimate if its model may be accepted.
fn grade(assessment: &Assessment) -> Option<char> {
    assessment.grade.filter(|grade| matches!(grade, 'A' | 'B'))
}

/// A loop's usual values, and its accepted model.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct GapWatch {
    accepted: Option<Accepted>,
    /// Fits of the latest windows, %.
    fits_pct: VecDeque<f64>,
    /// Gaps of the accepted model in the latest windows, relative to PV's standard deviation.
    gaps: VecDeque<f64>,
    departing: u32,
    /// End of the window of the last automatic diagnosis.
    ran_ns: Option<i64>,
    /// A diagnosis was made against the accepted model, so the next graded window replaces it.
    renew: bool,
}

impl GapWatch {
    pub(super) const fn accepted(&self) -> Option<&Accepted> {
        self.accepted.as_ref()
    }

    /// The model against which a diagnosis would now be made.
    #[must_use]
    pub fn model(&self) -> Option<&Model> {
        self.accepted.as_ref().map(|a| &a.model)
    }

    /// Takes the next window. Returns reason and model of a diagnosis that is now due.
    pub(super) fn window(
        &mut self,
        assessment: &Assessment,
        record: &Record,
        watched: Watched,
        params: &GapParams,
    ) -> Option<(GapReason, Option<Model>)> {
        let fit_pct = fit_pct(assessment)?;
        let fell = usual(&self.fits_pct).is_some_and(|median| fit_pct < median - FIT_DROP_PCT);
        let gap = if watched.accepted == self.accepted {
            watched.gap
        } else {
            // Another model was accepted while the window waited, which is rare.
            self.accepted.as_ref().and_then(|accepted| accepted.gap_in(record))
        };
        let limit = usual(&self.gaps).map(|median| GAP_GROWTH * median.max(LEAST_GAP));
        let grew = gap.zip(limit).is_some_and(|(gap, limit)| gap > limit);
        remember(&mut self.fits_pct, fit_pct);
        gap.into_iter().for_each(|gap| remember(&mut self.gaps, gap));
        self.departing = if fell || grew { self.departing.saturating_add(1) } else { 0 };
        let end_ns = assessment.window.end_ns;
        // A clock set back by more than a day counts as another day.
        let rested = self.ran_ns.is_none_or(|ran_ns| end_ns.abs_diff(ran_ns) >= REST_NS.unsigned_abs());
        let due = params.enabled && self.departing >= IN_A_ROW && rested;
        let asked = due.then(|| {
            (self.ran_ns, self.renew) = (Some(end_ns), true);
            (if fell { GapReason::FitFell } else { GapReason::GapGrew }, self.model().cloned())
        });
        self.accept(assessment, watched.model);
        asked
    }

    /// The due diagnosis found no place in the queue: the next departing window requests it again.
    pub(super) const fn gave_up(&mut self) {
        (self.ran_ns, self.renew) = (None, false);
    }

    fn accept(&mut self, assessment: &Assessment, model: Option<Model>) {
        let (Some(grade), Some(model)) = (grade(assessment), model) else { return };
        let better = |a: &Accepted| a.grade == 'B' && grade == 'A' && self.departing == 0;
        if !self.renew && !self.accepted.as_ref().is_none_or(better) {
            return;
        }
        self.accepted = Some(Accepted { model, grade, window_end_ns: assessment.window.end_ns });
        self.gaps.clear();
        self.renew = false;
    }
}

fn usual(memory: &VecDeque<f64>) -> Option<f64> {
    let values: Vec<f64> = memory.iter().copied().collect();
    (values.len() >= USUAL).then(|| stats::median(&values))
}

fn remember(memory: &mut VecDeque<f64>, value: f64) {
    if memory.len() == REMEMBERED {
        memory.pop_front();
    }
    memory.push_back(value);
}

/// Valve and process of a model without its effects.
fn valve_and_process(model: &Model) -> ident::Model {
    let (law, fs, fd) = match model.valve.law.as_str() {
        "tracking" => (Law::Tracking, model.valve.fs, model.valve.fd),
        "none" => (Law::He, 0.0, 0.0),
        _ => (Law::He, model.valve.fs, model.valve.fd),
    };
    let p = &model.process;
    let (gain, dead_time_s, integrating) = (p.gain, p.dead_time_s, p.integrating);
    ident::Model { law, fs, fd, gain, time_constants_s: p.time_constants_s.clone(), dead_time_s, integrating }
}

impl Accepted {
    /// Residual of the model in PV beyond its white noise, after the model's own window, relative to PV's standard deviation.
    /// `None` unless at least half of the record is after that window, since a model fits the points it was made from.
    fn gap_in(&self, record: &Record) -> Option<f64> {
        let length_ns = record.end_ns.saturating_sub(record.start_ns);
        if self.window_end_ns.saturating_sub(record.start_ns) > length_ns / 2 {
            return None;
        }
        let run = free_run(record, &valve_and_process(&self.model), self.window_end_ns)?;
        let noise = stats::noise_sd(&record.pv);
        let gap = (run.rmse * run.rmse - noise * noise).max(0.0).sqrt() / stats::std_dev(&record.pv);
        gap.is_finite().then_some(gap)
    }
}

/// The model of an estimate, at the operating point of its window.
fn model_of(assessment: &Assessment, record: &Record) -> Option<Model> {
    let (fs, fd, p) = (assessment.fs?, assessment.fd?, assessment.process.as_ref()?);
    let mut model = Model {
        schema: model::SCHEMA.to_owned(),
        ts_s: record.ts_s,
        valve: model::Valve { law: assessment.valve_model?.name().to_owned(), fs, fd, stem0: None },
        process: model::Process {
            gain: p.gain,
            time_constants_s: p.time_constants_s.clone(),
            dead_time_s: p.dead_time_s,
            integrating: p.integrating,
            op: 0.0,
            pv: 0.0,
        },
        effects: Vec::new(),
    };
    let run = free_run(record, &valve_and_process(&model), record.start_ns)?;
    (model.process.op, model.process.pv) = (run.rest_op, run.rest_pv);
    let process = &model.process;
    let numbers = [fs, fd, process.gain, process.dead_time_s, process.op, process.pv];
    numbers.iter().chain(&process.time_constants_s).all(|x| x.is_finite()).then_some(model)
}

/// A requested diagnosis, which leaves the engine like a request for an estimate.
#[derive(Debug, Clone)]
pub struct GapRequest {
    /// Its loop.
    pub id: LoopId,
    /// Its number among the loop's diagnoses, with which the answer is returned.
    pub number: u64,
    /// The loop's name.
    pub loop_name: Arc<str>,
    /// The reason.
    pub reason: GapReason,
    /// The person who requested it, if any.
    pub by: Option<String>,
    /// The record to diagnose.
    pub record: Arc<Record>,
    /// Parameters for judging the loop's valve.
    pub assess: AssessParams,
    /// The loop's accepted model, if it has one.
    pub model: Option<Model>,
    /// Other loops on the record's grid, each a possible load.
    pub neighbours: Vec<Neighbour>,
    /// Earlier windows of the loop that help to decide the cause.
    pub earlier: Vec<pool::Window>,
    /// Most model responses to compute.
    pub budget_evaluations: u64,
    /// Hash of the configuration.
    pub config_hash: Arc<str>,
    /// Id of the requesting daemon; `None` outside a daemon.
    pub daemon: Option<Arc<str>>,
}

impl GapRequest {
    /// Computes the answer. It depends on the request and on the evaluations after which `executor` ends it, if it does.
    ///
    /// # Errors
    /// The record cannot be diagnosed.
    pub fn compute(&self, executor: &dyn Executor) -> Result<PublishedGap, GapError> {
        let base = self.model.clone().map_or(Base::Refit, |model| Base::Given(Box::new(model)));
        let period_points = oscillation::detect(&self.record.op(), &self.record.pv).map(|o| o.period_points);
        let options = GapOptions {
            base,
            period_points,
            budget_evaluations: self.budget_evaluations,
            neighbours: self.neighbours.clone(),
            ..GapOptions::default()
        };
        let alone = gap::diagnose(&self.record, &options, executor)?;
        let source = format!("window to {}", format_rfc3339(self.record.end_ns));
        // If the base is worse than PV's mean, nothing can be judged from this window, nor together with others.
        let own = (!alone.is_worse_than_mean()).then(|| pool::Window::of(&source, &self.record, &alone));
        let windows: Vec<pool::Window> = self.earlier.iter().chain(&own).cloned().collect();
        let is_pooled = own.is_some() && windows.len() > 1;
        let together = is_pooled.then(|| pool::decide_together(&windows)).transpose()?;
        let diagnosis = together.map_or_else(|| alone.clone(), |together| alone.with_answer_of(&together));
        let assessment = assess(&self.record, &self.assess);
        let mut document = GapDocument::beside(&self.loop_name, &self.record, &options, &diagnosis, Some(&assessment));
        if is_pooled {
            document.pooled = pool::notes(&windows, self.earlier.len());
        }
        Ok(PublishedGap {
            document,
            own: own.map(Box::new),
            reason: self.reason,
            by: self.by.clone(),
            config_hash: self.config_hash.to_string(),
            daemon: self.daemon.as_deref().map(str::to_owned),
        })
    }
}

/// A diagnosis as published, with its reason and configuration.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PublishedGap {
    /// The diagnosis.
    #[serde(flatten)]
    pub document: GapDocument,
    /// Evidence of this window alone for a later decision; `None` if its base is worse than PV's mean.
    #[serde(skip)]
    pub own: Option<Box<pool::Window>>,
    /// The reason.
    pub reason: GapReason,
    /// The person who requested it, if any.
    pub by: Option<String>,
    /// Hash of the configuration.
    pub config_hash: String,
    /// Id of the daemon that made it; absent outside a daemon.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub daemon: Option<String>,
}

impl PublishedGap {
    /// End of its window, ns.
    #[must_use]
    pub const fn end_ns(&self) -> i64 {
        self.document.window.end_ns
    }
}

/// Whether a recording can restore the window: JSON has no numbers that are not finite.
pub(super) fn is_recordable(window: &pool::Window) -> bool {
    let json = serde_json::to_vec(window);
    json.is_ok_and(|json| serde_json::from_slice::<pool::Window>(&json).is_ok_and(|read| read == *window))
}

/// Why a person's request for a diagnosis is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum GapRefusal {
    /// No such loop.
    #[error("no loop {0:?} has appeared: ask */estimate for those that have")]
    UnknownLoop(String),
    /// Nothing to diagnose.
    #[error("{points} points since the last gap in the data, but a diagnosis needs {needed}: ask again later")]
    TooShort {
        /// Points held.
        points: usize,
        /// Points needed.
        needed: usize,
    },
    /// No earlier window to decide together with.
    #[error(
        "no diagnosis of an earlier window is remembered, of the last {} days and since the daemon started: ask without pool",
        POOLED_NS / 86_400_000_000_000
    )]
    NothingEarlier,
}
