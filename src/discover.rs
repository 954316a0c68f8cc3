//! `stictiond discover`: lists the loops on a bus, in files or in an OPC UA server as `[[loop]]` entries.

#[cfg(feature = "bridge-opcua")]
pub mod opcua;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use serde_json::json;

use super::reading::ReadArgs;
use super::{Format, Outcome, asked_to_stop, block_on, note, play, print, say};
use stiction::record::Signal;
use stiction::units::{is_loop_name, loop_name_from};
use stiction_command::manual::refuse_existing;
use stiction_files::export::names::role;
use stiction_monitor::codec::{self, Bundle, Memory};
use stiction_monitor::config::NAME_MARK;

/// Most keys and names examined.
const MAX_NAMES: usize = 1_000_000;
/// Most names of one kind listed.
const TOLD: usize = 50;

/// Find loops on a bus or in files and write [[loop]] entries; signals are paired by the endings of their names.
///
/// On the bus it examines every key below --key that carries data within --for seconds, and the names inside payloads
/// with several signals. Unpaired names are written as comments and counted on stderr.
#[derive(Debug, clap::Args)]
#[command(
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    disable_help_subcommand = true,
    after_help = "Examples: stictiond discover --connect tcp/127.0.0.1:7447 --key 'gateway/**' --for 30\n          \
                        stictiond discover exports/ --pattern 'gateway/{loop}.{SIGNAL}' --out loops.toml"
)]
pub struct Args {
    #[command(subcommand)]
    elsewhere: Option<Elsewhere>,
    /// Files, folders and patterns to examine.
    #[arg(required_unless_present = "connect", conflicts_with = "connect")]
    pub input: Vec<PathBuf>,
    /// Zenoh endpoint of the bus to examine, such as tcp/127.0.0.1:7447.
    #[arg(long)]
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

#[derive(Debug, clap::Subcommand)]
enum Elsewhere {
    #[cfg(feature = "bridge-opcua")]
    Opcua(Box<opcua::Args>),
    #[cfg(not(feature = "bridge-opcua"))]
    Opcua(super::bridge::Absent),
}

fn seconds(text: &str) -> Result<f64, String> {
    let sound = |s: &f64| (0.1..=86_400.0).contains(s);
    text.parse().ok().filter(sound).ok_or_else(|| "write seconds from 0.1 to 86400".to_owned())
}

/// What was seen: signals of loops by source, and names without a recognised signal.
#[derive(Debug, Default)]
struct Seen {
    loops: BTreeMap<String, BTreeMap<&'static str, (usize, String)>>,
    unknown: BTreeSet<String>,
    names: usize,
    memory: Memory,
    /// How often each key was decoded: once its names are known, its payloads add nothing.
    looked: HashMap<String, u8>,
}

impl Seen {
    /// Takes one name. If its ending names a signal, it becomes the source of that loop's signal unless a better one exists.
    fn take(&mut self, loop_name: &str, signal: Signal, rank: usize, source: &str) {
        self.names += 1;
        let signals = self.loops.entry(loop_name.to_owned()).or_default();
        let stronger = signals.get(signal.name()).is_none_or(|(known, _)| rank < *known);
        if stronger && let Some((_, weaker)) = signals.insert(signal.name(), (rank, source.to_owned())) {
            self.unknown.insert(weaker);
        } else if !stronger && signals.get(signal.name()).is_some_and(|(_, known)| known != source) {
            self.unknown.insert(source.to_owned());
        }
    }

    /// Takes a single-signal name; `own` is the part below the fixed prefix.
    fn name(&mut self, own: &str, source: String) -> bool {
        match role(own).filter(|found| !found.loop_name.is_empty()) {
            Some(found) => self.take(&found.loop_name, found.signal, found.rank, &source),
            None => return false,
        }
        true
    }

