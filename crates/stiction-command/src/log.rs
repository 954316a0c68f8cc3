//! The log on stderr, held back while a screen is drawn on the same terminal.

use std::io::{IsTerminal, Write};
use std::sync::{Mutex, PoisonError};

use tracing_subscriber::EnvFilter;

use super::Format;

/// Bytes that are held at most; what comes later is dropped.
const HELD: usize = 64 << 10;

/// What was written while a screen was shown; none while there is none.
static BACK: Mutex<Option<Vec<u8>>> = Mutex::new(None);

/// Starts the log.
pub fn start(form: Format, default_filter: &str) {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(default_filter));
    let colours = std::io::stderr().is_terminal();
    let builder = tracing_subscriber::fmt().with_env_filter(filter).with_writer(|| Lines).with_ansi(colours);
    let started = match form {
        Format::Text => builder.with_target(false).try_init(),
        Format::Json => builder.json().try_init(),
    };
    // A second start, in tests, keeps the first log.
    drop(started);
}

/// stderr, or what is held back.
struct Lines;

impl Write for Lines {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        match BACK.lock().unwrap_or_else(PoisonError::into_inner).as_mut() {
            Some(held) => {
                let room = HELD.saturating_sub(held.len()).min(bytes.len());
                held.extend_from_slice(&bytes[..room]);
                Ok(bytes.len())
            }
            None => std::io::stderr().write(bytes),
        }
    }

    fn flush(&mut self) -> std::io::Result<()> {
        std::io::stderr().flush()
    }
}

/// Holds the log back from now on, where it would come onto the terminal.
pub fn hold() {
    if std::io::stderr().is_terminal() {
        BACK.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_default();
    }
}

/// Adds a line to the log as it is.
pub fn line(text: &str) {
    // Nobody can be told where stderr is gone.
    let _ = writeln!(Lines, "{text}");
}

/// Writes what was held, and holds no longer.
pub fn release() {
    let held = BACK.lock().unwrap_or_else(PoisonError::into_inner).take();
    if let Some(held) = held.filter(|held| !held.is_empty()) {
        let _ = std::io::stderr().write_all(&held);
    }
}
