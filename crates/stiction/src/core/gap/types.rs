//! Request and result types of the diagnosis.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::model::Model;
use super::neighbour::{Neighbour, NeighbourError};
use super::sizes::Quantity;

/// Id of an effect, as in documents.
pub(crate) type EffectId = &'static str;

/// Id of the answer that the base explains the record.
pub const NONE: &str = "none";
/// Id of the answer that the record differs from the base and no effect of the catalogue explains it.
pub const UNKNOWN: &str = "unknown";

/// Base model of the gap.
#[derive(Debug, Clone, Default, PartialEq)]
pub enum Base {
    /// He's valve model with a first-order process, refitted.
    #[default]
    Refit,
    /// The same process with an ideal valve; stiction is then an effect.
    Linear,
    /// A given model; the refitted base is evaluated too.
    Given(Box<Model>),
}

/// Per cent of the gap below which an effect makes next to nothing of it.
pub(crate) const LITTLE_PCT: f64 = 10.0;

/// Error over the floor up to which a fit has reached it.
pub(crate) const AT_FLOOR: f64 = 1.05;

/// Options of a diagnosis.
#[derive(Debug, Clone, PartialEq)]
pub struct GapOptions {
    /// Base model.
    pub base: Base,
    /// Ids of effects excluded from the catalogue.
    pub without: Vec<String>,
    /// Try a second effect beside the first even if one explains the record.
    pub pairs: bool,
    /// Most model responses per search; a recorded valve position and pairs add one search each.
    pub budget_evaluations: u64,
    /// Seed of all random choices.
    pub seed: u64,
    /// Period of the oscillation in points, if known.
    pub period_points: Option<f64>,
    /// Other loops on the record's grid, each a possible load.
    pub neighbours: Vec<Neighbour>,
}

impl GapOptions {
    /// Whether the diagnosis tries this effect.
    pub(super) fn asks(&self, id: &str) -> bool {
        !self.without.iter().any(|left_out| left_out == id)
    }
}

impl Default for GapOptions {
    fn default() -> Self {
        Self {
            base: Base::Refit,
            without: Vec::new(),
            pairs: false,
            budget_evaluations: super::DEFAULT_EVALUATIONS,
            seed: 1,
            period_points: None,
            neighbours: Vec::new(),
        }
    }
}

/// Execution of the work: the caller supplies threads and a clock; results depend on neither. A scope of threads
/// (`std::thread::scope`) fits, because jobs borrow.
pub trait Executor: Sync {
    /// Runs each of `job(0)` to `job(jobs - 1)` once, in any order, and returns when all are done; a panic of a job is passed
    /// on.
    fn run(&self, jobs: usize, job: &(dyn Fn(usize) + Sync));
    /// Called between rounds with the number of evaluations; returning false ends the search with the results so far.
    fn tick(&self, done: u64) -> bool;
}

/// Runs jobs in sequence and never stops early.
#[derive(Debug, Clone, Copy, Default)]
pub struct Serial;

impl Executor for Serial {
    fn run(&self, jobs: usize, job: &(dyn Fn(usize) + Sync)) {
        (0..jobs).for_each(job);
    }

    fn tick(&self, _done: u64) -> bool {
        true
    }
}

/// Why a search ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Ended {
    /// The base leaves only noise.
    Noise,
    /// The base with an effect leaves only noise.
    Explained,
    /// The last round gained almost nothing.
    Agreement,
    /// All rounds were made.
    Complete,
    /// The budget was used up.
    Budget,
    /// Stopped on request.
    Stopped,
}

/// Statistics of the search.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SearchNote {
    /// Model responses of all searches: base and effects, with a recorded valve position, pairs.
    pub evaluations: u64,
    /// Most responses per search.
    pub budget: u64,
    /// Why the search for base and effects ended: `noise`, `explained`, `agreement`, `complete`, `budget` or `stopped`.
    pub ended: Ended,
}

