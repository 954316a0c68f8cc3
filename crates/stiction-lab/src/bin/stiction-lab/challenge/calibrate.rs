//! `stiction-lab challenge calibrate`: fits the decision's numbers to answered challenges of split A (development
//! set), and reports its quality on cases left out of the fit.

use std::iter;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use serde::Deserialize;
use serde_json::json;

use super::{ANSWERS, opened, read, write};
use stiction::core::gap::calibration::Calibration;
use stiction::core::gap::{Alternative as Answered, Decision, Evidence, NONE, UNKNOWN, decide, holds_out};
use stiction_lab::calibrate_gap::{Example, fit};
use stiction_lab::challenge::score::{Alternative, Answer, Called, Figures, is_expressed, score};
use stiction_lab::challenge::{Answer as Right, Split, Truth, TruthCase};
use stictiond::cli::{Format, Outcome, print, say};

/// Thousandths that a share keeps.
const DIGITS: f64 = 1e3;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folders of answered challenges of split A.
    #[arg(required = true, value_name = "DIR")]
    dirs: Vec<PathBuf>,
    /// Output file for the calibration (JSON).
    #[arg(long, value_name = "FILE.json")]
    out: Option<PathBuf>,
    /// Replace an existing output file.
    #[arg(long)]
    force: bool,
    /// Weight of an answer without the true effect; one with the whole catalogue weighs 1.
    #[arg(long, default_value_t = 0.2)]
    withheld: f64,
    /// Cross-validation folds.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u8).range(2..))]
    folds: u8,
}

/// Answer fields that are not scored.
#[derive(Debug, Deserialize)]
struct Kept {
    evidence: Option<Evidence>,
    made_with: MadeWith,
}

#[derive(Debug, Deserialize)]
struct MadeWith {
    search: String,
}

/// A case with its truth, its answer, and the fits behind the answer.
#[derive(Debug, Clone)]
struct Case {
    truth: TruthCase,
    answer: Answer,
    evidence: Option<Evidence>,
    search: String,
}

/// Runs the command.
///
/// # Errors
/// A folder cannot be read, is of split B, or has answers of another version.
pub(super) fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    if let Some(out) = args.out.as_ref().filter(|out| out.exists() && !args.force) {
        bail!("{}: already exists; use --force to replace it", out.display());
    }
    let (mut cases, mut decks, mut first) = (Vec::new(), Vec::new(), None);
    for dir in &args.dirs {
        let truth = opened(dir)?;
        if truth.split != Split::A.name() {
            bail!("{}: split {} is the test set; choose thresholds on split A (odd seeds)", dir.display(), truth.split);
        }
        let read = cases_of(dir, &truth)?;
        decks.push(format!("seed {} ({} cases)", truth.seed, read.len()));
        cases.extend(read);
        first.get_or_insert(truth);
    }
    let search = cases.first().map(|case| case.search.clone()).unwrap_or_default();
    if let Some(other) = cases.iter().find(|case| case.search != search) {
        bail!(
            "{} was answered by search {}, others by {search}; run the challenges again with --force",
            other.truth.name,
            other.search
        );
    }
    let mut made = calibrated(args, &cases).context("no case has an effect; use a larger challenge")?;
    made.from = format!(
        "challenge calibrate --withheld {}; version {}, split A, {}",
        args.withheld,
        stiction::core::VERSION,
        decks.join(", ")
    );
    made.search = search;
    let first = first.context("name at least one folder")?;
    let inside = judged(&first, &cases, |_| Some(&made))?;
    let folds = usize::from(args.folds);
    let parts: Vec<Option<Calibration>> =
        (0..folds).map(|part| calibrated(args, &without(&cases, part, folds))).collect();
    let outside = judged(&first, &cases, |index| parts[index % folds].as_ref())?;
    if let Some(out) = &args.out {
        let mut bytes = serde_json::to_vec_pretty(&made)?;
        bytes.push(b'\n');
        write(out, &bytes)?;
    }
    match format {
        Format::Json => say(json!({ "schema": "stictiond.challenge.calibration.v1", "from": made.from,
            "fitted": inside, "left_out": outside }))?,
        Format::Text => {
            print(&format!("{}\n\n", made.from))?;
            print(&format!("On the cases used in the fit:\n{}\n", inside.text()))?;
            print(&format!("On cases left out of the fit, {folds} folds:\n{}", outside.text()))?;
        }
    }
    Ok(Outcome::Done)
}

/// The cases of a folder; their names contain the seed, so that folders can be combined.
fn cases_of(dir: &Path, truth: &Truth) -> anyhow::Result<Vec<Case>> {
    let path = dir.join(ANSWERS);
    let text = String::from_utf8_lossy(&read(&path)?).into_owned();
    let mut out = Vec::new();
    for line in text.lines() {
        let wrong = || format!("{}: cannot be parsed; run the challenge again with --force", path.display());
        let mut answer: Answer = serde_json::from_str(line).with_context(wrong)?;
        let kept: Kept = serde_json::from_str(line).with_context(wrong)?;
        let Some(case) = truth.cases.iter().find(|c| c.name == answer.recording) else { continue };
        let mut case = case.clone();
        case.name = format!("{}/{}", truth.seed, case.name);
        answer.recording.clone_from(&case.name);
        out.push(Case { truth: case, answer, evidence: kept.evidence, search: kept.made_with.search });
    }
    if out.is_empty() {
        bail!("{}: has no answers; run `stiction-lab challenge run` first", path.display());
    }
    Ok(out)
}

