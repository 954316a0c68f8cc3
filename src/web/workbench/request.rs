//! The request for a job: the options of `analyze` and `gap`, their check, and the equivalent command line.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::fault::Fault;
use crate::report::command::command_line;
use stiction::core::gap::effects;
use stiction::core::gap::model_file::ModelFile;
use stiction::core::optim::SolverName;
use stiction::core::units::{format_rfc3339, parse_time};
use stiction::core::verdict::prevalence::SHARES;
use stiction::core::verdict::{DelayChoice, ModelChoice, ValveChoice};
use stiction::toolbox::surface::BUDGET;
use stiction_engine::analysis::gap::{BaseChoice, GapSettings};
use stiction_engine::analysis::{Cut, Detrend, FitOverrides, Section, delay_choice};

/// Most sections of one job: as many as a report draws in full.
const SECTIONS: usize = crate::report::IN_FULL;
/// Default seed of a diagnosis.
pub const GAP_SEED: u64 = 1;
/// Bounds of the fineness, as on the command line.
pub const FINENESS_PCT: [f64; 2] = [0.5, 50.0];
/// Bounds of the models that a solver may try.
pub const EVALUATIONS: [u64; 2] = [1, 10_000_000];
/// Longest search in a diagnosis, s.
pub const BUDGET_S: f64 = 600.0;
/// File names in the command line for a base and a scored model that came with the request.
const BASE_FILE: &str = "base.json";
const SCORE_FILE: &str = "score.json";

/// Kind of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// One estimate for each section.
    Analyze,
    /// One gap diagnosis for each section.
    Gap,
}

/// `--model`, or both orders one after the other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Model {
    /// First order with dead time.
    Fopdt,
    /// Second order with dead time.
    Sopdt,
    /// Second order only if the data justify its additional parameter.
    #[default]
    Auto,
    /// One run with each of the first two.
    Both,
}

impl Model {
    /// The model of each run.
    #[must_use]
    pub fn runs(self) -> Vec<Self> {
        if self == Self::Both { vec![Self::Fopdt, Self::Sopdt] } else { vec![self] }
    }

    /// Its word on the command line.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Fopdt => "fopdt",
            Self::Sopdt => "sopdt",
            Self::Auto => "auto",
            Self::Both => "both",
        }
    }

    /// The order that it requests.
    #[must_use]
    pub const fn order(self) -> Option<u8> {
        match self {
            Self::Fopdt => Some(1),
            Self::Sopdt => Some(2),
            Self::Auto | Self::Both => None,
        }
    }
}

/// `--valve`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
#[allow(missing_docs)] // as on the command line
pub enum Valve {
    He,
    Tracking,
    #[default]
    Auto,
}

/// `--detrend`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
#[allow(missing_docs)] // as on the command line
pub enum DetrendWord {
    Mean,
    Median,
    Linear,
}