/// Where an effect acts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// Between OP and the flow.
    Valve,
    /// Between the flow and PV.
    Process,
    /// An external disturbance.
    Disturbance,
    /// In the measurement or its recording.
    Measurement,
    /// In the operation of the loop.
    Operation,
    /// Unknown from this record.
    CannotTell,
    /// There is no gap.
    None,
}

impl Stage {
    /// Word of the stage in documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Valve => "valve",
            Self::Process => "process",
            Self::Disturbance => "disturbance",
            Self::Measurement => "measurement",
            Self::Operation => "operation",
            Self::CannotTell => "cannot_tell",
            Self::None => "none",
        }
    }
}

/// Why windows cannot be judged together.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PoolError {
    /// Fewer than two windows.
    #[error("one window only: give the files or sections of at least two")]
    Single,
    /// The same data twice.
    #[error("{source_name}: the same data as {other}; leave one of them out")]
    Twice {
        /// The later of the two.
        source_name: String,
        /// The earlier.
        other: String,
    },
    /// A window from which nothing can be judged.
    #[error(
        "{0}: the base model leaves more of held-out PV than PV's mean does, so this window can decide nothing; leave it out"
    )]
    NotJudged(String),
}

/// Why no diagnosis was possible.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GapError {
    /// Record too short.
    #[error("the section has {points} points, but a diagnosis needs {needed}; choose a longer section")]
    TooShort {
        /// Points in the record.
        points: usize,
        /// Points needed.
        needed: usize,
    },
    /// A constant signal.
    #[error("{signal} is constant (spread {spread} over {points} points); choose a section in which it moves")]
    Still {
        /// Name of the signal.
        signal: &'static str,
        /// Its spread.
        spread: f64,
        /// Points in the record.
        points: usize,
    },
    /// An unknown effect.
    #[error("there is no effect {id:?}; choose from {known}")]
    UnknownEffect {
        /// As given.
        id: String,
        /// All ids.
        known: String,
    },
    /// A model that cannot be simulated on this record.
    #[error("the given model: {0}")]
    Model(#[from] super::model::ModelError),
    /// A neighbour that cannot be offered.
    #[error(transparent)]
    Neighbour(#[from] NeighbourError),
    /// Windows that cannot be judged together.
    #[error(transparent)]
    Pool(#[from] PoolError),
    /// No base model fits.
    #[error(
        "no base model fits the {points} points ({evaluations} evaluations): PV does not follow OP; choose another section or check the tags"
    )]
    NoBase {
        /// Points in the record.
        points: usize,
        /// Evaluations used.
        evaluations: u64,
    },
}

/// A movement of the stem.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slip {
    /// Point of the record at which it occurs.
    pub point: usize,
    /// +1 up, -1 down.
    pub direction: f64,
    /// Size, OP units, >= 0.
    pub size: f64,
}

/// A fitted parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// Name, including the unit if there is one.
    pub name: &'static str,
    /// Value in `unit`.
    pub value: f64,
    /// Unit: `OP`, `PV`, `s`, `PV/s`, `OP/s`, `Hz`, `1`, ….
    pub unit: &'static str,
}

/// A model fitted to the training blocks, and its residuals in free run.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// `base`, `given`, or the id of the added effect.
    pub id: String,
    /// The model in recorded units.
    pub model: Model,
    /// Flow at each point, OP units: before the valve's characteristic, without drift and change of dead time.
    pub valve: Vec<f64>,
    /// Movements of the stem in time order.
    pub slips: Vec<Slip>,
    /// Free-run prediction at each point, PV units; valid from [`Blocks::from`].
    pub prediction: Vec<f64>,
    /// Root mean squared error on the training blocks, PV units.
    pub rmse_train: f64,
    /// Root mean squared error on the held-out blocks, PV units.
    pub rmse: f64,
    /// Part of the held-out error above the noise floor, PV units; the full error if there is no floor.
    pub gap: f64,
    /// Number of free parameters, linear ones included.
    pub parameters: usize,
    /// Number of model responses computed for it.
    pub evaluations: u64,
    /// Whether its training error is within 5 % of the noise floor.
    pub at_floor: bool,
    /// Fitted points.
    pub points: usize,
    /// How likely PV is one step ahead.
    pub one_step: OneStep,
}

