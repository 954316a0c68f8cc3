//! The terminal: set up, drawn on, and restored however the program ends.

use std::io::{Stdout, stdout};
use std::panic;
use std::sync::Once;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::ThreadId;
use std::time::Duration;

use ratatui::backend::CrosstermBackend;
use ratatui::crossterm::cursor::{Hide, Show};
use ratatui::crossterm::event::{self, Event};
use ratatui::crossterm::execute;
use ratatui::crossterm::terminal::{
    self, Clear, ClearType, EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode, enable_raw_mode,
};
use ratatui::layout::{Rect, Size};
use ratatui::{Frame, Terminal, TerminalOptions, Viewport};
use tokio::sync::mpsc::{Receiver, channel};

use crate::log;

/// Whether the terminal is set up.
static TAKEN: AtomicBool = AtomicBool::new(false);
/// Longest wait for a key; the thread ends within this time.
const LOOK: Duration = Duration::from_millis(100);
/// Most keys waiting.
const KEYS: usize = 256;

/// A set-up terminal, restored on drop.
pub struct Screen {
    terminal: Terminal<CrosstermBackend<Stdout>>,
    size: Size,
}

/// A frame buffer of this size. Its position is fixed: a viewport that follows the terminal's size queries the cursor
/// position, which not every terminal answers.
fn blank(size: Size) -> std::io::Result<Terminal<CrosstermBackend<Stdout>>> {
    execute!(stdout(), Clear(ClearType::All))?;
    let viewport = Viewport::Fixed(Rect::new(0, 0, size.width, size.height));
    Terminal::with_options(CrosstermBackend::new(stdout()), TerminalOptions { viewport })
}

/// The terminal's size; 80 by 24 if it does not report one.
fn size() -> std::io::Result<Size> {
    let (width, height) = terminal::size()?;
    Ok(if width == 0 || height == 0 { Size::new(80, 24) } else { Size::new(width, height) })
}

impl Screen {
    /// Sets up the terminal.
    ///
    /// # Errors
    /// The terminal refuses raw mode or cannot be written to.
    pub fn open() -> std::io::Result<Self> {
        give_back_on_panic();
        TAKEN.store(true, Ordering::SeqCst);
        log::hold();
        let opened = enable_raw_mode()
            .and_then(|()| execute!(stdout(), EnterAlternateScreen, Hide))
            .and_then(|()| size())
            .and_then(|size| Ok(Self { terminal: blank(size)?, size }));
        if opened.is_err() {
            give_back();
        }
        opened
    }

    /// Draws one frame at the terminal's current size.
    ///
    /// # Errors
    /// The terminal cannot be written to.
    pub fn draw(&mut self, picture: impl FnOnce(&mut Frame<'_>)) -> std::io::Result<()> {
        let now = size()?;
        if now != self.size {
            (self.terminal, self.size) = (blank(now)?, now);
        }
        self.terminal.draw(picture).map(drop)
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        give_back();
    }
}

/// Restores the terminal; a second call does nothing.
fn give_back() {
    if TAKEN.swap(false, Ordering::SeqCst) {
        // A terminal that is gone needs nothing.
        let _ = disable_raw_mode();
        let _ = execute!(stdout(), LeaveAlternateScreen, Show);
        log::release();
    }
}

/// A panic of the drawing thread ends the program, so the terminal is restored before the panic is printed. One of another
/// thread, such as a fit's, is caught there and printed once the terminal is restored.
fn give_back_on_panic() {
    static ONCE: Once = Once::new();
    let drawing: ThreadId = std::thread::current().id();
    ONCE.call_once(|| {
        let before = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            if std::thread::current().id() == drawing {
                give_back();
            }
            if TAKEN.load(Ordering::SeqCst) {
                log::line(&info.to_string());
            } else {
                before(info);
            }
        }));
    });
}

/// Keys and resizes, read by a thread of its own until the receiver is dropped.
///
/// # Errors
/// The system refuses a thread.
pub fn keys() -> std::io::Result<Receiver<Event>> {
    let (found, keys) = channel(KEYS);
    std::thread::Builder::new().name("keys".into()).spawn(move || {
        while !found.is_closed() {
            match event::poll(LOOK) {
                Ok(false) => {}
                Ok(true) => match event::read() {
                    Ok(event) => drop(found.blocking_send(event)),
                    Err(_) => return,
                },
                // The terminal is gone: the receiver sees the end.
                Err(_) => return,
            }
        }
    })?;
    Ok(keys)
}
