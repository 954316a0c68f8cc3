//! Types of one estimate, as in `stictiond.estimate.v1`.

use crate::core::ident::region::{Region, Size};
use crate::core::ident::slip_search::stages::Ended;
use crate::core::optim::SolverName;
use crate::core::sim::slips::Law;
use serde::{Deserialize, Serialize};

use super::cause::Missing;
use super::prevalence::CALIBRATED_FOR;
pub use super::process::Process;
use super::rule::Opinion;
use super::valve_position::ValvePosition;
use crate::core::detect::Indicator;
pub use crate::core::ident::ESTIMATE_SCHEMA;
use crate::core::ident::{FitBasis, Model};
use crate::core::record::Record;
use crate::core::units::Moment;

/// Verdict on one window.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The valve sticks and slips.
    Stiction,
    /// The valve has a dead band without a slip jump.
    Deadband,
    /// An external disturbance makes the loop oscillate.
    Disturbance,
    /// The controller makes the loop oscillate.
    Tuning,
    /// The loop does not oscillate, and no sign of stiction was found.
    #[serde(alias = "no_oscillation")]
    NotOscillating,
    /// The loop oscillates, and no cause was found.
    #[serde(alias = "no_stiction")]
    CauseUnknown,
    /// The window is inconclusive; the validity checks give the reason.
    Inconclusive,
}

impl Verdict {
    /// All verdicts.
    pub const ALL: [Self; 7] = [
        Self::Stiction,
        Self::Deadband,
        Self::Disturbance,
        Self::Tuning,
        Self::NotOscillating,
        Self::CauseUnknown,
        Self::Inconclusive,
    ];

    /// The verdict's word in documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Stiction => "stiction",
            Self::Deadband => "deadband",
            Self::Disturbance => "disturbance",
            Self::Tuning => "tuning",
            Self::NotOscillating => "not_oscillating",
            Self::CauseUnknown => "cause_unknown",
            Self::Inconclusive => "inconclusive",
        }
    }

    /// True for a sticking valve, false for another verdict, `None` if inconclusive.
    #[must_use]
    pub const fn stiction(self) -> Option<bool> {
        match self {
            Self::Stiction | Self::Deadband => Some(true),
            Self::Inconclusive => None,
            _ => Some(false),
        }
    }
}

/// A named validity check that limits the answer or prevents it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Gate {
    /// The controller was in manual.
    Manual,
    /// Too many values were missing or bad.
    BadQuality,
    /// PV never moved.
    FrozenPv,
    /// OP never moved.
    FrozenOp,
    /// OP ran on while PV stayed away from its set point: PV does not answer OP.
    NoResponse,
    /// OP looks like a fraction of its range, 0 to 1.
    OpScale,
    /// OP follows the set point, and PV does not: the two seem to be swapped.
    Swapped,
    /// OP was at a limit.
    Saturated,
    /// Fewer than 30 usable samples, or fewer than 2 periods.
    TooFewSamples,
    /// Fewer than 10 samples in a period: nothing can be said of its cause.
    RateTooLow,
    /// The window was not fitted: the machine was too busy, or the daemon stopped.
    Skipped,
    /// Fewer periods than required.
    TooFewPeriods,
    /// Fewer samples per period than required.
    TooCoarse,
    /// Neither enough periods nor enough reversals of the stem: the window is inconclusive.
    TooFewReversals,
    /// The set point moved in steps.
    SetpointSteps,
    /// OP or PV has a coarse resolution.
    Quantised,
    /// The history was compressed: values repeat or are on straight lines.
    Compressed,
    /// The sampling time is not constant.
    Irregular,
    /// A single event, such as a trip or a start-up, was removed.
    Excursion,
    /// A single event was kept: without a set point a step cannot be told from an upset.
    StepOrUpset,
}

impl Gate {
    /// All validity checks, blocking ones first.
    pub const ALL: [Self; 20] = [
        Self::Manual,
        Self::BadQuality,
        Self::FrozenPv,
        Self::FrozenOp,
        Self::NoResponse,
        Self::OpScale,
        Self::Swapped,
        Self::Saturated,
        Self::TooFewSamples,
        Self::RateTooLow,
        Self::Skipped,
        Self::TooFewPeriods,
        Self::TooCoarse,
        Self::TooFewReversals,
        Self::SetpointSteps,
        Self::Quantised,
        Self::Compressed,
        Self::Irregular,
        Self::Excursion,
        Self::StepOrUpset,
    ];

    /// Whether the check prevents any answer.
    #[must_use]
    pub(crate) const fn blocks(self) -> bool {
        matches!(
            self,
            Self::Manual
                | Self::BadQuality
                | Self::FrozenPv
                | Self::FrozenOp
                | Self::NoResponse
                | Self::OpScale
                | Self::Swapped
                | Self::Saturated
                | Self::TooFewSamples
                | Self::RateTooLow
                | Self::Skipped
        )
    }

