//! Output of an evaluation: counts, confusions, every wrong case with its reasons, reliability.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use super::Judged;
use stiction::core::verdict::tally::{self, Scored, Tally};
use stiction::core::verdict::{Assessment, Verdict};
use stictiond::cli::{Format, say};

/// Bins of the reliability table.
const BINS: usize = 5;

/// One way of counting: every record, or each group or valve with a total weight of one.
struct Count {
    /// Name in the document.
    name: &'static str,
    says: &'static str,
    rows: Vec<(String, Tally)>,
    all: Tally,
    brier: Option<f64>,
    reliability: Vec<tally::Bin>,
}

impl Count {
    fn new(name: &'static str, says: &'static str, judged: &[&Judged], key: fn(&Judged) -> &str) -> Self {
        let scored: Vec<&Judged> = judged.iter().copied().filter(|j| j.case.truth().is_some()).collect();
        let keys: Vec<&str> = scored.iter().map(|j| key(j)).collect();
        let mut cases: Vec<Scored> = scored.iter().filter_map(|j| score(j)).collect();
        tally::share_by(&mut cases, &keys);
        let unreadable = |j: &Judged| j.result.is_err();
        let of = |source: Option<&str>| {
            let mine = |j: &Judged| source.is_none_or(|s| j.case.source == s);
            let pairs = || scored.iter().zip(&cases).filter(|(j, _)| mine(j));
            let readable: Vec<Scored> = pairs().filter(|(j, _)| !unreadable(j)).map(|(_, c)| *c).collect();
            let errors = pairs().filter(|(j, _)| unreadable(j)).map(|(_, c)| c.weight).sum();
            Tally { errors, ..Tally::of(&readable) }
        };
        let mut sources: Vec<&str> = Vec::new();
        for one in &scored {
            if !sources.contains(&one.case.source.as_str()) {
                sources.push(&one.case.source);
            }
        }
        let rows = sources.into_iter().map(|s| (s.to_owned(), of(Some(s)))).collect();
        Self {
            name,
            says,
            rows,
            all: of(None),
            brier: tally::brier(&cases),
            reliability: tally::reliability(&cases, BINS),
        }
    }

    fn of(judged: &[Judged]) -> Vec<Self> {
        let believed: Vec<&Judged> = judged.iter().filter(|j| !j.case.doubtful).collect();
        let mut out = Self::usual(&judged.iter().collect::<Vec<_>>());
        if believed.len() < judged.len() {
            let says = "records of the same data counted once, without labels that are not believed";
            out.push(Self::new("believed", says, &believed, |j| &j.case.group));
        }
        out
    }

    fn usual(judged: &[&Judged]) -> Vec<Self> {
        vec![
            Self::new("records", "every record counted once", judged, |j| &j.case.file),
            Self::new("distinct", "records of the same data counted once", judged, |j| &j.case.group),
            Self::new("valves", "every valve counted once, by its share", judged, |j| &j.case.valve),
        ]
    }
}

fn score(one: &Judged) -> Option<Scored> {
    let a = one.result.as_ref().ok();
    let (answer, p) = (a.and_then(|a| a.stiction), a.and_then(|a| a.p_calibrated));
    Some(Scored { truth: one.case.truth()?, answer, p, weight: 1.0 })
}

/// Verdicts by label, as counts.
fn confusion(judged: &[Judged]) -> BTreeMap<&str, BTreeMap<&'static str, usize>> {
    let mut table: BTreeMap<&str, BTreeMap<&'static str, usize>> = BTreeMap::new();
    for one in judged {
        let verdict = one.result.as_ref().map_or("error", |a| a.verdict.name());
        *table.entry(&one.case.label).or_default().entry(verdict).or_default() += 1;
    }
    table
}

/// Prints everything.
pub(super) fn print(judged: &[Judged], format: Format) -> anyhow::Result<()> {
    match format {
        Format::Json => print_json(judged),
        Format::Text => print_text(judged),
    }
}

/// A number as JSON, as an integer if it is whole.
fn count(x: f64) -> Value {
    let whole = x.round();
    if (x - whole).abs() < 1e-9 { json!(whole as u64) } else { json!(x) }
}

fn row(name: &str, c: &Tally) -> Value {
    json!({"source": name, "right": count(c.right()), "total": count(c.total()), "interval": c.interval(),
        "found": count(c.found), "missed": count(c.missed), "false_alarms": count(c.false_alarms),
        "cleared": count(c.cleared), "unanswered": count(c.unanswered), "errors": count(c.errors)})
}

fn print_json(judged: &[Judged]) -> anyhow::Result<()> {
    for one in judged {
        let (case, elapsed_s) = (&one.case, one.elapsed_s);
        match &one.result {
            Ok(a) => say(json!({"schema": "stictiond.case.v1", "file": case.file, "label": case.label,
                "valve": case.valve, "group": case.group, "elapsed_s": elapsed_s,
                "scored": case.truth().is_some(), "right": case.truth().map(|t| a.stiction == Some(t)),
                "verdict": a.verdict, "stiction": a.stiction, "p_stiction": a.p_stiction, "p_calibrated": a.p_calibrated, "s": a.s, "j": a.j,
                "stiction_index": a.stiction_index, "s_over_span": a.s_over_span, "gates": a.gates,
                "reversals": a.reversals, "oscillation": a.oscillation,
                "reason": a.reason, "implausible": a.implausible, "doubtful": case.doubtful, "indicators": a.indicators, "explanation": a.explanation}))?,
            Err(error) => say(json!({"schema": "stictiond.case.v1", "file": case.file, "label": case.label,
                "error": format!("{error:#}")}))?,
        }
    }
    let counts = Count::of(judged);
    let whole = |c: &Count| {
        let rows: Vec<Value> = c.rows.iter().map(|(name, tally)| row(name, tally)).collect();
        json!({"all": row("all", &c.all), "sources": rows, "brier": c.brier, "reliability": c.reliability})
    };
    let mut document = whole(&counts[0]);
    document["schema"] = json!("stictiond.evaluation.v1");
    document["confusion"] = json!(confusion(judged));
    for c in &counts[1..] {
        document[c.name] = whole(c);
    }
    say(document)?;
    Ok(())
}

