//! Where the gap lies: the held-out residual of a model by time, phase of the stem, direction, frequency and level.
//!
//! Everything here is counted on the held-out points alone, so that every list of shares sums to 1 of their squared
//! residual. What stands beside each list, [`Test`], says whether the list is more uneven than the same residual with
//! its blocks shuffled (199 times: p from 0.005).

mod band;
mod cycle;
mod excitation;
mod held;
mod level;
#[cfg(test)]
mod tests;
mod time;

use serde::{Deserialize, Serialize};

use super::judged::Diagnosis;
use super::types::{Blocks, Fit, Signature, Stage, Stages};
use crate::core::record::Record;
use held::Held;

/// A figure with the value that chance reaches once in twenty, and the probability that chance reaches it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Test {
    /// The figure.
    pub value: f64,
    /// The 95 % point of the same figure after shuffling.
    pub threshold: f64,
    /// Share of shuffles that reach it.
    pub p: f64,
}

/// A stretch of time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Segment {
    /// Its start, s from the record's first sample.
    pub from_s: f64,
    /// Its end.
    pub to_s: f64,
    /// Share of the squared residual; `None` where nothing in it is held out.
    pub share: Option<f64>,
    /// Share of the held-out points.
    pub expected: f64,
}

/// Shares by what the stem did last.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Phases {
    /// At rest for longer than dead time and time constant together.
    pub stuck: Option<f64>,
    /// Within that time after a slip out of rest.
    pub slip: Option<f64>,
    /// Within that time after a move that follows another.
    pub moving: Option<f64>,
}

/// Shares by the direction of the stem's last move.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Direction {
    /// Upwards.
    pub up: Option<f64>,
    /// Downwards.
    pub down: Option<f64>,
}

/// A band of frequencies.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Band {
    /// Its lower edge, Hz.
    pub from_hz: f64,
    /// Its upper edge, Hz; the sampling's own limit for the last.
    pub to_hz: f64,
    /// Share of the squared residual; `None` where the band lies above half the sampling frequency.
    pub share: Option<f64>,
    /// What white noise would have.
    pub expected: f64,
}

/// A range of OP.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Level {
    /// Its lower end, OP units.
    pub from: f64,
    /// Its upper end.
    pub to: f64,
    /// Share of the squared residual; `None` where nothing in it is held out.
    pub share: Option<f64>,
    /// Share of the held-out points.
    pub expected: f64,
    /// Mean residual there, PV units.
    pub mean: Option<f64>,
}

/// How much of the residual hangs on where the loop stands: R2 of means by bins.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LevelR2 {
    /// By OP.
    pub op: Option<Test>,
    /// By the simulated PV.
    pub pv: Option<Test>,
    /// By the valve's position.
    pub valve: Option<Test>,
}

/// Slips that model and PV do not share.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SlipCount {
    /// Seen in PV (or the valve position), not in the model.
    pub missed: Option<u64>,
    /// In the model, not seen.
    pub extra: Option<u64>,
}

/// What the record offers to learn from.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Excitation {
    /// Different positions of the model's stem.
    pub levels: u64,
    /// Moves of the stem between turns.
    pub jumps_per_half_cycle: Option<f64>,
    /// Moves of the set point; `None` without one.
    pub setpoint_moves: Option<u64>,
    /// Two positions only: gain, bands and every curvature hide in one number.
    pub two_level: bool,
}

/// OP to valve position, apart.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct OpToMv {
    /// What the base's valve (with free gain and offset) leaves of the position's variance, %.
    pub unexplained_pct: f64,
}

/// Valve position to PV, apart.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MvToPv {
    /// Gap of the first-order process driven by the recorded position, PV units.
    pub gap: f64,
    /// The same over PV's standard deviation.
    pub relative: Option<f64>,
}

/// Whether lists are more uneven than chance makes them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Unevenness {
    /// Over the segments of time.
    pub segments: Option<Test>,
    /// Over the phases of the stem.
    pub phases: Option<Test>,
    /// Over the directions.
    pub direction: Option<Test>,
    /// Over the levels of OP.
    pub level: Option<Test>,
}

/// How the residual's power goes with time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Course {
    /// Where the power changed, s from the first sample; `None` where no change shows (p >= .05 or under twofold).
    pub onset_s: Option<f64>,
    /// Power after the most likely change over power before it.
    pub onset_ratio: Option<f64>,
    /// The change's test: gain in log likelihood.
    pub onset: Option<Test>,
    /// Power at the end over power at the start, by a line through its logarithm.
    pub trend_ratio: Option<f64>,
    /// The line's test: correlation of the logarithm with time.
    pub trend: Option<Test>,
    /// Course of the residual itself: its rise over the record, PV units.
    pub drift: Option<f64>,
}

