//! The report as one HTML file that needs neither scripts nor a network.
//!
//! Names come from outside; every value goes through `maud`, which escapes it. The style sheet and the script are separate
//! files next to this one and do not depend on the data.

use maud::{DOCTYPE, Markup, PreEscaped, html};
use serde_json::Value;

use super::figures::{Figure, Subject, brief, detailed};
use super::ink;
use super::plot::PlotError;
use super::{LoopReport, Report};
use stiction::core::units::{duration, from_to, number};
use stiction::core::verdict::{Assessment, Verdict, texts};
use stiction::words;
use stiction::words::answer::Answer;

/// Renders the page.
///
/// # Errors
/// [`PlotError`], if a picture cannot be drawn.
pub fn page(report: &Report) -> Result<String, PlotError> {
    let order = report.by_urgency();
    let single = report.loops.len() == 1;
    let mut sections = Vec::with_capacity(order.len());
    for &k in &order {
        sections.push(section(&report.loops[k], k, single)?);
    }
    let title = match report.loops.as_slice() {
        [one] => format!("Valve stiction report: {}", one.document.loop_name),
        all => format!("Valve stiction report: {} loops", all.len()),
    };
    let body = html! {
        @if !single { (overview(report, &order)) }
        @for warning in &report.warnings { p.warning { (warning) } }
        (super::groups::cards(report))
        @for part in sections { (part) }
    };
    let remark = "The same file, options and build give the same numbers. docs/read-a-result.md of \
                  stictiond explains the fields. Pictures are drawn from the points that were analysed; curves keep \
                  the extremes of each pixel column.";
    Ok(whole(&title, [&report.input, &report.command], &body, remark))
}

/// A page around `body`: head, styles, script, and a footer with its origin (`[input, command]` and a remark).
pub(super) fn whole(title: &str, [input, command]: [&str; 2], body: &Markup, remark: &str) -> String {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                meta http-equiv="Content-Security-Policy"
                    content="default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'";
                title { (title) }
                style { (PreEscaped(ink::style())) (PreEscaped(include_str!("page.css"))) }
            }
            body {
                header {
                    h1 { (title) }
                    p.soft { "From " code { (input) } ", stictiond " (stiction::core::VERSION) "." }
                }
                main {
                    (body)
                    section.card.sign-off {
                        h2 { "Sign-off" }
                        dl { @for line in ["Date", "Author", "Work order", "Checked on site, result", "Signature"] { dt { (line) } dd.line { "\u{a0}" } } }
                    }
                    section.card {
                        h2 { "How this report was made" }
                        pre { code { (command) } }
                        p.soft { (remark) }
                    }
                }
                div id="value" hidden {}
                script { (PreEscaped(include_str!("page.js"))) }
            }
        }
    }
    .into_string()
}

/// The table of all loops, by probability of stiction and size, largest first.
fn overview(report: &Report, order: &[usize]) -> Markup {
    let count = |wanted: Option<bool>| report.loops.iter().filter(|l| l.document.assessment.stiction == wanted).count();
    html! {
        section.card {
            h2 { "All loops" }
            p {
                (report.loops.len()) " loops: stiction found in " b { (count(Some(true))) } ", not seen in " (count(Some(false)))
                ", no verdict for " (count(None)) ". Sorted by probability, then by s."
            }
            @if report.loops.iter().any(|l| l.detail.is_none() && l.document.assessment.s.is_some()) {
                p.soft { "Loops further down are shown in short; --report-all draws every loop in full, --loop one of them." }
            }
            div.scroll {
                table.overview {
                    thead { tr {
                        th { "loop" } th { "verdict" } th.number { "stiction" } th.more { "grade" } th.number { "s (90 %)" }
                        th.number.more { "period" } th.more { "limits" }
                    } }
                    tbody {
                        @for &k in order {
                            @let one = &report.loops[k];
                            @let a = &one.document.assessment;
                            tr {
                                td.name { a href=(format!("#loop-{k}")) { (one.document.loop_name) } }
                                td { (badge(a.verdict)) }
                                @let answer = Answer::of(a);
                                td.number { (answer.probability) }
                                td.more { (answer.grade.map_or_else(|| NONE.to_owned(), String::from)) }
                                td.number { (answer.size.unwrap_or_else(|| NONE.to_owned())) }
                                td.number.more { (a.oscillation.period_s.map_or_else(|| NONE.to_owned(), duration)) }
                                td.more { (a.gates.iter().map(|g| g.name().replace('_', " ")).collect::<Vec<_>>().join(", ")) }
                            }
                        }
                    }
                }
            }
        }
    }
}

