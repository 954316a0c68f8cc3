//! What of a file is looked at, and how densely: the same options for every command that fits models.

use std::sync::Arc;

use anyhow::{anyhow, bail};
use clap::ValueEnum;
use serde::Serialize;

use super::UsageError;
use crate::files::LoadedLoop;
use stiction::record::{Record, Signal, Value};
use stiction::signal::align::{Point, align_all};
use stiction::signal::detrend::remove_line;
use stiction::signal::resample::{boxed, decimated};
use stiction::signal::stats;
use stiction::units::{format_rfc3339, parse_time};
use stiction_monitor::config::Config;
use stiction_monitor::engine::{LoopSettings, longest, section, windows};

/// Usable samples, and points after downsampling, that a fit must have at least.
pub const MIN_SAMPLES: usize = 30;

/// Loop, section, density.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct Selection {
    /// Only this loop. In a compact store also its number, a tag, or what its tags have in common.
    #[arg(long = "loop", value_name = "NAME", help_heading = "What to look at")]
    pub loop_name: Option<String>,
    /// Samples START to END, counted from 1, ends included (50,500 is 451 samples); repeat for several sections.
    #[arg(long, value_name = "START,END", value_parser = samples_range, help_heading = "What to look at")]
    pub samples: Vec<(usize, usize)>,
    /// From time T0 to T1, ends included: seconds since 1970 or RFC 3339; ns as in documents with the suffix ns.
    /// Repeat for several sections.
    #[arg(long, value_name = "T0,T1", value_parser = time_range, help_heading = "What to look at")]
    pub window: Vec<(i64, i64)>,
    /// One point for every R samples, any real number above 1, without aliasing: the valve law still runs on every OP
    /// value, what it gives and PV are averaged over the same boxes.
    #[arg(long, value_name = "R", value_parser = ratio, help_heading = "What to look at")]
    pub downsample: Option<f64>,
    /// Drop samples instead of averaging, OP's too, as the toolbox does; it may alias.
    #[arg(long, requires = "downsample", help_heading = "What to look at")]
    pub downsample_like_toolbox: bool,
    /// Take this away from PV and SP first. Mean and median change no result, the model has a level of its own;
    /// linear takes a drift away. OP stays as recorded: the valve saw it so.
    #[arg(long, value_enum, help_heading = "What to look at")]
    pub detrend: Option<Detrend>,
}

/// `--detrend`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Detrend {
    /// The mean.
    Mean,
    /// The median.
    Median,
    /// The least-squares line.
    Linear,
}

/// One section of a loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Section {
    /// Everything.
    Whole,
    /// Samples, counted from 1, ends included.
    Samples(usize, usize),
    /// From one stamp to another, ns, ends included.
    Window(i64, i64),
}

/// What was taken, for documents.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Taken {
    /// The section.
    pub section: Section,
    /// Downsampling, if there was any.
    pub downsample: Option<Downsampled>,
    /// What was taken away from PV.
    pub detrend: Option<Detrend>,
}

/// What downsampling left.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Downsampled {
    /// Samples a point.
    pub ratio: f64,
    /// Samples dropped instead of averaged.
    pub like_toolbox: bool,
    /// Samples before.
    pub samples: usize,
    /// Sampling time before, s.
    pub ts_s: f64,
    /// Points left.
    pub points: usize,
    /// Points left of each period; `None` until a period is known.
    pub points_per_period: Option<f64>,
}

fn pair(text: &str) -> Result<(&str, &str), String> {
    text.split_once(',').ok_or_else(|| format!("{text:?} is not two values with a comma between"))
}

/// Two numbers, the lower one first.
pub(super) fn rising(text: &str) -> Result<[f64; 2], String> {
    let (low, high) = pair(text)?;
    let number = |s: &str| s.trim().parse::<f64>().map_err(|_| format!("{s:?} is not a number"));
    let range = [number(low)?, number(high)?];
    if range[1] > range[0] { Ok(range) } else { Err("the upper end must be above the lower".to_owned()) }
}

fn samples_range(text: &str) -> Result<(usize, usize), String> {
    let (start, end) = pair(text)?;
    let whole = |s: &str| s.trim().parse::<usize>().map_err(|_| format!("{s:?} is not a whole number"));
    match (whole(start)?, whole(end)?) {
        (0, _) => Err("samples are counted from 1".to_owned()),
        (start, end) if end <= start => Err(format!("the end {end} must lie behind the start {start}")),
        (start, end) if end - start + 1 < MIN_SAMPLES => {
            Err(format!("{start} to {end} are {} samples, at least {MIN_SAMPLES} are needed", end - start + 1))
        }
        range => Ok(range),
    }
}