/// The report on where the gap lies.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Location {
    /// The cause's stage.
    pub stage: String,
    /// Sixteen stretches of time.
    pub segments: Vec<Segment>,
    /// By what the stem did last.
    pub phases: Phases,
    /// The same shares of the points.
    pub phases_expected: Phases,
    /// How long after a move counts as just moved: dead time and time constant, s.
    pub slip_window_s: f64,
    /// By the direction of its last move.
    pub direction: Direction,
    /// Mean square after moves up over that after moves down.
    pub direction_ratio: Option<f64>,
    /// By frequency, around the oscillation's own.
    pub bands: Vec<Band>,
    /// The oscillation's frequency, Hz.
    pub fundamental_hz: f64,
    /// By OP.
    pub level: Vec<Level>,
    /// R2 by level.
    pub level_r2: LevelR2,
    /// Slips that differ.
    pub slips: SlipCount,
    /// Where the residual's power changed, s from the first sample.
    pub onset_s: Option<f64>,
    /// The course of its power.
    pub trend: Course,
    /// Traces in the data.
    pub signatures: Vec<Signature>,
    /// What the record offers.
    pub excitation: Excitation,
    /// OP to valve position, where that is recorded.
    pub op_to_mv: Option<OpToMv>,
    /// Valve position to PV.
    pub mv_to_pv: Option<MvToPv>,
    /// Whether the lists are uneven.
    pub uneven: Unevenness,
    /// Held-out points.
    pub points: u64,
}

/// What is looked at: a fit, and what the diagnosis knows beside it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Subject<'a> {
    /// The model whose residual is looked at.
    pub fit: &'a Fit,
    /// Which points count.
    pub blocks: &'a Blocks,
    /// What no model gets below, PV units.
    pub noise_floor: Option<f64>,
    /// Traces in the data.
    pub signatures: &'a [Signature],
    /// The gaps before and behind the recorded valve position.
    pub stages: Option<&'a Stages>,
    /// The cause's stage.
    pub stage: Stage,
    /// Period of the oscillation, points, where one is known.
    pub period_points: Option<f64>,
    /// Seed of the shuffles.
    pub seed: u64,
}

impl<'a> Subject<'a> {
    /// The model that a diagnosis measures from: the given one as it was given, else the base.
    #[must_use]
    pub(crate) fn of(diagnosis: &'a Diagnosis, period_points: Option<f64>, seed: u64) -> Self {
        Self {
            fit: diagnosis.findings.given.as_ref().unwrap_or(&diagnosis.findings.base),
            blocks: &diagnosis.findings.blocks,
            noise_floor: diagnosis.findings.floor.noise_floor,
            signatures: &diagnosis.findings.signatures,
            stages: diagnosis.findings.stages.as_ref(),
            stage: diagnosis.cause.stage,
            period_points,
            seed,
        }
    }
}

/// Says where a model's gap lies on the record that it was fitted to.
#[must_use]
pub(crate) fn locate(record: &Record, subject: &Subject<'_>) -> Location {
    let held = Held::new(record, subject);
    let (segments, uneven_segments) = time::segments(&held);
    let steps = cycle::Steps::of(&held);
    let (phases, phases_expected, uneven_phases) = cycle::phases(&held, &steps);
    let (direction, direction_ratio, uneven_direction) = cycle::direction(&held, &steps);
    let (level, uneven_level) = level::by_op(&held);
    let trend = time::course(&held);
    let deviation = crate::core::signal::stats::std_dev(&record.pv);
    let relative = |gap: f64| (deviation > 0.0).then(|| gap / deviation);
    Location {
        stage: subject.stage.name().to_owned(),
        segments,
        phases,
        phases_expected,
        slip_window_s: steps.window as f64 * held.point_s,
        direction,
        direction_ratio,
        bands: band::bands(&held),
        fundamental_hz: 1.0 / (held.period * held.point_s),
        level,
        level_r2: level::r2(&held),
        slips: cycle::slips(&held, record.mv.as_deref(), subject.noise_floor),
        onset_s: trend.onset_s,
        trend,
        signatures: subject.signatures.to_vec(),
        excitation: excitation::excitation(&held, record),
        op_to_mv: subject.stages.map(|s| OpToMv { unexplained_pct: s.op_to_mv }),
        mv_to_pv: subject.stages.map(|s| MvToPv { gap: s.mv_to_pv, relative: relative(s.mv_to_pv) }),
        uneven: Unevenness {
            segments: uneven_segments,
            phases: uneven_phases,
            direction: uneven_direction,
            level: uneven_level,
        },
        points: held.points.len() as u64,
    }
}
