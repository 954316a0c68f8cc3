//! `stictiond` watches control loops for sticking valves.
//!
//! # The map
//! The crates of the workspace, each using only those above it, which the compiler holds:
//!
//! | crate | |
//! |---|---|
//! | `stiction` | the science: records, physics, identification, verdict, gap. No file, clock, thread or socket |
//! | `stiction-monitor` | what is deterministic of a daemon: payloads, settings, the engine, alarms. Neither |
//! | `stiction-lab` | what proves the science: truth, challenge, calibration |
//! | `stiction-files` | tables, exports, MCAP, `.mat`, stores |
//! | `stiction-runtime` | clock, queues, metrics, faults, health, overview: what the parts of a running program share |
//! | `stiction-report` | pages and pictures |
//! | `stiction-daemon` | the bus, threads, publisher, recorder, receivers, replay |
//! | `stiction-web` | the page and the API under it, `/metrics`, `/healthz`. It does not know the daemon, nor the daemon it |
//! | `stiction-workbench` | files in the browser: a program of its own, of which the daemon knows nothing |
//! | this one | the command line: a file for each command. Results go to stdout, everything else to stderr |
//!
//! # One sample's way
//! `source::zenoh` (callback, bounded queue) → `core` (route, decode, record), both of `stiction-daemon` →
//! [`stiction_monitor::engine::Engine::push`] → [`stiction::signal::align`] (joined by source time) →
//! [`stiction::signal::history`] (bounded memory) → a due window → `schedule` (in turn) → `worker` →
//! [`stiction::verdict::assess`] → [`stiction_monitor::alarm`] → `sink::zenoh`, `sink::recorder` and `sink::keeper`.

pub mod analyze;
mod analyze_report;
pub mod bench;
pub mod bridge;
mod browser;
pub mod calibrate;
mod calibrate_bump_test;
mod calibrate_intervals;
mod calibrate_plants;
pub mod challenge;
pub mod check;
pub mod compact;
pub mod completions;
pub mod convert;
pub mod demo;
pub mod discover;
pub mod evaluate;
mod fleet;
pub mod gap;
pub mod info;
mod log;
pub mod manual;
mod plant;
pub mod play;
pub mod reading;
pub mod recover;
pub mod reload;
pub mod replay;
pub mod run;
mod running;
pub mod schema;
pub mod selection;
pub mod simulate;
pub mod solving;
mod stop;
pub mod test;
pub mod top;
pub mod workbench;

use std::fmt::Display;
use std::future::Future;
use std::io::Write;
use std::process::ExitCode;

use anyhow::Context;
use clap::error::ErrorKind;
use clap::{Parser, Subcommand, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use stiction_runtime::cores;

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

/// Find sticking control valves in loop data, live or recorded, with probability, size and interval.
///
/// Exit codes: 0 done (a verdict never changes the exit code), 1 failed, 2 wrong command line, 3 done with data loss.
#[derive(Debug, Parser)]
#[command(name = "stictiond", version, max_term_width = 100)]
struct Cli {
    /// Format of the results on stdout.
    #[arg(long, global = true, value_enum, default_value_t)]
    format: Format,
    /// Format of the log on stderr. RUST_LOG sets the log level [default: info].
    #[arg(long, global = true, value_enum, default_value_t)]
    log: Format,
    #[command(subcommand)]
    command: CommandArgs,
}

#[derive(Debug, Subcommand)]
enum CommandArgs {
    Run(run::Args),
    Demo(demo::Args),
    Top(top::Args),
    Play(play::Args),
    Replay(replay::Args),
    Analyze(analyze::Args),
    Gap(gap::Args),
    Workbench(workbench::Args),
    Evaluate(evaluate::Args),
    Calibrate(calibrate::Args),
    Simulate(simulate::Args),
    Compact(compact::Args),
    Convert(convert::ConvertArgs),
    Check(check::Args),
    Reload(reload::Args),
    Test(test::Args),
    Discover(discover::Args),
    Bridge(bridge::Args),
    Info(info::InfoArgs),
    Recover(recover::Args),
    Schema(schema::Args),
    Bench(bench::Args),
    Manual(manual::Args),
    Completions(completions::Args),
}

/// Reads the command line and runs one command.
fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            let asked = matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion);
            let _ = error.print();
            return ExitCode::from(if asked { Outcome::Done } else { Outcome::Usage }.code());
        }
    };
    log::start(cli.log, cli.default_filter());
    let outcome = dispatch(cli).unwrap_or_else(|error| {
        // A reader that closes our output early (`| head`) is no failure.
        let pipe = error.chain().filter_map(|e| e.downcast_ref::<std::io::Error>());
        if pipe.into_iter().any(|e| e.kind() == std::io::ErrorKind::BrokenPipe) {
            return Outcome::Done;
        }
        let _ = writeln!(std::io::stderr(), "stictiond: {}", plain(&causes_without_repeats(&error)));
        if error.is::<UsageError>() { Outcome::Usage } else { Outcome::Failed }
    });
    ExitCode::from(outcome.code())
}