/// A job as requested. Fields that are absent or null have the defaults of the command line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Request {
    /// Kind of the job.
    pub kind: Kind,
    /// The file, by its id.
    pub file: String,
    /// The loop, by its name.
    #[serde(rename = "loop")]
    pub loop_name: String,
    /// Sections: samples from 1, ends included. Absent for the whole record.
    #[serde(default)]
    pub samples: Option<Vec<[usize; 2]>>,
    /// Sections by time, ms since 1970, ends included.
    #[serde(default)]
    pub window_ms: Option<[f64; 2]>,
    /// One point for this many samples.
    #[serde(default)]
    pub downsample: Option<f64>,
    /// Drop samples instead of averaging.
    #[serde(default)]
    pub like_toolbox: bool,
    /// The trend removed from PV and SP.
    #[serde(default)]
    pub detrend: Option<DetrendWord>,
    /// The process model.
    #[serde(default)]
    pub model: Model,
    /// `auto`, samples such as `3`, or seconds such as `12s`.
    #[serde(default)]
    pub delay: Option<String>,
    /// The valve law.
    #[serde(default)]
    pub valve: Valve,
    /// Step of the grid, % of OP's span.
    #[serde(default)]
    pub fineness: Option<f64>,
    /// Seed of every random choice.
    #[serde(default)]
    pub seed: Option<u64>,
    /// A solver to compare with, by name.
    #[serde(default)]
    pub solver: Option<String>,
    /// Models that the solver may try.
    #[serde(default)]
    pub evaluations: Option<u64>,
    /// OP's range, OP units.
    #[serde(default)]
    pub op_range: Option<[f64; 2]>,
    /// Fraction of such loops that stick; p depends on it.
    #[serde(default)]
    pub prevalence: Option<f64>,
    /// Unit of OP on pictures.
    #[serde(default)]
    pub op_unit: Option<String>,
    /// Unit of PV on pictures.
    #[serde(default)]
    pub pv_unit: Option<String>,
    /// A model to run over the record as well: a document or a plain model.
    #[serde(default)]
    pub score: Option<Value>,
    /// `refit`, `linear`, or a model: a document or a plain model.
    #[serde(default)]
    pub base: Option<Value>,
    /// Effects that are excluded.
    #[serde(default)]
    pub without: Vec<String>,
    /// Whether to try pairs of effects even if one alone explains the record.
    #[serde(default)]
    pub pairs: bool,
    /// Time limit of the diagnosis' search, s.
    #[serde(default)]
    pub budget_s: Option<f64>,
}

/// A checked request.
#[derive(Debug, Clone)]
pub struct Task {
    /// The original request.
    pub request: Request,
    /// Sections in order.
    pub sections: Vec<Section>,
    /// Density and trend.
    pub cut: Cut,
    /// The dead time.
    pub delay: DelayChoice,
    /// A model to run over the record as well.
    pub score: Option<ModelFile>,
    /// Options of a diagnosis.
    pub settings: GapSettings,
}

impl Request {
    /// Reads a request.
    ///
    /// # Errors
    /// Names the field that is not understood, and what is valid.
    pub fn read(body: &[u8]) -> Result<Self, Fault> {
        serde_json::from_slice(body).map_err(|error| Fault::wrong(format!("cannot parse the request: {error}")))
    }

