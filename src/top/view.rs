//! View state: sort order, filter, selection, and the action of each key. Independent of the terminal.

use std::cmp::Ordering;

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

use super::board::LoopTable;
use super::cells::{self, Figure};
use stiction_monitor::alarm::check_name;
use stiction_runtime::overview::Row;

/// Longest input text.
const TYPED: usize = 64;

/// Sort order of the rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Order {
    /// Most severe first.
    #[default]
    Severity,
    /// By name.
    Name,
    /// Most likely sticking first.
    P,
    /// Widest bands first.
    S,
    /// Fastest growing first.
    Trend,
}

impl Order {
    /// All orders, as `o` and the digits select them.
    pub const ALL: [Self; 5] = [Self::Severity, Self::Name, Self::P, Self::S, Self::Trend];

    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Severity => "severity",
            Self::Name => "name",
            Self::P => "p",
            Self::S => "s",
            Self::Trend => "trend",
        }
    }

    fn compare(self, a: &Row, b: &Row) -> Ordering {
        let down =
            |x: Option<f64>, y: Option<f64>| y.unwrap_or(f64::NEG_INFINITY).total_cmp(&x.unwrap_or(f64::NEG_INFINITY));
        let by_p = || down(a.p_stiction, b.p_stiction);
        let by_s = || down(a.s.filter(|_| a.stiction == Some(true)), b.s.filter(|_| b.stiction == Some(true)));
        let rank = |row: &Row| match row.s_trend {
            Some("rising") => 3,
            Some("steady") => 2,
            Some(_) => 1,
            None => 0,
        };
        let ordering = match self {
            Self::Severity => cells::severity(b).cmp(&cells::severity(a)).then_with(by_p).then_with(by_s),
            Self::Name => Ordering::Equal,
            Self::P => by_p(),
            Self::S => down(a.s, b.s),
            Self::Trend => rank(b).cmp(&rank(a)).then_with(by_s).then_with(by_p),
        };
        ordering.then_with(|| a.name.cmp(&b.name))
    }
}

/// Page on the screen.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Page {
    /// All loops.
    #[default]
    Table,
    /// One loop.
    Loop(String),
    /// The help page, and the page to return to.
    Help(Box<Page>),
}

/// What is being typed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Prompt {
    /// The filter.
    Filter,
    /// The name of the person acknowledging this loop's alarm.
    Acknowledge(String),
}

/// What a key requests.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Ask {
    /// Quit.
    Quit,
    /// Subscribe to the samples of this loop, or of none.
    Watch(Option<String>),
    /// Acknowledge an alarm.
    Acknowledge {
        /// Of this loop.
        name: String,
        /// By this person.
        by: String,
    },
}

/// The view state.
#[derive(Debug, Clone, Default)]
pub struct View {
    /// Current page.
    pub page: Page,
    /// Sort order.
    pub order: Order,
    /// Whether it is reversed.
    pub reversed: bool,
    /// What sparklines show.
    pub figure: Figure,
    /// Shows only rows whose name, verdict or category contains this text.
    pub filter: String,
    /// Open prompt and its text.
    pub prompt: Option<(Prompt, String)>,
    /// Selected loop.
    pub selected: Option<String>,
    /// First visible row; adjusted when drawing.
    pub offset: usize,
    /// First visible line of a long page.
    pub scroll: u16,
    /// Number of visible rows; set when drawing.
    pub room: usize,
    /// Default name for acknowledging.
    pub person: String,
    /// Why the input was rejected.
    pub refused: Option<String>,
}

impl View {
    /// With this default name.
    #[must_use]
    pub fn of(person: &str) -> Self {
        Self { person: person.to_owned(), room: 10, ..Self::default() }
    }

