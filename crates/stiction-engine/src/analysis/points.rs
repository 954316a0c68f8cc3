//! A loop's joined samples, and sections of them as records.

use std::sync::Arc;

use serde::Serialize;

use super::AnalysisError;
use crate::config::Config;
use crate::engine::{LoopSettings, longest, section, windows};
use stiction::core::record::{Record, Sample, Signal, Value};
use stiction::core::units::format_rfc3339;
use stiction::core::verdict::{AssessParams, swapped};
use stiction::samples::align::{Point, align_all};

/// Fewest usable samples, and fewest points after downsampling, for a fit.
pub const MIN_SAMPLES: usize = 30;

/// One section of a loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Section {
    /// The whole record.
    Whole,
    /// Samples, counted from 1, both ends included.
    Samples(usize, usize),
    /// From one timestamp to another, ns, both ends included.
    Window(i64, i64),
}

impl Section {
    /// In words; empty for the whole record.
    #[must_use]
    pub fn words(&self) -> String {
        match self {
            Self::Whole => String::new(),
            Self::Samples(start, end) => format!("samples {start} to {end}"),
            Self::Window(from, to) => format!("{} to {}", format_rfc3339(*from), format_rfc3339(*to)),
        }
    }

    /// Samples START to END, counted from 1, both ends included.
    ///
    /// # Errors
    /// What is wrong with them, in a sentence.
    pub fn of_samples(start: usize, end: usize) -> Result<Self, String> {
        match (start, end) {
            (0, _) => Err("samples are counted from 1".to_owned()),
            (start, end) if end <= start => Err(format!("the end {end} must be after the start {start}")),
            (start, end) if end - start + 1 < MIN_SAMPLES => {
                Err(format!("{start} to {end} are {} samples, at least {MIN_SAMPLES} are needed", end - start + 1))
            }
            _ => Ok(Self::Samples(start, end)),
        }
    }

    /// From one timestamp to another, ns, both ends included.
    ///
    /// # Errors
    /// The end is not after the start.
    pub fn of_times(from_ns: i64, to_ns: i64) -> Result<Self, String> {
        if to_ns > from_ns {
            Ok(Self::Window(from_ns, to_ns))
        } else {
            Err("the end of the window must be after its start".to_owned())
        }
    }
}

/// Samples with both OP and PV: an upper bound that is quick to count.
#[must_use]
pub fn usable(samples: &[Sample]) -> usize {
    let of = |signal| {
        let values = samples.iter().filter(|s| s.signal == signal);
        values.filter(|s| matches!(s.value, Value::Number(_))).count()
    };
    of(Signal::Op).min(of(Signal::Pv))
}

/// A note is given if more than this fraction of a signal's values share their timestamp with a different value.
const REPEATS: f64 = 0.01;

/// Notes for OP and PV if many of their values share timestamps, of which only one is used.
#[must_use]
pub fn repeated_timestamps(samples: &[Sample]) -> Vec<String> {
    let note = |signal: Signal| {
        let of: Vec<&Sample> = samples.iter().filter(|s| s.signal == signal).collect();
        // A repeated equal value, as in overlapping exports, loses nothing.
        let is_repeat = |pair: &&[&Sample]| pair[0].t_ns == pair[1].t_ns && pair[0].value != pair[1].value;
        let (all, repeats) = (of.len(), of.windows(2).filter(is_repeat).count());
        (repeats as f64 > REPEATS * all as f64).then(|| {
            format!(
                "{repeats} of {all} {} values are not used, because an earlier value has the same timestamp: if the export \
                 cut the times, for example to the minute, export them in full",
                signal.name().to_uppercase()
            )
        })
    };
    [Signal::Op, Signal::Pv].into_iter().filter_map(note).collect()
}

/// A loop's points with notes on them.
#[derive(Debug, Clone)]
pub struct Points {
    /// The loop.
    pub name: String,
    /// Settings of the loop in the configuration of the recording.
    pub settings: Arc<LoopSettings>,
    /// Notes on the joining for the user, one line each.
    pub notes: Vec<String>,
    stretches: Vec<Vec<Point>>,
}

/// A whole recording in the form in which it is judged.
#[derive(Debug, Clone)]
pub struct Judgeable {
    /// Longest section without a data gap.
    pub record: Record,
    /// Windows of a long recording; each is judged.
    pub windows: Vec<Record>,
    /// Parameters of the judgement.
    pub params: AssessParams,
}

impl Points {
    /// Joins a loop's samples with the configuration of the recording.
    #[must_use]
    pub fn of(name: &str, samples: &[Sample], config: &Config) -> Self {
        let settings = Arc::new(config.loop_settings(name));
        let (stretches, counts) = align_all(samples, &settings.align);
        let mut notes = repeated_timestamps(samples);
        notes.extend(super::repeated_values(samples));
        if counts.late + counts.stamp_outliers > 0 {
            let (late, outliers) = (counts.late, counts.stamp_outliers);
            notes.push(format!(
                "samples skipped because their timestamps are out of order ({late} late, {outliers} far from the rest)"
            ));
        }
        Self { name: name.to_owned(), settings, notes, stretches }
    }

