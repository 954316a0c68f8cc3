//! The log on stderr.

use std::io::IsTerminal;

use tracing_subscriber::EnvFilter;

use super::Format;

/// Starts the log.
pub fn start(form: Format, default_filter: &str) {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(default_filter));
    let colours = std::io::stderr().is_terminal();
    let builder = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).with_ansi(colours);
    let started = match form {
        Format::Text => builder.with_target(false).try_init(),
        Format::Json => builder.json().try_init(),
    };
    // A second start, in tests, keeps the first log.
    drop(started);
}
