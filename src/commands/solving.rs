//! A solver on the error surface, as in the toolbox: a built-in one by name, or an external program.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use crossbeam_channel::{Receiver, RecvTimeoutError, bounded};
use indicatif::ProgressBar;
use serde_json::json;

use crate::cli::stop;
use stiction::core::ident::Options;
use stiction::core::optim::{Outcome, Settings, SolverName, Termination};
use stiction::core::record::Record;
use stiction::core::units::significant;
use stiction::core::verdict::Assessment;
use stiction::toolbox::surface::{BUDGET, Solved, Surface};
use stiction_engine::analysis::solver::{self, SolverDocument};

/// `--solver` and its options.
#[derive(Debug, Clone, clap::Args)]
pub struct SolverArgs {
    /// Also minimise the mean squared error over (fs, fd) with this solver, as the toolbox does, and print its result next to
    /// the estimate: contour, multistart, random, branch-bound, or cmd:PROGRAM (see examples/solver.py).
    #[arg(long, value_parser = choice, help_heading = "Solver")]
    pub solver: Option<SolverChoice>,
    /// Step of the contour grid in % of S0, OP's span; for --solver contour and for the estimate's first scan.
    #[arg(long, value_name = "PCT", default_value_t = Options::default().fineness_pct, value_parser = fineness, help_heading = "Solver")]
    pub fineness: f64,
    /// Largest number of models that the solver may evaluate.
    #[arg(long, value_name = "N", default_value_t = BUDGET, value_parser = clap::value_parser!(u64).range(1..=10_000_000),
        help_heading = "Solver")]
    pub evaluations: u64,
    /// End an external program that writes nothing for this long.
    #[arg(long, value_name = "SECONDS", default_value_t = 60.0, value_parser = patience, help_heading = "Solver")]
    pub solver_patience: f64,
    /// Seed of all random choices.
    #[arg(long, default_value_t = Options::default().seed, help_heading = "Solver")]
    pub seed: u64,
}

/// Which solver to run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SolverChoice {
    /// A built-in solver.
    Ours(SolverName),
    /// An external program with its arguments.
    Program(String),
}

fn choice(text: &str) -> Result<SolverChoice, String> {
    if let Some(program) = text.strip_prefix("cmd:") {
        let program = program.trim();
        return if program.is_empty() {
            Err("write the program after cmd:, such as cmd:examples/solver.py".to_owned())
        } else {
            Ok(SolverChoice::Program(program.to_owned()))
        };
    }
    let names = || SolverName::ALL.map(SolverName::name).join(", ");
    SolverName::of(text).map(SolverChoice::Ours).ok_or_else(|| format!("known solvers: {}, cmd:PROGRAM", names()))
}

fn fineness(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("{text:?} is not a number"))?;
    if (0.5..=50.0).contains(&value) { Ok(value) } else { Err("write a step from 0.5 to 50 %".to_owned()) }
}

fn patience(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("{text:?} is not a number"))?;
    if (0.1..=86_400.0).contains(&value) { Ok(value) } else { Err("write seconds from 0.1 to 86400".to_owned()) }
}

/// Runs the solver on the surface of an assessment: its valve law and process class. `None` if the record could not be
/// fitted.
///
/// # Errors
/// The program cannot be started, writes something other than numbers, or writes nothing for too long.
pub fn run(
    args: &SolverArgs,
    record: &Record,
    options: &Options,
    found: &Assessment,
    bar: &ProgressBar,
) -> anyhow::Result<Option<SolverDocument>> {
    let Some(choice) = &args.solver else { return Ok(None) };
    let Some(mut surface) = solver::surface(record, options, found) else { return Ok(None) };
    let settings = Settings { budget: args.evaluations, fineness_pct: args.fineness, seed: args.seed };
    let own = found.fs.zip(found.fd);
    let estimate_mse = solver::own_mse(&mut surface, found);
    let started = Instant::now();
    let (name, mut solved) = match choice {
        SolverChoice::Ours(solver) => {
            let name = solver.name();
            let mut heard = |done: u64, least: f64| {
                if done.is_multiple_of(50) {
                    let least = significant(least, 5);
                    bar.set_message(format!("{name} {done} of {}, least MSE {least}", settings.budget));
                }
                !stop::asked()
            };
            (name.to_owned(), solver::search(&mut surface, solver.solver(), &settings, &mut heard))
        }
        SolverChoice::Program(program) => {
            let patience = Duration::from_secs_f64(args.solver_patience);
            let outcome = converse(program, &mut surface, &settings, own, patience, bar)
                .with_context(|| format!("--solver cmd:{program}"))?;
            (program.clone(), Solved::of(outcome, surface.s0()))
        }
    };
    let elapsed_ms = started.elapsed().as_secs_f64() * 1e3;
    if stop::asked() {
        solved.outcome.stopped = Termination::Interrupted;
    }
    Ok(Some(solver::document(name, &solved, &mut surface, &settings, found, estimate_mse, elapsed_ms)))
}

/// A running program. On drop it is killed with every program that it started, since any survivor would hold standard error
/// open.
struct Program {
    child: Child,
    lines: Receiver<std::io::Result<String>>,
}

