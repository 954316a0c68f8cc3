//! When a loop's gap is diagnosed, and against which model.
//!
//! A window *departs* where its fit is [`FIT_DROP_PCT`] points below the loop's own median, or where the accepted model,
//! run freely over what came after its own window, leaves [`GAP_GROWTH`] times its usual gap. [`IN_A_ROW`] such windows
//! ask for a diagnosis, at most once in [`REST_NS`] of event time; windows without a fit neither count nor break the row.
//!
//! The *accepted* model is that of the first window graded A or B, and stays until a diagnosis has been made against it
//! (or a first one of grade B is followed by an A): were it renewed with every window, stiction that grows slowly would
//! never show. The window that was diagnosed, or the next one graded A or B, gives the next. What a person asks for
//! changes none of this. All of it hangs on the loop's windows in their order alone, and is part of its checkpoint.

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

/// Points of fit below the loop's median from which a window departs.
pub const FIT_DROP_PCT: f64 = 15.0;
/// Times its usual gap from which a window departs.
pub const GAP_GROWTH: f64 = 1.5;
/// Departing windows in a row that ask for a diagnosis.
pub const IN_A_ROW: u32 = 3;
/// Event time between two diagnoses that nobody asked for: a day, ns.
pub const REST_NS: i64 = 86_400_000_000_000;
/// Windows of earlier diagnoses that are remembered.
pub(super) const POOLED: usize = 4;
/// Event time for which a diagnosis is remembered: 30 days, ns.
pub(super) const POOLED_NS: i64 = 30 * REST_NS;
/// Windows that make what is usual.
const REMEMBERED: usize = 24;
/// Fewest of them to speak of.
const USUAL: usize = 5;
/// A gap below this share of PV's standard deviation counts as this large: half as much again of nothing is nothing.
const LEAST_GAP: f64 = 0.05;

/// Why a gap is diagnosed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GapReason {
    /// A person asked.
    Operator,
    /// Three windows whose fit is far below the loop's own median.
    FitFell,
    /// Three windows in which the accepted model left far more than usual.
    GapGrew,
}

/// A model against which later windows are held.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Accepted {
    model: Model,
    /// Grade of its estimate.
    grade: char,
    /// Name of its window, ns.
    window_end_ns: i64,
}

/// Figures of a window's record for the watch: computed with the window's estimate, not on the engine's thread.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Watched {
    /// The model that was accepted when the window was due.
    accepted: Option<Accepted>,
    /// Its gap in the window.
    gap: Option<f64>,
    /// The window's own model, if it is graded A or B.
    model: Option<Model>,
}

impl Watched {
    /// Of a window that became due under this model.
    pub(super) fn of(assessment: &Assessment, record: &Record, accepted: Option<Accepted>) -> Self {
        let gap = fit_pct(assessment).and_then(|_| accepted.as_ref()?.gap_in(record));
        let model = grade(assessment).and_then(|_| model_of(assessment, record));
        Self { accepted, gap, model }
    }
}

fn fit_pct(assessment: &Assessment) -> Option<f64> {
    assessment.process.as_ref().map(|p| p.fit_pct).filter(|fit| fit.is_finite())
}

/// The grade of an estimate whose model may be accepted.
fn grade(assessment: &Assessment) -> Option<char> {
    assessment.grade.filter(|grade| matches!(grade, 'A' | 'B'))
}

/// A loop's memory of what is usual.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct GapWatch {
    accepted: Option<Accepted>,
    /// Fits of the latest windows, %.
    fits_pct: VecDeque<f64>,
    /// Gaps of the accepted model in the latest windows, shares of PV's standard deviation.
    gaps: VecDeque<f64>,
    departing: u32,
    /// The window of the last diagnosis that nobody asked for.
    ran_ns: Option<i64>,
    /// A diagnosis was made against the accepted model: the next graded window gives another.
    renew: bool,
}

impl GapWatch {
    pub(super) const fn accepted(&self) -> Option<&Accepted> {
        self.accepted.as_ref()
    }

    /// The model against which a diagnosis would be made now.
    #[must_use]
    pub fn model(&self) -> Option<&Model> {
        self.accepted.as_ref().map(|a| &a.model)
    }

    /// Takes a window in its order. Gives the reason and the model of a diagnosis that is due now.
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
        // A clock that was set back by more than a day counts as another day.
        let rested = self.ran_ns.is_none_or(|ran_ns| end_ns.abs_diff(ran_ns) >= REST_NS.unsigned_abs());
        let due = params.enabled && self.departing >= IN_A_ROW && rested;
        let asked = due.then(|| {
            (self.ran_ns, self.renew) = (Some(end_ns), true);
            (if fell { GapReason::FitFell } else { GapReason::GapGrew }, self.model().cloned())
        });
        self.accept(assessment, watched.model);
        asked
    }

    /// The diagnosis that was due found no place: the next departing window asks again.
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
    /// What the model leaves of PV above its white noise after its own window, over PV's standard deviation. `None` until
    /// half of the window lies after it: a model knows the points that it was made from.
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

/// The model that an estimate stands for, with the rest at which its own window was.
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

/// A diagnosis that is asked for: leaves the engine as an estimate's request does.
#[derive(Debug, Clone)]
pub struct GapRequest {
    /// Its loop.
    pub id: LoopId,
    /// Its place among the loop's diagnoses; the key to hand the answer back with.
    pub number: u64,
    /// The loop's name.
    pub loop_name: Arc<str>,
    /// Why.
    pub reason: GapReason,
    /// Who asked, where a person did.
    pub by: Option<String>,
    /// What it is made from.
    pub record: Arc<Record>,
    /// How the loop's valve is judged.
    pub assess: AssessParams,
    /// The loop's accepted model, if it has one.
    pub model: Option<Model>,
    /// Other loops on the record's grid, each a possible load.
    pub neighbours: Vec<Neighbour>,
    /// Earlier windows of the loop from which the cause is decided, too.
    pub earlier: Vec<pool::Window>,
    /// Model responses that it may compute.
    pub budget_evaluations: u64,
    /// Hash of the configuration.
    pub config_hash: Arc<str>,
    /// Id of the daemon that asks; none outside one.
    pub daemon: Option<Arc<str>>,
}

impl GapRequest {
    /// Computes the answer. Depends on the request and on the evaluations at which `executor` ends it, if it does.
    ///
    /// # Errors
    /// Where the record cannot be diagnosed.
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
        // From a base that is worse than PV's mean nothing can be judged, in other windows either.
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

/// A diagnosis as it is published: why it was made, and under which configuration.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PublishedGap {
    /// The diagnosis.
    #[serde(flatten)]
    pub document: GapDocument,
    /// What the window by itself adds to a later decision; none where its base is worse than PV's mean.
    #[serde(skip)]
    pub own: Option<Box<pool::Window>>,
    /// Why it was made.
    pub reason: GapReason,
    /// Who asked, where a person did.
    pub by: Option<String>,
    /// Hash of the configuration.
    pub config_hash: String,
    /// Id of the daemon that made it; absent where none did.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub daemon: Option<String>,
}

impl PublishedGap {
    /// The name of its window, ns.
    #[must_use]
    pub const fn end_ns(&self) -> i64 {
        self.document.window.end_ns
    }
}

/// Whether a recording can give a window back: JSON holds no number that is not finite.
pub(super) fn is_recordable(window: &pool::Window) -> bool {
    let json = serde_json::to_vec(window);
    json.is_ok_and(|json| serde_json::from_slice::<pool::Window>(&json).is_ok_and(|read| read == *window))
}

/// Why a person's wish for a diagnosis is refused.
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