    /// The word in documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Manual => "manual",
            Self::BadQuality => "bad_quality",
            Self::FrozenPv => "frozen_pv",
            Self::FrozenOp => "frozen_op",
            Self::NoResponse => "no_response",
            Self::OpScale => "op_scale",
            Self::Swapped => "swapped",
            Self::Saturated => "saturated",
            Self::TooFewSamples => "too_few_samples",
            Self::RateTooLow => "rate_too_low",
            Self::Skipped => "skipped",
            Self::TooFewPeriods => "too_few_periods",
            Self::TooCoarse => "too_coarse",
            Self::TooFewReversals => "too_few_reversals",
            Self::SetpointSteps => "setpoint_steps",
            Self::Quantised => "quantised",
            Self::Compressed => "compressed",
            Self::Irregular => "irregular",
            Self::Excursion => "excursion",
            Self::StepOrUpset => "step_or_upset",
        }
    }
}

/// The rule by which a window holds enough evidence.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum CountedBy {
    /// Enough periods of enough samples each.
    Periods,
    /// Enough reversals of the stem.
    Reversals,
}

/// Reason of a loop whose final element is declared to be no valve.
pub const NO_VALVE: &str = "no_valve";
/// Words of [`Assessment::reason`] that are not the name of a blocking check.
const REASONS: [&str; 12] = [
    NO_VALVE,
    "stuck_signal",
    "implausible_model",
    "daily_cycle",
    "trend",
    "op_held",
    "too_few_reversals",
    // Of documents from before reversals were counted.
    "too_coarse",
    "too_few_periods",
    "not_fitted",
    "screened",
    "masked",
];

/// Every word of [`Assessment::reason`].
pub fn reasons() -> impl Iterator<Item = &'static str> {
    Gate::ALL.into_iter().filter(|gate| gate.blocks()).map(Gate::name).chain(REASONS)
}

/// An implausible property of a model or its record.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Implausible {
    /// The cycle takes a day: sun, shifts or load, not the valve.
    DailyCycle,
    /// PV is little more than a straight line.
    Trend,
    /// The dead time is longer than usual for such loops, or than half the period of the loop.
    DeadTime,
    /// A time constant is longer than usual for such loops, or than the window.
    TimeConstant,
    /// The gain would drive PV far out of its recorded range.
    Gain,
    /// Such loops do not integrate.
    Integrating,
    /// The model follows PV hardly better than its mean.
    Fit,
}

impl Implausible {
    /// Its word in documents.
    #[must_use]
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::DailyCycle => "daily_cycle",
            Self::Trend => "trend",
            Self::DeadTime => "dead_time",
            Self::TimeConstant => "time_constant",
            Self::Gain => "gain",
            Self::Integrating => "integrating",
            Self::Fit => "fit",
        }
    }

    /// Whether the record shows no cycle of a valve, rather than the model being wrong.
    #[must_use]
    pub(crate) const fn is_of_the_record(self) -> bool {
        matches!(self, Self::DailyCycle | Self::Trend)
    }
}

/// The time range of an estimate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Window {
    /// Timestamp of the first sample, ns since 1970.
    pub start_ns: i64,
    /// End of the window and its name, ns since 1970.
    pub end_ns: i64,
    /// The start, RFC 3339.
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub start: Moment,
    /// The end, RFC 3339.
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub end: Moment,
    /// Raw samples.
    pub samples: usize,
    /// Mean sampling time, s.
    pub ts_s: f64,
    /// Raw samples per point of the fit (1: raw).
    pub box_samples: usize,
}

impl Window {
    /// The window of a record.
    #[must_use]
    pub const fn of(record: &Record) -> Self {
        Self {
            start_ns: record.start_ns,
            end_ns: record.end_ns,
            start: Moment(record.start_ns),
            end: Moment(record.end_ns),
            samples: record.raw_samples,
            ts_s: record.recorded_ts_s,
            box_samples: record.box_samples,
        }
    }
}

/// The oscillation and its regularity.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Oscillation {
    /// Whether there is a regular one.
    pub oscillating: bool,
    /// Period, s.
    pub period_s: Option<f64>,
    /// Periods in the window.
    pub periods: Option<f64>,
    /// Raw samples per period; a PV that is held over several counts once.
    pub samples_per_period: Option<f64>,
    /// Thornhill's regularity: a third of mean over standard deviation of the intervals between zero crossings.
    pub regularity: Option<f64>,
}

