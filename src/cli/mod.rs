//! The command line: one file a command, results on stdout, everything else on stderr.

pub mod analyze;
mod analyze_report;
pub mod bench;
pub mod calibrate;
mod calibrate_intervals;
pub mod check;
pub mod convert;
pub mod demo;
pub mod evaluate;
pub mod info;
pub mod play;
pub mod replay;
pub mod run;
pub mod simulate;
mod text;

use std::fmt::Display;
use std::future::Future;
use std::io::{IsTerminal, Write};
use std::process::ExitCode;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::Context;
use clap::error::ErrorKind;
use clap::{Parser, Subcommand, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use tracing_subscriber::EnvFilter;

/// How a command ended; a verdict never changes it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Done: exit 0.
    Done,
    /// Failed: exit 1.
    Failed,
    /// Called wrongly: exit 2.
    Usage,
    /// Done with what a damaged recording still held: exit 3.
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

/// Form of the results on stdout.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum Format {
    /// For people.
    #[default]
    Text,
    /// For programs: one JSON document a line.
    Json,
}

/// Finds sticking control valves, says how sure it is, records and replays bit for bit.
///
/// Exit codes: 0 done (a verdict never changes it), 1 failed, 2 called wrongly, 3 completed with data loss.
#[derive(Debug, Parser)]
#[command(name = "stictiond", version, max_term_width = 100)]
struct Cli {
    /// Form of the results on stdout.
    #[arg(long, global = true, value_enum, default_value_t)]
    format: Format,
    /// Form of the log on stderr; RUST_LOG sets what is logged (default info).
    #[arg(long, global = true, value_enum, default_value_t)]
    log: Format,
    #[command(subcommand)]
    command: CommandArgs,
}

#[derive(Debug, Subcommand)]
enum CommandArgs {
    Run(run::Args),
    Demo(demo::Args),
    Play(play::Args),
    Replay(replay::Args),
    Analyze(analyze::Args),
    Evaluate(evaluate::Args),
    Calibrate(calibrate::Args),
    Simulate(simulate::Args),
    Convert(convert::ConvertArgs),
    Check(check::Args),
    Info(info::InfoArgs),
    Bench(bench::Args),
}

/// Reads the command line and runs one command.
#[must_use]
pub fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            let asked = matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion);
            let _ = error.print();
            return ExitCode::from(if asked { Outcome::Done } else { Outcome::Usage }.code());
        }
    };
    start_log(cli.log);
    let outcome = dispatch(cli).unwrap_or_else(|error| {
        // A reader that closes our output early (`| head`) is no failure.
        let pipe = error.chain().filter_map(|e| e.downcast_ref::<std::io::Error>());
        if pipe.into_iter().any(|e| e.kind() == std::io::ErrorKind::BrokenPipe) {
            return Outcome::Done;
        }
        let _ = writeln!(std::io::stderr(), "stictiond: {error:#}");
        if error.is::<UsageError>() { Outcome::Usage } else { Outcome::Failed }
    });
    ExitCode::from(outcome.code())
}

fn dispatch(cli: Cli) -> anyhow::Result<Outcome> {
    let format = cli.format;
    match cli.command {
        CommandArgs::Run(args) => run::run(&args),
        CommandArgs::Demo(args) => demo::run(&args, format),
        CommandArgs::Play(args) => play::run(&args, format),
        CommandArgs::Replay(args) => replay::run(&args, format),
        CommandArgs::Analyze(args) => analyze::run(&args, format),
        CommandArgs::Evaluate(args) => evaluate::run(&args, format),
        CommandArgs::Calibrate(args) => calibrate::run(&args, format),
        CommandArgs::Simulate(args) => simulate::run(&args, format),
        CommandArgs::Convert(args) => convert::run(&args, format),
        CommandArgs::Check(args) => check::run(&args, format),
        CommandArgs::Info(args) => info::run(&args, format),
        CommandArgs::Bench(args) => bench::run(&args, format),
    }
}

fn start_log(form: Format) {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info,zenoh=warn"));
    let colours = std::io::stderr().is_terminal();
    let builder = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).with_ansi(colours);
    let started = match form {
        Format::Text => builder.with_target(false).try_init(),
        Format::Json => builder.json().try_init(),
    };
    // A second start, in tests, keeps the first log.
    drop(started);
}

/// An error of the request, not of the work: exit 2.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct UsageError(pub String);

/// Prints results as they are.
pub(crate) fn print(text: &str) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    out.write_all(text.as_bytes()).and_then(|()| out.flush())
}

/// Prints one line of results.
pub(crate) fn say(line: impl Display) -> std::io::Result<()> {
    writeln!(std::io::stdout().lock(), "{line}")
}

/// Several faults, one a line.
pub(crate) fn list(faults: &[impl Display]) -> String {
    faults.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n  ")
}

/// Does a piece of work for each item on all cores, with a progress bar; answers stand in the items' order.
pub(crate) fn on_all_cores<T: Sync, R: Send>(
    items: &[T],
    name: impl Fn(&T) -> String + Sync,
    work: impl Fn(&T) -> R + Sync,
) -> Vec<R> {
    let bar = ProgressBar::new(items.len() as u64);
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos}/{len} {wide_msg}") {
        bar.set_style(style);
    }
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let next = AtomicUsize::new(0);
    let share = || {
        let mut mine = Vec::new();
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(item) = items.get(index) else { return mine };
            bar.set_message(name(item));
            mine.push((index, work(item)));
            bar.inc(1);
        }
    };
    let mut results: Vec<(usize, R)> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..cores).map(|_| scope.spawn(share)).collect();
        let join = |w: std::thread::ScopedJoinHandle<'_, Vec<(usize, R)>>| match w.join() {
            Ok(mine) => mine,
            Err(panic) => std::panic::resume_unwind(panic),
        };
        workers.into_iter().flat_map(join).collect()
    });
    bar.finish_and_clear();
    results.sort_by_key(|(index, _)| *index);
    results.into_iter().map(|(_, result)| result).collect()
}

/// Runs an asynchronous command. Zenoh needs a runtime of several threads.
pub(crate) fn block_on<T>(future: impl Future<Output = anyhow::Result<T>>) -> anyhow::Result<T> {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    let result = runtime.block_on(future);
    // The bus may leave a thread behind that never ends.
    runtime.shutdown_timeout(std::time::Duration::from_millis(200));
    result
}

/// Ready when the process is asked to end (SIGINT or SIGTERM).
pub(crate) async fn asked_to_stop() -> anyhow::Result<()> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut term = signal(SignalKind::terminate()).context("SIGTERM cannot be watched")?;
    let mut int = signal(SignalKind::interrupt()).context("SIGINT cannot be watched")?;
    tokio::select! {
        _ = term.recv() => {}
        _ = int.recv() => {}
    }
    Ok(())
}