    /// Checks everything that can be checked without the file.
    ///
    /// # Errors
    /// Names the field, and what would be valid.
    pub fn task(self) -> Result<Task, Fault> {
        let wrong = |text: String| Err(Fault::wrong(text));
        let of = |field: &'static str| move |why: String| Fault::wrong(format!("{field}: {why}"));
        let sections = self.sections()?;
        if let Some(ratio) = self.downsample.filter(|r| !(r.is_finite() && *r > 1.0)) {
            return wrong(format!("downsample: {ratio} is not above 1; write a number such as 2 or 2.5"));
        }
        if let Some(step) = self.fineness.filter(|f| !(FINENESS_PCT[0]..=FINENESS_PCT[1]).contains(f)) {
            return wrong(format!("fineness: {step} is not from {} to {} %", FINENESS_PCT[0], FINENESS_PCT[1]));
        }
        if let Some(count) = self.evaluations.filter(|n| !(EVALUATIONS[0]..=EVALUATIONS[1]).contains(n)) {
            return wrong(format!("evaluations: {count} is not from {} to {}", EVALUATIONS[0], EVALUATIONS[1]));
        }
        if let Some(share) = self.prevalence.filter(|share| !(SHARES[0]..=SHARES[1]).contains(share)) {
            return wrong(format!("prevalence: {share} is not from {} to {}", SHARES[0], SHARES[1]));
        }
        if let Some([low, high]) = self.op_range.filter(|[low, high]| high <= low) {
            return wrong(format!("op_range: the upper end {high} must be above the lower, {low}"));
        }
        if let Some(name) = self.solver.as_deref().filter(|name| SolverName::of(name).is_none()) {
            // A user's own solver program can only be started from the command line: nobody who reaches this page may do that.
            let known = SolverName::ALL.map(SolverName::name).join(", ");
            return wrong(format!("solver: {:?} is not available here; use one of {known}", super::names::shown(name)));
        }
        if let Some(seconds) = self.budget_s.filter(|s| !(*s > 0.0 && *s <= BUDGET_S)) {
            return wrong(format!("budget_s: {seconds} is not above 0 and at most {BUDGET_S} s"));
        }
        if let Some(id) = self.without.iter().find(|id| !effects::ALL.iter().any(|e| e.id == id.as_str())) {
            let known = effects::ALL.map(|effect| effect.id).join(", ");
            return wrong(format!("without: {:?} is not an effect; use {known}", super::names::shown(id)));
        }
        let delay = delay_choice(self.delay.as_deref().unwrap_or("auto")).map_err(of("delay"))?;
        let score = self.score.as_ref().map(model).transpose().map_err(of("score"))?;
        let base = match self.base.as_ref().map(|base| (base.as_str(), base)) {
            None | Some((Some("refit"), _)) => BaseChoice::Refit,
            Some((Some("linear"), _)) => BaseChoice::Linear,
            Some((Some(_), _)) => return wrong("base: write refit, linear, or a model's document".to_owned()),
            Some((None, document)) => BaseChoice::File(Box::new(model(document).map_err(of("base"))?)),
        };
        let settings = GapSettings {
            base,
            without: self.without.clone(),
            pairs: self.pairs,
            budget_s: self.budget_s,
            seed: self.seed.unwrap_or(GAP_SEED),
        };
        let detrend = self.detrend.map(|word| match word {
            DetrendWord::Mean => Detrend::Mean,
            DetrendWord::Median => Detrend::Median,
            DetrendWord::Linear => Detrend::Linear,
        });
        let cut = Cut { downsample: self.downsample, like_toolbox: self.like_toolbox, detrend };
        Ok(Task { request: self, sections, cut, delay, score, settings })
    }

    fn sections(&self) -> Result<Vec<Section>, Fault> {
        let mut sections = Vec::new();
        for [start, end] in self.samples.iter().flatten() {
            let section = Section::of_samples(*start, *end);
            sections.push(section.map_err(|why| Fault::wrong(format!("samples {start} to {end}: {why}")))?);
        }
        if let Some([from, to]) = self.window_ms {
            let ns = |ms: f64| (ms * 1e6).round() as i64;
            sections
                .push(Section::of_times(ns(from), ns(to)).map_err(|why| Fault::wrong(format!("window_ms: {why}")))?);
        }
        if sections.len() > SECTIONS {
            return Err(Fault::wrong(format!(
                "{} sections are selected; at most {SECTIONS} are allowed per run",
                sections.len()
            )));
        }
        if sections.is_empty() {
            sections.push(Section::Whole);
        }
        Ok(sections)
    }

    /// Equivalent command lines, one for each run; `file` and `alone` as for [`Request::arguments`].
    #[must_use]
    pub fn commands(&self, file: &[String], alone: bool) -> Vec<String> {
        let runs = if self.kind == Kind::Gap { vec![Model::Auto] } else { self.model.runs() };
        let words = |run| std::iter::once("stictiond".to_owned()).chain(self.arguments(run, file, alone));
        runs.into_iter().map(|run| command_line(words(run))).collect()
    }