fn time_range(text: &str) -> Result<(i64, i64), String> {
    let (start, end) = pair(text)?;
    let time = |s: &str| match s.trim().strip_suffix("ns") {
        Some(ns) => ns.parse::<i64>().map_err(|_| format!("{s:?} is not a whole number of ns")),
        None => parse_time(s).map_err(|e| e.to_string()),
    };
    let range = (time(start)?, time(end)?);
    if range.1 > range.0 { Ok(range) } else { Err("the window's end must lie behind its start".to_owned()) }
}

fn ratio(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("{text:?} is not a number"))?;
    if value.is_finite() && value > 1.0 {
        Ok(value)
    } else {
        Err("write a number above 1, such as 2 or 2.5".to_owned())
    }
}

/// Samples of a loop at which both OP and PV have a value, an upper bound that is quick to count.
pub(super) fn usable(samples: &LoadedLoop) -> usize {
    let of = |signal| {
        let values = samples.samples.iter().filter(|s| s.signal == signal);
        values.filter(|s| matches!(s.value, Value::Number(_))).count()
    };
    of(Signal::Op).min(of(Signal::Pv))
}

impl Section {
    /// In words; empty for everything.
    pub fn words(&self) -> String {
        match self {
            Self::Whole => String::new(),
            Self::Samples(start, end) => format!("samples {start} to {end}"),
            Self::Window(from, to) => format!("{} to {}", format_rfc3339(*from), format_rfc3339(*to)),
        }
    }
}

impl Selection {
    /// The loops asked for.
    ///
    /// # Errors
    /// No such loop.
    pub fn loops<'l>(&self, loops: &'l [LoadedLoop]) -> anyhow::Result<Vec<&'l LoadedLoop>> {
        match &self.loop_name {
            Some(wanted) => Ok(vec![crate::files::choose_loop(loops, wanted).map_err(anyhow::Error::msg)?]),
            None if loops.is_empty() => bail!("holds no loop"),
            None => Ok(loops.iter().collect()),
        }
    }

    /// The sections asked for, in the order of the command line; everything where none is.
    #[must_use]
    pub fn sections(&self) -> Vec<Section> {
        let samples = self.samples.iter().map(|(start, end)| Section::Samples(*start, *end));
        let windows = self.window.iter().map(|(from, to)| Section::Window(*from, *to));
        let all: Vec<Section> = samples.chain(windows).collect();
        if all.is_empty() { vec![Section::Whole] } else { all }
    }

    /// One section of a loop's points as a record, detrended and downsampled.
    ///
    /// # Errors
    /// Nothing there, or too little.
    pub fn record(&self, points: &Points, name: &str, section: Section) -> anyhow::Result<(Record, Taken)> {
        self.record_of(points, name, section, points.settings.window.max_points)
    }

    /// The same with another number of points that fits take.
    ///
    /// # Errors
    /// As [`Selection::record`].
    pub fn record_of(
        &self,
        points: &Points,
        name: &str,
        section: Section,
        max_points: usize,
    ) -> anyhow::Result<(Record, Taken)> {
        let most = if self.downsample.is_some() { usize::MAX } else { max_points };
        let mut record = points.record(name, section, most)?;
        if let Some(kind) = self.detrend {
            detrend(&mut record, kind);
        }
        let mut taken = Taken { section, downsample: None, detrend: self.detrend };
        let Some(ratio) = self.downsample else { return Ok((record, taken)) };
        let samples = record.len();
        let needed = (MIN_SAMPLES as f64 * ratio).ceil() as usize;
        if samples < needed {
            let what = format!("{name}: {samples} samples downsampled by {ratio} leave under {MIN_SAMPLES} points");
            return Err(UsageError(format!("{what}; take {needed} samples or a smaller ratio")).into());
        }
        let fewer = if self.downsample_like_toolbox { decimated } else { boxed };
        let ratio = {
            // More points than fits take are averaged, or dropped, further.
            let times = (samples as f64 / ratio / max_points as f64).ceil().max(1.0);
            if times > 1.0 {
                tracing::warn!(name, max_points, "downsampled by {} instead of {ratio} to fit", ratio * times);
            }
            ratio * times
        };
        let out = fewer(&record, ratio).ok_or_else(|| anyhow!("{name}: cannot be downsampled by {ratio}"))?;
        taken.downsample = Some(Downsampled {
            ratio,
            like_toolbox: self.downsample_like_toolbox,
            samples,
            ts_s: record.ts_s,
            points: out.len(),
            points_per_period: None,
        });
        Ok((out, taken))
    }
}