/// A sum of weights, without decimals if it is whole.
fn figure(x: f64) -> String {
    let whole = x.round();
    if (x - whole).abs() < 1e-9 { format!("{}", whole as u64) } else { format!("{x:.2}") }
}

fn table_of(c: &Count) -> Vec<String> {
    let mut lines = vec![format!(
        "{:<10} {:>11} {:>12} {:>6} {:>6} {:>6} {:>6} {:>11} {:>7}",
        "source", "right", "95 %", "TP", "FN", "FP", "TN", "unanswered", "errors"
    )];
    let named = c.rows.iter().map(|(name, tally)| (name.as_str(), tally)).chain([("all", &c.all)]);
    lines.extend(named.map(|(name, t)| {
        let right = format!("{}/{}", figure(t.right()), figure(t.total()));
        let interval = t.interval().map_or("-".to_owned(), |[low, high]| format!("{low:.2}..{high:.2}"));
        format!(
            "{name:<10} {right:>11} {interval:>12} {:>6} {:>6} {:>6} {:>6} {:>11} {:>7}",
            figure(t.found),
            figure(t.missed),
            figure(t.false_alarms),
            figure(t.cleared),
            figure(t.unanswered),
            figure(t.errors)
        )
    }));
    lines.push(
        c.brier.map_or("Brier score: none, no probability was given".to_owned(), |b| format!("Brier score: {b:.3}")),
    );
    lines
}

fn print_text(judged: &[Judged]) -> anyhow::Result<()> {
    let counts = Count::of(judged);
    say("TP, FN: labelled sticking, called so or not; FP, TN: labelled healthy, called sticking or not\n")?;
    for c in &counts {
        say(format!("{}:", c.says))?;
        for line in table_of(c) {
            say(line)?;
        }
        say("")?;
    }
    say("verdicts by label:")?;
    for line in confusion_lines(judged) {
        say(line)?;
    }
    say("\nreliability: of the cases given about p, how many are labelled sticking (records; then valves):")?;
    for c in [&counts[0], &counts[2]] {
        for b in &c.reliability {
            let (from, to, count, mean, rate) = (b.from, b.to, b.count, b.mean_p, b.rate);
            say(format!("  p {from:.1}..{to:.1}  {count:>4} cases  mean p {mean:.2}  sticking {rate:.2}"))?;
        }
        say("")?;
    }
    say("wrong, unanswered or unreadable:")?;
    let wrong = |j: &&Judged| match (&j.result, j.case.truth()) {
        (_, None) => false,
        (Ok(a), truth) => a.stiction != truth,
        (Err(_), _) => true,
    };
    for one in judged.iter().filter(wrong) {
        say_case(one, true)?;
    }
    say("\nshown, not scored:")?;
    for one in judged.iter().filter(|j| j.case.truth().is_none()) {
        say_case(one, false)?;
    }
    Ok(())
}

fn confusion_lines(judged: &[Judged]) -> Vec<String> {
    const VERDICTS: [Verdict; 7] = [
        Verdict::Stiction,
        Verdict::Deadband,
        Verdict::Disturbance,
        Verdict::Tuning,
        Verdict::CauseUnknown,
        Verdict::NotOscillating,
        Verdict::Inconclusive,
    ];
    let names: Vec<&str> = VERDICTS.iter().map(|v| v.name()).chain(["error"]).collect();
    let line = |first: &str, cells: Vec<String>| {
        let cells: Vec<String> = names.iter().zip(cells).map(|(n, c)| format!("{c:>w$}", w = n.len())).collect();
        format!("  {first:<14} {}", cells.join("  "))
    };
    let head = line("label", names.iter().map(|n| (*n).to_owned()).collect());
    let rows = confusion(judged).into_iter().map(|(label, row)| {
        let of = |n: &&str| row.get(n).map_or("-".to_owned(), ToString::to_string);
        line(if label.is_empty() { "(none)" } else { label }, names.iter().map(of).collect())
    });
    std::iter::once(head).chain(rows).collect()
}

fn say_case(one: &Judged, reasons: bool) -> anyhow::Result<()> {
    let (file, label) = (&one.case.file, &one.case.label);
    match &one.result {
        Ok(a) => {
            let doubt = if one.case.doubtful { " (label not believed)" } else { "" };
            say(format!("  {file:<50} {label:<12} {}{doubt}", brief(a)))?;
            if reasons && !a.indicators.is_empty() {
                let said = a.indicators.iter().map(|w| format!("{} {}", w.name, number(w.score)));
                say(format!("    {}", said.collect::<Vec<_>>().join(", ")))?;
            }
        }
        Err(error) => say(format!("  {file:<50} {label:<12} error: {error:#}"))?,
    }
    Ok(())
}

fn number(x: Option<f64>) -> String {
    x.map_or("-".to_owned(), |v| format!("{v:.2}"))
}

fn brief(a: &Assessment) -> String {
    let gates: Vec<&str> = a.gates.iter().map(|g| g.name()).collect();
    let figures =
        format!("p {} index {} s/span {}", number(a.p_calibrated), number(a.stiction_index), number(a.s_over_span));
    format!("{:<15} {figures} [{}]", a.verdict.name(), gates.join(", "))
}
