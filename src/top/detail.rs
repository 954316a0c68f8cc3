//! One loop on the screen: its newest window in words, its alarm, its gap, live OP and PV.

use std::collections::VecDeque;

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::Marker;
use ratatui::text::Line;
use ratatui::widgets::{Axis, Chart, Dataset, GraphType, Paragraph, Wrap};

use super::board::{LoopTable, Now};
use super::cells::{self, Figure, TerminalStyle};
use super::view::View;
use stiction_core::units::{duration, format_rfc3339, number};
use stiction_core::verdict::{Assessment, words};
use stiction_monitor::alarm::AlarmDocument;

/// Height of the trends on a low screen, lines.
const TRENDS: u16 = 8;

/// Draws the loop.
pub fn draw(
    frame: &mut Frame<'_>,
    area: Rect,
    board: &LoopTable,
    view: &mut View,
    name: &str,
    look: TerminalStyle,
    now: Now,
) {
    let texts = texts(board, name, look, now);
    let trends = TRENDS.min(area.height / 2).max(area.height / 3);
    let [upper, lower] = Layout::vertical([Constraint::Fill(1), Constraint::Length(trends)]).areas(area);
    let title = Style::new().add_modifier(Modifier::BOLD);
    let lines: Vec<Line> = texts
        .into_iter()
        .enumerate()
        .map(|(i, text)| if i == 0 { Line::styled(text, title) } else { Line::from(text) })
        .collect();
    view.scroll = view.scroll.min(lines.len() as u16);
    frame.render_widget(Paragraph::new(lines).wrap(Wrap { trim: false }).scroll((view.scroll, 0)), upper);
    let [left, right] = Layout::horizontal([Constraint::Percentage(50), Constraint::Percentage(50)]).areas(lower);
    let trend = board.trend.as_ref().filter(|t| t.name == name);
    let empty = VecDeque::new();
    chart(frame, left, "OP", trend.map_or(&empty, |t| &t.op), Color::Cyan, look);
    chart(frame, right, "PV", trend.map_or(&empty, |t| &t.pv), Color::Green, look);
}

/// The state of a loop, one paragraph per line.
#[must_use]
pub fn texts(board: &LoopTable, name: &str, look: TerminalStyle, now: Now) -> Vec<String> {
    let Some(row) = board.row(name) else { return vec![format!("{name} no longer exists")] };
    let newest = board.newest(name);
    let age = cells::age(board.age_s(name, now));
    let data = format!("Data: age {age}, gaps {}, dropped {}", row.data_gaps, row.dropped);
    let mut lines = vec![format!("{name}  {}  {}", cells::category(row, look), row.status), data];
    if let Some(estimate) = newest.estimate.as_deref() {
        lines.extend(answer(&estimate.assessment));
    } else {
        lines.push("No window has been judged yet; a window needs about five periods.".to_owned());
    }
    if let Some(alarm) = newest.alarm.as_deref() {
        lines.push(alarm_text(alarm));
        lines.extend(alarm.what_to_do.clone().map(|text| format!("To do: {text}")));
    }
    if let Some(gap) = board.gap(name) {
        lines.push(format!("Gap: {gap}"));
    }
    let spark = |figure| cells::sparkline(row, figure, look);
    let trend = row.s_trend.map_or_else(String::new, |t| format!(", s {t}"));
    lines.push(format!("Newest windows: p {}  s {}{trend}", spark(Figure::P), spark(Figure::S)));
    lines
}

fn answer(a: &Assessment) -> Vec<String> {
    let window = format!(
        "Window to {}: {} samples of {}",
        format_rfc3339(a.window.end_ns),
        a.window.samples,
        if a.window.ts_s.is_finite() { duration(a.window.ts_s) } else { "?".to_owned() }
    );
    let period = match (a.oscillation.oscillating, a.oscillation.period_s) {
        (true, Some(period_s)) => format!("; oscillates with a period of {}", duration(period_s)),
        _ => "; no regular oscillation".to_owned(),
    };
    let mut lines = vec![words::sureness(a), format!("{window}{period}.")];
    lines.extend(words::size(a, None).map(|size| format!("Size: {size}.")));
    lines.extend(words::disbelief(a).map(|text| format!("Note: {text}.")));
    lines.push(format!("What to do: {}", words::advice(a)));
    lines.extend(words::bump_test(a).iter().enumerate().map(|(k, step)| format!("  {}. {step}", k + 1)));
    lines.extend(a.gates.iter().map(|gate| format!("Gate {}: {}.", gate.name(), words::gate(*gate))));
    lines.extend(words::evidence(a).into_iter().map(|(text, _)| format!("  {text}.")));
    lines
}

fn alarm_text(d: &AlarmDocument) -> String {
    let by = d.by.as_ref().map_or_else(String::new, |by| format!(" by {by}"));
    let priority = d.priority.map_or_else(String::new, |p| format!(", priority {}", format!("{p:?}").to_lowercase()));
    format!("Alarm {}{priority}, changed {}{by}: {}", d.state.name().replace('_', " "), d.changed, d.detail)
}

/// The trend of one signal, with minimum and maximum.
fn chart(
    frame: &mut Frame<'_>,
    area: Rect,
    name: &str,
    points: &VecDeque<(f64, f64)>,
    colour: Color,
    look: TerminalStyle,
) {
    let (Some((from, _)), Some((to, _))) = (points.front(), points.back()) else {
        let told =
            format!("{name}: waiting for samples on the loop's own key (none arrive there if its tags are mapped)");
        return frame.render_widget(Paragraph::new(told).wrap(Wrap { trim: false }), area);
    };
    let data: Vec<(f64, f64)> = points.iter().map(|(t, v)| (t - to, *v)).collect();
    let (low, high) = data.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), (_, v)| (l.min(*v), h.max(*v)));
    let margin = (0.05 * (high - low)).max(1e-9 * (1.0 + high.abs()));
    let marker = if look.unicode { Marker::Braille } else { Marker::Dot };
    let style = if look.colour { Style::new().fg(colour) } else { Style::new() };
    let set = Dataset::default().marker(marker).graph_type(GraphType::Line).style(style).data(&data);
    let span_s = (to - from).max(1.0);
    let title = format!("{name} {} to {}, last {}", number(low), number(high), duration(span_s));
    let chart = Chart::new(vec![set])
        .x_axis(Axis::default().bounds([-span_s, 0.0]))
        .y_axis(Axis::default().bounds([low - margin, high + margin]));
    let [above, below] = Layout::vertical([Constraint::Length(1), Constraint::Fill(1)]).areas(area);
    frame.render_widget(Paragraph::new(title), above);
    frame.render_widget(chart, below);
}
