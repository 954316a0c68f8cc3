//! Shared by the programs' command lines: how a command ends, what it prints and logs, work on all cores with its progress,
//! Ctrl-C, man pages and completions.
//!
//! Results go to stdout, everything else to stderr.

pub mod bus;
pub mod cpu;
pub mod log;
#[cfg(feature = "manual")]
pub mod manual;
pub mod reading;
pub mod selection;
pub mod stop;
pub mod values;

use std::fmt::Display;
use std::future::Future;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use crate::runtime::cores;
use anyhow::{Context, bail};
use clap::error::ErrorKind;
use clap::{Parser, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use stiction_files::FileError;

/// How a command ended. A verdict never changes it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Done: exit 0.
    Done,
    /// Failed: exit 1.
    Failed,
    /// Wrong command line: exit 2.
    Usage,
    /// Done, but a damaged recording lost data: exit 3.
    DataLoss,
}

impl Outcome {
    /// The exit code.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Done => 0,
            Self::Failed => 1,
            Self::Usage => 2,
            Self::DataLoss => 3,
        }
    }
}

/// Output format of the results on stdout.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum Format {
    /// For people.
    #[default]
    Text,
    /// For programs: one JSON document per line.
    Json,
}

/// How every program prints.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct OutputArgs {
    /// Format of the results on stdout.
    #[arg(long, global = true, value_enum, default_value_t)]
    pub format: Format,
    /// Format of the log on stderr. RUST_LOG sets the log level [default: info].
    #[arg(long, global = true, value_enum, default_value_t)]
    pub log: Format,
}

/// Reads the command line. A wrong one, and one that asks for help, ends the program with this code.
///
/// # Errors
/// There is no command to run.
fn parse<C: Parser>() -> Result<C, ExitCode> {
    C::try_parse().map_err(|error| {
        let asked = matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion);
        let _ = error.print();
        ExitCode::from(if asked { Outcome::Done } else { Outcome::Usage }.code())
    })
}

/// A program: reads its command line, starts its log in the form and with the levels that `log_of` gives, and runs.
pub fn main_of<C: Parser>(
    program: &str,
    log_of: impl FnOnce(&C) -> (Format, &'static str),
    run: impl FnOnce(&C) -> anyhow::Result<Outcome>,
) -> ExitCode {
    let cli: C = match parse() {
        Ok(cli) => cli,
        Err(code) => return code,
    };
    let (form, levels) = log_of(&cli);
    log::start(form, levels);
    exit_code(program, run(&cli))
}

/// Prints why a command failed, and returns the exit code.
fn exit_code(program: &str, ended: anyhow::Result<Outcome>) -> ExitCode {
    let outcome = ended.unwrap_or_else(|error| {
        // A reader that closes our output early (`| head`) is no failure.
        let pipe = error.chain().filter_map(|e| e.downcast_ref::<std::io::Error>());
        if pipe.into_iter().any(|e| e.kind() == std::io::ErrorKind::BrokenPipe) {
            return Outcome::Done;
        }
        let told = causes_without_repeats(&error) + &command_with_option(&error);
        let _ = writeln!(std::io::stderr(), "{program}: {}", plain(&told));
        if error.is::<UsageError>() { Outcome::Usage } else { Outcome::Failed }
    });
    ExitCode::from(outcome.code())
}

/// For a table that is refused, the command with the option that settles it.
fn command_with_option(error: &anyhow::Error) -> String {
    let files = error.chain().filter_map(|e| e.downcast_ref::<FileError>());
    let flags = files.filter_map(|e| if let FileError::Export { cause, .. } = e { cause.flags() } else { None }).last();
    let quoted = |word: String| match word.contains(|c: char| !c.is_alphanumeric() && !"-_./=:,+@%".contains(c)) {
        true => format!("'{}'", word.replace('\'', "'\\''")),
        false => word,
    };
    let Some(flags) = flags else { return String::new() };
    // An option that was given gives way.
    let name = flags.split([' ', '=']).next().unwrap_or_default();
    let mut words: Vec<String> = std::env::args().skip(1).collect();
    if let Some(at) = words.iter().position(|word| word.split('=').next() == Some(name)) {
        words.drain(at..(at + if words[at].contains('=') { 1 } else { 2 }).min(words.len()));
    }
    let words: Vec<String> = words.into_iter().map(quoted).collect();
    format!("; for example: stictiond {} {flags}", words.join(" "))
}

/// An error and its causes, without a cause that the text already contains.
#[must_use]
pub fn causes_without_repeats(error: &anyhow::Error) -> String {
    error.chain().map(ToString::to_string).fold(String::new(), |text, cause| match text.as_str() {
        "" => cause,
        _ if text.contains(&cause) => text,
        _ => format!("{text}: {cause}"),
    })
}

/// An error in the request, not in the work: exit 2.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct UsageError(pub String);

/// Prints results unchanged.
///
/// # Errors
/// Stdout is closed.
pub fn print(text: &str) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    out.write_all(plain(text).as_bytes()).and_then(|()| out.flush())
}

/// A count with its noun.
#[must_use]
pub fn counted(count: usize, thing: &str) -> String {
    if count == 1 { format!("1 {thing}") } else { format!("{count} {thing}s") }
}

/// Prints one line of results.
///
/// # Errors
/// Stdout is closed.
pub fn say(line: impl Display) -> std::io::Result<()> {
    writeln!(std::io::stdout().lock(), "{}", plain(&line.to_string()))
}