    /// The visible rows in order.
    #[must_use]
    pub fn rows<'b>(&self, board: &'b LoopTable) -> Vec<&'b Row> {
        let wanted = self.filter.to_lowercase();
        let holds = |row: &&Row| {
            let word = row.verdict.map_or("", |v| v.name());
            let texts = [&row.name, &row.status, word, cells::alarm(row.alarm_state)];
            wanted.is_empty() || texts.iter().any(|text| text.to_lowercase().contains(&wanted))
        };
        let mut rows: Vec<&Row> = board.rows().filter(holds).collect();
        rows.sort_by(|a, b| self.order.compare(a, b));
        if self.reversed {
            rows.reverse();
        }
        rows
    }

    /// Index of the selected row among these; 0 if it is not there.
    #[must_use]
    pub fn place(&self, rows: &[&Row]) -> usize {
        let marked = self.selected.as_deref();
        marked.and_then(|name| rows.iter().position(|row| row.name == name)).unwrap_or(0)
    }

    /// Handles a key. Returns what it requests.
    pub fn key(&mut self, key: KeyEvent, board: &LoopTable) -> Option<Ask> {
        if key.kind == KeyEventKind::Release {
            return None;
        }
        if key.modifiers.contains(KeyModifiers::CONTROL) {
            return (key.code == KeyCode::Char('c')).then_some(Ask::Quit);
        }
        self.refused = None;
        if self.prompt.is_some() {
            return self.typed(key.code);
        }
        match (&self.page, key.code) {
            (Page::Help(before), _) => {
                self.page = (**before).clone();
                None
            }
            (_, KeyCode::Char('?' | 'h')) => {
                self.page = Page::Help(Box::new(self.page.clone()));
                None
            }
            (Page::Loop(_), KeyCode::Esc | KeyCode::Char('q') | KeyCode::Backspace | KeyCode::Enter) => {
                self.page = Page::Table;
                Some(Ask::Watch(None))
            }
            (_, KeyCode::Char('q')) => Some(Ask::Quit),
            (_, KeyCode::Char('a')) => {
                self.ask_name(board);
                None
            }
            (Page::Loop(_), code) => {
                self.move_page(code);
                None
            }
            (Page::Table, code) => self.table_key(code, board),
        }
    }

    fn move_page(&mut self, code: KeyCode) {
        self.scroll = match code {
            KeyCode::Up | KeyCode::Char('k') => self.scroll.saturating_sub(1),
            KeyCode::Down | KeyCode::Char('j') => self.scroll.saturating_add(1),
            KeyCode::PageUp => self.scroll.saturating_sub(10),
            KeyCode::PageDown => self.scroll.saturating_add(10),
            KeyCode::Home => 0,
            _ => self.scroll,
        };
    }

    fn table_key(&mut self, code: KeyCode, board: &LoopTable) -> Option<Ask> {
        let rows = self.rows(board);
        let (at, last) = (self.place(&rows), rows.len().saturating_sub(1));
        let to = match code {
            KeyCode::Up | KeyCode::Char('k') => at.saturating_sub(1),
            KeyCode::Down | KeyCode::Char('j') => at + 1,
            KeyCode::PageUp => at.saturating_sub(self.room),
            KeyCode::PageDown => at + self.room,
            KeyCode::Home => 0,
            KeyCode::End => last,
            KeyCode::Enter => {
                let name = rows.get(at)?.name.clone();
                (self.page, self.scroll) = (Page::Loop(name.clone()), 0);
                return Some(Ask::Watch(Some(name)));
            }
            other => {
                self.setting(other);
                return None;
            }
        };
        self.selected = rows.get(to.min(last)).map(|row| row.name.clone());
        None
    }

    fn setting(&mut self, code: KeyCode) {
        match code {
            KeyCode::Char('/') => self.prompt = Some((Prompt::Filter, self.filter.clone())),
            KeyCode::Esc => self.filter.clear(),
            KeyCode::Char('o') => {
                let at = Order::ALL.iter().position(|order| *order == self.order).unwrap_or(0);
                self.order = Order::ALL[(at + 1) % Order::ALL.len()];
            }
            KeyCode::Char('r') => self.reversed = !self.reversed,
            KeyCode::Char('t') => {
                self.figure = if self.figure == Figure::P { Figure::S } else { Figure::P };
            }
            KeyCode::Char(digit @ '1'..='5') => {
                let at = digit as usize - '1' as usize;
                self.order = Order::ALL[at];
            }
            _ => {}
        }
    }

    /// The loop that a command applies to.
    fn meant(&self, board: &LoopTable) -> Option<String> {
        match &self.page {
            Page::Loop(name) => Some(name.clone()),
            _ => {
                let rows = self.rows(board);
                rows.get(self.place(&rows)).map(|row| row.name.clone())
            }
        }
    }

    fn ask_name(&mut self, board: &LoopTable) {
        let Some(row) = self.meant(board).and_then(|name| board.row(&name)) else { return };
        if row.unacknowledged {
            self.prompt = Some((Prompt::Acknowledge(row.name.clone()), self.person.clone()));
        } else {
            let state = row.alarm_state.name();
            self.refused = Some(format!("nothing to acknowledge: the alarm of {} is {state}", row.name));
        }
    }

    fn typed(&mut self, code: KeyCode) -> Option<Ask> {
        let (prompt, mut text) = self.prompt.take()?;
        match code {
            KeyCode::Esc => {
                if prompt == Prompt::Filter {
                    self.filter.clear();
                }
                return None;
            }
            KeyCode::Enter => return self.entered(prompt, text),
            KeyCode::Backspace => {
                text.pop();
            }
            KeyCode::Char(c) if text.chars().count() < TYPED && !c.is_control() => text.push(c),
            _ => {}
        }
        if prompt == Prompt::Filter {
            self.filter.clone_from(&text);
        }
        self.prompt = Some((prompt, text));
        None
    }

    fn entered(&mut self, prompt: Prompt, text: String) -> Option<Ask> {
        let Prompt::Acknowledge(name) = prompt else { return None };
        let by = text.trim().to_owned();
        // A `;` would end the name in a query.
        let fault = match check_name(Some(&by)) {
            Err(error) => Some(error.to_string()),
            Ok(()) => by.contains(';').then(|| "a name must not contain ';'".to_owned()),
        };
        if fault.is_some() {
            (self.refused, self.prompt) = (fault, Some((Prompt::Acknowledge(name), text)));
            return None;
        }
        self.person.clone_from(&by);
        Some(Ask::Acknowledge { name, by })
    }
}