impl Drop for Program {
    fn drop(&mut self) {
        // If it has exited by itself, this has no effect.
        #[cfg(target_os = "linux")]
        if let Some(group) = i32::try_from(self.child.id()).ok().and_then(rustix::process::Pid::from_raw) {
            let _ = rustix::process::kill_process_group(group, rustix::process::Signal::KILL);
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn launch(program: &str) -> anyhow::Result<(Program, ChildStdin)> {
    let whole = std::path::Path::new(program).is_file();
    let mut words = if whole { vec![program] } else { program.split_whitespace().collect() };
    let first = words.remove(0);
    let mut command = Command::new(first);
    command.args(words).stdin(Stdio::piped()).stdout(Stdio::piped());
    #[cfg(target_os = "linux")]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    let mut child = command.spawn().with_context(|| format!("{first:?} cannot be started"))?;
    let (Some(input), Some(output)) = (child.stdin.take(), child.stdout.take()) else {
        bail!("{first:?} has no standard input and output");
    };
    let (send, lines) = bounded(16);
    std::thread::spawn(move || {
        for line in BufReader::new(output).lines() {
            if send.send(line).is_err() {
                break;
            }
        }
    });
    Ok((Program { child, lines }, input))
}

/// Reads pairs `fs fd` from a program and answers each with its mean squared error (`inf` where no model exists), until
/// the program closes its output or the evaluations are used up.
fn converse(
    program: &str,
    surface: &mut Surface,
    settings: &Settings,
    own: Option<(f64, f64)>,
    patience: Duration,
    bar: &ProgressBar,
) -> anyhow::Result<Outcome> {
    let s0 = surface.s0();
    let (mut running, mut input) = launch(program)?;
    let task = json!({
        "schema": "stictiond.solver.v1", "s0": s0, "bounds": {"fs": [0.0, s0], "fd": [0.0, s0]},
        "constraints": ["fd <= fs", "fs + fd <= s0"], "evaluations": settings.budget, "seed": settings.seed,
        "estimate": own.map(|(fs, fd)| json!({"fs": fs, "fd": fd})),
    });
    // If the program does not read, this is noticed when it ends.
    let mut open = writeln!(input, "{task}").and_then(|()| input.flush()).is_ok();
    let mut best = Outcome::nothing();
    loop {
        let line = match next_line(&running.lines, patience)? {
            Some(line) => line?,
            None => break,
        };
        let line = line.trim();
        if line.is_empty() {
            continue;
        }
        let Some([fs, fd]) = two_numbers(line) else {
            bail!("wrote {line:?} after {} evaluations; write two numbers per line, fs and fd", best.evaluations);
        };
        if best.evaluations == settings.budget {
            best.stopped = Termination::Budget;
            return Ok(best);
        }
        let mse = surface.mse(fs, fd);
        best.evaluations += 1;
        if mse < best.cost {
            (best.cost, best.best) = (mse, [(fs + fd) / s0, (fs - fd) / s0]);
        }
        let answer = if mse.is_finite() { format!("{mse}") } else { "inf".to_owned() };
        open &= writeln!(input, "{answer}").and_then(|()| input.flush()).is_ok();
        if best.evaluations.is_multiple_of(50) {
            bar.set_message(format!("{program} {} of {}", best.evaluations, settings.budget));
        }
        if stop::asked() {
            return Ok(best);
        }
    }
    drop(input);
    finish(&mut running, &best, open, patience)?;
    Ok(best)
}

fn two_numbers(line: &str) -> Option<[f64; 2]> {
    let mut words = line.split(|c: char| c.is_whitespace() || c == ',').filter(|w| !w.is_empty());
    let numbers = [words.next()?.parse().ok()?, words.next()?.parse().ok()?];
    words.next().is_none().then_some(numbers)
}

/// The next line; `None` at the end of the output.
fn next_line(
    lines: &Receiver<std::io::Result<String>>,
    patience: Duration,
) -> anyhow::Result<Option<std::io::Result<String>>> {
    let until = Instant::now() + patience;
    loop {
        match lines.recv_timeout(Duration::from_millis(100)) {
            Ok(line) => return Ok(Some(line)),
            Err(RecvTimeoutError::Disconnected) => return Ok(None),
            Err(RecvTimeoutError::Timeout) if stop::asked() => return Ok(None),
            Err(RecvTimeoutError::Timeout) if Instant::now() > until => {
                bail!(
                    "wrote nothing for {} s and was ended; raise --solver-patience to wait longer",
                    patience.as_secs_f64()
                );
            }
            Err(RecvTimeoutError::Timeout) => {}
        }
    }
}

/// Waits for a program that has closed its output to exit, and checks its status.
fn finish(running: &mut Program, best: &Outcome, open: bool, patience: Duration) -> anyhow::Result<()> {
    let until = Instant::now() + patience.min(Duration::from_secs(5));
    while Instant::now() < until && !stop::asked() {
        if let Some(status) = running.child.try_wait()? {
            let done = best.evaluations;
            if !status.success() {
                bail!("exited with {status} after {done} evaluations");
            }
            if done == 0 {
                bail!("exited without writing a pair fs fd{}", if open { "" } else { " and without reading the task" });
            }
            return Ok(());
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solvers_are_read_or_refused_with_a_reason() {
        assert_eq!(choice("random"), Ok(SolverChoice::Ours(SolverName::Random)));
        assert_eq!(choice("cmd:python3 a.py"), Ok(SolverChoice::Program("python3 a.py".to_owned())));
        assert!(choice("lgo").unwrap_err().contains("multistart") && choice("cmd: ").is_err());
        assert_eq!(two_numbers("1.5, 2e-1"), Some([1.5, 0.2]));
        assert!(two_numbers("1").is_none() && two_numbers("1 2 3").is_none() && two_numbers("a b").is_none());
    }
}
