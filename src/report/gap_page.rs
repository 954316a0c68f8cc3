//! The report on a gap as one HTML file that needs neither scripts nor a network.

use maud::{Markup, html};

use super::gap_figures::figures;
use super::page::{flatten, optional, picture, whole};
use super::plot::PlotError;
use stiction::core::units::{from_to, number, probability};
use stiction::words::gap_text::{self, BudgetText};
use stiction_engine::analysis::gap::Diagnosed;

/// Content of the report.
#[derive(Debug, Clone)]
pub struct GapReport {
    /// The input file as given.
    pub input: String,
    /// The command that reproduces the report.
    pub command: String,
    /// Warnings from the analysis.
    pub warnings: Vec<String>,
    /// The loops in the order of the file.
    pub loops: Vec<Diagnosed>,
}

/// Renders the page.
///
/// # Errors
/// [`PlotError`], if a picture cannot be drawn.
pub fn gap_page(report: &GapReport) -> Result<String, PlotError> {
    let single = report.loops.len() == 1;
    let mut sections = Vec::with_capacity(report.loops.len());
    for (k, one) in report.loops.iter().enumerate() {
        sections.push(section(one, k, single)?);
    }
    let title = match report.loops.as_slice() {
        [one] => format!("Gap between simulation and plant: {}", one.document.loop_name),
        all => format!("Gap between simulation and plant: {} sections", all.len()),
    };
    let body = html! {
        @for warning in &report.warnings { p.warning { (warning) } }
        @if !single { (overview(report)) }
        @for part in sections { (part) }
    };
    let remark = "The same file, options and build give the same numbers, unless the search ran out of time. \
                  Every figure can be computed again from what --predictions writes.";
    Ok(whole(&title, [&report.input, &report.command], &body, remark))
}

fn overview(report: &GapReport) -> Markup {
    html! {
        section.card {
            h2 { "All sections" }
            div.scroll {
                table.overview {
                    thead { tr {
                        th { "loop" } th { "valve" } th { "gap" } th.number { "p" } th.number { "gap, PV units" }
                        th.number.more { "of PV's deviation, %" } th.number { "closed, %" }
                    } }
                    tbody {
                        @for (k, one) in report.loops.iter().enumerate() {
                            @let d = &one.document;
                            tr {
                                td.name { a href=(format!("#loop-{k}")) { (d.loop_name) } }
                                td { (d.valve.as_ref().map_or_else(String::new, |valve| valve.title())) }
                                td { (gap_text::answer(d)) }
                                td.number { (probability(d.cause.probability)) }
                                td.number { (number(d.gap.gap)) }
                                td.number.more { (optional(d.gap.relative.map(|r| 100.0 * r))) }
                                td.number { (optional(d.named().and_then(|e| e.closed_pct))) }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn section(one: &Diagnosed, k: usize, open: bool) -> Result<Markup, PlotError> {
    let d = &one.document;
    let pictures = figures(one)?;
    let floor = d.gap.noise_floor.map_or_else(|| "not known".to_owned(), number);
    let document = serde_json::to_value(d).unwrap_or(serde_json::Value::Null);
    let mut rows = Vec::new();
    flatten("", &document, &mut rows);
    Ok(html! {
        details.loop open[open] {
            summary { span.name { (d.loop_name) } " " (gap_text::title(d)) }
            div id=(format!("loop-{k}")) {
                section.card {
                    @let [conclusion, next, cost] = gap_text::summary(d);
                    @if d.valve.is_some() {
                        p.headline { (gap_text::sentence(&gap_text::title(d))) }
                        p { (conclusion) }
                    } @else {
                        p.headline { (conclusion) }
                    }
                    p { (next) } p { (cost) }
                    p.soft { (gap_text::paragraph(d)) }
                    dl {
                        dt { "Gap" } dd {
                            (number(d.gap.gap)) " PV units above the noise"
                            @if let Some(relative) = d.gap.relative {
                                ", " (number(100.0 * relative)) " % of PV's standard deviation"
                            }
                            " (rms error " (number(d.gap.rmse)) ", noise floor " (floor) ")."
                        }
                        @if let (Some(given), Some(parametric)) = (d.given, d.parametric) {
                            dt { "Given model" } dd {
                                "gap " (number(given.gap)) ", of which refitting closes " (number(parametric)) "."
                            }
                        }
                        @if let (Some(op), Some(pv)) = (d.location.op_to_mv, d.location.mv_to_pv) {
                            dt { "With MV" } dd {
                                "OP to valve position: " (number(op.unexplained_pct)) " % unexplained; valve position to PV: gap " (number(pv.gap)) "."
                            }
                        }
                        @if let Some(position) = d.valve.as_ref().and_then(|valve| valve.position) {
                            dt { "Valve position" } dd { (gap_text::sentence(&position.words())) }
                        }
                        @if let Some(f) = d.forward {
                            dt { "Forward" } dd {
                                "Fitted to the first part and run over the rest: gap " (number(f.gap_before))
                                " before, " (number(f.gap_after)) " after."
                            }
                        }
                        @if let Some(from_sp) = &d.from_sp { dt { "From SP" } dd { (gap_text::from_sp(from_sp)) "." } }
                        @if let Some(windows) = gap_text::windows(d) { dt { "Windows" } dd { (windows) "." } }
                        @if let Some(compared) = gap_text::other_loops(d) { dt { "Other loops" } dd { (compared) "." } }
                        @if let Some(cycles) = &d.closed_loop { dt { "Closed loop" } dd { (gap_text::cycles(cycles)) "." } }
                        dt { "Record" } dd {
                            (from_to(d.window.start_ns, d.window.end_ns)) ", " (d.window.samples) " samples of " (number(d.window.ts_s)) " s, "
                            (d.evaluations) " model responses" @if d.stopped_early { ", search ended early" } "."
                        }
                    }
                }
                @if let Some(budget) = gap_text::budget(d) { (made_of(&budget, &gap_text::tellable(d))) }
                div.pictures { @for figure in &pictures { (picture(figure)) } }
                details.numbers {
                    summary { "All numbers" }
                    div.scroll { table.plain { tbody {
                        @for (name, value) in &rows { tr { th { (name) } td { (value) } } }
                    } } }
                }
            }
        }
    })
}

/// Shares of PV's variance, and their limits.
fn made_of(budget: &BudgetText, tellable: &[String]) -> Markup {
    html! {
        section.card {
            h2 { "What PV is made of" }
            div.scroll {
                table {
                    caption.soft { (budget.head) }
                    thead { tr { th.number { "share, %" } th.number { "sd, PV units" } th { "part" } } }
                    tbody {
                        @for part in &budget.parts {
                            tr {
                                td.number { (format!("{:.1}", part.share_pct)) } td.number { (number(part.sd)) }
                                td { (part.words) }
                            }
                        }
                    }
                }
            }
            @for sentence in budget.limits.iter().chain(tellable) { p.soft { (gap_text::sentence(sentence)) } }
        }
    }
}
