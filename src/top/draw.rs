//! Draws header, table, prompt and help.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Clear, Paragraph, Wrap};

use super::board::{LoopTable, Now};
use super::cells::{self, Column, TerminalStyle};
use super::detail;
use super::head;
use super::view::{Page, Prompt, View};
use stiction_runtime::overview::Row;

/// The help page.
const HELP: [&str; 15] = [
    "arrows, PgUp, PgDn, Home, End   select a loop",
    "Enter                           open the selected loop; Enter or Esc goes back",
    "o, or 1 2 3 4 5                 sort by severity, name, p, s, trend;  r reverses",
    "/                               filter by name, verdict or alarm; Esc clears the filter",
    "t                               sparkline of p or of s over the newest windows",
    "a                               acknowledge the selected loop's alarm (asks for your name)",
    "q, Ctrl-C                       quit",
    "",
    "NE 107: M maintenance required (the stiction alarm is active), F failure of a signal,",
    "S out of specification (oscillates, or sticks without an alarm), C function check (out of",
    "service, in manual), ok. p: probability that the valve sticks. s: dead band plus stick",
    "band in OP units, with its 90 % interval. g: grade of the answer, A to D. age: of the",
    "newest sample; + where the plant's clock is ahead.",
    "",
    "Press any key to go back.",
];

/// Draws everything; `below` are fixed lines below the table, such as a web address.
pub fn draw(
    frame: &mut Frame<'_>,
    board: &LoopTable,
    view: &mut View,
    below: &[String],
    look: TerminalStyle,
    now: Now,
) {
    let area = frame.area();
    let heading = head::lines(board, usize::from(area.width), look, now);
    // One loop needs the room more.
    let below = &below[..if matches!(view.page, Page::Loop(_)) { below.len().min(1) } else { below.len() }];
    let room_below = below.len().min(usize::from(area.height / 3)) as u16;
    let [top, middle, bottom, foot] = Layout::vertical([
        Constraint::Length((heading.len() as u16).min(area.height / 3)),
        Constraint::Fill(1),
        Constraint::Length(room_below),
        Constraint::Length(2),
    ])
    .areas(area);
    frame.render_widget(Paragraph::new(heading), top);
    match view.page.clone() {
        Page::Table => table(frame, middle, board, view, look, now),
        Page::Loop(name) => detail::draw(frame, middle, board, view, &name, look, now),
        Page::Help(_) => {
            frame.render_widget(Clear, middle);
            frame.render_widget(Paragraph::new(HELP.map(Line::from).to_vec()).wrap(Wrap { trim: false }), middle);
        }
    }
    let lines: Vec<Line> = below.iter().map(|text| Line::from(text.as_str())).collect();
    frame.render_widget(Paragraph::new(lines), bottom);
    footer(frame, foot, board, view, look, now);
}

/// Colour of a category; its letter says the same.
fn style_of(row: &Row, look: TerminalStyle) -> Style {
    let plain = Style::new();
    match row.ne107 {
        Some("F" | "M") if !look.colour => plain.add_modifier(Modifier::BOLD),
        _ if !look.colour => plain,
        Some("F") => plain.fg(Color::Red).add_modifier(Modifier::BOLD),
        Some("M") => plain.fg(Color::LightBlue).add_modifier(Modifier::BOLD),
        Some("S") => plain.fg(Color::Yellow),
        Some("C") => plain.fg(Color::Magenta),
        Some(_) => plain.fg(Color::Green),
        None => plain.add_modifier(Modifier::DIM),
    }
}

/// A cell padded to its column's width, right-aligned if numeric.
pub(super) fn padded(text: &str, column: Column, width: usize) -> String {
    if column.right() { format!("{text:>width$} ") } else { format!("{text:<width$} ") }
}

