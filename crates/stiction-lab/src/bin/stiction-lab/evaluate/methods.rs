//! Compares the shipped classifier with published methods, on the same recordings and simulated loops.

use super::Judged;
use super::simulated::Loops;
use serde_json::{Value, json};
use stiction::core::record::Record;
use stiction::core::units::LoopKind;
use stiction::core::verdict::rule::Rule;
use stiction::core::verdict::tally::{Scored, Tally};
use stiction::core::verdict::{Assessment, assess_in_windows};
use stiction_engine::analysis::Judgeable;
use stiction_lab::truth::methods::{ALL, Answer, Case};
use stiction_lab::truth::rates::{Called, count, share};
use stiction_lab::truth::{Half, verdict_case};
use stictiond::cli::{Format, say};

/// Largest share of the calibration half's healthy loops that a chosen threshold may call sticking.
const FALSE_POSITIVES: f64 = 0.05;
/// The classifier and the published methods.
const COUNT: usize = 1 + ALL.len();

/// Answers of the classifier and of each published method for one record.
pub type Answers = [Answer; COUNT];

/// Applies the published methods and puts the classifier's answer first.
pub fn answers(record: &Record, assessment: &Assessment, integrating: bool) -> Answers {
    let case = Case::new(record, integrating);
    let classifier = Answer { statistic: assessment.p_calibrated, sticks: assessment.stiction };
    core::array::from_fn(|at| at.checked_sub(1).map_or(classifier, |at| ALL[at].answer(&case)))
}

/// A level loop counts as integrating, as the methods' users would assume.
pub const fn integrates(kind: LoopKind) -> bool {
    matches!(kind, LoopKind::Level)
}

fn name(at: usize) -> &'static str {
    at.checked_sub(1).map_or("shipped classifier", |at| ALL[at].name())
}

/// Rule that turns a statistic into an answer.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Decision {
    /// By the published thresholds; for the classifier, by its own.
    Published,
    /// Sticking above this statistic.
    Above(f64),
}

impl Decision {
    fn of(self, answer: &Answer) -> Option<bool> {
        match self {
            Self::Published => answer.sticks,
            Self::Above(threshold) => answer.statistic.map(|x| x > threshold),
        }
    }

    fn words(self, at: usize) -> String {
        match (self, at.checked_sub(1)) {
            (Self::Above(threshold), _) => format!("> {threshold:.3}"),
            (Self::Published, None) => format!("p >= {}", Rule::shipped().cuts.called),
            (Self::Published, Some(at)) => ALL[at].decision().to_owned(),
        }
    }
}

/// One simulated loop with all answers.
struct Loop {
    sticks: bool,
    answers: Answers,
}

fn loops_of(loops: Loops, half: Half) -> Vec<Loop> {
    loops.each(half, |seed| {
        let case = verdict_case(half, seed);
        let Judgeable { record, windows, params } = case.judgeable();
        let assessment = assess_in_windows(&record, &windows, &params);
        let answers = answers(&record, &assessment, case.process.integrating);
        Loop { sticks: case.sticks, answers }
    })
}

/// The lowest threshold with at most the allowed share of false positives among these loops.
fn threshold(loops: &[Loop], at: usize) -> f64 {
    let healthy = loops.iter().filter(|one| !one.sticks);
    let mut found: Vec<f64> = healthy.map(|one| one.answers[at].statistic.unwrap_or(f64::NEG_INFINITY)).collect();
    found.sort_by(|a, b| b.total_cmp(a));
    let allowed = (FALSE_POSITIVES * found.len() as f64) as usize;
    found.get(allowed).copied().unwrap_or(f64::INFINITY)
}

/// Prints the comparison: first the simulated loops, if there are any, then the recordings.
///
/// # Errors
/// Nothing can be printed.
pub fn print(judged: &[Judged], loops: Option<Loops>, format: Format) -> anyhow::Result<()> {
    let mut sets: Vec<[Decision; COUNT]> = vec![[Decision::Published; COUNT]];
    let mut report = Vec::new();
    if let Some(loops) = loops {
        let calibration = loops_of(loops, Half::Calibration);
        sets.push(core::array::from_fn(|at| Decision::Above(threshold(&calibration, at))));
        report = loops_of(loops, Half::Report);
    }
    if format == Format::Json {
        return print_json(judged, &report, &sets);
    }
    if let Some(Loops { count, seed }) = loops {
        say(format!("{count} simulated loops of the report half from seed {seed}, 95 % intervals:"))?;
        for (decisions, words) in sets.iter().zip(["published thresholds", "chosen thresholds"]) {
            say(format!("{words}:"))?;
            for line in simulated_table(&report, decisions) {
                say(line)?;
            }
        }
        let share = 100.0 * FALSE_POSITIVES;
        say(format!("chosen: at most {share} % false positives on {count} loops of the calibration half\n"))?;
    }
    if judged.is_empty() {
        return Ok(());
    }
    for (decisions, words) in sets.iter().zip(["published thresholds", "thresholds chosen on simulated loops"]) {
        say(format!("recordings, {words}:"))?;
        for line in recordings_table(judged, decisions) {
            say(line)?;
        }
    }
    say("\nrecordings that a method gets wrong (published thresholds):")?;
    for line in wrong_cases(judged) {
        say(line)?;
    }
    Ok(())
}