fn detrend(record: &mut Record, kind: Detrend) {
    let slow: Vec<f64> = match kind {
        Detrend::Mean => vec![stats::mean(&record.pv); record.len()],
        Detrend::Median => vec![stats::median(&record.pv); record.len()],
        Detrend::Linear => remove_line(&record.pv).iter().zip(&record.pv).map(|(left, pv)| pv - left).collect(),
    };
    let take = |x: &mut Vec<f64>| x.iter_mut().zip(&slow).for_each(|(v, s)| *v -= s);
    take(&mut record.pv);
    if let Some(sp) = &mut record.sp {
        take(sp);
    }
}

/// A loop's points, with what to know of them.
pub struct Points {
    stretches: Vec<Vec<Point>>,
    /// Settings of the loop in the configuration that it was recorded with.
    pub settings: Arc<LoopSettings>,
}

impl Points {
    /// Joins a loop's samples under the configuration that they were recorded with.
    #[must_use]
    pub fn of(loaded: &LoadedLoop, config: &Config) -> Self {
        let settings = Arc::new(config.loop_settings(&loaded.name));
        let (stretches, counts) = align_all(&loaded.samples, &settings.align);
        if counts.late + counts.stamp_outliers > 0 {
            tracing::warn!(
                name = loaded.name,
                late = counts.late,
                outliers = counts.stamp_outliers,
                "samples were left out: their stamps stand out of order"
            );
        }
        Self { stretches, settings }
    }

    /// The record of a section, in boxes where it has more than `max_points` samples.
    ///
    /// # Errors
    /// The section lies outside the samples, or nothing is in it.
    pub fn record(&self, name: &str, part: Section, max_points: usize) -> anyhow::Result<Record> {
        let (from_ns, to_ns) = self.bounds(name, part)?;
        let end_ns = if let Section::Window(_, to) = part { Some(to) } else { None };
        let (record, outside) = section(&self.stretches, from_ns, to_ns, end_ns, max_points.min(1 << 40));
        if outside > 0 {
            tracing::warn!(name, outside, "the section has gaps: its longest stretch is analysed, the rest left out");
        }
        let record = record.ok_or_else(|| {
            anyhow!("{name}: no samples with both OP and PV in this section; see that both columns hold numbers there")
        })?;
        if part != Section::Whole && record.raw_samples < MIN_SAMPLES {
            let there = record.raw_samples;
            bail!("{name}: {there} samples in one piece in this section, at least {MIN_SAMPLES} are needed");
        }
        Ok(record)
    }

    /// The windows that a section is judged in where it is long, see [`windows`].
    ///
    /// # Errors
    /// The section lies outside the samples.
    pub fn windows(&self, name: &str, part: Section) -> anyhow::Result<Vec<Record>> {
        let (from_ns, to_ns) = self.bounds(name, part)?;
        Ok(windows(longest(&self.stretches, from_ns, to_ns).0, &self.settings.window))
    }

    /// Every joined sample of a section, those behind gaps too.
    ///
    /// # Errors
    /// The section lies outside the samples.
    pub fn samples(&self, name: &str, part: Section) -> anyhow::Result<Vec<Point>> {
        let (from_ns, to_ns) = self.bounds(name, part)?;
        let inside = |p: &&Point| (from_ns..=to_ns).contains(&p.t_ns);
        Ok(self.stretches.iter().flatten().filter(inside).copied().collect())
    }

    /// First and last stamp of a section.
    fn bounds(&self, name: &str, part: Section) -> anyhow::Result<(i64, i64)> {
        match part {
            Section::Window(from, to) => Ok((from, to)),
            Section::Samples(start, end) => {
                let stamps: Vec<i64> = self.stretches.iter().flatten().map(|p| p.t_ns).collect();
                let (Some(from), Some(to)) = (stamps.get(start - 1), stamps.get(end - 1)) else {
                    bail!("{name}: samples {start} to {end} are wanted, the loop has {}", stamps.len());
                };
                Ok((*from, *to))
            }
            Section::Whole => Ok((i64::MIN, i64::MAX)),
        }
    }
}

