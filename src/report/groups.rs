//! Cards of a page for groups of loops that share one oscillation.

use maud::{Markup, html};

use super::Report;
use stiction::core::units::{duration, number, probability};
use stiction::plantwide::{GroupDocument, headline, of_member};
use stiction::words::capital;

/// A card for each group; a single card if loops were compared but share no oscillation.
pub(super) fn cards(report: &Report) -> Markup {
    let Some(groups) = &report.groups else { return html! {} };
    html! {
        @if groups.is_empty() {
            section.card { h2 { "Plant" } p { "No loops share an oscillation. Each loop is judged on its own." } }
        }
        @for group in groups { (card(report, group)) }
    }
}

fn card(report: &Report, group: &GroupDocument) -> Markup {
    let source = &group.source;
    html! {
        section.card {
            h2 { (capital(&headline(group))) }
            p.soft {
                (group.members.len()) " loops oscillate together, period " (duration(group.period_s))
                "; probability that chance links them " (probability(group.p_value)) "."
            }
            ul { @for reason in &source.reasons { li { (reason) } } }
            @if let Some(test) = &source.next_test { p { b { "Next test: " } (test) } }
            div.scroll {
                table {
                    thead { tr { th { "loop" } th { "part in the group" } th.number { "lag, s" } th.number { "share of its power" } } }
                    tbody {
                        @for judged in &group.judgements {
                            @let follower = group.followers.iter().find(|f| f.loop_name == judged.loop_name);
                            tr {
                                td.name { (link(report, &judged.loop_name)) }
                                td { (of_member(judged)) }
                                td.number { @if let Some(f) = follower { (number(f.lag_s)) } }
                                td.number { @if let Some(f) = follower { ((100.0 * f.share).round()) " %" } }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn link(report: &Report, name: &str) -> Markup {
    match report.loops.iter().position(|l| l.document.loop_name == name) {
        Some(k) => html! { a href=(format!("#loop-{k}")) { (name) } },
        None => html! { (name) },
    }
}
