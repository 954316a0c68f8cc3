//! The shipped classifier on simulated loops of known truth, of the half that was not used for fitting.

use serde::Serialize;
use serde_json::json;

use stiction::core::verdict::rule::Rule;
use stiction::core::verdict::tally::{self, Scored};
use stiction::core::verdict::{AssessParams, Assessment, assess, assess_in_windows};
use stiction_engine::alarm::{AlarmParams, Evidence};
use stiction_engine::analysis::Judgeable;
use stiction_engine::engine::WindowParams;
use stiction_lab::truth::rates::{self, Called, reliability_lines};
use stiction_lab::truth::{Half, TruthLoop, verdict_case, verdict_stretch};
use stictiond::cli::{Format, on_all_cores, say};

/// Simulated loops: their number and first seed.
#[derive(Debug, Clone, Copy)]
pub struct Loops {
    pub count: u64,
    pub seed: u64,
}

impl Loops {
    /// Applies `work` to every loop of a half.
    pub fn each<R: Send>(self, half: Half, work: impl Fn(u64) -> R + Sync) -> Vec<R> {
        let seeds: Vec<u64> = (self.seed..self.seed.saturating_add(self.count)).collect();
        on_all_cores(&seeds, |seed| format!("{} {seed}", half.name()), |seed| work(*seed))
    }
}

