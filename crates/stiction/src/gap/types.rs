//! What the diagnosis is asked and what it answers.

use serde::{Deserialize, Serialize};

use super::model::Model;

/// Id of an effect, as it stands in documents.
pub type EffectId = &'static str;

/// Id of the answer that the base explains the record.
pub const NONE: &str = "none";
/// Id of the answer that something departs from the base which no effect of the catalogue explains.
pub const UNKNOWN: &str = "unknown";

/// From which model the gap is measured.
#[derive(Debug, Clone, Default, PartialEq)]
pub enum Base {
    /// He's law with a first-order process, refitted.
    #[default]
    Refit,
    /// The same process without a sticking valve: stiction itself is an effect.
    Linear,
    /// A model from elsewhere; the refitted base is measured beside it.
    Given(Box<Model>),
}

/// What is asked of a record.
#[derive(Debug, Clone, PartialEq)]
pub struct GapOptions {
    /// The base.
    pub base: Base,
    /// Ids of effects that are taken out of the catalogue.
    pub without: Vec<String>,
    /// Pairs of effects even where one alone explains the record; elsewhere they are tried unasked.
    pub pairs: bool,
    /// Model responses that a search may compute; a recorded valve position and pairs each bring another search.
    pub budget_evaluations: u64,
    /// Seed of every random choice.
    pub seed: u64,
    /// Period of the oscillation, points, where one is known.
    pub period_points: Option<f64>,
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
        }
    }
}

/// Who does the work: the shell brings threads and a clock, results depend on neither.
pub trait Executor: Sync {
    /// Runs `job(0)` to `job(jobs - 1)`, in any order, and returns when all are done.
    fn run(&self, jobs: usize, job: &(dyn Fn(usize) + Sync));
    /// Told how many evaluations are done between rounds; false ends the search with what is known.
    fn tick(&self, done: u64) -> bool;
}

/// One after the other, to the end.
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
    /// The base leaves nothing but noise.
    Noise,
    /// The base with an effect leaves nothing but noise.
    Explained,
    /// Another round gained next to nothing.
    Agreement,
    /// All rounds were made.
    Complete,
    /// The budget was spent.
    Budget,
    /// It was told to end.
    Stopped,
}

/// Where an effect acts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// Between OP and the flow.
    Valve,
    /// Between the flow and PV.
    Process,
    /// From outside.
    Disturbance,
    /// In the measurement or its recording.
    Measurement,
    /// In how the loop is operated.
    Operation,
    /// The record cannot tell.
    CannotTell,
    /// Nothing departs.
    None,
}

impl Stage {
    /// The stage's word in documents.
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

/// Why no diagnosis could be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GapError {
    /// Too short.
    #[error("{points} points, but a diagnosis needs {needed}: give it a longer section")]
    TooShort {
        /// Points in the record.
        points: usize,
        /// Points needed.
        needed: usize,
    },
    /// A signal that never moves.
    #[error("{signal} never moves (spread {spread} over {points} points): choose a section in which it does")]
    Still {
        /// Which one.
        signal: &'static str,
        /// Its spread.
        spread: f64,
        /// Points in the record.
        points: usize,
    },
    /// An id that is not in the catalogue.
    #[error("no effect is called {id:?}; there are {known}")]
    UnknownEffect {
        /// As given.
        id: String,
        /// All ids.
        known: String,
    },
    /// A model that cannot be simulated on this record.
    #[error("the given model: {0}")]
    Model(#[from] super::model::ModelError),
    /// No model of the base class can be fitted.
    #[error(
        "no base model could be fitted to {points} points after {evaluations} evaluations: nothing in PV follows OP"
    )]
    NoBase {
        /// Points in the record.
        points: usize,
        /// Evaluations spent.
        evaluations: u64,
    },
}

/// A move of the stem.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slip {
    /// Point of the record at which it happens.
    pub point: usize,
    /// +1 up, -1 down.
    pub direction: f64,
    /// Size of the move, OP units, >= 0.
    pub size: f64,
}

