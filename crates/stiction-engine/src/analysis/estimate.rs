//! The estimate of one section, as made and written by `analyze`.

use serde::Serialize;

use super::solver::SolverDocument;
use super::{AnalysisError, Cut, Points, Section, Taken};
use stiction::core::gap::model_file::ModelFile;
use stiction::core::gap::score::score;
use stiction::core::gap::{GapError, GapOptions};
use stiction::core::ident::Options;
use stiction::core::record::Record;
use stiction::core::signal::stats;
use stiction::core::verdict::{
    AssessParams, Assessment, DelayChoice, EstimateDocument, ModelChoice, ValveChoice, assess_in_windows, is_fraction,
};

/// Fit of a given model in free run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scored {
    /// Source of the model.
    pub model: String,
    /// Mean squared error, PV units squared.
    pub mse: f64,
    /// 100 (1 - rms error / std PV).
    pub fit_pct: f64,
}

impl Scored {
    /// Runs a model over the record.
    ///
    /// # Errors
    /// The model cannot be run on the record.
    pub fn of(name: &str, file: &ModelFile, record: &Record, period_points: Option<f64>) -> Result<Self, GapError> {
        let options = GapOptions { period_points, ..GapOptions::default() };
        let found = score(record, &file.on(record), &options)?;
        Ok(Self { model: name.to_owned(), mse: found.mse, fit_pct: found.fit_pct })
    }
}

/// An estimate with the additions of `analyze` to the published document.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Answer {
    /// As published by the daemon.
    #[serde(flatten)]
    pub document: EstimateDocument,
    /// Span of OP, the upper limit of `fs + fd`; null if OP does not move.
    pub s0: Option<f64>,
    /// The data used.
    pub selection: Taken,
    /// Result of the requested solver.
    pub solver: Option<SolverDocument>,
    /// Fit of the given model.
    pub scored: Option<Scored>,
}

/// Parses a dead time: `auto`, a number of samples such as `3`, or seconds such as `12s`; fractions are allowed.
///
/// # Errors
/// A sentence that says what is valid.
pub fn delay_choice(text: &str) -> Result<DelayChoice, String> {
    let number = |s: &str| {
        s.trim().parse::<f64>().ok().filter(|v| v.is_finite() && *v >= 0.0).ok_or_else(|| {
            format!("{text:?} is not a dead time; write auto, a number of samples such as 3, or seconds such as 12s")
        })
    };
    if text == "auto" {
        return Ok(DelayChoice::Auto);
    }
    Ok(match text.strip_suffix('s') {
        Some(seconds) => DelayChoice::Seconds(number(seconds)?),
        None => DelayChoice::Samples(number(text)?),
    })
}

/// Options of a fit that override a loop's settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FitOverrides {
    /// Order of the process model.
    pub model: ModelChoice,
    /// Valve model.
    pub valve: ValveChoice,
    /// Dead time.
    pub delay: DelayChoice,
    /// OP's range, `[low, high]`; `None` keeps the loop's range.
    pub op_range: Option<[f64; 2]>,
    /// Share of such loops that stick; `None` keeps the loop's value.
    pub prevalence: Option<f64>,
    /// Step of the contour grid, % of OP's span.
    pub fineness_pct: f64,
    /// Seed of all random choices.
    pub seed: u64,
}

impl Default for FitOverrides {
    fn default() -> Self {
        let Options { model, valve, delay, fineness_pct, seed, .. } = Options::default();
        Self { model, valve, delay, op_range: None, prevalence: None, fineness_pct, seed }
    }
}

impl FitOverrides {
    /// A loop's settings with these options applied.
    #[must_use]
    pub fn over(&self, own: &AssessParams) -> AssessParams {
        let Self { model, valve, delay, op_range, prevalence, fineness_pct, seed } = *self;
        let fit = Options { model, valve, delay, fineness_pct, seed, ..own.fit };
        AssessParams {
            op_range: op_range.or(own.op_range),
            prevalence: prevalence.unwrap_or(own.prevalence),
            fit,
            ..own.clone()
        }
    }
}