/// An error and its causes, without a cause that the text already contains.
fn causes_without_repeats(error: &anyhow::Error) -> String {
    error.chain().map(ToString::to_string).fold(String::new(), |text, cause| match text.as_str() {
        "" => cause,
        _ if text.contains(&cause) => text,
        _ => format!("{text}: {cause}"),
    })
}

fn dispatch(cli: Cli) -> anyhow::Result<Outcome> {
    let format = cli.format;
    match cli.command {
        CommandArgs::Run(args) => run::run(&args),
        CommandArgs::Demo(args) => demo::run(&args, format),
        CommandArgs::Top(args) => top::run(&args, format),
        CommandArgs::Play(args) => play::run(&args, format),
        CommandArgs::Replay(args) => replay::run(&args, format),
        CommandArgs::Analyze(args) => analyze::run(&args, format),
        CommandArgs::Gap(args) => gap::run(&args, format),
        CommandArgs::Workbench(args) => workbench::run(&args, format),
        CommandArgs::Evaluate(args) => evaluate::run(&args, format),
        CommandArgs::Calibrate(args) => calibrate::run(&args, format),
        CommandArgs::Simulate(args) => simulate::run(&args, format),
        CommandArgs::Compact(args) => compact::run(&args, format),
        CommandArgs::Convert(args) => convert::run(&args, format),
        CommandArgs::Check(args) => check::run(&args, format),
        CommandArgs::Reload(args) => reload::run(&args, format),
        CommandArgs::Test(args) => test::run(&args, format),
        CommandArgs::Discover(args) => discover::run(&args, format),
        CommandArgs::Bridge(args) => bridge::run(&args, format),
        CommandArgs::Info(args) => info::run(&args, format),
        CommandArgs::Recover(args) => recover::run(&args, format),
        CommandArgs::Schema(args) => schema::run(&args),
        CommandArgs::Bench(args) => bench::run(&args, format),
        CommandArgs::Manual(args) => manual::run(&args, format),
        CommandArgs::Completions(args) => completions::run(&args),
    }
}

impl Cli {
    /// The default log filter, used without `RUST_LOG`. The demo and `top` print alarms and lost links themselves; the
    /// OPC UA client would log every attempt, and the bridge logs outages itself.
    const fn default_filter(&self) -> &'static str {
        match (&self.command, self.format) {
            (CommandArgs::Demo(_), Format::Text) => "warn,zenoh=error,stiction_monitor::alarm=off",
            // It says in its own lines when the link is lost.
            (CommandArgs::Top(_), _) => "warn,zenoh=off",
            // The daemon itself says which listener or router is missing, without paths of sources.
            _ => "info,zenoh=warn,zenoh::net::runtime::orchestrator=error,opcua=off",
        }
    }
}

/// An error in the request, not in the work: exit 2.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct UsageError(pub String);

/// Prints results unchanged.
pub(crate) fn print(text: &str) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    out.write_all(plain(text).as_bytes()).and_then(|()| out.flush())
}

/// Prints one line of results.
pub(crate) fn say(line: impl Display) -> std::io::Result<()> {
    writeln!(std::io::stdout().lock(), "{}", plain(&line.to_string()))
}

/// Prints a warning on stderr.
pub(crate) fn warn(line: impl Display) {
    // Where nobody listens any more nothing is to be told.
    let _ = writeln!(std::io::stderr().lock(), "warning: {}", plain(&line.to_string()));
}

/// Prints a note on stderr that is not a warning.
pub(crate) fn note(line: impl Display) {
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
pub(crate) fn list(faults: &[impl Display]) -> String {
    faults.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n  ")
}

/// Runs `work` on each item on all cores, with a progress bar. The answers keep the order of the items.
pub(crate) fn on_all_cores<T: Sync, R: Send>(
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
pub(crate) fn in_order_on_all_cores<T: Sync, R: Send>(
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
fn bar_of(pieces: usize) -> ProgressBar {
    let bar = ProgressBar::new(pieces as u64);
    if let Ok(style) = ProgressStyle::with_template("{spinner} {bar:40} {pos}/{len} {elapsed} {wide_msg}") {
        bar.set_style(style);
    }
    bar.enable_steady_tick(std::time::Duration::from_millis(200));
    bar
}

/// Runs an asynchronous command. Zenoh needs a multi-threaded runtime.
pub(crate) fn block_on<T>(future: impl Future<Output = anyhow::Result<T>>) -> anyhow::Result<T> {
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
pub(crate) fn asked_to_stop() -> anyhow::Result<impl Future<Output = ()>> {
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
