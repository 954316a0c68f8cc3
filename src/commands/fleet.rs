//! Many loops at once: one line each in a table instead of a page of text.

use stiction::core::units::{duration, format_rfc3339, is_date, s_from_ns};
use stiction::core::verdict::Verdict;
use stiction_engine::analysis::Answer;

/// Number of loops from which the text output is only the table.
pub(super) const MANY: usize = 12;

/// One loop or section.
#[derive(Debug, Clone)]
struct Row {
    name: String,
    verdict: &'static str,
    sticks: bool,
    p: Option<f64>,
    seen: String,
    s: String,
    period_s: Option<f64>,
    grade: String,
    gates: String,
    end: String,
}

/// Results of many loops.
#[derive(Debug, Default)]
pub(super) struct Summary {
    rows: Vec<Row>,
    failed: usize,
}

/// The end of a window: a date, or the time since the start if the record has no dates.
fn end(ns: i64) -> String {
    if is_date(ns) { format_rfc3339(ns) } else { format!("after {}", duration(s_from_ns(ns))) }
}

impl Summary {
    /// Takes one answer.
    pub(super) fn add(&mut self, answer: &Answer) {
        let a = &answer.document.assessment;
        let told = stiction::words::answer::Answer::of(a);
        self.rows.push(Row {
            name: answer.document.loop_name.clone(),
            verdict: a.verdict.name(),
            sticks: matches!(a.verdict, Verdict::Stiction | Verdict::Deadband),
            p: a.p_stiction,
            seen: told.probability,
            s: told.size.unwrap_or_else(|| "-".to_owned()),
            period_s: a.oscillation.period_s,
            grade: told.grade.map_or_else(|| "-".to_owned(), |g| g.to_string()),
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
        let size = self.rows.iter().map(|r| r.s.chars().count()).max().unwrap_or(1).max(8);
        let head = ("loop", "verdict", "stiction", "s (90 %)", "period", "grade", "window ends");
        let (name, verdict, seen, s, period, grade, end) = head;
        let mut lines = vec![format!(
            "{name:width$}  {verdict:14}  {seen:17}  {s:>size$}  {period:>9}  {grade:5}  {end:20}  gates"
        )];
        for r in &self.rows {
            let name: String = r.name.chars().take(width).collect();
            let line = format!(
                "{name:width$}  {:14}  {:17}  {:>size$}  {:>9}  {:5}  {:20}  {}",
                r.verdict,
                r.seen,
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
