//! Valve stiction from routine data: whether and how much a control valve sticks, the process behind it, the confidence in
//! the answer, and what else in the loop the model does not explain.
//!
//! Input is a [`Record`]: controller output (OP) and process variable (PV) at a constant sampling time. The examples
//! simulate theirs with [`sim`].
//!
//! | task | function |
//! |---|---|
//! | is the valve sticking, and how much | [`assess`] |
//! | the fit alone: bands of He's valve model, process with dead time | [`quantify`] |
//! | one valve over many windows: size, changes, windows that disagree | [`over_time()`] |
//! | loops that share an oscillation, and the source of it | [`assess_plant`] |
//! | benefit of a valve repair | [`repair()`] |
//! | effects that the model leaves out, and how much of the gap each closes | [`diagnose`] |
//! | bands from your own solver | [`solver`] |
//! | simulation of a loop: valve models, processes, PID, disturbances | [`sim`] |
//!
//! Results are typed numbers; documents implement `serde::Serialize`. The feature `schema` derives JSON Schema for the
//! documents.
//!
//! # Is the valve sticking?
//! ```
#![doc = include_str!("example_loop.md")]
//! use stiction::{AssessParams, Record, Verdict, assess, headline};
//!
//! # let simulated = simulated.record(1000, 61.0);
//! # let (op, pv) = (simulated.op().to_vec(), simulated.pv);
//! // OP in % and PV in its own unit, one value a second, as a historian exports them.
//! let record = Record::uniform(1.0, op, pv);
//! let found = assess(&record, &AssessParams::default());
//! println!("{}", headline(&found));
//! assert_eq!(found.verdict, Verdict::Stiction);
//! // The loop was simulated with fs 5 and fd 3.
//! assert!((found.s.unwrap() - 8.0).abs() < 0.1);
//! let [low, high] = found.s_interval.unwrap();
//! println!("s between {low} and {high} with a probability of 90 %");
//! ```
//!
//! # The fit alone
//! ```
//! use stiction::sim::he_step;
//! use stiction::{ModelChoice, Options, Record, quantify};
//!
//! let op: Vec<f64> = (0..600).map(|k| 6.0 * (f64::from(k) * 0.06).sin() + 2.0 * (f64::from(k) * 0.017).sin()).collect();
//! let (mut stem, mut pv, mut measured) = (0.0, 0.0, Vec::new());
//! for &u in &op {
//!     measured.push(pv);
//!     stem = he_step(stem, u, 2.5, 1.0);
//!     pv += 0.1 * (1.5 * stem - pv);
//! }
//! let options = Options { model: ModelChoice::Fopdt, ..Options::default() };
//! let fit = quantify(&Record::uniform(1.0, op, measured), &options)?;
//! assert!((fit.s - 3.5).abs() < 0.05 && (fit.gain - 1.5).abs() < 0.05);
//! # Ok::<(), stiction::NoFit>(())
//! ```
//!
//! # One valve over many windows
//! ```
//! use stiction::{ChangeKind, WindowResult, over_time};
//!
//! let hour_ns = 3_600_000_000_000;
//! // s was near 4 for a week, and near 8 since. `WindowResult::from(&assessment)` makes one from an assessment.
//! let windows: Vec<WindowResult> = (0..28)
//!     .map(|k| {
//!         let s = if k < 14 { 4.0 } else { 8.0 } * (1.0 + 0.02 * f64::from(k % 5));
//!         let start_ns = i64::from(k) * 12 * hour_ns;
//!         WindowResult {
//!             start_ns,
//!             end_ns: start_ns + 2 * hour_ns,
//!             stiction: Some(true),
//!             p_stiction: Some(0.95),
//!             s: Some(s),
//!             s_interval: Some([0.9 * s, 1.1 * s]),
//!             ..WindowResult::default()
//!         }
//!     })
//!     .collect();
//! let valve = over_time(&windows);
//! assert_eq!(valve.changes.len(), 1);
//! assert_eq!(valve.changes[0].kind, ChangeKind::Worse);
//! println!("{}", valve.sentences.join(" "));
//! ```
//!
//! # Which loop of a plant causes the oscillation?
//! ```
//! use stiction::{AssessParams, PlantLoop, Record, assess, assess_plant, group_report};
//!
//! // The windows of two loops over the same time: here both follow one wave.
//! let wave = |lag: f64| (0..900).map(move |k| (f64::from(k) * 0.1 - lag).sin()).collect::<Vec<f64>>();
//! let records = [0.0, 0.7].map(|lag| Record::uniform(1.0, wave(lag), wave(lag + 1.0)));
//! let assessments = records.each_ref().map(|record| assess(record, &AssessParams::default()));
//! let loops: Vec<PlantLoop> = ["FIC101", "TIC102"]
//!     .into_iter()
//!     .zip(records.iter().zip(&assessments))
//!     .map(|(name, (record, assessment))| PlantLoop { name, record, assessment, area: None, upstream: &[] })
//!     .collect();
//! let groups = assess_plant(&loops);
//! assert_eq!(groups.len(), 1);
//! println!("{}", group_report(&groups[0]));
//! ```
//!
//! # What would a repair bring?
//! ```
#![doc = include_str!("example_loop.md")]
//! use stiction::{AssessParams, RepairParams, assess, repair};
//!
//! # let record = simulated.record(1000, 61.0);
//! // `always_fit`: a repair needs a model, also of a loop that screening would skip.
//! let found = assess(&record, &AssessParams { always_fit: true, ..AssessParams::default() });
//! let benefit = repair(&record, &found, &RepairParams::default())?;
//! assert!(benefit.repaired.pv_sd.value < benefit.now.pv_sd.value);
//! println!("{}", benefit.sentences.join(" "));
//! # Ok::<(), stiction::NoRepair>(())
//! ```
//!
//! # What does the model leave out?
//! ```
#![doc = include_str!("example_loop.md")]
//! use stiction::{GapDocument, GapOptions, Serial, diagnose, gap_report};
//!
//! # let record = simulated.record(600, 61.0);
//! let options = GapOptions::default();
//! let diagnosis = diagnose(&record, &options, &Serial)?;
//! let document = GapDocument::new("FIC101", &record, &options, &diagnosis);
//! println!("{}", gap_report(&document));
//! // The loop was simulated with the model itself: nothing is missing.
//! assert_eq!(document.cause.id, "none");
//! # Ok::<(), stiction::GapError>(())
//! ```
//!
//! # Determinism
//! No file, socket, clock, thread, environment or unseeded random numbers: the same record gives bit-identical results on
//! every machine. Transcendental functions come from `libm`, because system libraries differ in the last bit.