/// Log likelihood of PV one step ahead, nats a point in PV's standard deviations, at fitted and at held-out points: for noise that is
/// white, then an autoregression of first to fourth order, fitted to the former. Zero in a record of too few points.
pub type OneStep = [[f64; 2]; 5];

/// Noise that no model explains.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Floor {
    /// Standard deviation of PV's noise, PV units: of its white part, of the stored values if a historian thinned PV, or after a
    /// filter; `None` if held or compressed PV has too few stored values.
    pub noise_sd: Option<f64>,
    /// Noise floor of a free run: `noise_sd` and the share of PV's quantum combined.
    pub noise_floor: Option<f64>,
}

/// What comparing other loops with this one came to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Compared {
    /// Loops that were offered.
    pub offered: usize,
    /// The loop whose past tells most of PV beyond its own past and OP.
    pub best: Option<String>,
    /// Share of the prediction error of own past and OP that it takes, on the fitted blocks.
    pub share: Option<f64>,
    /// Share of shifts in time at which the best of all loops tells as much; `None` in a record of few periods.
    pub p_value: Option<f64>,
    /// The loop whose past the noise model has as a load in both halves of the record, where chance is rare enough.
    pub acts: Option<String>,
    /// Loops that were fitted, best first: rare enough, and telling from their past, not from their future.
    pub fitted: Vec<String>,
}

/// Use of each point.
#[derive(Debug, Clone, PartialEq)]
pub struct Blocks {
    /// First valid point; earlier ones depend on the valve's unknown past.
    pub from: usize,
    /// Length of a block, points.
    pub length: usize,
    /// Held out for testing, per point.
    pub held_out: Vec<bool>,
    /// Excluded from everything (by PV alone), per point.
    pub masked: Vec<bool>,
    /// Number of the block, per point.
    pub number: Vec<usize>,
}

/// A trace of an effect in the data itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "Trace"))]
pub struct Signature {
    /// The effect that it indicates.
    pub id: String,
    /// Measured value.
    pub value: f64,
    /// Threshold of the value.
    pub threshold: f64,
    /// Whether the threshold is reached.
    pub met: bool,
    /// Size of the trace: quantum (PV units), held share, level of the clip (PV units), outliers a thousand, ….
    #[serde(skip)]
    pub parameters: Vec<Parameter>,
}

/// An effect added to the base.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct EffectNote {
    /// Its id, or two joined by `+`.
    pub id: String,
    /// Where it acts.
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub stage: Stage,
    /// Its parameters as fitted.
    pub parameters: BTreeMap<String, Quantity>,
    /// Gap of the base, PV units.
    pub gap_before: f64,
    /// Gap with the effect.
    pub gap_after: f64,
    /// Noise floor with the effect, PV units, for effects that a free run cannot predict.
    pub floor_after: Option<f64>,
    /// 100 (1 - after / before); `None` if undefined.
    pub closed_pct: Option<f64>,
    /// 90 % interval of it.
    pub closed_interval: Option<[f64; 2]>,
    /// Gain in training log mean squared error over the base, after BIC.
    pub evidence: f64,
    /// Evidence minus the margin needed for naming it.
    pub lead: f64,
    /// Effects that are indistinguishable from it.
    pub confusable_with: Vec<String>,
    /// The measurement that would distinguish it.
    pub separated_by: String,
    /// Whether its training error reaches the noise floor; `None` for effects without simulation.
    pub at_floor: Option<bool>,
    /// Whether it is a wave with the period of the sticking valve's limit cycle, which makes it.
    #[serde(default, skip_serializing_if = "core::ops::Not::not")]
    pub own_cycle: bool,
    /// Whether it is a load that begins while PV answers a move of the set point the same way.
    #[serde(default, skip_serializing_if = "core::ops::Not::not")]
    pub follows_set_point: bool,
    /// Whether it was simulated rather than read from PV.
    #[serde(skip)]
    pub simulated: bool,
    /// The refitted model; for an effect read from PV, the base with the historian's artefact, if present and suited to a free
    /// run. Documents are without.
    #[serde(skip)]
    pub fit: Option<Fit>,
}