fn table(frame: &mut Frame<'_>, area: Rect, board: &LoopTable, view: &mut View, look: TerminalStyle, now: Now) {
    let rows = view.rows(board);
    let longest = rows.iter().map(|row| row.name.chars().count()).max().unwrap_or(0);
    let columns = cells::layout(usize::from(area.width), longest);
    let head: String = columns
        .iter()
        .map(|(column, width)| padded(&cells::cut(column.head(view.figure), *width, look), *column, *width))
        .collect();
    let mut lines = vec![Line::styled(head, Style::new().add_modifier(Modifier::BOLD | Modifier::UNDERLINED))];
    let room = usize::from(area.height.saturating_sub(1)).max(1);
    let at = view.place(&rows);
    view.room = room;
    view.offset = view.offset.clamp((at + 1).saturating_sub(room), at).min(rows.len().saturating_sub(room));
    for (index, row) in rows.iter().enumerate().skip(view.offset).take(room) {
        lines.push(row_line(row, &columns, index == at, view, board, look, now));
    }
    if rows.is_empty() {
        let why = if view.filter.is_empty() { "no loops yet" } else { "no loop matches the filter; Esc clears it" };
        lines.push(Line::from(why));
    }
    frame.render_widget(Paragraph::new(lines), area);
}

fn row_line(
    row: &Row,
    columns: &[(Column, usize)],
    marked: bool,
    view: &View,
    board: &LoopTable,
    look: TerminalStyle,
    now: Now,
) -> Line<'static> {
    let age_s = board.age_s(&row.name, now);
    let spans = columns.iter().map(|(column, width)| {
        let text = padded(&column.cell(row, *width, view.figure, age_s, look), *column, *width);
        match column {
            Column::Category | Column::Verdict => Span::styled(text, style_of(row, look)),
            Column::Alarm if row.unacknowledged => Span::styled(text, Style::new().add_modifier(Modifier::BOLD)),
            _ => Span::raw(text),
        }
    });
    let line = Line::from(spans.collect::<Vec<_>>());
    if marked { line.patch_style(Style::new().add_modifier(Modifier::REVERSED)) } else { line }
}

/// The prompt or the last message, and the keys.
fn footer(frame: &mut Frame<'_>, area: Rect, board: &LoopTable, view: &View, look: TerminalStyle, now: Now) {
    let said = board.said.as_ref().filter(|(_, at)| now.at.saturating_duration_since(*at).as_secs() < 15);
    let rows = view.rows(board);
    let marked = rows.get(view.place(&rows));
    let first = match (&view.prompt, &view.refused, said) {
        (Some((Prompt::Filter, text)), _, _) => format!("filter: {text}_"),
        (Some((Prompt::Acknowledge(_), text)), Some(why), _) => format!("{why}; your name: {text}_"),
        (Some((Prompt::Acknowledge(name), text)), None, _) => {
            format!("acknowledge {name}; your name: {text}_  (Enter sends, Esc cancels)")
        }
        (None, Some(why), _) => why.clone(),
        (None, None, Some((text, _))) => text.clone(),
        (None, None, None) if view.page == Page::Table => {
            marked.map_or_else(String::new, |row| format!("{}: {}", row.name, row.status))
        }
        _ => String::new(),
    };
    let width = usize::from(area.width);
    let order = format!("{}{}", view.order.name(), if view.reversed { ", reversed" } else { "" });
    let filter = if view.filter.is_empty() {
        String::new()
    } else {
        format!("  filter {:?}: {} of {}", view.filter, rows.len(), board.rows().count())
    };
    let keys = match view.page {
        Page::Loop(_) => "Esc back  a acknowledge  arrows scroll  ? help  Ctrl-C quit".to_owned(),
        _ => format!("? help  Enter loop  / filter  o sort ({order})  a acknowledge  q quit{filter}"),
    };
    let lines = [first, keys].map(|text| Line::from(cells::cut(&text, width, look)));
    let [first, keys] = lines;
    frame.render_widget(Paragraph::new(vec![first, keys.patch_style(Style::new().add_modifier(Modifier::DIM))]), area);
}