/// A parameter as fitted.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// Name, with its unit unless it has none.
    pub name: &'static str,
    /// Value in `unit`.
    pub value: f64,
    /// Unit: `OP`, `PV`, `s`, `PV/s`, `OP/s`, `Hz`, `1`, ….
    pub unit: &'static str,
}

/// One model fitted to the training blocks, and what its free run leaves.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// `base`, `given`, or the id of the effect that was added.
    pub id: String,
    /// The model in recorded units.
    pub model: Model,
    /// Valve signal at each point, OP units: what enters the process.
    pub valve: Vec<f64>,
    /// Moves of the stem, in order of time.
    pub slips: Vec<Slip>,
    /// Free-run prediction at each point, PV units; counts from [`Blocks::from`] on.
    pub prediction: Vec<f64>,
    /// Dead time, s.
    pub dead_time_s: f64,
    /// Time constants, s, largest first.
    pub time_constants_s: Vec<f64>,
    /// Root mean squared error on the training blocks, PV units.
    pub rmse_train: f64,
    /// The same on the held-out blocks.
    pub rmse: f64,
    /// What it leaves above the noise floor on the held-out blocks, PV units; the rmse itself where there is no floor.
    pub gap: f64,
    /// Free parameters, linear ones included.
    pub parameters: usize,
    /// Model responses computed for it.
    pub evaluations: u64,
    /// Whether its training error is at the noise floor (within 5 %).
    pub at_floor: bool,
    /// Gain of an autoregression of what it leaves, log mean squared training error: near 0 where that is white.
    pub colour: f64,
    /// Largest correlation of what it leaves with OP or its moves before, in standard errors of white noise.
    pub with_op: f64,
}

/// The noise that no model explains.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Floor {
    /// Standard deviation of PV's noise, PV units: of its white part, of the stored values where a recorder thinned PV, or
    /// behind a filter; `None` on held or compressed PV with too few of them.
    pub noise_sd: Option<f64>,
    /// Quantum of PV, PV units; `None` where it is not on a grid.
    pub quantum: Option<f64>,
    /// `noise_sd` and the quantum's share together: what free run cannot get below.
    pub noise_floor: Option<f64>,
    /// Standard deviation from the best residual's high band, PV units: the check of `noise_sd`.
    pub high_band_sd: Option<f64>,
}

/// Which points count for what.
#[derive(Debug, Clone, PartialEq)]
pub struct Blocks {
    /// First point that counts; before it the valve's past has a say.
    pub from: usize,
    /// Length of a block, points.
    pub length: usize,
    /// Held out (tested on), per point.
    pub held_out: Vec<bool>,
    /// Left out of everything (from PV alone), per point.
    pub masked: Vec<bool>,
    /// Number of the block, per point.
    pub number: Vec<usize>,
}

/// A trace that an effect leaves in the data itself.
#[derive(Debug, Clone, PartialEq)]
pub struct Signature {
    /// The effect it speaks for.
    pub id: EffectId,
    /// Measured value.
    pub value: f64,
    /// Value from which it speaks.
    pub threshold: f64,
    /// Whether it does.
    pub met: bool,
    /// Size of the trace: quantum (PV units), held share, level of the clip (PV units), outliers a thousand, ….
    pub parameters: Vec<Parameter>,
}