/// A whole recording as it is judged.
pub(super) struct Whole {
    /// Its longest section without a gap.
    pub record: Record,
    /// The windows that it is judged in where it is long.
    pub windows: Vec<Record>,
    /// Its loop's settings.
    pub settings: Arc<LoopSettings>,
}

/// The section of a whole recording that is longest without a gap, for commands that look at whole files.
pub(super) fn whole_record(loaded: &LoadedLoop, config: &Config) -> anyhow::Result<Whole> {
    let points = Points::of(loaded, config);
    let record = points.record(&loaded.name, Section::Whole, points.settings.window.max_points)?;
    let windows = points.windows(&loaded.name, Section::Whole)?;
    Ok(Whole { record, windows, settings: points.settings })
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction::record::Sample;
    use stiction::units::ns_from_s;

    #[test]
    fn sections_and_ratios_are_read_or_refused_with_a_reason() {
        assert_eq!(samples_range("50,500"), Ok((50, 500)));
        assert!(samples_range("0,50").is_err() && samples_range("5,5").is_err() && samples_range("5").is_err());
        assert!(samples_range("1,29").unwrap_err().contains("29 samples, at least 30"));
        assert!(samples_range("1,30").is_ok());
        assert_eq!(time_range("1,2.5"), Ok((ns_from_s(1.0), ns_from_s(2.5))));
        assert_eq!(time_range("7ns,9ns"), Ok((7, 9)));
        assert!(time_range("2,1").is_err());
        assert!(rising("0,100").is_ok() && rising("5,5").is_err());
        assert!(ratio("2.5").is_ok() && ratio("1").is_err() && ratio("inf").is_err() && ratio("two").is_err());
    }

    fn loaded(n: usize) -> LoadedLoop {
        let of =
            |signal, k: usize, v| Sample { signal, t_ns: ns_from_s(k as f64), value: Value::Number(v), quality: None };
        let row = |k: usize| {
            let x = k as f64;
            [of(Signal::Op, k, libm::sin(0.1 * x)), of(Signal::Pv, k, 5.0 + 0.01 * x + libm::cos(0.1 * x))]
        };
        LoadedLoop::new("A", (0..n).flat_map(row).collect())
    }

    #[test]
    fn a_section_holds_both_its_ends() {
        let points = Points::of(&loaded(600), &Config::with_prefix("p"));
        let selection = Selection { samples: vec![(50, 500), (1, 600)], ..Selection::default() };
        let [first, all] = selection.sections()[..] else { panic!() };
        let (record, _) = selection.record(&points, "A", first).unwrap();
        assert_eq!((record.raw_samples, record.start_ns, record.end_ns), (451, ns_from_s(49.0), ns_from_s(499.0)));
        assert_eq!(selection.record(&points, "A", all).unwrap().0.len(), 600);
        let beyond = selection.record(&points, "A", Section::Samples(50, 601)).unwrap_err().to_string();
        assert!(beyond.contains("the loop has 600"), "{beyond}");
    }

    #[test]
    fn downsampling_says_what_is_needed() {
        let points = Points::of(&loaded(600), &Config::with_prefix("p"));
        let by = |ratio| Selection { downsample: Some(ratio), ..Selection::default() };
        let (record, taken) = by(2.5).record(&points, "A", Section::Whole).unwrap();
        assert_eq!((record.len(), taken.downsample.unwrap().points), (240, 240));
        let error = by(25.0).record(&points, "A", Section::Whole).unwrap_err();
        assert!(error.is::<UsageError>() && error.to_string().contains("750 samples"), "{error}");
    }

    #[test]
    fn a_line_leaves_pv_and_op_stays() {
        let points = Points::of(&loaded(600), &Config::with_prefix("p"));
        let plain = Selection::default().record(&points, "A", Section::Whole).unwrap().0;
        for kind in [Detrend::Mean, Detrend::Median, Detrend::Linear] {
            let selection = Selection { detrend: Some(kind), ..Selection::default() };
            let record = selection.record(&points, "A", Section::Whole).unwrap().0;
            assert_eq!(record.op_path, plain.op_path);
            let drift = record.pv[572] - record.pv[7];
            // 565 samples are 8.99 turns of the sine.
            assert_eq!(drift.abs() < 0.3, kind == Detrend::Linear, "{kind:?}: {drift}");
        }
    }
}