    /// Takes a bus message; `fixed` is the common start of all keys.
    fn message(&mut self, key: &str, fixed: &str, encoding: Option<&str>, payload: &[u8]) {
        let times = self.looked.get(key).copied().unwrap_or(0);
        if times >= 3 || self.looked.len() >= MAX_NAMES || self.names >= MAX_NAMES {
            return;
        }
        self.looked.insert(key.to_owned(), times + 1);
        let own = key.strip_prefix(fixed).unwrap_or(key);
        if self.name(own, key.to_owned()) {
            return;
        }
        let (mut fields, bundle) = (Vec::new(), Bundle { key, payload, fallback_t_ns: 0 });
        if codec::decode_fields(&bundle, encoding, None, &mut self.memory, &mut fields).is_err() || fields.is_empty() {
            self.unknown.insert(key.to_owned());
            return;
        }
        for field in fields {
            let source = format!("{key}{NAME_MARK}{}", field.name);
            match role(field.own_name()) {
                None => drop(self.unknown.insert(source)),
                Some(found) => {
                    let of = if field.of.is_empty() { own } else { &field.of };
                    let name = if found.loop_name.is_empty() { loop_name_from(of) } else { found.loop_name };
                    self.take(&name, found.signal, found.rank, &source);
                }
            }
        }
    }

    /// Loops that have an OP and a PV, and those that lack one.
    fn paired(&self) -> (Vec<&str>, Vec<&str>) {
        let whole = |name: &&str| {
            let signals = &self.loops[*name];
            is_loop_name(name) && signals.contains_key("op") && signals.contains_key("pv")
        };
        self.loops.keys().map(String::as_str).partition(whole)
    }
}

/// Runs the command.
///
/// # Errors
/// Nothing can be read, nothing answers at the endpoint, or no loop was found.
pub fn run(args: &Args, format: Format) -> anyhow::Result<Outcome> {
    match &args.elsewhere {
        #[cfg(feature = "bridge-opcua")]
        Some(Elsewhere::Opcua(args)) => {
            let (seen, what) = opcua::look(args)?;
            tell(
                &Listing { seen: &seen, keyed: true, what: &what, out: args.out.as_deref(), force: args.force },
                format,
            )
        }
        #[cfg(not(feature = "bridge-opcua"))]
        Some(Elsewhere::Opcua(absent)) => absent.refuse("OPC UA client", "bridge-opcua"),
        None => {
            let (seen, what) = match &args.connect {
                Some(endpoint) => {
                    (look_at_bus(endpoint, &args.key, args.for_s)?, format!("{} for {} s", args.key, args.for_s))
                }
                None => (look_at_files(args)?, super::reading::named(&args.input)),
            };
            let keyed = args.connect.is_some() || args.pattern.is_some();
            tell(&Listing { seen: &seen, keyed, what: &what, out: args.out.as_deref(), force: args.force }, format)
        }
    }
}

/// What to print and where.
struct Listing<'a> {
    seen: &'a Seen,
    /// Whether entries name their sources.
    keyed: bool,
    what: &'a str,
    out: Option<&'a Path>,
    force: bool,
}

fn tell(told: &Listing<'_>, format: Format) -> anyhow::Result<Outcome> {
    let Listing { seen, keyed, what, out, force } = *told;
    let (whole, lacking) = seen.paired();
    let text = match format {
        Format::Text => as_toml(seen, &whole, &lacking, keyed, what),
        Format::Json => as_json(seen, &whole, &lacking),
    };
    match out {
        Some(path) => {
            refuse_existing(path, force)?;
            std::fs::write(path, text).with_context(|| path.display().to_string())?;
        }
        None if format == Format::Json => say(text.trim_end())?,
        None => print(&text)?,
    }
    let unknown = seen.unknown.len();
    note(format!(
        "{what}: found {} loops; {} lack OP or PV; {unknown} names have no recognised signal",
        whole.len(),
        lacking.len()
    ));
    if whole.is_empty() {
        bail!("no loop with both OP and PV found; names must end like FIC101.OP and FIC101.PV: check --key or --map");
    }
    Ok(Outcome::Done)
}