    /// Arguments of the command line for a run: `file` is the file's name with its reading options; `alone` says that the file
    /// holds no other loop.
    #[must_use]
    pub fn arguments(&self, run: Model, file: &[String], alone: bool) -> Vec<String> {
        let mut words = vec![if self.kind == Kind::Gap { "gap" } else { "analyze" }.to_owned()];
        words.extend_from_slice(file);
        let mut option = |name: &str, value: Option<String>| {
            if let Some(value) = value {
                // A value that begins with a dash would be taken for an option.
                if value.starts_with('-') {
                    words.push(format!("{name}={value}"));
                } else {
                    words.extend([name.to_owned(), value]);
                }
            }
        };
        option("--loop", (!alone).then(|| self.loop_name.clone()));
        for [start, end] in self.samples.iter().flatten() {
            option("--samples", Some(format!("{start},{end}")));
        }
        option("--window", self.window_ms.map(|ends| ends.map(moment).join(",")));
        option("--downsample", self.downsample.map(|ratio| ratio.to_string()));
        let defaults = FitOverrides::default();
        let unlike = |seed: u64, usual: u64| (seed != usual).then(|| seed.to_string());
        let file_of = |name: &str, given: bool| given.then(|| name.to_owned());
        match self.kind {
            Kind::Analyze => {
                option("--model", (run != Model::Auto).then(|| run.word().to_owned()));
                option("--delay", self.delay.clone().filter(|delay| delay != "auto"));
                let valve = match self.valve {
                    Valve::He => Some("he"),
                    Valve::Tracking => Some("tracking"),
                    Valve::Auto => None,
                };
                option("--valve", valve.map(str::to_owned));
                option("--op-range", self.op_range.map(|[low, high]| format!("{low},{high}")));
                option("--prevalence", self.prevalence.map(|share| share.to_string()));
                option("--solver", self.solver.clone());
                let fineness = self.fineness.filter(|step| *step != defaults.fineness_pct);
                option("--fineness", fineness.map(|step| step.to_string()));
                let evaluations = self.evaluations.filter(|count| *count != BUDGET && self.solver.is_some());
                option("--evaluations", evaluations.map(|count| count.to_string()));
                option("--seed", self.seed.and_then(|seed| unlike(seed, defaults.seed)));
                option("--score", file_of(SCORE_FILE, self.score.is_some()));
            }
            Kind::Gap => {
                let base = self.base.as_ref().filter(|base| base.as_str() != Some("refit"));
                option("--base", base.map(|base| base.as_str().unwrap_or(BASE_FILE).to_owned()));
                self.without.iter().for_each(|id| option("--without", Some(id.clone())));
                option("--budget", self.budget_s.map(|seconds| seconds.to_string()));
                option("--seed", self.seed.and_then(|seed| unlike(seed, GAP_SEED)));
            }
        }
        let detrend = self.detrend.map(|word| match word {
            DetrendWord::Mean => "mean",
            DetrendWord::Median => "median",
            DetrendWord::Linear => "linear",
        });
        option("--detrend", detrend.map(str::to_owned));
        if self.like_toolbox && self.downsample.is_some() {
            words.push("--downsample-like-toolbox".to_owned());
        }
        if self.kind == Kind::Gap && self.pairs {
            words.push("--pairs".to_owned());
        }
        words
    }
}

impl Task {
    /// The loop's settings with the options of a run.
    #[must_use]
    pub fn asked(&self, run: Model) -> FitOverrides {
        let (asked, defaults) = (&self.request, FitOverrides::default());
        FitOverrides {
            op_range: asked.op_range,
            prevalence: asked.prevalence,
            fineness_pct: asked.fineness.unwrap_or(defaults.fineness_pct),
            seed: asked.seed.unwrap_or(defaults.seed),
            delay: self.delay,
            model: match run {
                Model::Fopdt => ModelChoice::Fopdt,
                Model::Sopdt => ModelChoice::Sopdt,
                Model::Auto | Model::Both => ModelChoice::Auto,
            },
            valve: match asked.valve {
                Valve::He => ValveChoice::He,
                Valve::Tracking => ValveChoice::Tracking,
                Valve::Auto => ValveChoice::Auto,
            },
        }
    }
}

/// A time in the form that the command line reads back to the nanosecond.
fn moment(ms: f64) -> String {
    let ns = (ms * 1e6).round() as i64;
    let text = format_rfc3339(ns);
    if parse_time(&text) == Ok(ns) { text } else { format!("{ns}ns") }
}

fn model(document: &Value) -> Result<ModelFile, String> {
    ModelFile::parse(&document.to_string()).map_err(|error| error.to_string())
}