/// Prints the build below figures that a command measured with it; JSON output is left alone.
///
/// # Errors
/// The command failed; stdout is closed.
pub fn of_build(measured: anyhow::Result<Outcome>, format: Format, build: &str) -> anyhow::Result<Outcome> {
    let outcome = measured?;
    if format == Format::Text {
        say(build)?;
    }
    Ok(outcome)
}

/// Keeps an existing file from being replaced unasked.
///
/// # Errors
/// The file exists, and `force` was not given.
pub fn refuse_existing(path: &Path, force: bool) -> anyhow::Result<()> {
    if path.exists() && !force {
        bail!("{}: already exists; use --force to replace it", path.display());
    }
    Ok(())
}

/// Writes results to a file, or prints them where none is named.
///
/// # Errors
/// The file exists and `force` was not given, or it cannot be written; stdout is closed.
pub fn put(text: &str, out: Option<&Path>, force: bool) -> anyhow::Result<()> {
    match out {
        Some(path) => {
            refuse_existing(path, force)?;
            std::fs::write(path, text).with_context(|| path.display().to_string())
        }
        None => Ok(print(text)?),
    }
}

/// Prints a warning on stderr.
pub fn warn(line: impl Display) {
    // A closed stderr is no reason to fail.
    let _ = writeln!(std::io::stderr().lock(), "warning: {}", plain(&line.to_string()));
}

/// Prints a note on stderr that is not a warning.
pub fn note(line: impl Display) {
    let _ = writeln!(std::io::stderr().lock(), "{}", plain(&line.to_string()));
}

/// Escapes control characters, except newline and tab, so that printed text cannot drive a terminal. JSON parsers read
/// the escapes back as the characters.
fn plain(text: &str) -> std::borrow::Cow<'_, str> {
    let steers = |c: char| c.is_control() && c != '\n' && c != '\t';
    if !text.contains(steers) {
        return text.into();
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if steers(c) {
            out.push_str(&format!("\\u{:04x}", u32::from(c)));
        } else {
            out.push(c);
        }
    }
    out.into()
}

/// Several faults, one per line.
#[must_use]
pub fn list(faults: &[impl Display]) -> String {
    faults.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n  ")
}

/// Runs `work` on each item on all cores, with a progress bar. The answers keep the order of the items.
pub fn on_all_cores<T: Sync, R: Send>(
    items: &[T],
    name: impl Fn(&T) -> String + Sync,
    work: impl Fn(&T) -> R + Sync,
) -> Vec<R> {
    let mut answers = Vec::with_capacity(items.len());
    let keep = |answer| {
        answers.push(answer);
        Ok(())
    };
    // Keeping an answer cannot fail.
    let _: anyhow::Result<()> = in_order_on_all_cores(items, name, |item, _| work(item), keep);
    answers
}

/// As [`on_all_cores`], but hands each answer to `take` as soon as all earlier ones have been handed over. Ctrl-C, where
/// watched, and an error of `take` stop further items; the error is returned.
///
/// # Errors
/// That of `take`.
pub fn in_order_on_all_cores<T: Sync, R: Send>(
    items: &[T],
    name: impl Fn(&T) -> String + Sync,
    work: impl Fn(&T, &ProgressBar) -> R + Sync,
    mut take: impl FnMut(R) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let bar = bar_of(items.len());
    let work = |item: &T| {
        bar.set_message(name(item));
        let answer = work(item, &bar);
        bar.inc(1);
        answer
    };
    let result = cores::in_order(items, &|| !stop::asked(), work, |answer| bar.suspend(|| take(answer)));
    bar.finish_and_clear();
    result
}

/// A progress bar for this many items.
#[must_use]
pub fn bar_of(pieces: usize) -> ProgressBar {
    let bar = ProgressBar::new(pieces as u64);
    if let Ok(style) = ProgressStyle::with_template("{spinner} {bar:40} {pos}/{len} {elapsed} {wide_msg}") {
        bar.set_style(style);
    }
    bar.enable_steady_tick(std::time::Duration::from_millis(200));
    bar
}

/// Runs an asynchronous command. Zenoh needs a multi-threaded runtime.
///
/// # Errors
/// That of the command; the runtime cannot start.
pub fn block_on<T>(future: impl Future<Output = anyhow::Result<T>>) -> anyhow::Result<T> {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    let result = runtime.block_on(future);
    // The bus may leave a thread behind that never ends.
    runtime.shutdown_timeout(std::time::Duration::from_millis(200));
    result
}

/// Completes when the process receives SIGINT or SIGTERM after this call.
///
/// # Errors
/// The system refuses to install a signal handler.
pub fn asked_to_stop() -> anyhow::Result<impl Future<Output = ()>> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut term = signal(SignalKind::terminate()).context("cannot install the SIGTERM handler")?;
    let mut int = signal(SignalKind::interrupt()).context("cannot install the SIGINT handler")?;
    Ok(async move {
        tokio::select! {
            _ = term.recv() => {}
            _ = int.recv() => {}
        }
    })
}

#[cfg(test)]
mod tests {
    use super::plain;

    #[test]
    fn nothing_that_is_printed_steers_a_terminal() {
        assert_eq!(plain("loop \u{1b}]0;x\u{7}: 5 %\n\ta\u{9b}2J"), "loop \\u001b]0;x\\u0007: 5 %\n\ta\\u009b2J");
        assert_eq!(plain("Füllstand µ"), "Füllstand µ");
        let json = serde_json::to_string("a\u{9b}\u{7f}b").unwrap();
        assert_eq!(serde_json::from_str::<String>(&plain(&json)).unwrap(), "a\u{9b}\u{7f}b");
    }
}