/// Placeholder for an absent value.
const NONE: &str = "\u{2013}";

pub(super) fn optional(value: Option<f64>) -> String {
    value.map_or_else(|| NONE.to_owned(), number)
}

fn badge(v: Verdict) -> Markup {
    let class = if v.stiction() == Some(true) { "badge bad" } else { "badge open" };
    html! { span class=(class) { (texts::of(v).short) } }
}

/// One loop, collapsible; open if it is the only one.
fn section(one: &LoopReport, k: usize, open: bool) -> Result<Markup, PlotError> {
    let a = &one.document.assessment;
    let subject = Subject {
        record: &one.record,
        original: one.original.as_ref(),
        assessment: a,
        tags: &one.tags,
        detail: one.detail.as_ref(),
    };
    let in_full = open || one.detail.is_some() || one.full;
    let figures = if in_full { detailed(&subject)? } else { brief(&subject)? };
    Ok(html! {
        details.loop open[open] {
            summary {
                span.name { (one.document.loop_name) } " " (badge(a.verdict))
                @let answer = Answer::of(a);
                span.soft { " " (answer.probability) }
                @if let Some(size) = answer.size { span.soft { " s " (size) } }
            }
            div id=(format!("loop-{k}")) {
                (summary(one, a))
                div.pictures { @for figure in &figures { (picture(figure)) } }
                details.numbers {
                    summary { "All numbers" }
                    (numbers(one))
                }
            }
        }
    })
}

pub(super) fn picture(figure: &Figure) -> Markup {
    html! {
        figure class=[figure.wide.then_some("wide")] {
            div.frame { (figure.picture) }
            figcaption { b { (figure.picture.title) "." } " " (figure.caption) }
        }
    }
}

/// The facts for a planner.
fn summary(one: &LoopReport, a: &Assessment) -> Markup {
    let w = &a.window;
    let evidence = words::evidence(a);
    let unknown = words::unknowns(a);
    let bump = words::bump_test(a);
    html! {
        section.card {
            p.headline { (badge(a.verdict)) " " (words::capital(&words::headline(a))) "." }
            dl {
                @if let Some(size) = words::size(a).filter(|_| a.stiction == Some(true)) {
                    dt { "Size" } dd { (words::capital(&size)) "." }
                }
                dt { "How sure" } dd { (words::sureness(a)) }
                dt { "What to do" } dd { (words::advice(a)) }
                @if !bump.is_empty() {
                    dt { "Bump test" } dd { ol { @for step in &bump { li { (step) } } } }
                }
                @if !evidence.is_empty() {
                    dt { "Evidence" } dd { ul { @for (text, _) in &evidence { li { (text) "." } } } }
                }
                @if !unknown.is_empty() {
                    dt { "Not known" } dd { ul { @for text in &unknown { li { (words::capital(text)) "." } } } }
                }
                dt { "Record" } dd {
                    (from_to(w.start_ns, w.end_ns)) ", " (w.samples) " samples of "
                    (number(w.ts_s)) " s"
                    @if let (Some(period), Some(periods)) = (a.oscillation.period_s, a.oscillation.periods) {
                        ", " (number(periods)) " periods of " (duration(period))
                    }
                    "."
                    @if let Some(comment) = &one.comment { " " (comment) }
                    @for note in &one.notes { p.soft { (words::capital(note)) "." } }
                }
            }
        }
    }
}

/// The whole document as a table, including absent numbers.
fn numbers(one: &LoopReport) -> Markup {
    let document = serde_json::to_value(&one.document).unwrap_or(Value::Null);
    let mut rows = Vec::new();
    flatten("", &document, &mut rows);
    html! {
        div.scroll { table.plain { tbody {
            @for (name, value) in &rows { tr { th { (name) } td { (value) } } }
        } } }
    }
}

/// Leaves of a document with their paths; lists of numbers are one leaf.
pub(super) fn flatten(path: &str, value: &Value, out: &mut Vec<(String, String)>) {
    let below = |name: &str| if path.is_empty() { name.to_owned() } else { format!("{path}.{name}") };
    match value {
        Value::Object(map) => map.iter().for_each(|(name, v)| flatten(&below(name), v, out)),
        Value::Array(list) if list.iter().any(Value::is_object) => {
            for (k, v) in list.iter().enumerate() {
                let name = v.get("name").and_then(Value::as_str).map_or_else(|| k.to_string(), str::to_owned);
                flatten(&below(&name), v, out);
            }
        }
        Value::Null => out.push((path.to_owned(), "null".to_owned())),
        Value::String(text) => out.push((path.to_owned(), text.clone())),
        other => out.push((path.to_owned(), other.to_string())),
    }
}
