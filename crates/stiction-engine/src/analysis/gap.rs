//! The gap of one section, as `gap` measures and writes it.

use super::{AnalysisError, Cut, FitOverrides, Points, Section, estimate};
use stiction::core::detect::oscillation;
use stiction::core::gap::document::GapDocument;
use stiction::core::gap::model_file::ModelFile;
use stiction::core::gap::pool::{self, PoolError};
use stiction::core::gap::{self, Base, Diagnosis, Executor, GapError, GapOptions, Neighbour};
use stiction::core::record::Record;
use stiction::core::verdict::Assessment;

/// Most points of a simulation; sections with more samples are averaged in bins.
pub const MAX_POINTS: usize = 8_192;
/// Approximate run time of the default number of evaluations on two cores, s.
const DEFAULT_SECONDS: f64 = 3.0;

/// Options of a diagnosis.
#[derive(Debug, Clone, Default)]
pub struct GapSettings {
    /// Base model for the gap.
    pub base: BaseChoice,
    /// Effects excluded from the catalogue.
    pub without: Vec<String>,
    /// Search pairs of effects even if one effect explains the record.
    pub pairs: bool,
    /// Time for the search, s; sets the number of evaluations in proportion.
    pub budget_s: Option<f64>,
    /// Seed of all random choices.
    pub seed: u64,
}

/// Base model of the gap.
#[derive(Debug, Clone, Default)]
pub enum BaseChoice {
    /// He's valve model with a first-order process, refitted.
    #[default]
    Refit,
    /// No friction.
    Linear,
    /// A given model.
    File(Box<ModelFile>),
}

impl BaseChoice {
    /// The base for a record.
    #[must_use]
    pub fn on(&self, record: &Record) -> Base {
        match self {
            Self::Refit => Base::Refit,
            Self::Linear => Base::Linear,
            Self::File(file) => Base::Given(Box::new(file.on(record))),
        }
    }
}

impl GapSettings {
    /// Search options for a record.
    #[must_use]
    pub fn options(&self, record: &Record) -> GapOptions {
        let share = self.budget_s.map_or(1.0, |seconds| seconds / DEFAULT_SECONDS);
        GapOptions {
            base: self.base.on(record),
            without: self.without.clone(),
            pairs: self.pairs,
            budget_evaluations: (gap::DEFAULT_EVALUATIONS as f64 * share).ceil() as u64,
            seed: self.seed,
            neighbours: Vec::new(),
            period_points: oscillation::detect(&record.op(), &record.pv).map(|o| o.period_points),
        }
    }
}

/// A diagnosed section.
#[derive(Debug, Clone)]
pub struct Diagnosed {
    /// The diagnosis.
    pub document: GapDocument,
    /// The diagnosed record.
    pub record: Record,
    /// The fits behind it.
    pub diagnosis: Diagnosis,
    /// The estimate of the same record.
    pub assessment: Option<Assessment>,
}

/// The record of a section for a diagnosis, and notes for the user.
///
/// # Errors
/// The section is outside the samples, or has too few.
pub fn record(points: &Points, section: Section, cut: &Cut) -> Result<(Record, Vec<String>), AnalysisError> {
    let (record, _, notes) = cut.record(points, section, MAX_POINTS)?;
    Ok((record, notes))
}

/// Another loop on the grid of a diagnosed record.
///
/// # Errors
/// Names the loop, the problem and its remedy.
pub fn neighbour(points: &Points, record: &Record) -> Result<Neighbour, String> {
    let name = &points.name;
    let section = Section::Window(record.start_ns, record.end_ns);
    let told = |e| format!("neighbour {name}: {e}; choose a section by --window that both cover, or leave it out");
    let (other, _) = self::record(points, section, &Cut::default()).map_err(told)?;
    Neighbour::of(name, &other, record).map_err(|e| e.to_string())
}

/// The estimate of a section; `None` if there is none.
#[must_use]
pub fn assessment(points: &Points, section: Section, cut: &Cut) -> Option<Assessment> {
    let params = FitOverrides::default().over(&points.settings.assess);
    estimate(points, section, cut, params).ok().map(|found| found.assessment)
}

/// Diagnoses a record of a loop; `assessment` is its estimate.
///
/// # Errors
/// An unknown effect, or a record that cannot be diagnosed.
pub fn diagnose(
    name: &str,
    record: Record,
    options: &GapOptions,
    executor: &dyn Executor,
    assessment: Option<Assessment>,
) -> Result<Diagnosed, GapError> {
    let diagnosis = gap::diagnose(&record, options, executor)?;
    let document = GapDocument::beside(name, &record, options, &diagnosis, assessment.as_ref());
    Ok(Diagnosed { document, record, diagnosis, assessment })
}

/// One window of a valve, with its separate diagnosis.
#[derive(Debug, Clone)]
pub struct DiagnosedWindow {
    /// Where it comes from.
    pub source: String,
    /// Its separate diagnosis.
    pub alone: Diagnosed,
}

/// Decides from several windows. Returns the diagnosis of the window that shows the answer best, and its index.
///
/// # Errors
/// Names a window that does not match the others.
pub fn decide_together(windows: &[DiagnosedWindow], settings: &GapSettings) -> Result<(usize, Diagnosed), PoolError> {
    check_distinct(windows)?;
    if let Some(window) = windows.iter().find(|w| w.alone.diagnosis.is_worse_than_mean()) {
        return Err(PoolError::NotJudged(window.source.clone()));
    }
    let each: Vec<pool::Window> =
        windows.iter().map(|w| pool::Window::of(&w.source, &w.alone.record, &w.alone.diagnosis)).collect();
    let together = pool::decide_together(&each)?;
    let alone = &windows[together.clearest].alone;
    let (record, diagnosis) = (alone.record.clone(), alone.diagnosis.with_answer_of(&together));
    let options = settings.options(&record);
    let name = &alone.document.loop_name;
    let assessment = alone.assessment.clone();
    let mut document = GapDocument::beside(name, &record, &options, &diagnosis, assessment.as_ref());
    document.pooled = pool::notes(&each, together.clearest);
    Ok((together.clearest, Diagnosed { document, record, diagnosis, assessment }))
}

/// Refuses equal windows: the same samples under two names would count twice.
fn check_distinct(windows: &[DiagnosedWindow]) -> Result<(), PoolError> {
    let is_same = |x: &Record, y: &Record| x.op_path == y.op_path && x.pv == y.pv;
    for (at, window) in windows.iter().enumerate() {
        if let Some(other) = windows[..at].iter().find(|other| is_same(&other.alone.record, &window.alone.record)) {
            let [source_name, other] = [&window.source, &other.source].map(String::clone);
            return Err(PoolError::Twice { source_name, other });
        }
    }
    Ok(())
}
