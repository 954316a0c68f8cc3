//! One estimate of one section, as `analyze` makes and writes it.

use serde::Serialize;

use super::solver::SolverDocument;
use super::{AnalysisError, Cut, Points, Section, Taken};
use stiction::gap::model_file::ModelFile;
use stiction::gap::score::score;
use stiction::gap::{GapError, GapOptions};
use stiction::ident::Options;
use stiction::record::Record;
use stiction::signal::stats;
use stiction::verdict::{
    AssessParams, Assessment, DelayChoice, EstimateDocument, ModelChoice, ValveChoice, assess_in_windows,
};

/// How well a model from elsewhere follows the record, free run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scored {
    /// Where it came from.
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
    /// The model cannot be run on it.
    pub fn of(name: &str, file: &ModelFile, record: &Record, period_points: Option<f64>) -> Result<Self, GapError> {
        let options = GapOptions { period_points, ..GapOptions::default() };
        let found = score(record, &file.on(record), &options)?;
        Ok(Self { model: name.to_owned(), mse: found.mse, fit_pct: found.fit_pct })
    }
}

/// An estimate with what `analyze` adds to the published document.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Answer {
    /// As the daemon would publish it.
    #[serde(flatten)]
    pub document: EstimateDocument,
    /// Span of OP, which `fs + fd` was kept within; null where OP does not move.
    pub s0: Option<f64>,
    /// What of the recording was looked at.
    pub selection: Taken,
    /// What the solver found that was asked for.
    pub solver: Option<SolverDocument>,
    /// How well the model follows that was given.
    pub scored: Option<Scored>,
}

/// Reads a dead time: `auto`, a number of samples such as `3`, or seconds such as `12s`; fractions too.
///
/// # Errors
/// What would be right, in a sentence.
pub fn delay_choice(text: &str) -> Result<DelayChoice, String> {
    let number = |s: &str| {
        s.trim().parse::<f64>().ok().filter(|v| v.is_finite() && *v >= 0.0).ok_or_else(|| {
            format!("{text:?} is no dead time: write auto, a number of samples such as 3, or seconds such as 12s")
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

/// What a fit is asked, over a loop's own settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Asked {
    /// Order of the process model.
    pub model: ModelChoice,
    /// Valve law.
    pub valve: ValveChoice,
    /// Dead time.
    pub delay: DelayChoice,
    /// OP's range, `[low, high]`; `None` leaves the loop's own.
    pub op_range: Option<[f64; 2]>,
    /// Step of the contour grid, % of OP's span.
    pub fineness_pct: f64,
    /// Seed of every random choice.
    pub seed: u64,
}

impl Default for Asked {
    fn default() -> Self {
        let Options { model, valve, delay, fineness_pct, seed, .. } = Options::default();
        Self { model, valve, delay, op_range: None, fineness_pct, seed }
    }
}

impl Asked {
    /// A loop's settings with this over them.
    #[must_use]
    pub fn over(&self, own: &AssessParams) -> AssessParams {
        let Self { model, valve, delay, op_range, fineness_pct, seed } = *self;
        let fit = Options { model, valve, delay, fineness_pct, seed, ..own.fit };
        AssessParams { op_range: op_range.or(own.op_range), fit, ..own.clone() }
    }
}

/// A section judged.
#[derive(Debug, Clone)]
pub struct Estimated {
    /// The record that it was made from.
    pub record: Record,
    /// What of the recording that is.
    pub taken: Taken,
    /// What the fit was told.
    pub params: AssessParams,
    /// What it says.
    pub assessment: Assessment,
    /// What a solver on the same surface is told.
    pub options: Options,
    /// What a person should know, one line each.
    pub notes: Vec<String>,
}

/// Judges a section, however short. `params` are the loop's settings with what was asked for over them; a dead time in
/// samples counts those of the recording.
///
/// # Errors
/// The section lies outside the samples, or holds too little.
pub fn estimate(
    points: &Points,
    section: Section,
    cut: &Cut,
    mut params: AssessParams,
) -> Result<Estimated, AnalysisError> {
    let (record, mut taken, notes) = cut.record(points, section, points.settings.window.max_points)?;
    params.always_fit = true;
    if let (DelayChoice::Samples(count), Some(left)) = (params.fit.delay, &taken.downsample) {
        params.fit.delay = DelayChoice::Seconds(count * left.ts_s);
    }
    // What was asked to be looked at in another density or without its trend is taken as it then stands.
    let windows = if cut.is_plain() { points.windows(section)? } else { Vec::new() };
    let assessment = assess_in_windows(&record, &windows, &params);
    let period_points = assessment.oscillation.period_s.map(|period| period / record.point_s());
    if let Some(left) = &mut taken.downsample {
        left.points_per_period = period_points;
    }
    let options = params.options(period_points);
    Ok(Estimated { record, taken, params, assessment, options, notes })
}

/// Span of OP, OP units, which `fs + fd` is kept within; `None` where OP does not move.
#[must_use]
pub fn span_of(record: &Record) -> Option<f64> {
    Some(stats::span(&record.op_path)).filter(|span| span.is_finite() && *span > 0.0)
}

impl Estimated {
    /// The document, under a configuration's hash; `elapsed_ms` is from record to result.
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
