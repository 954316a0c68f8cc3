//! Python words and numbers to fit options; each fault names its argument and the remedy.

use pyo3::prelude::*;

use crate::refused;
use stiction::core::optim::{Settings, SolverName};
use stiction::core::units::{LoopKind, parse_time};
use stiction::core::verdict::{AssessParams, ModelChoice, ValveChoice};
use stiction::toolbox::surface::BUDGET;
use stiction_engine::analysis::{self, Cut, Detrend, Section, delay_choice};
use stiction_engine::config::Config;

/// Section and density: the same for every function.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Look {
    samples: Option<(usize, usize)>,
    window: Option<(String, String)>,
    downsample: Option<f64>,
    downsample_like_toolbox: bool,
    detrend: Option<String>,
}

/// Fit options.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Fit {
    op_range: Option<(f64, f64)>,
    prevalence: f64,
    kind: Option<String>,
    model: String,
    delay: String,
    valve: String,
    solver: Option<String>,
    fineness_pct: f64,
    evaluations: u64,
    seed: u64,
}

/// The named value among the valid ones.
fn one_of<T>(argument: &str, written: &str, known: &[(&str, T)]) -> PyResult<T>
where
    T: Copy,
{
    let names = || known.iter().map(|(name, _)| format!("{name:?}")).collect::<Vec<_>>().join(", ");
    let found = known.iter().find(|(name, _)| *name == written).map(|(_, value)| *value);
    found.ok_or_else(|| refused(argument, format!("{written:?} is not a valid value; write one of {}", names())))
}

impl Look {
    /// The section and its density.
    pub fn read(&self) -> PyResult<(Section, Cut)> {
        let section = match (&self.samples, &self.window) {
            (Some(_), Some(_)) => return Err(refused("samples", "and window both select a section; give one of them")),
            (Some((start, end)), None) => Section::of_samples(*start, *end).map_err(|e| refused("samples", e))?,
            (None, Some((from, to))) => {
                Section::of_times(stamp("window", from)?, stamp("window", to)?).map_err(|e| refused("window", e))?
            }
            (None, None) => Section::Whole,
        };
        if let Some(ratio) = self.downsample.filter(|ratio| !(ratio.is_finite() && *ratio > 1.0)) {
            return Err(refused(
                "downsample",
                format!("{ratio} is not a ratio; give a number above 1, such as 2 or 2.5"),
            ));
        }
        if self.downsample_like_toolbox && self.downsample.is_none() {
            return Err(refused("downsample_like_toolbox", "needs downsample, the ratio"));
        }
        let detrends = [("mean", Detrend::Mean), ("median", Detrend::Median), ("linear", Detrend::Linear)];
        let detrend = self.detrend.as_deref().map(|word| one_of("detrend", word, &detrends)).transpose()?;
        let cut = Cut { downsample: self.downsample, like_toolbox: self.downsample_like_toolbox, detrend };
        Ok((section, cut))
    }
}

/// A time in the command line's format.
pub fn stamp(argument: &str, text: &str) -> PyResult<i64> {
    let read = match text.strip_suffix("ns") {
        Some(ns) => ns.parse::<i64>().map_err(|_| format!("{text:?} is not a whole number of ns")),
        None => parse_time(text).map_err(|e| e.to_string()),
    };
    read.map_err(|e| refused(argument, e))
}

/// An additional solver.
#[derive(Debug, Clone, Copy)]
pub struct FitOverrides {
    /// The solver.
    pub solver: SolverName,
    /// Most models, grid step, seed.
    pub settings: Settings,
}

impl Fit {
    /// Options that override a loop's settings.
    pub fn over(&self, own: &AssessParams) -> PyResult<AssessParams> {
        let delay = delay_choice(&self.delay).map_err(|e| refused("delay", e))?;
        if let Some((low, high)) =
            self.op_range.filter(|(low, high)| !(low.is_finite() && high.is_finite() && high > low))
        {
            return Err(refused("op_range", format!("({low}, {high}) is empty; give (low, high), such as (0, 100)")));
        }
        if !(0.5..=50.0).contains(&self.fineness_pct) {
            return Err(refused("fineness_pct", format!("{} is not a step; give 0.5 to 50 %", self.fineness_pct)));
        }
        if !(0.001..=0.999).contains(&self.prevalence) {
            let why = format!("{} is not a share; give 0.001 to 0.999, such as 0.1 for one in ten", self.prevalence);
            return Err(refused("prevalence", why));
        }
        let asked = analysis::FitOverrides {
            model: one_of("model", &self.model, &ModelChoice::ALL)?,
            valve: one_of("valve", &self.valve, &ValveChoice::ALL)?,
            delay,
            op_range: self.op_range.map(Into::into),
            prevalence: Some(self.prevalence),
            fineness_pct: self.fineness_pct,
            seed: self.seed,
        };
        let mut params = asked.over(own);
        if let Some(word) = &self.kind {
            params.kind = one_of("kind", word, &LoopKind::ALL.map(|kind| (kind.name(), kind)))?;
        }
        Ok(params)
    }

    /// The requested solver.
    pub fn solver(&self) -> PyResult<Option<FitOverrides>> {
        if !(1..=10_000_000).contains(&self.evaluations) {
            let why = format!("{} is out of range; give 1 to 10000000, such as {BUDGET}", self.evaluations);
            return Err(refused("evaluations", why));
        }
        let Some(word) = &self.solver else { return Ok(None) };
        let solver = one_of("solver", word, &SolverName::ALL.map(|solver| (solver.name(), solver)))?;
        let settings = Settings { budget: self.evaluations, fineness_pct: self.fineness_pct, seed: self.seed };
        Ok(Some(FitOverrides { solver, settings }))
    }
}

/// The default configuration, as for tables on the command line.
pub fn config() -> Config {
    Config::with_prefix("plant")
}