    /// The record of a section, averaged in bins if it has more than `max_points` samples, and notes for the user.
    ///
    /// # Errors
    /// The section is outside the samples, or empty.
    pub fn record(&self, part: Section, max_points: usize) -> Result<(Record, Vec<String>), AnalysisError> {
        let (from_ns, to_ns) = self.bounds(part)?;
        let end_ns = if let Section::Window(_, to) = part { Some(to) } else { None };
        let (record, outside) = section(&self.stretches, from_ns, to_ns, end_ns, max_points.min(1 << 40));
        let nothing = || AnalysisError::Nothing { name: self.name.clone(), joined_ns: self.ends_ns() };
        let record = record.ok_or_else(nothing)?;
        if part != Section::Whole && record.raw_samples < MIN_SAMPLES {
            return Err(AnalysisError::Few { name: self.name.clone(), there: record.raw_samples });
        }
        let gaps = || {
            format!("the section has data gaps: its longest stretch is analysed, {outside} other samples are not used")
        };
        let names_swapped = || {
            "OP and PV look swapped: a controller would compute the signal named PV from the one named OP; check the tags"
                .to_owned()
        };
        // If the set point is known, a gate checks this instead.
        let is_swapped = record.sp.is_none() && swapped::by_controller(&record);
        let notes = (outside > 0).then(gaps).into_iter().chain(is_swapped.then(names_swapped)).collect();
        Ok((record, notes))
    }

    /// The windows of a long section, see [`windows`].
    ///
    /// # Errors
    /// The section is outside the samples.
    pub fn windows(&self, part: Section) -> Result<Vec<Record>, AnalysisError> {
        let (from_ns, to_ns) = self.bounds(part)?;
        Ok(windows(longest(&self.stretches, from_ns, to_ns).0, &self.settings.window))
    }

    /// The whole recording in the form in which it is judged, and notes for the user.
    ///
    /// # Errors
    /// There is no sample with both OP and PV.
    pub fn judgeable(&self) -> Result<(Judgeable, Vec<String>), AnalysisError> {
        let (record, notes) = self.record(Section::Whole, self.settings.window.max_points)?;
        let windows = self.windows(Section::Whole)?;
        Ok((Judgeable { record, windows, params: self.settings.assess.clone() }, notes))
    }

    /// Every joined sample of a section, across data gaps.
    ///
    /// # Errors
    /// The section is outside the samples.
    pub fn samples(&self, part: Section) -> Result<Vec<Point>, AnalysisError> {
        let (from_ns, to_ns) = self.bounds(part)?;
        let inside = |p: &&Point| (from_ns..=to_ns).contains(&p.t_ns);
        Ok(self.stretches.iter().flatten().filter(inside).copied().collect())
    }

    /// Timestamps of the first and last sample.
    fn ends_ns(&self) -> Option<[i64; 2]> {
        let first = self.stretches.iter().flatten().next()?;
        let last = self.stretches.iter().rev().find_map(|stretch| stretch.last())?;
        Some([first.t_ns, last.t_ns])
    }

    /// First and last timestamp of a section.
    fn bounds(&self, part: Section) -> Result<(i64, i64), AnalysisError> {
        match part {
            Section::Window(from, to) => Ok((from, to)),
            Section::Samples(start, end) => {
                let stamps: Vec<i64> = self.stretches.iter().flatten().map(|p| p.t_ns).collect();
                let at = |count: usize| count.checked_sub(1).and_then(|at| stamps.get(at)).copied();
                let there = stamps.len();
                let beyond = || AnalysisError::Beyond { name: self.name.clone(), start, end, there };
                at(start).zip(at(end)).ok_or_else(beyond)
            }
            Section::Whole => Ok((i64::MIN, i64::MAX)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_that_share_a_timestamp_are_told_unless_they_are_equal() {
        let sample = |t_ns, x| Sample { signal: Signal::Op, t_ns, value: Value::Number(x), quality: None };
        let cut: Vec<Sample> = (0..120).map(|k| sample(i64::from(k / 60), f64::from(k))).collect();
        let notes = repeated_timestamps(&cut);
        assert!(notes.len() == 1 && notes[0].starts_with("118 of 120 OP values are not used"), "{notes:?}");
        let twice: Vec<Sample> = (0..120).map(|k| sample(i64::from(k / 2), f64::from(k / 2))).collect();
        assert_eq!(repeated_timestamps(&twice), Vec::<String>::new());
    }
}