/// A judged section.
#[derive(Debug, Clone)]
pub struct Estimated {
    /// The record of the section.
    pub record: Record,
    /// The data used.
    pub taken: Taken,
    /// Parameters of the fit.
    pub params: AssessParams,
    /// The assessment.
    pub assessment: Assessment,
    /// Options of a solver on the same surface.
    pub options: Options,
    /// Notes for the user, one line each.
    pub notes: Vec<String>,
}

/// Judges a section of any length. `params` are the loop's settings with the options applied; a dead time in samples counts
/// samples of the recording.
///
/// # Errors
/// The section is outside the samples, or has too few; OP lies outside its range.
pub fn estimate(
    points: &Points,
    section: Section,
    cut: &Cut,
    mut params: AssessParams,
) -> Result<Estimated, AnalysisError> {
    let (record, mut taken, notes) = cut.record(points, section, points.settings.window.max_points)?;
    if let Some(range) = params.op_range {
        check_range(&points.name, &record.op_path, range)?;
    }
    params.always_fit = true;
    if let (DelayChoice::Samples(count), Some(left)) = (params.fit.delay, &taken.downsample) {
        params.fit.delay = DelayChoice::Seconds(count * left.ts_s);
    }
    // A section with another density or without its trend is judged as a single window.
    let windows = if cut.is_plain() { points.windows(section)? } else { Vec::new() };
    let assessment = assess_in_windows(&record, &windows, &params);
    let period_points = assessment.oscillation.period_s.map(|period| period / record.point_s());
    if let Some(left) = &mut taken.downsample {
        left.points_per_period = period_points;
    }
    let options = params.options(period_points);
    Ok(Estimated { record, taken, params, assessment, options, notes })
}

/// Checks that the range can be OP's.
fn check_range(name: &str, op: &[f64], range: [f64; 2]) -> Result<(), AnalysisError> {
    let ends = |of: fn(f64, f64) -> f64| op.iter().copied().reduce(of).unwrap_or_default();
    let (name, ends) = (name.to_owned(), [ends(f64::min), ends(f64::max)]);
    if is_outside(op, range) {
        return Err(AnalysisError::OutsideRange { name, op: ends, range });
    }
    if is_fraction(op, range) {
        return Err(AnalysisError::Fraction { name, op: ends, range });
    }
    Ok(())
}

/// Fraction of its width by which OP may exceed its range, as controllers allow.
const BEYOND: f64 = 0.1;

/// Whether most of OP is outside the range, so that the range cannot be OP's.
fn is_outside(op: &[f64], [low, high]: [f64; 2]) -> bool {
    let beyond = BEYOND * (high - low);
    let outside = op.iter().filter(|x| !(low - beyond..=high + beyond).contains(*x)).count();
    2 * outside > op.len()
}

/// Span of OP, OP units, the upper limit of `fs + fd`; `None` if OP does not move.
#[must_use]
pub fn span_of(record: &Record) -> Option<f64> {
    Some(stats::span(&record.op_path)).filter(|span| span.is_finite() && *span > 0.0)
}

impl Estimated {
    /// The document, with a configuration's hash; `elapsed_ms` is the time from record to result.
    #[must_use]
    pub fn answer(
        &self,
        name: &str,
        config_hash: &str,
        elapsed_ms: f64,
        solver: Option<SolverDocument>,
        scored: Option<Scored>,
    ) -> Answer {
        let assessment = Assessment { elapsed_ms: Some(elapsed_ms), ..self.assessment.clone() };
        Answer {
            document: EstimateDocument::new(name, config_hash, assessment),
            s0: span_of(&self.record),
            selection: self.taken.clone(),
            solver,
            scored,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_op_that_is_a_fraction_of_its_range_is_refused_with_the_option() {
        let op = |low: f64| (0..100).map(|k| low + 0.002 * f64::from(k % 50)).collect::<Vec<f64>>();
        let refused = check_range("FIC101", &op(0.44), [0.0, 100.0]).unwrap_err().to_string();
        assert!(refused.contains("OP runs from 0.44 to 0.538") && refused.contains("--op-range 0,1"), "{refused}");
        assert_eq!(check_range("FIC101", &op(0.44), [0.0, 1.0]), Ok(()));
        assert_eq!(check_range("FIC101", &op(44.0), [0.0, 100.0]), Ok(()));
    }
}
