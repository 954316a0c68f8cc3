//! Which part of a file to use and at what density: options shared by every command that fits models.

use anyhow::bail;
use clap::ValueEnum;

use crate::cli::UsageError;
use crate::cli::values::pair;
use stiction::core::units::parse_time;
use stiction_engine::analysis::{AnalysisError, Cut, Detrend, Points, Section};
use stiction_engine::config::Config;
use stiction_files::{Loaded, LoadedLoop};

/// Loop, section and density.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct Selection {
    /// Loop to use. In a compact store also its number, a tag, or the common part of its tags.
    #[arg(long = "loop", value_name = "NAME", help_heading = "Selecting data")]
    pub loop_name: Option<String>,
    /// Samples START to END, counted from 1, both included (50,500 is 451 samples); repeat for several sections.
    #[arg(long, value_name = "START,END", value_parser = samples_range, help_heading = "Selecting data")]
    pub samples: Vec<(usize, usize)>,
    /// Times T0 to T1, both included: seconds since 1970, RFC 3339, or nanoseconds with the suffix ns; repeat for
    /// several sections.
    #[arg(long, value_name = "T0,T1", value_parser = time_range, allow_hyphen_values = true, help_heading = "Selecting data")]
    pub window: Vec<(i64, i64)>,
    /// Downsample to one point per R samples (any number above 1) without aliasing: the valve model still runs on every
    /// OP sample; its output and PV are averaged over the same bins.
    #[arg(long, value_name = "R", value_parser = ratio, allow_negative_numbers = true, help_heading = "Selecting data")]
    pub downsample: Option<f64>,
    /// Downsample by dropping samples, OP's too, as the toolbox does. May alias.
    #[arg(long, requires = "downsample", help_heading = "Selecting data")]
    pub downsample_like_toolbox: bool,
    /// Trend to remove from PV and SP. mean and median change no result, because the model has its own offset; linear
    /// removes a drift. OP stays as recorded, because the valve received it so.
    #[arg(long, value_enum, help_heading = "Selecting data")]
    pub detrend: Option<DetrendArg>,
}

/// `--detrend`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum DetrendArg {
    /// Subtract the mean.
    Mean,
    /// Subtract the median.
    Median,
    /// Subtract the least-squares line.
    Linear,
}

impl From<DetrendArg> for Detrend {
    fn from(arg: DetrendArg) -> Self {
        match arg {
            DetrendArg::Mean => Self::Mean,
            DetrendArg::Median => Self::Median,
            DetrendArg::Linear => Self::Linear,
        }
    }
}

fn samples_range(text: &str) -> Result<(usize, usize), String> {
    let (start, end) = pair(text, "50,500")?;
    let whole = |s: &str| s.trim().parse::<usize>().map_err(|_| format!("{s:?} is not a whole number"));
    let range = (whole(start)?, whole(end)?);
    Section::of_samples(range.0, range.1).map(|_| range)
}

fn time_range(text: &str) -> Result<(i64, i64), String> {
    let (start, end) = pair(text, "2026-01-05T08:00:00Z,2026-01-05T09:00:00Z")?;
    let time = |s: &str| match s.trim().strip_suffix("ns") {
        Some(ns) => ns.parse::<i64>().map_err(|_| format!("{s:?} is not a whole number of ns")),
        None => parse_time(s).map_err(|e| e.to_string()),
    };
    let range = (time(start)?, time(end)?);
    Section::of_times(range.0, range.1).map(|_| range)
}

fn ratio(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("{text:?} is not a number"))?;
    if value.is_finite() && value > 1.0 {
        Ok(value)
    } else {
        Err("write a number above 1, such as 2 or 2.5".to_owned())
    }
}

impl Selection {
    /// The selected loops.
    ///
    /// # Errors
    /// There is no such loop, or none at all.
    pub fn loops<'l>(&self, loaded: &'l Loaded) -> anyhow::Result<Vec<&'l LoadedLoop>> {
        match &self.loop_name {
            _ if loaded.loops.is_empty() && loaded.data_loss => {
                bail!("the file is damaged, and no sample in it can be read")
            }
            Some(wanted) => Ok(vec![stiction_files::choose_loop(&loaded.loops, wanted).map_err(anyhow::Error::msg)?]),
            None if loaded.loops.is_empty() => bail!("no loop found: a loop needs an OP and a PV"),
            None => Ok(loaded.loops.iter().collect()),
        }
    }

    /// The selected sections in command-line order, or the whole record.
    #[must_use]
    pub fn sections(&self) -> Vec<Section> {
        let samples = self.samples.iter().map(|(start, end)| Section::Samples(*start, *end));
        let windows = self.window.iter().map(|(from, to)| Section::Window(*from, *to));
        let all: Vec<Section> = samples.chain(windows).collect();
        if all.is_empty() { vec![Section::Whole] } else { all }
    }

    /// Downsampling and detrending.
    #[must_use]
    pub fn cut(&self) -> Cut {
        Cut {
            downsample: self.downsample,
            like_toolbox: self.downsample_like_toolbox,
            detrend: self.detrend.map(Into::into),
        }
    }
}

/// Joins a loop's samples with the configuration that they were recorded with.
pub fn points(loaded: &LoadedLoop, config: &Config) -> Points {
    let points = Points::of(&loaded.name, &loaded.samples, config);
    warn(&points.name, &points.notes);
    points
}

/// Logs the notes on a loop.
pub fn warn(name: &str, notes: &[String]) {
    notes.iter().for_each(|note| tracing::warn!("{name}: {note}"));
}

/// A ratio or section that leaves too few points is a usage error.
pub fn told(error: AnalysisError) -> anyhow::Error {
    match error {
        AnalysisError::Sparse { .. } => UsageError(error.to_string()).into(),
        error => error.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction::core::units::ns_from_s;

    #[test]
    fn sections_and_ratios_are_read_or_refused_with_a_reason() {
        assert_eq!(samples_range("50,500"), Ok((50, 500)));
        assert!(samples_range("0,50").is_err() && samples_range("5,5").is_err() && samples_range("5").is_err());
        assert!(samples_range("1,29").unwrap_err().contains("29 samples, at least 30"));
        assert!(samples_range("1,30").is_ok());
        assert_eq!(time_range("1,2.5"), Ok((ns_from_s(1.0), ns_from_s(2.5))));
        assert_eq!(time_range("7ns,9ns"), Ok((7, 9)));
        assert!(time_range("2,1").is_err());
        assert!(ratio("2.5").is_ok() && ratio("1").is_err() && ratio("inf").is_err() && ratio("two").is_err());
    }
}