impl EffectNote {
    /// Whether it closes more than next to nothing of the gap, or that is not known.
    #[must_use]
    pub(crate) fn leads(&self) -> bool {
        self.closed_pct.is_none_or(|closed| closed >= LITTLE_PCT)
    }
}

/// The answer.
#[derive(Debug, Clone, PartialEq)]
pub struct Cause {
    /// An effect's id, two joined by `+`, `none` or `unknown`.
    pub id: String,
    /// Calibrated probability that the answer is right.
    pub probability: f64,
    /// Whether held-out blocks and the forward prediction confirm it; false means "suspected".
    pub confirmed: bool,
    /// Where it acts.
    pub stage: Stage,
}

/// Another possible answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "AlternativeNote"))]
pub struct Alternative {
    /// An id as of the cause.
    pub id: String,
    /// Probability that the answer is right.
    pub probability: f64,
}

/// Gaps over the second part for models fitted to the first part.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "ForwardNote"))]
pub struct Forward {
    /// Gap of the base, PV units.
    pub gap_before: f64,
    /// Gap with the cause, PV units.
    pub gap_after: f64,
    /// 100 (1 - after / before).
    pub closed_pct: Option<f64>,
}

impl Forward {
    /// Of the gaps before and after, PV units.
    #[must_use]
    pub(super) fn new([gap_before, gap_after]: [f64; 2]) -> Self {
        let pct = 100.0 * (1.0 - gap_after / gap_before);
        Self { gap_before, gap_after, closed_pct: (gap_before > 0.0 && pct.is_finite()).then_some(pct) }
    }
}

/// How much of PV the closed loop predicts from SP alone, after the part that model and controller were fitted to.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FromSp {
    /// Share of PV's variance that the base predicts, %; below 0 it is worse than PV's mean.
    pub base_pct: f64,
    /// The same with the cause.
    pub after_pct: Option<f64>,
    /// The same were PV equal to SP: what any loop that follows its set point reaches.
    pub sp_pct: f64,
    /// Time over which PV was averaged before, s: a limit cycle's phase cannot be predicted from SP.
    pub averaged_s: Option<f64>,
}

/// The experiment that distinguishes the two best answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "TestNote"))]
pub struct NextTest {
    /// `op` or `sp`.
    pub signal: String,
    /// Height of the bump, units of the signal.
    pub size: f64,
    /// Its duration, s.
    pub duration_s: f64,
    /// The two answers.
    pub separates: [String; 2],
    /// Probability that it distinguishes them.
    pub p: f64,
    /// How long the whole test takes, s.
    #[serde(default)]
    pub total_s: f64,
    /// How far PV goes, PV units.
    #[serde(default)]
    pub moves_pv: f64,
}

/// The free runs, one value per point, PV units; `None` if not simulated.
#[derive(Debug, Clone, PartialEq)]
pub struct Predictions {
    /// Base model.
    pub pv_base: Vec<Option<f64>>,
    /// With the cause; the base's own for `none` and `unknown`.
    pub pv_after: Vec<Option<f64>>,
}

/// Partial gaps if the valve position is recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct Stages {
    /// OP to MV (free gain and offset), % of MV's variance above its floor.
    pub op_to_mv: f64,
    /// MV to PV: gap of the first-order process driven by MV, PV units.
    pub mv_to_pv: f64,
    /// Where the gap is.
    pub stage: Stage,
}