#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::disallowed_types))]

// What is behind the items below, for the programs of this repository: it changes without notice. `core` judges one loop, by one
// record; it uses nothing of what lies beside it.
#[doc(hidden)]
pub mod core;
#[doc(hidden)]
pub mod over_time;
#[doc(hidden)]
pub mod plantwide;
#[doc(hidden)]
pub mod repair;
#[doc(hidden)]
pub mod samples;
#[doc(hidden)]
pub mod simulated;
#[doc(hidden)]
pub mod toolbox;
#[doc(hidden)]
pub mod words;

pub use crate::core::VERSION;
pub use crate::core::record::Record;
pub use crate::core::units::LoopKind;

// Verdicts.
pub use crate::core::verdict::{
    AssessParams, Assessment, Controller, EstimateDocument, Gate, Indicator, Oscillation, Process, Verdict, assess,
};
pub use crate::words::{advice, headline};

// The fit.
pub use crate::core::ident::class::Class;
pub use crate::core::ident::{DelayChoice, Estimate, ModelChoice, NoFit, Options, ValveChoice, quantify};
pub use crate::core::sim::slips::Law;

// One valve over time, one plant, one repair.
pub use crate::over_time::{Change, ChangeKind, Contradicting, OverTime, Pooled, Trend, WindowResult, over_time};
pub use crate::plantwide::{
    Follower, GroupDocument, MemberJudgement, PlantLoop, Source, SourceKind, assess_plant, text as group_report,
};
pub use crate::repair::{Case, Figure, NoRepair, Repair, RepairParams, repair};

// The gap between model and plant.
pub use crate::core::gap::document::{CauseNote, EffectNote, GapDocument};
pub use crate::core::gap::model::Model as GapModel;
pub use crate::core::gap::{Base, Diagnosis, Executor, GapError, GapOptions, Neighbour, Serial, diagnose};
pub use crate::words::gap_text::report as gap_report;

