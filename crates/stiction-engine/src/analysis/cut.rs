//! Downsampling and detrending of a section.

use serde::Serialize;

use super::{AnalysisError, MIN_SAMPLES, Points, Section};
use stiction::core::record::Record;
use stiction::core::signal::detrend::remove_line;
use stiction::core::signal::resample::{boxed, decimated};
use stiction::core::signal::stats;

/// Trend removed from PV and SP. Mean and median change no result, because the model has its own offset.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Detrend {
    /// Mean.
    Mean,
    /// Median.
    Median,
    /// Least-squares line.
    Linear,
}

/// Downsampling and detrending; the default uses a section unchanged.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Cut {
    /// Samples per point, above 1.
    pub downsample: Option<f64>,
    /// Drop samples instead of averaging.
    pub like_toolbox: bool,
    /// Trend to remove.
    pub detrend: Option<Detrend>,
}

/// The data used, for documents.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Taken {
    /// The section.
    pub section: Section,
    /// Downsampling, if any.
    pub downsample: Option<Downsampled>,
    /// Trend removed from PV.
    pub detrend: Option<Detrend>,
}

/// Result of downsampling.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Downsampled {
    /// Samples per point.
    pub ratio: f64,
    /// Samples were dropped instead of averaged.
    pub like_toolbox: bool,
    /// Number of samples before.
    pub samples: usize,
    /// Sampling time before, s.
    pub ts_s: f64,
    /// Number of points after.
    pub points: usize,
    /// Points per period after; `None` until a period is known.
    pub points_per_period: Option<f64>,
}

impl Cut {
    /// Whether a section is used unchanged.
    #[must_use]
    pub const fn is_plain(&self) -> bool {
        self.downsample.is_none() && self.detrend.is_none()
    }

    /// The record of one section with at most `max_points` points, detrended and downsampled; and notes for the user, one line
    /// each.
    ///
    /// # Errors
    /// The section has no data, or too little.
    pub fn record(
        &self,
        points: &Points,
        section: Section,
        max_points: usize,
    ) -> Result<(Record, Taken, Vec<String>), AnalysisError> {
        let most = if self.downsample.is_some() { usize::MAX } else { max_points };
        let (mut record, mut notes) = points.record(section, most)?;
        if let Some(kind) = self.detrend {
            detrend(&mut record, kind);
        }
        let mut taken = Taken { section, downsample: None, detrend: self.detrend };
        let Some(asked) = self.downsample else { return Ok((record, taken, notes)) };
        let (name, samples) = (points.name.clone(), record.len());
        let needed = (MIN_SAMPLES as f64 * asked).ceil() as usize;
        if samples < needed {
            return Err(AnalysisError::Sparse { name, samples, ratio: asked, needed });
        }
        let fewer = if self.like_toolbox { decimated } else { boxed };
        // If there are still too many points for a fit, reduce them further.
        let times = (samples as f64 / asked / max_points as f64).ceil().max(1.0);
        let ratio = asked * times;
        if times > 1.0 {
            notes.push(format!("downsampled by {ratio} instead of {asked}, to fit {max_points} points"));
        }
        let out = fewer(&record, ratio).ok_or(AnalysisError::Ratio { name, ratio })?;
        taken.downsample = Some(Downsampled {
            ratio,
            like_toolbox: self.like_toolbox,
            samples,
            ts_s: record.ts_s,
            points: out.len(),
            points_per_period: None,
        });
        Ok((out, taken, notes))
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use stiction::core::record::{Sample, Signal, Value};
    use stiction::core::units::ns_from_s;

    fn points(n: usize) -> Points {
        let of =
            |signal, k: usize, v| Sample { signal, t_ns: ns_from_s(k as f64), value: Value::Number(v), quality: None };
        let row = |k: usize| {
            let x = k as f64;
            [of(Signal::Op, k, libm::sin(0.1 * x)), of(Signal::Pv, k, 5.0 + 0.01 * x + libm::cos(0.1 * x))]
        };
        Points::of("A", &(0..n).flat_map(row).collect::<Vec<_>>(), &Config::with_prefix("p"))
    }

    #[test]
    fn a_section_holds_both_its_ends() {
        let points = points(600);
        let of = |section| Cut::default().record(&points, section, 2000).map(|(record, ..)| record);
        let record = of(Section::Samples(50, 500)).unwrap();
        assert_eq!((record.raw_samples, record.start_ns, record.end_ns), (451, ns_from_s(49.0), ns_from_s(499.0)));
        assert_eq!(of(Section::Samples(1, 600)).unwrap().len(), 600);
        let beyond = of(Section::Samples(50, 601)).unwrap_err().to_string();
        assert!(beyond.contains("the loop has 600"), "{beyond}");
    }

    #[test]
    fn downsampling_says_what_is_needed() {
        let points = points(600);
        let by = |ratio| Cut { downsample: Some(ratio), ..Cut::default() };
        let (record, taken, _) = by(2.5).record(&points, Section::Whole, 2000).unwrap();
        assert_eq!((record.len(), taken.downsample.unwrap().points), (240, 240));
        let error = by(25.0).record(&points, Section::Whole, 2000).unwrap_err().to_string();
        assert!(error.contains("750 samples"), "{error}");
    }

    #[test]
    fn a_line_leaves_pv_and_op_stays() {
        let points = points(600);
        let plain = Cut::default().record(&points, Section::Whole, 2000).unwrap().0;
        for kind in [Detrend::Mean, Detrend::Median, Detrend::Linear] {
            let cut = Cut { detrend: Some(kind), ..Cut::default() };
            let record = cut.record(&points, Section::Whole, 2000).unwrap().0;
            assert_eq!(record.op_path, plain.op_path);
            let drift = record.pv[572] - record.pv[7];
            // 565 samples are 8.99 periods of the sine.
            assert_eq!(drift.abs() < 0.3, kind == Detrend::Linear, "{kind:?}: {drift}");
        }
    }
}
