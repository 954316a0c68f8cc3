//! `stictiond workbench`: the page for files, without a daemon.

use std::net::SocketAddr;
use std::path::PathBuf;

use anyhow::{Context, bail};
use clap::CommandFactory;
use serde_json::json;
use tokio::net::TcpListener;

use crate::cli::reading::ReadArgs;
use crate::cli::{Format, Outcome, asked_to_stop, block_on, note, say, warn};
use crate::commands::browser;
use crate::web;
use crate::web::workbench::{OPTIONS, ReadingWords, Workbench};
use stiction_files::inputs::Unit;

/// Open files in the browser: choose sections on the trend, estimate, diagnose, compare, save reports.
///
/// The page is served by this program, needs no internet and is open to this machine alone. The numbers are those of
/// `analyze` and `gap`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stictiond workbench
  stictiond workbench recordings/sticking.mcap
  stictiond workbench exports/ --tz Europe/Berlin --listen 8090 --no-open

Ctrl-C ends it. Uploaded files are in a temporary folder until then.")]
pub struct Args {
    /// Tables, exports, recordings (.mcap), compact stores (.mat); folders and patterns of them too. More can be opened
    /// in the page.
    pub input: Vec<PathBuf>,
    /// How exports are read.
    #[command(flatten)]
    pub reading: ReadArgs,
    /// Where the page is served: a port of this machine, or an address with a port; port 0 takes any free one.
    #[arg(long, value_name = "PORT|ADDRESS", default_value = "127.0.0.1:0", value_parser = address)]
    pub listen: SocketAddr,
    /// Memory that the program may take for data, MiB. A file that needs more ends the program, and nothing else on the
    /// machine (Linux).
    #[arg(long, value_name = "MIB", default_value_t = 4096, value_parser = clap::value_parser!(u64).range(128..))]
    pub max_memory: u64,
    /// Only print the address, open no browser.
    #[arg(long)]
    pub no_open: bool,
}

fn address(text: &str) -> Result<SocketAddr, String> {
    let port = text.parse::<u16>().map(|port| SocketAddr::from(([127, 0, 0, 1], port)));
    port.or_else(|_| text.parse()).map_err(|_| format!("{text:?} is no address: write 8090 or 127.0.0.1:8090"))
}

/// Runs the command until it is stopped.
///
/// # Errors
/// The address cannot be used, or none of the given files can be read.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    limit_memory(args.max_memory)?;
    let bench = Workbench::start();
    let units = if args.input.is_empty() { Vec::new() } else { args.reading.units(&args.input)? };
    let (mut opened, mut failed) = (0, Vec::new());
    for unit in units {
        let name = Unit::name(&unit);
        match bench.open(unit, args.reading.options(), words()) {
            Ok(loops) => {
                opened += 1;
                note(format_args!("{name}: {loops} {}", if loops == 1 { "loop" } else { "loops" }));
            }
            Err(fault) => failed.push(fault),
        }
    }
    if opened == 0 && !failed.is_empty() {
        bail!("{}", crate::cli::list(&failed));
    }
    failed.iter().for_each(warn);
    // Times are shown in the zone that was given for the files.
    let zone = args.reading.tz.as_ref().map_or("UTC", |zone| zone.name()).to_owned();
    block_on(async {
        let stopping = asked_to_stop()?;
        let listener = TcpListener::bind(args.listen).await;
        let listener =
            listener.with_context(|| format!("{} cannot be used; --listen 0 takes any free port", args.listen))?;
        let address = listener.local_addr()?;
        let url = format!("http://{address}/#/workbench");
        match format {
            Format::Text => say(format_args!("The workbench is at {url} until Ctrl-C."))?,
            Format::Json => say(json!({"url": url, "address": address.to_string()}))?,
        }
        if !address.ip().is_loopback() {
            warn("whoever reaches this address can look at the files; only this machine can open or analyse some");
        }
        if !args.no_open {
            browser::open(&url);
        }
        tokio::select! {
            () = web::workbench::serve(listener, bench.clone(), zone) => {}
            () = stopping => {}
        }
        Ok(())
    })?;
    bench.close();
    Ok(Outcome::Done)
}

/// Limits this process's data memory: an allocation beyond the limit fails, which ends the program.
#[cfg(target_os = "linux")]
fn limit_memory(mib: u64) -> anyhow::Result<()> {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let there = getrlimit(Resource::Data);
    let wanted = mib << 20;
    let limit = there.current.map_or(wanted, |current| current.min(wanted));
    setrlimit(Resource::Data, Rlimit { current: Some(limit), maximum: there.maximum })
        .with_context(|| format!("the system refuses a limit of {mib} MiB (--max-memory)"))
}

#[cfg(not(target_os = "linux"))]
fn limit_memory(_: u64) -> anyhow::Result<()> {
    Ok(())
}

/// The reading options as typed, for the command lines shown on the page.
fn words() -> ReadingWords {
    let mut words = ReadingWords::default();
    let matches = crate::commands::Cli::command().get_matches();
    let Some((_, given)) = matches.subcommand() else { return words };
    for name in OPTIONS {
        let value = given.get_raw(name).and_then(|mut values| values.next());
        if let Some(value) = value {
            // They were already checked when the command line was parsed.
            let _ = words.set(name, &value.to_string_lossy());
        }
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_alone_is_one_of_this_machine() {
        assert_eq!(address("8090"), Ok(SocketAddr::from(([127, 0, 0, 1], 8090))));
        assert_eq!(address("0.0.0.0:0"), Ok(SocketAddr::from(([0, 0, 0, 0], 0))));
        assert!(address("somewhere").is_err() && address("70000").is_err());
    }
}