/// From raw samples to a [`Record`]: each value has its own timestamp, and some are late, missing or of bad quality.
///
/// ```
/// use stiction::record::{AlignParams, Sample, Signal, Value, align_all, record_of};
///
/// let second_ns = 1_000_000_000;
/// let sample = |signal, k: i64, value| Sample { signal, t_ns: k * second_ns, value, quality: None };
/// let samples: Vec<Sample> = (0..600)
///     .flat_map(|k| {
///         let swing = (k as f64 * 0.1).sin();
///         // One value of PV is missing.
///         let pv = if k == 300 { Value::Missing } else { Value::Number(20.0 + swing) };
///         [sample(Signal::Op, k, Value::Number(50.0 + swing)), sample(Signal::Pv, k, pv)]
///     })
///     .collect();
/// let (stretches, _) = align_all(&samples, &AlignParams::default());
/// let record = record_of(&stretches[0], 5000).expect("points");
/// assert_eq!(record.len(), 600);
/// assert_eq!(record.facts.filled, 1);
/// ```
pub mod record {
    pub use crate::core::record::{Mode, Sample, Signal, Value};
    pub use crate::samples::align::{AlignParams, Point, Quality, align_all};
    pub use crate::samples::history::record_of;
}

/// Lets your own solver search the error surface for the bands, next to the built-in solvers.
///
/// ```
/// use stiction::sim::he_step;
/// use stiction::solver::{Objective, Outcome, Settings, Solver, Surface, solve};
/// use stiction::{Class, Law, Options, Record};
///
/// /// Tries `budget` pairs of bands on a diagonal of the triangle.
/// struct Diagonal;
///
/// impl Solver for Diagonal {
///     fn name(&self) -> &'static str {
///         "diagonal"
///     }
///
///     fn search(&self, objective: &mut dyn Objective, settings: &Settings) -> Outcome {
///         let mut best = Outcome::nothing();
///         for k in 1..=settings.budget {
///             let s = k as f64 / settings.budget as f64;
///             let cost = objective.cost([s, 0.4 * s]);
///             best.evaluations += 1;
///             if cost < best.cost {
///                 (best.cost, best.best) = (cost, [s, 0.4 * s]);
///             }
///         }
///         best
///     }
/// }
///
/// let op: Vec<f64> = (0..300).map(|k| 6.0 * (f64::from(k) * 0.1).sin()).collect();
/// let (mut stem, mut pv, mut measured) = (0.0, 0.0, Vec::new());
/// for &u in &op {
///     measured.push(pv);
///     stem = he_step(stem, u, 2.5, 1.0);
///     pv += 0.1 * (1.5 * stem - pv);
/// }
/// let record = Record::uniform(1.0, op, measured);
/// let mut surface = Surface::new(&record, &Options::default(), Law::He, Class::First)?;
/// let found = solve(&mut surface, &Diagonal, &Settings { budget: 500, fineness_pct: 5.0, seed: 1 });
/// assert!(found.mse < surface.mse(0.0, 0.0));
/// # Ok::<(), stiction::NoFit>(())
/// ```
pub mod solver {
    pub use crate::core::optim::{Contour, Objective, Outcome, Settings, Solver};
    pub use crate::toolbox::solvers::{ALL, AdaptiveRandom, BranchBound, Multistart};
    pub use crate::toolbox::surface::{Solved, Surface, solve};
}

/// Simulation of control loops with sticking valves.
///
/// ```
/// use stiction::sim::{Action, ClosedLoop, LoopModel, PidSettings, ProcessModel, ValveLaw, ValveModel};
///
/// let controller = PidSettings {
///     kc: 0.8,
///     ti_s: 8.0,
///     td_s: 0.0,
///     action: Action::Reverse,
///     op_min: 0.0,
///     op_max: 100.0,
///     op_resolution: 0.01,
/// };
/// let model = LoopModel {
///     ts_s: 1.0,
///     // Times in samples.
///     process: ProcessModel { gain: 2.0, tau: 20.0, tau2: 0.0, dead_time: 6.0, integrating: false },
///     rest_op: 50.0,
///     rest_pv: 60.0,
///     controller,
///     valve: ValveModel { law: ValveLaw::He, fs: 5.0, fd: 3.0, ..ValveModel::HEALTHY },
///     pv_noise_sd: 0.05,
///     load: vec![],
///     pv_disturbance: vec![],
/// };
/// let seed = 1;
/// let record = ClosedLoop::new(model, 0.0, 60.0, seed).record(1800, 61.0);
/// // The sticking valve causes a limit cycle around the set point.
/// let late = &record.pv[900..];
/// assert!(late.iter().any(|pv| *pv > 61.5) && late.iter().any(|pv| *pv < 60.5));
/// ```
pub mod sim {
    pub use crate::core::sim::closed_loop::{ClosedLoop, LoopModel, Scan, ValveLaw, ValveModel};
    pub use crate::core::sim::controller::{Action, PidSettings};
    pub use crate::core::sim::disturbance::Disturbance;
    pub use crate::core::sim::process::ProcessModel;
    pub use crate::core::sim::valve::he_step;
}

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