/// The controller identified from the record.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Controller {
    /// Proportional gain, OP units per PV unit of SP - PV; negative if OP rises with PV.
    pub kc: f64,
    /// Integral time, s; infinite (null in JSON) without integral action.
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub ti_s: f64,
    /// Derivative time, s.
    pub td_s: f64,
    /// Samples by which OP is recorded after the PV from which it was computed.
    pub lag_samples: f64,
    /// Share of OP's moves that the controller model explains.
    pub r2: f64,
    /// Share of the window, 0..1, in stretches that it does not explain: another mode or other settings.
    pub unexplained: f64,
}

/// Everything in an estimate that depends on its window alone. The field order is that of the document.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Assessment {
    /// The window.
    pub window: Window,
    /// The oscillation of OP and PV.
    pub oscillation: Oscillation,
    /// The verdict.
    pub verdict: Verdict,
    /// Other causes that contribute.
    pub contributing: Vec<Verdict>,
    /// What is missing to name a cause, where the verdict is `cause_unknown` or `not_oscillating`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub missing: Vec<Missing>,
    /// Whether the valve sticks; `None` if the window is inconclusive.
    pub stiction: Option<bool>,
    /// Why there is no answer: the first blocking validity check, `too_few_reversals` (neither enough periods nor enough
    /// reversals of the stem), `stuck_signal` (PV is constant while OP moves), `not_fitted`, `implausible_model` (no plausible
    /// model), `daily_cycle`, `trend` or `op_held` (OP is stored too rarely to show the valve's input); `no_valve` (the final element is declared to be none); `masked` (an oscillation that it shares with other
    /// loops hides the valve's state); or why there is only a verdict: `screened` (a calm loop, for which nothing else was computed).
    pub reason: Option<&'static str>,
    /// Probability of stiction where `prevalence` of such valves stick, 0..1; `None` behind a blocking validity check and for a
    /// screened loop.
    pub p_stiction: Option<f64>,
    /// The same where half of them stick, as in the sets that the classifier is calibrated on: verdict, grade and alarm follow
    /// from this one.
    pub p_calibrated: Option<f64>,
    /// Share of such loops that is assumed to stick, 0..1.
    pub prevalence: f64,
    /// The larger of `p_calibrated` and 1 - `p_calibrated`; `None` where `stiction` is.
    pub confidence: Option<f64>,
    /// Validity checks that the window failed.
    pub gates: Vec<Gate>,
    /// Implausible properties of the model or the cycle; the model's numbers are then not given.
    pub implausible: Vec<Implausible>,
    /// Grade of the answer, A to C; `None` where no stiction was found.
    pub grade: Option<char>,
    /// Static band, OP units. The bands measure the valve only where `stiction` is `Some(true)`.
    pub fs: Option<f64>,
    /// Kinetic band, OP units.
    pub fd: Option<f64>,
    /// Dead band plus stick band, fs + fd, OP units.
    pub s: Option<f64>,
    /// Slip jump, fs - fd, OP units.
    pub j: Option<f64>,
    /// Interval of `fs`.
    pub fs_interval: Option<[f64; 2]>,
    /// Interval of `fd`.
    pub fd_interval: Option<[f64; 2]>,
    /// Interval of `s`; where no stiction was found it starts at 0, and only its upper end means anything.
    pub s_interval: Option<[f64; 2]>,
    /// Interval of `j`.
    pub j_interval: Option<[f64; 2]>,
    /// s of each third of the window that tells it, fitted by itself, OP units; empty where the thirds were not asked.
    pub s_thirds: Vec<f64>,
    /// Level of the intervals, 0.9.
    pub interval_level: Option<f64>,
    /// Whether the record identifies j: false too where its interval reaches from a dead band to a slip, or from a slip with play
    /// to one without.
    pub j_identifiable: Option<bool>,
    /// Smallest s that this window would have shown, OP units; `None` where stiction was found or it cannot be determined.
    pub s_detectable: Option<f64>,
    /// By which rule the window counts for an alarm; `None` for one that neither raises nor clears it.
    pub counted_by: Option<CountedBy>,
    /// Times that the stem changed its direction: that of the fitted valve where it is said to stick, else one that follows
    /// OP. `None` behind a blocking validity check.
    pub reversals: Option<usize>,
    /// 1 - error with stiction / error without, 0..1.
    pub stiction_index: Option<f64>,
    /// s over the span of OP in the window.
    pub s_over_span: Option<f64>,
    /// Where (fs, fd) lies in the plane of the valve model.
    pub region: Option<Region>,
    /// Class of s by the span of OP.
    pub strength_by_span: Option<Size>,
    /// Class of s by the range of OP, where that is known.
    pub severity_by_range: Option<Size>,
    /// OP's range, where it is known: sizes are then told in % of it.
    pub op_range: Option<[f64; 2]>,
    /// Unit of OP and of the bands, where it is known.
    pub op_unit: Option<String>,
    /// The valve model that fits better.
    pub valve_model: Option<Law>,
    /// The fitted process.
    pub process: Option<Process>,
    /// The error that was minimised, and how the order was chosen.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fitted_by: Option<FitBasis>,
    /// Span of PV in the window (0.5 to 99.5 percentile), PV units.
    pub pv_span: Option<f64>,
    /// The controller, where the record identifies one.
    pub controller: Option<Controller>,
    /// Indicators that need no valve model.
    pub indicators: Vec<Indicator>,
    /// Sum of the indicators' contributions, logits.
    pub explanation: Option<Opinion>,
    /// What the recorded valve position shows, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub valve_position: Option<ValvePosition>,
    /// Search statistics: evaluations, and why the search stopped.
    pub search: Option<Search>,
    /// Run time, ms; set by the caller.
    pub elapsed_ms: Option<f64>,
}

