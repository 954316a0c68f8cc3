//! Many loops at once: each by its line in one table, instead of a page of text.

use stiction_core::units::{duration, format_rfc3339, is_date, optional as number, probability, s_from_ns};
use stiction_core::verdict::{Assessment, Verdict, words};
use stiction_monitor::analysis::Answer;

/// Loops from which text gives the table alone.
pub(super) const MANY: usize = 12;

/// One loop or section.
#[derive(Debug, Clone)]
struct Row {
    name: String,
    verdict: &'static str,
    sticks: bool,
    p: Option<f64>,
    s: String,
    s_interval: Option<[f64; 2]>,
    period_s: Option<f64>,
    grade: String,
    gates: String,
    end: String,
}

/// What was found in many loops.
#[derive(Debug, Default)]
pub(super) struct Summary {
    rows: Vec<Row>,
    failed: usize,
}

/// s, a lower bound where the estimate reaches its own; `not seen` where no stiction was found.
fn size(a: &Assessment) -> String {
    match a.stiction {
        Some(false) => "not seen".to_owned(),
        Some(true) if words::at_bound(a) => {
            format!("at least {}", number(a.s_interval.map(|[low, _]| low).or(a.s)))
        }
        _ => number(a.s),
    }
}

/// The end of a window: a date, or the time since the start on a clock of the record's own.
fn end(ns: i64) -> String {
    if is_date(ns) { format_rfc3339(ns) } else { duration(s_from_ns(ns)) }
}

impl Summary {
    /// Takes one answer.
    pub(super) fn add(&mut self, answer: &Answer) {
        let a = &answer.document.assessment;
        self.rows.push(Row {
            name: answer.document.loop_name.clone(),
            verdict: a.verdict.name(),
            sticks: matches!(a.verdict, Verdict::Stiction | Verdict::Deadband),
            p: a.p_stiction,
            s: size(a),
            s_interval: a.s_interval.filter(|_| a.stiction == Some(true)),
            period_s: a.oscillation.period_s,
            grade: a.grade.map_or_else(|| "-".to_owned(), |g| g.to_string()),
            gates: a.gates.iter().map(|g| g.name()).collect::<Vec<_>>().join(" "),
            end: end(a.window.end_ns),
        });
    }

    /// Counts a loop or file that could not be analysed.
    pub(super) fn fail(&mut self) {
        self.failed += 1;
    }

    /// The table: most likely sticking first.
    pub(super) fn table(&mut self) -> String {
        self.rows.sort_by(|a, b| b.p.unwrap_or(-1.0).total_cmp(&a.p.unwrap_or(-1.0)));
        let width = self.rows.iter().map(|r| r.name.chars().count()).max().unwrap_or(4).clamp(4, 64);
        let head = ("loop", "verdict", "p", "s", "s 90 %", "period", "grade", "until");
        let (name, verdict, p, s, range, period, grade, end) = head;
        let mut lines = vec![format!(
            "{name:width$}  {verdict:14}  {p:>6}  {s:>13}  {range:>16}  {period:>9}  {grade:5}  {end:20}  gates"
        )];
        for r in &self.rows {
            let range = r
                .s_interval
                .map_or_else(|| "-".to_owned(), |[a, b]| format!("{} to {}", number(Some(a)), number(Some(b))));
            let name: String = r.name.chars().take(width).collect();
            let line = format!(
                "{name:width$}  {:14}  {:>6}  {:>13}  {range:>16}  {:>9}  {:5}  {:20}  {}",
                r.verdict,
                r.p.map_or_else(|| "-".to_owned(), probability),
                r.s,
                r.period_s.map_or_else(|| "-".to_owned(), duration),
                r.grade,
                r.end,
                r.gates
            );
            lines.push(line.trim_end().to_owned());
        }
        let sticking = self.rows.iter().filter(|r| r.sticks).count();
        let failed = if self.failed > 0 { format!(", {} not analysed", self.failed) } else { String::new() };
        lines.push(format!("{} loops, stiction found in {sticking}{failed}", self.rows.len()));
        lines.join("\n")
    }
}