fn look_at_files(args: &Args) -> anyhow::Result<Seen> {
    let mut seen = Seen::default();
    let loaded = args.reading.load_all(&args.input)?;
    loaded.warnings.iter().for_each(super::warn);
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
    // What stands in front of the first wildcard is no part of a loop's name.
    let mut fixed: String = key.split_inclusive('/').take_while(|chunk| !chunk.contains(['*', '$'])).collect();
    if !fixed.ends_with('/') {
        fixed.truncate(fixed.rfind('/').map_or(0, |at| at + 1));
    }
    let seen = Arc::new(Mutex::new(Seen::default()));
    let into = seen.clone();
    block_on(async {
        let stop = asked_to_stop()?;
        let session = play::connect(endpoint).await?;
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
    if seen.looked.is_empty() {
        return Err(anyhow!("no data received; check --key and raise --for"))
            .with_context(|| format!("{key} at {endpoint}"));
    }
    Ok(seen)
}

/// A text as TOML quotes it.
fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

fn as_toml(seen: &Seen, whole: &[&str], lacking: &[&str], keyed: bool, what: &str) -> String {
    let mut text = format!("# {} loops, by stictiond discover from {}\n", whole.len(), what.escape_debug());
    // Writing into a String cannot fail.
    for name in whole {
        let _ = write!(text, "\n[[loop]]\nname = {}\n", quoted(name));
        for (signal, (_, source)) in seen.loops[*name].iter().filter(|_| keyed) {
            let _ = writeln!(text, "{signal} = {}", quoted(source));
        }
    }
    if !lacking.is_empty() {
        let _ = writeln!(text, "\n# Lack OP or PV:");
    }
    for name in lacking.iter().take(TOLD) {
        let signals: Vec<String> = seen.loops[*name].iter().map(|(s, (_, source))| format!("{s} {source}")).collect();
        let _ = writeln!(text, "# {}", format!("{name}: {}", signals.join(", ")).escape_debug());
    }
    rest(&mut text, lacking.len());
    if !seen.unknown.is_empty() {
        let _ = writeln!(text, "\n# Names without a recognised signal, or with one that another name matches better:");
    }
    for name in seen.unknown.iter().take(TOLD) {
        let _ = writeln!(text, "# {}", name.escape_debug());
    }
    rest(&mut text, seen.unknown.len());
    text
}

fn rest(text: &mut String, count: usize) {
    if count > TOLD {
        let _ = writeln!(text, "# and {} more; --format json lists all", count - TOLD);
    }
}

fn as_json(seen: &Seen, whole: &[&str], lacking: &[&str]) -> String {
    let entry = |name: &&str| {
        let signals: BTreeMap<_, _> = seen.loops[*name].iter().map(|(s, (_, source))| (*s, source)).collect();
        json!({"name": name, "signals": signals})
    };
    let of = |names: &[&str]| names.iter().map(entry).collect::<Vec<_>>();
    json!({"schema": "stictiond.discover.v1", "loops": of(whole), "unpaired": of(lacking), "unknown": seen.unknown})
        .to_string()
        + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use stiction_monitor::config::Config;

    #[test]
    fn loops_of_a_bus_are_paired_and_the_rest_is_said() {
        let mut seen = Seen::default();
        for key in ["gw/u1/FIC101.OP", "gw/u1/FIC101.PV", "gw/u1/FIC101.SP", "gw/u1/LIC7.PV", "gw/u1/FIC101.OUT"] {
            seen.message(key, "gw/", None, b"1.5");
        }
        seen.message("gw/plc", "gw/", None, br#"{"TIC3": {"op": 1, "pv": 2}, "PIC4.PV": 3, "noise": 4}"#);
        seen.message("gw/odd", "gw/", None, b"\xff\xfe");
        let (whole, lacking) = seen.paired();
        assert_eq!(
            (whole.as_slice(), lacking.as_slice()),
            (["TIC3", "u1_FIC101"].as_slice(), ["PIC4", "u1_LIC7"].as_slice())
        );
        let unknown: Vec<&str> = seen.unknown.iter().map(String::as_str).collect();
        assert_eq!(unknown, ["gw/odd", "gw/plc#noise", "gw/u1/FIC101.OUT"]);
        let text = as_toml(&seen, &whole, &lacking, true, "a test");
        let config = Config::parse(&format!("[site]\nprefix = \"p\"\n{text}")).unwrap();
        assert_eq!(config.loops.len(), 2);
        assert!(config.loops[0].keys.contains(&(Signal::Op, "gw/plc#TIC3.op".to_owned())), "{text}");
        assert!(text.contains("# u1_LIC7: pv gw/u1/LIC7.PV"), "{text}");
    }
}
