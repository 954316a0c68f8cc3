//! The options of a job, with defaults and descriptions.

use schemars::JsonSchema;
use serde::Serialize;

use super::reading::OPTIONS;
use super::request::{BUDGET_S, EVALUATIONS, FINENESS_PCT, GAP_SEED};
use crate::report::IN_FULL;
use stiction::core::gap::effects;
use stiction::core::ident::Options;
use stiction::core::verdict::prevalence::{PREVALENCE, SHARES};
use stiction::toolbox::solvers;
use stiction::toolbox::surface::BUDGET;
use stiction_engine::analysis::MIN_SAMPLES;

/// One of several values.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct Choice {
    /// Its name in requests.
    pub id: String,
    /// Its description.
    pub words: String,
    /// For an effect, the part of the loop where it acts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stage: Option<&'static str>,
    /// Whether it is the default.
    pub default: bool,
}

/// A number within bounds.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct Number {
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
    /// Default; `None` if the program chooses.
    pub default: Option<f64>,
    /// Its unit, empty for a count.
    pub unit: &'static str,
    /// Its description.
    pub words: &'static str,
}

/// All options.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct Choices {
    models: Vec<Choice>,
    valves: Vec<Choice>,
    delays: Vec<Choice>,
    detrends: Vec<Choice>,
    solvers: Vec<Choice>,
    bases: Vec<Choice>,
    effects: Vec<Choice>,
    fineness: Number,
    evaluations: Number,
    prevalence: Number,
    downsample: Number,
    budget_s: Number,
    seed: u64,
    gap_seed: u64,
    /// Fewest samples of a section, and most sections in a job.
    min_samples: usize,
    max_sections: usize,
    /// Options for reading an uploaded file.
    reading: [&'static str; 8],
    /// Largest upload, bytes.
    max_file_bytes: u64,
}

fn choices(all: &[(&str, &str)]) -> Vec<Choice> {
    let one = |(k, (id, words)): (usize, &(&str, &str))| Choice {
        id: (*id).to_owned(),
        words: (*words).to_owned(),
        stage: None,
        default: k == 0,
    };
    all.iter().enumerate().map(one).collect()
}

/// All options; the first in a list is the default.
#[must_use]
pub fn all(max_file_bytes: u64) -> Choices {
    let solvers = [
        ("contour", "Contour: a grid over s and j, then a local search"),
        ("multistart", "Multistart: adaptive random search from many starts"),
        ("random", "Random: adaptive random search from one start"),
        ("branch-bound", "Branch and bound: divides the most promising cells (heuristic)"),
    ];
    let words_of = |name: &str| solvers.iter().find(|(id, _)| *id == name).map_or(name, |(_, words)| *words).to_owned();
    let mut set_beside = choices(&[("", "None: the estimate's own search")]);
    set_beside.extend(solvers::ALL.iter().map(|solver| Choice {
        id: solver.name().to_owned(),
        words: words_of(solver.name()),
        stage: None,
        default: false,
    }));
    let effect = |e: &&effects::Effect| Choice {
        id: e.id.to_owned(),
        words: e.noun.to_owned(),
        stage: Some(e.stage.name()),
        default: false,
    };
    Choices {
        models: choices(&[
            ("both", "Both orders, side by side"),
            ("auto", "Automatic: second order only if it fits better"),
            ("fopdt", "First order, dead time"),
            ("sopdt", "Second order, dead time"),
        ]),
        valves: choices(&[
            ("auto", "The better of the two"),
            ("he", "He: a staircase of slips"),
            ("tracking", "Tracking: slides once it moves"),
        ]),
        delays: choices(&[("auto", "Estimated with the model"), ("samples", "Samples"), ("seconds", "Seconds")]),
        detrends: choices(&[
            ("", "As recorded"),
            ("mean", "Remove the mean"),
            ("median", "Remove the median"),
            ("linear", "Remove the linear trend (drift)"),
        ]),
        solvers: set_beside,
        bases: choices(&[
            ("refit", "Sticking valve, first order, fitted here"),
            ("linear", "No friction: stiction is one of the effects"),
        ]),
        effects: effects::ALL.iter().map(effect).collect(),
        fineness: Number {
            min: FINENESS_PCT[0],
            max: FINENESS_PCT[1],
            default: Some(Options::default().fineness_pct),
            unit: "%",
            words: "Step of the contour grid over the bands, % of OP's span",
        },
        evaluations: Number {
            min: EVALUATIONS[0] as f64,
            max: EVALUATIONS[1] as f64,
            default: Some(BUDGET as f64),
            unit: "",
            words: "Most models that the solver evaluates",
        },
        prevalence: Number {
            min: SHARES[0],
            max: SHARES[1],
            default: Some(PREVALENCE),
            unit: "",
            words: "Share of such loops that stick, which p assumes",
        },
        downsample: Number {
            min: 1.0,
            max: 1e6,
            default: None,
            unit: "samples",
            words: "Samples per point, above 1; fractions are allowed",
        },
        budget_s: Number {
            min: 0.1,
            max: BUDGET_S,
            default: None,
            unit: "s",
            words: "Time for the search, s; default about 5 s on two cores",
        },
        seed: Options::default().seed,
        gap_seed: GAP_SEED,
        min_samples: MIN_SAMPLES,
        max_sections: IN_FULL,
        reading: OPTIONS,
        max_file_bytes,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_solver_has_words() {
        let all = all(1);
        assert_eq!(all.solvers.len(), solvers::ALL.len() + 1);
        assert!(all.solvers.iter().all(|solver| solver.words.contains(": ")), "{:?}", all.solvers);
        assert!(all.effects.iter().all(|effect| effect.stage.is_some() && !effect.words.is_empty()));
    }
}