fn simulated_table(loops: &[Loop], decisions: &[Decision; COUNT]) -> Vec<String> {
    let row = |method: &str, decision: &str, cells: [String; 3]| {
        let [answered, positives, negatives] = cells;
        format!("  {method:<25} {decision:<32} {answered:<26} {positives:<26} {negatives}").trim_end().to_owned()
    };
    let heads = ["answered", "true positives", "false positives"].map(str::to_owned);
    let mut lines = vec![row("method", "sticking if", heads)];
    lines.extend((0..COUNT).map(|at| {
        let of = |one: &Loop| decisions[at].of(&one.answers[at]);
        let called = |one: &Loop| Called { kind: "", sticks: one.sticks, called: [of(one) == Some(true)] };
        let table: Vec<Called<'_, 1>> = loops.iter().map(called).collect();
        let answered = loops.iter().filter(|one| of(one).is_some()).count();
        let [positives, negatives] = [true, false].map(|sticks| count(&table, sticks, 0)).map(|(k, n)| share(k, n));
        row(name(at), &decisions[at].words(at), [share(answered, loops.len()), positives, negatives])
    }));
    lines
}

/// The scored recordings that could be read.
fn scored(judged: &[Judged], at: usize, decision: Decision) -> impl Iterator<Item = (&Judged, Scored)> {
    judged.iter().filter_map(move |one| {
        let answer = one.answers.as_ref()?[at];
        let truth = one.case.truth()?;
        Some((one, Scored { truth, answer: decision.of(&answer), p: None, weight: 1.0 }))
    })
}

fn recordings_table(judged: &[Judged], decisions: &[Decision; COUNT]) -> Vec<String> {
    let mut sources: Vec<&str> = Vec::new();
    for one in judged.iter().filter(|one| one.case.truth().is_some()) {
        if !sources.contains(&one.case.source.as_str()) {
            sources.push(&one.case.source);
        }
    }
    let of_sources: String = sources.iter().map(|source| format!(" {source:>7}")).collect();
    let mut lines =
        vec![format!("  {:<25} {:>7} {:>12}{of_sources}   TP  FN  FP  TN  unanswered", "method", "right", "95 %")];
    lines.extend((0..COUNT).map(|at| {
        let tally = |source: Option<&str>| {
            let mine = scored(judged, at, decisions[at]).filter(|(one, _)| source.is_none_or(|s| one.case.source == s));
            Tally::of(&mine.map(|(_, scored)| scored).collect::<Vec<_>>())
        };
        let ratio = |t: &Tally| format!("{}/{}", t.right(), t.total());
        let all = tally(None);
        let interval = all.interval().map_or("-".to_owned(), |[low, high]| format!("{low:.2}..{high:.2}"));
        let by_source: String = sources.iter().map(|s| format!(" {:>7}", ratio(&tally(Some(s))))).collect();
        format!(
            "  {:<25} {:>7} {interval:>12}{by_source}  {:>3} {:>3} {:>3} {:>3} {:>11}",
            name(at),
            ratio(&all),
            all.found,
            all.missed,
            all.false_alarms,
            all.cleared,
            all.unanswered
        )
    }));
    lines
}

/// One line per recording with each method's result: false negative or false positive, `-` without an answer, `.` if right.
fn wrong_cases(judged: &[Judged]) -> Vec<String> {
    let heads = ["classifier", "toolbox", "Horch", "He", "Yamashita"].map(|head| format!(" {head:>10}")).concat();
    let mut lines = vec![format!("  {:<50} {:<12}{heads}", "recording", "label")];
    for one in judged {
        let (Some(answers), Some(truth)) = (&one.answers, one.case.truth()) else { continue };
        let word = |answer: &Answer| match (truth, answer.sticks) {
            (_, None) => "-",
            (true, Some(false)) => "FN",
            (false, Some(true)) => "FP",
            _ => ".",
        };
        let words = answers.each_ref().map(word);
        if words.iter().any(|word| *word != ".") {
            let cells = words.map(|word| format!(" {word:>10}")).concat();
            lines.push(format!("  {:<50} {:<12}{cells}", one.case.file, one.case.label));
        }
    }
    lines
}

fn print_json(judged: &[Judged], loops: &[Loop], sets: &[[Decision; COUNT]]) -> anyhow::Result<()> {
    for (decisions, thresholds) in sets.iter().zip(["published", "chosen"]) {
        let methods: Vec<Value> = (0..COUNT)
            .map(|at| {
                let recordings: Vec<Scored> = scored(judged, at, decisions[at]).map(|(_, scored)| scored).collect();
                let simulated: Vec<Scored> = loops
                    .iter()
                    .map(|one| Scored {
                        truth: one.sticks,
                        answer: decisions[at].of(&one.answers[at]),
                        p: None,
                        weight: 1.0,
                    })
                    .collect();
                json!({"method": name(at), "sticking_if": decisions[at].words(at),
                    "recordings": Tally::of(&recordings), "simulated": Tally::of(&simulated)})
            })
            .collect();
        say(json!({"schema": "stictiond.methods.v1", "thresholds": thresholds, "methods": methods}))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chosen_threshold_keeps_its_share_of_false_positives() {
        let one = |sticks, x: f64| Loop { sticks, answers: [Answer { statistic: Some(x), sticks: None }; COUNT] };
        let loops: Vec<Loop> = (0..200).map(|k| one(k % 2 == 1, f64::from(k))).collect();
        let threshold = threshold(&loops, 0);
        let called = loops.iter().filter(|l| Decision::Above(threshold).of(&l.answers[0]) == Some(true));
        assert_eq!(called.filter(|l| !l.sticks).count(), 5);
        assert_eq!(Decision::Above(1.0).of(&Answer::default()), None);
    }
}