/// One effect added to the base.
#[derive(Debug, Clone, PartialEq)]
pub struct EffectResult {
    /// The effect, or two joined by `+` in alphabetical order.
    pub id: String,
    /// Where it acts.
    pub stage: Stage,
    /// Whether it was added to the simulation, and not read from PV.
    pub simulated: bool,
    /// Its parameters.
    pub parameters: Vec<Parameter>,
    /// Gap of the base on held-out blocks, PV units.
    pub gap_before: f64,
    /// Gap with the effect.
    pub gap_after: f64,
    /// The floor with the effect, PV units, for effects that free run cannot predict.
    pub floor_after: Option<f64>,
    /// 100 (1 - after / before); `None` where it says nothing.
    pub closed_pct: Option<f64>,
    /// 90 % block-bootstrap interval of it.
    pub closed_interval: Option<[f64; 2]>,
    /// Gain in training log mean squared error over the base.
    pub raw_gain: f64,
    /// The same after BIC; what effects are ranked by.
    pub evidence: f64,
    /// Evidence less the effect's margin: named only when positive.
    pub lead: f64,
    /// Effects that fit nearly as well or that no record of OP and PV can tell from it.
    pub confusable_with: Vec<EffectId>,
    /// The measurement that would settle it.
    pub separated_by: &'static str,
    /// The refitted model; for an effect that is seen in PV the base with what the recorder did to it, where it is met and
    /// a free run can follow it.
    pub fit: Option<Fit>,
}

/// The answer.
#[derive(Debug, Clone, PartialEq)]
pub struct Cause {
    /// An effect's id, two joined by `+`, `none` or `unknown`.
    pub id: String,
    /// Calibrated probability that it is right.
    pub probability: f64,
    /// Whether held-out blocks and the run forward in time confirm it; false is "suspected".
    pub confirmed: bool,
    /// Where it acts.
    pub stage: Stage,
}

/// Another answer that is not excluded.
#[derive(Debug, Clone, PartialEq)]
pub struct Alternative {
    /// As [`Cause::id`].
    pub id: String,
    /// Calibrated probability.
    pub probability: f64,
}

/// Base and best model fitted to the first part, run freely over the rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Forward {
    /// Gap of the base, PV units.
    pub gap_before: f64,
    /// Gap with the cause.
    pub gap_after: f64,
}

/// The smallest experiment that tells the two best answers apart.
#[derive(Debug, Clone, PartialEq)]
pub struct NextTest {
    /// `op` or `sp`.
    pub signal: &'static str,
    /// Height of the bump, units of the signal.
    pub size: f64,
    /// Its duration, s.
    pub duration_s: f64,
    /// The two ids.
    pub separates: [String; 2],
    /// Probability that the better one is told.
    pub p: f64,
}

/// The free runs, one entry a point, PV units; `None` where not simulated.
#[derive(Debug, Clone, PartialEq)]
pub struct Predictions {
    /// The base's.
    pub pv_base: Vec<Option<f64>>,
    /// With the cause; the base's own for `none` and `unknown`.
    pub pv_after: Vec<Option<f64>>,
    /// Held out.
    pub held_out: Vec<bool>,
    /// Left out of everything.
    pub masked: Vec<bool>,
}

/// What the noise models make of the base's residual.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct NoiseModels {
    /// Gain in training log mean squared error of an autoregressive model of the best residual, one step ahead.
    pub over_base: f64,
    /// By how much it beats the best structural model, log mean squared error.
    pub over_best: f64,
    /// Smallest p of independence from OP, its moves, cycle phase and level.
    pub independence_p: f64,
    /// Whether the autoregression leaves white noise.
    pub whitens: bool,
    /// By how much an autoregression of higher order beats one of first order, log mean squared error: what swings or
    /// answers moves is of higher order than noise with a memory.
    pub beyond_first: f64,
}

/// What noise models make of what is left by the base's place that is best one step ahead.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Alone {
    /// The same; first order is that of a memory under white noise.
    pub models: NoiseModels,
    /// Excess kurtosis of the innovations: 0 for noise, large where a few of them are slips that the model lacks.
    pub tails: f64,
}

/// The position behind the friction, where it is recorded: two gaps.
#[derive(Debug, Clone, PartialEq)]
pub struct Stages {
    /// OP to MV (free gain and offset), % of MV's variance left above its floor.
    pub op_to_mv: f64,
    /// MV to PV: gap of the first-order process driven by MV, PV units.
    pub mv_to_pv: f64,
    /// The stage that holds the gap.
    pub stage: Stage,
}
