//! The gap of one section, as `gap` measures and writes it.

use super::{AnalysisError, Cut, Points, Section};
use stiction::detect::oscillation;
use stiction::gap::document::GapDocument;
use stiction::gap::locate::{Subject, locate};
use stiction::gap::model_file::ModelFile;
use stiction::gap::{self, Base, Diagnosis, Executor, GapError, GapOptions};
use stiction::record::Record;

/// Most points of a simulation: sections with more samples are averaged in boxes.
pub const MAX_POINTS: usize = 8_192;
/// Seconds that the default number of evaluations takes on two cores, about.
const DEFAULT_SECONDS: f64 = 3.0;

/// What is asked of a section.
#[derive(Debug, Clone, Default)]
pub struct GapSettings {
    /// The model that the gap is measured from.
    pub base: BaseChoice,
    /// Effects that are taken out of the catalogue.
    pub without: Vec<String>,
    /// Pairs of effects even where one alone explains the record.
    pub pairs: bool,
    /// Time for the search, s; evaluations in proportion.
    pub budget_s: Option<f64>,
    /// Seed of every random choice.
    pub seed: u64,
}

/// The model that the gap is measured from.
#[derive(Debug, Clone, Default)]
pub enum BaseChoice {
    /// He's law with a first-order process, refitted.
    #[default]
    Refit,
    /// Without friction.
    Linear,
    /// A model from elsewhere.
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
    /// What the search is told of a record.
    #[must_use]
    pub fn options(&self, record: &Record) -> GapOptions {
        let share = self.budget_s.map_or(1.0, |seconds| seconds / DEFAULT_SECONDS);
        GapOptions {
            base: self.base.on(record),
            without: self.without.clone(),
            pairs: self.pairs,
            budget_evaluations: (gap::DEFAULT_EVALUATIONS as f64 * share).ceil() as u64,
            seed: self.seed,
            period_points: oscillation::detect(&record.op(), &record.pv).map(|o| o.period_points),
        }
    }
}

/// A section diagnosed.
#[derive(Debug, Clone)]
pub struct Diagnosed {
    /// What was found.
    pub document: GapDocument,
    /// The record that was diagnosed.
    pub record: Record,
    /// The fits behind it.
    pub diagnosis: Diagnosis,
}

/// The record that a diagnosis of a section looks at, and what a person should know of it.
///
/// # Errors
/// The section lies outside the samples, or holds too little.
pub fn record(points: &Points, section: Section, cut: &Cut) -> Result<(Record, Vec<String>), AnalysisError> {
    let (record, _, notes) = cut.record(points, section, MAX_POINTS)?;
    Ok((record, notes))
}

/// Diagnoses a record of a loop.
///
/// # Errors
/// An unknown effect, or a record that cannot be diagnosed.
pub fn diagnose(
    name: &str,
    record: Record,
    options: &GapOptions,
    executor: &dyn Executor,
) -> Result<Diagnosed, GapError> {
    let diagnosis = gap::diagnose(&record, options, executor)?;
    let location = locate(&record, &Subject::of(&diagnosis, options.period_points, options.seed));
    let document = GapDocument::new(name, &record, &options.base, &diagnosis, location);
    Ok(Diagnosed { document, record, diagnosis })
}