/// Judges each loop as a whole, like a recording.
///
/// # Errors
/// Nothing can be printed.
pub fn print(loops: Loops, format: Format) -> anyhow::Result<()> {
    let judged: Vec<(TruthLoop, Assessment)> = loops.each(Half::Report, |seed| {
        let case = verdict_case(Half::Report, seed);
        let Judgeable { record, windows, params } = case.judgeable();
        let a = assess_in_windows(&record, &windows, &params);
        (case, a)
    });
    let told: Vec<(&'static str, Scored, Option<bool>)> = judged
        .iter()
        .map(|(case, a)| {
            let interval = a.s_interval.filter(|_| a.stiction == Some(false));
            let bounded = case.s.zip(interval).map(|(s, [low, high])| (low..=high).contains(&s));
            (case.kind, Scored { truth: case.sticks, answer: a.stiction, p: a.p_calibrated, weight: 1.0 }, bounded)
        })
        .collect();
    let cuts = Rule::shipped().cuts;
    let thresholds = [cuts.called, cuts.alarm];
    let called = |(kind, scored, _): &(&'static str, Scored, Option<bool>)| Called {
        kind,
        sticks: scored.truth,
        called: thresholds.map(|p| scored.at(p).answer == Some(true)),
    };
    let table: Vec<Called<'static, 2>> = told.iter().map(called).collect();
    let all: Vec<Scored> = told.iter().map(|(_, scored, _)| *scored).collect();
    let bounded: Vec<bool> = told.iter().filter_map(|(_, _, bounded)| *bounded).collect();
    let inside = bounded.iter().filter(|inside| **inside).count();
    let answered = all.iter().filter(|s| s.answer.is_some()).count();
    if format == Format::Json {
        for (case, a) in &judged {
            say(document(case, a))?;
        }
        let counts = [0, 1].map(|decision| {
            let [positives, negatives] = [true, false].map(|sticks| rates::count(&table, sticks, decision));
            json!({"threshold": thresholds[decision], "true_positives": positives.0, "sticking": positives.1,
                "false_positives": negatives.0, "healthy": negatives.1})
        });
        let bins = tally::reliability_equal(&all, 10);
        say(json!({"schema": "stictiond.simulated.v1", "loops": loops.count, "seed": loops.seed,
            "answered": answered, "false_negatives_with_interval": bounded.len(), "s_inside": inside, "decisions": counts, "brier": tally::brier(&all),
            "miscalibration": tally::miscalibration(&bins), "reliability": bins}))?;
        return Ok(());
    }
    say(format!(
        "{} simulated loops from seed {}, none of which the shipped classifier was fitted to; TPR, FPR: true and false \
         positive rate, with 95 % intervals",
        loops.count, loops.seed
    ))?;
    let names = thresholds.map(|p| format!("p >= {p}"));
    for line in rates::table([&names[0], &names[1]], &table) {
        say(line)?;
    }
    say(format!("answer rate {}", rates::share(answered, all.len()).trim_start()))?;
    say(format!("false negatives whose interval has the true s {}", rates::share(inside, bounded.len()).trim_start()))?;
    for line in reliability_lines(&all) {
        say(line)?;
    }
    Ok(())
}

/// One loop as a JSON document.
fn document(case: &TruthLoop, a: &Assessment) -> serde_json::Value {
    json!({"schema": "stictiond.simulated_case.v1", "seed": case.seed, "moved_by": case.kind, "sticks": case.sticks,
        "s_true": case.s, "right": a.stiction == Some(case.sticks), "verdict": a.verdict, "stiction": a.stiction,
        "p_stiction": a.p_stiction, "p_calibrated": a.p_calibrated, "s": a.s, "gates": a.gates, "reason": a.reason, "reversals": a.reversals,
        "oscillation": a.oscillation})
}

/// Shares of sticking valves for which the value of an alarm is reported.
const PREVALENCES: [f64; 4] = [0.02, 0.05, 0.1, 0.2];

/// Value of a decision, by its rates.
#[derive(Debug, Clone, Copy, Serialize)]
struct Worth {
    true_positive_rate: f64,
    false_positive_rate: f64,
}

impl Worth {
    fn of<const N: usize>(loops: &[Called<'_, N>], decision: usize) -> Self {
        let [true_positive_rate, false_positive_rate] = [true, false].map(|sticks| {
            let (called, all) = rates::count(loops, sticks, decision);
            called as f64 / all as f64
        });
        Self { true_positive_rate, false_positive_rate }
    }

    /// Shares of sticking valves among the loops that are called sticking, and among the others.
    fn sticking(self, prevalence: f64) -> [f64; 2] {
        let share = |of_sticking: f64, of_healthy: f64| {
            let sticking = prevalence * of_sticking;
            sticking / (sticking + (1.0 - prevalence) * of_healthy)
        };
        let (tpr, fpr) = (self.true_positive_rate, self.false_positive_rate);
        [share(tpr, fpr), share(1.0 - tpr, 1.0 - fpr)]
    }
}

/// Judges each loop in as many windows as an alarm considers, with the daemon's overlap, parameters and alarm rule: the value
/// of one window, and of m of n.
///
/// # Errors
/// Nothing can be printed.
pub fn print_alarms(loops: Loops, format: Format) -> anyhow::Result<()> {
    let alarm = AlarmParams::default();
    let [raise, of] = alarm.raise.map(usize::from);
    let hop_s = WindowParams::default().hop_s;
    let told: Vec<Called<'static, 2>> = loops.each(Half::Report, |seed| {
        let case = verdict_stretch(Half::Report, seed, of);
        let (record, params) = (case.record(), AssessParams::default());
        let length = record.len() / of;
        let hop = ((hop_s / record.point_s()) as usize).clamp(1, length);
        let window = |k: usize| assess(&record.part(k * hop, k * hop + length), &params);
        let counts: Vec<bool> = (0..of).map(|k| Evidence::of(&window(k), &alarm) == Evidence::For).collect();
        let raised = counts.iter().filter(|counts| **counts).count() >= raise;
        Called { kind: case.kind, sticks: case.sticks, called: [counts[0], raised] }
    });
    let worth = [0, 1].map(|decision| Worth::of(&told, decision));
    if format == Format::Json {
        say(json!({"schema": "stictiond.simulated_alarms.v1", "loops": loops.count, "seed": loops.seed,
            "raise": alarm.raise, "window": worth[0], "alarm": worth[1]}))?;
        return Ok(());
    }
    let threshold = Rule::shipped().cuts.alarm;
    let names = ["one window".to_owned(), format!("{raise} of {of} windows")];
    say(format!(
        "{} simulated loops from seed {}, {of} windows each, {hop_s} s apart, judged as the daemon judges them; a window counts \
         at p >= {threshold} and a size above the alarm's limit; TPR, FPR: true and false positive rate, with 95 % intervals",
        loops.count, loops.seed
    ))?;
    for line in rates::table([&names[0], &names[1]], &told) {
        say(line)?;
    }
    say(format!("{:<28}{:<46}{}", "share of valves that stick", names[0], names[1]))?;
    for prevalence in PREVALENCES {
        let percent = |share: f64| if share.is_nan() { "-".to_owned() } else { format!("{:.1}", 100.0 * share) };
        let cell = |decision: usize| {
            let [called, others] = worth[decision].sticking(prevalence).map(percent);
            format!("of those called {called} %, of the others {others} %")
        };
        say(format!("{:>4.0} % {:<22}{:<46}{}", 100.0 * prevalence, "", cell(0), cell(1)))?;
    }
    Ok(())
}