impl Assessment {
    /// The fitted valve and process; `None` if nothing was fitted, or the numbers are not reported.
    #[must_use]
    pub fn model(&self) -> Option<Model> {
        let (fs, fd, process) = (self.fs?, self.fd?, self.process.as_ref()?);
        Some(Model {
            law: self.valve_model.unwrap_or(Law::He),
            fs,
            fd,
            gain: process.gain,
            time_constants_s: process.time_constants_s.clone(),
            dead_time_s: process.dead_time_s,
            integrating: process.integrating,
        })
    }

    /// An empty assessment: `inconclusive`, all numbers absent.
    #[must_use]
    pub const fn empty(window: Window, oscillation: Oscillation) -> Self {
        Self {
            window,
            oscillation,
            verdict: Verdict::Inconclusive,
            contributing: Vec::new(),
            missing: Vec::new(),
            stiction: None,
            reason: None,
            p_stiction: None,
            p_calibrated: None,
            prevalence: CALIBRATED_FOR,
            confidence: None,
            gates: Vec::new(),
            implausible: Vec::new(),
            grade: None,
            fs: None,
            fd: None,
            s: None,
            j: None,
            fs_interval: None,
            fd_interval: None,
            s_interval: None,
            j_interval: None,
            s_thirds: Vec::new(),
            interval_level: None,
            j_identifiable: None,
            s_detectable: None,
            counted_by: None,
            reversals: None,
            stiction_index: None,
            s_over_span: None,
            region: None,
            strength_by_span: None,
            severity_by_range: None,
            op_range: None,
            op_unit: None,
            valve_model: None,
            process: None,
            fitted_by: None,
            pv_span: None,
            controller: None,
            indicators: Vec::new(),
            explanation: None,
            valve_position: None,
            search: None,
            elapsed_ms: None,
        }
    }
}

/// Statistics of the model search.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Search {
    /// The global solver.
    pub solver: SolverName,
    /// Models evaluated.
    pub evaluations: u64,
    /// Rounds made.
    pub rounds: usize,
    /// Why it ended.
    pub stopped: Ended,
}

/// A member's verdict in the light of its group.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MemberJudgement {
    /// Its name.
    #[serde(rename = "loop")]
    pub loop_name: String,
    /// Probability that the loop causes the oscillation.
    pub p_source: f64,
    /// Probability that its valve sticks, from the loop's own window alone, for the prevalence of its estimate.
    pub p_alone: Option<f64>,
    /// The same from the whole group.
    pub p_stiction: Option<f64>,
    /// The same where half of the valves stick.
    #[serde(default)]
    pub p_calibrated: Option<f64>,
    /// What drives it, such as `driven by FIC101, p 0.94`; absent for the source.
    pub cause: Option<String>,
    /// The source's oscillation hides whether this valve sticks: judge it again once the source is repaired.
    pub masked: bool,
}

/// The published document: an assessment with its loop and build.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct EstimateDocument {
    /// [`ESTIMATE_SCHEMA`].
    pub schema: &'static str,
    /// The loop's name.
    #[serde(rename = "loop")]
    pub loop_name: String,
    /// The assessment.
    #[serde(flatten)]
    pub assessment: Assessment,
    /// What the group of loops that share its oscillation says of it, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub group: Option<MemberJudgement>,
    /// Version of the program.
    pub version: &'static str,
    /// Hash of the configuration.
    pub config_hash: String,
    /// Id of the daemon that made it, if any. Of two documents for one window, the one with the smaller id counts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub daemon: Option<String>,
}

impl EstimateDocument {
    /// Wraps an assessment.
    #[must_use]
    pub fn new(loop_name: &str, config_hash: &str, assessment: Assessment) -> Self {
        Self {
            schema: ESTIMATE_SCHEMA,
            loop_name: loop_name.to_owned(),
            assessment,
            group: None,
            version: crate::core::VERSION,
            config_hash: config_hash.to_owned(),
            daemon: None,
        }
    }
}