fn without(cases: &[Case], part: usize, parts: usize) -> Vec<Case> {
    cases.iter().enumerate().filter(|(i, _)| i % parts != part).map(|(_, case)| case.clone()).collect()
}

/// Whether the recording itself shows a cause, so that no likelihood is asked.
fn shows_itself(evidence: &Evidence) -> bool {
    !evidence.basis.traces.is_empty() || evidence.basis.skew.is_some()
}

/// The decisions of one case used in the fit: with the whole catalogue, and without the true effect.
fn examples(case: &Case, withheld: f64) -> Vec<Example> {
    let Some(evidence) = case.evidence.as_ref().filter(|e| !shows_itself(e)) else { return Vec::new() };
    let hidden = (!is_expressed(&case.truth, &case.answer)).then_some(NONE);
    let example = |evidence: &Evidence, right: &str, weight: f64| Example {
        evidence: evidence.clone(),
        right: iter::once(right).chain(hidden).map(str::to_owned).collect(),
        weight,
    };
    let truth = case.truth.effect.as_str();
    match case.truth.answer {
        Right::Pair => {
            let either = truth.split('+').chain([truth]);
            vec![Example { right: either.map(str::to_owned).collect(), ..example(evidence, truth, 1.0) }]
        }
        Right::Known => vec![example(evidence, truth, 1.0), example(&evidence.without(truth), UNKNOWN, withheld)],
        Right::None => vec![example(evidence, NONE, 1.0)],
        Right::Foreign => vec![example(evidence, UNKNOWN, 1.0)],
    }
}

/// Fits the numbers, and counts how often what a recording itself shows is right; `None` without an example.
fn calibrated(args: &Args, cases: &[Case]) -> Option<Calibration> {
    let made: Vec<Example> = cases.iter().flat_map(|case| examples(case, args.withheld)).collect();
    let fitted = (!made.is_empty()).then(|| fit(&made, &Calibration::blank()))?;
    let shown: Vec<bool> = cases
        .iter()
        .filter(|case| case.truth.answer != Right::Pair)
        .filter_map(|case| Some((case, case.evidence.as_ref().filter(|e| shows_itself(e))?)))
        .map(|(case, evidence)| decide(&[evidence], &fitted).cause.id == case.truth.effect)
        .collect();
    // One right and one wrong added (Laplace).
    let share = (shown.iter().filter(|right| **right).count() + 1) as f64 / (shown.len() + 2) as f64;
    Some(Calibration { trace: (share * DIGITS).round() / DIGITS, ..fitted })
}

/// All figures with each answer decided again by its calibration, or as answered if there is none.
fn judged<'c>(of: &Truth, cases: &[Case], rule: impl Fn(usize) -> Option<&'c Calibration>) -> anyhow::Result<Figures> {
    let decided = |(index, case): (usize, &Case)| rule(index).map_or_else(|| case.answer.clone(), |r| again(case, r));
    let answers: Vec<Answer> = cases.iter().enumerate().map(decided).collect();
    let truth = Truth { cases: cases.iter().map(|c| c.truth.clone()).collect(), ..of.clone() };
    Ok(score(&truth, &answers)?)
}

/// The figures of a folder with the decision of this version, made from the answers' fits.
///
/// # Errors
/// Answers are missing or of another version.
pub(super) fn decided_again(dir: &Path, truth: &Truth) -> anyhow::Result<Figures> {
    let cases = cases_of(dir, truth)?;
    if let Some(case) = cases.iter().find(|c| c.evidence.is_none() && c.answer.document.is_some()) {
        bail!(
            "{}: {} was answered by a version that did not keep the fits; run the challenge again with --force",
            dir.display(),
            case.truth.name
        );
    }
    judged(truth, &cases, |_| Some(Calibration::shipped()))
}

/// Decides an answer again from its fits.
fn again(case: &Case, rule: &Calibration) -> Answer {
    let mut answer = case.answer.clone();
    let Some(evidence) = &case.evidence else { return answer };
    let called = |decision: &Decision, before: &Called| Called {
        id: decision.cause.id.clone(),
        probability: decision.cause.probability,
        confirmed: if decision.cause.id == before.id {
            before.confirmed
        } else {
            holds_out(&[evidence], &decision.cause.id)
        },
    };
    if let Some(document) = &mut answer.document {
        let decision = decide(&[evidence], rule);
        document.cause = called(&decision, &document.cause);
        decision.cause.stage.name().clone_into(&mut document.place.stage);
        let other = |a: &Answered| Alternative { id: a.id.clone(), probability: a.probability };
        document.second_cause = decision.second.as_ref().map(other);
        document.alternatives = decision.alternatives.iter().map(other).collect();
    }
    answer
}
