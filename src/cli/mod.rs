//! The command line: one file per command. Results go to stdout, diagnostics to stderr.

pub mod convert;
pub mod info;

use clap::ValueEnum;
use std::io::{self, Write};
use std::process::ExitCode;
use thiserror::Error;

/// How a command ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Done.
    Done,
    /// Not done.
    Failed,
    /// Asked for in a way that cannot be done.
    Usage,
    /// Done as far as a damaged recording allows.
    DataLoss,
}

impl Outcome {
    /// The exit code: 0, 1, 2, 3.
    #[must_use]
    pub const fn code(self) -> u8 {
        self as u8
    }
}

impl From<Outcome> for ExitCode {
    fn from(outcome: Outcome) -> Self {
        Self::from(outcome.code())
    }
}

/// What stands on stdout.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum Format {
    /// For people.
    #[default]
    Text,
    /// One JSON document a line, nothing else.
    Json,
}

/// An error of the request, not of the work: the exit code is that of [`Outcome::Usage`].
#[derive(Debug, Error)]
#[error("{0}")]
pub struct UsageError(pub String);

/// The outcome that an error stands for.
#[must_use]
pub fn outcome_of(error: &anyhow::Error) -> Outcome {
    if error.is::<UsageError>() { Outcome::Usage } else { Outcome::Failed }
}

/// Writes to stdout; a reader that has gone away (`| head`) is no error.
///
/// # Errors
/// What the system says otherwise.
pub fn print(text: &str) -> io::Result<()> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        other => other,
    }
}
