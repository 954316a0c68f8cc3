//! `stiction-lab challenge calibrate`: fits the decision's probabilities to answered challenges of split A (development
//! set), and reports its quality on cases left out of the fit.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use serde::Deserialize;
use serde_json::json;

use super::{ANSWERS, opened, read, write};
use stiction::core::gap::evidence::Evidence;
use stiction::core::gap::probability::{Calibration, Features, Outcome as Came};
use stiction::core::gap::{Alternative as Answered, By, Decision, NONE, UNKNOWN, decide, holds_out};
use stiction_lab::calibrate_gap::fit;
use stiction_lab::challenge::score::{Alternative, Answer, Called, Figures, is_expressed, score};
use stiction_lab::challenge::{Answer as Right, Split, Truth, TruthCase};
use stictiond::cli::{Format, Outcome, print, say};

/// Thresholds tried.
const STEP: f64 = 0.01;
/// Lowest threshold: a named effect with less probability would look like a guess, even if it were often right.
const LEAST_NAMED: f64 = 0.4;

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
    /// Precision of the named effects at which the threshold is chosen.
    #[arg(long, default_value_t = 0.9)]
    precision: f64,
    /// Weight of an answer without the true effect; one with the whole catalogue weighs 1.
    #[arg(long, default_value_t = 0.15)]
    withheld: f64,
    /// L2 penalty on the feature weights.
    #[arg(long, default_value_t = 1.0)]
    ridge: f64,
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
        "challenge calibrate --precision {} --withheld {} --ridge {}; version {}, split A, {}",
        args.precision,
        args.withheld,
        args.ridge,
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
            "name_from": made.name_from, "fitted": inside, "left_out": outside }))?,
        Format::Text => {
            print(&format!("{}\nan effect is named at p >= {:.2}\n\n", made.from, made.name_from))?;
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

/// The decisions of one case used in the fit: with the whole catalogue, and without the true effect.
fn examples(case: &Case, withheld: f64) -> Vec<(Features, Came, f64)> {
    let Some(evidence) = &case.evidence else { return Vec::new() };
    let blank = Calibration::blank();
    let shows = is_expressed(&case.truth, &case.answer);
    let come = |decision: &Decision, right: Option<&str>| {
        let ahead = evidence.contenders.iter().any(|c| Some(c.id.as_str()) == right && c.lead > 0.0);
        match case.truth.answer {
            Right::Known if ahead && decision.best.as_deref() == right => Came::Right,
            Right::None => Came::None,
            _ if !shows => Came::None,
            _ => Came::Other,
        }
    };
    let mut out = Vec::new();
    let mut add = |evidence: &Evidence, right: Option<&str>, weight: f64| {
        let decision = decide(evidence, &blank);
        if decision.by == By::Choice {
            out.push((decision.features, come(&decision, right), weight));
        }
    };
    let truth = case.truth.effect.as_str();
    match case.truth.answer {
        Right::Pair => {}
        Right::Known => {
            add(evidence, Some(truth), 1.0);
            add(&evidence.without(truth), None, withheld);
        }
        Right::None | Right::Foreign => add(evidence, None, 1.0),
    }
    out
}

/// Fits the weights, then threshold and precision by cases left out; `None` without an example.
fn calibrated(args: &Args, cases: &[Case]) -> Option<Calibration> {
    let folds = usize::from(args.folds);
    let weights = |cases: &[Case]| {
        let made: Vec<_> = cases.iter().flat_map(|case| examples(case, args.withheld)).collect();
        (!made.is_empty()).then(|| fit(&made, args.ridge))
    };
    let inner: Vec<Calibration> = (0..folds)
        .map(|part| Some(Calibration { weights: weights(&without(cases, part, folds))?, ..Calibration::blank() }))
        .collect::<Option<_>>()?;
    let steps = (LEAST_NAMED / STEP).round() as usize..(0.95 / STEP) as usize;
    let tried: Vec<(f64, Tally)> = steps
        .map(|step| step as f64 * STEP)
        .map(|name_from| (name_from, Tally::of(cases, &inner, name_from)))
        .collect();
    let precise = tried.iter().filter(|(_, t)| t.named.share() >= args.precision);
    let widest = precise.max_by_key(|(_, t)| t.covered);
    let (name_from, tally) =
        widest.or_else(|| tried.iter().max_by(|a, b| a.1.named.share().total_cmp(&b.1.named.share())))?;
    Some(Calibration {
        weights: weights(cases)?,
        name_from: (name_from / STEP).round() * STEP,
        trace: tally.trace.smoothed(),
        by_mv: tally.by_mv.smoothed(),
        second: tally.second.smoothed(),
        coloured_noise: tally.coloured.smoothed(),
        neighbour: Calibration::shipped().neighbour,
        unknown: tally.unknown.smoothed(),
        from: String::new(),
        search: String::new(),
    })
}

/// Number right of a total.
#[derive(Debug, Clone, Copy, Default)]
struct Count {
    right: usize,
    of: usize,
}

impl Count {
    fn add(&mut self, right: bool) {
        self.of += 1;
        self.right += usize::from(right);
    }

    fn share(self) -> f64 {
        self.right as f64 / self.of.max(1) as f64
    }

    /// The precision with one right and one wrong added (Laplace), to three digits.
    fn smoothed(self) -> f64 {
        ((self.right + 1) as f64 / (self.of + 2) as f64 * 1e3).round() / 1e3
    }
}

/// Result of a threshold.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    named: Count,
    trace: Count,
    by_mv: Count,
    /// Effects named in addition to recorder artefacts, over all cases.
    second: Count,
    coloured: Count,
    unknown: Count,
    /// Cases with an effect of the catalogue whose answer names one.
    covered: usize,
}

impl Tally {
    /// Each case by the calibration of the fold that left it out; those with two effects count only for the second.
    fn of(cases: &[Case], parts: &[Calibration], name_from: f64) -> Self {
        let mut tally = Self::default();
        let rules: Vec<Calibration> = parts.iter().map(|c| Calibration { name_from, ..c.clone() }).collect();
        for (index, case) in cases.iter().enumerate() {
            let Some(evidence) = &case.evidence else { continue };
            let decision = decide(evidence, &rules[index % rules.len()]);
            if let (By::Trace, Some(second)) = (decision.by, &decision.second) {
                tally.second.add(case.truth.effect.split('+').any(|part| part == second.id));
            }
            if case.truth.answer == Right::Pair {
                continue;
            }
            let said = decision.cause.id.as_str();
            let right = said == case.truth.effect || (said == UNKNOWN && case.truth.answer == Right::Foreign);
            if said != NONE && said != UNKNOWN {
                tally.named.add(right);
                tally.covered += usize::from(case.truth.answer == Right::Known);
            }
            match decision.by {
                By::Trace => tally.trace.add(right),
                By::Mv => tally.by_mv.add(right),
                By::Choice if said == "coloured_noise" => tally.coloured.add(right),
                By::Choice if said == UNKNOWN => tally.unknown.add(right),
                By::Choice => {}
            }
        }
        tally
    }
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
        confirmed: if decision.cause.id == before.id { before.confirmed } else { holds_out(evidence, &decision.cause) },
    };
    if let Some(document) = &mut answer.document {
        let decision = decide(evidence, rule);
        document.cause = called(&decision, &document.cause);
        decision.cause.stage.name().clone_into(&mut document.place.stage);
        let other = |a: &Answered| Alternative { id: a.id.clone(), probability: a.probability };
        document.second_cause = decision.second.as_ref().map(other);
        document.alternatives = decision.alternatives.iter().map(other).collect();
    }
    answer
}
