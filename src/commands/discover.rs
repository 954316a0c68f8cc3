//! `stictiond discover`: lists the loops on a bus or in files as `[[loop]]` entries.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Context, anyhow};

use crate::cli::reading::ReadArgs;
use crate::cli::{Format, Outcome, asked_to_stop, block_on, note};
use crate::cli::{bus, put};
use stiction::core::record::Signal;
use stiction_files::pairing::{Listing, Seen};

/// Find loops on a bus or in files and write [[loop]] entries; signals are paired by the endings of their names.
///
/// On the bus it examines every key below --key that carries data within --for seconds, and the names inside payloads
/// with several signals. Unpaired names are written as comments and counted on stderr.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples: stictiond discover --connect tcp/127.0.0.1:7447 --key 'gateway/**' --for 30\n          \
                        stictiond discover exports/ --pattern 'gateway/{loop}.{SIGNAL}' --out loops.toml"
)]
pub struct Args {
    /// Files, folders and patterns to examine.
    #[arg(required_unless_present = "connect", conflicts_with = "connect")]
    pub input: Vec<PathBuf>,
    /// Zenoh endpoint of the bus to examine, such as tcp/127.0.0.1:7447.
    #[arg(long, value_parser = bus::endpoint)]
    pub connect: Option<String>,
    /// Zenoh key expression of the keys to examine.
    #[arg(long, default_value = "**", requires = "connect")]
    pub key: String,
    /// How long to listen, s.
    #[arg(long = "for", default_value_t = 10.0, requires = "connect", value_parser = seconds)]
    pub for_s: f64,
    /// Key pattern for loops found in files, with {loop}, {signal} and {SIGNAL} as placeholders [default: entries with a
    /// name only].
    #[arg(long, conflicts_with = "connect")]
    pub pattern: Option<String>,
    /// Output file [default: stdout].
    #[arg(long)]
    pub out: Option<PathBuf>,
    /// Replace an existing file.
    #[arg(long)]
    pub force: bool,
    /// Options for reading exports.
    #[command(flatten)]
    pub reading: ReadArgs,
}

fn seconds(text: &str) -> Result<f64, String> {
    let sound = |s: &f64| (0.1..=86_400.0).contains(s);
    text.parse().ok().filter(sound).ok_or_else(|| "write seconds from 0.1 to 86400".to_owned())
}

/// Runs the command.
///
/// # Errors
/// Nothing can be read, nothing answers at the endpoint, or no loop was found.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let (seen, what) = match &args.connect {
        Some(endpoint) => (look_at_bus(endpoint, &args.key, args.for_s)?, format!("{} for {} s", args.key, args.for_s)),
        None => (look_at_files(args)?, crate::cli::reading::named(&args.input)),
    };
    let keyed = args.connect.is_some() || args.pattern.is_some();
    tell(&Listing { seen: &seen, keyed, what: &what }, args, format)
}

/// Prints or writes the entries, and notes on stderr what was found.
fn tell(listing: &Listing<'_>, args: &Args, format: Format) -> anyhow::Result<Outcome> {
    let text = if format == Format::Json { listing.json() } else { listing.toml() };
    put(&text, args.out.as_deref(), args.force)?;
    note(listing.summary());
    listing.check()?;
    Ok(Outcome::Done)
}

fn look_at_files(args: &Args) -> anyhow::Result<Seen> {
    let mut seen = Seen::default();
    let loaded = args.reading.load_all(&args.input)?;
    loaded.warnings.iter().for_each(crate::cli::warn);
    for one in &loaded.loops {
        for signal in Signal::ALL.into_iter().filter(|signal| one.count(*signal).0 > 0) {
            let fill = |pattern: &String| {
                let key = pattern.replace("{loop}", &one.name).replace("{signal}", signal.name());
                key.replace("{SIGNAL}", &signal.name().to_uppercase())
            };
            seen.take(&one.name, signal, 0, &args.pattern.as_ref().map(fill).unwrap_or_default());
        }
    }
    Ok(seen)
}

fn look_at_bus(endpoint: &str, key: &str, for_s: f64) -> anyhow::Result<Seen> {
    // The part before the first wildcard does not belong to a loop's name.
    let mut fixed: String = key.split_inclusive('/').take_while(|chunk| !chunk.contains(['*', '$'])).collect();
    if !fixed.ends_with('/') {
        fixed.truncate(fixed.rfind('/').map_or(0, |at| at + 1));
    }
    let seen = Arc::new(Mutex::new(Seen::default()));
    let into = seen.clone();
    block_on(async {
        let stop = asked_to_stop()?;
        let session = bus::connect(endpoint).await?;
        let subscriber = session
            .declare_subscriber(key.to_owned())
            .callback(move |sample| {
                let encoding = sample.encoding().to_string();
                let mut seen = into.lock().unwrap_or_else(PoisonError::into_inner);
                seen.message(sample.key_expr().as_str(), &fixed, Some(&encoding), &sample.payload().to_bytes());
            })
            .await
            .map_err(|e| anyhow!("cannot subscribe to {key:?}: {e}"))?;
        tokio::select! {
            () = tokio::time::sleep(Duration::from_secs_f64(for_s)) => {}
            () = stop => {}
        }
        subscriber.undeclare().await.map_err(|e| anyhow!("{e}"))?;
        let _ = tokio::time::timeout(Duration::from_secs(2), session.close()).await;
        Ok(())
    })?;
    let seen = std::mem::take(&mut *seen.lock().unwrap_or_else(PoisonError::into_inner));
    if !seen.has_data() {
        return Err(anyhow!("no data received; check --key and raise --for"))
            .with_context(|| format!("{key} at {endpoint}"));
    }
    Ok(seen)
}
